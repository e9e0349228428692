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
(`error_propagation.sensitivity_propagation`). Noise of carrier-smoothed ranges is correlated in time:
see `SmoothedRanges`.

Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.defect import Defect
from navsim.error_propagation.linearised import NOISES, Linearised, Steps
from navsim.error_propagation.sensitivity_propagation import (
    LinearisedHistory,
    propagate_excess,
)
from navsim.filter import states
from navsim.filter.design import SensorDesign, clock_sigma
from navsim.filter.measurement_kinds import FIX, RANGE
from navsim.filter.records import OUTPUT, Events
from navsim.filter.states import MAX_MEASUREMENT_SIZE, Block
from navsim.gnss.pseudorange import Signals
from navsim.simulation.aiding import columns_on_ground
from navsim.simulation.along_truth import FIRST_MARKOV, AlongTruth, along_truth, noise_densities
from navsim.simulation.correlated_sources import (
    white_noise,
)
from navsim.simulation.error_sources import (
    AIR,
    BIAS,
    CALIBRATION,
    CLOCK,
    CORRELATED,
    CURVATURE,
    EPHEMERIS,
    NOISE_SOURCES,
    OFFSET,
    RANGES,
    RATES,
    SOURCES,
    SURVEY,
    WANDERING,
    SourceSums,
    propagate_all_columns,
    propagate_clock_noise,
    propagate_noises,
    propagate_ranging_errors,
    propagate_sensor_clock,
    propagate_sensor_errors,
    propagate_smoothed_noise,
    sensor_error_states,
    source_names,
    transmitter_error_states,
    weighed_events,
)
from navsim.simulation.flight import Flight, InitialErrors
from navsim.simulation.inertial_states import TrueState, followed
from navsim.simulation.range_curvature import NEGLIGIBLE, Curvature, has_near_sources, range_forms

_ROUNDING = 1e-7
"""Largest rounding error of the mean square of a source, as a share of the sum of all."""
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
        means = [np.stack([d["sensor"], d["axis"], d["signal"]], axis=1) for d in (mine, truth)]
        same = (means[0][:, None] == means[1][None]).all(axis=2)
        self.to_error[states.SENSORS : self.clock[0], self.n :] = same
        self.markov = self.n + FIRST_MARKOV + np.arange(states.N_BASE - states.SENSORS)

    def route(self, events: Events, steps: Steps, lin: Linearised, offsets: np.ndarray) -> LinearisedHistory:
        """Effect of the events on the state; offsets: as of `LinearisedHistory`."""
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
            offsets,
        )


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
    errors = s.source_errors
    placed = () if errors is None else tuple(np.flatnonzero(errors[:, of_pseudolites].any(axis=(0, 1))).tolist())
    own += tuple(dict.fromkeys(_OWNERS[column] for column in placed))
    own += (AIR,) if s.drawn_air is not None else ()
    own += (OFFSET,) if s.offset is not None else ()
    own += (CLOCK,) if flight.scales else ()
    own += () if s.correlated is None else tuple(CORRELATED + name for name in s.correlated.names)
    own += () if s.wandering is None else (WANDERING,)
    own += tuple(dict.fromkeys(name for aid in shared.aids for name in source_names(aid)))
    curvature = _true_curvature(flight) if second_order else None
    own += (CURVATURE,) if curvature is not None or (second_order and design.tight and has_near_sources(s)) else ()
    sources = (*own, *(aid.sensor.name for aid in shared.aids))
    carried, route = _route(flight, along)
    n = carried.n
    kind = RANGE if design.tight else FIX
    weighed, row = weighed_events(events, route, kind)
    there = lin.have > 0.0
    both = there[weighed, :, None] & there[weighed, None, :]

    # white noise at each measurement, by its source: covariance (w, MOST, MOST)
    noise = {
        source: np.zeros((*there.shape, MAX_MEASUREMENT_SIZE))
        for source in (*RATES, *RANGES, *range(len(own), len(sources)))
    }
    for which, chosen in enumerate((~of_pseudolites, of_pseudolites)):
        of_rates = white_noise(by_rate, s.rate_sigma, s.used, chosen, epoch)
        noise[RATES[which]][weighed] = np.where(both, of_rates[row], 0.0)
        if s.smoothing is None:
            of_ranges = white_noise(by_range, s.sigma, s.used, chosen, epoch)
            noise[RANGES[which]][weighed] = np.where(both, of_ranges[row], 0.0)
    if curvature is not None:
        noise[sources.index(CURVATURE)] = np.zeros((*there.shape, MAX_MEASUREMENT_SIZE))
        noise[sources.index(CURVATURE)][weighed] = np.where(both, curvature.white[epoch][row], 0.0)
    for k, aid in enumerate(shared.aids):
        (at, its), numbers = weighed_events(events, route, aid.sensor.kind), np.arange(aid.sigma.shape[1])
        spread = np.where(there[at][:, numbers, None], aid.sensor.slope * aid.sigma[its, None, :], 0.0)
        noise[len(own) + k][at[:, None, None], numbers[:, None], numbers] = spread @ np.swapaxes(spread, 1, 2)
    out = SourceSums(
        np.zeros((len(sources), outputs, n)), np.zeros((outputs, n, n)), np.zeros((*there.shape, MAX_MEASUREMENT_SIZE))
    )
    density = np.zeros((len(sources), NOISES + 2))
    density[[SOURCES.index(name) for name in NOISE_SOURCES], np.arange(NOISES)] = noise_densities(flight)
    if flight.scales:
        density[sources.index(CLOCK), NOISES:] = shared.clock_density
    # Markov biases are states of the truth; no other noise acts on one
    markov = np.flatnonzero(density[:, 2:NOISES].any(axis=1)).tolist()
    others = [*np.flatnonzero(density[:, :2].any(axis=1) | density[:, NOISES:].any(axis=1)).tolist(), *noise]
    for group, chosen in ((others, np.arange(n)), (markov, np.append(np.arange(n), carried.markov))):
        for first in range(0, len(group), WIDTH):
            some = group[first : first + WIDTH]
            propagate_noises(route.of(chosen), lin.added, some, density[some], [noise.get(k) for k in some], out)
    if s.smoothing is not None:
        propagate_smoothed_noise(flight, along, route, of_pseudolites, out)
    if s.correlated is not None:
        propagate_ranging_errors(
            flight, along, route, [sources.index(CORRELATED + name) for name in s.correlated.names], out
        )
    if s.wandering is not None:
        propagate_clock_noise(flight, along, route, sources.index(WANDERING), out)
    for aid in shared.aids:
        if names := source_names(aid):
            propagate_sensor_errors(flight, along, route, aid, [sources.index(name) for name in names], out)
        if aid.sensor.clock is not None:
            propagate_sensor_clock(flight, along, route, aid, sources.index(names[-1]), out)

    # a column for systematic errors, then one for each error that is drawn once
    columns, owner = _at_start(carried, sources, flight.initial, true)
    messages = _messages(s, by_range, epoch)
    felt = messages.any(axis=(0, 1))
    messages, first = messages[:, :, felt], columns.shape[1]
    each = 0 if s.source_errors is None else s.source_errors.shape[2]
    owner = np.append(owner, _owners(own, of_pseudolites, each)[felt])
    shown = _shown_messages(flight)[:, felt]
    if (air := s.drawn_air) is not None:
        felt_air = np.einsum("mrs,ms->mr", by_range, np.where(s.used, air, 0.0)[epoch])
        messages = np.concatenate([messages, felt_air[..., None]], axis=2)
        owner = np.append(owner, sources.index(AIR))
        shown = np.column_stack([shown, _shown_refractivity(flight)])
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
    errors, seen = propagate_all_columns(route, columns, off)
    errors[:, :, first : first + shown.shape[1]] += shown
    if flight.transmitter_states is not None:
        errors[:, transmitter_error_states(flight), 0] += flight.transmitter_states.systematic
    for aid in shared.aids:
        mean = np.repeat(aid.sensor.mean_errors[list(aid.sensor.followed)], aid.sensor.components)
        errors[:, sensor_error_states(flight, aid), 0] += aid.sensor.state_scale * mean
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
    weighed, row = weighed_events(events, route, kind, kept)
    nis[epoch[row]] = 0.0
    for total, each in ((nis, square[weighed]), (systematic, of_mean[weighed]), (degrees, there[weighed].sum(axis=1))):
        np.add.at(total, epoch[row], each)
    aided = {}
    for aid in shared.aids:
        weighed, _ = weighed_events(events, route, aid.sensor.kind, kept)
        aided[aid.sensor.name] = np.array([square[weighed].sum(), there[weighed].sum()], float)
    analysis = Analysis(sources, out.variance, errors[:, :, 0].copy(), out.covariance, lin.assumed, nis, degrees, aided)
    white = (
        s.smoothing is None
        and s.source_errors is None
        and s.offset is None
        and s.drawn_air is None
        and s.correlated is None
        and s.wandering is None
    )
    white &= design.sigma_scale == 1.0 and second_order and curvature is None and flight.range_curvature is None
    white &= s.reflections is None
    white &= all(aid.sensor.is_true_model for aid in shared.aids)
    # every true error has its state, and all equal the filter model
    matched = carried.to_error[states.SENSORS :, n:].any(axis=0).all()
    inertial = tuple(b for b in design.sensors.blocks if b.sensor in (states.GYROS, states.ACCELEROMETERS))
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
    if s.source_errors is not None:
        square = square + np.sum(s.source_errors**2, axis=2)
    if (air := s.drawn_air) is not None:
        square = square + air**2
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
    noise[:, 1, 1] = flight.rate_sigma[epoch, source] ** 2
    if not flight.design.velocity:
        forms[:, 1], noise[:, 1, 1] = 0.0, 0.0
    return Curvature.of(forms, np.zeros_like(position), position, noise)


def _add_range_curvature(
    flight: Flight, along: AlongTruth, route: LinearisedHistory, source: int, out: SourceSums, errors: np.ndarray
) -> None:
    """Add second-order errors of near ranges in a tightly coupled filter, from its first-order position errors.

    Adds nothing if they are negligible and the filter model has none.
    """
    weighed, row = weighed_events(flight.events, route, RANGE)
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
    more, seen = propagate_all_columns(route, np.zeros((route.to_error.shape[1], 7)), off)
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
    as expected. Mean squares that rounding left below 0 become 0."""
    if not np.all(np.isfinite(analysis.variance)):
        raise AnalysisError("the accuracy is undefined (nan); please report this scenario")
    # sums of large terms that cancel: rounding may leave a source a little below 0
    below = analysis.variance < 0.0
    if np.any(analysis.variance < -_ROUNDING * np.abs(analysis.variance).sum(axis=0)):
        raise AnalysisError("a source has a mean square below 0: a defect of navsim; please report this scenario")
    analysis.variance[below] = 0.0
    some = analysis.degrees > 0
    per_degree = analysis.nis[some] / analysis.degrees[some]
    if matched and per_degree.size and np.abs(per_degree - 1.0).max() > _EXPECTED_NIS:
        worst = per_degree[np.argmax(np.abs(per_degree - 1.0))]
        raise AnalysisError(
            f"the filter model equals the truth, yet the expected NIS is {worst:.3f} instead of 1: "
            "a defect of navsim; please report this scenario"
        )


def _messages(signals: Signals, by_range: np.ndarray, epoch: np.ndarray) -> np.ndarray:
    """Change of measurements (m, MOST, k s) in the epochs (m,) by one sigma of each error of orbits and clocks; (m,
    MOST, 0) without them."""
    m = by_range.shape[0]
    if signals.source_errors is None:
        return np.zeros((m, MAX_MEASUREMENT_SIZE, 0))
    size = np.where(signals.used[:, :, None], signals.source_errors, 0.0)
    return np.einsum("mrs,msk->mrsk", by_range, size[epoch]).reshape(m, MAX_MEASUREMENT_SIZE, -1)


def _shown_messages(flight: Flight) -> np.ndarray:
    """True values of the filter's states (n, k s) by one sigma of each error of `_messages`; (n, 0) without these."""
    signals, mine, n = flight.shared.signals, flight.transmitter_states, flight.model.states
    out = np.zeros((n, 0 if signals.source_errors is None else signals.source_errors.shape[2] * len(signals.names)))
    if mine is not None and signals.source_errors is not None:
        out[transmitter_error_states(flight)] = mine.of_messages().reshape(len(mine.each), out.shape[1])
    return out


def _shown_refractivity(flight: Flight) -> np.ndarray:
    """True values of the filter's states (n,) by one sigma of the drawn refractivity."""
    out = np.zeros(flight.model.states)
    if flight.transmitter_states is not None:
        out[transmitter_error_states(flight)] = flight.transmitter_states.of_refractivity()
    return out


_OWNERS = (SURVEY, SURVEY, SURVEY, CALIBRATION, BIAS)
"""Source of each error of a pseudolite that is drawn once a run, as in `Signals.source_errors`."""


def _owners(sources: tuple[str, ...], of_pseudolites: np.ndarray, count: int) -> np.ndarray:
    """Source of each of `count` errors of each source of signals (count s,); -1 for errors that are not among the
    sources."""
    mine = np.array([sources.index(name) if name in sources else -1 for name in _OWNERS[:count]], int)
    return np.where(of_pseudolites[:, None], mine, EPHEMERIS).ravel()


def responses(flight: Flight, along: AlongTruth) -> np.ndarray:
    """Errors of the filter's states at its outputs (o, n, s + g) by a bias of 1 m, or rad, that each measurement always
    has, of the sources and then of transmitters on the ground."""
    carried, route = _route(flight, along)
    weighed, row = weighed_events(flight.events, route, RANGE if flight.design.tight else FIX)
    sources, aids = along.by_range.shape[2], flight.shared.aids
    off = np.zeros((*along.lin.have.shape, sources + sum(aid.sensor.transmitters for aid in aids)))
    off[weighed, :, :sources] = np.where(along.lin.have[weighed, :, None] > 0.0, along.by_range[row], 0.0)
    for aid, column in zip(aids, columns_on_ground(aids, sources), strict=True):
        if aid.sensor.transmitters:
            weighed, row = weighed_events(flight.events, route, aid.sensor.kind)
            off[weighed, 0, column[row]] = along.lin.have[weighed, 0]
    return propagate_all_columns(route, np.zeros((carried.size, off.shape[2])), off)[0]


def systematic(flight: Flight, along: AlongTruth) -> np.ndarray:
    """Mean errors of the filter's states at its outputs (o, n), from fixed values and systematic errors of
    measurements, without second-order errors."""
    carried, route = _route(flight, along)
    sources = (*SOURCES, *(state.source for state in along.true), CLOCK)
    columns, _ = _at_start(carried, sources, flight.initial, along.true)
    return propagate_all_columns(route, columns[:, :1], along.lin.z[..., None])[0][:, :, 0]


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
    weighed, row = weighed_events(flight.events, route, FIX)
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
    return carried, carried.route(flight.events, along.steps, along.lin, flight.model.clock.offsets)


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
