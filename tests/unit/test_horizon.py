"""Tables of a horizon: what is read, what is refused, what a landing makes of one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.formats.horizon import read_horizon
from navsim.formats.text import FileError
from navsim.landing.study import prepare
from navsim.scenario.load import read
from navsim.scenario_files.source import InputError
from tests.helpers import SCENARIOS

HEAD = "azimuth_deg,elevation_deg\n"


def written(folder: Path, text: str) -> Path:
    path = folder / "horizon.csv"
    path.write_text(text)
    return path


def test_straight_lines_and_through_north(tmp_path: Path) -> None:
    found = read_horizon(written(tmp_path, f"# seen from the threshold\n{HEAD}\n90, 10\n# a hill\n180,20\n350,4\n"))
    at = np.degrees(found.at(np.radians([90.0, 135.0, 180.0, 350.0, 40.0, 400.0, -10.0])))
    np.testing.assert_allclose(at, [10.0, 15.0, 20.0, 4.0, 7.0, 7.0, 4.0], atol=1e-9)
    one = read_horizon(written(tmp_path, f"{HEAD}77,12.5\n"))
    np.testing.assert_allclose(np.degrees(one.at(np.array([0.0, 3.0]))), 12.5)
    closed = read_horizon(written(tmp_path, f"{HEAD}0,5\n180,7\n360,5\n"))
    np.testing.assert_allclose(np.degrees(closed.at(np.radians([0.0, 90.0, 270.0, 359.999]))), [5.0, 6.0, 6.0, 5.0],
                               atol=1e-4)  # fmt: skip


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("# nothing\n", 0, "the file has no table"),
        (
            "az,el\n0,5\n",
            1,
            "the header lacks azimuth_deg, elevation_deg; the header has az, el",
        ),
        (HEAD, 1, "the table has no rows"),
        (
            f"{HEAD}0,5,7\n",
            2,
            "the row has 3 cells, the header 2; if the decimals have commas, separate the cells by semicolons",
        ),
        (f"{HEAD}0,5\n\n361,5\n", 4, "azimuth_deg is 361; allowed: 0 to 360"),
        (f"{HEAD}0,95\n", 2, "elevation_deg is 95; allowed: -90 to 90"),
        (f"{HEAD}0,high\n", 2, "expected a number for elevation_deg, found 'high'"),
        (f"{HEAD}10,5\n10,6\n", 3, "the azimuth does not increase; sort the rows by azimuth"),
        (f"{HEAD}0,5\n360,6\n", 3, "at 0 and 360 degrees elevations differ; write one of both rows"),
    ],
)
def test_what_is_refused(text: str, line: int, said: str, tmp_path: Path) -> None:
    with pytest.raises(FileError) as caught:
        read_horizon(written(tmp_path, text))
    assert (caught.value.line, caught.value.message) == (line, said)


def test_a_landing_sees_nothing_below_its_horizon(tmp_path: Path) -> None:
    """A level horizon is a mask; its checksum goes into the scenario, and another file is refused."""
    path = written(tmp_path, f"{HEAD}0,25\n")
    short = ("duration_s=2", "receiver.rate_hz=1")
    case = prepare(*read(SCENARIOS / "landing.yaml", (*short, f"sky.horizon={path}")))
    masked = prepare(*read(SCENARIOS / "landing.yaml", (*short, "sky.mask_deg=25")))
    open_sky = prepare(*read(SCENARIOS / "landing.yaml", short))
    np.testing.assert_array_equal(case.shared.signals.used, masked.shared.signals.used)
    assert case.shared.signals.used.sum() < open_sky.shared.signals.used.sum()
    assert case.scenario.sky.horizon_sha256 is not None
    for setting, said in (
        (f"sky.horizon_sha256={64 * 'a'}", "not this one"), (f"sky.horizon={tmp_path / 'none.csv'}", "cannot be read"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said):
            prepare(*read(SCENARIOS / "landing.yaml", (*short, f"sky.horizon={path}", setting)))
    with pytest.raises(InputError, match="there is no horizon: give it, or leave the checksum out"):
        read(SCENARIOS / "landing.yaml", (f"sky.horizon_sha256={64 * 'a'}",))
    path.write_text(f"{HEAD}0,5\n0,6\n")
    with pytest.raises(InputError) as caught:
        prepare(*read(SCENARIOS / "landing.yaml", (*short, f"sky.horizon={path}")))
    assert "horizon.csv:3" in str(caught.value)
