"""Where the filter starts: least squares of the first ranges from many guesses, and the mirror image of a solution.

Ranges from sources that lie nearly in a plane fit a position and its image on the other side nearly alike. So the start
that is kept is the one whose ranges, all of them, are most likely; among those that are as likely, the higher one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from navsim.gnss.ranging_geometry import Plane, plane_of
from navsim.ranging.estimate import Smoothed, StartState, relinearise
from navsim.ranging.model import RangeModel
from navsim.ranging.scenario import RECEIVER

WINDOW = 2.0
"""Length of the first stretch, s, whose ranges give the start; longer where not every source is heard in it."""
HEIGHTS = (0.0, 0.1, -0.1, 0.2, -0.2, 0.35, -0.35, 0.6, -0.6)
"""Heights above the middle of the sources that are tried, over the size of the layout."""
CANDIDATES = 2
"""Number of solutions at a constant height from which the height is set free."""
UNLIKELY = 9.0
"""Squared misfit above the best, in sigmas, beyond which a least squares solution is no start."""
_UPRIGHT = 0.5
"""Upward component of the normal of the sources' plane above which solutions above it are preferred."""
_LEVEL = 1e-3
"""1 sigma of the height, m, while it is held."""
AS_LIKELY = 3.0
"""Difference of log-likelihood below which two solutions are as likely as each other."""
_NOISE = 0.5
"""1 sigma of a range in the search for a start, m, beside what the clocks add."""
_ROUNDS = (3, 10)
"""Linearisations with all ranges for each start that is tried: with the height held, and free."""


def find_start(model: RangeModel, settings: dict[str, float]) -> tuple[StartState, Smoothed]:
    """The start whose ranges are most likely, and the smoothed solution from there."""
    given = model.scenario.motion.start
    if given is not None:
        start = StartState(np.array(given.position_m), given.sigma_m, _clock(model, np.array(given.position_m)))
        return start, relinearise(model, settings, start)
    levels = []
    for start in candidates(model):
        level = settings | {"vertical_noise": 0.0}
        levels.append(
            (
                start,
                relinearise(model, level, replace(start, sigma=(start.sigma[0], _LEVEL)), rounds=_ROUNDS[0], wide=True),
            )
        )
    levels.sort(key=lambda pair: -pair[1].filtered.likelihood)
    tried = [
        (start, relinearise(model, settings, start, solution, _ROUNDS[1], wide=True))
        for start, solution in levels[:CANDIDATES]
    ]
    tried = [pair for pair in tried if np.isfinite(pair[1].filtered.likelihood)] or tried[:1]
    best = max(one.filtered.likelihood for _, one in tried)
    near = [pair for pair in tried if pair[1].filtered.likelihood > best - AS_LIKELY]
    return max(near or tried, key=lambda pair: float(np.median(pair[1].state[:, 2])))


def candidates(model: RangeModel) -> list[StartState]:
    """Starts by least squares of the first ranges, the best first."""
    data = model.data
    within = data.time <= data.time[0] + WINDOW
    heard = np.unique(data.source)
    if np.unique(data.source[within]).size < heard.size:
        first = [data.time[data.source == i][0] for i in heard]
        within = data.time <= max(first)
    middle = {int(i): float(np.median(data.range[within & (data.source == i)])) for i in np.unique(data.source[within])}
    at, r = data.position[list(middle)], np.array(list(middle.values()))
    one_way = not model.has_no_clock
    noise = np.hypot(_NOISE, model.scenario.clocks.offset_sigma_m) if one_way else _NOISE
    scale = max(float(np.linalg.norm(at - at.mean(axis=0), axis=1).max()), 0.0 if one_way else float(np.median(r)))
    out: list[StartState] = []
    heights: tuple[float, ...] = HEIGHTS if model.scenario.motion.height == "free" else HEIGHTS[:1]
    plane = plane_of(model.log.sources.position)
    if plane.is_flat and plane.normal[2] > _UPRIGHT:
        heights = tuple(height for height in heights if height >= 0.0)
    for height in heights:
        found: list[tuple[float, StartState]] = []
        for angle in np.arange(8) * np.pi / 4.0:
            guess = at.mean(axis=0) + scale * np.array([0.7 * np.cos(angle), 0.7 * np.sin(angle), height])
            cost, start = _least_squares(at, r, guess, noise, one_way)
            if all(np.linalg.norm(start.position - other.position) > 0.02 * scale for _, other in found):
                found.append((cost, replace(start, sigma=(start.sigma[0], 0.3 * scale))))
        found.sort(key=lambda pair: pair[0])
        out += [start for cost, start in found[:2] if cost < found[0][0] + UNLIKELY]
    return out


def _least_squares(
    at: np.ndarray, r: np.ndarray, guess: np.ndarray, noise: float, one_way: bool
) -> tuple[float, StartState]:
    """Cost and start at the height of a guess, by Levenberg and Marquardt's steps."""
    x = np.array([guess[0], guess[1], float(np.median(r - np.linalg.norm(at - guess, axis=1))) if one_way else 0.0])

    def distance(y: np.ndarray) -> np.ndarray:
        return np.maximum(np.linalg.norm(np.array([y[0], y[1], guess[2]]) - at, axis=1), 1e-6)

    def chi_square(y: np.ndarray) -> float:
        return float(np.sum((r - distance(y) - y[2]) ** 2)) / noise**2

    damping, cost = 1e-3, chi_square(x)
    prior = np.diag([1e-12, 1e-12, 1e-12 if one_way else 1e12])
    normal = prior
    for _ in range(50):
        h = np.column_stack([(x[:2] - at[:, :2]) / distance(x)[:, None], np.ones(r.size)])
        normal = h.T @ h / noise**2 + prior
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), h.T @ (r - distance(x) - x[2]) / noise**2)
        new = chi_square(x + step)
        if new < cost:
            x, gain, cost, damping = x + step, cost - new, new, max(0.2 * damping, 1e-9)
            if gain < 1e-6 * (1.0 + cost):
                break
        else:
            damping *= 10.0
            if damping > 1e9:
                break
    spread = float(np.sqrt(np.abs(np.diag(np.linalg.inv(normal))[:2]).max()))
    sigma = float(np.clip(3.0 * spread, 1.0, 1e5))
    return cost, StartState(np.array([x[0], x[1], guess[2]]), (sigma, 1.0), float(x[2]) if one_way else 0.0)


def _clock(model: RangeModel, position: np.ndarray) -> float:
    """Offset of the receiver's clock at a known start, m."""
    if RECEIVER not in model.clocks:
        return 0.0
    data = model.data
    first = data.time <= data.time[0] + WINDOW
    distance = np.linalg.norm(position - data.position[data.source[first]], axis=1)
    return float(np.median(data.range[first] - distance))


def mirror_solution(
    model: RangeModel, settings: dict[str, float], start: StartState, found: Smoothed
) -> tuple[Plane, Smoothed | None]:
    """The solution on the other side of the sources' plane, None if they are no plane or there is no such solution."""
    plane = plane_of(model.log.sources.position)
    if not plane.is_flat:
        return plane, None
    image = StartState(plane.mirrored(start.position), start.sigma, start.clock)
    first = Smoothed(
        np.concatenate([plane.mirrored(found.state[:, :3]), found.state[:, 3:]], axis=1), found.covariance, found.lines,
        found.filtered, 0.0, found.prior,
    )  # fmt: skip
    other = relinearise(model, settings, image, first)
    side = np.median(plane.distance(found.state[:, :3])), np.median(plane.distance(other.state[:, :3]))
    return plane, other if np.sign(side[0]) != np.sign(side[1]) else None
