"""The filter of a landing, linearised along the truth or along its own model of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.error_propagation.linearised import Linearised, Steps, empty, linearise, steps_of
from navsim.filter import states
from navsim.filter.estimate import in_all_lanes
from navsim.filter.measurement_kinds import FixTable, RangeTable
from navsim.filter.records import ImuData
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.gnss.fix_states import StatedFixes
from navsim.integrity.fix_slopes import slopes
from navsim.simulation.aiding import columns_on_ground
from navsim.simulation.flight import Flight, exact_clock, exact_start, initial_state, with_clock
from navsim.simulation.inertial_states import TrueState, true_states
from navsim.simulation.measurement_tables import measurements, table_of_all_fixes, table_of_fixes, table_of_ranges
from navsim.simulation.measurements import filter_fixes, receiver_fixes, stated_fixes, without_noise
from navsim.simulation.shared_truth import assumed_measurements

FIRST_MARKOV = 6
"""The first of six Markov biases among the states of `true_states`."""


class AlongTruth(NamedTuple):
    """The filter of a flight, linearised along the truth."""

    steps: Steps
    """Steps of its events (`error_propagation.linearised`)."""
    lin: Linearised
    """Likewise."""
    by_range: np.ndarray
    """(m, MOST, s) derivatives of the measurements by pseudoranges: m fixes, one an epoch, or m ranges, one a
    source."""
    by_rate: np.ndarray
    """(m, MOST, s) derivatives by range rates."""
    epoch: np.ndarray
    """(m,) epoch of each measurement."""
    true: tuple[TrueState, ...]
    """True errors of the inertial sensors."""


def noise_densities(flight: Flight) -> np.ndarray:
    """True densities of the sensor noises (NOISES,), with flicker noise as of `Triad.merged`."""
    gyro, accel = flight.gyro.merged(), flight.accel.merged()
    return np.array([gyro.noise_density**2, accel.noise_density**2, gyro.drive(), accel.drive()])


def along_design(flight: Flight, without: Sequence[bool] | np.ndarray) -> AlongTruth:
    """Linearise a filter along measurements without any error (`shared_truth.assumed_measurements`), with noise-free
    sensors.

    without: (s + g,) bool, sources that are missing, and transmitters on the ground after them.
    """
    ranges, rates = assumed_measurements(flight.shared)
    sources = ranges.shape[1]
    missing = np.append(np.asarray(without, bool), False)  # -1: no transmitter
    aided = [
        np.where(missing[column][:, None], np.nan, aid.exact)
        for aid, column in zip(flight.shared.aids, columns_on_ground(flight.shared.aids, sources), strict=True)
    ]
    return _along(flight, np.where(missing[:sources], np.nan, ranges), rates, aided, noisy=False)


def along_truth(flight: Flight, flags: np.ndarray | None = None, rejected: np.ndarray | None = None) -> AlongTruth:
    """Fly the filter of a flight along the truth, without noise.

    flags: (e,) of fixes that have a state, which then are exact; their errors are "ranges" and "rates" of the result.
    rejected: (e,) bool, fixes that the filter does without; None for none.
    """
    own = None if flags is None else _flagged(flight, flags, False if rejected is None else rejected)
    return _along(flight, *without_noise(flight.shared), [aid.exact for aid in flight.shared.aids], own=own)


def _flagged(flight: Flight, flags: np.ndarray, rejected: np.ndarray | bool) -> FixTable:
    """Exact fixes with these flags (e,), as the filter takes them, without rejected ones (e,)."""
    of_lanes = np.repeat(flags[:, None], WIDTH, axis=1)
    none, sigma = np.zeros((flags.size, 6, WIDTH)), flight.design.flag_sigma
    assert sigma is not None
    stated = StatedFixes(of_lanes, of_lanes, none, none)
    solved = receiver_fixes(flight.shared, *map(in_all_lanes, without_noise(flight.shared)))
    llh, velocity, _, covariance = stated_fixes(flight.shared, solved, stated, sigma, None)
    unused = stated.unused(sigma)[:, None] | np.reshape(rejected, (-1, 1, 1))
    place, speed = (np.where(unused, np.nan, m)[..., 0] for m in (llh, velocity))
    return table_of_fixes(flight.design, place, speed, covariance[..., 0])


def _along(
    flight: Flight, ranges: np.ndarray, rates: np.ndarray, aided: Sequence[np.ndarray], noisy: bool = True,
    own: FixTable | RangeTable | None = None,
) -> AlongTruth:  # fmt: skip
    """Linearise along these measurements (e, s), and those of each sensor beside the receiver (m, k).

    noisy: whether to compute the added sensor noise. own: table of fixes that have a state."""
    shared, design, gyro, accel = flight.shared, flight.design, flight.gyro, flight.accel
    if own is not None:
        epoch = np.arange(shared.signals.time.size)
        by_range, by_rate = (np.repeat(np.eye(6, 3, k)[None], epoch.size, axis=0) for k in (0, -3))
    elif design.tight:
        epoch, source = np.nonzero(shared.signals.used)
        by_range, by_rate = (
            np.zeros((epoch.size, MAX_MEASUREMENT_SIZE, shared.signals.used.shape[1])) for _ in range(2)
        )
        by_range[np.arange(epoch.size), 0, source] = by_rate[np.arange(epoch.size), 1, source] = 1.0
        own = table_of_ranges(flight, ranges, rates)
    else:
        llh, velocity, clocks, cov = filter_fixes(shared, ranges, rates)
        epoch = np.arange(shared.signals.time.size)
        by_range, by_rate = slopes(shared.signals.of_filter, ranges, rates, (llh, velocity, clocks))
        own = table_of_all_fixes(flight, llh, velocity, cov)
    true = true_states(gyro, accel)
    truth = states.declared([state.block for state in true])
    of_unit_drive = truth.copy()
    of_unit_drive["drive"] = 1.0
    mine = flight.model.declared
    steps = steps_of(float(shared.imu_time[0]), flight.events)
    lin = empty(steps, shared.filter_time.size, flight.model.states, truth)
    linearise(
        ImuData(shared.imu_time, shared.dtheta, shared.dv),
        measurements(flight, own, aided),
        flight.events,
        steps,
        initial_state(
            flight, with_clock(flight, exact_start(shared.at_filter), exact_clock(flight)[0]), flight.covariance
        ),
        flight.model,
        np.concatenate([mine, of_unit_drive]),
        mine.size + FIRST_MARKOV,
        (noise_densities(flight) > 0.0) & noisy,
        lin,
    )
    return AlongTruth(steps, lin, by_range, by_rate, epoch, true)
