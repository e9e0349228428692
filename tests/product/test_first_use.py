"""What a newcomer meets: names of results, figures that belong to them, files of the wrong kind, help, templates."""

from __future__ import annotations

import contextlib
import gzip
import os
import re
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner, Result

from navsim.cli import run as run_command
from navsim.cli import studies
from navsim.cli.main import app
from navsim.formats.almanac import read_almanac
from navsim.gnss import timescales
from navsim.gnss.constellations import glonass, gps
from navsim.kinds import KINDS, OF_FILES, named
from navsim.report import figures as landing_figures
from navsim.report import printing as drawing
from navsim.results.result import ONE_RUN, SEVERAL_RUNS, ResultKind, read, read_kind
from navsim.scenario.landing import Landing
from navsim.scenario_files import shipped
from navsim.scenario_files.source import InputError, load
from navsim.sweeps.scenario import Sweep
from tests.conftest import ROOT, SCENARIOS
from tests.helpers import case, scenario
from tests.layout import as_declared

BRIEF = ("--set", "duration_s=2", "--set", "receiver.rate_hz=2", "--set", "imu.rate_hz=20")
LANDING = SCENARIOS / "landing.yaml"
LIMITS = "integrity={method: chi2, limits: {hal_m: 40, val_m: 60, tta_s: 2}}"
SWEEP = """
kind: sweep
version: 1
base: landing_gnss_only.yaml
set: {pseudolites.frame: runway, pseudolites.count: 1, duration_s: 20, receiver.rate_hz: 1}
vary:
  - {key: pseudolites.s_m, values: [200, 400]}
  - {key: pseudolites.l1_m, values: [1000, 2000]}
"""


def navsim(*arguments: object, cwd: Path, code: int = 0) -> Result:
    """The command within this process, which spares the start of Python."""
    with contextlib.chdir(cwd):
        done = CliRunner().invoke(app, list(map(str, arguments)), prog_name="navsim", env={"COLUMNS": "120"}, input="")
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == code, done.output
    return done


# --- results and their figures


def test_results_of_one_scenario_have_names_of_their_own(tmp_path: Path) -> None:
    """One run, ensembles and covariance analyses of a scenario stand beside each other, as the README makes them."""
    for options in ((), ("--runs", 2), ("--method", "covariance"), ("--until", "rms_horizontal within 900%")):
        navsim("run", LANDING, *BRIEF, "--figures", "none", "-q", *options, cwd=tmp_path)
    assert {path.name: read_kind(path) for path in (tmp_path / "results").glob("*.h5")} == {
        "landing.h5": ResultKind("landing", "monte-carlo", ONE_RUN),
        "landing_runs2.h5": ResultKind("landing", "monte-carlo", SEVERAL_RUNS),
        "landing_covariance.h5": ResultKind("landing", "covariance"),
        "landing_until.h5": ResultKind("landing", "monte-carlo", SEVERAL_RUNS),
    }
    said = navsim("live", LANDING, *BRIEF, "--receiver", "-", cwd=tmp_path, code=3).stdout
    assert "results/landing_live.h5" in said


def test_a_method_of_the_scenario_itself_needs_no_name(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text(LANDING.read_text() + "method: covariance\n")
    navsim("run", own, *BRIEF, "-q", cwd=tmp_path)
    navsim("run", own, *BRIEF, "-q", "--method", "covariance", cwd=tmp_path)
    navsim("run", own, *BRIEF, "-q", "--method", "monte-carlo", cwd=tmp_path)
    assert sorted(p.name for p in (tmp_path / "results").iterdir()) == ["mine.h5", "mine_monte-carlo.h5"]


def test_a_file_may_be_right_only_under_the_method_given(tmp_path: Path) -> None:
    """A smoother has no covariance analysis; the file asks for one, the command line for a run."""
    own = tmp_path / "mine.yaml"
    own.write_text(LANDING.read_text() + "method: covariance\n")
    own.write_text(own.read_text().replace("kind: gaussian-sum", "kind: rts"))
    assert "smoother" in navsim("run", own, *BRIEF, "-q", cwd=tmp_path, code=2).stderr
    navsim("run", own, *BRIEF, "-q", "--method", "monte-carlo", cwd=tmp_path)
    foreign = navsim("run", SCENARIOS / "mls_elevation.yaml", "--method", "covariance", cwd=tmp_path, code=2)
    assert "--method: only for `kind: landing`" in foreign.stderr


def test_fewer_runs_do_not_replace_more(tmp_path: Path) -> None:
    run = ("run", LANDING, *BRIEF, "-q", "-o", "r.h5", "--figures", "none", "--runs")
    navsim(*run, 3, cwd=tmp_path)
    assert "holds 3 runs, which 2 would replace" in navsim(*run, 2, cwd=tmp_path, code=2).stderr
    navsim(*run, 3, cwd=tmp_path)
    navsim(*run, 2, "--force", cwd=tmp_path)


def test_nor_do_those_that_are_found_to_be_enough(tmp_path: Path) -> None:
    """Their number is known when they are flown: they are kept, and written once that is asked for."""
    run = ("run", LANDING, *BRIEF, "-o", "r.h5", "--figures", "none")
    navsim(*run, "-q", "--runs", 40, cwd=tmp_path)
    before = (tmp_path / "r.h5").read_bytes()
    until = (*run, "--until", "rms_horizontal within 20%")
    refused = navsim(*until, cwd=tmp_path, code=3).stderr
    assert "holds 40 runs, which 32 would replace; choose another -o/--output" in refused
    assert "finished runs are kept in r.h5.partial; move r.h5 away, or give --force: the same command" in refused
    assert (tmp_path / "r.h5").read_bytes() == before
    navsim(*until, "--force", cwd=tmp_path)
    assert read_kind(tmp_path / "r.h5").count == 32
    navsim(*until, cwd=tmp_path)


def test_every_command_refuses_results_of_other_kinds(tmp_path: Path) -> None:
    """run, sweep, optimize, replay, live, table2 and integrity-table share one check, one message and one way out."""
    navsim("run", LANDING, *BRIEF, "-q", "-o", "r.h5", cwd=tmp_path)
    (tmp_path / "table2").mkdir()
    shutil.copy(tmp_path / "r.h5", tmp_path / "table2" / "table2.h5")
    study = tmp_path / "study.yaml"
    study.write_text(SWEEP.replace("landing_gnss_only.yaml", str(SCENARIOS / "landing_gnss_only.yaml")))
    for command in (
        ("run", SCENARIOS / "mls_elevation.yaml", "-o", "r.h5"),
        ("sweep", study, "-o", "r.h5"),
        ("optimize", SCENARIOS / "placement_optimum.yaml", "-o", "r.h5"),
        ("replay", SCENARIOS / "recorded_flight.yaml", "-o", "r.h5"),
        ("live", LANDING, *BRIEF, "--receiver", "-", "-o", "r.h5"),
        ("table2", "--runs", 1, "-o", "table2"),
        ("integrity-table", "--set", LIMITS, "-o", "r.h5"),
    ):
        refused = navsim(*command, cwd=tmp_path, code=2)
        assert "kind landing, method monte-carlo, one run" in refused.stderr, command
        assert "--force" in refused.stderr
    navsim("sweep", study, "-q", "-o", "s.h5", cwd=tmp_path)
    refused = navsim("sweep", study, "-q", "-o", "s.h5", "--method", "covariance", cwd=tmp_path, code=2)
    assert "kind sweep, method dop" in refused.stderr
    assert "kind sweep, method covariance" in refused.stderr
    navsim("sweep", study, "-q", "--method", "covariance", cwd=tmp_path)
    assert read_kind(tmp_path / "results" / "study_covariance.h5") == ResultKind("sweep", "covariance")


def test_what_is_no_result_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "letter.h5").write_text("to my aunt")
    navsim("run", LANDING, *BRIEF, "-q", "-o", "letter.h5", "--force", cwd=tmp_path, code=2)
    assert (tmp_path / "letter.h5").read_text() == "to my aunt"


def figures(folder: Path) -> set[str]:
    return {path.name for path in folder.glob("*.png")}


def test_figures_go_with_their_result(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of a result that is replaced are removed, also when the new one has none; other files never."""
    monkeypatch.setitem(drawing.STYLE, "savefig.dpi", 30.0)
    monkeypatch.setattr(landing_figures, "_SUMMARY_FIGURES", {})
    run = ("run", LANDING, *BRIEF, "-o", "r.h5")
    navsim(*run, cwd=tmp_path)
    own = figures(tmp_path)
    assert "r_errors.png" in own
    navsim("run", LANDING, *BRIEF, "-o", "r_wide.h5", "--figures", "none", cwd=tmp_path)
    navsim("plot", "r_wide.h5", "--only", "errors", "--figures", ".", cwd=tmp_path)
    wide = figures(tmp_path) - own
    assert "r_wide_errors.png" in wide
    Image.new("RGB", (8, 8)).save(tmp_path / "r_photo.png")
    (tmp_path / "r_note.png").write_text("no picture")
    # a picture too large to open, and one cut off: neither ends a run that is finished
    huge = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    (tmp_path / "r_huge.png").write_bytes(huge + struct.pack(">I", zlib.crc32(huge[12:])))
    (tmp_path / "r_cut.png").write_bytes(huge[:20])
    os.mkfifo(tmp_path / "r_pipe.png")
    mine = {"r_photo.png", "r_note.png", "r_huge.png", "r_cut.png", "r_pipe.png"}

    navsim(*run, "--method", "covariance", "--force", cwd=tmp_path)
    now = figures(tmp_path) - wide - mine
    assert "r_budget.png" in now
    assert "r_fixes.png" in own
    assert "r_fixes.png" not in now

    navsim(*run, "--runs", 2, "--force", cwd=tmp_path)
    assert figures(tmp_path) == wide | mine

    navsim(*run, "--force", "--figures", "drawn", cwd=tmp_path)
    assert figures(tmp_path) == wide | mine
    assert figures(tmp_path / "drawn") == own


# --- files of the wrong kind


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result and a file of every kind."""
    folder = tmp_path_factory.mktemp("files")
    navsim("run", LANDING, *BRIEF, "-q", "-o", "x.h5", cwd=folder)
    return folder


@pytest.mark.parametrize("command", ["show", "plot", "export", "report", "cite"])
@pytest.mark.parametrize("template", ["landing_smooth", "recorded_flight"])
def test_results_are_wanted(command: str, template: str, files: Path) -> None:
    file = SCENARIOS / f"{template}.yaml"
    extra = ("--kml",) if command == "export" else ()
    said = navsim(command, file, *extra, cwd=files, code=2).stderr
    kind = shipped.kind(template)
    assert f"{file}: is not a result" in said
    assert f"kind {kind}: use navsim {KINDS[kind].command} {file} or navsim validate {file}" in said
    made = Path("results", f"{template}.h5")
    assert (f"; its result is {made}" in said) is (files / made).is_file()


@pytest.mark.parametrize("command", ["run", "sweep", "optimize", "replay", "live", "integrity-table", "validate"])
def test_scenarios_are_wanted(command: str, files: Path) -> None:
    extra = ("--receiver", "-") if command == "live" else ()
    said = navsim(command, "x.h5", *extra, cwd=files, code=2).stderr
    assert "x.h5: is a result, not a scenario: use navsim show x.h5 or navsim plot x.h5" in said


def test_a_table_is_no_log_file(tmp_path: Path) -> None:
    (tmp_path / "gnss.csv").write_text("t_s,lat_deg\n0,48\n")
    with pytest.raises(InputError, match=r"gnss\.csv: is a table, not a scenario\. A log file names it"):
        load(tmp_path / "gnss.csv")


def test_a_kind_that_is_a_list_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.yaml").write_text("kind: [landing]\nversion: 1\n")
    for command in (("run", "x.yaml"), ("run", "x.yaml", "--method", "covariance"), ("show", "x.yaml")):
        assert "x.yaml" in navsim(*command, cwd=tmp_path, code=2).stderr


TAKES = {
    "run": {"landing", "mls-elevation", "atc-tracking", "azimuth-tracking"},
    "sweep": {"sweep"},
    "optimize": {"optimize"},
    "replay": {"replay", "ranges"},
    "live": {"landing"},
    "integrity-table": {"landing"},
}


@pytest.mark.parametrize("command", TAKES)
@pytest.mark.parametrize(
    "template", ["landing", "mls_elevation", "placement_sweep", "placement_optimum", "recorded_flight"]
)
def test_files_are_sent_to_their_command(command: str, template: str, files: Path) -> None:
    kind = shipped.kind(template)
    if kind in TAKES[command]:
        return
    file = SCENARIOS / f"{template}.yaml"
    extra = ("--receiver", "-") if command == "live" else ()
    said = navsim(command, file, *extra, cwd=files, code=2).stderr
    assert f"use navsim {KINDS[kind].command} {file}" in said
    assert all(f"`kind: {wanted}`" in said for wanted in TAKES[command])


# --- help

COMMAND_NAMES = (
    "run", "table2", "integrity-table", "sweep", "optimize", "replay", "live", "show", "plot", "export", "validate",
    "schema", "init", "report", "cite", "keys", "variables", "resume",
)  # fmt: skip


def help_of(command: str) -> str:
    return " ".join(navsim(command, "--help", cwd=Path()).stdout.split())


@pytest.mark.parametrize("command", COMMAND_NAMES)
def test_help_says_what_is_true_of_the_command(command: str) -> None:
    text = help_of(command)
    for odd in ("<bool>", "<int", "<float", "stdout"):
        assert odd not in text
    reads = {"sweep": "study", "optimize": "study", "replay": "log"}.get(command, "scenario")
    for noun in {"scenario", "study", "log"} - {reads}:
        assert f"<{noun} stem>" not in text
        assert f"key of the {noun}" not in text
    if command not in ("run", "live"):
        assert "scenario stem" not in text
    if command not in ("run", "resume"):
        assert "several runs" not in text


def test_help_lists_choices() -> None:
    assert "<errors|all|none>" in help_of("run")
    assert "<monte-carlo|covariance|rare>" in help_of("run")
    assert "<dop|covariance|monte-carlo>" in help_of("sweep")
    assert ", ".join(OF_FILES) in help_of("schema")
    assert ", ".join(shipped.names()) in help_of("init")


def test_choices_are_those_of_the_scenarios() -> None:
    """The command line imports no scenario classes for its help; what it lists must stay what they allow."""
    assert get_args(run_command.Method) == get_args(Landing.model_fields["method"].annotation)
    assert get_args(studies.SweepMethod) == get_args(Sweep.model_fields["method"].annotation)


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_list_of_kinds_names_is_there(kind: str) -> None:
    from navsim.report.view import View
    from navsim.scenario_files.base import Section

    here = KINDS[kind]
    assert isinstance(named(here.view), View)
    assert here.job or not here.section
    if here.section:
        section = named(here.section)
        assert issubclass(section, Section)
        assert get_args(section.model_fields["kind"].annotation) == (kind,)
        assert callable(named(here.job))


def test_version(tmp_path: Path) -> None:
    for option in ("-V", "--version"):
        assert re.fullmatch(r"navsim \d+\.\d+\.\d+\n", navsim(option, cwd=tmp_path).stdout)


# --- templates


def test_init_starts_with_a_landing_under_the_open_sky(tmp_path: Path) -> None:
    """What an aircraft can fly, with ranging errors that last."""
    said = navsim("init", cwd=tmp_path).stdout
    assert said == "landing_open_sky.yaml written; go on with: navsim run landing_open_sky.yaml\n"
    assert (tmp_path / "landing_open_sky.yaml").read_text() == (SCENARIOS / "landing_open_sky.yaml").read_text()
    first, smooth = (scenario(name=name) for name in ("landing_open_sky", "landing_smooth"))
    assert first.signals.preset == "open-sky"
    assert first.model_copy(update={"signals": smooth.signals, "title": smooth.title}) == smooth


DRY = ("landing_smooth", "recorded_flight")
"""Of sweeps and searches the documented commands have one."""


@pytest.mark.parametrize("template", shipped.names())
def test_what_init_writes_runs_in_an_empty_folder(template: str, tmp_path: Path) -> None:
    """Bases of studies and recordings come along."""
    said = navsim("init", template, "-o", "mine.yaml", cwd=tmp_path).stdout
    command = said.split("go on with: navsim ")[1].split()[0]
    few = [part for axis in (1, 2) for part in ("--set", f"vary.{axis}.grid.count=3")]
    navsim("validate", "mine.yaml", *(few if template == "placement_sweep" else ()), cwd=tmp_path)
    if template in DRY:
        navsim(command, "mine.yaml", "--dry-run", cwd=tmp_path)
    for name in shipped.needs(template):
        assert (tmp_path / name).read_bytes() == (SCENARIOS / name).read_bytes()
        assert name in said
    assert "\t" not in (tmp_path / "mine.yaml").read_text()


def test_init_leaves_other_files_alone(tmp_path: Path) -> None:
    base = tmp_path / "landing_gnss_only.yaml"
    base.write_text((SCENARIOS / base.name).read_text() + "# mine\n")
    done = navsim("init", "placement_sweep", cwd=tmp_path)
    assert "landing_gnss_only.yaml differs from the shipped file; navsim keeps it" in done.stderr
    assert base.read_text().endswith("# mine\n")
    again = navsim("init", "placement_sweep", cwd=tmp_path, code=2)
    assert "exists already" in again.stderr
    navsim("init", "placement_optimum", "-o", "nowhere/deeper/x.yaml", cwd=tmp_path, code=2)


# --- data beside the templates


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the script makes today."""
    folder = tmp_path_factory.mktemp("data")
    subprocess.run([sys.executable, ROOT / "scripts" / "make_shipped_data.py", folder], cwd=ROOT, check=True)
    return folder


def numbers(file: Path) -> np.ndarray:
    """All numbers of a text file, plain or gzip."""
    raw = file.read_bytes()
    text = (gzip.decompress(raw) if file.suffix == ".gz" else raw).decode().replace("D+", "E+").replace("D-", "E-")
    return np.array(re.findall(r"[-+]?\d+\.?\d*(?:E[-+]\d+)?", text), dtype=float)


def test_shipped_data_are_what_the_script_makes(made: Path) -> None:
    shipped_files = sorted(path.name for path in (SCENARIOS / "data").iterdir())
    assert shipped_files == sorted(path.name for path in made.iterdir())
    for name in shipped_files:
        ours, theirs = numbers(SCENARIOS / "data" / name), numbers(made / name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-4, err_msg=name)  # a last digit may differ
    assert sum((SCENARIOS / "data" / name).stat().st_size for name in shipped_files) < 300_000


def test_shipped_almanacs_and_messages_are_the_nominal_sky() -> None:
    """GPS exactly; GLONASS to the short-period terms that only the almanac's algorithm has, 3 km of 25 500."""
    noon = timescales.posix(2018, 9, 13) + 43200.0
    time = timescales.gps_from_utc(noon + np.arange(-3600.0, 3601.0, 900.0))
    for name, nominal, limit in (
        ("nominal.agl", glonass.Glonass24Slots(), 3e3),
        ("nominal.alm", gps.nominal(noon), 0.1),
    ):
        almanac = read_almanac(SCENARIOS / "data" / name, noon).constellations[0]
        assert almanac.names == nominal.names
        off = np.linalg.norm(almanac.state(time)[0] - nominal.state(time)[0], axis=-1)
        assert off.max() < limit, name


@pytest.mark.parametrize(
    "settings",
    [
        ("sky.source=almanac", "sky.almanac=data/nominal.agl"),
        ("sky.source=almanac", "sky.almanac=[data/nominal.agl, data/nominal.alm]"),
        ("sky.source=navigation", "sky.navigation=data/nominal.rnx"),
    ],
)
def test_landings_fly_under_the_shipped_skies(settings: tuple[str, ...]) -> None:
    """The same satellites are seen as under the nominal constellation they were made from, and nothing is warned of."""
    with contextlib.chdir(SCENARIOS):
        real = case(*settings, "receiver.rate_hz=1")
    source = "nominal-glonass" if settings[1] == "sky.almanac=data/nominal.agl" else "nominal"
    made = case(f"sky.source={source}", "receiver.rate_hz=1")
    assert real.warnings == made.warnings
    assert sorted(real.shared.signals.names) == sorted(made.shared.signals.names)
    np.testing.assert_allclose(real.shared.dop[:, 1], made.shared.dop[:, 1], rtol=1e-3)


def test_the_shipped_flight_shows_what_was_put_into_it(tmp_path: Path) -> None:
    """Its latency is found, its innovations are as large as believed, and it aligns by itself."""
    brief = ("--set", "outages=[]", "--set", "filter.output_rate_hz=2")
    navsim("replay", SCENARIOS / "recorded_flight.yaml", *brief, "-q", "-o", "f.h5", cwd=tmp_path)
    flown = read(tmp_path / "f.h5")
    as_declared(flown)
    assert flown["/summary/nis"][:2] == pytest.approx(1.0, abs=0.15)
    assert float(flown["/tuning/latency"]) == pytest.approx(0.1, abs=0.02)
