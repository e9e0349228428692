"""Aircraft steered by an autopilot, for runs in lanes. Equations: `docs/theory/air.md`, section 6."""

from __future__ import annotations

from navsim.compiler.jit import kernel, kernel_inline
from navsim.compiler.lanes import alloc, as_simd, small_matrix, small_vector, where
from navsim.trajectory.air import GRAVITY
from navsim.trajectory.track_frame import ALONG, LATERAL, VERTICAL


@kernel_inline
def command(estimate, slope, slope_rate, gain, out):
    """Accelerations (3,), m/s2, that guidance asks for: lateral, along, vertical. It has the estimate alone.

    - `estimate` (3, 2): estimated deviation from the route, m, and its rate, m/s, along axes of the course.
    - `slope`, `slope_rate` (1/s): climb of the route per metre ahead.
    - `gain` (3, 2): acceleration per metre and per m/s.
    """
    ahead, faster = estimate[ALONG, 0], estimate[ALONG, 1]
    # in height from the glide path at the estimated place
    off = estimate[VERTICAL, 0] - slope * ahead
    rate = estimate[VERTICAL, 1] - slope * faster - slope_rate * ahead
    out[LATERAL] = -(gain[LATERAL, 0] * estimate[LATERAL, 0]) - gain[LATERAL, 1] * estimate[LATERAL, 1]
    out[ALONG] = -(gain[ALONG, 0] * ahead + gain[ALONG, 1] * faster)
    out[VERTICAL] = -(gain[VERTICAL, 0] * off + gain[VERTICAL, 1] * rate)


@kernel_inline
def respond(transition, drive, command, motion, new):
    """Motion (4,) after a sample with a constant command: deviation, two derivatives, rate of the acceleration."""
    for i in range(4):
        new[i] = drive[i] * command
        for j in range(4):
            new[i] += transition[i, j] * motion[j]
    for i in range(4):
        motion[i] = new[i]


@kernel_inline
def _move(direction, k, motion, way):
    """Add motion (4,) along a level direction (3, n, 3), with two derivatives, at sample k to `way` (n, 9)."""
    p, v, a = motion[0], motion[1], motion[2]
    for axis in range(2):
        d0, d1, d2 = direction[0, k, axis], direction[1, k, axis], direction[2, k, axis]
        way[k, axis] += p * d0
        way[k, 3 + axis] += v * d0 + p * d1
        way[k, 6 + axis] += a * d0 + 2.0 * v * d1 + p * d2


@kernel
def steer(
    step, first, error, slope, gain, limit, command_rate, transition, drive, right, ahead, airborne, slowness, pitches,
    way, turn,
):  # fmt: skip
    """Add the motion of steered aircraft, which begin on their route, to `way` (n, 9) and `turn` (n, 6) of lanes, see
    `PathDeviation`.

    - `step`: s between samples.
    - `first` (m,): samples from which guidance has `error` (m, 3, 2), truth minus estimate, along axes of the course:
      m, m/s.
    - `slope` (2, n), `gain` (3, 2): see `command`.
    - `limit` (3,): largest accelerations, m/s2; `command_rate` (3,): their largest rates, m/s3.
    - `transition` (3, 4, 4), `drive` (3, 4): see `respond`.
    - `right`, `ahead` (3, n, 3), `airborne` (3, n), `slowness` (2, n): see `Course`; `pitches`: the nose follows the
      path.
    """
    error, way, turn = as_simd(error), as_simd(way), as_simd(turn)
    row, zero = -1, 0.0 * way[0, 0]
    estimate, motion = small_matrix(way, 3, 2), alloc(way, (3, 4))
    asked, held, new = small_vector(way, 3), small_vector(way, 3), small_vector(way, 4)
    for axis in range(3):
        held[axis] = zero
        for i in range(4):
            motion[axis, i] = zero
    for k in range(way.shape[0]):
        _move(right, k, motion[LATERAL], way)
        _move(ahead, k, motion[ALONG], way)
        b0, b1, b2, slow, slower = airborne[0, k], airborne[1, k], airborne[2, k], slowness[0, k], slowness[1, k]
        p, v, a = motion[VERTICAL, 0], motion[VERTICAL, 1], motion[VERTICAL, 2]
        climb, bend = b0 * v + b1 * p, b0 * a + 2.0 * b1 * v + b2 * p
        way[k, 2] -= b0 * p
        way[k, 5] -= climb
        way[k, 8] -= bend
        if pitches:
            turn[k, 1] += 0.5 * slow * climb
            turn[k, 4] += 0.5 * (slow * bend + slower * climb)
        v, a = motion[LATERAL, 1], motion[LATERAL, 2]
        turn[k, 2] += 0.5 * slow * v
        turn[k, 5] += 0.5 * (slow * a + slower * v)
        turn[k, 0] += b0 * a * (0.5 / GRAVITY)
        turn[k, 3] += (b1 * a + b0 * motion[LATERAL, 3]) * (0.5 / GRAVITY)
        while row + 1 < first.shape[0] and first[row + 1] <= k:
            row += 1
        for axis in range(3):
            for order in range(2):
                estimate[axis, order] = motion[axis, order] - (error[row, axis, order] if row >= 0 else zero)
        command(estimate, slope[0, k], slope[1, k], gain, asked)
        for axis in range(3):
            change, most = command_rate[axis] * step, limit[axis]
            least, largest = held[axis] - change, held[axis] + change
            now = where(least > asked[axis], least, asked[axis])
            now = where(largest < now, largest, now)
            now = where(-most > now, -most, now)
            held[axis] = where(most < now, most, now)
            respond(transition[axis], drive[axis], held[axis], motion[axis], new)
