"""Ratios of errors to the filter's sigma, summed over runs."""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel

CORRELATED = 0.99
"""Correlation beyond which the geometry cannot tell two states apart."""
ROUNDING = 1e-8
"""Size of an error, in SI units, below which it may be rounding alone: 1.4e-9 m of a latitude in radians."""


@kernel
def sum_ratios(error, sigma, limits, squares, known, beyond, steps):
    """Sum over runs the statistics of z = error / sigma that consistency tests need.

    The sums are pairwise, as `runner.exact_sums` sums a block of r runs. The ratio is missing if error or sigma is not
    finite, or if sigma is 0 and the error is rounding. It is inf if sigma is 0 and the error is larger.

    - `error`, `sigma` (r, o, n): of runs, outputs and states; r is a power of two.
    - `limits` (k,): in sigmas.
    - `squares` (o, n), out: sums of z^2 over the runs that have a ratio.
    - `known` (o, n), out: number of these runs.
    - `beyond` (k, o, n), out: runs with |z| above each limit.
    - `steps` (n,), out: sums over runs and outputs of the squared change of z since the output before, if both are
      finite.
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


def correlated_states(covariance: np.ndarray, among: np.ndarray) -> list[tuple[int, int, float]]:
    """Pairs of states that are correlated beyond `CORRELATED`, the strongest first."""
    sigma = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    found = []
    for k, a in enumerate(among):
        for b in among[k + 1 :]:
            if sigma[a] > 0.0 and sigma[b] > 0.0:
                correlation = float(covariance[a, b] / (sigma[a] * sigma[b]))
                if abs(correlation) > CORRELATED:
                    found.append((int(a), int(b), correlation))
    return sorted(found, key=lambda pair: -abs(pair[2]))


def effective_count(values: np.ndarray) -> float:
    """Number of independent values with the same variance of the mean rank as values (n, k) at n times.

    Columns at one time may be correlated, and times with those before them: the initial positive sequence estimator of
    the autocorrelation of the ranks (Geyer, Practical Markov chain Monte Carlo, Statistical Science 7 (1992): 473-483,
    section 3.3).
    """
    from scipy.stats import rankdata

    n = len(values)
    if n < 2:
        return float(values.size)
    ranks = rankdata(values).reshape(values.shape)
    mean = ranks.mean(axis=1) - ranks.mean()
    product = np.correlate(mean, mean, "full")[n - 1 :] / n
    pairs = product[: n - n % 2].reshape(-1, 2).sum(axis=1)
    positive = pairs[: int(np.argmax(pairs <= 0.0))] if (pairs <= 0.0).any() else pairs
    variance = (2.0 * positive.sum() - product[0]) / n
    return float(np.clip(ranks.var() / variance, 1.0, values.size)) if variance > 0.0 else float(values.size)
