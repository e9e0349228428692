"""`kind: eskf`: feedback by addition, attitude by rotation, with the exact covariance reset.

Sources: [1] `docs/theory/filter.md`, section 5. [2] Mueller, Hehn & D'Andrea, Covariance correction step for Kalman
filtering with an attitude, JGCD 40 (2017).
"""

from __future__ import annotations

from navsim.compiler.elementary import sincos_of_latitude
from navsim.compiler.jit import kernel
from navsim.compiler.lanes import as_simd, small_matrix
from navsim.filter.covariance import reset
from navsim.filter.states import (
    NAV_BIAS_FRAME,
    NAV_LLH,
    NAV_QUAT,
    NAV_SENSORS,
    NAV_VEL,
    PHI_D,
    PHI_E,
    PHI_N,
    R_D,
    R_E,
    R_N,
    SENSORS,
    VEL,
)
from navsim.geodesy.attitude_kernels import difference, rotate_in_nav_axes
from navsim.geodesy.earth_kernels import radii, wrap_angle


@kernel
def move(nav, north, east, down):
    """Move the position of a navigation state by metres, in place."""
    lat, height = nav[NAV_LLH], nav[NAV_LLH + 2]
    sin_lat, cos_lat = sincos_of_latitude(lat)
    meridian, transverse = radii(sin_lat)
    nav[NAV_LLH + 1] = wrap_angle(nav[NAV_LLH + 1] + east / ((transverse + height) * cos_lat))
    nav[NAV_LLH] = lat + north / (meridian + height)
    nav[NAV_LLH + 2] = height - down


@kernel
def plain_error(llh, vel, quat, sensors, nav, error):
    """The plain error (n,) of a navigation state: the given position, velocity, attitude, sensor states less its
    own."""
    height = nav[NAV_LLH + 2]
    sin_lat, cos_lat = sincos_of_latitude(nav[NAV_LLH])
    meridian, transverse = radii(sin_lat)
    error[R_N] = (llh[0] - nav[NAV_LLH]) * (meridian + height)
    error[R_E] = wrap_angle(llh[1] - nav[NAV_LLH + 1]) * (transverse + height) * cos_lat
    error[R_D] = height - llh[2]
    for i in range(3):
        error[VEL + i] = vel[i] - nav[NAV_VEL + i]
    for c in range(sensors.shape[0]):
        error[SENSORS + c] = sensors[c] - nav[NAV_SENSORS + c]
    difference(quat, nav[NAV_QUAT:NAV_BIAS_FRAME], error[PHI_N:SENSORS])


@kernel
def between(a, b, error):
    """Plain error (n,) from navigation state b to a."""
    plain_error(a[NAV_LLH:NAV_VEL], a[NAV_VEL:NAV_QUAT], a[NAV_QUAT:NAV_BIAS_FRAME], a[NAV_SENSORS:], b, error)


@kernel
def inject(nav, x):
    """Feed the estimated errors x (n,) back into the navigation state, in place."""
    move(nav, x[R_N], x[R_E], x[R_D])
    for i in range(3):
        nav[NAV_VEL + i] += x[VEL + i]
    for c in range(x.shape[0] - SENSORS):
        nav[NAV_SENSORS + c] += x[SENSORS + c]
    rotate_in_nav_axes(nav[NAV_QUAT:NAV_BIAS_FRAME], x[PHI_N], x[PHI_E], x[PHI_D])


@kernel
def displace(nav, x):
    """`inject` for those who are outside of kernels: lanes of navigation states (NAV,) and errors (n,), in place."""
    inject(as_simd(nav), as_simd(x))


@kernel
def correct(nav, p, x, space):
    """Apply the estimated errors x (n,) and transform P (n, n) to the new estimate. space:
    `filter_loop.PropagationBuffers`."""
    inject(nav, x)
    reset(p, x[PHI_N], x[PHI_E], x[PHI_D], small_matrix(nav, 3, 3), space.columns)
