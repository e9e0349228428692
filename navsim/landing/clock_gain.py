"""Pseudolites whose clock errors leave them without effect in fixes: a warning before the flight.

The receiver weights ranges by their declared errors. A clock that was set long before has so large an error that its
range has no weight, and a loosely coupled filter sees fixes only. The filter can still learn a clock's offset from the
change of ranges during the approach, unless the clock's unknown rate changes them by more than the fixes' sigma.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from navsim.environment.sources import touchdown_time
from navsim.landing.plausibility import free_clocks
from navsim.statistics.rounding import digits

if TYPE_CHECKING:
    from navsim.gnss.pseudorange import Signals
    from navsim.scenario.landing import Landing
    from navsim.trajectory.kinematics import Moving

LEAST_GAIN = 0.1
"""Decrease of horizontal and vertical sigma of fixes by pseudolites, below which they are in vain."""
_LEAST_VARIANCE = 1e-6
"""Variance of a range besides its clock, m2, that rounding leaves."""
_EPOCHS = 50
"""Number of fixes to compute it for."""
_SINGULAR = 1e10
"""Condition number of normalised normal equations beyond which there is no fix."""


def clock_gain_warnings(scenario: Landing, trajectory: Moving, signals: Signals) -> list[str]:
    """Warning of pseudolites that are in vain for a loosely coupled filter because of their wandering clocks."""
    count, errors = len(scenario.pseudolites.placed()), scenario.pseudolites.errors()
    if not count or not errors.wanders or scenario.filter.tight or any(free_clocks(scenario)):
        return []
    received = signals.used[:, -count:].any(axis=1) & (signals.time <= touchdown_time(scenario, trajectory))
    fixes = np.flatnonzero(received)
    if not fixes.size:
        return []
    fixes = fixes[np.unique(np.linspace(0, fixes.size - 1, _EPOCHS).astype(int))]
    time, sigma, sky = signals.time[fixes], signals.fix_sigma[fixes], np.arange(len(signals.names)) < len(signals.names)
    sky[-count:] = False
    clock = errors.clock_covariance(time)
    square = sigma**2 - np.where(sky, 0.0, clock[:, :1, 0] + errors.offset**2)
    of_sky, declared, ideal = (
        fix_sigmas(signals.los[fixes], signals.time_scale, each, signals.used[fixes] & kept)
        for each, kept in ((sigma, sky), (sigma, True), (np.sqrt(np.maximum(square, _LEAST_VARIANCE)), True))
    )
    found, possible = (_largest_gain(each, of_sky) for each in (declared, ideal))
    drifted = float(np.sqrt(clock[0, 1, 1]) * (time[-1] - time[0]))
    if found >= LEAST_GAIN or possible < LEAST_GAIN or drifted < of_sky.min():
        return []
    first, last = (digits(float(size)) for size in np.sqrt(clock[[0, -1], 0, 0]))
    return [
        f"pseudolites: their clocks, set {errors.age:g} s before time 0 (clock_age_s), are off by {first} m to "
        f"{last} m (1 sigma). So they make sigma of fixes at most {100.0 * found:.1f} % smaller (with perfect clocks "
        f"{100.0 * possible:.0f} %), and a loosely coupled filter is hardly better than without pseudolites. Write "
        "filter.coupling: tight, whose filter learns the clocks, or set the clocks later"
    ]


def fix_sigmas(los: np.ndarray, scale: np.ndarray, sigma: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Horizontal and vertical 1 sigma of weighted fixes, m (e, 2); inf without a solution.

    los: unit vectors (e, s, 3) along north, east, down. scale: time scales (s,). sigma: of ranges, m (e, s). used:
    (e, s) bool.
    """
    of_scale = np.broadcast_to(scale[:, None] == np.unique(scale), (*used.shape, np.unique(scale).size))
    rows = np.where(used[..., None], np.concatenate([los, of_scale], axis=2), 0.0)
    rows /= np.where(used, sigma, 1.0)[..., None]
    normal = np.einsum("esi,esj->eij", rows, rows)
    size = np.sqrt(np.einsum("eii->ei", normal))
    unseen = size == 0.0
    size[unseen] = 1.0
    normal = normal / (size[:, :, None] * size[:, None]) + np.eye(size.shape[1]) * unseen[:, None]
    out, solved = np.full((len(used), 2), np.inf), np.linalg.cond(normal) < _SINGULAR
    variance = np.einsum("eii->ei", np.linalg.inv(normal[solved])) / size[solved] ** 2
    out[solved] = np.sqrt(np.stack([variance[:, :2].sum(axis=1), variance[:, 2]], axis=1))
    out[unseen[:, :3].any(axis=1)] = np.inf
    return out


def _largest_gain(sigma: np.ndarray, without: np.ndarray) -> float:
    """Largest relative decrease of sigmas (e, 2), 1 where there is a fix only with pseudolites."""
    fixed = np.isfinite(sigma)
    return float(np.max(1.0 - sigma[fixed] / without[fixed], initial=0.0))
