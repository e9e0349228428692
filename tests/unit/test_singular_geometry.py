"""Geometries on their way to being singular: fixes are refused before filters can no longer weigh them."""

from __future__ import annotations

import numpy as np

from navsim.filter import covariance
from navsim.filter.states import MAX_MEASUREMENT_SIZE
from navsim.geodesy.earth import ecef_from_llh, ned_matrix
from navsim.gnss.dop import MAX_CLOCKS, SINGULAR, dops
from navsim.gnss.position_fix import fixes

SIGMA, RATE_SIGMA = 4.5, 0.05
HEIGHTS = np.geomspace(1.0, 1e-8, 161)


def fixed() -> tuple[np.ndarray, np.ndarray]:
    """Four sources 20 000 km away whose unit vectors end ever nearer to one plane: covariances (e, 6, 6) of fixes, nan
    without one, and PDOP (e,) by the geometry."""
    llh = np.array([0.98, 0.65, 300.0])
    azimuth = np.array([0.1, 2.1, 4.4, 3.0])
    los = np.empty((HEIGHTS.size, 4, 3))
    for e, height in enumerate(HEIGHTS):
        up = np.array([0.5, 0.5, 0.5, 0.5 * (1.0 - height)])
        los[e] = np.stack([np.sqrt(1.0 - up**2) * np.cos(azimuth), np.sqrt(1.0 - up**2) * np.sin(azimuth), -up], axis=1)
    start = ecef_from_llh(llh)
    position = start + 2e7 * (los @ ned_matrix(llh))
    shape, clock = los.shape[:2], np.zeros(4, np.int64)
    cov = np.empty((HEIGHTS.size, 6, 6))
    fixes(
        start, position, np.zeros_like(position), np.full(shape, SIGMA), np.full(shape, RATE_SIGMA), clock,
        np.full(shape, 2e7), np.zeros(shape), np.empty((shape[0], 3)), np.empty((shape[0], 3)),
        np.empty((shape[0], MAX_CLOCKS)), cov,
    )  # fmt: skip
    return cov, dops(los, clock)[:, 1]


def test_a_geometry_that_is_all_but_singular_has_no_fix() -> None:
    """By PDOP, of fixes and of geometries alike."""
    cov, pdop = fixed()
    there = np.isfinite(cov[:, 0, 0])
    np.testing.assert_array_equal(there, np.isfinite(pdop))
    assert there[0]
    assert not there[-1]
    limit = np.sqrt(SINGULAR / 4.0)
    assert 0.8 * limit < np.nanmax(pdop) < limit
    np.testing.assert_allclose(
        np.sqrt(np.trace(cov[there, :3, :3], axis1=1, axis2=2)), SIGMA * pdop[there], rtol=1e-4
    )  # fmt: skip


def test_what_a_filter_makes_of_any_fix_is_a_covariance() -> None:
    """Fix after fix of each geometry: P stays positive definite, and no worse than it was."""
    cov, _ = fixed()
    rng = np.random.default_rng(7)
    root = rng.standard_normal((15, 15)) * np.repeat([300.0, 0.5, 0.02, 1e-3, 1e-2], 3)[:, None]
    h = np.zeros((MAX_MEASUREMENT_SIZE, 15))
    h[:6, :6] = np.eye(6)
    for r in cov[np.isfinite(cov[:, 3, 3])]:
        p = root @ root.T
        before = p.copy()
        noise = np.zeros((MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE))
        noise[:6, :6] = r
        pht, s, k, work = (
            np.zeros((15, MAX_MEASUREMENT_SIZE)),
            np.zeros((MAX_MEASUREMENT_SIZE, MAX_MEASUREMENT_SIZE)),
            np.zeros((15, MAX_MEASUREMENT_SIZE)),
            np.zeros((15, MAX_MEASUREMENT_SIZE)),
        )
        for _ in range(5):
            assert covariance.gain(p, h, noise, 6, pht, s, k)
            covariance.joseph(p, h, noise, 6, pht, k, work)
        scale = np.sqrt(np.diag(before))
        assert np.linalg.eigvalsh(p / scale / scale[:, None])[0] > 0.0
        assert np.linalg.eigvalsh((before - p) / scale / scale[:, None])[0] > -1e-9
