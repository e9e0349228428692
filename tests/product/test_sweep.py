"""`navsim sweep`: cubes, tables, maps; killed, damaged, refused, and always the same numbers in the end."""

from __future__ import annotations

import csv
import json
import signal
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from navsim.landing.study import covariance_analysis, covariance_result
from navsim.results.result import read
from tests import forks
from tests.conftest import SCENARIOS
from tests.forks import navsim
from tests.helpers import case, in_brief
from tests.layout import as_declared
from tests.product.test_run import stored
from tests.steps import KILL, PIECE

BASE = SCENARIOS / "landing_gnss_only.yaml"


def study(place: Path, name: str, text: str) -> Path:
    file = place / f"{name}.yaml"
    file.write_text(f"kind: sweep\nversion: 1\nbase: {BASE}\n{text}")
    return file


GRID = """
set: {pseudolites.frame: runway, receiver.rate_hz: 0.5}
vary:
  - {key: pseudolites.count, values: [1, 2]}
  - {key: pseudolites.s_m, grid: {first: 50, last: 2000, count: 45}}
  - {key: pseudolites.l1_m, range: {first: -500, last: 4000, step: 100}}
outputs: [pdop, vdop_max, fix_vertical]
"""
SIZE = 2 * 45 * 46


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sweep")


ALMANAC = "set: {pseudolites.count: 0, sky.source: almanac, sky.almanac: [data/nominal.agl]}\n"
DOUBTFUL: dict[str, tuple[str, int, tuple[str, ...]]] = {
    "a key that ends like a dimension of the result": (
        "set: {pseudolites.differential: {}, pseudolites.count: 0,\n"
        "  pseudolites.sites: [{name: A, s_m: 100, l1_m: 500}, {name: B, s_m: -100, l1_m: 500}]}\n"
        "vary: [{key: pseudolites.differential.site, values: [A, B]}, {key: receiver.rate_hz, values: [1, 5]}]",
        4,
        (),
    ),
    "numbers beyond 64 bits": (
        f"vary: [{{key: pseudolites.count, values: [0, {10**30}]}}]",
        1,
        ("no valid scenario", f"count {10**30}"),
    ),
    "files by their place in a list": (
        f"{ALMANAC}vary: [{{key: sky.almanac.0, values: [data/nominal.agl, data/other.agl]}}]",
        1,
        ("other.agl",),
    ),
    "a user that is not there": (
        "set: {pseudolites.count: 0, sky.source: almanac}\n"
        'vary: [{key: sky.almanac, values: [data/nominal.agl, "~nosuchuser/x"]}]',
        1,
        ("nosuchuser",),
    ),
    "horizons": (
        "vary: [{key: sky.horizon, values: [null, data/odense_horizon.csv, data/other.csv]}]",
        2,
        ("other.csv",),
    ),
    "a value in the way of another key": (
        "vary: [{key: sky, values: [{source: nominal-gps}, abc]}, {key: sky.source, values: [nominal-glonass]}]",
        1,
        ("sky abc",),
    ),
    "a recorded approach": (
        "vary: [{key: approach.profile, values: [smooth, recorded]}]",
        1,
        ("approach.profile recorded",),
    ),
    "a flight that ends in the air": (
        "method: covariance\noutputs: [horizontal, vertical_touchdown]\nset: {imu.rate_hz: 10, receiver.rate_hz: 1}\n"
        "vary: [{key: duration_s, values: [70, 20]}]",
        2,
        ("in 1 of 2 combinations the input has warnings; the first: duration_s 20: touchdown would be",),
    ),
    "a pseudolite on the runway": (
        "set: {pseudolites: {count: 1, frame: runway, l1_m: -500}}\nvary: [{key: pseudolites.s_m, values: [200, 14]}]",
        2,
        ("in 1 of 2 combinations the input has warnings; the first: pseudolites.s_m 14: pseudolites on the pavement",),
    ),
}
"""Studies of which not all combinations are in order: their text, how many are computed, what is said."""


@pytest.mark.parametrize("name", in_brief(DOUBTFUL, 0, 2, 4, 5, 8))
def test_doubtful_combinations_are_computed_or_named(name: str, tmp_path: Path) -> None:
    """And what was computed can be shown again."""
    text, computed, words = DOUBTFUL[name]
    (tmp_path / "data").symlink_to(SCENARIOS / "data")
    done = navsim("sweep", study(tmp_path, "s", text), "-o", "s.h5", "--figures", "none", cwd=tmp_path)
    assert ("warning" in done.stderr) == bool(words)
    for word in words:
        assert word in done.stderr
    result = read(tmp_path / "s.h5")
    assert int(np.sum(result["/outcome/combination"] == 0)) == computed
    navsim("show", "s.h5", cwd=tmp_path)


@pytest.fixture(scope="module")
def grid(place: Path) -> Path:
    """A geometry sweep left alone."""
    file = study(place, "grid", GRID)
    done = navsim("sweep", file, "-o", "grid.h5", "--figures", "none", cwd=place)
    assert "best" in done.stdout
    assert not Path(f"{place}/grid.h5.partial").exists()
    return place / "grid.h5"


def test_cube_and_table_hold_the_same(grid: Path) -> None:
    tree = xr.open_datatree(grid, engine="h5netcdf")
    assert tree["sweep/pdop"].sizes == {"count": 2, "s_m": 45, "l1_m": 46}
    assert float(tree["sweep/axes/l1_m"][-1]) == 4000.0
    result = read(grid)
    as_declared(result)
    with open(grid.with_suffix(".csv"), newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == SIZE
    middle = rows[1 * 45 * 46 + 7 * 46 + 3]
    assert (middle["count"], float(middle["l1_m"])) == ("2", -200.0)
    assert float(middle["pdop"]) == pytest.approx(result["/sweep/pdop"][1, 7, 3], rel=1e-9)


def test_each_combination_is_the_scenario_by_itself(grid: Path) -> None:
    """Cells against landings prepared one by one."""
    result = read(grid)
    for index in ((0, 0, 0), (1, 7, 3), (1, 44, 45)):
        s, l1 = result["/s_m"][index[1]], result["/l1_m"][index[2]]
        one = case(
            "pseudolites.frame=runway", "receiver.rate_hz=0.5", f"pseudolites.count={index[0] + 1}",
            f"pseudolites.s_m={s}", f"pseudolites.l1_m={l1}", name="landing_gnss_only",
        )  # fmt: skip
        glide = one.shared.signals.time <= 60.19
        assert result["/sweep/pdop"][index] == pytest.approx(one.shared.dop[glide, 1].mean(), rel=1e-12)
        assert result["/sweep/vdop_max"][index] == pytest.approx(one.shared.dop[glide, 3].max(), rel=1e-12)
        up = np.sqrt(one.shared.fix_covariance[glide, 2, 2]).mean()
        assert result["/sweep/fix_vertical"][index] == pytest.approx(up, rel=1e-12)


@pytest.mark.long
def test_killed_twice_with_damage_on_the_way(place: Path, grid: Path) -> None:
    """SIGKILL twice, a finished batch damaged, another number of workers: the same in the end."""
    file = study(place, "grid", GRID)
    target = place / "killed.h5"
    folder = Path(f"{target}.partial")
    command = ("sweep", file, "-o", target, "-q", "--workers", 1)
    for kept in (1, 2):
        done = forks.shared().run(*command, cwd=place, what=KILL, at=2, of=PIECE)
        assert done.code == -signal.SIGKILL
        assert len(list(folder.glob("*.npz"))) == kept
        assert not target.exists()
    victim = min(folder.glob("*.npz"))
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 1
    victim.write_bytes(content)
    done = navsim("sweep", file, "-o", target, "--workers", 2, "--figures", "none", cwd=place)
    assert "1 damaged piece" in done.stderr
    assert stored(target) == stored(grid)
    assert target.with_suffix(".csv").read_bytes() == grid.with_suffix(".csv").read_bytes()
    assert not folder.exists()


def test_methods_that_fly_a_filter(place: Path) -> None:
    """Covariance cells are those of `navsim run --method covariance`; runs agree with them, with intervals."""
    text = """
set: {imu.rate_hz: 20, receiver.rate_hz: 1, duration_s: 65, initial_errors.attitude_deg: 1, imu.gyro.drift_deg_h: 70}
vary:
  - keys: [pseudolites.count, pseudolites.s_m, pseudolites.l1_m]
    values: [[0, 0, 0], [2, 200, 1000]]
  - {key: filter.velocity, values: [true, false]}
outputs: [pdop, horizontal, vertical_200ft]
"""
    file = study(place, "filters", text)
    navsim("sweep", file, "--method", "covariance", "-o", "covariance.h5", "-q", cwd=place)
    navsim("sweep", file, "--method", "monte-carlo", "--runs", 200, "-o", "runs.h5", "-q", cwd=place)
    assert not (place / "covariance.h5.partial").exists()  # nor the runs of the best by vertical_200ft
    linear, flown = read(place / "covariance.h5"), read(place / "runs.h5")
    as_declared(linear)
    as_declared(flown)
    assert linear["/sweep/horizontal"].shape == (2, 2)
    one = case(
        "imu.rate_hz=20", "receiver.rate_hz=1", "duration_s=65", "initial_errors.attitude_deg=1",
        "imu.gyro.drift_deg_h=70",
        "pseudolites.count=2", "pseudolites.s_m=200", "pseudolites.l1_m=1000", "filter.velocity=false",
        name="landing_gnss_only",
    )  # fmt: skip
    alone = covariance_result(one, covariance_analysis(one), 1)
    assert linear["/sweep/horizontal"][1, 1] == pytest.approx(alone["/summary/rms/horizontal"][0])
    assert linear["/sweep/vertical_200ft"][1, 1] == pytest.approx(alone["/summary/at/vertical"][3, 0])
    ratio = flown["/sweep/horizontal"] / linear["/sweep/horizontal"]
    assert np.all(np.abs(ratio - 1.0) < 0.15), ratio
    assert np.all(flown["/sweep/horizontal_low"] < flown["/sweep/horizontal"])
    assert np.all(np.diff(linear["/sweep/horizontal"], axis=0) < 0)
    assert "PDOP" in navsim("show", "covariance.h5", cwd=place).stdout


def test_runs_of_the_best_judge_requirements_that_are_no_output(place: Path) -> None:
    """In the table, in the result, as JSON; a warning names those that a best combination misses, another how to have a
    verdict on each.

    Seen before: no word of the base's requirements.
    """
    text = """
method: covariance
set:
  imu.rate_hz: 20
  receiver.rate_hz: 1
  duration_s: 65
  requirements: [{what: rms, of: vertical, below_m: 90}, {what: rms, of: horizontal, below_m: 0.001}]
vary: [{keys: [pseudolites.count, pseudolites.s_m, pseudolites.l1_m], values: [[0, 0, 0], [2, 200, 1000]]}]
outputs: [pdop, horizontal, vertical]
"""
    file = study(place, "judged", text)
    done = navsim("sweep", file, "--runs", 8, "-o", "judged.h5", "--figures", "none", cwd=place)
    said = " ".join(done.stderr.split())
    assert f"the sweep has no verdicts on the requirements of {BASE}; navsim judges by them only the best" in said
    missed = "runs of the best combination don't meet: horizontal RMS error before touchdown below 0.001 m"
    assert f"horizontal: {missed}" in said
    result = read(place / "judged.h5")
    as_declared(result)
    assert result["/flown/requirements/output"].tolist() == ["horizontal", "vertical"]
    assert result["/flown/requirements/verdict"].tolist() == [["met", "not met"]] * 2
    value, low, high = result["/flown/requirements/value"][0, 1]
    assert 0.001 < low < value < high
    assert value == pytest.approx(result["/flown/horizontal"][0])
    assert "Requirements of the best combinations, by runs" in done.stdout
    best = json.loads(navsim("show", "judged.h5", "--json", cwd=place).stdout)
    assert [one["verdict"] for one in best["horizontal"]["requirements"]] == ["met", "not met"]
    varied = text.replace("vary: [", "vary: [{key: requirements.1.below_m, values: [1]}, ")
    navsim("sweep", study(place, "varied", varied), "--runs", 8, "-o", "varied.h5", "-q", cwd=place)
    assert "/flown/requirements/verdict" not in read(place / "varied.h5")


def test_latin_hypercube(place: Path) -> None:
    text = """
samples: 10
set: {pseudolites.frame: runway, pseudolites.count: 1, receiver.rate_hz: 1, imu.rate_hz: 10, duration_s: 61}
vary:
  - {key: pseudolites.s_m, lhs: {first: 100, last: 500}}
  - {key: pseudolites.l1_m, lhs: {first: 0, last: 4000}}
  - {key: sky.mask_deg, values: [5, 10]}
outputs: [pdop]
"""
    file = study(place, "cube", text)
    navsim("sweep", file, "-o", "cube.h5", "-q", cwd=place)
    result = read(place / "cube.h5")
    assert result["/sweep/pdop"].shape == (10, 2)
    bins = np.floor((result["/sweep/axes/s_m"] - 100.0) / 40.0).astype(int)
    assert sorted(bins) == list(range(10))  # one sample in each tenth
    assert np.all(result["/sweep/pdop"][:, 1] >= result["/sweep/pdop"][:, 0])
    navsim("sweep", file, "--seed", 2, "-o", "cube2.h5", "-q", cwd=place)
    assert not np.array_equal(read(place / "cube2.h5")["/sweep/axes/s_m"], result["/sweep/axes/s_m"])


def test_impossible_combinations_are_nan_and_named(place: Path) -> None:
    """A pseudolite under the wheels at touchdown is no scenario; the others are computed."""
    text = """
set: {pseudolites.frame: runway, pseudolites.count: 1, receiver.rate_hz: 1, imu.rate_hz: 10, duration_s: 61}
vary:
  - {key: pseudolites.s_m, values: [1, 100]}
  - {key: pseudolites.l1_m, values: [0, 1000]}
"""
    for method, bad in (("dop", 1), ("covariance", 1)):
        outputs = "outputs: [pdop]" if method == "dop" else "outputs: [pdop, horizontal]"
        file = study(place, f"wheels_{method}", text + outputs)
        done = navsim("sweep", file, "--method", method, "-o", f"wheels_{method}.h5", "-q", cwd=place)
        result = read(place / f"wheels_{method}.h5")
        assert np.isnan(result["/sweep/pdop"]).sum() == bad
        assert np.isnan(result["/sweep/pdop"][0, 0])
        assert "1 of 4 combinations" in done.stderr
    with open(place / "wheels_dop.csv", newline="") as table:
        assert next(csv.DictReader(table))["pdop"] == ""


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("vary: [{key: pseudolites.s_n, values: [1]}]", "did you mean 's_m'"),
        ("vary: [{key: duration_s, values: [10], grid: {first: 1, last: 2, count: 2}}]", "exactly one of"),
        ("vary: [{keys: [duration_s, title], values: [[1]]}]", "expected a list of 2 values"),
        ("vary: [{key: duration_s, values: [-1]}]", "duration_s"),
        ("vary: []", "vary"),
        ("vary: [{key: duration_s, lhs: {first: 10, last: 20}}]", "samples"),
        ("vary: [{key: duration_s, values: [10]}]\noutputs: [horizontal]", "needs covariance or monte-carlo"),
        ("vary: [{key: duration_s, values: [10]}]\noutputs: [pdob]", "did you mean 'pdop'"),
        ("set: {duration_s: 1}\nvary: [{key: duration_s, values: [10]}]", "set twice"),
        ("set: {duration_t: 1}\nvary: [{key: duration_s, values: [10]}]", "did you mean 'duration_s'"),
    ],
)
def test_bad_studies(place: Path, text: str, expected: str) -> None:
    file = study(place, "bad", text)
    done = navsim("sweep", file, "-o", "bad.h5", cwd=place, code=2)
    assert expected in done.stderr
    assert "bad.yaml:" in done.stderr


def test_wrong_kinds_are_sent_where_they_belong(place: Path) -> None:
    file = study(place, "kinds", GRID)
    assert "navsim sweep" in navsim("run", file, cwd=place, code=2).stderr
    assert "kind: sweep" in navsim("sweep", BASE, cwd=place, code=2).stderr
    file.write_text(file.read_text().replace(str(BASE), "nowhere.yaml"))
    assert "nowhere.yaml" in navsim("sweep", file, cwd=place, code=2).stderr


def test_runs_are_refused_where_none_are_flown(tmp_path: Path) -> None:
    said = navsim("sweep", SCENARIOS / "placement_sweep.yaml", "--runs", 5, cwd=tmp_path, code=2).stderr
    assert "--runs: this sweep is by geometry alone (method dop), which flies nothing" in said
