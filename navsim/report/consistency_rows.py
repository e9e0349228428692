"""Rows that compare errors with the filter's sigma."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from navsim.filter.states import display_name, is_sigma_wrong
from navsim.report.result_cells import RANGE, single
from navsim.report.table import ABSENT, Cell, Table, cell
from navsim.results.result import Result


def mean_head(result: Result) -> str:
    """Heading of means per degree of freedom."""
    flown = not single(result) and result.attributes["method"] != "covariance"
    return "1 is right" + (" (95 % band, times inside)" if flown else "")


def unit_mean(result: Result, name: str) -> Cell | str:
    """Mean over time of a consistency series, with the band of one instant."""
    variable = result.variables[f"/summary/consistency/{name}"]
    data = np.asarray(variable.data)
    known = data[np.isfinite(data)]
    if known.size == 0:
        return ABSENT
    mean = float(known.mean())
    if "band_low" not in variable.attributes:
        return cell("{:.3f}  (expected; {:.3f} to {:.3f})", mean, float(known.min()), float(known.max()), names=RANGE)
    if single(result):
        return cell("{:.3f}  (one run, over time)", mean, names=("mean",))
    low, high = (float(variable.attributes[f"band_{end}"]) for end in ("low", "high"))
    inside = 100 * float(np.mean((known >= low) & (known <= high)))
    return cell("{:.3f}  ({:.3f} to {:.3f}, {:.0f} % inside)", mean, low, high, inside,
                names=("mean", "band from", "band to", "inside"))  # fmt: skip


_PAIRS, _MOST_PAIRS = "/summary/consistency/pair", 6


VERDICT, _STATES, _RATIO = "/summary/consistency/verdict", "/summary/consistency/state", "/consistency/z"


def consistency_rows(table: Table, results: Sequence[tuple[str, Result]]) -> None:
    """The consistency test of every state: the verdict, and the worst state of each group whose sigma is wrong."""
    if not any(VERDICT in result for _, result in results):
        return
    table.head("Sigma of every state", *(_band(r) for _, r in results))
    table.add("  all states", *(state_verdict(result) for _, result in results))
    groups = dict.fromkeys(group for _, result in results for group in _state_groups(result))
    for name in groups:
        if any(_is_wrong(result, name) for _, result in results):
            table.add(f"  {name}, largest and least z", *(_worst(result, name) for _, result in results))
    if any(_PAIRS in result and result[_PAIRS].size for _, result in results):
        table.add("  pairs that geometry cannot tell apart", *(_pairs(result) for _, result in results))


def _pairs(result: Result) -> str:
    """Pairs of states whose combination alone is known, with their correlations, the strongest first."""
    if _PAIRS not in result or not result[_PAIRS].size:
        return ABSENT
    each = [f"{pair} ({c:+.4f})" for pair, c in zip(result[_PAIRS], result[f"{_PAIRS}_correlation"], strict=True)]
    more = [f"and {len(each) - _MOST_PAIRS} more"] if len(each) > _MOST_PAIRS else []
    return "\n".join([*each[:_MOST_PAIRS], *more])


def _band(result: Result) -> str:
    """Definition of z and its band, in words."""
    if _RATIO not in result:
        return ""
    low, high = _band_of(result)
    words = "z = RMS of error / σ, 1 is right"
    if single(result) or low == high or math.isnan(low):
        return words
    return f"{words}; 99.9 % band {low:.3f} to {high:.3f}"


def _band_of(result: Result) -> tuple[float, float]:
    """The band of z."""
    attributes = result.variables[_RATIO].attributes
    return float(attributes["band_low"]), float(attributes["band_high"])


def _is_wrong(result: Result, group: str) -> bool:
    """Whether the sigma of a state of a group is wrong."""
    states = _state_groups(result).get(group, [])
    if not states or "tolerance" not in result.variables[VERDICT].attributes:  # of an earlier version
        return False
    worst, least = (result[f"/summary/consistency/{name}_z"][states] for name in ("worst", "least"))
    tolerance = float(result.variables[VERDICT].attributes["tolerance"])
    pairs = zip(worst.tolist(), least.tolist(), strict=True)
    return any(any(is_sigma_wrong(*pair, _band_of(result), tolerance)) for pair in pairs)


def state_verdict(result: Result) -> str:
    """The verdict on every state's sigma."""
    if "/rare/error" in result:
        return "not evaluated by method rare, which shifts its runs"
    if VERDICT not in result or np.ndim(result[VERDICT]):
        return "none: the file is of an earlier version without this test; run it again"
    return str(result[VERDICT])


def _state_groups(result: Result) -> dict[str, list[int]]:
    """The states (numbers) of a result by groups that differ in the axis alone, in words."""
    out: dict[str, list[int]] = {}
    for i, name in enumerate(map(str, result[_STATES]) if _STATES in result else ()):
        stem, _, axis = name.rpartition("_")
        out.setdefault(display_name(stem if axis in _STATE_AXES else name), []).append(i)
    return out


_STATE_AXES = {"north", "east", "down", *"xyz", *"123", *(a + b for a in "xyz" for b in "xyz")}
"""Ends of names of states that are one of three."""


def _worst(result: Result, group: str) -> Cell | str:
    """The largest and least z of a group of states, and how many runs are beyond the limits of a correct sigma."""
    states = _state_groups(result).get(group, [])
    z = result["/summary/consistency/worst_z"][states] if states else np.empty(0)
    if not np.isfinite(z).any():
        return ABSENT
    i = states[int(np.nanargmax(z))]
    value, time = (float(result[f"/summary/consistency/{n}"][i]) for n in ("worst_z", "worst_time"))
    smallest = result["/summary/consistency/least_z"][states]
    j = states[int(np.nanargmin(smallest))]
    least = float(result["/summary/consistency/least_z"][j])
    name, least_name = (display_name(str(result[_STATES][state])) for state in (i, j))
    shares = [f"/summary/consistency/worst_beyond_{limit}" for limit in ("95", "99_9")]
    if single(result):
        return cell("{:.2f}  {}, {:g} s", value, name, time, names=("z", "state", "time"))
    if shares[0] not in result:
        return cell("{:.2f}  {}, {:g} s\nleast z {:.2f}  {}", value, name, time, least, least_name,
                    names=("z", "state", "time", "least z", "state of least z"))  # fmt: skip
    beyond = [100.0 * float(result[path][i]) for path in shares]
    names = ("z", "state", "time", "beyond 1.96σ", "beyond 3.29σ", "least z", "state of least z")
    return cell("{:.3f}  {}, {:g} s\n{:.1f} % > 1.96σ, {:.2f} % > 3.29σ\nleast z {:.3f}  {}",
                value, name, time, *beyond, least, least_name, names=names)  # fmt: skip


def coverage(result: Result, i: int) -> Cell | str:
    if "/summary/coverage/position" not in result:
        return ABSENT
    value, low, high = map(float, 100 * result["/summary/coverage/position"][i])
    expected = 100 * float(result["/summary/coverage/expected"][i])
    if not np.isfinite(low):
        return Cell("{:.1f} %  (Gaussian {:.1f} %)", (value, expected), names=("share", "Gaussian"))
    return Cell("{:.1f} %  [{:.1f}, {:.1f}]  (Gaussian {:.1f} %)", (value, low, high, expected), ends=True,
                names=("share", "", "", "Gaussian"))  # fmt: skip
