"""Tracking filters of air traffic control: Singer's on range, the full one with onboard data, its decoupled groups.

State of 13: range D, D', D''; speed V, V'; path angle th; track phi; elevation ev; azimuth eg, each with its rate. The
range acceleration follows from the rest,
    D'' = V' A + V (w_th B + w_v C - (w_phi - w_g) E),    A = cth cev cd + sth sev,  B = cth sev - sth cev cd,
    C = sth cev - cth sev cd,  E = cth cev sd,  d = phi - eg,
and enters the range as a first-order hold between scans. Decoupled: six filters, the range driven by the others'
estimates, the variance of that input ignored (`fix`) or counted (`adapt`). Full: one filter of 13 states. Cartesian:
position, velocity and Singer acceleration in N, h, E with all six measurements, what modern practice does.
Source: `docs/theory/atc.md`, sections 1, 2.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.companions.azimuth.filter import wrap
from navsim.companions.kalman import predict, update, update_row
from navsim.compiler.jit import kernel

D, V, TH, PH, EV, EG = 0, 3, 5, 7, 9, 11
"""Places of the levels in the state; rates follow them."""
N = 13
NAMES = (
    "range", "range_rate", "range_acceleration", "speed", "speed_rate", "path_angle", "path_angle_rate", "track",
    "track_rate", "elevation", "elevation_rate", "azimuth", "azimuth_rate",
)  # fmt: skip
MEASURED = 9
"""D, V, th, phi, ev, eg, then V', w_th, w_phi if they are measured on board."""
REPORTED = 3
"""The first pairs, V, th, phi, are reported by the aircraft; elevation and azimuth are the radar's."""
FULL, ADAPT, FIX = range(3)


@kernel
def range_acceleration(x, slope):
    """D'' of a state (13,); slope (13,) out: its derivatives with respect to the state."""
    v, v1, wth, wphi, wv, wg = x[V], x[V + 1], x[TH + 1], x[PH + 1], x[EV + 1], x[EG + 1]
    sth, cth = math.sin(x[TH]), math.cos(x[TH])
    sev, cev = math.sin(x[EV]), math.cos(x[EV])
    sd, cd = math.sin(x[PH] - x[EG]), math.cos(x[PH] - x[EG])
    a = cth * cev * cd + sth * sev
    b = cth * sev - sth * cev * cd
    c = sth * cev - cth * sev * cd
    e = cth * cev * sd
    f = cth * cev + sth * sev * cd
    w = wphi - wg
    slope[0] = slope[1] = slope[2] = 0.0
    slope[V] = wth * b + wv * c - w * e
    slope[V + 1] = a
    slope[TH] = v1 * b + v * (-wth * a + wv * f + w * sth * cev * sd)
    slope[TH + 1] = v * b
    turn = -v1 * e + v * (wth * sth * cev * sd + wv * cth * sev * sd - w * cth * cev * cd)
    slope[PH] = turn
    slope[PH + 1] = -v * e
    slope[EV] = v1 * c + v * (wth * f - wv * a + w * cth * sev * sd)
    slope[EV + 1] = v * c
    slope[EG] = -turn
    slope[EG + 1] = v * e
    return v1 * a + v * slope[V]


@kernel
def range_rate(x):
    """D' of a state (13,): V (cth cev cd + sth sev)."""
    d = x[PH] - x[EG]
    return x[V] * (math.cos(x[TH]) * math.cos(x[EV]) * math.cos(d) + math.sin(x[TH]) * math.sin(x[EV]))


@kernel
def start(measured, x):
    """The state (13,) from the first measurements: levels as measured, rates zero, D' by its formula."""
    for i in range(N):
        x[i] = 0.0
    x[D], x[V], x[TH], x[PH], x[EV], x[EG] = (
        measured[0], measured[1], measured[2], measured[3], measured[4], measured[5],
    )  # fmt: skip
    x[D + 1] = range_rate(x)


@kernel
def _innovation(measured, estimate, index):
    """Measured minus estimated, wrapped for track and azimuth."""
    nu = measured - estimate
    return wrap(nu) if index in (PH, EG) else nu


@kernel
def track(
    kind, period, measured, variance, rates, age, decay, rate_variance, residual, start_sigma, truth, error, deviation
):
    """One run of the full filter or of the decoupled groups over n scans.

    - `measured` (n, 9), `variance` (9,); `rates`: bool, whether the last three are measured; `truth` (n, 13).
    - `age`: age of reports in the filter model, s. In the full filter a reported speed, path angle or track is the
      state
      minus age times its rate. The decoupled groups are estimated at the time of the reports and predicted over their
      age.
    - `decay` (5,): 1 - alpha T of the groups V, th, phi, ev, eg; `rate_variance` (5,): variance added to a rate in a
      period.
    - `residual`: 1 sigma of D'' beyond the formula, m/s2; `start_sigma` (2,): of D' and D''.
    - `error`, `deviation` (n, 13), out.
    """
    t = period
    x, slope, gain = np.empty(N), np.empty(N), np.empty(N)
    p, phi, q, work = np.zeros((N, N)), np.zeros((N, N)), np.zeros((N, N)), np.empty((N, N))
    # a group of the decoupled filter: a level and its rate
    pair, pair_p, pair_phi, pair_q, pair_work = (
        np.empty(2), np.empty((2, 2)), np.zeros((2, 2)), np.zeros((2, 2)), np.empty((2, 2)),
    )  # fmt: skip
    pair_gain = np.empty(2)
    predicted = np.empty(N)
    # D, D', D'', driven by the acceleration from the groups, held over the period
    ranging, ranging_p, ranging_phi, ranging_q, ranging_work, ranging_gain = (
        np.empty(3), np.empty((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3)), np.empty(3),
    )  # fmt: skip
    row, space = np.zeros(N), np.empty(N)
    # reported pairs of the decoupled filter at the time of the last reports
    late, late_p = np.zeros((REPORTED, 2)), np.zeros((REPORTED, 2, 2))
    hold = np.array([t * t / 6.0, 0.5 * t, 1.0])
    ranging_phi[0, 0] = ranging_phi[1, 1] = 1.0
    ranging_phi[0, 1], ranging_phi[0, 2], ranging_phi[1, 2] = t, t * t / 3.0, 0.5 * t
    start(measured[0], x)
    p[0, 0], p[1, 1], p[2, 2] = variance[0], start_sigma[0] ** 2, start_sigma[1] ** 2
    for g in range(5):
        level = V + 2 * g
        p[level, level] = variance[1 + g]
        p[level + 1, level + 1] = rate_variance[g] / (1.0 - decay[g] * decay[g])
        if g < REPORTED:
            late[g, 0] = x[level]
            late_p[g, 0, 0], late_p[g, 1, 1] = p[level, level], p[level + 1, level + 1]
    for k in range(measured.shape[0]):
        if k > 0 and kind == FULL:
            phi[:] = 0.0
            q[:] = 0.0
            for g in range(5):
                level = V + 2 * g
                phi[level, level], phi[level, level + 1], phi[level + 1, level + 1] = 1.0, t, decay[g]
            for i in range(3):
                for j in range(3):
                    ranging[i] = x[i]
                    phi[i, j] = ranging_phi[i, j]
            # the groups first: the acceleration is that of their predicted state
            for i in range(N):
                predicted[i] = x[i]
            for g in range(5):
                level = V + 2 * g
                predicted[level] = x[level] + t * x[level + 1]
                predicted[level + 1] = decay[g] * x[level + 1]
            acceleration = range_acceleration(predicted, slope)
            acceleration_variance = residual * residual
            for g in range(5):
                level = V + 2 * g
                acceleration_variance += rate_variance[g] * slope[level + 1] ** 2
                q[level + 1, level + 1] = rate_variance[g]
                for i in range(3):
                    phi[i, level] = hold[i] * slope[level]
                    phi[i, level + 1] = hold[i] * (t * slope[level] + decay[g] * slope[level + 1])
                    q[i, level + 1] = q[level + 1, i] = hold[i] * slope[level + 1] * rate_variance[g]
            for i in range(3):
                for j in range(3):
                    q[i, j] = acceleration_variance * hold[i] * hold[j]
            predict(x, p, phi, q, work)
            # the range follows the acceleration itself, whose slope is in phi
            for i in range(3):
                moved = hold[i] * acceleration
                for j in range(3):
                    moved += ranging_phi[i, j] * ranging[j]
                x[i] = moved
        if k > 0:
            if kind == FULL:
                update(x, p, D, measured[k, 0] - x[D], variance[0], gain)
                for g in range(5):
                    level = V + 2 * g
                    if g < REPORTED and age > 0.0:
                        row[:] = 0.0
                        row[level], row[level + 1] = 1.0, -age
                        nu = _innovation(measured[k, 1 + g], x[level] - age * x[level + 1], level)
                        update_row(x, p, row, nu, variance[1 + g], gain, space)
                    else:
                        update(x, p, level, _innovation(measured[k, 1 + g], x[level], level), variance[1 + g], gain)
                if rates:
                    for g in range(3):
                        level = V + 2 * g + 1
                        update(x, p, level, measured[k, 6 + g] - x[level], variance[6 + g], gain)
            else:
                # the groups by themselves, then D'' from their estimates, then the range with it
                for g in range(5):
                    level = V + 2 * g
                    aged = g < REPORTED and age > 0.0
                    for i in range(2):
                        pair[i] = late[g, i] if aged else x[level + i]
                        for j in range(2):
                            pair_p[i, j] = late_p[g, i, j] if aged else p[level + i, level + j]
                    pair_phi[0, 0], pair_phi[0, 1], pair_phi[1, 1] = 1.0, t, decay[g]
                    pair_q[1, 1] = rate_variance[g]
                    predict(pair, pair_p, pair_phi, pair_q, pair_work)
                    nu = _innovation(measured[k, 1 + g], pair[0], level)
                    update(pair, pair_p, 0, nu, variance[1 + g], pair_gain)
                    if rates and g < 3:
                        update(pair, pair_p, 1, measured[k, 6 + g] - pair[1], variance[6 + g], pair_gain)
                    if aged:
                        # the pair is estimated for the time of the reports, then predicted over their age
                        late[g] = pair
                        late_p[g] = pair_p
                        kept = max(0.0, 1.0 - (1.0 - decay[g]) * age / t)
                        pair_phi[0, 1], pair_phi[1, 1] = age, kept
                        pair_q[1, 1] = rate_variance[g] / (1.0 - decay[g] * decay[g]) * (1.0 - kept * kept)
                        predict(pair, pair_p, pair_phi, pair_q, pair_work)
                    for i in range(2):
                        x[level + i] = pair[i]
                        for j in range(2):
                            p[level + i, level + j] = pair_p[i, j]
                acceleration = range_acceleration(x, slope)
                acceleration_variance = residual * residual
                if kind == ADAPT:
                    for g in range(5):
                        level = V + 2 * g
                        for i in range(2):
                            for j in range(2):
                                acceleration_variance += slope[level + i] * p[level + i, level + j] * slope[level + j]
                for i in range(3):
                    ranging[i] = x[i]
                    for j in range(3):
                        ranging_p[i, j] = p[i, j]
                        ranging_q[i, j] = acceleration_variance * hold[i] * hold[j]
                predict(ranging, ranging_p, ranging_phi, ranging_q, ranging_work)
                for i in range(3):
                    ranging[i] += hold[i] * acceleration
                update(ranging, ranging_p, 0, measured[k, 0] - ranging[0], variance[0], ranging_gain)
                for i in range(3):
                    x[i] = ranging[i]
                    for j in range(3):
                        p[i, j] = ranging_p[i, j]
        for i in range(N):
            gap = truth[k, i] - x[i]
            error[k, i] = wrap(gap) if i in (PH, EG) else gap
            deviation[k, i] = math.sqrt(p[i, i])


@kernel
def singer_range(measured, variance, phi, q, first, start_variance, truth, error, deviation):
    """Singer's filter on range alone: measured (n,), first (3,) estimate and start_variance (3,), phi, q (3, 3);
    truth, error, deviation (n, 3)."""
    x, p, gain, work = first.copy(), np.zeros((3, 3)), np.empty(3), np.empty((3, 3))
    for i in range(3):
        p[i, i] = start_variance[i]
    for k in range(measured.shape[0]):
        if k > 0:
            predict(x, p, phi, q, work)
            update(x, p, 0, measured[k] - x[0], variance, gain)
        for i in range(3):
            error[k, i] = truth[k, i] - x[i]
            deviation[k, i] = math.sqrt(p[i, i])


@kernel
def _expected(x, value, h):
    """Prediction of D, V, th, phi, ev, eg from a Cartesian state (9,): value (6,), and the rows h (6, 9)."""
    n, up, e = x[0], x[1], x[2]
    vn, vu, ve = x[3], x[4], x[5]
    h[:] = 0.0
    flat2 = n * n + e * e
    flat = math.sqrt(flat2)
    slant2 = flat2 + up * up
    slant = math.sqrt(slant2)
    level2 = vn * vn + ve * ve
    level = math.sqrt(level2)
    speed2 = level2 + vu * vu
    speed = math.sqrt(speed2)
    value[0] = slant
    h[0, 0], h[0, 1], h[0, 2] = n / slant, up / slant, e / slant
    value[1] = speed
    h[1, 3], h[1, 4], h[1, 5] = vn / speed, vu / speed, ve / speed
    value[2] = math.atan2(vu, level)
    h[2, 3], h[2, 4], h[2, 5] = -vu * vn / (level * speed2), level / speed2, -vu * ve / (level * speed2)
    value[3] = math.atan2(ve, vn)
    h[3, 3], h[3, 5] = -ve / level2, vn / level2
    value[4] = math.atan2(up, flat)
    h[4, 0], h[4, 1], h[4, 2] = -up * n / (flat * slant2), flat / slant2, -up * e / (flat * slant2)
    value[5] = math.atan2(e, n)
    h[5, 0], h[5, 2] = -e / flat2, n / flat2


@kernel
def cartesian(measured, variance, age, phi, q, start_variance, truth, error, deviation):
    """Cartesian filter over n scans.

    - `measured` (n, 9), of which six are used; `variance` (9,); `truth` (n, 13).
    - `age`: age of reported velocities in the filter model, s.
    - `phi`, `q` (3, 3): of one axis; `start_variance` (3,): of position, velocity, acceleration of each axis.
    - `error`, `deviation` (n, 4), out: of range, range rate, elevation, azimuth.
    """
    x, p, big_phi, big_q = np.zeros(9), np.zeros((9, 9)), np.zeros((9, 9)), np.zeros((9, 9))
    work, gain, space = np.empty((9, 9)), np.empty(9), np.empty(9)
    value, h, row, then = np.empty(6), np.empty((6, 9)), np.empty(9), np.empty(9)
    z = measured[0]
    flat = z[0] * math.cos(z[4])
    x[0], x[1], x[2] = flat * math.cos(z[5]), z[0] * math.sin(z[4]), flat * math.sin(z[5])
    level = z[1] * math.cos(z[2])
    x[3], x[4], x[5] = level * math.cos(z[3]), z[1] * math.sin(z[2]), level * math.sin(z[3])
    for axis in range(3):
        for i in range(3):
            p[3 * i + axis, 3 * i + axis] = start_variance[i]
            for j in range(3):
                big_phi[3 * i + axis, 3 * j + axis] = phi[i, j]
                big_q[3 * i + axis, 3 * j + axis] = q[i, j]
    for k in range(measured.shape[0]):
        if k > 0:
            predict(x, p, big_phi, big_q, work)
            for m in range(6):
                _expected(x, value, h)
                if age > 0.0 and 1 <= m <= REPORTED:
                    # the velocity was another by the acceleration since
                    for i in range(9):
                        then[i] = x[i] - age * x[i + 3] if 3 <= i < 6 else x[i]
                    _expected(then, value, h)
                    for i in range(3):
                        h[m, 6 + i] = -age * h[m, 3 + i]
                nu = measured[k, m] - value[m]
                if m in (3, 5):
                    nu = wrap(nu)
                for i in range(9):
                    row[i] = h[m, i]
                update_row(x, p, row, nu, variance[m], gain, space)
        _expected(x, value, h)
        rate = 0.0
        for i in range(3):
            rate += h[0, i] * x[3 + i]
        error[k, 0] = truth[k, 0] - value[0]
        error[k, 1] = truth[k, 1] - rate
        error[k, 2] = truth[k, EV] - value[4]
        error[k, 3] = wrap(truth[k, EG] - value[5])
        for out in range(4):
            for i in range(9):
                row[i] = 0.0
            for i in range(3):
                if out == 0:
                    row[i] = h[0, i]
                elif out == 1:
                    row[i] = (x[3 + i] - rate * h[0, i]) / value[0]
                    row[3 + i] = h[0, i]
                else:
                    row[i] = h[4, i] if out == 2 else h[5, i]
            t = 0.0
            for i in range(9):
                for j in range(9):
                    t += row[i] * p[i, j] * row[j]
            deviation[k, out] = math.sqrt(t)
