"""Twelve simulated flights through the replay with all its defaults: three classes of sensors with three receivers, and
three small quadrotors, whose errors are drawn. Their truth is known. `scripts/replays.py --bench` writes
the table.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
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
from navsim.scenario.presets import SENSOR_CLASSES
from navsim.trajectory.recorded import RecordedTrajectory
from tests.recordings import circuit, quadrotor, write_recording

SETTLED = 20.0
"""Errors count from this time after the alignment on, s."""
RATE = 100.0
"""Samples a second."""


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
    recording = study_sensors(grade)
    end = trajectory.path.knots[-1]
    time = np.arange(1.0 / RATE, end - 0.1, 1.0 / RATE)
    motion = trajectory.motion(time)
    drawn = {"gyro": recording[0] * rng.lognormal(0.0, 0.5), "accelerometer": recording[1] * rng.lognormal(0.0, 0.5),
             "latency": rng.uniform(0.02, 0.4), "velocity": receiver.velocity * rng.lognormal(0.0, 0.3)}  # fmt: skip
    moves = np.where(np.linalg.norm(motion.velocity_ned, axis=1) > 0.3, rough, 1.0)[:, None]
    noisy = []
    for values, name, bias in (
        (motion.angular_rate, "gyro", recording[2]), (motion.specific_force, "accelerometer", recording[3]),
    ):  # fmt: skip
        constant = bias * rng.standard_normal(3)
        drift = markov(rng, time[::100], 0.1 * bias, 300.0)
        drift = np.stack([np.interp(time, time[::100], each) for each in drift.T], axis=1)
        white = drawn[name] * np.sqrt(RATE) * moves * rng.standard_normal(values.shape)
        noisy.append(values + constant + drift + white)
    valid = np.arange(0.3, end - 1.0, 1.0 / receiver.rate)
    at = trajectory.motion(valid)
    off = markov(rng, valid, receiver.wander, receiver.time) + receiver.white * rng.standard_normal((valid.size, 3))
    llh = llh_from_ecef(at.position_ecef + np.einsum("nji,nj->ni", ned_matrix(at.llh), off * [1.0, 1.0, 1.5]))
    velocity = at.velocity_ned + drawn["velocity"] * rng.standard_normal(off.shape)
    stamp = valid + drawn["latency"] + 0.002 * rng.standard_normal(valid.size)
    return Samples(time, *noisy), Fixes(stamp, llh, velocity), drawn


def study_sensors(grade: str) -> tuple[float, float, float, float]:
    """White noise densities of gyros and accelerometers of a class, and 1 sigma of their turn-on biases, SI."""
    of_class = SENSOR_CLASSES[grade]
    gyro = Gyro.model_validate(of_class["gyro"]).triad(RATE)
    accelerometer = Accelerometer.model_validate(of_class["accelerometer"]).triad(RATE)
    biases = (float(np.max(gyro.initial_sigma())), float(np.max(accelerometer.initial_sigma())))
    return gyro.noise_density, accelerometer.noise_density, *biases


def fly(grade: str, name: str, seed: int, given: bool) -> dict[str, Any]:
    """NEES of a flight by axis, rejected fixes, tuned numbers over drawn ones, and what navsim said.

    given: the log tells the lasting error of the positions.
    """
    rng = np.random.default_rng(seed)
    kind, _, slow = name.partition(", ")
    trajectory = quadrotor() if slow else circuit()
    rough = 3.0 if slow else 2.0
    samples, fixes, drawn = record(trajectory, grade, RECEIVERS[kind], rng, rough)
    drawn |= {key: rough * drawn[key] for key in ("gyro", "accelerometer")}
    with tempfile.TemporaryDirectory() as folder:
        settings = ["tuning=likelihood", f"imu.sensor_class={grade}", "alignment.heading_sigma_deg=30"]
        receiver = RECEIVERS[kind]
        if given and receiver.wander:
            each = [receiver.wander, 1.5 * receiver.wander]
            settings.append(f"gnss.errors=[{{correlation_time_s: {receiver.time}, position_sigma_m: {each}}}]")
        log = write_recording(Path(folder), samples, fixes)
        recording = study.prepare(*read_replay(log, settings))
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
    nees = [float(np.mean((error / sigma[:, part])[late] ** 2))
            for error, part in ((position, slice(0, 3)), (attitude, slice(6, 9)))]  # fmt: skip
    used = found["/innovations/status"]
    tuned = {"gyro": "gyro_noise_density", "accelerometer": "accelerometer_noise_density",
             "velocity": "velocity_sigma_horizontal"}  # fmt: skip
    return {
        "nees": nees,
        "rejected": [int(found["/summary/count/rejected"]), int(np.sum(used > 0))],
        "tuned": {key: float(found[f"/tuning/{path}"]) / drawn[key] for key, path in tuned.items()},
        "latency": float(found["/tuning/latency"]) - drawn["latency"],
        "findings": [f.text for f in of(found)],
    }


def table() -> list[str]:
    """Lines of the page: a row a flight, flown as it is and with the lasting error of its positions given."""

    def flown(seed: int, given: bool) -> Any:
        flight = FLIGHTS[seed - 1]
        return measured.kept(("bench", *flight, seed, given), lambda: fly(*flight, seed, given))

    seeds = range(1, len(FLIGHTS) + 1)
    found, told = ([flown(seed, given) for seed in seeds] for given in (False, True))
    lines = [
        "| sensors, receiver | position | position, errors given | attitude | rejected | gyro | accelerometer | "
        "velocity | latency, s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (grade, name), each, other in zip(FLIGHTS, found, told, strict=True):
        nees = (each["nees"][0], other["nees"][0], each["nees"][1])
        ratios = (each["tuned"][key] for key in ("gyro", "accelerometer", "velocity"))
        cells = [*(f"{x:.2f}" for x in nees), "{} of {}".format(*each["rejected"]), *(f"{x:.2f}" for x in ratios)]
        lines.append(measured.row(f"{grade}, {name}", *cells, f"{each['latency']:+.3f}"))
    (place, attitude), (other, _) = (np.median([each["nees"] for each in these], axis=0) for these in (found, told))
    rejected, used = np.sum([each["rejected"] for each in found], axis=0)
    medians = [f"{x:.2f}" for x in (place, other, attitude)]
    return [*lines, measured.row("median, or all", *medians, f"{rejected} of {used}", "", "", "", "")]


def section() -> list[str]:
    """Lines of the page `docs/replay-measured.md`."""
    return [
        "",
        "## Twelve simulated flights",
        "",
        "`scripts/replay_bench.py`: circuits of 170 s, the last three a small quadrotor of 150 s. Drawn are biases, "
        "white noise (twice to three times as large in motion), latency, jitter of the stamps (2 ms) and noise of "
        "velocities. Errors of positions last for 60 s (differential, 0.4 m) or 120 s (single point, 1.2 m). The first "
        "three columns are mean squared errors over their variances, per axis, from 20 s after the alignment on, where "
        "1 is due. Then come tuned noise over that in motion, and the error of the latency.",
        "",
        *table(),
        "",
        "Errors of the positions that last for minutes don't show in flights of minutes: without `gnss.errors` the "
        "filter takes them for its own position. RTK positions are better than 2.5 s times the noise of velocities, "
        "the default; the accelerometers' noise takes the difference.",
    ]
