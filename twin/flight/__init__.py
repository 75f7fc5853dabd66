"""Flights of the twin: controllers, missions, the closed loop, and records of simulated flights."""
