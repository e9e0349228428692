"""Tables of a horizon: elevation of land, trees or buildings around an antenna, by azimuth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navsim.formats.tables import TextTable
from navsim.formats.text import Dropped, FileError, read_lines, within
from navsim.gnss.sky import Horizon

COLUMNS = ("azimuth_deg", "elevation_deg")
_MOST = 100_000


def read_horizon(path: Path) -> Horizon:
    """Read a table with the columns `COLUMNS`, packed or not; lines that begin with # are comments.

    Azimuths are from 0 to 360 degrees, clockwise from true north, each larger than the one before. Raises FileError,
    naming the line, for anything else; OSError where the file cannot be read.
    """
    dropped = Dropped()
    there = TextTable.of(path, read_lines(path, dropped))
    if len(there.numbers) > _MOST:
        raise FileError(0, f"the file has {len(there.numbers):,} lines; a horizon has at most {_MOST:,}", path)
    table, lines = there.read(COLUMNS, (), (), dropped)
    for i, line in enumerate(lines):
        for value, name, (low, high) in zip(table[i], COLUMNS, ((0.0, 360.0), (-90.0, 90.0)), strict=True):
            within(path, int(line), float(value), low, high, name)
        if i and table[i, 0] <= table[i - 1, 0]:
            raise FileError(int(line), "the azimuth does not increase; sort the rows by azimuth", path)
    if table[-1, 0] == 360.0 and len(table) > 1 and table[0, 0] == 0.0:
        if table[-1, 1] != table[0, 1]:
            raise FileError(int(lines[-1]), "at 0 and 360 degrees elevations differ; write one of both rows", path)
        table = table[:-1]
    return Horizon(*np.radians(table).T)
