"""Tables of precise orbits: positions and clocks where the epochs around tell them, and none elsewhere."""

from __future__ import annotations

import datetime
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from navsim.formats.sp3 import read_sp3
from navsim.gnss import timescales
from navsim.gnss.constellations import gps
from navsim.gnss.constellations.precise import OrbitTable, PreciseOrbits
from navsim.gnss.constellations.systems import GPS, SYSTEMS
from navsim.landing import study as landing
from navsim.scenario.load import read
from navsim.scenario_files.source import InputError
from tests.helpers import SCENARIOS

UTC = timescales.posix(2018, 9, 13, 12)
START = float(timescales.gps_from_utc(UTC))
NAMES = ("G01", "G02", "G03")
PRECISE = "data/esbc_2020177/GRG0MGXFIN_20201770000_01D_15M_ORB.SP3.gz"


def truth(time: np.ndarray) -> np.ndarray:
    """Places of the first satellites of the baseline constellation, which is no table."""
    return replace(gps.nominal(UTC), reach=np.inf).state(time)[0][:, : len(NAMES)]


def table(step: float = 900.0, epochs: int = 25) -> OrbitTable:
    time = START + step * (np.arange(epochs) - epochs // 2)
    none = np.zeros((epochs, len(NAMES)), dtype=bool)
    clock = 1e-6 * np.arange(3.0) + 1e-12 * (time[:, None] - START)
    return OrbitTable(NAMES, time, truth(time), clock, none, none)


def some(whole: OrbitTable, kept: np.ndarray) -> OrbitTable:
    """A table without some of its epochs."""
    names = ("time", "position", "offset", "manoeuvres", "clock_events")
    return replace(whole, **{name: getattr(whole, name)[kept] for name in names})


def between(orbits: PreciseOrbits | OrbitTable) -> np.ndarray:
    """Times within the table, five in each step."""
    return np.linspace(orbits.time[0], orbits.time[-1], 5 * (orbits.time.size - 1) + 1)


def error(found: OrbitTable, time: np.ndarray) -> np.ndarray:
    return np.linalg.norm(found.of(GPS).state(time)[0] - truth(time), axis=2)


@pytest.mark.parametrize("epochs", [10, 11, 25])
def test_positions_inside_of_a_whole_table(epochs: int) -> None:
    whole = table(epochs=epochs)
    assert error(whole, between(whole)).max() < 0.02
    assert np.isfinite(whole.of(GPS).clock(between(whole))[0]).all()
    assert whole.missing() == ()


@pytest.mark.parametrize("epochs", [1, 2, 4, 9])
def test_no_position_from_too_few_epochs(epochs: int) -> None:
    few = some(table(), np.arange(epochs))
    time = np.linspace(few.time[0], few.time[-1], 7)
    assert np.isnan(few.of(GPS).state(time)[0]).all()
    assert np.isnan(few.of(GPS).clock(time)[0]).all()
    (said,) = few.missing()
    assert f"{epochs} epoch" in said
    assert "interpolated from 10" in said


@pytest.mark.parametrize("lost", [range(11, 12), range(11, 19), range(3, 4), range(1, 2), range(14, 23)])
def test_no_position_beside_missing_epochs(lost: range) -> None:
    """Of all satellites, or of one: none where an epoch is missing of the ten around, right ones elsewhere."""
    whole = table(epochs=35)
    kept = np.array([k for k in range(35) if k not in lost])
    time = between(whole)
    gap = some(whole, kept)
    holed = replace(whole, position=whole.position.copy(), offset=whole.offset.copy())
    holed.position[lost, 1] = np.nan
    holed.offset[lost, 1] = np.nan
    for found, satellites in ((gap, [0, 1, 2]), (holed, [1])):
        wrong = error(found, time)
        assert np.nanmax(wrong) < 0.02
        none = np.isnan(wrong[:, satellites])
        near = (time > whole.time[max(lost.start - 5, 0)]) & (time < whole.time[lost.stop])
        assert none[near & (time > whole.time[lost.start - 1])].all()
        assert np.isfinite(wrong[(time <= whole.time[max(lost.start - 5, 0)]) & (lost.start > 9)]).all()
        assert np.isfinite(wrong[time > whole.time[lost.stop + 9 if lost.start < 5 else lost.stop + 4]]).all()
        clocks = np.isnan(found.of(GPS).clock(time)[0][:, satellites])
        assert clocks[(time > whole.time[lost.start - 1]) & (time < whole.time[lost.stop])].all()
        said = found.missing()
        assert len(said) == 2
        assert ("of G01, G02, G03 from" in said[0]) == (len(satellites) == 3)
        assert ("of G02 from" in said[0]) == (len(satellites) == 1)
        moments = [datetime.datetime.fromisoformat(word) for word in _moments(said[1])]
        due = [whole.time[lost.start - 1], whole.time[lost.stop]]
        assert [m.replace(tzinfo=datetime.UTC).timestamp() - timescales.GPS_EPOCH for m in moments] == due
        assert found.missing(whole.time[lost.stop + 10], whole.time[-1]) == ()


def _moments(text: str) -> list[str]:
    words = text.replace(",", "").split()
    return [f"{day}T{time}" for day, time in itertools.pairwise(words) if day[:3] == "201"]


@pytest.mark.parametrize(
    ("step", "largest"), [(300.0, 1e-3), (900.0, 0.02), (1800.0, 0.2), (3600.0, 0.2), (7200.0, 0.2)]
)
def test_tables_with_long_steps_give_no_bad_positions(step: float, largest: float) -> None:
    coarse = table(step)
    wrong = error(coarse, between(coarse))
    assert not np.any(wrong > largest)
    assert np.isfinite(wrong).all() == (step < 1000.0)
    assert bool(coarse.missing()) == (step > 1000.0)
    assert (f"epochs {step:g} s apart, or the rows" in " ".join(coarse.missing())) == (step > 3000.0)


def test_a_blunder_is_no_place_to_interpolate_from() -> None:
    whole = table(epochs=35)
    wrong = replace(whole, position=whole.position.copy())
    wrong.position[17, 0, 2] += 1000.0
    found = error(wrong, between(whole))
    assert np.nanmax(found) < 0.1
    assert np.isfinite(found[:, 1:]).all()


def sp3(orbits: OrbitTable, marks: dict[tuple[int, str], str], codes: str = "  5  5  5") -> str:
    """Text of version d; marks: from column 75 on, by epoch and satellite."""
    head = [
        f"#dP2018  9 13 12  0  0.00000000{orbits.time.size:8d} TRACK IGb14 FIT TEST",
        "+    3   " + "".join(orbits.names) + "  0" * 14,
        "++       " + codes + "  0" * 14,
        "%c M  cc GPS ccc cccc",
    ]
    lines = []
    for k, time in enumerate(orbits.time):
        moment = datetime.datetime.fromtimestamp(time + timescales.GPS_EPOCH, datetime.UTC)
        lines.append(f"*  {moment:%Y %m %d %H %M} {moment.second:11.8f}")
        for i, name in enumerate(orbits.names):
            numbers = [*(1e-3 * orbits.position[k, i]), 1e6 * orbits.offset[k, i]]
            row = f"P{name}" + "".join(f"{x:14.6f}" for x in numbers)
            lines.append(f"{row:74s}{marks.get((k, name), '')}".rstrip())
    return "\n".join([*head, *lines, "EOF"]) + "\n"


def test_marks_of_manoeuvres_and_jumps_of_clocks(tmp_path: Path) -> None:
    """Nothing is interpolated across them; predictions and poor orbits are told."""
    whole = table(epochs=25)
    path = tmp_path / "sp3"
    marks = {(12, "G01"): "    M", (12, "G02"): "E", (3, "G03"): " P   P"}
    path.write_text(sp3(whole, marks, "  5 14  0"))
    found = read_sp3(path)
    assert found.left_out == (
        "1 satellites with inaccurate orbits, as the header says: G02 (2^14 mm)",
        "1 predicted positions",
    )
    time = between(whole)
    wrong, clock = error(found, time), found.of(GPS).clock(time)[0]
    assert np.nanmax(wrong) < 0.03
    beside = (time > whole.time[7]) & (time <= whole.time[16])
    assert np.isnan(wrong[beside, 0]).all()
    assert np.isfinite(wrong[~beside, 0]).all()
    assert np.isfinite(wrong[:, 1:]).all()
    across = (time >= whole.time[11]) & (time < whole.time[12])
    np.testing.assert_array_equal(np.isnan(clock[:, 1]), across)
    assert any("no position of G01" in said for said in found.missing())
    assert any("no clock of G02" in said for said in found.missing())


def test_a_landing_hears_of_what_its_table_lacks(tmp_path: Path) -> None:
    def prepare(orbits: OrbitTable) -> landing.Case:
        (tmp_path / "sp3").write_text(sp3(orbits, {}))
        keys = ("sky.source=orbits", f"sky.orbits={tmp_path / 'sp3'}", "duration_s=3", "epoch=2018-09-13T12:00:00Z")
        return landing.prepare(*read(SCENARIOS / "landing.yaml", keys))

    whole = table(epochs=25)
    assert not [w for w in prepare(whole).warnings if "no position" in w]
    holed = replace(whole, position=whole.position.copy())
    holed.position[14, 1] = 0.0
    (said,) = (w for w in prepare(holed).warnings if "no position" in w)
    assert "no position of G02 from 2018-09-13 11:15:18" in said
    holed.position[14, 1], holed.position[1, 1] = holed.position[13, 1], np.nan
    with pytest.raises(InputError, match="no positions: 9 epochs are too few"):
        prepare(some(whole, np.arange(8, 17)))
    with pytest.raises(InputError, match=r"has no gps satellite for the time .*no position of G01, G02, G03 from"):
        prepare(some(whole, np.arange(25) != 14))


def test_held_out_epochs_of_a_real_table(shared: Path) -> None:
    """Of every other epoch, and beside a gap of eight: what is given is right, measured at the epochs left out."""
    whole = read_sp3(shared / PRECISE)
    every_other, gap = np.arange(0, 96, 2), np.array([k for k in range(96) if not 40 <= k < 48])
    for kept, least, largest in ((every_other, 0.8, 0.25), (gap, 0.0, 0.0)):
        out = np.setdiff1d(np.arange(kept[0], kept[-1]), kept)
        for system in SYSTEMS:
            orbits, thin = whole.of(system), some(whole, kept).of(system)
            wrong = np.linalg.norm(thin.state(whole.time[out])[0] - orbits.position[out], axis=2)
            assert np.isfinite(wrong).sum() >= least * wrong.size
            assert not np.any(wrong > largest)


def test_cases_of_too_few_epochs(shared: Path) -> None:
    for epochs in (1, 2, 4, 9):
        found = read_sp3(shared / "cases" / "sp3-few" / f"few{epochs}.sp3")
        time = np.linspace(found.time[0] - 900.0, found.time[-1] + 900.0, 20)
        for system in SYSTEMS:
            assert np.isnan(found.of(system).state(time)[0]).all()
            assert np.isnan(found.of(system).clock(time)[0]).all()
