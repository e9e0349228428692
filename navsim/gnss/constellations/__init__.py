"""Satellite systems: where their satellites are, from designs, almanacs, messages and precise orbits."""
