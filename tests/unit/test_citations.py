"""What is cited is there: pages with their sections and equations, links of pages, numbered sources of modules.

A citation of a page names it from the root of the tree, or beside the file that cites it: `docs/theory/landing.md`,
sections 2, 3; `docs/theory/landing.md`, eq. (13); `docs/landing.md`, "Reading the result". Equations are numbered by
`\\tag{13}` in a block of LaTeX.
"""

from __future__ import annotations

import ast
import os
import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.unit.test_reference import script

FOLDERS = ("navsim", "tests", "scripts", "benchmarks")
SOURCES = sorted(p for folder in FOLDERS for p in (ROOT / folder).rglob("*.py"))
THEORY = sorted((ROOT / "docs" / "theory").glob("*.md"))
REFERENCE = ROOT / "docs" / "reference"
"""Pages that the schemas make with the site: they are read as they are made, whether there is a site or not."""
PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md")),
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if not path.is_relative_to(REFERENCE)),
]
"""Those of the tree."""


@cache
def generated() -> dict[Path, str]:
    return {REFERENCE / name: text for name, text in script("reference").pages().items()}


_LINK = re.compile(r"!?\[([^\]\n]*)\]\(([^)\s]+)(?: \"([^\"]*)\")?\)")
_NUMBERS = r"\(?\d+\)?(?:(?:,|\s+to|\s+and)\s+\(?\d+\)?)*"
_CITED = re.compile(
    r"(?P<page>[\w./*-]+\.md)`?"
    rf"(?:,?\s+(?:sections?\s+(?P<sections>{_NUMBERS})|eqs?\.\s+(?P<equations>{_NUMBERS}))|,\s+\"(?P<heading>[^\"]+)\")?"
)
_SOURCE_NUMBER = re.compile(r"(?<![\w\])`])\[(\d+)\](?!\w|\[|\()")
_EQUATION = re.compile(r"\\tag\{(\d+)\}")


@dataclass(frozen=True)
class Page:
    """What of a page can be cited."""

    headings: frozenset[str]
    anchors: frozenset[str]
    sections: frozenset[int]
    equations: tuple[int, ...]


def text_of(path: Path) -> str:
    """The text of a page."""
    return generated()[path] if path in generated() else path.read_text(encoding="utf-8")


@cache
def page(path: Path) -> Page:
    """The page at a path."""
    text = text_of(path)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return Page(
        frozenset(headings),
        frozenset(re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings),
        frozenset(int(m[1]) for h in headings if (m := re.match(r"(\d+)\. ", h))),
        tuple(int(n) for n in _EQUATION.findall(text)),
    )


_CITES = re.compile(rb"\.md|(?<![\w\])`])\[\d+\](?!\w|\[|\()")
_CITING_COMMENT = re.compile(rb"#.*(?:%b)" % _CITES.pattern)
"""A line whose comment, or what looks like one, cites."""


@cache
def remarks(path: Path) -> tuple[str, ...]:
    """Docstrings of a module, of what it has and of its constants, and its comments, neighbouring lines as one.

    Nothing of a module that names neither a page nor a number of a source: to read all would take seconds.
    """
    return tuple(_remarks(path)) if _CITES.search(path.read_bytes()) else ()


def _remarks(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.value.value
    if not _CITING_COMMENT.search(path.read_bytes()):
        return
    block: list[str] = []
    line = 0
    with open(path, "rb") as file:
        for token in tokenize.tokenize(file.readline):
            if token.type == tokenize.COMMENT:
                if token.start[0] != line + 1:
                    yield " ".join(block)
                    block = []
                block.append(token.string.lstrip("# "))
                line = token.start[0]
    yield " ".join(block)


def _numbers(text: str) -> set[int]:
    """The numbers of "2, 3", "(5) to (8)", "2 and 4"."""
    out: set[int] = set()
    for first, last in re.findall(r"\(?(\d+)\)?(?:\s+to\s+\(?(\d+)\)?)?", text):
        out |= set(range(int(first), int(last or first) + 1))
    return out


def missing(text: str, folder: Path) -> tuple[int, list[str]]:
    """How many citations of pages a text in a file of this folder has, and which of them lead nowhere."""
    count, out = 0, []
    # a link is the citation of what it leads to
    for found in _CITED.finditer(_LINK.sub(lambda m: re.sub(r"#.*", "", m[2]), text)):
        if "*" in found["page"] or "//" in found["page"]:
            continue
        count += 1
        places = [Path(os.path.normpath(base / found["page"])) for base in (ROOT, folder)]
        target = next((p for p in places if p.is_file() or p in generated()), None)
        if target is None:
            out.append(f"{found[0]}: no such page")
            continue
        here = page(target)
        lost = _numbers(found["sections"] or "") - here.sections
        lost |= _numbers(found["equations"] or "") - set(here.equations)
        if lost or (found["heading"] and " ".join(found["heading"].split()) not in here.headings):
            out.append(f"{found[0]}: not on that page")
    return count, out


def test_pages_cited_by_code_are_there() -> None:
    """Every citation of a page in a docstring or comment resolves, down to its section and equation."""
    cited, lost = 0, []
    for path in SOURCES:
        if path == Path(__file__):
            continue
        for text in remarks(path):
            count, wrong = missing(text, path.parent)
            cited += count
            lost += [f"{path.relative_to(ROOT)}: {w}" for w in wrong]
    assert not lost, "\n".join(lost)
    assert cited > 40


def dead_links(path: Path, text: str) -> list[str]:
    """Links of a page that lead nowhere in a clone, where the pages that the site's build writes are not.

    Links to these go to a page of the clone; their title, by which the site replaces it, must be one of these.
    """
    out = []
    for _, link, title in _LINK.findall(text):
        if re.match(r"https?:|mailto:", link):
            continue
        file, _, anchor = link.partition("#")
        there = Path(os.path.normpath(path.parent / file)) if file else path
        is_built = there in generated()
        there_for_readers = there.exists() or is_built if path in generated() else there.exists() and not is_built
        if not there_for_readers or (anchor and anchor not in page(there).anchors):
            out.append(f"a link to {link}")
        if title.startswith("reference/"):
            file, _, anchor = title.partition("#")
            built = Path(os.path.normpath(there.parent / file))
            if built not in generated() or (anchor and anchor not in page(built).anchors):
                out.append(f"a link to {title} of the site")
    return out


@pytest.mark.parametrize("path", [*PAGES, REFERENCE], ids=lambda p: str(p.relative_to(ROOT)))
def test_pages_lead_somewhere(path: Path) -> None:
    """Links of a page, with their anchors, and pages it names. Pages that the schemas make are one case."""
    lost = []
    for one in generated() if path == REFERENCE else [path]:
        text = text_of(one)
        lost += [f"{one.name}: {wrong}" for wrong in (*missing(text, one.parent)[1], *dead_links(one, text))]
    assert not lost, "\n".join(lost)


def test_dead_links_of_a_clone_are_found() -> None:
    """A page of the reference exists in the site alone."""
    text = "[a](reference/landing.md) [b](nowhere.md) [c](index.md#nowhere) [d](https://example.org/x.md) "
    text += '[e](keys-and-variables.md "reference/landing.md") [f](keys-and-variables.md "reference/nowhere.md")'
    expected = ["reference/landing.md", "nowhere.md", "index.md#nowhere", "reference/nowhere.md of the site"]
    assert dead_links(ROOT / "docs/page.md", text) == [f"a link to {link}" for link in expected]


_USERS = "results"
"""A room, and the folder of users' results: of these pages name other files."""
_ROOMS = "|".join(sorted(p.parent.name for p in (ROOT / "navsim").glob("*/__init__.py")))
_MODULE = re.compile(rf"`(?:navsim/)?((?:{_ROOMS})/[\w/]+)(\.py)?(?:\.(\w+))?`")


def lost_modules(text: str) -> list[str]:
    """Modules that a text names, and names in them, that are not there."""
    out = []
    for whole, suffix, name in _MODULE.findall(text):
        file = ROOT / "navsim" / f"{whole}.py"
        folder = file.with_suffix("") / "__init__.py"
        if not (file.is_file() or folder.is_file()):
            if suffix or not whole.startswith(f"{_USERS}/"):
                out.append(whole)
        elif name and not re.search(rf"\b{name}\b", (file if file.is_file() else folder).read_text()):
            out.append(f"{whole}.{name}")
    return out


def test_modules_named_by_pages_are_there() -> None:
    # the former names of the changelog are history
    pages = [page for page in (*PAGES, *generated()) if page.name != "CHANGELOG.md"]
    found = {str(page.relative_to(ROOT)): lost_modules(text_of(page)) for page in pages}
    assert {page: lost for page, lost in found.items() if lost} == {}
    assert lost_modules("`filter/nothing.py`, `compiler/jit.no_such`, `compiler/jit.kernel`") == [
        "filter/nothing",
        "compiler/jit.no_such",
    ]


@pytest.mark.parametrize("path", THEORY, ids=lambda p: p.name)
def test_equations_are_numbered_in_order_and_referred_to(path: Path) -> None:
    """Equations of a page of theory count from 1, and what its sentences refer to is one of them."""
    assert page(path).equations == tuple(range(1, 1 + len(page(path).equations)))
    text = re.sub(r"```math.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    prose = "\n".join(x for x in text.splitlines() if not x.startswith(("    ", "|")))
    prose = re.sub(rf"equations? {_NUMBERS}", "", _CITED.sub("", _LINK.sub(lambda m: m[2], prose)))
    wanted = {int(n) for n in re.findall(r"(?<!\w)\((\d{1,2})\)", prose)}
    assert wanted <= set(page(path).equations), wanted - set(page(path).equations)


def forges_refuse(text: str) -> list[str]:
    """Formulas that GitHub shows otherwise than the site does: it refuses some macros, and its Markdown takes the
    backslash before punctuation away within a line (https://github.com/github/markup/issues/1688)."""
    blocks = re.split(r"(^```.*?^```$)", text, flags=re.S | re.M)
    within = re.findall(r"(?<!`)\$(?!\s)[^$\n`]+\$", re.sub(r"`[^`\n]*`", "", "".join(blocks[::2])))
    return [
        *re.findall(r"\\(?:operatorname|def|newcommand)\b", text),
        *(one for one in within if re.search(r"\\[!-/:-@\[-`{-~]", one)),
    ]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_forges_show_the_formulas_of_pages(path: Path) -> None:
    assert not forges_refuse(path.read_text())


def test_formulas_that_forges_refuse_are_found() -> None:
    assert forges_refuse(r"so $a\, b$ and $\operatorname{tr} P$") == [r"\operatorname", r"$a\, b$"]
    assert not forges_refuse("`\\,` is $a\\thinspace b$\n```math\na\\, b\n```\n")


def test_every_page_of_theory_is_cited_by_code() -> None:
    """None of them is there for its own sake."""
    text = "\n".join(remark for path in SOURCES if path.is_relative_to(ROOT / "navsim") for remark in remarks(path))
    assert THEORY
    for path in THEORY:
        assert f"docs/theory/{path.name}" in text, path.name


def unlisted(path: Path) -> set[int]:
    """Numbers of sources that a module's docstrings and comments use and its list of sources has not."""
    if not remarks(path):
        return set()
    module = ast.get_docstring(ast.parse(path.read_bytes()), clean=False) or ""
    head, _, listed = module.partition("Source")
    used = {int(n) for text in (head, *(t for t in remarks(path) if t != module)) for n in _SOURCE_NUMBER.findall(text)}
    return used - {int(n) for n in _SOURCE_NUMBER.findall(listed)}


def test_numbered_sources_are_listed() -> None:
    """A [1] in a docstring or comment is in the list of sources that its module begins with."""
    lost = {str(p.relative_to(ROOT)): found for p in SOURCES if p != Path(__file__) and (found := unlisted(p))}
    assert not lost, lost


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("Source: `landing.md` section 1.", "landing.md"),
        ("`docs/theory/landing.md`, section 99.", "section 99"),
        ("`docs/theory/landing.md`, sections 1 to 99.", "99"),
        ("`docs/theory/filter.md`, eq. (999).", "999"),
        ('`docs/landing.md`, "No such heading".', "No such heading"),
        ("[there](nowhere.md)", "nowhere.md"),
    ],
)
def test_what_leads_nowhere_is_found(text: str, found: str) -> None:
    count, lost = missing(text, ROOT / "navsim")
    assert count == 1
    assert len(lost) == 1
    assert found in lost[0]


def test_a_source_that_is_not_listed_is_found(tmp_path: Path) -> None:
    file = tmp_path / "module.py"
    file.write_text('"""Something [1].\n\nSource: [1] A book.\n"""\nX = 1  # as of [2]\nY = [3]\n')
    assert unlisted(file) == {2}
