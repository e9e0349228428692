"""`navsim export`: files that other programs read, judged by them."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from navsim.core.wgs84 import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.io.export import export
from navsim.io.recording import read_fixes
from navsim.io.results import Result, ResultError
from navsim.io.rinex_nav import read_nav
from navsim.io.rinex_obs import read_obs
from navsim.models import glonass_broadcast, gps
from navsim.study import landing
from navsim.study.single_point import Settings, solve
from tests.helpers import case

EXACT = ("signals.range_sigma_m=1e-6", "signals.range_rate_sigma_m_s=1e-6", "filter.gate.probability=0")
RTKLIB = """pos1-posmode=single
pos1-elmask=0
pos1-ionoopt=off
pos1-tropopt=off
pos1-sateph=brdc
pos1-navsys=5
out-solformat=xyz
out-timesys=gpst
out-timeform=tow
out-timendec=7
"""


def flown(*assignments: str, sky: str = "nominal", name: str = "landing") -> Result:
    c = case(f"sky.source={sky}", "sky.broadcast=true", "receiver.rate_hz=2", *assignments, name=name)
    return landing.result(c, landing.fly_all(c, 1, 0, 1, 1, keep="all"), 1, keep="all")


@pytest.fixture(scope="module")
def noisy() -> Result:
    return flown()


def rnx2rtkp(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (s of the first epoch's minute), ECEF positions, numbers of satellites by RTKLIB."""
    program = shutil.which("rnx2rtkp")
    if program is None:
        pytest.skip("needs RTKLIB's rnx2rtkp (Debian package rtklib), which is not installed")
    (folder / "rtk.conf").write_text(RTKLIB)
    command = [program, "-k", "rtk.conf", "-o", "out.pos", "r.obs", "r.nav"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    table = np.loadtxt(folder / "out.pos", comments="%", ndmin=2)
    return table[:, 1], table[:, 2:5], table[:, 6]


def antenna(result: Result) -> np.ndarray:
    """True antenna at the fix epochs, ECEF; the shipped landing has no lever arm."""
    ecef = ecef_from_llh(result["/truth/position_llh"])
    index = np.searchsorted(result["/truth/time"], result["/geometry/time"] - 1e-9)
    return ecef[index]


@pytest.mark.validates(
    "Exported RINEX of error-free GPS, GLONASS and both", "RTKLIB rnx2rtkp 2.4.3", "0.05 m at every epoch"
)
@pytest.mark.parametrize("sky", ["nominal-gps", "nominal-glonass", "nominal"])
def test_rtklib_finds_the_true_path(sky: str, tmp_path: Path) -> None:
    result = flown(*EXACT, sky=sky)
    export(result, tmp_path / "r.h5", ["rinex"])
    _, position, satellites = rnx2rtkp(tmp_path)
    truth = antenna(result)
    assert position.shape == truth.shape
    assert np.linalg.norm(position - truth, axis=1).max() < 0.05
    assert satellites.min() >= 5


@pytest.mark.validates(
    "Exported RINEX of noisy measurements", "RTKLIB rnx2rtkp 2.4.3", "errors correlate at 0.8, rms within 25 %"
)
def test_rtklib_agrees_with_our_fixes(tmp_path: Path) -> None:
    """RTKLIB weighs by another law of elevation (variances as 1 / sin), so single fixes differ, the less the higher the
    mask; their errors are alike, and as large."""
    noisy = flown("pseudolites.count=0", "receiver.rate_hz=10", "sky.mask_deg=20")
    export(noisy, tmp_path / "r.h5", ["rinex"])
    second, position, _ = rnx2rtkp(tmp_path)
    # RTKLIB leaves out fixes whose residuals fail its chi-square test
    time = noisy["/geometry/time"]
    index = np.searchsorted(time, second - second[0] + time[0] - 0.01)
    assert index.size > 0.98 * time.size
    truth = antenna(noisy)[index]
    axes = ned_matrix(llh_from_ecef(truth))
    theirs = np.einsum("nij,nj->ni", axes, position - truth)
    ours = np.einsum("nij,nj->ni", axes, ecef_from_llh(noisy["/receiver/position_llh"][0][index]) - truth)
    ratio = np.sqrt(np.mean(theirs**2, axis=0) / np.mean(ours**2, axis=0))
    assert np.all((ratio > 0.8) & (ratio < 1.25)), ratio
    assert all(np.corrcoef(theirs[:, i], ours[:, i])[0, 1] > 0.8 for i in range(3))
    assert np.sqrt(np.mean(np.sum(theirs**2, axis=1))) == pytest.approx(
        np.sqrt(np.mean(np.sum(ours**2, axis=1))), rel=0.25
    )


def test_our_own_reader_and_solver_find_the_fixes_again(noisy: Result, tmp_path: Path) -> None:
    """Written, read, solved with the weights of the landing: the receiver's fixes to millimetres (RINEX has three
    decimals), pseudolites apart."""
    alone = flown("pseudolites.count=0")
    export(alone, tmp_path / "r.h5", ["rinex"])
    observations, navigation = read_obs(tmp_path / "r.obs"), read_nav(tmp_path / "r.nav")
    assert navigation.gps is not None
    assert navigation.glonass is not None
    known = [glonass_broadcast.Constellation(navigation.glonass), gps.Constellation(navigation.gps)]
    found = solve(observations, known, Settings(mask=0.0, troposphere=False))
    ours = ecef_from_llh(alone["/receiver/position_llh"][0])
    assert np.linalg.norm(found.position - ours, axis=1).max() < 0.02
    assert np.abs(found.velocity - alone["/receiver/velocity_ned"][0]).max() < 0.2
    np.testing.assert_allclose(found.clocks[:, 0], alone["/receiver/clock"][0][:, 0], atol=0.05)


@pytest.mark.filterwarnings("ignore::FutureWarning:georinex")
def test_georinex_reads_the_same(noisy: Result, tmp_path: Path) -> None:
    georinex = pytest.importorskip("georinex")
    export(noisy, tmp_path / "r.h5", ["rinex"])
    theirs, ours = georinex.load(tmp_path / "r.obs"), read_obs(tmp_path / "r.obs")
    assert list(theirs.sv.values) == list(ours.satellites)
    for code in ("C1C", "D1C", "S1C"):
        np.testing.assert_allclose(theirs[code].values, ours.values[code], atol=1e-9)
    messages, mine = georinex.load(tmp_path / "r.nav"), read_nav(tmp_path / "r.nav").gps
    assert mine is not None
    first = messages.sel(sv="G05").isel(time=np.flatnonzero(np.isfinite(messages.sel(sv="G05")["sqrtA"].values))[:1])
    mine = mine.take(np.flatnonzero(mine.prn == 5)[:1])
    for there, here in (("sqrtA", mine.sqrt_a), ("M0", mine.m0), ("Omega0", mine.omega0), ("Io", mine.i0)):
        np.testing.assert_allclose(first[there].values, here, rtol=1e-12)


def test_a_real_sky_survives_the_round_trip(shared: Path, tmp_path: Path) -> None:
    """A landing under a day's real messages, with their clocks and group delays."""
    source = shared / "data/esbc_2020177/ESBC00DNK_R_20201770000_01D_MN.rnx.gz"
    result = flown(f"sky.navigation={source}", "epoch=2020-06-25T10:00:00Z", *EXACT, sky="navigation")
    export(result, tmp_path / "r.h5", ["rinex"])
    _, position, _ = rnx2rtkp(tmp_path)
    assert np.linalg.norm(position - antenna(result), axis=1).max() < 0.05


def test_pseudolites_go_to_their_own_table(noisy: Result, tmp_path: Path) -> None:
    written = export(noisy, tmp_path / "r.h5", ["rinex"])
    table = tmp_path / "r_pseudolites.csv"
    assert table in written
    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 2 * noisy["/geometry/time"].size
    assert {r["name"] for r in rows} == {"PL1", "PL2"}
    place = np.array([float(rows[0][k]) for k in ("x_m", "y_m", "z_m")])
    np.testing.assert_allclose(place, ecef_from_llh(noisy["/pseudolites/position_llh"][0]), atol=1e-3)
    i = list(noisy["/geometry/source"]).index("PL1")
    assert float(rows[0]["pseudorange_m"]) == pytest.approx(noisy["/measurements/pseudorange"][0, 0, i], abs=1e-3)


def test_nmea_and_csv_say_what_the_fixes_are(noisy: Result, tmp_path: Path) -> None:
    export(noisy, tmp_path / "r.h5", ["nmea", "csv"])
    ours = noisy["/receiver/position_llh"][0]
    for name, tolerance in (("r.nmea", 2e-3), ("r_gnss.csv", 1e-4)):
        fixes, dropped = read_fixes(tmp_path / name)
        assert not dropped.counts
        np.testing.assert_allclose(ecef_from_llh(fixes.llh), ecef_from_llh(ours), atol=tolerance)
        np.testing.assert_allclose(fixes.velocity[:, :2], noisy["/receiver/velocity_ned"][0][:, :2], atol=0.02)
    filter_rows = list(csv.DictReader((tmp_path / "r_filter.csv").open()))
    assert float(filter_rows[-1]["error_position_down"]) == pytest.approx(noisy["/filter/error"][0, -1, 2], rel=1e-6)
    assert len(list(csv.DictReader((tmp_path / "r_truth.csv").open()))) == noisy["/truth/time"].size


def test_maps(noisy: Result, tmp_path: Path) -> None:
    shapely = pytest.importorskip("shapely.geometry")
    export(noisy, tmp_path / "r.h5", ["kml", "geojson"])
    features = json.loads((tmp_path / "r.geojson").read_text())["features"]
    kinds = [f["properties"]["kind"] for f in features]
    assert {"track", "runway", "pseudolite", "ellipse"} <= set(kinds)
    for f in features:
        shape = shapely.shape(f["geometry"])
        assert shape.is_valid
        if f["properties"]["kind"] == "ellipse":
            assert shape.exterior.is_ccw
            assert f["properties"]["semi_major_m"] >= f["properties"]["semi_minor_m"] > 0.0
    track = features[kinds.index("track")]["geometry"]["coordinates"]
    np.testing.assert_allclose(track[0][:2], np.degrees(noisy["/truth/position_llh"][0, [1, 0]]), atol=1e-8)
    names = {"k": "http://www.opengis.net/kml/2.2"}
    root = ElementTree.parse(tmp_path / "r.kml").getroot()
    assert len(root.findall(".//k:Placemark", names)) == len(features)


def test_what_cannot_be_exported_is_said(noisy: Result, tmp_path: Path) -> None:
    c = case("receiver.rate_hz=2")
    bare = landing.result(c, landing.fly_all(c, 1, 0, 2, 1, keep="errors"), 1, keep="errors")
    with pytest.raises(ResultError, match="--keep all"):
        export(bare, tmp_path / "r.h5", ["rinex"])
    listed = case("receiver.rate_hz=2", name="table2")
    flat = landing.result(listed, landing.fly_all(listed, 1, 0, 1, 1, keep="all"), 1, keep="all")
    with pytest.raises(ResultError, match="no navigation messages"):
        export(flat, tmp_path / "r.h5", ["rinex"])
    with pytest.raises(ResultError, match="cannot be written"):
        export(noisy, tmp_path / "missing" / "r.h5", ["csv"])
    assert not list(tmp_path.iterdir())


def test_a_replay_as_map_and_table(tmp_path: Path) -> None:
    from navsim.scenario.load import read_replay
    from navsim.study import replay
    from tests.recordings import write_flight

    write_flight(tmp_path, duration=30.0)
    result = replay.compute(replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none",))))
    export(result, tmp_path / "f.h5", ["csv", "kml", "geojson"])
    rows = list(csv.DictReader((tmp_path / "f_flight.csv").open()))
    assert float(rows[-1]["lat_rad"]) == pytest.approx(result["/filter/position_llh"][-1, 0], rel=1e-11)
    assert float(rows[-1]["sigma_attitude_down"]) == pytest.approx(result["/filter/sigma"][-1, 8], rel=1e-9)
    assert len(json.loads((tmp_path / "f.geojson").read_text())["features"]) == 2
    ElementTree.parse(tmp_path / "f.kml")
    with pytest.raises(ResultError, match="nothing for --rinex"):
        export(result, tmp_path / "f.h5", ["rinex"])
