"""What a sensor of second order makes of increments.

Source: `docs/theory/sensors.md`, section 2.
"""

from __future__ import annotations

import numpy as np

from navsim.compiler.jit import kernel


@kernel
def respond(increments, dt, step, out):
    """Increments out (n, m) of a response of second order to increments (n, m) over intervals of dt, s.

    step (3, 3): what the integral over an interval, the value and its slope are after it, of value and slope before it
    and of the mean of the input. Before the first interval everything has stood still.
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
