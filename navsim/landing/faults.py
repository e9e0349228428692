"""Faults that the monitor of a scenario expects."""

from __future__ import annotations

import numpy as np

from navsim.gnss.signals import SignalScenario
from navsim.integrity.araim import Allocation
from navsim.integrity.gbas_station import GbasStation
from navsim.integrity.innovations import InnovationTest
from navsim.integrity.monitoring import ExpectedFault, Monitoring
from navsim.integrity.residuals import ChiSquareTest
from navsim.scenario.ground_stations import StationSection
from navsim.scenario.integrity import GroundGroup, IntegritySection, transmitter_prior
from navsim.scenario.landing import Landing
from navsim.scenario_files.base import DEG
from navsim.simulation.filter_bank import FilterBank


def watching(scenario: Landing, sources: SignalScenario) -> Monitoring | None:
    """Monitor of a scenario, if its runs have one."""
    section = scenario.integrity
    if section is None or not scenario.monitored:
        return None
    names = sources.pseudolites.names
    of_filter = section.method == "filter"
    ground = scenario.ground_names() if of_filter else ()
    beacons = () if scenario.beacons is None or not of_filter else scenario.beacons.names()
    sections = scenario.aiding_sections().values() if of_filter else ()
    stations = {one.name: one.nominal_bias(scenario) for one in sections if isinstance(one, StationSection)}
    systems = _systems(sources)
    # satellites that are not to be used are among the signals all the same
    nominal = {name: section.b_nom_m for of_group, _ in _satellites(sources) for name in of_group}
    nominal |= dict.fromkeys(names, section.b_nom_pseudolite_m) | dict.fromkeys(beacons, section.b_nom_beacon_m)
    nominal |= stations
    drops, asked = section.on_alarm == "drop", section.innovations
    innovations = None if asked is None else InnovationTest(asked.window_s, asked.p_fa)
    if section.method == "chi2":
        test = ChiSquareTest(section.p_fa, section.p_md)
        return Monitoring(
            test, (), nominal, section.sigma_ratio_acc, section.exclusion, drops, innovations,
            station=_station(scenario, sources),
        )  # fmt: skip
    faults = [
        ExpectedFault(name, (name,), section.p_satellite, key="p_satellite")
        for members in systems.values()
        for name in members
    ]
    faults += [
        ExpectedFault(name, (name,), transmitter_prior(section.p_pseudolite), key="p_pseudolite") for name in names
    ]
    faults += [ExpectedFault(name, (name,), transmitter_prior(section.p_beacon), key="p_beacon") for name in beacons]
    faults += [ExpectedFault(name, (name,), transmitter_prior(section.p_station), key="p_station") for name in stations]
    faults += [
        ExpectedFault(
            system, members, section.p_constellations.get(system, section.p_constellation), key="p_constellations"
        )
        for system, members in systems.items()
    ]
    faults += [
        ExpectedFault("+".join(g.members), g.members, g.prior, key="ground_groups")
        for g in _groups(section, names, beacons)
    ]
    return Monitoring(
        Allocation(
            section.p_hmi_v, section.p_hmi_h, section.p_fa_v, section.p_fa_h, section.p_unmonitored_max,
            samples=section.effective_samples,
        ),
        tuple(fault for fault in faults if fault.prior > 0.0), nominal, section.sigma_ratio_acc, section.exclusion,
        drops, innovations, FilterBank.of if of_filter else None, ground,
        _station(scenario, sources),
    )  # fmt: skip


def _station(scenario: Landing, sources: SignalScenario) -> GbasStation | None:
    """Ground station whose B values runs draw, None without."""
    asked, ground = scenario.integrity, scenario.signals.errors.ground_station
    section = None if asked is None or asked.comparison is None else asked.comparison.gbas
    if section is None or not section.drawn:
        return None
    assert ground is not None
    return GbasStation(
        ground.model(), tuple(event for event in sources.events if event.receiver), scenario.runway.heading_deg * DEG,
        scenario.glide_path(), section.approach_service == "D", dict(zip(sources.names, sources.systems, strict=True)),
    )  # fmt: skip


def _groups(section: IntegritySection, *kinds: tuple[str, ...]) -> tuple[GroundGroup, ...]:
    """Transmitters that fail together; kinds: names of the pseudolites, and of the beacons."""
    if section.ground_groups is not None:
        return tuple(section.ground_groups)
    return tuple(GroundGroup(members=names) for names in kinds if len(names) > 1)


def _systems(sources: SignalScenario) -> dict[str, tuple[str, ...]]:
    """Satellites by their system, without excluded ones."""
    found: dict[str, list[str]] = {}
    names = [
        (name, bool(use))
        for of_group, chosen in _satellites(sources)
        for name, use in zip(of_group, chosen, strict=True)
    ]
    for (name, use), system in zip(names, sources.systems, strict=False):
        if use:
            found.setdefault(system, []).append(name)
    return {system: tuple(members) for system, members in found.items()}


def _satellites(sources: SignalScenario) -> list[tuple[tuple[str, ...], np.ndarray]]:
    """Names of satellites, group by group, and which of them the receiver is to use."""
    groups = [(group.names, group.chosen) for group in sources.satellites]
    return groups if sources.listed is None else [*groups, (sources.listed.names, sources.listed.chosen)]
