"""Rows of total system errors, deviations that pilots see, touchdowns and go-arounds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from navsim.report.result_cells import count_cell, heights_of, percentile_cell, runs_of, share_cell, single
from navsim.report.table import ABSENT, Cell, Table, number
from navsim.results.result import Result
from navsim.results.schema import INDICATED


def system_error_heading(result: Result) -> str:
    """The numbers of `total_error`."""
    errors = "navigation, flight-technical, total"
    if single(result):
        return errors
    return f"{errors}: RMS" + ("; correlation" if "/summary/guidance/loop_gap" in result else "")


def total_error(result: Result, axis: str, height: int) -> Cell | str:
    """Navigation, flight-technical and total system error at a height; of runs that are steered by their estimates also
    the correlation, about zero, of the first two."""
    path = f"/summary/at/{axis}"
    if f"{path}_tse" not in result:
        return ABSENT
    suffix, place = ("_run", (0, height)) if single(result) else ("", (height, 0))
    found = [float(result[f"{path}{kind}{suffix}"][place]) for kind in ("", "_fte", "_tse")]
    if not np.isfinite(found).all():
        return ABSENT
    if single(result) or "/summary/guidance/loop_gap" not in result or 0.0 in found[:2]:  # no correlation with nothing
        return Cell("{:.3f}  {:.3f}  {:.3f}", tuple(found), names=("nse", "fte", "tse"))
    navigation, technical, total = found
    both = (total**2 - navigation**2 - technical**2) / (2.0 * navigation * technical)
    return Cell("{:.3f}  {:.3f}  {:.3f}  {:+.2f}", (*found, both), names=("nse", "fte", "tse", "correlation"))


def ending_rows(table: Table, results: list[tuple[str, Result]]) -> None:
    """Sizes of total system errors, deviations that pilots see, touchdowns, go-arounds."""

    def row(label: str, shown: Any) -> None:
        table.add(label, *(shown(r) for _, r in results))

    def levels(result: Result) -> str:
        return "  ".join(f"{p} %" for p in result["/summary/percentile"]) + " of runs below"

    def section(title: str, path: str, shown: Callable[[Result], str]) -> bool:
        there = any(path in r for _, r in results)
        if there:
            table.head(title, *(shown(r) if path in r else "" for _, r in results))
        return there

    several = not all(single(r) for _, r in results)
    if several and section("Size of the total system error, m", "/summary/at/lateral_tse_percentile", levels):
        for i, label in heights_of([r for _, r in results]).items():
            for name in ("lateral", "along", "vertical"):
                path = f"/summary/at/{name}_tse_percentile"
                row(f"  {label}, {name}", lambda r, p=path, i=i: percentile_cell(r, p, i) if p in r else ABSENT)
    if section("Largest deviation, parts of full scale", "/summary/indicator/localizer_percentile", levels):
        for name in INDICATED:
            for kind, whose in (("", "aircraft"), ("_indicated", "indicated")):
                path = f"/summary/indicator/{name}{kind}"
                row(f"  {name.replace('_', ' ')}, {whose}",
                    lambda r, p=f"{path}_percentile": percentile_cell(r, p) if p in r else ABSENT)  # fmt: skip
                row(f"  {name.replace('_', ' ')}, {whose}: runs beyond half scale",
                    lambda r, p=f"{path}_beyond_half": share_cell(r, p))  # fmt: skip
    if section("Touchdown", "/summary/touchdown/along", lambda r: "value" if single(r) else "mean, sigma"):
        for label, name in (("beyond the threshold, m", "along"), ("right of the centre line, m", "lateral"),
                            ("sink rate, m/s", "sink_rate")):  # fmt: skip
            row(f"  {label}", lambda r, n=name: _touchdown(r, n))
    if section("Go-arounds after an alarm", "/summary/go_around/share", lambda r: f"of {runs_of(r)}"):
        row("  share of runs", lambda r: share_cell(r, "/summary/go_around/share"))
        row("  height lost, m", lambda r: percentile_cell(r, "/summary/go_around/lost_percentile"))
        row("  largest height lost, m", lambda r: _of_go_around(r, "lost_largest"))
        row("  that touch the ground", lambda r: count_cell(r, "/summary/go_around/touched"))


def _touchdown(result: Result, name: str) -> Cell | str:
    """Mean and sigma of a number of touchdowns; of one run the number."""
    path = f"/summary/touchdown/{name}"
    if path not in result or not np.isfinite(mean := float(result[path][0])):
        return ABSENT
    if not np.isfinite(sigma := float(result[f"{path}_sigma"])):
        return number(mean, 2)
    return Cell("{:.2f}  {:.2f}", (mean, sigma), names=("mean", "sigma"))


def _of_go_around(result: Result, name: str) -> Cell | str:
    path = f"/summary/go_around/{name}"
    return number(float(result[path]), 2) if path in result and np.isfinite(result[path]) else ABSENT
