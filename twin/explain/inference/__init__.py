"""Selection of effects and estimation of their numbers from the residuals: likelihood, fit,
selection."""
