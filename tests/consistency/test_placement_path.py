"""Placements are judged by the landing's own signals: the placement path against the landing, over every setting."""

from __future__ import annotations

import datetime
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, event, example, given, reject, settings
from hypothesis import strategies as st

from navsim.environment.sources import on_glide
from navsim.geodesy.earth import ecef_from_llh
from navsim.gnss.constellations.systems import CLOCKS
from navsim.gnss.pseudolite import NEAREST, TRACK_STEP, Track
from navsim.landing.case import world_of
from navsim.landing.result_groups import start_result
from navsim.landing.study import covariance_analysis, covariance_result
from navsim.optimization import problem as objective
from navsim.optimization.scenario import Optimize
from navsim.results.builder import ResultBuilder
from navsim.results.schema import COVARIANCE
from navsim.runner.findings import LANDING
from navsim.scenario.landing import Landing
from navsim.scenario.load import read_study
from navsim.scenario.site_clearance import track_of
from navsim.scenario_files.base import Section
from navsim.scenario_files.source import InputError
from navsim.simulation.landing_covariance import AnalysisError
from navsim.simulation.measurements import receiver_fixes
from navsim.simulation.placement_geometry import Geometry
from navsim.simulation.shared_truth import SharedTruth
from navsim.sweeps.outputs import beacon_outputs
from navsim.sweeps.plan import plan
from navsim.sweeps.scenario import BEACON_OUTPUTS, DOP_OUTPUTS, FILTER_OUTPUTS, Sweep
from navsim.sweeps.study import COMPUTED, INVALID, NO_FIX, SweepStudy, filter_outputs
from tests.helpers import SCENARIOS, case, scenario

FLAG = st.booleans()
METRES = st.sampled_from([0.5, 2.23606797749979])
STRENGTH = st.sampled_from([30.0, 45.0])
LATITUDE = st.sampled_from([56.0, -0.01, 75.0])
LONGITUDE = st.sampled_from([37.0, 179.999])
DIRECTION = st.fixed_dictionaries(
    {"azimuth_deg": st.integers(0, 35).map(lambda n: 10 * n), "elevation_deg": st.integers(1, 8).map(lambda n: 10 * n)},
    optional={"clock": st.sampled_from(CLOCKS)},
)
SITE = st.one_of(
    st.fixed_dictionaries(
        {"s_m": st.sampled_from([-2000, -80, 300]), "l1_m": st.sampled_from([-1000, 200, 4000])},
        optional={"height_m": st.sampled_from([-20.0, 40.0])},
    ),
    st.just({"lat_deg": 56.01, "lon_deg": 37.02}),
)

JAMMER = {"name": "J1", "place": {"lat_deg": 56.05, "lon_deg": 37.02}, "centre_mhz": 1590.0}
DRAWN: dict[str, st.SearchStrategy[Any]] = {
    "epoch": st.sampled_from(["2018-09-13T12:00:00Z", "2018-09-13T04:17:03.5Z"]),
    "duration_s": st.sampled_from([8.0, 30.0, 61.0, 62.3]),
    "runway.heading_deg": st.sampled_from([0.0, 233.0]),
    "runway.height_m": st.sampled_from([0.0, 800.0]),
    "runway.aim_point_m": st.sampled_from([0.0, 300.0]),
    "runway.slope_percent": st.sampled_from([0.0, 1.5]),
    "runway.threshold.lat_deg": LATITUDE,
    "runway.threshold.lon_deg": LONGITUDE,
    "approach.start.lat_deg": LATITUDE,
    "approach.start.lon_deg": LONGITUDE,
    "approach.start_height_m": st.sampled_from([120.0, 153.0]),
    "approach.glide_slope_deg": st.sampled_from([3.0, 5.0]),
    "approach.speed_start_kmh": st.sampled_from([130.0, 400.0]),
    "approach.speed_touchdown_kmh": st.sampled_from([80.0, 120.0]),
    "approach.angle_of_attack_deg": st.sampled_from([3.0, -5.0]),
    "approach.pitch": st.sampled_from(["path", "level"]),
    "approach.transition_time_s": st.sampled_from([0.5, 2.0]),
    "approach.lead_in_s": st.sampled_from([5.0, 35.0]),
    "approach.capture_s": st.sampled_from([4.0, 6.0]),
    "approach.flare_height_m": st.sampled_from([4.0, 6.0]),
    "approach.flare_blend_s": st.sampled_from([0.5, 1.0]),
    "approach.touchdown_sink_m_s": st.sampled_from([0.5, 0.8]),
    "approach.settle_s": st.sampled_from([0.5, 1.0]),
    "approach.rollout_deceleration_m_s2": st.sampled_from([0.0, 0.5]),
    "approach.turn_rate_deg_s": st.sampled_from([2.0, 6.0]),
    "approach.period_s": st.sampled_from([20.0, 30.0]),
    "approach.roll_s": st.sampled_from([1.0, 2.0]),
    "approach.circuit.side": st.sampled_from(["left", "right"]),
    "approach.circuit.begin_m": st.sampled_from([-1500.0, 0.0]),
    "approach.circuit.offset_m": st.sampled_from([700.0, 800.0]),
    "approach.circuit.final_m": st.sampled_from([2500.0, 4000.0]),
    "approach.bank_deg": st.sampled_from([20.0, 30.0]),
    "approach.taxi_speed_kmh": st.sampled_from([0.0, 30.0]),
    "approach.go_around.height_m": st.sampled_from([30.0, 60.0]),
    "approach.go_around.load_factor": st.sampled_from([1.1, 1.5]),
    "approach.go_around.climb_deg": st.sampled_from([3.0, 10.0]),
    "approach.ending": st.sampled_from(["flare", "paper", "none"]),
    "wind.speed_m_s": st.sampled_from([0.0, 7.0]),
    "wind.from_deg": st.sampled_from([0.0, 80.0]),
    "wind.profile": st.sampled_from(["constant", "log", "power"]),
    "approach.speed_is": st.sampled_from(["ground", "air"]),
    "imu.rate_hz": st.sampled_from([10.0, 12.5]),
    "sky.source": st.sampled_from(
        ["nominal-glonass", "nominal-gps", "nominal", "directions", "directions", "almanac", "navigation"]
    ),
    "sky.almanac": st.sampled_from([str(SCENARIOS / "data" / f"nominal.{kind}") for kind in ("agl", "alm")]),
    "sky.navigation": st.just(str(SCENARIOS / "data" / "nominal.rnx")),
    "sky.systems": st.sampled_from([["glonass"], ["glonass", "gps"]]),
    "sky.broadcast": FLAG,
    "sky.directions": st.lists(DIRECTION, min_size=1, max_size=8),
    "sky.mask_deg": st.sampled_from([1.0, 5.0, 20.0]),
    "sky.mask_upper_deg": st.sampled_from([60.0, 90.0]),
    "sky.interference": st.sampled_from(
        [[{"azimuth_deg": [300, 80]}], [{"azimuth_deg": [90, 200]}, {"elevation_deg": [40, 90]}]]
    ),
    "events": st.sampled_from(
        [
            [{"what": "silence", "sources": ["pseudolites"], "at_s": 3.0, "until_s": 20.0}],
            [{"what": "silence", "sources": ["all"], "at_s": 5.0, "until_s": 7.0}],
            [{"what": "spoof", "sources": ["all"], "offset_ned_m": [9.0, -5.0, 3.0]}],
        ]
    ),
    "interference.jammers": st.sampled_from(
        [
            [JAMMER | {"eirp_dbw": 5.0, "waveform": "noise", "bandwidth_mhz": 60.0, "on_s": [[3, 20]]}],
            [JAMMER | {"eirp_dbw": 30.0, "waveform": "matched"}],
            [JAMMER | {"eirp_dbw": 5.0, "waveform": "sweep", "bandwidth_mhz": 60.0, "sweep_s": 7.0}],
        ]
    ),
    "interference.pseudolites.lines": st.just(False),
    "interference.pseudolites.isolation_db": st.just(21.1),
    "interference.pseudolites.pulses.duty": st.just(0.2),
    "interference.pseudolites.pulses.blanking": FLAG,
    "interference.pseudolites.pulses.correlation": st.sampled_from(["gated", "ungated"]),
    "interference.horizon": st.just([{"azimuth_deg": [0.0, 90.0], "elevation_deg": 3.0, "distance_m": 700.0}]),
    "terrain": st.sampled_from(
        [
            [{"azimuth_deg": [0.0, 180.0], "elevation_deg": 4.0, "distance_m": 600.0}],
            [{"ends": [{"lat_deg": 56.01, "lon_deg": 36.98}, {"lat_deg": 56.01, "lon_deg": 37.03}], "height_m": 90}],
        ]
    ),
    "interference.front_end_mhz": st.sampled_from([[[1570.0, 1610.0]], [[1590.0, 1615.0]]]),
    "sky.exclude": st.sampled_from([["R05", "G02"], ["X01"]]),
    "sky.use_unhealthy": FLAG,
    "pseudolites.frame": st.sampled_from(["table1", "runway"]),
    "pseudolites.height_m": st.sampled_from([0.0, 12.0]),
    "pseudolites.clock": st.sampled_from(CLOCKS),
    "pseudolites.clock_offset_ns": st.just(20.0),
    "pseudolites.survey_error_m": st.just([1.0, -2.0, 3.0]),
    "pseudolites.survey_sigma_m": st.just(0.4),
    "pseudolites.clock_sigma_ns": st.just(3.0),
    "pseudolites.clock_noise.h0": st.just(2e-20),
    "pseudolites.clock_noise.h_minus2": st.just(1e-22),
    "pseudolites.clock_noise.oscillator": st.just("tcxo"),
    "pseudolites.range_bias_sigma_m": st.just(0.5),
    "pseudolites.clock_drift_sigma_ppb": st.just(2.0),
    "pseudolites.clock_age_s": st.just(60.0),
    "pseudolites.range_sigma_m": METRES,
    "pseudolites.range_rate_sigma_m_s": METRES,
    "pseudolites.cn0_dbhz": STRENGTH,
    "pseudolites.cn0_reference_m": st.just(1000.0),
    "pseudolites.eirp_dbm": st.sampled_from([-20.0, 20.0]),
    "pseudolites.pattern.azimuth_deg": st.just([40.0]),
    "pseudolites.pattern.elevation_deg": st.just([-5.0, 10.0]),
    "pseudolites.pattern.gain_db": st.just([[0.0, -8.0]]),
    "pseudolites.range_law": st.sampled_from(["constant", "cn0"]),
    "pseudolites.carrier_mhz": st.sampled_from([1575.42, 1602.0]),
    "pseudolites.air.truth_refractivity_n": st.just(340.0),
    "pseudolites.air.correction": st.sampled_from(["none", "refractivity"]),
    "pseudolites.air.corrected_refractivity_n": st.just(315.0),
    "pseudolites.air.refractivity_sigma_n": st.just(45.0),
    "pseudolites.multipath.permittivity": st.just(30.0),
    "pseudolites.multipath.conductivity_s_m": st.just(0.1),
    "pseudolites.multipath.polarisation": st.sampled_from(["circular", "vertical", "horizontal"]),
    "pseudolites.differential.latency_s": st.sampled_from([0.0, 30.0]),
    "pseudolites.differential.sigma_m": st.sampled_from([0.0, 0.8]),
    "pseudolites.differential.site": st.just("PL1"),
    "pseudolites.differential.link.rate_hz": st.sampled_from([0.1, 2.0]),
    "pseudolites.differential.link.max_age_s": st.sampled_from([31.0, 40.0]),
    "pseudolites.differential.link.loss": st.sampled_from([0.0, 0.5, 1.0]),
    "signals.range_sigma_m": METRES,
    "signals.range_law": st.sampled_from(["constant", "inverse-sine", "exponential", "cn0"]),
    "signals.range_scale_deg": st.just(20.0),
    "signals.range_rate_sigma_m_s": METRES,
    "signals.cn0_dbhz": STRENGTH,
    "signals.tracking.spacing_chips": st.just(0.1),
    "signals.tracking.bandwidth_hz": st.just(4.0),
    "signals.tracking.integration_s": st.just(0.001),
    "signals.tracking.gain_horizon_db": st.just(-3.0),
    "signals.ionosphere.alpha": st.just([2e-8, 1e-8, -5e-8, -5e-8]),
    "signals.ionosphere.beta": st.just([9e4, 1e4, -2e5, -6e4]),
    "signals.ionosphere.truth_scale": st.just(3.0),
    "signals.ionosphere.corrected": FLAG,
    "signals.troposphere.truth_scale": st.just(1.1),
    "signals.troposphere.correction": st.sampled_from(["none", "saastamoinen", "mops"]),
    "signals.ephemeris.orbit_sigma_m": st.just([1.0, 2.0, 3.0]),
    "signals.ephemeris.clock_sigma_m": st.just(2.0),
    "signals.preset": st.sampled_from(["open-sky", "white"]),
    "signals.gps_offset_ns": st.just(30.0),
    "receiver.rate_hz": st.sampled_from([0.4, 1.0, 2.0, 10.0]),
    "receiver.latency_s": st.sampled_from([0.0, 0.3, 2.0]),
    "receiver.lever_arm_m": st.sampled_from([[0.0, 0.0, 0.0], [3.0, -1.0, -0.5]]),
    "receiver.noise_figure_db": st.just(3.0),
    "receiver.antenna.mount": st.sampled_from(["top", "belly"]),
    "receiver.antenna.elevation_deg": st.just([-40.0, 80.0]),
    "receiver.antenna.gain_dbi": st.just([-9.0, 4.0]),
    "receiver.antenna.mask_deg": st.sampled_from([-90.0, -10.0]),
    "receiver.clock_offset_us": st.sampled_from([0.0, 100.0]),
    "receiver.clock_drift_ppb": st.sampled_from([0.0, 50.0]),
    "receiver.smoothing_s": st.sampled_from([0.0, 0.25, 1.25, 20.0, 1000.0]),
    "receiver.single_clock": FLAG,
}
"""Values of the keys a landing's signals depend on."""
PLACED = st.sampled_from([2, 1, 0, 4]).flatmap(
    lambda n: st.one_of(
        st.fixed_dictionaries({"sites": st.lists(SITE, min_size=n, max_size=n)}),
        st.fixed_dictionaries(
            {
                "count": st.just(min(n, 2)),
                "s_m": st.sampled_from([80.0, 900.0]),
                "l1_m": st.sampled_from([500.0, 5000.0]),
            }
        ),
    )
)
"""Keys that say where pseudolites stand."""
ONE_SATELLITE = {"sky.source": "directions", "sky.directions": [{"azimuth_deg": 0, "elevation_deg": 90}]}
NEAR_FAR = {"interference.pseudolites": {}, "pseudolites.cn0_reference_m": 1000.0, "pseudolites.carrier_mhz": 1602.0}
PLACE = st.tuples(st.sampled_from([-2000.0, -80.0, 300.0]), st.sampled_from([-1000.0, 200.0, 4000.0])).map(list)
EXAMPLES, PHASES = 3, (Phase.explicit, Phase.generate)
ALIKE = {
    "kind": "a name", "version": "a name", "title": "a name",
    "method": "how the filter is judged", "box.": "the same", "requirements": "the same",
    "integrity.": "how fixes are watched",
    "interference.lock.": "weaker or stronger jammers", "interference.rate_bandwidth_hz": "range rates",
    "imu.": "inertial sensors",
    "altimeter.": "a sensor beside the receiver", "radio_altimeter.": "the same", "barometric_altimeter.": "the same",
    "magnetometer.": "the same", "beacons.": "the same",
    "azimuth_station.": "the same", "elevation_station.": "the same", "dme.": "the same",
    "runway.bearing_deg": "runway.heading_deg", "runway.bearing_is": "the same", "runway.bearing_year": "the same",
    "runway.declination_deg": "the same", "runway.end.": "the same", "runway.tch_m": "runway.aim_point_m",
    "runway.height_above": "what runway.height_m is above", "runway.geoid_undulation_m": "the same",
    "runway.end_height_m": "runway.slope_percent",
    "initial_errors.": "of the filter", "filter.": "the filter",
    "receiver.clock.": "noise that each run draws",
    "signals.errors.": "those of signals.preset",
    "approach.flight_technical_error.": "the ways of runs, whose route is the same",
    "approach.guidance": "the same", "approach.autopilot.": "the same", "approach.indicator.": "the same",
    "receiver.fix_states.": "fixes that have a state depend on no geometry", "filter.fix_flag": "the same",
    "approach.go_around.on_alarm": "the same", "approach.go_around.delay_s": "the same",
    "approach.go_around.decision_height_m": "the same",
    "wind.turbulence.": "the same", "wind.gusts": "the same", "wind.response.": "the same",
    "wind.roughness_m": "of wind.profile", "wind.exponent": "the same", "wind.levels": "the same",
    "approach.profile": "by the shipped scenarios", "approach.points": "a circuit is of them",
    "imu.from": "the numbers of imu", "signals.from": "those of signals", "signals.hdop": "the same",
    "approach.file": "studies take no recorded flight", "approach.file_sha256": "the same",
    "approach.sigma_m": "the same", "approach.sigma_vertical_m": "the same",
    "approach.go_around.at_s": "approach.go_around.height_m", "approach.go_around.ease_s": "a pull-up's shape",
    "approach.hover_height_m": "a landing on a pad is one more route", "approach.hover_s": "the same",
    "approach.sink_m_s": "the same", "approach.descent_ease_s": "the same", "approach.nose_deg": "the same",
    "approach.brake_ease_s": "how taxiing begins", "approach.taxi_s": "how long it lasts",
    "approach.start_s": "the same", "approach.touchdown_s": "the same",
    "runway.length_m": "for drawings", "runway.width_m": "for drawings",
    "pseudolites.count": "PLACED", "pseudolites.s_m": "PLACED", "pseudolites.l1_m": "PLACED",
    "pseudolites.sites": "PLACED", "pseudolites.differential.link.senders": "names of them",
    "sky.almanac_sha256": "a checksum", "sky.navigation_sha256": "a checksum", "sky.orbits_sha256": "a checksum",
    "signals.system_offsets_ns": "signals.gps_offset_ns of other systems",
    "signals.system_offset_sigma_ns": "what each run draws",
    "sky.galileo_message": "a constellation as the other message makes one",
    "sky.horizon": "a mask of more sectors", "sky.horizon_sha256": "a checksum",
    "sky.almanac_system": "read as an almanac is", "sky.orbits": "a constellation as the messages make one",
    "sky.skip_bad_records": "how files are read", "sky.almanac_warning_days": "a warning",
}  # fmt: skip
"""Keys, or (with a dot behind) sections, that are not drawn, and why."""


def sections(annotation: Any) -> list[type[Section]]:
    """The sections a key may hold, one or none at a time; those in lists are values."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return [annotation]
    if get_origin(annotation) is tuple:
        return []
    return [section for part in get_args(annotation) for section in sections(part)]


def keys(model: type[Section], before: str = "") -> Iterator[str]:
    """The dotted names of all keys."""
    for attribute, field in model.model_fields.items():
        name, inner = field.alias or attribute, sections(field.annotation)
        for section in inner:
            yield from keys(section, f"{before}{name}.")
        if not inner:
            yield before + name


def told(key: str, entry: str) -> bool:
    """Whether an entry of `ALIKE` speaks of a key: it names the key, or the section that has it."""
    return key == entry or (entry.endswith(".") and key.startswith(entry))


def test_every_key_of_a_landing_is_drawn_or_told_why_not() -> None:
    """A key that is added to the schema must be added here; one that is removed, too."""
    known = set(keys(Landing))
    missing = {key for key in known - DRAWN.keys() if not any(told(key, a) for a in ALIKE)}
    assert not missing
    assert known >= DRAWN.keys()
    assert all(any(told(key, a) for key in known) for a in ALIKE)


def study_of(folder: Path, kind: str, settings: dict[str, Any], text: str, name: str = "landing") -> Path:
    """A study file of a shipped scenario."""
    path = folder / f"{kind}.yaml"
    path.write_text(f"kind: {kind}\nversion: 1\nbase: {SCENARIOS / name}.yaml\nset: {json.dumps(settings)}\n{text}")
    return path


def excluded(key: str, drawn: dict[str, Any]) -> bool:
    """Whether a key cannot go together with others that are drawn."""
    if key == "pseudolites.cn0_reference_m":
        return "pseudolites.eirp_dbm" in drawn
    if key.startswith("pseudolites.pattern."):
        needed = ("pseudolites.eirp_dbm", "pseudolites.pattern.elevation_deg", "pseudolites.pattern.gain_db")
        return not {*needed} <= drawn.keys()
    coefficients = {"pseudolites.clock_noise.h0", "pseudolites.clock_noise.h_minus2"}
    if key in coefficients:
        return "pseudolites.clock_noise.oscillator" in drawn or not coefficients <= drawn.keys()
    if key == "pseudolites.clock_age_s":
        wandering = {"pseudolites.clock_noise.oscillator", "pseudolites.clock_drift_sigma_ppb"}
        return not (coefficients <= drawn.keys() or wandering & drawn.keys())
    if key == "interference.pseudolites.isolation_db":
        without = ("interference.pseudolites.pulses", "interference.pseudolites.lines")
        return any(name.startswith(without) for name in drawn)
    return False


def letters_of(drawn: dict[str, Any]) -> str:
    """The letters of the satellites that the sky has."""
    source = drawn.get("sky.source", "nominal-glonass")
    if source == "almanac":
        return "G" if drawn.get("sky.almanac", "").endswith(".alm") else "R"
    return {"nominal-glonass": "R", "nominal-gps": "G", "directions": "X"}.get(source, "RG")


def settings_of(drawn: dict[str, Any], placed: dict[str, Any], name: str) -> dict[str, Any]:
    """Settings of a shipped scenario that can go together, its pseudolites as one section."""
    shipped = scenario(name=name)
    profile = type(shipped.approach).model_fields
    from_threshold = shipped.runway.threshold is not None
    out: dict[str, Any] = {"imu.rate_hz": 10.0, "receiver.rate_hz": 1.0, "pseudolites": dict(placed)}
    if drawn.get("sky.source") == "directions":
        out["sky.directions"] = [{"azimuth_deg": 40 * i, "elevation_deg": 10 + 20 * (i % 3)} for i in range(7)]
    for key in [key for key in drawn if excluded(key, drawn)]:
        drawn = {name: value for name, value in drawn.items() if name != key}
    for key, value in drawn.items():
        section, _, rest = key.partition(".")
        if section == "approach" and rest.split(".")[0] not in profile:
            continue
        if key.startswith("approach.start.") == from_threshold and key.startswith(
            ("approach.start.", "runway.threshold.")
        ):
            continue
        if from_threshold and (key, value) == ("pseudolites.frame", "table1"):
            continue
        if key == "sky.exclude":
            value = [name for name in value if name[0] in letters_of(drawn)]
        if section != "pseudolites":
            out[key] = value
        elif placed.get("sites") or placed.get("count") or not rest.startswith("differential"):
            inner = out["pseudolites"]
            *path, last = rest.split(".")
            for part in path:
                inner = inner.setdefault(part, {})
            inner[last] = value
    return out


def judged(geometry: Geometry, sites: np.ndarray) -> np.ndarray:
    """DOPs and SKO of a placement (k, 3) at every epoch (e, 6)."""
    out = np.empty((len(geometry.receiver), 6))
    for e in range(len(out)):
        here = geometry.at(np.array([e]))
        out[e] = *here.dops(sites[None])[0][:, 0, 0], *here.fix_sigmas(sites[None])[0][:, 0, 0]
    return out


def of_world(world: SharedTruth, glide: np.ndarray) -> np.ndarray:
    """The same of a landing."""
    variance = np.diagonal(world.fix_covariance, axis1=1, axis2=2)
    sums = np.stack([variance.sum(axis=1), variance[:, :2].sum(axis=1), variance[:, 2]], axis=1)
    return np.concatenate([world.dop[:, 1:4], np.sqrt(sums)], axis=1)[glide]


def assert_close(found: np.ndarray, expected: np.ndarray, pdop: np.ndarray) -> None:
    """To 1e-9, and to what a normal matrix of condition PDOP^2 leaves of 16 digits; lost epochs are the same."""
    np.testing.assert_array_equal(np.isnan(found), np.isnan(expected))
    allowed = expected * (1e-9 + 1e-13 * pdop**2)
    assert np.all(np.isnan(expected) | (np.abs(found - expected) <= allowed)), (found, expected)


@pytest.mark.parametrize(
    "name", ["landing", *(pytest.param(n, marks=pytest.mark.long) for n in ("landing_smooth", "s_turn", "circuit"))]
)
@settings(
    max_examples=EXAMPLES,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
    phases=PHASES,
)
@given(st.fixed_dictionaries({}, optional=DRAWN), PLACED)
@example(
    {"receiver.single_clock": True, "pseudolites.clock": "gps", "sky.source": "nominal"},
    {"count": 2, "s_m": 80.0, "l1_m": 500.0},
)
@example({"receiver.smoothing_s": 0.25, "receiver.rate_hz": 10.0}, {"count": 1, "s_m": 80.0, "l1_m": 500.0})
@example(NEAR_FAR, {"count": 2, "s_m": 80.0, "l1_m": 500.0})
@example(
    {"terrain": [{"azimuth_deg": [0, 180], "elevation_deg": 4, "distance_m": 600}]},
    {"sites": [{"s_m": 300, "l1_m": 200}, {"s_m": -80, "l1_m": 4000}]},
)
@example(ONE_SATELLITE | {"pseudolites.clock": "own"}, {"sites": [{"s_m": 300, "l1_m": 200}]})
@example(ONE_SATELLITE, {"sites": [{"s_m": s, "l1_m": 200} for s in (-2000, -80, 300)]})
@example(
    {"pseudolites.air.correction": "refractivity", "pseudolites.air.refractivity_sigma_n": 100.0},
    {"sites": [{"s_m": 300, "l1_m": 200}, {"s_m": -80, "l1_m": 4000}]},
)
def test_placement_path_equals_the_landing(
    tmp_path_factory: pytest.TempPathFactory, name: str, drawn: dict[str, Any], placed: dict[str, Any]
) -> None:
    """DOPs, SKO and lost epochs by both ways of a sweep and by optimize, against the landing and its result."""
    given = settings_of(drawn, placed, name)
    try:
        flown = case(*(f"{key}={json.dumps(value)}" for key, value in given.items()), name=name)
    except InputError as error:
        event(f"refused: {str(error)[:60]}")
        reject()
    world, sites = flown.shared, ecef_from_llh(flown.pseudolites.llh)
    glide = on_glide(flown.scenario, flown.trajectory, world.signals.time)
    expected = of_world(world, glide)
    outputs = of_result(start_result(flown, COVARIANCE), int(np.isnan(expected[:, 0]).sum()))
    event(f"{len(sites)} pseudolites, {name}, solved: {np.isfinite(expected[:, 0]).any()}")

    folder = tmp_path_factory.mktemp("study")
    section = given["pseudolites"]
    corrected = "differential" in section
    by_link = "link" in section.get("differential", {})
    station = by_link or (corrected and any(key.startswith("signals.troposphere") for key in given))
    by_strength, by_smoothing = flown.environment.strength_placed, flown.environment.smoothing_placed
    by = "sites" if "sites" in placed else "l1_m"
    others = {key: value for key, value in section.items() if key != by}
    by_air = flown.environment.air_placed
    known = not (station or by_strength or by_smoothing or by_air)
    for axis, value, rest, alone in (
        (f"pseudolites.{by}", section[by], given | {"pseudolites": others}, known),
        ("duration_s", flown.scenario.duration_s, {k: v for k, v in given.items() if k != "duration_s"}, False),
    ):
        vary = [{"key": axis, "values": [value]}]
        planned = plan(
            *read_study(study_of(folder, "sweep", rest, f"vary: {json.dumps(vary)}\nmethod: dop\n", name), Sweep, []), 1
        )
        assert (planned.geometry is not None) == alone
        rows, _, _ = SweepStudy(planned).batch(0, 1)
        if rows["outcome"][0] == COMPUTED:
            assert_close(np.array([rows[k][0] for k in DOP_OUTPUTS]), outputs, np.nanmax(expected[:, 0], initial=0.0))
        else:
            assert rows["outcome"][0] == NO_FIX
            assert np.isnan(expected).all()
        if planned.geometry is not None:
            assert_close(judged(planned.geometry, sites), expected, expected[:, :1])
    check_fixes(world, glide, expected)

    area = "area: {s_m: [-500, 500], l1_m: [0, 5000]}\npseudolites: [1]\nobjective: pdop\n"
    starts = 1 if given.get("sky.broadcast") or given.get("sky.source") == "navigation" else 2
    period = "period: {hours: 5, count: 2}\n" if starts == 2 else ""
    path = study_of(folder, "optimize", given, area + period, name)
    if corrected:
        with pytest.raises(InputError, match="there is none"):
            objective.problem(*read_study(path, Optimize, []))
        return
    if by_strength:
        with pytest.raises(InputError, match="evaluated from directions alone"):
            objective.problem(*read_study(path, Optimize, []))
        return
    here = objective.problem(*read_study(path, Optimize, []))
    if by_air:
        weighted = study_of(folder, "optimize", given, (area + period).replace("pdop", "fix_vertical"), name)
        with pytest.raises(InputError, match="distances of pseudolites matter"):
            objective.problem(*read_study(weighted, Optimize, []))
        return  # their weight depends on their distance, which is in no geometry
    if by_smoothing:
        return  # how well they are smoothed is in no geometry: of DOPs alone, which the others tell
    found = judged(here.geometry, sites)
    assert_close(found[: len(expected)], expected, expected[:, :1])
    if starts == 2:
        epoch = flown.scenario.epoch + datetime.timedelta(hours=2.5)
        later = of_world(
            world_of(flown.scenario.model_copy(update={"epoch": epoch}), flown.trajectory, flown.environment), glide
        )
        assert_close(found[len(expected) :], later, later[:, :1])


@pytest.mark.parametrize("name", ["landing", pytest.param("landing_smooth", marks=pytest.mark.long)])
@settings(max_examples=2, derandomize=True, suppress_health_check=list(HealthCheck), phases=PHASES)
@given(
    st.fixed_dictionaries({}, optional=DRAWN | {"duration_s": st.sampled_from([50.0, 62.3, 105.0])}),
    st.lists(PLACE, min_size=1, max_size=3, unique_by=tuple),
    st.sampled_from(FILTER_OUTPUTS),
)
def test_an_error_of_the_filter_is_the_landings_own(
    tmp_path_factory: pytest.TempPathFactory, name: str, drawn: dict[str, Any], places: list[list[float]], output: str
) -> None:
    """The objective of a placement, with its flight cut short, against the covariance analysis of the whole landing."""
    drawn = {key: value for key, value in drawn.items() if not key.startswith("pseudolites.differential")}
    drawn |= {"pseudolites.frame": "runway"}
    sites = [{"s_m": s, "l1_m": l1} for s, l1 in places]
    given = settings_of(drawn, {"sites": sites}, name)
    try:
        flown = case(*(f"{key}={json.dumps(value)}" for key, value in given.items()), name=name)
        expected = filter_outputs(covariance_result(flown, covariance_analysis(flown), 1))[output]
    except (InputError, AnalysisError):
        reject()  # nothing to compare with
    text = "area: {s_m: [-500, 500], l1_m: [0, 5000]}\npseudolites: [1]\n"
    text += f"objective: {output}\nheight_m: {drawn.get('pseudolites.height_m', 0.0)}\n"
    study = read_study(study_of(tmp_path_factory.mktemp("study"), "optimize", given, text, name), Optimize, [])
    event(f"{output}: {expected:.3g}")
    if np.isnan(expected):
        with pytest.raises(InputError, match="has no value"):
            objective.problem(*study)
        return
    # sources that are never heard are left out of it: sums are rounded otherwise, and a flight that hardly has a fix
    # enlarges the difference with its errors
    rounding = 1e-9 if expected < 100.0 else 1e-6
    assert objective.problem(*study).objective(np.array([places]))[0] == pytest.approx(expected, rel=rounding)


BEACON = st.fixed_dictionaries(
    {"s_m": st.sampled_from([-400.0, -90.0, 300.0]), "l1_m": st.sampled_from([-900.0, 200.0, 1500.0])},
    optional={"height_m": st.sampled_from([3.0, 25.0])},
)
BEACONS: dict[str, st.SearchStrategy[Any]] = {
    "height_m": st.just(8.0), "weak_sigma_m": st.just(0.4), "bias_sigma_m": st.just(0.2), "growth_m": st.just(0.3),
    "growth_sigma_m": st.just(0.1), "growth_distance_m": st.just(90.0), "survey_sigma_m": st.just(0.1),
    "latency_s": st.just(0.2), "lever_arm_m": st.just([1.0, 0.0, -0.5]), "loss": st.just(0.1),
    "range_limit_m": st.sampled_from([9000.0, 1800.0]), "rate_hz": st.sampled_from([2.0, 5.0]),
}  # fmt: skip


@settings(max_examples=1, derandomize=True, suppress_health_check=list(HealthCheck), phases=PHASES)
@given(
    st.fixed_dictionaries(BEACONS), st.lists(BEACON, min_size=3, max_size=4, unique_by=str),
    st.sampled_from(FILTER_OUTPUTS),
)  # fmt: skip
def test_a_placement_of_beacons_is_the_landings_own(
    tmp_path_factory: pytest.TempPathFactory, keys: dict[str, Any], sites: list[dict[str, float]], output: str
) -> None:
    """DOPs of beacons and an error of the filter by optimize and by a sweep, against the landing."""
    folder, base = tmp_path_factory.mktemp("study"), {"rate_hz": 4.0, "sigma_m": 0.2, "range_limit_m": 9000.0}
    ridge = [{"azimuth_deg": [30.0, 180.0], "elevation_deg": 3.0, "distance_m": 700.0}]
    section = base | keys | {"sites": [{"s_m": 500.0, "l1_m": 0.0}]}
    given_ = {"imu.rate_hz": 10.0, "receiver.rate_hz": 0.5, "duration_s": 62.0, "beacons": section, "terrain": ridge}
    placed = given_ | {"beacons": section | {"sites": sites}}
    flown = case("method=covariance", *(f"{key}={json.dumps(value)}" for key, value in placed.items()))
    result = covariance_result(flown, covariance_analysis(flown), 1)
    expected = [result[f"/summary/beacons/{d}dop"][i] for i in (0, 2, 3) for d in "phv"]
    solved = np.isfinite(result["/beacons/vdop"][on_glide(flown.scenario, flown.trajectory, result["/beacons/time"])])
    area = "area: {s_m: [-500, 500], l1_m: [-900, 5000], height_m: [0, 30]}\nbeacons: [3]\n"
    places = np.array([[[s["s_m"], s["l1_m"], s.get("height_m", section.get("height_m", 0.0))] for s in sites]])
    of_filter, of_geometry = (
        objective.problem(*read_study(study_of(folder, "optimize", given_, f"{area}objective: {name}\n"), Optimize, []))
        for name in (output, "beacons_vdop")
    )
    assert of_filter.objective(places)[0] == pytest.approx(filter_outputs(result)[output], rel=1e-9)
    assert of_geometry.objective(places)[0] == (pytest.approx(expected[2], rel=1e-9) if solved.all() else np.inf)
    assert of_geometry.beacons is not None
    dops = beacon_outputs(of_geometry.beacons, of_geometry.rules.plane.ecef(places))
    assert_close(np.array([dops[name][0] for name in BEACON_OUTPUTS]), np.array(expected), np.array(expected[3]))
    vary = [{"key": "beacons.sites", "values": [sites]}]
    text = f"vary: {json.dumps(vary)}\nmethod: dop\noutputs: [beacons_vdop]\n"
    rows, _, _ = SweepStudy(plan(*read_study(study_of(folder, "sweep", given_, text), Sweep, []), 1)).batch(0, 1)
    np.testing.assert_array_equal(rows["beacons_vdop"], expected[2])


def of_result(result: ResultBuilder, lost: int) -> np.ndarray:
    """What a landing's result file says, in the order of DOP_OUTPUTS."""
    dops = [result[f"/summary/dop/{d}dop"] for d in "phv"]
    sigmas = [result[f"/summary/fix/rms_{n}"][0] for n in ("horizontal", "vertical")]
    return np.array([*(d[0] for d in dops), *(d[2] for d in dops), *sigmas, float(lost)])


def check_fixes(world: SharedTruth, glide: np.ndarray, expected: np.ndarray) -> None:
    """Fixes from ranges without error: none without a DOP, and where they find the place, their covariance is that of
    the SKO; the iteration, whose last step is below 1 cm, may miss it beside pseudolites."""
    signals = world.signals
    ranges = np.linalg.norm(signals.position - signals.antenna[:, None], axis=2) + world.clock[:, :1]
    ranges = np.where(signals.used, ranges, np.nan)
    llh, _, _, cov = receiver_fixes(world, ranges, np.where(signals.used, signals.range_rate, np.nan))
    off = np.linalg.norm(ecef_from_llh(llh[glide]) - signals.antenna[glide], axis=1)
    sigma = np.sqrt(np.trace(cov[glide, :3, :3], axis1=1, axis2=2))
    found = (off < 0.01) & ~(expected[:, 0] > 100.0)
    np.testing.assert_allclose(sigma[found], expected[found, 3], rtol=1e-3)


def test_pseudolites_too_near_are_refused_by_all(tmp_path: Path) -> None:
    """A metre beside the rollout; under a fast aircraft between tenths of a second; under the antenna alone."""
    runway = {"pseudolites.frame": "runway", "pseudolites.count": 1}
    for settings_, s_m, l1_m in (
        ({}, (1.0, 100.0), -600.0),
        ({"approach.speed_start_kmh": 1000, "approach.speed_touchdown_kmh": 980}, (1.0, 100.0), -72.5),
        ({"receiver.lever_arm_m": [0, 30, 0]}, (30.0, 100.0), -600.0),
    ):
        given = runway | settings_
        area = "area: {s_m: [-500, 500], l1_m: [-900, 5000]}\npseudolites: [1]\nobjective: pdop\n"
        here = objective.problem(*read_study(study_of(tmp_path, "optimize", given, area), Optimize, []))
        near, far = here.rules.violation(np.array([[[s, l1_m]] for s in s_m]))
        assert 0.0 < near <= NEAREST
        assert far <= 0.0
        vary = [{"key": "pseudolites.s_m", "values": s_m}, {"key": "pseudolites.l1_m", "values": [l1_m]}]
        for more, alone in ([], True), ([{"key": "duration_s", "values": [110.0]}], False):
            text = f"vary: {json.dumps([*vary, *more])}\nmethod: dop\n"
            planned = plan(*read_study(study_of(tmp_path, "sweep", given, text), Sweep, []), 1)
            assert (planned.geometry is not None) == alone
            rows, _, _ = SweepStudy(planned).batch(0, 2)
            np.testing.assert_array_equal(rows["outcome"], [INVALID, COMPUTED])
        assignments = [f"{key}={json.dumps(value)}" for key, value in given.items()]
        with pytest.raises(InputError, match="of the aircraft; it must stay 10 m away"):
            scenario(*assignments, f"pseudolites.s_m={s_m[0]}", f"pseudolites.l1_m={l1_m}")


def test_a_frame_that_is_not_to_be_had_is_no_combination(tmp_path: Path) -> None:
    """The paper's frame without approach.start: named as an invalid combination."""
    vary = [{"key": "pseudolites.frame", "values": ["runway", "table1"]}]
    path = study_of(tmp_path, "sweep", {}, f"vary: {json.dumps(vary)}\nmethod: dop\n", "landing_smooth")
    planned = plan(*read_study(path, Sweep, []), 1)
    rows, _, _ = SweepStudy(planned).batch(0, 2)
    assert planned.geometry is not None
    np.testing.assert_array_equal(rows["outcome"], [COMPUTED, INVALID])


def test_a_glide_without_epochs_is_the_same_by_both_ways(tmp_path: Path) -> None:
    """A flight that ends before its glide begins has no DOPs: no fix at all where placements are judged."""
    axes = [{"key": "pseudolites.l1_m", "values": [500.0]}], [{"key": "duration_s", "values": [8.0]}]
    for vary, alone in zip(axes, (True, False), strict=True):
        given = {"duration_s": 8.0} if alone else {}
        text = f"vary: {json.dumps(vary)}\nmethod: dop\n"
        planned = plan(*read_study(study_of(tmp_path, "sweep", given, text, "landing_smooth"), Sweep, []), 1)
        rows, _, _ = SweepStudy(planned).batch(0, 1)
        assert (planned.geometry is not None) == alone
        assert rows["outcome"][0] == NO_FIX
        assert all(np.isnan(rows[name][0]) for name in DOP_OUTPUTS)
        assert [name for name, found in zip(LANDING, rows["findings"][0], strict=True) if found] == ["no_fix"]


@pytest.mark.parametrize("duration", [61.0, 62.0, 62.5, 90.0])
@pytest.mark.parametrize("smoothing", [0.15, 0.25, 0.35, 1.25, 2.05])
def test_memory_of_smoothing_does_not_depend_on_the_epochs_told(duration: float, smoothing: float) -> None:
    """Half an epoch more than a whole number of them goes up, for times of any rounding."""
    world = case(f"receiver.smoothing_s={smoothing}", f"duration_s={duration}", "imu.rate_hz=10").shared
    assert world.signals.smoothing is not None
    assert world.signals.smoothing.max() == np.ceil(10.0 * smoothing)


def test_clearance_does_not_depend_on_the_number_of_sites() -> None:
    rng = np.random.default_rng(1)
    track, sites = Track(rng.normal(size=(500, 3)) * 1e3), rng.normal(size=(40, 3)) * 1e3
    np.testing.assert_allclose(track.clearance(sites), [track.clearance(s[None])[0] for s in sites], rtol=1e-12)


@pytest.mark.parametrize("speed", [130.0, 1000.0])
def test_points_of_the_track_follow_close(speed: float) -> None:
    """From time 0 to the end, none farther from the next than the rule of nearness needs."""
    one = scenario(f"approach.speed_start_kmh={speed}", f"approach.speed_touchdown_kmh={speed}")
    trajectory = one.trajectory()
    track = track_of(one, trajectory).points
    steps = np.linalg.norm(np.diff(track, axis=0), axis=1)
    assert steps.max() <= TRACK_STEP + 1e-6
    ends = trajectory.motion(np.array([0.0, one.duration_s])).position_ecef
    np.testing.assert_allclose(track[[0, -1]], ends, atol=1e-6)
