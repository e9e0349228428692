"""`kind: atc-tracking`: Singer on range against filters with onboard data, full and decoupled.

Source: `docs/theory/atc.md`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from navsim.companions.atc.filter import ADAPT, FIX, FULL, MEASURED, NAMES, N, cartesian, singer_range, start, track
from navsim.companions.atc.scenario import Atc, DataLink
from navsim.companions.azimuth.study import ratio, rmse
from navsim.companions.azimuth.study import window as _window
from navsim.companions.circuit import CircuitFlight, at, fly
from navsim.companions.kalman import singer, steady_state
from navsim.companions.reports import quantise
from navsim.results.builder import ResultBuilder
from navsim.results.findings import Finding, kept
from navsim.results.result import Result
from navsim.results.schema import ATC
from navsim.runner.attributes import root_attributes
from navsim.runner.findings import of_filter
from navsim.scenario_files.base import DEG
from navsim.statistics.random_streams import generator

FILTERS = ("full", "adapt", "fix", "singer", "cartesian")
WINDOWS = ("manoeuvre", "straight")
CARTESIAN = ("range", "range_rate", "elevation", "azimuth")
UNITS = ("m", "m/s", "m/s2", "m/s", "m/s2", *("rad", "rad/s") * 4)


@dataclass(frozen=True)
class TrackingCase:
    """A case in SI units and rad; variance (9,) that the filters count with, noise (9,) in truth, decay, rate_variance
    (5,). latency, quantised: of reports in truth; age: that the filters count with."""

    period: float
    rates: bool
    variance: np.ndarray
    decay: np.ndarray
    rate_variance: np.ndarray
    noise: np.ndarray
    latency: float
    quantised: bool
    age: float


def settings(scenario: Atc, period: float, rates: bool, link: DataLink | None = None) -> TrackingCase:
    """The filters' numbers of one case; link: instead of the scenario's."""
    link = link or scenario.link
    s, g = scenario.sigmas, scenario.groups
    sigma = np.array([
        s.range_m, s.speed_m_s, s.path_angle_deg * DEG, s.track_deg * DEG, s.elevation_deg * DEG, s.azimuth_deg * DEG,
        s.speed_rate_m_s2, s.path_angle_rate_deg_s * DEG, s.track_rate_deg_s * DEG,
    ])  # fmt: skip
    groups = (g.speed, g.path_angle, g.track, g.elevation, g.azimuth)
    decay = np.array([1.0 - group.alpha_1_s * period for group in groups])
    unit = np.array([1.0, DEG, DEG, DEG, DEG])
    rate = np.array([group.rate_sigma for group in groups]) * unit
    variance = sigma**2
    if link.assumed_quantised:
        speed = scenario.circuit.speed_m_s
        steps = [0.0, link.speed_lsb_m_s, link.vertical_rate_lsb_m_s / speed, link.track_lsb_deg * DEG, 0.0, 0.0,
                 0.0, 0.0, link.track_rate_lsb_deg_s * DEG]  # fmt: skip
        variance = variance + np.square(steps) / 12.0
    quiet = scenario.noise == "none"
    return TrackingCase(
        period, rates, variance, decay, rate**2 * (1.0 - decay**2), np.zeros(MEASURED) if quiet else sigma,
        0.0 if quiet else link.latency_s, link.quantised and not quiet, 0.0 if quiet else link.assumed_latency_s,
    )  # fmt: skip


_REPORTED = [1, 2, 3, 6, 7, 8]
"""Columns of the measurements that come by data link; the others are the radar's."""
_OF_STATES = [0, 3, 5, 7, 9, 11, 4, 6, 8]
"""States that are measured."""


def quantised_reports(measured: np.ndarray, link: DataLink) -> np.ndarray:
    """Measurements (n, 9) as registers have them: speed, track and its rate, and the vertical rate, from which and the
    speed the path angle follows."""
    out = measured.copy()
    up = quantise(measured[:, 1] * np.sin(measured[:, 2]), link.vertical_rate_lsb_m_s)
    out[:, 1] = quantise(measured[:, 1], link.speed_lsb_m_s)
    if link.vertical_rate_lsb_m_s > 0.0:
        out[:, 2] = np.arcsin(np.clip(up / np.maximum(out[:, 1], 1.0), -1.0, 1.0))
    out[:, 3] = quantise(measured[:, 3], link.track_lsb_deg * DEG)
    out[:, 8] = quantise(measured[:, 8], link.track_rate_lsb_deg_s * DEG)
    return out


def truth(flight: CircuitFlight) -> np.ndarray:
    """The 13 states (n, 13) of a flight."""
    return np.column_stack([
        flight.range, flight.range1, flight.range2, flight.speed, flight.speed1, flight.path_angle, flight.path_angle1,
        flight.track, flight.track1, flight.elevation, flight.elevation1, np.unwrap(flight.azimuth), flight.azimuth1,
    ])  # fmt: skip


def fly_case(
    scenario: Atc, flight: CircuitFlight, case: TrackingCase, seed: int, runs: int
) -> tuple[np.ndarray, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Time (k,) and, by filter, errors (run, k, m) and the filter's sigma in the first run (k, m)."""
    time = np.arange(scenario.circuit.scans(case.period)) * case.period
    states = truth(at(flight, time))
    true = states[:, _OF_STATES]
    if case.latency > 0.0:
        true[:, _REPORTED] = truth(at(flight, np.maximum(time - case.latency, 0.0)))[:, _OF_STATES][:, _REPORTED]
    k = time.size
    error = {name: np.empty((runs, k, states_of(name))) for name in FILTERS}
    deviation = {name: np.empty((k, states_of(name))) for name in FILTERS}
    scratch = {name: np.empty((k, states_of(name))) for name in FILTERS}
    start_sigma = np.array([scenario.start_range_rate_m_s, scenario.start_range_acceleration_m_s2])
    own = singer(case.period, scenario.singer.alpha_1_s, scenario.singer.sigma_m_s2)
    plain = singer(case.period, scenario.cartesian.alpha_1_s, scenario.cartesian.sigma_m_s2)
    first_variance = np.array([case.variance[0], *start_sigma**2])
    axis_variance = np.array([case.variance[0], 9.0, scenario.cartesian.sigma_m_s2**2])
    first = np.empty(N)
    for run in range(runs):
        measured = true + case.noise * generator(seed, run, "plots").standard_normal((k, MEASURED))
        if case.quantised:
            measured = quantised_reports(measured, scenario.link)
        out = deviation if run == 0 else scratch
        for name, kind in (("full", FULL), ("adapt", ADAPT), ("fix", FIX)):
            track(
                kind, case.period, measured, case.variance, case.rates, case.age, case.decay, case.rate_variance,
                scenario.residual_m_s2, start_sigma, states, error[name][run], out[name],
            )  # fmt: skip
        start(measured[0], first)
        singer_range(
            measured[:, 0], case.variance[0], *own, first[:3], first_variance, states[:, :3], error["singer"][run],
            out["singer"],
        )  # fmt: skip
        cartesian(
            measured, case.variance, case.age, *plain, axis_variance, states, error["cartesian"][run], out["cartesian"]
        )
    return time, {name: (error[name], deviation[name]) for name in FILTERS}


def states_of(name: str) -> int:
    """Number of states that a filter leaves a history of."""
    return {"singer": 3, "cartesian": len(CARTESIAN)}.get(name, N)


def _states(name: str) -> tuple[str, ...]:
    return {"singer": NAMES[:3], "cartesian": CARTESIAN}.get(name, NAMES)


def group_limits(case: TrackingCase) -> list[tuple[float, np.ndarray]]:
    """Steady 1 sigma of the level and gain (2,) of each pair, without measured rates: SI, rad."""
    out = []
    for g in range(5):
        phi = np.array([[1.0, case.period], [0.0, case.decay[g]]])
        q = np.diag([0.0, case.rate_variance[g]])
        p, gain = steady_state(phi, q, np.array([[1.0, 0.0]]), case.variance[1 + g : 2 + g, None])
        out.append((float(np.sqrt(p[0, 0])), gain[:, 0]))
    return out


def multiplications(states: int, measurements: int) -> int:
    """Multiplications of a covariance step with scalar updates: 2 n^3 + m (n^2 + n)."""
    return 2 * states**3 + measurements * (states**2 + states)


def run_count(scenario: Atc, runs: int | None) -> int:
    """Number of runs; runs: replaces the scenario's."""
    return 1 if scenario.noise == "none" else runs or scenario.runs


def compute(scenario: Atc, seed: int, runs: int | None, done: Callable[[int], None] = lambda _: None) -> Result:
    """The whole study as a result; runs: replaces the scenario's."""
    count = run_count(scenario, runs)
    flight = fly(scenario.circuit.circuit())
    cases = [(scenario.period_s, scenario.onboard_rates),
             *((c.period_s, c.onboard_rates) for c in scenario.further_cases)]  # fmt: skip
    labels = [f"T{period:g}_{'rates' if rates else 'angles'}" for period, rates in cases]
    draft = ResultBuilder(ATC, case=labels[1:])
    draft["/run"] = np.arange(count)
    draft["/case"] = np.array(labels, dtype=object)
    draft["/filter"] = np.array(FILTERS)
    draft["/window"] = np.array(WINDOWS)
    draft.put("/state", np.array(NAMES), {"state_units": ", ".join(UNITS)})
    draft["/singer_state"] = np.array(NAMES[:3])
    draft["/cartesian_state"] = np.array(CARTESIAN)
    tables = np.full((len(cases), len(FILTERS), len(WINDOWS), N, 3), np.nan)
    to_full = np.full((len(cases), 2, len(WINDOWS), N, 3), np.nan)
    to_adapt = np.full((len(cases), len(WINDOWS), 2, 3), np.nan)
    warned: list[Finding] = []
    for i, (period, rates) in enumerate(cases):
        case = settings(scenario, period, rates)
        time, found = fly_case(scenario, flight, case, seed, count)
        for name, (error, deviation) in found.items():
            warned += of_filter(f"{name}, {labels[i]}", time, error, deviation)
        _case(draft, "" if i == 0 else labels[i], time, found)
        for w, name in enumerate(WINDOWS):
            inside = _window(scenario.circuit, name, time)
            for f, which in enumerate(FILTERS):
                for m, state in enumerate(_states(which)):
                    tables[i, f, w, NAMES.index(state)] = rmse(found[which][0][:, inside, m])
            for j, which in enumerate(("adapt", "fix")):
                for m in range(N):
                    to_full[i, j, w, m] = ratio(found[which][0][:, inside, m], found["full"][0][:, inside, m])
            for m in range(2):
                to_adapt[i, w, m] = ratio(found["singer"][0][:, inside, m], found["adapt"][0][:, inside, m])
        done(i + 1)
    draft["/summary/rmse"] = tables
    draft["/summary/decoupled_to_full"] = to_full
    draft["/range_state"] = np.array(NAMES[:2])
    draft["/summary/singer_to_adapt"] = to_adapt
    limits = group_limits(settings(scenario, scenario.period_s, False))
    draft["/limits/sigma"] = np.array([sigma for sigma, _ in limits])
    draft["/limits/gain"] = np.array([g for _, g in limits])
    if linked(scenario):
        _link(draft, scenario, flight, seed)
        done(len(cases) + 1)
    for name, value in (
        ("multiplications_full", multiplications(N, 6)),
        ("multiplications_decoupled", 5 * multiplications(2, 1) + multiplications(3, 1)),
        ("stored_full", N * (N + 1) // 2),
        ("stored_decoupled", 5 * 3 + 6),
    ):
        draft[f"/summary/{name}"] = np.int64(value)
    out = draft.result(root_attributes("atc-tracking", seed, scenario))
    out.variables.update(kept(warned))
    return out


def extent(scenario: Atc) -> int:
    """Steps of progress."""
    return 1 + len(scenario.further_cases) + linked(scenario)


def linked(scenario: Atc) -> bool:
    """Whether there is a study of the data link."""
    return scenario.link.study_runs > 0 and scenario.noise != "none"


LINK_FILTERS = ("full", "adapt", "fix", "cartesian")


def _link(draft: ResultBuilder, scenario: Atc, flight: CircuitFlight, seed: int) -> None:
    """Write the cost of age and quantisation of reports in the manoeuvre, relative to exact reports of the same
    runs."""
    section = scenario.link
    exact = section.model_copy(
        update={"latency_s": 0.0, "quantised": False, "assumed_latency_s": 0.0, "assumed_quantised": False}
    )
    shape = (2, len(section.study_latencies_s), 2, len(LINK_FILTERS), 2, 3)
    rmses, costs = np.empty(shape), np.empty(shape)
    ideal = np.empty((2, len(LINK_FILTERS), 2, 3))

    def flown(rates: bool, link: DataLink) -> dict[str, np.ndarray]:
        """Errors of range and its rate in the manoeuvre (run, k, 2) by filter."""
        case = settings(scenario, scenario.period_s, rates, link)
        time, found = fly_case(scenario, flight, case, seed, section.study_runs)
        inside = _window(scenario.circuit, "manoeuvre", time)
        return {name: found[name][0][:, inside, :2] for name in LINK_FILTERS}

    for r, rates in enumerate((False, True)):
        best = flown(rates, exact)
        ideal[r] = [[rmse(best[name][:, :, m]) for m in range(2)] for name in LINK_FILTERS]
        for a, age in enumerate(section.study_latencies_s):
            for k, known in enumerate((False, True)):
                told = {"assumed_latency_s": age if known else 0.0, "assumed_quantised": known}
                errors = flown(rates, exact.model_copy(update={"latency_s": age, "quantised": True, **told}))
                for f, name in enumerate(LINK_FILTERS):
                    for m in range(2):
                        rmses[r, a, k, f, m] = rmse(errors[name][:, :, m])
                        costs[r, a, k, f, m] = ratio(errors[name][:, :, m], best[name][:, :, m])
    draft["/link/age"] = np.array(section.study_latencies_s)
    draft["/link/exact_rmse"], draft["/link/rmse"], draft["/link/cost"] = ideal, rmses, costs


def _case(draft: ResultBuilder, label: str, time: np.ndarray, found: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Write time and filters of a case; label: "" for the first, the others are kept with fewer digits."""
    place = f"/cases/{label}" if label else ""
    if label:
        draft[f"{place}/scan_{label}"] = np.arange(time.size)
    draft[f"{place}/time"] = time
    for name, (error, deviation) in found.items():
        draft[f"{place}/filters/{name}/error"] = error.astype(np.float32) if label else error
        draft[f"{place}/filters/{name}/sigma"] = deviation
