"""Flights in which a physical effect is hidden, and the score of a program that looks for it."""
