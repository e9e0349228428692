"""Verdicts on the scenario's `requirements`, as `/summary/requirements`.

A verdict uses the value in the summary with its 95 % interval. The requirement is met if the whole interval is on the
right side of the limit, not met if all of it is on the wrong side, undecided otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from navsim.integrity.monitoring import LandingMonitor, Monitoring, tested_levels, threshold_by_faults, vertical_sigma
from navsim.landing.case import Case, crossing_times, evaluated_heights, touches_down
from navsim.landing.integrity import (
    approach_limits,
    excludes,
    glide_of,
    is_kept_from_faults,
    relative_levels,
    share_of_alike,
)
from navsim.landing.total_errors import runs_beyond
from navsim.results.builder import ResultBuilder
from navsim.results.heights import spoken_height
from navsim.results.schema import COVARIANCE, MET, NOT_MET, RARE, UNDECIDED
from navsim.runner.statistics import rms_interval_of_means, share_interval
from navsim.scenario.landing import Landing
from navsim.scenario.requirements import (
    AccuracyRequirement,
    AlertRequirement,
    AnySingle,
    AvailabilityRequirement,
    BoxRequirement,
    ErrorRequirement,
    GoAroundRequirement,
    IndicatorRequirement,
    LevelRequirement,
    PresetRequirement,
    RiskRequirement,
    RmsRequirement,
    ThresholdRequirement,
    singles,
)
from navsim.simulation.landing_covariance import folded_quantile
from navsim.statistics import normal
from navsim.statistics.importance_sampling import FEW

if TYPE_CHECKING:
    from navsim.landing.controlled import Controls

MOST_RUNS = 10**12
"""Largest number of runs that is proposed."""
_AXES = ("lateral", "along", "vertical")


@dataclass(frozen=True)
class RequirementValue:
    """Value of a required quantity."""

    text: str
    value: np.ndarray
    """(3,) with its interval, nan if unknown."""
    limit: float
    """Required limit."""
    least: bool = False
    """Whether it is a lower limit."""
    with_runs: Callable[[int], np.ndarray] | None = None
    """Expected interval of so many runs like these."""
    utilisation: float = math.nan
    """Size that the required share reaches over the size allowed; below 1: margin."""
    plain: np.ndarray | None = None
    """Value (3,) of the runs alone, if `value` is by control variates."""

    def verdict(self, value: np.ndarray | None = None) -> str:
        """Verdict on the value, or on another value (3,)."""
        _, low, high = self.value if value is None else value
        good, bad = (low >= self.limit, high < self.limit) if self.least else (high <= self.limit, low > self.limit)
        return MET if good else NOT_MET if bad else UNDECIDED

    def more(self, runs: int) -> float:
        """Number of further runs for a decision, if they are like these; nan if none would be enough, or if it is
        decided."""
        if self.with_runs is None or self.verdict() != UNDECIDED or np.isnan(self.value[0]):
            return math.nan
        low, high = runs, 2 * runs
        while self.verdict(self.with_runs(high)) == UNDECIDED:
            low, high = high, 2 * high
            if high > MOST_RUNS:
                return math.nan
        while high - low > max(1, low // 100):
            middle = (low + high) // 2
            low, high = (middle, high) if self.verdict(self.with_runs(middle)) == UNDECIDED else (low, middle)
        return float(high - runs)


UNKNOWN = np.full(3, np.nan)
"""Value of a quantity that a method does not compute."""


def unevaluated_by_importance_sampling(scenario: Landing) -> list[str]:
    """Warning about requirements that importance sampling cannot evaluate."""
    every = singles(scenario.requirements)
    told = BoxRequirement, GoAroundRequirement
    untold = [text + _statement(one)[0] for text, one in every if not isinstance(one, told)]
    if not untold:
        return []
    text = "requirements: `--method rare` judges the box and go-arounds alone; for others use `--method monte-carlo`"
    return [f"{text}: {'; '.join(untold)}"]


@dataclass(frozen=True)
class Statement:
    """A requirement in words. unit: of its value. limit: required; least: whether it is a lower limit."""

    text: str
    unit: str
    limit: float
    least: bool


def statements(scenario: Landing) -> list[Statement]:
    """All requirements of a scenario, presets as their parts, in the order of evaluation."""
    out = []
    for before, one in singles(scenario.requirements):
        text, limit, least = _statement(one)
        unit = {RmsRequirement: "m", AlertRequirement: "s"}.get(type(one), "1")
        out.append(Statement(before + text, unit, limit, least))
    return out


Moments = tuple[np.ndarray, np.ndarray]
"""Mean (h, 3) and 1 sigma (h, 3) of the errors at the heights, from a covariance analysis."""


def fulfilments(
    draft: ResultBuilder,
    case: Case,
    runs: int,
    moments: Moments | None = None,
    within: Sequence[np.ndarray] | None = None,
    controls: Controls | None = None,
) -> list[RequirementValue]:
    """Values of the requirements from a summary.

    With layout `COVARIANCE`, analysis or monitor may be missing; values that need them are unknown. within: see
    `integrity.levels_within`. controls: controlled estimates of the runs, if there are any.
    """
    uncounted = _uncounted(case.scenario)
    shares = iter(within or ())
    found = []
    every = singles(case.scenario.requirements)
    for i, (text, (_, one)) in enumerate(zip(statements(case.scenario), every, strict=True)):
        nothing = RequirementValue(text.text, UNKNOWN, text.limit, text.least)
        if isinstance(one, LevelRequirement) and within is not None:
            found.append(_share_of_epochs(nothing, next(shares), runs))
        else:
            known = nothing if i in uncounted else _found(one, draft, case, runs, moments)
            if controls is not None and np.isfinite(known.value).all():
                known = _by_control(one, known, controls, runs)
            found.append(replace(known, text=text.text))
    return found


def _uncounted(scenario: Landing) -> set[int]:
    """Requirements, presets as their parts, on counts with other limits than the scenario's."""
    out, i = set(), 0
    limits = None if scenario.integrity is None else scenario.integrity.limits
    for each in scenario.requirements:
        parts = each.parts() if isinstance(each, PresetRequirement) else (each,)
        other = isinstance(each, PresetRequirement) and not each.counts_by(limits)
        out |= {i + k for k, part in enumerate(parts) if other and isinstance(part, RiskRequirement)}
        i += len(parts)
    return out


def write_verdicts(
    draft: ResultBuilder,
    case: Case,
    runs: int,
    moments: Moments | None = None,
    within: Sequence[np.ndarray] | None = None,
    controls: Controls | None = None,
) -> None:
    """The verdicts, by a summary that is complete otherwise; nothing where nothing is asked for."""
    found = fulfilments(draft, case, runs, moments, within, controls)
    if not found:
        return
    branch = "/summary/requirements"
    draft[f"{branch}/requirement"] = np.arange(1, len(found) + 1)
    draft[f"{branch}/statement"] = np.array([one.text for one in found], dtype=object)
    draft[f"{branch}/value"] = np.stack([one.value for one in found])
    draft[f"{branch}/limit"] = np.array([one.limit for one in found])
    asked = [one for _, one in singles(case.scenario.requirements)]
    for name in ("what", "of", "at"):
        draft[f"{branch}/{name}"] = np.array([getattr(one, name, "") for one in asked], dtype=object)
    draft[f"{branch}/size"] = np.array([getattr(one, "below_m", math.nan) for one in asked])
    draft[f"{branch}/verdict"] = np.array([one.verdict() for one in found], dtype=object)
    draft[f"{branch}/more_runs"] = np.array([one.more(runs) for one in found])
    draft[f"{branch}/plain_value"] = np.stack([UNKNOWN if one.plain is None else one.plain for one in found])
    plain = ["" if one.plain is None else one.verdict(one.plain) for one in found]
    draft[f"{branch}/plain_verdict"] = np.array(plain, dtype=object)


def _found(one: AnySingle, draft: ResultBuilder, case: Case, runs: int, moments: Moments | None) -> RequirementValue:
    """Value of a requirement from a summary."""
    text, limit, least = _statement(one)
    nothing = RequirementValue(text, UNKNOWN, limit, least)
    if isinstance(one, BoxRequirement):
        return _of_box(nothing, draft, runs)
    if draft.layout == RARE:
        if not isinstance(one, GoAroundRequirement):
            return nothing
        effective = float(draft["/summary/rare/go_around_effective_samples"])
        few = 0.0 < effective < FEW
        return nothing if few else _pushed(nothing, draft["/summary/rare/go_around"], runs)
    if isinstance(one, LevelRequirement):
        monitor = case.flight.monitor
        levels = None if monitor is None else tested_levels(monitor)[:, ("hpl", "vpl").index(one.of)]
        return _of_epochs(one, nothing, levels, case)
    if isinstance(one, ThresholdRequirement | AccuracyRequirement):
        return _of_epochs(one, nothing, sizes_of(one, case.flight.watching, case.flight.monitor), case)
    if draft.layout == COVARIANCE and isinstance(one, AvailabilityRequirement):
        return (_available_by_levels if one.what == "availability" else _approaches_by_levels)(one, nothing, case)
    if draft.layout == COVARIANCE and is_kept_from_faults(case):
        return nothing
    if isinstance(one, ErrorRequirement):
        return _of_error(one, nothing, draft, case, moments)
    if isinstance(one, RmsRequirement):
        return _of_rms(one, nothing, draft, runs) if touches_down(case) else nothing
    if draft.layout == COVARIANCE:
        return nothing
    if isinstance(one, GoAroundRequirement):
        return _counted(nothing, int(draft["/summary/go_around/count"]), runs)
    if isinstance(one, IndicatorRequirement):
        largest = draft[f"/summary/indicator/{one.what}_largest_run"]
        beyond, judged = runs_beyond(largest, one.within)
        return _counted(nothing, judged - beyond, judged) if judged else nothing
    if isinstance(one, AlertRequirement):
        return replace(nothing, value=_exactly(float(draft["/summary/integrity/time_to_alert"])))
    if one.what == "misleading" and not _may_mislead(case):
        return nothing
    return _of_shares(one, nothing, draft, runs)


def _by_control(one: AnySingle, plain: RequirementValue, controls: Controls, runs: int) -> RequirementValue:
    """Value of a requirement from the controlled estimate if that is better than the plain one."""
    if isinstance(one, BoxRequirement):
        found = controls.outside()
    elif isinstance(one, ErrorRequirement):
        found = controls.at_heights()[_AXES.index(one.of)][
            list(evaluated_heights(controls.case.scenario)).index(one.at)
        ].share_below(one.below_m)
    elif isinstance(one, RmsRequirement):
        found = controls.rms(one.of)
    else:
        return plain
    if not found.helps:
        return plain
    return replace(plain, value=found.value, plain=plain.value, with_runs=lambda n: found.with_runs(runs, n))


def _statement(one: AnySingle) -> tuple[str, float, bool]:
    """A requirement in words, its limit, and whether it is a lower limit."""
    if isinstance(one, ErrorRequirement):
        height = spoken_height(one.at)
        return f"{one.of} error at {height} below {one.below_m:g} m in {100 * one.share:g} % of runs", one.share, True
    if isinstance(one, RmsRequirement):
        return f"{one.of} RMS error before touchdown below {one.below_m:g} m", one.below_m, False
    if isinstance(one, BoxRequirement):
        return f"outside the box in at most {one.at_most:g} of landings", one.at_most, False
    if isinstance(one, GoAroundRequirement):
        return f"a go-around after an alarm in at most {one.at_most:g} of landings", one.at_most, False
    if isinstance(one, IndicatorRequirement):
        seen = f"largest {one.what.replace('_', ' ')} deviation within {one.within:g} of full scale"
        return f"{seen} in {100 * one.share:g} % of runs", one.share, True
    if isinstance(one, LevelRequirement):
        name = one.of.upper()
        return f"{name} within {one.below_m:g} m at {100 * one.share:g} % of epochs of the glide", one.share, True
    if isinstance(one, ThresholdRequirement):
        return f"EMT within {one.below_m:g} m at {100 * one.share:g} % of epochs of the glide", one.share, True
    if isinstance(one, AccuracyRequirement):
        error = f"P(fault-free vertical error > {one.below_m:g} m) at most {one.at_most:g}"
        return f"{error} at {100 * one.share:g} % of epochs of the glide", one.share, True
    if isinstance(one, AvailabilityRequirement):
        what = "epochs of the glide available" if one.what == "availability" else "approaches available throughout"
        return f"{100 * one.at_least:g} % of {what}", one.at_least, True
    if isinstance(one, RiskRequirement):
        what = "continuity risk in 15 s" if one.what == "continuity" else "risk of hazardously misleading information"
        return f"{what} at most {one.at_most:g}", one.at_most, False
    return f"an alarm within {one.within_s:g} s in each of these runs", one.within_s, False


def _exactly(value: float) -> np.ndarray:
    return np.full(3, value)


def _counted(nothing: RequirementValue, count: int, runs: int) -> RequirementValue:
    """Value of a fraction of runs."""
    share = count / runs

    def with_runs(n: int) -> np.ndarray:
        return share_interval(round(share * n), n)

    return replace(nothing, value=share_interval(count, runs), with_runs=with_runs)


def _pushed(nothing: RequirementValue, value: np.ndarray, runs: int) -> RequirementValue:
    """Value of a probability (3,) from pushed runs."""

    def with_runs(n: int) -> np.ndarray:
        reach = np.log(value[1:] / value[0]) * math.sqrt(runs / n)
        return np.array([value[0], *(value[0] * np.exp(reach))])

    return replace(nothing, value=value, with_runs=with_runs if np.isfinite(value).all() and value[1] > 0.0 else None)


def _of_box(nothing: RequirementValue, draft: ResultBuilder, runs: int) -> RequirementValue:
    if draft.layout == RARE:
        return _pushed(nothing, draft["/summary/rare/probability"], runs)
    if draft.layout == COVARIANCE:  # between the most probable of its sides and the sum of all
        if "/summary/box/axis_first_order" not in draft:
            return nothing
        sides = draft["/summary/box/axis_first_order"]
        most = min(1.0, float(np.nansum(sides)))
        return replace(nothing, value=np.array([most, float(np.nanmax(sides)), most]))
    return _counted(nothing, int(draft["/summary/box/outside"]), runs)


def _of_error(
    one: ErrorRequirement,
    nothing: RequirementValue,
    draft: ResultBuilder,
    case: Case,
    moments: Moments | None,
) -> RequirementValue:
    height, axis = list(evaluated_heights(case.scenario)).index(one.at), _AXES.index(one.of)
    if draft.layout == COVARIANCE:
        mean, sigma = (math.nan, math.nan) if moments is None else (float(moment[height, axis]) for moment in moments)
        if not math.isfinite(sigma):
            return nothing
        share = 1.0 - float(normal.exceedance(np.array(one.below_m), mean, sigma))
        return replace(
            nothing, value=_exactly(share), utilisation=folded_quantile(one.share, mean, sigma) / one.below_m
        )
    error = draft[f"/summary/at/{one.of}_run"][:, height]
    if "/summary/go_around/time_run" in draft:  # of the runs that still land
        error = error[~(draft["/summary/go_around/time_run"] < crossing_times(case)[height])]
    if np.isnan(error).all():  # the height is not passed
        return nothing
    return _counted(nothing, int((np.abs(error) < one.below_m).sum()), error.size)


def _of_rms(one: RmsRequirement, nothing: RequirementValue, draft: ResultBuilder, runs: int) -> RequirementValue:
    if draft.layout == COVARIANCE and f"/summary/rms/{one.of}" not in draft:
        return nothing
    value = draft[f"/summary/rms/{one.of}"]
    if draft.layout == COVARIANCE:
        return replace(nothing, value=value, utilisation=float(value[0]) / one.below_m)
    if not np.isfinite(value).all():
        return replace(nothing, value=value)
    axes = draft["/summary/rms/position_ned"][:, 0]
    squares = (axes[:2] if one.of == "horizontal" else axes[2:]) ** 2
    return replace(nothing, value=value, with_runs=lambda n: rms_interval_of_means(squares, n))


def _of_epochs(
    one: LevelRequirement | ThresholdRequirement | AccuracyRequirement,
    nothing: RequirementValue,
    sizes: np.ndarray | None,
    case: Case,
) -> RequirementValue:
    """Value from the fraction of epochs of the glide whose sizes (e,), m, are within the requirement; nan is not."""
    glide = glide_of(case)
    if sizes is None or not glide.any():
        return nothing
    sizes = sizes[glide]
    share = float(np.mean(sizes <= one.below_m))
    # after an exclusion they are larger, in runs that have one
    value = np.array([share, 0.0, share]) if excludes(case) else _exactly(share)
    return replace(nothing, value=value, utilisation=_kept_by(sizes, one.share) / one.below_m)


def sizes_of(
    one: ThresholdRequirement | AccuracyRequirement, watching: Monitoring | None, monitor: LandingMonitor | None
) -> np.ndarray | None:
    """Quantity of a requirement at all epochs (e,), m; None if unknown."""
    if watching is None or monitor is None:
        return None
    if isinstance(one, ThresholdRequirement):
        threshold = threshold_by_faults(monitor)
        return None if threshold is None else np.where(monitor.tested, threshold, np.nan)
    return -normal.quantile(0.5 * one.at_most) * vertical_sigma(watching, monitor)


def _available_by_levels(one: AvailabilityRequirement, nothing: RequirementValue, case: Case) -> RequirementValue:
    """Bounds of availability: epochs of the glide with levels within their limits, with and without false alarms.

    Only runs show other alarms: faults, or ranges worse than the monitor's model.
    """
    asked, monitor, section = approach_limits(case), case.flight.monitor, case.scenario.integrity
    if asked is None or monitor is None or section is None:
        return nothing
    relative = relative_levels(asked, tested_levels(monitor))[asked.glide].max(axis=1)
    if not relative.size:
        return nothing
    share = float(np.mean(relative <= 1.0))
    worse = section.sigma_ratio_acc < 1.0 or section.error_model != "gaussian"
    if worse or any(event.what != "silence" for event in case.scenario.events):
        return replace(nothing, value=np.array([share, 0.0, share]))
    quiet = 1.0 - section.false_alarm()
    due = one.at_least / quiet
    return replace(
        nothing,
        value=np.array([share, share * quiet, share]),
        utilisation=_kept_by(relative, due) if due <= 1.0 else math.inf,
    )


def _approaches_by_levels(one: AvailabilityRequirement, nothing: RequirementValue, case: Case) -> RequirementValue:
    """No approach if a required epoch has a level beyond its limit; only runs show how many have no alarm."""
    asked, monitor = approach_limits(case), case.flight.monitor
    if asked is None or monitor is None:
        return nothing
    relative = relative_levels(asked, tested_levels(monitor))[asked.due].max(axis=1, initial=0.0)
    return replace(nothing, value=_exactly(0.0)) if (relative > 1.0).any() else nothing


def _may_mislead(case: Case) -> bool:
    """Whether a level is within its limit at any epoch of the glide; beyond it navsim claims nothing."""
    asked, monitor = approach_limits(case), case.flight.monitor
    if asked is None or monitor is None:
        return False
    return bool((relative_levels(asked, tested_levels(monitor))[asked.glide] <= 1.0).any())


def _kept_by(values: np.ndarray, share: float) -> float:
    """Smallest size that this fraction of values (n,) does not exceed, inf if too many have none."""
    ordered = np.sort(np.where(np.isnan(values), np.inf, values))
    shares = np.arange(1, ordered.size + 1) / ordered.size
    return float(ordered[np.searchsorted(shares, share)])


def _of_shares(
    one: AvailabilityRequirement | RiskRequirement, nothing: RequirementValue, draft: ResultBuilder, runs: int
) -> RequirementValue:
    branch = "/summary/integrity"
    if one.what in ("approaches", "misleading"):
        value = draft[f"{branch}/{'hmi' if one.what == 'misleading' else one.what}"]
        return _counted(nothing, round(float(value[0]) * runs), runs) if np.isfinite(value[0]) else nothing
    value = draft[f"{branch}/{'continuity_risk' if one.what == 'continuity' else one.what}"]
    return _share_of_epochs(nothing, value, runs)


def _share_of_epochs(nothing: RequirementValue, share: np.ndarray, runs: int) -> RequirementValue:
    """Value of a fraction of epochs (3,) of so many runs."""
    if not np.isfinite(share).all():
        return replace(nothing, value=np.array([share[0], np.nan, np.nan]))
    alike = np.array_equal(share, share_of_alike(float(share[0]), runs))
    half = float(np.abs(share[1:] - share[0]).max())  # the other end may be cut off at 0 or 1

    def with_runs(n: int) -> np.ndarray:
        if alike:
            return share_of_alike(float(share[0]), n)
        reach = half * math.sqrt(runs / n)
        return np.array([share[0], *np.clip([share[0] - reach, share[0] + reach], 0.0, 1.0)])

    return replace(nothing, value=share, with_runs=with_runs)
