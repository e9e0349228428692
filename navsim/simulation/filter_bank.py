"""Solution separation of filters: the filter's solution compared with those without the sources of each fault.

The other filters use the same inertial sensors, so the differences depend only on gains and innovations. Covariances
and gains are those along the truth, the same in all runs. A run propagates the differences
(`error_propagation.sensitivity_propagation.propagate_differences`).

Source: `docs/theory/integrity.md`, section 10; Brenner, Integrated GPS/inertial fault detection availability,
NAVIGATION 43(2) (1996); Young & McGraw, Fault detection and exclusion using normalized solution separation and residual
monitoring methods, NAVIGATION 50(3) (2003).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from navsim.compiler.lanes import WIDTH, in_lanes
from navsim.defect import Defect
from navsim.error_propagation.sensitivity_propagation import LinearisedHistory, propagate_differences
from navsim.filter import states
from navsim.filter.measurement_kinds import FIX
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.receiver_fixes import ReceiverFixes, solve_fixes
from navsim.integrity import araim
from navsim.integrity.araim import Allocation, Levels, SeparationDistances, SolutionSpread
from navsim.integrity.monitoring import faults_of, fix_of
from navsim.integrity.solution import turned
from navsim.simulation.aiding import columns_on_ground
from navsim.simulation.along_truth import AlongTruth, along_design
from navsim.simulation.flight import Flight
from navsim.simulation.landing_covariance import excess, responses, route_of_filter

_ROUNDING = 1e-5
"""A negative variance of a difference is rounding if it is above this fraction of that without some sources."""
LEAST = 0.05
"""Smallest sigma of a difference, relative to that without some sources. Gains along the truth neglect some hundredths
of it, which would cause an alarm for sources with hardly any weight."""
_ENU = _NED = [1, 0, 2]
"""Indices of east, north, up in north, east, down, except for the sign of up; and vice versa."""


@dataclass(frozen=True)
class FilterSolution:
    """Position of a filter at its outputs except the first; east, north, down."""

    covariance: np.ndarray
    """(e, 3, 3) m2."""
    reach: np.ndarray
    """(e, 3, s + g) effect of the largest bias of each source, m, and then of each transmitter on the ground."""

    @classmethod
    def of(cls, flight: Flight, along: AlongTruth, nominal: np.ndarray) -> FilterSolution:
        """Solution of a filter along the truth. nominal: (s + g,) bounds of biases, m or rad."""
        covariance = along.lin.assumed[1:, :3, :3][:, _ENU][:, :, _ENU]
        return cls(covariance, responses(flight, along)[1:, states.POS : states.POS + 3][:, _ENU] * nominal)


@dataclass(frozen=True)
class FilterBank(SeparationDistances):
    """Monitor of a filter by other filters with fewer measurements; see `monitoring.SubfilterMonitor`."""

    flight: Flight
    found: Levels
    """(e,) protection levels at its outputs except the first."""
    taken: np.ndarray
    """(f, s + g) bool, sources and transmitters on the ground that each of the other filters does not use."""
    route: LinearisedHistory
    """State history of the filter."""
    gains: np.ndarray
    """(w, f, n, MOST) of the others."""
    fix: np.ndarray
    """(k,) row of each fix, -1 for other events."""
    scale: np.ndarray
    """(o, f, 3) inverse thresholds of the differences north, east, down."""
    solutions: tuple[FilterSolution, ...]
    """Solutions of the filter and of the others; they give levels along other axes."""
    aided: np.ndarray
    """(e,) bool, whether the filter has a fix, a measurement of a transmitter on the ground or, tightly coupled, of a
    source."""
    idle: np.ndarray
    """(f, e) bool, whether without the faulty ones there is neither a fix nor transmitters on the ground enough for a
    position."""
    excluded: tuple[str, ...] = ()
    """Transmitters on the ground that no filter uses."""
    _kept: dict[tuple[str, ...], FilterBank] = field(default_factory=dict)

    @classmethod
    def of(cls, flight: Flight, excluded: tuple[str, ...] = ()) -> FilterBank:
        """Filter bank of a flight whose filters never use the excluded transmitters on the ground. Raises ValueError
        for a flight that no filters monitor."""
        watching = flight.watching
        if watching is None or not isinstance(watching.test, Allocation):
            raise ValueError("solution separation needs the shares of its levels")
        signals = flight.shared.signals
        every = (*signals.names, *watching.ground)
        test, expected = watching.test, watching.expected(signals)
        if excluded:
            test, expected = watching.without_ground(signals, excluded)
        sources, never = len(signals.names), np.isin(every, excluded)
        faults = faults_of(every, expected)
        taken = np.array([never | np.isin(every, one.sources) for one in expected], bool).reshape(-1, len(every))
        whole = along_design(flight, never)
        nominal = np.array([watching.nominal[name] for name in every])
        # only the data that levels and differences need, since all would be hundreds of megabytes
        route = route_of_filter(flight, whole)
        gains, solutions, both = [], [FilterSolution.of(flight, whole, nominal)], []
        for without in taken:
            along = along_design(flight, without)
            gains.append(along.lin.gain)
            solutions.append(FilterSolution.of(flight, along, nominal))
            both.append(2.0 * np.diagonal(excess(flight, route, whole, along)[1:], axis1=1, axis2=2)[:, _ENU])
        heard = ground_received(flight) & ~never[sources:]
        # those that give a position by themselves
        enough = 4 if any(aid.sensor.clock is not None for aid in flight.shared.aids) else 3
        ever = np.logical_or.accumulate(np.hstack([signals.used, heard]), axis=0)
        spread = _together(solutions, both)
        # without some sources there is no fix, so the filter coasts on its inertial sensors with growing errors
        solved_ = [
            fix_of(replace(signals, used=signals.used & ~one[:sources])).solved
            | ((heard & ~one[sources:]).sum(axis=1) >= enough)
            for one in taken
        ]
        idle = ~np.array(solved_, bool).reshape(len(taken), signals.time.size)
        found = araim.allocated_risk(spread, ever, faults, test, idle=idle)
        there = found.monitored[..., None] & (found.threshold > 0.0)
        inverse = 1.0 / np.where(there, found.threshold, np.inf)
        scale = np.zeros((flight.shared.filter_time.size, len(faults), 3))
        scale[1:] = np.moveaxis(inverse, 0, 1)[..., _NED]
        events = flight.events
        shape = whole.lin.gain.shape[0], 0, *whole.lin.gain.shape[1:]
        return cls(
            flight, found, taken, route, np.stack(gains, axis=1) if gains else np.zeros(shape),
            np.where(events.kind == FIX, events.row, -1), scale, tuple(solutions),
            np.asarray(signals.used.any(axis=1) if flight.design.tight else fix_of(signals).solved)
            | heard.any(axis=1), idle, excluded,
        )  # fmt: skip

    def without(self, ground: tuple[str, ...]) -> FilterBank:
        """The bank of the filter that never uses these transmitters on the ground either, and of filters without each
        further fault."""
        if ground not in self._kept:
            self._kept[ground] = FilterBank.of(self.flight, ground)
        return self._kept[ground]

    @property
    def tested(self) -> np.ndarray:
        """(e,) whether the filter has measurements and a fault is monitored."""
        return self.aided & super().tested

    @property
    def sigma(self) -> np.ndarray:
        """1 sigma of the filter that levels are of (e, 3), north, east, down, m."""
        return self.found.spread.sigma[:, _NED]

    def along(self, bearing: float) -> np.ndarray:
        """Levels (e, 2) across and along a horizontal direction of a bearing, rad, m; nan without a level."""
        watching = self.flight.watching
        assert watching is not None
        assert isinstance(watching.test, Allocation)
        turn = turned(np.eye(2), bearing)
        spreads = [
            (
                np.sqrt(np.einsum("ai,eij,aj->ea", turn, one.covariance[:, :2, :2], turn)),
                np.abs(turned(one.reach, bearing)).sum(axis=2),
            )
            for one in self.solutions
        ]
        priors = np.array([fault.prior for fault in watching.expected(self.flight.shared.signals)])
        return araim.across(self.found, spreads, priors, watching.test, bearing)

    @property
    def size(self) -> int:
        """Approximate memory, bytes."""
        return int(self.gains.nbytes + self.route.phi.nbytes + self.route.h.nbytes + self.route.gain.nbytes)

    def statistic(
        self, innovation: np.ndarray, fixes: ReceiverFixes, ranges: np.ndarray, rates: np.ndarray
    ) -> np.ndarray:
        """The largest difference of filters, by its threshold (e, W).

        innovation: (k, MOST, W) those that the filter used, nan for others. fixes: that it was given, where it was;
        ranges, rates: (e, s, W) that they are of.
        """
        others, outputs, n = self.taken.shape[0], self.scale.shape[0], self.gains.shape[2]
        apart = np.zeros((others, 0, MAX_MEASUREMENT_SIZE, WIDTH))
        if (self.fix >= 0).any():
            apart = self._separations(fixes, ranges, rates)
        out = np.zeros((outputs, WIDTH))
        propagate_differences(
            self.route, self.gains, in_lanes(innovation), self.fix, in_lanes(apart), self.scale,
            in_lanes(np.zeros((2, others, n, WIDTH))), in_lanes(out),
        )  # fmt: skip
        return out[1:]

    def _separations(self, fixes: ReceiverFixes, ranges: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Fixes of the others minus those of the filter (f, e, MOST, W), m, m/s, north, east, down."""
        shared = self.flight.shared
        heard = np.asarray(shared.signals.used.any(axis=0))
        signals = shared.signals.select(heard)
        measured, rates = (np.ascontiguousarray(m[:, heard]) for m in (ranges, rates))
        here = _ecef(fixes.llh)
        # sources that are taken anyway are taken once
        taken, which = np.unique(self.taken[:, : heard.size][:, heard], axis=0, return_inverse=True)
        out = np.empty((len(taken), ranges.shape[0], MAX_MEASUREMENT_SIZE, WIDTH))
        axes = shared.antenna_enu[:, _NED] * np.array([[1.0], [1.0], [-1.0]])
        for one, without in zip(out, taken, strict=True):
            other = solve_fixes(shared.start, signals, np.where(without[:, None], np.nan, measured), rates)
            one[:, :3] = np.einsum("eij,ejw->eiw", axes, _ecef(other.llh) - here)
            one[:, 3:] = other.velocity - fixes.velocity
        return np.ascontiguousarray(out[which.reshape(-1)])


def ground_received(flight: Flight) -> np.ndarray:
    """Of which transmitters on the ground, (e, g) bool, the filter has a fresh measurement at its outputs except the
    first; (e, 0) if no monitor watches them. A fresh one is not older than a cycle of questions or an interval of
    fixes."""
    now, watching, aids = flight.shared.filter_time[1:], flight.watching, flight.shared.aids
    out = np.zeros((now.size, 0 if watching is None else len(watching.ground)), bool)
    for aid, column in zip(aids, columns_on_ground(aids, 0), strict=True) if out.size else ():
        fresh = max(aid.sensor.transmitters / aid.sensor.rate, float(np.diff(now).max(initial=0.0)))
        for one in np.unique(column[column >= 0]):
            came = np.append(-np.inf, aid.arrival[np.isfinite(aid.exact[:, 0]) & (column == one)])
            out[:, one] = now - came[np.searchsorted(came, now, side="right") - 1] < fresh + _ROUNDING
    return out


def _ecef(llh: np.ndarray) -> np.ndarray:
    """ECEF (e, 3, W), m, of positions (e, 3, W)."""
    return np.moveaxis(ecef_from_llh(np.moveaxis(llh, 1, 2)), 2, 1)


def _together(solutions: Sequence[FilterSolution], both: Sequence[np.ndarray]) -> SolutionSpread:
    """The spread of a filter, the first, and of those without the sources of each fault; both: twice the `excess` of
    the variances (e, 3) of each."""
    variance = np.stack([np.diagonal(one.covariance, axis1=1, axis2=2) for one in solutions])
    bias = np.stack([np.abs(one.reach).sum(axis=2) for one in solutions])
    apart = variance[1:] - variance[0] - np.array(both).reshape(variance[1:].shape)
    if (apart < -_ROUNDING * variance[1:]).any():
        raise Defect("the difference of two filters has a negative variance; please report this scenario")
    solved_ = np.ones(variance.shape[:2], bool)
    apart = np.maximum(apart, LEAST**2 * variance[1:])
    return SolutionSpread(
        solved_[0], solved_[1:], np.sqrt(variance[0]), np.sqrt(variance[1:]), np.sqrt(apart), bias[0], bias[1:]
    )
