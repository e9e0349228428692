"""The fixes' scatter against their predicted covariance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from navsim.geodesy import earth
from navsim.gnss.constellations.systems import CLOCKS
from navsim.gnss.dop import MAX_CLOCKS, geometry_covariance
from navsim.gnss.position_fix import fixes
from navsim.scenario_files.source import InputError
from navsim.simulation.landing_covariance import Analysis, analyse
from navsim.simulation.measurements import measured
from navsim.simulation.shared_truth import SharedTruth
from navsim.statistics.noise import measure
from navsim.statistics.random_streams import generator, normals
from navsim.trajectory.kinematics import Motion
from tests.helpers import case

FIXES = 5000


def wishart_statistic(errors: np.ndarray, covariance: np.ndarray) -> float:
    """-2 log likelihood ratio that the errors (n, p), mean known to be zero, have this covariance.

    Asymptotically chi-square with p (p + 1) / 2 degrees of freedom (Anderson, An Introduction to
    Multivariate Statistical Analysis, 3rd ed., section 10.8).
    """
    n, p = errors.shape
    ratio = np.linalg.solve(covariance, errors.T @ errors / n)
    return float(n * (np.trace(ratio) - np.log(np.linalg.det(ratio)) - p))


def many_fixes(settings: tuple[str, ...], epoch: int) -> tuple[np.ndarray, np.ndarray]:
    """Position errors (n, 3), ENU, of fixes at one epoch's fixed geometry, and their predicted covariance."""
    world = case(*settings).shared
    s = world.signals

    def held(a: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.broadcast_to(a[epoch], (FIXES, *a.shape[1:])))

    ranges, rates = np.empty((2, FIXES, len(s.names), 1))
    measure(
        normals([generator(1, 0, "measurements")], FIXES, len(s.names), 2), held(s.range[..., None]),
        held(s.range_bias[..., None]), held(s.sigma[..., None]),
        held(s.range_rate[..., None]), held(s.rate_sigma), held(s.used), held(world.clock), ranges, rates,
    )  # fmt: skip
    llh, v, clocks = np.empty((FIXES, 3)), np.empty((FIXES, 3)), np.empty((FIXES, MAX_CLOCKS))
    cov = np.empty((FIXES, 6, 6))
    fixes(
        world.start, held(s.position), held(s.velocity), held(s.sigma), held(s.rate_sigma), s.time_scale,
        ranges[..., 0], rates[..., 0],
        llh, v, clocks, cov,
    )  # fmt: skip
    truth = world.at_filter
    ned = earth.ned_matrix(truth.llh[epoch + 1])
    error = (earth.ecef_from_llh(llh) - truth.position_ecef[epoch + 1]) @ ned.T
    return error[:, [1, 0, 2]] * [1, 1, -1], world.fix_covariance[epoch]


@pytest.mark.parametrize(
    "settings",
    [
        ("pseudolites.count=0",),
        (),
        ("pseudolites.clock=own",),
        ("signals.range_law=constant", "pseudolites.range_sigma_m=0.3"),
    ],
    ids=["satellites", "two pseudolites", "pseudolites with their own clock", "precise pseudolites"],
)
def test_scatter_is_the_predicted_covariance(settings: tuple[str, ...]) -> None:
    """5000 fixes, Wishart likelihood-ratio test, 6 degrees of freedom, 1 %."""
    error, covariance = many_fixes((*settings, "receiver.rate_hz=1"), 30)
    assert wishart_statistic(error, covariance) < chi2.ppf(0.99, 6)
    # the mean is zero too: Hotelling's statistic
    mean = error.mean(axis=0)
    assert FIXES * mean @ np.linalg.solve(covariance, mean) < chi2.ppf(0.99, 3)


def test_the_test_can_fail() -> None:
    """A covariance wrong by 5 % in one axis does not pass."""
    error, covariance = many_fixes(("receiver.rate_hz=1",), 30)
    wrong = covariance.copy()
    wrong[2, 2] *= 1.1025
    assert wishart_statistic(error, wrong) > chi2.ppf(0.99, 6)


def test_velocity_of_fixes() -> None:
    """Velocity errors of a whole run, normalised by their own covariance: mean square one per axis."""
    flown = case("receiver.rate_hz=10", "receiver.lever_arm_m=[2, 1, -1]")
    run = flown.fly(3, 0)
    s = flown.shared.signals
    at = flown.trajectory.motion(s.time)
    c_ne = earth.ned_matrix(at.llh)
    omega_ie_b = np.einsum("nji,njk,k->ni", at.c_nb, c_ne, [0, 0, earth.RATE])
    swing = np.einsum("nij,nj->ni", at.c_nb, np.cross(at.angular_rate - omega_ie_b, [2, 1, -1]))
    error = run.fix_velocity - at.velocity_ned - swing
    total = sum(x @ np.linalg.solve(p, x) for x, p in zip(error, noise_only(flown.shared, at, c_ne), strict=True))
    freedom = 3 * s.time.size
    assert chi2.ppf(0.005, freedom) < total < chi2.ppf(0.995, freedom)


def noise_only(world: SharedTruth, at: Motion, c_ne: np.ndarray) -> np.ndarray:
    """Covariance (e, 3, 3), NED, that the noise of the range rates alone gives the velocity, densely."""
    s = world.signals
    los = np.einsum("nij,nsj->nsi", c_ne, s.position - at.position_ecef[:, None])
    los /= np.linalg.norm(los, axis=2, keepdims=True)
    out = []
    for e in range(s.time.size):
        h = np.concatenate([-los[e, s.used[e]], np.ones((s.used[e].sum(), 1))], axis=1)
        out.append(np.linalg.inv(h.T @ h / 0.1**2)[:3, :3])
    return np.array(out)


def test_position_and_velocity_beside_a_near_pseudolite() -> None:
    """Passing 220 m from a pseudolite, position errors turn the unit vectors: the joint covariance knows."""
    flown = case("pseudolites.l1_m=1000", "receiver.rate_hz=5", name="landing_smooth")
    world = flown.shared
    at = flown.trajectory.motion(world.signals.time)
    near = np.linalg.norm(world.signals.position[:, -1] - at.position_ecef, axis=1) < 260.0
    assert near.sum() > 10
    c_ne = earth.ned_matrix(at.llh)
    arm = np.einsum("nij,j->ni", at.c_nb, flown.scenario.receiver.lever_arm_m)
    alone = noise_only(world, at, c_ne)[near]
    total, count, s = np.zeros(2), 0, world.signals
    for run in range(400):
        ranges, rates = np.empty((2, *s.range.shape, 1))
        measure(
            normals([generator(1, run, "measurements")], *s.range.shape, 2), s.range[..., None],
            s.range_bias[..., None], s.sigma[..., None], s.range_rate[..., None], s.rate_sigma, s.used, world.clock,
            ranges, rates,
        )  # fmt: skip
        e = s.time.size
        llh, v, clocks, cov = np.empty((e, 3)), np.empty((e, 3)), np.empty((e, MAX_CLOCKS)), np.empty((e, 6, 6))
        fixes(
            world.start, s.position, s.velocity, s.sigma, s.rate_sigma, s.time_scale, ranges[..., 0], rates[..., 0],
            llh, v, clocks, cov,
        )  # fmt: skip
        antenna = at.position_ecef + np.einsum("nji,nj->ni", c_ne, arm)
        position = np.einsum("nij,nj->ni", c_ne, earth.ecef_from_llh(llh) - antenna)
        error = np.concatenate([position, v - at.velocity_ned], axis=1)[near]
        for one, p, plain in zip(error, cov[near], alone, strict=True):
            total += one @ np.linalg.solve(p, one) / 6, one[3:] @ np.linalg.solve(plain, one[3:]) / 3
            count += 1
    assert 0.95 < total[0] / count < 1.08  # what is left is the curvature of 4 m at 220 m
    assert total[1] / count > 2.0  # by the noise of the range rates alone it would look far better than it is


def test_receiver_clocks_come_back() -> None:
    flown = case("pseudolites.clock=own", "pseudolites.clock_offset_ns=100", "receiver.clock_offset_us=3")
    run = flown.fly(1, 0)
    offset = 299792458.0 * (3e-6 + 50e-9 * flown.shared.signals.time)
    assert np.all(np.isnan(run.fix_clock[:, 1]))
    assert np.nanmean(run.fix_clock[:, 0] - offset) == pytest.approx(0.0, abs=1.0)
    # pseudolites ahead of their scale by 100 ns are heard 30 m too near
    assert np.nanmean(run.fix_clock[:, 2] - run.fix_clock[:, 0]) == pytest.approx(-29.98, abs=1.0)


def test_every_system_has_a_clock_of_its_own() -> None:
    """Three systems, six unknowns; clocks of systems that are not in the sky are not solved for."""
    flown = case("sky.source=nominal", "sky.systems=[gps, galileo, beidou]", "duration_s=20", "pseudolites.count=0")
    s = flown.shared.signals
    assert {CLOCKS[c] for c in s.time_scale} == {"gps", "galileo", "beidou"}
    run = flown.fly(1, 0)
    known = [CLOCKS.index(name) for name in ("gps", "galileo", "beidou")]
    assert np.isfinite(run.fix_clock[:, known]).all()
    assert np.isnan(np.delete(run.fix_clock, known, axis=1)).all()
    _, unknowns = geometry_covariance(s.los, s.time_scale, 1.0 / s.fix_sigma**2)
    assert (unknowns == 6).all()
    offset = 299792458.0 * (100e-6 + 50e-9 * s.time)
    np.testing.assert_allclose(np.mean(run.fix_clock[:, known] - offset[:, None], axis=0), 0.0, atol=1.0)


SHARED_CLOCK = ("sky.source=nominal", "sky.systems=[gps, galileo]", "receiver.single_clock=true", "pseudolites.count=0")
BRIEFLY = ("duration_s=20", "receiver.rate_hz=2")


def analysis_of(*assignments: str) -> Analysis:
    flown = case(*SHARED_CLOCK, *BRIEFLY, *assignments)
    return analyse(flown.flight, np.zeros(len(flown.shared.signals.names), dtype=bool))


@pytest.mark.parametrize("coupling", ["loose", "tight"])
def test_a_drawn_offset_between_systems_does_what_a_constant_one_does(coupling: str) -> None:
    """To a receiver that takes both for one: its 1 sigma in the covariance analysis is the mean error by that much."""
    mode = f"filter.coupling={coupling}"
    drawn = analysis_of(mode, "signals.system_offset_sigma_ns=10")
    given, none = analysis_of(mode, "signals.system_offsets_ns={galileo: 10}"), analysis_of(mode)
    sigma = np.sqrt(drawn.variance[drawn.sources.index("system_offset")])[:, :6]
    mean = np.abs(given.mean - none.mean)[:, :6]
    assert mean[:, :3].max() > 0.2
    np.testing.assert_allclose(sigma, mean, atol=1e-6)


def test_offsets_between_systems_are_drawn_for_each_run() -> None:
    """The same for all satellites of a system at all times, none of the first system, of the size asked for."""
    flown, plain = (case(*SHARED_CLOCK, *BRIEFLY, *more) for more in (("signals.system_offset_sigma_ns=10",), ()))
    of_galileo = np.array([CLOCKS[c] == "galileo" for c in plain.environment.satellites[1].time_scale])
    assert of_galileo.all()
    names = flown.shared.signals.names
    second = np.isin(names, plain.environment.satellites[1].names)
    drawn = []
    for run in range(400):
        apart = measured(flown.shared, 1, run)[0] - measured(plain.shared, 1, run)[0]
        assert np.nanmax(np.abs(apart[:, ~second])) == 0.0
        assert np.ptp(apart[:, second][np.isfinite(apart[:, second])]) < 1e-7
        drawn.append(np.nanmean(apart[:, second]))
    assert abs(np.mean(drawn)) < 4.0 * 3.0 / 20.0
    assert np.std(drawn) == pytest.approx(299792458.0 * 10e-9, rel=0.15)


def test_offsets_between_systems_are_for_one_clock() -> None:
    with pytest.raises(InputError, match="a clock unknown for each system does not notice"):
        case("sky.source=nominal", "signals.system_offset_sigma_ns=10")
    for system, why in (("glonass", "the others are counted from it"), ("gps", "signals.gps_offset_ns")):
        with pytest.raises(InputError, match=why):
            case(f"signals.system_offsets_ns={{{system}: 10}}")


def test_survey_error_and_clock_offset_bias_the_fixes() -> None:
    """They act on the truth alone: the mean fix is off by what the geometry makes of them."""
    plain, _ = many_fixes(("receiver.rate_hz=1",), 30)
    moved, _ = many_fixes(("receiver.rate_hz=1", "pseudolites.survey_error_m=[0, 5, 0]"), 30)
    shifted, _ = many_fixes(("receiver.rate_hz=1", "pseudolites.clock_offset_ns=20"), 30)
    for other in (moved, shifted):
        assert 0.3 < np.linalg.norm((other - plain).mean(axis=0)) < 10.0
