"""What is excluded after an alarm: fixes solved anew by other means, events whose sources are known, and counts."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navsim.filter.records import NOT_USED
from navsim.geodesy.earth import ned_matrix
from navsim.gnss.sky import unit_vector
from navsim.integrity.exclusion import NOTHING, alone, contained, least_rms
from navsim.integrity.monitoring import ALARM, EXCLUDED, QUIET
from navsim.integrity.residuals import ChiSquareTest, Monitor
from navsim.integrity.solution import Independent, rows_of, solve
from navsim.landing import integrity
from navsim.landing.ensemble import UNWEIGHED, LandingStudy
from navsim.landing.study import Case
from navsim.results.result import read
from navsim.runner.statistics import share_interval
from navsim.simulation import landing as simulation
from navsim.simulation import measurements
from tests.consistency.test_tight_landings import flown
from tests.consistency.test_watched_fixes import anew, brief, reference
from tests.helpers import SCENARIOS
from tests.layout import as_declared
from tests.product.test_run import navsim

LIMITS = "limits: {hal_m: 100, val_m: 150, tta_s: 2}"
STEP = [{"what": "step", "sources": ["R01"], "error_m": 80, "at_s": 8, "until_s": 14}]


def faulty(rule: str, events: list[dict[str, Any]], *more: str) -> Case:
    return brief(f"integrity={{{rule}, {LIMITS}}}", f"events={json.dumps(events)}", *more)


def tried(monitor: Monitor, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which sets without one source pass their own test (s, e, m), the RMS of their residuals, m, and their sizes."""
    solution = monitor.solution
    assert isinstance(solution.noise, Independent)
    passes, rms, left = [], [], []
    for i in range(solution.used.shape[1]):
        kept = solution.used.copy()
        kept[:, i] = False
        # the rows are whitened already
        rest = Monitor(solve(solution.rows, kept, Independent(np.ones(kept.shape))), monitor.test)
        of_rest = rest.solution.residuals(errors / solution.noise.sigma[..., None])
        passes.append((of_rest**2).sum(axis=1) <= np.where(rest.tested, rest.threshold, -1.0)[:, None])
        square = ((of_rest * solution.noise.sigma[..., None]) ** 2).sum(axis=1)
        rms.append(np.sqrt(square / kept.sum(axis=1)[:, None]))
        left.append(kept.sum(axis=1))
    return np.array(passes), np.array(rms), np.array(left)


def singles(count: int) -> np.ndarray:
    return contained(np.eye(count, dtype=bool), np.ones((1, count), bool))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(6, 12), bias=st.floats(0.0, 60.0))
def test_what_is_left_loses_the_square_of_the_normalised_residual(seed: int, count: int, bias: float) -> None:
    """So that whatever is excluded has the largest one, and the order of the sources does not matter."""
    rng = np.random.default_rng(seed)
    los = unit_vector(rng.uniform(0, 2 * np.pi, (1, count)), rng.uniform(0.0, 1.5, (1, count)))
    rows, used, test = rows_of(los, np.zeros(count, int)), np.ones((1, count), bool), ChiSquareTest(1e-3, 1e-3)
    sigma = rng.uniform(0.5, 3.0, (1, count))
    errors = rng.standard_normal((1, count, 50)) * sigma[..., None]
    errors[0, 0] += bias
    order = rng.permutation(count)
    found = []
    for some in (np.arange(count), order):
        monitor = Monitor(solve(rows[:, some], used, Independent(sigma[:, some])), test)
        passes, _, _ = tried(monitor, errors[:, some])
        found.append(alone(passes, singles(count))[0])
        each = monitor.each(errors[:, some])[0]
        seen = np.isfinite(each).all(axis=1)
        square = (monitor.solution.residuals(errors[:, some]) ** 2).sum(axis=1)[0]
        threshold = monitor.test.threshold(monitor.solution.degrees - 1)[0]
        np.testing.assert_array_equal(passes[seen, 0], (square - each**2 <= threshold)[seen])
        chosen = found[-1] != NOTHING
        alarmed = square > monitor.threshold[0]
        picked = chosen & alarmed
        np.testing.assert_array_equal(found[-1][picked], np.nanargmax(np.abs(each), axis=0)[picked])
    np.testing.assert_array_equal(np.where(found[1] == NOTHING, NOTHING, order[found[1]]), found[0])


@pytest.mark.parametrize("source", [0, 2, 5, 6])
def test_the_wrong_one_is_excluded_no_more_often_than_false_alarms_come(source: int) -> None:
    """Without the source at fault the rest is clean and fails its test with p_fa; only then may another one be alone.
    RTKLIB's rule has no such bound."""
    rows, sigma = reference()
    monitor = Monitor(solve(rows, np.ones((1, 8), bool), Independent(sigma)), ChiSquareTest(1e-2, 1e-3))
    rng = np.random.default_rng(source)
    wrong = {"alone": 0, "rms": 0}
    for _ in range(20):
        errors = rng.standard_normal((1, 8, 5_000)) * sigma[..., None]
        errors[0, source] += 0.8 * monitor.minimal_bias[0, source]
        alarm = (monitor.solution.residuals(errors) ** 2).sum(axis=1) > monitor.threshold[:, None]
        passes, rms, left = tried(monitor, errors)
        for name, chosen in (
            ("alone", alone(passes & alarm, singles(8))),
            ("rms", least_rms(passes & alarm, rms, left)),
        ):
            wrong[name] += int(((chosen != NOTHING) & (chosen != source)).sum())
    assert share_interval(wrong["alone"], 100_000)[1] <= 1e-2
    assert wrong["rms"] > wrong["alone"]


def test_candidates_that_take_away_more_do_not_count() -> None:
    """A group passes where one of its members does; what is the same in all that is used is the first of them."""
    groups = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 0], [0, 1, 0, 1]], bool)
    used = np.array([[1, 1, 1, 1], [1, 1, 1, 0]], bool)
    inside = contained(groups, used)

    def chosen(*which: int) -> list[int]:
        passes = np.isin(np.arange(4), which)[:, None, None] & np.ones((4, 2, 1), bool)
        return list(alone(passes, inside)[:, 0])

    assert chosen() == [NOTHING, NOTHING]
    assert chosen(0, 2) == [0, 0]
    assert chosen(2) == [2, 2]
    assert chosen(0, 1, 2) == [NOTHING, NOTHING]
    assert chosen(2, 3) == [NOTHING, 3]
    assert chosen(1, 3) == [1, 1]


@pytest.mark.parametrize("rule", ["method: chi2, exclusion: residual", "method: chi2, exclusion: rms",
                                  "p_constellation: 1.0e-9, exclusion: residual"])  # fmt: skip
def test_fixes_without_the_faulty_source(rule: str) -> None:
    """Fixes, their errors and levels after exclusions are those of a landing that does not hear it."""
    c = faulty(rule, STEP)
    run = simulation.fly(c.flight, 5, [3]).one(0)
    names = [one.name for one in c.flight.candidates]
    excluded = run.monitor_excluded == names.index("R01")
    time = c.shared.signals.time
    assert not excluded[(time < 8) | (time >= 14)].any()
    assert excluded[(time >= 8) & (time < 14)].mean() > 0.9
    np.testing.assert_array_equal(run.monitor_status == EXCLUDED, run.monitor_excluded != NOTHING)
    for e in np.flatnonzero(excluded)[::3]:
        place, _, _ = anew(c, run.pseudorange, e, ("R01",))
        off = ned_matrix(c.shared.at_filter.llh[e + 1]) @ (place - c.shared.signals.antenna[e])
        np.testing.assert_allclose(run.watched_error[e], [np.hypot(off[0], off[1]), abs(off[2])], rtol=1e-3, atol=1e-4)
    assert c.flight.watching is not None
    deaf = faulty(rule, [{"what": "silence", "sources": ["R01"]}])
    assert deaf.flight.monitor is not None
    # what levels may miss is shared by the candidates: higher than those of a landing that has none
    assert (run.monitor_level[excluded] > deaf.flight.monitor.levels[excluded]).all()
    assert (run.monitor_level[excluded] < 1.5 * deaf.flight.monitor.levels[excluded]).all()


def test_the_filter_gets_the_fix_without_the_faulty_source() -> None:
    """A step of 80 m on one satellite for 6 s: with exclusion the filter's error is what it is without the step."""

    def worst(integrity_section: str, events: list[dict[str, Any]]) -> float:
        run = flown(faulty(integrity_section, events), 8, 5)
        return float(np.sqrt(np.mean(run.error[:, -12:, :3] ** 2)))

    clean, faulted = worst("method: chi2", []), worst("method: chi2", STEP)
    spared = worst("method: chi2, exclusion: residual, on_alarm: drop", STEP)
    assert faulted > 2.0 * clean
    assert spared < 1.15 * clean


def test_both_pseudolites_are_excluded_together() -> None:
    """Surveyed 60 m beside where they are, they are wrong consistently: neither passes alone, the group does."""
    events = [{"what": "step", "sources": ["PL1"], "error_m": 60}, {"what": "step", "sources": ["PL2"], "error_m": -60}]
    c = faulty("p_constellation: 1.0e-8, exclusion: residual", events)
    run = simulation.fly(c.flight, 5, [0]).one(0)
    names = [one.name for one in c.flight.candidates]
    assert "PL1 & PL2" not in names
    assert (run.monitor_excluded == names.index("PL1+PL2")).mean() > 0.9
    found = integrity.exclusion_outcomes(c)[run.monitor_excluded, np.arange(run.monitor_excluded.size)]
    assert set(found[run.monitor_excluded == names.index("PL1+PL2")]) == {integrity.EXCLUSIONS.index("correct")}
    assert integrity.exclusion_outcomes(c)[names.index("PL1"), 0] == integrity.EXCLUSIONS.index("wrong")


def test_a_run_does_not_depend_on_its_neighbours() -> None:
    c = faulty("method: chi2, p_fa: 0.01, exclusion: residual, on_alarm: drop", STEP)
    several, single = simulation.fly(c.flight, 5, range(4)).one(2), simulation.fly(c.flight, 5, [2]).one(0)
    assert (several.monitor_excluded != NOTHING).any()
    for name in ("fix_llh", "fix_velocity", "watched_error", "monitor_level", "monitor_excluded", "error", "status"):
        np.testing.assert_array_equal(getattr(several, name), getattr(single, name), err_msg=name)


def test_nothing_changes_where_there_is_no_alarm() -> None:
    quiet, ready = (
        simulation.fly(brief(f"integrity={{method: chi2, p_fa: 1.0e-9{more}}}").flight, 2, [4]).one(0)
        for more in ("", ", exclusion: residual, on_alarm: drop")
    )
    assert set(ready.monitor_status) == {QUIET}
    assert quiet.monitor_excluded.size == quiet.monitor_level.size == 0
    for name in ("fix_llh", "error", "sigma", "nees", "status", "watched_error"):
        np.testing.assert_array_equal(getattr(quiet, name), getattr(ready, name))


def test_the_filter_does_without_dropped_fixes() -> None:
    c = faulty("method: chi2, on_alarm: drop", STEP)
    runs = simulation.fly(c.flight, 5, range(4))
    alarms = runs.monitor_status == ALARM
    assert alarms.any()
    np.testing.assert_array_equal(runs.status == NOT_USED, alarms)
    assert np.isfinite(runs.fix_llh).all()
    rows, _, _ = LandingStudy(c, 5, "none").batch(0, 4)
    assert not rows["fix_flaws_count"][:, UNWEIGHED].any()  # it is as it was asked for


@pytest.mark.parametrize("keep", ["none", "errors"])
def test_the_result_says_what_was_excluded(tmp_path: Path, keep: str) -> None:
    section = f"integrity={{method: chi2, p_fa: 1.0e-3, exclusion: residual, {LIMITS}}}"
    given = ("--set", "duration_s=70", "--set", "receiver.rate_hz=2", "--set", "filter.kind=eskf", "--set",
             f"events={json.dumps(STEP)}", "--set", section)  # fmt: skip
    said = navsim("run", SCENARIOS / "landing.yaml", *given, "--runs", 20, "--keep", keep, "-o", "a.h5", cwd=tmp_path)
    result = read(tmp_path / "a.h5")
    as_declared(result)
    branch = "/summary/integrity"
    came = [int(result[f"{branch}/exclusions_{name}"]) for name in integrity.EXCLUSIONS]
    assert sum(came) == int(result[f"{branch}/exclusions"])
    assert came[0] > 0.9 * 12 * 20
    assert came[1] <= 2
    alarms = int(result[f"{branch}/alarms"])
    assert float(result[f"{branch}/exclusion_share"][0]) == pytest.approx(sum(came) / (sum(came) + alarms))
    assert f"{sum(came)}: {came[0]}, {came[1]}, {came[2]}" in said.stdout
    assert int(result[f"{branch}/stanford_vertical"].sum()) == int(result[f"{branch}/tested"])
    if keep == "errors":
        glide = result["/integrity/time"] <= 60.2
        status, excluded = result["/integrity/status"][:, glide], result["/integrity/excluded"][:, glide]
        assert int((status == EXCLUDED).sum()) == sum(came)
        np.testing.assert_array_equal(status == EXCLUDED, excluded != NOTHING)
        left = excluded == list(result["/integrity/candidate"]).index("R01")
        hpl = result["/integrity/hpl_run"][:, glide]
        plain = ~left & (status == QUIET)
        whole = np.broadcast_to(result["/integrity/hpl"][glide], hpl.shape)
        np.testing.assert_array_equal(hpl[plain], whole[plain])
        low = (hpl <= 100.0) & (result["/integrity/vpl_run"][:, glide] <= 150.0)
        assert float(result[f"{branch}/exclusions_available"][0]) == pytest.approx(low[status == EXCLUDED].mean())
        available = float((low & (status != ALARM)).mean())
        assert float(result[f"{branch}/availability"][0]) == pytest.approx(available)


def test_a_fix_without_a_pseudolite_has_none_of_its_reflections() -> None:
    """A loosely coupled filter takes the mean error by reflections off, and adds their spread to R, where the
    pseudolite is in the fix, and leaves the others as the receiver made them."""
    step = [{"what": "step", "sources": ["PL1"], "error_m": 80, "at_s": 8, "until_s": 14}]
    reflected = ("pseudolites.count=1", "pseudolites.height_m=5", "pseudolites.multipath={}")
    watched = faulty("exclusion: residual", step, *reflected)
    run = simulation.fly(watched.flight, 3, range(4))
    position, velocity = run.filter_fix_llh - run.fix_llh, run.filter_fix_velocity - run.fix_velocity
    shifted = np.abs(np.concatenate([position, velocity], axis=2)).max(axis=2) > 0.0
    number = [one.sources for one in watched.flight.candidates].index(("PL1",))
    without = run.monitor_excluded == number
    assert without.sum() > 20
    np.testing.assert_array_equal(shifted, ~without)
    _, _, _, cov = measurements.receiver_fixes(
        watched.shared, np.where(np.array(watched.shared.signals.names) == "PL1", np.nan, run.pseudorange[0]),
        run.range_rate[0],
    )  # fmt: skip
    np.testing.assert_allclose(run.filter_fix_covariance[0][without[0]], cov[without[0]], rtol=1e-9)
