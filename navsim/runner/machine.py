"""Free resources of the machine for this process: memory, disk, cores."""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from navsim.runner.executor import threads


@dataclass(frozen=True)
class Machine:
    """Free memory and disk for the process, bytes, None if unknown; cores it may use."""

    memory_bytes: float | None
    disk_bytes: float | None
    cores: int


def machine(folder: Path) -> Machine:
    """Free resources; folder: of future files, which need not exist."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        disk = float(shutil.disk_usage(place).free)
    except OSError:  # a file system without this information: a lack of space shows while writing
        disk = None
    return Machine(available_memory(), disk, threads().workers)


def available_memory(proc: Path = Path("/proc"), groups: Path = Path("/sys/fs/cgroup")) -> float | None:
    """Largest memory of the process, including what it has already, bytes; None if unknown.

    It is the least of the machine's free memory and the limits of its control groups (v1 or v2) and of the process.
    """
    own = (_integer(proc / "self/statm", 1) or 0) * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 0
    limits = [_process_limit(proc), *(left + own for left in _group_memory(proc, groups))]
    left = _field(proc / "meminfo", "MemAvailable:")
    limits.append(None if left is None else 1024.0 * left + own)
    if left is None and "SC_PHYS_PAGES" in getattr(os, "sysconf_names", {}):
        limits.append(float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE"))
    return min((limit for limit in limits if limit is not None), default=None)


def _process_limit(proc: Path) -> float | None:
    """Remaining address space of the process, bytes."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return None
    page = os.sysconf("SC_PAGE_SIZE")
    mapped, held = ((_integer(proc / "self/statm", i) or 0) * page for i in (0, 1))
    return float(limit - mapped + held)


def usable_cores(proc: Path = Path("/proc"), groups: Path = Path("/sys/fs/cgroup")) -> float:
    """Cores that the process may use at once, by its affinity and the limits of its control groups (v1 or v2)."""
    limits = [float(threads().workers)]
    for place, version2 in _control_groups(proc, groups, "cpu"):
        quota = _integer(place / ("cpu.max" if version2 else "cpu.cfs_quota_us"))
        period = _integer(place / "cpu.max", 1) if version2 else _integer(place / "cpu.cfs_period_us")
        if quota is not None and period:
            limits.append(quota / period)
    return min(limits)


def _group_memory(proc: Path, groups: Path) -> list[float]:
    """Remaining memory of the control groups of the process, bytes."""
    found = []
    for place, version2 in _control_groups(proc, groups, "memory"):
        names = ("memory.max", "memory.current") if version2 else ("memory.limit_in_bytes", "memory.usage_in_bytes")
        most, used = _integer(place / names[0]), _integer(place / names[1])
        if most is not None and used is not None and most < 2**60:
            # the cache of files is given up before anything else
            cache = _field(place / "memory.stat", "inactive_file") or 0.0
            found.append(float(most) - used + cache)
    return found


def _control_groups(proc: Path, groups: Path, controller: str) -> Iterator[tuple[Path, bool]]:
    """Folders of the process's control groups that limit a resource (controller); whether they are of version 2."""
    for line in _lines(proc / "self/cgroup"):
        parts = line.split(":", 2)
        if len(parts) < 3 or (parts[1] and controller not in parts[1].split(",")):
            continue
        root = groups / controller if parts[1] else groups
        folder = root / parts[2].lstrip("/")
        # a container often has its own group as the root, whatever the process file contains
        for place in (folder, *(parent for parent in folder.parents if parent == root or root in parent.parents)):
            yield place, not parts[1]


def _lines(file: Path) -> list[str]:
    try:
        return file.read_text().splitlines()
    except (OSError, UnicodeDecodeError):  # another system: without such a file nothing is known
        return []


def _integer(file: Path, column: int = 0) -> int | None:
    words = " ".join(_lines(file)).split()
    return int(words[column]) if len(words) > column and words[column].isdecimal() else None


def _field(file: Path, name: str) -> float | None:
    words = next((line.split() for line in _lines(file) if line.startswith(name)), [])
    return float(words[1]) if len(words) > 1 and words[1].isdecimal() else None
