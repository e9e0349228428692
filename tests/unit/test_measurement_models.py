"""Dispatch of measurement models: a kind without one is refused, in kernels too."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.defect import Defect
from navsim.filter import states
from navsim.filter.design import SensorDesign
from navsim.filter.measurement_kinds import ALTITUDE, AltitudeTable, Measurements
from navsim.filter.measurement_models import observe

UNKNOWN = 99


def observed(kind: int) -> float:
    """Innovation of a height of 3 m by an estimate of 1 m."""
    nav = np.zeros(states.NAV_N)
    nav[states.NAV_QUAT], nav[states.NAV_LLH + 2] = 1.0, 1.0
    tables = Measurements.of({ALTITUDE: AltitudeTable(np.array([3.0]), np.array([0.25]))})
    have, z, h, r = np.zeros(6), np.zeros(6), np.zeros((6, states.N_BASE)), np.zeros((6, 6))
    declared = states.declared(states.biases())
    observe(kind, 0, tables, nav, np.zeros(6), 0.01, declared, np.zeros((3, 3)), have, z, h, r)
    return float(z[0])


def test_a_kind_without_a_model_is_refused() -> None:
    """It must not be read as a height, which was the last branch of all."""
    assert observed(ALTITUDE) == -2.0
    with pytest.raises(ValueError, match="no measurement model"):
        observed(UNKNOWN)
    with pytest.raises(KeyError, match="kind 99"):
        Measurements.of({UNKNOWN: None})


def test_a_state_of_sigma_0_in_a_new_unit_is_named() -> None:
    blocks = (*states.biases(), states.Block("magnetometer_hard_iron", "uT", UNKNOWN))
    known = np.repeat([10.0, 1.0, 0.1], 3)
    p = SensorDesign(blocks, (0.0, 0.0, 5.0), np.zeros(2)).covariance(known)
    assert p[-1, -1] == 25.0
    assert np.all(np.diagonal(p) > 0.0), "known units have floors"
    with pytest.raises(Defect, match="sigma 0 of magnetometer_hard_iron_north"):
        SensorDesign(blocks, (0.0, 0.0, 0.0), np.zeros(2)).covariance(known)
