"""A landing of which the receiver or the IMU is real: lines in, filter on, a result at the end.

Receiver lines are NMEA sentences or rows `t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s`; IMU lines are rows
`t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2`, each the mean since the row before. Times are UTC, or any
count of seconds: then the first line is at the time where the scenario would have had it.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from navsim.core import states
from navsim.io.nmea import Assembler
from navsim.io.results import Result, Variable
from navsim.io.stream import Lines
from navsim.models import imu, timescales
from navsim.models.conventions import GNSS_COLUMNS, IMU_COLUMNS
from navsim.simulation.landing import fixed, initial_estimate, measured
from navsim.simulation.live import Increments, LiveFilter
from navsim.simulation.streams import generator
from navsim.study.landing.case import Case
from navsim.study.root import root_attributes

Block = Literal["receiver", "imu"]
COUNTS = {
    "received": "lines received",
    "used": "messages used",
    "corrupt": "lines that are no message: checksum, syntax, values",
    "late": "messages for a time already passed: late, doubled or out of order",
    "lost": "messages missing in between, by the scenario's rate",
    "early": "messages for a time beyond the data or the scenario",
    "empty": "messages without a fix",
}
_LIMITS = {"lat": 90.0, "lon": 360.0, "h": 1e5, "v": 2000.0, "rate": 100.0, "force": 2000.0}


@dataclass
class Session:
    """A live run under way; `pump` it with lines, then take the `result`."""

    case: Case
    block: Block
    seed: int
    realtime: bool = False
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(COUNTS, 0))

    def __post_init__(self) -> None:
        world, case = self.case.world, self.case
        initial = generator(self.seed, 0, "initial")
        self.filter = LiveFilter(
            case.settings,
            case.trajectory,
            initial_estimate(initial, world.at_filter, case.initial),
            Increments([0.0]),
        )
        self.assembler = Assembler()
        self.offset: float | None = None
        self.last: float | None = None
        self.started = clock.monotonic()
        self.noise, self.simulated = _fixes(case, self.seed)
        self.next_fix = 0
        if self.block == "receiver":
            step = world.imu_time[1] - world.imu_time[0]
            dtheta, dv, _ = imu.simulate(
                generator(self.seed, 0, "imu"), world.dtheta, world.dv, step, case.gyro, case.accel
            )
            for t, a, b in zip(world.imu_time[1:], dtheta, dv, strict=True):
                self.filter.increments.add(float(t), a, b)
        self.period = 1.0 / (case.scenario.receiver.rate_hz if self.block == "receiver" else case.scenario.imu.rate_hz)

    @property
    def over(self) -> bool:
        """Whether the scenario's time has passed."""
        return self.last is not None and self.last > self.case.scenario.duration_s - 0.5 * self.period

    def pump(self, lines: Lines, silence: float, done: Callable[[int], None] = lambda _: None) -> str:
        """Take lines until the scenario is over, the source ends, or `silence` seconds pass without; says which."""
        quiet_since = clock.monotonic()
        while not self.over:
            line = lines.take(min(0.2, silence))
            if line is not None:
                quiet_since = clock.monotonic()
                self.take(line)
                done(int(self.last or 0.0))
            elif lines.ended:
                self.finish()
                return "the source ended"
            elif clock.monotonic() - quiet_since > silence:
                self.finish()
                return f"nothing came for {silence:g} s"
        return "the scenario's time is over"

    def take(self, line: str) -> None:
        """One line as it came."""
        if not line.strip() or line.startswith(("#", "t_s")):
            return
        self.counts["received"] += 1
        if line.startswith("$") or (self.block == "receiver" and "$" in line[:2]):
            corrupt, empty = self.assembler.corrupt, self.assembler.no_fix
            row = self.assembler.feed(line) if self.block == "receiver" else None
            self.counts["corrupt"] += self.assembler.corrupt - corrupt + (self.block == "imu")
            self.counts["empty"] += self.assembler.no_fix - empty
            if row is not None:
                self._use(row[:7])
            return
        row = _row(line, len(GNSS_COLUMNS if self.block == "receiver" else IMU_COLUMNS), self.block)
        if row is None:
            self.counts["corrupt"] += 1
        else:
            self._use(row)

    def finish(self) -> None:
        """The last epoch of NMEA sentences has no successor that would complete it."""
        row = self.assembler.flush() if self.block == "receiver" else None
        if row is not None:
            self._use(row[:7])

    def _use(self, row: np.ndarray) -> None:
        t = self._scenario_time(float(row[0]))
        if self.last is not None and t <= self.last + 1e-6:
            self.counts["late"] += 1
            return
        if t > self.case.scenario.duration_s + 1e-6:
            self.counts["early"] += 1
            return
        if self.realtime:
            clock.sleep(max(0.0, self.started + t - clock.monotonic()))
        missing = round((t - (self.last or 0.0)) / self.period) - 1
        self.counts["lost"] += max(0, missing)
        if self.block == "receiver":
            self._use_fix(t, row)
        else:
            self._use_sample(t, row)
        self.last = t

    def _use_fix(self, t: float, row: np.ndarray) -> None:
        llh = np.array([np.radians(row[1]), np.radians(row[2]), row[3]])
        index = int(np.argmin(np.abs(self.case.world.signals.time - t)))
        used = self.filter.weigh(t, llh, row[4:7].astype(float), self.noise[index])
        self.counts["used" if used else "early"] += 1

    def _use_sample(self, t: float, row: np.ndarray) -> None:
        step = t - self.filter.known_until
        self.filter.increments.add(t, step * row[1:4], step * row[4:7])
        self.counts["used"] += 1
        fixes = self.case.world.signals.time
        while self.next_fix < fixes.size and fixes[self.next_fix] <= t + 1e-9:
            llh, velocity = self.simulated[0][self.next_fix], self.simulated[1][self.next_fix]
            self.filter.weigh(float(fixes[self.next_fix]), llh, velocity, self.noise[self.next_fix])
            self.next_fix += 1

    def _scenario_time(self, stamp: float) -> float:
        """Seconds of the scenario: from UTC, from the time of day, or counted from the first message."""
        if self.offset is None:
            epoch = self.case.scenario.epoch.timestamp()
            candidates = [stamp - epoch, stamp - epoch % timescales.DAY]
            inside = [c for c in candidates if 0.0 < c <= self.case.scenario.duration_s]
            self.offset = stamp - (inside[0] if inside else self.period)
        return stamp - self.offset

    def result(self) -> Result:
        """What there is, as far as it came."""
        left = self.filter.estimates()
        v: dict[str, Variable] = {}
        for name, labels, meaning in (
            ("llh", ("latitude", "longitude", "height"), "geodetic coordinates, WGS-84"),
            ("ned", ("north", "east", "down"), "axes of the local level frame"),
        ):
            v[f"/{name}"] = Variable((name,), np.array(labels), "1", meaning)
        mixed = ", ".join(dict.fromkeys(states.UNITS))
        v["/filter/time"] = Variable(("time",), left["time"], "s", "times of the fixes since the epoch")
        v["/filter/state"] = Variable(("state",), np.array(states.NAMES, dtype=object), "1", "names of the states")
        v["/filter/error"] = Variable(("time", "state"), left["error"], mixed, "truth of the scenario minus estimate")
        v["/filter/sigma"] = Variable(("time", "state"), left["sigma"], mixed, "1 sigma of the filter")
        llh = left["estimate"][:, states.NAV_LLH : states.NAV_LLH + 3]
        v["/filter/position_llh"] = Variable(("time", "llh"), llh, "rad, rad, m", "estimated position of the IMU")
        velocity = left["estimate"][:, states.NAV_VEL : states.NAV_VEL + 3]
        v["/filter/velocity_ned"] = Variable(("time", "ned"), velocity, "m/s", "estimated velocity")
        v["/innovations/time"] = Variable(("time",), left["time"], "s", "times of the fixes since the epoch")
        for name, part, unit in (("position_ned", slice(0, 3), "m"), ("velocity_ned", slice(3, 6), "m/s")):
            v[f"/innovations/{name}"] = Variable(("time", "ned"), left["misfit"][:, part], unit, "fix less prediction")
        v["/innovations/normalized_squared"] = Variable(("time",), left["squared"], "1", "normalised and squared")
        v["/innovations/degrees"] = Variable(("time",), left["degrees"], "1", "degrees of freedom of the same")
        v["/innovations/status"] = Variable(("time",), left["status"], "1", "0 no fix, 1 used, 2 rejected by the gate")
        for name, count in self.counts.items():
            v[f"/stream/{name}"] = Variable((), np.int64(count), "1", COUNTS[name])
        late = left["time"] > left["time"][-1] - 20.0 if left["time"].size else np.zeros(0, dtype=bool)
        squares = left["error"][late, :3] ** 2
        rms = np.sqrt(squares.mean(axis=0)) if late.any() else np.full(3, np.nan)
        v["/summary/rms_position_ned"] = Variable(("ned",), rms, "m", "rms position error over the last 20 s")
        nis = np.nansum(left["squared"]) / max(int(left["degrees"].sum()), 1)
        v["/summary/nis"] = Variable((), np.float64(nis), "1", "normalised innovation squared per degree of freedom")
        return Result(root_attributes("live", self.seed, self.case.scenario, replaced_block=self.block), v)


def _row(line: str, width: int, block: Block) -> np.ndarray | None:
    """The numbers of a row, None for anything that cannot be one."""
    cells = line.split(",")
    if len(cells) < width:
        return None
    try:
        row = np.array([float(c) if c.strip() else np.nan for c in cells[:width]])
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
    llh, velocity, _, cov = fixed(case.world, *measured(case.world, seed, 0))
    usual = np.diag([25.0, 25.0, 100.0, 0.1, 0.1, 0.4])  # where the scenario's own receiver would have no fix
    return np.where(np.isnan(cov), usual, cov) * case.settings.sigma_scale**2, (llh, velocity)
