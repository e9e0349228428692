"""Verification of a result: is it what this input gives by this code?

- The file: checksums, and a digest of each variable and attribute as they were written.
- The origin: digests of the files that were read, of the code; versions, processor.
- The numbers: the work of the result is done again and every variable compared to the bit. Of an ensemble only some
  runs are flown again, and all statistics computed again from the stored ones (`Kind.ensemble`).
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np

import navsim
from navsim.results import files
from navsim.results.findings import several
from navsim.results.result import DamagedResult, Result, ResultError, contents_of, read_unchecked
from navsim.results.schema import LIVE, NOT_REPEATED, PROVENANCE, SCHEMA_VERSION
from navsim.runner.executor import Executor
from navsim.runner.job import JobError, OptionError, Progress
from navsim.runner.provenance import (
    CODE,
    INSTRUCTIONS,
    InputFile,
    software,
    stored_inputs,
    stored_options,
    stored_software,
)
from navsim.runner.provenance import OPTIONS as OPTIONS_ITEM
from navsim.scenario_files.source import Document, InputError, parse

EQUAL, DIFFERS, NOTE, UNCHECKED, OTHER_CODE = "equal", "differs", "note", "not checked", "other code"
"""Verdicts. A note says what follows from another code or machine, and is no difference of the result. "other code" is
a number that differs while other code than this one computed the result: a change of the code explains it."""
INTACT = "intact; computed by other code, so numbers cannot be repeated to the bit"
ROUNDING = 1e-6
"""Largest difference, relative to the largest value of a variable, that another processor or library may cause."""
DRAWN = 96
"""Usual number of runs that are flown again."""
ALL = 0
"""Number that stands for all runs."""
_FOREIGN = 0.25
"""If a larger part of the variables differs, it isn't one change in the file."""
FOREIGN = "most numbers differ: seed, scenario, input files or code are not those that gave them"
_MOST = 12
"""Differences of one sort that are listed."""


@dataclass(frozen=True)
class VerificationCheck:
    """Outcome of one check."""

    subject: str
    verdict: str
    text: str


@dataclass
class Verification:
    """Outcome of all checks of a result."""

    file: str
    checks: list[VerificationCheck] = field(default_factory=list)

    @property
    def differs(self) -> bool:
        """Whether the result, an input or the file is not what it claims to be."""
        return any(check.verdict == DIFFERS for check in self.checks)

    @property
    def incomplete(self) -> bool:
        """Whether numbers could not be checked."""
        return any(check.verdict == UNCHECKED for check in self.checks)

    @property
    def of_other_code(self) -> bool:
        """Whether numbers differ that other code computed."""
        return any(check.verdict == OTHER_CODE for check in self.checks)

    def plain(self) -> dict[str, Any]:
        """Data for JSON."""
        verdict = DIFFERS if self.differs else UNCHECKED if self.incomplete else EQUAL
        verdict = OTHER_CODE if verdict == EQUAL and self.of_other_code else verdict
        return {"file": self.file, "verdict": verdict, "checks": [asdict(check) for check in self.checks]}

    def add(self, subject: str, wrong: list[str], right: str, verdict: str = DIFFERS) -> None:
        """Add a check: equal with the text `right`, or one line for each difference."""
        for text in wrong[:_MOST]:
            self.checks.append(VerificationCheck(subject, verdict, text))
        if len(wrong) > _MOST:
            self.checks.append(VerificationCheck(subject, verdict, f"and {len(wrong) - _MOST} more"))
        if not wrong:
            self.checks.append(VerificationCheck(subject, EQUAL, right))


class EnsembleCheck(Protocol):
    """Check of an ensemble by statistics and drawn runs (`landing.verification.check_ensemble`)."""

    def __call__(self, again: Recomputation, runs: int) -> None: ...


@dataclass
class Recomputation:
    """A result and the prepared job that computes it again."""

    result: Result
    job: Any
    executor: Executor
    tell: Progress
    tolerance: float
    """0 where bits must be equal, else relative."""
    verdict: str
    """Verdict on a number that differs: `DIFFERS`, or `OTHER_CODE`."""
    out: Verification


def damage(file: Path) -> list[str]:
    """What of a result file is not as it was written: its blocks, variables and attributes. Raises ResultError."""
    result, contents, wrong = read_unchecked(file)
    out = Verification(str(file))
    out.add("file", wrong, "")
    _check_contents(out, result, contents)
    return [check.text for check in out.checks if check.verdict == DIFFERS]


def verify(file: Path, folder: Path | None, runs: int, executor: Executor, tell: Progress) -> Verification:
    """Verify a result.

    folder: of the files that the scenario names; None: as when it was computed, or beside the result. runs: to fly
    again, `ALL` for all. Raises ResultError for anything but a result.
    """
    out = Verification(str(file))
    try:
        result, contents, wrong = read_unchecked(file)
    except DamagedResult as error:
        out.add("file", [str(error).removeprefix(f"{file}: ")], "")
        return out
    out.add("file", wrong, "checksums of all blocks" if contents is not None else "no damage found")
    _check_contents(out, result, contents)
    damaged = [path for path in result.variables if not _readable(result, path)]
    if damaged:
        out.add("file", [f"{path}: its data are damaged" for path in damaged], "")
        return out
    tolerance, of_difference = _check_software(out, result)
    found = _check_inputs(out, result, file, folder)
    _check_scenario(out, result)
    kind = str(result.attributes["kind"])
    if kind == LIVE:
        text = "a stream of a receiver or sensor cannot be computed again; file and scenario are what can be verified"
        out.checks.append(VerificationCheck("numbers", NOTE, text))
    elif result.attributes.get("stopped"):
        text = f"the work ended early ({result.attributes['stopped']}), which no repetition reproduces"
        out.checks.append(VerificationCheck("numbers", NOTE, text))
    elif found is not None:
        _check_numbers(out, result, Path(file), found, runs, executor, tell, tolerance, of_difference)
    return out


def _readable(result: Result, path: str) -> bool:
    try:
        for _ in result.variables[path].data.blocks() if result.variables[path].data.shape else ():
            pass
    except ResultError:
        return False
    return True


def _check_contents(out: Verification, result: Result, contents: Mapping[str, str] | None) -> None:
    """Compare the digests of all variables and attributes with those written with them."""
    if contents is None and stored_software(result):
        out.add("contents", ["the digests of the contents, which this file was written with, are gone"], "")
        return
    if contents is None:
        version = result.attributes["navsim_version"]
        text = f"the file has no digests of its contents: written by an earlier navsim ({version})"
        out.checks.append(VerificationCheck("contents", UNCHECKED if out.differs else NOTE, text))
        return
    here = contents_of(result)
    wrong = []
    for name in sorted(set(contents) | set(here)):
        what = f"root attribute {name[1:]}" if name.startswith("@") else name
        if name not in here:
            wrong.append(f"{what}: was deleted from the file")
        elif name not in contents:
            wrong.append(f"{what}: was added to the file")
        elif contents[name] != here[name]:
            wrong.append(f"{what}: was changed after the file was written")
    whole = hashlib.sha256(json.dumps(contents, sort_keys=True).encode()).hexdigest()
    variables = sum(1 for name in contents if name.startswith("/"))
    text = f"{variables} variables and {len(contents) - variables} attributes as written; together SHA-256 {whole}"
    out.add("contents", wrong, text)


def _check_software(out: Verification, result: Result) -> tuple[float, str]:
    """Compare code, libraries and machine.

    Returns the tolerance of numbers, 0 where all is the same, and the verdict on those that differ by more.
    """
    there, here = stored_software(result), software()
    there.pop(OPTIONS_ITEM, None)
    if not there:
        text = "the result does not say which code and machine computed it; numbers are compared within rounding"
        out.checks.append(VerificationCheck("software", NOTE, text))
        return ROUNDING, DIFFERS
    unlike = [name for name in there | here if there.get(name) != here.get(name)]
    version = str(result.attributes["navsim_version"])
    if CODE not in unlike and version != navsim.__version__:
        out.add("software", [f"navsim_version: {version} in the file, its code is that of {navsim.__version__}"], "")
    for name in unlike:
        if name == INSTRUCTIONS:
            lacking, more = (set(a.split(",")) - set(b.split(",")) for a, b in (
                (there.get(name, ""), here.get(name, "")), (here.get(name, ""), there.get(name, "")),
            ))  # fmt: skip
            text = f"{name}: {len(lacking)} of the result's are lacking here, {len(more)} more are here"
        elif name == CODE:
            text = f"navsim {version} of another code than this {navsim.__version__}"
            text += f": SHA-256 {there.get(name, 'unknown')[:16]} in the result, {here[name][:16]} here"
        else:
            text = f"{name}: {there.get(name, 'none')} in the result, {here.get(name, 'none')} here"
        out.checks.append(VerificationCheck("software", NOTE, text))
    if unlike:
        text = (
            "equal bits can be expected only of the same code, libraries and type of processor; numbers are compared "
            f"within {ROUNDING:g} of the largest value of each variable"
        )
        out.checks.append(VerificationCheck("software", NOTE, text))
        return ROUNDING, OTHER_CODE if CODE in unlike else DIFFERS
    text = f"code of navsim {navsim.__version__} (SHA-256 {here[CODE][:16]}), {len(here) - 1} versions, this machine's"
    out.checks.append(VerificationCheck("software", EQUAL, f"{text} processor: equal bits are expected"))
    return 0.0, DIFFERS


def find_inputs(result: Result, file: Path, folder: Path | None) -> list[tuple[InputFile, Path | None]]:
    """Input files of a result, with their places here.

    folder: first place to look; None: the scenario's folder when the result was computed.
    """
    inputs = stored_inputs(result)
    near = [Path(each.name).parent for each in inputs if not each.key] if folder is None else [folder]
    return [(each, _find(each, [*near, Path(), file.parent, file.parent / "inputs"])) for each in inputs]


def _check_inputs(out: Verification, result: Result, file: Path, folder: Path | None) -> dict[str, Path] | None:
    """Compare the digests of input files; returns where they are by name, None if one is lacking."""
    found, wrong, lacking = dict[str, Path](), list[str](), False
    for each, path in find_inputs(result, file, folder):
        if path is not None:
            found[each.name] = path
            if (checksum := files.checksum(path)) != each.sha256:
                text = f"{path} has SHA-256 {checksum[:16]}, the file that was read had {each.sha256[:16]}"
                wrong.append(f"{each}: {text}")
        elif each.key and not each.key.endswith(".from"):
            lacking = True
            text = f"{each}: no such file; --folder says where the files lie that the scenario names"
            out.checks.append(VerificationCheck("inputs", UNCHECKED, text))
        else:
            text = f"{each}: not found here; the scenario stored in the result is used"
            out.checks.append(VerificationCheck("inputs", NOTE, text))
    if wrong or not lacking:
        out.add("inputs", wrong, f"{several(len(found), 'file')}: {', '.join(found)}" if found else "no files")
    return None if lacking else found


def _find(each: InputFile, folders: list[Path]) -> Path | None:
    """Where a file is: in the first folder that has it by its name or its last part."""
    names = [Path(each.name), Path(Path(each.name).name)]
    if not each.key:
        names = names[::-1]
    candidates = [folder / name for folder in folders for name in names]
    return next((path for path in candidates if path.is_file()), None)


def _check_scenario(out: Verification, result: Result) -> None:
    """Compare the stored scenario with its digest."""
    text = str(result.attributes.get("study", "")) + str(result.attributes.get("scenario", ""))
    stated, here = str(result.attributes.get("scenario_sha256")), hashlib.sha256(text.encode()).hexdigest()
    wrong = [] if stated == here else [f"its text has SHA-256 {here[:16]}, scenario_sha256 is {stated[:16]}"]
    out.add("scenario", wrong, f"SHA-256 {here[:16]}")


def _check_numbers(
    out: Verification, result: Result, file: Path, found: dict[str, Path], runs: int, executor: Executor,
    tell: Progress, tolerance: float, of_difference: str,
) -> None:  # fmt: skip
    """Compute the result again, or parts of an ensemble, and compare."""
    from navsim.kinds import KINDS, named

    name = str(result.attributes["kind"])
    kind = KINDS.get(name)
    refused = UNCHECKED if of_difference == OTHER_CODE else DIFFERS
    if kind is None or not kind.job:
        out.add("numbers", [f"kind {name!r}: is no kind of result that can be computed"], "", refused)
        return
    if int(result.attributes["schema_version"]) != SCHEMA_VERSION:
        text = f"its layout is version {result.attributes['schema_version']}, this navsim writes {SCHEMA_VERSION}"
        out.checks.append(VerificationCheck("numbers", UNCHECKED, f"{text}; navsim of that layout can verify it"))
        return
    try:
        options = stored_options(result)
        many = named(kind.ensemble) if kind.ensemble else None
        if many is not None:
            options = named(f"{kind.ensemble.partition(':')[0]}:options_of")(result, options)
        section, document = _document(result, file, found)
        if kind.section and section.kind != name:
            out.add("scenario", [f"is of kind {section.kind}, the result says kind {name}"], "")
            return
        job = named(kind.job)(section, document, options)
        job.prepare(executor, lambda *_, **__: None)
        again = Recomputation(result, job, executor, tell, tolerance, of_difference, out)
        count = int(result["/run"].size) if many is not None and "/run" in result else 0
        if many is not None and runs != ALL and count > max(runs, 1):
            many(again, runs)
        else:
            recompute_all(again)
    except InputError as error:
        out.add("scenario", [f"cannot be computed: {problem}" for problem in error.problems], "", refused)
    except (OptionError, JobError, ValueError, KeyError, TypeError, ResultError) as error:
        message = str(error).splitlines()[0] if str(error) else type(error).__name__
        out.add("numbers", [f"what the file holds cannot be computed again: {message}"], "", refused)


def _document(result: Result, file: Path, found: dict[str, Path]) -> tuple[Any, Document]:
    """Section and document of a result's scenario or study, with its files where they were found."""
    from navsim.scenario.load import section
    from navsim.scenario_files.base import validated

    part = "study" if "study" in result.attributes else "scenario"
    document = parse(str(result.attributes[part]), f"{file}, {part}", Path().absolute())
    document.elsewhere.update(found)
    return validated(section(str(document.data.get("kind"))), document), document


def recompute_all(again: Recomputation) -> None:
    """Do the whole work again and compare everything."""
    other = again.job.run(again.executor, None, again.tell).result
    wrong = [*attribute_differences(again.result, other, again.tolerance)]
    again.out.add("attributes", wrong, f"{len(other.attributes)} computed again", again.verdict)
    wrong = [*differences(again.result, other, again.tolerance)]
    count = sum(1 for path in other.variables if not path.startswith(PROVENANCE))
    if again.verdict == DIFFERS and len(wrong) > _FOREIGN * count:
        wrong.insert(0, FOREIGN)
    text = f"{count} variables computed again, all but those of {PROVENANCE}: {_precision(again.tolerance)}"
    again.out.add("numbers", wrong, text, again.verdict)
    if wrong and again.verdict == OTHER_CODE:
        for text in printed_differences(again.result, other):
            again.out.checks.append(VerificationCheck("printed", OTHER_CODE, text))


_DECIMALS = re.compile(r"\.(\d+)(?![\de])")
Printed = dict[tuple[str, ...], list[tuple[tuple[float, ...], str]]]
"""Numbers of tables, with the text of their cell, by table, section, row, column and name."""


def _printed(result: Result) -> Printed:
    from navsim.report.table import Table, tidy
    from navsim.report.view import view

    out: Printed = {}
    for table in view(result.attributes["kind"]).tables([("", result)]):
        for *where, _, value, low, high, text in tidy(table) if isinstance(table, Table) else ():
            numbers = tuple(float(x) if isinstance(x, float | int) else math.nan for x in (value, low, high))
            out.setdefault(tuple(map(str, where)), []).append((numbers, str(text)))
    return out


def printed_differences(stored: Result, other: Result) -> list[str]:
    """What differs of the tables of two results: the largest relative difference of a number, and the rows that print
    other text.

    A difference of a number, or of an end of its interval, is relative to the number, at least to a unit of its last
    printed digit. Changed rows are sorted by it.
    """
    one, two = _printed(stored), _printed(other)
    found = dict[tuple[str, ...], tuple[float, str]]()  # by row
    rows = {where[:3] for where in one | two}
    largest, text = 0.0, ""
    for where in one.keys() | two.keys():
        name = ", ".join(part for part in where[1:3] if part)
        there, here = one.get(where, []), two.get(where, [])
        if len(there) != len(here):
            found[where[:3]] = math.inf, f"{name}: {'not computed' if there else 'lacking in the file'}"
        for (a, before), (b, after) in zip(there, here, strict=False):
            digit = min((10.0 ** -len(digits) for digits in _DECIMALS.findall(before)), default=0.0)
            size = max((abs(x) for x in (a[0], b[0], digit) if math.isfinite(x)), default=0.0)
            gaps = [abs(x - y) for x, y in zip(a, b, strict=True) if math.isfinite(x - y)]
            relative = max(gaps, default=0.0) / (size or 1.0)
            if relative > largest:
                largest, text = relative, f" ({name}: {before} in the file, {after} computed)"
            if before != after and relative >= found.get(where[:3], (0.0, ""))[0]:
                found[where[:3]] = relative, f"{name}: {before} in the file, {after} computed"
    head = f"largest relative difference of a printed number: {largest:.2g}{text}"
    count = f"printed rows that read differently: {len(found)} of {len(rows)}"
    changed = [line for _, line in sorted(found.values(), reverse=True)]
    return [head, count, *changed[:_MOST], *[f"and {len(changed) - _MOST} more"] * (len(changed) > _MOST)]


def _precision(tolerance: float) -> str:
    return f"equal within {tolerance:g}" if tolerance else "all bits equal"


def attribute_differences(stored: Result, other: Result, tolerance: float) -> Iterator[str]:
    """Differences between root attributes, as text."""
    for name in sorted(set(stored.attributes) | set(other.attributes)):
        if name in NOT_REPEATED or (tolerance and name.startswith(("scenario", "study"))):
            continue  # another version may add keys to a scenario
        a, b = (one.attributes.get(name) for one in (stored, other))
        if a is None or b is None:
            yield f"{name}: {'lacking' if a is None else 'no attribute of such a result'}"
        elif not _same_values(np.asarray(a), np.asarray(b), tolerance):
            yield f"{name}: {_shown(a)} in the file, {_shown(b)} computed"


def differences(
    stored: Result,
    other: Result,
    tolerance: float,
    wanted: Callable[[str], bool] = lambda _: True,
    rows: slice | None = None,
) -> Iterator[str]:
    """Differences of a result from another computation of it, as text.

    wanted: which paths to compare. rows: of the stored data of runs; None: all.
    """
    for path in sorted(set(stored.variables) | set(other.variables)):
        if path.startswith(PROVENANCE) or not wanted(path):
            continue
        if path not in stored.variables:
            yield f"{path}: lacking"
        elif path not in other.variables:
            yield f"{path}: is no variable of such a result"
        else:
            yield from _variable_differences(path, stored, other, tolerance, rows)


def _variable_differences(
    path: str, stored: Result, other: Result, tolerance: float, rows: slice | None
) -> Iterator[str]:
    one, two = stored.variables[path], other.variables[path]
    about_too = rows is None  # those of an ensemble depend on all its runs
    rows = rows if one.dims[:1] == ("run",) else None
    a = np.asarray(one.data) if rows is None else one.data.rows(rows.start, rows.stop)
    b = np.asarray(two.data)
    if a.shape != b.shape or one.dims != two.dims:
        yield f"{path}: has dimensions {_sizes(one.dims, a)}, computed {_sizes(two.dims, b)}"
        return
    about: list[tuple[str, Any, Any]] = [("units", one.units, two.units), ("long_name", one.long_name, two.long_name)]
    about += [(name, one.attributes.get(name), two.attributes.get(name)) for name in one.attributes | two.attributes]
    for name, x, y in about if about_too and not tolerance else ():
        if x is None or y is None or not _same_values(np.asarray(x), np.asarray(y), tolerance):
            yield f"{path}, attribute {name}: {_shown(x)} in the file, {_shown(y)} computed"
    if _same_values(a, b, tolerance):
        return
    unlike = np.argwhere(~_each_same(a, b, tolerance))
    first = tuple(int(i) for i in unlike[0])
    at = (first[0] + rows.start, *first[1:]) if rows is not None else first
    where = f"[{', '.join(map(str, at))}]" if at else ""
    more = f", and {several(len(unlike) - 1, 'value')} more" if len(unlike) > 1 else ""
    yield f"{path}{where}: {_shown(a[first])} in the file, {_shown(b[first])} computed{more}"


def _sizes(dims: tuple[str, ...], data: np.ndarray) -> str:
    return ", ".join(f"{name} {size}" for name, size in zip(dims, data.shape, strict=False)) or "none"


def _shown(value: Any) -> str:
    text = repr(value.item() if isinstance(value, np.generic) else value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _same_values(a: np.ndarray, b: np.ndarray, tolerance: float) -> bool:
    return a.shape == b.shape and bool(np.all(_each_same(a, b, tolerance)))


def _each_same(a: np.ndarray, b: np.ndarray, tolerance: float) -> np.ndarray:
    """Which values are the same: to the bit, but for zeros and nan of any sign; floats within a tolerance."""
    if a.dtype.kind in "OUS" or b.dtype.kind in "OUS":
        return np.asarray(a.astype(object) == b.astype(object), bool)
    same = (a == b) | (np.isnan(a) & np.isnan(b)) if a.dtype.kind == b.dtype.kind == "f" else a == b
    if tolerance and "f" in (a.dtype.kind, b.dtype.kind):
        finite = np.abs(b[np.isfinite(b)])
        with np.errstate(invalid="ignore"):
            same |= np.abs(a - b) <= tolerance * (finite.max() if finite.size else 0.0)
    return np.asarray(same, bool)
