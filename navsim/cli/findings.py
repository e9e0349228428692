"""Print the findings of a study on standard error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from navsim.cli.exit_status import print_message

if TYPE_CHECKING:
    from navsim.results.result import Result


def warn(result: Result, name: str = "", known: Sequence[str] = ()) -> None:
    """Print the findings of a result. name: of the result, if there are several. known: findings already printed."""
    from navsim.results.findings import of, several
    from navsim.results.notes import labelled

    found = of(result)
    for one in found:
        if one.text not in known:
            print_message(f"warning: {name}{': ' if name else ''}{labelled(one.text, one.name)}")
    if found:
        print_message(several(len(found), "warning"))
