"""Zero-mean effects: noise, vibration, gusts, stuck readings."""
