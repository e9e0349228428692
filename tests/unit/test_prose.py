"""Lengths of what users read: README, docs, help, messages and keys; and that the check of them can fail."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.unit.test_reference import script

prose = script("prose")


def test_readme_docs_help_and_messages_are_no_longer_than_accepted() -> None:
    """The words are checked by `make lint`; so are these, which a run of the tests is to show too."""
    wrong = prose.compare(prose.lengths(prose.texts()), prose.accepted(), "sentence|paragraph|page")
    wrong += prose.compare_total(prose.words_of_docs(), prose.accepted())
    assert wrong == [], "mend the text, or shorten the list: " + prose.UPDATE


def test_the_readme_is_never_excepted() -> None:
    assert [key for key in prose.accepted() if key[1] == "README.md" and key[0] in ("page", "sentence")] == []


def test_all_that_users_read_is_there() -> None:
    files = {text.file for text in prose.texts()}
    assert {"README.md", "CHANGELOG.md", "docs/theory/filter.md", "navsim/cli/run.py", "keys of landing"} <= files
    assert not [file for file in files if file.startswith(("docs/_build/", "docs/reference/"))]


LONG = "One " + "word " * 35


def test_sentences_end_and_code_is_one_word() -> None:
    page = f"# {LONG}\n\n{LONG.strip()}. Short one, e.g. This of `a b c d`.\n\n    {LONG}\n\n"
    page += f"| {LONG} |\n|---|\n| cell |\n"
    found = list(prose.of_markdown("docs/page.md", page))
    assert [(text.line, prose.word_count(text.text), text.prose) for text in found] == [
        (1, 36, False), (3, 43, True), (7, 36, False), (9, 1, False),
    ]  # fmt: skip
    assert [(one.line, one.rule) for one in prose.lengths(found)] == [(3, "sentence")]


def test_paragraphs_and_pages_end() -> None:
    fat = "Word " + "word " * 29 + "end. "
    found = list(prose.of_markdown("docs/page.md", f"{fat * 3}\n"))
    assert [one.rule for one in prose.lengths(found)] == ["paragraph"]
    found = list(prose.of_markdown("docs/page.md", f"{fat}\n\n" * 49))
    assert [one.rule for one in prose.lengths(found)] == ["page"]
    found = list(prose.of_markdown("README.md", f"{fat}\n\n" * 17))
    assert [one.rule for one in prose.lengths(found)] == ["page"]


def test_messages_are_strings_that_are_no_docstrings() -> None:
    source = '"""Words of a module that nobody counts."""\nraise E(f"the file {name} has no fix, and so no start")\n'
    assert [(text.line, text.text) for text in prose.of_source("a.py", source)] == [
        (2, "the file x has no fix, and so no start")
    ]


def test_the_style_is_the_houses_and_proselints() -> None:
    text = prose.Text("a.md", 7, "Of it the filter is told what is foreseen, for all intensive purposes.")
    assert [(one.line, one.rule) for one in prose.style([prose.Text("a.md", 1, "A clean line."), text])] == [
        (7, "house.openings"), (7, "house.phrases"), (7, "house.phrases"), (7, "house.words"), (7, "mondegreens"),
    ]  # fmt: skip


def test_the_list_fails_for_more_and_for_less(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And only lowers its sums."""
    finding = prose.Finding("a.md", 1, "sentence", "40 words")
    assert prose.compare([finding], {}) == [str(finding)]
    assert prose.compare([finding], {("sentence", "a.md"): 1}) == []
    assert "--update" in prose.compare([finding], {("sentence", "a.md"): 2})[0]
    assert prose.compare_total(28_000, {}) == []
    assert len(prose.compare_total(28_001, {})) == 1
    assert prose.compare_total(30_400, {("words", "docs"): 30_500}) == []
    assert "--update" in prose.compare_total(30_000, {("words", "docs"): 30_500})[0]
    monkeypatch.setattr(prose, "ACCEPTED", tmp_path / "accepted.txt")
    prose.update([finding, finding], 30_001)
    assert prose.accepted() == {("sentence", "a.md"): 2, ("words", "docs"): 30_500}
    prose.update([finding] * 3, 31_000)
    assert prose.accepted() == {("sentence", "a.md"): 2, ("words", "docs"): 30_500}
    moved = prose.Finding("b.md", 1, "sentence", "40 words")
    prose.update([finding, moved], 30_000)
    assert prose.accepted() == {("sentence", "a.md"): 1, ("sentence", "b.md"): 1, ("words", "docs"): 30_000}
    prose.update([finding], 29_000)
    assert prose.accepted() == {("sentence", "a.md"): 1, ("words", "docs"): 29_000}
