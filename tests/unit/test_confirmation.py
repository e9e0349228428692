"""Runs of what an analysis recommends: which choice is recommended, and by which runs."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from navsim.landing.confirmation import Candidate, Confirmation, Errors, FlownRequirements, OfRuns, confirm
from navsim.optimization import study
from navsim.optimization.best_placement import Found
from navsim.optimization.costs import Member
from navsim.optimization.problem import Evaluated
from navsim.optimization.scenario import Optimize
from navsim.optimization.search_log import SearchLog
from navsim.results.notes import CONSISTENT
from navsim.results.schema import FILTER_QUANTITIES, MET, NOT_MET
from navsim.runner.errors import BadInput
from navsim.runner.job import Options
from navsim.runner.opening import open_job
from navsim.sweeps.job import SweepJob
from tests.conftest import SCENARIOS


def errors(value: float) -> Errors:
    """Errors of 200 runs whose RMS is `value`."""
    return {f"{name}{end}": value * by for name in FILTER_QUANTITIES
            for end, by in (("", 1.0), ("_low", 0.91), ("_high", 1.11))}  # fmt: skip


def confirmed(
    analysed: list[float],
    flown: list[float],
    small: bool = False,
    missing: int = 0,
    objective: str = "vertical",
    misplaced: int = 0,
) -> tuple[Confirmation, list[tuple[int, int]]]:
    """What comes of candidates, and which of them was flown from which run on. small: whether runs object to sigma;
    missing, misplaced: how many of the candidates miss a requirement in runs, or have too small a sigma of position."""
    calls, met = [], np.array([True, False])

    def fly(choice: np.ndarray, seed: int, first: int, runs: int) -> OfRuns:
        number = int(choice[0])
        calls.append((number, first))
        verdicts = np.array([NOT_MET if number < missing else MET, NOT_MET], object)
        found = FlownRequirements(np.zeros((2, 3)), verdicts, np.zeros(2))
        return OfRuns(errors(flown[number]), f"sigma of {number}", small, found, number < misplaced)

    def candidate(i: int) -> Callable[[], tuple[np.ndarray, float] | None]:
        return lambda: (np.array([i]), analysed[i])

    candidates: list[Candidate] = [candidate(i) for i in range(len(analysed))]
    return confirm(candidates, objective, fly, 1, 200, met), calls


def test_one_that_agrees_is_flown_once() -> None:
    found, calls = confirmed([1.0, 1.1], [1.1, 1.1])
    assert (found.best.choice[0], found.rejected, calls) == (0, (), [(0, 0)])
    assert not found.findings("vertical", str)


def test_the_verdict_is_of_the_runs_of_the_recommended_one() -> None:
    """And comes back from storage; a sigma that is too small is a finding."""
    found, _ = confirmed([0.112, 0.20, 0.21], [0.258, 0.215, 0.21], small=True)
    again = Confirmation.of(found.arrays())
    assert again.best.verdict == "sigma of 1"
    (one,) = (one for one in again.findings("2 pseudolites", str) if one.name == "sigma_of_state")
    assert (one.text, one.against) == ("2 pseudolites: sigma of 1", (CONSISTENT,))
    assert not [one for one in confirmed([1.0], [1.1])[0].findings("x", str) if one.name == "sigma_of_state"]


def test_one_that_runs_speak_against_gives_way_to_one_that_agrees() -> None:
    """The printed errors are of runs that chose nothing."""
    found, calls = confirmed([0.112, 0.12, 0.20, 0.21], [0.258, 0.25, 0.215, 0.21])
    assert found.best.choice[0] == 2
    assert [one.choice[0] for one in found.rejected] == [0, 1]
    assert calls == [(0, 0), (1, 200), (2, 400), (2, 600)]
    first, *_ = found.findings("1 pseudolite", lambda choice: f"placement {choice[0]}")
    assert first.text == (
        "1 pseudolite: placement 0 is rejected: 0.112 m by covariance analysis, 0.258 m [0.235, 0.286] in 200 runs"
    )


@pytest.mark.parametrize("flown", [[0.4, 1.6], [0.4, 1.5]])
def test_one_that_flies_better_than_all_others_is_kept_and_told(flown: list[float]) -> None:
    """Nothing is recommended that flies worse than what was rejected, and nothing is flown that cannot be better."""
    found, calls = confirmed([0.13, 1.5], flown)
    assert (found.best.choice[0], len(calls)) == (0, 1)
    told = found.findings("vertical", str)
    assert [one.name for one in told] == ["choice_worse_than_analysed"]
    assert "trust the runs" in told[0].text


def test_runs_better_than_the_analysis_are_told_and_kept() -> None:
    found, _ = confirmed([1.0, 1.1], [0.7, 1.1])
    assert (found.best.choice[0], found.rejected) == (0, ())
    assert [one.name for one in found.findings("vertical", str)] == ["choice_better_than_analysed"]


@pytest.mark.parametrize("objective", ["vertical", "pdop"])
def test_one_whose_runs_miss_a_requirement_gives_way(objective: str) -> None:
    """Though it flies better; a requirement that no analysis decides rejects nothing."""
    found, calls = confirmed([1.0, 1.1, 1.2], [1.0, 1.1, 1.2], missing=1, objective=objective)
    found = Confirmation.of(found.arrays())
    assert (found.best.choice[0], [one.choice[0] for one in found.rejected]) == (1, [0])
    assert calls == [(0, 0), (1, 200), (1, 400)]
    assert found.findings("x", str)[0].text == "x: [0] is rejected: 200 runs don't meet its requirements"


def test_one_whose_position_has_too_small_a_sigma_gives_way() -> None:
    found = Confirmation.of(confirmed([1.0, 1.1, 1.2], [1.0, 1.1, 1.2], misplaced=1)[0].arrays())
    assert (found.best.choice[0], [one.choice[0] for one in found.rejected]) == (1, [0])
    assert found.findings("x", str)[0].text == "x: [0] is rejected: in 200 runs a σ of position is too small"
    assert confirmed([1.0, 1.1], [1.0, 1.2], misplaced=2)[0].best.choice[0] == 0, "no other is better"


def test_a_level_of_a_placement_that_replaces_another_is_known() -> None:
    """By analysis: runs have errors of the filter alone."""
    outcome, first = study.SearchOutcome(0.0), np.zeros((1, 2))
    one = Member(1, 0)
    outcome.found[one] = Found(first, 20.0, {}, False, True, others=(first + 90.0,))

    def fly(choice: np.ndarray, seed: int, number: int, runs: int) -> OfRuns:
        return OfRuns(errors(1.0), "", False, small_position=not choice.any())

    def judged(places: np.ndarray) -> Evaluated:
        return Evaluated(20.0 + places[:, 0, 0], 20.0 + places[:, 0, 0], np.zeros(1))

    problem: Any = SimpleNamespace(fly=fly, judged=judged, requirements=None, study=Optimize.model_construct(
        objective="vpl_p95"), of=lambda _: problem)  # fmt: skip
    study._fly_best(problem, outcome, one, 1, 200, SearchLog())
    assert outcome.found[one].value == 110.0


def test_one_without_an_error_in_runs_is_not_confirmed() -> None:
    found, _ = confirmed([0.1, 0.2], [np.nan, 0.2])
    assert (found.best.choice[0], [one.choice[0] for one in found.rejected]) == (1, [0])


def test_arrays_hold_all() -> None:
    found, _ = confirmed([0.112, 0.20], [0.258, 0.215])
    again = Confirmation.of(found.arrays())
    assert (again.best.choice[0], len(again.rejected), again.runs) == (1, 1, 200)
    np.testing.assert_array_equal(again.rejected[0].errors, found.rejected[0].errors)


def test_a_sweep_by_covariance_can_leave_its_best_unflown() -> None:
    """`--runs 0` is of the verification; the study's own runs are another number."""
    study = SCENARIOS / "placement_sweep.yaml"
    job, _ = open_job("sweep", study, [], Options(1, 0, method="covariance"), print)
    assert isinstance(job, SweepJob)
    assert job.confirming == 0
    with pytest.raises(BadInput, match="at least"):
        open_job("sweep", study, [], Options(1, 0, method="monte-carlo"), print)
