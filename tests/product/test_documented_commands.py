"""Every command of README.md and docs/*.md, run top to bottom as written, in a fresh copy of the tree.

Nothing lies beside the copy. It has what git tracks but for the package: that is the one under test, as an editable
installation has it. `navsim` and `python` are forks of one process that has all loaded: see `tests/forks.py`.

A command that has run at length since its page, its parameters or its scenario changed runs in brief (`BRIEF`), once
however many pages have it; where no later command takes its result its job is opened and not begun. Any other runs as
it is written.
With `--as-written` (part of `make validate`) all do: see `tests/at_length.py`.
"""

from __future__ import annotations

import json
import re
import shlex
import shutil
import signal
import socket
import subprocess
import threading
import time
import urllib.request
from collections.abc import Container, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from navsim.cli import recorded, studies
from navsim.cli import run as run_command
from navsim.cli.main import app
from navsim.formats.export import export
from navsim.results.result import read
from tests import at_length
from tests.conftest import ROOT
from tests.forks import XARRAY, found_first, shared

DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PROGRAMS = ("navsim", "make", "cat", "python")
"""What a line of a code block must start with to be a command."""

MOST, FEW = 10, 4
"""Runs that brief forms have; how many instead of more."""
NO_DEVICE = "serial:///dev/ttyUSB0"
"""There is no receiver at a serial port; the command must get as far as saying so."""
BRIEF = [
    (r"navsim (run|replay|live) (?!.*--figures)", r"navsim \1 --figures none "),
    (r"--figures \S+", "--figures none"),
    (r"(navsim run .*scenarios/(?:landing(?:_smooth)?|s_turn)\.yaml)", r"\1 --set imu.rate_hz=20"),
    (r"runs=20, set={", 'runs=4, set={"imu.rate_hz": 20, '),
    (r"--first-run (\d)0? --runs (\d)0\b", r"--first-run \1 --runs \2"),
    (r"navsim plot", "navsim plot --only errors"),
    (r"navsim live", "navsim live --silence 2 --set duration_s=32 --set imu.rate_hz=20"),
]
"""Patterns of commands and what is run instead in brief."""
HOURS = ("--runs 100000", "--runs 1000")
"""What a cluster is for takes one machine hours: no form runs it, `--dry-run` apart."""
REALTIME = " --realtime"
"""A landing lasts two minutes: with `--as-written` alone."""

INSTALLS = ("make run", "make test", "make site")
"""They install from the network; `make -n` says that the targets are there."""


def code_blocks(text: str) -> list[list[str]]:
    """Blocks of lines, fenced or indented by four columns after a blank line."""
    blocks: list[list[str]] = []
    fenced = inside = False
    before = ""
    for line in text.splitlines():
        if line.startswith("```"):
            fenced = not fenced
            inside = False
        elif fenced or (line.startswith("    ") and (inside or not before.strip())):
            if not inside:
                blocks.append([])
            blocks[-1].append(line if fenced else line[4:])
            inside = True
        elif line.strip():
            inside = False
        before = line
    return blocks


def commands(document: Path) -> list[str]:
    """Shell commands of a document, continuation lines joined; programs in Python are given to python."""
    found = []
    for block in code_blocks(document.read_text(encoding="utf-8")):
        if block[0].startswith("import "):
            found.append(f"python -c {shlex.quote(chr(10).join(block))}")
            continue
        for line in "\n".join(block).replace("\\\n", "").split("\n"):
            if line.split(" ")[0] in PROGRAMS:
                found.append(line)
    return found


WITH_COMMANDS = [path for path in DOCUMENTS if commands(path)]


def fresh_copy(target: Path, *left_out: str) -> None:
    """The files a clone would have, without those of some folders."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in listed.split("\0"):
        source = ROOT / name
        if name and source.is_file() and not name.startswith(left_out):
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, target / name)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def taken(port: int) -> bool:
    """Whether somebody listens for datagrams."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("0.0.0.0", port))
        except OSError:
            return True
        return False


def send_fixes(result: Path, folder: Path, port: int, stop: threading.Event) -> None:
    """A receiver: the NMEA sentences of a result's fixes, as soon as somebody listens."""
    (sentences,) = export(read(result), folder / "sent.h5", ["nmea"])
    lines = sentences.read_text().splitlines()
    while not taken(port) and not stop.is_set():
        time.sleep(0.05)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        for line in lines:
            link.sendto(f"{line}\r\n".encode(), ("127.0.0.1", port))
            time.sleep(0.0005)


def run(
    command: str, tree: Path, place: Path, environment: dict[str, str], ends: ExitStack
) -> subprocess.CompletedProcess[str]:
    """One line by the shell. ends: of what is there until the end of the page."""
    if command.startswith("navsim plan"):
        return look(command, tree, environment)
    if "--scheduler" in command:
        return with_cluster(command, tree, environment, ends)
    stop = threading.Event()
    receiver = None
    udp = re.search(r"udp://0\.0\.0\.0:(\d+)", command)
    if udp:
        port = free_port()
        command = command.replace(udp[0], f"udp://0.0.0.0:{port}")
        result = tree / "results" / "landing.h5"
        receiver = threading.Thread(target=send_fixes, args=(result, place, port, stop))
        receiver.start()
    try:
        return subprocess.run(
            ["bash", "-o", "pipefail", "-c", command],
            cwd=tree, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
        )  # fmt: skip
    finally:
        stop.set()
        if receiver is not None:
            receiver.join()


def with_cluster(
    command: str, tree: Path, environment: dict[str, str], ends: ExitStack
) -> subprocess.CompletedProcess[str]:
    """A command that names a scheduler, by its file or an address, with one that is there until the end of its page."""
    pytest.importorskip("distributed")
    from tests.product.test_cluster import Cluster

    if not (tree / "scheduler.json").exists():
        ends.callback(Cluster(tree).close)
    address = json.loads((tree / "scheduler.json").read_text())["address"]
    return subprocess.run(
        ["bash", "-c", re.sub(r"tcp://\S+", address, command)],
        cwd=tree, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
    )  # fmt: skip


def look(command: str, tree: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """The planner, which lasts until Ctrl-C: its page is asked for once. What ended so is taken for done."""
    words = ["bash", "-c", f"exec {command.partition('#')[0]} --port 0 --no-browser"]
    with subprocess.Popen(
        words, cwd=tree, env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        line = process.stdout.readline()
        if line:
            with urllib.request.urlopen(line.split()[0]) as page:
                assert page.status == 200
            process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    code = 0 if process.returncode == 128 + signal.SIGINT else process.returncode
    return subprocess.CompletedProcess(words, code, line + out, err)


@pytest.fixture
def ends() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def brief(command: str) -> str:
    """The brief form of a command, whose result has the name that the long form gives it."""
    runs = re.search(r"--runs (\d+)", command)
    # few runs leave a requirement undecided, parts of an ensemble lie side by side
    if runs and int(runs[1]) > MOST and not re.search("--require |--first-run ", command):
        scenario = re.search(r"(\w+)\.yaml", command)
        result = f" -o results/{scenario[1]}_runs{runs[1]}.h5" if scenario and " -o " not in command else ""
        command = command.replace(runs[0], f"--runs {FEW}{result}")
    for pattern, instead in BRIEF:
        command = re.sub(pattern, instead, command)
    return command


def form(command: str, done: Container[str], anew: bool = False) -> str:
    """What is run of a command. done: digests of those that have run at length. anew: all run at length."""
    if command.split("#")[0].strip() in INSTALLS:
        return command.replace("make", "make -n", 1)
    again = at_length.digest(command) in done
    if not anew:
        command = command.replace(REALTIME, "")
    if again:
        return brief(command)
    return command if "--dry-run" in command else command.replace(*HOURS)


@pytest.mark.parametrize("document", WITH_COMMANDS, ids=[path.stem for path in WITH_COMMANDS])
def test_commands_run(document: Path, tmp_path: Path, pytestconfig: pytest.Config, ends: ExitStack) -> None:
    tree = tmp_path / "tree"
    fresh_copy(tree, "navsim/", "tests/", "benchmarks/")
    environment = found_first(shared().programs(tmp_path / "bin"))
    if document.stem == "python":
        shared().prepare(modules=XARRAY)
    page = commands(document)
    digests = {at_length.digest(command) for command in page}
    anew = pytestconfig.getoption("--as-written")
    done_at_length = _run_at_length if anew else at_length.stored()
    if anew:
        at_length.store(at_length.stored() - (digests - _run_at_length), every_command())
    for command, again, opens in forms(page, done_at_length, anew):
        done = job_opened(command, tree) if opens else run_once(command, again, tree, tmp_path, environment, ends)
        if NO_DEVICE in command:
            assert done.returncode == 2, command
            assert f"{NO_DEVICE}?baud=921600" in done.stderr
            assert "cannot be opened" in done.stderr
            continue
        assert done.returncode == 0, f"{document.name}: {command}\n{done.stdout}{done.stderr}"
        assert "Traceback" not in done.stderr
        if "udp://" in command:
            (used,) = re.findall(r"messages used +(\d+)", done.stdout)
            sent = 320 if "duration_s=32" in command else 1200
            assert int(used) >= 0.7 * sent  # a datagram may be lost where the machine is busy
    if anew:
        _run_at_length.update(digests)
        at_length.store(at_length.stored() | digests, every_command())


def forms(page: list[str], done: Container[str], anew: bool) -> list[tuple[str, bool, bool]]:
    """What is done of a page, by the commands: whether each has run at length, and whether its job is only opened."""
    taken: list[tuple[str, bool, bool]] = []
    for written in reversed(page):
        again = at_length.digest(written) in done
        command, opens = form(written, done, anew), False
        if again and not anew:
            key = re.sub(r" +# .*", "", command)
            written_to = re.search(r"(?:-o (?:\S+/)?|output=\"results/)(\w+)", command)
            stem = re.search(r"(\w+)\.yaml(?:.* --method (\w+))?", command)
            name = written_to[1] if written_to else "_".join(filter(None, stem.groups())) if stem else ""
            takers = [later for later, *_ in taken if not OPENS.match(later)]
            if not ("init" in command or (name and any(re.search(rf"\b{name}\b", later) for later in takers))):
                if key in _seen:
                    continue
                opens = bool(OPENS.match(command))
            _seen.add(key)
        taken.append((written if opens else command, again, opens))
    return taken[::-1]


OPENS = re.compile(r"navsim (run|sweep|optimize|replay|integrity-table|table2|keys|schema|validate)\b(?!.*--log)")
"""Commands that open a job, or read and print alone."""
_seen: set[str] = set()
"""Commands that have run in brief on this page or an earlier one."""


def job_opened(command: str, tree: Path) -> subprocess.CompletedProcess[str]:
    """A command in this process, whose options, scenario and files are read as ever; if it has a job that does not
    begin."""
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(tree)
        for module in (run_command, studies, recorded):
            patched.setattr(module, "run_job", lambda *_: None)
        done = CliRunner().invoke(app, shlex.split(command, comments=True)[1:])
    return subprocess.CompletedProcess(command, done.exit_code, done.stdout, done.stderr)


SHIPPED_ALONE = re.compile(
    r"navsim (?:table2|integrity-table|(?:run|sweep|optimize)\b.*? scenarios/\w+\.yaml)\b"
    r"(?!.*(?:--scheduler|--dry-run))"
)
"""Commands that take nothing of what earlier ones of their page have written."""


def run_once(
    command: str, again: bool, tree: Path, place: Path, environment: dict[str, str], ends: ExitStack
) -> subprocess.CompletedProcess[str]:
    """One line by the shell. Of one that takes shipped files alone, and has run at length (again): what it did on an
    earlier page, and the files it wrote there, where none of them is here."""
    key = re.sub(r" +# .*", "", command)
    if key in _wrote:
        done, files = _wrote[key]
        if not any((tree / name).exists() for name in files):
            for name, content in files.items():
                (tree / name).parent.mkdir(parents=True, exist_ok=True)
                (tree / name).write_bytes(content)
            return done
    before = _files(tree)
    done = run(command, tree, place, environment, ends)
    after = _files(tree)
    new = after.keys() - before.keys()
    if again and done.returncode == 0 and SHIPPED_ALONE.match(key) and new and before.items() <= after.items():
        _wrote[key] = done, {path.relative_to(tree): path.read_bytes() for path in new}
    return done


def _files(tree: Path) -> dict[Path, int]:
    """When each file was written."""
    return {path: path.stat().st_mtime_ns for path in tree.rglob("*") if path.is_file()}


_wrote: dict[str, tuple[subprocess.CompletedProcess[str], dict[Path, bytes]]] = {}
"""What commands have said, and the files they wrote, by their names."""
_run_at_length: set[str] = set()
"""Digests of commands that this process has run as they are written, on pages that passed."""


def every_command() -> list[str]:
    return [command for document in WITH_COMMANDS for command in commands(document)]


def test_what_has_not_run_at_length_runs_as_written() -> None:
    every = every_command()
    done = {at_length.digest(command) for command in every}
    asked = [command for command in every if command.split("#")[0].strip() not in INSTALLS]
    assert [command for command in asked if form(command, (), anew=True) != command] == [
        command for command in asked if "--scheduler s" in command
    ]
    assert all(form(command, ()) == form(command, (), anew=True).replace(REALTIME, "") for command in asked)
    brief_forms = [form(command, done) for command in asked]
    assert not [one for one in brief_forms if re.search(r"--runs \d{3}(?!.*--require)|--realtime", one)]
    for one, short in zip(asked, brief_forms, strict=True):
        verb, also = (re.findall(r"navsim \S+", text) for text in (one, short))
        assert verb[:1] == also[:1]
    longer = [command.replace("--runs 1000", "--runs 1001") for command in asked]
    changed = [new for old, new in zip(asked, longer, strict=True) if old != new and "--dry-run" not in new]
    assert len(changed) >= 4
    assert all(form(command, done) == command.replace(*HOURS) for command in changed)


def test_there_are_commands_to_run() -> None:
    """The extraction finds what a reader sees; a document with a command is not passed over."""
    found = {path.stem: commands(path) for path in WITH_COMMANDS}
    assert [command.split("#")[0].strip() for command in found["README"]] == ["make run", "make test"]
    assert any("sky.almanac" in command and "epoch=" in command for command in found["landing"])  # joined lines
    assert any(command.startswith("python -c 'import xarray") for command in found["python"])
    for path in DOCUMENTS:
        seen = len(re.findall(r"^    (?:cat .*\| )?navsim ", path.read_text(encoding="utf-8"), re.MULTILINE))
        assert seen == sum("navsim " in command for command in commands(path) if "python" not in command), path


def test_options_named_in_running_text_exist() -> None:
    """`navsim COMMAND --option` within a sentence names commands and options that are there."""
    known = {name: {o for p in c.params for o in p.opts} for name, c in typer.main.get_command(app).commands.items()}
    checked = 0
    for path in DOCUMENTS:
        for code in re.findall(r"`navsim ([^`]+)`", path.read_text(encoding="utf-8")):
            words = code.split()
            if words[0].startswith("-"):
                continue
            assert words[0] in known, f"{path.name}: navsim {code}"
            for option in (word for word in words[1:] if word.startswith("-")):
                assert option in known[words[0]], f"{path.name}: navsim {code}"
            checked += 1
    assert checked >= 5
