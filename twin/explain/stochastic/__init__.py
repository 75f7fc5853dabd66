"""Effects that change no mean: noise, vibration, gusts, readings that stand still."""
