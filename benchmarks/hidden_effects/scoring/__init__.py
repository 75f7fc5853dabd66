"""How well a program named what was hidden."""
