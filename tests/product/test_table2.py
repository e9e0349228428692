"""`navsim table2`: its files, their columns, the same numbers in all of them."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from navsim.published_tables import table2 as study
from navsim.published_tables.table2_report import cells
from navsim.results.result import read
from tests.layout import as_declared
from tests.product.test_run import navsim

QUANTITIES = ("pdop", "hdop", "vdop", "rms_horizontal_m", "rms_vertical_m", "error_horizontal_m")
NAMES = ("table2", "table2_row1", "table2_almanac", "table2_weighted")


@pytest.fixture(scope="module")
def made(place: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """What `navsim table2 --runs 12` has written and said."""
    folder = Path(shutil.copytree(place / "t2", tmp_path_factory.mktemp("table2") / "out"))
    return folder, (folder / "printed.txt").read_text(encoding="utf-8")


def test_files_and_columns(made: tuple[Path, str]) -> None:
    folder, printed = made
    for name in NAMES:
        with open(folder / f"{name}.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        beside = [f"{q[:-2]}_published_m" if q.endswith("_m") else f"{q}_published" for q in QUANTITIES]
        heads = ["pseudolites", "s_m", "l1_m", *(h for pair in zip(QUANTITIES, beside, strict=True) for h in pair)]
        assert list(rows[0]) == [*heads, "error_horizontal_low_m", "error_horizontal_high_m"]
        assert [(r["pseudolites"], r["s_m"], r["l1_m"]) for r in rows] == [
            ("0", "", ""), ("1", "50", "4000"), ("1", "200", "5000"), ("1", "500", "5000"), ("1", "1000", "5000"),
            ("2", "50", "4000"), ("2", "200", "5000"), ("2", "1000", "5000"),
        ]  # fmt: skip
        assert rows[0]["pdop_published"] == "3.67"
        assert rows[3]["pdop_published"] == ""
        assert rows[7]["error_horizontal_published_m"] == "0.8573"
        assert all(float(r["error_horizontal_low_m"]) < float(r["error_horizontal_m"]) for r in rows)
    page = (folder / "table2.md").read_text()
    for text in (page, printed):
        assert "2.534" in text
        assert all(claim in text for claim in ("C1", "C2", "C3", "C4"))
    for name in ("table2_pdop", "table2_rms"):
        with Image.open(folder / f"{name}.png") as image:
            assert min(image.size) > 300
    with open(folder / "table2_approach.csv", newline="") as file:
        assert len(list(csv.reader(file))) == 1 + 61 * 5


def test_result_is_a_tree_others_can_open(made: tuple[Path, str]) -> None:
    folder, _ = made
    tree = xr.open_datatree(folder / "table2.h5", engine="h5netcdf")
    assert tree["table/pdop"].sizes == {"calibration": 4, "case": 8, "statistic": 3}
    result = read(folder / "table2.h5")
    computed, published = cells(result, 0)
    assert computed.shape == published.shape == (8, 6)
    as_declared(result)
    assert "Table 2" in navsim("show", "table2.h5", cwd=folder).stdout
    assert sorted(p.name for p in folder.glob("*.png")) == sorted(
        Path(line).name for line in navsim("plot", "table2.h5", cwd=folder).stdout.split()
    )


def test_claims_are_judged(made: tuple[Path, str]) -> None:
    """C3 and C4 hold by default; a table where two close pseudolites were best would fail C3, C1 and C2 are judged."""
    result = read(made[0] / "table2.h5")
    held = dict(zip(result["/claims/claim"], result["/claims/holds"][0], strict=True))
    assert held["C3"]
    assert held["C4"]
    dops = np.repeat(np.array([3.67, 2.98, 2.86, 2.85, 2.84, 2.52, 2.38, 2.2])[:, None], 3, axis=1)
    sko = np.array([r.sko or (4.5, 11.5) for r in study.ROWS])
    error = np.array([1.0, 1, 0.98, 1, 1, 1, 1, 0.85])[:, None] * [1.0, 0.99, 1.01]
    paper = {c.name: c.holds for c in study.claims(dops, sko, error)}
    assert paper == {"C1": True, "C2": False, "C3": True, "C4": True}
    worse = dops.copy()
    worse[5] = 2.1
    error[7] = 0.99
    broken = {c.name: c.holds for c in study.claims(worse, sko, error)}
    assert not broken["C3"]
    assert not broken["C4"]


def test_bad_output(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    done = navsim("table2", "-o", "file", "--runs", 1, cwd=tmp_path, code=2)
    assert "file" in done.stderr
