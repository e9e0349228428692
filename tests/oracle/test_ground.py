"""Measurements of a vehicle on the ground against complex steps in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.filter import states
from navsim.filter.measurement_kinds import HEADING, REST_RATE, VEHICLE_VELOCITY, Measurements, VehicleTable
from navsim.filter.measurement_models import observe
from navsim.filter.states import Block, declared
from navsim.geodesy.earth import RATE
from tests.conftest import Within
from tests.oracle.test_ground_stations import quaternion, rotation

BLOCKS = (
    *states.biases(),
    Block("vehicle_axes", "rad", VEHICLE_VELOCITY, of_body=True),
    Block("vehicle_lever_arm", "m", VEHICLE_VELOCITY, of_body=True, first=3),
    Block("heading_error", "rad", HEADING, size=1),
)
ESTIMATES = np.array([1e-3, -2e-3, 3e-3, 0.1, -0.2, 0.05, 0.02, 0.03, -0.04, 0.4, -0.3, 0.2, 0.05])


@pytest.mark.validates("Measurement models of heading, wheels and rest, and their derivatives",
                       "complex steps in numpy", every_value="1e-14", derivatives="1e-9 (relative)")  # fmt: skip
def test_vehicle(within: Within) -> None:
    """At an attitude far from level; estimates of all states differ from zero, and the axes are mounted askew."""
    c_nb, mounted, arm = rotation(0.2, -0.1, 0.4), rotation(0.3, 0.1, -0.6), np.array([1.0, -0.5, 0.3])
    rate, lat = np.array([0.05, -0.1, 0.3]), 0.9
    nav = np.zeros(states.NAV_SENSORS + ESTIMATES.size)
    nav[states.NAV_LLH], nav[states.NAV_VEL : states.NAV_QUAT] = lat, (12.0, -5.0, 0.7)
    nav[states.NAV_QUAT : states.NAV_BIAS_FRAME], nav[states.NAV_SENSORS :] = quaternion(c_nb), ESTIMATES
    earth = RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])

    def exact(kind: int, d: np.ndarray) -> np.ndarray:
        """Of a state with the errors d (n,)."""
        theta, x = d[states.ATT : states.SENSORS], ESTIMATES + d[states.SENSORS :]
        c = c_nb + np.cross(theta, c_nb, axis=0)
        if kind == HEADING:
            u = c @ mounted[0]
            return np.array([np.arctan(u[1] / u[0]) + x[12]])
        if kind == REST_RATE:
            return np.asarray(c_nb.T @ earth + x[:3])
        turned = rate - d[states.GYRO : states.GYRO + 3] - c_nb.T @ earth
        body = c.T @ (nav[states.NAV_VEL : states.NAV_QUAT] + d[states.VEL : states.ATT])
        along = mounted @ (body + np.cross(turned, arm + x[9:12]))
        return np.asarray(along - np.cross(x[6:9], along))

    table = VehicleTable(np.zeros((1, 3)), np.full((1, 3), 0.04), mounted, arm)
    tables = Measurements.of(dict.fromkeys((HEADING, VEHICLE_VELOCITY, REST_RATE), table))
    n = states.SENSORS + ESTIMATES.size
    increments = np.concatenate([0.01 * rate, np.zeros(3)])
    for kind in (HEADING, VEHICLE_VELOCITY, REST_RATE):
        have, z, h, r = np.zeros(6), np.zeros(6), np.zeros((6, n)), np.zeros((6, 6))
        m = observe(kind, 0, tables, nav, increments, 0.01, declared(BLOCKS), np.zeros((3, 3)), have, z, h, r)
        np.testing.assert_allclose(-z[:m], exact(kind, np.zeros(n)), rtol=0.0, atol=within["every_value"])
        found = np.array([exact(kind, step).imag for step in 1e-30j * np.eye(n)]).T / 1e-30
        assert np.abs(h[:m] - found).max() < within["derivatives"] * np.abs(found).max()
        np.testing.assert_array_equal(r[:m, :m], 0.04 * np.eye(m))


def test_axis_without_heading() -> None:
    """An axis that points up has none: the measurement is missing."""
    nav = np.zeros(states.NAV_SENSORS + 6)
    nav[states.NAV_QUAT] = 1.0
    up = VehicleTable(np.zeros((1, 3)), np.ones((1, 3)), np.eye(3)[[2, 0, 1]], np.zeros(3))
    have, z, h, r = np.zeros(6), np.ones(6), np.zeros((6, 15)), np.zeros((6, 6))
    tables, model = Measurements.of({HEADING: up}), declared(states.biases())
    observe(HEADING, 0, tables, nav, np.zeros(6), 0.01, model, np.zeros((3, 3)), have, z, h, r)
    assert have[0] == z[0] == 0.0
    assert not h.any()
