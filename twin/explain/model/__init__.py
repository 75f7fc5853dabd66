"""Residuals of flights as a function of the numbers of effects."""
