"""First-order sensitivity of a position error to all random inputs of a landing.

The covariance analysis (`simulation.landing_covariance`) propagates errors forward through the linearised filter. Here
a row of weights goes backward through the same matrices: the transposed (adjoint) system. It leads from the outputs to
each IMU sample, each range and the initial errors. One pass gives the slopes of an error by tens of thousands of
numbers.

Source: Bryson & Ho, Applied Optimal Control (1975), section 2.3 (adjoint equations); Zarchan, Tactical and Strategic
Missile Guidance, the chapters on the method of adjoints (what each error contributes to a miss).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from navsim.filter import states
from navsim.filter.measurement_kinds import FIX, RANGE
from navsim.filter.records import OUTPUT, TIME_TOLERANCE
from navsim.gnss import dll
from navsim.gnss.correlated_errors import CorrelatedErrors
from navsim.gnss.fix_states import StateHistory
from navsim.gnss.pseudolite_clock import clock_noise, clock_transition
from navsim.gnss.pseudorange import Signals
from navsim.sensors.imu import Triad
from navsim.simulation.aiding import Aid
from navsim.simulation.along_truth import AlongTruth
from navsim.simulation.flight import Flight
from navsim.simulation.measurements import CARRIER_SIGMA, expected_measurements
from navsim.simulation.run_inputs import Inputs
from navsim.simulation.shared_truth import SharedTruth


@dataclass(frozen=True)
class Slopes:
    """Slopes of K errors by all random inputs of a landing, or K directions in these inputs.

    Arrays are those of `simulation.run_inputs.Inputs` with K first.
    """

    initial: np.ndarray
    """(K, 9)."""
    dtheta: np.ndarray
    """(K, n, 3)."""
    dv: np.ndarray
    """(K, n, 3)."""
    ranges: np.ndarray
    """(K, e, s); (K, e, 3) by position errors of fixes that have a state."""
    rates: np.ndarray
    """(K, e, s); (K, e, 3) likewise, by velocity errors."""
    phases: np.ndarray | None
    """(K, e, s)."""
    aided: tuple[np.ndarray, ...]
    """(K, m, k) of each sensor."""
    mean: np.ndarray | None = None
    """(K,) errors to first order where nothing is drawn."""

    def members(self) -> list[np.ndarray]:
        """Its arrays."""
        phases = [] if self.phases is None else [self.phases]
        return [self.initial, self.dtheta, self.dv, self.ranges, self.rates, *phases, *self.aided]

    def times(self, deviations: list[np.ndarray]) -> np.ndarray:
        """Sums (K, W) of these slopes times deviations of `members`, each (..., W)."""
        pairs = zip(self.members(), deviations, strict=True)
        return np.sum([np.einsum("ki,iw->kw", a.reshape(a.shape[0], -1), _rows(d)) for a, d in pairs], axis=0)


def _rows(lanes: np.ndarray) -> np.ndarray:
    return lanes.reshape(-1, lanes.shape[-1])


def sensitivity(flight: Flight, along: AlongTruth, weights: np.ndarray) -> Slopes:
    """Slopes of K sums of position errors, NED, truth - estimate, by the inputs. weights: (K, o, 3) of the sums, or
    (K, o, 6) with those of velocity errors.

    Between events the slopes by velocity are taken as linear in time, those by attitude as a parabola.
    """
    shared, events, steps, lin = flight.shared, flight.events, along.steps, along.lin
    count, n = weights.shape[0], lin.assumed.shape[1]
    e, s = shared.signals.range.shape[0], along.by_range.shape[2]
    mean = np.zeros(count)
    c_nb = 0.5 * (shared.truth.c_nb[:-1] + shared.truth.c_nb[1:])
    force = np.einsum("tij,tj->ti", c_nb, shared.dv / np.diff(shared.imu_time)[:, None])
    felt = np.zeros((count, shared.dtheta.shape[0], 6))  # by theta and v, NED, at each sample
    ranges, rates = np.zeros((count, e, s)), np.zeros((count, e, s))
    turned = np.zeros((count, shared.dtheta.shape[0], 3))  # by the angular rate that a lever arm turns with
    aided = {aid.sensor.kind: np.zeros((count, *aid.exact.shape)) for aid in shared.aids}
    slope = {aid.sensor.kind: aid.sensor.slope for aid in shared.aids}
    own, copied = np.zeros((count, n)), np.zeros((count, n))
    for i in range(events.time.size - 1, -1, -1):
        ahead, kind, row, w = bool(events.ahead[i]), int(events.kind[i]), events.row[i], steps.measurement[i]
        here = copied if ahead else own
        if kind == OUTPUT:
            here[:, states.POS : states.POS + weights.shape[2]] += weights[:, row]
        elif w >= 0 and lin.have[w].any():
            there = np.flatnonzero(lin.have[w])
            by_innovation = here @ lin.gain[w][:, there]
            mean -= by_innovation @ lin.z[w, there]
            if kind in (FIX, RANGE):
                ranges[:, along.epoch[row]] -= by_innovation @ along.by_range[row, there]
                rates[:, along.epoch[row]] -= by_innovation @ along.by_rate[row, there]
                sample = max(int(np.searchsorted(shared.imu_time, events.time[i] - TIME_TOLERANCE)) - 1, 0)
                turned[:, sample] -= by_innovation @ lin.h[w, there, states.GYRO : states.GYRO + 3]
            else:
                aided[kind][:, row] -= by_innovation @ slope[kind][there]
            here -= by_innovation @ lin.h[w, there]
        if steps.interval[i] >= 0:
            after = here.copy()
            here[...] = after @ lin.transition[steps.interval[i]]
            begin = max(float(events.time[i]), float(shared.imu_time[0])) - steps.length[i]
            _spread_over_samples(shared.imu_time, begin, begin + steps.length[i], here, after, force, felt)
        if ahead and (i == 0 or not events.ahead[i - 1]):
            own += copied
            copied[...] = 0.0
    # errors of the increments act on theta and v through -C
    dtheta, dv = (-np.einsum("kti,tij->ktj", felt[..., part], c_nb) for part in (slice(3, 6), slice(0, 3)))
    dtheta += turned / (shared.imu_time[1] - shared.imu_time[0])
    phases = None
    if shared.signals.smoothing is not None and shared.fix_states is None:
        ranges, phases = dll.smoothing_slopes(ranges, shared.signals.smoothing)
    by_initial, fixed, dt = own[:, : states.SENSORS], flight.initial.fixed, shared.imu_time[1] - shared.imu_time[0]
    mean += 0.0 if fixed is None else by_initial @ fixed
    for triad, slopes in ((flight.gyro, dtheta), (flight.accel, dv)):
        mean += dt * slopes.sum(axis=1) @ np.array(triad.fixed_bias or (0.0, 0.0, 0.0))
    return Slopes(by_initial, dtheta, dv, ranges, rates, phases, tuple(aided.values()), mean)


def _spread_over_samples(
    time: np.ndarray, begin: float, end: float, before: np.ndarray, after: np.ndarray, force: np.ndarray,
    felt: np.ndarray,
) -> None:  # fmt: skip
    """Add the slopes by velocity and attitude over an interval to `felt` (K, n, 6), velocity first, of its IMU samples.

    before, after: slopes (K, n) at its ends. force: (n, 3) specific force of the samples, NED, m/s2.
    """
    first = int(np.searchsorted(time, begin + TIME_TOLERANCE, side="right")) - 1
    last = int(np.searchsorted(time, end - TIME_TOLERANCE, side="left"))
    low, high = np.maximum(time[first:last], begin), np.minimum(time[first + 1 : last + 1], end)
    part = (high - low) / (time[first + 1 : last + 1] - time[first:last])
    past = 0.5 * (low + high) - begin
    late = (past / (end - begin))[:, None]
    moving = slice(states.VEL, states.ATT + 3)
    between = before[:, None, moving] * (1.0 - late) + after[:, None, moving] * late
    # attitude acts on position by half the square of the time left: a parabola over the interval
    bow = 0.5 * past * (end - begin - past)
    between[..., 3:] += bow[:, None] * np.cross(after[:, None, states.POS : states.POS + 3], force[first:last])
    felt[:, first:last] += part[:, None] * between


def carried(flight: Flight, slopes: Slopes, history: StateHistory | None = None) -> Slopes:
    """The covariance of the inputs times `slopes`: where the inputs most likely are when sums of them with these slopes
    are off by their variances. history: of fixes that have a state."""
    shared, errors = flight.shared, flight.initial
    variance = np.repeat([errors.position**2, errors.velocity**2, errors.attitude**2], 3)
    initial = slopes.initial * (variance if errors.fixed is None else 0.0)
    dt = shared.imu_time[1] - shared.imu_time[0]
    return Slopes(
        initial,
        _of_triad(flight.gyro, slopes.dtheta, shared.dtheta, dt),
        _of_triad(flight.accel, slopes.dv, shared.dv, dt),
        *(of_ranges(flight, slopes) if history is None else of_states(shared, slopes, history)),
        tuple(of_aid(aid, a) for a, aid in zip(slopes.aided, shared.aids, strict=True)),
    )


def of_states(shared: SharedTruth, slopes: Slopes, history: StateHistory) -> tuple[np.ndarray, np.ndarray, None]:
    """Covariance of the errors of fixes that have a state times their slopes."""
    assert shared.fix_states is not None
    both = np.concatenate([slopes.ranges, slopes.rates], axis=2)
    out = shared.fix_states.carried(history, shared.signals.time, both)
    return out[..., :3], out[..., 3:], None


def of_ranges(flight: Flight, slopes: Slopes) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Covariance of the errors of ranges, range rates and carrier phases times their slopes."""
    signals, density = flight.shared.signals, flight.shared.clock_density
    ranges = slopes.ranges * np.where(signals.used, signals.sigma, 0.0) ** 2
    rates = slopes.rates * np.where(signals.used, signals.rate_sigma, 0.0) ** 2
    phases = None if slopes.phases is None else np.where(signals.used, CARRIER_SIGMA**2 * slopes.phases, 0.0)
    if signals.source_errors is not None:
        size = np.where(signals.used[..., None], signals.source_errors, 0.0)
        both = slopes.ranges if slopes.phases is None else slopes.ranges + slopes.phases
        delay = np.einsum("esc,ksc->kes", size, np.einsum("kes,esc->ksc", both, size))
        ranges = ranges + delay
        phases = None if phases is None else phases + delay
    if signals.offset is not None:
        both = slopes.ranges if slopes.phases is None else slopes.ranges + slopes.phases
        delay = np.where(signals.used, both, 0.0).sum(axis=1) @ signals.offset @ signals.offset.T
        delay = np.where(signals.used, delay[:, None], 0.0)
        ranges = ranges + delay
        phases = None if phases is None else phases + delay
    if (air := signals.drawn_air) is not None:
        both = slopes.ranges if slopes.phases is None else slopes.ranges + slopes.phases
        air = np.where(signals.used, air, 0.0)
        delay = np.einsum("kes,es->k", both, air)[:, None, None] * air
        ranges = ranges + delay
        phases = None if phases is None else phases + delay
    if signals.correlated is not None:
        both = slopes.ranges if slopes.phases is None else slopes.ranges + slopes.phases
        heard = replace(signals.correlated, sigma=np.where(signals.used, signals.correlated.sigma, 0.0))
        delay = _of_correlated(heard, signals.time, both)
        ranges = ranges + delay
        phases = None if phases is None else phases + delay
    if signals.wandering is not None:
        both = slopes.ranges if slopes.phases is None else slopes.ranges + slopes.phases
        delay, faster = _of_clocks(signals, both, slopes.rates)
        ranges, rates = ranges + delay, rates + faster
        phases = None if phases is None else phases + delay
    if flight.design.tight and any(density):  # each fix solves for the clock
        both = slopes.ranges if slopes.phases is None else slopes.ranges + slopes.phases
        later = np.stack([np.where(signals.used, m, 0.0).sum(axis=2) for m in (both, slopes.rates)], axis=-1)
        dt = np.diff(signals.time, prepend=0.0)
        of_clock = _of_steps(clock_transition(dt), clock_noise(density, dt), later[:, :, None])
        delay, faster = (np.where(signals.used, of_clock[..., k], 0.0) for k in (0, 1))
        ranges, rates = ranges + delay, rates + faster
        phases = None if phases is None else phases + delay
    return ranges, rates, phases


def range_covariance(flight: Flight) -> np.ndarray:
    """Covariance (e, s, s) of the errors of pseudoranges at each epoch, m2, without those of the receiver's clock."""
    signals = flight.shared.signals
    alone, code = np.where(signals.used, signals.sigma, 0.0) ** 2, np.where(signals.used, signals.sigma, 0.0) ** 2
    if signals.smoothing is not None:
        before = np.zeros_like(alone[0])
        for e, count in enumerate(np.maximum(signals.smoothing, 1)):
            carried_on = (1.0 - 1.0 / count) ** 2
            alone[e] = code[e] / count**2 + carried_on * (before + CARRIER_SIGMA**2)
            before = (code[e] + CARRIER_SIGMA**2) / count**2 + carried_on * before  # smoothed code minus carrier
    if signals.source_errors is not None:
        alone = alone + np.sum(signals.source_errors**2, axis=2)
    if signals.correlated is not None:
        alone = alone + signals.correlated.total**2
    if signals.wandering is not None:
        alone = alone + signals.wandering.sigmas(signals.time)[0] ** 2
    out = np.where(signals.used, alone, 0.0)[..., None] * np.eye(alone.shape[1])
    for effects in (
        None if signals.offset is None else signals.offset[None],
        None if signals.drawn_air is None else signals.drawn_air[..., None],
    ):
        if effects is not None:
            seen = np.where(signals.used[..., None], effects, 0.0)
            out = out + seen @ seen.swapaxes(1, 2)
    return out


def of_aid(aid: Aid, slopes: np.ndarray, exact: np.ndarray | None = None, way: Any = None) -> np.ndarray:
    """Covariance of a sensor's errors times their slopes (K, m, k), which belong to the route.

    way: trajectory on which the errors act, with exact (m, k) measurements; None for the route.
    """
    white, effects = slopes * aid.sigma**2, aid.effects
    if exact is not None and way is not None:
        white, effects = slopes * aid.sigma * aid.sensor.noise_sigma(exact), aid.sensor.effects(way, aid.time)
    correlated = np.zeros_like(slopes)
    for error, effect, acting in zip(aid.sensor.errors, aid.effects, effects, strict=True):
        own = CorrelatedErrors((error.name,), np.array([error.time]), np.full((1, aid.time.size, 1), error.sigma))
        of_error = _of_correlated(own, aid.time, np.einsum("Kmk,mkc->Kmc", slopes, effect))
        correlated += np.einsum("mkc,Kmc->Kmk", acting, of_error)
    return np.asarray(white + correlated)


def _of_correlated(correlated: CorrelatedErrors, time: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Covariance of time-correlated errors, at epochs (e,), s, times their slopes (K, e, s)."""
    kept, _ = correlated.steps(time)
    out = np.zeros_like(slopes)
    for k, sigma in enumerate(correlated.sigma):
        # the covariance of unit errors at epochs i and j is the product of the decays between them
        own = slopes * sigma
        before, after = own.copy(), own.copy()
        for t in range(1, own.shape[1]):
            before[:, t] += kept[t, k] * before[:, t - 1]
        for t in range(own.shape[1] - 2, -1, -1):
            after[:, t] += kept[t + 1, k] * after[:, t + 1]
        out += sigma * (before + after - own)
    return out


def _of_clocks(signals: Signals, ranges: np.ndarray, rates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the effect of pseudolites' clocks on ranges and range rates, times slopes by these (K, e, s)."""
    clocks = signals.wandering
    assert clocks is not None
    there = signals.used & clocks.which
    later = np.where(there[..., None], np.stack([ranges, rates], axis=-1), 0.0)
    out = np.where(there[..., None], _of_steps(*clocks.steps(signals.time), later), 0.0)
    return out[..., 0], out[..., 1]


def _of_steps(transition: np.ndarray, new: np.ndarray, later: np.ndarray) -> np.ndarray:
    """Covariance of offsets and rates of clocks times slopes by them (K, e, s, 2), which are overwritten.

    transition, new: of each step (e, 2, 2). With L that makes offsets and rates of all that was new up to then, it is
    L Q L'.
    """
    for t in range(later.shape[1] - 2, -1, -1):
        later[:, t] += later[:, t + 1] @ transition[t + 1]
    out = np.einsum("eij,kesj->kesi", new, later)
    for t in range(1, out.shape[1]):
        out[:, t] += out[:, t - 1] @ transition[t].T
    return out


def _of_triad(triad: Triad, slopes: np.ndarray, exact: np.ndarray, dt: float) -> np.ndarray:
    """The covariance of the errors of increments times their slopes (K, n, 3); exact: (n, 3) increments."""
    out = triad.noise_density**2 * dt * slopes
    if triad.fixed_bias is None:
        out += (triad.bias * dt) ** 2 * slopes.sum(axis=1, keepdims=True)
    if triad.scale > 0.0:
        out += triad.scale**2 * exact * by_scale(slopes, exact)[:, None]
    for sigma, time in triad.markovs:
        out += _of_markov(sigma, time, slopes, dt)
    return out


def by_scale(slopes: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Slopes (K, 3) by scale factors, from those by increments (K, n, 3); exact: (n, 3) increments."""
    return np.einsum("kti,ti->ki", slopes, exact)


def _of_markov(sigma: float, time: float, slopes: np.ndarray, dt: float) -> np.ndarray:
    """Covariance of a Markov bias alone times slopes; between samples i and j it is sigma^2 decay^|i - j|."""
    decay = np.exp(-dt / time)
    later, out = np.zeros_like(slopes[:, 0]), np.empty_like(slopes)
    for t in range(slopes.shape[1] - 1, -1, -1):
        later = decay * later + slopes[:, t]
        out[:, t] = later
    earlier = np.zeros_like(later)
    for t in range(slopes.shape[1]):
        out[:, t] += earlier
        earlier = decay * (earlier + slopes[:, t])
    return (sigma * dt) ** 2 * out


def deviations(flight: Flight, inputs: Inputs) -> list[np.ndarray]:
    """Deviation of drawn inputs from those without random errors, in the order of `Slopes.members`, lanes last."""
    shared, dt = flight.shared, flight.shared.imu_time[1] - flight.shared.imu_time[0]
    fixed = np.zeros(states.SENSORS) if flight.initial.fixed is None else flight.initial.fixed
    ranges, rates, phases = expected_measurements(shared)
    used = shared.signals.used[..., None]
    increments = [
        lanes - (exact + dt * np.array(triad.fixed_bias or (0.0, 0.0, 0.0)))[..., None]
        for lanes, exact, triad in (
            (inputs.dtheta, shared.dtheta, flight.gyro),
            (inputs.dv, shared.dv, flight.accel),
        )
    ]
    of_phases = [] if phases is None or inputs.phases is None else [inputs.phases - phases[..., None]]
    signals = (inputs.ranges - ranges[..., None], inputs.rates - rates[..., None], *of_phases)
    if (stated := inputs.stated) is not None:
        off = stated.error - stated.known
        signals, used = (off[:, :3], off[:, 3:]), np.ones((1, 1, 1), bool)
    return [
        inputs.initial - fixed[:, None],
        *increments,
        *(np.where(used, lanes, 0.0) for lanes in signals),
        *(
            np.where(np.isnan(aid.exact)[..., None], 0.0, lanes - aid.exact[..., None])
            for lanes, aid in zip(inputs.aided, shared.aids, strict=True)
        ),
    ]
