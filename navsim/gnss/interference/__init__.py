"""Jammers: propagation, ridges, the loss in the correlator, loss of lock."""
