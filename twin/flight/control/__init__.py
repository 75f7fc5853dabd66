"""What the controllers are made of: hover model, gains, attitude geometry, rotor mixing."""
