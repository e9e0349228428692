"""Large errors of the default filter, and those that its mixture predicts: the page mixture-tails-measured.

    python scripts/mixture_tails.py                                      the page, an hour
    python scripts/mixture_tails.py --runs 40 --cases landing            one row, a minute

At each output, samples of the mixture take the place of the truth. If the mixture is the posterior, their NEES has the
distribution of that of the runs. Finished pieces stay in results/measured/.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from operator import itemgetter

import filter_consistency as consistency
import measured
import numpy as np
from scipy.stats import chi2

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import WIDTH, as_simd, in_lanes
from navsim.filter.error_parametrisation import GaussianSum, chart_of, feed_back
from navsim.filter.estimate import fly_in_pieces, in_all_lanes
from navsim.filter.evaluation import evaluate_into
from navsim.filter.filter_loop import propagation_buffers
from navsim.filter.records import (
    OUTPUT,
    Events,
    FilterModel,
    ImuData,
    Mixture,
    Truth,
    empty_error_history,
    empty_history,
)
from navsim.filter.states import N_BASE, NAV_BIAS_FRAME, NAV_LLH, NAV_QUAT, NAV_SENSORS, NAV_VEL, PHI_D
from navsim.landing.study import Case
from navsim.simulation.flight import initial_estimate, initial_state, with_clock
from navsim.simulation.measurement_tables import measurements, table_of_all_fixes
from navsim.simulation.measurements import receiver_fixes
from navsim.simulation.run_inputs import draw_inputs

SAMPLES = 999
"""Samples of each mixture. A true one has all of them below the truth in 1 of 1000 cases."""
NOMINAL = 0.1
"""Share, %, of NEES of a Gaussian beyond its limit."""
LIMIT = chi2.isf(NOMINAL / 100.0, N_BASE)
PIECE = 88
"""Runs that are stored together."""
RUNS = {
    **dict.fromkeys(("landing, noise × 0.1", "s_turn", "circuit"), 704),
    **dict.fromkeys(("landing", "landing, lever arm", "landing, 1400 °/h", "landing, 10°"), 264),
}
"""Runs of each seed by case."""


@kernel
def displace(chart: GaussianSum, nav: np.ndarray, x: np.ndarray, declared: np.ndarray) -> None:
    """Feed errors x (r, n) back into navigation states nav (r, NAV), in place."""
    navs, errors = as_simd(nav), as_simd(x)
    space = propagation_buffers(navs[0], errors.shape[1], chart.straight, declared)
    for row in range(navs.shape[0]):
        # numba chooses it by the chart, so that it has no types to check
        feed_back(chart, navs[row], errors[row], space)  # type: ignore[no-untyped-call]


def sampled(
    weight: np.ndarray, covariance: np.ndarray, samples: int, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Components (s,) of samples of a mixture, and their errors (s, n) from the component's estimate.

    weight (M,); covariance (M, n, n).
    """
    counts = random.multinomial(samples, weight / weight.sum())
    errors = [
        random.standard_normal((count, len(p))) @ np.linalg.cholesky(p).T
        for count, p in zip(counts, covariance, strict=True)
        if count
    ]
    return np.repeat(np.arange(weight.size), counts), np.concatenate(errors)


def as_truth(nav: np.ndarray) -> Truth:
    """Navigation states (r, NAV, W) as truths."""
    parts = (NAV_LLH, NAV_VEL), (NAV_VEL, NAV_QUAT), (NAV_QUAT, NAV_BIAS_FRAME), (NAV_SENSORS, None)
    return Truth(*(nav[:, first:last].copy() for first, last in parts))


def judged(model: FilterModel, nav: np.ndarray, p: np.ndarray, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Heading error in its sigma (r, W) and NEES (r, W) of an output nav (NAV, W), p (n, n, W), for r truths."""
    history, errors = empty_history(len(truth.llh), 0, len(p), WIDTH), empty_error_history(truth, len(p), 0, WIDTH)
    history.navigation[...], history.covariance[...] = nav, p
    evaluate_into(model, history, errors)
    return errors.errors.error[:, PHI_D] / errors.sigma[:, PHI_D], errors.errors.nees


@dataclass
class Judged:
    """Outputs of runs (o, r): NEES, mean NEES of samples, share of them beyond the limit, whether none of them is
    beyond the run, number of components, share of samples with heading beyond `consistency.FAR` sigma."""

    nees: np.ndarray
    mean: np.ndarray
    predicted: np.ndarray
    beyond_own: np.ndarray
    components: np.ndarray
    far: np.ndarray

    @property
    def beyond(self) -> np.ndarray:
        """Whether NEES of the runs is beyond the limit (o, r)."""
        return self.nees > LIMIT


def of_output(
    model: FilterModel, mean: np.ndarray, p: np.ndarray, own: Mixture, truth: Truth, random: np.random.Generator
) -> list[np.ndarray]:
    """Members of `Judged` (W,) of one output mean (NAV, W), p (n, n, W)."""
    drawn, x = np.empty((SAMPLES, *mean.shape)), np.empty((SAMPLES, *p.shape[1:]))
    there = own.weight > 0.0
    for lane in range(WIDTH):
        which = np.flatnonzero(there[:, lane])
        part, x[..., lane] = sampled(own.weight[which, lane], own.covariance[which, ..., lane], SAMPLES, random)
        drawn[..., lane] = own.navigation[which[part], :, lane]
    displace(chart_of(model), in_lanes(drawn), in_lanes(x), model.declared)
    heading, nees = judged(model, mean, p, as_truth(drawn))
    _, flown = judged(model, mean, p, truth)
    return [
        flown[0], nees.mean(axis=0), (nees > LIMIT).mean(axis=0), (nees < flown).all(axis=0), there.sum(axis=0),
        (np.abs(heading) > consistency.FAR).mean(axis=0),
    ]  # fmt: skip


def outputs(case: Case) -> np.ndarray:
    """Rows of the outputs that the page of consistency judges."""
    clock = case.shared.filter_time
    wanted = sorted({consistency.CORNER, *np.arange(consistency.TENTH, clock[-1] + 1e-6, consistency.TENTH).tolist()})
    return np.unique([int(np.argmin(np.abs(clock - t))) for t in wanted])


def fly(case: Case, seed: int, first: int) -> list[list[np.ndarray]]:
    """Members of `Judged` of `WIDTH` runs at each of `outputs`. Raises ValueError for a case that it can't fly."""
    flight, shared, model = case.flight, case.shared, case.flight.model
    if shared.dispersion is not None or flight.design.tight or flight.events.ahead.any():
        raise ValueError("only loose coupling without latency along the route")
    inputs, rows = draw_inputs(flight, seed, range(first, first + WIDTH)), outputs(case)
    llh, velocity, _, covariance = receiver_fixes(shared, inputs.ranges, inputs.rates)
    tables = measurements(flight, table_of_all_fixes(flight, llh, velocity, covariance), ())
    nav = with_clock(flight, initial_estimate(flight, inputs.initial), inputs.clock)
    state, events = initial_state(flight, nav, in_all_lanes(flight.covariance)), flight.events
    # outputs do not change the filter, so only those that are judged
    kept = (events.kind != OUTPUT) | np.isin(events.row, rows)
    row = np.where(events.kind == OUTPUT, np.searchsorted(rows, events.row), events.row)
    events = Events(events.time[kept], events.kind[kept], row[kept], events.ahead[kept])
    at = shared.at_filter
    llh, velocity, quaternion = (in_all_lanes(m[rows]) for m in (at.llh, at.velocity_ned, at.quaternion))
    truth = Truth(llh, velocity, quaternion, np.ascontiguousarray(inputs.sensors[rows]))
    random, out = np.random.default_rng([seed, first, 38]), []
    imu = ImuData(shared.imu_time, inputs.dtheta, inputs.dv)
    for _, output, history in fly_in_pieces(imu, tables, events, state, model, 1):
        if output.stop > output.start:
            mean, p = history.navigation[0], history.covariance[0]
            now = truth.each(itemgetter(output))
            out.append(of_output(model, mean, p, state.components, now, random))
    return out


def piece(label: str, seed: int, first: int, runs: int) -> Judged:
    """Runs first ... first + runs - 1 of a case, stored."""

    def compute() -> list[list[list[float]]]:
        case = consistency.ready(label, consistency.DEFAULT)
        packs = [fly(case, seed, start) for start in range(first, first + runs, WIDTH)]
        members = zip(*([np.stack(m) for m in zip(*pack, strict=True)] for pack in packs), strict=True)
        return [np.concatenate(m, axis=1).astype(float).tolist() for m in members]

    return Judged(*map(np.array, measured.kept(("mixture tails", SAMPLES, label, seed, first, runs), compute)))


def percent(of_outputs: np.ndarray) -> str:
    """Mean (%) over outputs and runs (o, r), with 1 sigma of its sampling."""
    mean = 100.0 * of_outputs.mean(axis=0)
    return f"{mean.mean():.2f} ± {mean.std() / np.sqrt(mean.size):.2f}"


def excess(of_outputs: np.ndarray) -> float:
    """What a printed share (%) has beyond the nominal one; 0 where it is below twice its sampling error."""
    mean, error = map(float, percent(of_outputs).split(" ± "))
    return mean - NOMINAL if mean - NOMINAL > 2.0 * error else 0.0


def explained(found: Judged) -> str:
    """Part of the excess over the nominal share that is predicted, %, by the printed digits."""
    more = excess(found.beyond)
    return f"{100.0 * (float(percent(found.predicted).split()[0]) - NOMINAL) / more:.0f}" if more else "-"


HEAD = (
    "| case | runs | predicted, % | observed, % | explained, % | beyond own, % | several: predicted | observed "
    "| beyond own | one: observed | beyond own | heading > 6 σ |",
    f"|{'---|' * 12}",
)


def flown(label: str, runs: int) -> Judged:
    """All runs of a case, so many of each seed."""
    parts = [
        piece(label, seed, first, min(PIECE, runs - first))
        for seed in consistency.SEEDS
        for first in range(0, runs, PIECE)
    ]
    return Judged(*(np.concatenate([vars(part)[name] for part in parts], axis=1) for name in vars(parts[0])))


def cells(label: str, found: Judged) -> list[str]:
    """The row of a case."""
    shares = found.predicted, found.beyond, found.beyond_own
    several = (found.components > 1.0).mean(axis=1) > 0.5
    far = f"{SAMPLES * found.far.sum():.0f} of {SAMPLES * found.far.size / 1e6:.0f} million"
    every, mixed, single = ([percent(share[at]) for share in shares] for at in (slice(None), several, ~several))
    return [label, str(found.nees.shape[1]), *every[:2], explained(found), every[2], *mixed, *single[1:], far]


def results(labels: Sequence[str], found: Sequence[Judged]) -> list[str]:
    """What the rows come to."""
    predicted, observed = (
        100.0 * np.array([m.mean() for m in each])
        for each in zip(*((one.predicted, one.beyond) for one in found), strict=True)
    )
    alone = 100.0 * np.array([one.beyond[(one.components > 1.0).mean(axis=1) <= 0.5].mean() for one in found])
    parts = [int(part) for part in map(explained, found) if part != "-"]
    beyond = 100.0 * np.mean([one.beyond_own.mean() for one in found])
    own = ", ".join(f"`{label}`" for label, one in zip(labels, found, strict=True) if excess(one.beyond_own))
    return [
        f"The mixture predicts {predicted.min():.2f} to {predicted.max():.2f} %, runs show {observed.min():.2f} to "
        f"{observed.max():.2f} %. Where their excess over {NOMINAL} % is",
        f"beyond chance (2 sigma), the mixture explains {consistency.span(parts)} % of it. The cause of the rest is "
        "unknown: with one",
        f"component, hence without a mixture, {alone.min():.2f} to {alone.max():.2f} % exceed the limit, too.",
        f"Errors beyond their own mixture are too frequent by more than chance in: {own or 'no case'}.",
        f"Over all cases their mean share is {beyond:.1f} % instead of {NOMINAL} %: the mixture is not quite the "
        "posterior.",
        "",
    ]


INTRODUCTION = """# Large errors of the default filter, and its mixture

NEES judges an error by one mean and covariance. The default filter's density is a [mixture](theory/gaussian-sum.md).
If the mixture is the posterior, its samples exceed the 99.9 % limit of NEES as often as the errors do.

Times, seeds and first runs are those of [consistency](filter-consistency.md).

"""
COLUMNS = f"""
| column | meaning |
|---|---|
| predicted | share of {SAMPLES} samples of each mixture beyond the 99.9 % limit of NEES |
| observed | share of the errors beyond it, same runs and times |
| explained | predicted part of the excess over {NOMINAL} %, by the printed digits; - where that is below twice its ± |
| beyond own | share of the errors whose NEES exceeds that of all samples; 0.1 % if the mixture is exact |
| several, one | times at which most runs have several components, or one, as after a turn |
| heading > 6 σ | samples with a heading error beyond {consistency.FAR:g} σ |
| ± | 1 sigma of the chance of a finite number of runs |
"""


def probe() -> measured.Probe:
    """The first runs of a case: NEES and predictions at 59 s and at the end."""
    case = consistency.ready("landing", consistency.DEFAULT)
    first = fly(case, consistency.SEEDS[0], 0)
    return {"landing": [float(member.mean()) for at in (5, -1) for member in first[at][:2]]}


PAGE = measured.Page("mixture-tails-measured.md", "mixture_tails", consistency.SEEDS, probe)


def main() -> None:
    """Print the rows of what is asked for, or write the page."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--runs", type=int, help="runs of each seed; without it those of the page")
    ask.add_argument("--cases", nargs="+", choices=list(RUNS), metavar="CASE", help=", ".join(RUNS))
    options = ask.parse_args()
    whole = options.runs is None and options.cases is None
    begun = measured.commit() if whole else ""
    labels = options.cases or list(RUNS)
    every = [flown(label, options.runs or RUNS[label]) for label in labels]
    rows = [measured.row(*cells(label, found)) for label, found in zip(labels, every, strict=True)]
    if whole:
        lines = [*INTRODUCTION.splitlines(), *results(labels, every), *HEAD, *rows, *COLUMNS.splitlines()]
        PAGE.write(lines, begun)
    else:
        sys.stdout.write("\n".join([*HEAD, *rows, ""]))


if __name__ == "__main__":
    main()
