"""Runs that begin with a large tilt error keep centimetre fixes: the gate does not take it for a wrong fix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import navsim
from tests.helpers import SCENARIOS

FIXED = {"forced": [{"state": "fixed", "at_s": 0, "until_s": 4, "error_ned_m": [0, 0, 0]}]}
TILTED = {"initial_errors.fixed": {"attitude_deg": [11, -11, 0]}, "receiver.rate_hz": 2, "duration_s": 3}


def flown(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Errors and sigmas (runs, outputs, 3) of position of 16 runs, m."""
    made = {**TILTED, "receiver.fix_states": FIXED, "filter.initial.attitude_deg": 5.0}
    result = navsim.run(SCENARIOS / "landing.yaml", runs=16, seed=5, set=made, output=folder / "tilted.h5").tree
    filtered = result["filter"]
    return filtered["error"].values[..., :3], filtered["sigma"].values[..., :3]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_no_fix_is_rejected(tmp_path: Path) -> None:
    """15.5 deg of tilt, 3.1 sigma. Without its second order the gate rejects fixes, and errors reach 5 m in 3 s."""
    error, sigma = flown(tmp_path)
    assert np.abs(error[:, -1]).max() < 0.1
    assert np.abs(error[:, 1:] / sigma[:, 1:]).max() < 6.0
