"""The first-order error of each run of a landing, with its exact mean and covariance.

`error_propagation.first_order` computes the errors; here are the matrices that it takes, from the covariance
analysis of the same flight, and what is drawn of its runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.error_propagation.first_order import LinearisedRun, Readings, propagate_errors
from navsim.filter import states
from navsim.filter.measurement_kinds import FIX, RANGE
from navsim.filter.records import OUTPUT, TIME_TOLERANCE
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.simulation.aiding import Aid
from navsim.simulation.along_truth import AlongTruth, along_truth
from navsim.simulation.flight import Flight, exact_clock
from navsim.simulation.landing_covariance import analyse, systematic
from navsim.simulation.measurements import without_noise
from navsim.simulation.run_inputs import Inputs
from navsim.simulation.shared_truth import SharedTruth


@dataclass(frozen=True)
class FirstOrder:
    """First-order errors of position and velocity of the runs of a flight. exact: measurements where nothing is drawn.
    mean (o, 6): of the errors at the filter's outputs, NED, m, m/s, truth - estimate."""

    route: LinearisedRun
    exact: Readings
    mean: np.ndarray

    @classmethod
    def of(cls, flight: Flight) -> FirstOrder:
        """Those of a flight."""
        along = along_truth(flight)
        shared, dt = flight.shared, flight.shared.imu_time[1] - flight.shared.imu_time[0]
        biases = [dt * np.array(triad.fixed_bias or (0.0, 0.0, 0.0)) for triad in (flight.gyro, flight.accel)]
        exact = Readings(shared.dtheta + biases[0], shared.dv + biases[1], *without_noise(shared))
        return cls(_route(flight, along), exact, systematic(flight, along)[:, states.POS : states.ATT].copy())

    def errors(self, flight: Flight, inputs: Inputs, ranges: np.ndarray) -> np.ndarray:
        """Errors (o, 6, W) of runs, by all that is drawn of them; ranges: (e, s, W), smoothed by the carrier where the
        receiver does that."""
        x = np.zeros((2, self.route.transition.shape[1], WIDTH))
        fixed = np.zeros(states.SENSORS) if flight.initial.fixed is None else flight.initial.fixed
        x[0, : states.SENSORS] = inputs.initial - fixed[:, None]
        if flight.scales:
            x[0, -len(inputs.clock) :] = exact_clock(flight)[0][:, None] - inputs.clock
        out = np.empty((*self.mean.shape, WIDTH))
        measured = Readings(inputs.dtheta, inputs.dv, ranges, inputs.rates)
        propagate_errors(
            self.route, Readings(*map(in_lanes, measured)), self._exact(flight.shared, inputs),
            flight.shared.signals.used, in_lanes(_aided_errors(flight.shared.aids, inputs)), in_lanes(x), in_lanes(out),
        )  # fmt: skip
        out += self.mean[..., None]
        return out

    def _exact(self, shared: SharedTruth, inputs: Inputs) -> Readings:
        """What runs would measure if nothing but their trajectories were drawn."""
        if inputs.flown is None:
            return self.exact
        its, flown, s = self.exact, inputs.flown, shared.signals
        lanes = (
            flown.dtheta + (its.dtheta - shared.dtheta)[..., None], flown.dv + (its.dv - shared.dv)[..., None],
            flown.ranges + (its.ranges - s.range)[..., None], flown.rates + (its.rates - s.range_rate)[..., None],
        )  # fmt: skip
        return Readings(*map(in_lanes, lanes))


def position_covariance(flight: Flight, of_pseudolites: np.ndarray) -> np.ndarray:
    """Exact covariance (o, 3, 3) of the first-order errors of position at the filter's outputs, NED, m2;
    of_pseudolites: (s,) bool. Raises AnalysisError where the analysis contradicts itself."""
    # errors of second order are no sums over draws
    analysis = analyse(flight, of_pseudolites, second_order=False)
    position = states.SLICES["position"]
    return analysis.covariance[:, position, position].copy()


def _aided_errors(aids: Sequence[Aid], inputs: Inputs) -> np.ndarray:
    """Changes (m, W) of the innovations by errors of sensors beside the receiver, one after the other."""
    off = []
    for aid, measured, exact in zip(aids, inputs.aided, inputs.aided_exact, strict=True):
        # what is not measured is not off
        error = np.where(np.isnan(measured), 0.0, measured - exact)
        off.append(np.einsum("rk,mkw->mrw", aid.sensor.slope, error))
    return np.concatenate([np.empty((0, WIDTH)), *(m.reshape(-1, WIDTH) for m in off)])


def _route(flight: Flight, along: AlongTruth) -> LinearisedRun:
    """The linearised filter of a flight."""
    shared, events, steps, lin = flight.shared, flight.events, along.steps, along.lin
    time, e, w = shared.imu_time, events.time.size, len(lin.have)
    begin = np.maximum(events.time, time[0]) - steps.length
    end = begin + steps.length
    sample = np.maximum(np.searchsorted(time, begin + TIME_TOLERANCE, side="right") - 1, 0)
    last = np.searchsorted(time, end - TIME_TOLERANCE, side="left") - 1
    interval = np.diff(time)
    shares = np.ones((e, 2))
    for k, at in enumerate((sample, last)):
        at = np.clip(at, 0, interval.size - 1)
        shares[:, k] = (np.minimum(end, time[at + 1]) - np.maximum(begin, time[at])) / interval[at]
    c_nb = 0.5 * (shared.truth.c_nb[:-1] + shared.truth.c_nb[1:])
    there = lin.have > 0.0
    has = np.append(there.any(axis=1), False)  # -1 for an event without a measurement
    weighed = np.where(has[steps.measurement], steps.measurement, -1)
    source, by = _of_sources(flight, along)
    aided = np.full((w, MAX_MEASUREMENT_SIZE), -1)
    for i in np.flatnonzero(weighed >= 0):
        if events.kind[i] in (FIX, RANGE):
            at = weighed[i]
            for one in by:
                one[events.row[i]] *= there[at, :, None]
    first = 0
    for aid in shared.aids:
        mine = np.flatnonzero((events.kind == aid.sensor.kind) & (weighed >= 0))
        count = aid.exact.shape[1]
        numbers = first + events.row[mine, None] * count + np.arange(count)
        aided[weighed[mine], :count] = np.where(there[weighed[mine], :count], numbers, -1)
        first += aid.exact.size
    return LinearisedRun(
        events.ahead, np.where(events.kind == OUTPUT, events.row, -1), steps.interval, weighed, events.row, sample,
        np.where(steps.interval >= 0, last - sample + 1, 0), shares,
        np.maximum(np.searchsorted(time, events.time - TIME_TOLERANCE) - 1, 0), lin.transition,
        lin.h * there[..., None], lin.gain * there[:, None], time, c_nb,
        np.einsum("tij,tj->ti", c_nb, shared.dv / interval[:, None]),
        along.epoch, source, *by, aided,
    )  # fmt: skip


def _of_sources(flight: Flight, along: AlongTruth) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """The source of each fix or range, -1 for all, and derivatives by ranges and rates."""
    if not flight.design.tight:
        return np.full(along.epoch.size, -1), (along.by_range.copy(), along.by_rate.copy())
    source, one = np.argmax(along.by_range[:, 0], axis=1), np.zeros((along.epoch.size, MAX_MEASUREMENT_SIZE, 1))
    by_range, by_rate = one.copy(), one.copy()
    by_range[:, 0], by_rate[:, 1] = 1.0, 1.0
    return source, (by_range, by_rate)
