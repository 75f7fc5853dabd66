"""Training: samples, losses, checkpoints."""
