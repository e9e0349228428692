"""Two sources whose positions are exchanged in the table: exchanged back, they fit the ranges far better.

Looked for only where the tuned solution fits badly, since each pair costs the search for a start. All are judged by the
noise before the tuning, which a wrong table would enlarge.
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
    worst = np.sort(np.argsort(np.nan_to_num(residual))[-_WORST:])
    before, count = _likelihood(first), first.data.time.size
    gains = {(int(a), int(b)): _likelihood(_exchanged(first, a, b)) - before for a, b in combinations(worst, 2)}
    best = max(gains.values())
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


def _likelihood(model: RangeModel) -> float:
    """Log-likelihood of a solution with the noise before the tuning; very low without a solution."""
    try:
        found = float(find_start(model, model.settings())[1].filtered.likelihood)
    except np.linalg.LinAlgError:
        found = np.nan
    return found if np.isfinite(found) else -1e9 * model.data.time.size
