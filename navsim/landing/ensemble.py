"""Monte Carlo of a landing: data kept and reduced of each run, stopping rule, findings."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from navsim.filter import states
from navsim.filter.design import FilterDesign
from navsim.filter.records import NOT_USED, REJECTED
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.geodesy.attitude import rpy_error, rpy_jacobian
from navsim.geodesy.indicator import aircraft_and_estimate
from navsim.gnss.dop import MAX_CLOCKS
from navsim.integrity.gbas_station import HISTORY
from navsim.integrity.monitoring import ALARM
from navsim.landing import fix_states, integrity, total_errors
from navsim.landing.case import MOVING, Case, crossing_times, rms_window
from navsim.landing.consistency import evaluate_states, ratios_of_runs
from navsim.results.findings import Finding
from navsim.results.notes import FIX
from navsim.runner import findings as judging
from navsim.runner.batches import Ensemble
from navsim.runner.batches import fly_all as fly_ensemble
from navsim.runner.checkpoint import Arrays, CheckpointStore, code_key
from navsim.runner.consistency import LIMITS
from navsim.runner.control_variates import LEAST_RUNS
from navsim.runner.exact_sums import Sums, blocks
from navsim.runner.executor import Executor
from navsim.runner.findings import Flaws
from navsim.scenario.load import resolved_yaml
from navsim.scenario_files.base import DEG
from navsim.simulation.first_order import FirstOrder
from navsim.simulation.landing import LOOP_TOLERANCE
from navsim.simulation.run import Run
from navsim.statistics.consistency import sum_ratios

LEVELS = np.array([1.0, 2.0, 3.0])
"""Sigma levels of the position ellipsoids whose coverage is counted."""


FIRST_ORDER = "first_order_square"
"""Statistic of runs that have first-order errors."""
_NO_HISTORY = ("clipped", "first_order", "touchdown", "go_around", "loop_gap")
"""Numbers of a run that are stored as statistics."""
HISTORIES = {
    "none": (),
    "errors": (
        "error",
        "sigma",
        "nees",
        "nees_position_velocity",
        "innovation_squared",
        "status",
        "aided_squared",
        "aided_status",
        "monitor_statistic",
        "monitor_status",
        "watched_error",
        "innovation_ratio",
        "monitor_excluded",
        "monitor_level",
        "station",
        "deviation",
    ),
    "all": tuple(name for name in Run.__dataclass_fields__ if name not in _NO_HISTORY),
}
"""Histories of a run that are stored, by `--keep`."""

_SHAPES: dict[str, tuple[str | int, ...]] = {
    "pseudorange": ("epoch", "source"), "range_rate": ("epoch", "source"), "fix_llh": ("epoch", 3),
    "fix_velocity": ("epoch", 3), "fix_clock": ("epoch", MAX_CLOCKS), "error": ("output", "state"),
    "sigma": ("output", "state"), "cross": ("output", 6), "nees": ("output",), "nees_position_velocity": ("output",),
    "nees_group": ("output", "group"), "innovation_squared": ("epoch",), "degrees": ("epoch",),
    "status": ("epoch",), "range_status": ("epoch", "ranged"), "aided": ("aided", MAX_MEASUREMENT_SIZE),
    "aided_squared": ("aided",), "aided_degrees": ("aided",),
    "aided_status": ("aided",), "monitor_statistic": ("watched",), "monitor_status": ("watched",),
    "watched_error": ("watched", 2), "monitor_excluded": ("settled",), "monitor_level": ("settled", 2),
    "station": ("served", len(HISTORY)),
    "innovation_ratio": ("tried",), "deviation": ("deviating", 3), "attitude": ("deviating", 3),
    "antenna": ("met", 3), "gust": ("deviating", 3), "delta_angle": ("sample", 3), "delta_velocity": ("sample", 3),
    "start_llh": (3,), "start_velocity": (3,), "start_rpy": (3,),
    "filter_fix_llh": ("loose", 3), "filter_fix_velocity": ("loose", 3),
    "filter_fix_covariance": ("loose", MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE),
    "clipped": ("limited",), "first_order": ("linear", 3), "fix_state": ("stated",), "fix_flag": ("stated",),
    "touchdown": ("ended", 4), "go_around": ("broken_off", 3),
    "loop_gap": ("steered",),
}  # fmt: skip
"""Shapes of the histories of a run, all of eight bytes a number; output: time 0 and every epoch."""


def history_bytes(name: str, sizes: Mapping[str, int]) -> int:
    """Size of a history of one run before any run, bytes; sizes: of the dimensions of `_SHAPES`."""
    return 8 * math.prod(sizes[d] if isinstance(d, str) else d for d in _SHAPES[name])


@dataclass(frozen=True)
class LandingStudy:
    """An ensemble of a case as the engine flies it (`runner.batches.Study`)."""

    case: Case
    seed: int
    keep: str
    first_order: FirstOrder | None = None
    """Computes first-order errors of the runs; None: there are none."""

    @cached_property
    def window(self) -> np.ndarray:
        """Which filter outputs count for the RMS errors."""
        return rms_window(self.case)

    @cached_property
    def attitude(self) -> tuple[np.ndarray, np.ndarray]:
        """True roll, pitch, yaw (n, 3) of those outputs, rad, and the matrix from errors in NED to theirs (n, 3, 3)."""
        rpy = self.case.shared.at_filter.rpy[self.window]
        return rpy, rpy_jacobian(rpy)

    @cached_property
    def box_time(self) -> list[float]:
        """When the height of the box is passed, s; of no box nothing."""
        return [] if self.case.scenario.box is None else [self.case.preflight.box_time]

    @cached_property
    def crossings(self) -> list[float]:
        """Times at the decision heights, s."""
        return crossing_times(self.case)

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Fly runs first ... first + count - 1 and reduce them, in order."""
        window, crossings = self.window, self.crossings
        route_rpy, to_rpy = self.attitude
        rows: list[Arrays] = []
        sums, ratios = Sums(), Sums()
        every, moving, *of_groups = (
            self.case.degrees(part) or math.nan
            for part in (slice(None), MOVING, *(slice(3 * i, 3 * i + 3) for i in range(len(self.case.groups))))
        )
        groups = np.array(of_groups)
        kept: Arrays = {}
        flown = 0
        measured = "pseudorange" in HISTORIES[self.keep]
        linear = () if self.first_order is None else (self.first_order,)
        for runs in self.case.fly_runs(self.seed, first, count, measured, *linear):
            fixes = fix_flaws(runs, self.case.solvable, self.case.design, self.case.flight.drops)
            outputs = output_flaws(runs)
            error = runs.error[:, window]
            squares, rpy, turn = mean_square(error), route_rpy, to_rpy
            if self.case.shared.dispersion is not None:
                rpy = runs.attitude[:, window]
                turn = rpy_jacobian(rpy)
            rows.append(
                {
                    "position_square": squares[:, states.SLICES["position"]],
                    "at_height": at_heights(self.case, crossings, runs.error),
                    "at_box": box_errors(self.case, self.box_time, runs),
                    "fixes": np.sum(~np.isnan(runs.fix_llh[..., 0]), axis=1),
                    **{f"fix_flaws_{part}": getattr(fixes, part) for part in FLAW_PARTS},
                    **{f"output_flaws_{part}": getattr(outputs, part) for part in FLAW_PARTS},
                    "nees_mean": finite_means(runs.nees[:, 1:]) / every,
                    "nees_position_velocity_mean": finite_means(runs.nees_position_velocity[:, 1:]) / moving,
                    "innovations": np.nansum(runs.innovation_squared, axis=1),
                    "weighed": runs.degrees.sum(axis=1),
                    "weighed_ranges": np.sum(runs.range_status != NOT_USED, axis=(1, 2)),
                    **of_aids(self.case, runs),
                    **integrity.count_epochs(self.case, runs),
                    "degrees": runs.degrees.max(axis=1, initial=0),
                    "inside": _inside(runs),
                    **fix_states.of_runs(runs),
                    **flight_technical_errors(self.case, crossings, runs),
                    **({"clipped": runs.clipped} if self.case.flight.limited else {}),
                    **({"loop_gap": runs.loop_gap[:, 0]} if self.case.scenario.steered else {}),
                    **(self._linear(runs.first_order) if linear else {}),
                }
            )
            added = {
                "mean_square": squares,
                "rpy_square": mean_square(rpy_error(rpy, error[..., states.SLICES["attitude"]])),
                "variance": mean_square(runs.sigma[:, window]),
                "rpy_variance": _mean(turned_variances(turn, covariances(runs, "attitude", window))),
                "at_variance": variances_at_heights(self.case, crossings, covariances(runs, "position")),
            }
            add_ratios(ratios, first + flown, runs.error, runs.sigma)
            for i in range(runs.nees.shape[0]):
                nis = runs.innovation_squared[i] / np.maximum(runs.degrees[i], 1)
                sums.add(
                    first + flown + i,
                    1,
                    {
                        **{name: values[i] for name, values in added.items()},
                        "nees": runs.nees[i] / every,
                        "nees_position_velocity": runs.nees_position_velocity[i] / moving,
                        "nees_group": runs.nees_group[i] / groups,
                        "nis": np.concatenate([[np.nan], nis]),
                    },
                )
            for name in HISTORIES[self.keep]:
                history = getattr(runs, name)
                if name not in kept:
                    kept[name] = np.empty((count, *history.shape[1:]), history.dtype)
                kept[name][flown : flown + history.shape[0]] = history
            flown += runs.nees.shape[0]
        per_run = {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}
        return per_run, sums.arrays() | ratios.arrays(), kept

    def _linear(self, error: np.ndarray) -> Arrays:
        """Statistics of first-order errors (run, o, 3)."""
        return {
            FIRST_ORDER: mean_square(error[:, self.window]),
            "first_order_mean": _mean(error[:, self.window]),
            "first_order_at_height": outputs_around(self.case, self.crossings, error @ to_runway(self.case).T),
            "first_order_at_box": outputs_around(self.case, self.box_time, error @ to_runway(self.case).T),
        }


def add_ratios(sums: Sums, first: int, errors: np.ndarray, sigmas: np.ndarray) -> None:
    """Add the ratios of errors to sigmas (run, o, n) of runs from `first` on (`statistics.consistency`) to sums."""
    limits = np.array(LIMITS)
    for start, length in blocks(first, errors.shape[0]):
        part = slice(start - first, start - first + length)
        error, sigma = errors[part], sigmas[part]
        shape = error.shape[1:]
        squares, known = np.empty(shape), np.empty(shape, np.int32)
        beyond, steps = np.empty((limits.size, *shape), np.int32), np.empty(shape[1])
        sum_ratios(error, sigma, limits, squares, known, beyond, steps)
        added: Arrays = {"ratio_square": squares, "ratio_known": known, "ratio_beyond": beyond, "ratio_step": steps}
        sums.add(start, length, added)


def fly_all(
    case: Case,
    seed: int,
    first_run: int,
    runs: int,
    executor: Executor,
    *,
    keep: str = "all",
    store: CheckpointStore | None = None,
    done: Callable[[int], None] = lambda _: None,
    enough: Callable[[Ensemble], bool] | None = None,
) -> Ensemble:
    """Fly runs of a case, with first-order errors if they are enough for a controlled estimate; see
    `runner.batches.fly_all`."""
    first_order = case.first_order if runs >= LEAST_RUNS else None
    return fly_ensemble(LandingStudy(case, seed, keep, first_order), first_run, runs, executor, store, done, enough)


def percent(text: str, expression: str, least: float, most: float) -> float:
    """Fraction from a text in percent.

    Raises ValueError for anything but a number from least to most, percent; expression: that contains it.
    """
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{expression!r}: {text!r} is not a number") from None
    if not least <= value <= most:
        raise ValueError(f"{expression!r}: {text} % is not within {least:g} to {most:g} percent")
    return value / 100.0


def partial_key(case: Case, seed: int, first_run: int, runs: int, keep: str) -> dict[str, object]:
    """Data that partial work must match to be resumed: scenario, random numbers, extent, code."""
    text = resolved_yaml(case.scenario)
    return {
        "scenario_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "seed": seed,
        "first_run": first_run,
        "runs": runs,
        "keep": keep,
        **code_key(),
    }


FLAW_PARTS = tuple(Flaws.__dataclass_fields__)
"""Members of `Flaws`."""
UNHEARD, PENALTY_UNSOLVED, NO_VELOCITY, UNWEIGHED, GATED, UNRANGED = range(6)
"""Flaws of a fix epoch, in order. Too few usable sources, or no solution in their geometry. Enough sources, but no
least-squares solution. A position without the velocity that the filter needs. A fix that the filter could not use. A
fix, or a range of its epoch, that the gate rejected. No range that a tightly coupled filter could use."""
NOT_FINITE, NOT_POSITIVE, FAR_OFF = range(3)
"""Flaws of an output: errors that are not finite; a covariance that is not positive definite; position or velocity
beyond `findings.BEYOND` sigmas. Attitude and biases are tested only over ensembles: before the first turn of the nose,
their errors exceed the sigmas in some runs in a hundred (docs/filter.md)."""
FOLLOWED = slice(0, states.ATT)
"""States whose errors and sigmas follow the fixes: position and velocity."""


def of_aids(case: Case, runs: Run) -> dict[str, np.ndarray]:
    """Sums over each sensor beside the receiver (run, aid): squared innovations, degrees of freedom, rejections by the
    gate."""
    ends = np.cumsum([0, *(aid.time.size for aid in case.shared.aids)])
    parts = [slice(first, last) for first, last in itertools.pairwise(ends)]

    def each(values: np.ndarray) -> np.ndarray:
        """Sums (run, aid) of the numbers (run, a) of each sensor."""
        total = [np.nansum(values[:, part], axis=1) for part in parts]
        return np.stack(total, axis=1) if total else np.zeros((values.shape[0], 0), values.dtype)

    return {
        "aided_innovations": each(runs.aided_squared),
        "aided_weighed": each(runs.aided_degrees),
        "aided_rejected": each((runs.aided_status == REJECTED).astype(np.int64)),
    }


def fix_flaws(runs: Run, solvable: np.ndarray, design: FilterDesign, drops: bool = False) -> Flaws:
    """Flaws (run, flaw) of the fix epochs of several runs. solvable: (e,) where the geometry has a solution. drops:
    whether the filter does without fixes with an alarm."""
    none = np.isnan(runs.fix_llh[..., 0])
    masks = np.zeros((none.shape[0], UNRANGED + 1, none.shape[1]), bool)
    masks[:, UNHEARD], masks[:, PENALTY_UNSOLVED] = none & ~solvable, none & solvable
    unweighed = runs.status == NOT_USED
    if design.flag_sigma is not None:
        unweighed &= ~np.isnan(design.flag_sigma[runs.fix_flag.astype(int), 0])
    if drops:
        unweighed &= runs.monitor_status != ALARM
    if design.tight:
        masks[:, UNRANGED] = unweighed
        masks[:, GATED] = (runs.range_status == REJECTED).any(axis=2)
        return judging.tally(masks)
    masks[:, NO_VELOCITY] = design.velocity & ~none & np.isnan(runs.fix_velocity[..., 0])
    masks[:, UNWEIGHED] = ~none & unweighed
    masks[:, GATED] = runs.status == REJECTED
    return judging.tally(masks)


def output_flaws(runs: Run) -> Flaws:
    """Flaws (run, flaw) of the filter's outputs of several runs."""
    masks = np.zeros((runs.nees.shape[0], 3, runs.nees.shape[1]), bool)
    # no error is more sigmas off than the root of a normalised square it is in, and one is finite only with the rest
    squares = runs.nees_position_velocity
    clean = np.isfinite(runs.nees).all(axis=1) & (squares <= judging.BEYOND**2).all(axis=1)
    if clean.all():
        return judging.tally(masks)
    finite = np.isfinite(runs.error).all(axis=2)
    masks[:, NOT_FINITE] = ~finite
    masks[:, NOT_POSITIVE] = finite & ~np.isfinite(runs.nees)
    masks[:, FAR_OFF] = (np.abs(runs.error[..., FOLLOWED]) > judging.BEYOND * runs.sigma[..., FOLLOWED]).any(axis=2)
    masks[clean] = False
    return judging.tally(masks)


def findings(case: Case, ensemble: Ensemble) -> list[Finding]:
    """Findings about the input and the runs."""
    fixes, outputs = (
        Flaws(*(ensemble.per_run(f"{which}_flaws_{part}") for part in FLAW_PARTS)) for which in ("fix", "output")
    )
    runs = ensemble.runs
    out = judging.notes([*case.warnings, *integrity.level_warnings(case)])
    out += of_fixes(case, fixes)
    epochs = case.shared.signals.time
    fixed, probability = int(ensemble.per_run("fixes").sum()), case.scenario.filter.gate.probability
    gated, tight = judging.spread(fixes, GATED, epochs), case.design.tight
    each = int(ensemble.per_run("weighed_ranges").sum()) if tight else None
    out += judging.rejections(gated, runs * epochs.size if tight else fixed, probability, runs, each)
    out += of_outputs(case, outputs)
    mean = _finite_mean(ensemble.per_run("nees_position_velocity_mean"))
    moving = case.degrees(MOVING)
    out += judging.doubted("sigma_position_velocity", "errors of position and velocity", mean, moving * runs, runs)
    if runs > 1:  # of the lower half of runs: the few with a wrong heading are known, see `FAR_OFF`
        n = case.degrees()
        half = float(np.sort(ensemble.per_run("nees_mean"))[(runs - 1) // 2])
        out += judging.doubted("sigma_all_states", f"errors of {n} states in half of the runs", half, n * runs, runs)
        out += judging.of_states(evaluate_states(case, ratios_of_runs(case, ensemble))[1], runs)
    for k, aid in enumerate(case.shared.aids):
        rejected, weighed = (int(ensemble.per_run(f"aided_{name}")[:, k].sum()) for name in ("rejected", "weighed"))
        name = aid.sensor.name
        out += judging.rejected_of(name, rejected, runs * (aid.time.size - aid.missing), probability)
        silent = np.flatnonzero(ensemble.per_run("aided_weighed")[:, k] == 0)
        if aid.sensor.varies and silent.size and aid.missing < aid.time.size:
            out.append(judging.unheard(name, silent, runs))
        if weighed and not aid.sensor.has_outliers:
            mean = float(ensemble.per_run("aided_innovations")[:, k].sum()) / weighed
            out += judging.doubted("aided_innovations", f"innovations of the {name}", mean, weighed, runs)
    if case.flight.limited:
        samples = runs * (case.shared.imu_time.size - 1)
        out += judging.clipped(ensemble.per_run("clipped"), samples)
    if case.scenario.steered:
        out += judging.open_loops(ensemble.per_run("loop_gap"), LOOP_TOLERANCE)
    out += integrity.levels_without_alarm(case, ensemble)
    weighed = int(ensemble.per_run("weighed").sum())
    if weighed:
        mean = float(ensemble.per_run("innovations").sum()) / weighed
        out += judging.doubted("innovations", "innovations", mean, weighed, runs)
    return out


def of_fixes(case: Case, flaws: Flaws) -> list[Finding]:
    """Findings about fixes that are not there; flaws (run, flaw), see `UNHEARD`."""
    epochs = case.shared.signals.time
    if not epochs.size:
        return [Finding("no_fix", case.scenario.why_no_fix(), (FIX,))]
    names = {UNHEARD: "epochs_without_fix", PENALTY_UNSOLVED: "lost_fixes", NO_VELOCITY: "fixes_without_velocity",
             UNWEIGHED: "unweighed_fixes"}  # fmt: skip
    return _spreads(flaws, {UNRANGED: "epochs_without_range"} if case.design.tight else names, epochs)


def of_outputs(case: Case, flaws: Flaws) -> list[Finding]:
    """Findings about the filter's outputs; flaws (run, flaw), see `NOT_FINITE`."""
    names = {NOT_FINITE: "not_finite", NOT_POSITIVE: "covariance_not_positive", FAR_OFF: "errors_beyond_sigma"}
    return _spreads(flaws, names, case.shared.filter_time)


def _spreads(flaws: Flaws, names: dict[int, str], time: np.ndarray) -> list[Finding]:
    """Findings of flaws (run, flaw) by their names, at times (index,), s."""
    runs = flaws.count.shape[0]
    spreads = ((name, judging.spread(flaws, which, time)) for which, name in names.items())
    return [
        judging.counted(name, found.count, runs * time.size, found.first, found.last, found.runs, runs)
        for name, found in spreads
        if found
    ]


def _finite_mean(values: np.ndarray) -> float:
    """Mean of the finite values; nan without any."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else math.nan


def finite_means(values: np.ndarray) -> np.ndarray:
    """`_finite_mean` of each row (run, t)."""
    if np.isfinite(values).all() and values.shape[1]:
        return np.asarray(values.mean(axis=1))
    return np.array([_finite_mean(row) for row in values])


def _inside(runs: Run) -> np.ndarray:
    """The share (run, level) of the outputs whose position is within each of `LEVELS`; nan without fixes."""
    if not runs.degrees.shape[1]:
        return np.full((runs.nees.shape[0], LEVELS.size), np.nan)
    return np.mean(runs.nees_group[:, 1:, :1] <= LEVELS**2, axis=1)


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean over time (run, t, m) -> (run, m); nan for no time at all."""
    if not values.shape[1]:
        return np.full((values.shape[0], values.shape[2]), np.nan)
    return np.mean(values, axis=1)


def mean_square(error: np.ndarray) -> np.ndarray:
    """Mean square over time (run, t, m) -> (run, m); nan for no time at all."""
    return _mean(error**2)


def covariances(runs: Run, group: str, window: Any = slice(None)) -> np.ndarray:
    """The filter's covariance (run, t, 3, 3) of the position or attitude errors of several runs, at the outputs of a
    window, or all."""
    cross = (runs.cross[..., :3] if group == "position" else runs.cross[..., 3:])[:, window]
    out = np.zeros((*cross.shape[:2], 3, 3))
    out[..., [0, 0, 1], [1, 2, 2]] = cross
    out += out.swapaxes(2, 3)
    out[..., range(3), range(3)] = runs.sigma[:, window, states.SLICES[group]] ** 2
    return out


def turned_variances(turn: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Variances (..., 3) along turned axes: the diagonal of turn (..., 3, 3) covariance (..., 3, 3) turn'."""
    return np.einsum("...ij,...jk,...ik->...i", turn, covariance, turn)


def to_runway(case: Case) -> np.ndarray:
    """The matrix that turns NED into lateral (right), along-track and vertical (up)."""
    c, s = np.cos(case.scenario.runway.heading_deg * DEG), np.sin(case.scenario.runway.heading_deg * DEG)
    return np.array([[-s, c, 0.0], [c, s, 0.0], [0.0, 0.0, -1.0]])


def interpolate_outputs(case: Case, times: list[float], history: np.ndarray) -> np.ndarray:
    """Histories of the filter's outputs (..., t, m) at some times (..., h, m), between outputs in a straight line; nan
    for nan."""
    unknown = ~np.isfinite(times)
    before, after, share = between_outputs(case, np.where(unknown, case.shared.filter_time[0], times))
    share = share[:, None]
    first, second = history[..., before, :], history[..., after, :]
    out = np.where(share > 0.0, first + share * (second - first), first)
    out[..., unknown, :] = np.nan
    return np.asarray(out)


def outputs_around(case: Case, times: list[float], history: np.ndarray) -> np.ndarray:
    """Histories of the filter's outputs (..., t, m) at the outputs before and after some times (..., h, 2, m); nan for
    nan."""
    unknown = ~np.isfinite(times)
    before, after, _ = between_outputs(case, np.where(unknown, case.shared.filter_time[0], times))
    out = np.stack([history[..., before, :], history[..., after, :]], axis=-2)
    out[..., unknown, :, :] = np.nan
    return out


def between_outputs(case: Case, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outputs before and after times (h,), and the fraction of the interval up to them."""
    t = case.shared.filter_time
    before = np.clip(np.searchsorted(t, times, side="right") - 1, 0, t.size - 1)
    after = np.minimum(before + 1, t.size - 1)
    length = t[after] - t[before]
    return before, after, np.clip((times - t[before]) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)


def variances_at_heights(case: Case, crossings: list[float], covariance: np.ndarray) -> np.ndarray:
    """Variances (..., h, 3) of lateral, along-track and vertical errors at the crossings, of covariances (..., t, 3,
    3), m2."""
    flat = interpolate_outputs(case, crossings, covariance.reshape(*covariance.shape[:-2], 9))
    return turned_variances(to_runway(case), flat.reshape(*flat.shape[:-1], 3, 3))


def flight_technical_errors(case: Case, crossings: list[float], runs: Run) -> dict[str, np.ndarray]:
    """Flight-technical errors (run, h, 3) at the crossings of the route, where runs deviate from it, and their ends."""
    ways = case.shared.dispersion
    if ways is None:
        return {}
    error = runs.error[..., states.SLICES["position"]] @ to_runway(case).T
    both = aircraft_and_estimate(runs.deviation, error, ways.steered)
    return {"at_deviation": _technical(case, crossings, runs), **total_errors.of_runs(case, runs, *both)}


def _technical(case: Case, when: list[float], runs: Run) -> np.ndarray:
    """Deviation of each run from the route (run, h, 3); with guidance by estimates, the deviation of the estimate."""
    off = interpolate_outputs(case, when, runs.deviation)
    ways = case.shared.dispersion
    return off if ways is None or not ways.steered else off - at_heights(case, when, runs.error)


def box_errors(case: Case, when: list[float], runs: Run) -> np.ndarray:
    """The errors (run, h, 3) that the scenario's box limits, at times (h,), s: of navigation, the total ones, or those
    of touchdown."""
    error, box = at_heights(case, when, runs.error), case.scenario.box
    if box is None or box.error == "navigation":
        return error
    if box.error == "touchdown":
        place = np.zeros((runs.touchdown.shape[0], 1, 3))
        place[:, 0, :2] = runs.touchdown[:, [2, 1]]
        return place
    return error + _technical(case, when, runs)


def at_heights(case: Case, crossings: list[float], error: np.ndarray) -> np.ndarray:
    """Lateral, along-track and vertical position errors (..., h, 3) at the crossings, m, of errors (..., t, n)."""
    return interpolate_outputs(case, crossings, error[..., states.SLICES["position"]]) @ to_runway(case).T
