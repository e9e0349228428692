"""Gaussian-sum filter over heading, `kind: gaussian-sum`.

A single Gaussian becomes inconsistent when the aircraft turns while its heading is uncertain. The biases B = C b are
known along level axes but not along the vertical, and they rotate with the body. The error is then a product of two
uncertain quantities. This filter holds several components, each with a small heading sigma. Each component is a `tfg`
filter with a rule of its own for the axes of the biases in turns (`_set_bias_axes`).

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
from navsim.compiler.jit import kernel, kernel_internal
from navsim.compiler.lanes import alloc, any_lane, as_simd, no, small_matrix, small_vector, where
from navsim.compiler.linear import cholesky, copy, copy_matrix, invert3
from navsim.filter import tfg
from navsim.filter.covariance import gain, transport
from navsim.filter.eskf import between
from navsim.filter.filter_loop import (
    advance,
    force_noise,
    is_later,
    propagation_buffers,
    start_axes,
    start_mechanisation,
)
from navsim.filter.history import as_error_registers, as_registers, clear_event, write_output
from navsim.filter.left_invariant import turned
from navsim.filter.measurement_models import RANGE, observe, slot
from navsim.filter.outliers import excess, expects_outliers
from navsim.filter.range_update import (
    accumulate_range,
    apply_epoch,
    begin_epoch,
    begin_estimate,
    count_range,
    is_epoch_boundary,
    predict_range,
    range_epoch,
)
from navsim.filter.receiver_clock import detect_clock_jumps, reset_clock
from navsim.filter.records import OUTPUT, PASS, TIME_TOLERANCE, Mixture
from navsim.filter.states import (
    ATT,
    GYRO,
    MAX_MEASUREMENT_SIZE,
    NAV_BIAS_FRAME,
    NAV_GYRO,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    PHI_D,
    PHI_E,
    PHI_N,
    POS,
)
from navsim.filter.steady_force import (
    begin_interval,
    couple_sum,
    end_interval,
    is_interval_started,
    mean_velocity,
    start_line,
    turns_from_mean,
)
from navsim.filter.update import (
    apply_gate,
    copy_where_not,
    count_valid,
    estimate_errors,
    update,
    update_buffers,
    whitened_square,
)
from navsim.geodesy.attitude_kernels import dcm, left_jacobian

_SPLIT_SIGMA = 0.65
"""1 sigma of heading of each of the three that a component is divided into, in its own."""
_SPLIT_OFFSET = math.sqrt(3.0 * (1.0 - _SPLIT_SIGMA * _SPLIT_SIGMA))
"""Distance of the outer two components in 1 sigma. With the weights 1/6, 4/6, 1/6 all moments up to the fifth equal
those of the original."""
_MIN_TURN = 0.02
"""A turn that must always be expected, rad."""
_TURN_HORIZON = 2.0
"""Time for which a turn is expected to continue, s."""
_FREEZE_RATE = 0.002
"""Least rate about the level axes of the body that is a turn, rad/s."""
_FREEZE_HEADING = 0.003
"""1 sigma of heading below which bias axes are not held, rad."""
_PLAIN_HEADING = 0.02
"""1 sigma of heading below which bias errors may become plain instead of held, rad."""
_PLAIN_BANK = 0.15
"""Bank or pitch, from the held axes, beyond which they become plain, rad."""
_FREEZE_LEVEL_BIAS = 0.1
"""Largest sigma of level gyro biases for which axes are held, relative to the vertical one."""
_MAX_QUADRATIC_ERROR = 0.5
"""Largest quadratic error of a level bias that a turn may cause, relative to its sigma."""
_MAX_LEVEL_BIAS = 0.01
"""Largest sigma of level biases that the limit assumes, relative to the vertical one. At first they are unknown, but a
quadratic error caused then shows later."""
_MAX_HEADING_TILT = 0.0015
"""Largest product of the sigmas of heading and of tilt of a component, rad2. While the filter learns tilt, heading
rotates the information of each fix about it."""
_MIN_SPLIT_SIGMA = 0.5
"""1 sigma of heading that no turn asks to divide, in that of the widest component."""
_MERGE_FRACTION = 0.4
"""1 sigma of heading of two as one, in that of the widest, below which they become one."""
_CROWDED_MERGE_FRACTION = 0.7
"""Merge two components if their joint heading sigma is below this fraction of the allowed one. It is above that of
three parts of a split component, whose distances keep them apart."""
_MIN_WEIGHT = 1e-5
"""Components of less weight go."""
_MIN_SPLIT_WEIGHT = 0.005
"""Components with less weight are not split in straight flight. In a turn the limit falls as the turn grows."""
_FAST_TURN = 0.1
"""A turn that may take all the room there is, rad."""
_SLOW_TURN_SHARE = 0.625
"""Fraction of the components that a slower turn may use."""
_SLOW_TURN_COMPONENTS = 3
"""Components that a slow turn may always use."""
_MERGE_COST = 0.3
"""Without free room, merge two components to split another if the merge costs less than this fraction of the gain. The
cost is the weight of the two, as far as they differ; the gain is the weight of the other."""


class MixtureBuffers(NamedTuple):
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


@kernel_internal
def _components(like, most, nav_size, n):
    """Allocate so many components, all without weight."""
    mixture = Mixture(
        alloc(like, (most, nav_size)), alloc(like, (most, n, n)), alloc(like, (most, 6)), alloc(like, (most,))
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


@kernel_internal
def _mixture_buffers(nav, n, most):
    """Allocate work space for so many components of n states."""
    size = nav.shape[0]
    return MixtureBuffers(
        alloc(nav, (n,)), alloc(nav, (n,)), alloc(nav, (n,)), alloc(nav, (size,)), alloc(nav, (size,)),
        alloc(nav, (n, n)),
        alloc(nav, (n, n)), alloc(nav, (6,)), _components(nav, 2, size, n), alloc(nav, (most,)),
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
def _load_component(which, mixture, j, nav, p, increments):
    """nav, p, increments <- component j where `which` is true."""
    copy_where_not(mixture.navigation[j], no(which), nav)
    copy_where_not(mixture.increments[j], no(which), increments)
    for i in range(p.shape[0]):
        copy_where_not(mixture.covariance[j, i], no(which), p[i])


@kernel
def _store_component(which, nav, p, increments, weight, mixture, j):
    """Component j <- nav, p, increments, weight where `which` is true."""
    copy_where_not(nav, no(which), mixture.navigation[j])
    copy_where_not(increments, no(which), mixture.increments[j])
    for i in range(p.shape[0]):
        copy_where_not(p[i], no(which), mixture.covariance[j, i])
    mixture.weight[j] = where(which, weight, mixture.weight[j])


@kernel
def _normalise_weights(which, weight):
    """Normalise the weights (M,) where `which` is true."""
    total = weight[0]
    for j in range(1, weight.shape[0]):
        total += weight[j]
    for j in range(weight.shape[0]):
        weight[j] = where(which, weight[j] / total, weight[j])


@kernel
def _compact_components(mixture):
    """Components that are there <- first."""
    weight = mixture.weight
    count = _count(weight)
    for empty in range(count):
        for j in range(count - 1, empty, -1):
            moves = (weight[empty] == 0.0) & (weight[j] > 0.0)
            if any_lane(moves):
                nav, p, increments = mixture.navigation[j], mixture.covariance[j], mixture.increments[j]
                _store_component(moves, nav, p, increments, weight[j], mixture, empty)
                weight[j] = where(moves, 0.0, weight[j])


@kernel
def _invert_blocks(diagonal, column, first):
    """The inverse of a matrix of such blocks (b, 3, 3) from `first` on, see `filter.covariance.transport`, in place."""
    attitude = ATT // 3
    inverse, theta, work = small_matrix(diagonal, 3, 3), small_matrix(diagonal, 3, 3), small_matrix(diagonal, 3, 3)
    invert3(diagonal[attitude], theta)
    for block in range(first, diagonal.shape[0]):
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
def _deviation(component, nav, flat, straight, body, error, x):
    """Difference x (n,) of a component (NAV,) from nav, in the chart at nav.

    flat: plain differences of positions and velocities instead. straight, body: of the chart. error (n,): work space.
    """
    between(component, nav, error)
    tfg.error_in_filter_coordinates(nav, error, x, straight, body)
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
def moments(mixture, nav, p, flat, space, mixture_work):
    """Mean nav (NAV,) and covariance p (n, n) of a sum.

    Components are split and merged in the chart at their mean. The output is `flat`: plain positions and velocities.
    The chart rotates a position difference by half of the heading difference. If one direction is known well and
    another badly, as with two sources, the rotation would spoil the well-known one.

    space: `filter_loop.propagation_buffers`.
    """
    weight, x, error, other, square = (
        mixture.weight,
        mixture_work.x,
        mixture_work.error,
        mixture_work.other,
        mixture_work.square,
    )
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
        heaviest = where(heavier, weight[j], heaviest)
        copy_where_not(mixture.navigation[j], no(heavier), nav)
    # to the mean, from the heaviest
    for _ in range(2):
        for i in range(n):
            mixture_work.mean[i] = 0.0
        for j in range(count):
            _deviation(mixture.navigation[j], nav, flat, space.straight, space.body, error, x)
            for i in range(n):
                mixture_work.mean[i] += where(weight[j] > 0.0, weight[j] * x[i], 0.0)
        if flat:
            _unturned(space, mixture_work.mean)
        copy(nav, other)
        tfg.feed_back(other, mixture_work.mean, space)
        copy_where_not(other, no(several), nav)
    for a in range(n):
        for b in range(a + 1):
            p[a, b] = where(several, 0.0, p[a, b])
    first = ATT // 3 if flat else space.straight
    for j in range(count):
        there = several & (weight[j] > 0.0)
        _deviation(mixture.navigation[j], nav, flat, space.straight, space.body, error, x)
        # inverse of the reset from the mean to the component; states with plain errors have none
        copy(nav, other)
        tfg.feed_back(other, x, space)
        _invert_blocks(space.diagonal, space.column, first)
        copy_matrix(mixture.covariance[j], square)
        transport(square, space.diagonal, space.column, first, space.turned)
        for a in range(n):
            for b in range(a + 1):
                p[a, b] = where(there, p[a, b] + weight[j] * (square[a, b] + x[a] * x[b]), p[a, b])
    for a in range(n):
        for b in range(a):
            p[b, a] = p[a, b]


@kernel
def expected_turn(imu, cursor, until, nav):
    """Angle (rad) by which the body is expected to turn, from its turn until `until`; 0 if that is now."""
    time, dtheta = imu.time, as_simd(imu.dtheta)
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
    return _MIN_TURN + size * max(1.0, _TURN_HORIZON / span) if span > 0.0 else 0.0 * size


@kernel
def _set_bias_axes(nav, p, before, dt, axes):
    """Set the axes of the bias errors after the body's turn in dt (s) since the attitude `before` (4,).

    Before a turn the filter knows the biases in body axes: the level ones well, the vertical one badly. Axes that
    turned with the body would add half of heading error x turn x vertical bias to the level ones. So the turn is held
    back until heading is known. If the aircraft is then banked, bias errors become plain, since the vertical bias also
    changes tilt in a bank. axes (3, 3): work space.
    """
    held, q = nav[NAV_BIAS_FRAME:NAV_SENSORS], nav[NAV_QUAT:NAV_BIAS_FRAME]
    # the conjugate of the attitude before, times that of now
    w = before[0] * q[0] + before[1] * q[1] + before[2] * q[2] + before[3] * q[3]
    x = before[0] * q[1] - before[1] * q[0] - before[2] * q[3] + before[3] * q[2]
    y = before[0] * q[2] + before[1] * q[3] - before[2] * q[0] - before[3] * q[1]
    z = before[0] * q[3] - before[1] * q[2] + before[2] * q[1] - before[3] * q[0]
    turning = 4.0 * (x * x + y * y) > (_FREEZE_RATE * dt) * (_FREEZE_RATE * dt)
    holds = turning | (abs(held[1]) + abs(held[2]) + abs(held[3]) > 0.0)
    plain = tfg.is_plain(nav)
    if not any_lane(holds | plain):
        return
    variance = small_vector(nav, 3)
    tfg.bias_axes(nav, axes)
    for i in range(3):
        variance[i] = 0.0
        for j in range(3):
            for k in range(3):
                variance[i] += axes[i, j] * p[GYRO + j, GYRO + k] * axes[i, k]
    level = where(variance[0] > variance[1], variance[0], variance[1])
    heading = p[PHI_D, PHI_D]
    holds = holds & (heading > _FREEZE_HEADING * _FREEZE_HEADING)
    holds = holds & no(plain) & (level < _FREEZE_LEVEL_BIAS * _FREEZE_LEVEL_BIAS * variance[2])
    # plain axes have no vertical one: of the eigenvalues of the covariance, their sum and that of products of two
    g = p[GYRO : GYRO + 3, GYRO : GYRO + 3]
    total = g[0, 0] + g[1, 1] + g[2, 2]
    products = g[0, 0] * g[1, 1] + g[0, 0] * g[2, 2] + g[1, 1] * g[2, 2]
    products -= g[0, 1] * g[0, 1] + g[0, 2] * g[0, 2] + g[1, 2] * g[1, 2]
    banked = 4.0 * (held[1] * held[1] + held[2] * held[2]) > _PLAIN_BANK * _PLAIN_BANK
    plain = plain | (holds & banked & (heading < _PLAIN_HEADING * _PLAIN_HEADING))
    plain = plain & (products < _FREEZE_LEVEL_BIAS * _FREEZE_LEVEL_BIAS * total * total)
    turns = holds & turning
    a, b, c, d = held[0], held[1], held[2], held[3]
    held[0] = where(plain, 0.0, where(turns, a * w - b * x - c * y - d * z, where(holds, a, 1.0)))
    held[1] = where(plain, 0.0, where(turns, a * x + b * w + c * z - d * y, where(holds, b, 0.0)))
    held[2] = where(plain, 0.0, where(turns, a * y - b * z + c * w + d * x, where(holds, c, 0.0)))
    held[3] = where(plain, 0.0, where(turns, a * z + b * y - c * x + d * w, where(holds, d, 0.0)))


@kernel
def _largest_heading_sigma(nav, p, turn, widest, c_nb):
    """Largest heading sigma (rad) of a component before a turn.

    A turn rotates part of the vertical bias into a level one, in a direction known as well as heading. The quadratic
    error of the level bias is the heading sigma x the turn x sigma of the vertical bias.
    """
    dcm(nav[NAV_QUAT:NAV_BIAS_FRAME], c_nb)
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
    level = where(variance[0] < variance[1], variance[0], variance[1])
    known = math.sqrt(level / variance[2])
    known = where(known > _MAX_LEVEL_BIAS, _MAX_LEVEL_BIAS, known)
    allowed = _MAX_QUADRATIC_ERROR * known / turn
    tilt = where(p[PHI_N, PHI_N] > p[PHI_E, PHI_E], p[PHI_N, PHI_N], p[PHI_E, PHI_E])
    levelled = _MAX_HEADING_TILT / math.sqrt(tilt)
    allowed = where(levelled < allowed, levelled, allowed)
    allowed = where(allowed < _MIN_SPLIT_SIGMA * widest, _MIN_SPLIT_SIGMA * widest, allowed)
    return where(allowed > widest, widest, allowed)


@kernel
def split(mixture, which, index, space, mixture_work):
    """Divide component `index` into three along heading, where `which` is true and two are free."""
    nav, p, other, square, x, along = (
        mixture_work.nav,
        mixture_work.p,
        mixture_work.other,
        mixture_work.square,
        mixture_work.x,
        mixture_work.error,
    )
    weight, increments = mixture.weight, mixture_work.increments
    n, most = p.shape[0], weight.shape[0]
    divided = 0.0 * weight[0]
    for j in range(most):
        own = which & (index == j)
        if any_lane(own):
            _load_component(own, mixture, j, nav, p, increments)
            divided = where(own, weight[j], divided)
    variance = p[PHI_D, PHI_D]
    for i in range(n):
        along[i] = p[i, PHI_D] / variance
    for a in range(n):
        for b in range(n):
            p[a, b] -= along[a] * along[b] * variance * (1.0 - _SPLIT_SIGMA * _SPLIT_SIGMA)
    for j in range(most):
        own = which & (index == j)
        if any_lane(own):
            _store_component(own, nav, p, increments, divided * (4.0 / 6.0), mixture, j)
    for side in range(2):
        for i in range(n):
            x[i] = along[i] * math.sqrt(variance) * (_SPLIT_OFFSET if side == 0 else -_SPLIT_OFFSET)
        copy(nav, other)
        copy_matrix(p, square)
        tfg.correct(other, square, x, space)
        free = which
        for j in range(1, most):
            own = free & (weight[j] == 0.0)
            if any_lane(own):
                _store_component(own, other, square, increments, divided * (1.0 / 6.0), mixture, j)
                free = free & no(own)


@kernel
def merge(mixture, which, first, second, space, mixture_work):
    """Components `first` and `second` <- one of the same moments, in the place of the first, where `which` is true."""
    pair, weight, increments = mixture_work.pair, mixture.weight, mixture_work.increments
    most = weight.shape[0]
    for side in range(2):
        # something of weight in lanes that have no pair
        pair.weight[side] = 0.5
        index = first if side == 0 else second
        for j in range(most):
            own = which & (index == j)
            if any_lane(own):
                _load_component(own, mixture, j, pair.navigation[side], pair.covariance[side], pair.increments[side])
                pair.weight[side] = where(own, weight[j], pair.weight[side])
    total = pair.weight[0] + pair.weight[1]
    _normalise_weights(total > 0.0, pair.weight)
    moments(pair, mixture_work.nav, mixture_work.p, False, space, mixture_work)
    for i in range(6):
        increments[i] = pair.weight[0] * pair.increments[0, i] + pair.weight[1] * pair.increments[1, i]
    for j in range(most):
        own = which & (first == j)
        if any_lane(own):
            _store_component(own, mixture_work.nav, mixture_work.p, increments, total, mixture, j)
        weight[j] = where(which & (second == j), 0.0, weight[j])
    _compact_components(mixture)


@kernel
def split_and_merge(mixture, turn, widest, space, mixture_work):
    """Merge and divide components until each is as narrow as a turn (rad) asks for, or there is no room."""
    weight = mixture.weight
    most = weight.shape[0]
    turning = turn > 0.0
    # the tails are right or wrong with the probability of their weight: splits for a turn may replace them
    slight = _MIN_SPLIT_WEIGHT * _MIN_TURN / where(turn > _MIN_TURN, turn, _MIN_TURN)
    places = where(turn > _FAST_TURN, 1.0 * most, 1.0 * max(_SLOW_TURN_COMPONENTS, int(_SLOW_TURN_SHARE * most)))
    for _ in range(4 * most):
        count = _count(weight)
        taken, needs, which, size = 0.0 * turn, 0.0 * turn, 0.0 * turn, 0.0 * turn
        for j in range(count):
            taken += where(weight[j] > 0.0, 1.0, 0.0)
            allowed = _largest_heading_sigma(mixture.navigation[j], mixture.covariance[j], turn, widest, space.c_nb)
            mixture_work.allowed[j] = allowed * allowed
            width = math.sqrt(mixture.covariance[j, PHI_D, PHI_D]) / allowed
            need = weight[j] * width * width * width
            first = (width > 1.0) & (weight[j] > slight) & (need > needs)
            needs, size = where(first, need, needs), where(first, weight[j], size)
            which = where(first, 1.0 * j, which)
        # the pair with the smallest heading difference, by weight: of all, and of those that are narrow when merged
        least, one, two = 0.0 * turn + math.inf, 0.0 * turn, 0.0 * turn
        narrow, first_narrow, second_narrow = 0.0 * turn + math.inf, 0.0 * turn, 0.0 * turn
        for i in range(count):
            q = mixture.navigation[i, NAV_QUAT:NAV_BIAS_FRAME]
            for j in range(i + 1, count):
                r = mixture.navigation[j, NAV_QUAT:NAV_BIAS_FRAME]
                half = q[0] * r[3] + q[1] * r[2] - q[2] * r[1] - q[3] * r[0]
                apart = 4.0 * half * half
                total = weight[i] + weight[j]
                within_i, within_j = mixture.covariance[i, PHI_D, PHI_D], mixture.covariance[j, PHI_D, PHI_D]
                lost = weight[i] * weight[j] * apart / (total * 0.5 * (within_i + within_j))
                nearer = (weight[j] > 0.0) & (lost < least)
                least = where(nearer, lost, least)
                one, two = where(nearer, 1.0 * i, one), where(nearer, 1.0 * j, two)
                mean = (weight[i] * within_i + weight[j] * within_j) / total
                joint = mean + weight[i] * weight[j] * apart / (total * total)
                room_for = where(
                    mixture_work.allowed[i] < mixture_work.allowed[j], mixture_work.allowed[i], mixture_work.allowed[j]
                )
                fits = (joint < (_MERGE_FRACTION * widest) * (_MERGE_FRACTION * widest)) | (
                    joint < _CROWDED_MERGE_FRACTION * _CROWDED_MERGE_FRACTION * room_for
                )
                fits = fits & (weight[j] > 0.0) & (lost < narrow)
                narrow = where(fits, lost, narrow)
                first_narrow, second_narrow = where(fits, 1.0 * i, first_narrow), where(fits, 1.0 * j, second_narrow)
        joins = turning & (narrow < math.inf)
        divides = turning & no(joins) & (needs > 0.0)
        full = taken > places - 2.0
        merges = joins | (divides & full & (least < _MERGE_COST * size))
        divides = divides & no(full)
        one, two = where(joins, first_narrow, one), where(joins, second_narrow, two)
        if any_lane(merges):
            merge(mixture, merges, one, two, space, mixture_work)
        if any_lane(divides):
            split(mixture, divides, which, space, mixture_work)
        if not any_lane(merges | divides):
            break


@kernel
def _mixture_innovation(weight, zs, ss, m, z, s):
    """Innovation z (m,) of a sum, and the factor s (m, m) of its covariance, from those of the components zs (M, MOST),
    ss (M, MOST, MOST). Returns whether it is one."""
    count = _count(weight)
    for a in range(m):
        z[a] = 0.0
        for j in range(count):
            z[a] += where(weight[j] > 0.0, weight[j] * zs[j, a], 0.0)
    for a in range(m):
        for b in range(a + 1):
            s[a, b] = 0.0
            for j in range(count):
                t = (zs[j, a] - z[a]) * (zs[j, b] - z[b])
                for c in range(b + 1):
                    t += ss[j, a, c] * ss[j, b, c]
                s[a, b] += where(weight[j] > 0.0, weight[j] * t, 0.0)
    return cholesky(s, m)


@kernel
def update_weights(used, weight, squares, sizes):
    """Multiply the weights (M,) by the likelihoods of a measurement, if it is used; negligible weights become zero.

    squares (M,): normalised innovations squared, sizes (M,): roots of the determinants of their covariances.
    """
    count = _count(weight)
    least, of_least = 0.0 * weight[0] + math.inf, 0.0 * weight[0] + 1.0
    for j in range(count):
        better = (weight[j] > 0.0) & (squares[j] < least)
        least, of_least = where(better, squares[j], least), where(better, sizes[j], of_least)
    for j in range(count):
        there = (weight[j] > 0.0) & (squares[j] < math.inf)
        less = where(there, -0.5 * (squares[j] - least), 0.0)
        likelihood = where(there, exp_of_negative(less) * of_least / sizes[j], 0.0)
        weight[j] = where(used & (weight[j] > 0.0), weight[j] * likelihood, weight[j])
    _normalise_weights(used, weight)
    for j in range(count):
        weight[j] = where(used & (weight[j] < _MIN_WEIGHT), 0.0, weight[j])
    _normalise_weights(used, weight)


@kernel
def run(chart, imu, measurements, events, state, stream, model, history, errors):
    """Process the events with a Gaussian sum; arguments are those of `filter_loop.run`.

    The components of `state` continue. Its navigation and covariance become their moments after the last event that was
    not ahead. The increments of `stream` are unused: each component has its own.
    """
    declared = model.declared
    state_nav, state_p, state_rejected = (
        as_simd(state.navigation),
        as_simd(state.covariance),
        as_simd(state.rejected),
    )
    record, account = as_registers(history), as_error_registers(errors)
    own = Mixture(
        as_simd(state.components.navigation), as_simd(state.components.covariance),
        as_simd(state.components.increments), as_simd(state.components.weight),
    )  # fmt: skip
    n, most, nav_size = state_p.shape[0], own.weight.shape[0], state_nav.shape[0]
    buffers = update_buffers(state_nav, n)
    zs, ss, ks = (
        alloc(state_nav, (most, MAX_MEASUREMENT_SIZE)),
        alloc(state_nav, (most, MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)),
        alloc(state_nav, (most, n, MAX_MEASUREMENT_SIZE)),
    )
    squares, sizes, numbers = alloc(state_nav, (most,)), alloc(state_nav, (most,)), alloc(state_nav, (most,))
    spreads = alloc(state_nav, (most,))
    there = alloc(state_nav, (MAX_MEASUREMENT_SIZE,))
    space, mixture_work = (
        propagation_buffers(state_nav, n, chart.straight, declared),
        _mixture_buffers(state_nav, n, most),
    )
    epoch, first = range_epoch(state_nav, n, most, events, model.clock.scales.shape[0]), 0
    # the copy that runs ahead
    runs_ahead = False
    for i in range(events.ahead.shape[0]):  # numba's own `any` loads its linear algebra at every start
        runs_ahead |= events.ahead[i]
    late = _components(state_nav, most if runs_ahead else 1, nav_size, n)
    line, v, variance = as_simd(state.steady), alloc(state_nav, (3,)), alloc(state_nav, (3,))
    m_force, turns, attitude = alloc(state_nav, (3,)), alloc(state_nav, (most, 3)), alloc(state_nav, (4,))
    rejections, cursors, cursor = alloc(state_nav, (2, state_rejected.shape[0])), np.empty((2, 3)), np.empty(3)
    copy(state_rejected, rejections[0])
    copy(stream.cursor, cursors[0])
    if stream.cursor[0] < 0.0:
        for j in range(_count(own.weight)):
            start_axes(own.navigation[j])
            start_mechanisation(imu, own.navigation[j], declared, cursors[0], own.increments[j])
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
        kind, row = events.kind[i], events.row[i]
        clear_event(record, i)
        copy(cursors[ahead], cursor)
        count = _count(weight)
        # nowhere to go: in the midst of an epoch, too, whose components keep their places until its end
        if is_later(events.time[i], cursor):
            # a turn finds the components as narrow as it needs them
            turn = expected_turn(imu, cursor, events.time[i], now.navigation[0])
            if any_lane(turn > 0.0):
                split_and_merge(now, turn, model.widest, space, mixture_work)
                count = _count(weight)
            if model.steady_force and not ahead and not is_interval_started(line):
                mean_velocity(now, count, v, variance)
                begin_interval(line, v, variance, force_noise(model, cursor), cursor[1])
            for j in range(count):
                copy(cursors[ahead], cursor)
                copy(now.navigation[j, NAV_QUAT:NAV_BIAS_FRAME], attitude)
                advance(
                    chart, events.time[i], imu, model, now.navigation[j], now.covariance[j], cursor, now.increments[j],
                    space,
                )  # fmt: skip
                _set_bias_axes(
                    now.navigation[j], now.covariance[j], attitude, cursor[1] - cursors[ahead, 1], space.c_nb
                )
            copy(cursor, cursors[ahead])
        if model.steady_force and not ahead and kind != OUTPUT and kind != PASS and is_interval_started(line):
            mean_velocity(now, count, v, variance)
            turns_from_mean(now, count, turns, attitude)
            end_interval(line, v, variance, attitude, force_noise(model, cursor), cursor[1], m_force)
            couple_sum(now, count, m_force, turns)
        if kind == OUTPUT:
            moments(now, buffers.nav, buffers.p, True, space, mixture_work)
            write_output(chart, buffers.nav, buffers.p, record, account, row)
        elif kind != PASS:
            m = 0
            for a in range(MAX_MEASUREMENT_SIZE):
                there[a] = 0.0
            if kind == RANGE and is_epoch_boundary(events, i, 1):
                first = i
                begin_epoch(epoch)
                for j in range(count):
                    begin_estimate(epoch, j, now.covariance[j])
            for j in range(count):
                nav, increments = now.navigation[j], now.increments[j]
                if kind == RANGE:
                    m = predict_range(
                        chart, row, measurements, declared, nav, increments, cursor[2], epoch, j, space, buffers
                    )
                else:
                    m = observe(
                        kind, row, measurements, nav, increments, cursor[2], declared, space.c_nb, buffers.have,
                        buffers.z,
                        buffers.h, buffers.r,
                    )  # fmt: skip
                numbers[j] = count_valid(buffers.have, m)
                for a in range(m):
                    more = (weight[j] > 0.0) & (buffers.have[a] > there[a])
                    there[a] = where(more, buffers.have[a], there[a])
                    zs[j, a] = buffers.z[a]
                good = gain(now.covariance[j], buffers.h, buffers.r, m, buffers.pht, ss[j], ks[j])
                copy(zs[j], buffers.z)
                square = whitened_square(ss[j], buffers.z, m)
                squares[j] = where(good & (square < math.inf), square, math.inf)
                sizes[j] = ss[j, 0, 0]
                for a in range(1, m):
                    sizes[j] *= ss[j, a, a]
                if expects_outliers(kind, measurements):
                    outliers = measurements.beacons.outliers
                    mean, spreads[j], square, sizes[j] = excess(zs[j, 0], ss[j, 0, 0], outliers)
                    squares[j] = where(squares[j] < math.inf, square, squares[j])
                    zs[j, 0] -= mean
            copy(there, buffers.have)
            degrees = count_valid(there, m)
            # a component that is none any more goes, unless there is no other
            sound = weight[0] < 0.0
            for j in range(count):
                squares[j] = where(numbers[j] < degrees, math.inf, squares[j])
                sound = sound | ((weight[j] > 0.0) & (squares[j] < math.inf))
            fewer = weight[0] < 0.0
            for j in range(count):
                failed = sound & (weight[j] > 0.0) & no(squares[j] < math.inf)
                weight[j] = where(failed, 0.0, weight[j])
                fewer = fewer | failed
            if any_lane(fewer):
                _normalise_weights(fewer, weight)
            weighed = _mixture_innovation(weight, zs, ss, m, buffers.z, buffers.s) & (degrees > 0.0) & sound
            counter = slot(kind, row, measurements)
            tested = not expects_outliers(kind, measurements)
            used = apply_gate(ahead > 0, weighed, degrees, m, buffers, counter, tested, model, rejected, record, i)
            for j in range(count):
                own_use = used & (weight[j] > 0.0)
                if not any_lane(own_use):
                    continue
                nav, p, increments = now.navigation[j], now.covariance[j], now.increments[j]
                if kind == RANGE:
                    # correction from another component is in the buffers
                    predict_range(
                        chart, row, measurements, declared, nav, increments, cursor[2], epoch, j, space, buffers
                    )
                    gain(p, buffers.h, buffers.r, m, buffers.pht, buffers.s, buffers.k)
                    estimate_errors(ks[j], zs[j], m, buffers.x)
                    accumulate_range(own_use, m, p, epoch, j, buffers)
                else:
                    estimate_errors(ks[j], zs[j], m, buffers.x)
                    buffers.spread[0] = spreads[j]
                    update(
                        chart, used, kind, row, measurements, declared, nav, p, increments, cursor[2], space, buffers
                    )  # fmt: skip
            update_weights(used, weight, squares, sizes)
            if kind == RANGE:
                count_range(measurements.ranges, row, i - first, weighed, used, epoch)
            if kind == RANGE and is_epoch_boundary(events, i, 0):
                for j in range(_count(weight)):
                    apply_epoch(
                        chart, weight[j] > 0.0, events.row[first : i + 1], measurements, declared, now.navigation[j],
                        now.covariance[j], now.increments[j], cursor[2], epoch, j, space, buffers,
                    )  # fmt: skip
                if detect_clock_jumps(epoch.available, epoch.accepted, epoch.jumped):
                    for j in range(_count(weight)):
                        reset_clock(epoch.jumped, now.covariance[j])
            # places in the epoch are those of its beginning
            if kind != RANGE or is_epoch_boundary(events, i, 0):
                _compact_components(now)
    moments(own, state_nav, state_p, True, space, mixture_work)
    copy(rejections[0], state_rejected)
    copy(cursors[0], stream.cursor)
