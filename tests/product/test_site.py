"""The site of docs/: it builds without a warning, lists every page, and a browser finds no fault with it, offline."""

from __future__ import annotations

import functools
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest

from tests.conftest import ROOT
from tests.helpers import in_brief
from tests.product.conftest import opened
from tests.unit.test_reference import script

pytestmark = pytest.mark.long  # the build takes half a minute; links of pages and code are checked every time

DOCS = ROOT / "docs"


@functools.cache
def pages() -> list[Path]:
    """Pages of the tree, and those that the schemas make."""
    there = [path.relative_to(DOCS) for path in sorted(DOCS.rglob("*.md"))]
    made = [Path("reference", name) for name in script("reference").pages()]
    return [page for page in there if not {"_build", "reference"} & {*page.parts}] + made


def build(source: Path, target: Path) -> subprocess.CompletedProcess[str]:
    """What `make site` does, but for cells: `test_notebooks` executes them."""
    cells_stay = ("-D", "nb_execution_mode=off", "-D", "suppress_warnings=bibtex.missing_field,myst-nb.lexer")
    return subprocess.run(
        [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-q", *cells_stay, source, target],
        capture_output=True, text=True, check=False, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=600,
    )  # fmt: skip


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built without a warning."""
    target = tmp_path_factory.mktemp("site")
    done = build(DOCS, target)
    assert done.returncode == 0, done.stdout + done.stderr
    return target


def test_pages_are_there_and_load_nothing_from_elsewhere(site: Path) -> None:
    """What is built is what there is. Links lead out, but no script, style, font or image comes from another place."""
    assert len(pages()) > 40
    seen = 0
    for page in pages():
        text = (site / page.with_suffix(".html")).read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe|source)\b[^>]*?\bsrc=\"([^\"]+)\"", text)
        loaded += [
            link for rel, link in re.findall(r"<link\b[^>]*?\brel=\"([^\"]+)\"[^>]*?\bhref=\"([^\"]+)\"", text)
            if rel in ("stylesheet", "preload", "icon", "shortcut icon")
        ]  # fmt: skip
        assert [one for one in loaded if re.match(r"(https?:)?//", one)] == [], page
        seen += len(loaded)
    assert seen > len(pages())


def test_a_page_that_nobody_lists_is_an_error(tmp_path: Path) -> None:
    """And so is a link that leads nowhere: the build can fail."""
    docs, sources = tmp_path / "docs", Path("navsim") / "report" / "sources.bib"
    docs.mkdir()
    for name in ("conf.py", "scorer.js"):
        shutil.copy(DOCS / name, docs)
    shutil.copytree(DOCS / "_static", docs / "_static")
    (tmp_path / sources).parent.mkdir(parents=True)
    shutil.copy(ROOT / sources, tmp_path / sources)
    (docs / "index.md").write_text("# Front\n\n[gone](nowhere.md)\n")
    (docs / "lonely.md").write_text("# Lonely\n")
    done = build(docs, tmp_path / "out")
    assert done.returncode != 0
    assert "lonely.md" in done.stderr
    assert "nowhere.md" in done.stderr


QUESTIONS = {
    "S": "glossary", "L1": "glossary", "sigma": "glossary", "PDOP": "glossary", "VPL": "glossary", "z": "glossary",
    "C/N0": "glossary", "tfg": "glossary", "Gaussian sum": "filter", "no fix": "troubleshooting", "data sheet": "imu",
    "error budget": "covariance", "jammer": "how-to/jammer", "protection level": "integrity",
    "figure for a paper": "how-to/figure", "exit code": "commands", "lateral_run": "reference/results/landing",
    "sky.mask_deg": "reference/landing/sky", "heading large": "troubleshooting", "sigma small": "troubleshooting",
    "NEES 1110": "troubleshooting", "placement map flat": "troubleshooting", "exit code 3": "commands",
    "S and L1": "glossary", "how to cite": "citing", "lever arm": "glossary", "latency sign": "glossary",
    "file formats": "how-to/files", "almanac": "how-to/files", "NMEA": "replay-files", "xarray": "python",
    "gust": "reference/landing/wind", "Monte Carlo": "glossary",
    "recorded ranges": "how-to/ranges", "beacon positions": "how-to/ranges", "two-way ranging": "how-to/ranges",
    "magnetometer": "how-to/sensor", "hard iron": "glossary", "control variates": "theory/control-variates",
    "python interface": "python-interface", "pseudolite clock": "how-to/pseudolite-clock",
    "pseudolite terrain": "how-to/pseudolite-reception",
    "reviewer": "how-to/review", "verify": "how-to/review",
    "tampered": "how-to/review", "RO-Crate": "how-to/review",
    "where do I put pseudolites": "troubleshooting", "how accurate will my landing be": "troubleshooting",
    "touchdown accuracy": "how-to/accuracy", "what does NEES mean": "troubleshooting", "replay my log": "how-to/log",
    "which filter": "filter", "how many runs": "troubleshooting", "not modelled": "limits",
    "add a sensor": "how-to/sensor", "exit codes": "commands", "survey error": "how-to/pseudolite-clock",
}  # fmt: skip
"""What users look for, and the page that has the answer."""


@pytest.mark.parametrize("every", in_brief([11, 1], 0))
def test_search_finds_what_users_ask(every: int, browser: Any, site: Path) -> None:
    """Among the first three pages, by the site's index as a browser asks it. The index is loaded once."""
    page = browser.new_page()
    page.set_default_timeout(120_000)  # on a busy machine
    missed = {}
    for number, (question, answer) in enumerate([*QUESTIONS.items()][::every]):
        if number == 0:
            page.goto(f"{(site / 'search.html').as_uri()}?q={quote(question)}")
        else:
            page.evaluate("document.getElementById('search-results').replaceChildren()")
            page.evaluate("question => Search.performSearch(question)", question)
        page.wait_for_function("/finished|not match/.test(document.querySelector('.search-summary')?.innerText)")
        links = page.evaluate("[...document.querySelectorAll('ul.search li > a')].map(a => a.getAttribute('href'))")
        found = list(dict.fromkeys(re.sub(r"\.html.*", "", link) for link in links))
        if answer not in found[:3]:
            missed[question] = found[:6]
    page.close()
    assert missed == {}


def test_answers_are_within_three_clicks(site: Path) -> None:
    """Along links of the pages' texts, from the front page."""
    clicks = {"index": 0}
    for name in (waiting := ["index"]):  # grows
        text = (site / f"{name}.html").read_text(encoding="utf-8")
        article = text[text.index("<article") : text.index("</article>")]
        for link in re.findall(r'href="([^"#]+)\.html', article):
            target = os.path.normpath(os.path.join(os.path.dirname(name), link))
            if "//" not in link and target not in clicks:
                clicks[target] = clicks[name] + 1
                waiting.append(target)
    assert {str(page.with_suffix("")) for page in pages()} <= clicks.keys()
    assert {answer: clicks[answer] for answer in QUESTIONS.values() if clicks[answer] > 3} == {}


LOOKED_AT = ("index", "tutorial", "reference/landing/imu", "theory/filter", "gallery", "contents/how-to")
"""Pages that a browser opens: the front page, console blocks, wide tables, formulas, figures, a list of contents."""


THEME_SAYS = "console: [PST]: Changed to auto mode"
"""What the theme writes whenever a page opens."""


@pytest.mark.parametrize("name", in_brief(LOOKED_AT, 0, 3))
def test_a_browser_finds_no_fault(name: str, browser: Any, site: Path) -> None:
    """Offline: no console line, no request outside; the paper follows the scheme; nothing is wider than a phone."""
    page = opened(browser, offline=True, viewport={"width": 1280, "height": 900})
    said: list[str] = []
    page.on("console", lambda message: said.append(f"console: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.on("request", lambda request: said.append(request.url))
    page.goto((site / f"{name}.html").as_uri(), wait_until="networkidle")
    assert page.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 0)")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_function(  # the paper changes slowly
            "light => (getComputedStyle(document.body).backgroundColor.match(/[0-9]+/g).slice(0, 3)"
            ".reduce((sum, part) => sum + Number(part), 0) > 600) === light",
            arg=scheme == "light",
        )
    assert [line for line in said if not line.startswith((site.as_uri(), THEME_SAYS))] == []
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.context.close()
