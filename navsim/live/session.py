"""Live landing with a real receiver or IMU: read lines, run the filter, write a result at the end.

Receiver lines are NMEA sentences or rows `t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s`; IMU lines are rows
`t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2`, each the mean since the row before. `source_clock` converts
their times. A fix arrives `position_fix.latency_s` after its time of validity, as in a landing.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from navsim.filter import states
from navsim.filter.estimate import in_all_lanes
from navsim.filter.records import REJECTED
from navsim.formats.conventions import GNSS_COLUMNS, IMU_COLUMNS
from navsim.formats.nmea import Assembler, has_sentences
from navsim.formats.stream import Lines
from navsim.formats.tables import StreamedTable
from navsim.formats.text import plain_number
from navsim.geodesy import earth
from navsim.geodesy.geoid import NoGeoid, undulation
from navsim.gnss.signals import antenna_ecef
from navsim.landing.case import Case
from navsim.live.filter import Increments, LiveFilter
from navsim.replays import source_clock
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, several
from navsim.results.result import Result
from navsim.results.schema import COUNTS, LIVE, RMS_WINDOW
from navsim.runner.attributes import root_attributes
from navsim.runner.findings import notes, of_flight
from navsim.sensors import imu
from navsim.simulation.flight import initial_errors, initial_estimate
from navsim.simulation.measurements import measured, receiver_fixes
from navsim.statistics.random_streams import generator
from navsim.statistics.rounding import digits

Block = Literal["receiver", "imu"]
_OF_NMEA = (
    "corrupt", "empty", "estimated", "manual", "simulated", "no_checksum", "untimed", "no_height", "contradicting",
    "no_separation", "other",
)  # fmt: skip
"""Counters of the sentence assembler."""
_LEFT_OUT = ("estimated", "manual", "simulated", "no_checksum")
"""Counters of omitted lines that look like fixes; each is reported to the user."""
_NO_FIX = ("corrupt", "empty", "untimed", "no_height", *_LEFT_OUT)
"""Counters of lines without a usable fix, which a good receiver seldom sends."""
_LIMITS = {"lat": 90.0, "lon": 360.0, "h": 1e5, "v": 2000.0, "rate": 100.0, "force": 2000.0}
_OVER = 10
"""Messages in a row from beyond the end of the flight after which it is over."""
_SAME_TIME = 1e-6
"""Times closer than this are one, s."""
_SLICE = 0.2
"""Longest wait without a look at whether to stop, s."""

_BEST_FIX = 1.0
"""No receiver is asked for fixes better than this, m an axis, also where the scenario has signals without errors."""
FEWEST_USED = 0.1
"""Least fraction of useful lines; lines without a fix and corrupt ones count as useless."""
MANY_CORRUPT = 0.05
"""Share of corrupt lines from which the user is warned."""
MOST_MISPLACED = 0.25
"""Largest fraction of messages out of order or in contradiction to others; beyond it the stream is not one
receiver's."""
MOST_REJECTED = 1.0 / 3.0
"""Largest fraction of fixes rejected by the gate; beyond it the flight is not this landing."""
MOST_NIS = 100.0
"""Largest median normalised innovation squared per degree of freedom, ten sigmas; beyond it the flight is not this
landing."""
MOST_OFF = 10.0
"""Median distance of the fixes from the flight, in sigmas of a fix, beyond which they are not of this landing."""
DOUBTED_ASIDE, MOST_ASIDE = 3.0, 5.0
"""Mean of the fixes across the track, or in height, in sigmas of one fix, beyond which the user is warned, and beyond
which they are not of this landing."""
_SIDES = {
    "across": ("left of", "right of"), "north": ("south of", "north of"), "east": ("west of", "east of"),
    "up": ("below", "above"),
}  # fmt: skip
"""Directions in which the mean of the fixes is judged, and words for deviations to either side."""
_UNDULATIONS = (-107.0, 86.0)
"""Least and largest height of the geoid of EGM96 above the ellipsoid, m."""
_AS_GEOID = 0.2
"""Part of the geoid's undulation within which a height error is taken for it: the fixes' own errors are in both."""
_DRAWN = 8
"""Runs of the scenario's own receiver, by which errors are known that it does not know of itself."""
_SPANS = 12
"""Spans in which the stream's shift along the track is taken, for their scatter; at least half must have fixes."""
_SHORTEST_SPAN = 1.0
_SLOWEST = 3.0
"""Speed, m/s, under which a shift in time does not show."""
_SURE = 4.0
"""Sigmas from which a shift is not chance."""


@dataclass
class Session:
    """A live run: `pump` it with lines, then take the `result`."""

    case: Case
    block: Block
    seed: int
    realtime: bool = False
    start: source_clock.Start | Literal["first"] | None = None
    """Reading of the source's clock at time 0; None: to be determined."""
    lenient: bool = False
    """See `Assembler`, also for `simulated`."""
    simulated: bool = False
    tell: Callable[[str], None] = lambda _: None
    """Receives messages for the user."""
    stopped: str | None = None
    """Set from outside to end the run, for example by a signal handler; contains the reason."""
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTS, 0))

    def __post_init__(self) -> None:
        shared, case = self.case.shared, self.case
        self.filter = LiveFilter(
            case.flight.with_receiver_fixes,
            case.trajectory,
            initial_estimate(case.flight, in_all_lanes(initial_errors(case.flight, self.seed, 0)))[:, 0].copy(),
            Increments([0.0]),
        )
        self.assembler = Assembler(self.lenient, self.simulated)
        self.clock: source_clock.SourceClock | None = None
        self.last: float | None = None
        self.fixes: list[tuple[float, np.ndarray]] = []
        self.noise, self.own_fixes = _fixes(case, self.seed)
        self.next_fix = 0
        self._table = StreamedTable(GNSS_COLUMNS if self.block == "receiver" else IMU_COLUMNS)
        self._of_nmea = dict.fromkeys(_OF_NMEA, 0)
        self._held: tuple[np.ndarray, source_clock.Kind] | None = None
        self._latest: np.ndarray | None = None
        self._beyond = 0
        self._began: float | None = None
        self._moved = 0.0
        self.latency = case.scenario.receiver.latency_s
        if self.block == "receiver":
            step = shared.imu_time[1] - shared.imu_time[0]
            dtheta, dv, _ = imu.simulate(
                generator(self.seed, 0, "imu"), shared.dtheta, shared.dv, step, case.flight.gyro, case.flight.accel
            )
            for t, a, b in zip(shared.imu_time[1:], dtheta, dv, strict=True):
                self.filter.increments.add(float(t), a, b)
        self.period = 1.0 / (case.scenario.receiver.rate_hz if self.block == "receiver" else case.scenario.imu.rate_hz)

    @property
    def over(self) -> bool:
        """Whether the scenario's time has passed."""
        latency = self.latency if self.block == "receiver" else 0.0
        end = self.case.scenario.duration_s - latency - 0.5 * self.period
        return self._beyond >= _OVER or (self.last is not None and self.last > end)

    def pump(self, lines: Lines, silence: float, done: Callable[[int], None] = lambda _: None) -> str:
        """Read lines until the scenario is over, the source ends, `silence` seconds pass, or `stopped` is set; returns
        which."""
        why = self._pump(lines, silence, done)
        self.finish()
        self.counts["dropped"] += lines.dropped
        self.counts["strangers"] += sum(lines.strangers.values())
        return why

    def _pump(self, lines: Lines, silence: float, done: Callable[[int], None]) -> str:
        quiet_since = clock.monotonic()
        while not self.over:
            if self.stopped is not None:
                return self.stopped
            line = lines.take(min(_SLICE, silence))
            if line is not None:
                self.take(line)
                quiet_since = clock.monotonic()
                done(int(self.last) if self.last is not None else 0)
            elif lines.ended:
                return f"the source went away: {lines.failure}" if lines.failure else "the source ended"
            elif clock.monotonic() - quiet_since > silence:
                return f"nothing came for {silence:g} s"
        return "the scenario's time is over"

    def take(self, line: str) -> None:
        """One line as it came."""
        if not line.strip():
            return
        # "$" begins a sentence, which is no header
        if "$" not in line and (lacking := self._table.header(line)) is not None:
            self._warn_of_header(lacking)
            return
        if line.startswith("#"):
            return
        self.counts["received"] += 1
        if self.block == "receiver" and ("$" in line or has_sentences([line])):
            self._from_nmea(self.assembler.feed(line))
            return
        row = _row(self._table.row(line), self.block)
        if row is None:
            self.counts["corrupt"] += 1
        else:
            self._use(row, "count")

    def _warn_of_header(self, lacking: list[str]) -> None:
        """Warn of a header that lacks columns. Without a header the columns are the first ones."""
        if lacking:
            order = ", ".join(self._table.wanted)
            self.tell(f"warning: the header lacks {', '.join(lacking)}; columns are taken in the order {order}")

    def finish(self) -> None:
        """Use the last epoch of NMEA sentences, or a single message, which waited for a successor."""
        last = self.assembler.flush()
        self._from_nmea([] if last is None else [last])
        if self._held is not None:
            self._settle(*self._held)

    def _from_nmea(self, rows: list[np.ndarray]) -> None:
        """Use rows from the assembler, and add its counters."""
        nmea = self.assembler
        for name in _OF_NMEA:
            now = getattr(nmea, name)
            new = now - self._of_nmea[name]
            # a line may hold several sentences, and pieces of some; it is counted once
            self.counts[name] += min(new, 1) if name == "corrupt" else new
            self._of_nmea[name] = now
        if nmea.moved != self._moved:
            # the date came after the first fixes: their times, and the clock found from them, are of that day
            ahead, self._moved = nmea.moved - self._moved, nmea.moved
            later = ahead * np.eye(len(GNSS_COLUMNS))[0]
            if self._held is not None:
                self._held = (self._held[0] + later, "dated")
            if self._latest is not None:
                self._latest = self._latest + later
            if self.clock is not None:
                self.clock = self.clock.dated(ahead, self.case.scenario.epoch.timestamp())
                self._report_clock()
        for row in rows:
            self._use(row[:7], "dated" if nmea.dated else "undated")

    def _use(self, row: np.ndarray, kind: source_clock.Kind) -> None:
        """Use a message (7,); until the clock is determined, it waits for the next one."""
        if self.clock is not None:
            self._place(row)
            return
        held, self._held = self._held, (row, kind)
        if held is None:
            return
        step = row[0] - held[0][0]
        if 0.0 < step <= max(source_clock.LONGEST_STEP, 10.0 * self.period):
            self._settle(*held)
            self._place(row)
        else:  # one of the two is wrong, or of another sender: only the one that is followed counts
            self.counts[self._passed(held[0], row)] += 1

    def _settle(self, row: np.ndarray, kind: source_clock.Kind) -> None:
        self._held = None
        scenario = self.case.scenario
        distance = (lambda t: self._normalized_distance(t, _radians(row))) if self.block == "receiver" else None
        self.clock = source_clock.estimate_clock(
            float(row[0]), kind, scenario.epoch.timestamp(), scenario.duration_s, self.period, distance, self.start
        )
        self._report_clock()
        self._place(row)

    def _report_clock(self) -> None:
        assert self.clock is not None
        self.tell(self.clock.text)
        if self.clock.doubt:
            self.tell(f"warning: {self.clock.doubt}")

    def _normalized_distance(self, t: float, llh: np.ndarray) -> float:
        """Distance of a fix from where the flight's antenna is at a time, in sigmas."""
        return float(np.linalg.norm(self._off(np.array([t]), llh[None])[0]) / self._sigma(np.array([t]))[0])

    def _off(self, time: np.ndarray, llh: np.ndarray) -> np.ndarray:
        """Fixes (n, 3) less the flight's antenna positions, m NED (n, 3)."""
        motion = self.case.trajectory.motion(time)
        off = earth.ecef_from_llh(llh) - antenna_ecef(motion, self.case.environment.lever_arm)
        return np.einsum("nij,nj->ni", earth.ned_matrix(motion.llh), off)

    def _sigma(self, time: np.ndarray) -> np.ndarray:
        """1 sigma of the scenario's fixes in space nearest to times (n,), m, for the evaluation of real ones."""
        noise = self.noise[self._nearest(time), :3, :3]
        return np.maximum(np.sqrt(np.trace(noise, axis1=1, axis2=2)), _BEST_FIX)

    def _nearest(self, time: np.ndarray) -> np.ndarray:
        """Numbers of the scenario's fixes nearest to times (n,)."""
        return np.array([np.argmin(np.abs(self.case.shared.signals.time - t)) for t in time], dtype=np.int64)

    def _place(self, row: np.ndarray) -> None:
        """A message at its time in the flight."""
        assert self.clock is not None
        t = float(row[0]) - self.clock.offset
        if t <= _SAME_TIME:
            self.counts["before"] += 1
            return
        if self.last is not None and t <= self.last + _SAME_TIME:
            assert self._latest is not None
            self.counts[self._passed(row, self._latest)] += 1
            return
        if t > self.case.scenario.duration_s + _SAME_TIME:
            self.counts["early"] += 1
            self._beyond += 1
            return
        self._beyond = 0
        if self.realtime:
            self._hold_back(t)
        previous = 0.0 if self.last is None else self.last
        self.counts["lost"] += max(0, round((t - previous) / self.period) - 1)
        if self.block == "receiver":
            self._use_fix(t, row)
        else:
            self._use_sample(t, row)
        self.last, self._latest = t, row

    def _passed(self, row: np.ndarray, other: np.ndarray) -> str:
        """Counter for a message that contradicts another one."""
        if abs(row[0] - other[0]) > _SAME_TIME:
            return "late"
        if np.array_equal(row[1:], other[1:], equal_nan=True):
            return "doubled"
        if self.block == "imu":
            return "contradicting"
        apart = float(np.linalg.norm(np.diff(earth.ecef_from_llh(_radians(np.array([row, other]))), axis=0)))
        now = np.array([0.0 if self.last is None else self.last])
        return "contradicting" if apart > source_clock.FITS * self._sigma(now)[0] else "late"

    def _hold_back(self, t: float) -> None:
        """Wait until as much time has passed since the first message as in the flight, or the run is stopped."""
        if self._began is None:
            self._began = clock.monotonic() - t
        while self.stopped is None and (left := self._began + t - clock.monotonic()) > 0.0:
            clock.sleep(min(left, _SLICE))

    def _use_fix(self, t: float, row: np.ndarray) -> None:
        index = int(np.argmin(np.abs(self.case.shared.signals.time - t)))
        used = self._weigh(t, _radians(row), row[4:7].astype(float), index)
        self.counts["used" if used else "early"] += 1

    def _use_sample(self, t: float, row: np.ndarray) -> None:
        step = t - self.filter.known_until
        self.filter.increments.add(t, step * row[1:4], step * row[4:7])
        self.counts["used"] += 1
        fixes = self.case.shared.signals.time
        while self.next_fix < fixes.size and fixes[self.next_fix] + self.latency <= t + 1e-9:
            llh, velocity = self.own_fixes[0][self.next_fix], self.own_fixes[1][self.next_fix]
            self._weigh(float(fixes[self.next_fix]), llh, velocity, self.next_fix)
            self.next_fix += 1

    def _weigh(self, t: float, llh: np.ndarray, velocity: np.ndarray, epoch: int) -> bool:
        """Use a fix of time t, which arrives the receiver's latency later, with the noise of the scenario's fix at an
        epoch."""
        used = self.filter.process_fix(t + self.latency, llh, velocity, self.noise[epoch], epoch)
        if used:
            self.fixes.append((t, llh))
        return used

    def _aside(self, time: np.ndarray, off: np.ndarray, shift: float) -> np.ndarray:
        """Means (4,) of fixes (n, 3) right of the flight where it moves, north and east of it, and above it, m.

        shift: along the track, s; where it is unknown, those to the north and east are too, unless nothing moves.
        """
        velocity = self.case.trajectory.motion(time).velocity_ned
        if np.isfinite(shift):
            off = off - shift * velocity
        right, moves = _right(velocity)
        finite = np.isfinite(off).all(axis=1)
        beside = np.sum(off * right, axis=1)[moves & finite]
        level = off[finite, :2] if np.isfinite(shift) or not moves.any() else off[:0, :2]
        means = (beside, *level.T, -off[finite, 2])
        return np.array([each.mean() if each.size else np.nan for each in means])

    def _aside_sigma(self, time: np.ndarray) -> np.ndarray:
        """1 sigma (4,) of the same for a healthy receiver whose errors last the whole flight, so that fixes do not
        average them.

        From the covariances of the scenario's fixes at these times (n,), or from runs if the receiver has unmodelled
        errors.
        """
        shared = self.case.shared
        right, _ = _right(self.case.trajectory.motion(time).velocity_ned)
        noise = self.noise[self._nearest(time), :3, :3]
        beside = np.einsum("ni,nij,nj->n", right, noise, right).mean()
        claimed = np.sqrt([beside, *np.diagonal(noise.mean(axis=0))])
        means = []
        for run in range(_DRAWN):
            llh = receiver_fixes(shared, *measured(shared, self.seed, run)).llh
            fixed = np.isfinite(llh[:, 0])
            at = shared.signals.time[fixed]
            if at.size:
                means.append(self._aside(at, self._off(at, llh[fixed]), 0.0))
        drawn = np.sqrt(np.mean(np.square(means), axis=0)) if means else np.zeros(len(_SIDES))
        return np.fmax(np.fmax(claimed, drawn), _BEST_FIX)

    def _undulation(self) -> float:
        """Height of the geoid above the ellipsoid at the start of the flight, m: the scenario's, else that of EGM96,
        nan where the extra `geoid` is not installed."""
        runway = self.case.scenario.runway
        if runway.geoid_undulation_m is not None:
            return runway.undulation_m
        lat, lon, _ = self.case.trajectory.motion(np.zeros(1)).llh[0]
        try:
            return undulation(float(np.degrees(lat)), float(np.degrees(lon)))
        except NoGeoid:
            return math.nan

    def result(self) -> Result:
        """The result so far."""
        left = self.filter.estimates()
        case = self.case
        draft = ResultBuilder(LIVE, {"mixed": ", ".join(dict.fromkeys(case.state_units))})
        draft["/filter/time"] = left["time"]
        draft.put("/filter/state", np.array(case.states), {"state_units": ", ".join(case.state_units)})
        draft["/filter/error"] = left["error"]
        draft["/filter/sigma"] = left["sigma"]
        draft["/filter/position_llh"] = left["navigation"][:, states.NAV_LLH : states.NAV_VEL]
        draft["/filter/velocity_ned"] = left["navigation"][:, states.NAV_VEL : states.NAV_QUAT]
        time = np.array([t for t, _ in self.fixes], dtype=float)
        draft["/innovations/time"] = time
        draft["/innovations/position_ned"] = left["innovation"][:, :3]
        draft["/innovations/velocity_ned"] = left["innovation"][:, 3:]
        draft["/innovations/normalized_squared"] = left["innovation_squared"]
        draft["/innovations/degrees"] = left["degrees"]
        draft["/innovations/status"] = left["status"]
        for name, count in self.counts.items():
            draft[f"/stream/{name}"] = np.int64(count)
        off = self._off(time, np.array([llh for _, llh in self.fixes]).reshape(-1, 3))
        draft["/innovations/off_flight_ned"] = off
        draft["/innovations/fix_sigma"] = self._sigma(time)
        shift, sigma = np.nan, np.nan
        if self.block == "receiver":
            shift, sigma = _shift(time, off, case.trajectory.motion(time).velocity_ned)
        aside, sure = np.full(len(_SIDES), np.nan), np.full(len(_SIDES), np.nan)
        if self.block == "receiver" and time.size:
            aside, sure = self._aside(time, off, shift), self._aside_sigma(time)
        for k, name in enumerate(_SIDES):
            draft[f"/off_flight/{name}"], draft[f"/off_flight/{name}_sigma"] = aside[k], sure[k]
        draft["/off_flight/undulation"] = self._undulation()
        draft["/clock/offset"] = np.nan if self.clock is None else self.clock.offset
        draft["/clock/shift"] = shift
        draft["/clock/shift_sigma"] = sigma
        late = left["time"] > left["time"][-1] - RMS_WINDOW if left["time"].size else np.zeros(0, dtype=bool)
        squares = left["error"][late, :3] ** 2
        draft["/summary/rms_position_ned"] = np.sqrt(squares.mean(axis=0)) if late.any() else np.full(3, np.nan)
        degrees = int(left["degrees"].sum())
        draft["/summary/motion"] = np.array(["all"])
        draft["/summary/nis"] = np.array([np.nansum(left["innovation_squared"]) / degrees if degrees else np.nan])
        base = "not settled" if self.clock is None else self.clock.base
        out = draft.result(root_attributes("live", self.seed, case.scenario, replaced_block=self.block, clock=base))
        verdict = "; ".join(failures(out))
        out.attributes["verdict"] = f"no result: {verdict}" if verdict else "flown"
        return out


def failures(result: Result) -> list[str]:
    """Reasons why the flight is not a valid result; empty if it is."""
    count = {name: int(result[f"/stream/{name}"]) for name in COUNTS}
    used = result["/innovations/time"].size
    if not used:
        causes = (*_NO_FIX, "other", "before", "early", "late", "doubled", "contradicting")
        why = [f"{count[name]} {COUNTS[name]}" for name in causes if count[name]]
        without_cause = f"{count['received']} {COUNTS['received']}" if count["received"] else "none came"
        return [f"no message could be used: {', '.join(why) or without_cause}"]
    out = []
    if not np.isfinite(result["/innovations/normalized_squared"]).any():
        out.append(f"none of the {several(used, 'fix')} could be used")
    misplaced = count["late"] + count["contradicting"]
    whole = count["used"] + misplaced
    if misplaced > MOST_MISPLACED * whole:
        out.append(
            f"{misplaced} of {whole} messages are out of order or contradict others of their time: two senders at "
            "once, or several recordings in one?"
        )
    came = whole + sum(count[name] for name in (*_NO_FIX, "early"))
    if count["used"] < FEWEST_USED * came:
        out.append(f"of {came} messages and corrupt lines only {count['used']} could be used")
    if count["early"] > count["used"]:
        out.append(f"{count['early']} messages lie beyond the end of the flight, {count['used']} in it: another clock?")
    distance = np.linalg.norm(result["/innovations/off_flight_ned"], axis=1)
    off = distance / result["/innovations/fix_sigma"]
    if result.attributes["replaced_block"] == "receiver" and (sigmas := float(np.median(off))) > MOST_OFF:
        metres = float(np.median(distance))
        out.append(
            f"half of the fixes lie more than {digits(metres)} m ({digits(sigmas)} sigmas) from where the flight is "
            "at their times: another flight, or another time of it?"
        )
    out += _aside(result, True)
    rejected = int(np.sum(result["/innovations/status"] == REJECTED))
    if rejected > MOST_REJECTED * used:
        out.append(f"the gate rejected {rejected} of {several(used, 'fix')}")
    degrees = result["/innovations/degrees"]
    judged = degrees > 0
    if judged.any():
        nis = float(np.median(result["/innovations/normalized_squared"][judged] / degrees[judged]))
        if nis > MOST_NIS:
            out.append(
                f"half of the normalised innovations squared are over {digits(nis)} per degree of freedom, 1 is due"
            )
    return out


def _aside(result: Result, wrong: bool) -> list[str]:
    """Messages about fixes so far beside, above or below the flight that they are not of it, or only doubted.

    Fixes aside of a flight that turns are not on one side of it: they lie to the north or east.
    """
    out: list[str] = []
    count = result["/innovations/time"].size
    for name, sides in _SIDES.items():
        off, sigma = float(result[f"/off_flight/{name}"]), float(result[f"/off_flight/{name}_sigma"])
        sigmas = abs(off) / sigma if sigma else math.inf
        if (sigmas > MOST_ASIDE if wrong else DOUBTED_ASIDE < sigmas <= MOST_ASIDE) and (name == "up" or not out):
            out.append(
                f"the fixes lie on average {abs(off):.1f} m {sides[off > 0.0]} the flight, {sigmas:.1f} "
                f"sigmas of one fix ({sigma:.1f} m) and {sigmas * np.sqrt(count):.0f} of the mean of {count} "
                f"whose errors are independent: {_why_above(off, result) if name == 'up' else _WHY_ACROSS}"
            )
    return out


_WHY_ACROSS = "another runway, another datum, or the wrong offset of an antenna?"


def _why_above(off: float, result: Result) -> str:
    """The likely reason why fixes lie above the flight, m."""
    geoid = float(result["/off_flight/undulation"]) if "/off_flight/undulation" in result else math.nan
    how = "rows have h_m above the ellipsoid, NMEA sentences have both"
    if not math.isfinite(geoid):
        low, high = _UNDULATIONS
        return (
            "heights above the geoid given as heights above the ellipsoid, or the reverse? They differ by the geoid's "
            f"undulation, {low:g} to {high:g} m over the Earth (the extra `geoid` computes it: pip install "
            f"'.[geoid]' in the folder of navsim); {how}"
        )
    for wrong, text in ((-geoid, "are above the geoid"), (geoid, "have the geoid's undulation twice")):
        if abs(off - wrong) < _AS_GEOID * abs(geoid):
            return f"the geoid is {geoid:.1f} m above the ellipsoid here, so these heights likely {text}; {how}"
    return (
        f"the wrong offset of an antenna, or another reference of heights? It is not the geoid, which is {geoid:.1f} m "
        f"above the ellipsoid here; {how}"
    )


def findings(session: Session, result: Result, lines: Lines) -> list[Finding]:
    """Findings of a run, besides `failures`."""
    text = _aside(result, False)
    if lines.strangers:
        others = ", ".join(f"{name} ({count})" for name, count in lines.strangers.items())
        text.append(f"datagrams of other senders than the first were left out: {others}")
    few = MANY_CORRUPT * session.counts["received"]
    if session.counts["corrupt"] > few:
        text.append(f"{session.counts['corrupt']} of {session.counts['received']} lines are corrupt")
    cures = {"simulated": ": --simulator-fixes uses them", "no_checksum": ": --lenient reads them"}
    for name in ("dropped", "contradicting", "no_separation", *_LEFT_OUT):
        if session.counts[name] > (few if name == "no_checksum" else 0):
            text.append(f"{session.counts[name]} {COUNTS[name]}{cures.get(name, '')}")
    shift, sigma = float(result["/clock/shift"]), float(result["/clock/shift_sigma"])
    if (
        session.clock is not None
        and abs(shift) > max(0.5 * session.period, _SURE * sigma)
        and _explains(session, result, shift)
    ):
        periods = round(shift / session.period) * session.period
        text.append(
            f"along the track the fixes lie {abs(shift):.3f} s {'ahead of' if shift > 0.0 else 'behind'} the flight "
            f"(sigma {sigma:.3f} s), {abs(shift) / session.period:.1f} periods: lines lost before the first, or a "
            f"clock that is off? --start-time {session.clock.option(-periods)} takes it off"
        )
    scenario, came = session.case.scenario, result["/innovations/time"]
    if came.size and came[-1] < scenario.duration_s - max(1.0, 2.0 * session.period):
        text.append(f"the data end at {came[-1]:.1f} s of a flight of {scenario.duration_s:g} s")
    gate = scenario.filter.gate.probability
    return [*notes(session.case.sky_warnings), *(Finding("stream", text) for text in text), *of_flight(result, gate)]


def _explains(session: Session, result: Result, shift: float) -> bool:
    """Whether fixes that lie ahead by a time lie on the flight without it."""
    velocity = session.case.trajectory.motion(result["/innovations/time"]).velocity_ned
    left = np.linalg.norm(result["/innovations/off_flight_ned"] - shift * velocity, axis=1)
    return float(np.median(left / result["/innovations/fix_sigma"])) <= MOST_OFF


def _shift(time: np.ndarray, off: np.ndarray, velocity: np.ndarray) -> tuple[float, float]:
    """Mean along-track lead of fixes over the flight, s, and its 1 sigma; nan with too few fixes.

    time (n,) s, off (n, 3) m, velocity (n, 3) m/s, both NED. The scatter is that of means over spans of time, so that
    noise correlated within a span counts once.
    """
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    use = (speed > _SLOWEST) & np.isfinite(off).all(axis=1)
    if not use.any():
        return np.nan, np.nan
    time, off, velocity, speed = time[use], off[use], velocity[use], speed[use]
    length = max((time[-1] - time[0]) / _SPANS, _SHORTEST_SPAN)
    span = np.minimum((time - time[0]) // length, _SPANS - 1)
    along = np.sum(off[:, :2] * velocity[:, :2], axis=1)
    shifts = np.array([along[span == k].sum() / np.sum(speed[span == k] ** 2) for k in np.unique(span)])
    if shifts.size < _SPANS // 2:
        return np.nan, np.nan
    return float(shifts.mean()), float(shifts.std(ddof=1) / np.sqrt(shifts.size))


def _right(velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (n, 3) right of velocities (n, 3), NED, level, and where these are fast enough to have a side (n,);
    0 elsewhere."""
    speed = np.linalg.norm(velocity[:, :2], axis=1)
    moves = speed > _SLOWEST
    out = np.zeros_like(velocity)
    out[moves, 0], out[moves, 1] = -velocity[moves, 1] / speed[moves], velocity[moves, 0] / speed[moves]
    return out, moves


def _radians(row: np.ndarray) -> np.ndarray:
    """Geodetic coordinates, rad, rad, m, of rows (..., 7)."""
    return np.stack([np.radians(row[..., 1]), np.radians(row[..., 2]), row[..., 3]], axis=-1)


def _row(cells: list[str] | None, block: Block) -> np.ndarray | None:
    """The numbers of a row's cells, None for anything that cannot be one."""
    if cells is None:
        return None
    try:
        row = np.array([plain_number(cell) if cell else np.nan for cell in cells])
    except ValueError:
        return None
    needed = row[:4] if block == "receiver" else row
    if not np.isfinite(needed).all() or np.isinf(row).any():
        return None
    if block == "receiver":
        good = abs(row[1]) <= _LIMITS["lat"] and abs(row[2]) <= _LIMITS["lon"] and abs(row[3]) <= _LIMITS["h"]
        return row if good and not np.any(np.abs(row[4:7]) > _LIMITS["v"]) else None
    good = np.all(np.abs(row[1:4]) <= _LIMITS["rate"]) and np.all(np.abs(row[4:7]) <= _LIMITS["force"])
    return row if good else None


def _fixes(case: Case, seed: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Covariances of the fixes (e, 6, 6) NED, and the simulated fixes themselves: llh, velocity (e, 3)."""
    llh, velocity, _, cov = receiver_fixes(case.shared, *measured(case.shared, seed, 0))
    usual = np.diag([25.0, 25.0, 100.0, 0.1, 0.1, 0.4])  # where the scenario's own receiver would have no fix
    return np.where(np.isnan(cov), usual, cov), (llh, velocity)
