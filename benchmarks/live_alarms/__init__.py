"""Alarms while it flies: named right, how soon, and how often for nothing."""
