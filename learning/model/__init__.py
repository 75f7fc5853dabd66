"""The compensator and the baselines."""
