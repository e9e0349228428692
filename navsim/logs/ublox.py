"""u-blox messages (`.ubx`), by the `pyubx2` package: fixes, and raw measurements as RINEX.

Source: [1] u-blox F9 HPG 1.32 interface description: UBX-NAV-PVT, UBX-NAV-HPPOSLLH, UBX-RXM-RAWX.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from navsim.formats.rinex_write import Epochs, observation_lines
from navsim.formats.text import FileError, check_table
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.constellations.systems import BEIDOU, GALILEO, GLONASS, GPS, QZSS
from navsim.gnss.timescales import WEEK, gps_from_utc, posix
from navsim.logs.contents import QUALITY, FixRecord, LogContents, check_size, foreign_reader
from navsim.results import files

TITLE = "u-blox messages"
GIVES = "fixes with accuracies and quality (NAV-PVT, NAV-HPPOSLLH), raw measurements as RINEX (RXM-RAWX)"
_HEAD = b"\xb5\x62"
_PVT, _PRECISE, _RAW = (0x01, 0x07), (0x01, 0x14), (0x02, 0x15)
"""Class and number of the messages [1]."""
_WITHOUT = {(0x01, 0x02): "NAV-POSLLH", (0x01, 0x12): "NAV-VELNED", (0x02, 0x13): "RXM-SFRBX", (0x10, 0x02): "ESF-MEAS",
            (0x10, 0x03): "ESF-RAW", (0x01, 0x3C): "NAV-RELPOSNED"}  # fmt: skip
"""Messages with measurements that navsim does not take."""
_SIGNALS = {
    (0, 0): GPS, (2, 0): GALILEO, (2, 1): GALILEO, (3, 0): BEIDOU, (3, 1): BEIDOU, (5, 0): QZSS, (6, 0): GLONASS,
}  # fmt: skip
"""Systems by number and signal, for those of the first frequency [1]."""
_BLOCK = np.dtype([
    ("range", "<f8"), ("phase", "<f8"), ("doppler", "<f4"), ("system", "u1"), ("satellite", "u1"), ("signal", "u1"),
    ("channel", "u1"), ("lock", "<u2"), ("cn0", "u1"), ("sigmas", "3u1"), ("status", "u1"), ("reserved", "u1"),
])  # fmt: skip
"""One measurement of RXM-RAWX [1]."""
_RAW_HEAD = 16
_RANGE_VALID = 1
_FIX_3D, _COMBINED = 3, (3, 4)
_CARRIER = {1: QUALITY["float"], 2: QUALITY["fixed"]}
_CHANNEL_ZERO = 7
"""The channel of GLONASS plus 7 is in the message."""


def matches(head: bytes, path: Path) -> bool:
    """Whether a file has such messages at its beginning, or the suffix and one of them."""
    return head.startswith(_HEAD) or (_HEAD in head and path.suffix.lower() == ".ubx")


def read(path: Path) -> LogContents:
    """Read messages. Raises FileError, OSError."""
    check_size(path)
    fixes: list[list[float]] = []
    precise: dict[float, list[float]] = {}
    week, last = 0, None
    raw: list[tuple[float, int, np.ndarray]] = []
    others: Counter[str] = Counter()
    out = LogContents(TITLE, clock="week")
    with files.open_regular(path) as file, foreign_reader(path, "pyubx2"):
        from pyubx2 import ERR_IGNORE, UBX_PROTOCOL, UBXReader, isvalid_checksum

        damaged = 0
        for message, _ in UBXReader(file, protfilter=UBX_PROTOCOL, quitonerror=ERR_IGNORE, parsing=False):
            kind = message[2], message[3]
            if kind in _WITHOUT:
                others[_WITHOUT[kind]] += 1
            if kind not in (_PVT, _PRECISE, _RAW):
                continue
            if not isvalid_checksum(message):
                damaged += 1
            elif kind == _RAW:
                raw.append(_raw(message[6:-2]))
            else:
                parsed = UBXReader.parse(message)
                if last is not None and abs(parsed.iTOW - last) > 500.0 * WEEK:
                    week += 1 if parsed.iTOW < last else -1
                last = parsed.iTOW
                at = WEEK * week + 1e-3 * parsed.iTOW
                if kind == _PVT:
                    fixes.append([at, *_fix(parsed)])
                else:
                    precise[at] = [parsed.lat, parsed.lon, 1e-3 * parsed.height, parsed.invalidLlh]
    out.count_omitted(damaged, "messages with a wrong checksum")
    out.left_out += [f"{count} messages {name}" for name, count in sorted(others.items())]
    if not fixes and not raw:
        reasons = ["no NAV-PVT and no RXM-RAWX: switch them on in the receiver", *out.left_out]
        raise FileError(0, "; ".join(reasons), path)
    if fixes:
        _add_fixes(out, np.array(fixes), precise)
    if raw:
        _add_rinex(out, path, raw)
    return out


def _fix(m: Any) -> list[float]:
    """Row of NAV-PVT after its time: UTC, position, velocity, accuracies, satellites, quality."""
    known = m.validDate and m.validTime
    utc = posix(m.year, m.month, m.day, m.hour, m.min, float(m.second)) + 1e-9 * m.nano if known else np.nan
    good = m.gnssFixOk and m.fixType in _COMBINED and not getattr(m, "invalidLlh", 0)
    level = _CARRIER.get(m.carrSoln, QUALITY["differential"] if m.diffSoln else QUALITY["3D"])
    return [
        utc, m.lat, m.lon, 1e-3 * m.height, 1e-3 * m.velN, 1e-3 * m.velE, 1e-3 * m.velD, 1e-3 * m.hAcc,
        1e-3 * m.vAcc, 1e-3 * m.sAcc, m.numSV, level if good else QUALITY["no fix"],
    ]  # fmt: skip


def _add_fixes(out: LogContents, table: np.ndarray, precise: dict[float, list[float]]) -> None:
    time = table[:, 0]
    dated = np.isfinite(table[:, 1])
    if dated.any():
        start = float(np.median(gps_from_utc(table[dated, 1]) - time[dated]))
        out.start = round(start / WEEK) * WEEK
    llh = table[:, 2:5].copy()
    finer = np.array([not precise.get(at, [0, 0, 0, 1])[3] for at in time])
    llh[finer] = np.array([precise[at][:3] for at in time[finer]]).reshape(-1, 3)
    if finer.any():
        out.decided.append(f"positions of {int(finer.sum())} of {finer.size} fixes from NAV-HPPOSLLH, to 0.1 mm")
    out.decided.append("times are GPS seconds of the week that begins the messages (iTOW)")
    sigma = np.where(table[:, 8:11] > 0.0, table[:, 8:11], np.nan)
    names = ("sigma_horizontal_m", "sigma_vertical_m", "sigma_speed_m_s")
    further = {"nsat": table[:, 11], "quality": table[:, 12], **dict(zip(names, sigma.T, strict=True))}
    out.add_receiver(FixRecord("receiver", time, llh, table[:, 5:8], further), table[:, 12] > QUALITY["no fix"])


def _raw(payload: bytes) -> tuple[float, int, np.ndarray]:
    """Receiver time of week, week, measurements (n,) of RXM-RAWX."""
    time, week = float(np.frombuffer(payload, "<f8", 1)[0]), int(np.frombuffer(payload, "<u2", 1, 8)[0])
    return time, week, np.frombuffer(payload, _BLOCK, offset=_RAW_HEAD)


def _add_rinex(out: LogContents, path: Path, raw: list[tuple[float, int, np.ndarray]]) -> None:
    """Observations of the first frequency as a RINEX file."""
    names: dict[str, int] = {}
    channels: dict[str, int] = {}
    rows: list[list[tuple[int, float, float, float]]] = []
    skipped = 0
    for _, _, measured in raw:
        row = []
        for one in measured:
            system = _SIGNALS.get((int(one["system"]), int(one["signal"])))
            if system is None or not one["status"] & _RANGE_VALID or not 1 <= one["satellite"] <= system.highest:
                skipped += 1
                continue
            name = f"{system.letter}{one['satellite']:02d}"
            if system is GLONASS:
                channels[name] = int(one["channel"]) - _CHANNEL_ZERO
            row.append((names.setdefault(name, len(names)), one["range"], one["doppler"], one["cn0"]))
        rows.append(row)
    out.count_omitted(skipped, "raw measurements of other frequencies or systems, or without a valid range")
    check_table(path, 3, len(rows), max(len(names), 1))
    values = np.full((3, len(rows), len(names)), np.nan)
    for epoch, row in enumerate(rows):
        for index, *numbers in row:
            values[:, epoch, index] = numbers
    time = np.array([week * WEEK + at for at, week, _ in raw])
    start = float(np.floor(time[0]))
    tag = np.array([(week - raw[0][1]) * WEEK + (at - (start - raw[0][1] * WEEK)) for at, week, _ in raw])
    place = out.receivers[0].llh[0] if out.receivers else np.zeros(3)
    position = ecef_from_llh(np.array([*np.radians(place[:2]), place[2]])) if out.receivers else np.zeros(3)
    order = np.argsort(list(names), kind="stable")
    step = float(np.median(np.diff(tag))) if tag.size > 1 else 1.0
    epochs = Epochs(start, tag, tuple(np.array(list(names))[order]), values[:, :, order], position, channels, step)
    lines = observation_lines(epochs, path.stem, [f"from RXM-RAWX of {path.name}"], "navsim import", "u-blox")
    out.texts["gnss.obs"] = "\n".join(lines) + "\n"
