"""Files of heights of the ground: read for a landing, levelled on its runway, and compared with its flight.

Source: `docs/theory/interference.md`, section 3.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from navsim.formats.heights import Box, read_heights
from navsim.formats.text import FileError
from navsim.geodesy.earth import ecef_from_llh, in_heading_axes, llh_from_ecef
from navsim.geodesy.height_grid import HeightGrid
from navsim.gnss.interference.horizon import Terrain
from navsim.results import files
from navsim.scenario.landing import Landing
from navsim.scenario.terrain import TerrainSection
from navsim.scenario_files.base import DEG
from navsim.scenario_files.source import Document, InputError, Problem, dotted
from navsim.trajectory.approach import TOUCHDOWN
from navsim.trajectory.kinematics import Frame, Moving

_STRIP = 60.0, 140.0
"""The runway strip, which is graded: beyond its ends and to its sides, m (Annex 14, 3.4, of code numbers 3 and 4)."""
_OFF = 10.0
"""Difference of a file from the runway's height at the threshold that is warned of, m."""
_STEP = 0.2
"""Interval between places of the flight that are compared with the ground, s."""


def with_heights(scenario: Landing, document: Document, frame: Frame) -> tuple[Landing, list[str]]:
    """The scenario with the heights of its files, and their checksums written into it; warnings.

    Raises InputError for a file that cannot be used.
    """
    if not any(section.file for section in scenario.terrain):
        return scenario, []
    threshold, out, warnings = scenario.threshold(frame), [], []
    for i, section in enumerate(scenario.terrain):
        if section.file is None:
            out.append(section)
            continue
        raw, checksum = _read(section, i, document, threshold)
        geoid = scenario.runway.undulation_m if section.height_above == "geoid" else 0.0
        grid = replace(raw, height=raw.height + np.float32(geoid))
        off = float(grid.at(threshold) - threshold[2])
        if abs(off) > _OFF:
            warnings.append(
                f"terrain[{i}]: {section.file} has the threshold {abs(off):.1f} m {'above' if off > 0 else 'below'} "
                f"the runway, {scenario.runway.ellipsoidal_m:g} m above the ellipsoid; check height_above, "
                "runway.height_m and runway.geoid_undulation_m"
            )
        out.append(section.with_grid(_levelled(grid, scenario, threshold), checksum))
    return scenario.model_copy(update={"terrain": tuple(out)}), warnings


def _read(section: TerrainSection, i: int, document: Document, threshold: np.ndarray) -> tuple[HeightGrid, str]:
    """Heights of a file above what it counts from, and its checksum. Raises InputError."""
    assert section.file is not None
    assert section.height_above is not None
    key = ("terrain", i, "file")
    path, place = document.resolve(key, section.file), document.place(key)
    try:
        checksum = files.checksum(path)
        if section.file_sha256 not in (None, checksum):
            key = ("terrain", i, "file_sha256")
            text = f"{section.file} has the checksum {checksum}, not this one"
            raise InputError([Problem(document.place(key), dotted(key), text)])
        grid = _cached(path, checksum, *threshold[:2].tolist(), section.reach_m, section.unit, section.height_above)
    except FileError as error:
        raise InputError([Problem(place, dotted(key), f"{section.file}: {error.message}")]) from None
    except OSError as error:
        text = f"{section.file}: cannot be read: {error.strerror or error} ({path})"
        raise InputError([Problem(place, dotted(key), text)]) from None
    return grid, checksum


@functools.lru_cache(maxsize=4)
def _cached(path: Path, checksum: str, lat: float, lon: float, reach: float, unit: str, above: str) -> HeightGrid:
    """`read_heights`, once for all combinations of a study; checksum: of the file that is read."""
    return read_heights(path, Box.about(np.array([lat, lon]), reach), unit, above)


def _levelled(grid: HeightGrid, scenario: Landing, threshold: np.ndarray) -> HeightGrid:
    """The grid with the runway's own surface in its strip: heights of files are off by metres."""
    runway, cell = scenario.runway, 6.4e6 * max(grid.down, grid.right * math.cos(threshold[0]))
    beyond, beside = (part + cell for part in _STRIP)  # so that no cell that reaches into it has other points
    reach = Box.about(threshold, runway.extent_m + beyond + beside)
    south = [(grid.north - side) / grid.down for side in (reach.north, reach.south)]
    rows = slice(*np.clip([math.floor(south[0]), math.ceil(south[1]) + 1], 0, grid.height.shape[0]))
    east = [math.remainder(side - grid.west, 2.0 * math.pi) / grid.right for side in (reach.west, reach.east)]
    columns = slice(*np.clip([math.floor(east[0]), math.ceil(east[1]) + 1], 0, grid.height.shape[1]))
    lat = grid.north - grid.down * np.arange(rows.start, rows.stop)
    lon = grid.west + grid.right * np.arange(columns.start, columns.stop)
    llh = np.stack([*np.broadcast_arrays(lat[:, None], lon, threshold[2])], axis=-1)
    along, right, _ = np.moveaxis(in_heading_axes(ecef_from_llh(llh), threshold, runway.heading_deg * DEG), -1, 0)
    strip = (along >= -beyond) & (along <= runway.extent_m + beyond) & (np.abs(right) <= beside)
    surface = threshold[2] + runway.rise * np.clip(along, 0.0, runway.extent_m)
    height = grid.height.copy()
    height[rows, columns][strip] = surface[strip]
    return replace(grid, height=height)


def check_ground(scenario: Landing, document: Document, trajectory: Moving, terrain: Terrain) -> list[str]:
    """Warnings about a flight through the ground, sources under it or beside the files, and unknown ground.

    Raises InputError for a flight that leaves the files.
    """
    if not terrain.grids:
        return []
    first = next(i for i, section in enumerate(scenario.terrain) if section.file)
    time = np.linspace(0.0, scenario.duration_s, max(2, math.ceil(scenario.duration_s / _STEP)))
    llh = trajectory.motion(time).llh
    over = llh[:, 2] - terrain.ground(llh)
    if np.isnan(over).any():
        k, key = int(np.argmax(np.isnan(over))), ("terrain", first, "file")
        lat, lon, _ = np.degrees(llh[k])
        text = (
            f"there is no height under the flight at {time[k]:.1f} s, {lat:.5f}, {lon:.5f} deg: it is outside of the "
            "files, a void, or farther from the threshold than reach_m; add the file of that place"
        )
        raise InputError([Problem(document.place(key), dotted(key), text)])
    out = []
    flying = time < trajectory.path.events.get(TOUCHDOWN, math.inf)
    lowest = int(np.argmin(np.where(flying, over, math.inf)))
    if over[lowest] < 0.0:
        out.append(
            f"terrain[{first}]: the flight goes through the ground at {time[lowest]:.1f} s, {-over[lowest]:.1f} m "
            "under it by the files of heights; raise the path, or check the files' heights"
        )
    names, places = _sources(scenario, trajectory.frame)
    above = places[:, 2] - terrain.ground(places)
    for name, height in zip(names, above.tolist(), strict=True):
        if math.isnan(height):
            out.append(f"terrain[{first}]: there is no height at {name}; what stands around it is not known")
        elif height < 0.0:
            out.append(
                f"terrain[{first}]: {name} is {-height:.1f} m under the ground, which hides it; heights of sources "
                "count from the runway"
            )
    return out


def _sources(scenario: Landing, frame: Frame) -> tuple[list[str], np.ndarray]:
    """Names and places (n, 3), rad, rad, m, of transmitters on the ground."""
    names, places = [*scenario.pseudolites.names()], [scenario.pseudolite_positions(frame)]
    if scenario.beacons is not None:
        names += scenario.beacons.names()
        places.append(scenario.beacons.model(scenario).positions(frame))
    if (its := scenario.interference) is not None:
        jammers = its.models(scenario.runway.ellipsoidal_m, scenario.signals.tracking)
        names += [jammer.name for jammer in jammers]
        places += [llh_from_ecef(jammer.place)[None] for jammer in jammers]
    return names, np.concatenate(places)
