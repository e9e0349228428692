"""Outside judges of the methods of a result, and effects that its scenario leaves out.

Both come from pages of the documentation: `docs/validation.md`, which the oracle tests write, and `docs/limits.md`. The
wheel contains them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from navsim.report.citations import at, filtered, methods_of, of_landing
from navsim.results.result import Result, scenario_of

_PACKED = Path(__file__).resolve().parent / "pages"
_IN_TREE = Path(__file__).resolve().parents[2] / "docs"
_LANDING, _FIXES = "the landing, its sensors and its signals", "fixes by weighted least squares, dilution of precision"
_FROM_FILES = "satellites by almanacs or two-line elements"
_EARTH = (
    "geodetic and ECEF coordinates", "normal gravity", "geodetic and ECEF coordinates, random points",
    "local axes, random points", "azimuth, elevation and distance, random points",
    "places in the axes of a runway, random points", "radii of curvature at pole and equator",
)  # fmt: skip
_RAIM = (
    "square root of the chi-square threshold", "chi-square thresholds at 1e-3", "bias in the residuals that is missed",
    "noncentrality of Baarda's reliability", "RAIM of 6 satellites and 2 pseudolites", "exclusion of a biased range",
    "RAIM and separation levels of two rings of sources", "risk of a biased range under the chi-square test",
    "what residuals see of spoofed satellites", "risk of a biased range, sampled", "worst bias of a range",
)  # fmt: skip
_SEPARATION = (
    "solution separation (ARAIM), drawn skies", "solution separation (ARAIM)",
    "separation levels with pseudolites and their group", "separation where few satellites are left",
    "risk of a biased range under one separation test", "risk under one separation test, sampled",
)  # fmt: skip
_CIRCUIT = ("The landing circuit: position, azimuth, range and their derivatives",)
JUDGES: Mapping[str, tuple[str, ...]] = {
    _LANDING: (*_EARTH, "the ten coordinates of Table 1", "pulsed pseudolites", "noise of range rates"),
    _FIXES: (
        "GDOP, PDOP, HDOP, VDOP, TDOP", "DOPs and weighted covariance with one to three clocks",
        "nine satellites and their DOPs, 56N 37E, 2018-09-13 12:00 UTC",
        "Cells of Table 2: DOPs and SKO of all rows and calibrations",
        "Exported RINEX of noisy measurements", "Exported RINEX of error-free GPS, GLONASS and both",
    ),
    "GLONASS satellites": (
        "nominal GLONASS: radius, inclination, planes, places", "nominal GLONASS near the real one of 2018-09-13",
        "PZ-90.11 to ITRF2008", "GLONASS orbit, simplified Runge-Kutta", "GLONASS orbit with lunisolar accelerations",
        "GLONASS broadcast position", "Broadcast GLONASS orbits over a day",
        "Exported RINEX of GPS and GLONASS through the leap second of 2016", "Leap seconds as GPS announces them",
    ),
    "GPS satellites": (
        "Broadcast GPS orbits over a day", "DOPs of GPS's 24 slots and of a Walker 24/3/1 over a day",
        "Broadcast positions and clocks of GPS and of BeiDou's three kinds of orbits",
    ),
    "Galileo satellites": (
        "A Galileo position by I/NAV", "Broadcast orbits and clocks of GPS and Galileo (I/NAV) over a day",
        "Clocks by I/NAV and by F/NAV, with group delays",
        "Design constellations of Galileo, BeiDou (MEO) and QZSS",
        "Exported RINEX of error-free Galileo, BeiDou and all systems",
    ),
    "BeiDou satellites": (
        "Jumps between hourly BeiDou messages", "Design constellations of Galileo, BeiDou (MEO) and QZSS",
        "Broadcast positions and clocks of GPS and of BeiDou's three kinds of orbits",
    ),
    "QZSS satellites": ("Design constellations of Galileo, BeiDou (MEO) and QZSS",),
    _FROM_FILES: (
        "GLONASS almanac propagation", "DOPs from a YUMA almanac with masks", "Greenwich mean sidereal time",
        "Two-line elements", "row 1 of Table 2 from a real jammed sky", "Real skies of Table 2's calibrations a and b'",
    ),
    "precise orbits": ("Single-point positioning by precise orbits (SP3), a day of GPS, GLONASS and both",),
    "ionosphere and troposphere": (
        "Klobuchar's ionosphere", "Saastamoinen's troposphere", "Niell's mapping functions",
        "Exported RINEX with ionosphere and troposphere",
    ),
    "inertial sensors and their errors": ("specific force and angular rate belong to the path",),
    "strapdown mechanisation": (
        "velocity increment with rotation correction", "drift under coning, without and with the two-sample correction",
        "specific force and angular rate belong to the path",
    ),
    "error model and update of the navigation filter": (
        "clock of a receiver without sources", "two sources and an unknown clock",
        "update with a range that may be an outlier", "angles and ranges of ground stations, and their derivatives",
        "Covariance of position, clocks, survey errors and biases of pseudolites and beacons",
    ),
    "batch smoother": ("The `map` smoother minimises the nonlinear least-squares cost of the whole flight",),
    "consistency: each state's sigma, NEES, NIS and their bands": ("Chances of the bands and the runs they need",),
    "fixes watched by their residuals": _RAIM,
    "fixes watched by solution separation": _SEPARATION,
    "filters watched by solution separation": (
        "Separation of a filter and one with fewer measurements", "Slow ramp behind a filter, by its innovations",
    ),
    "protection levels of augmentation systems, alert limits": (
        "SBAS protection levels", "GBAS factors", "GBAS protection levels", "alert limits of operations",
        "regions of a Stanford diagram", "what numbers of sources make possible",
    ),
    "interference": (
        "budgets of jammers, J/S and effective C/N0", "spectral separation and Q of jammers",
        "thresholds of phase and code loops", "loss behind a knife edge", "a jammed landing, from power to code noise",
        "where lock is lost and found again", "spectral separation of carriers apart",
        "spectral separation in the band of a front end", "loss behind a ridge",
    ),
    "alignment in flight": (
        "RINEX observations: versions 2, 3, 4, scale factors, blank lines",
        "RINEX observations: a real day, packed by Hatanaka", "RINEX 4 messages: LNAV, FDMA with health flags",
        "RINEX 3.05 messages: a real day", "Single-point positioning, a day of GPS, GLONASS and both",
        "Single-point positions of a day by GPS, Galileo, GPS and Galileo, GPS and BeiDou, weighted by an error budget",
    ),
    "elevation on an MLS approach": (
        "Covariance and gain of the elevation filter, step by step", "Steady state of the elevation filter",
        "Exact Singer discretisation", "beta, beta', beta'' on the four segments",
    ),
    "tracking with onboard data": (
        "Range rate and acceleration from onboard and line-of-sight data", "Steady state of the five pairs", *_CIRCUIT,
    ),
    "azimuth from load factors": _CIRCUIT,
}  # fmt: skip
"""Claims of `docs/validation.md` for each method of `citations.METHODS` that an outside judge stands behind."""

Applies = Callable[[Mapping[str, Any], Mapping[str, Any]], bool]


def _has_pseudolites(scenario: Mapping[str, Any]) -> bool:
    return bool(at(scenario, "pseudolites", "count") or at(scenario, "pseudolites", "sites"))


_ON_GROUND = ("beacons", "azimuth_station", "elevation_station", "dme")
_ALTIMETERS = ("radio_altimeter", "barometric_altimeter", "magnetometer")
SECTIONS: Mapping[str, Applies] = {
    "Signals and atmosphere": of_landing,
    "Pseudolites": lambda scenario, root: of_landing(scenario, root) and _has_pseudolites(scenario),
    "Terrain and horizon": of_landing,
    "Satellite systems and time": lambda scenario, root: of_landing(scenario, root) or root["kind"] == "replay",
    "Receiver and interference": of_landing,
    "Integrity": lambda scenario, root: of_landing(scenario, root) and at(scenario, "integrity") is not None,
    "Filter and covariance analysis": filtered,
    "Inertial sensors": lambda scenario, root: of_landing(scenario, root) and filtered(scenario, root),
    "Altimeters": lambda scenario, root: any(at(scenario, name) is not None for name in _ALTIMETERS),
    "Aircraft, wind, trajectories of runs": of_landing,
    "Runway and Earth": of_landing,
    "Beacons, ground stations": lambda scenario, _: any(at(scenario, name) is not None for name in _ON_GROUND),
    "Replay, live, exports": lambda _, root: root["kind"] in ("replay", "live"),
}
"""Sections of `docs/limits.md`, and the results that they are about."""
_KEY = re.compile(r"`([a-z_]+(?:\.[a-z_0-9]+)+)(?:: ([\w-]+))?`")
"""A key in a row, perhaps with a value."""


@dataclass(frozen=True)
class Judged:
    """A claim of the package, and who confirmed it."""

    method: str
    claim: str
    oracle: str
    tolerance: str
    outcome: str


@dataclass(frozen=True)
class UnmodelledEffect:
    """An effect that is not modelled. instead: what takes its place. remedy: "" for none."""

    section: str
    effect: str
    instead: str
    remedy: str


def rows_of(page: str) -> list[tuple[str, list[str]]]:
    """Rows of the tables of a page, each with the section that it stands in."""
    folder = _PACKED if _PACKED.is_dir() else _IN_TREE
    section, rows = "", []
    for line in (folder / page).read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            section = line[3:].strip()
        elif line.startswith("|"):
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip().strip("|"))]
            rows.append((section, cells))
    heads = {i for i, (_, cells) in enumerate(rows) if set("".join(cells)) <= set("-: ")}
    return [row for i, row in enumerate(rows) if i not in heads and i + 1 not in heads]


def _without_marks(text: str) -> str:
    """Text of Markdown without links and marks of code."""
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text).replace("`", "")


def judged(result: Result) -> tuple[list[Judged], list[str]]:
    """Outside judges of the methods of a result, and its methods without any."""
    known = {cells[0]: cells for _, cells in rows_of("validation.md")}
    out, without = [], []
    for method in methods_of([result]):
        claims = [[*map(_without_marks, known[claim])] for claim in JUDGES.get(method.name, ()) if claim in known]
        out += [Judged(method.name, claim, oracle, limit, end) for claim, oracle, limit, end, *_ in claims]
        without += [] if claims else [method.name]
    return out, without


def unmodelled_effects(result: Result) -> list[UnmodelledEffect]:
    """Effects that concern this scenario and are not modelled.

    A row about a key is left away where the scenario lacks the key, or has another value than the row names.
    """
    scenario, root = scenario_of(result), result.attributes

    def concerns(effect: str) -> bool:
        keys = [(at(scenario, *key.split(".")), value) for key, value in _KEY.findall(effect)]
        return all(there is not None and value in ("", str(there)) for there, value in keys)

    return [
        UnmodelledEffect(section, *map(_without_marks, (cells[0], cells[1], cells[2] if len(cells) > 2 else "")))
        for section, cells in rows_of("limits.md")
        if SECTIONS.get(section, lambda *_: True)(scenario, root) and concerns(cells[0])
    ]
