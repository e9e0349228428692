"""The kinds of scenario files and the command that takes each. Imports nothing, so that `--help` can list them."""

from __future__ import annotations

COMMANDS = {
    "landing": "run",
    "mls-elevation": "run",
    "atc-tracking": "run",
    "azimuth-tracking": "run",
    "sweep": "sweep",
    "optimize": "optimize",
    "replay": "replay",
}
"""By kind, the command that computes a file of it."""
_NOUNS = {"sweep": "study", "optimize": "study", "replay": "log"}


def noun(kind: str) -> str:
    """What a file of this kind is called: scenario, study or log."""
    return _NOUNS.get(kind, "scenario")


def advice(kind: str, path: object) -> str:
    """Which commands take the file of this kind."""
    return f"a {noun(kind)} of kind {kind}: use navsim {COMMANDS[kind]} {path} or navsim validate {path}"
