"""Angles and ranges of ground stations against pymap3d's geodesy, and their derivatives against complex steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pymap3d
import pytest

from navsim.filter import states
from navsim.filter.measurement_kinds import AZIMUTH, DISTANCE, ELEVATION, Measurements
from navsim.filter.measurement_models import observe
from tests.conftest import Within
from tests.helpers import case

BIAS = {AZIMUTH: (1e-3, -2e-3), ELEVATION: (3e-4, 1e-4), DISTANCE: (40.0, -7.0)}
"""Bias and bends that the filter assumes there to be, rad or m."""
ARM = np.array([1.5, -0.4, -1.2])
ANGLES = np.radians([12.0, -5.0, 70.0])


def rotation(roll: float, pitch: float, yaw: float) -> np.ndarray:
    """From body axes to NED."""
    (a, b, c), (d, e, f) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    x = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
    y = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
    z = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
    return np.asarray(z @ y @ x)


def quaternion(c: np.ndarray) -> np.ndarray:
    """Of a rotation, scalar first."""
    w = 0.5 * np.sqrt(1.0 + np.trace(c))
    return np.array([w, *((c[[2, 0, 1], [1, 2, 0]] - c[[1, 2, 0], [2, 0, 1]]) / (4.0 * w))])


@pytest.mark.validates("Angles and ranges of ground stations, and their derivatives",
                       "pymap3d; complex steps in numpy", angle="1e-9 rad", range="1e-6 m",
                       derivatives="1e-9 (relative)")  # fmt: skip
def test_stations(within: Within) -> None:
    """One point of the approach, off the centre line, at an attitude far from level."""
    lever = f"lever_arm_m: [{', '.join(map(str, ARM))}]"
    flown = case(
        "duration_s=10", "receiver.rate_hz=1", "imu.rate_hz=20", "runway.heading_deg=35", "runway.height_m=140",
        "runway.length_m=3000", "runway.aim_point_m=300", "approach.start=~", "pseudolites={frame: runway, count: 0}",
        "runway.threshold={lat_deg: 56, lon_deg: 37}",
        f"azimuth_station={{noise_m: 1, bias_m: 1, bends_m: 1, height_m: 3, {lever}}}",
        f"elevation_station={{noise_deg: 0.1, bias_deg: 0.1, bends_deg: 0.1, beyond_m: 250, {lever}}}",
        f"dme={{noise_m: 5, bias_m: 10, bends_m: 10, right_m: -80, {lever}}}",
    )  # fmt: skip
    sites = {AZIMUTH: (3300.0, 0.0, 3.0), ELEVATION: (250.0, 120.0, 0.0), DISTANCE: (3300.0, -80.0, 0.0)}
    llh, c_nb = np.array([np.radians(55.991), np.radians(36.987), 190.0]), rotation(*ANGLES)
    place: Any = np.degrees(llh[0]), np.degrees(llh[1])
    declared = flown.flight.model.declared
    tables = Measurements.of({aid.sensor.kind: aid.table(np.zeros((1, 1))) for aid in flown.shared.aids})
    nav = np.zeros(states.NAV_SENSORS + declared.size)
    nav[states.NAV_LLH : states.NAV_VEL], nav[states.NAV_QUAT : states.NAV_BIAS_FRAME] = llh, quaternion(c_nb)
    for k, one in enumerate(declared):
        if one["sensor"] in BIAS:
            nav[states.NAV_SENSORS + k] = BIAS[one["sensor"]][one["axis"]]

    def ecef(ned: np.ndarray, lat: float, lon: float) -> np.ndarray:
        """A direction in axes of a point, in those of the Earth."""
        return np.array(pymap3d.enu2uvw(ned[1], ned[0], -ned[2], lat, lon))

    heading = np.radians(35.0)
    along, right = np.array([np.cos(heading), np.sin(heading), 0.0]), np.array([-np.sin(heading), np.cos(heading), 0.0])
    touchdown = pymap3d.ned2geodetic(*(300.0 * along), 56.0, 37.0, 140.0)
    axes = np.column_stack([ecef(np.eye(3)[k], *place) for k in range(3)])
    for kind, (beyond, across, up) in sites.items():
        lat, lon, _ = pymap3d.ned2geodetic(*((beyond - 300.0) * along + across * right), *touchdown[:2], 140.0)
        station = np.array(pymap3d.geodetic2ecef(lat, lon, 140.0 + up))
        axis = ecef(right, *touchdown[:2]) if kind == AZIMUTH else ecef(np.array([0.0, 0.0, -1.0]), lat, lon)

        def exact(dr: np.ndarray, theta: np.ndarray, station: Any = station, axis: Any = axis, kind: int = kind) -> Any:
            arm = c_nb @ ARM
            away = np.array(pymap3d.geodetic2ecef(*place, llh[2])) + axes @ (arm + dr + np.cross(theta, arm)) - station
            distance = np.sqrt(np.sum(away**2))
            return distance if kind == DISTANCE else np.arcsin(axis @ away / distance)

        have, z, h, r = np.zeros(6), np.zeros(6), np.zeros((6, states.SENSORS + declared.size)), np.zeros((6, 6))
        m = observe(kind, 0, tables, nav, np.zeros(6), 0.01, declared, np.zeros((3, 3)), have, z, h, r)
        assert m == 1
        limit = within["range"] if kind == DISTANCE else within["angle"]
        none = np.zeros(3)
        assert -z[0] == pytest.approx(exact(none, none) + sum(BIAS[kind]), abs=limit)
        steps = 1e-30j * np.eye(3)
        found = np.array([exact(s, none).imag for s in steps] + [exact(none, s).imag for s in steps]) / 1e-30
        mine = np.concatenate([h[0, states.POS : states.VEL], h[0, states.ATT : states.ATT + 3]])
        assert np.abs(mine - found).max() < within["derivatives"] * np.abs(found).max()
        own = [1.0 if one["sensor"] == kind else 0.0 for one in declared]
        np.testing.assert_array_equal(h[0, states.SENSORS :], own)
        assert not h[0, states.VEL : states.ATT].any()
