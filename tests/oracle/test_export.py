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

from navsim.formats.export import export
from navsim.formats.export_maps import _runway
from navsim.formats.recording import read_fixes
from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import read_obs
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.landing import study as landing
from navsim.replays.single_point import PositioningOptions, solve
from navsim.results.result import Result, ResultError, read
from navsim.runner.executor import threads
from tests.conftest import Within
from tests.forks import navsim
from tests.helpers import SCENARIOS, case
from tests.unit.test_two_line import GPS as GPS_BY_TWO_LINES

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
    return landing.result(c, landing.fly_all(c, 1, 0, 1, threads(1), keep="all"), 1, keep="all")


@pytest.fixture(scope="module")
def noisy() -> Result:
    return flown()


def rnx2rtkp(folder: Path, **options: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (s of the first epoch's minute), ECEF positions, numbers of satellites by RTKLIB; options: of its pos1."""
    program = shutil.which("rnx2rtkp")
    if program is None:
        pytest.skip("needs RTKLIB's rnx2rtkp (Debian package rtklib), which is not installed")
    conf = dict(line.split("=") for line in RTKLIB.split()) | {f"pos1-{k}": v for k, v in options.items()}
    (folder / "rtk.conf").write_text("".join(f"{key}={value}\n" for key, value in conf.items()))
    command = [program, "-k", "rtk.conf", "-o", "out.pos", "r.obs", "r.nav"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    table = np.loadtxt(folder / "out.pos", comments="%", ndmin=2)
    return table[:, 1], table[:, 2:5], table[:, 6]


def antenna(result: Result) -> np.ndarray:
    """True antenna at the fix epochs, ECEF; the shipped landing has no lever arm."""
    ecef = ecef_from_llh(result["/truth/position_llh"])
    index = np.searchsorted(result["/truth/time"], result["/geometry/time"] - 1e-9)
    return ecef[index]


@pytest.mark.validates("Exported RINEX of error-free GPS, GLONASS and both", "RTKLIB rnx2rtkp 2.4.3", "at every epoch",
                       distance="0.05 m")  # fmt: skip
@pytest.mark.parametrize("sky", ["nominal-gps", "nominal-glonass", "nominal"])
def test_rtklib_finds_the_true_path(sky: str, tmp_path: Path, within: Within) -> None:
    result = flown(*EXACT, sky=sky)
    export(result, tmp_path / "r.h5", ["rinex"])
    _, position, satellites = rnx2rtkp(tmp_path)
    truth = antenna(result)
    assert position.shape == truth.shape
    assert np.linalg.norm(position - truth, axis=1).max() < within["distance"]
    assert satellites.min() >= 5


@pytest.mark.validates("Exported RINEX of error-free Galileo, BeiDou and all systems", "RTKLIB rnx2rtkp 2.4.3",
                       "at every epoch", distance="0.05 m")  # fmt: skip
@pytest.mark.parametrize(("systems", "letters"), [("galileo", 8), ("beidou", 32), ("gps, galileo, beidou", 41)])
def test_rtklib_finds_the_true_path_by_other_systems(
    systems: str, letters: int, tmp_path: Path, within: Within
) -> None:
    result = flown(*EXACT, f"sky.systems=[{systems}]")
    export(result, tmp_path / "r.h5", ["rinex"])
    _, position, satellites = rnx2rtkp(tmp_path, navsys=str(letters))
    truth = antenna(result)
    assert position.shape == truth.shape
    assert np.linalg.norm(position - truth, axis=1).max() < within["distance"]
    assert satellites.min() >= 5


def header(path: Path, label: str) -> list[str]:
    """Contents of the header's lines of a label."""
    head = path.read_text().split("END OF HEADER")[0].splitlines()
    return [line[:60].rstrip() for line in head if line[60:].strip() == label]


def comments(folder: Path) -> str:
    """What the comments say, the same in both files."""
    said = [" ".join(header(folder / name, "COMMENT")) for name in ("r.obs", "r.nav")]
    assert said[0] == said[1]
    return said[0]


LEAP = ("epoch=2016-12-31T23:59:30.25Z", "duration_s=60")


@pytest.fixture(scope="module")
def leaping() -> Result:
    return flown(*LEAP, *EXACT)


@pytest.mark.validates("Exported RINEX of GPS and GLONASS through the leap second of 2016", "RTKLIB rnx2rtkp 2.4.3",
                       "at every epoch, 23:59:60 too", distance="0.05 m")  # fmt: skip
def test_rtklib_follows_through_a_leap_second(leaping: Result, tmp_path: Path, within: Within) -> None:
    export(leaping, tmp_path / "r.h5", ["rinex"])
    _, position, satellites = rnx2rtkp(tmp_path)
    truth = antenna(leaping)
    assert position.shape == truth.shape
    assert np.linalg.norm(position - truth, axis=1).max() < within["distance"]
    assert satellites.min() >= 10
    # 17 s now, 18 s after the seventh day of GPS week 1929
    for name in ("r.obs", "r.nav"):
        assert header(tmp_path / name, "LEAP SECONDS") == ["    17    18  1929     7"]
    vectors = read_nav(tmp_path / "r.nav").glonass
    assert vectors is not None
    assert set(vectors.time % 1800.0) == {0.0}
    # a message's frame is told in seconds of the week of UTC; 2017-01-01 was a Sunday
    first = [line[61:80] for line in (tmp_path / "r.nav").read_text().splitlines() if line.startswith("R")]
    assert {float(x.replace("D", "E")) % 1800.0 for x in first} == {0.0}
    assert float(first[0].replace("D", "E")) in (0.0, 603000.0)


def test_nmea_has_the_leap_second(leaping: Result, tmp_path: Path) -> None:
    export(leaping, tmp_path / "r.h5", ["nmea"])
    said = [line.split(",") for line in (tmp_path / "r.nmea").read_text().splitlines() if line.startswith("$GNRMC")]
    assert [(x[1], x[9]) for x in said[57:64]] == [
        ("235959.25", "311216"), ("235959.75", "311216"), ("235960.25", "311216"), ("235960.75", "311216"),
        ("000000.25", "010117"), ("000000.75", "010117"), ("000001.25", "010117"),
    ]  # fmt: skip


def test_our_reader_gives_no_fix_of_a_leap_second_another_time(leaping: Result, tmp_path: Path) -> None:
    export(leaping, tmp_path / "r.h5", ["nmea"])
    fixes, dropped = read_fixes(tmp_path / "r.nmea")
    ours = ecef_from_llh(leaping["/receiver/position_llh"][0])
    since = leaping["/geometry/time"] + 0.25  # of 23:59:30
    inside = (since >= 30.0) & (since < 31.0)
    np.testing.assert_allclose(ecef_from_llh(fixes.llh), ours[~inside], atol=2e-3)
    posix = since[~inside] - (since[~inside] >= 31.0)
    np.testing.assert_allclose(fixes.time - fixes.time[0], posix - posix[0], atol=1e-6)
    assert dropped.counts == {"NMEA sentences without a time of day (a leap second has none)": 4}


def test_fractions_of_the_epoch_are_kept(leaping: Result, tmp_path: Path) -> None:
    assert leaping.attributes["epoch"] == "2016-12-31T23:59:30.25Z"
    export(leaping, tmp_path / "r.h5", ["rinex"])
    first = header(tmp_path / "r.obs", "TIME OF FIRST OBS")[0].split()
    # GPS time is 17 s ahead, the receiver's clock 100 us, the first fix after half a second
    assert first == ["2016", "12", "31", "23", "59", "47.7501000", "GPS"]


ALPHA = "alpha: [2.0e-8, 1.5e-8, -1.2e-7, -6.0e-8], beta: [1.2e5, 3.3e4, -2.6e5, -6.6e4]"


@pytest.mark.validates("Exported RINEX with ionosphere and troposphere",
                       "RTKLIB rnx2rtkp 2.4.3: broadcast ionosphere, MOPS troposphere",
                       "at every epoch, either and both", distance="0.1 m")  # fmt: skip
@pytest.mark.parametrize("air", ["ionosphere", "troposphere", "both"])
def test_rtklib_takes_the_atmosphere_off(air: str, tmp_path: Path, within: Within) -> None:
    iono = f"signals.ionosphere={{{ALPHA}, truth_scale: 1.0, corrected: false}}"
    tropo = "signals.troposphere={truth_scale: 1.0, correction: none}"
    wanted = {"ionosphere": (iono,), "troposphere": (tropo,), "both": (iono, tropo)}[air]
    result = flown(*EXACT, *wanted, "sky.mask_deg=15", "duration_s=30")
    export(result, tmp_path / "r.h5", ["rinex"])
    truth = antenna(result)
    bare = np.linalg.norm(rnx2rtkp(tmp_path)[1] - truth, axis=1)
    options = {"ionosphere": {"ionoopt": "brdc"}, "troposphere": {"tropopt": "sbas"}}
    chosen = {k: v for name in options if air in (name, "both") for k, v in options[name].items()}
    corrected = np.linalg.norm(rnx2rtkp(tmp_path, **chosen)[1] - truth, axis=1)
    assert bare.min() > 2.0
    assert corrected.size == truth.shape[0]
    assert corrected.max() < within["distance"]
    alpha_beta = read_nav(tmp_path / "r.nav").klobuchar
    if air == "troposphere":
        assert alpha_beta is None
        assert not header(tmp_path / "r.nav", "IONOSPHERIC CORR")
    else:
        assert header(tmp_path / "r.nav", "IONOSPHERIC CORR") == [
            "GPSA   2.0000D-08  1.5000D-08 -1.2000D-07 -6.0000D-08",
            "GPSB   1.2000D+05  3.3000D+04 -2.6000D+05 -6.6000D+04",
        ]
        assert alpha_beta is not None
        np.testing.assert_allclose(alpha_beta[1], [1.2e5, 3.3e4, -2.6e5, -6.6e4])


@pytest.mark.parametrize(
    ("keys", "said", "not_said"),
    [
        ((), ["no ionosphere", "no troposphere"], ["residual", "GLONASS time", "smoothed", "errors of the messages"]),
        (
            ("signals.ionosphere={truth_scale: 1.25, corrected: false}", "signals.troposphere={correction: none}"),
            ["1.25 times Klobuchar's delay alpha 1.1176e-08",
             "1.02 times the climatology of DO-229 with Niell's mapping"],
            ["residual", "no ionosphere", "no troposphere"],
        ),
        (
            ("signals.ionosphere={truth_scale: 1.5}", "signals.troposphere={}", "signals.ephemeris={}"),
            ["1.5 times Klobuchar's delay less the model: only a residual is in, correct no more",
             "Niell's mapping less Saastamoinen's model: only a residual is in, correct no more",
             "orbits 0.3, 1, 0.7 m (radial, along, across), clocks 1 m, 1 sigma"],
            ["no ionosphere", "no troposphere"],
        ),
        (
            ("signals.ionosphere={corrected: false}", "pseudolites.differential={latency_s: 2}",
             "receiver.smoothing_s=60", "signals.gps_offset_ns=-25"),
            ["differential corrections, 2 s old, are applied: of all these only a residual is in, correct no more",
             "code smoothed by the carrier, memory 60 s", "GPS time less GLONASS time: -25 ns"],
            ["no ionosphere"],
        ),
    ],
)  # fmt: skip
def test_rinex_says_what_is_in_the_pseudoranges(
    keys: tuple[str, ...], said: list[str], not_said: list[str], tmp_path: Path
) -> None:
    """And gives coefficients only to those who still have to correct."""
    export(flown("duration_s=3", *keys), tmp_path / "r.h5", ["rinex"])
    text = comments(tmp_path)
    assert all(x in text for x in said), text
    assert not any(x in text for x in not_said), text
    whole = "residual" not in text and "no ionosphere" not in text
    assert bool(header(tmp_path / "r.nav", "IONOSPHERIC CORR")) == whole
    offset = "-2.5000000000D-08" if "signals.gps_offset_ns=-25" in keys else " 0.0000000000D+00"
    # 2018-09-13 12:00 UTC is second 388818 of GPS week 2018
    assert header(tmp_path / "r.nav", "TIME SYSTEM CORR") == [f"GLGP {offset} 0.000000000D+00 388818 2018"]


def test_the_offset_between_systems_is_in_the_pseudoranges(tmp_path: Path) -> None:
    export(flown(*EXACT, "duration_s=3", "signals.gps_offset_ns=100"), tmp_path / "r.h5", ["rinex"])
    navigation = read_nav(tmp_path / "r.nav")
    assert navigation.gps is not None
    assert navigation.glonass is not None
    known = navigation.constellations()
    found = solve(read_obs(tmp_path / "r.obs"), known, PositioningOptions(mask=0.0, troposphere=False))
    # a receiver's clock is by so much less ahead of the time scale that is ahead itself
    np.testing.assert_allclose(found.clocks[:, 0] - found.clocks[:, 1], 299792458.0 * 100e-9, atol=0.05)


def test_satellites_without_messages_are_named(tmp_path: Path) -> None:
    """GPS by two-line elements beside GLONASS by an almanac: only the latter has messages that can be written."""
    (tmp_path / "gps.tle").write_text("\n".join(GPS_BY_TWO_LINES) + "\n")
    files = f"sky.almanac=[{SCENARIOS / 'data/nominal.agl'}, {tmp_path / 'gps.tle'}]"
    export(flown("duration_s=3", files, sky="almanac"), tmp_path / "r.h5", ["rinex"])
    assert "for want of messages to write: G0" in comments(tmp_path)
    assert {name[0] for name in read_obs(tmp_path / "r.obs").satellites} == {"R"}
    export(flown("duration_s=3"), tmp_path / "all.h5", ["rinex"])
    assert "for want of" not in (tmp_path / "all.obs").read_text()


def test_one_system_has_no_offset_between_systems(tmp_path: Path) -> None:
    export(flown("duration_s=3", sky="nominal-gps"), tmp_path / "r.h5", ["rinex"])
    assert not header(tmp_path / "r.nav", "TIME SYSTEM CORR")


@pytest.mark.validates("Exported RINEX of noisy measurements", "RTKLIB rnx2rtkp 2.4.3", RMS="25 %", correlation="0.8")
def test_rtklib_agrees_with_our_fixes(tmp_path: Path, within: Within) -> None:
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
    assert np.all((ratio > 1.0 / (1.0 + within["RMS"])) & (ratio < 1.0 + within["RMS"])), ratio
    assert all(np.corrcoef(theirs[:, i], ours[:, i])[0, 1] > within["correlation"] for i in range(3))
    assert np.sqrt(np.mean(np.sum(theirs**2, axis=1))) == pytest.approx(
        np.sqrt(np.mean(np.sum(ours**2, axis=1))), rel=within["RMS"]
    )


def test_our_own_reader_and_solver_find_the_fixes_again(noisy: Result, tmp_path: Path) -> None:
    """Written, read, solved with the weights of the landing: the receiver's fixes to millimetres (RINEX has three
    decimals), pseudolites apart."""
    alone = flown("pseudolites.count=0")
    export(alone, tmp_path / "r.h5", ["rinex"])
    observations, navigation = read_obs(tmp_path / "r.obs"), read_nav(tmp_path / "r.nav")
    assert navigation.gps is not None
    assert navigation.glonass is not None
    known = navigation.constellations()
    found = solve(observations, known, PositioningOptions(mask=0.0, troposphere=False))
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
    assert float(filter_rows[-1]["error_position_down_m"]) == pytest.approx(noisy["/filter/error"][0, -1, 2], rel=1e-6)
    assert len(list(csv.DictReader((tmp_path / "r_truth.csv").open()))) == noisy["/truth/time"].size


def test_columns_of_states_end_with_their_units(tmp_path: Path) -> None:
    """Those of errors of fixes are of the size they had before anything was measured, as figures have them."""
    export(flown("duration_s=3", name="landing_open_sky"), tmp_path / "r.h5", ["csv"])
    head = (tmp_path / "r_filter.csv").read_text().splitlines()[0].split(",")
    assert {"error_fix_error_slow_north_prior_sigma", "sigma_fix_error_slow_more_3_prior_sigma"} <= set(head)
    assert all(name.endswith(("_m", "_m_s", "_rad", "_rad_s", "_m_s2", "_prior_sigma")) for name in head[1:])


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


def test_a_runway_that_rises_is_drawn_so() -> None:
    level = {"heading_deg": 40.0, "width_m": 30.0, "length_m": 1000.0}
    threshold = np.array([0.98, 0.65, 12.0])
    up = np.array([_runway(threshold, level | {"slope_percent": s})["coordinates"] for s in (0.0, 1.5)])[..., 2]
    np.testing.assert_allclose(up[1] - up[0], [0.0, 15.0, 15.0, 0.0, 0.0], atol=2e-3)


def test_ellipses_lie_about_the_antenna(tmp_path: Path) -> None:
    """Fixes are of the antenna: five metres ahead of the IMU, to the north, their ellipses are there."""
    shapely = pytest.importorskip("shapely.geometry")
    result = flown("receiver.lever_arm_m=[5, 0, 0]", "duration_s=20")
    export(result, tmp_path / "r.h5", ["geojson"])
    features = json.loads((tmp_path / "r.geojson").read_text())["features"]
    ellipses = [f for f in features if f["properties"]["kind"] == "ellipse"]
    assert ellipses
    for f in ellipses:
        here = np.argmin(np.abs(result["/truth/time"] - f["properties"]["t_s"]))
        latitude = np.radians(shapely.shape(f["geometry"]).centroid.y)
        ahead = 6.37e6 * (latitude - result["/truth/position_llh"][here, 0])
        assert ahead == pytest.approx(5.0 * np.cos(result["/truth/attitude_rpy"][here, 1]), abs=0.05)


def test_what_cannot_be_exported_is_said(noisy: Result, tmp_path: Path) -> None:
    c = case("receiver.rate_hz=2")
    bare = landing.result(c, landing.fly_all(c, 1, 0, 2, threads(1), keep="errors"), 1, keep="errors")
    with pytest.raises(ResultError, match="--keep all"):
        export(bare, tmp_path / "r.h5", ["rinex"])
    said = r"--rinex: the result has no measurements .*; --nmea: .* no fixes .*; nothing .*, but --kml and --csv"
    with pytest.raises(ResultError, match=said):
        export(bare, tmp_path / "r.h5", ["kml", "rinex", "nmea", "csv"])
    listed = case("receiver.rate_hz=2", name="table2")
    flat = landing.result(listed, landing.fly_all(listed, 1, 0, 1, threads(1), keep="all"), 1, keep="all")
    with pytest.raises(ResultError, match="no navigation messages"):
        export(flat, tmp_path / "r.h5", ["rinex"])
    with pytest.raises(ResultError, match="cannot be written"):
        export(noisy, tmp_path / "missing" / "r.h5", ["csv"])
    short = flown("duration_s=0.4", sky="nominal-gps")
    with pytest.raises(ResultError, match="shorter than one fix interval"):
        export(short, tmp_path / "r.h5", ["rinex"])
    assert not list(tmp_path.iterdir())


def test_places_of_a_sweep_are_those_of_landings(tmp_path: Path) -> None:
    """Each combination, with its settings and outputs; where a landing with them has its pseudolites."""
    (tmp_path / "s.yaml").write_text(
        f"kind: sweep\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\nset: {{runway.heading_deg: 33}}\nmethod: dop\n"
        "vary: [{key: pseudolites.s_m, values: [300, 4000]}, {key: pseudolites.count, values: [1, 2]}]\n"
    )
    navsim("sweep", "s.yaml", "-q", "--figures", "none", "-o", "s.h5", cwd=tmp_path)
    navsim("export", "s.h5", "--geojson", "--kml", cwd=tmp_path)
    _, *places = json.loads((tmp_path / "s.geojson").read_text())["features"]
    assert [p["properties"]["name"] for p in places] == [
        "PL1, combination 1", "PL1, combination 2", "PL2, combination 2", "PL1, combination 3", "PL1, combination 4",
        "PL2, combination 4",
    ]  # fmt: skip
    table = list(csv.DictReader((tmp_path / "s.csv").open()))
    for place in places:
        row = table[int(place["properties"]["name"].split()[-1]) - 1]
        told = {name: value for name, value in place["properties"].items() if name not in ("kind", "name")}
        assert told == {name: pytest.approx(float(text), rel=1e-8) for name, text in row.items()}
    wide = ("--set", "runway.heading_deg=33", "--set", "pseudolites.s_m=4000", "--set", "duration_s=2")
    navsim("run", SCENARIOS / "landing.yaml", *wide, "-q", "--figures", "none", "-o", "r.h5", cwd=tmp_path)
    there = np.degrees(read(tmp_path / "r.h5")["/pseudolites/position_llh"][:, [1, 0]])
    found = [place["geometry"]["coordinates"][:2] for place in places[-2:]]
    np.testing.assert_allclose(found, there, atol=2e-7)  # a centimetre, four kilometres away
    names = {"k": "http://www.opengis.net/kml/2.2"}
    assert len(ElementTree.parse(tmp_path / "s.kml").getroot().findall(".//k:Placemark", names)) == 7


def test_a_replay_as_map_and_table(tmp_path: Path) -> None:
    from navsim.replays import study as replay
    from navsim.scenario.load import read_replay
    from tests.recordings import write_flight

    write_flight(tmp_path, duration=30.0)
    result = replay.compute(replay.prepare(*read_replay(tmp_path / "log.yaml", ("tuning=none",))))
    export(result, tmp_path / "f.h5", ["csv", "kml", "geojson"])
    rows = list(csv.DictReader((tmp_path / "f_flight.csv").open()))
    assert float(rows[-1]["lat_rad"]) == pytest.approx(result["/filter/position_llh"][-1, 0], rel=1e-11)
    assert float(rows[-1]["sigma_attitude_down_rad"]) == pytest.approx(result["/filter/sigma"][-1, 8], rel=1e-9)
    assert len(json.loads((tmp_path / "f.geojson").read_text())["features"]) == 2
    ElementTree.parse(tmp_path / "f.kml")
    with pytest.raises(ResultError, match="nothing for --rinex"):
        export(result, tmp_path / "f.h5", ["rinex"])


@pytest.mark.parametrize(("systems", "talker"), [("[gps]", "GP"), ("[galileo]", "GA"), ("[gps, glonass]", "GN")])
def test_the_talker_is_that_of_the_satellites(systems: str, talker: str, tmp_path: Path) -> None:
    """NMEA 0183: GN for a fix of several systems, else the system's own."""
    sky = f"sky={{source: nominal, systems: {systems}}}"
    this = case(sky, "pseudolites={count: 0}", "duration_s=1.5", "imu.rate_hz=20")
    result = landing.result(this, landing.fly_all(this, 1, 0, 1, threads(1), keep="all"), 1, keep="all")
    (file,) = export(result, tmp_path / "r.h5", ["nmea"])
    assert {line[1:3] for line in file.read_text().splitlines()} == {talker}


def test_an_exported_run_is_replayed(tmp_path: Path) -> None:
    """`export --imu` writes a log that `navsim replay` flies as it is, without a warning; its estimates lie within its
    sigmas about the truth of the simulation (`consistency/test_round_trip.py` has them beside the run's)."""
    keys = ("duration_s=60", "receiver.latency_s=0.2", "receiver.lever_arm_m=[1, 0, -0.5]")
    settings = [part for key in keys for part in ("--set", key)]
    navsim("run", SCENARIOS / "s_turn.yaml", *settings, "-q", "--figures", "none", "-o", "r.h5", cwd=tmp_path)
    done = navsim("export", "r.h5", "--imu", cwd=tmp_path)
    assert done.stdout.split() == ["r_imu.csv", "r_fixes.csv", "r_replay.yaml"]
    assert not done.stderr
    done = navsim("replay", "r_replay.yaml", "-q", "--figures", "none", "-o", "f.h5", cwd=tmp_path)
    assert "warning" not in done.stderr
    run, flown = read(tmp_path / "r.h5"), read(tmp_path / "f.h5")
    assert flown["/filter/time"][0] == 0.0
    samples = np.loadtxt(tmp_path / "r_imu.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(samples[:, 1:4] * 0.01, run["/imu/delta_angle"][0], rtol=1e-12, atol=1e-17)
    np.testing.assert_allclose(samples[:, 4:] * 0.01, run["/imu/delta_velocity"][0], rtol=1e-12, atol=1e-14)
    time = flown["/filter/time"]
    late = time > 40.0
    truth = np.stack([np.interp(time, run["/truth/time"], x) for x in run["/truth/position_llh"].T], axis=1)
    error = ecef_from_llh(truth[late]) - ecef_from_llh(flown["/filter/position_llh"].reshape(-1, 3)[late])
    sigma = np.linalg.norm(flown["/filter/sigma"].reshape(time.size, -1)[late, :3], axis=1)
    assert np.all(np.linalg.norm(error, axis=1) < 4.0 * sigma)
