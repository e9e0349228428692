"""Shell completion, and the scripts for bash, zsh and fish.

It reads only the options of the command being typed and the list of keys, without models and numba, so that the answer
comes while the user types.
"""

from __future__ import annotations

import inspect
import os
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from glob import escape
from pathlib import Path
from typing import Any, Literal, NoReturn, get_args, get_origin

from typer.models import OptionInfo

from navsim.cli.options import grouped
from navsim.kinds import KINDS, OF_FILES, named

UNTIL = ("rms_horizontal within 2%", "rms_vertical within 2%", "probability within 20%")
"""Values of `--until`, each as one word."""

FILES, FOLDERS = "<files>", "<folders>"
"""Instead of a candidate: the shell completes files with the endings in its meaning, or folders."""

_SCRIPTS = {
    "bash": r"""# completion of navsim in bash; to load it: source <(navsim completion bash)
_navsim() {
  local current=${COMP_WORDS[COMP_CWORD]} value meaning
  COMPREPLY=()
  while IFS=$'\t' read -r value meaning; do
    case $value in
      '<files>')
        compopt -o filenames 2>/dev/null
        local pattern=${meaning:-*}
        while IFS= read -r value; do COMPREPLY+=("$value"); done \
          < <(compgen -d -- "$current"; compgen -f -X "!$pattern" -- "$current") ;;
      '<folders>')
        compopt -o filenames 2>/dev/null
        while IFS= read -r value; do COMPREPLY+=("$value"); done < <(compgen -d -- "$current") ;;
      *)
        [[ $value == *[=.] ]] && compopt -o nospace 2>/dev/null
        COMPREPLY+=("$value") ;;
    esac
  done < <(_NAVSIM_COMPLETE=bash COMP_LINE="${COMP_LINE:0:COMP_POINT}" COMP_WORDBREAKS="$COMP_WORDBREAKS" \
    "${COMP_WORDS[0]}" 2>/dev/null)
}
complete -F _navsim navsim
""",
    "zsh": r"""#compdef navsim
# completion of navsim in zsh: a file _navsim in a folder of $fpath, or: source <(navsim completion zsh)
_navsim() {
  local line value meaning
  local -a plain shown open openshown
  for line in "${(@f)$(_NAVSIM_COMPLETE=zsh "${(Q)words[1]}" "${(@Q)words[1,CURRENT]}" 2>/dev/null)}"; do
    value=${line%%$'\t'*} meaning=${line#*$'\t'}
    case $value in
      '') ;;
      '<files>') _files -g "${meaning:-*}" ;;
      '<folders>') _files -/ ;;
      *[=.]) open+=("$value"); openshown+=("$value${meaning:+  -- $meaning}") ;;
      *) plain+=("$value"); shown+=("$value${meaning:+  -- $meaning}") ;;
    esac
  done
  (( $#plain )) && compadd -l -d shown -a plain
  (( $#open )) && compadd -l -S '' -d openshown -a open
}
if [[ $zsh_eval_context[-1] == loadautofunc ]]; then _navsim "$@"; else compdef _navsim navsim; fi
""",
    "fish": r"""# completion of navsim in fish: in ~/.config/fish/completions, or: navsim completion fish | source
function __navsim_complete
    set -l words (commandline -opc) (commandline -ct)
    for line in (_NAVSIM_COMPLETE=fish $words[1] $words 2>/dev/null)
        set -l parts (string split -m 1 \t -- $line)
        switch $parts[1]
            case '<files>'
                set -l pattern $parts[2]
                test -n "$pattern"; or set pattern '*'
                string match -r -- '.*/$' (__fish_complete_path (commandline -ct))
                string match -- $pattern (__fish_complete_path (commandline -ct) | string replace -r '\t.*' '')
            case '<folders>'
                __fish_complete_directories (commandline -ct)
            case '*'
                echo $line
        end
    end
end
complete -c navsim -f -a '(__navsim_complete)'
""",
}
SHELLS = tuple(_SCRIPTS)


def script(shell: str) -> str:
    """Script with which a shell completes commands of navsim."""
    return _SCRIPTS[shell]


@dataclass(frozen=True)
class Candidate:
    """A possible word at the cursor, and its meaning in a few words."""

    value: str
    meaning: str = ""


def print_completions(shell: str, words: Sequence[str]) -> NoReturn:
    """Print completions of the last word, a line each with its meaning after a tab; then exit.

    words: of the command line up to the cursor, the program first; bash has them in `COMP_LINE`.
    """
    if shell == "bash":
        words = _split(os.environ.get("COMP_LINE", ""))
    typed = words[-1] if words else ""
    for found in candidates(list(words[1:])):
        value = found.value
        if value not in (FILES, FOLDERS):
            if not value.startswith(typed):
                continue
            if shell == "bash":  # bash replaces only the text after the last word break
                value = value[_broken(typed, os.environ.get("COMP_WORDBREAKS", "=:")) :]
                value = value if "=" in value[-1:] or _SAFE.fullmatch(value) else shlex.quote(value)
        sys.stdout.write(f"{value}\t{found.meaning}\n")
    sys.stdout.flush()
    sys.exit(0)


_SAFE = re.compile(r"[\w@%+=:,./-]*")


def _split(line: str) -> list[str]:
    """Words of a line; the last one, possibly empty, is being typed, possibly within quotation marks."""
    for closing in ("", "'", '"'):
        try:
            words = shlex.split(line + closing)
        except ValueError:
            continue
        return words if not closing and words and not line[-1:].isspace() else [*words, *([""] * (not closing))]
    return [""]


def _broken(typed: str, breaks: str) -> int:
    """Start of the part of a word that bash completes."""
    return max((typed.rfind(sign) + 1 for sign in "=:" if sign in breaks), default=0)


@dataclass(frozen=True)
class Parameter:
    """Parameter of a command. names: of an option, none of an argument. values: type of its values."""

    name: str
    names: tuple[str, ...]
    values: Any
    metavar: str
    meaning: str

    @property
    def flag(self) -> bool:
        """Whether it takes no value."""
        return self.values is bool

    @property
    def choices(self) -> tuple[str, ...]:
        """The words it takes alone, () for any."""
        forms = [self.values, *get_args(self.values)]
        return tuple(str(word) for form in forms if get_origin(form) is Literal for word in get_args(form))


def parameters(command: Callable[..., Any]) -> list[Parameter]:
    """Parameters of a command, from its signature."""
    out = []
    for name, parameter in inspect.signature(grouped(command)).parameters.items():
        values, info = get_args(parameter.annotation)
        option = isinstance(info, OptionInfo)
        # within Annotated, typer takes the first name for a default until it builds the command
        first = (info.default,) if isinstance(info.default, str) else ()
        names = (*first, *(info.param_decls or ())) or (f"--{name.replace('_', '-')}",) if option else ()
        out.append(Parameter(name, names, values, info.metavar or "", _short(info.help)))
    return out


def candidates(words: list[str]) -> Iterator[Candidate]:
    """Completions of the last word of a command line without the program."""
    from navsim.cli.main import PLACES

    if len(words) <= 1:
        yield from (Candidate(name, _short(named(place).__doc__)) for name, place in PLACES.items())
        yield from (Candidate("--version"), _HELP)
        return
    if words[0] not in PLACES:
        return
    known, typed, before = parameters(named(PLACES[words[0]])), words[-1], words[-2]
    options = {name: parameter for parameter in known for name in parameter.names}
    given, equals, value = typed.partition("=")
    if before in options and not options[before].flag:
        yield from _values(before, options[before], words, typed)
    elif equals and given in options:
        for found in _values(given, options[given], words, value):
            if found.value not in (FILES, FOLDERS):
                yield Candidate(f"{given}={found.value}", found.meaning)
    elif typed.startswith("-"):
        yield from (Candidate(max(p.names, key=len), p.meaning) for p in known if p.names)
        yield _HELP
    else:
        yield from _arguments(words, [p for p in known if not p.names], _count_arguments(options, words))


_HELP = Candidate("--help", "Show this help and exit.")


def _short(text: str | None) -> str:
    """The first sentence, on one line."""
    return " ".join((text or "").split("\n\n")[0].split()).partition(". ")[0][:100]


def _values(name: str, option: Parameter, words: Sequence[str], typed: str) -> Iterable[Candidate]:
    """Possible values of an option."""
    if name == "--set":
        return _assignments(words, typed)
    if name == "--until":
        return map(Candidate, UNTIL)
    if name == "--only":
        return _figures(words, typed)
    if option.choices or _WORDS.fullmatch(option.metavar):
        return map(Candidate, option.choices or option.metavar.split("|"))
    return [*([Candidate("none")] if "none" in option.metavar else []), *_paths(option.metavar)]


_WORDS = re.compile(r"[a-z]+(\|[a-z]+)+")
"""Words to choose from, as the name of a value."""


def _figures(words: Sequence[str], typed: str) -> Iterator[Candidate]:
    """Figures of the results among the words, without those that are named already."""
    before = typed[: typed.rfind(",") + 1]
    for word in words[1:-1]:
        result = Path(word)
        if result.suffix == ".h5":
            found = {path.stem.removeprefix(f"{result.stem}_") for ending in ("png", "svg", "pdf")
                     for path in result.parent.glob(f"{escape(result.stem)}_*.{ending}")}  # fmt: skip
            yield from (Candidate(f"{before}{name}") for name in sorted(found - {*before.split(",")}))


def _paths(metavar: str) -> list[Candidate]:
    """Files or folders that an argument or an option of this name accepts."""
    if "FOLDER" in metavar:
        return [Candidate(FOLDERS)]
    ending = re.search(r"[A-Z]\.([a-z0-9]+)", metavar)
    return [Candidate(FILES, f"*.{ending[1]}")] if ending else [Candidate(FILES)] if "FILE" in metavar else []


def _arguments(words: Sequence[str], arguments: Sequence[Parameter], given: int) -> Iterator[Candidate]:
    """Possible values of the argument at the cursor. given: number of arguments before it."""
    if not arguments or (given >= len(arguments) and get_origin(arguments[-1].values) is not list):
        return
    at = arguments[min(given, len(arguments) - 1)]
    offered = _OFFERED.get((words[0], at.name))
    yield from map(Candidate, offered()) if offered is not None else _paths(at.metavar)


def _count_arguments(options: dict[str, Parameter], words: Sequence[str]) -> int:
    """Number of arguments before the cursor, without options and their values."""
    count, skip = 0, False
    for word in words[1:-1]:
        if skip:
            skip = False
        elif word.startswith("-") and word != "-":
            skip = word in options and not options[word].flag
        else:
            count += 1
    return count


def _templates() -> Sequence[str]:
    from navsim.scenario.shipped import names

    return names()


_OFFERED = {
    ("schema", "kind"): lambda: (*OF_FILES, "any"),
    ("keys", "kind"): lambda: OF_FILES,
    ("init", "template"): _templates,
    ("completion", "shell"): lambda: SHELLS,
}
"""The words that arguments may be, by command and name."""


def _assignments(words: Sequence[str], typed: str) -> Iterator[Candidate]:
    """Keys for `--set`, or, behind a key and `=`, the values it may have."""
    from navsim.scenario.key_names import key_names

    known = key_names()
    keys: dict[str, list[str]] = {}
    for kind in _kinds_of(words):
        for key, choices in known[kind].items():
            keys.setdefault(key, []).extend(choice for choice in choices if choice not in keys.get(key, []))
    name, equals, _ = typed.partition("=")
    if equals:
        general = ".".join("N" if part.isdecimal() else part for part in name.split("."))
        yield from (Candidate(f"{name}={choice}") for choice in keys.get(general, ()))
        return
    parts = name.split(".")
    for key in keys:
        shown = key.split(".")
        for place, part in enumerate(shown):
            if part == "N":  # the number that was typed, else the first
                shown[place] = parts[place] if place < len(parts) and parts[place].isdecimal() else "0"
        if "NAME" in shown:
            yield Candidate(".".join(shown[: shown.index("NAME")]) + ".")
        else:
            yield Candidate(".".join(shown) + "=")


def _kinds_of(words: Sequence[str]) -> list[str]:
    """The kind of the file among the words, else the kinds that the command takes."""
    for word in words[1:-1]:
        if word.endswith((".yaml", ".yml")):
            try:
                with open(word, encoding="utf-8", errors="replace") as file:
                    found = re.search(r"^kind:\s*[\"']?([\w-]+)", file.read(100_000), re.MULTILINE)
            except OSError:
                continue
            if found and found[1] in OF_FILES:
                return [found[1]]
    if words[0] in ("live", "integrity-table"):
        return ["landing"]
    return [kind for kind in OF_FILES if KINDS[kind].command == words[0]] or list(OF_FILES)
