"""Write docs/reference, every key of every kind of file and every variable of a result, for `make site`."""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import result_file
import yaml

from navsim.kinds import OF_FILES
from navsim.scenario.imu import NEEDED
from navsim.scenario.load import section
from navsim.scenario_files import shipped
from navsim.scenario_files.keys import ITEM, NAME, KeyRow, rows
from navsim.scenario_files.presets import IMU_PRESETS, IMU_SHEETS
from navsim.scenario_files.source import load

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "reference"

_SUM = "3f" * 32
EXAMPLES: dict[str, tuple[tuple[str, tuple[str, ...]], ...]] = {
    "landing": (
        ("landing", (
            "imu.gyro={arw_deg_sqrt_h: 0.05, scale_ppm: 300, markov_deg_h: 10, markov_time_s: 300, "
            "drift_fixed_deg_h: [700, -300, 100], rate_random_walk_deg_h_sqrt_h: 5, "
            "misalignment_mrad: 1, asymmetry_ppm: 200, nonlinearity_ppm_deg_s: 5, g_sensitivity_deg_h_g: 10, "
            "ramp_deg_h_h: 30, temperature_deg_h_k: 10, rectification_deg_h_g2: 1, sine_deg_h: 20, sine_hz: 0.1, "
            "quantum_urad: 10, range_deg_s: 125, bandwidth_hz: 50, damping: 0.7}",
            "imu.accelerometer={vrw_m_s_sqrt_h: 0.06, scale_ppm: 300, markov_mg: 0.5, markov_time_s: 300, "
            "bias_fixed_mg: [1, -1, 0.5], bias_random_walk_mg_sqrt_h: 0.1, "
            "misalignment_mrad: 1, asymmetry_ppm: 200, nonlinearity_ug_g2: 50, ramp_mg_h: 1, temperature_mg_k: 0.1, "
            "rectification_ug_g2: 100, sine_mg: 0.5, sine_hz: 0.1, quantum_mm_s: 0.5, range_g: 8, bandwidth_hz: 50, "
            "damping: 0.7}",
            "imu.vibration={lines: [{amplitude_g: 0.5, frequency_hz: 80}], psd: [[20, 0.001], [200, 0.001]]}",
            "imu.temperature={ramp_k_min: 1, warm_up_k: 15, warm_up_time_s: 200}",
            "altimeter={sigma_m: 0.5, believed_sigma_m: 1}",
            "radio_altimeter={sigma_floor_m: 0.5, sigma_share: 0.02, ground: [[-600, -6], [0, 0]]}",
            "barometric_altimeter={sigma_m: 0.5, lag_s: 0.3, isa_deviation_k: -10, drift_m: 2}",
            "magnetometer={noise_ut: 0.3, hard_iron_ut: 2, scale_percent: 1, misalignment_mrad: 5, disturbance_ut: 1, "
            "declination_deg: 11, dip_deg: 71, intensity_ut: 52.5}",
            "beacons={sites: [{name: north, s_m: 120, l1_m: 300, height_m: 2}, {name: south, lat_deg: 56.02, lon_deg: "
            "37.01}], rate_hz: 20, sigma_m: 0.1, weak_sigma_m: 0.3, bias_sigma_m: 0.1, growth_m: 0.3, growth_sigma_m: "
            "0.1, survey_sigma_m: 0.05, eirp_dbm: 14, sensitivity_dbm: -97, carrier_mhz: 868, long_share: 0.02, "
            "long_m: 2, outlier_share: 0.01, outlier_sigma_m: 5, bandwidth_mhz: 0.5, noise_figure_db: 5, "
            "clock: {}, air: {truth_refractivity_n: 340, correction: refractivity, corrected_refractivity_n: 315, "
            "refractivity_sigma_n: 45}}",
            "filter.beacons.refractivity_sigma_n=30", "filter.beacons.second_order=true",
            "azimuth_station={preset: mls, beyond_m: 3000, half_width_m: 300, off_s: [[10, 20]], faults: [{at_s: 40, "
            "until_s: 60, rate_m_s: 0.5}]}",
            "elevation_station={preset: mls, faults: [{at_s: 40, until_s: 60, error_deg: 0.3}]}",
            "dme={preset: dme-p, beyond_m: 3000, faults: [{until_s: 60, error_m: 100}]}",
            "runway.geoid_undulation_m=15.5",
            f"sky={{source: almanac, almanac: MCCJ_180913.agl, almanac_sha256: {_SUM}}}",
            "events=[{what: step, sources: [R05], at_s: 20, until_s: 40, error_m: 10}, "
            "{what: ramp, sources: [glonass], rate_m_s: 0.5}, {what: survey, sources: [PL1], ned_m: [1, 0, 0]}, "
            "{what: meacon, sources: [all], place: {lat_deg: 56.03, lon_deg: 37.05}}]",
            "wind={profile: table, levels: [{height_m: 10, speed_m_s: 4, from_deg: 60}, "
            "{height_m: 100, speed_m_s: 7, from_deg: 75}], turbulence: {severity: moderate}, "
            "gusts: [{amplitude_m_s: 5, towards: right, start_s: 20, ramp_s: 2, hold_s: 3}]}",
            "filter={radio_altimeter: {sigma_floor_m: 1, sigma_share: 0.03, latency_s: 0.05, lever_arm_m: [0, 0, 0.3], "
            "ground: [], from_m: 0}, barometric_altimeter: {sigma_m: 1, lag_s: 0, isa_deviation_k: 0, "
            "geoid_undulation_m: 16, errors: states, qnh_sigma_hpa: 0.5, drift_m: 3, drift_time_s: 300}, "
            "magnetometer: {errors: states, noise_ut: 0.4, hard_iron_ut: 3, scale_percent: 1, misalignment_mrad: 5, "
            "mounting_deg: [0, 0, 2], field_error_ut: 0.2, disturbance_ut: 1, latency_s: 0.02}, "
            "beacons: {outliers: mixture, long_share: 0.1, long_m: 2, outlier_share: 0.02, outlier_sigma_m: 3, "
            "clock: {offset_sigma_us: 5, drift_sigma_ppb: 50, h0: 3.0e-19, h_minus2: 3.0e-20}, errors: states, "
            "sigma_m: 0.2, weak_sigma_m: 0.4, bias_sigma_m: 0.2, "
            "growth_m: 0.2, "
            "growth_sigma_m: 0.2, growth_distance_m: 30, survey_sigma_m: 0.1, latency_s: 0.02, "
            "lever_arm_m: [0, 0, 0.1]}, "
            "azimuth_station: {bias_m: 3, bends_m: 2, noise_m: 2, bends_time_s: 3, latency_s: 0.1, "
            "lever_arm_m: [1, 0, 0]}, elevation_station: {bias_deg: 0.1, bends_deg: 0.1, noise_deg: 0.1, "
            "bends_time_s: 1, latency_s: 0.1, lever_arm_m: [1, 0, 0]}, "
            "dme: {bias_m: 20, bends_m: 5, noise_m: 10, bends_time_s: 3, latency_s: 0.1, lever_arm_m: [1, 0, 0]}, "
            "scale_factors: true, misalignments: true, latency_s: 0.1, "
            "lever_arm_m: [0.5, 0, -0.3], initial: {attitude_deg: 5, position_m: 10, velocity_m_s: 1}, "
            "imu: {gyro: {drift_deg_h: 500, noise_deg_h: 30, scale_ppm: 300, markov_deg_h: 10, markov_time_s: 300, "
            "misalignment_mrad: 1, rate_random_walk_deg_h_sqrt_h: 5}, "
            "accelerometer: {bias_mg: 1, noise_mg: 10, scale_ppm: 300, markov_mg: 0.5, markov_time_s: 300, "
            "misalignment_mrad: 1, bias_random_walk_mg_sqrt_h: 0.1}}}",
            "box={lateral_m: 0.8, along_m: 5, vertical_m: 1.2}", "approach.go_around={at_s: 40}",
            "runway={bearing_deg: 353, bearing_is: magnetic, declination_deg: 11.2, bearing_year: 2018.7, tch_m: 15.2, "
            "geoid_undulation_m: 15.5}",
            "approach.flight_technical_error={lateral: {sigma_m: 3, reference_height_m: 100, floor_m: 1}, "
            "along: {sigma_m: 5, reference_height_m: 100, floor_m: 1}, "
            "vertical: {sigma_m: 2, reference_height_m: 100, floor_m: 0.5}}", "approach.guidance=estimate",
            "approach.indicator={system: gls, course_origin_m: 1600, glide_full_scale: 0.25}",
            "pseudolites.differential={link: {senders: [PL1]}}",
            "integrity={limits: {operation: LPV-200, tta_s: 6}, tails: {at_s: [30, 55]}, decision_height_m: 30, "
            "comparison: {gbas: {receivers: 4, ground_sigma_m: 0.2, b_m: 0.1, glide_path_deg: 5}}, "
            "p_constellations: {glonass: 1e-4}, ground_groups: [{members: [PL1, PL2]}]}",
            "requirements=[{what: error, of: lateral, at: 100ft, below_m: 0.5, share: 0.95}, "
            "{what: rms, of: horizontal, below_m: 0.4}, {what: box, at_most: 1e-6}, "
            "{what: level, of: hpl, below_m: 40}, {what: time_to_alert, within_s: 6}]",
        )),
        ("odense", ("runway.end_height_m=17",)),
        ("beacons_pad", ("approach.nose_deg=90",)),
        ("landing", ("receiver.fix_states={forced: [{state: wrong, at_s: 20, until_s: 40, error_ned_m: [0, 0, 6]}]}",)),
        ("landing", (
            "imu.gyro={drift_deg_h: 700, noise_deg_h: 30, bias_instability_deg_h: 8}",
            "pseudolites.clock_noise={h0: 2e-22, h_minus2: 1.5e-25}", "pseudolites.clock_age_s=60",
            "filter.pseudolites={survey_sigma_m: 0.2, range_bias_sigma_m: 0.3, clock_sigma_ns: 5, "
            "clock_drift_sigma_ppb: 1, refractivity_sigma_n: 30, clock_noise: {h0: 4e-22, h_minus2: 3e-25}}",
            "pseudolites.air={correction: refractivity, refractivity_sigma_n: 45}",
            "terrain=[{ends: [{lat_deg: 56.0035, lon_deg: 37.005}, {lat_deg: 56.016, lon_deg: 37.006}], height_m: 35}, "
            "{azimuth_deg: [350, 10], elevation_deg: 3, distance_m: 2000}, "
            f"{{file: N56E037.hgt, file_sha256: {_SUM}, height_above: ellipsoid}}]",
            "wind={turbulence: {w20_m_s: 8}, gusts: [{amplitude_m_s: -4, towards: up, start_s: 30, ramp_m: 60}]}",
            "imu.accelerometer={bias_mg: 1, noise_mg: 10, bias_instability_mg: 0.1}",
            "filter.imu={gyro: {bias_instability_deg_h: 10}, accelerometer: {bias_instability_mg: 0.2}}",
        )),
        ("circuit", (
            "approach.circuit=~",
            "approach.points=[{lat_deg: 56.03, lon_deg: 36.99, height_m: 200, speed_kmh: 120}, "
            "{along_m: -3000, right_m: -900}, {along_m: -3000, right_m: 0}]",
            "runway.end={lat_deg: 56.0278, lon_deg: 37.0180}", "approach.taxi_speed_kmh=18", "approach.taxi_s=20",
            "approach.go_around={height_m: 30, load_factor: 1.2, climb_deg: 5}",
            "pseudolites={frame: runway, count: 1, s_m: 300, l1_m: 1500, eirp_dbm: -10, pattern: {azimuth_deg: "
            "[0, 120, 240], elevation_deg: [-5, 0, 10, 90], "
            "gain_db: [[-15, -3, 0, -10], [-15, -3, 0, -10], [-20, -8, -5, -15]]}}",
            "receiver.antenna={elevation_deg: [-30, 0, 90], gain_dbi: [-15, -3, 4], mask_deg: -20}",
            "interference={pseudolites: {isolation_db: 21.1}}",
        )),
        ("landing", (
            "box={lateral_m: [-4, 6], from_threshold_m: [60, 400]}",
            f"sky={{source: navigation, navigation: [brdc.rnx.gz], navigation_sha256: [{_SUM}]}}",
            "pseudolites={sites: [{name: west, s_m: -300, l1_m: 1500, height_m: 5}, {lat_deg: 56.03, lon_deg: 37.02}], "
            "cn0_reference_m: 1000, differential: {site: west}}",
            "interference={pseudolites: {lines: true}, jammers: [{name: van, place: {lat_deg: 56.01, lon_deg: 37.0}, "
            "eirp_dbw: -10, waveform: sweep, bandwidth_mhz: 20, sweep_s: 1e-4}], horizon: [{ends: [{lat_deg: 56.02, "
            "lon_deg: 36.98}, {lat_deg: 56.02, lon_deg: 37.02}], height_m: 60}, {azimuth_deg: [350, 10], "
            "elevation_deg: 3, distance_m: 2000}]}",
            "filter.imu={gyro: {drift_fixed_deg_h: [0, 0, 0], arw_deg_sqrt_h: 0.05}, "
            "accelerometer: {bias_fixed_mg: [0, 0, 0], vrw_m_s_sqrt_h: 0.06}}",
        )),
        ("landing", (
            f"sky={{source: orbits, orbits: [COD0OPSFIN.SP3], orbits_sha256: [{_SUM}], horizon: ridge.csv, "
            f"horizon_sha256: {_SUM}}}",
            f"approach={{profile: recorded, file: flight.h5, file_sha256: {_SUM}, start_s: 540, touchdown_s: 580}}",
            "runway.threshold={lat_deg: 56.02, lon_deg: 37.0}",
            "pseudolites={frame: runway, count: 0}", "receiver.single_clock=true",
            "signals={system_offsets_ns: {galileo: 2.4}, system_offset_sigma_ns: 10}",
            "signals.errors={orbit_clock: {sigma_m: 1, correlation_time_s: 9000, mapping: none}, "
            "ionosphere: {sigma_m: 2, correlation_time_s: 1800, mapping: ionosphere}, "
            "troposphere: {sigma_m: 0.2, correlation_time_s: 1800, mapping: troposphere}, "
            "multipath: {sigma_m: 0.5, correlation_time_s: 100, mapping: multipath}, "
            "ground_station: {receivers: 4, accuracy_designator: C, correlation_time_s: 100}}",
            "events=[{what: step, sources: [gps], error_m: 2, reference_receiver: 1}]",
        )),
        ("track", ("approach.sigma_vertical_m=0.5",)),
    ),
    "sweep": (
        ("placement_sweep", (
            "set={pseudolites.frame: runway}", "samples=200",
            "vary=[{key: receiver.rate_hz, range: {first: 1, last: 10, step: 1}}, "
            "{keys: [pseudolites.count, filter.velocity], values: [[1, true], [2, false]]}, "
            "{key: pseudolites.s_m, lhs: {first: 100, last: 2000}}]",
        )),
    ),
    "optimize": (
        ("placement_optimum", (
            "set={sky.exclude: [R05]}", "period={hours: 191.5, count: 200}", "objective=pdop",
            f"constraints={{keep_out: fields.geojson, keep_out_sha256: {_SUM}}}",
        )),
        ("placement_optimum", (
            "area=null", "pseudolites=[1]",
            "sites=[{name: mast, s_m: 300, l1_m: 1500, height_m: 12}, {name: hangar, s_m: -400, l1_m: 200}]",
        )),
        ("placement_optimum", (
            "set={pseudolites.range_law: cn0}", "pseudolites=[1]", "area=null", "objective=vertical",
            f"constraints={{permission: fields.geojson, permission_sha256: {_SUM}}}",
            "sites=[{name: hangar, s_m: -400, l1_m: 200, height_m: 12, ground_m: 8, cost: 300}]",
            "costs={each: 5000, mast_per_metre: 200, steps: 6, "
            "power: [{eirp_dbm: -40, cost: 0}, {eirp_dbm: -30, cost: 500}]}",
        )),
        ("placement_optimum", (
            "base=beacons_uav.yaml", "pseudolites=null", "beacons={first: 3, last: 4}", "objective=beacons_pdop",
            "area={s_m: [-300, 300], l1_m: [-400, 800], height_m: [2, 15]}", "height_m=0", "period=null",
            "constraints={}",
        )),
    ),
    "replay": (
        ("recorded_flight", (
            f"imu.file_sha256={_SUM}", "imu.columns={gx_rad_s: GyrX}", "imu.gyro_axes=FRD",
            "imu.accelerometer_axes=BLU", "imu.longest_gap_s=0.5", "start_s=10", "end_s=100",
            "alignment.heading_deg=90",
            "imu.gyro={drift_deg_h: 100, drift_fixed_deg_h: [10, 0, 0], arw_deg_sqrt_h: 0.3, markov_deg_h: 10, "
            "markov_time_s: 300, rate_random_walk_deg_h_sqrt_h: 5}",
            "imu.accelerometer={bias_mg: 5, bias_fixed_mg: [1, 0, 0], vrw_m_s_sqrt_h: 0.15, markov_mg: 0.3, "
            "markov_time_s: 300, bias_random_walk_mg_sqrt_h: 0.1}",
            f"gnss.file_sha256={_SUM}", "gnss.columns={h_m: Alt}", "gnss.latency_s=0.1", "gnss.velocity_latency_s=0.3",
            "gnss.velocity_sigma_m_s=[0.3, 0.5]", "gnss.position_sigma_m=[1.5, 2.5]", "filter.gate.max_rejected=10",
            f"reference={{file: attitude.csv, file_sha256: {_SUM}}}",
            f"heading={{file: headings.csv, file_sha256: {_SUM}, columns: {{heading_deg: Yaw}}, declination_deg: 11.5, "
            "sigma_deg: 3, error_sigma_deg: 5}", "standstill={}", "side_slip={}",
            "ranges={file: beacon_ranges.csv, sigma_m: 0.1, columns: {source: anchor}, survey_sigma_m: 0.05, "
            "growth: {sigma_m: 0.1, distance_m: 17}, lever_arm_m: [0, 0, 0.1], latency_s: 0.02}",
            "sources={positions: [{name: NW, lat_deg: 56.01, lon_deg: 37.01, height_m: 152}]}",
        )),
        ("recorded_flight", (
            "imu.gyro.bias_instability_deg_h=10", "imu.accelerometer.bias_instability_mg=0.3",
            "gnss.errors=[{correlation_time_s: 1000, position_sigma_m: [2, 3]}, {correlation_time_s: 100, states: 6}]",
            "alignment.known={time_s: 10, lat_deg: 56, lon_deg: 37, height_m: 150, velocity_m_s: [29, -1, 0], "
            "attitude_deg: [0, 2, 30], gyro_bias_deg_h: [20, -5, 10], accelerometer_bias_mg: [1, 0, -2], "
            "position_sigma_m: [1, 1, 2], velocity_sigma_m_s: [0.1, 0.1, 0.2], attitude_sigma_deg: [0.5, 0.5, 2]}",
        )),
        ("recorded_flight", (
            f"gnss={{file: flight.obs, navigation: [brdc.rnx.gz], navigation_sha256: [{_SUM}], range_sigma_m: 1, "
            "range_rate_sigma_m_s: 0.1}",
            "filter.coupling=tight",
        )),
        ("recorded_flight", (
            "ranges={file: ranges.csv, sigma_m: 0.1, source_columns: {D0: north}}",
            "sources={file: beacons.csv, columns: {source: name}}",
        )),
        ("recorded_flight", (
            "ranges={file: ranges.csv, measurement: one_way, sigma_m: 0.5, time_offset_s: -18}",
            "sources={file: pseudolites.csv}",
            "clocks={datum: receiver, sources: {oscillator: ocxo}, receiver: {h0: 1.0e-21, h_minus2: 2.0e-20}}",
        )),
        ("recorded_flight", (
            "ranges={file: ranges.csv, measurement: one_way, sigma_m: 0.5}", "sources={file: pseudolites.csv}",
            "clocks={datum: PL1, sources: {h0: 8.0e-20, h_minus2: 4.0e-23}, receiver: {oscillator: tcxo}}",
        )),
    ),
    "ranges": (
        ("recorded_ranges", (
            "ranges.columns={source: anchor, signal_dbm: rssi}", "ranges.sigma_m=0.1", "motion.noise=[0.5, 0.1]",
            "motion.start={position_m: [60, 0, 20], sigma_m: [5, 10]}", "bias.growth={sigma_m: 0.1}",
            "bias.wander={sigma_m: 0.05, correlation_time_s: 2}", "start_s=10", "end_s=60",
            "outliers={share: 0.02, sigma_m: 3, long_share: 0.05, long_m: 1}",
        )),
        ("recorded_ranges", (
            "ranges={file: ranges.csv, measurement: one_way, source_columns: {p1: north, p2: east, p3: south}}",
            "sources={positions: [{name: north, lat_deg: 56, lon_deg: 37, height_m: 150}, {name: east, lat_deg: 56, "
            "lon_deg: 37.01, height_m: 150}, {name: south, lat_deg: 55.99, lon_deg: 37, height_m: 150}]}",
            "clocks={datum: east, sources: {oscillator: ocxo}, receiver: {h0: 1.0e-21, h_minus2: 2.0e-20}}",
            "motion={model: acceleration, correlation_time_s: 5}", "bias.smoothing_s=0.5",
            "reference={file: track.csv, columns: {t_s: time}}",
        )),
        ("recorded_ranges", (
            "sources={file: beacons.csv, columns: {source: name}}", "ranges.measurement=one_way",
            "clocks={sources: {h0: 8.0e-20, h_minus2: 4.0e-23}, receiver: {oscillator: tcxo}}",
        )),
    ),
}  # fmt: skip
"""Of each kind shipped files and what is set in them, for keys that no shipped file has: every set is a valid file."""
NO_EXAMPLE = {
    "landing": ("imu.from", "signals.from", "signals.hdop"),
    "replay": ("sources.positions.N.position_m",),
}
"""Keys of a result that has to be there, and one that a replay refuses."""


def _values(node: Any, key: str) -> Iterator[tuple[str, Any]]:
    """Keys of a file, dotted, with the mark of an item for its number, and their values."""
    if isinstance(node, dict):
        for name, value in node.items():
            yield from _values(value, f"{key}.{name}" if key else str(name))
    else:
        yield key, node
        for value in node if isinstance(node, list) else ():
            if isinstance(value, dict):
                yield from _values(value, f"{key}.{ITEM}")


@functools.cache
def _examples(kind: str) -> dict[str, Any]:
    """Values that keys have in files of this kind, as written there: the shipped ones first."""
    out: dict[str, Any] = {}
    for name in shipped.names():
        data = load(shipped.path(name)).data
        if data["kind"] == kind:
            out = dict(_values(data, "")) | out
        elif kind == "landing":
            for key, value in data.get("set", {}).items():
                out = dict(_values(value, key)) | out
    for _, assignments in EXAMPLES.get(kind, ()):
        for assignment in assignments:
            key, _, value = assignment.partition("=")
            given = yaml.safe_load(value)
            out = dict(_values(given, key)) | out
            out.setdefault(key, given)
    return out


def _text(value: Any) -> str:
    """A value as YAML has it, on one line and not long."""
    if isinstance(value, float):
        return f"{value:.7g}"
    if isinstance(value, (list, tuple, dict)):
        shown = yaml.safe_dump(json.loads(json.dumps(value, default=str)), default_flow_style=True, width=1000).strip()
        return shown if len(shown) <= 60 else f"{shown[:55]} ..."
    return "null" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def example(kind: str, row: KeyRow) -> Any:
    """A value that the key may have; None where there is none to show."""
    known = _examples(kind)
    for key in (row.key, row.key.replace(f".{NAME}", "")):
        found = known.get(key)
        if isinstance(found, dict) and key != row.key:
            found = next(iter(found.values()))
        if found is not None and (not row.choices or found in row.choices or isinstance(found, list)):
            return found
    named = next((v for k, v in known.items() if NAME in row.key and k.startswith(row.key.partition(NAME)[0])), None)
    if named is not None:
        return named
    return row.default if row.default is not None else next(iter(row.choices), None)


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def _code(text: str) -> str:
    return f"`{_cell(text)}`" if text else ""


def row_of(kind: str, row: KeyRow) -> str:
    """The row of a key."""
    value = row.kind
    if row.choices:
        number = f"number, {row.range}, or " if row.range else ""
        value = number + ", ".join(_code(_text(choice)) for choice in row.choices)
    elif row.range:
        value += f", {row.range}"
    meaning = row.meaning
    if row.when:
        meaning += f" (where {' and '.join(_code(w) for w in row.when)})"
    default = "required" if row.required else "" if row.section else _code(_text(row.default))
    shown = "" if row.section else _code(_text(found) if (found := example(kind, row)) is not None else "")
    return f"| `{row.key}` | {_cell(meaning)} | {_cell(value)} | {row.unit} | {default} | {shown} |"


HEAD = """# Keys of {name}

Made from the schema (`navsim schema {kind}`, `navsim keys {kind}`). {doc}

A dotted key is what `--set` takes: `--set key=value`. `{item}` stands for the number of an item of a list, from 0,
`{own}` for a name of your own. `null`: left out unless it is wanted. A number without a unit is a pure
one, or its meaning says its unit.
"""
TABLE = "| key | meaning | value | unit | default | example |\n|---|---|---|---|---|---|"


PRESETS = """## Presets of inertial sensors

What `imu.preset` gives where `imu.gyro` and `imu.accelerometer` do not, where it was seen, and what is missing there
and has to be given ([inertial sensors](../../imu.md)).

| preset | gyro | accelerometer | to be given | seen in |
|---|---|---|---|---|"""


def _presets() -> Iterator[str]:
    """The table of the presets of inertial sensors."""
    yield PRESETS
    for name, sensors in IMU_PRESETS.items():
        given = [_code(", ".join(f"{key}: {_text(v)}" for key, v in values.items())) for values in sensors.values()]
        asked = [
            f"`{sensor}.{keys[0]}`" for sensor, needed in NEEDED.items() for keys in needed
            if name in IMU_SHEETS and not {*keys} & sensors[sensor].keys()
        ]  # fmt: skip
        yield f"| `{name}` | {' | '.join(given)} | {', '.join(asked)} | {IMU_SHEETS.get(name, '')} |"
    yield ""


def _section(kind: str, top: KeyRow, every: list[KeyRow], depth: int) -> list[str]:
    """The table of a section, below a heading of this depth."""
    within = [row for row in every if row.key.startswith(f"{top.key}.")]
    meaning = f"{top.meaning[:1].upper()}{top.meaning[1:]}.".replace("..", ".")
    head = f"# Keys of `{top.key}` in {kind} files" if depth == 1 else f"{'#' * depth} `{top.key}`"
    lines = [head, "", meaning, "", TABLE, *(row_of(kind, row) for row in within), ""]
    return [*lines, *_presets()] if (kind, top.key) == ("landing", "imu") else lines


def pages_of(kind: str) -> dict[str, str]:
    """The page of a kind; of a landing, which has the most keys, also one for each section."""
    model = section(kind)
    doc = " ".join((model.__doc__ or "").split())
    head = HEAD.format(name=f"`kind: {kind}`", kind=kind, doc=doc, item=ITEM, own=NAME)
    every = rows(model.model_json_schema())
    tops = [row for row in every if "." not in row.key and row.section]
    at_top = [row for row in every if "." not in row.key and not row.section]
    lines = [head, "## At the top", "", TABLE, *(row_of(kind, row) for row in at_top), ""]
    if kind != "landing":
        return {f"{kind}.md": "\n".join(lines + [line for top in tops for line in _section(kind, top, every, 2)])}
    lines += ["## Sections", "", "| section | what |", "|---|---|"]
    lines += [f"| [`{top.key}`]({kind}/{top.key}.md) | {_cell(top.meaning)} |" for top in tops]
    lines += ["", "```{toctree}", ":hidden:", "", *(f"{kind}/{top.key}" for top in tops), "```", ""]
    out = {f"{kind}.md": "\n".join(lines)}
    return out | {f"{kind}/{top.key}.md": "\n".join(_section(kind, top, every, 1)) for top in tops}


@functools.cache
def pages() -> dict[str, str]:
    """All generated pages, by their names in docs/reference."""
    out = result_file.pages()
    for kind in OF_FILES:
        out |= pages_of(kind)
    return out


def write(folder: Path = FOLDER) -> None:
    """Write the pages that differ, and remove those that there are no more."""
    every = pages()
    for old in folder.rglob("*.md"):
        if str(old.relative_to(folder)) not in every:
            old.unlink()
    for name, text in every.items():
        target = folder / name
        if not target.exists() or target.read_text(encoding="utf-8") != text:
            target.parent.mkdir(parents=True, exist_ok=True)
            beside = target.with_suffix(f".{os.getpid()}")
            beside.write_text(text, encoding="utf-8")
            beside.replace(target)


if __name__ == "__main__":
    write()
