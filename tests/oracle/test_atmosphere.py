"""Atmospheric delays against published numbers."""

from __future__ import annotations

import datetime
from typing import Any

import numpy as np
import pytest

from navsim.gnss import atmosphere, timescales
from tests.conftest import Within

SITE = np.array([np.radians(35.0), np.radians(140.0), 100.0])


def gpst(text: str) -> float:
    return datetime.datetime.fromisoformat(text + "+00:00").timestamp() - timescales.GPS_EPOCH


@pytest.mark.validates("Klobuchar's ionosphere", "RTKLIB's unit test t_atmos.c", delay="1e-8 m")
def test_klobuchar(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["klobuchar"]
    for c in entry["cases"]:
        llh = np.array([*np.radians(c["llh"][:2]), c["llh"][2]])
        ours = atmosphere.klobuchar(
            np.array(entry["alpha"]), np.array(entry["beta"]), gpst(c["gpst"]), llh, *np.radians(c["azel_deg"])
        )
        assert ours == pytest.approx(c["m"], abs=within["delay"])


@pytest.mark.validates("Saastamoinen's troposphere", "RTKLIB's unit test t_atmos.c", delay="1e-8 m")
def test_saastamoinen(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["saastamoinen"]
    c = entry["case"]
    llh = np.array([*np.radians(c["llh"][:2]), c["llh"][2]])
    ours = atmosphere.saastamoinen(llh, np.radians(c["azel_deg"][1]), c["humidity"])
    assert ours == pytest.approx(c["m"], abs=within["delay"])


def test_saastamoinen_has_no_delay_below_the_horizon() -> None:
    assert np.isnan(atmosphere.saastamoinen(SITE, np.array([-0.1, 0.0]))).all()


def test_climatology_beside_the_standard_atmosphere() -> None:
    """Two sources for one thing: hydrostatic zenith delays within 3 cm, wet ones within 20 cm, all seasons."""
    for latitude in np.radians([-70.0, -20.0, 0.0, 35.0, 56.0, 80.0]):
        for height in (0.0, 1500.0):
            llh = np.array([latitude, 0.0, height])
            for day in (15, 110, 210, 300):
                dry, wet = atmosphere.mops_zenith(llh, day)
                standard_dry, standard_wet = atmosphere.saastamoinen_zenith(llh)
                assert dry == pytest.approx(standard_dry, abs=0.06)
                assert 0.0 < wet < standard_wet + 0.22


def test_seasons_are_opposite_in_the_hemispheres() -> None:
    north, south = np.array([0.9, 0.0, 0.0]), np.array([-0.9, 0.0, 0.0])
    assert atmosphere.mops_zenith(north, 28 + 10) == pytest.approx(atmosphere.mops_zenith(south, 211 + 10), rel=1e-3)
    assert atmosphere.mops_zenith(north, 211)[1] > 1.5 * atmosphere.mops_zenith(north, 28)[1]


@pytest.mark.validates(
    "Niell's mapping functions", "MOPS mapping 1.001 / sqrt(0.002001 + sin2 E) of DO-229", "above 10°",
    hydrostatic="0.6 %", wet="1.5 %",
)  # fmt: skip
def test_niell_against_the_mapping_of_the_mops(within: Within) -> None:
    elevation = np.radians(np.array([10.0, 20.0, 45.0, 90.0]))
    mops = 1.001 / np.sqrt(0.002001 + np.sin(elevation) ** 2)
    hydrostatic, wet = atmosphere.niell_mapping(np.array([0.9, 0.0, 0.0]), elevation, 100)
    np.testing.assert_allclose(hydrostatic, mops, rtol=within["hydrostatic"])
    np.testing.assert_allclose(wet, mops, rtol=within["wet"])  # vapour lies lower: the Earth's curvature matters less
    assert atmosphere.niell_mapping(SITE, np.pi / 2, 10) == pytest.approx((1.0, 1.0), abs=1e-9)
