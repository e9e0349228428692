"""Formats of other programs: read, checked and written."""
