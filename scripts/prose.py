"""Check what users read: README, docs, help, messages and keys. Run by `make lint`; `--update` shortens the list.

Lengths of sentences, paragraphs and pages, the house's words, and proselint's own checks. Findings that are still
accepted are counted for each file in `prose_accepted.txt`. A file that has more fails, and a file that has fewer fails
until the list is updated, so that the counts only fall.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token
from proselint import checks
from proselint.config import DEFAULT
from proselint.registry import CheckRegistry
from proselint.registry.checks import Check, CheckResult, types
from proselint.registry.checks.engine import Fancy, RegexOptions
from proselint.tools import LintFile

from navsim.kinds import OF_FILES
from navsim.scenario.load import section
from navsim.scenario_files.keys import rows

ROOT = Path(__file__).resolve().parent.parent
ACCEPTED = Path(__file__).with_name("prose_accepted.txt")
GENERATED = ("docs/_build/", "docs/reference/")
"""Pages that other texts make; keys and schemas are checked where they are written."""
MOST_SENTENCE, MOST_PARAGRAPH, MOST_PAGE, MOST_README, MOST_DOCS = 35, 90, 1500, 500, 28_000
"""Words."""
STEP = 500
"""The accepted length of all pages is a multiple of this."""
UPDATE = "python scripts/prose.py --update"

PHRASES = (
    "(?:is|are|was|were|be) told", "stands? (?:in|for|beside|at|under)", "what (?:is|are|it|they|there|of)",
    "of (?:its|their) own", "as (?:it|they) (?:is|are|stands?)", "beside (?:the|it|what)", "where it is not",
    "the same (?:in|of|as|with|way)", "goes? on", "of (?:one|several|another) (?:run|kind|sort)", "by itself",
    "as one has", "not one", "nothing of",
)  # fmt: skip
"""Turns that make a reader look for who does what."""
WORDS = {
    "flown ways?": "flown trajectory", "misfits?": "model mismatch", "beliefs": "filter model", "foreseen": "predicted",
    "grow old": "propagate", "workplaces?": "executor", "sorts? of results?": "result kind", "afford": "have room for",
    "glideslope": "glide slope", "touch-down": "touchdown", "way-points?": "waypoint",
    "pseudo-satellites?": "pseudolite", "pseudo-ranges?": "pseudorange",
    "kalman-filter": "Kalman filter", "innovation's": "innovation", "lever-arm": "lever arm", "cut-off angle": "mask",
    "colors?": "colour", "centers?": "centre", "meters": "metres", "behaviors?": "behaviour", "modeling": "modelling",
    "datas": "data", "informations": "information", "softwares": "software", "allows to": "lets you",
    "in order to": "to", "utilize[ds]?": "use", "is able to": "can", "at this point in time": "now",
    "it should be noted that": "",
}  # fmt: skip
"""The field's words, by what is not written for them; regular expressions."""
OWN_CHECKS = (
    "cliches", "hedging", "industrial_language.bureaucratese",
    "malapropisms", "misc.illogic", "misc.many_a", "misc.latin", "misc.metadiscourse", "misc.pretension",
    "mixed_metaphors", "mondegreens", "needless_variants", "nonwords", "oxymorons", "redundancy", "spelling",
    "terms.eponymous_adjectives", "weasel_words",
)  # fmt: skip
"""Checks of proselint that fit technical English."""

_WORD = re.compile(r"[A-Za-z][A-Za-z'’-]*")
_SENTENCE_END = re.compile(r"(?<=[.!?])\s+(?=[A-Z\"'(`])")
_SHORT_FORM = re.compile(r"\b(e\.g|i\.e|cf|vs|[Ff]ig|[Ee]q|No|St)\.")
_FORMULA = re.compile(r"\$[^$]+\$")


@dataclass(frozen=True)
class Text:
    """A paragraph, a cell, a heading or a message. prose: it has sentences, whose lengths count."""

    file: str
    line: int
    text: str
    prose: bool = True


@dataclass(frozen=True)
class Finding:
    """What breaks a rule, and where."""

    file: str
    line: int
    rule: str
    message: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.rule}: {self.message}"


def word_count(text: str) -> int:
    """Number of words."""
    return len(_WORD.findall(text))


def sentences(text: str) -> list[str]:
    """Sentences of a paragraph that have three words or more."""
    return [one for one in _SENTENCE_END.split(_SHORT_FORM.sub(r"\1", text)) if word_count(one) > 2]


def _plain(inline: Token) -> str:
    """The words of a line of Markdown: code and formulas count as one word each, images and HTML as none."""
    children = inline.children or ()
    replaced = {"code_inline": "code", "softbreak": " "}
    text = "".join(child.content if child.type == "text" else replaced.get(child.type, "") for child in children)
    return " ".join(_FORMULA.sub("x", text).split())


def of_markdown(file: str, source: str) -> Iterator[Text]:
    """Paragraphs, and cells of tables and headings, which are no prose."""
    opened, line = "", 1
    for token in MarkdownIt("commonmark").enable("table").parse(source):
        if token.map:
            line = token.map[0] + 1
        if token.type == "inline" and (text := _plain(token)):
            yield Text(file, line, text, opened == "paragraph_open")
        opened = token.type


def of_source(file: str, source: str) -> Iterator[Text]:
    """Strings of five words or more that are no docstrings: help, messages, labels."""
    tree = ast.parse(source)
    skipped: set[int] = set()
    for node in ast.walk(tree):  # from the outside in
        text = ""
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "x" for part in node.values)
            skipped |= {id(part) for part in node.values}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in skipped:
            text = node.value
        if word_count(text) >= 5 and " " in text.strip() and not text.startswith(("#", ":root")):  # scripts, styles
            yield Text(file, getattr(node, "lineno", 1), " ".join(re.sub(r"`[^`]*`", "code", text).split()))


@cache
def texts() -> tuple[Text, ...]:
    """All that users read, file by file."""
    out: list[Text] = []
    for path in (*ROOT.glob("*.md"), *sorted((ROOT / "docs").rglob("*.md"))):
        name = str(path.relative_to(ROOT))
        if not name.startswith(GENERATED):
            out += of_markdown(name, path.read_text(encoding="utf-8"))
    for path in sorted((ROOT / "navsim").rglob("*.py")):
        out += of_source(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))
    for kind in OF_FILES:
        for number, row in enumerate(rows(section(kind).model_json_schema()), 1):
            out.append(Text(f"keys of {kind}", number, row.meaning))
    return tuple(out)


def lengths(found: Iterable[Text]) -> Iterator[Finding]:
    """Sentences, paragraphs and pages that are too long."""
    for file, group in groupby((text for text in found if text.prose), key=lambda text: text.file):
        total = 0
        for text in group:
            total += (count := word_count(text.text))
            if count > MOST_PARAGRAPH:
                message = f"{count} words, {MOST_PARAGRAPH} at most: {text.text[:80]}..."
                yield Finding(file, text.line, "paragraph", message)
            for sentence in sentences(text.text):
                if (count := word_count(sentence)) > MOST_SENTENCE:
                    message = f"{count} words, {MOST_SENTENCE} at most: {sentence[:80]}..."
                    yield Finding(file, text.line, "sentence", message)
        most = MOST_README if file == "README.md" else MOST_PAGE
        if total > most and file.endswith(".md") and file != "CHANGELOG.md":
            yield Finding(file, 1, "page", f"{total} words, {most} at most")


def words_of_docs() -> int:
    """Words of prose of all pages of docs/ that are not generated."""
    return sum(word_count(text.text) for text in texts() if text.prose and text.file.startswith("docs/"))


def _phrases(text: str, check: Check) -> Iterator[CheckResult]:
    for match in re.finditer(rf"\b(?:{'|'.join(PHRASES)})\b", text, re.IGNORECASE):
        yield CheckResult(check.path, f"say who does what, instead of {match[0]!r}", match.span(), None)


def _openings(text: str, check: Check) -> Iterator[CheckResult]:
    for match in re.finditer(r"(?:^|(?<=[.!?] ))(?:What|Of|As|Where it is) (?![^.!?]*\?)", text, re.MULTILINE):
        yield CheckResult(check.path, f"begin with who does it, instead of {match[0]!r}", match.span(), None)


@cache
def _registry() -> CheckRegistry:
    """Proselint's checks, and the house's."""
    registry = CheckRegistry()
    registry.register_many(checks.__register__)
    registry.register(Check(_phrases, path="house.phrases"))
    registry.register(Check(_openings, path="house.openings"))
    exactly = Fancy(RegexOptions(case_insensitive=False))  # names keep their spelling
    registry.register(Check(types.PreferredForms(WORDS), exactly, "house.words", "write '{}' instead of '{}'"))
    return registry


def style(found: Iterable[Text]) -> Iterator[Finding]:
    """The house's words and phrases, and proselint's checks; a text a line, for proselint wants whole files."""
    _registry()
    config = {**DEFAULT, "max_errors": 100_000, "checks": dict.fromkeys(("house", *OWN_CHECKS), True)}
    for file, group in groupby(found, key=lambda text: text.file):
        lines = list(group)
        linted = LintFile(file, "\n".join(text.text for text in lines))
        for result in linted.lint(config):
            before = linted.content.count("\n", 0, result.check_result.span[0])
            at = lines[max(0, before - 1)]  # proselint puts an empty line before the first
            rule = ".".join(result.check_result.check_path.split(".")[:2])
            yield Finding(file, at.line, rule, f"{result.check_result.message}: {at.text[:80]}")


def accepted() -> dict[tuple[str, str], int]:
    """The list: how many findings of a rule a file may have, and how many words all pages."""
    text = ACCEPTED.read_text(encoding="utf-8") if ACCEPTED.exists() else ""
    entries = (line.split(maxsplit=2) for line in text.splitlines() if line and not line.startswith("#"))
    return {(rule, file): int(count) for count, rule, file in entries}


def compare(found: Iterable[Finding], allowed: dict[tuple[str, str], int], rules: str = "") -> list[str]:
    """What the findings and the list differ in; of the rules that match."""
    found = [one for one in found if re.match(rules, one.rule)]
    counts = Counter((one.rule, one.file) for one in found)
    out = [str(one) for one in found if counts[one.rule, one.file] > allowed.get((one.rule, one.file), 0)]
    for (rule, file), count in allowed.items():
        if re.match(rules, rule) and rule != "words" and counts[rule, file] < count:
            out.append(f"{file}: {counts[rule, file]} findings of {rule}, {count} are accepted: run `{UPDATE}`")
    return out


def compare_total(total: int, allowed: dict[tuple[str, str], int]) -> list[str]:
    """Whether all pages together are too long, or shorter than the list says."""
    most = max(MOST_DOCS, allowed.get(("words", "docs"), 0))
    if total > most:
        return [f"docs: {total} words of prose, {most} are accepted"]
    if MOST_DOCS <= most - STEP >= total:
        return [f"docs: {total} words of prose, {most} are accepted: run `{UPDATE}`"]
    return []


def update(found: Iterable[Finding], total: int) -> None:
    """Write the list. Its sums only fall: text may move between files; without a list it is made of what there is."""
    old, counts = accepted(), Counter((one.rule, one.file) for one in found)
    new: dict[tuple[str, str], int] = {}
    for rule in {rule for rule, _ in counts}:
        before, now = ({key: n for key, n in group.items() if key[0] == rule} for group in (old, counts))
        rose = bool(old) and sum(now.values()) > sum(before.values())
        new |= {key: min(n, before.get(key, 0)) if rose else n for key, n in now.items()}
    most = max(MOST_DOCS, -(-total // STEP) * STEP)
    new["words", "docs"] = min(most, old.get(("words", "docs"), most))
    entries = sorted((file, rule, count) for (rule, file), count in new.items() if count)
    lines = [f"{count} {rule} {file}" for file, rule, count in entries]
    head = f"# Findings that are still accepted: count, rule, file. Written by `{UPDATE}`, which only lowers sums.\n"
    ACCEPTED.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")


def main() -> None:
    found = [*lengths(texts()), *style(texts())]
    if sys.argv[1:] == ["--update"]:
        update(found, words_of_docs())
    elif sys.argv[1:] == ["--all"]:
        print(*found, sep="\n")
        return
    wrong = compare(found, accepted()) + compare_total(words_of_docs(), accepted())
    print(*wrong, sep="\n", end="\n" if wrong else "")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
