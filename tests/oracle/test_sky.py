"""Satellites of Galileo, BeiDou and QZSS: messages, orbits and clocks of a real day; the design constellations."""

from __future__ import annotations

import gzip
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.formats.rinex_nav import Navigation, read_nav, time_offset
from navsim.formats.sp3 import read_sp3
from navsim.geodesy.earth import SPEED_OF_LIGHT, ecef_from_llh
from navsim.gnss import timescales
from navsim.gnss.constellations import gps, nominal_constellations
from navsim.gnss.constellations.nominal import design
from navsim.gnss.constellations.systems import BEIDOU, GALILEO, GPS, QZSS, SYSTEMS, System
from navsim.gnss.dop import dops
from navsim.gnss.sky import azimuth_elevation, enu_matrix
from navsim.landing.study import prepare
from navsim.scenario.load import read
from navsim.scenario_files.source import InputError
from tests.conftest import DATA, SCENARIOS, Within

BROADCAST = "data/esbc_2020177/ESBC00DNK_R_20201770000_01D_MN.rnx.gz"
PRECISE = "data/esbc_2020177/GRG0MGXFIN_20201770000_01D_15M_ORB.SP3.gz"
NOON_UTC = timescales.posix(2020, 6, 25, 12) - 18.0
NOON = float(timescales.gps_from_utc(NOON_UTC))
"""12:00 GPS time of the day of the messages."""
DATE_OF_SLOTS = timescales.posix(1993, 7, 1)


def oracle(name: str) -> dict[str, Any]:
    return json.loads((DATA / "sky.json").read_text())[name]


@pytest.fixture(scope="module")
def navigation(shared: Path) -> Navigation:
    return read_nav(shared / BROADCAST, systems=SYSTEMS)


def nearest(navigation: Navigation, system: System, prn: int) -> gps.Elements:
    """The record of a satellite whose reference time is nearest to noon."""
    records = navigation.elements[system, system.message]
    mine = np.flatnonzero(records.prn == prn)
    return records.take(mine[[np.argmin(np.abs(records.toe[mine] - NOON))]])


@pytest.mark.validates("Broadcast positions and clocks of GPS and of BeiDou's three kinds of orbits",
                       "RTKLIB (pyrtklib 0.2.7, eph2pos)", position="1e-3 m", clock="1e-12 s")  # fmt: skip
@pytest.mark.parametrize(
    ("name", "system", "key"),
    [
        ("C05", BEIDOU, "C05_GEO_toe_388800_bdt"), ("C06", BEIDOU, "C06_IGSO_toe_388800_bdt"),
        ("C19", BEIDOU, "C19_MEO_toe_388800_bdt"), ("G05", GPS, "G05_toe_388784"),
    ],
)  # fmt: skip
def test_positions_by_messages(name: str, system: System, key: str, navigation: Navigation, within: Within) -> None:
    given, record = oracle("broadcast_positions_rtklib"), nearest(navigation, system, int(name[1:]))
    assert record.toe[0] - NOON == (14.0 if system is BEIDOU else -16.0)
    position, velocity = record.state(np.array([NOON]), system)
    np.testing.assert_allclose(position[0], given[key], rtol=0.0, atol=within["position"])
    clock, _ = record.clock(np.array([NOON]), system)
    assert clock[0] == pytest.approx(given["clock_s"][name], abs=within["clock"])
    near = (record.state(np.array([NOON + h]), system)[0] for h in (0.5, -0.5))
    np.testing.assert_allclose(velocity, np.subtract(*near), atol=1e-5)


@pytest.mark.validates("A Galileo position by I/NAV", "RTKLIB (eph2pos)", position="0.01 m")
def test_a_galileo_position(navigation: Navigation, within: Within) -> None:
    given, record = oracle("galileo_inav_position"), nearest(navigation, GALILEO, 1)
    assert record.toe[0] == NOON
    position = record.state(np.array([NOON]), GALILEO)[0][0]
    np.testing.assert_allclose(position, given["E01"], rtol=0.0, atol=within["position"])
    assert np.linalg.norm(position - given["sp3"]) == pytest.approx(given["distance_m"], abs=within["position"])


@pytest.mark.validates("Statistics of the broadcast errors of GPS and Galileo (I/NAV) over a day",
                       "independent script on the messages and the precise orbits of CNES/GRGS, 2020-06-25",
                       "(count, median, RMS, 95 %, radial mean, tangential and clock RMS)",
                       statistics="2 %")  # fmt: skip
@pytest.mark.parametrize(
    ("key", "system", "reach", "ahead"),
    [
        ("GPS", GPS, 7200.0, 7200.0), ("GAL_INAV", GALILEO, 3600.0, 1800.0),
        ("GAL_INAV_age_4h", GALILEO, 14400.0, 1800.0),
    ],
)  # fmt: skip
def test_broadcast_less_precise(
    key: str, system: System, reach: float, ahead: float, navigation: Navigation, shared: Path, within: Within
) -> None:
    ours = gps.KeplerianEphemerides(navigation.elements[system, system.message], reach, ahead, system=system)
    precise = read_sp3(shared / PRECISE).of(system)
    common = [name for name in precise.names if name in ours.names]
    mine, theirs = ([one.names.index(name) for name in common] for one in (ours, precise))
    position, velocity = (part[:, mine] for part in ours.state(precise.time))
    table = precise.position[:, theirs]
    error = position - table
    there = np.isfinite(error[..., 0]) & np.isfinite(precise.offset[:, theirs])
    outward = table / np.linalg.norm(table, axis=2, keepdims=True)
    across = np.cross(outward, velocity + np.cross([0.0, 0.0, system.earth_rate], position))
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    size = np.linalg.norm(error, axis=2)[there]
    radial = np.sum(error * outward, axis=2)[there]
    record = ours.records.take(ours.chosen(np.repeat(precise.time[:, None], len(ours.names), axis=1))[:, mine])
    since = precise.time[:, None] - record.toc
    clock = record.af0 + record.af1 * since + record.af2 * since**2 - precise.offset[:, theirs]
    clock[~there] = np.nan
    clock -= np.nanmedian(clock, axis=1, keepdims=True)
    found = [
        size.size, np.median(size), np.sqrt(np.mean(size**2)), np.percentile(size, 95), radial.mean(),
        np.sqrt(np.mean(size**2 - radial**2)), SPEED_OF_LIGHT * np.sqrt(np.nanmean(clock**2)),
    ]  # fmt: skip
    np.testing.assert_allclose(found, oracle("broadcast_minus_sp3")[key], rtol=within["statistics"])


@pytest.mark.validates("Difference of Galileo clocks by I/NAV and by F/NAV, with group delays",
                       "independent script on the same messages", statistics="2 %")  # fmt: skip
def test_group_delays_bring_both_galileo_messages_together(navigation: Navigation, within: Within) -> None:
    given = oracle("galileo_bgd")
    inav, fnav = (navigation.elements[GALILEO, name] for name in ("INAV", "FNAV"))
    pairs = [
        (i, k)
        for i in np.flatnonzero(inav.healthy)
        for k in np.flatnonzero((fnav.prn == inav.prn[i]) & (fnav.toc == inav.toc[i]) & fnav.healthy)
    ]
    i, k = np.array(pairs).T
    assert len(pairs) == given["pairs"]
    raw = SPEED_OF_LIGHT * (inav.af0[i] - fnav.af0[k])
    after = raw - SPEED_OF_LIGHT * (inav.tgd[i] - fnav.tgd[k])
    found = [np.sqrt(np.mean(raw**2)), np.sqrt(np.mean(after**2)), after.mean()]
    wanted = [given["raw_rms_m"], given["after_bgd_rms_m"], given["after_bgd_mean_m"]]
    np.testing.assert_allclose(found, wanted, rtol=within["statistics"])


@pytest.mark.validates("Jumps between hourly BeiDou messages", "independent script", jump="0.02 m")
@pytest.mark.parametrize("name", ["C05", "C06", "C19", "C23", "C30"])
def test_beidou_messages_follow_each_other(name: str, navigation: Navigation, within: Within) -> None:
    records = navigation.elements[BEIDOU, BEIDOU.message]
    mine = np.flatnonzero(records.prn == int(name[1:]))
    mine = mine[np.argsort(records.toe[mine])]
    jumps = []
    for before, after in itertools.pairwise(mine):
        at = records.toe[[after]]
        if 0.0 < at[0] - records.toe[before] <= 3600.0:
            both = (records.take(np.array([k])).state(at, BEIDOU)[0] for k in (before, after))
            jumps.append(np.linalg.norm(np.subtract(*both)))
    assert np.median(jumps) == pytest.approx(oracle("beidou_handover")["median_m"][name], abs=within["jump"])


def test_unhealthy_and_old_messages_are_not_used(navigation: Navigation) -> None:
    """E14 and E18 are marked; a message of Galileo is used from its reference time on."""
    ours = next(c for c in navigation.constellations() if c.system is GALILEO)
    position = ours.state(NOON + np.arange(0.0, 3600.0, 60.0))[0]
    for name in ("E14", "E18"):
        assert np.isnan(position[:, ours.names.index(name)]).all()
    assert isinstance(ours, gps.KeplerianEphemerides)
    times = NOON + np.arange(0.0, 43000.0, 300.0)[:, None] + np.zeros(len(ours.names))
    chosen = ours.chosen(times)
    age = (times - ours.records.toe[chosen])[chosen >= 0]
    assert age.min() >= 0.0
    assert age.max() <= 14400.1


def test_what_a_source_lacks_and_marks_is_said(shared: Path) -> None:
    """A system that is named and not there; satellites that their own records mark."""
    with pytest.raises(InputError, match="`source: nominal-gps` has no satellite of galileo"):
        prepare(*read(SCENARIOS / "landing.yaml", ["sky={source: nominal-gps, systems: [gps, galileo]}"]))
    day = f"sky={{source: navigation, navigation: [{shared / BROADCAST}], systems: [galileo]}}"
    when = ("epoch=2020-06-25T12:10:00Z", "duration_s=2", "receiver.rate_hz=1")
    warnings = prepare(*read(SCENARIOS / "landing.yaml", [day, *when])).sky_warnings
    (marked,) = (text for text in warnings if "marked as unhealthy" in text)
    assert marked.startswith("satellites not used: E14")
    assert "no valid ephemeris at this time" in marked
    assert len([text for text in warnings if "not used" in text]) == 1


def test_a_landing_flies_galileo_by_the_message_it_names(shared: Path) -> None:
    """The clocks of I/NAV and of F/NAV differ by 0.13 m rms with their group delays, the orbits by less."""
    settings = (
        "sky.source=navigation", f"sky.navigation={shared / BROADCAST}", "sky.systems=[galileo]",
        "epoch=2020-06-25T12:10:00Z", "duration_s=2", "receiver.rate_hz=1",
    )  # fmt: skip
    inav, fnav = (
        prepare(*read(SCENARIOS / "landing.yaml", (*settings, *more))) for more in ((), ("sky.galileo_message=fnav",))
    )
    one, other = (case.environment.satellites[0].constellation for case in (inav, fnav))
    time = float(timescales.gps_from_utc(timescales.posix(2020, 6, 25, 12, 10))) + np.zeros(1)
    common = [name for name in one.names if name in other.names]
    a, b = (c.clock(time)[0][0, [c.names.index(name) for name in common]] for c in (one, other))
    apart = SPEED_OF_LIGHT * (a - b)
    assert 0.01 < np.sqrt(np.nanmean(apart**2)) < 0.4
    assert inav.shared.signals.used.any()


def statistics(constellation: Any, mask: float) -> tuple[np.ndarray, dict[str, list[float]]]:
    """Satellites and DOPs over a sidereal day from 1993-07-01 at 56 N 37 E, by straight lines."""
    site = np.array([np.radians(56.0), np.radians(37.0), 0.0])
    time = float(timescales.gps_from_utc(DATE_OF_SLOTS)) + np.arange(0.0, 86164.0905, 60.0)
    away = constellation.state(time)[0] - ecef_from_llh(site)
    los = np.einsum("ij,mnj->mni", enu_matrix(site), away / np.linalg.norm(away, axis=2, keepdims=True))
    los[azimuth_elevation(los)[1] < np.radians(mask)] = np.nan
    found = dops(los, np.zeros(los.shape[1], int))
    count = np.isfinite(los[..., 0]).sum(axis=1)
    out: dict[str, list[float]] = {"n": [count.mean(), count.min(), count.max()]}
    for i, name in enumerate(("GDOP", "PDOP", "HDOP", "VDOP", "TDOP")):
        x = found[:, i]
        out[name] = [x.mean(), np.median(x), np.percentile(x, 95), x.max()]
    return found, out


WALKER = gps.on_circles(
    GALILEO, np.arange(1, 25), 29599.801e3, np.radians(56.0), nominal_constellations.walker(3, 8, 15.0, (0.0, 0.0)),
    DATE_OF_SLOTS, DATE_OF_SLOTS,
)  # fmt: skip


@pytest.mark.validates("Directions of GPS's 24 slots", "GPS SPS Performance Standard (2001), Table 3-1",
                       angle="5e-3 deg")  # fmt: skip
def test_slots_of_the_standard(shared: Path, within: Within) -> None:
    """Directions from the Earth's centre by the nodes, arguments and the Greenwich hour angle of the table."""
    given = oracle("gps_24_slots")
    utc = timescales.posix(*(int(part) for part in given["epoch"][:10].split("-")))
    records = gps.nominal(utc).records
    np.testing.assert_allclose(np.degrees(records.i0), given["inclination_deg"], rtol=1e-15)
    np.testing.assert_allclose(records.sqrt_a**2, 1e3 * given["a_km"], rtol=1e-15)
    rows = np.loadtxt(shared / "data/almanacs/gps_24_slots.csv", delimiter=",", skiprows=2, usecols=(1, 2))
    node, argument = np.radians(rows - [given["greenwich_hour_angle_deg"], 0.0]).T
    sin, cos, tilt = np.sin(argument), np.cos(argument), np.radians(given["inclination_deg"])
    place = np.stack([cos * np.cos(node) - sin * np.cos(tilt) * np.sin(node),
                      cos * np.sin(node) + sin * np.cos(tilt) * np.cos(node), sin * np.sin(tilt)], axis=1)  # fmt: skip
    found = gps.nominal(utc).state(np.array([float(timescales.gps_from_utc(utc))]))[0][0]
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    apart = np.degrees(np.arccos(np.clip(np.sum(place * found, axis=1), -1.0, 1.0)))
    assert apart.max() < within["angle"]


@pytest.mark.validates("Offset of Galileo's time from GPS's", "header GAGP of a real day", offset="1e-4 m")
def test_time_offset_of_messages(navigation: Navigation, shared: Path, within: Within) -> None:
    """As the header says it, at any time of its line; a scenario takes it on request, and stores the number."""
    given = oracle("ggto")
    offset = time_offset(shared / BROADCAST, *navigation.offsets[GALILEO])
    assert (offset.a0, offset.a1) == (given["a0_s"], given["a1"])
    assert offset.reference == given["week"] * 604800.0 + given["t_ref_s"]
    assert SPEED_OF_LIGHT * offset.at(offset.reference) == pytest.approx(given["offset_m_at_ref"], abs=within["offset"])
    assert offset.at(offset.reference + 1e4) == given["a0_s"] + 1e4 * given["a1"]
    sky = f"sky={{source: navigation, navigation: [{shared / BROADCAST}], systems: [gps, galileo]}}"
    flown, document = read(SCENARIOS / "landing.yaml", [
        sky, "epoch=2020-06-25T12:00:00Z", "signals={gps_offset_ns: 1, system_offsets_ns: {galileo: broadcast}}",
        "receiver.single_clock=true",
    ])  # fmt: skip
    stored = prepare(flown, document).scenario
    now = float(timescales.gps_from_utc(flown.epoch.timestamp()))
    assert stored.signals.system_offsets_ns["galileo"] == pytest.approx(1.0 + 1e9 * offset.at(now), abs=1e-6)
    assert stored.signals.offsets()[3] == pytest.approx(-SPEED_OF_LIGHT * (1e-9 + offset.at(now)), abs=1e-6)


def test_no_time_offset(shared: Path, tmp_path: Path) -> None:
    """Of what no file says, and no file is named for; of another time, or of none."""
    with pytest.raises(InputError, match=r"system_offsets_ns\.galileo: messages contain it"):
        read(SCENARIOS / "landing.yaml", ["signals.system_offsets_ns={galileo: broadcast}"])
    text = gzip.decompress((shared / BROADCAST).read_bytes()).decode()
    (line,) = (line for line in text.splitlines() if line.startswith("GAGP"))
    for system, changed, words in (
        ("qzss", line, "no header of sky.navigation has the offset of qzss time"),
        ("galileo", line.replace("2111", "2100"), "78 days away from the epoch"),
        ("galileo", line.replace("345600 2111", "     0    0"), "has no reference time"),
    ):
        (tmp_path / "nav.rnx").write_text(text.replace(line, changed))
        flown, document = read(SCENARIOS / "landing.yaml", [
            f"sky={{source: navigation, navigation: [{tmp_path / 'nav.rnx'}], systems: [gps]}}",
            "epoch=2020-06-25T12:00:00Z", f"signals.system_offsets_ns={{{system}: broadcast}}",
        ])  # fmt: skip
        with pytest.raises(InputError, match=words):
            prepare(flown, document)


@pytest.mark.validates("DOPs of GPS's 24 slots and of a Walker 24/3/1 over a day", "independent script",
                       statistics="0.005", largest="0.02")  # fmt: skip
@pytest.mark.parametrize(
    ("key", "constellation", "mask"),
    [
        ("GPS24_mask5", gps.nominal(DATE_OF_SLOTS), 5.0), ("GPS24_mask15", gps.nominal(DATE_OF_SLOTS), 15.0),
        ("GAL_walker_24_3_1_mask5", WALKER, 5.0),
    ],
)  # fmt: skip
def test_dops_of_designs(key: str, constellation: Any, mask: float, within: Within) -> None:
    given = oracle("nominal_dop")
    found, stats = statistics(constellation, mask)
    for name, wanted in given[key].items():
        if name == "n":
            np.testing.assert_allclose(stats["n"], wanted, rtol=0.0, atol=within["statistics"])
        elif name.endswith("DOP"):
            # at a mask of 15 degrees a few minutes are nearly singular, which is in the mean, too
            some = slice(1, 3) if mask > 10.0 else slice(0, 3)
            np.testing.assert_allclose(stats[name][some], wanted[some], rtol=0.0, atol=within["statistics"])
            if mask < 10.0:
                assert stats[name][3] == pytest.approx(wanted[3], abs=within["largest"])
    if key == "GPS24_mask5":
        for epoch in given["GPS24_epochs"]:
            ours = dict(zip(("GDOP", "PDOP", "HDOP", "VDOP", "TDOP"), found[int(epoch["t_s"] / 60)], strict=True))
            for name, value in ours.items():
                assert value == pytest.approx(epoch[name], abs=within["statistics"])


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles (m, n) between places (m, 3) and (n, 3), as the Earth's centre sees them, degrees."""
    a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b))
    return np.degrees(np.arccos(np.clip(a @ b.T, -1.0, 1.0)))


@pytest.mark.validates("Slots of the design constellations of Galileo, BeiDou (MEO) and QZSS",
                       "broadcast messages of 2020-06-25", slot="4.5 deg", mean="0.5 deg")  # fmt: skip
@pytest.mark.parametrize("system", [GALILEO, BEIDOU, QZSS])
def test_designs_have_the_phase_of_the_real_satellites(system: System, navigation: Navigation, within: Within) -> None:
    ours = design(system, NOON_UTC)
    real = gps.KeplerianEphemerides(navigation.elements[system, system.message], 86400.0, system=system)
    theirs = real.state(np.array([NOON]))[0][0]
    medium = np.linalg.norm(theirs, axis=1) < 35000e3
    off_slot = set(oracle("walker_from_broadcast")["beidou_meo"]["off_slot"])
    kept = [i for i, name in enumerate(real.names) if (medium[i] or system is QZSS) and name not in off_slot]
    assert len(kept) == {GALILEO: 22, BEIDOU: 18, QZSS: 3}[system]
    angle = apart(theirs[kept], ours.state(np.array([NOON]))[0][0])
    slots = angle.argmin(axis=1)
    assert len(set(slots)) == len(kept)
    assert angle.min(axis=1).max() < within["slot"]
    offset = theirs[kept] - ours.state(np.array([NOON]))[0][0][slots]
    assert np.linalg.norm(offset.mean(axis=0)) / 29e6 < np.radians(within["mean"])


def test_beidou_stands_over_its_meridians_whatever_the_day() -> None:
    for utc in (NOON_UTC, NOON_UTC + 1000.25 * 86400.0):
        ours = design(BEIDOU, utc)
        time = float(timescales.gps_from_utc(utc)) + np.arange(0.0, 86400.0, 1800.0)
        position, velocity = ours.state(time)
        still = [ours.names.index(name) for name in ("C59", "C60", "C61")]
        longitude = np.degrees(np.arctan2(position[:, still, 1], position[:, still, 0]))
        np.testing.assert_allclose(longitude, np.broadcast_to([80.0, 110.5, 140.0], longitude.shape), atol=1e-6)
        assert np.abs(position[:, still, 2]).max() < 1.0
        assert np.abs(velocity[:, still]).max() < 1e-4
        inclined = [ours.names.index(name) for name in ("C38", "C39", "C40")]
        crossing = np.diff(np.sign(position[:, inclined, 2]), axis=0) > 0
        longitude = np.degrees(np.arctan2(position[:, inclined, 1], position[:, inclined, 0]))[:-1]
        np.testing.assert_allclose(longitude[crossing], 118.0, atol=4.0)
