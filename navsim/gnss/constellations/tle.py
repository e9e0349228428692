"""Satellites from two-line elements, by SGP4.

The `sgp4` package, Vallado's own code, propagates them. Mean sidereal time rotates its true equator and mean equinox to
Earth-fixed axes. UT1 is taken as UTC: within 15 arc seconds, usually 0.5 km and at most 2 km at GNSS heights. Polar
motion is neglected, 40 m. Good for skies, not for ranges. Elements contain no frequency channels: GLONASS carriers are
those of channel 0.

Source: [1] Vallado et al., Revisiting Spacetrack Report 3, AIAA 2006-6753.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from navsim.geodesy.earth import RATE
from navsim.gnss import timescales
from navsim.gnss.constellations.constellation import WithoutMessages
from navsim.gnss.constellations.messages import for_each
from navsim.gnss.constellations.systems import NAMES, SYSTEMS, TITLES, UNKNOWN, UNTITLED, System, system_of

if TYPE_CHECKING:
    from sgp4.api import Satrec

_JULIAN_1970 = 2440587.5
_MOST_TITLES = 10
"""Satellites of a system that a message names."""


def short_name(title: str, first: str) -> str:
    """G13 for `GPS BIIR-2 (PRN 13)` and for `G13`, R730 for `COSMOS 2456 (730)`, T28874 by catalogue number otherwise.

    The number of a GLONASS satellite in brackets is its own, of three digits, not its slot; slots are R01 to R24.
    """
    told = system_of(title)
    for system in SYSTEMS:
        numbered = re.search(system.numbered, title.upper())
        if told == system.name and numbered:
            return system.letter + numbered[1].zfill(2)
        if told == system.name and (name := system.name_in(title)):
            return name
    return f"T{first[2:7].strip():0>5}"


@dataclass(frozen=True)
class TwoLineSets:
    """Two-line elements of any systems from a file."""

    names: tuple[str, ...]
    """(n,) short names."""
    titles: tuple[str, ...]
    """(n,) titles in the file."""
    lines: tuple[int, ...]
    """(n,) first line of each."""
    systems: tuple[str, ...]
    """(n,) see `system_of`."""
    epochs: np.ndarray
    """(n,) UTC, POSIX s."""
    satellites: tuple[Satrec, ...]
    """(n,) objects of the `sgp4` package."""

    @classmethod
    def of_lines(cls, titles: list[str], first: list[str], second: list[str], lines: list[int]) -> TwoLineSets:
        """From titles ("" if missing), the lines of the elements, and the line numbers.

        Raises ValueError for elements that SGP4 cannot use.
        """
        from sgp4.api import Satrec

        names = tuple(short_name(title, line) for title, line in zip(titles, first, strict=True))
        satellites = tuple(Satrec.twoline2rv(a, b) for a, b in zip(first, second, strict=True))
        for name, satellite in zip(names, satellites, strict=True):
            if satellite.error:
                raise ValueError(f"{name}: SGP4 cannot use these elements (error {satellite.error})")
        epochs = np.array([(s.jdsatepoch - _JULIAN_1970 + s.jdsatepochF) * timescales.DAY for s in satellites])
        return cls(names, tuple(titles), tuple(lines), tuple(system_of(title) for title in titles), epochs, satellites)

    def of(self, system: System, untitled: bool = False) -> TwoLineElements:
        """Satellites of a system; untitled: including those whose system is unknown."""
        wanted = (system.name, UNTITLED) if untitled else (system.name,)
        keep = [i for i, told in enumerate(self.systems) if told in wanted]
        return TwoLineElements(
            system, tuple(self.names[i] for i in keep), self.epochs[keep], tuple(self.satellites[i] for i in keep)
        )

    @property
    def strangers(self) -> tuple[str, ...]:
        """In words, whose satellites are of no system that navsim models."""
        text = []
        for told in dict.fromkeys(self.systems):
            if told not in (*NAMES, UNTITLED):
                theirs = [i for i, system in enumerate(self.systems) if system == told]
                some = ", ".join(f"{self.titles[i]} (line {self.lines[i]})" for i in theirs[:_MOST_TITLES])
                more = f" and {len(theirs) - _MOST_TITLES} more" if len(theirs) > _MOST_TITLES else ""
                if told == UNKNOWN:
                    known = "; ".join(TITLES)
                    told = f"{some}{more}; known are such as {known}"
                    text.append(f"not used, of no known system by their titles: {told}")
                else:
                    text.append(f"not used, of {told}, which navsim does not model: {some}{more}")
        return tuple(text)


@dataclass(frozen=True)
class TwoLineElements(WithoutMessages):
    """Satellites of one system by two-line elements, see `TwoLineSets`."""

    system: System
    names: tuple[str, ...]
    epochs: np.ndarray
    satellites: tuple[Satrec, ...]

    @property
    def channels(self) -> Mapping[str, int]:
        """None: elements do not contain them."""
        return {}

    @property
    def usable(self) -> np.ndarray:
        """(n,): all, for elements have no marks of health."""
        return np.ones(len(self.names), dtype=bool)

    @property
    def span(self) -> tuple[float, float] | None:
        """First and last epoch of the elements, GPS s."""
        times = timescales.gps_from_utc(self.epochs)
        return float(times.min()), float(times.max())

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

    def clock(self, gpst: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unknown (m, n): elements are of orbits alone."""
        unknown = np.full(for_each(gpst, len(self.names)).shape, np.nan)
        return unknown, unknown.copy()
