"""Ridges, skylines and files of heights that hide sources and jammers: section `terrain`.

Source: `docs/theory/interference.md`, section 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from navsim.scenario.runway import Point
from navsim.scenario_files.base import DEG, Azimuth, Checksum, PairOf, Section, Signed, reject

if TYPE_CHECKING:
    import numpy as np

    from navsim.geodesy.height_grid import HeightGrid
    from navsim.gnss.interference.horizon import Terrain


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
        given = {name for name in (*ridge, *skyline, "file") if getattr(self, name, None) is not None}
        if given not in ({*ridge}, {*skyline}, {"file"}):
            or_file = " or a file" * ("file" in type(self).model_fields)
            raise reject(f"give either ends and height_m, or azimuth_deg, elevation_deg and distance_m{or_file}")
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


Reach = Annotated[float, Field(ge=1e3, le=2e5)]


class TerrainSection(RidgeSection):
    """A ridge or a skyline, or the heights of the ground in a file."""

    file: str | None = None
    """file of heights: .hgt of SRTM; with the extra `terrain` also GeoTIFF, DTED and others"""
    file_sha256: Checksum | None = None
    """checksum of the file; when given, another file is refused"""
    height_above: Literal["ellipsoid", "geoid"] | None = None
    """what the heights of the file count from; geoid: sea level, as SRTM, DTED, Copernicus and most others, which
    `runway.geoid_undulation_m` makes heights above the ellipsoid"""
    unit: Literal["m", "ft"] = "m"
    """unit of the heights of the file"""
    reach_m: Reach = 50e3
    """distance from the threshold, to each side, within which the file is used"""

    _grid: Any = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _check_file(self) -> Self:
        if self.file is None:
            usual = type(self).model_fields
            for key in ("file_sha256", "height_above", "unit", "reach_m"):
                if getattr(self, key) != usual[key].default:
                    raise reject("is for a file of heights: give `file`, or leave this out", key)
        elif self.height_above is None:
            raise reject(
                "say what the heights of the file count from: geoid (SRTM, DTED, Copernicus: sea level) or ellipsoid",
                "height_above",
            )
        return self

    def with_grid(self, grid: HeightGrid, checksum: str) -> Self:
        """Copy with the heights of its file."""
        out = self.model_copy(update={"file_sha256": checksum})
        out._grid = grid
        return out

    @property
    def grid(self) -> HeightGrid:
        """The heights of its file. Raises ValueError before they are read."""
        if self._grid is None:
            raise ValueError(f"{self.file} has not been read")
        return self._grid


def tops_of(ridges: Sequence[RidgeSection], threshold: np.ndarray) -> np.ndarray:
    """Tops (w, 2, 3), ECEF, m, of all straight parts of ridges; threshold: (3,) of the runway, rad, rad, m."""
    import numpy as np

    return np.concatenate([np.empty((0, 2, 3)), *(ridge.tops(threshold) for ridge in ridges)])


def terrain_of(sections: Sequence[RidgeSection], threshold: np.ndarray) -> Terrain:
    """Ridges and read files together; threshold: (3,) of the runway, rad, rad, m."""
    from navsim.gnss.interference.horizon import Terrain

    grids = tuple(each.grid for each in sections if isinstance(each, TerrainSection) and each.file is not None)
    return Terrain(tops_of([each for each in sections if not getattr(each, "file", None)], threshold), grids)
