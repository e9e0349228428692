"""`import navsim`: results of the command line byte for byte; errors, warnings, interrupts as Python has them."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import subprocess
import sys
import threading
from dataclasses import fields
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import xarray as xr
import yaml

import navsim
from navsim.api.arguments import OptimizeArguments, ReplayArguments, RunArguments, SweepArguments
from navsim.cli.options import OutputOptions, Required
from navsim.cli.recorded import ReplayOptions
from navsim.cli.run import RunOptions
from navsim.cli.studies import OptimizeOptions, SweepOptions
from navsim.runner.batches import BATCH
from tests.conftest import ROOT, SCENARIOS
from tests.helpers import in_brief
from tests.product.test_run import navsim as command
from tests.product.test_run import stored
from tests.recordings import sentences_of, write_flight

LANDING = SCENARIOS / "landing.yaml"
SHORT = {"duration_s": 20, "imu.rate_hz": 20, "receiver.rate_hz": 2}
STUDY = """
kind: sweep
version: 1
base: BASE
set: {pseudolites.frame: runway, receiver.rate_hz: 2}
vary:
  - {key: pseudolites.s_m, grid: {first: 50, last: 2000, count: 5}}
  - {key: pseudolites.l1_m, grid: {first: -500, last: 4000, count: 4}}
outputs: [pdop, fix_horizontal]
"""
BOX = {"lateral_m": 0.8, "vertical_m": 1.2}

pytestmark = pytest.mark.filterwarnings("ignore::navsim.NavsimWarning")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> navsim.ResultFile:
    """One landing, for tests that look at it."""
    return navsim.run(LANDING, set=SHORT, output=tmp_path_factory.mktemp("made") / "a.h5")


@pytest.fixture
def study(tmp_path: Path) -> Path:
    file = tmp_path / "study.yaml"
    file.write_text(STUDY.replace("BASE", str(SCENARIOS / "landing_gnss_only.yaml")))
    return file


def same(one: Path, other: Path) -> None:
    """Every dataset and attribute bit by bit."""
    left, right = stored(one), stored(other)
    assert left.keys() == right.keys()
    assert len(left) > 20
    for name in left:
        if name == "/":
            assert left[name].keys() == right[name].keys()
            assert all(np.array_equal(value, right[name][key]) for key, value in left[name].items()), name
        else:
            assert left[name] == right[name], name


def python(code: str, cwd: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """A process of its own."""
    return subprocess.run([sys.executable, *options, "-c", code], cwd=cwd, capture_output=True, text=True, timeout=600)


def problems(error: navsim.NavsimError) -> list[str]:
    """The problems of an error, which are its text."""
    said = [str(problem) for problem in error.problems]
    assert str(error) == "\n".join(said)
    return said


@pytest.mark.parametrize(
    ("scenario", "options", "given"),
    in_brief(
        [
            ("landing", {"runs": 40, "seed": 7}, SHORT),
            ("landing", {"method": "covariance"}, SHORT),
            ("landing_smooth", {"method": "rare", "runs": 32}, {"box": BOX}),
            ("mls_elevation", {}, {"montecarlo.experiments": 5}),
        ],
        0,
        1,
    ),
)
def test_runs_are_those_of_the_command_line(
    scenario: str, options: dict[str, Any], given: dict[str, Any], tmp_path: Path
) -> None:
    """From a file, and from its contents."""
    file = SCENARIOS / f"{scenario}.yaml"
    words = [w for name, value in options.items() for w in (f"--{name}", str(value))]
    words += [w for key, value in given.items() for w in ("--set", f"{key}={json.dumps(value)}")]
    command("run", str(file), *words, "-o", "cli.h5", "--figures", "none", cwd=tmp_path)
    made = navsim.run(file, set=given, output=tmp_path / "api.h5", **options)
    same(tmp_path / "cli.h5", made.path)
    if "runs" in options:
        contents = yaml.safe_load(file.read_text())  # with a datetime: PyYAML reads YAML 1.1
        again = navsim.run(contents, set=given, **options)
        same(made.path, again.path)


def test_a_sweep_is_the_one_of_the_command_line(study: Path, tmp_path: Path) -> None:
    command("sweep", str(study), "-o", "cli.h5", "--figures", "none", cwd=tmp_path)
    made = navsim.sweep(study, output=tmp_path / "api.h5", figures=tmp_path / "figures")
    same(tmp_path / "cli.h5", made.path)
    assert (tmp_path / "cli.csv").read_bytes() == (tmp_path / "api.csv").read_bytes()
    assert {file.suffix for file in made.files} == {".csv", ".png"}
    assert all(file.is_file() for file in made.files)
    assert made.verdicts == []
    assert made.tree["sweep/pdop"].shape == (5, 4)


def test_a_replay_is_the_one_of_the_command_line(tmp_path: Path) -> None:
    log = SCENARIOS / "recorded_flight.yaml"
    command("replay", str(log), "--set", "tuning=none", "-o", "cli.h5", "--figures", "none", cwd=tmp_path)
    same(tmp_path / "cli.h5", navsim.replay(log, set={"tuning": "none"}, output=tmp_path / "api.h5").path)


@pytest.mark.parametrize(
    ("arguments", "groups"),
    [
        (RunArguments, (RunOptions, Required, OutputOptions)),
        (SweepArguments, (SweepOptions, Required, OutputOptions)),
        (OptimizeArguments, (OptimizeOptions, OutputOptions)),
        (ReplayArguments, (ReplayOptions, Required, OutputOptions)),
    ],
    ids=["run", "sweep", "optimize", "replay"],
)
def test_every_option_of_the_command_line_is_a_keyword(arguments: Any, groups: tuple[Any, ...]) -> None:
    """But those about what is printed, and of how long it would take."""
    options = {field.name.rstrip("_") for group in groups for field in fields(group)}
    about_printing = {"json", "quiet", "dry_run", "log"}
    keywords = set(arguments.__annotations__) - {"progress"}
    if arguments is ReplayArguments:
        keywords -= {"fresh"}  # no work of a replay is kept
    assert keywords == options - about_printing


def test_problems_are_those_of_the_command_line(tmp_path: Path) -> None:
    """With file, line and key; all of them at once."""
    file = tmp_path / "bad.yaml"
    file.write_text(LANDING.read_text().replace("  rate_hz: ", "  rate_hzz: ").replace("duration_s: ", "duration_s: -"))
    done = command("validate", str(file), cwd=tmp_path, code=2)
    with pytest.raises(navsim.BadInput) as caught:
        navsim.run(file)
    assert done.stderr.splitlines() == [f"error: {problem}" for problem in problems(caught.value)]
    lines = file.read_text().splitlines()
    assert len(caught.value.problems) >= 2
    for problem in caught.value.problems:
        assert problem.file == str(file)
        assert problem.key.split(".")[-1] in lines[problem.line - 1]
    with pytest.raises(navsim.NavsimError):
        navsim.validate(file)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: navsim.run({"kind": "landing", "versoin": 1}), "versoin: unknown key; did you mean 'version'?"),
        (lambda: navsim.run({"kind": "landng"}), "scenario: kind: 'landng' is not a kind of scenario; did you mean"),
        (lambda: navsim.run({"kind": "landing", 3: 4}), "scenario: a key must be a text, not 3"),
        (lambda: navsim.run({"a": {"b": [1, object()]}}), "scenario: a.b.1: object is not a value for a key"),
        (lambda: navsim.run({"duration_s": float("nan")}), "scenario: duration_s: a finite number is needed, not nan"),
        (lambda: navsim.run(LANDING, set={"pseudolites.s_mm": 1}), "pseudolites.s_mm: unknown key; did you mean"),
        (lambda: navsim.run(LANDING, set={"duration_s.x": 1}), "--set duration_s.x=1: 'duration_s' is a single value"),
        (lambda: navsim.run(LANDING, set={"duration_s": np.inf}), "--set duration_s=inf: a finite number is needed"),
        (lambda: navsim.run(LANDING, seed=-1), "seed=-1: expected a whole number of at least 0"),
        (lambda: navsim.run(LANDING, runs=True), "runs=True: expected a whole number of at least 1"),
        (lambda: navsim.run(LANDING, keep="alll"), "keep='alll': allowed: errors, all, none"),
        (lambda: navsim.run(LANDING, until="soon"), "--until 'soon': expected `rms_horizontal within 2%`"),
        (lambda: navsim.run(LANDING, first_run=2**63 - 1), "--first-run 9223372036854775807: the last of 1 run(s)"),
        (lambda: navsim.run(LANDING, method="covariance", runs=5), "--runs: only for method monte-carlo"),
        (lambda: navsim.run(LANDING, output="nowhere/below/a.h5"), "create it first or choose another -o/--output"),
        (
            lambda: navsim.run(LANDING, output=ROOT / "LICENSE"),
            "not a readable HDF5 file; a result of navsim (.h5) is needed; it is not overwritten",
        ),
        (lambda: navsim.sweep(LANDING), f"use navsim run {LANDING} or navsim validate "),
        (lambda: navsim.run("absent.yaml"), "absent.yaml: there is no such file; 'navsim init' writes a"),
        (lambda: navsim.run(3), "expected the path of a file, or a mapping with its contents"),
        (lambda: navsim.load(ROOT / "README.md"), "README.md: not a readable HDF5 file"),
        (lambda: navsim.ResultFile("absent.h5"), "absent.h5: no such file"),
        (lambda: navsim.ResultFile(LANDING), "is not a result but a scenario of kind landing: use navsim run "),
        (lambda: navsim.verify(LANDING), "is not a result but a scenario of kind landing: use navsim run "),
        (lambda: navsim.verify("absent.h5", runs=0), "runs=0: expected a whole number of at least 1"),
        (lambda: navsim.evidence("absent.h5"), "absent.h5: no such file"),
        (lambda: navsim.import_log("absent.bin"), "absent.bin: cannot be read"),
        (lambda: navsim.import_log(LANDING, format="px5"), "--format px5: not a format of logs; did you mean 'px4'"),
        (lambda: navsim.schema("landng"), "'landng' is not a kind of scenario; did you mean 'landing'? allowed: "),
    ],
)  # fmt: skip
def test_bad_input_says_so(call: Any, said: str, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(navsim.BadInput) as caught:
        call()
    assert any(said in line for line in problems(caught.value)), problems(caught.value)
    assert not list(tmp_path.iterdir())


def test_what_must_stay_is_refused_with_the_option_that_helps(made: navsim.ResultFile, tmp_path: Path) -> None:
    target = Path(shutil.copy(made.path, tmp_path))
    before = target.read_bytes()
    with pytest.raises(navsim.BadInput, match="overwrite it with --force"):
        navsim.run(LANDING, set=SHORT, method="covariance", output=target)
    assert target.read_bytes() == before
    other = navsim.run(LANDING, set=SHORT, method="covariance", output=target, force=True)
    assert other.attributes["method"] == "covariance"
    with pytest.raises(navsim.BadInput, match="--over-budget computes it nevertheless"):
        navsim.run(LANDING, runs=10**9, keep="all", output=tmp_path / "b.h5")


def test_what_was_required_and_is_not_so(tmp_path: Path) -> None:
    """The result is complete, and the error says where."""
    events = {"events": [{"what": "silence", "sources": ["all"], "at_s": 5, "until_s": 8}]}
    with pytest.raises(navsim.RunFailed, match="--require-fix") as caught:
        navsim.run(LANDING, set=SHORT | events, require_fix=True, output=tmp_path / "a.h5")
    problems(caught.value)
    assert caught.value.path == tmp_path / "a.h5"
    found = navsim.ResultFile(tmp_path / "a.h5").findings
    assert any("fix" in finding.against and finding.count > 0 for finding in found)


class Enough(Exception):
    """Raised out of the progress of a study."""


@pytest.mark.parametrize("stop", in_brief([KeyboardInterrupt, Enough], 1))
def test_what_ends_the_work_leaves_what_is_finished(stop: type[BaseException], tmp_path: Path) -> None:
    """And the same call continues from there, to the same result."""
    target, runs = tmp_path / "a.h5", 2 * BATCH
    seen: list[tuple[int, int]] = []

    def told(finished: int, extent: int, words: str) -> None:
        seen.append((finished, extent))
        if finished >= BATCH:
            raise stop

    with pytest.raises(stop) as caught:
        navsim.run(LANDING, set=SHORT, runs=runs, workers=1, output=target, progress=told)
    assert not target.exists()
    kept = list((tmp_path / "a.h5.partial").glob("*.npz"))
    assert kept
    if stop is KeyboardInterrupt:
        assert any("the same command continues from there" in note for note in caught.value.__notes__)
    with pytest.raises(navsim.BadInput, match="--fresh discards it") as refused:
        navsim.run(LANDING, set=SHORT, runs=runs, seed=9, output=target)
    assert re.search(r"another study.*seed 1 there, 9 here", problems(refused.value)[0])
    seen.clear()
    made = navsim.run(LANDING, set=SHORT, runs=runs, workers=1, output=target, progress=lambda *a: seen.append(a[:2]))
    assert not (tmp_path / "a.h5.partial").exists()
    assert seen[-1] == (runs, runs)
    assert seen[0][0] >= BATCH
    assert [finished for finished, _ in seen] == sorted(finished for finished, _ in seen)
    whole = navsim.run(LANDING, set=SHORT, runs=runs)
    same(made.path, whole.path)


def test_nothing_is_printed_and_warnings_are_pythons(tmp_path: Path) -> None:
    code = f"""
import logging, warnings
import navsim
with warnings.catch_warnings(record=True) as heard:
    warnings.simplefilter("always")
    made = navsim.run({str(LANDING)!r}, set={SHORT!r}, output="a.h5")
assert all(w.category is navsim.NavsimWarning and w.filename == "<string>" for w in heard), heard
texts = [str(w.message) for w in heard]
assert texts == [found.text for found in made.findings] != [], texts
"""
    done = python(code, tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert [file.name for file in tmp_path.iterdir()] == ["a.h5"]


def test_a_temporary_result_goes_with_its_object_and_a_tree_stays() -> None:
    made = navsim.run(LANDING, set=SHORT)
    path, tree = made.path, made.tree
    assert path.is_file()
    text = repr(made)
    assert str(path) in text
    del made
    assert not path.parent.exists()
    assert np.isfinite(tree["filter/error"].to_numpy()).all()


def test_a_failure_leaves_no_temporary_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(navsim.BadInput):
        navsim.run(LANDING, runs=10**9, keep="all")
    assert not list(tmp_path.iterdir())


def test_calls_from_several_threads_wait_for_each_other(made: navsim.ResultFile) -> None:
    flown: list[navsim.ResultFile] = []
    threads = [threading.Thread(target=lambda: flown.append(navsim.run(LANDING, set=SHORT))) for _ in range(2)]
    usual = sys.getswitchinterval()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sys.getswitchinterval() == usual
    assert len(flown) == 2
    for one in flown:
        same(one.path, made.path)

    def again(*_: object) -> None:
        navsim.run(LANDING, set=SHORT)

    with pytest.raises(navsim.BadInput, match="a study is computed already"):
        navsim.run(LANDING, set=SHORT, progress=again)
    assert navsim.run(LANDING, set=SHORT).kind == "landing"


def test_a_result_shows_what_the_command_line_shows(tmp_path: Path) -> None:
    title = "<script>alert(1)</script> & [bold]"
    requirement = {"what": "rms", "of": "horizontal", "below_m": 50.0}
    settings = SHORT | {"title": title, "requirements": [requirement], "duration_s": 65, "imu.rate_hz": 10}
    made = navsim.run(LANDING, set=settings, output=tmp_path / "a.h5", runs=8)
    shown = command("show", "a.h5", cwd=tmp_path)
    assert made.show().split() == shown.stdout.split()
    assert str(made) == made.show()
    summary = json.loads(command("show", "a.h5", "--json", cwd=tmp_path).stdout)
    assert made.summary == summary
    (verdict,) = made.verdicts
    assert verdict.verdict in ("met", "not met", "undecided")
    assert verdict.limit == 50.0
    page = made._repr_html_()
    assert "<script>" not in page
    assert page.count("<table>") == page.count("</table>") == sum(not isinstance(t, str) for t in made.tables())
    assert all(found.text.split(";")[0].split("<")[0] in page for found in made.findings)
    again = navsim.ResultFile(made.path)
    assert again.show() == made.show()


def test_a_tree_is_what_xarray_opens(made: navsim.ResultFile) -> None:
    with xr.open_datatree(made.path, engine="h5netcdf") as tree, navsim.load(made.path) as loaded:
        assert not loaded["filter/error"].variable._in_memory  # read when it is asked for
        xr.testing.assert_identical(tree, loaded)
        assert loaded["filter/error"].attrs["units"]
        np.testing.assert_array_equal(made["filter/error"], loaded["filter/error"])
        np.testing.assert_array_equal(made["/filter/error"], made["filter/error"])
    with pytest.raises(KeyError, match="did you mean 'filter/error'"):
        made["filter/eror"]


@pytest.mark.parametrize("name", ["xarray", "h5netcdf"])
def test_without_xarray_the_line_to_install_it_is_said(
    name: str, made: navsim.ResultFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    assert navsim.ResultFile(made.path).show()
    with pytest.raises(ModuleNotFoundError, match=r"pip install '\.\[xarray\]'"):
        navsim.load(made.path)


def test_the_import_is_light_and_names_are_found(tmp_path: Path) -> None:
    code = """
import sys
import navsim
heavy = {"numpy", "numba", "h5py", "pydantic", "yaml", "xarray", "typer", "rich", "matplotlib"}
assert not heavy & set(sys.modules)
assert {"run", "sweep", "optimize", "replay", "validate", "load", "schema", "ResultFile"} <= set(dir(navsim))
navsim.NavsimError, navsim.BadInput, navsim.RunFailed
assert not heavy & set(sys.modules)
for name in navsim.__all__:
    assert getattr(navsim, name) is not None
assert "typer" not in sys.modules
try:
    navsim.rnu
except AttributeError as error:
    assert "rnu" in str(error)
else:
    raise SystemExit("found")
"""
    done = python(code, tmp_path)
    assert done.returncode == 0, done.stderr


def test_validate_and_schema_are_those_of_the_command_line(study: Path, tmp_path: Path) -> None:
    assert navsim.schema("sweep") == json.loads(command("schema", "sweep", cwd=tmp_path).stdout)
    whole = navsim.validate(LANDING, set={"pseudolites.s_m": np.float64(321.0)})
    assert whole["pseudolites"]["s_m"] == 321.0
    assert navsim.validate(whole) == whole
    assert navsim.validate(study)["kind"] == "sweep"
    with pytest.raises(navsim.BadInput, match="s_mm"):
        navsim.validate(study, set={"vary.0.key": "pseudolites.s_mm"})


def test_a_result_is_verified_and_handed_to_a_reviewer(made: navsim.ResultFile, tmp_path: Path) -> None:
    """Both as by the command; what differs is told and not raised."""
    told: list[str] = []
    found = navsim.verify(made.path, workers=1, progress=lambda finished, extent, words: told.append(words))
    assert (found.differs, found.incomplete) == (False, False)
    assert found.plain() == json.loads(command("verify", str(made.path), "--json", cwd=tmp_path).stdout)
    files = navsim.evidence(made.path, output=tmp_path / "folder", license="https://example.org/terms")
    assert sorted(files) == sorted(path for path in (tmp_path / "folder").rglob("*") if path.is_file())
    assert "https://example.org/terms" in (tmp_path / "folder" / "ro-crate-metadata.json").read_text()
    changed = tmp_path / "changed.h5"
    shutil.copy(made.path, changed)
    with h5py.File(changed, "r+") as file:
        file["filter/sigma"][..., 0] *= 2
    assert navsim.verify(changed, workers=1).differs
    with pytest.raises(navsim.BadInput, match="checksums are gone"):
        navsim.evidence(changed)


def test_a_log_is_imported_as_by_the_command(tmp_path: Path) -> None:
    log = tmp_path / "log.nmea"
    write_flight(tmp_path, 20.0)
    log.write_text("\n".join(sentences_of(tmp_path / "gnss.csv")) + "\n")
    with pytest.warns(navsim.NavsimWarning, match="inertial samples"):
        done = navsim.import_log(log, output=tmp_path / "here")
    command("import", str(log), "-o", "there", cwd=tmp_path)
    assert {path.name: path.read_bytes() for path in done.files} == (
        {path.name: path.read_bytes() for path in (tmp_path / "there").iterdir()}
    )
    with pytest.raises(navsim.BadInput, match="already; choose another folder"):
        navsim.import_log([log], output=tmp_path / "here")


def test_a_mapping_names_files_from_the_working_folder(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    contents = yaml.safe_load(study.read_text())
    (tmp_path / "base.yaml").write_text((SCENARIOS / "landing_gnss_only.yaml").read_text())
    monkeypatch.chdir(tmp_path)
    assert navsim.sweep(contents | {"base": "base.yaml"}).kind == "sweep"
    with pytest.raises(navsim.BadInput, match=r"absent\.yaml"):
        navsim.sweep(contents | {"base": "absent.yaml"})


def test_a_search_that_is_ended(tmp_path: Path) -> None:
    """It holds what was found; a search by geometry keeps no analyses, and so no folder of partial work."""
    words: list[str] = []

    def told(_: int, extent: int, said: str) -> None:
        assert extent == 0
        words.append(said)
        if "; best " in said:
            raise KeyboardInterrupt

    study = SCENARIOS / "placement_optimum.yaml"
    with pytest.raises(KeyboardInterrupt) as caught:
        navsim.optimize(study, set={"pseudolites": [1]}, output=tmp_path / "a.h5", progress=told)
    assert any("holds what was found" in note for note in caught.value.__notes__)
    assert any("placements tried" in said for said in words)
    found = navsim.ResultFile(tmp_path / "a.h5")
    assert found.kind == "optimize"
    assert np.isfinite(found["pareto/objective"]).any()
    assert found["front/objective"] is not None  # by its former name
    assert not (tmp_path / "a.h5.partial").exists()


def test_the_log_takes_what_is_no_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    kept = tmp_path / "a.h5.partial"

    def told(finished: int, *_: object) -> None:
        if finished >= BATCH:
            raise Enough

    with pytest.raises(Enough):
        navsim.run(LANDING, set=SHORT, runs=2 * BATCH, workers=1, output=tmp_path / "a.h5", progress=told)
    for piece in kept.glob("*.npz"):
        piece.write_bytes(b"damaged")
    with caplog.at_level(logging.INFO, "navsim"):
        navsim.run(LANDING, set=SHORT, runs=2 * BATCH, output=tmp_path / "a.h5")
    assert "damaged piece(s) of an earlier attempt were computed again" in caplog.text


USER = """
from pathlib import Path
import navsim

made: navsim.ResultFile = navsim.run("a.yaml", runs=5, set={"a.b": 1}, method="covariance", output=Path("a.h5"))
text: str = made.show()
first: str = made.findings[0].text
whole: dict[str, object] = navsim.validate({"kind": "landing"})
rms: float = float(made["summary/rms/horizontal"][0])
kind: str = made.tree.attrs["kind"]
try:
    navsim.sweep("b.yaml", progress=lambda finished, extent, words: None)
except navsim.BadInput as error:
    line: int = error.problems[0].line
except navsim.RunFailed as error:
    path: Path | None = error.path
"""
WRONG = """
import navsim
navsim.run("a.yaml", runs="5")
navsim.run("a.yaml", runz=5)
navsim.run("a.yaml", method="dop")
navsim.optimize("a.yaml", first_run=5)
navsim.ResultFile("a.h5").shwo()
"""


def test_mypy_is_content_with_what_a_user_writes(tmp_path: Path) -> None:
    """And finds what is wrong in it."""
    pytest.importorskip("mypy", reason="mypy belongs to the group lint")
    (tmp_path / "right.py").write_text(USER)
    (tmp_path / "wrong.py").write_text(WRONG)
    # with the settings and what `make lint` has kept: to read the package anew takes 20 s
    kept = ("--config-file", ROOT / "pyproject.toml", "--cache-dir", ROOT / ".mypy_cache")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", *kept, "right.py", "wrong.py"],
        cwd=tmp_path,
        env={**os.environ, "MYPYPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=900,
    )
    found = {line.partition(": error")[0] for line in done.stdout.splitlines() if ": error" in line}
    assert found == {f"wrong.py:{n}" for n in (3, 4, 5, 6, 7)}, (done.stdout, done.stderr)
