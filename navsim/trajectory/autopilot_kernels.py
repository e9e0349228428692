"""Aircraft steered by an autopilot, for runs in lanes. Equations: `docs/theory/air.md`, section 6."""

from __future__ import annotations

import numpy as np

from navsim.compiler.jit import kernel, kernel_inline
from navsim.trajectory.air import GRAVITY
from navsim.trajectory.track_frame import ALONG, LATERAL, VERTICAL


@kernel_inline
def command(estimate, slope, slope_rate, gain, out):
    """Accelerations (3, W), m/s2, that guidance asks for: lateral, along, vertical. It has the estimate alone.

    - `estimate` (3, 2, W): estimated deviation from the route, m, and its rate, m/s, along axes of the course.
    - `slope`, `slope_rate` (1/s): climb of the route per metre ahead.
    - `gain` (3, 2): acceleration per metre and per m/s.
    """
    for lane in range(out.shape[1]):
        ahead, faster = estimate[ALONG, 0, lane], estimate[ALONG, 1, lane]
        # in height from the glide path at the estimated place
        off = estimate[VERTICAL, 0, lane] - slope * ahead
        rate = estimate[VERTICAL, 1, lane] - slope * faster - slope_rate * ahead
        out[LATERAL, lane] = -(gain[LATERAL, 0] * estimate[LATERAL, 0, lane])
        out[LATERAL, lane] -= gain[LATERAL, 1] * estimate[LATERAL, 1, lane]
        out[ALONG, lane] = -(gain[ALONG, 0] * ahead + gain[ALONG, 1] * faster)
        out[VERTICAL, lane] = -(gain[VERTICAL, 0] * off + gain[VERTICAL, 1] * rate)


@kernel_inline
def respond(transition, drive, command, motion, new):
    """Motion (4, W) after a sample with a constant command (W,): deviation, two derivatives, rate of the
    acceleration."""
    for i in range(4):
        for lane in range(command.shape[0]):
            new[i, lane] = drive[i] * command[lane]
        for j in range(4):
            for lane in range(command.shape[0]):
                new[i, lane] += transition[i, j] * motion[j, lane]
    for i in range(4):
        for lane in range(command.shape[0]):
            motion[i, lane] = new[i, lane]


@kernel_inline
def _move(direction, k, motion, way):
    """Add motion (4, W) along a level direction (3, n, 3), with two derivatives, at sample k to `way` (n, 9, W)."""
    for axis in range(2):
        d0, d1, d2 = direction[0, k, axis], direction[1, k, axis], direction[2, k, axis]
        for lane in range(way.shape[2]):
            p, v, a = motion[0, lane], motion[1, lane], motion[2, lane]
            way[k, axis, lane] += p * d0
            way[k, 3 + axis, lane] += v * d0 + p * d1
            way[k, 6 + axis, lane] += a * d0 + 2.0 * v * d1 + p * d2


@kernel
def steer(
    step, first, error, slope, gain, limit, command_rate, transition, drive, right, ahead, airborne, slowness, pitches,
    way, turn,
):  # fmt: skip
    """Add the motion of steered aircraft, which begin on their route, to `way` (n, 9, W) and `turn` (n, 6, W) of a
    `Departure`.

    - `step`: s between samples.
    - `first` (m,): samples from which guidance has `error` (m, 3, 2, W), truth minus estimate, along axes of the
      course: m, m/s.
    - `slope` (2, n), `gain` (3, 2): see `command`.
    - `limit` (3,): largest accelerations, m/s2; `command_rate` (3,): their largest rates, m/s3.
    - `transition` (3, 4, 4), `drive` (3, 4): see `respond`.
    - `right`, `ahead` (3, n, 3), `airborne` (3, n), `slowness` (2, n): see `Course`; `pitches`: the nose follows the
      path.
    """
    lanes, row = way.shape[2], -1
    estimate, asked, held = np.zeros((3, 2, lanes)), np.zeros((3, lanes)), np.zeros((3, lanes))
    motion, new = np.zeros((3, 4, lanes)), np.zeros((4, lanes))
    for k in range(way.shape[0]):
        _move(right, k, motion[LATERAL], way)
        _move(ahead, k, motion[ALONG], way)
        b0, b1, b2, slow, slower = airborne[0, k], airborne[1, k], airborne[2, k], slowness[0, k], slowness[1, k]
        for lane in range(lanes):
            p, v, a = motion[VERTICAL, 0, lane], motion[VERTICAL, 1, lane], motion[VERTICAL, 2, lane]
            climb, bend = b0 * v + b1 * p, b0 * a + 2.0 * b1 * v + b2 * p
            way[k, 2, lane] -= b0 * p
            way[k, 5, lane] -= climb
            way[k, 8, lane] -= bend
            if pitches:
                turn[k, 1, lane] += 0.5 * slow * climb
                turn[k, 4, lane] += 0.5 * (slow * bend + slower * climb)
            v, a = motion[LATERAL, 1, lane], motion[LATERAL, 2, lane]
            turn[k, 2, lane] += 0.5 * slow * v
            turn[k, 5, lane] += 0.5 * (slow * a + slower * v)
            turn[k, 0, lane] += b0 * a * (0.5 / GRAVITY)
            turn[k, 3, lane] += (b1 * a + b0 * motion[LATERAL, 3, lane]) * (0.5 / GRAVITY)
        while row + 1 < first.shape[0] and first[row + 1] <= k:
            row += 1
        for axis in range(3):
            for order in range(2):
                for lane in range(lanes):
                    wrong = error[row, axis, order, lane] if row >= 0 else 0.0
                    estimate[axis, order, lane] = motion[axis, order, lane] - wrong
        command(estimate, slope[0, k], slope[1, k], gain, asked)
        for axis in range(3):
            change, most = command_rate[axis] * step, limit[axis]
            for lane in range(lanes):
                now = min(max(asked[axis, lane], held[axis, lane] - change), held[axis, lane] + change)
                held[axis, lane] = min(max(now, -most), most)
            respond(transition[axis], drive[axis], held[axis], motion[axis], new)
