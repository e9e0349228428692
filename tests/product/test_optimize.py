"""`navsim optimize`: tables, files, repeatability, messages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from navsim.io.results import read
from tests.conftest import SCENARIOS
from tests.layout import as_declared
from tests.product.test_run import navsim, stored

BASE = SCENARIOS / "landing_gnss_only.yaml"


def study(place: Path, text: str) -> Path:
    file = place / "study.yaml"
    file.write_text(f"kind: optimize\nversion: 1\nbase: {BASE}\nset: {{receiver.rate_hz: 1}}\n{text}")
    return file


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("optimize")


def test_shipped_study(place: Path) -> None:
    """Files, figures, a front that falls, rules kept, the same again with the same seed."""
    done = navsim(
        "optimize", SCENARIOS / "placement_optimum.yaml", "--set", "pseudolites=[1, 2]", "-o", "a.h5", cwd=place
    )
    assert "PL2" in done.stdout
    result = read(place / "a.h5")
    tree = xr.open_datatree(place / "a.h5", engine="h5netcdf")
    assert tree["map/objective"].sizes == {"pseudolites": 2, "s": 61, "l1": 61}
    as_declared(result)
    front = result["/front/objective"]
    none = result.variables["/front/objective"].attributes["without_pseudolites"]
    assert np.all(np.diff(np.append(none, front)) < 0)
    assert np.all(result["/optimum/violation"] <= 0.01)
    np.testing.assert_allclose(result["/optimum/pdop"], front, rtol=1e-12)
    # no place of the map is better than the optimum
    assert np.all(np.nanmin(result["/map/objective"], axis=(1, 2)) >= front * (1 - 1e-3))
    reach = result["/optimum/neighbourhood"]
    both = np.isfinite(reach[:, :, 0]) & np.isfinite(reach[:, :, 1])
    assert np.all(reach[:, :, 0][both] < reach[:, :, 1][both])
    for name in ("plan", "front"):
        with Image.open(place / f"a_{name}.png") as image:
            assert min(image.size) > 300
    for name in ("b.h5", "c.h5"):
        navsim(
            "optimize", SCENARIOS / "placement_optimum.yaml", "--set", "pseudolites=[1]", "-o", name, "-q", cwd=place
        )
    assert stored(place / "b.h5") == stored(place / "c.h5")
    assert read(place / "b.h5")["/front/objective"] == result["/front/objective"][0]
    assert "PL2" in navsim("show", "a.h5", cwd=place).stdout


def test_json(place: Path) -> None:
    file = study(place, "pseudolites: [1]\nobjective: vdop\narea: {s_m: [100, 900], l1_m: [0, 2000]}\n")
    done = navsim("optimize", file, "--json", "-o", "json.h5", "--seed", 4, cwd=place)
    data = json.loads(done.stdout)
    assert 100 <= data["placements"][0]["sites"][0]["s_m"] <= 900
    assert data["placements"][0]["value"] < data["without_pseudolites"]


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
def test_what_cannot_be_done_is_said(place: Path, text: str, code: int, expected: str) -> None:
    (place / "line.json").write_text(json.dumps({"type": "LineString", "coordinates": [[37, 56], [38, 56]]}))
    (place / "broken.json").write_text("{")
    bow = [[[37.0, 56.0], [37.1, 56.1], [37.1, 56.0], [37.0, 56.1], [37.0, 56.0]]]
    (place / "bow.json").write_text(json.dumps({"type": "Polygon", "coordinates": bow}))
    done = navsim("optimize", study(place, text), "-o", "bad.h5", cwd=place, code=code)
    assert expected in done.stderr
    assert not (place / "bad.h5").exists()
