"""Guidance by the estimate: effect of navigation errors on the trajectory.

Guidance corrects the estimated deviation from the route, not the true one. The aircraft therefore follows the error of
the estimate, with the lag of the guidance loop. Equations: `docs/theory/air.md`, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.statistics.linear_processes import exponential
from navsim.trajectory.air import Process, through, two_lags


def steered(loop: float, lag: float, bank_lag: float | None) -> Process:
    """Linear model of an aircraft whose guidance follows a wrong estimate; the estimate's error, m, drives it.

    - The command of the guidance, with the lag of its `loop`, s.
    - Position, m, and velocity, m/s, behind two lags of `lag` s.
    - With bank_lag, the bank for the lateral acceleration, as m/s2, behind two lags of its own, and its rate.
    """
    own = through(Process(np.array([[-1.0 / loop]]), np.array([1.0 / loop])), np.ones(1), two_lags(lag))
    return own if bank_lag is None else through(own, acceleration(lag), two_lags(bank_lag))


def acceleration(lag: float) -> np.ndarray:
    """The row (3,) that makes an acceleration, m/s2, of the first states of `steered`."""
    return np.array([1.0, -1.0, -2.0 * lag]) / lag**2


@dataclass(frozen=True)
class GuidanceErrors:
    """Errors of estimates as guidance knows them, truth - estimate: values (m, 3, W), m, along path axes, each from one
    of the samples `first` (m,), increasing from 0 on, until the next."""

    first: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, first: np.ndarray, values: np.ndarray) -> GuidanceErrors:
        """Hold outputs at samples (m,), which may repeat: the last one counts.

        An estimate that is nan holds the last valid one. Before the first valid one the estimate is unknown.
        """
        known = np.where(np.isfinite(values).all(axis=1), np.arange(first.size)[:, None], -1)
        last = np.maximum.accumulate(known, axis=0)
        kept = np.take_along_axis(values, np.maximum(last, 0)[:, None], axis=0)
        of_samples = np.append(first[1:] != first[:-1], True)
        return cls(first[of_samples], np.where(last[:, None] >= 0, kept, 0.0)[of_samples])

    def drives(self, process: Process, amount: np.ndarray, samples: int, step: float) -> np.ndarray:
        """States (samples, n, W) of a process from rest, driven by amounts (m, W) of these errors, at samples so many s
        apart.

        Exact.
        """
        n, lengths = process.a.shape[0], np.diff(np.append(self.first, samples - 1))
        # powers of the transition and the additions of a held error, as one matrix
        both = np.zeros((n + 1, n + 1))
        both[:n, :n], both[:n, n] = process.a, process.b
        powers = exponential(both * (step * np.arange(1, int(lengths.max(initial=1)) + 1)[:, None, None]))
        out = np.zeros((samples, n, amount.shape[1]))
        for first, length, held in zip(self.first, lengths, amount, strict=True):
            since = powers[:length, :n]
            out[first + 1 : first + 1 + length] = since[..., :n] @ out[first] + since[..., n:] * held
        return out
