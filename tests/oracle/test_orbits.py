"""Orbits, clocks and time scales of real satellites against other people's."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.formats.almanac import read_almanac
from navsim.formats.horizon import read_horizon
from navsim.formats.rinex_nav import read_nav
from navsim.formats.sp3 import read_sp3
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss import timescales
from navsim.gnss.constellations import glonass, gps
from navsim.gnss.constellations.glonass_broadcast import StateVectorEphemerides as Glonass
from navsim.gnss.constellations.glonass_broadcast import itrf_from_pz90, lunisolar, pz90_from_itrf, sent_by
from navsim.gnss.constellations.glonass_integration import glonass_states
from navsim.gnss.constellations.systems import GLONASS, GPS
from navsim.gnss.dop import dops
from navsim.gnss.pseudorange import satellites_at_reception
from navsim.gnss.sky import Mask, azimuth_elevation, enu_matrix
from tests.conftest import SCENARIOS, Within

BROADCAST = "data/esbc_2020177/ESBC00DNK_R_20201770000_01D_MN.rnx.gz"
PRECISE = "data/esbc_2020177/GRG0MGXFIN_20201770000_01D_15M_ORB.SP3.gz"


@pytest.mark.validates("Transformation from PZ-90.11 to ITRF2008", "PZ-90.11 reference document (via Orekit)",
                       position="1e-4 m")  # fmt: skip
def test_pz90(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["pz9011_itrf2008"]
    itrf, pz = np.array(entry["itrf2008_m"]), np.array(entry["pz9011_m"])
    np.testing.assert_allclose(pz90_from_itrf(itrf), pz, rtol=0.0, atol=within["position"])
    np.testing.assert_allclose(itrf_from_pz90(pz), itrf, rtol=0.0, atol=within["position"])
    np.testing.assert_allclose(itrf_from_pz90(pz90_from_itrf(itrf)), itrf, rtol=0.0, atol=1e-7)


def integrate(state: Any, acceleration: Any, interval: float, step: float = 60.0) -> np.ndarray:
    out = np.empty((1, 6))
    glonass_states(np.array([state]), np.array([acceleration]), np.array([interval]), step, out)
    return out[0]


@pytest.mark.validates("GLONASS orbit without lunisolar accelerations", "GLONASS ICD example",
                       "(the example has lunisolar accelerations)", position="0.6 m",
                       velocity="2e-3 m/s")  # fmt: skip
def test_glonass_simplified(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["glonass_icd_numeric"]
    out = integrate(entry["state_tb_m_mps"], [0.0] * 3, entry["ti_s"] - entry["tb_s"])
    np.testing.assert_allclose(out[:3], entry["expect_pos_m"], rtol=0.0, atol=within["position"])
    np.testing.assert_allclose(out[3:], entry["expect_vel_mps"], rtol=0.0, atol=within["velocity"])


@pytest.mark.validates("GLONASS orbit with lunisolar accelerations", "GLONASS ICD example", position="1.1e-3 m",
                       velocity="1e-5 m/s")  # fmt: skip
def test_glonass_precise(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["glonass_icd_numeric"]
    day = timescales.posix(2012, 9, 7) - glonass.MOSCOW_MINUS_UTC
    state = np.array(entry["state_tb_m_mps"])
    step = 10.0
    for start in np.arange(entry["tb_s"], entry["ti_s"], step):
        middle = state[:3] + 0.5 * step * state[3:]
        state = integrate(state, lunisolar(np.array([day + start + 0.5 * step]), middle[None])[0], step, step)
    np.testing.assert_allclose(state[:3], entry["expect_pos_m"], rtol=0.0, atol=within["position"])
    np.testing.assert_allclose(state[3:], entry["expect_vel_mps"], rtol=0.0, atol=within["velocity"])


@pytest.mark.validates("GLONASS position by broadcast messages", "IGS precise orbit (via Orekit)", distance="2.8 m")
def test_glonass_broadcast_against_igs(oracles: dict[str, Any], within: Within) -> None:
    entry = oracles["glonass_brdc_vs_igs"]
    out = integrate(entry["state_m_mps"], entry["acc_mps2"], entry["dt_s"])
    assert np.linalg.norm(out[:3] - entry["expect_ecef_m"]) <= within["distance"]


def test_runge_kutta_is_of_fourth_order(oracles: dict[str, Any]) -> None:
    state = oracles["glonass_icd_numeric"]["state_tb_m_mps"]
    exact = integrate(state, [1e-6, 0.0, 0.0], 900.0, 5.0)
    errors = [np.linalg.norm((integrate(state, [1e-6, 0.0, 0.0], 900.0, h) - exact)[:3]) for h in (225.0, 112.5)]
    assert 3.7 < np.log2(errors[0] / errors[1]) < 4.3
    assert np.linalg.norm((integrate(state, [1e-6, 0.0, 0.0], 900.0, 60.0) - exact)[:3]) < 1e-3
    back = integrate(integrate(state, [0.0] * 3, 900.0), [0.0] * 3, -900.0)
    np.testing.assert_allclose(back[:3], state[:3], rtol=0.0, atol=1e-3)


@pytest.mark.validates("Distance of broadcast from precise GPS orbits over a day",
                       "precise orbits of CNES/GRGS, 2020-06-25", RMS="1.6 m")  # fmt: skip
def test_gps_broadcast_against_sp3(shared: Path, within: Within) -> None:
    navigation, precise = read_nav(shared / BROADCAST), read_sp3(shared / PRECISE)
    assert navigation.gps is not None
    error = _differences(gps.KeplerianEphemerides(navigation.gps), precise.of(GPS))
    assert error.size > 2000
    assert np.sqrt(np.mean(error**2)) <= within["RMS"]
    assert np.median(error) == pytest.approx(1.31, abs=0.02)  # a plain solver's, truth.json


@pytest.mark.validates("Distance of broadcast from precise GLONASS orbits over a day",
                       "precise orbits of CNES/GRGS, 2020-06-25", RMS="3.8 m", largest="7.9 m")  # fmt: skip
def test_glonass_broadcast_against_sp3(shared: Path, within: Within) -> None:
    navigation, precise = read_nav(shared / BROADCAST), read_sp3(shared / PRECISE)
    assert navigation.glonass is not None
    error = _differences(Glonass(navigation.glonass), precise.of(GLONASS))
    assert error.size > 800
    assert np.sqrt(np.mean(error**2)) <= within["RMS"]
    assert error.max() < within["largest"]


def _differences(ours: Any, precise: Any) -> np.ndarray:
    common = [n for n in precise.names if n in ours.names]
    a = ours.state(precise.time)[0][:, [ours.names.index(n) for n in common]]
    b = precise.position[:, [precise.names.index(n) for n in common]]
    error = np.linalg.norm(a - b, axis=2)
    return error[np.isfinite(error)]


def test_gps_clocks_near_the_precise_ones(shared: Path) -> None:
    """Broadcast clocks less precise ones: each satellite's scatter a few ns, after the common time scale's offset."""
    navigation, precise = read_nav(shared / BROADCAST), read_sp3(shared / PRECISE).of(GPS)
    assert navigation.gps is not None
    ours = gps.KeplerianEphemerides(navigation.gps)
    common = [n for n in precise.names if n in ours.names]
    columns = [ours.names.index(n) for n in common]
    index = ours.chosen(np.repeat(precise.time[:, None], len(ours.names), axis=1))
    # SP3 clocks are of the ionosphere-free combination, without relativity and group delay
    both = ours.clock(precise.time)[0][:, columns] + ours.records.tgd[index][:, columns]
    table = precise.clock(precise.time)[0][:, [precise.names.index(n) for n in common]]
    difference = both - table
    difference -= np.nanmedian(difference, axis=1, keepdims=True)
    assert np.nanmedian(np.abs(difference)) < 2e-9


@pytest.mark.parametrize("make", ["gps", "glonass", "precise"])
def test_velocity_is_the_rate_of_position(make: str, request: pytest.FixtureRequest) -> None:
    """Of shipped messages, and of a real table of precise orbits."""
    constellation: Any
    if make == "precise":
        constellation = read_sp3(request.getfixturevalue("shared") / PRECISE).of(GPS)
        noon = timescales.posix(2020, 6, 25, 12)
    else:
        navigation = read_nav(SCENARIOS / "data" / "nominal.rnx")
        assert navigation.gps is not None
        assert navigation.glonass is not None
        constellation = gps.KeplerianEphemerides(navigation.gps) if make == "gps" else Glonass(navigation.glonass)
        noon = timescales.posix(2018, 9, 13, 12)
    t = timescales.gps_from_utc(noon) + np.arange(-480.0, -80.0, 40.0)
    velocity = constellation.state(t)[1]
    h = 0.5
    numeric = (constellation.state(t + h)[0] - constellation.state(t - h)[0]) / (2 * h)
    error = np.abs(velocity - numeric)
    assert np.isfinite(error).any()
    # where the nearest message changes between the two positions, the difference is no velocity
    assert np.nanpercentile(error, 95) < 2e-4


@pytest.mark.validates("DOPs from a YUMA almanac with masks", "Trimble Planning (via Orekit)", DOPs="0.01")
def test_trimble_dops(oracles: dict[str, Any], shared: Path, tmp_path: Path, within: Within) -> None:
    entry = oracles["dop_trimble_yuma"]
    site = np.array([*np.radians(entry["site_llh"][:2]), entry["site_llh"][2]])
    here = ecef_from_llh(site)
    table = "".join(f"{a},{e}\n" for a, e in entry["cases"][2]["mask_az_el_linear_interp"])
    (tmp_path / "horizon.csv").write_text(f"azimuth_deg,elevation_deg\n{table}")
    horizon = read_horizon(tmp_path / "horizon.csv")
    for c in entry["cases"]:
        utc = datetime.datetime.fromisoformat(c["utc"] + "+00:00").timestamp()
        almanac = read_almanac(shared / "data/almanacs/gps_yuma_20160331.alm", utc).constellations[0]
        position, _ = satellites_at_reception(almanac, timescales.gps_from_utc(np.array([utc])), here[None])
        away = position - here
        los = np.einsum("ij,mnj->mni", enu_matrix(site), away / np.linalg.norm(away, axis=2, keepdims=True))
        azimuth, elevation = azimuth_elevation(los)
        low = c.get("mask_deg")
        mask = Mask(-0.5 * np.pi, 0.5 * np.pi, (), horizon) if low is None else Mask(np.radians(low), 0.5 * np.pi)
        seen = mask.passes(azimuth, elevation)
        los[~seen] = np.nan
        ours = dops(los, np.zeros(los.shape[1], int))[0]
        g, p, h, v, t = ours
        assert int(seen.sum()) == c["expect"][0]
        if c["expect"][1] is None:
            assert np.isnan(ours).all()
        else:
            np.testing.assert_allclose([g, t, p, h, v], c["expect"][1:], rtol=0.0, atol=within["DOPs"])


def test_gps_almanacs_of_neighbouring_weeks_agree(shared: Path) -> None:
    utc = timescales.posix(2018, 9, 13)
    old, new = (
        read_almanac(shared / f"data/almanacs/MCCJ_{d}.agp", utc).constellations[0] for d in ("180901", "180913")
    )
    common = [n for n in old.names if n in new.names]
    gpst = timescales.gps_from_utc(np.array([utc]))
    a = old.state(gpst)[0][0][[old.names.index(n) for n in common]]
    b = new.state(gpst)[0][0][[new.names.index(n) for n in common]]
    assert len(common) > 28
    assert np.median(np.linalg.norm(a - b, axis=1)) < 2e4  # twelve days apart: a twentieth of a degree


def test_sem_and_yuma_of_neighbouring_weeks_agree(shared: Path) -> None:
    utc = timescales.posix(2016, 3, 20)
    sem = read_almanac(shared / "data/almanacs/gps_sem_current.al3", utc).constellations[0]
    yuma = read_almanac(shared / "data/almanacs/gps_yuma_20160331.alm", utc).constellations[0]
    common = [n for n in sem.names if n in yuma.names]
    gpst = timescales.gps_from_utc(np.array([utc]))
    a = sem.state(gpst)[0][0][[sem.names.index(n) for n in common]]
    b = yuma.state(gpst)[0][0][[yuma.names.index(n) for n in common]]
    assert len(common) > 28
    assert np.nanmedian(np.linalg.norm(a - b, axis=1)) < 5e4  # four weeks apart; one satellite is unhealthy


def test_simulated_messages_follow_their_constellation() -> None:
    """State vectors each half hour of the almanac's orbits, integrated, stay near those orbits: J2 and its short-period
    terms are in both, the almanac has no Moon."""
    start = timescales.posix(2018, 9, 13, 11, 50)
    shape = glonass.Glonass24Slots()
    ours = sent_by(shape, start, start + 7200.0)
    assert np.all(ours.records.time % 1800.0 == 0.0)
    t = timescales.gps_from_utc(start + np.arange(0.0, 7200.0, 300.0))
    position, _ = ours.state(t)
    error = np.linalg.norm(position - shape.state(t)[0], axis=2)
    assert np.isfinite(error).all()
    assert error.max() < 400.0  # the nominal circles have no J2 in their plane
    first = timescales.gps_from_utc(ours.records.time[:1])
    exact = np.linalg.norm(ours.state(first)[0] - shape.state(first)[0], axis=2)
    assert exact.max() < 1e-6


def test_leap_seconds() -> None:
    """GPS - UTC: 0 in 1980, 17 and 18 s on the two sides of 2017, IERS Bulletin C."""
    assert timescales.leap_seconds(timescales.posix(1980, 1, 6)) == 0.0
    edge = timescales.posix(2017, 1, 1)
    assert timescales.leap_seconds(edge - 0.5) == 17.0
    assert timescales.leap_seconds(edge) == 18.0
    utc = np.linspace(timescales.posix(1981, 1, 1), timescales.posix(2025, 1, 1), 997)
    np.testing.assert_allclose(timescales.utc_from_gps(timescales.gps_from_utc(utc)), utc, rtol=0.0, atol=1e-6)
    assert timescales.full_week(866, timescales.posix(2016, 3, 31)) == 1890
    assert timescales.full_week(38, timescales.posix(2020, 1, 1)) == 2086


def test_the_leap_second_of_2016_has_a_date_of_its_own() -> None:
    before = float(timescales.gps_from_utc(timescales.posix(2016, 12, 31, 23, 59, 59.0)))
    last, first = datetime.date(2016, 12, 31), datetime.date(2017, 1, 1)
    wanted = [
        (last, 23, 59, 59.0),
        (last, 23, 59, 59.5),
        (last, 23, 59, 60.0),
        (last, 23, 59, 60.5),
        (first, 0, 0, 0.0),
    ]
    assert [timescales.utc_calendar(before + 0.5 * k) for k in range(5)] == wanted
    assert timescales.gps_from_utc(timescales.posix(2017, 1, 1)) - before == 2.0


@pytest.mark.validates("Leap seconds as GPS announces them", "IERS Bulletin C 52; GPS week 1929, day 7", "exact")
@pytest.mark.parametrize(
    ("date", "wanted"),
    [
        ((2016, 6, 1), (17, (17, 1851, 3))),  # the last one was at the end of 2015-06-30, a Tuesday
        ((2016, 12, 31, 23, 59, 59.0), (17, (18, 1929, 7))),
        ((2017, 1, 1), (18, (18, 1929, 7))),
        ((2024, 5, 5), (18, (18, 1929, 7))),
    ],
)
def test_announced_leap_seconds(date: tuple[int, ...], wanted: tuple[int, tuple[int, int, int]]) -> None:
    assert timescales.announced_leap_second(float(timescales.gps_from_utc(timescales.posix(*date)))) == wanted


def test_almanacs_and_the_nominal_sky_move_on_in_a_leap_second() -> None:
    """A satellite flies its 3.9 km in it as in any other."""
    t = timescales.gps_from_utc(timescales.posix(2016, 12, 31, 23, 59, 58.0)) + np.arange(0.0, 5.0)
    # the almanac's own time is later: behind the leap second
    almanac = read_almanac(SCENARIOS / "data" / "nominal.agl", timescales.posix(2018, 9, 13)).constellations[0]
    for constellation in (almanac, glonass.Glonass24Slots(), gps.nominal(timescales.posix(2016, 12, 31))):
        position, velocity = constellation.state(t)
        np.testing.assert_allclose(np.diff(position, axis=0), 0.5 * (velocity[1:] + velocity[:-1]), atol=0.5)


@pytest.mark.validates("Greenwich mean sidereal time", "Astronomical Almanac, 2000-01-01 12:00 UT1: 280.46062°",
                       angle="1e-5 deg")  # fmt: skip
def test_sidereal_angle(within: Within) -> None:
    angle = timescales.sidereal_angle(timescales.posix(2000, 1, 1, 12))
    assert np.degrees(angle) == pytest.approx(280.46062, abs=within["angle"])


TLE = """VANGUARD 1
1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753
2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667
"""


@pytest.mark.validates("Satellite position by two-line elements",
                       "SGP4 verification set (AIAA 2006-6753), satellite 00005", position="1 m",
                       axes="1e-3 deg")  # fmt: skip
def test_two_line_elements(tmp_path: Path, within: Within) -> None:
    path = tmp_path / "vanguard.tle"
    path.write_text(TLE.split("\n", 1)[1])
    constellation = read_almanac(path, 0.0, GPS).constellations[0]
    assert constellation.names == ("T00005",)
    utc = float(constellation.epochs[0])
    ours = constellation.state(timescales.gps_from_utc(np.array([utc])))[0][0, 0]
    published = 1e3 * np.array([7022.46529266, -1400.08296755, 0.03995155])
    assert np.linalg.norm(ours) == pytest.approx(np.linalg.norm(published), abs=within["position"])
    assert ours[2] == pytest.approx(published[2], abs=within["position"])
    turned = np.arctan2(published[1], published[0]) - np.arctan2(ours[1], ours[0])
    assert np.sin(turned - timescales.sidereal_angle(utc)) == pytest.approx(0.0, abs=np.radians(within["axes"]))
