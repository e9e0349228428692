"""Ratios of errors to the filter's sigma, summed over runs."""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel

ROUNDING = 1e-8
"""Size of an error, in SI units, below which it may be rounding alone: 1.4e-9 m of a latitude in radians."""


@kernel
def sum_ratios(error, sigma, limits, squares, known, beyond, steps):
    """Sum what consistency tests need of z = error / sigma over runs.

    The sums are pairwise, those of `runner.exact_sums` for a block of so many runs. There is no ratio where error or
    sigma is not finite, nor where sigma is 0 and the error rounding; it is inf where sigma is 0 and the error is
    larger.

    Parameters
    ----------
    error, sigma : arrays (r, o, n) of runs, outputs and states; r is a power of two.
    limits : array (k,), sigmas.
    squares : array (o, n), out: sums of z^2 over the runs that have a ratio.
    known : array (o, n), out: how many they are.
    beyond : array (k, o, n), out: runs with |z| above each limit.
    steps : array (n,), out: sums over runs and outputs of the squared change of z since the output before, where both
        are finite.
    """
    runs, outputs, n = error.shape
    pairs = np.empty(runs)
    before = np.full((runs, n), math.nan)
    step = np.zeros((runs, n))
    for o in range(outputs):
        for i in range(n):
            for k in range(limits.shape[0]):
                beyond[k, o, i] = 0
            known[o, i] = 0
            for r in range(runs):
                e, s = error[r, o, i], sigma[r, o, i]
                z = (math.nan if abs(e) <= ROUNDING else math.inf) if s == 0.0 else e / s
                pairs[r] = 0.0 if math.isnan(z) else z * z
                known[o, i] += not math.isnan(z)
                for k in range(limits.shape[0]):
                    beyond[k, o, i] += abs(z) > limits[k]
                change = z - before[r, i]
                if math.isfinite(change):
                    step[r, i] += change * change
                before[r, i] = z
            squares[o, i] = _sum_pairwise(pairs, runs)
    for i in range(n):
        for r in range(runs):
            pairs[r] = step[r, i]
        steps[i] = _sum_pairwise(pairs, runs)


@kernel
def _sum_pairwise(values, count):
    """Sum of the first `count` values (a power of two) as a balanced tree; changes them."""
    while count > 1:
        count //= 2
        for k in range(count):
            values[k] = values[2 * k] + values[2 * k + 1]
    return values[0]
