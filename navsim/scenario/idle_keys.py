"""Keys of a landing that its other settings leave without effect."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from navsim.scenario.approach import PadApproach
from navsim.scenario.filter import SUM
from navsim.scenario.imu import assumed_sensor, lone_correlation_times
from navsim.scenario.sky import SOURCES_FROM_FILES
from navsim.scenario_files.base import Section
from navsim.scenario_files.presets import BEACON_PRESETS, MAGNETOMETER_PRESETS, STATION_PRESETS

if TYPE_CHECKING:
    from navsim.scenario.landing import Landing


def _assumed(truth: Any, given: Any) -> Any:
    """The sensor that the filter assumes, without the correlation time that is not its own."""
    own = None if given is None else given.markov_time_s
    return (truth if given is None else assumed_sensor(truth, given)).model_copy(update={"markov_time_s": own})


def idle_keys(scenario: Landing) -> list[str]:
    """Keys without effect, as messages, where they differ from their defaults."""
    signals, sources, components = scenario.signals, scenario.pseudolites, scenario.filter.gaussian_sum
    jammed, linked = scenario.interference is not None, sources.eirp_dbm is not None
    tracked = jammed or sources.multipath is not None or "cn0" in (signals.range_law, sources.range_law)
    beacons, of_jamming = scenario.beacons, "interference and beacons.bandwidth_mhz"
    of_tracking = "`range_law: cn0`, pseudolites.multipath or interference"
    sections: tuple[tuple[bool, str, Section, Iterable[str], str], ...] = (
        (tracked, "signals.tracking", signals.tracking, type(signals.tracking).model_fields, of_tracking),
        (signals.range_law == "exponential", "signals", signals, ("range_scale_deg",), "`range_law: exponential`"),
        (jammed or linked, "receiver", scenario.receiver, ("noise_figure_db",), "pseudolites.eirp_dbm or interference"),
        (scenario.filter.kind == SUM, "filter.gaussian_sum", components, type(components).model_fields,
         f"`filter.kind: {SUM}`"),
        (scenario.sky.source in SOURCES_FROM_FILES, "sky", scenario.sky, ("use_unhealthy",),
         "satellites of a file, which says whether they are healthy"),
        (not isinstance(scenario.approach, PadApproach) or scenario.wind.turbulence is not None, "wind", scenario.wind,
         ("speed_m_s", "levels"), "another `approach.profile` than pad, which keeps course and attitude in any wind"),
        *((getattr(scenario, name) is not None, "integrity", scenario.integrity, (f"b_nom_{name}_{unit}",), f"`{name}`")
          for name, unit in (("azimuth_station", "m"), ("elevation_station", "deg"), ("dme", "m"))
          if scenario.integrity is not None),
        *(() if beacons is None else ((jammed and beacons.bandwidth_mhz is not None, "beacons", beacons,
                                       ("bandwidth_mhz", "noise_figure_db"), of_jamming),)),
    )  # fmt: skip
    lone = lone_correlation_times(
        "filter.imu",
        _assumed(scenario.imu.gyro, scenario.filter.imu.gyro),
        _assumed(scenario.imu.accelerometer, scenario.filter.imu.accelerometer),
    )
    return [*lone, *_idle_presets(scenario)] + [
        f"{prefix}.{name} is not used: it needs {needed}"
        for used, prefix, section, names, needed in sections
        for name in names
        if not used and getattr(section, name) != type(section).model_fields[name].default
    ]


def _idle_presets(scenario: Landing) -> list[str]:
    """Presets of which the keys beside them leave nothing, as messages."""
    sections = {"beacons": BEACON_PRESETS, "magnetometer": MAGNETOMETER_PRESETS, **STATION_PRESETS}
    return [
        f"{name}.preset: {section.preset} changes nothing: {', '.join(its)} replace all of its values; leave these "
        "keys out, or the preset"
        for name, presets in sections.items()
        if (section := getattr(scenario, name)) is not None and (its := presets.get(section.preset))
        and all(getattr(section, key) != value for key, value in its.items())
    ]  # fmt: skip
