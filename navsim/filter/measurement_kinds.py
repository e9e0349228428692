"""Kinds of measurements: the number of each kind, and the table that holds its measurements for the filter.

Sources:

- [1] `docs/theory/lasting-errors.md`, sections 3 and 4.
- [2] `docs/theory/magnetometer.md`.
- [3] `docs/theory/beacons.md`.
- [4] `docs/theory/ground-stations.md`.
- [5] `docs/theory/ground.md`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from navsim.filter.states import MAX_MEASUREMENT_SIZE

FIX, ALTITUDE, MONITOR_ONLY_FIX, RANGE, ABOVE_GROUND, PRESSURE, MAGNETIC = 2, 3, 4, 5, 6, 7, 8
"""Kinds of measurements, as kinds of events; `records.PASS` and `OUTPUT` come before them. The filter computes the
innovation of a probe, a kind of fix, and never uses it. Random numbers are keyed by these numbers, so they never
change."""
SOURCE = 9
"""Kind of the states that are errors of transmitters on the ground: in measurements of the kinds FIX and RANGE."""
BEACON = 10
"""Kind of the ranges of beacons."""
BEACON_STATES = 5
"""Errors of a beacon: bias, growth of the bias, position along north, east, down [3]. The state of the error k of the
beacon i has the axis `BEACON_STATES` i + k. Behind those of n beacons come offset and rate of the receiver's clock, the
refractivity of the air, and offset and rate of each beacon's own clock."""
AZIMUTH, ELEVATION, DISTANCE = 11, 12, 13
"""Kinds of the measurements of ground stations: two angles and a range [4]."""
HEADING, VEHICLE_VELOCITY, REST_RATE = 14, 15, 16
"""Kinds of headings, of velocities along the axes of a vehicle, and of the gyros' readings at rest [5]."""
PRODUCT = 17
"""Kind of the states that are products of the position error (`error_products`), of no measurement."""
KIND_COUNT = 1 + REST_RATE
"""Slots of the other kinds, see `measurement_models.slot`. Slots of ranges follow, one for each beacon, then one for
each source."""


class FixTable(NamedTuple):
    """Fixes of a receiver's antenna, m of them."""

    llh: np.ndarray
    """(m, 3) rad, rad, m, nan without a position."""
    velocity: np.ndarray
    """(m, 3) NED m/s; the filter ignores components that are nan."""
    covariance: np.ndarray
    """(m, 6, 6) of the white noise of both, NED."""
    lever_arm: np.ndarray
    """(3,) IMU to antenna, body axes, m; the same in all lanes."""
    correlated: np.ndarray = np.empty((0, MAX_MEASUREMENT_SIZE, 0))
    """(m, 6, k) effect of each of the filter's k time-correlated errors of fixes [1]; the same in all lanes."""
    transmitters: np.ndarray = np.empty((0, MAX_MEASUREMENT_SIZE, 0))
    """(m, 6, q) effect of each of the filter's q errors of transmitters; the same in all lanes."""

    @classmethod
    def none(cls, *lanes: int) -> FixTable:
        """The table without measurements, of one run or of lanes."""
        return cls(np.empty((0, 3, *lanes)), np.empty((0, 3, *lanes)), np.empty((0, 6, 6, *lanes)), np.zeros(3))

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> FixTable:
        """The table with every array changed that differs between runs."""
        return self._replace(llh=change(self.llh), velocity=change(self.velocity), covariance=change(self.covariance))


class AltitudeTable(NamedTuple):
    """Heights of the IMU above the ellipsoid, m of them."""

    height: np.ndarray
    """(m,) m, nan if missing."""
    variance: np.ndarray
    """(m,) m2."""

    @classmethod
    def none(cls, *lanes: int) -> AltitudeTable:
        """The table without measurements, of one run or of lanes."""
        return cls(np.empty((0, *lanes)), np.empty((0, *lanes)))

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> AltitudeTable:
        """The table with every array changed that differs between runs."""
        return AltitudeTable(change(self.height), change(self.variance))


class GroundTable(NamedTuple):
    """Heights of a radio altimeter's antenna above the ground, m of them, and the filter's model of the ground."""

    height: np.ndarray
    """(m,) m, nan if missing."""
    floor: float
    """Smallest 1 sigma, m."""
    share: float
    """1 sigma as a fraction of the height, if that is larger than `floor`."""
    start: float
    """Distance beyond the threshold from which the filter uses heights, m."""
    threshold: np.ndarray
    """See `sensors.altimeter.Centreline`, also for `scale` and `direction`."""
    scale: np.ndarray
    direction: np.ndarray
    along: np.ndarray
    """(g,) see `sensors.altimeter.Ground`, also for `ground`."""
    ground: np.ndarray
    lever_arm: np.ndarray
    """See `FixTable`."""

    @classmethod
    def none(cls, *lanes: int) -> GroundTable:
        """The table without measurements, of one run or of lanes."""
        level = np.zeros(1)
        height, north = np.empty((0, *lanes)), np.array([1.0, 0.0])
        return cls(height, 1.0, 0.0, 0.0, np.zeros(3), np.ones(2), north, level, level, np.zeros(3))

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> GroundTable:
        """The table with every array changed that differs between runs."""
        return self._replace(height=change(self.height))


class PressureTable(NamedTuple):
    """Heights of the IMU above the ellipsoid from static pressure, m of them."""

    height: np.ndarray
    """(m,) m, nan if missing."""
    variance: np.ndarray
    """(m,) m2 of the white noise."""
    lag: float
    """Delay of the pressure, s."""

    @classmethod
    def none(cls, *lanes: int) -> PressureTable:
        """The table without measurements, of one run or of lanes."""
        return cls(np.empty((0, *lanes)), np.empty((0, *lanes)), 0.0)

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> PressureTable:
        """The table with every array changed that differs between runs."""
        return self._replace(height=change(self.height), variance=change(self.variance))


class MagneticTable(NamedTuple):
    """Magnetic fields along the body axes, m of them, and the filter's model of the field [2]."""

    field: np.ndarray
    """(m, 3) uT, nan if missing."""
    variance: float
    """Of the white noise of each axis, uT2."""
    earth: np.ndarray
    """(3,) field of the Earth, NED, uT."""
    ground: float
    """Height of the ground above the ellipsoid, m."""
    fades: float
    """Height in which the disturbance by the ground falls to 1 / e, m."""

    @classmethod
    def none(cls, *lanes: int) -> MagneticTable:
        """The table without measurements, of one run or of lanes."""
        return cls(np.empty((0, 3, *lanes)), 1.0, np.zeros(3), 0.0, 1.0)

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> MagneticTable:
        """The table with every array changed that differs between runs."""
        return self._replace(field=change(self.field))


class BeaconTable(NamedTuple):
    """Two-way ranges from an antenna to beacons, m of them, and the filter's model of n beacons [3]."""

    range: np.ndarray
    """(m,) m, nan if missing."""
    beacon: np.ndarray
    """(m,) int, number of the beacon."""
    position: np.ndarray
    """(n, 3) surveyed, ECEF, m."""
    axes: np.ndarray
    """(n, 3, 3) unit vectors north, east, down of each, ECEF."""
    sigma: float
    """1 sigma of the noise of a strong signal, m."""
    rise: float
    """1 sigma of the noise that grows with distance, per metre of distance."""
    growth: float
    """Mean growth of the bias, m."""
    growth_distance: float
    """Distance at which the bias has grown to 63 %, m."""
    lever_arm: np.ndarray
    """See `FixTable`."""
    outliers: np.ndarray = np.empty(0)
    """(5,) of the mixture that the filter assumes (`outliers.outlier_moments`); (0,) for none."""
    weakened: np.ndarray = np.empty(0)
    """(m,) factor on the noise that grows with distance, by jammers; (0,) without."""
    rise_to: np.ndarray = np.empty(0)
    """(n,) height of each beacon above the runway over the scale height of refractivity; (0,) without a state of it."""
    ground: float = 0.0
    """Ellipsoidal height of the runway, m."""
    air_height: float = 1.0
    """Scale height of refractivity, m."""

    @classmethod
    def none(cls, *lanes: int) -> BeaconTable:
        """The table without measurements, of one run or of lanes."""
        position, axes = np.empty((0, 3)), np.empty((0, 3, 3))
        return cls(np.empty((0, *lanes)), np.empty(0, np.int64), position, axes, 1.0, 0.0, 0.0, 1.0, np.zeros(3))

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> BeaconTable:
        """The table with every array changed that differs between runs."""
        return self._replace(range=change(self.range))


class StationTable(NamedTuple):
    """Angles or ranges of an antenna from a ground station, m of them [4]."""

    value: np.ndarray
    """(m,) rad or m, nan if missing."""
    position: np.ndarray
    """(3,) of the station, ECEF, m."""
    axis: np.ndarray
    """(3,) ECEF unit vector from which the complement of an angle is counted; unused for ranges."""
    variance: float
    """Of the white noise, rad2 or m2."""
    lever_arm: np.ndarray
    """See `FixTable`."""

    @classmethod
    def none(cls, *lanes: int) -> StationTable:
        """The table without measurements, of one run or of lanes."""
        return cls(np.empty((0, *lanes)), np.zeros(3), np.zeros(3), 1.0, np.zeros(3))

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> StationTable:
        """The table with every array changed that differs between runs."""
        return self._replace(value=change(self.value))


class VehicleTable(NamedTuple):
    """Headings, velocities along the axes of a vehicle, or readings of gyros at rest, m of them [5].

    The states of a kind: the lasting error of a heading; of velocities, the rotation of the vehicle's axes (axes 0 to
    2) and the rest of the lever arm (3 to 5).
    """

    value: np.ndarray
    """(m, 3) nan if missing: a heading of the first row of `axes`, rad; velocity, m/s; mean rate of the gyros,
    rad/s."""
    variance: np.ndarray
    """(m, 3) of the white noise, squared units; the same in all lanes."""
    axes: np.ndarray
    """(3, 3) axes of the vehicle, each a row in body axes; unused for rates."""
    lever_arm: np.ndarray
    """(3,) IMU to the point with that velocity, body axes, m."""

    @classmethod
    def none(cls, *lanes: int) -> VehicleTable:
        """The table without measurements, of one run or of lanes."""
        return cls(np.empty((0, 3, *lanes)), np.empty((0, 3)), np.eye(3), np.zeros(3))

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> VehicleTable:
        """The table with every array changed that differs between runs."""
        return self._replace(value=change(self.value))


class RangeTable(NamedTuple):
    """Pseudoranges and range rates of a receiver's antenna, m of them, each of a source and an epoch.

    Only `pseudorange` and `range_rate` differ between lanes.
    """

    position: np.ndarray
    """(m, 3) of the source according to the receiver (`gnss.pseudorange.Signals`), ECEF, m."""
    velocity: np.ndarray
    """(m, 3) likewise, m/s."""
    distance: np.ndarray
    """(m,) approximate distance to it, m."""
    sigma: np.ndarray
    """(m,) of pseudoranges, m."""
    rate_sigma: np.ndarray
    """(m,) of range rates, m/s."""
    source: np.ndarray
    """(m,) int, number of the source."""
    bias: np.ndarray
    """(m,) int, clock bias in the pseudorange (`receiver_clock.ReceiverClock`)."""
    pseudorange: np.ndarray
    """(m,) m, nan if missing."""
    range_rate: np.ndarray
    """(m,) m/s, unused if it or the pseudorange is nan."""
    lever_arm: np.ndarray
    """See `FixTable`."""
    correlated: np.ndarray
    """(m, g) 1 sigma of the time-correlated errors that the filter estimates, m, for each of g groups of kinds. The
    state with the axis g source + group is this error in sigmas [1]."""
    transmitters: np.ndarray = np.empty((0, 2, 0))
    """(m, 2, q) effect of each of the filter's q errors of transmitters on the pseudorange and the range rate."""

    @classmethod
    def none(cls, *lanes: int) -> RangeTable:
        """The table without measurements, of one run or of lanes."""
        each, number = np.empty(0), np.empty(0, np.int64)
        return cls(
            np.empty((0, 3)), np.empty((0, 3)), each, each, each, number, number, np.empty((0, *lanes)),
            np.empty((0, *lanes)), np.zeros(3), np.empty((0, 0)),
        )  # fmt: skip

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> RangeTable:
        """The table with every array changed that differs between runs."""
        return self._replace(pseudorange=change(self.pseudorange), range_rate=change(self.range_rate))


def _contiguous(table: Any) -> Any:
    """The table with contiguous arrays: numba compiles a filter once more for an array with steps."""
    return table._make(np.ascontiguousarray(m) if isinstance(m, np.ndarray) else m for m in table)


class Measurements(NamedTuple):
    """Tables of all kinds of measurements, empty without measurements."""

    fixes: FixTable
    altitudes: AltitudeTable
    ranges: RangeTable
    grounds: GroundTable
    pressures: PressureTable
    magnetic: MagneticTable
    beacons: BeaconTable
    azimuths: StationTable
    elevations: StationTable
    distances: StationTable
    headings: VehicleTable
    vehicle_velocities: VehicleTable
    rest_rates: VehicleTable

    @classmethod
    def of(cls, tables: Mapping[int, Any], *lanes: int) -> Measurements:
        """Measurements from tables by their kinds, of one run or of lanes; other kinds have none.

        Fixes and probes share one table. Raises KeyError for an unknown kind.
        """
        if unknown := tables.keys() - {MONITOR_ONLY_FIX, *_TABLES}:
            raise KeyError(f"no measurements are of the kind {unknown.pop()}")
        known = {FIX: tables[MONITOR_ONLY_FIX], **tables} if MONITOR_ONLY_FIX in tables else tables
        return cls(
            *(_contiguous(known[kind] if kind in known else table.none(*lanes)) for kind, table in _TABLES.items())
        )

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Measurements:
        """The tables with every array changed that differs between runs."""
        tables: Any = self
        return Measurements(*(table.each(change) for table in tables))


_TABLES: dict[int, Any] = {
    FIX: FixTable, ALTITUDE: AltitudeTable, RANGE: RangeTable, ABOVE_GROUND: GroundTable, PRESSURE: PressureTable,
    MAGNETIC: MagneticTable, BEACON: BeaconTable, AZIMUTH: StationTable, ELEVATION: StationTable,
    DISTANCE: StationTable, HEADING: VehicleTable, VEHICLE_VELOCITY: VehicleTable, REST_RATE: VehicleTable,
}  # fmt: skip
"""Table of each kind, in the order of `Measurements`. Probes are in the table of fixes."""
