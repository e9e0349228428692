"""Table of the capabilities of few satellites and pseudolites by rank, and of their protection levels in an approach.

Source: `docs/theory/integrity.md`, sections 6, 7. Capabilities follow from numbers of sources alone. Levels are those
of subsets of the satellites of an approach, with the first pseudolites of the scenario or none.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from navsim.gnss import events
from navsim.gnss.pseudorange import Signals
from navsim.integrity.monitoring import Monitoring, Snapshot, tested_levels
from navsim.integrity.observability import possible
from navsim.landing.integrity import (
    ApproachLimits,
    approach_limits,
    below_limits,
    glide_of,
    least_limits,
    level_warnings,
    spread_over,
)
from navsim.landing.study import Case
from navsim.results.builder import ResultBuilder
from navsim.results.findings import kept
from navsim.results.result import Result
from navsim.results.schema import INTEGRITY_TABLE, MOST_LEVELS
from navsim.runner.attributes import root_attributes
from navsim.runner.findings import notes
from navsim.simulation.flight import Flight
from navsim.statistics.random_streams import generator

SATELLITES = (2, 3, 4, 5, 6, 7)
"""Numbers of satellites, the columns of both tables."""
PSEUDOLITES = (0, 1, 2)
"""Numbers of pseudolites, their rows."""
CELLS = len(PSEUDOLITES) * len(SATELLITES)
MOST_SUBSETS, MOST_SUBSETS_OF_FILTERS = 60, 12
"""Largest number of subsets of satellites; of more, so many are drawn. It is smaller for levels of filters, which take
a second each."""
_FLAGS = ("fix", "detection", "exclusion", "ground_loss")


@dataclass(frozen=True)
class MonitoredGlide:
    """Inputs for protection levels on the glide."""

    watching: Monitoring
    """Monitor of the fixes."""
    requirements: ApproachLimits
    """Limits."""
    signals: Signals
    """Signals of the epochs with levels."""
    satellites: np.ndarray
    """(n,) numbers of the sources that are used throughout the glide."""
    pseudolites: np.ndarray
    """(k,) numbers of the first ones."""
    epochs: int
    """Number of epochs of the whole glide."""
    flight: Flight | None
    """Whole flight if levels are the filter's, else None."""
    chosen: np.ndarray
    """(m,) numbers of the epochs with levels."""

    @property
    def subsets(self) -> int:
        """Largest number of subsets of satellites."""
        return MOST_SUBSETS if self.flight is None else MOST_SUBSETS_OF_FILTERS

    def monitor(self, sources: np.ndarray) -> Snapshot:
        """The monitor of fixes from sources with these numbers (m,) alone."""
        return self.watching.over(_of_these(self.signals, sources))

    def levels(self, sources: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Levels (m, 2) with only the sources of these numbers, at all epochs, nan without a test."""
        if self.flight is None:
            monitor = self.monitor(sources)
            return monitor.levels, tested_levels(monitor)
        shared = self.flight.shared
        bank = self.flight.over(replace(shared, signals=_of_these(shared.signals, sources))).bank
        assert bank is not None
        return bank.levels[self.chosen], tested_levels(bank)[self.chosen]

    def judged(self, sources: np.ndarray) -> np.ndarray:
        """Performance of such sources (3,): fraction of epochs with both levels within their limits; median HPL and
        VPL, m.

        A median is inf if most epochs have no level.
        """
        levels, tested = self.levels(sources)
        levels = np.where(np.isfinite(levels), levels, np.inf)
        return np.array([below_limits(self.requirements, tested).all(axis=1).mean(), *np.median(levels, axis=0)])


def _of_these(signals: Signals, sources: np.ndarray) -> Signals:
    """Signals of the sources with these numbers (m,) alone."""
    return replace(signals, used=signals.used & np.isin(np.arange(len(signals.names)), sources))


def watched(case: Case) -> MonitoredGlide:
    """Inputs for the levels of a case with limits. Raises ValueError without a fix epoch on the glide."""
    watching, asked, glide = case.flight.watching, approach_limits(case), np.flatnonzero(glide_of(case))
    assert watching is not None
    assert asked is not None
    if not glide.size:
        raise ValueError("there is no fix epoch on the glide within duration_s")
    spread = spread_over(glide, MOST_LEVELS)
    signals = case.shared.signals
    ground = np.array([system == events.PSEUDOLITES for system in case.environment.systems], bool)
    throughout = signals.used[glide].all(axis=0)
    return MonitoredGlide(
        watching, asked.at(spread), signals.at(spread), np.flatnonzero(throughout & ~ground),
        np.flatnonzero(ground)[: max(PSEUDOLITES)], glide.size, case.flight if watching.bank else None, spread,
    )  # fmt: skip


def subsets(satellites: np.ndarray, count: int, seed: int, most: int = MOST_SUBSETS) -> np.ndarray:
    """Subsets (m, count) of so many of satellites (n,): all, or a random choice of `most` different ones."""
    if math.comb(satellites.size, count) <= most:
        return np.array(list(itertools.combinations(satellites, count)), int).reshape(-1, count)
    rng = generator(seed, 0, "subsets", count)
    found: set[tuple[int, ...]] = set()
    while len(found) < most:
        found.add(tuple(sorted(rng.choice(satellites, count, replace=False).tolist())))
    return np.array(sorted(found))


def cells(here: MonitoredGlide, seed: int, done: Callable[[int], None]) -> tuple[np.ndarray, np.ndarray]:
    """Protection levels of each cell (pseudolites, satellites, 4), nan with too few sources; number of subsets
    (satellites,).

    A cell has the fraction of epochs with levels within their limits, for the worst and for the median subset; and the
    median HPL and VPL, m. More than half of the subsets reach a median.

    `done(n)` receives the number of finished cells.
    """
    out = np.full((len(PSEUDOLITES), len(SATELLITES), 4), np.nan)
    taken = np.zeros(len(SATELLITES), int)
    places = itertools.product(enumerate(SATELLITES), enumerate(PSEUDOLITES))
    for finished, ((i, count), (k, added)) in enumerate(places):
        chosen = subsets(here.satellites, count, seed, here.subsets)
        taken[i] = len(chosen)
        if len(chosen) and added <= here.pseudolites.size:
            ground = here.pseudolites[:added]
            found = np.sort([here.judged(np.concatenate([some, ground])) for some in chosen], axis=0)
            out[k, i] = found[0, 0], found[(len(found) - 1) // 2, 0], *found[len(found) // 2, 1:]
        done(finished + 1)
    return out, taken


def compute(case: Case, here: MonitoredGlide, seed: int, done: Callable[[int], None] = lambda _: None) -> Result:
    """Both tables as a result of kind integrity-table; `done(n)` receives the number of finished cells."""
    draft = ResultBuilder(INTEGRITY_TABLE)
    draft["/pseudolites"], draft["/satellites"] = np.array(PSEUDOLITES), np.array(SATELLITES)
    flags = [[possible((0,) * n, (0,) * k) for n in SATELLITES] for k in PSEUDOLITES]
    for name in _FLAGS:
        draft[f"/possible/{name}"] = np.array([[getattr(each, name) for each in row] for row in flags]).astype(np.int8)
    found, taken = cells(here, seed, done)
    for i, name in enumerate(("worst", "median", "hpl", "vpl")):
        draft[f"/subsets/{name}"] = found[..., i]
    draft["/subsets/number"] = taken
    draft["/subsets/number_of_all"] = np.array([math.comb(here.satellites.size, n) for n in SATELLITES])
    for name, numbers in (("satellite", here.satellites), ("pseudolite", here.pseudolites)):
        draft[f"/subsets/{name}"] = np.array([here.signals.names[i] for i in numbers], dtype=object)
    draft["/subsets/hal"], draft["/subsets/val"] = least_limits(here.requirements)
    if expected := here.watching.expected(here.signals):
        draft["/subsets/fault"] = np.array([fault.name for fault in expected], dtype=object)
        draft["/subsets/prior"] = np.array([fault.prior for fault in expected])
    draft.put("/glide/time", here.signals.time, {"epochs_of_glide": here.epochs})
    out = draft.result(root_attributes("integrity-table", seed, case.scenario))
    out.variables.update(
        kept(notes([*case.warnings, *level_warnings(case), *_several_clocks(here), *_still_jamming(case)]))
    )
    return out


def _still_jamming(case: Case) -> list[str]:
    """Warning if pseudolites jam."""
    jamming = case.environment.jamming
    if jamming is None or jamming.pseudolites is None:
        return []
    return ["pseudolites that a row leaves out send all the same, and jam"]


def _several_clocks(here: MonitoredGlide) -> list[str]:
    """Warning if capabilities and levels have different clock unknowns."""
    sources = np.concatenate([here.satellites, here.pseudolites])
    clocks = np.unique(here.signals.time_scale[sources]).size
    if clocks < 2:
        return []
    return [f"the sources keep {clocks} clocks, each an unknown of the fix; the table by rank assumes one clock"]
