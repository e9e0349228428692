"""Speed of navsim as ratios within one run, against rivals, itself before and itself in other sizes; writes RESULTS.md.

Run by `make bench`, some twenty minutes. Every line is a ratio of jobs that took turns in this one run: the ratios
travel from machine to machine, the seconds beside them do not. `--quick` tries everything in two minutes with jobs too
small to conclude from, and `--only` some of it; both write to results/bench and leave RESULTS.md as it is.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # numpy as a rival of one thread, too

import argparse
import platform
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import processes
from measure import WORK, Curve, Line, Plan, table

BEFORE = "511ebbf"
"""The commit of the version before."""
ORIGINAL = "1ce67a8"
"""The commit of the first version."""

Section = Callable[[Plan], tuple[list[Line], list[Curve]]]


def _filters(plan: Plan) -> tuple[list[Line], list[Curve]]:
    import kernels

    return kernels.filters(plan), []


def _states(plan: Plan) -> tuple[list[Line], list[Curve]]:
    import kernels

    lines, curve = kernels.by_states(plan)
    return lines, [curve]


def _dops(plan: Plan) -> tuple[list[Line], list[Curve]]:
    import kernels

    return kernels.placements(plan), []


def _engines(plan: Plan) -> tuple[list[Line], list[Curve]]:
    import kernels

    return kernels.analysis(plan) + kernels.tracking(plan), []


def _curves(plan: Plan) -> tuple[list[Line], list[Curve]]:
    import curves

    return [], curves.curves(plan)


def _of(section: Callable[[Plan], list[Line]]) -> Section:
    return lambda plan: (section(plan), [])


SECTIONS: dict[str, Section] = {
    "before": _of(processes.against_before),
    "original": _of(processes.against_original),
    "world": _of(processes.world),
    "closed": _of(processes.closed_loop),
    "start": _of(processes.start),
    "landing": _of(processes.one_landing),
    "first": _of(processes.first_run),
    "workers": _of(processes.workers),
    "memory": _of(processes.memory),
    "filter": _filters,
    "states": _states,
    "dops": _dops,
    "engines": _engines,
    "curves": _curves,
}
"""What is measured, by name, in order; kernels are imported when it is their turn."""


def processor() -> str:
    """What the machine calls its processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":")[1].strip() for line in lines if "model name" in line), platform.processor())


def report(lines: list[Line], found: list[Curve], plan: Plan, figure: Path) -> str:
    """The whole of what is written; the figure is drawn where there are curves."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    text = [
        "# Speed, measured",
        "",
        f"{datetime.now(UTC):%Y-%m-%d}, {processor()}, {cores} cores, Python {platform.python_version()}, numpy "
        f"{np.__version__}. Made by `make bench`{' with --quick: too small to conclude from' if plan.quick else ''}.",
        "",
        "Every ratio is of jobs that took turns in this one run: median (range) over the rounds. Seconds beside them "
        "hold on this machine only.",
        f"Reference job: 120 s landing, 100 Hz, 12 000 steps. The version before is commit {plan.before}, the first "
        f"one {plan.original}.",
        "",
        *table(("what", "ratio", "must", "aim", "", "seconds"), (line.cells() for line in lines)),
    ]
    if found:
        import curves

        curves.draw(found, figure)
        text += [
            "",
            "## Cost against size",
            "",
            "In one process, `eskf`, one worker but where workers are counted. Slope: of log cost by log size; 1 where "
            "twice the size costs twice as much, 0 where it costs the same.",
            "27 states: Markov biases beside the biases and scale factors, handed to the filter's loop; scenarios "
            "offer 15 and 21.",
            "",
            *curves.table_of(found),
            "",
            f"![Cost against size]({figure.name})",
        ]
    return "\n".join([*text, ""])


def main() -> int:
    """Measure, write the report, return 1 where a must is missed by jobs of full size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--quick", action="store_true", help="everything in two minutes, too small to conclude from")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, metavar="PART", help=f"some of {', '.join(SECTIONS)}")
    parser.add_argument("--out", type=Path, help="where to write; the figure beside it")
    options = parser.parse_args()
    plan = Plan(options.quick, BEFORE, ORIGINAL)
    whole = not (options.quick or options.only)
    out = options.out or (Path(__file__).resolve().parent if whole else WORK) / "RESULTS.md"
    out.parent.mkdir(parents=True, exist_ok=True)
    lines: list[Line] = []
    found: list[Curve] = []
    text = ""
    for name in options.only or SECTIONS:
        start = time.perf_counter()
        more, grown = SECTIONS[name](plan)
        lines += more
        found += grown
        # after every part, so that a later one that fails takes nothing with it
        text = report(lines, found, plan, out.with_name("curves.png"))
        out.write_text(text)
        print(f"{name}: {time.perf_counter() - start:.0f} s", file=sys.stderr)
    print(text)
    return 0 if plan.quick or all(line.holds for line in lines) else 1


if __name__ == "__main__":
    sys.exit(main())
