"""What is told of a file before anything is computed: files that are not there, and what flying it would warn of."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from navsim.kinds import OF_FILES
from navsim.landing.study import prepare
from navsim.runner.errors import BadInput
from navsim.runner.opening import checked
from navsim.scenario.load import read, section
from navsim.scenario_files.keys import rows
from tests.conftest import SCENARIOS
from tests.helpers import in_brief

NAMING = [
    ("landing", ["sky.source=almanac", "sky.almanac=none.agl"], "sky.almanac"),
    ("landing", ["sky.source=navigation", "sky.navigation=[none.rnx]"], "sky.navigation"),
    ("landing", ["sky.source=orbits", "sky.orbits=none.sp3"], "sky.orbits"),
    ("landing", ["sky.horizon=none.csv"], "sky.horizon"),
    ("landing", ["terrain=[{file: none.hgt, height_above: ellipsoid}]"], "terrain.N.file"),
    ("landing", ["imu={from: none.h5}"], "imu.from"),
    ("landing", ["signals.from=none.h5"], "signals.from"),
    ("track", ["approach.file=none.csv"], "approach.file"),
    ("recorded_flight", ["imu.file=none.csv"], "imu.file"),
    ("recorded_flight", ["gnss.file=none.csv"], "gnss.file"),
    ("recorded_flight", ["gnss.navigation=none.rnx"], "gnss.navigation[0]"),
    ("recorded_flight", ["reference.file=none.csv"], "reference.file"),
    ("recorded_flight", ["heading.file=none.csv"], "heading.file"),
    ("placement_sweep", ["base=none.yaml"], "base"),
    ("placement_optimum", ["base=none.yaml"], "base"),
    ("placement_optimum", ["constraints.keep_out=none.geojson"], "constraints.keep_out"),
    ("placement_optimum", ["constraints.permission=none.geojson"], "constraints.permission"),
]
"""Template, what names a file that is not there, the key that is blamed."""


@pytest.mark.parametrize(("name", "given", "key"), NAMING, ids=[f"{name}-{key}" for name, _, key in NAMING])
def test_files_that_are_not_there(name: str, given: list[str], key: str) -> None:
    with pytest.raises(BadInput) as caught:
        checked(SCENARIOS / f"{name}.yaml", given)
    (problem,) = caught.value.problems
    assert "cannot be read: No such file or directory" in problem.message or "no such file" in problem.message
    # of a base the file itself is named, and where it stands behind it
    assert problem.key == key.replace(".N.", ".0.") or f"named at --set {key}=" in problem.message


def test_every_key_that_names_a_file_is_tried() -> None:
    """Those that have a checksum beside them, results of replays, and the bases of studies."""
    named = set()
    for kind in OF_FILES:
        keys = {row.key for row in rows(section(kind).model_json_schema())}
        named |= {key for key in keys if f"{key}_sha256" in keys or key == "base" or key.endswith(".from")}
    assert named == {key.partition("[")[0] for _, _, key in NAMING}


def test_a_file_is_read_as_whoever_flies_does(tmp_path: Path) -> None:
    """With its line, and the place that names it."""
    shutil.copy(SCENARIOS / "odense.yaml", tmp_path / "mine.yaml")
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "odense_horizon.csv").write_text("azimuth_deg,elevation_deg\n0,3\n10,north\n")
    with pytest.raises(BadInput) as caught:
        checked(tmp_path / "mine.yaml", [])
    (problem,) = caught.value.problems
    assert str(problem).startswith(f"{tmp_path / 'data' / 'odense_horizon.csv'}:3")
    assert f"named at {tmp_path / 'mine.yaml'}:" in problem.message


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["duration_s=20"], "touchdown would be at 60.2 s"),
        (["pseudolites.s_m=60000"], "beyond the radio horizon of the whole flight"),
        (["box={lateral_m: [1, 2], vertical_m: 1}"], "box: the route itself is outside lateral_m"),
        (["box={error: touchdown, from_threshold_m: [-90, -60]}", "approach.guidance=estimate"],
         "box: the route itself is outside from_threshold_m: it is then 0 m beyond the threshold"),
        (["box={lateral_m: 1, vertical_m: 1, height_m: 152.9}"], "before the first fix"),
        (["events=[{what: step, sources: [R01], at_s: 0, until_s: 9, error_m: 3}]", "sky.exclude=[R01]"],
         "none of them is received then"),
        (["sky.source=nominal", "sky.systems=[gps]", "sky.exclude=[R05, G01, R07]"],
         "sky.exclude: R05 (glonass), R07 (glonass): not used anyway, systems are gps"),
        (["integrity={method: mhss, p_constellations: {gps: 1e-5}}"], "the sky has none of them"),
        (["integrity={method: mhss, p_constellation: 1.0e-8}"], "levels allow for one independent error an approach"),
        (["integrity={method: mhss, limits: {operation: APV-I, tta_s: 10}}"], "here 150 s / 10 s = 15"),
        (["integrity={method: chi2}", "signals.ephemeris={}"], "no level contains the errors of signals.ephemeris,"),
        (["receiver.antenna={elevation_deg: [-90, 90], gain_dbi: [0, 0], mask_deg: 20}"], "the aircraft shadows PL1"),
        (["signals.system_offsets_ns={galileo: 3}"], "no source keeps the time of galileo"),
    ],
)  # fmt: skip
def test_warnings_are_those_of_the_flight(given: list[str], said: str) -> None:
    file = SCENARIOS / "landing.yaml"
    told = checked(file, given)[2]
    assert any(said in text for text in told), told
    assert told == prepare(*read(file, [*given, "imu.rate_hz=20"])).warnings


@pytest.mark.parametrize(("smoothing", "warned"), [(100, True), (150, False)])
def test_levels_are_for_one_error_an_approach_if_all_of_it_lasts(smoothing: float, warned: bool) -> None:
    given = ["integrity={method: mhss, p_constellation: 1.0e-8}", "signals.preset=open-sky"]
    told = checked(SCENARIOS / "landing.yaml", [*given, f"receiver.smoothing_s={smoothing}"])[2]
    assert any("effective_samples" in text for text in told) == warned


@pytest.mark.parametrize("study", in_brief(["placement_sweep", "placement_optimum"], 1))
def test_studies_warn_of_levels_as_landings_do(study: str) -> None:
    given = ["set.integrity={method: mhss}", *(["objective=pdop"] if study == "placement_optimum" else [])]
    assert any("effective_samples" in text for text in checked(SCENARIOS / f"{study}.yaml", given)[2])


SILENCE = "events=[{what: silence, sources: [all], at_s: 5, until_s: 9}]"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["receiver.latency_s=5", "duration_s=4"], "the filter never gets a fix; give a shorter latency"),
        (["receiver.rate_hz=0.01"], "the filter never gets a fix; give a higher rate"),
        (["sky.mask_deg=89.9", "pseudolites.count=0"], "no source is received. A fix needs four"),
        (["sky.mask_deg=89.9", "pseudolites.count=0"], "; lower sky.mask_deg, or add"),
        ([SILENCE], "without events[0] (silence from 5 s on) there are enough at 40 of these epochs"),
        ([SILENCE, "sky.mask_deg=89.9"], "lower sky.mask_deg, or add"),
        ([SILENCE, "filter.coupling=tight", "sky.mask_deg=50"], "40 of 100 epochs without a pseudorange: too few"),
    ],
)
def test_fixes_that_no_source_gives_are_warned_of(given: list[str], said: str) -> None:
    """With what takes them: latency, rate, mask, or an event."""
    _, _, warnings = checked(SCENARIOS / "landing.yaml", ["duration_s=10", *given])
    (about,) = (text for text in warnings if "touchdown" not in text)
    assert said in about
    assert ("sky.mask_deg" in about) == (any("mask" in each for each in given) and "tight" not in str(given))


@pytest.mark.parametrize(
    ("name", "given"),
    [("placement_sweep", ["vary=[{key: pseudolites.s_m, values: [200, 300]}]"]), ("placement_optimum", [])],
)
def test_studies_without_fixes_are_warned_of(name: str, given: list[str]) -> None:
    """Of a search only what no pseudolites can give."""
    _, _, before = checked(SCENARIOS / f"{name}.yaml", given)
    assert not any("no fix" in text for text in before)
    _, _, warnings = checked(SCENARIOS / f"{name}.yaml", [*given, "set={sky.mask_deg: 89.9}"])
    assert any("received. A fix needs four" in text for text in warnings)


def test_a_box_that_is_never_passed_is_refused() -> None:
    with pytest.raises(BadInput, match="never comes down through 500 m above the runway within duration_s"):
        checked(SCENARIOS / "landing.yaml", ["box={lateral_m: 1, vertical_m: 1, height_m: 500}"])


@pytest.mark.parametrize(
    ("given", "index", "said"),
    [
        (["sky.exclude=[R01, G05]"], 1, "`source: nominal-glonass` has no 'G05'; did you mean 'R05'? allowed: R01"),
        (["sky.source=nominal", "sky.exclude=[G33, R05]"], 0, "`source: nominal` has no 'G33'"),
        (["sky.source=almanac", f"sky.almanac={SCENARIOS / 'data' / 'nominal.agl'}", "epoch=2018-09-13T12:00:00Z",
          "sky.exclude=[G02]"], 0, "`source: almanac` has no 'G02'"),
        (["sky.source=directions", "sky.directions=[{azimuth_deg: 0, elevation_deg: 50}]", "sky.exclude=[X01, X02]"],
         1, "`source: directions` has no 'X02'; did you mean 'X01'? allowed: X01"),
    ],
)  # fmt: skip
def test_satellites_to_exclude_that_are_not_there_are_refused(given: list[str], index: int, said: str) -> None:
    with pytest.raises(BadInput) as caught:
        checked(SCENARIOS / "landing.yaml", given)
    (problem,) = caught.value.problems
    assert (problem.key, problem.file) == (f"sky.exclude.{index}", f"--set {given[-1]}")
    assert problem.message.startswith(said)
