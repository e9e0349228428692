"""Recorded flights made from simulated ones, in the format of `interface.md`, for tests of the replay."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navsim.core.wgs84 import ned_matrix
from tests.helpers import case

LEVER = np.array([0.4, -0.2, -0.3])
LATENCY = 0.12
GYRO_BIAS = np.array([2e-3, -1e-3, 3e-3])
ACCEL_BIAS = np.array([0.05, -0.03, 0.04])


def write_flight(
    folder: Path, duration: float = 100.0, seed: int = 5, vertical: bool = True, rough: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """imu.csv and gnss.csv of an S-turn, and log.yaml; returns time, llh, velocity, attitude (rpy) of the truth.

    rough: irregular sample times, rows twice, rows out of order, wild fixes. vertical: with vertical velocities.
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
    from navsim.core.wgs84 import llh_from_ecef

    llh = llh_from_ecef(ecef)
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
