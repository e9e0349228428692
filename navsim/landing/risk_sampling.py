"""Sampled integrity risk of a landing: fixes beyond their protection levels without an alarm, as `/integrity/tails`.

Source: `docs/theory/integrity.md`, section 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from navsim.integrity.araim import UP, SeparationMonitor
from navsim.integrity.monitoring import fix_of
from navsim.integrity.residuals import ChiSquareTest, Monitor
from navsim.integrity.risk_sampling import NOT_SHIFTED, TailCase, sampled, under_separations, under_squares, worst_size
from navsim.integrity.solution import MonitoredFix
from navsim.landing.case import Case
from navsim.results.builder import ResultBuilder
from navsim.runner.statistics import weighted_share
from navsim.statistics.random_streams import generator

AXES = ("east", "north", "up")
NO_FAULT = "no fault"
_AROUND = (1.0, 0.85, 0.925, 1.075, 1.15)
"""Sizes of a bias relative to the worst one under a single test; the worst of these under all tests is used."""
_PILOT = 10_000
"""Draws by which it is chosen."""


@dataclass(frozen=True)
class AssumedFault:
    """An assumed fault.

    name; taken: (s,) bool, its sources; prior: probability, nan without one; bias: (n,) whitened nominal biases.
    """

    name: str
    taken: np.ndarray
    prior: float
    beside: np.ndarray


@dataclass(frozen=True)
class SampledLevel:
    """A level at an epoch, and how often it is exceeded: numbers of `/integrity/tails`."""

    level: float
    bias: np.ndarray
    risk: np.ndarray
    effective: np.ndarray
    total: np.ndarray


def sampled_risks(draft: ResultBuilder, case: Case, seed: int) -> None:
    """Risks beyond the levels at the times that the scenario asks for, if any."""
    section, monitor, time = case.scenario.integrity, case.flight.monitor, case.shared.signals.time
    if section is None or section.tails is None or monitor is None or not time.size:
        return
    epochs = np.maximum(np.searchsorted(time, np.array(section.tails.at_s) + 1e-9, side="right") - 1, 0)
    axes = (UP,) if isinstance(monitor, Monitor) else tuple(range(len(AXES)))
    names = _names(case)
    shape = epochs.size, len(axes)
    bias, effective = (np.full((*shape, len(names)), np.nan) for _ in range(2))
    level, total = np.full(shape, np.nan), np.full((*shape, 3), np.nan)
    risk = np.full((*shape, len(names), 3), np.nan)
    fix = fix_of(case.shared.signals)
    for i, epoch in enumerate(map(int, epochs)):
        for j, axis in enumerate(axes):
            found = _at(case, fix, epoch, axis, seed)
            level[i, j], bias[i, j], risk[i, j] = found.level, found.bias, found.risk
            effective[i, j], total[i, j] = found.effective, found.total
    branch = "/integrity/tails"
    draft[f"{branch}/at"] = time[epochs]
    draft[f"{branch}/axis"] = np.array([AXES[axis] for axis in axes], dtype=object)
    draft[f"{branch}/fault"] = np.array(names, dtype=object)
    draft[f"{branch}/allowed"] = np.array([_allowed(case, axis) for axis in axes])
    for name, values in (("level", level), ("bias", bias), ("risk", risk), ("effective", effective), ("total", total)):
        draft[f"{branch}/{name}"] = values


def _names(case: Case) -> list[str]:
    signals = case.shared.signals
    if isinstance(case.flight.monitor, SeparationMonitor):
        return [NO_FAULT, *(fault.name for fault in case.flight.expected)]
    return [NO_FAULT, *(signals.names[i] for i in np.flatnonzero(signals.used.any(axis=0)))]


def _allowed(case: Case, axis: int) -> float:
    """Allowed risk of an axis."""
    assert case.flight.watching is not None
    test = case.flight.watching.test
    if isinstance(test, ChiSquareTest):
        return test.p_md
    return float(test.p_hmi[axis])


def _at(case: Case, fix: MonitoredFix, epoch: int, axis: int, seed: int) -> SampledLevel:
    """The level of an axis at an epoch."""
    monitor, section = case.flight.monitor, case.scenario.integrity
    assert isinstance(monitor, Monitor | SeparationMonitor)
    assert section is not None
    assert section.tails is not None
    # the residuals' square has a level for the vertical alone
    level = float(monitor.levels[epoch, 1] if isinstance(monitor, Monitor) else monitor.found.level[epoch, axis])
    count = len(_names(case))
    bias, effective, risk = np.full(count, np.nan), np.full(count, np.nan), np.full((count, 3), np.nan)
    if not math.isfinite(level) or not bool(monitor.tested[epoch]):
        return SampledLevel(level, bias, risk, effective, np.full(3, np.nan))
    if isinstance(monitor, Monitor):
        tail = under_squares(monitor, epoch, axis)
    else:
        tail = under_separations(fix, monitor.found, epoch, axis)
    priors = np.zeros(count)
    for k, fault in enumerate(_assumed_faults(case, fix, tail, epoch, axis)):
        if fault is None:
            continue

        def drawn(biases: np.ndarray, draws: int, part: int, k: int = k) -> tuple[np.ndarray, float]:
            found = sampled(tail, biases, level, draws, generator(seed, epoch, "integrity", axis, k, part))
            value, _, worth = weighted_share(found.log_weights, found.hits, 1.0 / NOT_SHIFTED, 1.0 / NOT_SHIFTED)
            return value, worth

        direction = tail.least_visible_bias(fault.taken)
        own = worst_size(tail, direction, fault.beside, level) * direction
        if own.any():
            pilots = [drawn(fault.beside + share * own, _PILOT, i)[0][0] for i, share in enumerate(_AROUND)]
            # nan is a probability below all that can be estimated (`weighted_share`): less than any other
            own = own * _AROUND[int(np.argmax(np.where(np.isnan(pilots), 0.0, pilots)))]
        bias[k] = float(np.abs(own * tail.unwhitened).max(initial=0.0))
        risk[k], effective[k] = drawn(fault.beside + own, section.tails.samples, len(_AROUND))
        priors[k] = fault.prior
    return SampledLevel(level, bias, risk, effective, _total(case, epoch, axis, priors, risk))


def _total(case: Case, epoch: int, axis: int, priors: np.ndarray, risk: np.ndarray) -> np.ndarray:
    """Total of the risks (k, 3), weighted by their priors, with the axis's share of unmonitored faults.

    Without priors the largest.
    """
    monitor, watching = case.flight.monitor, case.flight.watching
    assert watching is not None
    if not isinstance(monitor, SeparationMonitor) or isinstance(watching.test, ChiSquareTest):
        return np.asarray(np.nanmax(risk, axis=0))
    unmonitored = float(monitor.found.unmonitored[epoch]) * _allowed(case, axis) / watching.test.total
    # nan for faults without sources, and for probabilities below all that can be estimated
    return np.asarray(np.nansum(priors[:, None] * risk, axis=0) + unmonitored)


def _assumed_faults(
    case: Case, fix: MonitoredFix, tail: TailCase, epoch: int, axis: int
) -> Iterator[AssumedFault | None]:
    """No fault, then each of `_names`; None for those that are not there at the epoch, or not monitored."""
    monitor, signals, watching = case.flight.monitor, case.shared.signals, case.flight.watching
    assert watching is not None
    none = np.zeros(len(signals.names), bool)
    if not isinstance(monitor, SeparationMonitor):
        nothing = np.zeros(tail.used.size)
        yield AssumedFault(NO_FAULT, none, 1.0, nothing)
        for i in np.flatnonzero(signals.used.any(axis=0)):
            taken = np.arange(none.size) == i
            yield AssumedFault(signals.names[i], taken, math.nan, nothing) if signals.used[epoch, i] else None
        return
    nominal = np.array([watching.nominal[name] for name in signals.names])
    yield AssumedFault(NO_FAULT, none, 1.0, tail.biases(np.sign(fix.estimator[epoch, axis]) * nominal))
    for k, fault in enumerate(case.flight.expected):
        taken = np.isin(signals.names, fault.sources)
        # nominal biases that move the fix without the fault most
        without = monitor.found.separator[k, epoch, axis] + fix.estimator[epoch, axis]
        beside = tail.biases(np.where(taken, 0.0, np.sign(without) * nominal))
        yield AssumedFault(fault.name, taken, fault.prior, beside) if monitor.found.monitored[k, epoch] else None
