"""The summary of landings as a table, and of all results as plain data for JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from navsim.filter.states import display_name, is_sigma_wrong
from navsim.report.controlled_rows import controlled_rows
from navsim.report.table import ABSENT, Cell, Table, cell, number, numbers
from navsim.results.result import Result, scenario_of
from navsim.results.schema import HEIGHTS, INDICATED, RMS_WINDOW, RUNWAY_AXES
from navsim.statistics.importance_sampling import LEAST
from navsim.statistics.rounding import digits

FINDINGS = "/findings/"
"""Path of the findings in a result."""
_DEGREE = 180.0 / math.pi


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


def _late(result: Result, name: str, i: int | None = None, scale: float = 1.0) -> Cell:
    """RMS over the last seconds of an entry of /summary/rms, of its component `i` if it has several."""
    values, sigma = result[f"/summary/rms/{name}"], result[f"/summary/sigma/{name}"]
    if i is not None:
        values, sigma = values[i], sigma[i]
    if single(result):
        values = np.repeat(values[:1], 3)
    return _accuracy(values, sigma, scale)


def _at(result: Result, name: str, i: int) -> Cell:
    """Error at a height: of one run with its sign, of several the RMS with its interval."""
    sign = result[f"/summary/at/{name}_run"][0, i] if single(result) else None
    return _accuracy(result[f"/summary/at/{name}"][i], result[f"/summary/at/{name}_sigma"][i], sign=sign)


def _percentiles(result: Result, path: str, i: int | None = None) -> Cell | str:
    """Percentiles over runs; a result of one run has none, a covariance analysis only those at heights."""
    if single(result) or path not in result:
        return ABSENT
    values = result[path] if i is None else result[path][i]
    names = [f"p{level:g}" for level in result["/summary/percentile"].tolist()]
    return numbers(values, 3, names) if np.all(np.isfinite(values)) else ABSENT


def _mean_head(result: Result) -> str:
    """Heading of means per degree of freedom."""
    flown = not single(result) and result.attributes["method"] != "covariance"
    return "1 is right" + (" (95 % band, times inside)" if flown else "")


def _unit_mean(result: Result, name: str) -> Cell | str:
    """Mean over time of a consistency series, with the band of one instant."""
    variable = result.variables[f"/summary/consistency/{name}"]
    data = np.asarray(variable.data)
    known = data[np.isfinite(data)]
    if known.size == 0:
        return ABSENT
    mean = float(known.mean())
    if "band_low" not in variable.attributes:
        return cell("{:.3f}  (expected; {:.3f} to {:.3f})", mean, float(known.min()), float(known.max()), names=_RANGE)
    if single(result):
        return cell("{:.3f}  (one run, over time)", mean, names=("mean",))
    low, high = (float(variable.attributes[f"band_{end}"]) for end in ("low", "high"))
    inside = 100 * float(np.mean((known >= low) & (known <= high)))
    return cell("{:.3f}  ({:.3f} to {:.3f}, {:.0f} % inside)", mean, low, high, inside,
                names=("mean", "band from", "band to", "inside"))  # fmt: skip


def _fixes(result: Result) -> Cell:
    runs, fixes = result["/run"].size, int(result["/summary/count/fixes"])
    if runs > 1:
        return Cell("{}  ({:.6g} per run)", (fixes, fixes / runs), trials=runs, names=("count", "a run"),
                    units=("", "1/run"))  # fmt: skip
    return Cell("{}", (fixes,), trials=runs, names=("count",))


_DELAYING = ("ephemeris", "ionosphere", "troposphere")
_OF_PSEUDOLITES = ("multipath", "air", "survey_error_m", "survey_sigma_m", "clock_sigma_ns", "clock_noise")
"""Keys of `signals`, and of `pseudolites`, with time-correlated ranging errors, if present and not zero."""


def ranging_errors(result: Result) -> str:
    """Whether errors of ranges average out."""
    if _FIX_STATES in result:
        return "not used: fixes have errors of their state"
    signals, pseudolites, receiver = (setting(result, section) for section in ("signals", "pseudolites", "receiver"))
    if "errors" not in signals:  # of an earlier version
        return ABSENT
    values = [kind["sigma_m"] for kind in signals["errors"].values() if kind]
    values += [signals.get(key) for key in _DELAYING]
    if pseudolites["count"] or pseudolites["sites"]:
        values += [pseudolites.get(key) for key in _OF_PSEUDOLITES]
        if pseudolites.get("clock") != "own" or receiver["single_clock"]:
            values.append(pseudolites["clock_offset_ns"])
    if receiver["single_clock"]:
        values += [signals["gps_offset_ns"], signals.get("system_offset_sigma_ns")]
        values += signals.get("system_offsets_ns", {}).values()
    correlated = any(any(value) if isinstance(value, list) else value for value in values)
    if not correlated and receiver["smoothing_s"] == 0.0:
        return "white"
    return "some time-correlated" + ("" if signals["preset"] == "white" else f" ({signals['preset']})")


def _named(results: Sequence[Result], path: str) -> list[str]:
    """All names at a path of results, each once."""
    return list(dict.fromkeys(str(name) for result in results if path in result for name in result[path]))


def _place(result: Result, path: str, name: str) -> int | None:
    """Index of a name at a path of a result; None if missing."""
    there = [str(each) for each in result[path]] if path in result else []
    return there.index(name) if name in there else None


_RANGE = ("mean", "smallest", "largest")
_SOURCES = "/summary/budget/source"
_PAIRS, _MOST_PAIRS = "/summary/consistency/pair", 6
_VERDICT, _STATES, _RATIO = "/summary/consistency/verdict", "/summary/consistency/state", "/consistency/z"


def _consistency(table: Table, results: Sequence[tuple[str, Result]]) -> None:
    """The consistency test of every state: the verdict, and the worst state of each group whose sigma is wrong."""
    if not any(_VERDICT in result for _, result in results):
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
    if not states or "tolerance" not in result.variables[_VERDICT].attributes:  # of an earlier version
        return False
    worst, least = (result[f"/summary/consistency/{name}_z"][states] for name in ("worst", "least"))
    tolerance = float(result.variables[_VERDICT].attributes["tolerance"])
    pairs = zip(worst.tolist(), least.tolist(), strict=True)
    return any(any(is_sigma_wrong(*pair, _band_of(result), tolerance)) for pair in pairs)


def state_verdict(result: Result) -> str:
    """The verdict on every state's sigma."""
    if "/rare/error" in result:
        return "not evaluated by method rare, which shifts its runs"
    if _VERDICT not in result or np.ndim(result[_VERDICT]):
        return "none: the file is of an earlier version without this test; run it again"
    return str(result[_VERDICT])


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


def _sensors(result: Result) -> list[str]:
    """Sensors beside the receiver: runs count their measurements, and in an error budget they are the sources that have
    a section in the scenario."""
    counted = (path.split("/")[3] for path in result.variables if path.startswith("/summary/aiding/"))
    sources = (str(source) for source in result[_SOURCES]) if _SOURCES in result else ()
    names = {*counted, *sources}
    return [name for name, section in setting(result).items() if name in names and section is not None]


def _aiding(result: Result, sensor: str) -> Cell | str:
    """Status of the measurements of a sensor beside the receiver."""
    branch = f"/summary/aiding/{sensor}"
    if f"{branch}/nis" not in result:
        return "propagated to first order" if sensor in _sensors(result) else ABSENT
    counts = (int(result[f"{branch}/{name}"]) for name in ("rejected", "missing"))
    return Cell("{} rejected, {} missing; NIS {:.3f}", (*counts, float(result[f"{branch}/nis"])),
                names=("rejected", "missing", "NIS"), trials=result["/run"].size)  # fmt: skip


_LOSSES = (
    ("Behind terrain", "hidden", True, "/geometry/behind_terrain"),
    ("In the aircraft's shadow", "shadowed", False, "/geometry/shadowed"),
    ("Too weak or jammed", "lost", False, "/interference/js"),
)
"""Causes of lost sources above the mask: section of the table, name, whether to list pseudolites that it never affects,
and path in the result."""


def _taken(result: Result, path: str) -> np.ndarray | None:
    """Number of fix epochs at which each source (s,) is lost to this cause; None if the result lacks it."""
    if path not in result:
        return None
    found = result[path]
    if found.ndim == 1:
        return found
    # jammer to signal ratio, relative to reception without jammers
    lost: np.ndarray = (~np.isnan(found).all(axis=0) & (result["/interference/held"] == 0)).sum(axis=0)
    return lost


def _losses(table: Table, results: Sequence[Result]) -> None:
    """Add causes of lost sources by name, pseudolites first."""
    for title, word, all_of_them, path in _LOSSES:
        counts = [_taken(result, path) for result in results]
        told = [(r, c) for r, c in zip(results, counts, strict=True) if c is not None]
        lost = [str(name) for r, c in told for name, times in zip(r["/geometry/source"], c, strict=True) if times]
        ground = [n for n in _named([r for r, _ in told], "/pseudolites/name") if all_of_them or n in lost]
        if lost or ground:
            table.head(title, *("fix epochs" for _ in results))
        for name in dict.fromkeys([*ground, *lost]):
            table.add(f"  {name}", *(_lost(r, c, name, word) for r, c in zip(results, counts, strict=True)))


def _lost(result: Result, count: np.ndarray | None, name: str, word: str) -> Cell | str:
    """At how many fix epochs a source is lost to something, which takes each (s,) so often."""
    i = _place(result, "/geometry/source", name)
    if i is None or count is None:
        return ABSENT
    return cell("{} of {}", int(count[i]), result["/geometry/time"].size, names=(word, "of"))


_SMALL_SHARE = 0.005
"""Share of the mean square error below which sources are summed."""


def _shares(result: Result, name: str) -> tuple[float, float]:
    """Shares of a source in the horizontal and vertical mean square error; 0 for one that a result lacks."""
    i = _place(result, _SOURCES, name)
    if i is None:
        return 0.0, 0.0
    horizontal, vertical = (float(result[f"/summary/budget/{axis}_share"][i]) for axis in ("horizontal", "vertical"))
    return horizontal, vertical


def source_title(name: str) -> str:
    """Name of a source of error in reports."""
    return (
        name.replace("satellite_lasting_", "time-correlated ")
        .replace("orbit_clock", "orbits, clocks")
        .replace("_", " ")
    )


def _budget_rows(results: Sequence[Result]) -> dict[str, list[str]]:
    """Sources of the error budget by the names of their rows: the largest of any result first, small ones last."""
    largest = {name: max(max(_shares(r, name)) for r in results) for name in _named(results, _SOURCES)}
    order = sorted(largest, key=lambda name: -largest[name])
    out = {source_title(name): [name] for name in order if largest[name] >= _SMALL_SHARE}
    rest = [name for name in order if largest[name] < _SMALL_SHARE]
    return out | ({f"{len(rest)} others, below {100 * _SMALL_SHARE:g} % each": rest} if rest else {})


def _budget(result: Result, names: Sequence[str]) -> Cell | str:
    """Sum of the sources, horizontal and vertical, m, and their share of the mean square, %."""
    found = [i for name in names if (i := _place(result, _SOURCES, name)) is not None]
    if not found:
        return ABSENT
    values = []
    for axis in ("horizontal", "vertical"):
        share = 100.0 * float(np.sum(result[f"/summary/budget/{axis}_share"][found]))
        values += [math.sqrt(float(np.sum(result[f"/summary/budget/{axis}"][found] ** 2))), share]
    names = tuple(f"{axis}{what}" for axis in ("horizontal", "vertical") for what in ("", ", share"))
    return Cell("{:.3f} ({:.1f} %), {:.3f} ({:.1f} %)", tuple(values), names=names)


def _coverage(result: Result, i: int) -> Cell | str:
    if "/summary/coverage/position" not in result:
        return ABSENT
    value, low, high = map(float, 100 * result["/summary/coverage/position"][i])
    expected = 100 * float(result["/summary/coverage/expected"][i])
    if not np.isfinite(low):
        return Cell("{:.1f} %  (Gaussian {:.1f} %)", (value, expected), names=("share", "Gaussian"))
    return Cell("{:.1f} %  [{:.1f}, {:.1f}]  (Gaussian {:.1f} %)", (value, low, high, expected), ends=True,
                names=("share", "", "", "Gaussian"))  # fmt: skip


def outside_box(result: Result) -> np.ndarray:
    """Which runs (r,) of a result end outside its box: of one of an ensemble that one alone."""
    error = result["/summary/box/error_run"]
    within = (result["/summary/box/lower"] <= error) & (error <= result["/summary/box/upper"])
    outside = np.logical_not(within.all(axis=1))
    if "/summary/go_around/time_run" in result:
        outside &= ~(result["/summary/go_around/time_run"] < result["/summary/box/time"])
    return outside


def box_limits(result: Result, axis: int) -> tuple[float, float] | None:
    """The least and the largest error along an axis inside the box, m, if it limits that."""
    low, high = (float(result[f"/summary/box/{end}"][axis]) for end in ("lower", "upper"))
    return (low, high) if math.isfinite(high) else None


def of_total(result: Result) -> bool:
    """Whether a result has a box of total system errors."""
    return "/summary/box/axis_gaussian" in result


def box_head(result: Result, flown: bool) -> str:
    """Heading of the probabilities of leaving a box, with an interval if they come from runs."""
    if "/summary/box/upper" not in result:
        return ""
    interval = " [95 %]" if flown and (result["/run"].size > 1 or "/summary/rare/probability" in result) else ""
    total = ", of total system errors" if of_total(result) else ""
    if setting(result, "box", "error") == "touchdown":
        return f"probability{interval}, where runs touch down"
    height = float(result["/summary/box/height"])
    where = f"{height:g} m above the runway" if height else "at touchdown"
    return f"probability{interval}, {where}{total}"


def box_to_first_order(result: Result, i: int | None) -> Cell | str:
    """The chance that a Gaussian error exceeds its limit; i None: any of them does, at most."""
    chances = result["/summary/box/axis_first_order"]
    value = min(1.0, float(np.nansum(chances))) if i is None else float(chances[i])
    if not np.isfinite(value):
        return ABSENT
    shown = "below {:g}" if value < LEAST else "{:.3g}"
    value = max(value, LEAST)
    if i is None:
        several = np.isfinite(chances).sum() > 1  # the sum is a bound
        text = f"{'at most ' if several else ''}{{:.3g}}  (if Gaussian)" if value > LEAST else shown
        return cell(text, value, names=("probability",))
    where, ends = box_sides(result, i)
    return Cell(f"{shown}  ({where}, if Gaussian)", (value, *ends), names=("probability", *_SIDES[len(ends)]),
                units=("1", *("m" for _ in ends)))  # fmt: skip


_SIDES = {1: ("beyond",), 2: ("from", "to")}
"""Names of the limits of a box, by their number."""


def box_sides(result: Result, i: int) -> tuple[str, tuple[float, ...]]:
    """Sides at which an axis of a box is left: a pattern, and its values."""
    limits = box_limits(result, i)
    assert limits is not None
    low, high = limits
    if i == RUNWAY_AXES.index("along") and "/summary/box/place" in result:
        place = float(result["/summary/box/place"])
        return "outside {:g} to {:g} m from the threshold", (round(low + place, 9), round(high + place, 9))
    return ("beyond {:g} m", (high,)) if low == -high else ("outside {:g} to {:g} m", limits)


def _box(result: Result, i: int | None) -> Cell | str:
    """Probability of leaving the box: from a count, or to first order."""
    if "/summary/box/upper" not in result:
        return ABSENT
    if i is None:
        if "/summary/box/probability" not in result:
            return box_to_first_order(result, None)
        return _of_runs("{:.3g}", result, result["/summary/box/probability"], "probability")
    if box_limits(result, i) is None:
        return ABSENT
    if "/summary/box/axis_probability" in result:
        one = _of_runs("{:.3g}", result, result["/summary/box/axis_probability"][i], "probability")
        where, ends = box_sides(result, i)
        found, pattern = one.values, one.pattern
        names, units = (*one.names, *_SIDES[len(ends)]), (*("1" for _ in found), *("m" for _ in ends))
        of_gaussian = "/summary/box/axis_gaussian"
        chance = float(result[of_gaussian][i]) if of_gaussian in result else math.nan
        if found[0] == 0.0 and math.isfinite(chance):
            shown = "below {:g}" if chance < LEAST else "{:.2g}"
            return Cell(f"{pattern}  ({where}; {shown} if Gaussian)", (*found, *ends, max(chance, LEAST)),
                        ends=one.ends, names=(*names, "Gaussian"), units=(*units, "1"))  # fmt: skip
        return Cell(f"{pattern}  ({where})", (*found, *ends), ends=one.ends, names=names, units=units)
    return box_to_first_order(result, i)


def _share(result: Result, path: str) -> Cell | str:
    """A share with its interval, where the result has it."""
    if path not in result:
        return ABSENT
    if not np.isfinite(result[path][0]):
        return ABSENT
    return _of_runs("{:.4g}", result, result[path], "share")


def _of_runs(how: str, result: Result, values: np.ndarray, name: str) -> Cell:
    """A number over runs with its interval (3,), if any; for one run the number alone, since one run is no sample."""
    value, low, high = map(float, values)
    if single(result) or not np.isfinite(low):
        return cell(how, value, names=(name,))
    return Cell(f"{how}  [{how}, {how}]", (value, low, high), ends=True, names=(name, "", ""))


def _protection(result: Result, name: str) -> Cell | str:
    """A protection level on the glide, with its limit."""
    path = f"/summary/integrity/{name}"
    if path not in result or not np.isfinite(result[path]).all():
        return ABSENT
    mean, low, high = map(float, result[path][:3])
    alert = f"/summary/integrity/{name[0]}al"
    limit = float(result[alert]) if alert in result else np.inf
    if not np.isfinite(limit):
        return Cell("{:.2f}  ({:.2f} - {:.2f})", (mean, low, high), whole=True, names=_RANGE)
    return Cell("{:.2f}  ({:.2f} - {:.2f}), limit {:g}", (mean, low, high, limit), whole=True,
                names=(*_RANGE, "limit"))  # fmt: skip


def _compared(result: Result, name: str) -> Cell | str:
    """A level of another system's form on the glide."""
    path = f"/summary/integrity/{name}"
    if path not in result or not np.isfinite(result[path]).all():
        return ABSENT
    return Cell("{:.2f}  ({:.2f} - {:.2f})", tuple(map(float, result[path][:3])), whole=True, names=_RANGE)


def _level_share(result: Result) -> Cell | str:
    path = "/summary/integrity/level_share"
    return number(float(result[path]), 3) if path in result else ABSENT


def _alarms(result: Result) -> Cell | str:
    if "/summary/integrity/alarms" not in result:
        return ABSENT
    alarms, tested = (int(result[f"/summary/integrity/{name}"]) for name in ("alarms", "tested"))
    return Cell("{} of {}", (alarms, tested), trials=tested, trial="tested epoch", names=("count", "of"))


def _count(result: Result, path: str) -> Cell | str:
    return Cell("{}", (int(result[path]),), trials=result["/run"].size) if path in result else ABSENT


def _range_noise(result: Result) -> Cell | str:
    """Distribution of the ranging noise if it is not the assumed Gaussian."""
    if "/integrity/hpl" not in result:
        return ABSENT
    section = setting(result, "integrity")
    if "error_model" not in section or section["error_model"] == "gaussian":  # earlier version, or as modelled
        return ABSENT
    noise = section["heavy_tailed"]
    core, tail, share = (float(noise[name]) for name in ("core", "tail", "share"))
    return cell("{:g} σ, {:g} σ of {:g} %", core, tail, 100.0 * share, names=("core", "tail", "share"))


def _exclusions(result: Result) -> Cell | str:
    branch = "/summary/integrity/exclusions"
    if branch not in result:
        return ABSENT
    came = [int(result[f"{branch}_{name}"]) for name in ("correct", "wrong", "needless")]
    return Cell("{}: {}, {}, {}", (int(result[branch]), *came), trials=result["/run"].size,
                names=("count", "correct", "wrong", "needless"))  # fmt: skip


def requirements(table: Table, results: Sequence[tuple[str, Result]]) -> None:
    """Add a verdict on each requirement, if any."""
    branch = "/summary/requirements"
    asked = [result for _, result in results if f"{branch}/verdict" in result]
    if not asked:
        return
    found = (f"found{'' if single(result) else ' [95 %]'}" for _, result in results)
    table.head("Requirements", *(f"verdict: {what}; number of runs for a decision" for what in found))
    for statement in dict.fromkeys(str(text) for result in asked for text in result[f"{branch}/statement"]):
        table.add(f"  {statement}", *(_verdict(result, statement) for _, result in results))


def verdicts(results: Sequence[tuple[str, Result]]) -> list[Table | str]:
    """Verdicts on requirements, and on the filter's sigmas if there are runs."""
    out = Table("", ("", *(name for name, _ in results)), caption="Verdicts on requirements")
    requirements(out, results)
    if any(_VERDICT in result for _, result in results):
        out.head("Sigma of every state", *("" for _ in results))
        out.add("  all states", *(state_verdict(result) for _, result in results))
    return [out] if out.rows else []


def _verdict(result: Result, statement: str) -> Cell | str:
    branch = "/summary/requirements"
    text = [] if f"{branch}/verdict" not in result else [str(text) for text in result[f"{branch}/statement"]]
    if statement not in text:
        return ABSENT
    i = text.index(statement)
    word, more = str(result[f"{branch}/verdict"][i]), float(result[f"{branch}/more_runs"][i])
    return verdict_cell(word, result[f"{branch}/value"][i], more, single(result))


def verdict_cell(word: str, interval: np.ndarray, more: float, one_run: bool = False) -> Cell:
    """A verdict on a requirement with the value and its interval (3,), and the number of runs that would decide it."""
    value, low, high = map(float, interval)
    if np.isnan(value):
        return cell("{}: not evaluated by this method", word)
    number = digits(more, 2) if more >= 1e5 else f"{more:.0f}"
    enough = f"; {number} more run{'' if number == '1' else 's'}" if np.isfinite(more) else ""
    if low == high or np.isnan(low) or one_run:
        return cell("{}: {:.4g}" + enough, word, value, names=("verdict", "found"))
    return cell("{}: {:.4g}  [{:.4g}, {:.4g}]" + enough, word, value, low, high,
                names=("verdict", "found", "found, low", "found, high"))  # fmt: skip


_INTEGRITY = {
    "epochs available": "availability",
    "approaches available throughout": "approaches",
    "continuity risk in 15 s": "continuity_risk",
    "hazardously misleading information": "hmi",
}
"""Labels of shares, and their names in the result."""


def _priors(result: Result) -> Cell | str:
    """Fault probabilities assumed by protection levels."""
    if "/integrity/hpl" not in result:
        return ABSENT
    section = setting(result, "integrity")
    if section["method"] == "chi2":
        return ABSENT
    known = [section.get(f"p_{what}") for what in ("satellite", "constellation", "pseudolite")]
    if None in known:  # of an earlier version
        return ABSENT
    own = section.get("p_constellations") or {}
    each = "".join(f", {name} {{:.3g}}" for name in own)
    pattern = ", ".join("{}" if isinstance(one, str) else "{:.3g}" for one in known)  # type of monitoring: a word
    return Cell(pattern + each, (*known, *map(float, own.values())),
                names=("satellite", "system", "pseudolite", *own))  # fmt: skip


def _integrity(table: Table, results: list[tuple[str, Result]]) -> None:
    """Add the results of the monitor of the fixes, or of the filter."""

    def row(label: str, shown: Callable[[Result], Cell | str]) -> None:
        table.add(f"  {label}", *(shown(result) for _, result in results))

    flown = any("/summary/integrity/alarms" in result for _, result in results)
    asked = any("/summary/integrity/hmi" in result for _, result in results)
    methods = [setting(result, "integrity", "method") for _, result in results if "/integrity/hpl" in result]
    whose = {"filter" if method == "filter" else "fixes" for method in methods}
    title = f"Integrity of the {' or the '.join(sorted(whose))} on the glide"
    table.head(title, *("mean (min - max), m" for _ in results))
    for name in ("hpl", "vpl"):
        row(name.upper(), lambda r, n=name: _protection(r, n))  # type: ignore[misc]
    for name in ("lateral", "along"):
        row(f"{name} level, runway axes", lambda r, n=name: _protection(r, f"level_{n}"))  # type: ignore[misc]
    for form, names in (("sbas", ("hpl", "vpl")), ("gbas", ("lpl", "vpl"))):
        if any(f"/summary/integrity/{form}_vpl" in result for _, result in results):
            for name in names:
                row(f"{name.upper()} by the form of {form.upper()}", lambda r, n=f"{form}_{name}": _compared(r, n))  # type: ignore[misc]
    row("share of epochs with levels", _level_share)
    if any(_priors(result) != ABSENT for _, result in results):
        row("prior: satellite, system, pseudolite", _priors)
    if flown:
        row("alarms, of tested epochs", _alarms)
        if any(int(r["/summary/integrity/lost"]) for _, r in results if "/summary/integrity/lost" in r):
            row("alerts without a fix or source", lambda r: _count(r, "/summary/integrity/lost"))
        for name in ("horizontal", "vertical"):
            row(f"{name} error beyond its level", lambda r, n=name: _share(r, f"/summary/integrity/exceeded_{n}"))  # type: ignore[misc]
    if any(_range_noise(result) != ABSENT for _, result in results):
        row("noise of ranges", _range_noise)
    if any("/summary/integrity/innovation_share" in result for _, result in results):
        row("epochs with an innovation alarm", lambda r: _share(r, "/summary/integrity/innovation_share"))
    if any("/summary/integrity/exclusions" in result for _, result in results):
        row("exclusions: right, wrong, needless", _exclusions)
    if any("/summary/integrity/exclusions_available" in result for _, result in results):
        row("exclusions available", lambda r: _share(r, "/summary/integrity/exclusions_available"))
    if asked:
        for label, name in _INTEGRITY.items():
            row(label, lambda r, n=name: _share(r, f"/summary/integrity/{n}"))  # type: ignore[misc]


_LEVEL, _WHOLE, _NO_FAULT, _WORST = "level, m", "in all", "no fault", "worst fault"


def _tails(table: Table, results: list[tuple[str, Result]]) -> None:
    """Add the sampled probability that errors exceed their levels without an alarm."""
    branch = "/integrity/tails"
    rows = [
        (float(at), str(axis))
        for _, result in results
        if f"{branch}/risk" in result
        for at in result[f"{branch}/at"]
        for axis in result[f"{branch}/axis"]
    ]
    if not rows:
        return
    table.head("Beyond the level without an alarm", *("sampled risk [95 %] (effective samples)" for _ in results))
    for at, axis in dict.fromkeys(rows):
        for part in (_LEVEL, _WHOLE, _NO_FAULT, _WORST):
            table.add(f"  {at:g} s, {axis}, {part}", *(_tail(result, at, axis, part) for _, result in results))


def _tail(result: Result, at: float, axis: str, part: str) -> Cell | str:
    """At a time and axis: level; total risk with its allowed value; risk without a fault, or of the worst fault."""
    branch = "/integrity/tails"
    if f"{branch}/risk" not in result or axis not in (axes := list(map(str, result[f"{branch}/axis"]))):
        return ABSENT
    there = np.flatnonzero(result[f"{branch}/at"] == at)
    if not there.size:
        return ABSENT
    e, q = int(there[0]), axes.index(axis)
    level, allowed = float(result[f"{branch}/level"][e, q]), float(result[f"{branch}/allowed"][q])
    risk = result[f"{branch}/risk"][e, q]
    if not np.isfinite(level) or not np.isfinite(risk[1:, 0]).any():
        return ABSENT
    if part == _LEVEL:
        return number(level, 2)
    if part == _WHOLE:
        return Cell("{:.2g}  [{:.2g}, {:.2g}], allowed {:g}", (*map(float, result[f"{branch}/total"][e, q]), allowed),
                    ends=True, names=("risk", "", "", "allowed"))  # fmt: skip
    k = 1 + int(np.nanargmax(risk[1:, 0])) if part == _WORST else 0
    found = (*map(float, risk[k]), float(result[f"{branch}/effective"][e, q, k]))
    if part != _WORST:
        return Cell("{:.2g}  [{:.2g}, {:.2g}]  ({:.0f})", found, ends=True,
                    names=("risk", "", "", "effective samples"))  # fmt: skip
    bias, name = float(result[f"{branch}/bias"][e, q, k]), str(result[f"{branch}/fault"][k])
    names = ("fault", "bias", "risk", "risk, low", "risk, high", "effective samples")
    return Cell("{}, {:.1f} m: {:.2g}  [{:.2g}, {:.2g}]  ({:.0f})", (name, bias, *found), names=names,
                units=("", "m", "1", "1", "1", "1"))  # fmt: skip


_FAMILIES = {"clock_": "receiver clock", "range_error_": "errors of ranges",
             "fix_error_": "errors of fixes", "transmitter_": "errors of pseudolites",
             "gyro_misalignment_": "gyro misalignments",
             "accelerometer_misalignment_": "accelerometer misalignments", "gyro_scale_": "gyro scale factors",
             "accelerometer_scale_": "accelerometer scale factors"}  # fmt: skip
"""Names of further filter states, besides navigation and biases, by their prefix."""


def _further_states(result: Result) -> dict[str, int]:
    """Number of further filter states of each family, besides navigation and biases."""
    names = [str(name) for name in result["/filter/state"]] if "/filter/state" in result else []
    families = _FAMILIES | {f"{name.split('_')[0]}_": name.replace("_", " ") for name in _sensors(result)}
    found = (next((family for begin, family in families.items() if name.startswith(begin)), "") for name in names)
    return dict(Counter(family for family in found if family))


def _uses(result: Result, kind: str) -> bool:
    """Whether the result counts satellites or pseudolites, and any is used."""
    return f"/summary/used/{kind}" in result and bool(result[f"/summary/used/{kind}"][2] > 0.0)


def _used(result: Result, kind: str) -> Cell | str:
    """Numbers of satellites or pseudolites used on the glide."""
    if f"/summary/used/{kind}" not in result:
        return ABSENT
    mean, low, high = map(float, result[f"/summary/used/{kind}"][:3])
    return Cell("{:.1f}  ({:.0f} - {:.0f})", (mean, low, high), whole=True, names=_RANGE)


def _dop(result: Result, path: str) -> Cell | str:
    """Statistics of a DOP on the glide."""
    if path not in result:
        return ABSENT
    mean, low, high = map(float, result[path][:3])
    return Cell("{:.2f}  ({:.2f} - {:.2f})", (mean, low, high), whole=True, names=_RANGE)


_HELPFUL = 0.5
"""Sigma with beacons over that without them up to which the ranges count as the source of a coordinate."""


def _with_beacons(result: Result, axis: str, i: int) -> Cell | str:
    """Sigmas of a coordinate at a height with and without beacons, and whether beacons measure it."""
    if (path := f"/summary/at/{axis}_without_beacons") not in result:
        return ABSENT
    held, without = float(result[f"/summary/at/{axis}_sigma"][i]), float(result[path][i])
    if math.isnan(held):
        return ABSENT
    by = "from beacons" if held <= _HELPFUL * without else "not from beacons"
    return cell("{:.2f} ({:.2f}), {}", held, without, by, names=("with", "without", "source"))


def _mirror(result: Result) -> Cell | str:
    """The mirror solution that fits the ranges best before touchdown, the first of several: how far from the aircraft,
    and its residual."""
    if "/beacons/image_residual" not in result:
        return ABSENT
    events = dict(zip(map(str, result["/truth/event"]), result["/truth/event_time"].tolist(), strict=True))
    airborne = result["/beacons/instant"] < events.get("touchdown", math.inf)
    residual = np.where(airborne, result["/beacons/image_residual"], np.nan)
    if np.isnan(residual).all():
        return "none: the beacons are not in one plane"
    best = int(np.argmax(residual < np.nanmin(residual) + 0.005))  # first of those that fit equally well, as shown
    away = float(result["/beacons/image_height"][best])
    side = "above" if away > 0.0 else "below"
    return cell("{:.0f} m {} the aircraft, fits within {:.2f} m", abs(away), side, float(residual[best]),
                names=("distance", "side", "residual"))  # fmt: skip


def summary_table(results: list[tuple[str, Result]]) -> Table:
    """One table of the summaries, a column a result: names and results in order."""
    table = Table("", ("", *(name for name, _ in results)), caption=_SUMMARY)

    def row(label: str, shown: Any) -> None:
        table.add(label, *(shown(r) for _, r in results))

    def section(title: str, shown: Callable[[Result], str] = lambda _: "") -> None:
        table.head(title, *(shown(r) for _, r in results))

    row("runs", runs_of)
    row("ranging errors", ranging_errors)
    row("fixes", _fixes)
    row("fix epochs without a fix", lambda r: _count(r, "/summary/count/epochs_without_fix"))
    sensors = list(dict.fromkeys(name for _, r in results for name in _sensors(r)))
    if sensors:
        section("Aiding sensors", lambda _: "measurements of all runs")
        for name in sensors:
            row(f"  {name.replace('_', ' ')}", lambda r, n=name: _aiding(r, n))
    if families := list(dict.fromkeys(family for _, r in results for family in _further_states(r))):
        section("Further states of the filter", lambda _: "number")
        for family in families:
            row(f"  {family}", lambda r, f=family: Cell("{}", (_further_states(r).get(f, 0),), names=("count",)))
    if any("/summary/fix_states/share" in r for _, r in results):
        section("States of the fixes", lambda _: "share of time; stationary share; rms height error, m")
        for k, name in enumerate(next(r for _, r in results if "/summary/fix_states/share" in r)[_FIX_STATES]):
            row(f"  {name}", lambda r, k=k: _fix_state(r, k))
    _losses(table, [r for _, r in results])
    section("Geometry on the glide", lambda _: "mean (min - max)")
    for name in ("pdop", "hdop", "vdop", "gdop", "tdop"):
        row("  " + name.upper(), lambda r, n=name: _dop(r, f"/summary/dop/{n}"))
    for name in ("satellites", "pseudolites"):
        if any(_uses(r, name) for _, r in results):
            row(f"  {name} used", lambda r, n=name: _used(r, n))
    for title, end in (("beacons", ""), ("beacons and fix", "_with_sources")):
        for name in ("hdop", "vdop"):
            path = f"/summary/beacons/{name}{end}"
            if any(path in r and np.isfinite(r[path][0]) for _, r in results):
                row(f"  {name.upper()}, {title}", lambda r, p=path: _dop(r, p))
    if any(_FIX_STATES not in r for _, r in results):  # fixes with a state have its errors, not those of ranges
        section("Fix, RMS by its covariance, m", lambda _: "mean on the glide")
        for name in ("horizontal", "vertical", "3d"):
            row(f"  {name}", lambda r, n=name: _fix_rms(r, n))

    def columns(result: Result, value: str) -> str:
        return value + (" [95 %]" if result["/run"].size > 1 else "") + ", σ of the filter"

    # the error at touchdown, which `navsim show` reads, shows whether there was one
    landed = {bool(np.isfinite(r["/summary/at/lateral"][0]).any()) for _, r in results}
    to = " or ".join(words for here, words in ((True, "touchdown"), (False, "the end")) if here in landed)
    section(f"Filter, errors over {RMS_WINDOW:g} s to {to}", lambda r: columns(r, "RMS"))
    for name in ("horizontal", "vertical"):
        row(f"  {name} position, m", lambda r, n=name: _late(r, n))
    for path, axes, unit, scale in (
        ("velocity_ned", ("velocity north", "velocity east", "velocity down"), "m/s", 1.0),
        ("attitude_rpy", ("roll", "pitch", "heading"), "deg", _DEGREE),
    ):
        for i, axis in enumerate(axes):
            row(f"  {axis}, {unit}", lambda r, p=path, i=i, s=scale: _late(r, p, i, s))
    labels = [name.replace("ft", " ft") for name in HEIGHTS]
    section("Filter, position error at height, m", lambda r: columns(r, "truth - estimate" if single(r) else "RMS"))
    for i, label in enumerate(labels):
        for name in ("lateral", "along", "vertical"):
            row(f"  {label}, {name}", lambda r, n=name, i=i: _at(r, n, i))

    if any("/summary/at/vertical_without_beacons" in r for _, r in results):
        section("When may height be trusted? σ of the filter, m", lambda _: "with beacons (without)")
        for i, label in enumerate(labels):
            for name in ("vertical", "lateral"):
                row(f"  {label}, {name}", lambda r, n=name, i=i: _with_beacons(r, n, i))
        row("  mirror solution of the ranges", _mirror)

    controlled_rows(table, results)

    def levels(result: Result) -> str:
        return "" if single(result) else "  ".join(f"{p} %" for p in result["/summary/percentile"]) + " of runs below"

    if not all(single(r) for _, r in results):
        section("Size of the position error, m", levels)
        for name in ("horizontal", "vertical"):
            row(
                f"  {name}, RMS over {RMS_WINDOW:g} s",
                lambda r, n=name: _percentiles(r, f"/summary/rms/{n}_percentile"),
            )
        for i, label in enumerate(labels):
            for name in ("lateral", "along", "vertical"):
                path = f"/summary/at/{name}_percentile"
                row(f"  {label}, {name}", lambda r, p=path, i=i: _percentiles(r, p, i))
    if any("/summary/at/lateral_tse" in r for _, r in results):
        section("System errors at height, m", _of_system_errors)
        for i, label in enumerate(labels):
            for name in ("lateral", "along", "vertical"):
                row(f"  {label}, {name}", lambda r, n=name, i=i: _total(r, n, i))
        _ends(table, results)
    if any("/summary/at/headwind" in r for _, r in results):
        section("Mean wind and airspeed at height")
        for i, label in enumerate(labels):
            for words, name, scale in _WIND:
                row(f"  {label}, {words}", lambda r, i=i, n=name, s=scale: _wind(r, n, i, s))
    if any("/summary/track/rms_smoothed" in r for _, r in results):
        section("Trajectory of the table, smoothed")
        for path, label, scale, digits in (
            ("rms_smoothed", "rms distance from the table, m", 1.0, 2),
            ("specific_force", "largest specific force, m/s2", 1.0, 2),
            ("rate", "largest rate, deg/s", _DEGREE, 1),
        ):
            row(f"  {label}", lambda r, p=path, s=scale, d=digits: _of_track(r, p, s, d))
    boxed = [r for _, r in results if "/summary/box/upper" in r]
    if boxed:
        section("Outside the box", lambda r: box_head(r, "/summary/box/probability" in r))
        row("  any limit exceeded", lambda r: _box(r, None))
        for i, name in enumerate(("lateral", "along", "vertical")):
            row(f"  {name}", lambda r, i=i: _box(r, i))
    if any("/summary/integrity/level_share" in r for _, r in results):
        _integrity(table, results)
        _tails(table, results)
    section("Consistency, mean per degree of freedom", _mean_head)
    counts = sorted(
        {int(r.variables["/summary/consistency/nees"].attributes["degrees_of_freedom"]) for _, r in results}
    )
    row(f"  NEES, {' or '.join(map(str, counts))} states", lambda r: _unit_mean(r, "nees"))
    row("  NEES, position and velocity", lambda r: _unit_mean(r, "nees_position_velocity"))
    row("  NIS", lambda r: _unit_mean(r, "nis"))
    flown = next((r for _, r in results if "/summary/coverage/level" in r), None)
    if flown is not None:
        for i, level in enumerate(flown["/summary/coverage/level"]):
            row(f"  share of position within {level:g}σ", lambda r, i=i: _coverage(r, i))
    _consistency(table, results)
    if sources := _budget_rows([r for _, r in results]):
        shares = "horizontal, vertical, m (share of mean square)"
        section(f"Error budget over the same {RMS_WINDOW:g} s", lambda _: shares)
        for label, names in sources.items():
            row(f"  {label}", lambda r, n=names: _budget(r, n))
    requirements(table, results)
    return table


def _of_track(result: Result, name: str, scale: float, digits: int) -> Cell | str:
    """A number of the smoothed trajectory of a table."""
    path = f"/summary/track/{name}"
    return number(scale * float(result[path]), digits) if path in result else ABSENT


def _of_system_errors(result: Result) -> str:
    """The numbers of `_total`."""
    errors = "navigation, flight-technical, total"
    if single(result):
        return errors
    return f"{errors}: RMS" + ("; correlation" if "/summary/guidance/loop_gap" in result else "")


def _total(result: Result, axis: str, height: int) -> Cell | str:
    """Navigation, flight-technical and total system error at a height; of runs that are steered by their estimates also
    the correlation, about zero, of the first two."""
    path = f"/summary/at/{axis}"
    if f"{path}_tse" not in result:
        return ABSENT
    kinds = ("", "_fte", "_tse")
    one = [float(result[f"{path}{kind}_run"][0, height]) for kind in kinds]
    if single(result):
        found = one
    elif _count(result, "/summary/go_around/count") != ABSENT:
        # the errors of runs that have not gone around before
        every = np.stack([result[f"{path}{kind}_run"][:, height] for kind in kinds])
        landing = every[:, np.isfinite(every).all(axis=0)]
        found = [float(np.sqrt(np.mean(each**2))) if each.size else math.nan for each in landing]
    else:
        found = [float(result[f"{path}{kind}"][height, 0]) for kind in kinds]
    if not np.isfinite(found).all():
        return ABSENT
    if single(result) or "/summary/guidance/loop_gap" not in result:
        return Cell("{:.3f}  {:.3f}  {:.3f}", tuple(found), names=("nse", "fte", "tse"))
    navigation, technical, total = found
    both = (total**2 - navigation**2 - technical**2) / (2.0 * navigation * technical)
    return Cell("{:.3f}  {:.3f}  {:.3f}  {:+.2f}", (*found, both), names=("nse", "fte", "tse", "correlation"))


def _ends(table: Table, results: list[tuple[str, Result]]) -> None:
    """Sizes of total system errors, deviations that pilots see, touchdowns, go-arounds."""

    def row(label: str, shown: Any) -> None:
        table.add(label, *(shown(r) for _, r in results))

    def levels(result: Result) -> str:
        return "  ".join(f"{p} %" for p in result["/summary/percentile"]) + " of runs below"

    def section(title: str, path: str, shown: Callable[[Result], str]) -> bool:
        there = any(path in r for _, r in results)
        if there:
            table.head(title, *(shown(r) if path in r else "" for _, r in results))
        return there

    several = not all(single(r) for _, r in results)
    if several and section("Size of the total system error, m", "/summary/at/lateral_tse_percentile", levels):
        for i, label in enumerate(name.replace("ft", " ft") for name in HEIGHTS):
            for name in ("lateral", "along", "vertical"):
                path = f"/summary/at/{name}_tse_percentile"
                row(f"  {label}, {name}", lambda r, p=path, i=i: _percentiles(r, p, i) if p in r else ABSENT)
    if section("Largest deviation, parts of full scale", "/summary/indicator/localizer_percentile", levels):
        for name in INDICATED:
            for kind, whose in (("", "aircraft"), ("_indicated", "indicated")):
                path = f"/summary/indicator/{name}{kind}"
                row(f"  {name.replace('_', ' ')}, {whose}",
                    lambda r, p=f"{path}_percentile": _percentiles(r, p) if p in r else ABSENT)  # fmt: skip
                row(f"  {name.replace('_', ' ')}, {whose}: runs beyond half scale",
                    lambda r, p=f"{path}_beyond_half": _share(r, p))  # fmt: skip
    if section("Touchdown", "/summary/touchdown/along", lambda r: "value" if single(r) else "mean, sigma"):
        for label, name in (("beyond the threshold, m", "along"), ("right of the centre line, m", "lateral"),
                            ("sink rate, m/s", "sink_rate")):  # fmt: skip
            row(f"  {label}", lambda r, n=name: _touchdown(r, n))
    if section("Go-arounds after an alarm", "/summary/go_around/share", lambda r: f"of {runs_of(r)}"):
        row("  share of runs", lambda r: _share(r, "/summary/go_around/share"))
        row("  height lost, m", lambda r: _percentiles(r, "/summary/go_around/lost_percentile"))
        row("  largest height lost, m", lambda r: _of_go_around(r, "lost_largest"))
        row("  that touch the ground", lambda r: _count(r, "/summary/go_around/touched"))


_FIX_STATES = "/summary/fix_states/state"


def _fix_rms(result: Result, name: str) -> Cell | str:
    """Size of the error of a fix by its covariance, unless fixes have states."""
    return ABSENT if _FIX_STATES in result else number(result[f"/summary/fix/rms_{name}"][0], 2)


def _fix_state(result: Result, k: int) -> Cell | str:
    """Share of a state of the fixes, that of the chain, and its error in height."""
    if _FIX_STATES not in result:
        return ABSENT
    branch = "/summary/fix_states"
    found = result[f"{branch}/share"][k, 0], result[f"{branch}/stationary"][k], result[f"{branch}/rms_vertical"][k]
    return Cell("{:.4f}  {:.4f}  {:.3f}", tuple(map(float, found)), names=("share", "stationary", "height"))


def _touchdown(result: Result, name: str) -> Cell | str:
    """Mean and sigma of a number of touchdowns; of one run the number."""
    path = f"/summary/touchdown/{name}"
    if path not in result or not np.isfinite(mean := float(result[path][0])):
        return ABSENT
    if not np.isfinite(sigma := float(result[f"{path}_sigma"])):
        return number(mean, 2)
    return Cell("{:.2f}  {:.2f}", (mean, sigma), names=("mean", "sigma"))


def _of_go_around(result: Result, name: str) -> Cell | str:
    path = f"/summary/go_around/{name}"
    return number(float(result[path]), 2) if path in result and np.isfinite(result[path]) else ABSENT


_WIND = (
    ("headwind, m/s", "headwind", 1.0), ("wind from the left, m/s", "crosswind", 1.0),
    ("airspeed, m/s", "airspeed", 1.0), ("crab, deg", "crab", _DEGREE),
)  # fmt: skip
"""Rows of the wind triangle: heading, variable, and factor to its unit."""


def _wind(result: Result, name: str, height: int, scale: float) -> Cell | str:
    """A number of the wind triangle at a height."""
    path = f"/summary/at/{name}"
    value = scale * float(result[path][height]) if path in result else math.nan
    return number(value, 2) if math.isfinite(value) else ABSENT


def glance(result: Result) -> list[tuple[str, Cell | str]]:
    """Key figures of a landing from its tables, with their intervals."""
    if result.attributes["method"] == "rare":
        value, low, high = map(float, result["/summary/rare/probability"])
        chance = Cell("{:.3g}  [{:.3g}, {:.3g}]", (value, low, high), ends=True, names=("probability", "", ""))
        if not np.isfinite(value):
            chance = cell("below {:.2g}", high)
        effective = cell("{:.0f}", float(result["/summary/rare/effective_samples"]))
        return [("outside the box", chance), ("effective samples", effective), ("pushed runs", runs_of(result))]
    dops = tuple(map(float, result["/summary/dop/pdop"][:3]))
    out: list[tuple[str, Cell | str]] = [
        (f"horizontal RMS over {RMS_WINDOW:g} s, m", _late(result, "horizontal")),
        (f"vertical RMS over {RMS_WINDOW:g} s, m", _late(result, "vertical")),
        ("lateral at touchdown, m", _at(result, "lateral", 0)),
        ("PDOP on the glide", Cell("{:.2f}  ({:.2f} - {:.2f})", dops, names=_RANGE)),
        ("NEES per state", _unit_mean(result, "nees")),
        ("sigma of each state", state_verdict(result)),
    ]
    if "/summary/box/upper" in result:
        out.append(("outside the box", _box(result, None)))
    if "/summary/integrity/availability" in result:
        out.append(("epochs available", _share(result, "/summary/integrity/availability")))
    return out


_SUMMARY = (
    "Landings. The names of rows and of their groups contain the units. In brackets [low, high]: 95 % intervals over "
    "runs. σ: the filter's own, root mean square. Lateral, along and vertical are axes of the runway"
)
"""Caption of the table of landings."""
LONG = ("/summary/consistency/time",)
"""In the summary of a file, but no summary."""


def plain_tree(result: Result, prefixes: tuple[str, ...]) -> dict[str, Any]:
    """The variables whose paths start with one of the prefixes as nested plain data; nan becomes null."""
    out: dict[str, Any] = {}
    for path, variable in result.variables.items():
        if path.startswith(prefixes) and path not in LONG:
            node = out
            *groups, name = path.strip("/").split("/")
            for group in groups:
                node = node.setdefault(group, {})
            node[name] = _plain(np.asarray(variable.data))
    return out


def _plain(data: np.ndarray) -> Any:
    """Arrays as nested lists of plain numbers and text; values that are not finite become None."""
    if data.ndim:
        return [_plain(np.asarray(d)) for d in data]
    value = data.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
