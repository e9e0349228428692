"""`navsim validate`, `navsim schema`, `navsim init`: scenario files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import (
    BAD_INPUT,
    ScenarioArgument,
    SetOption,
    leave,
)

_NOUNS = {"sweep": "study", "optimize": "study", "replay": "log"}


def validate(scenario: ScenarioArgument, set_: SetOption = None) -> None:
    """Check a scenario or study file and say what is wrong with it."""
    from navsim.scenario.load import read_any, read_study
    from navsim.scenario.source import InputError
    from navsim.scenario.sweep import Sweep

    try:
        checked, document = read_any(scenario, set_ or [])
        kind = document.data["kind"]
        if isinstance(checked, Sweep):
            from navsim.study.sweep import plan

            plan(*read_study(scenario, Sweep, set_ or []), seed=1)
    except InputError as error:
        leave(BAD_INPUT, *error.problems)
    print(f"{scenario}: a valid {_NOUNS.get(kind, 'scenario')} of kind {kind}")


def schema(kind: Annotated[str, typer.Argument(help="Kind of scenario.")] = "landing") -> None:
    """Print the JSON Schema of a kind of scenario: every key, its unit, range, default."""
    import json

    from navsim.scenario.load import KINDS

    if kind not in KINDS:
        leave(BAD_INPUT, f"{kind!r} is no kind of scenario; allowed: {', '.join(KINDS)}")
    print(json.dumps(KINDS[kind].model_json_schema(), indent=1))


def init(
    template: Annotated[str, typer.Argument(help="Which one; a wrong name lists them.")] = "landing",
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.yaml", help="Default: <template>.yaml.", show_default=False),
    ] = None,
) -> None:
    """Write a commented scenario to start from, which runs as it is."""
    from navsim.scenario.shipped import names, text

    if template not in names():
        leave(BAD_INPUT, f"there is no template {template!r}; allowed: {', '.join(names())}")
    target = output or Path(f"{template}.yaml")
    try:
        with open(target, "x", encoding="utf-8") as file:
            file.write(text(template))
    except FileExistsError:
        leave(BAD_INPUT, f"{target}: exists already and stays untouched; choose another name with -o")
    except OSError as error:
        leave(BAD_INPUT, f"{target}: cannot be written: {error.strerror or error}")
    import yaml

    kind = yaml.safe_load(text(template))["kind"]
    verb = kind if kind in ("sweep", "optimize", "replay") else "run"
    print(f"{target} written; go on with: navsim {verb} {target}")
