"""Linear covariance analysis of a landing: what a thousand runs would show, from matrices alone.

Truth and filter are two models. The filter's own covariance gives the gains; every source of error (initial
errors, sensor biases and noises, orbits and clocks of satellites, ranging noise of satellites and of pseudolites,
systematic errors) is then carried through the linearised loop by itself, with what it really is. Their sum is the true
covariance, whatever the filter believes, and the terms are the error budget.

State carried: the errors of navigation (9), minus the filter's estimates of its sensor states, the sensor states that
there really are; the filter's error of a state is the sum of those that mean the same. Noise of carrier-smoothed ranges
is correlated in time and is carried beside it, see `_Smoothed`; errors of orbits and clocks are constant over a run, so
what each does to the state is.

Source: Maybeck, Stochastic Models, Estimation, and Control, vol. 1 (1979), section 6.8.
"""

from __future__ import annotations

import copy as copying
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from navsim.core import states
from navsim.core.arrays.earth import E2, A, short_way
from navsim.core.defect import Defect
from navsim.core.lanes import WIDTH
from navsim.core.states import MOST, Block
from navsim.estimation.beliefs import SensorBeliefs
from navsim.estimation.estimate import in_all_lanes
from navsim.estimation.linearised import NOISES, Linearised, Steps, linearise, room, steps_of
from navsim.estimation.observations import FIX
from navsim.estimation.records import OUTPUT, ImuData, start
from navsim.models.pseudorange import Signals
from navsim.simulation.landing import (
    CARRIER_SIGMA,
    Flight,
    InitialErrors,
    World,
    exact_start,
    measurements,
    receiver_fixes,
    table_of_fixes,
    without_noise,
)
from navsim.simulation.sensors import TrueState, followed, true_states

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
"""Independent random sources of error, in the order of the budget; further errors of the inertial sensors and noise of
sensors beside the receiver come after them, systematic errors beside them as a mean."""
_EPHEMERIS = SOURCES.index("satellite_ephemeris")
_RANGES = (SOURCES.index("satellite_range"), SOURCES.index("pseudolite_range"))
_RATES = (SOURCES.index("satellite_range_rate"), SOURCES.index("pseudolite_range_rate"))

_MARKOV = np.arange(6, 12)
"""The Markov biases among the states of `true_states`."""

_DIFFERENCE = 0.05
"""Step of pseudoranges (m) and range rates (m/s) for the receiver's derivatives: a fix is nearly linear in them, and
rounding of 1e-8 m stays 1e-7 of the step."""

_EXPECTED_NIS = 0.01
"""Largest deviation from 1 of the expected normalised innovation squared, per degree of freedom, of a filter that
believes what is true."""


class AnalysisError(Defect):
    """The analysis contradicts itself."""


@dataclass(frozen=True)
class Analysis:
    """True accuracy of the filter to first order.

    sources: names of the random sources of error. variance: (source, t, n) of each of them. mean: (t, n) from
    systematic errors and fixed values. covariance: (t, n, n) of all sources, without the mean. believed: (t, n, n) the
    filter's own. nis: (e,) expected normalised innovation squared, nan without a fix; degrees: (e,).
    """

    sources: tuple[str, ...]
    variance: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    believed: np.ndarray
    nis: np.ndarray
    degrees: np.ndarray
    aided: dict[str, np.ndarray]

    def expected_square(self, states_: slice) -> np.ndarray:
        """Expected normalised squared error of some states, per degree of freedom (t,)."""
        second = self.covariance + self.mean[:, :, None] * self.mean[:, None, :]
        believed = self.believed[:, states_, states_]
        return np.trace(np.linalg.solve(believed, second[:, states_, states_]), axis1=1, axis2=2) / believed.shape[1]


def _solve(world: World, ranges: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fixes (e, 3) llh and (e, 3) velocity, and their covariance (e, 6, 6); of measurements of lanes, those of each."""
    llh, velocity, _, cov = receiver_fixes(world, ranges, rates)
    return llh, velocity, cov


def _slopes(world: World, ranges: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of position and velocity fixes (e, 6) by each pseudorange and each range rate, (e, 6, s) each.

    The receiver itself is differentiated, measurement by measurement, so that its weights are in it. Zero for what is
    not used, and where there is no fix.
    """
    s = world.signals
    e, n = ranges.shape
    out = np.zeros((2, e, 6, n))
    fix = np.isfinite(_solve(world, ranges, rates)[0][:, 0])
    # a measurement a pair of lanes: up in one, down in the other
    pairs = [(part, i) for part in (0, 1) for i in range(n)]
    for first in range(0, len(pairs), WIDTH // 2):
        some = pairs[first : first + WIDTH // 2]
        moved = in_all_lanes(ranges), in_all_lanes(rates)
        for lane, (part, i) in enumerate(some):
            moved[part][:, i, 2 * lane] += _DIFFERENCE
            moved[part][:, i, 2 * lane + 1] -= _DIFFERENCE
        llh, velocity, _ = _solve(world, *moved)
        for lane, (part, i) in enumerate(some):
            up, down = 2 * lane, 2 * lane + 1
            north_east_down = _metres(llh[..., up] - llh[..., down], llh[..., down])
            slope = np.concatenate([north_east_down, velocity[..., up] - velocity[..., down]], axis=1)
            here = s.used[:, i] & fix
            out[part][here, :, i] = slope[here] / (2.0 * _DIFFERENCE)
    return out[0], out[1]


def _white(slope: np.ndarray, sigma: np.ndarray, used: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Covariance of fixes (e, 6, 6) by independent errors of chosen (s,) sources; slope: (e, 6, s), others: (e, s)."""
    spread = slope * np.where(used & chosen, sigma, 0.0)[:, None, :]
    return spread @ np.swapaxes(spread, 1, 2)


class _Smoothed:
    """Range noise after Hatch's filter with what it has done to the state, (S + s)^2 for satellites and pseudolites.

    The smoothed noise is x + w, w the carrier's own, and x = (1 - 1/n) x before + (v - w) / n with the code's v: a
    process of first order driven by white noise, one state more a source.
    """

    def __init__(
        self,
        size: int,
        counts: np.ndarray,
        sigma: np.ndarray,
        used: np.ndarray,
        slope: np.ndarray,
        of_pseudolites: np.ndarray,
    ):
        """size: S of the state carried; counts, sigma, used: (e, s) of `Signals`; slope: (e, 6, s) of fixes;
        of_pseudolites: (s,) bool."""
        self.size = size
        self.n = np.maximum(counts, 1)
        self.decay = np.where(counts > 1, 1.0 - 1.0 / self.n, 0.0)
        self.sigma, self.slope, self.used = sigma, slope, used
        self.chosen = (~of_pseudolites, of_pseudolites)
        self.cov = np.zeros((2, size + of_pseudolites.size, size + of_pseudolites.size))

    def copied(self) -> _Smoothed:
        """The same, to go on by itself."""
        out = copying.copy(self)
        out.cov = self.cov.copy()
        return out

    def carry(self, phi: np.ndarray) -> None:
        """On by what changes the state by `phi` (S, S): an interval, or the weighing of another sensor."""
        self.cov[:, : self.size] = phi @ self.cov[:, : self.size]
        self.cov[:, :, : self.size] = self.cov[:, :, : self.size] @ phi.T

    def measure(self, i: int) -> None:
        """The smoothed noises become those of epoch i."""
        decay = self.decay[i]
        self.cov[:, self.size :] *= decay[:, None]
        self.cov[:, :, self.size :] *= decay
        at = self.size + np.arange(decay.size)
        for cov, chosen in zip(self.cov, self.chosen, strict=True):
            code = np.where(chosen & self.used[i], self.sigma[i], 0.0)
            phase = np.where(chosen & self.used[i], CARRIER_SIGMA, 0.0)
            cov[at, at] += (code**2 + phase**2) / self.n[i] ** 2

    def fixed(self, i: int, here: np.ndarray, gain: np.ndarray, there: np.ndarray) -> np.ndarray:
        """Weigh the fix of epoch i, of which the numbers `there` (m,) are in use, by `gain` (S, m), `here` (m, S);
        returns what it adds to E[z z'] (m, m)."""
        m, slope = there.size, self.slope[i, there]
        turn = np.eye(self.cov.shape[1])
        turn[: self.size, : self.size] -= gain @ here
        turn[: self.size, self.size :] = -gain @ slope
        seen = np.hstack([here, slope])
        out = np.zeros((m, m))
        for k, chosen in enumerate(self.chosen):
            phase = np.where(chosen & self.used[i], CARRIER_SIGMA**2, 0.0)
            # the carrier's noise is in the fix and, with the other sign, in the smoothed state
            with_phase = np.zeros((self.cov.shape[1], phase.size))
            with_phase[self.size :] = np.diag(-phase / self.n[i])
            cross = seen @ with_phase @ slope.T
            out += seen @ self.cov[k] @ seen.T + cross + cross.T + (slope * phase) @ slope.T
            direct = np.zeros_like(with_phase)
            direct[: self.size] = -gain @ slope
            cross = turn @ with_phase @ direct.T
            self.cov[k] = turn @ self.cov[k] @ turn.T + cross + cross.T + (direct * phase) @ direct.T
        return out

    def state(self) -> np.ndarray:
        """Covariances of the state (2, S, S)."""
        return self.cov[:, : self.size, : self.size]


def _metres(difference: np.ndarray, llh: np.ndarray) -> np.ndarray:
    """Small differences of geodetic coordinates as NED metres (e, 3)."""
    w = 1.0 - E2 * np.sin(llh[:, 0]) ** 2
    meridian = A * (1.0 - E2) / (w * np.sqrt(w))
    transverse = A / np.sqrt(w)
    return np.stack(
        [
            difference[:, 0] * (meridian + llh[:, 2]),
            short_way(difference[:, 1]) * (transverse + llh[:, 2]) * np.cos(llh[:, 0]),
            -difference[:, 2],
        ],
        axis=1,
    )


class _Augmented:
    """The state carried and what happens to it: minus the filter's estimates, and the sensor states that there are.

    n: states of the filter; size: S of the state carried; to_error (n, S): the filter's errors from it; markov: places
    of the Markov biases in it; decay (t,): of the true states, 1/s.
    """

    def __init__(self, followed: Sequence[Block], true: Sequence[Block]):
        mine, truth = states.declared(followed), states.declared(true)
        self.n = states.SENSORS + mine.size
        self.size = self.n + truth.size
        self.decay = truth["decay"]
        self.to_error = np.zeros((self.n, self.size))
        self.to_error[:, : self.n] = np.eye(self.n)
        means = [np.stack([d["triad"], d["axis"], d["signal"]], axis=1) for d in (mine, truth)]
        same = (means[0][:, None] == means[1][None]).all(axis=2)
        self.to_error[states.SENSORS :, self.n :] = same
        self.markov = self.n + _MARKOV

    def interval(self, lin: Linearised, i: int, length: float, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition (S, S) and added covariance (source, S, S) of interval i, length s. density: (source, NOISES)."""
        phi = np.eye(self.size)
        phi[: self.n, : self.n] = lin.transition[i]
        phi[: states.SENSORS, self.n :] = lin.inputs[i]
        at = np.arange(self.n, self.size)
        phi[at, at] = np.exp(-self.decay * length)
        # the sensor rows of what is added are those of the Markov biases themselves
        place = np.concatenate([np.arange(states.SENSORS), self.markov])
        added = np.zeros((density.shape[0], self.size, self.size))
        for source, noise in zip(*np.nonzero(density), strict=True):
            added[source][np.ix_(place, place)] += density[source, noise] * lin.added[i, noise]
        return phi, added


class AlongTruth(NamedTuple):
    """The filter of a flight as it is along the truth.

    steps, lin: of its events (`estimation.linearised`). by_range, by_rate: (e, 6, s) derivatives of position and
    velocity fixes by pseudoranges and range rates. true: the errors of the inertial sensors that there are.
    """

    steps: Steps
    lin: Linearised
    by_range: np.ndarray
    by_rate: np.ndarray
    true: tuple[TrueState, ...]


def along_truth(flight: Flight) -> AlongTruth:
    """Fly the filter of a flight along the truth, without noise."""
    world, beliefs, gyro, accel = flight.world, flight.beliefs, flight.gyro, flight.accel
    ranges, rates = without_noise(world)
    llh, velocity, cov = _solve(world, ranges, rates)
    true = true_states(gyro, accel)
    truth = states.declared([state.block for state in true])
    markov = states.declared(states.biases((1.0 / gyro.markov_time, 0.0), (1.0 / accel.markov_time, 0.0)))
    steps = steps_of(float(world.imu_time[0]), flight.events)
    lin = room(steps, world.filter_time.size, flight.model.declared, truth)
    linearise(
        ImuData(world.imu_time, world.dtheta, world.dv),
        measurements(flight, table_of_fixes(beliefs, llh, velocity, cov), [aid.exact for aid in world.aids]),
        flight.events,
        steps,
        start(exact_start(world.at_filter), flight.covariance),
        flight.model,
        truth,
        markov,
        lin,
    )
    return AlongTruth(steps, lin, *_slopes(world, ranges, rates), true)


def analyse(flight: Flight, of_pseudolites: np.ndarray, along: AlongTruth | None = None) -> Analysis:
    """The accuracy of a flight's filter.

    of_pseudolites: (s,) bool, which sources are pseudolites. along: where it is known already. Raises AnalysisError
    where the result contradicts itself.
    """
    world, beliefs, gyro, accel = flight.world, flight.beliefs, flight.gyro, flight.accel
    steps, lin, by_range, by_rate, true = along or along_truth(flight)
    s, events, outputs = world.signals, flight.events, world.filter_time.size
    own = (*SOURCES, *(state.source for state in true if state.source not in SOURCES))
    sources = (*own, *(aid.sensor.name for aid in world.aids))
    of_kind = {aid.sensor.kind: (len(own) + k, aid) for k, aid in enumerate(world.aids)}
    carried = _Augmented(beliefs.sensors.blocks, [state.block for state in true])
    n = carried.n

    density = np.zeros((len(sources), NOISES))
    for row, (name, value) in enumerate(
        (
            ("gyro_noise", gyro.noise_density**2),
            ("accelerometer_noise", accel.noise_density**2),
            ("gyro_markov", gyro.drive()),
            ("accelerometer_markov", accel.drive()),
        )
    ):
        density[SOURCES.index(name), row] = value
    e = s.time.size
    noise = np.zeros((len(sources), e, MOST, MOST))
    smoothed = None
    if s.smoothing is not None:
        smoothed = _Smoothed(carried.size, s.smoothing, s.sigma, s.used, by_range, of_pseudolites)
    for which, chosen in enumerate((~of_pseudolites, of_pseudolites)):
        noise[_RATES[which]] = _white(by_rate, s.rate_sigma, s.used, chosen)
        if smoothed is None:
            noise[_RANGES[which]] = _white(by_range, s.sigma, s.used, chosen)
    ephemeris = _messages(s, by_range)

    variance = np.empty((len(sources), outputs, n))
    means, sums = np.empty((outputs, n)), np.empty((outputs, n, n))
    nis, degrees, systematic = np.full(e, np.nan), np.zeros(e, np.int64), np.zeros(e)

    total, mean = _at_start(carried, sources, flight.initial, true)
    response = np.zeros((carried.size, ephemeris.shape[2]))
    kept = copied = (total, mean, response)
    # smoothed ranges are carried on a copy that runs ahead where fixes are weighed there
    smoothed_ahead = smoothed is not None and bool(np.any(events.ahead & (events.kind == FIX)))
    copy: _Smoothed | None = None
    was_ahead = False
    aided = {aid.sensor.name: np.zeros(2) for aid in world.aids}
    for i in range(events.time.size):
        # on a copy of the filter that runs ahead nothing but the answer is kept
        ahead = bool(events.ahead[i])
        total, mean, response = copied if ahead and was_ahead else kept
        if ahead and not was_ahead and smoothed is not None and smoothed_ahead:
            copy = smoothed.copied()
        ranges_here = copy if ahead else smoothed
        was_ahead = ahead
        interval = steps.interval[i]
        if interval >= 0:
            phi, added = carried.interval(lin, interval, steps.length[i], density)
            total = phi @ total @ phi.T + added
            mean, response = phi @ mean, phi @ response
            if ranges_here is not None:
                ranges_here.carry(phi)
                total[list(_RANGES)] = ranges_here.state()
        kind, row, w = int(events.kind[i]), int(events.row[i]), steps.measurement[i]
        if kind == OUTPUT:
            error = carried.to_error @ total @ carried.to_error.T
            one = carried.to_error @ response
            error[_EPHEMERIS] = one @ one.T
            variance[:, row] = np.diagonal(error, axis1=1, axis2=2)
            sums[row] = error.sum(axis=0)
            means[row] = carried.to_error @ mean
        if kind == FIX and ranges_here is not None:
            ranges_here.measure(row)
        if kind == FIX and not ahead:
            degrees[row] = int(lin.have[w].sum())
        if w >= 0 and lin.have[w].any():
            there = np.flatnonzero(lin.have[w])
            m = there.size
            here = lin.h[w, there] @ carried.to_error
            feedback = np.zeros((carried.size, m))
            feedback[:n] = lin.gain[w][:, there]
            keep = np.eye(carried.size) - feedback @ here
            z, expected = lin.z[w, there], lin.expected[w][np.ix_(there, there)]
            if kind == FIX:
                r, message = noise[:, row][:, there[:, None], there], ephemeris[row, there]
            else:
                source, aid = of_kind[kind]
                r, message = np.zeros((len(sources), m, m)), np.zeros((m, response.shape[1]))
                r[source] = np.diag(aid.sigma[there] ** 2)
            fixed_off, messages_off = z + here @ mean, here @ response + message
            correlated = kind == FIX and ranges_here is not None
            others = (np.delete(total, _RANGES, axis=0) if correlated else total).sum(axis=0)
            second = here @ others @ here.T + r.sum(axis=0) + messages_off @ messages_off.T
            total = keep @ total @ keep.T + feedback @ r @ feedback.T
            if ranges_here is not None:
                if correlated:
                    second += ranges_here.fixed(row, here, feedback, there)
                else:
                    ranges_here.carry(keep)
                total[list(_RANGES)] = ranges_here.state()
            mean = keep @ mean - feedback @ z
            response = keep @ response - feedback @ message
            off = fixed_off @ np.linalg.solve(expected, fixed_off)
            square = np.trace(np.linalg.solve(expected, second)) + off
            if kind == FIX and not ahead:
                systematic[row], nis[row] = off, square
            elif not ahead:
                aided[aid.sensor.name] += square, m
        if ahead:
            copied = (total, mean, response)
        else:
            kept = (total, mean, response)
    out = Analysis(sources, variance, means, sums, lin.believed, nis, degrees, aided)
    white = smoothed is None and s.space is None and beliefs.sigma_scale == 1.0
    white &= all(np.array_equal(aid.sigma, aid.believed) for aid in world.aids)
    # every error that there is has its state, and all are as believed
    matched = carried.to_error[states.SENSORS :, n:].any(axis=0).all()
    matched &= _same(beliefs.sensors, followed(gyro, accel, n > states.N))
    begins = np.allclose(lin.believed[0], sums[0], rtol=1e-9, atol=0.0)
    # a constant bias beside a Markov one is more than the filter's one state a bias can follow
    can_follow = all(not t.markov or (not t.bias and t.fixed_bias is None) for t in (gyro, accel))
    _check(out, matched=bool(white and matched and begins and can_follow and np.all(systematic < 1e-3)))
    return out


def _same(a: SensorBeliefs, b: SensorBeliefs) -> bool:
    """Whether two beliefs give a filter the same process noise."""
    mine, other = states.declared(a.blocks), states.declared(b.blocks)
    return mine.size == other.size and all(
        np.allclose(x, y, rtol=1e-12, atol=0.0)
        for x, y in ((a.noise, b.noise), *((mine[name], other[name]) for name in states.DECLARED.names or ()))
    )


def _check(analysis: Analysis, matched: bool) -> None:
    """Raise AnalysisError for undefined accuracies, and where a filter that believes what is true is not expected to
    have innovations of the size it expects itself."""
    if not np.all(np.isfinite(analysis.variance)):
        raise AnalysisError("the accuracy is undefined (nan); please report this scenario")
    some = analysis.degrees > 0
    per_degree = analysis.nis[some] / analysis.degrees[some]
    if matched and per_degree.size and np.abs(per_degree - 1.0).max() > _EXPECTED_NIS:
        worst = per_degree[np.argmax(np.abs(per_degree - 1.0))]
        raise AnalysisError(
            f"the filter believes what is true, yet its expected NIS is {worst:.3f} instead of 1: "
            "the analysis is wrong; please report this scenario"
        )


def _messages(signals: Signals, by_range: np.ndarray) -> np.ndarray:
    """Change of fixes (e, 6, 4 s) by one sigma of each error of orbits and clocks; (e, 6, 0) without them."""
    e = by_range.shape[0]
    if signals.space is None:
        return np.zeros((e, 6, 0))
    size = np.where(signals.used[:, :, None], signals.space, 0.0)
    return np.einsum("ers,esk->ersk", by_range, size).reshape(e, 6, -1)


def _at_start(
    carried: _Augmented, sources: Sequence[str], initial: InitialErrors, true: Sequence[TrueState]
) -> tuple[np.ndarray, np.ndarray]:
    """Covariances (source, S, S) and mean (S,) at time 0."""
    total = np.zeros((len(sources), carried.size, carried.size))
    mean = np.zeros(carried.size)

    def draw(source: str, first: int, sigma: float) -> None:
        at = range(first, first + 3)
        total[sources.index(source), at, at] = sigma**2

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
    return total, mean


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
