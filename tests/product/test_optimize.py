"""`navsim optimize`: tables, files, repeatability, messages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from navsim.report.view import view
from navsim.results.result import Result, read
from tests.conftest import SCENARIOS
from tests.layout import as_declared
from tests.product.test_run import navsim, stored

BASE = SCENARIOS / "landing_gnss_only.yaml"

FEW = ("--runs", 8)
"""Runs of the best placements, where a test says nothing of them."""


def study(folder: Path, text: str) -> Path:
    file = folder / "study.yaml"
    file.write_text(f"kind: optimize\nversion: 1\nbase: {BASE}\nset: {{receiver.rate_hz: 1, imu.rate_hz: 20}}\n{text}")
    return file


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("optimize")


def test_shipped_study(place: Path, folder: Path) -> None:
    """A front that falls, rules kept, the same again for fewer pseudolites with the same seed."""
    result = read(place / "optimize.h5")
    tree = xr.open_datatree(place / "optimize.h5", engine="h5netcdf")
    assert tree["map/objective"].sizes == {"pseudolites": 2, "s": 61, "l1": 61}
    as_declared(result)
    front = result["/pareto/objective"]
    none = result.variables["/pareto/objective"].attributes["without_pseudolites"]
    assert np.all(np.diff(np.append(none, front)) < 0)
    assert np.all(result["/optimum/violation"] <= 0.01)
    np.testing.assert_allclose(result["/optimum/pdop"], front, rtol=1e-12)
    # no place of the map is better than the optimum
    assert np.all(np.nanmin(result["/map/objective"], axis=(1, 2)) >= front * (1 - 1e-3))
    reach = result["/optimum/neighbourhood"]
    both = np.isfinite(reach[:, :, 0]) & np.isfinite(reach[:, :, 1])
    assert np.all(reach[:, :, 0][both] < reach[:, :, 1][both])
    shipped = ("optimize", SCENARIOS / "placement_optimum.yaml", "--set", "effort=1", "--set", "pseudolites=[1]", *FEW)
    navsim(*shipped, "-o", "one.h5", "-q", cwd=folder)
    assert read(folder / "one.h5")["/pareto/objective"] == front[0]
    assert "PL2" in navsim("show", place / "optimize.h5", cwd=folder).stdout


def test_json(folder: Path) -> None:
    file = study(folder, "pseudolites: [1]\nobjective: vdop\narea: {s_m: [100, 900], l1_m: [0, 2000]}\n")
    done = navsim("optimize", file, "--json", "-o", "json.h5", "--seed", 4, "--figures", "none", cwd=folder)
    data = json.loads(done.stdout)
    assert 100 <= data["placements"][0]["sites"][0]["s_m"] <= 900
    assert data["placements"][0]["value"] < data["without_pseudolites"]
    # no optimum is printed that was not flown, one of geometry neither
    flown = data["placements"][0]["flown"]
    assert flown["runs"] == 200
    value, low, high = flown["vertical"]
    assert 0.0 < low < value < high
    assert flown["objective"] == [None] * 3, "runs have no VDOP"
    assert flown["verdict"].startswith("sigma ")
    shown = navsim("show", "json.h5", cwd=folder).stdout
    assert "near-far effects are not simulated" in shown
    assert "errors of pseudolites: white noise alone, so their gain is optimistic" in " ".join(shown.split())
    assert f"All states, 1 pseudolite: {flown['verdict']}" in " ".join(shown.split())


def test_none_is_flown_where_that_is_asked_for(folder: Path) -> None:
    file = study(folder, NARROW)
    limit = ("--set", "set.requirements=[{what: rms, of: vertical, below_m: 90}]")
    done = navsim("optimize", file, *limit, "--runs", 0, "-o", "unflown.h5", "--figures", "none", cwd=folder)
    assert "No runs have checked the best placements" in done.stdout
    assert not [name for name in read(folder / "unflown.h5").variables if name.startswith("/flown/requirements/")]
    file = study(folder, "pseudolites: [1]\nobjective: pdop\nsites: [{s_m: -14, l1_m: -300}]\n")
    said = navsim("optimize", file, "--runs", 0, "-o", "unflown.h5", "--figures", "none", cwd=folder).stderr
    assert "1 pseudolite: pseudolites on the pavement of the runway, 1000 m by 30 m" in said
    assert "(300.0 m beyond the threshold, 14.0 m off the centre line)" in said


def test_runs_of_the_best_judge_requirements_that_are_no_constraint(folder: Path) -> None:
    """In the table, in the result, as JSON; a warning names those that it misses, another that the search ignores them.

    Seen before: "the requirements are not evaluated", and no verdict anywhere.
    """
    limits = "set.requirements=[{what: rms, of: vertical, below_m: 90}, {what: rms, of: horizontal, below_m: 0.001}]"
    done = navsim("optimize", study(folder, NARROW), "--set", limits, *FEW, "-o", "r.h5", "--figures", "none",
                  cwd=folder)  # fmt: skip
    assert "the search ignores the requirements of" in done.stderr
    missed = "1 pseudolite: runs of the best placement don't meet: horizontal RMS error before touchdown below 0.001 m"
    assert missed in " ".join(done.stderr.split())
    result = read(folder / "r.h5")
    as_declared(result)
    assert result["/flown/requirements/verdict"].tolist() == [["met", "not met"]]
    value, low, high = result["/flown/requirements/value"][0, 1]
    assert 0.001 < low < value < high
    assert "Requirements of the best placements, by runs" in done.stdout
    assert f"not met: {value:.4g}  [{low:.4g}, {high:.4g}]" in done.stdout
    (best,) = json.loads(navsim("show", "r.h5", "--json", cwd=folder).stdout)["placements"]
    assert [one["verdict"] for one in best["flown"]["requirements"]] == ["met", "not met"]


NARROW = "pseudolites: [1]\nobjective: pdop\narea: {s_m: [0, 50], l1_m: [0, 100]}\n"


@pytest.mark.parametrize(
    ("text", "code", "expected"),
    [
        ("pseudolites: [1]\nobjective: pdob\narea: {s_m: [0, 1], l1_m: [0, 1]}", 2, "did you mean 'pdop'"),
        ("pseudolites: [1]\nobjective: pdop", 2, "exactly one of area and sites"),
        ("pseudolites: [1]\nobjective: pdop\narea: {s_m: [5, 1], l1_m: [0, 1]}", 2, "lower end comes first"),
        ("pseudolites: [3]\nobjective: pdop\nsites: [{s_m: 1, l1_m: 2}]", 2, "only 1 sites"),
        (
            "pseudolites: [1]\nobjective: pdop\narea: {s_m: [0, 50], l1_m: [-9, -1]}\nconstraints: {runway_strip: {}}",
            3, "breaks a rule",
        ),
        (
            "pseudolites: [2]\nobjective: pdop\nsites: [{s_m: 0, l1_m: -100}, {s_m: 500, l1_m: 0}]\n"
            "constraints: {runway_strip: {}}",
            3, "only 1 of 2 sites",
        ),
        (
            NARROW + "constraints: {keep_out: no.json}",
            2, "no.json: cannot be read",
        ),
        (
            NARROW + "constraints: {keep_out: line.json}",
            2, "'LineString' is not a Polygon",
        ),
        (
            NARROW + "constraints: {keep_out: broken.json}",
            2, "not a GeoJSON file",
        ),
        (
            NARROW + "constraints: {keep_out: bow.json}",
            2, "Self-intersection",
        ),
        (
            "pseudolites: [1]\nobjective: vertical\narea: {s_m: [0, 50], l1_m: [0, 9]}\nperiod: {hours: 24, count: 4}",
            2, "over one epoch",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_said(folder: Path, text: str, code: int, expected: str) -> None:
    (folder / "line.json").write_text(json.dumps({"type": "LineString", "coordinates": [[37, 56], [38, 56]]}))
    (folder / "broken.json").write_text("{")
    bow = [[[37.0, 56.0], [37.1, 56.1], [37.1, 56.0], [37.0, 56.1], [37.0, 56.0]]]
    (folder / "bow.json").write_text(json.dumps({"type": "Polygon", "coordinates": bow}))
    done = navsim("optimize", study(folder, text), "-o", "bad.h5", cwd=folder, code=code)
    assert expected in done.stderr
    assert not (folder / "bad.h5").exists()


JUDGED = """set:
  receiver.rate_hz: 1
  imu.rate_hz: 20
  duration_s: 61
  integrity: {method: chi2, limits: {hal_m: 40, val_m: 35, tta_s: 6}}
  requirements:
    - {what: level, of: vpl, below_m: 40}
    - {what: misleading, at_most: 1.0e-6}
sites: [{s_m: 400, l1_m: 200}, {s_m: -900, l1_m: 2500}, {s_m: 1500, l1_m: 3000}, {s_m: -1500, l1_m: -500}]
constraints: {requirements: true}
"""


def judged(folder: Path, text: str = JUDGED) -> Path:
    file = folder / "judged.yaml"
    file.write_text(f"kind: optimize\nversion: 1\nbase: {BASE}\nobjective: vpl_p95\n{text}")
    return file


NUMBERS = "pseudolites={first: 1, last: 3}"


def test_requirements_are_told_with_every_number(folder: Path) -> None:
    """In the result, the table, the figures, as JSON; what levels do not decide is said."""
    done = navsim("optimize", judged(folder), "--set", NUMBERS, *FEW, "-o", "judged.h5", cwd=folder)
    result = read(folder / "judged.h5")
    as_declared(result)
    met, used = result["/pareto/met"], result["/requirements/utilisation"][:, 0]
    assert met.tolist() == [0, 1, 1]
    assert (used <= 1.0).tolist() == [False, True, True]
    assert not result["/pareto/met_without"]
    assert int(result["/pareto/fewest"]) == 2
    assert result["/requirements/verdict"][:, 0].tolist() == ["not met", "met", "met"]
    assert set(result["/requirements/verdict"][:, 1]) == {"undecided"}
    assert result["/requirements/decided"].tolist() == [1, 0]
    assert f"(margin {100 * (1 - used[1]):.1f} %)" in done.stdout
    assert "by analysis, the fewest pseudolites with which the requirements are met: 2" in done.stdout
    assert "by runs: 2 pseudolites undecided; 3 pseudolites undecided" in done.stdout, "8 runs decide no risk of 1e-6"
    assert done.stdout.count("  met by analysis") == 2
    assert "only runs decide (use `navsim run`): risk of hazardously misleading information" in done.stderr
    assert (
        "1 pseudolite: no placement meets the requirements (every choice of sites was tried); the nearest"
        in done.stderr
    )
    # where moving the first one would break them the map is empty, with one it is all of it
    assert np.isnan(result["/map/objective"][0]).all()
    assert np.isfinite(result["/map/objective"][1]).any()
    for name in ("plan", "front", "requirements"):
        with Image.open(folder / f"judged_{name}.png") as image:
            assert min(image.size) > 300
    data = json.loads(navsim("show", "judged.h5", "--json", cwd=folder).stdout)
    assert data["fewest"] == 2
    assert [one["met"] for one in data["placements"]] == [False, True, True]
    assert [one["met_by_runs"] for one in data["placements"]][1:] == ["undecided", "undecided"]
    assert data["placements"][0]["requirements"][0]["verdict"] == "not met"


def test_what_cannot_be_met_fails_with_the_nearest(folder: Path) -> None:
    """The result is whole and has the placement that misses by least; the exit code says that it is no answer."""
    limit = "set.requirements=[{what: level, of: vpl, below_m: 5}]"
    given = ("--set", NUMBERS, "--set", limit, *FEW, "--figures", "none", "-o", "no.h5")
    done = navsim("optimize", judged(folder), *given, cwd=folder, code=3)
    assert "no placement found meets the requirements (no.h5 is complete)" in done.stderr
    assert "no placement found meets the requirements, for any number of pseudolites" in done.stdout
    result = read(folder / "no.h5")
    as_declared(result)
    assert int(result["/pareto/fewest"]) == -1
    used = result["/requirements/utilisation"][:, 0]
    assert (used > 1.0).all()
    assert (np.diff(used) < 0.0).all()
    for used_here in used:
        assert f"{100 * (used_here - 1):.3g} % beyond the size" in done.stderr


def test_requirements_that_need_no_pseudolites(folder: Path) -> None:
    limit = "set.requirements=[{what: level, of: vpl, below_m: 80}]"
    one = ("--set", "pseudolites=[1]", *FEW)
    done = navsim("optimize", judged(folder), *one, "--set", limit, "-o", "n.h5", "--figures", "none", cwd=folder)
    assert "by analysis, the fewest pseudolites with which the requirements are met: 0" in done.stdout
    assert "by runs: 1 pseudolite met" in done.stdout
    result = read(folder / "n.h5")
    unflown = {name: v for name, v in result.variables.items() if not name.startswith("/flown/requirements/")}
    front, *_ = view("optimize").tables([("n", Result(result.attributes, unflown))])
    assert "by runs: 1 pseudolite not simulated" in front.notes


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (["set.requirements=[]"], "constraints.requirements: there are no `requirements` in"),
        (["set.integrity=null", "constraints={}", "set.requirements=[]"], "objective: vpl_p95 needs `integrity`"),
        (
            ["set.requirements=[{what: misleading, at_most: 1.0e-6}]"],
            "constraints.requirements: levels and covariance analysis decide none of them: risk of hazardously",
        ),
        (
            ["period={hours: 2, count: 4}"],
            "period: errors of the filter, levels and requirements are taken over one epoch",
        ),
        (["pseudolites={first: 3, last: 2}"], "pseudolites.last: must not lie below first"),
        (["pseudolites={first: 1, lst: 2}"], "pseudolites.lst: unknown key; did you mean 'last'?"),
        (["pseudolites={first: 0, last: 2}"], "pseudolites.first: must be at least 1"),
        (["pseudolites={first: 1, last: 5}"], "pseudolites: there are only 4 sites"),
        (["pseudolites=2"], "pseudolites: "),
    ],
)
def test_requirements_that_cannot_be_asked(folder: Path, settings: list[str], expected: str) -> None:
    keys = [part for key in (NUMBERS, *settings) for part in ("--set", key)]
    done = navsim("optimize", judged(folder), *keys, "-o", "bad.h5", cwd=folder, code=2)
    assert expected in done.stderr
    assert not (folder / "bad.h5").exists()


@pytest.mark.long
def test_a_search_under_requirements_goes_on_after_its_time(folder: Path) -> None:
    """What was analysed is remembered with its load: the same in the end as in one go."""
    fewer = JUDGED.replace("receiver.rate_hz: 1", "receiver.rate_hz: 0.25")
    file = judged(folder, fewer.replace("sites: [", "effort: 1\narea: {s_m: [200, 900], l1_m: [0, 1500]}\nnone: [")
                  .replace("none: [{s_m: 400, l1_m: 200}, {s_m: -900, l1_m: 2500}, {s_m: 1500, l1_m: 3000}, "
                           "{s_m: -1500, l1_m: -500}]\n", ""))  # fmt: skip
    common = ("--set", "pseudolites=[1]", "--set", "set.requirements=[{what: level, of: hpl, below_m: 30}]", "-q",
              "--figures", "none", *FEW)  # fmt: skip
    navsim("optimize", file, *common, "-o", "whole.h5", cwd=folder)
    navsim("optimize", file, *common, "-o", "cut.h5", "--time-limit", 0.7, cwd=folder, code=None)
    navsim("optimize", file, *common, "-o", "cut.h5", "--force", cwd=folder)
    whole, cut = (stored(folder / name) for name in ("whole.h5", "cut.h5"))
    for data in (whole, cut):
        for name in [name for name in data if name.startswith("/pareto/evaluations")]:
            data.pop(name)
    assert whole == cut


def test_silent_pseudolites_are_not_sought(folder: Path) -> None:
    file = study(folder, "pseudolites: [1]\nobjective: vertical\narea: {s_m: [100, 900], l1_m: [0, 2000]}\n")
    silent = ("--set", "set.events=[{what: silence, sources: [all]}]")
    done = navsim("optimize", file, *silent, "-o", "silent.h5", cwd=folder, code=2)
    assert "events[0] silences the pseudolites, too, during the whole flight" in done.stderr
