"""Azimuth of an aircraft from a scanning radar and Mode S reports."""
