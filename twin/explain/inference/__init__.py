"""Which effects, with which numbers, the residuals ask for: likelihood, fit, selection."""
