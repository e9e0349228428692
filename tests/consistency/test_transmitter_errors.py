"""Errors of pseudolites as states of the filter: consistent, and as the covariance analysis says."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.landing.study import covariance_analysis
from tests.helpers import case

BRIEF = (
    "duration_s=20", "receiver.rate_hz=2", "imu.rate_hz=20", "pseudolites.frame=runway", "sky.source=nominal-gps",
    "pseudolites.clock=gps", "filter.kind=eskf",
)  # fmt: skip
FREE = (
    "pseudolites.survey_sigma_m=0.5", "pseudolites.clock_sigma_ns=15", "pseudolites.clock_drift_sigma_ppb=5",
    "pseudolites.clock_noise={oscillator: tcxo}", "pseudolites.clock_age_s=3",
)  # fmt: skip


@pytest.mark.parametrize("coupling", ["loose", "tight"])
@pytest.mark.parametrize("more", [(), ("receiver.latency_s=0.2",)], ids=["now", "late"])
def test_every_state_is_consistent(coupling: str, more: tuple[str, ...]) -> None:
    """RMS of error / sigma over 80 landings, of every state at several times; the covariance analysis has the same
    sigma as the filter, whose model is the truth."""
    flown = case(*BRIEF, *FREE, f"filter.coupling={coupling}", *more)
    analysis = covariance_analysis(flown)
    names = flown.states
    own = [i for i, name in enumerate(names) if name.startswith("transmitter_")]
    assert len(own) == 10
    ratio = np.sqrt(np.einsum("tii->ti", analysis.covariance) / np.einsum("tii->ti", analysis.assumed))
    runs = list(flown.fly_runs(20, 0, 80, measured=False))
    z = np.concatenate([run.error for run in runs]) / np.concatenate([run.sigma for run in runs])
    rms = np.sqrt(np.mean(z**2, axis=0))
    assert np.all(np.abs(ratio[:, own] - 1.0) < 0.02)
    assert np.all(np.abs(rms[[0, 1, -1]][:, [*range(9), *own]] - 1.0) < 4.0 / np.sqrt(160.0))
