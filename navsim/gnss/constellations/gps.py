"""Satellites from Keplerian elements, those of GPS and of the systems whose messages are made like its own: broadcast
ephemerides, almanacs; and the baseline constellation of GPS.

Sources: [1] IS-GPS-200, sections 20.3.3.3.3.1 (satellite clock), 20.3.3.4.3 (ephemeris), 20.3.3.5.2 (almanac).
[2] Remondi, Computing satellite velocity using the broadcast ephemeris, GPS Solutions 8 (2004).
[3] GPS Standard Positioning Service Performance Standard, 4th ed. (2008), table A.2-1 (baseline 24 slots).
[4] BeiDou SIS ICD, open service signal B1I (geostationary satellites).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from navsim.geodesy.earth import SPEED_OF_LIGHT
from navsim.gnss import timescales
from navsim.gnss.constellations.messages import Messages, for_each, nearest
from navsim.gnss.constellations.systems import BEIDOU, GALILEO, GPS, QZSS, System

HALF_FIT = 7200.0 + 1e-3
"""A broadcast ephemeris is used within this distance of its reference time, s."""
WINDOWS = {
    GPS: (HALF_FIT, HALF_FIT),
    QZSS: (HALF_FIT, HALF_FIT),
    GALILEO: (14400.0 + 1e-3, 0.0),
    BEIDOU: (7200.0 + 1e-3, 3600.0 + 1e-3),
}
"""Validity of a system's message after and before its reference time, s. Galileo messages refer to the past and are
valid for four hours; BeiDou messages come each hour."""
TILT = np.radians(-5.0)
"""Turn about the first axis from the axes of elements of geostationary BeiDou satellites to the Earth's [4]."""


@dataclass(frozen=True)
class Elements:
    """Keplerian elements of n records, names as in [1].

    Every field (n,); angles rad, rates rad/s, times GPS s from 1980-01-06. An almanac has zeros for missing elements.
    The satellite system supplies the constants.
    """

    prn: np.ndarray
    """int."""
    healthy: np.ndarray
    """bool."""
    toe: np.ndarray
    """Reference time of the orbit."""
    toc: np.ndarray
    """Reference time of the clock."""
    sqrt_a: np.ndarray
    e: np.ndarray
    i0: np.ndarray
    omega0: np.ndarray
    omega: np.ndarray
    m0: np.ndarray
    delta_n: np.ndarray
    omega_dot: np.ndarray
    i_dot: np.ndarray
    cuc: np.ndarray
    """Harmonic corrections `c..` in rad and m."""
    cus: np.ndarray
    crc: np.ndarray
    crs: np.ndarray
    cic: np.ndarray
    cis: np.ndarray
    af0: np.ndarray
    """Clock polynomial `af0`, `af1`, `af2`."""
    af1: np.ndarray
    af2: np.ndarray
    tgd: np.ndarray
    """Group delay of the L1 signal, s, nan if unknown."""
    ura: np.ndarray
    """User range accuracy, m, -1 if missing."""
    iode: np.ndarray
    """Issues of data `iode`, `iodc`."""
    iodc: np.ndarray

    @classmethod
    def of(cls, **given: np.ndarray) -> Elements:
        """Elements with zeros in all fields not given."""
        zero = np.zeros(len(given["prn"]))
        return cls(**{f.name: np.asarray(given.get(f.name, zero)) for f in fields(cls)})

    def take(self, index: np.ndarray) -> Elements:
        """Some of the records; an index array of any shape gives fields of that shape."""
        return Elements(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def referred_to(self, toe: np.ndarray, system: System) -> Elements:
        """The same orbits and clocks with other reference times (n,), GPS s, as in a later message.

        Not for satellites with tilted axes, which are those of the reference time.
        """
        dt = toe - self.toe
        sow, new_sow = second_of_week(self.toe, system), second_of_week(toe, system)
        n = self._mean_motion(system)
        node = self.omega0 + (self.omega_dot - system.earth_rate) * dt - system.earth_rate * (sow - new_sow)
        clock = toe - self.toc
        return replace(
            self,
            toe=toe,
            toc=toe,
            m0=_wrapped(self.m0 + n * dt),
            omega0=_wrapped(node),
            i0=self.i0 + self.i_dot * dt,
            af0=self.af0 + self.af1 * clock + self.af2 * clock**2,
            af1=self.af1 + 2.0 * self.af2 * clock,
        )

    def state(self, gpst: np.ndarray, system: System) -> tuple[np.ndarray, np.ndarray]:
        """ECEF position and velocity (..., 3), m and m/s, at GPS times (...) of the fields' shape [1, 2, 4]."""
        a = self.sqrt_a**2
        tk = gpst - self.toe
        n = np.sqrt(system.gm / a**3) + self.delta_n
        eccentric = self._eccentric_anomaly(tk, system)
        sin_e, cos_e = np.sin(eccentric), np.cos(eccentric)
        rate_e = n / (1.0 - self.e * cos_e)
        root = np.sqrt(1.0 - self.e**2)
        phi = np.arctan2(root * sin_e, cos_e - self.e) + self.omega
        rate_phi = root * rate_e / (1.0 - self.e * cos_e)
        s2, c2 = np.sin(2.0 * phi), np.cos(2.0 * phi)
        u = phi + self.cus * s2 + self.cuc * c2
        rate_u = rate_phi * (1.0 + 2.0 * (self.cus * c2 - self.cuc * s2))
        r = a * (1.0 - self.e * cos_e) + self.crs * s2 + self.crc * c2
        rate_r = a * self.e * sin_e * rate_e + 2.0 * rate_phi * (self.crs * c2 - self.crc * s2)
        i = self.i0 + self.i_dot * tk + self.cis * s2 + self.cic * c2
        rate_i = self.i_dot + 2.0 * rate_phi * (self.cis * c2 - self.cic * s2)
        tilted = np.isin(self.prn, system.tilted)
        rate_node = self.omega_dot - np.where(tilted, 0.0, system.earth_rate)
        node = self.omega0 + rate_node * tk - system.earth_rate * second_of_week(self.toe, system)

        cos_u, sin_u, cos_n, sin_n = np.cos(u), np.sin(u), np.cos(node), np.sin(node)
        cos_i, sin_i = np.cos(i), np.sin(i)
        x, y = r * cos_u, r * sin_u
        rate_x = rate_r * cos_u - r * sin_u * rate_u
        rate_y = rate_r * sin_u + r * cos_u * rate_u
        ecef_x = x * cos_n - y * cos_i * sin_n
        ecef_y = x * sin_n + y * cos_i * cos_n
        tilt = rate_y * cos_i - y * sin_i * rate_i
        position = np.stack([ecef_x, ecef_y, y * sin_i], axis=-1)
        velocity = np.stack(
            [
                rate_x * cos_n - tilt * sin_n - ecef_y * rate_node,
                rate_x * sin_n + tilt * cos_n + ecef_x * rate_node,
                rate_y * sin_i + y * cos_i * rate_i,
            ],
            axis=-1,
        )
        if tilted.any():
            turn = np.where(tilted, system.earth_rate * tk, 0.0)
            level, earthly = _tilted_to_ecef(position, turn), _tilted_to_ecef(velocity, turn)
            earthly[..., 0] += system.earth_rate * level[..., 1]
            earthly[..., 1] -= system.earth_rate * level[..., 0]
            position = np.where(tilted[..., None], level, position)
            velocity = np.where(tilted[..., None], earthly, velocity)
        return position, velocity

    def clock(self, gpst: np.ndarray, system: System) -> tuple[np.ndarray, np.ndarray]:
        """Satellite clock less GPS time, s, and its rate, with the relativistic term, without the group delay [1]."""
        dt = gpst - self.toc
        eccentric = self._eccentric_anomaly(gpst - self.toe, system)
        n = self._mean_motion(system)
        relativity = -2.0 * np.sqrt(system.gm) / SPEED_OF_LIGHT**2  # F of [1], s/sqrt(m)
        amplitude = relativity * self.e * self.sqrt_a
        offset = self.af0 + self.af1 * dt + self.af2 * dt**2 + amplitude * np.sin(eccentric)
        rate_e = n / (1.0 - self.e * np.cos(eccentric))
        return offset, self.af1 + 2.0 * self.af2 * dt + amplitude * np.cos(eccentric) * rate_e

    def _mean_motion(self, system: System) -> np.ndarray:
        return np.asarray(np.sqrt(system.gm / self.sqrt_a**6) + self.delta_n)

    def _eccentric_anomaly(self, tk: np.ndarray, system: System) -> np.ndarray:
        """Kepler's equation by Newton steps; quadratic, so that six are plenty up to e = 0.5."""
        mean = self.m0 + self._mean_motion(system) * tk
        eccentric = mean + self.e * np.sin(mean)
        for _ in range(6):
            eccentric = eccentric - (eccentric - self.e * np.sin(eccentric) - mean) / (1.0 - self.e * np.cos(eccentric))
        return eccentric


def second_of_week(gpst: np.ndarray, system: System) -> np.ndarray:
    """Seconds of the week by the clock of a system, of GPS times."""
    return (gpst - timescales.BEHIND_GPS[system.time_system]) % timescales.WEEK


def _tilted_to_ecef(v: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of the tilted axes along those of the Earth, which has turned on by `turn` (...), rad [4]."""
    c, s = np.cos(TILT), np.sin(TILT)
    x, y, z = v[..., 0], c * v[..., 1] + s * v[..., 2], c * v[..., 2] - s * v[..., 1]
    c, s = np.cos(turn), np.sin(turn)
    return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)


def _wrapped(angle: np.ndarray) -> np.ndarray:
    """Angles in -pi .. pi."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@dataclass(frozen=True)
class KeplerianEphemerides:
    """Satellites that fly by sets of elements, at each time by the one of the nearest reference time.

    records: of all satellites. reach: longest after the reference time that a record is used, s; ahead: longest before
    it, as long if None. use_unhealthy: use records marked as unhealthy. A satellite without a usable record has nan.
    """

    records: Elements
    reach: float = HALF_FIT
    ahead: float | None = None
    use_unhealthy: bool = False
    system: System = GPS

    @classmethod
    def sent(cls, records: Elements, system: System) -> KeplerianEphemerides:
        """By the messages of a system, as long as they hold."""
        reach, ahead = WINDOWS[system]
        return cls(records, reach, ahead, system=system)

    @property
    def prn(self) -> np.ndarray:
        """The satellites (n,), in ascending order."""
        return np.unique(self.records.prn)

    @property
    def names(self) -> tuple[str, ...]:
        """The satellites' names, in the order of `prn`."""
        return tuple(self.system.satellite(prn) for prn in self.prn)

    @property
    def channels(self) -> Mapping[str, int]:
        """None: the elements are of systems that share a carrier."""
        return {}

    @property
    def usable(self) -> np.ndarray:
        """(n,): all, for each record has its own mark."""
        return np.ones(self.prn.size, dtype=bool)

    def chosen(self, gpst: np.ndarray) -> np.ndarray:
        """Index of the record that each satellite uses at GPS times (m, n), -1 without one."""
        usable = self.records.healthy | self.use_unhealthy
        ahead = self.reach if self.ahead is None else self.ahead
        return nearest(self.records.prn, usable, self.records.toe, self.prn, gpst, self.reach, ahead)

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last reference time of the records, GPS s."""
        return float(self.records.toe.min()), float(self.records.toe.max())

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF positions and velocities (m, n, 3), m and m/s, at GPS times (m,) or (m, n); nan without a record."""
        gpst, index = self._select(gpst)
        position, velocity = self.records.take(index).state(gpst, self.system)
        lost = index < 0
        position[lost], velocity[lost] = np.nan, np.nan
        return position, velocity

    def clock(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Satellite clocks minus GPS time for an L1 user, s, and their rates (m, n); nan without a record.

        An unknown group delay counts as zero, as in RTKLIB; readers report it.
        """
        gpst, index = self._select(gpst)
        records = self.records.take(index)
        offset, rate = records.clock(gpst, self.system)
        lost = index < 0
        delay = np.where(np.isnan(records.tgd), 0.0, records.tgd)
        return np.where(lost, np.nan, offset - delay), np.where(lost, np.nan, rate)

    def accuracy(self, gpst: np.ndarray) -> np.ndarray:
        """User range accuracies of the messages, m (m, n); nan without a record or an accuracy."""
        ura = self.records.ura[(index := self._select(gpst)[1])]
        return np.where((index < 0) | (ura <= 0.0), np.nan, ura)

    def using_unhealthy(self) -> KeplerianEphemerides:
        """Copy that also uses records marked as unhealthy."""
        return replace(self, use_unhealthy=True)

    def broadcast(self, first: float, last: float) -> KeplerianEphemerides:
        """Itself: it consists of messages."""
        return self

    def messages(self, gpst: np.ndarray) -> Messages:
        """The records that are used at GPS times (m,)."""
        used = self._select(gpst)[1]
        return Messages(vars(self.records.take(np.unique(used[used >= 0]))), exact=True)

    def _select(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gpst = for_each(gpst, self.prn.size)
        return gpst, self.chosen(gpst)


_SLOTS = (  # planes A to F: longitude of the node, arguments of latitude of the four slots, degrees [3]
    (272.847, 268.126, 161.786, 11.676, 41.806),
    (332.847, 80.956, 173.336, 309.976, 204.376),
    (32.847, 111.876, 11.796, 339.666, 241.556),
    (92.847, 135.226, 265.446, 35.156, 167.356),
    (152.847, 197.046, 302.596, 66.066, 333.686),
    (212.847, 238.886, 345.226, 105.206, 135.346),
)
_SLOTS_TIME = timescales.posix(1993, 7, 1)
_SLOTS_RADIUS = 26559.7e3
_SLOTS_INCLINATION = np.radians(55.0)
_J2, _EQUATOR = 1.08263e-3, 6378137.0


def on_circles(
    system: System, numbers: np.ndarray, radius: float, inclination: float, start: np.ndarray, epoch: float, utc: float
) -> KeplerianEphemerides:
    """Satellites on circular orbits at a UTC time (POSIX s), as one set of elements each with that reference time.

    Circular mean motion and the secular regression of the node propagate them from `epoch`, UTC (POSIX s).

    numbers (n,): of the satellites. radius: m. inclination: rad. start (n, 2): right ascension of the node and argument
    of latitude at `epoch`, degrees.
    """
    n = np.sqrt(system.gm / radius**3)
    node_rate = -1.5 * _J2 * n * (_EQUATOR / radius) ** 2 * np.cos(inclination)
    toe = np.floor(timescales.gps_from_utc(utc))
    since = float(toe - timescales.gps_from_utc(epoch))
    node, latitude = start.T
    inertial = np.radians(node) + node_rate * since
    greenwich = timescales.sidereal_angle(timescales.utc_from_gps(toe))
    count = node.size
    records = Elements.of(
        prn=numbers,
        healthy=np.ones(count, dtype=bool),
        toe=np.full(count, toe),
        toc=np.full(count, toe),
        sqrt_a=np.full(count, np.sqrt(radius)),
        i0=np.full(count, inclination),
        # the message counts the node from Greenwich at the start of the week
        omega0=(inertial - greenwich + system.earth_rate * second_of_week(toe, system)) % (2.0 * np.pi),
        m0=(np.radians(latitude) + n * since) % (2.0 * np.pi),
        omega_dot=np.full(count, node_rate),
    )
    return KeplerianEphemerides(records, reach=np.inf, system=system)


def nominal(utc: float) -> KeplerianEphemerides:
    """The baseline 24 slots of [3], reference 1993-07-01, for flights about a UTC time (POSIX s), see `on_circles`;
    G01 ... G24 by slot."""
    start = np.array([(plane[0], u) for plane in _SLOTS for u in plane[1:]])
    numbers = np.arange(1, len(start) + 1)
    return on_circles(GPS, numbers, _SLOTS_RADIUS, _SLOTS_INCLINATION, start, _SLOTS_TIME, utc)
