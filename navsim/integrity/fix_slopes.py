"""Derivatives of a receiver's fixes by pseudoranges and range rates.

Source: Groves (2013), section 9.4.1 (the least-squares solution that is differentiated).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from navsim.geodesy.earth import E2, A, ecef_from_llh, ned_matrix
from navsim.gnss.pseudorange import Signals


def slopes(
    signals: Signals, ranges: np.ndarray, rates: np.ndarray, fixes: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of position and velocity fixes (e, 6) by each pseudorange and each range rate, (e, 6, s) each.

    ranges, rates: (e, s). fixes: llh, velocity and clocks of the receiver from them.

    A fix satisfies H' W r = 0 with the residuals r. Unit vectors in H rotate with the position, which matters if
    residuals are not small compared with the distance to a source. Zero for unused sources, and without a fix.
    """
    s = signals
    llh, velocity, clocks = fixes
    e, n = ranges.shape
    by_range, by_rate = np.zeros((e, 6, n)), np.zeros((e, 6, n))
    here = np.isfinite(ranges) & np.isfinite(llh[:, :1])
    # without a fix any axes serve: `here` is False, and their results are discarded
    c_ne = ned_matrix(np.where(np.isfinite(llh), llh, 0.0))
    way = np.where(here[:, :, None], (s.position - ecef_from_llh(llh)[:, None]) @ np.swapaxes(c_ne, 1, 2), 1.0)
    distance = np.linalg.norm(way, axis=2)
    u = way / distance[:, :, None]
    # effect of the position on -u, for each source (e, s, 3, 3)
    turning = (np.eye(3) - u[:, :, :, None] * u[:, :, None, :]) / distance[:, :, None, None]

    weight = np.where(here, s.fix_sigma, np.inf) ** -2.0
    kept = np.unique(s.time_scale)
    h = np.concatenate([-u, np.broadcast_to(s.time_scale[:, None] == kept, (e, n, kept.size))], axis=2)
    residual = np.where(here, ranges - distance - clocks[:, s.time_scale], 0.0)
    normal, weighed = _normal(h, weight)
    normal[:, :3, :3] -= np.einsum("es,esij->eij", weight * residual, turning)
    by_range[:, :3] = np.linalg.solve(normal, weighed)[:, :3]

    here &= np.isfinite(rates) & np.isfinite(velocity[:, :1])
    weight = np.where(here, s.fix_rate_sigma, np.inf) ** -2.0
    h = np.concatenate([-u, np.ones((e, n, 1))], axis=2)
    relative = np.where(here[:, :, None], s.velocity @ np.swapaxes(c_ne, 1, 2) - velocity[:, None], 0.0)
    residual = np.where(here, rates - np.sum(u * relative, axis=2), 0.0)
    # the clock's drift takes the mean
    total = weight.sum(axis=1, keepdims=True)
    residual -= np.sum(weight * residual, axis=1, keepdims=True) / np.where(total > 0.0, total, 1.0)
    normal, weighed = _normal(h, weight)
    by_rate[:, 3:] = np.linalg.solve(normal, weighed)[:, :3]
    by_place = weighed @ np.einsum("esi,esij->esj", relative, turning)
    by_place[:, :3] += np.einsum("es,esij->eij", weight * residual, turning)
    by_place = np.linalg.solve(normal, by_place)[:, :3]
    # and the axes that the velocity is given along turn with the place
    by_place += np.cross(velocity[:, :, None], _turn_of_axes(llh), axis=1)
    by_range[:, 3:] = np.where(np.isfinite(velocity[:, :1, None]), by_place, 0.0) @ by_range[:, :3]
    return by_range, by_rate


def _normal(h: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """H' W H (e, k, k), with a 1 for an unknown without a source, and H' W (e, k, s); h: (e, s, k), weight: (e, s)."""
    weighed = np.swapaxes(h, 1, 2) * weight[:, None, :]
    normal = weighed @ h
    unknown = np.arange(normal.shape[1])
    normal[:, unknown, unknown] += normal[:, unknown, unknown] == 0.0
    return normal, weighed


def _turn_of_axes(llh: np.ndarray) -> np.ndarray:
    """The turn of north, east, down along themselves, rad, by a step of 1 m along each (e, 3, 3); llh: (e, 3)."""
    w = 1.0 - E2 * np.sin(llh[:, 0]) ** 2
    transverse = A / np.sqrt(w)
    east = 1.0 / (transverse + llh[:, 2])
    out = np.zeros((llh.shape[0], 3, 3))
    out[:, 0, 1] = east
    out[:, 1, 0] = -1.0 / (transverse * (1.0 - E2) / w + llh[:, 2])
    out[:, 2, 1] = -east * np.tan(llh[:, 0])
    return out
