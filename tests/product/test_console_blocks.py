"""Console blocks of README.md and docs/: each command is run in the order of its page; its output is what is shown.

A block fenced as `console` has commands behind `$ `, each followed by what it says; a line `...` stands for any lines,
`[exit code N]` for an end other than 0. A block fenced as `yaml` whose first line is `# NAME.yaml` is a file that the
reader writes. Each page starts in an empty folder.
"""

from __future__ import annotations

import re
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.forks import found_first, program, shared
from tests.product.test_documented_commands import fresh_copy

DOCS = ROOT / "docs"
_FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
ANY = "..."
BETWEEN = re.compile(r"\d+ of \d+ \w+, \d+ s used|compiling the kernels")
"""How the lines begin that a slow machine, or one at its first start, says in between."""


@dataclass(frozen=True)
class Step:
    """A file to write (name, text), or a command to run with what it says and its exit code."""

    command: str = ""
    says: tuple[str, ...] = ()
    code: int = 0
    file: str = ""
    text: str = ""


def steps(page: str) -> list[Step]:
    """What a page has its reader do."""
    found = []
    for language, body in _FENCE.findall(page):
        if language == "yaml" and (name := re.match(r"# ([\w.-]+\.yaml)\n", body)):
            found.append(Step(file=name[1], text=body))
        if language == "console":
            for one in re.split(r"^\$ ", body, flags=re.MULTILINE)[1:]:
                command, *said = one.rstrip("\n").replace("\\\n", "").split("\n")
                ended = re.fullmatch(r"\[exit code (\d+)\]", said[-1]) if said else None
                found.append(Step(command, tuple(said[:-1] if ended else said), int(ended[1]) if ended else 0))
    return found


def lines(text: str, folder: Path) -> list[str]:
    """What was said, by its words: columns are as wide as their tables need; no empty lines, no path of the folder, no
    progress, nor that kernels are compiled."""
    every = [" ".join(line.split()) for line in text.replace(f"{folder}/", "").splitlines()]
    return [line for line in every if line and not BETWEEN.match(line)]


def fits(said: list[str], shown: list[str]) -> bool:
    """Whether what was said is what is shown, `...` standing for any lines."""
    pattern = "".join(r"(?:.*\n)*" if line == ANY else re.escape(line) + r"\n" for line in shown)
    return re.fullmatch(pattern, "".join(f"{line}\n" for line in said)) is not None


WRITTEN = {
    str(path.relative_to(DOCS) if DOCS in path.parents else path.name): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted(DOCS.rglob("*.md")))
}
_ALL = {page: steps(text) for page, text in WRITTEN.items()}
PAGES = {page: found for page, found in _ALL.items() if any(step.command for step in found)}
"""What pages with commands have their readers do."""


def followed(page: list[Step], folder: Path, clone: Path | None = None) -> Path:
    """Do what a page says, returns the folder in which it was done. clone: whose package is started anew for every
    command; without one they are forks of a process that has all loaded."""
    programs = folder / "bin"
    if clone is None:
        shared().programs(programs)
    else:
        programs.mkdir()
        program(programs / "navsim", "-m", "navsim")
    environment = {**found_first(programs, clone or ROOT), "PYTHONSAFEPATH": "1", "COLUMNS": "130"}
    work = folder / "work"
    work.mkdir()
    for step in page:
        if step.file:
            (work / step.file).write_text(step.text, encoding="utf-8")
            continue
        done = subprocess.run(
            ["bash", "-o", "pipefail", "-c", step.command], cwd=work, env=environment, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        said, shown = lines(done.stdout, work), lines("\n".join(step.says), work)
        assert done.returncode == step.code, f"$ {step.command}\n{done.stdout}"
        assert fits(said, shown), "\n".join([f"$ {step.command}", *said, "--- but the page shows", *shown])
    return work


TUTORIAL = "tutorial.md"
MOST_S = 600.0
"""What the tutorial promises: ten minutes; kernels that have to be compiled are in it."""


DEAR = ("commands.md", "how-to/beacon-verdict.md", "how-to/beacons.md", "how-to/figure.md", "how-to/ranges.md")
"""Pages whose commands other pages and tests run, too, at length or in brief."""


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.long] if page in DEAR else []) for page in PAGES if page != TUTORIAL],
)
def test_commands_say_what_pages_show(page: str, tmp_path: Path) -> None:
    followed(PAGES[page], tmp_path)


@pytest.mark.long
def test_a_newcomer_has_a_placement_map_in_ten_minutes(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    """A first result, one's own runway, a map of placements, a page, by what the tutorial says and nothing else; with
    `--as-written` by the package of a clone, whose commands start and compile as a newcomer's do."""
    clone = tmp_path / "clone" if pytestconfig.getoption("--as-written") else None
    start = time.monotonic()
    if clone is not None:
        fresh_copy(clone)
    work = followed(PAGES[TUTORIAL], tmp_path, clone)
    seconds = time.monotonic() - start
    print(f"{seconds:.0f} s")
    assert seconds < MOST_S
    assert "threshold: {lat_deg: 48.21, lon_deg: 11.35}" in (work / "runway.yaml").read_text()
    for name in (
        "runway.h5",
        "runway_errors.png",
        "placement.h5",
        "placement.csv",
        "placement_pdop.png",
        "runway.html",
        "placement.html",
    ):
        assert (work / "results" / name).stat().st_size > 10_000, name


def test_the_blocks_are_found() -> None:
    """A parser that finds nothing would pass everything."""
    count = {page: sum(bool(step.command) for step in found) for page, found in PAGES.items()}
    assert count == COUNT
    written = sum(len(re.findall(r"^\$ ", text, re.MULTILINE)) for text in WRITTEN.values())
    assert written == sum(count.values())


COUNT = {
    "README.md": 3,
    "commands.md": 13,
    "how-to/beacon-verdict.md": 3,
    "how-to/beacons.md": 7,
    "how-to/compare.md": 4,
    "how-to/figure.md": 4,
    "how-to/jammer.md": 2,
    "how-to/log.md": 3,
    "how-to/pseudolite.md": 2,
    "how-to/ranges.md": 2,
    "how-to/requirement.md": 3,
    "how-to/runway.md": 2,
    "how-to/sensor.md": 2,
    "tutorial.md": 9,
}
"""Commands of each page."""


@pytest.mark.parametrize(
    ("said", "shown", "whole"),
    [
        (["a", "b"], ["a", "b"], True),
        (["a", "b", "c"], ["a", ANY, "c"], True),
        (["a", "c"], ["a", ANY, "c"], True),
        (["a", "b"], ["a"], False),
        (["a", "b"], [ANY, "a"], False),
        (["1.0"], ["1x0"], False),
        ([], ["a"], False),
    ],
)
def test_what_does_not_fit_is_seen(said: list[str], shown: list[str], whole: bool) -> None:
    assert fits(said, shown) == whole


def test_a_wrong_page_fails(tmp_path: Path) -> None:
    """Another output, another exit code: each is found by the same way that pages take."""
    for number, body in enumerate(("$ navsim --version\nnavsim 9.9", "$ navsim --no-such-option")):
        folder = tmp_path / str(number)
        folder.mkdir()
        with pytest.raises(AssertionError, match="navsim"):
            followed(steps(f"```console\n{body}\n```\n"), folder)
