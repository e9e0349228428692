"""Ground stations in filter and covariance analysis: errors as large as both say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from navsim.compiler.lanes import WIDTH
from navsim.integrity import monitoring
from navsim.landing.integrity import count_epochs
from navsim.landing.study import covariance_analysis, fly_all
from navsim.runner.executor import threads
from navsim.simulation.filter_bank import FilterBank
from navsim.simulation.landing import fly_inputs
from navsim.simulation.run_inputs import draw_inputs
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


def test_a_fault_of_a_station_acts_as_the_analysis_predicts_and_alarms() -> None:
    """The same runs with and without a fault of the glide path differ by the mean of the analysis. The test of
    innovations sees 0.5 degrees in all runs, though there is no fix, and nothing without a fault."""
    watched = "integrity={method: chi2, innovations: {window_s: 10, p_fa: 1.0e-6}}"
    brief = ("imu.rate_hz=25", "receiver.rate_hz=1", "duration_s=80", "wind={}", watched)

    def flown(*settings: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        of = case(*brief, *settings, name="landing_ils")
        runs = [of.fly(44, run) for run in range(4)]
        alarms = np.array([(run.monitor_status == monitoring.ALARM).any() for run in runs])
        return np.array([run.error for run in runs]), alarms, covariance_analysis(of).mean

    (error, none, _), (wrong, _, mean) = flown(), flown("elevation_station.faults=[{at_s: 40, error_deg: 0.01}]")
    added, z = (wrong - error).mean(axis=0), slice(2, 3)
    assert np.abs(mean[:, z]).max() > 0.1
    np.testing.assert_allclose(added[:, z], mean[:, z], atol=0.03 * np.abs(mean[:, z]).max())
    _, alarms, _ = flown("elevation_station.faults=[{at_s: 40, error_deg: 0.5}]")
    assert alarms.all()
    assert not none.any()


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


WATCHED = ("imu.rate_hz=20", "receiver.rate_hz=1", "duration_s=45", "wind={}", "events=[]",
           "filter.gate={probability: 0}", "integrity={method: filter, p_constellation: 1.0e-8, p_satellite: 1.0e-7, "
           "exclusion: residual}")  # fmt: skip


@pytest.mark.parametrize(("station", "fault", "until"), in_brief([
    ("azimuth_station", "rate_m_s: 2", 20.0), ("elevation_station", "error_deg: 0.5", 4.0),
    ("dme", "error_m: 1500", 1.0),
], 0))  # fmt: skip
def test_a_faulty_station_is_excluded_and_the_filter_without_it_takes_over(
    station: str, fault: str, until: float
) -> None:
    """By satellites, ILS and DME, with a step or a ramp at 20 s. Nobody is excluded before it. Some time after it runs
    are to the bit those of a filter that never had the station, within the levels of its own monitor."""
    flown = case(*WATCHED, f"{station}.faults=[{{at_s: 20, {fault}}}]", name="landing_ils")
    (run,) = flown.fly_runs(5, 0, WIDTH, measured=False)
    time, names = flown.shared.signals.time, [one.name for one in flown.flight.candidates]
    after = time > 20.0 + until
    assert (run.monitor_status[:, time < 20.0] == monitoring.QUIET).all()
    assert (run.monitor_status[:, after] == monitoring.EXCLUDED).all()
    assert (run.monitor_excluded[:, after] == names.index(station)).all()
    assert (count_epochs(flown, run)["integrity_exclusions"][:, 1:] == 0).all(), "none but right ones"
    assert (run.watched_error < run.monitor_level)[:, after].all()
    bare = replace(flown.flight, watching=None, second_order=False)
    inputs = draw_inputs(bare, 5, range(WIDTH))
    aided = tuple(np.full_like(m, np.nan) if aid.sensor.name == station else m
                  for aid, m in zip(flown.shared.aids, inputs.aided, strict=True))  # fmt: skip
    other = fly_inputs(bare, replace(inputs, aided=aided), WIDTH)
    for name in ("error", "sigma"):
        np.testing.assert_array_equal(getattr(run, name)[:, 1:][:, after], getattr(other, name)[:, 1:][:, after])


def test_an_aircraft_that_its_estimate_steers_goes_on_by_the_rest() -> None:
    """A localizer that the filter takes to be exact, off by 40 m for good: with exclusion the loop closes, and the
    aircraft comes back; without it the aircraft follows the localizer."""
    exact, lateral = "azimuth_station={noise_m: 1, faults: [{at_s: 10, error_m: 40}]}", []
    for rule in ("residual", "none"):
        more = exact, "approach.guidance=estimate", f"integrity.exclusion={rule}"
        flown = case(*WATCHED, *more, name="landing_ils")
        (run,) = flown.fly_runs(5, 0, WIDTH, measured=False)
        assert run.loop_gap.max() <= 0.01
        lateral.append(run.deviation[:, -1, 0])
    spared, misled = lateral
    print(spared, misled)
    assert np.abs(spared).max() < 3.0
    assert misled.mean() < -50.0


BOUNDS = {"azimuth_station": ("m", 8.0), "elevation_station": ("deg", 0.03), "dme": ("m", 60.0)}
"""Biases of stations and the units of their keys."""


@pytest.mark.parametrize("station", list(BOUNDS))
def test_levels_allow_for_as_much_as_a_bias_moves_the_filter(station: str) -> None:
    """The bound of a station's bias, in levels, is how far two flights are apart of which one has that bias, which its
    filter does not know; a filter without the station has none of it."""
    unit, size = BOUNDS[station]
    watched = tuple(one for one in WATCHED if not one.startswith("integrity"))
    monitor = "integrity={method: filter, p_constellation: 1.0e-8, p_satellite: 1.0e-7"
    others = ", b_nom_m: 0, b_nom_beacon_m: 0}"
    plain = case(*watched, monitor + others, name="landing_ils")
    bounded = case(*watched, f"{monitor}, b_nom_{station}_{unit}: {size}{others}", name="landing_ils")
    biased = case(*watched, monitor + others, f"{station}.faults=[{{error_{unit}: {size}}}]", name="landing_ils")
    runs = [next(iter(one.fly_runs(5, 0, WIDTH, measured=False))).error[:, 1:, :3] for one in (biased, plain)]
    moved = np.abs(runs[0] - runs[1]).mean(axis=0)
    bank, bare = bounded.flight.bank, plain.flight.bank
    assert isinstance(bank, FilterBank)
    assert isinstance(bare, FilterBank)
    of = bank.found.spread.bias[:, [1, 0, 2]]
    largest = moved.max(axis=0)
    some = largest > 0.02 * largest.max()
    np.testing.assert_allclose(of[:, some], moved[:, some], rtol=0.03, atol=0.02 * largest.max())
    without = [fault.name for fault in bounded.flight.expected].index(station)
    np.testing.assert_array_equal(bank.found.spread.separate_bias[without], 0.0)
    assert not bare.found.spread.bias.any()
    np.testing.assert_array_less(bare.levels[5:], bank.levels[5:])
