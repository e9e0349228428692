"""Which program wrote a log, and its contents. A format is a module with `TITLE`, `GIVES`, `matches` and `read`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from navsim.formats.text import FileError, read_lines
from navsim.logs import ardupilot, comma2k19, kf_gins, nmea_log, px4, rtklib, ublox
from navsim.logs.contents import LogContents, check_size
from navsim.results import files

FORMATS: dict[str, Any] = {
    "ardupilot": ardupilot, "px4": px4, "ublox": ublox, "nmea": nmea_log, "rtklib": rtklib, "kf-gins": kf_gins,
    "comma2k19": comma2k19,
}  # fmt: skip
"""Formats by name, in the order in which a file is compared with them."""
RECEIVERS = tuple(form.TITLE for form in (ublox, nmea_log, rtklib))
"""Titles of formats without inertial samples."""
_BINARY = (ardupilot, px4, ublox)
_HEAD = 65536
"""Bytes at the beginning that show the format."""


def read_logs(paths: list[Path], name: str | None = None) -> LogContents:
    """Contents of the files of one recording. name: their format; None: as each shows. Raises FileError, OSError."""
    contents: LogContents | None = None
    for path in paths:
        part = (FORMATS[name] if name is not None else _format(path)).read(path)
        if not part.found():
            raise FileError(0, "; ".join(["no samples, fixes or other measurements in it", *part.left_out]), path)
        if contents is None:
            contents = part
        else:
            contents.merge(part, str(path))
    assert contents is not None
    return contents


def _format(path: Path) -> Any:
    """The format of a file or folder. Raises FileError, OSError."""
    if path.is_dir():
        if comma2k19.matches(path):
            return comma2k19
        raise FileError(0, f"the folder is not {comma2k19.TITLE}: it has no IMU_gyro_value.npy; name a file", path)
    if path.suffix.lower() == ".tlog":
        todo = "export tables, and declare their columns in a log.yaml (navsim init recorded_flight)"
        raise FileError(0, f"navsim does not read MAVLink logs: {todo}", path)
    check_size(path)
    with files.open_regular(path) as file:
        head = file.read(_HEAD)
    for form in _BINARY:
        if form.matches(head, path):
            return form
    try:
        lines = read_lines(path)
    except FileError as error:
        raise FileError(0, f"{error.message}, nor a log that navsim knows ({_known()})", path) from None
    text = "\n".join(lines[:2000]).encode("latin-1", "replace")
    for form in (nmea_log, rtklib, kf_gins):
        if form.matches(text, path):
            return form
    todo = {
        ".yaml": "a file of navsim itself needs no import: navsim replay or navsim validate takes it",
        ".csv": "for a table of your own declare the columns in a log.yaml (navsim init recorded_flight)",
    }.get(path.suffix.lower(), f"name its format with --format {'|'.join(FORMATS)}")
    raise FileError(0, f"not a log that navsim knows ({_known()}); {todo}", path)


def _known() -> str:
    return ", ".join(form.TITLE.removeprefix("a ").removeprefix("an ") for form in FORMATS.values())
