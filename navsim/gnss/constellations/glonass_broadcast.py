"""GLONASS satellites from broadcast state vectors: Runge-Kutta orbits, clocks, PZ-90.11, lunisolar accelerations.

Sources:

- [1] GLONASS ICD, navigational radiosignal in bands L1, L2, edition 5.1 (2008), section 4.4 (immediate information) and
  appendix 3.
- [2] Parametry Zemli 1990 (PZ-90.11), reference document (2014), table of transformations (PZ-90.11 to ITRF2008).
- [3] GLONASS ICD, general description of CDMA signals (2016), appendix J (positions of Moon and Sun).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np

from navsim.gnss import timescales
from navsim.gnss.constellations.messages import Messages, for_each, nearest
from navsim.gnss.constellations.systems import GLONASS

STEP = 60.0
"""Length of an integration step, s: a state 15 minutes away is then good to 1e-3 m."""
HALF_INTERVAL = 900.5 + 1e-3
"""State vectors hold for 15 minutes on both sides of their time [1], s; across a leap second two are half a second
farther from their middle."""

_MAS = np.pi / (180.0 * 3600.0 * 1000.0)
_TO_ITRF_SHIFT = np.array([-0.003, -0.001, 0.000])
_TO_ITRF_TURN = np.array([0.019, -0.042, 0.002]) * _MAS
"""PZ-90.11 to ITRF2008: metres and rotations [2]; WGS 84 (G1674 and later) is ITRF2008 within a centimetre."""


def itrf_from_pz90(position: np.ndarray) -> np.ndarray:
    """Positions (..., 3), m, of PZ-90.11 in ITRF2008 (WGS 84) [2]."""
    return position + _TO_ITRF_SHIFT - np.cross(_TO_ITRF_TURN, position)


def pz90_from_itrf(position: np.ndarray) -> np.ndarray:
    """Positions (..., 3), m, of ITRF2008 (WGS 84) in PZ-90.11; the inverse of `itrf_from_pz90` to 1e-8 m."""
    return position - _TO_ITRF_SHIFT + np.cross(_TO_ITRF_TURN, position)


@dataclass(frozen=True)
class StateVectors:
    """Immediate information of n records [1]."""

    slot: np.ndarray
    """int."""
    channel: np.ndarray
    """int."""
    healthy: np.ndarray
    """bool."""
    time: np.ndarray
    """t_b of the record, UTC (POSIX s)."""
    position: np.ndarray
    """(n, 3) PZ-90 rotating axes, m."""
    velocity: np.ndarray
    """(n, 3) m/s."""
    acceleration: np.ndarray
    """(n, 3) lunisolar only, m/s2."""
    tau: np.ndarray
    """tau_n, correction of the satellite clock, s."""
    gamma: np.ndarray
    """Relative frequency offset."""
    age: np.ndarray
    """Days."""

    def take(self, index: np.ndarray) -> StateVectors:
        """Some of the records."""
        return StateVectors(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


@dataclass(frozen=True)
class StateVectorEphemerides:
    """GLONASS satellites that fly by broadcast state vectors, at each time by the nearest one.

    reach: farthest from its time that a state vector is used, s. A satellite without a usable one has nan.
    """

    records: StateVectors
    reach: float = HALF_INTERVAL
    use_unhealthy: bool = False

    system = GLONASS

    @property
    def slot(self) -> np.ndarray:
        """The satellites (n,), in ascending order."""
        return np.unique(self.records.slot)

    @property
    def names(self) -> tuple[str, ...]:
        """R01, R02, ... of `slot`."""
        return tuple(self.system.satellite(slot) for slot in self.slot)

    @property
    def channels(self) -> Mapping[str, int]:
        """Frequency channels by name."""
        _, first = np.unique(self.records.slot, return_index=True)
        return dict(zip(self.names, self.records.channel[first].tolist(), strict=True))

    @property
    def usable(self) -> np.ndarray:
        """(n,): all, for each record has its own mark."""
        return np.ones(self.slot.size, dtype=bool)

    def chosen(self, gpst: np.ndarray) -> np.ndarray:
        """Index of the record that each satellite uses at GPS times (m, n), -1 without one."""
        usable = self.records.healthy | self.use_unhealthy
        return nearest(self.records.slot, usable, self._time, self.slot, gpst, self.reach, self.reach)

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last GPS time of the records, s."""
        return float(self._time.min()), float(self._time.max())

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF (ITRF) positions and velocities (m, n, 3), m, m/s, at GPS times (m,) or (m, n); nan without a record."""
        # compiled code only when something is really computed
        from navsim.gnss.constellations.glonass_integration import glonass_states

        gpst, index = self._select(gpst)
        records = self.records.take(index.ravel())
        interval = np.where(index < 0, np.nan, gpst - self._time[index])
        start = np.concatenate([records.position, records.velocity], axis=1)
        out = np.empty_like(start)
        glonass_states(start, np.ascontiguousarray(records.acceleration), interval.ravel(), STEP, out)
        return itrf_from_pz90(out[:, :3].reshape(*gpst.shape, 3)), out[:, 3:].reshape(*gpst.shape, 3)

    def clock(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Satellite clocks less GLONASS time, s, and their rates (m, n); nan without a record. Relativity is within the
        message's own gamma and tau [1]."""
        gpst, index = self._select(gpst)
        lost = index < 0
        tau, gamma = self.records.tau[index], self.records.gamma[index]
        offset = -tau + gamma * (gpst - self._time[index])
        return np.where(lost, np.nan, offset), np.where(lost, np.nan, gamma)

    def accuracy(self, gpst: np.ndarray) -> np.ndarray:
        """Unknown (m, n): the reader ignores the accuracy in messages."""
        return np.full(for_each(gpst, self.slot.size).shape, np.nan)

    def using_unhealthy(self) -> StateVectorEphemerides:
        """Copy that also uses records marked as unhealthy."""
        return replace(self, use_unhealthy=True)

    def broadcast(self, first: float, last: float) -> StateVectorEphemerides:
        """Itself: it consists of broadcast messages."""
        return self

    def messages(self, gpst: np.ndarray) -> Messages:
        """The records that are used at GPS times (m,)."""
        used = self._select(gpst)[1]
        return Messages(vars(self.records.take(np.unique(used[used >= 0]))), exact=True)

    @property
    def _time(self) -> np.ndarray:
        """Times of the records, GPS s."""
        return timescales.gps_from_utc(self.records.time)

    def _select(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        gpst = for_each(gpst, self.slot.size)
        return gpst, self.chosen(gpst)


class Slotted(Protocol):
    """Satellites whose slots (n,), marks of health (n,), frequency channels (n,) and states are known."""

    @property
    def slot(self) -> np.ndarray: ...
    @property
    def healthy(self) -> np.ndarray: ...
    @property
    def channel(self) -> np.ndarray: ...
    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...


def sent_by(satellites: Slotted, first: float, last: float, spacing: float = 1800.0) -> StateVectorEphemerides:
    """Simulated broadcast of satellites: states, lunisolar accelerations, and perfect clocks.

    Of all multiples of `spacing` (s of the day, UTC) that are needed from `first` to `last` (UTC, POSIX s).
    """
    times = np.arange(round(first / spacing), round(last / spacing) + 1) * spacing
    position, velocity = satellites.state(timescales.gps_from_utc(times))
    count, n = position.shape[:2]
    time = np.repeat(times, n)
    extra = lunisolar(time, position.reshape(-1, 3))
    zero = np.zeros(count * n)
    records = StateVectors(
        slot=np.tile(satellites.slot, count),
        channel=np.tile(satellites.channel, count),
        healthy=np.tile(satellites.healthy, count),
        time=time,
        position=pz90_from_itrf(position.reshape(-1, 3)),
        velocity=velocity.reshape(-1, 3),
        acceleration=extra,
        tau=zero,
        gamma=zero,
        age=zero,
    )
    return StateVectorEphemerides(records)


def would_send(satellites: Slotted, gpst: np.ndarray) -> Messages | None:
    """Simulated messages, for GPS times (m,), of satellites with other orbit data; None for no times."""
    if not gpst.size:
        return None
    sent = sent_by(satellites, *timescales.utc_from_gps(gpst[[0, -1]]))
    return Messages(vars(sent.records), exact=False)


_GM_MOON, _GM_SUN = 4902.799e9, 132712440.0e12
_MOON_AXIS, _MOON_E, _MOON_TILT = 3.84385243e8, 0.054900489, 0.0898041080
_SUN_AXIS, _SUN_E = 1.49598e11, 0.016719


def lunisolar(utc: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Accelerations of satellites by Moon and Sun relative to the Earth's own, in rotating axes, m/s2 (n, 3) [3].

    utc: (n,) POSIX s. position: (n, 3) ECEF, m.
    """
    t = (np.asarray(utc) - 946728000.0) / (timescales.DAY * 36525.0)
    obliquity = 0.4090926006 - 0.0002270711 * t
    node = 2.1824391966 - 33.7570459536 * t
    moon_perigee = 1.4547885346 + 71.0176852437 * t
    moon_anomaly = 2.3555557435 + 8328.6914257190 * t + 0.0001545547 * t**2
    sun_anomaly = 6.2400601269 + 628.3019551714 * t - 0.0000026820 * t**2
    sun_perigee = -7.6281824375 + 0.0300101976 * t + 0.0000079741 * t**2
    angle = timescales.sidereal_angle(utc)
    total = np.zeros_like(position)
    for gm, axis, e, anomaly, perigee, tilt in (
        (_GM_MOON, _MOON_AXIS, _MOON_E, moon_anomaly, moon_perigee - node, _MOON_TILT),
        (_GM_SUN, _SUN_AXIS, _SUN_E, sun_anomaly, sun_perigee, 0.0),
    ):
        eccentric = anomaly
        for _ in range(6):
            eccentric = anomaly + e * np.sin(eccentric)
        x, y = axis * (np.cos(eccentric) - e), axis * np.sqrt(1.0 - e**2) * np.sin(eccentric)
        body = np.stack([x, y, np.zeros_like(x)], axis=-1)
        body = _turn(body, perigee, 2)
        if tilt:
            body = _turn(_turn(body, np.full_like(x, tilt), 0), node, 2)
        body = _turn(_turn(body, obliquity, 0), -angle, 2)
        offset = body - position
        total += gm * (
            offset / np.linalg.norm(offset, axis=-1, keepdims=True) ** 3
            - body / np.linalg.norm(body, axis=-1, keepdims=True) ** 3
        )
    return total


def _turn(v: np.ndarray, angle: np.ndarray, axis: int) -> np.ndarray:
    """Vectors (n, 3) turned by angles (n,) about a coordinate axis, right-handed."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = v.copy()
    out[:, i] = c * v[:, i] - s * v[:, j]
    out[:, j] = s * v[:, i] + c * v[:, j]
    return out
