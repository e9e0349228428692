"""The Python interface: the jobs of the command line as functions. `navsim/__init__.py` lists the public names."""
