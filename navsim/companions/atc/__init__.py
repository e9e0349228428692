"""Tracking by an air traffic control radar with onboard data."""
