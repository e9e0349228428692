"""Ridges and skylines that hide sources and jammers: section `terrain`.

Source: `docs/theory/interference.md`, section 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import Field, model_validator

from navsim.scenario.base import DEG, Azimuth, PairOf, Section, Signed, reject
from navsim.scenario.runway import Point

if TYPE_CHECKING:
    import numpy as np


class RidgeSection(Section):
    """A straight ridge, or a skyline seen from the threshold of the runway: a knife edge between a source, or a jammer,
    and the aircraft where their path crosses it."""

    ends: PairOf[Point] | None = None
    """places that a ridge runs between"""
    height_m: Signed | None = None
    """height of the ridge's top above the runway"""
    azimuth_deg: PairOf[Azimuth] | None = None
    """azimuths of a skyline: from, to, clockwise; 350 to 10 goes through north"""
    elevation_deg: Annotated[float, Field(ge=-10.0, le=60.0)] | None = None
    """elevation up to which a skyline reaches"""
    distance_m: Annotated[float, Field(ge=1.0, le=1e5)] | None = None
    """distance of a skyline along the ground"""

    @model_validator(mode="after")
    def _check_alternatives(self) -> Self:
        ridge, skyline = ("ends", "height_m"), ("azimuth_deg", "elevation_deg", "distance_m")
        given = {name for name in (*ridge, *skyline) if getattr(self, name) is not None}
        if given not in ({*ridge}, {*skyline}):
            raise reject("give either ends and height_m, or azimuth_deg, elevation_deg and distance_m")
        if self.ends is not None and self.ends[0] == self.ends[1]:
            raise reject("a ridge needs two positions", "ends")
        if self.azimuth_deg is not None and self.azimuth_deg[0] == self.azimuth_deg[1]:
            raise reject("a skyline needs two azimuths; all around is from 0 to 360", "azimuth_deg")
        return self

    def tops(self, threshold: np.ndarray) -> np.ndarray:
        """Tops (w, 2, 3), ECEF, m, of its straight parts; threshold: (3,) of the runway, rad, rad, m."""
        import numpy as np

        from navsim.gnss.interference.horizon import ridge, skyline

        if self.ends is not None:
            assert self.height_m is not None
            return ridge(np.array([end.radians for end in self.ends]), threshold[2] + self.height_m)
        assert self.azimuth_deg is not None
        assert self.elevation_deg is not None
        assert self.distance_m is not None
        first, last = self.azimuth_deg
        return skyline(threshold, (first * DEG, last * DEG), self.elevation_deg * DEG, self.distance_m)


def tops_of(ridges: Sequence[RidgeSection], threshold: np.ndarray) -> np.ndarray:
    """Tops (w, 2, 3), ECEF, m, of all straight parts of ridges; threshold: (3,) of the runway, rad, rad, m."""
    import numpy as np

    return np.concatenate([np.empty((0, 2, 3)), *(ridge.tops(threshold) for ridge in ridges)])
