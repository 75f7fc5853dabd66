"""Physics of the twin and flight logs: no FMU, no command line, no network."""
