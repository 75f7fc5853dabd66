"""How each effect is hidden in a plant."""
