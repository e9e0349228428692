"""`kind: mls-elevation`: covariance of the elevation filter, its Monte Carlo proof, its run on the nominal approach.

Source: `docs/theory/elevation.md`. Degrees throughout, as the paper has it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from navsim.companions.elevation import mls
from navsim.companions.elevation.filter import Model, first_order, fly, follow, model
from navsim.companions.elevation.scenario import SETTLING, Elevation
from navsim.companions.kalman import covariance_sequence, driven_covariance, singer, singer_sigma, steady_state
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept
from navsim.results.notes import CONSISTENT
from navsim.results.result import Result
from navsim.results.schema import ELEVATION
from navsim.runner.attributes import root_attributes
from navsim.runner.findings import doubted, positive
from navsim.statistics import chi_square
from navsim.statistics.random_streams import generator
from navsim.statistics.rounding import digits

BANDS = ("std_theory", "std_sample", "variance")
"""Interpretations of "within +-20 %": of the standard deviation, about the filter's or about the sample's, or of the
variance."""
G = 9.80665


def band_limits(band: str, delta: float) -> tuple[float, float]:
    """Limits of sample variance over the filter's variance."""
    if band == "variance":
        return 1.0 - delta, 1.0 + delta
    low, high = (1.0 - delta) ** 2, (1.0 + delta) ** 2
    return (low, high) if band == "std_theory" else (1.0 / high, 1.0 / low)


def coverage(band: str, delta: float, degrees: int) -> float:
    """Probability that a sample variance of so many degrees of freedom lies within the band, for a consistent
    filter."""
    low, high = band_limits(band, delta)
    reach_low, reach_high = (chi_square.probability_below(limit * degrees, degrees) for limit in (low, high))
    return reach_high - reach_low


def smallest_number(band: str, delta: float, confidence: float) -> int:
    """The least number of degrees of freedom for which the band holds with this confidence."""
    low, high = 1, 1
    while coverage(band, delta, high) < confidence:
        high *= 2
    # coverage increases with the number except for the first few
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if coverage(band, delta, middle) < confidence else (low, middle)
    return high


@dataclass(frozen=True)
class Proof:
    """Monte Carlo results of one model."""

    covariance: np.ndarray
    """(k, n, n) of the filter."""
    gain: np.ndarray
    """(k, n) of the filter."""
    mean_error: np.ndarray
    """(k, n) of the first experiment."""
    sample: np.ndarray
    """(k, n, n) of the first experiment."""
    all_runs: np.ndarray
    """(k, n, n) of all runs."""
    inside: np.ndarray
    """(experiment, band) fraction of the steps inside."""
    nees: float
    """Mean over all runs and steps, as `nis`."""
    nis: float


def prove(scenario: Elevation, seed: int, runs: int, experiments: int, done: Callable[[int], None]) -> Proof:
    """Fly all experiments; run r of experiment e is run e * runs + r of the seed."""
    given, steps = scenario.filter, scenario.montecarlo.steps
    m = _model(scenario)
    n = m.phi.shape[0]
    p0 = _initial(scenario, n)
    covariances, gains = covariance_sequence(m.phi, m.q, m.h, m.r, p0, steps)
    gain = gains[:, :, 0]
    inverse = np.linalg.inv(covariances)
    variances = covariance_of_innovation(m, covariances, p0)
    root_p0, sigma = np.linalg.cholesky(p0), float(np.sqrt(given.measurement_variance_deg2))
    phi, root = map(np.ascontiguousarray, (m.phi, m.root))
    error, innovation = np.empty((runs, steps, n)), np.empty((runs, steps))
    total, nees, nis = np.zeros((steps, n, n)), 0.0, 0.0
    inside = np.empty((experiments, len(BANDS)))
    mean_error, sample = np.empty((steps, n)), np.empty((steps, n, n))
    for e in range(experiments):
        for r in range(runs):
            rng = generator(seed, e * runs + r, "elevation")
            fly(rng, phi, root, sigma, gain, root_p0, error[r], innovation[r])
        second = np.einsum("rki,rkj->kij", error, error)
        total += second
        nees += float(np.einsum("rki,kij,rkj->", error, inverse, error))
        nis += float(np.sum(innovation**2 / variances))
        ratio = second[:, 0, 0] / runs / covariances[:, 0, 0]
        for b, band in enumerate(BANDS):
            low, high = band_limits(band, scenario.montecarlo.band)
            inside[e, b] = np.mean((ratio > low) & (ratio < high))
        if e == 0:
            mean_error, sample = error.mean(axis=0), second / runs
        done(e + 1)
    count = runs * experiments
    return Proof(
        covariances, gain, mean_error, sample, total / count, inside, nees / (count * steps), nis / (count * steps)
    )


def covariance_of_innovation(m: Model, covariances: np.ndarray, p0: np.ndarray) -> np.ndarray:
    """Innovation variance of the filter (k,), deg2."""
    before = np.concatenate([p0[None], covariances[:-1]])
    predicted = m.phi @ before @ m.phi.T + m.q
    return (m.h @ predicted @ m.h.T + m.r)[:, 0, 0]


def _model(scenario: Elevation, rate_variance: float | None = None) -> Model:
    f = scenario.filter
    variance = f.rate_variance_deg2_s2 if rate_variance is None else rate_variance
    return model(f.model, f.period_s, variance, f.correlation_time_s, f.measurement_variance_deg2)


def _initial(
    scenario: Elevation, n: int, rate_variance: float | None = None, period: float | None = None
) -> np.ndarray:
    f = scenario.filter
    variance = f.rate_variance_deg2_s2 if rate_variance is None else rate_variance
    acceleration = 0.5 * variance / (f.period_s if period is None else period) / f.correlation_time_s
    return np.diag([*f.initial_variance, acceleration][:n])


@dataclass(frozen=True)
class ChannelRun:
    """A channel's filters on its true angle, a filter for each process noise Q, deg.

    time (k,), s, angle (k,). sigma (q,): steady-state 1 sigma. bias (q, k): estimate minus truth; noise (q, k): 1 sigma
    due to measurement noise.
    """

    time: np.ndarray
    angle: np.ndarray
    sigma: np.ndarray
    bias: np.ndarray
    noise: np.ndarray

    @classmethod
    def of(
        cls, time: np.ndarray, angle: np.ndarray, filters: Sequence[tuple[Model, np.ndarray, tuple[float, ...]]]
    ) -> ChannelRun:
        """Run filters on a true angle (k,): models with the covariance (n, n) and the state (n,) they start with."""
        bias, noise = np.swapaxes([without_noise(*each, angle) for each in filters], 0, 1)
        limits_ = [steady_state(m.phi, m.q, m.h, m.r)[0][0, 0] for m, _, _ in filters]
        return cls(time, angle, np.sqrt(limits_), bias, noise)


def nominal(scenario: Elevation) -> ChannelRun:
    """The elevation filters on the nominal approach, without random numbers."""
    f, section = scenario.filter, scenario.nominal
    time = section.from_s + f.period_s * np.arange(1, scenario.nominal_steps + 1)
    models = [_model(scenario, q) for q in section.rate_variances_deg2_s2]
    n = models[0].phi.shape[0]
    start = _initial(scenario, n), (*f.initial_deg, 0.0)[:n]
    return ChannelRun.of(time, mls.approach(time)[0], [(m, *start) for m in models])


def without_noise(
    m: Model, p0: np.ndarray, first: tuple[float, ...], angle: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Bias of a filter on a true angle (k,), deg, estimate minus truth, and 1 sigma due to noise, (k,)."""
    _, gains = covariance_sequence(m.phi, m.q, m.h, m.r, p0, angle.size)
    estimate = np.empty((angle.size, p0.shape[0]))
    follow(m.phi, gains[:, :, 0], np.array(first), angle, estimate)
    none = np.zeros_like(p0)
    noise = np.sqrt(driven_covariance(m.phi, m.h, m.r, gains, none, none)[:, 0, 0])
    return estimate[:, 0] - angle, noise


# --- the order of the filter, its criterion, the limits of its model


ORDERS = ("second order", "first order, rate white", "first order, same sigma", "first order, least error")
"""The filter of the scenario, and three first-order filters. Their process noise is: that of a white rate with the
initial variance of the rate; that for the second-order filter's sigma; that for the least error on this approach."""
TENTH = 0.1
"""Fraction of its largest value below which a bias has settled."""


@dataclass(frozen=True)
class OrderRun:
    """A filter on the nominal approach."""

    name: str
    variance: float
    """Process noise."""
    gain: float
    sigma: float
    """Steady-state sigma of its angle, deg."""
    bias: np.ndarray
    """(k,) deg."""
    noise: np.ndarray
    """(k,) deg."""
    before: float
    """Bias just before the glide-slope capture, deg."""
    recovery: float
    """Time from the capture until the bias stays below a tenth of its largest value after it, s; nan if it never
    does."""


def least_error_gain(rate: float, period: float, r: float) -> float:
    """Steady-state gain of the first-order filter with the least root mean square error, for an angle rate of `rate`,
    deg/s.

    The lag is rate T (1 - K)/K, and the noise variance R K/(2 - K).
    """
    k = np.geomspace(1e-6, 0.999, 20_000)
    return float(k[np.argmin((rate * period * (1.0 - k) / k) ** 2 + r * k / (2.0 - k))])


def orders(scenario: Elevation, flown: ChannelRun) -> list[OrderRun]:
    """First-order filters compared with the second-order one of the scenario, on the nominal approach.

    In steady state a first-order filter of the gain K has the process noise K P- = K^2 R/(1 - K).
    """
    f = scenario.filter
    r, m = f.measurement_variance_deg2, _model(scenario)
    n = m.phi.shape[0]
    second, gain = steady_state(m.phi, m.q, m.h, m.r)
    predicted = (m.phi @ second @ m.phi.T + m.q)[0, 0]
    fastest = float(np.abs(mls.approach(flown.time[judged(scenario, flown.time)])[1]).max())
    least = least_error_gain(fastest, f.period_s, r)
    variances = [
        f.initial_variance[1] * f.period_s**2,
        float(gain[0, 0] * predicted),
        least**2 / (1.0 - least) * r,
        *scenario.nominal.first_order_variances_deg2,
    ]
    names = [*ORDERS, *(f"first order, {digits(q, 4)} deg2" for q in scenario.nominal.first_order_variances_deg2)]
    out = [_order(names[0], f.rate_variance_deg2_s2, m, _initial(scenario, n), (*f.initial_deg, 0.0)[:n], flown)]
    for name, variance in zip(names[1:], variances, strict=True):
        p0 = np.array([[f.initial_variance[0]]])
        out.append(_order(name, variance, first_order(variance, r), p0, f.initial_deg[:1], flown))
    return out


def _order(
    name: str, variance: float, m: Model, p0: np.ndarray, first: tuple[float, ...], flown: ChannelRun
) -> OrderRun:
    p, gain = steady_state(m.phi, m.q, m.h, m.r)
    bias, noise = without_noise(m, p0, first, flown.angle)
    captured = flown.time >= mls.LEVEL_END
    before, recovery = np.nan, np.nan
    if captured.any() and not captured[0]:
        before = float(bias[~captured][-1])
        late = np.abs(bias[captured])
        above = np.flatnonzero(late > TENTH * late.max())[-1]
        if above + 1 < late.size:
            recovery = float(flown.time[captured][above + 1] - mls.LEVEL_END)
    return OrderRun(name, variance, float(gain[0, 0]), float(np.sqrt(p[0, 0])), bias, noise, before, recovery)


STRETCHES = ("level leg", "glide", "flare", "roll-out", "nominal run")


def memory(m: Model, period: float) -> float:
    """Time constant of a filter in the limit, s: that of the slowest pole of (I - K h) phi."""
    gain = steady_state(m.phi, m.q, m.h, m.r)[1]
    poles = np.linalg.eigvals((np.eye(m.phi.shape[0]) - gain @ m.h) @ m.phi)
    return float(-period / np.log(np.abs(poles).max()))


def largest_accelerations(scenario: Elevation) -> np.ndarray:
    """Largest |beta''| on each of STRETCHES, deg/s2."""
    ends = np.array([0.0, mls.LEVEL_END, mls.GLIDE_END, mls.GLIDE_END + mls.FLARE, mls.GLIDE_END + mls.FLARE + 20.0])
    stretches = [*itertools.pairwise(ends), (scenario.nominal.from_s, scenario.nominal.to_s)]
    # a corner belongs to the stretch before it as well as to that after it
    return np.array([
        np.abs(mls.approach(np.linspace(a, np.nextafter(b, a), 20_001))[2]).max() for a, b in stretches
    ])  # fmt: skip


@dataclass(frozen=True)
class Limits:
    """Distance of the exact model of a correlated acceleration from its limits, as a function of T over the correlation
    time."""

    to_velocity: float
    """Largest difference of its transition matrix from constant velocity (uncorrelated accelerations). Elements of the
    last column are relative to T^2/2, T, 1."""
    to_acceleration: float
    """Largest difference from constant acceleration, likewise."""
    to_white: float
    """Largest relative difference of Q of angle and rate from that of a white acceleration of the same density."""
    drive: float
    """Variance that a period adds to the acceleration, as a fraction of the acceleration's own."""
    angle: float
    """Steady-state P11 over that of the scenario's `paper` model."""


def limits(scenario: Elevation, correlation_time: float) -> Limits:
    """Comparison of the exact model with its limits; the density of the acceleration is that of the filter."""
    f = scenario.filter
    t, density = f.period_s, f.rate_variance_deg2_s2 / f.period_s
    variance = 0.5 * density / correlation_time
    phi, q = singer(t, 1.0 / correlation_time, float(np.sqrt(variance)))
    shares = phi[:, 2] / np.array([0.5 * t * t, t, 1.0])
    white = density * np.array([[t**3 / 3.0, t**2 / 2.0], [t**2 / 2.0, t]])
    r = np.array([[f.measurement_variance_deg2]])
    exact = steady_state(phi, q, np.array([[1.0, 0.0, 0.0]]), r)[0][0, 0]
    m = model("paper", t, f.rate_variance_deg2_s2, correlation_time, f.measurement_variance_deg2)
    paper = steady_state(m.phi, m.q, m.h, m.r)[0][0, 0]
    return Limits(
        float(np.abs(shares).max()), float(np.abs(1.0 - shares).max()), float(np.abs(q[:2, :2] / white - 1.0).max()),
        float(q[2, 2] / variance), float(exact / paper),
    )  # fmt: skip


# --- the azimuth, and the flare guided from beyond the runway


def judged(scenario: Elevation, time: np.ndarray) -> np.ndarray:
    """Whether times of the nominal run are past its settling."""
    return time >= scenario.nominal.from_s + SETTLING


def azimuth_channel(scenario: Elevation) -> ChannelRun:
    """The azimuth filter while the aircraft turns onto the centre line."""
    c, f = scenario.azimuth, scenario.filter
    time = c.from_s + c.period_s * np.arange(1, scenario.azimuth_steps + 1)
    angle = mls.azimuth(time, c.on_line_s, c.cross_speed_m_s, c.cross_acceleration_m_s2)[0]
    filters = []
    for q in c.rate_variances_deg2_s2:
        m = model(f.model, c.period_s, q, f.correlation_time_s, c.measurement_variance_deg2)
        n = m.phi.shape[0]
        filters.append((m, _initial(scenario, n, q, c.period_s), (*c.initial_deg, 0.0)[:n]))
    return ChannelRun.of(time, angle, filters)


FLARE_SOURCES = ("angle of the station", "range and radio altimeter", "both")


@dataclass(frozen=True)
class FlareRun:
    """The flare: time, beta (k,); by source, 1 sigma of one measured angle (s, k); by source and Q, bias and noise
    (s, q, k), deg. lever: height that a degree is at touchdown, m."""

    time: np.ndarray
    beta: np.ndarray
    measured: np.ndarray
    bias: np.ndarray
    noise: np.ndarray
    lever: float


def flare_steps(scenario: Elevation) -> int:
    """Measurements of the flare."""
    return int(mls.FLARE / scenario.filter.period_s + 1e-9)


def flare_guidance(scenario: Elevation) -> FlareRun:
    """The filter in the flare, guided by the station's angle, by arctan(height/range), or by both.

    Both measure the same angle: they count as one measurement of the variance 1/(1/R1 + 1/R2).
    """
    c, f = scenario.flare, scenario.filter
    since = f.period_s * np.arange(1, flare_steps(scenario) + 1)
    leg = mls.flare(since, mls.FLARE_STATION)
    beta = mls.elevation(leg)[0]
    height = np.maximum(c.height_sigma_floor_m, c.height_sigma_share * leg.h)
    angle = np.full(since.size, np.sqrt(f.measurement_variance_deg2))
    onboard = mls.angle_sigma(leg.d, leg.h, c.range_sigma_m, height)
    measured = np.array([angle, onboard, 1.0 / np.hypot(1.0 / angle, 1.0 / onboard)])
    runs = np.empty((2, len(FLARE_SOURCES), len(c.rate_variances_deg2_s2), since.size))
    for i, sigma in enumerate(measured):
        for j, q in enumerate(c.rate_variances_deg2_s2):
            m = replace(_model(scenario, q), r=sigma[:, None, None] ** 2)
            n = m.phi.shape[0]
            runs[:, i, j] = without_noise(m, _initial(scenario, n, q), (*c.initial_deg, 0.0)[:n], beta)
    lever = float(np.hypot(leg.h[-1], leg.d[-1]) ** 2 / leg.d[-1] / mls.TO_DEGREES)
    return FlareRun(mls.GLIDE_END + since, beta, measured, runs[0], runs[1], lever)


# --- the paper's numbers


@dataclass(frozen=True)
class Checked:
    """A number of the paper with ours."""

    statement: str
    published: float
    computed: float
    unit: str
    verdict: str


def audit() -> list[Checked]:
    """Every number the paper states, computed from its own data where that can be done."""
    level, line = mls.elevation(mls.level_leg(np.array([80.0]))), mls.elevation(mls.glide(np.array([0.0])))
    start, rate, acceleration = (float(x[0]) for x in level)
    touchdown = float(mls.elevation(mls.flare(np.array([mls.FLARE]), mls.FLARE_STATION))[0][0])
    sigma = singer_sigma(0.2 * G, 0.1, 0.5)
    period, tau = 0.0247, 1.0

    def formula(d: float, h: float, along: float, up: float) -> float:
        return float(mls.angle_sigma(d, h, along, up)) ** 2

    rows = [
        Checked("beta at the start of the glide", 2.4, start, "deg", "off by 0.11; 2.4 needs D = 4772 m"),
        Checked("beta' there (text)", 0.042, rate, "deg/s", "near the level leg before capture; on the glide it is 0"),
        Checked("beta' there (table)", 0.0042, rate, "deg/s", "a misplaced decimal"),
        Checked("beta' on the glide", 0.0042, float(line[1][0]), "deg/s", "the line passes through the beacon"),
        Checked("beta'' there", 0.0002, acceleration, "deg/s2", "inconsistent with beta' at the same point by 7.7"),
        Checked("beta at touchdown (H = 2, D = 3500 m)", 0.032, touchdown, "deg", "agrees"),
        Checked("sink at the start of the flare", 3.2, 30.0 * mls.SINK, "m/s", "jumps; continuity needs 0.1067 1/s"),
        Checked("sigma_a for 0.2 g, 0.1, 0.5", 1.0743, sigma, "m/s2", "the formula is right"),
        Checked("sigma^2 of beta'' at 5000/200, along", 17e-4, formula(5000, 200, sigma, 0), "deg2/s4",
                "not reproducible: 7000 times too big"),
        Checked("sigma^2 of beta'' at 5000/200, up", 17e-4, formula(5000, 200, 0, sigma), "deg2/s4",
                "not reproducible: 11 times too big"),
    ]  # fmt: skip
    for printed, d, h in ((3.6e-8, 10000.0, 200.0), (11.5e-4, 1000.0, 40.0)):
        for name, along, up in (("along", sigma, 0.0), ("up", 0.0, sigma)):
            value = 2.0 * formula(d, h, along, up) * tau * period
            rows.append(Checked(f"Q at {d / 1000:g} km, {name}", printed, value, "deg2/s2", "not reproducible"))
    rows += [
        Checked("Q of the table from 17e-4", 1e-4, 2.0 * 17e-4 * tau * period, "deg2/s2",
                "the text rounded up by 19 %; so the 17e-4 went into the filter; its unit is (deg/s)^2"),
        Checked("coverage of the band, 50 runs", 0.95, coverage("std_theory", 0.2, 50), "1",
                "right for standard deviations"),
        Checked("coverage of +-20 % of P11, 50 runs", 0.95, coverage("variance", 0.2, 50), "1",
                "the conclusion's words mean the root of P11"),
        Checked("runs needed for 0.95 (std about theory)", 50, smallest_number("std_theory", 0.2, 0.95), "1", "right"),
        Checked("runs needed for 0.95 (std about sample)", 50, smallest_number("std_sample", 0.2, 0.95), "1", "right"),
        Checked("runs needed for 0.95 (variance)", 50, smallest_number("variance", 0.2, 0.95), "1", "wrong"),
    ]  # fmt: skip
    return rows


def compute(scenario: Elevation, seed: int, runs: int | None, done: Callable[[int], None] = lambda _: None) -> Result:
    """The whole study as a result. runs: of each experiment, replaces the scenario's."""
    section = scenario.montecarlo
    count = runs or section.runs
    proof = prove(scenario, seed, count, section.experiments, done)
    flown = nominal(scenario)
    m = _model(scenario)
    limit, gain = steady_state(m.phi, m.q, m.h, m.r)
    draft = ResultBuilder(ELEVATION)
    names = np.array(("beta", "beta_rate", "beta_acceleration")[: m.phi.shape[0]])
    draft.put("/step", np.arange(1, section.steps + 1), {"period_s": scenario.filter.period_s})
    draft["/state"] = draft["/state_column"] = names
    draft["/filter/covariance"] = proof.covariance
    draft["/filter/gain"] = proof.gain
    draft["/filter/steady_covariance"] = limit
    draft["/filter/steady_gain"] = gain[:, 0]
    draft["/montecarlo/mean_error"] = proof.mean_error
    draft["/montecarlo/covariance"] = proof.sample
    draft["/montecarlo/covariance_all"] = proof.all_runs
    draft["/band"] = np.array(BANDS)
    draft["/experiment"] = np.arange(1, section.experiments + 1)
    draft["/montecarlo/fraction_in_band"] = proof.inside
    draft["/montecarlo/runs"] = np.int64(count)
    draft["/montecarlo/nees"] = proof.nees
    draft["/montecarlo/nis"] = proof.nis
    for name, degrees in (("coverage", count), ("coverage_mean_removed", count - 1)):
        draft[f"/band_theory/{name}"] = np.array([coverage(b, section.band, degrees) for b in BANDS])
    needed = np.array([smallest_number(b, section.band, section.confidence) for b in BANDS])
    draft.put("/band_theory/runs_needed", needed, confidence=f"{section.confidence:g}")
    _approach(draft)
    _nominal(draft, scenario, flown)
    _orders(draft, scenario, flown)
    _model_limits(draft, scenario)
    _azimuth(draft, scenario)
    _flare(draft, scenario)
    rows = audit()
    for name, kind in (("statement", object), ("published", float), ("computed", float), ("unit", object),
                       ("verdict", object)):  # fmt: skip
        draft[f"/published/{name}"] = np.array([getattr(row, name) for row in rows], dtype=kind)
    out = draft.result(root_attributes("mls-elevation", seed, scenario))
    out.variables.update(kept(_findings(proof, section.steps, count * section.experiments)))
    return out


def _findings(proof: Proof, steps: int, runs: int) -> list[Finding]:
    """Findings of the Monte Carlo against the filter's covariance; errors within a run count as one."""
    size = proof.covariance.shape[1]
    out = []
    bad = ~positive(proof.covariance) | ~np.isfinite(proof.mean_error).all(axis=1)
    if bad.any():
        first = int(np.argmax(bad)) + 1
        text = f"{bad.sum()} of {steps} covariances are not positive definite, the first at step {first}"
        out.append(Finding("covariance_not_positive", text, (CONSISTENT,), int(bad.sum()), steps))
    out += doubted("sigma_all_states", "errors of all states", proof.nees / size, size * runs, runs)
    return out + doubted("innovations", "innovations", proof.nis, steps * runs, runs)


def _approach(draft: ResultBuilder) -> None:
    time = np.linspace(0.0, mls.GLIDE_END + mls.FLARE + 20.0, 1000)
    draft["/approach/time"] = time
    for name, column in zip(("beta", "beta_rate", "beta_acceleration"), mls.approach(time), strict=True):
        draft[f"/approach/{name}"] = column
    draft["/approach/segment_start"] = np.array([0.0, mls.LEVEL_END, mls.GLIDE_END, mls.GLIDE_END + mls.FLARE])


def _nominal(draft: ResultBuilder, scenario: Elevation, flown: ChannelRun) -> None:
    draft["/nominal/rate_variance"] = np.array(scenario.nominal.rate_variances_deg2_s2)
    draft.put("/nominal/time", flown.time, {"settling_s": SETTLING})
    draft["/nominal/beta"] = flown.angle
    draft["/nominal/bias"] = flown.bias
    draft["/nominal/noise"] = flown.noise
    settled = judged(scenario, flown.time)
    _worst(draft, "/nominal", flown.time, settled)
    draft["/nominal/steady_sigma"] = flown.sigma


def _orders(draft: ResultBuilder, scenario: Elevation, flown: ChannelRun) -> None:
    found, settled = orders(scenario, flown), judged(scenario, flown.time)
    draft["/order/filter"] = np.array([order.name for order in found], dtype=object)
    draft["/order/time"] = flown.time
    for name in ("variance", "gain", "sigma", "bias", "noise", "before", "recovery"):
        draft[f"/order/{name}"] = np.array([getattr(order, name) for order in found])
    _worst(draft, "/order", flown.time, settled)


def _worst(draft: ResultBuilder, place: str, time: np.ndarray, settled: np.ndarray) -> None:
    """Write the largest bias of each filter, its time, and the largest root mean square error, from the data so far."""
    bias, noise = draft[f"{place}/bias"][..., settled], draft[f"{place}/noise"][..., settled]
    peak = np.argmax(np.abs(bias), axis=-1)
    draft[f"{place}/peak_bias"] = np.take_along_axis(bias, peak[..., None], axis=-1)[..., 0]
    draft[f"{place}/peak_time"] = time[settled][peak]
    draft[f"{place}/worst_rmse"] = np.hypot(bias, noise).max(axis=-1)


def _model_limits(draft: ResultBuilder, scenario: Elevation) -> None:
    f, m = scenario.filter, _model(scenario)
    length, largest = memory(m, f.period_s), largest_accelerations(scenario)
    draft["/criterion/acceleration"] = largest
    draft["/criterion/memory"] = length
    draft["/criterion/sigma"] = np.sqrt(f.measurement_variance_deg2)
    draft["/criterion/period_error"] = 0.5 * f.period_s**2 * largest
    draft["/criterion/memory_error"] = 0.5 * length**2 * largest
    times = np.array(scenario.correlation_times_s)
    draft["/limit/correlation_time"] = times
    draft["/limit/ratio"] = f.period_s / times
    rows = [limits(scenario, time) for time in scenario.correlation_times_s]
    for name in ("to_velocity", "to_acceleration", "to_white", "drive", "angle"):
        draft[f"/limit/{name}"] = np.array([getattr(row, name) for row in rows])


def _azimuth(draft: ResultBuilder, scenario: Elevation) -> None:
    found = azimuth_channel(scenario)
    draft["/azimuth/rate_variance"] = np.array(scenario.azimuth.rate_variances_deg2_s2)
    draft["/azimuth/time"] = found.time
    draft["/azimuth/angle"] = found.angle
    draft["/azimuth/steady_sigma"] = found.sigma
    draft["/azimuth/bias"], draft["/azimuth/noise"] = found.bias, found.noise
    _worst(draft, "/azimuth", found.time, found.time >= scenario.azimuth.from_s + SETTLING)


def _flare(draft: ResultBuilder, scenario: Elevation) -> None:
    found = flare_guidance(scenario)
    draft["/flare/rate_variance"] = np.array(scenario.flare.rate_variances_deg2_s2)
    draft["/flare/time"] = found.time
    draft["/flare/beta"] = found.beta
    draft["/flare/measured_sigma"] = found.measured
    draft["/flare/bias"], draft["/flare/noise"] = found.bias, found.noise
    _worst(draft, "/flare", found.time, found.time >= mls.GLIDE_END + SETTLING)
    draft["/flare/touchdown_rmse"] = np.hypot(found.bias, found.noise)[..., -1]
    draft["/flare/touchdown_height_rmse"] = found.lever * np.hypot(found.bias, found.noise)[..., -1]
