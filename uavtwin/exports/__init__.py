"""Export of components, the whole twin, replays and compensators for FMI tools."""
