"""Linear covariance analysis of a landing: the statistics of many runs, from matrices alone.

Truth and filter are two models. The filter's own covariance gives the gains. Every source of error is then propagated
separately through the linearised loop with its true statistics:

- initial errors, sensor biases and noises;
- orbits and clocks of satellites, ranging noise of satellites and of pseudolites;
- the receiver clock if a tightly coupled filter estimates it;
- systematic errors.

Their sum is the true covariance, whatever the filter model, and the terms are the error budget.

The propagated state has nine navigation errors, the negative sensor states of the filter, and the true sensor states.
The filter's error of a state is the sum of those with the same meaning. An error drawn once a run (initial error,
constant bias, orbit, clock) is propagated as the effect of its one sigma; noise is propagated as a covariance
(`filter.sensitivity_propagation`). Noise of carrier-smoothed ranges is correlated in time: see `SmoothedRanges`.

Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.defect import Defect
from navsim.filter import states
from navsim.filter.design import SensorDesign, clock_sigma
from navsim.filter.linearised import NOISES, Linearised, Steps, empty, linearise, steps_of
from navsim.filter.measurement_models import FIX, RANGE, FixTable, RangeTable
from navsim.filter.records import OUTPUT, Events, ImuData
from navsim.filter.sensitivity_propagation import (
    LinearisedHistory,
    propagate_columns,
    propagate_covariances,
    propagate_excess,
)
from navsim.filter.states import MAX_MEASUREMENT_SIZE, Block
from navsim.gnss.correlated_errors import CorrelatedErrors
from navsim.gnss.pseudorange import Signals
from navsim.integrity.fix_slopes import slopes
from navsim.simulation.aiding import Aid
from navsim.simulation.correlated_sources import (
    CorrelatedSources,
    SensorErrorSources,
    SmoothedRanges,
    SourceErrors,
    WanderingClockErrors,
    white_noise,
)
from navsim.simulation.inertial_states import TrueState, followed, true_states
from navsim.simulation.landing import Flight, InitialErrors, exact_clock, exact_start, initial_state, with_clock
from navsim.simulation.measurement_tables import measurements, table_of_all_fixes, table_of_ranges
from navsim.simulation.measurements import receiver_fixes
from navsim.simulation.range_curvature import NEGLIGIBLE, Curvature, has_near_sources, range_forms
from navsim.simulation.shared_truth import assumed_measurements, without_noise

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
_EPHEMERIS = SOURCES.index("satellite_ephemeris")
_RANGES = (SOURCES.index("satellite_range"), SOURCES.index("pseudolite_range"))
_RATES = (SOURCES.index("satellite_range_rate"), SOURCES.index("pseudolite_range_rate"))

OFFSET = "system_offset"
"""The source that drawn offsets of time scales are to a receiver that takes all for one."""
SURVEY, CALIBRATION = "pseudolite_survey", "pseudolite_clock"
"""The sources that drawn errors of the places and clocks of pseudolites are."""
WANDERING = "pseudolite_clock_noise"
"""The source that the noise of pseudolites' clocks is."""
CORRELATED = "satellite_lasting_"
"""Prefix of the names of time-correlated ranging errors of satellites."""
CURVATURE = "range_curvature"
"""Source of error: second-order errors near sources."""
CLOCK = "receiver_clock"
"""The source that the clock's noise, and not knowing it at the start, are to a tightly coupled filter."""
_NOISES = ("gyro_noise", "accelerometer_noise", "gyro_markov", "accelerometer_markov")
"""The sources that the sensor noises of `filter.linearised` are."""

_MARKOV = 6
"""The first of six Markov biases among the states of `true_states`."""

_EXPECTED_NIS = 0.01
"""Largest deviation from 1 of the expected normalised innovation squared, per degree of freedom, of a filter whose
model equals the truth."""


class AnalysisError(Defect):
    """The analysis contradicts itself."""


@dataclass(frozen=True)
class Analysis:
    """True accuracy of the filter to first order."""

    sources: tuple[str, ...]
    """Names of the random sources of error."""
    variance: np.ndarray
    """(source, t, n) due to each of them."""
    mean: np.ndarray
    """(t, n) due to systematic errors and fixed values."""
    covariance: np.ndarray
    """(t, n, n) due to all sources, without the mean."""
    assumed: np.ndarray
    """(t, n, n) filter covariance."""
    nis: np.ndarray
    """(e,) expected normalised innovation squared, nan without a fix."""
    degrees: np.ndarray
    """(e,) its degrees of freedom."""
    aided: dict[str, np.ndarray]

    def expected_square(self, states_: slice | np.ndarray) -> np.ndarray:
        """Expected normalised squared error of some states, or of those of numbers (k,), per degree of freedom (t,);
        nan of none."""
        numbers = np.arange(self.mean.shape[1])[states_]
        if not numbers.size:
            return np.full(len(self.mean), np.nan)
        second = self.covariance + self.mean[:, :, None] * self.mean[:, None, :]
        assumed, second = (p[:, numbers[:, None], numbers] for p in (self.assumed, second))
        return np.trace(np.linalg.solve(assumed, second), axis1=1, axis2=2) / numbers.size


class _Augmented:
    """Propagated state: navigation errors, minus the filter's estimates of its sensor states, and the true sensor
    states.

    n: states of the filter; size: S, all states; to_error (n, S): matrix to the filter's errors; markov: indices of the
    Markov biases; decay (t,): of the true states, 1/s.
    """

    def __init__(self, followed: Sequence[Block], true: Sequence[Block], scales: int):
        """scales: number of time scales with a clock bias of the filter. Clock states are the errors themselves."""
        mine, truth = states.declared(followed), states.declared(true)
        self.clock = states.SENSORS + mine.size, scales
        self.n = states.SENSORS + mine.size + states.clock_states(scales)
        self.size = self.n + truth.size
        self.decay = truth["decay"]
        self.to_error = np.zeros((self.n, self.size))
        self.to_error[:, : self.n] = np.eye(self.n)
        means = [np.stack([d["triad"], d["axis"], d["signal"]], axis=1) for d in (mine, truth)]
        same = (means[0][:, None] == means[1][None]).all(axis=2)
        self.to_error[states.SENSORS : self.clock[0], self.n :] = same
        self.markov = self.n + _MARKOV + np.arange(states.N_BASE - states.SENSORS)

    def route(self, events: Events, steps: Steps, lin: Linearised) -> LinearisedHistory:
        """Effect of the events on the state."""
        ends = steps.interval >= 0
        length = np.zeros(lin.transition.shape[0])
        length[steps.interval[ends]] = steps.length[ends]
        own = np.diagonal(lin.transition, axis1=1, axis2=2)[:, states.SENSORS :]
        has = np.append(lin.have.any(axis=1), False)  # -1 for an event without a measurement
        return LinearisedHistory(
            events.ahead,
            np.where(events.kind == OUTPUT, events.row, -1),
            steps.interval,
            np.where(has[steps.measurement], steps.measurement, -1),
            np.concatenate([lin.transition[:, : states.SENSORS], lin.inputs], axis=2),
            np.concatenate([own, np.exp(-length[:, None] * self.decay)], axis=1),
            length,
            lin.h @ self.to_error,
            lin.gain,
            self.to_error,
            self.clock,
        )


class AlongTruth(NamedTuple):
    """The filter of a flight, linearised along the truth."""

    steps: Steps
    """Steps of its events (`filter.linearised`)."""
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


def _densities(flight: Flight) -> np.ndarray:
    """True densities of the sensor noises (NOISES,), with flicker noise as of `Triad.merged`."""
    gyro, accel = flight.gyro.merged(), flight.accel.merged()
    return np.array([gyro.noise_density**2, accel.noise_density**2, gyro.drive(), accel.drive()])


def along_design(flight: Flight, without: Sequence[bool] | np.ndarray) -> AlongTruth:
    """Linearise a filter along measurements without any error (`shared_truth.assumed_measurements`), with noise-free
    sensors.

    without: (s,) bool, sources that are missing.
    """
    ranges, rates = assumed_measurements(flight.shared)
    return _along(flight, np.where(without, np.nan, ranges), rates, noisy=False)


def along_truth(flight: Flight) -> AlongTruth:
    """Fly the filter of a flight along the truth, without noise."""
    return _along(flight, *without_noise(flight.shared))


def _along(flight: Flight, ranges: np.ndarray, rates: np.ndarray, noisy: bool = True) -> AlongTruth:
    """Linearise along these measurements (e, s); noisy: whether to compute the added sensor noise."""
    shared, design, gyro, accel = flight.shared, flight.design, flight.gyro, flight.accel
    own: FixTable | RangeTable
    if design.tight:
        epoch, source = np.nonzero(shared.signals.used)
        by_range, by_rate = (
            np.zeros((epoch.size, MAX_MEASUREMENT_SIZE, shared.signals.used.shape[1])) for _ in range(2)
        )
        by_range[np.arange(epoch.size), 0, source] = by_rate[np.arange(epoch.size), 1, source] = 1.0
        own = table_of_ranges(flight, ranges, rates)
    else:
        llh, velocity, clocks, cov = receiver_fixes(shared, ranges, rates)
        epoch = np.arange(shared.signals.time.size)
        by_range, by_rate = slopes(shared.signals, ranges, rates, (llh, velocity, clocks))
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
        measurements(flight, own, [aid.exact for aid in shared.aids]),
        flight.events,
        steps,
        initial_state(
            flight, with_clock(flight, exact_start(shared.at_filter), exact_clock(flight)[0]), flight.covariance
        ),
        flight.model,
        np.concatenate([mine, of_unit_drive]),
        mine.size + _MARKOV,
        (_densities(flight) > 0.0) & noisy,
        lin,
    )
    return AlongTruth(steps, lin, by_range, by_rate, epoch, true)


def analyse(
    flight: Flight, of_pseudolites: np.ndarray, along: AlongTruth | None = None, second_order: bool = True
) -> Analysis:
    """Accuracy of a flight's filter.

    of_pseudolites: (s,) bool, which sources are pseudolites. along: if known already. second_order: with second-order
    errors due to near sources. Raises AnalysisError if the result contradicts itself.
    """
    shared, design, gyro, accel = flight.shared, flight.design, flight.gyro, flight.accel
    along = along or along_truth(flight)
    _, lin, by_range, by_rate, epoch, true = along
    s, events, e, outputs = shared.signals, flight.events, shared.signals.time.size, shared.filter_time.size
    own = tuple(dict.fromkeys((*SOURCES, *(state.source for state in true))))
    placed = () if s.space is None else tuple(np.flatnonzero(s.space[:, of_pseudolites].any(axis=(0, 1))).tolist())
    own += tuple(dict.fromkeys(SURVEY if column < 3 else CALIBRATION for column in placed))
    own += (OFFSET,) if s.offset is not None else ()
    own += (CLOCK,) if flight.scales else ()
    own += () if s.correlated is None else tuple(CORRELATED + name for name in s.correlated.names)
    own += () if s.wandering is None else (WANDERING,)
    own += tuple(dict.fromkeys(name for aid in shared.aids for name in _source_names(aid)))
    curvature = _true_curvature(flight) if second_order else None
    own += (CURVATURE,) if curvature is not None or (second_order and design.tight and has_near_sources(s)) else ()
    sources = (*own, *(aid.sensor.name for aid in shared.aids))
    carried, route = _route(flight, along)
    n = carried.n
    kind = RANGE if design.tight else FIX
    weighed, row = _weighed(events, route, kind)
    there = lin.have > 0.0
    both = there[weighed, :, None] & there[weighed, None, :]

    # white noise at each measurement, by its source: covariance (w, MOST, MOST)
    noise = {
        source: np.zeros((*there.shape, MAX_MEASUREMENT_SIZE))
        for source in (*_RATES, *_RANGES, *range(len(own), len(sources)))
    }
    for which, chosen in enumerate((~of_pseudolites, of_pseudolites)):
        of_rates = white_noise(by_rate, s.rate_sigma, s.used, chosen, epoch)
        noise[_RATES[which]][weighed] = np.where(both, of_rates[row], 0.0)
        if s.smoothing is None:
            of_ranges = white_noise(by_range, s.sigma, s.used, chosen, epoch)
            noise[_RANGES[which]][weighed] = np.where(both, of_ranges[row], 0.0)
    if curvature is not None:
        noise[sources.index(CURVATURE)] = np.zeros((*there.shape, MAX_MEASUREMENT_SIZE))
        noise[sources.index(CURVATURE)][weighed] = np.where(both, curvature.white[epoch][row], 0.0)
    for k, aid in enumerate(shared.aids):
        (at, its), numbers = _weighed(events, route, aid.sensor.kind), np.arange(aid.sigma.shape[1])
        spread = np.where(there[at][:, numbers, None], aid.sensor.slope * aid.sigma[its, None, :], 0.0)
        noise[len(own) + k][at[:, None, None], numbers[:, None], numbers] = spread @ np.swapaxes(spread, 1, 2)
    out = _Sums(
        np.zeros((len(sources), outputs, n)), np.zeros((outputs, n, n)), np.zeros((*there.shape, MAX_MEASUREMENT_SIZE))
    )
    density = np.zeros((len(sources), NOISES + 2))
    density[[SOURCES.index(name) for name in _NOISES], np.arange(NOISES)] = _densities(flight)
    if flight.scales:
        density[sources.index(CLOCK), NOISES:] = shared.clock_density
    # Markov biases are states of the truth; no other noise acts on one
    markov = np.flatnonzero(density[:, 2:NOISES].any(axis=1)).tolist()
    others = [*np.flatnonzero(density[:, :2].any(axis=1) | density[:, NOISES:].any(axis=1)).tolist(), *noise]
    for group, chosen in ((others, np.arange(n)), (markov, np.append(np.arange(n), carried.markov))):
        for first in range(0, len(group), WIDTH):
            some = group[first : first + WIDTH]
            _propagate_noises(route.of(chosen), lin.added, some, density[some], [noise.get(k) for k in some], out)
    if s.smoothing is not None:
        _propagate_smoothed_noise(flight, along, route, of_pseudolites, out)
    if s.correlated is not None:
        _propagate_ranging_errors(
            flight, along, route, [sources.index(CORRELATED + name) for name in s.correlated.names], out
        )
    if s.wandering is not None:
        _propagate_clock_noise(flight, along, route, sources.index(WANDERING), out)
    for aid in shared.aids:
        if names := _source_names(aid):
            _propagate_sensor_errors(flight, along, route, aid, [sources.index(name) for name in names], out)

    # a column for systematic errors, then one for each error that is drawn once
    columns, owner = _at_start(carried, sources, flight.initial, true)
    messages = _messages(s, by_range, epoch)
    felt = messages.any(axis=(0, 1))
    messages, first = messages[:, :, felt], columns.shape[1]
    owner = np.append(owner, _owners(own, of_pseudolites)[: felt.size][felt])
    if s.offset is not None:
        messages = np.concatenate([messages, np.where(s.used[epoch, None], by_range, 0.0) @ s.offset], axis=2)
        owner = np.append(owner, np.full(s.offset.shape[1], sources.index(OFFSET)))
    if curvature is not None:
        messages = np.concatenate([messages, curvature.correlated[epoch]], axis=2)
        owner = np.append(owner, np.full(curvature.correlated.shape[2], sources.index(CURVATURE)))
    columns = np.pad(columns, ((0, 0), (0, messages.shape[2])))
    off = np.zeros((*there.shape, owner.size))
    off[:, :, 0] = lin.z
    if curvature is not None:  # the filter removed the mean of its model
        off[weighed, :, 0] += np.where(there[weighed], curvature.mean[epoch][row], 0.0)
    off[weighed, :, first:] = np.where(there[weighed, :, None], messages[row], 0.0)
    errors, seen = _propagate_columns(route, columns, off)
    for aid in shared.aids:
        mean = np.repeat(aid.sensor.mean_errors[list(aid.sensor.followed)], aid.sensor.components)
        errors[:, _states_of(flight, aid), 0] += aid.sensor.state_scale * mean
    for source in set(owner[1:].tolist()):
        out.variance[source] += np.sum(errors[:, :, owner == source] ** 2, axis=2)
    out.covariance[...] += errors[:, :, 1:] @ np.swapaxes(errors[:, :, 1:], 1, 2)
    out.second[...] += seen[:, :, 1:] @ np.swapaxes(seen[:, :, 1:], 1, 2)

    if design.tight and CURVATURE in sources:
        _add_range_curvature(flight, along, route, sources.index(CURVATURE), out, errors)

    # missing components are 0, and any expected value for them has no effect
    expected = lin.expected + np.eye(MAX_MEASUREMENT_SIZE) * ~there[:, :, None]
    solved = np.linalg.solve(expected, np.concatenate([out.second, seen[:, :, :1]], axis=2))
    of_mean = np.sum(seen[:, :, 0] * solved[:, :, MAX_MEASUREMENT_SIZE], axis=1)
    square = np.trace(solved[:, :, :MAX_MEASUREMENT_SIZE], axis1=1, axis2=2) + of_mean
    nis, degrees, systematic = np.full(e, np.nan), np.zeros(e, np.int64), np.zeros(e)
    kept = ~events.ahead
    weighed, row = _weighed(events, route, kind, kept)
    nis[epoch[row]] = 0.0
    for total, each in ((nis, square[weighed]), (systematic, of_mean[weighed]), (degrees, there[weighed].sum(axis=1))):
        np.add.at(total, epoch[row], each)
    aided = {}
    for aid in shared.aids:
        weighed, _ = _weighed(events, route, aid.sensor.kind, kept)
        aided[aid.sensor.name] = np.array([square[weighed].sum(), there[weighed].sum()], float)
    analysis = Analysis(sources, out.variance, errors[:, :, 0].copy(), out.covariance, lin.assumed, nis, degrees, aided)
    white = (
        s.smoothing is None and s.space is None and s.offset is None and s.correlated is None and s.wandering is None
    )
    white &= design.sigma_scale == 1.0 and second_order and curvature is None and flight.range_curvature is None
    white &= s.reflections is None
    white &= all(aid.sensor.is_true_model for aid in shared.aids)
    # every true error has its state, and all equal the filter model
    matched = carried.to_error[states.SENSORS :, n:].any(axis=0).all()
    inertial = tuple(b for b in design.sensors.blocks if b.triad in (states.GYROS, states.ACCELEROMETERS))
    matched &= _same(replace(design.sensors, blocks=inertial), followed(gyro, accel, design.sensors.blocks))
    if design.clock is not None:
        matched &= np.allclose(design.clock, shared.clock_density, rtol=1e-12, atol=0.0)
    begins = np.allclose(lin.assumed[0], analysis.covariance[0], rtol=1e-9, atol=0.0)
    # a constant bias beside a Markov one exceeds the filter's one state for each bias
    can_follow = all(not t.markov or (not t.bias and t.fixed_bias is None) for t in (gyro, accel))
    _check(analysis, matched=bool(white and matched and begins and can_follow and np.all(systematic < 1e-3)))
    return analysis


def _true_curvature(flight: Flight) -> Curvature | None:
    """True second-order errors of fixes, if the filter model includes any.

    They are due to all time-correlated errors, also those of messages, which the receiver does not model.
    """
    s = flight.shared.signals
    if flight.curvature is None:
        return None
    square = np.zeros_like(s.fix_sigma) if s.correlated is None else s.correlated.total**2
    noise = s.sigma
    if s.smoothing is not None:
        noise, square = np.zeros_like(s.fix_sigma), s.fix_sigma**2
    if s.space is not None:
        square = square + np.sum(s.space**2, axis=2)
    return flight.shared.fix_errors.curvature(
        noise, np.sqrt(square), MAX_MEASUREMENT_SIZE if flight.design.velocity else 3
    )


def curvature_of_ranges(flight: Flight) -> Curvature | None:
    """Second-order errors of all ranges (m, 2) due to the position errors of the filter model without second order.

    None if negligible.
    """
    epoch, source = np.nonzero(flight.shared.signals.used)
    assumed = along_truth(flight).lin.assumed[1 + epoch, : states.VEL, : states.VEL]
    found = _curvature_of_ranges(flight, epoch, source, assumed)
    return found if found.squares > NEGLIGIBLE else None


def _curvature_of_ranges(flight: Flight, epoch: np.ndarray, source: np.ndarray, position: np.ndarray) -> Curvature:
    """Second-order errors of ranges and range rates (m, 2) at the epochs of the sources (m,), for lasting position
    errors (m, 3, 3)."""
    s = flight.shared.signals
    of_range, of_rate, _ = range_forms(s)
    forms = -np.stack([of_range[epoch, source], of_rate[epoch, source]], axis=1)
    noise = np.zeros((epoch.size, 2, 2))
    noise[:, 0, 0] = flight.range_sigma[epoch, source] ** 2
    noise[:, 1, 1] = s.fix_rate_sigma[epoch, source] ** 2
    if not flight.design.velocity:
        forms[:, 1], noise[:, 1, 1] = 0.0, 0.0
    return Curvature.of(forms, np.zeros_like(position), position, noise)


def _add_range_curvature(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, source: int, out: _Sums, errors: np.ndarray
) -> None:
    """Add second-order errors of near ranges in a tightly coupled filter, from its first-order position errors.

    Adds nothing if they are negligible and the filter model has none.
    """
    weighed, row = _weighed(flight.events, route, RANGE)
    epoch = along.epoch[row]
    heard = np.argmax(along.by_range[row, 0], axis=1)
    position = out.covariance[1 + epoch, : states.VEL, : states.VEL]
    found = _curvature_of_ranges(flight, epoch, heard, position)
    if found.squares <= NEGLIGIBLE and flight.range_curvature is None:
        return
    off = np.zeros((*along.lin.have.shape, 7))
    there = along.lin.have[weighed, :2] > 0.0
    off[weighed, :2, 0] = np.where(there, found.mean, 0.0)
    off[weighed, :2, 1:] = np.where(there[:, :, None], found.correlated, 0.0)
    more, seen = _propagate_columns(route, np.zeros((route.to_error.shape[1], 7)), off)
    errors[:, :, 0] += more[:, :, 0]
    out.variance[source] += np.sum(more[:, :, 1:] ** 2, axis=2)
    out.covariance[...] += more[:, :, 1:] @ np.swapaxes(more[:, :, 1:], 1, 2)
    out.second[...] += seen[:, :, 1:] @ np.swapaxes(seen[:, :, 1:], 1, 2)


def _same(a: SensorDesign, b: SensorDesign) -> bool:
    """Whether two filter models have the same process noise."""
    mine, other = states.declared(a.blocks), states.declared(b.blocks)
    return mine.size == other.size and all(
        np.allclose(x, y, rtol=1e-12, atol=0.0)
        for x, y in ((a.noise, b.noise), *((mine[name], other[name]) for name in states.DECLARED.names or ()))
    )


def _check(analysis: Analysis, matched: bool) -> None:
    """Raise AnalysisError for undefined accuracies, and for a filter whose model is true but whose innovations are not
    as expected."""
    if not np.all(np.isfinite(analysis.variance)):
        raise AnalysisError("the accuracy is undefined (nan); please report this scenario")
    some = analysis.degrees > 0
    per_degree = analysis.nis[some] / analysis.degrees[some]
    if matched and per_degree.size and np.abs(per_degree - 1.0).max() > _EXPECTED_NIS:
        worst = per_degree[np.argmax(np.abs(per_degree - 1.0))]
        raise AnalysisError(
            f"the filter model equals the truth, yet the expected NIS is {worst:.3f} instead of 1: "
            "a defect of navsim; please report this scenario"
        )


def _messages(signals: Signals, by_range: np.ndarray, epoch: np.ndarray) -> np.ndarray:
    """Change of measurements (m, MOST, 4 s) in the epochs (m,) by one sigma of each error of orbits and clocks; (m,
    MOST, 0) without them."""
    m = by_range.shape[0]
    if signals.space is None:
        return np.zeros((m, MAX_MEASUREMENT_SIZE, 0))
    size = np.where(signals.used[:, :, None], signals.space, 0.0)
    return np.einsum("mrs,msk->mrsk", by_range, size[epoch]).reshape(m, MAX_MEASUREMENT_SIZE, -1)


def _owners(sources: tuple[str, ...], of_pseudolites: np.ndarray) -> np.ndarray:
    """Source of each position and clock error (4 s,); -1 for errors that are not among the sources."""
    mine = [sources.index(name) if name in sources else -1 for name in (SURVEY, SURVEY, SURVEY, CALIBRATION)]
    return np.where(of_pseudolites[:, None], mine, _EPHEMERIS).ravel()


def responses(flight: Flight, along: AlongTruth) -> np.ndarray:
    """Errors of the filter's states at its outputs (o, n, s) by a bias of 1 m that each range always has."""
    carried, route = _route(flight, along)
    weighed, row = _weighed(flight.events, route, RANGE if flight.design.tight else FIX)
    sources = along.by_range.shape[2]
    off = np.zeros((*along.lin.have.shape, sources))
    off[weighed] = np.where(along.lin.have[weighed, :, None] > 0.0, along.by_range[row], 0.0)
    return _propagate_columns(route, np.zeros((carried.size, sources)), off)[0]


def systematic(flight: Flight, along: AlongTruth) -> np.ndarray:
    """Mean errors of the filter's states at its outputs (o, n), from fixed values and systematic errors of
    measurements, without second-order errors."""
    carried, route = _route(flight, along)
    sources = (*SOURCES, *(state.source for state in along.true), CLOCK)
    columns, _ = _at_start(carried, sources, flight.initial, along.true)
    return _propagate_columns(route, columns[:, :1], along.lin.z[..., None])[0][:, :, 0]


def route_of_filter(flight: Flight, along: AlongTruth) -> LinearisedHistory:
    """History of the filter's own states, whatever the truth is."""
    carried, route = _route(flight, along)
    return route.of(np.arange(carried.n))


def excess(flight: Flight, route: LinearisedHistory, whole: AlongTruth, other: AlongTruth) -> np.ndarray:
    """Covariance between the position errors of a filter with fewer measurements and of the full filter, minus the
    latter's.

    At the outputs (o, 3, 3), m2, according to both filter models. route: of the full filter.
    """
    signals, design = flight.shared.signals, flight.design
    out = np.zeros((flight.shared.filter_time.size, 3, 3))
    if design.tight:  # ranges are weighted optimally
        return out
    weighed, row = _weighed(flight.events, route, FIX)
    slopes = [(whole.by_range, other.by_range, signals.fix_sigma)]
    slopes += [(whole.by_rate, other.by_rate, signals.fix_rate_sigma)] if design.velocity else []
    total = np.zeros((signals.time.size, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE))
    for mine, its, sigma in slopes:
        weight = np.where(signals.used, design.sigma_scale * sigma, 0.0)[:, None] ** 2
        total += (mine * weight) @ np.swapaxes(its - mine, 1, 2)
    there = whole.lin.have[weighed, :, None] * other.lin.have[weighed, None, :]
    cross, n = np.zeros((*whole.lin.have.shape, MAX_MEASUREMENT_SIZE)), route.gain.shape[1]
    cross[weighed] = np.where(there > 0.0, total[row], 0.0)
    propagate_excess(route, other.lin.gain, cross, np.zeros((2, n, n)), out)
    return out


def _route(flight: Flight, along: AlongTruth) -> tuple[_Augmented, LinearisedHistory]:
    """The propagated state and its history."""
    carried = _Augmented(flight.design.sensors.blocks, [state.block for state in along.true], len(flight.scales))
    return carried, carried.route(flight.events, along.steps, along.lin)


def _at_start(
    carried: _Augmented, sources: Sequence[str], initial: InitialErrors, true: Sequence[TrueState]
) -> tuple[np.ndarray, np.ndarray]:
    """Columns (S, c) at time 0, the mean first, then 1 sigma of each thing that is drawn, and the source (c,) of each,
    -1 for the mean."""
    mean = np.zeros(carried.size)
    columns, owner = [mean], [-1]

    def draw(source: str, first: int, sigma: float) -> None:
        if sigma > 0.0:
            columns.extend(sigma * np.eye(carried.size)[first : first + 3])
            owner.extend([sources.index(source)] * 3)

    if initial.fixed is None:
        draw("initial_position", states.POS, initial.position)
        draw("initial_velocity", states.VEL, initial.velocity)
        draw("initial_attitude", states.ATT, initial.attitude)
    else:
        mean[: states.SENSORS] = initial.fixed
    for k, state in enumerate(true):
        first = carried.n + 3 * k
        if state.fixed is None:
            draw(state.source, first, state.sigma)
        else:
            mean[first : first + 3] = state.fixed
    first, scales = carried.clock
    for k, sigma in enumerate(clock_sigma(scales)):
        columns.append(sigma * np.eye(carried.size)[first + k])
        owner.append(sources.index(CLOCK))
    return np.stack(columns, axis=1), np.array(owner)


class _Sums(NamedTuple):
    """Sums over sources."""

    variance: np.ndarray
    """(source, o, n) of the errors at the outputs."""
    covariance: np.ndarray
    """(o, n, n) of the errors at the outputs."""
    second: np.ndarray
    """(w, MOST, MOST) moments of the innovations."""


def _weighed(
    events: Events, route: LinearisedHistory, kind: int, chosen: np.ndarray | bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Measurements of a kind that the filter uses, of chosen events: indices in the route and rows (m,)."""
    at = np.flatnonzero((events.kind == kind) & (route.weighed >= 0) & chosen)
    return route.weighed[at], events.row[at]


def _propagate_noises(
    route: LinearisedHistory,
    added: np.ndarray,
    some: list[int],
    density: np.ndarray,
    noise: list[np.ndarray | None],
    out: _Sums,
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


def _propagate_smoothed_noise(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, of_pseudolites: np.ndarray, out: _Sums
) -> None:
    """Add the effect of smoothed range noise."""
    s = flight.shared.signals
    assert s.smoothing is not None
    own = SmoothedRanges(along.lin.assumed.shape[1], s.smoothing, s.sigma, s.used, of_pseudolites)
    _propagate_correlated(flight, along, route, own, _own_kind(flight), along.epoch, along.by_range, list(_RANGES), out)


def _propagate_ranging_errors(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, rows: list[int], out: _Sums
) -> None:
    """Add the effect of time-correlated ranging errors, each kind to the variance of its row."""
    s = flight.shared.signals
    assert s.correlated is not None
    n, kinds_and_sources = along.lin.assumed.shape[1], s.correlated.sigma.shape[::2]
    followed_ = np.flatnonzero(np.isin(flight.model.declared["triad"], (FIX, RANGE))) + states.SENSORS
    of_states = flight.correlated_of_states

    def shown(epoch: int) -> np.ndarray:
        out = np.zeros((n, *kinds_and_sources))
        out[followed_] = of_states(epoch)
        return out

    own = CorrelatedSources(n, s.correlated, s.used, s.time, shown)
    own.measure(0)
    _propagate_correlated(flight, along, route, own, _own_kind(flight), along.epoch, along.by_range, rows, out)


def _propagate_clock_noise(flight: Flight, along: AlongTruth, route: LinearisedHistory, row: int, out: _Sums) -> None:
    """Add the effect of clock noise of pseudolites."""
    s = flight.shared.signals
    assert s.wandering is not None
    own = WanderingClockErrors(along.lin.assumed.shape[1], s.wandering, s.used, s.time)
    slope = np.concatenate([by[..., s.wandering.which] for by in (along.by_range, along.by_rate)], axis=2)
    _propagate_correlated(flight, along, route, own, _own_kind(flight), along.epoch, slope, [row], out)


def _source_names(aid: Aid) -> tuple[str, ...]:
    """Source of each time-correlated error of a sensor, without those of size 0."""
    return tuple(f"{aid.sensor.name}_{error.name}" for error in aid.sensor.errors if error.sigma > 0.0)


def _states_of(flight: Flight, aid: Aid) -> np.ndarray:
    """Indices of the filter's states for the time-correlated errors of a sensor."""
    return states.SENSORS + np.flatnonzero(flight.model.declared["triad"] == aid.sensor.kind)


def _propagate_sensor_errors(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, aid: Aid, rows: list[int], out: _Sums
) -> None:
    """Add the effect of the time-correlated errors of a sensor, each to the variance of its row."""
    n, m, sensor = along.lin.assumed.shape[1], aid.time.size, aid.sensor
    there = [k for k, error in enumerate(sensor.errors) if error.sigma > 0.0]
    errors, parts = [sensor.errors[k] for k in there], np.arange(sensor.components)
    shown = np.zeros((n, len(there), parts.size))
    for at, followed_ in zip(_states_of(flight, aid).reshape(-1, parts.size), sensor.followed, strict=True):
        for k in (k for k, error in enumerate(there) if error == followed_):
            shown[at, k, parts] = sensor.state_scale * errors[k].sigma
    sigma = np.array([error.sigma for error in errors])[:, None, None] * np.ones((1, m, parts.size))
    those = CorrelatedErrors(tuple(e.name for e in errors), np.array([error.time for error in errors]), sigma)
    own = SensorErrorSources(n, those, np.ones((m, parts.size), bool), aid.time, lambda _: shown, moving=True)
    by = np.zeros((m, MAX_MEASUREMENT_SIZE, len(there), parts.size))
    by[:, : len(sensor.numbers)] = np.stack([sensor.slope @ aid.effects[k] for k in there], axis=2)
    own.measure(0)
    _propagate_correlated(flight, along, route, own, sensor.kind, np.arange(m), by, rows, out)


def _own_kind(flight: Flight) -> int:
    """Kind of the measurements from the receiver."""
    return RANGE if flight.design.tight else FIX


def _propagate_correlated(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, own: SourceErrors, kind: int, epoch: np.ndarray,
    slope: np.ndarray, rows: list[int], out: _Sums,
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


def _propagate_columns(route: LinearisedHistory, start_: np.ndarray, off: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def folded_quantile(probability: float, mean: float, sigma: float) -> float:
    """Quantile of the size of a Gaussian value; nan for undefined ones."""
    if not math.isfinite(mean) or not math.isfinite(sigma):
        return math.nan
    if sigma == 0.0:
        return abs(mean)
    from scipy.optimize import brentq
    from scipy.special import ndtr

    def excess(q: float) -> float:
        return float(ndtr((q - mean) / sigma) - ndtr((-q - mean) / sigma)) - probability

    return float(brentq(excess, 0.0, abs(mean) + 10.0 * sigma, xtol=1e-12))
