"""Simulation of a landing, block by block as in figure 1 of the landing paper.

    route -> signal simulator with pseudolites -> receiver -> fix ┐
    route -> inertial sensors -> SINS ────────────────────────────┴-> Kalman filter -> accuracy

`shared_truth.SharedTruth` contains what all runs of a scenario share: the route, and the signals. `fly` simulates one
run. If the air moves each run off the route, `simulation.dispersed_trajectory` has its own trajectory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.filter.estimate import in_all_lanes, run_filter
from navsim.filter.measurement_kinds import FixTable, Measurements, RangeTable
from navsim.filter.records import (
    TIME_TOLERANCE,
    ErrorHistory,
    ImuData,
    Truth,
    by_epoch,
    empty_error_history,
)
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.geodesy.attitude import dcm_from_quaternion, roll_pitch_yaw
from navsim.gnss.receiver_fixes import ReceiverFixes
from navsim.integrity import monitoring
from navsim.integrity.exclusion import NOTHING
from navsim.integrity.gbas_station import HISTORY
from navsim.sensors.beacons import Beacons
from navsim.sensors.ground_stations import GroundStation
from navsim.simulation.filter_exclusion import after_exclusion
from navsim.simulation.flight import (
    Flight,
    initial_estimate,
    initial_state,
    with_clock,
)
from navsim.simulation.measurement_tables import (
    measurements,
    table_of_all_fixes,
    table_of_fixes,
    table_of_ranges,
)
from navsim.simulation.measurements import (
    filter_fixes,
    receiver_fixes,
    smoothed,
    stated_fixes,
)
from navsim.simulation.run import MonitorOutput, Run
from navsim.simulation.run_inputs import Inputs, Noise, Pushes, draw_inputs
from navsim.simulation.shared_truth import SharedTruth
from navsim.trajectory.dispersion import PathDeviation

LOOP_TOLERANCE = 0.01
"""Largest distance between the trajectory that a run flew and the one that guidance by its estimates gives, m."""


TOGETHER = 2
"""Flights of runs beside the same others."""


class Linear(Protocol):
    """Computes first-order errors of runs (`simulation.first_order`)."""

    def errors(self, flight: Flight, inputs: Inputs, ranges: np.ndarray) -> np.ndarray:
        """Errors (o, 6, W) of runs; ranges: (e, s, W) as the receiver uses them."""


def fly(
    flight: Flight,
    seed: int,
    runs: Sequence[int],
    measured: bool = True,
    first_order: Linear | None = None,
    predicts: Linear | None = None,
) -> Run:
    """At most WIDTH landings, see `fly_runs`. Raises ValueError for more."""
    if len(runs) > WIDTH:
        raise ValueError(f"1 to {WIDTH} runs can fly at once, not {len(runs)}")
    return next(fly_runs(flight, seed, runs, measured, first_order, predicts))


def fly_runs(
    flight: Flight,
    seed: int,
    runs: Sequence[int],
    measured: bool = True,
    first_order: Linear | None = None,
    predicts: Linear | None = None,
    pushes: Pushes | None = None,
) -> Iterator[Run]:
    """Landings numbered `runs` of the ensemble of `seed`, in order, WIDTH at a time.

    - measured: with their measurements.
    - first_order: computes their first-order errors, None if they are not requested.
    - predicts: computes the first-order errors that steer the first of their flights, None to begin along the route.
    - pushes: shifts what they draw, None to leave it.

    Aircraft that their estimates steer, or that an alarm breaks off, fly until the loop closes. Guidance acts on the
    past alone. So each flight is right until a later output of the filter than the one before, and one trajectory alone
    reproduces itself, after as many flights as there are outputs at the latest.
    Runs that need more than TOGETHER flights fly them beside those of other lanes."""
    packs, ways = [runs[i : i + WIDTH] for i in range(0, len(runs), WIDTH)], flight.shared.dispersion
    if ways is None or not ways.depends:
        for pack in packs:
            inputs = _drawn(flight, seed, pack, None, Noise.of(flight, seed, pack, pushes), pushes)
            yield _as_runs(flight, inputs, _filter(flight, inputs), len(pack), measured, first_order)
        return
    out: list[Run] = []
    still_open: list[_OpenRun] = []

    def flown(
        pack: Sequence[int], noise: Noise, departure: PathDeviation, flights: int
    ) -> tuple[Run, np.ndarray, PathDeviation]:
        """Runs of a pack, which of them have closed their loops, and the departures that their estimates command."""
        gap = np.full(WIDTH, np.inf)
        for last in reversed(range(flights)):
            inputs = _drawn(flight, seed, pack, departure, noise, pushes)
            filtered = _filter(flight, inputs)
            now = _commanded(flight, noise, len(pack), inputs, filtered)
            # a run whose loop is closed flies the same again, whoever flies beside it
            apart = np.abs(now.way[:, :3] - departure.way[:, :3]).reshape(-1, 3 * WIDTH)
            new = apart.max(axis=0).reshape(3, WIDTH).max(axis=0)
            gap = np.where(gap <= LOOP_TOLERANCE, gap, new)
            if last == 0 or gap.max() <= LOOP_TOLERANCE:
                break
            departure = departure.where(gap <= LOOP_TOLERANCE, now)
        made = _as_runs(flight, inputs, filtered, len(pack), measured, first_order)
        made = replace(made, loop_gap=gap[: len(pack), None]) if ways.steered else made
        return made, gap[: len(pack)] <= LOOP_TOLERANCE, now

    for number, pack in enumerate(packs):
        noise = Noise.of(flight, seed, pack, pushes)
        assert noise.departure is not None
        known = None
        if ways.steered and predicts is not None:
            known = ways.known(_predicted(flight, seed, pack, noise, predicts, pushes))
        made, closed, now = flown(pack, noise, ways.commanded(noise.departure, len(pack), known), TOGETHER)
        out.append(made)
        own = np.flatnonzero(~closed).tolist()
        still_open += [_OpenRun(number, i, noise.lane(i), now.lane(i), TOGETHER) for i in own]
        while len(still_open) >= WIDTH or (still_open and number == len(packs) - 1):
            now_open, still_open = still_open[:WIDTH], still_open[WIDTH:]
            pack = [packs[one.pack][one.place] for one in now_open]
            departure = PathDeviation.of_lanes([one.departure for one in now_open], WIDTH)
            made, closed, now = flown(pack, Noise.of_lanes([one.noise for one in now_open]), departure, 1)
            for lane, one in enumerate(now_open):
                if closed[lane] or one.flights > flight.shared.filter_time.size:
                    out[one.pack].put(one.place, made, lane)
                else:
                    still_open.append(replace(one, departure=now.lane(lane), flights=one.flights + 1))
    yield from out


@dataclass(frozen=True)
class _OpenRun:
    """A run whose loop is open: its pack and its place there, its draws, the departure to fly next, and its flights so
    far."""

    pack: int
    place: int
    noise: Noise
    departure: PathDeviation
    flights: int


def _drawn(
    flight: Flight, seed: int, runs: Sequence[int], departure: PathDeviation | None, noise: Noise | None,
    pushes: Pushes | None,
) -> Inputs:  # fmt: skip
    """Inputs of runs, see `draw`, with their pushes."""
    inputs = draw_inputs(flight, seed, runs, departure, noise)
    return inputs if pushes is None else pushes.inputs(runs, inputs)


def _commanded(flight: Flight, noise: Noise, count: int, inputs: Inputs, filtered: _Filtered) -> PathDeviation:
    """Departures that the estimates and alarms of so many runs command."""
    ways, known = flight.shared.dispersion, None
    assert ways is not None
    assert noise.departure is not None
    if ways.steered:  # a run's numbers lie side by side: sums over them have one order
        errors = _of_runs(filtered.errors.errors.error[:, states.POS : states.ATT], WIDTH)
        known = ways.known(errors.transpose(1, 2, 0))
    begin = ways.begins(_monitored(flight, inputs, filtered, WIDTH).alerts) if ways.breaks_off else None
    return ways.commanded(noise.departure, count, known, begin)


def _predicted(
    flight: Flight, seed: int, runs: Sequence[int], noise: Noise, linear: Linear, pushes: Pushes | None
) -> np.ndarray:
    """First-order errors (o, 6, W) of runs, which do not depend on the trajectory: along the route."""
    along = flight.along_route
    inputs = _drawn(along, seed, runs, None, noise, pushes)
    return linear.errors(along, inputs, smoothed(along.shared, inputs.ranges, inputs.phases))


NO_FIXES = FixTable(
    np.empty((0, 3, WIDTH)),
    np.empty((0, 3, WIDTH)),
    np.empty((0, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE, WIDTH)),
    np.zeros(3),
)
"""A table of fixes of lanes without any."""


_ROWS = 64
"""Numbers of a run that are taken out of its lane before those of the next: 4 kB of eight lanes."""


@kernel
def _runs_of_lanes(lanes: np.ndarray, runs: np.ndarray) -> None:
    """Runs (r, m) out of the first lanes of (m, W)."""
    count, numbers = runs.shape
    for first in range(0, numbers, _ROWS):
        for run in range(count):
            for row in range(first, min(first + _ROWS, numbers)):
                runs[run, row] = lanes[row, run]


def _of_runs(lanes: np.ndarray, count: int) -> np.ndarray:
    """The first `count` runs (r, ...) of lanes (..., W)."""
    runs = np.empty((count, *lanes.shape[:-1]))
    _runs_of_lanes(lanes.reshape(-1, WIDTH), runs.reshape(count, -1))
    return runs


@dataclass(frozen=True)
class _Filtered:
    """WIDTH landings after the filter, one in each SIMD lane."""

    nav: np.ndarray
    """(NAV, W) initial navigation states of the filter."""
    ranges: np.ndarray
    """(e, s, W) pseudoranges, m, as the receiver uses them."""
    fixes: ReceiverFixes
    tables: Measurements
    watched: MonitorOutput
    station: np.ndarray
    """(e, 8, W) see `Run`."""
    errors: ErrorHistory


def fly_inputs(flight: Flight, inputs: Inputs, count: int) -> Run:
    """Run the filter on these inputs; returns the first `count` landings without their measurements."""
    return _as_runs(flight, inputs, _filter(flight, inputs), count, measured=False, first_order=None)


def _filter(flight: Flight, inputs: Inputs) -> _Filtered:
    """Run the receiver, its monitor and the filter on these inputs."""
    shared, design = flight.shared, flight.design
    n = flight.covariance.shape[0]
    nav = with_clock(flight, initial_estimate(flight, inputs.initial, inputs.flown), inputs.clock)
    ranges, rates = smoothed(shared, inputs.ranges, inputs.phases), inputs.rates
    fixes = receiver_fixes(shared, ranges, rates)
    antenna = in_all_lanes(shared.signals.antenna) if inputs.flown is None else inputs.flown.antenna
    station = _station_output(flight, inputs, ranges, fixes.llh, antenna)
    watched = MonitorOutput.of_fixes(flight, antenna, ranges, fixes).after_exclusion(
        flight, antenna, ranges, rates, fixes
    )
    if inputs.stated is not None and design.flag_sigma is not None:
        fixes = stated_fixes(shared, fixes, inputs.stated, design.flag_sigma, inputs.flown)
    llh, velocity, _, cov = fixes
    if design.tight:
        own: RangeTable | FixTable = table_of_ranges(flight, watched.trusted(flight, ranges), rates)
    else:
        if shared.signals.filter_fix_sigma is not None:
            position, speed, _, cov = filter_fixes(shared, ranges, rates)
        else:
            position, speed = llh, velocity
        if flight.drops:
            dropped = (watched.status == monitoring.ALARM)[:, None]
            position, speed = np.where(dropped, np.nan, position), np.where(dropped, np.nan, speed)
        if inputs.stated is not None:
            unused = inputs.stated.unused(design.flag_sigma)[:, None]
            position, speed = np.where(unused, np.nan, position), np.where(unused, np.nan, speed)
            table = table_of_fixes(design, position, speed, cov)
        else:
            table = table_of_all_fixes(flight, position, speed, cov)
        for candidate in np.unique(watched.excluded[watched.excluded != NOTHING]).astype(int):
            mine = watched.excluded == candidate
            made = table_of_all_fixes(flight.without(candidate), position, speed, cov)
            for all_fixes, without in zip(table[:3], made[:3], strict=True):
                np.copyto(all_fixes, without, where=mine.reshape(len(mine), *[1] * (all_fixes.ndim - 2), -1))
        own = table
    tables = measurements(flight, own, inputs.aided)

    def fly(tables: Measurements) -> ErrorHistory:
        errors = empty_error_history(
            _truth(shared, inputs), n, flight.events.time.size, WIDTH,
            single=n - 3 * len(states.slices(design.sensors.blocks)), innovations=flight.bank is not None,
        )  # fmt: skip
        start_, imu = initial_state(flight, nav, in_all_lanes(flight.covariance)), (inputs.dtheta, inputs.dv)
        run_filter(ImuData(shared.imu_time, *imu), tables, flight.events, start_, flight.model, errors)
        return errors

    errors = fly(tables)
    if flight.bank is not None:
        watched = MonitorOutput.of_filter(flight, flight.bank, errors, fixes, ranges, rates)
        if flight.watching is not None and flight.watching.exclusion != monitoring.NO_EXCLUSION:
            watched = after_exclusion(
                flight, watched, errors, (fixes, ranges, rates), inputs.aided,
                lambda aided: fly(measurements(flight, own, aided)),
            )  # fmt: skip
    return _Filtered(nav, ranges, fixes, tables, watched, station, errors)


def _station_output(
    flight: Flight, inputs: Inputs, ranges: np.ndarray, llh: np.ndarray, antenna: np.ndarray
) -> np.ndarray:
    """`Run.station` (e, 8, W) of fixes llh (e, 3, W) from ranges (e, s, W); antenna: (e, 3, W) true, ECEF, m."""
    station = flight.station
    if station is None or inputs.b_values is None:
        return np.empty((0, len(HISTORY), WIDTH))
    differences = np.zeros((llh.shape[0], 2, WIDTH))
    if station.station.two_smoothings:
        assert inputs.phases is not None
        differences = station.smoothing_differences(ranges, inputs.ranges, inputs.phases)
    return station.of_fixes(inputs.b_values, differences, llh, antenna, flight.shared.antenna_enu)


@dataclass(frozen=True)
class _Monitored:
    """Events and monitor status of runs."""

    of_events: dict[str, np.ndarray]
    """See `_of_events`."""
    status: np.ndarray
    """(r, e) status of the monitor."""
    ratio: np.ndarray
    """(r, e) see `Run.innovation_ratio`."""

    @property
    def alerts(self) -> np.ndarray:
        """(e, r) whether the user is alerted."""
        return monitoring.alerted(self.status).T


def _monitored(flight: Flight, inputs: Inputs, filtered: _Filtered, count: int) -> _Monitored:
    """Events and monitor status of the first `count` runs."""
    errors = filtered.errors
    of_events = _of_events(
        flight, [_of_runs(m, count) for m in inputs.aided], _of_runs(errors.innovation_squared, count),
        _of_runs(errors.degrees, count).astype(np.int64), _of_runs(errors.status, count).astype(np.int64),
    )  # fmt: skip
    status, ratio = _of_runs(filtered.watched.status, count).astype(np.int64), np.empty((count, 0))
    if flight.watching is not None and flight.watching.innovations is not None:
        squared, degrees = _with_transmitters(flight, of_events)
        ratio = flight.watching.innovations.ratio(flight.shared.signals.time, squared, degrees)
        # stations guide without fixes, too
        guided = any(isinstance(aid.sensor, GroundStation) for aid in flight.shared.aids)
        status = np.where((ratio > 1.0) & (guided | (status != monitoring.NO_FIX)), monitoring.ALARM, status)
    return _Monitored(of_events, status, ratio)


def _with_transmitters(flight: Flight, of_events: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Innovations squared and their degrees (r, e) of fixes, or ranges, together with those of beacons and ground
    stations since the epoch before."""
    degrees = of_events["degrees"].copy()
    squared, first = np.where(degrees > 0, of_events["innovation_squared"], 0.0), 0
    for aid in flight.shared.aids:
        its = slice(first, first + aid.time.size)
        first = its.stop
        if isinstance(aid.sensor, (Beacons, GroundStation)):
            epoch = np.searchsorted(flight.shared.filter_time[1:], aid.arrival - TIME_TOLERANCE)
            some = epoch < degrees.shape[1]
            count, square = of_events["aided_degrees"][:, its], of_events["aided_squared"][:, its]
            np.add.at(degrees.T, epoch[some], count[:, some].T)
            np.add.at(squared.T, epoch[some], np.where(count > 0, square, 0.0)[:, some].T)
    return squared, degrees


def _as_runs(
    flight: Flight, inputs: Inputs, filtered: _Filtered, count: int, measured: bool, first_order: Linear | None
) -> Run:
    """The first `count` landings, with their measurements and first-order errors if requested."""
    shared, design, nav, watched, errors = flight.shared, flight.design, filtered.nav, filtered.watched, filtered.errors
    llh, velocity, clocks, _ = filtered.fixes
    linear = None if first_order is None else first_order.errors(flight, inputs, filtered.ranges)

    def of_runs(lanes: np.ndarray) -> np.ndarray:
        return _of_runs(lanes, count)

    def of_signals(lanes: np.ndarray) -> np.ndarray:
        return of_runs(lanes) if measured else np.empty((count, 0, 0))

    of_filter = filtered.tables.fixes if measured and not design.tight else NO_FIXES
    none = np.empty((0, 3, WIDTH))
    own = {"deviation": none, "attitude": none, "antenna": none, "gust": none}
    none = np.empty((0, WIDTH))
    stated = inputs.stated
    for name in ("state", "flag"):
        own[f"fix_{name}"] = none if stated is None else getattr(stated, name).astype(float)
    own |= {"touchdown": none, "go_around": none}
    if inputs.flown is not None and shared.dispersion is not None:
        flown = inputs.flown
        own |= {"deviation": flown.deviation, "attitude": flown.rpy, "antenna": flown.antenna, "gust": flown.gust}
        ends = shared.dispersion.endings(flown)
        own["touchdown"] = ends.touchdown
        if shared.dispersion.breaks_off:
            own["go_around"] = ends.go_around
    monitored = _monitored(flight, inputs, filtered, count)
    return Run(
        of_signals(filtered.ranges), of_signals(inputs.rates), of_runs(llh), of_runs(velocity), of_runs(clocks),
        of_runs(errors.errors.error), of_runs(errors.sigma), of_runs(errors.cross),
        of_runs(errors.errors.nees), of_runs(errors.errors.nees_position_velocity),
        of_runs(errors.errors.nees_group),
        **monitored.of_events,
        monitor_statistic=of_runs(watched.statistic), monitor_status=monitored.status, innovation_ratio=monitored.ratio,
        watched_error=of_runs(watched.error), monitor_excluded=of_runs(watched.excluded).astype(np.int64),
        monitor_level=of_runs(watched.level),
        station=of_runs(filtered.station),
        **{name: of_runs(lanes) for name, lanes in own.items()},
        delta_angle=of_signals(inputs.dtheta), delta_velocity=of_signals(inputs.dv),
        start_llh=of_runs(nav[states.NAV_LLH : states.NAV_VEL]),
        start_velocity=of_runs(nav[states.NAV_VEL : states.NAV_QUAT]),
        start_rpy=roll_pitch_yaw(dcm_from_quaternion(of_runs(nav[states.NAV_QUAT : states.NAV_BIAS_FRAME]))),
        filter_fix_llh=of_runs(of_filter.llh), filter_fix_velocity=of_runs(of_filter.velocity),
        filter_fix_covariance=of_runs(of_filter.covariance),
        clipped=of_runs(inputs.clipped).astype(np.int64) if flight.limited else np.empty((count, 0), np.int64),
        first_order=np.empty((count, 0, 3)) if linear is None else of_runs(linear[:, states.SLICES["position"]]),
        loop_gap=np.empty((count, 0)),
    )  # fmt: skip


def _truth(shared: SharedTruth, inputs: Inputs) -> Truth:
    """True values for the errors of runs."""
    route, flown = shared.at_filter, inputs.flown
    if flown is not None:
        return Truth(flown.llh, flown.velocity, flown.quaternion, inputs.sensors)
    llh, velocity, quaternion = (in_all_lanes(m) for m in (route.llh, route.velocity_ned, route.quaternion))
    return Truth(llh, velocity, quaternion, inputs.sensors)


def _of_events(
    flight: Flight, aided: Sequence[np.ndarray], squared: np.ndarray, degrees: np.ndarray, status: np.ndarray
) -> dict[str, np.ndarray]:
    """History of the fixes and of the sensors beside the receiver.

    aided: (r, m, k) of each; squared, degrees, status (r, k): of all events.
    """
    aids = np.concatenate([np.empty(0, np.int64), *(flight.events.rows(a.sensor.kind) for a in flight.shared.aids)])
    measured = np.full((squared.shape[0], aids.size, MAX_MEASUREMENT_SIZE), np.nan)
    first = 0
    for numbers in aided:
        measured[:, first : first + numbers.shape[1], : numbers.shape[2]] = numbers
        first += numbers.shape[1]
    of_events = {"squared": squared, "degrees": degrees, "status": status}
    # a run's numbers lie side by side, as they do when it flies alone: sums over them have one order
    of_fixes = {name: np.ascontiguousarray(values) for name, values in _of_epochs(flight, of_events).items()}
    of_aids = {f"aided_{name}": np.ascontiguousarray(values[:, aids]) for name, values in of_events.items()}
    return {
        "innovation_squared": of_fixes["squared"], "degrees": of_fixes["degrees"], "status": of_fixes["status"],
        "range_status": of_fixes["range_status"],
        "aided": measured, **of_aids,
    }  # fmt: skip


def _of_epochs(flight: Flight, of_events: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Innovations squared, degrees and status of each epoch (r, e), from those of all events (r, k), and range_status
    (r, e, s), see `records.by_epoch`."""
    weighed = flight.event_of_measurement
    if not flight.design.tight:
        of_fixes = {name: values[:, weighed[:, 0]] for name, values in of_events.items()}
        return {**of_fixes, "range_status": np.empty((*of_fixes["status"].shape, 0), np.int64)}
    names = ("squared", "degrees", "status", "range_status")
    return dict(zip(names, by_epoch(weighed, *(of_events[name] for name in names[:3])), strict=True))
