"""Noise of inertial sensors from a log at rest: checks that it is one, terms with intervals, a block for `imu:`."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import median_filter

from navsim.formats.recorded_data import Samples
from navsim.formats.recording import read_imu
from navsim.formats.text import FileError
from navsim.geodesy.earth import STANDARD_GRAVITY
from navsim.logs.reading import read_logs
from navsim.replays.reading import ReplayError
from navsim.report.printing import COLUMN, Print, abreast, content, new_figure, printed, style
from navsim.report.table import Table
from navsim.scenario.load import read_replay
from navsim.scenario_files.base import DEG, DEG_H, DEG_SQRT_H, MG
from navsim.sensors.imu import MARKOV_PEAK
from navsim.statistics.allan import (
    FLAT,
    LONGEST_SHARE,
    NoiseFit,
    Term,
    cluster_counts,
    fit,
    overlapping_deviation,
    spectra,
)
from navsim.statistics.rounding import digits

SHORTEST = 60.0
"""A shorter record shows no noise to some per cent, s."""
_GRAVITY_TOLERANCE = 0.1
"""Share by which the mean specific force at rest may differ from gravity."""
_MEAN_S, _DRIFT_MEANS = 1.0, 61
"""Samples are averaged over this time; a slow drift is the median of so many means."""
_MOVED_SIGMAS = 10.0
_LEAST_MOTION = {"gyro": 0.1 * DEG, "accelerometer": 0.05}
"""A mean that differs from the drift by this and by `_MOVED_SIGMAS` shows motion, rad/s, m/s2."""
_SURE_MOTION = {"gyro": 1.0 * DEG, "accelerometer": 0.5}
"""One that differs by this shows motion in any noise."""
_HOLE = 5.0
"""Intervals of a hole; the longest piece without one is used."""
_UNITS = {
    "gyro": {
        "white": ("arw_deg_sqrt_h", DEG_SQRT_H, "°/√h"),
        "flicker": ("bias_instability_deg_h", DEG_H, "°/h"),
        "walk": ("rate_random_walk_deg_h_sqrt_h", DEG_H / 60.0, "°/h/√h"),
    },
    "accelerometer": {
        "white": ("vrw_m_s_sqrt_h", 1.0 / 60.0, "m/s/√h"),
        "flicker": ("bias_instability_mg", MG, "mg"),
        "walk": ("bias_random_walk_mg_sqrt_h", MG / 60.0, "mg/√h"),
    },
}
"""Key of the scenario, its unit in SI, its name, of each term of each sensor."""
_WORDS = {"white": "white noise N", "flicker": "bias instability (lowest deviation), from B", "walk": "random walk K"}


class StaticError(ReplayError):
    """A log that is not one of a sensor at rest, or too short."""


@dataclass(frozen=True)
class SensorNoise:
    """Noise of three gyros or accelerometers: together, and of each axis."""

    name: str
    tau: np.ndarray
    deviation: np.ndarray
    """(k, 3) overlapping Allan deviation, SI."""
    together: NoiseFit
    axes: list[NoiseFit]
    bias: np.ndarray
    """(3,) mean, SI."""

    @property
    def flat_to(self) -> float:
        """Longest cluster time of the record, s."""
        return float(self.tau[-1])

    def holds_flicker(self) -> bool:
        """Whether the record shows flicker noise and is long enough for its level."""
        return self.together.flicker.held and self.together.corner <= self.flat_to


@dataclass(frozen=True)
class ImuNoise:
    """Noise of an inertial sensor at rest."""

    source: str
    seconds: float
    rate_hz: float
    sensors: tuple[SensorNoise, SensorNoise]
    remarks: list[str]


def read_static(path: Path, imu: int = 0) -> tuple[Samples, str]:
    """Samples of a log.yaml, a table, or a log of another program, and their name.

    Raises FileError, InputError, OSError.
    """
    is_log = path.suffix.lower() in (".yaml", ".yml")
    alone = "it has the samples of one IMU, number 0; leave --imu out, or name the log or table of the other IMU"
    if is_log:
        section, document = read_replay(path)
        file = document.resolve(("imu", "file"), section.imu.file)
        samples = read_imu(file, section.skip_bad_records, section.imu.convention())[0]
    else:
        try:
            samples = read_imu(path)[0]
        except (IsADirectoryError, FileError) as error:
            if ".csv" in path.suffixes:
                raise error
            samples = None
    if samples is not None:
        if imu:
            raise FileError(0, alone, path)
        return samples, path.name
    contents = read_logs([path])
    if imu >= len(contents.imus):
        names = ", ".join(f"{i}: {each.name}" for i, each in enumerate(contents.imus)) or "none"
        raise FileError(0, f"the log has no IMU {imu}; it has {names}", path)
    record = contents.imus[imu]
    return Samples(record.time, record.rate, record.force), f"{record.name} of {path.name}"


def measure(samples: Samples, source: str, first: float = -math.inf, last: float = math.inf) -> ImuNoise:
    """Noise of samples between two times. Raises StaticError for a log that moves or is too short."""
    samples = samples.between(first, last)
    samples, remarks = _longest_piece(samples)
    seconds = float(samples.time[-1] - samples.time[0]) if samples.time.size else 0.0
    if seconds < SHORTEST:
        text = f"{seconds:.1f} s of samples; the noise needs {SHORTEST:g} s at rest"
        raise StaticError(f"{text}, the bias instability an hour or more")
    step = seconds / (samples.time.size - 1)
    _check_at_rest(samples, step)
    sensors = (_sensor("gyro", samples.rate, step), _sensor("accelerometer", samples.force, step))
    for sensor in sensors:
        remarks += _remarks(sensor, seconds)
    return ImuNoise(source, seconds, 1.0 / step, sensors, remarks)


def _longest_piece(samples: Samples) -> tuple[Samples, list[str]]:
    if samples.time.size < 3:
        return samples, []
    gaps = np.diff(samples.time)
    ends = np.flatnonzero(gaps > _HOLE * np.median(gaps))
    bounds = np.concatenate([[0], ends + 1, [samples.time.size]])
    longest = int(np.argmax(np.diff(bounds)))
    if not ends.size:
        return samples, []
    piece = slice(bounds[longest], bounds[longest + 1])
    time = samples.time[piece]
    text = f"{ends.size} holes in the samples: the piece from {time[0]:.1f} to {time[-1]:.1f} s is used"
    return Samples(time, samples.rate[piece], samples.force[piece]), [text]


def _check_at_rest(samples: Samples, step: float) -> None:
    """Raise StaticError where the samples show motion, or no gravity."""
    gravity = float(np.linalg.norm(samples.force.mean(axis=0)))
    if abs(gravity / STANDARD_GRAVITY - 1.0) > _GRAVITY_TOLERANCE:
        text = f"the mean specific force is {digits(gravity, 4)} m/s2, not gravity: the sensor is not at rest, or has "
        raise StaticError(f"{text}another unit; declare units in a log.yaml, and name it instead of the table")
    for name, values in (("gyro", samples.rate), ("accelerometer", samples.force)):
        if (dead := np.flatnonzero(np.ptp(values, axis=0) == 0.0)).size:
            text = f"the {name} of the {'xyz'[dead[0]]} axis never changes: its noise is below one digit of the log"
            raise StaticError(f"{text}, or it is dead; log it with more digits")
    size = max(round(_MEAN_S / step), 1)
    count = samples.time.size // size
    for name, values, unit, factor in (
        ("gyro", samples.rate, "deg/s", DEG), ("accelerometer", samples.force, "m/s2", 1.0),
    ):  # fmt: skip
        means = values[: count * size].reshape(count, size, 3).mean(axis=1)
        slow = median_filter(means, (min(_DRIFT_MEANS, count), 1), mode="nearest")
        noise = 1.4826 * np.median(np.abs(means - slow), axis=0)
        off = np.maximum(np.abs(means - slow), np.abs(np.diff(slow, axis=0, prepend=slow[:1])))
        least = np.maximum(_LEAST_MOTION[name], np.minimum(_MOVED_SIGMAS * noise, _SURE_MOTION[name]))
        far = np.abs(slow - np.median(slow, axis=0)) > _SURE_MOTION[name]
        moved = np.flatnonzero(((off > least) | far).any(axis=1))
        if moved.size:
            row = int(moved[np.argmax(off[moved].max(axis=1))])
            at = samples.time[row * size]
            rest = _longest_rest(moved, count)
            ends = samples.time[np.minimum(np.array(rest) * size, samples.time.size - 1)]
            where = f"the longest rest is {ends[0]:.0f} to {ends[1]:.0f} s: choose it with --start and --end"
            if ends[1] - ends[0] < SHORTEST:
                where = f"it never lies still for the {SHORTEST:g} s that the noise needs: make a log at rest"
            change, allowed = off[row].max() / factor, least.max() / factor
            raise StaticError(
                f"the sensor moves: the {name}s change by {digits(change)} {unit} at {at:.1f} s, where their noise "
                f"allows {digits(allowed)}; {where}"
            )


def _longest_rest(moved: np.ndarray, count: int) -> tuple[int, int]:
    bounds = np.concatenate([[-1], moved, [count]])
    longest = int(np.argmax(np.diff(bounds)))
    return int(bounds[longest]) + 1, int(bounds[longest + 1])


def _sensor(name: str, values: np.ndarray, step: float) -> SensorNoise:
    counts = cluster_counts(values.shape[0])
    *axes, together = [fit(spectrum) for spectrum in spectra(values, step)]
    deviation = overlapping_deviation(values - values.mean(axis=0), step, counts)
    return SensorNoise(name, counts * step, deviation, together, axes, values.mean(axis=0))


def _remarks(sensor: SensorNoise, seconds: float) -> list[str]:
    """Why a term is missing, and how long a record has to be for it."""
    found = sensor.together
    _, unit, words = _UNITS[sensor.name]["flicker"]
    limit = f"at most {digits(math.sqrt(FLAT) * found.flicker.high / unit)} {words}"
    if sensor.holds_flicker():
        return []
    due = LONGEST_SHARE * found.corner
    longer = f"; record {digits(due / 3600.0, 2)} h or more" if math.isfinite(due) and due > seconds else ""
    if found.ambiguous:
        return [f"{sensor.name}: {seconds:.0f} s show a slow drift, and cannot tell flicker noise from a random walk: "
                f"no bias instability, {limit}{longer}"]  # fmt: skip
    if found.flicker.held:
        return [f"{sensor.name}: {seconds:.0f} s cannot hold the bias instability, whose level begins after "
                f"{found.corner:.0f} s{longer}"]  # fmt: skip
    return [f"{sensor.name}: no bias instability shows in {seconds:.0f} s: {limit}"]


def _shown(sensor: SensorNoise, term: str) -> Term | None:
    """A term in units of the scenario, None if the record does not show it. The instability is the lowest deviation."""
    found: Term = getattr(sensor.together, term)
    if not found.held or (term == "flicker" and not sensor.holds_flicker()):
        return None
    unit = _UNITS[sensor.name][term][1] / (math.sqrt(FLAT) if term == "flicker" else 1.0)
    return Term(found.value / unit, found.low / unit, found.high / unit, True)


def tables(noise: ImuNoise) -> list[Table | str]:
    """Table of the terms with intervals, and remarks."""
    table = Table(f"Noise of {noise.source}", ("term", "value", "95 %", "unit", "axes x, y, z"))
    for sensor in noise.sensors:
        table.head(f"{sensor.name}s")
        for term, (_, unit, words) in _UNITS[sensor.name].items():
            shown = _shown(sensor, term)
            if shown is None:
                table.add(_WORDS[term], "not shown", "", words)
                continue
            unit = unit / (math.sqrt(FLAT) if term == "flicker" else 1.0)
            axes = ", ".join(digits(getattr(axis, term).value / unit) for axis in sensor.axes)
            table.add(
                _WORDS[term],
                digits(shown.value),
                f"{digits(shown.low)} to {digits(shown.high)}",
                words,
                axes,
            )
    text = f"{noise.seconds:.0f} s at rest, {digits(noise.rate_hz, 4)} Hz"
    return [table, "; ".join([text, *noise.remarks])]


def sheet(noise: ImuNoise) -> str:
    """Block for `imu:` of a scenario or a log."""
    source = json.dumps(noise.source, ensure_ascii=False)
    lines = [
        f"# Noise of {source}, {noise.seconds:.0f} s at rest, by `navsim imu`; intervals of 95 %.",
        "# One log cannot show the spread of turn-on biases: take them from the data sheet.",
        *(f"# {remark}" for remark in noise.remarks),
        "imu:",
    ]
    for sensor, constant in zip(noise.sensors, ("drift_deg_h", "bias_mg"), strict=True):
        lines += [f"  {sensor.name}:", f"    {constant}: 0"]
        for term, (key, _, words) in _UNITS[sensor.name].items():
            shown = _shown(sensor, term)
            if shown is not None:
                lines.append(
                    f"    {key}: {digits(shown.value, 4)}  # {digits(shown.low)} to {digits(shown.high)} {words}"
                )
                if term == "flicker":
                    time = sensor.flat_to / MARKOV_PEAK[0]
                    lines.append(
                        f"    markov_time_s: {digits(time, 4)}  # flat up to {digits(sensor.flat_to, 4)} s at least"
                    )
    return "\n".join(lines) + "\n"


def figure(noise: ImuNoise) -> bytes:
    """PNG of the Allan deviations with the fitted terms."""
    with printed(Print()):
        fig = new_figure(2 * COLUMN, 3.0)
        for ax, sensor in zip(abreast(fig, 2), noise.sensors, strict=True):
            _, unit, words = _UNITS[sensor.name]["flicker"]
            for i, axis in enumerate("xyz"):
                ax.loglog(sensor.tau, sensor.deviation[:, i] / unit, label=axis, **style(i))
            ax.loglog(sensor.tau, np.sqrt(sensor.together.variance(sensor.tau)) / unit, "k:", label="fit")
            ax.set(title=f"{sensor.name}s at rest", xlabel="cluster time, s", ylabel=f"Allan deviation, {words}")
            ax.legend()
        return content(fig, Print(), noise.source)


def curve(noise: ImuNoise) -> tuple[list[str], np.ndarray]:
    """Table of the Allan deviations, in SI units."""
    names = [f"{sensor.name}_{axis}" for sensor in noise.sensors for axis in "xyz"]
    columns = [sensor.deviation for sensor in noise.sensors]
    return ["tau_s", *names], np.column_stack([noise.sensors[0].tau, *columns])
