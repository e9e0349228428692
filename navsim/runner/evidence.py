"""A folder for a reviewer: a result, its inputs, a page that explains both, and RO-Crate metadata.

Sources: [1] RO-Crate 1.1, https://w3id.org/ro/crate/1.1 (root data entity, metadata descriptor, data entities,
provenance of entities: software and actions).
"""

from __future__ import annotations

import hashlib
import json
import shlex
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files as packaged
from pathlib import Path, PurePosixPath
from typing import Any

import navsim
from navsim.kinds import KINDS
from navsim.report.assurance import judged, unmodelled_effects
from navsim.report.citations import cited, methods_of
from navsim.report.table import Table, html
from navsim.report.view import view
from navsim.results import files
from navsim.results.findings import of as findings_of
from navsim.results.result import DamagedResult, Result, ResultError, read, write_bytes, write_text
from navsim.runner.errors import BadInput, as_problems
from navsim.runner.provenance import CODE, OPTIONS, InputFile, software, stored_software
from navsim.runner.verification import damage, find_inputs

METADATA, PAGE, SUMS = "ro-crate-metadata.json", "ro-crate-preview.html", "SHA256SUMS"
_CRATE = "https://w3id.org/ro/crate/1.1"
_INPUTS = "inputs"
_FORMATS = {
    ".h5": "application/x-hdf5", ".yaml": "application/yaml", ".html": "text/html", ".csv": "text/csv",
    ".txt": "text/plain",
}  # fmt: skip
_MAY_I = "May you quote it? The page how-to/review.md of the documentation of navsim has the list."
_NO_LICENCE = "#licence-not-stated"
_STYLE = packaged(__package__).joinpath("evidence.css").read_text(encoding="utf-8")


@dataclass(frozen=True)
class Evidence:
    """What goes into the folder. inputs: files with their names there; `texts` are the files with text."""

    result: Result
    file: Path
    inputs: list[tuple[InputFile, Path, str]]
    texts: dict[str, str]
    licence: str


def write_evidence(file: Path, folder: Path, inputs: Path | None, licence: str) -> list[Path]:
    """Write the folder; returns its files. inputs: where the result's input files lie, see `verification.find_inputs`.

    Raises BadInput for a folder that holds something, and for inputs that are lacking or were changed; ResultError,
    also for a result that is not as it was written.
    """
    try:
        result = read(file)
    except DamagedResult as error:
        raise ResultError(f"{error}; `navsim verify` says more") from None
    if wrong := damage(file):
        raise ResultError(f"{file}: {wrong[0]}; `navsim verify` lists what was changed")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise BadInput(as_problems(f"{folder}: is not an empty folder; choose another -o/--output"))
    named = _named_inputs(result, file, inputs)
    texts = {
        f"{part}.yaml": str(result.attributes[part]) for part in ("study", "scenario") if part in result.attributes
    }
    evidence = Evidence(result, file, named, texts, licence)
    texts[PAGE] = page(evidence)
    try:
        folder.mkdir(exist_ok=True)
        for name, source in [(file.name, file), *((name, path) for _, path, name in named)]:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, folder / name)
    except OSError as error:
        raise ResultError(f"{folder}: cannot be written: {error.strerror or error}") from None
    for name, text in texts.items():
        write_text(folder / name, text)
    write_text(folder / METADATA, json.dumps(crate(evidence, folder), indent=1, ensure_ascii=False) + "\n")
    made = sorted(path for path in folder.rglob("*") if path.is_file())
    sums = "".join(f"{files.checksum(path)}  {path.relative_to(folder).as_posix()}\n" for path in made)
    write_bytes(folder / SUMS, sums.encode())
    return [*made, folder / SUMS]


def _named_inputs(result: Result, file: Path, folder: Path | None) -> list[tuple[InputFile, Path, str]]:
    """Input files of a result, and their names in the folder: those that the scenario uses, where they lie below it."""
    out: list[tuple[InputFile, Path, str]] = []
    wrong = []
    for each, path in find_inputs(result, file, folder):
        if path is None:
            wrong += [f"{each}: no such file; --folder says where the files lie that the scenario names"] * bool(
                each.key
            )
            continue
        if files.checksum(path) != each.sha256:
            wrong.append(f"{each}: {path} was changed after the result was computed")
        name = PurePosixPath(each.name if each.key else Path(each.name).name)
        if name.is_absolute() or ".." in name.parts:
            name = PurePosixPath(name.name)
        text = f"{_INPUTS}/{name}"
        taken = {other: source for _, source, other in out}
        if text not in taken:
            out.append((each, path, text))
        elif taken[text] != path:
            wrong.append(f"{each}: another input has the same name in the folder; rename one of them")
    if wrong:
        raise BadInput(as_problems(*wrong))
    return out


def page(evidence: Evidence) -> str:
    """The page for the reviewer, one HTML file that needs no network."""
    result, root = evidence.result, evidence.result.attributes
    title = str(root.get("title") or evidence.file.stem)
    about = f"Result of navsim {root['navsim_version']}, computed {root['created']}"
    one, other = (code.get(CODE, "unknown")[:16] for code in (stored_software(result), software()))
    written = (
        f"navsim {navsim.__version__} wrote this page. Its code (SHA-256 {other}) is "
        f"{'the one' if one == other else 'not the one'} that computed the result. It compared checksums and computed "
        "nothing again; navsim verify does."
    )
    body = "\n".join((f"<p>{escape(written)} {escape(_MAY_I)}</p>", *_sections(evidence)))
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>\n'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>\n<body>'
        f"<h1>{escape(title)}</h1>\n<p>{escape(about)}, kind {escape(str(root['kind']))}.</p>\n{body}\n"
        "</body></html>\n"
    )


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]], title: str = "") -> str:
    out = Table(title, tuple(heads))
    for row in rows:
        out.add(*row)
    return html([out])


def _sections(evidence: Evidence) -> Iterator[str]:
    result, name = evidence.result, evidence.file.stem
    here = view(result.attributes["kind"])
    verdicts = here.verdicts([(name, result)])
    yield "<h2>Verdicts</h2>"
    asked = "/summary/requirements/verdict" in result
    yield ("" if asked else "<p>The scenario states no requirements.</p>") + html(verdicts)
    yield "<h2>Warnings</h2>"
    limits = unmodelled_effects(result)
    found = [f"Not modelled: {each.effect}. {each.consequence} {each.remedy}" for each in limits if each.forbids]
    found += [each.text for each in findings_of(result)]
    yield "".join(f"<p>{escape(text)}</p>" for text in found) or "<p>navsim found nothing to warn of.</p>"
    yield f"<h2>Results</h2>{html(here.tables([(name, result)]))}"
    rows, without = judged(result)
    yield "<h2>Outside checks of the methods used</h2>"
    yield "<p>Each row compares code of navsim with another program, a publication or a closed form. All rows hold.</p>"
    if rows:
        cells = [(each.method, each.claim, each.oracle, each.tolerance) for each in rows]
        yield _table(("method", "navsim computes", "compared with", "largest difference"), _once(cells))
    if without:
        yield f"<p>Methods of this result without an outside check: {escape('; '.join(without))}.</p>"
    yield "<h2>Effects that are not modelled</h2>"
    effects = [(each.section, each.effect, each.consequence, each.remedy) for each in limits]
    if effects:
        yield _table(("subject", "not in this result", "what that does to it", "what to do"), _once(effects))
    else:
        yield "<p>The assumptions are those of the sources below; navsim keeps no list for this kind of result.</p>"
    yield f"<h2>Sources of the methods</h2><pre>{escape(cited(methods_of([result])))}</pre>"
    yield "<h2>Input files</h2>"
    yield _table(
        ("file", "key of the scenario", "bytes", "SHA-256"),
        [(place, each.key or "the file itself", str(each.size), each.sha256) for each, _, place in evidence.inputs],
    )
    yield "<h2>Code and machine</h2>"
    yield _table(("item", "value"), [*stored_software(result).items(), ("scenario SHA-256", _sha(result))])
    yield f"<h2>Reproduce and verify</h2><pre>{escape(_commands(evidence))}</pre>"
    yield (
        f"<p><code>{SUMS}</code> has a checksum of each file. Sign it with a tool of your own, such as gpg. This "
        "folder shows the input, the computation and the numbers. It is no approval by anybody, and navsim is no "
        "qualified tool (DO-330).</p>"
    )
    for part, text in evidence.texts.items():
        yield f'<h2>{escape(part)}</h2><pre class="long">{escape(text)}</pre>'


def _once(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Rows whose first cell is empty where it is that of the row above."""
    return [(row[0] if not i or rows[i - 1][0] != row[0] else "", *row[1:]) for i, row in enumerate(rows)]


def _sha(result: Result) -> str:
    return str(result.attributes["scenario_sha256"])


def _commands(evidence: Evidence) -> str:
    """Commands that verify and repeat the result, in the folder."""
    result = evidence.result
    given = json.loads(stored_software(result).get(OPTIONS, "{}"))
    if "/run" in result and result["/run"].size > 1:
        given |= {"runs": int(result["/run"].size)}
        given.pop("until", None)
    options = "".join(f" --{name.replace('_', '-')} {value}" for name, value in given.items() if value is not None)
    command = KINDS[str(result.attributes["kind"])].command
    main = "study.yaml" if "study.yaml" in evidence.texts else "scenario.yaml"
    verify = f"sha256sum -c {SUMS}\nnavsim verify {shlex.quote(evidence.file.name)} --folder {_INPUTS}"
    if command not in ("run", "sweep", "optimize", "replay"):
        return verify
    seed = "" if command == "replay" else f" --seed {result.attributes['seed']}"
    copy = f"cp -r {_INPUTS} ../again\ncp {main} ../again/again.yaml"
    compare = f"navsim show {shlex.quote(evidence.file.name)} ../again/again.h5 --compare"
    return f"{verify}\n{copy}\nnavsim {command} ../again/again.yaml{seed}{options} -o ../again/again.h5\n{compare}"


def crate(evidence: Evidence, folder: Path) -> dict[str, Any]:
    """RO-Crate metadata [1] of the files in a folder."""
    result, root = evidence.result, evidence.result.attributes
    names = [evidence.file.name, *evidence.texts, *(name for _, _, name in evidence.inputs)]
    about = {name: f"input: {each.key or 'the scenario or study'}" for each, _, name in evidence.inputs}
    about |= {evidence.file.name: "result, HDF5 that is valid netCDF-4", PAGE: "page for a reviewer"}
    parts = [
        {
            "@id": name, "@type": "File", "name": about.get(name, f"{name} as stored in the result"),
            "encodingFormat": _FORMATS.get(Path(name).suffix, "application/octet-stream"),
            "contentSize": str((folder / name).stat().st_size),
            "sha256": hashlib.sha256((folder / name).read_bytes()).hexdigest(),
        }
        for name in dict.fromkeys(names)
    ]  # fmt: skip
    sources = [each for each in names[1:] if each != PAGE]
    licence = {"@id": evidence.licence or _NO_LICENCE}
    graph: list[dict[str, Any]] = [
        {"@id": METADATA, "@type": "CreativeWork", "about": {"@id": "./"}, "conformsTo": {"@id": _CRATE}},
        {
            "@id": "./", "@type": "Dataset", "name": str(root.get("title") or evidence.file.stem),
            "description": f"Result of kind {root['kind']} of navsim {root['navsim_version']}, with its inputs",
            "datePublished": str(root["created"]), "license": licence,
            "hasPart": [{"@id": part["@id"]} for part in parts], "mentions": {"@id": "#computation"},
        },
        *parts,
        {
            "@id": "#navsim", "@type": "SoftwareApplication", "name": "navsim",
            "softwareVersion": str(root["navsim_version"]),
            "description": "; ".join(f"{name} {value}" for name, value in stored_software(result).items()),
        },
        {
            "@id": "#computation", "@type": "CreateAction", "name": "computation of the result",
            "endTime": str(root["created"]), "instrument": {"@id": "#navsim"},
            "object": [{"@id": name} for name in sources], "result": {"@id": evidence.file.name},
        },
        {
            **licence, "@type": "CreativeWork", "name": "licence" if evidence.licence else "licence not stated",
            "description": "terms of use of this folder"
            if evidence.licence
            else "whoever made this folder stated no terms of use",
        },
    ]  # fmt: skip
    return {"@context": [f"{_CRATE}/context", {"sha256": "https://schema.org/sha256"}], "@graph": graph}
