"""`first-estimates` and `observability-constrained`: error-state filters with constrained linearisation points.

An attitude error changes position and velocity by the motion of an interval. The usual transition computes this motion
from the corrected estimate at its start to the predicted one at its end. The next transition starts from another point,
so the transitions do not chain, and the filter gains information about a rotation that no measurement shows.

Both kinds compute the motion from the predicted estimate at the start:

- `first-estimates`: for all attitude errors.
- `observability-constrained`: for heading errors alone, which is the smallest change that keeps a rotation about the
  vertical unobservable.

Everything else is as in `eskf`. Sensor columns of the transition keep the corrected attitude.

Sources:

- [1] Huang, Mourikis & Roumeliotis, Observability-based rules for designing consistent EKF SLAM estimators, IJRR 29
  (2010).
- [2] Li & Mourikis, High-precision, consistent EKF-based visual-inertial odometry, IJRR 32 (2013).
- [3] Hesch, Kottas, Bowman & Roumeliotis, Consistency analysis and improvement of vision-aided inertial navigation,
  IEEE Transactions on Robotics 30 (2014).
- [4] `docs/theory/first-estimates.md`.
"""

from __future__ import annotations

from navsim.compiler.jit import kernel
from navsim.filter.eskf import between
from navsim.filter.records import FIRST_ESTIMATES
from navsim.filter.states import ATT, POS, VEL
from navsim.filter.steady_force import couple


@kernel
def note_shift(nav, predicted, work, shift):
    """Add the correction of position, m, and velocity, m/s, by a measurement to `shift` (6,).

    nav, predicted: (NAV,) navigation state after and before it. work: (n,).
    """
    between(nav, predicted, work)
    for i in range(ATT):
        shift[i] += work[i]


@kernel
def start_transition(kind, shift, p):
    """Move the start of the next transition of P (n, n) back by the corrections `shift` (6,), in place; clear them."""
    tilts = 1.0 if kind == FIRST_ESTIMATES else 0.0
    couple(p, POS, shift[POS:VEL], tilts)
    couple(p, VEL, shift[VEL:ATT], tilts)
    for i in range(ATT):
        shift[i] = 0.0 * shift[i]
