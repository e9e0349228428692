"""Ground stations in filter and covariance analysis: errors as large as both say."""

from __future__ import annotations

import numpy as np
import pytest

from navsim.landing.study import covariance_analysis, fly_all
from navsim.runner.executor import threads
from tests.helpers import case, in_brief

ILS = ("azimuth_station.bends_time_s=3", "dme.bends_m=10", "elevation_station.latency_s=0.1")


@pytest.mark.parametrize(("kind", "coupling"), in_brief([("eskf", "tight"), ("tfg", "loose")], 0))
def test_runs_agree_with_filter_and_analysis(kind: str, coupling: str) -> None:
    """400 landings by ILS and DME, without satellites: error over the filter's sigma, and over that of the analysis, of
    each state in the mean of the outputs."""
    brief = ("imu.rate_hz=25", "receiver.rate_hz=1", "duration_s=80", "wind={}")
    flown = case(*brief, *ILS, f"filter.kind={kind}", f"filter.coupling={coupling}", name="landing_ils")
    runs = fly_all(flown, 44, 0, 400, threads())
    analysis = covariance_analysis(flown)
    own = {f"{name}_station_{error}" for name in ("azimuth", "elevation") for error in ("bias", "bends")}
    assert own | {"dme_bias", "dme_bends", "azimuth_station", "elevation_station", "dme"} < set(analysis.sources)
    assert {"azimuth_bias", "azimuth_bends", "elevation_bias", "dme_bias"} < set(flown.states)
    rms = np.sqrt(np.mean(runs["error"] ** 2, axis=0))[5:]
    predicted = np.sqrt(analysis.variance.sum(axis=0) + analysis.mean**2)[5:]
    z = np.sqrt(np.mean((runs["error"] / runs["sigma"]) ** 2, axis=0))[5:]
    followed = len(flown.states) - flown.flight.model.clock_states
    z_of, ratio_of = (np.sqrt(np.mean(x[:, :followed] ** 2, axis=0)) for x in (z, rms / predicted))
    np.testing.assert_allclose(z_of, 1.0, atol=0.07)
    np.testing.assert_allclose(ratio_of, 1.0, atol=0.08)
    squares, weighed = (runs.per_run(f"aided_{name}").sum() for name in ("innovations", "weighed"))
    assert squares / weighed == pytest.approx(1.0, abs=0.02)


def test_bias_without_noise_has_a_budget() -> None:
    """Rounding leaves the mean square of a source a little below 0: its root is 0, not nan."""
    exact = ("azimuth_station={bias_m: 5, noise_m: 1e-3}", "dme={bias_m: 10, noise_m: 0.01}",
             "elevation_station={bias_deg: 0.1, noise_deg: 1e-4, beyond_m: 200}")  # fmt: skip
    analysis = covariance_analysis(case(*exact, "initial_errors.position_m=3000", name="landing_ils"))
    assert (analysis.variance >= 0.0).all()


@pytest.mark.parametrize(("true", "assumed"), [(0.0, 0.4), (0.2, 0.4), (0.4, 0.0)])
def test_the_filter_takes_measurements_as_of_its_own_latency(true: float, assumed: float) -> None:
    """Also where the measurements are in truth not late; none is older than the flight."""
    flown = case(f"dme.latency_s={true}", f"filter.dme={{latency_s: {assumed}}}", "duration_s=20", name="landing_ils")
    aid = next(aid for aid in flown.shared.aids if aid.sensor.name == "dme")
    np.testing.assert_allclose(aid.valid, np.maximum(aid.time + true - assumed, 0.0), atol=1e-12)
