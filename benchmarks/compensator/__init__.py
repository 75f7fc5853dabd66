"""Flights with hidden effects at scale, for statistics on what a compensator learns."""
