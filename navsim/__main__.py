"""`python -m navsim`, and the `navsim` command."""

from __future__ import annotations

from navsim.cli.ending import deafen, ends, prepare_streams


def main() -> None:
    """Entry point; what ends a command is heard from here on, before anything heavy is imported."""
    prepare_streams()
    try:
        with ends():
            from navsim.cli.main import app

            app()
    finally:
        deafen()


if __name__ == "__main__":
    main()
