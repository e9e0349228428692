"""Checks of the fixes of a recording: positions against velocities, units, axes and columns.

Source: [1] White (1980), Econometrica 48(4): 817-838 (variance of a regression whose errors differ).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import LEVEL_AXES, axes_letters, axes_matrix
from navsim.formats.recorded_data import Fixes
from navsim.geodesy import earth
from navsim.recording_checks.fix_readings import (
    EAST_NORTH,
    OF_ALL_COLUMNS,
    is_on_earth,
    position_readings,
    with_all_columns_exchanged,
    with_angles,
    with_columns_exchanged,
)
from navsim.recording_checks.mistakes import (
    CERTAIN,
    OF_HEIGHTS,
    SHORTEST_CLIMBS,
    SHORTEST_WAYS,
    WINDOW,
    Log,
    Mistake,
    relative_units,
    without_seem,
)
from navsim.recording_checks.sensor_checks import NOTHING_EXPLAINS, motion
from navsim.recording_checks.unit_checks import overlap
from navsim.statistics.rounding import digits

FITS, MISFITS = 0.35, 0.5
"""Difference of two displacements over their mean, median of all pieces: a fit up to the first, none from the second
on."""
ACCEPTED = 0.15
"""Fit that a correction must reach."""
EXCHANGED = 0.25
"""Fit of exchanged columns over that of columns as written from which on they are exchanged."""
LARGEST_LAG, FEWEST_STEPS, LAG_SHOWS = 4.0, 20, 1.5
"""Largest lag of the velocities that is tried, s; changes of position that it needs; and by how much their mean square
difference from the velocities has to be larger without it."""
LEAST_SCATTER = 0.02
"""Scatter of a way about its velocities' over its length that is always allowed for: accelerations between fixes."""
LEAST_RADIANS = 0.1
"""Largest latitude or longitude, rad, of a place that is not beside 0 N 0 E, where simulated flights are."""
LIKELY = 9.0
"""A factor is as likely as another whose chi-square is less by no more than this: three sigma."""


def interpretations(log: Log, unseen: list[str]) -> tuple[list[Mistake], Log]:
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
    if not log.sentences and np.isnan(_relative_residual(way[:, :2], summed[:, :2], SHORTEST_WAYS)[0]):
        more, log = _in_the_ocean(log)
        found += more
    for what, axes, shortest in (
        ("unit and axes of the horizontal velocity, unit of the angles", slice(0, 2), SHORTEST_WAYS),
        (OF_HEIGHTS, slice(2, 3), SHORTEST_CLIMBS),
    ):
        if not np.isfinite(log.fixes.velocity[:, axes]).all(axis=1).any():
            unseen.append(f"{what}: the fixes have no such velocity")
        elif np.isnan(_relative_residual(way[:, axes], summed[:, axes], shortest)[0]):
            unseen.append(f"{what}: fewer than three intervals of {WINDOW:g} s change by more than {shortest[1]:g} m")
    if not more and not log.sentences:
        for name, line, mirror in (("latitude", "parallel", [-1.0, 1.0]), ("longitude", "meridian", [1.0, -1.0])):
            if _relative_residual(way[:, :2] * mirror, summed[:, :2], SHORTEST_WAYS)[0] <= MISFITS:
                unseen.append(f"sign of the {name}: the way leads along a {line}, and either sign fits the velocities")
        exchanged = with_all_columns_exchanged(log)[0].fixes
        if is_on_earth(exchanged) and velocity_difference(exchanged) <= 1.5 * velocity_difference(log.fixes) + 0.02:
            unseen.append(
                f"order of the columns, {EAST_NORTH}: positions and velocities agree in both, only turns tell"
            )
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
            evidence = f"latitudes reach {digits(lat, 6)} degrees"
            found = Mistake(evidence, f"angles seem to be in {unit}", ({"gnss.angle_unit": unit},))
            return [found], with_angles(log, unit, factor)
    elif lat > 90.0 >= lon:
        evidence = f"latitudes reach {lat:.1f} degrees, longitudes {lon:.1f}"
        log, remedy = with_columns_exchanged(log)
        return [Mistake(evidence, "they seem to be exchanged", (remedy,))], log
    return [], log


def _in_the_ocean(log: Log) -> tuple[list[Mistake], Log]:
    """Positions that move too little to show their unit, but lie where radians do when they are read as degrees: in the
    Gulf of Guinea, which has no land there."""
    lat, lon = np.degrees(np.abs(log.fixes.llh[:, :2])).max(axis=0)
    if log.gnss.angle_unit != "deg" or lat > np.pi / 2.0 or lon > np.pi or max(lat, lon) < LEAST_RADIANS:
        return [], log
    evidence = (
        f"all positions lie in the ocean, within {lat:.2f} degrees of latitude and {lon:.2f} of longitude of 0, 0"
    )
    found = Mistake(evidence, "latitude and longitude seem to be in rad", ({"gnss.angle_unit": "rad"},), "gnss")
    return [found], with_angles(log, "rad", conventions.ANGLE_UNITS["rad"])


def _climbs(log: Log) -> bool:
    """Whether enough pieces climb or descend to check the vertical velocity."""
    way, summed = _moved(log.fixes)
    return bool(np.isfinite(_relative_residual(way[:, 2:], summed[:, 2:], SHORTEST_CLIMBS)[0]))


def _both_turn(level: Mistake, vertical: Mistake) -> bool:
    """Whether both, each with one remedy, are about the axes of the velocity alone."""
    axes = {"gnss.velocity_axes"}
    return all(len(each.remedies) == 1 and set(each.remedies[0]) == axes for each in (level, vertical))


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


def lag_of_velocities(fixes: Fixes) -> float:
    """How much older the velocities are than changes of position show, s; nan if they do not show it.

    Differences of positions are compared with the velocities at other times.
    """
    fixes = fixes.take(np.isfinite(fixes.velocity[:, :2]).all(axis=1))
    step = np.diff(fixes.time)
    if step.size < FEWEST_STEPS:
        return float("nan")
    moved = np.diff(earth.ecef_from_llh(fixes.llh), axis=0)
    speed = np.einsum("mij,mj->mi", earth.ned_matrix(fixes.llh[1:]), moved)[:, :2] / step[:, None]
    middle = fixes.time[1:] - 0.5 * step
    inside = (middle > fixes.time[0] + LARGEST_LAG) & (middle < fixes.time[-1] - LARGEST_LAG)
    inside &= step < 1.5 * np.median(step)
    lags = np.arange(-LARGEST_LAG, LARGEST_LAG + 0.05, 0.1)
    if inside.sum() < FEWEST_STEPS:
        return float("nan")
    apart = [
        np.mean(np.sum((speed - _at(middle + lag, fixes.time, fixes.velocity[:, :2]))[inside] ** 2, axis=1))
        for lag in lags
    ]
    best, none = int(np.argmin(apart)), int(np.argmin(np.abs(lags)))
    return float(lags[best]) if apart[none] > LAG_SHOWS * apart[best] else float("nan")


def _at(time: np.ndarray, at: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(time, at, column) for column in values.T], axis=1)


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
        if not log.sentences and (exchanged := _east_before_north(log, as_written)) is not None:
            return [exchanged[0]], [exchanged[1]]
        found, log = _speed(log, way[:, :2], summed[:, :2])
        return found, [log]
    written = "kn" if log.sentences else log.gnss.speed_unit
    speeds = {written: 1.0, **relative_units(conventions.SPEED_UNITS, written)}
    options: list[tuple[int, float, Log, dict[str, Any], str]] = []
    places: list[tuple[int, Log, Mapping[str, Any], str]] = [(0, log, {}, "")]
    if not log.sentences:
        places += [(1, placed, remedy, seems) for placed, remedy, seems, _ in position_readings(log)]
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
            keys, text = dict(remedy), [seems] if seems else []
            if turned:
                keys["gnss.velocity_axes"] = letters
                text.append(f"the columns vn, ve, vd seem to point {letters}")
            if log.sentences:
                text.append(f"the sentences seem to give speeds as if {unit} were due, not {written}")
            elif unit != written:
                keys["gnss.speed_unit"] = unit
                text.append(f"speeds seem to be in {unit}")
            velocity = factor * placed.fixes.velocity
            velocity[:, :2] = velocity[:, :2] @ matrix[:2, :2].T  # the vertical one may be unknown
            gnss = replace(placed.gnss, velocity_axes=letters, speed_unit=unit)
            cured = replace(placed, fixes=replace(placed.fixes, velocity=velocity), gnss=gnss)
            options.append((changes + turned + (factor != 1.0), residual, cured, keys, " and ".join(text)))
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


def velocity_difference(fixes: Fixes) -> float:
    """Relative difference of displacements and integrated velocities, horizontal, as of `_relative_residual`."""
    way, summed = _moved(fixes)
    return _relative_residual(way[:, :2], summed[:, :2], SHORTEST_WAYS)[0]


def _east_before_north(log: Log, as_written: float) -> tuple[Mistake, Log] | None:
    """The mistake of columns in the order east, north, of positions and velocities alike, and the corrected log.

    Both agree as written, but for the length of a degree of longitude, which tells where it differs enough.
    """
    cured, remedy = with_all_columns_exchanged(log)
    found = velocity_difference(cured.fixes) if is_on_earth(cured.fixes) else np.nan
    if not found <= min(ACCEPTED, EXCHANGED * as_written):
        return None
    evidence = (
        f"the velocities differ from the change of position by {100.0 * as_written:.0f} %, with latitude and "
        f"longitude exchanged by {100.0 * found:.0f} %"
    )
    return Mistake(evidence, OF_ALL_COLUMNS, (remedy,)), cured


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
    if slope is None or slope.chi_square(1.0) <= CERTAIN:
        return [], log
    written = "kn" if log.sentences else log.gnss.speed_unit
    units = list(relative_units(conventions.SPEED_UNITS, written).items())
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
    return digits(value)


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

    def chi_square(self, slope: float) -> float:
        """Chi-square of a slope, of one degree of freedom."""
        first, other = self.slope
        if slope / first < 1.0:
            return ((slope - first) / self.sigma[0]) ** 2
        if slope * other > 1.0:
            return ((1.0 / slope - other) / self.sigma[1]) ** 2
        return 0.0

    def explained(self, options: list[tuple[int, float]]) -> list[int]:
        """Which of (changes, slope) explain the data: those of the fewest changes, best first, at most three."""
        fits = [i for i, (_, slope) in enumerate(options) if self.chi_square(slope) <= CERTAIN]
        fewest = min((options[i][0] for i in fits), default=0)
        return sorted((i for i in fits if options[i][0] == fewest), key=lambda i: self.chi_square(options[i][1]))[:3]


def _regressed(y: np.ndarray, x: np.ndarray) -> tuple[float, float]:
    """Slope of y (w, d) over x (w, d) through zero and its 1 sigma, with an individual scatter of each piece [1]."""
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
        unseen.append(f"{OF_HEIGHTS}: heights and vertical velocities scatter by more than the flight climbs")
        return [], log
    speed = log.gnss.vertical_speed_unit or log.gnss.speed_unit
    units: list[tuple[str, str, float, float]] = [("", "", 1.0, 1.0)]
    heights = relative_units(conventions.HEIGHT_UNITS, log.gnss.height_unit)
    units += [("height_unit", u, f, 1.0) for u, f in heights.items()]
    units += [
        ("vertical_speed_unit", u, 1.0, f) for u, f in relative_units(conventions.VERTICAL_SPEED_UNITS, speed).items()
    ]
    options = []
    for sign, (key, unit, longer, faster) in itertools.product((1.0, -1.0), units):
        axes = axes_letters(np.diag([1.0, 1.0, sign]) @ axes_matrix(log.gnss.velocity_axes, LEVEL_AXES), LEVEL_AXES)
        gnss, keys, text = log.gnss, {}, []
        if sign < 0.0:
            keys["gnss.velocity_axes"] = axes
            gnss = replace(gnss, velocity_axes=axes)
            text.append("the vertical velocity seems to have the other sign")
        if key:
            keys[f"gnss.{key}"] = unit
            height = key == "height_unit"
            gnss = replace(gnss, height_unit=unit) if height else replace(gnss, vertical_speed_unit=unit)
            text.append(f"{'heights seem' if height else 'vertical velocities seem'} to be in {unit}")
        fixes = replace(
            log.fixes,
            llh=log.fixes.llh * [1.0, 1.0, longer],
            velocity=log.fixes.velocity * [1.0, 1.0, sign * faster],
        )
        cured = replace(log, fixes=fixes, gnss=gnss)
        options.append(((sign < 0.0) + bool(key), sign * faster / longer, cured, keys, " and ".join(text)))
    if slope.chi_square(1.0) <= CERTAIN:
        least = slope.chi_square(1.0) + LIKELY
        as_well = [text for changes, due, *_, text in options if changes == 1 and slope.chi_square(due) <= least]
        if as_well:
            noun = ", ".join(without_seem(text) for text in as_well)
            unseen.append(f"{OF_HEIGHTS}: with this mistake ({noun}) the data would fit about as well")
        return [], log
    chosen = slope.explained([(changes, due) for changes, due, *_ in options])
    ratio = _ratio(1.0 / slope.slope[0])
    evidence = f"over {len(down)} pieces of {WINDOW:g} s the vertical velocities add up to {ratio} times the descent"
    if not chosen:
        # heights of a poor receiver, or of a barometer, drift by as much: that is no mistake of the log
        unseen.append(f"{OF_HEIGHTS}: {evidence}, which no unit explains")
        return [], log
    return [
        Mistake(evidence, " or ".join(options[i][4] for i in chosen), tuple(options[i][3] for i in chosen))
    ], options[chosen[0]][2]
