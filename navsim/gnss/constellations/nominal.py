"""The design constellation of each system."""

from __future__ import annotations

from collections.abc import Callable

from navsim.gnss.constellations import glonass, gps, nominal_constellations
from navsim.gnss.constellations.constellation import Constellation
from navsim.gnss.constellations.systems import BEIDOU, GALILEO, GLONASS, GPS, QZSS, System

_DESIGNED: dict[System, Callable[[float], Constellation]] = {
    GLONASS: lambda utc: glonass.Glonass24Slots(),
    GPS: gps.nominal,
    GALILEO: nominal_constellations.galileo,
    BEIDOU: nominal_constellations.beidou,
    QZSS: nominal_constellations.qzss,
}


def design(system: System, utc: float) -> Constellation:
    """A system's constellation as it was designed, for flights about a UTC time (POSIX s)."""
    return _DESIGNED[system](utc)
