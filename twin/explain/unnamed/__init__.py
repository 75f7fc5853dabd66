"""Something outside the library: equations for what no effect explains."""
