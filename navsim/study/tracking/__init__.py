"""Studies of the companion papers' systems."""
