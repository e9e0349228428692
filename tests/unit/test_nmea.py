"""Times of NMEA fixes: dates that come late, midnight, receivers' resets, and files that are two recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.io.nmea import Assembler, read_nmea
from navsim.io.text import Dropped, FileError
from navsim.models import timescales
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
        rmc("120001.00", "060180", "V"),
        sentence("GPZDA,120001.00,,,,,"),
        sentence("GPZDA,120001.00,31,02,2018,00,00"),
        gga("", quality=0),
        gga("120002.00"),
        rmc("120002.00", "130918"),
    )
    np.testing.assert_allclose(got, DAY + 43200.0 + np.arange(1, 3))


@pytest.mark.parametrize(
    ("second", "said"),
    [
        (("130918", "115000.00"), "from 2018-09-13T12:00:01.000Z to 2018-09-13T11:50:00.000Z, two recordings"),
        (("150918", "120002.00"), "to 2018-09-15T12:00:02.000Z, two recordings in one file"),
        (("280199", "120002.00"), "1024 weeks: the receiver's count of GPS weeks rolled over"),
    ],
)
def test_two_recordings_in_one_file_are_refused(second: tuple[str, str], said: str) -> None:
    date, clock = second
    lines = [gga("120001.00"), rmc("120001.00", "130918"), gga(clock), rmc(clock, date)]
    with pytest.raises(FileError, match=said) as refusal:
        times(*lines)
    assert refusal.value.line == 3
    with pytest.raises(FileError, match=r"from 43201.000 s of the day to 42600.000 s of the day, two"):
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
