"""Verification of an ensemble of landings without flying all of it again.

- The statistics of all runs give every table: they are computed again from the data of the group `/part`.
- Histories of runs give their own statistics, as far as the histories are stored.
- Drawn runs are flown again. An altered run that is not drawn, and agrees with its statistics, is not found.
"""

from __future__ import annotations

import math
import secrets
from collections.abc import Iterable
from typing import Any

import numpy as np

from navsim.compiler.lanes import WIDTH
from navsim.filter import states
from navsim.landing import rare_events
from navsim.landing.case import MOVING, Case
from navsim.landing.ensemble import LandingStudy, add_ratios, at_heights, finite_means, mean_square
from navsim.landing.merge import keep_of
from navsim.landing.result import result as result_of
from navsim.results.result import Result
from navsim.results.schema import PART
from navsim.runner.batches import Ensemble
from navsim.runner.exact_sums import Sums
from navsim.runner.job import Options
from navsim.runner.merge_state import batch_of, together
from navsim.runner.verification import FOREIGN, OTHER_CODE, Recomputation, attribute_differences, differences


def options_of(result: Result, options: Options) -> Options:
    """Options that compute a result of landings again: its own runs, however they were chosen."""
    if "/run" not in result or result.attributes.get("method") == "covariance":
        return Options(options.seed)
    runs, keep = result["/run"], keep_of(result)
    rare = result.attributes.get("method") == "rare"
    return Options(options.seed, int(runs.size), int(runs[0]), keep=None if rare else keep)


def check_ensemble(again: Recomputation, runs: int) -> None:
    """Check tables, histories and as many drawn runs."""
    numbers = again.result["/run"]
    wrong = [] if np.array_equal(numbers, numbers[0] + np.arange(numbers.size)) else ["/run: its numbers have gaps"]
    case, seed = again.job.case, again.job.seed
    ensemble = together(int(numbers[0]), [batch_of(again.result)])
    if ensemble.runs != numbers.size:
        again.out.add("tables", [f"{PART} has {ensemble.runs} runs, /run has {numbers.size}"], "")
        return
    other = (
        rare_events.result(case, again.job.edge, ensemble, seed)
        if case.scenario.method == "rare"
        else result_of(case, ensemble, seed, keep="none")
    )
    wrong += attribute_differences(again.result, other, again.tolerance)
    again.out.add("attributes", wrong, f"{len(other.attributes)} computed again", again.verdict)
    tables = other.variables.keys()
    wrong = [*differences(again.result, other, again.tolerance, tables.__contains__)]
    text = f"{len(tables)} variables computed again from statistics of all runs"
    again.out.add("tables", wrong, text, again.verdict)
    if "/filter/error" in again.result:
        _check_histories(again, case, ensemble)
    _compare_drawn_runs(again, runs, set(tables))


def _check_histories(again: Recomputation, case: Case, ensemble: Ensemble) -> None:
    """Compare statistics of runs with those that the stored histories give."""
    stored, study = again.result, LandingStudy(case, again.job.seed, "none")
    columns, first, runs = ensemble.columns(), ensemble.first_run, ensemble.runs
    every, moving = (case.degrees(part) or math.nan for part in (slice(None), MOVING))
    sums, ratios = Sums(), Sums()
    wrong: dict[str, dict[int, None]] = {}  # runs by path, in order
    step = 32
    for begin in range(0, runs, step):
        end = min(begin + step, runs)
        names = ("error", "sigma", "nees", "nees_position_velocity", "innovation_squared")
        error, sigma, nees, nees_moving, squares = (
            stored.variables[f"/filter/{name}"].data.rows(begin, end) for name in names
        )
        mean = mean_square(error[:, study.window])
        given = {
            "position_square": ("/filter/error", mean[:, states.SLICES["position"]]),
            "at_height": ("/filter/error", at_heights(case, study.crossings, error)),
            "nees_mean": ("/filter/nees", finite_means(nees[:, 1:]) / every),
            "nees_position_velocity_mean": (
                "/filter/nees_position_velocity", finite_means(nees_moving[:, 1:]) / moving
            ),
            "innovations": ("/filter/innovation_squared", np.nansum(squares, axis=1)),
        }  # fmt: skip
        for name, (path, values) in given.items():
            there = columns[name][begin:end]
            same = np.isclose(values, there, rtol=again.tolerance, atol=again.tolerance, equal_nan=True)
            for row in np.flatnonzero(~same.reshape(end - begin, -1).all(axis=1)):
                wrong.setdefault(path, {})[first + begin + int(row)] = None
        add_ratios(ratios, first + begin, error, sigma)
        variance = mean_square(sigma[:, study.window])
        for i in range(end - begin):
            sums.add(first + begin + i, 1, {
                "mean_square": mean[i], "variance": variance[i], "nees": nees[i] / every,
                "nees_position_velocity": nees_moving[i] / moving,
            })  # fmt: skip
    texts = [
        f"{path}: run {_first_of(numbers)} does not give the statistics of {PART}" for path, numbers in wrong.items()
    ]
    of_sums = {"nees": "/filter/nees", "nees_position_velocity": "/filter/nees_position_velocity",
               "variance": "/filter/sigma"}  # fmt: skip
    for name, values in (sums.arrays() | ratios.arrays()).items():
        there = ensemble.sums()[name]
        if not np.allclose(values, there, rtol=again.tolerance, atol=again.tolerance, equal_nan=True):
            path = of_sums.get(name, "/filter/error or /filter/sigma")
            texts.append(f"{path}: its runs do not give the sum {name} of {PART}")
    text = f"errors and sigmas of {runs} runs give the stored statistics"
    again.out.add("histories", texts, text, again.verdict)


def _compare_drawn_runs(again: Recomputation, runs: int, tables: set[str]) -> None:
    """Fly drawn runs, as many side by side as a register has lanes, and compare all that is stored of them.

    tables: variables that statistics of all runs gave.
    """
    numbers, job = again.result["/run"], again.job
    first, count = int(numbers[0]), int(numbers.size)
    blocks = list(range(0, count, WIDTH))
    drawn = sorted(secrets.SystemRandom().sample(blocks, min(len(blocks), -(-runs // WIDTH))))
    wrong: list[str] = []
    flown, foreign = 0, bool(drawn)
    for begin in drawn:
        size = min(WIDTH, count - begin)
        job.first, job.runs = first + begin, size
        other = job.run(again.executor, None, lambda *_: None).result
        wanted = {path for path, v in other.variables.items() if v.dims[:1] == ("run",)}
        wanted |= {path for path in again.result.variables if path not in tables} | (set(other.variables) - tables)
        rows = slice(begin, begin + size)
        unlike = [*differences(again.result, other, again.tolerance, wanted.__contains__, rows)]
        foreign &= len(unlike) > 0.5 * len(wanted)
        wrong += unlike
        flown += size
        again.tell(flown)
    if again.verdict == OTHER_CODE:
        wrong[:0] = ["--runs all repeats every run and compares what tables print"] * bool(wrong)
    elif foreign:
        wrong.insert(0, FOREIGN)
    text = (
        f"{flown} of {count} drawn and flown again: {_blocks(first, drawn, count)}. One altered run among the others "
        f"would be found with a probability of {flown / count:.0%}; --runs all flies all"
    )
    again.out.add("runs", wrong, text, again.verdict)


def _first_of(numbers: Iterable[int]) -> str:
    known = [*numbers]
    return ", ".join(map(str, known[:4])) + (" ..." if len(known) > 4 else "")


def _blocks(first: int, drawn: list[int], count: int) -> str:
    shown: list[Any] = [f"{first + b} to {first + min(b + WIDTH, count) - 1}" for b in drawn[:4]]
    return ", ".join(shown) + (" ..." if len(drawn) > 4 else "")
