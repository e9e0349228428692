"""Sections of the companion papers' systems."""
