"""WGS-84 against published points, pymap3d and published gravity."""

from __future__ import annotations

from typing import Any

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navsim.core import earth, wgs84


@pytest.mark.validates("geodetic and ECEF coordinates", "RTKLIB and roktools published points", "1e-7 deg, 2 mm")
def test_published_points(oracles: dict[str, Any]) -> None:
    for entry in oracles["ecef_llh"]:
        lat, lon, h = entry["lat_lon_deg_h_m"]
        llh = np.array([np.radians(lat), np.radians(lon), h])
        np.testing.assert_allclose(wgs84.ecef_from_llh(llh), entry["ecef_m"], atol=2e-3)
        back = wgs84.llh_from_ecef(np.array(entry["ecef_m"]))
        np.testing.assert_allclose(np.degrees(back[:2]), [lat, lon], atol=1e-7)
        assert back[2] == pytest.approx(h, abs=1e-3)


@pytest.mark.validates("normal gravity", "NIMA TR8350.2 figures as in pyins' tests", "1e-9 m/s²")
def test_published_gravity(oracles: dict[str, Any]) -> None:
    entry = oracles["gravity_somigliana"]
    assert earth.gravity(0.0, 0.0) == pytest.approx(entry["g_equator_h0"], abs=1e-10)
    assert earth.gravity(1.0, 0.0) == pytest.approx(entry["g_pole_h0"], abs=1e-9)
    assert earth.gravity(0.5, 1000.0) == pytest.approx(earth.gravity(0.5, 0.0) * (1 - 2000.0 / wgs84.A), rel=1e-14)


@pytest.mark.validates("geodetic and ECEF coordinates, random points", "pymap3d", "1e-8 m")
@given(st.floats(-89.9, 89.9), st.floats(-180, 180), st.floats(-1e3, 5e5))
def test_coordinates_agree_with_pymap3d(lat: float, lon: float, h: float) -> None:
    llh = np.array([np.radians(lat), np.radians(lon), h])
    ecef = wgs84.ecef_from_llh(llh)
    np.testing.assert_allclose(ecef, pymap3d.geodetic2ecef(lat, lon, h), atol=1e-8)
    np.testing.assert_allclose(wgs84.ecef_from_llh(wgs84.llh_from_ecef(ecef)), ecef, atol=1e-8)
    kernel = np.empty(3)
    earth.ecef_to_llh(*ecef, kernel)
    np.testing.assert_allclose(kernel, wgs84.llh_from_ecef(ecef), rtol=1e-14, atol=2e-9)
    axes = np.empty((3, 3))
    earth.ned_axes(llh[0], llh[1], axes)
    np.testing.assert_allclose(axes, wgs84.ned_matrix(llh), atol=1e-15)


@pytest.mark.validates("local axes, random points", "pymap3d", "1e-14")
@given(st.floats(-89.9, 89.9), st.floats(-180, 180))
def test_local_axes_agree_with_pymap3d(lat: float, lon: float) -> None:
    v = np.array([0.3, -2.0, 1.1])
    enu = pymap3d.ecef2enuv(*v, lat, lon)
    ned = wgs84.ned_matrix(np.array([np.radians(lat), np.radians(lon), 0.0])) @ v
    np.testing.assert_allclose(ned, [enu[1], enu[0], -enu[2]], atol=1e-14)


@pytest.mark.validates("radii of curvature at pole and equator", "closed form", "1e-12")
def test_radii_at_pole_and_equator() -> None:
    """Closed forms: a(1 - e2) and a on the equator, both a/sqrt(1 - e2) at the pole."""
    assert earth.radii(0.0) == pytest.approx((wgs84.A * (1 - wgs84.E2), wgs84.A), rel=1e-15)
    polar = wgs84.A**2 / wgs84.B
    assert earth.radii(1.0) == pytest.approx((polar, polar), rel=1e-12)
