"""Simulated flights: controllers, missions, the closed loop, and records of such flights."""
