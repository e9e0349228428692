"""navsim: plan and check a landing navigation system (INS + GNSS + ground pseudolites).

Conventions of the whole package; `docs/conventions.md` has the details.

- Frames: i inertial; e ECEF (WGS-84); n local level, north-east-down (NED) at the vehicle; b body, forward-right-down.
  Receiver geometry is in ENU, because that is how DOPs are defined.
- C_nb rotates b components into n: v_n = C_nb v_b. Quaternions are b -> n, Hamilton, scalar first.
- Errors: truth minus estimate. Attitude error: rotation vector theta in NED, C_nb(true) = exp(theta x) C_nb(estimate).
- States: fifteen, in the order of `navsim.filter.states`. Position (m, NED), velocity (m/s), attitude (rad), gyro bias
  (rad/s), accelerometer bias (m/s2). The scale factor errors of gyros and accelerometers (1) follow if a filter
  estimates them. Measured = (1 + scale) true + bias.
- Units: SI and radians inside; outside the unit is in the name of each key or column.
- Time: seconds since the scenario's epoch, which is UTC; increments belong to the interval that ends at their time.
- DOP: from unit-weight geometry in ENU; GDOP is the root of the whole trace, TDOP belongs to the first clock.
- SKO: the paper's СКО, root of the weighted covariance of a fix (horizontal: two axes, vertical: one).
"""

from __future__ import annotations

from importlib import import_module as _import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from navsim.api.calls import NavsimWarning as NavsimWarning
    from navsim.api.calls import evidence as evidence
    from navsim.api.calls import import_log as import_log
    from navsim.api.calls import optimize as optimize
    from navsim.api.calls import replay as replay
    from navsim.api.calls import run as run
    from navsim.api.calls import schema as schema
    from navsim.api.calls import sweep as sweep
    from navsim.api.calls import validate as validate
    from navsim.api.calls import verify as verify
    from navsim.api.result import ResultFile as ResultFile
    from navsim.api.result import load as load
    from navsim.runner.errors import BadInput as BadInput
    from navsim.runner.errors import NavsimError as NavsimError
    from navsim.runner.errors import RunFailed as RunFailed

_PLACES = {
    **dict.fromkeys(
        (
            "run",
            "sweep",
            "optimize",
            "replay",
            "validate",
            "verify",
            "evidence",
            "import_log",
            "schema",
            "NavsimWarning",
        ),
        "navsim.api.calls",
    ),
    **dict.fromkeys(("load", "ResultFile"), "navsim.api.result"),
    **dict.fromkeys(("NavsimError", "BadInput", "RunFailed"), "navsim.runner.errors"),
}
"""Modules of the public names, which are imported on first use (PEP 562)."""

__all__ = [*_PLACES, "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'navsim' has no attribute {name!r}")
    return getattr(_import_module(_PLACES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_PLACES})
