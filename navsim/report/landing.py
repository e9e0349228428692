"""How landings are shown: side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING

from navsim.io.results import Result
from navsim.report.tables import summary_table
from navsim.report.view import View

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _figures(result: Result) -> dict[str, Figure]:
    from navsim.report import figures

    return figures.landing(result)


VIEW = View(lambda results: [summary_table(list(results))], 116, _figures, ("/summary/",), width_more=60)
