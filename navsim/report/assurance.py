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
from navsim.results.findings import of as findings_of
from navsim.results.notes import SECOND_ORDER
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
    "Geodetic and ECEF coordinates", "Normal gravity", "Geodetic and ECEF coordinates, random points",
    "Local axes, random points", "Azimuth, elevation and distance, random points",
    "Positions in runway axes, random points", "Radii of curvature at pole and equator",
)  # fmt: skip
_RAIM = (
    "Square root of the chi-square threshold", "Chi-square thresholds at 1e-3",
    "Range bias that the residual test misses",
    "Noncentrality of Baarda's reliability", "RAIM of 6 satellites and 2 pseudolites: test statistic, slopes, levels",
    "Choice of the range that RAIM excludes",
    "RAIM and ARAIM levels of two rings of sources", "Risk of a biased range under the chi-square test",
    "Residuals of spoofed satellites", "Risk of a biased range, by importance sampling",
    "Bias of a range with the largest risk",
)  # fmt: skip
_SEPARATION = (
    "ARAIM protection levels and fault modes under random skies", "ARAIM protection levels of a published example",
    "ARAIM levels with pseudolites that may fail together", "ARAIM levels if few satellites remain",
    "Risk of a biased range under one ARAIM test", "Risk under one ARAIM test, by importance sampling",
)  # fmt: skip
_AIR = (
    "Dryden turbulence: spectrum",
    "Dryden turbulence: the spectrum's test finds the error of a handbook's difference equation",
    "Dryden turbulence: variance", "Dryden turbulence: scales and sigmas",
    "Dryden turbulence: spectra of both specifications agree", "Dryden turbulence: autocorrelation",
    "Exact discretisation of Dryden turbulence", "Variance of a gust behind a first-order lag",
    "Sigma of an aircraft's motion in turbulence",
    "Covariance and autocorrelation of the flight-technical error", "Mean wind by height",
    "Heading and ground speed by the wind triangle",
)  # fmt: skip
_PATHS = (
    "Radius, rate and load factor of a level turn", "Distance before the corner at which a fly-by turn begins",
    "Velocities of a smoothed recorded flight", "Distance of the aim point by the threshold crossing height",
    "Runway direction by its two thresholds",
)  # fmt: skip
_PSEUDOLITES = (
    "Free-space loss", "C/N0 near a pseudolite, and the tolerable J/S",
    "Distance within which a pseudolite costs satellites", "Loss of satellite and pseudolite signals by pulses",
    "Elevation seen by a banked antenna",
    "Reflection coefficients of the ground", "Path difference and level of a ray reflected by flat ground",
    "Code error by a reflection with little delay",
    "Delay by the air on the paths of pseudolites", "Effect of pulsed pseudolites on receivers",
)  # fmt: skip
_BEACONS = (
    "DOPs of two-way and one-way ranges, alone and with satellites",
    "DOPs of beacons, without and with a clock",
    "Predicted range, its variance and gate, of a beacon without bias",
)  # fmt: skip
_HEIGHTS = (
    "Static pressure up to 11 km", "Barometric height over a cold aerodrome", "Undulations of the geoid",
    "Magnetic fields", "Magnetic declinations",
)  # fmt: skip
_CIRCUIT = ("The landing circuit: position, azimuth, range and their derivatives",)
_ONE_GAUSSIAN = (
    "Sigma and estimates of `gaussian-sum` where one Gaussian, a `tfg` filter, is enough, with `filter.steady_force`"
)
JUDGES: Mapping[str, tuple[str, ...]] = {
    _LANDING: (*_EARTH, *_AIR, *_PATHS, *_PSEUDOLITES, *_BEACONS, *_HEIGHTS,
               "Coordinates of Table 1 of the landing paper", "Noise of range rates"),
    _FIXES: (
        "GDOP, PDOP, HDOP, VDOP, TDOP", "DOPs and covariance of weighted fixes with one to three clocks",
        "Visible GLONASS satellites and their DOPs, 56N 37E, 2018-09-13 12:00 UTC",
        "Cells of Table 2: DOPs and SKO of all rows and calibrations",
        "Exported RINEX of noisy measurements", "Exported RINEX of error-free GPS, GLONASS and both",
    ),
    "GLONASS satellites": (
        "Nominal GLONASS constellation: radius, inclination, planes and slots",
        "Directions of nominal GLONASS satellites, against the real ones of 2018-09-13",
        "Transformation from PZ-90.11 to ITRF2008", "GLONASS orbit without lunisolar accelerations",
        "GLONASS orbit with lunisolar accelerations",
        "GLONASS position by broadcast messages", "Distance of broadcast from precise GLONASS orbits over a day",
        "Exported RINEX of GPS and GLONASS through the leap second of 2016", "Leap seconds as GPS announces them",
    ),
    "GPS satellites": (
        "Directions of GPS's 24 slots", "Distance of broadcast from precise GPS orbits over a day",
        "DOPs of GPS's 24 slots and of a Walker 24/3/1 over a day",
        "Broadcast positions and clocks of GPS and of BeiDou's three kinds of orbits",
    ),
    "Galileo satellites": (
        "Offset of Galileo's time from GPS's", "A Galileo position by I/NAV",
        "Statistics of the broadcast errors of GPS and Galileo (I/NAV) over a day",
        "Difference of Galileo clocks by I/NAV and by F/NAV, with group delays",
        "Slots of the design constellations of Galileo, BeiDou (MEO) and QZSS",
        "Exported RINEX of error-free Galileo, BeiDou and all systems",
    ),
    "BeiDou satellites": (
        "Jumps between hourly BeiDou messages", "Slots of the design constellations of Galileo, BeiDou (MEO) and QZSS",
        "Broadcast positions and clocks of GPS and of BeiDou's three kinds of orbits",
    ),
    "QZSS satellites": ("Slots of the design constellations of Galileo, BeiDou (MEO) and QZSS",),
    _FROM_FILES: (
        "GLONASS position and velocity by almanac", "DOPs from a YUMA almanac with masks",
        "Greenwich mean sidereal time",
        "Satellite position by two-line elements", "DOPs of Table 2's calibrations a and b' under real skies",
    ),
    "precise orbits": (
        "Error of single-point positions by precise orbits (SP3), whose clocks leave the group delays, over a day by "
        "GPS, GLONASS and both",
    ),
    "ionosphere and troposphere": (
        "Ionospheric delay by Klobuchar's model", "Tropospheric delay by Saastamoinen's model",
        "Niell's mapping functions",
        "Exported RINEX with ionosphere and troposphere",
    ),
    "inertial sensors and their errors": (
        "Error-free accelerometer and gyro data reproduce the path",
        "Effect of scale factor, misalignment, asymmetry, nonlinearity and g-sensitivity",
        "Sensor bias by vibration and by temperature", "Angle lost by a saturated gyro",
        "Delay and gain of a sensor's bandwidth",
        "Allan deviation of every noise of inertial sensors",
        "Allan deviation of quantisation, and the peak of a Gauss-Markov bias",
        "Spectral density and mean square of random vibration", "Conversion of the units of data sheets",
    ),
    "ground stations: angles, and limits of presets": (
        "Angles and ranges of ground stations, and their derivatives",
        "Estimate without an excluded ground station, and its sigma",
    ),
    "strapdown mechanisation": (
        "Velocity increment of a rotating sensor",
        "Attitude drift under coning, without and with the two-sample correction",
        "Error-free accelerometer and gyro data reproduce the path",
    ),
    "error model and update of the navigation filter": (
        "Growth of a receiver's clock error while it receives nothing",
        "Filter update by two ranges with an unknown clock",
        "Measurement models of heading, wheels and rest, and their derivatives",
        "Filter update by a range that may be an outlier",
        "Covariance of position, clocks, survey errors and biases of pseudolites and beacons",
    ),
    "filter on the two-frames group": (_ONE_GAUSSIAN,),
    "reset of the covariance after a correction": (
        "Sigma and estimates of `eskf`, from fixes and from ranges, with `filter.steady_force` and without it",
    ),
    "Gaussian sum": (_ONE_GAUSSIAN,),
    "rare events by importance sampling": (
        "Probability of leaving a box by importance sampling, linear errors",
    ),
    "batch smoother": ("The `map` smoother minimises the nonlinear least-squares cost of the whole flight",),
    "consistency: each state's sigma, NEES, NIS and their bands": (
        "Probabilities of accuracy bands, and the runs that they need",
    ),
    "fixes watched by their residuals": _RAIM,
    "fixes watched by solution separation": _SEPARATION,
    "filters watched by solution separation": (
        "Covariance of the difference between a filter and one with fewer measurements",
        "Innovations of a filter that follows a slow ramp, and the chance to detect it",
    ),
    "protection levels of augmentation systems, alert limits": (
        "SBAS protection levels", "Factors K of GBAS protection levels", "GBAS protection levels",
        "Alert limits of operations",
        "Growth of GBAS alert limits", "Sigma of GBAS ground accuracy designators",
        "GBAS levels by random B values, D_L and D_V",
        "Regions of the Stanford diagram", "Number of sources that detection and exclusion need",
    ),
    "interference": (
        "Jammer power at the receiver, J/S and effective C/N0", "Spectral separation and Q of jammers",
        "Tracking thresholds of phase and code loops", "Diffraction loss behind a knife edge",
        "Code noise of a jammed landing, step by step from the transmitter's power",
        "C/N0 at which lock is lost and found", "Spectral separation of different carriers",
        "Spectral separation in the band of a front end", "Diffraction loss behind a ridge",
    ),
    "alignment in flight": (
        "RINEX observations: versions 2, 3, 4, scale factors, blank lines",
        "RINEX observations: a real day, packed by Hatanaka", "RINEX 4 messages: LNAV, FDMA with health flags",
        "RINEX 3.05 messages: a real day", "Error of single-point positions over a day by GPS, GLONASS and both",
        "Error of weighted single-point positions over a day by GPS, Galileo, GPS and Galileo, GPS and BeiDou",
    ),
    "tuning by likelihood": (
        "Position and biases by recorded two-way ranges of UWB anchors",
        "Residuals (geometric mean of sources), clock rates by pseudoranges of five free clocks",
        "Clocks, position and sigmas by one-way ranges beside an inertial sensor",
    ),
    "elevation on an MLS approach": (
        "Covariance and gain of the elevation filter, step by step", "Steady state of the elevation filter",
        "Exact Singer discretisation", "Elevation beta and its derivatives on the four segments",
        "First-order filters on the nominal approach",
        "Model of a correlated acceleration, by its correlation time",
        "The flare guided by range and radio altimeter",
    ),
    "tracking with onboard data": (
        "Range rate and acceleration from onboard and line-of-sight data", "Steady state of the five pairs of filters",
        "Track by reports of a data link with age and quantisation", *_CIRCUIT,
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
    (("Reflection coefficients of the ground", "Path difference and level of a ray reflected by flat ground",
    "Code error by a reflection with little delay"),
     _has("pseudolites.multipath")),
    (("Delay by the air on the paths of pseudolites",), _has("pseudolites.air", "beacons.air")),
    (("Loss of satellite and pseudolite signals by pulses", "Effect of pulsed pseudolites on receivers",
    "Distance within which a pseudolite costs satellites"),
     _has("interference.pseudolites")),
    (("SBAS protection levels", "Factors K of GBAS protection levels",
    "GBAS protection levels"), _has("integrity.comparison")),
    (("Number of sources that detection and exclusion need",), lambda _, root: root["kind"] == "integrity-table"),
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
    "GAST D: that levels add D_L and D_V": lambda scenario, _: (
        at(scenario, "integrity", "comparison", "gbas", "approach_service") == "D"
    ),
    "rare events of landings with nonlinear errors": lambda _, result: result.attributes.get("method") == "rare",
    "control variates": lambda _, result: f"{BRANCH}/rms/horizontal" in result,
    "the sum of several Gaussians, held axes of biases": lambda scenario, result: (
        result.attributes.get("method") != "covariance"
        and filtered(scenario, result.attributes)
        and at(scenario, "filter", "kind") == "gaussian-sum"
    ),
    "late measurements": lambda scenario, result: (
        filtered(scenario, result.attributes) and bool(at(scenario, "receiver", "latency_s"))
    ),
    "states for products of position errors near beacons": lambda scenario, result: (
        filtered(scenario, result.attributes)
        and bool(
            at(scenario, "filter", "beacons", "second_order")
            or any(found.name == SECOND_ORDER for found in findings_of(result))
        )
    ),
    "filter states for time-correlated ranging errors, and their inflation": lambda scenario, result: (
        filtered(scenario, result.attributes) and _is_set(at(scenario, "signals", "errors"))
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
