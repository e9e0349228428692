"""A recorded flight through the filter: increments from samples, fixes as they arrived, nothing simulated.

A late fix is used at its time of validity, and the output at each time uses what was known then: see
`filter.filter_loop`. Across missing samples, the motion is interpolated with a corresponding process noise; the
smoother runs across them.

A flight has several parts if the filter cannot continue: samples are missing for longer than the attitude survives, or
the filter contradicts its fixes for so long that it is lost. Each part starts anew, and is filtered or smoothed
separately.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from navsim.filter import states
from navsim.filter.design import FilterDesign
from navsim.filter.estimate import FILTER_KINDS, estimate, is_smoother, lost
from navsim.filter.measurement_kinds import (
    FIX,
    MONITOR_ONLY_FIX,
    RANGE,
    BeaconTable,
    FixTable,
    Measurements,
    RangeTable,
    VehicleTable,
)
from navsim.filter.records import (
    NOT_USED,
    REJECTED,
    Events,
    History,
    ImuData,
    by_epoch,
    schedule,
    start,
)
from navsim.formats.recorded_data import Ranges
from navsim.geodesy import earth
from navsim.geodesy.attitude import dcm_from_quaternion, roll_pitch_yaw
from navsim.replays.aids import merge_aids
from navsim.replays.alignment import Alignment
from navsim.replays.flight_tables import fix_covariance, noise_of, noise_of_fixes, start_of, table_of
from navsim.replays.recorded_flight import PartStart, RecordedFlight

CONTRADICTED, LEAST_REJECTED = 0.75, 3
"""Share of the fixes, and their number, that a filter rejects which contradicts them."""
RETURNED = 0.5
"""Two jumps cancel where their sum is below this share of the larger one."""
RELAPSE = 60.0
"""A filter that contradicts its fixes again within this time, s, had a wrong attitude."""
GAP, CONTRADICTION = "no samples", "the filter contradicted its fixes"
"""Why a filter is lost."""


@dataclass(frozen=True)
class LostSpan:
    """Time in which the output of a filter is useless."""

    begin: float
    """s."""
    end: float
    """s."""
    why: str
    """Reason."""
    jump: np.ndarray
    """(3,) NED, m, fixes minus prediction at the end, nan if unknown."""
    ended: bool = False
    """No part of the flight follows."""


@dataclass(frozen=True)
class AidInnovations:
    """Innovations of an aid at its times (k,), see `History`."""

    innovation: np.ndarray
    """(k, 3)."""
    innovation_sigma: np.ndarray
    """(k, 3)."""
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray

    @classmethod
    def none(cls, count: int) -> AidInnovations:
        """Of measurements that are not used."""
        unknown = np.full((count, 3), np.nan)
        zero = np.zeros(count, np.int64)
        return cls(unknown, unknown.copy(), np.full(count, np.nan), zero, np.full(count, NOT_USED))


@dataclass(frozen=True)
class Replayed:
    """Output of the filter at the requested times (t,) and at the fixes (m,).

    For a tightly coupled filter, quantities of fixes are those of all ranges of an epoch. Only `innovation` is that of
    the fix, which the filter does not use.
    """

    time: np.ndarray
    """(t,) s."""
    navigation: np.ndarray
    """(t, NAV)."""
    sigma: np.ndarray
    """(t, n)."""
    innovation: np.ndarray
    """(m, 6) see `History`, as the next fields."""
    innovation_sigma: np.ndarray
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray
    log_sigma: np.ndarray
    """(m,) sum of the logarithms of the sigmas of counted innovations."""
    range_innovation: np.ndarray
    """(m, s, 2) of pseudorange and range rate, m, m/s; empty unless tightly coupled."""
    range_status: np.ndarray
    """(m, s), likewise."""
    rejected: np.ndarray
    """(m,) measurements that the gate rejected. For ranges, innovation_squared, degrees and log_sigma do not count
    them."""
    flown: np.ndarray
    """(m,) whether the fix is in a part of the flight."""
    lost: tuple[LostSpan, ...]
    """Times in which the output is useless."""
    parts: tuple[tuple[PartStart, float], ...] = ()
    """Start and end, s, of the parts of the flight."""
    aids: tuple[AidInnovations, ...] = ()
    """Of each of the flight's aids."""
    covariance: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    """(n, n) at the last output."""

    @property
    def rpy(self) -> np.ndarray:
        """Roll, pitch, yaw (t, 3), rad."""
        return roll_pitch_yaw(dcm_from_quaternion(self.navigation[:, states.NAV_QUAT : states.NAV_BIAS_FRAME]))

    def surprise(self, counted: np.ndarray, of_rejected: np.ndarray) -> float:
        """Negative log-likelihood of the counted fixes' innovations, up to a constant.

        The determinant of an innovation covariance is approximated by the product of its diagonal: the noise of the
        fixes is uncorrelated, and the filter's own uncertainty is small beside it. A rejected measurement counts
        `of_rejected`, () of all or (m,) of each fix, whatever its size, as if from another, wide distribution.
        """
        seen = counted & (self.degrees > 0) & (self.status != REJECTED)
        told = 0.5 * np.sum(self.innovation_squared[seen]) + np.sum(self.log_sigma[seen])
        return float(told + np.sum((of_rejected * self.rejected)[counted]))


@dataclass(frozen=True)
class _FlightInputs:
    """Common inputs of all parts of a flight, see `fly`."""

    flight: RecordedFlight
    design: FilterDesign
    fix_sigma: np.ndarray
    times: np.ndarray
    withheld: np.ndarray
    range_sigma: tuple[float, float] | None
    brief: bool

    @property
    def ranges(self) -> Ranges | None:
        """The ranges that a tightly coupled filter takes."""
        return self.flight.ranges if self.design.tight else None


@dataclass(frozen=True)
class _Part:
    """A part of a flight: numbers (k,) and arrivals, s, of its fixes; filter output with covariance (t, n, n).

    Also the first and last row of the fixes that the filter contradicts, and the part's start and end, s.
    """

    rows: np.ndarray
    arrival: np.ndarray
    seen: Replayed
    covariance: np.ndarray
    streak: tuple[int, int] | None
    begin: PartStart
    end: float
    aid_rows: tuple[np.ndarray, ...]
    """Numbers of the measurements of each aid."""


def fly(
    flight: RecordedFlight,
    design: FilterDesign,
    fix_sigma: np.ndarray,
    times: np.ndarray,
    until: float = np.inf,
    withheld: np.ndarray | None = None,
    range_sigma: tuple[float, float] | None = None,
    brief: bool = False,
) -> Replayed:
    """Run a filter or smoother over the flight, part by part.

    - `fix_sigma` (6,): position and velocity of the fixes, north, east, down, m, m/s.
    - `times` (t,): output times, in addition to the arrivals of fixes; `until`: early end, s.
    - `withheld` (m,) bool: fixes, or ranges of their epochs, that the filter does not use (innovation nan).
    - `range_sigma`: of pseudoranges (m) and range rates (m/s) overhead, for a tightly coupled filter.
    - `brief`: no outputs but at the ends of the parts, for the innovations alone.

    Raises ArithmeticError if a smoother's covariance fails, ValueError for a tightly coupled filter without ranges or
    their sigmas.
    """
    if design.tight and (flight.ranges is None or range_sigma is None):
        raise ValueError("a tightly coupled filter needs ranges and their sigmas")
    withheld = np.zeros(flight.arrival.size, bool) if withheld is None else withheld
    given = _FlightInputs(flight, design, fix_sigma, times, withheld, range_sigma, brief)
    until = min(until, float(flight.imu_time[-1]))
    parts: list[_Part] = []
    lost: list[LostSpan] = []
    begin: PartStart | None = flight.start
    while begin is not None and begin.alignment.time < until:
        missing = next((gap for gap in flight.breaks if gap[0] >= begin.alignment.time), None)
        end = until if missing is None else min(until, missing[0])
        part = _fly_part(given, begin, end, stops=True)
        streak = part.streak
        gap = None if streak is None else _gap_before(flight, begin, part, streak[0])
        if gap is not None:
            taken = _taken_after(given, begin, end, gap)
            part, streak = (_fly_part(given, begin, gap[0]) if taken is None else taken), None
            missing = gap if taken is None else missing
        if streak is not None:
            first, last = (float(part.arrival[i]) for i in streak)
            part = _fly_part(given, begin, last)
            jump = part.seen.innovation[streak[1], :3]
            if first - begin.alignment.time < last - first:  # contradicted for longer than confirmed: a wrong start
                first = begin.alignment.time
            begin = _after_contradiction(given, part, streak, lost, jump)
            lost.append(_lost(begin, first, last, CONTRADICTION, jump, until))
        elif missing is not None and missing[1] <= until:
            begin = flight.restart(missing[1])
            lost.append(_lost(begin, missing[0], missing[1], GAP, np.full(3, np.nan), until))
        else:
            begin = None
        parts.append(part)
    return _joined(given, parts, tuple(lost), int(np.sum(flight.arrival <= until + 1e-9)))


def fly_same_parts(
    flown: Replayed,
    flight: RecordedFlight,
    design: FilterDesign,
    fix_sigma: np.ndarray,
    withheld: np.ndarray,
    range_sigma: tuple[float, float] | None = None,
) -> Replayed:
    """Run a filter over the same parts as in a flight under slightly other settings, in brief, without a gate for
    fixes.

    Small changes of the settings then make small changes of the innovations. withheld (m,): fixes that were rejected.
    """
    if not design.tight:
        design = replace(design, gate=np.full_like(design.gate, np.inf))
    given = _FlightInputs(flight, design, fix_sigma, np.empty(0), withheld, range_sigma, True)
    parts: list[_Part] = []
    for begin, end in flown.parts:
        again: PartStart | None = begin
        if not parts:
            again = flight.start
        elif begin.kept is None:
            again = flight.restart(begin.alignment.time)
        parts.append(_fly_part(given, begin if again is None else again, end))
    return _joined(given, parts, (), flight.arrival.size)


def _gap_before(flight: RecordedFlight, begin: PartStart, part: _Part, first: int) -> tuple[float, float] | None:
    """Begin and end, s, of the missing samples after which a filter rejects all fixes, `first` being the first of
    them, of the rows of the part; None where it was well before."""
    used = np.flatnonzero((part.seen.degrees > 0) & (part.seen.status != REJECTED))
    well = max([begin.alignment.time, *part.arrival[used[used < first]]])
    spans = [(float(flight.imu_time[k]), float(flight.imu_time[k + 1])) for k, _ in flight.gaps]
    earliest, latest = max(well, begin.alignment.time), part.arrival[first]
    return next((gap for gap in spans if gap[0] >= begin.alignment.time and earliest <= gap[1] <= latest), None)


def _taken_after(given: _FlightInputs, begin: PartStart, end: float, gap: tuple[float, float]) -> _Part | None:
    """The part without the gate, if it would reject fixes only in the time after a gap, s; else None.

    An unobserved manoeuvre in the gap is larger than the filter model, and nothing else is wrong.
    """
    design = given.design
    if design.tight:
        return None
    part = _fly_part(replace(given, design=replace(design, gate=np.full_like(design.gate, np.inf))), begin, end)
    settling = (part.arrival >= gap[1]) & (part.arrival <= gap[1] + given.flight.patience)
    beyond = part.seen.innovation_squared > design.gate[part.seen.degrees]
    return None if np.any(beyond & ~settling) else part


def _lost(begin: PartStart | None, first: float, last: float, why: str, jump: np.ndarray, until: float) -> LostSpan:
    """Lost span from `first` to the next start, or to the end of the flight."""
    end = until if begin is None else max(last, begin.alignment.time)
    return LostSpan(first, min(end, until), why, jump, ended=begin is None)


def _weighed(history: History, pairs: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which fixes (k,) the filter has weighed, and which it rejected.

    A fix is rejected if its position, its velocity, or more than half of its ranges are. pairs (1 or 2, k): events of
    fixes. table (k, s): events of ranges, -1 for none.
    """
    if not table.shape[1]:
        status = history.status[pairs].max(axis=0, initial=NOT_USED)
        return status != NOT_USED, status == REJECTED
    each = np.where(table >= 0, history.status[table], NOT_USED)
    count = (each != NOT_USED).sum(axis=1)
    return count > 0, 2 * (each == REJECTED).sum(axis=1) > count


def _contradiction(
    arrival: np.ndarray, weighed: np.ndarray, rejected: np.ndarray, patience: float
) -> tuple[int, int] | None:
    """First streak of fixes (k,), `patience` seconds long, of which the filter rejects nearly all: first and last row.

    arrival: s; weighed, rejected: as of `_weighed`.
    """
    rows = np.flatnonzero(rejected & weighed)
    time = arrival[rows]
    so_far, all_so_far = np.cumsum(rejected), np.cumsum(weighed)
    earliest = np.searchsorted(time, time - patience + 1e-9, side="right") - 1
    for i, j in zip(np.flatnonzero(earliest >= 0), earliest[earliest >= 0], strict=True):
        first, last = rows[j], rows[i]
        count = so_far[last] - so_far[first] + 1
        if count >= LEAST_REJECTED and count >= CONTRADICTED * (all_so_far[last] - all_so_far[first] + 1):
            return int(first), int(last)
    return None


def _after_contradiction(
    given: _FlightInputs, part: _Part, streak: tuple[int, int], lost: list[LostSpan], jump: np.ndarray
) -> PartStart | None:
    """Start after fixes that the filter contradicted, at the last of them; lost: spans so far.

    If the fixes have moved as the inertial sensors did, either they or the position has a constant error; attitude and
    biases are kept. Otherwise, or if a filter was lost in the same way shortly before, the attitude is aligned anew.
    """
    flight, seen = given.flight, part.seen
    first, last = streak
    time = float(part.arrival[last])
    change = seen.innovation[last] - seen.innovation[first]
    squared = change**2 / (seen.innovation_sigma[last] ** 2 + seen.innovation_sigma[first] ** 2)
    known = np.isfinite(squared)
    agree = known.sum() >= 3 and float(squared[known].sum()) <= given.design.gate[known.sum()]
    before = [one for one in lost if one.why == CONTRADICTION and time - one.end < RELAPSE]
    if not agree or (before and not _cancel(before[-1].jump, jump)):
        return flight.restart(time)
    nav, covariance = seen.navigation[-1], part.covariance[-1]
    fix = int(part.rows[last])
    velocity = flight.velocity[fix].copy()
    unknown = np.isnan(velocity)
    velocity[unknown] = nav[states.NAV_VEL : states.NAV_QUAT][unknown]
    age = given.design.latency
    here = earth.ecef_from_llh(flight.llh[fix]) + age * earth.ned_matrix(flight.llh[fix]).T @ velocity
    att, sigma = slice(states.ATT, states.ATT + 3), np.sqrt(np.diag(covariance))
    aligned = Alignment(
        time, nav[states.NAV_QUAT : states.NAV_BIAS_FRAME], covariance[att, att],
        nav[states.NAV_GYRO : states.NAV_ACCEL],
        sigma[states.GYRO : states.GYRO + 3], time, time,
    )  # fmt: skip
    own = np.sqrt(np.diag(flight.covariance[fix]))
    return PartStart(
        aligned, earth.llh_from_ecef(here), velocity, age, np.zeros(3), own, flight.weight[fix], flight.effect[fix],
        (nav, covariance),
    )  # fmt: skip


def _cancel(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two jumps (3,) lead back to where the first began."""
    return bool(np.linalg.norm(one + other) < RETURNED * max(np.linalg.norm(one), np.linalg.norm(other)))


def _joined(given: _FlightInputs, parts: list[_Part], lost: tuple[LostSpan, ...], count: int) -> Replayed:
    """The parts of a flight as one, with its first `count` fixes; fixes outside of all parts count as unused."""
    last = -np.inf
    kept = []
    for part in parts:
        kept.append(part.seen.time > last)
        last = float(part.seen.time[-1])
    of_outputs = {
        name: np.concatenate([getattr(part.seen, name)[keep] for part, keep in zip(parts, kept, strict=True)])
        for name in ("time", "navigation", "sigma")
    }
    of_fixes = {}
    for name, nothing in (
        ("innovation", np.nan), ("innovation_sigma", np.nan), ("innovation_squared", np.nan), ("degrees", 0),
        ("status", NOT_USED), ("log_sigma", 0.0), ("range_innovation", np.nan), ("range_status", NOT_USED),
        ("rejected", 0), ("flown", False),
    ):  # fmt: skip
        like = getattr(parts[0].seen, name)
        whole = np.full((count, *like.shape[1:]), nothing, like.dtype)
        for part in parts:
            whole[part.rows] = getattr(part.seen, name)
        of_fixes[name] = whole
    spans = tuple((part.begin, part.end) for part in parts)
    aids = tuple(AidInnovations.none(aid.time.size) for aid in given.flight.aids)
    for part in parts:
        for whole_aid, rows, own in zip(aids, part.aid_rows, part.seen.aids, strict=True):
            for name, values in vars(own).items():
                getattr(whole_aid, name)[rows] = values
    last_covariance = parts[-1].covariance[-1]
    return Replayed(
        **of_outputs, **of_fixes, lost=_merged(lost), parts=spans, aids=aids, covariance=last_covariance
    )  # fmt: skip


def _merged(lost: tuple[LostSpan, ...]) -> tuple[LostSpan, ...]:
    """Merge lost spans if fixes jumped away and came back: those in between were wrong."""
    out: list[LostSpan] = []
    for one in lost:
        if out and out[-1].why == one.why == CONTRADICTION and _cancel(out[-1].jump, one.jump):
            one = replace(one, begin=out.pop().begin, jump=np.full(3, np.nan))
        out.append(one)
    return tuple(out)


def _cut(flight: RecordedFlight, begin: float, end: float) -> tuple[ImuData, slice]:
    """Increments from `begin` to at least `end`, s, and their intervals; the first is cut in proportion."""
    first = int(np.searchsorted(flight.imu_time, begin + 1e-9, side="right")) - 1
    last = max(first + 1, int(np.searchsorted(flight.imu_time, end - 1e-9)))
    within = slice(first, last)
    time, dtheta, dv = flight.imu_time[first : last + 1], flight.dtheta[within], flight.dv[within]
    if begin > time[0] + 1e-9:
        share = (time[1] - begin) / (time[1] - time[0])
        time, dtheta, dv = time.copy(), dtheta.copy(), dv.copy()
        time[0] = begin
        dtheta[0] *= share
        dv[0] *= share
    return ImuData(time, dtheta, dv), within


def _positions_and_velocities(fixes: FixTable, known: np.ndarray) -> FixTable:
    """Fixes (m,) as positions and, in as many rows more, velocities, which are of another time; known (m,): whether the
    flight has begun at that time."""
    none = np.full_like(fixes.llh, np.nan)
    velocity = np.where(known[:, None], fixes.velocity, np.nan)
    return FixTable(
        np.concatenate([fixes.llh, none]), np.concatenate([none, velocity]), np.tile(fixes.covariance, (2, 1, 1)),
        fixes.lever_arm, np.tile(fixes.correlated, (2, 1, 1)),
    )  # fmt: skip


def _fly_part(given: _FlightInputs, begin: PartStart, end: float, stops: bool = False) -> _Part:
    """A flight from a start to `end`, s, as of `fly`; stops: soon after a filter has contradicted its fixes, so that
    later outputs are not set."""
    flight, design, fix_sigma, times = given.flight, given.design, given.fix_sigma, given.times
    imu, within = _cut(flight, begin.alignment.time, end)
    at = float(imu.time[0])
    rows = np.flatnonzero((flight.arrival - design.latency > at) & (flight.arrival <= end + 1e-9))
    arrival, withheld, count = flight.arrival[rows], given.withheld[rows], rows.size
    wanted = np.unique(times[(times > at + design.latency) & (times <= end + 1e-9)])
    outputs = np.unique(np.concatenate([imu.time[:1], arrival[-1:] if given.brief else arrival, wanted]))
    known_llh = np.where(given.withheld[:, None], np.nan, flight.llh)
    llh, velocity = flight.llh[rows], flight.velocity[rows]
    llh[withheld] = velocity[withheld] = np.nan
    valid = np.maximum(arrival - design.latency, at)
    # over a gap one linearisation is not enough: the filter's attitude is off by tens of degrees there
    gaps = any(within.start <= k < within.stop for k, _ in flight.gaps)
    kind = FILTER_KINDS["map"] if is_smoother(design.kind) and gaps else design.kind
    noise = design.sigma_scale**2 * fix_covariance(flight.covariance[rows], fix_sigma * flight.weight[rows])
    known = valid if is_smoother(kind) else arrival
    tables: dict[int, FixTable | RangeTable | VehicleTable | BeaconTable] = {}
    scales: tuple[int, ...] = ()
    heard = np.zeros((count, 0), bool)
    ranges = given.ranges
    if ranges is not None and given.range_sigma is not None:
        scales, ranges = ranges.clocks, ranges.take(rows)
        heard = np.isfinite(ranges.pseudorange) & ~withheld[:, None]
        noise = noise_of_fixes(ranges, llh, given.range_sigma, noise)
        tables[RANGE] = table_of(ranges, heard, scales, given.range_sigma, design.lever_arm)
    fixes, fix_valid, fix_known = FixTable(llh, velocity, noise, design.lever_arm, flight.effect[rows]), valid, known
    apart = bool(flight.velocity_lag) and not design.tight
    if apart:
        older = arrival - design.latency - flight.velocity_lag
        fixes = _positions_and_velocities(fixes, older > at)
        fix_valid = np.concatenate([valid, np.maximum(older, at)])
        fix_known = fix_valid if is_smoother(kind) else np.tile(arrival, 2)
    tables[MONITOR_ONLY_FIX if design.tight else FIX] = fixes
    aid_rows = tuple(np.flatnonzero((aid.time > at) & (aid.time <= end + 1e-9)) for aid in flight.aids)
    of_aids = []
    for which in dict.fromkeys(aid.kind for aid in flight.aids):
        same = [(aid, keep) for aid, keep in zip(flight.aids, aid_rows, strict=True) if aid.kind == which]
        missing = [aid.of_receiver & within_outages(withheld, arrival, aid.time[keep]) for aid, keep in same]
        tables[which] = merge_aids(same, missing)
        time = np.concatenate([aid.time[keep] for aid, keep in same])
        of_aids.append((which, time, time))
    epoch = np.nonzero(heard)[0]
    of_fixes = (MONITOR_ONLY_FIX if design.tight else FIX, fix_valid, fix_known)
    events = schedule(outputs, of_fixes, (RANGE, valid[epoch], known[epoch]), *of_aids)
    densities = noise_of(flight, design)
    densities = densities if densities.shape[0] == 1 else densities[within]
    model = replace(design, kind=kind).model(densities, scales)
    pairs = events.rows(MONITOR_ONLY_FIX if design.tight else FIX).reshape(2 if apart else 1, count)
    table = np.full(heard.shape, -1)
    table[heard] = events.rows(RANGE)

    def streak_of(history: History) -> tuple[int, int] | None:
        return _contradiction(arrival, *_weighed(history, pairs, table), flight.patience)

    measurements = Measurements.of(tables)
    history = estimate(
        imu,
        measurements,
        events,
        start(
            *start_of(replace(flight, llh=known_llh), begin, design, fix_sigma, scales, ranges),
            model.components,
            heard.shape[1] + measurements.beacons.position.shape[0],
        ),
        model,
        (lambda so_far: streak_of(so_far) is not None) if stops else None,
    )
    if is_smoother(kind) and lost(history):
        raise ArithmeticError("the smoother lost the positive covariance of its flight")
    squared, degrees, status, each_status = by_epoch(
        pairs.T, history.innovation_squared, history.degrees, history.status
    )
    status = np.where((each_status == REJECTED).any(axis=1), REJECTED, status)
    innovation, innovation_sigma = (
        np.hstack([values[pairs[0], :3], values[pairs[-1], 3:]])
        for values in (history.innovation, history.innovation_sigma)
    )
    each = np.where(np.isfinite(history.innovation_sigma), history.innovation_sigma, 1.0)  # 1 for a missing one
    log_sigma = np.log(each).sum(axis=1)
    of_ranges = np.full((*heard.shape, 2), np.nan)
    range_status = np.zeros(heard.shape, np.int64)
    logs, rejected = log_sigma[pairs].sum(axis=0), (status == REJECTED).astype(np.int64)
    if design.tight:
        passed = history.status != REJECTED
        squared, degrees, status, range_status = by_epoch(
            table, np.where(passed, history.innovation_squared, np.nan), np.where(passed, history.degrees, 0),
            history.status,
        )  # fmt: skip
        of_ranges[heard] = history.innovation[table[heard], :2]
        logs = np.where((table >= 0) & passed[table], log_sigma[table], 0.0).sum(axis=1)
        rejected = (range_status == REJECTED).sum(axis=1)
    seen = Replayed(
        outputs, history.navigation, history.sigma(), innovation, innovation_sigma, squared, degrees, status, logs,
        of_ranges, range_status, rejected, np.full(count, True), (), (),
        _aid_innovations(history, events, [aid.kind for aid in flight.aids], [keep.size for keep in aid_rows]),
    )  # fmt: skip
    return _Part(rows, arrival, seen, history.covariance, streak_of(history), begin, end, aid_rows)


def within_outages(withheld: np.ndarray, arrival: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Whether the fix before a time (k,) is withheld (m,)."""
    before = np.searchsorted(arrival, time, side="right") - 1
    return np.asarray(np.concatenate([withheld, [False]])[before])


def _aid_innovations(
    history: History, events: Events, kinds: list[int], sizes: list[int]
) -> tuple[AidInnovations, ...]:
    """Innovations of aids of these kinds with so many measurements; those of one kind share a table, in order."""
    out, begun = [], dict.fromkeys(kinds, 0)
    for kind, size in zip(kinds, sizes, strict=True):
        at = events.rows(kind)[begun[kind] : begun[kind] + size]
        begun[kind] += size
        out.append(AidInnovations(
            history.innovation[at, :3], history.innovation_sigma[at, :3], history.innovation_squared[at],
            history.degrees[at], history.status[at],
        ))  # fmt: skip
    return tuple(out)
