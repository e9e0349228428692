"""Files of heights: what their ground hides, against lines that are sampled finely; and what is refused and warned of.

The judge shares no code with navsim: its own ellipsoid, its own interpolation, every line asked each 5 m.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from navsim.formats import heights
from navsim.formats.heights import Box, read_heights
from navsim.formats.text import FileError
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef
from navsim.gnss.interference.horizon import Terrain, behind, loss_behind, ridge, ridge_loss, skyline_elevation
from navsim.gnss.sky import enu_matrix, unit_vector
from navsim.landing.case import Case, prepare
from navsim.landing.result_groups import start_result
from navsim.optimization.placement import RunwayPlane
from navsim.optimization.problem import problem
from navsim.optimization.scenario import Optimize
from navsim.results.schema import COVARIANCE
from navsim.runner.provenance import inputs_of
from navsim.scenario.load import read, read_study
from navsim.scenario_files.source import InputError
from navsim.simulation.placement_geometry import glide_geometry
from tests.helpers import SCENARIOS

SIDE, GEOID, NAME = 1201, 14.0, "N56E037.hgt"
LAT, LON = 57.0 - np.arange(SIDE) / (SIDE - 1), 37.0 + np.arange(SIDE) / (SIDE - 1)
THRESHOLD = 56.3157, 37.3


def ground(lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    """Level about the runway, 3 m above it but for its strip and a cell around; hills of 40 m in waves of a kilometre,
    a mountain of 150 m north-west, a wall right of the approach."""
    north, east = 111e3 * (lat - THRESHOLD[0]), 61.9e3 * (lon - THRESHOLD[1])
    away = np.hypot(np.maximum(np.abs(north - 500.0) - 900.0, 0.0), np.maximum(np.abs(east) - 250.0, 0.0))
    out = 123.0 + np.minimum(away / 100.0, 1.0) * 20.0 * np.sin(north / 300.0) * np.cos(east / 400.0)
    out += 150.0 * np.exp(-((north - 1500.0) ** 2 + (east + 2500.0) ** 2) / 1200.0**2)
    out = out + 60.0 * (np.abs(east - 700.0) < 60.0) * (np.abs(north + 900.0) < 600.0)
    return np.where((north >= -170.0) & (north <= 1170.0) & (np.abs(east) <= 250.0), 120.0, out)


def ellipsoidal(lat: np.ndarray, lon: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Geocentric coordinates by the ellipsoid's equation; deg, m."""
    a, f = 6378137.0, 1.0 / 298.257223563
    e2, phi, lam = f * (2.0 - f), np.radians(lat), np.radians(lon)
    n = a / np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
    across = (n + height) * np.cos(phi)
    return np.stack([across * np.cos(lam), across * np.sin(lam), (n * (1.0 - e2) + height) * np.sin(phi)], axis=-1)


def geodetic(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Latitude, longitude, deg, height, m, by fixed-point iteration."""
    a, f = 6378137.0, 1.0 / 298.257223563
    e2, p = f * (2.0 - f), np.hypot(points[..., 0], points[..., 1])
    phi = np.arctan2(points[..., 2], p * (1.0 - e2))
    for _ in range(6):
        n = a / np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
        height = p / np.cos(phi) - n
        phi = np.arctan2(points[..., 2], p * (1.0 - e2 * n / (n + height)))
    return np.degrees(phi), np.degrees(np.arctan2(points[..., 1], points[..., 0])), height


def over_line(tile: np.ndarray, antenna: np.ndarray, place: np.ndarray, length: float) -> float:
    """By how much the ground of a tile is above the line from an antenna towards a place, at most `length` m of it."""
    way = place - antenna
    far = float(np.linalg.norm(way))
    share = np.arange(0.0, min(far, length), 5.0) / far
    lat, lon, height = geodetic(antenna + share[:, None] * way)
    y, x = (57.0 - lat) * (SIDE - 1), (lon - 37.0) * (SIDE - 1)
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    y, x = y - i, x - j
    corners = tile[i, j], tile[i, j + 1], tile[i + 1, j], tile[i + 1, j + 1]
    weights = (1 - y) * (1 - x), (1 - y) * x, y * (1 - x), y * x
    return float(np.max(sum(c * w for c, w in zip(corners, weights, strict=True)) + GEOID - height))


@pytest.fixture(scope="module")
def tile() -> np.ndarray:
    return np.round(ground(*np.meshgrid(LAT, LON, indexing="ij")))


@pytest.fixture(scope="module")
def folder(tile: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("heights")
    tile.astype(">i2").tofile(out / NAME)
    return out


SITES = [{"name": "east", "s_m": 900, "l1_m": 900, "height_m": 60}, {"name": "west", "s_m": -3300, "l1_m": -700}]
GIVEN: dict[str, Any] = {
    "runway": {"heading_deg": 0, "height_m": 120, "height_above": "geoid", "geoid_undulation_m": GEOID,
               "threshold": {"lat_deg": THRESHOLD[0], "lon_deg": THRESHOLD[1]}},
    "approach.start": None, "receiver.rate_hz": 0.5, "imu.rate_hz": 20, "duration_s": 62, "sky.source": "nominal",
    "method": "covariance", "terrain": [{"file": NAME, "height_above": "geoid"}],
    "pseudolites": {"clock": "gps", "height_m": 100, "sites": SITES},
}  # fmt: skip


def field(folder: Path, **more: Any) -> Case:
    keys = [f"{key}={json.dumps(value)}" for key, value in (GIVEN | more).items()]
    scenario, document = read(SCENARIOS / "landing.yaml", keys)
    for path in [path for path in document.folders if path[0] == "terrain"]:
        document.folders[path] = folder
    return prepare(scenario, document)


@pytest.fixture(scope="module")
def hilly(folder: Path) -> Case:
    return field(folder)


def test_ground_hides_what_finely_sampled_lines_go_under(tile: np.ndarray, hilly: Case) -> None:
    """Each source at each fix of a landing, and 300 places near the ground at three of them."""
    assert hilly.warnings == [], hilly.warnings
    s, terrain = hilly.shared.signals, hilly.environment.terrain
    seen = hilly.environment.in_view(s.azimuth, s.elevation, s.antenna)
    seen[:, -2:] = True
    tested = {True: 0, False: 0}
    for e, i in np.argwhere(seen):
        over = over_line(tile, s.antenna[e], s.position[e, i], 12e3)
        if abs(over) > 0.1:
            assert s.used[e, i] == (over < 0.0), (e, s.names[i], over)
            tested[over < 0.0] += 1
    assert tested[False] > 20
    rng = np.random.default_rng(4)
    north, east = rng.uniform(-6e3, 6e3, (2, 300))
    lat, lon = THRESHOLD[0] + north / 111e3, THRESHOLD[1] + east / 61.9e3
    places = ellipsoidal(lat, lon, ground(lat, lon) + GEOID + rng.uniform(1.0, 30.0, 300))
    hidden = behind(terrain, places[None], s.antenna[::12])
    for e, i in np.ndindex(*hidden.shape):
        over = over_line(tile, s.antenna[12 * e], places[i], 3e4)
        if abs(over) > 0.1:
            assert hidden[e, i] == (over > 0.0), (e, i, over)
    assert 0.1 < hidden.mean() < 0.9


def test_searches_see_the_same(hilly: Case) -> None:
    """DOPs by the kernel are those of the landing; shares seen are its counts; antennas above the ground stand on it;
    the skyline ends where satellites begin to be seen; the result has it."""
    s, landing = hilly.shared.signals, hilly.scenario
    counted = np.ones(s.time.size, bool)
    geometry = glide_geometry(hilly.trajectory, hilly.environment, landing.epoch.timestamp(), s.time, counted)
    places = ecef_from_llh(hilly.pseudolites.llh)
    values, lost = geometry.dops(np.repeat(places[None], 9, axis=0))
    np.testing.assert_allclose(values[0, 0], np.full(9, hilly.shared.dop[:, 1].mean()), rtol=1e-9)
    assert not lost.any()
    count = hilly.behind_terrain()[:, -2:].sum(axis=0)
    assert 0 < count.min() < s.time.size
    np.testing.assert_allclose(geometry.visible_share(places), 1.0 - count / s.time.size)

    plane = RunwayPlane(landing.threshold(hilly.trajectory.frame), 0.0, 3.0, hilly.environment.terrain)
    llh = plane.llh(np.array([[-2000.0, -900.0]]))[0]
    # the file has whole metres
    assert llh[2] == pytest.approx(float(ground(*np.degrees(llh[:2]))) + GEOID + 3.0, abs=0.8)
    assert plane.above_runway(np.array([[-2000.0, -900.0]]))[0, 2] == pytest.approx(llh[2] - 134.0)

    draft = start_result(hilly, COVARIANCE)
    azimuth, edge = draft["/geometry/skyline_azimuth"][::30], draft["/geometry/skyline"][::30]
    np.testing.assert_array_equal(edge, skyline_elevation(hilly.environment.terrain, s.antenna[-1], azimuth))
    for off, wanted in ((-2e-5, True), (2e-5, False)):
        away = 1e6 * unit_vector(azimuth, edge + off) @ enu_matrix(llh_from_ecef(s.antenna[-1]))
        found = behind(hilly.environment.terrain, (s.antenna[-1] + away)[None], s.antenna[-1:])[0]
        np.testing.assert_array_equal(found, wanted)
    assert edge.max() > np.radians(3.0)


def test_a_narrow_wall_of_a_grid_is_a_knife_edge(folder: Path) -> None:
    """Jammers lose power behind it as behind a ridge of that height, 1 dB for its width and the hills."""
    lat = np.full((200, 200), np.float32(10.0))
    lat[100] = 60.0
    grid = heights.HeightGrid(np.radians(56.1), np.radians(37.0), *np.radians([1e-3, 1e-3]), lat)
    llh = np.radians([[56.03, 37.1], [55.97, 37.1]])
    place = ecef_from_llh(np.array([*llh[0], 12.0]))
    antenna = ecef_from_llh(np.column_stack([np.repeat(llh[1:], 4, axis=0), [25.0, 60.0, 90.0, 400.0]]))
    tops = ridge(np.radians([[56.0, 37.09], [56.0, 37.11]]), 60.0)
    found = loss_behind(Terrain(grids=(grid,)), place, antenna, 0.19)
    np.testing.assert_allclose(found, ridge_loss(tops, place, antenna, 0.19), atol=0.3)
    assert found[0] > 15.0
    assert found[3] == 0.0


def test_height_above_the_ground_of_a_file(folder: Path, hilly: Case) -> None:
    """The altimeter measures down to the ground under it, but to the runway over its strip; the filter has the same
    ground under the centre line."""
    case = field(folder, radio_altimeter={"sigma_floor_m": 0.5, "ground_from": "terrain"})
    sensor, time = case.shared.aids[0].sensor, np.arange(1.0, 60.0)
    llh = case.trajectory.motion(time).llh
    before = 111e3 * (THRESHOLD[0] - np.degrees(llh[:, 0]))
    far, strip = before > 700.0, before < 0.0
    exact = sensor.noise_free(case.trajectory, time)[:, 0]
    below = ground(*np.degrees(llh[:, :2]).T) + GEOID
    np.testing.assert_allclose(exact[far], (llh[:, 2] - below)[far], atol=0.8)
    assert np.ptp(below[far]) > 20.0
    np.testing.assert_allclose(exact[strip], llh[strip, 2] - 134.0, atol=0.5)
    table = sensor.table(case.trajectory.frame, exact[:, None])
    np.testing.assert_allclose(np.interp(-before, table.along, table.ground)[far], (below - 134.0)[far], atol=1.0)


def test_what_is_warned_of(folder: Path, hilly: Case) -> None:
    """A flight through a hill, a source under the ground, another height of the runway; and the file is an input."""
    document = SimpleNamespace(file="x", named={(("terrain", 0, "file"), NAME): folder / NAME})
    assert [each.key for each in inputs_of(SimpleNamespace(document=document)).values()] == ["terrain.0.file"]
    assert hilly.scenario.terrain[0].file_sha256 == heights.files.checksum(folder / NAME)
    low = {"name": "low", "s_m": -2500, "l1_m": -1500, "height_m": 5}
    runway = GIVEN["runway"] | {"height_m": 60}
    said = "\n".join(field(folder, pseudolites={"clock": "gps", "sites": [low]}, runway=runway).warnings)
    assert re.search(r"terrain\[0\]: low is 1\d\d\.\d m under the ground", said)
    assert re.search(r"terrain\[0\]: the flight goes through the ground at \d+\.\d s, \d+\.\d m under", said)
    assert re.search(rf"{NAME} has the threshold \d\d\.\d m above the runway, 74 m above the ellipsoid; check", said)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"terrain": [{"file": NAME}]}, "terrain.0.height_above: say what the heights of the file count from"),
        ({"terrain": [{"reach_m": 9e3}]}, "give either ends and height_m, .* or a file"),
        ({"terrain": [{"ends": [{"lat_deg": 1, "lon_deg": 2}] * 2, "height_m": 1, "unit": "ft"}]}, "a ridge needs two"),
        ({"runway": {**GIVEN["runway"], "height_above": "ellipsoid", "geoid_undulation_m": None}},
         "terrain.0.height_above: heights above the geoid need"),
        ({"terrain": [{"file": "N10E010.hgt", "height_above": "geoid"}]}, "cannot be read: No such file"),
        ({"terrain": [{**GIVEN["terrain"][0], "unit": "ft"}]}, "heights of .hgt files are in metres"),
        ({"terrain": [{**GIVEN["terrain"][0], "file_sha256": "0" * 64}]}, "file_sha256: .* has the checksum"),
        ({"terrain": [{**GIVEN["terrain"][0], "reach_m": 1000}]}, "there is no height under the flight at 0.0 s, 56.2"),
        ({"runway": GIVEN["runway"] | {"threshold": {"lat_deg": 20, "lon_deg": 20}}}, "has no heights within reach_m"),
        ({"radio_altimeter": {"sigma_floor_m": 1, "ground_from": "terrain"}, "terrain": []}, "there is no `file`"),
    ],
)  # fmt: skip
def test_what_is_refused(folder: Path, more: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        field(folder, **more)


HERE = Box.about(np.radians([*THRESHOLD, 0.0]), 5e3)


def test_damaged_files_and_voids(
    folder: Path, tile: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Short files, names without a corner, voids, and formats without rasterio."""
    for name, content, message in (
        (NAME, b"1234", "has 4 bytes; tiles have"), ("hill.hgt", b"", "south-western corner"),
        ("S57E037.hgt", tile.astype(">i2").tobytes(), "has no heights within reach_m"),
        (NAME, np.full(SIDE**2, -32768, ">i2").tobytes(), "nothing but voids"),
        (NAME, np.full(SIDE**2, -9999, ">i2").tobytes(), "heights of -9999 m; if these are voids"),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileError, match=message):
            read_heights(tmp_path / name, HERE, "m", "geoid")
    with monkeypatch.context() as short:
        short.setattr(heights, "MOST", 1000)
        with pytest.raises(FileError, match="at most 1,000 are kept: give a smaller reach_m"):
            read_heights(folder / NAME, HERE, "m", "geoid")
    (tmp_path / "hill.tif").write_bytes(b"II*\0")

    def absent(name: str) -> None:
        raise ImportError(name)

    with monkeypatch.context() as bare:
        bare.setattr(heights.importlib, "import_module", absent)
        with pytest.raises(FileError, match=r"needs the extra `terrain` \(pip install"):
            read_heights(tmp_path / "hill.tif", HERE, "m", "geoid")
    void = tile.copy()
    void[int((57.0 - THRESHOLD[0]) * 1200) + 12] = -32768
    void.astype(">i2").tofile(tmp_path / NAME)
    with pytest.raises(InputError, match="there is no height under the flight"):
        field(tmp_path)


def test_other_formats_have_the_same_heights(folder: Path, tile: np.ndarray, tmp_path: Path) -> None:
    """A GeoTIFF of the tile, in feet, in projected coordinates, with another datum of heights; DTED by its points."""
    rasterio = pytest.importorskip("rasterio", reason="the extra `terrain` is not installed")
    from rasterio.warp import Resampling, calculate_default_transform, reproject

    half = 0.5 / (SIDE - 1)
    turn = rasterio.Affine(2 * half, 0.0, 37.0 - half, 0.0, -2 * half, 57.0 + half)
    about = {"driver": "GTiff", "width": SIDE, "height": SIDE, "count": 1, "dtype": "float32", "transform": turn}

    def write(name: str, data: np.ndarray, crs: str | None = "EPSG:4326", **more: Any) -> Path:
        with rasterio.open(tmp_path / name, "w", **(about | {"crs": crs} | more)) as out:
            for band in range(out.count):
                out.write(data.astype(out.dtypes[0]), band + 1)
            if name == "ft.tif":
                out.units = ("ft",)
        return tmp_path / name

    wanted = read_heights(folder / NAME, HERE, "m", "geoid")
    same = read_heights(write("m.tif", tile), HERE, "m", "geoid")
    np.testing.assert_array_equal(same.height, wanted.height)
    np.testing.assert_allclose([same.north, same.west, same.down], [wanted.north, wanted.west, wanted.down], rtol=1e-12)
    feet = write("ft.tif", tile / 0.3048)
    np.testing.assert_allclose(read_heights(feet, HERE, "ft", "geoid").height, wanted.height, atol=1e-3)
    turned, width, height = calculate_default_transform("EPSG:4326", "EPSG:32637", SIDE, SIDE, 37, 56, 38, 57)
    flat = np.full((height, width), -32768.0, np.float32)
    smooth = 120.0 + 30.0 * np.sin(12.0 * np.add.outer(LAT, LON))
    reproject(smooth, flat, src_transform=turn, src_crs="EPSG:4326", dst_transform=turned, dst_crs="EPSG:32637",
              dst_nodata=-32768.0, resampling=Resampling.cubic)  # fmt: skip
    utm = read_heights(
        write("utm.tif", flat, "EPSG:32637", transform=turned, width=width, height=height, nodata=-32768.0), HERE, "m",
        "geoid",
    )  # fmt: skip
    lat, lon = np.random.default_rng(1).uniform([56.28, 37.24], [56.35, 37.36], (50, 2)).T
    found = utm.at(np.radians(np.column_stack([lat, lon])))
    np.testing.assert_allclose(found, 120.0 + 30.0 * np.sin(12.0 * (lat + lon)), atol=0.05)
    wide = Box.about(np.radians([56.98, 37.5, 0.0]), 5e3)
    beside = read_heights(
        write("bare.tif", 0.0 * flat + 500.0, "EPSG:32637", transform=turned, width=width, height=height), wide, "m",
        "geoid",
    )  # fmt: skip
    assert np.nanmin(beside.height) == 500.0
    globe = {"width": 720, "height": 360, "transform": rasterio.Affine(0.5, 0.0, -180.0, 0.0, -0.5, 90.0)}
    east = read_heights(write("globe.tif", np.tile(np.arange(720.0), (360, 1)), **globe), HERE, "m", "geoid")
    assert east.at(np.radians(THRESHOLD)) == pytest.approx((THRESHOLD[1] + 180.0) / 0.5 - 0.5, abs=1e-3)
    turn = rasterio.Affine(4 * half, 0.0, 37.0 - 2 * half, 0.0, -2 * half, 57.0 + half)
    dted = read_heights(
        write("n56.dt1", tile[:, ::2], driver="DTED", dtype="int16", width=601, transform=turn), HERE, "m", "geoid"
    )
    points = np.stack(np.meshgrid(LAT[800:820], LON[320:370:2], indexing="ij"), axis=-1)
    np.testing.assert_allclose(dted.at(np.radians(points)), tile[800:820, 320:370:2], atol=1e-6)
    for path, unit, above, message in (
        (feet, "m", "geoid", "in feet: write unit: ft"),
        (write("none.tif", tile[:3, :3], None, width=3, height=3), "m", "geoid", "coordinate system"),
        (write("three.tif", tile[:3, :3], count=3, width=3, height=3), "m", "geoid", "has 3 bands"),
        (write("egm.tif", tile, "EPSG:4326+5773"), "m", "ellipsoid", "above EGM96 height: write height_above: geoid"),
        (folder / "text.tif", "m", "geoid", "no file of heights that rasterio reads"),
    ):
        if not path.exists():
            path.write_text("none")
        with pytest.raises(FileError, match=message):
            read_heights(path, HERE, unit, above)


def test_a_search_counts_heights_from_the_ground(folder: Path, tmp_path: Path) -> None:
    """It refuses ground that there is not; its placements stand on what there is."""
    keys = GIVEN | {"terrain": [{**GIVEN["terrain"][0], "file": str(folder / NAME)}]}
    study = {"kind": "optimize", "version": 1, "base": str(SCENARIOS / "landing.yaml"), "pseudolites": [1], "set": keys,
             "objective": "pdop", "height_m": 4, "height_above": "ground",
             "area": {"s_m": [-2000, 2000], "l1_m": [200, 2000]}}  # fmt: skip
    for more, message in (
        ({}, None), ({"set": keys | {"terrain": []}}, "has no `file` of heights under `terrain`"),
        ({"area": {"s_m": [0, 50e3], "l1_m": [0, 10]}}, "the files of heights have none at s, l1 of"),
    ):  # fmt: skip
        (tmp_path / "study.yaml").write_text(json.dumps(study | more))
        if message is None:
            posed = problem(*read_study(tmp_path / "study.yaml", Optimize, []))
            llh = posed.rules.plane.llh(np.array([[[1000.0, 300.0]]]))[0, 0]
            assert llh[2] == pytest.approx(float(ground(*np.degrees(llh[:2]))) + GEOID + 4.0, abs=0.8)
            continue
        with pytest.raises(InputError, match=message):
            problem(*read_study(tmp_path / "study.yaml", Optimize, []))
