"""A receiver whose fixes have a state: fixed, float, differential, single, wrong.

The state is a continuous-time Markov chain. Each state has white noise and an error that is drawn when it begins and
lasts until it ends, so that position and height jump at a change. A wrong fix is flagged as fixed. Equations:
`docs/theory/signals.md`, section 8.
"""

from __future__ import annotations

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


class StatedFixes(NamedTuple):
    """States of the fixes of runs."""

    state: np.ndarray
    """(e, W) true state."""
    flag: np.ndarray
    """(e, W) state that the receiver reports."""
    error: np.ndarray
    """(e, 6, W) error of position, m, and velocity, m/s, NED."""

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

    def path(self, rng: np.random.Generator, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Times (k,) when states begin, the first at 0 s, up to an end, s; and the states (k,)."""
        state, now = int(rng.choice(len(STATES), p=self.shares)), 0.0
        times, states = [now], [state]
        while (now := now + float(rng.exponential(self.mean_time[state]))) < end:
            state = int(rng.choice(len(STATES), p=self.following[state]))
            times.append(now)
            states.append(state)
        return self._with_forced(np.array(times), np.array(states))

    def _with_forced(self, times: np.ndarray, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same with forced states instead of those that they cover."""
        for one in self.forced:
            after = states[np.searchsorted(times, one.end, side="right") - 1]
            kept = (times < one.begin) | (times > one.end)
            times, states = times[kept], states[kept]
            at = int(np.searchsorted(times, one.begin))
            times, states = np.insert(times, at, [one.begin, one.end]), np.insert(states, at, [one.state, after])
        return times, states

    def drawn(self, rngs: tuple[np.random.Generator, ...], noise: tuple[np.random.Generator, ...], time: np.ndarray,
              lanes: int) -> StatedFixes:  # fmt: skip
        """States of fixes at times (e,), s, of runs in the first of so many lanes; further lanes repeat the last run.

        rngs: generators of states and lasting errors; noise: of white noise.
        """
        out = StatedFixes(
            np.empty((time.size, lanes), int), np.empty((time.size, lanes), int), np.empty((time.size, 6, lanes))
        )
        for lane, (rng, white) in enumerate(zip(rngs, noise, strict=True)):
            begins, states = self.path(rng, float(time[-1]) if time.size else 0.0)
            lasting = rng.standard_normal((begins.size, 3)) * self.lasting[states][:, [0, 0, 1]]
            for one in self.forced:
                if one.lasting is not None:
                    lasting[np.searchsorted(begins, one.begin)] = one.lasting
            now = np.searchsorted(begins, time + 1e-9, side="right") - 1
            seen = np.maximum(np.searchsorted(begins, time - self.flag_delay + 1e-9, side="right") - 1, 0)
            out.state[:, lane] = states[now]
            out.flag[:, lane] = np.where(states[seen] == WRONG, FIXED, states[seen])
            out.error[:, :, lane] = (
                white.standard_normal((time.size, 6)) * self.noise[states[now]][:, [0, 0, 1, 2, 2, 2]]
            )
            out.error[:, :3, lane] += lasting[now]
        for each in out:
            each[..., len(rngs) :] = each[..., len(rngs) - 1 : len(rngs)]
        return out
