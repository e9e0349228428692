"""Studies carry the checksums of every file they read: in the stored scenario, and in the key of partial work."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from navsim.optimization import problem as objective
from navsim.optimization import study as optimize
from navsim.optimization.result import optimize_result
from navsim.optimization.scenario import Optimize
from navsim.runner.checkpoint import CheckpointError
from navsim.runner.executor import threads
from navsim.scenario.load import read_study
from navsim.scenario_files.source import InputError
from navsim.sweeps.plan import plan
from navsim.sweeps.scenario import Sweep
from navsim.sweeps.study import SweepStudy, compute, partial_key, sweep_result
from tests.helpers import SCENARIOS

GPS = """******** Week 911 almanac for PRN-{prn:02d} ********
ID:                         {prn:02d}
Health:                     000
Eccentricity:               0.5E-002
Time of Applicability(s):  405504.0000
Orbital Inclination(rad):   0.96
Rate of Right Ascen(r/s):  -0.8E-008
SQRT(A)  (m 1/2):           5153.6
Right Ascen at Week(rad):   {node:.6E}
Argument of Perigee(rad):   0.5
Mean Anom(rad):             {anomaly:.6E}
Af0(s):                     0.0
Af1(s/s):                   0.0
week:                        911
"""
"""A YUMA almanac of our own making."""


def almanac(path: Path, shift: float = 0.0) -> str:
    """Write 24 satellites; returns the checksum."""
    blocks = [
        GPS.format(prn=i + 1, node=-3.0 + (i % 6) * 1.0472, anomaly=(i // 6) * 1.5708 + 0.2 * (i % 6) - 3.0 + shift)
        for i in range(24)
    ]
    path.write_text("\n".join(blocks))
    return hashlib.sha256(path.read_bytes()).hexdigest()


def sweep_of(folder: Path, vary: str = "", method: str = "dop") -> Path:
    path = folder / "study.yaml"
    path.write_text(
        f"kind: sweep\nversion: 1\nbase: {SCENARIOS}/landing.yaml\nmethod: {method}\nset:\n"
        "  sky.source: almanac\n  epoch: 2017-01-26T12:00:00Z\n  receiver.rate_hz: 1\n  duration_s: 61\n"
        "  pseudolites.count: 1\n  pseudolites.frame: runway\n  pseudolites.l1_m: 1000\n  pseudolites.clock: gps\n"
        + ("" if vary else "  sky.almanac: a.alm\n")
        + f"vary:\n- {{key: pseudolites.s_m, values: [200, 400]}}\n{vary}"
    )
    return path


@pytest.mark.parametrize("vary", ["", "- {key: sky.almanac, values: [a.alm, b.alm]}\n"], ids=["base", "varied"])
def test_a_sweep_is_resumed_with_the_same_files_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, vary: str
) -> None:
    """The key of partial work changes with the content of any file that any combination reads."""
    sums = {"a.alm": almanac(tmp_path / "a.alm"), "b.alm": almanac(tmp_path / "b.alm", 0.5)}
    monkeypatch.chdir(tmp_path)
    path = sweep_of(tmp_path, vary)
    planned = plan(*read_study(path, Sweep, []), 1)
    key = partial_key(planned)
    assert key["files"] == (sums if vary else {"a.alm": sums["a.alm"]})
    result = sweep_result(planned, compute(planned, threads(1)))
    assert sums["a.alm"] in str(result.attributes["scenario"])
    assert json.loads(result.attributes["files"]) == key["files"]
    last = "b.alm" if vary else "a.alm"
    almanac(tmp_path / last, 0.7)
    again = partial_key(plan(*read_study(path, Sweep, []), 1))
    assert again != key
    # a file that changes while the study runs is noticed, too
    if vary:
        with pytest.raises(CheckpointError, match=r"b\.alm was changed while the study ran"):
            SweepStudy(planned).batch(0, 4)


def test_an_unusable_file_of_one_combination_is_part_of_the_key(tmp_path: Path) -> None:
    almanac(tmp_path / "a.alm")
    path = sweep_of(tmp_path, "- {key: sky.almanac, values: [a.alm, b.alm]}\n")
    first = partial_key(plan(*read_study(path, Sweep, []), 1))
    almanac(tmp_path / "b.alm")
    assert partial_key(plan(*read_study(path, Sweep, []), 1)) != first


def test_files_that_serve_only_some_combinations(tmp_path: Path) -> None:
    """A file that is of no use at the first epoch has its checksum all the same; its combinations are nan there."""
    sums = {"a.alm": almanac(tmp_path / "a.alm")}
    (tmp_path / "b.alm").write_text("nothing of use")
    sums["b.alm"] = hashlib.sha256(b"nothing of use").hexdigest()
    path = sweep_of(tmp_path, "- {key: sky.almanac, values: [a.alm, b.alm]}\n")
    planned = plan(*read_study(path, Sweep, []), 1)
    assert planned.files == sums
    rows, _, _ = SweepStudy(planned).batch(0, 4)
    assert list(np.isfinite(rows["pdop"])) == [True, False, True, False]


def test_the_keep_out_file_is_pinned(tmp_path: Path) -> None:
    """Its checksum stands in the stored study; given, another file is refused with both named."""
    keep_out = {"type": "Polygon", "coordinates": [[[37.5, 56.1], [37.6, 56.1], [37.6, 56.2], [37.5, 56.1]]]}
    (tmp_path / "keep.json").write_text(json.dumps(keep_out))
    checksum = hashlib.sha256((tmp_path / "keep.json").read_bytes()).hexdigest()
    text = (
        f"kind: optimize\nversion: 1\nbase: {SCENARIOS}/landing.yaml\nset: {{receiver.rate_hz: 0.5}}\nobjective: pdop\n"
        "pseudolites: [1]\nsites: [{s_m: 300, l1_m: 1000}, {s_m: -300, l1_m: 2000}]\nconstraints:\n"
        "  keep_out: keep.json\n"
    )
    path = tmp_path / "study.yaml"
    path.write_text(text)
    here = objective.problem(*read_study(path, Optimize, []))
    stored = optimize_result(here, optimize.solve(here, 1), 1).attributes["study"]
    assert f"keep_out_sha256: {checksum}" in str(stored)
    path.write_text(text + f"  keep_out_sha256: {'f' * 64}\n")
    with pytest.raises(InputError, match=f"keep.json has the checksum {checksum}, not this one"):
        objective.problem(*read_study(path, Optimize, []))
    path.write_text(text + f"  keep_out_sha256: {checksum}\n")
    objective.problem(*read_study(path, Optimize, []))
