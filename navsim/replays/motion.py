"""Motion of a recorded flight at its fixes: moving or parked, turning or straight on; correlation of innovations."""

from __future__ import annotations

import numpy as np

from navsim.replays.recorded_flight import RecordedFlight

FASTEST_NEEDED = 3.0
"""Speed over ground, m/s, above which a fix of any flight counts as in motion."""
SLOWEST, SLOWEST_DERIVED = 0.5, 1.5
"""Least speed, m/s, of a fix in motion, and where positions alone give the speed: receivers at rest show less."""
TYPICAL, SHARE = 90.0, 0.5
"""Percentile of the speeds of a slow flight, and the fraction of it above which a fix counts as in motion."""
TREMBLING, TREMBLE_TIME, PIECE = np.radians(2.0), 1.0, 0.25
"""Scatter, rad/s, of the rates of rotation over pieces, s, of the time around a fix, s, above which a slow aircraft is
in the air: at rest they show 0.1 deg/s."""
TURN_TIME = 2.0
"""Time over which a rate of rotation is averaged, s."""


def moving_speed(speed: np.ndarray, derived: bool) -> float:
    """Speed, m/s, above which a fix is in motion in a flight with speeds (m,); derived: from positions alone.

    3 m/s, or in a slow flight half of its usual speed.
    """
    known = speed[np.isfinite(speed)]
    usual = SHARE * float(np.percentile(known, TYPICAL)) if known.size else 0.0
    return float(np.clip(usual, SLOWEST_DERIVED if derived else SLOWEST, FASTEST_NEEDED))


def in_motion(flight: RecordedFlight, threshold: float) -> np.ndarray:
    """Which fixes (m,) are in motion: those faster than `threshold`, m/s, as of `moving_speed`.

    In a slow flight a hovering aircraft too, from the first fast fix to the last one: it trembles. Before and after,
    hands may move it.
    """
    fast = np.asarray(flight.speed > threshold)
    if threshold >= FASTEST_NEEDED:
        return fast
    rows = np.flatnonzero(fast)
    aloft = np.zeros(fast.size, bool)
    aloft[slice(rows[0], rows[-1] + 1) if rows.size else slice(None)] = True
    return fast | (aloft & (_trembling(flight) > TREMBLING))


def turn_rate(flight: RecordedFlight) -> np.ndarray:
    """Mean size of the rate of rotation around each fix (m,), rad/s, over `TURN_TIME`."""
    return np.asarray(np.linalg.norm(_rates(flight, np.array([-0.5, 0.5]) * TURN_TIME)[:, 0], axis=1))


def _trembling(flight: RecordedFlight) -> np.ndarray:
    """Scatter of the rates of rotation around each fix (m,), rad/s, for all axes together."""
    rates = _rates(flight, np.arange(-TREMBLE_TIME, TREMBLE_TIME + 0.5 * PIECE, PIECE))
    return np.asarray(np.sqrt(rates.var(axis=1).sum(axis=1)))


def _rates(flight: RecordedFlight, edges: np.ndarray) -> np.ndarray:
    """Mean rates of rotation (m, k - 1, 3), rad/s, between edges (k,), s after each fix."""
    angle = np.concatenate([np.zeros((1, 3)), np.cumsum(flight.dtheta, axis=0)])
    times = flight.arrival[:, None] + edges
    at = np.stack([np.interp(times, flight.imu_time, angle[:, i]) for i in range(3)], axis=2)
    return np.asarray(np.diff(at, axis=1) / np.diff(edges)[:, None])


def lag1_correlation(x: np.ndarray) -> float:
    """Correlation of innovations (m, k) over their sigmas with those before; nan without any. White ones have 0."""
    both = np.isfinite(x[1:]) & np.isfinite(x[:-1])
    square = float(np.sum(x[1:][both] ** 2) + np.sum(x[:-1][both] ** 2))
    return float(2.0 * np.sum(x[1:][both] * x[:-1][both]) / square) if square > 0.0 else float("nan")
