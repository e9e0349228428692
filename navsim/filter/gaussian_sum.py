"""Gaussian-sum filter over heading, `kind: gaussian-sum`.

A single Gaussian becomes inconsistent when the aircraft turns while its heading is uncertain. The biases B = C b are
known along level axes but not along the vertical, and they rotate with the body. The error is then a product of two
uncertain quantities. This filter holds several components, each with a small heading sigma. Each component is a `tfg`
filter with a rule of its own for held axes (`_hold_axes`).

- Split: before a turn, a component that is too wide in heading is divided into three. The split follows the correlation
  of the other states with heading.
- Weight: each measurement multiplies a component's weight by its likelihood.
- Prune and merge: negligible components are dropped; neighbours that are jointly narrow are merged. When heading is
  known, one component remains.

The output is the mean and covariance of the mixture in the chart of `tfg`.

Components of W runs are processed together in SIMD lanes: the first components, then the second ones. A run with fewer
components than another has weight 0 in the rest.

Sources:

- [1] Alspach & Sorenson, Nonlinear Bayesian estimation using Gaussian sum approximations, IEEE TAC 17 (1972).
- [2] Runnalls, Kullback-Leibler approach to Gaussian mixture reduction, IEEE TAES 43 (2007).
- [3] `docs/theory/gaussian-sum.md`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navsim.compiler.elementary import exp_of_negative
from navsim.compiler.jit import kernel, within
from navsim.compiler.lanes import any_lane, no, registers, room, select, small_matrix, small_vector
from navsim.compiler.linear import cholesky, copy, copy_matrix, invert3
from navsim.filter import tfg
from navsim.filter.covariance import gain, transport
from navsim.filter.eskf import between
from navsim.filter.filter_loop import advance, force_noise, is_ahead, set_off, start_axes, workshop
from navsim.filter.history import answer, nothing_yet, opened
from navsim.filter.left_invariant import turned
from navsim.filter.measurement_models import RANGE, observe, slot
from navsim.filter.range_update import (
    begin_epoch,
    begin_estimate,
    count_range,
    foresee,
    is_alone,
    move_estimate,
    range_epoch,
    take_range,
)
from navsim.filter.receiver_clock import forget_clock, has_jumped
from navsim.filter.records import OUTPUT, PASS, TIME_TOLERANCE, Mixture
from navsim.filter.states import A_D, A_E, A_N, ATT, GYRO, MOST, NAV_GYRO, NAV_HELD, NAV_QUAT, NAV_SENSORS, NAV_VEL, POS
from navsim.filter.steady_force import (
    begin_interval,
    couple_sum,
    end_interval,
    has_begun,
    mean_velocity,
    start_line,
    turns_from_mean,
)
from navsim.filter.update import decide, errors_from, held, numbers_in, update, weighing, whitened_square
from navsim.geodesy.attitude_kernels import dcm, left_jacobian

_NARROWED = 0.65
"""1 sigma of heading of each of the three that a component is divided into, in its own."""
_OFFSET = math.sqrt(3.0 * (1.0 - _NARROWED * _NARROWED))
"""Distance of the outer two components in 1 sigma. With the weights 1/6, 4/6, 1/6 all moments up to the fifth equal
those of the original."""
_TURN = 0.02
"""A turn that must always be expected, rad."""
_AHEAD = 2.0
"""Time for which a turn is expected to continue, s."""
_HELD_RATE = 0.002
"""Least rate about the level axes of the body that is a turn, rad/s."""
_HELD_HEADING = 0.003
"""1 sigma of heading below which bias axes are not held, rad."""
_HELD_LEVEL = 0.1
"""Largest sigma of level gyro biases for which axes are held, relative to the vertical one."""
_CROSSED = 0.5
"""Largest quadratic error of a level bias that a turn may cause, relative to its sigma."""
_LEVEL_KNOWN = 0.01
"""Largest sigma of level biases that the limit assumes, relative to the vertical one. At first they are unknown, but a
quadratic error caused then shows later."""
_TILT_CROSSED = 0.0015
"""Largest product of the sigmas of heading and of tilt of a component, rad2. While the filter learns tilt, heading
rotates the information of each fix about it."""
_NARROWEST = 0.5
"""1 sigma of heading that no turn asks to divide, in that of the widest component."""
_AS_ONE = 0.4
"""1 sigma of heading of two as one, in that of the widest, below which they become one."""
_ROOMY = 0.7
"""Merge two components if their joint heading sigma is below this fraction of the allowed one. It is above that of
three parts of a split component, whose distances keep them apart."""
_NEGLIGIBLE = 1e-5
"""Components of less weight go."""
_SLIGHT = 0.005
"""Components with less weight are not split in straight flight. In a turn the limit falls as the turn grows."""
_QUICK = 0.1
"""A turn that may take all the room there is, rad."""
_CALM = 0.625
"""Fraction of the components that a slower turn may use."""
_FEWEST = 3
"""Components that a slow turn may always use."""
_GAIN = 0.3
"""Without free room, merge two components to split another if the merge costs less than this fraction of the gain. The
cost is the weight of the two, as far as they differ; the gain is the weight of the other."""


class Bench(NamedTuple):
    """Work space: x, error, mean (n,), nav, other (NAV,), p, square (n, n), increments (6,), pair: two components;
    allowed (M,): variance of heading that a component may have."""

    x: np.ndarray
    error: np.ndarray
    mean: np.ndarray
    nav: np.ndarray
    other: np.ndarray
    p: np.ndarray
    square: np.ndarray
    increments: np.ndarray
    pair: Mixture
    allowed: np.ndarray


@within
def _components(like, most, nav_size, n):
    """Allocate so many components, all without weight."""
    mixture = Mixture(
        room(like, (most, nav_size)), room(like, (most, n, n)), room(like, (most, 6)), room(like, (most,))
    )  # fmt: skip
    for j in range(most):
        mixture.weight[j] = 0.0
        for i in range(nav_size):
            mixture.navigation[j, i] = 0.0
        for i in range(6):
            mixture.increments[j, i] = 0.0
        for a in range(n):
            for b in range(n):
                mixture.covariance[j, a, b] = 0.0
    return mixture


@within
def _bench(nav, n, most):
    """Allocate work space for so many components of n states."""
    size = nav.shape[0]
    return Bench(
        room(nav, (n,)), room(nav, (n,)), room(nav, (n,)), room(nav, (size,)), room(nav, (size,)), room(nav, (n, n)),
        room(nav, (n, n)), room(nav, (6,)), _components(nav, 2, size, n), room(nav, (most,)),
    )  # fmt: skip


@kernel
def _copy_mixture(source, count, target):
    """The first components."""
    for j in range(count):
        copy(source.navigation[j], target.navigation[j])
        copy_matrix(source.covariance[j], target.covariance[j])
        copy(source.increments[j], target.increments[j])
    copy(source.weight, target.weight)


@kernel
def _count(weight):
    """Largest number of components of any run."""
    count = 1
    for j in range(1, weight.shape[0]):
        if any_lane(weight[j] > 0.0):
            count = j + 1
    return count


@kernel
def _take(which, mixture, j, nav, p, increments):
    """nav, p, increments <- component j where `which` is true."""
    held(mixture.navigation[j], no(which), nav)
    held(mixture.increments[j], no(which), increments)
    for i in range(p.shape[0]):
        held(mixture.covariance[j, i], no(which), p[i])


@kernel
def _put(which, nav, p, increments, weight, mixture, j):
    """Component j <- nav, p, increments, weight where `which` is true."""
    held(nav, no(which), mixture.navigation[j])
    held(increments, no(which), mixture.increments[j])
    for i in range(p.shape[0]):
        held(p[i], no(which), mixture.covariance[j, i])
    mixture.weight[j] = select(which, weight, mixture.weight[j])


@kernel
def _share(which, weight):
    """Normalise the weights (M,) where `which` is true."""
    total = weight[0]
    for j in range(1, weight.shape[0]):
        total += weight[j]
    for j in range(weight.shape[0]):
        weight[j] = select(which, weight[j] / total, weight[j])


@kernel
def _close_ranks(mixture):
    """Components that are there <- first."""
    weight = mixture.weight
    count = _count(weight)
    for empty in range(count):
        for j in range(count - 1, empty, -1):
            moves = (weight[empty] == 0.0) & (weight[j] > 0.0)
            if any_lane(moves):
                nav, p, increments = mixture.navigation[j], mixture.covariance[j], mixture.increments[j]
                _put(moves, nav, p, increments, weight[j], mixture, empty)
                weight[j] = select(moves, 0.0, weight[j])


@kernel
def _invert_blocks(diagonal, column):
    """The inverse of a matrix of such blocks (b, 3, 3), see `filter.covariance.transport`, in place."""
    attitude = ATT // 3
    inverse, theta, work = small_matrix(diagonal, 3, 3), small_matrix(diagonal, 3, 3), small_matrix(diagonal, 3, 3)
    invert3(diagonal[attitude], theta)
    for block in range(diagonal.shape[0]):
        own, across = diagonal[block], column[block]
        invert3(own, inverse)
        copy_matrix(inverse, own)
        if block != attitude:
            for i in range(3):
                for j in range(3):
                    work[i, j] = across[i, 0] * theta[0, j] + across[i, 1] * theta[1, j] + across[i, 2] * theta[2, j]
            for i in range(3):
                for j in range(3):
                    t = inverse[i, 0] * work[0, j] + inverse[i, 1] * work[1, j] + inverse[i, 2] * work[2, j]
                    across[i, j] = -t


@kernel
def _apart(component, nav, flat, straight, body, error, x):
    """Difference x (n,) of a component (NAV,) from nav, in the chart at nav.

    flat: plain differences of positions and velocities instead. straight, body: of the chart. error (n,): work space.
    """
    between(component, nav, error)
    tfg.own_error(nav, error, x, straight, body)
    if flat:
        for i in range(POS, ATT):
            x[i] = error[i]


@kernel
def _unturned(space, x):
    """x (n,) of a `flat` mean <- in the chart, as `tfg.feed_back` takes it."""
    jac, inverse, moved = space.c_nb, small_matrix(x, 3, 3), small_vector(x, 3)
    left_jacobian(x[ATT], x[ATT + 1], x[ATT + 2], jac)
    invert3(jac, inverse)
    for first in range(3 * space.straight, ATT, 3):
        turned(inverse, x[first : first + 3], moved)
        copy(moved, x[first : first + 3])


@kernel
def moments(mixture, nav, p, flat, space, bench):
    """Mean nav (NAV,) and covariance p (n, n) of a sum.

    Components are split and merged in the chart at their mean. The output is `flat`: plain positions and velocities.
    The chart rotates a position difference by half of the heading difference. If one direction is known well and
    another badly, as with two sources, the rotation would spoil the well-known one.

    space: `filter_loop.workshop`.
    """
    weight, x, error, other, square = mixture.weight, bench.x, bench.error, bench.other, bench.square
    n = p.shape[0]
    count = _count(weight)
    copy(mixture.navigation[0], nav)
    copy_matrix(mixture.covariance[0], p)
    if count == 1:
        return
    several = weight[1] > 0.0
    heaviest = weight[0]
    for j in range(1, count):
        heavier = weight[j] > heaviest
        heaviest = select(heavier, weight[j], heaviest)
        held(mixture.navigation[j], no(heavier), nav)
    # to the mean, from the heaviest
    for _ in range(2):
        for i in range(n):
            bench.mean[i] = 0.0
        for j in range(count):
            _apart(mixture.navigation[j], nav, flat, space.straight, space.body, error, x)
            for i in range(n):
                bench.mean[i] += select(weight[j] > 0.0, weight[j] * x[i], 0.0)
        if flat:
            _unturned(space, bench.mean)
        copy(nav, other)
        tfg.feed_back(other, bench.mean, space)
        held(other, no(several), nav)
    for a in range(n):
        for b in range(n):
            p[a, b] = select(several, 0.0, p[a, b])
    for j in range(count):
        there = several & (weight[j] > 0.0)
        _apart(mixture.navigation[j], nav, flat, space.straight, space.body, error, x)
        # inverse of the reset from the mean to the component; states with plain errors have none
        copy(nav, other)
        tfg.feed_back(other, x, space)
        for block in range(ATT // 3 if flat else 0):
            for a in range(3):
                for b in range(3):
                    space.diagonal[block, a, b], space.column[block, a, b] = 1.0 if a == b else 0.0, 0.0
        _invert_blocks(space.diagonal, space.column)
        copy_matrix(mixture.covariance[j], square)
        transport(square, space.diagonal, space.column, space.turned)
        for a in range(n):
            for b in range(a + 1):
                p[a, b] = select(there, p[a, b] + weight[j] * (square[a, b] + x[a] * x[b]), p[a, b])
                p[b, a] = select(there, p[a, b], p[b, a])


@kernel
def turn_ahead(imu, cursor, until, nav):
    """Angle (rad) by which the body is expected to turn, from its turn until `until`; 0 if that is now."""
    time, dtheta = imu.time, registers(imu.dtheta)
    first = int(cursor[0])
    last = first
    body = small_vector(nav, 3)
    for i in range(3):
        body[i] = 0.0
    while last < time.shape[0] - 1 and time[last] < until - TIME_TOLERANCE:
        for i in range(3):
            body[i] += dtheta[last, i]
        last += 1
    span = time[last] - time[first]
    for i in range(3):
        body[i] -= nav[NAV_GYRO + i] * span
    size = math.sqrt(body[0] * body[0] + body[1] * body[1] + body[2] * body[2])
    return _TURN + size * max(1.0, _AHEAD / span) if span > 0.0 else 0.0 * size


@kernel
def _hold_axes(nav, p, before, dt, axes):
    """Hold the axes of the biases back by the body's turn in dt (s) since the attitude `before` (4,).

    Before a turn the filter knows the biases in body axes: the level ones well, the vertical one badly. Axes that
    turned with the body would add half of heading error x turn x vertical bias to the level ones. axes (3, 3): work
    space.
    """
    held, q = nav[NAV_HELD:NAV_SENSORS], nav[NAV_QUAT:NAV_HELD]
    # the conjugate of the attitude before, times that of now
    w = before[0] * q[0] + before[1] * q[1] + before[2] * q[2] + before[3] * q[3]
    x = before[0] * q[1] - before[1] * q[0] - before[2] * q[3] + before[3] * q[2]
    y = before[0] * q[2] + before[1] * q[3] - before[2] * q[0] - before[3] * q[1]
    z = before[0] * q[3] - before[1] * q[2] + before[2] * q[1] - before[3] * q[0]
    turning = 4.0 * (x * x + y * y) > (_HELD_RATE * dt) * (_HELD_RATE * dt)
    holds = turning | (abs(held[1]) + abs(held[2]) + abs(held[3]) > 0.0)
    if not any_lane(holds):
        return
    variance = small_vector(nav, 3)
    tfg.bias_axes(nav, axes)
    for i in range(3):
        variance[i] = 0.0
        for j in range(3):
            for k in range(3):
                variance[i] += axes[i, j] * p[GYRO + j, GYRO + k] * axes[i, k]
    level = select(variance[0] > variance[1], variance[0], variance[1])
    holds = holds & (p[A_D, A_D] > _HELD_HEADING * _HELD_HEADING)
    holds = holds & (level < _HELD_LEVEL * _HELD_LEVEL * variance[2])
    turns = holds & turning
    a, b, c, d = held[0], held[1], held[2], held[3]
    held[0] = select(turns, a * w - b * x - c * y - d * z, select(holds, a, 1.0))
    held[1] = select(turns, a * x + b * w + c * z - d * y, select(holds, b, 0.0))
    held[2] = select(turns, a * y - b * z + c * w + d * x, select(holds, c, 0.0))
    held[3] = select(turns, a * z + b * y - c * x + d * w, select(holds, d, 0.0))


@kernel
def _allowed(nav, p, turn, widest, c_nb):
    """Largest heading sigma (rad) of a component before a turn.

    A turn rotates part of the vertical bias into a level one, in a direction known as well as heading. The quadratic
    error of the level bias is the heading sigma x the turn x sigma of the vertical bias.
    """
    dcm(nav[NAV_QUAT:NAV_HELD], c_nb)
    variance, big, row = small_vector(nav, 3), small_vector(nav, 3), small_vector(nav, 6)
    for i in range(3):
        big[i] = c_nb[i, 0] * nav[NAV_GYRO] + c_nb[i, 1] * nav[NAV_GYRO + 1] + c_nb[i, 2] * nav[NAV_GYRO + 2]
    for i in range(3):
        # dB = C db - [B x] theta; attitude and gyro biases follow each other among the states
        for j in range(3):
            row[j] = 0.0
            row[3 + j] = c_nb[i, j]
        row[(i + 2) % 3] = -big[(i + 1) % 3]
        row[(i + 1) % 3] = big[(i + 2) % 3]
        t = 0.0 * turn
        for j in range(6):
            for k in range(6):
                t += row[j] * p[ATT + j, ATT + k] * row[k]
        variance[i] = t
    level = select(variance[0] < variance[1], variance[0], variance[1])
    known = math.sqrt(level / variance[2])
    known = select(known > _LEVEL_KNOWN, _LEVEL_KNOWN, known)
    allowed = _CROSSED * known / turn
    tilt = select(p[A_N, A_N] > p[A_E, A_E], p[A_N, A_N], p[A_E, A_E])
    levelled = _TILT_CROSSED / math.sqrt(tilt)
    allowed = select(levelled < allowed, levelled, allowed)
    allowed = select(allowed < _NARROWEST * widest, _NARROWEST * widest, allowed)
    return select(allowed > widest, widest, allowed)


@kernel
def divide(mixture, which, index, space, bench):
    """Divide component `index` into three along heading, where `which` is true and two are free."""
    nav, p, other, square, x, along = bench.nav, bench.p, bench.other, bench.square, bench.x, bench.error
    weight, increments = mixture.weight, bench.increments
    n, most = p.shape[0], weight.shape[0]
    divided = 0.0 * weight[0]
    for j in range(most):
        own = which & (index == j)
        if any_lane(own):
            _take(own, mixture, j, nav, p, increments)
            divided = select(own, weight[j], divided)
    variance = p[A_D, A_D]
    for i in range(n):
        along[i] = p[i, A_D] / variance
    for a in range(n):
        for b in range(n):
            p[a, b] -= along[a] * along[b] * variance * (1.0 - _NARROWED * _NARROWED)
    for j in range(most):
        own = which & (index == j)
        if any_lane(own):
            _put(own, nav, p, increments, divided * (4.0 / 6.0), mixture, j)
    for side in range(2):
        for i in range(n):
            x[i] = along[i] * math.sqrt(variance) * (_OFFSET if side == 0 else -_OFFSET)
        copy(nav, other)
        copy_matrix(p, square)
        tfg.correct(other, square, x, space)
        free = which
        for j in range(1, most):
            own = free & (weight[j] == 0.0)
            if any_lane(own):
                _put(own, other, square, increments, divided * (1.0 / 6.0), mixture, j)
                free = free & no(own)


@kernel
def merge(mixture, which, first, second, space, bench):
    """Components `first` and `second` <- one of the same moments, in the place of the first, where `which` is true."""
    pair, weight, increments = bench.pair, mixture.weight, bench.increments
    most = weight.shape[0]
    for side in range(2):
        # something of weight in lanes that have no pair
        pair.weight[side] = 0.5
        index = first if side == 0 else second
        for j in range(most):
            own = which & (index == j)
            if any_lane(own):
                _take(own, mixture, j, pair.navigation[side], pair.covariance[side], pair.increments[side])
                pair.weight[side] = select(own, weight[j], pair.weight[side])
    total = pair.weight[0] + pair.weight[1]
    _share(total > 0.0, pair.weight)
    moments(pair, bench.nav, bench.p, False, space, bench)
    for i in range(6):
        increments[i] = pair.weight[0] * pair.increments[0, i] + pair.weight[1] * pair.increments[1, i]
    for j in range(most):
        own = which & (first == j)
        if any_lane(own):
            _put(own, bench.nav, bench.p, increments, total, mixture, j)
        weight[j] = select(which & (second == j), 0.0, weight[j])
    _close_ranks(mixture)


@kernel
def arrange(mixture, turn, widest, space, bench):
    """Merge and divide components until each is as narrow as a turn (rad) asks for, or there is no room."""
    weight = mixture.weight
    most = weight.shape[0]
    turning = turn > 0.0
    # the tails are right or wrong with the probability of their weight: splits for a turn may replace them
    slight = _SLIGHT * _TURN / select(turn > _TURN, turn, _TURN)
    places = select(turn > _QUICK, 1.0 * most, 1.0 * max(_FEWEST, int(_CALM * most)))
    for _ in range(4 * most):
        count = _count(weight)
        taken, needs, which, size = 0.0 * turn, 0.0 * turn, 0.0 * turn, 0.0 * turn
        for j in range(count):
            taken += select(weight[j] > 0.0, 1.0, 0.0)
            allowed = _allowed(mixture.navigation[j], mixture.covariance[j], turn, widest, space.c_nb)
            bench.allowed[j] = allowed * allowed
            width = math.sqrt(mixture.covariance[j, A_D, A_D]) / allowed
            need = weight[j] * width * width * width
            first = (width > 1.0) & (weight[j] > slight) & (need > needs)
            needs, size = select(first, need, needs), select(first, weight[j], size)
            which = select(first, 1.0 * j, which)
        # the pair with the smallest heading difference, by weight: of all, and of those that are narrow when merged
        least, one, two = 0.0 * turn + math.inf, 0.0 * turn, 0.0 * turn
        narrow, first_narrow, second_narrow = 0.0 * turn + math.inf, 0.0 * turn, 0.0 * turn
        for i in range(count):
            q = mixture.navigation[i, NAV_QUAT:NAV_HELD]
            for j in range(i + 1, count):
                r = mixture.navigation[j, NAV_QUAT:NAV_HELD]
                half = q[0] * r[3] + q[1] * r[2] - q[2] * r[1] - q[3] * r[0]
                apart = 4.0 * half * half
                total = weight[i] + weight[j]
                within_i, within_j = mixture.covariance[i, A_D, A_D], mixture.covariance[j, A_D, A_D]
                lost = weight[i] * weight[j] * apart / (total * 0.5 * (within_i + within_j))
                nearer = (weight[j] > 0.0) & (lost < least)
                least = select(nearer, lost, least)
                one, two = select(nearer, 1.0 * i, one), select(nearer, 1.0 * j, two)
                mean = (weight[i] * within_i + weight[j] * within_j) / total
                joint = mean + weight[i] * weight[j] * apart / (total * total)
                room_for = select(bench.allowed[i] < bench.allowed[j], bench.allowed[i], bench.allowed[j])
                fits = (joint < (_AS_ONE * widest) * (_AS_ONE * widest)) | (joint < _ROOMY * _ROOMY * room_for)
                fits = fits & (weight[j] > 0.0) & (lost < narrow)
                narrow = select(fits, lost, narrow)
                first_narrow, second_narrow = select(fits, 1.0 * i, first_narrow), select(fits, 1.0 * j, second_narrow)
        joins = turning & (narrow < math.inf)
        divides = turning & no(joins) & (needs > 0.0)
        full = taken > places - 2.0
        merges = joins | (divides & full & (least < _GAIN * size))
        divides = divides & no(full)
        one, two = select(joins, first_narrow, one), select(joins, second_narrow, two)
        if any_lane(merges):
            merge(mixture, merges, one, two, space, bench)
        if any_lane(divides):
            divide(mixture, divides, which, space, bench)
        if not any_lane(merges | divides):
            break


@kernel
def _together(weight, zs, ss, m, z, s):
    """Innovation z (m,) of a sum, and the factor s (m, m) of its covariance, from those of the components zs (M, MOST),
    ss (M, MOST, MOST). Returns whether it is one."""
    count = _count(weight)
    for a in range(m):
        z[a] = 0.0
        for j in range(count):
            z[a] += select(weight[j] > 0.0, weight[j] * zs[j, a], 0.0)
    for a in range(m):
        for b in range(a + 1):
            s[a, b] = 0.0
            for j in range(count):
                t = (zs[j, a] - z[a]) * (zs[j, b] - z[b])
                for c in range(b + 1):
                    t += ss[j, a, c] * ss[j, b, c]
                s[a, b] += select(weight[j] > 0.0, weight[j] * t, 0.0)
    return cholesky(s, m)


@kernel
def weigh(used, weight, squares, sizes):
    """Multiply the weights (M,) by the likelihoods of a measurement, if it is used; negligible weights become zero.

    squares (M,): normalised innovations squared, sizes (M,): roots of the determinants of their covariances.
    """
    count = _count(weight)
    least, of_least = 0.0 * weight[0] + math.inf, 0.0 * weight[0] + 1.0
    for j in range(count):
        better = (weight[j] > 0.0) & (squares[j] < least)
        least, of_least = select(better, squares[j], least), select(better, sizes[j], of_least)
    for j in range(count):
        there = (weight[j] > 0.0) & (squares[j] < math.inf)
        less = select(there, -0.5 * (squares[j] - least), 0.0)
        likelihood = select(there, exp_of_negative(less) * of_least / sizes[j], 0.0)
        weight[j] = select(used & (weight[j] > 0.0), weight[j] * likelihood, weight[j])
    _share(used, weight)
    for j in range(count):
        weight[j] = select(used & (weight[j] < _NEGLIGIBLE), 0.0, weight[j])
    _share(used, weight)


@kernel
def run(chart, imu, measurements, events, state, way, model, account):
    """Process the events with a Gaussian sum; arguments are those of `filter_loop.run`.

    The components of `state` continue. Its navigation and covariance become their moments after the last event that was
    not ahead. The increments of `way` are unused: each component has its own.
    """
    declared = model.declared
    state_nav, state_p, state_rejected = (
        registers(state.navigation),
        registers(state.covariance),
        registers(state.rejected),
    )
    left = opened(account)
    own = Mixture(
        registers(state.components.navigation), registers(state.components.covariance),
        registers(state.components.increments), registers(state.components.weight),
    )  # fmt: skip
    n, most, nav_size = state_p.shape[0], own.weight.shape[0], state_nav.shape[0]
    gauge = weighing(state_nav, n)
    zs, ss, ks = room(state_nav, (most, MOST)), room(state_nav, (most, MOST, MOST)), room(state_nav, (most, n, MOST))
    squares, sizes, numbers = room(state_nav, (most,)), room(state_nav, (most,)), room(state_nav, (most,))
    there = room(state_nav, (MOST,))
    space, bench = workshop(state_nav, n, chart.straight, declared), _bench(state_nav, n, most)
    epoch, first = range_epoch(state_nav, n, most, events, model.clock.scales.shape[0]), 0
    # the copy that runs ahead
    runs_ahead = False
    for i in range(events.ahead.shape[0]):  # numba's own `any` loads its linear algebra at every start
        runs_ahead |= events.ahead[i]
    late = _components(state_nav, most if runs_ahead else 1, nav_size, n)
    line, v, variance = registers(state.steady), room(state_nav, (3,)), room(state_nav, (3,))
    m_force, turns, attitude = room(state_nav, (3,)), room(state_nav, (most, 3)), room(state_nav, (4,))
    rejections, cursors, cursor = room(state_nav, (2, state_rejected.shape[0])), np.empty((2, 3)), np.empty(3)
    copy(state_rejected, rejections[0])
    copy(way.cursor, cursors[0])
    if way.cursor[0] < 0.0:
        for j in range(_count(own.weight)):
            start_axes(own.navigation[j])
            set_off(imu, own.navigation[j], declared, cursors[0], own.increments[j])
        start_line(line, own.navigation[0, NAV_VEL:NAV_QUAT], cursors[0, 1])
    before = 0
    for i in range(events.time.shape[0]):
        ahead = 1 if events.ahead[i] else 0
        if ahead > before:
            _copy_mixture(own, _count(own.weight), late)
            copy(cursors[0], cursors[1])
            copy(rejections[0], rejections[1])
        before = ahead
        now = late if ahead else own
        weight, rejected = now.weight, rejections[ahead]
        what, row = events.kind[i], events.row[i]
        nothing_yet(left, i)
        copy(cursors[ahead], cursor)
        count = _count(weight)
        # nowhere to go: in the midst of an epoch, too, whose components keep their places until its end
        if is_ahead(events.time[i], cursor):
            # a turn finds the components as narrow as it needs them
            turn = turn_ahead(imu, cursor, events.time[i], now.navigation[0])
            if any_lane(turn > 0.0):
                arrange(now, turn, model.widest, space, bench)
                count = _count(weight)
            if model.steady_force and not ahead and not has_begun(line):
                mean_velocity(now, count, v, variance)
                begin_interval(line, v, variance, force_noise(model, cursor), cursor[1])
            for j in range(count):
                copy(cursors[ahead], cursor)
                copy(now.navigation[j, NAV_QUAT:NAV_HELD], attitude)
                advance(
                    chart, events.time[i], imu, model, now.navigation[j], now.covariance[j], cursor, now.increments[j],
                    space,
                )  # fmt: skip
                _hold_axes(now.navigation[j], now.covariance[j], attitude, cursor[1] - cursors[ahead, 1], space.c_nb)
            copy(cursor, cursors[ahead])
        if model.steady_force and not ahead and what != OUTPUT and what != PASS and has_begun(line):
            mean_velocity(now, count, v, variance)
            turns_from_mean(now, count, turns, attitude)
            end_interval(line, v, variance, attitude, force_noise(model, cursor), cursor[1], m_force)
            couple_sum(now, count, m_force, turns)
        if what == OUTPUT:
            moments(now, gauge.nav, gauge.p, True, space, bench)
            answer(chart, gauge.nav, gauge.p, left, row)
        elif what != PASS:
            m = 0
            for a in range(MOST):
                there[a] = 0.0
            if what == RANGE and is_alone(events, i, 1):
                first = i
                begin_epoch(epoch)
                for j in range(count):
                    begin_estimate(epoch, j, now.covariance[j])
            for j in range(count):
                nav, increments = now.navigation[j], now.increments[j]
                if what == RANGE:
                    m = foresee(chart, row, measurements, declared, nav, increments, cursor[2], epoch, j, space, gauge)
                else:
                    m = observe(
                        what, row, measurements, nav, increments, cursor[2], declared, space.c_nb, gauge.have, gauge.z,
                        gauge.h, gauge.r,
                    )  # fmt: skip
                numbers[j] = numbers_in(gauge.have, m)
                for a in range(m):
                    more = (weight[j] > 0.0) & (gauge.have[a] > there[a])
                    there[a] = select(more, gauge.have[a], there[a])
                    zs[j, a] = gauge.z[a]
                good = gain(now.covariance[j], gauge.h, gauge.r, m, gauge.pht, ss[j], ks[j])
                copy(zs[j], gauge.z)
                square = whitened_square(ss[j], gauge.z, m)
                squares[j] = select(good & (square < math.inf), square, math.inf)
                sizes[j] = ss[j, 0, 0]
                for a in range(1, m):
                    sizes[j] *= ss[j, a, a]
            copy(there, gauge.have)
            degrees = numbers_in(there, m)
            # a component that is none any more goes, unless there is no other
            sound = weight[0] < 0.0
            for j in range(count):
                squares[j] = select(numbers[j] < degrees, math.inf, squares[j])
                sound = sound | ((weight[j] > 0.0) & (squares[j] < math.inf))
            fewer = weight[0] < 0.0
            for j in range(count):
                failed = sound & (weight[j] > 0.0) & no(squares[j] < math.inf)
                weight[j] = select(failed, 0.0, weight[j])
                fewer = fewer | failed
            if any_lane(fewer):
                _share(fewer, weight)
            weighed = _together(weight, zs, ss, m, gauge.z, gauge.s) & (degrees > 0.0) & sound
            where = slot(what, row, measurements)
            used = decide(ahead > 0, weighed, degrees, m, gauge, where, model, rejected, left, i)
            for j in range(count):
                own_use = used & (weight[j] > 0.0)
                if not any_lane(own_use):
                    continue
                nav, p, increments = now.navigation[j], now.covariance[j], now.increments[j]
                if what == RANGE:
                    # correction from another component is in the gauge
                    foresee(chart, row, measurements, declared, nav, increments, cursor[2], epoch, j, space, gauge)
                    gain(p, gauge.h, gauge.r, m, gauge.pht, gauge.s, gauge.k)
                    errors_from(ks[j], zs[j], m, gauge.x)
                    take_range(own_use, m, p, epoch, j, gauge)
                else:
                    errors_from(ks[j], zs[j], m, gauge.x)
                    update(
                        chart, used, what, row, measurements, declared, nav, p, increments, cursor[2], space, gauge
                    )  # fmt: skip
            weigh(used, weight, squares, sizes)
            if what == RANGE:
                count_range(measurements.ranges, row, i - first, weighed, used, epoch)
            if what == RANGE and is_alone(events, i, 0):
                for j in range(_count(weight)):
                    move_estimate(
                        chart, weight[j] > 0.0, events.row[first : i + 1], measurements, declared, now.navigation[j],
                        now.covariance[j], now.increments[j], cursor[2], epoch, j, space, gauge,
                    )  # fmt: skip
                if has_jumped(epoch.heard, epoch.kept, epoch.jumped):
                    for j in range(_count(weight)):
                        forget_clock(epoch.jumped, now.covariance[j])
            # places in the epoch are those of its beginning
            if what != RANGE or is_alone(events, i, 0):
                _close_ranks(now)
    moments(own, state_nav, state_p, True, space, bench)
    copy(rejections[0], state_rejected)
    copy(cursors[0], way.cursor)
