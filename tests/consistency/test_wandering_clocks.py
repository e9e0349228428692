"""Clocks of pseudolites that wander: what is drawn, what the receiver makes of it, what the analyses carry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from navsim.gnss.pseudolite_clock import TransmitterErrors, WanderingClocks
from navsim.landing.study import covariance_analysis
from navsim.simulation.along_truth import along_truth
from navsim.simulation.measurements import measured
from navsim.simulation.sensitivity import carried, sensitivity
from tests.helpers import case

LIGHT = 299792458.0
H0, H_MINUS2, AGE = 2e-20, 1e-22, 20.0
PHASE, FREQUENCY = 0.5 * LIGHT**2 * H0, 2.0 * (np.pi * LIGHT) ** 2 * H_MINUS2
BRIEF = (
    "duration_s=30", "receiver.rate_hz=2", "imu.rate_hz=20", "pseudolites.frame=runway", "sky.source=nominal-gps",
    "pseudolites.clock=gps", "filter.kind=eskf",
)  # fmt: skip
WANDER = (f"pseudolites.clock_noise={{h0: {H0}, h_minus2: {H_MINUS2}}}", f"pseudolites.clock_age_s={AGE}")


def closed_form(time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Covariances (e, e) of offsets, of offsets (rows) with rates, of rates, of a clock set `AGE` before time 0:
    integrals of white noise, and of its integral."""
    since = time + AGE
    least, most = np.minimum.outer(since, since), np.maximum.outer(since, since)
    offsets = PHASE * least + FREQUENCY * (least**2 * most / 2.0 - least**3 / 6.0)
    return offsets, FREQUENCY * (since[:, None] * least - least**2 / 2.0), FREQUENCY * least


@pytest.mark.parametrize("tau", [1, 10])
def test_allan_variance(tau: int) -> None:
    """IEEE Std 1139: h0/(2 tau) + (2 pi)^2 h_-2 tau/6, of a series with some thousand intervals."""
    clocks = WanderingClocks(TransmitterErrors(density=(PHASE, FREQUENCY)), np.full(4, True))
    time = np.arange(40_000) * 0.5
    x = clocks.drawn(time, [np.random.default_rng(3)])[0, :, :, 0] / LIGHT
    m = 2 * tau
    second = x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]
    expected = H0 / (2.0 * tau) + (2.0 * np.pi) ** 2 * H_MINUS2 * tau / 6.0
    assert np.mean(second**2) / (2.0 * tau**2) == pytest.approx(expected, rel=0.05)


def test_what_is_drawn_of_ranges_and_rates() -> None:
    """Of each pseudolite its own, another in each run: variances and correlations against integrals, to 4.5 sigma of
    300 runs of two clocks; nothing of satellites."""
    quiet = ("pseudolites.range_sigma_m=1e-6", "pseudolites.range_rate_sigma_m_s=1e-6", "duration_s=12")
    world = case(*BRIEF, *WANDER, *quiet).shared
    s = world.signals
    clean = (s.range + s.range_bias + world.clock[:, :1], s.range_rate + world.clock[:, 1:])
    still = case(*BRIEF, *quiet).shared
    off = []
    for run in range(300):
        drawn = measured(world, 5, run)
        off.append([one - exact for one, exact in zip(drawn, clean, strict=True)])
        if run < 3:
            for one, other in zip(drawn, measured(still, 5, run), strict=True):
                np.testing.assert_array_equal(one[:, :-2], other[:, :-2])
    found = np.array(off)[..., -2:]  # run, range or rate, epoch, pseudolite
    offsets, mixed, rates = closed_form(s.time)
    close = 4.5 / np.sqrt(600.0)
    for e in (0, s.time.size - 1):
        pairs = found[:, :, e].transpose(1, 0, 2).reshape(2, -1)
        expected = np.array([[offsets[e, e], mixed[e, e]], [mixed[e, e], rates[e, e]]])
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert np.abs((pairs @ pairs.T / 600.0 - expected) / scale).max() < np.sqrt(2.0) * close
    first, last = found[:, 0, 0].ravel(), found[:, 0, -1].ravel()
    correlation = offsets[0, -1] / np.sqrt(offsets[0, 0] * offsets[-1, -1])
    assert np.corrcoef(first, last)[0, 1] == pytest.approx(correlation, abs=close)
    assert abs(np.corrcoef(found[:, 0, -1].T)[0, 1]) < 4.5 / np.sqrt(300.0)


def test_the_receiver_weighs_by_how_far_they_have_wandered() -> None:
    plain, s = case(*BRIEF).shared.signals, case(*BRIEF, *WANDER, "pseudolites.clock_sigma_ns=2").shared.signals
    offsets, _, rates = (np.diag(m) for m in closed_form(s.time))
    ranges = np.sqrt(plain.fix_sigma[:, -2:] ** 2 + (LIGHT * 2e-9) ** 2 + offsets[:, None])
    np.testing.assert_allclose(s.fix_sigma[:, -2:], ranges, rtol=1e-12)
    faster = np.sqrt(plain.rate_sigma[:, -2:] ** 2 + rates[:, None])
    np.testing.assert_allclose(s.fix_rate_sigma[:, -2:], faster, rtol=1e-12)
    np.testing.assert_array_equal(s.fix_sigma[:, :-2], plain.fix_sigma[:, :-2])
    np.testing.assert_array_equal(s.rate_sigma, plain.rate_sigma)


@pytest.mark.parametrize("more", [(), ("receiver.smoothing_s=10", "receiver.latency_s=0.3")], ids=["bare", "smoothed"])
def test_the_analyses_carry_them(more: tuple[str, ...]) -> None:
    """The variance of the last position, and what pushed runs are pushed by: slopes by ranges and range rates, told by
    the adjoint filter, about the dense covariance of integrals."""
    flown = case(*BRIEF, *WANDER, *more)
    along, outputs = along_truth(flown.flight), flown.shared.filter_time.size
    weights = np.zeros((3, outputs, 3))
    weights[:, -1] = np.eye(3)
    slopes = sensitivity(flown.flight, along, weights)
    ranges = slopes.ranges if slopes.phases is None else slopes.ranges + slopes.phases
    both = np.concatenate([ranges, slopes.rates], axis=1)[..., -2:]
    offsets, mixed, rates = closed_form(flown.shared.signals.time)
    dense = np.block([[offsets, mixed], [mixed.T, rates]])
    moved = np.einsum("ij,kjp->kip", dense, both)
    variance = np.einsum("kip,kip->k", both, moved)
    whole = covariance_analysis(flown)
    assert variance.min() > 1e-4
    found = whole.variance[whole.sources.index("pseudolite_clock_noise"), -1, :3]
    np.testing.assert_allclose(found, variance, rtol=1e-6)
    # what clocks alone push is the difference to the same filter of ranges without them
    pushed = carried(flown.flight, slopes)
    world = replace(flown.shared, signals=replace(flown.shared.signals, wandering=None))
    without = carried(replace(flown.flight, shared=world), slopes)
    e = offsets.shape[0]
    np.testing.assert_allclose((pushed.ranges - without.ranges)[..., -2:], moved[:, :e], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose((pushed.rates - without.rates)[..., -2:], moved[:, e:], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_clocks_set_long_ago_are_as_good_as_constant(coupling: str) -> None:
    """What white noise of the frequency has made in 10^6 s hardly changes in 20 s: as much of a constant offset."""
    age, sigma = 1e6, 2.0
    settings = (*BRIEF, "duration_s=20", f"filter.coupling={coupling}")
    noise = f"pseudolites.clock_noise={{h0: {2.0 * sigma**2 / (LIGHT**2 * age)}, h_minus2: 0}}"
    wandering = covariance_analysis(case(*settings, noise, f"pseudolites.clock_age_s={age}"))
    constant = covariance_analysis(case(*settings, f"pseudolites.clock_sigma_ns={1e9 * sigma / LIGHT}"))
    one = wandering.variance[wandering.sources.index("pseudolite_clock_noise"), -1, :6]
    other = constant.variance[constant.sources.index("pseudolite_clock"), -1, :6]
    np.testing.assert_allclose(one, other, rtol=2e-3, atol=1e-6)
