"""Compensators of the sensors: trained, flown as FMUs, measured, drawn from."""
