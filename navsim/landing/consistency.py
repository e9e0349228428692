"""Consistency test of the states of a landing's filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from navsim.filter import states
from navsim.filter.measurement_kinds import PRODUCT, RANGE
from navsim.landing.case import Case
from navsim.results.builder import ResultBuilder
from navsim.runner.batches import Ensemble
from navsim.runner.consistency import RatioBand, Ratios, StateVerdict, correlation_of, evaluate, simultaneous_band
from navsim.simulation.along_truth import along_truth
from navsim.simulation.error_sources import transmitter_error_states
from navsim.statistics.consistency import ROUNDING, correlated_states

EXACT_START = 1e-3
"""Ratio at time 0 below which a state starts without error, apart from the smallest initial sigma of a filter."""
BEYOND = ("beyond_95", "beyond_99_9")
"""Names of the shares of runs beyond each of `runner.consistency.LIMITS`."""


def ratios_of_runs(case: Case, ensemble: Ensemble) -> Ratios:
    """Ratios of errors to sigma of an ensemble, from the runs that have one if these are at least half of all."""
    squares, known = ensemble.total("ratio_square"), ensemble.total("ratio_known")
    correlation = correlation_of(squares, ensemble.total("ratio_step"))
    found = _ratios(case, np.sqrt(_of_known(squares, known, ensemble.runs)), ensemble.runs, correlation)
    fewest = int(known[~np.isnan(found.z)].min(initial=ensemble.runs))
    return replace(found, runs=fewest, flown=ensemble.runs)


def shares_beyond(ensemble: Ensemble) -> np.ndarray:
    """Shares of those runs (k, t, n) whose error is beyond each of `runner.consistency.LIMITS`."""
    return _of_known(ensemble.total("ratio_beyond"), ensemble.total("ratio_known"), ensemble.runs)


def _of_known(total: np.ndarray, known: np.ndarray, runs: int) -> np.ndarray:
    """Means of sums over known (t, n) runs; nan if these are less than half of all."""
    return np.asarray(np.where(2 * known >= runs, total / np.maximum(known, 1), np.nan))


def expected_ratios(case: Case, rms: np.ndarray, sigma: np.ndarray) -> Ratios:
    """The ratios that a covariance analysis expects of true errors (t, n) and the filter's sigma (t, n)."""
    none = np.where(rms <= ROUNDING, np.nan, np.inf)
    z = np.divide(rms, sigma, out=none, where=sigma > 0.0)
    return _ratios(case, z, 0, np.full(rms.shape[1], np.nan))


def _ratios(case: Case, z: np.ndarray, runs: int, correlation: np.ndarray) -> Ratios:
    known = np.where(case.uncertain, z, np.nan)
    # not Gaussian; they enlarge the sigma of other states
    known[:, states.SENSORS + np.flatnonzero(case.flight.model.declared["sensor"] == PRODUCT)] = np.nan
    known[0, known[0] < EXACT_START] = np.nan
    return Ratios(case.shared.filter_time, case.states, known, runs, correlation)


def evaluate_states(case: Case, ratios: Ratios) -> tuple[RatioBand, StateVerdict]:
    """The band of a right filter, and the verdict with the scenario's tolerance."""
    band = simultaneous_band(ratios)
    return band, evaluate(ratios, band, case.scenario.filter.sigma_tolerance)


def put_consistency(draft: ResultBuilder, case: Case, ratios: Ratios, beyond: np.ndarray | None) -> None:
    """Write the ratios, and the worst of them. beyond: fractions of runs (k, t, n) beyond the limits."""
    band, verdict = evaluate_states(case, ratios)
    draft["/consistency/time"] = ratios.time
    draft["/consistency/state"] = np.array(ratios.names, dtype=object)
    limits = {"band_low": band.low, "band_high": band.high, "runs": ratios.runs}
    draft.put("/consistency/z", ratios.z, limits)
    draft.put("/summary/consistency/verdict", verdict.words, {"tolerance": case.scenario.filter.sigma_tolerance})
    draft["/summary/consistency/state"] = np.array(ratios.names, dtype=object)
    draft["/summary/consistency/looks"] = band.looks
    rows, columns = _largest(ratios.z), np.arange(len(ratios.names))
    known = ratios.looks > 0
    least = np.where(known, np.where(np.isnan(ratios.z), np.inf, ratios.z).min(axis=0, initial=np.inf), np.nan)
    draft["/summary/consistency/worst_z"] = np.where(known, ratios.z[rows, columns], np.nan)
    draft["/summary/consistency/worst_time"] = np.where(known, ratios.time[rows], np.nan)
    draft["/summary/consistency/least_z"] = least
    for name, shares in zip(BEYOND, beyond if beyond is not None else (), strict=False):
        draft[f"/consistency/{name}"] = np.where(np.isnan(ratios.z), np.nan, shares)
        draft[f"/summary/consistency/worst_{name}"] = np.where(known, shares[rows, columns], np.nan)
    if case.flight.transmitter_states is not None:
        _put_pairs(draft, case)


def _put_pairs(draft: ResultBuilder, case: Case) -> None:
    """Write which errors of pseudolites the filter cannot tell from each other, from position, clock, ranging errors.

    The pairs are those at the end of the error-free flight. A position counts along the line of sight.
    """
    mine = case.flight.transmitter_states
    assert mine is not None
    own, n = transmitter_error_states(case.flight), case.flight.model.states
    ranging = states.SENSORS + np.flatnonzero(case.flight.model.declared["sensor"] == RANGE)
    clock = np.arange(n - len(case.flight.model.clock.scales) - 1, n) if case.design.tight else np.empty(0, int)
    others = np.concatenate([np.arange(states.POS, states.POS + 3), ranging, clock]).astype(int)
    lines, along = mine.along_lines_of_sight()
    rows = np.concatenate([np.eye(n), np.zeros((len(lines), n))])
    rows[n:, own] = along
    names = [*map(states.display_name, case.states), *(f"position of {name} along the line of sight" for name in lines)]
    among = np.concatenate([own[~mine.of_positions], np.arange(n, len(rows)), others])
    pairs = correlated_states(rows @ along_truth(case.flight).lin.assumed[-1] @ rows.T, among)
    pairs = [pair for pair in pairs if pair[0] not in others]  # others are the last ones
    draft["/summary/consistency/pair"] = np.array([f"{names[a]}, {names[b]}" for a, b, _ in pairs], dtype=object)
    draft["/summary/consistency/pair_correlation"] = np.array([c for _, _, c in pairs], dtype=float)


def _largest(z: np.ndarray) -> np.ndarray:
    """At which output (n,) each state has its largest z, 0 for none."""
    return np.asarray(np.where(np.isnan(z), -np.inf, z).argmax(axis=0))
