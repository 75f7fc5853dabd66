"""Verbs that write a flight table."""
