"""Estimates of studies over many scenarios, and of recorded flights."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from navsim.gnss.receiver import epochs
from navsim.gnss.signals import Environment
from navsim.results.schema import MOST_LEVELS
from navsim.scenario.filter import SMOOTHERS
from navsim.scenario.landing import Landing
from navsim.scenario.load import read
from navsim.scenario.optimize import DOP_OBJECTIVES, Optimize
from navsim.scenario.shipped import path
from navsim.scenario.sweep import FILTER_OUTPUTS
from navsim.study import integrity_table, optimize, replay, table2
from navsim.study.analyses import COARSE_FIXES, COARSE_IMU, SCREENED
from navsim.study.budget.estimate import (
    AXIS,
    BASE_MEMORY,
    BASE_TIME,
    BATCH_FILE,
    NUMBER,
    VARIABLE,
    WRITING,
    Budget,
)  # fmt: skip
from navsim.study.budget.landing import (
    ANALYSED_MEMORY,
    FIX_TIME,
    SAMPLE_MEMORY,
    SAMPLE_TIME,
    SIGHT_TIME,
    SIGNAL_MEMORY,
    STATISTICS,
    Extent,
    analysis_time,
    bank_time,
    extent,
    landing,
    prepared,
    run_time,
    shared_memory,
    sums_bytes,
    times_as_long,
)  # fmt: skip
from navsim.study.ensemble import BATCH
from navsim.study.landing.ensemble import HISTORIES, history_bytes
from navsim.study.objective import PlacementProblem
from navsim.study.search import CHUNK, COARSE, FULL, GEOMETRY, LEVELS
from navsim.study.sources import environment, glide_epochs
from navsim.study.sweep import MOST_MAP_SITES, Axis, Plan, columns

_WIDTHS = 100
"""Values of an axis that are written to see how long they are."""
_SAMPLED = 20
"""Combinations of a sweep that are looked at for its sizes."""
_PLACEMENT_TIME, _POINT_TIME = 0.6e-3, 25e-9
"""Seconds a placement of a sweep, and a placement at an epoch in the kernel."""
_OUTPUT_WIDTH = 12
"""Characters of an output in the table of a sweep."""
_TEXTS = 6400
"""Scenario and study in the attributes of a result, bytes."""
_JUDGED_MEMORY = 70
"""A site of a placement at an epoch while rules are judged, bytes."""
_LEVEL_TIME = 1e-6
"""Seconds a source of signals at an epoch when the levels of a subset of them are computed."""
_LEVEL_MEMORY = 200
"""A pair of sources at an epoch then, bytes."""
_READ_MEMORY = 600
"""A sample or fix of a recording while it is read and judged, bytes."""
_SPAN_MEMORY = 400
"""An outage, bytes."""
_REPLAYED_MEMORY = 3000
"""An output or fix of a replayed flight, bytes."""


def sweep(planned: Plan, workers: int, away: bool = False, confirming: int = 0) -> Budget:
    """All combinations of a study. Sizes are those of combinations spread over it that are valid. away: whether the
    workers have memory of their own. confirming: runs of the best for each error of the filter."""
    names = columns(planned)
    keys = sum(len(axis.keys) for axis in planned.axes)
    of_one = NUMBER * (len(names) + 2 * MOST_MAP_SITES)
    axes = sum(len(axis.points) * (len(axis.keys) + 1) for axis in planned.axes)
    variables = len(names) + keys + len(planned.axes) + 14
    row = _OUTPUT_WIDTH * len(names) + sum(_width(axis, i) for axis in planned.axes for i in range(len(axis.keys)))
    table = planned.size * row
    file = planned.size * of_one + NUMBER * (axes + 600) + variables * VARIABLE + _TEXTS
    file += len(names) * (len(planned.axes) - 1) * AXIS
    workers = max(1, min(workers, -(-planned.size // planned.batch)))
    memory, time = 0.0, 0.0
    if planned.geometry_alone:
        scenario = planned.first[0]
        here, glide = extent(scenario, planned.sources), _glide(scenario)
        time = SIGHT_TIME * glide * here.sources + planned.size * (_PLACEMENT_TIME + 2.0 * _POINT_TIME * glide)
        memory = SIGNAL_MEMORY * here.epochs * here.sources
    else:
        scenarios = planned.spread(_SAMPLED)
        costs = [_combination(planned, scenario) for scenario in scenarios]
        time = planned.size / workers * sum(cost.time_s for cost in costs) / len(costs)
        if confirming:
            errors = sum(name in FILTER_OUTPUTS for name in names)
            time += errors * confirming * max(run_time(each, extent(each, planned.sources)) for each in scenarios)
        memory = 0.0 if away else workers * max(cost.memory_bytes for cost in costs)
    batches = -(-planned.size // planned.batch)
    return Budget(
        BASE_TIME + time,
        BASE_MEMORY + memory + (2.0 + WRITING) * file + 6 * table + 200 * axes,
        file + table,
        planned.size * of_one + batches * BATCH_FILE if batches > 1 else 0.0,
    )


def _width(axis: Axis, number: int) -> float:
    """Mean width of the values of a key in the table, characters."""
    some = axis.points[:: max(len(axis.points) // _WIDTHS, 1)]
    return 1.0 + sum(len(_written(point[number])) for point in some) / len(some)


def _written(value: Any) -> str:
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def _combination(planned: Plan, scenario: Landing) -> Budget:
    """What one combination takes beside the process itself."""
    here = extent(scenario, planned.sources)
    study = planned.study
    if study.method == "monte-carlo":
        runs = study.runs
        sums = -(-runs // BATCH) * sums_bytes(here)
        time, memory = runs * run_time(scenario, here), float(3 * STATISTICS * runs + sums)
    elif study.method == "covariance":
        time, memory = analysis_time(here), float(ANALYSED_MEMORY * here.epochs)
    else:
        time, memory = 0.0, 0.0
    return Budget(prepared(here) + time, shared_memory(here) - BASE_MEMORY + memory, 0.0)


def posing(study: Optimize, scenario: Landing, sources: Environment) -> Budget:
    """What a search for placements takes but for its time, which is told by `search_time` once it is posed."""
    here = extent(scenario, sources)
    starts = 1 if study.period is None else study.period.count
    most = max(study.counts)
    # a map is judged at one go, choices of sites in chunks
    at_once = {k: min(math.comb(len(study.sites), k), CHUNK) if study.sites else 0 for k in study.counts}
    judged_places = max(k * max(optimize.MAP_POINTS**2, at_once[k]) for k in study.counts)
    signals = SIGNAL_MEMORY * here.epochs * here.sources * starts
    ruled = study.constraints.distance_m is not None or study.constraints.near_far_db is not None
    judged = _JUDGED_MEMORY * judged_places * _glide(scenario) * ruled
    result = NUMBER * len(study.counts) * (optimize.MAP_POINTS**2 + 30 * most) + 46 * VARIABLE
    flown = 0.0
    if study.objective not in DOP_OBJECTIVES or study.constraints.requirements:
        flown = 2.0 * SAMPLE_MEMORY * here.samples + ANALYSED_MEMORY * here.epochs
    return Budget(
        BASE_TIME + SIGHT_TIME * starts * here.epochs * here.sources,
        BASE_MEMORY + signals + judged + flown,
        result,
    )


def _glide(scenario: Landing) -> int:
    """Epochs of the glide, by which placements are judged."""
    return int(glide_epochs(scenario, scenario.trajectory())[1].sum())


def _whole(here: PlacementProblem) -> Extent:
    """The base scenario with the most pseudolites."""
    case = here.scenario
    fixes = case.receiver.model().epochs(case.duration_s, case.imu.rate_hz).size
    samples = epochs(case.duration_s, case.imu.rate_hz).size
    followed = case.filter.states(1, case.gain_states + case.height_states)
    return Extent(samples, fixes, 24 + max(here.study.counts), 1, followed, 0, 0.0, 0, 0)


def search_time(here: PlacementProblem) -> float:
    """The most time a search takes, s."""
    case, whole = here.scenario, _whole(here)
    points = len(here.geometry.receiver)
    fixes, heard = whole.epochs, whole.sources
    rough = replace(whole, samples=int(case.duration_s * COARSE_IMU), epochs=int(case.duration_s * COARSE_FIXES))
    full, coarse = (0.0, 0.0) if here.quick else (analysis_time(whole), analysis_time(rough))
    levels = 0.0
    if case.integrity is not None and (here.quick or here.requirements is not None):
        # solution separation has a fix for each fault, and one for most sources
        subsets = heard * (heard if case.integrity.method == "mhss" else 1)
        full += SIGHT_TIME * fixes * heard + _LEVEL_TIME * points * subsets
        coarse += SIGHT_TIME * fixes * heard + _LEVEL_TIME * min(points, MOST_LEVELS) * subsets
        levels = _LEVEL_TIME * SCREENED * subsets
    cost = {GEOMETRY: 4.0 * points * _POINT_TIME, FULL: full, COARSE: coarse, LEVELS: levels}
    return sum(cost[way] * most for step in optimize.planned(here) for way, most in step.most.items())


def confirming_time(here: PlacementProblem, runs: int) -> float:
    """Time to fly the best placement of each number of pseudolites, s."""
    scenario = here.scenario
    return len(here.study.counts) * runs * run_time(scenario, _whole(here)) if runs else 0.0


def tables(runs: int, workers: int) -> Budget:
    """Table 2 of the paper: every row under every calibration."""
    time, memory, points = 0.0, 0.0, 0
    for calibration in table2.CALIBRATIONS:
        scenario, document = read(path(calibration.name), table2.ROWS[-1].assignments())
        sources, scenario, _ = environment(scenario, document)
        here = extent(scenario, sources)
        for i in range(len(table2.ROWS)):
            keep = "errors" if i in table2.CURVES else "none"
            one = landing(scenario, sources, runs, keep, workers)
            time += one.time_s - BASE_TIME
            # no partial work is kept: histories stay in memory
            held = runs * sum(history_bytes(name, here.sizes()) for name in HISTORIES[keep])
            sums = -(-runs // BATCH) * sums_bytes(here)
            memory = max(memory, shared_memory(here) + held + sums + 3 * STATISTICS * runs)
        points = max(points, here.epochs)
    result = NUMBER * points * (1 + 2 * len(table2.CURVES)) + 10_000 + 44 * VARIABLE
    return Budget(BASE_TIME + time, memory + WRITING * result, result)


def levels_of_subsets(scenario: Landing, sources: Environment) -> Budget:
    """What is possible by rank, and the levels of subsets of the satellites in an approach."""
    here = extent(scenario, sources)
    levels = integrity_table.CELLS * integrity_table.MOST_SUBSETS * MOST_LEVELS * here.sources
    separated = scenario.integrity is not None and scenario.integrity.method != "chi2"
    banks = integrity_table.CELLS * integrity_table.MOST_SUBSETS_OF_FILTERS if here.filters else 0
    result = _TEXTS + NUMBER * MOST_LEVELS + (20 if separated else 18) * VARIABLE
    return Budget(
        BASE_TIME + prepared(here) + (banks * bank_time(here) if banks else _LEVEL_TIME * levels),
        shared_memory(here) + _LEVEL_MEMORY * MOST_LEVELS * here.sources**2 + WRITING * result,
        result,
    )


def recorded(recording: replay.Recording) -> Budget:
    """A recorded flight that was read and aligned."""
    samples, fixes = recording.samples.time.size, recording.fixes.time.size
    lasts = float(recording.samples.time[-1]) - recording.alignment.time
    rate = recording.scenario.filter.output_rate_hz
    outputs = fixes + 1.0 if rate == "fixes" else lasts * rate
    outages = sum(len(outage.start_s) * len(outage.duration_s) for outage in recording.scenario.outages)
    once = SAMPLE_TIME * samples + FIX_TIME * fixes
    section = recording.scenario.filter
    longer = times_as_long(section.kind, section.gaussian_sum.components)
    time = once * (replay.extent(recording) + longer * outages) + longer * (once + SAMPLE_TIME * outputs)
    smoothed = 3.0 if recording.scenario.filter.kind in SMOOTHERS else 1.0
    result = NUMBER * (31 * outputs + 23 * fixes + 5 * outages) + 44 * VARIABLE
    memory = (
        _READ_MEMORY * (samples + fixes)
        + _SPAN_MEMORY * outages
        + smoothed * _REPLAYED_MEMORY * (outputs + fixes)
        + WRITING * result
    )
    return Budget(BASE_TIME + time, BASE_MEMORY + memory, result)
