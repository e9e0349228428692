"""Cost against size, within the engine: how it grows with runs, sources, fixes and workers."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from pathlib import Path

from kernels import landing
from measure import Curve, Job, Plan, alternate, seconds, spread, table, timed

from navsim.landing.study import fly_all
from navsim.runner.executor import threads

GOLDEN_DEG = 137.50776405
"""Azimuth from one source to the next, so that any number of them are spread."""

_TICKS = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Ratios that the figure names."""


def ensemble(count: int, *settings: str, workers: int = 1) -> Job:
    """So many landings of one Gaussian, of which statistics are kept."""
    case = landing("filter.kind=eskf", *settings)
    return timed(lambda: fly_all(case, 1, 0, count, threads(workers), keep="none"))


def sky(sources: int) -> tuple[str, ...]:
    """Settings of so many sources in all, two of them pseudolites."""
    fixed = [
        f"{{azimuth_deg: {i * GOLDEN_DEG % 360.0:.1f}, elevation_deg: {10.0 + i * 37.0 % 70.0:.1f}}}"
        for i in range(sources - 2)
    ]
    return ("sky.source=directions", f"sky.directions=[{', '.join(fixed)}]")


def curve(plan: Plan, what: str, unit: str, jobs: Mapping[float, Job], share: Mapping[float, float]) -> Curve:
    """Jobs by size, taken in turns; the first round, which may compile, does not count."""
    alternate(1, *jobs.values())
    took = alternate(plan.rounds(3), *jobs.values())
    return Curve(what, unit, dict(zip(jobs, took, strict=True)), "run", share)


def curves(plan: Plan) -> list[Curve]:
    """All of them; that by states is `kernels.by_states`."""
    few, many = plan.size(80, 8), plan.size(800, 64)
    counts = (8, few, many) if few > 8 else (8, many)
    sources, rates = (4, 10, 20, 40), (0.1, 0.3, 1, 3, 10)
    return [
        curve(plan, "runs", "", {n: ensemble(n) for n in counts}, {n: n for n in counts}),
        curve(plan, "sources", "", {n: ensemble(few, *sky(n)) for n in sources}, dict.fromkeys(sources, few)),
        curve(plan, "fixes a second", " Hz", {f: ensemble(few, f"receiver.rate_hz={f}") for f in rates},
              dict.fromkeys(rates, few)),
        curve(plan, "workers", "", {n: ensemble(many, workers=n) for n in (1, 2)}, {1: many, 2: many}),
    ]  # fmt: skip


def table_of(found: list[Curve]) -> list[str]:
    """The curves as a table, with their slopes."""
    rows = []
    for each in found:
        for size in each.seconds:
            first = size == next(iter(each.seconds))
            rows.append(
                (
                    each.what if first else "",
                    f"{size:g}{each.unit}",
                    spread(each.against_first(size), "×"),
                    seconds("", each.cost(size), per=f" a {each.per}").strip(),
                    f"{each.slope():.2f}" if first else "",
                )
            )
    return table(("against", "size", "cost, against the first", "seconds", "slope"), rows)


def draw(found: list[Curve], path: Path) -> None:
    """The curves as a figure."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.ticker import NullFormatter

    figure, axes = pyplot.subplots(
        1, len(found), figsize=(2.6 * len(found), 2.6), sharey=True, layout="constrained", squeeze=False
    )
    for axis, each in zip(axes[0], found, strict=True):
        sizes = list(each.seconds)
        rounds = [each.against_first(size) for size in sizes]
        middle = [statistics.median(values) for values in rounds]
        reach = [[m - min(v), max(v) - m] for m, v in zip(middle, rounds, strict=True)]
        axis.errorbar(sizes, middle, list(zip(*reach, strict=True)), marker="o", markersize=3, linewidth=1, capsize=2)
        axis.set(xscale="log", yscale="log", xlabel=each.what, title=f"slope {each.slope():.2f}")
        axis.set_xticks(sizes, [f"{size:g}" for size in sizes])
        axis.set_yticks(_TICKS, [f"{tick:g}" for tick in _TICKS])
        for side in (axis.xaxis, axis.yaxis):
            side.set_minor_formatter(NullFormatter())
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("cost of a run, against the first")
    figure.savefig(path, dpi=100)
    pyplot.close(figure)
