"""Analysis of a placement of pseudolites or beacons: covariance of the flight, and protection levels of its fixes.

The satellites' part does not depend on them. A case without them is prepared once, and placements are added to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from navsim.environment.sources import touchdown_time
from navsim.gnss.constellations.constellation import CachedConstellation
from navsim.gnss.pseudorange import Signals
from navsim.gnss.signals import SignalScenario, build_signals
from navsim.gnss.sky import enu_matrix
from navsim.landing import integrity
from navsim.landing.case import Case, case_of, world_of
from navsim.landing.confirmation import filter_outputs
from navsim.landing.covariance import (
    covariance_analysis,
    covariance_findings,
    covariance_summary,
    judged_without_runs,
)
from navsim.landing.integrity import spread_over
from navsim.landing.requirements import RequirementValue, sizes_of
from navsim.optimization.placement import ObjectiveFunction, Rules, RunwayPlane
from navsim.optimization.scenario import LEVEL_OBJECTIVES
from navsim.results.findings import Finding
from navsim.results.schema import LARGE
from navsim.scenario.beacons import BeaconsSection
from navsim.scenario.requirements import (
    AccuracyRequirement,
    AvailabilityRequirement,
    LevelRequirement,
    ThresholdRequirement,
    singles,
)
from navsim.scenario.transmitters import Site
from navsim.simulation.aiding import aids_of
from navsim.simulation.landing_covariance import Analysis
from navsim.trajectory.kinematics import Motion

COARSE_FIXES = 1.0
"""Rate of fixes of the coarse analysis, Hz."""
COARSE_RANGES = 4.0
"""Ranges a second to all beacons together in the coarse analysis, of the same information, Hz."""
COARSE_IMU = 10.0
"""Inertial samples of the coarse analysis, Hz."""
SCREENED = 8
"""Epochs of the glide by which levels of many placements are screened."""
_AT_ONCE = 2048
"""Epochs of all placements together that are screened at a time."""


@dataclass(frozen=True)
class Prepared:
    """A flight without pseudolites, to which placements are added."""

    case: Case
    motion: Motion
    heard: np.ndarray
    """(s,) bool, sources that are ever tracked."""
    share: float
    """Information of one of the receiver's fixes relative to one of these, as a factor on its sigmas."""
    watched: np.ndarray | None = None
    """(m,) fix epochs that remain if only levels count, of more; else None."""
    names: tuple[str, ...] | None = None
    """Names of the pseudolites; None for PL1, PL2, ..."""

    @property
    def axes(self) -> np.ndarray:
        """East, north, up at the epochs that are left (m, 3, 3) rows, ECEF."""
        axes = enu_matrix(self.motion.llh)
        return axes if self.watched is None else axes[self.watched]

    def with_sites(self, llh: np.ndarray) -> Case:
        """The case with pseudolites at (k, 3) rad, rad, m; of its world only the signals know of them."""
        names = self.names or tuple(f"PL{i}" for i in range(1, len(llh) + 1))
        sources = replace(self.case.environment, pseudolites=replace(self.case.pseudolites, names=names, llh=llh))
        signals = build_signals(self.motion, self.case.scenario.epoch.timestamp(), sources)
        signals = signals.select(np.concatenate([self.heard, np.full(len(llh), True)]))
        if self.watched is not None:
            signals = signals.at(self.watched)
        signals = self.thinned(signals)
        return replace(self.case, environment=sources).over(replace(self.case.shared, signals=signals))

    def thinned(self, signals: Signals) -> Signals:
        """Signals with the noise of so much fewer fixes of the same information."""
        if self.share == 1.0:
            return signals
        # fewer epochs have less to smooth already
        return signals.with_noise(self.share if signals.smoothing is None else self.share**2, self.share)


@dataclass(frozen=True)
class BeaconFlight:
    """A flight without beacons, to which placements of them are added."""

    flight: Prepared
    section: BeaconsSection
    """The beacons, whose sites are those of the placement."""

    @classmethod
    def of(cls, case: Case, section: BeaconsSection, end: float, coarse: bool) -> BeaconFlight:
        """The flight up to `end`, s, with its filter to be analysed; see `flown`."""
        flight = flown(case, end, coarse)
        if not coarse or section.rate_hz <= COARSE_RANGES:
            return cls(flight, section)
        share = math.sqrt(COARSE_RANGES / section.rate_hz)
        scenario, noise = flight.case.scenario, ("sigma_m", "weak_sigma_m")
        less = {key: share * getattr(section, key) for key in noise}
        its = scenario.filter.beacons
        of_filter = {key: share * value for key in noise if (value := getattr(its, key)) is not None}
        own = scenario.filter.model_copy(update={"beacons": its.model_copy(update=of_filter)})
        case = replace(flight.case, scenario=scenario.model_copy(update={"filter": own}))
        return cls(replace(flight, case=case), section.model_copy(update={"rate_hz": COARSE_RANGES, **less}))

    def with_sites(self, llh: np.ndarray) -> Case:
        """The case with beacons at (k, 3) rad, rad, m."""
        case, ground = self.flight.case, self.flight.case.scenario.runway.ellipsoidal_m
        sites = tuple(
            Site(lat_deg=math.degrees(lat), lon_deg=math.degrees(lon), height_m=height - ground)
            for lat, lon, height in llh
        )
        placed = self.section.model_copy(update={"sites": sites}) if sites else None
        scenario = case.scenario.model_copy(update={"beacons": placed})
        aids = aids_of(scenario.aiding(), case.trajectory, scenario.duration_s, scenario.imu.rate_hz)
        shared = replace(case.shared, aids=aids, signals=self.flight.thinned(case.shared.signals))
        return case_of(scenario, case.trajectory, case.environment, shared)


class FidelityEvaluator:
    """Evaluation of placements at one fidelity.

    flown: for the filter, with pseudolites or beacons; watched: for levels; None if not needed. The last placement and
    the one without sources are cached, since objective and requirements need the same.
    """

    def __init__(self, kept: Rules, flown: Prepared | BeaconFlight | None, watched: Prepared | None) -> None:
        self._kept, self._flown, self._watched = kept, flown, watched
        self._kept_found: dict[bytes, _Found] = {}

    def _of(self, places: np.ndarray) -> _Found:
        key = np.ascontiguousarray(places, np.float64).tobytes()
        if key not in self._kept_found:
            llh = self._kept.plane.llh(places)
            cases = [None if flight is None else flight.with_sites(llh) for flight in (self._flown, self._watched)]
            without = {some: self._kept_found[some] for some in (b"",) if some in self._kept_found}
            self._kept_found = {**without, key: _Found(*cases)}
        return self._kept_found[key]

    def judge(self, name: str) -> ObjectiveFunction:
        """Evaluator of placements by an error of the filter, or by levels.

        With levels: large for a small fraction of epochs that have them; for other statistics inf unless all epochs
        have them.
        """

        def one(places: np.ndarray) -> float:
            found = self._of(places)
            if name not in LEVEL_OBJECTIVES:
                return found.errors[name]
            share = found.levels["level_share"]
            if name in LARGE:
                return 1.0 / share if share > 0.0 else math.inf
            return found.levels[name] if share == 1.0 else math.inf

        return lambda places: np.array([one(p) for p in places])

    def fulfilments(self, places: np.ndarray) -> list[RequirementValue]:
        """Values of the base scenario's requirements for a placement (k, 2)."""
        return self._of(places).fulfilments

    def findings(self, places: np.ndarray) -> list[Finding]:
        """Findings of the covariance analysis of a placement (k, 2)."""
        found = self._of(places)
        assert found.flown is not None
        return covariance_findings(found.flown, found.analysis)


class LevelScreen:
    """Levels of many placements at once, at some epochs of the glide: objectives and loads for ranking.

    The signal of a pseudolite must not depend on its position, nor on its number. decided: requirements of the scenario
    that count (q,) bool, None for none.
    """

    def __init__(self, plane: RunwayPlane, flight: Prepared, name: str, decided: np.ndarray | None) -> None:
        self._plane, self._flight, self._name = plane, flight, name
        asked = singles(flight.case.scenario.requirements)
        self._asked = [] if decided is None else [one for (_, one), use in zip(asked, decided, strict=True) if use]

    def __call__(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Objectives, if they are levels, and loads (n,) of placements (n, k, 2)."""
        step = max(_AT_ONCE // SCREENED, 1)
        parts = [self._of(places[i : i + step]) for i in range(0, len(places), step)]
        objective, load = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return objective, load

    def _of(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        n, k = places.shape[:2]
        case = self._flight.with_sites(self._plane.llh(places[0]))
        signals, watching = case.shared.signals, case.flight.watching
        assert watching is not None
        e, s = signals.used.shape
        away = self._plane.ecef(places)[:, None] - signals.antenna[:, None]
        towards = away / np.linalg.norm(away, axis=-1, keepdims=True)
        los = np.repeat(signals.los[None], n, axis=0)
        los[:, :, s - k :] = np.einsum("eij,nekj->neki", self._flight.axes, towards)
        stacked = replace(
            signals, los=los.reshape(n * e, s, 3), used=np.tile(signals.used, (n, 1)),
            fix_sigma=np.tile(signals.fix_sigma, (n, 1)),
        )  # fmt: skip
        monitor = watching.over(stacked)
        levels = np.where(monitor.tested[:, None] & np.isfinite(monitor.levels), monitor.levels, np.inf)
        levels = levels.reshape(n, e, 2)
        relative = None
        if any(isinstance(one, AvailabilityRequirement) for one in self._asked):
            asked = integrity.approach_limits(case)
            assert asked is not None
            relative = np.sort(integrity.relative_levels(asked, levels), axis=1)
        levels = np.sort(levels, axis=1)
        load = self._load(levels, relative)
        for one in self._asked:
            if isinstance(one, ThresholdRequirement | AccuracyRequirement):
                sizes = sizes_of(one, watching, monitor)
                assert sizes is not None  # unknown requirements are not decided
                ordered = np.sort(np.where(np.isnan(sizes), np.inf, sizes).reshape(n, e), axis=1)
                load = np.maximum(load, ordered[:, _kept_by(one.share, e)] / one.below_m)
        return self._objective(levels), load

    def _objective(self, levels: np.ndarray) -> np.ndarray:
        """Objective from levels (n, e, 2), the smallest first."""
        if self._name in LARGE:
            share = np.isfinite(levels).all(axis=2).mean(axis=1)
            return np.divide(1.0, share, out=np.full(share.shape, np.inf), where=share > 0.0)
        of = levels[..., 0 if self._name.startswith("hpl") else 1]
        return of[:, -1] if self._name.endswith("max") else of[:, _kept_by(0.95, of.shape[1])]

    def _load(self, levels: np.ndarray, relative: np.ndarray | None) -> np.ndarray:
        """Largest utilisation (n,) of the requirements on levels (n, e, 2), m, also relative to alert limits, in
        order."""
        load = np.zeros(len(levels))
        for one in self._asked:
            if isinstance(one, LevelRequirement):
                at = _kept_by(one.share, levels.shape[1])
                load = np.maximum(load, levels[:, at, 0 if one.of == "hpl" else 1] / one.below_m)
            elif isinstance(one, AvailabilityRequirement):
                assert relative is not None
                load = np.maximum(load, relative[:, _kept_by(one.at_least, levels.shape[1])].max(axis=1))
        return load


def _kept_by(share: float, epochs: int) -> int:
    """Index of the ordered value at so many epochs that this fraction of them does not exceed."""
    return int(np.searchsorted(np.arange(1, epochs + 1) / epochs, share))


@dataclass(frozen=True)
class _Found:
    """A placement's flight and monitor."""

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
    def fulfilments(self) -> list[RequirementValue]:
        """By whichever of them knows."""
        known = []
        if self.watched is not None:
            known.append(judged_without_runs(self.watched, None))
        if self.flown is not None:
            known.append(judged_without_runs(self.flown, self.analysis))
        return [
            next((one for one in each if not math.isnan(one.utilisation)), each[0]) for each in zip(*known, strict=True)
        ]


def flown(case: Case, end: float, coarse: bool) -> Prepared:
    """The flight whose filter is analysed, up to `end`, s."""
    # levels are those of the receiver's own fixes, whatever fixes the filter uses here
    unwatched = replace(case, scenario=case.scenario.model_copy(update={"integrity": None}))
    receiver, imu = case.scenario.receiver.rate_hz, case.scenario.imu.rate_hz
    return _flight(unwatched, end, *((COARSE_FIXES, COARSE_IMU) if coarse else (receiver, imu)))


def watched(case: Case, most: int | None = None) -> Prepared:
    """The flight with monitored fixes, on the glide, at so many epochs at most."""
    return _watched(case, lambda glide: glide if most is None else spread_over(glide, most))


def screened(case: Case) -> Prepared:
    """`watched` at the middles of some stretches of the glide, where code smoothing has settled."""
    return _watched(case, lambda glide: glide[np.unique((2 * np.arange(SCREENED) + 1) * glide.size // (2 * SCREENED))])


def glimpsed(case: Case) -> Prepared:
    """`screened` for interactive pictures, with code smoothing.

    Loop memory covers only the epoch before, as long ago as lost signals wait, instead of the whole approach.
    """
    prepared = screened(case)
    if prepared.watched is None or prepared.case.shared.signals.smoothing is not None:
        return prepared
    jamming, time = prepared.case.environment.jamming, prepared.case.shared.signals.time
    assert jamming is not None  # else nothing is remembered
    wait = max(jamming.lock.lose_s, jamming.lock.regain_s)
    before = np.searchsorted(time, time[prepared.watched] - wait, side="right") - 1
    kept = np.union1d(prepared.watched, np.maximum(before, 0))
    motion = case.trajectory.motion(time[kept])
    return replace(prepared, motion=motion, watched=np.searchsorted(kept, prepared.watched))


def _watched(case: Case, chosen: Callable[[np.ndarray], np.ndarray]) -> Prepared:
    end, scenario = touchdown_time(case.scenario, case.trajectory), case.scenario
    flight = _flight(case, end, scenario.receiver.rate_hz, scenario.imu.rate_hz)
    epochs = chosen(np.flatnonzero(integrity.glide_of(flight.case)))
    if flight.case.shared.signals.smoothing is not None or flight.case.environment.jamming is not None:
        return replace(flight, watched=epochs)  # a receiver with memory must be simulated throughout
    return replace(flight, motion=case.trajectory.motion(flight.case.shared.signals.time[epochs]))


def _flight(case: Case, end: float, fix_rate: float, imu_rate: float) -> Prepared:
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
    sources: SignalScenario = replace(
        case.environment,
        satellites=tuple(
            replace(g, constellation=CachedConstellation(g.constellation)) for g in case.environment.satellites
        ),
    )
    shared = world_of(scenario, case.trajectory, sources)
    return Prepared(
        replace(case, scenario=scenario, environment=sources).over(shared),
        case.trajectory.motion(shared.signals.time),
        np.any(shared.signals.used, axis=0),
        math.sqrt(fix_rate / receiver.rate_hz),
    )
