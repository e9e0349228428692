"""Air and flight-technical error: mean wind, gusts, turbulence, and the aircraft's deviation from its route.

Winds are given by the direction to which the air moves, along path axes (x along the landing direction, y right, z
down); heights are above the runway. Sources and equations: `docs/theory/air.md`.

- [1] MIL-F-8785C (1980), section 3.7 (wind shear, gust, Dryden spectra).
- [2] MIL-HDBK-1797 (1997), appendix (Dryden spectra, low altitude).
- [3] Yeager, NASA CR-206937 (1998) (both forms of the spectra).
- [4] Hsu, Meindl & Gilhousen, J. Applied Meteorology 33 (1994) (power law).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from navsim.geodesy.earth import FOOT
from navsim.statistics.linear_processes import stationary
from navsim.trajectory.approach import TOUCHDOWN
from navsim.trajectory.autopilot import Autopilot
from navsim.trajectory.go_around import AlarmGoAround
from navsim.trajectory.kinematics import Trajectory, faded
from navsim.trajectory.path import AnyPath

KNOT = 1852.0 / 3600.0
LOWEST = 3.0 * FOOT
"""Height below which a profile is constant, m [1]."""
HIGHEST = 1000.0 * FOOT
"""Height up to which the logarithmic profile and the low-altitude spectra hold, m [1, 2]."""
REFERENCE = 20.0 * FOOT
"""Height of the wind that turbulence goes by, and that the logarithmic profile begins with, m [1]."""
POWER_REFERENCE = 10.0
"""Height of the wind that the power law begins with, m."""
TURBULENCE_LOWEST = 10.0 * FOOT
"""Height below which turbulence is constant, m."""
_ROUNDING = 1.0 * FOOT
"""Half the stretch, m, over which a corner of a profile is rounded: a nose cannot follow a corner."""
AIR_DENSITY = 1.225
"""Density of the standard atmosphere at sea level, kg/m3."""
GRAVITY = 9.80665


class AirError(ValueError):
    """The trajectory cannot be flown in this air; key: member of the section."""

    def __init__(self, key: str, text: str) -> None:
        super().__init__(text)
        self.key = key


def towards(speed: np.ndarray, from_: np.ndarray, heading: float) -> np.ndarray:
    """Horizontal wind (..., 3) along path axes that point to `heading`; from_: where it comes from, both rad from
    true north."""
    angle = from_ + math.pi - heading
    return np.stack([speed * np.cos(angle), speed * np.sin(angle), np.zeros_like(speed * angle)], axis=-1)


@dataclass(frozen=True)
class Profile:
    """Mean wind by height. Corners between linear pieces are rounded."""

    kind: str
    heights: np.ndarray
    """m, increasing; for logarithmic and power profiles, the height at which they end."""
    speed: np.ndarray
    """m/s, linear between `heights`."""
    from_: np.ndarray
    """Direction from which it comes, rad, linear between `heights`."""
    parameter: float = math.nan
    """Roughness length, m, of a logarithmic profile; exponent of a power law."""

    def _shape(self, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fraction of the reference speed above `LOWEST`, and its slope, 1/m, of a logarithmic or power profile."""
        if self.kind == "log":
            scale = 1.0 / math.log(REFERENCE / self.parameter)
            return scale * np.log(h / self.parameter), scale / h
        p = self.parameter
        share = (h / POWER_REFERENCE) ** p
        return share, p * share / h

    def at(self, height: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Speed and its slope by height, 1/s, direction and its slope, rad/m, at heights (n,), m."""
        h = np.asarray(height, dtype=float)
        if self.kind == "table":
            (speed, rise), (direction, turn) = self._linear(h, self.speed), self._linear(h, self.from_)
            return speed, rise, direction, turn
        if self.kind == "constant":
            none = np.zeros_like(h)
            return np.full_like(h, self.speed[0]), none, np.full_like(h, self.from_[0]), none
        # held at its value of LOWEST below it
        share, slope = self._shape(np.maximum(h, LOWEST))
        more, steeper = _rounded(h, LOWEST, float(self._shape(np.array(LOWEST))[1]), _ROUNDING)
        speed = self.speed[0] * (share + more)
        rise = self.speed[0] * (np.where(h > LOWEST, slope, 0.0) + steeper)
        return speed, rise, np.full_like(h, self.from_[0]), np.zeros_like(h)

    def _linear(self, h: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A table's values and their slopes, held beyond its ends."""
        slopes = np.concatenate([[0.0], np.diff(values) / np.diff(self.heights), [0.0]])
        out = np.interp(h, self.heights, values)
        slope = slopes[np.searchsorted(self.heights, h, side="right")]
        for corner, change, half in zip(self.heights, np.diff(slopes), self._halves, strict=True):
            more, steeper = _rounded(h, float(corner), float(change), float(half))
            out, slope = out + more, slope + steeper
        return out, slope

    @property
    def _halves(self) -> np.ndarray:
        """Half the stretches over which corners are rounded, m: not into those of their neighbours."""
        if self.kind != "table":
            return np.full(self.heights.size, _ROUNDING)
        gaps = np.concatenate([[math.inf], np.diff(self.heights), [math.inf]])
        return np.minimum(_ROUNDING, 0.5 * np.minimum(gaps[:-1], gaps[1:]))

    @property
    def corners(self) -> np.ndarray:
        """Heights, m, where the slopes have corners."""
        if self.kind == "constant":
            return np.empty(0)
        return np.sort(np.concatenate([self.heights - self._halves, self.heights + self._halves]))


def _rounded(h: np.ndarray, corner: float, change: float, half: float) -> tuple[np.ndarray, np.ndarray]:
    """Correction of a function, and of its slope, by a parabola over `corner` +- `half`, where its slope changes."""
    away = np.abs(h - corner)
    inside = np.maximum(half - away, 0.0)
    return change * inside**2 / (4.0 * half), -np.sign(h - corner) * change * inside / (2.0 * half)


def profiled(
    kind: str, speed: float, from_: float, parameter: float = math.nan, table: np.ndarray | None = None
) -> Profile:
    """A profile: `constant`; `log` by the speed at 20 ft and a roughness length, m; `power` by that at 10 m and an
    exponent; `table` (m, 3) of heights, speeds, directions, which turn the short way."""
    if table is not None:
        return Profile("table", table[:, 0], table[:, 1], np.unwrap(table[:, 2]))
    return Profile(kind, np.array([LOWEST]), np.array([speed]), np.array([from_]), parameter)


def crossings(path: AnyPath, heights: np.ndarray, end: float) -> np.ndarray:
    """Times, s, up to `end` when a path passes heights above the runway, m."""
    fine = np.linspace(0.0, end, max(2, math.ceil(end / 0.05)) + 1)
    above = -path.jet(fine)[:, 0, 2]
    out: list[float] = []
    for height in heights:
        for i in np.flatnonzero((above[:-1] > height) != (above[1:] > height)):
            low, high, falling = fine[i], fine[i + 1], above[i] > height
            for _ in range(50):
                middle = 0.5 * (low + high)
                if (-path.jet(np.array([middle]))[0, 0, 2] > height) == falling:
                    low = middle
                else:
                    high = middle
            out.append(float(high))
    return np.array(sorted(out))


@dataclass(frozen=True)
class MeanWind:
    """A profile along path axes that point to `heading`, rad."""

    profile: Profile
    heading: float

    def at(self, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The wind and its slope by height (n, 3), m/s, 1/s, at heights (n,), m."""
        speed, rise, from_, turn = self.profile.at(height)
        ahead = towards(np.ones_like(speed), from_, self.heading)
        aside = np.stack([-ahead[:, 1], ahead[:, 0], ahead[:, 2]], axis=1)
        return speed[:, None] * ahead, rise[:, None] * ahead + (speed * turn)[:, None] * aside


def over_runway(path: AnyPath, t: np.ndarray, jet: np.ndarray, rise: float) -> tuple[np.ndarray, np.ndarray]:
    """Heights (n,), m, of a path above the runway at times t, s, jet (n, 4, 3), and their rates.

    Before touchdown they are relative to the touchdown point, afterwards to a runway with this rise along the x axis, m
    a m.
    """
    slope = np.where(t >= path.events.get(TOUCHDOWN, math.inf), rise, 0.0)
    return -jet[:, 0, 2] - slope * jet[:, 0, 0], -jet[:, 1, 2] - slope * jet[:, 1, 0]


@dataclass(frozen=True)
class WindAlong:
    """A mean wind where a path is, by its height `over_runway`; the crab is taken out as of `kinematics.Wind`."""

    mean_wind: MeanWind
    path: AnyPath
    end: float
    decrab_start: float | None = None
    decrab_end: float | None = None
    rise: float = 0.0

    def mean(self, t: np.ndarray) -> np.ndarray:
        """Wind (n, 3), m/s, independent of the attitude."""
        return self.mean_wind.at(over_runway(self.path, t, self.path.jet(t), self.rise)[0])[0]

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The wind the attitude answers to, and its rate of change: (n, 3) m/s, m/s2."""
        height, climb = over_runway(self.path, t, self.path.jet(t), self.rise)
        wind, slope = self.mean_wind.at(height)
        rate = climb[:, None] * slope
        if self.decrab_start is None or self.decrab_end is None:
            return wind, rate
        keep, change = faded(t, self.decrab_start, self.decrab_end)
        return keep[:, None] * wind, keep[:, None] * rate + change[:, None] * wind

    @cached_property
    def knots(self) -> np.ndarray:
        """Times where a higher derivative jumps."""
        ends = [t for t in (self.decrab_start, self.decrab_end) if t is not None]
        return np.concatenate([np.array(ends), crossings(self.path, self.mean_wind.profile.corners, self.end)])


# --- the wind triangle


@dataclass(frozen=True)
class Triangle:
    """Wind triangle at n times. Without a horizontal course all but the airspeed are nan."""

    airspeed: np.ndarray
    """(n,) m/s."""
    crab: np.ndarray
    """(n,) angle of the nose to the right of the course, rad."""
    headwind: np.ndarray
    """(n,) m/s along the horizontal course."""
    crosswind: np.ndarray
    """(n,) m/s, from the left positive."""


def triangle(velocity: np.ndarray, wind: np.ndarray) -> Triangle:
    """Wind triangle of a flight at ground velocity (n, 3) in a wind (n, 3), m/s along path axes."""
    through = velocity - wind
    along, right = level_axes(velocity)
    crab = np.arctan2(np.sum(through * right, axis=1), np.sum(through * along, axis=1))
    return Triangle(np.linalg.norm(through, axis=1), crab, -np.sum(wind * along, axis=1), np.sum(wind * right, axis=1))


def triangle_along(trajectory: Trajectory, t: np.ndarray) -> Triangle:
    """Wind triangle of a trajectory in its mean wind at times (n,), s."""
    return triangle(trajectory.path.jet(t)[:, 1], trajectory.wind.mean(t))


def level_axes(velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal unit vectors (n, 3) along the course of velocity (n, 3) and to its right; nan at rest."""
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    speed = np.where(speed > 0.0, speed, np.nan)
    x, y, zero = velocity[:, 0] / speed, velocity[:, 1] / speed, np.zeros_like(speed)
    return np.stack([x, y, zero], axis=1), np.stack([-y, x, zero], axis=1)


def ground_speed(airspeed: np.ndarray, ahead: np.ndarray, wind: np.ndarray) -> np.ndarray:
    """Speed over ground (n,) along unit vectors (n, 3) at an airspeed (n,) in a wind (n, 3), m/s; nan where the wind
    across is no less than the airspeed."""
    along = np.sum(wind * ahead, axis=1)
    across2 = np.sum(wind**2, axis=1) - along**2
    with np.errstate(invalid="ignore"):
        return np.asarray(along + np.where(across2 < airspeed**2, np.sqrt(airspeed**2 - across2), np.nan))


# --- discrete gusts


@dataclass(frozen=True)
class Gust:
    """A 1 - cosine gust [1]: it rises, holds, and falls as it rose."""

    amplitude: float
    """m/s."""
    start: float
    """s."""
    ramp: float
    """Duration of the rise, s; with `by_way` its length through the air, m."""
    hold: float
    """s; infinite if it never falls."""
    towards: str
    """`north`, `east`, `up`; `wind`, the direction of the mean wind; `along` the course, level; or `right` of it."""
    by_way: bool = False

    def rise_time(self, airspeed: float) -> float:
        """Duration of the rise, s, at an airspeed, m/s."""
        return self.ramp / airspeed if self.by_way else self.ramp

    def at(self, t: np.ndarray, airspeed: float) -> np.ndarray:
        """Its speed at times (n,), s: m/s; airspeed: at its start, m/s."""
        ramp = self.rise_time(airspeed)
        since = np.clip((t - self.start) / ramp, 0.0, 1.0)
        left = np.clip((t - self.start - ramp - self.hold) / ramp, 0.0, 1.0)
        return 0.5 * self.amplitude * (np.cos(math.pi * left) - np.cos(math.pi * since))


# --- Dryden turbulence

MIL_F_8785C, MIL_HDBK_1797 = "mil-f-8785c", "mil-hdbk-1797"


def dryden_scales(height: np.ndarray, form: str = MIL_F_8785C) -> np.ndarray:
    """Lengths L_u, L_v, L_w (..., 3), m, at heights, m, in either form, which belong to its own spectrum: the same
    turbulence [1, 2, 3]."""
    feet = np.clip(height, TURBULENCE_LOWEST, HIGHEST) / FOOT
    along = feet / (0.177 + 0.000823 * feet) ** 1.2
    half = 1.0 if form == MIL_F_8785C else 0.5
    return FOOT * np.stack([along, half * along, half * feet], axis=-1)


def dryden_sigmas(height: np.ndarray, wind: float) -> np.ndarray:
    """1 sigma (..., 3) of u, v, w, m/s, at heights, m, by the wind at 20 ft, m/s."""
    feet = np.clip(height, TURBULENCE_LOWEST, HIGHEST) / FOOT
    down = np.full_like(feet, 0.1 * wind)
    across = down / (0.177 + 0.000823 * feet) ** 0.4
    return np.stack([across, across, down], axis=-1)


@dataclass(frozen=True)
class Process:
    """x' = A x + b n with n white of unit density: a (n, n), b (n,)."""

    a: np.ndarray
    b: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """Stationary (n, n)."""
        return stationary(self.a, self.b)


def dryden(time_scale: float, transverse: bool) -> tuple[Process, np.ndarray]:
    """Dryden gust of unit variance with time scale L/V, s (lengths of 8785C): process and output row (n,).

    The states have unit variance and keep their meaning while the scale changes.
    """
    t = time_scale
    if not transverse:
        return Process(np.array([[-1.0 / t]]), np.array([math.sqrt(2.0 / t)])), np.ones(1)
    # x1 / sqrt(T^3/4), x2 / sqrt(T/4) of the controllable form
    a = np.array([[0.0, 1.0], [-1.0, -2.0]]) / t
    return Process(a, np.array([0.0, 2.0 / math.sqrt(t)])), np.array([0.5, 0.5 * math.sqrt(3.0)])


@dataclass(frozen=True)
class Turbulence:
    """Dryden turbulence of low altitude by the wind at 20 ft, m/s. form: which specification's lengths and spectra;
    both are one model."""

    wind: float
    form: str = MIL_F_8785C

    def time_scales(self, height: np.ndarray, airspeed: np.ndarray) -> np.ndarray:
        """L/V of u, v, w (..., 3), s, as `dryden` takes them, at heights, m, and airspeeds, m/s (...)."""
        whole = np.array([1.0, 1.0, 1.0] if self.form == MIL_F_8785C else [1.0, 2.0, 2.0])  # 1797 has them by halves
        return np.asarray(whole * dryden_scales(height, self.form) / airspeed[..., None])

    def sigmas(self, height: np.ndarray) -> np.ndarray:
        """1 sigma of u, v, w (..., 3), m/s, at heights, m."""
        return dryden_sigmas(height, self.wind)


# --- response of an aircraft


def through(process: Process, row: np.ndarray, system: Process) -> Process:
    """A process, followed by a linear system that a row (n,) of its states drives instead of noise."""
    n, more = process.a.shape[0], system.a.shape[0]
    a, b = np.zeros((n + more, n + more)), np.zeros(n + more)
    a[:n, :n], b[:n] = process.a, process.b
    a[n:, :n], a[n:, n:] = np.outer(system.b, row), system.a
    return Process(a, b)


def two_lags(lag: float) -> Process:
    """Two first-order lags of `lag` s each in series: output and its rate."""
    return Process(np.array([[0.0, 1.0], [-1.0 / lag**2, -2.0 / lag]]), np.array([0.0, 1.0 / lag**2]))


def carried(lag: float, loop: float, nose_lag: float | None) -> Process:
    """Linear model of an aircraft in a gust, m/s, which drives it.

    - The velocity, m/s, that the gust alone causes, with a first-order `lag`, s.
    - Position, m, and velocity, m/s, under guidance: a critically damped loop of time constant `loop`, s.
    - With nose_lag, the speed through the air, m/s, that the nose follows (see `two_lags`), and its rate.
    """
    size = 3 if nose_lag is None else 5
    a, b = np.zeros((size, size)), np.zeros(size)
    a[0, 0], b[0] = -1.0 / lag, 1.0 / lag
    a[1, 2] = 1.0
    a[2, :3], b[2] = [-1.0 / lag, -1.0 / loop**2, -2.0 / loop], 1.0 / lag
    if nose_lag is not None:
        nose = two_lags(nose_lag)
        a[3:, 3:], a[3:, 2], b[3:] = nose.a, nose.b, -nose.b
    return Process(a, b)


def gust_lag(wing_loading: float, speed: np.ndarray, slope: float) -> np.ndarray:
    """Time constant, s, of an aircraft's velocity response to a gust: 2 (W/S) / (rho g V c).

    Wing loading in N/m2, speeds in m/s. slope: c, derivative of the force coefficient by the flow angle, 1/rad.
    """
    return np.asarray(2.0 * wing_loading / (AIR_DENSITY * GRAVITY * speed * slope))


@dataclass(frozen=True)
class Response:
    """Response of an aircraft to gusts and commands."""

    wing_loading: float
    """N/m2."""
    lift_slope: float
    """Lift curve slope, 1/rad."""
    side_slope: float
    """Derivative of the side force coefficient, 1/rad."""
    drag: float
    """Drag coefficient."""
    nose_lag: float
    """Each of two lags of the nose behind lateral and vertical gusts, s."""
    loop: float
    """Time constant of the guidance that corrects deviations by gusts, s."""
    bank_lag: float = 0.3
    """Each of two lags of the bank behind the lateral acceleration of flight-technical error, s."""

    def lags(self, airspeed: np.ndarray) -> np.ndarray:
        """`gust_lag` across the course, along it and in height (3, n), s, at airspeeds (n,), m/s: drag, by V^2, changes
        by twice its coefficient."""
        slopes = (self.side_slope, 2.0 * self.drag, self.lift_slope)
        return np.stack([gust_lag(self.wing_loading, airspeed, slope) for slope in slopes])


# --- flight-technical error


@dataclass(frozen=True)
class Deviation:
    """Flight-technical error across the path, along it or in height: third-order Gauss-Markov."""

    sigma: float
    """1 sigma at or above `height`, m. Below, it is proportional to the height above the runway."""
    time: float
    """Correlation time, s: integral of the normalised autocorrelation."""
    floor: float = 0.0
    """Added in squares to the proportional part, m."""
    height: float = math.inf
    """m; inf: constant sigma."""

    @property
    def beta(self) -> float:
        """Triple pole, 1/s."""
        return 8.0 / (3.0 * self.time)

    def process(self) -> Process:
        """Process of unit variance: error, rate, acceleration."""
        return third_order(self.beta)

    def scale(self, height: np.ndarray) -> np.ndarray:
        """1 sigma (3, n), m, and its first two derivatives, along heights (3, n), m, and theirs."""
        if not math.isfinite(self.height):
            out = np.zeros_like(height)
            out[0] = self.sigma
            return out
        u, u1, u2 = self.sigma / self.height * height
        if self.floor == 0.0:
            return np.stack([u, u1, u2])
        s = np.hypot(self.floor, u)
        s1 = u * u1 / s
        return np.stack([s, s1, (u1**2 + u * u2 - s1**2) / s])


def third_order(beta: float) -> Process:
    """The Gauss-Markov process of a triple pole at -beta and unit variance, driven by white jerk of density
    16/3 beta^5."""
    a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-(beta**3), -3.0 * beta**2, -3.0 * beta]])
    return Process(a, np.array([0.0, 0.0, math.sqrt(16.0 / 3.0 * beta**5)]))


@dataclass(frozen=True)
class Air:
    """Disturbances that move aircraft off the route, and the aircraft's response."""

    response: Response
    """Response of the aircraft."""
    lateral: Deviation | None = None
    """Flight-technical error across the course."""
    along: Deviation | None = None
    """Along the course."""
    vertical: Deviation | None = None
    """In height."""
    turbulence: Turbulence | None = None
    """Drawn for each run."""
    gusts: tuple[Gust, ...] = ()
    """The same for all runs."""
    autopilot: Autopilot | None = None
    """Steers each run by its own estimate; None: guidance has the truth."""
    go_around: AlarmGoAround | None = None
    """Breaks off a run after its own alarm; None: alarms change nothing."""
    rise: float = 0.0
    """Slope of the runway in the direction of landing, m a m."""

    @property
    def draws(self) -> int:
        """Numbers that are drawn at each time of a way."""
        technical = 5 * (self.lateral is not None) + 3 * ((self.along is not None) + (self.vertical is not None))
        return technical + 18 * (self.turbulence is not None)
