"""What a search for placements makes small, an objective of the geometry, a protection level, or an error of the
filter; and what placements have to meet.

An error of the filter is a linear covariance analysis of every placement, a level the monitor of its fixes. What does
not depend on it is done once: the flight (cut where the objective no longer looks), the orbits, the sources that are
ever heard. It is to be had in three ways, each much dearer as the one before and closer to the truth [1]:

    screens     accuracy of fixes by the geometry kernel: over the last seconds before the objective is read, the glide
    coarse      covariance analysis with a fix a second of the same information, inertial samples at 10 Hz; levels at
                some epochs of the glide
    objective   covariance analysis, and levels, as a landing by itself has them

Requirements are judged as those of landings are (`study.landing.requirements`). The load of a placement is the largest
utilisation among them; one of a load above 1 ranks behind all that meet them, by its load [2].

Source: [1] Peherstorfer, Willcox & Gunzburger, Survey of multifidelity methods in uncertainty propagation, inference,
and optimization, SIAM Review 60 (2018). [2] Deb, An efficient constraint handling method for genetic algorithms,
Comput. Methods Appl. Mech. Engrg. 186 (2000).
"""

from __future__ import annotations

import datetime
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from navsim.io.findings import Finding
from navsim.io.schema import HEIGHTS, LARGE, MOST_LEVELS, RMS_WINDOW
from navsim.models import timescales
from navsim.models.constellation import Remembering
from navsim.models.kinematics import Motion
from navsim.models.signals import Environment, build_signals
from navsim.scenario.base import validated
from navsim.scenario.landing import Landing
from navsim.scenario.optimize import DOP_OBJECTIVES, LEVEL_OBJECTIVES, Optimize
from navsim.scenario.requirements import ErrorRequirement, RmsRequirement
from navsim.scenario.source import Document, InputError, KeyPath, Problem, dotted, set_value
from navsim.simulation.geometry import Geometry, glide_geometry
from navsim.simulation.landing_covariance import Analysis
from navsim.study.landing import (
    Case,
    covariance_analysis,
    covariance_findings,
    covariance_summary,
    integrity,
    judged_without_runs,
    prepare,
)
from navsim.study.landing.case import (
    Ask,
    crossing_times,
    environment,
    glide_epochs,
    touchdown_time,
    world_of,
)
from navsim.study.landing.integrity import spread_over
from navsim.study.landing.requirements import MET, Fulfilment, single
from navsim.study.placement import Rules, rules
from navsim.study.sweep import filter_outputs

BROKEN = 1e9
"""Objective of a placement that breaks a rule by nothing; more for worse."""
UNSOLVED = 1e8
"""Objective of a placement that keeps the rules and leaves an epoch without a fix, or without a level that is the
objective."""
UNMET = 1e7
"""Objective of a placement that misses the requirements by nothing; up to twice that for worse."""
_LEVELLESS = 1e3
"""Load of a placement that no size would save, since levels are lacking at too many epochs; up to three times that."""
COARSE_FIXES = 1.0
"""Rate of fixes of the coarse analysis, Hz."""
COARSE_IMU = 10.0
"""Inertial samples of the coarse analysis, Hz."""
_TRACK, _TRACK_MARGIN = 12.0, 0.3
"""Spacing of the points of the approach that rough rules ask, m, and their margin: 60 m from the aircraft, the nearest
point is by no more than that nearer than the nearest of those asked."""
_STRETCHES = (30.0, 15.0, 5.0)
"""Where the glide is divided to describe its geometry, s before the objective is read."""
_ALIKE = 5
"""So many of them where levels alone are analysed."""
_NO_FIX = 1e4
"""What an epoch without a fix counts as in ranking placements by their geometry, m."""

Judge = Callable[[np.ndarray], np.ndarray]
"""Values (n,) of placements (n, k, 2); smaller is better, not finite without a solution."""


class Judged(NamedTuple):
    """Of placements (n,): value, what a search makes small; objective, nan where a rule is broken; load of the
    requirements, 0 where there are none, nan where a rule is broken."""

    value: np.ndarray
    objective: np.ndarray
    load: np.ndarray


def merit(objective: np.ndarray, load: np.ndarray, most: float = 1.0) -> np.ndarray:
    """What a search makes small, of objectives and loads of placements that keep the rules; a load may be `most`."""
    solved = np.isfinite(objective)
    unmet = UNMET * (2.0 - most / np.maximum(load, most))
    return np.where(solved, np.where(load > most, unmet, objective), UNSOLVED)


def load_of(value: float) -> float:
    """The load of a placement that misses the requirements, by its value."""
    return 1.0 / (2.0 - value / UNMET)


@dataclass(frozen=True)
class Requirements:
    """What placements have to meet. decided: which of the base scenario's requirements (q,) bool levels and covariance
    analysis decide; the others are left to runs. judge, coarse: what they find of a placement (k, 2), in full and
    coarsely."""

    decided: np.ndarray
    judge: Callable[[np.ndarray], list[Fulfilment]]
    coarse: Callable[[np.ndarray], list[Fulfilment]]

    def load(self, found: Sequence[Fulfilment]) -> float:
        """The largest utilisation; at most 1 where all that is decided is met."""
        return max(_load(one) for one, decided in zip(found, self.decided, strict=True) if decided)


def _load(one: Fulfilment) -> float:
    if not math.isfinite(one.utilisation):  # the figure says how far off it is all the same
        short = one.limit - one.value[0]
        return _LEVELLESS * (2.0 + (short if math.isfinite(short) else 1.0))
    # the verdict stands where rounding has the utilisation on the other side
    if one.verdict() == MET:
        return min(one.utilisation, 1.0)
    return min(max(one.utilisation, math.nextafter(1.0, 2.0)), _LEVELLESS)


@dataclass(frozen=True)
class PlacementProblem:
    """An objective with its rules, and warnings about the sky.

    For what is analysed, an error of the filter or a level, or with requirements: coarse, the objective's quick judge;
    screens and features, what the geometry says of it (features: (n, f) of placements (n, k, 2), finite); found, the
    findings of a placement (k, 2); quick: levels are all that is analysed. None and none for objectives of geometry.
    load, coarse_load: of the requirements.
    """

    study: Optimize
    scenario: Landing
    rules: Rules
    geometry: Geometry
    objective: Judge
    warnings: list[str]
    coarse: Judge | None = None
    screens: tuple[Judge, ...] = ()
    features: Judge | None = None
    found: Callable[[np.ndarray], list[Finding]] | None = None
    quick: bool = False
    requirements: Requirements | None = None
    load: Judge | None = None
    coarse_load: Judge | None = None

    @property
    def analysed(self) -> bool:
        """Whether placements are analysed one by one: for an error of the filter, levels, requirements."""
        return self.coarse is not None

    def judged(self, places: np.ndarray, coarse: bool = False) -> Judged:
        """What the objective, or its quick judge, and the requirements say of placements. Values below UNMET keep all
        rules, have a solution and meet the requirements."""
        broken = self.rules.violation(places)
        judge, load = (self.coarse or self.objective, self.coarse_load) if coarse else (self.objective, self.load)
        found = Judged(_of_broken(broken), np.full(len(places), np.nan), np.full(len(places), np.nan))
        if np.any(kept := broken <= 0.0):
            found.objective[kept] = judge(places[kept])
            found.load[kept] = 0.0 if load is None else load(places[kept])
            found.value[kept] = merit(found.objective[kept], found.load[kept])
        return found

    def value(self, places: np.ndarray) -> np.ndarray:
        """What a search makes small (n,): the objective, where rules are kept and requirements met, else how badly they
        are not."""
        return self.judged(places).value

    def rough_value(self, places: np.ndarray, judge: Judge) -> np.ndarray:
        """The same by a judge that stands in for the objective, and by rules that ask fewer points of the approach,
        with a margin that makes up for it."""
        rough, margin = self._rough_rules
        broken = rough.violation(places) + margin
        out = _of_broken(broken)
        if np.any(kept := broken <= 0.0):
            values = judge(places[kept])
            out[kept] = np.where(np.isfinite(values), values, UNSOLVED)
        return out

    def shown(self, value: np.ndarray) -> np.ndarray:
        """The objective as people have it, of what is made small."""
        return np.asarray(1.0 / value if self.study.objective in LARGE else value)

    @cached_property
    def _rough_rules(self) -> tuple[Rules, float]:
        track = self.rules.receiver
        spacing = np.linalg.norm(np.diff(track, axis=0), axis=1).max(initial=0.0)
        step = 1 if spacing == 0.0 else max(int(_TRACK / spacing), 1)
        return replace(self.rules, receiver=track[::step]), _TRACK_MARGIN if step > 1 else 0.0

    def limits(self) -> tuple[np.ndarray, np.ndarray]:
        """The corners of the area, or of what the sites cover, (2,) least and largest s and l1."""
        if self.study.area is not None:
            low, high = np.array([self.study.area.s_m, self.study.area.l1_m]).T
            return low, high
        sites = self.sites()
        return sites.min(axis=0), sites.max(axis=0)

    def sites(self) -> np.ndarray:
        """The sites to choose from (n, 2) s and l1, m."""
        return np.array([[site.s_m, site.l1_m] for site in self.study.sites])


def _of_broken(broken: np.ndarray) -> np.ndarray:
    """Values of placements that break a rule by so much (n,)."""
    return np.where(broken > 0.0, BROKEN * (1.0 + np.maximum(broken, 0.0)), np.nan)


def problem(study: Optimize, document: Document, base: Document, ask: Ask = lambda *_: None) -> PlacementProblem:
    """The base scenario, the rules and the objective of a study, once `ask` has let it pass. Raises InputError, and
    what `ask` raises."""
    bare = base.copy()
    for key in ("count", "s_m", "l1_m", "sites"):
        if isinstance(bare.data.get("pseudolites"), dict):
            bare.data["pseudolites"].pop(key, None)
    set_value(bare, "pseudolites.count", 0, document.place(("base",)), document.folder)
    scenario, flies = _posed(study, document, bare)
    sources, scenario, warnings = environment(scenario, bare)
    ask(scenario, sources)
    trajectory = scenario.trajectory()
    starts = np.array([scenario.epoch.timestamp()])
    if study.period is not None:
        starts = starts + np.arange(study.period.count) * study.period.hours * 3600.0 / study.period.count
        _check_known(sources, starts, document)
    fixes, counted = glide_epochs(scenario, trajectory)
    epochs = fixes[counted]
    geometry = glide_geometry(trajectory, sources, starts, fixes, counted)
    kept = rules(study, document, scenario, geometry.receiver[: epochs.size])
    study = study.model_copy(update={"constraints": kept.given})
    objective: Judge = partial(_of_geometry, study.objective, geometry, kept)
    if study.objective in DOP_OBJECTIVES and not study.constraints.requirements:
        return PlacementProblem(study, scenario, kept, geometry, objective, warnings)
    case = prepare(scenario, bare)
    end = touchdown = touchdown_time(scenario, trajectory)
    if study.objective not in (*DOP_OBJECTIVES, *LEVEL_OBJECTIVES):
        end = _read_at(study.objective, case)
        if not math.isfinite(end):
            text = f"'{study.objective}' has no value: the flight of {study.base} does not pass there within duration_s"
            raise _refused(document, ("objective",), f"{text}: {case.scenario.duration_s:g}")
    watches = study.constraints.requirements or study.objective in LEVEL_OBJECTIVES
    until = max(end, touchdown) if study.constraints.requirements else end
    full, coarse = (
        _Analyst(
            kept,
            _flown(case, until, rough) if flies else None,
            _watched(case, rough) if watches and case.flight.watching is not None else None,
        )
        for rough in (False, True)
    )
    first: tuple[Judge, ...] = ()
    quick = objective
    if study.objective in DOP_OBJECTIVES:
        first = (objective,)
    else:
        objective, quick = full.judge(study.objective), coarse.judge(study.objective)
    here = PlacementProblem(
        study, scenario, kept, geometry, objective, warnings, quick,
        (*first, *_screens(study.objective, geometry, epochs, end, kept)),
        _features(geometry, epochs, end, kept, flies),
        full.findings if flies else None,
        not flies,
    )  # fmt: skip
    return _with_requirements(here, full, coarse, document) if study.constraints.requirements else here


def _posed(study: Optimize, document: Document, bare: Document) -> tuple[Landing, bool]:
    """The base scenario, and whether its filter is analysed. Raises InputError where it has not what the study asks
    for."""
    of_filter = study.objective not in (*DOP_OBJECTIVES, *LEVEL_OBJECTIVES)
    if of_filter:
        set_value(bare, "method", "covariance", document.place(("objective",)), document.folder)
    scenario = validated(Landing, bare)
    if study.objective in LEVEL_OBJECTIVES and scenario.integrity is None:
        text = f"{study.objective} needs `integrity`, which {study.base} does not have"
        raise _refused(document, ("objective",), text)
    judged, key = study.constraints.requirements, ("constraints", "requirements")
    if judged and not scenario.requirements:
        raise _refused(document, key, f"there are no `requirements` in {study.base}")
    flies = of_filter or (
        judged and any(isinstance(one, ErrorRequirement | RmsRequirement) for _, one in single(scenario))
    )
    # of pushed runs nothing watches the fixes
    if flies != of_filter or (scenario.method == "rare" and (judged or study.objective in LEVEL_OBJECTIVES)):
        set_value(bare, "method", "covariance", document.place(key), document.folder)
        scenario = validated(Landing, bare)
    return scenario, flies


def _refused(document: Document, key: KeyPath, text: str) -> InputError:
    return InputError([Problem(document.place(key), dotted(key), text)])


def _with_requirements(
    here: PlacementProblem, full: _Analyst, coarse: _Analyst, document: Document
) -> PlacementProblem:
    """The same with the base scenario's requirements; without pseudolites it shows which of them are decided."""
    found = full.fulfilments(np.empty((0, 2)))
    decided = np.array([not math.isnan(one.utilisation) for one in found])
    left = [one.text for one, known in zip(found, decided, strict=True) if not known]
    if not decided.any():
        text = f"levels and covariance analysis decide none of them: {'; '.join(left)}"
        raise _refused(document, ("constraints", "requirements"), text)
    asked = Requirements(decided, full.fulfilments, coarse.fulfilments)

    def judge(by: Callable[[np.ndarray], list[Fulfilment]]) -> Judge:
        return lambda places: np.array([asked.load(by(one)) for one in places])

    warnings = [*here.warnings]
    if left:
        warnings.append(f"requirements that runs alone decide (navsim run) are no constraint here: {'; '.join(left)}")
    return replace(
        here, warnings=warnings, requirements=asked, load=judge(asked.judge), coarse_load=judge(asked.coarse)
    )


def _check_known(sources: Environment, starts: np.ndarray, document: Document) -> None:
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


def _of_geometry(name: str, geometry: Geometry, kept: Rules, places: np.ndarray) -> np.ndarray:
    sites = kept.plane.ecef(places)
    which = 2 if name.endswith("_max") else 0
    if name.startswith("fix_"):
        values, lost = geometry.fix_sigmas(sites)
        out = values[1 if name == "fix_horizontal" else 2, 0]
    else:
        values, lost = geometry.dops(sites)
        out = values["phv".index(name[0]), which]
    return np.where(lost == 0, out, np.inf)


def _read_at(name: str, case: Case) -> float:
    """Time at which an error of the filter is read, or the end of the stretch it is taken over, s."""
    _, _, height = name.partition("_")
    return (
        crossing_times(case)[list(HEIGHTS).index(height)] if height else touchdown_time(case.scenario, case.trajectory)
    )


def _screens(name: str, geometry: Geometry, time: np.ndarray, end: float, kept: Rules) -> tuple[Judge, ...]:
    """Judges by the SKO of fixes: of the objective's axis, and in space, over the seconds before it is read; of the
    axis over the glide up to then. Epochs without a fix count first."""
    before = time <= end
    late = before & (time > end - RMS_WINDOW)
    row = 2 if name.startswith(("v", "fix_vertical")) else 1

    def screen(of: int, part: Geometry, places: np.ndarray) -> np.ndarray:
        values, lost = part.fix_sigmas(kept.plane.ecef(places))
        return np.where(lost < len(part.receiver), values[of, 0] + _NO_FIX * lost, np.inf)

    parts = (row, _some(geometry, late)), (row, _some(geometry, before)), (0, _some(geometry, late))
    return tuple(partial(screen, *part) for part in parts)


def _features(geometry: Geometry, time: np.ndarray, end: float, kept: Rules, flies: bool) -> Judge:
    """Logarithms of the mean SKO of fixes in space, horizontal, vertical, and epochs without a fix, over stretches of
    the glide before `end`: the filter forgets the earlier ones, by how much differs. Levels are of each epoch by
    itself: the stretches are alike then."""
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


def _some(geometry: Geometry, epochs: np.ndarray) -> Geometry:
    """Of these epochs (e,) bool every fifth, which says enough."""
    return geometry.at(np.flatnonzero(epochs)[::5])


@dataclass(frozen=True)
class _Flight:
    """A flight without pseudolites, ready to be given some.

    heard: (s,) bool, the sources of which anything is heard. share: of the information of one of the receiver's fixes
    in one of these, as a factor of its sigmas. watched: numbers of the fix epochs that are left (m,), where all that
    counts are levels, of more; else None.
    """

    case: Case
    motion: Motion
    heard: np.ndarray
    share: float
    watched: np.ndarray | None = None

    def with_pseudolites(self, llh: np.ndarray) -> Case:
        """The case with pseudolites at (k, 3) rad, rad, m; of its world only the signals know of them."""
        names = tuple(f"PL{i}" for i in range(1, len(llh) + 1))
        sources = replace(self.case.environment, pseudolites=replace(self.case.pseudolites, names=names, llh=llh))
        signals = build_signals(self.motion, self.case.scenario.epoch.timestamp(), sources)
        signals = signals.select(np.concatenate([self.heard, np.full(len(llh), True)]))
        if self.watched is not None:
            signals = signals.at(self.watched)
        # fewer epochs have less to smooth already
        share = self.share if signals.smoothing is None else self.share**2
        signals = replace(
            signals, sigma=share * signals.sigma, rate_sigma=self.share * signals.rate_sigma,
            fix_sigma=share * signals.fix_sigma,
        )  # fmt: skip
        return replace(self.case, environment=sources).over(replace(self.case.world, signals=signals))


class _Analyst:
    """What is found of placements at one fidelity. flown: for the filter; watched: for levels; each None where nobody
    asks. The last placement is remembered, since objective and requirements ask for the same."""

    def __init__(self, kept: Rules, flown: _Flight | None, watched: _Flight | None) -> None:
        self._kept, self._flown, self._watched = kept, flown, watched
        self._last: tuple[bytes, _Found] | None = None

    def _of(self, places: np.ndarray) -> _Found:
        key = np.ascontiguousarray(places, np.float64).tobytes()
        if self._last is None or self._last[0] != key:
            llh = self._kept.plane.llh(places)
            cases = [
                None if flight is None else flight.with_pseudolites(llh) for flight in (self._flown, self._watched)
            ]
            self._last = key, _Found(*cases)
        return self._last[1]

    def judge(self, name: str) -> Judge:
        """The judge of placements by an error of the filter, or by levels: large for a small share of epochs that have
        them, inf for one of the others where not all have."""

        def one(places: np.ndarray) -> float:
            found = self._of(places)
            if name not in LEVEL_OBJECTIVES:
                return found.errors[name]
            share = found.levels["level_share"]
            if name in LARGE:
                return 1.0 / share if share > 0.0 else math.inf
            return found.levels[name] if share == 1.0 else math.inf

        return lambda places: np.array([one(p) for p in places])

    def fulfilments(self, places: np.ndarray) -> list[Fulfilment]:
        """What is known of the base scenario's requirements with a placement (k, 2)."""
        return self._of(places).fulfilments

    def findings(self, places: np.ndarray) -> list[Finding]:
        """What the covariance analysis of a placement (k, 2) finds."""
        found = self._of(places)
        assert found.flown is not None
        return covariance_findings(found.flown, found.analysis)


@dataclass(frozen=True)
class _Found:
    """A placement, as it is flown and as it is watched."""

    flown: Case | None
    watched: Case | None

    @cached_property
    def analysis(self) -> Analysis:
        assert self.flown is not None
        return covariance_analysis(self.flown)

    @cached_property
    def errors(self) -> dict[str, float]:
        assert self.flown is not None
        return filter_outputs(covariance_summary(self.flown, self.analysis))

    @cached_property
    def levels(self) -> dict[str, float]:
        assert self.watched is not None
        return integrity.level_outputs(self.watched)

    @cached_property
    def fulfilments(self) -> list[Fulfilment]:
        """By whichever of them knows."""
        known = []
        if self.watched is not None:
            known.append(judged_without_runs(self.watched, None))
        if self.flown is not None:
            known.append(judged_without_runs(self.flown, self.analysis))
        return [
            next((one for one in each if not math.isnan(one.utilisation)), each[0]) for each in zip(*known, strict=True)
        ]


def _flown(case: Case, end: float, coarse: bool) -> _Flight:
    """The flight whose filter is analysed, up to `end`, s."""
    # levels are those of the receiver's own fixes, whatever the filter is given here
    unwatched = replace(case, scenario=case.scenario.model_copy(update={"integrity": None}))
    receiver, imu = case.scenario.receiver.rate_hz, case.scenario.imu.rate_hz
    return _flight(unwatched, end, *((COARSE_FIXES, COARSE_IMU) if coarse else (receiver, imu)))


def _watched(case: Case, coarse: bool) -> _Flight:
    """The flight whose fixes are watched, on the glide."""
    end, scenario = touchdown_time(case.scenario, case.trajectory), case.scenario
    flight = _flight(case, end, scenario.receiver.rate_hz, scenario.imu.rate_hz)
    glide = np.flatnonzero(integrity.glide_of(flight.case))
    epochs = spread_over(glide, MOST_LEVELS) if coarse else glide
    if flight.case.world.signals.smoothing is not None or flight.case.environment.jamming is not None:
        return replace(flight, watched=epochs)  # what a receiver remembers has to be gone through
    return replace(flight, motion=case.trajectory.motion(flight.case.world.signals.time[epochs]))


def _flight(case: Case, end: float, fix_rate: float, imu_rate: float) -> _Flight:
    """The flight up to the first fix after `end`, s, with at most these rates, Hz."""
    scenario = case.scenario
    receiver, imu = scenario.receiver, scenario.imu
    fix_rate, imu_rate = min(fix_rate, receiver.rate_hz), min(imu_rate, imu.rate_hz)
    # the error at a height is interpolated to the output after it
    duration = min(end + receiver.latency_s + 1.0 / fix_rate + 1.0 / imu_rate, scenario.duration_s)
    scenario = scenario.model_copy(
        update={
            "duration_s": duration,
            "receiver": receiver.model_copy(update={"rate_hz": fix_rate}),
            "imu": imu.model_copy(update={"rate_hz": imu_rate}),
        }
    )
    sources: Environment = replace(
        case.environment,
        satellites=tuple(replace(g, constellation=Remembering(g.constellation)) for g in case.environment.satellites),
    )
    world = world_of(scenario, case.trajectory, sources)
    return _Flight(
        replace(case, scenario=scenario, environment=sources).over(world),
        case.trajectory.motion(world.signals.time),
        np.any(world.signals.used, axis=0),
        math.sqrt(fix_rate / receiver.rate_hz),
    )
