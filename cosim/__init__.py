"""Co-simulation: systems of FMUs, the master, SSP files, masters in worker processes."""
