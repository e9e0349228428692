"""What a result was computed from: files with their digests, code, libraries, machine, options.

Two results are the same to the bit if all of it is the same. Another version of the code or of a library, or another
type of processor, may round differently.
"""

from __future__ import annotations

import json
import platform
from dataclasses import dataclass, fields
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from navsim.results import files
from navsim.results.builder import ResultBuilder
from navsim.results.result import Result, Variable
from navsim.results.schema import INPUTS, LANDING, PROVENANCE, SOFTWARE
from navsim.runner.job import Options

CODE, OPTIONS, PROCESSOR, INSTRUCTIONS = "code of navsim", "options", "processor", "instructions"
"""Items: SHA-256 of the package's sources, options that change numbers, type and instruction sets of the processor."""
LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "h5py", "pyyaml", "pydantic", "sgp4", "shapely")
"""Packages that numbers may depend on."""
_NUMBERS = ("runs", "first_run", "until", "keep", "method", "time_limit", "bet")
"""Options that change a result; the seed is a root attribute."""


@dataclass(frozen=True)
class InputFile:
    """A file that was read. name: as written there. key: that names it, "" for the scenario or study itself."""

    name: str
    key: str
    sha256: str
    size: int

    def __str__(self) -> str:
        return f"{self.name} ({self.key})" if self.key else self.name


def inputs_of(job: Any) -> dict[tuple[str, str], InputFile]:
    """Files of a prepared job, by name and key. Files that are gone or too large are left out."""
    document = getattr(job, "document", None)
    if document is None:
        return {}
    from navsim.scenario_files.source import dotted

    found = {(document.file, ""): Path(document.file)}
    found |= {(name, dotted(path)): file for (path, name), file in list(document.named.items())}
    out = {}
    for (name, key), file in found.items():
        try:
            out[name, key] = InputFile(name, key, files.checksum(file), file.stat().st_size)
        except OSError:  # a scenario from Python's data has no file
            continue
    return out


def provenance(job: Any, options: Options, read: dict[tuple[str, str], InputFile]) -> dict[str, Variable]:
    """Variables of the group `/provenance` of a job's result.

    read: files as they were before the work; those that it read later are added.
    """
    out = ResultBuilder(LANDING)
    if getattr(job, "document", None) is not None:  # merged results have those of their parts
        inputs = list((inputs_of(job) | read).values())
        out[INPUTS] = np.array([each.name for each in inputs], dtype=object)
        out[f"{INPUTS}_key"] = np.array([each.key for each in inputs], dtype=object)
        out[f"{INPUTS}_sha256"] = np.array([each.sha256 for each in inputs], dtype=object)
        out[f"{INPUTS}_bytes"] = np.array([each.size for each in inputs], dtype=np.int64)
    given = {name: value for name in _NUMBERS if (value := getattr(options, name)) is not None}
    items = software() | {OPTIONS: json.dumps(given)}
    out[SOFTWARE] = np.array(list(items), dtype=object)
    out[f"{PROVENANCE}/value"] = np.array(list(items.values()), dtype=object)
    return {path: variable for path, variable in out.variables.items() if path.startswith(PROVENANCE)}


@cache
def software() -> dict[str, str]:
    """Code, libraries and machine of this process."""
    import llvmlite.binding as llvm
    import numba

    from navsim.runner.checkpoint import code_digest

    config: Any = numba.config
    flags = config.CPU_FEATURES if config.CPU_FEATURES is not None else llvm.get_host_cpu_features().flatten()
    out = {CODE: code_digest(), "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            out[name] = version(name)
        except PackageNotFoundError:
            continue
    out[PROCESSOR] = config.CPU_NAME or llvm.get_host_cpu_name()
    out[INSTRUCTIONS] = ",".join(sorted(flag[1:] for flag in flags.split(",") if flag.startswith("+")))
    out["system"] = " ".join((platform.system(), platform.machine(), *platform.libc_ver())).strip()
    return out


def stored_software(result: Result) -> dict[str, str]:
    """Items of a result, `OPTIONS` among them; empty for results of earlier versions."""
    if SOFTWARE not in result:
        return {}
    return dict(zip(map(str, result[SOFTWARE]), map(str, result[f"{PROVENANCE}/value"]), strict=False))


def stored_options(result: Result) -> Options:
    """Options with which a result is computed again. Raises ValueError for damaged ones."""
    given = json.loads(stored_software(result).get(OPTIONS, "{}"))
    known = {field.name for field in fields(Options)}
    if not isinstance(given, dict) or not set(given) <= known:
        raise ValueError(f"{PROVENANCE}: its options are damaged")
    return Options(int(result.attributes["seed"]), **given)


def stored_inputs(result: Result) -> list[InputFile]:
    """Files of a result; empty for results of earlier versions."""
    if INPUTS not in result:
        return []
    columns = (np.atleast_1d(result[f"{INPUTS}{part}"]) for part in ("", "_key", "_sha256", "_bytes"))
    return [InputFile(str(a), str(b), str(c), int(d)) for a, b, c, d in zip(*columns, strict=False)]
