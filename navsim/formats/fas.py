"""FAS data block: the final approach segment of an approach by SBAS or GBAS, 40 bytes with a checksum.

Fields follow each other, the least significant bit of the first byte first. The checksum is CRC-32Q, polynomial
0x814141AB, least significant bit first, from zero, without inversion. Sources: ICAO Annex 10, volume I, appendix B,
3.6.4.5; RTCA DO-229D, table D-1. `tests/unit/test_fas.py` has published blocks.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from navsim.geodesy import earth
from navsim.results.result import Result, ResultError, scenario_of

SIZE = 40
"""Bytes of a block."""
CHECKSUM = 4
"""Bytes of its checksum, at its end."""
GARP = 305.0
"""Distance of the GBAS azimuth reference point, the vertex of the course, beyond the flight path alignment point, m;
unverified."""
NO_PROVIDER = 15
"""Service provider of a block for any; unverified."""
_POLYNOMIAL = int(f"{0x814141AB:032b}"[::-1], 2)


class Field(NamedTuple):
    """A number of a block: its resolution, and what a number of zero bits means."""

    name: str
    unit: str
    bits: int
    resolution: float = 1.0
    zero: float = 0.0
    signed: bool = False


FIELDS = (
    Field("operation type", "", 4), Field("service provider", "", 4), Field("airport", "text", 32),
    Field("runway", "", 6), Field("runway letter", "", 2), Field("performance", "", 3), Field("route", "", 5),
    Field("path selector", "", 8), Field("path", "text", 32),
    Field("threshold latitude", "arcsec", 32, 0.0005, signed=True),
    Field("threshold longitude", "arcsec", 32, 0.0005, signed=True),
    Field("threshold height", "m", 16, 0.1, -512.0),
    Field("alignment latitude", "arcsec", 24, 0.0005, signed=True),
    Field("alignment longitude", "arcsec", 24, 0.0005, signed=True),
    Field("crossing height", "0.05 m or 0.1 ft", 15), Field("crossing height in m", "", 1),
    Field("glide path angle", "deg", 16, 0.01), Field("course width", "m", 8, 0.25, 80.0),
    Field("length offset", "m", 8, 8.0), Field("horizontal alert limit", "m", 8, 0.2),
    Field("vertical alert limit", "m", 8, 0.2),
)  # fmt: skip
"""Fields in their order. Alignment: the point's difference from the threshold."""


def checksum(data: bytes) -> int:
    """CRC-32Q of bytes."""
    rest = 0
    for byte in data:
        rest ^= byte
        for _ in range(8):
            rest = rest >> 1 ^ (_POLYNOMIAL if rest & 1 else 0)
    return rest


def decode(block: bytes) -> dict[str, float | str]:
    """Values of a block by the names of `FIELDS`. Raises ValueError for another size, or a wrong checksum."""
    if len(block) != SIZE:
        raise ValueError(f"a FAS data block has {SIZE} bytes, not {len(block)}")
    body, given = block[:-CHECKSUM], int.from_bytes(block[-CHECKSUM:], "little")
    if (due := checksum(body)) != given:
        raise ValueError(f"the checksum of the FAS data block is {given:08X}, that of its bytes {due:08X}")
    bits, out = int.from_bytes(body, "little"), dict[str, float | str]()
    for field in FIELDS:
        raw = bits & ((1 << field.bits) - 1)
        bits >>= field.bits
        if field.unit == "text":
            letters = raw.to_bytes(field.bits // 8, "big")
            out[field.name] = "".join(chr(64 + one) if one < 32 else chr(one) for one in letters)
            continue
        if field.signed and raw >> (field.bits - 1):
            raw -= 1 << field.bits
        out[field.name] = field.zero + field.resolution * raw
    return out


def encode(values: dict[str, float | str]) -> bytes:
    """Block of values by the names of `FIELDS`, texts of four capitals, digits or spaces.

    Raises ValueError for a value that its field cannot hold.
    """
    bits = at = 0
    for field in FIELDS:
        value = values[field.name]
        if field.unit == "text":
            text = str(value)
            if len(text) != 4 or not all(one in " 0123456789" or "A" <= one <= "Z" for one in text):
                raise ValueError(f"{field.name} {text!r}: four capitals, digits or spaces are needed")
            raw = int.from_bytes(bytes(ord(one) & 63 for one in text), "big")
        else:
            raw = round((float(value) - field.zero) / field.resolution)
            least = -(1 << (field.bits - 1)) if field.signed else 0
            most = least + (1 << field.bits) - 1
            if not least <= raw <= most:
                low, high = (field.zero + field.resolution * end for end in (least, most))
                raise ValueError(f"{field.name} {float(value):g} {field.unit}: the block holds {low:g} to {high:g}")
            raw &= (1 << field.bits) - 1
        bits |= raw << at
        at += field.bits
    body = bits.to_bytes(SIZE - CHECKSUM, "little")
    return body + checksum(body).to_bytes(CHECKSUM, "little")


def write_fas(result: Result, target: Path) -> dict[Path, str]:
    """Write the block of a landing's approach: a line of hexadecimal digits, and its values.

    Names of airport and path are blank, the runway's number is that of its heading. Raises ResultError for a landing
    without `approach.indicator` or alert limits, and for values that the block cannot hold.
    """
    scales, limits = "/summary/indicator/scale_", "/summary/integrity/"
    if f"{scales}origin" not in result:
        raise ResultError("the course width of the FAS data block is that of `approach.indicator`")
    if f"{limits}hal" not in result:
        raise ResultError("the alert limits of the FAS data block are those of `integrity.limits`")
    origin, aim, width, angle, foot = (
        float(result[f"{scales}{name}"]) for name in ("origin", "aim", "width", "angle", "foot")
    )
    heading, threshold = float(scenario_of(result)["runway"]["heading_deg"]), result["/truth/threshold_llh"]
    rise = result["/summary/indicator/touchdown_llh"][2] - threshold[2]
    along = (origin - GARP) * earth.heading_axes(threshold, np.radians(heading))[:, 0]
    alignment = earth.llh_from_ecef(earth.ecef_from_llh(threshold) + along)
    arcsec = 3600.0 * np.degrees(threshold[:2])
    apart = 3600.0 * np.degrees([alignment[0] - threshold[0], earth.wrap_angle(alignment[1] - threshold[1])])
    values: dict[str, float | str] = {
        "operation type": 0, "service provider": NO_PROVIDER, "airport": "    ", "path": "    ",
        "runway": round(heading / 10.0) % 36 or 36, "runway letter": 0, "performance": 0, "route": 0,
        "path selector": 0, "threshold latitude": arcsec[0], "threshold longitude": arcsec[1],
        "threshold height": threshold[2], "alignment latitude": apart[0], "alignment longitude": apart[1],
        "crossing height": ((aim + foot) * np.tan(angle) + rise) / 0.05, "crossing height in m": 1,
        "glide path angle": np.degrees(angle), "course width": width, "length offset": 0.0,
        "horizontal alert limit": float(result[f"{limits}hal"]), "vertical alert limit": float(result[f"{limits}val"]),
    }  # fmt: skip
    try:
        block = encode(values)
    except ValueError as error:
        raise ResultError(f"FAS data block: {error}") from None
    written = decode(block)
    rows = [f"{one.name}\t{written[one.name]}\t{one.unit}" for one in FIELDS]
    return {target.with_name(f"{target.stem}_fas.txt"): "\n".join([block.hex().upper(), *rows, ""])}
