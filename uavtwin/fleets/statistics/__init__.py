"""Aircraft against each other, numbers against dates, many tests at once."""
