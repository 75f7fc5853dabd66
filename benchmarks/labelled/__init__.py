"""Somebody else's flights with a label, and what each method says of them."""
