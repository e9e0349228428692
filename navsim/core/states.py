"""The one table of states: order, slices, names, units. Nothing else in navsim counts to fifteen.

Error state (filter, results): truth minus estimate, in the order of the paper's equation (1).
Navigation state (strapdown): one flat array of twenty numbers, the `NAV_*` offsets below.
"""

from __future__ import annotations

# --- error state
POS, VEL, ATT, GYRO, ACCEL = 0, 3, 6, 9, 12
"""First index of the position, velocity, attitude, gyro bias and accelerometer bias errors."""
N = 15

SLICES = {
    "position": slice(POS, VEL),
    "velocity": slice(VEL, ATT),
    "attitude": slice(ATT, GYRO),
    "gyro_bias": slice(GYRO, ACCEL),
    "accelerometer_bias": slice(ACCEL, N),
}

NAMES = (
    *(f"position_{axis}" for axis in ("north", "east", "down")),
    *(f"velocity_{axis}" for axis in ("north", "east", "down")),
    *(f"attitude_{axis}" for axis in ("north", "east", "down")),
    *(f"gyro_bias_{axis}" for axis in ("x", "y", "z")),
    *(f"accelerometer_bias_{axis}" for axis in ("x", "y", "z")),
)
UNITS = ("m",) * 3 + ("m/s",) * 3 + ("rad",) * 3 + ("rad/s",) * 3 + ("m/s2",) * 3

# --- navigation state: latitude, longitude [rad], height [m]; velocity NED [m/s]; quaternion b -> n
# (scalar first); gyro and accelerometer bias estimates [rad/s, m/s2]; the turn that the `tfg` filter's bias
# axes have been held back by (quaternion, see `estimation.tfg`; zeros at the start of a flight)
NAV_LLH, NAV_VEL, NAV_QUAT, NAV_GYRO, NAV_ACCEL, NAV_HELD = 0, 3, 6, 10, 13, 16
NAV_N = 20
