"""Second-order errors of fixes beside a near source against fixes that the receiver makes of drawn ranges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix, shifted
from navsim.landing.study import Case, prepare
from navsim.scenario.load import read
from navsim.simulation.measurements import receiver_fixes
from navsim.simulation.range_curvature import Curvature, fix_forms
from navsim.simulation.shared_truth import assumed_measurements
from tests.conftest import SCENARIOS

SITE = ("receiver.rate_hz=2", "imu.rate_hz=10", "receiver.lever_arm_m=[0, 0, 0]", "pseudolites.count=1",
        "pseudolites.l1_m=245")  # fmt: skip


def passed(side: float, *settings: str) -> Case:
    """The landing that passes over a pseudolite, or beside it."""
    scenario, document = read(SCENARIOS / "landing_open_sky.yaml", [*SITE, f"pseudolites.s_m={side}", *settings])
    return prepare(scenario, document)


@dataclass(frozen=True)
class Drawn:
    """Errors of fixes (n, 6) at one epoch, by the receiver, and to first order (n, 6); u: to the pseudolite, NED."""

    errors: np.ndarray
    first: np.ndarray
    u: np.ndarray
    forms: np.ndarray
    sigma: np.ndarray


def drawn(case: Case, runs: int) -> Drawn:
    """At the epoch when the pseudolite is nearest."""
    world, rng = case.shared, np.random.default_rng(7)
    s, fix_errors = world.signals, world.fix_errors
    near = int(np.argmin(s.range[:, -1]))
    ranges, rates = assumed_measurements(world)
    axes = ned_matrix(llh_from_ecef(s.antenna))[near]
    errors, first = [], []
    for _ in range(runs // WIDTH):
        off = np.where(s.used, s.fix_sigma, 0.0)[..., None] * rng.standard_normal((*ranges.shape, WIDTH))
        fixes = receiver_fixes(world, ranges[..., None] + off, np.repeat(rates[..., None], WIDTH, axis=2))
        position = (ecef_from_llh(fixes.llh[near].T) - s.antenna[near]) @ axes.T
        velocity = fixes.velocity[near].T - axes @ s.antenna_velocity[near]
        errors.append(np.hstack([position, velocity]))
        first.append((fix_errors.by_range[near] @ off[near]).T)
    away = axes @ (s.position[near, -1] - s.antenna[near])
    forms = fix_forms(s, fix_errors.by_range, fix_errors.by_rate)[near]
    sigma = fix_errors.of_ranges(s.fix_sigma)[near, :3, :3]
    return Drawn(np.vstack(errors), np.vstack(first), away / np.linalg.norm(away), forms, sigma)


@pytest.mark.parametrize("side", [0.5, 30.0])
def test_second_order_errors_are_those_of_the_receiver(side: float) -> None:
    """Along the line of sight, of position and of velocity: what a fix is off beside its first order is the quadratic
    form of that, and its mean is the trace."""
    found = drawn(passed(side), 400)
    rest = found.errors - found.first
    second = np.einsum("nj,kji,ni->nk", found.first[:, :3], found.forms, found.first[:, :3])
    for part in (slice(0, 3), slice(3, 6)):
        along, told = rest[:, part] @ found.u, second[:, part] @ found.u
        assert np.std(along - told) < 0.35 * np.std(along)
        expected = np.trace(found.forms[part] @ found.sigma, axis1=1, axis2=2) @ found.u
        assert along.mean() == pytest.approx(expected, abs=3.5 * np.std(along) / np.sqrt(len(along)))


def draw_forms(rng: np.random.Generator, epochs: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Symmetric forms (epochs, count, 3, 3) and covariances (epochs, 3, 3)."""
    forms = rng.standard_normal((epochs, count, 3, 3))
    root = rng.standard_normal((epochs, 3, 3))
    return forms + np.swapaxes(forms, 2, 3), root @ np.swapaxes(root, 1, 2)


def test_products_have_the_moments_of_the_forms() -> None:
    """Mean tr(F C), covariance 2 tr(F C G C) of forms F, G [Magnus 1978]."""
    rng = np.random.default_rng(3)
    forms, covariance = draw_forms(rng, 2, 4)
    found = Curvature.of(forms, np.zeros_like(covariance), covariance, np.broadcast_to(np.eye(4), (2, 4, 4)))
    by = forms @ covariance[:, None]
    np.testing.assert_allclose(found.mean, np.trace(by, axis1=2, axis2=3), rtol=1e-12)
    moments = 2.0 * np.einsum("makl,mblk->mab", by, by)
    np.testing.assert_allclose(found.correlated @ np.swapaxes(found.correlated, 1, 2), moments, rtol=1e-9)
    np.testing.assert_allclose(found.white, np.zeros((2, 4, 4)), atol=1e-9)


def test_noise_that_stands_for_lasting_errors_is_never_too_small() -> None:
    """The covariance of all measurements together, lasting and as white noise: the difference has no negative value."""
    rng = np.random.default_rng(4)
    forms, lasting = draw_forms(rng, 5, 3)
    found = Curvature.of(forms, np.zeros_like(lasting), lasting, np.broadcast_to(np.eye(3), (5, 3, 3)))
    together = found.correlated.reshape(15, -1)
    white = np.zeros((15, 15))
    for t in range(5):
        white[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] = found.bound[t]
    assert np.linalg.eigvalsh(white - together @ together.T).min() > -1e-9


def test_positions_are_shifted_along_their_axes() -> None:
    llh = np.array([[0.97, 0.65, 120.0], [-0.3, -2.0, 30.0]])
    by = np.array([[1.0, -2.0, 3.0], [0.5, 0.25, -0.125]])
    moved = np.einsum("eij,ej->ei", ned_matrix(llh), ecef_from_llh(shifted(llh, by, llh)) - ecef_from_llh(llh))
    np.testing.assert_allclose(moved, by, atol=1e-5)
    lanes = shifted(np.repeat(llh[..., None], 2, axis=2), by, llh)
    np.testing.assert_array_equal(lanes[..., 0], shifted(llh, by, llh))
