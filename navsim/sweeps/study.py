"""Sweep over every combination of a study's settings: geometry, covariance analysis or Monte Carlo, resumable.

A combination replaces a run in the ensemble engine: batches of them are kept on disk with checksums as they are
finished, and joined in order. Combinations that only move pseudolites share one geometry.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from navsim.geodesy.earth import ecef_from_llh, in_heading_axes
from navsim.gnss.constellations.systems import CLOCKS
from navsim.gnss.pseudolite import Track
from navsim.gnss.signals import Environment
from navsim.landing import integrity
from navsim.landing.confirmation import (
    APART,
    CANDIDATES,
    Candidate,
    Confirmation,
    OfRuns,
    confirm,
    filter_outputs,
    fly_case,
    of_runs,
)
from navsim.landing.plausibility import implausible, one_direction
from navsim.landing.preflight import FOLLOW, lone_pseudolite_warning
from navsim.landing.requirements import Statement, statements
from navsim.landing.result_groups import geometry_summary
from navsim.landing.sources import environment, files_of, glide_epochs, on_glide
from navsim.landing.study import (
    Case,
    covariance_analysis,
    covariance_findings,
    covariance_summary,
    judged_without_runs,
    prepare,
)
from navsim.results import files
from navsim.results.builder import ResultBuilder
from navsim.results.findings import FIX, Finding, kept, of
from navsim.results.result import Result
from navsim.results.schema import OUTCOMES, SWEEP, UNDECIDED, VERDICTS
from navsim.runner.attributes import root_attributes
from navsim.runner.batches import Ensemble, fly_all
from navsim.runner.checkpoint import Arrays, CheckpointError, CheckpointStore, code_key
from navsim.runner.executor import Executor, threads
from navsim.runner.findings import LANDING, among, marks, notes, without_fix
from navsim.scenario.approach import FileApproach
from navsim.scenario.base import DEG, validated
from navsim.scenario.landing import Landing
from navsim.scenario.load import NO_RECORDED, resolved_yaml
from navsim.scenario.signals import PseudolitesSection
from navsim.scenario.sky import SOURCES_FROM_FILES
from navsim.scenario.source import Document, InputError, KeyPath, Problem, dotted, set_value
from navsim.simulation.placement_geometry import Geometry, glide_geometry
from navsim.sweeps.outputs import (
    NUMBERED,
    dop_outputs,
    landing_outputs,
    outputs_of_fulfilments,
    requirement_outputs,
    watched_outputs,
)
from navsim.sweeps.scenario import (
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
_PLACES = ("pseudolites.s_m", "pseudolites.l1_m")
"""Keys of distances, m, that determine the positions of pseudolites."""
NAME_FILES = ("source", "horizon", *SOURCES_FROM_FILES)
"""Keys of the sky that name files, including those below them."""
OWN_DIMENSIONS = ("finding", "interval", "point", "rejected", "sample", "site")
"""Dimensions of a result that are no axes named by keys."""
UNUSABLE = "unusable"
MOST_MAP_SITES = 8
_NOTHING: Mapping[str, Confirmation] = {}
COMPUTED, INVALID, NO_FIX = range(3)
"""Outcome of a combination, see `schema.OUTCOMES`."""
_UNHEARD, _NO_EPOCH = (list(LANDING).index(name) for name in ("epochs_without_fix", "no_fix"))


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
    def asked(self) -> list[Statement]:
        """Requirements that every combination is evaluated by; empty if they are no output."""
        return statements(self.first[0]) if REQUIREMENTS in self.study.wanted() else []

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
        """The aircraft during the first combination's simulation, see `Landing.track`."""
        return self.first[0].track(self.trajectory)

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
        moves &= not set(self.study.wanted()) & {*LEVEL_OUTPUTS, REQUIREMENTS}
        return moves and not self.sources.placed and not self.sources.singled_out

    @cached_property
    def geometry(self) -> Geometry | None:
        """Common geometry of combinations that only move pseudolites and need no filter, else None."""
        if not self.geometry_alone:
            return None
        sources, scenario, _ = self._environment
        trajectory, utc = scenario.trajectory(), np.array([scenario.epoch.timestamp()])
        return glide_geometry(trajectory, sources, utc, *glide_epochs(scenario, trajectory))

    @cached_property
    def _environment(self) -> tuple[Environment, Landing, list[str]]:
        return environment(*self.first)

    @property
    def sources(self) -> Environment:
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
        fixed = [] if moves else one_direction(scenario, self.trajectory)  # its DOPs evaluate the moved pseudolites
        return [*warnings, *implausible(scenario, self.trajectory), *fixed]

    def warnings_of(self, case: Case) -> list[str]:
        """Warnings about the input of a combination that are not the study's."""
        scenario, flown = case.scenario, case.trajectory
        mine = case.warnings
        if self.study.method == "dop":  # geometry alone does not give values that are undefined without a touchdown
            mine = [*case.sky_warnings, *implausible(scenario, flown)]
        # a lone pseudolite is a separate finding
        told = {*self.warnings, *case.foreseen.lone_pseudolite, *one_direction(scenario, flown)}
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
    if study.method != "dop":
        base = base.copy()
        set_value(base, "method", study.method, document.place(("method",)), document.folder)
    out = Plan(study, document, base, seed, axes(study, seed))
    _ = out.pinned, out.files
    _check_watched(study, *out.first)
    if REQUIREMENTS in study.wanted():
        for i, vary in enumerate(study.vary):
            if any(key.split(".")[0] == REQUIREMENTS for key in vary.names()):
                text = "`outputs` has requirements: all combinations need the same ones"
                raise InputError([Problem(document.place(("vary", i)), dotted(("vary", i)), text)])
    return out


@dataclass(frozen=True)
class SweepStudy:
    """A plan as the ensemble engine flies it: combinations for runs."""

    plan: Plan

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Combinations first ... first + count - 1."""
        names = columns(self.plan)
        rows = {name: np.full(count, np.nan) for name in names}
        for name in verdicts(self.plan):
            rows[name] = np.full(count, VERDICTS.index(UNDECIDED), np.int8)
        rows["outcome"] = np.full(count, INVALID, np.int8)
        rows["findings"] = np.zeros((count, len(LANDING)), bool)
        rows["warned"], rows["alone"] = np.zeros(count, bool), np.zeros(count, bool)
        rows["site"] = np.full((count, MOST_MAP_SITES, 2), np.nan)
        if self.plan.geometry is not None:
            self._placements(first, count, self.plan.geometry, rows)
            return rows, {}, {}
        for i in range(count):
            try:
                found, site, what, rows["warned"][i], rows["alone"][i] = self._one(first + i)
            except InputError:
                self.plan.check_files(first + i)
                continue  # not a valid scenario: nan
            rows["site"][i] = self.plan.in_plan(site)
            rows["findings"][i] = marks(f.name for f in what)
            unfixed = without_fix(what)
            rows["outcome"][i] = NO_FIX if unfixed else COMPUTED
            for name in names:
                # the lack of levels, and its consequences, are known of flights without a fix too
                if not unfixed or name == "level_share" or name.startswith(NUMBERED):
                    rows[name][i] = found[name]
        return rows, {}, {}

    def _placements(self, first: int, count: int, geometry: Geometry, rows: Arrays) -> None:
        """Combinations that only move pseudolites: grouped by their number, each group at one go."""
        scenario = self.plan.first[0]
        base = scenario.pseudolites.model_dump()
        groups: dict[int, tuple[list[int], list[np.ndarray]]] = {}
        for i in range(count):
            settings = {key.split(".")[1]: value for key, value in self.plan.settings(first + i).items()}
            try:
                section = PseudolitesSection.model_validate(base | settings)
                moved = scenario.model_copy(update={"pseudolites": section})
                site = moved.pseudolite_sites(self.plan.frame, self.plan.track)
            except ValueError:
                continue
            rows["site"][i] = self.plan.in_plan(site)
            rows["warned"][i] = not set(moved.doubted_heights()) <= set(self.plan.warnings)
            members, sites = groups.setdefault(len(site), ([], []))
            members.append(i)
            sites.append(site)
        for members, sites in groups.values():
            found = dop_outputs(geometry, np.array(sites))
            lost = found["epochs_without_fix"]
            solved = lost < len(geometry.receiver)
            rows["outcome"][members] = np.where(solved, COMPUTED, NO_FIX)
            rows["findings"][members, _UNHEARD] = lost > 0.0
            rows["findings"][members, _NO_EPOCH] = len(geometry.receiver) == 0
            rows["alone"][members] = geometry.find_lone_pseudolite(len(sites[0])).any()
            for name in columns(self.plan):
                rows[name][members] = np.where(solved, found[name], np.nan)

    def _one(self, index: int) -> tuple[dict[str, float], np.ndarray, list[Finding], bool, bool]:
        """Outputs of a combination, its sites, ECEF, findings of its flights, and two flags.

        The flags are: its input has warnings that the study has not; a pseudolite is alone on a clock.
        """
        scenario, document = self.plan.scenario(self.plan.settings(index))
        method = self.plan.study.method
        case = prepare(scenario, document)
        for name, checksum in files_of(case.scenario).items():
            if checksum != self.plan.files[name]:
                raise CheckpointError(f"{name} was changed while the study ran")
        site = ecef_from_llh(case.pseudolites.llh)
        warned, alone = bool(self.plan.warnings_of(case)), bool(case.foreseen.lone_pseudolite)
        glide = on_glide(case.scenario, case.trajectory, case.world.signals.time)
        lost = int(np.isnan(case.world.dop[glide, 1]).sum())
        out = landing_outputs(geometry_summary(case), lost)
        _check_watched(self.plan.study, scenario, document)
        if set(self.plan.study.wanted()) & set(LEVEL_OUTPUTS):
            out |= integrity.level_outputs(case)
        if method == "covariance":
            analysis = covariance_analysis(case)
            outputs = out | filter_outputs(covariance_summary(case, analysis))
            if self.plan.asked:
                outputs |= outputs_of_fulfilments(judged_without_runs(case, analysis))
            return outputs, site, covariance_findings(case, analysis), warned, alone
        if method == "monte-carlo":
            flown = fly_case(case, self.plan.seed, 0, self.plan.study.runs, threads(1))
            outputs = out | filter_outputs(flown) | watched_outputs(flown)
            return outputs | requirement_outputs(flown), site, of(flown), warned, alone
        if self.plan.asked:
            out |= outputs_of_fulfilments(judged_without_runs(case, None))
        epochs = int(glide.sum())
        found = []
        if lost:
            said = f"{lost} epochs of the glide without a fix"
            found.append(Finding("epochs_without_fix", said, (FIX,), lost, epochs))
        if not epochs:
            found.append(Finding("no_fix", "no fix epoch in the glide", (FIX,)))
        return out, site, found, warned, alone


def _check_watched(study: Sweep, scenario: Landing, document: Document) -> None:
    """Raise InputError for outputs of monitored fixes without a monitor or without limits."""
    section = scenario.integrity
    for name in study.wanted():
        lacking = "integrity" if name in LEVEL_OUTPUTS and section is None else ""
        if name in WATCHED_OUTPUTS and (section is None or section.limits is None):
            lacking = "integrity.limits"
        if lacking:
            text = f"the output {name} needs `{lacking}`, which the scenario does not have"
            raise InputError([Problem(document.place(("integrity",)), "integrity", text)])
    if REQUIREMENTS in study.wanted() and not scenario.requirements:
        text = "the output requirements needs `requirements`, of which the scenario has none"
        raise InputError([Problem(document.place((REQUIREMENTS,)), REQUIREMENTS, text)])


def columns(planned: Plan) -> list[str]:
    """Data stored of each combination; Monte Carlo figures have intervals."""
    study, flown = planned.study, planned.study.method == "monte-carlo"
    out = []
    for name in study.wanted():
        if name == REQUIREMENTS:
            for i in range(1, len(planned.asked) + 1):
                ends = ("", "_low", "_high", "_verdict") if flown else ("", "_verdict")
                out += [f"{NUMBERED}{i}{end}" for end in ends]
            continue
        out.append(name)
        if flown and name in (*FILTER_OUTPUTS, *WATCHED_OUTPUTS):
            out += [f"{name}_low", f"{name}_high"]
    return out


def verdicts(planned: Plan) -> list[str]:
    """Columns with verdicts, as numbers of `schema.VERDICTS`."""
    return [f"{NUMBERED}{i}_verdict" for i in range(1, len(planned.asked) + 1)]


def compute(
    planned: Plan,
    executor: Executor,
    store: CheckpointStore | None = None,
    done: Callable[[int], None] = lambda _: None,
) -> Ensemble:
    """All combinations; see `runner.batches.fly_all`."""
    return fly_all(SweepStudy(planned), 0, planned.size, executor, store, done, size=planned.batch)


def confirm_best(
    planned: Plan, found: Ensemble, runs: int, store: CheckpointStore | None, tell: Callable[[str], None]
) -> dict[str, Confirmation]:
    """Run the best combination for each error of the filter, after a covariance analysis of all."""
    known: dict[tuple[int, int], OfRuns] = {}
    out = {}
    for name in columns(planned):
        values = found.per_run(name) if name in FILTER_OUTPUTS else np.empty(0)
        if not np.isfinite(values).any():
            continue
        tell(f"flying the best by {name}")

        def fly(choice: np.ndarray, seed: int, first: int, count: int) -> OfRuns:
            index = int(choice[0])
            if (index, first) not in known:
                scenario, document = _as_runs(planned, index)
                flown = fly_case(prepare(scenario, document), seed, first, count, threads())
                known[index, first] = of_runs(flown)
            return known[index, first]

        kept = None if store is None else store.read(f"flown-{name}-{runs}")
        if kept is None:
            kept = confirm(_ranked(planned, values), name, fly, planned.seed, runs).arrays()
            if store is not None:
                store.write(f"flown-{name}-{runs}", kept)
        out[name] = Confirmation.of(kept)
    return out


def _as_runs(planned: Plan, index: int) -> tuple[Landing, Document]:
    """The scenario of a combination, to be flown."""
    document = planned.scenario(planned.settings(index))[1].copy()
    set_value(document, "method", "monte-carlo", planned.document.place(("method",)), planned.document.folder)
    return validated(Landing, document), document


def _ranked(planned: Plan, values: np.ndarray) -> Iterator[Candidate]:
    """Combinations by their values (n,), the best first.

    Omits those that move pseudolites of an earlier one by less than `APART`, since runs would contradict both.
    """
    tried: list[dict[str, Any]] = []
    for index in np.argsort(values, kind="stable"):
        if len(tried) == CANDIDATES or not np.isfinite(values[index]):
            return
        here = planned.settings(int(index))
        if any(all(_is_near(key, here[key], value) for key, value in other.items()) for other in tried):
            continue
        tried.append(here)
        yield partial(_candidate, int(index), float(values[index]))


def _is_near(key: str, value: Any, other: Any) -> bool:
    return bool(abs(value - other) < APART if key in _PLACES else value == other)


def _candidate(index: int, value: float) -> tuple[np.ndarray, float]:
    return np.array([index]), value


def partial_key(planned: Plan) -> dict[str, object]:
    """Data that partial work must match to be resumed."""
    text = resolved_yaml(planned.study) + resolved_yaml(planned.pinned)
    return {
        "study_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "files": planned.files,
        "seed": planned.seed,
        **code_key(),
    }


def sweep_result(planned: Plan, found: Ensemble, confirmed: Mapping[str, Confirmation] = _NOTHING) -> Result:
    """The cube of the study, with the positions of the pseudolites of each combination, and the runs of the best."""
    study = planned.study
    draft = ResultBuilder(
        SWEEP,
        dimension=[axis.name for axis in planned.axes],
        varied=[short(study, key) for axis in planned.axes for key in axis.keys],
        number=[str(i) for i in range(1, len(planned.asked) + 1)],
    )
    for axis in planned.axes:
        alone = len(axis.keys) == 1
        points = _column([p[0] for p in axis.points]) if alone else np.arange(len(axis.points))
        draft.put(f"/{axis.name}", points, points=f"values of {axis.keys[0]}" if alone else "points of the axis")
        for j, key in enumerate(axis.keys):
            values = _column([p[j] for p in axis.points])
            draft.put(f"/sweep/axes/{short(study, key)}", values, key=key, of_axis=axis.name)
    for name in columns(planned):
        cube = found.per_run(name).reshape(planned.shape)
        if name.startswith(NUMBERED):
            said = planned.asked[int(name.split("_")[1]) - 1]
            plain = name.count("_") == 1
            attributes = {"limit": said.limit, "least": int(said.least)} if plain else {}
            draft.put(f"/sweep/{name}", cube, attributes, unit=said.unit, statement=said.text)
        else:
            draft[f"/sweep/{name}"] = cube
    _places(draft, planned, found)
    _flown(draft, confirmed)
    outcome = found.per_run("outcome")
    draft["/outcome/combination"] = outcome.reshape(planned.shape)
    root = root_attributes(
        "sweep",
        planned.seed,
        planned.pinned,
        study=study,
        files=json.dumps(planned.files, sort_keys=True),
        method=study.method,
        runs=study.runs if study.method == "monte-carlo" else 0,
        combinations=planned.size,
        refused=int(np.sum(outcome != COMPUTED)),
    )
    out = draft.result(root)
    flown = [
        each
        for name, one in confirmed.items()
        for each in one.findings(name, lambda choice: _label(planned, int(choice[0])))
    ]
    out.variables.update(kept(_findings(planned, found, outcome) + flown))
    return out


def _flown(draft: ResultBuilder, confirmed: Mapping[str, Confirmation]) -> None:
    """Write results of runs of the best combinations, and of those that runs contradicted."""
    for name, one in confirmed.items():
        draft["/flown/runs"] = np.int64(one.runs)
        draft[f"/flown/{name}"] = one.best.errors[0]
        draft[f"/flown/{name}_combination"] = np.int64(one.best.choice[0])
        draft[f"/flown/{name}_verdict"] = one.best.verdict
    rejected = [(name, one) for name, confirmation in confirmed.items() for one in confirmation.rejected]
    if rejected:
        draft["/rejected/rejected"] = np.arange(1, len(rejected) + 1)
        draft["/rejected/output"] = np.array([name for name, _ in rejected], dtype=object)
        draft["/rejected/combination"] = np.array([int(one.choice[0]) for _, one in rejected])
        draft["/rejected/analysed"] = np.array([one.analysed for _, one in rejected])
        draft["/rejected/flown"] = np.array([one.errors[0] for _, one in rejected])


def _label(planned: Plan, index: int) -> str:
    return ", ".join(f"{key} {value}" for key, value in planned.settings(index).items())


def _findings(planned: Plan, found: Ensemble, outcome: np.ndarray) -> list[Finding]:
    """Findings: number of combinations with each, combinations that are nan, and warnings about the input."""

    label = partial(_label, planned)
    out = notes(planned.warnings)
    for number, against in ((INVALID, ()), (NO_FIX, (FIX,))):
        some = outcome == number
        if some.any():
            text = f"{some.sum()} of {some.size} combinations are nan: {OUTCOMES[number]}"
            said = f"{text}; the first: {label(int(np.argmax(some)))}"
            out.append(Finding("refused", said, against, int(some.sum()), some.size))
    warned = found.per_run("warned")
    if warned.any():
        first, count = int(np.argmax(warned)), int(warned.sum())
        said = "; ".join(planned.warnings_of(prepare(*planned.scenario(planned.settings(first)))))
        text = f"in {count} of {warned.size} combinations the input has warnings; the first: {label(first)}: {said}"
        out.append(Finding("input", text, (), count, warned.size))
    alone = found.per_run("alone")
    if alone.any():
        clock, when = CLOCKS[planned.sources.pseudolites.clock], f"in {alone.sum()} of {alone.size} combinations"
        text = lone_pseudolite_warning(clock, when, FOLLOW)
        shared = planned.geometry
        equal = shared is not None and bool(shared.find_lone_pseudolite(1).all())
        if equal and (alone | (outcome != COMPUTED)).all():
            text = f"all combinations are equally good: {text}"
        out.append(Finding("input", text, (), int(alone.sum()), alone.size))
    return out + among(found.per_run("findings"), "combinations", label)


def _column(values: list[Any]) -> np.ndarray:
    if all(isinstance(x, bool) for x in values):
        return np.array(values).astype(np.int8)
    if all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in values):
        stored = all(isinstance(x, int) and abs(x) < 2**63 for x in values)  # integers in HDF5
        return np.array(values, dtype=np.int64 if stored else np.float64)
    return np.array([x if isinstance(x, str) else json.dumps(x) for x in values], dtype=object)


def _places(draft: ResultBuilder, planned: Plan, found: Ensemble) -> None:
    """The approach and the sites of every combination in the plane of the runway."""
    scenario = planned.first[0]
    time = np.linspace(0.0, scenario.duration_s, 200)
    track = planned.plane(scenario.trajectory().motion(time).position_ecef)
    sites = found.per_run("site").reshape(*planned.shape, MOST_MAP_SITES, 2)
    draft["/plan/point"] = np.arange(time.size)
    draft["/plan/threshold_llh"] = scenario.threshold(planned.frame)
    draft["/site"] = np.arange(1, MOST_MAP_SITES + 1)
    for i, name in enumerate(("along", "right")):
        draft[f"/plan/track_{name}"] = track[:, i]
        draft[f"/plan/site_{name}"] = sites[..., i]
