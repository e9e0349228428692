"""Fault priors of a scenario that gives none, for the scenario and for the tables of its result."""

GROUP_PRIOR = 1e-5
"""Probability that a whole group of pseudolites or beacons is faulty."""
