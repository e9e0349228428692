"""The watch of a search: counts, the best so far, estimates of time, the limit; and the line that shows it."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from navsim.cli import common
from navsim.optimization.job import progress_text
from navsim.optimization.progress import SearchMonitor, SearchProgress, ShareUp, Step, TimeUp
from navsim.replays.job import ReplayJob


class Clock:
    """Seconds that pass when they are told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_time_left_is_what_is_planned_at_its_measured_cost() -> None:
    clock, told = Clock(), list[SearchProgress]()
    watch = SearchMonitor(told.append, clock=clock)
    watch.plan([Step("one", {"cheap": 100}), Step("two", {"dear": 10}), Step("three", {"dear": 5})])
    with watch.step("one"), watch.trying("cheap", 50):
        clock.now += 1.0
    assert told[-1].remaining is None, "nobody knows yet what dear ones cost"
    with watch.step("two"):
        for _ in range(4):
            with watch.trying("dear", 1):
                clock.now += 2.0
        # 6 of its own and 5 of the next; the 50 that step one did not need are not counted
        assert told[-1].remaining == pytest.approx(22.0)
    assert told[-1].tried == {"cheap": 50, "dear": 4}
    assert told[-1].used == pytest.approx(9.0)


def test_limit_ends_the_work() -> None:
    clock = Clock()
    watch = SearchMonitor(time_limit=3.0, clock=clock)
    with watch.trying("any", 1):
        clock.now += 2.0
    with pytest.raises(TimeUp), watch.trying("any", 1):
        clock.now += 2.0
    assert watch.tried == {"any": 2}


def test_numbers_share_the_limit() -> None:
    """Of ten seconds the first of two takes half, and has a placement then; the last takes all that is left."""
    clock = Clock()
    watch, begun = SearchMonitor(time_limit=10.0, clock=clock), clock.now
    for parts, after, end in ((2, 7.0, ShareUp), (1, 10.0, TimeUp)):
        watch.allot(parts)
        clock.now = begun + after
        watch.look() if parts > 1 else None
        watch.offer(np.zeros((1, 2)), 1.0)
        with pytest.raises(end):
            watch.look()


def test_the_best_is_of_the_number_and_of_the_judge_in_work() -> None:
    watch, a, b, c = SearchMonitor(), *(np.full((1, 2), x) for x in (1.0, 2.0, 3.0))
    watch.offer(a, 5.0)
    watch.offer(b, 6.0)
    assert watch.best == 5.0
    watch.judge_anew()
    assert watch.best == 5.0, "kept until the stricter judge has spoken"
    watch.offer(c, 5.5)
    watch.offer(b, 5.6)
    assert (watch.best, watch.places) == (5.5, c)
    watch.begin()
    assert watch.best is None


def progress(used: float, best: float | None) -> SearchProgress:
    places = None if best is None else np.array([[-42.0, 518.0], [100.0, 7.0]])
    return SearchProgress("2 pseudolites, searching", {"geometry": 900, "coarse": 30}, best, places, used, 41.6)


def test_a_line_every_ten_seconds_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    began = clock.now
    with common.progress(0, "placements", True, clock) as tell:
        for used in np.arange(0.0, 31.0, 0.5):
            clock.now = began + used
            tell(0, progress_text(progress(float(used), None if used < 15 else 0.15619), "m"))
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 3
    assert lines[0] == (
        "2 pseudolites, searching: 930 placements tried, 30 by covariance analysis; none found yet; 10 s used, "
        "at most 42 s of search left"
    )
    assert "best 0.1562 m at s, l1 (-42, 518), (100, 7) m; 20 s used" in lines[1]


def test_quiet_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with common.progress(0, "placements", False) as tell:
        tell(0, progress_text(progress(100.0, 0.1), "m"))
    assert capsys.readouterr().err == ""


def test_a_live_line_on_a_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "200")
    with common.progress(0, "placements", True) as tell:
        tell(0, progress_text(progress(1.0, 2.5), "1"))
        import time

        time.sleep(0.3)  # the line is drawn some ten times a second
    err = capsys.readouterr().err
    assert "2 pseudolites, searching" in err
    assert "best 2.5 at s, l1" in err


@pytest.mark.parametrize(("free", "extent"), [(0, 1), (2, 0)])
def test_a_tuning_has_no_known_end(free: int, extent: int) -> None:
    """It ends where it has converged: a remaining time by its most flights was "about 10 h" for half a minute."""
    job = object.__new__(ReplayJob)
    job.recording = cast("Any", SimpleNamespace(free=np.arange(free)))
    assert job.extent == extent
