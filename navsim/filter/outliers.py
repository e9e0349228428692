"""Ranges with outliers in the filter: a mixture of a clean range, one wrong to both sides, and one that is too long.

    z = H d + noise + D,  D = 0, or normal with sigma s, or exponential with mean m

Given D, the update is the usual one of z - D. So D is replaced by its mean given z, and its variance given z, times K
K', is added to the covariance after the update: the law of total variance. Mean and variance are exact for a Gaussian
prior.

Source: `docs/theory/beacons.md`, section 3; Masreliez, Approximate non-Gaussian filtering with linear state and
observation relations, IEEE TAC 20(1) (1975).
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import exp_of_negative
from navsim.compiler.jit import kernel, kernel_inline
from navsim.compiler.lanes import fma, where
from navsim.filter.measurement_kinds import BEACON
from navsim.filter.states import POS

_FAR = 3.0
"""Argument from which Mills' ratio follows from its continued fraction."""
_TERMS = 40
"""Terms of it: 1e-11 of the ratio."""
_ROOT_TWO_PI = math.sqrt(2.0 * math.pi)


@kernel
def truncated_normal(b):
    """Mean and variance of a normal variable of mean b and variance 1, given that it is positive; and the probability
    of that, for b <= 0 by the density at b.

    Mean and probability are within 1e-6 of themselves, the variance within 1e-5.
    """
    x = abs(b)
    # far out 1 / R(x) = x + 1 / (x + 2 / (x + 3 / ...)): its fractions are the moments, without cancellation
    safe = where(x > _FAR, x, _FAR)
    more = 0.0 * x
    for k in range(_TERMS, 1, -1):
        more = k / (safe + more)
    mean = 1.0 / (safe + more)
    variance, ratio = mean * (more - mean), 1.0 / (safe + mean)
    # near, erfc(y) = t exp(-y^2 + series in t): Press et al., Numerical Recipes, 3rd ed., section 6.2.2
    t = 2.0 / (2.0 + where(x > _FAR, _FAR, x) * math.sqrt(0.5))
    series = fma(t, fma(t, fma(t, 0.17087277, -0.82215223), 1.48851587), -1.13520398)
    series = fma(t, fma(t, fma(t, fma(t, fma(t, series, 0.27886807), -0.18628806), 0.09678418), 0.37409196), 1.00002368)
    near = 0.5 * _ROOT_TWO_PI * t * exp_of_negative(fma(t, series, -1.26551223))
    density = exp_of_negative(-0.5 * x * x) / _ROOT_TWO_PI
    ratio = where(x > _FAR, ratio, near)
    positive = 1.0 - density * ratio
    slope = where(b > 0.0, density / positive, 1.0 / near)
    close = (b > 0.0) | (x <= _FAR)
    mean, variance = where(close, b + slope, mean), where(close, 1.0 - slope * (b + slope), variance)
    return mean, variance, where(b > 0.0, positive, ratio)


@kernel
def outlier_moments(z, root, outliers):
    """Mean and variance, m, m2, of the outlier D given an innovation z of a clean 1 sigma `root`, m.

    Also q and `size`: the likelihood of z is exp(-q / 2) / size but for a constant; and the chance that it is clean.

    outliers (5,): share of ranges wrong to both sides, their variance, m2, share of long ranges, their mean, m; and the
    number in a row that is no chance any more.
    """
    share, variance, long_share, long = outliers[0], outliers[1], outliers[2], outliers[3]
    square = root * root
    wide = square + variance
    clean, both = z * z / square, z * z / wide
    b = z / root - root / long
    mean, spread, chance = truncated_normal(b)
    tail = where(b > 0.0, (2.0 * z - square / long) / long, clean)
    q = clean
    if share > 0.0:
        q = where(both < q, both, q)
    if long_share > 0.0:
        q = where(tail < q, tail, q)
    usual = (1.0 - share - long_share) / root * exp_of_negative(0.5 * (q - clean))
    far = share * exp_of_negative(-0.5 * where(both > q, both - q, 0.0)) / math.sqrt(wide)
    late = long_share / long * chance * exp_of_negative(-0.5 * where(tail > q, tail - q, 0.0))
    late *= where(b > 0.0, _ROOT_TWO_PI, 1.0)
    total = usual + far + late
    far /= total
    late /= total
    first, second = far * z * variance / wide, late * root * mean
    moment = far * (square * variance / wide + (z * variance / wide) * (z * variance / wide))
    moment += late * square * (spread + mean * mean)
    expected = first + second
    return expected, moment - expected * expected, q, 1.0 / total, usual / total


@kernel_inline
def is_lost(rejected, outliers, most):
    """Whether a filter is wrong rather than so many ranges of a beacon in a row, which it took for outliers.

    rejected: their number. most: as of the gate (`FilterModel.max_rejected`). outliers: as of `outlier_moments`.
    """
    return rejected >= max(1.0 * most, outliers[4])


@kernel
def widen(p, lost, z, root):
    """Where a filter is `lost`, add to P (n, n) independent errors of position, each as large as the innovation z if
    that exceeds its clean 1 sigma `root`. Their sum is as large along every line, so also along that of the range."""
    for i in range(POS, POS + 3):
        p[i, i] += where(lost & (z * z > root * root), z * z, 0.0)


@kernel_inline
def expects_outliers(kind, measurements):
    """Whether the filter has a mixture for measurements of this kind."""
    return kind == BEACON and measurements.beacons.outliers.shape[0] > 0


@kernel
def add_spread(p, k, spread):
    """P (n, n) += K K' times the variance of an outlier; k (n, MOST)."""
    for i in range(p.shape[0]):
        for j in range(i + 1):
            t = fma(spread * k[i, 0], k[j, 0], p[i, j])
            p[i, j], p[j, i] = t, t
