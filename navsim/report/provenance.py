"""Provenance of results: their files, software and inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from navsim.report.table import ABSENT, Table
from navsim.results import files
from navsim.results.result import Result

_HEADS = {
    "kind": "kind", "title": "title", "method": "method", "seed": "seed", "epoch": "epoch", "created": "computed at",
    "navsim_version": "navsim", "schema_version": "version of the layout", "scenario_sha256": "SHA-256 of the scenario",
    "combinations": "combinations", "objective": "objective", "replaced_block": "replaced by a stream",
}  # fmt: skip
"""Root attributes of provenance, and their headings."""


@dataclass(frozen=True)
class Read:
    """A result that was read, with its name and the path of its file."""

    name: str
    path: Path
    result: Result


def provenance(read: Sequence[Read]) -> Table:
    """Files and software of results, a column for each."""
    caption = "Where the results come from; times are UTC"
    out = Table("", ("", *(each.name for each in read)), caption=caption)
    out.add("file", *(str(each.path) for each in read))
    out.add("SHA-256 of the file", *(_sum(each.path) for each in read))
    for attribute, text in _HEADS.items():
        if any(attribute in each.result.attributes for each in read):
            out.add(text, *(str(each.result.attributes.get(attribute, ABSENT)) for each in read))
    if any("/run" in each.result for each in read):
        out.add("runs", *(_runs(each.result) for each in read))
    return out


def _runs(result: Result) -> str:
    """Runs in a result: their number, the first and the last."""
    if "/run" not in result or result.attributes.get("method") == "covariance" or not result["/run"].size:
        return ABSENT
    numbers = result["/run"]
    return f"{numbers.size} ({numbers[0]} to {numbers[-1]})"


def _sum(path: Path) -> str:
    try:
        return files.checksum(path)
    except OSError as error:  # too large to be summed now
        return f"{ABSENT} ({error.strerror})"
