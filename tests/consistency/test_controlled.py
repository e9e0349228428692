"""Controlled estimates of landings: unbiased, covered, the same for any batch, and used where they are the narrower."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from navsim.landing.confirmation import filter_outputs
from navsim.landing.controlled import Controls, controls_of, stopping_rule
from navsim.landing.study import Case, LandingStudy, fly_all, result
from navsim.report.controlled_rows import as_good_as
from navsim.report.summary_tables import summary_table
from navsim.results.findings import of
from navsim.results.result import Result
from navsim.runner.batches import Batch, Ensemble
from navsim.runner.control_variates import LEAST_RUNS
from navsim.runner.executor import threads
from tests.helpers import case, load_script

script: Any = load_script("control_variates")
BRIEF = script.SHORT
ASKED = (
    "box={height_m: 0, lateral_m: 3, vertical_m: 4}",
    "requirements=[{what: rms, of: vertical, below_m: 3}, {what: error, of: vertical, at: touchdown, below_m: 3, "
    "share: 0.5}, {what: box, at_most: 0.2}]",
)


@pytest.fixture(scope="module")
def ready() -> Case:
    return case(*BRIEF, *ASKED)


@pytest.fixture(scope="module")
def flown(ready: Case) -> Ensemble:
    return fly_all(ready, 1, 0, 2 * LEAST_RUNS, threads(1), keep="none")


@pytest.fixture(scope="module")
def many(ready: Case) -> Ensemble:
    """Runs of which those of `flown` are none."""
    return fly_all(ready, 2, 0, 4000, threads(1), keep="none")


@pytest.fixture(scope="module")
def made(ready: Case, flown: Ensemble) -> Result:
    return result(ready, flown, 1, keep="none")


def test_the_plain_estimate_of_many_more_runs(ready: Case, made: Result, many: Ensemble) -> None:
    """RMS, means, percentiles, the box: within both intervals together, and within that of the many runs alone by
    little; the RMS ten times narrower than that of the same runs."""
    at = many.per_run("at_height")
    for i, axis in enumerate(("lateral", "along", "vertical")):
        errors = at[:, 0, i]
        for name, plain, deviation in (
            (axis, float(np.sqrt(np.mean(errors**2))), float(np.std(errors**2) / (2.0 * np.sqrt(np.mean(errors**2))))),
            (f"{axis}_mean", float(errors.mean()), float(errors.std())),
        ):
            value, low, high = made[f"/summary/controlled/at/{name}"][0]
            assert low < value < high
            assert abs(plain - value) < 3.5 * np.hypot(deviation / np.sqrt(errors.size), (high - low) / 3.92), name
            assert float(made[f"/summary/controlled/at/{name}_gain"][0]) > 100.0
        share = 100.0 * np.mean(np.abs(errors) <= made[f"/summary/controlled/at/{axis}_percentile"][0, 1, 0])
        assert abs(share - 95.0) < 3.5 * np.sqrt(95.0 * 5.0 * (1.0 / errors.size + 1.0 / (2 * LEAST_RUNS)))
    outside = np.mean((np.abs(many.per_run("at_box")[:, 0][:, [0, 2]]) > [3.0, 4.0]).any(axis=1))
    value, low, high = made["/summary/controlled/box/probability"]
    reach = 3.5 * np.sqrt(outside * (1.0 - outside) / 4000)
    assert low - reach < outside < high + reach


def test_results_take_the_narrower_interval(made: Result) -> None:
    """Requirements, and the errors by which placements are confirmed."""
    asked = made["/summary/requirements/value"]
    np.testing.assert_array_equal(asked[0], made["/summary/controlled/rms/vertical"])
    np.testing.assert_array_equal(asked[2], made["/summary/controlled/box/probability"])
    np.testing.assert_array_equal(made["/summary/requirements/plain_value"][0], made["/summary/rms/vertical"])
    assert asked[1, 0] != pytest.approx(np.mean(np.abs(made["/summary/at/vertical_run"][:, 0]) < 3.0), abs=1e-12)
    outputs = filter_outputs(made)
    assert outputs["vertical"] == made["/summary/controlled/rms/vertical"][0]
    assert outputs["lateral_touchdown_high"] == made["/summary/controlled/at/lateral"][0, 2]
    plain = replace(made, variables={p: v for p, v in made.variables.items() if "controlled" not in p})
    assert filter_outputs(plain)["vertical"] == made["/summary/rms/vertical"][0]


def test_the_table_has_both(made: Result) -> None:
    table = summary_table([("a", made)])
    rows = {str(row.cells[0]).strip(): str(row.cells[1]) for row in table.rows if len(row.cells) > 1}
    assert "equivalent runs" in rows["RMS by control variates (more precise), m"]
    value, low, high = made["/summary/controlled/rms/vertical"]
    shown = [float(each) for each in re.findall(r"\d+\.\d+", rows["vertical, 20 s"])[:3]]
    assert shown == pytest.approx([value, low, high], abs=0.05 * (high - low))  # two digits of half the interval
    assert max(len(f"{name:<40} {text}") for name, text in rows.items() if ", 20 s" in name) <= 80
    assert rows["vertical RMS error before touchdown below 3 m"].endswith("], by control variates")
    plain = [str(row.cells[1]) for row in table.rows if str(row.cells[0]).strip() == "by the runs alone"]
    value, low, high = made["/summary/rms/vertical"]
    assert plain[0].endswith(f": {value:.4g}  [{low:.4g}, {high:.4g}]")
    assert as_good_as(made, 1e4) == "1.3 million"
    assert as_good_as(made, 1e8) == "over 1000 million"
    assert as_good_as(made, 123.0) == "16 000"


def test_the_stop_is_earlier(ready: Case, flown: Ensemble) -> None:
    until = stopping_rule(lambda: ready, "rms_vertical within 1%")
    assert until(flown)
    assert "rms_vertical" in until.words
    few = Ensemble(0, 32)
    few.add(Batch({name: values[:32] for name, values in flown.columns().items()}, {}, {}))
    assert not until(few)


def test_numbers_depend_on_no_batch_and_no_neighbour(ready: Case, flown: Ensemble) -> None:
    study = LandingStudy(ready, 1, "none", ready.first_order)
    parts = [study.batch(0, 3)[0], study.batch(3, 14)[0]]
    for name, values in flown.columns().items():
        np.testing.assert_array_equal(np.concatenate([part[name] for part in parts]), values[:17], err_msg=name)


def test_few_runs_have_none(ready: Case) -> None:
    few = fly_all(ready, 1, 0, 3, threads(1), keep="none")
    assert controls_of(ready, few) is None
    assert not [path for path in result(ready, few, 1, keep="none").variables if "controlled" in path]


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        (("filter.kind=rts",), "smoother"),
        (("imu.vibration={}",), "Monte Carlo"),
        (("filter.gate.probability=0.05",), "rejects good fixes"),
        (("events=[{what: silence, sources: [all], at_s: 2, until_s: 6}]",), "5.0 s without fixes"),
        (  # two satellites and two pseudolites with a clock of their own: five unknowns
            (
                "pseudolites.clock=gps",
                "events=[{what: silence, sources: [R07, R08, R09, R16, R17, R23], at_s: 2, until_s: 6}]",
            ),
            "5.0 s without fixes",
        ),
    ],
)
def test_the_reason_where_there_are_none(settings: tuple[str, ...], why: str) -> None:
    off = case(*(each for each in BRIEF if "kind" not in each), *settings)
    made = result(off, fly_all(off, 1, 0, LEAST_RUNS, threads(1), keep="none"), 1, keep="none")
    assert why in str(made["/summary/controlled/why_none"])
    assert why in "".join(str(row.cells) for row in summary_table([("a", made)]).rows)


def test_errors_far_from_first_order_are_warned_of(ready: Case) -> None:
    """Spoofed satellites draw the fixes away."""
    spoofed = case(*BRIEF, "events=[{what: spoof, sources: [glonass], clock_m: 300, at_s: 3, until_s: 6}]")
    ensemble = fly_all(spoofed, 1, 0, 2 * LEAST_RUNS, threads(1), keep="none")
    found = [one for one in of(result(spoofed, ensemble, 1, keep="none")) if one.name == "far_from_first_order"]
    assert len(found) == 1
    assert "correlation" in found[0].text


def test_a_run_that_is_not_finite_leaves_the_plain_estimate(ready: Case, flown: Ensemble) -> None:
    lost = Ensemble(0, flown.runs)
    columns = {name: values.copy() for name, values in flown.columns().items()}
    columns["at_height"][5] = columns["position_square"][5] = np.nan
    lost.add(Batch(columns, {}, {}))
    controls = Controls(ready, lost)
    assert not controls.rms("vertical").helps
    assert not controls.at_heights()[0][0].rms().helps
    assert not controls.at_heights()[0][0].percentile(0.95).helps


def test_a_wrong_exact_covariance_is_noticed(ready: Case, flown: Ensemble) -> None:
    wrong = replace(ready)
    wrong.__dict__["first_order"] = ready.first_order
    wrong.__dict__["first_order_covariance"] = 3.0 * ready.first_order_covariance
    assert np.isnan(Controls(wrong, flown).rms("vertical").gain)


def test_coverage_in_brief(ready: Case) -> None:
    """60 repeats of 64 landings: 95 % intervals cover in 86 to 100 %, without bias."""
    found = script.covered(ready, 5, 60)
    for name, (covers, off) in found.items():
        assert covers >= 0.86, name
        assert abs(off) < 4.0, name


@pytest.mark.long
@pytest.mark.parametrize("which", range(len(script.COVERAGE)))
def test_coverage(which: int) -> None:
    """400 repeats of the fewest runs: 93 to 97 %, by chance 1.5 % more, and no bias."""
    name, _, settings = script.COVERAGE[which]
    for quantity, (covers, off) in script.covered(script.case(name, *script.SHORT, *settings), 6, 400).items():
        assert 0.915 <= covers <= 0.985, quantity
        assert abs(off) < 4.0, quantity
