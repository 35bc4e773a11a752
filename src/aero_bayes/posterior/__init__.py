"""Sample the posterior of a fit, and predict recordings from its draws."""
