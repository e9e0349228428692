"""Probability and random numbers: distributions, sampled processes, noise, consistency sums."""
