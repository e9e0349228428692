"""Merge partial ensembles into one result, identical to a single run of all.

What all runs share is computed again from the scenario in every part and compared with the parts. The summary follows
from the statistics and sums in every part (`runner.merge_state`). Histories are concatenated.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import navsim
from navsim.landing import rare_events
from navsim.landing.case import Case, prepare
from navsim.landing.ensemble import FIRST_ORDER, LandingStudy
from navsim.landing.result import result
from navsim.results.findings import several
from navsim.results.result import BLOCK_BYTES, Result, Stream, Variable
from navsim.results.schema import FINDINGS, INPUTS, PART, PROVENANCE, SCHEMA_VERSION
from navsim.runner.batches import Batch
from navsim.runner.job import OptionError
from navsim.runner.merge_state import batch_of, mergeable, together
from navsim.scenario.landing import Landing
from navsim.scenario_files.base import validated
from navsim.scenario_files.source import InputError, parse

Parts = list[tuple[Path, Result]]
"""Results by the files they are in."""
_KEEPS = {"all": "/measurements/pseudorange", "errors": "/filter/error"}
"""Variable that identifies each value of `--keep`; `statistics` has none."""
_DEGREES = "degrees_of_freedom"


def ordered(given: Parts) -> Parts:
    """The parts in the order of their runs. Raises OptionError unless they are all parts of one ensemble, each run
    once."""
    first_file, first = given[0]
    for file, one in given:
        kind, method = (str(one.attributes.get(name, "")) for name in ("kind", "method"))
        if kind != "landing" or method == "covariance":
            what = f"kind {kind}" if kind != "landing" else "method covariance"
            raise OptionError(f"{file}: is not part of an ensemble of landings but of {what}")
        if not mergeable(one):
            raise OptionError(f"{file}: has no {PART}, written by an earlier version of navsim; fly it again")
        mine, theirs = _identity(one), _identity(first)
        unlike = [
            f"{name} {theirs[name]} in {first_file}, {mine[name]} here" for name in mine if mine[name] != theirs[name]
        ]
        if unlike:
            raise OptionError(f"{file}: is of another ensemble than {first_file}: {'; '.join(unlike)}")
    if (version := first.attributes["navsim_version"]) != navsim.__version__:
        raise OptionError(
            f"{first_file}: was flown by navsim {version}; this is {navsim.__version__}, merge it by that"
        )
    if (schema := int(first.attributes["schema_version"])) != SCHEMA_VERSION:
        raise OptionError(f"{first_file}: is a result of schema {schema}; this navsim writes {SCHEMA_VERSION}")
    for file, one in given:
        runs = one["/run"]
        if not runs.size or not np.array_equal(runs, np.arange(runs[0], runs[0] + runs.size)):
            raise OptionError(f"{file}: its runs are not numbered one after the other")
    parts = sorted(given, key=lambda named: int(named[1]["/run"][0]))
    wrong = [text for before, after in itertools.pairwise(parts) if (text := _between(before, after))]
    if wrong:
        raise OptionError("; ".join(wrong))
    return parts


def keep_of(one: Result) -> str:
    """The `--keep` that a result was flown with."""
    return next((keep for keep, path in _KEEPS.items() if path in one), "none")


def _identity(one: Result) -> dict[str, str]:
    """Data that parts must agree in, by name."""
    a = one.attributes
    return {
        "navsim": str(a["navsim_version"]), "schema": str(a["schema_version"]), "method": str(a["method"]),
        "seed": str(a["seed"]), "--keep": keep_of(one), "scenario of SHA-256": str(a["scenario_sha256"])[:12],
    }  # fmt: skip


def _between(before: tuple[Path, Result], after: tuple[Path, Result]) -> str:
    """Error between two adjacent parts, "" for none."""
    (one, a), (other, b) = before, after
    end, start = int(a["/run"][-1]), int(b["/run"][0])
    if start > end + 1:
        return f"{_numbers(end + 1, start - 1)} missing between {one} and {other}"
    if start <= end:
        return f"{_numbers(start, min(end, int(b['/run'][-1])))} in both {one} and {other}"
    return ""


def _numbers(first: int, last: int) -> str:
    return f"run {first} is" if first == last else f"runs {first} to {last} are"


def case_of(parts: Parts, folder: Path) -> Case:
    """The case that the parts were flown of. folder: where the files lie that the scenario names. Raises InputError,
    OptionError."""
    file, first = parts[0]
    document = parse(str(first.attributes["scenario"]), f"{file}, scenario", folder)
    try:
        return prepare(validated(Landing, document), document)
    except InputError as error:
        advice = "--folder says where the files lie that the scenario names"
        raise OptionError("\n".join([*map(str, error.problems), advice])) from None


def merged(parts: Parts, case: Case) -> Result:
    """Merge of parts in order.

    Raises OptionError if they do not belong to this case, or if their code or processors give different numbers;
    ResultError, ValueError for damaged files.
    """
    file, first = parts[0]
    seed = int(first.attributes["seed"])
    ensemble = together(int(first["/run"][0]), _batches(parts, case, seed))
    if case.scenario.method == "rare":
        whole = rare_events.result(case, rare_events.prepare(case), ensemble, seed)
    else:
        whole = result(case, ensemble, seed, keep="none")
    if whole.attributes["scenario_sha256"] != first.attributes["scenario_sha256"]:
        raise OptionError(f"{file}: its scenario has changed: the satellite files that it names are different now")
    for name in whole.attributes:
        if name not in ("created", *first.attributes):
            raise OptionError(f"{file}: has no root attribute {name}")
    for path, variable in first.variables.items():
        if variable.dims[:1] == ("run",) and path not in whole:
            whole.variables[path] = _one_after_the_other(path, parts)
        elif path.startswith(INPUTS):
            whole.variables[path] = variable
        elif _shared(path):
            whole.variables.setdefault(path, variable)
            for other_file, other in parts:
                if path not in other or not _same(other.variables[path], whole.variables[path]):
                    raise OptionError(
                        f"{other_file}: {path}, common to all runs, differs from the others: it was computed by other "
                        "code, another numba or another type of processor; compute it again here"
                    )
    return whole


def _batches(parts: Parts, case: Case, seed: int) -> list[Batch]:
    """The runs of the parts. A landing that was flown by itself has no first-order error: it is flown again, where the
    others have it."""
    batches = [batch_of(one) for _, one in parts]
    if not any(FIRST_ORDER in batch.per_run for batch in batches):
        return batches
    study = LandingStudy(case, seed, "none", case.first_order)
    return [
        batch if FIRST_ORDER in batch.per_run else Batch(*study.batch(int(one["/run"][0]), one["/run"].size))
        for batch, (_, one) in zip(batches, parts, strict=True)
    ]


def _shared(path: str) -> bool:
    """Whether a variable is the same in all parts."""
    own = ("/summary/", "/consistency/", "/rare/", f"{PART}/", f"{FINDINGS}/", f"{PROVENANCE}/")
    return path != "/run" and not path.startswith(own)


def _same(one: Variable, other: Variable) -> bool:
    """Whether variables are the same to the bit; one may be a Stream."""
    a, b = np.asarray(one.data), np.asarray(other.data)
    texts = [array.dtype.kind in "OU" for array in (a, b)]
    if a.shape != b.shape or texts[0] != texts[1]:
        return False
    return a.tolist() == b.tolist() if texts[0] else a.dtype == b.dtype and a.tobytes() == b.tobytes()


def _one_after_the_other(path: str, parts: Parts) -> Variable:
    """A history of all parts."""
    some = [one.variables[path] for _, one in parts]
    shape = (sum(v.data.shape[0] for v in some), *some[0].data.shape[1:])
    odd = next((file for (file, _), v in zip(parts, some, strict=True) if v.data.shape[1:] != shape[1:]), None)
    if odd is not None:
        raise OptionError(f"{odd}: {path} has other dimensions than in {parts[0][0]}")
    attributes = dict(some[0].attributes)
    if _DEGREES in attributes:  # the most that any run has
        attributes[_DEGREES] = max(v.attributes[_DEGREES] for v in some)
    return replace(some[0], data=Stream(shape, some[0].data.dtype, lambda: _blocks(some)), attributes=attributes)


def _blocks(some: Sequence[Variable]) -> Iterator[np.ndarray]:
    for variable in some:
        yield from variable.data.blocks()


def read_through(one: Result) -> None:
    """Read all of a part once, to find damage before the merge. Raises ResultError."""
    for variable in one.variables.values():
        for _ in _pieces(variable):
            pass


def _pieces(variable: Variable) -> Iterable[np.ndarray]:
    data = variable.data
    if not data.shape or data.dtype.kind in "UO" or data.nbytes <= BLOCK_BYTES:
        return [np.asarray(data)]
    return data.blocks()


def describe_parts(parts: Parts) -> str:
    """The parts in a line."""
    first, last = int(parts[0][1]["/run"][0]), int(parts[-1][1]["/run"][-1])
    return f"{several(len(parts), 'part')}, runs {first} to {last}"
