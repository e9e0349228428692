"""What a search for placements makes small: an objective of the geometry, or an error of the filter.

An error of the filter is a linear covariance analysis of every placement. What does not depend on it is done once: the
flight (cut where the objective no longer looks), the orbits, the sources that are ever heard. It is to be had in three
ways, each much dearer as the one before and closer to the truth [1]:

    screens     accuracy of fixes by the geometry kernel: over the last seconds before the objective is read, the glide
    coarse      covariance analysis with a fix a second of the same information, inertial samples at 10 Hz
    objective   covariance analysis as a landing by itself has it

Source: [1] Peherstorfer, Willcox & Gunzburger, Survey of multifidelity methods in uncertainty propagation, inference,
and optimization, SIAM Review 60 (2018).
"""

from __future__ import annotations

import datetime
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from navsim.io.findings import Finding
from navsim.io.schema import HEIGHTS, RMS_WINDOW
from navsim.models import timescales
from navsim.models.constellation import Remembering
from navsim.models.kinematics import Motion
from navsim.models.signals import Environment, build_signals
from navsim.scenario.base import validated
from navsim.scenario.landing import Landing
from navsim.scenario.optimize import DOP_OBJECTIVES, Optimize
from navsim.scenario.source import Document, InputError, Problem, set_value
from navsim.simulation.geometry import Geometry, glide_geometry
from navsim.study.landing import Case, covariance_analysis, covariance_findings, covariance_summary, prepare
from navsim.study.landing.case import (
    Ask,
    crossing_times,
    environment,
    glide_epochs,
    touchdown_time,
    world_of,
)
from navsim.study.placement import Rules, rules
from navsim.study.sweep import filter_outputs

BROKEN = 1e9
"""Objective of a placement that breaks a rule by nothing; more for worse."""
UNSOLVED = 1e8
"""Objective of a placement that keeps the rules and leaves an epoch without a fix."""
COARSE_FIXES = 1.0
"""Rate of fixes of the coarse analysis, Hz."""
COARSE_IMU = 10.0
"""Inertial samples of the coarse analysis, Hz."""
_TRACK, _TRACK_MARGIN = 12.0, 0.3
"""Spacing of the points of the approach that rough rules ask, m, and their margin: 60 m from the aircraft, the nearest
point is by no more than that nearer than the nearest of those asked."""
_STRETCHES = (30.0, 15.0, 5.0)
"""Where the glide is divided to describe its geometry, s before the objective is read."""
_NO_FIX = 1e4
"""What an epoch without a fix counts as in ranking placements by their geometry, m."""

Judge = Callable[[np.ndarray], np.ndarray]
"""Values (n,) of placements (n, k, 2); smaller is better, not finite without a solution."""


@dataclass(frozen=True)
class PlacementProblem:
    """An objective with its rules, and warnings about the sky.

    For an error of the filter: coarse, its quick judge; screens and features, what the geometry says of it (features:
    (n, f) of placements (n, k, 2), finite); found, the findings of a placement (k, 2). None and none for objectives of
    geometry.
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

    @property
    def flown(self) -> bool:
        """Whether the objective is an error of the filter."""
        return self.coarse is not None

    def value(self, places: np.ndarray, judge: Judge | None = None) -> np.ndarray:
        """What a search makes small (n,): the judge's value, or the objective, where rules are kept, else how badly
        they are broken. Below UNSOLVED all rules are kept and there is a solution."""
        return _ranked(places, self.rules.violation(places), judge or self.objective)

    def rough_value(self, places: np.ndarray, judge: Judge) -> np.ndarray:
        """The same by rules that ask fewer points of the approach, and a margin that makes up for it."""
        rough, margin = self._rough_rules
        return _ranked(places, rough.violation(places) + margin, judge)

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


def problem(study: Optimize, document: Document, base: Document, ask: Ask = lambda *_: None) -> PlacementProblem:
    """The base scenario, the rules and the objective of a study, once `ask` has let it pass. Raises InputError, and
    what `ask` raises."""
    bare = base.copy()
    for key in ("count", "s_m", "l1_m", "sites"):
        if isinstance(bare.data.get("pseudolites"), dict):
            bare.data["pseudolites"].pop(key, None)
    set_value(bare, "pseudolites.count", 0, document.place(("base",)), document.folder)
    if study.objective not in DOP_OBJECTIVES:
        set_value(bare, "method", "covariance", document.place(("objective",)), document.folder)
    scenario = validated(Landing, bare)
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
    if study.objective in DOP_OBJECTIVES:
        objective = partial(_of_geometry, study.objective, geometry, kept)
        return PlacementProblem(study, scenario, kept, geometry, objective, warnings)
    case = prepare(scenario, bare)
    end = _read_at(study.objective, case)
    if not math.isfinite(end):
        place = document.place(("objective",))
        text = f"'{study.objective}' has no value: the flight of {study.base} does not pass there within duration_s"
        raise InputError([Problem(place, "objective", f"{text}: {case.scenario.duration_s:g}")])
    flight = _flight(case, end, case.scenario.receiver.rate_hz, case.scenario.imu.rate_hz)
    return PlacementProblem(
        study, scenario, kept, geometry,
        flight.judge(study.objective, kept),
        warnings,
        _flight(case, end, COARSE_FIXES, COARSE_IMU).judge(study.objective, kept),
        _screens(study.objective, geometry, epochs, end, kept),
        _features(geometry, epochs, end, kept),
        partial(flight.findings, kept),
    )  # fmt: skip


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


def _ranked(places: np.ndarray, broken: np.ndarray, judge: Judge) -> np.ndarray:
    out = np.where(broken > 0.0, BROKEN * (1.0 + np.maximum(broken, 0.0)), np.nan)
    kept = broken <= 0.0
    if np.any(kept):
        values = judge(places[kept])
        out[kept] = np.where(np.isfinite(values), values, UNSOLVED)
    return out


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
    row = 2 if name.startswith("vertical") else 1

    def screen(of: int, part: Geometry, places: np.ndarray) -> np.ndarray:
        values, lost = part.fix_sigmas(kept.plane.ecef(places))
        return np.where(lost < len(part.receiver), values[of, 0] + _NO_FIX * lost, np.inf)

    parts = (row, _some(geometry, late)), (row, _some(geometry, before)), (0, _some(geometry, late))
    return tuple(partial(screen, *part) for part in parts)


def _features(geometry: Geometry, time: np.ndarray, end: float, kept: Rules) -> Judge:
    """Logarithms of the mean SKO of fixes in space, horizontal, vertical, and epochs without a fix, over stretches of
    the glide before `end`: the filter forgets the earlier ones, by how much differs."""
    edges = (-math.inf, *(end - before for before in _STRETCHES), end)
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
    in one of these, as a factor of its sigmas.
    """

    case: Case
    motion: Motion
    heard: np.ndarray
    share: float

    def judge(self, name: str, kept: Rules) -> Judge:
        """The judge of placements by an error of the filter."""

        def one(places: np.ndarray) -> float:
            here = self.with_pseudolites(kept.plane.llh(places))
            return filter_outputs(covariance_summary(here, covariance_analysis(here)))[name]

        return lambda places: np.array([one(p) for p in places])

    def findings(self, kept: Rules, places: np.ndarray) -> list[Finding]:
        """What the covariance analysis of a placement (k, 2) finds."""
        here = self.with_pseudolites(kept.plane.llh(places))
        return covariance_findings(here, covariance_analysis(here))

    def with_pseudolites(self, llh: np.ndarray) -> Case:
        """The case with pseudolites at (k, 3) rad, rad, m; of its world only the signals know of them."""
        names = tuple(f"PL{i}" for i in range(1, len(llh) + 1))
        sources = replace(self.case.environment, pseudolites=replace(self.case.pseudolites, names=names, llh=llh))
        signals = build_signals(self.motion, self.case.scenario.epoch.timestamp(), sources)
        signals = signals.select(np.concatenate([self.heard, np.full(len(llh), True)]))
        # fewer epochs have less to smooth already
        share = self.share if signals.smoothing is None else self.share**2
        signals = replace(
            signals, sigma=share * signals.sigma, rate_sigma=self.share * signals.rate_sigma,
            fix_sigma=share * signals.fix_sigma,
        )  # fmt: skip
        return replace(self.case, environment=sources).over(replace(self.case.world, signals=signals))


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
