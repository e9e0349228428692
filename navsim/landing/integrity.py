"""Integrity results of a landing: levels, alarms, availability, misleading information, as `/integrity` and
`/summary/integrity`.

Source of the counts: `docs/theory/integrity.md`, section 7.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.environment.sources import on_glide
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.events import BEACONS, Event, Silence
from navsim.integrity import sbas_gbas
from navsim.integrity.araim import SeparationDistances
from navsim.integrity.exclusion import NOTHING
from navsim.integrity.gbas_station import ERRORS, LEVELS
from navsim.integrity.monitoring import (
    ALARM,
    EXCLUDED,
    NO_EXCLUSION,
    NO_FIX,
    QUIET,
    alerted,
    fix_of,
    runway_levels,
    tested_levels,
    vertical_sigma,
)
from navsim.landing.case import Case, times_at_heights
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding
from navsim.results.notes import Note
from navsim.results.schema import COVARIANCE
from navsim.runner.batches import Ensemble
from navsim.runner.checkpoint import Arrays
from navsim.runner.statistics import mean_interval, share_interval
from navsim.scenario.requirements import LevelRequirement, singles
from navsim.scenario_files.base import DEG
from navsim.sensors.ground_stations import GroundStation
from navsim.simulation.filter_bank import FilterBank, ground_received
from navsim.simulation.run import Run
from navsim.statistics.rounding import digits

WINDOW = 15.0
"""Length of the stretches for which continuity is counted, s: as ICAO Annex 10, table 3.7.2.4-1 has it."""
REGIONS = ("nominal", "misleading", "hazardous", "unavailable", "unavailable_misleading", "alarm")
"""Regions of a Stanford diagram, without epochs with an alarm."""
NOMINAL, MISLEADING, HAZARDOUS, UNAVAILABLE, UNAVAILABLE_MISLEADING, ALARMED = range(6)
EXCLUSIONS = ("correct", "wrong", "needless")
"""Outcomes of exclusions when events are active: the remaining sources are unaffected; they are affected; no event."""
_EARLY = 1e-9
"""Tolerance of times, which are sums of intervals."""


@dataclass(frozen=True)
class ApproachLimits:
    """Integrity requirements of an approach."""

    limits: np.ndarray
    """(e, 2) horizontal and vertical alert limit at each epoch, m, inf for none."""
    alert: float
    """Time to alert, s."""
    time: np.ndarray
    """(e,) fix epochs, s."""
    glide: np.ndarray
    """(e,) bool, on the glide."""
    due: np.ndarray
    """(e,) bool, where the approach has to be available throughout."""
    grow: bool = False
    """Whether limits grow with the distance from the threshold."""

    def at(self, epochs: np.ndarray) -> ApproachLimits:
        """Those at some epochs, their numbers (m,)."""
        limits, time, glide, due = (each[epochs] for each in (self.limits, self.time, self.glide, self.due))
        return replace(self, limits=limits, time=time, glide=glide, due=due)


def glide_of(case: Case) -> np.ndarray:
    """Which fix epochs are on the glide (e,) bool."""
    return on_glide(case.scenario, case.trajectory, case.shared.signals.time)


def spread_over(epochs: np.ndarray, most: int) -> np.ndarray:
    """At most so many of epochs (e,), including the first and the last."""
    count = min(epochs.size, most)
    return epochs[np.arange(count) * (epochs.size - 1) // max(count - 1, 1)]


def approach_limits(case: Case) -> ApproachLimits | None:
    """Requirements of the scenario, if any."""
    section = case.scenario.integrity
    if section is None or section.limits is None:
        return None
    time, glide = case.shared.signals.time, glide_of(case)
    due = glide
    if section.decision_height_m is not None:
        (passed,) = times_at_heights(case, [section.decision_height_m])
        due = glide & (time >= (-math.inf if math.isnan(passed) else passed) - _EARLY)
    limits = np.array([math.inf if limit is None else limit for limit in section.limits.limits()])
    grow = section.limits.grow_with_distance
    limits = limits + (_growth(case, time) if grow else np.zeros((time.size, 2)))
    return ApproachLimits(limits, section.limits.tta_s, time, glide, due, grow)


def _growth(case: Case, time: np.ndarray) -> np.ndarray:
    """What alert limits at the route's places at times (e,), s, exceed those at the threshold by (e, 2), m."""
    frame, route = case.trajectory.frame, case.trajectory.path.jet(time)[:, 0]
    threshold = (ecef_from_llh(case.scenario.threshold(frame)) - frame.origin) @ frame.axes
    return sbas_gbas.growth_of_limits(threshold[0] - route[:, 0], threshold[2] - route[:, 2])


def least_limits(asked: ApproachLimits) -> np.ndarray:
    """The smallest of the alert limits at any epoch of the glide (2,), m; those of all epochs without a glide."""
    limits = asked.limits[asked.glide] if asked.glide.any() else asked.limits
    return limits.min(axis=0, initial=np.inf)


def below_limits(asked: ApproachLimits, levels: np.ndarray) -> np.ndarray:
    """Whether levels (..., 2) of tested fixes, nan of others, are below their limits; without a limit no level is
    needed."""
    return relative_levels(asked, levels) <= 1.0


def relative_levels(asked: ApproachLimits, levels: np.ndarray) -> np.ndarray:
    """Levels (..., 2) relative to their limits, inf without a level, 0 without a limit."""
    relative = np.where(np.isfinite(levels), levels, np.inf) / np.where(np.isinf(asked.limits), 1.0, asked.limits)
    return np.where(np.isinf(asked.limits), 0.0, relative)


def faulty_measurements(case: Case) -> np.ndarray:
    """Which measurements, of sources and of monitored transmitters on the ground, are wrong by an event or a fault
    (e, s + g) bool."""
    signals, watching = case.shared.signals, case.flight.watching

    def wrong(events: Sequence[Event], names: Sequence[str], systems: Sequence[str]) -> np.ndarray:
        out = np.zeros((signals.time.size, len(names)), bool)
        for event in events:
            if not isinstance(event.what, Silence):
                during = (signals.time >= event.begin) & (signals.time < event.end)
                out |= during[:, None] & event.concerns(names, systems)
        return out

    out = wrong(case.environment.events, signals.names, case.environment.systems_of(signals.names)) & signals.used
    if watching is None or not watching.ground:
        return out
    beacons = case.scenario.beacons
    mine, names = () if beacons is None else beacons.happenings(case.scenario), watching.ground
    on_ground = wrong(mine, names, [BEACONS] * len(names))
    for aid in case.shared.aids:
        for begin, end, *_ in aid.sensor.faults if isinstance(aid.sensor, GroundStation) else ():
            on_ground[:, names.index(aid.sensor.name)] |= (signals.time >= begin) & (signals.time < end)
    return np.hstack([out, on_ground & ground_received(case.flight)])


def exclusion_outcomes(case: Case) -> np.ndarray:
    """Outcome by `EXCLUSIONS` of excluding each candidate at each epoch (c + 1, e); the last is `NOTHING`."""
    wrong, watching = faulty_measurements(case), case.flight.watching
    if case.flight.bank is not None:
        wrong = np.logical_or.accumulate(wrong, axis=0)  # a filter that took it does not forget it
    names = (*case.shared.signals.names, *(() if watching is None else watching.ground))
    taken = np.array([np.isin(names, one.sources) for one in case.flight.candidates]).reshape(-1, 1, len(names))
    remains = (wrong & ~taken).any(axis=2)
    came = np.where(wrong.any(axis=1), remains.astype(np.int64), EXCLUSIONS.index("needless"))
    return np.concatenate([came, np.full((1, wrong.shape[0]), NOTHING)])


def count_epochs(case: Case, runs: Run) -> Arrays:
    """Counts of each of several runs, on the glide; empty without a monitor."""
    monitor = case.flight.monitor
    if monitor is None:
        return {}
    glide = glide_of(case)
    status = runs.monitor_status[:, glide]
    out: Arrays = {
        "integrity_tested": (status >= QUIET).sum(axis=1),
        "integrity_alarms": (status == ALARM).sum(axis=1),
        "integrity_lost": (status == NO_FIX).sum(axis=1),
    }
    if case.flight.station is not None:
        own, error = (runs.station[:, glide, part] for part in (LEVELS, ERRORS))
        out["integrity_station_fixes"] = np.isfinite(own[..., 0]).sum(axis=1)
        out["integrity_station_level"] = np.nansum(own, axis=1)
        out["integrity_station_exceeded"] = (error > own).sum(axis=1)
    if watches_innovations(case):
        out["integrity_innovations"] = (runs.innovation_ratio[:, glide] > 1.0).sum(axis=1)
    levels = tested_levels(monitor)[None]
    if excludes(case):
        excluded, levels = runs.monitor_excluded[:, glide], runs.monitor_level
        came = exclusion_outcomes(case)[excluded, np.flatnonzero(glide)]
        out["integrity_exclusions"] = (came[..., None] == np.arange(len(EXCLUSIONS))).sum(axis=1)
        if sizes := _levels_required(case):
            small = [levels[:, glide, axis] <= size for axis, size in sizes]
            out["integrity_within"] = np.stack(small, axis=2).sum(axis=1)
    settled = (runs.monitor_status == QUIET) | (runs.monitor_status == EXCLUDED)
    beyond = settled[..., None] & (runs.watched_error > levels)
    out["integrity_exceeded"] = beyond[:, glide].sum(axis=1)
    asked = approach_limits(case)
    if asked is None:
        return out
    low = below_limits(asked, levels)
    available = settled & low.all(axis=2)
    out["integrity_available"] = available[:, glide].sum(axis=1)
    if excludes(case):
        out["integrity_regained"] = (available[:, glide] & (status == EXCLUDED)).sum(axis=1)
    out["integrity_approach"] = available[:, asked.due].all(axis=1).astype(np.int64) * int(asked.due.any())
    out["integrity_windows"] = continuity_windows(asked.time[glide], available[:, glide])
    region = stanford_regions(asked, levels, runs.monitor_status, runs.watched_error)[:, glide]
    out["integrity_regions"] = np.stack([(region == i).sum(axis=1) for i in range(len(REGIONS))], axis=2)
    exceeded = runs.watched_error[:, glide] > asked.limits[glide]
    # a level above its limit has already announced that the error may be large
    misled = exceeded & low[:, glide]
    out["integrity_misled"] = np.zeros((status.shape[0], 2), np.int64)
    out["integrity_delay"] = np.full((status.shape[0], 2), np.nan)
    for run, axis in np.argwhere(misled.any(axis=1)):
        found = missed_alerts(asked, asked.time[glide], misled[run, :, axis], alerted(status[run]))
        out["integrity_misled"][run, axis], out["integrity_delay"][run, axis] = found
    return out


def _levels_required(case: Case) -> list[tuple[int, float]]:
    """Axis and size of the scenario's requirements on levels, in their order."""
    asked = [one for _, one in singles(case.scenario.requirements) if isinstance(one, LevelRequirement)]
    return [(("hpl", "vpl").index(one.of), one.below_m) for one in asked]


def levels_within(case: Case, ensemble: Ensemble) -> list[np.ndarray] | None:
    """Fractions (3,) of the epochs of the glide with levels within the requirements, each with its interval.

    None if all runs have the same levels, without exclusion.
    """
    if not (excludes(case) and _levels_required(case) and glide_of(case).any()):
        return None
    epochs = np.full(ensemble.runs, int(glide_of(case).sum()))
    return [share_over_runs(each, epochs) for each in ensemble.per_run("integrity_within").T]


def excludes(case: Case) -> bool:
    """Whether something is excluded after alarms."""
    watching = case.flight.watching
    return watching is not None and watching.exclusion != NO_EXCLUSION


def is_kept_from_faults(case: Case) -> bool:
    """Whether runs ignore fixes or sources after alarms, and events cause some.

    Covariance analysis and levels of all sources do not include this.
    """
    return (excludes(case) or case.flight.drops) and bool(faulty_measurements(case).any())


def watches_innovations(case: Case) -> bool:
    """Whether the filter's innovations are monitored."""
    watching = case.flight.watching
    return watching is not None and watching.innovations is not None


def stanford_regions(asked: ApproachLimits, levels: np.ndarray, status: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Region of each fix in horizontal and vertical Stanford diagrams (r, e, 2), by `REGIONS`.

    error: (r, e, 2); levels: (r or 1, e, 2) of tested ones; status: (r, e).
    """
    level = np.where(np.isnan(levels), np.inf, levels)
    below = error <= level
    inside = np.where(below, NOMINAL, np.where(error <= asked.limits, MISLEADING, HAZARDOUS))
    # an error without a fix is no number, and beyond no level
    outside = np.where(error > level, UNAVAILABLE_MISLEADING, UNAVAILABLE)
    found = np.where((level <= asked.limits) & np.isfinite(level) & (status != NO_FIX)[..., None], inside, outside)
    return np.where((status == ALARM)[..., None], ALARMED, found)


def continuity_windows(time: np.ndarray, available: np.ndarray) -> np.ndarray:
    """Number of intervals of `WINDOW` that begin available, and of those in which availability is lost (r, 2).

    available: (r, e).
    """
    last = np.searchsorted(time, time + WINDOW + _EARLY, side="right") - 1
    whole = time + WINDOW <= time[-1] + _EARLY if time.size else np.zeros(0, bool)
    lost = np.concatenate([np.zeros((available.shape[0], 1), np.int64), np.cumsum(~available, axis=1)], axis=1)
    begun = available[:, whole]
    broken = lost[:, last[whole] + 1] - lost[:, np.flatnonzero(whole)] > 0
    return np.stack([begun.sum(axis=1), (begun & broken).sum(axis=1)], axis=1)


def missed_alerts(asked: ApproachLimits, time: np.ndarray, misled: np.ndarray, alarm: np.ndarray) -> tuple[int, float]:
    """Alerts for intervals in which an error exceeds its limit and its level does not.

    Returns the number of intervals (e,) without an alert, as of `alerted`, within the time to alert; and the longest
    wait, s. The wait is inf if an alert was due and did not come, nan if none was due. An interval without an alarm
    that lasts to the end counts even if it is short.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], misled, [False]]).astype(np.int8)))
    late, longest = 0, math.nan
    for first, end in edges.reshape(-1, 2):
        alarms = np.flatnonzero(alarm[first:end])
        lasted = math.inf if end == time.size else float(time[end - 1] - time[first])
        wait = float(time[first + alarms[0]] - time[first]) if alarms.size else lasted
        missed = wait > asked.alert + _EARLY
        late += int(missed)
        if alarms.size or missed:
            longest = float(np.fmax(longest, wait if alarms.size else math.inf))
    return late, longest


def write_levels(draft: ResultBuilder, case: Case) -> None:
    """Write levels by geometry, which are the same in all runs, and their summary; nothing without a monitor."""
    monitor, watching = case.flight.monitor, case.flight.watching
    if monitor is None or watching is None:
        return
    draft["/integrity/time"] = case.shared.signals.time
    draft["/integrity/threshold"] = monitor.threshold
    draft["/integrity/sigma_vertical"] = vertical_sigma(watching, monitor)
    levels = monitor.levels
    for i, name in enumerate(("hpl", "vpl")):
        draft[f"/integrity/{name}"] = levels[:, i]
    if isinstance(monitor, SeparationDistances):
        expected = case.flight.expected
        draft["/integrity/fault"] = np.array([fault.name for fault in expected], dtype=object)
        draft["/integrity/prior"] = np.array([fault.prior for fault in expected], dtype=float)
        draft["/integrity/monitored"] = monitor.found.monitored.astype(np.int8)
        draft["/integrity/unmonitored"] = monitor.found.unmonitored
        draft["/integrity/emt"] = monitor.found.emt
    glide = glide_of(case)
    there = np.isfinite(levels[glide]).all(axis=1)
    draft["/summary/integrity/level_share"] = there.mean() if there.size else math.nan
    for i, name in enumerate(("hpl", "vpl")):
        draft[f"/summary/integrity/{name}"] = _numbers(levels[glide][there, i])
    asked = approach_limits(case)
    if asked is not None:
        draft["/summary/integrity/hal"], draft["/summary/integrity/val"] = least_limits(asked)
        if asked.grow:
            draft["/integrity/hal"], draft["/integrity/val"] = asked.limits.T
        draft["/summary/integrity/tta"] = asked.alert


def _numbers(values: np.ndarray) -> np.ndarray:
    """Mean, smallest, largest, median and 95 % of levels (n,); nan of none."""
    if not values.size:
        return np.full(5, np.nan)
    return np.array([values.mean(), values.min(), values.max(), *np.percentile(values, [50, 95])])


def in_runway_axes(draft: ResultBuilder, case: Case) -> None:
    """Write levels across and along the runway, beside those of `write_levels`; nothing without a monitor."""
    flight, bearing = case.flight, case.scenario.runway.heading_deg * DEG
    if flight.bank is not None:
        levels = flight.bank.along(bearing)
    elif flight.snapshot is not None and flight.watching is not None:
        levels = runway_levels(flight.watching, flight.snapshot, case.shared.signals, bearing)
    else:
        return
    there = glide_of(case) & np.isfinite(levels).all(axis=1)
    for i, name in enumerate(("lateral", "along")):
        draft[f"/integrity/level_{name}"] = levels[:, i]
        draft[f"/summary/integrity/level_{name}"] = _numbers(levels[there, i])


def write_comparison(draft: ResultBuilder, case: Case) -> None:
    """Write levels of the same fixes by the methods of other systems, if requested."""
    section = case.scenario.integrity
    if section is None or section.comparison is None:
        return
    signals, scenario, station = case.shared.signals, case.scenario, section.comparison.gbas
    fix, found = fix_of(signals), {}
    if section.comparison.sbas:
        levels = sbas_gbas.sbas(fix, None if section.limits is None else section.limits.operation)
        found = {"sbas_hpl": levels[:, 0], "sbas_vpl": levels[:, 1]}
    if case.flight.station is not None:
        found |= dict(zip(("gbas_lpl", "gbas_vpl"), case.flight.station.fault_free().T, strict=True))
    elif station is not None and station.receivers is not None:
        projection = sbas_gbas.gbas_projection(fix.estimator, scenario.runway.heading_deg * DEG, scenario.glide_path())
        sigma = np.where(signals.used, signals.fix_sigma, 0.0)
        ground, b = (np.full(sigma.shape, value) for value in (station.ground_sigma_m, station.b_m))
        # B values times the sizes of the effect of each range add up to the worst case
        projection = np.abs(projection)
        levels = sbas_gbas.gbas(
            projection, sigma, ground, sbas_gbas.effect_of_b(projection, b), station.receivers,
            sbas_gbas.gbas_factors(station.receivers),
        ).max(axis=2)  # fmt: skip
        levels[~fix.solved] = np.nan
        found |= {"gbas_lpl": levels[:, 0], "gbas_vpl": levels[:, 1]}
    glide = glide_of(case)
    for name, values in found.items():
        draft[f"/integrity/{name}"] = values
        draft[f"/summary/integrity/{name}"] = _numbers(values[glide & np.isfinite(values)])


def levels_without_alarm(case: Case, ensemble: Ensemble) -> list[Finding]:
    """Finding of protection levels above their alert limits where only alarms break landings off."""
    if not case.scenario.breaks_off or approach_limits(case) is None:
        return []
    counts = ensemble.per_run("integrity_regions").sum(axis=0)
    above = counts[:, [REGIONS.index(name) for name in ("unavailable", "unavailable_misleading")]].sum(axis=1)
    if not (most := int(above.max())):
        return []
    axis = int(np.argmax(above))
    text = (
        f"the {('horizontal', 'vertical')[axis]} protection level is above its alert limit without an alarm at {most} "
        f"of {int(counts[axis].sum())} epochs: `go_around.on_alarm` counts alarms of tests, so that such a level "
        "breaks no landing off"
    )
    return [Finding("level_without_alarm", text)]


def level_outputs(case: Case) -> dict[str, float]:
    """Levels on the glide for those who need no more, by the names that sweeps have for them."""
    draft = ResultBuilder(COVARIANCE)
    write_levels(draft, case)
    out = {"level_share": float(draft["/summary/integrity/level_share"])}
    for name in ("hpl", "vpl"):
        numbers = draft[f"/summary/integrity/{name}"]
        out |= {f"{name}_p95": float(numbers[4]), f"{name}_max": float(numbers[2])}
    return out


def write_counts(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    """Write the counts of runs; nothing without a monitor."""
    if case.flight.monitor is None:
        return
    branch, runs = "/summary/integrity", ensemble.runs
    tested, alarms = ensemble.per_run("integrity_tested"), ensemble.per_run("integrity_alarms")
    draft[f"{branch}/tested"], draft[f"{branch}/alarms"] = np.int64(tested.sum()), np.int64(alarms.sum())
    draft[f"{branch}/alarm_share"] = share_over_runs(alarms, tested)
    draft[f"{branch}/lost"] = np.int64(ensemble.per_run("integrity_lost").sum())
    levelled = np.isfinite(tested_levels(case.flight.monitor)[glide_of(case)]).any(axis=0)
    for i, name in enumerate(("horizontal", "vertical")):
        exceeded = share_over_runs(ensemble.per_run("integrity_exceeded")[:, i], tested)
        draft[f"{branch}/exceeded_{name}"] = exceeded if levelled[i] else np.full(3, np.nan)
    if case.flight.station is not None:
        fixes, levels = ensemble.per_run("integrity_station_fixes"), ensemble.per_run("integrity_station_level")
        exceeded = ensemble.per_run("integrity_station_exceeded")
        for i, (axis, name) in enumerate((("lateral", "lpl"), ("vertical", "vpl"))):
            draft[f"{branch}/gbas_{name}_run"] = _numbers(levels[fixes > 0, i] / fixes[fixes > 0])
            draft[f"{branch}/gbas_exceeded_{axis}"] = share_over_runs(exceeded[:, i], fixes)
    if watches_innovations(case):
        found, glide = ensemble.per_run("integrity_innovations"), int(glide_of(case).sum())
        draft[f"{branch}/innovation_alarms"] = np.int64(found.sum())
        draft[f"{branch}/innovation_share"] = share_over_runs(found, np.full(runs, glide))
    if excludes(case):
        draft["/integrity/candidate"] = np.array([one.name for one in case.flight.candidates], dtype=object)
        _counted_exclusions(draft, branch, ensemble, alarms)
    if approach_limits(case) is None:
        return
    if excludes(case):
        regained, exclusions = (ensemble.per_run(f"integrity_{name}") for name in ("regained", "exclusions"))
        draft[f"{branch}/exclusions_available"] = share_over_runs(regained, exclusions.sum(axis=1))
    epochs = np.full(runs, int(glide_of(case).sum()))
    windows = ensemble.per_run("integrity_windows")
    draft[f"{branch}/availability"] = share_over_runs(ensemble.per_run("integrity_available"), epochs)
    draft[f"{branch}/continuity_risk"] = share_over_runs(windows[:, 1], windows[:, 0])
    draft[f"{branch}/approaches"] = share_interval(int(ensemble.per_run("integrity_approach").sum()), runs)
    misled = ensemble.per_run("integrity_misled") > 0
    delay = ensemble.per_run("integrity_delay")
    counts = ensemble.per_run("integrity_regions").sum(axis=0)
    draft[f"{branch}/region"] = np.array(REGIONS)
    for i, name in enumerate(("horizontal", "vertical")):
        misleading = share_interval(int(misled[:, i].sum()), runs)
        draft[f"{branch}/hmi_{name}"] = misleading if levelled[i] else np.full(3, np.nan)
        draft[f"{branch}/stanford_{name}"] = counts[i].astype(np.int64)
    either = share_interval(int(misled.any(axis=1).sum()), runs)
    draft[f"{branch}/hmi"] = either if levelled.any() else np.full(3, np.nan)
    draft[f"{branch}/time_to_alert"] = np.fmax.reduce(delay, axis=None)


def _counted_exclusions(draft: ResultBuilder, branch: str, ensemble: Ensemble, alarms: np.ndarray) -> None:
    """Write the outcomes of exclusions; alarms: number of other alarms (run,)."""
    came = ensemble.per_run("integrity_exclusions")
    for i, name in enumerate(EXCLUSIONS):
        draft[f"{branch}/exclusions_{name}"] = np.int64(came[:, i].sum())
    draft[f"{branch}/exclusions"] = np.int64(came.sum())
    draft[f"{branch}/exclusion_share"] = share_over_runs(came.sum(axis=1), came.sum(axis=1) + alarms)
    draft[f"{branch}/exclusion_wrong_share"] = share_over_runs(came[:, 1], came[:, :2].sum(axis=1))


def share_over_runs(count: np.ndarray, of: np.ndarray) -> np.ndarray:
    """Fraction of epochs (run,) of (run,) with its 95 % interval over runs: value, low, high; nan without epochs.

    Epochs of a run are correlated, so runs count as independent. If all runs are equal, the interval is that of
    `share_of_alike`.
    """
    total = int(of.sum())
    if not total:
        return np.full(3, np.nan)
    value = float(count.sum()) / total
    if (count * total == of * count.sum()).all():
        return share_of_alike(value, count.size)
    # runs with different numbers of epochs: a ratio of means, with the error from the residual of each
    reach = mean_interval((count - value * of) * (count.size / total))
    return np.array([value, max(0.0, value + reach[1]), min(1.0, value + reach[2])])


def share_of_alike(value: float, runs: int) -> np.ndarray:
    """Fraction of epochs that is the same in all of so many runs, with its 95 % interval.

    A different run is as probable as the number of equal runs allows.
    """
    _, _, rare = share_interval(0, runs)
    return np.array([value, value * (1.0 - rare), value + rare * (1.0 - value)])


def level_warnings(case: Case) -> list[str]:
    """Warnings about missing levels."""
    monitor, glide = case.flight.monitor, glide_of(case)
    section = case.scenario.integrity
    if monitor is None or section is None or not glide.any():
        return []
    lacking = glide & ~np.isfinite(monitor.levels).all(axis=1)
    if not lacking.any():
        if not case.flight.expected and section.method != "chi2":
            return ["integrity: no fault is expected (probabilities 0): nothing is tested, and no level counts"]
        return _by_inertial_sensors(case, glide)
    many = f"integrity: no protection level at {lacking.sum()} of {glide.sum()} epochs of the glide"
    if not isinstance(monitor, SeparationDistances):
        return [f"{many}: a range is not checked by the others there, or there is no fix"]
    unmonitored = monitor.found.unmonitored[lacking]
    worst = int(np.argmax(unmonitored))
    there = monitor.found.monitored[:, np.flatnonzero(lacking)[worst]]
    unseen = _named(case, ~there)
    if unmonitored[worst] <= section.p_unmonitored_max:
        budget = section.p_hmi_v + section.p_hmi_h
        if unmonitored[worst] >= budget:
            text = f"is {digits(unmonitored[worst], 2)}, and p_hmi_v and p_hmi_h allow {digits(budget, 2)} in all"
            return [f"{many}: the probability of unmonitored faults {text}"]
        return [f"{many}: there is no fix"]
    what = f" ({unseen})" if unseen else " (several at once)"
    return [
        f"{many}: the probability of unmonitored faults{what} is {digits(unmonitored[worst], 2)}; "
        f"integrity.p_unmonitored_max is {section.p_unmonitored_max:g}"
    ]


def _named(case: Case, which: np.ndarray) -> str:
    """The first of some expected faults (k,) bool, with their probabilities; "" for none."""
    names = [
        f"{fault.name} {fault.prior:g}" for fault, chosen in zip(case.flight.expected, which, strict=True) if chosen
    ]
    return f"{', '.join(names[:5])}{', ...' if len(names) > 5 else ''}"


def _by_inertial_sensors(case: Case, glide: np.ndarray) -> list[str]:
    """Warning about faults that the filter detects with its inertial sensors alone."""
    bank = case.flight.bank
    if not isinstance(bank, FilterBank):
        return []
    silent = glide & ~bank.aided
    if silent.any():
        return [
            f"integrity: no signal at {silent.sum()} of {glide.sum()} epochs of the glide: an alert, and no "
            "level counts there"
        ]
    which = (bank.found.monitored & bank.idle)[:, glide].any(axis=1)
    if not which.any():
        return []
    faults = case.flight.expected
    keys = dict.fromkeys(faults[j].key for i in np.flatnonzero(which) for j in faults[i].of or (i,))
    return [
        Note(
            f"integrity: without {_named(case, which)} the filter relies on its inertial sensors, and the levels grow. "
            f"These probabilities are set by {', '.join(f'integrity.{key}' for key in keys)}",
            "levels_by_inertial_sensors",
        )
    ]
