"""`kind: azimuth-tracking`: Singer's filters against those driven by reported load factors.

Source: `docs/theory/azimuth.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navsim.companions.azimuth.filter import FIRST, HELD, LITERAL, SINGER, TANGENT, azimuth_filter
from navsim.companions.azimuth.scenario import Azimuth
from navsim.companions.circuit import CircuitFlight, at, fly
from navsim.companions.circuit_section import CircuitSection
from navsim.companions.kalman import singer
from navsim.companions.reports import Draws, Onboard, draw, nodes, reported, stamped
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept
from navsim.results.result import Result
from navsim.results.schema import AZIMUTH
from navsim.runner.attributes import root_attributes
from navsim.runner.findings import of_filter
from navsim.runner.statistics import mean_interval
from navsim.scenario_files.base import DEG

FILTERS = ("S1", "S2", "L1", "L2", "L3", "L4")
SOURCES = ("L4 stamped", "L4 roll", "L4 track rate", "L4 roll stamped")
"""Variants of L4: age of the reports known; BDS 5,0 roll or track rate instead of load factors."""
WINDOWS = ("manoeuvre", "straight")
BASELINES = ("S1", "S2")
_KINDS = {"L1": LITERAL, "L2": TANGENT, "L3": HELD, "L4": FIRST}


@dataclass(frozen=True)
class Scans:
    """Inputs of all filters of one case: n scans of `runs` runs.

    azimuth, ground_range (run, n) measured, rad, m; nodes by source (run, n, 4), as `companions.reports.nodes`; truth
    (n,).
    """

    period: float
    time: np.ndarray
    truth: np.ndarray
    azimuth: np.ndarray
    ground_range: np.ndarray
    variance: float
    reports: np.ndarray
    latency: float


def scans(
    scenario: Azimuth, flight: CircuitFlight, period: float, draws: Draws, latency: float, sigma_deg: float
) -> Scans:
    """Plots and reports of one case."""
    quiet = scenario.noise == "none"
    time = np.arange(draws.plots.shape[1]) * period
    here = at(flight, time)
    sigma = sigma_deg * DEG
    azimuth = np.unwrap(here.azimuth) + (0.0 if quiet else sigma) * draws.plots[..., 0]
    slant = here.range + (0.0 if quiet else scenario.radar.range_sigma_m) * draws.plots[..., 1]
    ground = np.sqrt(np.maximum(slant**2 - here.position[:, 1] ** 2, 1.0))
    then = at(flight, np.maximum(time - (0.0 if quiet else latency), 0.0))
    errors = Onboard(np.zeros(8), np.zeros(8)) if quiet else onboard(scenario)
    return Scans(
        period, time, np.unwrap(here.azimuth), azimuth, ground, sigma**2, reported(then, draws.reports, errors),
        0.0 if quiet else latency,
    )  # fmt: skip


def onboard(scenario: Azimuth) -> Onboard:
    """Noise and quantisation of reports."""
    r = scenario.report
    n, ln = r.load_factor_sigma_g, r.load_factor_lsb_g
    sigma = [n, n, n, r.roll_sigma_deg * DEG, r.path_angle_sigma_deg * DEG, r.track_sigma_deg * DEG, r.speed_sigma_m_s,
             r.track_rate_sigma_deg_s * DEG]  # fmt: skip
    lsb = [ln, ln, ln, r.roll_lsb_deg * DEG, 0.0, r.track_lsb_deg * DEG, r.speed_lsb_m_s, r.track_rate_lsb_deg_s * DEG]
    return Onboard(np.array(sigma), np.array(lsb))


@dataclass(frozen=True)
class Errors:
    """One filter over all runs: error (run, n) rad, deviation (n,) its 1 sigma in the first run, nis (run, n)."""

    error: np.ndarray
    deviation: np.ndarray
    nis: np.ndarray


def run_filter(name: str, case: Scans, alpha: float, sigma: float) -> Errors:
    """One filter, by the name it has in the result, with its 1 sigma of acceleration (m/s2)."""
    runs, count = case.azimuth.shape
    phi, q = map(np.ascontiguousarray, singer(case.period, alpha, 1.0))
    source = "roll" if "roll" in name else "rate" if "rate" in name else "load"
    now = nodes(case.reports, source, case.period)
    before = np.concatenate([now[:, :1], now[:, :-1]], axis=1)
    if "stamped" in name:
        before, now = stamped(now, case.period, case.latency)
    kind = SINGER if name.startswith("S") else _KINDS[name[:2]]
    error, deviation, nis = np.empty((runs, count)), np.empty((runs, count)), np.empty((runs, count))
    sigmas = np.full(count, sigma)
    for run in range(runs):
        azimuth_filter(
            kind, case.period, case.azimuth[run], case.ground_range[run], case.variance, phi, q, sigmas,
            before[run], now[run], case.truth, error[run], deviation[run], nis[run],
        )  # fmt: skip
    return Errors(error, deviation[0], nis)


def window(circuit: CircuitSection, name: str, time: np.ndarray) -> np.ndarray:
    """Which scans count."""
    stretches = circuit.manoeuvre_s if name == "manoeuvre" else circuit.straight_s
    return np.any([(time >= a - 1e-9) & (time < b - 1e-9) for a, b in stretches], axis=0)


def rmse(errors: np.ndarray) -> np.ndarray:
    """Root mean square over runs and scans with its 95 % interval (runs count as independent): value, low, high."""
    square = mean_interval(np.mean(errors**2, axis=1))
    return np.sqrt(np.maximum(square, 0.0))


def ratio(over: np.ndarray, under: np.ndarray) -> np.ndarray:
    """Ratio of two root mean square errors (run, n) of the same runs, with its 95 % interval by linearisation.

    nan where one of them is zero, as in a run without noise.
    """
    a, b = np.mean(over**2, axis=1), np.mean(under**2, axis=1)
    if not a.any() or not b.any():
        return np.full(3, np.nan)
    value = float(np.sqrt(a.mean() / b.mean()))
    spread = 0.5 * value * (a / a.mean() - b / b.mean())
    reach = float(mean_interval(spread)[2] - mean_interval(spread)[0])
    return np.array([value, value - reach, value + reach])


def peak_growth(manoeuvre: np.ndarray, straight: np.ndarray) -> float:
    """Largest RMSE of a scan of the manoeuvre (run, n) over the RMSE of the straight stretch; nan for no error."""
    level = float(np.sqrt(np.mean(straight**2)))
    return float(np.sqrt(np.mean(manoeuvre**2, axis=0)).max()) / level if level else np.nan


def run_count(scenario: Azimuth, runs: int | None) -> int:
    """Number of runs; runs: replaces the scenario's."""
    return 1 if scenario.noise == "none" else runs or scenario.runs


def mapped(scenario: Azimuth) -> bool:
    """Whether there is a map."""
    return scenario.map.runs > 0 and scenario.noise != "none"


def compute(scenario: Azimuth, seed: int, runs: int | None, done: Callable[[int], None] = lambda _: None) -> Result:
    """The whole study as a result; runs: replaces the scenario's."""
    count = run_count(scenario, runs)
    flight = fly(scenario.circuit.circuit())
    periods = [scenario.period_s, *scenario.further_periods_s]
    draft = ResultBuilder(AZIMUTH, case=[f"T{period:g}" for period in periods[1:]])
    draft["/run"] = np.arange(count)
    draft["/filter"] = np.array([*FILTERS, *SOURCES], dtype=object)
    draft["/window"] = np.array(WINDOWS)
    _truth(draft, flight)
    draft["/period"] = np.array(periods)
    draft["/latency"] = np.array(scenario.latencies_s)
    tables, ratios, nis, sweep, growth, peaks = [], [], [], [], [], []
    warned: list[Finding] = []
    for i, period in enumerate(periods):
        draws = draw(seed, count, scenario.circuit.scans(period))
        case = scans(scenario, flight, period, draws, scenario.report.latency_s, scenario.radar.azimuth_sigma_deg)
        found = {name: _tuned(scenario, name, case) for name in (*FILTERS, *SOURCES)}
        for name, errors in found.items():
            warned += of_filter(f"{name}, T = {period:g} s", case.time, errors.error, errors.deviation)
        _case(draft, "" if i == 0 else f"T{period:g}", case, found)
        masks = [window(scenario.circuit, name, case.time) for name in WINDOWS]
        tables.append([[rmse(found[f].error[:, m]) for m in masks] for f in found])
        ratios.append([[ratio(found[s].error[:, m], found["L4"].error[:, m]) for m in masks] for s in BASELINES])
        growth.append([ratio(*(found[s].error[:, m] for m in masks)) for s in BASELINES])
        peaks.append([peak_growth(*(found[s].error[:, m] for m in masks)) for s in BASELINES])
        nis.append([[float(np.nanmean(found[f].nis[:, m])) for m in masks] for f in found])
        sweep.append(_latencies(scenario, flight, period, draws, masks[0]))
        done(1 + i)
    draft["/summary/rmse"] = np.degrees(np.array(tables))
    draft["/summary/nis"] = np.array(nis)
    draft["/summary/ratio_to_l4"] = np.array(ratios)
    draft["/summary/growth"] = np.array(growth)
    draft["/summary/peak_growth"] = np.array(peaks)
    draft["/summary/latency_rmse"] = np.degrees(np.array(sweep))
    _model_errors(draft, scenario, flight)
    if mapped(scenario):
        _maps(draft, scenario, flight, seed, lambda n: done(len(periods) + n))
    out = draft.result(root_attributes("azimuth-tracking", seed, scenario))
    out.variables.update(kept(warned))
    return out


def extent(scenario: Azimuth) -> int:
    """Steps of progress: cases, then rows of the maps."""
    rows = len(scenario.map.periods_s) if mapped(scenario) else 0
    return 1 + len(scenario.further_periods_s) + rows


def _tuned(scenario: Azimuth, name: str, case: Scans) -> Errors:
    f = scenario.filters
    sigma = {"S1": f.singer_sigma_m_s2[0], "S2": f.singer_sigma_m_s2[1]}.get(name, f.residual_sigma_m_s2)
    return run_filter(name, case, f.alpha_1_s, sigma)


def _case(draft: ResultBuilder, label: str, case: Scans, found: dict[str, Errors]) -> None:
    """Write time and filters of a case; label: "" for the first, the others omit the variants of L4.

    A case has its own scans: a dimension different from that of the root.
    """
    place = f"/cases/{label}" if label else ""
    if label:
        draft[f"{place}/scan_{label}"] = np.arange(case.time.size)
    draft[f"{place}/time"] = case.time
    for name, errors in found.items():
        if not label or name in FILTERS:
            here = f"{place}/filters/{name.replace(' ', '_')}"
            draft[f"{here}/error_deg"] = np.degrees(errors.error)
            draft[f"{here}/sigma_deg"] = np.degrees(errors.deviation)


def _latencies(
    scenario: Azimuth, flight: CircuitFlight, period: float, draws: Draws, mask: np.ndarray
) -> list[list[float]]:
    out = []
    for latency in scenario.latencies_s:
        case = scans(scenario, flight, period, draws, latency, scenario.radar.azimuth_sigma_deg)
        pair = [_tuned(scenario, name, case).error[:, mask] for name in ("L4", "L4 stamped")]
        out.append([float(np.sqrt(np.mean(e**2))) for e in pair])
    return out


def _truth(draft: ResultBuilder, flight: CircuitFlight) -> None:
    thin = slice(None, None, 10)
    draft["/instant"] = np.arange(flight.time[thin].size)
    draft["/truth/time"] = flight.time[thin]
    draft["/truth/position"] = flight.position[thin]
    for name, values in (
        ("azimuth", flight.azimuth),
        ("azimuth_rate", flight.azimuth1),
        ("azimuth_acceleration", flight.azimuth2),
        ("azimuth_acceleration_literal", flight.azimuth2_literal),
        ("roll", flight.roll),
    ):
        draft[f"/truth/{name}"] = np.degrees(values)[thin]


def _model_errors(draft: ResultBuilder, scenario: Azimuth, flight: CircuitFlight) -> None:
    """Write the error of the paper's acceleration, window by window, without a filter."""
    ahead, right = flight.level_acceleration()
    d = flight.track - flight.azimuth
    tangent = (ahead * np.sin(d) + right * np.cos(d)) / flight.ground_range
    exact = flight.azimuth2
    rows = []
    for name in WINDOWS:
        mask = window(scenario.circuit, name, flight.time)
        rows.append(
            [
                np.sqrt(np.mean(x[mask] ** 2))
                for x in (exact, flight.azimuth2_literal - exact, tangent - exact)
            ]
        )  # fmt: skip
    draft["/summary/acceleration_rms"] = np.degrees(np.array(rows))


def _maps(
    draft: ResultBuilder, scenario: Azimuth, flight: CircuitFlight, seed: int, done: Callable[[int], None]
) -> None:
    """Singer over L4, each at its best tuning in the manoeuvre."""
    section = scenario.map
    draft["/map/scan_period"] = np.array(section.periods_s)
    draft["/map/azimuth_sigma"] = np.array(section.azimuth_sigmas_deg)
    draft["/map/report_age"] = np.array(section.latencies_s)
    by_sigma = np.empty((len(section.periods_s), len(section.azimuth_sigmas_deg)))
    by_latency = np.empty((len(section.periods_s), len(section.latencies_s)))
    growth = np.empty((len(section.periods_s), len(section.singer_sigmas_m_s2)))

    for i, period in enumerate(section.periods_s):
        draws = draw(seed, section.runs, scenario.circuit.scans(period))

        def best(name: str, sigmas: tuple[float, ...], case: Scans) -> float:
            inside = window(scenario.circuit, "manoeuvre", case.time)
            each = [run_filter(name, case, scenario.filters.alpha_1_s, s).error[:, inside] for s in sigmas]
            return min(float(np.sqrt(np.mean(e**2))) for e in each)

        def one(latency: float, sigma: float, period: float = period, draws: Draws = draws) -> float:
            case = scans(scenario, flight, period, draws, latency, sigma)
            over = best("S", section.singer_sigmas_m_s2, case)
            return over / best("L4", section.residual_sigmas_m_s2, case)

        by_sigma[i] = [one(scenario.report.latency_s, s) for s in section.azimuth_sigmas_deg]
        by_latency[i] = [one(late, scenario.radar.azimuth_sigma_deg) for late in section.latencies_s]
        usual = scans(scenario, flight, period, draws, scenario.report.latency_s, scenario.radar.azimuth_sigma_deg)
        masks = [window(scenario.circuit, name, usual.time) for name in WINDOWS]
        for j, sigma in enumerate(section.singer_sigmas_m_s2):
            error = run_filter("S", usual, scenario.filters.alpha_1_s, sigma).error
            growth[i, j] = ratio(*(error[:, m] for m in masks))[0]
        done(i + 1)
    draft["/map/ratio"] = by_sigma
    draft["/map/ratio_by_latency"] = by_latency
    draft["/map/singer_sigma"] = np.array(section.singer_sigmas_m_s2)
    draft["/map/growth"] = growth
