"""Spelling of options in messages: as on the command line, or as in Python if the work was started there.

Results are the same for both, so they contain no such words.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_python: ContextVar[bool] = ContextVar("python", default=False)
_SHORT = {"output": "-o/"}
"""Options that have a short form, too."""


@contextmanager
def of_python() -> Iterator[None]:
    """Context in which messages of this thread, and of the workers of its studies, use Python's spelling."""
    token = _python.set(True)
    try:
        yield
    finally:
        _python.reset(token)


def option(name: str, value: object = None) -> str:
    """An option by its name in Python: `--first-run`, `--first-run 7`, or `first_run`, `first_run=7`."""
    if _python.get():
        return name if value is None else f"{name}={value!r}"
    return f"{_SHORT.get(name, '')}--{name.replace('_', '-')}" + ("" if value is None else f" {value}")


def switch(name: str) -> str:
    """An option that is on or off: `--fresh`, or `fresh=True`."""
    return option(name, True) if _python.get() else option(name)


def resume_hint() -> str:
    """Advice for continuing from finished work."""
    return "the same call" if _python.get() else "the same command"


def command(name: str, path: object) -> str:
    """A command of navsim for a file, where Python has the same: `navsim run FILE`, or `navsim.run('FILE')`."""
    return f"navsim.{name}({str(path)!r})" if _python.get() else f"navsim {name} {path}"


def show_hint(path: object) -> str:
    """Advice for looking at a result."""
    if _python.get():
        return f"use navsim.ResultFile({str(path)!r}) or navsim.load({str(path)!r})"
    return f"use navsim show {path} or navsim plot {path}"


def setting(key: str, value: object) -> str:
    """The assignment of a value to a key of the file."""
    return f"set[{key!r}]" if _python.get() else f"--set {key}={value}"
