"""At the prompt: completion, the reference of keys, schemas as editors read them."""

from __future__ import annotations

import functools
import itertools
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from typer.testing import CliRunner

from navsim.cli.completion import UNTIL
from navsim.cli.main import PLACES, app
from navsim.kinds import OF_FILES
from navsim.landing.controlled import stopping_rule
from navsim.landing.rare_events import stopping_rule as rare_rule
from navsim.scenario.load import section
from navsim.scenario_files import key_names, shipped
from navsim.scenario_files.json_schema import ANY, DIALECT, identity, published
from navsim.scenario_files.source import load
from tests.conftest import ROOT, SCENARIOS
from tests.forks import navsim, shared
from tests.helpers import load_script


def need(program: str) -> str:
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"{program} is not installed")
    return found


TYPED = [
    ("navsim sw", {"sweep"}),
    ("navsim run --method c", {"covariance"}),
    ("navsim run --keep ", {"errors", "all", "none"}),
    ("navsim init placement_", {"placement_lpv200", "placement_optimum", "placement_sweep"}),
    ("navsim schema mls", {"mls-elevation"}),
    ("navsim keys op", {"optimize"}),
    ("navsim run --set filter.gate.max", {"filter.gate.max_rejected="}),
    ("navsim replay --set tuni", {"tuning="}),
    ("navsim validate glide.yaml --set sky.directions.3.az", {"sky.directions.3.azimuth_deg="}),
    ("navsim show glued.h5 --format m", {"markdown"}),
    ("navsim plot glued.h5 --only ", {"sky", "track"}),
    ("navsim plot glued.h5 --only sky,t", {"sky,track"}),
    ("navsim run glide.yaml --require-f", {"--require-fix"}),
    ("navsim run --set filter.kind=gau", {"filter.kind=gaussian-sum"}),
    ("navsim validate glide.yaml --set scan_p", set()),
    ("navsim run glide.yaml", set()),  # the shell completes files
]


@pytest.mark.parametrize(("typed", "offered"), TYPED, ids=[typed for typed, _ in TYPED])
def test_completion_offers(typed: str, offered: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a shell gets that has run `navsim --install-completion`."""
    for name in ("glued_sky.png", "glued_track.svg"):
        (tmp_path / name).touch()
    (tmp_path / "glide.yaml").write_text("kind: landing\nversion: 1\n")
    monkeypatch.chdir(tmp_path)
    words = typed.split(" ")
    asked = {"_NAVSIM_COMPLETE": "complete_bash", "COMP_WORDS": "\n".join(words), "COMP_CWORD": str(len(words) - 1)}
    assert set(CliRunner().invoke(app, prog_name="navsim", env=asked).output.split()) == offered


def test_an_answer_loads_no_models_and_no_kernels() -> None:
    """A completion comes while somebody types. What it loads is said by the interpreter itself."""
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c",
         "import sys; sys.argv = ['navsim']; from navsim.__main__ import main; main()"],
        env={**os.environ, "_NAVSIM_COMPLETE": "complete_bash", "COMP_CWORD": "4",
             "COMP_WORDS": "navsim run glide.yaml --set filt"},
        capture_output=True, text=True, cwd=ROOT,
    )  # fmt: skip
    assert "filter.kind=" in done.stdout
    loaded = {line.rpartition("|")[2].strip().split(".")[0] for line in done.stderr.splitlines()}
    assert {"numba", "numpy", "scipy", "yaml", "rich", "bokeh"} & loaded == set()


def test_the_list_of_names_is_that_of_the_models() -> None:
    script = load_script("key_names")
    assert key_names.FILE.read_text(encoding="utf-8") == script.text(script.collected()), "run: make docs"


def test_what_until_is_offered_is_taken() -> None:
    for expression in UNTIL:
        rare = expression.startswith("probability")
        (rare_rule if rare else stopping_rule)(lambda: None, expression)


# --- navsim keys


def test_keys_are_printed_with_what_they_mean(tmp_path: Path) -> None:
    said = navsim("keys", "landing", "flare_height", cwd=tmp_path).stdout
    assert said.splitlines()[0] == "approach.flare_height_m"
    assert "number; m; 0.01 to 1000; default 6.0; with approach.profile: smooth" in said
    every = json.loads(navsim("keys", "landing", "--json", cwd=tmp_path).stdout)
    assert len(every) > 200
    assert {"key", "unit", "range", "default", "meaning", "choices", "required", "when"} <= every[0].keys()


def test_keys_that_are_not_there_get_their_nearest(tmp_path: Path) -> None:
    assert "did you mean 'landing'?" in navsim("keys", "landig", cwd=tmp_path, code=2).stderr
    said = navsim("keys", "landing", "glide_slop_deg", cwd=tmp_path, code=2).stderr
    assert "nearest: approach.glide_slope_deg" in said
    assert "lists all" in navsim("keys", "landing", "qqqqqq", cwd=tmp_path, code=2).stderr


# --- navsim variables


def test_variables_of_a_result_are_printed_with_what_they_mean(tmp_path: Path) -> None:
    said = navsim("variables", "landing", "nees_position", cwd=tmp_path).stdout
    facts = "    number; 1; (run, time); unless `--keep none`"
    assert said.splitlines()[:2] == ["/filter/nees_position_velocity", facts]
    every = json.loads(navsim("variables", "covariance", "--json", cwd=tmp_path).stdout)
    assert {"/filter/sigma", "/summary/budget/source"} <= {path for row in every for path in row["paths"]}
    assert "did you mean 'covariance'?" in navsim("variables", "covarianc", cwd=tmp_path, code=2).stderr
    assert "lists all" in navsim("variables", "landing", "qqqqqq", cwd=tmp_path, code=2).stderr


# --- schemas


@pytest.mark.parametrize("kind", [*OF_FILES, ANY])
def test_schemas_say_what_they_are(kind: str) -> None:
    schema = published(kind)
    assert (schema["$schema"], schema["$id"]) == (DIALECT, identity(kind))
    assert schema["title"]
    jsonschema.Draft202012Validator.check_schema(schema)
    for example in schema["examples"]:
        jsonschema.Draft202012Validator(schema).validate(example)


def arrays(node: Any) -> Iterator[dict[str, Any]]:
    if isinstance(node, dict):
        if node.get("type") == "array":
            yield node
        for child in node.values():
            yield from arrays(child)
    elif isinstance(node, list):
        for child in node:
            yield from arrays(child)


@pytest.mark.parametrize("kind", OF_FILES)
def test_lists_are_bounded_as_lists(kind: str) -> None:
    assert not [node for node in arrays(section(kind).model_json_schema()) if {"minLength", "maxLength"} & node.keys()]


def test_an_empty_list_is_refused_by_the_schema_as_by_navsim(tmp_path: Path) -> None:
    data = dict(load(shipped.path("placement_sweep")).data)
    validator = jsonschema.Draft202012Validator(published("sweep"))
    assert validator.is_valid(data)
    assert not validator.is_valid(data | {"vary": []})


@functools.cache
def every_kind() -> dict[str, Any]:
    return published(ANY)


@pytest.mark.parametrize("name", shipped.names())
def test_the_schema_of_any_kind_takes_every_template_and_no_misspelt_key(name: str) -> None:
    validator = jsonschema.Draft202012Validator(every_kind())
    data = load(shipped.path(name)).data
    validator.validate(data)
    assert not validator.is_valid(data | {"titel": "x"})


@pytest.fixture
def data_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder whose name needs care in a URI."""
    return tmp_path / "data home"


def install(tmp_path: Path, data_home: Path, *arguments: str) -> str:
    done = subprocess.run(
        [shared().programs(tmp_path / "bin") / "navsim", *arguments],
        cwd=tmp_path, env={**os.environ, "XDG_DATA_HOME": str(data_home)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_templates_name_their_schema_where_it_is_installed(tmp_path: Path, data_home: Path) -> None:
    install(tmp_path, data_home, "init", "landing")
    assert (tmp_path / "landing.yaml").read_text() == shipped.text("landing")
    install(tmp_path, data_home, "schema", "--install")
    lying = {path.stem for path in (data_home / "navsim" / "schema").glob("*.json")}
    assert lying == {*OF_FILES, ANY}
    install(tmp_path, data_home, "init", "landing", "-o", "mine.yaml")
    first, _, rest = (tmp_path / "mine.yaml").read_text().partition("\n")
    assert rest == shipped.text("landing")
    named = re.fullmatch(r"# yaml-language-server: \$schema=file://(\S+)", first)
    assert named is not None
    copy = Path(named[1].replace("%20", " "))
    assert json.loads(copy.read_text()) == published("landing")
    install(tmp_path, data_home, "validate", "mine.yaml")


# --- an editor


class Server:
    """yaml-language-server as an editor has it: messages with a length before each, over its standard streams."""

    def __init__(self, program: str, folder: Path) -> None:
        self._process = subprocess.Popen(
            [program, "--stdio"], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self._ids = itertools.count(1)
        self.notes: list[dict[str, Any]] = []

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def tell(self, method: str, parameters: Any, **more: Any) -> None:
        self._send({"jsonrpc": "2.0", "method": method, "params": parameters, **more})

    def _send(self, message: dict[str, Any]) -> None:
        assert self._process.stdin is not None
        text = json.dumps(message).encode()
        self._process.stdin.write(b"Content-Length: %d\r\n\r\n" % len(text) + text)
        self._process.stdin.flush()

    def ask(self, method: str, parameters: Any) -> Any:
        number = next(self._ids)
        self.tell(method, parameters, id=number)
        while True:
            message = self.read()
            if message.get("id") == number and "method" not in message:
                return message["result"]

    def read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        length = 0
        while (line := self._process.stdout.readline().strip()) or not length:
            assert line or self._process.poll() is None, "it is gone"
            if line.lower().startswith(b"content-length:"):
                length = int(line.partition(b":")[2])
        message: dict[str, Any] = json.loads(self._process.stdout.read(length))
        if "method" in message and "id" in message:  # it asks for settings: there are none
            items = message.get("params", {}).get("items", []) if message["method"] == "workspace/configuration" else []
            self._send({"jsonrpc": "2.0", "id": message["id"], "result": [{} for _ in items] or None})
        elif "method" in message:
            self.notes.append(message)
        return message

    def marked(self, uri: str) -> list[str]:
        """What is marked in a file, once it is known."""
        while True:
            for note in self.notes:
                if note["method"] == "textDocument/publishDiagnostics" and note["params"]["uri"] == uri:
                    self.notes.remove(note)
                    return [found["message"] for found in note["params"]["diagnostics"]]
            self.read()


@pytest.mark.long
@pytest.mark.parametrize("schema", ["landing", ANY])
def test_an_editor_marks_explains_and_completes_keys(schema: str, tmp_path: Path, data_home: Path) -> None:
    """By the line that `navsim init` writes, and by the schema that takes every kind."""
    program = need("yaml-language-server")
    install(tmp_path, data_home, "schema", "--install")
    install(tmp_path, data_home, "init", "landing_smooth")
    text = (tmp_path / "landing_smooth.yaml").read_text().replace("/landing.json", f"/{schema}.json")
    assert f"/{schema}.json" in text.splitlines()[0]
    server = Server(program, tmp_path)
    try:
        server.ask("initialize", {"processId": None, "rootUri": tmp_path.as_uri(), "capabilities": {}})
        server.tell("initialized", {})

        def opened(name: str, text: str) -> str:
            uri = (tmp_path / name).as_uri()
            document = {"uri": uri, "languageId": "yaml", "version": 1, "text": text}
            server.tell("textDocument/didOpen", {"textDocument": document})
            return uri

        assert server.marked(opened("right.yaml", text)) == []
        wrong = server.marked(opened("wrong.yaml", text.replace("glide_slope_deg:", "glide_slope_degg:")))
        if schema == ANY:
            assert wrong
        else:
            assert any("glide_slope_degg" in message for message in wrong)
        lines = text.splitlines()
        at = next(number for number, line in enumerate(lines) if line.startswith("epoch:"))
        right = {"textDocument": {"uri": (tmp_path / "right.yaml").as_uri()}}
        shown = server.ask("textDocument/hover", right | {"position": {"line": at, "character": 2}})
        assert "UTC of time 0" in json.dumps(shown)
        uri = opened("new.yaml", f"{lines[0]}\nkind: landing\nrunw\n")
        found = server.ask(
            "textDocument/completion", {"textDocument": {"uri": uri}, "position": {"line": 2, "character": 4}}
        )
        items = found["items"] if isinstance(found, dict) else found
        assert "runway" in {item["label"] for item in items}
    finally:
        server.close()


@pytest.mark.parametrize("name", ["merge", "show", "cite"])
def test_help_has_no_types_of_python(name: str) -> None:
    text = CliRunner().invoke(app, [name, "--help"]).output
    assert "<path>" in text
    assert "list[" not in text


def test_help_says_what_each_command_is_for() -> None:
    """In the words with which its own help begins."""
    said = " ".join(CliRunner().invoke(app, ["--help"]).output.split())
    for name in PLACES:
        own = CliRunner().invoke(app, [name, "--help"]).output.split("\n\n")[1]
        (first, *_) = own.strip().split(".\n")[0].split(". ")
        assert f" {name} {' '.join(first.split())}" in said


def test_a_newcomer_is_told_where_to_start() -> None:
    """By the bare command and by `help`, without an error."""
    shown = [CliRunner().invoke(app, given) for given in ([], ["help"], ["--help"])]
    assert {(done.exit_code, done.output) for done in shown} == {(0, shown[0].output)}
    assert "Start with: navsim init" in shown[0].output
    assert CliRunner().invoke(app, ["help", "plot"]).output == CliRunner().invoke(app, ["plot", "--help"]).output
    assert "--require takes no value" in CliRunner().invoke(app, ["run", "x.yaml", "--require", "lateral<1"]).output


def test_validate_says_what_changes_nothing(tmp_path: Path) -> None:
    given = ("--set", "sky.almanac=README.md", "--set", "integrity={method: mhss, p_fa: 1e-4, effective_samples: 25}")
    done = navsim("validate", SCENARIOS / "landing.yaml", *given, cwd=tmp_path)
    assert done.stderr.splitlines() == [
        "warning: sky.almanac is not used: sky.source is nominal-glonass",
        "warning: integrity.p_fa is not used: integrity.method is mhss",
    ]
    assert "a valid scenario" in done.stdout
    small = ("--set", "vary.1.grid.count=3", "--set", "vary.2.grid.count=3")
    assert navsim("validate", SCENARIOS / "placement_sweep.yaml", *small, cwd=tmp_path).stderr == ""
