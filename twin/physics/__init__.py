"""Dynamics of the vehicle: rigid body, rotors, ground, battery, sensors, and the air around it."""
