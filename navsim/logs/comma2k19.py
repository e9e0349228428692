"""Segments of comma2k19: a folder with arrays `.npy` of a car's IMU and receiver.

Source: [1] Schafer et al. (2018), A Commute in Data: The comma2k19 Dataset: names of the arrays, units.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from navsim.formats.text import MOST_BYTES, FileError
from navsim.logs.contents import FixRecord, ImuRecord, LogContents, interpolated
from navsim.results import files

TITLE = "a segment of comma2k19"
GIVES = "IMU, fixes of the u-blox receiver without vertical velocity"
_IMU = {"IMU_gyro": 3, "IMU_accelerometer": 3}
_FIXES = "GNSS_live_gnss_ublox"
"""Latitude and longitude deg, speed m/s, UTC ms, altitude m, course deg [1]."""


def matches(folder: Path) -> bool:
    """Whether a folder has such arrays."""
    return (folder / "IMU_gyro_value.npy").exists()


def read(folder: Path) -> LogContents:
    """Read a segment. Raises FileError, OSError."""
    out = LogContents(TITLE)
    (time, rate), (theirs, force) = (_pair(folder, name, width) for name, width in _IMU.items())
    on_gyro = interpolated(time, theirs, force)
    out.decided.append("specific force interpolated to the times of the gyros; axes forward-right-down as recorded")
    out.add_imu(ImuRecord("IMU", time, rate, on_gyro))
    time, fix = _pair(folder, _FIXES, 6)
    course = np.radians(fix[:, 5])
    velocity = np.column_stack([fix[:, 2] * np.cos(course), fix[:, 2] * np.sin(course), np.full(time.size, np.nan)])
    out.add_receiver(FixRecord("u-blox", time, fix[:, [0, 1, 4]], velocity))
    out.left_out.append("other arrays of the folder: raw measurements, camera poses, the car's own signals")
    return out


def _pair(folder: Path, name: str, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of an array. Raises FileError."""
    parts = []
    for kind in ("t", "value"):
        path = folder / f"{name}_{kind}.npy"
        try:
            with files.open_regular(path, MOST_BYTES) as file:
                parts.append(np.asarray(np.lib.format.read_array(file, allow_pickle=False), dtype=float))
        except (ValueError, EOFError, TypeError, SyntaxError, MemoryError) as error:
            raise FileError(0, f"not an array of numpy: {str(error)[:100]}", path) from None
    time, value = parts
    if time.ndim != 1 or value.shape != (time.size, width):
        message = f"arrays of shape {time.shape} and {value.shape}; due are (n,) and (n, {width})"
        raise FileError(0, message, folder / f"{name}_value.npy")
    return time, value
