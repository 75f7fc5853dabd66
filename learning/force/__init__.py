"""Residual force and moment of the equations, learned from flights and added to the equations."""
