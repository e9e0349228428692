"""Data of an ensemble in its result for a merge of parts, which gives the same result as all runs at once.

Statistics of runs are columns of numbers, sums are those of `runner.exact_sums`. Both are stored for any `--keep`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import numpy as np

from navsim.results.builder import ResultBuilder
from navsim.results.result import Result
from navsim.results.schema import PART
from navsim.runner.batches import Batch, Ensemble
from navsim.runner.checkpoint import Arrays
from navsim.runner.exact_sums import blocks

_COLUMNS, _SUMS = f"{PART}/of_run", f"{PART}/sum"


def pack(draft: ResultBuilder, ensemble: Ensemble) -> None:
    """Write the merge data into a result."""
    numbers, names, layout = _flat(ensemble.columns())
    draft[f"{PART}/column"] = np.array(names, dtype=object)
    draft.put(_COLUMNS, numbers, {"layout": layout})
    if sums := ensemble.sums():
        numbers, names, layout = _flat(sums)
        draft[f"{PART}/block"] = np.array([first for first, _ in blocks(ensemble.first_run, ensemble.runs)])
        draft[f"{PART}/entry"] = np.arange(len(names))
        draft.put(_SUMS, numbers, {"layout": layout})


def mergeable(result: Result) -> bool:
    """Whether a result has the merge data."""
    return _COLUMNS in result


def batch_of(part: Result) -> Batch:
    """The runs of a part, without histories. Raises ResultError, ValueError for a damaged one."""
    return Batch(_arrays(part, _COLUMNS), _arrays(part, _SUMS) if _SUMS in part else {}, {})


def together(first_run: int, parts: Sequence[Batch]) -> Ensemble:
    """The ensemble of parts that follow each other."""
    ensemble = Ensemble(first_run, sum(len(next(iter(part.per_run.values()))) for part in parts))
    for part in parts:
        ensemble.add(part)
    return ensemble


def _flat(arrays: Arrays) -> tuple[np.ndarray, list[str], str]:
    """Arrays (n, ...) as one (n, m), the name of each column, and a description for the inverse."""
    rows = next(iter(arrays.values())).shape[0]
    numbers = np.concatenate([array.reshape(rows, -1).astype(float) for array in arrays.values()], axis=1)
    layout = [[name, array.dtype.str, list(array.shape[1:])] for name, array in arrays.items()]
    names = [name for name, array in arrays.items() for _ in range(math.prod(array.shape[1:]))]
    return numbers, names, json.dumps(layout)


def _arrays(part: Result, path: str) -> Arrays:
    """Inverse of `_flat`."""
    numbers = part[path]
    out, start = {}, 0
    for name, dtype, shape in json.loads(part.variables[path].attributes["layout"]):
        end = start + math.prod(shape)
        out[name] = numbers[:, start:end].reshape(len(numbers), *shape).astype(dtype)
        start = end
    return out
