"""Two sources whose positions are exchanged in the table: exchanged back, they fit the ranges far better.

Looked for only where the tuned solution fits badly, since each pair costs the search for a start. All are solved with
the noise before the tuning, which a wrong table would enlarge. Where ranges are noisier, all likelihoods differ by too
much, so that the innovations judge as well: those of each table show its own noise.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from navsim.ranging.estimate import Smoothed
from navsim.ranging.model import RangeModel, build_model
from navsim.ranging.start import find_start

_RANGES = 600
"""Ranges that are looked at, from the first on."""
_WORST = 6
"""Sources of which pairs are tried: those with the largest residuals."""
_GAIN = 0.2
"""Gain of log-likelihood for each range above which a pair is named. Recordings with a right table: at most 0.01."""
_LESS = 0.8
"""RMS of the innovations over that with the table as written, below which a pair is named. True exchange of anchors
2 m apart: 0.6. Right tables with noise of 2 m and biases of 1 m: none of 40 drawn recordings."""
_NEAR = 0.5
"""Pairs with more than this part of the best gain are named, too: a layout may nearly be its own mirror image."""
_BAD = 3.0
"""Noise over that before the tuning, beyond which a solution fits badly."""

_LEARNING = 5.0
"""Log-likelihood that the first ranges lose for each state that they have to show."""


def fits_badly(model: RangeModel, settings: dict[str, float], smoothed: Smoothed) -> bool:
    """Whether ranges are less likely than with `_BAD` times the usual noise, or take as much wander to fit."""
    usual = model.settings()
    expected = -np.log(_BAD * usual["range_sigma"]) - 0.5 * (1.0 + np.log(2.0 * np.pi))
    least = expected * model.data.time.size - _LEARNING * model.size
    return bool(smoothed.filtered.likelihood < least or settings["wander_sigma"] > _BAD * usual["wander_sigma"] > 0.0)


def swapped_pairs(model: RangeModel, residual: np.ndarray) -> list[tuple[str, str]]:
    """Pairs of sources whose exchange makes the ranges clearly more likely, the best first; residual: RMS of each
    source (s,), m."""
    first, names = _first(model), model.log.sources.names
    heard = np.where(np.isnan(residual), 0.0, residual)  # a source whose ranges all are outliers has none
    worst = np.sort(np.argsort(heard)[-_WORST:])
    (before, rms), count = _judged(first), first.data.time.size
    judged = {(int(a), int(b)): _judged(_exchanged(first, a, b)) for a, b in combinations(worst, 2)}
    gains = {pair: likelihood - before for pair, (likelihood, left) in judged.items() if left < _LESS * rms}
    best = max(gains.values(), default=0.0)
    if not best > _GAIN * count:
        return []
    ordered = sorted(gains, key=lambda pair: -gains[pair])
    return [(names[a], names[b]) for a, b in ordered if gains[a, b] > _NEAR * best]


def _first(model: RangeModel) -> RangeModel:
    """The model of the first ranges."""
    log = {name: getattr(model.log, name)[:_RANGES] for name in ("time", "source", "range", "sigma", "signal")}
    return build_model(model.scenario, replace(model.log, **log))


def _exchanged(model: RangeModel, a: int, b: int) -> RangeModel:
    position = model.log.sources.position.copy()
    position[[a, b]] = position[[b, a]]
    return build_model(model.scenario, replace(model.log, sources=replace(model.log.sources, position=position)))


def _judged(model: RangeModel) -> tuple[float, float]:
    """Log-likelihood of a solution with the noise before the tuning, very low without a solution, and the RMS of its
    innovations, m."""
    try:
        filtered = find_start(model, model.settings())[1].filtered
    except np.linalg.LinAlgError:
        return -1e9 * model.data.time.size, np.inf
    found = float(filtered.likelihood)
    rms = float(np.sqrt(np.mean(filtered.innovation**2)))
    return (found, rms) if np.isfinite(found) else (-1e9 * model.data.time.size, np.inf)
