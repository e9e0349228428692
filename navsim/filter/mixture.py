"""The components of a Gaussian sum: their moments, their division before turns, and their merging."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import kernel, kernel_internal
from navsim.compiler.lanes import alloc, any_lane, no, small_matrix, small_vector, where
from navsim.compiler.linear import copy, copy_matrix, invert3
from navsim.filter import tfg
from navsim.filter.covariance import transported
from navsim.filter.eskf import between
from navsim.filter.left_invariant import turned
from navsim.filter.records import Mixture
from navsim.filter.states import ATT, NAV_BIAS_FRAME, NAV_GYRO, NAV_QUAT, PHI_D, PHI_E, PHI_N, POS
from navsim.filter.update import copy_where_not
from navsim.geodesy.attitude_kernels import dcm, left_jacobian

_SPLIT_SIGMA = 0.65
"""1 sigma of heading of each of the three that a component is divided into, in its own."""
_SPLIT_OFFSET = math.sqrt(3.0 * (1.0 - _SPLIT_SIGMA * _SPLIT_SIGMA))
"""Distance of the outer two components in 1 sigma. With the weights 1/6, 4/6, 1/6 all moments up to the fifth equal
those of the original."""
MIN_TURN = 0.02
"""A turn that must always be expected, rad."""
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
MIN_WEIGHT = 1e-5
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
def empty_components(like, most, nav_size, n):
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
def mixture_buffers(nav, n, most):
    """Allocate work space for so many components of n states."""
    size = nav.shape[0]
    return MixtureBuffers(
        alloc(nav, (n,)), alloc(nav, (n,)), alloc(nav, (n,)), alloc(nav, (size,)), alloc(nav, (size,)),
        alloc(nav, (n, n)),
        alloc(nav, (n, n)), alloc(nav, (6,)), empty_components(nav, 2, size, n), alloc(nav, (most,)),
    )  # fmt: skip


@kernel
def copy_mixture(source, count, target):
    """The first components."""
    for j in range(count):
        copy(source.navigation[j], target.navigation[j])
        copy_matrix(source.covariance[j], target.covariance[j])
        copy(source.increments[j], target.increments[j])
    copy(source.weight, target.weight)


@kernel
def count_components(weight):
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
def normalise_weights(which, weight):
    """Normalise the weights (M,) where `which` is true."""
    total = weight[0]
    for j in range(1, weight.shape[0]):
        total += weight[j]
    for j in range(weight.shape[0]):
        weight[j] = where(which, weight[j] / total, weight[j])


@kernel
def compact_components(mixture):
    """Components that are there <- first."""
    weight = mixture.weight
    count = count_components(weight)
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
    count = count_components(weight)
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
        transported(mixture.covariance[j], space.diagonal, space.column, first, space.turned, square)
        for a in range(n):
            for b in range(a + 1):
                p[a, b] = where(there, p[a, b] + weight[j] * (square[a, b] + x[a] * x[b]), p[a, b])
    for a in range(n):
        for b in range(a):
            p[b, a] = p[a, b]


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
            u = 0.5 * row[j] * p[ATT + j, ATT + j]
            for k in range(j):
                u += row[k] * p[ATT + j, ATT + k]
            t += 2.0 * row[j] * u
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
    normalise_weights(total > 0.0, pair.weight)
    moments(pair, mixture_work.nav, mixture_work.p, False, space, mixture_work)
    for i in range(6):
        increments[i] = pair.weight[0] * pair.increments[0, i] + pair.weight[1] * pair.increments[1, i]
    for j in range(most):
        own = which & (first == j)
        if any_lane(own):
            _store_component(own, mixture_work.nav, mixture_work.p, increments, total, mixture, j)
        weight[j] = where(which & (second == j), 0.0, weight[j])
    compact_components(mixture)


@kernel
def split_and_merge(mixture, turn, widest, space, mixture_work):
    """Merge and divide components until each is as narrow as a turn (rad) asks for, or there is no room."""
    weight = mixture.weight
    most = weight.shape[0]
    turning = turn > 0.0
    # the tails are right or wrong with the probability of their weight: splits for a turn may replace them
    slight = _MIN_SPLIT_WEIGHT * MIN_TURN / where(turn > MIN_TURN, turn, MIN_TURN)
    places = where(turn > _FAST_TURN, 1.0 * most, 1.0 * max(_SLOW_TURN_COMPONENTS, int(_SLOW_TURN_SHARE * most)))
    for _ in range(4 * most):
        count = count_components(weight)
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
