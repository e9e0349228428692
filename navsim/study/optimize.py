"""Where pseudolites should stand: search under constraints, how flat the optimum is, accuracy against number.

Free placements: differential evolution [1] (scipy's, whole populations at once through the geometry kernel), from
several independent starts and from the best place for one more beside the pseudolites found before; each is finished by
Nelder-Mead down to centimetres. Placements that break a rule rank behind all that keep them, by how much they
break it [2], so the answer keeps them all. A list of sites: every choice where there are few enough, else the best of
many greedy choices improved by exchanges.

Sources: [1] Storn & Price, J. Global Optimization 11 (1997). [2] Deb, An efficient constraint handling method for
genetic algorithms, Comput. Methods Appl. Mech. Engrg. 186 (2000).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from navsim.core.wgs84 import llh_from_ecef
from navsim.io.results import Result, Variable
from navsim.scenario.base import validated
from navsim.scenario.landing import Landing
from navsim.scenario.optimize import DOP_OBJECTIVES, Optimize
from navsim.scenario.source import Document, set_value
from navsim.simulation.geometry import Geometry, glide_geometry
from navsim.simulation.signals import Ground as Transmitters
from navsim.simulation.signals import build_signals
from navsim.study.landing import Case, covariance_analysis, covariance_summary, prepare
from navsim.study.landing.case import environment, glide_epochs
from navsim.study.placement import Rules, rules
from navsim.study.root import root_attributes
from navsim.study.sweep import describe, dop_outputs, filter_outputs

if TYPE_CHECKING:
    from scipy.optimize import Bounds

ALL_CHOICES = 2_000_000
"""Choices of sites up to which every one is tried for an objective of geometry; of a filter: ALL_FLOWN."""
ALL_FLOWN = 2_000
_BROKEN = 1e9
"""Objective of a placement that breaks a rule by nothing; more for worse."""
_UNSOLVED = 1e8
"""Objective of a placement that keeps the rules and leaves an epoch without a fix."""
_CHUNK = 65_536
BEARINGS = np.arange(0.0, 360.0, 45.0)
"""Directions in which the neighbourhood is explored, degrees from the landing direction, clockwise."""
LOSSES = (0.01, 0.05)
"""Losses of the objective that bound the neighbourhood."""
MAP_POINTS = 61


@dataclass(frozen=True)
class Problem:
    """An objective with its rules. value(places (n, k, 2)) -> (n,); smaller is better, all rules kept below 1e8."""

    study: Optimize
    scenario: Landing
    rules: Rules
    objective: Callable[[np.ndarray], np.ndarray]
    geometry: Geometry
    flown: bool

    def value(self, places: np.ndarray) -> np.ndarray:
        """What the search makes small: the objective where rules are kept, else how badly they are broken."""
        broken = self.rules.violation(places)
        out = np.where(broken > 0.0, _BROKEN * (1.0 + np.maximum(broken, 0.0)), np.nan)
        kept = broken <= 0.0
        if np.any(kept):
            values = self.objective(places[kept])
            out[kept] = np.where(np.isfinite(values), values, _UNSOLVED)
        return out

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """The corners of the area, (2,) least and largest s and l1."""
        assert self.study.area is not None
        low, high = np.array([self.study.area.s_m, self.study.area.l1_m]).T
        return low, high


def problem(study: Optimize, document: Document, base: Document) -> Problem:
    """The base scenario, the rules and the objective of a study. Raises InputError."""
    bare = base.copy()
    for key in ("count", "s_m", "l1_m", "sites"):
        if isinstance(bare.data.get("pseudolites"), dict):
            bare.data["pseudolites"].pop(key, None)
    set_value(bare, "pseudolites.count", 0, document.place(("base",)), document.folder)
    if study.objective not in DOP_OBJECTIVES:
        set_value(bare, "method", "covariance", document.place(("objective",)), document.folder)
    scenario = validated(Landing, bare)
    sources, scenario, _ = environment(scenario, bare)
    trajectory = scenario.trajectory()
    starts = np.array([scenario.epoch.timestamp()])
    if study.period is not None:
        starts = starts + np.arange(study.period.count) * study.period.hours * 3600.0 / study.period.count
    epochs, counted = glide_epochs(scenario, trajectory)
    geometry = glide_geometry(trajectory, sources, starts, epochs, counted)
    kept = rules(study, document, scenario, geometry.receiver[: counted.sum()])
    flown = study.objective not in DOP_OBJECTIVES
    if flown:
        objective = _flown_objective(study.objective, prepare(scenario, bare), kept)
    else:
        objective = _geometry_objective(study.objective, geometry, kept)
    study = study.model_copy(update={"constraints": kept.given})
    return Problem(study, scenario, kept, objective, geometry, flown)


def _geometry_objective(name: str, geometry: Geometry, kept: Rules) -> Callable[[np.ndarray], np.ndarray]:
    row = {"p": 0, "h": 1, "v": 2}
    which = 2 if name.endswith("_max") else 0

    def objective(places: np.ndarray) -> np.ndarray:
        sites = kept.ground.ecef(places)
        if name.startswith("fix_"):
            values, lost = geometry.fix_sigmas(sites)
            out = values[1 if name == "fix_horizontal" else 2, 0]
        else:
            values, lost = geometry.dops(sites)
            out = values[row[name[0]], which]
        return np.where(lost == 0, out, np.inf)

    return objective


def _flown_objective(name: str, case: Case, kept: Rules) -> Callable[[np.ndarray], np.ndarray]:
    """An error of the filter, by linear covariance analysis of each placement."""
    motion = case.trajectory.motion(case.world.signals.time)
    utc = case.scenario.epoch.timestamp()

    def one(places: np.ndarray) -> float:
        names = tuple(f"PL{i}" for i in range(1, len(places) + 1))
        ground: Transmitters = replace(case.ground, names=names, llh=llh_from_ecef(kept.ground.ecef(places)))
        sources = replace(case.environment, ground=ground)
        world = replace(case.world, signals=build_signals(motion, utc, sources))
        here = replace(case, environment=sources, world=world)
        return filter_outputs(covariance_summary(here, covariance_analysis(here)))[name]

    return lambda places: np.array([one(p) for p in places])


@dataclass(frozen=True)
class Found:
    """The best placement of one number of pseudolites. places: (k, 2) s and l1, m. neighbourhood: (k, 2, 8) how far
    each may be moved by itself, by LOSSES and BEARINGS, m; nan where the area or a rule ends it first."""

    places: np.ndarray
    value: float
    evaluations: int
    every: bool
    neighbourhood: np.ndarray


def search(here: Problem, seed: int, done: Callable[[int], None] = lambda _: None) -> dict[int, Found]:
    """The best placement for every number of pseudolites the study asks for."""
    out: dict[int, Found] = {}
    earlier: np.ndarray | None = None
    for number, count in enumerate(sorted(here.study.pseudolites), 1):
        if here.study.sites:
            places, value, evaluations, every = _choose(here, count, seed)
        else:
            places, value, evaluations = _place(here, count, seed, earlier)
            every = False
        if value >= _UNSOLVED:
            reason = "breaks a rule" if value >= _BROKEN else "leaves epochs of the glide without a fix"
            raise NoPlacement(f"{count} pseudolite(s): every placement tried {reason}")
        earlier = places
        out[count] = Found(places, value, evaluations, every, _neighbourhood(here, places, value))
        done(number)
    return out


class NoPlacement(Exception):
    """The constraints leave no place, or no placement gives a fix at every epoch."""


def _place(here: Problem, count: int, seed: int, earlier: np.ndarray | None) -> tuple[np.ndarray, float, int]:
    from scipy.optimize import Bounds, differential_evolution

    evaluations = 0

    def values(x: np.ndarray, /) -> np.ndarray:
        """Of a whole population, (2 count, n)."""
        nonlocal evaluations
        evaluations += x.shape[1]
        return here.value(x.T.reshape(-1, count, 2))

    def value(x: np.ndarray) -> float:
        return float(values(x[:, None])[0])

    low, high = here.limits()
    bounds = Bounds(np.tile(low, count), np.tile(high, count))
    candidates: list[np.ndarray] = []
    for start in range(here.study.effort):
        rng = np.random.default_rng([seed, count, start])
        candidates.append(
            differential_evolution(
                values,  # type: ignore[arg-type]  # vectorized: a population at once
                bounds, popsize=6 if here.flown else 30, maxiter=20 if here.flown else 400, tol=1e-7,
                mutation=(0.4, 0.9), recombination=0.8, vectorized=True, updating="deferred", polish=False, rng=rng,
                init="sobol",
            ).x
        )  # fmt: skip
    if earlier is not None and len(earlier) < count:
        candidates.append(_one_more(here, count, earlier, seed))
    best, lowest = candidates[0], math.inf
    for candidate in candidates:
        x, reached = _finish(value, candidate, bounds, 25 if here.flown else 200)
        if reached < lowest:
            best, lowest = x, reached
    return best.reshape(count, 2), lowest, evaluations


def _one_more(here: Problem, count: int, earlier: np.ndarray, seed: int) -> np.ndarray:
    """The placement found for fewer, with the best of many random places added one at a time."""
    rng = np.random.default_rng([seed, count, 1000])
    low, high = here.limits()
    places = earlier
    while len(places) < count:
        tries = rng.uniform(low, high, (40 if here.flown else 4000, 2))
        whole = np.concatenate([np.broadcast_to(places, (len(tries), *places.shape)), tries[:, None]], axis=1)
        values = here.value(whole)
        places = whole[int(np.argmin(values))]
    return places.ravel()


def _finish(
    value: Callable[[np.ndarray], float], start: np.ndarray, bounds: Bounds, tries: int
) -> tuple[np.ndarray, float]:
    """Nelder-Mead from simplices of 100, 10 and 1 m, down to a centimetre; at most `tries` a coordinate and simplex."""
    from scipy.optimize import minimize

    x = np.asarray(start, dtype=float)
    low, high = bounds.lb, bounds.ub
    lowest = value(x)
    for size in (100.0, 10.0, 1.0):
        steps = np.where(x + size > high, -size, size)
        simplex = np.vstack([x, np.clip(x + np.diag(steps), low, high)])
        found = minimize(
            value, x, method="Nelder-Mead", bounds=bounds,
            options={"initial_simplex": simplex, "xatol": 1e-2, "fatol": 1e-9, "maxfev": tries * x.size,
                     "adaptive": True},
        )  # fmt: skip
        if found.fun < lowest:
            x, lowest = found.x, float(found.fun)
    return x, lowest


def _choose(here: Problem, count: int, seed: int) -> tuple[np.ndarray, float, int, bool]:
    """The best `count` of the study's sites."""
    sites = np.array([[site.s_m, site.l1_m] for site in here.study.sites])
    alone = here.rules.violation(sites[:, None]) <= 0.0
    usable = sites[alone]
    if len(usable) < count:
        raise NoPlacement(f"only {len(usable)} of {len(sites)} sites keep the constraints, {count} are wanted")
    if math.comb(len(usable), count) <= (ALL_FLOWN if here.flown else ALL_CHOICES):
        choices = itertools.combinations(range(len(usable)), count)
        best, lowest, evaluations = usable[:count], math.inf, 0
        while chunk := list(itertools.islice(choices, _CHUNK)):
            places = usable[np.array(chunk)]
            values = here.value(places)
            evaluations += len(values)
            i = int(np.argmin(values))
            if values[i] < lowest:
                best, lowest = places[i], float(values[i])
        return best, lowest, evaluations, True
    best, lowest, evaluations = usable[:count], math.inf, 0

    def fill(others: list[int]) -> tuple[list[int], float]:
        """The best site beside the others, and the value with it."""
        nonlocal evaluations
        free = [i for i in range(len(usable)) if i not in others]
        values = here.value(usable[np.array([[*others, i] for i in free])])
        evaluations += len(free)
        i = int(np.argmin(values))
        return [*others, free[i]], float(values[i])

    rng = np.random.default_rng([seed, count])
    for start in range(5 * here.study.effort):
        chosen = [] if start == 0 else [int(i) for i in rng.choice(len(usable), count - 1, replace=False)]
        value = math.inf
        while len(chosen) < count:
            chosen, value = fill(chosen)
        improved = True
        while improved:
            improved = False
            for slot in range(count):
                other, reached = fill([c for i, c in enumerate(chosen) if i != slot])
                if reached < value * (1.0 - 1e-12):
                    chosen, value, improved = other, reached, True
        if value < lowest:
            best, lowest = usable[np.array(chosen)], value
    return best, lowest, evaluations, False


def _neighbourhood(here: Problem, places: np.ndarray, value: float) -> np.ndarray:
    """How far each pseudolite may be moved before the objective worsens by LOSSES, (k, 2, 8) m."""
    reach = np.geomspace(1.0, 3000.0, 12 if here.flown else 160)
    out = np.full((len(places), len(LOSSES), BEARINGS.size), np.nan)
    for k in range(len(places)):
        for b, bearing in enumerate(np.radians(BEARINGS)):
            moved = np.repeat(places[None], reach.size, axis=0)
            # s is right of landing, l1 against it
            moved[:, k, 0] += reach * np.sin(bearing)
            moved[:, k, 1] -= reach * np.cos(bearing)
            inside = np.full(reach.size, True)
            if here.study.area is not None:
                for axis, (low, high) in enumerate((here.study.area.s_m, here.study.area.l1_m)):
                    inside &= (moved[:, k, axis] >= low) & (moved[:, k, axis] <= high)
            usable = inside & (here.rules.violation(moved) <= 0.0)
            blocked = int(np.argmin(usable)) if not usable.all() else reach.size
            values = here.objective(moved[:blocked]) if blocked else np.empty(0)
            for i, loss in enumerate(LOSSES):
                worse = np.flatnonzero(values > value * (1.0 + loss))
                if worse.size:
                    out[k, i, b] = reach[worse[0]]
    return out


def objective_map(here: Problem, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The objective with the first pseudolite moved over the area: s (a,), l1 (b,), values (a, b), nan where a rule
    is broken."""
    area = here.study.area
    sites = np.array([[site.s_m, site.l1_m] for site in here.study.sites]) if area is None else np.array(
        [[area.s_m[i], area.l1_m[i]] for i in range(2)]
    )  # fmt: skip
    (s0, l0), (s1, l1) = sites.min(axis=0), sites.max(axis=0)
    points = 9 if here.flown else MAP_POINTS
    s, along = np.linspace(s0, s1, points), np.linspace(l0, l1, points)
    moved = np.repeat(places[None], points * points, axis=0)
    moved[:, 0] = np.stack(np.meshgrid(s, along, indexing="ij"), axis=-1).reshape(-1, 2)
    values = here.value(moved)
    return s, along, np.where(values < _UNSOLVED, values, np.nan).reshape(points, points)


def optimize_result(here: Problem, found: dict[int, Found], seed: int) -> Result:
    """The optima, their neighbourhoods and the front as a result tree of kind optimize."""
    study = here.study
    counts = sorted(found)
    most = max(counts)
    v: dict[str, Variable] = {}
    v["/pseudolites"] = Variable(("pseudolites",), np.array(counts), "1", "number of pseudolites")
    v["/pseudolite"] = Variable(("pseudolite",), np.arange(1, most + 1), "1", "pseudolite of a placement")
    v["/bearing"] = Variable(("bearing",), BEARINGS, "deg", "direction from the landing direction, clockwise")
    v["/loss"] = Variable(("loss",), np.array(LOSSES), "1", "relative loss of the objective")
    unit, meaning = describe(study.objective)
    none = here.objective(np.empty((1, 0, 2)))[0]
    values = np.array([found[c].value for c in counts])
    v["/front/objective"] = Variable(("pseudolites",), values, unit, meaning, {"without_pseudolites": float(none)})
    v["/front/evaluations"] = Variable(
        ("pseudolites",), np.array([found[c].evaluations for c in counts]), "1", "placements tried"
    )
    v["/front/every_choice"] = Variable(
        ("pseudolites",), np.array([found[c].every for c in counts]).astype(np.int8), "1", "1: every choice was tried"
    )
    places = np.full((len(counts), most, 2), np.nan)
    llh = np.full((len(counts), most, 3), np.nan)
    around = np.full((len(counts), most, len(LOSSES), BEARINGS.size), np.nan)
    margin = np.empty(len(counts))
    for i, count in enumerate(counts):
        best = found[count]
        places[i, :count] = best.places
        llh[i, :count] = llh_from_ecef(here.rules.ground.ecef(best.places))
        around[i, :count] = best.neighbourhood
        margin[i] = here.rules.violation(best.places[None])[0]
    for axis, (name, text) in enumerate((("s", "right of the runway's axis"), ("l1", "before the threshold"))):
        v[f"/optimum/{name}"] = Variable(("pseudolites", "pseudolite"), places[..., axis], "m", text)
    for axis, (name, u) in enumerate((("latitude", "rad"), ("longitude", "rad"), ("height", "m"))):
        v[f"/optimum/{name}"] = Variable(("pseudolites", "pseudolite"), llh[..., axis], u, f"WGS-84 {name}")
    v["/optimum/neighbourhood"] = Variable(
        ("pseudolites", "pseudolite", "loss", "bearing"), around, "m",
        "how far a pseudolite may be moved by itself; nan where the area or a rule ends it first",
    )  # fmt: skip
    v["/optimum/violation"] = Variable(
        ("pseudolites",), margin, "m", "by how much the tightest rule is broken; negative: room left"
    )
    others = [dop_outputs(here.geometry, here.rules.ground.ecef(found[c].places)[None]) for c in counts]
    for name in others[0]:
        u, text = describe(name)
        v[f"/optimum/{name}"] = Variable(("pseudolites",), np.array([o[name][0] for o in others]), u, text)
    maps = [objective_map(here, found[c].places) for c in counts]
    v["/map/s"] = Variable(("s",), maps[0][0], "m", "right of the runway's axis")
    v["/map/l1"] = Variable(("l1",), maps[0][1], "m", "before the threshold")
    v["/map/objective"] = Variable(
        ("pseudolites", "s", "l1"), np.stack([m[2] for m in maps]), unit,
        f"{meaning}, the first pseudolite moved, the others kept; nan where a rule is broken",
    )  # fmt: skip
    attributes = root_attributes("optimize", seed, here.scenario, study=study, objective=study.objective)
    return Result(attributes, v)
