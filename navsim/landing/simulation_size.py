"""Sizes of a landing that follow from its scenario and sky alone, and the memory that they take."""

from __future__ import annotations

from dataclasses import dataclass

from navsim.gnss.receiver import epochs
from navsim.gnss.signals import SignalScenario
from navsim.scenario.landing import Landing

SAMPLE_MEMORY = 3200
"""Memory for an IMU sample in the shared inputs and their computation, bytes."""
SIGNAL_MEMORY = 300
"""A source of signals at an epoch, bytes."""
ANALYSED_MEMORY = 12_000
"""An epoch of a covariance analysis, bytes."""


@dataclass(frozen=True)
class SimulationSize:
    """Sizes of a simulation without regard to its filter."""

    samples: int
    """Samples of the inertial sensors."""
    epochs: int
    """Fix epochs."""
    sources: int
    """Sources of signals."""


def simulation_size(scenario: Landing, sources: SignalScenario) -> SimulationSize:
    """Size of a scenario under a sky."""
    names = sum(len(group.names) for group in sources.satellites) + len(sources.pseudolites.names)
    return SimulationSize(
        epochs(scenario.duration_s, scenario.imu.rate_hz).size,
        scenario.receiver.model().epochs(scenario.duration_s, scenario.imu.rate_hz).size,
        names + (0 if sources.listed is None else len(sources.listed.names)),
    )
