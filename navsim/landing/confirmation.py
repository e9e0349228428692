"""Confirmation of the best placements by runs: errors by Monte Carlo compared with the covariance analysis.

A covariance analysis is right only to some order. A search looks for the position where it is smallest, so it ends
where the analysis is wrong, if it is wrong anywhere. navsim therefore flies the best placements before it prints them.
It rejects one whose runs are worse than the analysis, and flies the next best with other runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from navsim.filter import states
from navsim.results.builder import ResultBuilder
from navsim.results.estimates import estimate
from navsim.results.findings import Finding, of, several
from navsim.results.notes import CONSISTENT
from navsim.results.result import Result
from navsim.results.schema import FILTER_QUANTITIES, HEIGHTS, NOT_MET
from navsim.runner.checkpoint import Arrays
from navsim.runner.executor import Executor
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from navsim.landing.case import Case
    from navsim.landing.requirements import Statement

RUNS = 200
"""Runs of a recommended flight: the interval of an RMS error is 10 % wide to each side."""
TOLERANCE = 0.1
"""Runs contradict an analysis if their 95 % interval lies beyond this share of its value."""
_PARTS = ("horizontal", "vertical")
"""Errors to report for every objective."""

Errors = Mapping[str, float]
"""Errors of the filter by name, with the ends of their intervals as `NAME_low`, `NAME_high`."""


class FlownRequirements(NamedTuple):
    """Verdicts of runs on the scenario's requirements (q,): values with intervals (q, 3), "met" and the like, further
    runs for a decision; empty without requirements."""

    value: np.ndarray = np.empty((0, 3))
    verdict: np.ndarray = np.empty(0, dtype=object)
    more_runs: np.ndarray = np.empty(0)

    @staticmethod
    def of(found: Result) -> FlownRequirements:
        """The verdicts in a landing's result."""
        branch = "/summary/requirements"
        if f"{branch}/verdict" not in found:
            return FlownRequirements()
        return FlownRequirements(*(found[f"{branch}/{name}"] for name in FlownRequirements._fields))


def put_requirements(
    draft: ResultBuilder, asked: Sequence[Statement], found: Sequence[FlownRequirements | None]
) -> list[list[str]]:
    """Write the verdicts of runs on the scenario's requirements, a row for each of several choices; None: it was not
    flown. Returns the requirements that each misses, in words."""
    shape = len(found), len(asked)
    value, more_runs, verdict = np.full((*shape, 3), np.nan), np.full(shape, np.nan), np.full(shape, "", dtype=object)
    for i, row in enumerate(found):
        if row is not None:
            value[i], verdict[i], more_runs[i] = row.value, row.verdict, row.more_runs
    branch = "/flown/requirements"
    draft[f"{branch}/requirement"] = np.arange(1, len(asked) + 1)
    draft[f"{branch}/statement"] = np.array([one.text for one in asked], dtype=object)
    draft[f"{branch}/limit"] = np.array([one.limit for one in asked])
    draft[f"{branch}/value"], draft[f"{branch}/verdict"], draft[f"{branch}/more_runs"] = value, verdict, more_runs
    return [[one.text for one, each in zip(asked, row, strict=True) if each == NOT_MET] for row in verdict]


class OfRuns(NamedTuple):
    """Results of runs of a choice: the filter's errors; the verdict on the sigmas of its states, and whether one is too
    small; verdicts on the scenario's requirements; whether a sigma of position is too small."""

    errors: Errors
    verdict: str
    small: bool
    requirements: FlownRequirements = FlownRequirements()
    small_position: bool = False


Fly = Callable[[np.ndarray, int, int, int], OfRuns]
"""Runs a choice: choice, seed, number of the first run, number of runs."""
Candidate = Callable[[], tuple[np.ndarray, float] | None]
"""A choice, a placement (k, 2) or the number of a combination (1,), and its objective by analysis; None if it has
none."""
APART = 30.0
"""Least distance between candidates, m: runs that contradict one contradict its neighbours too."""
CANDIDATES = 12
"""Largest number of choices to fly until runs agree with the analysis of one."""


def filter_outputs(tree: Result | ResultBuilder) -> dict[str, float]:
    """The filter's errors of a landing result, with the ends of their intervals as `NAME_low`, `NAME_high`: controlled
    estimates where these are better."""
    out: dict[str, float] = {}
    for name in FILTER_QUANTITIES:
        if name in _PARTS:
            interval = estimate(tree, f"/summary/rms/{name}")
        else:
            axis, height = name.split("_")
            interval = estimate(tree, f"/summary/at/{axis}", list(HEIGHTS).index(height))
        out |= dict(zip((name, f"{name}_low", f"{name}_high"), map(float, interval), strict=True))
    return out


def fly_case(case: Case, seed: int, first: int, runs: int, executor: Executor) -> Result:
    """The result of runs first ... first + runs - 1, statistics alone."""
    from navsim.landing.ensemble import fly_all
    from navsim.landing.result import result

    return result(case, fly_all(case, seed, first, runs, executor, keep="none"), seed, keep="none")


def of_runs(found: Result) -> OfRuns:
    """Summary of a landing's runs from its result."""
    small = any(one.name == "sigma_of_state" for one in of(found))
    verdict, z = found.variables["/summary/consistency/verdict"], found.variables["/consistency/z"]
    largest = np.fmax.reduce(found["/summary/consistency/worst_z"][states.SLICES["position"]])
    band = float(z.attributes["band_low"]), float(z.attributes["band_high"])
    of_position, _ = states.is_sigma_wrong(float(largest), 1.0, band, float(verdict.attributes["tolerance"]))
    return OfRuns(filter_outputs(found), str(verdict.data), small, FlownRequirements.of(found), of_position)


def interval_of(errors: Errors, name: str) -> np.ndarray:
    """An error by runs with its 95 % interval: value, low, high (3,)."""
    return np.array([errors[name], errors[f"{name}_low"], errors[f"{name}_high"]])


def is_worse(analysed: float, interval: np.ndarray) -> bool:
    """Whether the runs are significantly worse than the analysis, by more than `TOLERANCE`, or have no value."""
    if math.isfinite(analysed) and not math.isfinite(interval[0]):
        return True
    return bool(interval[1] > (1.0 + TOLERANCE) * analysed)


def is_better(analysed: float, interval: np.ndarray) -> bool:
    """Whether the runs are significantly better than the analysis, by more than `TOLERANCE`."""
    return bool(interval[2] < (1.0 - TOLERANCE) * analysed)


@dataclass(frozen=True)
class FlownChoice:
    """A choice that was flown, see `Candidate`."""

    choice: np.ndarray
    analysed: float
    """Its objective by analysis; nan where that is no error of the filter."""
    errors: np.ndarray
    """(3, 3) by runs: rows objective, horizontal, vertical; columns value, low, high."""
    verdict: str
    """As of `OfRuns`; so are the next three."""
    small: bool
    requirements: FlownRequirements
    small_position: bool = False
    missed: bool = False
    """Whether runs don't meet a requirement that the analysis meets."""

    @property
    def is_worse(self) -> bool:
        """Whether its runs are worse than the analysis."""
        return is_worse(self.analysed, self.errors[0])

    @property
    def is_contradicted(self) -> bool:
        """Whether its runs contradict the analysis."""
        return self.is_worse or self.is_excluded

    @property
    def is_excluded(self) -> bool:
        """Whether its runs forbid it, whatever their errors are."""
        return self.missed or self.small_position


@dataclass(frozen=True)
class Confirmation:
    """Runs of the best choices. best: the recommended one, with runs that chose nothing. rejected: the others, with the
    runs that contradicted them. runs: number of runs of each."""

    best: FlownChoice
    rejected: tuple[FlownChoice, ...]
    runs: int

    def arrays(self) -> Arrays:
        """Arrays for storage; `of` restores the object."""
        every = (self.best, *self.rejected)
        return {
            "choice": np.array([one.choice for one in every]), "analysed": np.array([one.analysed for one in every]),
            "errors": np.array([one.errors for one in every]), "runs": np.array(self.runs),
            "verdict": np.array([one.verdict for one in every]), "small": np.array([one.small for one in every]),
            "small_position": np.array([one.small_position for one in every]),
            "missed": np.array([one.missed for one in every]),
            "requirement_value": np.array([one.requirements.value for one in every]),
            "requirement_verdict": np.array([one.requirements.verdict.astype(str) for one in every]),
            "requirement_more_runs": np.array([one.requirements.more_runs for one in every]),
        }  # fmt: skip

    @staticmethod
    def of(arrays: Arrays) -> Confirmation:
        """Restore the object from `arrays`."""
        of_requirements = (f"requirement_{name}" for name in FlownRequirements._fields)
        names = ("choice", "analysed", "errors", "verdict", "small", "small_position", "missed", *of_requirements)
        best, *rejected = (
            FlownChoice(
                choice,
                float(value),
                errors,
                str(verdict),
                bool(small),
                FlownRequirements(*of),
                bool(sigma),
                bool(missed),
            )
            for choice, value, errors, verdict, small, sigma, missed, *of in zip(
                *(arrays[name] for name in names), strict=True
            )
        )
        return Confirmation(best, tuple(rejected), int(arrays["runs"]))

    def findings(self, whose: str, label: Callable[[np.ndarray], str]) -> list[Finding]:
        """Findings about rejected choices, and about a recommended one whose runs do not agree. whose: prefix of the
        messages; label: makes the text of a choice."""
        out = []
        for one in self.rejected:
            runs = several(self.runs, "run")
            why = f"{runs} don't meet its requirements" if one.missed else f"in {runs} a σ of position is too small"
            why = self._both(one) if one.is_worse else why
            text = f"{whose}: {label(one.choice)} is rejected: {why}"
            out.append(Finding("rejected_choice", text))
        if self.best.is_worse:
            text = f"{whose}: covariance analysis and runs do not agree: {self._both(self.best)}; trust the runs"
            text += "; nothing else that was flown is better" if self.rejected else ""
            out.append(Finding("choice_worse_than_analysed", text, (CONSISTENT,)))
        elif is_better(self.best.analysed, self.best.errors[0]):
            text = f"{whose}: runs are better than the covariance analysis says: {self._both(self.best)}"
            out.append(Finding("choice_better_than_analysed", text))
        if self.best.small:
            out.append(Finding("sigma_of_state", f"{whose}: {self.best.verdict}", (CONSISTENT,)))
        return out

    def _both(self, one: FlownChoice) -> str:
        value, low, high = one.errors[0]
        runs = several(self.runs, "run")
        in_runs = f"{digits(value)} m [{digits(low)}, {digits(high)}] in {runs}"
        return f"{digits(one.analysed)} m by covariance analysis, {in_runs}"


def confirm(
    candidates: Iterable[Candidate], objective: str, fly: Fly, seed: int, runs: int, met: np.ndarray | None = None
) -> Confirmation:
    """Fly candidates, the best by analysis first, until runs agree with the analysis of one, or no remaining analysis
    is better than the runs so far.

    The function recommends the candidate whose runs agree, unless another one flies better. Each candidate has its own
    runs. After several candidates, the recommended one is flown once more: the runs that chose it are biased. met:
    requirements (q,) bool that each candidate meets by analysis; runs that don't meet one contradict it.
    """
    tried: list[FlownChoice] = []
    of_filter = objective in FILTER_QUANTITIES

    def flown(choice: np.ndarray, analysed: float, number: int) -> FlownChoice:
        found = fly(choice, seed, number * runs, runs)
        first = interval_of(found.errors, objective) if of_filter else np.full(3, np.nan)
        rows = np.array([first, *(interval_of(found.errors, name) for name in _PARTS)])
        known = analysed if of_filter else math.nan
        missed = met is not None and bool((found.requirements.verdict[met] == NOT_MET).any())
        return FlownChoice(
            choice, known, rows, found.verdict, found.small, found.requirements, found.small_position, missed
        )

    def size(one: FlownChoice) -> float:
        return float(one.errors[0, 0]) if np.isfinite(one.errors[0, 0]) else math.inf

    for candidate in candidates:
        if (found := candidate()) is None:
            continue
        if any(found[1] >= one.errors[0, 0] for one in tried if not one.is_excluded):
            break
        tried.append(flown(*found, len(tried)))
        if not tried[-1].is_contradicted:
            break
    best = min([one for one in tried if not one.is_excluded] or tried, key=size)
    if not tried[-1].is_contradicted and best.errors[0, 2] >= tried[-1].errors[0, 1]:
        best = tried[-1]
    rejected = tuple(one for one in tried if one is not best and one.is_contradicted)
    if len(tried) > 1:
        best = flown(best.choice, best.analysed, len(tried))
    return Confirmation(best, rejected, runs)
