"""The verdict on every state: a false belief is found by name and time, a true filter passes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from navsim.filter.states import PHI_D
from navsim.landing.case import Case
from navsim.landing.consistency import evaluate_states, ratios_of_runs
from navsim.landing.result import result
from navsim.landing.study import covariance_analysis, covariance_result, fly_all
from navsim.report import summary_tables
from navsim.report.compare import compared
from navsim.report.table import Table
from navsim.results.findings import of
from navsim.results.result import Result
from navsim.runner.consistency import Ratios
from navsim.runner.executor import threads
from navsim.runner.requirements import ExitRequirements, unmet_requirements
from navsim.simulation.run import Run
from tests.helpers import case

# small errors, in which one Gaussian is true
BRIEF = ("imu.rate_hz=10", "receiver.rate_hz=1", "duration_s=20", "filter.kind=eskf", "imu.gyro.drift_deg_h=70",
         "initial_errors.attitude_deg=1")  # fmt: skip


def ratios(flown: Case, runs: int, seed: int = 1) -> Ratios:
    return ratios_of_runs(flown, fly_all(flown, seed, 0, runs, threads(1), keep="none"))


def flown(of_case: Case, runs: int, seed: int = 1) -> Result:
    return result(of_case, fly_all(of_case, seed, 0, runs, threads(1), keep="none"), seed, keep="none")


def believing_too_little(share: float, state: int, *settings: str) -> Case:
    """A case whose filter believes in this share of the true initial sigma of one state alone."""
    right = case(*BRIEF, *settings)
    covariance = right.flight.covariance.copy()
    covariance[state] *= share
    covariance[:, state] *= share
    return replace(right, flight=replace(right.flight, covariance=covariance))


def rows(found: Result) -> dict[str, str]:
    table = summary_tables.summary_table([("x", found)])
    return {str(row.cells[0]).strip(): row.texts()[1] for row in table.rows if row.cells[1:]}


@pytest.mark.parametrize("seed", range(100, 120))
def test_a_true_filter_passes(seed: int) -> None:
    right = case(*BRIEF)
    found = ratios(right, 120, seed)
    band, verdict = evaluate_states(right, found)
    assert verdict.words.startswith("sigma right as far as 120 runs tell")
    assert not verdict.small
    assert band.low < np.nanmin(found.z) < np.nanmax(found.z) < band.high


def test_one_false_belief_is_found_by_name_and_time() -> None:
    """Heading of 0.85 of its sigma: 18 % small from the start. NEES over all states is 3 % too large, as it is by
    chance in many a run of fewer."""
    found = flown(believing_too_little(0.85, PHI_D), 1200)
    words = str(found["/summary/consistency/verdict"])
    worst, state = found["/summary/consistency/worst_z"], list(found["/summary/consistency/state"])
    z = found["/consistency/z"][:, state.index("attitude_down")]
    output = int(np.argmax(z))
    time = found["/consistency/time"][output]
    above = f"errors {100 * (z.max() - 1):.0f} % above it"
    assert words == f"sigma too small, {above}: heading at {time:g} s (z {z.max():.2f}, 1200 runs)"
    assert z[0] == pytest.approx(1.0 / 0.85, abs=0.06)
    assert state[int(np.argmax(worst))] == "attitude_down"
    (finding,) = (one for one in of(found) if one.name == "sigma_of_state")
    assert finding.text == words
    assert unmet_requirements(found, ExitRequirements(consistent=True)) == [f"--require-consistent: {words}"]
    shown = rows(found)
    assert shown["all states"] == words
    assert "position, largest and least z" not in shown  # right, as the verdict says
    beyond = 100 * found["/consistency/beyond_95"][output, state.index("attitude_down")]
    row = shown["attitude, largest and least z"]
    assert row.startswith(f"{z.max():.3f}  heading, {time:g} s\n{beyond:.1f} % > 1.96σ")
    # the least of the group, not of the state with the largest
    least = found["/summary/consistency/least_z"][[i for i, name in enumerate(state) if name.startswith("attitude")]]
    assert row.splitlines()[-1].startswith(f"least z {least.min():.3f}  ")
    assert beyond > 7.0


def test_the_tolerance_is_the_scenarios() -> None:
    found = flown(believing_too_little(0.85, PHI_D, "filter.sigma_tolerance=0.3"), 1200)
    words = str(found["/summary/consistency/verdict"])
    assert " % above sigma (significant, within the 30 % tolerance): heading at " in words
    assert found.variables["/summary/consistency/verdict"].attributes["tolerance"] == 0.3
    assert not [one for one in of(found) if one.name == "sigma_of_state"]
    assert unmet_requirements(found, ExitRequirements(consistent=True)) == []


def test_a_sigma_that_is_too_large_is_reported_and_no_finding() -> None:
    found = flown(believing_too_little(1.5, PHI_D), 300)
    assert str(found["/summary/consistency/verdict"]).startswith("sigma too large, errors 3")
    assert " % below it: heading at " in str(found["/summary/consistency/verdict"])
    assert unmet_requirements(found, ExitRequirements(consistent=True)) == []


def test_a_belief_of_nothing_and_an_exact_start() -> None:
    """Next to no sigma beside errors is the worst of all; an exact start with no error but rounding is not judged."""
    wrong = case(*BRIEF, "filter.imu.gyro.drift_deg_h=0")
    found = ratios(wrong, 8)
    assert (found.z[:, wrong.states.index("gyro_bias_x")] > 1e6).all()
    assert evaluate_states(wrong, found)[1].words.startswith("sigma too small by a factor of ")
    exact = case(*BRIEF, "initial_errors.position_m=0")
    found = ratios(exact, 64)
    assert np.isnan(found.z[0, :3]).all()
    assert np.isfinite(found.z[1:]).all()
    assert "not finite" not in evaluate_states(exact, found)[1].words


def test_heading_does_not_wrap() -> None:
    """An error across the jump of a compass is as large as across none."""
    first, second = (ratios(case(*BRIEF, f"runway.heading_deg={heading}"), 16).z[0] for heading in (0, 180))
    np.testing.assert_allclose(first, second, rtol=1e-6)


def test_a_covariance_analysis_has_the_expected_ratio() -> None:
    """An error of attitude that is believed too small by a fifth, to first order."""
    wrong = case(*BRIEF, "filter.initial.attitude_deg=0.8", "method=covariance")
    found = covariance_result(wrong, covariance_analysis(wrong), 1)
    state = list(found["/consistency/state"]).index("attitude_down")
    assert found["/consistency/z"][0, state] == pytest.approx(1.25)
    np.testing.assert_allclose(found["/consistency/z"][:, state], found["/covariance/rms"][:, state]
                               / found["/filter/sigma"][0, :, state])  # fmt: skip
    assert str(found["/summary/consistency/verdict"]).startswith("sigma too small, errors 25 % above it: ")
    assert str(found["/summary/consistency/verdict"]).endswith("(z 1.25, to first order)")
    (finding,) = (one for one in of(found) if one.name == "sigma_of_state")
    assert finding.text == str(found["/summary/consistency/verdict"])
    assert unmet_requirements(found, ExitRequirements(consistent=True)) == [f"--require-consistent: {finding.text}"]


def test_a_run_that_is_not_finite_leaves_the_others_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of forty, from 5 s on: the verdict is of 39, and says so; with more than half lost there is none."""
    flown_all, lost = Case.fly_runs, [7]

    def fly_runs(self: Case, seed: int, first: int, count: int, measured: bool = True) -> Iterator[Run]:
        for runs in flown_all(self, seed, first, count, measured):
            for run in set(lost) & set(range(first, first + len(runs.error))):
                runs.error[run - first, 5:] = runs.sigma[run - first, 5:] = np.nan
            first += len(runs.error)
            yield runs

    right = case(*BRIEF)
    whole = ratios(right, 40)
    monkeypatch.setattr(Case, "fly_runs", fly_runs)
    found = flown(right, 40)
    words = str(found["/summary/consistency/verdict"])
    assert "as far as 39 runs tell" in words
    assert words.endswith("; 1 run of 40 not finite at some outputs, and not tested there")
    z = found["/consistency/z"]
    np.testing.assert_array_equal(z[:5], whole.z[:5])
    assert np.isfinite(z).all()
    assert found.variables["/consistency/z"].attributes["runs"] == 39
    assert 0.0 < np.nanmean(found["/consistency/beyond_95"]) < 0.15
    lost.extend(range(19, 40))
    assert str(flown(right, 40)["/summary/consistency/verdict"]).endswith(
        "; 16 of 21 outputs are not finite and not tested"
    )


def test_results_beside_each_other_and_of_an_earlier_version() -> None:
    """Differences of z have numbers; a file without z says why there is no verdict."""
    right, wrong = flown(case(*BRIEF), 40, 2), flown(believing_too_little(0.6, PHI_D), 40)
    named = [("right", right), ("wrong", wrong)]
    (table,) = compared(named, [summary_tables.summary_table(named)], [])
    assert isinstance(table, Table)
    (row,) = (row for row in table.rows if str(row.cells[0]).strip() == "attitude, largest and least z")
    ratio = wrong["/summary/consistency/worst_z"][6:9].max() / right["/summary/consistency/worst_z"][6:9].max()
    assert row.texts()[-1] == f"{ratio:.3f}"
    old = Result(right.attributes, {path: v for path, v in right.variables.items()
                                    if not path.startswith("/consistency/") and path.split("/")[-1] not in
                                    ("verdict", "state", "looks", "worst_z", "worst_time", "least_z")})  # fmt: skip
    shown = summary_tables.summary_table([("old", old), ("right", right)])
    (row,) = (row for row in shown.rows if str(row.cells[0]).strip() == "all states")
    assert row.texts()[1] == "none: the file is of an earlier version without this test; run it again"
    assert row.texts()[2] == str(right["/summary/consistency/verdict"])
    assert "NEES, 15 states" in rows(old)
