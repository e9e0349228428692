"""Tables of a horizon: how high the land, trees or buildings around an antenna stand, by azimuth."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from navsim.io.text import FileError, number, read_lines, within
from navsim.models.sky import Horizon

COLUMNS = ("azimuth_deg", "elevation_deg")
_MOST = 100_000


def read_horizon(path: Path) -> Horizon:
    """Read a table with the columns `COLUMNS`, packed or not; lines that begin with # are comments.

    Azimuths are from 0 to 360 degrees, clockwise from true north, each larger than the one before. Raises FileError,
    naming the line, for anything else; OSError where the file cannot be read.
    """
    rows = [(n, line) for n, line in enumerate(read_lines(path), 1) if line.strip() and not line.startswith("#")]
    if not rows:
        raise FileError(0, "the file has no table", path)
    if len(rows) > _MOST:
        raise FileError(0, f"{len(rows):,} lines are no horizon; the longest have {_MOST:,}", path)
    (first, head), *lines = ((n, [cell.strip() for cell in next(csv.reader([line]))]) for n, line in rows)
    if tuple(head) != COLUMNS:
        raise FileError(first, f"expected the columns {', '.join(COLUMNS)}", path)
    if not lines:
        raise FileError(first, "the table has no row", path)
    table = np.empty((len(lines), 2))
    for i, (line, cells) in enumerate(lines):
        if len(cells) != len(COLUMNS):
            raise FileError(line, f"expected {len(COLUMNS)} numbers, found {len(cells)}", path)
        for k, (cell, name, (low, high)) in enumerate(zip(cells, COLUMNS, ((0.0, 360.0), (-90.0, 90.0)), strict=True)):
            table[i, k] = within(path, line, number(path, line, cell, name), low, high, name)
        if i and table[i, 0] <= table[i - 1, 0]:
            raise FileError(line, "azimuths have to grow from row to row", path)
    if table[-1, 0] == 360.0 and len(table) > 1 and table[0, 0] == 0.0:
        if table[-1, 1] != table[0, 1]:
            raise FileError(lines[-1][0], "the elevation at 360 degrees is not the one at 0", path)
        table = table[:-1]
    return Horizon(*np.radians(table).T)
