"""Sources of error that are correlated in time, in a covariance analysis: their effect from epoch to epoch."""

from __future__ import annotations

import copy as copying
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Self

import numpy as np

from navsim.gnss.correlated_errors import CorrelatedErrors
from navsim.gnss.pseudolite_clock import WanderingClocks
from navsim.simulation.measurements import CARRIER_SIGMA


class SourceErrors(ABC):
    """Time-correlated ranging errors together with their effect on the state: covariance (S + s)^2 for each of k kinds.

    Each source has one or more states after the S propagated ones. epoch: of the present errors, -1 before the first.
    """

    def __init__(self, kinds: int, size: int, sources: int):
        """size: number S of propagated states."""
        self.size, self.epoch = size, -1
        self.cov = np.zeros((kinds, size + sources, size + sources))

    def copied(self) -> Self:
        """Independent copy."""
        out = copying.copy(self)
        out.cov = self.cov.copy()
        return out

    def propagate(self, phi: np.ndarray) -> None:
        """Propagate by a change of the state `phi` (S, S): an interval, or the update with another sensor."""
        self.cov[:, : self.size] = phi @ self.cov[:, : self.size]
        self.cov[:, :, : self.size] = self.cov[:, :, : self.size] @ phi.T

    def states(self) -> np.ndarray:
        """Covariances of the state by each kind (k, S, S)."""
        return self.cov[:, : self.size, : self.size]

    def errors(self, when: float) -> np.ndarray:
        """Covariances of the errors of the filter's states by each kind (k, S, S) at a time, s."""
        return self.states()

    @abstractmethod
    def measure(self, i: int) -> None:
        """The errors become those of epoch i, if they are not yet."""

    @abstractmethod
    def fixed(self, i: int, here: np.ndarray, gain: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Propagate through the update of a fix, or a range, of epoch i; returns the addition to E[z z'] (m, m).

        gain (S, m); here (m, S): measurement matrix; slope (m, s): derivative by the errors.
        """


class CorrelatedSources(SourceErrors):
    """Time-correlated measurement errors, of each kind those of sources of variance one.

    shown: returns their effect on the filter's states for such errors at an epoch (n, k, s). moving: whether they
    change between epochs, or keep the last value.
    """

    def __init__(
        self, size: int, errors: CorrelatedErrors, used: np.ndarray, time: np.ndarray,
        shown: Callable[[int], np.ndarray], moving: bool = False,
    ):  # fmt: skip
        """size: number S of propagated states; errors, used (e, s), time (e,) of `Signals`."""
        super().__init__(len(errors.names), size, used.shape[1])
        self.shown, self.time, self.decay, self.moving = shown, time, 1.0 / errors.time, moving
        self.sigma = np.where(used, errors.sigma, 0.0)
        self.kept, self.new = errors.steps(time)

    def measure(self, i: int) -> None:
        """The errors become those of epoch i, if they are not yet."""
        at = self.size + np.arange(self.cov.shape[1] - self.size)
        while self.epoch < i:
            self.epoch += 1
            kept = self.kept[self.epoch][:, None, None]
            self.cov[:, self.size :] *= kept
            self.cov[:, :, self.size :] *= kept
            self.cov[:, at, at] += self.new[self.epoch][:, None] ** 2

    def fixed(self, i: int, here: np.ndarray, gain: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """See `SourceErrors.fixed`; slope (m, s): derivative by the ranges."""
        out = np.zeros((slope.shape[0],) * 2)
        for k, (cov, sigma) in enumerate(zip(self.cov, self.sigma[:, i], strict=True)):
            seen = np.hstack([here, self.slope_of(slope, k) * sigma])
            by = seen @ cov
            out += by @ seen.T
            cov[: self.size] -= gain @ by
            cov[:, : self.size] -= (cov @ seen.T) @ gain.T
        return out

    def slope_of(self, slope: np.ndarray, kind: int) -> np.ndarray:
        """Derivatives (m, s) of the numbers by the errors of a kind: those of ranges have one slope."""
        return slope

    def errors(self, when: float) -> np.ndarray:
        """Covariances of the errors of the filter's states by each kind (k, S, S) at a time, s."""
        turn = np.eye(self.size, self.cov.shape[1])
        out = np.empty((self.cov.shape[0], self.size, self.size))
        at = max(self.epoch, 0)
        age, of_kinds = abs(when - self.time[at]) if self.moving else 0.0, self.shown(at)
        for k, cov in enumerate(self.cov):
            shown, kept = of_kinds[:, k], math.exp(-age * self.decay[k])
            turn[:, self.size :] = kept * shown
            out[k] = turn @ cov @ turn.T
            if kept < 1.0:
                out[k] += (1.0 - kept**2) * shown @ shown.T
        return out


class SensorErrorSources(CorrelatedSources):
    """Time-correlated errors of a sensor that aids the filter. slope (m, k, s): of each kind its own."""

    def slope_of(self, slope: np.ndarray, kind: int) -> np.ndarray:
        """Derivatives (m, s) of the numbers by the errors of a kind."""
        return slope[:, kind]


def white_noise(
    slope: np.ndarray, sigma: np.ndarray, used: np.ndarray, chosen: np.ndarray, epoch: np.ndarray
) -> np.ndarray:
    """Covariance of measurements (m, MOST, MOST) by independent errors of chosen (s,) sources; slope: (m, MOST, s) in
    the epochs (m,), others: (e, s)."""
    spread = slope * np.where(used & chosen, sigma, 0.0)[epoch, None, :]
    return spread @ np.swapaxes(spread, 1, 2)


class SmoothedRanges(SourceErrors):
    """Range noise after Hatch's filter, of satellites and of pseudolites.

    The smoothed noise is x + w, with the carrier noise w. With the code noise v, x = (1 - 1/n) x before + (v - w) / n:
    a first-order process driven by white noise, one state more for each source.
    """

    def __init__(
        self,
        size: int,
        counts: np.ndarray,
        sigma: np.ndarray,
        used: np.ndarray,
        of_pseudolites: np.ndarray,
    ):
        """size: number S of propagated states; counts, sigma, used: (e, s) of `Signals`; of_pseudolites: (s,) bool."""
        super().__init__(2, size, of_pseudolites.size)
        self.n = np.maximum(counts, 1)
        self.decay = np.where(counts > 1, 1.0 - 1.0 / self.n, 0.0)
        self.sigma, self.used = sigma, used
        self.chosen = (~of_pseudolites, of_pseudolites)

    def measure(self, i: int) -> None:
        """The smoothed noises become those of epoch i, if they are not yet."""
        if self.epoch == i:
            return
        self.epoch, decay = i, self.decay[i]
        self.cov[:, self.size :] *= decay[:, None]
        self.cov[:, :, self.size :] *= decay
        at = self.size + np.arange(decay.size)
        for cov, chosen in zip(self.cov, self.chosen, strict=True):
            code = np.where(chosen & self.used[i], self.sigma[i], 0.0)
            phase = np.where(chosen & self.used[i], CARRIER_SIGMA, 0.0)
            cov[at, at] += (code**2 + phase**2) / self.n[i] ** 2

    def fixed(self, i: int, here: np.ndarray, gain: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """See `SourceErrors.fixed`; slope (m, s): derivative by the ranges."""
        m = slope.shape[0]
        turn = np.eye(self.cov.shape[1])
        turn[: self.size, : self.size] -= gain @ here
        turn[: self.size, self.size :] = -gain @ slope
        seen = np.hstack([here, slope])
        out = np.zeros((m, m))
        for k, chosen in enumerate(self.chosen):
            phase = np.where(chosen & self.used[i], CARRIER_SIGMA**2, 0.0)
            # the carrier's noise is in the fix and, with the other sign, in the smoothed state
            with_phase = np.zeros((self.cov.shape[1], phase.size))
            with_phase[self.size :] = np.diag(-phase / self.n[i])
            cross = seen @ with_phase @ slope.T
            out += seen @ self.cov[k] @ seen.T + cross + cross.T + (slope * phase) @ slope.T
            direct = np.zeros_like(with_phase)
            direct[: self.size] = -gain @ slope
            cross = turn @ with_phase @ direct.T
            self.cov[k] = turn @ self.cov[k] @ turn.T + cross + cross.T + (direct * phase) @ direct.T
        return out


class WanderingClockErrors(SourceErrors):
    """Clock noise of pseudolites, of one kind: the offsets of all, then their rates."""

    def __init__(
        self, size: int, clocks: WanderingClocks, used: np.ndarray, time: np.ndarray,
        shown: Callable[[float], np.ndarray],
    ):  # fmt: skip
        """size: number S of propagated states; used (e, s), time (e,) of `Signals`; shown: effect (S, 2 p) of offsets
        and rates at a time, s, on the filter's states."""
        super().__init__(1, size, 2 * int(clocks.which.sum()))
        self.used = np.tile(used[:, clocks.which], 2)
        self.transition, self.new = clocks.steps(time)
        self.clocks, self.time, self.shown = clocks, time, shown

    def measure(self, i: int) -> None:
        """The errors become those of epoch i, if they are not yet."""
        own, one = slice(self.size, None), np.eye(self.used.shape[1] // 2)
        while self.epoch < i:
            self.epoch += 1
            on = np.kron(self.transition[self.epoch], one)
            self.cov[:, own] = on @ self.cov[:, own]
            self.cov[:, :, own] = self.cov[:, :, own] @ on.T
            self.cov[:, own, own] += np.kron(self.new[self.epoch], one)

    def errors(self, when: float) -> np.ndarray:
        """Covariance of the errors of the filter's states (1, S, S) at a time, s."""
        shown, one = self.shown(when), np.eye(int(self.clocks.which.sum()))
        if self.epoch < 0:  # the clocks have not been seen
            start = np.kron(self.clocks.errors.clock_covariance(when), one)
            return np.asarray(self.cov[:, : self.size, : self.size] + shown @ start @ shown.T)
        on, new = (np.kron(m[0], one) for m in self.clocks.between(np.array([when - self.time[self.epoch]])))
        turn = np.hstack([np.eye(self.size), shown @ on])
        return turn @ self.cov @ turn.T + shown @ new @ shown.T

    def fixed(self, i: int, here: np.ndarray, gain: np.ndarray, slope: np.ndarray) -> np.ndarray:
        """Propagate through the update of a fix, or a range, of epoch i; returns the addition to E[z z'] (m, m).

        gain (S, m); here (m, S): measurement matrix; slope (m, 2 p): derivatives by offsets and rates.
        """
        seen = np.hstack([here, np.where(self.used[i], slope, 0.0)])
        (cov,) = self.cov
        by = seen @ cov
        out = by @ seen.T
        cov[: self.size] -= gain @ by
        cov[:, : self.size] -= (cov @ seen.T) @ gain.T
        return np.asarray(out)
