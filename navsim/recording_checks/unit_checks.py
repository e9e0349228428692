"""Checks of a recording: times, overlap of the files, units of the sensors by their sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from navsim.formats import conventions
from navsim.formats.recorded_data import Samples
from navsim.formats.recording import increments_as_rates
from navsim.recording_checks.mistakes import Log, Mistake, relative_units
from navsim.statistics.rounding import digits

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


# --- times


def times(log: Log) -> tuple[list[Mistake], Log]:
    """Units of time: intervals no sensor has, and spans of the two files that differ by a power of ten."""
    found: list[Mistake] = []
    interval = float(np.median(np.diff(log.samples.time)))
    span, other = np.ptp(log.samples.time), np.ptp(log.fixes.time)
    if not FASTEST <= interval <= SLOWEST:
        fits = {
            unit: factor
            for unit, factor in relative_units(conventions.TIME_UNITS, log.imu.time_unit).items()
            if 2.0 * FASTEST <= interval * factor <= 0.4 * SLOWEST
        }
        if fits:
            unit = min(fits, key=lambda u: abs(np.log(fits[u] * span / other)))
            found.append(
                Mistake(
                    f"the inertial samples are {interval:g} s apart and span {digits(span, 6)} s, the fixes "
                    f"{digits(other, 6)} s",
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
            for unit, factor in relative_units(conventions.TIME_UNITS, log.gnss.time_unit).items()
            if 5e-3 <= apart * factor <= 60.0 and abs(np.log(factor * other / span)) < abs(np.log(other / span)) - 2.0
        }
        if fits:
            unit = min(fits, key=lambda u: abs(np.log(fits[u] * other / span)))
            found.append(
                Mistake(
                    f"the fixes are {apart:g} s apart and span {digits(other, 6)} s, the inertial samples "
                    f"{digits(span, 6)} s",
                    f"their time seems to be in {unit}",
                    ({"gnss.time_unit": unit},),
                )
            )
            offset = log.gnss.time_offset
            fixes = replace(log.fixes, time=(log.fixes.time - offset) * fits[unit] + offset)
            log = replace(log, fixes=fixes, gnss=replace(log.gnss, time_unit=unit))
    return found, log


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
            "their clocks differ; if both files begin within half a second of each other, this is by how much",
            ({"gnss.time_offset_s": shift},),
        )
    ]


# --- gravity


def scales(log: Log) -> tuple[list[Mistake], Log]:
    """Unit of the accelerometers, and gyros exchanged with accelerometers: mean specific force must be gravity."""
    (force, _), (rate, spread) = (_strength(log.samples, v) for v in (log.samples.force, log.samples.rate))
    if PLAUSIBLE[0] <= force / GRAVITY <= PLAUSIBLE[1]:
        return [], log
    units = relative_units(conventions.ACCELEROMETER_UNITS, log.imu.accelerometer_unit)
    evidence = f"the mean specific force is {digits(force, 4)} where gravity is {GRAVITY} m/s2"
    if NEAR[0] <= rate / GRAVITY <= NEAR[1] and force < 0.3 * GRAVITY and spread < STEADY:
        gyros, accelerometers = conventions.IMU_COLUMNS[1:4], conventions.IMU_COLUMNS[4:]
        before = {name: log.imu.columns.get(name, name) for name in (*gyros, *accelerometers)}
        columns = dict(log.imu.columns)
        for ours, theirs in zip(gyros, accelerometers, strict=True):
            columns |= {ours: before[theirs], theirs: before[ours]}
        found = Mistake(
            f"{evidence}, and the mean of the angular rate {digits(rate)} rad/s",
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
                f"{evidence}, {digits(factor * force / interval)} when divided by the interval of {interval:g} s",
                "the samples seem to be increments of angle and velocity, not rates",
                (remedy,),
            )
            both = increments_as_rates(log.samples.time, np.hstack([log.samples.rate, factor * log.samples.force]))
            samples = Samples(log.samples.time, both[:, :3], both[:, 3:])
            imu = replace(log.imu, increments=True, accelerometer_unit=unit)
            return [found], replace(log, samples=samples, imu=imu)
    elif NEAR[0] <= force * interval / GRAVITY <= NEAR[1]:
        found = Mistake(
            f"{evidence}, {digits(force * interval)} when not divided by the interval of {interval:g} s",
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
