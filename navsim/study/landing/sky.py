"""The satellites of a landing scenario: design constellations, or real ones from files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from navsim.io import files
from navsim.io.almanac import read_almanac
from navsim.io.rinex_nav import read_nav
from navsim.io.sp3 import read_sp3
from navsim.io.text import FileError
from navsim.models import glonass, glonass_broadcast, gps, timescales, tle
from navsim.models.signals import Satellites
from navsim.scenario.landing import Landing
from navsim.scenario.sky import CLOCKS, LENIENT, SOURCES_FROM_FILES, SYSTEMS, Sky
from navsim.scenario.source import Document, InputError, Place, Problem


def read_satellites(
    scenario: Landing, document: Document, warnings: list[str]
) -> tuple[tuple[Satellites, ...], Landing]:
    """The constellations of the sky section, and the scenario with its files' checksums written into it.

    Raises InputError for files that cannot be used, or have nothing for the time of the scenario.
    """
    sky = scenario.sky
    utc = scenario.epoch.timestamp()
    key = sky.source
    constellations: list[Any] = []
    if key in ("nominal-glonass", "nominal"):
        constellations.append(glonass.Nominal())
    if key in ("nominal-gps", "nominal"):
        constellations.append(gps.nominal(utc))
    if key in SOURCES_FROM_FILES:
        files = _Files(scenario, document, key)
        for name in getattr(sky, key):
            constellations += files.read(name, _READERS[key], utc, warnings)
        scenario = files.with_checksums()
        if not constellations:
            where = document.place(("sky", key))
            message = f"no satellite of {' or '.join(SYSTEMS)}{''.join(f'; {w}' for w in warnings)}"
            raise InputError([Problem(where, f"sky.{key}", message)])
    if sky.systems:
        constellations = [c for c in constellations if c.system in sky.systems]
        if not constellations:
            where = document.place(("sky", "systems"))
            message = f"`source: {key}` has no satellite of {', '.join(sky.systems)}"
            raise InputError([Problem(where, "sky.systems", message)])
    if key == "almanac":
        _warn_of_age(sky.almanac_warning_days, constellations, float(timescales.gps_from_utc(utc)), warnings)
    if sky.broadcast:
        last = float(timescales.utc_from_gps(timescales.gps_from_utc(utc) + scenario.duration_s))
        constellations = [_as_broadcast(c, utc, last) for c in constellations]
    groups = tuple(_group(scenario, document, c, warnings) for c in constellations)
    names = [name for group in groups for name in group.names]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        where = document.place(("sky", key))
        raise InputError([Problem(where, f"sky.{key}", f"more than one file has {', '.join(twice)}")])
    return groups, scenario


_Read = tuple[list[Any], list[str]]
"""Constellations of a file, and what the user should hear of it."""


def _read_almanac(path: Path, utc: float, sky: Sky) -> _Read:
    found = read_almanac(path, utc)
    return _split(found, sky.almanac_system) if isinstance(found, tle.Constellation) else ([found], [])


def _split(elements: tle.Constellation, told: str | None) -> _Read:
    """Two-line elements by system, with warnings of those that are not used; told: the system of those without names.

    Raises FileError where nothing tells the system.
    """
    if tle.UNTITLED in elements.systems and told is None:
        count = elements.systems.count(tle.UNTITLED)
        raise FileError(
            0,
            f"{count} of its two-line elements have no names, which would tell their systems; give "
            f"sky.almanac_system ({' or '.join(SYSTEMS)}), or a file with names",
        )
    said = []
    for system in dict.fromkeys(elements.systems):
        if system not in (*SYSTEMS, tle.UNTITLED):
            titles = ", ".join(t for t, s in zip(elements.titles, elements.systems, strict=True) if s == system)
            why = "of no known system" if system == tle.UNKNOWN else f"of {system}, which navsim does not model"
            said.append(f"not used, {why}: {titles}")
    parts = [elements.of(system, *([tle.UNTITLED] if system == told else [])) for system in SYSTEMS]
    return [part for part in parts if part.names], said


def _read_navigation(path: Path, utc: float, sky: Sky) -> _Read:
    found = read_nav(path, sky.lenient)
    out: list[Any] = []
    if found.glonass is not None:
        out.append(glonass_broadcast.Constellation(found.glonass))
    if found.gps is not None:
        out.append(gps.Constellation(found.gps))
    return out, list(found.left_out)


def _read_orbits(path: Path, utc: float, sky: Sky) -> _Read:
    table = read_sp3(path, sky.lenient)
    return [o for o in (table.of("R", "glonass"), table.of("G", "gps")) if o.names], list(table.left_out)


_READERS: dict[str, Callable[[Path, float, Sky], _Read]] = {
    "almanac": _read_almanac,
    "navigation": _read_navigation,
    "orbits": _read_orbits,
}


class _Files:
    """Reads the files of one key of the sky section, and compares and notes their checksums."""

    def __init__(self, scenario: Landing, document: Document, key: str) -> None:
        self.scenario, self.document, self.key = scenario, document, key
        self.wanted = getattr(scenario.sky, f"{key}_sha256")
        self.found: list[str] = []

    def read(
        self, name: str, reader: Callable[[Path, float, Sky], _Read], utc: float, warnings: list[str]
    ) -> list[Any]:
        place = ("sky", self.key)
        path = self.document.resolve(place, name)
        try:
            checksum = files.checksum(path)
            constellations, remarks = reader(path, utc, self.scenario.sky)
        except FileError as error:
            curable = error.salvageable and self.key in LENIENT
            cure = "; `sky.lenient: true` takes what is whole" if curable else ""
            message = f"not a usable file of satellites: {error.message}{cure}"
            raise self._wrong(name, path, message, error.line) from None
        except OSError as error:
            raise self._wrong(name, path, f"cannot be read: {error.strerror or error} ({path})") from None
        number = len(self.found)
        if self.wanted is not None and (number >= len(self.wanted) or checksum != self.wanted[number]):
            raise self._wrong(name, path, f"has the checksum {checksum}, not the one of sky.{self.key}_sha256")
        self.found.append(checksum)
        warnings += [f"{name}: {remark}" for remark in remarks]
        return constellations

    def with_checksums(self) -> Landing:
        sky = self.scenario.sky.model_copy(update={f"{self.key}_sha256": tuple(self.found)})
        return self.scenario.model_copy(update={"sky": sky})

    def _wrong(self, name: str, path: Path, message: str, line: int = 0) -> InputError:
        named = self.document.place(("sky", self.key))
        if not line:
            return InputError([Problem(named, f"sky.{self.key}", f"{name}: {message}")])
        return InputError([Problem(Place(str(path), line, 1), f"sky.{self.key}", f"{message} (named at {named})")])


def _warn_of_age(limit_days: float, constellations: list[Any], gpst: float, warnings: list[str]) -> None:
    for constellation in constellations:
        age = constellation.age(gpst) / 86400.0
        if age > limit_days:
            warnings.append(
                f"the {constellation.system} almanac is {age:.0f} days away from the epoch; satellite positions may be "
                "off"
            )


def _as_broadcast(constellation: Any, first: float, last: float) -> Any:
    """The constellation by the messages it would send."""
    if isinstance(constellation, (glonass.Almanac, glonass.Nominal)):
        return glonass_broadcast.Constellation(glonass_broadcast.messages(constellation, first, last))
    return constellation


def _group(scenario: Landing, document: Document, constellation: Any, warnings: list[str]) -> Satellites:
    """A constellation with the choice of its satellites; warnings of those that cannot be used."""
    sky = scenario.sky
    if sky.use_unhealthy and hasattr(constellation, "use_unhealthy"):
        constellation = type(constellation)(constellation.records, constellation.reach, True)
    names = constellation.names
    healthy = np.ones(len(names), dtype=bool)
    if hasattr(constellation, "healthy") and not sky.use_unhealthy:
        healthy = constellation.healthy
    start = float(timescales.gps_from_utc(scenario.epoch.timestamp()))
    ends = constellation.state(np.array([start, start + scenario.duration_s]))[0]
    known = np.isfinite(ends[..., 0]).any(axis=0)
    if not known.any():
        where = document.place(("sky", sky.source))
        message = (
            f"has no {constellation.system} satellite for the time of the scenario, {scenario.epoch:%Y-%m-%d %H:%M}"
        )
        raise InputError([Problem(where, f"sky.{sky.source}", message)])
    for good, why in ((healthy, "because the almanac marks them as unhealthy"), (known, "because no message serves")):
        if not np.all(good):
            out = ", ".join(n for n, g in zip(names, good, strict=True) if not g)
            warnings.append(f"not used, {why}: {out}")
    chosen = healthy & known & np.array([name not in sky.exclude for name in names])
    clock = np.full(len(names), CLOCKS.index(constellation.system))
    return Satellites(constellation, names, clock, chosen)
