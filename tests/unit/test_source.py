"""What a scenario's text may hold, from a file and from `--set` alike."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path

import pytest

from navsim.formats.yaml_text import dump
from navsim.scenario.load import read_any, resolved_yaml
from navsim.scenario_files import shipped
from navsim.scenario_files.rewrite import rewritten
from navsim.scenario_files.source import Document, InputError, assign, load, parse
from tests.helpers import in_brief
from tests.torture import mutants
from tests.torture.trials import sources

LAUGHS = "a0: &a0 [x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 8)}]\n" for k in range(1, 9)
)
REFUSED: list[tuple[str, str, str, str]] = [
    ("billion laughs", LAUGHS, "", "20,000 keys and values"),
    ("a list that holds itself", "a: &a [*a]", ":1:", "nested too deeply"),
    ("a mapping that holds itself", "a: &a {b: *a}", ":1:", "nested too deeply"),
    ("deep lists", "a: " + "[" * 20000 + "]" * 20000, ":1:", "nested too deeply"),
    ("deep mappings", "a: " + "{a: " * 5000 + "1" + "}" * 5000, ":1:", "nested too deeply"),
    ("deep lists by lines", "a:\n" + "- " * 3000 + "1", ":2:", "nested too deeply"),
    ("many nodes", "a: [" + "1," * 25000 + "]", ":1:", "20,000 keys and values"),
    ("a bad integer", "a: !!int abc", ":1:4:", "tags"),
    ("a boolean that is none", "a: !!bool maybe", ":1:4:", "tags"),
    ("a tag that would be right", "a: !!float 1.0", ":1:4:", "tags"),
    ("a tag on a mapping", "a: !!set {b}", ":1:4:", "tags"),
    ("a tag of nobody", "b: 1\na: !foo 5", ":2:4:", "tags"),
    ("code", "a: !!python/object/apply:os.system ['true']", ":1:4:", "tags"),
    ("a tag on a key", "!!str a: 1", ":1:1:", "tags"),
    ("5000 digits", "a: " + "9" * 5000, ":1:4: a", "60"),
    ("5000 hexadecimal digits", "a: 0x" + "f" * 5000, ":1:4: a", "60"),
    ("5000 digits of a fraction", "a: 0." + "1" * 5000, ":1:4: a", "60"),
    ("a denormal", "a: 5e-324", ":1:4: a", "1e-50"),
    ("what vanishes", "a: 1e-400", ":1:4: a", "1e-50"),
    ("too large", "a: 1e300", ":1:4: a", "1e+50"),
    ("too large for a double", "b: [1, -1e400]", ":1:8: b.1", "finite"),
    ("not a number", "a: .nan", ":1:4: a", "finite"),
    ("infinite", "a: -.inf", ":1:4: a", "finite"),
    ("a NUL", 'a: "x\\0y"', ":1:4: a", "U+0000"),
    ("half a pair", 'a: "\\ud800"', ":1:4: a", "U+D800"),
    ("an escape", 'a: "\\e[31m"', ":1:4: a", "U+001B"),
    ("a NUL in a key", 'a: {"x\\0": 1}', ":1:5: a", "U+0000"),
    ("a long text", "a: " + "x" * 5000, ":1:4: a", "4096"),
    ("a control character", "b: 1\na: x\x00", ":2:5:", "U+0000"),
    ("a brace left open", "b: 1\na: {c: 1, d: 2\ne:\n  f: 1\n", ":2:4:", "'{' here is not closed by '}', or lacks"),
    ("a brace left open at the end", "b: 1\na: {c: 1, d: 2\n", ":2:4:", "'{' here is not closed by '}'"),
    ("a bracket left open", "a:\n  b: [1, 2\n", ":2:6:", "'[' here is not closed by ']'"),
    ("a comma left out", "b: 1\na: {c: 1 d: 2}\n", ":2:11:", "expected ',' or '}'"),
    ("a text left open", 'b: 1\na: "x\nc: 1\n', ":2:4:", "quotation mark here has no second one"),
    ("a decimal comma between braces", "b: 1\na: [{c: -1,5}]", ":2:12: a.0.c", "decimals take a point: -1.5"),
]


@pytest.mark.parametrize(("name", "text", "place", "said"), REFUSED, ids=[case[0] for case in REFUSED])
def test_what_no_scenario_may_hold(name: str, text: str, place: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        parse(text, "s.yaml", tmp_path)
    assert f"s.yaml{place}" in str(caught.value)
    assert said in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(("name", "text", "place", "said"), REFUSED, ids=[case[0] for case in REFUSED])
def test_the_same_by_option(name: str, text: str, place: str, said: str, tmp_path: Path) -> None:
    document = Document("s.yaml", tmp_path, {"kind": "landing"})
    value = text.removeprefix("a: ") if text.startswith("a: ") and "\n" not in text else "{" + text + "}"
    if "\n" in text or value == "{!!str a: 1}":
        return  # lines of a file
    with pytest.raises(InputError) as caught:
        assign(document, f"title={value}")
    assert said in str(caught.value)
    assert str(caught.value).startswith("--set title=")
    assert len(str(caught.value)) < 500


def test_a_key_by_option_goes_no_deeper_than_a_file(tmp_path: Path) -> None:
    for key in (".".join("a" * 5000), "a." + "9" * 5000):
        with pytest.raises(InputError):
            assign(Document("s.yaml", tmp_path, {"a": [1]}), f"{key}=1")


def test_what_is_rare_and_right(tmp_path: Path) -> None:
    text = "a: &x {b: -0.0, c: 1_000, d: 0x10, e: 0o17, f: '~', g: +1.5e-12}\nh: [*x, *x]\n"
    data = parse(text, "s.yaml", tmp_path).data
    assert data["a"] == {"b": 0.0, "c": "1_000", "d": 16, "e": 15, "f": "~", "g": 1.5e-12}
    assert str(data["a"]["b"]) == "0.0"
    assert data["h"] == [data["a"], data["a"]]


def test_a_file_too_large_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_bytes(b"# filler\n" * 200_000)
    with pytest.raises(InputError, match="more than 1,000,000 bytes"):
        load(tmp_path / "s.yaml")


def test_a_log_is_no_scenario(tmp_path: Path) -> None:
    (tmp_path / "f.ULG").write_bytes(b"ULog\x01\x12\x35\x01")
    with pytest.raises(InputError, match=r"use navsim import .*f\.ULG, which"):
        load(tmp_path / "f.ULG")


@pytest.mark.parametrize(("name", "said"), [
    ("pipe", "a named pipe"), ("/dev/zero", "a device"), ("/dev/null", "a device"), (".", "a folder"),
    ("loop", "cannot be read"),
])  # fmt: skip
def test_only_regular_files_are_read(name: str, said: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match=said):
        load(tmp_path / name)
    for key in ("sky.almanac", "sky.navigation", "sky.orbits"):
        from navsim.landing.study import prepare

        source_of = key.partition(".")[2]
        options = [f"sky.source={source_of}", f"{key}={tmp_path / name}"]
        scenario, document = read_any(shipped.path("landing"), options)
        with pytest.raises(InputError, match=f"{key}: .*cannot be read"):
            prepare(scenario, document)


def test_the_folder_of_nobody(tmp_path: Path) -> None:
    document = parse("sky: {almanac: ~nosuchuser/x}", "s.yaml", tmp_path)
    with pytest.raises(InputError, match=r"s\.yaml:1:7: sky.almanac: there is no user's folder '~nosuchuser'"):
        document.resolve(("sky", "almanac"), "~nosuchuser/x")


@pytest.mark.parametrize("part", in_brief(range(4), 0, 1))
def test_mutants_are_refused_with_a_place_or_mean_something(part: int, tmp_path: Path) -> None:
    """Never another exception than InputError, and what is accepted reads back as the same scenario."""
    path, accepted, refused = tmp_path / mutants.NAME, 0, 0
    for mutant in islice(mutants.mutants(sources(), 100 + part), 75):
        path.write_bytes(mutant.text)
        try:
            scenario, _ = read_any(path)
        except InputError as error:
            refused += 1
            if not all(problem.place.line for problem in error.problems):
                raise
            continue
        accepted += 1
        dumped = scenario.model_dump(mode="json", exclude_none=True)
        path.write_text(dump(dumped), encoding="utf-8")
        assert read_any(path)[0] == scenario
    assert refused > 20
    assert accepted > 0


@pytest.mark.parametrize("title", ["1e3", "0o17", "\u22125", "1e-3", "5", "yes", "~", "1_000", "nan"])
def test_texts_that_look_like_numbers_stay_texts(title: str, tmp_path: Path) -> None:
    """In a stored scenario, and in one that the planner changes."""
    scenario, document = read_any(shipped.path("landing"), [f'title="{title}"'])
    (tmp_path / "s.yaml").write_text(resolved_yaml(scenario))
    assert read_any(tmp_path / "s.yaml")[0] == scenario
    (tmp_path / "t.yaml").write_text(rewritten(shipped.text("landing"), document.data).text)
    assert read_any(tmp_path / "t.yaml")[0].title == title
