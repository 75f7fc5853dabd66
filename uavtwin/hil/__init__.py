"""The twin as the simulator of an autopilot: PX4's simulator interface."""
