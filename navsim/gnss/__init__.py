"""Satellites, pseudolites, their signals and the receiver."""
