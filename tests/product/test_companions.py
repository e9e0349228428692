"""`navsim run` on the companion papers' systems: files, figures, repeatability, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import xarray as xr
from PIL import Image

from navsim.results.result import read
from tests.conftest import SCENARIOS
from tests.layout import as_declared
from tests.made import COMMANDS
from tests.product.test_run import navsim, stored

SHIPPED = {
    "mls_elevation": (
        {"filter/covariance": ("step", "state", "state_column"), "montecarlo/fraction_in_band": ("experiment", "band")},
        ("approach", "proof", "nominal", "orders", "channels"),
    ),
    "azimuth_tracking": (
        {"filters/L4/error_deg": ("run", "time"), "filters/S1/sigma_deg": ("time",)},
        ("errors", "accelerations", "map"),
    ),
    "atc_tracking": (
        {"filters/full/error": ("run", "time", "state"), "filters/singer/sigma": ("time", "singer_state")},
        ("errors", "ratios"),
    ),
}


@pytest.mark.parametrize("name", SHIPPED)
def test_companions_repeat_and_are_as_declared(name: str, place: Path, tmp_path: Path) -> None:
    """In brief; their figures are drawn in `test_baselines`."""
    short = name.replace("_", "-")
    file = place / f"{short}.h5"
    result = read(file)
    as_declared(result)
    tree = xr.open_datatree(file, engine="h5netcdf")
    for path, dims in SHIPPED[name][0].items():
        assert tree[path].dims == dims
    assert json.loads(navsim(*COMMANDS[short], "--json", "-o", "again.h5", cwd=tmp_path).stdout)
    assert stored(file) == stored(tmp_path / "again.h5")


@pytest.mark.long
@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_companion(name: str, tmp_path: Path) -> None:
    variables, figures = SHIPPED[name]
    done = navsim("run", SCENARIOS / f"{name}.yaml", cwd=tmp_path)
    file = tmp_path / "results" / f"{name}.h5"
    assert done.stdout
    result = read(file)
    as_declared(result)
    tree = xr.open_datatree(file, engine="h5netcdf")
    for path, dims in variables.items():
        assert tree[path].dims == dims
    for figure in figures:
        with Image.open(file.with_name(f"{name}_{figure}.png")) as image:
            assert min(image.size) > 300
    again = ("--json", "--figures", "none", "-o", "again.h5")
    assert json.loads(navsim("run", SCENARIOS / f"{name}.yaml", *again, cwd=tmp_path).stdout)
    assert stored(file) == stored(tmp_path / "again.h5")
    assert navsim("show", file, cwd=tmp_path).stdout
    assert navsim("validate", SCENARIOS / f"{name}.yaml", cwd=tmp_path).stdout


def test_options_of_landings_are_refused(tmp_path: Path) -> None:
    for option in (("--keep", "all"), ("--until", "rms_horizontal within 2%"), ("--require-fix",)):
        done = navsim("run", SCENARIOS / "mls_elevation.yaml", *option, cwd=tmp_path, code=2)
        assert option[0] in done.stderr
    done = navsim("run", SCENARIOS / "mls_elevation.yaml", "--set", "filter.modell=paper", cwd=tmp_path, code=2)
    assert "did you mean 'model'" in done.stderr


@pytest.mark.parametrize(
    ("name", "setting"),
    [
        ("mls_elevation", "nominal.to_s=10800"),
        ("mls_elevation", "azimuth.to_s=10800"),
        ("azimuth_tracking", "circuit.duration_s=10800"),
        ("atc_tracking", "circuit.duration_s=4000"),  # three hours need 21 GB
    ],
)
def test_more_than_an_hour_is_flown_where_memory_allows(name: str, setting: str, tmp_path: Path) -> None:
    """Memory alone bounds the length, and is asked for before anything is flown. What is timed is no part of a study
    whose most is not what it counts."""
    scenario = SCENARIOS / f"{name}.yaml"
    told = navsim("run", scenario, "--set", setting, "--dry-run", cwd=tmp_path).stderr
    assert "of memory" in told
    assert "its time is not estimated" in told
    key = setting.partition("=")[0]
    done = navsim("run", scenario, "--set", f"{key}=2e6", "--dry-run", cwd=tmp_path, code=2)
    assert "1e+06" in done.stderr or "1000000" in done.stderr
