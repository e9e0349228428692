"""Named sensor sets with their provenance."""

from __future__ import annotations

IMU_PRESETS: dict[str, dict[str, dict[str, float]]] = {
    # The landing paper (`shared/papers/002`, list of initial data): constant gyro drift 700 deg/h with a
    # random part of 30 deg/h, accelerometer error 1e-3 g with a random part of 1e-2 g. "Random part" is read
    # as 1 sigma of a white sequence per sample at 100 Hz, the constant parts as 1 sigma over flights
    # (`landing.md` section 1).
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
