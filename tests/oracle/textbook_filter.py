"""An error-state Kalman filter of textbooks, which shares no code with navsim and judges its filters.

It mechanises in ECEF axes, where navsim does in local level ones; it predicts the covariance once an interval between
measurements, where navsim does it each sample; and it follows many runs at once, an axis of every array.

Sources: [1] Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed. (2013):
sections 2.4 (Earth), 5.3 (ECEF mechanisation), 14.2.3 (ECEF error model), 14.3 (measurements). [2] Titterton & Weston,
Strapdown Inertial Navigation Technology, 2nd ed. (2004), section 3.6 (rotation vectors). [3] Mueller, Hehn & D'Andrea,
JGCD 40 (2017): the covariance after a correction of attitude. [4] Sola, arXiv 1711.02508: left Jacobians.
The steady specific force is by the description of it in docs/theory/steady-force.md.

Errors are truth minus estimate: position, velocity and attitude in ECEF axes, biases of gyros and accelerometers in
body axes, then those of the receiver's clock.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

_A, _FLATTENING = 6378137.0, 1.0 / 298.257223563
_E2 = _FLATTENING * (2.0 - _FLATTENING)
_RATE = 7.292115e-5
_EARTH = np.array([0.0, 0.0, _RATE])
_CHUNK = 10
"""Samples of which the covariance is predicted at once."""
POS, VEL, ATT, GYRO, ACCEL = (slice(k, k + 3) for k in range(0, 15, 3))


def cross(v: np.ndarray) -> np.ndarray:
    """Matrices [v x] (..., 3, 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return out - out.swapaxes(-1, -2)


def rotation(v: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) by vectors (..., 3), rad [2]."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    k = cross(v)
    return np.asarray(np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * (k @ k))


def left_jacobian(v: np.ndarray) -> np.ndarray:
    """What is left of a small error of attitude after a correction by v (..., 3), rad: the mean of the rotations on the
    way there [4], by Gauss-Legendre quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    return np.asarray(sum(0.5 * w * rotation((0.5 + 0.5 * x) * v) for x, w in zip(nodes, weights, strict=True)))


def ecef(llh: np.ndarray) -> np.ndarray:
    """ECEF positions of geodetic ones (..., 3), rad, rad, m ([1], eq. 2.112)."""
    lat, lon, h = np.moveaxis(llh, -1, 0)
    east = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    level = (east + h) * np.cos(lat)
    return np.stack([level * np.cos(lon), level * np.sin(lon), ((1.0 - _E2) * east + h) * np.sin(lat)], axis=-1)


def geodetic(r: np.ndarray) -> np.ndarray:
    """Latitude, longitude, height of ECEF positions (..., 3), by iteration from a sphere's."""
    level = np.hypot(r[..., 0], r[..., 1])
    lat = np.arctan2(r[..., 2], level * (1.0 - _E2))
    for _ in range(4):
        east = _A / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
        lat = np.arctan2(r[..., 2] + _E2 * east * np.sin(lat), level)
    height = level * np.cos(lat) + r[..., 2] * np.sin(lat) - _A * np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return np.stack([lat, np.arctan2(r[..., 1], r[..., 0]), height], axis=-1)


def level_axes(llh: np.ndarray) -> np.ndarray:
    """North, east and down as columns in ECEF axes (..., 3, 3) ([1], eq. 2.150)."""
    lat, lon = llh[..., 0], llh[..., 1]
    sin, cos, out = np.sin(lat), np.cos(lat), np.zeros((*lat.shape, 3, 3))
    out[..., 0, 0], out[..., 1, 0], out[..., 2, 0] = -sin * np.cos(lon), -sin * np.sin(lon), cos
    out[..., 0, 1], out[..., 1, 1] = -np.sin(lon), np.cos(lon)
    out[..., 0, 2], out[..., 1, 2], out[..., 2, 2] = -cos * np.cos(lon), -cos * np.sin(lon), -sin
    return out


def attitude(rpy: np.ndarray) -> np.ndarray:
    """Body to level axes (..., 3, 3) of roll, pitch and yaw (..., 3), rad ([1], eq. 2.24)."""
    about = [rotation(rpy[..., k, None] * np.eye(3)[k]) for k in range(3)]
    return about[2] @ about[1] @ about[0]


def gravity(llh: np.ndarray) -> np.ndarray:
    """Gravity downwards (...), m/s2: Somigliana's at height 0 ([1], eq. 2.134), less with height (eq. 2.139)."""
    square, h = np.sin(llh[..., 0]) ** 2, llh[..., 2]
    ground = 9.7803253359 * (1.0 + 0.001931853 * square) / np.sqrt(1.0 - _E2 * square)
    ratio = _RATE**2 * _A**3 * (1.0 - _FLATTENING) / 3.986004418e14
    return np.asarray(
        ground * (1.0 - 2.0 / _A * (1.0 + _FLATTENING * (1.0 - 2.0 * square) + ratio) * h + 3.0 * (h / _A) ** 2)
    )


@dataclass(frozen=True)
class Sensors:
    """What the filter is told: 1 sigma per axis at the start, of position (m), velocity (m/s), attitude (rad), gyro
    (rad/s) and accelerometer biases (m/s2); noise of gyros and accelerometers per sample, rad/s and m/s2; s between
    samples; lever arm (3,), m."""

    start: tuple[float, float, float, float, float]
    gyro_noise: float
    accel_noise: float
    step: float
    lever_arm: np.ndarray = field(default_factory=lambda: np.zeros(3))
    clock_noise: tuple[float, float] = (0.0, 0.0)
    """Densities of the receiver clock's frequency noise, m2/s, and of the noise of its drift, m2/s3."""


@dataclass
class TextbookFilter:
    """Filters of R runs: r, v (R, 3) and c (R, 3, 3), body to ECEF axes; biases (R, 3); clock (R, k); p (R, n, n)."""

    sensors: Sensors
    r: np.ndarray
    v: np.ndarray
    c: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    clock: np.ndarray
    p: np.ndarray
    rate: np.ndarray
    """Angular rate (R, 3) of the last sample, freed of its bias, rad/s."""

    @classmethod
    def begun(
        cls, sensors: Sensors, llh: np.ndarray, velocity: np.ndarray, rpy: np.ndarray, clock: np.ndarray | None = None,
        clock_sigma: tuple[float, ...] = (),
    ) -> TextbookFilter:  # fmt: skip
        """At positions (R, 3), rad, rad, m, velocities, NED, and roll, pitch, yaw, and estimates of a clock (R, k)."""
        axes, runs = level_axes(llh), llh.shape[0]
        sigma = np.concatenate([np.repeat(sensors.start, 3), clock_sigma])
        return cls(
            sensors, ecef(llh), (axes @ velocity[..., None])[..., 0], axes @ attitude(rpy),
            np.zeros((runs, 3)), np.zeros((runs, 3)), np.zeros((runs, 0)) if clock is None else clock,
            np.tile(np.diag(sigma**2), (runs, 1, 1)), np.zeros((runs, 3)),
        )  # fmt: skip

    def predict(self, angles: np.ndarray, velocities: np.ndarray) -> None:
        """Go on by samples (R, k, 3) of angle and of velocity."""
        for first in range(0, angles.shape[1], _CHUNK):
            part = slice(first, first + _CHUNK)
            self._predict(angles[:, part], velocities[:, part])

    def _predict(self, angles: np.ndarray, velocities: np.ndarray) -> None:
        dt, count = self.sensors.step, angles.shape[1]
        turns = angles - dt * self.gyro[:, None]
        self.rate = turns[:, -1] / dt
        felt = velocities - dt * self.accel[:, None]
        whole, half, earth = rotation(turns), rotation(0.5 * turns), rotation(-dt * _EARTH)
        middle = np.empty((*angles.shape, 3))
        for k in range(count):
            middle[:, k] = self.c @ half[:, k]
            self.c = earth @ self.c @ whole[:, k]
        pushed = (middle @ felt[..., None])[..., 0]
        # gravity where the samples are, Coriolis by the velocity of their beginning and what they are pushed by
        since = dt * (np.arange(count) + 0.5)[None, :, None]
        llh = geodetic(self.r[:, None] + since * self.v[:, None])
        down = gravity(llh)[..., None] * level_axes(llh)[..., 2]
        near = self.v[:, None] + np.cumsum(pushed + dt * down, axis=1) - 0.5 * (pushed + dt * down)
        changes = pushed + dt * (down - 2.0 * np.cross(_EARTH, near))
        after = self.v[:, None] + np.cumsum(changes, axis=1)
        self.r = self.r + dt * (after - 0.5 * changes).sum(axis=1)
        self.v = after[:, -1]
        self._predict_covariance(middle, pushed, down[:, -1])

    def _predict_covariance(self, middle: np.ndarray, pushed: np.ndarray, down: np.ndarray) -> None:
        """middle: attitudes of samples (R, k, 3, 3), pushed: velocity (R, k, 3) by the specific force, ECEF axes."""
        dt, n = self.sensors.step, self.p.shape[1]
        runs, count = pushed.shape[:2]
        span = count * dt
        left = dt * (count - 0.5 - np.arange(count))  # from the middle of each sample to the end
        phi = np.tile(np.eye(n), (runs, 1, 1))
        phi[:, POS, VEL] = span * np.eye(3)
        phi[:, VEL, ATT] = -cross(pushed.sum(axis=1))
        phi[:, POS, ATT] = -cross(np.einsum("rkx,k->rx", pushed, left))
        turned = dt * (np.cumsum(middle, axis=1) - 0.5 * middle)  # attitude by a gyro bias, until each sample
        by_gyro = cross(pushed) @ turned
        phi[:, ATT, GYRO] = -dt * middle.sum(axis=1)
        phi[:, VEL, GYRO] = by_gyro.sum(axis=1)
        phi[:, POS, GYRO] = np.einsum("rkxy,k->rxy", by_gyro, left)
        phi[:, VEL, ACCEL] = -dt * middle.sum(axis=1)
        phi[:, POS, ACCEL] = -dt * np.einsum("rkxy,k->rxy", middle, left)
        # the Earth turns, and gravity changes with position ([1], eq. 14.49)
        small = np.zeros((runs, n, n))
        small[:, ATT, ATT] = -span * cross(_EARTH)
        small[:, VEL, VEL] = -2.0 * span * cross(_EARTH)
        up = self.r / np.linalg.norm(self.r, axis=1)[:, None]
        small[:, VEL, POS] = -2.0 * span / _A * down[:, :, None] * up[:, None, :]
        if n > 15:
            phi[:, 15:-1, -1] = span
        phi = phi + small @ phi
        # white noise of each sample until the end
        rest = pushed.sum(axis=1)[:, None] - np.cumsum(pushed, axis=1) + 0.5 * pushed
        later = np.einsum("rkx,jk->rjx", pushed, np.maximum(left[None, :] * (left[:, None] > left[None, :]), 0.0))
        by_turn = np.zeros((runs, count, 9, 3))
        by_turn[:, :, POS], by_turn[:, :, VEL], by_turn[:, :, ATT] = -cross(later), -cross(rest), np.eye(3)
        noise = (dt * self.sensors.gyro_noise) ** 2 * np.einsum("rkij,rklj->ril", by_turn, by_turn)
        by_push = np.zeros((count, 9, 3))
        by_push[:, POS], by_push[:, VEL] = left[:, None, None] * np.eye(3), np.eye(3)
        noise += (dt * self.sensors.accel_noise) ** 2 * np.einsum("kij,klj->il", by_push, by_push)
        self.p = phi @ self.p @ phi.swapaxes(1, 2)
        self.p[:, :9, :9] += noise
        if n > 15:
            self.clock[:, :-1] += span * self.clock[:, -1:]
            white, wander = self.sensors.clock_noise
            self.p[:, 15:, 15:] += [  # of a bias and a drift ([1], eq. 14.88)
                [white * span + wander * span**3 / 3.0, wander * span**2 / 2.0],
                [wander * span**2 / 2.0, wander * span],
            ]

    def couple(self, m: np.ndarray) -> None:
        """Add m (R, 3), NED, to the change of velocity by which attitude errors act on velocity errors."""
        t = np.tile(np.eye(self.p.shape[1]), (m.shape[0], 1, 1))
        t[:, VEL, ATT] = -cross((self.axes @ m[..., None])[..., 0])
        self.p = t @ self.p @ t.swapaxes(1, 2)

    @property
    def axes(self) -> np.ndarray:
        """North, east and down (R, 3, 3) where the filter believes to be."""
        return level_axes(geodetic(self.r))

    @property
    def velocity_ned(self) -> np.ndarray:
        return np.asarray((self.axes.swapaxes(1, 2) @ self.v[..., None])[..., 0])

    def in_level_axes(self, matrix: np.ndarray) -> np.ndarray:
        """A covariance (R, n, n) with position, velocity and attitude along north, east and down."""
        turn = np.tile(np.eye(matrix.shape[1]), (matrix.shape[0], 1, 1))
        for part in (POS, VEL, ATT):
            turn[:, part, part] = self.axes
        return np.asarray(turn.swapaxes(1, 2) @ matrix @ turn)

    @property
    def to_level(self) -> np.ndarray:
        """From body axes to north, east, down (R, 3, 3)."""
        return self.axes.swapaxes(1, 2) @ self.c

    @property
    def velocity_variance(self) -> np.ndarray:
        """Of the velocity along north, east and down (R, 3)."""
        return np.einsum("rii->ri", self.in_level_axes(self.p)[:, VEL, VEL])

    @property
    def antenna(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Position and velocity of the antenna (R, 3), and what they owe to the errors of the states (R, 3, n)
        ([1], eqs. 14.100 to 14.103)."""
        arm = self.sensors.lever_arm
        turned = self.c @ arm
        rate = self.rate - (self.c.swapaxes(1, 2) @ _EARTH)
        swung = (self.c @ np.cross(rate, arm)[..., None])[..., 0]
        of_position = np.zeros((*turned.shape, self.p.shape[1]))
        of_velocity = of_position.copy()
        of_position[:, :, POS] = of_velocity[:, :, VEL] = np.eye(3)
        of_position[:, :, ATT], of_velocity[:, :, ATT] = -cross(turned), -cross(swung)
        of_velocity[:, :, GYRO] = self.c @ cross(arm)
        return self.r + turned, self.v + swung, of_position, of_velocity

    def weigh(self, misfit: Callable[[], tuple[np.ndarray, np.ndarray]], r: np.ndarray) -> None:
        """Correct by z = h error + noise, z (R, m) and h (R, m, n) by `misfit` at the estimate, covariance r (R, m, m)
        ([1], eqs. 3.58 to 3.61): one step of Gauss and Newton, whose covariance is of the new estimate."""
        z, h = misfit()
        x = (self._gain(h, r) @ z[..., None])[..., 0]
        self.r, self.v = self.r + x[:, POS], self.v + x[:, VEL]
        self.c = rotation(x[:, ATT]) @ self.c
        self.gyro, self.accel, self.clock = self.gyro + x[:, GYRO], self.accel + x[:, ACCEL], self.clock + x[:, 15:]
        # the error that is left is of the attitude after the correction [3]
        g = np.tile(np.eye(self.p.shape[1]), (z.shape[0], 1, 1))
        g[:, ATT, ATT] = left_jacobian(x[:, ATT])
        self.p = g @ self.p @ g.swapaxes(1, 2)
        h = misfit()[1]
        k = self._gain(h, r)
        keep = np.eye(self.p.shape[1]) - k @ h
        self.p = keep @ self.p @ keep.swapaxes(1, 2) + k @ r @ k.swapaxes(1, 2)

    def _gain(self, h: np.ndarray, r: np.ndarray) -> np.ndarray:
        hp = h @ self.p
        return np.linalg.solve(hp @ h.swapaxes(1, 2) + r, hp).swapaxes(1, 2)

    def weigh_fix(self, llh: np.ndarray, velocity: np.ndarray, covariance: np.ndarray) -> None:
        """A fix of the antenna (R, 3), rad, rad, m, its velocity (R, 3) and the covariance of both (R, 6, 6), NED."""
        axes = level_axes(llh)
        place, speed = ecef(llh), (axes @ velocity[..., None])[..., 0]
        turn = np.zeros((llh.shape[0], 6, 6))
        turn[:, :3, :3] = turn[:, 3:, 3:] = axes

        def misfit() -> tuple[np.ndarray, np.ndarray]:
            r, v, of_r, of_v = self.antenna
            return np.concatenate([place - r, speed - v], axis=1), np.concatenate([of_r, of_v], axis=1)

        self.weigh(misfit, turn @ covariance @ turn.swapaxes(1, 2))

    def weigh_ranges(
        self, place: np.ndarray, speed: np.ndarray, ranges: np.ndarray, rates: np.ndarray, sigma: np.ndarray
    ) -> None:
        """Ranges and range rates (R, s) of sources at places (s, 3) with velocities (s, 3), ECEF, and their sigmas
        (2, s), by one clock ([1], eqs. 14.120 to 14.128)."""
        count = place.shape[0]

        def misfit() -> tuple[np.ndarray, np.ndarray]:
            r, v, of_r, of_v = self.antenna
            away = place - r[:, None]
            distance = np.linalg.norm(away, axis=2)
            u, w = away / distance[..., None], speed - v[:, None]
            along = np.einsum("rsx,rsx->rs", u, w)
            across = (w - along[..., None] * u) / distance[..., None]
            h = np.concatenate([-u @ of_r, -u @ of_v - across @ of_r], axis=1)
            h[:, :count, 15], h[:, count:, 16] = 1.0, 1.0
            return np.concatenate([ranges - distance - self.clock[:, :1], rates - along - self.clock[:, 1:]], axis=1), h

        self.weigh(misfit, np.tile(np.diag(sigma.ravel() ** 2), (ranges.shape[0], 1, 1)))


@dataclass
class SteadyForce:
    """What is left out of the change of velocity in steady flight: docs/theory/steady-force.md.

    density: of the accelerometers' noise, m2/s3. Everything else is of R runs, velocities along north, east, down.
    """

    density: float
    line: np.ndarray
    slope: np.ndarray
    coupled: np.ndarray
    """The line at the measurement before (R, 3), by which attitude errors are coupled."""
    left: np.ndarray
    """The filter's velocity after that measurement (R, 3)."""
    age: np.ndarray
    steady: np.ndarray
    square: np.ndarray
    count: np.ndarray
    force: np.ndarray
    """Mean specific force in body axes since the line began (R, 3)."""
    omitted: np.ndarray
    """What it left out, as far as fixes have not corrected it (R, 3)."""
    keeps: np.ndarray
    step: float = 0.0

    @classmethod
    def begun(cls, density: float, velocity: np.ndarray) -> SteadyForce:
        zero = np.zeros(velocity.shape[0])
        none = 0.0 * velocity
        steady, keeps = zero > 0.0, zero == 0.0
        return cls(density, velocity, none, velocity, velocity, zero, steady, zero + 1.0, zero, none, none, keeps)

    def _rough(self) -> np.ndarray:
        with np.errstate(divide="ignore"):
            return np.asarray(self.square - 1.0 > 4.0 * np.sqrt(2.0 / (3.0 * self.count)))

    def after_measurement(self, v: np.ndarray, variance: np.ndarray) -> None:
        """v, variance (R, 3) of the filter."""
        memory = variance.mean(axis=1) / self.density
        if self.step:
            self.age = self.age + self.step
            n = np.maximum(np.minimum(self.age, np.maximum(40.0, 12.0 * memory)) / self.step, 1.0)[:, None]
            off = v - self.line
            self.line = self.line + 2.0 * (2.0 * n - 1.0) / (n * (n + 1.0)) * off
            self.slope = self.slope + np.where(n > 1.5, 6.0 / (n * (n + 1.0)) * off / self.step, 0.0)
        old = self.age > 2.0 + 1e-9
        self.count = np.where(old | self.steady | self.keeps, self.count, 0.0)
        begins = old & ~self.steady & (self.count * self.step > 2.0 + 1e-9) & ~self._rough()
        self.coupled = np.where(self.steady[:, None], self.coupled, self.line)
        self.line = np.where(begins[:, None], v, self.line)
        self.coupled = np.where(begins[:, None], v, self.coupled)
        self.omitted = np.where(begins[:, None], 0.0, self.omitted)
        self.steady = self.steady | begins
        self.left = v

    def before_measurement(self, v: np.ndarray, variance: np.ndarray, to_level: np.ndarray, step: float) -> np.ndarray:
        """What is to be added (R, 3) to the change of velocity that couples, over an interval of `step`, s; to_level
        (R, 3, 3) from body axes."""
        noise = self.density * step
        memory, age = variance.mean(axis=1) / self.density, self.age + step
        n = np.maximum(np.minimum(age, np.maximum(40.0, 12.0 * memory)) / step, 1.0)[:, None]
        felt = (v - self.left) / step - [0.0, 0.0, 9.8]
        in_body = np.einsum("rij,ri->rj", to_level, felt)
        self.force = self.force + (in_body - self.force) / n
        by_force = (np.einsum("rij,rj->ri", to_level, self.force) - felt) * step
        expected = self.line + self.slope * step
        of_line, of_force = self.coupled - self.left, self.omitted
        omitted = np.maximum(1.0 - step / memory, 0.0)[:, None] * of_force + by_force
        limit = 4.5 * np.sqrt(self.density * memory * (0.5 + memory / age))
        turned = (np.abs(omitted) > limit[:, None]) | (np.abs(by_force) > 6.0 * np.sqrt(noise))
        keeps = self.keeps & ~turned.any(axis=1)
        change = v - self.left - self.slope * step
        beside = np.where(keeps[:, None], by_force, change)
        self.count = np.minimum(self.count + 1.0, 20.0 / step)
        self.square = self.square + ((beside**2).sum(axis=1) / (3.0 * noise) - self.square) / self.count
        sudden = (np.abs(v - expected) > 4.5 * np.sqrt(variance)).any(axis=1)
        sudden |= self.steady & (np.abs(change) > 6.0 * np.sqrt(noise)).any(axis=1)
        ends = sudden | (self.steady & self._rough()) | (memory > np.where(self.steady, 36.0, 24.0))
        by_line = (expected - self.coupled) - (v - self.left) + np.where(self.keeps[:, None], of_line - of_force, 0.0)
        back = -np.where(self.keeps[:, None], of_force, of_line)
        m = np.where(ends[:, None], back, np.where(keeps[:, None], by_force, by_line))
        m[~self.steady] = 0.0
        self.omitted = np.where(ends[:, None], 0.0, omitted)
        self.force = np.where(ends[:, None], in_body, self.force)
        self.keeps = keeps | ends
        self.line = self.coupled = np.where(ends[:, None], v, expected)
        self.slope = np.where(ends[:, None], (v - self.left) / step, self.slope)
        self.age = np.where(ends, 0.0, self.age)
        self.steady = self.steady & ~ends
        self.count = np.where(sudden, 0.0, self.count)
        self.step = step
        return m
