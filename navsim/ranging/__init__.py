"""Recorded ranges of beacons and pseudolites: position, clocks and biases without an inertial sensor."""
