"""The twin as the simulator that an autopilot flies: PX4's simulator interface."""
