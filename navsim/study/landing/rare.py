"""The probability that a landing ends outside the scenario's box, from runs that are pushed towards its edge.

What is flown and weighed is `simulation.rare`'s; here are the study of many runs, its statistics and its result.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navsim.core.arrays.sampling import FEW, TWO_SIDED
from navsim.core.lanes import WIDTH
from navsim.io.draft import Draft
from navsim.io.findings import Finding, kept
from navsim.io.results import Result
from navsim.io.schema import RARE
from navsim.simulation.landing import draw, fly_inputs
from navsim.simulation.landing_covariance import along_truth, analyse
from navsim.simulation.rare import Tilt, pushed, tilt
from navsim.simulation.sensitivity import sensitivity
from navsim.study import findings as judging
from navsim.study.ensemble import Ensemble
from navsim.study.ensemble import fly_all as fly_ensemble
from navsim.study.executor import Executor
from navsim.study.findings import Flaws
from navsim.study.landing.box import Box, box_of, to_first_order, where_limited
from navsim.study.landing.case import Case
from navsim.study.landing.ensemble import (
    FAR_OFF,
    FLAW_PARTS,
    at_heights,
    between_outputs,
    fix_flaws,
    of_fixes,
    of_outputs,
    output_flaws,
    to_runway,
)
from navsim.study.landing.tree import attributes
from navsim.study.partial import Arrays, Store
from navsim.study.statistics import weighted_share

USUAL = 0.2
"""Half the width of the 95 % interval, over the probability, with which a study ends unless told otherwise."""
MOST_RUNS = 20_000
"""Where it gives up, unless told otherwise."""
LINEAR = 0.2
"""Sigmas of an error that may be other than linear before intervals are too narrow (docs/rare-events-measured.md)."""


@dataclass(frozen=True)
class Edge:
    """The box of a case, and the pushes to its edge."""

    box: Box
    tilt: Tilt


def prepare(case: Case) -> Edge:
    """The way to the edge of the box of a case. Raises ValueError where an error that it bounds depends on nothing that
    is drawn."""
    box = box_of(case)
    assert box is not None
    before, after, share = between_outputs(case, np.array([box.time]))
    weights = np.zeros((3, case.world.filter_time.size, 3))
    turn = to_runway(case)
    weights[:, before[0]] += (1.0 - share[0]) * turn
    weights[:, after[0]] += share[0] * turn
    along = along_truth(case.flight)
    analysis = analyse(case.flight, np.isin(case.world.signals.names, case.pseudolites.names), along)
    mean = at_heights(case, [box.time], analysis.mean)[0]
    return Edge(box, tilt(case.flight, sensitivity(case.flight, along, weights), mean, box.limits))


@dataclass(frozen=True)
class RareStudy:
    """Pushed runs of a case as the engine flies them (`study.ensemble.Study`)."""

    case: Case
    edge: Edge
    seed: int

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Fly runs first ... first + count - 1, in order."""
        case, tilt = self.case, self.edge.tilt
        solvable = np.isfinite(case.world.dop[:, 1])
        rows: list[Arrays] = []
        for begin in range(first, first + count, WIDTH):
            runs = range(begin, min(begin + WIDTH, first + count))
            components = [tilt.proposal.drawn(self.seed, run) for run in runs]
            inputs, off = pushed(case.flight, tilt, draw(case.flight, self.seed, runs), components)
            flown = fly_inputs(case.flight, inputs, len(runs))
            fixes, outputs = fix_flaws(flown, solvable, case.beliefs.velocity), output_flaws(flown)
            rows.append(
                {
                    "error": at_heights(case, [self.edge.box.time], flown.error)[:, 0],
                    "first_order": (tilt.mean[:, None] + off).T[: len(runs)],
                    "log_weight": tilt.proposal.log_weights(off)[: len(runs)],
                    **{f"fix_flaws_{part}": getattr(fixes, part) for part in FLAW_PARTS},
                    **{f"output_flaws_{part}": getattr(outputs, part) for part in FLAW_PARTS},
                }
            )
        return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}, {}, {}


def fly_all(
    case: Case,
    edge: Edge,
    seed: int,
    first_run: int,
    runs: int,
    executor: Executor,
    *,
    store: Store | None = None,
    done: Callable[[int], None] = lambda _: None,
    enough: Callable[[Ensemble], bool] | None = None,
) -> Ensemble:
    """Fly pushed runs of a case; see `study.ensemble.fly_all`."""
    return fly_ensemble(RareStudy(case, edge, seed), first_run, runs, executor, store, done, enough)


def probability(edge: Edge, flown: Ensemble) -> tuple[np.ndarray, float, float]:
    """Of ending outside the box: value with its 95 % interval (3,), relative standard error, effective samples."""
    outside = np.asarray(edge.box.beyond(flown.per_run("error")).any(axis=1))
    return weighted_share(flown.per_run("log_weight"), outside, edge.tilt.proposal.most_weight)


_UNTIL = re.compile(r"\s*probability\s+within\s+([0-9.]+)\s*%\s*")


def stopping_rule(edge: Callable[[], Edge], expression: str) -> Callable[[Ensemble], bool]:
    """`probability within 20%`: true once the 95 % interval reaches no further than that from its value, to first
    order, and rests on no fewer than `FEW` effective samples. edge: known once runs are. Raises ValueError for anything
    else."""
    match = _UNTIL.fullmatch(expression)
    try:
        share = float(match.group(1)) / 100.0 if match else 0.0
    except ValueError:
        share = 0.0
    if match is None or not 1e-3 <= share <= 0.5:
        raise ValueError(f"{expression!r}: expected `probability within 20%`, with 0.1 to 50 percent")

    def enough(flown: Ensemble) -> bool:
        _, relative, effective = probability(edge(), flown)
        return TWO_SIDED * relative <= share and effective >= FEW

    return enough


def findings(case: Case, edge: Edge, flown: Ensemble) -> list[Finding]:
    """What was wrong with the input, with what was flown, and with the probability."""
    fixes, outputs = (
        Flaws(*(flown.per_run(f"{which}_flaws_{part}") for part in FLAW_PARTS)) for which in ("fix", "output")
    )
    outputs.count[:, FAR_OFF] = 0  # pushed runs are far off on purpose
    out = judging.notes(case.warnings) + of_fixes(case, fixes) + of_outputs(case, outputs)
    (_, _, high), relative, effective = probability(edge, flown)
    if effective == 0.0:
        text = f"none of {flown.runs} runs ended outside the box: its probability is below {high:.2g} (95 %)"
        out.append(Finding("none_outside", text, (), 0, flown.runs, flown.runs))
    elif effective < FEW:
        known = f" (relative error {100.0 * relative:.0f} %)" if math.isfinite(relative) else ""
        text = (
            f"the probability rests on {effective:.0f} effective samples of {flown.runs} runs{known}: its interval is "
            "a hint; fly more runs"
        )
        out.append(Finding("few_effective_samples", text, (), int(effective), flown.runs, flown.runs))
    off = float(not_linear(edge, flown).max())
    if off > LINEAR:
        text = (
            f"the error at the box is not linear in what is drawn: {off:.2g} sigma of it is not; the interval is too "
            "narrow more often than it says (docs/rare-events.md)"
        )
        out.append(Finding("not_linear", text, (), flown.runs, flown.runs, flown.runs))
    return out


def not_linear(edge: Edge, flown: Ensemble) -> np.ndarray:
    """Standard deviation over the pushed runs of what is not of first order in the limited errors (k,), over their
    sigmas to first order; inf for errors that are no numbers."""
    some = np.isfinite(edge.box.limits)
    off = (flown.per_run("error") - flown.per_run("first_order"))[:, some]
    sigma = np.sqrt(np.diagonal(edge.tilt.proposal.covariance))[some]
    return np.where(np.isfinite(off).all(axis=0), off.std(axis=0), np.inf) / sigma


def result(case: Case, edge: Edge, flown: Ensemble, seed: int) -> Result:
    """The result."""
    draft = Draft(RARE)
    error, log_weight, tilt = flown.per_run("error"), flown.per_run("log_weight"), edge.tilt
    outside = edge.box.beyond(error)
    value, relative, effective = probability(edge, flown)
    draft["/run"] = np.arange(flown.first_run, flown.first_run + flown.runs)
    draft["/rare/error"] = error
    draft["/rare/first_order"] = flown.per_run("first_order")
    draft["/rare/log_weight"] = log_weight
    to_first_order(draft, edge.box, tilt.mean, np.sqrt(np.diagonal(tilt.proposal.covariance)))
    of_axes = [weighted_share(log_weight, one, tilt.proposal.most_weight) for one in outside.T]
    for name, data in (
        ("probability", value),
        ("axis_probability", where_limited(edge.box, np.stack([each[0] for each in of_axes]))),
        ("axis_effective_samples", where_limited(edge.box, np.array([each[2] for each in of_axes]))),
        ("relative_error", relative),
        ("effective_samples", effective),
        ("landings", np.int64(flown.runs)),
        ("outside", np.int64(outside.any(axis=1).sum())),
    ):
        draft[f"/summary/rare/{name}"] = data
    draft["/summary/count/runs"] = np.int64(flown.runs)
    out = draft.result(attributes(case, seed))
    out.variables.update(kept(findings(case, edge, flown)))
    return out
