"""The vertical acceleration that F omits of a tilt error, against drawn rotations."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from navsim.filter.filter_loop import add_second_order_of_tilt
from navsim.filter.states import POS, VEL

G, DT, TIME = 9.8, 0.2, 1.5
DOWN = 2
TILT = np.radians([[6.0, 2.0], [2.0, 4.0]]) * np.radians(5.0)
"""Covariance of the tilt errors about north and east, rad2."""


def grown() -> np.ndarray:
    p = np.zeros((15, 15))
    add_second_order_of_tilt(p, np.array([TILT[0, 0], TILT[1, 1], TILT[0, 1]]), G, DT, TIME)
    return p


def test_the_noise_has_twice_the_mean_square_of_drawn_tilt_errors() -> None:
    tilt = np.random.default_rng(3).multivariate_normal([0.0, 0.0], TILT, 400_000)
    turned = Rotation.from_rotvec(np.column_stack([tilt, np.zeros(len(tilt))]))
    measured = turned.inv().apply([0.0, 0.0, -G])
    predicted = measured + np.cross(np.column_stack([tilt, np.zeros(len(tilt))]), measured)
    omitted = -G - predicted[:, DOWN]
    np.testing.assert_allclose(grown()[VEL + DOWN, VEL + DOWN], 2.0 * np.mean(omitted**2) * TIME * DT, rtol=0.03)
    assert omitted.min() >= 0.0


def test_the_covariance_is_that_of_a_white_acceleration() -> None:
    """Position and velocity of a white noise of density q after T: q T^3 / 3, q T^2 / 2, q T."""
    p = grown()
    q = p[VEL + DOWN, VEL + DOWN] / DT
    at = np.ix_([POS + DOWN, VEL + DOWN], [POS + DOWN, VEL + DOWN])
    np.testing.assert_allclose(p[at], q * np.array([[DT**3 / 3.0, DT**2 / 2.0], [DT**2 / 2.0, DT]]), rtol=1e-12)
    p[at] = 0.0
    assert not p.any()
