"""Height files: heights of the ground at the points of a grid.

SRTM's .hgt files are read as they are; GeoTIFF, DTED and others through rasterio, which the extra `terrain` has.

Sources: [1] NASA/USGS, SRTM data users' guide (.hgt: big-endian integers of 16 bits, rows from north to south, named by
the south-western corner; -32768 is a void).
"""

from __future__ import annotations

import importlib
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from navsim.formats.text import FileError
from navsim.geodesy.earth import FOOT
from navsim.geodesy.height_grid import HeightGrid
from navsim.results import files

MOST = 40_000_000
"""Points that are kept of a file."""
_VOID = -32768
_LOWEST, _HIGHEST = -500.0, 9000.0
"""Heights of the ground beyond which a number is a void that the file does not declare, m."""
_CORNER = re.compile(r"([NS])(\d{2})([EW])(\d{3})", re.IGNORECASE)
_SIDES = (1201, 3601)
"""Points along the side of a tile [1]."""


@dataclass(frozen=True)
class Box:
    """Part of the Earth, rad; west may be greater than east."""

    south: float
    north: float
    west: float
    east: float

    @classmethod
    def about(cls, place: np.ndarray, reach: float) -> Box:
        """The box that reaches so far, m, to all sides of a place, rad."""
        high = reach / 6.35e6
        wide = min(high / max(math.cos(abs(place[0]) + high), 0.01), 1.0)
        return cls(place[0] - high, place[0] + high, place[1] - wide, place[1] + wide)


def read_heights(path: Path, box: Box, unit: str, above: str) -> HeightGrid:
    """The heights of a file within a box, m, above what the file counts from; nan where it has none.

    unit: of the file, `m` or `ft`. above: `geoid` or `ellipsoid`, as the file's own words must not contradict. Raises
    FileError, and OSError where the file cannot be read.
    """
    if path.suffix.lower() == ".hgt":
        return _read_hgt(path, box, unit)
    with files.open_regular(path):  # its errors are those of other files
        pass
    return _read_raster(path, box, unit, above)


def _read_hgt(path: Path, box: Box, unit: str) -> HeightGrid:
    """A tile of SRTM [1]."""
    named = _CORNER.match(path.name)
    if named is None:
        raise FileError(0, "its name does not begin with its south-western corner, such as N56E037", path)
    if unit != "m":
        raise FileError(0, "heights of .hgt files are in metres: leave `unit` out", path)
    data = files.content(path, 2 * _SIDES[-1] ** 2)
    side = math.isqrt(len(data) // 2)
    if side not in _SIDES or len(data) != 2 * side * side:
        raise FileError(0, f"has {len(data)} bytes; tiles have {' or '.join(str(2 * n * n) for n in _SIDES)}", path)
    south = float(named[2]) * (1.0 if named[1] in "Nn" else -1.0)
    west = float(named[4]) * (1.0 if named[3] in "Ee" else -1.0)
    step = math.radians(1.0 / (side - 1))
    rows, columns = _window(path, box, (math.radians(south + 1.0), math.radians(west)), (step, step), (side, side))
    part = np.frombuffer(data, ">i2").reshape(side, side)[rows, columns]
    height = np.where(part == _VOID, np.float32(np.nan), part.astype(np.float32))
    return _grid(path, (math.radians(south + 1.0), math.radians(west)), (step, step), (rows, columns), height)


def _read_raster(path: Path, box: Box, unit: str, above: str) -> HeightGrid:
    """A file of any format that rasterio knows."""
    rasterio: Any
    try:
        rasterio = importlib.import_module("rasterio")
    except ImportError:
        raise FileError(
            0, "needs the extra `terrain` (pip install '.[terrain]' in the folder of navsim), without which .hgt files "
            "are read alone", path,
        ) from None  # fmt: skip
    try:
        with rasterio.open(path) as raw:
            _check_raster(path, raw, unit, above)
            wgs84 = rasterio.crs.CRS.from_epsg(4326)
            turn = raw.transform
            if raw.crs == wgs84 and turn.b == turn.d == 0.0 and turn.a > 0.0 > turn.e:
                return _read_band(path, raw, box, unit)
            # what is beside a file that declares no void would be 0 m high
            how = {"crs": wgs84, "resampling": rasterio.enums.Resampling.bilinear, "nodata": math.nan}
            with rasterio.vrt.WarpedVRT(raw, dtype="float32", **how) as turned:
                return _read_band(path, turned, box, unit)
    except rasterio.errors.RasterioError as error:
        raise FileError(0, f"is no file of heights that rasterio reads: {error}", path) from None


def _check_raster(path: Path, raw: Any, unit: str, above: str) -> None:
    """Raise FileError for a file that has no heights, or others than the scenario says."""
    if raw.count != 1:
        raise FileError(0, f"has {raw.count} bands; a file of heights has one", path)
    if raw.crs is None:
        raise FileError(0, "does not say its coordinate system; give it one: gdal_translate -a_srs EPSG:4326", path)
    text = raw.crs.to_wkt()
    vertical = text[at:] if (at := max(text.find("VERT_CS["), text.find("VERTCRS["))) >= 0 else ""
    if vertical and "ellipsoid" not in vertical.lower() and above == "ellipsoid":
        name = vertical.split('"')[1]
        raise FileError(0, f"says that its heights are above {name}: write height_above: geoid", path)
    said = f"{raw.units[0] or ''} {vertical}".lower()
    if unit == "m" and ("foot" in said or "feet" in said or re.search(r"\bft", said)):
        raise FileError(0, "says that its heights are in feet: write unit: ft", path)
    if unit == "ft" and re.fullmatch(r"m|met(re|er)s?", (raw.units[0] or "").strip().lower()):
        raise FileError(0, "says that its heights are in metres: leave `unit` out", path)


def _read_band(path: Path, raw: Any, box: Box, unit: str) -> HeightGrid:
    """The heights of an open file in latitudes and longitudes."""
    turn = raw.transform
    step = math.radians(-turn.e), math.radians(turn.a)
    corner = math.radians(turn.f) - 0.5 * step[0], math.radians(turn.c) + 0.5 * step[1]
    rows, columns = _window(path, box, corner, step, (raw.height, raw.width))
    window = ((rows.start, rows.stop), (columns.start, columns.stop))
    read = raw.read(1, window=window, masked=True)
    scale = raw.scales[0] * (FOOT if unit == "ft" else 1.0)
    offset = raw.offsets[0] * (FOOT if unit == "ft" else 1.0)
    height = (read.astype(np.float32) * np.float32(scale) + np.float32(offset)).filled(np.nan)
    return _grid(path, corner, step, (rows, columns), height)


def _window(
    path: Path, box: Box, corner: tuple[float, float], step: tuple[float, float], shape: tuple[int, int]
) -> tuple[slice, slice]:
    """Rows and columns of a file within a box, and one more to each side; corner, step: of its first point, rad."""
    middle = 0.5 * step[1] * shape[1]
    turns = (math.remainder(side - corner[1] - middle, 2.0 * math.pi) for side in (box.west, box.east))
    east, wide = (middle + turn for turn in turns)
    out = []
    for low, high, count in (
        ((corner[0] - box.north) / step[0], (corner[0] - box.south) / step[0], shape[0]),
        (east / step[1], wide / step[1], shape[1]),
    ):
        first, last = max(math.floor(low) - 1, 0), min(math.ceil(high) + 2, count)
        if last - first < 2:
            raise FileError(0, "has no heights within reach_m of the threshold; give the file of that place", path)
        out.append(slice(first, last))
    rows, columns = out
    if (many := (rows.stop - rows.start) * (columns.stop - columns.start)) > MOST:
        text = f"has {many:,} heights within reach_m; at most {MOST:,} are kept: give a smaller reach_m"
        raise FileError(0, f"{text}, or a coarser file (gdalwarp -r max -tr ...)", path)
    return rows, columns


def _grid(
    path: Path, corner: tuple[float, float], step: tuple[float, float], part: tuple[slice, slice], height: np.ndarray
) -> HeightGrid:
    """Part of a file as a grid. Raises FileError for voids that the file does not declare."""
    known = height[np.isfinite(height)]
    if not known.size:
        raise FileError(0, "has nothing but voids within reach_m of the threshold", path)
    for worst, wrong in ((known.min(), known.min() < _LOWEST), (known.max(), known.max() > _HIGHEST)):
        if wrong:
            text = f"has heights of {worst:g} m; if these are voids, declare them: gdal_translate -a_nodata {worst:g}"
            raise FileError(0, text, path)
    rows, columns = part
    height[~np.isfinite(height)] = np.nan
    return HeightGrid(
        corner[0] - rows.start * step[0], corner[1] + columns.start * step[1], *step, np.ascontiguousarray(height)
    )
