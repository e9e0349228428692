"""The reference of keys: every key of every kind is described, has a unit or is known to have none, and an example."""

from __future__ import annotations

import importlib.util
import re
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from pydantic import BaseModel, TypeAdapter
from pydantic_core import PydanticUndefined

from navsim.kinds import OF_FILES
from navsim.scenario.load import read_any, section
from navsim.scenario_files import shipped
from navsim.scenario_files.keys import KeyRow, rows
from navsim.scenario_files.presets import IMU_PRESETS
from tests.conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts"))  # one script imports another


@cache
def script(name: str) -> ModuleType:
    """A script of the tree as a module."""
    spec = importlib.util.spec_from_file_location(f"script_{name}", ROOT / "scripts" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


reference = script("reference")


def properties(kind: str) -> dict[str, dict[str, Any]]:
    """Every property of the schema of a kind, by its section."""
    schema = section(kind).model_json_schema()
    sections = {**schema.get("$defs", {}), kind: schema}
    return {f"{name}.{key}": p for name, s in sections.items() for key, p in s.get("properties", {}).items()}


@pytest.mark.parametrize("kind", OF_FILES)
def test_every_key_is_described(kind: str) -> None:
    every = properties(kind)
    assert len(every) >= 20
    assert [key for key, value in every.items() if len(value.get("description", "")) < 4] == []


def test_there_are_as_many_keys_as_were_counted() -> None:
    """A schema that lost its keys would have them all described."""
    assert sum(len(properties(kind)) for kind in OF_FILES) >= 600


@pytest.mark.parametrize("kind", OF_FILES)
def test_the_pages_of_a_kind_have_every_key_once(kind: str) -> None:
    lines = "\n".join(reference.pages_of(kind).values()).splitlines()
    every = [row.key for row in rows(section(kind).model_json_schema())]
    listed = [key for key in re.findall(r"^\| `([^`]+)` \|", "\n".join(lines), re.M) if key not in IMU_PRESETS]
    tops = [key for key in every if "." not in key and key not in listed]
    assert sorted(listed + tops) == sorted(every)


def test_pages_are_written_once_and_old_ones_go(tmp_path: Path) -> None:
    (tmp_path / "gone.md").write_text("# Of a kind that there was\n")
    reference.write(tmp_path)
    written = {str(path.relative_to(tmp_path)): path.stat().st_mtime_ns for path in tmp_path.rglob("*.md")}
    assert written.keys() == reference.pages().keys()
    assert {f"{kind}.md" for kind in OF_FILES} | {"landing/filter.md", "results/landing.md"} <= written.keys()
    reference.write(tmp_path)
    assert {str(path.relative_to(tmp_path)): path.stat().st_mtime_ns for path in tmp_path.rglob("*.md")} == written


@pytest.mark.parametrize("kind", OF_FILES)
def test_every_key_has_an_example(kind: str) -> None:
    refused = reference.NO_EXAMPLE.get(kind, ())
    every: list[KeyRow] = [row for row in rows(section(kind).model_json_schema()) if not row.section]
    assert [row.key for row in every if row.key not in refused and reference.example(kind, row) is None] == []


SETS = [(kind, *one) for kind, sets in reference.EXAMPLES.items() for one in sets]


@pytest.mark.parametrize(("kind", "name", "assignments"), SETS)
def test_examples_are_valid(kind: str, name: str, assignments: tuple[str, ...]) -> None:
    scenario, _ = read_any(shipped.path(name), assignments)
    assert scenario.kind == kind


WITHOUT_UNIT = {
    "p_fa", "p_md", "p_hmi_v", "p_hmi_h", "p_fa_v", "p_fa_h", "p_unmonitored_max",
    "p_satellite", "p_constellation", "p_constellations", "p_station",
    "p_pseudolite", "p_beacon", "prior", "probability", "confidence", "at_most", "at_least", "availability", "share",
    "long_share",
    "outlier_share", "loss", "truth_refractivity_n", "corrected_refractivity_n",
    "refractivity_sigma_n",
    "band", "duty", "sigma_share", "height_sigma_share", "load_factor", "load_factor_limit", "bearing_year",  # of one
    "exponent", "damping", "glide_full_scale", "within",  # parts of a scale
    "fixed", "float", "differential", "single", "wrong",  # shares of the states of a fix
    "truth_scale", "fix_sigma_scale", "permittivity", "sigma_ratio_acc", "core", "tail", "sigma_tolerance",  # ratios
    "hdop",
    "max_rejected", "components", "samples", "receivers", "reference_receiver", "effective_samples",
    "runs", "study_runs", "steps", "experiments",  # counts
    "lift_slope", "side_force_slope", "drag",  # coefficients
    "each", "mast_per_metre", "cost",  # in a currency
    "count", "pseudolites", "beacons", "effort", "min_satellites",
    "h0", "h_minus2", "rate_sigma", "alpha", "beta", "initial_variance",  # what it means says the unit
    "first", "last", "step",  # in the unit of the key that is varied
}  # fmt: skip
"""Last names of keys that are numbers and have no unit at their end."""


@pytest.mark.parametrize("kind", OF_FILES)
def test_numbers_have_a_unit_or_are_known_to_have_none(kind: str) -> None:
    lost = []
    for row in rows(section(kind).model_json_schema()):
        name = [part for part in row.key.split(".") if not re.fullmatch("[A-Z]+", part)][-1]
        if re.search("number", row.kind) and not row.unit and name not in WITHOUT_UNIT:
            lost.append(row.key)
    assert lost == []


def effective(model: type[BaseModel], known: BaseModel | None, prefix: str = "") -> dict[str, Any]:
    """The value of every key that is left out, with all around it, as the sections set it."""
    out: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        value = getattr(known, name) if known is not None else field.get_default(call_default_factory=True)
        if isinstance(value, BaseModel):
            if "preset" not in type(value).model_fields:  # a preset fills in values of its own
                out |= effective(type(value), value, f"{prefix}{name}.")
        elif value is not PydanticUndefined:
            out[prefix + name] = TypeAdapter(Any).dump_python(value, mode="json")
    return out


@pytest.mark.parametrize("kind", OF_FILES)
def test_documented_defaults_are_those_of_the_sections(kind: str) -> None:
    """A section may set other defaults for the keys of another one that it holds: those are documented."""
    documented = {row.key: row for row in rows(section(kind).model_json_schema()) if not row.section}
    set_so = {key: value for key, value in effective(section(kind), None).items() if key in documented}
    assert len(set_so) >= 5
    wrong = {
        key: (value, documented[key].default)
        for key, value in set_so.items()
        if value not in ({}, None) and (documented[key].default != value or documented[key].required)
    }
    assert wrong == {}


def test_the_gallery_is_what_its_script_writes() -> None:
    gallery = script("gallery")
    assert gallery.text() == gallery.PAGE.read_text(encoding="utf-8")
    pictures = re.findall(r"\((images/[^)]+)\)", gallery.text())
    assert len(pictures) >= 20
    assert [name for name in pictures if not (gallery.PAGE.parent / name).is_file()] == []
