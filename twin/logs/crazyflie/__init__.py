"""Crazyflie uSD-card logs -> Flight; Bitcraze's units, axes and names stand here alone."""
