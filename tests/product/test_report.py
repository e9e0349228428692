"""What people see of results: tables and figures say what they show, of whom, and hide nothing."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import yaml
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from rich.console import Console, RenderableType
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from navsim.cli.main import app
from navsim.companions.atc import report as atc
from navsim.companions.atc import study as atc_study
from navsim.companions.azimuth import report as azimuth
from navsim.companions.elevation import mls
from navsim.companions.elevation import report as elevation
from navsim.companions.elevation import study as elevation_study
from navsim.landing import study as landing
from navsim.optimization import report as optimize_report
from navsim.page import touchdown
from navsim.report import budget_rows, figure_data, figures, limits, printing, summary_tables
from navsim.report.landing import VIEW
from navsim.report.ridges import ShownRidge, shown_ridges
from navsim.report.table import Table, console
from navsim.results.result import Result, read, write
from navsim.runner.executor import threads
from navsim.scenario.load import read_for, read_study, resolved_yaml
from navsim.sweeps import report as sweep_report
from navsim.sweeps import study as sweep_study
from navsim.sweeps.plan import plan
from navsim.sweeps.scenario import Sweep
from tests.conftest import SCENARIOS
from tests.helpers import case

RUNS = 6
SMOOTH = (
    "receiver.rate_hz=2", "imu.rate_hz=50", "receiver.latency_s=0.3", "receiver.lever_arm_m=[2, 0.5, -1]",
    "runway.heading_deg=30", "imu.gyro.drift_deg_h=70", "initial_errors.attitude_deg=1",
)  # fmt: skip
"""Fixes away from the IMU, and a runway along neither axis."""


ASKED = (
    "requirements=[{what: error, of: lateral, at: 100ft, below_m: 0.5, share: 0.9}, "
    "{what: error, of: vertical, at: 50ft, below_m: 1.5}, {what: error, of: vertical, below_m: 90}, "
    "{what: rms, of: horizontal, below_m: 0.4}, {what: level, of: vpl, below_m: 45}, "
    "{what: preset, operation: APV-I}, {what: box, at_most: 1.0e-3}]",
    "box={along_m: [-0.5, 0.4], lateral_m: [-0.3, 0.35], height_m: 20}",
    "integrity={method: chi2, limits: {hal_m: 50, tta_s: 2}}",
)
"""Requirements of every sort that a figure can draw."""


def flown(runs: int, keep: str, *more: str, first: int = 0) -> Result:
    c = case(*SMOOTH, *more)
    return landing.result(c, landing.fly_all(c, 1, first, runs, threads(1), keep=keep), 1, keep=keep)


@pytest.fixture(scope="module")
def one() -> Result:
    return flown(1, "all")


@pytest.fixture(scope="module")
def many() -> Result:
    """With requirements of every sort."""
    return flown(RUNS, "all", *ASKED)


@pytest.fixture(scope="module")
def linear() -> Result:
    """With the same requirements, and a box of one side."""
    c = case(*SMOOTH, *ASKED, "box={lateral_m: 0.2}", "method=covariance")
    return landing.covariance_result(c, landing.covariance_analysis(c), 1)


def printed(table: RenderableType) -> str:
    with open(os.devnull, "w") as nowhere:
        console = Console(width=200, record=True, file=nowhere)
        console.print(table)
        return console.export_text()


def text_of(*results: Result) -> str:
    return printed(console([summary_tables.summary_table([(f"r{i}", r) for i, r in enumerate(results)])]))


def rows(text: str, word: str) -> list[str]:
    return [line for line in text.splitlines() if word in line]


# --- the table


def test_one_run_has_signed_errors_and_no_statistics(one: Result) -> None:
    """A sample of one: its error with the sign and the filter's sigma; no interval, no percentile, a verdict on gross
    errors alone."""
    text = text_of(one)
    assert "run 0, seed 1" in text
    at = {name: one[f"/summary/at/{name}_run"][0] for name in ("lateral", "along", "vertical")}
    for i, height in enumerate(("touchdown", "50 ft", "100 ft", "200 ft")):
        for name, errors in at.items():
            (row,) = rows(text, f"{height}, {name}")
            assert f"{errors[i]:+.3f}" in row
            assert f"σ {one[f'/summary/at/{name}_sigma'][i]:.3f}" in row
    for word in ("[95 %]", "[0", "of runs below", "true)", "SKO", "epochs without"):
        assert word not in text.replace("fix epochs without a fix", ""), word
    assert str(one["/summary/consistency/verdict"]).startswith("no error beyond ")
    assert "σ in one run: " in str(one["/summary/consistency/verdict"])
    # the same as the stored history, along a runway at 30 degrees
    crossing = one["/truth/event_time"][list(one["/truth/event"]).index("touchdown")]
    north, east = (np.interp(crossing, one["/filter/time"], one["/filter/error"][0, :, i]) for i in (0, 1))
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    assert at["lateral"][0] == pytest.approx(c * east - s * north)


def test_several_runs_have_intervals_percentiles_and_verdicts(many: Result) -> None:
    text = text_of(many)
    assert "6 runs (0 to 5), seed 1" in text
    value, low, high = many["/summary/at/lateral"][0]
    half = many["/summary/at/lateral_percentile"][0, 0]
    first, second = rows(text, "touchdown, lateral")
    assert f"{value:.3f}  [{low:.3f}, {high:.3f}]  σ {many['/summary/at/lateral_sigma'][0]:.3f}" in first
    assert f"{half:.3f}  -  -" in second, "six runs have no 95th percentile"
    drawn = touchdown.percentiles([("many", many)])
    assert drawn is not None
    assert "errors that 50 % of runs stay below" in drawn.caption
    words = str(many["/summary/consistency/verdict"])
    assert words.startswith("sigma ")
    assert words in rows(text, "all states")[0]
    assert ("largest z" in text.replace(words, "")) != words.startswith("sigma right")  # more rows where groups differ


def test_attitude_is_roll_pitch_heading(many: Result) -> None:
    """The file keeps the rotation vector; the table's angles are those of the two attitudes, by scipy."""
    touchdown = many["/truth/event_time"][list(many["/truth/event"]).index("touchdown")]
    time = many["/filter/time"]
    late = (time >= touchdown - 20) & (time <= touchdown)
    true = np.stack(
        [np.interp(time[late], many["/truth/time"], many["/truth/attitude_rpy"][:, i]) for i in range(3)], 1
    )
    squares = []
    for run in many["/filter/error"]:
        estimate = Rotation.from_rotvec(-run[late, 6:9]) * Rotation.from_euler("ZYX", true[:, ::-1])
        error = true - estimate.as_euler("ZYX")[:, ::-1]
        squares.append(((error + np.pi) % (2 * np.pi) - np.pi) ** 2)
    expected = np.sqrt(np.mean(squares, axis=(0, 1)))
    np.testing.assert_allclose(many["/summary/rms/attitude_rpy"][:, 0], expected, rtol=1e-6)
    text = text_of(many)
    for name, value in zip(("roll", "pitch", "heading"), np.degrees(expected), strict=True):
        assert f"{value:.3f}" in rows(text, f"  {name}, deg")[0]


def test_the_sigma_beside_an_error_is_that_of_its_axes(one: Result, many: Result, linear: Result) -> None:
    """Two computations of the covariance: the filter's own in flight, and the one along the error-free flight."""
    for r in (one, many):
        for name in ("lateral_sigma", "along_sigma", "vertical_sigma"):
            np.testing.assert_allclose(r[f"/summary/at/{name}"], linear[f"/summary/at/{name}"], rtol=0.02)
        for name in ("position_ned", "velocity_ned", "attitude_rpy", "horizontal", "vertical"):
            np.testing.assert_allclose(r[f"/summary/sigma/{name}"], linear[f"/summary/sigma/{name}"], rtol=0.05)
    # the axes of the runway are not those of the map: north and east errors are correlated
    across = np.hypot(*(np.array([-0.5, np.sqrt(0.75)]) * linear["/summary/sigma/position_ned"][:2]))
    assert abs(linear["/summary/at/lateral_sigma"][0] / across - 1.0) > 0.005
    np.testing.assert_allclose(linear["/summary/at/lateral_sigma"], linear["/summary/at/lateral"][:, 0], rtol=1e-3)
    np.testing.assert_allclose(
        linear["/summary/sigma/attitude_rpy"], linear["/summary/rms/attitude_rpy"][:, 0], rtol=1e-3
    )
    text = text_of(linear)
    assert "linear covariance analysis" in text
    assert "[" not in rows(text, "touchdown, lateral")[0]


# --- figures of landings


def drawn(result: Result) -> Mapping[str, Figure]:
    """Its figures as they are drawn, once for all tests."""
    if id(result) not in _drawn:
        with mpl.rc_context(printing.STYLE):
            made = VIEW.figures(result)
            for figure in made.values():
                figure.draw_without_rendering()
        _drawn[id(result)] = result, made
    return _drawn[id(result)][1]


_drawn: dict[int, tuple[Result, Mapping[str, Figure]]] = {}
"""By the identity of results, which are kept so that it stays theirs."""


def words_of(figure: Figure) -> str:
    return "\n".join(t.get_text() for t in figure.findobj(Text))


def check_page(name: str, figure: Figure) -> None:
    """Nothing is cut, no letter is under 7 points, no legend of the figure lies on data."""
    page = figure.bbox
    assert figure.get_figwidth() <= 2 * printing.COLUMN
    renderer = FigureCanvasAgg(figure).get_renderer()
    for text in figure.findobj(Text):
        if text.get_text().strip():
            assert text.get_fontsize() >= 7.0, (name, text.get_text())
    written = [*figure.texts, *(text for legend in figure.legends for text in legend.get_texts())]
    for ax in figure.axes:
        written += [ax.title, ax.xaxis.label, ax.yaxis.label, *ax.texts]
    for text in written:
        if text.get_text().strip():
            box = text.get_window_extent(renderer)
            inside = (box.x0 >= -1, box.x1 <= page.x1 + 1, box.y0 >= -1, box.y1 <= page.y1 + 1)
            assert all(inside), (name, text.get_text(), inside)
    for legend in figure.legends:
        box = legend.get_window_extent(renderer)
        assert not any(box.overlaps(ax.get_window_extent(renderer)) for ax in figure.axes), name


def test_every_figure_fits_its_page(one: Result, many: Result, linear: Result) -> None:
    names = set()
    for result in (one, many, linear):
        for name, figure in drawn(result).items():
            names.add(name)
            check_page(name, figure)
    assert names == {
        "track", "sky", "dop", "nees", "consistency", "fixes", "errors", "budget", "box", "integrity", "stanford",
        "requirements",
    }  # fmt: skip


def test_the_legend_has_terrain_whichever_ridge_is_shown() -> None:
    """The first one is out of sight."""
    figure = printing.new_figure(3.5, 2.0)
    ax = figure.subplots()
    far, near = (ShownRidge(np.array([[at, -50.0, 9.0], [at, 50.0, 9.0]]), 9.0) for at in (900.0, 10.0))
    figures.ridge_lines(ax, [far, near, near], (-100.0, 100.0), (-100.0, 100.0))
    assert list(printing.named_handles([ax])) == ["terrain, height of its top"]


def test_fixes_lie_about_the_antenna() -> None:
    """Exact ranges: the fixes are the antenna's true position to centimetres, 2.3 m from the IMU."""
    exact = flown(1, "all", "signals.range_sigma_m=1e-4", "pseudolites.range_sigma_m=1e-4")
    error = figure_data.fix_errors(exact)
    assert error.shape == (1, exact["/receiver/time"].size, 3)
    assert np.abs(error).max() < 0.02
    drawn_points = figures.fixes(exact).axes[0].lines[0].get_xydata()
    assert np.abs(drawn_points).max() < 0.02


def test_states_are_shown_in_their_units() -> None:
    """Fix errors, of variance 1, in their σ before; they are told apart by their own ends."""
    names = [f"{triad}_{axis}" for triad in "abcdef" for axis in "xyz"]
    more = [f"fix_error_slow_{a}" for a in ("north", "east", "down")] + [f"fix_error_slow_more_{k}" for k in (1, 2, 3)]
    shown = figure_data.followed(names + more, ["1"] * 24)
    assert [(one.label, one.axis) for one in shown[17:20]] == [
        ("f, ppm", "z"),
        ("slow satellite errors, prior σ", "north"),
        ("slow satellite errors, prior σ", "east"),
    ]
    assert (shown[21].label, shown[21].axis, shown[21].scale) == ("further slow satellite errors, prior σ", "1", 1.0)


def test_figures_of_an_ensemble_show_the_ensemble(one: Result, many: Result) -> None:
    alone, ensemble = drawn(one), drawn(many)
    for name in ("errors", "fixes", "nees"):
        assert "run 0, seed 1" in words_of(alone[name]), name
        assert "6 runs (0 to 5), seed 1" in words_of(ensemble[name]), name
    for name in ("track", "sky", "dop"):
        assert "which all 6 runs share" in words_of(ensemble[name]), name
    panel = ensemble["errors"].axes[2]
    lines = [np.asarray(line.get_ydata()) for line in panel.lines[: RUNS + 2]]  # limits come later
    np.testing.assert_allclose(lines[6], 3 * np.sqrt(np.mean(many["/filter/error"][:, :, 2] ** 2, axis=0)))
    for run, line in zip(many["/filter/error"][:, :, 2], lines, strict=False):
        np.testing.assert_array_equal(line, run)
    points = ensemble["fixes"].axes[0].lines[0].get_xydata()
    assert len(points) == 6 * one["/receiver/time"].size
    np.testing.assert_allclose(ensemble["nees"].axes[0].lines[0].get_ydata(), many["/filter/nees"].mean(axis=0) / 15)


def test_sources_of_a_budget_can_be_told_apart(linear: Result) -> None:
    names = [str(name) for name in linear["/budget/source"]]
    alike = replace(linear.variables["/budget/rms"], data=np.ones_like(linear["/budget/rms"]))  # so all are shown
    legend = figures.budget(Result(linear.attributes, linear.variables | {"/budget/rms": alike})).legends[-1]
    texts, patches = legend.get_texts(), legend.get_patches()
    styles = {t.get_text(): (p.get_facecolor(), p.get_hatch()) for t, p in zip(texts, patches, strict=True)}
    assert list(styles) == [budget_rows.source_title(name) for name in names]
    assert len(set(styles.values())) == len(names) == 15


def required_lines(ax: Axes) -> list[np.ndarray]:
    """What is drawn in the colour of requirements, point by point."""
    return [np.asarray(line.get_xydata()) for line in ax.lines if line.get_color() == limits.REQUIRED]


def test_figures_draw_the_limits_where_they_hold(many: Result) -> None:
    """At 100 ft, 50 ft and touchdown of the paper's profile, whose times are closed forms; over the glide; the box."""
    result, drawings = many, drawn(many)
    # along the path of 153 m / sin 5 degrees from 130 to 80 km/h
    fast, slow, length = 130 / 3.6, 80 / 3.6, 153 / np.sin(np.radians(5))
    slower = (fast**2 - slow**2) / (2 * length)

    def when(height: float) -> float:
        gone = (153 - height) / np.sin(np.radians(5))
        return float((fast - np.sqrt(fast**2 - 2 * slower * gone)) / slower)

    horizontal, lateral, vertical = drawings["requirements"].axes
    (line,) = required_lines(horizontal)
    np.testing.assert_allclose(line, [[when(0) - 20, 0.4], [when(0), 0.4]], atol=1e-3)
    np.testing.assert_allclose(required_lines(lateral), [[[0.58, y], [1.42, y]] for y in (-0.5, 0.5)])
    assert {"90 %", "95 %"} <= set(words_of(drawings["requirements"]).splitlines())
    np.testing.assert_allclose([line[0, 1] for line in required_lines(vertical)], [-1.5, 1.5])
    assert "↑ ±90 m" in words_of(drawings["requirements"]).splitlines()  # wider than what is found by far
    points = next(line for line in lateral.lines if line.get_marker() == ".")  # touchdown comes first
    np.testing.assert_array_equal(points.get_ydata(), result["/summary/at/lateral_run"][:, 0])

    down = drawings["errors"].axes[2]
    (gate,) = down.containers
    (segment,) = gate.lines[2][0].get_segments()
    np.testing.assert_allclose(segment, [[when(50 * 0.3048), -1.5], [when(50 * 0.3048), 1.5]], atol=2e-2)
    assert "±90 m ↕" in words_of(drawings["errors"])
    assert "required of the vertical error" in words_of(drawings["errors"])

    upper, lower = drawings["integrity"].axes
    for ax, sizes in ((upper, [40]), (lower, [45, 50])):
        for line, size in zip(required_lines(ax), sizes, strict=True):
            np.testing.assert_allclose(line, [[0, size], [when(0), size]], atol=1e-3)
    assert "required at 99 %: 45 m" in words_of(drawings["integrity"])

    (view,) = drawings["box"].axes
    (edges,) = required_lines(view)
    np.testing.assert_allclose(edges, [[-0.5, -0.3], [0.4, -0.3], [0.4, 0.35], [-0.5, 0.35], [-0.5, -0.3]])
    error = result["/summary/box/error_run"]
    outside = ((error[:, :2] < [-0.3, -0.5]) | (error[:, :2] > [0.35, 0.4])).any(axis=1)
    assert 0 < outside.sum() < RUNS
    by_mark = {line.get_marker(): np.asarray(line.get_xydata()) for line in view.lines}
    np.testing.assert_array_equal(by_mark["."], error[~outside][:, [1, 0]])
    np.testing.assert_array_equal(by_mark["x"], error[outside][:, [1, 0]])
    assert f"{outside.sum()} outside\nrequired: at most 0.001 of landings outside" in words_of(drawings["box"])
    north, east = (np.interp(when(20), result["/filter/time"], result["/filter/error"][0, :, i]) for i in (0, 1))
    assert error[0, 0] == pytest.approx(np.cos(np.pi / 6) * east - np.sin(np.pi / 6) * north, abs=2e-2)


def test_limits_of_other_studies_fit_their_page(linear: Result, one: Result) -> None:
    """A covariance analysis has no runs, one run no statistics; a box of one side has no other."""
    alone = drawn(flown(1, "none", *ASKED, "box={lateral_m: 0.2}"))
    for name, figure in alone.items():
        check_page(name, figure)
    for drawings in (alone, drawn(linear)):
        assert len(drawings["requirements"].axes) == 3
        assert len(required_lines(drawings["box"].axes[0])) == 2
    assert "required: 0.4 m" in words_of(drawn(linear)["budget"])
    assert not {"requirements", "box"} & set(drawn(one))


# --- commands


def test_no_figures_means_none(one: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "one.h5", one)
    done = CliRunner().invoke(app, ["plot", "one.h5", "--figures", "none"])
    assert done.exit_code == 0
    assert done.stdout == ""
    assert [p.name for p in tmp_path.iterdir()] == ["one.h5"]
    (tmp_path / "taken").write_text("")
    refused = CliRunner().invoke(app, ["plot", "one.h5", "--figures", "taken"])
    assert refused.exit_code == 2
    assert "taken" in refused.stderr


def table(path: Path) -> tuple[list[str], np.ndarray]:
    with open(path, newline="") as file:
        head = next(csv.reader(file))
    return head, np.genfromtxt(path, delimiter=",", skip_header=1)


def test_an_ensemble_says_which_run_is_exported(many: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "many.h5", many)
    for given, number in (([], 0), (["--run", "4"], 4)):
        done = CliRunner().invoke(app, ["export", "many.h5", "--csv", "--rinex", "--nmea", *given])
        assert done.exit_code == 0, done.stderr
        assert f"run {number} of 6" in done.stderr
        head, values = table(tmp_path / "many_filter.csv")
        assert head[-1] == "run"
        assert set(values[:, -1]) == {number}
        np.testing.assert_allclose(values[:, 1:16], many["/filter/error"][number], rtol=1e-8, atol=1e-12)
        head, values = table(tmp_path / "many_gnss.csv")
        assert head[-1] == "run"
        np.testing.assert_allclose(values[:, 3], many["/receiver/position_llh"][number, :, 2], atol=1e-4)
        assert f"run {number} of an ensemble of 6" in (tmp_path / "many.obs").read_text()
    refused = CliRunner().invoke(app, ["export", "many.h5", "--csv", "--run", "6"])
    assert refused.exit_code == 2
    assert "runs 0 to 5" in refused.stderr


# --- the companions: what is drawn stands in the file


@pytest.mark.long
def test_atc_figures_follow_the_scenario() -> None:
    settings = ["further_cases=[]", "circuit.manoeuvre_s=[[100, 150]]", "circuit.duration_s=200",
                "circuit.straight_s=[[50, 90]]"]  # fmt: skip
    scenario = read_for("run", SCENARIOS / "atc_tracking.yaml", settings)[0]
    result = atc_study.compute(scenario, 1, 3)
    with mpl.rc_context(printing.STYLE):
        drawings = atc.figures(result)
    spans = [(p.get_x(), p.get_x() + p.get_width()) for p in drawings["errors"].axes[0].patches
             if isinstance(p, Rectangle)]  # fmt: skip
    assert spans == [(100.0, 150.0)]
    labels = [text.get_text().split(":")[0] for text in drawings["errors"].legends[0].get_texts()]
    assert labels == [str(name) for name in result["/filter"]]
    assert "T = 1 s, angles, 3 runs" in words_of(drawings["errors"])
    for name, figure in drawings.items():
        figure.draw_without_rendering()
        check_page(name, figure)
    ratios = result["/summary/decoupled_to_full"]
    ratios[0, 0, 0, [3, 5, 7, 9, 11], 0] = 1.5
    ratios[0, 0, 0, :2, 0] = 1.0
    assert "for the range, not for the pairs" in printed(console(atc.tables(result)))


def test_elevation_figures_follow_the_scenario() -> None:
    settings = ["montecarlo.band=0.3", "montecarlo.experiments=2", "montecarlo.confidence=0.9"]
    scenario = read_for("run", SCENARIOS / "mls_elevation.yaml", settings)[0]
    result = elevation_study.compute(scenario, 1, None)
    with mpl.rc_context(printing.STYLE):
        drawings = elevation.figures(result)
    assert "±30 %" in words_of(drawings["proof"])
    band = drawings["proof"].axes[0].collections[0].get_paths()[0].vertices
    sigma = np.sqrt(result["/filter/covariance"][-1, 0, 0])
    at_end = band[np.isclose(band[:, 0], band[:, 0].max()), 1]
    assert at_end.max() / sigma == pytest.approx(1.3)
    edges = [line.get_xdata()[0] for line in drawings["approach"].axes[0].lines[1:]]
    assert edges == pytest.approx([mls.LEVEL_END, mls.GLIDE_END, mls.GLIDE_END + mls.FLARE])
    for name, figure in drawings.items():
        figure.draw_without_rendering()
        check_page(name, figure)
    text = printed(console(elevation.tables(result)))
    assert "±30 %" in text
    assert "confidence of 0.9" in text
    assert "±20 %" not in text


def test_azimuth_names_its_filters_by_the_scenario() -> None:
    scenario = read_for("run", SCENARIOS / "azimuth_tracking.yaml", ["filters.singer_sigma_m_s2=[0.7, 4]"])[0]
    words = azimuth.filter_labels(Result({"scenario": resolved_yaml(scenario)}, {}))
    assert words["S1"] == "Singer, 0.7 m/s²"
    assert words["S2"] == "Singer, 4 m/s²"


# --- maps of sweeps

MAP = """kind: sweep
version: 1
base: {base}
set: {{pseudolites.frame: runway, pseudolites.count: 1, receiver.rate_hz: 1}}
vary:
  - {{key: pseudolites.s_m, grid: {{first: -100, last: 100, count: 21}}}}
  - {{key: pseudolites.l1_m, grid: {{first: -500, last: 500, count: 21}}}}
method: dop
outputs: [pdop]
"""


def test_varied_keys_are_words_with_units() -> None:
    """Each as it is called in titles and on axes; those of lists tell which."""
    said = {
        "pseudolites.count": "pseudolites", "pseudolites.s_m": "distance from the axis",
        "pseudolites.sites.1.s_m": "sites[1] distance right of the axis", "terrain.0.height_m": "terrain[0] height",
        "interference.jammers.0.place.lat_deg": "jammers[0] latitude", "imu.gyro.noise_deg_h": "gyro noise",
        "signals.range_sigma_m": "signals range sigma", "method": "method",
    }  # fmt: skip
    assert {key: sweep_report.key_label(key) for key in said} == said


@pytest.mark.parametrize("better", [True, False])
def test_what_is_the_same_everywhere_has_the_colour_of_the_best(better: bool) -> None:
    for value in (1.0, 0.0, -3.0):
        cube = np.full((3, 4), value)
        cube[0, 0] = np.nan
        low, high = sweep_report.colours(cube, better)
        assert (low < value == high) if better else (low == value < high)
        assert high - low >= 1.0


def with_terrain(result: Result) -> Result:
    """A sweep over two ridges by the threshold, of which it varies the second."""
    lat, lon = np.degrees(result["/plan/threshold_llh"][:2])
    ends = [{"lat_deg": float(lat) + 5e-4, "lon_deg": float(lon) + east} for east in (1e-4, 4e-4)]
    ridges = [{"ends": ends, "height_m": height} for height in (60, 80)]
    found = {part: yaml.safe_load(str(result.attributes[part])) for part in ("scenario", "study")}
    found["scenario"]["terrain"] = ridges
    found["study"]["vary"].append({"key": "terrain.1.height_m", "values": [80]})
    told = {part: yaml.safe_dump(data) for part, data in found.items()}
    return Result(result.attributes | told, result.variables)


def test_maps_below_each_other_fit_their_page(place: Path) -> None:
    """As they are printed, with their colour bar beside them."""
    with printing.printed(printing.Print()):
        for name, figure in [*sweep_report.figures(read(place / "sweep.h5")).items()][::3]:
            printing.fit(figure)
            figure.draw_without_rendering()
            check_page(name, figure)


def test_a_map_is_filled_and_says_that_its_best_lies_on_the_border(tmp_path: Path) -> None:
    """One pseudolite near the threshold: best as far out as the map goes, refused under the wheels."""
    file = tmp_path / "map.yaml"
    file.write_text(MAP.format(base=SCENARIOS / "landing_gnss_only.yaml"))
    section, document, base = read_study(file, Sweep, [])
    planned = plan(section, document, base, 1)
    result = sweep_study.sweep_result(planned, sweep_study.compute(planned, threads(1)))
    values = result["/sweep/pdop"]
    assert np.isnan(values).any()
    best = sweep_report.best(values, large=False)
    assert best is not None
    assert best[1] == 20
    with mpl.rc_context(printing.STYLE):
        figure = sweep_report.figures(result)["pdop"]
    figure.draw_without_rendering()
    check_page("map", figure)
    ax = figure.axes[0]
    assert "on the border of the map (distance before the threshold = 500 m): try a wider range" in ax.get_title()
    # the mesh reaches from edge to edge of the panel, half a cell beyond the first and the last combination
    assert ax.get_xlim() == pytest.approx((-525.0, 525.0), abs=0.5)
    assert ax.get_ylim() == pytest.approx((105.0, -105.0), abs=0.5)
    corners = ax.collections[0].get_coordinates()
    assert np.ptp(np.diff(corners[:, :, 0], axis=1)) < 1e-6
    assert sweep_report.best_plain(result)["pdop"]["at_end_of_range"] == ["l1_m"]
    flat = np.where(np.isnan(values), np.nan, 1.0)
    pdop = replace(result.variables["/sweep/pdop"], data=flat)
    alike = Result(result.attributes, result.variables | {"/sweep/pdop": pdop})
    (panel,) = sweep_report.panels(alike, "pdop", (0, 1))
    assert (panel.best, panel.title) == (None, "any place 1")
    hilly = with_terrain(result)
    assert [each.label for each in shown_ridges(hilly)] == ["60 m"]
    with printing.printed(printing.Print()):
        words = words_of(sweep_report.figures(hilly)["pdop"])
    assert "not drawn: terrain[1], which varies" in words
    assert "60 m" in words
    text = printed(console(sweep_report.tables(result)))
    assert "500 *" in text
    assert "the best may lie beyond" in text


def test_the_table_has_the_satellites_used_and_the_tightest_rule(place: Path) -> None:
    result = read(place / "runs.h5")
    sky = np.array([not str(name).startswith("PL") for name in result["/geometry/source"]])
    used = np.isfinite(result["/geometry/line_of_sight"][:, sky, 0])
    assert result["/summary/used/satellites"][1] >= used.sum(axis=1).min()
    assert result["/summary/used/satellites"][2] <= used.sum(axis=1).max()
    (row,) = (
        row for row in summary_tables.summary_table([("runs", result)]).rows if "satellites used" in str(row.cells[0])
    )
    mean, low, high = result["/summary/used/satellites"][:3]
    assert str(row.cells[1]) == f"{mean:.1f}  ({low:.0f} - {high:.0f})"
    best = read(place / "optimize.h5")
    front = optimize_report.tables(best)[0]
    assert isinstance(front, Table)
    for row, rule in zip(front.rows[1:], best["/optimum/tightest_rule"], strict=True):
        assert str(row.cells[7]).startswith(f"{rule}: ")
        assert str(row.cells[7]).endswith(" dB left" if rule == "near_far_db" else " m left")
