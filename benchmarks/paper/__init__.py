"""Generators that the paper compares its own with, one module each."""
