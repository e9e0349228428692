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
from navsim.results.estimates import BRANCH
from navsim.results.result import Result, scenario_of

_PACKED = Path(__file__).resolve().parent / "pages"
_IN_TREE = Path(__file__).resolve().parents[2] / "docs"
Applies = Callable[[Mapping[str, Any], Mapping[str, Any]], bool]


def _has_pseudolites(scenario: Mapping[str, Any], _: Mapping[str, Any]) -> bool:
    return bool(at(scenario, "pseudolites", "count") or at(scenario, "pseudolites", "sites"))


def _is_set(value: Any) -> bool:
    """Whether a setting, or a section with any of its settings, differs from none, zero and false."""
    return any(map(_is_set, value.values())) if isinstance(value, Mapping) else bool(value) and value != "none"


def _has(*names: str) -> Applies:
    return lambda scenario, _: any(_is_set(at(scenario, *name.split("."))) for name in names)


_ALTIMETERS = ("radio_altimeter", "barometric_altimeter", "magnetometer")
_LANDING, _FIXES = "the landing, its sensors and its signals", "fixes by weighted least squares, dilution of precision"
_FROM_FILES = "satellites by almanacs or two-line elements"
_EARTH = (
    "geodetic and ECEF coordinates", "normal gravity", "geodetic and ECEF coordinates, random points",
    "local axes, random points", "azimuth, elevation and distance, random points",
    "positions in runway axes, random points", "radii of curvature at pole and equator",
)  # fmt: skip
_RAIM = (
    "square root of the chi-square threshold", "chi-square thresholds at 1e-3",
    "range bias that the residual test misses",
    "noncentrality of Baarda's reliability", "RAIM of 6 satellites and 2 pseudolites", "exclusion of a biased range",
    "RAIM and separation levels of two rings of sources", "risk of a biased range under the chi-square test",
    "residuals under spoofed satellites", "risk of a biased range, sampled", "worst bias of a range",
)  # fmt: skip
_SEPARATION = (
    "solution separation (ARAIM), drawn skies", "solution separation (ARAIM)",
    "separation levels with pseudolites and their group", "separation where few satellites are left",
    "risk of a biased range under one separation test", "risk under one separation test, sampled",
)  # fmt: skip
_AIR = (
    "Dryden turbulence: spectrum", "Dryden turbulence: the handbook's difference equation differs",
    "Dryden turbulence: variance", "Dryden turbulence: scales and sigmas",
    "Dryden turbulence: spectra of both specifications agree", "Dryden turbulence: autocorrelation",
    "exact discretisation", "variance of a gust behind a first-order lag", "an aircraft in turbulence",
    "flight-technical error", "mean wind by height", "the wind triangle",
)  # fmt: skip
_PATHS = (
    "radius, rate, load factor of a level turn", "a fly-by turn begins R tan(Δψ/2) before its corner",
    "velocities of a smoothed recorded flight", "aim points from threshold crossing heights",
    "directions between thresholds",
)  # fmt: skip
_PSEUDOLITES = (
    "free-space loss", "C/N0 near a pseudolite, and the tolerable J/S",
    "distance within which a pseudolite costs satellites", "losses by pulses", "elevation seen by a banked antenna",
    "Fresnel coefficients of the ground", "two rays over flat ground", "code error of a short reflection",
    "air on the paths of pseudolites", "pulsed pseudolites",
)  # fmt: skip
_BEACONS = (
    "DOPs of two-way and one-way ranges, alone and with satellites",
    "DOPs of ranges, without and with a clock",
    "predicted range, noise and gate of a beacon without bias",
)  # fmt: skip
_HEIGHTS = (
    "static pressure up to 11 km", "heights shown over a cold aerodrome", "undulations of the geoid",
    "magnetic fields", "magnetic declinations",
)  # fmt: skip
_CIRCUIT = ("The landing circuit: position, azimuth, range and their derivatives",)
_ONE_GAUSSIAN = "Sigma and estimates of `gaussian-sum` where one Gaussian is enough, with `filter.steady_force`"
JUDGES: Mapping[str, tuple[str, ...]] = {
    _LANDING: (*_EARTH, *_AIR, *_PATHS, *_PSEUDOLITES, *_BEACONS, *_HEIGHTS, "the ten coordinates of Table 1",
               "noise of range rates"),
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
        "GPS's 24 slots", "Broadcast GPS orbits over a day", "DOPs of GPS's 24 slots and of a Walker 24/3/1 over a day",
        "Broadcast positions and clocks of GPS and of BeiDou's three kinds of orbits",
    ),
    "Galileo satellites": (
        "Galileo's time against GPS's", "A Galileo position by I/NAV",
        "Broadcast orbits and clocks of GPS and Galileo (I/NAV) over a day",
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
        "Two-line elements", "Real skies of Table 2's calibrations a and b'",
    ),
    "precise orbits": ("Single-point positioning by precise orbits (SP3), a day of GPS, GLONASS and both",),
    "ionosphere and troposphere": (
        "Klobuchar's ionosphere", "Saastamoinen's troposphere", "Niell's mapping functions",
        "Exported RINEX with ionosphere and troposphere",
    ),
    "inertial sensors and their errors": (
        "specific force and angular rate belong to the path", "gains of inertial sensors",
        "bias by vibration and by temperature", "saturation", "bandwidth",
        "Allan deviation of every noise of inertial sensors", "quantisation and the peak of a Markov bias",
        "random vibration", "units of data sheets",
    ),
    "ground stations: angles, and limits of presets": ("angles and ranges of ground stations, and their derivatives",),
    "strapdown mechanisation": (
        "velocity increment with rotation correction", "drift under coning, without and with the two-sample correction",
        "specific force and angular rate belong to the path",
    ),
    "error model and update of the navigation filter": (
        "clock of a receiver without sources", "two sources and an unknown clock",
        "headings, velocities along the axes of a vehicle, gyros at rest, and their derivatives",
        "update with a range that may be an outlier",
        "Covariance of position, clocks, survey errors and biases of pseudolites and beacons",
    ),
    "filter on the two-frames group": (_ONE_GAUSSIAN,),
    "error-state filter with reset of its covariance": (
        "Sigma and estimates of `eskf`, from fixes and from ranges, with `filter.steady_force` and without it",
    ),
    "Gaussian sum": (_ONE_GAUSSIAN,),
    "rare events by importance sampling": (
        "probability of leaving a box by importance sampling, linear errors",
    ),
    "batch smoother": ("The `map` smoother minimises the nonlinear least-squares cost of the whole flight",),
    "consistency: each state's sigma, NEES, NIS and their bands": (
        "Probabilities of accuracy bands, and the runs they need",
    ),
    "fixes watched by their residuals": _RAIM,
    "fixes watched by solution separation": _SEPARATION,
    "filters watched by solution separation": (
        "Separation of a filter and one with fewer measurements", "Slow ramp behind a filter, by its innovations",
    ),
    "protection levels of augmentation systems, alert limits": (
        "SBAS protection levels", "GBAS factors", "GBAS protection levels", "alert limits of operations",
        "growth of GBAS alert limits", "ground accuracy designators", "GBAS levels by drawn B values, D_L and D_V",
        "regions of a Stanford diagram", "numbers of sources for detection and exclusion",
    ),
    "interference": (
        "budgets of jammers, J/S and effective C/N0", "spectral separation and Q of jammers",
        "thresholds of phase and code loops", "loss behind a knife edge", "a jammed landing, from power to code noise",
        "C/N0 at which lock is lost and found", "spectral separation of different carriers",
        "spectral separation in the band of a front end", "loss behind a ridge",
    ),
    "alignment in flight": (
        "RINEX observations: versions 2, 3, 4, scale factors, blank lines",
        "RINEX observations: a real day, packed by Hatanaka", "RINEX 4 messages: LNAV, FDMA with health flags",
        "RINEX 3.05 messages: a real day", "Single-point positioning, a day of GPS, GLONASS and both",
        "Single-point positions of a day by GPS, Galileo, GPS and Galileo, GPS and BeiDou, weighted by an error budget",
    ),
    "tuning by likelihood": (
        "two-way ranges of UWB anchors: position and biases",
        "pseudoranges of five free clocks: residual and clock rates",
    ),
    "elevation on an MLS approach": (
        "Covariance and gain of the elevation filter, step by step", "Steady state of the elevation filter",
        "Exact Singer discretisation", "beta, beta', beta'' on the four segments",
        "First-order filters on the nominal approach", "Limits of the exact model of a correlated acceleration",
        "The flare guided by range and radio altimeter",
    ),
    "tracking with onboard data": (
        "Range rate and acceleration from onboard and line-of-sight data", "Steady state of the five pairs",
        "Reports by data link: their age and steps", *_CIRCUIT,
    ),
    "azimuth from load factors": _CIRCUIT,
    "axes of the landing circuit": _CIRCUIT,
}  # fmt: skip
"""Claims of `docs/validation.md` for each method of `citations.METHODS` that an outside judge stands behind."""

PARTS: tuple[tuple[tuple[str, ...], Applies], ...] = (
    (_AIR, _has("wind.speed_m_s", "wind.levels", "wind.turbulence", "wind.gusts", "approach.flight_technical_error")),
    (_PSEUDOLITES, _has_pseudolites),
    (_BEACONS, _has("beacons")),
    (_HEIGHTS, _has(*_ALTIMETERS)),
    (("Fresnel coefficients of the ground", "two rays over flat ground", "code error of a short reflection"),
     _has("pseudolites.multipath")),
    (("air on the paths of pseudolites",), _has("pseudolites.air", "beacons.air")),
    (("losses by pulses", "pulsed pseudolites", "distance within which a pseudolite costs satellites"),
     _has("interference.pseudolites")),
    (("SBAS protection levels", "GBAS factors", "GBAS protection levels"), _has("integrity.comparison")),
    (("numbers of sources for detection and exclusion",), lambda _, root: root["kind"] == "integrity-table"),
)  # fmt: skip
"""Claims about a part of a landing, and whether a scenario has it."""


def _by_separation(scenario: Mapping[str, Any]) -> bool:
    return bool(at(scenario, "integrity", "method") == "mhss")


UNCHECKED: Mapping[str, Callable[[Mapping[str, Any], Result], bool]] = {
    "solution separation: risk under all tests at once": lambda scenario, _: (
        _by_separation(scenario) and _is_set(at(scenario, "integrity", "tails"))
    ),
    "solution separation: exclusion": lambda scenario, _: (
        at(scenario, "integrity", "method") in ("mhss", "filter") and _is_set(at(scenario, "integrity", "exclusion"))
    ),
    "the risk behind the levels of a monitored filter": lambda scenario, _: (
        at(scenario, "integrity", "method") == "filter"
    ),
    "rare events of landings with nonlinear errors": lambda _, result: result.attributes.get("method") == "rare",
    "control variates": lambda _, result: f"{BRANCH}/rms/horizontal" in result,
    "the sum of several Gaussians": lambda scenario, result: (
        result.attributes.get("method") != "covariance"
        and filtered(scenario, result.attributes)
        and at(scenario, "filter", "kind") == "gaussian-sum"
    ),
    "steering by the estimate": lambda scenario, _: at(scenario, "approach", "guidance") == "estimate",
}
"""Parts of methods without an outside judge, and whether a result rests on them."""


def _studied(_: Mapping[str, Any], root: Mapping[str, Any]) -> bool:
    return root["kind"] in ("sweep", "optimize")


SECTIONS: Mapping[str, Applies] = {
    "The ten most dangerous": of_landing,
    "Every landing": of_landing,
    "Integrity": _has("integrity"),
    "Pseudolites": lambda scenario, root: of_landing(scenario, root) and _has_pseudolites(scenario, root),
    "Filter and covariance analysis": filtered,
    "Aircraft and wind": of_landing,
    "Runway and Earth": of_landing,
    "Terrain": _has("terrain", "sky.horizon"),
    "Jammers": _has("interference"),
    "Altimeters and magnetometer": _has(*_ALTIMETERS),
    "Inertial sensors": lambda scenario, root: of_landing(scenario, root) and filtered(scenario, root),
    "Beacons": _has("beacons"),
    "Ground stations": _has("azimuth_station", "elevation_station", "dme"),
    "Satellites and time": lambda scenario, root: of_landing(scenario, root) or root["kind"] == "replay",
    "Sweeps and searches": _studied,
    "Replay and live": lambda _, root: root["kind"] in ("replay", "live"),
}
"""Sections of `docs/limits.md`, and the results that they are about."""
CONDITION = re.compile(r"(without |)`(?:--method ([a-z-]+)|([a-z_]+(?:\.[a-z_0-9]+)*)(?:: ([\w.-]+(?: or [\w-]+)*))?)`")
"""A method, or a key with or without values, which a result has or lacks if the row is about it."""


TO_DECLARE = (
    "without signals.errors", "without pseudolites.clock_sigma_ns", "without pseudolites.range_bias_sigma_m",
    "without pseudolites.survey_sigma_m", "integrity.p_constellation: 1e-08",
)  # fmt: skip
"""Ends of rows of `docs/limits.md` without which nobody may quote a number: errors that last and are not declared, a
prior without a source."""


@dataclass(frozen=True)
class Judged:
    """A claim of the package, and who confirmed it."""

    method: str
    claim: str
    oracle: str
    tolerance: str


@dataclass(frozen=True)
class UnmodelledEffect:
    """An effect that is not modelled, with its consequence and a remedy."""

    section: str
    effect: str
    consequence: str
    remedy: str

    @property
    def forbids(self) -> bool:
        """Whether it forbids quoting the numbers, see `TO_DECLARE`."""
        return self.effect.endswith(TO_DECLARE)


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
    scenario, root = scenario_of(result), result.attributes
    absent = {claim for claims, has_part in PARTS if not has_part(scenario, root) for claim in claims}
    out, without = [], []
    for method in methods_of([result]):
        claims = [[*map(_without_marks, known[claim])] for claim in JUDGES.get(method.name, ())
                  if claim in known and claim not in absent]  # fmt: skip
        out += [Judged(method.name, claim, oracle, limit) for claim, oracle, limit, *_ in claims]
        without += [] if claims else [method.name]
    return out, without + [part for part, is_used in UNCHECKED.items() if is_used(scenario, result)]


def unmodelled_effects(result: Result) -> list[UnmodelledEffect]:
    """Effects that concern this scenario and are not modelled.

    The first cell of a row names keys and methods. The row concerns scenarios that set these keys (to the value that
    it names, or one of several), or that lack them if it says "without".
    """
    scenario, root = scenario_of(result), result.attributes

    def concerns(effect: str) -> bool:
        for without, method, key, value in CONDITION.findall(effect):
            there = root.get("method") if method else at(scenario, *key.split("."))
            meant = (method or value).split(" or ")
            is_so = _has_pseudolites(scenario, root) if key == "pseudolites" else _is_set(there)
            if (str(there) in meant if meant != [""] else is_so) == bool(without):
                return False
        return True

    return [
        UnmodelledEffect(section, *map(_without_marks, cells))
        for section, cells in rows_of("limits.md")
        if SECTIONS.get(section, lambda *_: True)(scenario, root) and concerns(cells[0])
    ]
