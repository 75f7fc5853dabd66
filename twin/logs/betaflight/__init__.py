"""Betaflight Blackbox logs -> Flight; Betaflight's units, axes and names stand here alone."""
