"""Noise and latency of a recorded flight, such that the innovations of its fixes in motion are most likely [1].

Source: [1] Mehra, On the identification of variances and adaptive Kalman filtering, IEEE Trans. AC 15 (1970). [2]
Harvey, Forecasting, structural time series models and the Kalman filter (1989), section 3.4 (prediction error
decomposition, method of scoring). [3] Marquardt, J. SIAM 11 (1963): 431-441. [4] Ragonneau & Zhang, COBYQA (2022).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from navsim.filter.design import gate_limits
from navsim.filter.measurement_kinds import HEADING
from navsim.filter.records import REJECTED, TFG, USED
from navsim.replays import flight as replay
from navsim.replays.motion import in_motion, lag1_correlation
from navsim.replays.recorded_flight import RecordedFlight
from navsim.results.findings import Finding
from navsim.results.notes import CONSISTENT
from navsim.scenario_files.base import FIX_LATENCIES
from navsim.statistics.rounding import digits, value_text

if TYPE_CHECKING:
    from scipy.optimize import Bounds

    from navsim.replays.study import Recording

FEWEST = 20
"""Number of fixes in motion that a tuning has to exceed: receivers at rest smooth their fixes and so hide the noise."""
TRUST = 0.7
"""1 sigma of the logarithm of a sensor's noise about its class's value, before the flight is looked at."""
GYRO_NOISE, ACCELEROMETER_NOISE, LATENCY, VELOCITY_LAG, POSITION_RATIO, ERROR_SIZE, ERROR_TIME = range(2, 9)
"""Numbers of the settings that all filters have, after the two of the noise of fixes or ranges."""
CLAIMS = ((ERROR_SIZE, 0.3), (ERROR_TIME, 2.0))
"""1 sigma of the logarithms of the true accuracy over the claimed one, and of its correlation time."""
UNCLAIMED = ((ERROR_TIME, 1.0),)
"""The same of the correlation time where the receiver claims nothing."""
LASTING_TIME = 100.0
"""Correlation time of errors that last, s, before the flight is looked at."""
WHITE_START, LASTING_START = 1.5, 4.0
"""White noise of positions over its least, and lasting error over the white noise, where their search starts."""
NEGLIGIBLE = 0.1
"""A lasting error below this part of the white noise is left out."""
STRAYED = 5.0
"""Sigmas of `TRUST` beyond which a tuned noise is no sensor's: an airframe's vibration reaches 4.4 (a factor of 22)."""
LEVER_ARM, HEADING_RATIO, SETTINGS = np.arange(9, 12), 12, 13
"""Numbers of the lever arm's components, of the factor on the noise of headings, and of all settings."""
TIMES, LENGTHS = np.isin(np.arange(SETTINGS), (LATENCY, VELOCITY_LAG)), np.isin(np.arange(SETTINGS), LEVER_ARM)
"""Settings that are times, searched in tenths of a second, and lengths, m; the others are searched as logarithms."""
SEARCHED = (FIX_LATENCIES[0], 2.0)
"""Bounds between which the latency is searched, s. A larger one can be given; it is rather an offset of the clocks."""
WIDEST_LAG = 1.0
"""Largest difference between the latencies of velocity and position that is searched, s."""
AT_BOUND = 0.01
"""Distance from a bound of the latency, s, below which the latency is at that bound."""
USUAL, COARSE = 1.0, 2.5
"""A usual latency, and the step between those that are tried before the search, tenths of a second."""
LAGS = (-0.8, -0.4, -0.15, 0.15, 0.4, 0.8)
"""Differences between the latencies of velocity and position that are tried, s."""
ERRORS = ((5.0, 1.0), (20.0, 1.0), (20.0, 2.0), (60.0, 2.0), (60.0, 4.0), (200.0, 8.0))
"""Correlation times, s, and sizes, over the noise of positions, of errors of the fixes that are tried."""
LIKELIER = 12.5
"""Gain of log-likelihood from which on such a lag or error is certain: five sigma."""
FACTOR, SIZES, CORRELATION_TIMES = 1e4, (0.05, 100.0), (2.0, 1e5)
"""Bounds of a search: of noise over its start, of the size of an error as above, and of its correlation time, s."""
DIFFERENCES, LONGEST_STEPS = np.where(TIMES | LENGTHS, 0.3, 0.1), np.where(TIMES, 5.0, 2.0)
"""Steps for derivatives and longest steps of a search, of all settings as they are searched."""
SHORTEST_ARM, SURE_ARM = 0.5, 5.0
"""Difference of a lever arm from the one given, m and in its sigma, that is told."""
LONGEST_ARM = 100.0
"""Bound of each component of a lever arm that is searched, m."""
OTHER_LATENCIES, OTHER_LATENCY = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5), 0.02
"""Latencies that are tried with another forward lever arm, s; difference from the tuned one that is told, s."""
CONVERGED = 0.01
"""A search has converged if the next step would gain less log-likelihood: a seventh of the settings' sigma."""
MOST_DAMPED = 100.0
"""Damping from which on no step gains."""
WORTH = 0.5
"""Gain of log-likelihood that a damped step, or a search in a trust region, has to bring for the search to go on."""
GOOD_REJECTED = 1e-3
"""Share of good fixes that the gate rejects at most."""
REGION, ROUND = (0.7, 0.02), 200
"""Radius of the trust region at begin and end, and the largest number of flights of one search in it."""
VAGUE = 0.01
"""Least second derivative of the negative log-likelihood by a setting, for those that the flight does not show."""
EVALUATIONS = 1000
"""Largest number of flights of a tuning."""


@dataclass(frozen=True)
class Tuning:
    """Settings as of `Recording.tuned`; which of them are tuned, bool; warnings about them."""

    settings: np.ndarray
    tuned: np.ndarray
    findings: tuple[Finding, ...] = ()
    spread: np.ndarray = field(default_factory=lambda: np.full(SETTINGS, np.nan))
    """1 sigma by which the flight shows each setting: of times s, of others of the logarithm; nan where not tuned."""
    correlation: np.ndarray = field(default_factory=lambda: np.eye(SETTINGS))
    """Of the errors of the tuned settings, as they are searched."""
    origin: str = "given"
    """Where the settings are from that are not tuned."""

    @property
    def latency_sigma(self) -> float:
        """1 sigma of the latency, s: 0 of a given one."""
        return float(self.spread[LATENCY]) if self.tuned[LATENCY] else 0.0


def tune(recording: Recording, done: Callable[[int], None] = lambda _: None) -> Tuning:
    """The settings with the free ones most likely. Then a lag of the velocities and a time-correlated error of the
    positions are tried, and tuned with the rest where they are clearly likelier."""
    free, given = recording.free, recording.settings
    tuned = np.isin(np.arange(SETTINGS), free)
    if not free.size:
        return Tuning(given, tuned)
    threshold = recording.moving_speed
    fast = int(np.sum(in_motion(recording.flight(given), threshold)))
    if fast <= FEWEST:
        names = ", ".join(recording.tuned[i].replace("_", " ") for i in free)
        remark = (
            f"nothing is tuned: {fast} fixes are in motion (faster than {digits(threshold, 2)} m/s), needed are more "
            f"than {FEWEST}, and receivers at rest do not show their noise; untuned are {names}: give them in the log"
        )
        return Tuning(given, np.zeros(SETTINGS, bool), (Finding("tuning", remark),))
    search = TuningSearch(recording, done)
    best, now, converged = search.settle(search.begin(free), free)
    # a lag is looked for again after an error of the positions that may have hidden it
    of_lag, of_error = (search.lags, [VELOCITY_LAG]), (search.errors, [ERROR_SIZE, ERROR_TIME])
    for number, (trials, which) in enumerate((of_lag, of_error, of_lag)):
        again = number > 1 and ERROR_SIZE not in free
        tried = [] if again or which[0] in free else trials(best)
        excess = [now.excess(search.evaluate(trial, near=now)) for trial in tried]
        if min(excess, default=0.0) < -LIKELIER:
            more = np.union1d(free, which)
            found = search.settle(tried[int(np.argmin(excess))], more)
            if found[1].surprise < now.surprise - LIKELIER:
                free, (best, now, converged) = more, found
    lasting = search.lasting(best, now)
    if lasting is not None:
        free, best, now, converged = np.union1d(free, lasting[0]), *lasting[1:3], converged and lasting[3]
    tuned = np.isin(np.arange(SETTINGS), free)
    if not recording.has_vertical:
        best[1] = best[0]
        tuned[1] = tuned[0]
    other_arm, spread, correlation = search.shown(best, now, free)
    remarks = [*_remarks(recording, best, free, converged, search.flown), *other_arm]
    told = tuple(Finding("tuning", remark, (CONSISTENT,)) for remark in remarks)
    return Tuning(best, tuned, told, spread, correlation)


@dataclass(frozen=True)
class _Evaluation:
    """A flight with some settings, by the fixes of the recording and measured headings (m,), nan for those that do not
    count."""

    surprise: float
    """Negative log-likelihood of the innovations in motion, rejected ones included, and of the sensors' noise."""
    cost: np.ndarray
    """(m,) negative log-likelihood of each fix."""
    of_class: float
    """That of the sensors' noise, by their class."""
    innovation: np.ndarray
    """(m, 6), and its sigma."""
    sigma: np.ndarray
    rejected: np.ndarray
    """(fixes,) bool."""
    flown: replay.Replayed

    @property
    def robust(self) -> float:
        """Negative log-likelihood of the fixes under a distribution with long tails: wild fixes count little."""
        logs = np.nansum(np.log(self.sigma), axis=1)
        size = np.maximum(np.isfinite(self.sigma).sum(axis=1), 1)
        return float(np.nansum(0.5 * size * np.log1p(2.0 * (self.cost - logs) / size) + logs))

    def excess(self, other: _Evaluation) -> float:
        """Negative log-likelihood of another evaluation minus this one's, of the fixes that count in both."""
        return float(np.nansum(other.cost - self.cost)) + other.of_class - self.of_class

    def information(self, moved: list[_Evaluation], steps: np.ndarray) -> np.ndarray:
        """Expected second derivatives (k, k) of the negative log-likelihood by evaluations (k) a step away [2]."""
        both = np.array([
            np.concatenate([np.sqrt(2.0) * np.log(each.sigma / self.sigma),
                            (each.innovation - self.innovation) / self.sigma]).ravel() / step
            for each, step in zip(moved, steps, strict=True)
        ])  # fmt: skip
        both = both[:, np.isfinite(both).all(axis=0)]
        return np.asarray(both @ both.T)


def _of_headings(flight: RecordedFlight, seen: replay.Replayed, moving: np.ndarray) -> list[np.ndarray]:
    """Rows (k, 13) of `_Evaluation` of the measured headings in motion; moving: (m,) of the fixes."""
    out = []
    for aid, own in zip(flight.aids, seen.aids, strict=True):
        if aid.kind == HEADING:
            rows = np.full((aid.time.size, 13), np.nan)
            counts = (own.status == USED) & moving[np.searchsorted(flight.arrival, aid.time).clip(max=moving.size - 1)]
            sigma = own.innovation_sigma[counts, 0]
            rows[counts, 0] = 0.5 * own.innovation_squared[counts] + np.log(sigma)
            rows[counts, 1], rows[counts, 7] = own.innovation[counts, 0], sigma
            out.append(rows)
    return out


def _searched(values: np.ndarray) -> np.ndarray:
    """All settings as they are searched: times in tenths of a second, others as logarithms."""
    plain = TIMES | LENGTHS
    return np.where(plain, np.where(TIMES, 10.0, 1.0) * values, np.log(np.where(plain | (values <= 0.0), 1.0, values)))


def _settings(x: np.ndarray, start: np.ndarray, free: np.ndarray) -> np.ndarray:
    """All settings, with the free ones of a search; the others as at its start."""
    whole = start.copy()
    plain = (TIMES | LENGTHS)[free]
    whole[free] = np.where(plain, np.where(TIMES[free], 0.1, 1.0) * x, np.exp(np.where(plain, 0.0, x)))
    return whole


class TuningSearch:
    """Search for the likeliest settings of a recording."""

    def __init__(self, recording: Recording, done: Callable[[int], None]) -> None:
        self.recording, self.done = recording, done
        self.flown = 0
        self.kept: _Evaluation | None = None
        """The evaluation whose parts and rejected fixes all others keep, in a search without the gate."""
        self.lasts = False
        """Whether an error is searched that lasts longer than the flight shows."""

    def _expected(self) -> tuple[np.ndarray, np.ndarray]:
        """Settings (k,) that are expected near their start, and 1 sigma (k,) of their logarithms."""
        of_errors = CLAIMS if self.recording.claimed else UNCLAIMED if self.lasts else ()
        pairs = [(GYRO_NOISE, TRUST), (ACCELEROMETER_NOISE, TRUST), *of_errors]
        return np.array([i for i, _ in pairs]), np.array([sigma for _, sigma in pairs])

    def begin(self, free: np.ndarray) -> np.ndarray:
        """Settings at which the search starts."""
        start = self.recording.settings.copy()
        if LATENCY in free:

            def at(latency: float, judged: bool) -> _Evaluation:
                return self.evaluate(np.where(np.arange(SETTINGS) == LATENCY, 0.1 * latency, start), judged)

            first = _first_latency(lambda latency: at(latency, judged=False).robust)
            # after wild fixes a flight without the gate is lost, and its cost means nothing
            if first != USUAL and at(USUAL, judged=True).surprise < at(first, judged=True).surprise:
                first = USUAL
            start[LATENCY] = 0.1 * first
        return start

    def evaluate(self, values: np.ndarray, judged: bool = True, near: _Evaluation | None = None) -> _Evaluation:
        """Fly some settings; near: an evaluation of almost the same ones, whose parts and rejected fixes are kept."""
        recording, near = self.recording, near or self.kept
        self.flown += 1
        self.done(self.flown)
        flight, design = recording.flight(values, coarse=True), recording.design(values, TFG)
        if not judged:
            design = replace(design, gate=gate_limits(0.0))
        fix_sigma, range_sigma = recording.fix_sigma(values), recording.range_sigma(values)
        if near is None:
            seen = replay.fly(flight, design, fix_sigma, np.empty(0), range_sigma=range_sigma, brief=True)
        else:
            withheld = near.rejected[flight.row] & (not recording.tight)
            seen = replay.fly_same_parts(near.flown, flight, design, fix_sigma, withheld, range_sigma)
        moving = in_motion(flight, recording.moving_speed)
        used = moving & (seen.degrees > 0) & (seen.status != REJECTED)
        count = (recording.fixes if recording.ranges is None or not recording.tight else recording.ranges).time.size
        each = np.full((count, 13), np.nan)
        each[flight.row[used]] = np.column_stack(
            [0.5 * seen.innovation_squared + seen.log_sigma, seen.innovation, seen.innovation_sigma]
        )[used]
        each = np.vstack([each, *_of_headings(flight, seen, moving)])
        rejected = np.zeros(count, bool)
        rejected[flight.row] = seen.status == REJECTED
        which, trust = self._expected()
        of_class = 0.5 * float(np.sum((np.log(values[which] / recording.settings[which]) / trust) ** 2))
        total = seen.surprise(moving, recording.of_rejected(recording.settings, flight)) + of_class
        total += float(np.nansum(each[count:, 0]))
        return _Evaluation(total, each[:, 0], of_class, each[:, 1:7], each[:, 7:], rejected, seen)

    def settle(self, start: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, _Evaluation, bool]:
        """The likeliest settings with the free ones changed from `start` on, their evaluation, and whether the search
        converged.

        The method of scoring [2]: Newton steps, damped [3], with the expected second derivatives. These need first
        derivatives of the innovations and their sigmas alone, by differences: forward ones first, then central ones
        of one sigma. The gate makes steps in the likelihood, so derivatives keep the parts of the flight and the
        rejected fixes, and after a step that rejects clearly more fixes another search begins from the start.
        """
        from scipy.optimize import Bounds

        low, high = start / FACTOR, start * FACTOR
        low[LATENCY], high[LATENCY] = SEARCHED
        low[VELOCITY_LAG], high[VELOCITY_LAG] = -WIDEST_LAG, WIDEST_LAG
        low[LEVER_ARM], high[LEVER_ARM] = -LONGEST_ARM, LONGEST_ARM
        low[ERROR_SIZE], high[ERROR_SIZE] = SIZES
        low[ERROR_TIME], high[ERROR_TIME] = CORRELATION_TIMES
        if not self.recording.claimed:
            low[POSITION_RATIO] = self.recording.settings[POSITION_RATIO]
        bounds = _searched(low)[free], _searched(high)[free]
        longest = LONGEST_STEPS[free]
        x, damping = _searched(start)[free], 0.0
        now = first = self.evaluate(start)
        fewest = int(now.rejected.sum())
        gradient, information = np.zeros(free.size), np.eye(free.size)
        fresh = fine = False
        while self.flown + free.size < EVALUATIONS and damping < MOST_DAMPED:
            if not fresh:
                steps = DIFFERENCES[free]
                if fine:
                    steps = np.minimum(steps, np.sqrt(np.diag(np.linalg.inv(information))))
                steps = steps * np.where(x + steps > bounds[1], -1.0, 1.0)
                gradient, information = self._derivatives(x, start, free, now, steps, fine)
                fresh = True
            step, inside = np.zeros(free.size), (x > bounds[0]) | (gradient < 0.0)
            inside &= (x < bounds[1]) | (gradient > 0.0)
            some = information[np.ix_(inside, inside)]
            step[inside] = -np.linalg.solve(some + damping * np.diag(np.diag(some)), gradient[inside])
            due = -0.5 * float(gradient @ step) * (1.0 + damping)
            if due < CONVERGED and fine:
                return _settings(x, start, free), now, True
            if due < CONVERGED:
                fine, fresh = True, False
                continue
            step /= max(1.0, float(np.max(np.abs(step) / longest)))
            trial = np.clip(x + step, *bounds)
            found = self.evaluate(_settings(trial, start, free))
            gain = now.surprise - found.surprise
            if found.rejected.sum() > fewest + GOOD_REJECTED * found.rejected.size:
                return self._search_region(_searched(start)[free], first, start, free, Bounds(*bounds))
            fewest = min(fewest, int(found.rejected.sum()))
            if gain > 0.0:
                x, now, fresh = trial, found, False
            if gain > min(WORTH, 0.25 * due):
                damping = 0.0
            elif fine:
                damping = max(1.0, 5.0 * damping)
            else:
                fine, fresh = True, False
        return self._search_region(x, now, start, free, Bounds(*bounds))

    def lasting(self, best: np.ndarray, now: _Evaluation) -> tuple[np.ndarray, np.ndarray, _Evaluation, bool] | None:
        """Which settings of the noise of positions are tuned, all settings with them, their evaluation, and whether
        the search converged; the settings before have the evaluation `now`.

        Without claimed accuracies only the flight shows a lasting error, by how fast it changes: the square of its
        size over its time. So its time has a prior. The sensors' noise and that of the velocities stay. Receivers
        that smooth their positions show less white noise than the jumps of their positions need, so it is at least
        what it was. None where the error is negligible, or where the gate then rejects more fixes.
        """
        recording = self.recording
        if recording.claimed or recording.tight or recording.scenario.gnss.errors or recording.fixes.has_own_noise:
            return None
        free, start = np.array([ERROR_SIZE, ERROR_TIME]), best.copy()
        start[free] = LASTING_START, LASTING_TIME
        if recording.scenario.gnss.position_sigma_m is None:
            free = np.append(free, POSITION_RATIO)
            start[POSITION_RATIO] *= WHITE_START
        self.kept, self.lasts = now, True
        found, _, converged = self.settle(start, np.sort(free))
        self.kept, self.lasts = None, False
        if found[ERROR_SIZE] < NEGLIGIBLE:
            return None
        again = self.evaluate(found)
        if again.rejected.sum() > now.rejected.sum() + GOOD_REJECTED * now.rejected.size:
            return None
        if np.isclose(found[POSITION_RATIO], recording.settings[POSITION_RATIO]):
            free = free[:2]
        return free, found, again, converged

    def _search_region(
        self, x: np.ndarray, now: _Evaluation, start: np.ndarray, free: np.ndarray, bounds: Bounds
    ) -> tuple[np.ndarray, _Evaluation, bool]:
        """The result of `settle` from x on where the gate makes steps in the likelihood: a trust region with quadratic
        models [4], begun again where it has ended until that gains nothing."""
        from scipy.optimize import minimize

        converged, worst = False, now.surprise

        def cost(trial: np.ndarray) -> float:
            nonlocal x, now, worst
            found = self.evaluate(_settings(trial, start, free))
            worst = max(worst, found.surprise) if np.isfinite(found.surprise) else worst + 100.0
            if found.surprise < now.surprise:
                x, now = trial.copy(), found
            return found.surprise if np.isfinite(found.surprise) else worst

        while not converged and self.flown < EVALUATIONS:
            options = {"maxfev": max(min(ROUND, EVALUATIONS - self.flown), 2 * free.size + 2), "scale": False,
                       "initial_tr_radius": REGION[0], "final_tr_radius": REGION[1]}  # fmt: skip
            before = now.surprise
            found = minimize(cost, x, method="COBYQA", bounds=bounds, options=options)  # type: ignore[call-overload]  # stubs lack it
            converged = bool(found.success) and before - now.surprise < WORTH
        return _settings(x, start, free), now, converged

    def _derivatives(
        self, x: np.ndarray, start: np.ndarray, free: np.ndarray, now: _Evaluation, steps: np.ndarray,
        central: bool = False,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """First and expected second derivatives (k,), (k, k) of the negative log-likelihood by the free settings, by
        forward or by central differences."""
        moved = [self.evaluate(_settings(x + each, start, free), near=now) for each in np.diag(steps)]
        which, trust = self._expected()
        expected = np.zeros(SETTINGS)
        expected[which] = trust**-2
        information = now.information(moved, steps) + np.diag(VAGUE + expected[free])
        slopes = np.array([now.excess(each) for each in moved]) / steps
        if central:
            back = [self.evaluate(_settings(x - each, start, free), near=now) for each in np.diag(steps)]
            return 0.5 * (slopes - np.array([now.excess(each) for each in back]) / steps), information
        return slopes - 0.5 * steps * np.diag(information), information

    def shown(self, best: np.ndarray, now: _Evaluation, free: np.ndarray) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Remark on a lever arm that is clearly likelier than the one given, with the free settings tuned to it; and
        spread and correlation of the free settings, see `Tuning`. After one step towards the likeliest arm only a
        search with all settings free makes the arm likeliest, and its sigma that of the noise with it.

        Innovations that are correlated with those before tell as much as fewer white ones.
        """
        which = np.concatenate([free, LEVER_ARM])
        gradient, information = self._derivatives(_searched(best)[which], best, which, now, DIFFERENCES[which])
        fewer = self._fewer(now)
        spread = np.full(SETTINGS, np.nan)
        of_free = np.linalg.inv(information[: free.size, : free.size])  # the lever arm is known
        spread[free] = np.where(TIMES[free], 0.1, 1.0) * np.sqrt(fewer * np.diag(of_free))
        correlation, sigma = np.eye(SETTINGS), np.sqrt(np.diag(of_free))
        correlation[np.ix_(free, free)] = of_free / np.outer(sigma, sigma)
        other, likelier = self._traded(best, now, free)
        if other is not best:
            gradient, information = self._derivatives(
                _searched(other)[which], other, which, likelier, DIFFERENCES[which]
            )
        longest = np.where(LENGTHS, np.inf, LONGEST_STEPS)[which]
        step = np.clip(-np.linalg.solve(information, gradient), -longest, longest)
        trial = _settings(_searched(other)[which] + step, other, which)
        for setting, bounds in ((LATENCY, SEARCHED), (ERROR_SIZE, SIZES), (ERROR_TIME, CORRELATION_TIMES)):
            if setting in which:
                trial[setting] = np.clip(trial[setting], *bounds)
        found = self.evaluate(trial, near=likelier)
        if likelier.excess(found) < 0.0:
            other, likelier = trial, found
        of_arm = np.sqrt(fewer * np.diag(np.linalg.inv(information))[-3:])
        if not self._is_clearly_likelier(best, now, other, likelier, of_arm, fewer):
            return [], spread, correlation
        self.kept = likelier
        other, likelier, _ = self.settle(other, which)
        information = self._derivatives(_searched(other)[which], other, which, likelier, DIFFERENCES[which])[1]
        self.kept = None
        of_arm = np.sqrt(fewer * np.diag(np.linalg.inv(information))[-3:])
        if not self._is_clearly_likelier(best, now, other, likelier, of_arm, fewer):
            return [], spread, correlation
        late = abs(other[LATENCY] - best[LATENCY]) > OTHER_LATENCY
        speed = self._mean_speed(other) if LATENCY in which else None
        change = (other - best)[LEVER_ARM]
        text = _of_lever_arm(best[LEVER_ARM], change, of_arm, float(other[LATENCY]) if late or speed else None, speed)
        return [text], spread, correlation

    def _mean_speed(self, values: np.ndarray) -> float:
        """Mean speed of the fixes in motion, m/s."""
        flight = self.recording.flight(values, coarse=True)
        return float(np.mean(flight.speed[in_motion(flight, self.recording.moving_speed)]))

    @staticmethod
    def _is_clearly_likelier(
        best: np.ndarray, now: _Evaluation, other: np.ndarray, likelier: _Evaluation, sigma: np.ndarray, fewer: float
    ) -> bool:
        """Whether a user is told of other settings, because their lever arm is another one, and clearly likelier.

        sigma: of the arm (3,), m; fewer: as of `_fewer`.
        """
        change = (other - best)[LEVER_ARM]
        if np.linalg.norm(change) < SHORTEST_ARM or np.all(np.abs(change) < SURE_ARM * sigma):
            return False
        return now.excess(likelier) <= -LIKELIER * fewer

    @staticmethod
    def _fewer(now: _Evaluation) -> float:
        """Number of correlated innovations that tell as much as one white one."""
        of_fixes = slice(now.rejected.size)
        lag1 = max(0.0, lag1_correlation(now.innovation[of_fixes] / now.sigma[of_fixes]))
        return float((1.0 + lag1) / (1.0 - lag1))

    def _traded(self, best: np.ndarray, now: _Evaluation, free: np.ndarray) -> tuple[np.ndarray, _Evaluation]:
        """The likeliest settings with another latency, and their evaluation.

        The forward lever arm is 0, or that which puts fixes at the mean speed in the same positions. Such a latency
        hides a wrong arm.
        """
        found = best, now
        if LATENCY not in free:
            return found
        speed = self._mean_speed(best)
        trials = []
        for latency in OTHER_LATENCIES:
            if speed * abs(latency - best[LATENCY]) >= SHORTEST_ARM:
                trials.append(best.copy())
                trials[-1][LATENCY] = latency
                trials[-1][LEVER_ARM[0]] += speed * (latency - best[LATENCY])
        trials.append(best.copy())
        trials[-1][LATENCY], trials[-1][LEVER_ARM] = 0.1 * USUAL, 0.0
        for trial in trials:
            other = self.evaluate(trial)
            if now.excess(other) < now.excess(found[1]):
                found = trial, other
        return found

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
    lowest, highest = (10.0 * bound for bound in SEARCHED)
    coarse = np.arange(np.ceil((lowest - USUAL) / COARSE), np.floor((highest - USUAL) / COARSE) + 1.0) * COARSE + USUAL
    coarse = np.unique([lowest, *coarse, highest])
    best = float(min(coarse, key=cost))
    if best == USUAL:
        return USUAL
    fine = best + COARSE * np.array([-0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8])
    return float(min(fine[(fine >= lowest) & (fine <= highest)], key=cost))


def _of_lever_arm(
    given: np.ndarray, change: np.ndarray, sigma: np.ndarray, latency: float | None = None, speed: float | None = None
) -> str:
    """Remark on another lever arm (3,), m, by the axes that the motion shows.

    These are axes where `SHORTEST_ARM` or the change exceeds `SURE_ARM` sigmas. latency: that with this arm, s, if it
    differs from the tuned one. speed: mean speed, m/s, where a tuned latency hides a forward arm, which then has no
    sigma; else None.
    """
    is_shown = (SURE_ARM * sigma <= SHORTEST_ARM) | (np.abs(change) >= SURE_ARM * sigma)
    axes = list(zip(("forward", "right", "down"), given + change, sigma, is_shown, strict=True))[speed is not None :]
    parts = [f"{name} {value_text(x, s)} ± {digits(s, 1)}" for name, x, s, known in axes if known]
    late = "" if latency is None else f" with a latency of {latency:.2f} s"
    if speed is not None:
        parts.insert(0, f"forward about {given[0] + change[0]:.1f}")
    unknown = [name for name, *_, known in axes if not known]
    hidden = f"; the motion does not show {' and '.join(unknown)}" if unknown else ""
    if speed is not None:
        hidden += f"; at the mean speed {0.1 * speed:.1f} m more forward look almost like 0.1 s more latency"
    return (
        f"a lever arm of {', '.join(parts)} m (1 sigma) from the IMU to the antenna{late} explains the fixes clearly "
        f"better than [{', '.join(map(digits, given))}] m{hidden}. Measure it, and write gnss.lever_arm_m: [forward, "
        "right, down]"
    )


def _remarks(recording: Recording, best: np.ndarray, free: np.ndarray, converged: bool, flown: int) -> list[str]:
    """Warnings about a tuning."""
    out = []
    if not converged:
        names = ", ".join(recording.tuned[i].replace("_", " ") for i in free)
        out.append(
            f"the tuning had not converged after {flown} passes of the filter: its numbers ({names}) may be far from "
            "the most likely ones; give some of them in the log, or replay a longer part"
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
