"""A receiver in the loop: `navsim live`."""
