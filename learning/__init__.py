"""Compensators: residuals that no named effect explains, learned from flights (needs the extra
`learn`)."""
