"""Inputs that all runs of a landing share: trajectory, exact IMU increments, signals, true heights, receiver clock
noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from navsim.geodesy.earth import llh_from_ecef
from navsim.gnss import pseudorange
from navsim.gnss.dop import dops, geometry_covariance
from navsim.gnss.fix_states import FixStates
from navsim.gnss.heavy_tailed import HeavyTailedNoise
from navsim.gnss.receiver import Receiver
from navsim.gnss.signals import SignalScenario, build_signals, true_positions
from navsim.gnss.sky import enu_matrix
from navsim.simulation.aiding import Aid, aids_of
from navsim.simulation.correlated_errors import FixErrors
from navsim.simulation.dispersed_trajectory import Dispersion
from navsim.trajectory.air import Air
from navsim.trajectory.kinematics import Motion, Moving, Trajectory


@dataclass(frozen=True)
class SharedTruth:
    """Simulation inputs that all runs of a scenario share."""

    imu_time: np.ndarray
    """(n + 1,) s."""
    dtheta: np.ndarray
    """(n, 3) exact angle increments, rad."""
    dv: np.ndarray
    """(n, 3) exact velocity increments, m/s."""
    truth: Motion
    """Motion at `imu_time`."""
    signals: pseudorange.Signals
    clock: np.ndarray
    """(e, 2) receiver clock offset (m) and drift (m/s) at the fixes, without noise."""
    clock_density: tuple[float, float]
    """Noise densities of the clock (`gnss.receiver.wander`)."""
    clock_at_filter: np.ndarray
    """(e + 1, 2) clock at the filter's outputs, without noise."""
    scale_offsets: np.ndarray
    """(MAX_CLOCKS,) offset of each time scale in the pseudoranges of its sources, m."""
    start: np.ndarray
    """(3,) ECEF, m: touchdown point, from which fixes iterate."""
    at_filter: Motion
    """Motion at the filter's e + 1 output times: 0, and every fix epoch plus latency."""
    filter_index: np.ndarray
    """(e + 1,) index of the IMU sample at or just before them."""
    aids: tuple[Aid, ...]
    """Sensors beside the receiver."""
    noise_distribution: HeavyTailedNoise | None
    """Distribution of the ranging noise if it is not Gaussian."""
    fix_states: FixStates | None = None
    """States of the receiver's fixes; None: fixes follow from the ranges."""
    dispersion: Dispersion | None = None
    """Common data of the trajectories of runs that deviate from the route; None if all runs fly the route."""

    @property
    def filter_time(self) -> np.ndarray:
        """Times of the filter's output, s (e + 1,)."""
        return self.at_filter.time

    @cached_property
    def scales(self) -> tuple[int, ...]:
        """Numbers of the time scales of the sources that are ever received."""
        return tuple(sorted(set(self.signals.time_scale[self.signals.used.any(axis=0)].tolist())))

    @cached_property
    def dop(self) -> np.ndarray:
        """`dops` of the signals (e, 5)."""
        return dops(self.signals.los, self.signals.time_scale)

    @cached_property
    def fix_errors(self) -> FixErrors:
        """Effect of ranging errors on fixes."""
        return FixErrors.of(self.start, self.signals, *assumed_measurements(self))

    @cached_property
    def antenna_enu(self) -> np.ndarray:
        """Rows (e, 3, 3) that resolve ECEF along east, north and up at the antenna."""
        return enu_matrix(llh_from_ecef(self.signals.antenna))

    @cached_property
    def fix_covariance(self) -> np.ndarray:
        """Weighted covariance of the position fixes from the signals (e, 3, 3), ENU, m2."""
        weight = 1.0 / self.signals.fix_sigma**2
        return geometry_covariance(self.signals.los, self.signals.time_scale, weight)[0][:, :3, :3]


def build_shared_truth(
    trajectory: Moving,
    environment: SignalScenario,
    receiver: Receiver,
    *,
    utc: float,
    duration: float,
    imu_rate: float,
    aiding: Sequence[Any] = (),
    air: Air | None = None,
) -> SharedTruth:
    """Route and geometry of the signals.

    utc: of time 0, s from 1970-01-01. duration: s. imu_rate: Hz. Fixes after the end are omitted. aiding: models of
    sensors beside the receiver. air: disturbances that give each run its own trajectory around a `Trajectory`.
    """
    imu_time = np.arange(int(np.floor(duration * imu_rate + 1e-9)) + 1) / imu_rate
    dtheta, dv = trajectory.increments(imu_time)
    fix_time = receiver.epochs(duration, imu_rate)
    at_filter = trajectory.motion(np.concatenate([[0.0], fix_time + receiver.latency]))
    at_fixes = trajectory.motion(fix_time)
    signals, ways = build_signals(at_fixes, utc, environment), None
    if air is not None:
        assert isinstance(trajectory, Trajectory)
        sources = true_positions(environment, signals.position)
        ways = Dispersion.of(air, trajectory, imu_time, at_filter, at_fixes, signals, sources, environment.lever_arm)
    return SharedTruth(
        imu_time=imu_time,
        dtheta=dtheta,
        dv=dv,
        truth=trajectory.motion(imu_time),
        signals=signals,
        clock=receiver.clock(fix_time),
        clock_density=receiver.clock_density,
        clock_at_filter=receiver.clock(at_filter.time),
        scale_offsets=environment.scale_offsets,
        start=trajectory.frame.origin,
        at_filter=at_filter,
        filter_index=np.searchsorted(imu_time, at_filter.time + 1e-9, side="right") - 1,
        aids=aids_of(aiding, trajectory, duration, imu_rate),
        noise_distribution=environment.effects.noise_distribution,
        fix_states=receiver.states,
        dispersion=ways,
    )


def assumed_measurements(shared: SharedTruth) -> tuple[np.ndarray, np.ndarray]:
    """Pseudoranges and range rates (e, s) without any error: they agree with the receiver's own positions of the
    sources."""
    signals = shared.signals
    offset = signals.position - signals.antenna[:, None]
    distance = np.linalg.norm(offset, axis=2)
    rate = np.sum(offset * (signals.velocity - signals.antenna_velocity[:, None]), axis=2) / distance
    ranges = np.where(signals.used, distance + shared.clock[:, :1], np.nan)
    return ranges, np.where(signals.used, rate + shared.clock[:, 1:], np.nan)
