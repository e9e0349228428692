"""Recordings of which little is left: short files, filtered rows, spans that hold nothing. Each ends in words."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from navsim.cli.main import app
from navsim.io.recording import read_fixes, read_imu
from navsim.study.diagnosis import Log, diagnose
from tests.conftest import SCENARIOS

SHIPPED = SCENARIOS / "recorded_flight.yaml"


def replayed(folder: Path, *assignments: str) -> tuple[int, str]:
    """Exit code of a dry run of the shipped flight with keys set, and what it said."""
    keys = [word for assignment in assignments for word in ("--set", assignment)]
    run = CliRunner().invoke(app, ["replay", str(SHIPPED), "--dry-run", "-o", str(folder / "out.h5"), *keys])
    assert run.exception is None or isinstance(run.exception, SystemExit), run.exception
    return run.exit_code, run.output


@pytest.mark.parametrize("last", [2.0, 5.0, 12.0, 16.3, 30.7, 30.9, 31.2, 45.0, 46.5])
def test_a_flight_of_any_length_is_judged(last: float) -> None:
    """With two windows no clock offset outside of those tolerated can be judged."""
    samples = read_imu(SCENARIOS / "data" / "flight_imu.csv.gz")[0]
    fixes = read_fixes(SCENARIOS / "data" / "flight_gnss.csv")[0]
    log = Log(samples.between(-np.inf, last), fixes.take(fixes.time <= last))
    assert diagnose(log) == []
