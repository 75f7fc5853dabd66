"""Components, the whole twin, replays and compensators as files that FMI tools run."""
