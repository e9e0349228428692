"""Covariance once an interval against covariance at every sample of the IMU, over whole flights, of every kind.

A filter that has to get to every sample takes each for an interval by itself: the recursion by samples.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from navsim.filter.records import PASS, Events
from navsim.simulation.landing import fly
from tests.helpers import case

FOLLOWED = (
    "imu.gyro.scale_ppm=3000", "imu.accelerometer.scale_ppm=3000", "imu.gyro.misalignment_mrad=3",
    "imu.accelerometer.misalignment_mrad=3", "filter.scale_factors=true", "filter.misalignments=true",
)  # fmt: skip
DRIVEN = "imu.preset=adis16488"
"""Biases that walk."""
LATE = ("receiver.rate_hz=1", "receiver.latency_s=0.137")
CASES = [
    ("eskf", ()), ("eskf", FOLLOWED), ("eskf", (DRIVEN,)), ("eskf", LATE), ("left-invariant", ()), ("tfg", ()),
    ("first-estimates", ()), ("observability-constrained", ()),
]  # fmt: skip


def at_every_sample(events: Events, samples: np.ndarray) -> Events:
    """The events with nothing but a time to get to at each sample, for the filter itself."""
    # what runs ahead stays behind the event that it starts from
    reached = np.maximum.accumulate(np.where(events.ahead, -np.inf, events.time))
    at = np.searchsorted(reached, samples)
    return Events(*(np.insert(m, at, new) for m, new in zip(events, (samples, PASS, 0, False), strict=True)))


@pytest.mark.parametrize(("kind", "settings"), CASES, ids=[f"{kind} {' '.join(s)}"[:40] for kind, s in CASES])
def test_an_interval_is_its_samples(kind: str, settings: tuple[str, ...]) -> None:
    """Sigma of every state at every output, two runs."""
    made = case(f"filter.kind={kind}", "duration_s=25", "approach.start_height_m=50", *settings)
    flight, samples = made.flight, made.shared.imu_time[1:-1]
    by_interval = fly(flight, 3811, (0, 1)).sigma
    by_samples = fly(replace(flight, events=at_every_sample(flight.events, samples)), 3811, (0, 1)).sigma
    assert not np.array_equal(by_interval, by_samples)
    np.testing.assert_allclose(by_interval, by_samples, rtol=1e-5)
