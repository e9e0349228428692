"""Keyword arguments of the functions of `navsim`: types, defaults and checks."""

from __future__ import annotations

import inspect
import operator
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypedDict, TypeVar, get_args, get_type_hints

from navsim.runner.errors import BadInput, as_problems
from navsim.runner.opening import Keep, Method, SweepMethod

F = TypeVar("F", bound=Callable[..., Any])
PathLike = str | os.PathLike[str]
Told = Callable[[int, int, str], None]
"""Progress callback: finished, extent (0 if unknown), message."""


class Common(TypedDict, total=False):
    """Keyword arguments of all functions that compute."""

    set: Mapping[str, Any] | None
    """Values for keys, dotted: `{"pseudolites.s_m": 1000}`."""
    output: PathLike | None
    """Result file; None: a temporary one, deleted with the returned object."""
    figures: PathLike | None
    """Folder for figures; None: no figures."""
    fresh: bool
    """Discard partial work of an earlier attempt."""
    force: bool
    """Overwrite a result of a different kind."""
    over_budget: bool
    """Compute even if this machine seems too small."""
    progress: Told | None
    """Callback for the progress of the work. An exception from it ends the work."""


class ResultConditions(Common, total=False):
    """Conditions on the result. If one fails, RunFailed is raised with the path of the complete result."""

    require_fix: bool
    """Every epoch has a fix."""
    require_consistent: bool
    """The errors do not contradict the filter's sigmas."""
    require: bool
    """The result meets all requirements of the scenario."""


class ReplayArguments(ResultConditions, total=False):
    """Keyword arguments of `replay`."""

    bet: float | PathLike | None
    """Predict the rest of the recording from its part up to this time, s, or test an earlier prediction, a file."""


class RunArguments(ResultConditions, total=False):
    """Keyword arguments of `run`."""

    seed: int
    """Root of all random numbers."""
    runs: int | None
    """Number of runs."""
    first_run: int | None
    """Number of the first run."""
    until: str | None
    """Stop when an interval is narrow enough: `"rms_horizontal within 2%"`."""
    keep: Keep | None
    """Data stored of each run."""
    method: Method | None
    """Replaces the scenario's method."""
    workers: int | None
    """Threads; None: all cores."""
    scheduler: PathLike | None
    """Address or file of the scheduler of a Dask cluster; None: this machine."""


class SweepArguments(ResultConditions, total=False):
    """Keyword arguments of `sweep`; see `RunArguments`."""

    seed: int
    runs: int | None
    """Runs of each combination with method monte-carlo."""
    method: SweepMethod | None
    """Replaces the study's method."""
    workers: int | None
    scheduler: PathLike | None


class OptimizeArguments(Common, total=False):
    """Keyword arguments of `optimize`; see `RunArguments`."""

    seed: int
    runs: int | None
    """Runs of the best placements, 0 for none."""
    workers: int | None
    """Threads of these runs."""
    scheduler: PathLike | None
    time_limit: float | None
    """Stop after this time with the best placement so far, s."""


class FileArguments(TypedDict, total=False):
    """Keyword arguments of `verify`, `evidence` and `import_log`, for their checks."""

    folder: PathLike | None
    output: PathLike | None
    runs: int | None
    workers: int | None
    imu: int
    receiver: int
    force: bool
    progress: Told | None


_LEAST: dict[str | tuple[str, str], int] = {
    "seed": 0, ("optimize", "runs"): 0, ("sweep", "runs"): 0, "runs": 1, "first_run": 0, "workers": 1,
    "imu": 0, "receiver": 0,
}  # fmt: skip
_CHOICES = {"keep": Keep, ("run", "method"): Method, ("sweep", "method"): SweepMethod}
_LONGEST = 1e9
"""Largest time limit, s."""


def spelled(arguments: Any) -> Callable[[F], F]:
    """Decorator: show the keywords of a function with `**given` in its signature, for help() and editors."""

    def shown(function: F) -> F:
        signature = inspect.signature(function)
        first = [p for p in signature.parameters.values() if p.kind is not inspect.Parameter.VAR_KEYWORD]
        hints = arguments.__annotations__
        named = [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=default(name), annotation=_text(hints[name])
            )
            for name in hints
        ]
        function.__signature__ = signature.replace(parameters=[*first, *named])  # type: ignore[attr-defined]
        return function

    return shown


def _text(annotation: Any) -> str:
    return str(getattr(annotation, "__forward_arg__", annotation))


def default(name: str) -> Any:
    """Default of a keyword."""
    return 1 if name == "seed" else None if "None" in _text(_HINTS[name]) else False


_HINTS: dict[str, Any] = {
    name: hint
    for group in (ReplayArguments, RunArguments, SweepArguments, OptimizeArguments, FileArguments)
    for name, hint in group.__annotations__.items()
}


def checked(command: str, arguments: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """All keywords of a command, given or default.

    Raises TypeError for an unknown name, as Python does; BadInput for wrong values.
    """
    names = get_type_hints(arguments)
    for name in given:
        if name not in names:
            raise TypeError(f"{command}() got an unexpected keyword argument {name!r}; it takes {', '.join(names)}")
    out = {name: default(name) for name in names} | dict(given)
    wrong = []
    for name, value in given.items():
        if value is None and default(name) is None:
            continue
        try:
            out[name] = _right(command, name, value)
        except (TypeError, ValueError) as error:
            wrong.append(f"{name}={value!r:.60}: {error}")
    if wrong:
        raise BadInput(as_problems(*wrong))
    return out


def _right(command: str, name: str, value: Any) -> Any:
    """Check and convert a value. Raises TypeError or ValueError that lists the allowed values."""
    from navsim.results.result import MOST_WHOLE

    least = _LEAST.get((command, name), _LEAST.get(name))
    if least is not None:
        words = f"expected a whole number of at least {least}"
        try:
            number = operator.index(value)
        except TypeError:
            raise TypeError(words) from None
        if isinstance(value, bool) or not least <= number <= MOST_WHOLE:
            raise ValueError(words if number <= MOST_WHOLE else f"{words} and at most {MOST_WHOLE}")
        return number
    if name == "time_limit":
        if isinstance(value, bool) or not 0.0 <= float(value) <= _LONGEST:
            raise ValueError(f"expected seconds from 0 to {_LONGEST:g}")
        return float(value)
    choices = _CHOICES.get(name) or _CHOICES.get((command, name))
    if choices is not None:
        if value not in get_args(choices):
            raise ValueError(f"allowed: {', '.join(get_args(choices))}")
        return value
    if name == "bet" and isinstance(value, (int, float)) and not isinstance(value, bool):
        return str(value)
    if name in ("bet", "scheduler"):
        return os.fspath(value)
    if name in ("output", "figures", "folder"):
        return Path(value).expanduser()
    if name == "set":
        if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
            raise TypeError("expected a mapping of dotted keys to values, as {'pseudolites.s_m': 1000}")
        return value
    if name == "until":
        if not isinstance(value, str):
            raise TypeError("expected a text, as 'rms_horizontal within 2%'")
        return value
    if name == "progress":
        if not callable(value):
            raise TypeError("expected a function of (finished, extent, words)")
        return value
    if not isinstance(value, bool):
        raise TypeError("expected True or False")
    return value
