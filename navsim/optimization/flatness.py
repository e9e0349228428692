"""How flat an optimum is: how far each source may move, and a map of the objective with the first one moved."""

from __future__ import annotations

import numpy as np

from navsim.optimization.best_placement import Found
from navsim.optimization.evaluator import Evaluator
from navsim.optimization.placement import ObjectiveFunction
from navsim.optimization.problem import (
    PENALTY_CONSTRAINT,
    PENALTY_REQUIREMENT,
    PENALTY_UNSOLVED,
    PlacementProblem,
    penalised,
)

BEARINGS = np.arange(0.0, 360.0, 45.0)
"""Directions in which the neighbourhood is explored, degrees from the landing direction, clockwise."""
LOSSES = (0.01, 0.05)
"""Losses of the objective that bound the neighbourhood."""
MAP_POINTS = 61
ANALYSED_MAP_POINTS, WATCHED_MAP_POINTS = 9, 17
_REACH = np.geomspace(1.0, 3000.0, 160)
"""Distances tried in the neighbourhood, m; where placements are analysed every doubling, and between by its curve."""
_ANALYSED_REACH = 32.0 * 2.0 ** np.arange(-5, 7)
_ANALYSED_FIRST = 5
"""Index of the first distance of the search outwards or inwards."""


def reaches(problem: PlacementProblem) -> int:
    """Most distances tried in a direction."""
    return _ANALYSED_REACH.size if problem.analysed else _REACH.size


def _judged(problem: PlacementProblem, best: Found, trials: Evaluator) -> ObjectiveFunction:
    """Evaluator for neighbourhoods: the objective, or the coarse analysis scaled to be right at the best.

    inf without a solution or if requirements are not met.
    """
    if problem.coarse is None:
        return trials.at_once
    there = trials.coarse(best.places[None])
    scale = best.value / float(there.objective[0])
    heavier = best.load / float(there.load[0]) if problem.requirements is not None else 1.0

    def judge(places: np.ndarray) -> np.ndarray:
        found = trials.coarse(places)
        values = penalised(scale * found.objective, heavier * found.load)
        return np.where((found.value < PENALTY_CONSTRAINT) & (values < PENALTY_REQUIREMENT), values, np.inf)

    return judge


def neighbourhood(problem: PlacementProblem, best: Found, trials: Evaluator) -> np.ndarray:
    """Distance that each pseudolite may be moved alone before the objective worsens, by LOSSES and BEARINGS (k, 2, 8),
    m.

    Missed requirements end it, too. nan where the area or a rule ends it first, and if requirements were never met.
    """
    if not best.met:
        return np.full((len(best.places), len(LOSSES), BEARINGS.size), np.nan)
    judge = _judged(problem, best, trials)
    reach = _ANALYSED_REACH if problem.analysed else _REACH
    out = np.full((len(best.places), len(LOSSES), BEARINGS.size), np.nan)
    for k in range(len(best.places)):
        for b, bearing in enumerate(np.radians(BEARINGS)):
            moved = np.repeat(best.places[None], reach.size, axis=0)
            # s is right of landing, l1 against it
            moved[:, k, 0] += reach * np.sin(bearing)
            moved[:, k, 1] -= reach * np.cos(bearing)
            inside = np.full(reach.size, True)
            if problem.study.area is not None:
                (low, high), level = problem.limits(), moved[:, k, :2]
                inside = np.all((level >= low[:2]) & (level <= high[:2]), axis=1)
            usable = inside & (problem.rules.violation(moved) <= 0.0)
            blocked = int(np.argmin(usable)) if not usable.all() else reach.size
            if not blocked:
                continue
            if problem.analysed:
                out[k, :, b] = _reached(judge, moved[:blocked], reach, best.value)
                continue
            values = judge(moved[:blocked])
            for i, loss in enumerate(LOSSES):
                worse = np.flatnonzero(values > best.value * (1.0 + loss))
                if worse.size:
                    out[k, i, b] = reach[worse[0]]
    return out


def _reached(judge: ObjectiveFunction, moved: np.ndarray, reach: np.ndarray, value: float) -> np.ndarray:
    """Distances (2,) at which LOSSES are reached outwards through `moved` (n, k, 2), nan if they are not.

    From the middle outwards until the larger loss is exceeded, inwards until the smaller is not. Between two distances
    the loss is taken as a power of the distance, as near an optimum.
    """
    losses: dict[int, float] = {}

    def loss(i: int) -> float:
        if i not in losses:
            losses[i] = float(judge(moved[i : i + 1])[0]) / value - 1.0
        return losses[i]

    first = min(_ANALYSED_FIRST, len(moved) - 1)
    inward = first
    while loss(inward) > LOSSES[0] and inward > 0:
        inward -= 1
    outward = first
    while loss(outward) <= LOSSES[-1] and outward < len(moved) - 1:
        outward += 1
    out = np.full(len(LOSSES), np.nan)
    for j, wanted in enumerate(LOSSES):
        beyond = [i for i in range(inward, outward + 1) if loss(i) > wanted]
        if not beyond:
            continue
        i = beyond[0]
        if not np.isfinite(loss(i)):  # a cliff: the largest distance known to be on this side of it
            out[j] = reach[i - 1] if i else 0.0
            continue
        if i == 0 or loss(i - 1) <= 0.0:
            out[j] = reach[i]
            continue
        power = np.log(loss(i) / loss(i - 1)) / np.log(reach[i] / reach[i - 1])
        out[j] = reach[i] * (wanted / loss(i)) ** (1.0 / power)
    return out


def map_points(problem: PlacementProblem) -> int:
    """Along each axis of a map."""
    return MAP_POINTS if not problem.analysed else WATCHED_MAP_POINTS if problem.quick else ANALYSED_MAP_POINTS


def map_axes(problem: PlacementProblem) -> tuple[np.ndarray, np.ndarray]:
    """The axes of maps of the objective: s (a,), l1 (b,), m."""
    low, high = problem.limits()
    points = map_points(problem)
    return np.linspace(low[0], high[0], points), np.linspace(low[1], high[1], points)


def objective_map(problem: PlacementProblem, best: Found, trials: Evaluator) -> np.ndarray:
    """The objective with the first pseudolite moved over the area (a, b), nan where a rule is broken, or
    requirements are not met."""
    s, l1 = map_axes(problem)
    moved = np.repeat(best.places[None], s.size * l1.size, axis=0)
    moved[:, 0, :2] = np.stack(np.meshgrid(s, l1, indexing="ij"), axis=-1).reshape(-1, 2)
    if not best.met:
        return np.full((s.size, l1.size), np.nan)
    values = _judged(problem, best, trials)(moved)
    return np.where(values < PENALTY_UNSOLVED, values, np.nan).reshape(s.size, l1.size)


def visible_share(problem: PlacementProblem, s: np.ndarray, l1: np.ndarray) -> np.ndarray:
    """Share of the glide's fixes (a, b) that see an antenna of the least height there is at places s (a,), l1 (b,)."""
    places = np.stack(np.meshgrid(s, l1, indexing="ij"), axis=-1).reshape(-1, 2)
    if problem.coordinates == 3:
        places = np.column_stack([places, np.full(len(places), problem.limits()[0][2])])
    return problem.geometry.visible_share(problem.rules.plane.ecef(places)).reshape(s.size, l1.size)
