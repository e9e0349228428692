"""Inertial sensors and altimeters."""
