"""How flown ways deviate from a reference, each run in its own way: flight-technical error, turbulence, gusts.

`Air` says what there is (`navsim.models.air`); along a trajectory it becomes `Disturbance`, which draws a `Departure`
for each run; `deviated` is the motion of an aircraft on it. Equations: `docs/theory/air.md`, sections 3 to 5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.core.arrays import earth
from navsim.core.arrays.processes import discretised
from navsim.models.air import GRAVITY, Air, Deviation, Process, smoothed
from navsim.models.approach import TOUCHDOWN
from navsim.models.kinematics import EARTH_RATE, Frame, Motion, Trajectory

GROUNDED = 5.0
"""After touchdown the ground takes out deviations in height and in attitude within so long, s."""
_GRADIENT_STEP = 100.0
"""Baseline of the differences of gravity, m."""
LATERAL, ALONG, VERTICAL = range(3)
"""Parts of a deviation in axes of the course: to the right, ahead, up."""


@dataclass(frozen=True)
class Course:
    """A reference that moves at times (k,): unit vectors along path axes to the right of its course and ahead, level,
    each with its first two derivatives (3, k, 3); heights above the runway with theirs (3, k), m; the inverse of its
    airspeed and the rate of that (2, k); how much of what the air does is left, and its first two derivatives (3, k):
    the ground takes it after touchdown."""

    right: np.ndarray
    ahead: np.ndarray
    height: np.ndarray
    slowness: np.ndarray
    airborne: np.ndarray

    @classmethod
    def of(cls, trajectory: Trajectory, time: np.ndarray) -> Course:
        """That of a trajectory, which moves over ground everywhere."""
        jet = trajectory.path.jet(time)
        (vx, vy), (ax, ay), (jx, jy) = (jet[:, order, :2].T for order in (1, 2, 3))
        square = vx**2 + vy**2
        speed, zero = np.sqrt(square), np.zeros(time.size)
        ahead = np.stack([vx / speed, vy / speed, zero], axis=1)
        right = np.stack([-ahead[:, 1], ahead[:, 0], zero], axis=1)
        turn = (vx * ay - vy * ax) / square
        faster = ((vx * jy - vy * jx) - 2.0 * turn * (vx * ax + vy * ay)) / square
        turn, faster = turn[:, None], faster[:, None]
        airspeed = np.linalg.norm(jet[:, 1] - trajectory.wind.mean(time), axis=1)
        slowness = 1.0 / airspeed
        return cls(
            np.stack([right, -turn * ahead, -faster * ahead - turn**2 * right]),
            np.stack([ahead, turn * right, faster * right - turn**2 * ahead]),
            -jet[:, :3, 2].T,
            np.stack([slowness, np.gradient(slowness, time)]),
            _airborne(time, trajectory.path.events.get(TOUCHDOWN)),
        )


def _airborne(time: np.ndarray, touchdown: float | None) -> np.ndarray:
    """1 in the air, 0 on the ground, with derivatives (3, k); twice differentiable."""
    out = np.zeros((3, time.size))
    out[0] = 1.0
    if touchdown is not None:
        u = np.clip((time - touchdown) / GROUNDED, 0.0, 1.0)
        out[0] -= u**3 * (10.0 + u * (6.0 * u - 15.0))
        out[1] = -30.0 * u**2 * (1.0 - u) ** 2 / GROUNDED
        out[2] = -60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / GROUNDED**2
    return out


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """A product with its first two derivatives (3, ...), of factors with theirs (3, ...)."""
    return np.stack([a[0] * b[0], a[1] * b[0] + a[0] * b[1], a[2] * b[0] + 2.0 * a[1] * b[1] + a[0] * b[2]])


@dataclass(frozen=True)
class Departure:
    """Deviations of runs at times (k,), s, equally spaced: way (k, 9, W) place (m), velocity and acceleration along
    path axes; turn (k, 6, W) Gibbs vector of the attitude in the reference's body axes, and its rate."""

    time: np.ndarray
    way: np.ndarray
    turn: np.ndarray

    def at(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`way` and `turn` at times (m,): between samples the quintic, and the cubic, of both ends."""
        h = float(self.time[1] - self.time[0])
        first = np.clip(np.searchsorted(self.time, time + 1e-9, side="right") - 1, 0, self.time.size - 2)
        s = np.clip(time - self.time[first], 0.0, h)[:, None, None]
        (p0, v0, a0), (p1, v1, a1) = (np.split(self.way[i], 3, axis=1) for i in (first, first + 1))
        away, b0, b1 = p1 - p0, 0.5 * h * a0, 0.5 * h * a1
        c3 = (10.0 * away / h - 6.0 * v0 - 4.0 * v1 - 3.0 * b0 + b1) / h**2
        c4 = (-15.0 * away / h + 8.0 * v0 + 7.0 * v1 + 3.0 * b0 - 2.0 * b1) / h**3
        c5 = (6.0 * away / h - 3.0 * (v0 + v1) - b0 + b1) / h**4
        place = p0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5))))
        velocity = v0 + s * (a0 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))
        acceleration = a0 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))
        (p0, v0), (p1, v1) = (np.split(self.turn[i], 2, axis=1) for i in (first, first + 1))
        c2, c3 = (3.0 * (p1 - p0) / h - 2.0 * v0 - v1) / h, (-2.0 * (p1 - p0) / h + v0 + v1) / h**2
        turn = p0 + s * (v0 + s * (c2 + s * c3))
        rate = v0 + s * (2.0 * c2 + s * 3.0 * c3)
        return np.concatenate([place, velocity, acceleration], axis=1), np.concatenate([turn, rate], axis=1)


@dataclass(frozen=True)
class Walk:
    """A process in exact steps between times (k,): transition, root (m, n, n), which (k - 1,) of them each step takes,
    start (n, n) root of its stationary covariance."""

    transition: np.ndarray
    root: np.ndarray
    which: np.ndarray
    start: np.ndarray

    @classmethod
    def of(cls, processes: list[Process], which: np.ndarray, step: float) -> Walk:
        """That of processes with the same states, by the one of each step of so many s."""
        parts = [discretised(p.a, p.b, step) for p in processes]
        transition, root = (np.stack(m) for m in zip(*parts, strict=True))
        return cls(transition, root, which, np.linalg.cholesky(processes[which[0]].covariance))

    def drawn(self, rngs: tuple[np.random.Generator, ...], count: int) -> np.ndarray:
        """States (k, n, W) of the first `count` of W runs."""
        from navsim.core.noise import walk  # compiled code only when something is really simulated

        out = np.zeros((self.which.size + 1, self.start.shape[0], len(rngs)))
        walk(rngs, count, self.transition, self.root, self.which, self.start, out)
        return out


@dataclass(frozen=True)
class Disturbance:
    """What a trajectory meets at times (k,), s, equally spaced: `of` makes it. walks: by the number of their random
    stream. gradient: (k, 3, 3) of gravity along path axes, 1/s2."""

    time: np.ndarray
    frame: Frame
    course: Course
    air: Air
    walks: dict[int, Walk]
    gradient: np.ndarray
    pitches: bool

    @classmethod
    def of(cls, air: Air, trajectory: Trajectory, time: np.ndarray) -> Disturbance:
        """That of some air around a trajectory."""
        course, step = Course.of(trajectory, time), float(time[1] - time[0])
        same = np.zeros(time.size - 1, np.int64)
        walks = {}
        for number, deviation in enumerate((air.lateral, air.along, air.vertical)):
            if deviation is not None:
                process = deviation.process()
                if number == LATERAL:
                    process = smoothed(process, np.array([0.0, 0.0, 1.0]), air.response.bank_lag)
                walks[number] = Walk.of([process], same, step)
        position = trajectory.path.jet(time)[:, 0] @ trajectory.frame.axes.T + trajectory.frame.origin
        return cls(
            time, trajectory.frame, course, air, walks, _gradient(position, trajectory.frame),
            trajectory.pitch_follows_path,
        )  # fmt: skip

    def drawn(self, rngs: dict[int, tuple[np.random.Generator, ...]], count: int) -> Departure:
        """Departures of the first `count` of W runs; rngs: W generators for each of the walks."""
        lanes = len(next(iter(rngs.values())))
        way, turn = np.zeros((self.time.size, 9, lanes)), np.zeros((self.time.size, 6, lanes))
        course, air = self.course, self.air
        states = {number: walk.drawn(rngs[number], count) for number, walk in self.walks.items()}
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
            if self.pitches:  # the nose follows the way through the air
                self._turn(turn, 1, up[1], up[2])
        return Departure(self.time, way, turn)

    def _across(self, deviation: Deviation, states: np.ndarray, way: np.ndarray, turn: np.ndarray) -> None:
        """Adds a deviation across the course: the nose follows the way, the bank its acceleration."""
        scale = deviation.scale(self.course.height)[..., None]
        of_states = states.transpose(1, 0, 2)
        right = _product(scale, of_states[:3])
        _add(way, right, self.course.right)
        self._turn(turn, 2, right[1], right[2])
        air = self.course.airborne[..., None]
        bank = scale[0] * of_states[3]
        rate = scale[1] * of_states[3] + scale[0] * of_states[4]
        turn[:, 0] += air[0] * bank * (0.5 / GRAVITY)
        turn[:, 3] += (air[1] * bank + air[0] * rate) * (0.5 / GRAVITY)

    def _turn(self, turn: np.ndarray, axis: int, speed: np.ndarray, acceleration: np.ndarray) -> None:
        """Adds the turn about a body axis of a nose that follows a speed (k, W) across its way, m/s."""
        slow, slower = self.course.slowness[..., None]
        turn[:, axis] += 0.5 * slow * speed
        turn[:, 3 + axis] += 0.5 * (slow * acceleration + slower * speed)


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


def deviated(reference: Motion, frame: Frame, way: np.ndarray, turn: np.ndarray) -> Motion:
    """The motion of W runs, one after the other (W m), that deviate from a reference (m,) by `way` (m, 9, W), `turn`
    (m, 6, W), see `Departure`."""
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
    felt = acceleration @ to_ecef + 2.0 * np.cross(EARTH_RATE, speed)
    felt -= earth.gravity_at(llh) - earth.gravity_ecef(old)
    turned = _of_gibbs(gibbs)
    c_eb = each(reference.c_eb)
    force = each(reference.specific_force) + np.einsum("nji,nj->ni", c_eb, felt)
    scale = 2.0 / (1.0 + np.sum(gibbs**2, axis=1, keepdims=True))
    own = np.einsum("nji,nj->ni", turned, each(reference.angular_rate))
    return Motion(
        time=each(reference.time),
        position_ecef=position,
        velocity_ecef=each(reference.velocity_ecef) + speed,
        llh=llh,
        c_eb=c_eb @ turned,
        specific_force=np.einsum("nji,nj->ni", turned, force),
        angular_rate=own + scale * (rate - np.cross(gibbs, rate)),
    )


def _of_gibbs(h: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3) of Gibbs vectors (n, 3)."""
    zero = np.zeros(h.shape[0])
    x, y, z = h.T
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    scale = 2.0 / (1.0 + np.sum(h**2, axis=1))
    return np.eye(3) + scale[:, None, None] * (cross + cross @ cross)
