"""Our own plant: rigid body, rotors, controller, flown by itself for many flights at once."""
