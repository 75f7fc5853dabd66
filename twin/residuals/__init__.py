"""Differences between a flight and its twin: the flight on the twin's grid, predictions, the
gap."""
