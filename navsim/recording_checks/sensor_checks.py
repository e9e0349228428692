"""Checks of the inertial sensors of a recording: which axes, signs, columns and times fit the motion."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import BODY_AXES, axes_letters, axes_matrix
from navsim.formats.recorded_data import Fixes
from navsim.geodesy.attitude import wahba
from navsim.recording_checks.axes_fit import (
    MOVING,
    PIECE,
    PIECES,
    PROPER_AXES,
    STEP,
    VELOCITY_SIGMA,
    AxesHypothesis,
    HypothesisFit,
    Propagated,
    carried,
    fitted,
    gained,
)
from navsim.recording_checks.fix_readings import is_on_earth, position_readings
from navsim.recording_checks.mistakes import (
    CERTAIN,
    OF_SENSORS,
    WINDOW,
    WORSE,
    Log,
    Mistake,
    relative_units,
    without_seem,
)
from navsim.statistics.rounding import digits

MOST_SECONDS = 600.0
"""Longest part of a flight, from its first motion on, that sensors are compared over."""
OFFSETS = 40.0
"""Largest offset between the clocks that is looked for, s: GPS time is 18 s from UTC, TAI 37 s."""
USUAL_OFFSET = (-2.1, 0.4)
"""Times of samples less those of fixes, s, that the latency of a receiver explains."""
LEAP = "the likeliest, since GPS time is 18 s from UTC"
"""Words on an offset that is more likely than others."""
USUAL_LATENCY = 0.5
"""Latency that a receiver without a radio link has at most, s."""
LEAST_WINDOWS, LARGEST_SHARE = 2, 0.7
"""A clock offset needs so many windows of the recording as written, at least half of them. It is at most this fraction
of their length, since a flight that repeats itself fits a few windows anywhere."""
APART = 2.0
"""Offsets of the clocks farther apart than this, s, are different ones."""
ALONG = 0.75
"""Least mean component of a direction along the axis that it is taken for."""
SHORT_LIST = 40
"""Hypotheses that are fitted with biases, the best without."""
NOTHING_EXPLAINS = "nothing explains the velocities, not as written either"


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
        logs += position_readings(log)
    if not known[:, 2].all():
        logs += _with_heights(log)
    if known[:, 2].any() and not log.sentences:
        logs += _with_heights_and_climbs(log)
    logs = [entry for entry in logs if is_on_earth(entry[0].fixes)]
    counts = _compared(log)
    return [
        _Interpretation(each.fixes.with_velocity()[0].take(counts), each, remedy, seems, scale)
        for each, remedy, seems, scale in logs
    ]


def _with_heights(log: Log) -> list[tuple[Log, Mapping[str, Any], str, np.ndarray]]:
    """Interpretations of the heights in other units, as those of `_readings`."""
    out: list[tuple[Log, Mapping[str, Any], str, np.ndarray]] = []
    for unit, factor in relative_units(conventions.HEIGHT_UNITS, log.gnss.height_unit).items():
        scale = np.array([1.0, 1.0, factor])
        fixes = replace(log.fixes, llh=log.fixes.llh * scale)
        written = replace(log, fixes=fixes, gnss=replace(log.gnss, height_unit=unit))
        if log.sentences:
            out.append((written, {}, f"the sentences seem to give heights in {unit}", scale))
        else:
            out.append((written, {"gnss.height_unit": unit}, f"heights seem to be in {unit}", scale))
    return out


def _with_heights_and_climbs(log: Log) -> list[tuple[Log, Mapping[str, Any], str, np.ndarray]]:
    """The same of heights and vertical velocities that agree, in units of the same length."""
    out: list[tuple[Log, Mapping[str, Any], str, np.ndarray]] = []
    speeds = relative_units(conventions.VERTICAL_SPEED_UNITS, log.gnss.vertical_speed_unit or log.gnss.speed_unit)
    for unit, factor in relative_units(conventions.HEIGHT_UNITS, log.gnss.height_unit).items():
        scale = np.array([1.0, 1.0, factor])
        for speed in [name for name, other in speeds.items() if np.isclose(other, factor)]:
            fixes = replace(log.fixes, llh=log.fixes.llh * scale, velocity=log.fixes.velocity * scale)
            gnss = replace(log.gnss, height_unit=unit, vertical_speed_unit=speed)
            remedy = {"gnss.height_unit": unit, "gnss.vertical_speed_unit": speed}
            seems = f"heights seem to be in {unit}, vertical velocities in {speed}"
            out.append((replace(log, fixes=fixes, gnss=gnss), remedy, seems, scale))
    return out


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
    fit: HypothesisFit


class _AxesTest:
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

    def carried(self, factor: float, bias: np.ndarray, nudged: bool = True) -> Propagated:
        """The samples of this log with a factor on their rates."""
        return carried(self.samples, factor, bias, nudged)

    def rough(self, flight: Propagated, factor: float, offset: float) -> list[tuple[float, AxesHypothesis]]:
        """Mean squares of all turns and signs of the accelerometers, without looking for biases."""
        target, windows = self.targets[0], self.windows[self.inside(offset)]
        if windows.shape[0] < 2:
            return []
        turns = np.array(PROPER_AXES)
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
            out += [(float(square), AxesHypothesis(factor, turn, sign, offset)) for turn, square in enumerate(squares)]
        return out

    def inside(self, offset: float) -> np.ndarray:
        """Which windows (w,) the samples cover without a hole."""
        edges = self.targets[0].edges + offset
        begin, end = edges[self.windows[:, 0]], edges[self.windows[:, -1] + 1]
        covered = (begin >= self.samples.time[0]) & (end <= self.samples.time[-1] - STEP)
        pierced = (self.hole_begin < end[:, None]) & (self.hole_end > begin[:, None])
        return covered & ~pierced.any(axis=1)

    def clocks(
        self, flight: Propagated, offsets: np.ndarray, tolerated: tuple[float, float]
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

    def fit(self, flight: Propagated, hypothesis: AxesHypothesis, bias: np.ndarray) -> HypothesisFit | None:
        """The fit of a hypothesis; None with fewer than two windows."""
        inside = self.inside(hypothesis.offset)
        if inside.sum() < 2:
            return None
        target = self.targets[hypothesis.reading]
        found = fitted(flight, target, self.windows[inside], hypothesis, bias)
        square = np.full(inside.size, np.nan)
        square[inside] = found.square
        return replace(found, square=square)

    def fits(self, flight: Propagated, hypotheses: list[AxesHypothesis], bias: np.ndarray) -> list[HypothesisFit]:
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
        evidence = f"latitudes reach {digits(lat, 6)} degrees"
        return [Mistake(evidence, "no known unit of the angles explains it", (), "gnss")], log
    too_short = f"{OF_SENSORS}: fewer than two windows of {PIECE * PIECES:g} s have samples and fixes without holes"
    if readings[0].fixes.time.size < PIECES:
        unseen.append(too_short)
        return [], log
    judge = _AxesTest(log, readings)
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
        unseen.append(f"clock offsets of {digits(beyond)} s or more: samples and fixes would overlap too little")
    clocks = [AxesHypothesis(offset=at)]
    for apart in others:
        finer = apart + 0.1 * np.arange(-4, 5)
        finer = finer[(finer < tolerated[0]) | (finer > tolerated[1])]
        around = judge.fits(plain, [AxesHypothesis(offset=float(offset)) for offset in finer], none)
        # `apart` itself is among them and can be checked, so there is a best one
        best_apart = min(around, key=lambda fit: float(np.mean(fit.square[np.isfinite(fit.square)])))
        clocks.append(best_apart.hypothesis)
    fits = judge.fits(plain, clocks, none)
    home = fits[0]
    starts = [at] if abs(at - usual) < 0.25 else [at, usual]
    others_read = itertools.product(starts, range(1, len(readings)))
    fits += judge.fits(plain, [AxesHypothesis(offset=start, reading=reading) for start, reading in others_read], none)
    factors = [1.0, *relative_units(conventions.GYRO_UNITS, log.imu.gyro_unit).values()]
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
        unseen.append(f"{OF_SENSORS}: {NOTHING_EXPLAINS}")
        return [], log
    options = [e for i in in_question for e in _explained(log, readings, fits[i], float(levels[i]), tolerated)]
    if not options:
        return [], log
    options.sort(key=lambda e: (e.changes, not e.usual, e.square))
    first = options[0]
    if first.changes == 0:
        known = _OF_TIMES | log.declared | ({"imu.axes"} if len(log.declared) == 2 else set())
        seen = (e for e in options if e.changes == 1 and not known & set(e.remedy))
        hidden = {_as_hidden(e) for e in seen if e.usual or _is_left_handed(e)}
        if hidden:
            unseen.append(f"{', '.join(sorted(hidden))}: with this mistake the data would fit equally well")
        return [], log
    # usual mistakes come first, but not alone where one of equally many changes fits better
    alternatives = [
        e for e in options if e.changes == first.changes
        and (e.square <= _ALIKE * first.square if e.usual == first.usual else _ALIKE * e.square <= first.square)
    ]  # fmt: skip
    # forward is kept if the motion does not show it: of several mountings of the triads the one with the fewest changes
    alternatives.sort(key=lambda e: (_changed_letters(e), e.square))
    alike: dict[str, _Explanation] = {}
    for e in alternatives:
        alike.setdefault("imu.axes" if "imu.axes" in e.remedy else f"{e.remedy} {e.seems}", e)
    unique = sorted(alike.values(), key=lambda e: (not _of_usual_latency(e), LEAP not in e.seems, e.square))[:3]
    if _of_usual_latency(unique[0]):
        unique = [e for e in unique if not _is_alias(e, unique[0])]
    evidence = _evidence(home, float(levels[0]), unique[0])
    remedies = tuple(e.remedy for e in unique if not (log.sentences and e.fit.hypothesis.reading))
    mistake = Mistake(evidence, " or ".join(e.seems for e in unique), remedies, "gnss")
    return [mistake], log


_ALIKE = 1.3
"""Mean squares of explanations within this factor are alike."""
_TIME_SCALES = (18.0, 19.0, 37.0)
"""Differences between UTC, GPS time and TAI, s."""
_SAME_SHIFT = 0.5
"""Offsets closer than this are one, s: the clocks are searched in steps of it."""
_OF_TIMES = {"gnss.time_offset_s", "gnss.latency_s"}


def _of_usual_latency(explanation: _Explanation) -> bool:
    """Whether it replaces a given latency by a usual one, which is likelier than clocks that are off."""
    return abs(explanation.remedy.get("gnss.latency_s", np.inf)) <= USUAL_LATENCY


def _is_alias(explanation: _Explanation, latency: _Explanation) -> bool:
    """Whether it shifts the times by a period of the motion beside a usual latency, and by no difference of time
    scales."""
    shift = explanation.fit.hypothesis.offset - latency.fit.hypothesis.offset
    if "gnss.time_offset_s" not in explanation.remedy:
        return False
    return abs(shift) > _SAME_SHIFT and not any(abs(abs(shift) - scale) <= _SAME_SHIFT for scale in _TIME_SCALES)


def _turns_forward(explanation: _Explanation) -> bool:
    """Whether all it does is to turn both triads about the vertical."""
    return list(explanation.remedy) == ["imu.axes"] and explanation.remedy["imu.axes"][2] == "D"


def _is_left_handed(explanation: _Explanation) -> bool:
    """Whether all it does is to let both triads point along the same left-handed axes."""
    axes = explanation.remedy.get("imu.axes") if len(explanation.remedy) == 1 else None
    return axes is not None and float(np.linalg.det(axes_matrix(axes, BODY_AXES))) < 0.0


def _as_hidden(explanation: _Explanation) -> str:
    """The mistake that the motion does not show, as a noun phrase."""
    if _is_left_handed(explanation):
        return f"left-handed axes {explanation.remedy['imu.axes']} of gyros and accelerometers"
    return "another horizontal axis forward" if _turns_forward(explanation) else without_seem(explanation.seems)


def _always(hypothesis: AxesHypothesis, offset: float) -> bool:
    """Whether a hypothesis is a usual mistake of one triad, or a unit of the gyros, at the offset as written."""
    if hypothesis.offset != offset or hypothesis.reading:
        return False
    apart = hypothesis.accel @ hypothesis.gyro
    if abs(hypothesis.factor) != 1.0:
        return hypothesis.factor > 0.0 and hypothesis.accel_sign > 0.0 and not hypothesis.turn
    return np.array_equal(apart, np.eye(3)) or _describe_change("", apart)[1]


def _changed_letters(explanation: _Explanation) -> tuple[bool, int]:
    """Whether forward changes, and how many letters of the axes differ from those due."""
    letters = explanation.remedy.get("imu.axes", "FRD")
    return letters[0] != "F", sum(a != b for a, b in zip(letters, "FRD", strict=True))


def _evidence(home: HypothesisFit, as_written: float, best: _Explanation) -> str:
    text = []
    if best.square < 0.8 * as_written:
        text.append(
            "the changes of velocity by the sensors differ from those of the fixes by "
            f"{digits(np.sqrt(as_written), 2)} m/s in each second (with the correction, by "
            f"{digits(np.sqrt(best.square), 2)} m/s)"
        )
    for name, mean, due in (("down", home.down, 2), ("the velocity", home.ahead, 0)):
        if as_written <= WORSE**2 * best.square and np.abs(mean).max() >= ALONG and mean[due] < ALONG:
            shown = ", ".join(f"{value:+.2f}" for value in mean)
            text.append(f"{name} points along ({shown}) in the axes forward, right, down")
    return " and ".join(text)


def _explained(
    log: Log, readings: list[_Interpretation], fit: HypothesisFit, square: float, tolerated: tuple[float, float]
) -> list[_Explanation]:
    """Interpretations of a fit, for each correction of its times and each orientation allowed by gravity and
    velocity."""
    hypothesis = fit.hypothesis
    reading = readings[hypothesis.reading]
    remedy, seems, changes = dict(reading.remedy), [reading.seems] if reading.seems else [], int(bool(reading.seems))
    cures: list[tuple[dict[str, Any], list[str]]] = [({}, [])]
    if not tolerated[0] - 1e-9 <= hypothesis.offset <= tolerated[1] + 1e-9:
        cures = [({key: value}, [text]) for key, value, text in _of_times(log, hypothesis.offset)]
        changes += 1
    if abs(hypothesis.factor) != 1.0:
        units = relative_units(conventions.GYRO_UNITS, log.imu.gyro_unit)
        unit = next(name for name, factor in units.items() if factor == abs(hypothesis.factor))
        remedy["imu.gyro_unit"] = unit
        seems.append(f"the gyros seem to be in {unit}")
        changes += 1
    out = []
    for (shift, shifted), turn in itertools.product(cures, _pointed(fit)):
        gyro, accel = turn @ hypothesis.gyro, turn @ hypothesis.accel
        axes, text, more, usual = _describe_axes(log, gyro, accel)
        words = " and ".join([*shifted, *seems, *text])
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
    leap = f" ({LEAP})" if abs(shift) == 18.0 else ""
    text = f"the times of the fixes seem to be {-shift:+g} s off those of the samples{leap}"
    clocks = ("gnss.time_offset_s", log.gnss.time_offset + shift, text)
    low, high = USUAL_OFFSET
    if log.latency is None or not low <= offset <= high:
        return [clocks]
    found = round(-offset, 1) + 0.0
    text = f"the fixes seem to have a latency of {found:g} s, not of {log.latency:g} s (without the key it is tuned)"
    latency = ("gnss.latency_s", found, text)
    return [latency, clocks] if abs(found) <= USUAL_LATENCY else [clocks, latency]


def _pointed(fit: HypothesisFit) -> list[np.ndarray]:
    """The turns (3, 3) by right angles after which down and the velocity point as they should."""
    out = PROPER_AXES
    for row, mean in ((2, fit.down), (0, fit.ahead)):
        axis = int(np.argmax(np.abs(mean)))
        if abs(mean[axis]) >= ALONG:
            out = [turn for turn in out if turn[row, axis] * mean[axis] > 0.0]
        elif row == 2:
            return [np.eye(3)]
    return out


def _describe_axes(
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
        return keys, [f"the axes of gyros and accelerometers seem to point {_spell_axes(both)}"], 1, mounted
    keys, text, usual = {}, [], True
    for name, change in (("gyro", gyro), ("accelerometer", accel)):
        if np.array_equal(change, same):
            continue
        keys[f"imu.{name}_axes"] = letters[name]
        words, common = _describe_change(name, change)
        text.append(words)
        usual &= common
    return keys, text, len(keys), usual


def _spell_axes(letters: str) -> str:
    names = {"F": "forward", "B": "back", "R": "right", "L": "left", "D": "down", "U": "up"}
    return "-".join(names[letter] for letter in letters)


def _describe_change(name: str, change: np.ndarray) -> tuple[str, bool]:
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
