"""Numerical integration of GLONASS orbits from the broadcast message.

The method is the simplified algorithm of [1]: J2, constant lunisolar accelerations, rotating axes, fourth-order
Runge-Kutta. Source [2] gives the rate of the Earth to more digits, and that rate reproduces its worked example.

Sources: [1] GLONASS ICD, navigational radiosignal in bands L1, L2, edition 5.1 (2008), appendix 3, section A.3.1.2. [2]
GLONASS ICD, general description of CDMA signals (2016), appendix J.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.compiler.jit import kernel

GM = 398600.4418e9
"""Gravitational constant of the Earth, m3/s2 [1]."""
A_E = 6378136.0
"""Equatorial radius, m [1]."""
J20 = 1.08262575e-3
"""Second zonal harmonic, -sqrt(5) C20 [1]."""
EARTH_RATE = 7.2921151467e-5
"""rad/s [2]."""


@kernel
def _derivative(s, extra, out):
    """Velocity and acceleration of a state (6,) in rotating axes; extra: (3,) lunisolar acceleration [1]."""
    r2 = s[0] * s[0] + s[1] * s[1] + s[2] * s[2]
    r = math.sqrt(r2)
    centre = -GM / (r2 * r)
    flat = 1.5 * J20 * GM * A_E * A_E / (r2 * r2 * r)
    z2 = 5.0 * s[2] * s[2] / r2
    out[0] = s[3]
    out[1] = s[4]
    out[2] = s[5]
    out[3] = (centre - flat * (1.0 - z2) + EARTH_RATE * EARTH_RATE) * s[0] + 2.0 * EARTH_RATE * s[4] + extra[0]
    out[4] = (centre - flat * (1.0 - z2) + EARTH_RATE * EARTH_RATE) * s[1] - 2.0 * EARTH_RATE * s[3] + extra[1]
    out[5] = (centre - flat * (3.0 - z2)) * s[2] + extra[2]


@kernel
def glonass_states(state, acceleration, interval, step, out):
    """Positions and velocities after an interval each, by Runge-Kutta in equal steps no longer than `step`.

    state: (n, 6) m, m/s, PZ-90. acceleration: (n, 3) lunisolar, m/s2. interval: (n,) s, of either sign, nan for
    none. step: s. out: (n, 6); nan where the interval is.
    """
    k1, k2, k3, k4 = np.empty(6), np.empty(6), np.empty(6), np.empty(6)
    s, mid = np.empty(6), np.empty(6)
    for n in range(state.shape[0]):
        if math.isnan(interval[n]):
            out[n] = np.nan
            continue
        count = math.ceil(abs(interval[n]) / step)
        h = interval[n] / max(count, 1)
        s[:] = state[n]
        for _ in range(count):
            _derivative(s, acceleration[n], k1)
            for i in range(6):
                mid[i] = s[i] + 0.5 * h * k1[i]
            _derivative(mid, acceleration[n], k2)
            for i in range(6):
                mid[i] = s[i] + 0.5 * h * k2[i]
            _derivative(mid, acceleration[n], k3)
            for i in range(6):
                mid[i] = s[i] + h * k3[i]
            _derivative(mid, acceleration[n], k4)
            for i in range(6):
                s[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
        out[n] = s
