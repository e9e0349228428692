"""Sweeps of protection levels and of what is counted of watched fixes: the numbers of single runs."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from navsim.results.result import Result, read
from navsim.results.schema import VERDICTS
from tests.helpers import SCENARIOS
from tests.layout import as_declared
from tests.product.test_run import navsim

WATCHED = {
    "integrity": {"method": "chi2", "p_fa": 1e-2, "limits": {"hal_m": 60, "val_m": 90, "tta_s": 1}},
    "duration_s": 62,
    "receiver.rate_hz": 2,
    "filter.kind": "eskf",
}


def study(folder: Path, text: str, settings: dict[str, object] = WATCHED) -> Path:
    path = folder / "study.yaml"
    base = SCENARIOS / "landing.yaml"
    vary = "vary: [{key: pseudolites.count, values: [0, 2]}]"
    path.write_text(f"kind: sweep\nversion: 1\nbase: {base}\nset: {json.dumps(settings)}\n{vary}\n{text}")
    return path


def single(folder: Path, count: int, *options: object) -> Result:
    keys = [part for key, value in WATCHED.items() for part in ("--set", f"{key}={json.dumps(value)}")]
    navsim(
        "run", SCENARIOS / "landing.yaml", *keys, "--set", f"pseudolites.count={count}", *options,
        "--figures", "none", "-q", "-o", f"one{count}.h5", "--force", cwd=folder,
    )  # fmt: skip
    return read(folder / f"one{count}.h5")


def test_levels_are_those_of_single_landings(tmp_path: Path) -> None:
    """By geometry alone, by number of pseudolites."""
    path = study(tmp_path, "outputs: [pdop, hpl_p95, vpl_max, level_share]")
    navsim("sweep", path, "--figures", "none", "-q", "-o", "s.h5", cwd=tmp_path)
    swept = read(tmp_path / "s.h5")
    as_declared(swept)
    for i, count in enumerate((0, 2)):
        one = single(tmp_path, count, "--method", "covariance")
        assert swept["/sweep/hpl_p95"][i] == one["/summary/integrity/hpl"][4]
        assert swept["/sweep/vpl_max"][i] == one["/summary/integrity/vpl"][2]
    assert swept["/sweep/hpl_p95"][1] < swept["/sweep/hpl_p95"][0]
    np.testing.assert_array_equal(swept["/sweep/level_share"], 1.0)


def test_counts_are_those_of_single_ensembles(tmp_path: Path) -> None:
    path = study(
        tmp_path, "method: monte-carlo\nruns: 8\noutputs: [availability, approaches, continuity_risk, hmi, vpl_p95]"
    )
    navsim("sweep", path, "--figures", "none", "-q", "-o", "s.h5", cwd=tmp_path)
    swept = read(tmp_path / "s.h5")
    as_declared(swept)
    one = single(tmp_path, 2, "--runs", 8, "--keep", "none")
    for name in ("availability", "approaches", "continuity_risk", "hmi"):
        found = [swept[f"/sweep/{name}{end}"][1] for end in ("", "_low", "_high")]
        np.testing.assert_array_equal(found, one[f"/summary/integrity/{name}"])


REQUIRED: dict[str, object] = {
    "requirements": [
        {"what": "level", "of": "vpl", "below_m": 45, "share": 0.9},
        {"what": "rms", "of": "vertical", "below_m": 1.5},
        {"what": "error", "of": "lateral", "at": "100ft", "below_m": 0.6},
        {"what": "availability", "at_least": 0.9},
        {"what": "preset", "operation": "APV-I"},
    ]
}


def test_excluded_satellites_are_as_good_as_silent(tmp_path: Path) -> None:
    """They are among the signals, unused, and no fault to expect."""
    priors = {"integrity": {"method": "mhss", "p_constellations": {"glonass": 1e-8}}}
    silence = {"events": [{"what": "silence", "sources": ["R23"]}]}
    levels = []
    for i, out in enumerate(({"sky.exclude": ["R23"]}, silence, {})):
        path = study(tmp_path, "outputs: [hpl_max, vpl_max]", WATCHED | priors | out)
        navsim("sweep", path, "--figures", "none", "-q", "-o", f"{i}.h5", cwd=tmp_path)
        levels.append(np.array([read(tmp_path / f"{i}.h5")[f"/sweep/{name}"] for name in ("hpl_max", "vpl_max")]))
    np.testing.assert_allclose(levels[0], levels[1], rtol=1e-9)
    assert (levels[0] > 1.1 * levels[2]).all()


@pytest.mark.parametrize("method", ["monte-carlo", "covariance"])
def test_requirements_are_judged_as_in_single_landings(tmp_path: Path, method: str) -> None:
    path = study(tmp_path, f"method: {method}\nruns: 8\noutputs: [requirements]", WATCHED | REQUIRED)
    done = navsim("sweep", path, "--figures", "none", "-o", "s.h5", "--require", cwd=tmp_path, code=3)
    assert "VPL within 45 m at 90 % of epochs of the glide" in done.stdout
    assert "requirement_8: not met, or undecided, in 2 of 2 combinations" in done.stderr
    swept = read(tmp_path / "s.h5")
    as_declared(swept)
    runs = method == "monte-carlo"
    rows = list(csv.DictReader((tmp_path / "s.csv").open()))
    for i, count in enumerate((0, 2)):
        asked = ("--set", f"requirements={json.dumps(REQUIRED['requirements'])}", "--method", method)
        one = single(tmp_path, count, *asked, *(("--runs", 8, "--keep", "none") if runs else ()))
        for k in range(9):
            name = f"requirement_{k + 1}"
            ends = [f"{name}{end}" for end in (("", "_low", "_high") if runs else ("",))]
            found = [swept[f"/sweep/{each}"][i] for each in ends]
            np.testing.assert_array_equal(found, one["/summary/requirements/value"][k][: len(found)])
            verdict = str(one["/summary/requirements/verdict"][k])
            assert VERDICTS[swept[f"/sweep/{name}_verdict"][i]] == verdict == rows[i][f"{name}_verdict"]
            variable = swept.variables[f"/sweep/{name}"]
            assert variable.attributes["limit"] == one["/summary/requirements/limit"][k]
            assert variable.long_name == f"{one['/summary/requirements/statement'][k]}: value"
    assert swept.variables["/sweep/requirement_2"].units == "m"
    # two pseudolites make some of them come true
    assert swept["/sweep/requirement_1_verdict"].tolist() == [0, 2]


def test_geometry_judges_the_levels_among_requirements(tmp_path: Path) -> None:
    """Where there is no fix there is no level, and that is known."""
    directions = [{"azimuth_deg": a, "elevation_deg": e} for a, e in ((0, 50), (120, 30), (240, 40))]
    sky = {"sky": {"source": "directions", "directions": directions}}
    path = study(tmp_path, "outputs: [requirements]", WATCHED | REQUIRED | sky)
    navsim("sweep", path, "--figures", "none", "-q", "-o", "s.h5", cwd=tmp_path)
    swept = read(tmp_path / "s.h5")
    as_declared(swept)
    assert swept["/outcome/combination"].tolist() == [2, 0]
    assert swept["/sweep/requirement_1"][0] == 0.0
    assert [int(swept[f"/sweep/requirement_{i}_verdict"][0]) for i in (1, 2, 3, 4, 7, 8)] == [0, 1, 1, 0, 0, 1]


def test_availability_by_levels_is_what_runs_have_but_for_alarms(tmp_path: Path) -> None:
    """A hundredth of the fixes alarms: the share of the runs lies between what the geometry says."""
    asked = ("--set", 'requirements=[{"what": "availability", "at_least": 0.995}]')
    analysed = single(tmp_path, 2, *asked, "--method", "covariance")["/summary/requirements/value"][0]
    np.testing.assert_allclose(analysed, [1.0, 0.99, 1.0])
    flown = single(tmp_path, 2, *asked, "--runs", 64, "--keep", "none")
    _, low, high = flown["/summary/requirements/value"][0]
    assert low < 0.99 < high
    faulty = ("--set", 'events=[{"what": "step", "sources": ["PL1"], "error_m": 30}]')
    value = single(tmp_path, 2, *asked, *faulty, "--method", "covariance")["/summary/requirements/value"][0]
    np.testing.assert_allclose(value, [1.0, 0.0, 1.0])


def test_the_best_of_a_share_is_the_largest(tmp_path: Path) -> None:
    limits = {"integrity": {"method": "chi2", "limits": {"hal_m": 30, "val_m": 52, "tta_s": 1}}}
    path = study(tmp_path, "method: monte-carlo\nruns: 2\noutputs: [availability]", WATCHED | limits)
    done = navsim("sweep", path, "--figures", "none", "--json", "-o", "s.h5", cwd=tmp_path)
    best = json.loads(done.stdout)["availability"]
    assert best["count"] == 2
    assert best["value"] == read(tmp_path / "s.h5")["/sweep/availability"].max() > 0.0


@pytest.mark.parametrize(
    ("text", "settings", "says"),
    [
        (
            "outputs: [requirements]",
            WATCHED,
            "the output requirements needs `requirements`, of which the scenario has none",
        ),
        ("outputs: [hpl_p95]", {}, "the output hpl_p95 needs `integrity`"),
        ("method: monte-carlo\noutputs: [hmi]", {"integrity": {}}, "the output hmi needs `integrity.limits`"),
        ("outputs: [hmi]", WATCHED, "'hmi' is of runs: it needs method monte-carlo"),
    ],
)
def test_outputs_of_what_nobody_watches(tmp_path: Path, text: str, settings: dict[str, object], says: str) -> None:
    done = navsim("sweep", study(tmp_path, text, settings), "-o", "s.h5", cwd=tmp_path, code=2)
    assert says in done.stderr


def test_what_is_asked_for_does_not_vary(tmp_path: Path) -> None:
    path = study(tmp_path, "outputs: [requirements]", WATCHED | REQUIRED)
    vary = "vary=[{key: requirements.0.below_m, values: [40, 60]}]"
    done = navsim("sweep", path, "--set", vary, "-o", "s.h5", cwd=tmp_path, code=2)
    assert "vary.0: `outputs` has requirements: all combinations need the same ones" in done.stderr


@pytest.mark.long
def test_an_optimum_of_a_watched_landing_is_that_of_an_unwatched_one(tmp_path: Path) -> None:
    """Placements have pseudolites of their own, which are watched as well."""
    places = []
    for settings in ({}, {"integrity": {"p_constellation": 1e-8}}):
        path = tmp_path / "optimum.yaml"
        common = {"pseudolites.frame": "runway", "duration_s": 61, "receiver.rate_hz": 1, "imu.rate_hz": 10}
        path.write_text(
            f"kind: optimize\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\nobjective: horizontal\n"
            f"set: {json.dumps(common | {'filter.kind': 'eskf'} | settings)}\npseudolites: [1]\n"
            "sites: [{s_m: 300, l1_m: 500}, {s_m: -800, l1_m: 1500}, {s_m: 600, l1_m: 0}]\n"
        )
        navsim("optimize", path, "--runs", 8, "--figures", "none", "-q", "-o", "o.h5", "--force", cwd=tmp_path)
        result = read(tmp_path / "o.h5")
        as_declared(result)
        places.append(
            {name: np.asarray(v.data) for name, v in result.variables.items() if name.startswith("/optimum/")}
        )
    assert len(places[0]) > 10
    assert places[0].keys() == places[1].keys()
    for name, data in places[0].items():
        np.testing.assert_array_equal(data, places[1][name], err_msg=name)
