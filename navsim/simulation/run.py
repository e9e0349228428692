"""Output of a run of a landing, and of the monitor of its fixes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.filter.records import (
    ErrorHistory,
)
from navsim.gnss.receiver_fixes import ReceiverFixes, range_residuals
from navsim.integrity import monitoring
from navsim.integrity.exclusion import NOTHING
from navsim.integrity.fix_exclusion import FixesAfterExclusion

if TYPE_CHECKING:
    from navsim.simulation.flight import Flight


@dataclass(frozen=True)
class Run:
    """Output of one run, or of several along a first axis. Shapes and units are those of the result file without the
    run axis.

    Arrays of n samples, e fixes, o outputs, s sources, a aiding measurements. Those that do not apply are empty.
    """

    pseudorange: np.ndarray
    """(e, s) m; empty if measurements are not kept."""
    range_rate: np.ndarray
    """(e, s) m/s, likewise."""
    fix_llh: np.ndarray
    """(e, 3) fixes of the receiver."""
    fix_velocity: np.ndarray
    """(e, 3) NED, m/s."""
    fix_clock: np.ndarray
    """Clock estimates of the fixes, m."""
    error: np.ndarray
    """(e + 1, n) truth minus estimate at the outputs."""
    sigma: np.ndarray
    """(e + 1, n) filter sigma."""
    cross: np.ndarray
    """(e + 1, 6) elements NE, ND, ED of the covariance of position, then of attitude: they allow a later rotation of
    axes."""
    nees: np.ndarray
    """(e + 1,) of all states."""
    nees_position_velocity: np.ndarray
    """(e + 1,) of position and velocity."""
    nees_group: np.ndarray
    """(e + 1, g) of each group of three states."""
    innovation_squared: np.ndarray
    """(e,) normalised innovation squared."""
    degrees: np.ndarray
    """(e,) its degrees of freedom."""
    status: np.ndarray
    """(e,) not used, used or rejected."""
    range_status: np.ndarray
    """(e, s) status of each range; empty unless the filter is tightly coupled."""
    aided: np.ndarray
    """(a, MOST) measurements of sensors beside the receiver, in the order of `SharedTruth.aids`; nan after their
    numbers."""
    aided_squared: np.ndarray
    """(a,) as of the fixes."""
    aided_degrees: np.ndarray
    """(a,) as of the fixes."""
    aided_status: np.ndarray
    """(a,) as of the fixes."""
    monitor_statistic: np.ndarray
    """(e,) test statistic of the monitor, see `MonitorOutput`."""
    monitor_status: np.ndarray
    """(e,) result of the test."""
    watched_error: np.ndarray
    """(e, 2) sizes of the monitored horizontal and vertical errors, m."""
    monitor_excluded: np.ndarray
    """(e,) number of the exclusion candidate, -1 for none; empty without exclusion."""
    monitor_level: np.ndarray
    """(e, 2) protection levels of the fixes after exclusion, nan without a test; empty without exclusion."""
    station: np.ndarray
    """(e, 8) GBAS levels of the fixes, see `integrity.gbas_station.HISTORY`; empty without drawn B values."""
    innovation_ratio: np.ndarray
    """(e,) see `InnovationTest`; empty without the test."""
    deviation: np.ndarray
    """(o, 3) of the trajectory from the route, lateral, along, vertical, m. Empty if all runs fly the route."""
    attitude: np.ndarray
    """(o, 3) true roll, pitch, yaw, rad, likewise."""
    antenna: np.ndarray
    """(e, 3) true antenna position at fixes, ECEF, m, likewise."""
    gust: np.ndarray
    """Wind minus the mean wind (o, 3), m/s: right of the course, along it, up. Empty if all runs fly the route."""
    delta_angle: np.ndarray
    """Angle increments measured by the gyros (n, 3), rad. Empty if measurements are not kept."""
    delta_velocity: np.ndarray
    """Velocity increments measured by the accelerometers (n, 3), m/s. Empty if measurements are not kept."""
    start_llh: np.ndarray
    """Initial position of the filter (3,), rad, rad, m."""
    start_velocity: np.ndarray
    """Initial velocity of the filter (3,), NED, m/s."""
    start_rpy: np.ndarray
    """Initial roll, pitch, yaw of the filter (3,), rad."""
    filter_fix_llh: np.ndarray
    """Fixes (e, 3) used by a loosely coupled filter, nan where it uses none. Empty if measurements are not kept, or the
    filter is tightly coupled."""
    filter_fix_velocity: np.ndarray
    """Velocities (e, 3) of these fixes, NED, m/s, nan where the filter uses none."""
    filter_fix_covariance: np.ndarray
    """Their covariance (e, 6, 6) in the filter model, position and velocity, NED."""
    clipped: np.ndarray
    """(2,) samples of gyros and of accelerometers beyond their range; empty without a range."""
    first_order: np.ndarray
    """(o, 3) first-order error of position, NED, m, truth minus estimate; empty if not requested."""
    fix_state: np.ndarray
    """(e,) true state of each fix (`gnss.fix_states.STATES`); empty if fixes have none."""
    fix_flag: np.ndarray
    """(e,) state that the receiver reports, likewise."""
    touchdown: np.ndarray
    """(4,) see `Endings`; empty if all runs fly the route."""
    go_around: np.ndarray
    """(3,) likewise; empty if no alarm breaks a landing off."""
    loop_gap: np.ndarray
    """(1,) largest distance between the flown trajectory and the one that guidance by this estimate gives, m. Empty if
    the estimate does not steer."""

    def one(self, which: int) -> Run:
        """One of several runs."""
        return Run(**{name: getattr(self, name)[which] for name in self.__dataclass_fields__})

    def put(self, which: int, others: Run, other: int) -> None:
        """Overwrite one of several runs by one of others."""
        for name in self.__dataclass_fields__:
            getattr(self, name)[which] = getattr(others, name)[other]


@dataclass(frozen=True)
class MonitorOutput:
    """Output of a monitor of fixes, or of filters, in lanes; empty without a monitor."""

    statistic: np.ndarray
    """(e, W)."""
    status: np.ndarray
    """(e, W)."""
    error: np.ndarray
    """(e, 2, W) sizes of the horizontal and vertical errors, m."""
    excluded: np.ndarray
    """(e, W) see `Run`."""
    level: np.ndarray
    """(e, 2, W) see `Run`."""

    @classmethod
    def of_filter(
        cls,
        flight: Flight,
        bank: monitoring.SubfilterMonitor,
        errors: ErrorHistory,
        fixes: ReceiverFixes,
        ranges: np.ndarray,
        rates: np.ndarray,
    ) -> MonitorOutput:
        """Monitor output for the filter of a bank, from its history and its fixes from ranges and rates (e, s, W)."""
        none = np.empty((0, WIDTH)), np.empty((0, 2, WIDTH))
        statistic = bank.statistic(errors.innovation, fixes, ranges, rates)
        aided = np.repeat(bank.aided[:, None], WIDTH, axis=1)
        text = monitoring.status(bank.tested, bank.threshold, statistic, aided)
        # nan is not silence; nor do levels hold if the filter's sigma is much larger than theirs
        sigma = errors.sigma[1:, states.POS : states.POS + 3]
        lost = np.isnan(statistic) | (sigma > monitoring.DOUBTED * bank.sigma[..., None]).any(axis=1)
        text = np.where(lost & aided, monitoring.ALARM, text)
        error = np.abs(errors.errors.error[1:, states.POS : states.POS + 3])
        off = np.stack([np.hypot(error[:, 0], error[:, 1]), error[:, 2]], axis=1)
        return cls(statistic, text.astype(float), off, *none)

    @classmethod
    def of_fixes(cls, flight: Flight, antenna: np.ndarray, ranges: np.ndarray, fixes: ReceiverFixes) -> MonitorOutput:
        """Monitor output for fixes from ranges (e, s, W); antenna: (e, 3, W) true position, ECEF, m."""
        monitor, none = flight.snapshot, (np.empty((0, WIDTH)), np.empty((0, 2, WIDTH)))
        if monitor is None:
            return cls(none[0], *none, *none)
        signals, axes = flight.shared.signals, flight.shared.antenna_enu
        left, error = range_residuals(signals, antenna, axes, ranges, fixes.llh, fixes.clocks)
        fixed = ~np.isnan(fixes.llh[:, 0])
        statistic = np.where(fixed, monitor.statistic(left), np.nan)
        text = monitoring.status(monitor.tested, monitor.threshold, statistic, fixed)
        return cls(statistic, text.astype(float), error, *none)

    def after_exclusion(
        self, flight: Flight, antenna: np.ndarray, ranges: np.ndarray, rates: np.ndarray, fixes: ReceiverFixes
    ) -> MonitorOutput:
        """After exclusions, which change the fixes."""
        excluder, monitor = flight.excluder, flight.snapshot
        if excluder is None or monitor is None:
            return self
        levels = np.repeat(monitoring.tested_levels(monitor)[..., None], WIDTH, axis=2)
        now = FixesAfterExclusion(fixes, self.error.copy(), levels, np.full(self.status.shape, float(NOTHING)))
        excluder.exclude(self.status == monitoring.ALARM, ranges, rates, antenna, now)
        status = np.where(now.excluded == NOTHING, self.status, monitoring.EXCLUDED)
        return MonitorOutput(self.statistic, status, now.error, now.excluded, now.level)

    def trusted(self, flight: Flight, ranges: np.ndarray) -> np.ndarray:
        """Ranges (e, s, W) with nan for excluded ones, and for epochs with an alarm if the filter ignores them."""
        out = ranges
        if self.excluded.size:
            for number, candidate in enumerate(flight.candidates):
                taken = np.isin(flight.shared.signals.names, candidate.sources)
                out = np.where((self.excluded == number)[:, None] & taken[:, None], np.nan, out)
        if flight.drops:
            out = np.where((self.status == monitoring.ALARM)[:, None], np.nan, out)
        return out
