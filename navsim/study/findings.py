"""What of a study its user must hear about, judged by what was flown, and kept in the result.

A finding is a warning with counts. It goes to standard error when the study is done, and into `/findings` of the
result, so that whoever opens the file later hears the same. Thresholds are such that a filter which is right, or
known to be off as docs/filter.md says, never causes one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from navsim.io.results import Result, ResultError, Variable
from navsim.study.statistics import chi_square_quantile, poisson_exceedance

FIX, CONSISTENT = "fix", "consistent"
"""What a finding speaks against: that there are fixes (`--require-fix`), that the filter is consistent
(`--require-consistent`)."""

FALSE_ALARM = 1e-6
"""Chance that a filter which is right causes a finding that rests on chance."""
DOUBTED = 4.0
"""Mean normalised square per degree of freedom, two sigmas, that is no accident of modelling: the filter's known faults
reach 1.6 over ensembles of the shipped scenarios (docs/filter-consistency.md)."""
BEYOND = 10.0
"""Sigmas an error never reaches: a Gaussian one does with a chance of 1e-23."""


@dataclass(frozen=True)
class Finding:
    """A warning. count: how many of `of` (fixes, outputs, runs, combinations) it is about, in how many runs; first:
    time of the first of them, s, nan where it has none. All 0 and nan for one without counts."""

    name: str
    text: str
    against: tuple[str, ...] = ()
    count: int = 0
    of: int = 0
    runs: int = 0
    first: float = math.nan


def limit(degrees: float) -> float:
    """The mean normalised square per degree of freedom, of so many independent ones (inf: an expectation), from which
    on a filter is doubted: what one with sigmas off by a factor of two exceeds with the chance `FALSE_ALARM`."""
    chance = 1.0 if math.isinf(degrees) else chi_square_quantile(1.0 - FALSE_ALARM, degrees) / degrees
    return DOUBTED * chance


def too_many(rejected: int, expected: float) -> bool:
    """Whether a gate rejected more fixes than it does by chance."""
    return poisson_exceedance(rejected, expected) < FALSE_ALARM


def times(first: float, last: float, runs: int = 1, of_runs: int = 1) -> str:
    """When something happened, s, and in how many runs, in words."""
    where = f", in {runs} of {of_runs} runs" if of_runs > 1 else ""
    return f"{where}, the first at {first:g} s" + (f", the last at {last:g} s" if last != first else "")


def doubted(name: str, what: str, mean: float, degrees: float, runs: int = 1) -> list[Finding]:
    """The finding of a mean normalised square per degree of freedom that is beyond its `limit`, if it is.

    what: says so, of sigmas `{factor}` times too small.
    """
    if not degrees or not mean > limit(degrees):
        return []
    text = f"{what.format(factor=f'{math.sqrt(mean):.3g}')} (mean normalised square {mean:.3g}, 1 is due)"
    return [Finding(name, text, (CONSISTENT,), runs, runs, runs)]


def sigmas_doubted(name: str, states: str, mean: float, degrees: float, runs: int = 1) -> list[Finding]:
    """`doubted` of estimation errors."""
    return doubted(name, f"errors of {states} are {{factor}} times what the filter believes", mean, degrees, runs)


def innovations_doubted(mean: float, degrees: float, runs: int = 1) -> list[Finding]:
    """`doubted` of innovations."""
    return doubted("innovations", "innovations are {factor} times what the filter believes", mean, degrees, runs)


def rejections(
    count: int, of: int, probability: float, when: str, runs: int = 1, first: float = math.nan
) -> list[Finding]:
    """The finding of fixes rejected by a gate of this probability, where they are more than chance makes them."""
    if not count or not too_many(count, of * probability):
        return []
    text = f"{count} of {of} fixes were rejected by the innovation gate{when}"
    return [Finding("rejected_fixes", text, (FIX, CONSISTENT), count, of, runs, first)]


def notes(texts: Iterable[str]) -> list[Finding]:
    """Warnings about the input."""
    return [Finding("input", text) for text in texts]


def kept(found: list[Finding]) -> dict[str, Variable]:
    """The group `/findings` of a result."""

    def column(values: list[object], kind: type, units: str, meaning: str) -> Variable:
        return Variable(("finding",), np.array(values, dtype=kind), units, meaning)

    return {
        "/findings/finding": column([f.name for f in found], object, "1", "names of what the user must hear about"),
        "/findings/text": column([f.text for f in found], object, "1", "what was found"),
        "/findings/against": column(
            [", ".join(f.against) for f in found], object, "1", "what it speaks against: fix, consistent, or neither"
        ),
        "/findings/count": column([f.count for f in found], np.int64, "1", "how many it is about"),
        "/findings/of": column([f.of for f in found], np.int64, "1", "of how many"),
        "/findings/runs": column([f.runs for f in found], np.int64, "1", "in how many runs"),
        "/findings/first": column(
            [f.first for f in found], np.float64, "s", "time of the first, nan where it has none"
        ),
    }


def of(result: Result) -> list[Finding]:
    """The findings kept in a result; none in one of an earlier version. Raises ResultError for a damaged group."""
    if "/findings/finding" not in result:
        return []
    names = ("finding", "text", "against", "count", "of", "runs", "first")
    try:
        columns = [np.atleast_1d(result[f"/findings/{name}"]) for name in names]
        return [
            Finding(str(name), str(text), tuple(str(against).split(", ")) if against else (), int(count), int(total),
                    int(runs), float(first))
            for name, text, against, count, total, runs, first in zip(*columns, strict=True)
        ]  # fmt: skip
    except (KeyError, ValueError, TypeError) as error:
        raise ResultError(f"/findings is damaged ({error})") from None


@dataclass(frozen=True)
class Flaws:
    """How often each of `Flaws.NAMES` happened in a run, and its first and last index on its axis, -1 for never; each
    (flaw,) int32, or (run, flaw) of many."""

    count: np.ndarray
    first: np.ndarray
    last: np.ndarray


def tally(masks: np.ndarray) -> Flaws:
    """`Flaws` of masks (index, flaw) bool."""
    found = masks.any(axis=0)
    size = masks.shape[0]
    if not found.any():
        none = np.full(masks.shape[1], -1, np.int32)
        return Flaws(np.zeros(masks.shape[1], np.int32), none, none)
    first = np.where(found, masks.argmax(axis=0), -1)
    last = np.where(found, size - 1 - masks[::-1].argmax(axis=0), -1)
    return Flaws(masks.sum(axis=0).astype(np.int32), first.astype(np.int32), last.astype(np.int32))


@dataclass(frozen=True)
class Spread:
    """A flaw over all runs: how often, in how many runs, first and last time, s."""

    count: int
    runs: int
    first: float
    last: float


def spread(flaws: Flaws, which: int, time: np.ndarray) -> Spread | None:
    """One of the flaws of many runs, at times (index,), s; None where it never happened."""
    count = flaws.count[:, which]
    some = count > 0
    if not some.any():
        return None
    first, last = flaws.first[some, which].min(), flaws.last[some, which].max()
    return Spread(int(count.sum(dtype=np.int64)), int(some.sum()), float(time[first]), float(time[last]))
