"""Satellites and their reception: section `sky`."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from navsim.gnss.constellations.systems import CLOCKS, GALILEO, GLONASS, NAMES, SYSTEMS, USUAL, System
from navsim.scenario_files.base import (
    DEG,
    Azimuth,
    Checksum,
    DistinctListOf,
    Elevation,
    ListOf,
    PairOf,
    Section,
    one_or_list,
    one_or_more,
    reject,
)

if TYPE_CHECKING:
    from navsim.gnss.signals import FixedDirectionSources
    from navsim.gnss.sky import Horizon, Mask


LENIENT = ("navigation", "orbits")
"""Sources whose files can be read in part."""
SOURCES_FROM_FILES = ("almanac", "navigation", "orbits")
"""Values of `sky.source` that name files by the key of the same name."""

# allowed values follow from the table of systems
if TYPE_CHECKING:
    Clock = str
    Name = str
    Source = str
else:
    Clock = Literal[CLOCKS]
    Name = Literal[NAMES]
    Source = Literal[(*(f"nominal-{name}" for name in NAMES), "nominal", *SOURCES_FROM_FILES, "directions")]


class Direction(Section):
    """A source in a fixed direction."""

    azimuth_deg: Azimuth
    """azimuth of the source, clockwise from true north"""
    elevation_deg: Elevation
    """elevation of the source above the horizon"""
    clock: Clock = GLONASS.name
    """time scale the source keeps, and with it the clock unknown it is solved with"""


class Interference(Section):
    """A jammed part of the sky: sources inside are lost."""

    azimuth_deg: PairOf[Azimuth] = (0.0, 360.0)
    """azimuths of the sector, from, to, clockwise; 350 to 10 goes through north"""
    elevation_deg: PairOf[Elevation] = (-90.0, 90.0)
    """elevations of the sector, from, to"""

    @model_validator(mode="after")
    def _ranges(self) -> Self:
        if self.elevation_deg[0] >= self.elevation_deg[1]:
            raise reject("the lower end comes first", "elevation_deg")
        return self


Files = Annotated[tuple[str, ...], one_or_more(str), one_or_list]
"""A file name or a list of them."""
Checksums = Annotated[tuple[Checksum, ...], one_or_more(Checksum), one_or_list]


class Sky(Section):
    """Positions of satellites, and their reception."""

    source: Source = f"nominal-{GLONASS.name}"
    """nominal: design constellations of `systems`; almanac, navigation, orbits: real satellites from files"""
    almanac: Files | None = None
    """for `source: almanac`: .agl, .agp, YUMA, SEM, two-line elements; one file or a list"""
    almanac_sha256: Checksums | None = None
    """checksum of the file, or a list in their order; when given, another file is refused"""
    almanac_system: Name | None = None
    """system of two-line elements without names; names identify it themselves"""
    navigation: Files | None = None
    """for `source: navigation`: RINEX 2, 3 or 4 broadcast messages, one file or a list; .gz, .bz2, .zip, .Z too"""
    navigation_sha256: Checksums | None = None
    """checksum of the file, or a list in their order; when given, another file is refused"""
    orbits: Files | None = None
    """for `source: orbits`: SP3 precise orbits, one file or a list; packed as messages may be"""
    orbits_sha256: Checksums | None = None
    """checksum of the file, or a list in their order; when given, another file is refused"""
    skip_bad_records: bool = False
    """for `source: navigation` and `orbits`: use the intact part of damaged files, and warn of the rest"""
    systems: DistinctListOf[Name] = ()
    """use only these, each with its own clock unknown; left out: GPS and GLONASS, or that of `nominal-...`"""
    galileo_message: Literal["inav", "fnav"] = "inav"
    """for `source: navigation`: message of Galileo satellites, I/NAV (of E1, E5b) or F/NAV (of E5a)"""
    broadcast: bool = False
    """satellites follow their simulated broadcast messages: GLONASS by state vectors each 30 minutes, integrated as
    receivers do; files exported from the run are then exact"""
    directions: ListOf[Direction] = ()
    """sources X01, X02, ... in fixed directions from the receiver, for `source: directions`"""
    mask_deg: Elevation = 5.0
    """lowest usable elevation; below the horizon, which the antenna sees the lower the higher it is, nothing is
    received"""
    mask_upper_deg: Elevation = 90.0
    """highest usable elevation"""
    horizon: str | None = None
    """file with a table azimuth_deg,elevation_deg of obstacles: signals below its lines are not received"""
    horizon_sha256: Checksum | None = None
    """checksum of that file; when given, another file is refused"""
    interference: ListOf[Interference] = ()
    """sectors of the sky in which nothing is received"""
    exclude: DistinctListOf[str] = ()
    """names of satellites not to use, such as R05"""
    use_unhealthy: bool = False
    """use satellites that the almanac marks as unhealthy"""
    almanac_warning_days: Annotated[float, Field(ge=1e-3, le=1e5)] = 14.0
    """age of an almanac from which on a warning is given"""

    @model_validator(mode="after")
    def _what_the_source_needs(self) -> Self:
        for source in SOURCES_FROM_FILES:
            if self.source == source and not getattr(self, source):
                raise reject(f"`source: {source}` needs the file name here", source)
        if self.skip_bad_records and self.source not in LENIENT:
            raise reject(f"is for `source: {'` and `'.join(LENIENT)}`, not for `{self.source}`", "skip_bad_records")
        if self.source == "directions" and not self.directions:
            raise reject("`source: directions` needs a list of azimuth_deg and elevation_deg here", "directions")
        if self.horizon is None and self.horizon_sha256 is not None:
            raise reject("there is no horizon: give it, or leave the checksum out", "horizon_sha256")
        if self.mask_deg >= self.mask_upper_deg:
            raise reject("must lie below mask_upper_deg", "mask_deg")
        for index, name in enumerate(self.exclude):
            if not (any(s.has(name) for s in SYSTEMS) or re.fullmatch(r"T[0-9A-Z]\d{4}|X\d{2}", name)):
                known = ", ".join(system.numbers for system in SYSTEMS)
                raise reject(f"'{name}' names no source; {known}", "exclude", index)
        return self

    def wanted(self) -> tuple[System, ...]:
        """The systems that are used where the sky has them."""
        named = self.systems or tuple(s.name for s in SYSTEMS if self.source == f"nominal-{s.name}")
        usual = () if named else (*USUAL, *(s for s in SYSTEMS if s.name == self.almanac_system))
        return tuple(s for s in SYSTEMS if s.name in named or s in usual)

    def messages(self) -> dict[System, str]:
        """Systems that fly by another message than their usual one."""
        return {GALILEO: GALILEO.other_messages[0]} if self.galileo_message == "fnav" else {}

    def unused(self) -> list[str]:
        """Keys without effect, as messages."""
        names = (*SOURCES_FROM_FILES, "directions")
        given = [name for name in names if name != self.source and getattr(self, name)]
        out = [f"sky.{name} is not used: sky.source is {self.source}" for name in given]
        usual = type(self).model_fields
        out += [
            f"sky.{key} is not used: sky.source is {self.source}, not almanac"
            for key in ("almanac_system", "almanac_warning_days")
            if self.source != "almanac" and getattr(self, key) != usual[key].default
        ]
        if self.messages() and (self.source != "navigation" or GALILEO not in self.wanted()):
            out.append(f"sky.galileo_message is not used: no {GALILEO.title} satellite flies by messages")
        return out

    def listed(self) -> FixedDirectionSources:
        """The sources in fixed directions."""
        import numpy as np

        from navsim.gnss.signals import FixedDirectionSources

        names = tuple(f"X{i:02d}" for i in range(1, len(self.directions) + 1))
        return FixedDirectionSources(
            names,
            np.array([d.azimuth_deg for d in self.directions]) * DEG,
            np.array([d.elevation_deg for d in self.directions]) * DEG,
            np.array([CLOCKS.index(d.clock) for d in self.directions]),
            np.array([name not in self.exclude for name in names]),
        )

    def mask(self, horizon: Horizon | None = None) -> Mask:
        """The mask in radians, with the horizon of the file that is named."""
        from navsim.gnss.sky import Mask, Sector

        sectors = tuple(
            Sector(
                (s.azimuth_deg[0] * DEG, s.azimuth_deg[1] * DEG),
                (s.elevation_deg[0] * DEG, s.elevation_deg[1] * DEG),
            )
            for s in self.interference
        )
        return Mask(self.mask_deg * DEG, self.mask_upper_deg * DEG, sectors, horizon)
