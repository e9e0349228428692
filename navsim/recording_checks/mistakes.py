"""Mistakes of a recording, the recording as its log describes it, and the words that checks of it share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from navsim.formats import conventions
from navsim.formats.conventions import GnssConvention, ImuConvention
from navsim.formats.recorded_data import Fixes, Samples

WINDOW = 10.0
"""Length of the pieces over which positions and velocities are compared, s."""
SHORTEST_WAYS, SHORTEST_CLIMBS = (15.0, 4.0), (8.0, 3.0)
"""Pieces of a shorter way or climb, m, do not count: positions wander. The second is for flights that have too few
longer ones: of these only a correction that explains them is a mistake."""
WORSE, CERTAIN = 1.25, 20.0
"""A fit is worse than the best if its residual is larger by the first factor and its chi-square by the second number.
The chi-square is divided by four for correlated residuals."""


@dataclass(frozen=True)
class Mistake:
    """A probable mistake in how a recording is written.

    It has the evidence in numbers, a statement of what seems wrong, and remedies. Any one remedy would explain it; each
    is a set of keys of the log with values. It is reported at the file of the first key, or `without_remedy`.
    """

    evidence: str
    seems: str
    remedies: tuple[Mapping[str, Any], ...] = ()
    without_remedy: str = "imu"

    @property
    def section(self) -> str:
        """`imu` or `gnss`, the file it is about."""
        return next(iter(self.remedies[0])).partition(".")[0] if self.remedies else self.without_remedy

    def __str__(self) -> str:
        written = ", or ".join(f"`{_as_yaml(remedy)}`" for remedy in self.remedies)
        return f"{self.evidence}: {self.seems}" + (f"; write {written}" if written else "")


def _as_yaml(remedy: Mapping[str, Any]) -> str:
    sections: dict[str, list[str]] = {}
    for key, value in remedy.items():
        section, _, name = key.partition(".")
        shown = value
        if isinstance(value, Mapping):
            shown = "{" + ", ".join(f"{a}: {b}" for a, b in value.items()) + "}"
        sections.setdefault(section, []).append(f"{name}: {shown}")
    return ", ".join(f"{section}: {{{', '.join(keys)}}}" for section, keys in sections.items())


@dataclass(frozen=True)
class Log:
    """A recording read under some conventions, SI."""

    samples: Samples
    fixes: Fixes
    imu: ImuConvention = conventions.IMU_AS_DUE
    gnss: GnssConvention = conventions.GNSS_AS_DUE
    latency: float | None = None
    """Latency of the fixes, s; None: to be tuned."""
    first: float = -np.inf
    """First time for the checks of the sensors, s; `last` likewise."""
    last: float = np.inf
    sentences: bool = False
    """The fixes are NMEA, which fixes units and axes; the only correction is a time offset."""
    declared: frozenset[str] = frozenset()
    """Keys of a triad's axes that the log has: they are known, even if the motion does not show them."""


OF_HEIGHTS = "sign of the vertical velocity, unit of the height"
OF_SENSORS = "signs, columns and axes of the sensors, unit of the gyros, clocks"


def relative_units(units: dict[str, float], written: str) -> dict[str, float]:
    """The other units, each over the one that values were read in."""
    return {unit: factor / units[written] for unit, factor in units.items() if unit != written}


def without_seem(words: str) -> str:
    """The statement of a mistake as a noun phrase."""
    has = ((" seem to have ", " with "), (" seems to have ", " with "))
    for seem, is_so in (*has, (" seem to be ", " "), (" seem to ", " "), (" seems ", " ")):
        words = words.replace(seem, is_so)
    return words
