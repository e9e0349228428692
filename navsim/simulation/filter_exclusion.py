"""Exclusion by the monitor of a filter: after an alarm, one that never used the faulty beacons or stations takes over.

Source: `docs/theory/integrity.md`, section 10.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.filter.records import TIME_TOLERANCE, ErrorHistory
from navsim.gnss.receiver_fixes import ReceiverFixes
from navsim.integrity import exclusion, monitoring
from navsim.integrity.exclusion import NOTHING
from navsim.integrity.innovations import InnovationTest
from navsim.simulation.aiding import columns_on_ground
from navsim.simulation.filter_bank import FilterBank, ground_received
from navsim.simulation.flight import Flight
from navsim.simulation.run import MonitorOutput

_WINDOW, _P_FA = 10.0, 1e-5
"""Window, s, and false alarm probability of the test of innovations, where the scenario has none."""
Fly = Callable[[Sequence[np.ndarray]], ErrorHistory]
"""Flies the filter with these measurements (m, k, W) of sensors beside the receiver."""


def after_exclusion(
    flight: Flight,
    watched: MonitorOutput,
    errors: ErrorHistory,
    given: tuple[ReceiverFixes, np.ndarray, np.ndarray],
    aided: Sequence[np.ndarray],
    fly: Fly,
) -> MonitorOutput:
    """Monitor output after exclusions of transmitters on the ground; `errors` of runs with one change in place from the
    alarm on.

    A candidate is excluded for the rest of the run if the filter without it passes two tests: its innovations are
    consistent, and it agrees with filters that have fewer measurements still. If several have consistent innovations,
    one of them alone must pass the second. given: fixes, and the ranges and rates (e, s, W) that they are of.
    """
    bank, candidates = flight.bank, flight.candidates
    assert isinstance(bank, FilterBank)
    assert flight.watching is not None
    levels = np.repeat(monitoring.tested_levels(bank)[..., None], WIDTH, axis=2)
    nothing = np.full(watched.status.shape, float(NOTHING))
    out = MonitorOutput(watched.statistic.copy(), watched.status.copy(), watched.error.copy(), nothing, levels)
    alarm = watched.status == monitoring.ALARM
    if not alarm.any() or not candidates:
        return out
    names = flight.watching.ground
    flown = [fly(_measured_without(flight, aided, names, one.sources)) for one in candidates]
    taken = np.array([np.isin(names, one.sources) for one in candidates])
    passes = alarm & np.array([_consistent(flight, other) for other in flown])
    inside = exclusion.contained(taken, ground_received(flight))
    chosen = exclusion.alone(passes, inside)
    tried = np.flatnonzero(passes.any(axis=(1, 2)))
    banks = {int(c): bank.without(candidates[c].sources) for c in tried}
    monitored = {c: MonitorOutput.of_filter(flight, less, flown[c], *given) for c, less in banks.items()}
    for c, its in monitored.items():
        passes[c] &= its.status == monitoring.QUIET
    chosen = np.where(chosen == NOTHING, exclusion.alone(passes, inside), chosen)
    for c, its in monitored.items():
        begins = (chosen == c) & (its.status == monitoring.QUIET)
        for lane in map(int, np.flatnonzero(begins.any(axis=0))):
            epoch = int(np.argmax(begins[:, lane]))
            if out.excluded[epoch, lane] != NOTHING:
                continue
            _take_over(flight, epoch, lane, errors, flown[c])
            for name in ("statistic", "status", "error"):
                getattr(out, name)[epoch:, ..., lane] = getattr(its, name)[epoch:, ..., lane]
            settled = its.status[epoch:, lane] == monitoring.QUIET
            out.status[epoch:, lane][settled] = monitoring.EXCLUDED
            out.excluded[epoch:, lane] = c
            out.level[epoch:, :, lane] = monitoring.tested_levels(banks[c])[epoch:]
    return out


def _consistent(flight: Flight, errors: ErrorHistory) -> np.ndarray:
    """Whether innovations of a filter are as small as their sigma says, over a window before each epoch (e, W)."""
    assert flight.watching is not None
    time, events = flight.shared.filter_time[1:], flight.events
    own = np.concatenate([flight.event_of_measurement[flight.event_of_measurement >= 0],
                          *(events.rows(aid.sensor.kind) for aid in flight.shared.aids)])  # fmt: skip
    epoch = np.searchsorted(time, events.time[own] - TIME_TOLERANCE)
    own, epoch = own[epoch < time.size], epoch[epoch < time.size]
    squared, degrees = np.zeros((time.size, WIDTH)), np.zeros((time.size, WIDTH))
    np.add.at(degrees, epoch, errors.degrees[own])
    np.add.at(squared, epoch, np.where(errors.degrees[own] > 0, errors.innovation_squared[own], 0.0))
    test = flight.watching.innovations or InnovationTest(_WINDOW, _P_FA)
    return test.ratio(time, squared.T, degrees.T.astype(np.int64)).T <= 1.0


def _measured_without(
    flight: Flight, aided: Sequence[np.ndarray], names: Sequence[str], excluded: Sequence[str]
) -> list[np.ndarray]:
    """Measurements of sensors beside the receiver, nan for those of the excluded transmitters."""
    out, columns = np.append(np.isin(names, excluded), False), columns_on_ground(flight.shared.aids, 0)
    return [
        np.where(out[column][:, None, None], np.nan, measured) for column, measured in zip(columns, aided, strict=True)
    ]


def _take_over(flight: Flight, epoch: int, lane: int, errors: ErrorHistory, other: ErrorHistory) -> None:
    """Overwrite the history of a run by that of another filter from an epoch on."""
    late = flight.events.time > flight.shared.filter_time[1 + epoch]
    of_outputs = *errors.errors, errors.sigma, errors.cross
    for mine, new in zip(of_outputs, (*other.errors, other.sigma, other.cross), strict=True):
        mine[1 + epoch :, ..., lane] = new[1 + epoch :, ..., lane]
    for mine, new in zip(errors.by_event, other.by_event, strict=True):
        mine[late, ..., lane] = new[late, ..., lane]
