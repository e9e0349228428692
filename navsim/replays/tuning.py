"""Noise and latency of a recorded flight, such that the innovations of its fixes in motion are most likely [1].

Source: [1] Mehra, On the identification of variances and adaptive Kalman filtering, IEEE Trans. AC 15 (1970); Harvey,
Forecasting, structural time series models and the Kalman filter (1989), section 3.4 (prediction error decomposition).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from navsim.filter.records import TFG
from navsim.replays import flight as replay
from navsim.results.findings import CONSISTENT, Finding
from navsim.runner.statistics import gate_limits
from navsim.scenario.base import FIX_LATENCIES

if TYPE_CHECKING:
    from navsim.replays.study import Recording

FASTEST_NEEDED = 3.0
"""Speed over ground, m/s, above which a fix of any flight counts as in motion."""
SLOWEST, SLOWEST_DERIVED = 0.5, 1.5
"""Least speed, m/s, of a fix in motion, and where positions alone give the speed: receivers at rest show less."""
TYPICAL, SHARE = 90.0, 0.5
"""Percentile of the speeds of a slow flight, and the fraction of it above which a fix counts as in motion."""
FEWEST = 20
"""Number of fixes in motion that a tuning has to exceed: receivers at rest smooth their fixes and so hide the noise."""
TRUST = 0.7
"""1 sigma of the logarithm of a sensor's noise about its class's value, before the flight is looked at."""
STRAYED = 5.0
"""Sigmas of `TRUST` beyond which a tuned noise is no sensor's: an airframe's vibration reaches 4.4 (a factor of 22)."""
GYRO_NOISE, ACCELEROMETER_NOISE, LATENCY, SETTINGS = 2, 3, 4, 5
"""Numbers of the settings that all filters have, after the two of the noise of fixes or ranges, and how many there
are."""
SEARCHED = (FIX_LATENCIES[0], 2.0)
"""Bounds between which the latency is searched, s. A larger one can be given; it is rather an offset of the clocks."""
AT_BOUND = 0.01
"""Distance from a bound of the latency, s, below which the latency is at that bound."""
COARSE = 2.5
"""Step between the latencies that are tried before the simplex, tenths of a second."""
WANDERING = ((5.0, 1.0), (20.0, 1.0), (20.0, 2.0), (60.0, 2.0), (60.0, 4.0), (200.0, 8.0))
"""Correlation times, s, and sizes, over the noise of positions, of errors of the fixes that are looked for."""
LIKELIER = 12.5
"""Gain of log-likelihood from which on such an error is certain: five sigma."""
EVALUATIONS = 1000
"""Largest number of flights of a tuning."""
SIMPLEX = 200
"""Largest number of flights of one simplex."""
WORTH = 0.5
"""Gain of log-likelihood that a simplex has to bring for another one to begin where it ended."""


@dataclass(frozen=True)
class Tuning:
    """Settings (5,) as of `Recording.tuned`; which of them are tuned (5,) bool; warnings about them."""

    settings: np.ndarray
    tuned: np.ndarray
    findings: tuple[Finding, ...] = ()


def moving_speed(speed: np.ndarray, derived: bool) -> float:
    """Speed, m/s, above which a fix is in motion in a flight with speeds (m,); derived: from positions alone.

    3 m/s, or in a slow flight half of its usual speed.
    """
    known = speed[np.isfinite(speed)]
    usual = SHARE * float(np.percentile(known, TYPICAL)) if known.size else 0.0
    return float(np.clip(usual, SLOWEST_DERIVED if derived else SLOWEST, FASTEST_NEEDED))


def tune(recording: Recording, done: Callable[[int], None] = lambda _: None) -> Tuning:
    """The settings with the free ones most likely, by Nelder and Mead's simplex over their logarithms, begun again
    where it has ended until that gains nothing."""
    free, given = recording.free, recording.settings
    tuned = np.isin(np.arange(SETTINGS), free)
    if not free.size:
        return Tuning(given, tuned)
    threshold = recording.moving_speed
    fast = int(np.sum(recording.flight(given[LATENCY]).speed > threshold))
    if fast <= FEWEST:
        names = ", ".join(recording.tuned[i].replace("_", " ") for i in free)
        remark = (
            f"nothing is tuned: {fast} fixes are in motion (faster than {threshold:.2g} m/s), needed are more than "
            f"{FEWEST}, and receivers at rest do not show their noise; untuned are {names}: give them in the log"
        )
        return Tuning(given, np.zeros(SETTINGS, bool), (Finding("tuning", remark),))
    from scipy.optimize import minimize

    scale = np.where(np.arange(SETTINGS) == LATENCY, 0.1, 1.0)  # the latency itself, in tenths of a second
    start = np.where(np.arange(SETTINGS) == LATENCY, given / scale, np.log(np.maximum(given, 1e-9)))
    start[LATENCY] = 1.0 if LATENCY in free else start[LATENCY]
    flown = 0

    def settings(x: np.ndarray) -> np.ndarray:
        whole = start.copy()
        whole[free] = x
        return np.where(np.arange(SETTINGS) == LATENCY, scale * whole, np.exp(whole))

    def cost(x: np.ndarray) -> float:
        nonlocal flown
        flown += 1
        done(min(flown, EVALUATIONS))
        return surprise(x, True)

    def surprise(x: np.ndarray, judged: bool) -> float:
        values = settings(x)
        if not SEARCHED[0] <= values[LATENCY] <= SEARCHED[1]:
            return 1e12
        total = _surprise(recording, values, judged)
        total += 0.5 * float(np.sum((np.log(values[GYRO_NOISE:LATENCY] / given[GYRO_NOISE:LATENCY]) / TRUST) ** 2))
        return total if np.isfinite(total) else 1e12

    if LATENCY in free:
        start[LATENCY] = _first_latency(
            lambda latency: surprise(np.where(free == LATENCY, latency, start[free]), False)
        )
    x, least, converged = start[free], np.inf, False
    step = np.diag(np.where(free == LATENCY, 0.5, 0.7))
    # a simplex shrinks to points that are no optimum, above all where the gate makes steps in the cost
    while not converged and flown < EVALUATIONS:
        options = {"maxfev": min(SIMPLEX, EVALUATIONS - flown), "initial_simplex": np.vstack([x, x + step]),
                   "xatol": 0.01, "fatol": 0.05}  # fmt: skip
        found = minimize(cost, x, method="Nelder-Mead", options=options)  # type: ignore[call-overload]
        converged = bool(found.success) and least - found.fun < WORTH
        x, least = found.x, found.fun
    best = settings(x)
    if not recording.has_vertical:
        best[1] = best[0]
        tuned[1] = tuned[0]
    remarks = [*_remarks(recording, best, converged, flown), *wandering_errors(recording, best)]
    return Tuning(best, tuned, tuple(Finding("tuning", remark, (CONSISTENT,)) for remark in remarks))


def _surprise(recording: Recording, values: np.ndarray, judged: bool = True) -> float:
    """Negative log-likelihood of the innovations in motion, by settings (5,); judged: with the gate."""
    flight, design = recording.flight(values[LATENCY]), recording.design(values, TFG)
    if not judged:
        design = replace(design, gate=gate_limits(0.0))
    seen = replay.fly(
        flight, design, recording.fix_sigma(values), np.empty(0), range_sigma=recording.range_sigma(values)
    )
    return seen.surprise(flight.speed > recording.moving_speed, recording.of_rejected(recording.settings, flight))


def wandering_errors(recording: Recording, settings: np.ndarray) -> list[str]:
    """Warning about position errors with a correlation time of seconds to minutes.

    It is given if a filter that estimates them finds the innovations likelier. One that treats them as white noise has
    too small a position sigma.
    """
    if recording.tight or recording.scenario.gnss.errors or recording.fixes.has_own_noise:
        return []
    noise = recording.fix_sigma(settings)[[0, 2]]
    before = _surprise(recording, settings)
    gains = [before - _surprise(recording.with_error(time, tuple(size * noise)), settings) for time, size in WANDERING]
    gain = max(gains)
    if not gain > LIKELIER:
        return []
    time, size = WANDERING[gains.index(gain)]
    horizontal, vertical = (f"{sigma:.2g}" for sigma in size * noise)
    return [
        f"the position errors of the fixes wander over about {time:g} s by {horizontal} m (1 sigma). A filter that "
        f"follows them explains the innovations far better (log-likelihood higher by {gain:.0f}). Without it the "
        f"sigmas of position are too small. Write `gnss: {{errors: [{{correlation_time_s: {time:g}, position_sigma_m: "
        f"[{horizontal}, {vertical}]}}]}}`"
    ]


def _first_latency(cost: Callable[[float], float]) -> float:
    """The latency, tenths of a second, at which the simplex starts: 0.1 s, unless another one is more likely. cost: of
    flights without the gate. With it, all fixes are rejected if the latency is far off, and the cost has no slope."""
    near, (lowest, highest) = 1.0, (10.0 * bound for bound in SEARCHED)
    coarse = np.arange(np.ceil((lowest - near) / COARSE), np.floor((highest - near) / COARSE) + 1.0) * COARSE + near
    coarse = np.unique([lowest, *coarse, highest])
    best = float(min(coarse, key=cost))
    if best == near:
        return near
    fine = best + COARSE * np.array([-0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8])
    return float(min(fine[(fine >= lowest) & (fine <= highest)], key=cost))


def _remarks(recording: Recording, best: np.ndarray, converged: bool, flown: int) -> list[str]:
    """Warnings about a tuning."""
    out = []
    if not converged:
        names = ", ".join(recording.tuned[i].replace("_", " ") for i in recording.free)
        out.append(
            f"the tuning had not converged after {flown} flights: its numbers ({names}) may be far from the most "
            "likely ones; give some of them in the log, or fly a longer part"
        )
    if LATENCY in recording.free and min(abs(best[LATENCY] - bound) for bound in SEARCHED) <= AT_BOUND:
        side = "earlie" if best[LATENCY] < 0.0 else "late"
        out.append(
            f"the tuned latency is at its bound of {best[LATENCY]:.3g} s. The fixes are stamped even {side}r than "
            "that, or something else is wrong with them. Set the clocks right with gnss.time_offset_s, or give "
            f"gnss.latency_s ({FIX_LATENCIES[0]:g} to {FIX_LATENCIES[1]:g} s)"
        )
    for i, key in (
        (GYRO_NOISE, "imu.gyro.arw_deg_sqrt_h"), (ACCELEROMETER_NOISE, "imu.accelerometer.vrw_m_s_sqrt_h"),
    ):  # fmt: skip
        ratio = float(best[i] / recording.settings[i])
        if i in recording.free and np.log(ratio) > STRAYED * TRUST:
            out.append(
                f"the tuned {recording.tuned[i].replace('_', ' ')} is {ratio:.3g} times that of the sensor class. The "
                "fixes or the attitude disagree with the samples by more than noise does. Look at the innovations, "
                f"choose another imu.sensor_class, or give {key}"
            )
    return out
