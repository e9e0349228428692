"""Conditions on a result that it does not meet."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from navsim.results.result import Result


@dataclass(frozen=True)
class ExitRequirements:
    """Conditions on a result: a fix at all epochs, a consistent filter, all requirements met."""

    fix: bool = False
    consistent: bool = False
    requirements: bool = False


def unmet_requirements(result: Result, demands: ExitRequirements) -> list[str]:
    """Violated conditions, in words."""
    from navsim.results.findings import of
    from navsim.results.notes import CONSISTENT, FIX

    kinds = [kind for kind, asked in ((FIX, demands.fix), (CONSISTENT, demands.consistent)) if asked]
    wrong = [f"--require-{kind}: {found.text}" for kind in kinds for found in of(result) if kind in found.against]
    if demands.requirements:
        wrong += [f"--require: {text}" for text in _unmet(result)]
    return wrong


def _unmet(result: Result) -> list[str]:
    """Requirements of a landing, or of combinations, that are not met or undecided, in words."""
    from navsim.results.schema import VERDICTS

    branch = "/summary/requirements"
    swept = [path for path in result.variables if re.fullmatch(r"/sweep/requirement_\d+_verdict", path)]
    if swept:
        out = []
        for path in swept:
            name, verdict = path.split("/")[-1].removesuffix("_verdict"), result[path]
            if some := int((verdict != VERDICTS.index("met")).sum()):
                out.append(f"{name}: not met, or undecided, in {some} of {verdict.size} combinations")
        return out
    if f"{branch}/verdict" not in result:
        return ["the scenario has no requirements"]
    pairs = zip(result[f"{branch}/statement"], result[f"{branch}/verdict"], strict=True)
    return [f"{statement}: {verdict}" for statement, verdict in pairs if verdict != "met"]
