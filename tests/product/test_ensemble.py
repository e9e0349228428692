"""Studies of many runs: killed, interrupted, damaged, refused, and always the same numbers in the end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2, norm

from navsim.results.estimates import estimate
from navsim.results.result import read
from navsim.runner.batches import BATCH
from tests import forks
from tests.conftest import SCENARIOS
from tests.forks import Ended, navsim
from tests.layout import as_declared
from tests.product.test_run import SHORT, stored
from tests.steps import PIECE

RUNS = 8 * BATCH
KEPT = "finished runs are kept in {0}.partial; the same command continues from there, or navsim resume {0}.partial\n"
QUICK = (*SHORT, "--set", "imu.rate_hz=20", "--set", "receiver.rate_hz=2", "--set", "filter.kind=eskf")
BATCH_BYTES = 500_000
"""Of a batch of the study on disk, roughly."""
COMMAND = ("run", SCENARIOS / "landing.yaml", *QUICK, "--runs", RUNS, "-q")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("ensemble")


@pytest.fixture(scope="module")
def undisturbed(place: Path) -> Path:
    file = place / "undisturbed.h5"
    navsim(*COMMAND, "-o", file, cwd=place)
    assert not Path(f"{file}.partial").exists()
    return file


def finished(file: Path) -> list[Path]:
    return sorted(Path(f"{file}.partial").glob("*.npz"))


def stopped_by(number: str, file: Path, after: int, *more: object) -> Ended:
    """The study, which gets a signal as the batch after these is about to be kept."""
    words = (*COMMAND, "--workers", 1, *more, "-o", file)
    return forks.shared().run(*words, cwd=file.parent, what=number, at=after + 1, of=PIECE)


def test_interrupt_keeps_what_is_finished(place: Path, undisturbed: Path, tmp_path: Path) -> None:
    """And `navsim resume` goes on with it, from any folder."""
    file = place / "interrupted.h5"
    done = stopped_by("SIGINT", file, 2)
    assert done.code == 130
    assert "Traceback" not in done.err
    assert f"continues from there, or navsim resume {file}.partial\n" in done.err
    kept = {path.name: path.stat().st_mtime_ns for path in finished(file)}
    assert 2 <= len(kept) < 8
    said = navsim("resume", f"{file}.partial", cwd=tmp_path).stderr
    assert said.startswith(f"navsim {COMMAND[0]} {COMMAND[1]} --output {file} ")
    assert stored(file) == stored(undisturbed)
    assert not Path(f"{file}.partial").exists()
    assert "no folder of partial work" in navsim("resume", f"{file}.partial", cwd=tmp_path, code=2).stderr


def test_full_disk_keeps_finished_batches(place: Path) -> None:
    """A limit on the size of a file stands for a full disk: the first batch that does not fit ends the study."""
    file = place / "full.h5"
    ends = {0: "; no work is kept; the same command starts from the beginning\n", 2: KEPT.format(file)}
    for before, end in ends.items():
        if before:
            stopped_by("SIGKILL", file, before)
        kept = finished(file)
        assert len(kept) == before
        done = navsim(*COMMAND, "-o", file, cwd=place, code=3, file_bytes=BATCH_BYTES // 2)
        assert "full.h5.partial" in done.stderr
        assert "cannot be written" in done.stderr
        assert done.stderr.endswith(end)
        assert finished(file) == kept
        assert not file.exists()


def test_large_result_on_a_full_disk(place: Path) -> None:
    """The file of an ensemble is larger than its batches; when it does not fit, the batches stay."""
    file = place / "large.h5"
    done = navsim(*COMMAND, "-o", file, cwd=place, code=3, file_bytes=4 * BATCH_BYTES)
    assert done.stderr.endswith(KEPT.format(file))
    assert len(finished(file)) == 8
    navsim(*COMMAND, "-o", file, cwd=place)
    assert read(file)["/run"].size == RUNS


def test_keep_decides_what_is_stored(place: Path) -> None:
    base = ("run", SCENARIOS / "landing.yaml", *QUICK, "--runs", 30, "-q", "-o", "keep.h5", "--keep")
    summaries = []
    for keep, stored_paths, left_out in (
        ("none", ["/summary/rms/horizontal"], ["/filter/error", "/receiver/position_llh"]),
        ("errors", ["/filter/error", "/filter/sigma"], ["/receiver/position_llh", "/measurements/pseudorange"]),
        ("all", ["/filter/error", "/receiver/position_llh", "/measurements/pseudorange"], []),
    ):
        navsim(*base, keep, cwd=place)
        r = read(place / "keep.h5")
        as_declared(r)
        assert all(path in r for path in stored_paths)
        assert not any(path in r for path in left_out)
        summaries.append({p: v.data for p, v in r.variables.items() if p.startswith("/summary")})
    for path in summaries[0]:
        np.testing.assert_array_equal(summaries[0][path], summaries[1][path])
        np.testing.assert_array_equal(summaries[0][path], summaries[2][path])


def test_statistics_do_not_need_the_histories(place: Path, undisturbed: Path) -> None:
    """The streamed summary against one recomputed from the stored errors of all runs."""
    r = read(undisturbed)
    t = r["/filter/time"]
    window = (t >= 60.18782 - 20) & (t <= 60.18783)
    mean_square = np.mean(r["/filter/error"][:, window] ** 2, axis=(0, 1))
    assert r["/summary/rms/horizontal"][0] == pytest.approx(np.sqrt(mean_square[:2].sum()))
    np.testing.assert_allclose(r["/summary/rms/velocity_ned"][:, 0], np.sqrt(mean_square[3:6]))
    np.testing.assert_allclose(r["/summary/consistency/nees"], r["/filter/nees"].mean(axis=0) / 15)
    np.testing.assert_allclose(r["/summary/consistency/nis"][1:], r["/filter/innovation_squared"].mean(axis=0) / 6)
    at = r["/filter/error"][:, :, :3]
    touchdown = np.array([[np.interp(60.187821483, t, run[:, i]) for i in range(3)] for run in at])
    assert r["/summary/at/vertical"][0, 0] == pytest.approx(np.sqrt(np.mean(touchdown[:, 2] ** 2)), rel=1e-6)
    assert r["/summary/at/lateral"][0, 0] == pytest.approx(np.sqrt(np.mean(touchdown[:, 1] ** 2)), rel=1e-6)


def test_percentiles_coverage_and_verdicts(undisturbed: Path) -> None:
    """Against the stored histories, and the shares of a Gaussian."""
    r = read(undisturbed)
    t = r["/filter/time"]
    window = (t >= 60.18782 - 20) & (t <= 60.18783)
    size = np.sqrt(np.mean(r["/filter/error"][:, window, 2] ** 2, axis=1))
    np.testing.assert_allclose(r["/summary/rms/vertical_percentile"], np.percentile(size, [50, 95, 99]))
    np.testing.assert_allclose(r["/summary/coverage/expected"], chi2.cdf([1, 4, 9], 3))
    value, low, high = r["/summary/coverage/position"].T
    assert np.all((low < value) & (value < high))
    np.testing.assert_allclose(value, r["/summary/coverage/expected"], atol=0.04)
    groups = r["/summary/consistency/nees_group"]
    assert groups.shape == (t.size, 5)
    np.testing.assert_allclose(groups[0], 1.0, atol=0.15)  # the initial errors are drawn from P
    np.testing.assert_allclose(r["/summary/consistency/mean_group"], groups[window].mean(axis=0))


def test_every_state_is_judged_at_every_output(undisturbed: Path) -> None:
    """z, and shares of runs beyond its limits, against the stored histories of all runs."""
    r = read(undisturbed)
    ratio = r["/filter/error"] / r["/filter/sigma"]
    z, names, time = r["/consistency/z"], r["/consistency/state"], r["/consistency/time"]
    np.testing.assert_allclose(z, np.sqrt(np.mean(ratio**2, axis=0)), rtol=1e-12)
    for name, limit in (("beyond_95", norm.isf(0.025)), ("beyond_99_9", norm.isf(0.0005))):
        np.testing.assert_array_equal(r[f"/consistency/{name}"], np.mean(np.abs(ratio) > limit, axis=0))
    output, state = np.unravel_index(np.argmax(z), z.shape)
    branch = "/summary/consistency"
    assert (r[f"{branch}/worst_z"][state], r[f"{branch}/worst_time"][state]) == (z[output, state], time[output])
    assert r[f"{branch}/worst_beyond_95"][state] == r["/consistency/beyond_95"][output, state]
    np.testing.assert_array_equal(r[f"{branch}/least_z"], z.min(axis=0))
    called = str(names[state]).replace("attitude_down", "heading").replace("_", " ")
    words = str(r[f"{branch}/verdict"])
    assert f"{called} at {time[output]:g} s" in words
    assert f"z {z[output, state]:.2f}" in words
    assert f"{ratio.shape[0]} runs" in words
    assert r.variables[f"{branch}/verdict"].attributes["tolerance"] == 0.05


def test_until_stops_when_the_interval_is_narrow(place: Path, undisturbed: Path) -> None:
    """The first ensemble of whole batches whose interval is narrow enough, for any number of workers."""
    base = ("run", SCENARIOS / "landing.yaml", *QUICK, "-q", "--until", "rms_horizontal within 9 %")
    for workers in (1, 2):
        navsim(*base, "--workers", workers, "-o", f"u{workers}.h5", cwd=place)
    assert stored(place / "u1.h5") == stored(place / "u2.h5")
    r = read(place / "u1.h5")
    runs = r["/run"].size
    assert BATCH < runs < RUNS
    assert runs % BATCH == 0
    value, low, high = estimate(r, "/summary/rms/horizontal")
    assert 0.5 * (high - low) <= 0.09 * value
    np.testing.assert_array_equal(r["/filter/error"], read(undisturbed)["/filter/error"][:runs])
    shorter = ("run", SCENARIOS / "landing.yaml", *QUICK, "-q", "--runs", runs - BATCH, "-o", "shorter.h5")
    navsim(*shorter, cwd=place)
    value, low, high = read(place / "shorter.h5")["/summary/rms/horizontal"]
    assert 0.5 * (high - low) > 0.09 * value
    capped = navsim(*base, "--runs", BATCH, "-o", "capped.h5", cwd=place)
    assert f"not reached within {BATCH} runs" in capped.stderr


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        *(
            (wrong, "rms_horizontal within 2%")
            for wrong in ("", "rms", "rms_horizontal within", "rms_sideways within 2%")
        ),
        ("rms_vertical within 0%", "0 % is not within 0.001 to 1000 percent"),
    ],
)
def test_until_refused(expression: str, said: str, place: Path) -> None:
    refused = navsim("run", SCENARIOS / "landing.yaml", "--until", expression, "-o", "no.h5", cwd=place, code=2)
    assert said in refused.stderr
