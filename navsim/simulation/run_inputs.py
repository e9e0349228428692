"""Inputs of runs of a landing: everything that they draw, one run in each SIMD lane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.filter.error_products import FIRST
from navsim.filter.estimate import in_all_lanes
from navsim.filter.measurement_kinds import FIX, PRODUCT, RANGE, SOURCE
from navsim.gnss.fix_states import StatedFixes, StateHistory
from navsim.sensors import imu
from navsim.simulation.dispersed_trajectory import DispersedTrajectories
from navsim.simulation.flight import (
    Flight,
    exact_clock,
    initial_clock_errors,
    initial_errors,
)
from navsim.simulation.inertial_states import true_values
from navsim.simulation.measurements import (
    ClockErrors,
    correlated_errors,
    draw_measurements,
    generators,
    range_noise,
)
from navsim.simulation.shared_truth import SharedTruth
from navsim.statistics.random_streams import generator
from navsim.trajectory.dispersion import PathDeviation


@dataclass(frozen=True)
class Inputs:
    """Everything drawn for WIDTH landings, one in each SIMD lane."""

    initial: np.ndarray
    """(9, W) errors of the navigation states at time 0, truth minus estimate."""
    dtheta: np.ndarray
    """(n, 3, W) measured angle increments, rad."""
    dv: np.ndarray
    """(n, 3, W) measured velocity increments, m/s."""
    ranges: np.ndarray
    """(e, s, W) pseudoranges (m), nan if missing."""
    rates: np.ndarray
    """(e, s, W) range rates (m/s), nan if missing."""
    phases: np.ndarray | None
    """(e, s, W) carrier phases (m) if they smooth the code, else None."""
    aided: tuple[np.ndarray, ...]
    """(m, k, W) of each sensor beside the receiver."""
    aided_exact: tuple[np.ndarray, ...]
    """(m, k, W) of each sensor beside the receiver, without errors."""
    clock: np.ndarray
    """(c, W) estimates of the clock states at time 0."""
    sensors: np.ndarray
    """(o, k, W) true values of the filter's sensor states and clock states, for its errors."""
    clipped: np.ndarray
    """(2, W) samples of gyros and of accelerometers beyond their range."""
    flown: DispersedTrajectories | None = None
    """Trajectories of the runs; None if all fly the route."""
    stated: StatedFixes | None = None
    """States of the fixes; None if fixes follow from the ranges."""
    b_values: np.ndarray | None = None
    """(e, s, M, W) B values of the ground station, m; None without."""


@dataclass(frozen=True)
class Noise:
    """Draws of WIDTH landings that their trajectories do not change: kept while the same landings fly again."""

    initial: np.ndarray
    """See `Inputs`."""
    sensors: imu.ImuDraws
    ranges: np.ndarray
    """(r, e, s, 2) see `statistics.noise.measure`."""
    aids: dict[int, np.ndarray]
    """True values of the filter's states for errors of sensors beside the receiver, by their kind: `_states_of_aid`."""
    of_aids: tuple[list[list[np.ndarray]], ...]
    """Time-correlated errors of each sensor beside the receiver, for each run: `Aid.drawn`."""
    departure: PathDeviation | None
    """Deviations from the route without guidance or go-around; None if all fly the route."""

    @classmethod
    def of(cls, flight: Flight, seed: int, runs: Sequence[int], pushes: Pushes | None = None) -> Noise:
        """Those of runs, with pushes of their trajectories. Raises ValueError for more than WIDTH."""
        if not 0 < len(runs) <= WIDTH:
            raise ValueError(f"1 to {WIDTH} runs can fly at once, not {len(runs)}")
        initial, shared = np.empty((states.SENSORS, WIDTH)), flight.shared
        for lane, run in enumerate(runs):
            initial[:, lane] = initial_errors(flight, seed, run)
        of_imu, intervals = generators(seed, runs, "imu", WIDTH), len(shared.dtheta)
        sensors = imu.ImuDraws.of(of_imu, len(runs), intervals, flight.gyro, flight.accel)
        of_aids = tuple([aid.drawn(seed, run) for aid in shared.aids] for run in runs)
        aids = {aid.sensor.kind: _states_of_aid(flight, k, seed, runs, of_aids) for k, aid in enumerate(shared.aids)}
        departure = None
        if shared.dispersion is not None:
            shift = None if pushes is None else pushes.walks(runs)
            departure = shared.dispersion.departure(seed, runs, WIDTH, shift)
        return cls(initial, sensors, range_noise(shared, seed, runs), aids, of_aids, departure)

    def lane(self, i: int) -> Noise:
        """Copy of one lane."""
        aids = {kind: values[..., i : i + 1].copy() for kind, values in self.aids.items()}
        initial, departure = self.initial[:, i : i + 1].copy(), self.departure and self.departure.lane(i)
        ranges = self.ranges[i : i + 1].copy()
        return Noise(initial, self.sensors.lane(i), ranges, aids, self.of_aids[i : i + 1], departure)

    @classmethod
    def of_lanes(cls, each: Sequence[Noise]) -> Noise:
        """Draws of one lane in the first lanes; further lanes repeat the last."""
        every = [*each, *[each[-1]] * (WIDTH - len(each))]
        aids = {kind: np.concatenate([one.aids[kind] for one in every], axis=-1) for kind in each[0].aids}
        departures = [one.departure for one in each if one.departure is not None]
        return cls(
            np.concatenate([one.initial for one in every], axis=1),
            imu.ImuDraws.of_lanes([one.sensors for one in each], WIDTH),
            np.concatenate([one.ranges for one in each]),
            aids,
            tuple(one.of_aids[0] for one in each),
            PathDeviation.of_lanes(departures, WIDTH) if departures else None,
        )


def draw_inputs(
    flight: Flight, seed: int, runs: Sequence[int], departure: PathDeviation | None = None, noise: Noise | None = None
) -> Inputs:
    """Inputs of at most WIDTH landings, numbered `runs`, of the ensemble of `seed`; further lanes repeat the last one.

    departure: their deviations from the route where these depend on what they measure; None: those of their noise.
    noise: of these runs if it is known. Raises ValueError for more.
    """
    noise = Noise.of(flight, seed, runs) if noise is None else noise
    shared, design = flight.shared, flight.design
    flown = None
    if shared.dispersion is not None:
        departure = noise.departure if departure is None else departure
        assert departure is not None
        flown = shared.dispersion.flown(departure)
    aided, aided_exact = (tuple(np.empty((*aid.exact.shape, WIDTH)) for aid in shared.aids) for _ in range(2))
    for lane, run in enumerate(runs if aided else ()):
        way = None if shared.dispersion is None or flown is None else shared.dispersion.of_run(flown, lane)
        for k, aid in enumerate(shared.aids):
            flawless = aided_exact[k][..., lane] = aid.exact_on(way)
            aided[k][..., lane] = aid.measured(seed, run, way, flawless, noise.of_aids[lane][k])
    dt = shared.imu_time[1] - shared.imu_time[0]
    exact = (shared.dtheta, shared.dv) if flown is None else (flown.dtheta, flown.dv)
    dtheta, dv, errors = imu.simulate_lanes(noise.sensors, *exact, dt, flight.gyro, flight.accel, shared.filter_index)
    true = {states.GYROS: true_values(design.sensors.blocks, errors)}
    wandered = ClockErrors.of(shared, seed, runs, WIDTH)
    correlated = correlated_errors(shared, seed, runs)
    ranges, rates, phases = draw_measurements(shared, seed, runs, WIDTH, noise.ranges, wandered, correlated, flown)
    if correlated is not None:
        true[RANGE if design.tight else FIX] = _correlated_states(flight, correlated)
    true.update(noise.aids)
    if flight.transmitter_states is not None:
        true[SOURCE] = flight.transmitter_states.true_values(shared.filter_time, seed, runs, WIDTH)
    kinds = dict.fromkeys(block.sensor for block in design.sensors.blocks if block.sensor > states.ACCELEROMETERS)
    if PRODUCT in kinds:
        true[PRODUCT] = np.zeros((shared.filter_time.size, len(FIRST), WIDTH))  # outputs add those of the error
    sensors = np.concatenate([true[kind] for kind in (states.GYROS, *kinds)], axis=1)
    clock, sensors = _clock_states(flight, seed, runs, wandered, sensors)
    stated = draw_states(shared, seed, runs)
    b_values = None
    if flight.station is not None:
        b_values = flight.station.b_values(generators(seed, runs, "lasting", WIDTH, 1))
    for lanes in (
        noise.initial,
        dtheta,
        dv,
        sensors,
        ranges,
        rates,
        *([] if phases is None else [phases]),
        *aided,
        *aided_exact,
        clock,
    ):
        lanes[..., len(runs) :] = lanes[..., len(runs) - 1 : len(runs)]
    return Inputs(
        noise.initial, dtheta, dv, ranges, rates, phases, aided, aided_exact, clock, sensors, errors.clipped, flown,
        stated, b_values,
    )  # fmt: skip


def draw_states(
    shared: SharedTruth, seed: int, runs: Sequence[int], histories: Sequence[StateHistory] | None = None
) -> StatedFixes | None:
    """States of the fixes of runs, None without; histories: see `FixStates.drawn`."""
    if shared.fix_states is None:
        return None
    of_states, of_noise = (tuple(generator(seed, run, "fix", *branch) for run in runs) for branch in ((), (1,)))
    return shared.fix_states.drawn(of_states, of_noise, shared.signals.time, WIDTH, histories)


def _correlated_states(flight: Flight, errors: np.ndarray) -> np.ndarray:
    """True values (o, k, W) of the time-correlated errors that the filter estimates at its outputs, from
    `correlated_errors`.

    They are those of the last fix, and before it those of the first one.
    """
    assumed = flight.design.correlated
    outputs = flight.shared.filter_time.size
    if assumed is None or not assumed.followed:
        return np.empty((outputs, 0, WIDTH))
    epoch = np.maximum(np.arange(outputs) - 1, 0)
    if flight.design.tight:
        mine = flight.range_errors
        out = np.empty((outputs, mine.states[0].size, WIDTH))
        for lane in range(errors.shape[-1]):
            out[..., lane] = mine.true_values(errors[..., lane])[epoch] / flight.design.sigma_scale
        return out
    effect = flight.correlated_projections
    out = np.empty((outputs, effect.shape[1], WIDTH))
    for lane in range(errors.shape[-1]):
        # one run at a time: sums over its numbers have one order
        own = np.ascontiguousarray(np.moveaxis(errors[..., lane], 0, 1))
        out[..., lane] = np.sum(effect * own[:, None], axis=(2, 3))[epoch]
    return out


def _states_of_aid(
    flight: Flight, k: int, seed: int, runs: Sequence[int], of_aids: Sequence[Sequence[Sequence[np.ndarray]]]
) -> np.ndarray:
    """True values (o, k, W) of the filter's states for the errors of sensor k, at its outputs; of_aids: see `Noise`."""
    shared, aid = flight.shared, flight.shared.aids[k]
    rate = aid.sensor.clock is not None
    out = np.empty((shared.filter_time.size, len(aid.sensor.followed) * aid.sensor.components + rate, WIDTH))
    for lane, run in enumerate(runs):
        out[..., lane] = aid.true_states(seed, run, shared.filter_time, of_aids[lane][k])
    return out


def _clock_states(
    flight: Flight, seed: int, runs: Sequence[int], wandered: ClockErrors | None, sensors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Estimates of the clock's states at time 0 (c, W), and its true values behind those of the sensors (o, k + c,
    W)."""
    if not flight.scales:
        return np.empty((0, WIDTH)), sensors
    true = in_all_lanes(exact_clock(flight))
    if wandered is not None:
        true[:, :-1] += wandered.at_filter[:, :1]
        true[:, -1:] += wandered.at_filter[:, 1:]
    clock = true[0].copy()
    for lane, run in enumerate(runs):
        clock[:, lane] -= initial_clock_errors(flight, seed, run)
    return clock, np.concatenate([sensors, true], axis=1)


class Pushes(Protocol):
    """Shifts everything that runs draw (`simulation.importance_sampling`)."""

    def inputs(self, runs: Sequence[int], inputs: Inputs) -> Inputs:
        """Inputs of runs, shifted."""

    def walks(self, runs: Sequence[int]) -> dict[int, np.ndarray]:
        """Shifts (k, n, W) of the states of the air's walks, by number of their stream."""
