"""Elevation of an aircraft on an MLS approach."""
