"""Protection levels of a GBAS approach from the B values that a ground station broadcasts in each run.

A correction is the mean of M reference receivers. The mean of their errors and the deviations from it are independent,
so the runs draw the mean as an error of ranges, and the deviations here.

Source: `docs/theory/integrity.md`, section 5.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss import dll
from navsim.gnss.correlated_errors import CorrelatedErrors
from navsim.gnss.events import PSEUDOLITES, Event, RangeFault
from navsim.gnss.ground_accuracy import GroundStationError
from navsim.gnss.pseudorange import Signals
from navsim.integrity.sbas_gbas import effect_of_b, gbas, gbas_factors, gbas_projection
from navsim.integrity.solution import MonitoredFix

SECOND_SMOOTHING = 100.0
"""Time constant, s, of the second carrier smoothing of GAST D; the receiver's is the first."""

HISTORY = ("gbas_lpl_run", "gbas_vpl_run", "gbas_error_lateral", "gbas_error_vertical", "gbas_b_lateral",
           "gbas_b_vertical", "gbas_d_lateral", "gbas_d_vertical")  # fmt: skip
"""Numbers of a fix of a run: its levels, the sizes of its errors, the largest effect of the B values of a reference
receiver on it, and D_L and D_V; m."""
LEVELS, ERRORS, B_EFFECTS, DIFFERENCES = (slice(2 * i, 2 * i + 2) for i in range(4))
"""Parts of `HISTORY`, each lateral and vertical."""


@dataclass(frozen=True)
class GbasStation:
    """A GBAS ground station and the approach that it serves."""

    error: GroundStationError
    """Errors of its corrections."""
    events: tuple[Event, ...]
    """Faults of its reference receivers."""
    course: float
    """Course of the approach, rad from north."""
    glide: float
    """Glide path angle, rad."""
    two_smoothings: bool
    """Levels contain the difference of positions from two smoothings, as those of GAST D."""
    systems: Mapping[str, str]
    """Systems of satellites by their names."""

    def over(self, signals: Signals, fix: MonitoredFix) -> StationLevels:
        """Levels of the fixes from these signals."""
        projection = gbas_projection(fix.estimator, self.course, self.glide)
        systems = tuple(self.systems.get(name, PSEUDOLITES) for name in signals.names)
        return StationLevels(self, signals, systems, projection, fix.solved)


@dataclass(frozen=True)
class StationLevels:
    """Levels along a landing: `station` over the signals that all runs share, of these systems (s,)."""

    station: GbasStation
    signals: Signals
    systems: tuple[str, ...]
    projection: np.ndarray
    """(e, 2, s) effect of ranges across the track and on the height above the glide path."""
    solved: np.ndarray
    """(e,) bool, epochs with a fix."""

    @property
    def receivers(self) -> int:
        """Number of reference receivers."""
        return self.station.error.receivers

    def faults(self) -> np.ndarray:
        """What events add to the corrections of each reference receiver (e, s, M), m."""
        signals = self.signals
        out = np.zeros((*signals.used.shape, self.receivers))
        for event in self.station.events:
            assert isinstance(event.what, RangeFault)
            lasting = (signals.time >= event.begin) & (signals.time < event.end)
            size = np.where(lasting, event.what.at(signals.time - event.begin), 0.0)
            out[..., event.receiver - 1] += size[:, None] * event.concerns(signals.names, self.systems)
        return out

    def b_values(self, rngs: Sequence[np.random.Generator]) -> np.ndarray:
        """B values (e, s, M, W), m, of as many runs as there are generators.

        B of a receiver: the correction, the mean of all receivers, minus the mean of the others.
        """
        own, _ = self.station.error.of_receiver(self.signals.elevation, self.systems)
        shape = (self.receivers, *own.shape)
        unit = CorrelatedErrors((), np.full(self.receivers, self.station.error.time), np.empty(shape))
        drawn = np.moveaxis(unit.drawn(self.signals.time, rngs), 0, 2)
        error = own[..., None, None] * drawn + self.faults()[..., None]
        satellites = own[..., None, None] > 0.0
        deviation = error - error.mean(axis=2, keepdims=True)
        return np.where(satellites & self.signals.used[..., None, None], deviation / (self.receivers - 1), 0.0)

    def levels(self, off: np.ndarray) -> np.ndarray:
        """Lateral and vertical levels (e, 2, 2, W), m, without a faulty receiver and with one.

        off: (e, 2, W) the largest effect of the B values of a receiver, m.
        """
        ground = np.where(self.signals.used, self.station.error.at(self.signals.elevation, self.systems), 0.0)
        sigma, factors = np.where(self.signals.used, self.signals.fix_sigma, 0.0), gbas_factors(self.receivers)
        out = gbas(self.projection, sigma, ground, off, self.receivers, factors)
        out[~self.solved] = np.nan
        return out

    def fault_free(self) -> np.ndarray:
        """Levels (e, 2), m, without a faulty receiver: the same in all runs."""
        return self.levels(np.zeros((self.solved.size, 2, 1)))[:, :, 0, 0]

    def smoothing_differences(self, ranges: np.ndarray, codes: np.ndarray, phases: np.ndarray) -> np.ndarray:
        """D_L and D_V (e, 2, W), m: sizes of what a second smoothing of 100 s changes in a position.

        ranges: (e, s, W) smoothed, codes and phases that they are of, m.
        """
        memory = dll.smoothing_memory(SECOND_SMOOTHING, self.signals.time)
        _, counts = dll.smoothed_variance(np.zeros(ranges.shape[:2]), self.signals.used, memory)
        longer = np.stack([dll.smooth(codes[..., k], phases[..., k], counts) for k in range(codes.shape[2])], axis=2)
        change = np.where(self.signals.used[..., None], ranges - longer, 0.0)
        return np.abs(np.einsum("eas,esw->eaw", self.projection, change))

    def of_fixes(
        self, b: np.ndarray, differences: np.ndarray, llh: np.ndarray, antenna: np.ndarray, enu: np.ndarray
    ) -> np.ndarray:
        """`HISTORY` (e, 8, W) of fixes llh (e, 3, W); nan without a fix.

        - `b` (e, s, M, W): B values; `differences` (e, 2, W): D_L and D_V, or zeros, m.
        - `antenna` (e, 3, W): true, ECEF, m; `enu` (e, 3, 3): rows east, north, up at the antenna.
        """
        away = ecef_from_llh(np.moveaxis(llh, 1, 2)) - np.moveaxis(antenna, 1, 2)
        error = gbas_projection(np.einsum("ecd,ewd->ecw", enu, away), self.station.course, self.station.glide)
        off = effect_of_b(self.projection, b).max(axis=2)
        out = np.concatenate([self.levels(off).max(axis=2) + differences, np.abs(error), off, differences], axis=1)
        out[:, : LEVELS.stop][np.isnan(error)] = np.nan
        return out
