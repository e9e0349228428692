"""Sweeps of protection levels and of what is counted of watched fixes: the numbers of single runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from navsim.io.results import Result, read
from tests.helpers import SCENARIOS
from tests.layout import as_declared
from tests.product.test_run import navsim

WATCHED = {
    "integrity": {"method": "chi2", "p_fa": 1e-2, "limits": {"hal_m": 60, "val_m": 90, "tta_s": 1}},
    "duration_s": 62,
    "receiver.rate_hz": 2,
    "filter.kind": "eskf",
}


def study(folder: Path, text: str, settings: dict[str, object] = WATCHED) -> Path:
    path = folder / "study.yaml"
    base = SCENARIOS / "landing.yaml"
    vary = "vary: [{key: pseudolites.count, values: [0, 2]}]"
    path.write_text(f"kind: sweep\nversion: 1\nbase: {base}\nset: {json.dumps(settings)}\n{vary}\n{text}")
    return path


def single(folder: Path, count: int, *options: object) -> Result:
    keys = [part for key, value in WATCHED.items() for part in ("--set", f"{key}={json.dumps(value)}")]
    navsim(
        "run", SCENARIOS / "landing.yaml", *keys, "--set", f"pseudolites.count={count}", *options,
        "--figures", "none", "-q", "-o", f"one{count}.h5", "--force", cwd=folder,
    )  # fmt: skip
    return read(folder / f"one{count}.h5")


def test_levels_are_those_of_single_landings(tmp_path: Path) -> None:
    """By geometry alone, by number of pseudolites."""
    path = study(tmp_path, "outputs: [pdop, hpl_p95, vpl_max, level_share]")
    navsim("sweep", path, "--figures", "none", "-q", "-o", "s.h5", cwd=tmp_path)
    swept = read(tmp_path / "s.h5")
    as_declared(swept)
    for i, count in enumerate((0, 2)):
        one = single(tmp_path, count, "--method", "covariance")
        assert swept["/sweep/hpl_p95"][i] == one["/summary/integrity/hpl"][4]
        assert swept["/sweep/vpl_max"][i] == one["/summary/integrity/vpl"][2]
    assert swept["/sweep/hpl_p95"][1] < swept["/sweep/hpl_p95"][0]
    np.testing.assert_array_equal(swept["/sweep/level_share"], 1.0)


def test_counts_are_those_of_single_ensembles(tmp_path: Path) -> None:
    path = study(
        tmp_path, "method: monte-carlo\nruns: 8\noutputs: [availability, approaches, continuity_risk, hmi, vpl_p95]"
    )
    navsim("sweep", path, "--figures", "none", "-q", "-o", "s.h5", cwd=tmp_path)
    swept = read(tmp_path / "s.h5")
    as_declared(swept)
    one = single(tmp_path, 2, "--runs", 8, "--keep", "none")
    for name in ("availability", "approaches", "continuity_risk", "hmi"):
        found = [swept[f"/sweep/{name}{end}"][1] for end in ("", "_low", "_high")]
        np.testing.assert_array_equal(found, one[f"/summary/integrity/{name}"])


@pytest.mark.parametrize(
    ("text", "settings", "says"),
    [
        ("outputs: [hpl_p95]", {}, "the output hpl_p95 needs `integrity`"),
        ("method: monte-carlo\noutputs: [hmi]", {"integrity": {}}, "the output hmi needs `integrity.limits`"),
        ("outputs: [hmi]", WATCHED, "'hmi' is of runs: it needs method monte-carlo"),
    ],
)
def test_outputs_of_what_nobody_watches(tmp_path: Path, text: str, settings: dict[str, object], says: str) -> None:
    done = navsim("sweep", study(tmp_path, text, settings), "-o", "s.h5", cwd=tmp_path, code=2)
    assert says in done.stderr


def test_an_optimum_of_a_watched_landing_is_that_of_an_unwatched_one(tmp_path: Path) -> None:
    """Placements have pseudolites of their own, which are watched as well."""
    places = []
    for settings in ({}, {"integrity": {"p_constellation": 1e-8}}):
        path = tmp_path / "optimum.yaml"
        common = {"pseudolites.frame": "runway", "duration_s": 61, "receiver.rate_hz": 1, "imu.rate_hz": 10}
        path.write_text(
            f"kind: optimize\nversion: 1\nbase: {SCENARIOS / 'landing.yaml'}\nobjective: horizontal\n"
            f"set: {json.dumps(common | {'filter.kind': 'eskf'} | settings)}\npseudolites: [1]\n"
            "sites: [{s_m: 300, l1_m: 500}, {s_m: -800, l1_m: 1500}, {s_m: 600, l1_m: 0}]\n"
        )
        navsim("optimize", path, "--figures", "none", "-q", "-o", "o.h5", "--force", cwd=tmp_path)
        result = read(tmp_path / "o.h5")
        as_declared(result)
        places.append(
            {name: np.asarray(v.data) for name, v in result.variables.items() if name.startswith("/optimum/")}
        )
    assert len(places[0]) > 10
    assert places[0].keys() == places[1].keys()
    for name, data in places[0].items():
        np.testing.assert_array_equal(data, places[1][name], err_msg=name)
