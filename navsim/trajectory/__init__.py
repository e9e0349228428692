"""Trajectories of the aircraft, and the air that it flies in."""
