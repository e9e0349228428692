"""Export of the trajectory of recorded ranges as a table and as a map."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from navsim.formats.export import export
from navsim.geodesy.earth import ecef_from_llh
from navsim.ranging.scenario import RecordedRanges
from navsim.ranging.study import compute, prepare
from navsim.results.result import Result, ResultError
from navsim.scenario_files.base import validated
from navsim.scenario_files.source import assign, load
from tests.helpers import SCENARIOS

SITES = np.array([[48.0, 11.0, 500.0], [48.002, 11.0, 503.0], [48.0, 11.003, 510.0], [48.002, 11.003, 520.0]])


def computed(log: Path, *assignments: str) -> Result:
    document = load(log)
    for each in assignments:
        assign(document, each)
    return compute(prepare(validated(RecordedRanges, document), document))


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def geodetic(folder: Path) -> Result:
    """A flight that rests at 48.001°, 11.001°, 540 m, in exact ranges of four sources."""
    sites, there = np.radians(SITES), np.radians([48.001, 11.001, 0.0])
    sites[:, 2], there[2] = SITES[:, 2], 540.0
    ranges = np.linalg.norm(ecef_from_llh(sites) - ecef_from_llh(there), axis=1)
    lines = [f"{0.5 * k},{name},{r:.4f}" for k in range(60) for name, r in zip("abcd", ranges, strict=True)]
    (folder / "r.csv").write_text("\n".join(["t_s,source,range_m", *lines]) + "\n")
    named = zip("abcd", SITES, strict=True)
    positions = ", ".join(
        f"{{name: {name}, lat_deg: {lat}, lon_deg: {lon}, height_m: {h}}}" for name, (lat, lon, h) in named
    )  # fmt: skip
    text = "kind: ranges\nversion: 1\nranges: {file: r.csv, measurement: two_way}\ntuning: none\n"
    (folder / "ranges.yaml").write_text(f"{text}sources: {{positions: [{positions}]}}\n")
    return computed(folder / "ranges.yaml")


@pytest.mark.parametrize(("smoother", "group"), [("true", "smoother"), ("false", "filter")])
def test_a_table_in_the_axes_of_the_sources(smoother: str, group: str, tmp_path: Path) -> None:
    result = computed(SCENARIOS / "recorded_ranges.yaml", "tuning=none", f"smoother={smoother}")
    export(result, tmp_path / "r.h5", ["csv"])
    rows = rows_of(tmp_path / "r_flight.csv")
    for name, form in (("position", "{}_m"), ("position_sigma", "sigma_{}_m"), ("velocity", "v{}_m_s")):
        found = [[float(row[form.format(axis)]) for axis in "xyz"] for row in rows]
        np.testing.assert_allclose(found, result[f"/{group}/{name}"], atol=1e-8)
    with pytest.raises(ResultError, match="export --csv"):
        export(result, tmp_path / "r.h5", ["kml"])


def test_a_map_of_geodetic_sources(tmp_path: Path) -> None:
    """The aircraft rests at a known place."""
    export(geodetic(tmp_path), tmp_path / "g.h5", ["csv", "kml", "geojson"])
    last = rows_of(tmp_path / "g_flight.csv")[-1]
    assert float(last["lat_deg"]) == pytest.approx(48.001, abs=5e-6)
    assert float(last["lon_deg"]) == pytest.approx(11.001, abs=5e-6)
    assert float(last["h_m"]) == pytest.approx(540.0, abs=5.0)
    track, *sites = json.loads((tmp_path / "g.geojson").read_text())["features"]
    assert track["geometry"]["coordinates"][-1][:2] == pytest.approx([11.001, 48.001], abs=5e-6)
    found = [site["geometry"]["coordinates"] for site in sites]
    np.testing.assert_allclose(found, SITES[:, [1, 0, 2]], atol=2e-3)
