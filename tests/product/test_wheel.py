"""The wheel: what it holds, what it asks for, and that it works in an empty folder without this tree."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

from tests.conftest import ROOT

pytest.importorskip("hatchling")

BASE = {
    "h5py", "hatanaka", "matplotlib", "ncompress", "numba", "numpy", "pillow", "pydantic", "pynmeagps", "pyserial",
    "pyyaml", "rich", "scipy", "sgp4", "shapely", "typer",
}  # fmt: skip
"""All that a plain installation brings."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, capture_output=True, check=True)
    (made,) = folder.glob("*.whl")
    return made


def tracked(*folders: str) -> list[str]:
    """Files that git has below folders."""
    command = ["git", "ls-files", "-z", *folders]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [name for name in listed.split("\0") if name]


def test_it_holds_the_package_and_the_scenarios(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
    scenarios = {f"navsim/scenario_files/templates/{name.removeprefix('scenarios/')}" for name in tracked("scenarios")}
    pages = {f"navsim/report/pages/{name}.md" for name in ("limits", "validation")}  # `navsim evidence` reads them
    assert held == {*tracked("navsim"), *scenarios, *pages}
    assert wheel.stat().st_size < 2_000_000


def test_it_asks_for_no_more_than_it_did(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith("/METADATA"))
        asked = Parser().parsestr(archive.read(name).decode()).get_all("Requires-Dist") or []
    base = {each.split(">")[0].split("[")[0].strip() for each in asked if "extra ==" not in each}
    assert base == BASE


@pytest.mark.long
def test_it_works_by_itself(wheel: Path, tmp_path: Path) -> None:
    """Unpacked as pip does it, in an empty folder, with the packages of this environment and nothing of this tree."""
    site, work = tmp_path / "site", tmp_path / "work"
    work.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    environment = os.environ | {"PYTHONPATH": str(site), "PYTHONSAFEPATH": "1"}

    code = """
import navsim
from typer.testing import CliRunner
from navsim.cli.main import app
print(navsim.__file__)
for words in ("init -o my.yaml", "validate my.yaml", "run my.yaml --set duration_s=2 -q -o my.h5", "show my.h5",
              "schema any", "keys landing flare", "report my.h5 -o my.html"):
    done = CliRunner().invoke(app, words.split())
    assert done.exit_code == 0, (words, done.output, done.exception)
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=work, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(site / "navsim" / "__init__.py")
    assert (work / "my.html").stat().st_size > 100_000
