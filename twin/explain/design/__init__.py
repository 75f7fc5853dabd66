"""What to fly next to learn more."""
