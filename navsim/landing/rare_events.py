"""Probability that a landing ends outside the scenario's box, by importance sampling.

`simulation.importance_sampling` does the sampling; here are the study of many runs, its statistics and its result.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.filter.records import TIME_TOLERANCE
from navsim.gnss.fix_states import StateHistory
from navsim.landing import requirements
from navsim.landing.case import MOVING, Case
from navsim.landing.ensemble import (
    FAR_OFF,
    FLAW_PARTS,
    GATED,
    at_heights,
    between_outputs,
    box_errors,
    fix_flaws,
    of_aids,
    of_fixes,
    of_outputs,
    output_flaws,
    percent,
    to_runway,
)
from navsim.landing.error_box import AXES, ErrorBox, box_of, where_limited, write_first_order_box
from navsim.landing.result_groups import attributes
from navsim.landing.total_errors import went_around
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept, several
from navsim.results.result import Result
from navsim.results.schema import RARE
from navsim.runner import findings as judging
from navsim.runner.batches import Ensemble, Until
from navsim.runner.batches import fly_all as fly_ensemble
from navsim.runner.checkpoint import Arrays, CheckpointStore
from navsim.runner.executor import Executor
from navsim.runner.findings import Flaws
from navsim.runner.merge_state import pack
from navsim.runner.statistics import weighted_share
from navsim.simulation.alarm_events import SHARE, AlarmProposal
from navsim.simulation.along_truth import along_truth
from navsim.simulation.importance_sampling import (
    AirShifts,
    HistoryProposal,
    ProposalShifts,
    PushedRuns,
    ShiftsByHistory,
    proposal_shifts,
    shift_inputs,
)
from navsim.simulation.landing import LOOP_TOLERANCE, fly_inputs
from navsim.simulation.landing_covariance import analyse
from navsim.simulation.run_inputs import draw_inputs
from navsim.simulation.sensitivity import sensitivity
from navsim.statistics.importance_sampling import FEW

USUAL = 0.2
"""Default half width of the 95 % interval, relative to the probability, at which a study ends."""
MOST_RUNS = 20_000
"""Default largest number of runs."""
LINEAR = 0.2
"""Sigmas of an error that may be other than linear before intervals are too narrow (docs/rare-events-measured.md)."""


@dataclass(frozen=True)
class LimitState:
    """The box of a case, and the pushes to its edge."""

    box: ErrorBox
    tilt: ProposalShifts
    """Of fixes that have a state: those of the most likely history."""
    histories: HistoryProposal | None = None
    """Of fixes that have a state."""
    alarms: AlarmProposal | None = None
    """Alarms that break runs off; None where none do, or where they are not rare."""
    why_no_alarms: str = ""
    """The reason, where they are None."""


def prepare(case: Case) -> LimitState:
    """Importance sampling for the box of a case. Raises ValueError if a limited error depends on no random input."""
    box = box_of(case)
    assert box is not None
    before, after, share = between_outputs(case, np.array([box.time]))
    at_box = np.array([before[0], after[0]]), np.array([1.0 - share[0], share[0]])
    weights = np.zeros((3, case.shared.filter_time.size, 3))
    for output, part in zip(*at_box, strict=True):
        weights[:, output] += part * to_runway(case)
    air, off, ended = None, np.zeros(3), np.zeros(3)
    if case.shared.dispersion is not None:
        weights, positions = _off_route(case, box, at_box)
        air = AirShifts.of(case.shared.dispersion, positions)
        if case.scenario.box is not None and case.scenario.box.error == "touchdown":
            ended[:2] = _touchdown_at_rest(case)[[2, 1]] - air.mean[:2]
        off = air.mean + ended
    if case.shared.fix_states is not None:
        return _by_history(ShiftsByHistory(case.flight, weights, off, box.lower, box.upper, air), box)
    along = along_truth(case.flight)
    analysis = analyse(case.flight, np.isin(case.shared.signals.names, case.pseudolites.names), along)
    mean = at_heights(case, [box.time], analysis.mean)[0]
    if air is not None:
        mean = air.mean + np.einsum("Kos,os->K", weights, analysis.mean[:, MOVING]) + ended
    tilt = proposal_shifts(case.flight, sensitivity(case.flight, along, weights), mean, box.lower, box.upper, air)
    return LimitState(box, tilt, None, *AlarmProposal.of(case.flight))


def _by_history(shifts: ShiftsByHistory, box: ErrorBox) -> LimitState:
    """Importance sampling of runs whose fixes have a state."""
    model = shifts.model
    likely = StateHistory(np.zeros(1), np.array([int(model.shares.argmax())]))
    histories = HistoryProposal.of(shifts, box.time)
    return LimitState(box, shifts.of(model.with_forced(likely)), histories, *AlarmProposal.of(shifts.flight))


def _touchdown_at_rest(case: Case) -> np.ndarray:
    """Touchdown (4,) of a run with exact estimates that only the discrete gusts take off the route, see `Endings`."""
    ways = case.shared.dispersion
    assert ways is not None
    out = ways.end.endings(ways.disturbance.guided(ways.disturbance.at_rest, None)).touchdown[:, 0]
    if not np.isfinite(out).all():
        raise ValueError("a run that is led by the discrete gusts alone never touches down")
    return np.asarray(out)


def _off_route(case: Case, box: ErrorBox, at_box: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Weights of what makes the box's errors of runs that leave the route, to first order.

    The first (3, o, 6) are of the errors of the filter's outputs, NED. The second (3, k, 3) are of the positions that
    runs are off the route, along path axes at the samples.

    at_box: outputs beside the box, and their shares.
    """
    ways, section = case.shared.dispersion, case.scenario.box
    assert ways is not None
    assert section is not None
    own, samples = np.zeros((3, case.shared.filter_time.size, 6)), ways.disturbance.time
    positions, turn = np.zeros((3, samples.size, 3)), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    times, shares = case.shared.filter_time[at_box[0]], at_box[1]
    if section.error == "touchdown":
        ended = _touchdown_at_rest(case)
        times, shares = ended[:1], np.ones(1)
        velocity = case.trajectory.path.jet(times)[0, 1]
        later = -np.array([case.scenario.runway.rise, 0.0, 1.0]) / ended[3]  # a run that is higher flies on
        turn = np.stack([turn[0] + velocity[1] * later, turn[1] + velocity[0] * later, np.zeros(3)])
    else:
        for output, share in zip(*at_box, strict=True):
            own[:, output, states.SLICES["position"]] += share * to_runway(case)
    if section.error == "navigation":
        return own, positions
    step = samples[1] - samples[0]
    for time, share in zip(times, shares, strict=True):
        first = min(int(np.searchsorted(samples, time + TIME_TOLERANCE, side="right")) - 1, samples.size - 2)
        late = (time - samples[first]) / step
        positions[:, first] += share * (1.0 - late) * turn
        positions[:, first + 1] += share * late * turn
    if ways.steered:
        return ways.slopes_by_errors(positions), positions
    return own if section.error == "total" else np.zeros_like(own), positions


@dataclass(frozen=True)
class RareStudy:
    """Pushed runs of a case as the engine flies them (`runner.batches.Study`)."""

    case: Case
    edge: LimitState
    seed: int

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Fly runs first ... first + count - 1, in order."""
        case, tilt = self.case, self.edge.tilt
        rows: list[Arrays] = []
        for begin in range(first, first + count, WIDTH):
            runs = range(begin, min(begin + WIDTH, first + count))
            pushes = PushedRuns(case.flight, tilt, self.seed, self.edge.histories, self.edge.alarms)
            tilts, components = pushes.tilts(runs), pushes.components(runs)
            if self.edge.histories is None and tilt.air is None:
                inputs, off = shift_inputs(case.flight, tilt, draw_inputs(case.flight, self.seed, runs), components)
                flown = fly_inputs(case.flight, inputs, len(runs))
            else:
                (flown,), off = case.fly_runs(self.seed, begin, len(runs), False, pushes=pushes), pushes.off(runs)
            mean = np.stack([one.mean for one in tilts], axis=1)
            still = np.array([not one.proposal.shifts[c].any() for one, c in zip(cycle(tilts), components)])
            still &= [not pushes.is_to_alarm(run) for run in runs]
            own = {}
            if (histories := self.edge.histories) is not None:
                drawn, some = pushes.histories_of(runs), tilts[: len(runs)]
                still &= [one.from_chain for one in drawn]
                own["history_log_weight"] = np.array([one.log_weight for one in drawn])
                own["mean"] = mean.T[: len(runs)]
                own["sigma"] = np.sqrt([np.diagonal(one.proposal.covariance) for one in some])
                own["chance"] = np.stack([histories.shifts.chances(one) for one in some])
            fixes, outputs = fix_flaws(flown, case.solvable, case.design), output_flaws(flown)
            rows.append(
                {
                    "error": box_errors(case, [self.edge.box.time], flown)[:, 0],
                    "first_order": (mean + off).T[: len(runs)],
                    "log_weight": pushes.log_weights(runs, off),
                    "still": still,
                    **own,
                    "fixes": np.sum(~np.isnan(flown.fix_llh[..., 0]), axis=1),
                    "aided_rejected": of_aids(case, flown)["aided_rejected"],
                    **({"loop_gap": flown.loop_gap[:, 0]} if case.scenario.steered else {}),
                    **({"go_around": flown.go_around} if case.scenario.breaks_off else {}),
                    **{f"fix_flaws_{part}": getattr(fixes, part) for part in FLAW_PARTS},
                    **{f"output_flaws_{part}": getattr(outputs, part) for part in FLAW_PARTS},
                }
            )
        return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}, {}, {}


def fly_all(
    case: Case,
    edge: LimitState,
    seed: int,
    first_run: int,
    runs: int,
    executor: Executor,
    *,
    store: CheckpointStore | None = None,
    done: Callable[[int], None] = lambda _: None,
    enough: Callable[[Ensemble], bool] | None = None,
) -> Ensemble:
    """Fly pushed runs of a case; see `runner.batches.fly_all`."""
    return fly_ensemble(RareStudy(case, edge, seed), first_run, runs, executor, store, done, enough)


def probability(edge: LimitState, flown: Ensemble) -> tuple[np.ndarray, float, float]:
    """Probability of ending outside the box: value with its 95 % interval (3,), relative standard error, effective
    samples."""
    return _share(edge, flown, np.any(_outside(edge, flown), axis=1), edge.box.lower, edge.box.upper)


def _outside(edge: LimitState, flown: Ensemble) -> np.ndarray:
    """Which errors of runs (run, 3) are outside; runs that have gone around end nowhere."""
    return np.asarray(edge.box.beyond(flown.per_run("error")) & ~went_around(flown, edge.box.time)[:, None])


def go_around_probability(edge: LimitState, flown: Ensemble) -> tuple[np.ndarray, float, float]:
    """Probability that an alarm breaks a landing off, in the same form."""
    return _share(edge, flown, went_around(flown), np.full(3, -np.inf), np.full(3, np.inf))


def axis_probabilities(edge: LimitState, flown: Ensemble) -> list[tuple[np.ndarray, float, float]]:
    """Probability of exceeding each limit alone, in the same form."""
    outside = _outside(edge, flown)
    alone = np.eye(3, dtype=bool)
    lower, upper = np.where(alone, edge.box.lower, -np.inf), np.where(alone, edge.box.upper, np.inf)
    return [_share(edge, flown, *each) for each in zip(outside.T, lower, upper, strict=True)]


def _share(
    edge: LimitState, flown: Ensemble, outside: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Probability of runs outside (run,) of limits (3,); see `runner.statistics.weighted_share`."""
    mean, mix = edge.tilt.mean, edge.tilt.proposal
    if edge.histories is not None:
        most = inside = edge.histories.most_weight * mix.most_weight
    else:
        most = inside = mix.most_weight
        if "go_around" not in flown.columns():  # other runs are within the limits
            inside = mix.most_weight_between(lower - mean, upper - mean)
    if edge.alarms is not None:
        most, inside = most / (1.0 - SHARE), inside / (1.0 - SHARE)
    return weighted_share(flown.per_run("log_weight"), outside, most, inside)


def is_narrow(value: np.ndarray, effective: float, share: float) -> bool:
    """Whether an interval (3,) is within a fraction of its value on both sides and has at least `FEW` effective
    samples.

    A probability too small to be estimated needs no interval.
    """
    reaches = (1.0 - share) * value[0] <= value[1] and value[2] <= (1.0 + share) * value[0]
    return effective >= FEW and bool(reaches or np.isnan(value[0]))


_UNTIL = re.compile(r"\s*probability\s+within\s+([0-9.]+)\s*%\s*")


def stopping_rule(edge: Callable[[], LimitState], expression: str) -> Until:
    """`probability within 20%`: true once the 95 % interval is `is_narrow` by that share, and that of go-arounds, if
    there are any and runs are pushed to alarms. edge: known once runs are. Raises ValueError for anything else."""
    match = _UNTIL.fullmatch(expression)
    if match is None:
        raise ValueError(f"{expression!r}: with method rare expected `probability within 20%`")
    share = percent(match.group(1), expression, 0.1, 50.0)

    def judge(flown: Ensemble) -> tuple[bool, str]:
        value, _, effective = probability(edge(), flown)
        words = f"probability {value[0]:.2g} ({value[1]:.2g} to {value[2]:.2g})"
        enough = is_narrow(value, effective, share)
        if edge().alarms is not None:
            value, _, effective = go_around_probability(edge(), flown)
            words += f", of a go-around {value[0]:.2g} ({value[1]:.2g} to {value[2]:.2g})"
            enough &= effective == 0.0 or is_narrow(value, effective, share)  # exclusion may end every alarm
        return enough, words

    return Until(judge)


def findings(case: Case, edge: LimitState, flown: Ensemble) -> list[Finding]:
    """Findings about the input, the runs, and the probability."""
    fixes, outputs = (
        Flaws(*(flown.per_run(f"{which}_flaws_{part}") for part in FLAW_PARTS)) for which in ("fix", "output")
    )
    outputs.count[:, FAR_OFF] = 0  # pushed runs are far off on purpose
    told = [*case.warnings, *requirements.unevaluated_by_importance_sampling(case.scenario)]
    out = judging.notes(told) + of_fixes(case, fixes) + _rejections(case, fixes, flown)
    out += of_outputs(case, outputs)
    if case.scenario.steered:
        out += judging.open_loops(flown.per_run("loop_gap"), LOOP_TOLERANCE)
    (value, low, high), relative, effective = probability(edge, flown)
    if effective == 0.0:
        text = f"none of {several(flown.runs, 'run')} ended outside the box: its probability is below {high:.2g} (95 %)"
        out.append(Finding("none_outside", text, (), 0, flown.runs, flown.runs))
    elif value == 1.0:
        text = f"all of {several(flown.runs, 'run')} ended outside the box: its probability is above {low:.3g} (95 %)"
        out.append(Finding("all_outside", text, (), flown.runs, flown.runs, flown.runs))
    elif effective < FEW:
        known = f" (relative error {100.0 * relative:.0f} %)" if math.isfinite(relative) else ""
        text = (
            f"the probability rests on {several(round(effective), 'effective sample')} of "
            f"{several(flown.runs, 'run')}{known}: its interval is a hint; fly more runs"
        )
        out.append(Finding("few_effective_samples", text, (), int(effective), flown.runs, flown.runs))
    if case.scenario.breaks_off:
        out += _of_go_arounds(edge, flown)
    off = not_linear(edge, flown)
    if off.max() > LINEAR:
        axis = AXES[np.flatnonzero(np.isfinite(edge.box.upper))[off.argmax()]]
        text = (
            f"the {axis} error at the box is not linear in the random inputs by {off.max():.2g} sigma; the "
            "interval contains the true probability in less than 95 % of the studies (docs/rare-events.md)"
        )
        out.append(Finding("not_linear", text, (), flown.runs, flown.runs, flown.runs))
    return out


def _of_go_arounds(edge: LimitState, flown: Ensemble) -> list[Finding]:
    """Finding about too few go-arounds."""
    (_, _, high), _, effective = go_around_probability(edge, flown)
    if effective >= FEW:
        return []
    of = several(flown.runs, "run")
    text = f"none of {of} went around: the probability of a go-around is below {high:.2g} (95 %)"
    if effective > 0.0:
        text = f"the probability of a go-around rests on {several(round(effective), 'effective sample')} of {of}"
    if edge.alarms is None:
        text += f"; {edge.why_no_alarms}; method monte-carlo counts them"
    else:
        text += "; fly more runs"
    return [Finding("few_go_arounds", text, (), int(effective), flown.runs, flown.runs)]


def _rejections(case: Case, fixes: Flaws, flown: Ensemble) -> list[Finding]:
    """Finding about rejections by the gate in all runs beyond chance.

    It violates the condition on fixes if runs without a shift have too many as well.
    """
    still, probability = flown.per_run("still"), case.scenario.filter.gate.probability
    rejected, fixed = fixes.count[:, GATED], flown.per_run("fixes")
    found = judging.spread(fixes, GATED, case.shared.signals.time)
    out = judging.rejections(found, int(fixed.sum()), probability, flown.runs)
    if not judging.too_many(int(rejected[still].sum()), int(fixed[still].sum()) * probability):
        out = [_by_pushes(each) for each in out]
    for k, aid in enumerate(case.shared.aids):
        of_aid, size = flown.per_run("aided_rejected")[:, k], aid.time.size - aid.missing
        of_all = judging.rejected_of(aid.sensor.name, int(of_aid.sum()), flown.runs * size, probability)
        if not judging.too_many(int(of_aid[still].sum()), int(still.sum()) * size * probability):
            of_all = [_by_pushes(each) for each in of_all]
        out += of_all
    return out


def _by_pushes(found: Finding) -> Finding:
    """A finding that runs without a push do not bear out."""
    return replace(found, text=f"{found.text}; pushes may have caused it", against=())


def not_linear(edge: LimitState, flown: Ensemble) -> np.ndarray:
    """Nonlinear part of the limited errors (k,): its standard deviation over shifted runs, relative to the first-order
    sigma. If fixes have a state, runs count as much as their histories lead outside to first order.

    inf for errors that are not finite. Runs that have gone around do not count; nan if no other is left.
    """
    some, lands = np.isfinite(edge.box.upper), ~went_around(flown, edge.box.time)
    if not lands.any():
        return np.full(int(some.sum()), np.nan)
    off = (flown.per_run("error") - flown.per_run("first_order"))[lands][:, some]
    if edge.histories is not None:
        share = np.exp(flown.per_run("history_log_weight")[lands])[:, None] * flown.per_run("chance")[lands][:, some]
        square = np.sum(share * (off / flown.per_run("sigma")[lands][:, some]) ** 2, axis=0) / share.sum(axis=0)
        return np.where(np.isfinite(square), np.sqrt(square), np.inf)
    sigma = np.sqrt(np.diagonal(edge.tilt.proposal.covariance))[some]
    return np.where(np.isfinite(off).all(axis=0), off.std(axis=0), np.inf) / sigma


def _over_histories(draft: ResultBuilder, edge: LimitState, flown: Ensemble) -> None:
    """Mean, sigma and probabilities of the errors to first order over all histories of fix states."""
    weight = np.exp(flown.per_run("history_log_weight"))[:, None] / flown.runs
    mean, sigma, chance = (flown.per_run(name) for name in ("mean", "sigma", "chance"))
    draft["/rare/history_log_weight"] = flown.per_run("history_log_weight")
    centre = np.sum(weight * mean, axis=0) / weight.sum()
    draft["/summary/box/axis_mean"] = centre
    square = np.sum(weight * (sigma**2 + (mean - centre) ** 2), axis=0) / weight.sum()
    draft["/summary/box/axis_sigma"] = np.sqrt(square)
    draft["/summary/box/axis_first_order"] = where_limited(edge.box, np.sum(weight * chance, axis=0))


def result(case: Case, edge: LimitState, flown: Ensemble, seed: int) -> Result:
    """The result."""
    draft = ResultBuilder(RARE)
    error, log_weight, tilt = flown.per_run("error"), flown.per_run("log_weight"), edge.tilt
    outside = _outside(edge, flown)
    value, relative, effective = probability(edge, flown)
    draft["/run"] = np.arange(flown.first_run, flown.first_run + flown.runs)
    draft["/rare/error"] = np.where(went_around(flown, edge.box.time)[:, None], np.nan, error)
    draft["/rare/first_order"] = flown.per_run("first_order")
    draft["/rare/log_weight"] = log_weight
    write_first_order_box(draft, edge.box, tilt.mean, np.sqrt(np.diagonal(tilt.proposal.covariance)))
    if edge.histories is not None:
        _over_histories(draft, edge, flown)
    of_axes = axis_probabilities(edge, flown)
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
    if case.scenario.breaks_off:
        draft["/rare/go_around_time"] = flown.per_run("go_around")[:, 0]
        found = go_around_probability(edge, flown)
        draft["/summary/rare/go_around"], draft["/summary/rare/go_around_effective_samples"] = found[0], found[2]
    draft["/summary/count/runs"] = np.int64(flown.runs)
    requirements.write_verdicts(draft, case, flown.runs)
    pack(draft, flown)
    out = draft.result(attributes(case, seed))
    out.variables.update(kept(findings(case, edge, flown)))
    return out
