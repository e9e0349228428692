"""Named sensor sets with their provenance."""

from __future__ import annotations

from typing import Any

IMU_PRESETS: dict[str, dict[str, dict[str, float]]] = {
    # The landing paper, list of initial data: constant gyro drift 700 deg/h with a
    # random part of 30 deg/h, accelerometer error 1e-3 g with a random part of 1e-2 g. "Random part" is read
    # as 1 sigma of a white sequence per sample at 100 Hz, the constant parts as 1 sigma over flights
    # (`docs/theory/landing.md`, section 1).
    "paper": {
        "gyro": {"drift_deg_h": 700.0, "noise_deg_h": 30.0},
        "accelerometer": {"bias_mg": 1.0, "noise_mg": 10.0},
    },
    # No errors at all: checks the mechanisation against the truth.
    "perfect": {
        "gyro": {"drift_deg_h": 0.0, "noise_deg_h": 0.0},
        "accelerometer": {"bias_mg": 0.0, "noise_mg": 0.0},
    },
}

SIGNAL_PRESETS: dict[str, dict[str, Any]] = {
    # The landing paper: white noise of pseudoranges (variance 5 m2 at the zenith), nothing that lasts.
    "white": {},
    # A receiver of one frequency by itself: sizes at the zenith of the simulation program of Groves (2013) (satellites
    # 1 m, ionosphere 2 m, troposphere 0.2 m, code 1 m), multipath of Langel, Garcia Crespillo & Joerger (2021); where
    # the times come from, `docs/theory/lasting-errors.md`, section 2.
    "open-sky": {
        "range_sigma_m": 1.0,
        "range_law": "constant",
        "errors": {
            "orbit_clock": {"sigma_m": 1.0, "time_s": 9000.0},
            "ionosphere": {"sigma_m": 2.0, "time_s": 1800.0},
            "troposphere": {"sigma_m": 0.2, "time_s": 1800.0},
            "multipath": {"sigma_m": 0.5, "time_s": 100.0},
        },
    },
    # What the corrections of a satellite-based augmentation leave: sizes chosen with the errors in view that the
    # FAA reports of WAAS, not measured against them; section 2.
    "sbas": {
        "range_sigma_m": 0.3,
        "range_law": "constant",
        "errors": {
            "orbit_clock": {"sigma_m": 0.3, "time_s": 1800.0},
            "ionosphere": {"sigma_m": 0.3, "time_s": 1800.0},
            "troposphere": {"sigma_m": 0.12, "time_s": 1800.0},
            "multipath": {"sigma_m": 0.13, "time_s": 100.0},
        },
    },
    # What the corrections of a station at the aerodrome leave: its own multipath and the aircraft's, and 10 parts in a
    # million of 5 km of way; section 2.
    "differential": {
        "range_sigma_m": 0.3,
        "range_law": "constant",
        "errors": {
            "ionosphere": {"sigma_m": 0.05, "time_s": 1800.0},
            "multipath": {"sigma_m": 0.18, "time_s": 100.0},
        },
    },
}
"""Ranging errors of satellites, keys of section `signals`."""

SENSOR_CLASSES: dict[str, dict[str, dict[str, float]]] = {
    # Groves (2013), tables 4.1 and section 4.4: grades of inertial sensors. `drift` and `bias` are what is left of the
    # turn-on bias where no standstill shows it; `markov` the in-run instability with its correlation time.
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
