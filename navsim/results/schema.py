"""Schema of results: path, dimensions, unit, meaning of every variable, layouts that contain it, and conditions.

Studies add data by path (`results.builder`). The schema is written into the file, published in docs/reference/results,
and compared with the files of studies (`tests/layout.py`).

A `{name}` in a path represents each member of a family: those that the entry lists, or those that a study names (its
sensors, its axes). In units and meanings it represents the member, or a word that comes with the data (`WORDS`). A
dimension `*axes` represents all axes of a sweep. `run` is omitted where there is a single flight (`ONE_FLIGHT`). A
variable with the name of its only dimension is that dimension's coordinate; in a group it hides one of the same name
above.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from types import MappingProxyType

SCHEMA_VERSION = 4
"""Version of the names and meanings on this page; root attribute of every result."""
LANDING, COVARIANCE, RARE, REPLAY, LIVE = "landing", "covariance", "rare", "replay", "live"
SWEEP, OPTIMIZE, TABLE2, INTEGRITY_TABLE = "sweep", "optimize", "table2", "integrity-table"
ELEVATION, ATC, AZIMUTH = "mls-elevation", "atc-tracking", "azimuth-tracking"
RANGES = "ranges"
LAYOUTS = {
    LANDING: "runs of a landing, one or several",
    COVARIANCE: "the covariance analysis of a landing; root attribute `kind` is landing, `method` covariance",
    RARE: "the probability that a landing ends outside a box; root attribute `kind` is landing, `method` rare",
    REPLAY: "a recorded flight through the filter",
    LIVE: "a landing with a real block in the loop",
    RANGES: "recorded ranges of beacons or pseudolites through the filter",
    SWEEP: "every combination of a study's settings",
    OPTIMIZE: "the best placements",
    TABLE2: "the paper's Table 2, published and computed",
    INTEGRITY_TABLE: "capabilities of few satellites and pseudolites by rank, and their protection levels in an "
    "approach",
    ELEVATION: "the companion paper on MLS elevation",
    ATC: "the companion paper on tracking by an air traffic control radar",
    AZIMUTH: "the companion paper on azimuth tracking",
}
"""Layouts of results, with descriptions."""
ONE_FLIGHT = (REPLAY, LIVE)
"""Layouts that have one flight and no axis `run`."""
NUMBER, WHOLE, TEXT, ANY = "number", "whole number", "text", "number or text"
DTYPES = {NUMBER: "f", WHOLE: "iu", TEXT: "UO", ANY: "fiuUO"}
"""Types of numpy by the content of an entry."""
WORDS = {
    "mixed": "the units of the states",
    "unit": "its own",
    "key": "the varied key",
    "quantity": "objective",
    "how": "for errors of the filter, levels and with requirements: by the coarse analysis, in proportion",
    "confidence": "the confidence asked for",
    "of_axis": "the axis of the key",
    "points": "values of its key, or points of the axis if it has several",
    "statement": "the requirement in words",
    "moving": "the speed from which on the tuning counts fixes",
}
"""Words that come with the data into units and meanings, and their meaning."""
FAMILIES = {
    "sensor": "sensor beside the receiver",
    "system": "satellite system",
    "dimension": "axis of the study, named by its keys",
    "varied": "varied key, by its last part",
    "number": "number of a requirement of the scenario, presets as their parts",
    "case": "further case, named by scan period and measurements",
}
"""Families whose members a study names."""


@dataclass(frozen=True)
class Entry:
    """A variable, or a family of similar variables."""

    path: str
    dims: tuple[str, ...]
    units: str
    meaning: str
    layouts: Mapping[str, str]
    """Results that may contain it, and the condition for each, "" for always."""
    of: str = NUMBER
    """Type of its content."""
    each: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))
    """Members of the families in the path."""
    attributes: tuple[str, ...] = ()
    """In addition to units and long_name."""
    labels: tuple[str, ...] = ()
    """Labels of a coordinate that is the same in every result."""


@dataclass(frozen=True)
class Chapter:
    """Entries that belong together, under the title they have in the documentation."""

    title: str
    text: str
    entries: tuple[Entry, ...]


def _a(
    path: str,
    dims: str,
    units: str,
    meaning: str,
    layouts: str | Sequence[str],
    of: str = NUMBER,
    *,
    when: str | Mapping[str, str] = "",
    attributes: tuple[str, ...] = (),
    labels: tuple[str, ...] = (),
    **each: tuple[str, ...],
) -> Entry:
    """An entry; dims: names with blanks between; when: one for all layouts, or by layout if it is not always there."""
    names = (layouts,) if isinstance(layouts, str) else tuple(layouts)
    conditions = {name: when if isinstance(when, str) else when.get(name, "") for name in names}
    return Entry(path, tuple(dims.split()), units, meaning, conditions, of, each, attributes, labels)


def _labels(path: str, meaning: str, layouts: str | Sequence[str], *labels: str) -> Entry:
    """A coordinate with the same labels in every result."""
    return _a(path, path.rsplit("/", 1)[-1], "1", meaning, layouts, TEXT, labels=labels)


_FLOWN = (LANDING, COVARIANCE)
_BEACONS = "where there are `beacons`"
_STATIONS = "where there are ground stations"
_KEPT = "unless `--keep none`"
_HORIZON = "with `sky.horizon`"
_HEIGHTS_FILE = "with a `file` under `terrain`"
_WIND = "where there is a mean wind"
_TRACK = "with `approach.profile: track`"
_ALL = "with `--keep all`, which is the default for one run"
_WAYS = "where runs deviate from the route"
INDICATED = ("localizer", "glide_path")
"""Deviations that a pilot sees."""
_INDICATED = "where the scenario has `approach.indicator`"
_STATED = "with `receiver.fix_states`"
_BROKEN_OFF = "with `approach.go_around.on_alarm`"
_TIGHT = f"{_ALL}, of a tightly coupled filter"
_LOOSE = f"{_ALL}, of a loosely coupled filter"
_CORRELATED = f"{_LOOSE} with states of lasting errors"
_TRANSMITTERS = "with states for errors of pseudolites"
_REFERENCE = "with `reference`"
_BET = "with `--bet`"
_HEADING, _AIDED = "with `heading`", "with `heading`, `standstill`, `side_slip` or `ranges`"
_RANGED = "with `ranges`"
_CLOCKED = "with one-way `ranges`"
_LOOSE_REPLAY, _TIGHT_REPLAY = "of a loosely coupled filter", "of a tightly coupled filter"
_DOPS = ("gdop", "pdop", "hdop", "vdop", "tdop")
RMS_WINDOW = 20.0
"""Length of the stretch before touchdown over which RMS errors are taken, s."""
HEIGHTS = {"touchdown": 0, "50ft": 50, "100ft": 100, "200ft": 200}
"""Heights above the runway at which errors are evaluated, ft."""
SKY_TIMES = 25
"""Largest number of times at which the directions to all sources are kept."""
SKYLINE = 721
"""Number of azimuths of a skyline."""
_HEIGHTS = ", ".join(HEIGHTS).replace("ft", " ft") + ", then those of `requirements`"
RUNWAY_AXES = ("lateral", "along", "vertical")
"""Axes of the runway: to the right, along the landing, up."""
_BAND = ("band_low", "band_high", "degrees_of_freedom")
_LATE = f"over {RMS_WINDOW:g} s to touchdown"
_RMS = f"root mean square over runs and {_LATE}"
_SIGMA = "1 sigma of the filter, root mean square over runs"

_AXES = Chapter(
    "Axes",
    "Coordinates with the same labels in every file.",
    (
        _labels("/llh", "geodetic coordinates, WGS-84", (*_FLOWN, REPLAY, LIVE, SWEEP, OPTIMIZE), "latitude",
                "longitude", "height"),
        _labels("/ned", "axes of the local level frame", (*_FLOWN, REPLAY, LIVE), "north", "east", "down"),
        _labels("/enu", "axes of the local level frame, east first", _FLOWN, "east", "north", "up"),
        _labels("/enu_column", "columns of matrices in these axes", _FLOWN, "east", "north", "up"),
        _labels("/rpy", "Euler angles, yaw-pitch-roll sequence", (*_FLOWN, REPLAY), "roll", "pitch", "yaw"),
        _labels("/interval", "a value and its two-sided 95 % confidence interval",
                (*_FLOWN, RARE, TABLE2, ATC, AZIMUTH, SWEEP, OPTIMIZE), "value", "low", "high"),
        _labels("/statistic", "statistics over the fix epochs of the glide", _FLOWN,
                "mean", "min", "max", "p50", "p95"),
        _labels("/statistic", "statistics over the fix epochs of the glide", TABLE2, "mean", "min", "max"),
        _a("/run", "run", "1", "number of the run in the ensemble of the seed; 0 in a covariance analysis, which flies "
           "along the error-free flight", (*_FLOWN, RARE, ATC, AZIMUTH), WHOLE),
    ),
)  # fmt: skip

_TRUTH = Chapter(
    "Truth and geometry of a landing",
    "The true flight, and the sources in view.",
    (
        _a("/truth/time", "time", "s", "time since the epoch", _FLOWN),
        _a("/truth/position_llh", "time llh", "rad, rad, m", "latitude, longitude, height of the IMU", _FLOWN),
        _a("/truth/velocity_ned", "time ned", "m/s", "velocity over ground", _FLOWN),
        _a("/truth/attitude_rpy", "time rpy", "rad", "roll, pitch, yaw", _FLOWN),
        _a("/truth/wind_ned", "time ned", "m/s", "mean wind at the aircraft, direction to which it moves",
           _FLOWN, when=_WIND),
        _a("/truth/airspeed", "time", "m/s", "speed through the mean wind", _FLOWN, when=_WIND),
        _a("/truth/event", "event", "1", "names of the events", _FLOWN, TEXT),
        _a("/truth/event_time", "event", "s", "times of the events", _FLOWN),
        _a("/truth/threshold_llh", "llh", "rad, rad, m", "threshold of the runway", _FLOWN),
        _a("/geometry/time", "time", "s", "fix epochs, time of validity since the epoch", _FLOWN),
        _a("/geometry/source", "source", "1", "names of the sources", _FLOWN, TEXT),
        _a("/geometry/clock", "source", "1", "clock unknown the source belongs to", _FLOWN, WHOLE,
           attributes=("clocks",)),
        _a("/geometry/line_of_sight", "time source enu", "1",
           "unit vectors antenna to source at truth, nan where not used", _FLOWN),
        _a("/geometry/{dop}", "time", "1", "{DOP}, unit weights, nan without a fix", _FLOWN, dop=_DOPS),
        _a("/geometry/instant", "instant", "s", f"fix epochs with the complete sky: at most {SKY_TIMES}, evenly "
           "spread, including the first and the last", _FLOWN),
        _a("/geometry/{angle}", "instant source", "rad",
           "{angle} of a source at truth, used or not, nan without orbit data", _FLOWN,
           angle=("azimuth", "elevation")),
        _a("/geometry/bearing", "bearing", "rad", "azimuths of the corners of the horizon, growing", _FLOWN,
           when=_HORIZON),
        _a("/geometry/horizon", "bearing", "rad", "elevation of the horizon, straight between its corners", _FLOWN,
           when=_HORIZON),
        _a("/geometry/behind_terrain", "source", "1", "fix epochs at which terrain hides the source: a satellite that "
           "the mask lets pass, or a pseudolite", _FLOWN, WHOLE, when="where there is `terrain`"),
        _a("/geometry/skyline_azimuth", "skyline_azimuth", "rad", "azimuths of the skyline, growing", _FLOWN,
           when=_HEIGHTS_FILE),
        _a("/geometry/skyline", "skyline_azimuth", "rad", "elevation up to which terrain hides the sky from the "
           "antenna at the last fix, -pi/2 where there is none", _FLOWN, when=_HEIGHTS_FILE),
        _a("/geometry/shadowed", "source", "1", "fix epochs at which the aircraft hides the source: a satellite above "
           "the mask, or a pseudolite", _FLOWN, WHOLE, when="where there is "
           "`receiver.antenna`"),
        _a("/pseudolites/name", "name", "1", "names of the pseudolites", _FLOWN, TEXT),
        _a("/pseudolites/position_llh", "name llh", "rad, rad, m", "surveyed positions of the pseudolites", _FLOWN),
        _a("/stations/name", "name", "1", "names of the ground stations", _FLOWN, TEXT, when=_STATIONS),
        _a("/stations/position_llh", "name llh", "rad, rad, m", "positions of their antennas", _FLOWN, when=_STATIONS),
        _a("/beacons/name", "name", "1", "names of the ranging beacons", _FLOWN, TEXT, when=_BEACONS),
        _a("/beacons/position_llh", "name llh", "rad, rad, m", "surveyed positions of the beacons", _FLOWN,
           when=_BEACONS),
        _a("/beacons/time", "time", "s", "fix epochs", _FLOWN, when=_BEACONS),
        _a("/beacons/instant", "instant", "s", f"at most {SKY_TIMES} of them", _FLOWN, when=_BEACONS),
        _a("/beacons/received", "name", "1", "fix epochs at which the beacon is within reach and in sight", _FLOWN,
           WHOLE, when=_BEACONS),
        _a("/beacons/{dop}", "time", "1", "{DOP} of the ranges to all beacons received, without a clock, unit "
           "weights, nan without a solution", _FLOWN, when=_BEACONS, dop=_DOPS[1:4]),
        _a("/beacons/{dop}_with_sources", "time", "1", "{DOP} of these ranges together with the sources of the "
           "fix", _FLOWN, when=_BEACONS, dop=_DOPS[1:4]),
        _a("/beacons/image_height", "instant", "m", "height of the mirror solution of the ranges above the "
           "antenna, nan without one", _FLOWN, when=_BEACONS),
        _a("/beacons/image_residual", "instant", "m", "residual of the ranges there, RMS", _FLOWN, when=_BEACONS),
        _a("/beacons/output", "output", "s", "times of the filter's output", COVARIANCE, when=_BEACONS),
        *(
            _a(f"/beacons/{axis}_sigma{end}", "output", "m", f"{axis} position, sigma of the filter {words} beacons",
               COVARIANCE, when=_BEACONS)
            for axis in ("lateral", "vertical") for end, words in (("", "with"), ("_without", "without"))
        ),
    ),
)  # fmt: skip

_RECEIVER = Chapter(
    "Receiver",
    "Measurements and fixes, simulated or recorded.",
    (
        _a("/receiver/time", "time", "s", "times of the fixes since the epoch: of validity; of a recorded flight those "
           "in the log", (*_FLOWN, REPLAY)),
        _a("/receiver/position_llh", "run time llh", "rad, rad, m", "fixes of the antenna", (LANDING, REPLAY),
           when={LANDING: _ALL}),
        _a("/receiver/true_position_llh", "run time llh", "rad, rad, m", "true position of the antenna", LANDING,
           when=f"{_WAYS}, {_ALL}"),
        _a("/receiver/velocity_ned", "run time ned", "m/s", "velocity fixes of the antenna, nan if missing",
           (LANDING, REPLAY), when={LANDING: _ALL}),
        _a("/receiver/clock_name", "clock_name", "1", "time scales", LANDING, TEXT, when=_ALL),
        _a("/receiver/clock", "run time clock_name", "m", "receiver clock against each time scale", LANDING, when=_ALL),
        _a("/receiver/{state}", "run time", "1", "true state of the fix, or the state that the receiver reports: 0 "
           "fixed, 1 float, 2 differential, 3 single, 4 wrong", LANDING, WHOLE, when=f"{_STATED}, {_ALL}",
           state=("fix_state", "fix_flag")),
        _a("/receiver/covariance_enu", "time enu enu_column", "m2", "weighted covariance of a position fix at truth",
           _FLOWN),
        _a("/imu/time", "time", "s", "times of the samples since the epoch: each is of the interval that ends there",
           LANDING, when=_ALL),
        _labels("/imu/axis", "body axes", LANDING, "forward", "right", "down"),
        _a("/imu/delta_angle", "run time axis", "rad", "integral of the angular rate that the gyros measured over the "
           "interval", LANDING, when=_ALL),
        _a("/imu/delta_velocity", "run time axis", "m/s", "integral of the specific force that the accelerometers "
           "measured over the interval", LANDING, when=_ALL),
        _a("/measurements/time", "time", "s", "fix epochs", LANDING, when=_ALL),
        _a("/measurements/source", "source", "1", "names of the sources", LANDING, TEXT, when=_ALL),
        _a("/measurements/pseudorange", "run time source", "m", "pseudoranges", LANDING, when=_ALL),
        _a("/measurements/range_rate", "run time source", "m/s", "pseudorange rates", LANDING, when=_ALL),
        _a("/measurements/cn0", "run time source", "dB-Hz", "carrier to noise density ratio", LANDING, when=_ALL),
    ),
)  # fmt: skip

_FILTER = Chapter(
    "Filter",
    "Every answer of the filter, after the update, at the same times in all variables of the group.",
    (
        _a("/filter/time", "time", "s", "times of the filter's outputs since the epoch: time 0 and whenever fixes are "
           "applied, of a recorded flight at filter.output_rate_hz", (*_FLOWN, REPLAY, LIVE), when={LANDING: _KEPT}),
        _a("/filter/state", "state", "1", "states of the filter", (*_FLOWN, REPLAY, LIVE), TEXT, when={LANDING: _KEPT},
           attributes=("state_units",)),
        _a("/filter/error", "run time state", "{mixed}", "truth minus estimate, after the update", (LANDING, LIVE),
           when={LANDING: _KEPT}),
        _a("/filter/sigma", "run time state", "{mixed}", "1 sigma of the filter, after the update",
           (*_FLOWN, REPLAY, LIVE), when={LANDING: _KEPT}),
        _a("/filter/position_llh", "run time llh", "rad, rad, m", "estimated position of the IMU", (REPLAY, LIVE)),
        _a("/filter/velocity_ned", "run time ned", "m/s", "estimated velocity over ground", (REPLAY, LIVE)),
        _a("/filter/attitude_rpy", "run time rpy", "rad", "estimated roll, pitch, yaw", REPLAY),
        _labels("/filter/axis", "body axes, forward-right-down", REPLAY, "x", "y", "z"),
        _a("/filter/gyro_bias", "run time axis", "rad/s", "estimated bias of the gyros", REPLAY),
        _a("/filter/accelerometer_bias", "run time axis", "m/s2", "estimated bias of the accelerometers", REPLAY),
        _a("/filter/nees", "run time", "1",
           "normalised estimation error squared of all states, in the coordinates of the filter kind; not divided by "
           "its degrees of freedom, which are the states that have any "
           "uncertainty", LANDING, when=_KEPT, attributes=("degrees_of_freedom",)),
        _a("/filter/nees_position_velocity", "run time", "1",
           "normalised estimation error squared of position and velocity", LANDING, when=_KEPT,
           attributes=("degrees_of_freedom",)),
        _a("/filter/deviation_{axis}", "run time", "m", "deviation of a run from the route, {axis}", LANDING,
           when=f"{_WAYS}, {_KEPT}", axis=RUNWAY_AXES),
        _a("/filter/gust_{axis}", "run time", "m/s", "gusts and turbulence in addition to the mean wind "
           "(`/truth/wind_ned`), {axis}: to the right of the course, along it, up; both together are the wind that the "
           "aircraft meets",
           LANDING, when=f"{_WAYS}, {_ALL}", axis=RUNWAY_AXES),
        _a("/filter/epoch", "epoch", "s", "fix epochs, time of validity", LANDING, when=_KEPT),
        _a("/filter/innovation_squared", "run epoch", "1",
           "normalised innovation squared, nan without a measurement", LANDING, when=_KEPT,
           attributes=("degrees_of_freedom",)),
        _a("/filter/start_position_llh", "run llh", "rad, rad, m", "position that the filter starts from at time 0",
           LANDING, when=_ALL),
        _a("/filter/start_velocity_ned", "run ned", "m/s", "velocity that the filter starts from", LANDING, when=_ALL),
        _a("/filter/start_attitude_rpy", "run rpy", "rad", "roll, pitch, yaw that the filter starts from", LANDING,
           when=_ALL),
        _a("/filter/start_sigma", "state", "{mixed}", "1 sigma that the filter starts from, without "
           "correlations", LANDING, when=_ALL),
        _a("/filter/state_decay", "state", "1/s", "reciprocal of the correlation time of each sensor state of the "
           "filter, 0 of a constant or a random walk", LANDING, when=_ALL),
        _a("/filter/state_drive", "state", "{mixed}", "root of the density of the white noise that drives each sensor "
           "state, in its unit by the root of a second", LANDING, when=_ALL),
        _a("/filter/noise_gyro", "", "rad/sqrt(s)", "root of the density of white noise that the filter takes the "
           "gyros for", LANDING, when=_ALL),
        _a("/filter/noise_accelerometer", "", "m/s/sqrt(s)", "root of the density of white noise that the filter takes "
           "the accelerometers for", LANDING, when=_ALL),
        _labels("/filter/fix_number", "numbers of a fix", LANDING, "position_north", "position_east", "position_down",
                "velocity_north", "velocity_east", "velocity_down"),
        _labels("/filter/fix_column", "columns of matrices of these numbers", LANDING, "position_north",
                "position_east", "position_down", "velocity_north", "velocity_east", "velocity_down"),
        _a("/filter/fix_position_llh", "run epoch llh", "rad, rad, m", "fixes of the antenna that the filter uses, "
           "nan where it uses none: minus the errors that it knows, without those that a monitor excludes",
           LANDING, when=_LOOSE),
        _a("/filter/fix_velocity_ned", "run epoch ned", "m/s", "their velocities, nan where the filter uses none",
           LANDING, when=_LOOSE),
        _a("/filter/fix_covariance", "run epoch fix_number fix_column", "m2, m2/s, m2/s2", "covariance of position and "
           "velocity, NED, of a fix in the filter model, without the errors that it estimates as states",
           LANDING, when=_LOOSE),
        _a("/filter/fix_error", "fix_error", "1", "states of the filter for time-correlated errors of fixes",
           LANDING, TEXT, when=_CORRELATED),
        _a("/filter/fix_effect", "epoch fix_number fix_error", "m, m/s", "effect of an error of 1 of each of these "
           "states on a fix", LANDING, when=_CORRELATED),
        _a("/filter/source", "source", "1", "names of the sources", LANDING, TEXT, when=_TIGHT),
        _a("/filter/range_status", "run epoch source", "1",
           "0 not received, 1 used, 2 rejected by the gate", LANDING, WHOLE, when=_TIGHT),
        _a("/filter/fix_status", "run epoch", "1",
           "0 no fix, 1 used, 2 rejected by the gate; tightly coupled: 0 no range, 1 some used, 2 all rejected",
           LANDING, WHOLE, when=_KEPT),
        _a("/innovations/time", "time", "s", "time stamps of the fixes since the epoch", (REPLAY, LIVE)),
        _a("/innovations/{part}_ned", "time ned", "m", "fix minus prediction, {part}, nan if not used",
           (REPLAY, LIVE), part=("position",)),
        _a("/innovations/{part}_ned", "time ned", "m/s", "fix minus prediction, {part}, nan if not used",
           (REPLAY, LIVE), part=("velocity",)),
        _a("/innovations/{part}_ned_sigma", "time ned", "m", "1 sigma of the innovation, {part}", REPLAY,
           part=("position",)),
        _a("/innovations/{part}_ned_sigma", "time ned", "m/s", "1 sigma of the innovation, {part}", REPLAY,
           part=("velocity",)),
        _a("/innovations/normalized_squared", "time", "1", "normalised innovation squared, nan without a fix",
           (REPLAY, LIVE)),
        _a("/innovations/degrees", "time", "1", "degrees of freedom of the normalised innovation squared",
           (REPLAY, LIVE), WHOLE),
        _a("/innovations/status", "time", "1", "0 no fix, 1 used, 2 rejected by the gate", (REPLAY, LIVE), WHOLE),
        _a("/innovations/source", "source", "1", "names of the satellites", REPLAY, TEXT, when=_TIGHT_REPLAY),
        _a("/innovations/range", "time source", "m", "pseudorange minus prediction, nan if missing", REPLAY,
           when=_TIGHT_REPLAY),
        _a("/innovations/range_rate", "time source", "m/s", "innovations of range rates, likewise",
           REPLAY, when=_TIGHT_REPLAY),
        _a("/innovations/range_status", "time source", "1", "0 none, 1 used, 2 rejected by the gate", REPLAY, WHOLE,
           when=_TIGHT_REPLAY),
        _a("/innovations/off_flight_ned", "time ned", "m", "fix minus the flight's antenna position", LIVE),
        _a("/innovations/fix_sigma", "time", "m", "1 sigma of the scenario's fixes in space", LIVE),
        _a("/aiding/{sensor}/time", "time", "s", "times of the measurements since the epoch", LANDING, when=_KEPT),
        _a("/aiding/{sensor}/number", "number", "1", "measured quantity", LANDING, TEXT, when=_ALL),
        _a("/aiding/{sensor}/measured", "run time number", "{unit}", "as measured", LANDING, when=_ALL),
        _a("/aiding/{sensor}/sigma", "time number", "{unit}", "1 sigma of the white noise, on the route", LANDING,
           when=_ALL),
        _a("/aiding/{sensor}/innovation_squared", "run time", "1",
           "normalised innovation squared, nan without a measurement", LANDING, when=_KEPT,
           attributes=("degrees_of_freedom",)),
        _a("/aiding/{sensor}/status", "run time", "1", "0 not used, 1 used, 2 rejected by the gate", LANDING, WHOLE,
           when=_KEPT),
    ),
)  # fmt: skip

_CONSISTENCY = Chapter(
    "Consistency of every state",
    "Errors of each state in units of the filter's sigma, at every output: `/summary/consistency/verdict` is by these. "
    "Results of layouts before version 4 do not have them.",
    (
        _a("/consistency/time", "time", "s", "times of the filter's outputs", _FLOWN),
        _a("/consistency/state", "state", "1", "states of the filter", _FLOWN, TEXT),
        _a("/consistency/z", "time state", "1", "root mean square over runs of error / sigma, in plain coordinates; "
           "nan if the state has no uncertainty or is not finite; of a covariance analysis the expected one. The "
           "ratios of a consistent filter stay within the band in every state at every output in 999 of 1000 "
           "ensembles; runs: 0 for an expectation", _FLOWN, attributes=("band_low", "band_high", "runs")),
        _a("/consistency/beyond_95", "time state", "1", "share of runs with an error beyond 1.960 sigma, 5 % is right",
           LANDING),
        _a("/consistency/beyond_99_9", "time state", "1", "share of runs with an error beyond 3.291 sigma, 0.1 % is "
           "right", LANDING),
    ),
)  # fmt: skip

_ANALYSIS = Chapter(
    "Covariance analysis",
    "Errors to first order, and the budget of their sources.",
    (
        _a("/covariance/time", "time", "s", "times of `/filter/time`", COVARIANCE),
        _a("/covariance/state", "state", "1", "states of the filter", COVARIANCE, TEXT, attributes=("state_units",)),
        _a("/covariance/rms", "time state", "{mixed}", "true root mean square error, after the update", COVARIANCE),
        _a("/covariance/mean", "time state", "{mixed}", "mean error, truth minus estimate", COVARIANCE),
        _a("/budget/source", "source", "1", "sources of error", COVARIANCE, TEXT),
        _a("/budget/time", "time", "s", "times of `/filter/time`", COVARIANCE),
        _a("/budget/state", "state", "1", "states of the filter", COVARIANCE, TEXT, attributes=("state_units",)),
        _a("/budget/rms", "source time state", "{mixed}", "root mean square error from each source alone", COVARIANCE),
    ),
)  # fmt: skip

_SUMMARY = Chapter(
    "Summary of a landing",
    "The numbers that `navsim show` prints, and `--json` under the same names.",
    (
        _a("/summary/dop/{dop}", "statistic", "1", "{DOP} over the fix epochs of the glide", _FLOWN, dop=_DOPS),
        _a("/summary/beacons/{dop}", "statistic", "1", "{DOP} of the beacons over the fix epochs of the glide", _FLOWN,
           when=_BEACONS, dop=_DOPS[1:4]),
        _a("/summary/beacons/{dop}_with_sources", "statistic", "1", "{DOP} of beacons and sources of the fix together, "
           "likewise", _FLOWN, when=_BEACONS, dop=_DOPS[1:4]),
        _a("/summary/at/{axis}_without_beacons", "height", "m", "{axis} position at the heights, sigma of the filter "
           "without beacons", COVARIANCE, when=_BEACONS, axis=("lateral", "vertical")),
        _a("/summary/used/{part}", "statistic", "1", "number of {part} used over the fix epochs of the glide", _FLOWN,
           part=("satellites", "pseudolites")),
        _a("/summary/fix/rms_{part}", "interval", "m", "sigma of a fix (SKO): root of the weighted covariance, mean "
           "over the fix epochs of the glide; a prediction, without sampling uncertainty", _FLOWN,
           attributes=("minimum", "maximum"), part=("horizontal", "vertical", "3d")),
        _a("/summary/rms/position_ned", "ned interval", "m", f"position error, {_RMS}", _FLOWN),
        _a("/summary/rms/velocity_ned", "ned interval", "m/s", f"velocity error, {_RMS}", _FLOWN),
        _a("/summary/rms/attitude", "ned interval", "rad", f"attitude error, {_RMS}", _FLOWN),
        _a("/summary/rms/attitude_rpy", "rpy interval", "rad",
           f"roll, pitch, yaw error, true minus estimated, {_RMS}", _FLOWN),
        _a("/summary/rms/{part}", "interval", "m", "{part} error, " + _RMS, _FLOWN, part=("horizontal", "vertical")),
        _a("/summary/rms/{part}_percentile", "percentile", "m",
           f"percentiles over runs of the {{part}} error, root mean square {_LATE}", LANDING,
           part=("horizontal", "vertical")),
        _a("/summary/sigma/position_ned", "ned", "m", f"position, {_SIGMA} and {_LATE}", _FLOWN),
        _a("/summary/sigma/velocity_ned", "ned", "m/s", f"velocity, {_SIGMA} and {_LATE}", _FLOWN),
        _a("/summary/sigma/attitude", "ned", "rad", f"attitude, {_SIGMA} and {_LATE}", _FLOWN),
        _a("/summary/sigma/attitude_rpy", "rpy", "rad", f"roll, pitch, yaw, {_SIGMA} and {_LATE}", _FLOWN),
        _a("/summary/sigma/{part}", "", "m", f"{{part}} position, {_SIGMA} and {_LATE}", _FLOWN,
           part=("horizontal", "vertical")),
        _a("/summary/percentile", "percentile", "1", "percentiles over runs of the size of an error", _FLOWN, WHOLE),
        _a("/summary/at/height", "height", "m", f"true height above the runway: {_HEIGHTS}", _FLOWN),
        _a("/summary/at/{axis}", "height interval", "m", "root mean square over runs of the {axis} position error",
           _FLOWN, axis=RUNWAY_AXES),
        _a("/summary/at/{axis}_sigma", "height", "m", f"{{axis}} position, {_SIGMA}", _FLOWN, axis=RUNWAY_AXES),
        _a("/summary/at/{axis}_run", "run height", "m", "{axis} position error of each run, truth minus estimate",
           LANDING, axis=RUNWAY_AXES),
        _a("/summary/at/{axis}_percentile", "height percentile", "m",
           "percentiles over runs of the size of the {axis} position error", _FLOWN, axis=RUNWAY_AXES),
        _a("/summary/track/rms_smoothed", "", "m",
           "rms distance of the smoothed trajectory from the places of the table", _FLOWN, when=_TRACK),
        _a("/summary/track/specific_force", "", "m/s2", "its largest specific force", _FLOWN, when=_TRACK),
        _a("/summary/track/rate", "", "rad/s", "its largest rate against inertial space", _FLOWN, when=_TRACK),
        _a("/summary/at/{axis}_fte", "height interval", "m",
           "root mean square over runs of the {axis} flight-technical error, the deviation from the route, including "
           "gusts and turbulence", LANDING,
           when=_WAYS, axis=RUNWAY_AXES),
        _a("/summary/at/{axis}_fte_run", "run height", "m",
           "{axis} flight-technical error of each run, when the route passes the height; with guidance by the "
           "estimate, deviation of the estimate from the route", LANDING, when=_WAYS,
           axis=RUNWAY_AXES),
        _a("/summary/at/{axis}_tse", "height interval", "m",
           "root mean square over runs of the {axis} total system error", LANDING, when=_WAYS, axis=RUNWAY_AXES),
        _a("/summary/at/{axis}_tse_run", "run height", "m",
           "{axis} total system error of each run: its flight-technical error plus its position error", LANDING,
           when=_WAYS, axis=RUNWAY_AXES),
        _a("/summary/at/{axis}_tse_percentile", "height percentile", "m",
           "percentiles over runs of the size of the {axis} total system error", LANDING, when=_WAYS, axis=RUNWAY_AXES),
        *(
            entry
            for kind, whose in (("", "aircraft"), ("_indicated", "estimate, as the pilot sees it"))
            for entry in (
                _a(f"/summary/at/{{seen}}{kind}", "height interval", "1", "root mean square over runs of the {seen} "
                   f"deviation of the {whose}, in parts of full scale", LANDING, when=_INDICATED, seen=INDICATED),
                _a(f"/summary/at/{{seen}}{kind}_run", "run height", "1", "likewise of each run, right and up positive; "
                   "nan at touchdown for the glide path", LANDING, when=_INDICATED, seen=INDICATED),
                _a(f"/summary/indicator/{{seen}}{kind}_largest_run", "run", "1", "largest {seen} deviation of the "
                   f"{whose} from `from_time` to `until_time`, in parts of full scale", LANDING, when=_INDICATED,
                   seen=INDICATED),
                _a(f"/summary/indicator/{{seen}}{kind}_percentile", "percentile", "1", "percentiles over runs of it",
                   LANDING, when=_INDICATED, seen=INDICATED),
                _a(f"/summary/indicator/{{seen}}{kind}_beyond_{{part}}", "interval", "1", "share of runs with more "
                   "than {part} scale, of those with a deviation", LANDING, when=_INDICATED, seen=INDICATED,
                   part=("half", "full")),
            )
        ),
        _a("/summary/indicator/from_time", "", "s", "when the route is established on course and glide path", LANDING,
           when=_INDICATED),
        _a("/summary/indicator/until_time", "", "s", "when the route is `until_height_m` above the runway", LANDING,
           when=_INDICATED),
        *(
            _a(f"/summary/indicator/scale_{name}", "", unit, f"scales of these deviations: {meaning}", LANDING,
               when=_INDICATED)
            for name, unit, meaning in (
                ("origin", "m", "distance of the vertex of the course beyond the threshold"),
                ("aim", "m", "distance of the touchdown point beyond the threshold"),
                ("width", "m", "full scale from the centre line at the threshold"),
                ("angle", "rad", "angle of the glide path"),
                ("share", "1", "full scale of the glide path as a part of its angle"),
                ("foot", "m", "distance of the foot of the glide path beyond the touchdown point"),
            )
        ),
        _a("/summary/indicator/touchdown_llh", "llh", "rad, rad, m", "touchdown point of the route", LANDING,
           when=_INDICATED),
        _a("/summary/fix_states/state", "state", "1", "states of fixes", LANDING, TEXT, when=_STATED),
        _a("/summary/fix_states/share", "state interval", "1", "share of the fixes in each state", LANDING,
           when=_STATED),
        _a("/summary/fix_states/stationary", "state", "1", "stationary share of time in each state, without "
           "forced states", LANDING, when=_STATED),
        _a("/summary/fix_states/rms_{part}", "state", "m", "root mean square {part} error of each state, of one axis",
           LANDING, when=_STATED, part=("horizontal", "vertical")),
        _a("/summary/fix_states/wrong_share", "", "1", "share of wrong fixes among those that are flagged as fixed",
           LANDING, when=_STATED),
        _a("/summary/touchdown/landed", "", "1", "number of runs that touch down", LANDING, WHOLE, when=_WAYS),
        *(
            entry
            for name, units, meaning in (
                ("time", "s", "time when a run touches down"),
                ("along", "m", "where a run touches down, beyond the threshold"),
                ("lateral", "m", "where a run touches down, right of the centre line"),
                ("sink_rate", "m/s", "sink rate relative to the runway when a run touches down"),
            )
            for entry in (
                _a(f"/summary/touchdown/{name}", "interval", units, f"{meaning}: mean", LANDING, when=_WAYS),
                _a(f"/summary/touchdown/{name}_sigma", "", units, f"{meaning}: standard deviation", LANDING,
                   when=_WAYS),
                _a(f"/summary/touchdown/{name}_run", "run", units, f"{meaning}; nan where it does not", LANDING,
                   when=_WAYS),
            )
        ),
        *(
            _a(f"/summary/go_around/{name}", dims, units, meaning, LANDING, of, when=_BROKEN_OFF)
            for name, dims, units, meaning, of in (
                ("count", "", "1", "number of runs that go around after an alarm", WHOLE),
                ("share", "interval", "1", "share of runs that go around", NUMBER),
                ("touched", "", "1", "number of go-arounds that touch the ground", WHOLE),
                ("time_run", "run", "s", "when a run's pull-up begins; nan where none does", NUMBER),
                ("height_run", "run", "m", "height above the runway then", NUMBER),
                ("lowest_run", "run", "m", "lowest height above the runway after it, below 0 if it touches the ground",
                 NUMBER),
                ("lost_run", "run", "m", "height lost", NUMBER),
                ("lost_percentile", "percentile", "m", "percentiles of it over runs that go around", NUMBER),
                ("lost_largest", "", "m", "largest height lost", NUMBER),
            )
        ),
        _a("/summary/at/headwind", "height", "m/s", "mean wind against the course, at the heights", _FLOWN,
           when=_WIND),
        _a("/summary/at/crosswind", "height", "m/s", "mean wind across the course, from the left positive", _FLOWN,
           when=_WIND),
        _a("/summary/at/airspeed", "height", "m/s", "speed through the mean wind", _FLOWN, when=_WIND),
        _a("/summary/at/crab", "height", "rad", "crab angle of the nose to the right of the course", _FLOWN,
           when=_WIND),
        _a("/summary/coverage/level", "level", "1", "size of the ellipsoid in sigmas", LANDING),
        _a("/summary/coverage/position", "level interval", "1",
           "share of outputs after time 0 with the position error inside its ellipsoid", LANDING),
        _a("/summary/coverage/expected", "level", "1", "share of a Gaussian error", LANDING),
        _a("/summary/consistency/time", "time", "s", "time of the filter's output", _FLOWN),
        *(
            _a(f"/summary/consistency/{name}", "time", "1", f"{how} per degree of freedom: normalised {meaning}",
               layout, attributes=attributes)
            for layout, how, attributes in ((LANDING, "ensemble mean", _BAND),
                                          (COVARIANCE, "expected", ("degrees_of_freedom",)))
            for name, meaning in (
                ("nees", "estimation error squared of all states"),
                ("nees_position_velocity", "estimation error squared of position and velocity"),
                ("nis", "innovation squared"),
            )
        ),
        _a("/summary/consistency/group", "group", "1", "groups of three states", LANDING, TEXT),
        _a("/summary/consistency/nees_group", "time group", "1",
           "ensemble mean per degree of freedom of each group's normalised squared error; nan without uncertainty",
           LANDING, attributes=_BAND),
        _a("/summary/consistency/mean_group", "group", "1", f"mean of nees_group {_LATE}; one is right", LANDING),
        _a("/summary/consistency/verdict", "", "1", "verdict on all states at all outputs: the worst one by name and "
           "time, with its z; percent: of z - 1", _FLOWN, TEXT, attributes=("tolerance",)),
        _a("/summary/consistency/state", "state", "1", "states of the filter", _FLOWN, TEXT),
        _a("/summary/consistency/looks", "state", "1", "effective number of independent outputs, which determines the "
           "width of the band of `/consistency/z`", _FLOWN),
        _a("/summary/consistency/worst_z", "state", "1", "largest `/consistency/z` of each state; nan without "
           "uncertainty", _FLOWN),
        _a("/summary/consistency/worst_time", "state", "s", "time of worst_z", _FLOWN),
        _a("/summary/consistency/least_z", "state", "1", "smallest `/consistency/z` of each state", _FLOWN),
        _a("/summary/consistency/pair", "pair", "1", "errors of pseudolites (positions along the line of sight), each "
           "with another state, correlated beyond 0.99 at the end of the error-free flight", _FLOWN, TEXT,
           when=_TRANSMITTERS),
        _a("/summary/consistency/pair_correlation", "pair", "1", "their correlations", _FLOWN, when=_TRANSMITTERS),
        _a("/summary/consistency/worst_beyond_95", "state", "1", "`/consistency/beyond_95` at worst_time", LANDING),
        _a("/summary/consistency/worst_beyond_99_9", "state", "1", "`/consistency/beyond_99_9` at worst_time", LANDING),
        _a("/summary/budget/source", "source", "1", "sources of error", COVARIANCE, TEXT),
        _a("/summary/budget/{part}", "source", "m", "{part} error from each source alone, as in /summary/rms",
           COVARIANCE, part=("horizontal", "vertical")),
        _a("/summary/budget/{part}_share", "source", "1", "share of each source in the mean square {part} error",
           COVARIANCE, part=("horizontal", "vertical")),
        _a("/summary/aiding/{sensor}/nis", "", "1",
           "normalised innovation squared per degree of freedom, mean of all runs", LANDING),
        _a("/summary/aiding/{sensor}/rejected", "", "1", "measurements of all runs rejected by the gate", LANDING,
           WHOLE),
        _a("/summary/aiding/{sensor}/missing", "", "1",
           "times at which it measured nothing (height, attitude), of all runs", LANDING, WHOLE),
        _a("/summary/guidance/loop_gap", "", "m",
           "largest distance of all runs between the flown trajectory and the one that guidance by its estimate gives",
           LANDING, when="where the estimate steers"),
        _a("/summary/count/clipped_{inertial}", "", "1", "samples of the {inertial}s beyond their range, of all runs",
           LANDING, WHOLE, when="where an inertial sensor has a range", inertial=("gyro", "accelerometer")),
        _a("/summary/count/runs", "", "1", "number of runs; 0 in a covariance analysis", _FLOWN, WHOLE),
        _a("/summary/count/fixes", "", "1", "number of fixes, of all runs", (*_FLOWN, REPLAY), WHOLE),
        _a("/summary/count/epochs_without_fix", "", "1", "epochs without a fix, of all runs", _FLOWN, WHOLE),
        _a("/summary/count/rejected", "", "1", "fixes rejected by the gate, or ranges, of all runs",
           (LANDING, REPLAY), WHOLE),
    ),
)  # fmt: skip

_CONTROLLED_WHEN = "of 64 runs or more that have first-order errors"
_CONTROLLED_BY = "controlled by the exactly known first-order errors"
_GAIN = (
    "how many times as many runs would be as precise without control (RMS, mean: by the scatter of these runs; "
    "percentile, probability: by the intervals); nan where there is none"
)
_CONTROLLED = Chapter(
    "Summary of a landing by its first-order errors",
    "Narrower intervals from the same runs. The covariance analysis tells exactly how far the first-order errors of "
    "these runs are from those of all, and navsim corrects the estimate for it.",
    (
        *(
            _a(path, dims, units, meaning, LANDING, when=_CONTROLLED_WHEN, **each)
            for path, dims, units, meaning, each in (
                ("/summary/controlled/rms/{part}", "interval", "m", f"{{part}} error, {_RMS}, {_CONTROLLED_BY}",
                 {"part": ("horizontal", "vertical")}),
                ("/summary/controlled/rms/{part}_gain", "", "1", f"of the {{part}} RMS: {_GAIN}",
                 {"part": ("horizontal", "vertical")}),
                ("/summary/controlled/at/height", "height", "m", f"true height above the runway: {_HEIGHTS}", {}),
                ("/summary/controlled/at/{axis}", "height interval", "m",
                 f"root mean square of the {{axis}} position error, {_CONTROLLED_BY}", {"axis": RUNWAY_AXES}),
                ("/summary/controlled/at/{axis}_gain", "height", "1", f"of this RMS of the {{axis}} error: {_GAIN}",
                 {"axis": RUNWAY_AXES}),
                ("/summary/controlled/at/{axis}_mean", "height interval", "m",
                 f"mean {{axis}} position error, truth minus estimate, {_CONTROLLED_BY}", {"axis": RUNWAY_AXES}),
                ("/summary/controlled/at/{axis}_mean_gain", "height", "1", f"of the mean {{axis}} error: {_GAIN}",
                 {"axis": RUNWAY_AXES}),
                ("/summary/controlled/at/{axis}_percentile", "height percentile interval", "m",
                 f"percentiles of the size of the {{axis}} position error, {_CONTROLLED_BY}", {"axis": RUNWAY_AXES}),
                ("/summary/controlled/at/{axis}_percentile_gain", "height percentile", "1",
                 f"of these percentiles of the {{axis}} error: {_GAIN}", {"axis": RUNWAY_AXES}),
                ("/summary/controlled/at/{axis}_run", "run height", "m",
                 "{axis} position error of each run to first order, by all that was drawn", {"axis": RUNWAY_AXES}),
                ("/summary/controlled/at/{axis}_exact", "height", "m",
                 "root mean square of the {axis} first-order error, exact", {"axis": RUNWAY_AXES}),
            )
        ),
        *(
            _a(f"/summary/controlled/box/probability{name}", dims, "1", meaning, LANDING,
               when=f"{_CONTROLLED_WHEN}, with a box of navigation errors")
            for name, dims, meaning in (
                ("", "interval", f"probability that a landing ends outside the box, {_CONTROLLED_BY}"),
                ("_gain", "", f"of the probability to end outside the box: {_GAIN}"),
            )
        ),
        _a("/summary/controlled/why_none", "", "1", "why there are no controlled estimates", LANDING, TEXT,
           when="of 64 runs or more without first-order errors"),
    ),
)  # fmt: skip

_BOX_AXES = "position errors in axes of the runway: lateral (right), along (forward), vertical (up)"
_BOX_WHEN = "where the scenario has a box"
_BOX = Chapter(
    "Leaving a box",
    "Probability that a landing ends outside the scenario's box: counted, from the covariance analysis, or by "
    "importance sampling.",
    (
        _labels("/axis", _BOX_AXES, RARE, *RUNWAY_AXES),
        _a("/rare/error", "run axis", "m", "error that the box limits, by `box.error`", RARE),
        _a("/rare/first_order", "run axis", "m", "the same error to first order, from all that was drawn", RARE),
        _a("/rare/log_weight", "run", "1",
           "natural logarithm of the density of the run's inputs over that which they were drawn from", RARE),
        _a("/rare/history_log_weight", "run", "1", "the part of it that the states of the fixes have", RARE,
           when=_STATED),
        _a("/rare/go_around_time", "run", "s", "begin of the run's go-around, nan for none; those that go around "
           "before the time of the box have no error there", RARE, when=_BROKEN_OFF),
        *(
            _a(path, dims, units, meaning, layouts, of, when=dict.fromkeys(_FLOWN, _BOX_WHEN))
            for path, dims, units, meaning, layouts, of in (
                ("/summary/box/axis", "axis", "1", _BOX_AXES, _FLOWN, TEXT),
                ("/summary/box/height", "", "m", "true height above the runway at which errors are evaluated",
                 (*_FLOWN, RARE), NUMBER),
                ("/summary/box/time", "", "s", "time of the last descent through it", (*_FLOWN, RARE), NUMBER),
                ("/summary/box/lower", "axis", "m", "least error inside the box, -inf for none", (*_FLOWN, RARE),
                 NUMBER),
                ("/summary/box/upper", "axis", "m", "largest error inside the box, inf for none", (*_FLOWN, RARE),
                 NUMBER),
                ("/summary/box/probability", "interval", "1", "share of runs that end outside the box", (LANDING,),
                 NUMBER),
                ("/summary/box/axis_probability", "axis interval", "1",
                 "share of runs whose error exceeds its limit, nan for none", (LANDING,), NUMBER),
                ("/summary/box/outside", "", "1", "number of runs that end outside the box", (LANDING,), WHOLE),
                ("/summary/box/error_run", "run axis", "m",
                 "position error of each run at the height of the box, truth minus estimate, or its total system "
                 "error, or its touchdown from that of the route; nan after a go-around",
                 (LANDING,), NUMBER),
                ("/summary/box/axis_first_order", "axis", "1",
                 "chance that a Gaussian error of this mean and sigma exceeds its limit, nan for none",
                 (COVARIANCE, RARE), NUMBER),
                ("/summary/box/axis_sigma", "axis", "m", "1 sigma of the error to first order",
                 (COVARIANCE, RARE), NUMBER),
                ("/summary/box/axis_mean", "axis", "m", "mean error to first order", (COVARIANCE, RARE),
                 NUMBER),
            )
        ),
        _a("/summary/box/place", "", "m",
           "position of the route at that time, along the runway from the threshold; limits along are relative to it",
           (*_FLOWN, RARE), when="where the scenario has `box.from_threshold_m`"),
        _a("/summary/box/axis_gaussian", "axis", "1",
           "chance that a Gaussian error with the mean and sigma of the runs exceeds its limit, nan for none", LANDING,
           when=f"{_BOX_WHEN}, with `box.error` total or touchdown"),
        _a("/summary/rare/probability", "interval", "1",
           "probability that a landing ends outside the box; nan, its interval from 0, if it is below 1e-300", RARE),
        _a("/summary/rare/axis_probability", "axis interval", "1",
           "probability that this error exceeds its limit, nan for no limit", RARE),
        _a("/summary/rare/relative_error", "", "1",
           "1 sigma of the probability over itself; nan where no run, or every one, is outside", RARE),
        _a("/summary/rare/effective_samples", "", "1",
           "effective number of equally weighted runs outside the box", RARE),
        _a("/summary/rare/axis_effective_samples", "axis", "1", "number of equally weighted runs beyond the limit of "
           "each error, nan for none", RARE),
        _a("/summary/rare/go_around", "interval", "1", "probability that an alarm breaks a landing off", RARE,
           when=_BROKEN_OFF),
        _a("/summary/rare/go_around_effective_samples", "", "1", "number of equally weighted runs that go around", RARE,
           when=_BROKEN_OFF),
        _a("/summary/rare/landings", "", "1", "number of runs", RARE, WHOLE),
        _a("/summary/rare/outside", "", "1", "number of them outside the box", RARE, WHOLE),
        _a("/summary/count/runs", "", "1", "number of runs", RARE, WHOLE),
    ),
)  # fmt: skip

_JAMMED = "where the scenario has `interference`"
_INTERFERENCE = Chapter(
    "Interference",
    "Signals under jamming; all runs share them.",
    (
        _a("/interference/time", "time", "s", "fix epochs, time of validity since the epoch", _FLOWN, when=_JAMMED),
        _a("/interference/source", "source", "1", "names of the sources", _FLOWN, TEXT, when=_JAMMED),
        _a("/interference/jammer", "jammer", "1", "names of the jammers, followed by pseudolites if they jam",
           _FLOWN, TEXT, when=_JAMMED),
        _a("/interference/js", "jammer time source", "dB", "jammer to signal power ratio, of pulses while they last; "
           "-inf while the jammer is not received, nan where the signal is not", _FLOWN, when=_JAMMED),
        _a("/interference/cn0", "time source", "dB-Hz", "effective carrier to noise density ratio, nan if the signal "
           "is not used", _FLOWN, when=_JAMMED),
        _a("/interference/held", "time source", "1", "1 if the signal is used", _FLOWN, WHOLE, when=_JAMMED),
    ),
)  # fmt: skip

_LINKED = "where the scenario has `pseudolites.differential.link`"
_CORRECTIONS = Chapter(
    "Corrections for satellites",
    "Their reception over a link, in an example of lost messages; each run loses its own.",
    (
        _a("/corrections/time", "time", "s", "fix epochs, time of validity since the epoch", _FLOWN, when=_LINKED),
        _a("/corrections/age", "time", "s", "age of the corrections in use, inf where there are none", _FLOWN,
           when=_LINKED),
    ),
)  # fmt: skip

_WATCHED = "where the scenario has `integrity`"
_WATCHED_KEPT = f"{_WATCHED}, {_KEPT}"
_SEPARATED = f"{_WATCHED} with method mhss or filter"
_ASKED = f"{_WATCHED} with limits"
_SAMPLED = f"{_WATCHED} with tails"
_EXCLUDING = f"{_WATCHED} with exclusion"
_COMPARED_SBAS, _COMPARED_GBAS = (f"{_WATCHED} with comparison.{form}" for form in ("sbas", "gbas"))
_DRAWN_B = f"{_COMPARED_GBAS} and drawn B values"
_DRAWN_B_KEPT = f"{_DRAWN_B}, {_KEPT}"
_TRIED = f"{_WATCHED} with innovations"
_TRIED_KEPT = f"{_TRIED}, {_KEPT}"
_EXCLUDING_KEPT = f"{_EXCLUDING}, {_KEPT}"
_EXCLUDING_ASKED = f"{_EXCLUDING} and limits"
_INTEGRITY = Chapter(
    "Integrity",
    "Monitoring of the fixes: protection levels from the geometry, and alarms in the simulated runs. Intervals of "
    "shares of epochs are over runs, since the epochs of a run are correlated.",
    (
        _a("/integrity/time", "time", "s", "fix epochs, time of validity since the epoch", _FLOWN, when=_WATCHED),
        _a("/integrity/hpl", "time", "m", "horizontal protection level of a fix from all sources used. With method "
           "filter it is the filter's after this fix, as are all that follow. Inf if a range is unchecked, nan without "
           "a fix", _FLOWN, when=_WATCHED),
        _a("/integrity/vpl", "time", "m", "vertical protection level, the same", _FLOWN, when=_WATCHED),
        _a("/integrity/level_{axis}", "time", "m", "protection level of the {axis} error, in axes of the runway",
           _FLOWN, when=_WATCHED, axis=("lateral", "along")),
        _a("/integrity/sbas_{level}", "time", "m", "{LEVEL} that the form of SBAS gives the fix from all that is used; "
           "nan without a fix", _FLOWN, when=_COMPARED_SBAS, level=("hpl", "vpl")),
        _a("/integrity/gbas_{level}", "time", "m", "{LEVEL} that the form of GBAS gives it, the larger with and "
           "without a faulty reference receiver; across the track (lpl) and over the glide path (vpl). With drawn B "
           "values: without", _FLOWN, when=_COMPARED_GBAS, level=("lpl", "vpl")),
        _a("/integrity/gbas_{level}_run", "run time", "m", "{LEVEL} by the B values of the run, the larger with and "
           "without a faulty reference receiver, for GAST D plus D_L or D_V (unverified); nan without a fix", LANDING,
           when=_DRAWN_B_KEPT, level=("lpl", "vpl")),
        _a("/integrity/gbas_error_{axis}", "run time", "m", "size of the error of the fix that this level is of",
           LANDING, when=_DRAWN_B_KEPT, axis=("lateral", "vertical")),
        _a("/integrity/gbas_b_{axis}", "run time", "m", "largest effect of the B values of a reference receiver on the "
           "fix", LANDING, when=_DRAWN_B_KEPT, axis=("lateral", "vertical")),
        _a("/integrity/gbas_d_{axis}", "run time", "m", "size of the difference between positions from ranges smoothed "
           "over 30 s and over 100 s, D_L or D_V", LANDING, when=f"{_DRAWN_B_KEPT}, of GAST D",
           axis=("lateral", "vertical")),
        _a("/integrity/sigma_vertical", "time", "m", "fault-free 1 sigma of the vertical error of the fix, or the "
           "filter; nan without one", _FLOWN, when=_WATCHED),
        _a("/integrity/threshold", "time", "1", "largest statistic without an alarm", _FLOWN, when=_WATCHED),
        _a("/integrity/fault", "fault", "1", "faults that are expected, of sources that are used", _FLOWN, TEXT,
           when=_SEPARATED),
        _a("/integrity/prior", "fault", "1", "their probabilities", _FLOWN, when=_SEPARATED),
        _a("/integrity/monitored", "fault time", "1", "1 if the solution without the fault is compared", _FLOWN, WHOLE,
           when=_SEPARATED),
        _a("/integrity/unmonitored", "time", "1", "probability of unmonitored faults", _FLOWN, when=_SEPARATED),
        _a("/integrity/emt", "time", "m", "effective monitor threshold", _FLOWN, when=_SEPARATED),
        _a("/integrity/statistic", "run time", "1", "square of the residuals in sigmas (chi2), or the largest "
           "difference of fixes, or filters, by its threshold (mhss, filter); nan without a fix", LANDING,
           when=_WATCHED_KEPT),
        _a("/integrity/status", "run time", "1", "0 no fix, or nothing received (filter); 1 nothing to test it by, 2 "
           "nothing wrong, 3 alarm, 4 alarm, and a source or fault excluded; 0 and 3 are alerts", LANDING, WHOLE,
           when=_WATCHED_KEPT),
        _a("/integrity/error_{axis}", "run time", "m", "size of the {axis} error of the fix, or the filter", LANDING,
           when=_WATCHED_KEPT, axis=("horizontal", "vertical")),
        _a("/integrity/innovation_ratio", "run time", "1", "sum of the normalised innovations squared of a window "
           "relative to its threshold, above which it is an alarm; nan without a measurement",
           LANDING, when=_TRIED_KEPT),
        _a("/integrity/{limit}", "time", "m", "{LIMIT} at each fix epoch, inf for none", _FLOWN,
           when=f"{_ASKED}.grow_with_distance", limit=("hal", "val")),
        _a("/integrity/candidate", "candidate", "1", "sources or faults that may be excluded", LANDING, TEXT,
           when=_EXCLUDING),
        _a("/integrity/excluded", "run time", "1", "number of the candidate that the fix is made without, from 0; -1 "
           "for none", LANDING, WHOLE, when=_EXCLUDING_KEPT),
        _a("/integrity/{level}_run", "run time", "m", "{LEVEL} of the fix, after an exclusion that of the remaining "
           "sources; nan without a test", LANDING, when=_EXCLUDING_KEPT, level=("hpl", "vpl")),
        _a("/integrity/tails/at", "at", "s", "fix epochs at which risks beyond the levels are sampled", _FLOWN,
           when=_SAMPLED),
        _a("/integrity/tails/axis", "axis", "1", "axes of the levels", _FLOWN, TEXT, when=_SAMPLED),
        _a("/integrity/tails/fault", "fault", "1", "no fault, then faults (mhss) or sources (chi2)", _FLOWN, TEXT,
           when=_SAMPLED),
        _a("/integrity/tails/level", "at axis", "m", "protection level along the axis; nan or inf without one",
           _FLOWN, when=_SAMPLED),
        _a("/integrity/tails/bias", "at axis fault", "m", "largest bias of a range of the fault: the biases that most "
           "often exceed the level without an alarm", _FLOWN, when=_SAMPLED),
        _a("/integrity/tails/risk", "at axis fault interval", "1", "chance to be beyond the level without an alarm, if "
           "the fault is there with these biases, and nominal ones at their worst (mhss)", _FLOWN, when=_SAMPLED),
        _a("/integrity/tails/effective", "at axis fault", "1", "effective number of equally weighted samples", _FLOWN,
           when=_SAMPLED),
        _a("/integrity/tails/total", "at axis interval", "1", "sum over all faults by their probabilities, and "
           "unmonitored faults (mhss); the largest of them (chi2)", _FLOWN, when=_SAMPLED),
        _a("/integrity/tails/allowed", "axis", "1", "largest allowed risk: p_hmi_v or half of p_hmi_h (mhss), p_md "
           "(chi2)",
           _FLOWN, when=_SAMPLED),
        _a("/summary/integrity/{level}", "statistic", "m", "{LEVEL} on the glide, if any", _FLOWN,
           when=_WATCHED, level=("hpl", "vpl")),
        _a("/summary/integrity/level_{axis}", "statistic", "m", "level of the {axis} error on the glide, if any",
           _FLOWN, when=_WATCHED, axis=("lateral", "along")),
        _a("/summary/integrity/sbas_{level}", "statistic", "m", "{LEVEL} on the glide by the form of SBAS", _FLOWN,
           when=_COMPARED_SBAS, level=("hpl", "vpl")),
        _a("/summary/integrity/gbas_{level}", "statistic", "m", "{LEVEL} on the glide by the form of GBAS", _FLOWN,
           when=_COMPARED_GBAS, level=("lpl", "vpl")),
        _a("/summary/integrity/gbas_{level}_run", "statistic", "m", "mean {LEVEL} on the glide of each run, by its "
           "B values", LANDING, when=_DRAWN_B, level=("lpl", "vpl")),
        _a("/summary/integrity/gbas_exceeded_{axis}", "interval", "1", "share of fixes on the glide whose {axis} error "
           "exceeds the level by B values", LANDING, when=_DRAWN_B, axis=("lateral", "vertical")),
        _a("/summary/integrity/level_share", "", "1", "share of the epochs of the glide with protection levels", _FLOWN,
           when=_WATCHED),
        _a("/summary/integrity/hal", "", "m", "horizontal alert limit, inf for none; the smallest on the glide", _FLOWN,
           when=_ASKED),
        _a("/summary/integrity/val", "", "m", "vertical alert limit, inf for none; the smallest on the glide", _FLOWN,
           when=_ASKED),
        _a("/summary/integrity/tta", "", "s", "time to alert that is asked for", _FLOWN, when=_ASKED),
        _a("/summary/integrity/tested", "", "1", "fixes on the glide that were tested, of all runs", LANDING, WHOLE,
           when=_WATCHED),
        _a("/summary/integrity/alarms", "", "1", "number of these with an alarm, without exclusions", LANDING, WHOLE,
           when=_WATCHED),
        _a("/summary/integrity/lost", "", "1", "epochs on the glide, of all runs, without a fix, or with nothing "
           "received (filter): alerts, too, but none of the alarms", LANDING, WHOLE, when=_WATCHED),
        _a("/summary/integrity/alarm_share", "interval", "1", "their share", LANDING, when=_WATCHED),
        _a("/summary/integrity/exceeded_{axis}", "interval", "1", "share of tested fixes on the glide whose {axis} "
           "error is beyond its protection level without an alarm", LANDING, when=_WATCHED,
           axis=("horizontal", "vertical")),
        _a("/summary/integrity/innovation_alarms", "", "1", "epochs on the glide with an alarm by the innovations, of "
           "all runs; they are among the alarms", LANDING, WHOLE, when=_TRIED),
        _a("/summary/integrity/innovation_share", "interval", "1", "their share", LANDING, when=_TRIED),
        _a("/summary/integrity/exclusions", "", "1", "fixes on the glide after an exclusion, of all runs; they do not "
           "count as alarms", LANDING, WHOLE, when=_EXCLUDING),
        _a("/summary/integrity/exclusions_{outcome}", "", "1", "outcome of the exclusions during events: "
           "correct, no affected source remains; wrong, one remains; needless, without an event", LANDING, WHOLE,
           when=_EXCLUDING, outcome=("correct", "wrong", "needless")),
        _a("/summary/integrity/exclusion_share", "interval", "1", "share of exclusions among them and the alarms",
           LANDING, when=_EXCLUDING),
        _a("/summary/integrity/exclusion_wrong_share", "interval", "1", "share of wrong ones among exclusions during "
           "events", LANDING, when=_EXCLUDING),
        _a("/summary/integrity/exclusions_available", "interval", "1", "share of fixes after an exclusion whose levels "
           "are within their limits", LANDING, when=_EXCLUDING_ASKED),
        _a("/summary/integrity/availability", "interval", "1", "share of the epochs of the glide with a tested fix, no "
           "alarm, and levels within their limits", LANDING, when=_ASKED),
        _a("/summary/integrity/approaches", "interval", "1", "share of runs with that at every epoch from "
           "integrity.decision_height_m to touchdown", LANDING, when=_ASKED),
        _a("/summary/integrity/continuity_risk", "interval", "1", "share of intervals of 15 s on the glide that begin "
           "available and lose availability; nan without any", LANDING, when=_ASKED),
        _a("/summary/integrity/hmi", "interval", "1", "share of runs with hazardously misleading information: an error "
           "beyond its limit for longer than the time to alert, or to the end, no alarm, the level within it; nan "
           "without any level", LANDING, when=_ASKED),
        _a("/summary/integrity/hmi_{axis}", "interval", "1", "fraction of runs with hazardously misleading "
           "information, {axis} error", LANDING, when=_ASKED,
           axis=("horizontal", "vertical")),
        _a("/summary/integrity/time_to_alert", "", "s", "longest wait for an alarm while an error was beyond its limit "
           "and the level within it; inf if a due alarm did not come, nan if none was due", LANDING,
           when=_ASKED),
        _a("/summary/integrity/region", "region", "1", "regions of a Stanford diagram, and epochs with an alarm",
           LANDING, TEXT, when=_ASKED),
        _a("/summary/integrity/stanford_{axis}", "region", "1", "epochs of the glide in it, of all runs, by {axis} "
           "error and level", LANDING, WHOLE, when=_ASKED, axis=("horizontal", "vertical")),
    ),
)  # fmt: skip

VERDICTS = NOT_MET, UNDECIDED, MET = ("not met", "undecided", "met")
"""Verdicts on a requirement, by number in a sweep."""
_ASKED_FOR = "where the scenario has `requirements`"
_REQUIREMENTS = Chapter(
    "Requirements",
    "A verdict on each of the scenario's requirements, presets as their parts.",
    tuple(
        _a(f"/summary/requirements/{name}", dims, units, meaning, (*_FLOWN, RARE), of, when=_ASKED_FOR)
        for name, dims, units, meaning, of in (
            ("requirement", "requirement", "1", "numbers of the statements, in order", WHOLE),
            ("statement", "requirement", "1", "requirement, in words", TEXT),
            ("value", "requirement interval", "1", "value, in the unit of the statement; nan if the method "
             "does not compute it", NUMBER),
            ("limit", "requirement", "1", "required limit", NUMBER),
            ("what", "requirement", "1", "kind of the statement, as `what` of the scenario", TEXT),
            ("of", "requirement", "1", "error, RMS or level concerned, empty for others", TEXT),
            ("at", "requirement", "1", "height at which its error counts, empty for others", TEXT),
            ("size", "requirement", "m", "upper limit of its error, RMS or level, nan for others", NUMBER),
            ("verdict", "requirement", "1", "met, not met or undecided, by the interval", TEXT),
            ("more_runs", "requirement", "1", "number of further runs for a decision, if they are like these; nan if "
               "none would be enough, or if it is decided", NUMBER),
            ("plain_value", "requirement interval", "1", "value of the runs alone, if `value` is by control variates; "
             "nan otherwise", NUMBER),
            ("plain_verdict", "requirement", "1", "verdict by `plain_value`; empty without it", TEXT),
        )
    ),
)  # fmt: skip

_MESSAGE = "{field} of the navigation message"
_MESSAGES = "where the orbits of the system are broadcast, or an almanac whose messages an export makes"


def _message(units: str, *names: str, dims: str = "message", of: str = NUMBER) -> Entry:
    """Fields of navigation messages that have one unit."""
    return _a("/navigation/{system}/{field}", dims, units, _MESSAGE, _FLOWN, of, when=_MESSAGES, field=names)


_NAVIGATION = Chapter(
    "Navigation messages",
    "Messages that the satellites sent or would have sent: state vectors of GLONASS in Earth-fixed axes, elements of "
    "the others. An export to RINEX needs them.",
    (
        _a("/navigation/{system}/message", "message", "1",
           "number of the message; exact: the satellites flew by these messages", _FLOWN, WHOLE, when=_MESSAGES,
           attributes=("exact",)),
        _a("/navigation/{system}/xyz", "xyz", "1", "axes fixed to the Earth", _FLOWN, TEXT, when=_MESSAGES),
        _message("1", "prn", "slot", "channel", "healthy", of=WHOLE),
        _message("1", "e", "iode", "iodc", of=ANY),
        _message("s", "toe", "toc", "af0", "tgd", "time", "tau"),
        _message("s/s", "af1", "gamma"),
        _message("s/s2", "af2"),
        _message("sqrt(m)", "sqrt_a"),
        _message("rad", "i0", "omega0", "omega", "m0", "cuc", "cus", "cic", "cis"),
        _message("rad/s", "delta_n", "omega_dot", "i_dot"),
        _message("m", "crc", "crs", "ura"),
        _message("day", "age", of=ANY),
        _message("m", "position", dims="message xyz"),
        _message("m/s", "velocity", dims="message xyz"),
        _message("m/s2", "acceleration", dims="message xyz"),
    ),
)  # fmt: skip

_REPLAY = Chapter(
    "A recorded flight",
    "Tuning, innovations, and drift without fixes.",
    (
        *(
            _a(f"/tuning/{name}", "", units, name.replace("_", " "), REPLAY, attributes=("origin",))
            for name, units in (
                ("gyro_noise_density", "rad/sqrt(s)"), ("accelerometer_noise_density", "m/s/sqrt(s)"), ("latency", "s"),
            )
        ),
        *(
            _a(f"/tuning/{name}_white_noise", "", units, f"white noise of the {name}s at rest",
               REPLAY, attributes=("origin",))
            for name, units in (("gyro", "rad/sqrt(s)"), ("accelerometer", "m/s/sqrt(s)"))
        ),
        *(
            _a(f"/tuning/{name}", "", "m/s", name.replace("_", " "), REPLAY, attributes=("origin",), when=_LOOSE_REPLAY)
            for name in ("velocity_sigma_horizontal", "velocity_sigma_vertical")
        ),
        _a("/tuning/velocity_latency", "", "s", "latency of the velocities", REPLAY, attributes=("origin",),
           when=_LOOSE_REPLAY),
        *(
            _a(f"/tuning/{name}", "", "m", name.replace("_", " "), REPLAY, attributes=("origin",), when=_LOOSE_REPLAY)
            for name in ("position_sigma_horizontal", "position_sigma_vertical")
        ),
        *(
            _a(f"/tuning/{name}", "", units, f"time-correlated position error, {meaning}", REPLAY,
               attributes=("origin",), when=_LOOSE_REPLAY + ", where the fixes show or claim such an error")
            for name, units, meaning in (
                ("position_error_horizontal", "m", "horizontal, 1 sigma per axis"),
                ("position_error_vertical", "m", "vertical, 1 sigma"),
                ("position_error_time", "s", "correlation time"),
            )
        ),
        *(
            _a(f"/tuning/{name}", "", units, f"{name.replace('_', ' ')}, overhead", REPLAY, attributes=("origin",),
               when=_TIGHT_REPLAY)
            for name, units in (("range_sigma", "m"), ("range_rate_sigma", "m/s"))
        ),
        _a("/tuning/heading_sigma", "", "rad", "noise of a usual measured heading", REPLAY, attributes=("origin",),
           when=_HEADING),
        _a("/heading/time", "time", "s", "times of the measured headings", REPLAY, when=_HEADING),
        _a("/heading/innovation", "time", "rad", "measured heading minus prediction, nan where unused", REPLAY,
           when=_HEADING),
        _a("/heading/innovation_sigma", "time", "rad", "1 sigma of the innovation", REPLAY, when=_HEADING),
        _a("/heading/status", "time", "1", "0 unused, 1 used, 2 rejected by the gate", REPLAY, WHOLE,
           when=_HEADING),
        _a("/summary/aid", "aid", "1", "measurements beside the fixes", REPLAY, TEXT, when=_AIDED),
        _a("/summary/aid_used", "aid", "1", "number of measurements that the filter used", REPLAY, WHOLE, when=_AIDED),
        _a("/summary/aid_rejected", "aid", "1", "number of those that the gate rejected", REPLAY, WHOLE, when=_AIDED),
        _a("/summary/aid_nis", "aid motion", "1", "normalised innovation squared per degree of freedom, by the motion "
           "at the next fix", REPLAY, when=_AIDED),
        _a("/summary/beacon", "beacon", "1", "names of the beacons", REPLAY, TEXT, when=_RANGED),
        _a("/summary/beacon_bias", "beacon", "m", "constant bias of the ranges at the end", REPLAY, when=_RANGED),
        _a("/summary/beacon_bias_sigma", "beacon", "m", "1 sigma of it", REPLAY, when=_RANGED),
        _a("/clock", "clock", "1", "names of the clocks in one-way ranges but the reference, its attribute "
           "`datum`", REPLAY, TEXT, attributes=("datum",), when=_CLOCKED),
        _a("/filter/clock_offset", "run time clock", "m", "estimated offset of the clock against the reference", REPLAY,
           when=_CLOCKED),
        _a("/filter/clock_rate", "run time clock", "m/s", "estimated rate of the clock against the reference", REPLAY,
           when=_CLOCKED),
        *(
            _a(f"/summary/clock_{name}", "clock", units, f"{meaning} at the end, nan if the ranges do not show it",
               REPLAY, when=_CLOCKED)
            for name, units, meaning in (
                ("offset", "m", "offset against the reference"), ("offset_sigma", "m", "1 sigma of it"),
                ("rate", "m/s", "rate against the reference"), ("rate_sigma", "m/s", "1 sigma of it"),
            )
        ),
        _a("/lost/span", "span", "1", "number of the time at which the output is unusable", REPLAY, WHOLE),
        _a("/lost/start", "span", "s", "when the filter was lost", REPLAY),
        _a("/lost/end", "span", "s", "time of the restart, or end of the flight", REPLAY),
        _a("/lost/cause", "span", "1", "reason: no samples, and no output of that time; or the filter contradicted its "
           "fixes", REPLAY, TEXT),
        _a("/filter/reference_attitude_rpy", "run time rpy", "rad", "roll, pitch, yaw by another system", REPLAY,
           when=_REFERENCE),
        _a("/summary/attitude_difference_{statistic}", "rpy", "rad",
           "{statistic} of the filter's attitude minus the other system's", REPLAY, when=_REFERENCE,
           statistic=("mean", "scatter")),
        _a("/outages/outage", "outage", "1", "number of the outage", REPLAY, WHOLE),
        _a("/outages/start", "outage", "s", "start of the outage", REPLAY),
        _a("/outages/end", "outage", "s", "end of the outage", REPLAY),
        _a("/outages/horizontal_error", "outage", "m",
           "withheld fix minus prediction at the end, horizontal; nan outside the flight", REPLAY),
        _a("/outages/vertical_error", "outage", "m", "the same, vertical", REPLAY),
        _a("/outages/nees", "outage", "1", "squared horizontal drift in units of its sigma, per degree of freedom",
           REPLAY),
        _a("/summary/motion", "motion", "1", "fixes: all; in motion above {moving}; parked; in motion, straight on or "
           "turning", REPLAY, TEXT),
        _a("/summary/motion", "motion", "1", "all", LIVE, TEXT),
        _a("/summary/innovation_position", "motion ned", "m", "rms of the position innovations", REPLAY),
        _a("/summary/innovation_velocity", "motion ned", "m/s", "rms of the velocity innovations", REPLAY),
        _a("/summary/nis", "motion", "1", "normalised innovation squared per degree of freedom", (REPLAY, LIVE)),
        _a("/summary/degrees_of_freedom", "motion", "1", "degrees of freedom of their innovations", REPLAY, WHOLE),
        _a("/summary/motion_fixes", "motion", "1", "number of fixes that the filter used", REPLAY, WHOLE),
        _a("/summary/count/samples", "", "1", "number of samples of the IMU", REPLAY, WHOLE),
        _a("/summary/count/gaps", "", "1", "number of gaps between the samples", REPLAY, WHOLE),
        _a("/summary/nis_{part}", "motion", "1", "normalised innovation squared per degree of freedom, {part}", REPLAY,
           part=("position", "velocity")),
        _a("/summary/lag1_{part}", "", "1", "lag-1 autocorrelation of {part} innovations in motion; 0 is due", REPLAY,
           part=("position", "velocity")),
        _a("/summary/duration", "duration", "s", "length of the outages", REPLAY),
        _a("/summary/drift_nees", "duration", "1", "mean of `/outages/nees`; 1 is due", REPLAY),
        _a("/summary/drift_{statistic}", "duration", "m", "{statistic} horizontal drift of the outages", REPLAY,
           statistic=("median", "max")),
        _a("/summary/quantity", "quantity", "1", "what the first part predicts, in motion, and its unit", REPLAY, TEXT,
           when=_BET),
        _a("/summary/bet_until", "", "s", "end of the first part", REPLAY, when=_BET, attributes=("sha256",)),
        _a("/summary/bet_values", "quantity", "1", "number of values that followed", REPLAY, WHOLE, when=_BET),
        _a("/summary/bet_independent", "quantity", "1", "number of independent values among them", REPLAY, when=_BET),
        _a("/summary/bet_verdict", "quantity", "1", "whether the shares that followed contradict the prediction at "
           "99.9 %: held, sigma too small, sigma too large, not Gaussian", REPLAY, TEXT, when=_BET),
        *(
            _a(f"/summary/bet_{name}_{{percent}}", "quantity", "1", meaning, REPLAY, when=_BET, percent=("50", "95"))
            for name, meaning in (
                ("band", "size below which {percent} % of the values are predicted, in the unit of the quantity"),
                ("share", "share of the values that followed within the band of {percent} %"),
                ("low", "lower end of the 95 % interval of the share within the band of {percent} %"),
                ("high", "upper end of the 95 % interval of the share within the band of {percent} %"),
            )
        ),
    ),
)  # fmt: skip

_SMOOTHED = "with `smoother: true`"
_ONE_WAY = "of one-way ranges"
_FLAT = "where the sources lie nearly in a plane"
_COMPARED = "with `reference`"
_RANGES = Chapter(
    "Recorded ranges",
    "Positions, clocks and biases from ranges of beacons or pseudolites. Axes are those of the sources: east, north "
    "and up from the middle of geodetic positions, else x, y, z as given.",
    (
        _a("/source", "source", "1", "names of the sources", RANGES, TEXT),
        _labels("/axis", "axes of positions", RANGES, "x", "y", "z"),
        _labels("/llh", "geodetic coordinates, WGS-84", RANGES, "latitude", "longitude", "height"),
        _a("/sources/position", "source axis", "m", "positions of the sources", RANGES),
        _a("/sources/origin_llh", "llh", "rad, rad, m", "origin of the axes", RANGES,
           when="where the positions are geodetic"),
        _a("/time", "time", "s", "times of the ranges, each once", RANGES),
        *(
            _a(f"/{{estimate}}/{quantity}{of}", "time axis", units, f"{meaning}, {{estimate}}", RANGES,
               when=_SMOOTHED if estimate == "smoother" else "", estimate=(estimate,))
            for estimate in ("filter", "smoother")
            for quantity, units in (("position", "m"), ("velocity", "m/s"))
            for of, meaning in (("", f"estimated {quantity}"), ("_sigma", f"1 sigma of the {quantity}"))
        ),
        _a("/noise/setting", "setting", "1", "names of the noise settings", RANGES, TEXT),
        _a("/noise/value", "setting", "1", "their values, in the units of /noise/units", RANGES),
        _a("/noise/units", "setting", "1", "units of these values", RANGES, TEXT),
        _a("/noise/tuned", "setting", "1", "1 where the value is tuned, 0 where the file gives it", RANGES, WHOLE),
        _a("/noise/source_range_sigma", "source", "m", "1 sigma of the white noise by source", RANGES),
        _a("/noise/source_wander_sigma", "source", "m", "1 sigma of the wandering error by source", RANGES),
        _a("/states/state", "state", "1", "names of the states", RANGES, TEXT),
        _a("/states/units", "state", "1", "units of the states", RANGES, TEXT),
        _a("/states/value", "state", "1", "states at the end, nan where the ranges do not show them", RANGES),
        _a("/states/sigma", "state", "1", "1 sigma of these, nan as above", RANGES),
        _a("/states/prior_sigma", "state", "1", "1 sigma of the states at the start", RANGES),
        _a("/states/pair", "pair", "1", "pairs of states that are correlated beyond 0.99", RANGES, TEXT),
        _a("/states/pair_correlation", "pair", "1", "their correlations", RANGES),
        _a("/clocks/clock", "clock", "1", "names of the clocks but for the datum", RANGES, TEXT, when=_ONE_WAY),
        _a("/clocks/offset", "time clock", "m", "offset of the clock against the datum", RANGES, when=_ONE_WAY),
        _a("/clocks/offset_sigma", "time clock", "m", "1 sigma of the offset", RANGES, when=_ONE_WAY),
        _a("/clocks/rate", "time clock", "m/s", "rate of the clock against the datum", RANGES, when=_ONE_WAY),
        _a("/clocks/rate_sigma", "time clock", "m/s", "1 sigma of the rate", RANGES, when=_ONE_WAY),
        _a("/clocks/mean_rate", "clock", "m/s", "gain of the offset over the recording by its length", RANGES,
           when=_ONE_WAY),
        _a("/ranges/time", "range", "s", "time of the range", RANGES),
        _a("/ranges/source_index", "range", "1", "number of the source, from 0", RANGES, WHOLE),
        _a("/ranges/range", "range", "m", "the range", RANGES),
        _a("/ranges/innovation", "range", "m", "range less prediction from the ranges before it. With the smoother, "
           "distances are linearised about the smoothed positions", RANGES),
        _a("/ranges/innovation_sigma", "range", "m", "1 sigma of the innovation", RANGES),
        _a("/ranges/residual", "range", "m", "range less distance, clocks and biases of the smoothed states, or of the "
           "filter's without smoother", RANGES),
        _a("/ranges/weight", "range", "1", "probability that the range has the usual noise", RANGES),
        _a("/ranges/signal", "range", "dBm", "signal strength", RANGES, when="where the table has it"),
        _a("/dop/position", "time", "1", "position dilution of precision of all sources", RANGES),
        _a("/dop/horizontal", "time", "1", "horizontal dilution of precision", RANGES),
        _a("/dop/vertical", "time", "1", "vertical dilution of precision", RANGES),
        _a("/mirror/normal", "axis", "1", "normal of the plane nearest to the sources", RANGES),
        _a("/mirror/thickness", "", "m", "1 sigma of the sources' distances from that plane", RANGES),
        _a("/mirror/width", "", "m", "1 sigma of the sources along their second axis in that plane", RANGES),
        _a("/mirror/near_share", "", "1", "share of positions nearer to their mirror image than 1 sigma", RANGES,
           when=_FLAT),
        _a("/mirror/log_likelihood_ratio", "", "1", "log-likelihood of the solution less that of its mirror image",
           RANGES, when=f"{_FLAT} and the image is a solution"),
        _a("/reference/position", "time axis", "m", "position of the reference, nan where it has none", RANGES,
           when=_COMPARED),
        _a("/reference/time_offset", "", "s", "added to the reference's times", RANGES, when=_COMPARED),
        _a("/summary/ranges", "source", "1", "number of ranges", RANGES, WHOLE),
        _a("/summary/outliers", "source", "1", "number of ranges that do not have the usual noise", RANGES, WHOLE),
        _a("/summary/residual_rms", "source", "m", "RMS of the residuals without outliers", RANGES),
        _a("/summary/nis", "source", "1", "mean normalised innovation squared without outliers", RANGES),
        _a("/summary/lag1", "source", "1", "lag-1 autocorrelation of the innovations of the source", RANGES),
        _a("/summary/residual_rms_all", "", "m", "RMS of all residuals without outliers", RANGES),
        _a("/summary/nis_all", "", "1", "mean normalised innovation squared of all without outliers", RANGES),
        _a("/summary/log_likelihood", "", "1", "logarithm of the likelihood of the ranges", RANGES),
        *(
            _a(f"/summary/{{estimate}}_error_{what}", "axis", units, meaning, RANGES,
               when=_COMPARED if estimate == "filter" else f"{_COMPARED} and {_SMOOTHED}", estimate=(estimate,))
            for estimate in ("filter", "smoother")
            for what, units, meaning in (
                ("rms", "m", "RMS error against the reference, {estimate}"),
                ("z", "1", "RMS of error over sigma, {estimate}"),
                ("mean", "m", "mean error against the reference, {estimate}"),
            )
        ),
    ),
)  # fmt: skip

COUNTS = {
    "received": "lines received",
    "used": "messages used",
    "corrupt": "lines without a valid message: checksum, syntax, values",
    "doubled": "messages that came again unchanged",
    "late": "messages for a time already passed: late or out of order",
    "contradicting": "messages of one time with another place: of another sender",
    "lost": "messages missing in between, by the scenario's rate",
    "before": "messages from before the flight",
    "early": "messages for a time beyond the data or the scenario",
    "empty": "messages without a fix",
    "estimated": "NMEA epochs of the receiver's own dead reckoning (quality 6, mode E), left out",
    "manual": "NMEA epochs of positions typed into the receiver (quality 7, mode M), left out",
    "simulated": "NMEA epochs of a simulator (quality 8, mode S), left out unless asked for",
    "no_checksum": "NMEA sentences without a checksum, left out unless asked for, or cut off before it",
    "dropped": "lines left out because they came faster than they were taken",
    "strangers": "datagrams of other senders, left out",
    "untimed": "NMEA sentences without a time of day",
    "no_height": "fixes without a height: none in GGA or GNS, or neither of them",
    "no_separation": "fixes without a geoid separation; navsim takes their heights as heights above the ellipsoid",
    "other": "valid sentences of kinds without a fix",
}
"""Counters of a live run for its stream."""

_LIVE = Chapter(
    "A live run",
    "Messages received, and navsim's use of them.",
    (
        *(_a(f"/stream/{name}", "", "1", meaning, LIVE, WHOLE) for name, meaning in COUNTS.items()),
        _a("/clock/offset", "", "s", "reading of the source's clock at time 0 of the flight", LIVE),
        _a("/clock/shift", "", "s", "lead of the fixes over the flight along the track, in time", LIVE),
        *(
            _a(f"/off_flight/{name}", "", "m", meaning, LIVE)
            for name, meaning in (
                ("across", "mean deviation of the fixes to the right of the flight, without a shift along the track"),
                ("across_sigma", "its 1 sigma if errors of the scenario's size last the whole flight"),
                ("north", "mean deviation of the fixes to the north of the flight, without a shift along the track"),
                ("north_sigma", "its 1 sigma if errors of the scenario's size last the whole flight"),
                ("east", "mean deviation of the fixes to the east of the flight, without a shift along the track"),
                ("east_sigma", "its 1 sigma if errors of the scenario's size last the whole flight"),
                ("up", "mean deviation of the fixes above the flight, without a shift along the track"),
                ("up_sigma", "its 1 sigma if errors of the scenario's size last the whole flight"),
                ("undulation", "height of the geoid above the ellipsoid at the start of the flight, nan where unknown"),
            )
        ),
        _a("/clock/shift_sigma", "", "s", "1 sigma of the same, from its scatter", LIVE),
        _a("/summary/rms_position_ned", "ned", "m",
           f"rms position error over the last {RMS_WINDOW} s received, not those to touchdown", LIVE),
    ),
)  # fmt: skip

DOP_QUANTITIES = {
    **{
        f"{dop}{end}": ("1", f"{dop.upper()}, {which} over the glide")
        for end, which in (("", "mean"), ("_max", "largest"))
        for dop in ("pdop", "hdop", "vdop")
    },
    **{f"fix_{part}": ("m", f"{part} RMS of a fix, mean over the glide") for part in ("horizontal", "vertical")},
    "epochs_without_fix": ("1", "epochs of the glide without a fix"),
}
"""Unit and meaning of quantities of placements for every method: DOPs, sigma of a fix, lost epochs."""
FILTER_QUANTITIES = {
    **{part: ("m", f"root mean square {part} position error {_LATE}") for part in ("horizontal", "vertical")},
    **{
        f"{axis}_{height}": ("m", f"root mean square {axis} position error at {height}")
        for axis in RUNWAY_AXES
        for height in HEIGHTS
    },
}
"""Quantities of methods with a filter."""
BEACON_QUANTITIES = {
    f"beacons_{dop}{end}": ("1", f"{dop.upper()} of the ranges to beacons, {which} over the glide")
    for end, which in (("", "mean"), ("_max", "largest"), ("_p50", "median"))
    for dop in ("pdop", "hdop", "vdop")
}
"""Quantities of scenarios with beacons, for every method."""
QUANTITIES = DOP_QUANTITIES | FILTER_QUANTITIES | BEACON_QUANTITIES
"""Unit and meaning of quantities for the evaluation of placements."""
LEVEL_QUANTITIES = {
    **{
        f"{level}_{part}": ("m", f"{level.upper()} on the glide, {words}")
        for level in ("hpl", "vpl")
        for part, words in (("p95", "kept by 95 % of the epochs that have one"), ("max", "largest"))
    },
    "level_share": ("1", "share of the epochs of the glide with protection levels"),
}
"""Quantities of scenarios with monitored fixes, for every method."""
WATCHED_QUANTITIES = {
    "availability": ("1", "share of the epochs of the glide that is available"),
    "approaches": ("1", "share of runs available throughout"),
    "continuity_risk": ("1", "share of stretches of 15 s that begin available and do not stay so"),
    "hmi": ("1", "share of runs with hazardously misleading information"),
}
"""Quantities of runs with monitored fixes and limits."""
TOTAL_QUANTITIES = {
    f"{axis}_total_{height}": ("m", f"root mean square {axis} total system error at {height}")
    for axis in RUNWAY_AXES
    for height in HEIGHTS
} | {
    "outside_box": ("1", "share of runs that end outside the box"),
    "go_around": ("1", "share of runs that go around after an alarm"),
}
"""Quantities of runs that leave their route, and of where they end."""
OBJECTIVE_QUANTITIES = QUANTITIES | LEVEL_QUANTITIES
"""Possible objectives of placements."""
LARGE = ("level_share", "availability", "approaches")
"""Objectives that are maximised."""
SWEEP_QUANTITIES = QUANTITIES | LEVEL_QUANTITIES | WATCHED_QUANTITIES | TOTAL_QUANTITIES
"""Possible outputs of sweeps."""

OUTCOMES = ("computed", "no valid scenario", "no fix at all")
"""Outcome of a combination of a sweep, by number."""

_JUDGED_BY_RUNS = "where the base scenario has `requirements` and the best {} were flown"


def _flown_requirements(dim: str, whose: str, layout: str) -> tuple[Entry, ...]:
    """Verdicts of runs of the best placements or combinations on the base scenario's requirements."""
    return tuple(
        _a(f"/flown/requirements/{name}", dims, "1", meaning, layout, of, when=_JUDGED_BY_RUNS.format(f"{whose}s"))
        for name, dims, meaning, of in (
            ("requirement", "requirement", "numbers of the statements, in order", WHOLE),
            ("statement", "requirement", "requirement of the base scenario, in words", TEXT),
            ("limit", "requirement", "required limit", NUMBER),
            ("value", f"{dim} requirement interval", f"value by runs of the best {whose}, in the unit of the "
             "statement; nan if unknown", NUMBER),
            ("verdict", f"{dim} requirement", "met, not met or undecided, by the interval; empty without runs", TEXT),
            ("more_runs", f"{dim} requirement", "number of further runs for a decision, if they are like these; nan if "
             "none would be enough, or if it is decided", NUMBER),
        )
    )  # fmt: skip


_OF_REQUIREMENTS = "where `requirements` is one of `outputs`"
_CONFIRMED = "with method covariance, where it is one of `outputs`, unless `--runs 0`"
_REJECTING = "where runs spoke against a choice"
_SWEEP = Chapter(
    "Sweep",
    "A cube for each output, an axis for each varied key or list of keys.",
    (
        _a("/{dimension}", "{dimension}", "1", "{points}", SWEEP, ANY),
        _a("/sweep/axes/{varied}", "{of_axis}", "1", "values of {key}", SWEEP, ANY),
        *(
            _a(f"/sweep/{name}", "*axes", units, meaning, SWEEP, when="where it is one of `outputs`")
            for name, (units, meaning) in SWEEP_QUANTITIES.items()
        ),
        *(
            _a(f"/sweep/{name}_{{end}}", "*axes", units, meaning + ", {end} end of its 95 % interval", SWEEP,
               when="with method monte-carlo, where it is one of `outputs`", end=("low", "high"))
            for name, (units, meaning) in (FILTER_QUANTITIES | WATCHED_QUANTITIES | TOTAL_QUANTITIES).items()
        ),
        _a("/sweep/requirement_{number}", "*axes", "{unit}", "{statement}: value", SWEEP,
           when=_OF_REQUIREMENTS, attributes=("limit", "least")),
        _a("/sweep/requirement_{number}_{end}", "*axes", "{unit}", "{statement}: {end} end of the 95 % interval of the "
           "value", SWEEP, when=f"{_OF_REQUIREMENTS}, with method monte-carlo", end=("low", "high")),
        _a("/sweep/requirement_{number}_verdict", "*axes", "1", "{statement}: "
           + ", ".join(f"{number} {words}" for number, words in enumerate(VERDICTS)), SWEEP, WHOLE,
           when=_OF_REQUIREMENTS),
        _a("/outcome/combination", "*axes", "1",
           ", ".join(f"{number} {words}" for number, words in enumerate(OUTCOMES)), SWEEP, WHOLE),
        _a("/flown/runs", "", "1", "runs of each of the best combinations", SWEEP, WHOLE, when=_CONFIRMED),
        *(
            entry
            for name, (units, meaning) in FILTER_QUANTITIES.items()
            for entry in (
                _a(f"/flown/{name}", "interval", units, f"{meaning} of the best combination by runs", SWEEP,
                   when=_CONFIRMED),
                _a(f"/flown/{name}_combination", "", "1", "number of that combination, the last axis fastest", SWEEP,
                   WHOLE, when=_CONFIRMED),
                _a(f"/flown/{name}_verdict", "", "1", "verdict of its runs on all states at all outputs", SWEEP, TEXT,
                   when=_CONFIRMED),
            )
        ),
        _a("/flown/requirements/output", "output", "1", "output that the combination is the best for", SWEEP, TEXT,
           when=_JUDGED_BY_RUNS.format("combinations")),
        *_flown_requirements("output", "combination", SWEEP),
        *(
            _a(f"/rejected/{name}", dims, units, meaning, SWEEP, of, when=_REJECTING)
            for name, dims, units, meaning, of in (
                ("rejected", "rejected", "1", "numbers of combinations that runs spoke against", WHOLE),
                ("output", "rejected", "1", "the output that they were the best for", TEXT),
                ("combination", "rejected", "1", "number of the combination, the last axis fastest", WHOLE),
                ("analysed", "rejected", "m", "the output by covariance analysis", NUMBER),
                ("flown", "rejected interval", "m", "the output by runs", NUMBER),
            )
        ),
        _a("/plan/point", "point", "1", "points of the track", SWEEP, WHOLE),
        _a("/plan/threshold_llh", "llh", "rad, rad, m", "threshold of the runway", (SWEEP, OPTIMIZE)),
        _a("/site", "site", "1", "number of the pseudolite", SWEEP, WHOLE),
        *(
            entry
            for name, meaning in (("along", "along the runway, positive beyond the threshold"),
                                  ("right", "right of the runway's axis"))
            for entry in (
                _a(f"/plan/track_{name}", "point", "m", f"ground track, {meaning}", SWEEP),
                _a(f"/plan/site_{name}", "*axes site", "m", f"pseudolites, {meaning}; nan for none", SWEEP),
            )
        ),
    ),
)  # fmt: skip

_MEETING = "with `constraints.requirements`"
_COSTING = "with `costs`"
_HEIGHTS_FOUND = "where heights are searched, or differ between sites"
_OPTIMIZE = Chapter(
    "Best placements",
    "By number of pseudolites; a placement of fewer than the most is filled up with nan. With `costs` several "
    "placements have the same number, the cheapest of them first.",
    (
        _a("/pseudolites", "pseudolites", "1", "number of pseudolites, or of the beacons that are placed", OPTIMIZE,
           WHOLE),
        _a("/pseudolite", "pseudolite", "1", "pseudolite, or beacon, of a placement", OPTIMIZE, WHOLE),
        _a("/bearing", "bearing", "deg", "direction from the landing direction, clockwise", OPTIMIZE),
        _a("/loss", "loss", "1", "relative loss of the objective", OPTIMIZE),
        _a("/pareto/objective", "pseudolites", "{unit}", "{quantity}", OPTIMIZE, attributes=("without_pseudolites",)),
        _a("/pareto/evaluations", "pseudolites", "1", "placements tried", OPTIMIZE, WHOLE),
        _a("/pareto/evaluations_coarse", "pseudolites", "1", "number of placements tried by coarse covariance analysis",
           OPTIMIZE, WHOLE),
        _a("/pareto/evaluations_full", "pseudolites", "1", "number of placements tried by covariance analysis",
           OPTIMIZE, WHOLE),
        _a("/pareto/every_choice", "pseudolites", "1", "1: every choice was tried", OPTIMIZE, WHOLE),
        _a("/pareto/finished", "pseudolites", "1", "1: the search came to its end, 0: it was stopped", OPTIMIZE, WHOLE),
        _a("/pareto/cost", "pseudolites", "1", "cost of the placement, in the currency of the study", OPTIMIZE,
           when=_COSTING),
        _a("/pareto/on_front", "pseudolites", "1", "1: no other placement is at least as accurate and as cheap, and "
           "better in one of both", OPTIMIZE, WHOLE, when=_COSTING),
        _a("/pareto/eirp", "pseudolites", "dBm", "transmitter power, EIRP", OPTIMIZE, when="with `costs.power`"),
        _a("/optimum/cost", "pseudolites pseudolite", "1", "cost of each, with mast and permission", OPTIMIZE,
           when=_COSTING),
        _a("/optimum/explored", "pseudolites", "1", "1: the neighbourhood was computed", OPTIMIZE, WHOLE),
        _a("/optimum/s", "pseudolites pseudolite", "m", "right of the runway's axis", OPTIMIZE),
        _a("/optimum/l1", "pseudolites pseudolite", "m", "before the threshold", OPTIMIZE),
        _a("/optimum/up", "pseudolites pseudolite", "m", "above the runway", OPTIMIZE, when=_HEIGHTS_FOUND),
        _a("/optimum/{coordinate}", "pseudolites pseudolite", "rad", "WGS-84 {coordinate}", OPTIMIZE,
           coordinate=("latitude", "longitude")),
        _a("/optimum/{coordinate}", "pseudolites pseudolite", "m", "WGS-84 {coordinate}", OPTIMIZE,
           coordinate=("height",)),
        _a("/optimum/neighbourhood", "pseudolites pseudolite loss bearing", "m",
           "largest shift of a single pseudolite{how}; nan if the area or a rule ends it first, or requirements are "
           "not met to begin with", OPTIMIZE),
        _a("/optimum/violation", "pseudolites", "m", "violation of the tightest rule (dB for near_far_db); negative: "
           "margin", OPTIMIZE),
        _a("/optimum/tightest_rule", "pseudolites", "1", "rule with the least margin, a key below `constraints`; "
           "`aircraft`: the distance of pseudolites from it", OPTIMIZE, TEXT),
        *(
            _a(f"/optimum/{name}", "pseudolites", units, meaning, OPTIMIZE, when="where pseudolites are placed")
            for name, (units, meaning) in DOP_QUANTITIES.items()
        ),
        *(
            _a(f"/optimum/{name}", "pseudolites", units, meaning, OPTIMIZE, when="where beacons are placed")
            for name, (units, meaning) in BEACON_QUANTITIES.items()
        ),
        _a("/flown/runs", "pseudolites", "1", "runs of the best placement; 0: none", OPTIMIZE, WHOLE),
        _a("/flown/verdict", "pseudolites", "1", "verdict of the runs on all states at all outputs; empty without runs",
           OPTIMIZE, TEXT),
        _a("/flown/objective", "pseudolites interval", "{unit}",
           "{quantity}, of the best placement by runs; nan without runs, or if the objective is not an error of the "
           "filter", OPTIMIZE),
        *(
            _a(f"/flown/{part}", "pseudolites interval", "m", f"{part} position error, {_RMS}, of the best placement; "
               "nan without runs", OPTIMIZE)
            for part in ("horizontal", "vertical")
        ),
        *_flown_requirements("pseudolites", "placement", OPTIMIZE),
        _a("/rejected/rejected", "rejected", "1", "numbers of placements that runs spoke against", OPTIMIZE, WHOLE,
           when=_REJECTING),
        _a("/rejected/pseudolites", "rejected", "1", "number of pseudolites", OPTIMIZE, WHOLE, when=_REJECTING),
        _a("/rejected/s", "rejected pseudolite", "m", "right of the runway's axis", OPTIMIZE, when=_REJECTING),
        _a("/rejected/l1", "rejected pseudolite", "m", "before the threshold", OPTIMIZE, when=_REJECTING),
        _a("/rejected/up", "rejected pseudolite", "m", "above the runway", OPTIMIZE,
           when=f"{_REJECTING}, {_HEIGHTS_FOUND}"),
        _a("/rejected/analysed", "rejected", "{unit}", "{quantity}, by covariance analysis", OPTIMIZE,
           when=_REJECTING),
        _a("/rejected/flown", "rejected interval", "{unit}", "{quantity}, by runs", OPTIMIZE, when=_REJECTING),
        _a("/pareto/met", "pseudolites", "1", "1: all decidable requirements are met", OPTIMIZE,
           WHOLE, when=_MEETING),
        _a("/pareto/met_without", "", "1", "the same without pseudolites", OPTIMIZE, WHOLE, when=_MEETING),
        _a("/pareto/fewest", "", "1", "fewest pseudolites with which they are met by analysis, 0 if none are "
           "needed, -1 if no number is enough", OPTIMIZE, WHOLE, when=_MEETING),
        _a("/pareto/cheapest", "", "1", "least cost with which they are met, nan if none is enough", OPTIMIZE,
           when=f"{_MEETING}, {_COSTING}"),
        *(
            _a(f"/requirements/{name}", "requirement", "1", meaning, OPTIMIZE, of, when=_MEETING)
            for name, meaning, of in (
                ("requirement", "numbers of the statements, in order", WHOLE),
                ("statement", "requirement, in words", TEXT),
                ("limit", "required limit", NUMBER),
                ("decided", "1: placements are evaluated by it, 0: only runs decide it", WHOLE),
            )
        ),
        *(
            entry
            for name, meaning, of in (
                ("value", "value, in the unit of the statement; nan if unknown", NUMBER),
                ("verdict", "met, not met or undecided", TEXT),
                ("utilisation", "smallest size that is kept as often as required, relative to the required size: above "
                 "1 if it is not met, inf if no size is kept", NUMBER),
            )
            for entry in (
                _a(f"/requirements/{name}", "pseudolites requirement", "1", meaning, OPTIMIZE, of, when=_MEETING),
                _a(f"/requirements/{name}_without", "requirement", "1", f"{meaning}; without pseudolites", OPTIMIZE, of,
                   when=_MEETING),
            )
        ),
        _a("/map/computed", "pseudolites", "1", "1: the map was computed", OPTIMIZE, WHOLE),
        _a("/map/s", "s", "m", "right of the runway's axis", OPTIMIZE),
        _a("/map/l1", "l1", "m", "before the threshold", OPTIMIZE),
        _a("/map/seen", "s l1", "1", "share of the glide's fixes that see an antenna there, at the least height of the "
           "search", OPTIMIZE, when="where the base scenario has `terrain`"),
        _a("/map/objective", "pseudolites s l1", "{unit}",
           "{quantity}, the first pseudolite moved, the others kept{how}; nan if a rule is violated, or requirements "
           "are not met", OPTIMIZE),
    ),
)  # fmt: skip

_TABLE2 = Chapter(
    "Table 2",
    "Values of the paper, and of each calibration.",
    (
        _a("/calibration", "calibration", "1", "calibrations", TABLE2, TEXT),
        _a("/case", "case", "1", "case of the paper's Table 1, the empty one first", TABLE2, WHOLE),
        _a("/table/pseudolites", "case", "1", "number of pseudolites", TABLE2, WHOLE),
        _a("/table/s", "case", "m", "S of Table 1", TABLE2),
        _a("/table/l1", "case", "m", "L1 of Table 1", TABLE2),
        _a("/published/{dop}", "case", "1", "{DOP} of Table 2", TABLE2, dop=("pdop", "hdop", "vdop")),
        _a("/table/{dop}", "calibration case statistic", "1", "{DOP}, unit weights", TABLE2,
           dop=("pdop", "hdop", "vdop")),
        _a("/weighted/{dop}", "calibration case statistic", "1", "{DOP}, sigma of the fix over that of a range", TABLE2,
           dop=("pdop", "hdop", "vdop")),
        _a("/published/rms_{part}", "case", "m", "sigma of a fix (SKO)", TABLE2, part=("horizontal", "vertical")),
        _a("/table/rms_{part}", "calibration case", "m", "sigma of a fix (SKO), mean over the glide", TABLE2,
           part=("horizontal", "vertical")),
        _a("/published/error_horizontal", "case", "m", "horizontal estimation error of Table 2", TABLE2),
        _a("/table/error_horizontal", "calibration case interval", "m", f"horizontal estimation error, {_RMS}", TABLE2,
           attributes=("runs",)),
        _a("/fit/parameters", "calibration", "1", "number of fitted parameters", TABLE2, WHOLE),
        _a("/fit/id", "calibration", "1", "letters", TABLE2, TEXT),
        _a("/fit/meaning", "calibration", "1", "fitted quantity and its constraint", TABLE2, TEXT),
        _a("/fit/weighted", "calibration", "1",
           "1: the published DOPs are compared with weighted ones; 0: with unit-weight ones", TABLE2, WHOLE),
        _a("/fit/dop_rms", "calibration", "1", "root mean square relative difference over the 21 DOP cells", TABLE2),
        _a("/fit/dop_max", "calibration", "1", "largest relative difference of a DOP cell", TABLE2),
        _a("/fit/sko_rms", "calibration", "1", "root mean square relative difference over the 14 SKO cells", TABLE2),
        _a("/fit/sko_max", "calibration", "1", "largest relative difference of an SKO cell", TABLE2),
        _a("/claims/claim", "claim", "1", "claims", TABLE2, TEXT),
        _a("/claims/says", "claim", "1", "claim", TABLE2, TEXT),
        _a("/claims/reason", "claim", "1", "reasons", TABLE2, TEXT),
        _a("/claims/calibration", "calibration", "1", "calibrations", TABLE2, TEXT),
        _a("/claims/computed", "calibration claim", "1", "computed value", TABLE2, TEXT),
        _a("/claims/holds", "calibration claim", "1", "1: the claim holds", TABLE2, WHOLE),
        _a("/approach/time", "time", "s", "fix epochs of the default calibration", TABLE2),
        _a("/approach/pseudolites", "curve", "1", "pseudolites, those at S = 200, L1 = 5000 m", TABLE2, WHOLE),
        _a("/approach/curve", "curve", "1", "case of the curve", TABLE2, WHOLE),
        _a("/approach/pdop", "curve time", "1", "PDOP, unit weights", TABLE2),
        _a("/approach/rms_horizontal", "curve time", "m", "horizontal estimation error over runs", TABLE2),
    ),
)  # fmt: skip

MOST_LEVELS = 60
"""Most epochs of a glide that a table of integrity has levels at."""
_SEPARATING = "with method mhss or filter"
_INTEGRITY_TABLE = Chapter(
    "Table of integrity",
    "For each number of sources on one clock: capabilities of their geometry by rank, and the share of epochs of the "
    "glide with both protection levels within the limits.",
    (
        _a("/pseudolites", "pseudolites", "1", "number of pseudolites", INTEGRITY_TABLE, WHOLE),
        _a("/satellites", "satellites", "1", "number of satellites left", INTEGRITY_TABLE, WHOLE),
        *(
            _a(f"/possible/{name}", "pseudolites satellites", "1", f"1: {meaning}", INTEGRITY_TABLE, WHOLE)
            for name, meaning in (
                ("fix", "a fix"),
                ("detection", "every single fault is detectable"),
                ("exclusion", "every single fault is excludable"),
                ("ground_loss", "every single fault is detectable, and the loss of all pseudolites leaves a fix"),
            )
        ),
        *(
            _a(f"/subsets/{name}", "pseudolites satellites", "1",
               "share of `/glide/time` with both levels within their "
               f"limits, {which}; nan if the scenario has too few sources", INTEGRITY_TABLE)
            for name, which in (
                ("worst", "the worst subset of satellites"),
                ("median", "the median subset: more than half of them reach it"),
            )
        ),
        _a("/subsets/{level}", "pseudolites satellites", "m",
        "median {LEVEL} over `/glide/time` that more than half of "
           "the subsets keep; inf if they have none, nan if the scenario has too few sources", INTEGRITY_TABLE,
           level=("hpl", "vpl")),
        _a("/subsets/number", "satellites", "1", "subsets of satellites that levels were computed for", INTEGRITY_TABLE,
           WHOLE),
        _a("/subsets/number_of_all", "satellites", "1", "number of subsets; if fewer are computed, they are drawn",
           INTEGRITY_TABLE, WHOLE),
        _a("/subsets/satellite", "satellite", "1",
        "satellites that are used throughout the glide: subsets are of these",
           INTEGRITY_TABLE, TEXT),
        _a("/subsets/pseudolite", "pseudolite", "1", "pseudolites in the order in which they are added",
        INTEGRITY_TABLE,
           TEXT),
        _a("/subsets/hal", "", "m", "horizontal alert limit, inf for none", INTEGRITY_TABLE),
        _a("/subsets/val", "", "m", "vertical alert limit, inf for none", INTEGRITY_TABLE),
        _a("/subsets/fault", "fault", "1", "faults that are expected, of sources that are used", INTEGRITY_TABLE, TEXT,
           when=_SEPARATING),
        _a("/subsets/prior", "fault", "1", "their probabilities", INTEGRITY_TABLE, when=_SEPARATING),
        _a("/glide/time", "time", "s", f"fix epochs of the glide with computed levels: all, or {MOST_LEVELS} of more, "
           "evenly spread", INTEGRITY_TABLE, attributes=("epochs_of_glide",)),
    ),
)  # fmt: skip

_DEG2 = "deg2, deg2/s, deg2/s2"
_ELEVATION = Chapter(
    "MLS elevation",
    "Degrees throughout, as the paper has it.",
    (
        _a("/step", "step", "1", "number of the measurement", ELEVATION, WHOLE, attributes=("period_s",)),
        _a("/state", "state", "1", "states: deg, deg/s, deg/s2", ELEVATION, TEXT),
        _a("/state_column", "state_column", "1", "columns of matrices", ELEVATION, TEXT),
        _a("/filter/covariance", "step state state_column", _DEG2, "covariance after the update", ELEVATION),
        _a("/filter/gain", "step state", "1, 1/s", "gain", ELEVATION),
        _a("/filter/steady_covariance", "state state_column", _DEG2, "covariance in the limit", ELEVATION),
        _a("/filter/steady_gain", "state", "1, 1/s", "gain in the limit", ELEVATION),
        _a("/montecarlo/mean_error", "step state", "deg, deg/s",
           "mean error of the first experiment, truth - estimate", ELEVATION),
        _a("/montecarlo/covariance", "step state state_column", _DEG2, "second moments of the first experiment",
           ELEVATION),
        _a("/montecarlo/covariance_all", "step state state_column", _DEG2, "second moments of all experiments",
           ELEVATION),
        _a("/band", "band", "1", "interpretations of the band", ELEVATION, TEXT),
        _a("/experiment", "experiment", "1", "number of the experiment", ELEVATION, WHOLE),
        _a("/montecarlo/fraction_in_band", "experiment band", "1",
           "share of steps with the sample's beta inside the band", ELEVATION),
        _a("/montecarlo/runs", "", "1", "runs of each experiment", ELEVATION, WHOLE),
        _a("/montecarlo/nees", "", "1", "mean normalised estimation error squared", ELEVATION),
        _a("/montecarlo/nis", "", "1", "mean normalised innovation squared", ELEVATION),
        _a("/band_theory/coverage", "band", "1", "exact chance of the band, mean known to be zero", ELEVATION),
        _a("/band_theory/coverage_mean_removed", "band", "1", "exact chance of the band, mean taken from the sample",
           ELEVATION),
        _a("/band_theory/runs_needed", "band", "1", "smallest number of runs for {confidence}", ELEVATION, WHOLE),
        _a("/approach/time", "time", "s", "time from 15 km", ELEVATION),
        _a("/approach/beta", "time", "deg", "beta of the guidance used", ELEVATION),
        _a("/approach/beta_rate", "time", "deg/s", "beta rate of the guidance used", ELEVATION),
        _a("/approach/beta_acceleration", "time", "deg/s2", "beta acceleration of the guidance used", ELEVATION),
        _labels("/approach/segment", "segments of the approach", ELEVATION, "level leg", "glide", "flare", "roll-out"),
        _a("/approach/segment_start", "segment", "s", "where each of them begins", ELEVATION),
        _a("/nominal/rate_variance", "rate_variance", "deg2/s2", "Q of the filter", ELEVATION),
        _a("/nominal/time", "time", "s", "time of the approach; evaluated after settling", ELEVATION,
           attributes=("settling_s",)),
        _a("/nominal/beta", "time", "deg", "true angle", ELEVATION),
        _a("/nominal/bias", "rate_variance time", "deg", "estimate minus truth without noise", ELEVATION),
        _a("/nominal/noise", "rate_variance time", "deg", "1 sigma due to measurement noise", ELEVATION),
        _a("/nominal/worst_rmse", "rate_variance", "deg", "largest root mean square error after settling", ELEVATION),
        _a("/nominal/peak_bias", "rate_variance", "deg", "largest bias after settling", ELEVATION),
        _a("/nominal/peak_time", "rate_variance", "s", "time of the largest bias", ELEVATION),
        _a("/nominal/steady_sigma", "rate_variance", "deg", "1 sigma of the angle in the limit", ELEVATION),
        _a("/order/filter", "filter", "1", "the filter of the scenario, and first-order filters", ELEVATION, TEXT),
        _a("/order/time", "time", "s", "time of the approach", ELEVATION),
        _a("/order/variance", "filter", "deg2, deg2/s2",
           "process noise over a period: of the rate in a second-order filter, of the angle in a first-order one",
           ELEVATION),
        _a("/order/gain", "filter", "1", "gain of the angle in the limit", ELEVATION),
        _a("/order/sigma", "filter", "deg", "1 sigma of the angle in the limit", ELEVATION),
        _a("/order/before", "filter", "deg", "bias just before glide-slope capture, nan if the run has none",
           ELEVATION),
        _a("/order/recovery", "filter", "s",
           "time from the capture until the bias stays below a tenth of its largest value, nan if it does not",
           ELEVATION),
        *(
            entry
            for place, dims in (("/order", "filter"), ("/azimuth", "rate_variance"), ("/flare", "source rate_variance"))
            for entry in (
                _a(f"{place}/bias", f"{dims} time", "deg", "estimate minus truth without noise", ELEVATION),
                _a(f"{place}/noise", f"{dims} time", "deg", "1 sigma due to measurement noise", ELEVATION),
                _a(f"{place}/peak_bias", dims, "deg", "largest bias after settling", ELEVATION),
                _a(f"{place}/peak_time", dims, "s", "time of the largest bias", ELEVATION),
                _a(f"{place}/worst_rmse", dims, "deg", "largest root mean square error after settling", ELEVATION),
            )
        ),
        _labels("/criterion/stretch", "stretches of the approach", ELEVATION, "level leg", "glide", "flare", "roll-out",
                "nominal run"),
        _a("/criterion/acceleration", "stretch", "deg/s2", "largest acceleration of the angle", ELEVATION),
        _a("/criterion/sigma", "", "deg", "1 sigma of a measured angle", ELEVATION),
        _a("/criterion/memory", "", "s", "time constant of the filter in the limit", ELEVATION),
        _a("/criterion/period_error", "stretch", "deg", "half the acceleration times the period squared", ELEVATION),
        _a("/criterion/memory_error", "stretch", "deg", "half the acceleration times the time constant squared",
           ELEVATION),
        _a("/limit/correlation_time", "correlation_time", "s", "correlation time of the angle's acceleration",
           ELEVATION),
        _a("/limit/ratio", "correlation_time", "1", "period over the correlation time", ELEVATION),
        _a("/limit/to_velocity", "correlation_time", "1",
           "largest difference of the exact transition matrix from that of constant velocity", ELEVATION),
        _a("/limit/to_acceleration", "correlation_time", "1",
           "largest difference of the exact transition matrix from that of constant acceleration", ELEVATION),
        _a("/limit/to_white", "correlation_time", "1",
           "largest relative difference of Q of angle and rate from that of a white acceleration", ELEVATION),
        _a("/limit/drive", "correlation_time", "1",
           "variance that a period adds to the acceleration, relative to its steady variance", ELEVATION),
        _a("/limit/angle", "correlation_time", "1", "steady variance of the angle over that of the paper's model",
           ELEVATION),
        _a("/azimuth/rate_variance", "rate_variance", "deg2/s2", "Q of the filter", ELEVATION),
        _a("/azimuth/time", "time", "s", "time of the approach", ELEVATION),
        _a("/azimuth/angle", "time", "deg", "true azimuth", ELEVATION),
        _a("/azimuth/steady_sigma", "rate_variance", "deg", "1 sigma of the azimuth in the limit", ELEVATION),
        _labels("/flare/source", "guidance source in the flare", ELEVATION, "angle of the station",
                "range and radio altimeter", "both"),
        _a("/flare/rate_variance", "rate_variance", "deg2/s2", "Q of the filter", ELEVATION),
        _a("/flare/time", "time", "s", "time of the approach", ELEVATION),
        _a("/flare/beta", "time", "deg", "true angle", ELEVATION),
        _a("/flare/measured_sigma", "source time", "deg", "1 sigma of one measured angle", ELEVATION),
        _a("/flare/touchdown_rmse", "source rate_variance", "deg", "root mean square error at touchdown", ELEVATION),
        _a("/flare/touchdown_height_rmse", "source rate_variance", "m",
           "root mean square error at touchdown as a height over the station's plane", ELEVATION),
        _a("/published/statement", "statement", "1", "statement of the paper", ELEVATION, TEXT),
        _a("/published/published", "statement", "see unit", "the paper's value", ELEVATION),
        _a("/published/computed", "statement", "see unit", "the value computed", ELEVATION),
        _a("/published/unit", "statement", "1", "units", ELEVATION, TEXT),
        _a("/published/verdict", "statement", "1", "verdicts", ELEVATION, TEXT),
    ),
)  # fmt: skip

_SI = "m, m/s, m/s2, rad, rad/s"
_CIRCUIT = (ATC, AZIMUTH)
_ATC_FILTERS = {
    "state": ("full", "adapt", "fix"), "singer_state": ("singer",), "cartesian_state": ("cartesian",),
}  # fmt: skip
_AZIMUTH_FILTERS = ("S1", "S2", "L1", "L2", "L3", "L4")
_AZIMUTH_VARIANTS = ("L4_stamped", "L4_roll", "L4_track_rate", "L4_roll_stamped")
_TRACKING = Chapter(
    "Tracking",
    "Filters of the companion papers on tracking from the ground; further cases have the layout of the first.",
    (
        _a("/time", "time", "s", "scans", _CIRCUIT),
        _a("/cases/{case}/scan_{case}", "scan_{case}", "1", "number of the scan", _CIRCUIT, WHOLE),
        _a("/cases/{case}/time", "scan_{case}", "s", "scans", _CIRCUIT),
        _a("/filter", "filter", "1", "filters", _CIRCUIT, TEXT),
        _a("/window", "window", "1", "stretches of the circuit", _CIRCUIT, TEXT),
    ),
)  # fmt: skip

_ATC = Chapter(
    "Air traffic control",
    "Errors truth - estimate.",
    (
        _a("/case", "case", "1", "cases: scan period, measurements", ATC, TEXT),
        _a("/state", "state", "1", "states", ATC, TEXT, attributes=("state_units",)),
        _a("/singer_state", "singer_state", "1", "states of singer: m, m/s, m/s2", ATC, TEXT),
        _a("/cartesian_state", "cartesian_state", "1", "figures of cartesian: m, m/s, rad, rad", ATC, TEXT),
        *(
            entry
            for state, names in _ATC_FILTERS.items()
            for place, scan in (("", "time"), ("/cases/{case}", "scan_{case}"))
            for entry in (
                _a(place + "/filters/{filter}/error", f"run {scan} {state}", _SI, "truth - estimate, after the update",
                   ATC, filter=names),
                _a(place + "/filters/{filter}/sigma", f"{scan} {state}", _SI, "1 sigma of the filter, first run", ATC,
                   filter=names),
            )
        ),
        _a("/summary/rmse", "case filter window state interval", _SI, "root mean square error over runs and scans",
           ATC),
        _labels("/decoupled", "decoupled filters", ATC, "adapt", "fix"),
        _a("/summary/decoupled_to_full", "case decoupled window state interval", "1",
           "RMSE over that of the full filter", ATC),
        _a("/range_state", "range_state", "1", "range and its rate", ATC, TEXT),
        _a("/summary/singer_to_adapt", "case window range_state interval", "1", "RMSE of Singer over that of adapt",
           ATC),
        _a("/summary/multiplications_full", "", "1",
           "multiplications of a covariance step, 13 states, six scalar updates", ATC, WHOLE),
        _a("/summary/multiplications_decoupled", "", "1", "multiplications for the six groups", ATC, WHOLE),
        _a("/summary/stored_full", "", "1", "numbers of the covariance stored", ATC, WHOLE),
        _a("/summary/stored_decoupled", "", "1", "numbers of the covariances of the six groups stored", ATC, WHOLE),
        *(
            _a(path, dims, units, meaning, ATC, when="where `link.study_runs` is not 0 and there is noise")
            for path, dims, units, meaning in (
                ("/link/age", "age", "s", "age of quantised reports"),
                ("/link/exact_rmse", "reports link_filter range_state interval", "m, m/s",
                 "RMSE in the manoeuvre with reports of no age, not quantised"),
                ("/link/rmse", "reports age knowledge link_filter range_state interval", "m, m/s",
                 "RMSE in the manoeuvre with quantised reports of this age"),
                ("/link/cost", "reports age knowledge link_filter range_state interval", "1",
                 "that over the RMSE with exact reports, in the same runs"),
            )
        ),
        _labels("/link/reports", "reported quantity", ATC, "levels", "levels and rates"),
        _labels("/link/knowledge", "filter model of age and quantisation", ATC, "unknown", "known"),
        _labels("/link/link_filter", "filters that use reports", ATC, "full", "adapt", "fix", "cartesian"),
        _labels("/group", "pairs of level and rate", ATC, "speed", "path_angle", "track", "elevation", "azimuth"),
        _labels("/gain_of", "gain of", ATC, "level", "rate"),
        _a("/limits/sigma", "group", "m/s, rad", "steady 1 sigma of the level", ATC),
        _a("/limits/gain", "group gain_of", "1, 1/s", "steady gain", ATC),
    ),
)  # fmt: skip

_AZIMUTH = Chapter(
    "Azimuth",
    "Degrees; errors truth minus estimate.",
    (
        _a("/instant", "instant", "1", "instants of the true circuit", AZIMUTH, WHOLE),
        _labels("/axis", "axes from the radar", AZIMUTH, "north", "up", "east"),
        _a("/truth/time", "instant", "s", "time of the circuit", AZIMUTH),
        _a("/truth/position", "instant axis", "m", "position from the radar", AZIMUTH),
        _a("/truth/azimuth", "instant", "deg", "azimuth", AZIMUTH),
        _a("/truth/azimuth_rate", "instant", "deg/s", "azimuth rate", AZIMUTH),
        _a("/truth/azimuth_acceleration", "instant", "deg/s2", "azimuth acceleration", AZIMUTH),
        _a("/truth/azimuth_acceleration_literal", "instant", "deg/s2",
           "azimuth acceleration literal (the paper's eq. 14: north component)", AZIMUTH),
        _a("/truth/roll", "instant", "deg", "roll", AZIMUTH),
        _a("/period", "period", "s", "scan periods of the cases", AZIMUTH),
        _a("/latency", "latency", "s", "age of reports", AZIMUTH),
        *(
            entry
            for place, scan, names in (("", "time", (*_AZIMUTH_FILTERS, *_AZIMUTH_VARIANTS)),
                                       ("/cases/{case}", "scan_{case}", _AZIMUTH_FILTERS))
            for entry in (
                _a(place + "/filters/{filter}/error_deg", f"run {scan}", "deg",
                   "azimuth error, truth minus estimate, after the update", AZIMUTH, filter=names),
                _a(place + "/filters/{filter}/sigma_deg", scan, "deg", "1 sigma of the filter, first run", AZIMUTH,
                   filter=names),
            )
        ),
        _a("/summary/rmse", "period filter window interval", "deg",
           "root mean square azimuth error over runs and scans", AZIMUTH),
        _a("/summary/nis", "period filter window", "1", "mean normalised innovation squared; one is right", AZIMUTH),
        _labels("/baseline", "Singer's filters", AZIMUTH, "S1", "S2"),
        _a("/summary/ratio_to_l4", "period baseline window interval", "1", "RMSE over that of L4", AZIMUTH),
        _a("/summary/growth", "period baseline interval", "1",
           "RMSE in the manoeuvre over RMSE on the straight stretch", AZIMUTH),
        _a("/summary/peak_growth", "period baseline", "1",
           "largest RMSE of a scan of the manoeuvre over RMSE on the straight stretch", AZIMUTH),
        _labels("/age", "filter model of the age of reports", AZIMUTH, "unknown", "stamped"),
        _a("/summary/latency_rmse", "period latency age", "deg", "RMSE of L4 in the manoeuvre", AZIMUTH),
        _labels("/acceleration", "accelerations of the azimuth", AZIMUTH, "exact", "error of (14)",
                "error of a_t/Dh"),
        _a("/summary/acceleration_rms", "window acceleration", "deg/s2", "root mean square of each", AZIMUTH),
        *(
            _a(path, dims, units, meaning, AZIMUTH, when="where `map.runs` is not 0 and there is noise")
            for path, dims, units, meaning in (
                ("/map/scan_period", "scan_period", "s", "scan period"),
                ("/map/azimuth_sigma", "azimuth_sigma", "deg", "of plots"),
                ("/map/report_age", "report_age", "s", "age of reports, unknown"),
                ("/map/ratio", "scan_period azimuth_sigma", "1",
                 "best Singer over best L4, RMSE in the manoeuvre"),
                ("/map/ratio_by_latency", "scan_period report_age", "1",
                 "best Singer over best L4, RMSE in the manoeuvre"),
                ("/map/singer_sigma", "singer_sigma", "m/s2", "1 sigma of Singer's acceleration"),
                ("/map/growth", "scan_period singer_sigma", "1",
                 "Singer's RMSE in the manoeuvre over RMSE on the straight stretch"),
            )
        ),
    ),
)  # fmt: skip

PART = "/part"
"""Group with the data for `navsim merge`."""
_PART = Chapter(
    "Part of an ensemble",
    "Data that `navsim merge` needs, whatever `--keep` left out: statistics of every run, and sums over runs by "
    "blocks. Each block has a power of two of runs and begins at a multiple of its length.",
    (
        _a(f"{PART}/column", "column", "1", "names of the statistics of a run, some with several columns",
           (LANDING, RARE), TEXT),
        _a(f"{PART}/of_run", "run column", "1", "statistics of every run, each in its own unit", (LANDING, RARE),
           attributes=("layout",)),
        _a(f"{PART}/block", "block", "1", "first run of each block", LANDING, WHOLE),
        _a(f"{PART}/entry", "entry", "1", "numbers of the sums", LANDING, WHOLE),
        _a(f"{PART}/sum", "block entry", "1", "sums over the runs of a block, each in its own unit", LANDING,
           attributes=("layout",)),
    ),
)  # fmt: skip

FINDINGS = "/findings"
"""Group with the findings."""
_FINDINGS = Chapter(
    "Findings",
    "Warnings with counts, in every result; of length 0 without warnings.",
    tuple(
        _a(f"{FINDINGS}/{name}", "finding", units, meaning, tuple(LAYOUTS), of)
        for name, units, meaning, of in (
            ("finding", "1", "names of the findings", TEXT),
            ("text", "1", "message", TEXT),
            ("against", "1", "condition that it violates: fix, consistent, or neither", TEXT),
            ("count", "1", "number of items concerned", WHOLE),
            ("of", "1", "number of all items", WHOLE),
            ("runs", "1", "in how many runs", WHOLE),
            ("first", "s", "time of the first, nan without a time", NUMBER),
        )
    ),
)  # fmt: skip

PROVENANCE = "/provenance"
INPUTS, SOFTWARE = f"{PROVENANCE}/input", f"{PROVENANCE}/item"
_PROVENANCE = Chapter(
    "Provenance",
    "Files that were read and software that computed. `navsim verify` compares them with its own.",
    tuple(
        _a(path, dim, units, meaning, [layout for layout in LAYOUTS if layout != LIVE], of, when="of a file on disk")
        for path, dim, units, meaning, of in (
            (INPUTS, "input", "1", "names of the files that were read, as the scenario has them", TEXT),
            (f"{INPUTS}_key", "input", "1", "keys that name them; empty for the scenario or study itself", TEXT),
            (f"{INPUTS}_sha256", "input", "1", "SHA-256 of each file", TEXT),
            (f"{INPUTS}_bytes", "input", "byte", "size of each file", WHOLE),
            (SOFTWARE, "item", "1", "software, machine and options", TEXT),
            (f"{PROVENANCE}/value", "item", "1", "version, digest or name of each", TEXT),
        )
    ),
)

SECTIONS = (
    _AXES, _TRUTH, _RECEIVER, _FILTER, _CONSISTENCY, _ANALYSIS, _SUMMARY, _CONTROLLED, _BOX, _INTERFERENCE,
    _CORRECTIONS, _INTEGRITY, _REQUIREMENTS, _NAVIGATION, _REPLAY, _RANGES, _LIVE, _SWEEP, _OPTIMIZE, _TABLE2,
    _INTEGRITY_TABLE, _ELEVATION, _TRACKING, _ATC, _AZIMUTH, _PART, _FINDINGS, _PROVENANCE,
)  # fmt: skip
"""All entries, in the order of the documentation."""

CHECKSUMS, CONTENTS = "checksums", "contents"
"""Root attributes of files, which `results.result` writes."""
NOT_REPEATED = ("created", "navsim_version", CONTENTS)
"""Root attributes that another computation of the same result may change; `PROVENANCE` are the variables."""
ROOT: Mapping[str, tuple[tuple[str, ...], str]] = {
    "kind": (tuple(LAYOUTS), "kind of result; landing for landing, covariance and rare"),
    "schema_version": (tuple(LAYOUTS), "version of this page's contents"),
    "navsim_version": (tuple(LAYOUTS), "the version that wrote the file"),
    "seed": (tuple(LAYOUTS), "root of all random numbers"),
    "scenario": (tuple(LAYOUTS), "the complete resolved scenario, YAML"),
    "study": ((SWEEP, OPTIMIZE), "the complete resolved study, YAML"),
    "scenario_sha256": (tuple(LAYOUTS), "SHA-256 of study and scenario"),
    "epoch": (tuple(LAYOUTS), "UTC of time 0"),
    "created": (tuple(LAYOUTS), "when the file was made, UTC"),
    "title": (tuple(LAYOUTS), "title of study or scenario"),
    "method": ((LANDING, COVARIANCE, RARE, SWEEP), "monte-carlo, covariance or rare; of a sweep also dop"),
    "files": ((SWEEP,), "checksums of the files that combinations read, JSON"),
    "runs": ((SWEEP,), "runs of each combination, 0 without runs"),
    "combinations": ((SWEEP,), "number of combinations"),
    "refused": ((SWEEP,), "number of combinations that are nan"),
    "objective": ((OPTIMIZE,), "objective"),
    "stopped": ((OPTIMIZE,), "why the work ended early; empty if it is complete"),
    "undone": ((OPTIMIZE,), "remaining part of the work"),
    "recorded_s": ((REPLAY, RANGES), "first and last time of samples and fixes in the log, or of the ranges used, s"),
    "measurement": ((RANGES,), "two_way or one_way"),
    "datum": ((RANGES,), "clock that is the datum; empty for two-way ranges"),
    "flown_s": ((REPLAY,), "first and last time of the log that the filter uses, s"),
    "not_judged": ((REPLAY,), "units, axes, signs and clocks that this flight does not show; they are unchecked"),
    "alignment_time": ((REPLAY,), "time of the log at which the flight is aligned, s"),
    "alignment_until": ((REPLAY,), "end of the alignment data, s"),
    "alignment_sigma_deg": ((REPLAY,), "1 sigma of the alignment, north, east, down, degrees"),
    "replaced_block": ((LIVE,), "receiver or imu: which block was real"),
    "clock": ((LIVE,), "basis of the source's clock"),
    "verdict": ((LIVE,), "flown, or the reason why this is not a valid result"),
    "least_pdop_of_case_6_from_cases_1_and_2": ((TABLE2,), "bound on case 6 from the paper's cases 1 and 2"),
    "largest_pdop_of_case_6_printed": ((TABLE2,), "the paper's printed value for case 6, rounding in its favour"),
    CHECKSUMS: (tuple(LAYOUTS), "marks a file with checksums"),
    CONTENTS: (tuple(LAYOUTS), "digest of each variable and root attribute, JSON"),
}
"""Root attributes: layouts and meanings."""
LATE = ("verdict", CHECKSUMS, CONTENTS)
"""Root attributes that are given when the rest of the result is there."""


@dataclass(frozen=True)
class Declared:
    """A variable that a result may hold, the families of its path filled in; `when`, `of`, `attributes`, `labels` as of
    its `Entry`. coordinates: the paths of those that its dimensions have."""

    dims: tuple[str, ...]
    units: str
    meaning: str
    when: str
    of: str
    attributes: tuple[str, ...]
    labels: tuple[str, ...]
    coordinates: tuple[str, ...] = ()


_FIELD = re.compile(r"{(\w+)}")


def fields(text: str) -> list[str]:
    """The names in braces of a path, a unit or a meaning."""
    return _FIELD.findall(text)


@cache
def declared(layout: str, named: tuple[tuple[str, tuple[str, ...]], ...] = ()) -> Mapping[str, Declared]:
    """All that a result of this layout may hold, by path. named: families and the members that the study names, see
    `FAMILIES`; a family without members is left out."""
    members = dict.fromkeys(FAMILIES, ()) | dict(named)
    axes = members["dimension"]
    out: dict[str, Declared] = {}
    for entry in (entry for section in SECTIONS for entry in section.entries if layout in entry.layouts):
        dims = tuple(d for dim in entry.dims for d in (axes if dim == "*axes" else (dim,)))
        if layout in ONE_FLIGHT:
            dims = tuple(dim for dim in dims if dim != "run")
        families = list(dict.fromkeys(fields(entry.path)))
        for chosen in itertools.product(*(entry.each.get(family) or members[family] for family in families)):
            words = dict(zip(families, chosen, strict=True))

            def filled(text: str, words: dict[str, str] = words) -> str:
                for name, word in words.items():
                    text = text.replace(f"{{{name}}}", word).replace(f"{{{name.upper()}}}", word.upper())
                return text

            path = filled(entry.path)
            assert path not in out, path
            out[path] = Declared(
                tuple(map(filled, dims)), filled(entry.units), filled(entry.meaning), entry.layouts[layout], entry.of,
                entry.attributes, entry.labels,
            )  # fmt: skip
    coordinates = {path for path, one in out.items() if one.dims == (path.rsplit("/", 1)[-1],)}
    return MappingProxyType({
        path: replace(one, coordinates=tuple(_coordinate(path, dim, coordinates) for dim in one.dims))
        for path, one in out.items()
    })  # fmt: skip


def _coordinate(path: str, dim: str, coordinates: set[str]) -> str:
    """The path of a dimension's coordinate: in the variable's group or the nearest above it; "" for none."""
    group = path
    while group:
        group = group.rpartition("/")[0]
        if f"{group}/{dim}" in coordinates:
            return f"{group}/{dim}"
    return ""
