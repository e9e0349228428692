"""Logs of other programs: a module a format, what they contain, the tables that `navsim import` writes."""
