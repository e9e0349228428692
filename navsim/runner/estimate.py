"""Estimate of memory and disk, and of time if a block of the work was timed, with its text."""

from __future__ import annotations

import math
from dataclasses import dataclass

from navsim.runner.machine import Machine

SPREAD = 1.5
"""Factor within which the estimated time is right (`scripts/dry_runs.py`)."""

NUMBER = 8
BASE_MEMORY = 200e6
"""The process with its libraries and kernels, bytes."""
VARIABLE = 2900
"""Overhead of a variable of one dimension in a file, bytes: name, units, chunk index."""
AXIS = 520
"""Additional overhead of a further dimension, bytes."""
TEXTS = 6400
"""Scenario and study in the attributes of a result, bytes."""
BUILT_IN_MEMORY = 64e6
WRITING = 1.3
"""Size of a file in memory while it is written, relative to its numbers."""
BATCH_FILE = 12_000
"""Overhead of a file of partial work, bytes."""


@dataclass(frozen=True)
class Budget:
    """Resources of a study.

    memory_bytes: peak of the process, within a factor of two. result_bytes: the final files, without figures.
    partial_bytes: partial work until the result is complete.
    """

    memory_bytes: float
    result_bytes: float
    partial_bytes: float = 0.0

    @property
    def disk_bytes(self) -> float:
        """The most that lies on disk at once."""
        return self.result_bytes + self.partial_bytes


def lacking(estimate: Budget, here: Machine, kept: float = 0.0) -> list[str]:
    """Missing resources of the machine, in words; kept: bytes of existing partial work."""
    out = []
    if here.memory_bytes is not None and estimate.memory_bytes > here.memory_bytes:
        out.append(f"about {size(estimate.memory_bytes)} of memory; {size(here.memory_bytes)} are free")
    if here.disk_bytes is not None and estimate.disk_bytes - kept > here.disk_bytes:
        out.append(f"about {size(estimate.disk_bytes)} on disk; {size(here.disk_bytes)} are free")
    return out


def estimate_text(estimate: Budget, here: Machine, where: str = "", seconds: float | None = None) -> str:
    """The estimate in words. where: the work is done, if not here. seconds: of the work, by a block that was timed."""
    parts = f", {size(estimate.partial_bytes)} of it until the result is complete" if estimate.partial_bytes else ""
    cores = f"on this machine's {here.cores} core{'' if here.cores == 1 else 's'}"
    time = ""
    if seconds is not None:
        how = f"within a factor of {SPREAD:g}, by a block that was timed"
        time = f"{duration(seconds, 2)} {where or cores} ({how}), "
    return f"{time}about {size(estimate.memory_bytes)} of memory, {size(estimate.disk_bytes)} on disk{parts}"


def size(count: float) -> str:
    """Bytes as text."""
    units = ("bytes", "kB", "MB", "GB", "TB", "PB", "EB")
    which = int(min(math.log10(max(count, 1.0)) / 3.0 + 1e-9, len(units) - 1))
    return f"{_significant(count / 1000.0**which, 2):.12g} {units[which]}"


def duration(seconds: float, digits: int = 1) -> str:
    """Seconds as text."""
    for unit, length, most in (("s", 1.0, 90.0), ("min", 60.0, 90.0), ("h", 3600.0, 48.0), ("days", 86400.0, 700.0)):
        if seconds < most * length:
            return f"about {max(_significant(seconds / length, digits), 1.0):g} {unit}"
    return f"about {_significant(seconds / 3.156e7, digits):g} years"


def _significant(value: float, digits: int) -> float:
    return float(f"{value:.{digits - 1}e}")
