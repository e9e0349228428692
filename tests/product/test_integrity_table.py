"""`navsim integrity-table`: flags by rank, levels against landings that hear the same sources, what is refused."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from navsim.integrity.monitoring import Snapshot
from navsim.landing.integrity import glide_of
from navsim.published_tables import integrity_table
from navsim.results.findings import of
from navsim.results.result import read
from tests.conftest import SCENARIOS
from tests.forks import navsim
from tests.helpers import case, in_brief
from tests.layout import as_declared

CHI2 = "integrity={method: chi2, limits: {hal_m: 60, val_m: 70, tta_s: 2}}"
MHSS = "integrity={p_constellation: 1.0e-8, limits: {hal_m: 100, val_m: 150, tta_s: 2}}"
SPARSE = "receiver.rate_hz=0.5"
SPEC = """
0 | -   | -   | F     | F D G   | F D X G | F D X G
1 | -   | F   | F D G | F D X G | F D X G | F D X G
2 | F   | F D | F D X G | F D X G | F D X G | F D X G
"""
"""Section 12 of the specification: G wherever D stands, but for 3 + 2."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The command as most will give it: the shipped landing, limits."""
    place = tmp_path_factory.mktemp("table")
    return place, navsim("integrity-table", "--set", CHI2, cwd=place).stdout


def test_flags_are_those_of_the_specification(made: tuple[Path, str]) -> None:
    place, printed = made
    wanted = [[cell.strip() for cell in line.split("|")] for line in SPEC.strip().splitlines()]
    first = printed.split("Useful")[0].splitlines()
    rows = [re.split(r"  +", line.strip()) for line in first if re.match(r" *\d  ", line)]
    assert rows == wanted
    result = read(place / "results" / "integrity_table.h5")
    letters = {"F": "fix", "D": "detection", "X": "exclusion", "G": "ground_loss"}
    for (k, row), (i, letter) in itertools.product(enumerate(wanted), itertools.product(range(6), letters)):
        assert result[f"/possible/{letters[letter]}"][k, i] == (letter in row[1 + i])


def test_printed_is_what_the_result_holds(made: tuple[Path, str]) -> None:
    place, printed = made
    result = read(place / "results" / "integrity_table.h5")
    as_declared(result)
    assert of(result) == []
    assert list(result["/subsets/number"]) == [28, 56, 60, 56, 28, 8]
    assert list(result["/subsets/number_of_all"]) == [math.comb(8, n) for n in integrity_table.SATELLITES]
    assert "60 of 70" in printed
    assert "HPL <= 60 m and VPL <= 70 m" in printed
    assert "60 of the 601 fix epochs" in printed
    worst, median = (result[f"/subsets/{name}"][2, 5] for name in ("worst", "median"))
    assert f"{worst:.2f} / {median:.2f}" in printed
    assert f"{result['/subsets/hpl'][2, 1]:.0f} / {result['/subsets/vpl'][2, 1]:.0f}" in printed
    time = result["/glide/time"]
    assert (time.size, time[-1]) == (60, 60.1)
    assert np.ptp(np.diff(time)) < 0.11  # of epochs 0.1 s apart
    (detected,) = np.where(result["/possible/detection"].ravel() == 0)
    assert np.isinf(result["/subsets/hpl"].ravel()[detected]).all()
    assert (result["/subsets/median"].ravel()[detected] == 0.0).all()
    shown = navsim("show", "results/integrity_table.h5", cwd=place).stdout
    assert shown.splitlines() == printed.splitlines()[:-1]


def test_the_same_as_plain_data(made: tuple[Path, str]) -> None:
    place, _ = made
    result = read(place / "results" / "integrity_table.h5")
    data = json.loads(navsim("integrity-table", "--set", CHI2, "--json", "-o", "j.h5", cwd=place).stdout)
    assert (data["kind"], data["method"], data["satellites"]) == ("integrity-table", "chi2", [2, 3, 4, 5, 6, 7])
    assert data["possible"]["fix"] == result["/possible/fix"].tolist()
    assert data["subsets"]["worst"] == result["/subsets/worst"].tolist()
    assert data["subsets"]["hpl"][0][:4] == [None, None, None, pytest.approx(result["/subsets/hpl"][0, 3])]


def heard(*names: str, more: tuple[str, ...]) -> Snapshot:
    """What watches a landing in which nothing else is received, on the glide."""
    every = case(SPARSE, *more).shared.signals.names
    silent = [name for name in every if name not in names]
    quiet = case(SPARSE, *more, f"events=[{{what: silence, sources: [{', '.join(silent)}]}}]")
    watching = quiet.flight.watching
    assert watching is not None
    return watching.over(quiet.shared.signals.at(np.flatnonzero(glide_of(quiet))))


@pytest.mark.parametrize("method", [CHI2, MHSS], ids=["chi2", "mhss"])
@pytest.mark.parametrize("added", in_brief([0, 1, 2], 1))
def test_levels_are_those_of_a_landing_that_hears_no_more(method: str, added: int) -> None:
    """Of one subset, and the cells of seven satellites by all eight subsets."""
    here = integrity_table.watched(case(SPARSE, method))
    names = here.signals.names
    ground = here.pseudolites[:added]
    some = np.concatenate([here.satellites[[0, 2, 3, 5, 6]], ground])
    theirs = heard(*(names[i] for i in some), more=(method,)).levels
    np.testing.assert_allclose(here.monitor(some).levels, theirs, rtol=1e-12)
    assert np.isfinite(theirs).all()
    share = np.mean((theirs <= here.requirements.limits).all(axis=1))
    np.testing.assert_allclose(here.judged(some), [share, *np.median(theirs, axis=0)], rtol=1e-12)


def test_a_cell_is_the_worst_and_the_median_of_its_subsets() -> None:
    here = integrity_table.watched(case(SPARSE, CHI2))
    found, taken = integrity_table.cells(here, 1, lambda _: None)
    assert taken[5] == 8
    ours = np.array([here.judged(np.r_[np.delete(here.satellites, i), here.pseudolites[:1]]) for i in range(8)])
    worst, median, *levels = found[1, 5]
    assert worst == ours[:, 0].min()
    assert (ours[:, 0] >= median).sum() > 4
    assert (ours[:, 0] > median).sum() <= 4
    for k, level in enumerate(levels):
        assert (ours[:, 1 + k] <= level).sum() == 5
    assert 0.0 < ours[:, 0].mean() < 1.0


def test_subsets_are_all_or_drawn_by_the_seed() -> None:
    numbers = np.array([3, 5, 8, 9, 11, 20, 21, 22])
    every = integrity_table.subsets(numbers, 2, 1)
    assert {tuple(row) for row in every} == set(itertools.combinations(numbers, 2))
    drawn = [integrity_table.subsets(numbers, 4, seed) for seed in (1, 1, 2)]
    for rows in drawn:
        assert len({tuple(row) for row in rows}) == len(rows) == integrity_table.MOST_SUBSETS
        assert {tuple(row) for row in rows} < set(itertools.combinations(numbers, 4))
    assert np.array_equal(drawn[0], drawn[1])
    assert not np.array_equal(drawn[0], drawn[2])
    assert integrity_table.subsets(numbers[:3], 4, 1).shape == (0, 4)


def test_separation_tells_its_priors(tmp_path: Path) -> None:
    done = navsim("integrity-table", "--set", MHSS, "--set", SPARSE, "-o", "m.h5", cwd=tmp_path)
    result = read(tmp_path / "m.h5")
    as_declared(result)
    assert dict(zip(result["/subsets/fault"], result["/subsets/prior"], strict=True))["glonass"] == 1e-8
    assert "1e-08 of glonass" in done.stdout
    assert "(mhss)" in done.stdout
    assert result["/subsets/median"][2, 5] > 0.0


def test_what_a_scenario_lacks_is_left_out(tmp_path: Path) -> None:
    """Without pseudolites two rows have no levels; with two systems ranks are of fewer unknowns than levels."""
    file = SCENARIOS / "landing_gnss_only.yaml"
    done = navsim("integrity-table", file, "--set", CHI2, "--set", "sky.source=nominal", "--set", SPARSE, cwd=tmp_path)
    assert "warning: the sources keep 2 clocks" in done.stderr
    result = read(tmp_path / "results" / "integrity_table.h5")
    as_declared(result)
    assert [f.name for f in of(result)] == ["input"]
    assert np.isnan(result["/subsets/worst"][1:]).all()
    assert np.isfinite(result["/subsets/worst"][0]).all()
    assert result["/subsets/pseudolite"].size == 0
    useful = done.stdout.split("Useful")[1]
    assert re.search(r"\n1 +- +- +- +- +- +- *\n", useful)
    assert "in this order, none" in useful


@pytest.mark.parametrize("more", [(), ("--set", "integrity={method: chi2}")])
def test_without_limits_it_says_what_to_give(more: tuple[str, ...], tmp_path: Path) -> None:
    said = navsim("integrity-table", *more, cwd=tmp_path, code=2).stderr
    assert "landing.yaml" in said or more
    (given,) = re.findall("--set '(.*)'", said)
    assert "limits" in given
    done = navsim("integrity-table", *more, "--set", given, "--dry-run", cwd=tmp_path)
    assert "18 cells, 8 satellites used throughout the glide, 2 pseudolite(s), 60 of 601 epochs" in done.stderr
    assert not list(tmp_path.rglob("*.h5"))


def test_what_it_cannot_do(tmp_path: Path) -> None:
    smooth = SCENARIOS / "landing_smooth.yaml"
    done = navsim("integrity-table", smooth, "--set", CHI2, "--set", "duration_s=2", cwd=tmp_path, code=3)
    assert "there is no fix epoch on the glide within duration_s" in done.stderr
    navsim("integrity-table", "--set", CHI2, "--set", SPARSE, "-q", cwd=tmp_path)
    assert "has no figures" in navsim("plot", "results/integrity_table.h5", cwd=tmp_path, code=2).stderr
