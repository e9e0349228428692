"""Importance sampling of alarms by a monitor of fixes: a run draws its range errors given that one test alarms.

Every test compares the size of some sums of ranging errors with a limit: the residuals of a fix together, or the
difference of two fixes along one axis. These sums are Gaussian. A test that is to alarm draws their direction, and then
their size given that it is beyond the limit. All ranging errors move with them, as they most likely do.

Runs draw the test as well, so that they come from a mixture over all tests. The density of a run follows from all tests
that alarm in it, whatever the filter and the aircraft then do.

Equations: `docs/theory/covariance.md`, section 3.

Sources:

- [1] Owen, Maximov & Chertkov, Importance sampling the union of rare events with an application to power systems
  analysis, Electronic Journal of Statistics 13 (2019).
- [2] Tyler, Statistical analysis for the angular central Gaussian distribution on the sphere, Biometrika 74 (1987).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from navsim.filter.estimate import in_all_lanes
from navsim.gnss import dll
from navsim.gnss.receiver_fixes import range_residuals
from navsim.integrity.araim import SeparationMonitor
from navsim.integrity.residuals import Monitor
from navsim.simulation.flight import Flight
from navsim.simulation.measurements import expected_measurements, receiver_fixes, smoothed, without_noise
from navsim.simulation.run_inputs import Inputs
from navsim.simulation.sensitivity import Slopes, of_ranges, range_covariance
from navsim.statistics.importance_sampling import LEAST
from navsim.statistics.random_streams import generator

SHARE = 0.3
"""Share of the runs in which a test is to alarm."""
_OFTEN = 0.1
"""Sum of the tests' probabilities of an alarm from which on plain runs have enough alarms."""
_EVENLY = 0.1
"""Share of these runs that goes to all tests alike; the rest goes by their probabilities of an alarm."""
_MARGIN = 2e-3
"""Part of the limit by which a test counts as alarming before it does: a run's own trajectory changes its geometry."""
_NO_NOISE = 1e-12
"""Variance of a sum relative to the largest one of its test, below which it does not vary."""
_DIRECTIONS = 64
"""Directions from which the probabilities of the alarms are estimated."""


class AlarmPush(NamedTuple):
    """Shift of the range errors of a run, and its density."""

    shift: tuple[np.ndarray, np.ndarray, np.ndarray | None] | None
    """Of ranges, range rates and carrier phases (e, s), see `Inputs`; None for a run that no test is chosen for."""
    log_ratio: float
    """Logarithm of the density of the run's errors, if a test is to alarm, over that without; -inf if none alarms."""


@dataclass(frozen=True)
class AlarmProposal:
    """Mixture over tests of fixes that break a landing off: errors of ranges given that a test alarms."""

    flight: Flight
    epoch: np.ndarray
    """(n,) of each test."""
    rows: np.ndarray
    """(n, f, s) independent sums of ranging errors, by error, whose squares a test adds up."""
    mean: np.ndarray
    """(n, f) of these sums by systematic errors."""
    sigma: np.ndarray
    """(n, f) of these sums; 0 where a test has fewer of them."""
    limit: np.ndarray
    """(n,) of the root of the sum of squares, above which it alarms."""
    shares: np.ndarray
    """(n,) of the tests."""

    @classmethod
    def of(cls, flight: Flight) -> tuple[AlarmProposal | None, str]:
        """The proposal of a flight; None, and the reason, if no test of fixes breaks its runs off, or if alarms are not
        rare."""
        monitor, ways, signals = flight.snapshot, flight.shared.dispersion, flight.shared.signals
        if ways is None or not ways.breaks_off:
            return None, "no alarm breaks a landing off"
        if not isinstance(monitor, Monitor | SeparationMonitor):
            return None, "method rare draws alarms of fixes, not those of the filter"
        heeded = np.isfinite(ways.begins(np.eye(signals.time.size, dtype=bool)))
        epoch = np.flatnonzero(heeded & monitor.tested)
        if not epoch.size:
            return None, "no fix that may break a landing off is tested"
        rows, limit = _of_residuals(monitor, epoch) if isinstance(monitor, Monitor) else _of_separations(monitor, epoch)
        times, errors = len(rows) // epoch.size, range_covariance(flight)[epoch]
        covariance = np.concatenate([np.einsum("nfs,nst,ngt->nfg", m, errors, m) for m in np.split(rows, times)])
        epoch = np.tile(epoch, times)
        variance, axes = np.linalg.eigh(covariance)
        rows = axes.swapaxes(1, 2) @ rows
        variance = np.where(variance > _NO_NOISE * variance[:, -1:], variance, 0.0)
        mean = np.einsum("nfs,ns->nf", rows, _without_noise(flight)[epoch])
        size = np.linalg.norm(mean, axis=1)
        if (size >= limit).any():
            return None, "systematic errors alone let a test of fixes alarm, so alarms are not rare"
        some = (variance[:, -1] > 0.0) & (size < limit)
        if not some.any():
            return None, "no test of fixes has random errors"
        even, sigma = np.full(int(some.sum()), 1.0 / some.sum()), np.sqrt(variance[some])
        out = cls(flight, epoch[some], rows[some], mean[some], sigma, limit[some], even)
        chance = out._chances()
        if chance.sum() > _OFTEN:
            text = f"probabilities of alarms of all tests add up to {chance.sum():.2g}"
            return None, f"{text}, and method rare draws alarms up to a sum of {_OFTEN:g}"
        likely = chance / chance.sum()
        return replace(out, shares=_EVENLY * even + (1.0 - _EVENLY) * likely), ""

    def is_chosen(self, seed: int, run: int) -> bool:
        """Whether a test is to alarm in a run."""
        return bool(generator(seed, run, "tilt", 3).random() < SHARE)

    def push(self, seed: int, run: int, inputs: Inputs, lane: int) -> AlarmPush:
        """The push of a run in a lane of inputs along the route."""
        shared, shift = self.flight.shared, None
        ranges, phases = self._expected
        own = inputs.ranges[..., [lane]] - ranges[..., None]
        of_phases = None if phases is None or inputs.phases is None else inputs.phases[..., [lane]] - phases[..., None]
        off = np.where(shared.signals.used, smoothed(shared, own, of_phases)[..., 0], 0.0)
        if self.is_chosen(seed, run):
            shift = self._drawn(generator(seed, run, "tilt", 4), off)
            carrier = None if shift[2] is None else shift[2][..., None]
            off = off + np.where(shared.signals.used, smoothed(shared, shift[0][..., None], carrier)[..., 0], 0.0)
        with np.errstate(divide="ignore"):
            return AlarmPush(shift, float(np.log(self.shares @ self._densities(off))))

    def _drawn(self, rng: np.random.Generator, off: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Shift of ranges, rates and phases (e, s) from errors off (e, s) to such with which a test alarms."""
        from scipy.special import gammainccinv

        test = int(np.searchsorted(np.cumsum(self.shares), rng.random() * self.shares.sum(), side="right"))
        way = self._ways(rng.standard_normal((1, self.sigma.shape[1])), slice(test, test + 1))
        exit_, beyond = self._exits(way, slice(test, test + 1))
        degrees = self._degrees[test]
        size = np.sqrt(2.0 * gammainccinv(0.5 * degrees, beyond[0] * rng.random()))
        size = max(float(size), float(exit_[0]) * (1.0 + 1e-9))  # rounding is no reason for a test to be silent
        sigma, epoch = self.sigma[test], self.epoch[test]
        moved = size * way[0] * sigma - self.rows[test] @ off[epoch]
        by_error = np.divide(moved, sigma**2, out=np.zeros_like(moved), where=sigma > 0.0) @ self.rows[test]
        slopes = np.zeros((1, *off.shape))
        slopes[0, epoch] = by_error
        phases, none = None, np.zeros((1, 0, 3))
        if self.flight.shared.signals.smoothing is not None:
            slopes, phases = dll.smoothing_slopes(slopes, self.flight.shared.signals.smoothing)
        both = Slopes(np.zeros((1, 9)), none, none, slopes, np.zeros_like(slopes), phases, ())
        ranges, rates, carrier = of_ranges(self.flight, both)
        return ranges[0], rates[0], None if carrier is None else carrier[0]

    @cached_property
    def _expected(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Ranges and carrier phases (e, s) along the route without random errors, m."""
        ranges, _, phases = expected_measurements(self.flight.shared)
        return ranges, phases

    @cached_property
    def _degrees(self) -> np.ndarray:
        """(n,) number of sums of each test."""
        return np.asarray((self.sigma > 0.0).sum(axis=1))

    @cached_property
    def _spread(self) -> np.ndarray:
        """(n, f) variances of the Gaussian that directions are drawn from: about that of the sums if they are large
        enough, in their sigmas; 1 in every direction if all sums vary alike."""
        most = self.sigma.max(axis=1, keepdims=True)
        far = (self.limit[:, None] / most) ** 2 / self._degrees[:, None]
        return np.where(self.sigma > 0.0, 1.0 / (1.0 + far * (1.0 - (self.sigma / most) ** 2)), 0.0)

    def _ways(self, drawn: np.ndarray, tests: slice) -> np.ndarray:
        """Directions (n, f) of some tests, of length 1, from standard normal numbers (n, f)."""
        out = np.sqrt(self._spread[tests]) * drawn
        return np.asarray(out / np.linalg.norm(out, axis=1, keepdims=True))

    def _exits(self, way: np.ndarray, tests: slice = slice(None)) -> tuple[np.ndarray, np.ndarray]:
        """Sizes (n,), in sigmas from the mean, from which on sums in these directions (n, f) make tests alarm, and the
        probability (n,) that sums in a given direction are at least as large."""
        from scipy.special import gammaincc

        mean, along = self.mean[tests], self.sigma[tests] * way
        square, both = np.sum(along**2, axis=1), np.sum(along * mean, axis=1)
        left = self.limit[tests] ** 2 - np.sum(mean**2, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            out = (np.sqrt(both**2 + square * left) - both) / square
        out = np.where(square > 0.0, out, np.inf)
        return out, np.maximum(gammaincc(0.5 * self._degrees[tests], 0.5 * out**2), LEAST)

    def _densities(self, off: np.ndarray) -> np.ndarray:
        """(n,) density of ranging errors (e, s), given that a test alarms, over that without."""
        sums = np.einsum("nfs,ns->nf", self.rows, off[self.epoch])
        sums = np.divide(sums, self.sigma, out=np.zeros_like(sums), where=self.sigma > 0.0)
        size = np.linalg.norm(sums, axis=1)
        way = sums / np.where(size > 0.0, size, 1.0)[:, None]
        exit_, beyond = self._exits(way)
        return np.where(size >= exit_, self._of_directions(way) / beyond, 0.0)

    def _of_directions(self, way: np.ndarray) -> np.ndarray:
        """(n,) density of directions (n, f) over that of a Gaussian with equal variances [2]."""
        spread, some = self._spread, self.sigma > 0.0
        stretched = np.sum(np.divide(way**2, spread, out=np.zeros_like(way), where=some), axis=1)
        return np.asarray(np.prod(np.where(some, spread, 1.0), axis=1) ** -0.5 * stretched ** (-0.5 * self._degrees))

    def _chances(self) -> np.ndarray:
        """(n,) probability that a test alarms, estimated."""
        count = _DIRECTIONS if self.sigma.shape[1] > 1 else 1  # along a line there is one, and its opposite
        out = np.zeros(len(self.sigma))
        for drawn in generator(0, 0, "tilt", 5).standard_normal((count, 1, self.sigma.shape[1])):
            for way in (self._ways(drawn, slice(None)), self._ways(-drawn, slice(None))):
                out += self._exits(way)[1] / self._of_directions(way)
        return out / (2 * count)


def _of_residuals(monitor: Monitor, epoch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums (n, f, s) of the residuals' test at epochs (n,), and its limit (n,)."""
    shown, degrees = monitor.solution.shown[epoch], monitor.solution.degrees[epoch]
    left, *_ = np.linalg.svd(shown)
    rows = left.swapaxes(1, 2) @ shown
    rows = np.where((np.arange(rows.shape[1]) < degrees[:, None])[..., None], rows, 0.0)
    return rows[:, : degrees.max()], (1.0 - _MARGIN) * np.sqrt(monitor.threshold[epoch])


def _of_separations(monitor: SeparationMonitor, epoch: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differences (n, 1, s) of fixes by their thresholds, along each axis and without each fault, and their limits
    (n,)."""
    rows = monitor.separator[:, epoch].transpose(0, 2, 1, 3)
    rows = rows.reshape(-1, 1, rows.shape[-1])
    return rows, np.full(len(rows), 1.0 - _MARGIN)


def _without_noise(flight: Flight) -> np.ndarray:
    """Residuals (e, s) of fixes along the route without random errors, m; 0 where there are none."""
    shared = flight.shared
    ranges, rates = (in_all_lanes(m) for m in without_noise(shared))
    fixes = receiver_fixes(shared, ranges, rates)
    antenna = in_all_lanes(shared.signals.antenna)
    left, _ = range_residuals(shared.signals, antenna, shared.antenna_enu, ranges, fixes.llh, fixes.clocks)
    has_fix = np.isfinite(fixes.llh[:, 0, 0])
    return np.where(shared.signals.used & has_fix[:, None], left[..., 0], 0.0)
