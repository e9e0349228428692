"""The outcome of a search for placements as a result, with its warnings and findings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from navsim.geodesy.earth import llh_from_ecef
from navsim.landing.beacons import FLAT_VDOP
from navsim.landing.confirmation import TOLERANCE, put_requirements
from navsim.landing.requirements import statements
from navsim.optimization.costs import Member
from navsim.optimization.evaluator import COARSE, FULL
from navsim.optimization.flatness import (
    BEARINGS,
    LOSSES,
    map_axes,
    visible_share,
)
from navsim.optimization.placement import Rules
from navsim.optimization.problem import (
    PlacementProblem,
)
from navsim.optimization.scenario import BEACON_OBJECTIVES, Surfaces
from navsim.optimization.study import SearchOutcome, cost_of, mark_front
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept
from navsim.results.notes import Note
from navsim.results.result import Result
from navsim.results.schema import MET, OBJECTIVE_QUANTITIES, OPTIMIZE
from navsim.runner import findings as judging
from navsim.runner.attributes import root_attributes
from navsim.statistics.rounding import digits
from navsim.sweeps.outputs import beacon_outputs, dop_outputs

if TYPE_CHECKING:
    from navsim.landing.requirements import RequirementValue


_SPOILT = 0.1
"""Share of a mean DOP from one epoch above which navsim warns. Where the aircraft crosses the plane of three beacons,
the mean depends on how near to it an epoch falls."""


_COMPARED = tuple(f"{axis}_{height}" for height in ("100ft", "50ft", "touchdown") for axis in ("vertical", "lateral"))
"""Errors of the filter by which a placement is compared with that of the base."""


def optimize_result(problem: PlacementProblem, outcome: SearchOutcome, seed: int) -> Result:
    """The optima, their neighbourhoods and the front as a result of kind optimize."""
    study, found = problem.study, outcome.found
    members = _rows(problem, outcome)
    counts = [one.count for one in members]
    most = max(counts)
    unit, quantity = OBJECTIVE_QUANTITIES[study.objective]
    draft = ResultBuilder(OPTIMIZE, {"how": "; by the coarse analysis, in proportion" if problem.analysed else ""})
    draft["/pseudolites"] = np.array(counts)
    draft["/pseudolite"] = np.arange(1, most + 1)
    draft["/bearing"] = BEARINGS
    draft["/loss"] = np.array(LOSSES)
    draft["/plan/threshold_llh"] = problem.rules.plane.threshold
    values = problem.shown(np.array([found[one].value for one in members]))
    without = {"without_pseudolites": float(problem.shown(np.array(outcome.without)))}
    draft.put("/pareto/objective", values, without, unit=unit, quantity=quantity)
    draft["/pareto/evaluations"] = np.array([sum(found[one].tried.values()) for one in members])
    for fidelity in (COARSE, FULL):
        draft[f"/pareto/evaluations_{fidelity}"] = np.array([found[one].tried.get(fidelity, 0) for one in members])
    for path, marks in (
        ("/pareto/every_choice", [found[one].every for one in members]),
        ("/pareto/finished", [found[one].finished for one in members]),
        ("/optimum/explored", [one in outcome.neighbourhoods for one in members]),
        ("/map/computed", [one in outcome.maps for one in members]),
    ):
        draft[path] = np.array(marks, dtype=np.int8)
    plane = problem.rules.plane
    axes = ("s", "l1", "up")[: problem.coordinates if plane.terrain is None else 3]
    places = np.full((len(counts), most, len(axes)), np.nan)
    llh = np.full((len(counts), most, 3), np.nan)
    around = np.full((len(counts), most, len(LOSSES), BEARINGS.size), np.nan)
    margin, tightest = np.empty(len(counts)), np.full(len(counts), "", dtype=object)
    for i, one in enumerate(members):
        best, count = found[one], one.count
        places[i, :count] = plane.above_runway(best.places)
        llh[i, :count] = llh_from_ecef(problem.rules.plane.ecef(best.places))
        if one in outcome.neighbourhoods:
            around[i, :count] = outcome.neighbourhoods[one]
        margin[i] = problem.rules.violation(best.places[None])[0]
        if excesses := problem.rules.excesses(best.places[None]):
            tightest[i] = max(excesses, key=lambda rule: float(excesses[rule][0]))
    for axis, name in enumerate(axes):
        draft[f"/optimum/{name}"] = places[..., axis]
    for axis, name in enumerate(("latitude", "longitude", "height")):
        draft[f"/optimum/{name}"] = llh[..., axis]
    draft["/optimum/neighbourhood"] = around
    draft["/optimum/violation"] = margin
    draft["/optimum/tightest_rule"] = tightest
    sites = [problem.rules.plane.ecef(found[one].places)[None] for one in members]
    others = [
        dop_outputs(problem.geometry, each) if beacons is None else beacon_outputs(beacons, each)
        for beacons, each in zip((problem.of(one).beacons for one in members), sites, strict=True)
    ]
    for name in others[0]:
        draft[f"/optimum/{name}"] = np.array([o[name][0] for o in others])
    s, l1 = map_axes(problem)
    draft["/map/s"] = s
    draft["/map/l1"] = l1
    if problem.scenario.terrain:
        draft["/map/seen"] = visible_share(problem, s, l1)
    maps = problem.shown(np.stack([outcome.maps.get(one, np.full((s.size, l1.size), np.nan)) for one in members]))
    draft.put("/map/objective", maps, unit=unit, quantity=quantity)
    _put_costs(draft, problem, outcome)
    _flown(draft, problem, outcome, unit, quantity)
    unmet = _requirements(draft, problem, outcome) + _flown_requirements(draft, problem, outcome)
    attributes = root_attributes(
        "optimize", seed, problem.scenario, study=study, objective=study.objective, stopped=outcome.stopped,
        undone="; ".join(outcome.undone(study)),
    )  # fmt: skip
    out = draft.result(attributes)
    flown = [each for one in members if one in outcome.confirmed
             for each in outcome.confirmed[one].findings(_named(problem, outcome, one), _at)]  # fmt: skip
    weak = [
        f"with {power.eirp_dbm:g} dBm: {error}"
        for one, error in outcome.impossible.items()
        if (power := study.powers[one.power]) is not None
    ]
    names = [_named(problem, outcome, one) for one in members]
    way = [text for one, name in zip(members, names, strict=True)
           for text in masts_above_glide(problem.rules, name, found[one].places)]  # fmt: skip
    told = judging.notes([*problem.warnings, *weak, *_on_pavement(problem, outcome), *way])
    if problem.beacons is not None:
        told += judging.notes(dop_warnings(problem, names, others))
        told += judging.notes(worse_than_base(problem, outcome))
    out.variables.update(kept(told + _findings(problem, outcome) + flown + unmet))
    return out


def _rows(problem: PlacementProblem, outcome: SearchOutcome) -> list[Member]:
    """The placements of a result: by their numbers of sources, then by their costs."""
    if problem.study.costs is None:
        return sorted(outcome.found)
    cost = {one: cost_of(problem.of(one), found) for one, found in outcome.found.items()}
    return sorted(outcome.found, key=lambda one: (one.count, cost[one], one))


def _named(problem: PlacementProblem, outcome: SearchOutcome, one: Member) -> str:
    """A placement in words, by its number of sources, and its cost and power where they tell it apart."""
    out, power = problem.study.named(one.count), problem.study.powers[one.power]
    if problem.study.costs is not None:
        out += f" for {digits(cost_of(problem.of(one), outcome.found[one]), 4)}"
    return out if power is None else f"{out} with {power.eirp_dbm:g} dBm"


def _put_costs(draft: ResultBuilder, problem: PlacementProblem, outcome: SearchOutcome) -> None:
    """Write costs, powers and the front; nothing where the study has no costs."""
    if problem.study.costs is None:
        return
    members = _rows(problem, outcome)
    each = np.full((len(members), max(one.count for one in members)), np.nan)
    for i, one in enumerate(members):
        each[i, : one.count] = problem.of(one).costs(outcome.found[one].places)
    front = mark_front(problem, outcome.found)
    draft["/optimum/cost"] = each
    draft["/pareto/cost"] = np.nansum(each, axis=1)
    draft["/pareto/on_front"] = np.array([front[one] for one in members], dtype=np.int8)
    if problem.study.costs.power:
        draft["/pareto/eirp"] = np.array(
            [power.eirp_dbm for one in members if (power := problem.study.powers[one.power])]
        )


def _on_pavement(problem: PlacementProblem, outcome: SearchOutcome) -> list[str]:
    """Warnings about best placements on the runway."""
    study, runway, out = problem.study, problem.scenario.runway, []
    for one in _rows(problem, outcome):
        places = outcome.found[one].places.tolist()
        named = ((f"number {k}", -l1, s) for k, (s, l1, *_) in enumerate(places, 1))
        out += [f"{_named(problem, outcome, one)}: {text}, or keep off it by `constraints.runway_strip`"
                for text in runway.on_pavement(study.placed, named)]  # fmt: skip
    return out


def masts_above_glide(rules: Rules, name: str, places: np.ndarray) -> list[str]:
    """Warning about antennas of a placement (k, c) before the threshold that rise above the glide beside it.

    The aircraft may strike their masts; `distance_m` asks only how far antennas are.
    """
    receiver = llh_from_ecef(rules.receiver)
    path = np.column_stack([rules.plane.places(receiver), receiver[:, 2] - rules.plane.threshold[2]])
    path = path[np.argsort(path[:, 1], kind="stable")]
    heights = np.broadcast_to(rules.plane.heights(places), len(places))
    found = []
    for k, (s, l1, up) in enumerate(zip(places[:, 0], places[:, 1], heights, strict=True), 1):
        if not (len(path) and max(path[0, 1], 0.0) < l1 < path[-1, 1]):
            continue
        beside = abs(s - float(np.interp(l1, path[:, 1], path[:, 0])))
        above = up - float(np.interp(l1, path[:, 1], path[:, 2]))
        if above > 0.0 and beside < 0.5 * Surfaces().inner_edge_m:
            found.append(f"number {k} rises {digits(above, 2)} m above the glide, {digits(beside, 2)} m off it")
    cure = "keep them lower by constraints.surfaces, or farther by constraints.keep_out"
    return [f"{name}: the aircraft may strike a mast: {'; '.join(found)}; {cure}"] if found else []


def dop_warnings(problem: PlacementProblem, names: Sequence[str], dops: Sequence[dict[str, np.ndarray]]) -> list[str]:
    """Warnings about best placements of beacons: what the objective leaves out is bad, or a mean is that of single
    epochs."""
    asked, out = problem.study.objective, []
    for name, its in zip(names, dops, strict=True):
        for axis, other in (("hdop", "vdop"), ("vdop", "hdop")):
            dop = float(its[f"beacons_{axis}"][0])
            if asked.startswith(f"beacons_{other}") and dop > FLAT_VDOP:
                out.append(
                    f"{name}: {axis.upper()} is {digits(dop)} there, since {asked} does not ask "
                    "for it; minimise beacons_pdop_p50"
                )
        if asked in BEACON_OBJECTIVES[:3] and problem.beacons is not None:
            mean, most, median = (float(its[f"{asked}{end}"][0]) for end in ("", "_max", "_p50"))
            share = most / (mean * len(problem.beacons.receiver))  # a best placement has a solution at each epoch
            if share > _SPOILT and most > 5.0 * median:
                out.append(
                    f"{name}: one of {len(problem.beacons.receiver)} epochs gives {100.0 * share:.0f} % of the mean "
                    f"{asked}: {digits(most)}, where the median is {digits(median)}. So the mean ranks placements by "
                    f"chance; minimise {asked}_p50"
                )
    return out


def worse_than_base(problem: PlacementProblem, outcome: SearchOutcome) -> list[str]:
    """Warnings about best placements by a DOP that were flown, where the layout of the base, of no more beacons, has a
    smaller error of the filter by covariance analysis."""
    out: list[str] = []
    count = 0 if problem.scenario.beacons is None else len(problem.scenario.beacons.sites)
    if problem.study.objective not in BEACON_OBJECTIVES:
        return out
    for one in _rows(problem, outcome):
        its = problem.of(one)
        if one not in outcome.confirmed or one.count < count or its.errors is None:
            continue
        plain, best = its.errors(None), its.errors(outcome.found[one].places)
        worse = [
            f"{name.replace('_', ' at ')} {digits(best[name], 2)} m instead of {digits(plain[name], 2)} m"
            for name in _COMPARED if best[name] > (1.0 + TOLERANCE) * plain[name]
        ]  # fmt: skip
        if worse:
            out.append(Note(
                f"{_named(problem, outcome, one)}: your own layout in {problem.study.base} is better, by covariance "
                f"analysis: here sigma is {', '.join(worse)}. A DOP ignores the inertial sensor and "
                "lasting errors: minimise the error that you need, such as vertical", "worse_than_base",
            ))  # fmt: skip
    return out


def _at(places: np.ndarray) -> str:
    return f"the placement at s, l1 {', '.join(f'({s:.2f}, {l1:.2f})' for s, l1 in places[:, :2])} m"


def _flown(draft: ResultBuilder, problem: PlacementProblem, outcome: SearchOutcome, unit: str, quantity: str) -> None:
    """Write results of runs of the best placements, and of those that runs contradicted."""
    members = _rows(problem, outcome)
    errors, runs = np.full((len(members), 3, 3), np.nan), np.zeros(len(members), np.int64)
    known = {one: outcome.confirmed[one] for one in members if one in outcome.confirmed}
    for i, one in enumerate(members):
        if one in known:
            errors[i], runs[i] = known[one].best.errors, known[one].runs
    draft["/flown/runs"] = runs
    verdicts = [known[one].best.verdict if one in known else "" for one in members]
    draft["/flown/verdict"] = np.array(verdicts, dtype=object)
    draft.put("/flown/objective", errors[:, 0], unit=unit, quantity=quantity)
    for i, name in enumerate(("horizontal", "vertical"), 1):
        draft[f"/flown/{name}"] = errors[:, i]
    rejected = [(one.count, each) for one, found in known.items() for each in found.rejected]
    if not rejected:
        return
    choices = [problem.rules.plane.above_runway(each.choice) for _, each in rejected]
    axes = ("s", "l1", "up")[: choices[0].shape[1]]
    places = np.full((len(rejected), max(one.count for one in members), len(axes)), np.nan)
    for i, (choice, (count, _)) in enumerate(zip(choices, rejected, strict=True)):
        places[i, :count] = choice
    draft["/rejected/rejected"] = np.arange(1, len(rejected) + 1)
    draft["/rejected/pseudolites"] = np.array([count for count, _ in rejected])
    for axis, name in enumerate(axes):
        draft[f"/rejected/{name}"] = places[..., axis]
    draft.put("/rejected/analysed", np.array([each.analysed for _, each in rejected]), unit=unit, quantity=quantity)
    draft.put("/rejected/flown", np.array([each.errors[0] for _, each in rejected]), unit=unit, quantity=quantity)


def _flown_requirements(draft: ResultBuilder, problem: PlacementProblem, outcome: SearchOutcome) -> list[Finding]:
    """Write the verdicts of runs on the base scenario's requirements; return those that a best placement misses."""
    asked, members = statements(problem.scenario), _rows(problem, outcome)
    if not asked or not outcome.confirmed:
        return []
    best = [outcome.confirmed[one].best.requirements if one in outcome.confirmed else None for one in members]
    return [
        Finding("requirements", f"{_named(problem, outcome, one)}: runs of the best placement don't meet: "
                f"{'; '.join(missed)}", (), len(missed), len(asked))
        for one, missed in zip(members, put_requirements(draft, asked, best), strict=True) if missed
    ]  # fmt: skip


def _requirements(draft: ResultBuilder, problem: PlacementProblem, outcome: SearchOutcome) -> list[Finding]:
    """Write verdicts for each placement and for none, and requirements that no placement meets.

    Writes nothing without requirements.
    """
    asked = problem.requirements
    if asked is None:
        return []
    members = _rows(problem, outcome)
    judged = [asked.judge(np.empty((0, 2)))]
    for one in members:
        of_power = problem.of(one).requirements
        assert of_power is not None
        judged.append(of_power.judge(outcome.found[one].places))
    analysed = np.array([asked.load(each) <= 1.0 for each in judged])
    missed = [one in outcome.confirmed and outcome.confirmed[one].best.missed for one in members]
    met = analysed & ~np.array([False, *missed])
    statements = np.array([one.text for one in judged[0]], dtype=object)
    value = np.array([[one.value[0] for one in each] for each in judged])
    verdict = np.array([[one.verdict() for one in each] for each in judged], dtype=object)
    utilisation = np.array([[one.utilisation for one in each] for each in judged])
    draft["/requirements/requirement"] = np.arange(1, statements.size + 1)
    draft["/requirements/statement"] = statements
    draft["/requirements/limit"] = np.array([one.limit for one in judged[0]])
    draft["/requirements/decided"] = asked.decided.astype(np.int8)
    for name, data in (("value", value), ("verdict", verdict), ("utilisation", utilisation)):
        draft[f"/requirements/{name}"], draft[f"/requirements/{name}_without"] = data[1:], data[0]
    draft["/pareto/met"], draft["/pareto/met_without"] = met[1:].astype(np.int8), np.int8(met[0])
    enough = [one.count for one, good in zip(members, met[1:], strict=True) if good]
    draft["/pareto/fewest"] = np.int64(0 if met[0] else min(enough, default=-1))
    if problem.study.costs is not None:
        cost = [0.0, *(cost_of(problem.of(one), outcome.found[one]) for one in members)]
        draft["/pareto/cheapest"] = min((each for each, good in zip(cost, met, strict=True) if good), default=np.nan)
    out = []
    for i, one in enumerate(members, start=1):
        if analysed[i]:
            continue
        unmet = [
            f"{text} ({_missed(each)})"
            for text, each, decided in zip(statements, judged[i], asked.decided, strict=True)
            if decided and each.verdict() != MET
        ]
        every = "every choice of sites was tried" if outcome.found[one].every else "of those tried"
        text = f"no placement meets the requirements ({every}); the nearest misses {'; '.join(unmet)}"
        text = f"{_named(problem, outcome, one)}: {text}"
        out.append(Finding("requirements", text, (), len(unmet), int(asked.decided.sum())))
    return out


def _missed(one: RequirementValue) -> str:
    """A missed requirement in words."""
    figure = f"{digits(one.value[0], 4)} of {one.limit:g}"
    if not np.isfinite(one.utilisation):
        return f"{figure}, no size would do"
    return f"{figure}; {digits(100.0 * (one.utilisation - 1.0))} % beyond the size"


def _findings(problem: PlacementProblem, outcome: SearchOutcome) -> list[Finding]:
    """Findings of the full analysis of the best placements; none for those evaluated by geometry."""
    if problem.found is None:
        return []
    members, marked = _rows(problem, outcome), []
    for one in members:
        found = problem.of(one).found
        assert found is not None
        marked.append(judging.marks(each.name for each in found(outcome.found[one].places)))
    return judging.among(np.array(marked), "best placements", lambda i: _named(problem, outcome, members[i]))
