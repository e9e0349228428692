"""`navsim verify`: results of every kind are what their scenarios give, and tampered ones are found, each by name."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from navsim.results.contents import attribute_digest
from navsim.results.result import Result, contents_of, read, read_unchecked, write
from navsim.runner.executor import threads
from navsim.runner.provenance import CODE
from navsim.runner.verification import ALL, DIFFERS, EQUAL, INTACT, NOTE, Verification, verify
from navsim.scenario import load
from navsim.scenario_files import shipped
from navsim.scenario_files.source import parse
from tests.conftest import SCENARIOS
from tests.forks import navsim
from tests.made import EVERY

RUNS = 5
BRIEFLY_VERIFIED = ("runs", "covariance", "rare", "sweep", "replay", "live")
"""A result of each way of computing; the others take seconds."""


def verified(file: Path, runs: int = ALL, folder: Path | None = None) -> Verification:
    return verify(file, folder, runs, threads(1), lambda *_: None)


def wrong(found: Verification) -> str:
    """All differences as text."""
    return "\n".join(f"{check.subject}: {check.text}" for check in found.checks if check.verdict == DIFFERS)


@pytest.mark.parametrize(
    "kind", [kind if kind in BRIEFLY_VERIFIED else pytest.param(kind, marks=pytest.mark.long) for kind in EVERY]
)
def test_every_kind_is_verified_to_the_bit(kind: str, place: Path) -> None:
    found = verified(place / f"{kind}.h5", 8 if kind == "runs" else ALL)
    assert wrong(found) == ""
    assert not found.incomplete
    verdicts = {check.subject: check.verdict for check in found.checks}
    if kind == "live":
        assert verdicts["numbers"] == NOTE
        return
    assert set(verdicts.values()) == {EQUAL}
    subjects = ("tables", "histories", "runs") if kind == "runs" else ("numbers",)
    assert set(subjects) <= set(verdicts)


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small ensemble that has requirements, a box, an input file, and everything kept of each run."""
    folder = tmp_path_factory.mktemp("original")
    shutil.copy(SCENARIOS / "data" / "nominal.agl", folder / "orbits.agl")
    text = (SCENARIOS / "landing.yaml").read_text()
    (folder / "case.yaml").write_text(text)
    navsim(
        "run", "case.yaml", "--runs", RUNS, "--keep", "all", "-q", "-o", "r.h5", "--set", "duration_s=62",
        "--set", "imu.rate_hz=10", "--set", "receiver.rate_hz=1",
        "--set", "sky={source: almanac, almanac: [orbits.agl]}",
        "--set", "box={lateral_m: 1.5, vertical_m: 1.5}",
        "--set", "requirements=[{what: rms, of: horizontal, below_m: 0.2}]", cwd=folder,
    )  # fmt: skip
    return folder


Change = Callable[[dict[str, Any], dict[str, np.ndarray]], None]


def _cell(path: str, *at: int, by: float = 1e-6) -> Change:
    def change(_: dict[str, Any], data: dict[str, np.ndarray]) -> None:
        data[path][at] += by

    return change


def _set(path: str, value: object) -> Change:
    def change(_: dict[str, Any], data: dict[str, np.ndarray]) -> None:
        data[path][...] = value

    return change


def _attribute(name: str, value: object) -> Change:
    def change(root: dict[str, Any], _: dict[str, np.ndarray]) -> None:
        root[name] = value

    return change


def _swap(one: str, other: str) -> Change:
    def change(_: dict[str, Any], data: dict[str, np.ndarray]) -> None:
        data[one], data[other] = data[other].copy(), data[one].copy()

    return change


def _swap_runs(path: str) -> Change:
    def change(_: dict[str, Any], data: dict[str, np.ndarray]) -> None:
        data[path][[1, 3]] = data[path][[3, 1]]

    return change


def _scenario(old: str, new: str, sealed: bool) -> Change:
    def change(root: dict[str, Any], _: dict[str, np.ndarray]) -> None:
        assert old in root["scenario"]
        root["scenario"] = root["scenario"].replace(old, new)
        if sealed:
            root["scenario_sha256"] = hashlib.sha256(root["scenario"].encode()).hexdigest()

    return change


def _warned(_: dict[str, Any], data: dict[str, np.ndarray]) -> None:
    for path in [path for path in data if path.startswith("/findings/")]:
        value = np.array(["all is well"], object) if data[path].dtype.kind == "O" else np.zeros(1, data[path].dtype)
        data[path] = np.concatenate([data[path], value])


CHANGES: dict[str, tuple[Change, str]] = {
    "a cell of a table": (_cell("/summary/rms/horizontal", 0), "/summary/rms/horizontal"),
    "the end of an interval": (_cell("/summary/rms/vertical", 2), "/summary/rms/vertical"),
    "a percentile": (_cell("/summary/at/lateral_percentile", 0, 0), "/summary/at/lateral_percentile"),
    "one run's table entry": (_cell("/summary/at/vertical_run", 2, 0), "/summary/at/vertical_run"),
    "an error": (_cell("/filter/error", 3, 40, 0), "/filter/error"),
    "the last digit of an error": (_cell("/filter/error", 0, 61, 14, by=1e-12), "/filter/error"),
    "a run's trajectory": (lambda _, d: d["/filter/error"][1].__imul__(0.9), "/filter/error"),
    "smaller sigmas": (lambda _, d: d["/filter/sigma"].__imul__(0.5), "/filter/sigma"),
    "two runs swapped": (_swap_runs("/filter/error"), "/filter/error"),
    "a range": (_cell("/measurements/pseudorange", 4, 10, 0, by=0.01), "/measurements/pseudorange"),
    "an inertial sample": (_cell("/imu/delta_angle", 2, 100, 1, by=1e-9), "/imu/delta_angle"),
    "a fix": (_cell("/receiver/position_llh", 1, 20, 2), "/receiver/position_llh"),
    "the use of a fix": (_set("/filter/fix_status", 0), "/filter/fix_status"),
    "not a number": (_set("/summary/consistency/mean_group", np.nan), "/summary/consistency/mean_group"),
    "the truth": (_cell("/truth/position_llh", 50, 2, by=1e-9), "/truth/position_llh"),
    "a dilution of precision": (_cell("/geometry/pdop", 10, by=-0.1), "/geometry/pdop"),
    "a verdict": (_set("/summary/requirements/verdict", "met"), "/summary/requirements/verdict"),
    "a requirement's value": (_set("/summary/requirements/value", 0.1), "/summary/requirements/value"),
    "a requirement's limit": (_set("/summary/requirements/size", 99.0), "/summary/requirements/size"),
    "datasets swapped": (_swap("/summary/rms/horizontal", "/summary/rms/vertical"), "/summary/rms/horizontal"),
    "a dataset deleted": (lambda _, d: d.pop("/summary/box/outside"), "/summary/box/outside"),
    "a warning added": (_warned, "/findings"),
    "a number of runs": (_set("/summary/count/runs", 1000), "/summary/count/runs"),
    "the runs' numbers": (_cell("/run", 4, by=5), "/run"),
    "the merge data": (_cell("/part/of_run", 1, 0), "/part/of_run"),
    "the seed": (_attribute("seed", 7), "seed"),
    "the title": (_attribute("title", "another"), "title"),
    "the epoch": (_attribute("epoch", "2018-09-13T12:00:01Z"), "epoch"),
    "the method": (_attribute("method", "covariance"), "method"),
    "the version": (_attribute("navsim_version", "9.9"), "navsim_version"),
    "the kind": (_attribute("kind", "sweep"), "kind"),
    "an attribute deleted": (lambda root, _: root.pop("title"), "title"),
    "an attribute added": (_attribute("approved", "yes"), "approved"),
    "the scenario": (_scenario("duration_s: 62", "duration_s: 61", False), "scenario"),
    "the scenario and its digest": (_scenario("below_m: 0.2", "below_m: 5.0", True), "/summary/requirements"),
    "the digest of an input": (_set("/provenance/input_sha256", "0" * 64), "orbits.agl"),
}  # fmt: skip
"""What somebody changes in a result, and what names it."""
BRIEFLY = ("a cell of a table", "a run's trajectory", "a verdict", "a dataset deleted", "the seed",
           "the scenario and its digest")  # fmt: skip
"""Tried every time: a statistic, a history, a decision, a lack, an attribute, a scenario that fits its digest."""
ALL_CHANGES = [name if name in BRIEFLY else pytest.param(name, marks=pytest.mark.long) for name in CHANGES]


def changed(file: Path, name: str, out: Path) -> None:
    """Write a result with a change, as if navsim had written it: all checksums and digests fit."""
    result = read(file)
    data = {path: np.array(v.data) for path, v in result.variables.items()}
    root = dict(result.attributes)
    CHANGES[name][0](root, data)
    write(out, Result(root, {path: replace(result.variables[path], data=data[path]) for path in data}))


@pytest.fixture(scope="module")
def honest(original: Path) -> dict[str, str]:
    """The digests that navsim wrote."""
    return contents_of(read(original / "r.h5"))


@pytest.mark.parametrize("name", ALL_CHANGES)
def test_changes_are_found_and_named(name: str, original: Path, honest: dict[str, str], tmp_path: Path) -> None:
    """A forger writes all digests anew: only the numbers themselves say it. Some other program leaves them: they say it
    without any computation."""
    file = tmp_path / "r.h5"
    changed(original / "r.h5", name, file)
    assert CHANGES[name][1] in wrong(verified(file, folder=original))
    with h5py.File(file, "r+") as tree:
        del tree.attrs["contents"]
        tree.attrs["contents"] = json.dumps(honest)
    result, contents, lost = read_unchecked(file)
    assert contents == honest
    assert lost
    here = contents_of(result)
    named = {key.removeprefix("@") for key in here.keys() | honest.keys() if here.get(key) != honest.get(key)}
    expected = "/provenance/input_sha256" if name == "the digest of an input" else CHANGES[name][1]
    assert any(expected in key for key in named) or name == "the scenario and its digest"
    if name == "the seed":
        found = wrong(verified(file, folder=original))
        assert "seed: was changed after the file was written" in found
        assert "checksums are gone" in found


def test_changed_and_lacking_inputs_are_named(original: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(original, tmp_path / "copy")
    with open(folder / "orbits.agl", "a") as file:
        file.write("\n")
    assert "orbits.agl (sky.almanac)" in wrong(verified(folder / "r.h5", folder=folder))
    (folder / "orbits.agl").unlink()
    done = navsim("verify", "r.h5", cwd=folder, code=2)
    assert "orbits.agl (sky.almanac): no such file; --folder" in done.stdout
    shutil.copy(original / "orbits.agl", folder)
    (folder / "case.yaml").write_text((folder / "case.yaml").read_text() + "# later\n")
    assert "case.yaml" in wrong(verified(folder / "r.h5", folder=folder))
    assert "an input is not the one of the result" in navsim("verify", "r.h5", cwd=folder, code=1).stderr


def test_damaged_files_are_found(original: Path, tmp_path: Path) -> None:
    whole = (original / "r.h5").read_bytes()
    file = tmp_path / "r.h5"
    for damaged in (whole[:-100], whole[: len(whole) // 2], whole.replace(b"/filter", b"/Filter", 1)):
        file.write_bytes(damaged)
        assert wrong(verified(file, folder=original)).startswith("file:")
    middle = bytearray(whole)
    middle[len(whole) // 2] ^= 1
    file.write_bytes(middle)
    assert wrong(verified(file, folder=original)).startswith("file:")


def test_files_without_marks_of_checksums_and_digests_are_found(original: Path, tmp_path: Path) -> None:
    """Results that say what computed them have both."""
    shutil.copy(original / "r.h5", tmp_path)
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        del file.attrs["checksums"]
        file["/summary/rms/horizontal"][0] += 1e-6
    found = wrong(verified(tmp_path / "r.h5", folder=original))
    assert "checksums are gone" in found
    assert "/summary/rms/horizontal: was changed after the file was written" in found
    assert "checksums are gone" in navsim("show", "r.h5", cwd=tmp_path, code=2).stderr
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        del file.attrs["contents"]
    assert "digests of the contents" in wrong(verified(tmp_path / "r.h5", folder=original))


def test_command_exit_codes(original: Path, tmp_path: Path) -> None:
    good = navsim("verify", original / "r.h5", "--folder", original, "--json", cwd=tmp_path)
    assert json.loads(good.stdout)["verdict"] == EQUAL
    changed(original / "r.h5", "a cell of a table", tmp_path / "r.h5")
    bad = navsim("verify", "r.h5", "--folder", original, "-q", cwd=tmp_path, code=1)
    assert "/summary/rms/horizontal[0]" in bad.stdout
    assert "equal" not in bad.stdout
    for command in (("none.h5",), (SCENARIOS / "landing.yaml",), ("r.h5", "--runs", "0"), ("r.h5", "--folder", "no")):
        navsim("verify", *command, cwd=tmp_path, code=2)


def test_another_machine_is_told_and_compared_within_rounding(original: Path, tmp_path: Path) -> None:
    result = read(original / "r.h5")
    data = {path: np.array(v.data) for path, v in result.variables.items()}
    items = list(data["/provenance/item"])
    data["/provenance/value"][items.index("processor")] = "another"
    data["/filter/error"] *= 1.0 + 1e-12
    write(tmp_path / "r.h5", Result(result.attributes, {
        path: replace(result.variables[path], data=data[path]) for path in data
    }))  # fmt: skip
    found = verified(tmp_path / "r.h5", folder=original)
    assert wrong(found) == ""
    notes = [check.text for check in found.checks if check.verdict == NOTE]
    assert any("processor: another in the result" in text for text in notes)
    assert any("equal bits can be expected only" in text for text in notes)
    data["/filter/error"][0, 0] += 0.1
    write(tmp_path / "r.h5", Result(result.attributes, {
        path: replace(result.variables[path], data=data[path]) for path in data
    }))  # fmt: skip
    assert "/filter/error" in wrong(verified(tmp_path / "r.h5", folder=original))


def _of_other_code(original: Path, out: Path, by: float) -> None:
    """Write the result with another digest of the code and a changed cell, sealed."""
    result = read(original / "r.h5")
    data = {path: np.array(v.data) for path, v in result.variables.items()}
    data["/provenance/value"][list(data["/provenance/item"]).index(CODE)] = "0" * 64
    data["/summary/rms/horizontal"][0] *= 1.0 + by
    write(out, Result(result.attributes, {path: replace(result.variables[path], data=data[path]) for path in data}))


def test_a_result_of_other_code_is_not_called_changed(original: Path, tmp_path: Path) -> None:
    """A verdict and an exit code of its own, what of the tables differs; damage and other inputs stay what they are."""
    _of_other_code(original, tmp_path / "r.h5", 0.02)
    done = navsim("verify", "r.h5", "--folder", original, "-q", "--runs", "all", cwd=tmp_path, code=4)
    assert INTACT in done.stderr
    assert "error" not in done.stderr
    (printed,) = re.findall("printed +other code +largest relative difference of a printed number: (.*)", done.stdout)
    assert printed.startswith("0.02 (Filter, errors over 20 s to touchdown, horizontal position, m: ")
    assert "printed rows that read differently: 1 of" in done.stdout
    with h5py.File(tmp_path / "r.h5", "r+") as file:
        file["/summary/rms/vertical"][0] += 1e-6
    assert verified(tmp_path / "r.h5", folder=original).differs
    _of_other_code(original, tmp_path / "r.h5", 0.0)
    found = verified(tmp_path / "r.h5", folder=original)
    assert found.plain()["verdict"] == EQUAL


def test_drawn_runs_and_statistics_find_errors_of_any_run(original: Path, tmp_path: Path) -> None:
    """Whichever runs are drawn, statistics find a changed error; and a note says what drawing may miss."""
    changed(original / "r.h5", "a run's trajectory", tmp_path / "r.h5")
    found = verified(tmp_path / "r.h5", 1, original)
    assert "/filter/error: run 1 does not give the statistics" in wrong(found)


def test_contents_are_of_values_and_not_of_their_storage() -> None:
    assert attribute_digest(np.float64(1.5)) == attribute_digest(1.5) == attribute_digest([1.5])
    assert attribute_digest("a") != attribute_digest("b")


@pytest.mark.parametrize("name", ["landing", "landing_open_sky", "circuit", "s_turn", "track"])
def test_a_stored_scenario_reads_back(name: str) -> None:
    """Every default is written out in a result: a key that is refused beside others is not, with its default."""
    section, document = load.read_any(shipped.path(name))
    text = load.resolved_yaml(section)
    again, _ = load.read_any(parse(text, "stored", document.folder))
    assert load.resolved_yaml(again) == text
