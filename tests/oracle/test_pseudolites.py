"""Pseudolites by the numbers of `data/pseudolites.json`: links, who is lost near them, pulses, antennas that bank."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from navsim.geodesy.attitude import dcm_from_rpy
from navsim.geodesy.earth import ecef_from_llh, ned_matrix
from navsim.gnss import dll
from navsim.gnss.antenna import GroundPattern
from navsim.gnss.interference import propagation
from navsim.gnss.signals import build_signals
from navsim.gnss.sky import enu_matrix, unit_vector
from navsim.scenario.signals import AntennaSection
from navsim.trajectory.kinematics import Motion
from tests.conftest import DATA, Within
from tests.helpers import case

L1 = 1575.42e6
RATE = 1.023e6
MATCHED = 1.0 / (1.5 * RATE)
LEVEL = np.radians([56.0, 37.0])


def oracle(name: str) -> dict[str, Any]:
    return json.loads((DATA / "pseudolites.json").read_text())[name]


def standing(llh: np.ndarray, c_nb: np.ndarray) -> Motion:
    """An aircraft at places (n, 3), a second apart, that does not move; c_nb: (n, 3, 3)."""
    still = np.zeros((len(llh), 3))
    c_eb = np.swapaxes(ned_matrix(llh), 1, 2) @ c_nb
    return Motion(np.arange(float(len(llh))), ecef_from_llh(llh), still, llh, c_eb, still, still)


@pytest.mark.validates("Free-space loss", "Friis, independent script", level="6e-3 dB")
def test_free_space(within: Within) -> None:
    for distance, loss, eirp in oracle("free_space_and_eirp")["rows"]:
        found = float(propagation.path_loss(np.array(float(distance)), L1))
        assert found == pytest.approx(loss, abs=within["level"])
        assert found - 130.0 == pytest.approx(eirp, abs=within["level"])


@pytest.mark.validates("C/N0 near a pseudolite, and the tolerable J/S", "matched spectra, independent script",
                       level="2e-3 dB")  # fmt: skip
def test_near_far(within: Within) -> None:
    given = oracle("near_far")

    def left_of(js: np.ndarray) -> np.ndarray:
        return propagation.jammed(np.full((js.size, 1), 45.0), js[None, :, None], np.full((1, 1), MATCHED))[:, 0]

    np.testing.assert_allclose(
        left_of(np.array(given["cn0_45"]["js_db"], float)), given["cn0_45"]["cn0_eff"], atol=within["level"]
    )
    for least in (28, 30):
        found = brentq(lambda js, least=least: left_of(np.array([js]))[0] - least, 0.0, 80.0)
        assert found == pytest.approx(given[f"js_limit_45_to_{least}"], abs=within["level"])


@pytest.mark.validates("Distance within which a pseudolite costs satellites", "closed form, independent script",
                       radius="0.5 m")  # fmt: skip
def test_radius_of_loss(within: Within) -> None:
    """Over a pseudolite that is received with -130 dBm in 10 km, a satellite with -128.5 dBm overhead: by noise alone,
    and by the lines of its code at whole kHz of Doppler."""
    given = oracle("near_far")["example"]
    eirp = given["pl_dbm_at_10km"] + float(propagation.path_loss(np.array(1e4), L1))
    noise_figure = given["satellite_dbm"] - 30.0 - 45.0 - propagation.noise_density(290.0)
    height = np.arange(1500.0, 50.0, -0.05)
    lock = {"lose_db_hz": 28.0, "lose_s": 0.0, "regain_db_hz": 28.0, "regain_s": 0.0}
    for near_far, wanted in (
        ({"lines": False}, given["radius_noise_m"]),
        ({"isolation_db": -oracle("ca_cross_correlation")["worst_db"][2]}, given["radius_isolation_21.08_m"]),
    ):
        sources = case(
            "sky={source: directions, directions: [{azimuth_deg: 0, elevation_deg: 89, clock: gps}]}",
            f"pseudolites={{frame: runway, clock: gps, count: 1, s_m: 300, l1_m: 0, eirp_dbm: {eirp}}}",
            "signals.tracking.gain_horizon_db=0", f"receiver.noise_figure_db={noise_figure}",
            f"interference={json.dumps({'pseudolites': near_far, 'lock': lock})}",
        ).environment  # fmt: skip
        over = np.repeat(sources.pseudolites.llh, height.size, axis=0) + np.outer(height, [0.0, 0.0, 1.0])
        signals = build_signals(standing(over, np.broadcast_to(np.eye(3), (height.size, 3, 3))), 1.6e9, sources)
        assert signals.used[:, 1].all()
        (last,) = np.flatnonzero(np.diff(signals.used[:, 0].astype(int)))  # lost for good on the way down
        assert height[last] == pytest.approx(wanted, abs=within["radius"])
        js = eirp - propagation.path_loss(height, L1) - given["satellite_dbm"]
        np.testing.assert_allclose(signals.js[0, :, 0], js, atol=1e-6)


@pytest.mark.validates("Loss of satellite and pseudolite signals by pulses", "closed form, independent script",
                       level="1e-3 dB")  # fmt: skip
def test_pulsing(within: Within) -> None:
    given = oracle("pulsing")
    one = given["duty_1_11"]
    duty = np.array([1.0, 1.0]) / 11.0
    assert -propagation.blanked_loss(duty[:1]) == pytest.approx(one["satellite_loss_db"], abs=within["level"])
    assert -propagation.blanked_loss(duty) == pytest.approx(
        given["two_duty_1_11_satellite_loss_db"], abs=within["level"]
    )
    assert -propagation.gated_loss(duty[0]) == pytest.approx(one["pl_gated_db"], abs=within["level"])
    assert -propagation.ungated_loss(duty[0]) == pytest.approx(one["pl_ungated_db"], abs=within["level"])


@pytest.mark.validates("Elevation seen by a banked antenna", "closed form, independent script", angle="1e-6 deg")
def test_banked_antenna(within: Within) -> None:
    """Heading north, a source due east 2 degrees below the horizon."""
    given = oracle("banked_antenna")
    llh = np.array([[*LEVEL, 100.0]] * 2)
    motion = standing(llh, dcm_from_rpy(np.radians([[30.0, 0.0, 0.0], [-30.0, 0.0, 0.0]])))
    east = unit_vector(np.array(np.radians(90.0)), np.array(np.radians(-2.0)))
    towards = np.einsum("nji,j->ni", enu_matrix(llh), east)[:, None]
    for mount, sign in (("top", 1.0), ("belly", -1.0)):
        found = np.degrees(AntennaSection(mount=mount).model().elevation_of(motion.c_eb, towards))[:, 0]
        wanted = sign * np.array([given["right_bank_30_top"], given["left_bank_30_top"]])
        np.testing.assert_allclose(found, wanted, atol=within["angle"])


def test_a_bank_shadows_what_is_on_the_other_side() -> None:
    """The same in the simulator of signals: gains of the table, and nothing below its mask."""
    sources = case(
        "sky={source: directions, mask_deg: 0, directions: [{azimuth_deg: 90, elevation_deg: 10, clock: gps},"
        "{azimuth_deg: 270, elevation_deg: 10, clock: gps}, {azimuth_deg: 0, elevation_deg: 90, clock: gps}]}",
        "receiver.antenna={elevation_deg: [-90, 0, 90], gain_dbi: [-20, -5, 3], mask_deg: -15}",
        "pseudolites={frame: runway, clock: gps, count: 1, s_m: 3000, l1_m: 0, eirp_dbm: 10}",
    ).environment
    place = sources.pseudolites.llh[0] + np.array([0.0, 0.0, 0.0])
    place[1] -= 3000.0 / 6378137.0 / np.cos(place[0])  # the pseudolite is due east
    llh = np.array([place + np.array([0.0, 0.0, 50.0])] * 2)
    motion = standing(llh, dcm_from_rpy(np.radians([[30.0, 0.0, 0.0], [-30.0, 0.0, 0.0]])))
    s = build_signals(motion, 1.6e9, sources)
    np.testing.assert_array_equal(s.used, [[True, False, True, True], [False, True, True, False]])
    table = np.interp([40.0, 90.0 - 30.0], [-90.0, 0.0, 90.0], [-20.0, -5.0, 3.0])
    np.testing.assert_allclose([s.cn0[0, 0], s.cn0[0, 2]], 45.0 + table - 3.0, atol=1e-6)
    away = s.position[0, 3] - s.antenna[0]
    below = np.degrees(np.arcsin(enu_matrix(llh[0])[2] @ away / np.linalg.norm(away)))
    gain = np.interp(below + 30.0, [-90.0, 0.0, 90.0], [-20.0, -5.0, 3.0])  # abeam, so that angles add up
    loss = 20.0 * np.log10(4.0 * np.pi * np.linalg.norm(away) * L1 / 299792458.0)
    wanted = 10.0 - 30.0 + gain - loss - 10.0 * np.log10(1.380649e-23 * 290.0)
    assert s.cn0[0, 3] == pytest.approx(wanted, abs=2e-3)


def test_a_pattern_of_the_ground_goes_all_around() -> None:
    """Straight between its azimuths, also through north, and between elevations; one azimuth is all of them."""
    azimuth, elevation = np.radians([10.0, 90.0, 300.0]), np.radians([-10.0, 20.0])
    pattern = GroundPattern(azimuth, elevation, np.array([[0.0, 6.0], [-3.0, 3.0], [-12.0, 0.0]]))
    for (az, el), wanted in (
        ((10.0, 20.0), 6.0), ((50.0, -10.0), -1.5), ((90.0, 5.0), 0.0), ((335.0, -10.0), -6.0), ((0.0, -40.0), -12 / 7),
        ((300.0, 80.0), 0.0), ((9.999999, 20.0), 6.0), ((195.0, 20.0), 1.5),
    ):  # fmt: skip
        found = pattern.gain_at(np.radians(np.array([az])), np.radians(np.array([el])))
        assert found.item() == pytest.approx(wanted, abs=1e-6), (az, el)
    one = replace(pattern, azimuth=azimuth[:1], gain=pattern.gain[:1])
    np.testing.assert_allclose(one.gain_at(np.radians(np.array([77.0])), np.radians(np.array([5.0]))), 3.0)


@pytest.mark.validates("Reflection coefficients of the ground", "independent script", coefficient="6e-5")
def test_reflection_coefficients_of_ground(within: Within) -> None:
    """Of linear polarisations, and of circular the parts of the same sense and of the other."""
    for _, permittivity, conductivity, grazing, *sizes in oracle("fresnel")["rows"]:
        v, h = dll.fresnel(permittivity, conductivity, 299792458.0 / L1, np.radians(np.array(grazing)))
        np.testing.assert_allclose(np.abs([h, v, 0.5 * (h + v), 0.5 * (h - v)]), sizes, atol=within["coefficient"])


@pytest.mark.validates("Path difference and level of a ray reflected by flat ground",
                       "closed form, independent script", length="6e-7 m", level="6e-4 dB")  # fmt: skip
def test_two_rays(within: Within) -> None:
    """Of ground that conducts as a metal does, which turns a horizontal wave over."""
    metal = dll.GroundReflection(0.0, 1.0, 1e14, 0.0, "horizontal")
    for transmitter, receiver, across, excess, field in oracle("two_ray")["rows"]:
        ray = dll.reflection(metal, L1, np.array(float(receiver)), transmitter, np.array(float(across)))
        assert float(ray[1]) == pytest.approx(excess, abs=within["length"])
        assert float(dll.fade(ray[0], ray[2])) == pytest.approx(field, abs=within["level"])


@pytest.mark.validates("Code error by a reflection with little delay", "closed form, independent script",
                       length="1e-5 m")  # fmt: skip
def test_code_error_of_a_short_excess(within: Within) -> None:
    given = oracle("short_delay_code_multipath")
    for phase, wanted in ((0.0, given["phi_0"]), (np.pi, given["phi_pi"])):
        size, excess = np.array([given["a"]]), np.array([given["delta_m"]])
        found = dll.multipath_error(0.5, 299792458.0 / RATE, size, excess, np.array([phase]))
        assert found.item() == pytest.approx(wanted, abs=within["length"])


def test_one_pseudolite_with_its_own_clock_changes_no_dop() -> None:
    settings = ("sky.source=nominal", "pseudolites.frame=runway", "receiver.rate_hz=1")
    alone = case(*settings, "pseudolites.count=0").shared.dop
    beside = case(*settings, "pseudolites.count=1", "pseudolites.clock=own").shared
    assert beside.signals.used[:, -1].all()
    np.testing.assert_allclose(beside.dop[:, 1:4], alone[:, 1:4], rtol=0, atol=1e-12)


@pytest.mark.parametrize(("frame", "nearest", "strongest"), [("table1", 5014.9, 4.97), ("runway", 3264.6, 8.70)])
def test_sites_of_the_main_job_are_far_enough(frame: str, nearest: float, strongest: float) -> None:
    """docs/how-to/pseudolite.md: -13.6 dBm, 0 dBi, satellites of 45 dB-Hz."""
    s = case(
        "sky.source=nominal-gps", f"pseudolites.frame={frame}", "pseudolites.eirp_dbm=-13.6",
        "signals.tracking.gain_horizon_db=0", "interference={pseudolites: {isolation_db: 21.1}}",
    ).shared.signals  # fmt: skip
    distance = np.linalg.norm(s.position[:, -2:] - s.antenna[:, None], axis=2)
    assert distance.min() == pytest.approx(nearest, abs=0.1)
    assert np.nanmax(s.js[:, :, :-2]) == pytest.approx(strongest, abs=0.01)
