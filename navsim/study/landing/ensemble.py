"""Monte Carlo of a landing: what is kept and reduced of each run, when to stop, what is worth a warning."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.core import states
from navsim.core.arrays.attitude import rpy_error, rpy_jacobian
from navsim.core.dop import MAX_CLOCKS
from navsim.core.states import MOST
from navsim.estimation.records import NOT_USED, REJECTED
from navsim.io.findings import FIX, Finding
from navsim.scenario.base import DEG
from navsim.scenario.load import resolved_yaml
from navsim.simulation.landing import Run
from navsim.study import findings as judging
from navsim.study.ensemble import Ensemble
from navsim.study.ensemble import fly_all as fly_ensemble
from navsim.study.executor import Executor
from navsim.study.findings import Flaws
from navsim.study.landing.case import Case, crossing_times, rms_window
from navsim.study.partial import Arrays, Store, code_key
from navsim.study.statistics import rms_interval

LEVELS = np.array([1.0, 2.0, 3.0])
"""Sigma levels of the position ellipsoids whose coverage is counted."""
_NO_LEVEL = np.full(LEVELS.size, np.nan)


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
    ),
    "all": tuple(Run.__dataclass_fields__),
}
"""Histories of a run that are stored, by `--keep`."""

_SHAPES: dict[str, tuple[str | int, ...]] = {
    "pseudorange": ("epoch", "source"), "range_rate": ("epoch", "source"), "fix_llh": ("epoch", 3),
    "fix_velocity": ("epoch", 3), "fix_clock": ("epoch", MAX_CLOCKS), "error": ("output", "state"),
    "sigma": ("output", "state"), "cross": ("output", 6), "nees": ("output",), "nees_position_velocity": ("output",),
    "nees_group": ("output", "group"), "innovation_squared": ("epoch",), "degrees": ("epoch",),
    "status": ("epoch",), "aided": ("aided", MOST), "aided_squared": ("aided",), "aided_degrees": ("aided",),
    "aided_status": ("aided",),
}  # fmt: skip
"""Shapes of the histories of a run, all of eight bytes a number; output: time 0 and every epoch."""


def history_bytes(name: str, sizes: Mapping[str, int]) -> int:
    """Size of a history of one run, told before one is flown, bytes; sizes: of the dimensions of `_SHAPES`."""
    return 8 * math.prod(sizes[d] if isinstance(d, str) else d for d in _SHAPES[name])


@dataclass(frozen=True)
class LandingStudy:
    """An ensemble of a case as the engine flies it (`study.ensemble.Study`)."""

    case: Case
    seed: int
    keep: str

    @cached_property
    def window(self) -> np.ndarray:
        """Which filter outputs count for the RMS errors."""
        return rms_window(self.case)

    @cached_property
    def attitude(self) -> tuple[np.ndarray, np.ndarray]:
        """True roll, pitch, yaw (n, 3) of those outputs, rad, and what turns errors in NED into theirs (n, 3, 3)."""
        rpy = self.case.world.at_filter.rpy[self.window]
        return rpy, rpy_jacobian(rpy)

    @cached_property
    def solvable(self) -> np.ndarray:
        """At which fix epochs the geometry has a solution (e,)."""
        return np.isfinite(self.case.world.dop[:, 1])

    @cached_property
    def crossings(self) -> list[float]:
        """Times at the decision heights, s."""
        return crossing_times(self.case)

    def batch(self, first: int, count: int) -> tuple[Arrays, Arrays, Arrays]:
        """Fly runs first ... first + count - 1 and reduce them, in order."""
        window, crossings = self.window, self.crossings
        rpy, to_rpy = self.attitude
        rows: list[dict[str, np.ndarray | np.generic]] = []
        sums = {name: np.zeros(self.case.world.filter_time.size) for name in ("nees", "nees_position_velocity", "nis")}
        sums["nis"][0] = np.nan
        n = len(self.case.states)
        sums["nees_group"] = np.zeros((self.case.world.filter_time.size, n // 3))
        kept: Arrays = {}
        for i, run in enumerate(self.case.fly_runs(self.seed, first, count)):
            fixes, outputs = fix_flaws(run, self.solvable, self.case.beliefs.velocity), output_flaws(run)
            rows.append(
                {
                    "mean_square": _mean_square(run.error[window]),
                    "rpy_square": _mean_square(rpy_error(rpy, run.error[window, states.SLICES["attitude"]])),
                    "variance": _mean_square(run.sigma[window]),
                    "rpy_variance": _mean(turned_variances(to_rpy, covariances(run, "attitude")[window])),
                    "at_height": at_heights(self.case, crossings, run.error),
                    "at_variance": variances_at_heights(self.case, crossings, covariances(run, "position")),
                    "fixes": np.sum(~np.isnan(run.fix_llh[:, 0])),
                    **{f"fix_flaws_{part}": getattr(fixes, part) for part in _PARTS},
                    **{f"output_flaws_{part}": getattr(outputs, part) for part in _PARTS},
                    "nees_mean": np.float64(_finite_mean(run.nees[1:]) / n),
                    "nees_position_velocity_mean": np.float64(_finite_mean(run.nees_position_velocity[1:]) / 6),
                    "innovations": np.nansum(run.innovation_squared),
                    "weighed": run.degrees.sum(),
                    **of_aids(self.case, run),
                    "degrees": run.degrees.max(initial=0),
                    "inside": np.mean(run.nees_group[1:, :1] <= LEVELS**2, axis=0) if len(run.degrees) else _NO_LEVEL,
                }
            )
            sums["nees"] += run.nees / n
            sums["nees_position_velocity"] += run.nees_position_velocity / 6
            sums["nees_group"] += run.nees_group / 3
            sums["nis"][1:] += run.innovation_squared / np.maximum(run.degrees, 1)
            for name in HISTORIES[self.keep]:
                history = getattr(run, name)
                if name not in kept:
                    kept[name] = np.empty((count, *history.shape), history.dtype)
                kept[name][i] = history
        per_run = {name: np.stack([row[name] for row in rows]) for name in rows[0]}
        return per_run, sums, kept


def fly_all(
    case: Case,
    seed: int,
    first_run: int,
    runs: int,
    executor: Executor,
    *,
    keep: str = "all",
    store: Store | None = None,
    done: Callable[[int], None] = lambda _: None,
    enough: Callable[[Ensemble], bool] | None = None,
) -> Ensemble:
    """Fly runs of a case; see `study.ensemble.fly_all`."""
    return fly_ensemble(LandingStudy(case, seed, keep), first_run, runs, executor, store, done, enough)


_UNTIL = re.compile(r"\s*(rms_horizontal|rms_vertical)\s+within\s+([0-9.]+)\s*%\s*")


def stopping_rule(expression: str) -> Callable[[Ensemble], bool]:
    """`rms_horizontal within 2%`: true once the 95 % interval reaches no further than that from its value.

    Raises ValueError for anything else.
    """
    match = _UNTIL.fullmatch(expression)
    try:
        share = float(match.group(2)) / 100.0 if match else 0.0
    except ValueError:
        share = 0.0
    if match is None or not 1e-5 <= share <= 10.0:
        form = "`rms_horizontal within 2%` or `rms_vertical within 2%`"
        raise ValueError(f"{expression!r}: expected {form}, with 0.001 to 1000 percent")
    columns = [0, 1] if match.group(1) == "rms_horizontal" else [2]

    def enough(ensemble: Ensemble) -> bool:
        value, low, high = rms_interval(ensemble.per_run("mean_square")[:, columns])
        return bool(0.5 * (high - low) <= share * value)

    return enough


def partial_key(case: Case, seed: int, first_run: int, runs: int, keep: str) -> dict[str, object]:
    """What partial work must agree in to be resumed: scenario, random numbers, extent, code."""
    text = resolved_yaml(case.scenario)
    return {
        "scenario_sha256": hashlib.sha256(text.encode()).hexdigest(),
        "seed": seed,
        "first_run": first_run,
        "runs": runs,
        "keep": keep,
        **code_key(),
    }


_PARTS = tuple(Flaws.__dataclass_fields__)
UNHEARD, UNSOLVED, NO_VELOCITY, UNWEIGHED, GATED = range(5)
"""Flaws of a fix epoch: too few usable sources; sources enough but no solution of the least squares; a position without
the velocity the filter wants; a fix that could not be weighed; one that the gate rejected."""
NOT_FINITE, NOT_POSITIVE, FAR_OFF = range(3)
"""Flaws of an output: errors that are not finite; a covariance that is not positive definite; position or velocity
beyond `findings.BEYOND` sigmas. Attitude and biases are judged over ensembles alone: before the first turn of the nose
the filter knows them worse than it believes in some runs in a hundred (docs/filter.md)."""
FOLLOWED = slice(0, states.ATT)
"""States whose errors and sigmas follow the fixes: position and velocity."""


def of_aids(case: Case, run: Run) -> dict[str, np.ndarray]:
    """Of each sensor beside the receiver (aid,): sums of innovations squared and of their degrees, and how many the
    gate rejected."""
    parts = np.split(np.arange(run.aided_status.size), np.cumsum([aid.time.size for aid in case.world.aids])[:-1])
    parts = parts[: len(case.world.aids)]
    return {
        "aided_innovations": np.array([np.nansum(run.aided_squared[part]) for part in parts]),
        "aided_weighed": np.array([run.aided_degrees[part].sum() for part in parts], dtype=np.int64),
        "aided_rejected": np.array([np.sum(run.aided_status[part] == REJECTED) for part in parts], dtype=np.int64),
    }


def fix_flaws(run: Run, solvable: np.ndarray, with_velocity: bool) -> Flaws:
    """Flaws of the fix epochs of a run. solvable: (e,) where the geometry has a solution."""
    none = np.isnan(run.fix_llh[:, 0])
    masks = np.empty((5, none.size), bool)
    masks[UNHEARD], masks[UNSOLVED] = none & ~solvable, none & solvable
    masks[NO_VELOCITY] = with_velocity & ~none & np.isnan(run.fix_velocity[:, 0])
    masks[UNWEIGHED] = ~none & (run.status == NOT_USED)
    masks[GATED] = run.status == REJECTED
    return judging.tally(masks)


def output_flaws(run: Run) -> Flaws:
    """Flaws of the filter's outputs of a run."""
    masks = np.zeros((3, run.nees.size), bool)
    # no error is more sigmas off than the root of a normalised square it is in, and one is finite only with the rest
    if np.isfinite(run.nees).all() and run.nees_position_velocity.max() <= judging.BEYOND**2:
        return judging.tally(masks)
    finite = np.isfinite(run.error).all(axis=1)
    masks[NOT_FINITE] = ~finite
    masks[NOT_POSITIVE] = finite & ~np.isfinite(run.nees)
    masks[FAR_OFF] = (np.abs(run.error[:, FOLLOWED]) > judging.BEYOND * run.sigma[:, FOLLOWED]).any(axis=1)
    return judging.tally(masks)


def findings(case: Case, ensemble: Ensemble) -> list[Finding]:
    """What was wrong with the input and with what was flown."""
    fixes, outputs = (
        Flaws(*(ensemble.per_run(f"{which}_flaws_{part}") for part in _PARTS)) for which in ("fix", "output")
    )
    runs = ensemble.runs
    out = judging.notes(case.warnings)
    out += of_fixes(case, fixes)
    epochs = case.world.signals.time
    fixed, probability = int(ensemble.per_run("fixes").sum()), case.scenario.filter.gate.probability
    out += judging.rejections(judging.spread(fixes, GATED, epochs), fixed, probability, runs)
    out += of_outputs(case, outputs)
    mean = _finite_mean(ensemble.per_run("nees_position_velocity_mean"))
    out += judging.doubted("sigma_position_velocity", "errors of position and velocity", mean, 6 * runs, runs)
    if runs > 1:  # of the lower half of runs: the few with a wrong heading are known, see `FAR_OFF`
        n = len(case.states)
        half = float(np.sort(ensemble.per_run("nees_mean"))[(runs - 1) // 2])
        out += judging.doubted("sigma_all_states", f"errors of {n} states in half of the runs", half, n * runs, runs)
    for k, aid in enumerate(case.world.aids):
        rejected, weighed = (int(ensemble.per_run(f"aided_{name}")[:, k].sum()) for name in ("rejected", "weighed"))
        name = aid.sensor.name
        out += judging.rejected_of(name, rejected, runs * aid.time.size, probability)
        if weighed:
            mean = float(ensemble.per_run("aided_innovations")[:, k].sum()) / weighed
            out += judging.doubted(f"{name}_innovations", f"innovations of the {name}", mean, weighed, runs)
    weighed = int(ensemble.per_run("weighed").sum())
    if weighed:
        mean = float(ensemble.per_run("innovations").sum()) / weighed
        out += judging.doubted("innovations", "innovations", mean, weighed, runs)
    return out


def of_fixes(case: Case, flaws: Flaws) -> list[Finding]:
    """Findings about fixes that are not there; flaws (run, flaw), see `UNHEARD`."""
    epochs = case.world.signals.time
    if not epochs.size:
        text = "the simulation is shorter than one fix interval: the filter never gets a fix"
        return [Finding("no_fix", text, (FIX,))]
    names = {UNHEARD: "epochs_without_fix", UNSOLVED: "lost_fixes", NO_VELOCITY: "fixes_without_velocity",
             UNWEIGHED: "unweighed_fixes"}  # fmt: skip
    return _spreads(flaws, names, epochs)


def of_outputs(case: Case, flaws: Flaws) -> list[Finding]:
    """Findings about the filter's outputs; flaws (run, flaw), see `NOT_FINITE`."""
    names = {NOT_FINITE: "not_finite", NOT_POSITIVE: "covariance_not_positive", FAR_OFF: "errors_beyond_sigma"}
    return _spreads(flaws, names, case.world.filter_time)


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
    """Mean of what is finite; nan where nothing is."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else math.nan


def _mean(values: np.ndarray) -> np.ndarray:
    """Mean over time (t, m) -> (m,); nan for no time at all."""
    return np.mean(values, axis=0) if values.shape[0] else np.full(values.shape[1], np.nan)


def _mean_square(error: np.ndarray) -> np.ndarray:
    """Mean square over time (t, m) -> (m,); nan for no time at all."""
    return _mean(error**2)


def covariances(run: Run, group: str) -> np.ndarray:
    """The filter's covariance (t, 3, 3) of the position or attitude errors of a run."""
    out = np.zeros((run.sigma.shape[0], 3, 3))
    out[:, [0, 0, 1], [1, 2, 2]] = run.cross[:, :3] if group == "position" else run.cross[:, 3:]
    out += out.swapaxes(1, 2)
    out[:, range(3), range(3)] = run.sigma[:, states.SLICES[group]] ** 2
    return out


def turned_variances(turn: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Variances (..., 3) along turned axes: the diagonal of turn (..., 3, 3) covariance (..., 3, 3) turn'."""
    return np.einsum("...ij,...jk,...ik->...i", turn, covariance, turn)


def to_runway(case: Case) -> np.ndarray:
    """The matrix that turns NED into lateral (right), along-track and vertical (up)."""
    c, s = np.cos(case.scenario.runway.heading_deg * DEG), np.sin(case.scenario.runway.heading_deg * DEG)
    return np.array([[-s, c, 0.0], [c, s, 0.0], [0.0, 0.0, -1.0]])


def at_times(case: Case, times: list[float], history: np.ndarray) -> np.ndarray:
    """A history of the filter's outputs (t, ...) at some times, between outputs in a straight line; nan for nan."""
    t, flat = case.world.filter_time, history.reshape(history.shape[0], -1)
    out = np.stack([np.interp(times, t, column) for column in flat.T], axis=1)
    out[~np.isfinite(times)] = np.nan
    return out.reshape(len(times), *history.shape[1:])


def variances_at_heights(case: Case, crossings: list[float], covariance: np.ndarray) -> np.ndarray:
    """Variances (h, 3) of lateral, along-track and vertical errors at the crossings, of covariances (t, 3, 3), m2."""
    return turned_variances(to_runway(case), at_times(case, crossings, covariance))


def at_heights(case: Case, crossings: list[float], error: np.ndarray) -> np.ndarray:
    """Lateral, along-track and vertical position error (h, 3) of one run at the crossings, m."""
    return at_times(case, crossings, error[:, states.SLICES["position"]]) @ to_runway(case).T
