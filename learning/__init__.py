"""Compensator: what no named effect explains, learned from residuals (needs the extra `learn`)."""
