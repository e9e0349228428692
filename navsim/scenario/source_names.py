"""Names of sources: events, monitors, tables, figures and exports tell sources apart by their names alone."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from navsim.gnss.constellations.systems import SYSTEMS
from navsim.scenario.ground_stations import StationSection
from navsim.scenario_files.base import reject

if TYPE_CHECKING:
    from navsim.scenario.landing import Landing

_WITHOUT_NUMBER = re.compile(r"T[0-9A-Z]\d{4}|X\d{2}")
"""Names of satellites that only their catalogue number identifies, and of sources in fixed directions."""


def check_source_names(landing: Landing) -> None:
    """Raise for a pseudolite, beacon or jammer that has the name of another source, sensor or group of sources."""
    from navsim.gnss.events import BEACONS, EVERY, PSEUDOLITES

    taken = {
        name: "the ground station" if isinstance(section, StationSection) else "the sensor"
        for name, section in landing.aiding_sections().items()
    }
    taken |= dict.fromkeys((EVERY, PSEUDOLITES, BEACONS), "all sources of that kind")
    taken |= {system.name: f"all satellites of {system.title}" for system in SYSTEMS}
    named: list[tuple[str, str, tuple[str | int, ...]]] = []
    for kind, its in (("pseudolite", landing.pseudolites), ("beacon", landing.beacons)):
        for i, name in enumerate(() if its is None else its.names()):
            site = its.sites[i] if its is not None and its.sites else None
            own = () if site is None else ("sites", i) if site.name is None else ("sites", i, "name")
            named.append((name, f"a {kind}", (f"{kind}s", *own)))
    for i, jammer in enumerate(() if landing.interference is None else landing.interference.jammers):
        named.append((jammer.name, "a jammer", ("interference", "jammers", i, "name")))
    for name, what, path in named:
        if any(system.has(name) for system in landing.sky.wanted()) or _WITHOUT_NUMBER.fullmatch(name):
            taken[name] = "a satellite"
        if name in taken:
            text = f"'{name}' is also the name of {taken[name]}: give one that no other pseudolite, beacon, jammer, "
            raise reject(f"{text}satellite, ground station or sensor has, nor all sources of a kind", *path)
        taken[name] = what
