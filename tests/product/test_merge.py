"""Parts of an ensemble, flown one by one and put together, are the whole to the bit; what is no part is refused."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import h5py
import pytest

from navsim.results.result import read
from navsim.runner.control_variates import LEAST_RUNS
from tests.conftest import SCENARIOS
from tests.forks import navsim
from tests.helpers import in_brief
from tests.layout import as_declared
from tests.product.test_run import SHORT, stored

PARTS = ((0, 7), (7, 26), (33, 1), (34, 6))
"""First runs and numbers of runs: a batch's size divides none of them, and one is alone."""
SLOW = ("--set", "receiver.rate_hz=1", "--set", "imu.rate_hz=20")
ALL = sum(runs for _, runs in PARTS)
TWO = ((0, 7), (7, ALL - 7))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("merge")


def fly(place: Path, name: str, *options: object) -> Path:
    file = place / f"{name}.h5"
    if not file.exists():
        navsim("run", SCENARIOS / "landing.yaml", *SHORT, *options, "-q", "-o", file, cwd=place)
    return file


def flown(
    place: Path, name: str, *options: object, parts: tuple[tuple[int, int], ...] = PARTS
) -> tuple[Path, list[Path]]:
    """The whole, and its parts."""
    whole = fly(place, f"{name}-whole", "--runs", ALL, *options)
    made = [fly(place, f"{name}-{first}", "--first-run", first, "--runs", runs, *options) for first, runs in parts]
    return whole, made


def test_a_first_landing_by_itself_and_the_others_are_the_whole(place: Path) -> None:
    """It has no first-order error of its own."""
    options = (*SLOW, "--keep", "none", "--set", "filter.kind=eskf")
    whole = fly(place, "eskf-whole", "--runs", LEAST_RUNS, *options)
    alone = fly(place, "eskf-alone", "--runs", 1, *options)
    others = fly(place, "eskf-others", "--first-run", 1, "--runs", LEAST_RUNS - 1, *options)
    file = place / "eskf-both.h5"
    navsim("merge", alone, others, "-o", file, "-q", cwd=place)
    assert stored(file) == stored(whole)
    assert "/summary/controlled/rms/horizontal" in read(file)


@pytest.mark.parametrize("keep", in_brief(["none", "errors", "all"], 1))
def test_four_parts_are_the_whole(keep: str, place: Path) -> None:
    whole, parts = flown(place, keep, *SLOW, "--keep", keep)
    file = place / f"{keep}-merged.h5"
    done = navsim("merge", parts[2], parts[0], parts[3], parts[1], "-o", file, cwd=place)
    assert stored(file) == stored(whole)
    as_declared(read(file))
    assert str(file) in done.stdout.replace("\n", "")
    if keep != "errors":
        return
    # what was put together is a part like any other
    half = place / f"{keep}-half.h5"
    navsim("merge", *parts[:2], "-o", half, "-q", cwd=place)
    again = place / f"{keep}-again.h5"
    navsim("merge", half, *parts[2:], "-o", again, "-q", cwd=place)
    assert stored(again) == stored(whole)


WATCHED = (
    *SLOW,
    "--set", "integrity={limits: {hal_m: 40, val_m: 15, tta_s: 6}, exclusion: residual}",
    "--set", "altimeter={}",
)  # fmt: skip


def test_watched_fixes_and_aiding_are_put_together_too(place: Path) -> None:
    whole, parts = flown(place, "watched", *WATCHED, "--keep", "errors", parts=TWO)
    file = place / "watched-merged.h5"
    navsim("merge", *parts, "-o", file, "-q", cwd=place)
    assert "/summary/integrity/alert" in read(file) or "/integrity/status" in read(file)
    assert stored(file) == stored(whole)


def test_pushed_runs_are_put_together_too(place: Path) -> None:
    options = ("--method", "rare", "--set", "box={height_m: 30, lateral_m: 12}", *SLOW)
    whole, parts = flown(place, "rare", *options, parts=TWO)
    file = place / "rare-merged.h5"
    navsim("merge", *parts, "-o", file, "-q", cwd=place)
    assert stored(file) == stored(whole)


def test_files_of_satellites_are_found_by_folder(place: Path) -> None:
    (place / "sky").mkdir()
    shutil.copy(SCENARIOS / "data" / "nominal.agl", place / "sky")
    sky = ("--set", "sky.source=almanac", "--set", "sky.almanac=sky/nominal.agl")
    whole, parts = flown(place, "almanac", *sky, "--keep", "none", *SLOW, parts=TWO)
    file = place / "almanac-merged.h5"
    refused = navsim("merge", *parts, "-o", file, cwd=place / "sky", code=2)
    assert "--folder" in refused.stderr
    navsim("merge", *parts, "-o", file, "--folder", place, "-q", cwd=place / "sky")
    assert stored(file) == stored(whole)


def test_summary_as_json_and_dry_run(place: Path) -> None:
    _, parts = flown(place, "errors", *SLOW, "--keep", "errors")
    told = navsim("merge", *parts, "-o", place / "told.h5", "--dry-run", cwd=place)
    assert "4 parts, runs 0 to 39" in told.stderr
    assert not (place / "told.h5").exists()
    done = navsim("merge", *parts, "-o", place / "told.h5", "--json", cwd=place)
    assert json.loads(done.stdout)["summary"]["count"]["runs"] == ALL


def test_gaps_overlaps_and_strangers_are_refused(place: Path) -> None:
    errors = ("--keep", "errors")
    whole, parts = flown(place, "errors", *SLOW, *errors)
    other_seed = fly(place, "seed", "--first-run", 7, *SLOW, "--seed", 2, *errors)
    kept = fly(place, "kept", "--first-run", 7, *SLOW, "--keep", "none")
    other = fly(place, "other", "--first-run", 7, *errors, *SLOW, "--set", "receiver.rate_hz=2")
    covariance = fly(place, "covariance", *SLOW, "--method", "covariance")
    refused = {
        "runs 7 to 33 are missing between errors-0.h5 and errors-34.h5": (parts[3], parts[0]),
        "run 33 is missing between errors-7.h5 and errors-34.h5": (parts[0], parts[1], parts[3]),
        "runs 7 to 32 are in both": (parts[1], whole),
        "run 33 is in both errors-33.h5 and errors-33.h5": (parts[2], parts[2]),
        "seed 1 in errors-0.h5, 2 here": (parts[0], other_seed),
        "--keep errors in errors-0.h5, none here": (parts[0], kept),
        "scenario of SHA-256": (parts[0], other),
        "method covariance": (parts[0], covariance),
        "nowhere.h5: no such file": (parts[0], place / "nowhere.h5"),
    }
    for words, files in refused.items():
        names = [file.name for file in files]
        done = navsim("merge", *names, "-o", "refused.h5", cwd=place, code=2)
        assert words in done.stderr, done.stderr
        assert not (place / "refused.h5").exists()
    same = navsim("merge", parts[0].name, parts[1].name, "-o", parts[1].name, cwd=place, code=2)
    assert "errors-7.h5: is one of the parts" in same.stderr


def test_damaged_and_altered_parts_are_refused(place: Path) -> None:
    _, parts = flown(place, "errors", *SLOW, "--keep", "errors")
    damaged = place / "damaged.h5"
    content = bytearray(parts[1].read_bytes())
    content[len(content) // 2] ^= 1
    damaged.write_bytes(content)
    done = navsim("merge", parts[0], damaged, "-o", place / "refused.h5", cwd=place, code=2)
    assert "damaged.h5" in done.stderr
    damaged.write_bytes(parts[1].read_bytes()[: len(content) // 2])
    done = navsim("merge", parts[0], damaged, "-o", place / "refused.h5", cwd=place, code=2)
    assert "damaged.h5" in done.stderr
    altered = place / "altered.h5"
    for path, words in (
        ("/geometry/pdop", "common to all runs"),
        ("/part", "an earlier version"),
    ):
        shutil.copy(parts[1], altered)
        with h5py.File(altered, "r+") as file:
            del file.attrs["checksums"], file.attrs["contents"]
            if path == "/part":
                del file[path]
            else:
                file[path][3] += 1e-12
        done = navsim("merge", parts[0], altered, "-o", place / "refused.h5", cwd=place, code=2)
        assert words in done.stderr, done.stderr
        assert "altered.h5" in done.stderr
    assert not (place / "refused.h5").exists()
