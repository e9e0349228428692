"""Satellites, pseudolites, their signals and what the receiver makes of them."""
