"""Torture: mutated scenarios, processes killed and disks full at every step, flipped bytes of results.

`python -m tests.torture` does it at length and writes docs/reliability.md; the tests here do the same briefly.
"""
