"""WGS-84 against published points, pymap3d and published gravity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pymap3d
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navsim.geodesy import earth
from navsim.geodesy import earth_kernels as point
from navsim.gnss.pseudolite import runway_position
from navsim.gnss.sky import azimuth_elevation, enu_matrix
from tests.conftest import Within


@pytest.mark.validates("Geodetic and ECEF coordinates", "RTKLIB and roktools published points", angles="1e-7 deg",
                       ECEF="2e-3 m", height="1e-3 m")  # fmt: skip
def test_published_points(oracles: dict[str, Any], within: Within) -> None:
    for entry in oracles["ecef_llh"]:
        lat, lon, h = entry["lat_lon_deg_h_m"]
        llh = np.array([np.radians(lat), np.radians(lon), h])
        np.testing.assert_allclose(earth.ecef_from_llh(llh), entry["ecef_m"], rtol=0.0, atol=within["ECEF"])
        back = earth.llh_from_ecef(np.array(entry["ecef_m"]))
        np.testing.assert_allclose(np.degrees(back[:2]), [lat, lon], rtol=0.0, atol=within["angles"])
        assert back[2] == pytest.approx(h, abs=within["height"])


@pytest.mark.validates("Normal gravity", "NIMA TR8350.2 figures as in pyins' tests", gravity="1e-9 m/s2")
def test_published_gravity(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["gravity_somigliana"]
    assert point.gravity(0.0, 0.0) == pytest.approx(entry["g_equator_h0"], abs=within["gravity"])
    assert point.gravity(1.0, 0.0) == pytest.approx(entry["g_pole_h0"], abs=within["gravity"])
    assert point.gravity(0.5, 1000.0) == pytest.approx(point.gravity(0.5, 0.0) * (1 - 2000.0 / earth.A), rel=1e-14)


@pytest.mark.validates("Geodetic and ECEF coordinates, random points", "pymap3d", ECEF="1e-8 m")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])  # the tolerances stay as they are
@given(lat=st.floats(-89.9, 89.9), lon=st.floats(-180, 180), h=st.floats(-1e3, 5e5))
def test_coordinates_agree_with_pymap3d(within: Within, lat: float, lon: float, h: float) -> None:
    llh = np.array([np.radians(lat), np.radians(lon), h])
    ecef = earth.ecef_from_llh(llh)
    np.testing.assert_allclose(ecef, pymap3d.geodetic2ecef(lat, lon, h), rtol=0.0, atol=within["ECEF"])
    np.testing.assert_allclose(earth.ecef_from_llh(earth.llh_from_ecef(ecef)), ecef, rtol=0.0, atol=within["ECEF"])
    kernel = np.empty(3)
    point.ecef_to_llh(*ecef, kernel)
    # a height is what two numbers of 6.4e6 m, known to 1e-9, leave of each other, each way with roundings of its own
    np.testing.assert_allclose(kernel, earth.llh_from_ecef(ecef), rtol=1e-14, atol=5e-9)
    axes = np.empty((3, 3))
    point.ned_axes(llh[0], llh[1], axes)
    np.testing.assert_allclose(axes, earth.ned_matrix(llh), atol=1e-15)


@pytest.mark.validates("Local axes, random points", "pymap3d", axes="1e-14")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lat=st.floats(-89.9, 89.9), lon=st.floats(-180, 180))
def test_local_axes_agree_with_pymap3d(within: Within, lat: float, lon: float) -> None:
    v = np.array([0.3, -2.0, 1.1])
    enu = pymap3d.ecef2enuv(*v, lat, lon)
    ned = earth.ned_matrix(np.array([np.radians(lat), np.radians(lon), 0.0])) @ v
    np.testing.assert_allclose(ned, [enu[1], enu[0], -enu[2]], rtol=0.0, atol=within["axes"])


@pytest.mark.validates("Azimuth, elevation and distance, random points", "pymap3d", angles="1e-8 deg",
                       distance="1e-6 m")  # fmt: skip
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    lat=st.floats(-89.0, 89.0), lon=st.floats(-180, 180), h=st.floats(-1e3, 1e4),
    azimuth=st.floats(0.0, 359.9), elevation=st.floats(-80.0, 80.0), distance=st.floats(10.0, 2e7),
)  # fmt: skip
def test_directions_agree_with_pymap3d(
    within: Within, lat: float, lon: float, h: float, azimuth: float, elevation: float, distance: float
) -> None:
    """Its way there only: on the way back it takes components below a millimetre for none."""
    there = np.array(pymap3d.aer2ecef(azimuth, elevation, distance, lat, lon, h))
    here = np.array([np.radians(lat), np.radians(lon), h])
    away = there - earth.ecef_from_llh(here)
    ours = azimuth_elevation(enu_matrix(here) @ away / np.linalg.norm(away))
    gap = (np.degrees(ours[0]) - azimuth + 180.0) % 360.0 - 180.0
    assert abs(gap) * np.cos(np.radians(elevation)) < within["angles"] + np.degrees(4e-9 / distance)
    assert np.degrees(ours[1]) == pytest.approx(elevation, abs=within["angles"] + np.degrees(4e-9 / distance))
    assert np.linalg.norm(away) == pytest.approx(distance, abs=within["distance"])


@pytest.mark.validates("Positions in runway axes, random points", "pymap3d", position="1e-6 m")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    lat=st.floats(-85.0, 85.0), lon=st.floats(-179, 179), heading=st.floats(0.0, 360.0), s=st.floats(-5e3, 5e3),
    l1=st.floats(-5e3, 2e4),
)  # fmt: skip
def test_runway_axes_agree_with_pymap3d(
    within: Within, lat: float, lon: float, heading: float, s: float, l1: float
) -> None:
    threshold = np.array([np.radians(lat), np.radians(lon), 150.0])
    ours = runway_position(threshold, np.radians(heading), s, l1, 3.0)
    ahead, right = np.array([np.sin(np.radians(heading)), np.cos(np.radians(heading))]), np.radians(heading + 90.0)
    east, north = -l1 * ahead + s * np.array([np.sin(right), np.cos(right)])
    place = pymap3d.enu2geodetic(east, north, 0.0, lat, lon, 150.0)
    theirs = np.array(pymap3d.geodetic2ecef(place[0], place[1], 153.0))
    np.testing.assert_allclose(earth.ecef_from_llh(ours), theirs, rtol=0.0, atol=within["position"])


@pytest.mark.validates("Radii of curvature at pole and equator", "closed form", "(relative)", radii="1e-12")
def test_radii_at_pole_and_equator(within: Within) -> None:
    """Closed forms: a(1 - e2) and a on the equator, both a/sqrt(1 - e2) at the pole."""
    assert point.radii(0.0) == pytest.approx((earth.A * (1 - earth.E2), earth.A), rel=within["radii"])
    polar = earth.A**2 / earth.B
    assert point.radii(1.0) == pytest.approx((polar, polar), rel=within["radii"])
