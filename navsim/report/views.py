"""How a result of each kind is shown: its tables in the terminal and its figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from navsim.io.results import Result, ResultError
from navsim.report import atc, azimuth, elevation, live, optimize, replay, sweep, table2
from navsim.report.table import Table, console

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


@dataclass(frozen=True)
class View:
    """Tables and words between them, the width they need in a terminal, and figures by name."""

    tables: Callable[[Result], list[Table | str]]
    width: int
    figures: Callable[[Result], dict[str, Figure]]

    def console(self, result: Result) -> RenderableType:
        """The tables, for the terminal."""
        return console(self.tables(result))


VIEWS = {
    "table2": View(table2.tables, 170, table2.figures),
    "sweep": View(sweep.tables, 150, sweep.figures),
    "atc-tracking": View(atc.tables, 150, atc.figures),
    "azimuth-tracking": View(azimuth.tables, 130, azimuth.figures),
    "mls-elevation": View(elevation.tables, 140, elevation.figures),
    "live": View(live.tables, 100, live.figures),
    "replay": View(replay.tables, 110, replay.figures),
    "optimize": View(optimize.tables, 140, optimize.figures),
}
"""Kinds with tables of their own; landings stand side by side (`report.tables`)."""


def save(result: Result, folder: Path, stem: str) -> list[Path]:
    """Draw every figure a result has data for as `folder/stem_NAME.png`; returns the files. Raises ResultError."""
    from navsim.report import figures

    kind = str(result.attributes["kind"])
    if kind == "landing":
        return figures.save_figures(lambda: figures.landing(result), folder, stem)
    if kind not in VIEWS:
        raise ResultError(f"there are no figures for results of kind {kind}")
    return figures.save_figures(lambda: VIEWS[kind].figures(result), folder, stem)
