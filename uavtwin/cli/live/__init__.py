"""The verbs of live flights."""
