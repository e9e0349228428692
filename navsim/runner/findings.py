"""Findings of a study from its runs.

Thresholds are such that a consistent filter, or one with the known deviations of docs/sigma.md, never causes a
finding.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.filter.records import NOT_USED, REJECTED
from navsim.results.findings import Finding, several
from navsim.results.notes import CONSISTENT, FIX, SIGMA_WITH_BEACONS, Note
from navsim.results.result import Result
from navsim.runner.consistency import StateVerdict
from navsim.runner.statistics import poisson_exceedance
from navsim.statistics import chi_square
from navsim.statistics.rounding import digits

FALSE_ALARM = 1e-6
"""Chance that a filter which is right causes a finding that rests on chance."""
DOUBTED = 4.0
"""Mean normalised square per degree of freedom, two sigmas, that is no accident of modelling: the filter's known faults
reach 1.6 over ensembles of the shipped scenarios (docs/filter-consistency.md)."""
BEYOND = 10.0
"""Sigmas an error never reaches: a Gaussian one does with a chance of 1e-23."""

LANDING: dict[str, tuple[tuple[str, ...], str]] = {
    "no_fix": ((FIX,), "no fix epoch in the flight, or in the part of the glide that evaluates placements"),
    "epochs_without_fix": ((FIX,), "epochs without a fix: too few usable sources, or all of them on one cone"),
    "lost_fixes": ((FIX,), "epochs without a fix: sources enough, but the least squares found no solution"),
    "fixes_without_velocity": ((FIX,), "fixes without the velocity that the filter needs"),
    "unweighed_fixes": ((FIX,), "fixes could not be used: the innovation covariance is not positive definite"),
    "rejected_fixes": ((FIX, CONSISTENT), "fixes were rejected by the innovation gate"),
    "epochs_without_range": ((FIX,), "epochs without a pseudorange: the filter goes by its other sensors"),
    "rejected_ranges": ((FIX, CONSISTENT), "epochs have ranges that were rejected by the innovation gate"),
    "not_finite": ((CONSISTENT,), "outputs are not finite numbers"),
    "covariance_not_positive": ((CONSISTENT,), "outputs have a covariance that is not positive definite"),
    "errors_beyond_sigma": ((CONSISTENT,), f"outputs have a position or velocity error beyond {BEYOND:g} sigma"),
    "sigma_position_velocity": ((CONSISTENT,), "errors of position and velocity exceed the filter's sigma"),
    "sigma_all_states": ((CONSISTENT,), "errors of all states exceed the filter's sigma"),
    "sigma_of_state": ((CONSISTENT,), "errors of a state exceed the filter's sigma at some output"),
    "innovations": ((CONSISTENT,), "innovations exceed the filter's sigma"),
    "aided_innovations": (
        (CONSISTENT,),
        "innovations of an aiding sensor exceed the filter's sigma",
    ),
    "aided_rejections": (
        (CONSISTENT,),
        "the innovation gate rejected measurements of an aiding sensor",
    ),
    SIGMA_WITH_BEACONS: ((CONSISTENT,), "the filter's sigma with these beacons is too small"),
    "silent_sensor": ((), "runs without any measurement of a sensor that measures along the route"),
    "clipped_samples": ((CONSISTENT,), "samples of inertial sensors are beyond their range and cut off"),
    "open_loop": ((CONSISTENT,), "trajectories are not those that guidance by the estimate gives"),
}
"""Possible findings of simulated landings: violated conditions, and text."""


def counted(name: str, count: int, of: int, first: float, last: float, runs: int = 1, of_runs: int = 1) -> Finding:
    """One of `LANDING` with its counts and times, s: how many of how many, in how many of how many runs."""
    against, words = LANDING[name]
    every = "no fix at all: " if count == of and name in ("epochs_without_fix", "lost_fixes") else ""
    every = "no range at all: " if count == of and name == "epochs_without_range" else every
    text = f"{every}{count} of {of} {words}{times(first, last, runs, of_runs)}"
    return Finding(name, text, against, count, of, runs, first)


def marks(names: Iterable[str]) -> np.ndarray:
    """Which of `LANDING` are among names of findings (name,) bool: all that a study of many flights keeps of each."""
    known = set(names)
    return np.array([name in known for name in LANDING])


def without_fix(found: Sequence[Finding]) -> bool:
    """Whether findings say that there was no fix, or no range, at any epoch of any run."""
    lost = ("epochs_without_fix", "lost_fixes", "unweighed_fixes", "epochs_without_range")
    share = sum(f.count / f.of for f in found if f.name in lost)
    return share > 1.0 - 1e-9 or any(f.name == "no_fix" for f in found)


def among(marked: np.ndarray, what: str, label: Callable[[int], str]) -> list[Finding]:
    """Findings of a study of many flights, from the `marks` (flight, name) of each: number of flights and the first.

    what: noun for the flights. label: name of a flight by its number.
    """
    out = []
    for (name, (against, words)), some in zip(LANDING.items(), marked.T, strict=True):
        count = int(some.sum())
        if count:
            text = f"in {count} of {some.size} {what}: {words}; the first: {label(int(np.argmax(some)))}"
            out.append(Finding(name, text, against, count, some.size, count))
    return out


def limit(degrees: float) -> float:
    """Largest mean normalised square per degree of freedom of a filter that counts as consistent.

    degrees: number of independent ones (inf: an expectation). A filter whose sigmas are off by a factor of two exceeds
    it with the probability `FALSE_ALARM`.
    """
    chance = 1.0 if math.isinf(degrees) else chi_square.quantile(1.0 - FALSE_ALARM, degrees) / degrees
    return DOUBTED * chance


def too_many(rejected: int, expected: float) -> bool:
    """Whether a gate rejected more fixes than it does by chance."""
    return poisson_exceedance(rejected, expected) < FALSE_ALARM


def times(first: float, last: float, runs: int = 1, of_runs: int = 1) -> str:
    """When something happened, s, and in how many runs, in words."""
    where = f", in {runs} of {of_runs} runs" if of_runs > 1 else ""
    return f"{where}, the first at {first:g} s" + (f", the last at {last:g} s" if last != first else "")


def doubted(name: str, whose: str, mean: float, degrees: float, runs: int = 1) -> list[Finding]:
    """The finding of a mean normalised square per degree of freedom beyond its `limit`, if it is; whose: in words."""
    if not degrees or not mean > limit(degrees):
        return []
    size = f"{digits(math.sqrt(mean))} times their expected size (mean square {digits(mean)}, expected 1)"
    text = f"{whose}, normalised by the filter's covariance, are {size}"
    return [Finding(name, text, LANDING[name][0], runs, runs, runs)]


def of_states(verdict: StateVerdict, runs: int = 1) -> list[Finding]:
    """The finding of a state whose sigma is smaller than its errors, if there is one."""
    if not verdict.small:
        return []
    return [Finding("sigma_of_state", verdict.words, LANDING["sigma_of_state"][0], runs, runs, runs)]


def rejections(
    found: Spread | None, of: int, probability: float, of_runs: int = 1, each: int | None = None
) -> list[Finding]:
    """Finding of rejections by a gate of this probability beyond chance.

    each: number of ranges used or rejected at epochs with rejected ranges.
    """
    if found is None or not too_many(found.count, (of if each is None else each) * probability):
        return []
    name = "rejected_fixes" if each is None else "rejected_ranges"
    return [counted(name, found.count, of, found.first, found.last, found.runs, of_runs)]


def rejected_of(name: str, count: int, of: int, probability: float) -> list[Finding]:
    """The finding of a sensor's measurements rejected by a gate of this probability, more than chance makes them."""
    if not too_many(count, of * probability):
        return []
    text = f"{count} of {of} measurements of the {name} were rejected by the innovation gate"
    return [Finding("aided_rejections", text, LANDING["aided_rejections"][0], count, of)]


def unheard(name: str, silent: np.ndarray, runs: int) -> Finding:
    """The finding of runs (k,) in which a sensor never measures, although it does along the route."""
    text = f"{name}: measured nothing in {silent.size} of {several(runs, 'run')}, the first run {silent[0]}"
    return Finding("silent_sensor", text, LANDING["silent_sensor"][0], silent.size, runs, silent.size)


def clipped(count: np.ndarray, of: int) -> list[Finding]:
    """Findings of samples of gyros and accelerometers beyond their range: counts (run, 2), of so many samples of
    each."""
    against, _ = LANDING["clipped_samples"]
    out = []
    for name, each in zip(("gyros", "accelerometers"), count.T, strict=True):
        if total := int(each.sum()):
            runs = int(np.count_nonzero(each))
            where = f"in {runs} of {several(each.size, 'run')}"
            text = f"{total} of {several(of, 'sample')} of the {name} are beyond their range and cut off, {where}"
            out.append(Finding("clipped_samples", text, against, total, of, runs))
    return out


def open_loops(gap: np.ndarray, tolerance: float) -> list[Finding]:
    """Findings of runs (run,) whose trajectory differs by a gap, m, from the one that guidance by its estimate
    gives."""
    against, _ = LANDING["open_loop"]
    if not (wrong := int(np.count_nonzero(~(gap <= tolerance)))):
        return []
    text = (
        f"the loop through guidance is not closed in {wrong} of {several(gap.size, 'run')}: trajectories are up to "
        f"{digits(np.max(gap))} m off those that guidance by the estimate gives"
    )
    return [Finding("open_loop", text, against, wrong, gap.size, wrong)]


def notes(texts: Iterable[str]) -> list[Finding]:
    """Warnings about the input."""
    told = (text if isinstance(text, Note) else Note(text) for text in texts)
    return [Finding(text.name, str(text), text.against) for text in told]


def of_flight(result: Result, probability: float | None, withheld: np.ndarray | None = None) -> list[Finding]:
    """Findings about a flight whose truth is not known, by `/filter` and `/innovations` of its result.

    probability: of the gate, None where rejections are found by others. withheld: (e,) bool, fixes that the filter was
    not given on purpose.
    """
    time, status = result["/innovations/time"], result["/innovations/status"]
    given = np.full(time.shape, True) if withheld is None else ~withheld
    answers = result["/filter/time"]
    finite = np.isfinite(result["/filter/position_llh"]).all(axis=1)
    finite &= np.isfinite(result["/filter/velocity_ned"]).all(axis=1)
    sigma = result["/filter/sigma"]
    out = []
    for name, mask, when, total in (
        ("unweighed_fixes", given & (status == NOT_USED), time, int(given.sum())),
        ("not_finite", ~finite, answers, answers.size),
        ("covariance_not_positive", finite & ~(sigma > 0.0).all(axis=1), answers, answers.size),
    ):
        if some := _instants(mask, when):
            out.append(counted(name, some.count, total, some.first, some.last))
    gated = status == REJECTED
    if probability is not None:
        out += rejections(_instants(gated, time), int(given.sum()), probability)
    degrees = int(result["/innovations/degrees"][~gated].sum())
    if degrees:
        mean = float(np.nansum(result["/innovations/normalized_squared"][~gated])) / degrees
        out += doubted("innovations", "innovations", mean, degrees)
    return out


def positive(covariance: np.ndarray) -> np.ndarray:
    """Positive definiteness (t,) of matrices (t, n, n), tested without their units."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = covariance / (sigma[:, :, None] * sigma[:, None, :])
    sound = np.isfinite(correlation).all(axis=(1, 2))
    least = np.full(sigma.shape[0], -1.0)
    least[sound] = np.linalg.eigvalsh(correlation[sound])[:, 0]
    return least > 0.0


def of_filter(name: str, time: np.ndarray, error: np.ndarray, sigma: np.ndarray) -> list[Finding]:
    """Findings about a filter over many runs: error (run, k, ...) and its 1 sigma (k, ...) at times (k,), s.

    Only errors that no filter may have. The filters of the companion papers are compared because some have wrong
    models; their summary shows the size of these errors.
    """
    runs, k = error.shape[:2]
    wrong = {
        "not_finite": ~np.isfinite(error).reshape(runs, k, -1).all(axis=2),
        "covariance_not_positive": ~(sigma > 0.0).reshape(1, k, -1).all(axis=2),
    }
    out = []
    for which, mask in wrong.items():
        of_runs = mask.shape[0]
        flaws = [tally(one[None]) for one in mask]
        many = Flaws(*(np.stack([getattr(one, part) for one in flaws]) for part in Flaws.__dataclass_fields__))
        if found := spread(many, 0, time):
            text = counted(which, found.count, mask.size, found.first, found.last, found.runs, of_runs)
            out.append(replace(text, text=f"{name}: {text.text}"))
    return out


def _instants(mask: np.ndarray, time: np.ndarray) -> Spread | None:
    """Number of times in one run, with the first and last one."""
    flaws = tally(mask[None])
    return spread(Flaws(flaws.count[None], flaws.first[None], flaws.last[None]), 0, time)


@dataclass(frozen=True)
class Flaws:
    """Number of each of `Flaws.NAMES` in a run, and its first and last index on its axis, -1 for never.

    Each (flaw,) int32, or (run, flaw) for many runs.
    """

    count: np.ndarray
    first: np.ndarray
    last: np.ndarray


def tally(masks: np.ndarray) -> Flaws:
    """`Flaws` of masks (..., flaw, index) bool."""
    found = masks.any(axis=-1)
    if not found.any():
        none = np.full(found.shape, -1, np.int32)
        return Flaws(np.zeros(found.shape, np.int32), none, none)
    first = np.where(found, masks.argmax(axis=-1), -1)
    last = np.where(found, masks.shape[-1] - 1 - masks[..., ::-1].argmax(axis=-1), -1)
    return Flaws(masks.sum(axis=-1).astype(np.int32), first.astype(np.int32), last.astype(np.int32))


@dataclass(frozen=True)
class Spread:
    """A flaw over all runs: number, number of runs, first and last time, s."""

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
