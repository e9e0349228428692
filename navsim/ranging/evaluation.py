"""Statistics of recorded ranges: innovations by source, dilution of precision, errors against a reference."""

from __future__ import annotations

import numpy as np

from navsim.ranging.estimate import Filtered, Smoothed
from navsim.ranging.model import RangeModel
from navsim.ranging.recording import ReferenceTrack
from navsim.statistics import chi_square
from navsim.statistics.consistency import effective_count

NOT_SEEN = 0.9
"""Sigma of a state over its sigma at the start from which on the ranges show nothing of it."""
_CLIPPED = 4.0
"""Sigmas to which innovations are clipped before they are correlated."""
TRUE_SIGMA, FALSE_VERDICT = (0.8, 1.25), 0.001
"""Root mean square of error over sigma between which a sigma is true, and the probability that a sigma at the
upper limit is called too small."""
_MOST_ERRORS = 5000
"""Errors whose correlation is looked at; of more, one in several."""
_OFFSETS = (1.0, 0.05, 0.005)
"""Largest time offset that is searched, and the steps of the two searches, s."""


def source_statistics(
    source: np.ndarray, count: int, residual: np.ndarray, filtered: Filtered
) -> dict[str, np.ndarray]:
    """Numbers of ranges and outliers, and RMS of the residuals, normalised innovation squared and lag-1 autocorrelation
    of the innovations of the others, for each source."""
    usual = filtered.weight > 0.5
    unit = filtered.innovation / np.sqrt(filtered.variance)
    out: dict[str, list[float]] = {name: [] for name in ("ranges", "outliers", "residual_rms", "nis", "lag1")}
    for i in range(count):
        all_of_it = source == i
        kept = all_of_it & usual
        out["ranges"].append(int(all_of_it.sum()))
        out["outliers"].append(int(np.sum(all_of_it & ~usual)))
        out["residual_rms"].append(float(np.sqrt(np.mean(residual[kept] ** 2))) if kept.any() else np.nan)
        out["nis"].append(float(np.mean(unit[kept] ** 2)) if kept.any() else np.nan)
        e = np.clip(unit[kept], -_CLIPPED, _CLIPPED)
        varies = e.size > 2 and float(np.std(e)) > 0.0
        out["lag1"].append(float(np.mean(e[1:] * e[:-1]) / np.mean(e**2)) if varies else np.nan)
    return {name: np.array(values) for name, values in out.items()}


def unobserved_states(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Which states (n,) the ranges do not show, by their variances at the start and at the end."""
    return after >= NOT_SEEN**2 * before


def dilution(position: np.ndarray, sources: np.ndarray, two_way: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position, horizontal and vertical dilution of precision (t,) of all sources at positions (t, 3); two_way: without
    a clock. inf where the geometry is singular."""
    away = position[:, None] - sources[None]
    h = away / np.maximum(np.linalg.norm(away, axis=2), 1e-9)[..., None]
    if not two_way:
        h = np.concatenate([h, np.ones((*h.shape[:2], 1))], axis=2)
    normal = np.einsum("tsi,tsj->tij", h, h)
    eigenvalues = np.linalg.eigvalsh(normal)
    regular = eigenvalues[:, 0] > 1e-12 * eigenvalues[:, -1]
    q = np.full(normal.shape, np.inf)
    q[regular] = np.linalg.inv(normal[regular])
    d = np.einsum("tii->ti", q)
    return np.sqrt(d[:, :3].sum(axis=1)), np.sqrt(d[:, 0] + d[:, 1]), np.sqrt(d[:, 2])


def find_time_offset(track: ReferenceTrack, model: RangeModel, smoothed: Smoothed) -> float:
    """Offset of the reference's times, s, at which the ranges fit it best (least median absolute deviation)."""
    data = model.data
    errors = slice(3, model.size)
    bare = data.range - np.einsum("mi,mi->m", data.row[:, errors], smoothed.state[:, errors])

    def spread(offset: float) -> float:
        e = bare - np.linalg.norm(track.at(data.time - offset) - data.position[data.source], axis=1)
        e = e[np.isfinite(e)]
        return float(np.median(np.abs(e - np.median(e)))) if e.size else np.inf

    largest, coarse, fine = _OFFSETS
    best = min(np.arange(-largest, largest + 0.5 * coarse, coarse), key=spread)
    return float(min(best + np.arange(-coarse, coarse + 0.5 * fine, fine), key=spread))


def errors_against(
    true: np.ndarray, state: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Root mean square error (3,) and mean error (3,), m, and errors over sigma (k, 3) at the k times at which true
    (t, 3) is known."""
    known = np.isfinite(true).all(axis=1)
    error = state[known, :3] - true[known]
    sigma = np.sqrt(np.einsum("tii->ti", covariance[known, :3, :3]))
    return np.sqrt(np.mean(error**2, axis=0)), error.mean(axis=0), error / sigma


def sigma_too_small(unit: np.ndarray) -> bool:
    """Whether errors over sigma (k, n), in order of time, exceed `TRUE_SIGMA` by more than their number explains.

    Of errors that last for as long as the recording, chance alone makes one in a hundred such.
    """
    count = effective_count(np.abs(unit[:: 1 + len(unit) // _MOST_ERRORS]))
    by_chance = chi_square.quantile(1.0 - FALSE_VERDICT, count) / count
    return bool(np.mean(unit**2) > TRUE_SIGMA[1] ** 2 * by_chance)
