"""What watches the fixes of a landing, against least squares solved anew without navsim's kernels, and by counts."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import optimize, stats

from navsim.compiler.lanes import WIDTH
from navsim.filter.estimate import in_all_lanes
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.gnss.sky import unit_vector
from navsim.integrity import monitoring
from navsim.integrity.araim import Allocation, Fault, SeparationMonitor, along, coincidences, levels
from navsim.integrity.monitoring import ALARM, NO_FIX, QUIET, UNTESTED
from navsim.integrity.residuals import ChiSquareTest, Monitor
from navsim.integrity.solution import Independent, rows_of, solve
from navsim.landing import integrity
from navsim.landing.ensemble import LandingStudy
from navsim.landing.study import Case
from navsim.report import figure_data
from navsim.results.result import read
from navsim.runner.statistics import share_interval
from navsim.simulation import landing as simulation
from navsim.simulation import measurements
from navsim.simulation.run import MonitorOutput
from tests.conftest import DATA
from tests.helpers import SCENARIOS, case, in_brief
from tests.layout import as_declared
from tests.product.test_run import navsim

CHI2 = "integrity={method: chi2, p_fa: 1.0e-2, limits: {hal_m: 60, val_m: 90, tta_s: 1}}"
MHSS = "integrity={p_constellation: 1.0e-8, p_fa_v: 1.0e-2, p_fa_h: 1.0e-2, limits: {hal_m: 60, val_m: 90, tta_s: 1}}"


def brief(*assignments: str) -> Case:
    return case("duration_s=20", "receiver.rate_hz=2", "filter.kind=eskf", *assignments)


def fixed_by(position: np.ndarray, clock: np.ndarray, sigma: np.ndarray, ranges: np.ndarray) -> tuple[Any, Any, Any]:
    """Position, whitened residuals and rows of a weighted least-squares fix, iterated to the end."""
    clocks = np.unique(clock)
    x = np.concatenate([ecef_from_llh(np.array([0.977, 0.646, 100.0])), np.zeros(clocks.size)])
    for _ in range(50):
        away = position - x[:3]
        distance = np.linalg.norm(away, axis=1)
        rows = np.concatenate([-away / distance[:, None], clock[:, None] == clocks], axis=1)
        left = ranges - distance - x[3 + np.searchsorted(clocks, clock)]
        step = np.linalg.lstsq(rows / sigma[:, None], left / sigma, rcond=None)[0]
        x = x + step
        if np.linalg.norm(step[:3]) < 1e-6:
            break
    return x[:3], left / sigma, rows / sigma[:, None]


def anew(c: Case, ranges: np.ndarray, e: int, without: tuple[str, ...] = ()) -> tuple[Any, Any, Any]:
    """The fix of an epoch from measured ranges (e, s), some sources left out."""
    s = c.shared.signals
    use = s.used[e] & ~np.isin(s.names, without)
    return fixed_by(s.position[e, use], s.time_scale[use], s.fix_sigma[e, use], ranges[e, use])


def test_residuals_are_those_of_the_fix() -> None:
    """The statistic, the alarm and the error of a run, by fixes solved anew from its pseudoranges."""
    c = brief(CHI2)
    run = simulation.fly(c.flight, 5, [3]).one(0)
    monitor = c.flight.monitor
    assert monitor is not None
    for e in range(0, c.shared.signals.time.size, 7):
        place, left, _ = anew(c, run.pseudorange, e)
        assert run.monitor_statistic[e] == pytest.approx(left @ left, rel=1e-5)
        alarm = bool(left @ left > monitor.threshold[e])
        assert run.monitor_status[e] == (ALARM if alarm else QUIET)
        off = ned_matrix(c.shared.at_filter.llh[e + 1]) @ (place - c.shared.signals.antenna[e])
        np.testing.assert_allclose(run.watched_error[e], [np.hypot(off[0], off[1]), abs(off[2])], rtol=1e-3, atol=1e-4)


def test_separations_are_those_of_fixes_without_the_fault() -> None:
    """The largest difference of fixes by its threshold, each fault's sources really left out. Ranges are not linearised
    there, so errors are made small: ten metres beside a pseudolite 1 km away turn its direction by a hundredth."""
    c = brief(MHSS)
    exact, rates = measurements.without_noise(c.shared)
    measured = exact + 0.01 * (measurements.measured(c.shared, 5, 3)[0] - exact)
    lanes = in_all_lanes(measured)
    fixes = measurements.receiver_fixes(c.shared, lanes, in_all_lanes(rates))
    said = MonitorOutput.of_fixes(c.flight, in_all_lanes(c.shared.signals.antenna), lanes, fixes)
    monitor = c.flight.monitor
    assert isinstance(monitor, SeparationMonitor)
    names = [fault.name for fault in c.flight.expected]
    assert {"PL1", "PL2", "PL1+PL2"} < set(names)
    axes = c.shared.antenna_enu
    for e in range(0, c.shared.signals.time.size, 13):
        whole, _, _ = anew(c, measured, e)
        largest = 0.0
        for k, fault in enumerate(c.flight.expected):
            if monitor.found.monitored[k, e]:
                apart = axes[e] @ (anew(c, measured, e, fault.sources)[0] - whole)
                largest = max(largest, float(np.max(np.abs(apart) / monitor.found.threshold[k, e])))
        np.testing.assert_allclose(said.statistic[e], largest, rtol=3e-4)


def test_levels_of_a_landing_by_plain_matrices() -> None:
    """Slopes by inverted normal matrices at the true antenna: the horizontal and the vertical level of an approach."""
    c = brief(CHI2)
    monitor, s = c.flight.monitor, c.shared.signals
    assert monitor is not None
    exact, _ = measurements.without_noise(c.shared)
    for e in (0, 20, s.time.size - 1):
        _, _, rows = anew(c, exact, e)
        sigma = s.fix_sigma[e, s.used[e]]
        turned = np.concatenate([rows[:, :3] @ c.shared.antenna_enu[e].T, rows[:, 3:]], axis=1)
        gain = np.linalg.inv(turned.T @ turned) @ turned.T
        redundancy = 1.0 - np.sum(turned * gain.T, axis=1)
        slope = np.stack([np.hypot(gain[0], gain[1]), np.abs(gain[2])]) / np.sqrt(redundancy)
        bias = ChiSquareTest(1e-2, 1e-3).bias(np.array([sigma.size - turned.shape[1]]))[0]
        np.testing.assert_allclose(monitor.levels[e], slope.max(axis=1) * bias, rtol=1e-5)


def reference() -> tuple[np.ndarray, np.ndarray]:
    """Rows and sigmas of the worked case of 6 satellites and 2 pseudolites."""
    given = json.loads((DATA / "integrity.json").read_text())["raim_weighted_6_satellites_2_pseudolites"]["inputs"]
    azimuth, elevation = np.radians(np.array(given["azimuth_elevation_deg"], float)).T
    return rows_of(unit_vector(azimuth, elevation)[None], np.zeros(8, int)), np.array(given["sigma_m"])[None]


@pytest.mark.parametrize("source", [None, 2, 6])
def test_alarms_and_misses_come_as_often_as_said(source: int | None) -> None:
    """A million epochs: false alarms at 1e-3, and misses of the smallest bias that is seen, of a satellite and of a
    pseudolite; 919 to 1081 are 99 % of what 1000 expected ones scatter to."""
    rows, sigma = reference()
    monitor = Monitor(solve(rows, np.ones((1, 8), bool), Independent(sigma)), ChiSquareTest(1e-3, 1e-3))
    rng = np.random.default_rng(20261123 if source is None else source)
    count = 0
    for _ in range(100):
        errors = rng.standard_normal((1, 8, 10_000)) * sigma[..., None]
        if source is not None:
            errors[0, source] += monitor.minimal_bias[0, source]
        left = monitor.solution.residuals(errors) * sigma[..., None]
        alarms = monitor.statistic(left) > monitor.threshold[:, None]
        count += int(alarms.sum() if source is None else (~alarms).sum())
    assert 919 <= count <= 1081


@pytest.mark.parametrize("by", [(30.0, 0.0, 0.0, 0.0), (0.0, 0.0, 200.0, -1000.0)])
def test_residuals_are_blind_to_a_spoofer_of_everything(by: tuple[float, ...]) -> None:
    """All ranges moved consistently: alarms come as without him."""
    rows, sigma = reference()
    monitor = Monitor(solve(rows, np.ones((1, 8), bool), Independent(sigma)), ChiSquareTest(1e-2, 1e-3))
    rng = np.random.default_rng(11)
    errors = rng.standard_normal((1, 8, 100_000)) * sigma[..., None] + (rows[0] @ np.array(by))[None, :, None]
    alarms = int((monitor.statistic(monitor.solution.residuals(errors) * sigma[..., None]) > monitor.threshold).sum())
    assert 919 <= alarms <= 1081


def test_separation_alarms_no_more_often_than_allotted() -> None:
    """Budgets of 1e-2 a direction group: alarms without a fault stay below their sum, which is a bound."""
    rows, sigma = reference()
    allocation = Allocation(p_fa_vertical=1e-2, p_fa_horizontal=1e-2)
    faults = [Fault((i,), 1e-5) for i in range(8)]
    noise = Independent(sigma)
    found = levels(rows, np.ones((1, 8), bool), noise, noise, np.full((1, 8), 0.5), faults, allocation)
    monitor = SeparationMonitor(found)
    rng = np.random.default_rng(12)
    count, epochs = 0, 0
    for drawn in np.split(rng.standard_normal((1, 8, 4000)) * sigma[..., None], 4000 // WIDTH, axis=2):
        count += int((monitor.statistic(np.ascontiguousarray(drawn)) > monitor.threshold[:, None]).sum())
        epochs += WIDTH
    assert 0.2 * 0.02 * epochs < count < 0.02 * epochs + 3.0 * np.sqrt(0.02 * epochs)


def asked(seconds: int, limits: tuple[float, float] = (10.0, 20.0), alert: float = 2.0) -> integrity.ApproachLimits:
    time = np.arange(seconds, dtype=float)
    every = np.ones(seconds, bool)
    return integrity.ApproachLimits(np.array(limits), alert, time, every, every)


@pytest.mark.parametrize(
    ("status", "level", "error", "region"),
    [
        (ALARM, 5.0, 50.0, "alarm"),
        (NO_FIX, 5.0, np.nan, "unavailable"),
        (QUIET, np.nan, 50.0, "unavailable"),
        (QUIET, np.inf, 50.0, "unavailable"),
    ],
)
def test_regions_of_what_is_no_pair(status: int, level: float, error: float, region: str) -> None:
    found = integrity.stanford_regions(
        asked(1), np.full((1, 1, 2), level), np.array([[status]]), np.full((1, 1, 2), error)
    )
    assert integrity.REGIONS[found[0, 0, 0]] == region


@pytest.mark.parametrize(
    ("misled", "alarm", "late", "longest"),
    [
        ("0000000000", "0000000000", 0, np.nan),
        ("0111000000", "0000000000", 0, np.nan),  # over within the time to alert
        ("0111100000", "0000000000", 1, np.inf),  # 3 s without an alarm
        ("0111100000", "0001000000", 0, 2.0),
        ("0111110000", "0000100000", 1, 3.0),  # an alarm, too late
        ("0000000011", "0000000000", 1, np.inf),  # short, and then touchdown
        ("0111100111", "0000000100", 1, np.inf),
    ],
)
def test_misleadingstretches(misled: str, alarm: str, late: int, longest: float) -> None:
    flags = [np.array([c == "1" for c in text]) for text in (misled, alarm)]
    found = integrity.missed_alerts(asked(10), np.arange(10.0), *flags)
    np.testing.assert_equal(found, (late, longest))


def test_windows_of_continuity() -> None:
    time = np.arange(0.0, 20.5, 0.5)
    available = np.ones((3, time.size), bool)
    available[1, 10] = False  # at 5 s: all windows that begin before or there
    available[2] = False
    found = integrity.continuity_windows(time, available)
    # windows begin at 0 ... 5 s: 11 of them
    np.testing.assert_array_equal(found, [[11, 0], [10, 10], [0, 0]])


def test_epochs_without_a_test_are_said() -> None:
    """Four sources of one clock: a fix, nothing to test it by, no level, nothing available."""
    directions = [{"azimuth_deg": a, "elevation_deg": e} for a, e in ((0, 80), (10, 20), (130, 20), (250, 20))]
    c = brief("sky.source=directions", f"sky.directions={json.dumps(directions)}", "pseudolites.count=0", CHI2)
    counts, _, _ = LandingStudy(c, 1, "none").batch(0, 2)
    assert c.flight.monitor is not None
    assert np.isinf(c.flight.monitor.levels).all()
    run = simulation.fly(c.flight, 1, [0]).one(0)
    assert set(run.monitor_status) == {UNTESTED}
    assert not counts["integrity_available"].any()
    assert not counts["integrity_approach"].any()
    (text,) = integrity.level_warnings(c)
    assert "no protection level at 40 of 40 epochs" in text


def test_faults_that_cannot_be_monitored_are_named() -> None:
    (text,) = integrity.level_warnings(brief("integrity={}"))
    assert "glonass 0.0001" in text
    assert "p_unmonitored_max is 8e-08" in text
    assert integrity.level_warnings(brief(MHSS)) == []
    assert integrity.level_warnings(brief("integrity={p_constellations: {glonass: 1.0e-8}}")) == []


def test_a_scenario_has_the_defaults_of_the_levels() -> None:
    """The allocation of LPV-200 stands in the section and in `Allocation`."""
    watching = brief("integrity={}").flight.watching
    assert watching is not None
    assert watching.test == Allocation()


def test_what_is_left_of_several_faults_at_once() -> None:
    """By all 64 combinations of six faults, without those that are listed; enough of them are."""
    priors = np.array([0.1, 0.02, 0.03, 0.05, 0.01, 0.004])
    chosen = coincidences(list(priors), 0.01)
    assert chosen[:2] == [(0, 3), (0, 2)]
    unlisted = 0.0
    for there in itertools.product((False, True), repeat=6):
        faults = tuple(np.flatnonzero(there).tolist())
        if len(faults) > 1 and faults not in chosen:
            unlisted += float(np.prod(np.where(there, priors, 1.0 - priors)))
    assert unlisted <= 0.005
    rows, sigma = reference()
    listed = [Fault((i,), float(p)) for i, p in enumerate(priors)]
    listed += [Fault((i, j), float(priors[i] * priors[j]), (i, j)) for i, j in chosen]
    noise = Independent(sigma)
    found = levels(rows, np.ones((1, 8), bool), noise, noise, np.zeros((1, 8)), listed, Allocation(p_unmonitored=0.01))
    lost = sum(fault.prior for fault, seen in zip(listed, found.monitored[:, 0], strict=True) if not seen)
    assert float(found.unmonitored[0]) == pytest.approx(unlisted + lost, rel=1e-9)


def test_two_systems_are_monitored_with_their_coincidences() -> None:
    """At the default priors, two systems and two pseudolites at 1e-4 come two at once with 1.3e-7."""
    c = brief("integrity={}", "sky.source=nominal")
    assert integrity.level_warnings(c) == []
    names = [fault.name for fault in c.flight.expected]
    assert "PL1 & glonass" in names
    assert isinstance(c.flight.monitor, SeparationMonitor)
    assert float(c.flight.monitor.found.unmonitored.max()) <= 8e-8


@pytest.mark.parametrize("setting", [CHI2, MHSS])
def test_nothing_else_of_a_run_changes(setting: str) -> None:
    """Who watches does not touch: fixes, errors and sigmas are those of a landing that nobody watches."""
    plain, watched = (simulation.fly(brief(*more).flight, 2, [4]).one(0) for more in ((), (setting,)))
    for name in ("fix_llh", "error", "sigma", "nees", "status"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(watched, name))
    assert plain.monitor_status.size == 0
    assert watched.monitor_status.size == 40


@pytest.mark.parametrize("keep", in_brief(["none", "errors", "all"], 2))
def test_the_result_says_what_was_counted(tmp_path: Path, keep: str) -> None:
    settings = ("--set", "duration_s=70", "--set", "receiver.rate_hz=2", "--set", "filter.kind=eskf", "--set", CHI2)
    navsim("run", SCENARIOS / "landing.yaml", *settings, "--runs", 40, "--keep", keep, "--figures", "none", "-q",
           "-o", "a.h5", cwd=tmp_path)  # fmt: skip
    result = read(tmp_path / "a.h5")
    as_declared(result)
    branch = "/summary/integrity"
    alarms, tested = int(result[f"{branch}/alarms"]), int(result[f"{branch}/tested"])
    assert tested == 40 * 120  # the glide takes 60.2 s
    assert alarms / tested == pytest.approx(0.01, abs=0.0045)
    assert int(result[f"{branch}/stanford_vertical"].sum()) == tested
    assert int(result[f"{branch}/stanford_vertical"][5]) == alarms
    assert float(result[f"{branch}/availability"][0]) == pytest.approx(1.0 - alarms / tested, abs=1e-12)
    if keep != "none":  # the diagram is of the same epochs, those with an alarm left out
        for axis in figure_data.LEVELS:
            assert figure_data.stanford(result, *axis).counts.sum() == tested - alarms
        assert "epochs of the glide alone, from its start to touchdown" in figure_data.stanford_text(result)
    value, low, high = result[f"{branch}/hmi"]
    assert value == 0.0
    assert low == 0.0
    assert high == pytest.approx(1.0 - 0.025 ** (1.0 / 40), rel=1e-9)
    if keep != "none":
        assert figure_data.ALARM == ALARM  # reports read results alone
        glide = result["/integrity/time"] <= 60.2
        assert int((result["/integrity/status"][:, glide] == ALARM).sum()) == alarms


def test_the_covariance_analysis_has_levels(tmp_path: Path) -> None:
    settings = ("--set", "method=covariance", "--set", "duration_s=20", "--set", "receiver.rate_hz=1", "--set", MHSS)
    navsim("run", SCENARIOS / "landing.yaml", *settings, "--figures", "none", "-q", "-o", "a.h5", cwd=tmp_path)
    result = read(tmp_path / "a.h5")
    as_declared(result)
    assert np.isfinite(result["/integrity/vpl"]).all()
    assert "/summary/integrity/alarms" not in result


def test_levels_of_other_forms(tmp_path: Path) -> None:
    """By the covariance of the receiver's own fixes: with nothing from the ground GBAS is K sigma along the axes of
    the approach, and what is asked of the ground adds to it."""
    station = "{receivers: 2, ground_sigma_m: %s, b_m: %s}"
    found = []
    for ground, b in ((0, 0), (1.5, 0), (1.5, 4)):
        chosen = f"integrity={{comparison: {{gbas: {station % (ground, b)}}}}}"
        options = ("-q", "--figures", "none", "--set", chosen, "-o", f"{ground}_{b}.h5")
        navsim("run", SCENARIOS / "landing.yaml", *options, cwd=tmp_path)
        found.append(read(tmp_path / f"{ground}_{b}.h5"))
    plain, noisy, biased = found
    cov = plain["/receiver/covariance_enu"]
    level = 6.0 * np.sqrt(np.linalg.eigvalsh(cov[:, :2, :2])[:, 1])
    np.testing.assert_allclose(plain["/integrity/sbas_hpl"], level, rtol=1e-6)
    np.testing.assert_allclose(plain["/integrity/sbas_vpl"], 5.33 * np.sqrt(cov[:, 2, 2]), rtol=1e-6)
    heading = np.radians(case().scenario.runway.heading_deg)
    across = np.array([np.cos(heading), -np.sin(heading), 0.0])
    over = np.array([np.sin(heading) * np.tan(np.radians(5.0)), np.cos(heading) * np.tan(np.radians(5.0)), 1.0])
    for name, axis in (("lpl", across), ("vpl", over)):
        sigma = np.sqrt(np.einsum("i,eij,j->e", axis, cov, axis))
        np.testing.assert_allclose(plain[f"/integrity/gbas_{name}"], 5.762 * sigma, rtol=1e-4)
        # the ground's is a part of what ranges have: with all receivers it is in their sigma
        np.testing.assert_allclose(noisy[f"/integrity/gbas_{name}"], plain[f"/integrity/gbas_{name}"], rtol=1e-12)
        assert np.all(biased[f"/integrity/gbas_{name}"] > 1.05 * noisy[f"/integrity/gbas_{name}"])
        # one receiver of two faulty: by normal equations of one epoch, K_md of 2.5e-3 x 2 / 3
        c = case("integrity={comparison: {}}")
        signals = c.shared.signals.at(np.array([7]))
        heard = signals.used[0]
        enu = ned_matrix(llh_from_ecef(signals.antenna[0]))[[1, 0, 2]] * np.array([[1.0], [1.0], [-1.0]])
        away = (signals.position[0, heard] - signals.antenna[0]) @ enu.T
        scale = signals.time_scale[heard]
        clock = (scale[:, None] == np.unique(scale)).astype(float)
        h = np.hstack([-away / np.linalg.norm(away, axis=1)[:, None], clock])
        sigma = signals.fix_sigma[0, heard]
        s = axis @ np.linalg.solve(h.T @ (h / sigma[:, None] ** 2), h.T / sigma**2)[:3]
        level = 4.0 * np.abs(s).sum() + 2.935 * np.sqrt(s**2 @ (sigma**2 + 1.5**2))
        assert biased[f"/integrity/gbas_{name}"][7] == pytest.approx(level, rel=1e-3)
    glide = plain["/integrity/time"] <= 60.0
    mean = plain["/integrity/sbas_vpl"][glide].mean()
    assert plain["/summary/integrity/sbas_vpl"][0] == pytest.approx(mean, rel=0.02)


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("integrity={comparison: {sbas: false}}", "there is nothing to compare"),
        ("integrity={method: filter, comparison: {}}", "the forms are of fixes"),
        ("integrity={comparison: {gbas: {receivers: 5, ground_sigma_m: 0.3, b_m: 0}}}", "receivers"),
        ("integrity={comparison: {gbas: {receivers: 4, ground_sigma_m: 2.3, b_m: 0}}}", "the least is 2.24 m"),
    ],
)
def test_comparisons_that_cannot_be(assignment: str, message: str, tmp_path: Path) -> None:
    refused = navsim("run", SCENARIOS / "landing.yaml", "--dry-run", "--set", assignment, cwd=tmp_path, code=2)
    assert message in refused.stderr


def test_limits_that_grow_with_the_distance(tmp_path: Path) -> None:
    """An epoch on the glide has the limits of its distance and height; only there a level may be larger."""
    grown = "integrity={limits: {hal_m: 40, val_m: 10, tta_s: 6, grow_with_distance: true}}"
    options = ("-q", "--figures", "none", "--set", grown, "--set", "duration_s=61", "--set", "imu.rate_hz=50")
    navsim("run", SCENARIOS / "landing.yaml", *options, "-o", "a.h5", cwd=tmp_path)
    result = read(tmp_path / "a.h5")
    as_declared(result)
    threshold = ecef_from_llh(result["/truth/threshold_llh"])
    truth = ecef_from_llh(result["/truth/position_llh"])
    time = result["/integrity/time"]
    k = np.searchsorted(result["/truth/time"], time[50] - 1e-9)
    height = result["/truth/position_llh"][k, 2] - result["/truth/threshold_llh"][2]
    distance = np.sqrt(np.sum((truth[k] - threshold) ** 2) - height**2)
    lateral, vertical = (result[f"/integrity/{name}"][50] for name in ("hal", "val"))
    assert lateral == pytest.approx(40.0 + max(0.0, 0.0044 * distance - 3.85), abs=0.01)
    assert vertical == pytest.approx(10.0 + max(0.0, 0.02925 * height / 0.3048 - 5.85), abs=0.05)
    assert float(result["/summary/integrity/val"]) == 10.0
    low = np.isfinite(result["/integrity/vpl"]) & (result["/integrity/vpl"] <= result["/integrity/val"])
    glide = time <= 60.0
    assert float(result["/summary/integrity/availability"][0]) <= low[glide].mean()
    of = figure_data.stanford(result, "vertical", "vpl", "val")
    assert of.limit == 10.0


def test_a_satellite_alone_on_its_clock_is_harmless() -> None:
    """It tells the clock of its system and nothing of the position: levels are those without it."""
    silent = ["G07", "G11", "G12", "G14", "G17"]
    events = [{"what": "silence", "sources": silent}]
    both = brief("sky.source=nominal", CHI2, f"events={json.dumps(events)}")
    used = both.shared.signals.used[20]
    assert sum(name.startswith("G") for name, use in zip(both.shared.signals.names, used, strict=True) if use) == 1
    alone = brief("sky.source=nominal-glonass", CHI2)
    assert both.flight.monitor is not None
    assert alone.flight.monitor is not None
    np.testing.assert_allclose(both.flight.monitor.levels[20], alone.flight.monitor.levels[20], rtol=1e-9)


def test_runs_that_are_all_alike_have_an_interval() -> None:
    """Two runs of 60 of 100 epochs do not say that a third is not another."""
    value, low, high = integrity.share_over_runs(np.array([60, 60]), np.array([100, 100]))
    rare = 1.0 - 0.025 ** (1.0 / 2)
    np.testing.assert_allclose([value, low, high], [0.6, 0.6 * (1.0 - rare), 0.6 + 0.4 * rare])
    value, low, high = integrity.share_over_runs(np.array([60]), np.array([100]))
    np.testing.assert_allclose([value, low, high], [0.6, 0.6 * 0.025, 0.6 + 0.4 * 0.975])  # a single run too
    for alike in (0, 100):
        found = integrity.share_over_runs(np.full(40, alike), np.full(40, 100))
        np.testing.assert_allclose(found, share_interval(40 * (alike > 0), 40), atol=1e-12)


def test_a_spoofer_that_nobody_notices_has_no_time_to_alert(tmp_path: Path) -> None:
    events = [{"what": "spoof", "sources": ["all"], "offset_ned_m": [100, 0, 0], "at_s": 10}]
    settings = ("--set", "duration_s=70", "--set", "receiver.rate_hz=2", "--set", "filter.kind=eskf", "--set",
                f"events={json.dumps(events)}", "--set", CHI2.replace("1.0e-2", "1.0e-9"), "--set",
                "requirements=[{what: time_to_alert, within_s: 6}]")  # fmt: skip
    navsim(
        "run", SCENARIOS / "landing.yaml", *settings, "--runs", 3, "--figures", "none", "-q", "-o", "a.h5", cwd=tmp_path
    )
    result = read(tmp_path / "a.h5")
    assert float(result["/summary/integrity/time_to_alert"]) == np.inf
    assert list(result["/summary/requirements/verdict"]) == ["not met"]
    assert list(result["/summary/requirements/statement"]) == ["an alarm within 6 s in each of these runs"]


def level_by_bisection(budget: float, bias: float, sigma: float, faults: list[tuple[float, float, float]]) -> float:
    """Where 2 Q((x - bias) / sigma) + sum of p Q((x - reach) / spread) is the budget."""

    def excess(x: float) -> float:
        others = sum(p * stats.norm.sf((x - reach) / spread) for p, reach, spread in faults)
        return float(2 * stats.norm.sf((x - bias) / sigma) + others - budget)

    return float(optimize.brentq(excess, 0.0, 1e5, xtol=1e-9))


@pytest.mark.parametrize("heading", [0.0, 90.0, 37.0])
def test_levels_in_axes_of_the_runway(heading: float) -> None:
    """By plain matrices: along north and east those of the axes, else under the tests east and north together."""
    c = brief(MHSS, f"runway.heading_deg={heading}", "pseudolites.count=2", "pseudolites.l1_m=1500")
    monitor, watching, s = c.flight.monitor, c.flight.watching, c.shared.signals
    assert isinstance(monitor, SeparationMonitor)
    assert watching is not None
    levels_ = monitoring.runway_levels(watching, monitor, s, np.radians(heading))
    assert levels_ is not None
    east, north = monitor.found.level[:, 0], monitor.found.level[:, 1]
    if heading != 37.0:
        expected = {0.0: [east, north], 90.0: [north, east]}[heading]
        np.testing.assert_allclose(levels_, np.transpose(expected), rtol=1e-7)
        return
    e = 11
    use, turn = s.used[e], np.radians(heading)
    clock = (s.time_scale[use][:, None] == np.unique(s.time_scale[use])).astype(float)
    rows = np.concatenate([-s.los[e, use], clock], axis=1)
    sigma, names = s.fix_sigma[e, use], np.array(s.names)[use]
    nominal = np.array([0.25 if name.startswith("PL") else 0.75 for name in names])

    def gain(kept: np.ndarray) -> np.ndarray:
        whitened = rows[kept] / sigma[kept, None]
        out = np.zeros((rows.shape[1], len(rows)))
        out[:, kept] = np.linalg.pinv(whitened) / sigma[kept]
        return out[:2]

    whole = gain(np.ones(len(rows), bool))
    monitored = monitor.found.monitored[:, e]
    k_fa = stats.norm.isf(1e-2 / (4 * monitored.sum()))
    total = 9.8e-8 + 2e-9
    budget = 1e-9 * (1 - monitor.found.unmonitored[e] / total)
    for axis, (a, b) in enumerate(((np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn)))):
        own, faults = np.array([a, b]) @ whole, []
        for fault, seen in zip(c.flight.expected, monitored, strict=True):
            if not seen:
                continue
            without = gain(~np.isin(names, fault.sources))
            limits = k_fa * np.sqrt((((without - whole) * sigma) ** 2).sum(axis=1))
            other = np.array([a, b]) @ without
            reach = abs(a) * limits[0] + abs(b) * limits[1] + np.abs(other) @ nominal
            faults.append((fault.prior, reach, np.sqrt(((other * sigma) ** 2).sum())))
        expected_level = level_by_bisection(budget, np.abs(own) @ nominal, np.sqrt(((own * sigma) ** 2).sum()), faults)
        assert levels_[e, axis] == pytest.approx(expected_level, rel=1e-6)


def test_levels_without_any_fault_to_expect() -> None:
    """All priors 0: the level is what noise and nominal biases leave, 2 Q((x - b)/sigma) = p_hmi, along every axis."""
    section = "{p_satellite: 0, p_constellation: 0, p_pseudolite: 0, ground_groups: []}"
    c = brief(f"integrity={section}", "runway.heading_deg=37")
    monitor, watching, s = c.flight.monitor, c.flight.watching, c.shared.signals
    assert isinstance(monitor, SeparationMonitor)
    assert watching is not None
    assert not monitor.tested.any()
    found = monitoring.runway_levels(watching, monitor, s, np.radians(37))
    assert found is not None
    use = s.used[4]
    rows = np.concatenate([-s.los[4, use], np.ones((int(use.sum()), 1))], axis=1) / s.fix_sigma[4, use][:, None]
    gain = np.linalg.pinv(rows) / s.fix_sigma[4, use]
    turn = np.radians(37)
    axes = (gain[2], np.cos(turn) * gain[0] - np.sin(turn) * gain[1], np.sin(turn) * gain[0] + np.cos(turn) * gain[1])
    nominal = np.array([0.25 if name.startswith("PL") else 0.75 for name in np.array(s.names)[use]])
    levels_ = (monitor.levels[4, 1], *found[4])
    for one, level, p_hmi in zip(axes, levels_, (9.8e-8, 1e-9, 1e-9), strict=True):
        expected = np.abs(one) @ nominal + stats.norm.isf(p_hmi / 2) * np.sqrt(np.sum((one * s.fix_sigma[4, use]) ** 2))
        assert level == pytest.approx(expected, rel=1e-7)


def test_slopes_in_axes_of_the_runway() -> None:
    """Of the residuals' test: the fix of a biased range, across and along a runway at 37 degrees."""
    c = brief(CHI2, "runway.heading_deg=37")
    monitor, watching, s = c.flight.monitor, c.flight.watching, c.shared.signals
    assert isinstance(monitor, Monitor)
    assert watching is not None
    found = monitoring.runway_levels(watching, monitor, s, np.radians(37))
    assert found is not None
    e, turn = 5, np.radians(37)
    rows = np.concatenate([-s.los[e, s.used[e]], np.ones((int(s.used[e].sum()), 1))], axis=1)
    rows /= s.fix_sigma[e, s.used[e]][:, None]
    gain = np.linalg.pinv(rows)
    seen = np.sqrt(1 - np.diag(rows @ gain))
    bias = ChiSquareTest(1e-2, 1e-3).bias(np.array([len(rows) - 4]))[0]
    across = np.cos(turn) * gain[0] - np.sin(turn) * gain[1]
    along = np.sin(turn) * gain[0] + np.cos(turn) * gain[1]
    np.testing.assert_allclose(found[e], [bias * np.max(np.abs(one) / seen) for one in (across, along)], rtol=1e-9)
    assert (found <= monitor.levels[:, :1] * (1 + 1e-12)).all()


@pytest.mark.parametrize("fault", in_brief([None, 3], 1))
def test_levels_in_axes_of_the_runway_hold(fault: int | None) -> None:
    """At budgets that can be counted: errors across and along a runway at 45 degrees that are beyond their level with
    no alarm, without a fault and with the worst bias of one satellite, which it has half of the time."""
    rows, sigma = reference()
    p_hmi = 2e-2
    allocation = Allocation(p_hmi_vertical=0.05, p_hmi_horizontal=p_hmi, p_fa_horizontal=0.05, p_unmonitored=0.1)
    priors = [1e-6] * 8
    if fault is not None:
        priors[fault] = 0.5
    faults = [Fault((i,), p) for i, p in enumerate(priors)]
    noise, used = Independent(sigma), np.ones((1, 8), bool)
    found = levels(rows, used, noise, noise, np.zeros((1, 8)), faults, allocation, unlisted=0.0)
    whole = solve(rows, used, noise)
    level = along(found, whole, np.zeros((1, 8)), np.array(priors), allocation, np.pi / 4)[0]
    turn = np.array([[1, -1], [1, 1]]) / np.sqrt(2)
    worst = 0.0
    rng = np.random.default_rng(20268)
    for bias in [0.0] if fault is None else np.linspace(2.0, 60.0, 30):
        errors = sigma[0][:, None] * rng.standard_normal((8, 100_000))
        if fault is not None:
            errors[fault] += bias
        position = turn @ whole.estimator[0, :2] @ errors
        apart = np.abs(found.separator[:, 0] @ errors)
        silent = (apart <= found.threshold[:, 0, :, None]).all(axis=(0, 1))
        worst = max(worst, float(np.mean((np.abs(position) > level[:, None]) & silent, axis=1).max()))
    share = 1.0 if fault is None else priors[fault]
    assert worst * share <= 0.5 * p_hmi


@pytest.mark.parametrize(
    ("given", "prior"), in_brief([("monitored", 4.3e-5), ("unmonitored", 1.04e-3), ("2.0e-5", 2e-5)], 1)
)
def test_priors_of_pseudolites(given: str, prior: float, tmp_path: Path) -> None:
    """As the specification rounds them; the table shows what was taken."""
    section = f"integrity={{p_pseudolite: {given}, p_constellations: {{glonass: 1.0e-8}}}}"
    faults = {fault.name: fault.prior for fault in brief(section).flight.watching.faults}
    assert faults["PL1"] == pytest.approx(prior, rel=0.01)
    settings = ("--set", section, "--set", "duration_s=30", "--set", "receiver.rate_hz=1", "--method", "covariance")
    done = navsim("run", SCENARIOS / "landing.yaml", *settings, "--figures", "none", "-o", "p.h5", cwd=tmp_path)
    (row,) = (line for line in done.stdout.splitlines() if "prior: satellite, system, pseudolite" in line)
    shown = f"{prior:.3g}" if given[0].isdigit() else given
    assert row.split("pseudolite", 1)[1].strip() == f"1e-05, 0.0001, {shown}, glonass 1e-08, all pseudolites 1e-05"
