"""Azimuth filters of a scanning radar: Singer's, and those driven by reported load factors.

    SINGER    [azimuth, rate, acceleration], exact discretisation, its sigma scaled by 1/Dh
    LITERAL   [azimuth, rate], acceleration g nXg / Dh as the paper's (14) has it, held over the scan (L1)
    TANGENT   the tangential component a_t / Dh instead of the northern one (L2)
    HELD      rigorous, with the Coriolis term, held over the scan (L3)
    FIRST     the same with first-order hold between two reports (L4)
Source: `docs/theory/azimuth.md`, section 2. Angles in rad, errors truth - estimate after the update.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.companions.kalman import predict, update
from navsim.compiler.jit import kernel

SINGER, LITERAL, TANGENT, HELD, FIRST = range(5)


@kernel
def wrap(angle):
    """The angle in -pi ... pi."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@kernel
def azimuth_filter(
    kind, period, measured, ground_range, variance, phi, q, sigma, node0, node1, truth, error, deviation, nis
):
    """One run of one filter over n scans.

    - `measured` (n,): azimuths, rad, of `variance` rad2; `ground_range` (n,): Dh from the measured slant range, m.
    - `phi`, `q` (3, 3): Singer's for a unit sigma; `sigma` (n,): 1 sigma of its acceleration or of the residual one,
      m/s2.
    - `node0`, `node1` (n, 4): filter model of the motion at the scan before and at this one. Acceleration along the
      track
      and right of it, m/s2; horizontal speed, m/s; track, rad.
    - `truth` (n,); `error`, `deviation`, `nis` (n,), out: nis is nan at scan 0.
    """
    size = 3 if kind == SINGER else 2
    x, p = np.zeros(size), np.zeros((size, size))
    move, noise, work, gain = np.zeros((size, size)), np.zeros((size, size)), np.empty((size, size)), np.empty(size)
    x[0] = measured[0]
    p[0, 0] = variance
    p[1, 1] = (node1[0, 2] / ground_range[0]) ** 2
    if kind == SINGER:
        p[2, 2] = (sigma[0] / ground_range[0]) ** 2
    error[0] = wrap(truth[0] - x[0])
    deviation[0] = math.sqrt(p[0, 0])
    nis[0] = np.nan
    t = period
    for k in range(1, measured.shape[0]):
        scale = (sigma[k] / ground_range[k]) ** 2
        if kind == SINGER:
            for i in range(3):
                for j in range(3):
                    noise[i, j] = scale * q[i, j]
            predict(x, p, phi, noise, work)
        else:
            d0 = ground_range[k - 1]
            e, w = x[0], x[1]
            a0, r0, v0, track0 = node0[k, 0], node0[k, 1], node0[k, 2], node0[k, 3]
            tangential = a0 * math.sin(track0 - e) + r0 * math.cos(track0 - e)
            rate0 = v0 * math.cos(track0 - e)
            c = 1.0
            if kind == FIRST:
                ahead = e + w * t
                a1, r1, v1, track1 = node1[k, 0], node1[k, 1], node1[k, 2], node1[k, 3]
                later = a1 * math.sin(track1 - ahead) + r1 * math.cos(track1 - ahead)
                d1 = d0 + 0.5 * (rate0 + v1 * math.cos(track1 - ahead)) * t
                c = d0 / d1
                shift = t * t * (tangential / 3.0 + later / 6.0) / d1
                kick = t * (tangential * d0 + later * d1) / (2.0 * d1 * d1)
            elif kind == HELD:
                d1 = d0 + rate0 * t
                c = d0 / d1
                u = tangential / d1
                shift, kick = 0.5 * u * t * t, u * t * (d0 + d1) / (2.0 * d1)
            else:
                if kind == LITERAL:
                    tangential = a0 * math.cos(track0) - r0 * math.sin(track0)
                u = tangential / d0
                shift, kick = 0.5 * u * t * t, u * t
            move[0, 0], move[0, 1], move[1, 1] = 1.0, t * c, c * c
            noise[0, 0] = scale * t**4 / 4.0
            noise[0, 1] = noise[1, 0] = scale * t**3 / 2.0
            noise[1, 1] = scale * t * t
            predict(x, p, move, noise, work)
            x[0] += shift
            x[1] += kick
        nis[k] = update(x, p, 0, wrap(measured[k] - x[0]), variance, gain)
        error[k] = wrap(truth[k] - x[0])
        deviation[k] = math.sqrt(p[0, 0])


@kernel
def range_filter(period, measured, variance, residual, push0, push1, rate, truth, error, deviation):
    """One run of [Dh, Dh'] with the radial acceleration push0, push1 (n,) m/s2 at the scan before and at this one.

    First-order hold. measured, truth (n,) m; residual (n,): 1 sigma of the residual acceleration, m/s2; rate: initial
    estimate of Dh', m/s, with a sigma of 5 m/s. Out: error, deviation (n,).
    """
    x, p, q = np.empty(2), np.zeros((2, 2)), np.empty((2, 2))
    phi, work, gain = np.zeros((2, 2)), np.empty((2, 2)), np.empty(2)
    t = period
    phi[0, 0] = phi[1, 1] = 1.0
    phi[0, 1] = t
    x[0], x[1] = measured[0], rate
    p[0, 0], p[1, 1] = variance, 25.0
    for k in range(measured.shape[0]):
        if k > 0:
            s = residual[k] * residual[k]
            q[0, 0], q[1, 1] = s * t**4 / 4.0, s * t * t
            q[0, 1] = q[1, 0] = s * t**3 / 2.0
            predict(x, p, phi, q, work)
            x[0] += t * t * (push0[k] / 3.0 + push1[k] / 6.0)
            x[1] += 0.5 * t * (push0[k] + push1[k])
            update(x, p, 0, measured[k] - x[0], variance, gain)
        error[k] = truth[k] - x[0]
        deviation[k] = math.sqrt(p[0, 0])
