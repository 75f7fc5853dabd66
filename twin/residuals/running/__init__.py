"""Residuals of a flight that still goes on: the numbers of `gap`, a second later."""
