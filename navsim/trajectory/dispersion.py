"""Deviations of runs from a reference: flight-technical error, turbulence, gusts, errors of an autopilot's estimates.

`Air` describes the causes (`navsim.trajectory.air`). Along a trajectory it becomes a `Disturbance`, which draws a
`PathDeviation` for each run; `deviated` is the resulting motion. Equations: `docs/theory/air.md`, sections 3 to 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from navsim.compiler.lanes import in_lanes
from navsim.geodesy import earth
from navsim.trajectory.air import GRAVITY, Air, Deviation, through, two_lags
from navsim.trajectory.guidance import GuidanceErrors, steered
from navsim.trajectory.gust_response import Buffeting, buffeting
from navsim.trajectory.kinematics import EARTH_RATE, Frame, Motion, Trajectory
from navsim.trajectory.track_frame import ALONG, LATERAL, VERTICAL, Course, Walk

_GRADIENT_STEP = 100.0
"""Baseline of the differences of gravity, m."""
_TURBULENCE = 3
"""Offset from the number of an axis to the random stream of its turbulence."""


_OF_RUNS = ("way", "turn", "gust", "begin", "displaced")
"""Fields of `PathDeviation` that have lanes."""


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A product with its first two derivatives (3, ...), of factors with theirs (3, ...)."""
    return np.stack([a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2]])


@dataclass(frozen=True)
class PathDeviation:
    """Deviations of runs from the route at equally spaced times."""

    time: np.ndarray
    """(k,) s."""
    way: np.ndarray
    """(k, 9, W) position (m), velocity and acceleration along path axes."""
    turn: np.ndarray
    """(k, 6, W) Gibbs vector of the attitude in the reference's body axes, and its rate."""
    gust: np.ndarray
    """(k, 3, W) wind minus the mean wind, m/s, to the right of the course, along it, up."""
    begin: np.ndarray = field(default_factory=lambda: np.array(np.inf))
    """(W,) or () when runs begin a go-around after an alarm, s; inf for none."""
    displaced: np.ndarray = field(default_factory=lambda: np.empty((0, 3, 2, 1)))
    """(k, 3, 2, W) displacement by gusts that an autopilot corrects where it knows it: lateral, along, up, m, and its
    rate, m/s, along axes of the course. (0, ...) without an autopilot or gusts."""

    def where(self, kept: np.ndarray, other: PathDeviation) -> PathDeviation:
        """These deviations in the lanes (W,) that are kept, and others elsewhere."""
        if not kept.any():
            return other
        pairs = ((getattr(self, name), getattr(other, name)) for name in _OF_RUNS)
        return PathDeviation(self.time, *(np.where(kept, own, new) for own, new in pairs))

    def lane(self, i: int) -> PathDeviation:
        """Copy of one lane."""
        begin = np.broadcast_to(self.begin, self.way.shape[2:])
        parts = self.way, self.turn, self.gust, begin, self.displaced
        return PathDeviation(self.time, *(m[..., i : i + 1].copy() for m in parts))

    @classmethod
    def of_lanes(cls, each: Sequence[PathDeviation], lanes: int) -> PathDeviation:
        """Deviations of one lane in the first of so many; further lanes repeat the last."""
        every = [*each, *[each[-1]] * (lanes - len(each))]
        parts = ([getattr(one, name) for one in every] for name in _OF_RUNS)
        return cls(each[0].time, *(np.concatenate(part, axis=-1) for part in parts))

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`way` and `turn` at times (m,): between samples the quintic, and the cubic, of both ends."""
        from navsim.trajectory.departure_kernels import interpolate  # compiled code only when something is simulated

        first, since, h = self._since(time)
        way, turn = (np.empty((time.size, *m.shape[1:])) for m in (self.way, self.turn))
        lanes = (in_lanes(m) for m in (self.way, self.turn, way, turn))
        interpolate(first, since, np.array([h, h**2, h**3, h**4]), *lanes)
        return way, turn

    def gust_at(self, time: np.ndarray) -> np.ndarray:
        """`gust` at times (m,): between samples on the straight line."""
        first, s, h = self._since(time)
        return np.asarray(self.gust[first] + s[:, None, None] / h * (self.gust[first + 1] - self.gust[first]))

    def _since(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """The samples before times (m,), the time since them (m,), and that between samples."""
        h = float(self.time[1] - self.time[0])
        first = np.clip(np.searchsorted(self.time, time + 1e-9, side="right") - 1, 0, self.time.size - 2)
        return first, np.clip(time - self.time[first], 0.0, h), h


@dataclass(frozen=True)
class Disturbance:
    """Disturbances along a trajectory at equally spaced times; `of` creates it."""

    time: np.ndarray
    """(k,) s."""
    frame: Frame
    course: Course
    air: Air
    walks: dict[int, Walk]
    """By number of their random stream."""
    buffeting: dict[int, Buffeting]
    """By axis."""
    gradient: np.ndarray
    """(k, 3, 3) gravity gradient along path axes, 1/s2."""
    slope: np.ndarray
    """(2, k) climb of the route per metre ahead, and its rate, 1/s."""
    pitches: bool
    """Whether the nose follows the path."""

    @classmethod
    def of(cls, air: Air, trajectory: Trajectory, time: np.ndarray) -> Disturbance:
        """Disturbances in this air along a trajectory."""
        course, step = Course.of(trajectory, time), float(time[1] - time[0])
        same = np.zeros(time.size - 1, np.int64)
        walks = {}
        for number, deviation in enumerate((air.lateral, air.along, air.vertical)):
            if deviation is not None:
                process = deviation.process()
                if number == LATERAL:
                    process = through(process, np.array([0.0, 0.0, 1.0]), two_lags(air.response.bank_lag))
                walks[number] = Walk.of([process], same, step)
        buffeted = buffeting(air, trajectory, time, course)
        walks |= {_TURBULENCE + axis: one.walk for axis, one in buffeted.items() if one.walk is not None}
        position = trajectory.path.jet(time)[:, 0] @ trajectory.frame.axes.T + trajectory.frame.origin
        return cls(
            time, trajectory.frame, course, air, walks, buffeted, _gradient(position, trajectory.frame),
            _slope(trajectory, time), trajectory.pitch_follows_path,
        )  # fmt: skip

    def drawn(
        self,
        rngs: dict[int, tuple[np.random.Generator, ...]],
        count: int,
        lanes: int,
        shift: dict[int, np.ndarray] | None = None,
    ) -> PathDeviation:
        """Departures of the first `count` of so many runs, W, without guidance.

        rngs: W generators for each of the walks. shift: added to the states (k, n, W) of the walks.
        """
        states = {number: walk.drawn(rngs[number], count) for number, walk in self.walks.items()}
        if shift is not None:
            states = {number: own + shift[number] for number, own in states.items()}
        return self.of_states(states, lanes)

    @property
    def at_rest(self) -> PathDeviation:
        """Departure (one lane) of a run whose walks are zero: that of the discrete gusts."""
        of_walks = ((number, walk.start.shape[0]) for number, walk in self.walks.items())
        return self.of_states({number: np.zeros((self.time.size, n, 1)) for number, n in of_walks}, 1)

    def guided(self, departure: PathDeviation, known: GuidanceErrors | None) -> PathDeviation:
        """Copy of departures with the effect of guidance; known: errors of the estimates of its autopilot, None: it has
        exact ones, or there is none."""
        way, turn = departure.way.copy(), departure.turn.copy()
        if known is None and len(departure.displaced):
            known = GuidanceErrors(np.zeros(1, int), np.zeros((1, 6, way.shape[2])))
        if known is not None:
            assert self.air.autopilot is not None
            step = float(self.time[1] - self.time[0])
            steered(self.air.autopilot, known, self.course, self.slope, step, self.pitches, way, turn,
                    departure.displaced)  # fmt: skip
        return replace(departure, way=way, turn=turn)

    def of_states(self, states: dict[int, np.ndarray], lanes: int) -> PathDeviation:
        """Departures of so many runs, W, by the states (k, n, W) of their walks, without guidance."""
        way, turn = np.zeros((self.time.size, 9, lanes)), np.zeros((self.time.size, 6, lanes))
        course, air = self.course, self.air
        if air.lateral is not None:
            self._across(air.lateral, states[LATERAL], way, turn)
        if air.along is not None:
            scale = air.along.scale(course.height)[..., None]
            _add(way, _product(scale, states[ALONG].transpose(1, 0, 2)), course.ahead)
        if air.vertical is not None:
            scale = _product(air.vertical.scale(course.height), course.airborne)[..., None]
            up = _product(scale, states[VERTICAL].transpose(1, 0, 2))
            for order in range(3):
                way[:, 3 * order + 2] -= up[order]
            if self.pitches:  # the nose follows the airspeed vector
                self._turn(turn, 1, up[1], up[2])
        gust = np.zeros((self.time.size, 3, lanes))
        corrected = self.buffeting and air.autopilot is not None
        displaced = np.zeros((self.time.size if corrected else 0, 3, 2, lanes))
        for axis, met in self.buffeting.items():
            own = states.get(_TURBULENCE + axis)
            gust[:, axis] = met.blowing(own)
            self._buffeted(axis, met, own, way, turn, displaced)
        return PathDeviation(self.time, way, turn, gust, displaced=displaced)

    def _across(self, deviation: Deviation, states: np.ndarray, way: np.ndarray, turn: np.ndarray) -> None:
        """Add a deviation across the course: the nose follows the trajectory, the bank its acceleration."""
        scale = deviation.scale(self.course.height)[..., None]
        of_states = states.transpose(1, 0, 2)
        right = _product(scale, of_states[:3])
        _add(way, right, self.course.right)
        self._turn(turn, 2, right[1], right[2])
        self._bank(turn, scale[0] * of_states[3], scale[1] * of_states[3] + scale[0] * of_states[4])

    def _buffeted(
        self, axis: int, met: Buffeting, states: np.ndarray | None, way: np.ndarray, turn: np.ndarray,
        displaced: np.ndarray,
    ) -> None:  # fmt: skip
        """Add the effect of gusts along an axis of the course.

        The nose follows the airspeed vector with a lag; guidance determines the bank. Vertical motion fades to zero at
        the height of the runway: with an autopilot its velocity, since the autopilot has answered what was before.
        """
        moved, nose = met.moved(states)
        airborne, free = self.course.airborne[..., None], self.course.free()[..., None]
        if len(displaced):
            moved = _slowed(free, moved, float(self.time[1] - self.time[0])) if axis == VERTICAL else moved
            displaced[:, axis] = moved[:2].transpose(1, 0, 2)
        if axis == VERTICAL:
            moved = _product(airborne if len(displaced) else _product(airborne, free), moved)
            for order in range(3):
                way[:, 3 * order + 2] -= moved[order]
            if self.pitches:
                self._turn(turn, 1, airborne[0] * nose[0], airborne[1] * nose[0] + airborne[0] * nose[1])
            return
        _add(way, moved, self.course.right if axis == LATERAL else self.course.ahead)
        if axis == LATERAL:
            self._turn(turn, 2, *nose)
            self._bank(turn, met.guided(moved), met.guided(moved[1:]))

    def _bank(self, turn: np.ndarray, acceleration: np.ndarray, rate: np.ndarray) -> None:
        """Add the bank for an acceleration to the right (k, W), m/s2, and its rate, m/s3, while the aircraft is
        airborne."""
        airborne = self.course.airborne[..., None]
        turn[:, 0] += airborne[0] * acceleration * (0.5 / GRAVITY)
        turn[:, 3] += (airborne[1] * acceleration + airborne[0] * rate) * (0.5 / GRAVITY)

    def _turn(self, turn: np.ndarray, axis: int, speed: np.ndarray, acceleration: np.ndarray) -> None:
        """Adds the turn about a body axis of a nose that follows a speed (k, W) across its way, m/s."""
        slow, slower = self.course.slowness[..., None]
        turn[:, axis] += 0.5 * slow * speed
        turn[:, 3 + axis] += 0.5 * (slow * acceleration + slower * speed)


def _slowed(factor: np.ndarray, moved: np.ndarray, step: float) -> np.ndarray:
    """A motion with two derivatives (3, k, W), every `step` s, whose velocity is multiplied by a factor with its
    derivatives (3, k, 1): the product, less the integral of factor' times the motion, by Hermite's cubic."""
    out = _product(factor, moved)
    lost, change = factor[1] * moved[0], factor[2] * moved[0] + factor[1] * moved[1]
    out[0, 1:] -= np.cumsum(0.5 * step * (lost[:-1] + lost[1:]) + step**2 / 12.0 * (change[:-1] - change[1:]), axis=0)
    out[1], out[2] = factor[0] * moved[1], factor[0] * moved[2] + factor[1] * moved[1]
    return out


def _add(way: np.ndarray, amount: np.ndarray, direction: np.ndarray) -> None:
    """Adds to a `way` (k, 9, W) an amount (3, k, W) along a level unit vector (3, k, 3), with two derivatives each."""
    for axis in range(2):
        part = _product(amount, direction[..., axis, None])
        for order in range(3):
            way[:, 3 * order + axis] += part[order]


def _gradient(position: np.ndarray, frame: Frame) -> np.ndarray:
    """Change of gravity by place (k, 3, 3), along path axes, 1/s2, at positions (k, 3), ECEF, m."""
    half = 0.5 * _GRADIENT_STEP
    columns = [
        (earth.gravity_ecef(position + half * axis) - earth.gravity_ecef(position - half * axis)) / _GRADIENT_STEP
        for axis in frame.axes.T
    ]
    return np.ascontiguousarray(frame.axes.T @ np.stack(columns, axis=-1))


def _slope(trajectory: Trajectory, time: np.ndarray) -> np.ndarray:
    """Climb per metre ahead, and its rate, 1/s (2, k), at times (k,)."""
    jet = trajectory.path.jet(time)
    velocity, acceleration = jet[:, 1], jet[:, 2]
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    faster = np.sum(velocity[:, :2] * acceleration[:, :2], axis=1) / speed
    return np.stack([-velocity[:, 2] / speed, (velocity[:, 2] * faster / speed - acceleration[:, 2]) / speed])


def deviated(reference: Motion, frame: Frame, way: np.ndarray, turn: np.ndarray, force: bool = True) -> Motion:
    """The motion of W runs, one after the other (W m), that deviate from a reference (m,) by `way` (m, 9, W), `turn`
    (m, 6, W), see `PathDeviation`.

    force: with the specific force, which takes half of the time; without, it is nan."""
    lanes = way.shape[2]
    place, velocity, acceleration, gibbs, rate = (
        part.transpose(2, 0, 1).reshape(-1, 3) for part in (*np.split(way, 3, axis=1), *np.split(turn, 2, axis=1))
    )

    def each(values: np.ndarray) -> np.ndarray:
        return np.tile(values, (lanes, *[1] * (values.ndim - 1)))

    to_ecef = frame.axes.T
    old = each(reference.position_ecef)
    position, speed = old + place @ to_ecef, velocity @ to_ecef
    llh = earth.llh_from_ecef(position)
    turned = _of_gibbs(gibbs)
    c_eb, specific_force = each(reference.c_eb), np.full(position.shape, np.nan)
    if force:
        felt = acceleration @ to_ecef + 2.0 * np.cross(EARTH_RATE, speed)
        felt -= earth.gravity_at(llh) - earth.gravity_ecef(old)
        own = each(reference.specific_force) + np.einsum("nji,nj->ni", c_eb, felt)
        specific_force = np.einsum("nji,nj->ni", turned, own)
    scale = 2.0 / (1.0 + np.sum(gibbs**2, axis=1, keepdims=True))
    own = np.einsum("nji,nj->ni", turned, each(reference.angular_rate))
    return Motion(
        time=each(reference.time),
        position_ecef=position,
        velocity_ecef=each(reference.velocity_ecef) + speed,
        llh=llh,
        c_eb=c_eb @ turned,
        specific_force=specific_force,
        angular_rate=own + scale * (rate - np.cross(gibbs, rate)),
    )


def _of_gibbs(h: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of Gibbs vectors (n, 3)."""
    zero = np.zeros(h.shape[0])
    x, y, z = h.T
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    scale = 2.0 / (1.0 + np.sum(h**2, axis=1))
    return np.eye(3) + scale[:, None, None] * (cross + cross @ cross)
