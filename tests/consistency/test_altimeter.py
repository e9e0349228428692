"""An altimeter beside the receiver: the second kind of measurement, in filter, smoother and covariance analysis."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.filter import records, states
from navsim.filter.estimate import estimate
from navsim.filter.measurement_kinds import ALTITUDE, FIX, AltitudeTable, Measurements
from navsim.landing.study import covariance_analysis, fly_all
from navsim.results.findings import of
from navsim.results.result import read
from navsim.runner.executor import threads
from navsim.scenario_files.source import InputError
from navsim.simulation.aiding import aids_of
from navsim.simulation.flight import exact_start
from tests.conftest import SCENARIOS
from tests.helpers import case, in_brief, outputs_at, ratios
from tests.layout import as_declared
from tests.product.test_run import navsim

GENTLE = ("imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1", "receiver.rate_hz=1", "duration_s=60")
DOWN, DOWN_RATE = states.R_D, states.V_D


@pytest.mark.parametrize(
    "settings",
    in_brief(
        [
            ("altimeter={sigma_m: 0.5}",),
            ("altimeter={sigma_m: 0.5, rate_hz: 4, believed_sigma_m: 1.5}", "receiver.latency_s=0.3"),
            ("altimeter={sigma_m: 2, offset_m: 1.5}", "receiver.smoothing_s=20", "filter.gate.probability=0"),
        ],
        0,
        whole=True,
    ),
    ids=["as believed", "late fixes, believed worse", "offset, smoothed code"],
)
def test_runs_agree_with_the_analysis(settings: tuple[str, ...]) -> None:
    """Every component of position and velocity at every 10 s: 400 runs within 16 % (4.5 sigma of the sampling)."""
    flown = case(*GENTLE, *settings)
    runs = fly_all(flown, 5, 0, 400, threads())
    analysis = covariance_analysis(flown)
    assert analysis.sources[-1] == "altimeter"
    ratio = ratios(runs, analysis, outputs_at(flown, range(10, 61, 10)))
    assert np.all(np.abs(ratio - 1.0) < 0.16), ratio
    without = covariance_analysis(case(*GENTLE, *settings[1:]))
    believed = np.sqrt(np.diagonal(analysis.assumed, axis1=1, axis2=2))[:, DOWN]
    assert np.all(believed[1:] < np.sqrt(without.assumed[1:, DOWN, DOWN]))


def test_its_budget_is_what_it_does_alone() -> None:
    """With ten times its noise, in the truth alone, its share of the budget grows tenfold and no other changes."""
    small = covariance_analysis(case(*GENTLE, "altimeter={sigma_m: 0.5, believed_sigma_m: 2}")).variance
    large = covariance_analysis(case(*GENTLE, "altimeter={sigma_m: 5, believed_sigma_m: 2}")).variance
    np.testing.assert_allclose(large[-1], 100.0 * small[-1], rtol=1e-9)
    np.testing.assert_array_equal(large[:-1], small[:-1])


HEIGHTS = {
    "altimeter": ("altimeter={sigma_m: 0.5, rate_hz: 2}",),
    "radio and barometric": (
        "radio_altimeter={sigma_floor_m: 0.3, latency_s: 0.1, rate_hz: 2}",
        "barometric_altimeter={sigma_m: 0.8, rate_hz: 2}",
        "runway.geoid_undulation_m=15.5",
    ),
}


@pytest.mark.parametrize("aids", in_brief(HEIGHTS.values(), 1, whole=True), ids=HEIGHTS)
@pytest.mark.parametrize("kind", [pytest.param("rts", marks=pytest.mark.long), "map"])
def test_smoothers_use_it_and_stay_true(kind: str, aids: tuple[str, ...]) -> None:
    flown = case(*GENTLE, *aids, f"filter.kind={kind}")
    runs = fly_all(flown, 6, 0, 120, threads())
    nees = runs["nees_position_velocity"].mean(axis=0) / 6
    assert 0.85 < nees[5:].mean() < 1.2, nees
    filtered = fly_all(case(*GENTLE, *aids), 6, 0, 120, threads())
    late = slice(10, 50)
    assert np.mean(runs["error"][:, late, DOWN] ** 2) < 0.9 * np.mean(filtered["error"][:, late, DOWN] ** 2)


def test_heights_alone_are_a_straight_line_fit() -> None:
    """Perfect sensors and nothing but heights: the filter's sigmas of height and climb are those of least squares
    (but for gravity, which falls with height: 3e-4)."""
    flown = case("imu.preset=perfect", "duration_s=20")
    world = flown.shared
    time = np.arange(1.0, 11.0)
    n, declared = states.N_BASE, states.declared(states.biases())
    p = np.diag(np.repeat([10.0, 1.0, 1e-9, 1e-12, 1e-12], 3) ** 2)
    table = AltitudeTable(world.truth.llh[[round(t * 100) for t in time], 2], np.full(time.size, 0.25))
    history = estimate(
        records.ImuData(world.imu_time, world.dtheta.copy(), world.dv.copy()),
        Measurements.of({ALTITUDE: table}),
        records.schedule(time, (ALTITUDE, time, time)),
        records.start(exact_start(world.at_filter), p),
        records.FilterModel(records.ESKF, np.zeros((1, 2)), declared, np.full(7, np.inf), 0),
    )
    assert history.covariance.shape == (time.size, n, n)
    information = np.diag([1.0 / 100.0, 1.0])
    for i, t in enumerate(time):
        row = np.array([1.0, t])
        information += np.outer(row, row) / 0.25
        there = np.array([[1.0, t], [0.0, 1.0]])
        expected = there @ np.linalg.inv(information) @ there.T
        found = history.covariance[i][np.ix_([DOWN, DOWN_RATE], [DOWN, DOWN_RATE])]
        np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_result_and_budget_name_it(tmp_path: Path) -> None:
    brief = ("--set", "duration_s=20", "--set", "altimeter={sigma_m: 0.5, rate_hz: 5}", "--figures", "none", "-q")
    navsim("run", SCENARIOS / "landing.yaml", *brief, "--runs", 3, "--keep", "all", "-o", "a.h5", cwd=tmp_path)
    result = read(tmp_path / "a.h5")
    as_declared(result)
    measured = result["/aiding/altimeter/measured"]
    assert measured.shape == (3, 100, 1)
    height = np.interp(result["/aiding/altimeter/time"], result["/truth/time"], result["/truth/position_llh"][:, 2])
    assert np.std(measured[:, :, 0] - height) == pytest.approx(0.5, rel=0.15)
    assert set(np.unique(result["/aiding/altimeter/status"])) == {1}
    assert 0.7 < float(result["/summary/aiding/altimeter/nis"]) < 1.3
    scales = ("--set", "imu.gyro.scale_ppm=500", "--set", "imu.accelerometer.scale_ppm=500")
    method = (*scales, "--set", "filter.scale_factors=true", "--method", "covariance", "-o", "c.h5", "--figures", ".")
    navsim("run", SCENARIOS / "landing.yaml", *brief, *method, cwd=tmp_path)
    assert (tmp_path / "c_budget.png").exists(), "every source has its colour and hatch"
    analysed = read(tmp_path / "c.h5")
    assert list(analysed["/budget/source"][-2:]) == ["altimeter", "systematic"]


def test_live_says_that_it_cannot_take_it(tmp_path: Path) -> None:
    said = navsim(
        "live", SCENARIOS / "landing.yaml", "--set", "altimeter={}", "--receiver", "-", cwd=tmp_path, code=2
    ).stderr
    assert "altimeter" in said


def test_wrong_heights_are_found_and_said(tmp_path: Path) -> None:
    """Heights 100 m off, and heights far noisier than believed: what they are, by runs and by analysis, refused."""
    command = ("run", SCENARIOS / "landing.yaml", "--figures", "none", "-q", "--set", "duration_s=10")
    off = ("--set", "altimeter={sigma_m: 10, believed_sigma_m: 1}")
    for more in (off, (*off, "--runs", 3), (*off, "--method", "covariance"), ("--set", "altimeter.offset_m=100")):
        name = tmp_path / "r.h5"
        said = navsim(*command, *more, "--require-consistent", "--force", "-o", name, cwd=tmp_path, code=3).stderr
        assert "of the altimeter" in said
        assert {"aided_innovations", "aided_rejections"} & {finding.name for finding in of(read(name))}


def test_wrong_heights_are_rejected_and_fixes_are_not() -> None:
    """Each kind of measurement is counted by itself: fifty heights in a row, 200 m off, and not a fix among them."""
    flown = case(*GENTLE, "altimeter={sigma_m: 0.5, offset_m: 200}", "filter.gate.max_rejected=50")
    run = flown.fly(1, 0)
    # fixes are used in between, which does not interrupt the count of heights
    assert np.all(run.aided_status[:50] == records.REJECTED)
    assert run.aided_status[50] == records.USED
    assert np.all(run.status[:5] == records.USED)
    waiting = ("altimeter={sigma_m: 0.5, offset_m: 200}", "filter.gate.max_rejected=100000", "receiver.latency_s=0.5")
    late = case(*GENTLE, *waiting)
    run = late.fly(1, 0)
    assert np.all(run.aided_status == records.REJECTED)
    assert np.all(run.status == records.USED)
    without = case(*GENTLE, "receiver.latency_s=0.5").fly(1, 0)
    assert np.sqrt(np.mean(run.error[20:, DOWN] ** 2)) < 2.0 * np.sqrt(np.mean(without.error[20:, DOWN] ** 2)) + 0.5


def test_fixes_on_the_copy_that_runs_ahead_are_analysed() -> None:
    """A filter that believes its fixes older than the flight has them on its copy alone at first."""
    settings = (*GENTLE[:2], "duration_s=12", "receiver.rate_hz=2", "filter.latency_s=2", "filter.gate.probability=0")
    for more in ((), ("receiver.smoothing_s=5",)):
        flown = case(*settings, *more)
        events = flown.flight.events
        assert np.any(events.ahead & (events.kind == FIX))
        analysis = covariance_analysis(flown)
        runs = fly_all(flown, 7, 0, 300, threads())
        ratio = ratios(runs, analysis, [*range(1, 6)])[:, :2]
        assert np.all(np.abs(ratio - 1.0) < 0.2), ratio


def test_a_late_fix_leaves_the_start_as_it_is() -> None:
    """A filter that waits is at its start until then: a Markov bias does not decay before the flight."""
    markov = ("imu.gyro.drift_deg_h=0", "imu.gyro.markov_deg_h=100", "imu.gyro.markov_time_s=2", "duration_s=20")
    begun = [covariance_analysis(case(*GENTLE[1:3], *markov, f"receiver.latency_s={late}")) for late in (0, 1)]
    np.testing.assert_allclose(begun[1].variance[:, 0], begun[0].variance[:, 0], rtol=1e-12)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (("altimeter.rate_hz=100", "imu.rate_hz=10", "receiver.rate_hz=1"), "imu.rate_hz"),
        (("altimeter.rate_hz=0.1", "duration_s=5"), "nothing within"),
        (("filter.scale_factors=true",), "scale_ppm"),
        (("filter.imu={gyro: {scale_ppm: 3}}",), "scale_factors"),
    ],
)
def test_what_would_do_nothing_is_refused(settings: tuple[str, ...], said: str) -> None:
    with pytest.raises(InputError) as caught:
        case(*settings)
    assert said in str(caught.value.problems[0])


def test_two_of_a_kind_are_refused() -> None:
    flown = case("altimeter={}")
    (model,) = flown.scenario.aiding()
    with pytest.raises(ValueError, match="two of a kind"):
        aids_of([model, model], flown.trajectory, 20.0, 100.0)
