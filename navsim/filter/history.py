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

from navsim.compiler.jit import kernel, kernel_internal
from navsim.compiler.lanes import alloc, as_simd, where
from navsim.compiler.linear import copy, copy_matrix
from navsim.filter.covariance import normalised_square
from navsim.filter.error_parametrisation import error_of_output
from navsim.filter.error_products import FIRST, SECOND
from navsim.filter.eskf import plain_error
from navsim.filter.records import NOT_USED, REJECTED, USED, History, OutputErrors, Truth
from navsim.filter.states import ATT, MAX_MEASUREMENT_SIZE, POS


class ErrorRegisters(NamedTuple):
    """Outputs of an error history as kernels write them, with buffers: factor (n, n), filter_error, x (n,)."""

    truth: Truth
    errors: OutputErrors
    sigma: np.ndarray
    cross: np.ndarray
    factor: np.ndarray
    filter_error: np.ndarray
    x: np.ndarray


@kernel_internal
def as_registers(history):
    """A history as kernels write it."""
    return History(
        as_simd(history.navigation), as_simd(history.covariance), as_simd(history.innovation),
        as_simd(history.innovation_sigma), as_simd(history.innovation_squared), as_simd(history.degrees),
        as_simd(history.status),
    )  # fmt: skip


@kernel_internal
def as_error_registers(history):
    """The outputs of an error history as kernels write them."""
    truth, errors, sigma = history.truth, history.errors, as_simd(history.sigma)
    n = sigma.shape[1]
    return ErrorRegisters(
        Truth(as_simd(truth.llh), as_simd(truth.velocity), as_simd(truth.quaternion), as_simd(truth.sensors)),
        OutputErrors(
            as_simd(errors.error), as_simd(errors.nees), as_simd(errors.nees_position_velocity),
            as_simd(errors.nees_group),
        ),
        sigma, as_simd(history.cross), alloc(sigma, (n, n)), alloc(sigma, (n,)), alloc(sigma, (n,)),
    )  # fmt: skip


@kernel
def write_output(chart, nav, p, history, errors, row):
    """Output `row` of a filter of this chart, nav (NAV,) and p (n, n), into the records that have rows for it."""
    if history.navigation.shape[0] > 0:
        copy(nav, history.navigation[row])
        copy_matrix(p, history.covariance[row])
    if errors.sigma.shape[0] > 0:
        _write_errors(chart, nav, p, errors, row)


@kernel
def _write_errors(chart, nav, p, record, row):
    truth, out, factor, filter_error, x = record.truth, record.errors, record.factor, record.filter_error, record.x
    n = p.shape[0]
    error = out.error[row]
    plain_error(truth.llh[row], truth.velocity[row], truth.quaternion[row], truth.sensors[row], nav, error)
    if chart.products > 0:
        for a in range(len(FIRST)):
            error[chart.products + a] += error[POS + FIRST[a]] * error[POS + SECOND[a]]  # the truth
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


@kernel
def clear_event(record, i):
    """Nothing was measured at event i."""
    if record.innovation.shape[0] > 0:
        for a in range(MAX_MEASUREMENT_SIZE):
            record.innovation[i, a] = math.nan
    if record.innovation_sigma.shape[0] > 0:
        for a in range(MAX_MEASUREMENT_SIZE):
            record.innovation_sigma[i, a] = math.nan
    record.innovation_squared[i] = math.nan
    record.degrees[i] = 0.0
    record.status[i] = NOT_USED


@kernel
def record_innovation(ahead, have, weighed, m, z, s, record, i):
    """Store innovations z (m,) of event i and their 1 sigma, from the factor s of their covariance; nan if missing.

    A history with sigmas stores none of the copy that predicts ahead.
    """
    if record.innovation_sigma.shape[0] == 0:
        if record.innovation.shape[0] > 0:
            for a in range(m):
                record.innovation[i, a] = where(weighed & (have[a] > 0.0), z[a], math.nan)
        return
    if ahead:
        return
    for a in range(m):
        t = s[a, 0] * s[a, 0]
        for b in range(1, a + 1):
            t += s[a, b] * s[a, b]
        there = weighed & (have[a] > 0.0)
        record.innovation[i, a] = where(there, z[a], math.nan)
        record.innovation_sigma[i, a] = where(there, math.sqrt(t), math.nan)


@kernel
def record_use(used, m, record, i):
    """Drop the innovations (m,) of event i from a history without sigmas if they were not used."""
    if record.innovation_sigma.shape[0] == 0 and record.innovation.shape[0] > 0:
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
    navs, ps, record = as_simd(navigation), as_simd(covariance), as_error_registers(errors)
    for row in range(navs.shape[0]):
        _write_errors(chart, navs[row], ps[row], record, row)
