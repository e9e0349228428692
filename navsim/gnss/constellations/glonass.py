"""GLONASS orbits from almanac elements, and the nominal constellation.

Sources:

- [1] GLONASS ICD, navigational radiosignal in bands L1, L2, edition 5.1 (2008), appendix 3, section A.3.2 (position of
  a satellite from the almanac), and ICD General description of the CDMA system (2016), appendix P (the same with other
  mean values).
- [2] ICD 5.1, section 3.3.2 (orbit structure).
- [3] PZ-90.11 reference document (2014): constants of the Earth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from navsim.gnss import timescales
from navsim.gnss.constellations.glonass_broadcast import StateVectorEphemerides, sent_by, would_send
from navsim.gnss.constellations.messages import Messages, for_each
from navsim.gnss.constellations.systems import GLONASS

A_E = 6378136.0
"""Equatorial radius, m [1]."""
J20 = 1.0826257e-3
"""Second zonal harmonic [1]."""
MOSCOW_MINUS_UTC = 10800.0
"""s; the GLONASS control centre keeps UTC + 3 h."""
DAY = 86400.0

FDMA_MEAN_PERIOD, FDMA_MEAN_INCLINATION = 43200.0, np.radians(63.0)
"""Mean draconic period (s) and inclination (rad) the broadcast FDMA almanac and `.agl` files refer to [1]."""

_PLANES = 3
"""Orbital planes of the design constellation [2]."""
_NOMINAL_RADIUS = 25_508_000.0
_NOMINAL_INCLINATION = np.radians(64.8)
_PHASE_TIME = float(timescales.gps_from_utc(17787 * DAY))
_PHASE_LATITUDE_ARGUMENT, _PHASE_NODE_LONGITUDE = 5.4, 177.2
"""Argument of latitude of slot 1 and longitude of the node of plane 1, degrees, at `_PHASE_TIME`."""


_CHANNELS = (1, -4, 5, 6, 1, -4, 5, 6, -2, -7, 0, -1, -2, -7, 0, -1, 4, -3, 3, 2, 4, -3, 3, 2)
"""Frequency channels by slot, shared by satellites on opposite sides of the Earth, as of 2018."""


class _Slots:
    """Satellites by their orbital slots."""

    slot: np.ndarray
    channel: np.ndarray
    system = GLONASS

    @property
    def names(self) -> tuple[str, ...]:
        """R01, R02, ... of `slot`."""
        return tuple(self.system.satellite(slot) for slot in self.slot)

    @property
    def channels(self) -> Mapping[str, int]:
        """Frequency channels by name."""
        return dict(zip(self.names, self.channel.tolist(), strict=True))

    def accuracy(self, gpst: np.ndarray) -> np.ndarray:
        """Unknown (m, n): neither almanacs nor designs contain it."""
        return np.full(for_each(gpst, self.slot.size).shape, np.nan)


@dataclass(frozen=True)
class GlonassAlmanac(_Slots):
    """Almanac of n satellites; every array (n,), angles rad, times s."""

    slot: np.ndarray
    """Orbital slot number."""
    healthy: np.ndarray
    """bool."""
    day: np.ndarray
    """Day of the almanac in Moscow time, days from 1970-01-01."""
    node_time: np.ndarray
    """t_lambda, time of the ascending node on that day, s, Moscow time."""
    node_longitude: np.ndarray
    """lambda."""
    inclination: np.ndarray
    """Absolute, not the correction."""
    perigee: np.ndarray
    """Argument omega."""
    eccentricity: np.ndarray
    period: np.ndarray
    """Draconic."""
    period_rate: np.ndarray
    """Change of the period per orbit."""
    channel: np.ndarray
    """Frequency channel, int."""
    use_unhealthy: bool = False
    """Use satellites that are not healthy."""

    @property
    def usable(self) -> np.ndarray:
        """(n,): those that are healthy, or all."""
        return self.healthy | self.use_unhealthy

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last GPS time of the almanac, s."""
        return float(self._node_gpst.min()), float(self._node_gpst.max())

    @property
    def _node_gpst(self) -> np.ndarray:
        """Times of the ascending nodes, GPS s."""
        return timescales.gps_from_utc(self.day * DAY + self.node_time - MOSCOW_MINUS_UTC)

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF positions and velocities (m, n, 3), m and m/s, rotating axes, at GPS times (m,) or (m, n).

        Follows the ICD algorithm, short-period J2 terms included.
        """
        gpst = for_each(gpst, self.slot.size)
        e, i, perigee = self.eccentricity, self.inclination, self.perigee
        sin_i, cos_i = np.sin(i), np.cos(i)

        # complete orbits since the node of the almanac, and the time of the present orbit's node [1]
        elapsed = gpst - self._node_gpst
        orbit = np.floor(elapsed / self.period)
        since_node = elapsed - self.period * orbit - self.period_rate * orbit**2
        draconic = self.period + (2.0 * orbit + 1.0) * self.period_rate
        n = 2.0 * np.pi / draconic

        a = _semi_major_axis(draconic, sin_i**2, e, perigee)
        ratio2 = (A_E / (a * (1.0 - e**2))) ** 2
        node_rate = -1.5 * J20 * n * ratio2 * cos_i
        perigee_rate = 0.75 * J20 * n * ratio2 * (5.0 * cos_i**2 - 1.0)
        node = self.node_longitude + (node_rate - GLONASS.earth_rate) * elapsed
        perigee = perigee + perigee_rate * elapsed

        eccentric = -2.0 * np.arctan(np.sqrt((1.0 - e) / (1.0 + e)) * np.tan(0.5 * perigee))
        mean_at_node = perigee + eccentric - e * np.sin(eccentric)
        mean = mean_at_node + n * since_node
        h, l = e * np.sin(perigee), e * np.cos(perigee)
        before = _short_period(a, i, h, l, mean_at_node)
        after = _short_period(a, i, h, l, mean)
        da, dh, dl, dnode, di, dmean = (y - x for x, y in zip(before, after, strict=True))

        a = a * (1.0 + da)
        h, l = h + dh, l + dl
        e = np.hypot(h, l)
        perigee = np.arctan2(h, l)
        mean = mean + dmean
        i = i + di
        node = node + dnode
        return _to_ecef(a, e, i, node, perigee, mean - perigee)

    def clock(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unknown (m, n): the clocks of almanacs are not read."""
        unknown = np.full(for_each(gpst, self.slot.size).shape, np.nan)
        return unknown, unknown.copy()

    def using_unhealthy(self) -> GlonassAlmanac:
        """Copy that also uses unhealthy satellites."""
        return replace(self, use_unhealthy=True)

    def broadcast(self, first: float, last: float) -> StateVectorEphemerides:
        """By state vectors with perfect clocks."""
        return sent_by(self, first, last)

    def messages(self, gpst: np.ndarray) -> Messages | None:
        """Simulated messages for GPS times (m,), with perfect clocks."""
        return would_send(self, gpst)


@dataclass(frozen=True)
class Glonass24Slots(_Slots):
    """The design constellation: 24 satellites on circles of 25 508 km radius at 64.8 degrees, in three planes 120
    degrees apart, eight a plane 45 degrees apart, shifted 15 degrees from plane to plane [2].

    Its phase is that of the real system on 2018-09-13, 00:00 UTC (mean of that day's almanac, 3 degrees);
    from there it moves with the circular mean motion and the secular regression of the node.
    """

    slot: np.ndarray = field(default_factory=lambda: np.arange(1, GLONASS.slots + 1))
    healthy: np.ndarray = field(default_factory=lambda: np.ones(GLONASS.slots, dtype=bool))
    channel: np.ndarray = field(default_factory=lambda: np.array(_CHANNELS))

    @property
    def usable(self) -> np.ndarray:
        """(n,): all."""
        return self.healthy

    @property
    def span(self) -> tuple[float, float] | None:
        """None: a design does not age."""
        return None

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF positions and velocities, (m, 24, 3), at GPS times (m,) or (m, 24); see `GlonassAlmanac.state`."""
        gpst = for_each(gpst, self.slot.size)
        plane, place = np.divmod(np.arange(GLONASS.slots), GLONASS.slots // _PLANES)
        since = gpst - _PHASE_TIME
        n = np.sqrt(GLONASS.gm / _NOMINAL_RADIUS**3)
        node_rate = -1.5 * J20 * n * (A_E / _NOMINAL_RADIUS) ** 2 * np.cos(_NOMINAL_INCLINATION)
        u = np.radians(_PHASE_LATITUDE_ARGUMENT + 15.0 * plane - 45.0 * place) + n * since
        node = np.radians(_PHASE_NODE_LONGITUDE + 120.0 * plane) + (node_rate - GLONASS.earth_rate) * since
        zero = np.zeros_like(u)
        position, velocity = _to_ecef(zero + _NOMINAL_RADIUS, zero, zero + _NOMINAL_INCLINATION, node, zero, u)
        # the planes turn with the secular regression: 0.15 m/s
        velocity[..., 0] -= node_rate * position[..., 1]
        velocity[..., 1] += node_rate * position[..., 0]
        return position, velocity

    def clock(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Perfect (m, n): zeros."""
        shape = for_each(gpst, self.slot.size).shape
        return np.zeros(shape), np.zeros(shape)

    def using_unhealthy(self) -> Glonass24Slots:
        """Itself: all are healthy."""
        return self

    def broadcast(self, first: float, last: float) -> StateVectorEphemerides:
        """By state vectors with perfect clocks."""
        return sent_by(self, first, last)

    def messages(self, gpst: np.ndarray) -> Messages | None:
        """Simulated messages for GPS times (m,), with perfect clocks."""
        return would_send(self, gpst)


def _semi_major_axis(draconic: np.ndarray, sin2_i: np.ndarray, e: np.ndarray, perigee: np.ndarray) -> np.ndarray:
    """Semi-major axis (m) whose osculating period matches the draconic one [1], by iteration."""
    period = draconic
    cos_p = np.cos(perigee)
    for _ in range(20):
        a = np.cbrt((period / (2.0 * np.pi)) ** 2 * GLONASS.gm)
        ratio2 = (A_E / (a * (1.0 - e**2))) ** 2
        bracket = (2.0 - 2.5 * sin2_i) * (1.0 - e**2) ** 1.5 / (1.0 + e * cos_p) ** 2
        bracket = bracket + (1.0 + e * cos_p) ** 3 / (1.0 - e**2)
        update = draconic / (1.0 - 1.5 * J20 * ratio2 * bracket)
        if np.max(np.abs(update - period)) < 1e-9:
            break
        period = update
    return a


def _short_period(a, i, h, l, u):  # type: ignore[no-untyped-def]
    """Short-period J2 changes of a (relative), h, l, node, i and the mean argument of latitude u [1]."""
    k = 1.5 * J20 * (A_E / a) ** 2
    s2, c2 = np.sin(i) ** 2, np.cos(i) ** 2
    q = 1.0 - 1.5 * s2
    sin, cos = np.sin, np.cos
    da = 2.0 * k * q * (l * cos(u) + h * sin(u)) + k * s2 * (
        0.5 * h * sin(u) - 0.5 * l * cos(u) + cos(2 * u) + 3.5 * l * cos(3 * u) + 3.5 * h * sin(3 * u)
    )
    dh = (
        k * q * (sin(u) + 1.5 * l * sin(2 * u) - 1.5 * h * cos(2 * u))
        - 0.25
        * k
        * s2
        * (
            sin(u)
            - 7.0 / 3.0 * sin(3 * u)
            + 5.0 * l * sin(2 * u)
            - 8.5 * l * sin(4 * u)
            + 8.5 * h * cos(4 * u)
            + h * cos(2 * u)
        )
        - 0.5 * k * c2 * l * sin(2 * u)
    )
    dl = (
        k * q * (cos(u) + 1.5 * l * cos(2 * u) + 1.5 * h * sin(2 * u))
        - 0.25
        * k
        * s2
        * (
            -cos(u)
            - 7.0 / 3.0 * cos(3 * u)
            - 5.0 * h * sin(2 * u)
            - 8.5 * l * cos(4 * u)
            - 8.5 * h * sin(4 * u)
            + l * cos(2 * u)
        )
        + 0.5 * k * c2 * h * sin(2 * u)
    )
    periodic = (
        3.5 * l * sin(u) - 2.5 * h * cos(u) - 0.5 * sin(2 * u) - 7.0 / 6.0 * l * sin(3 * u) + 7.0 / 6.0 * h * cos(3 * u)
    )
    dnode = -k * np.cos(i) * periodic
    di = (
        0.5
        * k
        * np.sin(i)
        * np.cos(i)
        * (-l * cos(u) + h * sin(u) + cos(2 * u) + 7.0 / 3.0 * l * cos(3 * u) + 7.0 / 3.0 * h * sin(3 * u))
    )
    du = (
        2.0 * k * q * (1.75 * l * sin(u) - 1.75 * h * cos(u))
        + 3.0
        * k
        * s2
        * (
            -7.0 / 24.0 * h * cos(u)
            - 7.0 / 24.0 * l * sin(u)
            - 49.0 / 72.0 * h * cos(3 * u)
            + 49.0 / 72.0 * l * sin(3 * u)
            + 0.25 * sin(2 * u)
        )
        + k * c2 * periodic
    )
    return da, dh, dl, dnode, di, du


def _to_ecef(a, e, i, node, perigee, anomaly):  # type: ignore[no-untyped-def]
    """Osculating elements, the node counted from Greenwich, to position and velocity in ECEF [1]."""
    eccentric = anomaly
    for _ in range(12):
        step = (eccentric - e * np.sin(eccentric) - anomaly) / (1.0 - e * np.cos(eccentric))
        if not step.any():  # on a circle at once
            break
        eccentric = eccentric - step
    true = 2.0 * np.arctan(np.sqrt((1.0 + e) / (1.0 - e)) * np.tan(0.5 * eccentric))
    u = true + perigee
    radius = a * (1.0 - e * np.cos(eccentric))
    root = np.sqrt(GLONASS.gm / a) / np.sqrt(1.0 - e**2)
    radial = root * e * np.sin(true)
    transverse = root * (1.0 + e * np.cos(true))
    cu, su, cn, sn, ci, si = np.cos(u), np.sin(u), np.cos(node), np.sin(node), np.cos(i), np.sin(i)
    outward = np.stack([cu * cn - su * sn * ci, cu * sn + su * cn * ci, su * si], axis=-1)
    forward = np.stack([-su * cn - cu * sn * ci, -su * sn + cu * cn * ci, cu * si], axis=-1)
    position = radius[..., None] * outward
    velocity = radial[..., None] * outward + transverse[..., None] * forward
    velocity[..., 0] += GLONASS.earth_rate * position[..., 1]
    velocity[..., 1] -= GLONASS.earth_rate * position[..., 0]
    return position, velocity
