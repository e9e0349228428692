"""A receiver whose fixes have a state: fixed, float, differential, single, wrong.

The state is a continuous-time Markov chain. Each state has white noise and an error that is drawn when it begins and
lasts until it ends, so that position and height jump at a change. A wrong fix is flagged as fixed. Equations:
`docs/theory/signals.md`, section 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

STATES = ("fixed", "float", "differential", "single", "wrong")
"""States of a fix, by number. Flags are the same without the last."""
FIXED, FLOAT, DIFFERENTIAL, SINGLE, WRONG = range(5)


@dataclass(frozen=True)
class ForcedState:
    """A state from a time up to another, s, in all runs. lasting: (3,) its error, NED, m; None: it is drawn."""

    state: int
    begin: float
    end: float
    lasting: np.ndarray | None = None


class StateHistory(NamedTuple):
    """States of the fixes of a run, one after another."""

    begin: np.ndarray
    """(k,) when each begins, s, the first at 0."""
    state: np.ndarray
    """(k,)."""

    def at(self, time: np.ndarray) -> np.ndarray:
        """Place (e,) in the history at times (e,), s."""
        return np.maximum(np.searchsorted(self.begin, time + 1e-9, side="right") - 1, 0)


class StatedFixes(NamedTuple):
    """States of the fixes of runs."""

    state: np.ndarray
    """(e, W) true state."""
    flag: np.ndarray
    """(e, W) state that the receiver reports."""
    error: np.ndarray
    """(e, 6, W) error of position, m, and velocity, m/s, NED."""
    known: np.ndarray
    """(e, 6, W) the part of it that the scenario gives."""

    def unused(self, flag_sigma: np.ndarray | None) -> np.ndarray:
        """Which fixes (e, W) a filter with these sigmas (5, 3) by flag does without."""
        assert flag_sigma is not None
        return np.asarray(np.isnan(flag_sigma[self.flag, 0]))


@dataclass(frozen=True)
class FixStates:
    """Model of the states of a receiver's fixes."""

    mean_time: np.ndarray
    """(5,) mean time in each state, s."""
    following: np.ndarray
    """(5, 5) probability of the state after each state; 0 on the diagonal."""
    noise: np.ndarray
    """(5, 3) 1 sigma of the white noise: horizontal axes and height, m, velocity, m/s."""
    lasting: np.ndarray
    """(5, 2) 1 sigma of the lasting error: horizontal axes and height, m."""
    flag_delay: float
    """From a change of state to the change of the flag, s."""
    forced: tuple[ForcedState, ...] = ()

    @cached_property
    def shares(self) -> np.ndarray:
        """(5,) stationary fractions of time in each state, without forced states.

        The embedded chain of changes has the stationary distribution v = v P; the shares are v m / (v m), with the mean
        times m.
        """
        count = len(STATES)
        equations = np.concatenate([(self.following - np.eye(count)).T, np.ones((1, count))])
        visits = np.linalg.lstsq(equations, np.append(np.zeros(count), 1.0), rcond=None)[0]
        share = np.clip(visits, 0.0, None) * self.mean_time
        return np.asarray(share / share.sum())

    @property
    def sigma(self) -> np.ndarray:
        """(5, 3) root mean square of the whole error of each state, as `noise`."""
        out = self.noise.copy()
        out[:, :2] = np.hypot(out[:, :2], self.lasting)
        return out

    @cached_property
    def before(self) -> np.ndarray:
        """(5, 5) probability of the state before each state: the stationary chain backward in time."""
        flow = (self.shares / self.mean_time)[:, None] * self.following
        total = flow.sum(axis=0)
        return np.where(total > 0.0, flow / np.where(total > 0.0, total, 1.0), 0.0).T

    def path(self, rng: np.random.Generator, end: float) -> StateHistory:
        """History up to an end, s, with the forced states."""
        return self.with_forced(self.unforced(rng, end))

    def unforced(
        self, rng: np.random.Generator, end: float, state: int | None = None, since: float = 0.0, until: float = 0.0
    ) -> StateHistory:
        """History up to an end, s, without forced states; given that it has a state from one time to another, s.

        Times that remain in that state, and that it has lasted, are exponential both.
        """
        if state is None:
            state = int(rng.choice(len(STATES), p=self.shares))
        past, earlier = self._walk(rng, state, since, self.before) if since > 0.0 else ([0.0], [state])
        ahead, later = self._walk(rng, state, end - until, self.following)
        begin = [0.0, *(since - t for t in past[:0:-1]), *(until + t for t in ahead[1:])]
        return StateHistory(np.array(begin), np.array([*earlier[::-1], *later[1:]]))

    def _walk(
        self, rng: np.random.Generator, state: int, length: float, following: np.ndarray
    ) -> tuple[list[float], list[int]]:
        """Times when states begin, from 0 s up to a length, s, and the states."""
        now = 0.0
        times, states = [now], [state]
        while (now := now + float(rng.exponential(self.mean_time[state]))) < length:
            state = int(rng.choice(len(STATES), p=following[state]))
            times.append(now)
            states.append(state)
        return times, states

    def with_forced(self, history: StateHistory) -> StateHistory:
        """The same with forced states instead of those that they cover."""
        times, states = history
        for one in self.forced:
            after = states[np.searchsorted(times, one.end, side="right") - 1]
            kept = (times < one.begin) | (times > one.end)
            times, states = times[kept], states[kept]
            at = int(np.searchsorted(times, one.begin))
            times, states = np.insert(times, at, [one.begin, one.end]), np.insert(states, at, [one.state, after])
        return StateHistory(times, states)

    def flags(self, history: StateHistory, time: np.ndarray) -> np.ndarray:
        """Reported states (e,) at times (e,), s."""
        seen = history.state[history.at(time - self.flag_delay)]
        return np.where(seen == WRONG, FIXED, seen)

    def rejected(self, history: StateHistory, time: np.ndarray, most: int) -> np.ndarray:
        """Which fixes (e,) at times (e,), s, a gate rejects if wrong ones are far off; it accepts one after `most`.

        The filter is far off from a change of a wrong state on, until it takes a fix that is fixed or wrong.
        """
        place, out = history.at(time), np.zeros(time.size, bool)
        wrong, taken = history.state[place] == WRONG, np.isin(history.state[place], (FIXED, WRONG))
        away, row = False, 0
        for i in range(1, time.size):
            if wrong[i] != wrong[i - 1]:
                away, row = True, 0
            if not away:
                continue
            out[i] = row < most
            away = bool(out[i]) or not taken[i]
            row = row + 1 if out[i] else 0
        return out

    def white(self, history: StateHistory, time: np.ndarray) -> np.ndarray:
        """(e, 6) 1 sigma of the white noise of position and velocity, NED, at times (e,), s."""
        return np.asarray(self.noise[history.state[history.at(time)]][:, [0, 0, 1, 2, 2, 2]])

    def lasting_errors(self, history: StateHistory) -> tuple[np.ndarray, np.ndarray]:
        """1 sigma (k, 3) of the lasting error of each state of a history, NED, and its mean (k, 3), which forced states
        have."""
        sigma, mean = self.lasting[history.state][:, [0, 0, 1]], np.zeros((history.begin.size, 3))
        for one in self.forced:
            if one.lasting is not None:
                row = np.searchsorted(history.begin, one.begin)
                sigma[row], mean[row] = 0.0, one.lasting
        return sigma, mean

    def carried(self, history: StateHistory, time: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Covariance of the errors (e, 6) of fixes at times (e,), s, times slopes (K, e, 6) by them."""
        out = slopes * self.white(history, time) ** 2
        within = np.eye(history.begin.size)[history.at(time)]
        of_states = self.lasting_errors(history)[0] ** 2 * np.einsum("Kea,ek->Kka", slopes[..., :3], within)
        out[..., :3] += np.einsum("Kka,ek->Kea", of_states, within)
        return np.asarray(out)

    def drawn(self, rngs: tuple[np.random.Generator, ...], noise: tuple[np.random.Generator, ...], time: np.ndarray,
              lanes: int, histories: Sequence[StateHistory] | None = None) -> StatedFixes:  # fmt: skip
        """States of fixes at times (e,), s, of runs in the first of so many lanes; further lanes repeat the last run.

        rngs: generators of states and lasting errors; noise: of white noise. histories: of the runs, drawn if None.
        """
        out = StatedFixes(*(np.empty((time.size, lanes), int) for _ in range(2)),
                          *(np.zeros((time.size, 6, lanes)) for _ in range(2)))  # fmt: skip
        for lane, (rng, white) in enumerate(zip(rngs, noise, strict=True)):
            end = float(time[-1]) if time.size else 0.0
            history = self.path(rng, end) if histories is None else histories[lane]
            sigma, mean = self.lasting_errors(history)
            lasting, now = rng.standard_normal(sigma.shape) * sigma + mean, history.at(time)
            out.state[:, lane], out.flag[:, lane] = history.state[now], self.flags(history, time)
            out.error[:, :, lane] = white.standard_normal((time.size, 6)) * self.white(history, time)
            out.error[:, :3, lane] += lasting[now]
            out.known[:, :3, lane] = mean[now]
        for each in out:
            each[..., len(rngs) :] = each[..., len(rngs) - 1 : len(rngs)]
        return out
