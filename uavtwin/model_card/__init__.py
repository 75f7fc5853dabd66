"""Model cards: what a trained model is, learned from, was measured to do, and where it ends."""
