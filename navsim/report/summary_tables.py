"""The summary of landings as a table."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from navsim.report.box_rows import box_cell, box_head
from navsim.report.budget_rows import SOURCES, budget_cell, budget_rows
from navsim.report.consistency_rows import consistency_rows, coverage, mean_head, state_verdict, unit_mean
from navsim.report.controlled_rows import controlled_rows
from navsim.report.ending_rows import ending_rows, system_error_heading, total_error
from navsim.report.integrity_rows import integrity_rows, tail_rows
from navsim.report.requirement_rows import requirements
from navsim.report.result_cells import (
    DEGREE,
    RANGE,
    count_cell,
    error_at,
    heights_of,
    index_of,
    late_rms,
    names_at,
    percentile_cell,
    runs_of,
    setting,
    share_cell,
    single,
)
from navsim.report.table import ABSENT, Cell, Table, cell, number
from navsim.results.result import Result
from navsim.results.schema import RMS_WINDOW


def _fixes(result: Result) -> Cell:
    runs, fixes = result["/run"].size, int(result["/summary/count/fixes"])
    if runs > 1:
        return Cell("{}  ({:.6g} per run)", (fixes, fixes / runs), trials=runs, names=("count", "a run"),
                    units=("", "1/run"))  # fmt: skip
    return Cell("{}", (fixes,), trials=runs, names=("count",))


WHITE_ALONE = "white noise alone, so their gain is optimistic"
"""What tables say of pseudolites without errors that last."""
_DELAYING = ("ephemeris", "ionosphere", "troposphere")
_OF_PSEUDOLITES = {
    "survey_error_m": "survey", "survey_sigma_m": "survey", "clock_sigma_ns": "clock", "clock_noise": "clock",
    "range_bias_sigma_m": "range bias", "multipath": "reflections", "air": "air",
}  # fmt: skip
"""Keys of `signals`, and of `pseudolites` with their names in tables, with time-correlated ranging errors, if present
and not zero."""


def ranging_errors(result: Result) -> str:
    """Whether errors of ranges average out."""
    if _FIX_STATES in result:
        return "not used: fixes have errors of their state"
    signals, pseudolites, receiver = (setting(result, section) for section in ("signals", "pseudolites", "receiver"))
    if "errors" not in signals:  # of an earlier version
        return ABSENT
    values = [kind.get("sigma_m", True) for kind in signals["errors"].values() if kind]
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


def _errors_of_pseudolites(result: Result) -> str:
    pseudolites = setting(result, "pseudolites")
    return errors_of(pseudolites) if pseudolites["count"] or pseudolites["sites"] else ABSENT


def errors_of(pseudolites: dict[str, Any]) -> str:
    """Which errors pseudolites of this section of a scenario have besides white noise."""
    given = {key: pseudolites.get(key) for key in _OF_PSEUDOLITES}
    names = [_OF_PSEUDOLITES[key] for key, value in given.items() if (any(value) if isinstance(value, list) else value)]
    return f"white noise, {', '.join(dict.fromkeys(names))}" if names else WHITE_ALONE


def _sensors(result: Result) -> list[str]:
    """Sensors beside the receiver: runs count their measurements, and in an error budget they are the sources that have
    a section in the scenario."""
    counted = (path.split("/")[3] for path in result.variables if path.startswith("/summary/aiding/"))
    sources = (str(source) for source in result[SOURCES]) if SOURCES in result else ()
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
        ground = [n for n in names_at([r for r, _ in told], "/pseudolites/name") if all_of_them or n in lost]
        if lost or ground:
            table.head(title, *("fix epochs" for _ in results))
        for name in dict.fromkeys([*ground, *lost]):
            table.add(f"  {name}", *(_lost(r, c, name, word) for r, c in zip(results, counts, strict=True)))


def _lost(result: Result, count: np.ndarray | None, name: str, word: str) -> Cell | str:
    """At how many fix epochs a source is lost to something, which takes each (s,) so often."""
    i = index_of(result, "/geometry/source", name)
    if i is None or count is None:
        return ABSENT
    return cell("{} of {}", int(count[i]), result["/geometry/time"].size, names=(word, "of"))


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
    return Cell("{:.1f}  ({:.0f} - {:.0f})", (mean, low, high), whole=True, names=RANGE)


def _dop(result: Result, path: str, with_median: bool = False) -> Cell | str:
    """Statistics of a DOP on the glide. with_median: the mean of a DOP that is nearly singular at times says little."""
    if path not in result:
        return ABSENT
    mean, low, high, median = map(float, result[path][:4])
    if with_median:
        return Cell("{:.2f}  ({:.2f} - {:.2f}), median {:.2f}", (mean, low, high, median), whole=True,
                    names=(*RANGE, "median"))  # fmt: skip
    return Cell("{:.2f}  ({:.2f} - {:.2f})", (mean, low, high), whole=True, names=RANGE)


_HELPFUL = 0.5
"""Sigma with beacons over that without them up to which the ranges count as the source of a coordinate."""


def _with_beacons(result: Result, axis: str, i: int) -> Cell | str:
    """Sigmas of a coordinate at a height with and without beacons, and whether beacons measure it."""
    held, path = float(result[f"/summary/at/{axis}_sigma"][i]), f"/summary/at/{axis}_without_beacons"
    if math.isnan(held):
        return ABSENT
    if path not in result:
        return cell("- ({:.2f}), no beacons", held, names=("without",))
    without = float(result[path][i])
    by = "from beacons" if held <= _HELPFUL * without else "not from beacons"
    return cell("{:.2f} ({:.2f}), {}", held, without, by, names=("with", "without", "source"))


def _mirror(result: Result) -> Cell | str:
    """The mirror solution that fits the ranges best before touchdown: how far away it is, when, and its residual.

    It is the first of those whose residuals differ by less than a tenth of the noise of ranges.
    """
    if "/beacons/image_residual" not in result:
        return ABSENT
    events = dict(zip(map(str, result["/truth/event"]), result["/truth/event_time"].tolist(), strict=True))
    airborne = result["/beacons/instant"] < events.get("touchdown", math.inf)
    residual = np.where(airborne, result["/beacons/image_residual"], np.nan)
    if np.isnan(residual).all():
        return "none: the beacons are not in one plane"
    alike = max(0.005, 0.1 * setting(result, "beacons", "sigma_m"))
    best = int(np.argmax(residual < np.nanmin(residual) + alike))
    away = float(result["/beacons/image_height"][best])
    side = "above" if away > 0.0 else "below"
    return cell("{:.0f} m {} the aircraft at {:.1f} s, fits within {:.2f} m", abs(away), side,
                float(result["/beacons/instant"][best]), float(residual[best]),
                names=("distance", "side", "time", "residual"))  # fmt: skip


def summary_table(results: list[tuple[str, Result]], every_source: bool = False) -> Table:
    """One table of the summaries, a column a result: names and results in order.

    every_source: a row for each source of the error budget, small ones too.
    """
    table = Table("", ("", *(name for name, _ in results)), caption=_SUMMARY)

    def row(label: str, shown: Any) -> None:
        table.add(label, *(shown(r) for _, r in results))

    def section(title: str, shown: Callable[[Result], str] = lambda _: "") -> None:
        table.head(title, *(shown(r) for _, r in results))

    row("runs", runs_of)
    row("ranging errors", ranging_errors)
    if any(_errors_of_pseudolites(r) != ABSENT for _, r in results):
        row("errors of pseudolites", _errors_of_pseudolites)
    row("fixes", _fixes)
    row("fix epochs without a fix", lambda r: count_cell(r, "/summary/count/epochs_without_fix"))
    sensors = list(dict.fromkeys(name for _, r in results for name in _sensors(r)))
    if sensors:
        section("Aiding sensors", lambda _: "measurements of all runs; NIS: 1 is right")
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
    labels = heights_of([r for _, r in results])
    if any("/summary/at/headwind" in r for _, r in results):
        section("Mean wind and airspeed at height")
        for i, label in labels.items():
            for words, name, scale in _WIND:
                row(f"  {label}, {words}", lambda r, i=i, n=name, s=scale: _wind(r, n, i, s))
    if any("/summary/track/rms_smoothed" in r for _, r in results):
        section("Trajectory of the table, smoothed")
        for path, label, scale, digits in (
            ("rms_smoothed", "rms distance from the table, m", 1.0, 2),
            ("specific_force", "largest specific force, m/s2", 1.0, 2),
            ("rate", "largest rate, deg/s", DEGREE, 1),
        ):
            row(f"  {label}", lambda r, p=path, s=scale, d=digits: _of_track(r, p, s, d))
    _losses(table, [r for _, r in results])

    def epochs(result: Result) -> str:
        lost = "/summary/count/epochs_without_fix"
        return "mean (min - max)" + ("; PDOP to TDOP: fixes only" if lost in result and result[lost] > 0 else "")

    section("Geometry on the glide", epochs)
    for name in ("pdop", "hdop", "vdop", "gdop", "tdop"):
        row("  " + name.upper(), lambda r, n=name: _dop(r, f"/summary/dop/{n}"))
    for name in ("satellites", "pseudolites"):
        if any(_uses(r, name) for _, r in results):
            row(f"  {name} used", lambda r, n=name: _used(r, n))
    for title, end in (("beacons", ""), ("beacons and fix", "_with_sources")):
        for name in ("hdop", "vdop"):
            path = f"/summary/beacons/{name}{end}"
            if any(path in r and np.isfinite(r[path][0]) for _, r in results):
                row(f"  {name.upper()}, {title}", lambda r, p=path: _dop(r, p, with_median=True))
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
        row(f"  {name} position, m", lambda r, n=name: late_rms(r, n))
    for path, axes, unit, scale in (
        ("velocity_ned", ("velocity north", "velocity east", "velocity down"), "m/s", 1.0),
        ("attitude_rpy", ("roll", "pitch", "heading"), "deg", DEGREE),
    ):
        for i, axis in enumerate(axes):
            row(f"  {axis}, {unit}", lambda r, p=path, i=i, s=scale: late_rms(r, p, i, s))
    section("Filter, position error at height, m", lambda r: columns(r, "truth - estimate" if single(r) else "RMS"))
    for i, label in labels.items():
        for name in ("lateral", "along", "vertical"):
            row(f"  {label}, {name}", lambda r, n=name, i=i: error_at(r, n, i))

    if any("/summary/at/vertical_without_beacons" in r for _, r in results):
        section("When may height be trusted? σ of the filter, m", lambda _: "with beacons (without)")
        for i, label in labels.items():
            for name in ("vertical", "lateral"):
                row(f"  {label}, {name}", lambda r, n=name, i=i: _with_beacons(r, n, i))
        row("  mirror solution of the ranges", _mirror)

    controlled_rows(table, results)

    def levels(result: Result) -> str:
        whose = "landings" if result.attributes["method"] == "covariance" else "runs"
        each = "  ".join(f"{p} %" for p in result["/summary/percentile"])
        return "" if single(result) else f"{each} of {whose} below"

    if not all(single(r) for _, r in results):
        section("Size of the position error, m", levels)
        for name in ("horizontal", "vertical"):
            path = f"/summary/rms/{name}_percentile"
            if any(path in r for _, r in results):  # covariance analysis has no runs to sort
                row(f"  {name}, RMS over {RMS_WINDOW:g} s", lambda r, p=path: percentile_cell(r, p))
        for i, label in labels.items():
            for name in ("lateral", "along", "vertical"):
                path = f"/summary/at/{name}_percentile"
                row(f"  {label}, {name}", lambda r, p=path, i=i: percentile_cell(r, p, i))
    if any("/summary/at/lateral_tse" in r for _, r in results):
        section("System errors at height, m", system_error_heading)
        for i, label in labels.items():
            for name in ("lateral", "along", "vertical"):
                row(f"  {label}, {name}", lambda r, n=name, i=i: total_error(r, n, i))
        ending_rows(table, results)
    boxed = [r for _, r in results if "/summary/box/upper" in r]
    if boxed:
        section("Outside the box", lambda r: box_head(r, "/summary/box/probability" in r))
        row("  any limit exceeded", lambda r: box_cell(r, None))
        for i, name in enumerate(("lateral", "along", "vertical")):
            row(f"  {name}", lambda r, i=i: box_cell(r, i))
    if any("/summary/integrity/level_share" in r for _, r in results):
        integrity_rows(table, results)
        tail_rows(table, results)
    section("Consistency, mean per degree of freedom", mean_head)
    counts = sorted(
        {int(r.variables["/summary/consistency/nees"].attributes["degrees_of_freedom"]) for _, r in results}
    )
    row(f"  NEES, {' or '.join(map(str, counts))} states", lambda r: unit_mean(r, "nees"))
    row("  NEES, position and velocity", lambda r: unit_mean(r, "nees_position_velocity"))
    row("  NIS", lambda r: unit_mean(r, "nis"))
    flown = next((r for _, r in results if "/summary/coverage/level" in r), None)
    if flown is not None:
        for i, level in enumerate(flown["/summary/coverage/level"]):
            row(f"  share of position within {level:g}σ", lambda r, i=i: coverage(r, i))
    consistency_rows(table, results)
    if sources := budget_rows([r for _, r in results], every_source):
        shares = "horizontal, vertical, m (share of mean square)"
        section(f"Error budget over the same {RMS_WINDOW:g} s", lambda _: shares)
        for label, names in sources.items():
            row(f"  {label}", lambda r, n=names: budget_cell(r, n))
    requirements(table, results)
    return table


def _of_track(result: Result, name: str, scale: float, digits: int) -> Cell | str:
    """A number of the smoothed trajectory of a table."""
    path = f"/summary/track/{name}"
    return number(scale * float(result[path]), digits) if path in result else ABSENT


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


_WIND = (
    ("headwind, m/s", "headwind", 1.0), ("wind from the left, m/s", "crosswind", 1.0),
    ("airspeed, m/s", "airspeed", 1.0), ("crab, deg", "crab", DEGREE),
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
        (f"horizontal RMS over {RMS_WINDOW:g} s, m", late_rms(result, "horizontal")),
        (f"vertical RMS over {RMS_WINDOW:g} s, m", late_rms(result, "vertical")),
        ("lateral at touchdown, m", error_at(result, "lateral", 0)),
        ("PDOP on the glide", Cell("{:.2f}  ({:.2f} - {:.2f})", dops, names=RANGE)),
        ("NEES per state", unit_mean(result, "nees")),
        ("sigma of each state", state_verdict(result)),
    ]
    if "/summary/box/upper" in result:
        out.append(("outside the box", box_cell(result, None)))
    if "/summary/integrity/availability" in result:
        out.append(("epochs available", share_cell(result, "/summary/integrity/availability")))
    return out


_SUMMARY = (
    "Landings. The names of rows and of their groups contain the units. In brackets [low, high]: 95 % intervals over "
    "runs. σ: the filter's own, root mean square. Lateral, along and vertical are axes of the runway"
)
"""Caption of the table of landings."""
