"""The batch smoother against a general least-squares solver that knows nothing of Kalman filters."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from navsim.filter import eskf, records, states
from navsim.filter.estimate import estimate
from navsim.filter.measurement_kinds import FIX, FixTable, Measurements
from navsim.filter.strapdown import navigate
from navsim.simulation.flight import exact_start
from tests.conftest import Within
from tests.helpers import case

SIGMA = np.repeat([10.0, 1.0, np.radians(5.0), np.radians(700.0 / 3600.0), 9.8e-3], 3)
FIX_SIGMA = 4.0
EPOCHS = 20
DECLARED = states.declared(states.biases())


def injected(start: np.ndarray, x: np.ndarray) -> np.ndarray:
    nav = start.copy()
    eskf.inject(nav, x)
    return nav


@pytest.mark.validates("The `map` smoother minimises the nonlinear least-squares cost of the whole flight",
                       "scipy.optimize.least_squares with numerical derivatives through the mechanisation",
                       "of a sigma, each state at the last fix", estimate="5e-3",
                       **{"sigma of biases": "2 %"})  # fmt: skip
def test_map_is_the_least_squares_solution(within: Within) -> None:
    """Perfect sensors but for constant biases, 5 degrees and 700 deg/h: fifteen unknowns, 60 positions and a prior."""
    flown = case("receiver.rate_hz=1", f"duration_s={EPOCHS}", "imu.gyro.noise_deg_h=0", "imu.accelerometer.noise_mg=0")
    world = flown.shared
    rng = np.random.default_rng(5)
    truth = world.at_filter
    start = np.zeros(states.NAV_N)
    start[:3], start[3:6], start[6:10] = truth.llh[0], truth.velocity_ned[0], truth.quaternion[0]
    start = injected(start, -SIGMA * rng.standard_normal(15) * np.repeat([1, 1, 1, 0, 0], 3))
    bias = SIGMA[9:] * rng.standard_normal(6)
    dt = 0.01
    dtheta, dv = world.dtheta + bias[:3] * dt, world.dv + bias[3:] * dt
    radius = np.array([6.38e6, 6.38e6 * np.cos(truth.llh[0, 0]), -1.0])
    fixes = truth.llh[1:] + FIX_SIGMA * rng.standard_normal((EPOCHS, 3)) / radius

    def residuals(shifted: np.ndarray) -> np.ndarray:
        # in sigmas and away from zero, so that the solver's relative steps are steps of 1e-4 sigma
        x = SIGMA * (shifted - 10.0)
        out = np.empty((EPOCHS + 1, states.NAV_N))
        navigate(injected(start, x), DECLARED, dtheta, dv, dt, 100, out)
        misfit = np.empty((EPOCHS, 3))
        for row, nav, fix in zip(misfit, out[1:], fixes, strict=True):
            z = np.empty(15)
            target = nav.copy()
            target[:3] = fix
            eskf.between(target, nav, z)
            row[:] = z[:3]
        return np.concatenate([x / SIGMA, misfit.ravel() / FIX_SIGMA])

    solution = least_squares(
        residuals, np.full(15, 10.0), "3-point", diff_step=1e-5, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    expected = np.empty((EPOCHS + 1, states.NAV_N))
    navigate(injected(start, SIGMA * (solution.x - 10.0)), DECLARED, dtheta, dv, dt, 100, expected)

    fix_time = np.arange(1.0, EPOCHS + 1)
    cov = np.tile(np.diag(np.repeat([FIX_SIGMA**2, 1.0], 3)), (EPOCHS, 1, 1))
    state = records.start(start, np.diag(SIGMA**2))
    history = estimate(
        records.ImuData(world.imu_time, dtheta, dv),
        Measurements.of({FIX: FixTable(fixes, np.full((EPOCHS, 3), np.nan), cov, np.zeros(3))}),
        records.schedule(np.arange(EPOCHS + 1.0), (FIX, fix_time, fix_time)),
        state,
        records.FilterModel(records.MAP, np.zeros((1, 2)), DECLARED, np.full(7, np.inf), 0),
    )
    nav, sigma = state.navigation, history.sigma()
    gap = np.empty(15)
    eskf.between(nav, expected[-1], gap)
    assert np.all(np.abs(gap) < within["estimate"] * sigma[-1]), gap / sigma[-1]
    # the prior is left by 0.5 degrees and more, so this is not the linear problem
    turned = Rotation.from_quat(nav[[7, 8, 9, 6]]) * Rotation.from_quat(start[[7, 8, 9, 6]]).inv()
    assert turned.magnitude() > np.radians(0.5)
    # its sigmas are those of the Jacobian at the solution, carried to the end
    jacobian = solution.jac
    initial = SIGMA * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
    np.testing.assert_allclose(sigma[0][9:], initial[9:], rtol=within["sigma of biases"])


@pytest.mark.parametrize("kind", [records.RTS, records.MAP])
def test_each_output_has_its_row_however_near(kind: int) -> None:
    """Two outputs within what is one time, as an offset of clocks makes them, are both answered, alike."""
    world = case("duration_s=3", "imu.preset=perfect").shared
    fix_time = np.array([1.0, 2.0])
    llh = world.truth.llh[[100, 200]]
    history = estimate(
        records.ImuData(world.imu_time, world.dtheta.copy(), world.dv.copy()),
        Measurements.of({FIX: FixTable(llh, np.full((2, 3), np.nan), np.tile(np.eye(6), (2, 1, 1)), np.zeros(3))}),
        records.schedule(np.array([1.0, np.nextafter(1.0, 2.0), 2.0]), (FIX, fix_time, fix_time)),
        records.start(exact_start(world.at_filter), np.diag(SIGMA**2)),
        records.FilterModel(kind, np.zeros((1, 2)), DECLARED, np.full(7, np.inf), 0),
    )
    np.testing.assert_allclose(history.navigation[1], history.navigation[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(history.covariance[1], history.covariance[0], rtol=1e-6, atol=1e-12)
