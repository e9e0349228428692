"""Satellites from two-line elements, by SGP4.

The propagation is the `sgp4` package's, Vallado's own code; from its true equator and mean equinox we turn by mean
sidereal time to rotating axes (UT1 taken as UTC: within 15 arc seconds, 2 km at GNSS heights at the very worst, usually
less than 0.5 km; polar motion left out, 40 m). Good for skies, not for ranges. Elements do not tell frequency channels:
GLONASS carriers are taken as that of channel 0.

Sources: [1] Vallado et al., Revisiting Spacetrack Report 3, AIAA 2006-6753. [2] CelesTrak's files of navigation
satellites (gps-ops, glo-ops, galileo, beidou, sbas, gnss): how titles tell systems.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.core.wgs84 import RATE
from navsim.models import timescales
from navsim.models.messages import for_each

_JULIAN_1970 = 2440587.5
_PRN = re.compile(r"\(PRN\s+0*(\d{1,2})\)")
_GLONASS_NUMBER = re.compile(r"\bCOSMOS\s+\d+\s+\((\d{3})K?\)")
UNTITLED, UNKNOWN = "", "unknown"
_SYSTEMS = {
    "QZSS": r"\bQZS",
    "SBAS": r"/PRN\s*\d{3}\)|\b(WAAS|EGNOS|MSAS|GAGAN|SDCM|KASS|SBAS)\b",
    "Galileo": r"\bGSAT0\d{3}\b|\bGALILEO\b|\bGIOVE\b|\(PRN\s+E\d{2}\)",
    "BeiDou": r"\bBEIDOU\b",
    "NavIC": r"\bIRNSS\b|\bNVS-\d",
    "glonass": rf"\bGLONASS\b|{_GLONASS_NUMBER.pattern}",
    "gps": rf"\bGPS\b|\bNAVSTAR\b|{_PRN.pattern}",
}
"""Systems by what their titles have [2], the first that fits; those of navsim by navsim's names."""


def system_of(title: str) -> str:
    """The system a title tells, a key of `_SYSTEMS`, or `UNKNOWN`; `UNTITLED` where there is no title."""
    if not title:
        return UNTITLED
    return next((name for name, pattern in _SYSTEMS.items() if re.search(pattern, title.upper())), UNKNOWN)


def short_name(title: str, first: str) -> str:
    """G13 for `GPS BIIR-2  (PRN 13)`, R730 for `COSMOS 2456 (730)`, T28874 by catalogue number otherwise.

    The number of a GLONASS satellite in brackets is its own, of three digits, not the slot it stands in; slots are
    R01 to R24.
    """
    system = system_of(title)
    prn, glonass = _PRN.search(title.upper()), _GLONASS_NUMBER.search(title.upper())
    if system == "gps" and prn:
        return f"G{int(prn[1]):02d}"
    if system == "glonass" and glonass:
        return f"R{glonass[1]}"
    return f"T{first[2:7].strip():0>5}"


@dataclass(frozen=True)
class Constellation:
    """Satellites of two-line elements.

    names, titles (n,): short names, and what the file calls them. systems (n,): as of `system_of`. healthy (n,), since
    elements do not say. epochs (n,): UTC, POSIX s. satellites (n,): of the `sgp4` package. system: that of all of them,
    empty for a mixture.
    """

    names: tuple[str, ...]
    titles: tuple[str, ...]
    systems: tuple[str, ...]
    healthy: np.ndarray
    epochs: np.ndarray
    satellites: tuple[Any, ...]
    system: str = ""

    @classmethod
    def of_lines(cls, titles: list[str], first: list[str], second: list[str]) -> Constellation:
        """From titles ("" where there is none) and the lines of the elements. Raises ValueError for elements that SGP4
        cannot use."""
        from sgp4.api import Satrec

        names = tuple(short_name(title, line) for title, line in zip(titles, first, strict=True))
        satellites = tuple(Satrec.twoline2rv(a, b) for a, b in zip(first, second, strict=True))
        for name, satellite in zip(names, satellites, strict=True):
            if satellite.error:
                raise ValueError(f"{name}: SGP4 cannot use these elements (error {satellite.error})")
        epochs = np.array([(s.jdsatepoch - _JULIAN_1970 + s.jdsatepochF) * timescales.DAY for s in satellites])
        systems = tuple(system_of(title) for title in titles)
        return cls(names, tuple(titles), systems, np.ones(len(names), dtype=bool), epochs, satellites)

    def of(self, *systems: str) -> Constellation:
        """The satellites of some of the `systems`, as a constellation of the first."""
        keep = [i for i, system in enumerate(self.systems) if system in systems]
        return Constellation(
            tuple(self.names[i] for i in keep),
            tuple(self.titles[i] for i in keep),
            tuple(self.systems[i] for i in keep),
            self.healthy[keep],
            self.epochs[keep],
            tuple(self.satellites[i] for i in keep),
            systems[0],
        )

    def age(self, gpst: float) -> float:
        """Largest distance, s, of the elements' epochs from a GPS time."""
        return float(np.max(np.abs(gpst - timescales.gps_from_utc(self.epochs))))

    def state(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """ECEF positions and velocities (m, n, 3), m, m/s, at GPS times (m,) or (m, n); nan where SGP4 fails."""
        from sgp4.api import SatrecArray

        # UTC counted on from the epochs of the elements: a later leap second is no step in the motion
        utc = self.epochs + (for_each(gpst, len(self.names)) - timescales.gps_from_utc(self.epochs))
        # one time for all satellites, then along the velocity for the travel time's spread of some 10 ms
        common = np.mean(utc, axis=1)
        day = np.floor(common / timescales.DAY)
        error, p, v = SatrecArray(self.satellites).sgp4(_JULIAN_1970 + day, common / timescales.DAY - day)
        p, v = 1e3 * np.moveaxis(p, 0, 1), 1e3 * np.moveaxis(v, 0, 1)
        failed = np.moveaxis(error, 0, 1) != 0
        p[failed], v[failed] = np.nan, np.nan
        p = p + v * (utc - common[:, None])[..., None]
        angle = timescales.sidereal_angle(utc)
        c, s = np.cos(angle), np.sin(angle)

        def turned(a: np.ndarray) -> np.ndarray:
            return np.stack([c * a[..., 0] + s * a[..., 1], c * a[..., 1] - s * a[..., 0], a[..., 2]], axis=-1)

        position, velocity = turned(p), turned(v)
        velocity[..., 0] += RATE * position[..., 1]
        velocity[..., 1] -= RATE * position[..., 0]
        return position, velocity
