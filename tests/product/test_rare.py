"""`--method rare`: whole commands, their result, table and figure, and what they refuse."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from navsim.results.result import read
from tests.conftest import SCENARIOS
from tests.forks import navsim
from tests.layout import as_declared

FAST = ("--set", "filter.kind=eskf", "--set", "receiver.rate_hz=1", "--set", "imu.rate_hz=20")
BOX = ("--set", "box={lateral_m: 2.4, vertical_m: 3.6}")
NOT_PUSHED = 4
"""A run that is not."""
RARE = ("run", SCENARIOS / "landing.yaml", "--method", "rare", *FAST, *BOX)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("rare")


def test_result_table_and_figure(place: Path) -> None:
    done = navsim(*RARE, "--figures", "f", cwd=place)
    assert done.returncode == 0, done.stderr
    for word in ("any limit exceeded", "effective samples", "pushed runs", "results/landing_rare.h5"):
        assert word in done.stdout
    result = read(place / "results" / "landing_rare.h5")
    as_declared(result)
    value, low, high = result["/summary/rare/probability"]
    assert low < value < high
    assert 1.96 * float(result["/summary/rare/relative_error"]) <= 0.2
    error, (lower, upper) = result["/rare/error"], (result[f"/summary/box/{end}"] for end in ("lower", "upper"))
    outside = ((error < lower) | (error > upper)).any(axis=1)
    np.testing.assert_array_equal(lower, -upper)
    assert int(result["/summary/rare/outside"]) == outside.sum()
    assert value == pytest.approx(np.mean(outside * np.exp(result["/rare/log_weight"])))
    assert np.isnan(result["/summary/rare/axis_probability"][1]).all()
    with Image.open(place / "f" / "landing_rare_exceedance.png") as picture:
        assert np.asarray(picture.convert("L")).min() < 128
    shown = json.loads(navsim("show", "results/landing_rare.h5", "--json", cwd=place).stdout)
    assert shown["summary"]["rare"]["probability"][0] == pytest.approx(value)


def test_beside_other_results(place: Path) -> None:
    """The box of runs and of a covariance analysis; one table for them, one for pushed runs."""
    common = ("run", SCENARIOS / "landing.yaml", *FAST, *BOX, "-q")
    assert navsim(*common, "--runs", 8, "-o", "some.h5", cwd=place).returncode == 0
    assert navsim(*common, "--method", "covariance", "-o", "cov.h5", cwd=place).returncode == 0
    assert navsim(*common, "--method", "rare", "--runs", 64, "-o", "rare.h5", cwd=place).returncode == 0
    for file in ("some.h5", "cov.h5"):
        as_declared(read(place / file))
    said = navsim("show", "some.h5", "rare.h5", "cov.h5", cwd=place).stdout
    assert said.count("Outside the box") == 2
    assert said.count("probability [95 %], at touchdown") == 2
    assert "at most " in said
    first, rare = (read(place / file)["/summary/box/axis_first_order"] for file in ("cov.h5", "rare.h5"))
    np.testing.assert_allclose(first, rare, rtol=0.15)  # of errors between outputs the analysis blurs covariances
    assert read(place / "some.h5")["/summary/box/probability"][2] == pytest.approx(1.0 - 0.025**0.125)
    done = navsim("export", "rare.h5", "--csv", cwd=place, code=2)
    assert "but no flight" in done.stderr


def test_none_outside_is_said(place: Path) -> None:
    """Of these runs; and nothing is said of none where some are outside with weights beyond any number."""
    done = navsim(*RARE, "--runs", 1, "--first-run", NOT_PUSHED, "-o", "far.h5", cwd=place)
    assert "none of 1 run ended outside the box: its probability is below" in done.stderr
    far = ("--set", "box={lateral_m: 60, vertical_m: 90}")
    done = navsim(*RARE, *far, "--runs", 16, "-o", "far.h5", "--force", cwd=place)
    assert "none of" not in done.stderr
    assert read(place / "far.h5")["/summary/rare/outside"] > 0
    value, low, high = read(place / "far.h5")["/summary/rare/probability"]
    assert np.isnan(value)
    assert (low, high) == (0.0, 1e-300)
    assert "below 1e-300  (if tails are Gaussian)" in done.stdout
    assert "[0, 0]" not in done.stdout
    assert "RuntimeWarning" not in done.stderr
    done = navsim(*RARE, "--runs", 40, "-o", "few.h5", cwd=place)
    assert "effective samples of 40 runs" in done.stderr


def test_all_outside_is_said(place: Path) -> None:
    """With what so many runs exclude; a study goes on until that is as narrow as asked for."""
    box = ("--set", "box={lateral_m: 0.05, along_m: 0.05, vertical_m: 0.05}")
    done = navsim(*RARE, *box, "--runs", 32, "-o", "all.h5", "--force", cwd=place)
    assert "all of 32 runs ended outside the box: its probability is above 0.89" in done.stderr
    assert "all outside; above 0.89" in done.stdout
    result = read(place / "all.h5")
    assert np.isnan(result["/summary/rare/relative_error"])
    assert navsim(*RARE, *box, "--until", "probability within 5%", "-o", "all.h5", "-q", cwd=place).returncode == 0
    result = read(place / "all.h5")
    value, low, high = result["/summary/rare/probability"]
    assert low >= 0.95 * value
    assert high <= 1.05 * value
    assert result["/run"].size > 32


def test_figures_of_far_and_of_common_errors(place: Path) -> None:
    """An axis ends where the curves do, which says where the limit is; what is common has its curve too. A box that is
    wider to one side is shown by the distance from its middle."""
    from navsim.report.rare import curve, exceedance

    for name, given, lateral, vertical in (("wide.h5", "500", 500, 0.02), ("narrow.h5", "[-2, 2.8]", 2.4, 3.6)):
        box = ("--set", f"box={{lateral_m: {given}, vertical_m: {vertical}}}", "--runs", 64)
        done = navsim(*RARE, *box, "-o", name, "--figures", "none", cwd=place)
        assert done.returncode == 0, done.stderr
        assert ("(beyond 500 m" if given == "500" else "(outside -2 to 2.8 m") in done.stdout
        result = read(place / name)
        far, common = exceedance(result).axes
        assert far.get_ylabel() == ("P(|lateral error| > x)" if given == "500" else "P(|lateral error -0.4 m| > x)")
        shown = curve(result, 0)
        beyond = shown.chance[shown.size > lateral]  # of the wide box no run is
        assert beyond.size == 0 or beyond[-1] == pytest.approx(result["/summary/rare/axis_probability"][0, 0])
        for ax, limit in ((far, lateral), (common, vertical)):
            assert ax.get_xlabel()
            x, chance = map(np.asarray, ax.lines[0].get_data())
            left, end = ax.get_xlim()
            low, top = ax.get_ylim()
            assert ((x >= left) & (x <= end) & (chance >= low) & (chance <= top)).sum() > 5
            assert ax.texts[0].get_text() == f"limit {limit:g} m" + (" →" if limit > end else "")
    assert "→" not in common.texts[0].get_text()


def test_box_before_any_fix_is_warned_of(place: Path) -> None:
    for height, warned in ((153, True), (140, False)):
        done = navsim(*RARE, "--set", f"box.height_m={height}", "--dry-run", "-o", "start.h5", cwd=place)
        assert ("before the first fix: the errors there are those that the filter begins with" in done.stderr) == warned


def test_rejected_fixes_are_reported(place: Path) -> None:
    """They speak against fixes where runs without a push have too many of them too."""
    tight = ("--set", "filter.fix_sigma_scale=0.3", "--runs", 32, "-o", "tight.h5", "--require-fix")
    done = navsim(*RARE, *tight, cwd=place, code=3)
    assert "fixes were rejected by the innovation gate, in 32 of 32 runs" in done.stderr
    assert "error: --require-fix:" in done.stderr
    assert "pushes may" not in done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--set", "box=null"), "box: method rare needs a box; give `box: {lateral_m: ..., vertical_m: ...}`"),
        (
            ("--set", "box={}"),
            "error: --set box={}: box: limits nothing: give lateral_m, along_m, from_threshold_m or vertical_m",
        ),
        (("--set", "box.height_m=5000"), "the aircraft never comes down through 5000 m above the runway"),
        (
            ("--set", "filter.kind=rts"),
            "rts is a smoother; the covariance analysis and method rare need a filter: use method monte-carlo, or",
        ),
        (("--set", "box={lateral_m: .inf}"), "box.lateral_m: a finite number is needed, not .inf"),
        (("--set", "box={lateral_m: .nan}"), "box.lateral_m: a finite number is needed, not nan"),
        (("--keep", "all"), "--keep: only for method monte-carlo"),
        (("--require-consistent",), "--require-consistent: only for method monte-carlo; errors and innovations of"),
        (("--until", "rms_horizontal within 2%"), "with method rare expected `probability within 20%`"),
        (("--until", "probability within 0.05%"), "0.05 % is not within 0.1 to 50 percent"),
        (("--until", "probability within 1.2.3%"), "'1.2.3' is not a number"),
        (("--method", "monte-carlo", "--until", "probability within 9%"), "a probability goes with --method rare"),
    ],
)
def test_refused(words: tuple[str, ...], message: str, place: Path) -> None:
    done = navsim(*RARE, *words, cwd=place, code=2)
    assert message in done.stderr
