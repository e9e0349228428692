"""The result of a Monte Carlo study of a landing."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter

import numpy as np

from navsim.filter import states
from navsim.filter.measurement_kinds import FIX
from navsim.geodesy.earth import llh_from_ecef
from navsim.gnss.constellations.systems import CLOCKS
from navsim.integrity.gbas_station import DIFFERENCES, HISTORY
from navsim.landing import integrity, requirements, risk_sampling
from navsim.landing.case import MOVING, PERCENTILES, Case, rms_window
from navsim.landing.consistency import put_consistency, ratios_of_runs, shares_beyond
from navsim.landing.controlled import controls_of, far_from_first_order, put_controlled
from navsim.landing.ensemble import GATED, LEVELS, PENALTY_UNSOLVED, UNHEARD, findings
from navsim.landing.error_box import box_of, write_box_counts
from navsim.landing.fix_states import put_fix_states
from navsim.landing.result_groups import attributes, start_result, write_accuracy, write_filter_sigmas
from navsim.landing.total_errors import put_total_errors, went_around, went_around_at_heights
from navsim.results.builder import ResultBuilder
from navsim.results.findings import kept
from navsim.results.result import Result, Stream
from navsim.results.schema import LANDING, RUNWAY_AXES
from navsim.runner.batches import Ensemble
from navsim.runner.merge_state import pack
from navsim.runner.statistics import (
    consistency_band,
    ellipsoid_probability,
    mean_interval,
    rms_interval,
    rms_interval_of_means,
)


def result(case: Case, ensemble: Ensemble, seed: int, *, keep: str) -> Result:
    """The result of an ensemble that was flown with the same `keep`.

    keep: `all` also stores measurements and fixes of every run, `errors` the filter's errors, `none` the
    statistics alone.
    """
    draft = start_result(case, LANDING)
    draft["/run"] = np.arange(ensemble.first_run, ensemble.first_run + ensemble.runs)
    if keep == "all":
        _receiver(draft, case, ensemble)
        _measurements(draft, case, ensemble)
    if keep != "none":
        _filter(draft, case, ensemble, keep)
        _aiding(draft, case, ensemble, keep == "all")
        _watched(draft, case, ensemble)
    integrity.write_levels(draft, case)
    integrity.in_runway_axes(draft, case)
    integrity.write_comparison(draft, case)
    integrity.write_counts(draft, case, ensemble)
    risk_sampling.sampled_risks(draft, case, seed)
    _summary(draft, case, ensemble)
    put_controlled(draft, case, ensemble)
    within = integrity.levels_within(case, ensemble)
    requirements.write_verdicts(draft, case, ensemble.runs, within=within, controls=controls_of(case, ensemble))
    pack(draft, ensemble)
    out = draft.result(attributes(case, seed))
    out.variables.update(kept([*findings(case, ensemble), *far_from_first_order(case, ensemble)]))
    return out


def _history(
    ensemble: Ensemble, name: str, convert: Callable[[np.ndarray], np.ndarray] = lambda block: block
) -> Stream:
    """A kept history as a stream of blocks along the run axis, never in memory as a whole."""
    first = convert(next(ensemble.blocks(name)))
    return Stream((ensemble.runs, *first.shape[1:]), first.dtype, lambda: map(convert, ensemble.blocks(name)))


def _measurements(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    s = case.shared.signals
    draft["/measurements/time"] = s.time
    draft["/measurements/source"] = np.array(s.names, dtype=object)
    draft["/measurements/pseudorange"] = _history(ensemble, "pseudorange")
    draft["/measurements/range_rate"] = _history(ensemble, "range_rate")
    draft["/imu/time"] = case.shared.imu_time[1:]
    for name in ("delta_angle", "delta_velocity"):
        draft[f"/imu/{name}"] = _history(ensemble, name)
    draft["/measurements/cn0"] = _history(ensemble, "pseudorange", lambda block: np.broadcast_to(s.cn0, block.shape))


def _receiver(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    s = case.shared.signals
    clocks = sorted(set(s.time_scale[np.any(s.used, axis=0)].tolist()))
    draft["/receiver/clock_name"] = np.array([CLOCKS[c] for c in clocks], dtype=object)
    draft["/receiver/position_llh"] = _history(ensemble, "fix_llh")
    draft["/receiver/velocity_ned"] = _history(ensemble, "fix_velocity")
    if case.shared.dispersion is not None:
        draft["/receiver/true_position_llh"] = _history(ensemble, "antenna", llh_from_ecef)
    if case.shared.fix_states is not None:
        for name in ("fix_state", "fix_flag"):
            draft[f"/receiver/{name}"] = _history(ensemble, name, lambda block: block.astype(np.int8))
    draft["/receiver/clock"] = _history(ensemble, "fix_clock", lambda block: block[..., clocks])


def _filter(draft: ResultBuilder, case: Case, ensemble: Ensemble, keep: str) -> None:
    shared = case.shared
    draft["/filter/time"] = shared.filter_time
    draft.put("/filter/state", np.array(case.states), {"state_units": ", ".join(case.state_units)})
    draft["/filter/error"] = _history(ensemble, "error")
    draft["/filter/sigma"] = _history(ensemble, "sigma")
    for name, degrees in _nees_degrees(case):
        draft.put(f"/filter/{name}", _history(ensemble, name), {"degrees_of_freedom": degrees})
    if shared.dispersion is not None:
        for i, axis in enumerate(RUNWAY_AXES):
            if keep == "all":
                draft[f"/filter/gust_{axis}"] = _history(ensemble, "gust", itemgetter((..., i)))
            draft[f"/filter/deviation_{axis}"] = _history(ensemble, "deviation", itemgetter((..., i)))
    draft["/filter/epoch"] = shared.signals.time
    most = int(ensemble.per_run("degrees").max())
    name = "innovation_squared"
    draft.put(f"/filter/{name}", _history(ensemble, name), {"degrees_of_freedom": most})
    draft["/filter/fix_status"] = _history(ensemble, "status", lambda block: block.astype(np.int8))
    if keep == "all":
        _filter_model(draft, case, ensemble)
    if keep == "all" and case.design.tight:
        draft["/filter/source"] = np.array(shared.signals.names, dtype=object)
        draft["/filter/range_status"] = _history(ensemble, "range_status", lambda block: block.astype(np.int8))


def _filter_model(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    """Write the filter model: initial state, sensors, and fixes."""
    sensors = case.design.sensors
    for name, history in (("position_llh", "llh"), ("velocity_ned", "velocity"), ("attitude_rpy", "rpy")):
        draft[f"/filter/start_{name}"] = _history(ensemble, f"start_{history}")
    draft["/filter/start_sigma"] = np.sqrt(np.diag(case.flight.covariance))
    others = len(case.states) - states.SENSORS - sum(block.size for block in sensors.blocks)
    for name, of_block in (("decay", lambda b: b.decay), ("drive", lambda b: b.drive**0.5)):
        each = np.repeat([of_block(b) for b in sensors.blocks], [b.size for b in sensors.blocks])
        draft[f"/filter/state_{name}"] = np.concatenate([np.zeros(states.SENSORS), each, np.zeros(others)])
    for k, name in enumerate(("gyro", "accelerometer")):
        draft[f"/filter/noise_{name}"] = float(np.sqrt(sensors.noise[k]))
    if not case.design.tight:
        draft["/filter/fix_position_llh"] = _history(ensemble, "filter_fix_llh")
        draft["/filter/fix_velocity_ned"] = _history(ensemble, "filter_fix_velocity")
        draft["/filter/fix_covariance"] = _history(ensemble, "filter_fix_covariance")
        if case.flight.correlated_roots.size:
            followed = [name for block in sensors.blocks if block.sensor == FIX for name in block.states]
            draft["/filter/fix_error"] = np.array(followed, dtype=object)
            draft["/filter/fix_effect"] = case.flight.correlated_roots


def _aiding(draft: ResultBuilder, case: Case, ensemble: Ensemble, measured: bool) -> None:
    """Write the measurements of each sensor beside the receiver, and their status."""
    first = 0
    for aid in case.shared.aids:
        branch, part = f"/aiding/{aid.sensor.name}", slice(first, first + aid.time.size)
        first, numbers = part.stop, aid.exact.shape[1]

        def of(name: str, part: slice = part, numbers: int = 0, kind: type | None = None) -> Stream:
            def one(block: np.ndarray) -> np.ndarray:
                out = block[:, part, :numbers] if numbers else block[:, part]
                return out if kind is None else out.astype(kind)

            return _history(ensemble, name, one)

        draft[f"{branch}/time"] = aid.time
        if measured:
            draft[f"{branch}/number"] = np.array(aid.sensor.numbers)
            draft.put(f"{branch}/measured", of("aided", numbers=numbers), unit=aid.sensor.unit)
            draft.put(f"{branch}/sigma", aid.sigma, unit=aid.sensor.unit)
        draft.put(f"{branch}/innovation_squared", of("aided_squared"), {"degrees_of_freedom": numbers})
        draft[f"{branch}/status"] = of("aided_status", kind=np.int8)


def _watched(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    """Write the status of the fix monitor, and the errors of the fixes."""
    if case.flight.monitor is None:
        return
    draft["/integrity/statistic"] = _history(ensemble, "monitor_statistic")
    draft["/integrity/status"] = _history(ensemble, "monitor_status", lambda block: block.astype(np.int8))
    for i, name in enumerate(("horizontal", "vertical")):
        draft[f"/integrity/error_{name}"] = _history(ensemble, "watched_error", itemgetter((..., i)))
    if integrity.watches_innovations(case):
        draft["/integrity/innovation_ratio"] = _history(ensemble, "innovation_ratio")
    if (station := case.flight.station) is not None:
        stored = len(HISTORY) if station.station.two_smoothings else DIFFERENCES.start
        for i, name in enumerate(HISTORY[:stored]):
            draft[f"/integrity/{name}"] = _history(ensemble, "station", itemgetter((..., i)))
    if not integrity.excludes(case):
        return
    draft["/integrity/excluded"] = _history(ensemble, "monitor_excluded", lambda block: block.astype(np.int16))
    for i, name in enumerate(("hpl", "vpl")):
        draft[f"/integrity/{name}_run"] = _history(ensemble, "monitor_level", itemgetter((..., i)))


def _summary(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    squares, gone = ensemble.per_run("position_square"), went_around_at_heights(case, ensemble)
    at = np.where(gone[..., None], np.nan, ensemble.per_run("at_height"))
    landing = [at[~gone[:, h], h] if not gone[:, h].all() else at[:, h] for h in range(at.shape[1])]  # nan if none is

    def each(mean_squares: np.ndarray) -> np.ndarray:
        return np.stack([rms_interval_of_means(square, ensemble.runs) for square in mean_squares[:, None]])

    write_accuracy(
        draft,
        case,
        each(ensemble.mean("mean_square")[: states.SENSORS]),
        each(ensemble.mean("rpy_square")),
        rms_interval(squares[:, :2]),
        rms_interval(squares[:, 2:3]),
        np.stack([[rms_interval(each[:, [i]] ** 2) for each in landing] for i in range(3)]),
    )
    write_filter_sigmas(draft, *(ensemble.mean(name) for name in ("variance", "rpy_variance", "at_variance")))
    draft["/summary/percentile"] = np.array(PERCENTILES)
    for i, name in enumerate(RUNWAY_AXES):
        draft[f"/summary/at/{name}_run"] = at[:, :, i]
        draft[f"/summary/at/{name}_percentile"] = np.stack(
            [np.percentile(np.abs(each[:, i]), PERCENTILES) for each in landing]
        )
    for name, first, last in (("horizontal", 0, 2), ("vertical", 2, 3)):
        size = np.sqrt(squares[:, first:last].sum(axis=1))
        draft[f"/summary/rms/{name}_percentile"] = np.percentile(size, PERCENTILES)

    put_total_errors(draft, case, ensemble)
    put_fix_states(draft, case, ensemble)
    if (box := box_of(case)) is not None:
        errors = ensemble.per_run("at_box")[:, 0]
        left = went_around(ensemble, box.time)
        write_box_counts(draft, box, np.where(left[:, None], np.nan, errors), left)
    inside = ensemble.per_run("inside")
    draft["/summary/coverage/level"] = LEVELS
    draft["/summary/coverage/position"] = np.clip([mean_interval(inside[:, k]) for k in range(LEVELS.size)], 0.0, 1.0)
    draft["/summary/coverage/expected"] = np.array([ellipsoid_probability(k, 3) for k in LEVELS])
    _consistency(draft, case, ensemble)

    for k, aid in enumerate(case.shared.aids):
        sums = [ensemble.per_run(f"aided_{name}")[:, k].sum() for name in ("innovations", "weighed", "rejected")]
        branch = f"/summary/aiding/{aid.sensor.name}"
        draft[f"{branch}/nis"] = float(sums[0] / sums[1]) if sums[1] else np.nan
        draft[f"{branch}/rejected"] = np.int64(sums[2])
        missing = ensemble.runs * aid.missing
        if aid.sensor.varies:
            missing = ensemble.runs * aid.time.size - int(sums[1])
        draft[f"{branch}/missing"] = np.int64(missing)
    if case.flight.limited:
        for name, total in zip(("gyro", "accelerometer"), ensemble.per_run("clipped").sum(axis=0), strict=True):
            draft[f"/summary/count/clipped_{name}"] = np.int64(total)
    if case.scenario.steered:
        draft["/summary/guidance/loop_gap"] = float(ensemble.per_run("loop_gap").max())
    for name, value in (
        ("runs", ensemble.runs),
        ("fixes", int(ensemble.per_run("fixes").sum())),
        ("epochs_without_fix", _flaws(ensemble, UNHEARD, PENALTY_UNSOLVED)),
        ("rejected", _flaws(ensemble, GATED)),
    ):
        draft[f"/summary/count/{name}"] = np.int64(value)


def _consistency(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    runs, branch = ensemble.runs, "/summary/consistency"
    draft[f"{branch}/time"] = case.shared.filter_time
    most = int(ensemble.per_run("degrees").max())
    for name, degrees in (*_nees_degrees(case), ("nis", most)):
        band = consistency_band(degrees, runs) if degrees else (np.nan, np.nan)
        draft.put(f"{branch}/{name}", ensemble.mean(name), _of_band(band, degrees))
    band = consistency_band(3, runs)
    groups = ensemble.mean("nees_group")
    draft[f"{branch}/group"] = np.array(case.groups, dtype=object)
    draft.put(f"{branch}/nees_group", groups, _of_band(band, 3))
    window = rms_window(case)
    draft[f"{branch}/mean_group"] = groups[window].mean(axis=0) if window.any() else np.full(len(case.groups), np.nan)
    put_consistency(draft, case, ratios_of_runs(case, ensemble), shares_beyond(ensemble))


def _nees_degrees(case: Case) -> tuple[tuple[str, int], ...]:
    """Degrees of freedom of the normalised estimation errors squared, by their names."""
    return ("nees", case.degrees()), ("nees_position_velocity", case.degrees(MOVING))


def _of_band(band: tuple[float, float], degrees: int) -> dict[str, float]:
    return {"band_low": band[0], "band_high": band[1], "degrees_of_freedom": degrees}


def _flaws(ensemble: Ensemble, *which: int) -> int:
    """Number of each flaw of fix epochs in all runs."""
    return int(ensemble.per_run("fix_flaws_count")[:, which].sum(dtype=np.int64))
