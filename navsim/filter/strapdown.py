"""Strapdown mechanisation in the local-level (NED) frame on WGS-84, from angle and velocity increments.

Two-sample: the increments of the previous interval correct the present ones for coning and sculling. Earth
rate and transport rate are taken at the middle of the interval.

Sources: [1] Savage, Strapdown inertial navigation integration algorithm design, parts 1 and 2, JGCD 21
(1998), 1: eqs. 43-46 (coning), 2: eqs. 29-56 (sculling, rotation compensation, position).
[2] Groves (2013), section 5.4 (local-navigation-frame equations).
"""

from __future__ import annotations

import math

from navsim.compiler.elementary import sincos_of_latitude
from navsim.compiler.jit import kernel, kernel_inline
from navsim.compiler.lanes import any_lane, as_simd, small_matrix, small_vector, where
from navsim.compiler.linear import copy, identity, invert3
from navsim.filter.states import (
    ACCELEROMETERS,
    N_BASE,
    NAV_ACCEL,
    NAV_BIAS_FRAME,
    NAV_GYRO,
    NAV_LLH,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    SENSORS,
)
from navsim.geodesy.attitude_kernels import dcm, normalise, rotate_in_body_axes, rotate_in_nav_axes
from navsim.geodesy.earth_kernels import RATE, gravity, radii, wrap_angle

# Quantities of a step for the error model, one flat array (`mid`): everything at mid-interval.
MID_DCM, MID_FELT, MID_SIN = 0, 9, 12
"""Offsets: C_nb by rows (9), specific force NED over the interval m/s (3), sin(latitude),"""
MID_COS, MID_HEIGHT, MID_VEL, MID_MERIDIAN, MID_TRANSVERSE = 13, 14, 15, 18, 19
"""cos(latitude), height m, velocity NED m/s (3), radii of curvature plus height m."""
MID_GRAVITY = 20
MID_N = 21


@kernel
def unmixing(nav, declared, out):
    """Correction of increments by the estimated scale factors: out (6, 3), (I + M)^-1 of each triad.

    The measurement model is measured = (I + M) true + bias.
    """
    m = small_matrix(nav, 3, 3)
    for triad in range(2):
        identity(m)
        for c in range(N_BASE - SENSORS, declared.shape[0]):
            if declared[c].sensor == triad:
                m[declared[c].axis, declared[c].signal] += nav[NAV_SENSORS + c]
        invert3(m, out[3 * triad : 3 * triad + 3])


@kernel
def is_mixed(declared):
    """Whether the inertial sensors have declared states other than biases, so that `unmixing` is needed."""
    mixed = False
    for c in range(N_BASE - SENSORS, declared.shape[0]):
        mixed |= declared[c].sensor <= ACCELEROMETERS
    return mixed


@kernel_inline
def compensated(nav, mixed, inverse, gx, gy, gz, fx, fy, fz, dt):
    """The increments without the sensor errors that the navigation state estimates, six numbers.

    nav: `navsim.filter.states`. mixed: `is_mixed`. inverse: from `unmixing`. gx ... fz: measured increments of angle
    (rad) and velocity (m/s) over dt (s); scalars, since a slice costs more.
    """
    tx = gx - nav[NAV_GYRO] * dt
    ty = gy - nav[NAV_GYRO + 1] * dt
    tz = gz - nav[NAV_GYRO + 2] * dt
    ux = fx - nav[NAV_ACCEL] * dt
    uy = fy - nav[NAV_ACCEL + 1] * dt
    uz = fz - nav[NAV_ACCEL + 2] * dt
    if mixed:
        tx, ty, tz = (
            inverse[0, 0] * tx + inverse[0, 1] * ty + inverse[0, 2] * tz,
            inverse[1, 0] * tx + inverse[1, 1] * ty + inverse[1, 2] * tz,
            inverse[2, 0] * tx + inverse[2, 1] * ty + inverse[2, 2] * tz,
        )
        ux, uy, uz = (
            inverse[3, 0] * ux + inverse[3, 1] * uy + inverse[3, 2] * uz,
            inverse[4, 0] * ux + inverse[4, 1] * uy + inverse[4, 2] * uz,
            inverse[5, 0] * ux + inverse[5, 1] * uy + inverse[5, 2] * uz,
        )
    return tx, ty, tz, ux, uy, uz


@kernel_inline
def step(nav, tx, ty, tz, ux, uy, uz, previous, dt, c_nb, mid):
    """Advance the navigation state by one interval, in place.

    - `nav`: navigation state, see `navsim.filter.states`.
    - `tx` ... `uz`: `compensated` increments of angle (rad) and velocity (m/s) over `dt` (s).
    - `previous` (6,): increments of the interval before, scaled to dt; overwritten by the present ones.
    - `c_nb` (3, 3): work space; `mid` (MID_N,), out: mid-interval quantities for the error model.
    """
    px, py, pz = previous[0], previous[1], previous[2]
    sx, sy, sz = previous[3], previous[4], previous[5]
    previous[0], previous[1], previous[2] = tx, ty, tz
    previous[3], previous[4], previous[5] = ux, uy, uz

    # coning: dtheta + 1/12 previous x dtheta
    k = 1.0 / 12.0
    ax = tx + k * (py * tz - pz * ty)
    ay = ty + k * (pz * tx - px * tz)
    az = tz + k * (px * ty - py * tx)

    # velocity rotation (exact for a constant rate to third order) and sculling
    cx = ty * uz - tz * uy
    cy = tz * ux - tx * uz
    cz = tx * uy - ty * ux
    bx = ux + 0.5 * cx + 2.0 * k * (ty * cz - tz * cy)
    by = uy + 0.5 * cy + 2.0 * k * (tz * cx - tx * cz)
    bz = uz + 0.5 * cz + 2.0 * k * (tx * cy - ty * cx)
    bx += k * (py * uz - pz * uy + sy * tz - sz * ty)
    by += k * (pz * ux - px * uz + sz * tx - sx * tz)
    bz += k * (px * uy - py * ux + sx * ty - sy * tx)

    q = nav[NAV_QUAT:NAV_BIAS_FRAME]
    dcm(q, c_nb)
    sn = c_nb[0, 0] * bx + c_nb[0, 1] * by + c_nb[0, 2] * bz
    se = c_nb[1, 0] * bx + c_nb[1, 1] * by + c_nb[1, 2] * bz
    sd = c_nb[2, 0] * bx + c_nb[2, 1] * by + c_nb[2, 2] * bz

    # velocity, latitude and height at mid-interval, predicted: their error is of third order in dt
    lat, height = nav[NAV_LLH], nav[NAV_LLH + 2]
    vn, ve, vd = nav[NAV_VEL], nav[NAV_VEL + 1], nav[NAV_VEL + 2]
    sin_lat, cos_lat = sincos_of_latitude(lat)
    meridian, transverse = radii(sin_lat)
    half = 0.5 * dt
    g = gravity(sin_lat, height)
    vnm = vn + 0.5 * sn
    vem = ve + 0.5 * se
    vdm = vd + 0.5 * (sd + g * dt)
    h = height - vdm * half
    rm = meridian + h
    rt = transverse + h
    per_rm, per_rt = 1.0 / rm, 1.0 / rt
    dlat = vnm * per_rm * half
    sin_m = sin_lat + cos_lat * dlat
    cos_m = cos_lat - sin_lat * dlat
    g = gravity(sin_m, h)
    per_cos = 1.0 / cos_m
    tan_m = sin_m * per_cos

    # rotation of the local frame: Earth rate, transport rate
    en, ed = RATE * cos_m, -RATE * sin_m
    wn = vem * per_rt
    we = -vnm * per_rm
    wd = -wn * tan_m
    zn = (en + wn) * dt
    ze = we * dt
    zd = (ed + wd) * dt

    # specific force into the frame of mid-interval, then gravity and Coriolis, this one from a mid-interval
    # velocity that has already felt it
    dn = sn - 0.5 * (ze * sd - zd * se)
    de = se - 0.5 * (zd * sn - zn * sd)
    dd = sd - 0.5 * (zn * se - ze * sn)
    on, oe, od = 2.0 * en + wn, we, 2.0 * ed + wd
    dd += g * dt
    cn = vn + 0.5 * (dn - (oe * vdm - od * vem) * dt)
    ce = ve + 0.5 * (de - (od * vnm - on * vdm) * dt)
    cd = vd + 0.5 * (dd - (on * vem - oe * vnm) * dt)
    vn1 = vn + dn - (oe * cd - od * ce) * dt
    ve1 = ve + de - (od * cn - on * cd) * dt
    vd1 = vd + dd - (on * ce - oe * cn) * dt

    nav[NAV_LLH + 2] = height - 0.5 * (vd + vd1) * dt
    nav[NAV_LLH] = lat + 0.5 * (vn + vn1) * dt * per_rm
    lon = nav[NAV_LLH + 1] + 0.5 * (ve + ve1) * dt * (per_rt * per_cos)
    beyond = abs(lon) > math.pi
    if any_lane(beyond):
        lon = where(beyond, wrap_angle(lon), lon)
    nav[NAV_LLH + 1] = lon
    nav[NAV_VEL], nav[NAV_VEL + 1], nav[NAV_VEL + 2] = vn1, ve1, vd1

    rotate_in_body_axes(q, ax, ay, az)
    wn = ce * per_rt
    rotate_in_nav_axes(q, -(en + wn) * dt, cn * per_rm * dt, -(ed - wn * tan_m) * dt)
    normalise(q)

    # C_nb half-way: C (I + 1/2 [dtheta x]) in the frame of mid-interval, enough for the error model
    for i in range(3):
        c0, c1, c2 = c_nb[i, 0], c_nb[i, 1], c_nb[i, 2]
        mid[3 * i] = c0 + 0.5 * (c1 * tz - c2 * ty)
        mid[3 * i + 1] = c1 + 0.5 * (c2 * tx - c0 * tz)
        mid[3 * i + 2] = c2 + 0.5 * (c0 * ty - c1 * tx)
    mid[MID_FELT], mid[MID_FELT + 1], mid[MID_FELT + 2] = dn, de, dd - g * dt
    mid[MID_SIN] = sin_m
    mid[MID_COS] = cos_m
    mid[MID_HEIGHT] = h
    mid[MID_VEL], mid[MID_VEL + 1], mid[MID_VEL + 2] = vnm, vem, vdm
    mid[MID_MERIDIAN] = rm
    mid[MID_TRANSVERSE] = rt
    mid[MID_GRAVITY] = g


@kernel
def first_increments(nav, declared, dtheta, dv, dt, previous):
    """Use the first interval's own compensated increments as those of the interval before it. previous: (6,) out."""
    inverse = small_matrix(nav, 6, 3)
    unmixing(nav, declared, inverse)
    increments = compensated(nav, is_mixed(declared), inverse, dtheta[0], dtheta[1], dtheta[2], dv[0], dv[1], dv[2], dt)
    for i in range(6):
        previous[i] = increments[i]


@kernel_inline
def _all(nav, mixed, inverse, dtheta, dv, dt, previous, every, out):
    c_nb = small_matrix(nav, 3, 3)
    mid = small_vector(nav, MID_N)
    for k in range(dtheta.shape[0]):
        tx, ty, tz, ux, uy, uz = compensated(
            nav, mixed, inverse, dtheta[k, 0], dtheta[k, 1], dtheta[k, 2], dv[k, 0], dv[k, 1], dv[k, 2], dt
        )
        step(nav, tx, ty, tz, ux, uy, uz, previous, dt, c_nb, mid)
        if (k + 1) % every == 0:
            copy(nav, out[(k + 1) // every])


@kernel
def navigate(nav, declared, dtheta, dv, dt, every, out):
    """Mechanise increments alone, without a filter: out[j] is the state after j * every intervals.

    nav: initial navigation state, overwritten by the final one, with estimates of the declared sensor states. dtheta,
    dv: (n, 3) rad, m/s. dt: s. out: (n // every + 1, NAV_N).
    """
    nav, dtheta, dv, out = as_simd(nav), as_simd(dtheta), as_simd(dv), as_simd(out)
    previous, inverse = small_vector(nav, 6), small_matrix(nav, 6, 3)
    first_increments(nav, declared, dtheta[0], dv[0], dt, previous)
    copy(nav, out[0])
    unmixing(nav, declared, inverse)
    # known to the compiler, so not tested at every step
    if is_mixed(declared):
        _all(nav, True, inverse, dtheta, dv, dt, previous, every, out)
    else:
        _all(nav, False, inverse, dtheta, dv, dt, previous, every, out)
