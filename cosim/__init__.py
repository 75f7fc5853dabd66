"""Co-simulation: systems, the master, the gap between a flight and its twin, the command line."""
