"""Ranges and range rates that runs measure, from shared truth and drawn errors, and the receiver's fixes from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from navsim.filter.estimate import in_all_lanes
from navsim.geodesy import earth
from navsim.gnss import dll
from navsim.gnss.fix_states import StatedFixes
from navsim.gnss.pseudorange import Signals
from navsim.gnss.receiver import wander
from navsim.gnss.receiver_fixes import ReceiverFixes, solve_fixes
from navsim.simulation.dispersed_trajectory import DispersedTrajectories
from navsim.simulation.shared_truth import SharedTruth
from navsim.simulation.transmitter_errors import drawn_refractivity
from navsim.statistics import noise
from navsim.statistics.random_streams import generator, normals

CARRIER_SIGMA = 3e-3
"""1 sigma of a carrier phase measurement, m."""


@dataclass(frozen=True)
class ClockErrors:
    """The noise of the receiver's clock in runs: offset, m, and drift, m/s, at the fixes (e, 2, W) and at the filter's
    outputs (e + 1, 2, W)."""

    at_fixes: np.ndarray
    at_filter: np.ndarray

    @classmethod
    def of(cls, shared: SharedTruth, seed: int, runs: Sequence[int], lanes: int) -> ClockErrors | None:
        """Receiver clocks of runs, in the first of so many lanes; None without clock noise."""
        if not any(shared.clock_density):
            return None
        fixed, answered = shared.signals.time, shared.filter_time
        time, where = np.unique(np.concatenate([fixed, answered]), return_inverse=True)
        wandered = np.empty((fixed.size + answered.size, 2, lanes))
        for lane, run in enumerate(runs):
            wandered[..., lane] = wander(shared.clock_density, time, generator(seed, run, "clock"))[where]
        wandered[..., len(runs) :] = wandered[..., len(runs) - 1 : len(runs)]
        return cls(wandered[: fixed.size], wandered[fixed.size :])


def smoothed(shared: SharedTruth, ranges: np.ndarray, phases: np.ndarray | None) -> np.ndarray:
    """Pseudoranges (e, s, W) as the receiver uses them: smoothed by the carrier where it does that."""
    if phases is None or shared.signals.smoothing is None:
        return ranges
    each = range(ranges.shape[-1])
    return np.stack([dll.smooth(ranges[..., k], phases[..., k], shared.signals.smoothing) for k in each], axis=-1)


def carrier(shared: SharedTruth, delay: np.ndarray) -> np.ndarray:
    """Carrier phases without noise (e, s), m, where the code is late by delay (e, s), m; ambiguities are left out."""
    return shared.signals.range + delay - shared.signals.divergence + shared.clock[:, :1]


def without_noise(shared: SharedTruth) -> tuple[np.ndarray, np.ndarray]:
    """`measured` without random errors: systematic errors only."""
    ranges, rates, phases = expected_measurements(shared)
    return smoothed(shared, ranges[..., None], None if phases is None else phases[..., None])[..., 0], rates


def expected_measurements(shared: SharedTruth) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Pseudoranges, range rates and carrier phases (e, s) as of `Inputs` where nothing is drawn."""
    signals = shared.signals
    ranges = np.where(signals.used, signals.range + signals.range_bias + shared.clock[:, :1], np.nan)
    rates = np.where(signals.used, signals.range_rate + shared.clock[:, 1:], np.nan)
    return ranges, rates, None if signals.smoothing is None else carrier(shared, signals.range_bias)


def measured(shared: SharedTruth, seed: int, run: int) -> tuple[np.ndarray, np.ndarray]:
    """Pseudoranges (m) and range rates (m/s) of a run on the route (e, s), nan if missing."""
    ranges, rates, phases = draw_measurements(
        shared, seed, (run,), 1, range_noise(shared, seed, (run,)), ClockErrors.of(shared, seed, (run,), 1),
        correlated_errors(shared, seed, (run,)), None,
    )  # fmt: skip
    return smoothed(shared, ranges, phases)[..., 0], rates[..., 0]


def correlated_errors(shared: SharedTruth, seed: int, runs: Sequence[int]) -> np.ndarray | None:
    """Time-correlated ranging errors of so many runs, in the sigma of their kinds (k, e, s, W); None without."""
    if shared.signals.correlated is None:
        return None
    return shared.signals.correlated.drawn(shared.signals.time, [generator(seed, run, "lasting") for run in runs])


def draw_measurements(
    shared: SharedTruth,
    seed: int,
    runs: Sequence[int],
    lanes: int,
    noises: np.ndarray,
    wandered: ClockErrors | None,
    correlated: np.ndarray | None,
    flown: DispersedTrajectories | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Pseudoranges, range rates and carrier phases of runs in the first of so many lanes, see `Inputs`.

    noises: from `range_noise`; correlated: from `correlated_errors`.
    """
    signals = shared.signals
    e, s = signals.range.shape
    # the additions below also reach idle lanes, the noise does not
    ranges, rates = np.zeros((e, s, lanes)), np.zeros((e, s, lanes))
    delay = signals.range_bias[..., None]
    of_space: list[np.ndarray | None] = [None] * len(runs)
    if signals.source_errors is not None:
        drawn_in_space = [
            generator(seed, run, "space").standard_normal((s, signals.source_errors.shape[2])) for run in runs
        ]
        late = [signals.range_bias + np.einsum("esk,sk->es", signals.source_errors, drawn) for drawn in drawn_in_space]
        of_space = [*drawn_in_space]
        delay = np.stack(late, axis=-1)
    sigma, divergence = signals.sigma[..., None], np.zeros((1, 1, 1))
    if (losses := signals.losses) is not None:
        mine = (losses.drawn(generator(seed, run, "corrections")) for run in runs)
        changes = [losses.changes(rows, drawn) for rows, drawn in zip(mine, of_space, strict=True)]
        later, divergence, variance = (np.stack([change[k] for change in changes], axis=-1) for k in range(3))
        delay, sigma = delay + later, np.sqrt(np.maximum(sigma**2 + variance, 0.0))
    if signals.offset is not None:
        scales = signals.offset.shape[1]
        apart = [signals.offset @ generator(seed, run, "space", 1).standard_normal(scales) for run in runs]
        delay = delay + np.stack(apart, axis=-1)[None]
    if (air := signals.drawn_air) is not None and signals.transmitters is not None:
        errors = signals.transmitters.errors
        delay = delay + np.stack([air * drawn_refractivity(errors, seed, run) for run in runs], axis=-1)
    if correlated is not None and signals.correlated is not None:
        # errors after smoothing: in code and carrier alike
        late = [np.sum(signals.correlated.sigma * correlated[..., lane], axis=0) for lane in range(len(runs))]
        delay = delay + np.stack(late, axis=-1)
    faster = None
    if signals.wandering is not None:
        rngs = [generator(seed, run, "clock", 2) for run in runs]
        late, faster = signals.wandering.drawn(signals.time, rngs)
        delay = delay + late
    if shared.noise_distribution is not None:
        # of a branch: the stream itself is that of Gaussian noise
        of_runs = (generator(seed, run, "measurements", 1) for run in runs)
        sigma = sigma * np.stack([shared.noise_distribution.scales(rng, (e, s)) for rng in of_runs], axis=-1)
    true = (signals.range[..., None], signals.range_rate[..., None]) if flown is None else (flown.ranges, flown.rates)
    noise.measure(
        noises, true[0], delay, sigma, true[1], signals.rate_sigma,
        signals.used, shared.clock, ranges, rates,
    )  # fmt: skip
    if faster is not None:
        rates[..., : len(runs)] += faster
    if wandered is not None:
        ranges += wandered.at_fixes[:, None, 0]
        rates += wandered.at_fixes[:, None, 1]
    if signals.smoothing is None:
        return ranges, rates, None
    phases = np.zeros((e, s, lanes))
    for lane, run in enumerate(runs):
        drawn = generator(seed, run, "carrier").standard_normal((e, s))
        longer = delay[..., min(lane, delay.shape[2] - 1)] - divergence[..., min(lane, divergence.shape[2] - 1)]
        if flown is not None:
            longer = longer + (flown.ranges[..., lane] - signals.range)
        phases[..., lane] = carrier(shared, longer) + CARRIER_SIGMA * drawn
    if wandered is not None:
        phases += wandered.at_fixes[:, None, 0]
    return ranges, rates, phases


def range_noise(shared: SharedTruth, seed: int, runs: Sequence[int]) -> np.ndarray:
    """Standard normal numbers of the ranges and range rates of runs (r, e, s, 2)."""
    return normals([generator(seed, run, "measurements") for run in runs], *shared.signals.range.shape, 2)


def generators(
    seed: int, runs: Sequence[int], stream: str, lanes: int, *branch: int
) -> tuple[np.random.Generator, ...]:
    """A random stream of each run, or a branch of it; further lanes get that of the last run and draw nothing."""
    own = [generator(seed, run, stream, *branch) for run in runs]
    return (*own, *(own[-1] for _ in range(lanes - len(own))))


def stated_fixes(
    shared: SharedTruth,
    fixes: ReceiverFixes,
    stated: StatedFixes,
    sigma: np.ndarray,
    flown: DispersedTrajectories | None,
) -> ReceiverFixes:
    """Fixes of a receiver whose fixes have a state, where it has one from ranges; their covariance is by their flag.

    sigma: (5, 3) by flag, see `FilterDesign.flag_sigma`.
    """
    sigma = np.where(np.isnan(sigma), 1.0, sigma)  # those of flags that the filter does without
    signals, lanes = shared.signals, stated.flag.shape[1]
    own = (signals.antenna, signals.antenna_velocity)
    position, velocity = map(in_all_lanes, own) if flown is None else (flown.antenna, flown.antenna_velocity)
    llh = earth.llh_from_ecef(position.transpose(2, 0, 1).reshape(-1, 3))
    turned = np.einsum("nij,nj->ni", earth.ned_matrix(llh), velocity.transpose(2, 0, 1).reshape(-1, 3))
    error = stated.error.transpose(2, 0, 1).reshape(-1, 6)
    moved = earth.shifted(llh, error[:, :3], llh)
    back = [m.reshape(lanes, -1, 3).transpose(1, 2, 0) for m in (moved, turned + error[:, 3:])]
    lost = np.isnan(fixes.llh[:, :1])
    of_axes = sigma[stated.flag][..., [0, 0, 1, 2, 2, 2]].transpose(0, 2, 1)
    covariance = np.zeros((len(lost), 6, 6, lanes))
    covariance[:, range(6), range(6)] = of_axes**2
    own_llh, own_velocity = (np.where(lost, np.nan, m) for m in back)
    return ReceiverFixes(own_llh, own_velocity, fixes.clocks, covariance)


def receiver_fixes(shared: SharedTruth, ranges: np.ndarray, rates: np.ndarray) -> ReceiverFixes:
    """The receiver's fixes from measurements (e, s), or of lanes (e, s, W)."""
    return _fixes(shared, shared.signals, ranges, rates)


def filter_fixes(shared: SharedTruth, ranges: np.ndarray, rates: np.ndarray) -> ReceiverFixes:
    """The fixes that a loosely coupled filter takes: those of the receiver, if need be with other weights."""
    return _fixes(shared, shared.signals.of_filter, ranges, rates)


def _fixes(shared: SharedTruth, signals: Signals, ranges: np.ndarray, rates: np.ndarray) -> ReceiverFixes:
    lanes = (m if m.ndim == 3 else in_all_lanes(m) for m in (ranges, rates))
    out = solve_fixes(shared.start, signals, *lanes)
    return out if ranges.ndim == 3 else ReceiverFixes(*(m[..., 0].copy() for m in out))
