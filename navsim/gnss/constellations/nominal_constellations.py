"""Design constellations of Galileo, BeiDou and QZSS.

Each constellation has its real shape: Walker 24/3/1 in medium orbits [1], and satellites that stay over one meridian.
Phases are those of the real satellites on 2020-06-25, 12:00 GPS time: means of all satellites in their slots, from the
messages that the station Esbjerg (ESBC) received. On other days medium orbits are propagated by mean motion and
regression of the node; satellites over one meridian stay there.

Sources:

- [1] Galileo: 56 degrees, 29 600 km; BeiDou: 55 degrees, 27 906.1 km; messages of that day agree to 1 km and 0.2
  degrees in the mean.
- [2] Longitudes of geostationary BeiDou satellites from public lists of satellites (G7, G6 of the second generation,
  and C01); the interface document was not seen.
- [3] Messages of J01, J02, J03 of that day.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from navsim.gnss import timescales
from navsim.gnss.constellations.gps import TILT, Elements, KeplerianEphemerides, on_circles, second_of_week
from navsim.gnss.constellations.systems import BEIDOU, GALILEO, QZSS, System

_PHASE_TIME = timescales.posix(2020, 6, 25, 11, 59, 42.0)
"""UTC of 12:00 GPS time."""
GALILEO_RADIUS, GALILEO_INCLINATION = 29600.0e3, np.radians(56.0)
GALILEO_PHASE = (41.4, 25.8)
"""Right ascension of the node and argument of latitude of the first satellite, degrees, at `_PHASE_TIME`."""
BEIDOU_RADIUS, BEIDOU_INCLINATION = 27906.1e3, np.radians(55.0)
BEIDOU_PHASE = (16.0, 35.9)
"""See `GALILEO_PHASE`."""
_BEIDOU_MEDIUM = (*range(19, 31), *range(32, 38), *range(41, 47))
"""Numbers that satellites in medium orbits have."""
_BEIDOU_INCLINED, _BEIDOU_STATIONARY = (38, 39, 40), (59, 60, 61)
_MERIDIANS = np.radians([80.0, 110.5, 140.0])
"""Longitudes of the geostationary satellites of BeiDou [2]."""
_INCLINED_MERIDIAN, _INCLINED_PHASE = np.radians(118.0), 31.0
"""Meridians at which the inclined BeiDou satellites cross the equator, and the argument of latitude of the first,
degrees."""
# number, inclination, eccentricity, perigee, longitude of the node at `_PHASE_TIME`, mean anomaly; degrees [3]
_QZSS_ORBITS = (
    (1, 41.6, 0.0759, 270.9, 49.4, 179.4),
    (2, 43.0, 0.0753, 269.3, 180.3, 50.8),
    (3, 40.8, 0.0748, 271.6, 277.5, 307.4),
)


def walker(planes: int, each: int, step: float, first: tuple[float, float]) -> np.ndarray:
    """Right ascensions of the node and arguments of latitude (planes * each, 2), degrees, plane by plane.

    step: by how much arguments of latitude grow from plane to plane, degrees. first: of the first satellite.
    """
    plane, place = np.divmod(np.arange(planes * each), each)
    node = first[0] + 360.0 / planes * plane
    return np.column_stack([node % 360.0, (first[1] + 360.0 / each * place + step * plane) % 360.0])


def galileo(utc: float) -> KeplerianEphemerides:
    """Walker 24/3/1, for flights about a UTC time (POSIX s); E01 ... E24 by slot."""
    start = walker(3, 8, 15.0, GALILEO_PHASE)
    numbers = np.arange(1, len(start) + 1)
    return on_circles(GALILEO, numbers, GALILEO_RADIUS, GALILEO_INCLINATION, start, _PHASE_TIME, utc)


def beidou(utc: float) -> KeplerianEphemerides:
    """Walker 24/3/1 in medium orbits, three in inclined geosynchronous orbits, three geostationary ones, for flights
    about a UTC time (POSIX s)."""
    start = walker(3, 8, 15.0, BEIDOU_PHASE)
    medium = on_circles(
        BEIDOU, np.array(_BEIDOU_MEDIUM), BEIDOU_RADIUS, BEIDOU_INCLINATION, start, _PHASE_TIME, utc
    ).records
    latitude = np.radians(_INCLINED_PHASE + np.array([0.0, 120.0, 240.0]))
    inclined = _synchronous(
        BEIDOU, _BEIDOU_INCLINED, utc, inclination=np.full(3, BEIDOU_INCLINATION),
        node=_INCLINED_MERIDIAN - latitude, anomaly=latitude,
    )  # fmt: skip
    parts = (medium, inclined, _stationary(BEIDOU, _BEIDOU_STATIONARY, _MERIDIANS, utc))
    whole = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Elements)}
    return KeplerianEphemerides(Elements(**whole), reach=np.inf, system=BEIDOU)


def qzss(utc: float) -> KeplerianEphemerides:
    """J01, J02, J03 over their meridians, for flights about a UTC time (POSIX s)."""
    table = np.array(_QZSS_ORBITS)
    inclination, perigee, node, anomaly = np.radians(table[:, [1, 3, 4, 5]]).T
    numbers = tuple(table[:, 0].astype(int).tolist())
    records = _synchronous(
        QZSS, numbers, utc, inclination=inclination, node=node, anomaly=anomaly, e=table[:, 2], omega=perigee
    )
    return KeplerianEphemerides(records, reach=np.inf, system=QZSS)


def _synchronous(
    system: System, numbers: tuple[int, ...], utc: float, *, inclination: np.ndarray, node: np.ndarray,
    anomaly: np.ndarray, **shape: np.ndarray,
) -> Elements:  # fmt: skip
    """Elements (n,) of geosynchronous satellites.

    node: longitude of the node, rad; anomaly: mean anomaly, rad, at `_PHASE_TIME`; shape: eccentricity and perigee of
    elliptic orbits.
    """
    toe = _floor_second(utc)
    turned = system.earth_rate * (toe - float(timescales.gps_from_utc(_PHASE_TIME)))
    return _with_the_earth(
        system, numbers, toe, i0=inclination,
        omega0=(node - turned + system.earth_rate * second_of_week(np.array(toe), system)) % (2.0 * np.pi),
        m0=(anomaly + turned) % (2.0 * np.pi), **shape,
    )  # fmt: skip


def _stationary(system: System, numbers: tuple[int, ...], longitude: np.ndarray, utc: float) -> Elements:
    """Elements (n,) in tilted axes of satellites that stay over longitudes, rad: a circle around the Earth's axis, seen
    from axes tilted against it, is inclined by the tilt."""
    toe = _floor_second(utc)
    node = np.pi + system.earth_rate * second_of_week(np.array(toe), system)
    count = len(numbers)
    return _with_the_earth(
        system, numbers, toe, i0=np.full(count, abs(TILT)), omega0=np.full(count, node % (2.0 * np.pi)),
        m0=longitude - np.pi,
    )  # fmt: skip


def _floor_second(utc: float) -> float:
    """GPS time of the second that a UTC time (POSIX s) is in."""
    return float(np.floor(timescales.gps_from_utc(utc)))


def _with_the_earth(system: System, numbers: tuple[int, ...], toe: float, **orbit: np.ndarray) -> Elements:
    """Elements (n,) of healthy satellites that go around as fast as the Earth; toe: GPS s; orbit: their other
    elements."""
    count = len(numbers)
    return Elements.of(
        prn=np.array(numbers),
        healthy=np.ones(count, dtype=bool),
        toe=np.full(count, toe),
        toc=np.full(count, toe),
        sqrt_a=np.full(count, (system.gm / system.earth_rate**2) ** (1.0 / 6.0)),
        **orbit,
    )
