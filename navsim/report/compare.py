"""Comparison of results: different settings, and differences of their numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from navsim.report.table import ABSENT, Cell, Row, Table, cell
from navsim.results.result import Result, scenario_of

TEXTS = ("scenario", "study")
"""Root attributes with the inputs of a result."""
_ALIKE = "no intervals: the results share random numbers (seed and runs), or have no intervals"
_COUNTS = "counts are compared per run, or per the unit shown, not as totals"
_APART = "95 % intervals of differences and ratios by Zou and Donner (2008), for results of other seeds or runs"


def settings_of(result: Result) -> dict[str, str]:
    """Everything a result was computed from, by dotted keys."""
    found: dict[str, str] = {}
    for part in TEXTS:
        if part in result.attributes:
            _flatten(found, "" if part == "scenario" else f"{part}.", scenario_of(result, part))
    if any(key.startswith("pseudolites.sites.") for key in found):
        found.pop("pseudolites.count", None)  # 0, if present: the list is in its place
    return found


def _flatten(found: dict[str, str], key: str, node: Any) -> None:
    if isinstance(node, Mapping):
        for name, value in node.items():
            _flatten(found, f"{key}{name}.", value)
    elif isinstance(node, list) and any(isinstance(each, Mapping) for each in node):
        for i, value in enumerate(node):
            _flatten(found, f"{key}{i}.", value)
    else:
        found[key.removesuffix(".")] = "none" if node in ([], {}, None) else str(node)


def differences(names: Sequence[str], settings: Sequence[Mapping[str, str]]) -> Table | None:
    """Settings in which results differ; None for one result. The settings of a study's scenario are included."""
    if len(names) < 2:
        return None
    out = Table("", ("setting", *names), caption="In which settings the results differ")
    keys = dict.fromkeys(key for each in settings for key in each)
    for key in keys:
        values = [each.get(key, ABSENT) for each in settings]
        # the items of the others show that a list is empty
        empty = set(values) == {"none", ABSENT} and any(each.startswith(f"{key}.") for each in keys)
        if len(set(values)) > 1 and not empty and not key.startswith("study.set."):
            out.add(key, *values)
    return out


def independent(one: Result, other: Result) -> bool:
    """Whether runs of two results drew none of the same random numbers: by other seeds, or as other runs of one."""
    if any("/run" not in each or each.attributes.get("method") == "covariance" for each in (one, other)):
        return False
    same_seed = int(one.attributes["seed"]) == int(other.attributes["seed"])
    return not same_seed or not set(one["/run"].tolist()) & set(other["/run"].tolist())


def compared(
    results: Sequence[tuple[str, Result]], parts: Sequence[Table | str], each: Sequence[Sequence[Table | str]]
) -> list[Table | str]:
    """Tables of several results with differences from the first and ratios to it.

    parts: their tables side by side. each: tables of every result alone, for rows that results do not share.
    """
    names = [name for name, _ in results]
    apart = [independent(results[0][1], result) for _, result in results]
    out: list[Table | str] = []
    for part in parts:
        if isinstance(part, Table) and list(part.heads[1:]) == names:
            out.append(_widened(part, names, apart))
    if out:
        return out
    tables = [[part for part in of if isinstance(part, Table)] for of in each]
    for same in zip(*tables, strict=False):
        rows = [dict(_numbers(table)) for table in same]
        listed = Table(same[0].title, ("", *names), caption=same[0].caption)
        for label in rows[0]:
            if all(label in of for of in rows):
                listed.add(label, *(of[label] for of in rows))
        if listed.rows:
            out.append(_widened(listed, names, apart))
    return out


def _numbers(table: Table) -> list[tuple[str, Cell]]:
    """The numbers of a table, named by row and column."""
    return [
        (f"{str(row.cells[0]).strip()}: {head}", one)
        for row in table.rows
        for head, one in zip(table.heads[1:], row.cells[1:], strict=False)
        if isinstance(one, Cell) and not row.heading and _known(one)
    ]


def _known(one: Cell | str) -> bool:
    return isinstance(one, Cell) and bool(one.values) and isinstance(one.values[0], float | int)


def _widened(table: Table, names: Sequence[str], apart: Sequence[bool]) -> Table:
    heads = [*table.heads]
    for name in names[1:]:
        heads += [f"{name} - {names[0]}", f"{name} / {names[0]}"]
    rows = []
    for row in table.rows:
        cells = [*row.cells, *[""] * (len(table.heads) - len(row.cells))]
        if not row.heading:
            for i in range(1, len(names)):
                cells += _against(cells[1], cells[1 + i], apart[i])
        rows.append(Row(tuple(cells), row.heading))
    counted = any(isinstance(one, Cell) and one.trials for row in table.rows for one in row.cells)
    said = "\n".join(filter(None, (table.notes, _APART if any(apart[1:]) else _ALIKE, _COUNTS * counted)))
    caption = ". ".join(filter(None, (table.caption, f"Differences from {names[0]}, and ratios to it")))
    return replace(table, heads=tuple(heads), rows=rows, notes=said, caption=caption)


def _against(a: Cell | str, b: Cell | str, apart: bool) -> list[Cell | str]:
    """The difference of two cells and their ratio, with intervals where both have one and are independent."""
    if not (isinstance(a, Cell) and isinstance(b, Cell) and _known(a) and _known(b)):
        return [ABSENT, ABSENT]
    if a.trials or b.trials:
        return _counted(a, b)
    digits = _digits(b.pattern)
    if a.several or b.several:
        pairs = [(float(x), float(y)) for x, y in zip(a.values, b.values, strict=False)]
        differences = tuple(y - x for x, y in pairs)
        ratios = tuple(y / x if x else math.nan for x, y in pairs)
        names = b.names[: len(pairs)]
        return [Cell("  ".join([f"{{:+{digits}}}"] * len(pairs)), differences, several=True, names=names),
                Cell("  ".join(["{:.3f}"] * len(pairs)), ratios, several=True, names=names, unit="1")]  # fmt: skip
    x, y = float(a.values[0]), float(b.values[0])
    if not math.isfinite(x) or not math.isfinite(y):
        return [ABSENT, ABSENT]
    ratio = y / x if x else math.nan
    if not (apart and a.ends and b.ends):
        return [cell(f"{{:+{digits}}}", y - x), Cell("{:.3f}", (ratio,), unit="1")]
    (xl, xh), (yl, yh) = (tuple(float(v) for v in one.values[1:3]) for one in (a, b))
    pattern = f"{{:+{digits}}}  [{{:+{digits}}}, {{:+{digits}}}]"
    low, high = y - x - math.hypot(y - yl, xh - x), y - x + math.hypot(yh - y, x - xl)
    difference = Cell(pattern, (y - x, low, high), whole=True, ends=True)
    if min(x, y, xl, yl) <= 0.0:
        return [difference, Cell("{:.3f}", (ratio,), unit="1")]
    down = math.hypot(math.log(y / yl), math.log(xh / x))
    up = math.hypot(math.log(yh / y), math.log(x / xl))
    ends = (ratio, ratio * math.exp(-down), ratio * math.exp(up))
    return [difference, Cell("{:.3f}  [{:.3f}, {:.3f}]", ends, whole=True, ends=True, unit="1")]


def _counted(a: Cell, b: Cell) -> list[Cell | str]:
    """Difference of two counts, each a fraction of its total, and their ratio."""
    if not (a.trials and b.trials) or a.trial != b.trial:
        return [ABSENT, ABSENT]
    x, y = (float(one.values[0]) / one.trials for one in (a, b))
    ratio = y / x if x else math.nan
    return [Cell(f"{{:+.6g}} a {b.trial}", (y - x,), unit=f"1/{b.trial}"), Cell("{:.3f}", (ratio,), unit="1")]


def _digits(pattern: str) -> str:
    """Format of the first number of a pattern, without its sign."""
    found = re.search(r"\{:\+?(\.[0-9]+[a-z])\}", pattern)
    return found[1] if found else "g"
