"""Noise of a receiver's clock: a bias and a drift, driven by white noises of phase and frequency.

Source: Brown & Hwang, Introduction to Random Signals and Applied Kalman Filtering, the two-state model of receiver
clocks: S_f = c^2 h0 / 2, S_g = 2 pi^2 c^2 h_-2.
"""

from __future__ import annotations

import math

import numpy as np

from navsim.geodesy.earth import SPEED_OF_LIGHT

OSCILLATORS = {"quartz": (2e-19, 2e-20), "tcxo": (1e-21, 2e-20), "ocxo": (8e-20, 4e-23), "rubidium": (2e-20, 4e-29)}
"""Allan variance coefficients h0 (s) and h_-2 (1/s) by Brown & Hwang, of a TCXO by Irsigler & Eissfeller (2002)."""


def densities(h0: float, h_minus2: float) -> tuple[float, float]:
    """Densities of the white noises of phase (m2/s) and frequency (m2/s3) from the Allan variance coefficients h0 (s)
    and h_-2 (1/s)."""
    return 0.5 * SPEED_OF_LIGHT**2 * h0, 2.0 * (math.pi * SPEED_OF_LIGHT) ** 2 * h_minus2


def step_covariance(density: np.ndarray, dt: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariance that clock noises of these densities (2,) add over dt (...), s.

    Returns the variance of the bias (m2), the covariance of both, the variance of the drift.
    """
    phase, frequency = density
    return phase * dt + frequency * dt**3 / 3.0, frequency * dt**2 / 2.0, frequency * dt
