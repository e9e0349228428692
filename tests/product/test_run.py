"""Whole commands: the main job, its files, warnings, repeatability."""

from __future__ import annotations

import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
from PIL import Image

from navsim.filter import states
from navsim.gnss.dop import dops
from navsim.results.findings import several
from navsim.results.result import read
from navsim.results.schema import NOT_REPEATED, PROVENANCE
from tests.conftest import SCENARIOS
from tests.forks import navsim
from tests.layout import as_declared

SHORT = ("--set", "duration_s=65")
QUICK = (*SHORT, "--set", "imu.rate_hz=20", "--set", "receiver.rate_hz=1")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("run")


@pytest.fixture(scope="module")
def landing(place: Path) -> tuple[subprocess.CompletedProcess[str], Path]:
    """The main job as the README runs it, in an empty folder."""
    done = navsim("run", SCENARIOS / "landing.yaml", cwd=place)
    return done, place / "results" / "landing.h5"


def test_summary_result_and_figures(landing: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    done, file = landing
    for word in (
        "PDOP",
        "horizontal position, m",
        "touchdown, lateral",
        "NEES, 15 states",
        "results/landing.h5",
    ):
        assert word in done.stdout
    assert file.is_file()
    for name in ("track", "sky", "dop", "fixes", "errors", "nees", "consistency"):
        with Image.open(file.parent / f"landing_{name}.png") as image:
            assert image.width >= 600
            pixels = np.asarray(image.convert("L"))
            assert 0.005 < np.mean(pixels < 128) < 0.5  # something is drawn, and not everything is black
    assert sorted(p.name for p in file.parent.iterdir() if p.suffix == ".tmp") == []
    as_declared(read(file))
    with h5py.File(file) as tree:
        assert {"kind", "schema_version", "navsim_version", "seed", "scenario_sha256", "created"} <= tree.attrs.keys()
        assert tree["/filter/innovation_squared"].attrs["degrees_of_freedom"] == 6
        assert list(tree["/filter/state"].asstr()[:]) == list(states.NAMES)
        assert tree["/geometry/source"].asstr()[0] == "R01"
        assert tree["/geometry/source"].asstr()[-1] == "PL2"


def test_result_agrees_with_itself(landing: tuple[subprocess.CompletedProcess[str], Path]) -> None:
    """Summary figures recomputed from the stored histories, independently of the code that wrote them."""
    r = read(landing[1])
    np.testing.assert_allclose(
        np.stack([r[f"/geometry/{d}"] for d in ("gdop", "pdop", "hdop", "vdop", "tdop")], axis=1),
        dops(r["/geometry/line_of_sight"], r["/geometry/clock"]),
    )
    glide = r["/geometry/time"] <= 60.1878
    assert r["/summary/dop/pdop"][0] == pytest.approx(r["/geometry/pdop"][glide].mean())
    assert r["/summary/dop/pdop"][1] == pytest.approx(r["/geometry/pdop"][glide].min())
    sko = np.sqrt(np.einsum("eii->ei", r["/receiver/covariance_enu"][glide])[:, :2].sum(axis=1)).mean()
    assert r["/summary/fix/rms_horizontal"][0] == pytest.approx(sko)
    t = r["/filter/time"]
    window = (t >= 60.18782 - 20) & (t <= 60.18783)
    error = r["/filter/error"][:, window, :]
    assert r["/summary/rms/horizontal"][0] == pytest.approx(np.sqrt(np.mean(error[..., 0] ** 2 + error[..., 1] ** 2)))
    assert r["/summary/rms/vertical"][0] == pytest.approx(np.sqrt(np.mean(error[..., 2] ** 2)))
    assert np.all(r["/summary/rms/horizontal"][1] < r["/summary/rms/horizontal"][0])
    assert np.all(r["/summary/rms/horizontal"][2] > r["/summary/rms/horizontal"][0])
    np.testing.assert_allclose(r["/summary/consistency/nees"], r["/filter/nees"].mean(axis=0) / 15)
    assert abs(r["/summary/at/vertical"][0, 0]) < 2.0


def test_error_is_truth_minus_estimate(place: Path) -> None:
    """Fixed initial errors come back in the result with their sign."""
    out = place / "fixed.h5"
    fixed = "initial_errors.fixed={position_m: [3, -4, 5], velocity_m_s: [0.1, 0.2, -0.3], attitude_deg: [1, -2, 3]}"
    navsim("run", SCENARIOS / "landing.yaml", *SHORT, "-o", out, "--figures", "none", "--set", fixed, cwd=place)
    r = read(out)
    expected = [3, -4, 5, 0.1, 0.2, -0.3, *np.radians([1, -2, 3])]
    np.testing.assert_allclose(r["/filter/error"][0, 0, :9], expected, rtol=1e-5)
    np.testing.assert_allclose(r["/filter/sigma"][0, 0, :9], np.repeat([10, 1, np.radians(5)], 3))


def stored(file: Path) -> dict[str, Any]:
    """All that must be identical between repetitions: every dataset and attribute but a few."""
    found: dict[str, Any] = {}
    with h5py.File(file) as h:
        found["/"] = {k: v for k, v in h.attrs.items() if k not in NOT_REPEATED}

        def take(name: str, node: Any) -> None:
            if f"/{name}".startswith(PROVENANCE):
                return  # options and paths by which the same was computed
            pointers = ("REFERENCE_LIST", "DIMENSION_LIST")
            found[name + "@"] = {k: np.asarray(v).tobytes() for k, v in node.attrs.items() if k not in pointers}
            if isinstance(node, h5py.Dataset):
                value = node.asstr()[()] if h5py.check_string_dtype(node.dtype) else node[()]
                found[name] = (
                    np.asarray(value).tolist().__repr__() if node.dtype.kind == "O" else np.asarray(value).tobytes()
                )

        h.visititems(take)
    return found


def test_repeats_bit_by_bit_whatever_the_workers(place: Path) -> None:
    files = []
    for workers in (1, 2):
        file = place / f"w{workers}.h5"
        options = ("--runs", 12, "--workers", workers, "--keep", "all", "-q", "-o", file)
        navsim("run", SCENARIOS / "landing.yaml", *QUICK, *options, cwd=place)
        files.append(stored(file))
    assert files[0] == files[1]


def test_a_run_alone_is_the_run_of_the_ensemble(place: Path) -> None:
    many, one, other = place / "many.h5", place / "one.h5", place / "other.h5"
    common = (SCENARIOS / "landing.yaml", *QUICK, "-q")
    navsim("run", *common, "--runs", 9, "-o", many, cwd=place)
    navsim("run", *common, "--first-run", 7, "-o", one, cwd=place)
    navsim("run", *common, "--first-run", 7, "--seed", 2, "-o", other, cwd=place)
    ensemble, alone = read(many), read(one)
    for path in ("/filter/error", "/filter/sigma", "/filter/nees", "/filter/innovation_squared"):
        np.testing.assert_array_equal(ensemble[path][7], alone[path][0])
    assert alone["/run"].tolist() == [7]
    assert np.any(read(other)["/filter/error"] != alone["/filter/error"])
    assert "/receiver/position_llh" not in ensemble
    assert not list(place.glob("many_*.png"))


def test_stored_scenario_reproduces_the_result(
    landing: tuple[subprocess.CompletedProcess[str], Path], place: Path
) -> None:
    """The resolved scenario in the file is a scenario, and flying it gives the same numbers."""
    first = read(landing[1])
    again = place / "again.yaml"
    again.write_text(str(first.attributes["scenario"]))
    navsim("run", again, "-q", "-o", place / "again.h5", cwd=place)
    second = read(place / "again.h5")
    assert second.attributes["scenario_sha256"] == first.attributes["scenario_sha256"]
    np.testing.assert_array_equal(second["/filter/error"], first["/filter/error"])


def test_json_is_alone_on_stdout(place: Path) -> None:
    done = navsim("run", SCENARIOS / "landing_gnss_only.yaml", *SHORT, "--json", "--figures", "none", cwd=place)
    summary = json.loads(done.stdout)
    assert summary["kind"] == "landing"
    assert summary["summary"]["count"]["fixes"] == 650
    assert len(summary["summary"]["rms"]["horizontal"]) == 3
    shown = json.loads(navsim("show", "results/landing_gnss_only.h5", "--json", cwd=place).stdout)
    assert shown == summary


def test_show_and_plot(landing: tuple[subprocess.CompletedProcess[str], Path], place: Path) -> None:
    table = navsim("show", landing[1], landing[1], cwd=place).stdout
    assert "PDOP" in table
    figures = navsim("plot", landing[1], "--only", "dop,sky", "--figures", "drawn", cwd=place).stdout.split()
    assert figures == ["drawn/landing_sky.png", "drawn/landing_dop.png"]
    assert all((place / f).is_file() for f in figures)


def warnings_of(done: subprocess.CompletedProcess[str]) -> list[str]:
    return [line for line in done.stderr.splitlines() if line.startswith("warning: ")]


def test_epochs_without_a_fix(place: Path) -> None:
    """Jammed but for the pseudolites: warned, exit 0, DOPs nan, sigma growing; --require-fix exits 3."""
    jam = ("--set", "sky.mask_deg=89.9", *QUICK, "-o", place / "jam.h5", "--figures", "none")
    ahead = navsim("validate", SCENARIOS / "landing.yaml", *jam[:2], *QUICK, cwd=place)
    said = "warning: 65 of 65 epochs without a fix: too few usable sources, the first at 1.0 s"
    assert any(w.startswith(said) for w in warnings_of(ahead))
    done = navsim("run", SCENARIOS / "landing.yaml", *jam, cwd=place)
    assert any("no fix at all" in w for w in warnings_of(done))
    assert several(len(warnings_of(done)), "warning") in done.stderr
    r = read(place / "jam.h5")
    assert np.all(np.isnan(r["/geometry/pdop"]))
    assert np.all(np.isnan(r["/receiver/position_llh"]))
    assert int(r["/summary/count/epochs_without_fix"]) == 65
    # a division of the sum's components takes some 3e-5 of it (docs/theory/gaussian-sum.md): J_l shrinks what it turns
    sigma = r["/filter/sigma"][0, :, 0]
    assert np.all(np.diff(sigma) > -1e-4 * sigma[:-1])
    assert np.all(sigma[10::10] > sigma[:-10:10])
    assert np.all(np.isnan(r["/summary/dop/pdop"]))
    refused = navsim("run", SCENARIOS / "landing.yaml", *jam, "--require-fix", cwd=place, code=3)
    assert "65 epochs without a fix" in refused.stderr


def test_some_epochs_without_a_fix(place: Path) -> None:
    """Four satellites, of which R07 sinks below the mask half-way: fixes before, none after, both counted."""
    jam = ("--set", "sky.mask_deg=22.15", "--set", "sky.exclude=[R08]", "--set", "pseudolites.count=0")
    done = navsim("run", SCENARIOS / "landing.yaml", *SHORT, *jam, "-q", "-o", "some.h5", cwd=place)
    r = read(place / "some.h5")
    lost = np.isnan(r["/geometry/pdop"])
    used = np.isfinite(r["/geometry/line_of_sight"][..., 0]).sum(axis=1)
    assert set(used) == {3, 4}
    np.testing.assert_array_equal(lost, used == 3)
    assert not lost[0]
    assert lost[-1]
    assert warnings_of(done) == [
        f"warning: {lost.sum()} of 650 epochs without a fix: too few usable sources, or all of them on one cone, "
        f"the first at {r['/geometry/time'][lost][0]:g} s, the last at 65 s [epochs_without_fix]"
    ]
    assert int(r["/summary/count/epochs_without_fix"]) == lost.sum()
    last_fix = int(np.flatnonzero(~lost)[-1]) + 1
    assert np.all(np.diff(r["/filter/sigma"][0, last_fix:, 0]) > 0)


def test_old_almanac_and_fresh_one(place: Path, shared: Path) -> None:
    """The real almanac by --set, as the docs show it; weeks later it is still used, with a warning."""
    almanac = shared / "data" / "almanacs" / "MCCJ_180913.agl"
    settings = ("--set", "sky.source=almanac", "--set", f"sky.almanac={almanac}", *QUICK, "-q", "-o", place / "a.h5")
    fresh = navsim("run", SCENARIOS / "landing.yaml", *settings, cwd=place)
    assert warnings_of(fresh) == []
    r = read(place / "a.h5")
    assert "almanac_sha256" in str(r.attributes["scenario"])
    relative = os.path.relpath(almanac, place)
    again = [a if not str(a).startswith("sky.almanac=") else f"sky.almanac={relative}" for a in settings]
    navsim("run", SCENARIOS / "landing.yaml", *again, cwd=place)
    np.testing.assert_array_equal(read(place / "a.h5")["/filter/error"], r["/filter/error"])
    old = navsim("run", SCENARIOS / "landing.yaml", *settings, "--set", "epoch=2018-11-20T12:00:00Z", cwd=place)
    # two months and a week; slots whose node is passed early in the day are the oldest
    assert any(re.search(r"6[89] days away", w) for w in warnings_of(old))


def test_short_flight_without_touchdown(place: Path) -> None:
    short = ("--set", "duration_s=30", "--figures", "none", "-o", place / "s.h5")
    done = navsim("run", SCENARIOS / "landing.yaml", *short, cwd=place)
    assert any("touchdown" in w for w in warnings_of(done))
    r = read(place / "s.h5")
    assert np.all(np.isnan(r["/summary/at/vertical"][0]))
    assert np.isfinite(r["/summary/rms/horizontal"][0])


def test_full_disk_is_a_clear_error(place: Path) -> None:
    """Files limited to 100 kB stand for a full disk: exit 3, message, the earlier result untouched."""
    file = place / "full.h5"
    navsim("run", SCENARIOS / "landing.yaml", *SHORT, "-q", "-o", file, cwd=place)
    before = file.read_bytes()
    again = ("run", SCENARIOS / "landing.yaml", *SHORT, "-q", "-o", file)
    done = navsim(*again, cwd=place, code=3, file_bytes=100_000)
    assert "full.h5" in done.stderr
    assert done.stderr.endswith("; no work is kept; the same command starts from the beginning\n")
    assert file.read_bytes() == before


def test_covariance_analysis(landing: tuple[subprocess.CompletedProcess[str], Path], place: Path) -> None:
    """`--method covariance`: the same table with a budget, readable by others, refused beside --runs."""
    command = ("run", SCENARIOS / "landing.yaml", *QUICK, "--method", "covariance", "--figures", "none")
    done = navsim(*command, "-o", "linear.h5", cwd=place)
    assert "Error budget" in done.stdout
    assert "satellite range" in done.stdout
    tree = xr.open_datatree(place / "linear.h5", engine="h5netcdf")
    assert tree["budget/rms"].dims == ("source", "time", "state")
    result = read(place / "linear.h5")
    as_declared(result)
    assert result.attributes["method"] == "covariance"
    data = json.loads(navsim("show", "linear.h5", "--json", cwd=place).stdout)
    budget = data["summary"]["budget"]
    assert budget["horizontal_share"][budget["source"].index("satellite_range")] > 0.5
    refused = navsim("run", SCENARIOS / "landing.yaml", "--method", "covariance", "--runs", 5, cwd=place, code=2)
    assert "--runs" in refused.stderr
    assert "linear covariance" in navsim("show", "linear.h5", landing[1], cwd=place).stdout
