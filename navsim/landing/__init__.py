"""Landings: scenario to models, Monte Carlo, covariance analysis, rare events, requirements, the result."""
