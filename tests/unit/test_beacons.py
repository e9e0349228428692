"""Ranging beacons: their model by hand, its linearisation, lost answers and outliers, mirror images, messages."""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import simpson

from navsim.filter import eskf, states
from navsim.filter.measurement_kinds import BEACON, Measurements
from navsim.filter.measurement_models import observe, slot
from navsim.formats.export_maps import write_kml
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.gnss.ranging_geometry import mirror_image
from navsim.landing.beacons import beacon_geometry, second_order
from navsim.landing.case import prepare
from navsim.landing.coasting import Coasting, grid
from navsim.landing.covariance import covariance_findings
from navsim.landing.result_groups import attributes
from navsim.landing.study import covariance_analysis, covariance_result
from navsim.optimization.job import OptimizeJob
from navsim.optimization.problem import problem
from navsim.optimization.report import tables
from navsim.optimization.result import dop_warnings, masts_above_glide, optimize_result, worse_than_base
from navsim.optimization.scenario import Optimize
from navsim.optimization.study import solve
from navsim.report.table import Table
from navsim.results.notes import Note
from navsim.results.result import read
from navsim.results.schema import HEIGHTS
from navsim.runner.job import Options
from navsim.scenario import load
from navsim.scenario.load import read_study
from navsim.scenario_files.source import InputError
from navsim.sensors.beacons import Beacons
from navsim.simulation.aiding import Aid
from navsim.sweeps.scenario import FILTER_OUTPUTS
from tests.forks import navsim
from tests.helpers import SCENARIOS, case, scenario

SITES = "{s_m: 300, l1_m: 900, height_m: 20}, {name: west, s_m: -250, l1_m: 400}, {lat_deg: 56.02, lon_deg: 37.01}"
BRIEF = ("duration_s=30", "receiver.rate_hz=1", "imu.rate_hz=20")


def section(*keys: str, sites: str = SITES) -> str:
    """Section of beacons with these keys."""
    return f"beacons={{sites: [{sites}], {', '.join(('rate_hz: 6, sigma_m: 0.1, range_limit_m: 9000', *keys))}}}"


def flown(*keys: str, sites: str = SITES) -> tuple[Any, Aid, Beacons]:
    """A landing, its beacons on the flight, and their model."""
    of = case(*BRIEF, section(*keys, sites=sites))
    (aid,) = of.shared.aids
    assert isinstance(aid.sensor, Beacons)
    return of, aid, aid.sensor


def test_what_they_measure() -> None:
    """In turn, from the antenna, with the mean bias; nothing out of reach."""
    of, aid, sensor = flown("growth_m: 0.5, growth_distance_m: 400, weak_sigma_m: 0.9, lever_arm_m: [2, 1, -1]")
    motion = of.trajectory.motion(aid.time)
    llh = sensor.positions(aid.frame)
    assert np.degrees(llh[2, :2]) == pytest.approx([56.02, 37.01])
    assert llh[:, 2] - of.scenario.runway.ellipsoidal_m == pytest.approx([20.0, 0.0, 0.0])
    sites = ecef_from_llh(llh)
    for row in (0, 1, 2, 3, 100):
        lat, lon = motion.llh[row, :2]
        down = -np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
        east = np.array([-math.sin(lon), math.cos(lon), 0.0])
        axes = np.column_stack([np.cross(east, down), east, down])
        antenna = motion.position_ecef[row] + axes @ motion.c_nb[row] @ [2.0, 1.0, -1.0]
        distance = np.linalg.norm(sites[row % 3] - antenna)
        bias = 0.5 * (1.0 - math.exp(-distance / 400.0))
        assert aid.exact[row, 0] == pytest.approx(distance + bias, abs=1e-8)
        assert aid.sigma[row, 0] == pytest.approx(math.hypot(0.1, 0.9 * distance / 9000.0), rel=1e-3)


def test_out_of_reach_and_behind_a_ridge() -> None:
    """No range beyond the limit; a ridge across the approach hides those on its other side."""
    (far,) = case(*BRIEF, section()).shared.aids
    assert not np.isnan(far.exact).any()
    middle = float(np.median(far.exact))
    (aid,) = case(*BRIEF, section().replace("9000", f"{middle:.3f}")).shared.aids
    np.testing.assert_array_equal(np.isnan(aid.exact), far.exact > middle)
    ridge = "terrain=[{azimuth_deg: [150, 210], elevation_deg: 25, distance_m: 1100}]"
    of = case(*BRIEF, section(), ridge)
    (hidden,) = of.shared.aids
    away = of.trajectory.frame.origin - of.trajectory.motion(hidden.time).position_ecef
    beyond = np.linalg.norm(away, axis=1) > 1250.0
    assert beyond.any()
    assert np.isnan(hidden.exact[beyond]).all()


def test_their_linearisation() -> None:
    """Each column of H against the change of the prediction, with all errors, at an attitude far from level."""
    of, aid, _ = flown("bias_sigma_m: 1, growth_m: 2, growth_sigma_m: 1, growth_distance_m: 200, survey_sigma_m: 1, "
                       "weak_sigma_m: 5, lever_arm_m: [20, -10, 5]")  # fmt: skip
    declared = of.flight.model.declared
    assert declared.size == 6 + 3 * 5
    tables = Measurements.of({BEACON: aid.table(aid.exact)})
    rng, n = np.random.default_rng(7), states.SENSORS + declared.size
    nav = np.zeros(states.NAV_SENSORS + declared.size)
    nav[states.NAV_LLH : states.NAV_VEL] = of.trajectory.llh(np.array([20.0]))[0]
    nav[states.NAV_QUAT : states.NAV_BIAS_FRAME] = np.array([0.82, 0.27, -0.34, 0.37]) / np.linalg.norm(
        [0.82, 0.27, -0.34, 0.37]
    )
    nav[states.NAV_SENSORS + 6 :] = rng.standard_normal(15) * np.tile([1.0, 1.0, 0.0, 0.0, 0.0], 3)

    def observed(nav: np.ndarray, row: int) -> tuple[float, np.ndarray, float]:
        have, z, h, r = np.zeros(6), np.zeros(6), np.zeros((6, n)), np.zeros((6, 6))
        assert observe(BEACON, row, tables, nav, np.zeros(6), 0.01, declared, np.zeros((3, 3)), have, z, h, r) == 1
        return float(z[0]), h[0], float(r[0, 0])

    for row in range(3):
        _, h, r = observed(nav, row)
        assert r > 0.01, "the noise grows with distance"
        for c in (*range(3), *range(6, 9), *range(states.SENSORS + 6, n)):
            size = 1e-6 if states.ATT <= c < states.SENSORS else 1e-2
            sides = []
            for sign in (1.0, -1.0):
                step, moved = np.zeros(n), nav.copy()
                step[c] = sign * size
                eskf.inject(moved, step)
                sides.append(observed(moved, row)[0])
            slope = (sides[1] - sides[0]) / (2.0 * size)
            assert slope == pytest.approx(h[c], rel=1e-5, abs=1e-5), (row, c)
        own = slice(states.SENSORS + 6 + 5 * row, states.SENSORS + 6 + 5 * row + 5)
        others = np.delete(h[states.SENSORS + 6 :], np.arange(5 * row, 5 * row + 5))
        assert np.all(h[own] != 0.0)
        assert not others.any()
        assert slot(BEACON, row, tables) == slot(BEACON, row + 3, tables) != slot(BEACON, (row + 1) % 3, tables)


def test_events_of_beacons() -> None:
    """Silence, a step, a ramp and a wrong survey of some beacons at some time; `all` is of satellites."""
    _, plain, _ = flown()
    happening = (
        "events=[{what: silence, sources: [west], at_s: 5, until_s: 8}, {what: step, sources: [B1], error_m: 7, "
        "at_s: 9}, {what: ramp, sources: [beacons], rate_m_s: 0.5, at_s: 12}, {what: silence, sources: [all], "
        "at_s: 20}, {what: survey, sources: [B3], ned_m: [0, 0, 2], at_s: 14}]"
    )
    of = case(*BRIEF, section(), happening)
    (aid,) = of.shared.aids
    off, asked, t = aid.exact[:, 0] - plain.exact[:, 0], aid.sensor.transmitter_at(aid.time), aid.time
    silent = (asked == 1) & (t >= 5.0) & (t < 8.0)
    np.testing.assert_array_equal(np.isnan(off), silent)
    expected = np.where((asked == 0) & (t >= 9.0), 7.0, 0.0) + 0.5 * np.maximum(t - 12.0, 0.0)
    surveyed = (asked == 2) & (t >= 14.0)
    np.testing.assert_allclose(off[~silent & ~surveyed], expected[~silent & ~surveyed], atol=1e-7)
    away, _ = aid.sensor.line_of_sight(of.trajectory, t)
    motion = of.trajectory.motion(t)
    sine = 2.0 * np.einsum("mj,mj->m", away, ned_matrix(motion.llh)[:, 2]) / np.linalg.norm(away, axis=1)
    np.testing.assert_allclose((off - expected)[surveyed], sine[surveyed], atol=2e-3)
    assert not of.beacons.received[(of.shared.signals.time == 6.0), 1].any()
    assert not [text for text in of.warnings if "none of them is received" in text]
    # a vehicle that seems to be 2 m higher sees the beacon 2 m lower
    survey, spoof = "survey, sources: [B3], ned_m: [0, 0, 2]", "spoof, sources: [B3], offset_ned_m: [0, 0, -2]"
    moved = happening.replace(survey, spoof)
    (spoofed,) = case(*BRIEF, section(), moved).shared.aids
    np.testing.assert_allclose(spoofed.exact, aid.exact, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (["events=[{what: spoof, sources: [beacons], clock_m: 9}]"], "clock_m: two-way ranges have no clock"),
        (["events=[{what: meacon, sources: [B1], place: {lat_deg: 56, lon_deg: 37}}]"], "use spoof or step"),
        (["events=[{what: silence, sources: [B9]}]"], "'B9' is not a source"),
        ([section("carrier_mhz: 1580"), "interference={jammers: [{name: J, place: {lat_deg: 56, lon_deg: 37}, "
          "eirp_dbw: 5, waveform: noise, bandwidth_mhz: 20}]}"], "1580 MHz is in the band of J"),
        (["filter.beacons={clock: {}}"], "two-way ranges have no clock"),
        ([section("clock: {h0: 0}")], "beacons.clock.h0: a clock without noise is none"),
        ([section("clock: {}"), "method=rare", "box={lateral_m: 1}"], "method rare does not push this clock"),
        (["filter.beacons={outliers: mixture}"], "no outliers: give long_share"),
        (["filter.beacons={long_share: 0.1}"], "is for `outliers: mixture`"),
        (["filter.beacons={outliers: mixture, long_share: 0.1}"], "share and size of outliers"),
        (["filter.beacons.second_order=true", "filter.kind=rts"], "rts has no products of the position error"),
        (["filter.beacons.second_order=true", "method=covariance"], "the covariance analysis is linear"),
        (["filter.beacons.second_order=true", "integrity={method: filter}"], "integrity watches filters that are"),
        (["filter.beacons={outliers: mixture, long_share: 0.1, long_m: 1}", "integrity={method: filter}"],
         "integrity.method filter expects a filter whose gains do not depend on the ranges"),
        (["filter.beacons={outliers: mixture, long_share: 0.1, long_m: 1}",
          "integrity={method: mhss, innovations: {}}"], "integrity.innovations expects a filter"),
        (["filter.beacons={outliers: mixture, long_share: 0.5, long_m: 1, outlier_share: 0.5, outlier_sigma_m: 1}"],
         "no range would be clean"),
    ],
)  # fmt: skip
def test_what_beacons_do_not_have_is_refused(settings: list[str], text: str) -> None:
    with pytest.raises(InputError, match=re.escape(text)):
        case(*BRIEF, *([] if any(each.startswith("beacons") for each in settings) else [section()]), *settings)


def test_jammers_weaken_questions_and_answers() -> None:
    """A tone on the carrier against the budget in dB, path loss in km and MHz: noise density 1 + J / (B k T F)."""
    keys = section("weak_sigma_m: 0.5", "carrier_mhz: 868", "bandwidth_mhz: 0.5", "noise_figure_db: 5", "gain_dbi: 2")
    jammer = (
        "interference={jammers: [{name: J, place: {lat_deg: 56.006, lon_deg: 37}, eirp_dbw: -44, waveform: tone, "
        "centre_mhz: 868, on_s: [[5, 20]]}]}"
    )
    plain, jammed = case(*BRIEF, keys), case(*BRIEF, keys, jammer)
    for key in ("bandwidth_mhz", "noise_figure_db"):
        told = [any(f"beacons.{key} is not used" in text for text in one.warnings) for one in (plain, jammed)]
        assert told == [True, False]
    (without,), (aid,) = plain.shared.aids, jammed.shared.aids
    sensor, t = aid.sensor, aid.time
    (source,) = sensor.jamming.jammers
    away, _ = without.sensor.line_of_sight(plain.trajectory, t)
    antenna, distance = sensor.antenna(jammed.trajectory, t), np.linalg.norm(away, axis=1)

    def noise(at: np.ndarray) -> np.ndarray:
        km = np.linalg.norm(source.place - at, axis=1) / 1e3
        received = -44.0 + 2.0 - (32.4478 + 20.0 * np.log10(km) + 20.0 * np.log10(868.0))
        density = received - 10.0 * np.log10(0.5e6)
        return 1.0 + np.where((t >= 5.0) & (t < 20.0), 10.0 ** ((density + 203.975 - 5.0) / 10.0), 0.0)

    answer, question = noise(antenna), noise(antenna + away)
    np.testing.assert_allclose(sensor.weakened**2, 0.5 * (answer + question), rtol=1e-4)
    lost = np.sqrt(np.maximum(answer, question)) * distance > sensor.reach
    np.testing.assert_array_equal(np.isnan(aid.exact[:, 0]), lost | np.isnan(without.exact[:, 0]))
    assert 0.1 < lost.mean() < 0.5
    further = 0.5 / sensor.reach * aid.exact[:, 0] * sensor.weakened
    np.testing.assert_allclose(aid.sigma[~lost, 0], np.hypot(sensor.sigma, further)[~lost], rtol=1e-12)
    analysis = covariance_analysis(case(*BRIEF, keys, jammer, "method=covariance"))  # whose filter knows the noise
    ratio = np.einsum("tii->ti", analysis.covariance) / np.einsum("tii->ti", analysis.assumed)
    np.testing.assert_allclose(ratio, 1.0, atol=0.03)


def test_monitors_leave_beacons_out() -> None:
    said = scenario(section(), "integrity={method: mhss}").unused()
    assert any(
        text.startswith("integrity: its levels and alarms are of fixes, which beacons do not enter") for text in said
    )


def test_a_search_chooses_the_best_sites(tmp_path: Path) -> None:
    """Three of five, each with its own height, by VDOP: against every choice by dense algebra; its table and map."""
    base = tmp_path / "base.yaml"
    keys = "beacons: {sites: [{s_m: 400, l1_m: 0}], rate_hz: 4, sigma_m: 0.1, range_limit_m: 9000}"
    base.write_text(f"{(SCENARIOS / 'landing.yaml').read_text()}\n{keys}\n")
    places = [(200, 900, 0), (-200, 900, 12), (150, -300, 25), (-300, 100, 3), (90, 1800, 0)]
    sites = ", ".join(f"{{s_m: {s}, l1_m: {l1}, height_m: {h}}}" for s, l1, h in places)
    study = tmp_path / "study.yaml"
    rates = "receiver.rate_hz: 0.5, imu.rate_hz: 20"
    study.write_text(f"kind: optimize\nversion: 1\nbase: base.yaml\nset: {{{rates}}}\nbeacons: [3]\n"
                     f"objective: beacons_vdop\nsites: [{sites}]\n")  # fmt: skip
    asked, document, landing = read_study(study, Optimize, [])
    posed = problem(asked, document, landing)
    job = OptimizeJob(asked, document, Options(time_limit=300.0))
    assert job.described().startswith("beacons_vdop for 3 beacons; the search ends after 300 s at the latest")
    outcome = solve(posed, 1)
    result = optimize_result(posed, outcome, 1)
    assert posed.beacons is not None
    assert posed.study.constraints.distance_m == (30.0, 100_000.0)
    away = posed.rules.plane.ecef(np.array(places, float)) - posed.beacons.receiver[:, None]
    up = llh_from_ecef(posed.beacons.receiver)
    axes = np.stack([np.cos(up[:, 0]) * np.cos(up[:, 1]), np.cos(up[:, 0]) * np.sin(up[:, 1]), np.sin(up[:, 0])], 1)
    vdop = {}
    for chosen in itertools.combinations(range(5), 3):
        u = away[:, chosen] / np.linalg.norm(away[:, chosen], axis=2, keepdims=True)
        inverse = np.linalg.inv(np.einsum("eki,ekj->eij", u, u))
        vdop[chosen] = np.sqrt(np.einsum("ei,eij,ej->e", axes, inverse, axes)).mean()
    best = min(vdop, key=vdop.__getitem__)
    assert result["/pareto/objective"][0] == pytest.approx(vdop[best], rel=1e-9)
    found = np.stack([result[f"/optimum/{axis}"][0] for axis in ("s", "l1", "up")], axis=1)
    assert found.tolist() == [list(map(float, places[k])) for k in best]
    names = [row.cells[1] for table in tables(result) if isinstance(table, Table) for row in table.rows]
    assert {"B1", "B2", "B3"} <= set(map(str, names))
    epochs = len(posed.beacons.receiver)
    left_out = {"beacons_hdop": 25.0, "beacons_vdop": 9.0, "beacons_vdop_max": 2.0 * epochs, "beacons_vdop_p50": 7.0}
    (own,) = dop_warnings(posed, ["3 beacons"], [{name: result[f"/optimum/{name}"] for name in left_out}])
    assert own.startswith(f"3 beacons: one of {epochs} epochs gives 31 % of the mean beacons_vdop")
    warned, spoilt = dop_warnings(posed, ["3 beacons"], [{name: np.array([one]) for name, one in left_out.items()}])
    assert warned == "3 beacons: HDOP is 25 there, since beacons_vdop does not ask for it; minimise beacons_pdop_p50"
    assert spoilt.startswith(f"3 beacons: one of {epochs} epochs gives 22 % of the mean beacons_vdop: {2 * epochs}, ")
    at = llh_from_ecef(posed.rules.receiver)
    s, l1 = posed.rules.plane.places(at[epochs // 2])
    up = at[epochs // 2, 2] - posed.rules.plane.threshold[2]
    beside = np.array([[s + 30.0, l1, up + 8.0], [s + 30.0, l1, up - 8.0], [s - 90.0, l1, up + 8.0], [s, -50.0, 99.0]])
    (way,) = masts_above_glide(posed.rules, "4 beacons", beside)
    assert "strike a mast: number 1 rises 8 m above the glide, 30 m off it; keep them lower" in way
    assert masts_above_glide(posed.rules, "3 beacons", beside[1:]) == []
    (text,) = write_kml(result, tmp_path / "best").values()
    assert all(f"<name>B{k} of 3</name>" in text for k in (1, 2, 3))
    assert posed.errors is not None
    analysed = case(*rates.replace(": ", "=").split(", "), keys.replace(": ", "=", 1), "method=covariance")
    sigma = covariance_result(analysed, covariance_analysis(analysed), 1)["/summary/at/vertical"]
    assert posed.errors(None)["vertical_touchdown"] == sigma[list(HEIGHTS).index("touchdown"), 0]
    sizes = dict.fromkeys(FILTER_OUTPUTS, 1.0)
    judged = replace(posed, errors=lambda places: sizes | ({} if places is None else {"vertical_touchdown": 1.2}))
    outcome.confirmed.update(dict.fromkeys(outcome.found))  # type: ignore[arg-type]
    (said,) = worse_than_base(judged, outcome)
    assert "here sigma is vertical at touchdown 1.2 m instead of 1 m." in said


def test_lost_answers_and_outliers() -> None:
    """Their shares and sizes over 60 runs of 180 questions, and the noise that is left unchanged by them."""
    _, aid, _ = flown("loss: 0.2, outlier_share: 0.1, outlier_sigma_m: 30, long_share: 0.05, long_m: 40")
    _, plain, _ = flown()
    off = np.concatenate([aid.measured(1, run) - plain.measured(1, run) for run in range(60)])
    count = off.size
    lost = np.isnan(off)
    assert lost.mean() == pytest.approx(0.2, abs=4.0 * math.sqrt(0.16 / count))
    there = off[~lost]
    assert (there != 0.0).mean() == pytest.approx(0.15, abs=0.015)
    assert (there < 0.0).mean() == pytest.approx(0.05, abs=0.01)
    longer = 0.5 * 30.0 * math.sqrt(2.0 / math.pi) + 0.5 * 40.0
    assert there[there > 0.0].mean() == pytest.approx(longer, rel=0.1)


def test_mirror_image() -> None:
    """Beacons on level ground have the image under it, as far below as the aircraft is above, exact; one on a mast is
    told apart by its residual, and a thick layout has none."""
    level = np.array([[0.0, 0.0, 0.0], [900.0, 0.0, 0.0], [0.0, 700.0, 0.0], [800.0, 600.0, 0.0]])
    at = np.array([300.0, 200.0, 80.0])
    image, residual = mirror_image(level, at)
    assert image == pytest.approx([300.0, 200.0, -80.0], abs=1e-6)
    assert residual < 1e-6
    mast = level + np.array([[0.0, 0.0, 25.0]]) * np.array([[1.0], [0.0], [0.0], [0.0]])
    image, residual = mirror_image(mast, at)
    assert -120.0 < image[2] < -40.0
    assert residual > 0.1
    assert np.isnan(mirror_image(level * [1, 1, 0] + np.diag([0.0, 0.0, 0.0, 500.0])[:, 3:] * [0, 0, 1], at)[1])
    assert np.isnan(mirror_image(level[:2], at)[1])


@pytest.mark.parametrize(
    ("keys", "key", "text"),
    [
        ("{sites: [], rate_hz: 6, sigma_m: 0.1, range_limit_m: 9000}", "beacons.sites", "at least 1"),
        (f"{{sites: [{SITES}], rate_hz: 6, sigma_m: 0.1}}", "beacons.range_limit_m", "link budget"),
        (f"{{sites: [{SITES}], rate_hz: 6, sigma_m: 0.1, range_limit_m: 9, eirp_dbm: 3}}", "beacons.eirp_dbm",
         "one of both"),
        (f"{{sites: [{SITES}], rate_hz: 6, sigma_m: 0.1, range_limit_m: 900, long_share: 0.1}}", "beacons.long_m",
         "but long_share needs it"),
        (f"{{sites: [{SITES}], rate_hz: 6, sigma_m: 0.1, range_limit_m: 900, carrier_mhz: 50}}", "beacons.carrier_mhz",
         "100"),
        ("{sites: [{name: a, s_m: 90, l1_m: 0}, {name: a, s_m: 80, l1_m: 0}], rate_hz: 6, sigma_m: 0.1, "
         "range_limit_m: 900}", "beacons.sites", "two beacons are named"),
        ("{sites: [{s_m: 0, l1_m: -200}], rate_hz: 6, sigma_m: 0.1, range_limit_m: 900}", "beacons.sites",
         "must stay 10 m away"),
        (f"{{sites: [{SITES}], rate_hz: 500, sigma_m: 0.1, range_limit_m: 900}}", "beacons.rate_hz", "imu.rate_hz"),
    ],
)  # fmt: skip
def test_messages(keys: str, key: str, text: str) -> None:
    with pytest.raises(InputError) as caught:
        scenario("imu.rate_hz=20", f"beacons={keys}")
    assert any(key in str(problem) and text in str(problem) for problem in caught.value.problems), caught.value.problems


def test_outliers_are_no_part_of_first_order_errors() -> None:
    """The rare method refuses them, the covariance analysis warns that it leaves them out; no control variates use
    them."""
    lossy = section("loss: 0.1")
    with pytest.raises(InputError, match="method rare pushes Gaussian errors"):
        scenario(lossy, "method=rare", "box={lateral_m: 1}")
    assert any("beacons.loss changes nothing" in text for text in scenario(lossy, "method=covariance").unused())
    assert "beacons.loss" in case(*BRIEF, lossy).why_not_linear
    assert "beacons" not in case(*BRIEF, section()).why_not_linear


def test_a_key_of_the_filters_clock_leaves_the_others_as_those_of_the_receiver() -> None:
    """The filter would otherwise believe a clock of 10 us beside one of 2 us."""
    mine = scenario(section("clock: {offset_sigma_us: 2, h0: 3.0e-19}"), "filter.beacons={clock: {drift_sigma_ppb: 5}}")
    clock = mine.beacons.assumed(mine).clock
    assert (clock.offset_sigma_us, clock.h0, clock.drift_sigma_ppb) == (2.0, 3e-19, 5.0)
    assert mine.beacons.clock.drift_sigma_ppb == 100.0


def test_air_delays_ranges_by_its_refractivity_which_each_run_draws() -> None:
    """The integral of the reference atmosphere along the path, for truth minus correction; the drawn part is one
    number for all beacons of a run, the covariance analysis counts it, and a large one is warned of."""
    air = "air: {truth_refractivity_n: 340, correction: refractivity, corrected_refractivity_n: 315%s}"
    (_, bare, _), (of, aid, sensor) = flown(), flown(air % ", refractivity_sigma_n: 150")
    llh, antenna = sensor.positions(aid.frame), sensor.antenna(of.trajectory, aid.time)
    for row in (0, 100):
        path = ecef_from_llh(llh[row % 3]) - antenna[row]
        share = np.linspace(0.0, 1.0, 101)
        above = llh_from_ecef(antenna[row] + share[:, None] * path)[:, 2] - of.scenario.runway.ellipsoidal_m
        delay = 1e-6 * np.linalg.norm(path) * simpson(np.exp(-above / 7350.0), x=share)
        # the straight path sags below that over heights by 1e-5 of the delay
        assert aid.exact[row, 0] - bare.exact[row, 0] == pytest.approx(25.0 * delay, rel=1e-4)
        assert aid.effects[-1][row, 0, 0] == pytest.approx(delay, rel=1e-4)
    assert [error.name for error in sensor.errors].count("air") == 1
    drawn = [(aid.measured(5, run) - bare.measured(5, run) - aid.exact + bare.exact) / aid.effects[-1][:, 0]
             for run in range(60)]  # fmt: skip
    assert np.ptp(drawn, axis=1).max() < 1e-4
    assert np.std([each[0] for each in drawn]) == pytest.approx(150.0, rel=0.3)
    assert not any(text.startswith("beacons.air:") for text in of.warnings)
    without = case(*BRIEF, section(air % ", refractivity_sigma_n: 150"), "filter.beacons.refractivity_sigma_n=0")
    assert any(text.startswith("beacons.air: its drawn part reaches") for text in without.warnings)
    both = "pseudolites.air={correction: refractivity, refractivity_sigma_n: 45}"
    for wrong, key in (
        ((both,), r"beacons\.air\.refractivity_sigma_n: pseudolites\.air draws it, too"),
        (
            ("beacons.air=null", "filter.beacons.refractivity_sigma_n=45"),
            r"filter\.beacons\.refractivity_sigma_n: ranges",
        ),
        (("filter.pseudolites.refractivity_sigma_n=45",), r"filter\.pseudolites\.refractivity_sigma_n: ranges"),
        (("filter.beacons={errors: none, refractivity_sigma_n: 45}",), r"is for `errors: states`"),
    ):
        with pytest.raises(InputError, match=key):
            scenario(section(air % ", refractivity_sigma_n: 150"), *wrong)
    with pytest.raises(InputError, match=r"beacons\.air\.refractivity_sigma_n: lasts"):
        scenario(section(air % ", refractivity_sigma_n: 150"), "integrity={method: filter}")


def test_keys_beside_a_preset_replace_its_values() -> None:
    """As those of other presets; a preset of which nothing is left is named."""
    uwb = "beacons={sites: [{s_m: 300, l1_m: 900}], preset: uwb, rate_hz: 6, range_limit_m: 900%s}"
    (kept,) = case(*BRIEF, uwb % ", growth_m: 0.5").shared.aids
    assert isinstance(kept.sensor, Beacons)
    assert (kept.sensor.sigma, kept.sensor.true_errors.growth) == (0.025, 0.5)
    assert not scenario(uwb % ", growth_m: 0.5").unused()
    sx1280 = uwb.replace("uwb", "sx1280")
    assert not scenario(sx1280 % ", sigma_m: 2").unused()
    with pytest.raises(InputError, match=r"beacons\.sigma_m: no source of the preset sx1280 has it"):
        scenario(sx1280 % "")
    radio = uwb.replace("uwb", "radio-915").replace(", range_limit_m: 900", "")
    with pytest.raises(InputError, match=r"beacons\.bias_sigma_m: no source of the preset radio-915 has it"):
        scenario(radio % "")
    assert scenario(radio % ", bias_sigma_m: 5").beacons.reach == pytest.approx(292e3, rel=0.01)
    assert scenario(radio % ", bias_sigma_m: 5, range_limit_m: 900").beacons.reach == 900.0
    for sigma, number in (("", 1), (", sigma_m: 8", 0)):
        of = case(*BRIEF, radio % f", bias_sigma_m: 5{sigma}")
        unverified = "beacons.sigma_m: 30 m of the preset radio-915 is unverified"
        assert sum(text.startswith(unverified) for text in of.warnings) == number
    every = ", sigma_m: 1, bias_sigma_m: 0, growth_m: 0, growth_sigma_m: 0, growth_distance_m: 1"
    (said,) = scenario(uwb % every).unused()
    assert said.startswith("beacons.preset: uwb changes nothing")


@pytest.mark.parametrize(("runway", "height", "text"), [
    ("runway.height_m=120", 121.5, "beacons.height_m: 121.5 m above the runway; heights of beacons are counted from "
     "the runway, which is itself at 120 m; give 1.5"),
    ("runway.height_m=20", 140.0, "heights of beacons are counted from the runway, not from the ellipsoid"),
    ("runway.height_m=20", -2.0, "under the ground"),
    ("runway.height_m=20", 30.0, ""),
])  # fmt: skip
def test_heights_above_something_else_are_doubted(runway: str, height: float, text: str) -> None:
    said = scenario(runway, "pseudolites.count=0", section(f"height_m: {height}")).doubted_heights()
    assert len(said) == bool(text)
    assert all(text in each for each in said)


def test_a_link_budget_is_a_largest_range() -> None:
    keys = section().replace("range_limit_m: 9000", "eirp_dbm: 14, sensitivity_dbm: -97, carrier_mhz: 868")
    (aid,) = case(*BRIEF, keys).shared.aids
    assert isinstance(aid.sensor, Beacons)
    assert aid.sensor.reach == pytest.approx(9740.0, rel=0.01)


def test_curved_ranges_are_warned_of() -> None:
    """The neglected error is that of 40 000 drawn positions; with the filter's noise as advised there is no warning,
    nor by default, where the filter follows the second order."""
    sites = "{s_m: 150, l1_m: 1000, height_m: 100}"
    linear = "filter.beacons.second_order=false"
    of, by_default = (case(*BRIEF, section("bias_sigma_m: 0.2", sites=sites), *more) for more in ([linear], []))
    assert by_default.scenario.filter.beacons.second_order
    assert len(by_default.states) == len(of.states) + 6
    assert not [text for text in by_default.warnings if "as linear" in text]
    (note,) = (text for text in by_default.warnings if "estimates the second order" in text)
    assert isinstance(note, Note)
    assert (note.name, note.against) == ("second_order", ())
    assert "those of B1: at" in note
    assert "`filter.beacons.second_order: false`" in note
    assert of.beacons is not None
    there = of.shared.fix_errors.of_ranges(of.shared.signals.fix_sigma)[:, :3, :3]
    (longer,) = second_order(of.beacons.at(np.arange(30) == 20), there[20:21])[0]
    east, north, up = of.beacons.away[20, 0]
    away = np.array([north, east, -up])
    u = away / np.linalg.norm(away)
    p = np.linalg.inv(np.linalg.inv(there[20]) + np.outer(u, u) / (0.1**2 + 0.2**2))
    drawn = np.random.default_rng(3).multivariate_normal(np.zeros(3), p, 40_000)
    off = np.linalg.norm(away - drawn, axis=1) - np.linalg.norm(away) + drawn @ u
    assert longer == pytest.approx(off.mean(), rel=0.03)
    (said,) = (text for text in of.warnings if "as linear in the position error" in text)
    assert "of B1" in said
    (kind,) = (f for f in covariance_findings(of, covariance_analysis(of)) if f.text == said)
    assert (kind.name, kind.against) == ("sigma_with_beacons", ("consistent",))
    later = sites.replace("1000", "925").replace("100}", "95}")
    rare = case(*BRIEF, section("bias_sigma_m: 0.2", sites=later), "receiver.rate_hz=0.1", linear,
                "initial_errors={attitude_deg: 0.01, position_m: 0.1, velocity_m_s: 0.01}")  # fmt: skip
    (passed,) = (text for text in rare.warnings if "as linear in the position error" in text)
    assert rare.beacons is not None
    distance = np.linalg.norm(rare.beacons.away[:, 0], axis=1)
    assert float(re.findall(r"at ([\d.]+) m", passed)[0]) < 0.85 * distance.min(), "between two fixes, 10 s apart"
    least = re.search(r"filter.beacons.sigma_m to ([\d.]+)", said)
    assert least
    more = case(*BRIEF, section("bias_sigma_m: 0.2", sites=sites),
                f"filter.beacons={{sigma_m: {least[1]}}}")  # fmt: skip
    assert not more.scenario.filter.beacons.second_order
    assert not [text for text in more.warnings if "as linear in the position error" in text]


CURVED = (*BRIEF, section("bias_sigma_m: 0.2", sites="{s_m: 150, l1_m: 1000, height_m: 100}"))


def test_curved_between_sparse_fixes() -> None:
    """Sigma grows for 10 s from one fix to the next: where those of fixes are linear, the ranges between are not."""
    near = section("bias_sigma_m: 0.2", sites="{s_m: 400, l1_m: 1000}"), "filter.beacons.second_order=false"
    drift = "imu.gyro={drift_deg_h: 0, arw_deg_sqrt_h: 60}"
    small = "initial_errors={attitude_deg: 0.01, position_m: 1, velocity_m_s: 0.1}"
    often, seldom = (case(*BRIEF, *near, drift, small, f"receiver.rate_hz={rate}") for rate in (1, 0.1))
    assert often.beacons is not None
    last = np.linalg.norm(often.beacons.away[11:, 0], axis=1)
    assert often.curved is None
    assert seldom.curved is not None
    assert last.min() < seldom.curved.distance < last.max(), "after the fix of 10 s"


@pytest.mark.parametrize(
    ("settings", "changes", "cures"),
    [
        (["integrity={method: filter}"], ["use another integrity.method than filter"], ["integrity.method=mhss"]),
        (["integrity={innovations: {}}", "filter.kind=rts"],
         ["use filter.kind gaussian-sum", "leave integrity.innovations out"],
         ["integrity.innovations=null", "filter.kind=eskf"]),
        (["method=rare", "box={lateral_m: 1, height_m: 100}", "filter.beacons.second_order=false"],
         ["use method monte-carlo instead of rare", "set filter.beacons.second_order: true"],
         ["method=monte-carlo", "filter.beacons.second_order=true"]),
    ],
)  # fmt: skip
def test_cures_of_curved_ranges(settings: list[str], changes: list[str], cures: list[str]) -> None:
    """Each warning names all that has to change, and with that it is gone."""
    (said,) = (text for text in case(*CURVED, *settings).warnings if "as linear" in text)
    assert all(change in said for change in changes)
    assert not [text for text in case(*CURVED, *settings, *cures).warnings if "as linear" in text]


def test_the_stored_scenario_keeps_what_was_given(tmp_path: Path) -> None:
    """So that other methods, which are linear, take it."""
    flown = case(*CURVED)
    stored = tmp_path / "stored.yaml"
    stored.write_text(text := attributes(flown, 1)["scenario"])
    assert "second_order" not in text
    again = prepare(*load.read(stored))
    assert again.scenario == flown.scenario
    assert attributes(again, 1)["scenario"] == text
    assert covariance_analysis(prepare(*load.read(stored, ["method=covariance"])))


FADING = "imu.gyro={drift_deg_h: 0, markov_deg_h: 3000, markov_time_s: 5}"


@pytest.mark.parametrize(("clock", "more"), [("", ()), (", clock: {}", ()), ("", (FADING,))])
def test_covariance_without_fixes(clock: str, more: tuple[str, ...]) -> None:
    """Before anything is flown, sigma of the position is that of the covariance analysis, with biases that fade, too;
    where satellites are lost, its growth says whether ranges are linear. A smoother warns, and names the kinds that
    estimate products."""
    lost = ("duration_s=40", "receiver.rate_hz=1", "imu.rate_hz=20", "initial_errors.attitude_deg=1",
            f"beacons={{sites: [{{s_m: 40, l1_m: 300, height_m: 10}}, {{s_m: -300, l1_m: 900}}], rate_hz: 10, "
            f"range_limit_m: 3000, sigma_m: 0.1, bias_sigma_m: 0.1{clock}}}", "pseudolites.count=0",
            "events=[{what: silence, sources: [all], at_s: 12}, {what: silence, sources: [B2], at_s: 20}]",
            "filter.coupling=tight", *more)  # fmt: skip
    linear = case(*lost, "filter.kind=eskf", "filter.beacons.second_order=false")
    analysis, time, out = covariance_analysis(linear), grid(linear.shared), linear.shared.filter_time[5:]
    geometry = beacon_geometry(linear.shared.aids[0].sensor, linear.trajectory, time)
    p = Coasting(linear.shared, linear.design, linear.flight.initial, geometry).covariance()
    ours = np.sqrt(np.einsum("gii->gi", p[np.searchsorted(time, out - 1e-6)]))
    sigma = np.sqrt(np.einsum("gii->gi", analysis.assumed[5:, :3, :3]))
    assert sigma[-5:].max() > 5.0 * sigma[6, :2].max()
    np.testing.assert_allclose(ours, sigma, rtol=0.05)
    (said,) = (text for text in case(*lost, "filter.kind=rts").warnings if "as linear" in text)
    assert "use filter.kind gaussian-sum, tfg, eskf or left-invariant" in said
    assert "second_order: true" not in said


CORNERS = "{s_m: -60, l1_m: 150}, {s_m: 60, l1_m: 150}, {s_m: -60, l1_m: -150}, {s_m: 60, l1_m: -150}"
IN_LINE = "{s_m: 0, l1_m: 450}, {s_m: 0, l1_m: 150}, {s_m: 0, l1_m: -150}"


@pytest.mark.parametrize(
    ("keys", "sites", "cause"),
    [
        (["clock: {}"], CORNERS, "seen from the glide they lie on one cone"),
        ([], IN_LINE, "seen from the glide they lie in one plane"),
        (["clock: {}"], IN_LINE, "at most 3 of them are received at a time on the glide, and a position needs 4"),
    ],
    ids=["mirrored", "in line", "few"],
)
def test_why_ranges_give_no_position(keys: list[str], sites: str, cause: str) -> None:
    """Mirrored pairs with an unknown clock, all in line, and too few."""
    (said,) = (text for text in case(*BRIEF, section(*keys, sites=sites)).warnings if "no position" in text)
    assert said.startswith(f"beacons: {cause}")


def test_a_flat_layout_is_warned_of_and_shown(tmp_path: Any) -> None:
    """The warning names VDOP and the mirror solution; the result has both, and table and map show the beacons."""
    flat = "{s_m: 300, l1_m: 900}, {s_m: -250, l1_m: 400}, {s_m: 200, l1_m: -500}, {s_m: -200, l1_m: -500}"
    path = tmp_path / "b.h5"
    done = navsim("run", SCENARIOS / "landing.yaml", "--set", "duration_s=30", "--set", "receiver.rate_hz=1", "--set",
                  section(sites=flat), "--method", "covariance", "-o", path, "--figures", "none",
                  cwd=tmp_path)  # fmt: skip
    assert "beacons: their ranges alone hardly show the height on the glide: VDOP" in done.stderr
    assert re.search(r"mirror solution \d+ m below the aircraft where the glide begins.*\[beacons\]", done.stderr)
    assert list(read(path)["/findings/finding"]).count("beacons") == 1
    assert "VDOP, beacons" in done.stdout
    result = read(path)
    most = re.search(r"VDOP up to ([\d.]+),", done.stderr)
    assert most
    assert float(most[1]) == pytest.approx(result["/summary/beacons/vdop"][2], rel=5e-3)  # of one sampling
    assert list(result["/beacons/name"]) == ["B1", "B2", "B3", "B4"]
    assert np.all(result["/beacons/vdop_with_sources"] < result["/beacons/vdop"])
    height = result["/truth/position_llh"][:, 2] - result["/truth/threshold_llh"][2]
    assert result["/beacons/image_height"][0] == pytest.approx(-2.0 * height[0], rel=0.05)
    assert np.nanmax(result["/beacons/image_residual"]) < 0.05
    assert "When may height be trusted?" in done.stdout
    assert re.search(r"mirror solution of the ranges +\d+ m below the aircraft at 1.0 s, fits within 0.0", done.stdout)


def test_sigmas_without_beacons_are_those_of_a_landing_without() -> None:
    """With them: those of the filter in runway axes; and what the table says about either."""
    lost = "events=[{what: silence, sources: [all], at_s: 12}]"
    layout = section("bias_sigma_m: 0.2", sites=SITES + ", {s_m: 200, l1_m: -500, height_m: 60}")
    flown, without = case(*BRIEF, layout, lost), case(*BRIEF, lost)
    result = covariance_result(flown, covariance_analysis(flown), 1)
    alone = covariance_result(without, covariance_analysis(without), 1)
    for axis in ("lateral", "vertical"):
        np.testing.assert_array_equal(result[f"/summary/at/{axis}_without_beacons"], alone[f"/summary/at/{axis}_sigma"])
    np.testing.assert_allclose(result["/beacons/vertical_sigma_without"], alone["/filter/sigma"][0, :, 2], rtol=1e-12)
    np.testing.assert_allclose(result["/beacons/vertical_sigma"], result["/filter/sigma"][0, :, 2], rtol=1e-12)
    assert result["/beacons/vertical_sigma"][-1] < 0.5 * result["/beacons/vertical_sigma_without"][-1]
