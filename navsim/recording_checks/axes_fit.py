"""Fit of a hypothesis about units, axes and times of inertial sensors: specific force rotated by the gyros against
velocity changes of the fixes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import BODY_AXES, axes_matrix
from navsim.formats.recorded_data import Fixes, Samples
from navsim.geodesy import earth
from navsim.geodesy.attitude import wahba

STEP = 0.1
"""Steps of the attitude integration, s."""
PIECE, PIECES = 1.0, 15
"""Length of a piece, s, and pieces in a window with one rotation."""
MOVING, HEADING_SIGMA = 3.0, 0.2
"""Speed, m/s, from which on, and 1 sigma of the heading, rad, up to which a course shows where the nose points."""
GYRO_BIAS, ACCEL_BIAS = 5e-3, 0.1
"""1 sigma of the biases, rad/s, m/s2, those of poor sensors whichever class the log names: 1000 deg/h, 10 mg."""
_NUDGE = 1e-6
"""Step of numerical derivatives by the gyros' bias, rad/s: small, since it adds up over the flight."""
LEAST_RESIDUAL = 0.05
"""1 sigma that no hypothesis explains, m/s: smaller differences decide nothing."""
LEAST_WEIGHT = 0.1
"""Least weight of the vertical velocity relative to the horizontal one."""
VELOCITY_SIGMA = 0.3
"""1 sigma of a piece's velocity change, relative to that of the biases, m/s."""


@dataclass(frozen=True)
class Propagated:
    """Specific force integrated with the attitude from gyros of one sign and unit."""

    time: np.ndarray
    """(n,) grid, s."""
    force: np.ndarray
    """(4, n, 3, 3, 3) integrals of specific force from the first time, for the gyros as measured and with a bias of
    `_NUDGE` about each axis; by row and column of the rotation and by component."""
    turning: np.ndarray
    """(n, 3, 3)."""
    attitude: np.ndarray
    """(n, 3, 3)."""

    def at(self, values: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Values (..., n, ...) given on the grid along axis 0, at other times within it."""
        after = np.clip(np.searchsorted(self.time, time), 1, self.time.size - 1)
        share = (time - self.time[after - 1]) / (self.time[after] - self.time[after - 1])
        share = share.reshape(-1, *(1,) * (values.ndim - 1))
        return (1.0 - share) * values[after - 1] + share * values[after]


@dataclass(frozen=True)
class VelocityGains:
    """Velocity changes of the fixes."""

    edges: np.ndarray
    """(e,) of the pieces, s."""
    gained: np.ndarray
    """(e - 1, 3) integrated specific force, NED, m/s."""
    velocity: np.ndarray
    """(e, 3)."""
    windows: np.ndarray
    """(w, k) pieces without holes."""
    weight: np.ndarray
    """(3,) of north, east, down. A unit that shrinks the fixes also shrinks their noise, which must not count in its
    favour. Noisy axes, such as vertical velocities from heights, must not hide the others."""


@dataclass(frozen=True)
class AxesHypothesis:
    """Signs, units and times to test. `gyro` and `accel` convert the columns into axes in which both triads agree."""

    factor: float = 1.0
    """Sign and factor on the rates."""
    turn: int = 0
    """Rotation of both triads."""
    accel_sign: float = 1.0
    """Sign of the accelerometers."""
    offset: float = 0.0
    """Offset of the fixes' times, s."""
    reading: int = 0
    """Another interpretation of the fixes, with its keys."""

    @property
    def gyro(self) -> np.ndarray:
        """Signed permutation of the rates (3, 3)."""
        return np.sign(self.factor) * PROPER_AXES[self.turn]

    @property
    def accel(self) -> np.ndarray:
        """Signed permutation of the specific forces (3, 3)."""
        return self.accel_sign * np.eye(3)


@dataclass(frozen=True)
class HypothesisFit:
    """Fit of a hypothesis to the velocities."""

    hypothesis: AxesHypothesis
    square: np.ndarray
    """(w,) mean square of each window, m2/s2, nan without samples."""
    bias: np.ndarray
    """(3,) gyro bias of the columns, rad/s."""
    down: np.ndarray
    """(3,) mean direction of down, see `_pointing`."""
    ahead: np.ndarray
    """(3,) mean direction of the velocity."""


PROPER_AXES = [
    m for m in (axes_matrix(n, BODY_AXES) for n in conventions.all_axes(BODY_AXES)) if np.linalg.det(m) > 0.0
]
PROPER_AXES.sort(key=lambda m: -float(np.trace(m)))
"""The 24 ways to turn a triad by right angles, as it is first."""


def carried(samples: Samples, factor: float, bias: np.ndarray, nudged: bool = True) -> Propagated:
    """The samples integrated over steps of at most `STEP`; bias (3,) rad/s is taken off the rates times the factor.

    nudged: also with the biases that derivatives need.
    """
    from scipy.spatial.transform import Rotation

    time = samples.time
    grid = np.arange(time[0], time[-1], max(STEP, float(np.median(np.diff(time)))))

    def gathered(values: np.ndarray) -> np.ndarray:
        steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time)[:, None]
        summed = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        return np.diff(np.stack([np.interp(grid, time, summed[:, i]) for i in range(3)], axis=1), axis=0)

    turned, gained, step = factor * gathered(samples.rate), gathered(samples.force), np.diff(grid)[:, None]
    ways = [turned - (bias + shift) * step for shift in (np.zeros(3), *(_NUDGE * np.eye(3)))[: 4 if nudged else 1]]
    half = np.stack([Rotation.from_rotvec(0.5 * way).as_matrix() for way in ways], axis=1)
    now = _products(half @ half)
    middle, attitude = now[:-1] @ half, now[:, 0]
    force = np.zeros((len(ways), grid.size, 3, 3, 3))
    for way in range(len(ways)):
        np.cumsum(middle[:, way, :, :, None] * gained[:, None, None, :], axis=0, out=force[way, 1:])
    turning = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(middle[:, 0] * step[:, :, None], axis=0)])
    return Propagated(grid, force, turning, attitude)


def _products(turns: np.ndarray) -> np.ndarray:
    """The products (n + 1, w, 3, 3) of the first 0, 1, ... n of turns (n, w, 3, 3), in their order: within rows of a
    matrix of turns, all rows at once, then from row to row."""
    count, ways = turns.shape[:2]
    length = max(1, round(count**0.5))
    rows = -(-count // length)
    out = np.tile(np.eye(3), (rows * length + 1, ways, 1, 1))
    within = out[1:].reshape(rows, length, ways, 3, 3)
    within.reshape(-1, ways, 3, 3)[:count] = turns
    for step in range(1, length):
        within[:, step] = within[:, step - 1] @ within[:, step]
    for row in range(1, rows):
        within[row] = within[row - 1, -1] @ within[row]
    return out[: count + 1]


def gained(fixes: Fixes, scale: np.ndarray, piece: float = PIECE, pieces: int = PIECES) -> VelocityGains:
    """Changes of velocity less gravity, over pieces of about `piece` seconds; velocities are all known, scale (3,):
    their size over that as written. The turning of the axes is left out: over a window it is a thousandth."""
    time = fixes.time
    pick = [0]
    for index in range(1, time.size):
        if time[index] - time[pick[-1]] >= piece - 1e-6:
            pick.append(index)
    edges, velocity = time[pick], fixes.velocity[pick]
    gravity = float(np.linalg.norm(earth.gravity_ecef(earth.ecef_from_llh(fixes.llh[:1]))))
    change = np.diff(velocity, axis=0) - np.diff(edges)[:, None] * [0.0, 0.0, gravity]
    whole = np.diff(edges) < 3.0 * piece
    windows = []
    for run in np.split(np.arange(whole.size), np.flatnonzero(~whole)):
        run = run[whole[run]]
        windows += [run[first : first + pieces] for first in range(0, run.size - pieces + 1, pieces)]
    whole_windows = np.reshape(windows, (-1, pieces)).astype(int)
    written = velocity / np.minimum(1.0, scale)
    rough = np.median(np.abs(np.diff(written, 2, axis=0)), axis=0) if len(velocity) > 2 else np.ones(3)
    down = np.clip(rough[:2].mean() / max(rough[2], 1e-9), LEAST_WEIGHT, 1.0)
    return VelocityGains(edges, change, velocity, whole_windows, np.maximum(1.0, 1.0 / scale) * [1.0, 1.0, down])


def fitted(
    flight: Propagated, target: VelocityGains, windows: np.ndarray, hypothesis: AxesHypothesis, bias: np.ndarray
) -> HypothesisFit:
    """Fit of a hypothesis to the velocities, with one free rotation for each window and common biases.

    windows: (w, k) of pieces within the samples. bias: removed by `carried`.
    """
    turn = PROPER_AXES[hypothesis.turn]
    edges = target.edges + hypothesis.offset
    both = np.unique(np.concatenate([windows, windows + 1]))
    place = np.searchsorted(both, windows)
    force = np.stack([flight.at(values, edges[both]) for values in flight.force])
    sums = np.einsum("xa,vnabc,cb->vnx", turn, force, turn) * hypothesis.accel_sign
    spin = np.einsum("xa,nab,yb->nxy", turn, flight.at(flight.turning, edges[both]), turn)
    after = np.searchsorted(both, windows + 1)
    sensed = sums[:, after] - sums[:, place]
    spun = spin[after] - spin[place]
    due = target.gained[windows]
    rotation = wahba(sensed[0], due)
    seen = np.einsum("wij,wkj->wki", rotation, sensed[0])
    count = windows.shape[0]
    residual = (due - seen).reshape(count, -1)
    free = _crosses(seen).reshape(count, -1, 3)
    shared = np.concatenate(
        [
            np.einsum("wij,vwkj->wkiv", rotation, sensed[1:] - sensed[:1]).reshape(count, -1, 3) / _NUDGE,
            -np.einsum("wij,wkjl->wkil", rotation, spun).reshape(count, -1, 3),
        ],
        axis=2,
    )
    inverse = np.linalg.inv(np.einsum("wni,wnj->wij", free, free) + 1e-9 * np.eye(3))

    def without_rotation(values: np.ndarray) -> np.ndarray:
        return values - np.einsum("wni,wij,wmj,wm...->wn...", free, inverse, free, values, optimize=True)

    residual, shared = without_rotation(residual), without_rotation(shared)
    normal = np.einsum("wni,wnj->ij", shared, shared)
    prior = VELOCITY_SIGMA**2 / np.repeat([GYRO_BIAS**2, ACCEL_BIAS**2], 3)
    taken = np.concatenate([bias, np.zeros(3)])  # the prior is that of the total bias
    right = np.einsum("wni,wn->i", shared, residual) - prior * taken
    more = np.linalg.solve(normal + np.diag(prior), right)
    residual = (residual - np.einsum("wni,i->wn", shared, more)) * np.tile(target.weight, windows.shape[1])
    down, ahead = _pointing(flight, target, windows, hypothesis, rotation, float(np.mean(residual**2)))
    return HypothesisFit(hypothesis, np.mean(residual**2, axis=1) + LEAST_RESIDUAL**2, bias + more[:3], down, ahead)


def _pointing(
    flight: Propagated,
    target: VelocityGains,
    windows: np.ndarray,
    hypothesis: AxesHypothesis,
    rotation: np.ndarray,
    scatter: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Mean directions of down and of the velocity in the axes of a hypothesis, (3,) each, of length 1 if they never
    differ.

    Velocities count if the window shows the heading and they are faster than `MOVING`.
    """
    turn = PROPER_AXES[hypothesis.turn]
    attitude = np.einsum("xa,nab,yb->nxy", turn, flight.at(flight.attitude, target.edges + hypothesis.offset), turn)
    middle = attitude[windows]
    down = np.einsum("wkji,wlj,l->wki", middle, rotation, [0.0, 0.0, 1.0])
    shown = np.sum(target.gained[windows][:, :, :2] ** 2, axis=(1, 2))
    heading = shown > 4.0 * 3.0 * scatter / HEADING_SIGMA**2
    velocity = target.velocity[windows]
    speed = np.linalg.norm(velocity, axis=2)
    counted = (speed > MOVING) & heading[:, None]
    if counted.sum() < PIECES:
        return down.mean(axis=(0, 1)), np.zeros(3)
    course = velocity / np.maximum(speed, MOVING)[..., None]
    ahead = np.einsum("wkji,wlj,wkl->wki", middle, rotation, course, optimize=True)
    return down.mean(axis=(0, 1)), ahead[counted].mean(axis=0)


def _crosses(vectors: np.ndarray) -> np.ndarray:
    """The matrices (..., 3, 3) that a small rotation moves the vectors (..., 3) by: -[v x]."""
    out = np.zeros((*vectors.shape, 3))
    x, y, z = np.moveaxis(vectors, -1, 0)
    out[..., 0, 1], out[..., 0, 2] = z, -y
    out[..., 1, 0], out[..., 1, 2] = -z, x
    out[..., 2, 0], out[..., 2, 1] = y, -x
    return out
