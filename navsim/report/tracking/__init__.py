"""How results of the companion papers' systems are shown."""
