"""What a foreign clock reads at the start of the flight: by its epoch, by the first line, or as the user says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from navsim.gnss import timescales
from navsim.replays.source_clock import Kind, Start, StartError, estimate_clock, start_time

EPOCH = timescales.posix(2018, 9, 13, 12)
NOON = 43200.0
DURATION, PERIOD = 120.0, 0.1


def at(true: float) -> Any:
    """A fix from where the flight is at a time: 36 m/s, 10 m of noise."""
    return lambda t: abs(t - true) * 36.0 / 10.0


@pytest.mark.parametrize(
    ("stamp", "kind", "true", "base", "time"),
    [
        (EPOCH + 0.2, "dated", 0.2, "utc", 0.2),
        (EPOCH - 30.0, "dated", -30.0, "utc", -30.0),
        (NOON + 40.0, "undated", 40.0, "time of day", 40.0),
        (EPOCH + 7 * 86400.0 + 0.2, "dated", 0.2, "time of day", 0.2),
        (EPOCH + 0.2, "count", 0.2, "utc", 0.2),
        (37.2, "count", 37.2, "flight time", 37.2),
        (0.0, "count", 0.0, "flight time", 0.0),
        (37.2, "count", 0.1, "first line", 0.1),
        (NOON + 5.0, "count", 5.0, "time of day", 5.0),
        (5000.1, "count", 0.1, "first line", 0.1),
        (EPOCH + 18.1, "dated", 0.1, "first line", 0.1),  # a clock that is off by the leap seconds
        (EPOCH + 3 * 3600.0, "dated", 0.1, "first line", 0.1),
        (EPOCH + 18.1, "dated", -5000.0, "utc", 18.1),  # a position from nowhere tells nothing of the clock
    ],
)
def test_the_first_message_settles_the_clock(stamp: float, kind: Kind, true: float, base: str, time: float) -> None:
    found = estimate_clock(stamp, kind, EPOCH, DURATION, PERIOD, at(true))
    assert found.base == base
    assert stamp - found.offset == pytest.approx(time, abs=1e-6)


def test_midnight_lies_within_a_flight() -> None:
    late = timescales.posix(2018, 9, 13, 23, 59, 30.0)
    found = estimate_clock(10.0, "undated", late, DURATION, PERIOD, at(40.0))
    assert found.base == "time of day"
    assert 10.0 - found.offset == pytest.approx(40.0)


def test_samples_have_no_place_to_check() -> None:
    assert estimate_clock(0.02, "count", EPOCH, DURATION, 0.01, None).base == "flight time"
    found = estimate_clock(37.2, "count", EPOCH, DURATION, 0.01, None)
    assert found.base == "first line"
    assert 37.2 - found.offset == pytest.approx(0.01)


def test_doubts_are_said() -> None:
    assert (
        "2018-09-20, is not the scenario's"
        in estimate_clock(EPOCH + 7 * 86400.0, "dated", EPOCH, 120, 1, at(0.0)).doubt
    )
    assert "rolled over" in estimate_clock(EPOCH - 1024 * 7 * 86400.0, "dated", EPOCH, 120, 1, at(0.0)).doubt
    assert "at 18.100 s of the flight" in estimate_clock(EPOCH + 18.1, "dated", EPOCH, 120, 0.1, at(0.1)).doubt
    assert estimate_clock(EPOCH + 0.1, "dated", EPOCH, 120, 0.1, at(0.1)).doubt == ""
    assert estimate_clock(EPOCH + 0.1, "dated", EPOCH, 120, 0.1, at(0.1)).text == (
        "time 0 of the flight is 2018-09-13T12:00:00.000Z by the source's clock, by UTC and the scenario's epoch"
    )


def test_a_date_that_comes_later_moves_the_clock() -> None:
    undated = estimate_clock(NOON + 1.0, "undated", EPOCH, DURATION, PERIOD, at(1.0))
    day = EPOCH - NOON
    assert undated.dated(day, EPOCH).base == "utc"
    assert undated.dated(day, EPOCH).offset == EPOCH
    other = undated.dated(day + 86400.0, EPOCH)
    assert other.base == "time of day"
    assert "2018-09-14" in other.doubt


def test_the_user_has_the_last_word() -> None:
    instant = start_time("2018-09-13T11:59:50Z")
    assert instant == Start(EPOCH - 10.0, True)
    assert estimate_clock(EPOCH + 1.0, "dated", EPOCH, 120, 0.1, at(1.0), instant).offset == EPOCH - 10.0
    undated = estimate_clock(NOON + 1.0, "undated", EPOCH, 120, 0.1, at(1.0), instant)
    assert NOON + 1.0 - undated.offset == pytest.approx(11.0)
    assert estimate_clock(77.0, "count", EPOCH, 120, 0.1, at(1.0), start_time("70.5")).offset == 70.5
    first = estimate_clock(EPOCH + 1.0, "dated", EPOCH, 120, 0.1, at(1.0), start_time("first"))
    assert EPOCH + 1.0 - first.offset == pytest.approx(0.1)
    for wrong in ("noon", "nan", "inf", "2018-13-13T00:00:00Z", ""):
        with pytest.raises(StartError, match="allowed are an instant"):
            start_time(wrong)


def test_what_is_said_can_be_given_back() -> None:
    for stamp, kind in ((EPOCH + 0.1, "dated"), (5000.1, "count")):
        found = estimate_clock(stamp, kind, EPOCH, DURATION, PERIOD, at(0.1))
        given = estimate_clock(stamp, kind, EPOCH, DURATION, PERIOD, at(0.1), start_time(found.option(-0.3)))
        np.testing.assert_allclose(given.offset, found.offset - 0.3, atol=1e-3)
