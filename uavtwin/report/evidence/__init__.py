"""The figures that convince of an effect."""
