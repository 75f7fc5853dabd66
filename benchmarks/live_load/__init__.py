"""What a live flight bears: floods, hours, many aircraft at once."""
