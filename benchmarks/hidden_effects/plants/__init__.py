"""Who flies: our own finer plant, and plants of other people's simulators."""
