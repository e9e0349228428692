"""`navsim validate`, `schema`, `keys`, `init`: scenario files; `navsim variables`: contents of results."""

from __future__ import annotations

import json
import textwrap
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from navsim.cli.common import AT_TERMINAL, leave, leaving, make_folder, print_json
from navsim.cli.exit_status import BAD_INPUT, print_message
from navsim.cli.options import argument, set_option, value_option
from navsim.kinds import KINDS, OF_FILES
from navsim.runner.errors import BadInput
from navsim.runner.opening import checked, schema_of
from navsim.scenario_files import shipped
from navsim.scenario_files.shipped import names


def validate(
    scenarios: Annotated[
        list[Path],
        argument("FILE.yaml", "Scenarios, studies or logs to check."),
    ],
    set_: Annotated[list[str] | None, set_option("file")] = None,
) -> None:
    """Check a scenario, study or log and the files that it names."""
    from navsim.results.notes import labelled

    right = True
    for scenario in scenarios:
        of = f"{scenario}: " if len(scenarios) > 1 else ""
        try:
            _, document, warnings = checked(scenario, set_ or [])
        except BadInput as error:
            right = False
            for problem in error.problems:
                print_message(f"error: {'' if problem.file == str(scenario) else of}{problem}")
            continue
        for text in warnings:
            AT_TERMINAL.warn(f"{of}{labelled(text)}")
        kind = str(document.data["kind"])
        print(f"{scenario}: a valid {KINDS[kind].noun} of kind {kind}")
    if not right:
        leave(BAD_INPUT)


def schema(
    kind: Annotated[
        str,
        typer.Argument(
            help=f"One of {', '.join(OF_FILES)}; or any, for one schema of all kinds.",
            autocompletion=lambda: [*OF_FILES, "any"],
        ),
    ] = "landing",
    all_: Annotated[bool, typer.Option("--all", help="The schema of all kinds, like `any`.")] = False,
    install: Annotated[
        bool,
        typer.Option(
            "--install",
            help="Write the schemas of all kinds into the user's data folder, for editors. `navsim init` then names "
            "them in the files it writes.",
        ),
    ] = False,
) -> None:
    """Print the JSON Schema of a kind of file, with unit, range and default of each key."""
    from navsim.results.atomic_write import write_atomically
    from navsim.scenario_files.json_schema import ANY, installed, published

    with leaving():
        found = schema_of(ANY if all_ and kind in OF_FILES else kind)
    if not install:
        print_json(found)
        return
    for each in (*OF_FILES, ANY):
        path = installed(each)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, json.dumps(published(each), ensure_ascii=False, indent=1).encode())
        except OSError as error:
            leave(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}")
    print(f"schemas of {len(OF_FILES)} kinds, and {ANY}, written to {installed(ANY).parent}")


def keys(
    kind: Annotated[
        str | None,
        typer.Argument(
            help=f"One of {', '.join(OF_FILES)}. Without it: list the kinds.",
            show_default=False,
            autocompletion=lambda: list(OF_FILES),
        ),
    ] = None,
    word: Annotated[
        str | None, typer.Argument(help="List only keys with this word in their name or meaning.", show_default=False)
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the keys of a kind of file with unit, range, default and meaning.

    N in a key is the index of a list item, from 0; NAME is a name that you choose.
    """
    from navsim.scenario.load import section
    from navsim.scenario_files.base import hint
    from navsim.scenario_files.keys import matching, nearest, rows

    if kind is None:
        if json_:
            print_json(list(OF_FILES))
            return
        for name in OF_FILES:
            print(f"{name:<18}a {KINDS[name].noun} for navsim {KINDS[name].command}")
        print("\nnavsim keys KIND prints the keys of a kind, with a word those about it: navsim keys landing wind")
        return
    if kind not in OF_FILES:
        leave(BAD_INPUT, f"{kind!r} is not a kind of scenario; {hint(kind, list(OF_FILES))}")
    every = rows(section(kind).model_json_schema())
    found = every if word is None else matching(every, word)
    if not found:
        near = nearest(every, str(word))
        ask = f"; nearest: {', '.join(near)}" if near else f"; navsim keys {kind} lists all {len(every)}"
        leave(BAD_INPUT, f"no key of kind {kind} has {word!r} in its name or meaning{ask}")
    if json_:
        print_json([asdict(row) for row in found])
        return
    for row in found:
        print(row.key)
        print(f"    {row.facts()}")
        print(textwrap.fill(row.meaning, 116, initial_indent="    ", subsequent_indent="    ") or "    -")


def _layouts() -> list[str]:
    from navsim.results.schema import LAYOUTS

    return list(LAYOUTS)


def variables(
    layout: Annotated[
        str | None,
        typer.Argument(
            help="Kind of result, such as landing or covariance. Without it: list the kinds.",
            show_default=False,
            autocompletion=_layouts,
        ),
    ] = None,
    word: Annotated[
        str | None,
        typer.Argument(help="List only variables with this word in their path or meaning.", show_default=False),
    ] = None,
    json_: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the variables of a kind of result with type, unit, dimensions and meaning.

    A name in <> is one that the study gives, such as a sensor. A word in * comes with the data.
    """
    from navsim.results.schema import LAYOUTS
    from navsim.results.variables import rows_of
    from navsim.scenario_files.base import hint

    if layout is None:
        if json_:
            print_json(LAYOUTS)
            return
        for name, what in LAYOUTS.items():
            print(textwrap.fill(what, 116, initial_indent=f"{name:<18}", subsequent_indent=" " * 18))
        return
    if layout not in LAYOUTS:
        leave(BAD_INPUT, f"{layout!r} is not a kind of result; {hint(layout, list(LAYOUTS))}")
    every = [row for _, row in rows_of(layout)]
    low = (word or "").lower()
    found = [row for row in every if low in " ".join(row.paths).lower() or low in row.meaning.lower()]
    if not found:
        leave(BAD_INPUT, f"no variable of a {layout} result has {word!r} in its path or meaning; "
                         f"navsim variables {layout} lists all {len(every)}")  # fmt: skip
    if json_:
        print_json([asdict(row) for row in found])
        return
    for row in found:
        print(textwrap.fill(", ".join(row.paths), 116, subsequent_indent="    "))
        print(textwrap.fill(row.facts(), 116, initial_indent="    ", subsequent_indent="    "))
        print(textwrap.fill(row.meaning, 116, initial_indent="    ", subsequent_indent="    "))


def init(
    template: Annotated[
        str, typer.Argument(help=f"One of {', '.join(names())}.", autocompletion=names)
    ] = "landing_open_sky",
    output: Annotated[
        Path | None,
        value_option("FILE.yaml", "The file to write. Default: <template>.yaml.", "--output", "-o"),
    ] = None,
) -> None:
    """Write a commented scenario to start from, ready to run.

    navsim also writes the files that the scenario uses, such as the base of a study, unless they exist. After
    `navsim schema --install` its first line names the schema for editors.
    """
    from navsim.scenario_files.base import hint

    if template not in names():
        leave(BAD_INPUT, f"there is no template {template!r}; {hint(template, names())}")
    target = output or Path(f"{template}.yaml")
    if target.exists():
        leave(BAD_INPUT, f"{target}: exists already and stays untouched; choose another name with -o")
    make_folder(target)
    from navsim.scenario_files.json_schema import modeline

    beside = {target.parent / name: shipped.content(name) for name in shipped.needs(template)}
    written = []
    for path, content in (
        *beside.items(),
        (target, (modeline(shipped.kind(template)) + shipped.text(template)).encode()),
    ):
        try:
            if path != target:
                path.parent.mkdir(exist_ok=True)
            with open(path, "xb") as file:
                file.write(content)
            written.append(str(path))
        except FileExistsError:
            if not path.is_file() or path.read_bytes() != content:
                print_message(f"warning: {path} differs from the shipped file; navsim keeps it. {target} names it")
        except OSError as error:
            leave(BAD_INPUT, f"{path}: cannot be written: {error.strerror or error}")
    also = f" (it uses {', '.join(written[:-1])}, written too)" if written[:-1] else ""
    print(f"{target} written{also}; go on with: navsim {KINDS[shipped.kind(template)].command} {target}")
