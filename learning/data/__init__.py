"""Residual flights as training data: channels, grids, sequences, scaling, clusters."""
