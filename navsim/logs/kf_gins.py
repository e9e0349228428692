"""Text files of KF-GINS: increments of the inertial sensors, positions with their accuracies, or both by its settings.

Source: [1] KF-GINS, manual (Wuhan University): IMU file (GPS seconds of week, three angle and three velocity
increments, forward-right-down), GNSS file (seconds, latitude, longitude, height, three sigmas), settings (YAML).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from navsim.formats.conventions import FIX_SIGMAS
from navsim.formats.recording import increments_as_rates
from navsim.formats.text import Dropped, FileError, read_lines
from navsim.logs.contents import SLOWEST_IMU_HZ, FixRecord, ImuRecord, LogContents
from navsim.statistics.rounding import digits

TITLE = "a text file of KF-GINS"
GIVES = "increments of the IMU; positions with accuracies; lever arm of its settings"
_IMU_COLUMNS, _FIX_COLUMNS = (7, 8), (7, 13)
"""With an odometer; with velocities and their sigmas."""
_PATHS = {"imupath": "IMU", "gnsspath": "GNSS"}


def matches(head: bytes, path: Path) -> bool:
    """Whether a file has rows of numbers alone, or is a settings file."""
    text = head.decode("latin-1")
    if re.search(r"^(imupath|gnsspath)\s*:", text, re.MULTILINE):
        return True
    lines = [line.split() for line in text.splitlines()[:-1] if line.strip()][:5]
    return bool(lines) and all(len(row) in (*_IMU_COLUMNS, *_FIX_COLUMNS) and _numbers(row) for row in lines)


def read(path: Path, with_settings: bool = True) -> LogContents:
    """Read one file, or all that settings name, if it may be settings. Raises FileError, OSError."""
    dropped = Dropped(lenient=True)
    lines = read_lines(path, dropped)
    if any(re.match(r"(imupath|gnsspath)\s*:", line) for line in lines):
        if not with_settings:
            raise FileError(0, "the settings name settings; name a file with rows of numbers", path)
        return _by_settings(path, "\n".join(lines))
    out = LogContents(TITLE, clock="week")
    rows = []
    width = len(next((line.split() for line in lines if line.strip()), []))
    for count, line in enumerate(lines, 1):
        cells = line.split()
        if cells and len(cells) == width and _numbers(cells):
            rows.append([float(cell) for cell in cells])
        elif cells:
            dropped.damaged("lines left out", FileError(count, f"not {width} numbers", path))
    out.left_out += dropped.reasons()
    if len(rows) < 2:
        raise FileError(0, "; ".join(["the file has fewer than two rows", *dropped.reasons()]), path)
    table = np.array(rows)
    rate = 1.0 / max(float(np.median(np.diff(table[:, 0]))), 1e-9)
    if width in _IMU_COLUMNS and rate >= SLOWEST_IMU_HZ:
        out.decided.append(f"{path.name} has IMU increments: {width} columns, {digits(rate, 4)} rows a second")
        keep = np.diff(table[:, 0], prepend=-np.inf) > 0.0
        out.count_omitted(int((~keep).sum()), f"samples of {path.name} with the time of another, or out of order")
        table = table[keep]
        rates = increments_as_rates(table[:, 0], table[:, 1:7])
        out.add_imu(ImuRecord(path.stem, table[:, 0], rates[:, :3], rates[:, 3:], "averaged"))
    elif width in _FIX_COLUMNS:
        out.decided.append(f"{path.name} has fixes: {width} columns, {digits(rate)} rows a second")
        velocity = table[:, 7:10] if width == _FIX_COLUMNS[1] else np.full((len(rows), 3), np.nan)
        sigma = table[:, 4:7] if width == _FIX_COLUMNS[0] else table[:, [4, 5, 6, 10, 11, 12]]
        known = {name: np.where(each > 0.0, each, np.nan) for name, each in zip(FIX_SIGMAS, sigma.T, strict=False)}
        out.add_receiver(FixRecord(path.stem, table[:, 0], table[:, 1:4], velocity, known))
    else:
        raise FileError(
            0, f"{width} columns at {digits(rate)} rows a second are neither IMU increments nor fixes", path
        )
    return out


def _by_settings(path: Path, text: str) -> LogContents:
    try:
        settings: Any = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise FileError(0, f"not YAML: {str(error).splitlines()[0]}", path) from None
    if not isinstance(settings, dict):
        raise FileError(0, "the settings are not keys and values", path)
    out: LogContents | None = None
    for key, what in _PATHS.items():
        name = settings.get(key)
        if not isinstance(name, str):
            raise FileError(0, f"the settings name no {what} file; write `{key}: FILE`", path)
        beside = path.parent / name
        part = read(beside if beside.exists() else path.parent / Path(name).name, with_settings=False)
        if out is None:
            out = part
        else:
            out.merge(part, name)
    assert out is not None
    arm = settings.get("antlever")
    if isinstance(arm, list) and len(arm) == 3 and all(isinstance(x, int | float) for x in arm):
        x, y, z = (float(each) for each in arm)
        out.place_antenna((x, y, z))
    return out


def _numbers(cells: list[str]) -> bool:
    return all(re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", cell) for cell in cells)
