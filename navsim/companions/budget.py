"""Estimates of the companion papers' systems."""

from __future__ import annotations

from navsim.companions.atc import study as atc
from navsim.companions.atc.scenario import Atc
from navsim.companions.azimuth import study as azimuth
from navsim.companions.azimuth.scenario import Azimuth
from navsim.companions.elevation import study as elevation
from navsim.companions.elevation.scenario import Elevation
from navsim.runner.estimate import BASE_MEMORY, NUMBER, VARIABLE, WRITING, Budget

_COVARIANCE_STEPS = 600
"""Steps of a run of the elevation filter that take as long as one of its covariance with that of its true errors."""
_AZIMUTH_MEMORY = 850
"""A scan of a run of the azimuth scenario: draws, reports, ten filters' histories, bytes."""


def mls_elevation(scenario: Elevation, runs: int | None = None) -> Budget:
    """The elevation filter; runs: of each experiment, instead of the scenario's."""
    section = scenario.montecarlo
    n = 3 if scenario.filter.model == "singer" else 2
    flown = (runs or section.runs) * section.steps
    nominal, filters = scenario.nominal_steps, len(scenario.nominal.rate_variances_deg2_s2)
    orders = len(elevation.ORDERS) + len(scenario.nominal.first_order_variances_deg2)
    azimuth_, azimuth_filters = scenario.azimuth_steps, len(scenario.azimuth.rate_variances_deg2_s2)
    flare = elevation.flare_steps(scenario)
    flares = len(elevation.FLARE_SOURCES) * len(scenario.flare.rate_variances_deg2_s2)
    kept = nominal * (2 + 2 * filters) + nominal * (1 + 2 * orders) + azimuth_ * (2 + 2 * azimuth_filters)
    kept += flare * (5 + 2 * flares)
    steps = section.steps * (1 + 3 * n * n + 2 * n) + 4 * section.experiments
    result = NUMBER * (steps + kept + 4300) + 84 * VARIABLE
    # covariances are made one filter after the other
    memory = flown * (n + 3) + section.steps * 8 * n * n + kept + max(nominal, azimuth_, flare) * (4 * n * n + 8)
    return Budget(BASE_MEMORY + NUMBER * memory + WRITING * result, result)


def mostly_experiments(scenario: Elevation, runs: int | None = None) -> bool:
    """Whether a block of the experiments predicts the time of the whole elevation study.

    Later work takes a third of their time at most.
    """
    section = scenario.montecarlo
    filters = len(scenario.nominal.rate_variances_deg2_s2) + len(elevation.ORDERS)
    covariances = scenario.nominal_steps * (filters + len(scenario.nominal.first_order_variances_deg2))
    covariances += scenario.azimuth_steps * len(scenario.azimuth.rate_variances_deg2_s2)
    flares = len(elevation.FLARE_SOURCES) * len(scenario.flare.rate_variances_deg2_s2)
    covariances += elevation.flare_steps(scenario) * flares
    return 3 * _COVARIANCE_STEPS * covariances < section.experiments * (runs or section.runs) * section.steps


def atc_tracking(scenario: Atc, runs: int | None = None) -> Budget:
    """Range and angles; runs: instead of the scenario's."""
    count = atc.run_count(scenario, runs)
    numbers = sum(atc.states_of(name) for name in atc.FILTERS)
    periods = [scenario.period_s, *(case.period_s for case in scenario.further_cases)]
    scans = [scenario.circuit.scans(period) for period in periods]
    # the first case is stored in double precision, the others in single precision
    errors = [count * numbers * k * (NUMBER if i == 0 else NUMBER // 2) for i, k in enumerate(scans)]
    deviations = NUMBER * sum(k * (numbers + 2) for k in scans)
    result = sum(errors) + deviations + NUMBER * count + 18_000 + (22 + 11.5 * len(scans)) * VARIABLE
    # the study of the data link flies the first case with exact reports, then by age, unknown and known
    study_runs = scenario.link.study_runs if atc.linked(scenario) else 0
    ages = len(scenario.link.study_latencies_s)
    result += NUMBER * 100 * (1 + ages) + 7 * VARIABLE
    present = max([NUMBER * count * numbers * k for k in scans] + [NUMBER * study_runs * numbers * scans[0]])
    return Budget(
        BASE_MEMORY + present + (1.0 + WRITING) * result + _circuit_memory(scenario.circuit.duration_s),
        result,
    )


def azimuth_tracking(scenario: Azimuth, runs: int | None = None) -> Budget:
    """Azimuth with and without reports; runs: instead of the scenario's."""
    count = azimuth.run_count(scenario, runs)
    scans = [scenario.circuit.scans(period) for period in (scenario.period_s, *scenario.further_periods_s)]
    every = len(azimuth.FILTERS) + len(azimuth.SOURCES)
    filters = [every if i == 0 else len(azimuth.FILTERS) for i in range(len(scans))]
    errors = NUMBER * sum(k * f * (count + 1) for k, f in zip(scans, filters, strict=True))
    truth = NUMBER * 9 * (1 + int(scenario.circuit.duration_s * 10.0))
    result = errors + NUMBER * (2 * sum(scans) + count) + truth + 3000 + (32 + 17.5 * len(scans)) * VARIABLE
    present = count * max(scans)
    if azimuth.mapped(scenario):
        section = scenario.map
        of_map = [section.runs * scenario.circuit.scans(period) for period in section.periods_s]
        present = max(present, *of_map)
    return Budget(
        BASE_MEMORY + present * _AZIMUTH_MEMORY + WRITING * result + _circuit_memory(scenario.circuit.duration_s),
        result,
    )


def _circuit_memory(duration: float) -> float:
    """The true circuit, in hundredths of a second, bytes."""
    return duration * 100.0 * 40 * NUMBER
