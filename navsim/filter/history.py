"""Output of an estimator: a history, or, if the truth is known, statistics of its errors.

An output consists of the navigation state and the covariance. A history stores both. An account evaluates them at once,
while they are in the processor's cache: the errors, and whether the filter's sigmas agree with them.

NEES uses the coordinates in which the filter is Gaussian (`error_parametrisation.own_error`). Source: Bar-Shalom, Li &
Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import in_kernels, kernel
from navsim.compiler.lanes import registers, room, select
from navsim.compiler.linear import copy, copy_matrix
from navsim.filter.covariance import normalised_square
from navsim.filter.error_parametrisation import own_error
from navsim.filter.eskf import plain_error
from navsim.filter.records import NOT_USED, REJECTED, USED, History, Judgement, Truth
from navsim.filter.states import ATT, MOST, POS


class Judging(NamedTuple):
    """An account as kernels write it, with work space: factor (n, n), own, x (n,)."""

    truth: Truth
    judgement: Judgement
    sigma: np.ndarray
    cross: np.ndarray
    innovation: np.ndarray
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray
    factor: np.ndarray
    own: np.ndarray
    x: np.ndarray


def opened(left):
    """A history or an account as kernels write it."""
    raise NotImplementedError("opened is for kernels")


@in_kernels(opened)
def _opened(left):
    if left.instance_class is History:
        return lambda left: History(
            registers(left.navigation), registers(left.covariance), registers(left.innovation),
            registers(left.innovation_sigma), registers(left.innovation_squared), registers(left.degrees),
            registers(left.status),
        )  # fmt: skip
    return _opened_account


def _opened_account(left):
    truth, judgement, sigma = left.truth, left.judgement, registers(left.sigma)
    n = sigma.shape[1]
    return Judging(
        Truth(
            registers(truth.llh), registers(truth.velocity), registers(truth.quaternion), registers(truth.sensors)
        ),
        Judgement(
            registers(judgement.error), registers(judgement.nees), registers(judgement.nees_position_velocity),
            registers(judgement.nees_group),
        ),
        sigma, registers(left.cross), registers(left.innovation), registers(left.innovation_squared),
        registers(left.degrees), registers(left.status), room(sigma, (n, n)), room(sigma, (n,)), room(sigma, (n,)),
    )  # fmt: skip


def answer(chart, nav, p, left, row):
    """Output `row` of a filter of this chart: nav (NAV,), p (n, n). left: from `opened`."""
    raise NotImplementedError("answer is for kernels")


@in_kernels(answer)
def _answer(chart, nav, p, left, row):
    return _keep if left.instance_class is History else _judge


def _keep(chart, nav, p, left, row):
    copy(nav, left.navigation[row])
    copy_matrix(p, left.covariance[row])


def _judge(chart, nav, p, left, row):
    truth, out, factor, own, x = left.truth, left.judgement, left.factor, left.own, left.x
    n = p.shape[0]
    error = out.error[row]
    plain_error(truth.llh[row], truth.velocity[row], truth.quaternion[row], truth.sensors[row], nav, error)
    own_error(chart, nav, error, own)
    for i in range(n):
        left.sigma[row, i] = math.sqrt(p[i, i])
    for k in range(2):
        i = ATT if k else POS
        left.cross[row, 3 * k], left.cross[row, 3 * k + 1] = p[i, i + 1], p[i, i + 2]
        left.cross[row, 3 * k + 2] = p[i + 1, i + 2]
    out.nees[row] = normalised_square(p, own, 0, n, factor, x)
    for group in range(out.nees_group.shape[1]):
        # position and velocity in plain coordinates, the rest in the filter's own
        if 3 * group < ATT:
            out.nees_group[row, group] = normalised_square(p, error, 3 * group, 3, factor, x)
        else:
            out.nees_group[row, group] = normalised_square(p, own, 3 * group, 3, factor, x)
    out.nees_position_velocity[row] = normalised_square(p, error, POS, ATT, factor, x)


def _no_innovation(left, i):
    """Store that event i has no innovation, if innovations are kept."""
    raise NotImplementedError("_no_innovation is for kernels")


@in_kernels(_no_innovation)
def _no_innovation_kept(left, i):
    return _nan_innovation if left.instance_class is History else _nan_of_account


def _nan_innovation(left, i):
    for a in range(MOST):
        left.innovation[i, a] = math.nan
        left.innovation_sigma[i, a] = math.nan


def _nan_of_account(left, i):
    if left.innovation.shape[0] > 0:
        for a in range(MOST):
            left.innovation[i, a] = math.nan


@kernel
def nothing_yet(left, i):
    """Nothing was measured at event i."""
    _no_innovation(left, i)
    left.innovation_squared[i] = math.nan
    left.degrees[i] = 0.0
    left.status[i] = NOT_USED


def keep_innovation(ahead, have, weighed, m, z, s, left, i):
    """Store innovations z (m,) of event i and their 1 sigma, from the factor s of their covariance; nan if missing.

    A history stores none of the copy that predicts ahead.
    """
    raise NotImplementedError("keep_innovation is for kernels")


@in_kernels(keep_innovation)
def _keep_innovation(ahead, have, weighed, m, z, s, left, i):
    return _innovation_kept if left.instance_class is History else _innovation_of_account


def _innovation_of_account(ahead, have, weighed, m, z, s, left, i):
    if left.innovation.shape[0] > 0:
        for a in range(m):
            left.innovation[i, a] = select(weighed & (have[a] > 0.0), z[a], math.nan)


def _innovation_kept(ahead, have, weighed, m, z, s, left, i):
    if ahead:
        return
    for a in range(m):
        t = s[a, 0] * s[a, 0]
        for b in range(1, a + 1):
            t += s[a, b] * s[a, b]
        there = weighed & (have[a] > 0.0)
        left.innovation[i, a] = select(there, z[a], math.nan)
        left.innovation_sigma[i, a] = select(there, math.sqrt(t), math.nan)


def keep_use(used, m, left, i):
    """Store the innovations (m,) of event i in an account if they were used."""
    raise NotImplementedError("keep_use is for kernels")


@in_kernels(keep_use)
def _keep_use(used, m, left, i):
    return (lambda used, m, left, i: None) if left.instance_class is History else _use_of_account


def _use_of_account(used, m, left, i):
    if left.innovation.shape[0] > 0:
        for a in range(m):
            left.innovation[i, a] = select(used, left.innovation[i, a], math.nan)


@kernel
def keep_decision(weighed, used, q, degrees, left, i):
    """Store the status of event i, and its normalised innovation squared q of so many degrees of freedom."""
    left.innovation_squared[i] = select(weighed, q, math.nan)
    left.degrees[i] = select(weighed, degrees, 0.0)
    left.status[i] = select(weighed, select(used, USED, REJECTED), left.status[i])


@kernel
def judge_all(chart, navigation, covariance, account):
    """Answer the outputs of an account from a history of them: navigation (o, NAV), covariance (o, n, n)."""
    navs, ps, left = registers(navigation), registers(covariance), opened(account)
    for row in range(navs.shape[0]):
        answer(chart, navs[row], ps[row], left, row)
