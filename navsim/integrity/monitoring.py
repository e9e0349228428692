"""Snapshot monitor along a landing: protection levels from the geometry, alarms from the residuals of fixes.

Source: `docs/theory/integrity.md`, section 7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, cast

import numpy as np

from navsim.gnss.pseudorange import Signals
from navsim.gnss.receiver_fixes import ReceiverFixes
from navsim.integrity import araim
from navsim.integrity.araim import UP, Allocation, SeparationDistances, SeparationMonitor
from navsim.integrity.gbas_station import GbasStation
from navsim.integrity.innovations import InnovationTest
from navsim.integrity.residuals import ChiSquareTest, Monitor
from navsim.integrity.solution import Independent, MonitoredFix, rows_of, solve

NO_FIX, UNTESTED, QUIET, ALARM, EXCLUDED = range(5)
"""Status of an epoch: no fix or no signal; no redundancy; no alarm; alarm; alarm with exclusion."""
DOUBTED = 1.5
"""Factor on 1 sigma of a filter relative to that in its levels, above which an alarm is raised: the gate has rejected
measurements that the levels assume."""
NO_EXCLUSION, RESIDUAL, RMS = "none", "residual", "rms"
"""Rules by which something is excluded after an alarm."""


class LandingMonitor(Protocol):
    """Monitor of a landing, of any type."""

    @property
    def levels(self) -> np.ndarray:
        """Protection levels (e, 2), m, horizontal and vertical; inf or nan without."""

    @property
    def threshold(self) -> np.ndarray:
        """(e,) largest `statistic` without an alarm."""

    @property
    def tested(self) -> np.ndarray:
        """(e,) whether there is a test."""

    @property
    def size(self) -> int:
        """Approximate memory, bytes."""


class Snapshot(LandingMonitor, Protocol):
    """Monitor of fixes, each epoch separately."""

    def statistic(self, residuals: np.ndarray) -> np.ndarray:
        """Test statistic (e, W) from residuals (e, s, W) of fixes, m."""


class SubfilterMonitor(LandingMonitor, Protocol):
    """A monitor of the filter, at its outputs."""

    @property
    def aided(self) -> np.ndarray:
        """(e,) whether the filter has a fix or, tightly coupled, a range."""

    @property
    def sigma(self) -> np.ndarray:
        """(e, 3) 1 sigma of position of the monitored filter, north, east, down, m, for which levels hold."""

    def along(self, bearing: float) -> np.ndarray:
        """Levels (e, 2) across and along a horizontal direction of a bearing, rad, m; nan without."""

    def statistic(
        self, innovation: np.ndarray, fixes: ReceiverFixes, ranges: np.ndarray, rates: np.ndarray
    ) -> np.ndarray:
        """Test statistic (e, W) from used innovations (k, MOST, W), nan for others, and from fixes from measurements
        (e, s, W)."""


@dataclass(frozen=True)
class ExpectedFault:
    """Sources that fail together, by name, with the probability that they have; see `araim.Fault`."""

    name: str
    sources: tuple[str, ...]
    prior: float
    of: tuple[int, ...] = ()
    key: str = ""
    """Key of `integrity` that sets its probability; empty for coincidences."""


@dataclass(frozen=True)
class Monitoring:
    """Configuration of the fix monitor."""

    test: ChiSquareTest | Allocation
    """Residual test, or the allocation of solution separation."""
    faults: tuple[ExpectedFault, ...]
    """Fault list of solution separation."""
    nominal: dict[str, float]
    """Bounds of the sources' biases by name, m."""
    accuracy: float
    """1 sigma of fault-free ranges relative to the receiver's."""
    exclusion: str = NO_EXCLUSION
    """Rule for exclusion after an alarm."""
    drops: bool = False
    """The filter ignores fixes with an alarm."""
    innovations: InnovationTest | None = None
    """Monitor of the filter's innovations, None without."""
    bank: Callable[[Any], SubfilterMonitor] | None = None
    """Creates the filter bank of a flight if it monitors the filter instead of the fixes."""
    ground: tuple[str, ...] = ()
    """Names of the ranging beacons and ground stations that the filter bank watches beside the sources of fixes."""
    station: GbasStation | None = None
    """Ground station whose B values runs draw, None without."""

    def expected(self, signals: Signals, share: float = 1.0) -> tuple[ExpectedFault, ...]:
        """Faults of all used sources and of `ground`, and pairs of them that must be monitored with a share of the
        tolerated probability."""
        if isinstance(self.test, ChiSquareTest):
            return ()
        used = {*np.array(signals.names)[signals.used.any(axis=0)].tolist(), *self.ground}
        alone = [fault for fault in self.faults if used.intersection(fault.sources)]
        pairs = araim.coincidences([fault.prior for fault in alone], share * self.test.p_unmonitored)
        both = [(alone[i], alone[j], (i, j)) for i, j in pairs]
        return (
            *alone,
            *(
                ExpectedFault(f"{a.name} & {b.name}", (*a.sources, *b.sources), a.prior * b.prior, of)
                for a, b, of in both
            ),
        )

    def candidates(self, signals: Signals) -> tuple[ExpectedFault, ...]:
        """Candidates for exclusion: each used source, or each fault of solution separation except coincidences."""
        if self.exclusion == NO_EXCLUSION:
            return ()
        if self.exclusion == RESIDUAL and isinstance(self.test, Allocation):
            single = tuple(fault for fault in self.expected(signals) if not fault.of)
            # the bank's filters can do without the ground's
            return tuple(one for one in single if self.bank is None or set(one.sources) <= set(self.ground))
        heard = np.flatnonzero(signals.used.any(axis=0))
        return tuple(ExpectedFault(signals.names[i], (signals.names[i],), 0.0) for i in heard)

    def without(self, flight: Signals, signals: Signals, candidate: int) -> Snapshot:
        """Monitor of fixes from these signals, of some epochs of a flight, without one of its candidates.

        All candidates and the fix with all sources share the integrity risk.
        """
        out = self.candidates(flight)[candidate].sources
        share, test = self._shared(flight)
        # the fault list does not depend on the epochs
        expected = self.expected(_but(flight, out), share)
        return self._over(_but(signals, out), expected, test)

    def without_ground(self, signals: Signals, names: Sequence[str]) -> tuple[Allocation, tuple[ExpectedFault, ...]]:
        """Allocation and faults of a filter without these of `ground`, which are one of the candidates; risk as of
        `without`."""
        share, test = self._shared(signals)
        assert isinstance(test, Allocation)
        faults = tuple(fault for fault in self.faults if not set(fault.sources) <= set(names))
        less = replace(self, faults=faults, ground=tuple(g for g in self.ground if g not in names))
        return test, less.expected(signals, share)

    def _shared(self, signals: Signals) -> tuple[float, ChiSquareTest | Allocation]:
        """Share of the integrity risk of each candidate and of the solution with all sources, and a test with it."""
        share = 1.0 / (1.0 + len(self.candidates(signals)))
        if isinstance(self.test, ChiSquareTest):
            return share, replace(self.test, p_md=share * self.test.p_md)
        p_hmi_v, p_hmi_h = share * self.test.p_hmi_vertical, share * self.test.p_hmi_horizontal
        return share, replace(self.test, p_hmi_vertical=p_hmi_v, p_hmi_horizontal=p_hmi_h)

    def over(self, signals: Signals) -> Snapshot:
        """The monitor of the fixes from these signals, of all that are used."""
        return self._over(signals, self.expected(signals), self.test)

    def _over(self, signals: Signals, expected: Sequence[ExpectedFault], test: ChiSquareTest | Allocation) -> Snapshot:
        rows, sigma = _geometry(signals)
        noise = Independent(sigma)
        if isinstance(test, ChiSquareTest):
            return Monitor(solve(rows, signals.used, noise), test)
        nominal = np.broadcast_to([self.nominal[name] for name in signals.names], sigma.shape)
        faults = faults_of(signals.names, expected)
        found = araim.levels(rows, signals.used, noise, Independent(self.accuracy * sigma), nominal, faults, test)
        return SeparationMonitor(found)


def runway_levels(watching: Monitoring, monitor: Snapshot, signals: Signals, bearing: float) -> np.ndarray:
    """Levels (e, 2) of the fixes from these signals across the runway and along it, m.

    monitor: of all that is used. bearing: of the runway, rad.
    """
    if isinstance(monitor, Monitor):
        return monitor.along(bearing)
    assert isinstance(monitor, SeparationMonitor)
    assert isinstance(watching.test, Allocation)
    fix = fix_of(signals)
    nominal = np.broadcast_to([watching.nominal[name] for name in signals.names], fix.used.shape)
    priors = np.array([fault.prior for fault in watching.expected(signals)])
    return araim.along(monitor.found, fix, nominal, priors, watching.test, bearing)


def fix_of(signals: Signals) -> MonitoredFix:
    """The fixes from these signals, as their monitors see them."""
    rows, sigma = _geometry(signals)
    return solve(rows, signals.used, Independent(sigma))


def _geometry(signals: Signals) -> tuple[np.ndarray, np.ndarray]:
    """Rows (e, s, u), and 1 sigma of ranges (e, s), m; values of unused sources are arbitrary."""
    los = np.where(signals.used[..., None], signals.los, 0.0)
    return rows_of(los, signals.time_scale), np.where(signals.used, signals.fix_sigma, 1.0)


def _but(signals: Signals, names: Sequence[str]) -> Signals:
    """Signals without some of the sources."""
    return replace(signals, used=signals.used & ~np.isin(signals.names, names))


def faults_of(names: Sequence[str], expected: Sequence[ExpectedFault]) -> list[araim.Fault]:
    """Faults that are expected of sources of these names."""
    return [araim.Fault(_indices(names, fault.sources), fault.prior, fault.of) for fault in expected]


def alerted(status: np.ndarray) -> np.ndarray:
    """Whether the user is alerted: an alarm, no fix, or no signal."""
    return (status == ALARM) | (status == NO_FIX)


def tested_levels(monitor: LandingMonitor) -> np.ndarray:
    """Protection levels (e, 2), m, nan without a test."""
    return np.where(monitor.tested[:, None], monitor.levels, np.nan)


def vertical_sigma(watching: Monitoring, monitor: LandingMonitor) -> np.ndarray:
    """1 sigma (e,), m, of the monitored fault-free vertical error, of fixes or of the filter; nan without."""
    if isinstance(monitor, Monitor):
        return watching.accuracy * np.sqrt(monitor.solution.covariance[:, UP, UP])
    if isinstance(monitor, SeparationMonitor):
        return monitor.found.accuracy[:, UP]
    return cast(SubfilterMonitor, monitor).sigma[:, UP]


def threshold_by_faults(monitor: LandingMonitor) -> np.ndarray | None:
    """Effective monitor threshold (e,), m; None where residuals are tested."""
    return monitor.found.emt if isinstance(monitor, SeparationDistances) else None


def _indices(names: Sequence[str], wanted: Sequence[str]) -> tuple[int, ...]:
    return tuple(i for i, name in enumerate(names) if name in wanted)


def status(tested: np.ndarray, threshold: np.ndarray, statistic: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Status of epochs (e, r): tested, threshold (e,), statistic (e, r), fixed (e, r) whether there is a fix."""
    text = np.where(statistic > threshold[:, None], ALARM, QUIET)
    return np.where(fixed, np.where(tested[:, None], text, UNTESTED), NO_FIX)
