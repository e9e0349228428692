"""Plots and Mode S reports of the azimuth scenario, and their use by filters.

Source: `docs/theory/azimuth.md`, sections 2, 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.companions.circuit import CircuitFlight, G, level_acceleration
from navsim.statistics.random_streams import generator

DRAWS = 8
"""Numbers drawn a report: three load factors, roll, path angle, track, speed, track rate."""


@dataclass(frozen=True)
class Onboard:
    """1 sigma and least significant bit of the reported values (8,), in the order of DRAWS, SI and rad; 0: none."""

    sigma: np.ndarray
    lsb: np.ndarray


@dataclass(frozen=True)
class Draws:
    """Standard normal numbers of many runs: azimuth and range (run, n, 2), reports (run, n, DRAWS)."""

    plots: np.ndarray
    reports: np.ndarray


def draw(seed: int, runs: int, scans: int) -> Draws:
    """The random numbers of runs 0 ... runs - 1."""
    plots, reports = np.empty((runs, scans, 2)), np.empty((runs, scans, DRAWS))
    for run in range(runs):
        generator(seed, run, "plots").standard_normal(out=plots[run])
        generator(seed, run, "onboard").standard_normal(out=reports[run])
    return Draws(plots, reports)


def reported(flight: CircuitFlight, draws: np.ndarray, onboard: Onboard) -> np.ndarray:
    """Reports (run, n, 8) of a flight at the reports' own times: noise first, quantised after it."""
    true = np.column_stack([flight.load, flight.roll, flight.path_angle, flight.track, flight.speed, flight.track1])
    values = true + onboard.sigma * draws
    for i, lsb in enumerate(onboard.lsb):
        values[..., i] = quantise(values[..., i], lsb)
    return values


def quantise(values: np.ndarray, lsb: float) -> np.ndarray:
    """Values rounded to the least significant bit; 0: unchanged."""
    return np.floor(values / lsb + 0.5) * lsb if lsb > 0.0 else values


_SLOPE_SECONDS = 15.0
"""Stretch of reported ground speeds from which the acceleration along the track is taken where no load factor is."""


def _slope(values: np.ndarray, period: float) -> np.ndarray:
    """Least-squares slope (run, n) of each value with those of the last seconds before it, 1/s; zero at the first."""
    span = max(2, round(_SLOPE_SECONDS / period))
    out = np.zeros_like(values)
    for k in range(1, values.shape[1]):
        part = values[:, max(0, k + 1 - span) : k + 1]
        t = period * (np.arange(part.shape[1]) - 0.5 * (part.shape[1] - 1))
        out[:, k] = part @ t / (t @ t)
    return out


def nodes(reports: np.ndarray, source: str, period: float) -> np.ndarray:
    """Motion from reports (run, n, 8): acceleration along and right, horizontal speed, track (run, n, 4).

    source: `load` the load factors, `roll` g tan(roll), `rate` speed times track rate. The latter two are of BDS 5,0,
    which has no acceleration along the track: it is the slope of the reported ground speeds.
    """
    load, roll, angle = reports[..., :3], reports[..., 3], reports[..., 4]
    track, speed, rate = reports[..., 5], reports[..., 6], reports[..., 7]
    if source == "load":
        ahead, right = level_acceleration(load, roll, angle)
        ground = speed * np.cos(angle)
    else:
        ahead, ground = _slope(speed, period), speed
        right = G * np.tan(roll) if source == "roll" else speed * rate
    return np.stack([ahead, right, ground, track], axis=-1)


def stamped(node: np.ndarray, period: float, latency: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (run, n, 4) at the scan before and at this one, from reports whose age the filter knows.

    Between two reports values are interpolated; after the newest they are held, and the track is advanced by a right /
    speed. Track is taken as unwrapped.
    """
    times = np.arange(node.shape[1]) * period
    sampled = times - latency

    def at(k: np.ndarray, when: np.ndarray) -> np.ndarray:
        """Values at `when` for scans k, which know reports up to k."""
        late = (when - sampled[0]) / period
        below = np.clip(np.floor(late + 1e-9).astype(int), 0, k)
        above = np.minimum(below + 1, k)
        share = np.clip(late - below, 0.0, 1.0)[:, None] * (above > below)[:, None]
        out = (1.0 - share) * node[:, below] + share * node[:, above]
        ahead = np.maximum(when - sampled[k], 0.0)
        out[..., 3] += ahead * out[..., 1] / np.maximum(out[..., 2], 1.0)
        return out

    k = np.arange(node.shape[1])
    return at(k, times - period), at(k, times)
