"""Tables of the capabilities of few satellites and pseudolites by rank, and of the usefulness of their levels in an
approach."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from navsim.report.result_cells import setting
from navsim.report.table import ABSENT, Cell, Table
from navsim.report.view import View, one_by_one
from navsim.results.result import Result, ResultError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LETTERS = {"F": "fix", "D": "detection", "X": "exclusion", "G": "ground_loss"}
"""Letters of flags, and their names in the result."""
_LEGEND = (
    "F a fix; D every single fault is detectable; X every single fault is excludable; G every single fault is "
    "detectable, and the loss of all pseudolites leaves a fix"
)


def method(result: Result) -> str:
    """Monitor of the fixes."""
    return str(setting(result, "integrity", "method"))


def _table(result: Result, title: str) -> Table:
    return Table(title, ("pseudolites", *(f"{n} satellites" for n in result["/satellites"])))


def _possible(result: Result) -> Table:
    out = _table(result, "Possible, by rank, sources on one clock")
    flags = {letter: result[f"/possible/{name}"] for letter, name in _LETTERS.items()}
    for k, added in enumerate(result["/pseudolites"]):
        text = (
            " ".join(letter for letter, there in flags.items() if there[k, i])
            for i in range(result["/satellites"].size)
        )
        out.add(str(added), *(text or ABSENT for text in text))
    return out


def _pairs(result: Result, title: str, pattern: str, *names: str) -> Table:
    """A table with two numbers a cell."""
    out = _table(result, title)
    for k, added in enumerate(result["/pseudolites"]):
        pairs = zip(*(result[f"/subsets/{name}"][k].tolist() for name in names), strict=True)
        cells = (Cell(pattern, pair, names=names) if np.isfinite(pair).any() else ABSENT for pair in pairs)
        out.add(str(added), *cells)
    return out


def _useful(result: Result) -> list[Table]:
    here = f"by levels ({method(result)})"
    shares = _pairs(
        result, f"Useful, {here}: share of epochs with {limits(result)}, worst / median subset",
        "{:.2f} / {:.2f}", "worst", "median",
    )  # fmt: skip
    counts = zip(result["/subsets/number"].tolist(), result["/subsets/number_of_all"].tolist(), strict=True)
    names = ("count", "of")
    shares.add("subsets", *(Cell("{} of {}", pair, trials=pair[1], trial="subset", names=names) for pair in counts))
    title = "The levels themselves: HPL / VPL, m, median over epochs, median subset"
    return [shares, _pairs(result, title, "{:.0f} / {:.0f}", "hpl", "vpl")]


def limits(result: Result) -> str:
    """Limits of the levels, in words."""
    asked = {"HPL": float(result["/subsets/hal"]), "VPL": float(result["/subsets/val"])}
    return " and ".join(f"{name} <= {most:g} m" for name, most in asked.items() if np.isfinite(most))


def _explained(result: Result) -> str:
    """Text below the fractions."""
    names = {noun: list(map(str, result[f"/subsets/{noun}"])) for noun in ("satellite", "pseudolite")}
    time = result.variables["/glide/time"]
    count, whole = time.data.shape[0], time.attributes["epochs_of_glide"]
    lines = [
        f"scenario: {result.attributes['title']}",
        f"epochs: {count} of the {whole} fix epochs of the glide, evenly spread",
        f"satellites: the {len(names['satellite'])} used throughout the glide, {_listed(names['satellite'])}; "
        f"subsets of them, where not all, are drawn by seed {result.attributes['seed']}",
        f"pseudolites: in this order, {_listed(names['pseudolite'])}",
        "median subset: more than half of the subsets are as good or better",
    ]
    if "/subsets/fault" in result:
        faults, priors = result["/subsets/fault"], result["/subsets/prior"]
        text = (f"{prior:g} of {', '.join(map(str, faults[priors == prior]))}" for prior in np.unique(priors))
        lines.append(f"priors of faults: {'; '.join(text)}")
    return "\n".join(f"- {line}" for line in lines)


def _listed(names: list[str]) -> str:
    return ", ".join(names) or "none"


def tables(result: Result) -> list[Table | str]:
    """Both tables, and their subject."""
    head = "Rank: possible or not. Protection levels: useful or not."
    return [head, _possible(result), _LEGEND, *_useful(result), _explained(result)]


def figures(result: Result) -> dict[str, Figure]:
    """Raises ResultError: there are none."""
    raise ResultError(f"a result of kind {result.attributes['kind']} has no figures; navsim show prints its tables")


def more(result: Result) -> dict[str, Any]:
    """Plain data in addition to the result's variables."""
    return {"method": method(result)}


VIEW = View(
    one_by_one(tables), figures, ("/pseudolites", "/satellites", "/possible", "/subsets"), more,
    drawings="navsim.published_tables.page:few_satellites",
)  # fmt: skip
