"""Runs of what an analysis recommends: which choice is recommended, and by which runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from navsim.landing.confirmation import Candidate, Confirmation, Errors, OfRuns, confirm
from navsim.results.findings import CONSISTENT
from navsim.results.schema import FILTER_QUANTITIES
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
    analysed: list[float], flown: list[float], small: bool = False
) -> tuple[Confirmation, list[tuple[int, int]]]:
    """What comes of candidates, and which of them was flown from which run on. small: whether runs object to sigma."""
    calls = []

    def fly(choice: np.ndarray, seed: int, first: int, runs: int) -> OfRuns:
        calls.append((int(choice[0]), first))
        return OfRuns(errors(flown[int(choice[0])]), f"sigma of {int(choice[0])}", small)

    def candidate(i: int) -> Callable[[], tuple[np.ndarray, float] | None]:
        return lambda: (np.array([i]), analysed[i])

    candidates: list[Candidate] = [candidate(i) for i in range(len(analysed))]
    return confirm(candidates, "vertical", fly, 1, 200), calls


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
