"""HTML page of results: overview, tables, drawings, provenance, references, in one file without network access.

The same results give the same page, byte for byte, with the same versions of navsim and Bokeh. Data from a result are
escaped by Jinja, or go into Bokeh's data with every `<` escaped.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from importlib.resources import files as packaged
from typing import Any

import bokeh
from bokeh.document import Document
from bokeh.resources import Resources
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

import navsim
from navsim.kinds import named
from navsim.page import plots
from navsim.page.plots import Drawing, Named
from navsim.report import citations
from navsim.report.compare import TEXTS, differences, settings_of
from navsim.report.provenance import Read, provenance
from navsim.report.table import ABSENT, Table
from navsim.report.view import View, view
from navsim.results import findings
from navsim.results.result import Result, ResultError

GENERATOR = "navsim report"
"""Mark of a page by navsim, which may be overwritten."""
_MODEL = re.compile("p[0-9]+")
"""Pattern of Bokeh's model names."""


def page(read: Sequence[Read]) -> str:
    """Page of results of one kind. Raises ResultError for several kinds, or for a kind that this version does not
    have."""
    kinds = sorted({str(each.result.attributes["kind"]) for each in read})
    if len(kinds) > 1:
        raise ResultError(f"results of different kinds cannot share a page: {', '.join(kinds)}")
    here = view(kinds[0])
    results = [(each.name, each.result) for each in read]
    drawings: list[Drawing] = named(here.drawings)(results)
    content, script = _embedded(drawings)
    methods = citations.methods_of(result for _, result in results)
    sources = citations.sources_of(methods)
    number = {source.key: i for i, source in enumerate(sources, 1)}
    settings = [settings_of(result) for _, result in results]
    colours = _colours(results)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    folder = packaged(__package__)
    return environment.from_string(folder.joinpath("page.html").read_text(encoding="utf-8")).render(
        generator=GENERATOR,
        version=navsim.__version__,
        drawn_by=bokeh.__version__,
        title=_title(results),
        kind=kinds[0],
        results=[{"name": name, "colour": colours[i], "title": str(r.attributes.get("title", "")), "about": _about(r)}
                 for i, (name, r) in enumerate(results)],
        glance=_glance(here, results, colours),
        warned=[(name, found.text) for name, result in results for found in findings.of(result)],
        verdicts=_parts(here.verdicts(results)),
        differences=differences([name for name, _ in results], settings),
        settings=[(name, [(part, str(result.attributes[part])) for part in TEXTS if part in result.attributes])
                  for name, result in results],
        tables=_parts(here.tables(results)),
        drawings=drawings,
        provenance=provenance(read),
        methods=[(method, citations.numbered(method, number)) for method in methods],
        sources=sources,
        bibtex=citations.bibtex(methods),
        style=Markup(folder.joinpath("page.css").read_text(encoding="utf-8")),  # ours
        library=Markup(_library()),
        content=Markup(content),  # JSON without `<`
        roots=Markup(script),  # the same
        absent=ABSENT,
    )  # fmt: skip


def _parts(parts: Sequence[Table | str]) -> list[tuple[str, Table | str]]:
    """Tables and texts, with the type of each."""
    return [("table" if isinstance(part, Table) else "words", part) for part in parts]


def _title(results: Sequence[Named]) -> str:
    """Title of the page: the common title of the results, if any, and their names."""
    titles = list(dict.fromkeys(str(result.attributes.get("title", "")) for _, result in results))
    names = ", ".join(name for name, _ in results)
    return f"{titles[0]}: {names}" if len(titles) == 1 and titles[0] else names


def _about(result: Result) -> str:
    """Method, runs and seed in words."""
    parts = [str(result.attributes["method"])] if "method" in result.attributes else []
    if "/run" in result and result["/run"].size > 1:
        parts.append(f"{result['/run'].size} runs")
    parts += [f"seed {result.attributes['seed']}", f"epoch {result.attributes['epoch']}"]
    return ", ".join(parts)


def _colours(results: Sequence[Named]) -> list[str]:
    """The colours of results: those that drawings show together, flights or pushed runs, count through."""
    pushed = [result.attributes.get("method") == "rare" for _, result in results]
    order = sorted(range(len(results)), key=pushed.__getitem__)
    return [plots.colour(order.index(i)) for i in range(len(results))]


_LONGEST_NUMBER = 24
"""Most characters in the large letters of a tile; a longer text is a sentence, in small letters."""


def _glance(here: View, results: Sequence[Named], colours: Sequence[str]) -> list[dict[str, Any]]:
    """The first figures of each result, split into the number and its interval."""
    out = []
    for i, (name, result) in enumerate(results):
        shown = []
        for label, text in here.glance(result):
            number, _, more = str(text).partition("  ")
            if len(number) > _LONGEST_NUMBER:
                number, more = "", str(text)
            shown.append({"label": label, "number": number, "more": more})
        out.append({"name": name, "colour": colours[i], "shown": shown})
    return out if any(each["shown"] for each in out) else []


def _embedded(drawings: Sequence[Drawing]) -> tuple[str, str]:
    """Bokeh's document as JSON, and which of its roots goes where; with names that are the same each time."""
    document = Document()
    models = [panel for drawing in drawings for panel in drawing.panels]
    places = {panel.id: f"{drawing.name}-{i}" for drawing in drawings for i, panel in enumerate(drawing.panels)}
    if not models:
        return "{}", "{}"
    with document.models.freeze():  # otherwise each would process all of it again
        for model in models:
            document.add_root(model)
    numbers: dict[str, str] = {}
    content = _renamed({**document.to_json(deferred=False)}, numbers)
    roots = {numbers[str(model.id)]: places[str(model.id)] for model in models}

    return _script(content), _script(roots)


def _library() -> str:
    """BokehJS, without the line that logs its log level."""
    return Resources(mode="inline", components=["bokeh"]).js_raw[0]


def _renamed(node: Any, numbers: dict[str, str]) -> Any:
    """The document with its models numbered from one."""
    if isinstance(node, dict):
        return {
            key: numbers.setdefault(value, f"p{len(numbers) + 1}")
            if key == "id" and isinstance(value, str) and _MODEL.fullmatch(value) else _renamed(value, numbers)
            for key, value in node.items()
        }  # fmt: skip
    return [_renamed(each, numbers) for each in node] if isinstance(node, list) else node


def _script(data: Any) -> str:
    """JSON that can be embedded in a script."""
    return json.dumps(data, separators=(",", ":")).replace("<", "\\u003c").replace("&", "\\u0026")
