"""Output of an estimator: a history, or, if the truth is known, statistics of its errors.

An output consists of the navigation state and the covariance. A history stores both. An error history evaluates them at
once, while they are in the processor's cache: the errors, and whether the filter's sigmas agree with them.

NEES uses the coordinates of the covariance (`error_parametrisation.error_of_output`). Source: Bar-Shalom, Li &
Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), section 5.4.2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from navsim.compiler.jit import in_kernels, kernel
from navsim.compiler.lanes import alloc, as_simd, where
from navsim.compiler.linear import copy, copy_matrix
from navsim.filter.covariance import normalised_square
from navsim.filter.error_parametrisation import error_of_output
from navsim.filter.eskf import plain_error
from navsim.filter.records import NOT_USED, REJECTED, USED, History, OutputErrors, Truth
from navsim.filter.states import ATT, MAX_MEASUREMENT_SIZE, POS


class ErrorRegisters(NamedTuple):
    """An error history as kernels write it, with buffers: factor (n, n), filter_error, x (n,)."""

    truth: Truth
    errors: OutputErrors
    sigma: np.ndarray
    cross: np.ndarray
    innovation: np.ndarray
    innovation_squared: np.ndarray
    degrees: np.ndarray
    status: np.ndarray
    factor: np.ndarray
    filter_error: np.ndarray
    x: np.ndarray


def as_registers(record):
    """A history or an error history as kernels write it."""
    raise NotImplementedError("as_registers is for kernels")


@in_kernels(as_registers)
def _as_registers(record):
    if record.instance_class is History:
        return lambda record: History(
            as_simd(record.navigation), as_simd(record.covariance), as_simd(record.innovation),
            as_simd(record.innovation_sigma), as_simd(record.innovation_squared), as_simd(record.degrees),
            as_simd(record.status),
        )  # fmt: skip
    return _error_registers


def _error_registers(record):
    truth, errors, sigma = record.truth, record.errors, as_simd(record.sigma)
    n = sigma.shape[1]
    return ErrorRegisters(
        Truth(
            as_simd(truth.llh), as_simd(truth.velocity), as_simd(truth.quaternion), as_simd(truth.sensors)
        ),
        OutputErrors(
            as_simd(errors.error), as_simd(errors.nees), as_simd(errors.nees_position_velocity),
            as_simd(errors.nees_group),
        ),
        sigma, as_simd(record.cross), as_simd(record.innovation), as_simd(record.innovation_squared),
        as_simd(record.degrees), as_simd(record.status), alloc(sigma, (n, n)), alloc(sigma, (n,)), alloc(sigma, (n,)),
    )  # fmt: skip


def write_output(chart, nav, p, record, row):
    """Output `row` of a filter of this chart: nav (NAV,), p (n, n). record: from `as_registers`."""
    raise NotImplementedError("write_output is for kernels")


@in_kernels(write_output)
def _write_output(chart, nav, p, record, row):
    return _write_estimate if record.instance_class is History else _write_errors


def _write_estimate(chart, nav, p, record, row):
    copy(nav, record.navigation[row])
    copy_matrix(p, record.covariance[row])


def _write_errors(chart, nav, p, record, row):
    truth, out, factor, filter_error, x = record.truth, record.errors, record.factor, record.filter_error, record.x
    n = p.shape[0]
    error = out.error[row]
    plain_error(truth.llh[row], truth.velocity[row], truth.quaternion[row], truth.sensors[row], nav, error)
    error_of_output(chart, nav, error, filter_error)
    for i in range(n):
        record.sigma[row, i] = math.sqrt(p[i, i])
    for k in range(2):
        i = ATT if k else POS
        record.cross[row, 3 * k], record.cross[row, 3 * k + 1] = p[i, i + 1], p[i, i + 2]
        record.cross[row, 3 * k + 2] = p[i + 1, i + 2]
    out.nees[row] = normalised_square(p, filter_error, 0, n, factor, x)
    for group in range(out.nees_group.shape[1]):
        # position and velocity in plain coordinates, the rest in the filter's own
        if 3 * group < ATT:
            out.nees_group[row, group] = normalised_square(p, error, 3 * group, 3, factor, x)
        else:
            out.nees_group[row, group] = normalised_square(p, filter_error, 3 * group, 3, factor, x)
    out.nees_position_velocity[row] = normalised_square(p, error, POS, ATT, factor, x)


def _clear_innovation(record, i):
    """Store that event i has no innovation, if innovations are kept."""
    raise NotImplementedError("_clear_innovation is for kernels")


@in_kernels(_clear_innovation)
def _clear_innovation_kernel(record, i):
    return _clear_innovation_of_history if record.instance_class is History else _clear_innovation_of_errors


def _clear_innovation_of_history(record, i):
    for a in range(MAX_MEASUREMENT_SIZE):
        record.innovation[i, a] = math.nan
        record.innovation_sigma[i, a] = math.nan


def _clear_innovation_of_errors(record, i):
    if record.innovation.shape[0] > 0:
        for a in range(MAX_MEASUREMENT_SIZE):
            record.innovation[i, a] = math.nan


@kernel
def clear_event(record, i):
    """Nothing was measured at event i."""
    _clear_innovation(record, i)
    record.innovation_squared[i] = math.nan
    record.degrees[i] = 0.0
    record.status[i] = NOT_USED


def record_innovation(ahead, have, weighed, m, z, s, record, i):
    """Store innovations z (m,) of event i and their 1 sigma, from the factor s of their covariance; nan if missing.

    A history stores none of the copy that predicts ahead.
    """
    raise NotImplementedError("record_innovation is for kernels")


@in_kernels(record_innovation)
def _record_innovation(ahead, have, weighed, m, z, s, record, i):
    return _record_innovation_of_history if record.instance_class is History else _record_innovation_of_errors


def _record_innovation_of_errors(ahead, have, weighed, m, z, s, record, i):
    if record.innovation.shape[0] > 0:
        for a in range(m):
            record.innovation[i, a] = where(weighed & (have[a] > 0.0), z[a], math.nan)


def _record_innovation_of_history(ahead, have, weighed, m, z, s, record, i):
    if ahead:
        return
    for a in range(m):
        t = s[a, 0] * s[a, 0]
        for b in range(1, a + 1):
            t += s[a, b] * s[a, b]
        there = weighed & (have[a] > 0.0)
        record.innovation[i, a] = where(there, z[a], math.nan)
        record.innovation_sigma[i, a] = where(there, math.sqrt(t), math.nan)


def record_use(used, m, record, i):
    """Store the innovations (m,) of event i in an error history if they were used."""
    raise NotImplementedError("record_use is for kernels")


@in_kernels(record_use)
def _record_use(used, m, record, i):
    return (lambda used, m, record, i: None) if record.instance_class is History else _record_use_of_errors


def _record_use_of_errors(used, m, record, i):
    if record.innovation.shape[0] > 0:
        for a in range(m):
            record.innovation[i, a] = where(used, record.innovation[i, a], math.nan)


@kernel
def record_decision(weighed, used, q, degrees, record, i):
    """Store the status of event i, and its normalised innovation squared q of so many degrees of freedom."""
    record.innovation_squared[i] = where(weighed, q, math.nan)
    record.degrees[i] = where(weighed, degrees, 0.0)
    record.status[i] = where(weighed, where(used, USED, REJECTED), record.status[i])


@kernel
def evaluate_outputs(chart, navigation, covariance, errors):
    """Evaluate the outputs of a history into an error history: navigation (o, NAV), covariance (o, n, n)."""
    navs, ps, record = as_simd(navigation), as_simd(covariance), as_registers(errors)
    for row in range(navs.shape[0]):
        write_output(chart, navs[row], ps[row], record, row)
