"""Files and results with former names are read, with a warning that names the new one."""

import json
from importlib.resources import files
from pathlib import Path

import pytest

from navsim.results import former_names
from navsim.results.former_names import present_path
from navsim.results.result import Result, Variable, read, scenario_of, write
from navsim.results.schema import SECTIONS
from navsim.runner.opening import checked
from navsim.scenario.load import read_any, resolved_yaml
from navsim.scenario_files.source import InputError, load, parse, set_value

LANDING = Path("scenarios/landing.yaml")
FORMER = {
    "approach.corner_s": ("approach.transition_time_s", 0.7),
    "sky.lenient": ("sky.skip_bad_records", False),
    "receiver.one_clock": ("receiver.single_clock", True),
    "integrity.alarmed_fixes": ("integrity.on_alarm", "drop"),
    "integrity.heavier.tail": ("integrity.heavy_tailed.tail", 4.0),
    "filter.gaussian_sum.heading_deg": ("filter.gaussian_sum.split_heading_sigma_deg", 7.0),
    "signals.errors.multipath.time_s": ("signals.errors.multipath.correlation_time_s", 9.0),
}
MORE = {
    "integrity.alarmed_fixes": ("integrity.method=chi2", "integrity.exclusion=residual"),
    "integrity.heavier.tail": ("integrity.method=chi2", "integrity.error_model=heavier"),
    "signals.errors.multipath.time_s": ("signals.errors.multipath.sigma_m=1",),
}


@pytest.mark.parametrize("former", FORMER)
def test_a_former_key_is_read_and_named(former: str) -> None:
    new, value = FORMER[former]
    more = MORE.get(former, ())
    old, document = read_any(LANDING, (*more, f"{former}={json.dumps(value)}"))
    present, silent = read_any(
        LANDING, (*(m.replace("heavier", "heavy_tailed") for m in more), f"{new}={json.dumps(value)}")
    )
    assert old == present
    (warning,) = document.renamed
    changed = next(b for a, b in zip(former.split("."), new.split("."), strict=True) if a != b)
    assert warning.startswith(f"--set {former}=")
    assert f"is called {changed} now" in warning
    assert silent.renamed == []


def test_a_former_key_of_a_file_keeps_its_line() -> None:
    text = LANDING.read_text().replace("  transition_time_s: 0.5", "  corner_s: 50")
    line = 1 + text[: text.index("corner_s")].count("\n")
    document = parse(text, "old.yaml", Path("scenarios"))
    assert document.renamed[0].startswith(f"old.yaml:{line}:3: approach.corner_s: ")
    with pytest.raises(InputError, match=rf"old\.yaml:{line}:3: approach\.transition_time_s: must be at most 5 s"):
        read_any(document)


def test_a_key_by_both_names_is_refused() -> None:
    text = LANDING.read_text().replace("  transition_time_s: 0.5", "  transition_time_s: 0.5\n  corner_s: 0.5")
    with pytest.raises(InputError, match=r"approach\.transition_time_s: is given twice, also by its former name"):
        parse(text, "old.yaml", Path("scenarios"))


def test_a_study_may_vary_a_former_key() -> None:
    base = load(LANDING)
    set_value(base, "approach.corner_s", 0.9, base.place(()), Path())
    assert base.data["approach"]["transition_time_s"] == 0.9
    assert "corner_s" not in base.data["approach"]


@pytest.mark.parametrize(
    ("text", "new"),
    [
        ("set: {approach.corner_s: 0.9}\nvary: [{key: pseudolites.s_m, values: [1, 2]}]", "transition_time_s"),
        ("set: {sky: {lenient: false}}\nvary: [{key: pseudolites.s_m, values: [1, 2]}]", "skip_bad_records"),
        ("vary: [{key: approach.corner_s, values: [0.4, 0.9]}]", "transition_time_s"),
        ("vary: [{keys: [pseudolites.s_m, approach.corner_s], values: [[1, 0.4]]}]", "transition_time_s"),
    ],
)
def test_a_study_tells_once_of_its_former_keys(text: str, new: str, tmp_path: Path) -> None:
    """Those of `set` and `vary` were renamed without a word."""
    file = tmp_path / "study.yaml"
    file.write_text(f"kind: sweep\nversion: 1\nmethod: dop\nbase: {LANDING.resolve()}\n{text}\n")
    (told,) = [one for one in checked(file, ())[2] if f"is called {new} now" in one]
    assert told.startswith(f"{file}:5:")


def test_present_keys_exist() -> None:
    keys = json.loads((files("navsim") / "scenario_files/keys.json").read_text())
    known = {key.rpartition(".")[2] for kind in keys.values() for key in kind} if isinstance(keys, dict) else set()
    for table in former_names._FORMER.values():
        assert set(table.values()) - {"heavy_tailed"} <= known


def test_variables_of_old_results_have_present_paths(tmp_path: Path) -> None:
    paths = {"/front/met": "/pareto/met", "/useful/subsets": "/subsets/number", "/useful/hpl": "/subsets/hpl",
             "/audit/verdict": "/published/verdict", "/fit/letter": "/fit/id"}  # fmt: skip
    assert {path: present_path(path) for path in paths} == paths
    assert present_path("/summary/rms") == "/summary/rms"
    now = [entry.path for chapter in SECTIONS for entry in chapter.entries]
    assert [present_path(path) for path in now] == now
    section, _ = read_any(LANDING)
    old = resolved_yaml(section).replace("transition_time_s", "corner_s")
    stored = Result(
        {"kind": "optimize", "navsim_version": "0", "scenario": old}, {"/front/x": Variable((), 1.5, "m", "x")}
    )
    write(tmp_path / "old.h5", stored)
    found = read(tmp_path / "old.h5")
    assert found["/pareto/x"] == 1.5
    assert scenario_of(found)["approach"]["transition_time_s"] == 0.5
