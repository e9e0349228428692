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
from navsim.statistics.rounding import digits

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
GYRO_NOISE, ACCELEROMETER_NOISE, LATENCY, VELOCITY_LAG, POSITION_RATIO, ERROR_SIZE, ERROR_TIME, SETTINGS = range(2, 10)
"""Numbers of the settings that all filters have, after the two of the noise of fixes or ranges, and how many there
are."""
TIMES = np.isin(np.arange(SETTINGS), (LATENCY, VELOCITY_LAG))
"""Settings that are times, searched in tenths of a second; the others are searched as logarithms."""
SEARCHED = (FIX_LATENCIES[0], 2.0)
"""Bounds between which the latency is searched, s. A larger one can be given; it is rather an offset of the clocks."""
WIDEST_LAG = 1.0
"""Largest difference between the latencies of velocity and position that is searched, s."""
AT_BOUND = 0.01
"""Distance from a bound of the latency, s, below which the latency is at that bound."""
COARSE = 2.5
"""Step between the latencies that are tried before the search, tenths of a second."""
LAGS = (-0.8, -0.4, -0.15, 0.15, 0.4, 0.8)
"""Differences between the latencies of velocity and position that are tried, s."""
ERRORS = ((5.0, 1.0), (20.0, 1.0), (20.0, 2.0), (60.0, 2.0), (60.0, 4.0), (200.0, 8.0))
"""Correlation times, s, and sizes, over the noise of positions, of errors of the fixes that are tried."""
LIKELIER = 12.5
"""Gain of log-likelihood from which on such a lag or error is certain: five sigma."""
FACTOR, SIZES, CORRELATION_TIMES = 1e4, (0.05, 100.0), (2.0, 1000.0)
"""Bounds of a search: of noise over its start, of the size of an error as above, and of its correlation time, s."""
REGION = (0.7, 0.02)
"""Radius of the trust region at begin and end."""
EVALUATIONS, ROUND = 1000, 200
"""Largest number of flights of a tuning, and of one search."""
WORTH = 0.5
"""Gain of log-likelihood that a search has to bring for another one to begin where it ended."""


@dataclass(frozen=True)
class Tuning:
    """Settings as of `Recording.tuned`; which of them are tuned, bool; warnings about them."""

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
    """The settings with the free ones most likely. Then a lag of the velocities and a time-correlated error of the
    positions are tried, and tuned with the rest where they are clearly likelier."""
    free, given = recording.free, recording.settings
    tuned = np.isin(np.arange(SETTINGS), free)
    if not free.size:
        return Tuning(given, tuned)
    threshold = recording.moving_speed
    fast = int(np.sum(recording.flight(given).speed > threshold))
    if fast <= FEWEST:
        names = ", ".join(recording.tuned[i].replace("_", " ") for i in free)
        remark = (
            f"nothing is tuned: {fast} fixes are in motion (faster than {digits(threshold, 2)} m/s), needed are more "
            f"than {FEWEST}, and receivers at rest do not show their noise; untuned are {names}: give them in the log"
        )
        return Tuning(given, np.zeros(SETTINGS, bool), (Finding("tuning", remark),))
    search = _Search(recording, done)
    best, least, converged = search.settle(search.begin(free), free)
    # a lag is looked for again after an error of the positions that may have hidden it
    of_lag, of_error = (search.lags, [VELOCITY_LAG]), (search.errors, [ERROR_SIZE, ERROR_TIME])
    for number, (trials, which) in enumerate((of_lag, of_error, of_lag)):
        again = number > 1 and ERROR_SIZE not in free
        tried = [] if again or np.isin(which, free).any() else trials(best)
        costs = [search.surprise(trial) for trial in tried]
        if min(costs, default=np.inf) < least - LIKELIER:
            free = np.union1d(free, which)
            best, least, converged = search.settle(tried[int(np.argmin(costs))], free)
    tuned = np.isin(np.arange(SETTINGS), free)
    if not recording.has_vertical:
        best[1] = best[0]
        tuned[1] = tuned[0]
    remarks = _remarks(recording, best, free, converged, search.flown)
    return Tuning(best, tuned, tuple(Finding("tuning", remark, (CONSISTENT,)) for remark in remarks))


class _Search:
    """Search for the likeliest settings of a recording."""

    def __init__(self, recording: Recording, done: Callable[[int], None]) -> None:
        self.recording, self.done = recording, done
        self.flown, self._worst = 0, 0.0

    def begin(self, free: np.ndarray) -> np.ndarray:
        """Settings at which the search starts."""
        start = self.recording.settings.copy()
        if LATENCY in free:

            def cost(latency: float) -> float:
                return self.surprise(np.where(np.arange(SETTINGS) == LATENCY, 0.1 * latency, start), False)

            start[LATENCY] = 0.1 * _first_latency(cost)
        return start

    def surprise(self, values: np.ndarray, judged: bool = True) -> float:
        """Negative log-likelihood of the innovations in motion and of the sensors' noise; judged: with the gate."""
        recording = self.recording
        flight, design = recording.flight(values), recording.design(values, TFG)
        if not judged:
            design = replace(design, gate=gate_limits(0.0))
        seen = replay.fly(
            flight, design, recording.fix_sigma(values), np.empty(0), range_sigma=recording.range_sigma(values)
        )
        of_rejected = recording.of_rejected(recording.settings, flight)
        total = seen.surprise(flight.speed > recording.moving_speed, of_rejected)
        strayed = np.log(values[GYRO_NOISE:LATENCY] / recording.settings[GYRO_NOISE:LATENCY]) / TRUST
        return total + 0.5 * float(np.sum(strayed**2))

    def settle(self, start: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, float, bool]:
        """The likeliest settings with the free ones changed from `start` on, their negative log-likelihood, and whether
        the search converged.

        A trust region with quadratic models, begun again where it has ended until that gains nothing: the gate makes
        steps in the likelihood.
        """
        from scipy.optimize import Bounds, minimize

        def settings(x: np.ndarray) -> np.ndarray:
            whole = start.copy()
            whole[free] = np.where(TIMES[free], 0.1 * x, np.exp(np.where(TIMES[free], 0.0, x)))
            return whole

        def cost(x: np.ndarray) -> float:
            self.flown += 1
            self.done(min(self.flown, EVALUATIONS))
            total = self.surprise(settings(x))
            self._worst = max(self._worst, total) if np.isfinite(total) else self._worst + 100.0
            return total if np.isfinite(total) else self._worst

        def searched(values: np.ndarray) -> np.ndarray:
            return np.where(TIMES, 10.0 * values, np.log(np.where(TIMES | (values <= 0.0), 1.0, values)))[free]

        low, high = start / FACTOR, start * FACTOR
        low[LATENCY], high[LATENCY] = SEARCHED
        low[VELOCITY_LAG], high[VELOCITY_LAG] = -WIDEST_LAG, WIDEST_LAG
        low[ERROR_SIZE], high[ERROR_SIZE] = SIZES
        low[ERROR_TIME], high[ERROR_TIME] = CORRELATION_TIMES
        bounds = Bounds(searched(low), searched(high))
        x, least, converged = searched(start), np.inf, False
        while not converged and self.flown < EVALUATIONS:
            options = {"maxfev": max(min(ROUND, EVALUATIONS - self.flown), 2 * free.size + 2), "scale": False,
                       "initial_tr_radius": REGION[0], "final_tr_radius": REGION[1]}  # fmt: skip
            found = minimize(cost, x, method="COBYQA", bounds=bounds, options=options)  # type: ignore[call-overload]  # stubs lack it
            converged = bool(found.success) and least - found.fun < WORTH
            x, least = (found.x, found.fun) if found.fun < least else (x, least)
        return settings(x), least, converged

    def lags(self, values: np.ndarray) -> list[np.ndarray]:
        """Settings with velocities that are older or newer than the positions, either of which keeps its latency."""
        gnss = self.recording.scenario.gnss
        if self.recording.tight or not self.recording.has_velocity or gnss.velocity_latency_s is not None:
            return []
        if gnss.latency_s is not None:
            return []
        out = []
        for lag in LAGS:
            for latency in (values[LATENCY], values[LATENCY] - lag):
                if SEARCHED[0] <= latency <= SEARCHED[1]:
                    trial = values.copy()
                    trial[VELOCITY_LAG], trial[LATENCY] = lag, latency
                    out.append(trial)
        return out

    def errors(self, values: np.ndarray) -> list[np.ndarray]:
        """Settings with a time-correlated error of the positions."""
        recording = self.recording
        if recording.tight or recording.scenario.gnss.errors or recording.fixes.has_own_noise:
            return []
        out = []
        for time, size in ERRORS:
            trial = values.copy()
            trial[ERROR_TIME], trial[ERROR_SIZE] = time, size
            out.append(trial)
        return out


def _first_latency(cost: Callable[[float], float]) -> float:
    """The latency, tenths of a second, at which the search starts: 0.1 s, unless another one is more likely. cost: of
    flights without the gate. With it, all fixes are rejected if the latency is far off, and the cost has no slope."""
    near, (lowest, highest) = 1.0, (10.0 * bound for bound in SEARCHED)
    coarse = np.arange(np.ceil((lowest - near) / COARSE), np.floor((highest - near) / COARSE) + 1.0) * COARSE + near
    coarse = np.unique([lowest, *coarse, highest])
    best = float(min(coarse, key=cost))
    if best == near:
        return near
    fine = best + COARSE * np.array([-0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8])
    return float(min(fine[(fine >= lowest) & (fine <= highest)], key=cost))


def _remarks(recording: Recording, best: np.ndarray, free: np.ndarray, converged: bool, flown: int) -> list[str]:
    """Warnings about a tuning."""
    out = []
    if not converged:
        names = ", ".join(recording.tuned[i].replace("_", " ") for i in free)
        out.append(
            f"the tuning had not converged after {flown} flights: its numbers ({names}) may be far from the most "
            "likely ones; give some of them in the log, or fly a longer part"
        )
    if LATENCY in recording.free and min(abs(best[LATENCY] - bound) for bound in SEARCHED) <= AT_BOUND:
        side = "earlie" if best[LATENCY] < 0.0 else "late"
        out.append(
            f"the tuned latency is at its bound of {digits(best[LATENCY])} s. The fixes are stamped even {side}r than "
            "that, or something else is wrong with them. Set the clocks right with gnss.time_offset_s, or give "
            f"gnss.latency_s ({FIX_LATENCIES[0]:g} to {FIX_LATENCIES[1]:g} s)"
        )
    if VELOCITY_LAG in free and WIDEST_LAG - abs(best[VELOCITY_LAG]) <= AT_BOUND:
        older = "older" if best[VELOCITY_LAG] > 0.0 else "newer"
        out.append(
            f"the velocities of the fixes are {WIDEST_LAG:g} s {older} than the positions, the bound of the search, or "
            f"something else is wrong with them. Give gnss.velocity_latency_s ({FIX_LATENCIES[0]:g} to "
            f"{FIX_LATENCIES[1]:g} s)"
        )
    for i, key in (
        (GYRO_NOISE, "imu.gyro.arw_deg_sqrt_h"), (ACCELEROMETER_NOISE, "imu.accelerometer.vrw_m_s_sqrt_h"),
    ):  # fmt: skip
        ratio = float(best[i] / recording.settings[i])
        if i in recording.free and np.log(ratio) > STRAYED * TRUST:
            out.append(
                f"the tuned {recording.tuned[i].replace('_', ' ')} is {digits(ratio)} times that of the sensor class. "
                "The fixes or the attitude disagree with the samples by more than noise does. Look at the innovations, "
                f"choose another imu.sensor_class, or give {key}"
            )
    return out
