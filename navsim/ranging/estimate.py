"""Positions, clocks and biases from ranges: start, filter, smoother, noise by likelihood.

The filter starts from positions that least squares find in the first ranges, at several heights; the start whose ranges
are most likely is kept. The smoother linearises the distances about its own result and repeats until it stays. For a
start whose sigma is large, each distance is the line that fits it best over the smoothed distribution of the position,
and the rest adds to the noise [1]; later it is the tangent. The noise settings that the scenario leaves out maximise
the likelihood of the ranges [2], within bounds.

Sources:

- [1] Garcia-Fernandez, Svensson & Sarkka, Iterated posterior linearization smoother, IEEE TAC 62 (2017).
- [2] Harvey, Forecasting, structural time series models and the Kalman filter (1989), section 3.4.
- [3] Berndt, Hall, Hall & Hausman, Annals of Economic and Social Measurement 3 (1974), with Marquardt's damping.
- [4] Bell & Cathey, The iterated Kalman filter update as a Gauss-Newton method, IEEE TAC 38 (1993); Kaess, Ranganathan
  & Dellaert, iSAM: incremental smoothing and mapping, IEEE Trans. Robotics 24 (2008).
- [5] Dempster, Laird & Rubin, J. Royal Statistical Society B 39 (1977), with Laplace's approximation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navsim.ranging.filter import DistanceLines, RangeHistory, filter_ranges, smooth_mean, smooth_ranges
from navsim.ranging.model import (
    BY_SOURCE,
    FACTOR_BOUNDS,
    SETTINGS,
    SPREAD_DEGREES,
    USUAL_SPREAD,
    RangeModel,
)
from navsim.ranging.scenario import RECEIVER

NO_LINES = DistanceLines(np.empty((0, 3)), np.empty(0), np.empty(0))
"""The filter linearises about its own prediction."""
_STAYS = 0.05
"""Change of the smoothed positions, in their sigmas (root mean square), below which the linearisation stays."""
_MOST_ROUNDS = 30
"""Largest number of linearisations."""
_FIRST_BLOCK, _BLOCKS = 20, 60
"""Ranges before the filter first linearises the past anew; how often it does so, evenly in time and evenly in its
logarithm."""
_MOST_STEPS, _GAIN = 40, 0.05
"""Largest number of steps of a search for the noise, and the gain of log-likelihood below which it ends."""
_MOST_DAMPING = 1e6
"""Damping beyond which no step gains anything."""
_STEP = 1e-3
"""Step of the logarithm of a setting for the slope of the likelihood."""


@dataclass(frozen=True)
class StartState:
    """State at the first range: position (3,) m, sigma of it (horizontal, vertical), receiver's clock offset, m."""

    position: np.ndarray
    sigma: tuple[float, float]
    clock: float


@dataclass(frozen=True)
class Filtered:
    """Output of one pass: state (m, n), covariance (m, n, n), innovation (m,), its variance (m,), weight (m,) of the
    usual noise, surprise (m,): minus its log-likelihood, history for the smoother."""

    state: np.ndarray
    covariance: np.ndarray
    innovation: np.ndarray
    variance: np.ndarray
    weight: np.ndarray
    surprise: np.ndarray
    history: RangeHistory

    @property
    def likelihood(self) -> float:
        """Logarithm of the likelihood of all ranges."""
        return -float(self.surprise.sum())


@dataclass(frozen=True)
class Smoothed:
    """Output of the smoother."""

    state: np.ndarray
    """(m, n)."""
    covariance: np.ndarray
    """(m, n, n)."""
    lines: DistanceLines
    """The linearised distances."""
    filtered: Filtered
    """The filter pass with these lines."""
    moved: float
    """How far the last linearisation moved the positions, in sigmas."""
    prior: np.ndarray
    """(n, n): covariance at the start."""


def allocate_history(count: int, size: int) -> RangeHistory:
    """RangeHistory of so many ranges and states."""
    return RangeHistory(
        np.zeros((count, size)), np.zeros((count, size, size)), np.zeros((count, size)), np.zeros((count, size)),
        np.zeros(count), np.zeros(count),
    )  # fmt: skip


def filter_pass(
    model: RangeModel,
    settings: dict[str, float],
    start: StartState,
    lines: DistanceLines = NO_LINES,
    history: RangeHistory | None = None,
    until: int | None = None,
) -> Filtered:
    """Filter the ranges with these settings; history: where it is kept, of no rows for none, left out: a new one;
    until: number of ranges, left out: all."""
    data = model.data
    m, n = data.time.size if until is None else until, model.size
    if m < data.time.size:
        data = data._replace(
            time=data.time[:m], source=data.source[:m], range=data.range[:m], scale=data.scale[:m], row=data.row[:m]
        )
    if history is None:
        history = allocate_history(m, n)
    x = np.zeros(n)
    x[:3] = start.position
    if RECEIVER in model.clocks:
        x[model.first_clock + 2 * model.clocks.index(RECEIVER)] = start.clock
    p = model.covariance(settings, start.sigma)
    innovation, variance, weight, surprise = np.empty(m), np.empty(m), np.empty(m), np.empty(m)
    filter_ranges(
        data,
        model.dynamics(settings),
        model.noise(settings),
        lines,
        x,
        p,
        history,
        innovation,
        variance,
        weight,
        surprise,
    )
    return Filtered(history.state, history.covariance, innovation, variance, weight, surprise, history)


def filter_causally(model: RangeModel, settings: dict[str, float], start: StartState) -> Filtered:
    """Filter all ranges; each estimate rests on the ranges up to its time, linearised about what these say.

    A filter that linearises each range once, about its prediction, takes errors of the linearisation for knowledge:
    with a small array its vertical errors are three times its sigma. So before each block of ranges the past is
    smoothed and linearised anew [4].
    """
    m, n = model.data.time.size, model.size
    ends = np.concatenate([np.geomspace(min(_FIRST_BLOCK, m), m, _BLOCKS), np.linspace(0, m, _BLOCKS + 1)[1:]])
    history, out = allocate_history(m, n), allocate_history(m, n)
    statistics = np.empty((4, m))
    mean, lines, begin = np.empty((m, n)), NO_LINES, 0
    for end in np.unique(ends.astype(int)):
        done = filter_pass(model, settings, start, lines, history, int(end))
        new = slice(begin, end)
        out.state[new], out.covariance[new] = history.state[new], history.covariance[new]
        statistics[:, new] = [part[new] for part in (done.innovation, done.variance, done.weight, done.surprise)]
        smooth_mean(model.data, model.dynamics(settings), history, int(end), mean)
        lines, begin = tangents(model, mean[:end, :3]), int(end)
    innovation, variance, weight, surprise = statistics
    return Filtered(out.state, out.covariance, innovation, variance, weight, surprise, history)


def smooth(
    model: RangeModel, settings: dict[str, float], filtered: Filtered, shown: int | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed state and covariance of a filter pass; shown: covariance of so many states, left out: of all."""
    m, n = filtered.state.shape
    size = n if shown is None else shown
    state, covariance = np.empty((m, n)), np.empty((m, size, size))
    smooth_ranges(model.data, model.dynamics(settings), filtered.history, state, covariance)
    return state, covariance


def linearise(model: RangeModel, mean: np.ndarray, covariance: np.ndarray) -> DistanceLines:
    """Lines that fit the distances best over positions of this mean (m, 3) and covariance (m, 3, 3), by the cubature
    of third degree."""
    m = mean.shape[0]
    w, v = np.linalg.eigh(covariance)
    w = np.maximum(w, 1e-10)
    root = v * np.sqrt(3.0 * w)[:, None, :]
    at = model.data.position[model.data.source]
    nodes = np.concatenate([mean[:, :, None] + root, mean[:, :, None] - root], axis=2)  # (m, axis, node)
    distance = np.linalg.norm(nodes - at[:, :, None], axis=1)
    middle = distance.mean(axis=1)
    cross = np.einsum("mak,mk->ma", nodes - mean[:, :, None], distance - middle[:, None]) / 6.0
    inverse = np.einsum("mak,mk,mbk->mab", v, 1.0 / w, v)
    slope = np.einsum("mab,mb->ma", inverse, cross)
    rest = np.mean((distance - middle[:, None]) ** 2, axis=1) - np.einsum("ma,ma->m", slope, cross)
    assert slope.shape == (m, 3)
    return DistanceLines(slope, middle - np.einsum("ma,ma->m", slope, mean), np.maximum(rest, 0.0))


def tangents(model: RangeModel, mean: np.ndarray) -> DistanceLines:
    """Tangents of the distances of the first ranges at their positions (k, 3)."""
    away = mean - model.data.position[model.data.source[: mean.shape[0]]]
    distance = np.maximum(np.linalg.norm(away, axis=1), 1e-6)
    slope = away / distance[:, None]
    return DistanceLines(slope, distance - np.einsum("ma,ma->m", slope, mean), np.zeros(distance.size))


def relinearise(
    model: RangeModel,
    settings: dict[str, float],
    start: StartState,
    first: Smoothed | None = None,
    rounds: int = _MOST_ROUNDS,
    wide: bool = False,
) -> Smoothed:
    """Smooth, linearise about the result, and repeat until it stays; first: where to begin; wide: fit the lines over
    the distribution of the positions, for a start whose sigma is large; else they are tangents."""
    if first is None:
        filtered = filter_pass(model, settings, start)
        state, spread = smooth(model, settings, filtered, 3)
        mean = state[:, :3].copy()
    else:
        mean, spread = first.state[:, :3].copy(), first.covariance[:, :3, :3].copy()
    step, before = 1.0, np.inf
    for _ in range(rounds):
        lines = linearise(model, mean, spread) if wide else tangents(model, mean)
        filtered = filter_pass(model, settings, start, lines)
        state, covariance = smooth(model, settings, filtered, 3)
        change = state[:, :3] - mean
        sigma = np.sqrt(np.maximum(np.einsum("mii->mi", covariance), 1e-12))
        moved = float(np.sqrt(np.mean((change / sigma) ** 2)))
        if moved < _STAYS:
            break
        if moved > 0.7 * before:
            step = max(0.5 * step, 0.1)
        before = moved
        mean = mean + step * change
        spread = covariance
    state, covariance = smooth(model, settings, filtered)
    return Smoothed(state, covariance, lines, filtered, moved, model.covariance(settings, start.sigma))


@dataclass(frozen=True)
class _Unknowns:
    """Unknowns of the tuning: names (k,), bounds (k,) of their logarithms, and which (g, s) are the factors of each
    setting that differs by source."""

    names: tuple[str, ...]
    low: np.ndarray
    high: np.ndarray
    factors: dict[str, np.ndarray]

    def precision(self, settings: dict[str, float]) -> np.ndarray:
        """Precision (k,) of the prior of the logarithms, which are 0 by it."""
        out = np.zeros(len(self.names))
        for name, which in self.factors.items():
            out[which] = settings[BY_SOURCE[name]] ** -2.0
        return out

    def spreads(self, x: np.ndarray, curvature: np.ndarray) -> dict[str, float]:
        """Most likely spread of each setting that differs by source, given the mean x (k,) and the inverse covariance
        (k, k) of the logarithms: a step of expectation and maximisation [5]."""
        out, variance = {}, np.diagonal(np.linalg.inv(curvature))
        for name, which in self.factors.items():
            squares = SPREAD_DEGREES * USUAL_SPREAD**2 + float(np.sum(x[which] ** 2 + variance[which]))
            out[BY_SOURCE[name]] = (squares / (SPREAD_DEGREES + which.size)) ** 0.5
        return out


def _unknowns(model: RangeModel) -> _Unknowns:
    names, bounds, factors = list(model.free), [(SETTINGS[name].low, SETTINGS[name].high) for name in model.free], {}
    for name in model.by_source:
        factors[name] = len(names) + np.arange(len(model.factors(name)))
        names += model.factors(name)
        bounds += [FACTOR_BOUNDS] * factors[name].size
    low, high = np.log(bounds).T
    return _Unknowns(tuple(names), low, high, factors)


def tune(
    model: RangeModel, settings: dict[str, float], start: StartState, lines: DistanceLines, done: Callable[[], None]
) -> dict[str, float]:
    """Settings with the free ones most likely, by the method of Berndt, Hall, Hall and Hausman [3] over logarithms."""
    unknown = _unknowns(model)
    free, low, high = unknown.names, unknown.low, unknown.high
    if not free:
        return settings
    none = allocate_history(0, model.size)

    def surprise(x: np.ndarray) -> np.ndarray:
        done()
        tried = settings | dict(zip(free, map(float, np.exp(x)), strict=True))
        return filter_pass(model, tried, start, lines, none).surprise

    x = np.log([settings[name] for name in free])
    here, damping = surprise(x), 1e-2
    for _ in range(_MOST_STEPS):
        inward = np.where(x + _STEP > high, -_STEP, _STEP)
        slopes = np.column_stack([(surprise(x + e) - here) / e.sum() for e in np.diag(inward)])
        curvature = slopes.T @ slopes + 1e-6 * np.eye(x.size)
        settings = settings | unknown.spreads(x, curvature + np.diag(unknown.precision(settings)))
        prior = unknown.precision(settings)
        downhill, curvature = -slopes.sum(axis=0) - prior * x, curvature + np.diag(prior)
        gain = -np.inf
        while damping < _MOST_DAMPING:
            held = ((x <= low) & (downhill < 0.0)) | ((x >= high) & (downhill > 0.0))
            step, move = np.zeros(x.size), ~held
            damped = curvature + damping * np.diag(np.diag(curvature))
            step[move] = np.linalg.solve(damped[np.ix_(move, move)], downhill[move])
            to = np.clip(x + np.clip(step, -1.5, 1.5), low, high)
            there = surprise(to)
            gain = float((here - there).sum() + 0.5 * np.sum(prior * (x**2 - to**2)))
            if gain > 0.0:
                x, here, damping = to, there, max(0.2 * damping, 1e-4)
                break
            damping *= 6.0
        if gain < _GAIN:
            break
    return settings | dict(zip(free, map(float, np.exp(x)), strict=True))
