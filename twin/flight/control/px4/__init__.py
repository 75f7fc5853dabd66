"""PX4's multicopter control: cascade, mixer, parameters."""
