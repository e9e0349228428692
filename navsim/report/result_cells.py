"""What several tables and figures say of a landing result."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from navsim.report.table import ABSENT, Cell, cell
from navsim.results.heights import height_names, spoken_height
from navsim.results.result import Result, scenario_of
from navsim.results.schema import HEIGHTS

DEGREE = 180.0 / math.pi


def setting(result: Result, *keys: str) -> Any:
    """A value of the scenario stored in a result, defaults included. Raises KeyError where it has no such key."""
    node = scenario_of(result)
    for key in keys:
        node = node[key]
    return node


def runs_of(result: Result) -> str:
    """Which runs a landing result holds, in words."""
    if result.attributes["method"] == "covariance":
        return "linear covariance analysis"
    numbers, seed = result["/run"], result.attributes["seed"]
    if numbers.size == 1:
        return f"run {numbers[0]}, seed {seed}"
    return f"{numbers.size} runs ({numbers[0]} to {numbers[-1]}), seed {seed}"


def single(result: Result) -> bool:
    """Whether a landing result is one run: a sample that has errors, but no statistics over runs."""
    return result["/run"].size == 1 and result.attributes["method"] != "covariance"


def _accuracy(values: np.ndarray, sigma: np.ndarray, scale: float = 1.0, sign: np.ndarray | None = None) -> Cell:
    """An error with the filter's sigma: of one run without an interval, with its `sign` if given."""
    value, low, high = (float(x) for x in np.asarray(values) * scale)
    assumed = float(sigma) * scale
    if sign is not None:
        shown = float(sign) * scale if np.isfinite(value) else value
        return Cell("{:+.3f}  σ {:.3f}", (shown, assumed), whole=True, names=("error", "σ"))
    if low == high:
        return Cell("{:.3f}  σ {:.3f}", (value, assumed), whole=True, names=("rms", "σ"))
    return Cell("{:.3f}  [{:.3f}, {:.3f}]  σ {:.3f}", (value, low, high, assumed), whole=True, ends=True,
                names=("rms", "", "", "σ"))  # fmt: skip


def late_rms(result: Result, name: str, i: int | None = None, scale: float = 1.0) -> Cell:
    """RMS over the last seconds of an entry of /summary/rms, of its component `i` if it has several."""
    values, sigma = result[f"/summary/rms/{name}"], result[f"/summary/sigma/{name}"]
    if i is not None:
        values, sigma = values[i], sigma[i]
    if single(result):
        values = np.repeat(values[:1], 3)
    return _accuracy(values, sigma, scale)


def error_at(result: Result, name: str, i: int) -> Cell:
    """Error at a height: of one run with its sign, of several the RMS with its interval."""
    sign = result[f"/summary/at/{name}_run"][0, i] if single(result) else None
    return _accuracy(result[f"/summary/at/{name}"][i], result[f"/summary/at/{name}_sigma"][i], sign=sign)


def heights_of(results: Sequence[Result]) -> dict[int, str]:
    """Titles of the heights that any of the results passes, by their index; without those that not all have."""
    found = [result["/summary/at/lateral"] for result in results]
    each = {tuple(height_names(result["/summary/at/height"])) for result in results}
    names = each.pop() if len(each) == 1 else tuple(HEIGHTS)
    return {i: spoken_height(name) for i, name in enumerate(names)
            if any(np.isfinite(each[i]).any() for each in found)}  # fmt: skip


def known_percentiles(result: Result) -> np.ndarray:
    """Which percentiles (p,) bool the result has runs for: at least one run in the mean exceeds them."""
    runs = math.inf if result.attributes["method"] == "covariance" else result["/run"].size
    return np.asarray(runs * (100 - result["/summary/percentile"]) >= 100)


def percentile_cell(result: Result, path: str, i: int | None = None) -> Cell | str:
    """Percentiles over runs, see `known_percentiles`; a result of one run has none, a covariance analysis only those
    at heights."""
    if single(result) or path not in result:
        return ABSENT
    values = result[path] if i is None else result[path][i]
    levels, shown = result["/summary/percentile"], known_percentiles(result)
    if not shown.any() or not np.isfinite(values).all():
        return ABSENT
    pattern = "  ".join("{:.3f}" if each else ABSENT for each in shown)
    return Cell(pattern, tuple(map(float, values[shown])), several=True, names=tuple(f"p{p:g}" for p in levels[shown]))


def names_at(results: Sequence[Result], path: str) -> list[str]:
    """All names at a path of results, each once."""
    return list(dict.fromkeys(str(name) for result in results if path in result for name in result[path]))


def index_of(result: Result, path: str, name: str) -> int | None:
    """Index of a name at a path of a result; None if missing."""
    there = [str(each) for each in result[path]] if path in result else []
    return there.index(name) if name in there else None


RANGE = ("mean", "smallest", "largest")


def share_cell(result: Result, path: str) -> Cell | str:
    """A share with its interval, where the result has it."""
    if path not in result:
        return ABSENT
    if not np.isfinite(result[path][0]):
        return ABSENT
    return over_runs("{:.4g}", result, result[path], "share")


def over_runs(how: str, result: Result, values: np.ndarray, name: str) -> Cell:
    """A number over runs with its interval (3,), if any; for one run the number alone, since one run is no sample."""
    value, low, high = map(float, values)
    if single(result) or not np.isfinite(low):
        return cell(how, value, names=(name,))
    return Cell(f"{how}  [{how}, {how}]", (value, low, high), ends=True, names=(name, "", ""))


def count_cell(result: Result, path: str) -> Cell | str:
    return Cell("{}", (int(result[path]),), trials=result["/run"].size) if path in result else ABSENT
