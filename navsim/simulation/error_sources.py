"""Sources of error of a covariance analysis, each propagated through the linearised filter of a landing."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.error_propagation.linearised import NOISES
from navsim.error_propagation.sensitivity_propagation import (
    LinearisedHistory,
    propagate_columns,
    propagate_covariances,
)
from navsim.filter import states
from navsim.filter.measurement_kinds import FIX, RANGE, SOURCE
from navsim.filter.records import OUTPUT, Events
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.gnss.correlated_errors import CorrelatedErrors
from navsim.simulation.aiding import Aid
from navsim.simulation.along_truth import AlongTruth
from navsim.simulation.correlated_sources import (
    CorrelatedSources,
    SensorErrorSources,
    SmoothedRanges,
    SourceErrors,
    WanderingClockErrors,
)
from navsim.simulation.flight import Flight

SOURCES = (
    "initial_position",
    "initial_velocity",
    "initial_attitude",
    "gyro_bias",
    "accelerometer_bias",
    "gyro_noise",
    "accelerometer_noise",
    "gyro_markov",
    "accelerometer_markov",
    "satellite_ephemeris",
    "satellite_range",
    "satellite_range_rate",
    "pseudolite_range",
    "pseudolite_range_rate",
)
"""Independent random sources of error, in the order of the budget. Further errors of inertial sensors and noise of
sensors beside the receiver follow; systematic errors are a mean."""
EPHEMERIS = SOURCES.index("satellite_ephemeris")
RANGES = (SOURCES.index("satellite_range"), SOURCES.index("pseudolite_range"))
RATES = (SOURCES.index("satellite_range_rate"), SOURCES.index("pseudolite_range_rate"))

OFFSET = "system_offset"
"""The source that drawn offsets of time scales are to a receiver that takes all for one."""
SURVEY, CALIBRATION, BIAS = "pseudolite_survey", "pseudolite_clock", "pseudolite_range_bias"
"""The sources that drawn errors of the places and clocks of pseudolites are."""
AIR = "pseudolite_air"
"""The source that the drawn refractivity on the paths of pseudolites is."""
WANDERING = "pseudolite_clock_noise"
"""The source that the noise of pseudolites' clocks is."""
CORRELATED = "satellite_lasting_"
"""Prefix of the names of time-correlated ranging errors of satellites."""
CURVATURE = "range_curvature"
"""Source of error: second-order errors near sources."""
CLOCK = "receiver_clock"
"""The source that the clock's noise, and not knowing it at the start, are to a tightly coupled filter."""
NOISE_SOURCES = ("gyro_noise", "accelerometer_noise", "gyro_markov", "accelerometer_markov")
"""The sources that the sensor noises of `error_propagation.linearised` are."""


class SourceSums(NamedTuple):
    """Sums over sources."""

    variance: np.ndarray
    """(source, o, n) of the errors at the outputs."""
    covariance: np.ndarray
    """(o, n, n) of the errors at the outputs."""
    second: np.ndarray
    """(w, MOST, MOST) moments of the innovations."""


def weighed_events(
    events: Events, route: LinearisedHistory, kind: int, chosen: np.ndarray | bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Measurements of a kind that the filter uses, of chosen events: indices in the route and rows (m,)."""
    at = np.flatnonzero((events.kind == kind) & (route.weighed >= 0) & chosen)
    return route.weighed[at], events.row[at]


def propagate_noises(
    route: LinearisedHistory,
    added: np.ndarray,
    some: list[int],
    density: np.ndarray,
    noise: list[np.ndarray | None],
    out: SourceSums,
) -> None:
    """Add the effect of at most WIDTH white noise sources.

    some: the sources; density: (source, NOISES + 2) of the sensors and of the clock; noise: of measurements (w, MOST,
    MOST), if any.
    """
    n, size = route.to_error.shape
    density_of, noise_of = np.zeros((NOISES + 2, WIDTH)), np.zeros((*out.second.shape, WIDTH))
    density_of[:, : len(some)] = density.T
    for lane, of_source in enumerate(noise):
        if of_source is not None:
            noise_of[..., lane] = of_source
    variance = np.empty((*out.variance.shape[1:], WIDTH))
    # the propagated Markov biases follow the filter's states
    place = np.append(np.arange(states.SENSORS), n + np.arange(states.N_BASE - states.SENSORS))
    propagate_covariances(
        route, added, place, in_lanes(density_of), in_lanes(np.zeros((2, size, size, WIDTH))), in_lanes(noise_of),
        in_lanes(variance), out.second, out.covariance,
    )  # fmt: skip
    out.variance[some] += np.moveaxis(variance, -1, 0)[: len(some)]


def propagate_smoothed_noise(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, of_pseudolites: np.ndarray, out: SourceSums
) -> None:
    """Add the effect of smoothed range noise."""
    s = flight.shared.signals
    assert s.smoothing is not None
    own = SmoothedRanges(along.lin.assumed.shape[1], s.smoothing, s.sigma, s.used, of_pseudolites)
    propagate_correlated(
        flight, along, route, own, receiver_kind(flight), along.epoch, along.by_range, list(RANGES), out
    )


def propagate_ranging_errors(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, rows: list[int], out: SourceSums
) -> None:
    """Add the effect of time-correlated ranging errors, each kind to the variance of its row."""
    s = flight.shared.signals
    assert s.correlated is not None
    n, kinds_and_sources = along.lin.assumed.shape[1], s.correlated.sigma.shape[::2]
    followed_ = np.flatnonzero(np.isin(flight.model.declared["sensor"], (FIX, RANGE))) + states.SENSORS
    of_states = flight.correlated_of_states

    def shown(epoch: int) -> np.ndarray:
        out = np.zeros((n, *kinds_and_sources))
        out[followed_] = of_states(epoch)
        return out

    own = CorrelatedSources(n, s.correlated, s.used, s.time, shown)
    own.measure(0)
    propagate_correlated(flight, along, route, own, receiver_kind(flight), along.epoch, along.by_range, rows, out)


def propagate_clock_noise(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, row: int, out: SourceSums
) -> None:
    """Add the effect of clock noise of pseudolites."""
    s = flight.shared.signals
    assert s.wandering is not None
    n, mine, which = along.lin.assumed.shape[1], flight.transmitter_states, s.wandering.which

    def shown(time: float) -> np.ndarray:
        out = np.zeros((n, 2 * int(which.sum())))
        if mine is not None:
            out[transmitter_error_states(flight)] = mine.of_clocks(which, time)
        return out

    own = WanderingClockErrors(n, s.wandering, s.used, s.time, shown)
    slope = np.concatenate([by[..., s.wandering.which] for by in (along.by_range, along.by_rate)], axis=2)
    propagate_correlated(flight, along, route, own, receiver_kind(flight), along.epoch, slope, [row], out)


def source_names(aid: Aid) -> tuple[str, ...]:
    """Source of each time-correlated error of a sensor, without those of size 0."""
    return tuple(f"{aid.sensor.name}_{error.name}" for error in aid.sensor.errors if error.sigma > 0.0)


def sensor_error_states(flight: Flight, aid: Aid) -> np.ndarray:
    """Indices of the filter's states for the time-correlated errors of a sensor."""
    each = states.SENSORS + np.flatnonzero(flight.model.declared["sensor"] == aid.sensor.kind)
    return np.asarray(each[: len(aid.sensor.followed) * aid.sensor.components])


def transmitter_error_states(flight: Flight) -> np.ndarray:
    """Indices of the filter's states for errors of transmitters (q,)."""
    return states.SENSORS + np.flatnonzero(flight.model.declared["sensor"] == SOURCE)


def propagate_sensor_errors(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, aid: Aid, rows: list[int], out: SourceSums
) -> None:
    """Add the effect of the time-correlated errors of a sensor, each to the variance of its row."""
    n, m, sensor = along.lin.assumed.shape[1], aid.time.size, aid.sensor
    there = [k for k, error in enumerate(sensor.errors) if error.sigma > 0.0]
    errors, parts = [sensor.errors[k] for k in there], np.arange(sensor.components)
    shown = np.zeros((n, len(there), parts.size))
    for at, followed_ in zip(sensor_error_states(flight, aid).reshape(-1, parts.size), sensor.followed, strict=True):
        for k in (k for k, error in enumerate(there) if error == followed_):
            shown[at, k, parts] = sensor.state_scale * errors[k].sigma
    sigma = np.array([error.sigma for error in errors])[:, None, None] * np.ones((1, m, parts.size))
    those = CorrelatedErrors(tuple(e.name for e in errors), np.array([error.time for error in errors]), sigma)
    own = SensorErrorSources(n, those, np.ones((m, parts.size), bool), aid.time, lambda _: shown, moving=True)
    by = np.zeros((m, MAX_MEASUREMENT_SIZE, len(there), parts.size))
    by[:, : len(sensor.numbers)] = np.stack([sensor.slope @ aid.effects[k] for k in there], axis=2)
    own.measure(0)
    propagate_correlated(flight, along, route, own, sensor.kind, np.arange(m), by, rows, out)


def propagate_sensor_clock(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, aid: Aid, row: int, out: SourceSums
) -> None:
    """Add the effect of the noise and the rate of a sensor's clock."""
    assert aid.sensor.clock is not None
    n, m = along.lin.assumed.shape[1], aid.time.size
    shown, slope = np.zeros((n, 2)), np.zeros((m, MAX_MEASUREMENT_SIZE, 2))
    offset = sensor_error_states(flight, aid)[-1]
    shown[offset, 0] = shown[offset + 1, 1] = 1.0
    slope[:, : len(aid.sensor.numbers), 0] = 1.0
    own = WanderingClockErrors(n, aid.sensor.clock, np.ones((m, 1), bool), aid.time, lambda _: shown)
    propagate_correlated(flight, along, route, own, aid.sensor.kind, np.arange(m), slope, [row], out)


def receiver_kind(flight: Flight) -> int:
    """Kind of the measurements from the receiver."""
    return RANGE if flight.design.tight else FIX


def propagate_correlated(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, own: SourceErrors, kind: int, epoch: np.ndarray,
    slope: np.ndarray, rows: list[int], out: SourceSums,
) -> None:  # fmt: skip
    """Add the effect of time-correlated errors of a kind of measurements, each kind of error to the variance of its
    row.

    epoch (m,): of each measurement; slope (m, MOST, ...): derivative of the measurements by the errors, as `own` takes
    it.
    """
    events, lin = flight.events, along.lin
    n, copy = lin.assumed.shape[1], own
    was_ahead = False
    for i in range(events.time.size):
        ahead = bool(events.ahead[i])
        if ahead and not was_ahead:
            copy = own.copied()
        was_ahead = ahead
        here = copy if ahead else own
        if route.interval[i] >= 0:
            here.propagate(lin.transition[route.interval[i]])
        row, w = events.row[i], route.weighed[i]
        if events.kind[i] == OUTPUT:
            errors = here.errors(float(events.time[i]))
            np.add.at(out.variance, (rows, row), np.diagonal(errors, axis1=1, axis2=2))  # a row may come twice
            out.covariance[row] += errors.sum(axis=0)
        if events.kind[i] == kind:
            here.measure(int(epoch[row]))
        if w >= 0:
            there = np.flatnonzero(lin.have[w])
            h, gain = lin.h[w, there], lin.gain[w][:, there]
            if events.kind[i] == kind:
                moments = here.fixed(int(epoch[row]), h, gain, slope[row, there])
            else:
                moments = h @ here.states().sum(axis=0) @ h.T
                here.propagate(np.eye(n) - gain @ h)
            out.second[w][np.ix_(there, there)] += moments


def propagate_all_columns(
    route: LinearisedHistory, start_: np.ndarray, off: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Propagate columns (S, c) from the start, with measurement errors `off` (w, MOST, c).

    Returns errors at the outputs (o, n, c) and innovations (w, MOST, c).
    """
    count = start_.shape[1]
    groups = -(-count // WIDTH)

    def grouped(array: np.ndarray) -> np.ndarray:
        padded = np.zeros((*array.shape[:-1], groups * WIDTH))
        padded[..., :count] = array
        return np.moveaxis(padded.reshape(*array.shape[:-1], groups, WIDTH), -2, -3)

    def together(array: np.ndarray) -> np.ndarray:
        return np.moveaxis(array, -3, -2).reshape(array.shape[0], array.shape[2], -1)[..., :count]

    n, size = route.to_error.shape
    x, d = np.zeros((2, groups, size, WIDTH)), np.ascontiguousarray(grouped(off))
    x[0] = grouped(start_)
    seen, errors = np.zeros_like(d), np.empty((int(route.output.max(initial=-1)) + 1, groups, n, WIDTH))
    propagate_columns(route, in_lanes(x), in_lanes(d), in_lanes(seen), in_lanes(errors))
    return together(errors), together(seen)
