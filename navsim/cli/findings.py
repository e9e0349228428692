"""What a study found, said on standard error, and made an error where that is asked for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from navsim.cli.common import leave
from navsim.cli.ending import RUN_FAILED, say
from navsim.cli.options import Required

if TYPE_CHECKING:
    from navsim.io.results import Result


def warn(result: Result, name: str = "", known: Sequence[str] = ()) -> None:
    """Say what a result has to warn of. name: of the result, where there are several. known: what was said before."""
    from navsim.io.findings import of

    found = [finding.text for finding in of(result)]
    for text in found:
        if text not in known:
            say(f"warning: {name}{': ' if name else ''}{text}")
    if found:
        say(f"{len(found)} warning(s)")


def require(result: Result, target: Path, required: Required) -> None:
    """Leave with the findings that speak against what was asked for, if there are any."""
    from navsim.io.findings import CONSISTENT, FIX, of

    wanted = [kind for kind, asked in ((FIX, required.require_fix), (CONSISTENT, required.require_consistent)) if asked]
    wrong = [f"--require-{kind}: {found.text}" for kind in wanted for found in of(result) if kind in found.against]
    if required.require:
        wrong += [f"--require: {text}" for text in unmet(result)]
    if wrong:
        leave(RUN_FAILED, *wrong[:-1], f"{wrong[-1]} ({target} is complete)")


def unmet(result: Result) -> list[str]:
    """What is asked of a landing, or of combinations, and is not met, or nothing can be said of, in words."""
    import re

    from navsim.io.schema import VERDICTS

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
