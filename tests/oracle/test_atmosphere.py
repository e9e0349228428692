"""Atmospheric delays against published numbers."""

from __future__ import annotations

import datetime
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from navsim.gnss import atmosphere, timescales
from tests.conftest import Within
from tests.helpers import case

SITE = np.array([np.radians(35.0), np.radians(140.0), 100.0])


def gpst(text: str) -> float:
    return datetime.datetime.fromisoformat(text + "+00:00").timestamp() - timescales.GPS_EPOCH


@pytest.mark.validates("Ionospheric delay by Klobuchar's model", "RTKLIB's unit test t_atmos.c", delay="1e-8 m")
def test_klobuchar(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["klobuchar"]
    for c in entry["cases"]:
        llh = np.array([*np.radians(c["llh"][:2]), c["llh"][2]])
        ours = atmosphere.klobuchar(
            np.array(entry["alpha"]), np.array(entry["beta"]), gpst(c["gpst"]), llh, *np.radians(c["azel_deg"])
        )
        assert ours == pytest.approx(c["m"], abs=within["delay"])


@pytest.mark.validates("Tropospheric delay by Saastamoinen's model", "RTKLIB's unit test t_atmos.c", delay="1e-8 m")
def test_saastamoinen(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["saastamoinen"]
    c = entry["case"]
    llh = np.array([*np.radians(c["llh"][:2]), c["llh"][2]])
    ours = atmosphere.saastamoinen(llh, np.radians(c["azel_deg"][1]), c["humidity"])
    assert ours == pytest.approx(c["m"], abs=within["delay"])


def test_saastamoinen_has_no_delay_below_the_horizon() -> None:
    assert np.isnan(atmosphere.saastamoinen(SITE, np.array([-0.1, 0.0]))).all()


def test_little_air_is_left_above_30_km() -> None:
    """Also where the temperature of the standard atmosphere would be that at which its vapour is infinite, or none."""
    delays = [sum(atmosphere.saastamoinen_zenith(np.array([0.9, 0.1, h]))) for h in (29e3, 38.4e3, 39e3, 44.4e3, 1e5)]
    assert np.all(np.diff(delays) <= 1e-4)
    assert 0.0 < delays[-1] < delays[0] < 0.01


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


@pytest.mark.validates("Niell's mapping functions", "MOPS mapping 1.001 / sqrt(0.002001 + sin2 E) of DO-229",
                       "above 10°", hydrostatic="0.6 %", wet="1.5 %")  # fmt: skip
def test_niell_against_the_mapping_of_the_mops(within: Within) -> None:
    elevation = np.radians(np.array([10.0, 20.0, 45.0, 90.0]))
    mops = 1.001 / np.sqrt(0.002001 + np.sin(elevation) ** 2)
    hydrostatic, wet = atmosphere.niell_mapping(np.array([0.9, 0.0, 0.0]), elevation, 100)
    np.testing.assert_allclose(hydrostatic, mops, rtol=within["hydrostatic"])
    np.testing.assert_allclose(wet, mops, rtol=within["wet"])  # vapour lies lower: the Earth's curvature matters less
    assert atmosphere.niell_mapping(SITE, np.pi / 2, 10) == pytest.approx((1.0, 1.0), abs=1e-9)


@pytest.mark.validates("Delay by the air on the paths of pseudolites",
                       "quadrature of ITU-R P.453's atmosphere (scipy)", every_value="1e-9 m")  # fmt: skip
@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (153.0, 2.0), (3.0, 3000.0), (10.0, 10.001)])
def test_ground_delay(a: float, b: float, within: Within) -> None:
    distance = 5000.0
    share, _ = quad(lambda s: np.exp(-(a + s * (b - a)) / 7350.0), 0.0, 1.0, epsabs=1e-14)
    found = 320.0 * atmosphere.ground_delay(np.array(a), np.array(b), np.array(distance))
    assert found == pytest.approx(320e-6 * distance * share, abs=within["every_value"])
    if b == 0.0:
        assert found == pytest.approx(1.6)  # 0.32 m a kilometre


def test_air_lengthens_the_ranges_of_pseudolites() -> None:
    """By what the receiver does not correct, and those of satellites not at all."""
    plain, thick, corrected = (
        case("duration_s=5", "receiver.rate_hz=1", *more).shared.signals
        for more in ((), ("pseudolites.air.truth_refractivity_n=320",), (
            "pseudolites.air={truth_refractivity_n: 320, correction: refractivity, corrected_refractivity_n: 300}",
        ))
    )  # fmt: skip
    count = 2
    added = thick.range_bias - plain.range_bias
    assert not added[:, :-count].any()
    per_km = added[:, -count:] / plain.range[:, -count:] * 1000.0
    assert np.all((per_km > 0.31) & (per_km < 0.32))
    np.testing.assert_allclose(corrected.range_bias - plain.range_bias, added * 20.0 / 320.0, atol=1e-12)
