"""How a result of each kind is shown: its tables in the terminal and its figures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from navsim.io.results import Result, ResultError
from navsim.report import atc, azimuth, elevation, live, optimize, replay, sweep, table2

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType


@dataclass(frozen=True)
class View:
    """Tables for the terminal, the width they need, and figures by name."""

    console: Callable[[Result], RenderableType]
    width: int
    figures: Callable[[Result], dict[str, Figure]]


VIEWS = {
    "table2": View(table2.console, 170, table2.figures),
    "sweep": View(sweep.console, 150, sweep.figures),
    "atc-tracking": View(atc.console, 150, atc.figures),
    "azimuth-tracking": View(azimuth.console, 130, azimuth.figures),
    "mls-elevation": View(elevation.console, 140, elevation.figures),
    "live": View(live.console, 100, live.figures),
    "replay": View(replay.console, 110, replay.figures),
    "optimize": View(optimize.console, 140, optimize.figures),
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
