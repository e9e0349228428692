"""What becomes of runs that leave their route: total system errors, indicated deviations, touchdowns, go-arounds.

Equations: `docs/theory/air.md`, sections 6 and 7.
"""

from __future__ import annotations

import numpy as np

from navsim.geodesy import earth
from navsim.geodesy.indicator import Indicator, foot_of
from navsim.landing.case import PERCENTILES, Case, crossing_times
from navsim.landing.integrity import glide_of
from navsim.results.builder import ResultBuilder
from navsim.results.schema import INDICATED, RUNWAY_AXES
from navsim.runner.batches import Ensemble
from navsim.runner.checkpoint import Arrays
from navsim.runner.statistics import mean_interval, rms_interval, share_interval
from navsim.scenario.approach import FileApproach
from navsim.scenario.guidance import IndicatorSection
from navsim.scenario.landing import Landing
from navsim.scenario_files.base import DEG
from navsim.simulation.run import Run
from navsim.trajectory.approach import TOUCHDOWN

FULL, HALF = 1.0, 0.5
"""Full scale of an indicator, and half of it."""


def indicator_of(scenario: Landing) -> IndicatorSection | None:
    """The indicator of the deviations that pilots see, None for none."""
    return getattr(scenario.approach, "indicator", None)


def scales_of(case: Case) -> Indicator | None:
    """The scales of the indicator."""
    section, approach = indicator_of(case.scenario), case.scenario.approach
    if section is None:
        return None
    assert not isinstance(approach, FileApproach)
    runway, angle = case.scenario.runway, approach.glide_slope_deg * DEG
    path, time = case.trajectory.path, case.shared.filter_time
    # the glide may begin after the end of the flight
    jet = path.jet(np.append(time, np.arange(time[-1], path.events.get(TOUCHDOWN, 0.0), 0.5)))
    foot = foot_of(jet[:, 0], jet[:, 1], angle)
    return Indicator(section.origin_m(runway), runway.aim_point_m, section.course_width_m, angle, section.share, foot)


def judged_outputs(case: Case, shown: Indicator) -> np.ndarray:
    """Outputs (o,) bool at which deviations count: from where the route is established on course and glide path down
    to `until_height_m`."""
    section, time = indicator_of(case.scenario), case.shared.filter_time
    assert section is not None
    route = case.trajectory.path.jet(time)[:, 0]
    judged = np.isin(time, case.shared.signals.time[glide_of(case)] + case.scenario.receiver.latency_s)
    judged &= -route[:, 2] >= section.until_height_m
    judged[judged] = shown.established(route[judged])
    return judged


def of_runs(case: Case, runs: Run, total: np.ndarray, of_estimate: np.ndarray) -> Arrays:
    """Numbers of each of several runs; total, of_estimate: deviations (run, o, 3) of aircraft and of their estimates
    from the route."""
    out: Arrays = {"touchdown": runs.touchdown}
    if case.shared.dispersion is not None and case.shared.dispersion.breaks_off:
        out["go_around"] = runs.go_around
    shown = scales_of(case)
    if shown is None:
        return out
    time, both = case.shared.filter_time, []
    route, judged = case.trajectory.path.jet(time)[:, 0], judged_outputs(case, shown)
    for off in (total, of_estimate):
        seen, here = shown.along_route(route, off), judged
        if "go_around" in out:
            here = judged & ~(time >= out["go_around"][:, :1])
        both.append(np.where(np.broadcast_to(here, seen.shape[:2])[..., None], np.abs(seen), -np.inf).max(axis=1))
    largest = np.stack(both, axis=2)
    out["indicated"] = np.where(np.isfinite(largest), largest, np.nan)
    return out


def went_around(ensemble: Ensemble, until: float = np.inf) -> np.ndarray:
    """Which runs (r,) have begun a go-around before a time, s."""
    if "go_around" not in ensemble.columns():
        return np.zeros(ensemble.runs, bool)
    return np.asarray(ensemble.per_run("go_around")[:, 0] < until)


def went_around_at_heights(case: Case, ensemble: Ensemble) -> np.ndarray:
    """Which runs have begun a go-around before they pass the heights, (r, h) bool."""
    return np.stack([went_around(ensemble, when) for when in crossing_times(case)], axis=1)


def put_total_errors(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    """Write the total system errors, and the ends of the runs; nothing if all fly the route."""
    if case.shared.dispersion is None:
        return
    at, technical = ensemble.per_run("at_height"), ensemble.per_run("at_deviation")
    times = np.array(crossing_times(case))
    gone = went_around_at_heights(case, ensemble)
    technical = np.where(gone[..., None], np.nan, technical)
    for i, name in enumerate(RUNWAY_AXES):
        for kind, values in (("fte", technical[..., i]), ("tse", technical[..., i] + at[..., i])):
            draft[f"/summary/at/{name}_{kind}_run"] = values
            draft[f"/summary/at/{name}_{kind}"] = np.stack([_rms(column) for column in values.T])
        draft[f"/summary/at/{name}_tse_percentile"] = np.stack([_percentiles(column) for column in values.T])
    _put_indicated(draft, case, ensemble, times, technical)
    _put_touchdown(draft, case, ensemble)
    if case.shared.dispersion.breaks_off:
        _put_go_arounds(draft, ensemble)


def runs_beyond(largest: np.ndarray, limit: float) -> tuple[int, int]:
    """How many runs deviate beyond a limit, and how many have a deviation; nan (r,): a run that goes around before."""
    known = _known(largest)
    return int((known > limit).sum()), known.size


def _known(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def _rms(values: np.ndarray) -> np.ndarray:
    """Root mean square (3,) with its interval, of runs with a value; all of them where none has gone around."""
    known = _known(values)
    return rms_interval((known if known.size else values)[:, None] ** 2)


def _percentiles(values: np.ndarray) -> np.ndarray:
    known = _known(values)
    return np.percentile(np.abs(known), PERCENTILES) if known.size else np.full(len(PERCENTILES), np.nan)


def _put_indicated(
    draft: ResultBuilder, case: Case, ensemble: Ensemble, times: np.ndarray, technical: np.ndarray
) -> None:
    """Write the deviations that pilots see; technical: (run, h, 3) deviations of the estimate at the heights."""
    shown = scales_of(case)
    if shown is None:
        return
    for name in ("origin", "aim", "width", "angle", "share", "foot"):
        draft[f"/summary/indicator/scale_{name}"] = getattr(shown, name)
    draft["/summary/indicator/touchdown_llh"] = earth.llh_from_ecef(case.trajectory.frame.origin)
    judged = case.shared.filter_time[judged_outputs(case, shown)]
    ends = (judged[0], judged[-1]) if judged.size else (np.nan, np.nan)
    draft["/summary/indicator/from_time"], draft["/summary/indicator/until_time"] = ends
    route = np.full((times.size, 3), np.nan)
    passed = np.isfinite(times)
    route[passed] = case.trajectory.path.jet(times[passed])[:, 0]
    total = technical + ensemble.per_run("at_height")
    for kind, off in (("", total), ("_indicated", technical)):
        seen = shown.along_route(route, off)
        for i, name in enumerate(INDICATED):
            draft[f"/summary/at/{name}{kind}_run"] = seen[..., i]
            draft[f"/summary/at/{name}{kind}"] = np.stack([_rms(column) for column in seen[..., i].T])
    largest, branch = ensemble.per_run("indicated"), "/summary/indicator"
    for i, name in enumerate(INDICATED):
        for j, kind in enumerate(("", "_indicated")):
            values = largest[:, i, j]
            draft[f"{branch}/{name}{kind}_largest_run"] = values
            draft[f"{branch}/{name}{kind}_percentile"] = _percentiles(values)
            for limit, of in ((HALF, "half"), (FULL, "full")):
                beyond, judged = runs_beyond(values, limit)
                share = share_interval(beyond, judged) if judged else np.full(3, np.nan)
                draft[f"{branch}/{name}{kind}_beyond_{of}"] = share


def _put_touchdown(draft: ResultBuilder, case: Case, ensemble: Ensemble) -> None:
    """Write where runs touch down."""
    values, branch = ensemble.per_run("touchdown"), "/summary/touchdown"
    landed = np.isfinite(values[:, 0])
    draft[f"{branch}/landed"] = np.int64(landed.sum())
    along = values[:, 1] + case.scenario.runway.aim_point_m
    for name, column in (
        ("time", values[:, 0]),
        ("along", along),
        ("lateral", values[:, 2]),
        ("sink_rate", values[:, 3]),
    ):
        draft[f"{branch}/{name}_run"] = column
        draft[f"{branch}/{name}"] = mean_interval(column[landed]) if landed.any() else np.full(3, np.nan)
        sigma = float(np.std(column[landed], ddof=1)) if landed.sum() > 1 else np.nan
        draft[f"{branch}/{name}_sigma"] = sigma


def _put_go_arounds(draft: ResultBuilder, ensemble: Ensemble) -> None:
    """Write how many runs go around, and the height that they lose."""
    values, branch, runs = ensemble.per_run("go_around"), "/summary/go_around", ensemble.runs
    gone = np.isfinite(values[:, 0])
    lost = values[:, 1] - values[:, 2]
    for name, column in (("time", values[:, 0]), ("height", values[:, 1]), ("lowest", values[:, 2]), ("lost", lost)):
        draft[f"{branch}/{name}_run"] = column
    draft[f"{branch}/count"] = np.int64(gone.sum())
    draft[f"{branch}/share"] = share_interval(int(gone.sum()), runs)
    draft[f"{branch}/touched"] = np.int64((values[gone, 2] <= 0.0).sum())
    draft[f"{branch}/lost_percentile"] = _percentiles(lost)
    draft[f"{branch}/lost_largest"] = float(lost[gone].max()) if gone.any() else np.nan
