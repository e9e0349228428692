"""The page of `navsim report`."""
