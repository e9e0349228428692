"""The benchmarks start, say what they measured, and measure the same arithmetic. No time is judged."""

from __future__ import annotations

import ctypes
import importlib
import math
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers import case

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Modules of the benchmarks, which stand beside the script that runs them."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def test_they_start_and_write_a_table(tmp_path: Path) -> None:
    out = tmp_path / "r.md"
    words = [sys.executable, str(BENCHMARKS / "run.py"), "--quick", "--only", "start", "--out", str(out)]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    rows = [line for line in out.read_text().splitlines() if line.startswith("| `navsim")]
    assert len(rows) == 2
    assert all("×" in row and row.count("|") == 7 for row in rows)


def test_everything_is_on(module: Any) -> None:
    """A landing that has what the row of the world says: each part changes what is flown, and the filter follows it."""
    processes = module("processes")
    every = case(*processes.EVERYTHING)
    assert len(case(*processes.EVERYTHING, processes.MISALIGNED).states) == len(every.states) + 12 == 47
    keys = {one.partition("=")[0].partition(".")[0] for one in processes.EVERYTHING}
    given, default = (one.scenario.model_dump() for one in (every, case()))
    assert all(given[key] != default[key] for key in keys)


def test_jobs_take_turns_and_are_compared_round_by_round(module: Any) -> None:
    measure = module("measure")
    order = []

    def job(name: str, took: float) -> Any:
        def once() -> float:
            order.append(name)
            return took * len(order)

        return once

    one, two = measure.alternate(3, job("a", 2.0), job("b", 1.0))
    assert "".join(order) == "abbaab"
    assert measure.ratios(one, two) == (2 * 1 / 2, 2 * 4 / 3, 2 * 5 / 6)


def test_a_line_is_judged_by_its_median(module: Any) -> None:
    line = module("measure").Line
    assert line("", (1.0, 3.0, 9.0), "", 3.0).holds
    assert not line("", (1.0, 2.9, 9.0), "", 3.0).holds
    assert line("", (1.0, 3.0, 9.0), "", 3.0, at_most=True).holds
    assert line("x", (1.0, 3.1, 9.0), "", 3.0, at_most=True).cells()[1:5] == (
        "3.1× (1 to 9)", "at most 3×", "", "**misses**",
    )  # fmt: skip
    assert line("x", (), "no compiler", 3.0).cells()[1:] == ("-", "3×", "", "not measured", "no compiler")


def test_the_slope_of_a_power(module: Any) -> None:
    curve = module("measure").Curve("n", "", {n: [3.0 * n**1.7] * 2 for n in (4, 10, 40)}, share={4: 1, 10: 1, 40: 1})
    assert math.isclose(curve.slope(), 1.7)
    np.testing.assert_allclose(curve.against_first(40), 10**1.7)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no compiler of C")
@pytest.mark.parametrize(("width", "name"), [(1, "dense_steps"), (1, "block_steps"), (4, "block_steps")])
def test_the_step_in_c_is_that_of_the_equations(module: Any, tmp_path: Path, width: int, name: str) -> None:
    step = module("c_step")
    rng = np.random.default_rng(1)
    phi = 0.01 * rng.standard_normal((9, 15))
    phi[0:3, 9:12] = phi[6:9, 12:15] = 0.0
    p = np.diag(rng.uniform(1.0, 2.0, 15))
    gyro, accel, dt, position, velocity = setting = np.array([0.3, 0.2, 0.1, 4.0, 0.5])
    whole, h, r = np.eye(15), np.eye(6, 15), np.diag([position] * 3 + [velocity] * 3)
    whole[:9] += phi
    white = np.zeros((15, 15))
    for i in range(3):
        white[np.ix_([i, 3 + i], [i, 3 + i])] = accel * dt * np.array([[dt**2 / 4, dt / 2], [dt / 2, 1.0]])
        white[6 + i, 6 + i] = gyro * dt
    given = np.repeat(p[..., None], width, axis=2)
    for k in range(1, 8):
        p = whole @ p @ whole.T + white
        if k % 3 == 0:
            p = np.linalg.inv(np.linalg.inv(p) + h.T @ np.linalg.inv(r) @ h)
    pointer = ctypes.POINTER(ctypes.c_double)
    wide = np.repeat(phi[..., None], width, axis=2)
    getattr(step.compiled(width, tmp_path), name)(
        *(array.ctypes.data_as(pointer) for array in (given, wide, setting)), ctypes.c_long(7), ctypes.c_long(3)
    )
    for lane in range(width):
        np.testing.assert_allclose(given[..., lane], p, rtol=0.0, atol=1e-12)
