"""Measurement models: innovation, matrix and noise of each kind of measurement.

    z = measured - predicted = H d + noise,  d the plain errors (dr, dv, theta, sensor states)

A new kind needs a number, a table, a line in `Measurements` and `_TABLES` (`measurement_kinds`), and a branch of
`observe`, whose equations stand in a module `..._measurements`. The rest of a sensor is its declaration
(`sensors.aiding`).
"""

from __future__ import annotations

from navsim.compiler.jit import kernel, kernel_inline
from navsim.filter.gnss_measurements import observe_fix, observe_range
from navsim.filter.ground_station_measurements import observe_beacon, observe_station
from navsim.filter.height_measurements import observe_altitude, observe_height_above_ground, observe_pressure
from navsim.filter.magnetometer_measurements import observe_field
from navsim.filter.measurement_kinds import (
    ABOVE_GROUND,
    ALTITUDE,
    AZIMUTH,
    BEACON,
    DISTANCE,
    ELEVATION,
    FIX,
    HEADING,
    KIND_COUNT,
    MAGNETIC,
    MONITOR_ONLY_FIX,
    PRESSURE,
    RANGE,
    REST_RATE,
    VEHICLE_VELOCITY,
)
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.filter.vehicle_measurements import observe_vehicle


@kernel
def slot(kind, row, measurements):
    """Counter for consecutive rejections of such a measurement; each source of ranges has its own."""
    beacons = measurements.beacons
    if kind == RANGE:
        return KIND_COUNT + beacons.position.shape[0] + measurements.ranges.source[row]
    return KIND_COUNT + beacons.beacon[row] if kind == BEACON else kind


@kernel_inline
def clear(have, h):
    """No component is valid: zeros in have (MOST,) and h (MOST, n)."""
    for a in range(MAX_MEASUREMENT_SIZE):
        have[a] = 0.0
        for c in range(h.shape[1]):
            h[a, c] = 0.0


@kernel_inline
def observe(kind, row, measurements, nav, increments, dt, declared, c_nb, have, z, h, r):
    """Innovation, matrix and noise of a measurement; returns the number of its components. Raises ValueError for an
    unknown kind.

    - `kind`, `row`: as of `records.Events`; `nav`: navigation state.
    - `increments` (6,): compensated increments of the last interval, of `dt` s.
    - `declared`: sensor states of the filter; `c_nb` (3, 3): work space.
    - `have` (MOST,), out: 1 for valid components, else 0.
    - `z` (MOST,), out: innovation; `h` (MOST, n), out; `r` (MOST, MOST), out: noise. An invalid component has
      innovation 0
      and row 0, so it has no effect.
    """
    clear(have, h)
    if kind in (FIX, MONITOR_ONLY_FIX):
        return observe_fix(measurements.fixes, row, nav, increments, dt, declared, c_nb, have, z, h, r)
    if kind == RANGE:
        return observe_range(measurements.ranges, row, nav, increments, dt, declared, c_nb, have, z, h, r)
    if kind == ABOVE_GROUND:
        return observe_height_above_ground(measurements.grounds, row, nav, c_nb, have, z, h, r)
    if kind == PRESSURE:
        return observe_pressure(measurements.pressures, row, nav, declared, have, z, h, r)
    if kind == ALTITUDE:
        return observe_altitude(measurements.altitudes, row, nav, have, z, h, r)
    if kind == MAGNETIC:
        return observe_field(measurements.magnetic, row, nav, declared, c_nb, have, z, h, r)
    if kind == BEACON:
        return observe_beacon(measurements.beacons, row, nav, declared, c_nb, have, z, h, r)
    if kind == AZIMUTH:
        return observe_station(kind, measurements.azimuths, row, nav, declared, c_nb, have, z, h, r)
    if kind == ELEVATION:
        return observe_station(kind, measurements.elevations, row, nav, declared, c_nb, have, z, h, r)
    if kind == DISTANCE:
        return observe_station(kind, measurements.distances, row, nav, declared, c_nb, have, z, h, r)
    if kind == HEADING:
        return observe_vehicle(
            kind, measurements.headings, row, nav, increments, dt, declared, c_nb, have, z, h, r
        )  # fmt: skip
    if kind == VEHICLE_VELOCITY:
        return observe_vehicle(
            kind, measurements.vehicle_velocities, row, nav, increments, dt, declared, c_nb, have, z, h, r
        )  # fmt: skip
    if kind == REST_RATE:
        return observe_vehicle(
            kind, measurements.rest_rates, row, nav, increments, dt, declared, c_nb, have, z, h, r
        )  # fmt: skip
    raise ValueError("no measurement model is of this kind")
