"""Recorded and live flights through the filter."""
