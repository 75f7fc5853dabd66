"""Residual flights as data: channels, grids, sequences, scaling, clusters."""
