"""The result file: its variables, how it is built, written and read."""
