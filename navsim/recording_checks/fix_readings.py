"""Other readings of the positions of a recording: another unit of angles, exchanged columns, other signs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import LEVEL_AXES, axes_letters, axes_matrix
from navsim.formats.recorded_data import Fixes
from navsim.recording_checks.mistakes import Log, relative_units


def with_angles(log: Log, unit: str, factor: float) -> Log:
    llh = log.fixes.llh * [factor, factor, 1.0]
    return replace(log, fixes=replace(log.fixes, llh=llh), gnss=replace(log.gnss, angle_unit=unit))


def with_columns_exchanged(log: Log) -> tuple[Log, dict[str, Any]]:
    """Latitude and longitude exchanged, and the remedy."""
    names = conventions.GNSS_COLUMNS[1:3]
    before = [log.gnss.columns.get(name, name) for name in names]
    columns = {**log.gnss.columns, names[0]: before[1], names[1]: before[0]}
    both = np.prod(conventions.POSITION_AXES[log.gnss.position_axes])  # the signs stay with the names
    fixes = replace(log.fixes, llh=log.fixes.llh[:, [1, 0, 2]] * [both, both, 1.0])
    return replace(log, fixes=fixes, gnss=replace(log.gnss, columns=columns)), {"gnss.columns": columns}


EAST_NORTH = "east before north"
OF_ALL_COLUMNS = "latitude and longitude seem to be exchanged, and so do the velocities north and east"
"""What seems wrong with a log of `with_all_columns_exchanged`."""


def with_all_columns_exchanged(log: Log) -> tuple[Log, dict[str, Any]]:
    """Positions and velocities in the order east, north, and the remedy."""
    placed, remedy = with_columns_exchanged(log)
    turn = np.eye(3)[[1, 0, 2]]
    axes = axes_letters(turn @ axes_matrix(log.gnss.velocity_axes, LEVEL_AXES), LEVEL_AXES)
    fixes = replace(placed.fixes, velocity=placed.fixes.velocity[:, [1, 0, 2]])
    cured = replace(placed, fixes=fixes, gnss=replace(placed.gnss, velocity_axes=axes))
    return cured, {**remedy, "gnss.velocity_axes": axes}


def _with_position_axes(log: Log, axes: str) -> Log:
    """Fixes whose latitude and longitude increase along `axes`."""
    now, due = (np.array(conventions.POSITION_AXES[each]) for each in (log.gnss.position_axes, axes))
    llh = log.fixes.llh * [*(now * due), 1.0]
    return replace(log, fixes=replace(log.fixes, llh=llh), gnss=replace(log.gnss, position_axes=axes))


def position_readings(log: Log) -> list[tuple[Log, Mapping[str, Any], str, np.ndarray]]:
    """Other interpretations of the columns of latitude and longitude: the log, keys, what seems to be the case, and the
    scale (3,) of the motion."""
    same = np.ones(3)
    exchanged, columns = with_columns_exchanged(log)
    out: list[tuple[Log, Mapping[str, Any], str, np.ndarray]] = [
        (exchanged, columns, "latitude and longitude seem to be exchanged", same)
    ]
    for axes, signs in conventions.POSITION_AXES.items():
        if axes != log.gnss.position_axes:
            changed = np.array(signs) != conventions.POSITION_AXES[log.gnss.position_axes]
            names = " and ".join(np.array(["latitude", "longitude"])[changed])
            seems = f"{names} {'seem' if changed.all() else 'seems'} to have the other sign"
            out.append((_with_position_axes(log, axes), {"gnss.position_axes": axes}, seems, same))
    for unit, factor in relative_units(conventions.ANGLE_UNITS, log.gnss.angle_unit).items():
        scale = np.array([factor, factor, 1.0])
        seems = f"latitude and longitude seem to be in {unit}"
        out.append((with_angles(log, unit, factor), {"gnss.angle_unit": unit}, seems, scale))
    return [entry for entry in out if is_on_earth(entry[0].fixes)]


def is_on_earth(fixes: Fixes) -> bool:
    """Whether no latitude is beyond a pole."""
    return bool(np.degrees(np.abs(fixes.llh[:, 0])).max() <= 90.0)
