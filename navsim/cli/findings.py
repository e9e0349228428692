"""What a study found, said on standard error, and the flags that make it an error."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from navsim.cli.common import RUN_FAILED, leave, say

if TYPE_CHECKING:
    from navsim.io.results import Result

RequireFixOption = Annotated[
    bool, typer.Option("--require-fix", help="Exit 3 where any epoch has no fix, or a fix could not be used.")
]
RequireConsistentOption = Annotated[
    bool,
    typer.Option(
        "--require-consistent",
        help="Exit 3 where errors, innovations or the covariance contradict what the filter believes.",
    ),
]


def tell(result: Result, name: str = "") -> None:
    """Say what a result has to warn of. name: of the result, where there are several."""
    from navsim.study.findings import of

    found = of(result)
    for finding in found:
        say(f"warning: {name}{': ' if name else ''}{finding.text}")
    if found:
        say(f"{len(found)} warning(s)")


def require(result: Result, target: Path, fix: bool, consistent: bool) -> None:
    """Leave with the findings that speak against what was asked for, if there are any."""
    from navsim.study.findings import CONSISTENT, FIX, of

    wanted = [kind for kind, asked in ((FIX, fix), (CONSISTENT, consistent)) if asked]
    wrong = [f"--require-{kind}: {found.text}" for kind in wanted for found in of(result) if kind in found.against]
    if wrong:
        leave(RUN_FAILED, *wrong[:-1], f"{wrong[-1]} ({target} is complete)")
