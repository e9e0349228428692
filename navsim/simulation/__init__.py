"""One run: truth, sensors, measurements, fixes, filter."""
