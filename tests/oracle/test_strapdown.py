"""The mechanisation against closed forms (coning, increments) and against an independent integrator."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from navsim.filter import states, strapdown
from navsim.geodesy import attitude_kernels as attitude
from navsim.geodesy import earth
from navsim.trajectory.kinematics import Trajectory
from tests.conftest import Within
from tests.helpers import case, cross, scenario


def mechanised(trajectory: Trajectory, rate: float, duration: float = 120.0) -> tuple[np.ndarray, np.ndarray]:
    """Position (m, NED) and attitude (rad) error at the end of an error-free run."""
    t = np.arange(round(duration * rate) + 1) / rate
    dtheta, dv = trajectory.increments(t)
    truth = trajectory.motion(t[[0, -1]])
    nav = np.zeros(states.NAV_N)
    nav[:3], nav[3:6], nav[6:10] = truth.llh[0], truth.velocity_ned[0], truth.quaternion[0]
    out = np.empty((2, states.NAV_N))
    strapdown.navigate(nav, states.declared(states.biases()), dtheta, dv, 1 / rate, t.size - 1, out)
    error = earth.ned_matrix(truth.llh[1]) @ (truth.position_ecef[1] - earth.ecef_from_llh(out[1, :3]))
    turn = np.empty(3)
    attitude.difference(truth.quaternion[1], out[1, 6:10], turn)
    return error, turn


@pytest.mark.parametrize(
    "settings",
    [(), ("runway.heading_deg=137",), ("wind.speed_m_s=6", "wind.from_deg=60", "runway.heading_deg=330")],
    ids=["north", "south-east", "wind"],
)
def test_smooth_approach_comes_back(settings: tuple[str, ...]) -> None:
    """After 120 s at 100 Hz: within 1 cm and 1e-5 rad of the truth, better as the square of the step."""
    trajectory = scenario(*settings, name="landing_smooth").trajectory()
    errors = {}
    for rate in (25.0, 50.0, 100.0):
        position, turn = mechanised(trajectory, rate)
        errors[rate] = np.linalg.norm(position)
        if rate == 100.0:
            assert errors[rate] < 0.01
            assert np.linalg.norm(turn) < 1e-5
    for coarse, fine in ((25.0, 50.0), (50.0, 100.0)):
        order = np.log2(errors[coarse] / errors[fine])
        assert order >= 1.95, f"errors {errors} fall with order {order:.2f}"


def test_paper_profile_comes_back() -> None:
    position, turn = mechanised(scenario().trajectory(), 100.0)
    assert np.linalg.norm(position) < 0.01
    assert np.linalg.norm(turn) < 1e-5


@pytest.mark.validates("Error-free accelerometer and gyro data reproduce the path", "scipy DOP853 in ECEF",
                       position="1e-4 m", attitude="1e-8 rad")  # fmt: skip
@pytest.mark.parametrize("name", ["landing", "landing_smooth"])
def test_truth_against_an_independent_integrator(name: str, within: Within) -> None:
    """The path's own rates, integrated in ECEF by scipy's DOP853, give back the path."""
    trajectory = scenario("wind.speed_m_s=5", "wind.from_deg=40", "runway.heading_deg=75", name=name).trajectory()
    omega = np.array([0.0, 0.0, earth.RATE])
    ends = np.array([0.0, *trajectory.path.knots, *trajectory.wind.knots, 120.0])
    ends = np.unique(ends[(ends >= 0) & (ends <= 120)])
    start = trajectory.motion(ends[:1])
    c_eb = earth.ned_matrix(start.llh[0]).T @ start.c_nb[0]
    y = np.concatenate([start.position_ecef[0], start.velocity_ecef[0], c_eb.ravel()])

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        motion = trajectory.motion(np.array([t]))
        c = y[6:].reshape(3, 3)
        w, f = motion.angular_rate[0], motion.specific_force[0]
        gravity = earth.gravity_ecef(y[:3])
        acceleration = c @ f + gravity - 2 * np.cross(omega, y[3:6])
        return np.concatenate([y[3:6], acceleration, (c @ cross(w) - cross(omega) @ c).ravel()])

    for begin, end in itertools.pairwise(ends):
        # a hair inside the segment, so that the integrator never sees the next one
        solution = solve_ivp(
            rates, (begin + 1e-10, end - 1e-10), y, method="DOP853", rtol=1e-11, atol=1e-9, max_step=2.0
        )
        y = solution.y[:, -1]
    truth = trajectory.motion(np.array([120.0]))
    assert np.linalg.norm(y[:3] - truth.position_ecef[0]) < within["position"]
    turn = Rotation.from_matrix(earth.ned_matrix(truth.llh[0]) @ y[6:].reshape(3, 3) @ truth.c_nb[0].T)
    assert turn.magnitude() < within["attitude"]


@pytest.mark.validates("Velocity increment of a rotating sensor", "pyins' tests", increment="3e-6 m/s")
def test_published_increment(oracles: dict[str, Any], within: Within) -> None:
    """Velocity increment turned by half the rotation; ours goes one order further, 2e-6 here."""
    entry = oracles["strapdown_increment"]
    nav = np.zeros(states.NAV_N)
    nav[6] = 1.0
    mid, dt = np.zeros(strapdown.MID_N), 0.01
    dtheta, dv = (
        np.array(entry["gyro_increment"], dtype=float),
        np.array(entry["accel_increment"], dtype=float),
    )
    strapdown.step(nav, *dtheta, *dv, np.concatenate([dtheta, dv]), dt, np.empty((3, 3)), mid)
    # the Earth turns the frame by 7e-7 rad meanwhile
    np.testing.assert_allclose(mid[9:12], entry["expected_dv_corrected"], rtol=0.0, atol=within["increment"])


@pytest.mark.validates("Attitude drift under coning, without and with the two-sample correction",
                       "closed form (Savage, Titterton)", "(corrected: (ωT)⁴/15 of it left)",
                       drift="5 %")  # fmt: skip
def test_coning(oracles: dict[str, Any], within: Within) -> None:
    """Pure coning: uncorrected increments drift as published, the two-sample algorithm hardly at all."""
    dt = 0.01
    for example in oracles["coning_analytic"]["examples"]:
        angle, frequency = np.radians(example["a_deg"]), 2 * np.pi * example["f_hz"]
        duration = 10.0
        n = round(duration / dt)
        t = np.arange(n + 1) * dt
        # body rates of coning, integrated exactly over each sample
        phase = frequency * t
        dtheta = np.stack(
            [
                np.sin(angle) * np.diff(np.sin(phase)),
                -np.sin(angle) * np.diff(np.cos(phase)),
                np.full(n, -frequency * dt * (1 - np.cos(angle))),
            ],
            axis=1,
        )

        def drift(previous_scale: float, dtheta: np.ndarray = dtheta) -> float:
            q = np.array([1.0, 0.0, 0.0, 0.0])
            previous = dtheta[0]
            for now in dtheta:
                coned = now + previous_scale / 12.0 * np.cross(previous, now)
                attitude.rotate_in_body_axes(q, *coned)
                previous = now
            matrix = np.empty((3, 3))
            attitude.dcm(q, matrix)
            return abs(np.arctan2(matrix[1, 0], matrix[0, 0]))

        published = np.radians(example["drift_deg_per_h"]) * duration / 3600.0
        per_sample = 1 - np.sin(frequency * dt) / (frequency * dt)
        plain, corrected = drift(0.0), drift(1.0)
        # angles summed sample by sample lose that share of the published drift of a rate summed continuously
        assert plain == pytest.approx(published * per_sample, rel=within["drift"])
        assert corrected < 0.25 * plain
        # what is left is of fourth order in the sample interval
        assert corrected < published * (frequency * dt) ** 4 / 15


def test_kernel_uses_the_same_coning_correction() -> None:
    """The correction tested above is the one in `step`: with Earth rate taken out, the same attitude."""
    previous, now = np.array([0.02, -0.01, 0.005]), np.array([-0.01, 0.015, 0.02])
    nav = np.zeros(states.NAV_N)
    nav[6] = 1.0
    work = np.concatenate([previous, np.zeros(3)])
    mid, dt = np.zeros(strapdown.MID_N), 0.01
    strapdown.step(nav, *now, 0.0, 0.0, -9.78 * dt, work, dt, np.empty((3, 3)), mid)
    expected = Rotation.from_rotvec(now + np.cross(previous, now) / 12.0).as_matrix()
    matrix = np.empty((3, 3))
    attitude.dcm(nav[6:10], matrix)
    np.testing.assert_allclose(matrix, expected, atol=1.5e-6)


@pytest.mark.parametrize(("lever_arm", "attitude"), [([0.0, 0.0, 0.0], 1e-6), ([1.5, -0.4, 0.8], 2e-5)])
def test_noise_free_run_has_no_error_but_rounding(lever_arm: list[float], attitude: float) -> None:
    """The whole chain (IMU, measurements, fixes, filter) without any error source stays at the truth.

    The filter believes velocities to 1e-9 m/s. A fix has the north and up of its antenna, which differ from the IMU's
    by lever arm / Earth's radius: 36 m/s * 1.7 m / 6.4e6 m = 1e-5 m/s, which the filter takes for tilt.
    """
    quiet = case(
        "imu.preset=perfect", "imu.gyro.drift_deg_h=0", "imu.gyro.noise_deg_h=0", "imu.accelerometer.bias_mg=0",
        "imu.accelerometer.noise_mg=0", "initial_errors.attitude_deg=0", "initial_errors.position_m=0",
        "initial_errors.velocity_m_s=0", "signals.range_sigma_m=1e-9", "signals.range_rate_sigma_m_s=1e-9",
        "pseudolites.range_sigma_m=1e-9", "pseudolites.range_rate_sigma_m_s=1e-9", "signals.range_law=constant",
        f"receiver.lever_arm_m={lever_arm}", "receiver.latency_s=0.13",
    )  # fmt: skip
    flown = quiet.fly(1, 0)
    # fixes carry the rounding of ranges of 2e7 m (4e-9 m) times the DOP
    fix = earth.ecef_from_llh(flown.fix_llh)
    at_fix = quiet.trajectory.motion(quiet.shared.signals.time)
    arm = np.einsum("nij,j->ni", at_fix.c_nb, lever_arm)
    antenna = at_fix.position_ecef + np.einsum("nji,nj->ni", earth.ned_matrix(at_fix.llh), arm)
    assert np.abs(fix - antenna).max() < 1e-6
    assert np.abs(flown.error[:, :3]).max() < 1e-3
    assert np.abs(flown.error[:, 6:9]).max() < attitude
