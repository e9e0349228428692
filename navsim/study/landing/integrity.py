"""What watching the fixes of a landing comes to: levels, alarms, what was available, what misled, as `/integrity` and
`/summary/integrity`.

Source of the counts: `docs/theory/integrity.md`, section 7.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from navsim.integrity.separation import SeparationMonitor
from navsim.io.draft import Draft
from navsim.io.schema import COVARIANCE
from navsim.simulation.landing import Run
from navsim.simulation.monitoring import ALARM, NO_FIX, QUIET, Snapshot
from navsim.study.ensemble import Ensemble
from navsim.study.landing.case import Case, on_glide, times_at_heights
from navsim.study.partial import Arrays
from navsim.study.statistics import mean_interval, share_interval

WINDOW = 15.0
"""Length of the stretches for which continuity is counted, s: as ICAO Annex 10, table 3.7.2.4-1 has it."""
REGIONS = ("nominal", "misleading", "hazardous", "unavailable", "unavailable_misleading", "alarm")
"""Where a pair of error and level lies in a Stanford diagram, but for those with an alarm."""
NOMINAL, MISLEADING, HAZARDOUS, UNAVAILABLE, UNAVAILABLE_MISLEADING, ALARMED = range(6)
_EARLY = 1e-9
"""Of times, which are sums of intervals."""


@dataclass(frozen=True)
class Asked:
    """What is asked of an approach.

    limits: (2,) of the horizontal and the vertical error, m, inf for none. alert: time to alert, s. time: (e,) of the
    fix epochs, s. glide: (e,) bool, on the glide. due: (e,) bool, where the approach has to be available throughout.
    """

    limits: np.ndarray
    alert: float
    time: np.ndarray
    glide: np.ndarray
    due: np.ndarray


def glide_of(case: Case) -> np.ndarray:
    """Which fix epochs are on the glide (e,) bool."""
    return on_glide(case.scenario, case.trajectory, case.world.signals.time)


def spread_over(epochs: np.ndarray, most: int) -> np.ndarray:
    """So many of epochs (e,) at most, the first and the last among them."""
    count = min(epochs.size, most)
    return epochs[np.arange(count) * (epochs.size - 1) // max(count - 1, 1)]


def asked_of(case: Case) -> Asked | None:
    """What the scenario asks, if anything."""
    section = case.scenario.integrity
    if section is None or section.limits is None:
        return None
    time, glide = case.world.signals.time, glide_of(case)
    due = glide
    if section.decision_height_m is not None:
        (passed,) = times_at_heights(case, [section.decision_height_m])
        due = glide & (time >= (-math.inf if math.isnan(passed) else passed) - _EARLY)
    limits = np.array([math.inf if limit is None else limit for limit in section.limits.limits()])
    return Asked(limits, section.limits.tta_s, time, glide, due)


def within(asked: Asked, monitor: Snapshot) -> np.ndarray:
    """Where the levels (e, 2) are below their limits; a limit that is none asks for no level."""
    return relative_levels(asked, monitor) <= 1.0


def relative_levels(asked: Asked, monitor: Snapshot) -> np.ndarray:
    """The levels (e, 2) by their limits, inf where there is none, 0 where none is asked for."""
    levels = monitor.levels
    there = monitor.tested[:, None] & np.isfinite(levels)
    relative = np.where(there, levels, np.inf) / np.where(np.isinf(asked.limits), 1.0, asked.limits)
    return np.where(np.isinf(asked.limits), 0.0, relative)


def tally(case: Case, runs: Run) -> Arrays:
    """What is counted of each of several runs, on the glide; nothing where nothing watches."""
    monitor = case.flight.monitor
    if monitor is None:
        return {}
    glide = glide_of(case)
    status = runs.monitor_status[:, glide]
    out: Arrays = {
        "integrity_tested": (status >= QUIET).sum(axis=1),
        "integrity_alarms": (status == ALARM).sum(axis=1),
    }
    asked = asked_of(case)
    if asked is None:
        return out
    low = within(asked, monitor)
    quiet = runs.monitor_status == QUIET
    available = quiet & low.all(axis=1)
    out["integrity_available"] = available[:, glide].sum(axis=1)
    out["integrity_approach"] = available[:, asked.due].all(axis=1).astype(np.int64) * int(asked.due.any())
    out["integrity_windows"] = windows(asked.time[glide], available[:, glide])
    region = regions(asked, monitor, runs.monitor_status, runs.fix_error)[:, glide]
    out["integrity_regions"] = np.stack([(region == i).sum(axis=1) for i in range(len(REGIONS))], axis=2)
    exceeded = runs.fix_error[:, glide] > asked.limits
    # a level above its limit has said already that the error may be large
    misled = exceeded & low[glide]
    out["integrity_misled"] = np.zeros((status.shape[0], 2), np.int64)
    out["integrity_delay"] = np.full((status.shape[0], 2), np.nan)
    for run, axis in np.argwhere(misled.any(axis=1)):
        found = stretches(asked, asked.time[glide], misled[run, :, axis], status[run] == ALARM)
        out["integrity_misled"][run, axis], out["integrity_delay"][run, axis] = found
    return out


def regions(asked: Asked, monitor: Snapshot, status: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Where in Stanford diagrams, horizontal and vertical, fixes with these errors (r, e, 2) lie (r, e, 2), by
    `REGIONS`; status (r, e)."""
    level = np.where(monitor.tested[:, None], monitor.levels, np.inf)
    level = np.where(np.isnan(level), np.inf, level)
    below = error <= level
    inside = np.where(below, NOMINAL, np.where(error <= asked.limits, MISLEADING, HAZARDOUS))
    # an error without a fix is no number, and beyond no level
    outside = np.where(error > level, UNAVAILABLE_MISLEADING, UNAVAILABLE)
    found = np.where((level <= asked.limits) & np.isfinite(level) & (status != NO_FIX)[..., None], inside, outside)
    return np.where((status == ALARM)[..., None], ALARMED, found)


def windows(time: np.ndarray, available: np.ndarray) -> np.ndarray:
    """How many stretches of `WINDOW` begin available, and in how many of those that does not last (r, 2); available
    (r, e)."""
    last = np.searchsorted(time, time + WINDOW + _EARLY, side="right") - 1
    whole = time + WINDOW <= time[-1] + _EARLY if time.size else np.zeros(0, bool)
    lost = np.concatenate([np.zeros((available.shape[0], 1), np.int64), np.cumsum(~available, axis=1)], axis=1)
    begun = available[:, whole]
    broken = lost[:, last[whole] + 1] - lost[:, np.flatnonzero(whole)] > 0
    return np.stack([begun.sum(axis=1), (begun & broken).sum(axis=1)], axis=1)


def stretches(asked: Asked, time: np.ndarray, misled: np.ndarray, alarm: np.ndarray) -> tuple[int, float]:
    """Of stretches of time (e,) in which an error is beyond its limit and its level is not: how many got no alarm
    within the time to alert, and the longest wait for one, s, inf where it was due and did not come, nan where none was
    due. One that lasts to the end, without an alarm, is not forgiven for being short."""
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


def described(draft: Draft, case: Case) -> None:
    """Levels by the geometry, which are the same in all runs, and their summary; nothing where nothing watches."""
    monitor = case.flight.monitor
    if monitor is None:
        return
    draft["/integrity/time"] = case.world.signals.time
    draft["/integrity/threshold"] = monitor.threshold
    levels = monitor.levels
    for i, name in enumerate(("hpl", "vpl")):
        draft[f"/integrity/{name}"] = levels[:, i]
    if isinstance(monitor, SeparationMonitor):
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
        values = levels[glide][there, i]
        numbers = np.full(5, np.nan)
        if values.size:
            numbers[:] = values.mean(), values.min(), values.max(), *np.percentile(values, [50, 95])
        draft[f"/summary/integrity/{name}"] = numbers
    asked = asked_of(case)
    if asked is not None:
        draft["/summary/integrity/hal"], draft["/summary/integrity/val"] = asked.limits
        draft["/summary/integrity/tta"] = asked.alert


def level_outputs(case: Case) -> dict[str, float]:
    """Levels on the glide for those who need no more, by the names that sweeps have for them."""
    draft = Draft(COVARIANCE)
    described(draft, case)
    out = {"level_share": float(draft["/summary/integrity/level_share"])}
    for name in ("hpl", "vpl"):
        numbers = draft[f"/summary/integrity/{name}"]
        out |= {f"{name}_p95": float(numbers[4]), f"{name}_max": float(numbers[2])}
    return out


def counted(draft: Draft, case: Case, ensemble: Ensemble) -> None:
    """What runs had of it; nothing where nothing watches."""
    if case.flight.monitor is None:
        return
    branch, runs = "/summary/integrity", ensemble.runs
    tested, alarms = ensemble.per_run("integrity_tested"), ensemble.per_run("integrity_alarms")
    draft[f"{branch}/tested"], draft[f"{branch}/alarms"] = np.int64(tested.sum()), np.int64(alarms.sum())
    draft[f"{branch}/alarm_share"] = share_over_runs(alarms, tested)
    if asked_of(case) is None:
        return
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
        draft[f"{branch}/hmi_{name}"] = share_interval(int(misled[:, i].sum()), runs)
        draft[f"{branch}/stanford_{name}"] = counts[i].astype(np.int64)
    draft[f"{branch}/hmi"] = share_interval(int(misled.any(axis=1).sum()), runs)
    draft[f"{branch}/time_to_alert"] = np.fmax.reduce(delay, axis=None)


def share_over_runs(count: np.ndarray, of: np.ndarray) -> np.ndarray:
    """A share of epochs (run,) of (run,) with the 95 % interval that runs have, for epochs of a run go together: value,
    low, high; nan without epochs. Where all runs are alike, that of so many runs in which no other was."""
    total = int(of.sum())
    if not total:
        return np.full(3, np.nan)
    value = float(count.sum()) / total
    if (count * total == of * count.sum()).all():
        return share_of_alike(value, count.size)
    # runs of unlike numbers of epochs: a ratio of means, its error by what is left of each
    reach = mean_interval((count - value * of) * (count.size / total))
    return np.array([value, max(0.0, value + reach[1]), min(1.0, value + reach[2])])


def share_of_alike(value: float, runs: int) -> np.ndarray:
    """A share of epochs that was the same in all of so many runs, or in the only one, with the 95 % interval: any other
    run may come, as rarely as none did."""
    _, _, rare = share_interval(0, runs)
    return np.array([value, value * (1.0 - rare), value + rare * (1.0 - value)])


def told(case: Case) -> list[str]:
    """What the user must hear of levels that are not there."""
    monitor, glide = case.flight.monitor, glide_of(case)
    if monitor is None or not glide.any():
        return []
    lacking = glide & ~np.isfinite(monitor.levels).all(axis=1)
    if not lacking.any():
        return []
    many = f"integrity: no protection level at {lacking.sum()} of {glide.sum()} epochs of the glide"
    if not isinstance(monitor, SeparationMonitor):
        return [f"{many}: a range is not checked by the others there, or there is no fix"]
    unmonitored = monitor.found.unmonitored[lacking]
    worst = int(np.argmax(unmonitored))
    there = monitor.found.monitored[:, np.flatnonzero(lacking)[worst]]
    unseen = (fault for fault, seen in zip(case.flight.expected, there, strict=True) if not seen)
    names = [f"{fault.name} {fault.prior:g}" for fault in unseen]
    section = case.scenario.integrity
    assert section is not None
    if unmonitored[worst] <= section.p_unmonitored_max:
        return [f"{many}: there is no fix"]
    what = f" ({', '.join(names[:5])}{', ...' if len(names) > 5 else ''})" if names else " (several at once)"
    return [
        f"{many}: what is not monitored{what} has the probability {unmonitored[worst]:.2g}; "
        f"integrity.p_unmonitored_max is {section.p_unmonitored_max:g}"
    ]
