"""Nothing depends on where longitudes are counted from: flights across 180 degrees are those of elsewhere."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
from shapely.geometry import shape

from navsim.formats import export, export_maps
from navsim.formats.export_maps import true_antenna
from navsim.geodesy import earth
from navsim.geodesy import earth_kernels as point
from navsim.landing import study as landing
from navsim.replays import study as replay
from navsim.report.figure_data import fix_errors
from navsim.results.result import Result
from navsim.runner.executor import threads
from navsim.scenario.load import read_replay
from tests.conftest import SCENARIOS
from tests.helpers import case

HALF = np.pi


@pytest.mark.parametrize("turns", [-2, -1, 0, 1])
def test_the_short_way_round(turns: int) -> None:
    angles = np.array([0.0, 1e-9, -3.0, 3.0, np.nan])
    np.testing.assert_allclose(earth.wrap_angle(angles + 2.0 * HALF * turns), angles, atol=1e-14)
    assert point.wrap_angle(angles[1]) == angles[1]
    assert np.isnan(point.wrap_angle(np.nan))


EAST = ("runway.heading_deg=90", "duration_s=40", "imu.rate_hz=20", "receiver.rate_hz=2")


def flown(longitude: float, *more: str, method: str = "monte-carlo") -> Result:
    """Eastwards under directions of satellites, which are the same anywhere."""
    this = case(f"approach.start.lon_deg={longitude}", *EAST, *more, name="table2_row1")
    if method == "covariance":
        return landing.covariance_result(this, landing.covariance_analysis(this), 1)
    return landing.result(this, landing.fly_all(this, 3, 0, 1, threads(1), keep="all"), 3, keep="all")


ACROSS = 179.995
"""Where a flight starts that crosses 180 degrees after some 10 s."""


@pytest.mark.parametrize("kind", ["gaussian-sum", "tfg", "eskf", "left-invariant", "rts", "map"])
def test_a_landing_across_the_date_line(kind: str) -> None:
    here, there = (flown(longitude, f"filter.kind={kind}") for longitude in (37.0, ACROSS))
    longitudes = there["/truth/position_llh"][:, 1]
    assert np.ptp(longitudes) > HALF
    for name in ("/filter/error", "/filter/sigma"):
        np.testing.assert_allclose(there[name], here[name], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(fix_errors(there), fix_errors(here), atol=1e-5)
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(true_antenna(there), axis=0), axis=1),
        np.linalg.norm(np.diff(true_antenna(here), axis=0), axis=1),
        atol=1e-5,
    )


def test_its_maps(tmp_path: Path) -> None:
    """No line round the Earth: what crosses 180 degrees is cut there in GeoJSON and in KML."""
    (there,) = export.export(flown(ACROSS), tmp_path / "there.h5", ["geojson"])
    (here,) = export.export(flown(37.0), tmp_path / "here.h5", ["geojson"])
    features, others = (json.loads(file.read_text())["features"] for file in (there, here))
    crossing = 0
    for feature, other in zip(features, others, strict=True):
        found, whole = shape(feature["geometry"]), shape(other["geometry"])
        parts = list(getattr(found, "geoms", [found]))
        assert feature["geometry"]["type"].removeprefix("Multi") == whole.geom_type
        assert len(parts) <= 2
        crossing += len(parts) == 2
        for part in parts:
            low, _, top, _ = part.bounds
            assert -180.0 <= low <= top <= 180.0
            assert top - low < 1.0
            assert part.is_valid
            assert whole.geom_type != "Polygon" or part.exterior.is_ccw
        assert found.area == pytest.approx(whole.area, rel=1e-4)
        assert found.length == pytest.approx(whole.length, rel=0.5 if len(parts) == 2 else 1e-4)
        assert whole.geom_type == "Polygon" or found.length == pytest.approx(whole.length, rel=1e-4)
    assert crossing
    (kml,) = export.export(flown(ACROSS), tmp_path / "r.h5", ["kml"])
    parts = [[float(place.split(",")[0]) for place in text.split()]
             for text in re.findall("<coordinates>(.*?)<", kml.read_text())]  # fmt: skip
    assert len([text for text in kml.read_text().split() if text == "<MultiGeometry>"]) == crossing
    for longitudes in parts:
        assert np.abs(longitudes).max() <= 180.0
        assert np.ptp(longitudes) < 1.0
    assert {float(np.sign(part[0])) for part in parts} == {-1.0, 1.0}


def test_longitudes_of_pseudolites_end_at_180_degrees() -> None:
    """Beside a start at 179.9 degrees, given in the frames of the paper's table and of the runway."""
    for frame in ("table1", "runway"):
        there = case("approach.start.lon_deg=179.999", "pseudolites={sites: [{s_m: 500, l1_m: 900}]}",
                     f"pseudolites.frame={frame}", "runway.heading_deg=0", "duration_s=4")  # fmt: skip
        here = case("approach.start.lon_deg=37", "pseudolites={sites: [{s_m: 500, l1_m: 900}]}",
                    f"pseudolites.frame={frame}", "runway.heading_deg=0", "duration_s=4")  # fmt: skip
        turned = np.radians(142.999 - 360.0)
        assert np.abs(there.pseudolites.llh[:, 1]).max() <= np.pi
        np.testing.assert_allclose(there.pseudolites.llh[:, 1], here.pseudolites.llh[:, 1] + turned, atol=1e-9)


def test_an_area_is_cut_as_well() -> None:
    """And one that lies beyond the line is brought back whole."""
    ring = [[179.0, 0.0, 5.0], [181.0, 0.0, 5.0], [181.0, 1.0, 5.0], [179.0, 1.0, 5.0], [179.0, 0.0, 5.0]]
    for given in (ring, ring[::-1], [[lon - 360.0, *rest] for lon, *rest in ring]):
        cut = shape(export_maps._geometry("Polygon", given))
        assert sorted(part.bounds for part in cut.geoms) == [(-180.0, 0.0, -179.0, 1.0), (179.0, 0.0, 180.0, 1.0)]
        assert all(part.exterior.is_ccw for part in cut.geoms)
    beyond = export_maps._geometry("LineString", [[180.5, 0.0, 5.0], [181.0, 0.0, 5.0]])
    assert beyond == {"type": "LineString", "coordinates": [[-179.5, 0.0, 5.0], [-179.0, 0.0, 5.0]]}


def test_its_covariance_analysis() -> None:
    here, there = (flown(longitude, method="covariance") for longitude in (37.0, ACROSS))
    for name in ("/summary/at/along", "/filter/sigma"):
        np.testing.assert_allclose(there[name], here[name], rtol=1e-6)


def test_a_recorded_flight_across_the_date_line(tmp_path: Path) -> None:
    with open(SCENARIOS / "data" / "flight_gnss.csv", newline="") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    head, body = rows[0], rows[1:]
    column = head.index("lon_deg")
    middle = float(np.median([float(row[column]) for row in body]))
    found = []
    for at in (37.0, 180.0):
        folder = tmp_path / f"{at:g}"
        (folder / "data").mkdir(parents=True)
        (folder / "data" / "flight_imu.csv.gz").symlink_to(SCENARIOS / "data" / "flight_imu.csv.gz")
        with open(folder / "data" / "flight_gnss.csv", "w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(head)
            for row in body:
                longitude = (float(row[column]) - middle + at + 180.0) % 360.0 - 180.0
                writer.writerow([*row[:column], f"{longitude:.9f}", *row[column + 1 :]])
        (folder / "log.yaml").write_text((SCENARIOS / "recorded_flight.yaml").read_text())
        found.append(replay.compute(replay.prepare(*read_replay(folder / "log.yaml", ("tuning=none",)))))
    here, there = found
    assert np.ptp(there["/receiver/position_llh"][:, 1]) > HALF
    assert np.abs(there["/filter/position_llh"][:, 1]).max() <= HALF
    for name in ("/filter/attitude_rpy", "/filter/velocity_ned", "/filter/sigma", "/innovations/normalized_squared"):
        np.testing.assert_allclose(there[name], here[name], rtol=1e-4, atol=1e-5)


def test_a_line_that_crosses_itself_is_cut_as_it_is_flown() -> None:
    """There and back, and once more: four parts in their order, with their own heights."""
    there = [[179.0, 0.0, 1.0], [181.0, 0.0, 2.0], [179.0, 0.0, 3.0], [181.0, 0.0, 4.0]]
    cut = export_maps._geometry("LineString", there)
    assert cut["type"] == "MultiLineString"
    assert cut["coordinates"] == [
        [[179.0, 0.0, 1.0], [180.0, 0.0, 1.5]],
        [[-180.0, 0.0, 1.5], [-179.0, 0.0, 2.0], [-180.0, 0.0, 2.5]],
        [[180.0, 0.0, 2.5], [179.0, 0.0, 3.0], [180.0, 0.0, 3.5]],
        [[-180.0, 0.0, 3.5], [-179.0, 0.0, 4.0]],
    ]
    west = export_maps._geometry("LineString", [[-179.0, 0.0, 0.0], [-181.0, 0.0, 0.0]])
    assert west["coordinates"] == [[[-179.0, 0.0, 0.0], [-180.0, 0.0, 0.0]], [[180.0, 0.0, 0.0], [179.0, 0.0, 0.0]]]
