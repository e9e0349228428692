"""Sweep over every combination of a study's settings: geometry, covariance analysis or Monte Carlo, resumable.

A combination replaces a run in the ensemble engine: batches of them are kept on disk with checksums as they are
finished, and joined in order. Combinations that only move pseudolites share one geometry.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from navsim.environment.sources import files_of, on_glide
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.constellations.systems import CLOCKS
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
    put_requirements,
)
from navsim.landing.preflight import FOLLOW, lone_pseudolite_warning
from navsim.landing.result_groups import geometry_summary
from navsim.landing.study import (
    covariance_analysis,
    covariance_findings,
    covariance_summary,
    judged_without_runs,
    prepare,
)
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept, of
from navsim.results.notes import FIX
from navsim.results.result import Result
from navsim.results.schema import OUTCOMES, SWEEP, UNDECIDED, VERDICTS
from navsim.runner.attributes import root_attributes
from navsim.runner.batches import Ensemble, fly_all
from navsim.runner.checkpoint import Arrays, CheckpointError, CheckpointStore, code_key
from navsim.runner.executor import Executor, threads
from navsim.runner.findings import LANDING, among, marks, notes, without_fix
from navsim.scenario.landing import Landing
from navsim.scenario.load import resolved_yaml
from navsim.scenario.pseudolites import PseudolitesSection
from navsim.scenario.site_clearance import pseudolite_sites
from navsim.scenario_files.base import validated
from navsim.scenario_files.source import Document, InputError, set_value
from navsim.simulation.placement_geometry import Geometry
from navsim.sweeps.outputs import (
    NUMBERED,
    dop_outputs,
    landing_outputs,
    outputs_of_fulfilments,
    requirement_outputs,
    total_outputs,
    watched_outputs,
)
from navsim.sweeps.plan import MOST_MAP_SITES, PLACE_KEYS, Plan, check_watched, short
from navsim.sweeps.scenario import (
    BEACON_OUTPUTS,
    FILTER_OUTPUTS,
    LEVEL_OUTPUTS,
    REQUIREMENTS,
    TOTAL_OUTPUTS,
    WATCHED_OUTPUTS,
)

_NOTHING: Mapping[str, Confirmation] = {}
COMPUTED, INVALID, NO_FIX = range(3)
"""Outcome of a combination, see `schema.OUTCOMES`."""
_OF_AIDED = (*FILTER_OUTPUTS, *TOTAL_OUTPUTS, *BEACON_OUTPUTS)
"""Beginnings of outputs that a filter with other sensors of position has without a fix."""
_UNHEARD, _NO_EPOCH = (list(LANDING).index(name) for name in ("epochs_without_fix", "no_fix"))


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
                found, site, what, rows["warned"][i], rows["alone"][i], aided = self._one(first + i)
            except InputError:
                self.plan.check_files(first + i)
                continue  # not a valid scenario: nan
            rows["site"][i] = self.plan.in_plan(site)
            rows["findings"][i] = marks(f.name for f in what)
            unfixed = without_fix(what)
            rows["outcome"][i] = NO_FIX if unfixed and not aided else COMPUTED
            for name in names:
                # the lack of levels, and its consequences, are known of flights without a fix too
                known = name == "level_share" or name.startswith(NUMBERED)
                if not unfixed or known or (aided and name.startswith(_OF_AIDED)):
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
                site = pseudolite_sites(moved, self.plan.frame, self.plan.track)
            except ValueError:
                continue
            rows["site"][i] = self.plan.in_plan(site)
            blocked = any(moved.runway.is_pavement(*place) for place in self.plan.plane(site).tolist())
            rows["warned"][i] = blocked or not set(moved.doubted_heights()) <= set(self.plan.warnings)
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

    def _one(self, index: int) -> tuple[dict[str, float], np.ndarray, list[Finding], bool, bool, bool]:
        """Outputs of a combination, its sites, ECEF, findings of its flights, and three flags.

        The flags are: its input has warnings that the study has not; a pseudolite is alone on a clock; the filter also
        has measurements of position from other sensors.
        """
        scenario, document = self.plan.scenario(self.plan.settings(index))
        method = self.plan.study.method
        case = prepare(scenario, document)
        for name, checksum in files_of(case.scenario).items():
            if checksum != self.plan.files[name]:
                raise CheckpointError(f"{name} was changed while the study ran")
        site = ecef_from_llh(case.pseudolites.llh)
        warned, alone = bool(self.plan.warnings_of(case)), bool(case.preflight.lone_pseudolite)
        aided = method != "dop" and case.aided
        glide = on_glide(case.scenario, case.trajectory, case.shared.signals.time)
        lost = int(np.isnan(case.shared.dop[glide, 1]).sum())
        out = landing_outputs(geometry_summary(case), lost)
        check_watched(self.plan.study, scenario, document)
        if set(self.plan.study.wanted()) & set(LEVEL_OUTPUTS):
            out |= integrity.level_outputs(case)
        if method == "covariance":
            analysis = covariance_analysis(case)
            outputs = out | filter_outputs(covariance_summary(case, analysis))
            if self.plan.requirements:
                outputs |= outputs_of_fulfilments(judged_without_runs(case, analysis))
            return outputs, site, covariance_findings(case, analysis), warned, alone, aided
        if method == "monte-carlo":
            flown = fly_case(case, self.plan.seed, 0, self.plan.study.runs, threads(1))
            outputs = out | filter_outputs(flown) | watched_outputs(flown) | total_outputs(flown)
            return outputs | requirement_outputs(flown), site, of(flown), warned, alone, aided
        if self.plan.requirements:
            out |= outputs_of_fulfilments(judged_without_runs(case, None))
        epochs = int(glide.sum())
        found = []
        if lost:
            text = f"{lost} epochs of the glide without a fix"
            found.append(Finding("epochs_without_fix", text, (FIX,), lost, epochs))
        if not epochs:
            found.append(Finding("no_fix", "no fix epoch in the glide", (FIX,)))
        return out, site, found, warned, alone, aided


def columns(planned: Plan) -> list[str]:
    """Data stored of each combination; Monte Carlo figures have intervals."""
    study, flown = planned.study, planned.study.method == "monte-carlo"
    out = []
    for name in study.wanted():
        if name == REQUIREMENTS:
            for i in range(1, len(planned.requirements) + 1):
                ends = ("", "_low", "_high", "_verdict") if flown else ("", "_verdict")
                out += [f"{NUMBERED}{i}{end}" for end in ends]
            continue
        out.append(name)
        if flown and name in (*FILTER_OUTPUTS, *WATCHED_OUTPUTS, *TOTAL_OUTPUTS):
            out += [f"{name}_low", f"{name}_high"]
    return out


def verdicts(planned: Plan) -> list[str]:
    """Columns with verdicts, as numbers of `schema.VERDICTS`."""
    return [f"{NUMBERED}{i}_verdict" for i in range(1, len(planned.requirements) + 1)]


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
    return bool(abs(value - other) < APART if key in PLACE_KEYS else value == other)


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
        number=[str(i) for i in range(1, len(planned.requirements) + 1)],
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
            text = planned.requirements[int(name.split("_")[1]) - 1]
            plain = name.count("_") == 1
            attributes = {"limit": text.limit, "least": int(text.least)} if plain else {}
            draft.put(f"/sweep/{name}", cube, attributes, unit=text.unit, statement=text.text)
        else:
            draft[f"/sweep/{name}"] = cube
    _places(draft, planned, found)
    unmet = _flown(draft, planned, confirmed)
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
    out.variables.update(kept(_findings(planned, found, outcome) + flown + unmet))
    return out


def _flown(draft: ResultBuilder, planned: Plan, confirmed: Mapping[str, Confirmation]) -> list[Finding]:
    """Write results of runs of the best combinations, and of those that runs contradicted; return the best ones that
    miss requirements."""
    for name, one in confirmed.items():
        draft["/flown/runs"] = np.int64(one.runs)
        draft[f"/flown/{name}"] = one.best.errors[0]
        draft[f"/flown/{name}_combination"] = np.int64(one.best.choice[0])
        draft[f"/flown/{name}_verdict"] = one.best.verdict
    out = []
    if confirmed and planned.common_requirements:
        draft["/flown/requirements/output"] = np.array(list(confirmed), dtype=object)
        best = [one.best.requirements for one in confirmed.values()]
        for name, missed in zip(confirmed, put_requirements(draft, planned.common_requirements, best), strict=True):
            if missed:
                text = f"{name}: runs of the best combination don't meet: {'; '.join(missed)}"
                out.append(Finding("requirements", text, (), len(missed), len(planned.common_requirements)))
    rejected = [(name, one) for name, confirmation in confirmed.items() for one in confirmation.rejected]
    if rejected:
        draft["/rejected/rejected"] = np.arange(1, len(rejected) + 1)
        draft["/rejected/output"] = np.array([name for name, _ in rejected], dtype=object)
        draft["/rejected/combination"] = np.array([int(one.choice[0]) for _, one in rejected])
        draft["/rejected/analysed"] = np.array([one.analysed for _, one in rejected])
        draft["/rejected/flown"] = np.array([one.errors[0] for _, one in rejected])
    return out


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
        clock, when = CLOCKS[planned.sources.pseudolites.time_scale], f"in {alone.sum()} of {alone.size} combinations"
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
