"""Named sensor sets with their provenance."""

from __future__ import annotations

import math
from typing import Any

_UG = 9.80665e-6 * 60.0
"""A density of 1 ug/sqrt(Hz) as velocity random walk, m/s/sqrt(h)."""

IMU_PRESETS: dict[str, dict[str, dict[str, float]]] = {
    # The landing paper, list of initial data: constant gyro drift 700 deg/h with a
    # random part of 30 deg/h, accelerometer error 1e-3 g with a random part of 1e-2 g. "Random part" is read
    # as 1 sigma of a white sequence per sample at 100 Hz, the constant parts as 1 sigma over flights
    # (`docs/theory/trajectory.md`).
    "paper": {
        "gyro": {"drift_deg_h": 700.0, "noise_deg_h": 30.0},
        "accelerometer": {"bias_mg": 1.0, "noise_mg": 10.0},
    },
    # No errors at all: checks the mechanisation against the truth.
    "perfect": {
        "gyro": {"drift_deg_h": 0.0, "noise_deg_h": 0.0},
        "accelerometer": {"bias_mg": 0.0, "noise_mg": 0.0},
    },
    # From here on data sheets, with no numbers but theirs (`IMU_SHEETS`). Missing ones are left out;
    # `scenario/imu.py` asks for those that a simulation needs. Correlation times are on no sheet: 100 s, except
    # here if the printed white noise would then exceed the printed minimum of the Allan deviation.
    "hg9900": {
        "gyro": {
            "bias_instability_deg_h": 0.0035, "markov_time_s": 1000.0, "arw_deg_sqrt_h": 0.002, "scale_ppm": 5.0,
        },
        "accelerometer": {"bias_instability_mg": 0.025, "scale_ppm": 100.0},
    },
    "hg1700": {
        "gyro": {"bias_instability_deg_h": 1.0, "arw_deg_sqrt_h": 0.125, "scale_ppm": 150.0},
        # 0.065 ft/s/sqrt(h)
        "accelerometer": {"bias_instability_mg": 1.0, "vrw_m_s_sqrt_h": 0.065 * 0.3048, "scale_ppm": 300.0},
    },
    "stim300": {
        "gyro": {
            "bias_instability_deg_h": 0.5, "markov_time_s": 300.0, "arw_deg_sqrt_h": 0.15, "scale_ppm": 500.0,
            "misalignment_mrad": 1.0, "g_sensitivity_deg_h_g": 1.0,
        },
        "accelerometer": {
            "bias_mg": 0.75, "bias_instability_mg": 0.05, "vrw_m_s_sqrt_h": 0.06, "scale_ppm": 300.0,
            "misalignment_mrad": 1.0, "range_g": 10.0,
        },
    },
    "adis16495-1": {
        "gyro": {
            "bias_instability_deg_h": 0.8, "arw_deg_sqrt_h": 0.09, "misalignment_mrad": 1e3 * math.radians(0.05),
        },
        "accelerometer": {"bias_instability_mg": 0.0032, "range_g": 8.0},
    },
    "adis16488": {
        # 0.2 deg/s
        "gyro": {"drift_deg_h": 720.0, "bias_instability_deg_h": 6.5, "arw_deg_sqrt_h": 0.3},
        "accelerometer": {"bias_mg": 16.0, "bias_instability_mg": 0.1, "vrw_m_s_sqrt_h": 0.029},
    },
    "adis16505-1": {
        "gyro": {
            "bias_instability_deg_h": 2.3, "arw_deg_sqrt_h": 0.13, "misalignment_mrad": 1e3 * math.radians(0.25),
            "range_deg_s": 125.0,
        },
        # 26.5 um/s2, 78.4 m/s2
        "accelerometer": {"bias_instability_mg": 26.5e-3 / 9.80665, "range_g": 78.4 / 9.80665},
    },
    "adis16470": {
        "gyro": {"bias_instability_deg_h": 8.0, "arw_deg_sqrt_h": 0.34, "scale_ppm": 2500.0, "range_deg_s": 2000.0},
        "accelerometer": {
            "bias_instability_mg": 0.013, "vrw_m_s_sqrt_h": 0.037, "scale_ppm": 1000.0, "range_g": 40.0,
        },
    },
    "mti-1": {
        # 0.007 deg/s/sqrt(Hz), 120 ug/sqrt(Hz)
        "gyro": {"bias_instability_deg_h": 10.0, "arw_deg_sqrt_h": 0.42, "range_deg_s": 2000.0},
        "accelerometer": {"bias_instability_mg": 0.03, "vrw_m_s_sqrt_h": 120.0 * _UG, "range_g": 16.0},
    },
    "icm-42688-p": {
        # 0.5 deg/s, 0.0028 deg/s/sqrt(Hz), 70 ug/sqrt(Hz)
        "gyro": {"drift_deg_h": 1800.0, "arw_deg_sqrt_h": 0.168, "scale_ppm": 5000.0},
        "accelerometer": {"bias_mg": 20.0, "vrw_m_s_sqrt_h": 70.0 * _UG, "scale_ppm": 5000.0},
    },
}  # fmt: skip

IMU_SHEETS = {
    "hg9900": "Honeywell HG9900 brochure N61-1638, as quoted in NavToolkit, hg9900_model",
    "hg1700": "Honeywell HG1700 brochure N61-1619, as quoted in NavToolkit, hg1700_model; scale factors (AG71) in the "
    "package imu-error-model 0.1.3",
    "stim300": "Safran (Sensonor) STIM300 data sheet TS1524 r9, as quoted in NavToolkit, stim300_model",
    "adis16495-1": "Analog Devices ADIS16495 data sheet Rev. C, page 1",
    "adis16488": "Analog Devices ADIS16488 data sheet Rev. G, as quoted in NaveGo, navego_example_synth.m",
    "adis16505-1": "Analog Devices ADIS16505 data sheet, page 1; x and y axes",
    "adis16470": "Analog Devices ADIS16470 data sheet Rev. C, as quoted in the package imu-error-model 0.1.3",
    "mti-1": "Xsens MTi-1, table in Transactions on Aerospace Research 2023 (doi:10.2478/tar-2023-0022)",
    "icm-42688-p": "TDK InvenSense ICM-42688-P data sheet 1.7, as quoted in the package imu-error-model 0.1.3",
}
"""Sources of those `IMU_PRESETS` that come from data sheets."""

MAGNETOMETER_PRESETS: dict[str, dict[str, float]] = {
    # Hard and soft iron belong to the aircraft around the sensor and are on no sheet: the scenario gives them.
    "bmm150": {"noise_ut": 0.3, "rate_hz": 20.0},
    "hmc5983": {"noise_ut": 0.2},
}
"""Magnetometers, keys of section `magnetometer`."""
MAGNETOMETER_SHEETS = {
    "bmm150": "Bosch BMM150 data sheet, high-accuracy preset, as quoted in the documentation of MetaWear-SDK-Python",
    "hmc5983": "Honeywell HMC5983 data sheet, page 1: field resolution of 2 mG, taken for the noise",
}
"""Where these numbers were seen."""

BEACON_PRESETS: dict[str, dict[str, float]] = {
    # How far either reaches is not in the sources.
    "uwb": {
        "sigma_m": 0.025, "bias_sigma_m": 0.05, "growth_m": 0.3, "growth_sigma_m": 0.05, "growth_distance_m": 17.0,
    },
    # Indicated distances at 0, 50, ..., 250 m were 4.4, 57.6, 103, 148, 201, 253 m: 4.1 m RMS off. The noise of single
    # ranges is not in them: the scenario gives it.
    "sx1280": {"carrier_mhz": 2400.0, "bias_sigma_m": 4.1},
    # The noise is that which PX4 assumes by default, EKF2_RNGBC_NOISE; no source has a measured one, or a bias.
    "radio-868": {"carrier_mhz": 868.0, "eirp_dbm": 14.0, "sensitivity_dbm": -121.0, "sigma_m": 30.0},
    "radio-915": {"carrier_mhz": 915.0, "eirp_dbm": 20.0, "sensitivity_dbm": -121.0, "sigma_m": 30.0},
    # The middle of the band. Power and reach are not in the source.
    "long-range": {"carrier_mhz": 750.0, "sigma_m": 30.0},
}  # fmt: skip
"""Ranging beacons, keys of section `beacons`."""
BEACON_SHEETS = {
    "uwb": "ultra-wideband modules outdoors: medians over 384 recordings of 90 ranges each, 2 to 61 m, line of sight",
    "sx1280": "Semtech SX1280, 2.4 GHz LoRa ranging in an open field, one pair of modules: www.loratracker.uk/?p=974",
    "radio-868": "25 mW of end devices (doi:10.1186/s13638-019-1502-5, table 6); sensitivity of the transceiver Si1000 "
    "(Tridgell, Building an open source telemetry radio); noise: PX4, src/modules/ekf2/params_ranging_beacon.yaml",
    "radio-915": "power and sensitivity of the transceiver Si1000 (Tridgell, Building an open source telemetry radio); "
    "noise: PX4, src/modules/ekf2/params_ranging_beacon.yaml",
    "long-range": "band of 500 to 1000 MHz: github.com/ArduPilot/ardupilot/pull/33586; noise: PX4, "
    "src/modules/ekf2/params_ranging_beacon.yaml",
}
"""Where these numbers were seen."""
BEACON_UNVERIFIED = dict.fromkeys(("radio-868", "radio-915", "long-range"), "sigma_m")
"""Key of each of these presets whose value nobody measured."""
BEACON_LACKS = {"sx1280": "sigma_m", **dict.fromkeys(BEACON_UNVERIFIED, "bias_sigma_m")}
"""Key that a preset has no value for, and that a simulation needs."""

_LIMIT = 1.959963985
"""A limit that holds for 95 % in 1 sigma, of a Gaussian error."""

STATION_PRESETS: dict[str, dict[str, dict[str, float]]] = {
    "azimuth_station": {
        # Alignment of the course at the threshold, 3.1.3.6; bends, attachment C, 2.1.4; linear up to 0.180 DDM at
        # 0.00145 DDM/m, 3.1.3.7. Noise is not in them: the scenario gives it.
        "ils-1": {"bias_m": 10.5 / _LIMIT, "bends_m": 10.0 / _LIMIT, "half_width_m": 0.180 / 0.00145},
        "ils-2": {"bias_m": 7.5 / _LIMIT, "bends_m": 5.0 / _LIMIT, "half_width_m": 0.180 / 0.00145},
        "ils-3": {"bias_m": 3.0 / _LIMIT, "bends_m": 5.0 / _LIMIT, "half_width_m": 0.180 / 0.00145},
        # Path following error 20 ft, control motion noise 10.5 ft. How much of the first is constant was not seen: here
        # all of it, which a filter cannot average.
        "mls": {"bias_m": 20.0 * 0.3048 / _LIMIT, "noise_m": 10.5 * 0.3048 / _LIMIT},
    },
    "elevation_station": {
        # The path's angle within 0.075 of it; full scale 0.24 of it. Bends and noise were not seen.
        "ils": {"bias_deg": 0.075 * 3.0 / _LIMIT, "low_deg": 3.0 * 0.76, "high_deg": 3.0 * 1.24},
        # Path following error 0.133 deg, its noise 0.087 deg below 1.5 rad/s, control motion noise 0.05 deg; guidance
        # from 0.9 deg on.
        "mls": {
            "bias_deg": math.sqrt(0.133**2 - 0.087**2) / _LIMIT, "bends_deg": 0.087 / _LIMIT,
            "bends_time_s": 1.0 / 1.5, "noise_deg": 0.05 / _LIMIT, "low_deg": 0.9,
        },
    },
    "dme": {
        # The whole error of the system, of which no part is said to vary.
        "dme-n": {"bias_m": 370.0 / _LIMIT},
        # Path following error 30 m, control motion noise 18 m, on a path of 3 deg.
        "dme-p": {"bias_m": 30.0 / _LIMIT, "noise_m": 18.0 / _LIMIT},
    },
}  # fmt: skip
"""Ground stations, keys of their sections: published limits, taken for 95 % of a Gaussian error.

ils-1 to ils-3: ICAO Annex 10, volume I, 3.1.3.6, 3.1.3.7 and attachment C, 2.1.4.
ils: 14 CFR 171.267 (a) (1); Annex 10, 3.1.5.6.
mls: 14 CFR 171.313, table 10, and 171.317, table 13; Annex 10, attachment G, 13.6.4.2.
dme-n: Annex 10, 3.5.3.1.3.3. dme-p: Annex 10, attachment C, 7.3.2.1.6.
"""

SIGNAL_PRESETS: dict[str, dict[str, Any]] = {
    # The landing paper: white noise of pseudoranges (variance 5 m2 at the zenith), no time-correlated errors.
    "white": {},
    # A single-frequency receiver without corrections: sizes at the zenith of the simulation program of Groves (2013)
    # (satellites 1 m, ionosphere 2 m, troposphere 0.2 m, code 1 m), multipath of Langel, Garcia Crespillo & Joerger
    # (2021); times: `docs/theory/lasting-errors.md`, section 2.
    "open-sky": {
        "range_sigma_m": 1.0,
        "range_law": "constant",
        "errors": {
            "orbit_clock": {"sigma_m": 1.0, "correlation_time_s": 9000.0},
            "ionosphere": {"sigma_m": 2.0, "correlation_time_s": 1800.0},
            "troposphere": {"sigma_m": 0.2, "correlation_time_s": 1800.0},
            "multipath": {"sigma_m": 0.5, "correlation_time_s": 100.0},
        },
    },
    # Residuals after the corrections of a satellite-based augmentation: sizes chosen with the errors in view that the
    # FAA reports of WAAS; section 2.
    "sbas": {
        "range_sigma_m": 0.3,
        "range_law": "constant",
        "errors": {
            "orbit_clock": {"sigma_m": 0.3, "correlation_time_s": 1800.0},
            "ionosphere": {"sigma_m": 0.3, "correlation_time_s": 1800.0},
            "troposphere": {"sigma_m": 0.12, "correlation_time_s": 1800.0},
            "multipath": {"sigma_m": 0.13, "correlation_time_s": 100.0},
        },
    },
    # Residuals after the corrections of a station at the aerodrome: its own multipath and the aircraft's, and 10 parts
    # per million of a distance of 5 km; section 2.
    "differential": {
        "range_sigma_m": 0.3,
        "range_law": "constant",
        "errors": {
            "ionosphere": {"sigma_m": 0.05, "correlation_time_s": 1800.0},
            "multipath": {"sigma_m": 0.18, "correlation_time_s": 100.0},
        },
    },
}
"""Ranging errors of satellites, keys of section `signals`."""

SENSOR_CLASSES: dict[str, dict[str, dict[str, float]]] = {
    # Groves (2013), tables 4.1 and section 4.4: grades of inertial sensors. `drift` and `bias` are the turn-on
    # bias without a standstill; `markov` is the in-run instability with its correlation time.
    "consumer": {
        "gyro": {"drift_deg_h": 1000.0, "arw_deg_sqrt_h": 1.0, "markov_deg_h": 20.0, "markov_time_s": 300.0},
        "accelerometer": {"bias_mg": 10.0, "vrw_m_s_sqrt_h": 0.6, "markov_mg": 1.0, "markov_time_s": 300.0},
    },
    "industrial": {
        "gyro": {"drift_deg_h": 200.0, "arw_deg_sqrt_h": 0.3, "markov_deg_h": 10.0, "markov_time_s": 300.0},
        "accelerometer": {"bias_mg": 8.0, "vrw_m_s_sqrt_h": 0.15, "markov_mg": 0.3, "markov_time_s": 300.0},
    },
    "tactical": {
        "gyro": {"drift_deg_h": 10.0, "arw_deg_sqrt_h": 0.06, "markov_deg_h": 1.0, "markov_time_s": 300.0},
        "accelerometer": {"bias_mg": 2.0, "vrw_m_s_sqrt_h": 0.05, "markov_mg": 0.1, "markov_time_s": 300.0},
    },
}
