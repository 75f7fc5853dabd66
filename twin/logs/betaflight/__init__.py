"""Reader of Betaflight Blackbox logs; the only package with Betaflight's units, axes and names."""
