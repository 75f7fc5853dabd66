"""Constants of the standard atmosphere, ISO 2533:1975."""

LAPSE_K_M = 0.0065
"""Fall of the temperature per height below 11 km."""
GAS_CONSTANT_J_KG_K = 287.05287
"""Specific gas constant of dry air."""
