"""Linear covariance analysis of a landing scenario: the accuracy table and the error budget without a single run."""

from __future__ import annotations

import math

import numpy as np

from navsim.filter import states
from navsim.geodesy.attitude import rpy_jacobian
from navsim.landing import integrity, requirements, risk_sampling
from navsim.landing.case import MOVING, PERCENTILES, Case, crossing_times, rms_window
from navsim.landing.consistency import evaluate_states, expected_ratios, put_consistency
from navsim.landing.ensemble import (
    FAR_OFF,
    FOLLOWED,
    NO_VELOCITY,
    NOT_POSITIVE,
    PENALTY_UNSOLVED,
    UNHEARD,
    UNRANGED,
    interpolate_outputs,
    of_fixes,
    of_outputs,
    to_runway,
    turned_variances,
    variances_at_heights,
)
from navsim.landing.error_box import box_of, write_first_order_box
from navsim.landing.result_groups import attributes, start_result, write_accuracy, write_filter_sigmas
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept, several
from navsim.results.result import Result
from navsim.results.schema import COVARIANCE
from navsim.runner.consistency import Ratios
from navsim.runner.findings import (
    BEYOND,
    Flaws,
    doubted,
    notes,
    of_states,
    positive,
    tally,
)
from navsim.scenario.analysable import check_analysable
from navsim.simulation.landing_covariance import Analysis, analyse, folded_quantile


def budget(analysis: Analysis) -> tuple[str, ...]:
    """Sources of error in the order of the budget.

    systematic: errors that are not random, such as survey errors, fixed biases, a wrong lever arm or latency in the
    filter.
    """
    return (*analysis.sources, "systematic")


def covariance_analysis(case: Case) -> Analysis:
    """The analysis of a case. Raises ValueError for a smoother, AnalysisError for a defect of the analysis."""
    check_analysable(case.scenario)
    of_pseudolites = np.isin(case.shared.signals.names, case.pseudolites.names)
    return analyse(case.flight, of_pseudolites)


def covariance_result(case: Case, analysis: Analysis, seed: int) -> Result:
    """Result of a covariance analysis: the names of a Monte Carlo study where they mean the same, with `/covariance`
    and `/budget`."""
    draft = start_result(case, COVARIANCE)
    square = _squares(analysis)
    draft["/run"] = np.zeros(1, np.int64)
    draft["/filter/sigma"] = np.sqrt(np.diagonal(analysis.assumed, axis1=1, axis2=2))[None]
    draft["/covariance/rms"] = np.sqrt(square.sum(axis=0))
    draft["/covariance/mean"] = analysis.mean
    draft["/budget/source"] = np.array(budget(analysis))
    draft["/budget/rms"] = np.sqrt(square)
    for group in ("filter", "covariance", "budget"):
        draft[f"/{group}/time"] = case.shared.filter_time
        draft.put(f"/{group}/state", np.array(case.states), {"state_units": ", ".join(case.state_units)})
    _summary(draft, case, analysis, square)
    _beacons(draft, case, analysis)
    integrity.write_levels(draft, case)
    integrity.in_runway_axes(draft, case)
    integrity.write_comparison(draft, case)
    risk_sampling.sampled_risks(draft, case, seed)
    requirements.write_verdicts(draft, case, 0, _moments(case, analysis))
    out = draft.result(attributes(case, seed))
    out.variables.update(kept(covariance_findings(case, analysis)))
    return out


def _beacons(draft: ResultBuilder, case: Case, analysis: Analysis) -> None:
    """Write sigmas with beacons, and those of the same filter without them, along the flight and at heights."""
    alone = case.without_beacons
    if alone is None:
        return
    without, axes = covariance_analysis(alone), (("lateral", 0), ("vertical", 2))
    draft["/beacons/output"] = case.shared.filter_time
    for end, its in (("", analysis), ("_without", without)):
        variance = turned_variances(to_runway(case), its.assumed[:, :3, :3])
        for name, i in axes:
            draft[f"/beacons/{name}_sigma{end}"] = np.sqrt(variance[:, i])
    at = variances_at_heights(case, crossing_times(case), without.assumed[:, :3, :3])
    for name, i in axes:
        draft[f"/summary/at/{name}_without_beacons"] = np.sqrt(at[:, i])


def _beyond_range(case: Case) -> list[str]:
    """Note that the analysis neglects the sensors' range, if the route exceeds it."""
    out, interval = [], np.diff(case.shared.imu_time)[:, None]
    for triad, exact, key in (
        (case.flight.gyro, case.shared.dtheta, "imu.gyro.range_deg_s"),
        (case.flight.accel, case.shared.dv, "imu.accelerometer.range_g"),
    ):
        over = int((np.abs(exact) > triad.further.largest * interval).any(axis=1).sum())
        if over:
            out.append(
                f"{several(over, 'sample')} of the route beyond {key}: the covariance analysis leaves the limit out"
            )
    return out


def covariance_findings(case: Case, analysis: Analysis) -> list[Finding]:
    """Findings about the input, the fixes of the error-free flight, and the filter's sigmas."""
    none, e = analysis.degrees == 0, analysis.degrees.size
    solvable = case.solvable
    fixes = np.zeros((UNRANGED + 1, e), bool)
    if case.design.tight:
        fixes[UNRANGED] = none
    else:
        fixes[UNHEARD], fixes[PENALTY_UNSOLVED] = none & ~solvable, none & solvable
        fixes[NO_VELOCITY] = case.design.velocity & (analysis.degrees == 3)
    outputs = np.zeros((FAR_OFF + 1, e + 1), bool)
    rms = np.sqrt(_squares(analysis).sum(axis=0))[:, FOLLOWED]
    assumed = np.diagonal(analysis.assumed, axis1=1, axis2=2)[:, FOLLOWED]
    outputs[NOT_POSITIVE] = ~positive(analysis.assumed)
    outputs[FAR_OFF] = (rms > BEYOND * np.sqrt(np.maximum(assumed, 0.0))).any(axis=1)
    found = notes([*case.warnings, *_beyond_range(case), *integrity.level_warnings(case)])
    if integrity.is_kept_from_faults(case):
        found += notes(
            ["the covariance analysis knows no exclusion and drops no fix: errors are those with the faults"]
        )
    found += of_fixes(case, _one(fixes)) + of_outputs(case, _one(outputs))
    if outputs[NOT_POSITIVE].any():
        return found  # no normalised square is defined
    for name, states_, words in (
        ("sigma_position_velocity", np.flatnonzero(case.uncertain[MOVING]), "errors of position and velocity"),
        ("sigma_all_states", np.flatnonzero(case.uncertain), f"errors of {case.degrees()} states"),
    ):
        mean = float(analysis.expected_square(states_)[1:].mean()) if e else math.nan
        found += doubted(name, words, mean, math.inf)
    found += of_states(evaluate_states(case, _expected(case, analysis))[1])
    for sensor, (squares, count) in analysis.aided.items():
        if count:
            found += doubted("aided_innovations", f"innovations of the {sensor}", float(squares / count), math.inf)
    degrees = analysis.degrees.sum()
    if degrees:
        found += doubted("innovations", "innovations", float(np.nansum(analysis.nis)) / degrees, math.inf)
    return found


def _one(masks: np.ndarray) -> Flaws:
    """Flaws of masks (flaw, index) as those of a single run."""
    flaws = tally(masks)
    return Flaws(flaws.count[None], flaws.first[None], flaws.last[None])


def covariance_summary(case: Case, analysis: Analysis) -> ResultBuilder:
    """The part of the result that the analysis gives to `/summary`, for those who need no more."""
    draft = ResultBuilder(COVARIANCE)
    _summary(draft, case, analysis, _squares(analysis))
    return draft


def judged_without_runs(case: Case, analysis: Analysis | None) -> list[requirements.RequirementValue]:
    """Values of a case's requirements from the geometry, and from its covariance analysis if there is one."""
    draft = ResultBuilder(COVARIANCE) if analysis is None else covariance_summary(case, analysis)
    integrity.write_levels(draft, case)
    return requirements.fulfilments(draft, case, 0, None if analysis is None else _moments(case, analysis))


def _moments(case: Case, analysis: Analysis) -> requirements.Moments:
    mean, cov = _at_heights(case, analysis, crossing_times(case))
    return mean, np.sqrt(np.diagonal(cov, axis1=1, axis2=2))


def _squares(analysis: Analysis) -> np.ndarray:
    """Mean squares of every source of the budget (source, t, n)."""
    return np.concatenate([analysis.variance, analysis.mean[None] ** 2])


def _exact(values: np.ndarray) -> np.ndarray:
    """Values (...) as intervals of no width (..., 3)."""
    return np.repeat(np.asarray(values)[..., None], 3, axis=-1)


def _summary(draft: ResultBuilder, case: Case, analysis: Analysis, square: np.ndarray) -> None:
    window, n = rms_window(case), len(case.states)
    late = square[:, window].mean(axis=1) if window.any() else np.full(square.shape[::2], np.nan)
    mean, cov = _at_heights(case, analysis, crossing_times(case))
    if (box := box_of(case)) is not None:
        (off,), (spread,) = _at_heights(case, analysis, [box.time])
        write_first_order_box(draft, box, off, np.sqrt(np.diagonal(spread)))
    attitude = states.SLICES["attitude"]
    square_of_all = analysis.covariance + analysis.mean[:, :, None] * analysis.mean[:, None, :]
    to_rpy = rpy_jacobian(case.shared.at_filter.rpy[window])

    def late_rpy(history: np.ndarray) -> np.ndarray:
        found = turned_variances(to_rpy, history[window, attitude, attitude])
        return found.mean(axis=0) if window.any() else np.full(3, np.nan)

    write_accuracy(
        draft,
        case,
        _exact(np.sqrt(late.sum(axis=0)[: states.SENSORS])),
        _exact(np.sqrt(late_rpy(square_of_all))),
        _exact(np.sqrt(late[:, :2].sum())),
        _exact(np.sqrt(late[:, 2].sum())),
        _exact(np.sqrt(mean**2 + np.diagonal(cov, axis1=1, axis2=2)).T),
    )
    variance = np.diagonal(analysis.assumed, axis1=1, axis2=2)[window]
    write_filter_sigmas(
        draft,
        variance.mean(axis=0) if window.any() else np.full(n, np.nan),
        late_rpy(analysis.assumed),
        variances_at_heights(case, crossing_times(case), analysis.assumed[:, :3, :3]),
    )
    draft["/summary/percentile"] = np.array(PERCENTILES)
    for i, name in enumerate(("lateral", "along", "vertical")):
        quantiles = [
            [folded_quantile(p / 100.0, m[i], math.sqrt(c[i, i])) for p in PERCENTILES]
            for m, c in zip(mean, cov, strict=True)
        ]
        draft[f"/summary/at/{name}_percentile"] = np.array(quantiles)
    draft["/summary/budget/source"] = np.array(budget(analysis))
    for name, columns in (("horizontal", [0, 1]), ("vertical", [2])):
        part = late[:, columns].sum(axis=1)
        share = part / part.sum() if part.any() else np.full(part.shape, np.nan)
        draft[f"/summary/budget/{name}"] = np.sqrt(part)
        draft[f"/summary/budget/{name}_share"] = share
    draft["/summary/consistency/time"] = case.shared.filter_time
    every, moving = np.flatnonzero(case.uncertain), np.flatnonzero(case.uncertain[MOVING])
    nis = np.concatenate([[np.nan], analysis.nis / np.maximum(analysis.degrees, 1)])
    for name, values, degrees in (
        ("nees", analysis.expected_square(every), every.size),
        ("nees_position_velocity", analysis.expected_square(moving), moving.size),
        ("nis", nis, int(analysis.degrees.max(initial=0))),
    ):
        draft.put(f"/summary/consistency/{name}", values, {"degrees_of_freedom": degrees})
    put_consistency(draft, case, _expected(case, analysis), None)
    lost = int(np.sum(~np.isfinite(case.shared.dop[:, 1]) if case.design.tight else analysis.degrees == 0))
    for name, value in (("runs", 0), ("fixes", analysis.degrees.size - lost), ("epochs_without_fix", lost)):
        draft[f"/summary/count/{name}"] = np.int64(value)


def _expected(case: Case, analysis: Analysis) -> Ratios:
    """Errors in units of the filter's sigma, to first order."""
    second = np.diagonal(analysis.covariance, axis1=1, axis2=2) + analysis.mean**2
    assumed = np.diagonal(analysis.assumed, axis1=1, axis2=2)
    return expected_ratios(case, np.sqrt(second), np.sqrt(assumed))


def _at_heights(case: Case, analysis: Analysis, times: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Mean (h, 3) and covariance (h, 3, 3) of lateral, along, vertical errors at times, s; both are interpolated
    between the filter's outputs."""
    turn = to_runway(case)
    mean = interpolate_outputs(case, times, analysis.mean[:, : states.VEL]) @ turn.T
    position = analysis.covariance[:, : states.VEL, : states.VEL]
    return mean, turn @ interpolate_outputs(case, times, position.reshape(-1, 9)).reshape(-1, 3, 3) @ turn.T
