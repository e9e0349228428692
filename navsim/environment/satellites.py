"""The satellites of a landing scenario: design constellations, or real ones from files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from navsim.gnss import timescales
from navsim.gnss.constellations.constellation import Constellation
from navsim.gnss.constellations.nominal import design
from navsim.gnss.constellations.systems import CLOCKS, NAMES, SYSTEMS, System
from navsim.gnss.signals import Satellites
from navsim.gnss.sky import Horizon
from navsim.results import files
from navsim.scenario.landing import Landing
from navsim.scenario.sky import LENIENT, SOURCES_FROM_FILES
from navsim.scenario_files.source import Document, InputError, Place, Problem, dotted


def read_satellites(
    scenario: Landing, document: Document, warnings: list[str]
) -> tuple[tuple[Satellites, ...], Landing]:
    """The constellations of the sky section, and the scenario with its files' checksums written into it.

    Raises InputError for files that cannot be used, or have nothing for the time of the scenario.
    """
    sky = scenario.sky
    utc = scenario.epoch.timestamp()
    key = sky.source
    wanted = sky.wanted()
    designed = [system for system in SYSTEMS if key in ("nominal", f"nominal-{system.name}")]
    constellations = [design(system, utc) for system in designed if key != "nominal" or system in wanted]
    if key in SOURCES_FROM_FILES:
        files = _Files(scenario, document, key)
        for name in getattr(sky, key):
            constellations += files.read(name, _READERS[key], utc, warnings)
        scenario = files.with_checksums()
        if not constellations:
            where = document.place(("sky", key))
            message = f"no satellite of {' or '.join(s.name for s in wanted)}{''.join(f'; {w}' for w in warnings)}"
            raise InputError([Problem(where, f"sky.{key}", message)])
    others = [c for c in constellations if c.system not in wanted]
    constellations = [c for c in constellations if c.system in wanted]
    unused: dict[str, list[str]] = {}
    if others and not sky.systems:
        unused[_UNNAMED] = [f"{c.system.name} ({len(c.names)} satellites)" for c in others]
    if not constellations:
        where = document.place(("sky", "systems"))
        named = ", ".join(s.name for s in wanted)
        remarks = "".join(f"; {remark}" for remark in (*warnings, *_not_used(unused)))
        message = f"`source: {key}` has no satellite of {named}{remarks}"
        raise InputError([Problem(where, "sky.systems", message)])
    there = {c.system for c in constellations}
    if sky.systems and (lacking := [s.name for s in wanted if s not in there]):
        where = document.place(("sky", "systems"))
        message = f"`source: {key}` has no satellite of {' or '.join(lacking)}{''.join(f'; {w}' for w in warnings)}"
        raise InputError([Problem(where, "sky.systems", message)])
    if key == "almanac":
        _warn_of_age(sky.almanac_warning_days, constellations, float(timescales.gps_from_utc(utc)), warnings)
    if sky.broadcast:
        last = float(timescales.utc_from_gps(timescales.gps_from_utc(utc) + scenario.duration_s))
        constellations = [c.broadcast(utc, last) for c in constellations]
    groups = tuple(_group(scenario, document, c, warnings, unused) for c in constellations)
    warnings += _not_used(unused)
    names = [name for group in groups for name in group.names]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        where = document.place(("sky", key))
        raise InputError([Problem(where, f"sky.{key}", f"more than one file has {', '.join(twice)}")])
    return groups, scenario


def horizon_of(scenario: Landing, document: Document) -> tuple[Horizon | None, Landing]:
    """The horizon that a scenario names, if any, and the scenario with its file's checksum written into it.

    Raises InputError for a file that cannot be used.
    """
    sky = scenario.sky
    if sky.horizon is None:
        return None, scenario
    from navsim.formats.horizon import read_horizon
    from navsim.formats.text import FileError

    key = ("sky", "horizon")
    path, place = document.resolve(key, sky.horizon), document.place(key)
    try:
        checksum, horizon = files.checksum(path), read_horizon(path)
    except FileError as error:
        at = Place(str(path), error.line, 1) if error.line else place
        raise InputError([Problem(at, "sky.horizon", f"{sky.horizon}: {error.message} (named at {place})")]) from None
    except OSError as error:
        message = f"{sky.horizon}: cannot be read: {error.strerror or error} ({path})"
        raise InputError([Problem(place, "sky.horizon", message)]) from None
    if sky.horizon_sha256 not in (None, checksum):
        message = f"{sky.horizon} has the checksum {checksum}, not this one"
        raise InputError([Problem(document.place(("sky", "horizon_sha256")), "sky.horizon_sha256", message)])
    pinned = sky.model_copy(update={"horizon_sha256": checksum})
    return horizon, scenario.model_copy(update={"sky": pinned})


_LONGEST_WORD = 14.0 * timescales.DAY
"""From the reference time of an offset between times of systems on, s, for which its rate holds."""


class _Read(NamedTuple):
    """Constellations of a file, warnings, and its lines with the offsets of system times from GPS time, with their
    numbers."""

    constellations: Sequence[Constellation]
    remarks: Sequence[str]
    offsets: Mapping[System, tuple[int, str]] = MappingProxyType({})


# readers are imported only for scenarios with files


def _read_almanac(path: Path, utc: float, scenario: Landing) -> _Read:
    from navsim.formats.almanac import read_almanac
    from navsim.formats.text import FileError

    told = next((system for system in SYSTEMS if system.name == scenario.sky.almanac_system), None)
    found = read_almanac(path, utc, told)
    if found.untitled:
        raise FileError(
            0,
            f"{found.untitled} of its two-line elements have no names, so their system is unknown; give "
            f"sky.almanac_system ({' or '.join(NAMES)}), or a file with names",
        )
    return _Read(found.constellations, found.not_used)


def _read_navigation(path: Path, utc: float, scenario: Landing) -> _Read:
    from navsim.formats.rinex_nav import read_nav

    sky = scenario.sky
    found = read_nav(path, sky.skip_bad_records, sky.wanted())
    remarks = [
        f"not used: {of.title} has {sent} alone, not {of.message}; `sky.galileo_message: {sent.lower()}` uses it"
        for of, sent in found.without_usual().items() if of not in sky.messages()
    ]  # fmt: skip
    return _Read(found.constellations(sky.messages()), [*found.left_out, *remarks], found.offsets)


def _read_orbits(path: Path, utc: float, scenario: Landing) -> _Read:
    from navsim.formats.sp3 import read_sp3

    table = read_sp3(path, scenario.sky.skip_bad_records)
    start = float(timescales.gps_from_utc(utc))
    missing = table.missing(start, start + scenario.duration_s, scenario.sky.wanted())
    return _Read([orbits for orbits in map(table.of, SYSTEMS) if orbits.names], [*table.left_out, *missing])


_READERS: dict[str, Callable[[Path, float, Landing], _Read]] = {
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
        self.offsets: list[tuple[str, Path, Mapping[System, tuple[int, str]]]] = []

    def read(
        self, name: str, reader: Callable[[Path, float, Landing], _Read], utc: float, warnings: list[str]
    ) -> Sequence[Constellation]:
        from navsim.formats.text import FileError

        place = ("sky", self.key)
        path = self.document.resolve(place, name)
        try:
            checksum = files.checksum(path)
            read = reader(path, utc, self.scenario)
        except FileError as error:
            curable = error.salvageable and self.key in LENIENT
            cure = "; `sky.skip_bad_records: true` takes the intact part" if curable else ""
            message = f"not a usable file of satellites: {error.message}{cure}"
            raise self._wrong(name, path, message, error.line) from None
        except OSError as error:
            raise self._wrong(name, path, f"cannot be read: {error.strerror or error} ({path})") from None
        number = len(self.found)
        if self.wanted is not None and (number >= len(self.wanted) or checksum != self.wanted[number]):
            raise self._wrong(name, path, f"has the checksum {checksum}, not the one of sky.{self.key}_sha256")
        self.found.append(checksum)
        warnings += [f"{name}: {remark}" for remark in read.remarks]
        self.offsets.append((name, path, read.offsets))
        return read.constellations

    def with_checksums(self) -> Landing:
        """The scenario with their checksums, and the offsets of times that it takes from them as numbers."""
        sky = self.scenario.sky.model_copy(update={f"{self.key}_sha256": tuple(self.found)})
        signals, numbers = self.scenario.signals, dict(self.scenario.signals.system_offsets_ns)
        for name, value in signals.system_offsets_ns.items():
            if value != "broadcast":
                continue
            numbers[name] = round(signals.gps_offset_ns + 1e9 * self._time_offset(name), 6)
        signals = signals.model_copy(update={"system_offsets_ns": numbers})
        return self.scenario.model_copy(update={"sky": sky, "signals": signals})

    def _time_offset(self, system: str) -> float:
        """Time of a system less GPS time, s, at the epoch, by the file whose word is nearest to it. Raises
        InputError."""
        from navsim.formats.rinex_nav import TimeOffset, time_offset
        from navsim.formats.text import FileError

        now = float(timescales.gps_from_utc(self.scenario.epoch.timestamp()))
        nearest: TimeOffset | None = None
        for name, path, lines in self.offsets:
            for line in (line for of, line in lines.items() if of.name == system):
                try:
                    found = time_offset(path, *line)
                except FileError as error:
                    raise self._wrong(name, path, error.message, error.line) from None
                if nearest is None or abs(now - found.reference) < abs(now - nearest.reference):
                    nearest = found
        key, text = ("signals", "system_offsets_ns", system), ""
        if nearest is None:
            text = f"no header of sky.navigation has the offset of {system} time (TIME SYSTEM CORR); give a number"
        elif abs(now - nearest.reference) > _LONGEST_WORD:
            days = abs(now - nearest.reference) / timescales.DAY
            text = f"the {system} time offset of sky.navigation is {days:.0f} days away from the epoch; give a number"
        if nearest is None or text:
            raise InputError([Problem(self.document.place(key), dotted(key), text)])
        return nearest.at(now)

    def _wrong(self, name: str, path: Path, message: str, line: int = 0) -> InputError:
        named = self.document.place(("sky", self.key))
        if not line:
            return InputError([Problem(named, f"sky.{self.key}", f"{name}: {message}")])
        return InputError([Problem(Place(str(path), line, 1), f"sky.{self.key}", f"{message} (named at {named})")])


def _warn_of_age(limit_days: float, constellations: Sequence[Constellation], gpst: float, warnings: list[str]) -> None:
    for constellation in constellations:
        age = max(abs(gpst - end) for end in constellation.span or (gpst,)) / timescales.DAY
        if age > limit_days:
            warnings.append(
                f"the {constellation.system.name} almanac is {age:.0f} days away from the epoch; satellite positions "
                "may be off"
            )


_UNNAMED, _UNHEALTHY = "sky.systems does not name them", "marked as unhealthy"
_UNKNOWN = "no valid ephemeris at this time"
"""Why satellites are not used."""


def _not_used(unused: dict[str, list[str]]) -> list[str]:
    """One warning of all satellites that are not used, by why; none if all are."""
    told = "; ".join(f"{', '.join(names)} ({why})" for why, names in unused.items())
    return [f"satellites not used: {told}"] if unused else []


def _covered(constellation: Constellation) -> str:
    """The times of a file, and what to do, for an error about a time without any."""
    times = [timescales.utc_text(float(timescales.utc_from_gps(end)))[:16] for end in constellation.span or ()]
    return f"; it covers {' to '.join(times)}: change `epoch`, or give a file of that day" if times else ""


def _group(
    scenario: Landing,
    document: Document,
    constellation: Constellation,
    warnings: list[str],
    unused: dict[str, list[str]],
) -> Satellites:
    """A constellation with the choice of its satellites; unusable ones are added to `unused`, by reason.

    warnings: earlier ones, which may explain why there is none.
    """
    sky = scenario.sky
    if sky.use_unhealthy:
        constellation = constellation.using_unhealthy()
    names, usable = constellation.names, constellation.usable
    start = float(timescales.gps_from_utc(scenario.epoch.timestamp()))
    times = np.array([start, start + scenario.duration_s])
    known = np.isfinite(constellation.state(times)[0][..., 0]).any(axis=0)
    # records marked as such are skipped
    usable &= known | ~np.isfinite(constellation.using_unhealthy().state(times)[0][..., 0]).any(axis=0)
    if not known.any():
        where = document.place(("sky", sky.source))
        of = constellation.system.name
        message = f"has no {of} satellite for the time of the scenario, {scenario.epoch:%Y-%m-%d %H:%M}"
        message += _covered(constellation)
        message += "".join(f"; {w}" for w in warnings)
        raise InputError([Problem(where, f"sky.{sky.source}", message)])
    served = known | ~usable
    for good, why in ((usable, _UNHEALTHY), (served, _UNKNOWN)):
        if not np.all(good):
            unused.setdefault(why, []).extend(n for n, g in zip(names, good, strict=True) if not g)
    chosen = usable & known & np.array([name not in sky.exclude for name in names])
    clock = np.full(len(names), CLOCKS.index(constellation.system.name))
    return Satellites(constellation, names, clock, chosen)
