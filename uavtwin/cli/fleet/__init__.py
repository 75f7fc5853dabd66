"""Verbs over many logs."""
