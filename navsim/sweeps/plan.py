"""Plan of a sweep: axes, settings and files of its combinations."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from navsim.environment.sources import environment, glide_epochs
from navsim.geodesy.earth import in_heading_axes
from navsim.gnss.pseudolite import Track
from navsim.gnss.signals import SignalScenario
from navsim.landing.plausibility import one_direction, plausibility_warnings
from navsim.landing.preflight import on_pavement
from navsim.landing.requirements import Statement, statements
from navsim.landing.study import (
    Case,
)
from navsim.results import files
from navsim.runner.checkpoint import CheckpointError
from navsim.scenario.approach import FileApproach
from navsim.scenario.landing import Landing
from navsim.scenario.load import NO_RECORDED
from navsim.scenario.site_clearance import track_of
from navsim.scenario.sky import SOURCES_FROM_FILES
from navsim.scenario_files.base import DEG, validated
from navsim.scenario_files.source import Document, InputError, KeyPath, Problem, dotted, set_value
from navsim.simulation.placement_geometry import Geometry, glide_geometry
from navsim.sweeps.scenario import (
    BEACON_OUTPUTS,
    FILTER_OUTPUTS,
    LEVEL_OUTPUTS,
    REQUIREMENTS,
    WATCHED_OUTPUTS,
    Sweep,
    Vary,
)
from navsim.trajectory.kinematics import Frame, Trajectory

MOVES = tuple(f"pseudolites.{key}" for key in ("count", "s_m", "l1_m", "height_m", "frame", "sites"))
"""Keys that move pseudolites and nothing else."""
PLACE_KEYS = ("pseudolites.s_m", "pseudolites.l1_m")
"""Keys of distances, m, that determine the positions of pseudolites."""
NAME_FILES = ("source", "horizon", *SOURCES_FROM_FILES)
"""Keys of the sky that name files, including those below them."""
OWN_DIMENSIONS = ("finding", "interval", "point", "rejected", "sample", "site")
"""Dimensions of a result that are no axes named by keys."""
UNUSABLE = "unusable"
MOST_MAP_SITES = 8


@dataclass(frozen=True)
class Axis:
    """One axis of the study: its dimension, its keys, and for each point the values of the keys."""

    name: str
    keys: tuple[str, ...]
    points: list[tuple[Any, ...]]


def axes(study: Sweep, seed: int) -> list[Axis]:
    """The axes; those of a Latin hypercube become one, drawn with the seed."""
    out: list[Axis] = []
    cube = [axis for axis in study.vary if axis.lhs is not None]
    if cube:
        from scipy.stats.qmc import LatinHypercube

        assert study.samples is not None
        unit = LatinHypercube(len(cube), rng=np.random.default_rng(seed)).random(study.samples)
    for vary in study.vary:
        if vary.lhs is None:
            out.append(Axis(_name(study, vary), vary.names(), _points(vary)))
        elif vary is cube[0]:
            bounds = np.array([[a.lhs.first, a.lhs.last] for a in cube if a.lhs is not None])
            values = bounds[:, 0] + unit * (bounds[:, 1] - bounds[:, 0])
            keys = tuple(name for a in cube for name in a.names())
            out.append(Axis("sample", keys, [tuple(float(x) for x in row) for row in values]))
    return out


def _points(vary: Vary) -> list[tuple[Any, ...]]:
    if vary.keys is not None:
        return [tuple(row) for row in vary.values or ()]
    spread = vary.grid or vary.range
    return [(value,) for value in (spread.numbers() if spread is not None else vary.values or ())]


def short(study: Sweep, key: str) -> str:
    """Name of a key in the result: its last part, if that is unique in the study and the result."""
    taken = [*OWN_DIMENSIONS, *(name.rsplit(".", 1)[-1] for vary in study.vary for name in vary.names())]
    last = key.rsplit(".", 1)[-1]
    return last if taken.count(last) == 1 else key.replace(".", "_")


def _name(study: Sweep, vary: Vary) -> str:
    if vary.key is not None:
        return short(study, vary.key)
    return "_and_".join(short(study, key) for key in vary.names())


@dataclass(frozen=True)
class Plan:
    """A study ready to be computed: the base as a document that may be copied and changed."""

    study: Sweep
    document: Document
    base: Document
    seed: int
    axes: list[Axis]

    @property
    def shape(self) -> tuple[int, ...]:
        """Points of each axis."""
        return self.study.shape

    @property
    def size(self) -> int:
        """Number of combinations."""
        return self.study.combinations

    @property
    def batch(self) -> int:
        """Combinations a batch: tenths of a second to seconds of work. With jammers one alone takes a quarter."""
        return 1000 if self.geometry_alone else 5 if self.study.method == "dop" else 1

    def settings(self, index: int) -> dict[str, Any]:
        """Keys and values of one combination, the last axis fastest."""
        place = np.unravel_index(index, self.shape)
        return _settings(self.axes, [axis.points[int(i)] for axis, i in zip(self.axes, place, strict=True)])

    def scenario(self, settings: dict[str, Any]) -> tuple[Landing, Document]:
        """Scenario of one combination. Raises InputError if it is invalid, or unsuitable for a study."""
        document = self._changed(settings)
        scenario = validated(Landing, document)
        if isinstance(scenario.approach, FileApproach):
            key = ("approach", "profile")
            raise InputError([Problem(document.place(key), dotted(key), NO_RECORDED)])
        return scenario, document

    def _changed(self, settings: dict[str, Any]) -> Document:
        """The base with these settings. Raises InputError if they are impossible."""
        document = self.base.copy()
        for key, value in settings.items():
            place = self.document.place(("vary", self._axis_of(key)))
            set_value(document, key, copy.deepcopy(value), place, self.document.folder)
        return document

    def _axis_of(self, key: str) -> int:
        return next(i for i, vary in enumerate(self.study.vary) if key in vary.names())

    @cached_property
    def first(self) -> tuple[Landing, Document]:
        """First valid combination. Raises the InputError of the first one if none of the first points is valid."""
        error: InputError | None = None
        for index in range(min(self.size, 1000)):
            try:
                return self.scenario(self.settings(index))
            except InputError as problem:
                error = error or problem
        assert error is not None
        raise error

    def invalid(self, most: int) -> tuple[int, list[tuple[dict[str, Any], InputError]]]:
        """Number of combinations checked, and the invalid ones, each with its errors.

        It checks all combinations, or about `most` spread evenly, and every point of every axis beside the first points
        of the others.
        """
        few = min(most, self.size)
        chosen = {i * (self.size - 1) // max(few - 1, 1) for i in range(few)}
        steps = np.cumprod((1, *self.shape[:0:-1]))[::-1]
        alone = {int(step) * i for step, points in zip(steps, self.shape, strict=True) for i in range(points)}
        wrong = []
        looked = sorted({*chosen, *alone})
        for index in looked:
            try:
                self.scenario(self.settings(index))
            except InputError as error:
                wrong.append((self.settings(index), error))
        return len(looked), wrong

    @property
    def requirements(self) -> list[Statement]:
        """Requirements that every combination is evaluated by; empty if they are no output."""
        return statements(self.first[0]) if REQUIREMENTS in self.study.wanted() else []

    @property
    def common_requirements(self) -> list[Statement]:
        """Requirements of all combinations; empty if they differ."""
        varied = any(key.split(".")[0] == REQUIREMENTS for vary in self.study.vary for key in vary.names())
        return [] if varied else statements(self.first[0])

    @cached_property
    def trajectory(self) -> Trajectory:
        """The aircraft's motion in the first combination."""
        return self.first[0].trajectory()

    @property
    def frame(self) -> Frame:
        """The frame of the first combination's touchdown point."""
        return self.trajectory.frame

    @cached_property
    def track(self) -> Track:
        """The aircraft during the first combination's simulation, see `track_of`."""
        return track_of(self.first[0], self.trajectory)

    def plane(self, ecef: np.ndarray) -> np.ndarray:
        """Positions (..., 3) ECEF in the plane of the runway: along it from the threshold, right of it (..., 2), m."""
        scenario = self.first[0]
        return in_heading_axes(ecef, scenario.threshold(self.frame), scenario.runway.heading_deg * DEG)[..., :2]

    def in_plan(self, site: np.ndarray) -> np.ndarray:
        """The first sites (k, 3) of a combination in that plane, (MOST_MAP_SITES, 2), nan for none."""
        out = np.full((MOST_MAP_SITES, 2), np.nan)
        shown = site[:MOST_MAP_SITES]
        out[: len(shown)] = self.plane(shown)
        return out

    @cached_property
    def geometry_alone(self) -> bool:
        """Whether all combinations only move pseudolites, without effect on other signals, and need no filter."""
        moves = self.study.method == "dop" and all(key in MOVES for axis in self.axes for key in axis.keys)
        moves &= not set(self.study.wanted()) & {*LEVEL_OUTPUTS, *BEACON_OUTPUTS, REQUIREMENTS}
        return moves and not self.sources.depends_on_pseudolite_sites and not self.sources.singled_out

    @cached_property
    def geometry(self) -> Geometry | None:
        """Common geometry of combinations that only move pseudolites and need no filter, else None."""
        if not self.geometry_alone:
            return None
        sources, scenario, _ = self._environment
        trajectory, utc = scenario.trajectory(), np.array([scenario.epoch.timestamp()])
        return glide_geometry(trajectory, sources, utc, *glide_epochs(scenario, trajectory))

    @cached_property
    def _environment(self) -> tuple[SignalScenario, Landing, list[str]]:
        return environment(*self.first)

    @property
    def sources(self) -> SignalScenario:
        """The sources of signals of the first combination."""
        return self._environment[0]

    def spread(self, most: int) -> list[Landing]:
        """Scenarios of up to `most` combinations spread evenly over the study, the first valid one among them."""
        found = [self.first[0]]
        for i in range(most):
            try:
                found.append(self.scenario(self.settings(i * (self.size - 1) // max(most - 1, 1)))[0])
            except InputError:
                continue  # no valid scenario: it will be nan in the result
        return found

    @property
    def pinned(self) -> Landing:
        """The scenario of the first combination with the checksums of its files. Raises InputError."""
        return self._environment[1]

    @cached_property
    def warnings(self) -> list[str]:
        """Warnings about the sky, the flight and the sensors of the first combination."""
        _, scenario, warnings = self._environment
        moves = any(key.startswith("pseudolites.") for axis in self.axes for key in axis.keys)
        fixed = []
        if not moves:  # its DOPs evaluate the moved pseudolites
            fixed = one_direction(scenario, self.trajectory) + on_pavement(scenario, self.trajectory)
        unused = []
        if scenario.requirements and REQUIREMENTS not in self.study.wanted():
            flies = self.study.method == "covariance" and set(self.study.wanted()) & set(FILTER_OUTPUTS)
            but = "; navsim judges by them only the best combinations that it flies" if flies else ""
            unused = [
                f"the sweep has no verdicts on the requirements of {self.study.base}{but}. For a verdict on each "
                "combination, add `requirements` to `outputs`"
            ]
        moved = [key for axis in self.axes for key in axis.keys if key.startswith("beacons")]
        if moved and self.study.method == "dop" and not set(self.study.wanted()) & {*BEACON_OUTPUTS, REQUIREMENTS}:
            unused.append(
                f"vary: {moved[0]} changes no output: these are of satellites and pseudolites. Add beacons_vdop or "
                "other ones of beacons to `outputs`, or use method covariance"
            )
        return [*warnings, *plausibility_warnings(scenario, self.trajectory), *fixed, *unused]

    def warnings_of(self, case: Case) -> list[str]:
        """Warnings about the input of a combination that are not the study's."""
        scenario, flown = case.scenario, case.trajectory
        mine = case.warnings
        if self.study.method == "dop":  # geometry alone does not give values that are undefined without a touchdown
            mine = [*case.sky_warnings, *plausibility_warnings(scenario, flown), *on_pavement(scenario, flown)]
        # a lone pseudolite is a separate finding
        told = {*self.warnings, *case.preflight.lone_pseudolite, *one_direction(scenario, flown)}
        return [text for text in mine if text not in told]

    @cached_property
    def files(self) -> dict[str, str]:
        """Checksums of the files of the sky that combinations name; UNUSABLE for those that cannot be read."""
        found: dict[str, str] = {}
        varied = [axis for axis in self.axes if any(map(_names_files, axis.keys))]
        for points in itertools.product(*(axis.points for axis in varied)):
            try:
                document = self._changed(_settings(varied, points))
            except InputError:
                continue  # no scenario, so it names no files
            for key, name in _files_in(document):
                if name not in found:
                    found[name] = _checksum(document, key, name)
        return found

    def check_files(self, index: int) -> None:
        """Raise CheckpointError if a file of a combination has changed since the start, or the worker cannot read
        it."""
        try:
            document = self._changed(self.settings(index))
        except InputError:
            return  # no scenario, so it names no files
        for key, name in _files_in(document):
            if _checksum(document, key, name) != self.files[name]:
                raise CheckpointError(f"{document.resolve(key, name)} was changed while the study ran, or is not there")


def _settings(axes: Sequence[Axis], points: Sequence[tuple[Any, ...]]) -> dict[str, Any]:
    """Keys and values at one point of each of some axes."""
    return {
        key: value
        for axis, point in zip(axes, points, strict=True)
        for key, value in zip(axis.keys, point, strict=True)
    }


def _names_files(key: str) -> bool:
    section, _, rest = key.partition(".")
    return section == "sky" and (not rest or rest.split(".")[0] in NAME_FILES)


def _files_in(document: Document) -> list[tuple[KeyPath, str]]:
    """The files of the sky that a scenario names, with their keys."""
    sky = document.data.get("sky")
    if not isinstance(sky, dict):
        return []
    named = {"horizon": sky.get("horizon")}
    if (source := sky.get("source")) in SOURCES_FROM_FILES:
        named[str(source)] = sky.get(source)
    each = ((key, name) for key, names in named.items() for name in (names if isinstance(names, list) else [names]))
    return [(("sky", key), name) for key, name in each if isinstance(name, str)]


def _checksum(document: Document, key: KeyPath, name: str) -> str:
    try:
        return files.checksum(document.resolve(key, name))
    except (OSError, InputError):
        return UNUSABLE


def plan(study: Sweep, document: Document, base: Document, seed: int) -> Plan:
    """Check that the keys can be varied at all, and read the files. Raises InputError."""
    for i, vary in enumerate(study.vary):
        for key in vary.names():
            document.present(tuple(key.split(".")), document.place(("vary", i)), base.data.get("kind"))
    if study.method != "dop":
        base = base.copy()
        set_value(base, "method", study.method, document.place(("method",)), document.folder)
    out = Plan(study, document, base, seed, axes(study, seed))
    _ = out.pinned, out.files
    check_watched(study, *out.first)
    if REQUIREMENTS in study.wanted():
        for i, vary in enumerate(study.vary):
            if any(key.split(".")[0] == REQUIREMENTS for key in vary.names()):
                text = "`outputs` has requirements: all combinations need the same ones"
                raise InputError([Problem(document.place(("vary", i)), dotted(("vary", i)), text)])
    return out


def lacking_of_ends(name: str, scenario: Landing) -> str:
    """Key that an output of where runs end needs and a scenario does not have; "" for none."""
    if name == "outside_box" and scenario.box is None:
        return "box"
    if name == "go_around" and not scenario.breaks_off:
        return "approach.go_around.on_alarm"
    return "approach.guidance: estimate" if "_total_" in name and scenario.air() is None else ""


def check_watched(study: Sweep, scenario: Landing, document: Document) -> None:
    """Raise InputError for outputs of monitored fixes without a monitor or without limits, and of beacons without
    any."""
    section = scenario.integrity
    for name in study.wanted():
        lacking = "integrity" if name in LEVEL_OUTPUTS and section is None else ""
        if name in BEACON_OUTPUTS and scenario.beacons is None:
            lacking = "beacons"
        if name in WATCHED_OUTPUTS and (section is None or section.limits is None):
            lacking = "integrity.limits"
        if lacking := lacking or lacking_of_ends(name, scenario):
            text = f"the output {name} needs `{lacking}`, which the scenario does not have"
            key = lacking.split(".")[0]
            raise InputError([Problem(document.place((key,)), key, text)])
    if REQUIREMENTS in study.wanted() and not scenario.requirements:
        text = "the output requirements needs `requirements`, of which the scenario has none"
        raise InputError([Problem(document.place((REQUIREMENTS,)), REQUIREMENTS, text)])
