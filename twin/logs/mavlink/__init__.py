"""MAVLink: messages to samples of a flight table and back, telemetry logs."""
