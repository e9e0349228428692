"""What figures and tables take from a result: heights over the threshold, outputs of sweeps."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from navsim.formats.sweep_rows import outputs
from navsim.geodesy.earth import ecef_from_llh, in_heading_axes
from navsim.optimization.report import flown_points
from navsim.report.figure_data import about_threshold
from navsim.report.figures import save_figures
from navsim.report.printing import Print
from navsim.results.result import Result, ResultError, Variable


def test_a_level_flight_is_drawn_level() -> None:
    """1000 m over the threshold, 20 km away: the plane has it lower by d^2 / 2R = 31.4 m."""
    threshold = np.array([np.radians(56.0), np.radians(37.0), 150.0])
    away = threshold + np.array([20_000.0 / 6.38e6, 0.0, 1000.0])
    (place,) = about_threshold(away[None], threshold, np.pi)
    assert place[2] == pytest.approx(1000.0, abs=1e-9)
    assert place[0] == pytest.approx(-20_000.0, rel=2e-3)
    plane = in_heading_axes(ecef_from_llh(away[None]), threshold, np.pi)[0]
    np.testing.assert_array_equal(place[:2], plane[:2])
    assert place[2] + plane[2] == pytest.approx(20_000.0**2 / 2.0 / 6.38e6, rel=2e-2)


def test_outputs_that_this_version_does_not_know_come_last() -> None:
    given = ("zeal", "requirement_10", "requirement_2_verdict", "requirement_2", "count_low", "pdop", "count", "art_95")
    result = Result({}, {f"/sweep/{name}": Variable(("x",), np.ones(2), "1", name) for name in given})
    known = ["pdop", "requirement_2", "requirement_2_verdict", "requirement_10"]
    assert outputs(result) == [*known, "art_95", "count", "count_low", "zeal"]


def test_a_figure_that_is_not_there(tmp_path: Path) -> None:
    """The message names one that is nearly so called, and those that are there."""
    for name, advice in (("eror", "did you mean errors? it has errors, track"), ("zz", "it has errors, track")):
        with pytest.raises(ResultError, match=re.escape(f"--only {name}: the result has no such figure; {advice}")):
            save_figures(lambda: {"errors": Figure(), "track": Figure()}, tmp_path, "a", Print("png"), [name])
    with pytest.raises(ResultError, match="it has none"):
        save_figures(dict, tmp_path, "a", Print("png"), ["errors"])


def test_the_front_shows_what_runs_found() -> None:
    """Points of those flown, with their intervals; none where runs do not measure the objective."""
    errors = np.array([[0.2, 0.15, 0.3], [np.nan] * 3, [0.1, 0.08, 0.12]])
    given = {"/pseudolites": np.array([1, 2, 3]), "/flown/objective": errors, "/flown/runs": np.array([200, 0, 200])}
    made = {path: Variable(("x",) if each.ndim == 1 else ("x", "y"), each, "1", path) for path, each in given.items()}
    counts, shown = flown_points(Result({"objective": "vertical_50ft"}, made))
    np.testing.assert_array_equal(counts, [1, 3])
    np.testing.assert_array_equal(shown, errors[[0, 2]])
    assert flown_points(Result({"objective": "fix_vertical"}, made))[0].size == 0
