"""The front of accuracy against cost, against every choice of sites; costs by hand; stopped and continued."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bokeh.models import GlyphRenderer

from navsim.formats.export_maps import write_kml
from navsim.optimization import flatness, page
from navsim.optimization.best_placement import Found, NoPlacement
from navsim.optimization.costs import HALVINGS, CostModel, cheaper, on_front
from navsim.optimization.placement import RunwayPlane, _polygons
from navsim.optimization.problem import PlacementProblem, problem
from navsim.optimization.progress import SearchMonitor, SearchProgress
from navsim.optimization.report import front, tables
from navsim.optimization.result import optimize_result
from navsim.optimization.scenario import Optimize
from navsim.optimization.search_log import SearchLog
from navsim.optimization.study import SearchOutcome, solve
from navsim.report.table import Table
from navsim.results.findings import of
from navsim.results.result import Result
from navsim.runner.checkpoint import CheckpointStore
from navsim.scenario.load import read_study
from navsim.scenario_files.source import InputError
from tests.conftest import SCENARIOS
from tests.layout import as_declared

SITES = [  # s, l1, height of the antenna and of the ground, permission
    (200, 900, 4, 0, 0), (-200, 900, 12, 8, 300), (150, -300, 25, 0, 700), (-300, 100, 3, 0, 100), (90, 1800, 1, 0, 50),
    (-400, 1500, 10, 10, 0),
]  # fmt: skip
EACH, MAST = 1000.0, 40.0
BEACONS = "beacons: {sites: [{s_m: 400, l1_m: 0}], rate_hz: 4, sigma_m: 0.1, range_limit_m: 9000}"


def posed(folder: Path, base: str, study: dict[str, Any], name: str = "landing.yaml") -> PlacementProblem:
    (folder / "base.yaml").write_text(f"{(SCENARIOS / name).read_text()}\n{base}\n")
    (folder / "study.yaml").write_text(json.dumps({"kind": "optimize", "version": 1, "base": "base.yaml"} | study))
    return problem(*read_study(folder / "study.yaml", Optimize, []))


def of_beacons(folder: Path, **more: Any) -> PlacementProblem:
    """Three or four of six sites."""
    names = ("s_m", "l1_m", "height_m", "ground_m", "cost")
    study = {"set": {"receiver.rate_hz": 0.25}, "beacons": [3, 4], "objective": "beacons_pdop"}
    sites = [dict(zip(names, each, strict=True)) for each in SITES]
    costs = {"each": EACH, "mast_per_metre": MAST, "steps": 50}
    return posed(folder, BEACONS, study | {"sites": sites, "costs": costs} | more)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    here = of_beacons(tmp_path_factory.mktemp("beacons"))
    return optimize_result(here, solve(here, 1), 1)


def pairs(result: Result, rows: np.ndarray) -> set[tuple[float, float]]:
    """Cost and objective of some placements, rounded."""
    both = np.column_stack([result["/pareto/cost"], result["/pareto/objective"]])[rows]
    return {tuple(row) for row in both.round(6).tolist()}


def not_dominated(every: list[tuple[float, float]]) -> set[tuple[float, float]]:
    """Those than which no other is at least as cheap and as good."""
    return {one for one in every if not any(o != one and o[0] <= one[0] and o[1] <= one[1] for o in every)}


def test_the_front_is_that_of_every_choice(tmp_path: Path, result: Result) -> None:
    here = of_beacons(tmp_path)
    costs = {site: EACH + MAST * max(site[2] - site[3], 0) + site[4] for site in SITES}
    every = []
    for chosen in itertools.chain(*(itertools.combinations(SITES, count) for count in (3, 4))):
        value = float(here.objective(np.array([[site[:3] for site in chosen]], float))[0])
        every.append((round(sum(costs[site] for site in chosen), 6), round(value, 6)))
    as_declared(result)
    assert pairs(result, result["/pareto/on_front"] > 0) == not_dominated(every)
    assert len(not_dominated(every)) >= 5
    np.testing.assert_allclose(np.nansum(result["/optimum/cost"], axis=1), result["/pareto/cost"])
    assert result["/optimum/explored"].all(), "the flat region of each is known"


def test_table_maps_and_figures_show_each_placement(result: Result, tmp_path: Path) -> None:
    rows = result["/pseudolites"].size
    printed = [table for table in tables(result) if isinstance(table, Table)]
    named = [str(row.cells[0]) for row in printed[0].rows[1:]]
    cheapest = f"3 for {result['/pareto/cost'][0]:g}"
    assert named[0] == cheapest
    assert len(named) == rows
    (text,) = write_kml(result, tmp_path / "best").values()
    assert f"<name>B1 of {cheapest}</name>" in text
    ax = front(result).axes[0]
    drawn = {text.get_text() for text in ax.texts}
    assert drawn == {"3", "4"}
    (first, *_) = page.optima([("one", result)])
    of_page = [
        np.column_stack([each.data_source.data["x"], each.data_source.data["y"]])
        for each in first.panels[0].select(type=GlyphRenderer)
        if {"x", "y", "said"} <= set(each.data_source.data)
    ]
    of_paper = np.vstack([line.get_xydata() for line in ax.lines])
    np.testing.assert_allclose(np.sort(of_page[0], axis=0), np.sort(of_paper, axis=0), rtol=1e-6)
    assert len(of_page[0]) == rows


def test_costs_by_hand() -> None:
    """Overlapping polygons: the cheaper permission; a mast below the ground costs nothing; the least of any."""
    plane = RunwayPlane(np.array([np.radians(56.0), np.radians(37.0), 0.0]), 0.0, 0.0)
    squares = [
        {"type": "Feature", "properties": {"cost": cost}, "geometry": {"type": "Polygon", "coordinates": [[
            [37.0 + x, 56.0 + y] for x, y in ((0, 0), (size, 0), (size, size), (0, size), (0, 0))]]}}
        for size, cost in ((0.02, 500), (0.01, 900))
    ]  # fmt: skip
    text = json.dumps({"type": "FeatureCollection", "features": squares}).encode()
    land = tuple(_polygons(text, plane, 0.0, True))
    given = Optimize.model_validate(
        {"kind": "optimize", "version": 1, "base": "b", "pseudolites": [1], "objective": "pdop",
         "area": {"s_m": [0, 1], "l1_m": [0, 1], "height_m": [-5, 20]}, "costs": {"each": 100, "mast_per_metre": 10}}
    )  # fmt: skip
    model = CostModel.of(given, 7.0, land)
    assert model is not None
    places = np.array([[[300.0, -500.0, 3.0], [900.0, -1500.0, -5.0], [300.0, 500.0, 0.0]]])
    np.testing.assert_allclose(model.each(places, places[..., 2]), [[637.0, 607.0, 107.0]])
    assert model.least(2, -5.0) == 2 * 607.0
    with pytest.raises(ValueError, match="cost 'dear' is not a number from 0"):
        _polygons(text.replace(b"900", b'"dear"'), plane, 0.0, True)
    assert len(_polygons(text.replace(b"900", b'"dear"'), plane, 0.0, False)) == 2


def test_limits_end_near_the_least_cost() -> None:
    """Costs above 300 of 1000 meet the requirements, above 180 there is a placement: by steps, then by halves."""
    tried: list[float] = []

    def seek(_: int, limit: float, __: Found) -> Found:
        tried.append(limit)
        if limit < 180.0:
            raise NoPlacement("none")
        return Found(np.array([[limit]]), 1.0, {}, False, True, load=300.0 / limit)

    best = Found(np.array([[1000.0]]), 1.0, {}, False, True, load=0.3)
    found = [
        each.places[0, 0] for _, _, each in cheaper(best, 100.0, 6, HALVINGS, lambda one: float(one.places[0, 0]), seek)
    ]
    assert found == [850.0, 700.0, 550.0, 400.0, 325.0, 306.25]
    assert tried == [850.0, 700.0, 550.0, 400.0, 250.0, 325.0, 287.5, 306.25]
    assert len(tried) <= 6 + HALVINGS
    missed = Found(best.places, 1.0, {}, False, True, load=1.2)
    assert list(cheaper(missed, 100.0, 6, 3, lambda _: 1000.0, seek)) == []
    assert list(cheaper(best, 1000.0, 6, 3, lambda _: 1000.0, seek)) == []
    cost, value, met = (
        np.array([1.0, 2.0, 2.0, 3.0]),
        np.array([5.0, 4.0, 4.5, 1.0]),
        np.array([True, True, True, False]),
    )
    assert on_front(cost, value, met).tolist() == [True, True, False, False]


POWERS = [{"eirp_dbm": -60, "cost": 0}, {"eirp_dbm": -40, "cost": 250}]
LIMIT = 1.0


def of_filter(folder: Path, **more: Any) -> PlacementProblem:
    """One of three sites, with two powers, by an error of the filter that is required, too."""
    sites = [{"s_m": s, "l1_m": l1, "cost": cost} for s, l1, cost in ((300, 900, 0), (-300, 200, 90), (500, 1500, 40))]
    settings = {
        "duration_s": 61, "receiver.rate_hz": 1, "imu.rate_hz": 10, "pseudolites.range_law": "cn0",
        "requirements": [{"what": "rms", "of": "vertical", "below_m": LIMIT}],
    }  # fmt: skip
    study = {"set": settings, "pseudolites": [1], "objective": "vertical", "sites": sites, "height_m": 2}
    study |= {"constraints": {"requirements": True}, "costs": {"each": 1000, "steps": 20, "power": POWERS}}
    return posed(folder, "", study | more, "landing_gnss_only.yaml")


def test_powers_requirements_and_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error of the filter of every choice at both powers: front, fewest and cheapest; each member is flown."""
    monkeypatch.setattr(flatness, "ANALYSED_MAP_POINTS", 2)
    here = of_filter(tmp_path)
    store = SearchLog(CheckpointStore(tmp_path / "log", {}, fresh=False))
    found = optimize_result(here, solve(here, 1, None, store, runs=4), 1)
    every = []
    for power, its in enumerate((here, *here.powers)):
        for place, permission in zip(here.sites(), (0, 90, 40), strict=True):
            cost = 1000.0 + POWERS[power]["cost"] + permission
            value = float(its.objective(place[None, None])[0])
            assert its.costs(place[None]).tolist() == [cost]
            if value < LIMIT:
                every.append((cost, round(value, 6)))
    as_declared(found)
    assert len(not_dominated(every)) < len(every) < 6
    assert pairs(found, found["/pareto/on_front"] > 0) == not_dominated(every)
    assert found["/pareto/cheapest"] == min(cost for cost, _ in every)
    assert found["/pareto/fewest"] == 1
    assert set(found["/pareto/eirp"]) == {-60.0, -40.0}
    assert (found["/flown/runs"] == 4).all()
    assert all(text.startswith("sigma ") for text in found["/flown/verdict"])
    assert np.isfinite(found["/flown/objective"]).all()


def test_a_stopped_search_continues(tmp_path: Path, result: Result) -> None:
    """Stopped below a limit of the cost, and again when the front is there."""
    here, log = of_beacons(tmp_path), tmp_path / "log"

    def until(over: Callable[[SearchProgress], bool]) -> SearchOutcome:
        def stop(progress: SearchProgress) -> None:
            if over(progress):
                raise KeyboardInterrupt

        found = solve(here, 1, SearchMonitor(stop), SearchLog(CheckpointStore(log, {}, fresh=False)))
        assert found.stopped == "interrupted"
        return found

    first = until(lambda _: len(list(log.glob("found-*"))) == 5)
    assert "the front of accuracy against cost" in first.undone(here.study)
    assert len(first.found) > 2, "what was found below limits is kept"
    again = optimize_result(here, until(lambda progress: progress.step.endswith("neighbourhood")), 1)
    assert again.attributes["undone"] == "the neighbourhood for 3, 4 beacon(s); the map for 3, 4 beacon(s)"
    for path in ("/pareto/objective", "/pareto/cost", "/pareto/on_front", "/optimum/s", "/optimum/l1", "/optimum/up"):
        np.testing.assert_array_equal(again[path], result[path])


def test_a_power_that_reaches_nobody_is_left_out(tmp_path: Path) -> None:
    """Twenty decibels less reach a tenth as far; without the other power the study has no placement."""
    link = BEACONS.replace("range_limit_m: 9000", "eirp_dbm: 0, sensitivity_dbm: -100, carrier_mhz: 2400")
    sites = [{"s_m": s, "l1_m": l1, "height_m": h} for s, l1, h, *_ in SITES[:3]]
    study = {"set": {"receiver.rate_hz": 0.25}, "beacons": [3], "objective": "beacons_pdop", "sites": sites}
    here = posed(tmp_path, link, study | {"costs": {"power": [{"eirp_dbm": -20}, {"eirp_dbm": 20, "cost": 5}]}})
    found = optimize_result(here, solve(here, 1), 1)
    assert found["/pareto/eirp"].tolist() == [20.0]
    assert found["/pareto/cost"].tolist() == [15.0]
    assert found.attributes["undone"] == ""
    assert any(one.text.startswith("with -20 dBm: 3 beacons: every placement tried leaves") for one in of(found))
    weak = posed(tmp_path, link, study | {"costs": {"power": [{"eirp_dbm": -20}]}})
    with pytest.raises(NoPlacement, match="leaves epochs of the glide without a position"):
        solve(weak, 1)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"costs": {"power": [{"eirp_dbm": 10}]}}, "range_limit_m replaces it"),
        ({"costs": None}, "is for `costs`, which is not given"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, more: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        of_beacons(tmp_path, **more)


def test_a_power_without_effect_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the power of pseudolites makes no difference"):
        of_filter(tmp_path, set={"duration_s": 61, "receiver.rate_hz": 1, "imu.rate_hz": 10}, constraints={})
