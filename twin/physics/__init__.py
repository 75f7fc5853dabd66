"""What moves the vehicle: rigid body, rotors, ground, battery, and the air around it."""
