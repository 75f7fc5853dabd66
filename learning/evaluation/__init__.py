"""Evaluation under a named protocol."""
