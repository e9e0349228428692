"""Corrections of a GBAS ground station: their errors, B values and levels, against plain numpy."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from navsim.geodesy.earth import llh_from_ecef, ned_matrix
from navsim.gnss.ground_accuracy import Designator, GroundStationError
from navsim.integrity.gbas_station import StationLevels
from navsim.integrity.sbas_gbas import gbas_factors
from navsim.landing.study import Case
from navsim.results.result import read
from navsim.scenario_files.source import InputError
from navsim.simulation.landing import fly_inputs
from navsim.simulation.measurements import correlated_errors, generators
from navsim.simulation.run_inputs import draw_inputs
from tests.conftest import Within
from tests.helpers import SCENARIOS, case
from tests.layout import as_declared
from tests.product.test_run import navsim

RUNS = range(4)
RANGES = (
    "signals={range_sigma_m: 0.4, range_law: constant, errors: {ground_station: "
    "{receivers: 4, accuracy_designator: C, correlation_time_s: 100}}}"
)
SERVED = "integrity={comparison: {gbas: {approach_service: D}}}"
THREE = "signals.errors.ground_station.receivers=3"
GPS_C = {"above 35": (0.15, 0.84, 15.5, 0.04), "below": (0.24, 0.0, 15.5, 0.04)}
GLONASS_C = {"above 35": (0.3, 1.68, 15.5, 0.042), "below": (0.48, 0.0, 15.5, 0.042)}


@cache
def served(*assignments: str) -> Case:
    return case(
        "duration_s=40", "imu.rate_hz=10", "receiver.rate_hz=1", "receiver.smoothing_s=30", "sky.source=nominal",
        "pseudolites.count=0", "filter.kind=eskf", RANGES, SERVED,
        *assignments,
    )  # fmt: skip


def station(c: Case) -> StationLevels:
    assert c.flight.station is not None
    return c.flight.station


def errors_of_receivers(c: Case) -> np.ndarray:
    """1 sigma (e, s) of a receiver's own error, by the tables."""
    elevation, out = np.degrees(c.shared.signals.elevation), np.empty(c.shared.signals.used.shape)
    for i, name in enumerate(c.shared.signals.names):
        table = GPS_C if name.startswith("G") else GLONASS_C
        for e, angle in enumerate(elevation[:, i]):
            a0, a1, scale, _ = table["above 35" if angle > 35.0 else "below"]
            out[e, i] = a0 + a1 * math.exp(-angle / scale)
    return out


@pytest.mark.validates("Sigma of GBAS ground accuracy designators", "ICAO Annex 10, tables B-74 and B-75",
                       sigma="1e-12 m")  # fmt: skip
def test_the_tables_of_ground_accuracy(within: Within) -> None:
    """Means of M receivers with what they have in common; below 5 degrees as at 5."""
    angle = np.radians([[0.0, 20.0, 35.0, 35.01, 90.0]])
    clear: dict[Designator, tuple[float, float, float, float]] = {
        "A": (0.5, 1.65, 14.3, 0.08), "B": (0.16, 1.07, 15.5, 0.08), "C": GPS_C["above 35"],
    }  # fmt: skip
    for name, (a0, a1, scale, a2) in clear.items():
        wanted = np.sqrt((a0 + a1 * np.exp(-np.array([5.0, 20.0, 35.0, 35.01, 90.0]) / scale)) ** 2 / 3 + a2**2)
        if name == "C":
            wanted[:3] = math.sqrt(0.24**2 / 3 + 0.04**2)
        found = GroundStationError(3, name, 100.0).at(angle, ("gps",) * 5)[0]
        np.testing.assert_allclose(found, wanted, rtol=0.0, atol=within["sigma"])
    a, b = (GroundStationError(2, name, 1.0).at(angle, ("glonass",) * 5)[0, 4] for name in ("A", "B"))
    assert a == pytest.approx(math.sqrt((1.58 + 5.18 * math.exp(-90 / 14.3)) ** 2 / 2 + 0.078**2), abs=1e-12)
    assert b == pytest.approx(math.sqrt((0.3 + 2.12 * math.exp(-90 / 15.5)) ** 2 / 2 + 0.078**2), abs=1e-12)


def test_drawn_errors_have_the_sizes_of_the_tables() -> None:
    """Over runs: the error of a correction, that of RMSpr_gnd; a B value, that of r / sqrt(M (M - 1)). What the
    correlation time leaves after 39 s is in both."""
    c, runs = served(), range(600)
    signals = c.shared.signals
    assert signals.correlated is not None
    drawn = correlated_errors(c.shared, 1, runs)
    assert drawn is not None
    correction = signals.correlated.sigma[0, [0, -1]][..., None] * drawn[0, [0, -1]]
    b = station(c).b_values(generators(1, runs, "lasting", len(runs), 1))[[0, -1]]
    np.testing.assert_allclose(b.sum(axis=2), 0.0, atol=1e-12)
    used, own = signals.used[[0, -1]], errors_of_receivers(c)[[0, -1]]
    common = np.array([0.04 if name.startswith("G") else 0.042 for name in signals.names])
    chance = 4.5 / math.sqrt(2 * len(runs))
    for found, wanted in (
        (correction.std(axis=2), np.sqrt(own**2 / 4 + common**2)), (b[:, :, 1].std(axis=2), own / math.sqrt(12)),
    ):  # fmt: skip
        np.testing.assert_allclose(found[used], wanted[used], rtol=chance)
    for first, last in (correction, b[:, :, 1]):
        there = used.all(axis=0)
        kept = np.mean(first[there] * last[there], axis=1) / (first[there].std(axis=1) * last[there].std(axis=1))
        np.testing.assert_allclose(kept, math.exp(-0.39), atol=4.5 / math.sqrt(len(runs)))
        assert abs(np.mean(kept) - math.exp(-0.39)) < 4.0 / math.sqrt(len(runs) * there.sum())
    one, other = (each[0][used[0]] for each in (correction, b[:, :, 1]))
    both = np.mean(one * other, axis=1) / (one.std(axis=1) * other.std(axis=1))
    assert np.abs(both).max() < 4.5 / math.sqrt(len(runs))


@pytest.mark.validates("GBAS levels by random B values, D_L and D_V", "plain numpy, normal equations and recursions",
                       levels="1e-9 m")  # fmt: skip
def test_levels_of_runs(within: Within) -> None:
    """H0 and H1 with the drawn B values, and the difference of two smoothings, epoch by epoch."""
    c = served()
    signals, inputs = c.shared.signals, draw_inputs(c.flight, 7, RUNS)
    assert inputs.b_values is not None
    assert inputs.phases is not None
    found = fly_inputs(c.flight, inputs, len(RUNS)).station
    own, course, slope = errors_of_receivers(c), math.radians(c.scenario.runway.heading_deg), math.tan(math.radians(5))
    common = np.array([0.04 if name.startswith("G") else 0.042 for name in signals.names])
    across = [-math.sin(course), math.cos(course), 0.0]
    axes = np.array([across, [math.cos(course) * slope, math.sin(course) * slope, -1.0]])  # of north, east, down
    k_free, k_missed = gbas_factors(4)
    memory = {30: np.zeros(len(signals.names)), 100: np.zeros(len(signals.names))}
    count = np.zeros(len(signals.names))
    for e in range(signals.time.size):
        heard = signals.used[e]
        north = ned_matrix(llh_from_ecef(signals.antenna[e]))
        away = (signals.position[e, heard] - signals.antenna[e]) @ north.T
        clocks = signals.time_scale[heard, None] == np.unique(signals.time_scale[heard])
        h = np.hstack([-away / np.linalg.norm(away, axis=1)[:, None], clocks.astype(float)])
        sigma = signals.fix_sigma[e, heard]
        s = axes @ np.linalg.solve(h.T @ (h / sigma[:, None] ** 2), h.T / sigma**2)[:3]
        ground = own[e, heard] ** 2 / 4 + common[heard] ** 2
        count = np.where(heard, count + 1, 0)
        for lane in RUNS:
            b = inputs.b_values[e, heard, :, lane]
            free = k_free * np.sqrt(s**2 @ sigma**2)
            missed = np.abs(s @ b).max(axis=1) + k_missed * np.sqrt(s**2 @ (sigma**2 + ground / 3))
            if lane == 0:
                code, phase = inputs.ranges[..., 0], inputs.phases[..., 0]
                for most in memory:
                    n = np.minimum(np.maximum(count, 1), most)
                    ahead = memory[most] + (phase[e] - phase[e - 1] if e else 0.0)
                    memory[most] = np.where(n > 1, code[e] / n + (1 - 1 / n) * ahead, code[e])
                gap = np.abs(s @ (memory[30] - memory[100])[heard])
                np.testing.assert_allclose(found[0, e, 6:], gap, rtol=0.0, atol=within["levels"])
            level = np.maximum(free, missed) + found[lane, e, 6:]
            np.testing.assert_allclose(found[lane, e, 4:6], np.abs(s @ b).max(axis=1), rtol=0.0, atol=within["levels"])
            np.testing.assert_allclose(found[lane, e, :2], level, rtol=0.0, atol=within["levels"])
    assert found[0, :30, 6:].max() < 1e-9 < found[0, 30:, 6:].min()


def test_a_faulty_reference_receiver() -> None:
    """A step of 30 m in one receiver of four moves the range by 7.5 m; its B value by as much, those of the others by a
    third of that against it. Errors exceed the fault-free level, and never that with B values."""
    c, runs = served(), range(8)
    i = int(np.abs(station(c).projection[:, 1].min(axis=0)).argmax())
    name = c.shared.signals.names[i]
    faulty = served(f"events=[{{what: step, sources: [{name}], error_m: 30, at_s: 20, reference_receiver: 2}}]")
    clean, wrong = draw_inputs(c.flight, 3, runs), draw_inputs(faulty.flight, 3, runs)
    assert clean.b_values is not None
    assert wrong.b_values is not None
    moved, b = wrong.ranges - clean.ranges, wrong.b_values - clean.b_values
    later = c.shared.signals.time >= 20.0
    np.testing.assert_allclose(moved[:, i].T, np.where(later, 7.5, 0.0) + np.zeros((len(runs), 1)), atol=1e-6)
    np.testing.assert_allclose(b[later, i, 1], 7.5, atol=1e-9)
    np.testing.assert_allclose(b[later][:, i, [0, 2, 3]], -2.5, atol=1e-9)
    assert np.abs(np.delete(b, i, axis=1)).max() == 0.0
    after = fly_inputs(faulty.flight, wrong, len(runs)).station[:, later]
    assert (after[..., 3] > station(faulty).fault_free()[later, 1]).all()
    assert (after[..., :2] > after[..., 2:4]).all()


@pytest.mark.parametrize(
    ("assignments", "message"),
    [
        (("signals={preset: sbas}",), "draws B values of signals.errors.ground_station: give it, or receivers"),
        (("receiver.smoothing_s=0",), "give receiver.smoothing_s: 30"),
        (("integrity={comparison: {gbas: {receivers: 4, b_m: 1}}}",), "ground_sigma_m: is missing"),
        (
            (THREE, "events=[{what: step, sources: [gps], error_m: 6, reference_receiver: 4}]"),
            "is none of the 3 reference",
        ),
        (("events=[{what: step, sources: [all], error_m: 6, reference_receiver: 1}]",), "name some, or their system"),
        (("sky.systems=[gps, galileo]",), "is for gps and glonass, and the sky has galileo"),
    ],
)
def test_stations_that_cannot_be(assignments: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as caught:
        served(*assignments)
    assert message in "; ".join(map(str, caught.value.problems))


def test_the_result_has_what_runs_drew(tmp_path: Path) -> None:
    """Levels, errors, effects of B values and D values by run, and their counts on the glide."""
    brief = ("duration_s=20", "imu.rate_hz=10", "receiver.rate_hz=1", "receiver.smoothing_s=30", "pseudolites.count=0",
             "sky.source=nominal", "filter.kind=eskf", RANGES, SERVED)  # fmt: skip
    settings = (part for one in brief for part in ("--set", one))
    options = ("--runs", 3, "--figures", "none", "-o", "a.h5")
    shown = navsim("run", SCENARIOS / "landing.yaml", *settings, *options, cwd=tmp_path).stdout
    result = read(tmp_path / "a.h5")
    as_declared(result)
    levels = result["/integrity/gbas_vpl_run"]
    assert levels.shape == (3, 20)
    assert (levels >= result["/integrity/gbas_vpl"] + result["/integrity/gbas_d_vertical"] - 1e-12).all()
    assert result["/summary/integrity/gbas_vpl_run"][0] == pytest.approx(levels.mean(), rel=1e-12)
    beyond = (result["/integrity/gbas_error_vertical"] > levels).mean()
    assert result["/summary/integrity/gbas_exceeded_vertical"][0] == beyond
    assert f"VPL by B values, mean of a run         {levels.mean():.2f}" in shown
