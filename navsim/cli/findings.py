"""What a study found, said on standard error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from navsim.cli.exit_status import print_message

if TYPE_CHECKING:
    from navsim.results.result import Result


def warn(result: Result, name: str = "", known: Sequence[str] = ()) -> None:
    """Say what a result has to warn of. name: of the result, where there are several. known: what was said before."""
    from navsim.results.findings import of

    found = [finding.text for finding in of(result)]
    for text in found:
        if text not in known:
            print_message(f"warning: {name}{': ' if name else ''}{text}")
    if found:
        print_message(f"{len(found)} warning(s)")
