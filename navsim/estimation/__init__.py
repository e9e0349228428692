"""Receiver fixes and navigation filters."""
