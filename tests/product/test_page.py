"""The page of `navsim report` and the list of `navsim cite`: every kind of result, alone and beside others; nothing of
a result is taken for markup; a real browser finds no fault with it."""

from __future__ import annotations

import functools
import hashlib
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bokeh.models import ColorBar

from navsim.formats import sweep_rows
from navsim.kinds import KINDS, named
from navsim.page import landing, plots, touchdown
from navsim.page.document import GENERATOR, Read, page
from navsim.page.terrain import ridge_lines
from navsim.report import citations, summary_tables
from navsim.report.compare import differences, settings_of
from navsim.report.figure_data import one_run
from navsim.report.requirements import box
from navsim.report.ridges import ShownRidge
from navsim.report.sky import source_tracks
from navsim.report.table import TIDY, Table, tidy
from navsim.report.view import view
from navsim.results.result import Result, read
from navsim.sweeps.page import sweeps
from tests import steps
from tests.conftest import ROOT
from tests.forks import navsim, shared
from tests.made import EVERY, EVIL
from tests.product.conftest import opened

MOST_BYTES = 5_000_000
"""Of a page with three results."""


PAGES = (
    ("cut",), ("runs", "evil", "covariance"), ("one", "none", "rare"), ("replay", "replay"),
    *((name,) for name in KINDS if name not in ("landing", "replay")),
)  # fmt: skip
"""Results that stand on a page together: of every kind, alone or two."""


IN_BROWSER = ("one", "sweep")
"""The first of those that a browser shows every time, beside those with markup in them."""


class Text(HTMLParser):
    """The words of a page, what it embeds, and its anchors and links within it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: dict[str, int] = {}
        self.words: list[str] = []
        self.anchors: list[str] = []
        self.links: list[str] = []
        self._within: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] = self.tags.get(tag, 0) + 1
        self._within.append(tag)
        for name, value in attrs:
            if name == "id" and value:
                self.anchors.append(value)
            if name in ("href", "src") and value:
                self.links.append(value)

    def handle_endtag(self, tag: str) -> None:
        if tag in self._within:
            while self._within.pop() != tag:
                pass

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self._within):
            self.words.append(data)

    @property
    def said(self) -> str:
        """All words, one blank between them."""
        return " ".join(" ".join(self.words).split())


def drawn_anew(place: Path, *names: str) -> str:
    """The page of results, each called by its name and place in the row."""
    files = [place / f"{name}.h5" for name in names]
    return page([Read(f"{file.stem}{i or ''}", file, read(file)) for i, file in enumerate(files)])


made = functools.cache(drawn_anew)
"""The same, once for all tests."""


def drawn(text: str) -> Any:
    """Bokeh's document within a page."""
    found = re.search(r'<script type="application/json" id="drawn">(.*?)</script>', text, re.DOTALL)
    assert found
    return json.loads(found[1])


def cells(parts: list[Table | str]) -> Iterator[str]:
    for part in parts:
        if isinstance(part, Table):
            for row in part.rows:
                yield from row.texts()


# --- every kind


@pytest.mark.parametrize("name", EVERY)
def test_every_number_in_csv_has_a_name(name: str, place: Path) -> None:
    """Where a cell has several; and what is an RMS or a percentile says so."""
    result = read(place / f"{name}.h5")
    rows = [row for part in view(result.attributes["kind"]).tables([(name, result)])
            if isinstance(part, Table) for row in tidy(part)]  # fmt: skip
    named = [dict(zip(TIDY, row, strict=True)) for row in rows]
    assert named
    assert [row for row in named if str(row["part"]).isdigit()] == []
    late = {row["part"] for row in named if str(row["section"]).startswith("Filter, errors over")}
    assert late in (set(), {"rms", "σ"})


def test_there_is_a_result_of_every_kind(place: Path) -> None:
    kinds = {str(read(place / f"{name}.h5").attributes["kind"]) for name in EVERY}
    assert kinds == set(KINDS)


@pytest.mark.parametrize("names", PAGES, ids="+".join)
def test_a_page_has_all_that_is_shown(names: tuple[str, ...], place: Path) -> None:
    """Every cell of the tables, verdicts, warnings, provenance and sources; figures with captions; nothing from
    elsewhere; links lead to what is there."""
    text = made(place, *names)
    found = Text(text)
    results = [(f"{name}{i or ''}", read(place / f"{name}.h5")) for i, name in enumerate(names)]
    kind = str(results[0][1].attributes["kind"])
    for said in cells(view(kind).tables(results)):
        assert " ".join(said.split()) in found.said, said
    for _, result in results:
        assert str(result.attributes["scenario_sha256"]) in found.said
        assert str(result.attributes["navsim_version"]) in found.said
    for name in names:
        assert hashlib.sha256((place / f"{name}.h5").read_bytes()).hexdigest() in found.said
    for source in citations.sources_of(citations.methods_of(result for _, result in results)):
        assert source.text() in found.said
    figures = found.tags["figure"]
    assert figures >= 1
    assert found.tags["figcaption"] == figures
    assert len(drawn(text)["roots"]) >= figures
    assert sorted(found.anchors) == sorted(set(found.anchors))
    for link in found.links:
        assert link == "data:," or link.removeprefix("#") in found.anchors, link
    assert len(text.encode()) < MOST_BYTES
    assert GENERATOR in text[:2000]


def test_the_same_results_give_the_same_page(place: Path) -> None:
    assert drawn_anew(place, "rare") == drawn_anew(place, "rare")


def test_a_sweep_is_told_in_words_in_the_order_of_quantities(place: Path) -> None:
    """Outputs by what they mean, with their units, varied keys as the scenario has them; colours with what they are of,
    the runway whole."""
    result = read(place / "sweep.h5")
    (table,) = (part for part in view("sweep").tables([("sweep", result)]) if isinstance(part, Table))
    assert table.heads[4:] == ("best pseudolites.count", "best pseudolites.s_m", "best pseudolites.l1_m")
    firsts = [str(row.cells[0]) for row in table.rows]
    assert firsts[:2] == [f"{dop}, mean over the glide" for dop in ("PDOP", "VDOP")]
    assert firsts[-1] == "vertical RMS of a fix, mean over the glide, m"
    drawings = sweeps([("sweep", result)])
    assert [drawing.name for drawing in drawings] == [f"{name}-0" for name in sweep_rows.outputs(result)]
    for drawing, said in zip(drawings, firsts, strict=True):
        for panel in drawing.panels:
            assert [bar.title for bar in panel.select(ColorBar)] == [said]
            assert panel.x_range.start < 0.0 < 1000.0 < panel.x_range.end
            assert panel.y_range.start > 0.0 > panel.y_range.end


def test_what_differs_is_said(place: Path) -> None:
    found = Text(made(place, "runs", "evil", "covariance")).said
    usual = "Glide approach with two pseudolites at 200/5000"
    assert f"title {usual} {EVIL} {usual}" in found
    assert "runway.heading_deg 0.0 33.0 0.0" in found
    assert "duration_s 65" not in found.partition("Verdicts")[0]
    assert "The settings are the same." in Text(made(place, "replay", "replay")).said


def test_what_differs_is_what_was_given() -> None:
    """No count of 0 beside the list that is in its place, no empty list beside the items of others."""
    sites = "pseudolites: {count: 0, sites: [{s_m: 3.0}]}\nterrain: []\n"
    count = "pseudolites: {count: 2, sites: []}\nterrain: [{height_m: 30.0}]\n"
    table = differences(["a", "b"], [settings_of(Result({"scenario": text}, {})) for text in (sites, count)])
    assert table is not None
    assert [row.texts() for row in table.rows] == [
        ["pseudolites.sites.0.s_m", "3.0", "-"], ["pseudolites.count", "-", "2"], ["terrain.0.height_m", "-", "30.0"],
    ]  # fmt: skip


def luminance(colour: str) -> float:
    """Relative, of WCAG."""
    coded = np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


@pytest.mark.parametrize("paper", ["#ffffff", "#14171c"])
def test_colours_are_seen_on_light_and_dark_paper(paper: str) -> None:
    assert paper in made_of("page.css")
    for colour, least in (*((each, 3.0) for each in plots.COLOURS), (plots.BROWN, 3.9), (plots.TEXT, 3.9)):
        low, high = sorted((luminance(colour), luminance(paper)))
        assert (high + 0.05) / (low + 0.05) >= least, colour


def made_of(name: str) -> str:
    """A file that pages are made of."""
    return files("navsim.page").joinpath(name).read_text(encoding="utf-8")


def test_heights_of_ridges_are_written_within_the_plan() -> None:
    """Over the upper end of the line; at a border of what is shown towards its middle."""
    said = {}
    for x, y in ((0.0, 0.0), (0.0, 95.0), (-95.0, 0.0), (95.0, 96.0)):
        on = plots.plot("", "", "")
        assert ridge_lines(on, [ShownRidge(np.array([[0.0, 90.0, 3.0], [x, -y, 3.0]]), 3.0)], (-100, 100), (-100, 100))
        name = on.renderers[-1].glyph
        said[x, y] = (name.text_align, name.text_baseline)
    assert said == {
        (0.0, 0.0): ("center", "bottom"), (0.0, 95.0): ("left", "top"), (-95.0, 0.0): ("left", "bottom"),
        (95.0, 96.0): ("right", "top"),
    }  # fmt: skip


def test_verdicts_and_warnings_are_said(place: Path) -> None:
    found = Text(made(place, "runs", "evil", "covariance")).said
    result = read(place / "runs.h5")
    names = (result[f"/summary/requirements/{each}"] for each in ("statement", "verdict"))
    for statement, verdict in zip(*names, strict=True):
        assert f"{statement} {verdict}: " in found
    assert str(read(place / "rare.h5")["/findings/text"][0]) in Text(made(place, "one", "none", "rare")).said


def test_the_first_figures_are_those_of_the_table(place: Path) -> None:
    result = read(place / "runs.h5")
    of_table = set(cells([summary_tables.summary_table([("runs", result)])]))
    shown = summary_tables.glance(result)
    assert len(shown) >= 6
    assert {str(said) for _, said in shown} <= of_table


def test_a_result_of_an_earlier_version_has_its_sky(place: Path) -> None:
    """Without the directions of sources that are not used."""
    result = read(place / "one.h5")
    new = {f"/geometry/{name}" for name in ("instant", "azimuth", "elevation")}
    old = Result(result.attributes, {k: v for k, v in result.variables.items() if k not in new})
    drawing = landing.sky([("old", old)])
    assert drawing is not None
    assert "A result of an earlier version keeps used sources alone." in drawing.caption


def test_paths_in_the_sky_are_smooth_and_of_one_scale(place: Path) -> None:
    """Lines pass every fix closely, with few points; skies side by side reach as far down."""
    result = read(place / "one.h5")
    los = result["/geometry/line_of_sight"]
    tracks, edge = source_tracks(result)
    assert edge == 100.0  # pseudolites stand lower than the aircraft
    assert sum(track.x.size for track in tracks) < 25 * len(tracks)
    names = list(map(str, result["/geometry/source"]))
    for track in tracks:
        if track.share < 1.0:
            continue
        east, north, up = los[:, names.index(track.name)].T
        away = 90.0 - np.degrees(np.arcsin(up))
        points = (away / np.hypot(east, north))[:, None] * np.stack([east, north], axis=1)
        line = np.stack([track.x, track.y], axis=1)
        ahead = np.diff(line, axis=0)
        aside = points[:, None] - line[None, :-1]
        along = np.clip(np.sum(aside * ahead, axis=2) / np.sum(ahead**2, axis=1), 0.0, 1.0)
        off = np.linalg.norm(aside - along[..., None] * ahead, axis=2).min(axis=1)
        assert off.max() < 0.16, track.name
    low = los.copy()
    low[:, names.index("PL1")] = [0.0, np.cos(-0.3), np.sin(-0.3)]
    below = result.variables | {
        "/geometry/line_of_sight": replace(result.variables["/geometry/line_of_sight"], data=low)
    }
    drawing = landing.sky([("one", result), ("low", Result(result.attributes, below))])
    assert {panel.x_range.end for panel in drawing.panels} == {1.14 * 110.0}


def test_unused_satellites_are_in_the_result(place: Path) -> None:
    """All that are above the horizon, those below the mask among them; where used, they are where the lines of sight
    point."""
    result = read(place / "one.h5")
    at = np.searchsorted(result["/geometry/time"], result["/geometry/instant"])
    los = result["/geometry/line_of_sight"][at]
    azimuth, elevation = result["/geometry/azimuth"], result["/geometry/elevation"]
    used = np.isfinite(los[:, :, 0])
    np.testing.assert_allclose(np.sin(elevation)[used], los[:, :, 2][used], atol=1e-12)
    np.testing.assert_allclose((np.tan(azimuth) * los[:, :, 1])[used], los[:, :, 0][used], atol=1e-9)
    assert ((elevation > 0.0) & ~used).any()
    assert at[0] == 0
    assert at[-1] == result["/geometry/time"].size - 1


def test_plans_are_views_from_above(place: Path) -> None:
    """Right of the landing direction is on the right-hand side; a box and a requirement are two limits."""
    drawings = named(view("landing").drawings)([("runs", read(place / "runs.h5"))])
    plans = [on for each in drawings for on in each.panels if on.yaxis[0].axis_label == "right of the axis, m"]
    assert plans
    for on in plans:
        assert on.y_range.start > on.y_range.end
        assert on.x_range.start < on.x_range.end
    (scatter,) = (each for each in drawings if each.name == "scatter")
    assert [key.text for key in scatter.keys] == ["box", "required"]


def test_long_histories_are_thinned_and_told_of() -> None:
    which = plots.thin(10 * plots.MOST_POINTS)
    assert which(np.arange(10 * plots.MOST_POINTS)).size == plots.MOST_POINTS
    assert which.caption() == f" The figure shows every 10th of {10 * plots.MOST_POINTS} instants."
    assert plots.thin(plots.MOST_POINTS).caption() == ""


@pytest.mark.parametrize("name", ["one", "evil"])
def test_errors_against_height_are_those_of_the_table(name: str, place: Path) -> None:
    """Along axes of the map and along others: what is drawn goes through what is told at heights."""
    result = read(place / f"{name}.h5")
    drawing = landing.heights([(name, result)])
    assert drawing is not None
    column = "error" if name == "one" else "rms"
    for axis, panel in zip(plots.AXES, drawing.panels, strict=True):
        (of,) = {r.data_source for r in panel.renderers if column in r.data_source.data}
        drawn_there = np.interp(result["/summary/at/height"], of.data["x"][::-1], of.data[column][::-1])
        told = result[f"/summary/at/{axis}_run"][0] if name == "one" else result[f"/summary/at/{axis}"][:, 0]
        np.testing.assert_allclose(drawn_there, told, rtol=0.1, atol=0.02)


@pytest.mark.parametrize("name", ["one", "evil"])
def test_sigma_is_named_as_it_is_drawn(name: str, place: Path) -> None:
    """Shaded where it is known all the way, bars alone across the axes of the map."""
    drawing = landing.heights([(name, read(place / f"{name}.h5"))])
    assert drawing is not None
    shaded = [r for r in drawing.panels[0].renderers if {"low", "high"} <= set(r.data_source.data)]
    areas = any("VArea" in type(r.glyph).__name__ or "HArea" in type(r.glyph).__name__ for r in shaded)
    (key,) = [key for key in drawing.keys if "σ" in key.text]
    assert (key.how == "band", "shaded" in drawing.caption) == (areas, areas) == (name == "one", name == "one")


def test_a_single_run_has_its_point_in_the_box(place: Path) -> None:
    result = one_run(read(place / "runs.h5"), 3)
    drawing = touchdown.scatter([("one", result)])
    assert drawing is not None
    on = drawing.panels[0]
    told = [r.data_source.data for r in on.renderers if "run" in r.data_source.data]
    (point,) = [data for data in told if data["run"].size]
    lateral, _, vertical = result["/summary/box/error_run"][0]
    np.testing.assert_allclose([point["x"][0], point["y"][0]], [lateral, vertical], rtol=1e-6)
    assert any(r.data_source.data.get("x", np.empty(0)).size == 5 for r in on.renderers)  # the box
    assert "ellipse" not in drawing.caption
    assert touchdown.scatter([("one", read(place / "one.h5"))]) is None


def test_of_one_run_the_box_counts_that_run(place: Path) -> None:
    result = read(place / "runs.h5")
    error = np.abs(result["/summary/box/error_run"][:, [0, 2]])
    outside = (error > result["/summary/box/upper"][[0, 2]]).any(axis=1)
    assert outside.sum() == result["/summary/box/outside"]
    for inside in (True, False):
        if (outside != inside).any():
            run = int(np.flatnonzero(outside != inside)[0])
            title = box(one_run(result, run)).get_suptitle()
            assert title.splitlines()[1].endswith(": 0 outside" if inside else ": 1 outside")


# --- what anybody may have written


IMAGE = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def marked(place: Path) -> str:
    """The page of three results, one of whose names and settings are markup, wherever there are any."""
    result = read(place / "evil.h5")
    names = [f"{name}{EVIL}</pre></script>&amp;" for name in result["/geometry/source"]]
    variables = dict(result.variables)
    variables["/geometry/source"] = replace(variables["/geometry/source"], data=np.array(names, dtype=object))
    attributes = result.attributes | {"navsim_version": "0.1", "epoch": EVIL, "seed": 7}
    evil = Read(f"a{EVIL}{IMAGE}", place / "evil.h5", Result(attributes, variables))
    others = (Read(name, place / f"{name}.h5", read(place / f"{name}.h5")) for name in ("runs", "covariance"))
    return page([evil, *others])


def test_nothing_of_a_result_is_markup(marked: str, place: Path) -> None:
    """Titles, names, settings, statements, in words, in Bokeh's data and in its tooltips."""
    text = marked
    assert EVIL not in text
    assert IMAGE not in text
    found = Text(text)
    clean = Text(made(place, "runs", "evil", "covariance"))
    assert {tag: count for tag, count in found.tags.items() if tag not in ("li", "dd")} == {
        tag: count for tag, count in clean.tags.items() if tag not in ("li", "dd")
    }
    assert EVIL in found.said
    assert "<b>van</b> is received" in found.said
    said = json.dumps(drawn(text), ensure_ascii=False)
    assert EVIL in said
    assert IMAGE in said


def test_the_page_takes_no_file_s_place(place: Path, tmp_path: Path) -> None:
    shutil.copy(place / "live.h5", tmp_path / "live.h5")
    before = (tmp_path / "live.h5").read_bytes()
    (tmp_path / "mine.html").write_text("<p>mine")
    for target, fragment in (("live.h5", "is one of the results"), ("mine.html", "is not a page of navsim report"),
                             ("no/no/x.html", "no such folder"), (".", "folder")):  # fmt: skip
        assert fragment in navsim("report", "live.h5", "-o", target, cwd=tmp_path, code=2).stderr
    assert (tmp_path / "live.h5").read_bytes() == before
    assert (tmp_path / "mine.html").read_text() == "<p>mine"
    assert navsim("report", "live.h5", cwd=tmp_path).stdout == "live.html\n"
    navsim("report", "live.h5", cwd=tmp_path)  # a page is written again
    said = navsim("report", "live.h5", place / "sweep.h5", cwd=tmp_path, code=2).stderr
    assert "results of different kinds cannot share a page: live, sweep" in said
    (tmp_path / "cut.h5").write_bytes(before[:-5000])
    assert "damaged" in navsim("report", "cut.h5", cwd=tmp_path, code=2).stderr


def test_results_of_one_name_are_told_apart(place: Path, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    shutil.copy(place / "rare.h5", tmp_path / "r.h5")
    shutil.copy(place / "rare.h5", tmp_path / "a" / "r.h5")
    navsim("report", "r.h5", "a/r.h5", "-o", "x.html", cwd=tmp_path)
    assert " r.h5 : rare" in (said := Text((tmp_path / "x.html").read_text()).said)
    assert " a/r.h5 : rare" in said
    navsim("report", "r.h5", "r.h5", "-o", "x.html", cwd=tmp_path)
    assert "r.h5 (1)" in Text((tmp_path / "x.html").read_text()).said


def test_a_kill_or_a_full_disk_leaves_the_page_before(place: Path, tmp_path: Path) -> None:
    shutil.copy(place / "live.h5", tmp_path / "r.h5")  # its page is the quickest to draw
    command = ("report", "r.h5")
    navsim(*command, cwd=tmp_path)
    whole = (tmp_path / "r.html").read_bytes()
    count = shared().run(*command, cwd=tmp_path).steps
    assert 2 <= count < 50
    for at, what in ((1, steps.FULL), (count // 2, steps.KILL), (count, steps.FULL), (count, steps.KILL)):
        done = shared().run(*command, cwd=tmp_path, what=what, at=at)
        assert what == steps.KILL or done.failure() is None, done.err
        assert (tmp_path / "r.html").read_bytes() == whole
    navsim(*command, cwd=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.h5", "r.html"]


def test_without_bokeh_the_way_to_it_is_said(place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import subprocess
    import sys

    (tmp_path / "bokeh.py").write_text("raise ModuleNotFoundError(\"No module named 'bokeh'\", name='bokeh')\n")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{ROOT}")
    done = subprocess.run([sys.executable, "-m", "navsim", "report", place / "one.h5", "-o", tmp_path / "x.html"],
                          capture_output=True, text=True, check=False)  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == (
        "error: navsim report draws with Bokeh, which is not installed here: pip install '.[report]' in the folder of "
        "navsim\n"
    )
    assert not (tmp_path / "x.html").exists()


# --- whom to cite


def test_sources_are_those_of_the_documentation() -> None:
    """Authors, year and title of each stand in docs/theory, another page or a module; a few titles are told to be from
    elsewhere; every source is used, every page there."""
    files = [*(ROOT / "docs").rglob("*.md"), *(p for p in (ROOT / "navsim").rglob("*.py") if p.name != "citations.py")]
    text = " ".join(" ".join(path.read_text().replace("*", "").split()) for path in files)
    elsewhere = (citations.__doc__ or "").partition("(")[2].partition(")")[0].split(", ")
    for source in citations.SOURCES.values():
        for author in source.authors if len(source.authors) < 5 else source.authors[:1]:
            assert author == "others" or author in text, (source.key, author)
        title = source.fields.get("title", "")  # none is invented
        assert source.fields.get("year", "") in text, source.key
        told = any(name in source.authors for name in elsewhere)
        assert told or title.split(", vol.")[0].split(", v3")[0].split(", parts")[0] in text, title
    used = {key for method in citations.METHODS for key in method.sources}
    assert used == set(citations.SOURCES)
    assert all((ROOT / method.page).is_file() for method in citations.METHODS)


def test_cite_names_what_a_result_rests_on(place: Path) -> None:
    said = navsim("cite", "rare.h5", cwd=place).stdout
    assert "rare events by importance sampling" in said
    assert "Owen & Zhou: Safe and effective importance sampling" in said
    assert "Singer" not in said
    assert "Singer" in navsim("cite", cwd=place).stdout
    entries = navsim("cite", "--bibtex", cwd=place).stdout
    assert len(re.findall(r"^@\w+\{\w+,$", entries, re.MULTILINE)) == len(citations.SOURCES)
    assert entries.count("{") == entries.count("}")


# --- a real browser


def looked_at(browser: Any, file: Path, **how: Any) -> tuple[Any, list[str]]:
    """A page offline, drawn to its end, and all it asked for or had to say."""
    shown = opened(browser, offline=True, **how)
    said: list[str] = []
    shown.on("console", lambda message: said.append(f"console: {message.text}"))
    shown.on("pageerror", lambda error: said.append(f"error: {error}"))
    shown.on("dialog", lambda dialog: said.append(f"dialog: {dialog.message}"))
    shown.on("request", lambda request: said.append(f"request: {request.url}"))
    shown.goto(file.as_uri())
    shown.wait_for_function("window.Bokeh && Bokeh.documents.length && Bokeh.documents.every(d => d.is_idle)")
    return shown, said


def test_a_browser_finds_no_fault(browser: Any, marked: str, tmp_path: Path) -> None:
    """Three results, offline: no console line, no request but the file; every panel drawn, as wide as there is room, on
    a phone, too; a title that is a script, and a name under the pointer that is markup, are text; on light and on dark
    paper, and printed."""
    file = tmp_path / "three.html"
    file.write_text(marked)
    assert file.stat().st_size < MOST_BYTES
    shown, said = looked_at(browser, file, color_scheme="dark", viewport={"width": 390, "height": 900})
    panels = len(drawn(file.read_text())["roots"])
    assert shown.evaluate("Bokeh.documents[0].roots().length") == panels
    empty = "[...document.querySelectorAll('.panel')].filter(p => p.getBoundingClientRect().height < 80).length"
    for width, scheme in ((390, "dark"), (1280, "light")):
        shown.set_viewport_size({"width": width, "height": 900})
        shown.emulate_media(color_scheme=scheme)
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        assert shown.evaluate(empty) == 0
        # rings and marks of a sky have one scale
        skies = shown.evaluate(
            "Bokeh.index.roots.filter(v => v.el.closest('#sky')).map(v => [v.frame.bbox.width, v.frame.bbox.height])"
        )
        assert skies
        assert all(wide == high > 200 for wide, high in skies)
        # digests and paths are broken, not cut off
        own = "(e => [e.scrollWidth, e.clientWidth])(document.querySelector('#provenance .scroll'))"
        inner, outer = shown.evaluate(own)
        assert inner <= outer or width < 800
        paper = shown.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", paper)[:3])) > 600) == (scheme == "light")
    # three lines under the pointer, one box is seen
    panel = shown.locator("#dop-0")
    panel.scroll_into_view_if_needed()
    box = panel.bounding_box()
    boxes = "[...document.querySelectorAll('.bk-Tooltip')].map(b => getComputedStyle(b).visibility)"
    for x in (0.4, 0.5):
        shown.mouse.move(box["x"] + x * box["width"], box["y"] + 0.5 * box["height"])
    shown.wait_for_function(f"{boxes}.length === 3 && {boxes}.filter(v => v === 'visible').length === 1")
    told = (
        "(function all(n) { return [...n.querySelectorAll('*')].map(e => (e.className === 'bk-tooltip-row-value' ? "
        "e.textContent : '') + (e.shadowRoot ? all(e.shadowRoot) : '')).join(' '); })(document)"
    )
    shown.wait_for_function(f"{told}.includes('onerror')")
    # on paper small figures are not parted, larger ones are, between their panels
    whole = shown.evaluate("[...document.querySelectorAll('figure')].filter(f => f.classList.contains('whole')).length")
    assert 4 <= whole <= 8 < Text(file.read_text()).tags["figure"]
    assert EVIL in shown.inner_text("header")
    assert said == [f"request: {file.as_uri()}"]
    printed = shown.pdf(format="A4")
    assert printed.startswith(b"%PDF")
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) >= 5
    shown.context.close()


@pytest.mark.parametrize(
    "names",
    [
        pytest.param(names, id="+".join(names), marks=[] if names[0] in IN_BROWSER else pytest.mark.long)
        for names in PAGES
        if "evil" not in names
    ],
)
def test_every_kind_is_drawn(names: tuple[str, ...], browser: Any, place: Path, tmp_path: Path) -> None:
    """Ensembles with histories in the tests before and after this one."""
    file = tmp_path / "page.html"
    file.write_text(made(place, *names))
    shown, said = looked_at(browser, file, viewport={"width": 800, "height": 600})
    assert said == [f"request: {file.as_uri()}"]
    shown.context.close()


UNITS = ("m", "s", "rad", "deg", "m_s", "rad_s", "m_s2", "dbhz")
PLAIN = re.compile(r"run|gate|name|source|pseudolites|count|normalized_squared|[phv]dop(_max|_published|_\d_pl)?")
"""Heads of columns without a unit."""


def test_columns_of_csv_files_end_with_their_units(place: Path, tmp_path: Path) -> None:
    """Of all files that are written beside results and by `navsim export`; the others have no unit."""
    for name in ("one", "runs", "replay"):
        navsim("export", place / f"{name}.h5", "--csv", "-o", tmp_path / name, cwd=place)
    navsim("export", place / "one.h5", "--rinex", "-o", tmp_path / "one", cwd=place)
    files = [*place.rglob("*.csv"), *tmp_path.glob("*.csv")]
    heads = {file.name: file.read_text().splitlines()[0].split(",") for file in files}
    assert len(files) > 9
    wrong = {
        (file, head)
        for file, row in heads.items()
        for head in row
        if not PLAIN.fullmatch(head) and not head.endswith(tuple(f"_{unit}" for unit in UNITS))
    }
    assert not wrong
