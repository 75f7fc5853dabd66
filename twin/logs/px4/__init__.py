"""PX4 ULog files: signals, phases, and motor commands rebuilt at full rate."""
