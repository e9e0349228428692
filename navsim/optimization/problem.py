"""Optimisation problem of placements: an objective and requirements.

The objective is a quantity of the geometry, a protection level, or an error of the filter. For a filter error, every
placement needs a linear covariance analysis; for a level, the monitor of its fixes. What does not depend on the
placement is computed once: the flight (until the objective is evaluated), the orbits, the sources that are ever
tracked. There are three fidelities, each much more expensive than the one before and closer to the truth [1]:

- screens: accuracy of fixes from the geometry kernel, over the last seconds before the objective is evaluated and over
  the glide.
- coarse: covariance analysis with one fix a second of the same information, inertial samples at 10 Hz; levels at some
  epochs of the glide.
- objective: covariance analysis, and levels, as for a single landing.

Requirements are evaluated as those of landings (`landing.requirements`). The load of a placement is the largest
utilisation among them. One with a load above 1 ranks behind all that meet them, by its load [2].

Source: [1] Peherstorfer, Willcox & Gunzburger, Survey of multifidelity methods in uncertainty propagation, inference,
and optimization, SIAM Review 60 (2018). [2] Deb, An efficient constraint handling method for genetic algorithms,
Comput. Methods Appl. Mech. Engrg. 186 (2000).
"""

from __future__ import annotations

import datetime
import itertools
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from navsim.environment.sources import environment, glide_epochs, touchdown_time
from navsim.gnss import timescales
from navsim.gnss.constellations.systems import CLOCKS
from navsim.gnss.events import BEACONS
from navsim.gnss.signals import SignalScenario
from navsim.landing.beacons import BeaconGlide
from navsim.landing.confirmation import Errors, Fly, OfRuns, filter_outputs, fly_case, of_runs
from navsim.landing.plausibility import plausibility_warnings
from navsim.landing.preflight import FOLLOW, lone_pseudolite_warning
from navsim.optimization.costs import Member
from navsim.optimization.placement import ObjectiveFunction, Rules, RunwayPlane, rules
from navsim.optimization.scenario import (
    BEACON_DISTANCE,
    BEACON_OBJECTIVES,
    DOP_OBJECTIVES,
    FILTER_DISTANCE,
    LEVEL_OBJECTIVES,
    Optimize,
)
from navsim.results.findings import Finding
from navsim.results.schema import HEIGHTS, LARGE, MET, MOST_LEVELS, RMS_WINDOW
from navsim.runner.executor import threads
from navsim.scenario.analysable import check_analysable
from navsim.scenario.landing import Landing
from navsim.scenario.requirements import ErrorRequirement, RmsRequirement, singles
from navsim.scenario_files.base import KeyedError, validated
from navsim.scenario_files.source import Document, InputError, KeyPath, Problem, dotted, set_value
from navsim.simulation.placement_geometry import Geometry, glide_geometry
from navsim.sweeps.scenario import FILTER_OUTPUTS

if TYPE_CHECKING:
    from navsim.landing.case import Ask, Case
    from navsim.landing.requirements import RequirementValue
    from navsim.optimization.analyses import BeaconFlight, FidelityEvaluator, LevelScreen, Prepared

PENALTY_CONSTRAINT = 1e9
"""Objective of a placement that breaks a rule by nothing; more for worse."""
PENALTY_UNSOLVED = 1e8
"""Objective of a placement that keeps the rules and leaves an epoch without a fix, or without a level that is the
objective."""
PENALTY_REQUIREMENT = 1e7
"""Objective of a placement that misses the requirements by nothing; up to twice that for worse."""
_LEVELLESS = 1e3
"""Load of a placement that no size would save, since levels are lacking at too many epochs; up to three times that."""
_TRACK, _TRACK_MARGIN = 12.0, 0.3
"""Spacing of the points of the approach that rough rules ask, m, and their margin: 60 m from the aircraft, the nearest
point is by no more than that nearer than the nearest of those asked."""
_STRETCHES = (30.0, 15.0, 5.0)
"""Limits of the stretches of the glide that describe its geometry, s before the objective is evaluated."""
_ALIKE = 5
"""Number of stretches if only levels are analysed."""
_NO_FIX = 1e4
"""Value of an epoch without a fix in rankings of placements by geometry, m."""


class Evaluated(NamedTuple):
    """Evaluation of placements (n,).

    value: minimised by a search; objective: nan if a rule is violated; load of the requirements: 0 without any, nan if
    a rule is violated.
    """

    value: np.ndarray
    objective: np.ndarray
    load: np.ndarray


def penalised(objective: np.ndarray, load: np.ndarray, most: float = 1.0) -> np.ndarray:
    """Value that a search minimises, from objectives and loads of placements that keep the rules; a load may be
    `most`."""
    solved = np.isfinite(objective)
    unmet = PENALTY_REQUIREMENT * (2.0 - most / np.maximum(load, most))
    return np.where(solved, np.where(load > most, unmet, objective), PENALTY_UNSOLVED)


def load_of(value: float) -> float:
    """The load of a placement that misses the requirements, by its value."""
    return 1.0 / (2.0 - value / PENALTY_REQUIREMENT)


@dataclass(frozen=True)
class Requirements:
    """Requirements on placements."""

    decided: np.ndarray
    """(q,) bool, requirements that levels and covariance analysis decide; runs decide the others."""
    judge: Callable[[np.ndarray], list[RequirementValue]]
    """Evaluates a placement (k, 2) fully."""
    coarse: Callable[[np.ndarray], list[RequirementValue]]
    """Evaluates it coarsely."""

    def load(self, found: Sequence[RequirementValue]) -> float:
        """The largest utilisation; at most 1 where all that is decided is met."""
        return max(_load(one) for one, decided in zip(found, self.decided, strict=True) if decided)


def _load(one: RequirementValue) -> float:
    if not math.isfinite(one.utilisation):  # the value still tells how far off it is
        short = one.limit - one.value[0]
        return _LEVELLESS * (2.0 + (short if math.isfinite(short) else 1.0))
    # the verdict decides if rounding puts the utilisation on the other side
    if one.verdict() == MET:
        return min(one.utilisation, 1.0)
    return min(max(one.utilisation, math.nextafter(1.0, 2.0)), _LEVELLESS)


@dataclass(frozen=True)
class PlacementProblem:
    """Objective, rules, and warnings about the sky.

    `coarse`, `screens`, `features`, `found` and `quick` serve analysed objectives (filter errors, protection levels)
    and requirements. For objectives of geometry they are empty.
    """

    study: Optimize
    scenario: Landing
    rules: Rules
    geometry: Geometry
    objective: ObjectiveFunction
    warnings: list[str]
    coarse: ObjectiveFunction | None = None
    """Fast evaluation of the objective."""
    screens: tuple[ObjectiveFunction, ...] = ()
    """Objectives from the geometry alone."""
    features: ObjectiveFunction | None = None
    """(n, f) geometry of placements (n, k, 2), finite."""
    found: Callable[[np.ndarray], list[Finding]] | None = None
    """Findings of a placement (k, 2)."""
    quick: bool = False
    """Only levels are analysed."""
    requirements: Requirements | None = None
    load: ObjectiveFunction | None = None
    """Load of the requirements, as `coarse_load`."""
    coarse_load: ObjectiveFunction | None = None
    level_screen: LevelScreen | None = None
    """Screen of placements if only levels are analysed."""
    ahead: Callable[[np.ndarray, str], None] | None = None
    """Analyses placements (n, k, 2) in parallel before they are evaluated one by one, with a fidelity (`search.COARSE`,
    `FULL`)."""
    fly: Fly | None = None
    """Runs of a placement."""
    errors: Callable[[np.ndarray | None], Errors] | None = None
    """Errors of the filter with a placement, None for that of the base, by covariance analysis; of searches by the DOP
    of beacons, where the filter has such an analysis."""
    beacons: BeaconGlide | None = None
    """Geometry of beacons, where these are placed."""
    powers: tuple[PlacementProblem, ...] = ()
    """The same with each further transmitter power."""

    def of(self, member: Member) -> PlacementProblem:
        """The problem with the power and the limit of the cost of a search; with a limit it begins near another
        placement, and one effort is enough."""
        its = self.powers[member.power - 1] if member.power else self
        if not member.number:
            return its
        study, rules = its.study.model_copy(update={"effort": 1}), replace(its.rules, limit=member.limit)
        return replace(its, study=study, rules=rules)

    def costs(self, places: np.ndarray) -> np.ndarray:
        """Cost (k,) of each source of a placement (k, c); nan where the study has no costs."""
        if self.rules.costs is None:
            return np.full(len(places), np.nan)
        return self.rules.costs.each(places[None], self.rules.plane.antenna_heights(places[None]))[0]

    @property
    def flies(self) -> bool:
        """Whether covariance analyses of the filter evaluate placements."""
        return self.found is not None

    @property
    def analysed(self) -> bool:
        """Whether placements are analysed one by one: for an error of the filter, levels, requirements."""
        return self.coarse is not None

    def judged(self, places: np.ndarray, coarse: bool = False) -> Evaluated:
        """Evaluation of placements by the objective, or its fast version, and the requirements.

        Values below UNMET keep all rules, have a solution and meet the requirements.
        """
        broken = self.rules.violation(places)
        judge, load = (self.coarse or self.objective, self.coarse_load) if coarse else (self.objective, self.load)
        found = Evaluated(_of_broken(broken), np.full(len(places), np.nan), np.full(len(places), np.nan))
        if np.any(kept := broken <= 0.0):
            found.objective[kept] = judge(places[kept])
            found.load[kept] = 0.0 if load is None else load(places[kept])
            found.value[kept] = penalised(found.objective[kept], found.load[kept])
        return found

    def value(self, places: np.ndarray) -> np.ndarray:
        """Value that a search minimises (n,): the objective, or a penalty for violated rules and missed
        requirements."""
        return self.judged(places).value

    def rough_value(self, places: np.ndarray, judge: ObjectiveFunction) -> np.ndarray:
        """`value` with a replacement of the objective.

        Rules use fewer points of the approach, with a margin that compensates for it.
        """
        rough, margin = self._rough_rules
        broken = rough.violation(places) + margin
        out = _of_broken(broken)
        if np.any(kept := broken <= 0.0):
            values = judge(places[kept])
            out[kept] = np.where(np.isfinite(values), values, PENALTY_UNSOLVED)
        return out

    def screened(self, places: np.ndarray) -> np.ndarray:
        """Values (n,) of placements by their levels at some epochs."""
        assert self.level_screen is not None
        objective, load = self.level_screen(places)
        if self.study.objective in DOP_OBJECTIVES:
            objective = self.objective(places)
        return penalised(objective, load)

    def shown(self, value: np.ndarray) -> np.ndarray:
        """Objective in the unit of tables, from the minimised value."""
        return np.asarray(1.0 / value if self.study.objective in LARGE else value)

    @cached_property
    def _rough_rules(self) -> tuple[Rules, float]:
        track = self.rules.receiver
        spacing = np.linalg.norm(np.diff(track, axis=0), axis=1).max(initial=0.0)
        step = 1 if spacing == 0.0 else max(int(_TRACK / spacing), 1)
        return replace(self.rules, receiver=track[::step]), _TRACK_MARGIN if step > 1 else 0.0

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """Corners of the area, or of the sites, (c,) least and largest s, l1, and height where each has its own."""
        if (area := self.study.area) is not None:
            ends = (area.s_m, area.l1_m) if area.height_m is None else (area.s_m, area.l1_m, area.height_m)
            low, high = np.array(ends).T
            return low, high
        sites = self.sites()
        return sites.min(axis=0), sites.max(axis=0)

    @property
    def coordinates(self) -> int:
        """Number of coordinates of a position, c: 2, or 3 with its own height."""
        return 3 if self.study.has_heights else 2

    @property
    def lowest(self) -> float:
        """Height of the lowest antenna that the study allows, m; of sites without their own."""
        area = self.study.area
        return self.study.height_m if area is None or area.height_m is None else area.height_m[0]

    def sites(self) -> np.ndarray:
        """The sites to choose from (n, c) s, l1, and height, m."""
        common = self.study.height_m
        each = [(s.s_m, s.l1_m, common if s.height_m is None else s.height_m) for s in self.study.sites]
        return np.array(each)[:, : self.coordinates]


def _of_broken(broken: np.ndarray) -> np.ndarray:
    """Values of placements that violate a rule by so much (n,)."""
    return np.where(broken > 0.0, PENALTY_CONSTRAINT * (1.0 + np.maximum(broken, 0.0)), np.nan)


def problem(
    study: Optimize, document: Document, base: Document, ask: Ask = lambda *_: None, workers: int | None = None
) -> PlacementProblem:
    """The base scenario, the rules and the objective of a study, after `ask` has checked it.

    workers: threads of the runs of placements, None for all cores. Raises InputError, and errors of `ask`.
    """
    first, *others = (
        _with_power(study, document, base, ask if i == 0 else lambda *_: None, i, workers)
        for i in range(len(study.powers))
    )
    warnings = [text for each in (first, *others) for text in each.warnings]
    return replace(first, powers=tuple(others), warnings=[*dict.fromkeys(warnings)]) if others else first


def _with_power(
    study: Optimize, document: Document, base: Document, ask: Ask, number: int, workers: int | None
) -> PlacementProblem:
    """The problem with a transmitter power of the study."""
    bare, power = base.copy(), study.powers[number]
    if power is not None:
        at = document.place(("costs", "power", number))
        set_value(bare, f"{study.placed}.eirp_dbm", power.eirp_dbm, at, document.folder)
    for key in ("count", "s_m", "l1_m", "sites") if study.beacons is None else ():
        if isinstance(bare.data.get("pseudolites"), dict):
            bare.data["pseudolites"].pop(key, None)
    if study.beacons is None:
        set_value(bare, "pseudolites.count", 0, document.place(("base",)), document.folder)
    scenario, flies = _posed(study, document, bare)
    sources, scenario, warnings = environment(scenario, bare)
    ask(scenario, sources)
    if study.beacons is None:
        _check_not_silenced(scenario, study, document)
    trajectory = scenario.trajectory()
    starts = np.array([scenario.epoch.timestamp()])
    if study.period is not None:
        starts = starts + np.arange(study.period.count) * study.period.hours * 3600.0 / study.period.count
        _check_known(sources, starts, document)
    fixes, counted = glide_epochs(scenario, trajectory)
    epochs = fixes[counted]
    if study.costs is not None and study.costs.power and study.beacons is None and not sources.strength_placed:
        text = f"the power of pseudolites makes no difference in {study.base}: it needs `range_law: cn0` or jamming"
        raise _refused(document, ("costs", "power"), text)
    if sources.strength_placed and study.objective in DOP_OBJECTIVES:
        text = (
            f"{study.objective} is evaluated from directions alone, but the strength of pseudolites matters by "
            f"{', '.join(sources.strength_keys)}. Leave these keys out, or use a level or an error of the filter"
        )
        raise _refused(document, ("objective",), text)
    if sources.smoothing_placed and study.objective.startswith("fix_"):
        text = (
            f"{study.objective} is evaluated from directions alone; with terrain and receiver.smoothing_s the time for "
            "which pseudolites are visible matters: use a level, or an error of the filter"
        )
        raise _refused(document, ("objective",), text)
    if sources.air_placed and study.objective.startswith("fix_"):
        text = (
            f"{study.objective} is evaluated from directions alone; with pseudolites.air.refractivity_sigma_n the "
            "distances of pseudolites matter: use a level, or an error of the filter"
        )
        raise _refused(document, ("objective",), text)
    seen = sources
    if sources.strength_placed:
        # by geometry others are only screened
        seen = sources.by_directions
        warnings.append(
            "the table's DOPs ignore `interference`, receiver.antenna and noise by pseudolites.range_law cn0, which "
            "depend on the positions of pseudolites; the objective includes them"
        )
    geometry = glide_geometry(trajectory, seen, starts, fixes, counted)
    beacons = None
    if study.beacons is not None:
        assert scenario.beacons is not None  # `_posed` has looked
        for event in scenario.beacons.happenings(scenario):
            if study.objective in BEACON_OBJECTIVES or set(event.sources) != {BEACONS}:
                text = "has an event of beacons, whose positions the search replaces; write `beacons` for all of them, "
                text += "and use an error of the filter as objective"
                raise _refused(document, ("base",), f"{study.base} {text}")
        beacons = BeaconGlide.of(scenario.beacons.model(scenario), trajectory, epochs)
    elif 1 in study.counts and (lone := int(geometry.find_lone_pseudolite(1).sum())):
        equal = "all positions of 1 pseudolite are equally good for fixes: " if lone == len(geometry.receiver) else ""
        clock, when = CLOCKS[sources.pseudolites.time_scale], f"at {lone} of {len(geometry.receiver)} epochs"
        warnings.append(equal + lone_pseudolite_warning(clock, when, FOLLOW))
    warnings += plausibility_warnings(scenario, trajectory)
    if scenario.requirements and not study.constraints.requirements:
        warnings.append(
            f"the search ignores the requirements of {study.base}; navsim judges by them only the best placements that "
            "it flies. To search placements that meet them, write `constraints: {requirements: true}`"
        )
    doubted = scenario.runway.doubted_height("height_m", study.height_m, study.placed)
    if doubted and study.height_above == "runway":
        warnings.append(doubted)
    if (study.objective in FILTER_OUTPUTS or beacons is not None) and study.constraints.distance_m is None:
        distance = FILTER_DISTANCE if beacons is None else BEACON_DISTANCE
        own = study.constraints.model_copy(update={"distance_m": distance})
        study = study.model_copy(update={"constraints": own})
    placing = geometry if beacons is None else beacons
    kept = rules(study, document, scenario, placing.receiver[: epochs.size], 0.0 if power is None else power.cost)
    study = study.model_copy(update={"constraints": kept.given})
    objective: ObjectiveFunction = partial(_of_geometry, study.objective.removeprefix("beacons_"), placing, kept)
    fly = partial(_fly, study, bare, document, kept.plane, workers)
    by_geometry = study.objective in (*DOP_OBJECTIVES, *BEACON_OBJECTIVES)
    if by_geometry and not study.constraints.requirements:
        errors = None
        if beacons is not None:
            with suppress(KeyedError):  # runs alone judge then
                check_analysable(scenario)
                errors = partial(_errors, study, bare, document, kept.plane)
        return PlacementProblem(
            study, scenario, kept, geometry, objective, warnings, fly=fly, errors=errors, beacons=beacons
        )
    # the filter and its monitors, which objectives of the geometry do without
    from navsim.landing.case import prepare
    from navsim.optimization.analyses import BeaconFlight, FidelityEvaluator, LevelScreen, flown, screened, watched

    # levels are those of fixes, to which beacons give nothing
    watches = beacons is None and (study.constraints.requirements or study.objective in LEVEL_OBJECTIVES)
    if watches and scenario.integrity is not None and scenario.integrity.method == "filter":
        text = "levels of filters take seconds each and are not searched; use integrity.method mhss, then navsim run"
        raise _refused(document, ("base",), f"{study.base}: {text}")
    case = prepare(scenario if beacons is None else scenario.model_copy(update={"beacons": None}), bare)
    end = touchdown = touchdown_time(scenario, trajectory)
    if not by_geometry and study.objective not in LEVEL_OBJECTIVES:
        end = _read_at(study.objective, case)
        if not math.isfinite(end):
            text = f"'{study.objective}' has no value: the flight of {study.base} does not pass there within duration_s"
            raise _refused(document, ("objective",), f"{text}: {case.scenario.duration_s:g}")
    until = max(end, touchdown) if study.constraints.requirements else end

    def flight(rough: bool) -> Prepared | BeaconFlight:
        its = scenario.beacons
        return flown(case, until, rough) if study.beacons is None or its is None else (
            BeaconFlight.of(case, its, until, rough))  # fmt: skip

    full, coarse = (
        FidelityEvaluator(
            kept,
            flight(rough) if flies else None,
            watched(case, MOST_LEVELS if rough else None) if watches and case.flight.watching is not None else None,
        )
        for rough in (False, True)
    )
    first: tuple[ObjectiveFunction, ...] = ()
    quick = objective
    if by_geometry:
        first = (objective,)
    else:
        objective, quick = full.judge(study.objective), coarse.judge(study.objective)
    problem = PlacementProblem(
        study, scenario, kept, geometry, objective, warnings, quick,
        (*first, *_screens(study.objective, placing, epochs, end, kept)),
        _features(placing, epochs, end, kept, flies),
        full.findings if flies else None,
        not flies,
        fly=fly,
        beacons=beacons,
    )  # fmt: skip
    if study.constraints.requirements:
        problem = _with_requirements(problem, full, coarse, document)
    placed = sources.depends_on_pseudolite_sites or sources.sight_placed or sources.singled_out
    placed = placed or geometry.has_beyond_horizon(kept.plane.ecef(_corners(*problem.limits())))
    if problem.quick and epochs.size and not placed:
        decided = None if problem.requirements is None else problem.requirements.decided
        problem = replace(problem, level_screen=LevelScreen(kept.plane, screened(case), study.objective, decided))
    return problem


def _check_not_silenced(scenario: Landing, study: Optimize, document: Document) -> None:
    """Raise InputError where an event silences all pseudolites from the beginning to the end."""
    for i, event in enumerate(scenario.events):
        throughout = event.at_s <= 0.0 and (event.until_s is None or event.until_s >= scenario.duration_s)
        if event.what == "silence" and throughout and {"all", "pseudolites"} & set(event.sources):
            text = f"events[{i}] silences the pseudolites, too, during the whole flight: no place of them makes a "
            text += "difference; silence satellites alone: sources: [satellites]"
            raise _refused(document, ("base",), f"{study.base}: {text}")


def _corners(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Corners (2^c, c) of an area from its least to its largest coordinates."""
    return np.array([*itertools.product(*zip(low, high, strict=True))])


def _posed(study: Optimize, document: Document, bare: Document) -> tuple[Landing, bool]:
    """The base scenario, and whether its filter is analysed. Raises InputError if it lacks what the study needs."""
    of_filter = study.objective in FILTER_OUTPUTS
    if of_filter:
        set_value(bare, "method", "covariance", document.place(("objective",)), document.folder)
    scenario = validated(Landing, bare)
    if study.beacons is not None and scenario.beacons is None:
        text = (
            f"{study.base} has no section `beacons`: describe one there, with rate_hz, sigma_m and how far it reaches"
        )
        raise _refused(document, ("beacons",), text)
    if study.objective in LEVEL_OBJECTIVES and scenario.integrity is None:
        text = f"{study.objective} needs `integrity`, which {study.base} does not have"
        raise _refused(document, ("objective",), text)
    if scenario.interference is not None:
        try:
            scenario.interference.check_turns(max(study.counts))
        except KeyedError as error:
            raise _refused(document, ("pseudolites",), str(error)) from None
    judged, key = study.constraints.requirements, ("constraints", "requirements")
    if judged and not scenario.requirements:
        raise _refused(document, key, f"there are no `requirements` in {study.base}")
    flies = (
        of_filter
        or (judged and study.beacons is not None)
        or (
            judged
            and any(isinstance(one, ErrorRequirement | RmsRequirement) for _, one in singles(scenario.requirements))
        )
    )
    # importance sampling has no monitor of the fixes
    if flies != of_filter or (scenario.method == "rare" and (judged or study.objective in LEVEL_OBJECTIVES)):
        set_value(bare, "method", "covariance", document.place(key), document.folder)
        scenario = validated(Landing, bare)
    return scenario, flies


def _fly(
    study: Optimize,
    bare: Document,
    document: Document,
    plane: RunwayPlane,
    workers: int | None,
    places: np.ndarray,
    seed: int,
    first: int,
    runs: int,
) -> OfRuns:
    """Results of runs of the base scenario with pseudolites, or beacons, at `places` (k, c)."""
    case = _case(with_sites(study, bare, document, places, plane), document, "monte-carlo")
    return of_runs(fly_case(case, seed, first, runs, threads(workers)))


def _errors(
    study: Optimize, bare: Document, document: Document, plane: RunwayPlane, places: np.ndarray | None
) -> Errors:
    """See `PlacementProblem.errors`."""
    from navsim.landing.covariance import covariance_analysis, covariance_summary

    own = bare.copy() if places is None else with_sites(study, bare, document, places, plane)
    case = _case(own, document, "covariance")
    return filter_outputs(covariance_summary(case, covariance_analysis(case)))


def _case(own: Document, document: Document, method: str) -> Case:
    from navsim.landing.case import prepare

    set_value(own, "method", method, document.place(("base",)), document.folder)
    return prepare(validated(Landing, own), own)


def with_sites(study: Optimize, bare: Document, document: Document, places: np.ndarray, plane: RunwayPlane) -> Document:
    """The base scenario with pseudolites, or beacons, at `places` (k, c)."""
    own = bare.copy()
    sites = [study.site(place) for place in plane.above_runway(places)]
    settings: dict[str, Any] = {f"{study.placed}.sites": sites}
    if study.beacons is None:
        own.data["pseudolites"].pop("count")
        settings["pseudolites.frame"] = "runway"
    for key, value in settings.items():
        set_value(own, key, value, document.place(("base",)), document.folder)
    return own


def _refused(document: Document, key: KeyPath, text: str) -> InputError:
    return InputError([Problem(document.place(key), dotted(key), text)])


def _with_requirements(
    problem: PlacementProblem, full: FidelityEvaluator, coarse: FidelityEvaluator, document: Document
) -> PlacementProblem:
    """The problem with the base scenario's requirements. A case without pseudolites shows which of them can be
    decided."""
    found = full.fulfilments(np.empty((0, 2)))
    decided = np.array([not math.isnan(one.utilisation) for one in found])
    left = [one.text for one, known in zip(found, decided, strict=True) if not known]
    if not decided.any():
        text = f"levels and covariance analysis decide none of them: {'; '.join(left)}"
        raise _refused(document, ("constraints", "requirements"), text)
    asked = Requirements(decided, full.fulfilments, coarse.fulfilments)

    def judge(by: Callable[[np.ndarray], list[RequirementValue]]) -> ObjectiveFunction:
        return lambda places: np.array([asked.load(by(one)) for one in places])

    warnings = [*problem.warnings]
    if left:
        warnings.append(f"the search ignores requirements that only runs decide (use `navsim run`): {'; '.join(left)}")
    return replace(
        problem, warnings=warnings, requirements=asked, load=judge(asked.judge), coarse_load=judge(asked.coarse)
    )


def _check_known(sources: SignalScenario, starts: np.ndarray, document: Document) -> None:
    """Raise InputError where a constellation is unknown at some of the starts, POSIX s (n,): the objective would be of
    fewer satellites there without a word."""
    for group in sources.satellites:
        position, _ = group.constellation.state(timescales.gps_from_utc(starts))
        lost = ~np.isfinite(position[..., 0]).any(axis=1)
        if lost.any():
            first = datetime.datetime.fromtimestamp(starts[np.argmax(lost)], datetime.UTC)
            text = (
                f"no {group.constellation.system.name} satellite is known at {lost.sum()} of {starts.size} start "
                f"times, the first of them {first:%Y-%m-%dT%H:%M:%SZ}: the messages or orbits do not reach over the "
                "period"
            )
            raise InputError([Problem(document.place(("period",)), "period", text)])


def _of_geometry(name: str, geometry: Geometry | BeaconGlide, kept: Rules, places: np.ndarray) -> np.ndarray:
    return of_geometry(name, geometry, kept.plane.ecef(places))


def of_geometry(name: str, geometry: Geometry | BeaconGlide, sites: np.ndarray) -> np.ndarray:
    """An objective of the geometry (n,) of placements (n, k, 3), ECEF, m; inf where an epoch has no solution."""
    which = next((i for end, i in (("_max", 2), ("_p50", 3)) if name.endswith(end)), 0)
    if name.startswith("fix_"):
        values, lost = geometry.fix_sigmas(sites)
        out = values[1 if name == "fix_horizontal" else 2, 0]
    else:
        values, lost = geometry.dops(sites, which == 3) if isinstance(geometry, BeaconGlide) else geometry.dops(sites)
        out = values["phv".index(name[0]), which]
    return np.where(lost == 0, out, np.inf)


def _read_at(name: str, case: Case) -> float:
    """Time at which an error of the filter is read, or the end of the stretch it is taken over, s."""
    from navsim.landing.case import crossing_times

    _, _, height = name.partition("_")
    return (
        crossing_times(case)[list(HEIGHTS).index(height)] if height else touchdown_time(case.scenario, case.trajectory)
    )


def _screens(
    name: str, geometry: Geometry | BeaconGlide, time: np.ndarray, end: float, kept: Rules
) -> tuple[ObjectiveFunction, ...]:
    """Screens by the sigma of fixes: along the objective's axis, and in space, over the seconds before it is evaluated;
    along the axis over the glide until then. The number of epochs without a fix counts first."""
    before = time <= end
    late = before & (time > end - RMS_WINDOW)
    row = 2 if name.startswith(("v", "fix_vertical", "beacons_v")) else 1

    def screen(of: int, part: Geometry | BeaconGlide, places: np.ndarray) -> np.ndarray:
        values, lost = part.fix_sigmas(kept.plane.ecef(places))
        return np.where(lost < len(part.receiver), values[of, 0] + _NO_FIX * lost, np.inf)

    parts = (row, _some(geometry, late)), (row, _some(geometry, before)), (0, _some(geometry, late))
    return tuple(partial(screen, *part) for part in parts)


def _features(
    geometry: Geometry | BeaconGlide, time: np.ndarray, end: float, kept: Rules, flies: bool
) -> ObjectiveFunction:
    """Geometry features of stretches of the glide before `end`.

    They are logarithms of the mean sigma of fixes in space, horizontal, vertical, and the number of epochs without a
    fix. The filter forgets earlier stretches, to a varying degree. Levels depend on each epoch separately, so the
    stretches are equal then.
    """
    if flies:
        edges = [-math.inf, *(end - before for before in _STRETCHES), end]
    else:
        edges = [-math.inf, *np.quantile(time, np.arange(1, _ALIKE + 1) / _ALIKE).tolist()]
    parts = [_some(geometry, (time > first) & (time <= last)) for first, last in itertools.pairwise(edges)]
    parts = [part for part in parts if len(part.receiver)]

    def features(places: np.ndarray) -> np.ndarray:
        out = []
        for part in parts:
            values, lost = part.fix_sigmas(kept.plane.ecef(places))
            out += [*np.log(np.where(lost < len(part.receiver), values[:, 0], _NO_FIX)), np.log1p(lost)]
        return np.stack(out, axis=1)

    return features


def _some(geometry: Geometry | BeaconGlide, epochs: np.ndarray) -> Geometry | BeaconGlide:
    """Every fifth of these epochs (e,) bool, which is enough."""
    return geometry.at(np.flatnonzero(epochs)[::5])
