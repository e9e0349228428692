"""Code loop, reflections and carrier smoothing: closed forms, limits, statistics."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.gnss import dll
from navsim.gnss.constellations.systems import GPS

CHIP = dll.chip_length(GPS)
GROUND = dll.GroundReflection(0.0, 15.0, 0.035, -10.0)


def test_thermal_noise_of_a_usual_loop() -> None:
    """45 dB-Hz, half a chip, 1 Hz: 0.83 m; halved spacing and four times the power take off sqrt(2) and 2."""
    loop = dll.CodeLoop(0.5, 1.0, 0.02)
    assert float(loop.sigma(np.array(45.0), CHIP)) == pytest.approx(0.83, abs=0.02)
    narrow = dll.CodeLoop(0.25, 1.0, 0.02)
    assert float(loop.sigma(np.array(60.0), CHIP) / narrow.sigma(np.array(60.0), CHIP)) == pytest.approx(
        2**0.5, rel=1e-3
    )
    strong = loop.sigma(np.array(60.0), CHIP) / loop.sigma(np.array(60.0 + 20 * np.log10(2.0)), CHIP)
    assert float(strong) == pytest.approx(2.0, rel=1e-3)


def test_multipath_of_a_short_delay_in_closed_form() -> None:
    """Up to half a spacing apart both correlation slopes are met: error = delta m / (1 + m), m = alpha cos(phase)."""
    excess = np.linspace(0.0, 0.2 * CHIP, 20)
    for amplitude in (0.1, 0.5, 0.9):
        for phase in (0.0, 1.0, np.pi):
            m = amplitude * np.cos(phase)
            ours = dll.multipath_error(0.5, CHIP, np.full(20, amplitude), excess, np.full(20, phase))
            expected = excess * m / (1.0 + m)
            inside = np.abs(excess - expected) + np.abs(expected) < 0.25 * CHIP
            np.testing.assert_allclose(ours[inside], expected[inside], atol=1e-4)


def test_mean_and_spread_of_a_short_delay_over_phases() -> None:
    """Of delta m / (1 + m) with m = alpha cos(phase), in closed form by the moments of 1 / (1 + m)."""
    excess, amplitude = np.array([0.5, 2.0, 5.0]), np.array([0.1, 0.3, 0.5])
    mean, spread = dll.over_phases(0.5, CHIP, amplitude, excess)
    left = 1.0 - amplitude**2
    np.testing.assert_allclose(mean, excess * (1.0 - left**-0.5), atol=1e-4)
    np.testing.assert_allclose(spread, excess * np.sqrt(left**-1.5 - 1.0 / left), atol=1e-4)


def test_multipath_has_its_known_envelope() -> None:
    """In phase the plateau is alpha d / 2 chips; beyond 1 + d / 2 chips there is none; opposite phases have opposite
    signs."""
    alpha, spacing = 0.3, 0.2
    far = dll.multipath_error(spacing, CHIP, np.array([alpha]), np.array([0.5 * CHIP]), np.array([0.0]))
    assert far[0] == pytest.approx(alpha * spacing / 2 * CHIP, rel=1e-3)
    out = dll.multipath_error(spacing, CHIP, np.array([alpha]), np.array([1.2 * CHIP]), np.array([0.0]))
    assert out[0] == pytest.approx(0.0, abs=1e-4)
    against = dll.multipath_error(spacing, CHIP, np.array([alpha]), np.array([0.5 * CHIP]), np.array([np.pi]))
    assert against[0] == pytest.approx(-far[0], rel=1e-3)


def test_reflection_over_flat_ground() -> None:
    """Excess length 2 h1 h2 / d far away; towards grazing the ground mirrors with the opposite sign."""
    amplitude, excess, _ = dll.reflection(GROUND, 1575.42e6, np.array([50.0]), 4.0, np.array([5000.0]))
    assert excess[0] == pytest.approx(2 * 50.0 * 4.0 / 5000.0, rel=1e-3)
    assert 0.0 < amplitude[0] < 1.0
    grazing = dll.reflection(dll.GroundReflection(0.0, 15.0, 0.035, 0.0), 1575.42e6, np.array([1.0]), 1.0,
                                  np.array([20000.0]))  # fmt: skip
    assert grazing[0][0] == pytest.approx(1.0, abs=0.01)
    assert np.cos(grazing[2][0] + 2 * np.pi * grazing[1][0] * 1575.42e6 / 299792458.0) == pytest.approx(-1.0, abs=0.01)
    brewster = dll.reflection(GROUND, 1575.42e6, np.array([100.0]), 100.0, np.array([2 * 100.0 * 15**0.5]))
    assert brewster[0][0] < 0.5  # where the vertical part vanishes, half of the horizontal one is left


def test_a_mast_over_dry_ground_fades() -> None:
    """The numbers of docs/how-to/pseudolite.md; no fade is deeper than its bound."""
    above = np.linspace(153.0, 10.0, 4000)
    dry = dll.GroundReflection(0.0, 4.0, 1e-3, -10.0)
    amplitude, excess, phase = dll.reflection(dry, 1575.42e6, above, 3.0, 300.0 + 4000.0 / 153.0 * above)
    change = dll.fade(amplitude, phase)
    assert (change.max(), change.min()) == pytest.approx((5.5, -20.5), abs=0.05)
    error = dll.multipath_error(0.5, CHIP, amplitude, excess, phase)
    assert np.abs(error).max() == pytest.approx(1.8, abs=0.05)
    assert change[np.argmax(np.abs(error))] < -15.0
    assert dll.fade(np.ones(1), np.full(1, np.pi)) == pytest.approx([-40.0])


def test_smoothing_has_the_variance_it_says() -> None:
    rng = np.random.default_rng(1)
    e, runs, most = 120, 4000, 50
    used = np.ones((e, 1), dtype=bool)
    used[60:63] = False
    variance, count = dll.smoothed_variance(np.full((e, 1), 4.0), used, most)
    truth = np.linspace(0.0, 500.0, e)[:, None]
    code = np.where(used, truth + 2.0 * rng.standard_normal((e, runs)), np.nan)  # runs side by side, as sources
    errors = dll.smooth(code, truth, np.repeat(count, runs, axis=1)) - truth
    sampled = np.var(errors[used[:, 0]], axis=1)
    np.testing.assert_allclose(sampled, variance[used[:, 0], 0], rtol=0.15)
    assert count[63, 0] == 1
    steady, _ = dll.smoothed_variance(np.full((1000, 1), 4.0), np.ones((1000, 1), dtype=bool), most)
    assert steady[-1, 0] == pytest.approx(4.0 / (2 * most - 1), rel=1e-6)
