"""Elementary functions inside kernels, for SIMD lanes and numbers alike: the same bits on every processor.

Sources:

- [1] Cody & Waite, Software Manual for the Elementary Functions (1980) (reduction of arguments).
- [2] Sun Microsystems, fdlibm, k_sin.c and k_cos.c (1993) (minimax polynomials up to pi/4).
- [3] Moshier, Cephes Math Library, atan.c (1995) (rational approximation up to tan(pi/8)).
"""

from __future__ import annotations

import math

from navsim.compiler.jit import kernel
from navsim.compiler.lanes import fma, power_of_two, where

_HALF_PI, _HALF_PI_REST = 1.5707963267948966, 6.123233995736766e-17
"""pi/2 and its rounding error."""
_TAN_EIGHTH = 0.41421356237309503
"""tan(pi/8)."""

# coefficients, of the highest power first
_S6, _S5, _S4 = 1.58969099521155010221e-10, -2.50507602534068634195e-08, 2.75573137070700676789e-06
_S3, _S2, _S1 = -1.98412698298579493134e-04, 8.33333333332248946124e-03, -1.66666666666666324348e-01
_C6, _C5, _C4 = -1.13596475577881948265e-11, 2.08757232129817482790e-09, -2.75573143513906633035e-07
_C3, _C2, _C1 = 2.48015872894767294178e-05, -1.38888888888741095749e-03, 4.16666666666666019037e-02
"""Coefficients of [2]."""
_P4, _P3, _P2 = -8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1
_P1, _P0 = -1.228866684490136173410e2, -6.485021904942025371773e1
_Q4, _Q3, _Q2 = 2.485846490142306297962e1, 1.650270098316988542046e2, 4.328810604912902668951e2
_Q1, _Q0 = 4.853903996359136964868e2, 1.945506571482613964425e2
"""Coefficients of [3]."""
_LN2, _LN2_REST = 0.6931471805599453, 2.3190468138462996e-17
"""ln 2 and its rounding error."""
_SMALLEST = -708.0
"""Smallest argument whose exponential is a normal number."""


@kernel
def _sincos_of_eighth(r):
    """Sine and cosine of |r| <= pi/4 [2]."""
    z = r * r
    s = fma(z, fma(z, fma(z, fma(z, fma(z, _S6, _S5), _S4), _S3), _S2), _S1)
    s = fma(z * r, s, r)
    c = fma(z, fma(z, fma(z, fma(z, fma(z, _C6, _C5), _C4), _C3), _C2), _C1) * z * z
    half = 0.5 * z
    w = 1.0 - half
    return s, w + (((1.0 - w) - half) + c)


@kernel
def sincos(x):
    """Sine and cosine of x, rad, within 1e-16 up to |x| = 1e5."""
    turns = math.floor(x * (1.0 / _HALF_PI) + 0.5)
    r = fma(-turns, _HALF_PI, x)
    s, c = _sincos_of_eighth(fma(-turns, _HALF_PI_REST, r))
    # the quarter of the circle: 0, 1, 2, 3
    quarter = turns - 4.0 * math.floor(0.25 * turns)
    odd = (quarter == 1.0) | (quarter == 3.0)
    sine, cosine = where(odd, c, s), where(odd, s, c)
    return (
        where(quarter >= 2.0, -sine, sine),
        where((quarter == 1.0) | (quarter == 2.0), -cosine, cosine),
    )


@kernel
def sincos_of_latitude(x):
    """Sine and cosine of |x| <= pi/2, rad, within 3e-16: by those of its half, without finding its quarter."""
    s, c = _sincos_of_eighth(0.5 * x)
    return 2.0 * s * c, (c - s) * (c + s)


@kernel
def atan2(y, x):
    """The angle of the point (x, y), rad, in -pi ... pi, within 2e-16 of itself; 0 for (0, 0)."""
    across, along = abs(y), abs(x)
    steep = across > along
    top, bottom = where(steep, along, across), where(steep, across, along)
    ratio = top / where(bottom == 0.0, 1.0, bottom)
    beyond = ratio > _TAN_EIGHTH
    a = where(beyond, (ratio - 1.0) / (ratio + 1.0), ratio)
    z = a * a
    p = fma(z, fma(z, fma(z, fma(z, _P4, _P3), _P2), _P1), _P0)
    q = fma(z, fma(z, fma(z, fma(z, z + _Q4, _Q3), _Q2), _Q1), _Q0)
    t = fma(a, z * p / q, a)
    t = where(beyond, 0.5 * _HALF_PI + (t + 0.5 * _HALF_PI_REST), t)
    t = where(steep, _HALF_PI - (t - _HALF_PI_REST), t)
    t = where(x < 0.0, 2.0 * _HALF_PI - (t - 2.0 * _HALF_PI_REST), t)
    return where(y < 0.0, -t, t)


@kernel
def exp_of_negative(x):
    """The exponential of x <= 0 within 2e-16 of itself; 0 below -708."""
    bounded = where(x > _SMALLEST, x, _SMALLEST)
    halvings = math.floor(bounded * (1.0 / _LN2) + 0.5)
    r = fma(-halvings, _LN2_REST, fma(-halvings, _LN2, bounded))
    # the series up to r^13 / 13!, of the highest power first; |r| <= ln 2 / 2
    t = 1.0 + r * 0.0
    for n in range(13, 0, -1):
        t = fma(r * (1.0 / n), t, 1.0)
    return where(x > _SMALLEST, t * power_of_two(halvings), where(math.isnan(x), x, 0.0))
