"""A sweep's result, combination by combination."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from navsim.results.result import Result
from navsim.results.schema import SWEEP_QUANTITIES, VERDICTS

VERDICT = "_verdict"
"""Suffix of outputs that are verdicts on requirements."""
_REQUIREMENT = re.compile(r"requirement_(\d+)")


def outputs(result: Result) -> list[str]:
    """Outputs of a sweep in the order of the layout.

    Quantities come first, each followed by the ends of its interval, then requirements by their numbers, then unknown
    ones. A file has its variables in alphabetical order.
    """
    found = [path.split("/")[2] for path in result.variables if path.startswith("/sweep/") and path.count("/") == 2]
    order = list(SWEEP_QUANTITIES)
    ends = ("_low", "_high", VERDICT)

    def place(name: str) -> tuple[int, int, str, int]:
        end = next((i for i, each in enumerate(ends, 1) if name.endswith(each)), 0)
        stem = name.removesuffix(ends[end - 1]) if end else name
        if stem in order:
            return order.index(stem), 0, "", end
        asked = _REQUIREMENT.fullmatch(stem)
        return (len(order) + 1, 0, stem, end) if asked is None else (len(order), int(asked[1]), "", end)

    return sorted(found, key=place)


def dimensions(result: Result) -> tuple[str, ...]:
    """Names of the axes, slowest first."""
    return result.variables[f"/sweep/{outputs(result)[0]}"].dims


def keys(result: Result) -> dict[str, str]:
    """Names of the varied keys and the axis each belongs to, in order."""
    found = {p.split("/")[3]: v.dims[0] for p, v in result.variables.items() if p.startswith("/sweep/axes/")}
    order = dimensions(result)
    return dict(sorted(found.items(), key=lambda item: order.index(item[1])))


def key_path(result: Result, key: str) -> str:
    """A varied key as the scenario has it, dotted."""
    return result.variables[f"/sweep/axes/{key}"].long_name.removeprefix("values of ")


def setting(result: Result, key: str, index: tuple[int, ...]) -> object:
    """The value of a varied key at one combination."""
    dims = dimensions(result)
    return result[f"/sweep/axes/{key}"][index[dims.index(keys(result)[key])]]


def heads(result: Result) -> list[str]:
    """The heads of columns: varied keys, then outputs, which end with their units."""
    units = {name: result.variables[f"/sweep/{name}"].units for name in outputs(result)}
    own = (name if unit == "1" or name.endswith(f"_{unit}") else f"{name}_{unit}" for name, unit in units.items())
    return [*keys(result), *own]


def rows(result: Result) -> Iterator[tuple[tuple[int, ...], list[object]]]:
    """Index of each combination in the cubes, and its values in the columns of `heads`."""
    names, columns = list(keys(result)), outputs(result)
    cubes = [result[f"/sweep/{name}"] for name in columns]

    def text(name: str, value: object) -> object:
        return VERDICTS[int(str(value))] if name.endswith(VERDICT) else value

    for i in np.ndindex(*cubes[0].shape):
        yield i, [*(setting(result, name, i) for name in names), *map(text, columns, (cube[i] for cube in cubes))]
