"""`python -m navsim`, and the `navsim` command."""

from __future__ import annotations

import gc
import os

from navsim.cli.exit_status import deafen, ends, prepare_streams

_OBJECTS = 200_000
"""New objects between two looks for cycles among them; Python's own number, 700, is a third of the imports' time."""


def _spare() -> None:
    """Switch off costs that a short command does not need.

    These are garbage collection during imports, a thread pool for matrices of fifteen rows (threads are for runs), and
    pydantic's search of all installed packages for plugins.
    """
    gc.set_threshold(_OBJECTS)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy reads it when it is imported
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")


def main() -> None:
    """Entry point; signals are handled from here on, before anything heavy is imported."""
    _spare()
    prepare_streams()
    try:
        with ends():
            from navsim.cli.main import app

            app()
    finally:
        deafen()
        gc.freeze()  # everything left is freed with the process, without a last garbage collection


if __name__ == "__main__":
    main()
