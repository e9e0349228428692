"""`navsim evidence`: a folder for a reviewer, which is an RO-Crate."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.report.assurance import CONDITION, JUDGES, SECTIONS, UNCHECKED, judged, rows_of, unmodelled_effects
from navsim.report.citations import METHODS
from navsim.results.checksum import MARK
from navsim.results.result import Result, read
from navsim.scenario.load import section
from navsim.scenario_files.keys import rows as key_rows
from tests.forks import navsim
from tests.made import EVERY


def test_every_judge_is_a_test_and_every_test_a_judge() -> None:
    """The table in the package is that of the oracle tests, which write `docs/validation.md`."""
    rows = [cells for _, cells in rows_of("validation.md") if len(cells) > 1]
    claims = {cells[0] for cells in rows}
    told = {claim for group in JUDGES.values() for claim in group}
    assert told == claims
    assert set(JUDGES) <= {method.name for method in METHODS}
    page = (Path(__file__).parents[2] / "docs" / "validation.md").read_text(encoding="utf-8")
    assert [part for part in UNCHECKED if f"\n| {part} |\n" not in page] == []
    sources = "\n".join(path.read_text() for path in (Path(__file__).parents[1] / "oracle").glob("test_*.py"))
    assert [cells[3] for cells in rows if f"def {cells[3].strip('`')}(" not in sources] == []


def test_every_section_of_the_limits_has_its_results() -> None:
    rows = rows_of("limits.md")
    assert {section for section, _ in rows} == set(SECTIONS)
    assert all(len(cells) == 3 and all(cells) for _, cells in rows)


def test_conditions_of_the_limits_are_keys() -> None:
    schemas = (section(kind).model_json_schema() for kind in ("landing", "replay"))
    known = {re.sub(r"\.N\b", "", row.key) for schema in schemas for row in key_rows(schema)}
    known |= {name[:end] for name in known for end in range(len(name)) if name[end] == "."}
    named = {key for _, cells in rows_of("limits.md") for _, _, key, _ in CONDITION.findall(cells[0]) if key}
    assert len(named) > 30
    assert named <= known


@pytest.mark.parametrize("kind", EVERY)
def test_every_kind_has_its_limits_and_judges(kind: str, place: Path) -> None:
    result = read(place / f"{kind}.h5")
    rows, without = judged(result)
    assert rows or without or kind == "ranges"
    found = unmodelled_effects(result)
    texts = " ".join(f"{each.effect} {each.consequence} {each.remedy}" for each in found)
    assert "`" not in texts
    assert "](" not in texts
    assert len(found) < 40
    if kind == "runs":
        assert "flight dynamics" in texts
        assert "without signals.errors" in texts
        assert "changes of orbit" not in texts  # of signals.ephemeris, which this scenario lacks
        assert "hard iron" not in texts  # of a magnetometer
        assert "live source" not in texts
        assert "the sum of several Gaussians, held axes of biases" in without
        assert "control variates" not in without  # of 30 runs
        named = [each.effect.rpartition("without ")[2] for each in found if each.forbids]
        assert named == ["signals.errors", *(f"pseudolites.{key}_sigma_{unit}" for key, unit in (
            ("clock", "ns"), ("range_bias", "m"), ("survey", "m")))]  # fmt: skip


def test_a_setting_of_none_has_no_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """An exclusion that is switched off has no limits; checks of stations are those of landings that have some."""
    scenario: dict[str, Any] = {"integrity": {"method": "chi2", "exclusion": "none"}}
    monkeypatch.setattr("navsim.report.assurance.scenario_of", lambda _: scenario)
    monkeypatch.setattr("navsim.report.citations.scenario_of", lambda _: scenario)
    result = Result({"kind": "landing", "method": "monte-carlo"}, {})
    excluding = "memory of excluded sources (integrity.exclusion)"
    assert excluding not in {each.effect for each in unmodelled_effects(result)}
    stations = {each.claim for each in judged(result)[0] if "ground stations" in each.claim}
    assert not stations
    scenario |= {"integrity": {"method": "chi2", "exclusion": "residual"}, "dme": {"noise_m": 1.0}}
    assert excluding in {each.effect for each in unmodelled_effects(result)}
    rows, without = judged(result)
    assert [each.method for each in rows if "ground stations" in each.claim] == [
        "ground stations: angles, and limits of presets"
    ]
    assert not [name for name in without if "ground stations" in name]


@pytest.mark.parametrize("method", ["chi2", "mhss", "filter"])
@pytest.mark.parametrize("count", [0, 2])
def test_a_row_may_name_several_values_and_pseudolites(
    monkeypatch: pytest.MonkeyPatch, method: str, count: int
) -> None:
    scenario = {
        "integrity": {"method": method, "effective_samples": 1.0}, "pseudolites": {"count": count, "s_m": 1.0}
    }  # fmt: skip
    monkeypatch.setattr("navsim.report.assurance.scenario_of", lambda _: scenario)
    found = [each.effect for each in unmodelled_effects(Result({"kind": "landing", "method": "monte-carlo"}, {}))]
    assert any("more than one independent error" in effect for effect in found) == (method != "chi2")
    assert any("without pseudolites.clock_sigma_ns" in effect for effect in found) == bool(count)


def graph_of(folder: Path) -> dict[str, dict[str, Any]]:
    """Entities of a crate by their identifiers."""
    crate = json.loads((folder / "ro-crate-metadata.json").read_text(encoding="utf-8"))
    assert crate["@context"][0] == "https://w3id.org/ro/crate/1.1/context"
    entities = crate["@graph"]
    assert len({entity["@id"] for entity in entities}) == len(entities)
    return {entity["@id"]: entity for entity in entities}


def follows_the_specification(folder: Path) -> None:
    """What RO-Crate 1.1 says that a crate MUST have."""
    graph = graph_of(folder)
    about = graph["ro-crate-metadata.json"]
    assert about["@type"] == "CreativeWork"
    assert about["about"] == {"@id": "./"}
    assert about["conformsTo"]["@id"].startswith("https://w3id.org/ro/crate/1.1")
    root = graph["./"]
    assert root["@type"] == "Dataset"
    assert all(root[name] for name in ("name", "description", "license"))
    datetime.fromisoformat(root["datePublished"])
    named = {part["@id"] for part in root["hasPart"]}
    files = {key for key, entity in graph.items() if entity["@type"] == "File"}
    assert named == files
    for key in files:
        content = (folder / key).read_bytes()
        assert graph[key]["sha256"] == hashlib.sha256(content).hexdigest()
        assert graph[key]["contentSize"] == str(len(content))
    on_disk = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert on_disk - files == {"ro-crate-metadata.json", "SHA256SUMS"}

    def references(value: Any) -> list[str]:
        if isinstance(value, list):
            return [each for one in value for each in references(one)]
        return [value["@id"]] if isinstance(value, dict) else []

    for entity in graph.values():
        assert entity["@id"]
        assert entity["@type"]
        for name, value in entity.items():
            if name != "conformsTo":
                assert set(references(value)) <= set(graph), (entity["@id"], name)


def test_a_folder_for_a_reviewer(place: Path, tmp_path: Path) -> None:
    done = navsim("evidence", place / "runs.h5", "-o", "folder", "--license", "https://x.org/terms", cwd=tmp_path)
    folder = tmp_path / "folder"
    assert done.stdout.splitlines()[-1] == "folder/SHA256SUMS"
    follows_the_specification(folder)
    assert graph_of(folder)["./"]["license"] == {"@id": "https://x.org/terms"}
    text = (folder / "ro-crate-preview.html").read_text(encoding="utf-8")
    for part in ("not met: 0.774", "undecided", "GDOP, PDOP, HDOP, VDOP, TDOP", "closed form (gnss_lib_py)",
                 "flight dynamics", "navsim verify runs.h5 --folder inputs", "code of navsim", "is the one that",
                 "<h2>Warnings</h2>\n<p>Not modelled: time-correlated errors of satellite ranges"):  # fmt: skip
        assert part in text
    assert not re.search("certified|compliant|certif", text, re.IGNORECASE)
    assert "http" not in re.sub(r"<pre.*?</pre>", "", text, flags=re.DOTALL)  # needs no network
    sums = dict(reversed(line.split("  ")) for line in (folder / "SHA256SUMS").read_text().splitlines())
    assert sums["runs.h5"] == hashlib.sha256((place / "runs.h5").read_bytes()).hexdigest()
    navsim("verify", "runs.h5", "--runs", 8, cwd=folder)
    navsim("evidence", place / "runs.h5", "-o", "folder", cwd=tmp_path, code=2)  # not empty


def test_a_damaged_result_has_no_folder(place: Path, tmp_path: Path) -> None:
    """A changed byte of any block, also of one that the page does not read."""
    whole = (place / "runs.h5").read_bytes()
    content = int.from_bytes(whole[-len(MARK) - 40 : -len(MARK) - 32], "little")
    for at in (content // 4, content // 2, content - 1):
        (tmp_path / "bad.h5").write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        done = navsim("evidence", "bad.h5", "-o", "folder", "--folder", place, cwd=tmp_path, code=2)
        assert "error: bad.h5: " in done.stderr
        assert not (tmp_path / "folder").exists()


def test_the_page_repeats_the_result(place: Path, tmp_path: Path) -> None:
    """The commands of the page give the same numbers, in a folder that has nothing else."""
    navsim("evidence", place / "rare.h5", "-o", "folder", cwd=tmp_path)
    folder = tmp_path / "folder"
    text = (folder / "ro-crate-preview.html").read_text(encoding="utf-8")
    words = re.search(r"navsim (run ../again/again.yaml[^<\n]*)", text)
    assert words
    shutil.copytree(folder / "inputs", tmp_path / "again")
    shutil.copy(folder / "scenario.yaml", tmp_path / "again" / "again.yaml")
    navsim(*words[1].split(), "-q", cwd=folder)
    first, again = read(folder / "rare.h5"), read(tmp_path / "again" / "again.h5")
    assert "navsim show rare.h5 ../again/again.h5 --compare" in text
    for path in ("/summary/rare/probability", "/rare/error"):
        np.testing.assert_array_equal(first[path], again[path])


@pytest.mark.parametrize("kind", ["optimize", "sweep", "replay", "ranges", "atc-tracking", "live", "table2"])
def test_other_kinds_have_a_folder_too(kind: str, place: Path, tmp_path: Path) -> None:
    navsim("evidence", place / f"{kind}.h5", "-o", "folder", cwd=tmp_path)
    follows_the_specification(tmp_path / "folder")
    if kind in ("optimize", "sweep"):
        assert (tmp_path / "folder" / "study.yaml").is_file()
        assert any((tmp_path / "folder" / "inputs").iterdir())
