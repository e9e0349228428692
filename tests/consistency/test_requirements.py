"""Verdicts on requirements: by intervals, of every method, and what more runs would do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.landing.integrity import glide_of
from navsim.landing.requirements import MET, NOT_MET, UNDECIDED, RequirementValue, _of_shares
from navsim.results.result import Result, read
from navsim.runner.statistics import rms_interval_of_means, share_interval
from navsim.scenario.integrity import LimitsSection
from navsim.scenario.requirements import PresetRequirement, RiskRequirement
from navsim.trajectory.go_around import GO_AROUND
from tests.helpers import SCENARIOS, case, in_brief, scenario
from tests.layout import as_declared
from tests.product.test_run import navsim

WATCHED = "integrity={method: chi2, p_fa: 1.0e-2, limits: {hal_m: 60, val_m: 90, tta_s: 1}}"


@pytest.mark.parametrize(
    ("value", "limit", "least", "verdict"),
    [
        ((0.5, 0.4, 0.6), 0.6, False, MET),
        ((0.5, 0.4, 0.6), 0.59, False, UNDECIDED),
        ((0.5, 0.4, 0.6), 0.4, False, UNDECIDED),
        ((0.5, 0.4, 0.6), 0.39, False, NOT_MET),
        ((0.5, 0.4, 0.6), 0.4, True, MET),
        ((0.5, 0.4, 0.6), 0.41, True, UNDECIDED),
        ((0.5, 0.4, 0.6), 0.61, True, NOT_MET),
        ((0.5, np.nan, np.nan), 0.1, True, UNDECIDED),
        ((np.nan, np.nan, np.nan), 0.1, False, UNDECIDED),
    ],
)
def test_verdicts(value: tuple[float, ...], limit: float, least: bool, verdict: str) -> None:
    assert RequirementValue("", np.array(value), limit, least).verdict() == verdict


@pytest.mark.parametrize(("count", "runs", "limit", "least"), [(93, 100, 0.95, True), (0, 50, 1e-3, False)])
def test_more_runs_of_a_share_decide(count: int, runs: int, limit: float, least: bool) -> None:
    """As many as are told; a count is whole, so about as many."""
    found = RequirementValue(
        "", share_interval(count, runs), limit, least, lambda n: share_interval(round(count / runs * n), n)
    )
    more = found.more(runs)
    total = runs + round(more)
    assert found.verdict(share_interval(round(count / runs * total), total)) != UNDECIDED
    fewer = runs + round(0.85 * more)
    assert found.verdict(share_interval(round(count / runs * fewer), fewer)) == UNDECIDED


def test_more_runs_of_a_root_mean_square() -> None:
    squares = np.array([0.05, 0.04])
    found = RequirementValue(
        "", rms_interval_of_means(squares, 30), 0.31, with_runs=lambda n: rms_interval_of_means(squares, n)
    )
    more = found.more(30)
    assert rms_interval_of_means(squares, 30 + round(more))[2] <= 0.31 < rms_interval_of_means(squares, 30)[2]
    # exactly what is asked for is never decided
    at_the_edge = RequirementValue(
        "", np.array([0.3, 0.2, 0.4]), 0.3, with_runs=lambda n: np.array([0.3, 0.3 - 1 / n, 0.3 + 1 / n])
    )
    assert np.isnan(at_the_edge.more(10))


def flown(folder: Path, requirements: list[dict[str, Any]], *options: object, code: int = 0) -> tuple[Result, str]:
    brief = ("duration_s=70", "receiver.rate_hz=2", "filter.kind=eskf", "box={lateral_m: 0.5}", WATCHED)
    settings = [part for key in (*brief, f"requirements={json.dumps(requirements)}") for part in ("--set", key)]
    done = navsim("run", SCENARIOS / "landing.yaml", *settings, *options, "--figures", "none", "-o", "a.h5", cwd=folder,
                  code=code)  # fmt: skip
    result = read(folder / "a.h5")
    as_declared(result)
    return result, done.stdout + done.stderr


ALL: list[dict[str, Any]] = [
    {"what": "error", "of": "lateral", "at": "100ft", "below_m": 0.6, "share": 0.5},
    {"what": "rms", "of": "vertical", "below_m": 5.0},
    {"what": "box", "at_most": 0.4},
    {"what": "level", "of": "vpl", "below_m": 90.0},
    {"what": "approaches", "at_least": 0.9},
    {"what": "availability", "at_least": 0.9},
    {"what": "continuity", "at_most": 1e-6},
    {"what": "misleading", "at_most": 1e-6},
    {"what": "time_to_alert", "within_s": 2},
    {"what": "preset", "operation": "APV-I"},
    {"what": "error", "of": "lateral", "at": "30.48m", "below_m": 0.6, "share": 0.5},
]


def test_runs_are_judged(tmp_path: Path) -> None:
    """Figures are those of the rest of the result; 40 runs of which a hundredth of the fixes alarms."""
    result, said = flown(tmp_path, ALL, "--runs", 40)
    branch = "/summary/requirements"
    values, verdicts = result[f"{branch}/value"], [str(word) for word in result[f"{branch}/verdict"]]
    inside = np.abs(result["/summary/at/lateral_run"][:, 2]) < 0.6
    np.testing.assert_allclose(values[0], share_interval(int(inside.sum()), 40))
    np.testing.assert_array_equal(values[1], result["/summary/rms/vertical"])
    np.testing.assert_array_equal(values[2], result["/summary/box/probability"])
    np.testing.assert_array_equal(values[4], result["/summary/integrity/approaches"])
    np.testing.assert_array_equal(values[5], result["/summary/integrity/availability"])
    np.testing.assert_array_equal(values[6], result["/summary/integrity/continuity_risk"])
    np.testing.assert_array_equal(values[7], result["/summary/integrity/hmi"])
    assert verdicts[:10] == [MET, MET, MET, MET, NOT_MET, MET, NOT_MET, UNDECIDED, UNDECIDED, MET]
    statements = [str(text) for text in result[f"{branch}/statement"]]
    assert statements[9:14] == [
        f"APV-I: {text}"
        for text in (
            "HPL within 40 m at 99 % of epochs of the glide",
            "VPL within 50 m at 99 % of epochs of the glide",
            "P(fault-free vertical error > 20 m) at most 0.05 at 99 % of epochs of the glide",
            "continuity risk in 15 s at most 8e-06",
            "risk of hazardously misleading information at most 2e-07",
        )
    ]
    np.testing.assert_array_equal(values[11], 1.0)
    assert np.isnan(values[12:14]).all()  # counted by other limits than those of APV-I
    assert verdicts[11:14] == [MET, UNDECIDED, UNDECIDED]
    np.testing.assert_array_equal(values[14], values[0], "100 ft in metres")
    assert statements[14] == "lateral error at 30.48 m below 0.6 m in 50 % of runs"
    assert "requirements[9]: levels are not those of APV-I, which allows a risk of 2e-07 an approach" in said
    assert "requirements[9]: continuity and hazardously misleading information are counted by integrity.limits" in said
    assert float(result[f"{branch}/more_runs"][7]) == pytest.approx(-np.log(0.025) / 1e-6, rel=0.02)
    assert "lateral error at 100 ft below 0.6 m in 50 % of runs" in said
    assert "met: " in said


@pytest.mark.parametrize(("operation", "grown"), [("CAT-I", True), ("LPV-200", False)])
def test_only_cat_i_has_limits_that_grow(operation: str, grown: bool) -> None:
    """Counts with larger limits than those of the operation are not its own."""
    asked = PresetRequirement.model_validate({"what": "preset", "operation": operation})
    for grow, own in ((False, True), (True, grown)):
        limits = {"operation": operation, "tta_s": 6.0, "grow_with_distance": grow}
        assert asked.counts_by(LimitsSection.model_validate(limits)) is own


MHSS = (
    "integrity={method: mhss, p_constellations: {glonass: 1.0e-8, gps: 1.0e-8}, limits: {operation: LPV-200, tta_s: 6}}"
)


@pytest.mark.parametrize("method", in_brief(["mhss", "chi2", "filter"], 0))
def test_lpv_200_has_accuracy_and_a_threshold(method: str, tmp_path: Path) -> None:
    """Shares are those of the thresholds and sigmas of the result; residuals have no threshold."""
    chi2 = "integrity={method: chi2, limits: {operation: LPV-200, tta_s: 6}}"
    watched = chi2 if method == "chi2" else MHSS.replace("mhss", method)
    own = {"what": "accuracy", "below_m": 5.0, "at_most": 0.01, "share": 0.3}
    asked = [{"what": "preset", "operation": "LPV-200"}, own]
    result, _ = flown(tmp_path, asked, "--set", watched, "--method", "covariance")
    branch, glide = "/summary/requirements", result["/integrity/time"] <= 60.2
    statements = [str(text) for text in result[f"{branch}/statement"]]
    assert statements[2:5] == [
        "LPV-200: EMT within 15 m at 99 % of epochs of the glide",
        "LPV-200: P(fault-free vertical error > 4 m) at most 0.05 at 99 % of epochs of the glide",
        "LPV-200: P(fault-free vertical error > 10 m) at most 1e-07 at 99 % of epochs of the glide",
    ]
    sigma = result["/integrity/sigma_vertical"][glide]
    value, verdicts = result[f"{branch}/value"], [str(word) for word in result[f"{branch}/verdict"]]
    if method == "chi2":
        assert np.isnan(value[2]).all()
        assert verdicts[2] == UNDECIDED
    else:
        np.testing.assert_allclose(value[2], np.mean(result["/integrity/emt"][glide] <= 15.0))
    # normal quantiles of tables: 0.975, 1 - 0.5e-7, 0.995
    for row, size, factor in ((3, 4.0, 1.959964), (4, 10.0, 5.326724), (7, 5.0, 2.575829)):
        np.testing.assert_allclose(value[row], np.mean(factor * sigma <= size))
    assert verdicts[7] == (MET if value[7, 0] >= 0.3 else NOT_MET)
    if method == "filter":
        filtered = result["/filter/sigma"].reshape(-1, 15)[result["/filter/time"] <= 60.2]
        np.testing.assert_allclose(sigma[-1], filtered[-1, 2], rtol=0.1)
    else:
        geometry = result["/geometry/vdop"][result["/geometry/time"] <= 60.2]
        assert (sigma > 1.5 * geometry).all()  # ranges of 2.2 m and more


def test_the_vertical_error_without_a_fault_is_what_fixes_have(tmp_path: Path) -> None:
    result, _ = flown(tmp_path, [], "--runs", 100, "--keep", "all", "--set", MHSS)
    glide = result["/integrity/time"] <= 60.2
    error, sigma = result["/integrity/error_vertical"][:, glide], result["/integrity/sigma_vertical"][glide]
    normalised = np.mean((error / sigma) ** 2)
    # fixes are independent from epoch to epoch: 4.5 sigma of a mean of squares
    assert normalised == pytest.approx(1.0, abs=4.5 * np.sqrt(2.0 / error.size))


def test_the_exit_code_follows_where_it_is_asked_to(tmp_path: Path) -> None:
    good, bad = (
        [{"what": "rms", "of": "vertical", "below_m": 50.0}],
        [{"what": "rms", "of": axis, "below_m": 0.01} for axis in ("vertical", "horizontal")],
    )
    flown(tmp_path, good, "--runs", 8, "--require")
    _, said = flown(tmp_path, bad, "--runs", 8, "--require", code=3)
    assert "--require: vertical RMS error before touchdown below 0.01 m: not met" in said
    assert "error: 2 conditions are violated; a.h5 is complete" in said
    flown(tmp_path, bad, "--runs", 8)


def test_covariance_analysis_and_pushed_runs_judge_what_they_know(tmp_path: Path) -> None:
    some = [ALL[0], ALL[2], ALL[3], ALL[4], ALL[1]]
    analysed, _ = flown(tmp_path, some, "--method", "covariance")
    value, verdicts = (analysed[f"/summary/requirements/{name}"] for name in ("value", "verdict"))
    assert list(verdicts) == [MET, MET, MET, UNDECIDED, MET]
    # the median of the error's size lies where half of it does
    (middle,) = analysed["/summary/at/lateral_percentile"][2:3, 0]
    again, _ = flown(tmp_path, [ALL[0] | {"below_m": float(middle)}], "--method", "covariance", "--force")
    assert float(again["/summary/requirements/value"][0, 0]) == pytest.approx(0.5, abs=1e-9)
    assert np.isnan(value[3]).all()


def test_the_bound_of_an_analysis_is_no_verdict(tmp_path: Path) -> None:
    """Of a box of several sides it knows the most probable one and the sum."""

    def analysed(limit: float) -> tuple[np.ndarray, str]:
        settings = ("--set", "duration_s=62", "--set", "receiver.rate_hz=2", "--set", "filter.kind=eskf",
                    "--set", "box={lateral_m: 0.8, along_m: 0.8, vertical_m: 1.2}")  # fmt: skip
        asked = ("--set", f"requirements={json.dumps([{'what': 'box', 'at_most': limit}])}")
        navsim("run", SCENARIOS / "landing.yaml", "--method", "covariance", *settings, *asked, "--figures", "none",
               "-q", "-o", "a.h5", "--force", cwd=tmp_path)  # fmt: skip
        result = read(tmp_path / "a.h5")
        sides = result["/summary/box/axis_first_order"]
        value = result["/summary/requirements/value"][0]
        np.testing.assert_allclose(value, [sides.sum(), sides.max(), sides.sum()])
        return value, str(result["/summary/requirements/verdict"][0])

    (_, low, high), verdict = analysed(1e-12)
    assert verdict == NOT_MET
    assert 0.0 < low < high < 0.5
    assert analysed(0.5 * (low + high))[1] == UNDECIDED
    assert analysed(1.01 * high)[1] == MET


def test_pushed_runs_judge_the_box(tmp_path: Path) -> None:
    settings = ("--set", "filter.kind=eskf", "--set", "box={lateral_m: 0.5}", "--set", "receiver.rate_hz=2", "--set",
                f"requirements={json.dumps([ALL[2], ALL[1]])}")  # fmt: skip
    navsim("run", SCENARIOS / "landing.yaml", "--method", "rare", "--runs", 64, *settings, "--figures", "none", "-q",
           "-o", "a.h5", cwd=tmp_path)  # fmt: skip
    result = read(tmp_path / "a.h5")
    as_declared(result)
    np.testing.assert_array_equal(result["/summary/requirements/value"][0], result["/summary/rare/probability"])
    assert list(result["/summary/requirements/verdict"]) == [MET, UNDECIDED]


@pytest.mark.parametrize(
    ("requirement", "says"),
    [
        ({"what": "box", "at_most": 1e-6}, "requirements.0.what: refers to `box`"),
        ({"what": "level", "of": "hpl", "below_m": 40}, "requirements.0.what: refers to `integrity`"),
        ({"what": "continuity", "at_most": 1e-6}, "requirements.0.what: refers to `integrity.limits`"),
        ({"what": "preset", "operation": "NPA"}, "requirements.0.operation: continuity and integrity of NPA"),
        ({"what": "errors"}, "did you mean 'error'?"),
    ],
)
def test_requirements_of_what_is_not_there(requirement: dict[str, Any], says: str) -> None:
    with pytest.raises(Exception, match="requirements") as error:
        scenario(f"requirements={json.dumps([requirement])}")
    assert says in str(error.value)


def test_a_preset_is_counted_by_its_own_limits(tmp_path: Path) -> None:
    """All satellites spoofed up: by the limits of APV-I every run misleads, by wider ones none does."""
    own = "integrity={method: chi2, limits: {operation: APV-I, tta_s: 6}}"
    drift = "events=[{what: spoof, sources: [glonass, gps], rate_ned_m_s: [0, 0, -2], at_s: 10}]"
    alone = ("--set", "pseudolites={count: 0}", "--set", "sky={source: nominal}", "--set", drift)
    asked = [{"what": "preset", "operation": "APV-I"}]
    by_own, said = flown(tmp_path, asked, "--runs", 8, *alone, "--set", own)
    assert "counted by" not in said
    assert list(by_own["/summary/requirements/verdict"][3:]) == [UNDECIDED, NOT_MET]
    other = "integrity={method: chi2, limits: {hal_m: 200, val_m: 200, tta_s: 6}}"
    by_others, said = flown(tmp_path, asked, "--runs", 8, *alone, "--set", other, "--force")
    assert "give limits: {operation: APV-I" in said
    assert list(by_others["/summary/requirements/verdict"][3:]) == [UNDECIDED, UNDECIDED]


@pytest.mark.parametrize(
    ("setting", "said"),
    in_brief(
        [
            ("integrity.p_hmi_v=1.2e-7", "p_hmi_v, p_hmi_h and p_unmonitored_max allow 2.02e-07"),
            ("integrity.method=chi2", "integrity.method chi2 computes them for a fault that is there"),
            ("integrity.p_hmi_v=1.1e-7", None),
        ],
        0,
        1,
    ),
)
def test_levels_of_a_preset_are_for_its_risk(setting: str, said: str | None, tmp_path: Path) -> None:
    asked = [{"what": "preset", "operation": "LPV-200"}]
    _, heard = flown(tmp_path, asked, "--set", MHSS, "--set", setting, "--method", "covariance")
    assert ("levels are not those of LPV-200" in heard) == (said is not None)
    assert said is None or said in heard


def test_levels_without_a_test_are_not_within_anything(tmp_path: Path) -> None:
    """Of a filter that is given nothing, though it has levels; and where no fault is expected."""
    level, emt = {"what": "level", "of": "hpl", "below_m": 1000.0}, {"what": "emt", "below_m": 1000.0}
    asked: list[dict[str, Any]] = [level, emt]
    branch, silence = "/summary/requirements/value", "events=[{what: silence, sources: [all], at_s: 40}]"
    watched = MHSS.replace("mhss", "filter")
    result, said = flown(tmp_path, asked, "--set", watched, "--set", silence, "--method", "covariance")
    time = result["/integrity/time"]
    assert np.isfinite(result["/integrity/hpl"][1:]).all()
    np.testing.assert_allclose(result[branch], np.mean(time[time <= 60.2] < 40.0))
    assert "no signal at" in said
    none = "integrity={p_satellite: 0, p_constellation: 0, p_pseudolite: 0, ground_groups: []}"
    result, said = flown(tmp_path, asked, "--set", none, "--method", "covariance", "--force")
    np.testing.assert_array_equal(result[branch], 0.0)
    assert "no fault is expected" in said


def test_the_climb_after_a_go_around_is_no_glide() -> None:
    flown = case("approach.go_around={height_m: 60}", "duration_s=90", "filter.kind=eskf", WATCHED)
    begin = flown.trajectory.path.events[GO_AROUND]
    time = flown.shared.signals.time
    assert 30.0 < begin < 60.0
    np.testing.assert_array_equal(glide_of(flown), time <= begin)


def test_a_flight_that_ends_on_the_glide_is_judged_as_far_as_it_goes(tmp_path: Path) -> None:
    asked = [{"what": "level", "of": "hpl", "below_m": 1000.0}]
    _, said = flown(tmp_path, asked, "--set", "duration_s=30", "--set", "box=null", "--method", "covariance")
    assert "requirements judge the part of the glide that is flown" in said


def test_more_runs_are_told_where_an_interval_is_cut_off_at_nothing() -> None:
    """Forty runs with 0.008 [0, 0.025]: nothing is decided before the lower end is above the limit."""
    value = np.array([0.008315, 0.0, 0.0246])
    one: Any = RiskRequirement(what="continuity", at_most=8e-6)
    draft: Any = {"/summary/integrity/continuity_risk": value}
    found = _of_shares(one, RequirementValue("", np.full(3, np.nan), 8e-6), draft, 40)
    assert found.verdict() == UNDECIDED
    assert found.more(40) == pytest.approx(40 * ((0.0246 - 0.008315) / (0.008315 - 8e-6)) ** 2 - 40, abs=2)


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (("run", SCENARIOS / "landing.yaml"), "--require: the scenario has no requirements"),
        (("sweep", SCENARIOS / "placement_sweep.yaml"), "--require: requirements is none of the study's outputs"),
        (("replay", SCENARIOS / "recorded_flight.yaml"), "--require: a recorded flight has no requirements"),
    ],
)
def test_nothing_is_computed_to_judge_nothing(command: tuple[Any, ...], said: str, tmp_path: Path) -> None:
    assert said in navsim(*command, "--require", cwd=tmp_path, code=2).stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("method", in_brief(["covariance", "monte-carlo"], 0))
def test_what_is_before_touchdown_is_not_known_without_one(method: str, tmp_path: Path) -> None:
    asked = [{"what": "rms", "of": "vertical", "below_m": 50.0}]
    cut = ("--set", "duration_s=30", "--set", "box=null")
    result, said = flown(tmp_path, asked, *cut, "--method", method)
    assert list(result["/summary/requirements/verdict"]) == [UNDECIDED]
    assert "errors over 20 s to the end" in said
    _, said = flown(tmp_path, asked, "--method", method, "--force")
    assert "errors over 20 s to touchdown" in said


def test_levels_after_exclusions_are_judged_by_runs(tmp_path: Path) -> None:
    """By the levels that each fix had: all of them as they are kept, and the intervals of other shares of epochs."""
    excluding = "integrity={method: chi2, p_fa: 1.0e-2, exclusion: residual, limits: {hal_m: 60, val_m: 90, tta_s: 1}}"
    step = "events=[{what: step, sources: [R01], error_m: 90, at_s: 30, until_s: 45}]"
    more = ("--runs", 24, "--set", step, "--set", excluding)
    first, _ = flown(tmp_path, [{"what": "level", "of": "hpl", "below_m": 50.0}], *more)
    glide = first["/integrity/time"] <= 60.2  # it begins on it
    levels = first["/integrity/hpl_run"][:, glide]
    size = float(np.nanmax(first["/integrity/hpl"][glide])) + 0.01
    assert (levels > size).any()
    asked = [{"what": "level", "of": "hpl", "below_m": size, "share": 0.5}, {"what": "preset", "operation": "APV-I"}]
    result, _ = flown(tmp_path, asked, *more, "--force")
    value = result["/summary/requirements/value"]
    assert value[0, 0] == pytest.approx(np.mean(levels <= size), abs=2.0 / levels.shape[1])
    assert value[0, 1] < value[0, 0] < value[0, 2]
    assert result["/summary/requirements/verdict"][0] == MET
    assert np.isfinite(value[:3]).all()


def test_levels_beyond_their_limits_mislead_nobody(tmp_path: Path) -> None:
    """navsim claims nothing there, so no number of runs shows a risk."""
    asked = [{"what": "misleading", "at_most": 0.1}]
    narrow = WATCHED.replace("hal_m: 60, val_m: 90", "hal_m: 1, val_m: 1")
    _, said = flown(tmp_path, asked, "--set", narrow, "--runs", 2)
    assert "undecided: no run or epoch counts" in said


def test_without_a_level_nothing_misleads_and_nothing_is_shown(tmp_path: Path) -> None:
    """One system, whose fault has the default prior, has no level at any epoch."""
    asked = [{"what": "misleading", "at_most": 0.1}]
    result, said = flown(tmp_path, asked, "--set", WATCHED.replace("chi2, p_fa: 1.0e-2", "mhss"), "--runs", 2)
    assert result["/summary/integrity/level_share"] == 0.0
    assert np.isnan(result["/summary/integrity/hmi"]).all()
    (line,) = (each for each in said.splitlines() if each.strip().startswith("hazardously misleading information  "))
    assert line.split()[-1] == "-"
    assert "levels, accuracy, alarms, risks " in said
    assert "undecided: no run or epoch counts" in said
