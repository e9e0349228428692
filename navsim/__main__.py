"""`python -m navsim`."""

from navsim.cli.main import main

main()
