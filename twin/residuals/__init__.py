"""Where a flight and its twin disagree: the flight on the twin's grid, predictions, the gap."""
