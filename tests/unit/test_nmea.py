"""NMEA fixes: what is one, its velocity; dates that come late, midnight, resets, files that are two recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.formats.nmea import Assembler, read_nmea
from navsim.formats.recording import read_fixes
from navsim.formats.text import Dropped, FileError
from navsim.gnss import timescales
from tests.product.test_fuzz_readers import sentence

DAY = timescales.posix(2018, 9, 13)


def gga(clock: str, lat: str = "4807.0300000", quality: int = 1) -> str:
    return sentence(f"GPGGA,{clock},{lat},N,01131.0000000,E,{quality},08,0.9,545.400,M,46.900,M,,")


def rmc(clock: str, date: str, status: str = "A") -> str:
    return sentence(f"GPRMC,{clock},{status},4807.0300000,N,01131.0000000,E,022.4,084.4,{date},,,A")


def times(*lines: str) -> np.ndarray:
    return read_nmea(Path("log.nmea"), list(lines), Dropped())[:, 0]


def test_fixes_before_the_first_date_are_given_it() -> None:
    got = times(gga("120001.00"), gga("120002.00"), rmc("120003.00", "130918"), gga("120003.00"), gga("120004.00"))
    np.testing.assert_allclose(got, DAY + 43200.0 + np.arange(1, 5))
    # also over midnight, and from ZDA
    got = times(gga("235959.00"), gga("000000.00"), sentence("GPZDA,000000.00,14,09,2018,00,00"), gga("000001.00"))
    np.testing.assert_allclose(got, DAY + 86400.0 + np.arange(-1, 2))


def test_midnight_comes_without_a_date_of_its_own() -> None:
    """The RMC of the new day is lost, or never was."""
    got = times(gga("235959.00"), rmc("235959.00", "130918"), gga("000000.00"), gga("000001.00"))
    np.testing.assert_allclose(np.diff(got), 1.0)
    assert got[0] == DAY + 86399.0
    np.testing.assert_allclose(times(gga("235959.00"), gga("000000.00")), [86399.0, 86400.0])


def test_a_line_out_of_order_is_no_midnight() -> None:
    got = times(gga("120001.00"), gga("120003.00"), gga("120002.00"), gga("120004.00"))
    np.testing.assert_allclose(got - 43200.0, [1.0, 3.0, 2.0, 4.0])


def test_a_receivers_reset_gives_no_date() -> None:
    """RMC that is not valid, ZDA without a date or with an impossible one; no time at all."""
    got = times(
        rmc("120000.00", "060180", "V"),
        gga("120001.00"),
        gga("120001.50"),
        rmc("120001.50", "060180", "V"),
        sentence("GPZDA,120001.00,,,,,"),
        sentence("GPZDA,120001.00,31,02,2018,00,00"),
        gga("", quality=0),
        gga("120002.00"),
        rmc("120002.00", "130918"),
    )
    np.testing.assert_allclose(got, DAY + 43200.0 + np.arange(1, 3))  # not that of 120001.50, which is not valid


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (
            ("130918", "115000.00"),
            "from 2018-09-13T12:00:01.000Z to 2018-09-13T11:50:00.000Z, so the file",
        ),
        (("150918", "120002.00"), "to 2018-09-15T12:00:02.000Z, so the file"),
        (("280199", "120002.00"), "1024 weeks: the receiver's GPS week count rolled over"),
    ],
)
def test_two_recordings_in_one_file_are_refused(second: tuple[str, str], said: str) -> None:
    date, clock = second
    lines = [gga("120001.00"), rmc("120001.00", "130918"), gga(clock), rmc(clock, date)]
    with pytest.raises(FileError, match=said) as refusal:
        times(*lines)
    assert refusal.value.line == 3
    with pytest.raises(FileError, match=r"from 43201.000 s of the day to 42600.000 s of the day, so the file"):
        times(gga("120001.00"), gga("115000.00"))


def test_a_pause_is_one_recording() -> None:
    np.testing.assert_allclose(np.diff(times(gga("100000.00"), rmc("100000.00", "130918"), gga("170000.00"))), 25200.0)


def test_a_stream_learns_the_date_once() -> None:
    assembler = Assembler()
    rows = [assembler.feed(line) for line in (gga("120001.00"), gga("120002.00"))]
    assert rows[0] == []
    assert not assembler.dated
    ((first, *_),) = rows[1]
    assert first == 43201.0
    ((second, *_),) = assembler.feed(rmc("120003.00", "130918"))
    assert second == DAY + 43202.0  # the epoch just complete is of the date that came with its successor
    assert assembler.dated
    assert first + assembler.moved == DAY + 43201.0
    # both in one line
    one = Assembler()
    one.feed(gga("120001.00"))
    ((only, *_),) = one.feed(gga("120002.00").strip() + sentence("GPZDA,120002.00,13,09,2018,00,00"))
    assert only == DAY + 43201.0


def test_one_epoch_is_of_one_receiver() -> None:
    """The first fix of an epoch counts; one close by is another system's of the same receiver, one far off is not."""
    assembler = Assembler()
    for line in (gga("120001.00"), gga("120001.00", "4807.0301000"), gga("120001.00", "4907.0300000")):
        assert assembler.feed(line) == []
    row = assembler.flush()
    assert row is not None
    assert row[1] == pytest.approx(48.0 + 7.03 / 60.0)
    assert assembler.contradicting == 1


def test_underscores_are_no_part_of_a_number() -> None:
    """They are of other sentences' texts."""
    assembler = Assembler()
    assembler.feed(sentence("GPGGA,120001.00,4807.0300000,N,01131.0000000,E,1,08,0.9,54_5.400,M,46.900,M,,"))
    assert assembler.corrupt == 1
    assembler.feed(sentence("GPTXT,01,01,02,u_blox"))
    assert (assembler.corrupt, assembler.other) == (1, 1)


# --- which epochs have a fix, and which velocity

WHERE = "4807.0300000,N,01131.0000000,E"


def epoch(quality: int | str = 1, *others: str) -> list[str]:
    """GGA of one epoch and other sentences of it, as `RMC,A,A`: kind, status, mode letter."""
    return [gga("120001.00", quality=quality), *(one(*other.split(",")) for other in others)]


def one(kind: str, status: str = "A", mode: str = "A", speed: str = "22.4", course: str = "84.4") -> str:
    kmh = f"{1.852 * float(speed):.3f}" if speed else ""
    return sentence(
        {
            "RMC": f"GNRMC,120001.00,{status},{WHERE},{speed},{course},130918,,,{mode}",
            "GLL": f"GNGLL,{WHERE},120001.00,{status},{mode}",
            "VTG": f"GNVTG,{course},T,,M,{speed},N,{kmh},K,{mode}",
            "GNS": f"GNGNS,120001.00,{WHERE},{mode},09,0.9,545.400,46.900,,",
        }[kind]
    )


def assembled(*lines: str, **how: bool) -> tuple[list[np.ndarray], Assembler]:
    assembler = Assembler(**how)
    rows = [row for line in lines for row in assembler.feed(line)]
    last = assembler.flush()
    return rows + ([] if last is None else [last]), assembler


@pytest.mark.parametrize("quality", range(1, 6))
@pytest.mark.parametrize("mode", ["A", "D", "F", "P", "R", ""])
def test_what_is_a_fix(quality: int, mode: str) -> None:
    rows, _ = assembled(*epoch(quality, f"RMC,A,{mode}", f"GLL,A,{mode}", f"VTG,A,{mode}"))
    assert len(rows) == 1


def test_quality_9_is_a_fix() -> None:
    assert len(assembled(gga("120001.00", quality=9))[0]) == 1


@pytest.mark.parametrize(
    ("lines", "counted"),
    [
        (epoch(6), "estimated"),
        (epoch(7), "manual"),
        (epoch(8), "simulated"),
        (epoch(0, "RMC,V,N"), "empty"),
        (epoch(10), "empty"),
        (epoch(1, "RMC,A,E"), "estimated"),
        (epoch(1, "RMC,V,E"), "estimated"),
        (epoch(1, "RMC,A,M"), "manual"),
        (epoch(1, "RMC,A,S"), "simulated"),
        (epoch(1, "RMC,A,N"), "empty"),
        (epoch(1, "RMC,V,"), "empty"),
        (epoch(1, "RMC,V,A"), "empty"),
        (epoch(1, "VTG,A,E"), "estimated"),
        (epoch(1, "GLL,A,E"), "estimated"),
        (epoch(1, "GLL,V,N"), "empty"),
        ([one("GNS", mode="N")], "empty"),
        ([one("GNS", mode="EE")], "estimated"),
        ([one("GNS", mode="NNEN")], "estimated"),
        ([one("GNS", mode="S")], "simulated"),
        ([one("GNS", mode="M")], "manual"),
        ([one("RMC", mode="E"), gga("120001.00")], "estimated"),
        ([one("RMC"), one("GLL")], "no_height"),
    ],
)
def test_what_is_none_is_counted_by_kind(lines: list[str], counted: str) -> None:
    rows, assembler = assembled(*lines)
    assert rows == []
    kinds = ("estimated", "manual", "simulated", "empty", "no_height", "corrupt")
    assert {name: getattr(assembler, name) for name in kinds} == {**dict.fromkeys(kinds, 0), counted: 1}


def test_a_simulators_fixes_are_taken_when_asked_for() -> None:
    assert len(assembled(*epoch(8, "RMC,A,S"), simulated=True)[0]) == 1
    assert assembled(*epoch(6, "RMC,A,S"), simulated=True)[0] == []


@pytest.mark.parametrize("mode", ["AN", "NA", "EA", "NNDN", "RR", "AAAA", "FN"])
def test_one_system_of_gns_is_enough(mode: str) -> None:
    rows, _ = assembled(one("GNS", mode=mode))
    ((time, lat, lon, height, *velocity, satellites),) = rows
    assert (time, height, satellites) == (43201.0, 592.3, 9.0)
    np.testing.assert_allclose((lat, lon), (48.0 + 7.03 / 60.0, 11.0 + 31.0 / 60.0))
    assert np.isnan(velocity).all()


def test_a_height_of_gns_where_gga_has_none() -> None:
    bare = sentence(f"GPGGA,120001.00,{WHERE},1,08,0.9,,M,,M,,")
    (row,), _ = assembled(bare, one("GNS"))
    assert row[3] == 592.3


@pytest.mark.parametrize(
    ("lines", "speed"),
    [
        ([one("RMC")], 22.4),
        ([one("RMC", course="")], None),
        ([one("RMC", course=""), one("VTG")], 22.4),
        ([one("RMC", speed=""), one("VTG")], 22.4),
        ([one("RMC", course=""), one("VTG", course="")], None),
        ([one("RMC", speed="", course="")], None),
        ([one("RMC", speed="0.000", course="")], 0.0),
        ([one("RMC", speed="0.15", course="")], 0.0),
        ([one("RMC", speed="0.25", course="")], None),
        ([one("VTG", mode="N")], None),
        ([sentence("GPVTG,,T,84.4,M,22.4,N,41.5,K,A")], None),  # a magnetic course alone
        ([sentence("GPVTG,84.4,T,,M,22.4,N,,K,A")], 22.4),  # in knots alone
        ([sentence("GPVTG,84.4,83.1,22.4,41.5")], None),  # of an old version
    ],
)
def test_a_velocity_needs_speed_and_course(lines: list[str], speed: float | None) -> None:
    (row,), assembler = assembled(gga("120001.00"), *lines)
    assert not assembler.corrupt
    course = np.radians(84.4)
    due = np.full(2, np.nan) if speed is None else speed * 1852.0 / 3600.0 * np.array([np.cos(course), np.sin(course)])
    np.testing.assert_allclose(row[4:6], due, atol=1e-3)


def test_sentences_in_any_order_and_of_several_rates() -> None:
    def at(time: str, *kinds: str) -> list[str]:
        every = {"GGA": gga("120001.00"), **{kind: one(kind) for kind in ("RMC", "GLL", "GNS", "VTG")}}
        return [sentence(every[kind][1:].split("*")[0].replace("120001.00", time)) for kind in kinds]

    plain, _ = assembled(*at("120001.00", "GGA", "RMC"), *at("120002.00", "GGA", "RMC"))
    for order in (("RMC", "VTG", "GGA", "GLL"), ("GLL", "GNS", "GGA", "VTG", "RMC"), ("GGA", "GLL", "RMC")):
        mixed, assembler = assembled(*at("120001.00", *order), *at("120002.00", *order))
        np.testing.assert_array_equal(mixed, plain)
        assert not assembler.contradicting
    rows, _ = assembled(*at("120001.00", "GGA", "RMC"), *at("120001.20", "GGA"), *at("120001.40", "GGA"),
                        *at("120002", "RMC", "GGA"))  # fmt: skip
    np.testing.assert_array_equal(np.isfinite([row[4] for row in rows]), [True, False, False, True])


@pytest.mark.parametrize("talker", ["GP", "GN", "GL", "GA", "GB", "BD", "GQ", "QZ", "GI", "IN", "II"])
def test_any_talker_gives_fixes(talker: str) -> None:
    lines = [gga("120001.00"), one("RMC")]
    rows, _ = assembled(*(sentence(talker + line[3:].split("*")[0]) for line in lines))
    assert len(rows) == 1
    assert np.isfinite(rows[0][4])


OTHERS = [
    "PUBX,00,120001.00,4807.0300000,N,01131.0000000,E,592.300,G3,2.1,2.0,40.700,84.40,0.007,,0.92,1.19,0.77,9,0,0",
    "PUBX,04,120001.00,130918,388800.00,2018,18,-1930035,-2660.664,43,", "PGRME,15.0,M,45.0,M,25.0,M",
    "PMTK001,604,3", "PSTI,030", "PASHR,120001.00,84.40,T,-0.31,+0.01,-0.03,0.021,0.021,0.012,2,3",
    "PTNL,PJK,120001.00,130918,+805083.350,N,+388997.346,E,10,09,1.5,GHT+25.478,M",
    "GPGSA,A,3,04,05,,09,12,,,24,,,,,2.5,1.3,2.1",
    "GNXYZ,1,2", "GPTXT,01,01,02,u_blox ag - www.u-blox.com", "HEHDT,84.4,T", "PUBX",
]  # fmt: skip


@pytest.mark.parametrize("body", OTHERS)
def test_sentences_of_other_kinds_are_not_corrupt(body: str) -> None:
    _, assembler = assembled(sentence(body))
    assert (assembler.corrupt, assembler.other) == (0, 1)


def test_encapsulated_sentences_are_not_corrupt() -> None:
    """Messages of ships begin with another sign; what only begins so is no sentence."""
    _, assembler = assembled("!AIVDM,1,1,,A,13u?etPv2;0n:dDPwUM1U1Cb069D,0*23", "!!?")
    assert (assembler.other, assembler.foreign) == (1, 1)


def test_a_short_sentence_with_its_checksum_is_no_crash() -> None:
    for body in (
        "GPGGA,120001.00,4807.03,N",
        "GPRMC,120001.00",
        "GPGNS",
        "GPVTG,1",
        "GPZDA,120001.00",
        "GPGLL,4807.03,N",
    ):
        rows, _ = assembled(gga("120000.00"), sentence(body))
        assert len(rows) == 1


def bare(line: str) -> str:
    return line.split("*")[0]


def test_the_checksum_is_optional(tmp_path: Path) -> None:
    """Sentences without one are read when lenient; one that is cut off is not."""
    fixes = [(f"12000{k}.00", f"4807.03{k}0000") for k in range(1, 9)]
    lines = [line for time, lat in fixes for line in (gga(time, lat), rmc(time, "130918"))]
    kinds = [f"{bare(line)}{end}" for line, end in zip(lines, ["", "\r", " "] * 6, strict=False)]
    rows, assembler = assembled(*kinds, bare(sentence(OTHERS[7])), "$PUBX,40,GGA,0,0", lenient=True)
    np.testing.assert_array_equal(rows, assembled(*lines)[0])
    assert (assembler.no_checksum, assembler.corrupt, assembler.other) == (0, 0, 2)
    rows, assembler = assembled(*kinds)
    assert rows == []
    assert (assembler.no_checksum, assembler.corrupt) == (16, 0)
    for cut in (
        "$GPGGA,120001.00,4807.0",
        bare(lines[0]).rsplit(",", 2)[0],
        "$GPRMC,120001.00,A,4807.03,N",
        lines[0].strip()[:-1],
    ):
        rows, assembler = assembled(cut, lenient=True)
        assert rows == []
        assert assembler.corrupt == 1
    (tmp_path / "log").write_text("\n".join(kinds))
    with pytest.raises(
        FileError, match=r"16 NMEA sentences without a checksum .*optional.*write `skip_bad_records: true` in the log"
    ):
        read_fixes(tmp_path / "log")
    assert read_fixes(tmp_path / "log", lenient=True)[0].time.size == 8


CASES = {
    "nmea-dead-reckoning/log.nmea": ({}, 10, "estimated"),
    "nmea-simulator-q8/log.nmea": ({"simulated": True}, 20, ""),
    "nmea-gns-only/log.nmea": ({}, 20, ""),
    "nmea-no-checksum/log.nmea": ({"lenient": True}, 20, ""),
    "nmea-replay-ok/gnss.nmea": ({}, 240, ""),
    "nmea-replay-dead-reckoned/gnss.nmea": ({}, 190, "estimated"),
    "nmea-replay-course-empty-some/gnss.nmea": ({}, 240, ""),
}


def test_the_cases_from_outside(shared: Path) -> None:
    for name, (how, count, left_out) in CASES.items():
        lines = (shared / "cases" / name).read_text().splitlines()
        rows, assembler = assembled(*lines, **how)
        assert len(rows) == count, name
        assert not assembler.corrupt
        assert not left_out or getattr(assembler, left_out), name
        if "course-empty" in name:
            assert sum(np.isnan(row[4]) for row in rows) == 20
