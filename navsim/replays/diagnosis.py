"""Check a recording before the filter uses it: units, axes, signs, columns, times.

A filter follows its fixes, so innovations look healthy even with a negated axis: biases and tuned noise absorb the
mistake. Therefore each stage compares two quantities that must agree, and finds the simplest correction that makes them
agree:

- sample intervals and spans of both files: units of time;
- mean specific force against gravity: unit of the accelerometers, gyros and accelerometers exchanged;
- changes of position against velocity [1]: angles, heights, speeds, axes of the velocity. The slope of one over the
  other, with its noise, decides between units that differ by a factor, and on the sign of the vertical velocity;
- specific force rotated by the gyros against changes of velocity, in pieces and windows: signs and columns of either
  triad, unit of the gyros, time offset. One rotation is free [2]; the biases are profiled out;
- gravity and velocity in the axes found so: body axes.

Wild fixes are removed first (`wild_fixes`): a mistake of units or axes is in all fixes.

Quantities that the motion does not show are not checked. A correction is reported only if the recording as written fits
clearly worse than the best one; equally good corrections are reported together. Each stage uses the corrections of the
stage before, so several mistakes are found.

Sources: [1] Groves (2013), section 17.4 (consistency tests). [2] Wu & Pan (2013), as `replays.alignment`. [3] White
(1980), Econometrica 48(4): 817-838 (variance of a regression whose errors differ).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import BODY_AXES, LEVEL_AXES, GnssConvention, ImuConvention, axes_letters, axes_matrix
from navsim.formats.recorded_data import Fixes, Samples
from navsim.formats.recording import increments_as_rates
from navsim.geodesy import earth
from navsim.geodesy.attitude import wahba
from navsim.replays.wild_fixes import plausible

GRAVITY = 9.8
"""m/s2, where a tenth does not matter."""
SLOWEST, FASTEST = 0.5, 5e-5
"""Intervals of inertial samples, s, that are in another unit for certain."""
RAREST = 5.0
"""Interval of fixes, s, that is looked into."""
PLAUSIBLE = (0.6, 1.8)
"""Mean specific force of a flight over gravity: circuits and turns have 1 to 1.5."""
NEAR = (0.8, 1.3)
"""`FITS` for the explanation by a unit."""
STEADY = 0.4
"""Spread of specific force over its mean that a flight has at most; rates of rotation spread more."""
WINDOW = 10.0
"""Length of the pieces over which positions and velocities are compared, s."""
SHORTEST_WAYS, SHORTEST_CLIMBS = (15.0, 4.0), (8.0, 3.0)
"""Pieces of a shorter way or climb, m, do not count: positions wander. The second is for flights that have too few
longer ones: of these only a correction that explains them is a mistake."""
FITS, MISFITS = 0.35, 0.5
"""Difference of two displacements over their mean, median of all pieces: a fit up to the first, none from the second
on."""
ACCEPTED = 0.15
"""Fit that a correction must reach."""
LEAST_SCATTER = 0.02
"""Scatter of a way about its velocities' over its length that is always allowed for: accelerations between fixes."""
MOST_SECONDS = 600.0
"""Longest part of a flight, from its first motion on, that sensors are compared over."""
STEP = 0.1
"""Steps of the attitude integration, s."""
PIECE, PIECES = 1.0, 15
"""Length of a piece, s, and pieces in a window with one rotation."""
OFFSETS = 40.0
"""Largest offset between the clocks that is looked for, s: GPS time is 18 s from UTC, TAI 37 s."""
USUAL_OFFSET = (-2.1, 0.4)
"""Times of samples less those of fixes, s, that the latency of a receiver explains."""
USUAL_LATENCY = 0.5
"""Latency that a receiver without a radio link has at most, s."""
LEAST_WINDOWS, LARGEST_SHARE = 2, 0.7
"""A clock offset needs so many windows of the recording as written, at least half of them. It is at most this fraction
of their length, since a flight that repeats itself fits a few windows anywhere."""
LIKELY = 9.0
"""A factor is as likely as another whose chi-square is less by no more than this: three sigma."""
APART = 2.0
"""Offsets of the clocks farther apart than this, s, are different ones."""
WORSE, CERTAIN = 1.25, 20.0
"""A fit is worse than the best if its residual is larger by the first factor and its chi-square by the second number.
The chi-square is divided by four for correlated residuals."""
MOVING, HEADING_SIGMA = 3.0, 0.2
"""Speed, m/s, from which on, and 1 sigma of the heading, rad, up to which a course shows where the nose points."""
ALONG = 0.75
"""Least mean component of a direction along the axis that it is taken for."""
GYRO_BIAS, ACCEL_BIAS = 5e-3, 0.1
"""1 sigma of the biases, rad/s, m/s2, those of poor sensors whichever class the log names: 1000 deg/h, 10 mg."""
_NUDGE = 1e-6
"""Step of numerical derivatives by the gyros' bias, rad/s: small, since it adds up over the flight."""
SHORT_LIST = 40
"""Hypotheses that are fitted with biases, the best without."""
LEAST_RESIDUAL = 0.05
"""1 sigma that no hypothesis explains, m/s: smaller differences decide nothing."""
LEAST_WEIGHT = 0.1
"""Least weight of the vertical velocity relative to the horizontal one."""
VELOCITY_SIGMA = 0.3
"""1 sigma of a piece's velocity change, relative to that of the biases, m/s."""


@dataclass(frozen=True)
class Mistake:
    """A probable mistake in how a recording is written.

    It has the evidence in numbers, a statement of what seems wrong, and remedies. Any one remedy would explain it; each
    is a set of keys of the log with values. It is reported at the file of the first key, or `without_remedy`.
    """

    evidence: str
    seems: str
    remedies: tuple[Mapping[str, Any], ...] = ()
    without_remedy: str = "imu"

    @property
    def section(self) -> str:
        """`imu` or `gnss`, the file it is about."""
        return next(iter(self.remedies[0])).partition(".")[0] if self.remedies else self.without_remedy

    def __str__(self) -> str:
        written = ", or ".join(f"`{_as_yaml(remedy)}`" for remedy in self.remedies)
        return f"{self.evidence}: {self.seems}" + (f"; write {written}" if written else "")


def _as_yaml(remedy: Mapping[str, Any]) -> str:
    sections: dict[str, list[str]] = {}
    for key, value in remedy.items():
        section, _, name = key.partition(".")
        shown = value
        if isinstance(value, Mapping):
            shown = "{" + ", ".join(f"{a}: {b}" for a, b in value.items()) + "}"
        sections.setdefault(section, []).append(f"{name}: {shown}")
    return ", ".join(f"{section}: {{{', '.join(keys)}}}" for section, keys in sections.items())


@dataclass(frozen=True)
class Log:
    """A recording read under some conventions, SI."""

    samples: Samples
    fixes: Fixes
    imu: ImuConvention = conventions.IMU_AS_DUE
    gnss: GnssConvention = conventions.GNSS_AS_DUE
    latency: float | None = None
    """Latency of the fixes, s; None: to be tuned."""
    first: float = -np.inf
    """First time for the checks of the sensors, s; `last` likewise."""
    last: float = np.inf
    sentences: bool = False
    """The fixes are NMEA, which fixes units and axes; the only correction is a time offset."""


@dataclass(frozen=True)
class Diagnosis:
    """Mistakes in the order of their correction, and quantities that the motion does not show, in which a mistake would
    remain."""

    mistakes: list[Mistake]
    not_judged: list[str]


def diagnose(log: Log) -> list[Mistake]:
    """All detectable mistakes of a recording, in the order of their correction."""
    return examine(log).mistakes


def examine(log: Log) -> Diagnosis:
    """Mistakes of a recording, and quantities that cannot be checked."""
    unseen: list[str] = [NEVER_JUDGED]
    found, log = times(replace(log, fixes=log.fixes.take(plausible(log.fixes))))
    more, log = scales(log)
    found += more
    more, log = ways(log, unseen)
    found += more
    apart = overlap(log)
    if apart or any(not mistake.remedies for mistake in found):
        return Diagnosis(found + apart, [*unseen, f"{_OF_SENSORS}: other mistakes come first"])
    more, log = motion(log, unseen)
    return Diagnosis(found + _without_mirrors(more, log), unseen)


NEVER_JUDGED = (
    "lever arm, scale factors of the sensors, datum of the heights (ellipsoid or mean sea level): no check covers them"
)
NOTHING_EXPLAINS = "nothing explains the velocities, not as written either"
_OF_HEIGHTS = "sign of the vertical velocity, unit of the height"
_OF_SENSORS = "signs, columns and axes of the sensors, unit of the gyros, clocks"


# --- times


def times(log: Log) -> tuple[list[Mistake], Log]:
    """Units of time: intervals no sensor has, and spans of the two files that differ by a power of ten."""
    found: list[Mistake] = []
    interval = float(np.median(np.diff(log.samples.time)))
    span, other = np.ptp(log.samples.time), np.ptp(log.fixes.time)
    if not FASTEST <= interval <= SLOWEST:
        fits = {
            unit: factor
            for unit, factor in _relative(conventions.TIME_UNITS, log.imu.time_unit).items()
            if 2.0 * FASTEST <= interval * factor <= 0.4 * SLOWEST
        }
        if fits:
            unit = min(fits, key=lambda u: abs(np.log(fits[u] * span / other)))
            found.append(
                Mistake(
                    f"the inertial samples are {interval:g} s apart and span {span:.6g} s, the fixes {other:.6g} s",
                    f"their time seems to be in {unit}",
                    ({"imu.time_unit": unit},),
                )
            )
            samples = replace(log.samples, time=log.samples.time * fits[unit])
            if log.imu.increments:
                samples = replace(samples, rate=samples.rate / fits[unit], force=samples.force / fits[unit])
            log = replace(log, samples=samples, imu=replace(log.imu, time_unit=unit))
            span *= fits[unit]
    apart = float(np.median(np.diff(log.fixes.time)))
    if not log.sentences and (apart > RAREST or apart < 2e-3):
        fits = {
            unit: factor
            for unit, factor in _relative(conventions.TIME_UNITS, log.gnss.time_unit).items()
            if 5e-3 <= apart * factor <= 60.0 and abs(np.log(factor * other / span)) < abs(np.log(other / span)) - 2.0
        }
        if fits:
            unit = min(fits, key=lambda u: abs(np.log(fits[u] * other / span)))
            found.append(
                Mistake(
                    f"the fixes are {apart:g} s apart and span {other:.6g} s, the inertial samples {span:.6g} s",
                    f"their time seems to be in {unit}",
                    ({"gnss.time_unit": unit},),
                )
            )
            offset = log.gnss.time_offset
            fixes = replace(log.fixes, time=(log.fixes.time - offset) * fits[unit] + offset)
            log = replace(log, fixes=fixes, gnss=replace(log.gnss, time_unit=unit))
    return found, log


def _relative(units: dict[str, float], written: str) -> dict[str, float]:
    """The other units, each over the one that values were read in."""
    return {unit: factor / units[written] for unit, factor in units.items() if unit != written}


def overlap(log: Log) -> list[Mistake]:
    """Two files with no common time."""
    samples, fixes = log.samples.time, log.fixes.time
    if samples[0] <= fixes[-1] and fixes[0] <= samples[-1]:
        return []
    shift = float(round(log.gnss.time_offset + samples[0] - fixes[0]))
    return [
        Mistake(
            f"the recordings have no common time: samples {samples[0]:.1f} to {samples[-1]:.1f} s, fixes "
            f"{fixes[0]:.1f} to {fixes[-1]:.1f} s",
            "their clocks do not start together; if both files begin at the same moment",
            ({"gnss.time_offset_s": shift},),
        )
    ]


# --- gravity


def scales(log: Log) -> tuple[list[Mistake], Log]:
    """Unit of the accelerometers, and gyros exchanged with accelerometers: mean specific force must be gravity."""
    (force, _), (rate, spread) = (_strength(log.samples, v) for v in (log.samples.force, log.samples.rate))
    if PLAUSIBLE[0] <= force / GRAVITY <= PLAUSIBLE[1]:
        return [], log
    units = _relative(conventions.ACCELEROMETER_UNITS, log.imu.accelerometer_unit)
    evidence = f"the mean specific force is {force:.4g} where gravity is {GRAVITY} m/s2"
    if NEAR[0] <= rate / GRAVITY <= NEAR[1] and force < 0.3 * GRAVITY and spread < STEADY:
        gyros, accelerometers = conventions.IMU_COLUMNS[1:4], conventions.IMU_COLUMNS[4:]
        before = {name: log.imu.columns.get(name, name) for name in (*gyros, *accelerometers)}
        columns = dict(log.imu.columns)
        for ours, theirs in zip(gyros, accelerometers, strict=True):
            columns |= {ours: before[theirs], theirs: before[ours]}
        found = Mistake(
            f"{evidence}, and the mean of the angular rate {rate:.3g} rad/s",
            "gyros and accelerometers seem to be exchanged",
            ({"imu.columns": columns},),
        )
        samples = Samples(log.samples.time, log.samples.force, log.samples.rate)
        return [found], replace(log, samples=samples, imu=replace(log.imu, columns=columns))
    for unit, factor in units.items():
        if NEAR[0] <= factor * force / GRAVITY <= NEAR[1]:
            found = Mistake(evidence, f"the accelerometers seem to be in {unit}", ({"imu.accelerometer_unit": unit},))
            samples = replace(log.samples, force=factor * log.samples.force)
            return [found], replace(log, samples=samples, imu=replace(log.imu, accelerometer_unit=unit))
    interval = float(np.median(np.diff(log.samples.time)))
    if not log.imu.increments:
        for unit, factor in {log.imu.accelerometer_unit: 1.0, **units}.items():
            if not NEAR[0] <= factor * force / interval / GRAVITY <= NEAR[1]:
                continue
            remedy = {"imu.samples": "increments"}
            if factor != 1.0:
                remedy["imu.accelerometer_unit"] = unit
            found = Mistake(
                f"{evidence}, {factor * force / interval:.3g} when divided by the interval of {interval:g} s",
                "the samples seem to be increments of angle and velocity, not rates",
                (remedy,),
            )
            both = increments_as_rates(log.samples.time, np.hstack([log.samples.rate, factor * log.samples.force]))
            samples = Samples(log.samples.time, both[:, :3], both[:, 3:])
            imu = replace(log.imu, increments=True, accelerometer_unit=unit)
            return [found], replace(log, samples=samples, imu=imu)
    elif NEAR[0] <= force * interval / GRAVITY <= NEAR[1]:
        found = Mistake(
            f"{evidence}, {force * interval:.3g} when not divided by the interval of {interval:g} s",
            "the samples seem to be rates, not increments",
            ({"imu.samples": "instantaneous"},),
        )
        samples = replace(log.samples, rate=interval * log.samples.rate, force=interval * log.samples.force)
        return [found], replace(log, samples=samples, imu=replace(log.imu, increments=False))
    return [Mistake(evidence, "no known unit of the accelerometers explains it")], log


def _strength(samples: Samples, values: np.ndarray) -> tuple[float, float]:
    """Median of the norms of means over about a second, and half the spread of their middle four fifths over it.

    Means remove vibration but not gravity.
    """
    count = max(1, round(1.0 / float(np.median(np.diff(samples.time)))))
    starts = np.arange(0, values.shape[0], count)
    sizes = np.diff(np.append(starts, values.shape[0]))
    norms = np.linalg.norm(np.add.reduceat(values, starts, axis=0) / sizes[:, None], axis=1)
    low, median, high = np.percentile(norms, [10.0, 50.0, 90.0])
    return float(median), float(0.5 * (high - low) / median) if median > 0.0 else np.inf


# --- positions against velocities


def ways(log: Log, unseen: list[str]) -> tuple[list[Mistake], Log]:
    """Check angles, heights, speeds and axes of the velocity: position changes must equal the integrated velocity.

    unseen: receives messages about quantities that cannot be checked.
    """
    found: list[Mistake] = []
    if not log.sentences:  # their positions are on Earth, or they are corrupt
        found, log = _angles(log)
    more, cures = _level(log)
    if len(cures) > 1 and not overlap(log):
        more, cures = _decided_by_motion(more, cures)
    found, log = found + more, cures[0]
    known = bool(np.isfinite(log.fixes.velocity[:, 2]).any())
    way, summed = _moved(log.fixes)
    for what, axes, shortest in (
        ("unit and axes of the horizontal velocity, unit of the angles", slice(0, 2), SHORTEST_WAYS),
        (_OF_HEIGHTS, slice(2, 3), SHORTEST_CLIMBS),
    ):
        if not np.isfinite(log.fixes.velocity[:, axes]).all(axis=1).any():
            unseen.append(f"{what}: the fixes have no such velocity")
        elif np.isnan(_relative_residual(way[:, axes], summed[:, axes], shortest)[0]):
            unseen.append(f"{what}: fewer than three pieces of {WINDOW:g} s are longer than {shortest[1]:g} m")
    turned = any(set(remedy) == {"gnss.velocity_axes"} for mistake in more for remedy in mistake.remedies[:1])
    if turned and not (known and _climbs(log)):
        # east, north, down is rare, but the vertical velocity does not show it
        axes = more[-1].remedies[0]["gnss.velocity_axes"]
        other = axes[:2] + ("U" if axes[2] == "D" else "D")
        either = ({"gnss.velocity_axes": axes}, {"gnss.velocity_axes": other})
        found[-1] = replace(more[-1], remedies=(*either, *more[-1].remedies[1:]))
    if known:
        more, log = _vertical(log, unseen)
        found += more
        if len(found) > 1 and _both_turn(found[-2], found[-1]):
            level, vertical = found[-2:]
            seems = f"the columns vn, ve, vd seem to point {log.gnss.velocity_axes}"
            evidence = f"{level.evidence}, and {vertical.evidence}"
            found[-2:] = [Mistake(evidence, seems, ({**level.remedies[0], **vertical.remedies[0]},))]
    return found, log


def _angles(log: Log) -> tuple[list[Mistake], Log]:
    """Latitudes that cannot be."""
    lat, lon = np.degrees(np.abs(log.fixes.llh[:, :2])).max(axis=0)
    if lat > 1e4:
        unit, factor = "1e-7 deg", conventions.ANGLE_UNITS["1e-7 deg"] / conventions.ANGLE_UNITS[log.gnss.angle_unit]
        if log.gnss.angle_unit != unit and lat * factor <= 90.0:
            evidence = f"latitudes reach {lat:.6g} degrees"
            found = Mistake(evidence, f"angles seem to be in {unit}", ({"gnss.angle_unit": unit},))
            return [found], _with_angles(log, unit, factor)
    elif lat > 90.0 >= lon:
        evidence = f"latitudes reach {lat:.1f} degrees, longitudes {lon:.1f}"
        log, remedy = _exchanged(log)
        return [Mistake(evidence, "they seem to be exchanged", (remedy,))], log
    return [], log


def _climbs(log: Log) -> bool:
    """Whether enough pieces climb or descend to check the vertical velocity."""
    way, summed = _moved(log.fixes)
    return bool(np.isfinite(_relative_residual(way[:, 2:], summed[:, 2:], SHORTEST_CLIMBS)[0]))


def _both_turn(level: Mistake, vertical: Mistake) -> bool:
    """Whether both, each with one remedy, are about the axes of the velocity alone."""
    axes = {"gnss.velocity_axes"}
    return all(len(each.remedies) == 1 and set(each.remedies[0]) == axes for each in (level, vertical))


def _with_angles(log: Log, unit: str, factor: float) -> Log:
    llh = log.fixes.llh * [factor, factor, 1.0]
    return replace(log, fixes=replace(log.fixes, llh=llh), gnss=replace(log.gnss, angle_unit=unit))


def _exchanged(log: Log) -> tuple[Log, dict[str, Any]]:
    """Latitude and longitude exchanged, and the remedy."""
    names = conventions.GNSS_COLUMNS[1:3]
    before = [log.gnss.columns.get(name, name) for name in names]
    columns = {**log.gnss.columns, names[0]: before[1], names[1]: before[0]}
    fixes = replace(log.fixes, llh=log.fixes.llh[:, [1, 0, 2]])
    return replace(log, fixes=fixes, gnss=replace(log.gnss, columns=columns)), {"gnss.columns": columns}


def _with_position_axes(log: Log, axes: str) -> Log:
    """Fixes whose latitude and longitude increase along `axes`."""
    now, due = (np.array(conventions.POSITION_AXES[each]) for each in (log.gnss.position_axes, axes))
    llh = log.fixes.llh * [*(now * due), 1.0]
    return replace(log, fixes=replace(log.fixes, llh=llh), gnss=replace(log.gnss, position_axes=axes))


def _position_readings(log: Log) -> list[tuple[Log, Mapping[str, Any], str, np.ndarray]]:
    """Other interpretations of the columns of latitude and longitude: the log, keys, what seems to be the case, and the
    scale (3,) of the motion."""
    same = np.ones(3)
    exchanged, columns = _exchanged(log)
    out: list[tuple[Log, Mapping[str, Any], str, np.ndarray]] = [
        (exchanged, columns, "latitude and longitude seem to be exchanged", same)
    ]
    for axes, signs in conventions.POSITION_AXES.items():
        if axes != log.gnss.position_axes:
            changed = np.array(signs) != conventions.POSITION_AXES[log.gnss.position_axes]
            names = " and ".join(np.array(["latitude", "longitude"])[changed])
            seems = f"{names} {'seem' if changed.all() else 'seems'} to have the other sign"
            out.append((_with_position_axes(log, axes), {"gnss.position_axes": axes}, seems, same))
    for unit, factor in _relative(conventions.ANGLE_UNITS, log.gnss.angle_unit).items():
        scale = np.array([factor, factor, 1.0])
        seems = f"latitude and longitude seem to be in {unit}"
        out.append((_with_angles(log, unit, factor), {"gnss.angle_unit": unit}, seems, scale))
    return [entry for entry in out if np.degrees(np.abs(entry[0].fixes.llh[:, 0])).max() <= 90.0]


def _moved(fixes: Fixes) -> tuple[np.ndarray, np.ndarray]:
    """Position changes and integrated velocity (w, 3), NED m, over pieces of `WINDOW` seconds without holes.

    For fixes with a horizontal velocity. The vertical components are nan unless the vertical velocity is known
    throughout.
    """
    usual = float(np.median(np.diff(fixes.time)))
    fixes = fixes.take(np.isfinite(fixes.velocity[:, :2]).all(axis=1))
    time = fixes.time
    if time.size < 2:
        return np.empty((0, 3)), np.empty((0, 3))
    ecef, axes = earth.ecef_from_llh(fixes.llh), earth.ned_matrix(fixes.llh)
    steps = 0.5 * (fixes.velocity[1:] + fixes.velocity[:-1]) * np.diff(time)[:, None]
    gathered = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    way, summed = [], []
    begin = 0
    for end in range(1, time.size):
        if time[end] - time[end - 1] > 2.5 * usual + 0.5:
            begin = end
        elif time[end] - time[begin] >= max(WINDOW, 2.0 * usual) - 1e-6:
            way.append(axes[begin] @ (ecef[end] - ecef[begin]))
            summed.append(gathered[end] - gathered[begin])
            begin = end
    return np.reshape(way, (-1, 3)), np.reshape(summed, (-1, 3))


def _relative_residual(way: np.ndarray, summed: np.ndarray, shortest: tuple[float, float]) -> tuple[float, int, bool]:
    """Median of |difference| / mean length of two displacements (w, d), number of moving pieces, and whether they are
    long.

    nan with fewer than three pieces of either kind.
    """
    length = 0.5 * (np.linalg.norm(way, axis=1) + np.linalg.norm(summed, axis=1))
    for least in shortest:
        counts = length > least
        if counts.sum() >= 3:
            difference = np.linalg.norm(way - summed, axis=1)
            return float(np.median(difference[counts] / length[counts])), int(counts.sum()), least == shortest[0]
    return np.nan, int(counts.sum()), False


_LEVEL = [m for m in (axes_matrix(name, LEVEL_AXES) for name in conventions.all_axes(LEVEL_AXES)) if m[2, 2] == 1.0]
"""The eight ways to assign two columns to north and east, the third down."""


def _level(log: Log) -> tuple[list[Mistake], list[Log]]:
    """Mistake in the horizontal positions or velocities, and the log corrected by each of its remedies."""
    way, summed = _moved(log.fixes)
    as_written, count, certain = _relative_residual(way[:, :2], summed[:, :2], SHORTEST_WAYS)
    if np.isnan(as_written):
        return [], [log]
    if as_written <= MISFITS:
        found, log = _speed(log, way[:, :2], summed[:, :2])
        return found, [log]
    written = "kn" if log.sentences else log.gnss.speed_unit
    speeds = {written: 1.0, **_relative(conventions.SPEED_UNITS, written)}
    options: list[tuple[int, float, Log, dict[str, Any], str]] = []
    places: list[tuple[int, Log, Mapping[str, Any], str]] = [(0, log, {}, "")]
    if not log.sentences:
        places += [(1, placed, remedy, seems) for placed, remedy, seems, _ in _position_readings(log)]
    axes_now = axes_matrix(log.gnss.velocity_axes, LEVEL_AXES)
    for changes, placed, remedy, seems in places:
        moved, added = _moved(placed.fixes)
        for matrix, (unit, factor) in itertools.product([np.eye(3)] if log.sentences else _LEVEL, speeds.items()):
            turned = not np.array_equal(matrix, np.eye(3))
            turned_way = factor * added[:, :2] @ matrix[:2, :2].T
            residual, _, _ = _relative_residual(moved[:, :2], turned_way, SHORTEST_WAYS)
            if np.isnan(residual):
                continue
            letters = axes_letters(matrix @ axes_now, LEVEL_AXES)
            keys, said = dict(remedy), [seems] if seems else []
            if turned:
                keys["gnss.velocity_axes"] = letters
                said.append(f"the columns vn, ve, vd seem to point {letters}")
            if log.sentences:
                said.append(f"the sentences seem to give speeds as if {unit} were due, not {written}")
            elif unit != written:
                keys["gnss.speed_unit"] = unit
                said.append(f"speeds seem to be in {unit}")
            velocity = factor * placed.fixes.velocity
            velocity[:, :2] = velocity[:, :2] @ matrix[:2, :2].T  # the vertical one may be unknown
            gnss = replace(placed.gnss, velocity_axes=letters, speed_unit=unit)
            cured = replace(placed, fixes=replace(placed.fixes, velocity=velocity), gnss=gnss)
            options.append((changes + turned + (factor != 1.0), residual, cured, keys, " and ".join(said)))
    ratio = float(np.sum(np.linalg.norm(summed[:, :2], axis=1)) / np.sum(np.linalg.norm(way[:, :2], axis=1)))
    course = np.degrees(np.arctan2(summed[:, 1], summed[:, 0]) - np.arctan2(way[:, 1], way[:, 0]))
    turned_by = float(np.median(np.abs((course + 180.0) % 360.0 - 180.0)))
    evidence = (
        f"over {count} pieces of {WINDOW:g} s the velocities add up to {_ratio(ratio)} times the change of position, "
        f"{turned_by:.0f} degrees aside of it"
    )
    chosen = _simplest([(changes, residual) for changes, residual, *_ in options], as_written)
    if not chosen:
        return [Mistake(evidence, "position and velocity contradict each other", (), "gnss")][: int(certain)], [log]
    told = " or ".join(options[i][4] for i in chosen)
    remedies = () if log.sentences else tuple(options[i][3] for i in chosen)
    return [Mistake(evidence, told, remedies, "gnss")], [options[i][2] for i in chosen]


def _decided_by_motion(found: list[Mistake], cures: list[Log]) -> tuple[list[Mistake], list[Log]]:
    """Of equally good remedies those after which the sensors need the fewest corrections.

    Negating the longitude and mirroring the velocity explain the same contradiction. Only one of them leaves a
    trajectory that turns as the gyros do.
    """
    (mistake,) = found
    corrections = []
    for log in cures:
        unseen: list[str] = []
        more, _ = motion(_vertical(log, [])[1], unseen)
        unexplained = any(NOTHING_EXPLAINS in each for each in unseen)
        corrections.append(np.inf if unexplained else max((len(m.remedies[0]) for m in more if m.remedies), default=0))
    kept = [i for i, count in enumerate(corrections) if count == min(corrections)]
    if len(kept) == len(cures) or not mistake.remedies:
        return found, [cures[i] for i in kept]
    seems = mistake.seems.split(" or ")
    decided = replace(
        mistake, seems=" or ".join(seems[i] for i in kept), remedies=tuple(mistake.remedies[i] for i in kept)
    )
    return [decided], [cures[i] for i in kept]


def _speed(log: Log, way: np.ndarray, summed: np.ndarray) -> tuple[list[Mistake], Log]:
    """Speed units similar to the one written, such as miles an hour and knots, for velocities along the displacements
    (w, 2)."""
    slope = _Slope.of(way, summed)
    if slope is None or slope.misfit(1.0) <= CERTAIN:
        return [], log
    written = "kn" if log.sentences else log.gnss.speed_unit
    units = list(_relative(conventions.SPEED_UNITS, written).items())
    chosen = [units[i] for i in slope.explained([(1, factor) for _, factor in units])]
    evidence = (
        f"over {len(way)} pieces of {WINDOW:g} s the velocities add up to {_ratio(1.0 / slope.slope[0])} times the "
        "change of position"
    )
    if not chosen:
        return [], log
    remedies: tuple[Mapping[str, Any], ...] = tuple({"gnss.speed_unit": unit} for unit, _ in chosen)
    seems = " or ".join(f"speeds seem to be in {unit}" for unit, _ in chosen)
    if log.sentences:
        remedies, units_said = (), " or ".join(unit for unit, _ in chosen)
        seems = f"the sentences seem to give speeds as if {units_said} were due, not {written}"
    unit, factor = chosen[0]
    fixes = replace(log.fixes, velocity=factor * log.fixes.velocity)
    cured = replace(log, fixes=fixes, gnss=replace(log.gnss, speed_unit=unit))
    return [Mistake(evidence, seems, remedies, "gnss")], cured


def _ratio(value: float) -> str:
    return f"{value:.3g}"


def _simplest(options: list[tuple[int, float]], as_written: float) -> list[int]:
    """Options (changes, residual) that explain the displacements: those with the fewest changes and nearly the best
    fit."""
    fits = [i for i, (_, m) in enumerate(options) if m <= ACCEPTED or (m <= FITS and m <= 0.25 * as_written)]
    if not fits:
        return []
    best = min(options[i][1] for i in fits)
    fits = [i for i in fits if options[i][1] <= 1.5 * best + 0.02]
    fewest = min(options[i][0] for i in fits)
    return sorted((i for i in fits if options[i][0] == fewest), key=lambda i: options[i][1])[:3]


@dataclass(frozen=True)
class _Slope:
    """Ratio of position changes to integrated velocities.

    Either side may have all the noise, so the ratio is between a regression and the inverse of the reverse regression.
    Both slopes are kept, with 1 sigma of each.
    """

    slope: tuple[float, float]
    sigma: tuple[float, float]

    @classmethod
    def of(cls, way: np.ndarray, summed: np.ndarray) -> _Slope | None:
        """Slope of displacements (w, d) over integrated velocities (w, d); None if they scatter too much."""
        slope, sigma = zip(_regressed(way, summed), _regressed(summed, way), strict=True)
        certain = all(abs(value) > CERTAIN**0.5 * error for value, error in zip(slope, sigma, strict=True))
        return cls(slope, sigma) if certain and slope[0] * slope[1] > 0.0 else None

    def misfit(self, slope: float) -> float:
        """Chi-square of a slope, of one degree of freedom."""
        first, other = self.slope
        if slope / first < 1.0:
            return ((slope - first) / self.sigma[0]) ** 2
        if slope * other > 1.0:
            return ((1.0 / slope - other) / self.sigma[1]) ** 2
        return 0.0

    def explained(self, options: list[tuple[int, float]]) -> list[int]:
        """Which of (changes, slope) explain the data: those of the fewest changes, best first, at most three."""
        fits = [i for i, (_, slope) in enumerate(options) if self.misfit(slope) <= CERTAIN]
        fewest = min((options[i][0] for i in fits), default=0)
        return sorted((i for i in fits if options[i][0] == fewest), key=lambda i: self.misfit(options[i][1]))[:3]


def _regressed(y: np.ndarray, x: np.ndarray) -> tuple[float, float]:
    """Slope of y (w, d) over x (w, d) through zero and its 1 sigma, with an individual scatter of each piece [3]."""
    xx = np.sum(x * x, axis=1)
    pieces = float(xx.sum()) ** 2 / max(float(np.sum(xx**2)), 1e-12)
    if pieces <= 1.5:
        return 0.0, np.inf
    slope = float(np.sum(x * y) / xx.sum())
    scatter = np.sum(x * (y - slope * x), axis=1) ** 2 + (LEAST_SCATTER * slope * xx) ** 2
    return slope, float(np.sqrt(scatter.sum() * pieces / (pieces - 1.0)) / xx.sum())


def _vertical(log: Log, unseen: list[str]) -> tuple[list[Mistake], Log]:
    """Check sign and unit of the vertical velocity, and unit of the height.

    unseen: receives messages about quantities that cannot be checked.
    """
    way, summed = _moved(log.fixes)
    down, added = way[:, 2:], summed[:, 2:]
    if np.isnan(_relative_residual(down, added, SHORTEST_CLIMBS)[0]):
        return [], log
    slope = _Slope.of(down, added)
    if slope is None:
        unseen.append(f"{_OF_HEIGHTS}: heights and vertical velocities scatter by more than the flight climbs")
        return [], log
    speed = log.gnss.vertical_speed_unit or log.gnss.speed_unit
    units: list[tuple[str, str, float, float]] = [("", "", 1.0, 1.0)]
    units += [("height_unit", u, f, 1.0) for u, f in _relative(conventions.HEIGHT_UNITS, log.gnss.height_unit).items()]
    units += [
        ("vertical_speed_unit", u, 1.0, f) for u, f in _relative(conventions.VERTICAL_SPEED_UNITS, speed).items()
    ]
    options = []
    for sign, (key, unit, longer, faster) in itertools.product((1.0, -1.0), units):
        axes = axes_letters(np.diag([1.0, 1.0, sign]) @ axes_matrix(log.gnss.velocity_axes, LEVEL_AXES), LEVEL_AXES)
        gnss, keys, said = log.gnss, {}, []
        if sign < 0.0:
            keys["gnss.velocity_axes"] = axes
            gnss = replace(gnss, velocity_axes=axes)
            said.append("the vertical velocity seems to have the other sign")
        if key:
            keys[f"gnss.{key}"] = unit
            height = key == "height_unit"
            gnss = replace(gnss, height_unit=unit) if height else replace(gnss, vertical_speed_unit=unit)
            said.append(f"{'heights seem' if height else 'vertical velocities seem'} to be in {unit}")
        fixes = replace(
            log.fixes,
            llh=log.fixes.llh * [1.0, 1.0, longer],
            velocity=log.fixes.velocity * [1.0, 1.0, sign * faster],
        )
        cured = replace(log, fixes=fixes, gnss=gnss)
        options.append(((sign < 0.0) + bool(key), sign * faster / longer, cured, keys, " and ".join(said)))
    if slope.misfit(1.0) <= CERTAIN:
        least = slope.misfit(1.0) + LIKELY
        as_well = [said for changes, due, *_, said in options if changes == 1 and slope.misfit(due) <= least]
        if as_well:
            noun = ", ".join(_without_seem(said) for said in as_well)
            unseen.append(f"{_OF_HEIGHTS}: with such a mistake ({noun}) they would fit about as well")
        return [], log
    chosen = slope.explained([(changes, due) for changes, due, *_ in options])
    ratio = _ratio(1.0 / slope.slope[0])
    evidence = f"over {len(down)} pieces of {WINDOW:g} s the vertical velocities add up to {ratio} times the descent"
    if not chosen:
        # heights of a poor receiver, or of a barometer, drift by as much: that is no mistake of the log
        unseen.append(f"{_OF_HEIGHTS}: {evidence}, which no unit explains")
        return [], log
    return [
        Mistake(evidence, " or ".join(options[i][4] for i in chosen), tuple(options[i][3] for i in chosen))
    ], options[chosen[0]][2]


# --- mirrored trajectories


def _without_mirrors(found: list[Mistake], log: Log) -> list[Mistake]:
    """Replace axes that together make a mirrored trajectory consistent by the wrong sign that mirrors it.

    A negated longitude mirrors positions. Left-handed axes of velocities and accelerometers, with gyros of the other
    sense, mirror all else: the two worlds cannot be told apart. navsim takes the one with fewer departures from the
    usual axes. found: mistakes of the sensors; log: as written and corrected before these.
    """
    remedy = dict(found[0].remedies[0]) if found and found[0].remedies else {}
    axes = remedy.pop("imu.axes", None)
    gyro = remedy.pop("imu.gyro_axes", axes or log.imu.gyro_axes)
    accelerometer = remedy.pop("imu.accelerometer_axes", axes or log.imu.accelerometer_axes)
    if log.sentences or not np.isfinite(log.fixes.velocity[:, :2]).any():
        return found
    written = (log.gnss.position_axes, log.gnss.velocity_axes, gyro, accelerometer)
    mirrored = [each for axis in (0, 1) if _departures(*(each := _mirrored(axis, written))) < _departures(*written)]
    if not mirrored:
        return found
    least = min(_departures(*each) for each in mirrored)
    keys = ("gnss.position_axes", "gnss.velocity_axes", "imu.gyro_axes", "imu.accelerometer_axes")
    now = (log.gnss.position_axes, log.gnss.velocity_axes, log.imu.gyro_axes, log.imu.accelerometer_axes)
    chosen = [each for each in mirrored if _departures(*each) == least]
    seems = [
        f"{name} seems to have the other sign"
        for name, axis in (("latitude", 0), ("longitude", 1))
        if any(each[0][axis] != written[0][axis] for each in chosen)
    ]
    remedies = tuple(
        {key: value for key, value, before in zip(keys, each, now, strict=True) if value != before} | remedy
        for each in chosen
    )
    evidence = (
        f"velocity_axes {written[1]} needs gyro_axes {gyro} and accelerometer_axes {accelerometer}: together they "
        "mirror the world"
    )
    return [Mistake(evidence, " or ".join(seems), remedies, "gnss")]


_Axes = tuple[str, str, str, str]
"""Axes of positions, velocities, gyros and accelerometers."""


def _mirrored(axis: int, written: _Axes) -> _Axes:
    """The same recording with north (axis 0) or east (1) reversed: only the fixes' positions differ. The body is
    mirrored left to right, which keeps forward and down; a mirror reverses the sense of rotations."""
    position, velocity, gyro, accelerometer = written
    level, body = np.eye(3), np.diag([1.0, -1.0, 1.0])
    level[axis, axis] = -1.0
    signs = np.array(conventions.POSITION_AXES[position]) * np.diag(level)[:2]
    return (
        next(name for name, each in conventions.POSITION_AXES.items() if np.array_equal(each, signs)),
        axes_letters(level @ axes_matrix(velocity, LEVEL_AXES), LEVEL_AXES),
        axes_letters(-body @ axes_matrix(gyro, BODY_AXES), BODY_AXES),
        axes_letters(body @ axes_matrix(accelerometer, BODY_AXES), BODY_AXES),
    )


def _departures(position: str, velocity: str, gyro: str, accelerometer: str) -> int:
    """Number of declarations that differ from the usual axes; one mounting of both triads counts once."""
    sensors = int(gyro != "FRD") if gyro == accelerometer else (gyro != "FRD") + (accelerometer != "FRD")
    return (position != "NE") + (velocity != "NED") + sensors


# --- specific force against velocities


@dataclass(frozen=True)
class _Carried:
    """Specific force integrated with the attitude from gyros of one sign and unit."""

    time: np.ndarray
    """(n,) grid, s."""
    force: np.ndarray
    """(4, n, 3, 3, 3) integrals of specific force from the first time, for the gyros as measured and with a bias of
    `_NUDGE` about each axis; by row and column of the rotation and by component."""
    turning: np.ndarray
    """(n, 3, 3)."""
    attitude: np.ndarray
    """(n, 3, 3)."""

    def at(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Values (..., n, ...) given on the grid along axis 0, at other times within it."""
        after = np.clip(np.searchsorted(self.time, time), 1, self.time.size - 1)
        share = (time - self.time[after - 1]) / (self.time[after] - self.time[after - 1])
        share = share.reshape(-1, *(1,) * (values.ndim - 1))
        return (1.0 - share) * values[after - 1] + share * values[after]


@dataclass(frozen=True)
class _Gained:
    """Velocity changes of the fixes."""

    edges: np.ndarray
    """(e,) of the pieces, s."""
    gained: np.ndarray
    """(e - 1, 3) integrated specific force, NED, m/s."""
    velocity: np.ndarray
    """(e, 3)."""
    windows: np.ndarray
    """(w, k) pieces without holes."""
    weight: np.ndarray
    """(3,) of north, east, down. A unit that shrinks the fixes also shrinks their noise, which must not count in its
    favour. Noisy axes, such as vertical velocities from heights, must not hide the others."""


@dataclass(frozen=True)
class _Hypothesis:
    """Signs, units and times to test. `gyro` and `accel` convert the columns into axes in which both triads agree."""

    factor: float = 1.0
    """Sign and factor on the rates."""
    turn: int = 0
    """Rotation of both triads."""
    accel_sign: float = 1.0
    """Sign of the accelerometers."""
    offset: float = 0.0
    """Offset of the fixes' times, s."""
    reading: int = 0
    """Another interpretation of the fixes, with its keys."""

    @property
    def gyro(self) -> np.ndarray:
        """Signed permutation of the rates (3, 3)."""
        return np.sign(self.factor) * _PROPER[self.turn]

    @property
    def accel(self) -> np.ndarray:
        """Signed permutation of the specific forces (3, 3)."""
        return self.accel_sign * np.eye(3)


@dataclass(frozen=True)
class _Fit:
    """Fit of a hypothesis to the velocities."""

    hypothesis: _Hypothesis
    square: np.ndarray
    """(w,) mean square of each window, m2/s2, nan without samples."""
    bias: np.ndarray
    """(3,) gyro bias of the columns, rad/s."""
    down: np.ndarray
    """(3,) mean direction of down, see `_pointing`."""
    ahead: np.ndarray
    """(3,) mean direction of the velocity."""


_PROPER = [m for m in (axes_matrix(n, BODY_AXES) for n in conventions.all_axes(BODY_AXES)) if np.linalg.det(m) > 0.0]
_PROPER.sort(key=lambda m: -float(np.trace(m)))
"""The 24 ways to turn a triad by right angles, as it is first."""


def carried(samples: Samples, factor: float, bias: np.ndarray, nudged: bool = True) -> _Carried:
    """The samples integrated over steps of at most `STEP`; bias (3,) rad/s is taken off the rates times the factor.

    nudged: also with the biases that derivatives need.
    """
    from scipy.spatial.transform import Rotation

    time = samples.time
    grid = np.arange(time[0], time[-1], max(STEP, float(np.median(np.diff(time)))))

    def gathered(values: np.ndarray) -> np.ndarray:
        steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None]
        summed = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        return np.diff(np.stack([np.interp(grid, time, summed[:, i]) for i in range(3)], axis=1), axis=0)

    turned, gained, step = factor * gathered(samples.rate), gathered(samples.force), np.diff(grid)[:, None]
    ways = [turned - (bias + shift) * step for shift in (np.zeros(3), *(_NUDGE * np.eye(3)))[: 4 if nudged else 1]]
    half = np.stack([Rotation.from_rotvec(0.5 * way).as_matrix() for way in ways], axis=1)
    now = _products(half @ half)
    middle, attitude = now[:-1] @ half, now[:, 0]
    force = np.zeros((len(ways), grid.size, 3, 3, 3))
    for way in range(len(ways)):
        np.cumsum(middle[:, way, :, :, None] * gained[:, None, None, :], axis=0, out=force[way, 1:])
    turning = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(middle[:, 0] * step[:, :, None], axis=0)])
    return _Carried(grid, force, turning, attitude)


def _products(turns: np.ndarray) -> np.ndarray:
    """The products (n + 1, w, 3, 3) of the first 0, 1, ... n of turns (n, w, 3, 3), in their order: within rows of a
    matrix of turns, all rows at once, then from row to row."""
    count, ways = turns.shape[:2]
    length = max(1, round(count**0.5))
    rows = -(-count // length)
    out = np.tile(np.eye(3), (rows * length + 1, ways, 1, 1))
    within = out[1:].reshape(rows, length, ways, 3, 3)
    within.reshape(-1, ways, 3, 3)[:count] = turns
    for step in range(1, length):
        within[:, step] = within[:, step - 1] @ within[:, step]
    for row in range(1, rows):
        within[row] = within[row - 1, -1] @ within[row]
    return out[: count + 1]


def gained(fixes: Fixes, scale: np.ndarray, piece: float = PIECE, pieces: int = PIECES) -> _Gained:
    """Changes of velocity less gravity, over pieces of about `piece` seconds; velocities are all known, scale (3,):
    their size over that as written. The turning of the axes is left out: over a window it is a thousandth."""
    time = fixes.time
    pick = [0]
    for index in range(1, time.size):
        if time[index] - time[pick[-1]] >= piece - 1e-6:
            pick.append(index)
    edges, velocity = time[pick], fixes.velocity[pick]
    gravity = float(np.linalg.norm(earth.gravity_ecef(earth.ecef_from_llh(fixes.llh[:1]))))
    change = np.diff(velocity, axis=0) - np.diff(edges)[:, None] * [0.0, 0.0, gravity]
    whole = np.diff(edges) < 3.0 * piece
    windows = []
    for run in np.split(np.arange(whole.size), np.flatnonzero(~whole)):
        run = run[whole[run]]
        windows += [run[first : first + pieces] for first in range(0, run.size - pieces + 1, pieces)]
    whole_windows = np.reshape(windows, (-1, pieces)).astype(int)
    rough = np.median(np.abs(np.diff(velocity, 2, axis=0)), axis=0) if len(velocity) > 2 else np.ones(3)
    down = np.clip(rough[:2].mean() / max(rough[2], 1e-9), LEAST_WEIGHT, 1.0)
    return _Gained(edges, change, velocity, whole_windows, np.maximum(1.0, 1.0 / scale) * [1.0, 1.0, down])


def fitted(flight: _Carried, target: _Gained, windows: np.ndarray, hypothesis: _Hypothesis, bias: np.ndarray) -> _Fit:
    """Fit of a hypothesis to the velocities, with one free rotation for each window and common biases.

    windows: (w, k) of pieces within the samples. bias: removed by `carried`.
    """
    turn = _PROPER[hypothesis.turn]
    edges = target.edges + hypothesis.offset
    both = np.unique(np.concatenate([windows, windows + 1]))
    place = np.searchsorted(both, windows)
    force = np.stack([flight.at(values, edges[both]) for values in flight.force])
    sums = np.einsum("xa,vnabc,cb->vnx", turn, force, turn) * hypothesis.accel_sign
    spin = np.einsum("xa,nab,yb->nxy", turn, flight.at(flight.turning, edges[both]), turn)
    after = np.searchsorted(both, windows + 1)
    sensed = sums[:, after] - sums[:, place]
    spun = spin[after] - spin[place]
    due = target.gained[windows]
    rotation = wahba(sensed[0], due)
    seen = np.einsum("wij,wkj->wki", rotation, sensed[0])
    count = windows.shape[0]
    residual = (due - seen).reshape(count, -1)
    free = _crosses(seen).reshape(count, -1, 3)
    shared = np.concatenate(
        [
            np.einsum("wij,vwkj->wkiv", rotation, sensed[1:] - sensed[:1]).reshape(count, -1, 3) / _NUDGE,
            -np.einsum("wij,wkjl->wkil", rotation, spun).reshape(count, -1, 3),
        ],
        axis=2,
    )
    inverse = np.linalg.inv(np.einsum("wni,wnj->wij", free, free) + 1e-9 * np.eye(3))

    def without_rotation(values: np.ndarray) -> np.ndarray:
        return values - np.einsum("wni,wij,wmj,wm...->wn...", free, inverse, free, values, optimize=True)

    residual, shared = without_rotation(residual), without_rotation(shared)
    normal = np.einsum("wni,wnj->ij", shared, shared)
    prior = VELOCITY_SIGMA**2 / np.repeat([GYRO_BIAS**2, ACCEL_BIAS**2], 3)
    taken = np.concatenate([bias, np.zeros(3)])  # the prior is that of the total bias
    right = np.einsum("wni,wn->i", shared, residual) - prior * taken
    more = np.linalg.solve(normal + np.diag(prior), right)
    residual = (residual - np.einsum("wni,i->wn", shared, more)) * np.tile(target.weight, windows.shape[1])
    down, ahead = _pointing(flight, target, windows, hypothesis, rotation, float(np.mean(residual**2)))
    return _Fit(hypothesis, np.mean(residual**2, axis=1) + LEAST_RESIDUAL**2, bias + more[:3], down, ahead)


def _pointing(
    flight: _Carried,
    target: _Gained,
    windows: np.ndarray,
    hypothesis: _Hypothesis,
    rotation: np.ndarray,
    scatter: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean directions of down and of the velocity in the axes of a hypothesis, (3,) each, of length 1 if they never
    differ.

    Velocities count if the window shows the heading and they are faster than `MOVING`.
    """
    turn = _PROPER[hypothesis.turn]
    attitude = np.einsum("xa,nab,yb->nxy", turn, flight.at(flight.attitude, target.edges + hypothesis.offset), turn)
    middle = attitude[windows]
    down = np.einsum("wkji,wlj,l->wki", middle, rotation, [0.0, 0.0, 1.0])
    shown = np.sum(target.gained[windows][:, :, :2] ** 2, axis=(1, 2))
    heading = shown > 4.0 * 3.0 * scatter / HEADING_SIGMA**2
    velocity = target.velocity[windows]
    speed = np.linalg.norm(velocity, axis=2)
    counted = (speed > MOVING) & heading[:, None]
    if counted.sum() < PIECES:
        return down.mean(axis=(0, 1)), np.zeros(3)
    course = velocity / np.maximum(speed, MOVING)[..., None]
    ahead = np.einsum("wkji,wlj,wkl->wki", middle, rotation, course, optimize=True)
    return down.mean(axis=(0, 1)), ahead[counted].mean(axis=0)


def _crosses(vectors: np.ndarray) -> np.ndarray:
    """The matrices (..., 3, 3) that a small rotation moves the vectors (..., 3) by: -[v x]."""
    out = np.zeros((*vectors.shape, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    out[..., 0, 1], out[..., 0, 2] = z, -y
    out[..., 1, 0], out[..., 1, 2] = -z, x
    out[..., 2, 0], out[..., 2, 1] = y, -x
    return out


@dataclass(frozen=True)
class _Interpretation:
    """The fixes under one interpretation, with all velocities, and the keys for it."""

    fixes: Fixes
    log: Log
    remedy: Mapping[str, Any]
    seems: str
    scale: np.ndarray


def _readings(log: Log) -> list[_Interpretation]:
    """Interpretations of the fixes: as written first; others only if no velocity confirms the positions."""
    same = np.ones(3)
    logs: list[tuple[Log, Mapping[str, Any], str, np.ndarray]] = [(log, {}, "", same)]
    known = np.isfinite(log.fixes.velocity)
    if not known[:, :2].all() and not log.sentences:
        logs += _position_readings(log)
    if not known[:, 2].all():
        for unit, factor in _relative(conventions.HEIGHT_UNITS, log.gnss.height_unit).items():
            scale = np.array([1.0, 1.0, factor])
            fixes = replace(log.fixes, llh=log.fixes.llh * scale)
            written = replace(log, fixes=fixes, gnss=replace(log.gnss, height_unit=unit))
            if log.sentences:
                logs.append((written, {}, f"the sentences seem to give heights in {unit}", scale))
            else:
                logs.append((written, {"gnss.height_unit": unit}, f"heights seem to be in {unit}", scale))
    logs = [entry for entry in logs if np.degrees(np.abs(entry[0].fixes.llh[:, 0])).max() <= 90.0]
    counts = _compared(log)
    return [
        _Interpretation(each.fixes.with_velocity()[0].take(counts), each, remedy, seems, scale)
        for each, remedy, seems, scale in logs
    ]


def _usual_offset(log: Log) -> tuple[float, tuple[float, float]]:
    """Usual times of samples minus times of fixes, s, and the bounds within which it is no mistake."""
    if log.latency is not None:
        return -log.latency, (-log.latency - 0.5, -log.latency + 0.5)
    return -0.1, USUAL_OFFSET


def _compared(log: Log) -> np.ndarray:
    """Fixes (m,) that count: from the first motion on, for `MOST_SECONDS`, within the requested part.

    If possible, samples must exist at each tolerated clock offset, so that all hypotheses have the same windows.
    """
    fixes, _ = log.fixes.with_velocity()
    wanted = (fixes.time >= log.first) & (fixes.time <= log.last) & np.isfinite(fixes.velocity).all(axis=1)
    low, high = _usual_offset(log)[1]
    sampled = (fixes.time + low >= log.samples.time[0]) & (fixes.time + high <= log.samples.time[-1] - 2.0 * STEP)
    wanted &= sampled if (wanted & sampled).any() else True
    moving = wanted & (np.linalg.norm(fixes.velocity[:, :2], axis=1) > MOVING)
    if moving.any():
        wanted &= fixes.time >= fixes.time[moving][0] - WINDOW
    return wanted & (fixes.time <= np.min(fixes.time[wanted], initial=np.inf) + MOST_SECONDS)


@dataclass(frozen=True)
class _Explanation:
    """Interpretation of a fit: keys to write, their meaning, number of changes, whether it is a usual mistake, its mean
    square, and the corrected log."""

    remedy: Mapping[str, Any]
    seems: str
    changes: int
    usual: bool
    square: float
    fit: _Fit


class _Judge:
    """Compares hypotheses with the same windows of a log."""

    def __init__(self, log: Log, readings: list[_Interpretation]) -> None:
        self.log = log
        self.targets = [gained(reading.fixes, reading.scale) for reading in readings]
        self.windows = self.targets[0].windows
        edges = self.targets[0].edges
        self.samples = log.samples.between(edges[0] - OFFSETS, edges[-1] + OFFSETS)
        step = np.diff(self.samples.time)
        holes = np.flatnonzero(step > max(0.5, 5.0 * float(np.median(step)))) if step.size else np.empty(0, int)
        self.hole_begin, self.hole_end = self.samples.time[holes], self.samples.time[holes + 1]

    def carried(self, factor: float, bias: np.ndarray, nudged: bool = True) -> _Carried:
        """The samples of this log with a factor on their rates."""
        return carried(self.samples, factor, bias, nudged)

    def rough(self, flight: _Carried, factor: float, offset: float) -> list[tuple[float, _Hypothesis]]:
        """Mean squares of all turns and signs of the accelerometers, without looking for biases."""
        target, windows = self.targets[0], self.windows[self.inside(offset)]
        if windows.shape[0] < 2:
            return []
        turns = np.array(_PROPER)
        sums = np.einsum(
            "txa,nabc,tcb->tnx", turns, flight.at(flight.force[0], target.edges + offset), turns, optimize=True
        )
        sensed = sums[:, windows + 1] - sums[:, windows]
        due = target.gained[windows]
        out = []
        for sign in (1.0, -1.0):
            rotation = wahba(sign * sensed, due)
            residual = due - np.einsum("twij,twkj->twki", rotation, sign * sensed)
            # the median, so that a window in which the receiver fails does not decide
            squares = np.median(np.mean(residual**2, axis=(2, 3)), axis=1) + np.mean(residual**2, axis=(1, 2, 3))
            out += [(float(square), _Hypothesis(factor, turn, sign, offset)) for turn, square in enumerate(squares)]
        return out

    def inside(self, offset: float) -> np.ndarray:
        """Which windows (w,) the samples cover without a hole."""
        edges = self.targets[0].edges + offset
        begin, end = edges[self.windows[:, 0]], edges[self.windows[:, -1] + 1]
        covered = (begin >= self.samples.time[0]) & (end <= self.samples.time[-1] - STEP)
        pierced = (self.hole_begin < end[:, None]) & (self.hole_end > begin[:, None])
        return covered & ~pierced.any(axis=1)

    def clocks(
        self, flight: _Carried, offsets: np.ndarray, tolerated: tuple[float, float]
    ) -> tuple[float, list[float], float] | None:
        """Best tolerated clock offset; best other offset with equally good ones; smallest offset that cannot be
        checked, s.

        All else is as written, without biases. None if no tolerated offset can be checked.
        """
        target = self.targets[0]
        squares = np.full((offsets.size, self.windows.shape[0]), np.nan)
        for row, offset in enumerate(offsets):
            inside = self.inside(offset)
            windows = self.windows[inside]
            if windows.shape[0] >= 2:
                sums = np.einsum("nabb->na", flight.at(flight.force[0], target.edges + offset))
                sensed, due = sums[windows + 1] - sums[windows], target.gained[windows]
                residual = due - np.einsum("wij,wkj->wki", wahba(sensed, due), sensed)
                squares[row, inside] = np.mean((target.weight * residual) ** 2, axis=(1, 2))
        allowed = (offsets >= tolerated[0] - 1e-9) & (offsets <= tolerated[1] + 1e-9)
        allowed &= np.isfinite(squares).any(axis=1)
        if not allowed.any():
            return None
        means = np.array(
            [float(np.mean(row[np.isfinite(row)])) if np.isfinite(row).any() else np.inf for row in squares]
        )
        home = int(np.argmin(np.where(allowed, means, np.inf)))
        common = np.sum(np.isfinite(squares) & np.isfinite(squares[home]), axis=1)
        length = common * self.targets[0].windows.shape[1] * PIECE
        enough = (common >= max(LEAST_WINDOWS, 0.5 * common[home])) & (np.abs(offsets) <= LARGEST_SHARE * length)
        others = np.where(allowed | ~enough, np.inf, _levels(squares, squares[home])[0])
        best: list[float] = []
        for row in np.argsort(others):
            if not np.isfinite(others[row]) or others[row] > WORSE**2 * others.min() or len(best) == 3:
                break
            if all(abs(offsets[row] - each) > APART for each in best):
                best.append(float(offsets[row]))
        not_judged = np.abs(offsets[~(enough | allowed)])
        return float(offsets[home]), best, float(not_judged.min(initial=np.inf))

    def fit(self, flight: _Carried, hypothesis: _Hypothesis, bias: np.ndarray) -> _Fit | None:
        """The fit of a hypothesis; None with fewer than two windows."""
        inside = self.inside(hypothesis.offset)
        if inside.sum() < 2:
            return None
        target = self.targets[hypothesis.reading]
        found = fitted(flight, target, self.windows[inside], hypothesis, bias)
        square = np.full(inside.size, np.nan)
        square[inside] = found.square
        return replace(found, square=square)

    def fits(self, flight: _Carried, hypotheses: list[_Hypothesis], bias: np.ndarray) -> list[_Fit]:
        """Fits of the hypotheses that can be checked."""
        return [fit for fit in (self.fit(flight, h, bias) for h in hypotheses) if fit is not None]


def _levels(squares: np.ndarray, home: np.ndarray) -> tuple[np.ndarray, int]:
    """Mean square (f,) of fits with the mean squares (f, w) over the windows of one of them, home (w,), m2/s2, scaled
    where a fit has fewer windows; and how many windows count. Those in which the receiver fails, so that nothing fits,
    do not."""
    seen = np.isfinite(home)
    least = np.nanmin(np.where(np.isfinite(squares), squares, np.inf), axis=0)
    kept = seen & (least <= 9.0 * np.median(least[seen]))
    squares, own = squares[:, kept], home[kept]
    there = np.isfinite(squares)
    share = np.where(there, squares, 0.0).sum(axis=1) / np.maximum(np.where(there, own, 0.0).sum(axis=1), 1e-12)
    enough = there.sum(axis=1) >= max(2, 0.5 * kept.sum())
    return np.where(enough, share * own.mean(), np.inf), int(kept.sum())


def motion(log: Log, unseen: list[str]) -> tuple[list[Mistake], Log]:
    """Find signs, columns and axes of the triads, unit of the gyros and clock offset.

    Of the hypotheses that fit the velocities as well as the best one, the one with the fewest changes wins. unseen:
    receives messages about quantities that the motion does not show.
    """
    readings = _readings(log)
    if not readings:
        lat = float(np.degrees(np.abs(log.fixes.llh[:, 0])).max())
        evidence = f"latitudes reach {lat:.6g} degrees"
        return [Mistake(evidence, "no known unit of the angles explains it", (), "gnss")], log
    too_short = f"{_OF_SENSORS}: fewer than two windows of {PIECE * PIECES:g} s have samples and fixes without holes"
    if readings[0].fixes.time.size < PIECES:
        unseen.append(too_short)
        return [], log
    judge = _Judge(log, readings)
    none = np.zeros(3)
    if not judge.windows.size or judge.samples.time.size < 10:
        unseen.append(too_short)
        return [], log
    # the clocks first, with all else as written: a latency that the tuning will find is no mistake
    usual, tolerated = _usual_offset(log)
    near = np.arange(tolerated[0], tolerated[1] + 1e-9, 0.1)
    offsets = np.unique(np.round(np.concatenate([[usual], near, np.arange(-OFFSETS, OFFSETS + 0.1, 0.5)]), 3))
    plain = judge.carried(1.0, none)
    best_clocks = judge.clocks(plain, offsets, tolerated)
    if best_clocks is None:
        unseen.append(too_short)
        return [], log
    at, others, beyond = best_clocks
    if np.isfinite(beyond):
        unseen.append(f"offsets of the clocks of {beyond:.3g} s and more: too little of the flight overlaps then")
    clocks = [_Hypothesis(offset=at)]
    for apart in others:
        finer = apart + 0.1 * np.arange(-4, 5)
        finer = finer[(finer < tolerated[0]) | (finer > tolerated[1])]
        around = judge.fits(plain, [_Hypothesis(offset=float(offset)) for offset in finer], none)
        # `apart` itself is among them and can be checked, so there is a best one
        best_apart = min(around, key=lambda fit: float(np.mean(fit.square[np.isfinite(fit.square)])))
        clocks.append(best_apart.hypothesis)
    fits = judge.fits(plain, clocks, none)
    home = fits[0]
    starts = [at] if abs(at - usual) < 0.25 else [at, usual]
    others_read = itertools.product(starts, range(1, len(readings)))
    fits += judge.fits(plain, [_Hypothesis(offset=start, reading=reading) for start, reading in others_read], none)
    factors = [1.0, *_relative(conventions.GYRO_UNITS, log.imu.gyro_unit).values()]
    rough = []
    for factor, offset in itertools.product((sign * value for value in factors for sign in (1.0, -1.0)), starts):
        rough += judge.rough(judge.carried(factor, none, nudged=False), factor, offset)
    rough.sort(key=lambda entry: (not _always(entry[1], at), entry[0]))
    tried = [hypothesis for _, hypothesis in rough[: SHORT_LIST + sum(_always(h, at) for _, h in rough)]]
    for factor in dict.fromkeys(hypothesis.factor for hypothesis in tried):
        chosen = [hypothesis for hypothesis in tried if hypothesis.factor == factor]
        fits += judge.fits(judge.carried(factor, none), chosen, none)
    # once more about the biases found, for those in question: over a window they turn by more than is linear
    levels, _ = _levels(np.array([fit.square for fit in fits]), home.square)
    order = np.argsort(levels)
    short = [home]
    for kind in (True, False):  # where nothing turns all fit alike, and the usual ones must be among them
        of_kind = [i for i in order if i and _always(fits[i].hypothesis, at) == kind]
        short += [fits[i] for i in of_kind[: 24 if kind else 12] if levels[i] <= 4.0 * levels[order[0]]]
    fits = [
        again
        for fit in short
        for again in judge.fits(judge.carried(fit.hypothesis.factor, fit.bias), [fit.hypothesis], fit.bias)
    ]
    home = fits[0]
    levels, count = _levels(np.array([fit.square for fit in fits]), home.square)
    best = float(levels.min())
    certain = 3 * PIECES * count * (levels / best - 1.0) / 4.0 > CERTAIN
    in_question = [i for i in range(len(fits)) if levels[i] <= WORSE**2 * best or not certain[i]]
    due = judge.targets[0].gained[judge.windows]
    signal = float(np.mean(np.var(due, axis=1)))
    if 0 not in in_question and best > max(0.25 * signal, 2.0 * VELOCITY_SIGMA**2):
        unseen.append(f"{_OF_SENSORS}: {NOTHING_EXPLAINS}")
        return [], log
    options = [e for i in in_question for e in _explained(log, readings, fits[i], float(levels[i]), tolerated)]
    if not options:
        return [], log
    options.sort(key=lambda e: (e.changes, not e.usual, e.square))
    first = options[0]
    if first.changes == 0:
        seen = (e for e in options if e.changes == 1 and e.usual and not _OF_TIMES & set(e.remedy))
        hidden = {"another horizontal axis forward" if _turns_forward(e) else _without_seem(e.seems) for e in seen}
        if hidden:
            unseen.append(f"{', '.join(sorted(hidden))}: with such a mistake the flight would fit as well")
        return [], log
    alternatives = [
        e for e in options if (e.changes, e.usual) == (first.changes, first.usual) and e.square <= 1.3 * first.square
    ]
    # forward is kept if the motion does not show it: of several mountings of the triads the one with the fewest changes
    alternatives.sort(key=lambda e: (_changed_letters(e), e.square))
    alike: dict[str, _Explanation] = {}
    for e in alternatives:
        alike.setdefault("imu.axes" if "imu.axes" in e.remedy else f"{e.remedy} {e.seems}", e)
    unique = sorted(alike.values(), key=lambda e: e.square)[:3]
    evidence = _evidence(home, float(levels[0]), unique[0])
    remedies = tuple(e.remedy for e in unique if not (log.sentences and e.fit.hypothesis.reading))
    mistake = Mistake(evidence, " or ".join(e.seems for e in unique), remedies, "gnss")
    return [mistake], log


_OF_TIMES = {"gnss.time_offset_s", "gnss.latency_s"}


def _without_seem(words: str) -> str:
    """The statement of a mistake as a noun phrase."""
    has = ((" seem to have ", " with "), (" seems to have ", " with "))
    for seem, is_so in (*has, (" seem to be ", " "), (" seem to ", " "), (" seems ", " ")):
        words = words.replace(seem, is_so)
    return words


def _turns_forward(explanation: _Explanation) -> bool:
    """Whether all it does is to turn both triads about the vertical."""
    return list(explanation.remedy) == ["imu.axes"] and explanation.remedy["imu.axes"][2] == "D"


def _always(hypothesis: _Hypothesis, offset: float) -> bool:
    """Whether a hypothesis is a usual mistake of one triad, or a unit of the gyros, at the offset as written."""
    if hypothesis.offset != offset or hypothesis.reading:
        return False
    apart = hypothesis.accel @ hypothesis.gyro
    if abs(hypothesis.factor) != 1.0:
        return hypothesis.factor > 0.0 and hypothesis.accel_sign > 0.0 and not hypothesis.turn
    return np.array_equal(apart, np.eye(3)) or _change_in_words("", apart)[1]


def _changed_letters(explanation: _Explanation) -> tuple[bool, int]:
    """Whether forward changes, and how many letters of the axes differ from those due."""
    letters = explanation.remedy.get("imu.axes", "FRD")
    return letters[0] != "F", sum(a != b for a, b in zip(letters, "FRD", strict=True))


def _evidence(home: _Fit, as_written: float, best: _Explanation) -> str:
    said = []
    if best.square < 0.8 * as_written:
        said.append(
            "carried along by the gyros, the specific force misses the changes of velocity by "
            f"{np.sqrt(as_written):.2g} m/s in each second as written, by {np.sqrt(best.square):.2g} m/s corrected"
        )
    for name, mean, due in (("down", home.down, 2), ("the velocity", home.ahead, 0)):
        if as_written <= WORSE**2 * best.square and np.abs(mean).max() >= ALONG and mean[due] < ALONG:
            shown = ", ".join(f"{value:+.2f}" for value in mean)
            said.append(f"{name} points along ({shown}) in the axes forward, right, down")
    return " and ".join(said)


def _explained(
    log: Log, readings: list[_Interpretation], fit: _Fit, square: float, tolerated: tuple[float, float]
) -> list[_Explanation]:
    """Interpretations of a fit, for each correction of its times and each orientation allowed by gravity and
    velocity."""
    hypothesis = fit.hypothesis
    reading = readings[hypothesis.reading]
    remedy, seems, changes = dict(reading.remedy), [reading.seems] if reading.seems else [], int(bool(reading.seems))
    cures: list[tuple[dict[str, Any], list[str]]] = [({}, [])]
    if not tolerated[0] - 1e-9 <= hypothesis.offset <= tolerated[1] + 1e-9:
        cures = [({key: value}, [said]) for key, value, said in _of_times(log, hypothesis.offset)]
        changes += 1
    if abs(hypothesis.factor) != 1.0:
        units = _relative(conventions.GYRO_UNITS, log.imu.gyro_unit)
        unit = next(name for name, factor in units.items() if factor == abs(hypothesis.factor))
        remedy["imu.gyro_unit"] = unit
        seems.append(f"the gyros seem to be in {unit}")
        changes += 1
    out = []
    for (shift, shifted), turn in itertools.product(cures, _pointed(fit)):
        gyro, accel = turn @ hypothesis.gyro, turn @ hypothesis.accel
        axes, said, more, usual = _axes_said(log, gyro, accel)
        words = " and ".join([*shifted, *seems, *said])
        out.append(_Explanation({**remedy, **shift, **axes}, words, changes + more, usual, square, fit))
    return out


def _of_times(log: Log, offset: float) -> list[tuple[str, float, str]]:
    """Corrections of an offset of the sample times minus the fix times, s: key, value, and statement.

    If a latency is given, it or the clocks may be wrong: the motion shows only their sum. The more usual one comes
    first.
    """
    apart = offset + (log.latency or 0.0)
    whole = round(apart)
    shift = float(whole) if abs(apart - whole) < 0.35 else round(apart, 1)
    leap = ": GPS time is 18 s from UTC" if abs(shift) == 18.0 else ""
    said = f"the times of the fixes seem to be {-shift:+g} s off those of the samples{leap}"
    clocks = ("gnss.time_offset_s", log.gnss.time_offset + shift, said)
    low, high = USUAL_OFFSET
    if log.latency is None or not low <= offset <= high:
        return [clocks]
    found = round(-offset, 1) + 0.0
    said = f"the fixes seem to have a latency of {found:g} s, not of {log.latency:g} s"
    latency = ("gnss.latency_s", found, said)
    return [latency, clocks] if abs(found) <= USUAL_LATENCY else [clocks, latency]


def _pointed(fit: _Fit) -> list[np.ndarray]:
    """The turns (3, 3) by right angles after which down and the velocity point as they should."""
    out = _PROPER
    for row, mean in ((2, fit.down), (0, fit.ahead)):
        axis = int(np.argmax(np.abs(mean)))
        if abs(mean[axis]) >= ALONG:
            out = [turn for turn in out if turn[row, axis] * mean[axis] > 0.0]
        elif row == 2:
            return [np.eye(3)]
    return out


def _axes_said(
    log: Log, gyro: np.ndarray, accel: np.ndarray
) -> tuple[dict[str, str], list[str], int, bool]:  # fmt: skip
    """Keys, words, number of changes, and whether it is a usual mistake, for corrections (3, 3) of the two triads."""
    same = np.eye(3)
    written = {
        "gyro": gyro @ axes_matrix(log.imu.gyro_axes, BODY_AXES),
        "accelerometer": accel @ axes_matrix(log.imu.accelerometer_axes, BODY_AXES),
    }
    letters = {name: axes_letters(matrix, BODY_AXES) for name, matrix in written.items()}
    if np.array_equal(gyro, accel):
        if np.array_equal(gyro, same):
            return {}, [], 0, True
        both = letters["gyro"]
        keys = {"imu.axes": both}
        if both != letters["accelerometer"]:
            keys = {f"imu.{name}_axes": value for name, value in letters.items()}
        mounted = float(np.linalg.det(gyro)) > 0.0  # no mounting mirrors a triad
        return keys, [f"the axes of gyros and accelerometers seem to point {_in_words(both)}"], 1, mounted
    keys, said, usual = {}, [], True
    for name, change in (("gyro", gyro), ("accelerometer", accel)):
        if np.array_equal(change, same):
            continue
        keys[f"imu.{name}_axes"] = letters[name]
        words, common = _change_in_words(name, change)
        said.append(words)
        usual &= common
    return keys, said, len(keys), usual


def _in_words(letters: str) -> str:
    names = {"F": "forward", "B": "back", "R": "right", "L": "left", "D": "down", "U": "up"}
    return "-".join(names[letter] for letter in letters)


def _change_in_words(name: str, change: np.ndarray) -> tuple[str, bool]:
    """Meaning of a correction (3, 3) of one triad, and whether it is a usual mistake."""
    axes = np.array(["x", "y", "z"])
    if np.array_equal(change, -np.eye(3)):
        gravity = " (a log of gravity instead of specific force)" if name == "accelerometer" else ""
        return f"the {name}s seem to have the other sign{gravity}", True
    diagonal = np.diag(change)
    if np.abs(diagonal).sum() == 3.0:
        reversed_ = axes[diagonal < 0.0]
        seem = "axis seems" if reversed_.size == 1 else "axes seem"
        return f"the {name}'s {' and '.join(reversed_)} {seem} reversed", reversed_.size == 1
    if (change >= 0.0).all() and diagonal.sum() == 1.0:
        first, second = axes[diagonal == 0.0]
        return f"the columns {first} and {second} of the {name}s seem to be exchanged", True
    return f"the {name}s seem to point otherwise than written", False
