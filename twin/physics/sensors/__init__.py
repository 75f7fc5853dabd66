"""Sensors, one file each, and their shared functions."""
