"""Errors of the corrections of a GBAS ground station, by its ground accuracy designator.

Source: ICAO Annex 10, volume I, appendix B, 3.6.7.1.1, tables B-74 (GPS) and B-75 (GLONASS);
`docs/theory/integrity.md`, section 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from navsim.gnss.constellations.systems import GLONASS, GPS

Designator = Literal["A", "B", "C"]
_Row = tuple[float, float, float, float, float]
TABLES: dict[str, dict[Designator, tuple[_Row, ...]]] = {
    GPS.name: {
        "A": ((0.0, 0.5, 1.65, 14.3, 0.08),),
        "B": ((0.0, 0.16, 1.07, 15.5, 0.08),),
        "C": ((0.0, 0.24, 0.0, 15.5, 0.04), (35.0, 0.15, 0.84, 15.5, 0.04)),
    },
    GLONASS.name: {
        "A": ((0.0, 1.58, 5.18, 14.3, 0.078),),
        "B": ((0.0, 0.3, 2.12, 15.5, 0.078),),
        "C": ((0.0, 0.48, 0.0, 15.5, 0.042), (35.0, 0.3, 1.68, 15.5, 0.042)),
    },
}
"""Elevation above which a row holds, deg; a0, a1, m; theta0, deg; a2, m; of each system and designator."""
_LOWEST = 5.0
"""Elevation below which the tables have nothing, deg: lower satellites have the errors of this one."""
STATION = "ground_station"
"""Name of this kind of error."""


@dataclass(frozen=True)
class GroundStationError:
    """Error of the corrections for each satellite: the mean error of the station's reference receivers, and a part that
    they have in common. receivers: their number; time: correlation time, s."""

    receivers: int
    designator: Designator
    time: float
    name: str = STATION

    @property
    def sigma(self) -> float:
        """1 sigma for a satellite of GPS at the zenith, m."""
        return float(self.at(np.array([[0.5 * np.pi]]), (GPS.name,))[0, 0])

    def of_receiver(self, elevation: np.ndarray, systems: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """1 sigma (e, s), m, of a reference receiver's own error, and of the common part.

        elevation: (e, s) rad; systems: of the satellites (s,); zero for those without a table.
        """
        own, common = np.zeros(elevation.shape), np.zeros(elevation.shape)
        angle = np.maximum(np.degrees(elevation), _LOWEST)
        for i, system in enumerate(systems):
            for above, a0, a1, scale, a2 in TABLES[system][self.designator] if system in TABLES else ():
                there = angle[:, i] > above
                own[there, i], common[there, i] = a0 + a1 * np.exp(-angle[there, i] / scale), a2
        return own, common

    def at(self, elevation: np.ndarray, systems: Sequence[str]) -> np.ndarray:
        """1 sigma of the corrections (e, s), m, the largest that the tables allow; arguments as of `of_receiver`."""
        own, common = self.of_receiver(elevation, systems)
        return np.sqrt(own**2 / self.receivers + common**2)
