"""Terrain hides pseudolites, satellites and jammers: sights by hand, and all that plans with the same world."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.formats.export import export
from navsim.geodesy.earth import llh_from_ecef
from navsim.geodesy.horizon import crossings, skyline_elevation
from navsim.gnss.interference import horizon
from navsim.gnss.sky import enu_matrix, unit_vector
from navsim.landing.preflight import through_ridges
from navsim.landing.result_groups import start_result
from navsim.landing.study import Case, covariance_analysis, covariance_result
from navsim.optimization import problem as objective
from navsim.optimization.scenario import Optimize
from navsim.planner.outlook import Outlook
from navsim.planner.proposal import PlannedScenario
from navsim.report.ridges import ShownRidge, clipped, flown_over, shown_ridges, terrain_skyline
from navsim.report.summary_tables import summary_table
from navsim.results.result import Result
from navsim.results.schema import COVARIANCE
from navsim.runner.opening import checked
from navsim.scenario.load import read_study
from navsim.scenario_files.source import load
from navsim.sweeps.plan import plan
from navsim.sweeps.scenario import DOP_OUTPUTS, FILTER_OUTPUTS, Sweep
from navsim.sweeps.study import SweepStudy, filter_outputs
from tests.helpers import SCENARIOS, case

EAST, WEST = {"name": "east", "s_m": 600, "l1_m": 500}, {"name": "west", "s_m": -600, "l1_m": 500}
FIELD: dict[str, Any] = {
    "receiver.rate_hz": 1, "imu.rate_hz": 20, "duration_s": 72, "sky.source": "nominal", "method": "covariance",
    "integrity": {"method": "mhss"}, "pseudolites": {"clock": "gps", "height_m": 5, "sites": [EAST, WEST]},
}  # fmt: skip
WALL = {"ends": [{"lat_deg": 56.0035, "lon_deg": 37.005}, {"lat_deg": 56.016, "lon_deg": 37.006}], "height_m": 35}
"""Right of the approach, before the pseudolite in the east."""
BANK = {"ends": [{"lat_deg": 56.0145, "lon_deg": 36.997}, {"lat_deg": 56.019, "lon_deg": 36.997}], "height_m": 70}
"""Left of the runway's beginning, and high enough for satellites."""


def field(terrain: list[dict[str, Any]], **more: Any) -> Case:
    given = FIELD | {"terrain": terrain} | more
    return case(*(f"{key}={json.dumps(value)}" for key, value in given.items()))


@pytest.fixture(scope="module")
def hilly() -> Case:
    return field([WALL, BANK])


def cartesian(lat: float, lon: float, height: float) -> np.ndarray:
    """A place, deg, deg, m, ECEF, by the ellipsoid's equation."""
    a, f = 6378137.0, 1.0 / 298.257223563
    e2, phi, lam = f * (2.0 - f), np.radians(lat), np.radians(lon)
    n = a / np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
    across = (n + height) * np.cos(phi)
    return np.array([across * np.cos(lam), across * np.sin(lam), (n * (1.0 - e2) + height) * np.sin(phi)])


def hidden_by_hand(wall: dict[str, Any], source: np.ndarray, antenna: np.ndarray) -> tuple[bool, float]:
    """Whether the line from a source to an antenna, (3,) ECEF, m, goes through an upright wall under its top, and by
    how much it misses the edge of what it hides, m: P + t (R - P) = A + u (B - A) + v up."""
    (a, b) = (cartesian(end["lat_deg"], end["lon_deg"], wall["height_m"]) for end in wall["ends"])
    lat, lon = (np.radians(0.5 * sum(end[key] for end in wall["ends"])) for key in ("lat_deg", "lon_deg"))
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    t, u, v = np.linalg.solve(np.column_stack([antenna - source, a - b, -up]), a - source)
    inside = 0.0 < t < 1.0 and 0.0 <= u <= 1.0
    return inside and v < 0.0, min(abs(v), np.linalg.norm(b - a) * min(abs(u), abs(1.0 - u)))


def test_what_a_wall_hides_is_by_hand(hilly: Case) -> None:
    """Of each source at each fix; both kinds of it, and neither, are there."""
    open_field, s = field([]).shared.signals, hilly.shared.signals
    assert s.used.shape == open_field.used.shape
    close = 0
    for e, i in np.ndindex(*s.used.shape):
        sights = (hidden_by_hand(wall, s.position[e, i], s.antenna[e]) for wall in (WALL, BANK))
        hidden, gaps = zip(*sights, strict=True)
        if min(gaps) < 1e-3:
            close += 1
            continue
        assert s.used[e, i] == (open_field.used[e, i] and not any(hidden))
    assert close < 10
    lost = (open_field.used & ~s.used).sum(axis=0)
    assert all(5 < times < 60 for times in lost[-2:])
    assert lost[:-2].any()  # a satellite


def test_only_what_is_low_is_asked() -> None:
    """Hidden is what it would be if each source were held against each ridge: rolling ridges, near and far, also below
    the antenna, sources from under the horizon to overhead."""
    rng = np.random.default_rng(3)
    antenna = np.array([cartesian(56.0, 37.0 + 1e-3 * k, 100.0 + 40.0 * k) for k in range(6)])
    ends = rng.uniform([55.97, 36.95], [56.03, 37.05], (90, 2, 2))
    tops = np.array([[cartesian(*end, height) for end in pair]
                     for pair, height in zip(ends, rng.uniform(0.0, 120.0, 90), strict=True)])  # fmt: skip
    places = rng.uniform([55.8, 36.6, 0.0], [56.2, 37.4, 3e3], (60, 3))
    sources = np.repeat(np.array([cartesian(*place) for place in places])[None], 6, axis=0)
    sources[:, 0] = np.nan
    found = horizon.behind(horizon.Terrain(tops), sources, antenna)
    for i in range(60):
        c = crossings(tops, sources[:, i, None], antenna)
        np.testing.assert_array_equal(found[:, i], (c.between & (c.over > 0.0)).any(axis=1))
    assert 0.05 < found.mean() < 0.95


def test_what_ridges_hide_of_the_sky_ends_where_they_begin_to_hide() -> None:
    """Far points a hair under and over the elevation that random ridges reach: hidden, and not."""
    rng = np.random.default_rng(8)
    azimuth = np.linspace(0.0, 2.0 * np.pi, 721)
    hidden = 0
    for _ in range(10):
        eye = cartesian(56.0, 37.0, rng.uniform(0.0, 100.0))
        ends = rng.uniform([55.97, 36.95], [56.03, 37.05], (6, 2, 2))
        tops = np.array([[cartesian(*end, height) for end in pair]
                         for pair, height in zip(ends, rng.uniform(0.0, 150.0, 6), strict=True)])  # fmt: skip
        edge = skyline_elevation(tops, eye, azimuth)
        sides = np.degrees(np.abs(np.diff(edge, prepend=edge[-2]))) > 1.0  # where a ridge ends, its side is upright
        for off, wanted in ((-1e-5, edge > -0.5 * np.pi), (1e-5, np.zeros(azimuth.size, bool))):
            at = np.where(edge > -0.5 * np.pi, edge + off, off)
            away = 1e6 * unit_vector(azimuth, at) @ enu_matrix(llh_from_ecef(eye))
            found = horizon.behind(horizon.Terrain(tops), (eye + away)[None], eye[None])[0]
            np.testing.assert_array_equal(found[~sides], wanted[~sides])
            hidden += int(found.sum())
    assert hidden > 1250


@pytest.fixture(scope="module")
def result(hilly: Case) -> Result:
    return covariance_result(hilly, covariance_analysis(hilly), 1)


def test_what_is_hidden_is_counted_by_name(hilly: Case, result: Result) -> None:
    """Satellites as pseudolites; in the table those satellites alone that are hidden at some time."""
    lost = (field([]).shared.signals.used & ~hilly.shared.signals.used).sum(axis=0)
    np.testing.assert_array_equal(result["/geometry/behind_terrain"], lost)
    rows = {row.texts()[0].strip(): row.texts()[1] for row in summary_table([("", result)]).rows}
    for name, times in zip(hilly.shared.signals.names, lost, strict=True):
        assert rows.get(name) == (f"{times} of 72" if times else None), name
    assert 2 < (lost > 0).sum() < len(lost)
    assert not [said for said in hilly.warnings if said.startswith("terrain")]
    high = field([WALL | {"height_m": 300}])
    said = "terrain: east is behind it during the whole flight and never received; move it, or the ridge"
    assert said in high.warnings
    given = (f"{key}={json.dumps(value)}" for key, value in (FIELD | {"terrain": [WALL | {"height_m": 300}]}).items())
    told = checked(SCENARIOS / "landing.yaml", [*given])[2]
    assert [text for text in told if text.startswith("terrain")] == [said]


def test_terrain_hides_jammers_as_their_own_horizon_does() -> None:
    van = {"name": "van", "place": {"lat_deg": 56.012, "lon_deg": 37.012}, "eirp_dbw": -10, "waveform": "noise",
           "bandwidth_mhz": 20}  # fmt: skip
    js = []
    for ridges, terrain in (([], []), ([WALL], []), ([], [WALL])):
        js.append(field(terrain, interference={"jammers": [van], "horizon": ridges}).shared.signals.js)
    both = np.isfinite(js[1]) & np.isfinite(js[2])
    np.testing.assert_array_equal(js[1][both], js[2][both])
    assert (js[0] - js[2])[both].max() > 10.0


def unfolded(given: dict[str, Any]) -> dict[str, Any]:
    """The data of the shipped scenario with dotted keys set."""
    data: dict[str, Any] = load(SCENARIOS / "landing.yaml").data
    for key, value in given.items():
        *sections, last = key.split(".")
        node = data
        for section in sections:
            node = node.setdefault(section, {})
        node[last] = value
    return data


def test_all_that_plans_sees_it(hilly: Case, result: Result, tmp_path: Path) -> None:
    """Sweeps by geometry and by filters, searches and the planner, against the landing behind the same wall."""
    wanted = filter_outputs(result) | {
        name: float(
            start_result(hilly, COVARIANCE)[f"/summary/dop/{name.removesuffix('_max')}"][2 * name.endswith("_max")]
        )
        for name in ("pdop", "hdop", "vdop", "pdop_max")
    }
    plain = field([])
    free = float(start_result(plain, COVARIANCE)["/summary/dop/pdop"][0])
    assert wanted["pdop"] > 1.002 * free
    given = FIELD | {"terrain": [WALL, BANK]}
    vary = json.dumps([{"key": "pseudolites.sites", "values": [[EAST, WEST]]}])
    head = f"version: 1\nbase: {SCENARIOS / 'landing.yaml'}\nset: {json.dumps(given)}\n"
    for method, names in (("dop", DOP_OUTPUTS), ("covariance", FILTER_OUTPUTS)):
        path = tmp_path / f"{method}.yaml"
        path.write_text(f"kind: sweep\n{head}vary: {vary}\nmethod: {method}\n")
        planned = plan(*read_study(path, Sweep, []), 1)
        assert (planned.geometry is not None) == (method == "dop")
        rows, _, _ = SweepStudy(planned).batch(0, 1)
        for name in set(names) & set(wanted):
            assert rows[name][0] == pytest.approx(wanted[name], rel=1e-9), name
    places = np.array([[[EAST["s_m"], EAST["l1_m"]], [WEST["s_m"], WEST["l1_m"]]]], float)
    area = "area: {s_m: [-900, 900], l1_m: [0, 900]}\npseudolites: [2]\nheight_m: 5\n"
    for name in ("pdop", "horizontal"):
        path = tmp_path / f"{name}.yaml"
        path.write_text(f"kind: optimize\n{head}{area}objective: {name}\n")
        here = objective.problem(*read_study(path, Optimize, []))
        assert here.level_screen is None
        assert here.objective(places)[0] == pytest.approx(wanted[name], rel=1e-9)
    lines = [f"{key}: {json.dumps(value)}" for key, value in unfolded(given).items()]
    (tmp_path / "field.yaml").write_text("\n".join(lines))
    proposal = PlannedScenario(load(tmp_path / "field.yaml"), "\n".join(lines))
    outlook = Outlook(proposal)
    found = {name: outlook.judge(name, proposal.names)(proposal.places()[None])[0] for name in ("pdop", "hpl_p95")}
    assert found["pdop"] == pytest.approx(wanted["pdop"], rel=1e-9)
    levels = outlook.found().figures
    assert found["hpl_p95"] == pytest.approx(levels["integrity/hpl_p95"], rel=0.1)  # at some epochs of the glide


ACROSS = {"ends": [{"lat_deg": 56.009, "lon_deg": 36.9985}, {"lat_deg": 56.009, "lon_deg": 37.0015}], "height_m": 160}
"""Along a parallel, across the approach."""


def test_a_ridge_that_is_flown_through_is_told(result: Result) -> None:
    """How far under its top, from where the way is at its parallel; and nothing of ridges that it goes over."""
    lat, _, height = result["/truth/position_llh"].T
    lat = np.degrees(lat)
    over = float(np.interp(56.009, lat, height)) - float(result["/truth/threshold_llh"][2])
    assert 20.0 < over < 150.0
    high = field([WALL, ACROSS])
    (said,) = [each for each in through_ridges(high.scenario, high.trajectory) if "flight goes through" in each]
    assert said in high.warnings
    when, under = (float(word) for word in re.findall(r"[0-9.]+(?= s,| m under)", said))
    assert said.startswith("terrain[1]:")
    assert under == pytest.approx(160.0 - over, abs=0.06)
    assert when == pytest.approx(float(np.interp(56.009, lat, result["/truth/time"])), abs=0.25)
    given = [f"{key}={json.dumps(value)}" for key, value in (FIELD | {"terrain": [WALL, ACROSS]}).items()]
    assert said in checked(SCENARIOS / "landing.yaml", given)[2]
    assert not through_ridges(*(getattr(field([ACROSS | {"height_m": over - 1.0}]), name)
                                for name in ("scenario", "trajectory")))  # fmt: skip


def test_what_is_drawn_is_what_is_hidden(hilly: Case, result: Result) -> None:
    """The skyline of the figures against the models' own sights to far points all around; ridges where they are given;
    the way over one of them."""
    seen = terrain_skyline(result)
    assert seen is not None
    azimuth, skyline = seen
    rng = np.random.default_rng(5)
    some = np.column_stack([rng.uniform(0.0, 2.0 * np.pi, 3000), rng.uniform(-0.02, 0.6, 3000)])
    eye = hilly.shared.signals.antenna[-1]
    away = 1e6 * unit_vector(some[:, 0], some[:, 1]) @ enu_matrix(llh_from_ecef(eye))
    hidden = horizon.behind(hilly.environment.terrain, (eye + away)[None], eye[None])[0]
    over = np.interp(some[:, 0], azimuth, skyline) - some[:, 1]
    sure = np.abs(over) > np.radians(0.3)  # azimuths are a quarter of a degree apart
    assert (hidden[sure] == (over[sure] > 0.0)).mean() > 0.999
    assert hidden.any()
    first, second = shown_ridges(result)
    assert (first.label, second.label) == ("35 m", "70 m")
    for ridge, given in ((first, WALL), (second, BANK)):
        ends = np.array([[end["lat_deg"], end["lon_deg"]] for end in given["ends"]])
        threshold = np.degrees(result["/truth/threshold_llh"][:2])
        along = 111.36e3 * (ends[:, 0] - threshold[0])  # by the meridian's radius; the landing heads north
        right = 111.32e3 * np.cos(np.radians(56.01)) * (ends[:, 1] - threshold[1])
        np.testing.assert_allclose(ridge.places[:, :2], np.column_stack([along, right]), atol=6.0)
    assert flown_over(result) == []
    (crossed,) = flown_over(covariance_result(across := field([ACROSS]), covariance_analysis(across), 1))
    assert crossed.along == pytest.approx(111.36e3 * (56.009 - np.degrees(result["/truth/threshold_llh"][0])), abs=3.0)
    assert crossed.top == pytest.approx(160.0, abs=0.1)


def test_ridges_are_cut_to_the_plan() -> None:
    cross = ShownRidge(np.array([[-100.0, -50.0, 0.0], [100.0, 50.0, 0.0], [100.0, 500.0, 0.0]]), 0.0)
    np.testing.assert_allclose(clipped(cross, (-20.0, 40.0), (-90.0, 90.0)), [[[-20.0, -10.0], [40.0, 20.0]]])
    np.testing.assert_allclose(clipped(cross, (90.0, 110.0), (60.0, 70.0)), [[[100.0, 60.0], [100.0, 70.0]]])
    assert clipped(cross, (0.0, 10.0), (50.0, 60.0)).shape == (0, 2, 2)


def test_ridges_are_in_maps_for_others(result: Result, tmp_path: Path) -> None:
    kml, geojson = export(result, tmp_path / "hilly", ["kml", "geojson"])
    drawn = [each for each in json.loads(geojson.read_text())["features"] if each["properties"]["kind"] == "ridge"]
    assert [each["properties"]["height_m"] for each in drawn] == [35.0, 70.0]
    ends = [[end["lon_deg"], end["lat_deg"], WALL["height_m"]] for end in WALL["ends"]]
    np.testing.assert_allclose(drawn[0]["geometry"]["coordinates"], ends, atol=1e-6)
    assert drawn[0]["geometry"]["type"] == "LineString"
    assert kml.read_text().count("<styleUrl>#ridge</styleUrl>") == 2
