"""Data of figures: computed once, for those drawn by matplotlib and those of the page.

Times are in s, lengths in m, as in the result.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from navsim.filter.states import display_name
from navsim.formats.export import choose_run, state_units
from navsim.formats.export_maps import true_antenna
from navsim.formats.simulated_log import FIX_ERROR, RANGE_ERROR
from navsim.geodesy.earth import ecef_from_llh, in_heading_axes, ned_matrix, unwrap_longitude
from navsim.geodesy.indicator import Indicator, aircraft_and_estimate
from navsim.report.result_cells import runs_of, setting
from navsim.results.result import Result, ResultError, Stream
from navsim.results.schema import INDICATED
from navsim.statistics import chi_square

START = 0.1
"""Fraction of a time axis at its start that sets no limits: the initial transient would dwarf the rest."""
INSTANTS = 150
"""Most instants at which figures show all runs."""
MOST_NUMBERS = 60_000_000
"""Most numbers of all runs in memory at once."""
MOST_RUNS = 50
"""Largest number of runs of an ensemble that are drawn individually."""
NO_FIX, ALARM = 0, 3
"""`/integrity/status` without a fix, and with an alarm."""
LEVELS = (("horizontal", "hpl", "hal"), ("vertical", "vpl", "val"))
"""Axes, and the names of their protection levels and alert limits."""
_BINS = 60
_STATES: tuple[tuple[str, str, float], ...] = (
    ("position", "m", 1.0),
    ("velocity", "m/s", 1.0),
    ("attitude", "deg", 180.0 / np.pi),
    ("gyro bias", "deg/h", 180.0 / np.pi * 3600.0),
    ("accel. bias", "mg", 1e3 / 9.80665),
)
"""Triads of the states, their units and scales."""


def settled(time: np.ndarray) -> np.ndarray:
    """Which times (t,) lie behind the start."""
    return time >= time[0] + START * (time[-1] - time[0])


def in_runway_axes(result: Result, llh: np.ndarray) -> np.ndarray:
    """Positions (n, 3): along (positive beyond it) and right in the threshold's tangent plane, height above it, m."""
    heading = np.radians(setting(result, "runway", "heading_deg"))
    return about_threshold(llh, result["/truth/threshold_llh"], heading)


def about_threshold(llh: np.ndarray, threshold: np.ndarray, heading: float) -> np.ndarray:
    """Positions (n, 3), latitude, longitude, rad, height, m, relative to a threshold (3,) and its heading, rad.

    Returns along and right in its tangent plane, and the difference of heights above the ellipsoid, m. The plane itself
    is 31 m off in 20 km.
    """
    flat = in_heading_axes(ecef_from_llh(llh), threshold, heading)
    return np.column_stack([flat[:, :2], llh[:, 2] - threshold[2]])


def event_time(result: Result, name: str) -> float:
    """Time of an event of the flight, s; nan if there is none of the name."""
    names = list(result["/truth/event"])
    return float(result["/truth/event_time"][names.index(name)]) if name in names else np.nan


def touchdown(result: Result) -> float:
    """When the aircraft touches down, s; nan where it does not."""
    return event_time(result, "touchdown")


def whose(result: Result) -> str:
    """Whose levels and errors `/integrity` has."""
    return "filter" if setting(result, "integrity", "method") == "filter" else "fix"


def true_for(result: Result) -> str:
    """Note of a figure of the truth about the runs to which it belongs."""
    runs = result["/run"].size
    if "/summary/at/lateral_fte" in result:
        return "the route, from which each run deviates"
    return f"the truth, which all {runs} runs share" if runs > 1 else ""


def fix_errors(result: Result) -> np.ndarray:
    """Fixes minus the antenna's true positions, NED, m: (run, e, 3); nan without a fix."""
    own = "/receiver/true_position_llh"
    true = ecef_from_llh(result[own]) if own in result else true_antenna(result)
    difference = ecef_from_llh(result["/receiver/position_llh"]) - true
    here = np.stack([np.interp(result["/receiver/time"], result["/truth/time"], column)
                     for column in unwrap_longitude(result["/truth/position_llh"]).T], axis=1)  # fmt: skip
    return np.einsum("eij,rej->rei", ned_matrix(here), difference)


def some_fix_errors(result: Result, most: int) -> np.ndarray:
    """About `most` of the horizontal errors of fixes, north and east, m (n, 2), of all runs alike."""
    error = fix_errors(result).reshape(-1, 3)
    error = error[np.isfinite(error[:, 0])]
    # a step that has no divisor in common with the epochs of a run
    step = max(1, len(error) // most)
    while np.gcd(step, result["/receiver/time"].size) > 1:
        step += 1
    return error[::step, :2]


SHARE_95 = 5.991
"""Square of the radius, in sigmas, of the circle that holds 95 % of a Gaussian of two dimensions: -2 ln 0.05."""


def ellipse(covariance: np.ndarray) -> np.ndarray:
    """The ellipse (2, 181) that holds 95 % of a Gaussian with this covariance (2, 2)."""
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = np.sqrt(SHARE_95) * np.stack([np.cos(angle), np.sin(angle)])
    return np.linalg.cholesky(covariance) @ circle


def blocks(result: Result, path: str) -> Iterator[np.ndarray]:
    """A variable along its first axis block by block, as stored: an ensemble need not fit into memory."""
    data = result.variables[path].data
    yield from data.blocks() if isinstance(data, Stream) else [np.asarray(data)]


def rms_over_runs(result: Result, path: str) -> np.ndarray:
    """Root mean square over runs (t, n)."""
    total = sum(np.sum(block**2, axis=0) for block in blocks(result, path))
    return np.sqrt(total / result["/run"].size)


def first_runs(result: Result, path: str, most: int = MOST_RUNS) -> np.ndarray:
    """Runs that are drawn individually (r, t, n)."""
    found: list[np.ndarray] = []
    for block in blocks(result, path):
        found.append(block[: most - sum(len(b) for b in found)])
        if sum(len(b) for b in found) >= most:
            break
    return np.concatenate(found)


def affordable_instants(result: Result, most: int = INSTANTS) -> int:
    """`most` instants, or as many as three numbers of each run have room for in memory."""
    return min(most, max(20, MOST_NUMBERS // (3 * result["/run"].size)))


def come_down(result: Result) -> float:
    """When the aircraft touches down, or goes around, s; nan where it does neither."""
    landed = touchdown(result)
    return event_time(result, "go_around") if np.isnan(landed) else landed


def heights(result: Result) -> np.ndarray:
    """True heights above the threshold at the times of the filter (t,), m."""
    up = in_runway_axes(result, result["/truth/position_llh"])[:, 2]
    return np.interp(result["/filter/time"], result["/truth/time"], up)


def descent(result: Result) -> np.ndarray:
    """The filter's outputs from where the aircraft leaves its level to touchdown, to a go-around, or to the end; their
    numbers."""
    time, height, landed = result["/filter/time"], heights(result), come_down(result)
    until = time <= landed if np.isfinite(landed) else np.full(time.size, True)
    begin = int(np.flatnonzero(until & (height >= height[until].max() - 0.5))[-1])
    return np.flatnonzero(until & (np.arange(time.size) >= begin))


@dataclass(frozen=True)
class RunwayErrors:
    """Position errors, truth minus estimate, right of, along and above the runway axes, m."""

    runs: np.ndarray
    """(r, w, 3) of the first runs; empty for a covariance analysis."""
    rms: np.ndarray | None
    """(w, 3) over all runs, or true; None if unknown."""
    sigma: np.ndarray | None
    """(w, 3) filter sigma. None if the runway is oblique to the map's axes, along which the file has the sigmas."""


def runway_errors(result: Result, at: np.ndarray, most: int) -> RunwayErrors:
    """At some outputs (w,), their numbers; of as many runs as `most`. Raises KeyError for a result without history."""
    heading = math.radians(setting(result, "runway", "heading_deg"))
    s, c = math.sin(heading), math.cos(heading)
    turn = np.array([[-s, c, 0.0], [c, s, 0.0], [0.0, 0.0, -1.0]])
    axes = np.round(np.abs(turn))
    straight = bool(np.isclose(np.abs(turn), axes, atol=1e-9).all())
    sigma = rms_over_runs(result, "/filter/sigma")[at][:, :3] @ axes.T if straight else None
    if "/filter/error" not in result:
        true = result["/covariance/rms"][at][:, :3] @ axes.T if straight else None
        return RunwayErrors(np.empty((0, at.size, 3)), true, sigma)
    total, runs, room = np.zeros((at.size, 3)), list[np.ndarray](), most
    for block in blocks(result, "/filter/error"):
        here = block[:, at, :3] @ turn.T
        total += np.sum(here**2, axis=0)
        runs.append(here[:room])
        room -= len(runs[-1])
    return RunwayErrors(np.concatenate(runs), np.sqrt(total / result["/run"].size), sigma)


PERCENTS = (2.5, 25.0, 50.0, 75.0, 97.5)
"""Percentiles of the values of all runs, with their signs."""


@dataclass(frozen=True)
class IndicatedDeviations:
    """Deviations of runs from localizer and glide path along the descent, in parts of full scale."""

    height: np.ndarray
    """(w,) of the route above the runway, m."""
    aircraft: np.ndarray
    """(5, w, 2) `PERCENTS` over runs that have not gone around."""
    estimate: np.ndarray
    """(5, w, 2) likewise, of the estimate: what the pilot sees."""
    required: dict[str, list[float]]
    """Required sizes by deviation."""

    def reach(self, i: int) -> float:
        """Largest deviation to show, with half scale."""
        largest = max(float(np.nanmax(np.abs(each[:, :, i]))) for each in (self.aircraft, self.estimate))
        return 1.15 * max(0.5, largest, *(self.required[INDICATED[i]] or [0.0]))


def indicated_deviations(result: Result, most: int = INSTANTS) -> IndicatedDeviations | None:
    """At so many at most of the outputs at which deviations count; None for a result without them."""
    if "/summary/indicator/from_time" not in result or "/filter/deviation_lateral" not in result:
        return None
    time = result["/filter/time"]
    first, last = (float(result[f"/summary/indicator/{end}_time"]) for end in ("from", "until"))
    at = np.flatnonzero((time >= first) & (time <= last))
    at = at[:: max(1, -(-at.size // affordable_instants(result, most)))]
    scales = (
        float(result[f"/summary/indicator/scale_{name}"])
        for name in ("origin", "aim", "width", "angle", "share", "foot")
    )
    shown, touchdown_llh = Indicator(*scales), result["/summary/indicator/touchdown_llh"]
    heading = math.radians(setting(result, "runway", "heading_deg"))
    time = time[at]
    ecef = ecef_from_llh(result["/truth/position_llh"])
    route = np.stack([np.interp(time, result["/truth/time"], column) for column in ecef.T], axis=1)
    route = in_heading_axes(route, touchdown_llh, heading)
    parts = (blocks(result, f"/filter/deviation_{axis}") for axis in ("lateral", "along", "vertical"))
    off = np.stack([np.concatenate([block[:, at] for block in part]) for part in parts], axis=-1)
    if "/summary/go_around/time_run" in result:
        off[time >= result["/summary/go_around/time_run"][:, None]] = np.nan
    error = runway_errors(result, at, result["/run"].size).runs
    both = aircraft_and_estimate(off, error, setting(result, "approach", "guidance") == "estimate")
    aircraft, estimate = (_percentiles(shown.along_route(route, own)) for own in both)
    asked = setting(result, "requirements") or []
    required = {name: [float(one["within"]) for one in asked if one["what"] == name] for name in INDICATED}
    return IndicatedDeviations(heights(result)[at], aircraft, estimate, required)


def _percentiles(runs: np.ndarray) -> np.ndarray:
    """`PERCENTS` (5, w, n) over runs (r, w, n) that have a value; nan where none has."""
    out, known = np.full((len(PERCENTS), *runs.shape[1:]), np.nan), np.isfinite(runs).any(axis=0)
    out[:, known] = np.nanpercentile(runs[:, known], PERCENTS, axis=0)
    return out


@dataclass(frozen=True)
class DisplayedState:
    """Display of a filter state: name of its row of three, unit, factor, and axis."""

    row: str
    unit: str
    scale: float
    axis: str

    @property
    def label(self) -> str:
        """The row with its unit, where it has one."""
        return f"{self.row}, {self.unit}" if self.unit else self.row


_TRIPLES = ("x y z", "xy yz zx", "xz yx zy", "north east down", "1 2 3")
"""Ends of the names of three states that make a row."""


def followed(names: list[str], units: list[str]) -> list[DisplayedState]:
    """Display of the states of a filter, three a row; names, units: as the result has them."""
    out: list[DisplayedState] = []
    while len(out) < len(names):
        i = len(out)
        first = names[i]
        stem, axes = first.rpartition("_")[0], [name.rpartition("_")[2] for name in names[i : i + 3]]
        triple = i < 3 * len(_STATES) or (names[i + 1 : i + 2] and names[i + 1].startswith(stem))
        if not triple or " ".join(axes) not in _TRIPLES:
            unit = "prior σ" if first.startswith(RANGE_ERROR) else units[i]
            out.append(DisplayedState(display_name(first), unit, 1.0, ""))
            continue
        # errors of fixes begin with a variance of 1
        prior, unit = first.startswith(FIX_ERROR), units[i].replace("uT", "µT")
        scale = ("prior σ", 1.0) if prior else ("ppm", 1e6) if unit == "1" else (unit, 1.0)
        label = display_name(stem).replace("accelerometer", "accel.")
        row = _STATES[i // 3] if i < 3 * len(_STATES) else (label, *scale)
        out += [DisplayedState(*row, axis) for axis in axes]
    return out


def followed_by(result: Result) -> list[DisplayedState]:
    """Display of the states of the filter of a result."""
    return followed([str(name) for name in result["/filter/state"]], state_units(result))


def shares(result: Result, states: list[int]) -> np.ndarray:
    """Shares of the sources of errors in the mean square error of these states (source, t), %."""
    share = (result["/budget/rms"] ** 2)[:, :, states].sum(axis=2)
    return 100.0 * share / np.maximum(share.sum(axis=0), np.finfo(float).tiny)


def limit(result: Result, name: str) -> float:
    """An alert limit of a landing, m; inf for none."""
    path = f"/summary/integrity/{name}"
    return float(result[path]) if path in result else np.inf


def limits_over_time(result: Result, name: str) -> np.ndarray:
    """An alert limit at each epoch (e,), m; inf for none."""
    path = f"/integrity/{name}"
    return result[path] if path in result else np.full(result["/integrity/time"].size, limit(result, name))


def largest_errors(result: Result, axis: str) -> np.ndarray:
    """Largest error of the fixes of all runs (e,), nan without fixes."""
    largest = np.full(result["/integrity/time"].size, -np.inf)
    for block in blocks(result, f"/integrity/error_{axis}"):
        largest = np.fmax(largest, np.fmax.reduce(block, axis=0))
    return np.where(np.isfinite(largest), largest, np.nan)


def alarms(result: Result, of: int = ALARM) -> np.ndarray:
    """Epochs at which a run has an alarm, or another status, their numbers."""
    return np.flatnonzero(sum((block == of).any(axis=0) for block in blocks(result, "/integrity/status")))


@dataclass(frozen=True)
class Stanford:
    """Counts of a Stanford diagram."""

    edges: np.ndarray
    """(b + 1,) of both axes, m."""
    counts: np.ndarray
    """Epochs (error, level)."""
    limit: float
    """Alert limit, inf for none."""
    top: float
    """End of the axes."""

    def regions(self) -> list[tuple[float, float, str]]:
        """Names and positions of the regions; empty without a limit."""
        most, top = self.limit, self.top
        if not math.isfinite(most):
            return []
        return [
            (0.25 * most, 0.75 * most, "nominal"),
            (0.72 * most, 0.25 * most, "misleading"),
            (0.5 * (most + top), 0.5 * most, "hazardous"),
            (0.5 * most, 0.5 * (most + top), "unavailable"),
        ]

    def within(self, name: str, x: float, y: float) -> bool:
        """Whether an error and a level belong to a region."""
        most = self.limit
        if name == "unavailable":
            return y > 1.08 * most
        if name == "hazardous":
            return x > most and y < 0.94 * most
        return y < 0.94 * most and (x < y if name == "nominal" else y < x < most)


def stanford(result: Result, axis: str, level: str, name: str) -> Stanford:
    """Stanford diagram of an axis of `LEVELS`, from epochs of the glide without an alarm."""
    time = result["/integrity/time"]
    # as the summary counts them: a path without a start of a glide is on it from the beginning
    flying = ~((time < event_time(result, "glide_start") - 1e-9) | (time > touchdown(result) + 1e-9))
    values = result[f"/integrity/{level}"]
    most = limit(result, name)
    # where limits grow, errors and levels are drawn relative to the limit of their epoch
    growth = limits_over_time(result, name) / most if np.isfinite(most) else 1.0
    top = 1.5 * most if np.isfinite(most) else 1.2 * float(np.max(values, where=np.isfinite(values), initial=1.0))
    edges = np.linspace(0.0, top, _BINS + 1)
    counts = np.zeros((_BINS, _BINS))
    own = f"/integrity/{level}_run"  # after exclusions
    errors, codes = (blocks(result, f"/integrity/{path}") for path in (f"error_{axis}", "status"))
    of_runs = blocks(result, own) if own in result else itertools.repeat(values)
    for error, status, one in zip(errors, codes, of_runs, strict=False):
        shown = np.isfinite(error) & np.isfinite(one) & (status != ALARM) & flying
        of_shown = np.broadcast_to(one / growth, error.shape)[shown]
        # points outside the axes are counted at the border
        counts += np.histogram2d(np.minimum((error / growth)[shown], top), np.minimum(of_shown, top), [edges, edges])[0]
    return Stanford(edges, counts, most, top)


def stanford_text(result: Result) -> str:
    """Epochs that a Stanford diagram counts."""
    return (
        f"{runs_of(result)}; epochs {_span(result)} by error and level, without those with an alarm; values outside "
        "the axes are drawn at the border"
        + "; both are scaled by the alert limit at the threshold over that of their epoch"
        * ("/integrity/hal" in result)
    )


def _span(result: Result) -> str:
    """Part of a flight in a Stanford diagram, in words."""
    begun, landed = (np.isfinite(event_time(result, name)) for name in ("glide_start", "touchdown"))
    if begun:
        return f"of the glide alone, from its start to {'touchdown' if landed else 'the end of the flight'},"
    return "until touchdown" if landed else "of the whole flight, which has no glide"


@dataclass(frozen=True)
class StateRatios:
    """Maps of ratios of errors to sigma.

    z: (n, m) of each state between edges (m + 1,) in time, s, the one furthest from 1. limit: of the colours, which
    reach from 1 / limit to limit, of one run (alone) from 0.
    """

    names: list[str]
    edges: np.ndarray
    z: np.ndarray
    limit: float
    alone: bool

    @property
    def label(self) -> str:
        """Description of the map."""
        return "error / σ" if self.alone else "z, RMS of error / σ"


def state_ratios(result: Result, most: int) -> StateRatios:
    """The ratios of a result for a map of no more columns than `most`."""
    z, time = result["/consistency/z"], result["/consistency/time"]
    step = max(1, -(-time.size // most))
    first = np.arange(0, time.size, step)
    padded = np.pad(z, ((0, first.size * step - time.size), (0, 0)), constant_values=np.nan)
    blocks = padded.reshape(first.size, step, z.shape[1])
    alone = result["/run"].size == 1 and result.attributes["method"] != "covariance"
    with np.errstate(divide="ignore", invalid="ignore"):
        off = blocks if alone else np.abs(np.log(blocks))
    chosen = np.where(np.isnan(off), -1.0, off).argmax(axis=1)
    shown = np.take_along_axis(blocks, chosen[:, None], axis=1)[:, 0]
    known = shown[np.isfinite(shown) & (shown > 0.0)]
    if alone:
        limit = max(3.0, float(result.variables["/consistency/z"].attributes["band_high"]))
    else:
        limit = float(np.clip(np.exp(np.abs(np.log(known)).max(initial=0.0)), 1.25, 2.0))
    edges = np.append(time[first], 2.0 * time[-1] - time[-2] if time.size > 1 else time[-1] + 1.0)
    names = [display_name(str(name)) for name in result["/consistency/state"]]
    return StateRatios(names, edges, shown.T, limit, alone)


def one_run(result: Result, number: int) -> Result:
    """Result of one run of an ensemble, with its own squared errors and innovations instead of those of all runs.

    Raises ResultError for a run that it does not contain, or if its figures are of one flight.
    """
    if "/run" not in result:
        raise ResultError(f"--run {number}: a result of kind {result.attributes['kind']} has no runs")
    if result.attributes.get("method") == "covariance":
        raise ResultError(f"--run {number}: a covariance analysis has no runs")
    chosen, _ = choose_run(result, number)
    variables = dict(chosen.variables)
    variables.pop("/consistency/z", None)  # of all runs together
    for name, path in (("nees", "nees"), ("nees_position_velocity",) * 2, ("nis", "innovation_squared")):
        mean, own = f"/summary/consistency/{name}", f"/filter/{path}"
        if mean not in chosen or own not in chosen or (name == "nis" and "/filter/range_status" in chosen):
            variables.pop(mean, None)
            continue
        degrees = int(variables[own].attributes["degrees_of_freedom"])
        values = chosen[own][0] / degrees
        if name == "nis":  # at fix epochs, none of which is at time 0
            values = np.append(np.full(chosen["/summary/consistency/time"].size - values.size, np.nan), values)
        band = {
            f"band_{end}": chi_square.quantile(p, degrees) / degrees for end, p in (("low", 0.025), ("high", 0.975))
        }
        variables[mean] = replace(variables[mean], data=values, attributes=variables[mean].attributes | band)
    return Result(chosen.attributes, variables)
