"""What the functions take beside the file, as keywords: their types, and what of them is right."""

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
"""Takes how much is finished, of how much (0 where that is not known), and where the work stands in words."""


class Common(TypedDict, total=False):
    """Of all that is computed.

    set: values for keys, dotted. output: the result file; None: a temporary one, deleted with the object that is
    returned. figures: the folder for figures; None: none are drawn. fresh: discard partial work of an earlier attempt.
    force: overwrite a result of another sort. over_budget: compute even what this machine seems too small for.
    progress: is told how the work goes on; what it raises ends the work.
    """

    set: Mapping[str, Any] | None
    output: PathLike | None
    figures: PathLike | None
    fresh: bool
    force: bool
    over_budget: bool
    progress: Told | None


class Requiring(Common, total=False):
    """And what the result must be worth; else RunFailed is raised, with the complete result's path.

    require_fix: no epoch without a fix. require_consistent: nothing contradicts what the filter believes. require: all
    requirements of the scenario are met.
    """

    require_fix: bool
    require_consistent: bool
    require: bool


class RunArguments(Requiring, total=False):
    """Of `run`. seed: root of all random numbers. runs: their number; first_run: the number of the first. until: stop
    once an interval is narrow. keep: what is stored of each run. method: instead of the scenario's. workers: threads;
    None: all cores. scheduler: of a Dask cluster that does the work, its address or its file; None: this machine."""

    seed: int
    runs: int | None
    first_run: int | None
    until: str | None
    keep: Keep | None
    method: Method | None
    workers: int | None
    scheduler: PathLike | None


class SweepArguments(Requiring, total=False):
    """Of `sweep`. runs: of each combination with method monte-carlo. method: instead of the study's."""

    seed: int
    runs: int | None
    method: SweepMethod | None
    workers: int | None
    scheduler: PathLike | None


class OptimizeArguments(Common, total=False):
    """Of `optimize`. runs: that the best placements are flown with, 0 for none. time_limit: stop then with the best
    found so far, s."""

    seed: int
    runs: int | None
    scheduler: PathLike | None
    time_limit: float | None


_LEAST: dict[str | tuple[str, str], int] = {
    "seed": 0, ("optimize", "runs"): 0, ("sweep", "runs"): 0, "runs": 1, "first_run": 0, "workers": 1,
}  # fmt: skip
_CHOICES = {"keep": Keep, ("run", "method"): Method, ("sweep", "method"): SweepMethod}
_LONGEST = 1e9
"""Time limit, s."""


def spelled(arguments: Any) -> Callable[[F], F]:
    """Show the keywords of a function, which has them as `**given`, in its signature, for help() and editors."""

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
    """What a keyword is that is not given."""
    return 1 if name == "seed" else None if "None" in _text(_HINTS[name]) else False


_HINTS: dict[str, Any] = {
    name: hint
    for group in (RunArguments, SweepArguments, OptimizeArguments)
    for name, hint in group.__annotations__.items()
}


def checked(command: str, arguments: Any, given: Mapping[str, Any]) -> dict[str, Any]:
    """All keywords of a command with what was given, or what stands for it. Raises TypeError for a name it does not
    take, as Python does; BadInput for wrong values."""
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
    """A value as the work takes it. Raises TypeError, ValueError, saying what is allowed."""
    from navsim.results.result import MOST_WHOLE

    least = _LEAST.get((command, name), _LEAST.get(name))
    if least is not None:
        words = f"expected a whole number from {least} to {MOST_WHOLE}"
        try:
            number = operator.index(value)
        except TypeError:
            raise TypeError(words) from None
        if isinstance(value, bool) or not least <= number <= MOST_WHOLE:
            raise ValueError(words)
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
    if name == "scheduler":
        return os.fspath(value)
    if name in ("output", "figures"):
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
