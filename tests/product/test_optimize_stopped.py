"""`navsim optimize` stopped by its time limit or by Ctrl-C: what was found is kept, what is left is said."""

from __future__ import annotations

import functools
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from navsim.__main__ import main
from navsim.cli import common
from navsim.optimization import job
from navsim.optimization import problem as posing
from navsim.optimization import progress as watch
from navsim.optimization.report import front, plan
from navsim.results.result import read
from navsim.runner.executor import threads
from tests.conftest import SCENARIOS
from tests.layout import as_declared


class Clock:
    """A second passes each time it is looked at; `act` is called at one of the looks."""

    def __init__(self, act: Callable[[], None] = lambda: None, at: int = -1) -> None:
        self.now, self._act, self._at = 0, act, at

    def __call__(self) -> float:
        self.now += 1
        if self.now == self._at:
            self._act()
        return float(self.now)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    file = tmp_path / "study.yaml"
    file.write_text(
        f"kind: optimize\nversion: 1\nbase: {SCENARIOS / 'landing_gnss_only.yaml'}\n"
        "set: {duration_s: 61, receiver.rate_hz: 1, imu.rate_hz: 10}\npseudolites: [1, 2]\nobjective: vertical\n"
        "effort: 1\narea: {s_m: [100, 900], l1_m: [-400, 1200]}\n"
    )
    return file


def optimize(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], clock: Clock, study: Path, *more: str
) -> tuple[int, str, str]:
    """The command in this process, by a clock of its own: exit code, standard output, standard error."""
    monkeypatch.setattr(common, "SAY_EVERY_S", 0.0)
    monkeypatch.setattr(job, "SearchMonitor", functools.partial(watch.SearchMonitor, clock=clock))
    monkeypatch.setattr(sys, "argv", ["navsim", "optimize", str(study), "-o", str(study.with_suffix(".h5")), *more])
    with pytest.raises(SystemExit) as left:
        main()
    out = capsys.readouterr()
    return int(left.value.code or 0), out.out, out.err


def test_time_limit_keeps_the_best(
    study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = optimize(monkeypatch, capsys, Clock(), study, "--time-limit", "420", "--json")
    assert code == 0
    assert "stopped early: time limit of 420 s" in err
    assert "undone: the search for 1, 2 pseudolite(s); the neighbourhood for 1, 2 pseudolite(s)" in err
    assert "at most" in err
    assert "by covariance analysis" in err
    result = read(study.with_suffix(".h5"))
    as_declared(result)
    assert result.attributes["stopped"] == "time limit"
    assert list(result["/pseudolites"]) == [1]
    assert list(result["/pareto/finished"]) == [0]
    assert list(result["/optimum/explored"]) == list(result["/map/computed"]) == [0]
    assert np.all(np.isnan(result["/map/objective"]))
    data = json.loads(out)
    assert data["stopped"] == "time limit"
    assert not data["placements"][0]["finished"]
    # the value is that of the full analysis, and better than nothing
    assert data["placements"][0]["value"] < data["without_pseudolites"]
    assert (study.parent / "study_plan.png").exists()
    words = [text.get_text() for one in (plan(result), front(result)) for text in one.findobj(Text)]
    assert {"maps not computed (stopped: time limit)", "area of the search", "search stopped"} <= set(words)


def test_time_limit_after_the_search_says_what_is_left(
    study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study.write_text(study.read_text().replace("[1, 2]", "[1]").replace("objective: vertical", "objective: vdop"))
    whole, flown = Clock(), list[int | None]()
    monkeypatch.setattr(posing, "threads", lambda workers: flown.append(workers) or threads(workers))
    code, out, _ = optimize(monkeypatch, capsys, whole, study, "--figures", "none", "--workers", "1")
    assert code == 0
    assert set(flown) == {1}, "runs of the best placement by other threads"
    assert "(stopped)" not in out
    limit = ("--time-limit", str(whole.now - 4), "--figures", "none")
    code, out, err = optimize(monkeypatch, capsys, Clock(), study, *limit)
    assert code == 0
    assert "undone: the map for 1 pseudolite(s)" in err
    assert "(stopped)" not in out
    assert "not computed" not in out, "the neighbourhood was"


def test_no_time_for_anything(study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = optimize(monkeypatch, capsys, Clock(), study, "--time-limit", "2")
    assert code == 3
    assert "time limit passed during 'preparing', before" in err
    assert "of it" not in err
    code, _, err = optimize(monkeypatch, capsys, Clock(), study, "--time-limit", "24")
    assert code == 3
    assert "screening by geometry', before navsim" in err
    assert "; preparing took 10 s of it; give a longer one" in err
    assert not study.with_suffix(".h5").exists()


def test_interrupt_keeps_the_best(
    study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ctrl_c() -> None:
        raise KeyboardInterrupt

    code, out, err = optimize(monkeypatch, capsys, Clock(ctrl_c, 420), study, "--figures", "none")
    assert code == 130
    assert "stopped early: interrupted" in err
    assert "(stopped)" in out
    assert "not computed" in out
    result = read(study.with_suffix(".h5"))
    as_declared(result)
    assert result.attributes["stopped"] == "interrupted"
    assert np.all(np.isfinite(result["/pareto/objective"]))


def test_interrupt_before_anything_is_found(
    study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def ctrl_c() -> None:
        raise KeyboardInterrupt

    code, _, err = optimize(monkeypatch, capsys, Clock(ctrl_c, 1), study)
    assert code == 130
    assert "stopped early" not in err
    assert list(study.parent.iterdir()) == [study], "an empty folder of partial work is removed"


def test_objective_the_flight_never_comes_to(
    study: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    study.write_text(study.read_text().replace("duration_s: 61", "duration_s: 20").replace("vertical", "vertical_50ft"))
    code, _, err = optimize(monkeypatch, capsys, Clock(), study)
    assert code == 2
    assert "study.yaml:6" in err
    assert "'vertical_50ft' has no value" in err
