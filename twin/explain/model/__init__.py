"""Residuals of flights as a function of the effects' numbers."""
