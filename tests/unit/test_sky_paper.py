"""The sky of the report and the planner: names that can be read, and a horizon that hides what the receiver did not
see."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
from matplotlib.path import Path as Outline

from navsim.landing import study as landing
from navsim.landing.study import prepare
from navsim.page.sky import beside, sky_paper, skyline
from navsim.runner.executor import threads
from navsim.scenario.load import read
from tests.helpers import SCENARIOS

WIDE, REACH = 290.0, 1.14
"""Pixels of a narrow paper, and how far it goes beyond its edge."""


def test_names_cover_neither_each_other_nor_bearings() -> None:
    """Two pseudolites side by side in the east, a satellite on the horizon's north, pairs close to each other."""
    azimuth = np.radians([94.0, 97.0, 0.5, 45.0, 47.0, 200.0, 202.0, 270.0])
    away = np.array([88.0, 89.0, 88.0, 70.0, 71.0, 30.0, 32.0, 89.0])
    x, y = away * np.sin(azimuth), away * np.cos(azimuth)
    names = ["PL1", "PL2", "G01", "E02", "E03", "C10", "C11", "R17"]
    put = beside(x.tolist(), y.tolist(), names, 90.0)
    scale = 0.5 * WIDE / (REACH * 90.0)
    boxes = []
    for i, name in enumerate(names):
        wide = 6.0 * len(name)
        left = scale * x[i] + put["right"][i] - wide * ("left", "center", "right").index(put["align"][i]) / 2.0
        down = -scale * y[i] + put["down"][i]
        boxes.append((left, left + wide, down - 4.5, down + 4.5))
    for said, bearing in (("N", 0.0), ("E", 90.0), ("W", 270.0)):
        at = scale * 1.07 * 90.0 * np.array([np.sin(np.radians(bearing)), -np.cos(np.radians(bearing))])
        boxes.append((at[0] - 3.0, at[0] + 3.0, at[1] - 4.5, at[1] + 4.5))
        names.append(said)
    for (one, a), (other, b) in itertools.combinations(zip(names, boxes, strict=True), 2):
        assert a[0] >= b[1] or b[0] >= a[1] or a[2] >= b[3] or b[2] >= a[3], (one, other)


def test_what_the_horizon_hides_is_shaded(tmp_path: Path) -> None:
    """The result keeps the horizon; of directions above the mask the shade has those that it hides, and no others."""
    file = tmp_path / "hills.csv"
    file.write_text("azimuth_deg,elevation_deg\n0,2\n90,25\n100,40\n140,40\n150,8\n")
    case = prepare(*read(SCENARIOS / "landing.yaml", ("duration_s=2", "receiver.rate_hz=1", f"sky.horizon={file}")))
    result = landing.result(case, landing.fly_all(case, 1, 0, 1, threads(1), keep="none"), 1, keep="none")
    on = sky_paper("", 90.0, [])
    skyline(on, result["/geometry/bearing"], result["/geometry/horizon"], 5.0)
    columns = on.renderers[-1].data_source.data
    shade = Outline(np.column_stack((columns["x"], columns["y"])))
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(0.0, 360.0, 2000), rng.uniform(5.0, 89.0, 2000)
    away = 90.0 - elevation
    points = np.column_stack((away * np.sin(np.radians(azimuth)), away * np.cos(np.radians(azimuth))))
    over = elevation - np.interp(azimuth, [0, 90, 100, 140, 150, 360], [2, 25, 40, 40, 8, 2])
    sure = np.abs(over) > 0.2  # chords of a degree
    np.testing.assert_array_equal(shade.contains_points(points)[sure], over[sure] < 0.0)
