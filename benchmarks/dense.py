"""The same filter with dense 15 x 15 loops: the yardstick any machine can check the block-sparse kernel by."""

from __future__ import annotations

import numpy as np

from navsim.compiler.jit import kernel
from navsim.filter import strapdown
from navsim.filter.interval import add_step, allocate_sums, reset_sums, transition
from navsim.filter.states import N_BASE, SENSORS


@kernel
def _multiply(a, b, out):
    for i in range(N_BASE):
        for j in range(N_BASE):
            t = 0.0
            for k in range(N_BASE):
                t += a[i, k] * b[k, j]
            out[i, j] = t


@kernel
def dense_filter(nav, declared, dtheta, dv, dt, p, q, every):
    """Strapdown, Phi P Phi' + Q densely at every step, a six-measurement Joseph update each `every` steps."""
    previous = np.zeros(6)
    c_nb = np.empty((3, 3))
    mid = np.empty(strapdown.MID_N)
    inverse = np.empty((6, 3))
    sums = allocate_sums(nav, declared)
    flat = np.zeros((SENSORS, N_BASE))
    phi, a, b, gain = (
        np.zeros((N_BASE, N_BASE)),
        np.zeros((N_BASE, N_BASE)),
        np.zeros((N_BASE, N_BASE)),
        np.zeros((N_BASE, N_BASE)),
    )
    for k in range(dtheta.shape[0]):
        g, f = dtheta[k], dv[k]
        tx, ty, tz, ux, uy, uz = strapdown.compensated(nav, False, inverse, g[0], g[1], g[2], f[0], f[1], f[2], dt)
        strapdown.step(nav, tx, ty, tz, ux, uy, uz, previous, dt, c_nb, mid)
        reset_sums(sums)
        sums.length[0], sums.length[1] = dt, 1.0
        add_step(sums.total, sums.decay, sums.row, mid, dt, previous, declared)
        transition(sums, mid, flat)
        for i in range(N_BASE):
            for j in range(N_BASE):
                phi[i, j] = (1.0 if i == j else 0.0) + (flat[i, j] if i < SENSORS else 0.0)
        _multiply(phi, p, a)
        phi_t = phi.T
        _multiply(a, phi_t, b)
        for i in range(N_BASE):
            for j in range(N_BASE):
                p[i, j] = b[i, j] + q[i, j]
        if (k + 1) % every == 0:
            # position and velocity, one after the other, in Joseph form
            for m in range(6):
                s = p[m, m] + 1.0
                for i in range(N_BASE):
                    for j in range(N_BASE):
                        gain[i, j] = 1.0 if i == j else 0.0
                    gain[i, m] -= p[i, m] / s
                _multiply(gain, p, a)
                gain_t = gain.T
                column = p[:, m].copy() / s
                _multiply(a, gain_t, b)
                for i in range(N_BASE):
                    for j in range(N_BASE):
                        p[i, j] = b[i, j] + column[i] * column[j]
    return p
