"""Logs of autopilots, receivers and recorders, read into one form (`contents`) and written as tables (`tables`)."""
