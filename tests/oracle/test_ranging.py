"""Recorded ranges against dense least squares, closed forms, simulated truth, and two public data sets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import BSpline
from scipy.linalg import expm
from scipy.optimize import least_squares
from scipy.signal import lfilter

from navsim.ranging import swapped
from navsim.ranging.estimate import (
    StartState,
    filter_causally,
    filter_pass,
    linearise,
    smooth,
    tangents,
    tune,
)
from navsim.ranging.evaluation import dilution, sigma_too_small, unobserved_states
from navsim.ranging.model import SETTINGS, RangeModel, build_model
from navsim.ranging.recording import RangeLog, Sources
from navsim.ranging.scenario import RecordedRanges
from navsim.ranging.start import find_start, mirror_solution
from navsim.ranging.study import RangeStudy, compute, prepare, solve
from navsim.results.findings import of as findings_of
from navsim.results.notes import CONSISTENT
from navsim.scenario_files.base import validated
from navsim.scenario_files.source import parse
from navsim.statistics.consistency import correlated_states
from tests.helpers import in_brief

POSITIONS = np.array([[0.0, 200.0, 5.0], [180.0, -20.0, 40.0], [-150.0, -120.0, 10.0], [60.0, 90.0, 120.0]])
NAMES = ("a", "b", "c", "d", "e", "f")
QUIET = {"outlier_share": 0.0, "long_share": 0.0}
ONE_WAY = "measurement: one_way"


def model_of(
    time: np.ndarray, source: np.ndarray, ranges: np.ndarray, keys: str = "", ranging: str = "measurement: two_way",
    position: np.ndarray = POSITIONS,
) -> RangeModel:  # fmt: skip
    """The model of ranges that stand in no file."""
    text = f"kind: ranges\nversion: 1\nranges: {{file: x, {ranging}}}\nsources: {{file: x}}\n{keys}"
    document = parse(text, "x", Path())
    scenario = validated(RecordedRanges, document)
    none = np.full(time.size, np.nan)
    sources = Sources(NAMES[: len(position)], position, None)
    return build_model(scenario, RangeLog(sources, time, source, ranges, none, none, ()))


def transition(model: RangeModel, settings: dict[str, float], dt: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition and noise over dt by the matrix exponential of Van Loan (1978), independently of the kernels."""
    n, of = model.size, model.dynamics(settings)
    a, q = np.zeros((n, n)), np.zeros((n, n))
    top = 3 * (of.order - 1)
    for i in range(top):
        a[i, i + 3] = 1.0
    q[top : top + 3, top : top + 3] = np.diag(of.motion)
    for i in range(of.clocks):
        k = model.first_clock + 2 * i
        a[k, k + 1] = 1.0
        for j in range(of.clocks):
            other = model.first_clock + 2 * j
            q[k, other], q[k + 1, other + 1] = of.clock_noise[i, j]
    for i, (tau, sigma) in enumerate(zip(of.markov_time, of.markov_sigma, strict=True)):
        k = of.first_markov + i
        a[k, k], q[k, k] = -1.0 / tau, 2.0 * sigma**2 / tau
        if i < of.smoothed:
            last = k + of.markov_time.size
            a[last, last], a[last, k] = -1.0 / of.smoothing_time, 1.0 / of.smoothing_time
    if of.order == 3:
        a[6:9, 6:9] = np.eye(3) / -of.motion_time
    both = expm(np.block([[-a, q], [np.zeros((n, n)), a.T]]) * dt)
    phi = both[n:, n:].T
    return phi, phi @ both[:n, n:]


def cycle(count: int, step: float, sources: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Times and sources of ranges asked one after another."""
    return step * np.arange(count), np.arange(count) % sources


@pytest.mark.parametrize("ranging", ["measurement: two_way", ONE_WAY])
def test_filter_and_smoother_are_dense_least_squares(ranging: str) -> None:
    """With given lines and one Gaussian the estimate is that of one large least squares problem."""
    time, source = cycle(24, 0.3)
    draw = np.random.default_rng(1)
    motion = "motion: {model: acceleration}\nbias: {growth: {sigma_m: 0.2}}\n" if "two" in ranging else ""
    model = model_of(time, source, draw.uniform(150.0, 260.0, time.size), motion, ranging)
    settings = model.settings() | QUIET | {"wander_time": 4.0, "source_frequency": 1e-2}
    settings |= {"range_sigma b": 3.0, "wander_sigma c": 5.0}
    start = StartState(np.array([20.0, -10.0, 30.0]), (5.0, 8.0), 3.0)
    lines = tangents(model, draw.normal([10.0, 0.0, 30.0], 5.0, (time.size, 3)))
    filtered = filter_pass(model, settings, start, lines)
    state, covariance = smooth(model, settings, filtered)

    m, n = time.size, model.size
    mean = np.zeros(n)
    mean[:3] = start.position
    if model.clocks:
        mean[model.first_clock] = start.clock
    phi, q = transition(model, settings, 0.3)
    whole, whole_mean = np.zeros((m * n, m * n)), np.zeros(m * n)
    marginal = [model.covariance(settings, start.sigma)]
    means = [mean]
    for _ in range(m - 1):
        marginal.append(phi @ marginal[-1] @ phi.T + q)
        means.append(phi @ means[-1])
    for i in range(m):
        whole_mean[i * n : i * n + n] = means[i]
        step = marginal[i]
        for j in range(i, m):
            whole[j * n : j * n + n, i * n : i * n + n] = step
            whole[i * n : i * n + n, j * n : j * n + n] = step.T
            step = phi @ step
    h = np.zeros((m, m * n))
    for k in range(m):
        h[k, k * n : k * n + n] = model.data.row[k]
        h[k, k * n : k * n + 3] = lines.slope[k]
    s = h @ whole @ h.T + np.diag((settings["range_sigma"] * np.where(source == 1, 3.0, 1.0)) ** 2)
    e = model.data.range - lines.offset - h @ whole_mean
    gain = np.linalg.solve(s, h @ whole).T
    best = (whole_mean + gain @ e).reshape(m, n)
    left = whole - gain @ h @ whole
    sigma = np.sqrt(np.diagonal(left).reshape(m, n))
    np.testing.assert_allclose(state, best, atol=2e-4 * max(1.0, np.abs(best).max()))
    np.testing.assert_allclose(np.sqrt(np.einsum("mii->mi", covariance)), sigma, rtol=2e-3, atol=1e-5)
    np.testing.assert_allclose(filtered.state[-1], best[-1], atol=2e-4 * max(1.0, np.abs(best).max()))
    likelihood = -0.5 * (e @ np.linalg.solve(s, e) + np.linalg.slogdet(2.0 * np.pi * s)[1])
    assert filtered.likelihood == pytest.approx(likelihood, abs=1e-3)


def test_two_sources_exchanged_in_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pair is named first, and with the right table none is. Pairs of the three worst sources."""
    monkeypatch.setattr(swapped, "_WORST", 3)
    time, source = cycle(80, 0.3)
    draw = np.random.default_rng(8)
    track = np.column_stack([20.0 + 3.0 * time, 10.0 - 2.0 * time, np.full(time.size, 30.0)])
    ranges = np.linalg.norm(track - POSITIONS[source], axis=1) + draw.normal(0.0, 0.1, time.size)
    for order, pairs in (([0, 1, 2, 3], []), ([0, 2, 1, 3], [("b", "c")])):
        model = model_of(time, source, ranges, position=POSITIONS[order])
        assert swapped.swapped_pairs(model, np.arange(4.0))[:1] == pairs
        _, smoothed = find_start(model, model.settings())
        assert swapped.fits_badly(model, model.settings(), smoothed) == bool(pairs)


def test_noise_is_no_exchange_of_sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise of 2 m and biases of 1 m, of which the filter knows nothing: with a right table no pair is named."""
    monkeypatch.setattr(swapped, "_WORST", 2)
    time, source = cycle(120, 0.3)
    draw, position = np.random.default_rng(504), np.array([[0.0, 0, 0], [20, 0, 1], [1, 19, 0.5], [21, 20, 0]])
    track = np.column_stack([5.0 + 0.3 * time, 4.0 - 0.2 * time, np.full(time.size, 6.0)])
    ranges = np.linalg.norm(track - position[source], axis=1) + draw.normal(0.0, 2.0, time.size)
    model = model_of(time, source, ranges + draw.normal(0.0, 1.0, 4)[source], position=position)
    assert swapped.swapped_pairs(model, np.array([0.0, 1.0, 1.0, 0.0])) == []


def test_cramer_rao_bound_of_a_static_layout() -> None:
    """The inverse of the sum of u u' / sigma^2."""
    time, source = cycle(400, 0.1)
    at, sigma = np.array([30.0, 10.0, 20.0]), 0.3
    away = at - POSITIONS[source]
    distance = np.linalg.norm(away, axis=1)
    none = "{sigma_m: 0, correlation_time_s: 1}"
    keys = f"bias: {{sigma_m: 0, wander: {none}, place: {none}, common: {none}}}\n"
    keys += "motion: {noise: [1.0e-9, 1.0e-9], speed_sigma_m_s: 1.0e-9}\n"
    model = model_of(time, source, distance, keys)
    settings = model.settings() | QUIET | {"range_sigma": sigma}
    start = StartState(at, (1e4, 1e4), 0.0)
    filtered = filter_pass(model, settings, start, tangents(model, np.tile(at, (400, 1))))
    u = away / distance[:, None]
    bound = np.linalg.inv(u.T @ u / sigma**2)
    np.testing.assert_allclose(filtered.covariance[-1][:3, :3], bound, rtol=1e-4, atol=1e-8)
    # and the dilution of precision is that of the unit vectors
    position, horizontal, vertical = dilution(at[None], POSITIONS, True)
    q = np.linalg.inv(u[:4].T @ u[:4])
    assert position[0] == pytest.approx(np.sqrt(np.trace(q)), rel=1e-12)
    assert (horizontal[0], vertical[0]) == pytest.approx((np.sqrt(q[0, 0] + q[1, 1]), np.sqrt(q[2, 2])), rel=1e-12)
    with_clock = np.column_stack([u[:4], np.ones(4)])
    assert dilution(at[None], POSITIONS, False)[0][0] == pytest.approx(
        np.sqrt(np.trace(np.linalg.inv(with_clock.T @ with_clock)[:3, :3])), rel=1e-9
    )


CLOCKS = "clocks: {offset_sigma_m: 1, rate_sigma_m_s: 0.05, sources: {h0: 2.0e-21, h_minus2: 1.0e-22}, receiver: "
CLOCKS += "{h0: 1.0e-20, h_minus2: 1.0e-20}}\n"
BIASES = (
    "bias: {sigma_m: 0.3, growth: {sigma_m: 0.3, distance_m: 100}, wander: {sigma_m: 0.2, correlation_time_s: 3}}\n"
)


@pytest.mark.parametrize(
    ("ranging", "keys", "size"), in_brief([("measurement: two_way", BIASES, 1.0), (ONE_WAY, CLOCKS, 20.0)], 0)
)
def test_every_state_is_consistent(ranging: str, keys: str, size: float) -> None:
    """RMS of error over sigma over 800 simulated recordings, filter and smoother."""
    runs, step = 800, 0.5
    time, source = cycle(120, step)
    position = size * POSITIONS
    blank = model_of(time, source, np.full(time.size, 200.0), keys, ranging, position)
    settings = blank.settings() | QUIET | {"range_sigma": 0.2, "horizontal_noise": 0.3, "vertical_noise": 0.1}
    start = StartState(np.array([10.0, 0.0, 60.0]), (3.0, 3.0), 0.0)
    phi, q = transition(blank, settings, step)
    draw = np.random.default_rng(2)
    prior = blank.covariance(settings, start.sigma)

    def drawn(of: np.ndarray, count: int) -> np.ndarray:
        value, vector = np.linalg.eigh(of)
        return draw.standard_normal((count, len(value))) * np.sqrt(np.maximum(value, 0.0)) @ vector.T

    x = drawn(prior, runs)
    x[:, :3] += start.position
    x[:, 3:6] *= 0.2  # slow enough to stay among the sources; judged without them
    truth = np.empty((time.size, runs, blank.size))
    for k in range(time.size):
        x = x @ phi.T + drawn(q, runs) if k else x
        truth[k] = x
    z = []
    for run in range(runs):
        at = truth[:, run]
        distance = np.linalg.norm(at[:, :3] - position[source], axis=1)
        row = blank.data.row
        if "two" in ranging:
            row = row.copy()
            growth = slice(blank.first_bias + 4, blank.first_bias + 8)
            row[:, growth] = np.where(row[:, growth] > 0.0, -np.expm1(-distance / 100.0)[:, None], 0.0)
        errors = np.einsum("mi,mi->m", row[:, 3:], at[:, 3:]) + 0.2 * draw.standard_normal(time.size)
        model = replace(blank, data=blank.data._replace(range=distance + errors, row=row))
        filtered = filter_pass(model, settings, start)
        state, covariance = smooth(model, settings, filtered)
        both = []
        for estimate, p in ((filtered.state, filtered.covariance), (state, covariance)):
            sigma = np.sqrt(np.einsum("mii->mi", p[[40, 80, 119]]))
            both.append((estimate[[40, 80, 119]] - at[[40, 80, 119]]) / np.where(sigma > 0.0, sigma, np.nan))
        z.append(both)
    rms = np.sqrt(np.mean(np.square(z), axis=(0, 2)))
    assert np.isfinite(rms).all()
    assert rms.min() > 0.93, dict(zip(blank.names, rms.T.round(3), strict=True))
    assert rms.max() < 1.07, dict(zip(blank.names, rms.T.round(3), strict=True))


def test_the_datum_changes_no_position() -> None:
    """Only differences of clocks can be observed: positions and differences are the same whichever is the datum."""
    time, source = cycle(200, 0.5)
    draw = np.random.default_rng(3)
    true = np.column_stack([10.0 + 0.5 * time, -20.0 + 0.2 * time, 60.0 + 0.0 * time])
    offsets, rates = draw.normal(0.0, 10.0, 4), draw.normal(0.0, 0.1, 4)
    ranges = np.linalg.norm(true - POSITIONS[source], axis=1) + 300.0 - offsets[source] - rates[source] * time
    ranges += draw.normal(0.0, 0.2, time.size)
    lines, seen = None, {}
    for datum in ("a", "c", "receiver"):
        model = model_of(time, source, ranges, CLOCKS.replace("{offset", f"{{datum: {datum}, offset"), ONE_WAY)
        settings = model.settings() | QUIET
        lines = lines or tangents(model, true)
        start = StartState(true[0], (5.0, 5.0), 0.0)
        filtered = filter_pass(model, settings, start, lines)
        at = {name: filtered.state[-1, model.first_clock + 2 * k] for k, name in enumerate(model.clocks)} | {datum: 0.0}
        seen[datum] = (filtered.state[:, :6], filtered.covariance[-1][:6, :6], at["b"] - at["d"], filtered.likelihood)
    for datum in ("c", "receiver"):
        for one, other in zip(seen["a"], seen[datum], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-3)


def circling(count: int, seed: int, sigma: float = 0.1, long: float = 0.0) -> tuple[np.ndarray, ...]:
    """Times, sources, true positions and two-way ranges of a vehicle that circles; long: share of reflections."""
    draw = np.random.default_rng(seed)
    time, source = cycle(count, 0.1)
    true = np.column_stack([60.0 * np.cos(0.05 * time), 60.0 * np.sin(0.05 * time), np.full(count, 30.0)])
    ranges = np.linalg.norm(true - POSITIONS[source], axis=1) + draw.normal(0.0, sigma, count)
    return time, source, true, ranges + np.where(draw.random(count) < long, draw.exponential(4.0, count), 0.0)


def test_reflections_are_found_and_do_no_harm() -> None:
    time, source, true, ranges = circling(600, 4, long=0.1)
    model = model_of(time, source, ranges)
    found = solve(model)
    error = np.linalg.norm((found.smoothed.state - np.pad(true, ((0, 0), (0, model.size - 3))))[:, :2], axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.2
    late = ranges - np.linalg.norm(true - POSITIONS[source], axis=1) > 2.0
    assert np.mean(found.smoothed.filtered.weight[late] < 0.5) > 0.95
    assert np.mean(found.smoothed.filtered.weight[~late] > 0.5) > 0.93
    plain = least_squares(  # what a filter is for: the same ranges without a model of outliers
        lambda p: (ranges - np.linalg.norm(p - POSITIONS[source], axis=1))[:40], true[20]
    )
    assert np.linalg.norm(plain.x[:2] - true[20, :2]) > 3.0 * np.sqrt(np.mean(error**2))


def test_tuning_finds_the_noise_and_stays_within_bounds() -> None:
    time, source, true, ranges = circling(800, 5, sigma=0.3)
    model = model_of(
        time,
        source,
        ranges,
        "bias: {wander: {sigma_m: 0, correlation_time_s: 1}, place: {sigma_m: 0, correlation_time_s: 1}}\n",
    )
    start = StartState(true[0], (2.0, 2.0), 0.0)
    lines = tangents(model, true)
    settings = tune(model, model.settings(), start, lines, lambda: None)
    assert settings["range_sigma"] == pytest.approx(0.3, rel=0.08)
    assert all(one.low <= settings[name] <= one.high for name, one in SETTINGS.items() if name in model.free)
    before, after = (filter_pass(model, s, start, lines).likelihood for s in (model.settings(), settings))
    assert after > before + 10.0
    without = model_of(time, source, ranges, "bias: {wander: {sigma_m: 0, correlation_time_s: 1}}\n", ONE_WAY)
    assert without.smoothed == 0  # nothing to smooth
    assert "smoothing_time" not in without.free
    given = model_of(time, source, ranges, "motion: {noise: [0.5, 0.1]}\noutliers: {share: 0.01}\n")
    assert not {"horizontal_noise", "outlier_share"} & set(given.free)


def test_each_source_has_its_own_noise() -> None:
    """Three sources with 900 ranges show their sigma, one with 6 keeps nearly the common one."""
    sigma, draw = np.array([0.1, 0.2, 0.4, 0.2]), np.random.default_rng(21)
    time, which = 0.1 * np.arange(2700), np.arange(2700) % 3
    few = (which == 2) & (np.arange(2700) % 450 == 2)
    source = np.where(few, 3, which)
    true = np.column_stack([60.0 * np.cos(0.05 * time), 60.0 * np.sin(0.05 * time), np.full(time.size, 30.0)])
    ranges = np.linalg.norm(true - POSITIONS[source], axis=1) + draw.normal(0.0, sigma[source])
    keys = "bias: {wander: {sigma_m: 0, correlation_time_s: 1}, place: {sigma_m: 0, correlation_time_s: 1}}\n"
    found, gain = {}, {}
    for noise in ("by_source", "common"):
        model = model_of(time, source, ranges, keys, f"measurement: two_way, noise: {noise}")
        start, lines = StartState(true[0], (2.0, 2.0), 0.0), tangents(model, true)
        settings = tune(model, model.settings(), start, lines, lambda: None)
        found[noise] = model.of_sources(settings, "range_sigma")
        gain[noise] = filter_pass(model, settings, start, lines).likelihood
        assert model.by_source == (("range_sigma",) if noise == "by_source" else ())
    np.testing.assert_allclose(found["by_source"][:3], sigma[:3], rtol=0.1)
    assert np.ptp(found["common"]) == 0.0
    assert gain["by_source"] > gain["common"] + 100.0
    # 6 ranges that are exact by chance do not make a source exact
    exact = np.where(few, np.linalg.norm(true - POSITIONS[source], axis=1), ranges)
    model = model_of(time, source, exact, keys)
    settings = tune(model, model.settings(), start, tangents(model, true), lambda: None)
    own = settings["range_sigma d"]
    assert 0.2 < own < 0.9
    given = model_of(time, source, exact, keys, "measurement: two_way, sigma_m: 0.2")
    assert given.by_source == ()
    np.testing.assert_array_equal(given.of_sources(given.settings(), "range_sigma"), 0.2)


def test_tuning_finds_smoothed_ranges_and_clocks() -> None:
    """Drawn by the matrix exponential. Phase noise of clocks and wandering errors are hardly told apart, so the
    likelihood judges these."""
    time, source = np.repeat(np.arange(500.0), 6), np.arange(3000) % 6
    position = 20.0 * np.vstack([POSITIONS, [[90.0, 150.0, 10.0], [-160.0, 80.0, 50.0]]])
    keys = "motion: {model: acceleration, noise: [0.6, 0.2]}\nclocks: {receiver: {h0: 1.0e-20, h_minus2: 1.0e-20}}\n"
    keys += "outliers: {share: 1.0e-6, sigma_m: 1, long_share: 1.0e-6, long_m: 1}\n"
    model = model_of(time, source, np.zeros(time.size), keys, ONE_WAY, position)
    drawn = {"wander_sigma": 0.4, "wander_time": 8.0, "smoothing_time": 1.0, "motion_time": 4.0, "range_sigma": 0.05}
    settings = model.settings() | drawn | {"source_frequency": 1e-4, "source_phase": 1e-8}
    start = StartState(np.array([0.0, 0.0, 400.0]), (1.0, 1.0), 0.0)
    draw = np.random.default_rng(14)
    phi, q = transition(model, settings, 1.0)
    prior, noise = (np.linalg.cholesky(p + 1e-12 * np.eye(model.size)) for p in (model.covariance(settings, (1, 1)), q))
    truth = [prior @ draw.standard_normal(model.size) + np.r_[start.position, np.zeros(model.size - 3)]]
    for _ in range(499):
        truth.append(phi @ truth[-1] + noise @ draw.standard_normal(model.size))
    true = np.repeat(truth, 6, axis=0)
    distance = np.linalg.norm(true[:, :3] - model.data.position[source], axis=1)
    ranges = distance + np.einsum("mi,mi->m", model.data.row, true) + draw.normal(0.0, 0.05, time.size)
    model = replace(model, data=model.data._replace(range=ranges))
    lines = tangents(model, true[:, :3])
    found = tune(model, model.settings(), start, lines, lambda: None)
    filtered = filter_pass(model, found, start, lines)
    gain = filtered.likelihood - filter_pass(model, settings, start, lines).likelihood
    assert -1.0 < gain < 12.2  # half of chi-square of 7 settings, 99.9 %; the search ends where little is left to gain
    assert found["motion_time"] == pytest.approx(4.0, rel=0.2)
    assert 0.4e-4 < found["source_frequency"] < 2.5e-4
    assert 0.5 < found["smoothing_time"] < 2.5
    z = (filtered.state[-1] - truth[-1]) / np.sqrt(np.diagonal(filtered.covariance[-1]))
    clocks = slice(model.first_clock, model.first_markov)
    assert np.abs(z[clocks]).max() < 3.0
    unit = (filtered.innovation / np.sqrt(filtered.variance)).reshape(-1, 6)
    assert np.abs(np.mean(unit[1:] * unit[:-1], axis=0)).max() < 0.13  # 3 sigma of chance


def test_mirror_image_of_sources_in_a_plane() -> None:
    flat = POSITIONS * [1.0, 1.0, 0.0]
    time, source, true, _ = circling(400, 6)
    ranges = np.linalg.norm(true - flat[source], axis=1) + np.random.default_rng(6).normal(0.0, 0.1, time.size)
    model = model_of(time, source, ranges, position=flat)
    settings = model.settings()
    start, smoothed = find_start(model, settings)
    assert np.median(smoothed.state[:, 2]) == pytest.approx(30.0, abs=1.0)  # above, not below
    plane, other = mirror_solution(model, settings, start, smoothed)
    assert plane.is_flat
    assert other is not None
    assert np.median(other.state[:, 2]) == pytest.approx(-30.0, abs=1.0)
    assert other.filtered.likelihood == pytest.approx(smoothed.filtered.likelihood, abs=1.0)
    result = compute(RangeStudy(model.scenario, model.log, model, None))
    assert "mirror_solution" in [found.name for found in findings_of(result)]
    assert "mirror_near" not in [found.name for found in findings_of(result)]
    upright = model_of(*circling(400, 6)[:2], circling(400, 6)[3])
    assert mirror_solution(upright, settings, start, smoothed)[1] is None


def test_states_that_the_ranges_do_not_show() -> None:
    """A vehicle at rest, whose clocks are all free: its position is known by the start alone."""
    time, source = cycle(200, 0.5)
    at = np.array([10.0, -20.0, 60.0])
    ranges = np.linalg.norm(at - POSITIONS[source], axis=1) + np.random.default_rng(7).normal(0.0, 0.1, time.size)
    keys = "motion: {noise: [0.01, 0.01], start: {position_m: [10, -20, 60]}}\n"
    model = model_of(time, source, ranges, keys, ONE_WAY)
    result = compute(RangeStudy(model.scenario, model.log, model, None))
    names = [found.name for found in findings_of(result)]
    assert "states_not_seen" in names
    values = dict(zip(result["/states/state"], result["/states/sigma"], strict=True))
    assert np.isnan(values["x"])
    p = np.array([[1.0, 0.995, 0.0], [0.995, 1.0, -0.5], [0.0, -0.5, 1.0]])
    assert correlated_states(p, np.arange(3)) == [(0, 1, pytest.approx(0.995))]
    assert unobserved_states(np.array([1.0, 1.0]), np.array([0.9, 0.5])).tolist() == [True, False]


def test_lines_of_a_wide_distribution() -> None:
    """The cubature of a distance: mean and slope as of many draws."""
    time, source = cycle(4, 1.0)
    model = model_of(time, source, np.full(4, 200.0))
    mean, covariance = np.array([20.0, 10.0, 30.0]), np.diag([12.0, 10.0, 15.0]) ** 2
    lines = linearise(model, np.tile(mean, (4, 1)), np.tile(covariance, (4, 1, 1)))
    points = np.random.default_rng(8).multivariate_normal(mean, covariance, 200_000)
    for k in range(4):
        distance = np.linalg.norm(points - POSITIONS[k], axis=1)
        a = np.column_stack([points, np.ones(len(points))])
        fit, rest, *_ = np.linalg.lstsq(a, distance, rcond=None)
        np.testing.assert_allclose(lines.slope[k], fit[:3], atol=0.04)
        assert lines.offset[k] + lines.slope[k] @ mean == pytest.approx(distance.mean(), abs=0.3)
        # of third degree, the rule finds too little of the rest, but never adds to it
        assert 0.0 < lines.variance[k] < rest[0] / len(points)


def test_relinearised_filter_is_causal() -> None:
    """Ranges after a time change nothing of the filter's output before it."""
    time, source, true, ranges = circling(400, 9)
    later = ranges.copy()
    later[250:] += 5.0
    start = StartState(true[0] + 1.0, (3.0, 3.0), 0.0)
    one, other = (
        filter_causally(model, model.settings(), start)
        for model in (model_of(time, source, r) for r in (ranges, later))
    )
    np.testing.assert_array_equal(one.state[:250], other.state[:250])
    assert not np.array_equal(one.state[250:], other.state[250:])


YARD = """
kind: ranges
version: 1
ranges: {{file: {0}/ranges.csv.gz, columns: {{source: anchor, signal_dbm: rssi_dbm}}, measurement: two_way}}
sources: {{file: {0}/ranges.csv.gz, columns: {{source: anchor, x_m: anchor_x_m, y_m: anchor_y_m, z_m: anchor_z_m}}}}
reference: {{file: {0}/truth.csv}}
"""


def study_of(text: str) -> RangeStudy:
    document = parse(text, "x.yaml", Path())
    return prepare(validated(RecordedRanges, document), document)


@pytest.mark.validates("Position and biases by recorded two-way ranges of UWB anchors",
                       "RTK truth of a public recording", filter="0.85 m", smoother="0.65 m",
                       bias="0.1 m")  # fmt: skip
@pytest.mark.parametrize(("part", "harder"), in_brief([("end_s: 120\n", 1.1), ("", 1.0)], 0))
def test_uwb_yard(part: str, harder: float, shared: Path, within: Any) -> None:
    """The first half of the recording, whose smoothed errors are a tenth larger, and all of it."""
    study = study_of(YARD.format(shared / "data" / "uwb_yard") + part)
    result = compute(study)
    for name in ("filter", "smoother"):
        rms, z = (result[f"/summary/{name}_error_{what}"] for what in ("rms", "z"))
        assert np.hypot(rms[0], rms[1]) <= harder * within[name]
        assert 0.8 <= np.sqrt(np.mean(z[:2] ** 2)) <= 1.25
    assert study.track is not None
    true = study.track.at(study.log.time)
    error = study.log.range - np.linalg.norm(true - study.log.sources.position[study.log.source], axis=1)
    states = list(result["/states/state"])
    for i, name in enumerate(study.log.sources.names):
        median = np.nanmedian(error[study.log.source == i])
        assert result["/states/value"][states.index(f"bias {name}")] == pytest.approx(median, abs=within["bias"])
    assert (result["/summary/outliers"] < 0.03 * result["/summary/ranges"]).all()
    told = [found for found in findings_of(result) if found.name == "reference_sigma"]
    assert [(each.text[:25], each.against) for each in told] == [("the vertical errors of th", (CONSISTENT,))] * (
        1 if part else 2
    )


@pytest.mark.parametrize(("size", "share"), [(1.0, (0.0, 0.0)), (3.0, (0.9, 1.0))])
def test_a_sigma_is_too_small_beyond_chance(size: float, share: tuple[float, float]) -> None:
    """Errors of 20 s correlation time over 200 s at 10 Hz."""
    drawn = size * np.random.default_rng(3).standard_normal((50, 2000, 1))
    keep = np.exp(-0.1 / 20.0)
    drawn[:, 0] /= np.sqrt(1.0 - keep**2)
    errors = np.sqrt(1.0 - keep**2) * lfilter([1.0], [1.0, -keep], drawn, axis=1)
    assert share[0] <= np.mean([sigma_too_small(each) for each in errors]) <= share[1]


UAV = """
kind: ranges
version: 1
ranges:
  file: {0}/uav_observations.txt
  measurement: one_way
  columns: {{t_s: "timeSec[s]"}}
  source_columns: {{{1}}}
sources:
  file: {0}/uav_base_stations.txt
  columns: {{source: ID, lat_deg: "UTM_E[m]", lon_deg: "UTM_N[m]", h_m: "UTM_U[m]"}}
motion: {{model: acceleration}}
"""


def uav_study(shared: Path, keys: str = "", noise: str = "by_source") -> RangeStudy:
    columns = ", ".join(f'"codePseudorange{i}[m]": "{i}"' for i in range(1, 6))
    text = UAV.format(shared / "data" / "pseudolite_uav", columns).replace("one_way", f"one_way\n  noise: {noise}")
    return study_of(text + keys)


@pytest.mark.long
def test_noise_by_source_predicts_what_it_was_not_tuned_on(shared: Path) -> None:
    """Tuned on one half of the recording, scored on the other: log-likelihood of each range given those before it.
    Outliers, which differ by half, have the shares and sizes of the whole recording."""
    middle, unsettled = 20519.0, 30.0
    tails = "outliers: {share: 0.015, sigma_m: 0.33, long_share: 0.0019, long_m: 18}\n"
    score = {"by_source": 0.0, "common": 0.0}
    for fit, rest in ((f"end_s: {middle}\n", f"start_s: {middle}\n"), (f"start_s: {middle}\n", f"end_s: {middle}\n")):
        for noise in score:
            settings = solve(uav_study(shared, tails + fit, noise).model).settings
            model = uav_study(shared, tails + rest, noise).model
            start, smoothed = find_start(model, settings)
            known = StartState(smoothed.state[0, :3], (30.0, 30.0), start.clock)
            late = model.data.time > model.data.time[0] + unsettled
            score[noise] -= filter_causally(model, settings, known).surprise[late].sum()
    assert score["by_source"] > score["common"] + 50.0


@pytest.mark.validates("Residuals (geometric mean of sources), clock rates by pseudoranges of five free clocks",
                       "independent script on a public recording", residual="0.25 m", rate="0.006 m/s")  # fmt: skip
def test_pseudolite_uav(shared: Path, within: Any) -> None:
    """Least squares with the receiver's clock and a horizontal position in every epoch, the height as a spline, offset
    and rate for each source."""
    study = uav_study(shared)
    result = compute(study)
    residual = result["/summary/residual_rms"]
    assert np.exp(np.mean(np.log(residual))) < within["residual"]
    assert result["/summary/residual_rms_all"] < 0.4
    wander = result["/noise/source_wander_sigma"]
    assert wander.max() > 2.0 * wander.min()
    assert set(np.argsort(wander)[-2:]) == set(np.argsort(residual)[-2:])
    assert 0.7 < result["/summary/nis_all"] < 1.3
    assert np.abs(result["/summary/lag1"]).max() < 0.2  # 0.38 where neither ranges nor accelerations are smooth
    log, epochs = study.log, np.unique(study.log.time)
    z = log.range.reshape(epochs.size, 5)
    smoothed = result["/smoother/position"]
    since = epochs - epochs[0]
    knots = np.r_[[0.0] * 3, np.linspace(0.0, since[-1], 32), [since[-1]] * 3]
    basis = BSpline.design_matrix(np.minimum(since, since[-1] - 1e-6), knots, 3).toarray()

    def eliminated(g: np.ndarray) -> np.ndarray:
        """Residuals with place and receiver's clock solved in each epoch: rates and offsets g[:8], height g[8:]."""
        clock = np.zeros((epochs.size, 5))
        clock[:, 1:] = g[:4] + np.outer(since, g[4:8])
        p = np.column_stack([smoothed[:, :2], basis @ g[8:]])
        for _ in range(2):
            away = p[:, None] - log.sources.position
            distance = np.linalg.norm(away, axis=2)
            h = np.concatenate([away[..., :2] / distance[..., None], np.ones((epochs.size, 5, 1))], axis=2)
            e = z - distance + clock
            step = np.linalg.solve(np.einsum("tsi,tsj->tij", h, h), np.einsum("tsi,ts->ti", h, e)[..., None])[..., 0]
            p[:, :2] += step[:, :2]
        return (e - np.einsum("tsi,ti->ts", h, step)).ravel()

    height = np.linalg.lstsq(basis, smoothed[:, 2])[0] + 5.0
    scale = np.r_[np.full(4, 1.0), np.full(4, 0.01), np.full(height.size, 10.0)]
    own = least_squares(eliminated, np.append(np.zeros(8), height), x_scale=scale, max_nfev=4)
    clocks = list(result["/clocks/clock"])
    mean = result["/clocks/mean_rate"]
    for i, name in enumerate(log.sources.names[1:]):
        sigma = result["/clocks/rate_sigma"][-1, clocks.index(name)]
        assert abs(mean[clocks.index(name)] - own.x[4 + i]) < min(within["rate"], 2.0 * sigma)
    assert np.median(smoothed[:, 2]) == pytest.approx(np.median(basis @ own.x[8:]), abs=30.0)
