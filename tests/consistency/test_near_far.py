"""Pseudolites that jam, ridges that hide jammers, bands of the front end and slow sweeps beside a landing: what is left
of each signal by plain formulas."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import quad

from navsim.geodesy.earth import ecef_from_llh, ned_matrix
from navsim.gnss.constellations.constellation import carriers
from navsim.landing.study import Case, covariance_analysis, covariance_result
from navsim.optimization import problem as objective
from navsim.optimization.scenario import Optimize
from navsim.published_tables import integrity_table
from navsim.results.result import read as read_result
from navsim.scenario.load import read_study, resolved_yaml
from navsim.scenario_files.source import InputError
from tests.conftest import DATA
from tests.helpers import SCENARIOS, case, scenario
from tests.layout import as_declared
from tests.product.test_run import navsim

BRIEF = ("duration_s=30", "receiver.rate_hz=10", "filter.kind=eskf", "sky.source=nominal-gps")
STRENGTH = ("pseudolites.cn0_reference_m=1000",)
NEVER_LOST = {"lose_db_hz": 0.0, "regain_db_hz": 0.0}
RATE = 1.023e6
MATCHED = 2.0 / (3.0 * RATE)
LIGHT = 299792458.0
PLACE = {"lat_deg": 56.03, "lon_deg": 37.02}
TONE: dict[str, Any] = {"name": "J1", "place": PLACE, "height_m": 10, "eirp_dbw": 0, "waveform": "tone"}


def with_interference(*settings: str, **section: Any) -> Case:
    return case(*BRIEF, *STRENGTH, f"interference={json.dumps(section)}", *settings)


def alone(c: Case) -> tuple[np.ndarray, np.ndarray]:
    """Carrier to noise density ratios of pseudolites without anybody else, 45 dB-Hz at 1 km, dB-Hz (e, 2), and which of
    the sources are satellites that are always used (s,)."""
    s = c.shared.signals
    strength = 45.0 + 20.0 * np.log10(1000.0 / np.linalg.norm(s.position[:, -2:] - s.antenna[:, None], axis=2))
    always = case(*BRIEF).shared.signals.used.all(axis=0)
    always[-2:] = False
    return strength, always


def ratio(decibels: np.ndarray | float) -> np.ndarray:
    return 10.0 ** (np.asarray(decibels) / 10.0)


def test_continuous_pseudolites_are_noise_to_all_others() -> None:
    """Satellites of GPS have both, each pseudolite the other; matched spectra take in 2 / (3 R)."""
    c = with_interference(pseudolites={"lines": False}, lock=NEVER_LOST)
    s, (strength, sky) = c.shared.signals, alone(c)
    expected = 1.0 / (ratio(-45.0) + ratio(strength - 45.0).sum(axis=1) * MATCHED)
    np.testing.assert_allclose(ratio(s.cn0[:, sky]), np.broadcast_to(expected[:, None], s.cn0[:, sky].shape), rtol=1e-9)
    for own, other in ((0, 1), (1, 0)):
        expected = ratio(strength[:, own]) / (1.0 + ratio(strength[:, other]) * MATCHED)
        np.testing.assert_allclose(ratio(s.cn0[:, -2 + own]), expected, rtol=1e-9)
        assert np.isneginf(s.js[own, :, -2 + own]).all()
        np.testing.assert_allclose(s.js[own, :, -2 + other], strength[:, own] - strength[:, other], atol=1e-9)
    # the loops' noise is that of what is left
    chip = LIGHT / RATE
    plain = case(*BRIEF, *STRENGTH).shared.signals

    def code(cn0: np.ndarray) -> np.ndarray:
        c_n0 = ratio(cn0)
        return chip**2 * 0.5 / (2.0 * c_n0) * (1.0 + 2.0 / (0.02 * 1.5 * c_n0))

    i = int(np.flatnonzero(sky)[0])
    more = code(s.cn0[:, i]) - code(np.full(s.time.size, 45.0))
    np.testing.assert_allclose(s.sigma[:, i] ** 2 - plain.sigma[:, i] ** 2, more, rtol=1e-6)
    assert (more > 0.0).all()


def test_a_pseudolite_in_the_band_of_glonass() -> None:
    """By the quadrature of both spectra about their carriers; one on L1 is 26 MHz away and next to nothing."""
    left = {}
    for carrier in (1602.0, 1575.42):
        c = with_interference("sky.source=nominal-glonass", f"pseudolites.carrier_mhz={carrier}", lock=NEVER_LOST,
                              pseudolites={"lines": False})  # fmt: skip
        left[carrier] = c.shared.signals.cn0
    s, (strength, _) = c.shared.signals, alone(c)
    (group,) = c.environment.satellites
    i = s.names.index("R01")
    offset = float(carriers(group.constellation)[i]) - 1602e6
    assert offset == 562500.0

    def product(f: float) -> float:
        return float(np.sinc(f / RATE) ** 2 / RATE * np.sinc((f - offset) / 0.511e6) ** 2 / 0.511e6)

    edges = np.linspace(-40e6, 40e6, 161)
    kappa = sum(quad(product, a, b, epsrel=1e-10)[0] for a, b in pairwise(edges))
    expected = 1.0 / (ratio(-45.0) + ratio(strength - 45.0).sum(axis=1) * kappa)
    np.testing.assert_allclose(ratio(left[1602.0][:, i]), expected, rtol=1e-5)
    assert (45.0 - left[1602.0][:, i] > 100.0 * (45.0 - left[1575.42][:, i])).all()


@pytest.mark.parametrize("correlation", ["gated", "ungated"])
@pytest.mark.parametrize("blanking", [True, False])
def test_pulses_cost_their_share(correlation: str, blanking: bool) -> None:
    """RTCM's pulses of two: deaf satellites lose both shares, others take the pulses in; what a pseudolite loses itself
    is told by the oracle."""
    oracle = json.loads((DATA / "integrity.json").read_text())["pulsed_pseudolite"]
    section = {"pulses": {"blanking": blanking, "correlation": correlation}}
    c = with_interference(pseudolites=section, lock=NEVER_LOST)
    s, (strength, sky) = c.shared.signals, alone(c)
    duty = oracle["duty"]
    if blanking:
        wanted = np.full(s.time.size, 45.0 + 10.0 * math.log10(1.0 - 2.0 * duty))
    else:
        wanted = -10.0 * np.log10(ratio(-45.0) + duty * ratio(strength - 45.0).sum(axis=1) * MATCHED)
    np.testing.assert_allclose(s.cn0[:, sky], np.broadcast_to(wanted[:, None], s.cn0[:, sky].shape), atol=1e-9)
    beside = 0.0 if correlation == "gated" else duty * ratio(strength[:, 1]) * MATCHED
    own = strength[:, 0] + oracle[f"pseudolite_loss_{correlation}_db"] - 10.0 * np.log10(1.0 + beside)
    np.testing.assert_allclose(s.cn0[:, -2], own, atol=1e-9)


def test_one_that_is_silent_neither_jams_nor_blanks() -> None:
    silent = json.dumps([{"what": "silence", "sources": ["PL1"], "at_s": 10, "until_s": 20}])
    for section in ({"lines": False}, {"pulses": {}}):
        c, both = (
            with_interference(*more, pseudolites=section, lock=NEVER_LOST) for more in ((f"events={silent}",), ())
        )
        s, (strength, sky) = c.shared.signals, alone(c)
        on = (s.time >= 10.0) & (s.time < 20.0)
        np.testing.assert_array_equal(s.cn0[np.ix_(~on, sky)], both.shared.signals.cn0[np.ix_(~on, sky)])
        noise = ratio(-45.0) + ratio(strength[:, 1] - 45.0) * MATCHED
        wanted = (
            -10.0 * np.log10(noise) if "lines" in section else np.full(s.time.size, 45.0 + 10.0 * math.log10(10 / 11))
        )
        np.testing.assert_allclose(s.cn0[np.ix_(on, sky)], np.broadcast_to(wanted[on, None], (on.sum(), sky.sum())))


def test_lines_take_what_is_weaker_by_24_db() -> None:
    """Half a second after a pseudolite is 24 dB stronger satellites of GPS go, though noise leaves them more than 31
    dB-Hz; those of GLONASS have other codes and stay."""
    near = ("pseudolites={count: 1, s_m: 60, l1_m: 700, frame: runway, cn0_dbhz: 50, cn0_reference_m: 1000}",)
    c, noise = (
        with_interference(*near, "duration_s=60", "sky.source=nominal", pseudolites=p) for p in ({}, {"lines": False})
    )
    s = c.shared.signals
    strength = 50.0 + 20.0 * np.log10(1000.0 / np.linalg.norm(s.position[:, -1] - s.antenna, axis=1))
    above = strength - 45.0 > 23.93924554139
    first, last = np.flatnonzero(above)[[0, -1]]
    assert above[first : last + 1].all()
    assert 10 < first < last < s.time.size - 30
    gps = np.array([name.startswith("G") for name in s.names]) & noise.shared.signals.used.all(axis=0)
    assert noise.shared.signals.cn0[:, gps].min() > 31.0
    lost = np.zeros(s.time.size, bool)
    lost[first + 5 : last + 1 + 20] = True  # half a second, and two after the end
    np.testing.assert_array_equal(~s.used[:, gps], np.broadcast_to(lost[:, None], (lost.size, gps.sum())))
    np.testing.assert_array_equal(s.used[:, ~gps], noise.shared.signals.used[:, ~gps])


def test_a_ridge_hides_a_jammer_while_it_is_between() -> None:
    """A wall 300 m before the jammer, across the aircraft's way to it: Fresnel's parameter by plane geometry about the
    jammer; once the aircraft looks past its end there is nothing."""
    start = np.array([math.radians(56.03), math.radians(37.02), 10.0])
    origin, ned = ecef_from_llh(start), ned_matrix(start)
    plain = with_interference(jammers=[TONE], lock=NEVER_LOST)
    place = (plain.shared.signals.antenna - origin) @ ned.T  # north, east, down of the jammer
    # the wall runs from west to east, 300 m south of it; what looks over it sees its top at 40 m
    north, wide, high = -300.0, 330.0, 40.0
    points = [start + np.array([north / 6.38e6, e / (6.38e6 * math.cos(start[0])), 0.0]) for e in (-wide, 0.0)]
    ends = [{"lat_deg": math.degrees(p[0]), "lon_deg": math.degrees(p[1])} for p in points]
    c = with_interference(jammers=[TONE], horizon=[{"ends": ends, "height_m": high}], lock=NEVER_LOST)
    loss = (plain.shared.signals.js - c.shared.signals.js)[0][:, plain.shared.signals.used.all(axis=0)]
    assert np.ptp(loss, axis=1).max() < 1e-9
    share = north / place[:, 0]
    behind = (share * place[:, 1] > -wide + 3.0) & (share * place[:, 1] < -3.0)
    beside = (share * place[:, 1] < -wide - 3.0) | (share * place[:, 1] > 3.0)
    distance = np.linalg.norm(place, axis=1)
    d1, d2 = share * distance, (1.0 - share) * distance
    above = (high - 10.0) + share * place[:, 2]
    across = np.cross(place, [0.0, 1.0, 0.0])
    above *= np.abs(across[:, 2]) / np.linalg.norm(across, axis=1)
    nu = above * np.sqrt(2.0 * distance / (LIGHT / 1575.42e6 * d1 * d2))
    expected = 6.9 + 20.0 * np.log10(np.sqrt((nu - 0.1) ** 2 + 1.0) + nu - 0.1)
    assert behind.any()
    np.testing.assert_allclose(loss[behind, 0], expected[behind], atol=0.2)
    assert loss[behind].min() > 20.0
    assert not loss[beside].any()


def test_a_skyline_all_around_hides_from_low_aircraft_alone() -> None:
    """Seen from the threshold 5 degrees high, 800 m away; what stands within it is not hidden."""
    around = [{"azimuth_deg": [0, 360], "elevation_deg": 5, "distance_m": 800}]
    inside = TONE | {"name": "J2", "place": {"lat_deg": 56.017, "lon_deg": 37.0}}
    outcomes = []
    for horizon in ([], around):
        c = with_interference("duration_s=60", jammers=[TONE, inside], horizon=horizon, lock=NEVER_LOST)
        outcomes.append(c.shared.signals.js[:, :, alone(c)[1]][..., 0])
    loss = outcomes[0] - outcomes[1]
    assert loss[0, -20:].min() > 15.0  # on the last metres before touchdown, 1.9 km from the jammer
    assert not loss[1, -20:].any()


def test_the_front_end_passes_its_bands() -> None:
    """Noise between both bands is not felt, of noise at the edge what is inside; carriers outside are not received."""
    bands = [[1565.0, 1586.0], [1592.0, 1612.0]]
    noise = TONE | {"waveform": "noise", "bandwidth_mhz": 4.0}
    between, edge = noise | {"centre_mhz": 1589.0}, noise | {"centre_mhz": 1586.0, "name": "J2"}
    strong = {"eirp_dbw": 40}
    free = with_interference(jammers=[between | strong], lock=NEVER_LOST)
    c = with_interference(jammers=[between | strong], front_end_mhz=bands, lock=NEVER_LOST)
    used = alone(c)[1]
    np.testing.assert_allclose(c.shared.signals.cn0[:, used], 45.0, atol=1e-12)
    assert free.shared.signals.cn0[:, used].max() < 44.9
    c = with_interference(jammers=[edge | strong], front_end_mhz=bands, lock=NEVER_LOST)
    s, i = c.shared.signals, int(np.flatnonzero(used)[0])
    inside = (
        quad(lambda f: np.sinc((f - 1575.42e6) / RATE) ** 2 / RATE, 1584e6, 1586e6, epsrel=1e-10, limit=200)[0] / 4e6
    )
    expected = 1.0 / (ratio(-45.0) + ratio(s.js[0, :, i]) * inside)
    np.testing.assert_allclose(ratio(s.cn0[:, i]), expected, rtol=1e-6)
    assert not [text for text in c.warnings if "front_end" in text]
    lone = with_interference("sky.source=nominal", jammers=[edge], front_end_mhz=bands[1:])
    s = lone.shared.signals
    glonass = np.array([name.startswith("R") for name in s.names])
    assert s.used[:, glonass].any()
    assert not s.used[:, ~glonass].any()
    (text,) = [text for text in lone.warnings if "front_end" in text]
    assert text.startswith("interference.front_end_mhz: no band has the carriers of G01, ")
    assert text.endswith("PL1, PL2: they are not received")


def test_a_slow_sweep_comes_and_goes() -> None:
    """20 MHz in 10 s from 1565 MHz on: on L1 at 5.2 s; a receiver remembers half a second, so a sweep in less is the
    mean, and over a period each has the mean of a fast one."""
    sweep = TONE | {"waveform": "sweep", "centre_mhz": 1575.0, "bandwidth_mhz": 20.0}
    slow, quick, mean = (
        with_interference(jammers=[sweep | more], lock=NEVER_LOST)
        for more in ({"sweep_s": 10.0}, {"sweep_s": 1e-3}, {})
    )
    used = mean.shared.signals.used.all(axis=0)
    noise = [1.0 / ratio(c.shared.signals.cn0[:, used][:, 0]) - ratio(-45.0) for c in (slow, quick, mean)]
    np.testing.assert_allclose(noise[1], noise[2], rtol=5e-3)
    js = ratio(slow.shared.signals.js[0][:, used][:, 0])
    kappa, time = noise[0] / js, slow.shared.signals.time
    at = 1565e6 + 2e6 * (time[:, None] - np.linspace(0.5, 0.0, 2001)[None, :-1] + 0.000125)
    at = 1565e6 + (at - 1565e6) % 20e6
    tones = np.mean(np.sinc((at - 1575.42e6) / RATE) ** 2 / RATE, axis=1)
    np.testing.assert_allclose(kappa, tones, rtol=1e-3, atol=1e-12)
    assert time[np.argmax(kappa[:100])] == pytest.approx(5.46, abs=0.2)
    period = (time > 10.0 + 1e-9) & (time <= 20.0 + 1e-9)
    assert kappa[period].mean() == pytest.approx((noise[2] / js).mean(), rel=1e-3)
    assert kappa.max() > 15.0 * kappa.mean()


def test_the_result_has_pseudolites_among_the_jammers(tmp_path: Path) -> None:
    section = {"jammers": [TONE], "pseudolites": {"pulses": {"duty": 0.2}}}
    words = [*BRIEF, *STRENGTH, f"interference={json.dumps(section)}", "method=covariance"]
    settings = [part for word in words for part in ("--set", word)]
    navsim("run", SCENARIOS / "landing.yaml", *settings, "--figures", "all", "-q", "-o", "r.h5", cwd=tmp_path)
    result = read_result(tmp_path / "r.h5")
    as_declared(result)
    assert list(result["/interference/jammer"]) == ["J1", "PL1", "PL2"]
    assert result["/interference/js"].shape[0] == 3
    again = yaml.safe_load(result.attributes["scenario"])["interference"]
    assert again["pseudolites"]["pulses"] == {"duty": 0.2, "blanking": True, "correlation": "gated"}


def test_what_is_resolved_reads_again(tmp_path: Path) -> None:
    horizon = [{"ends": [PLACE, {"lat_deg": 56.04, "lon_deg": 37.0}], "height_m": 30},
               {"azimuth_deg": [350, 10], "elevation_deg": 2, "distance_m": 900}]  # fmt: skip
    for pseudolites in ({}, {"lines": False}, {"pulses": {}}):
        section = {"jammers": [TONE], "pseudolites": pseudolites, "horizon": horizon, "front_end_mhz": [[1560, 1620]]}
        one = scenario(*STRENGTH, f"interference={json.dumps(section)}")
        (tmp_path / "again.yaml").write_text(resolved_yaml(one))
        assert scenario(name=str(tmp_path / "again")) == one


RIDGE = {"ends": [PLACE, {"lat_deg": 56.04, "lon_deg": 37.0}], "height_m": 30}


@pytest.mark.parametrize(
    ("section", "settings", "says"),
    [
        ({}, (), "interference.jammers: no jammer"),
        ({"pseudolites": {}}, (), "interference.pseudolites: how strong they are falls with distance: give "),
        ({"pseudolites": {"pulses": {"duty": 0.5}}}, STRENGTH, "duty: 2 pseudolites cannot take turns"),
        ({"pseudolites": {"pulses": {}, "lines": True}}, STRENGTH, "pseudolites.lines: are of whole codes"),
        ({"pseudolites": {"pulses": {"correlation": "gate"}}}, STRENGTH, "did you mean 'gated'?"),
        ({"pseudolites": {"pulse": {}}}, STRENGTH, "did you mean 'pulses'?"),
        ({"jammers": [TONE | {"name": "PL2"}]}, (), "'PL2' is also the name of a pseudolite"),
        ({"jammers": [TONE | {"sweep_s": 1}]}, (), "jammers.0.sweep_s: is for `waveform: sweep`, not for `tone`"),
        ({"pseudolites": {}, "horizon": [RIDGE]}, STRENGTH, "interference.horizon: hides jammers, and there are none"),
        ({"jammers": [TONE], "horizon": [{"height_m": 3}]}, (), "horizon.0: give either ends and height_m"),
        ({"jammers": [TONE], "horizon": [RIDGE | {"distance_m": 9}]}, (), "interference.horizon.0: give either ends"),
        ({"jammers": [TONE], "horizon": [RIDGE | {"ends": [PLACE, PLACE]}]}, (), "0.ends: a ridge needs two positions"),
        ({"jammers": [TONE], "horizon": [{"azimuth_deg": [9, 9], "elevation_deg": 2, "distance_m": 9}]}, (),
         "horizon.0.azimuth_deg: a skyline needs two azimuths"),
        ({"jammers": [TONE], "front_end_mhz": [[1580, 1570]]}, (), "front_end_mhz.0: the lower end comes first"),
        ({"jammers": [TONE], "front_end_mhz": [[1560, 1580], [1580, 1610]]}, (), "front_end_mhz.1: overlaps another"),
    ],
)  # fmt: skip
def test_interference_that_cannot_be(section: dict[str, Any], settings: tuple[str, ...], says: str) -> None:
    with pytest.raises(InputError) as error:
        scenario(*settings, f"interference={json.dumps(section)}")
    assert says in str(error.value)


def test_placements_by_strength(tmp_path: Path) -> None:
    """Of pseudolites that jam, an error of the filter is that of the landing; directions alone cannot judge them, and
    more than can take turns are refused."""

    def study(text: str, **section: Any) -> objective.PlacementProblem:
        given = {"duration_s": 62.3, "receiver.rate_hz": 1.0, "imu.rate_hz": 10.0, "interference": section,
                 "sky.source": "nominal-gps",
                 "pseudolites": {"frame": "runway", "cn0_reference_m": 300.0, "count": 0}}  # fmt: skip
        path = tmp_path / "study.yaml"
        path.write_text(f"kind: optimize\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\nset: {json.dumps(given)}\n"
                        f"area: {{s_m: [-900, 900], l1_m: [0, 5000]}}\n{text}")  # fmt: skip
        return objective.problem(*read_study(path, Optimize, []))

    with pytest.raises(InputError, match=r"directions alone, .* by pseudolites\.cn0_reference_m, interference\."):
        study("objective: pdop\npseudolites: [2]\n", pseudolites={})
    with pytest.raises(InputError, match=r"pseudolites: 5 pseudolites cannot take turns"):
        study("objective: lateral_touchdown\npseudolites: [1, 5]\n", pseudolites={"pulses": {"duty": 0.2}})
    here = study("objective: lateral_touchdown\npseudolites: [2]\n", pseudolites={})
    assert [text for text in here.warnings if text.startswith("the table's DOPs ignore `interference`")]
    places = [[80.0, 300.0], [-200.0, 2500.0]]
    sites = [{"s_m": s, "l1_m": l1} for s, l1 in places]
    flown = case("duration_s=62.3", "receiver.rate_hz=1", "imu.rate_hz=10", "sky.source=nominal-gps",
                 f"pseudolites={json.dumps({'frame': 'runway', 'cn0_reference_m': 300.0, 'sites': sites})}",
                 "interference={pseudolites: {}}", "method=covariance")  # fmt: skip
    result = covariance_result(flown, covariance_analysis(flown), 1)
    from navsim.sweeps.study import filter_outputs

    expected = filter_outputs(result)["lateral_touchdown"]
    assert here.objective(np.array([places]))[0] == pytest.approx(expected, rel=1e-12)


def test_the_integrity_table_says_that_all_send() -> None:
    c = with_interference("duration_s=62", "receiver.rate_hz=1", "imu.rate_hz=20", "method=covariance", pseudolites={},
                          lock=NEVER_LOST)  # fmt: skip
    assert integrity_table._still_jamming(c) == ["pseudolites that a row leaves out send all the same, and jam"]
    assert integrity_table._still_jamming(case(*BRIEF)) == []
