"""Dilution of precision against a closed form, an almanac's published figures and dense algebra."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.formats.almanac import read_almanac
from navsim.gnss import timescales
from navsim.gnss.constellations.glonass import Glonass24Slots, GlonassAlmanac
from navsim.gnss.dop import dops, geometry_covariance
from navsim.gnss.sky import unit_vector
from tests.conftest import Within
from tests.helpers import case, scenario


def directions(az_el_deg: list[list[float]]) -> np.ndarray:
    azimuth, elevation = np.radians(np.array(az_el_deg, dtype=float)).T
    return unit_vector(azimuth, elevation)[None]


@pytest.mark.validates("GDOP, PDOP, HDOP, VDOP, TDOP", "closed form (gnss_lib_py)", DOPs="1e-12")
def test_closed_form(oracles: dict[str, Any], within: Within) -> None:
    """Five directions whose DOPs are known in closed form."""
    entry = oracles["dop_closed_form"]
    ours = dops(directions(entry["az_el_deg"]), np.zeros(5, int))[0]
    for value, name in zip(ours, ("GDOP", "PDOP", "HDOP", "VDOP", "TDOP"), strict=True):
        assert value == pytest.approx(entry[name], abs=within["DOPs"]), name


@pytest.mark.validates("DOPs and covariance of weighted fixes with one to three clocks", "numpy dense inverse",
                       "(relative)", covariance="1e-8", DOPs="1e-9")  # fmt: skip
def test_several_clocks_against_dense_algebra(within: Within) -> None:
    rng = np.random.default_rng(3)
    compared = 0
    for _ in range(50):
        count = int(rng.integers(6, 15))
        los = unit_vector(rng.uniform(0, 2 * np.pi, count), rng.uniform(0.05, 1.5, count))
        clock = rng.integers(0, 3, count)
        weight = rng.uniform(0.1, 2.0, count)
        columns = np.unique(clock)
        h = np.concatenate([-los, (clock[:, None] == columns).astype(float)], axis=1)
        if count < h.shape[1]:
            continue
        cofactor, unknowns = geometry_covariance(los[None], clock, weight[None])
        expected = np.linalg.inv(h.T @ (weight[:, None] * h))
        assert unknowns[0] == h.shape[1]
        np.testing.assert_allclose(
            cofactor[0, : h.shape[1], : h.shape[1]], expected, rtol=within["covariance"], atol=1e-12
        )
        unit = np.linalg.inv(h.T @ h)
        expected_dops = np.sqrt(
            [np.trace(unit), np.trace(unit[:3, :3]), unit[0, 0] + unit[1, 1], unit[2, 2], unit[3, 3]]
        )
        np.testing.assert_allclose(dops(los[None], clock)[0], expected_dops, rtol=within["DOPs"])
        compared += 1
    assert compared > 40


def test_no_solution_is_nan() -> None:
    three = directions([[0, 10], [120, 40], [240, 30]])
    assert np.all(np.isnan(dops(three, np.zeros(3, int))))
    cone = directions([[a, 30] for a in range(0, 360, 45)])  # all on one cone: height and clock are one
    assert np.all(np.isnan(dops(cone, np.zeros(8, int))))
    four = directions([[0, 10], [120, 40], [240, 30], [60, 80]])
    assert np.all(np.isfinite(dops(four, np.zeros(4, int))))
    assert np.all(np.isnan(dops(four, np.array([0, 0, 0, 1]))))  # two clocks need five
    assert np.all(np.isnan(dops(np.empty((2, 0, 3)), np.empty(0, int))))


@pytest.mark.validates("GLONASS position and velocity by almanac", "GLONASS ICD example (as coded in Orekit)",
                       position="1e-3 m", velocity="1e-6 m/s")  # fmt: skip
def test_glonass_almanac_of_the_icd(oracles: dict[str, Any], within: Within) -> None:
    """The ICD's worked example, 25 500 km out at 4 km/s."""
    o = oracles["glonass_icd_almanac"]
    day = (datetime.date.fromisoformat(o["date_NA"]) - datetime.date(1970, 1, 1)).days

    def one(value: float) -> np.ndarray:
        return np.array([value])

    almanac = GlonassAlmanac(
        slot=one(1),
        healthy=np.array([True]),
        day=one(day),
        node_time=one(o["t_lambda_s"]),
        node_longitude=one(o["lambda_semicircles"] * o["pi"]),
        inclination=one(np.radians(o["i_mean_deg"]) + o["delta_i_semicircles"] * o["pi"]),
        perigee=one(o["omega_semicircles"] * o["pi"]),
        eccentricity=one(o["ecc"]),
        period=one(o["T_mean_s"] + o["delta_T_s"]),
        period_rate=one(o["delta_T_dot"]),
        channel=np.zeros(1, dtype=int),
    )
    moscow = (day + 1) * 86400.0 + 51300.0
    position, velocity = almanac.state(timescales.gps_from_utc(one(moscow - 3 * 3600.0)))
    np.testing.assert_allclose(position[0, 0], o["expect_pos_m"], rtol=0.0, atol=within["position"])
    np.testing.assert_allclose(velocity[0, 0], o["expect_vel_mps"], rtol=0.0, atol=within["velocity"])


@pytest.mark.parametrize("real", [True, False])
def test_velocity_is_the_derivative_of_position(real: bool, request: pytest.FixtureRequest) -> None:
    constellation: Any = Glonass24Slots()
    if real:
        path = request.getfixturevalue("shared") / "data/almanacs/MCCJ_180913.agl"
        (constellation,) = read_almanac(path, 0.0).constellations
    t = timescales.gps_from_utc(np.array([1536840000.0, 1536843333.0]))
    _, velocity = constellation.state(t)
    ahead, behind = (constellation.state(t + d)[0] for d in (0.5, -0.5))
    # the ICD's velocity leaves out the secular and short-period rates, 2e-5 of the speed
    np.testing.assert_allclose(ahead - behind, velocity, atol=0.2)


@pytest.mark.validates("Nominal GLONASS constellation: radius, inclination, planes and slots", "GLONASS ICD 3.3.2",
                       planes="1e-9 deg", slots="1e-6 deg")  # fmt: skip
def test_nominal_constellation_is_that_of_the_icd(within: Within) -> None:
    """Radius, inclination, three planes 120 degrees apart, eight places 45 degrees apart, shifted by 15."""
    t = timescales.gps_from_utc(np.array([1536840000.0]))
    position, velocity = Glonass24Slots().state(t)
    p = position[0]
    # seen from axes that turn with the planes: the Earth's rate, and the secular regression of the nodes
    mean_motion = np.sqrt(398600.4418e9 / 25_508_000.0**3)
    regression = -1.5 * 1082.62575e-6 * mean_motion * (6_378_136.0 / 25_508_000.0) ** 2 * np.cos(np.radians(64.8))
    v = velocity[0] + (7.292115e-5 - regression) * np.stack([-p[:, 1], p[:, 0], 0 * p[:, 0]], axis=1)
    np.testing.assert_allclose(np.linalg.norm(p, axis=1), 25_508_000.0, rtol=1e-12)
    normal = np.cross(p, v)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(np.degrees(np.arccos(normal[:, 2])), 64.8, rtol=0.0, atol=within["planes"])
    node = np.degrees(np.arctan2(normal[:, 0], -normal[:, 1]))
    ascending = np.stack([np.cos(np.radians(node)), np.sin(np.radians(node)), 0 * node], axis=1)
    u = np.degrees(np.arctan2(np.sum(np.cross(ascending, p) * normal, axis=1), np.sum(ascending * p, axis=1)))
    for slot in range(24):
        plane, place = divmod(slot, 8)
        assert (node[slot] - node[0] - 120 * plane + 180) % 360 - 180 == pytest.approx(0.0, abs=within["planes"])
        assert (u[slot] - u[0] - 15 * plane + 45 * place + 180) % 360 - 180 == pytest.approx(0.0, abs=within["slots"])


@pytest.mark.validates("Directions of nominal GLONASS satellites, against the real ones of 2018-09-13",
                       "real almanac MCCJ_180913.agl", median_satellite="4 deg", each_satellite="15 deg")  # fmt: skip
def test_nominal_is_near_the_real_constellation(shared: Path, within: Within) -> None:
    """On the day its phase was taken from, each slot as seen from the Earth's centre."""
    (almanac,) = read_almanac(shared / "data/almanacs/MCCJ_180913.agl", 0.0).constellations
    t = timescales.gps_from_utc(np.array([1536840000.0]))
    real, nominal = almanac.state(t)[0][0], Glonass24Slots().state(t)[0][0]
    angle = np.degrees(np.arccos(np.sum(real * nominal, axis=1) / np.linalg.norm(real, axis=1) / 25_508_000.0))
    assert np.median(angle) < within["median_satellite"]
    assert angle.max() < within["each_satellite"]


ALMANAC = "sky.almanac={}/data/almanacs/MCCJ_180913.agl"


@pytest.mark.validates("Visible GLONASS satellites and their DOPs, 56N 37E, 2018-09-13 12:00 UTC",
                       "independent script", DOPs="0.02")  # fmt: skip
def test_published_figure_at_56n_37e(shared: Path, within: Within) -> None:
    """Figures of a second program, by the almanac of the day."""
    flown = case(
        ALMANAC.format(shared),
        "sky.source=almanac",
        "pseudolites.count=0",
        "receiver.rate_hz=10",
        "duration_s=0.2",
    )
    assert flown.shared.signals.used[0].sum() == 9
    np.testing.assert_allclose(flown.shared.dop[0], [1.69, 1.51, 0.97, 1.16, 0.75], rtol=0.0, atol=within["DOPs"])


def test_sky_of_row_one(shared: Path) -> None:
    """A real sky, its upper part jammed, has row 1 of Table 2 at touchdown.

    The sky is fitted to it, so this validates nothing. Told in `docs/table2.md`. R19 stands at 45.87 degrees
    there and must be lost for the printed figures; with a limit of 46.0 PDOP is 3.41.
    """
    common = (
        ALMANAC.format(shared), "sky.source=almanac", "epoch=2018-09-15T01:05:59.9Z", "pseudolites.count=0",
        "approach.start=~", "runway.threshold={lat_deg: 56.0157, lon_deg: 37}", "approach.start_height_m=1",
        "duration_s=0.1",
    )  # fmt: skip
    below = case(*common, "sky.mask_upper_deg=45.8").shared
    np.testing.assert_allclose(below.dop[0, 1:4], [3.67, 1.33, 3.42], rtol=0.0, atol=0.005)
    exact = case(*common, "sky.mask_upper_deg=46").shared
    r19 = exact.signals.names.index("R19")
    assert exact.signals.used[0, r19]
    assert np.degrees(exact.signals.elevation[0, r19]) == pytest.approx(45.87, abs=0.01)
    assert exact.dop[0, 1] == pytest.approx(3.414, abs=0.005)


TABLE_1 = [
    (1, 50, 4000, [(56.0162, 37.0643)]),
    (1, 200, 5000, [(56.0176, 37.0804)]),
    (1, 500, 5000, [(56.0203, 37.0804)]),
    (1, 1000, 5000, [(56.0248, 37.0804)]),
    (2, 50, 4000, [(56.0162, 37.0643), (56.0153, 37.0643)]),
    (2, 200, 5000, [(56.0176, 37.0804), (56.0140, 37.0804)]),
    (2, 1000, 5000, [(56.0248, 37.0804), (56.0068, 37.0804)]),
]


@pytest.mark.validates("Coordinates of Table 1 of the landing paper", "the landing paper", "all four decimals")
@pytest.mark.parametrize(("count", "s", "l1", "published"), TABLE_1)
def test_table_1(count: int, s: float, l1: float, published: list[tuple[float, float]]) -> None:
    """The ten published coordinates from S and L1, to all four decimals."""
    flown = scenario(f"pseudolites.count={count}", f"pseudolites.s_m={s}", f"pseudolites.l1_m={l1}")
    computed = np.degrees(flown.pseudolite_positions(flown.trajectory().frame)[:, :2])
    assert [tuple(np.round(row, 4)) for row in computed] == published
    assert np.all(flown.pseudolite_positions(flown.trajectory().frame)[:, 2] == 0.0)


def test_runway_frame() -> None:
    """s across, positive right; l1 before the threshold; seen along the landing direction."""
    from navsim.geodesy.earth import ecef_from_llh, heading_axes

    flown = scenario("pseudolites.s_m=300", "pseudolites.l1_m=2000", name="landing_smooth")
    frame = flown.trajectory().frame
    threshold = flown.threshold(frame)
    offset = ecef_from_llh(flown.pseudolite_positions(frame)) - ecef_from_llh(threshold)
    ahead, right, down = (offset @ heading_axes(threshold, np.radians(30.0))).T
    np.testing.assert_allclose(ahead, -2000.0, atol=0.01)
    np.testing.assert_allclose(right, [300.0, -300.0], atol=0.01)
    # they stand on the ground, which falls off the tangent plane
    np.testing.assert_allclose(down, (2000.0**2 + 300.0**2) / (2 * 6.39e6), rtol=0.01)
