"""Twelve simulated flights through the replay with all its defaults: three classes of sensors with three receivers, and
three small quadrotors. Each is flown with `DRAWS` drawings of its errors, which last almost as long as it does. Their
truth is known. `scripts/replays.py --bench` writes the table.
"""

from __future__ import annotations

import functools
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import measured
import numpy as np

sys.path.insert(0, str(measured.ROOT))

from navsim.formats.recorded_data import Fixes, Samples
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.replays import study
from navsim.results.findings import of
from navsim.scenario.imu import Accelerometer, Gyro
from navsim.scenario.load import read_replay
from navsim.scenario_files.presets import SENSOR_CLASSES
from navsim.sensors.imu import Triad
from navsim.trajectory.recorded import RecordedTrajectory
from tests.recordings import circuit, quadrotor, write_recording

SETTLED = 20.0
"""Errors count from this time after the alignment on, s."""
RATE = 100.0
"""Samples a second."""
DRAWS = 4
"""Drawings of the errors of a flight."""
UNCLAIMED = (1001, 2)
"""First seed of the flights whose receivers claim no accuracies, which chose nothing, and drawings of each kind."""
WITHIN = 1.5
"""Factor by which a tuned number may differ from the drawn one."""


@dataclass(frozen=True)
class Receiver:
    """1 sigma and correlation time of the errors of positions, their white part, noise of velocities; m, s, m/s."""

    wander: float
    time: float
    white: float
    velocity: float
    rate: float


RECEIVERS = {
    "single point": Receiver(1.2, 120.0, 0.3, 0.10, 1.0),
    "differential": Receiver(0.4, 60.0, 0.15, 0.06, 5.0),
    "RTK": Receiver(0.0, 1.0, 0.02, 0.03, 5.0),
}
NUMBERS = {"gyro": "gyro_noise_density", "accelerometer": "accelerometer_noise_density",
           "velocity": "velocity_sigma_horizontal"}  # fmt: skip
"""Tuned numbers that are compared, and their variables."""
FLIGHTS = [(grade, name) for grade in ("consumer", "industrial", "tactical") for name in RECEIVERS]
FLIGHTS += [("consumer", f"{name}, quadrotor") for name in RECEIVERS]


def markov(rng: np.random.Generator, time: np.ndarray, sigma: float, tau: float) -> np.ndarray:
    """Gauss-Markov errors (m, 3) at times (m,)."""
    out = sigma * rng.standard_normal((time.size, 3))
    keep = np.exp(-np.diff(time) / tau)[:, None]
    for k in range(1, time.size):
        out[k] = keep[k - 1] * out[k - 1] + np.sqrt(1.0 - keep[k - 1] ** 2) * out[k]
    return out


def record(
    trajectory: RecordedTrajectory, grade: str, receiver: Receiver, rng: np.random.Generator, rough: float
) -> tuple[Samples, Fixes, dict[str, float]]:
    """Samples and fixes of a flight, and the drawn numbers. rough: noise of samples in motion over that at rest."""
    sensors = sensors_of(grade)
    end = trajectory.path.knots[-1]
    time = np.arange(1.0 / RATE, end - 0.1, 1.0 / RATE)
    motion = trajectory.motion(time)
    drawn = {name: triad.noise_density * rng.lognormal(0.0, 0.5) for name, triad in sensors.items()}
    drawn |= {"latency": rng.uniform(0.02, 0.4), "velocity": receiver.velocity * rng.lognormal(0.0, 0.3)}  # fmt: skip
    moving = np.flatnonzero(np.linalg.norm(motion.velocity_ned, axis=1) > 0.3)
    moves = np.ones((time.size, 1))
    moves[moving[0] : moving[-1]] = rough  # rotors turn in the hover too
    noisy = []
    for values, (name, triad) in zip((motion.angular_rate, motion.specific_force), sensors.items(), strict=True):
        constant = triad.bias * rng.standard_normal(3)
        drift = markov(rng, time[::100], triad.markov, triad.markov_time)
        drift = np.stack([np.interp(time, time[::100], each) for each in drift.T], axis=1)
        white = drawn[name] * np.sqrt(RATE) * moves * rng.standard_normal(values.shape)
        noisy.append(values + constant + drift + white)
    valid = np.arange(0.3, end - 1.0, 1.0 / receiver.rate)
    at = trajectory.motion(valid)
    off = markov(rng, valid, receiver.wander, receiver.time) + receiver.white * rng.standard_normal((valid.size, 3))
    llh = llh_from_ecef(at.position_ecef + np.einsum("nji,nj->ni", ned_matrix(at.llh), off * [1.0, 1.0, 1.5]))
    velocity = at.velocity_ned + drawn["velocity"] * rng.standard_normal(off.shape)
    stamp = valid + drawn["latency"] + 0.002 * rng.standard_normal(valid.size)
    claim = np.hypot(receiver.wander, receiver.white) * rng.lognormal(0.0, 0.15)
    claims = np.tile([claim, 1.5 * claim, receiver.velocity], (valid.size, 1))
    return Samples(time, *noisy), Fixes(stamp, llh, velocity, accuracy=claims), drawn


def sensors_of(grade: str) -> dict[str, Triad]:
    """Errors of the gyros and accelerometers of a class."""
    of_class = SENSOR_CLASSES[grade]
    return {name: section.model_validate(of_class[name]).triad(RATE)
            for name, section in (("gyro", Gyro), ("accelerometer", Accelerometer))}  # fmt: skip


def fly(grade: str, name: str, seed: int, claims: bool = True) -> dict[str, Any]:
    """NEES of position, velocity and attitude by axis, rejected fixes, tuned numbers over drawn ones, what was said.

    claims: whether the receiver claims accuracies.
    """
    rng = np.random.default_rng(seed)
    kind, _, slow = name.partition(", ")
    trajectory = quadrotor() if slow else circuit()
    rough = 3.0 if slow else 2.0
    samples, fixes, drawn = record(trajectory, grade, RECEIVERS[kind], rng, rough)
    fixes = fixes if claims else replace(fixes, accuracy=None)
    drawn |= {key: rough * drawn[key] for key in ("gyro", "accelerometer")}
    with tempfile.TemporaryDirectory() as folder:
        settings = ["tuning=likelihood", f"imu.sensor_class={grade}", "alignment.heading_sigma_deg=30"]
        recording = study.prepare(*read_replay(write_recording(Path(folder), samples, fixes), settings))
        found = study.compute(recording)
    time = found["/filter/time"]
    true = trajectory.motion(time)
    late = time > recording.alignment.time + SETTLED
    position = np.einsum(
        "nij,nj->ni", ned_matrix(true.llh), true.position_ecef - ecef_from_llh(found["/filter/position_llh"])
    )
    turn = true.c_nb @ np.swapaxes(dcm_from_rpy(found["/filter/attitude_rpy"]), 1, 2)
    attitude = 0.5 * np.stack([turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0],
                               turn[:, 1, 0] - turn[:, 0, 1]], axis=1)  # fmt: skip
    sigma = found["/filter/sigma"]
    velocity = found["/filter/velocity_ned"] - true.velocity_ned
    nees = [float(np.mean((error / sigma[:, 3 * i : 3 * i + 3])[late] ** 2))
            for i, error in enumerate((position, velocity, attitude))]  # fmt: skip
    used = found["/innovations/status"]
    return {
        "nees": nees,
        "rejected": [int(found["/summary/count/rejected"]), int(np.sum(used > 0))],
        "tuned": {key: float(found[f"/tuning/{path}"]) / drawn[key] for key, path in NUMBERS.items()},
        "told": {
            key: "determined" in str(found.variables[f"/tuning/{path}"].attributes["origin"])
            for key, path in NUMBERS.items()
        },
        "latency": float(found["/tuning/latency"]) - drawn["latency"],
        "findings": [f.text for f in of(found)],
    }


def table() -> list[str]:
    """Lines of the page: a row a flight, means and ranges over its drawings."""
    columns = ("sensors, receiver", "position", "velocity", "attitude", "rejected", *NUMBERS, "latency, s")
    lines = [measured.row(*columns), "|---" * len(columns) + "|"]
    every = []
    for first, flight in enumerate(FLIGHTS, 1):
        seeds = range(first, first + DRAWS * len(FLIGHTS), len(FLIGHTS))
        found = [measured.kept(("bench", *flight, seed), functools.partial(fly, *flight, seed)) for seed in seeds]
        nees = np.mean([each["nees"] for each in found], axis=0)
        rejected, used = np.sum([each["rejected"] for each in found], axis=0)
        ratios = np.array([[each["tuned"][key] for key in NUMBERS] for each in found])
        told = np.array([[each["told"][key] for key in NUMBERS] for each in found])
        ranges = [f"{low:.2f} to {high:.2f}" for low, high in zip(ratios.min(axis=0), ratios.max(axis=0), strict=True)]
        late = max((each["latency"] for each in found), key=abs)
        cells = [*(f"{x:.2f}" for x in nees), f"{rejected} of {used}", *ranges, f"{late:+.3f}"]
        lines.append(measured.row(", ".join(flight), *cells))
        every.append((nees, rejected, used, ratios, told))
    nees, rejected, used, ratios, told = (np.array(part) for part in zip(*every, strict=True))
    near = np.abs(np.log(ratios)) < np.log(WITHIN)
    cells = [*(f"{x:.2f}" for x in np.median(nees, axis=0)), f"{rejected.sum()} of {used.sum()}"]
    cells += [
        f"{100.0 * one:.0f} % within {WITHIN:g}, {100.0 * both:.0f} % or told"
        for one, both in zip(near.mean(axis=(0, 1)), (near | told).mean(axis=(0, 1)), strict=True)
    ]
    return [*lines, measured.row("median, total, shares", *cells, "")]


def unclaimed() -> list[str]:
    """Lines of the page on receivers that claim no accuracies: the range over the drawings of a kind."""
    first, draws = UNCLAIMED
    columns = ("sensors, receiver", "position", "velocity", "attitude", "rejected")
    lines = [measured.row(*columns), "|---" * len(columns) + "|"]
    every = []
    for number, flight in enumerate(FLIGHTS):
        seeds = range(first + number, first + number + draws * len(FLIGHTS), len(FLIGHTS))
        found = [measured.kept(("unclaimed", *flight, s), functools.partial(fly, *flight, s, False)) for s in seeds]
        nees = np.array([each["nees"] for each in found])
        rejected = np.sum([each["rejected"] for each in found], axis=0)
        cells = [" / ".join(f"{x:.2f}" for x in each) for each in nees.T]
        lines.append(measured.row(", ".join(flight), *cells, f"{rejected[0]} of {rejected[1]}"))
        every.append((nees, rejected))
    nees = np.concatenate([each for each, _ in every])
    rejected = np.sum([each for _, each in every], axis=0)
    cells = [f"{np.median(each):.2f}; {each.max():.2f}" for each in nees.T]
    return [
        "",
        "## Simulated flights without accuracies",
        "",
        f"The flights of the next section, {draws} of each kind, but the receivers claim no accuracies. The table has "
        "the NEES of each flight.",
        "",
        *lines,
        measured.row("median; largest, total", *cells, f"{rejected[0]} of {rejected[1]}"),
    ]


def section() -> list[str]:
    """Lines of the page `docs/replay-measured.md`."""
    return [
        "",
        "## Simulated flights",
        "",
        f"Each row has {DRAWS} simulated flights:",
        "",
        "| | |",
        "|---|---|",
        "| flight | circuits of 170 s, in the last three rows of 150 s with a small quadrotor |",
        "| drawn in each flight | biases, white noise (two to three times as large in motion), latency, jitter of "
        "stamps (2 ms), velocity noise |",
        "| position errors | correlation times of 60 s (differential, 0.4 m) or 120 s (single point, 1.2 m) |",
        "| accuracies that receivers claim | wrong by 15 % |",
        "| position, velocity, attitude | NEES per axis, from 20 s after the alignment; 1 is right |",
        "| gyro, accelerometer, velocity | least and largest tuned noise, divided by the true noise in motion |",
        "| latency | its largest error |",
        "",
        *table(),
        "",
        "If the noise of the fixes hides that of the sensors, the tuned noise stays at the value of the class. "
        "Then the replay tells its 95 % interval.",
    ]
