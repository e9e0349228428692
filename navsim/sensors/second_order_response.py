"""Response of a second-order sensor to increments.

Source: `docs/theory/sensors.md`, section 2.
"""

from __future__ import annotations

import numpy as np

from navsim.compiler.jit import kernel


@kernel
def respond(increments, dt, step, out):
    """Increments out (n, m) of a second-order response to increments (n, m) over intervals of dt, s, from rest.

    step (3, 3): matrix from value and slope before an interval, and the mean of the input, to the integral over the
    interval, and value and slope after it.
    """
    n, m = increments.shape
    value, slope = np.empty(m), np.zeros(m)
    for c in range(m):
        value[c] = increments[0, c] / dt
    for k in range(n):
        for c in range(m):
            x, v, u = value[c], slope[c], increments[k, c] / dt
            out[k, c] = step[0, 0] * x + step[0, 1] * v + step[0, 2] * u
            value[c] = step[1, 0] * x + step[1, 1] * v + step[1, 2] * u
            slope[c] = step[2, 0] * x + step[2, 1] * v + step[2, 2] * u
