"""RINEX texts made for tests: observations of versions 2 and 3, messages of version 4."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from navsim.formats import rinex_write
from navsim.gnss import timescales
from navsim.gnss.constellations import glonass, glonass_broadcast, gps
from navsim.gnss.constellations.systems import GPS

SATELLITES = ("G05", "G12", "R02")
CODES_3 = ("C1C", "L1C", "D1C", "S1C")
CODES_2 = ("C1", "L1", "D1", "S1", "P1", "P2", "C2")


def labelled(text: str, label: str) -> str:
    """A header line."""
    return f"{text:60s}{label}"


def header(version: float, lines: Sequence[str]) -> list[str]:
    """A header of observations with these lines."""
    return [
        labelled(f"{version:9.2f}           OBSERVATION DATA    M (MIXED)", "RINEX VERSION / TYPE"),
        *lines,
        labelled("  2018     9    13    12     0    0.0000000     GPS", "TIME OF FIRST OBS"),
        labelled("", "END OF HEADER"),
    ]


def value(epoch: int, satellite: int, code: int) -> float:
    """Some value of the size of its kind, to a millimetre."""
    size = (2e7, 1.1e8, -1234.5, 45.0, 2e7, 2e7, 2e7)[code]
    return round(size * (1.0 + 1e-3 * satellite) + 1.111 * epoch + 0.123 * code, 3)


def row(name: str, values: Sequence[float]) -> str:
    """A satellite's line of version 3."""
    return name + "".join(f"{v:14.3f}  " for v in values).rstrip()


def observations_3(extra: Sequence[str] = (), tail: Sequence[str] = ()) -> str:
    """Two epochs of three satellites, four types; extra header lines, lines after the epochs."""
    types = [labelled(f"{s}    4" + "".join(f" {c}" for c in CODES_3), "SYS / # / OBS TYPES") for s in "GR"]
    lines = header(3.04, [*types, *extra])
    for epoch in range(2):
        lines.append(f"> 2018 09 13 12 00 {epoch:2d}.0000000  0{len(SATELLITES):3d}")
        lines += [row(n, [value(epoch, s, c) for c in range(4)]) for s, n in enumerate(SATELLITES)]
    return "\n".join([*lines, *tail]) + "\n"


def epoch_2(second: float, names: Sequence[str], flag: int) -> str:
    """The line that begins an epoch of version 2."""
    return f" 18  9 13 12  0{second:11.7f}  {flag}{len(names):3d}" + "".join(names)


def observations_2(
    version: float, extra: Sequence[str] = (), types: int = 4, blank_from: int = 99, tail: Sequence[str] = ()
) -> str:
    """Two epochs of three satellites in version 2; the very last satellite has no values from a type on."""
    codes = CODES_2[:types]
    announced = labelled(f"{types:6d}" + "".join(f"    {c}" for c in codes), "# / TYPES OF OBSERV")
    lines = header(version, [announced, *extra])
    for epoch in range(2):
        lines.append(epoch_2(float(epoch), SATELLITES, 0))
        for s, name in enumerate(SATELLITES):
            last = epoch == 1 and name == SATELLITES[-1]
            fields = [f"{value(epoch, s, c):14.3f}  " for c in range(types)]
            fields = [16 * " " if last and c >= blank_from else text for c, text in enumerate(fields)]
            lines += ["".join(fields[k : k + 5]).rstrip() for k in range(0, types, 5)]
    return "\n".join([*lines, *tail]) + "\n"


def navigation_3(utc: float) -> str:
    """Messages of three GPS and three GLONASS satellites in version 3.04."""
    elements = gps.nominal(utc).records.take(np.arange(3))
    vectors = glonass_broadcast.sent_by(glonass.Glonass24Slots(), utc, utc).records.take(np.arange(3))
    at = float(timescales.gps_from_utc(utc))
    return "\n".join(rinex_write.navigation_lines({GPS: elements}, vectors, ["made"], "made", at=at)) + "\n"


_MESSAGES = {"G": "LNAV", "R": "FDMA", "E": "INAV", "C": "D1", "J": "LNAV", "S": "SBAS", "I": "LNAV"}


STATUS = f"{179.0:19.12E}"
"""Status flags of a GLONASS-M satellite."""


def in_version_4(
    text: str, version: str, more: Sequence[str], flags: str = f"{3.0:19.12E}", status: str = STATUS
) -> str:
    """Messages of version 3 in the frames of version 4, after the lines `more`; GLONASS with a fifth line.

    flags, status: the fields of health and status flags in it.
    """
    lines = text.rstrip("\n").split("\n")
    body = next(k for k, line in enumerate(lines) if "END OF HEADER" in line) + 1
    old = lines[0][5:9]
    out = [lines[0].replace(old, version), *(x for x in lines[1:body] if "IONOSPHERIC" not in x), *more]
    starts = [k for k in range(body, len(lines)) if lines[k][0] != " "]
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        name = lines[start][:3]
        out += [f"> EPH {name} {_MESSAGES[name[0]]}", *lines[start:stop]]
        if name[0] == "R" and stop - start == 4:
            out.append(f"    {status:19s}{2 * f'{1.0:19.12E}'}{flags}".rstrip())
    return "\n".join(out) + "\n"
