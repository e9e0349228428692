"""Recorded flights made from simulated ones, in the format of `docs/replay-files.md`, for tests of the replay."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np

from navsim.formats.conventions import FIX_ACCURACIES, GNSS_COLUMNS, HEIGHT_UNITS, IMU_COLUMNS, SPEED_UNITS
from navsim.formats.recorded_data import Fixes, Samples
from navsim.geodesy.attitude import dcm_from_rpy
from navsim.geodesy.earth import llh_from_ecef, ned_matrix
from navsim.trajectory.kinematics import tangent_frame
from navsim.trajectory.recorded import RecordedTrajectory, recorded_trajectory
from tests.helpers import case

LEVER = np.array([0.4, -0.2, -0.3])
LATENCY = 0.12
GYRO_BIAS = np.array([2e-3, -1e-3, 3e-3])
ACCEL_BIAS = np.array([0.05, -0.03, 0.04])


def write_flight(
    folder: Path, duration: float = 100.0, seed: int = 5, vertical: bool = True, rough: bool = False, lag: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """imu.csv and gnss.csv of an S-turn, and log.yaml; returns time, llh, velocity, attitude (rpy) of the truth.

    rough: irregular sample times, rows twice, rows out of order, wild fixes. vertical: with vertical velocities.
    lag: how much older velocities are than positions, s.
    """
    rng = np.random.default_rng(seed)
    trajectory = case(f"duration_s={duration}", name="s_turn").trajectory
    time = np.arange(0.02, duration, 0.02)
    if rough:
        time = np.sort(time + rng.uniform(-0.004, 0.004, time.size))
    motion = trajectory.motion(time)
    # this path's rate of roll jumps, so samples are means over their intervals
    dtheta, dv = trajectory.increments(np.concatenate([[0.0], time]))
    step = np.diff(time, prepend=0.0)[:, None]
    rate = dtheta / step + GYRO_BIAS + 1e-3 * rng.standard_normal((time.size, 3))
    force = dv / step + ACCEL_BIAS + 0.02 * rng.standard_normal((time.size, 3))
    rows = [",".join(f"{x:.9f}" for x in (t, *w, *f)) for t, w, f in zip(time, rate, force, strict=True)]
    if rough:
        rows = rows[:100] + rows[100:150] * 2 + rows[150:]
        rows[300], rows[301] = rows[301], rows[300]
    head = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"
    (folder / "imu.csv").write_text("\n".join([head, *rows]) + "\n")

    valid = np.arange(0.5, duration - 0.5, 0.5)
    at = trajectory.motion(valid)
    arm = np.einsum("nij,j->ni", at.c_nb, LEVER)
    swing = np.einsum("nij,nj->ni", at.c_nb, np.cross(at.angular_rate, LEVER))
    ecef = at.position_ecef + np.einsum("nji,nj->ni", ned_matrix(at.llh), arm + 0.3 * rng.standard_normal(arm.shape))
    llh = llh_from_ecef(ecef)
    if lag:
        at = trajectory.motion(valid - lag)
        swing = np.einsum("nij,nj->ni", at.c_nb, np.cross(at.angular_rate, LEVER))
    velocity = at.velocity_ned + swing + 0.1 * rng.standard_normal(arm.shape)
    fixes = []
    for t, p, v in zip(valid + LATENCY, llh, velocity, strict=True):
        down = f"{v[2]:.4f}" if vertical else ""
        place = f"{np.degrees(p[0]):.10f},{np.degrees(p[1]):.10f},{p[2]:.4f}"
        fixes.append(f"{t:.4f},{place},{v[0]:.4f},{v[1]:.4f},{down}")
    if rough:
        fixes = fixes[:50] + fixes[49:50] + fixes[50:]
        fixes[20], fixes[21] = fixes[21], fixes[20]
        fixes = [f"{0.1 * k:.1f},0.0,0.0,0.0,0.0,0.0,0.0" for k in range(3)] + fixes
    (folder / "gnss.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s", *fixes]) + "\n")
    (folder / "log.yaml").write_text(
        "kind: replay\nversion: 1\nimu: {file: imu.csv, sensor_class: consumer, samples: averaged}\n"
        f"gnss: {{file: gnss.csv, lever_arm_m: {LEVER.tolist()}}}\n"
    )
    return time, motion.llh, motion.velocity_ned, motion.rpy


def sentences_of(path: Path, speed_unit: str = "kn", height_unit: str = "m") -> list[str]:
    """The fixes of a table as GGA and RMC sentences; units: those that a receiver in order has, or others."""
    out = []
    for t, lat, lon, h, vn, ve, _ in np.genfromtxt(path, delimiter=",", skip_header=1):
        clock = f"{int(t // 3600):02d}{int(t // 60) % 60:02d}{t % 60:07.4f}"
        where = f"{int(lat):02d}{60 * (lat % 1):010.7f},N,{int(lon):03d}{60 * (lon % 1):010.7f},E"
        speed, course = np.hypot(vn, ve) / SPEED_UNITS[speed_unit], np.degrees(np.arctan2(ve, vn)) % 360
        factor = HEIGHT_UNITS[height_unit]
        for body in (
            f"GPGGA,{clock},{where},1,09,0.9,{(h - 15.0) / factor:.3f},M,{15.0 / factor:.3f},M,,",
            f"GPRMC,{clock},A,{where},{speed:.4f},{course:.3f},,,,A",
        ):
            check = 0
            for c in body:
                check ^= ord(c)
            out.append(f"${body}*{check:02X}")
    return out


def ride(
    duration: float,
    speed: Callable[[np.ndarray], np.ndarray],
    turning: Callable[[np.ndarray], np.ndarray],
    climbing: Callable[[np.ndarray], np.ndarray],
    heading: float = 0.7,
    banked: Callable[[np.ndarray], np.ndarray] = np.ones_like,
) -> RecordedTrajectory:
    """A ride from 45.3 N 93.2 W: speed over ground m/s, rate of the heading rad/s, rate of climb m/s at times s;
    banked: 1 as in a coordinated turn, 0 as a car."""
    time = np.arange(0.0, duration + 0.05, 0.1)
    v, rate, climb = speed(time), turning(time), climbing(time)

    def gathered(x: np.ndarray) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(0.05 * (x[1:] + x[:-1]))])

    yaw = heading + gathered(rate)
    north, east = gathered(v * np.cos(yaw)), gathered(v * np.sin(yaw))
    frame = tangent_frame(np.array([np.radians(45.3), np.radians(-93.2), 250.0]), 0.0)
    place = np.stack([north, east, -gathered(climb)], axis=1)
    llh = llh_from_ecef(frame.origin + place @ frame.axes.T)
    roll = banked(time) * np.arctan(v * rate / 9.8)
    pitch = np.arctan2(climb, np.maximum(v, 5.0)) + 0.03 * banked(time)
    c_nb = dcm_from_rpy(np.stack([roll, pitch, yaw], axis=1))
    return recorded_trajectory(time, llh, c_nb, frame, {})


def smooth_steps(t: np.ndarray, times: list[float], values: list[float], over: float = 4.0) -> np.ndarray:
    """From each value to the next, around the times and within `over` seconds, with continuous acceleration."""
    out = np.full_like(t, values[0])
    for at, before, after in zip(times, values, values[1:], strict=False):
        x = np.clip((t - at) / over + 0.5, 0.0, 1.0)
        out += (after - before) * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)
    return out


def circuit(standstill: float = 20.0) -> RecordedTrajectory:
    """A small aircraft: standstill, taxi around a corner, take-off, climb, circuits with turns to both sides, descent:
    150 s after the standstill."""
    s = standstill + 20.0
    return ride(
        s + 130.0,
        lambda t: smooth_steps(t, [s - 16.0, s + 6.0, s + 60.0], [0.0, 6.0, 25.0, 20.0], 8.0),
        lambda t: smooth_steps(
            t, [s + x for x in (-11, -5, 18, 30, 42, 54, 62, 76, 84, 100, 110, 124)],
            [0.0, 0.3, 0.0, 0.2, 0.0, 0.2, 0.0, -0.25, 0.0, 0.2, 0.0, 0.15, 0.0],
        ),
        lambda t: smooth_steps(t, [s + 12.0, s + 40.0, s + 90.0, s + 120.0], [0.0, 3.0, 0.0, -2.5, 0.0], 6.0),
        banked=lambda t: smooth_steps(t, [s + 10.0], [0.0, 1.0]),
    )  # fmt: skip


def straight(duration: float = 60.0) -> RecordedTrajectory:
    """Nothing but straight and level flight at 25 m/s."""
    return ride(duration, lambda t: np.full_like(t, 25.0), np.zeros_like, np.zeros_like, heading=2.0)


def hills(duration: float = 400.0) -> RecordedTrajectory:
    """Circles at 20 m/s, up and down by 8 m."""
    return ride(
        duration,
        lambda t: np.full_like(t, 20.0),
        lambda t: 0.2 * np.sin(t / 17.0),
        lambda t: 0.6 * np.sin(2.0 * np.pi * t / 42.0),
    )


def drive() -> RecordedTrajectory:
    """A car: it brakes, turns corners to both sides, waits."""
    return ride(
        120.0,
        lambda t: smooth_steps(t, [15.0, 40.0, 60.0, 90.0, 105.0], [0.0, 14.0, 6.0, 15.0, 0.0, 10.0], 8.0),
        lambda t: smooth_steps(t, [28.0, 33.0, 48.0, 54.0, 70.0, 76.0], [0.0, 0.25, 0.0, -0.25, 0.0, 0.2, 0.0]),
        np.zeros_like,
        banked=np.zeros_like,
    )


def quadrotor(duration: float = 150.0) -> RecordedTrajectory:
    """A small quadrotor: stands, climbs, hovers, flies out and back at 1 to 2 m/s with the nose wherever it is, and
    turns on the spot; it tilts to accelerate and against the drag of its rotors."""
    time = np.arange(0.0, duration + 0.05, 0.1)

    def gathered(x: np.ndarray) -> np.ndarray:
        return np.concatenate([[0.0], np.cumsum(0.05 * (x[1:] + x[:-1]))])

    north = smooth_steps(
        time, [20, 30, 60, 70, 100, 112, 120, 132], [0.0, 1.5, 0.0, -1.5, 0.0, 2.0, 0.0, -1.8, 0.0], 3.0
    )
    east = smooth_steps(time, [40, 50, 62, 72, 85, 95, 122, 130], [0.0, 1.2, 0.0, 1.6, 0.0, -1.8, 0.0, 1.2, 0.0], 3.0)
    climb = smooth_steps(time, [6, 12, 75, 80, 104, 110], [0.0, 1.2, 0.0, -1.0, 0.0, 0.9, 0.0], 3.0)
    turning = smooth_steps(
        time, [34, 37, 54, 58, 90, 94, 115, 118], [0.0, 0.5, 0.0, -0.4, 0.0, 0.5, 0.0, 0.4, 0.0], 2.0
    )
    yaw = 0.7 + gathered(turning)
    pushed = [np.gradient(speed, 0.1) + 0.3 * speed for speed in (north, east)]
    ahead, right = pushed[0] * np.cos(yaw) + pushed[1] * np.sin(yaw), pushed[1] * np.cos(yaw) - pushed[0] * np.sin(yaw)
    frame = tangent_frame(np.array([np.radians(45.3), np.radians(-93.2), 250.0]), 0.0)
    place = np.stack([gathered(north), gathered(east), -gathered(climb)], axis=1)
    c_nb = dcm_from_rpy(np.stack([np.arctan2(right, 9.8), -np.arctan2(ahead, 9.8), yaw], axis=1))
    return recorded_trajectory(time, llh_from_ecef(frame.origin + place @ frame.axes.T), c_nb, frame, {})


def record(
    trajectory: RecordedTrajectory,
    seed: int,
    rate: float = 50.0,
    gyro_bias: float = 0.003,
    accel_bias: float = 0.05,
    gyro_noise: float = 2e-3,
    accel_noise: float = 0.05,
    position_noise: float = 0.8,
    velocity_noise: float = 0.1,
    fix_rate: float = 1.0,
    latency: float = 0.1,
    velocities: Literal["ned", "horizontal", "none"] = "ned",
) -> tuple[Samples, Fixes]:
    """What sensors and a receiver log of a ride: biases of these 1 sigma (rad/s, m/s2) drawn for each axis, white noise
    per sample, errors of position that wander over some seconds."""
    rng = np.random.default_rng(seed)
    knots = trajectory.path.knots
    time = np.arange(1.0 / rate, knots[-1] - 0.1, 1.0 / rate)
    motion = trajectory.motion(time)
    shape = (time.size, 3)
    samples = Samples(
        time,
        motion.angular_rate + gyro_bias * rng.standard_normal(3) + gyro_noise * rng.standard_normal(shape),
        motion.specific_force + accel_bias * rng.standard_normal(3) + accel_noise * rng.standard_normal(shape),
    )
    valid = np.arange(0.3, knots[-1] - 1.0, 1.0 / fix_rate)
    at = trajectory.motion(valid)
    wander = np.empty((valid.size, 3))
    wander[0] = rng.standard_normal(3)
    keep = np.exp(-1.0 / (20.0 * fix_rate))
    for row in range(1, valid.size):
        wander[row] = keep * wander[row - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
    moved = position_noise * (wander + 0.1 * rng.standard_normal(wander.shape)) * [1.0, 1.0, 1.5]
    llh = llh_from_ecef(at.position_ecef + np.einsum("nji,nj->ni", ned_matrix(at.llh), moved))
    velocity = at.velocity_ned + velocity_noise * rng.standard_normal(moved.shape)
    if velocities != "ned":
        velocity[:, 2 if velocities == "horizontal" else slice(0, 3)] = np.nan
    return samples, Fixes(valid + latency, llh, velocity)


def parked_before(samples: Samples, fixes: Fixes, length: float, still: float = 4.0) -> tuple[Samples, Fixes]:
    """The same recording after `length` seconds at rest, as its first `still` seconds are, with fixes that the receiver
    smooths to centimetres."""
    rng = np.random.default_rng(3)
    time = np.arange(1, round(length / samples.time[0])) * samples.time[0]
    first = samples.time < still
    rate, force = (
        np.vstack([v[first].mean(axis=0) + v[first].std(axis=0) * rng.standard_normal((time.size, 3)), v])
        for v in (samples.rate, samples.force)
    )
    valid = np.arange(fixes.time[0], length, fixes.time[1] - fixes.time[0])
    llh = fixes.llh[:1] + [1e-9, 1e-9, 0.01] * rng.standard_normal((valid.size, 3))
    velocity = 0.01 * rng.standard_normal((valid.size, 3))
    return (
        Samples(np.concatenate([time, samples.time + length]), rate, force),
        Fixes(np.concatenate([valid, fixes.time + length]), np.vstack([llh, fixes.llh]),
              np.vstack([velocity, fixes.velocity])),
    )  # fmt: skip


def write_recording(folder: Path, samples: Samples, fixes: Fixes) -> Path:
    """The recording as files, and its log.yaml."""
    np.savetxt(folder / "imu.csv", np.column_stack([samples.time, samples.rate, samples.force]), "%.9g", ",",
               header=",".join(IMU_COLUMNS), comments="")  # fmt: skip
    place = np.column_stack([np.degrees(fixes.llh[:, :2]), fixes.llh[:, 2]])
    claims = np.empty((fixes.time.size, 0)) if fixes.accuracy is None else fixes.accuracy
    names = (*GNSS_COLUMNS, *FIX_ACCURACIES[: claims.shape[1]])
    np.savetxt(folder / "gnss.csv", np.column_stack([fixes.time, place, fixes.velocity, claims]), "%.12g", ",",
               header=",".join(names), comments="")  # fmt: skip
    log = folder / "log.yaml"
    log.write_text("kind: replay\nversion: 1\nimu: {file: imu.csv}\ngnss: {file: gnss.csv}\ntuning: none\n")
    return log
