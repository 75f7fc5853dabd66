"""The compensator and what it has to beat."""
