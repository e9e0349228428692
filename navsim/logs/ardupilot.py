"""ArduPilot DataFlash logs (`.bin`), with the formats of the `pymavlink` package.

navsim finds the messages, since pymavlink ends at the first damaged one. pymavlink interprets the formats that the log
declares; navsim then decodes all messages of a kind at once. Samples are in body
axes: the autopilot has applied the board's orientation. Source: [1] ArduPilot, "Onboard Message Log Messages":
IMU, GPS, GPA, ATT, BARO, RFND, MAG, ARSP, XKF0, XKRB, PARM.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from navsim.gnss.timescales import WEEK
from navsim.logs.contents import (
    BODY_AXES,
    FixRecord,
    ImuRecord,
    LogContents,
    RangeRecord,
    Topic,
    check_size,
    foreign_reader,
    lever_parameters,
    numbers,
)
from navsim.results import files

TITLE = "an ArduPilot DataFlash log"
GIVES = "all IMUs and receivers with accuracies, barometer, range finder, magnetometer, airspeed, beacons, attitude"
_HEAD = b"\xa3\x95"
_FMT, _FMT_LENGTH = 0x80, 89
"""Number and length of the message that declares another [1]."""
_FIX_3D = 3
_MILLISECOND = 1e-3
TOPICS = (
    Topic("BARO", "barometer", {
        "pressure_pa": ("Press", 1.0), "height_m": ("Alt", 1.0), "temperature_c": ("Temp", 1.0),
    }),
    Topic("RFND", "rangefinder", {"distance_m": ("Dist", 1.0)}),
    Topic("MAG", "magnetometer", {f"m{axis.lower()}_ut": (f"Mag{axis}", 0.1) for axis in "XYZ"}),
    Topic("ARSP", "airspeed", {"airspeed_m_s": ("Airspeed", 1.0)}),
)  # fmt: skip
"""Messages that become tables [1]; MAG has mG."""
_BEACONS = ("XKRB", "XKF0")
"""Ranges to beacons as the EKF uses them, by preference."""
_INSTANCES = ("I", "Instance")
_WITHOUT = {
    "ACC": "raw samples of the accelerometers", "GYR": "raw samples of the gyros", "IMT": "increments of the IMUs",
    "BCN": "ranges of beacons without their positions; docs/how-to/ranges.md says how to add them",
    "GPYW": "heading between two antennas; navsim takes GPS.Yaw",
}  # fmt: skip
"""Messages with measurements that navsim does not take."""


def matches(head: bytes, path: Path) -> bool:
    """Whether a file begins as such a log does, or has its suffix and such messages."""
    return head.startswith(_HEAD) or (path.suffix.lower() == ".bin" and _HEAD in head)


def read(path: Path) -> LogContents:
    """Read a log. Raises FileError, OSError."""
    check_size(path)
    with files.open_regular(path) as file, foreign_reader(path, "pymavlink"):
        messages = _Messages(file.read())
        contents = _contents(messages)
    contents.count_omitted(messages.skipped, "bytes of the log that belong to no message")
    return contents


class _Messages:
    """Messages of a log by name, as columns.

    A message begins with two bytes and its number; FMT tells length and columns of each number. Between messages, bytes
    are skipped up to the next beginning.
    """

    def __init__(self, content: bytes) -> None:
        from pymavlink.DFReader import DFFormat

        self._data = np.frombuffer(content, np.uint8)
        self._formats: dict[int, Any] = {}
        self.skipped = 0
        """Bytes that belong to no message."""
        places: dict[int, list[int]] = {}
        lengths = {_FMT: _FMT_LENGTH}
        at, end = 0, len(content)
        while at + 3 <= end:
            length = lengths.get(content[at + 2]) if content[at : at + 2] == _HEAD else None
            if length is None:
                following = content.find(_HEAD, at + 1)
                following = end if following < 0 else following
                self.skipped += following - at
                at = following
                continue
            if at + length > end:
                self.skipped += end - at
                break
            number = content[at + 2]
            if number == _FMT:
                kind, size, name, codes, columns = struct.unpack("<BB4s16s64s", content[at + 3 : at + _FMT_LENGTH])
                with suppress(Exception):  # pymavlink raises Exception itself for a code that it does not know
                    form = DFFormat(kind, name, size, codes.rstrip(b"\0").decode("latin-1"), _text(columns))
                    types = (f"<{_numpy(code)}" for code in _codes(form))
                    form.layout = np.dtype(list(zip(form.columns, types, strict=True)))
                    if form.layout.itemsize == size - 3 and kind not in lengths:
                        self._formats[kind] = form
                        lengths[kind] = size
            else:
                places.setdefault(number, []).append(at)
            at += length
        self._places = {number: np.array(found, dtype=np.int64) for number, found in places.items()}
        self._numbers = {self._formats[number].name: number for number in places}
        self.names = set(self._numbers)

    def columns(self, name: str) -> dict[str, np.ndarray]:
        """Columns of all messages of a name, in file order, scaled as their formats say; {} if there are none."""
        if name not in self.names:
            return {}
        form, at = self._formats[self._numbers[name]], self._places[self._numbers[name]]
        raw = self._data[at[:, None] + np.arange(3, 3 + form.layout.itemsize)]
        rows = np.ascontiguousarray(raw).view(form.layout)[:, 0]
        return {
            column: rows[column] if scale is None else rows[column] / round(1.0 / scale)
            for column, scale in zip(form.columns, form.msg_mults, strict=True)
        }

    def instances(self, name: str) -> list[tuple[int, dict[str, np.ndarray]]]:
        """The same for each instance: by the field of its number, or in messages NAME, NAME2, ... of older logs."""
        out = []
        for extra, stem in enumerate((name, *(f"{name}{i}" for i in range(2, 5)))):
            found = self.columns(stem)
            key = next((key for key in _INSTANCES if key in found), None)
            if key is None:
                out += [(extra, found)] if found else []
                continue
            for number in np.unique(found[key]):
                mine = found[key] == number
                out.append((int(number), {column: values[mine] for column, values in found.items()}))
        return out

    def parameters(self) -> dict[str, float]:
        """Last value of each parameter."""
        found = self.columns("PARM")
        if not {"Name", "Value"} <= set(found):
            return {}
        names = [_text(bytes(name)) for name in found["Name"]]
        return {name: float(value) for name, value in zip(names, found["Value"], strict=True)}


def _text(raw: bytes) -> str:
    return raw.split(b"\0")[0].decode("latin-1")


def _codes(form: Any) -> list[str]:
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    return [FORMAT_TO_STRUCT[code][0] for code in form.msg_fmts]


def _numpy(code: str) -> str:
    """Type of numpy for one of `struct`."""
    return f"S{code[:-1]}" if code.endswith("s") else np.dtype(code).str[1:]


def _seconds(found: Mapping[str, np.ndarray]) -> np.ndarray:
    return 1e-6 * found["TimeUS"].astype(float)


def _contents(messages: _Messages) -> LogContents:
    out = LogContents(TITLE)
    parameters = messages.parameters()
    out.imu_keys += BODY_AXES
    for number, found in messages.instances("IMU"):
        rate, force = numbers(found, "GyrX", "GyrY", "GyrZ"), numbers(found, "AccX", "AccY", "AccZ")
        if rate is None or force is None or "TimeUS" not in found:
            out.left_out.append(f"IMU {number}: its messages lack fields of the gyros or accelerometers")
            continue
        place = lever_parameters(parameters, (f"INS_POS{number + 1}",))
        out.add_imu(ImuRecord(f"IMU {number}", _seconds(found), rate, force, "instantaneous", place))
    for number, found in messages.instances("GPS"):
        _add_receiver(out, messages, parameters, number, found)
    for topic in TOPICS:
        parts = [
            topic.rows(_seconds(found), found, np.full(found["TimeUS"].size, number))
            for number, found in messages.instances(topic.message)
            if "TimeUS" in found
        ]
        if parts := [part for part in parts if part]:
            out.add_table(topic.table, {key: np.concatenate([part[key] for part in parts]) for key in parts[0]})
    attitude = messages.columns("ATT")
    angles = numbers(attitude, "Roll", "Pitch", "Yaw")
    if angles is not None:
        columns = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), angles.T, strict=True))
        out.add_table("attitude", {"t_s": _seconds(attitude), **columns})
    out.add_magnetic_heading()
    for name in _BEACONS:
        if beacons := messages.columns(name):
            out.ranges = _ranges(beacons)
            break
    out.left_out += [f"{name}: {what}" for name, what in _WITHOUT.items() if name in messages.names]
    turned = parameters.get("AHRS_ORIENTATION")
    if turned is not None:
        known = f"AHRS_ORIENTATION is {turned:g}"
        out.decided.append(f"axes forward-right-down: the autopilot has applied the board's orientation ({known})")
    return out


def _add_receiver(
    out: LogContents, messages: _Messages, parameters: Mapping[str, float], number: int, found: dict[str, np.ndarray]
) -> None:
    llh, motion = numbers(found, "Lat", "Lng", "Alt"), numbers(found, "Spd", "GCrs", "VZ")
    if llh is None or "TimeUS" not in found or "Status" not in found:
        out.left_out.append(f"GPS {number}: its messages lack fields of the position")
        return
    fix = found["Status"] >= _FIX_3D
    name = f"GPS {number}"
    time = _seconds(found)
    accuracy = dict(messages.instances("GPA")).get(number, {})
    further = {"nsat": found["NSats"].astype(float)} if "NSats" in found else {}
    further["quality"] = found["Status"].astype(float)
    for column, field in (("sigma_horizontal_m", "HAcc"), ("sigma_vertical_m", "VAcc"), ("sigma_speed_m_s", "SAcc")):
        if field in accuracy:
            value = _at(time, accuracy, accuracy[field])
            further[column] = np.where(value > 0.0, value, np.nan)
    velocity = np.full((time.size, 3), np.nan)
    if motion is not None:
        course = np.radians(motion[:, 1])
        velocity = np.column_stack([motion[:, 0] * np.cos(course), motion[:, 0] * np.sin(course), motion[:, 2]])
        if "VV" in accuracy:
            velocity[_at(time, accuracy, accuracy["VV"]) == 0.0, 2] = np.nan
    llh, heights = _ellipsoidal(name, llh, time, accuracy)
    known = found.get("GWk", np.zeros(time.size)) > 0
    if out.start is None and (fix & known).any() and "GMS" in found:
        # the median ignores fixes with damaged times
        gps = WEEK * found["GWk"].astype(float) + _MILLISECOND * found["GMS"].astype(float)
        out.start = round(float(np.median((gps - time)[fix & known])), 3)
    keys = (f"GPS_DELAY_MS{number + 1 if number else ''}", f"GPS{number + 1}_DELAY_MS")
    delay = next((_MILLISECOND * parameters[key] for key in keys if parameters.get(key)), None)
    remark = "GPS_DELAY_MS is 0, the driver's own value" if any(key in parameters for key in keys) else ""
    place = lever_parameters(parameters, (f"GPS{number + 1}_POS", f"GPS_POS{number + 1}"))
    if "Yaw" in found:  # 0: none
        yaw = found["Yaw"].astype(float)
        out.add_antenna_heading(time, np.where(yaw == 0.0, np.nan, yaw), None)
    if out.add_receiver(FixRecord(name, time, llh, velocity, further, place, delay, remark), fix):
        out.decided.append(heights)


def _at(time: np.ndarray, found: Mapping[str, np.ndarray], values: np.ndarray) -> np.ndarray:
    """Values of another message that belongs to these times: its last one until shortly after; nan if there is none."""
    theirs = _seconds(found)
    order = np.argsort(theirs, kind="stable")
    index = np.searchsorted(theirs[order], time + 0.02, side="right") - 1
    out = values[order].astype(float)[np.maximum(index, 0)]
    return np.where((index >= 0) & (time - theirs[order][np.maximum(index, 0)] < 2.0), out, np.nan)


def _ellipsoidal(
    name: str, llh: np.ndarray, time: np.ndarray, accuracy: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, str]:
    """Positions with heights above the ellipsoid, and a remark: those of the log are above sea level."""
    if "Und" in accuracy and np.any(accuracy["Und"] != 0.0):
        undulation = _at(time, accuracy, accuracy["Und"])
        text = f"heights of {name} above the ellipsoid: GPS.Alt less GPA.Und, here the negative of the geoid's height"
        return np.column_stack([llh[:, :2], llh[:, 2] - undulation]), text
    text = f"heights of {name} above mean sea level used as ellipsoidal ones: the log has no undulation (GPA.Und)"
    return llh, f"{text}; for heights above the ellipsoid add the geoid's to the column h_m"


def _ranges(found: Mapping[str, np.ndarray]) -> RangeRecord | None:
    """Ranges of the first EKF core; positions are relative to the EKF's origin."""
    place = numbers(found, "BPN", "BPE", "BPD")
    if place is None or "rng" not in found or "ID" not in found:
        return None
    core = found.get("C", np.zeros(found["ID"].size))
    mine = core == core.min()
    beacon = found["ID"][mine].astype(str)
    unknown = np.full(beacon.size, np.nan)
    positions = {str(name): _median(place[mine][beacon == name]) for name in np.unique(beacon)}
    ranges = found["rng"][mine].astype(float)
    return RangeRecord(_seconds(found)[mine], beacon, ranges, unknown, unknown, positions, is_geodetic=False)


def _median(ned: np.ndarray) -> tuple[float, float, float]:
    """East, north, up of positions north, east, down (n, 3)."""
    north, east, down = np.median(ned, axis=0)
    return float(east), float(north), float(-down)
