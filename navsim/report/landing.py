"""Display of landings, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from navsim.report.requirement_rows import verdicts
from navsim.report.summary_tables import glance, summary_table
from navsim.report.table import Table
from navsim.report.view import View
from navsim.results.result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _rare(result: Result) -> bool:
    return bool(result.attributes["method"] == "rare")


def _tables(results: Sequence[tuple[str, Result]], every_source: bool = False) -> list[Table | str]:
    """A table of the summaries of flights, and one of the probabilities of leaving a box."""
    flights = [(name, result) for name, result in results if not _rare(result)]
    boxes = [(name, result) for name, result in results if _rare(result)]
    out: list[Table | str] = [summary_table(flights, every_source)] if flights else []
    if boxes:
        from navsim.report.rare import table

        out.append(table(boxes))
    return out


def _figures(result: Result) -> dict[str, Figure]:
    if _rare(result):
        from navsim.report import rare

        return rare.figures(result)
    from navsim.report import ensembles, figures, integrity, requirements

    drawn = figures.landing(result) | ensembles.figures(result) | requirements.figures(result)
    if "/interference/cn0" in result:
        drawn["interference"] = integrity.interference(result)
    if "/integrity/hpl" in result:
        drawn["integrity"] = integrity.levels(result)
        if "/integrity/status" in result:
            drawn["stanford"] = integrity.stanford(result)
    return drawn


VIEW = View(_tables, _figures, ("/summary/",), drawings="navsim.page.landing:drawings",
            verdicts=verdicts, glance=glance, with_small_rows=partial(_tables, every_source=True),
            of_runs=("errors", "nees", "fixes", "box", "integrity", "stanford"))  # fmt: skip
"""The summary of landings as a table, and of all results as plain data for JSON."""
