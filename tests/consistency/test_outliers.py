"""Wrong pseudoranges in single-point positioning: found, excluded and reported, or no fix is given."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from navsim.formats import rinex_write
from navsim.formats.rinex_nav import Navigation, read_nav
from navsim.formats.rinex_obs import Observations, read_obs
from navsim.formats.text import Dropped, FileError
from navsim.geodesy.earth import ecef_from_llh, llh_from_ecef, ned_matrix
from navsim.gnss import timescales
from navsim.gnss.constellations import gps
from navsim.gnss.constellations.systems import GALILEO, GPS, SYSTEMS
from navsim.replays.recorded_ranges import read_messages, read_ranges
from navsim.replays.single_point import PositioningOptions, Solution, solve

UTC = timescales.posix(2018, 9, 13, 12)
START = float(timescales.gps_from_utc(UTC))
HERE = np.array([np.radians(56.0), np.radians(37.0), 150.0])
OPTIONS = PositioningOptions(troposphere=False, klobuchar=(np.zeros(4), np.zeros(4)))
"""Klobuchar's least delay, 1.5 m overhead, is too much here, and within the noise."""
CLOCK = 1234.5
EPOCHS = 40
SPEED_OF_LIGHT = 299792458.0


def made(systems: str = "GE", noise: float = 1.0) -> tuple[Navigation, Observations]:
    """A receiver that stands still under the nominal GPS, which also flies as Galileo, turned; white noise."""
    time = START + np.arange(float(EPOCHS))
    sky = gps.nominal(UTC)
    place = ecef_from_llh(HERE)
    names: list[str] = []
    tables = []
    elements = {}
    for letter, system, turn in (("G", GPS, 0.0), ("E", GALILEO, 1.0)):
        if letter not in systems:
            continue
        # messages of Galileo are of the past
        toe = sky.records.toe - 600.0
        records = replace(sky.records, omega0=sky.records.omega0 + turn, toe=toe, toc=toe)
        elements[system, system.message] = records
        flown = gps.KeplerianEphemerides.sent(records, system)
        travel = np.full((time.size, len(flown.names)), 0.075)
        for _ in range(4):
            position, _ = flown.state(time[:, None] - travel)
            angle = 7.2921151467e-5 * travel
            c, s = np.cos(angle), np.sin(angle)
            x, y, z = np.moveaxis(position, 2, 0)
            position = np.stack([c * x + s * y, c * y - s * x, z], axis=2)
            distance = np.linalg.norm(position - place, axis=2)
            travel = distance / SPEED_OF_LIGHT
        offset, _ = flown.clock(time[:, None] - travel)
        up = (position - place) @ (place / np.linalg.norm(place)) / distance
        seen = np.all(up > np.sin(np.radians(11.0)), axis=0)
        ranges = distance - SPEED_OF_LIGHT * offset
        names += [name for name, there in zip(flown.names, seen, strict=True) if there]
        tables.append(ranges[:, seen])
    code = np.concatenate(tables, axis=1)
    code += CLOCK + np.random.default_rng(1).normal(0.0, noise, code.shape)
    empty = np.zeros(3)
    observations = Observations(
        time + CLOCK / SPEED_OF_LIGHT, tuple(names), {"C1C": code}, {}, None, empty, {}, 0
    )  # fmt: skip
    return Navigation(elements, None, None, None), observations


def solved(navigation: Navigation, observations: Observations) -> Solution:
    return solve(observations, navigation.constellations(), OPTIONS)


def off(solution: Solution) -> np.ndarray:
    return np.linalg.norm(solution.position - ecef_from_llh(HERE), axis=1)


def with_faults(observations: Observations, faults: dict[tuple[int, int], float]) -> Observations:
    """Observations with metres added at (epoch, satellite)."""
    code = observations.values["C1C"].copy()
    for at, size in faults.items():
        code[at] += size
    return replace(observations, values={"C1C": code})


def some(observations: Observations, count: int, epochs: slice = slice(None)) -> Observations:
    """Observations with the first satellites alone at some epochs."""
    code = observations.values["C1C"].copy()
    code[epochs, count:] = np.nan
    return replace(observations, values={"C1C": code})


def test_good_ranges_pass() -> None:
    navigation, observations = made()
    found = solved(navigation, observations)
    assert found.satellites.min() >= 10
    assert off(found).max() < 10.0
    assert found.verdicts.report(found.ranges.names) == ()


@pytest.mark.parametrize(
    ("systems", "size"),
    [(of, size) for of in ("G", "GE") for size in (80e3, -80e3, 300e3, 1000.0)]
    + [("GE", -200.0), ("GE", 100.0)]
    + [("G", 1200e3)],  # puts so many others below the mask that nothing tests the fix
)
def test_a_wrong_range_is_excluded(systems: str, size: float) -> None:
    """Of each satellite once: the fix is that of the others, as if it had not been received."""
    navigation, observations = made(systems)
    count = len(observations.satellites)
    faults = {(2 * k, k): size for k in range(count)}
    found = solved(navigation, with_faults(observations, faults))
    without = solved(navigation, with_faults(observations, dict.fromkeys(faults, np.nan)))
    np.testing.assert_array_equal(np.argwhere(found.verdicts.excluded), sorted(faults))
    np.testing.assert_allclose(found.position, without.position, atol=1e-5)
    np.testing.assert_array_equal(found.satellites, without.satellites)
    np.testing.assert_array_equal(np.isnan(found.ranges.pseudorange), np.isnan(without.ranges.pseudorange))
    assert off(found).max() < 20.0
    (said,) = found.verdicts.report(found.ranges.names)
    assert said.startswith(f"{count} ranges excluded at {count} epochs, since they contradict the others: ")
    assert f"{found.ranges.names[0]} 1" in said


def test_two_wrong_ranges_are_excluded() -> None:
    navigation, observations = made()
    count = len(observations.satellites)
    faults = {(k, k): 80e3 for k in range(count - 3)} | {(k, k + 3): -3e3 for k in range(count - 3)}
    found = solved(navigation, with_faults(observations, faults))
    np.testing.assert_array_equal(np.argwhere(found.verdicts.excluded), sorted(faults))
    assert off(found).max() < 20.0


def test_what_cannot_be_told_apart_is_no_fix() -> None:
    """Five ranges for four unknowns show that one is wrong, not which."""
    navigation, observations = made("G")
    five = with_faults(some(observations, 5), {(k, k % 5): 80e3 for k in range(0, EPOCHS, 2)})
    found = solved(navigation, five)
    np.testing.assert_array_equal(np.isfinite(found.position[:, 0]), np.arange(EPOCHS) % 2 == 1)
    np.testing.assert_array_equal(np.isfinite(found.dop[:, 1]), np.arange(EPOCHS) % 2 == 1)
    assert np.isnan(found.ranges.pseudorange[::2]).all()
    (said,) = found.verdicts.report(found.ranges.names)
    assert said == "20 epochs without a fix, since their ranges contradict each other"
    assert not found.verdicts.excluded.any()


def test_fixes_that_nothing_tests_are_counted_and_compared_with_others() -> None:
    """Of four ranges: flagged where plausible, refused where they lie 80 km away from tested ones."""
    navigation, observations = made("G")
    four = some(observations, 4, slice(10, 20))
    found = solved(navigation, four)
    np.testing.assert_array_equal(found.verdicts.untested, (np.arange(EPOCHS) >= 10) & (np.arange(EPOCHS) < 20))
    assert np.isfinite(found.position).all()
    assert found.verdicts.report(found.ranges.names) == (
        "10 fixes from as many ranges as unknowns, which nothing tests",
    )
    found = solved(navigation, with_faults(four, {(11, 0): 80e3}))
    assert np.flatnonzero(np.isnan(found.position[:, 0])).tolist() == [11]
    assert any("1 epochs without a fix, since height, speed or distance" in line for line in
               found.verdicts.report(found.ranges.names))  # fmt: skip


def test_weak_geometry_gives_no_fix() -> None:
    navigation, observations = made("G")
    found = solve(observations, navigation.constellations(), replace(OPTIONS, most_pdop=1.0))
    assert np.isnan(found.position).all()
    assert found.verdicts.report(found.ranges.names) == (f"{EPOCHS} epochs without a fix, since PDOP is above 1",)
    found = solved(navigation, some(observations, 3, slice(10, 20)))
    assert "10 epochs without a fix, since too few ranges" in " ".join(found.verdicts.report(found.ranges.names))


def test_a_replay_hears_of_excluded_ranges(tmp_path: Path) -> None:
    """Through files, as `navsim replay` reads them."""
    navigation, observations = made("G")
    records = navigation.elements[GPS, GPS.message]
    lines = rinex_write.navigation_lines({GPS: records}, None, [], "made", at=START)
    (tmp_path / "a.nav").write_text("\n".join(lines) + "\n")

    def write(code: np.ndarray) -> None:
        blank = np.full(code.shape, np.nan)
        epochs = rinex_write.Epochs(
            START, np.arange(float(EPOCHS)), observations.satellites, np.stack([code, blank, blank]),
            ecef_from_llh(HERE), {}, 1.0,
        )  # fmt: skip
        (tmp_path / "a.obs").write_text("\n".join(rinex_write.observation_lines(epochs, "a", [], "made")) + "\n")

    dropped = Dropped()
    messages = read_messages(tmp_path / "a.nav", False, dropped, (GPS,))
    code = observations.values["C1C"] - CLOCK
    code[7, 2] += 80e3
    write(code)
    fixes, _ = read_ranges(tmp_path / "a.obs", messages, OPTIONS, 4, 0.0, dropped)
    assert np.linalg.norm(ecef_from_llh(fixes.llh) - ecef_from_llh(HERE), axis=1).max() < 20.0
    assert any(line.startswith("1 ranges excluded at 1 epochs") for line in dropped.reasons())
    code[:, 5:] = np.nan
    code[:, 0] += 80e3
    write(code)
    with pytest.raises(FileError, match=r"two are the least; .*40 epochs without a fix, since their ranges contradict"):
        read_ranges(tmp_path / "a.obs", messages, OPTIONS, 4, 0.0, Dropped())


FOLDER = "data/esbc_2020177"


def test_wrong_ranges_of_a_real_station(shared: Path) -> None:
    """An hour of ESBC, at each second epoch another satellite 80 km off: no fix is off by more than 20 m."""
    navigation = read_nav(shared / FOLDER / "ESBC00DNK_R_20201770000_01D_MN.rnx.gz", systems=SYSTEMS)
    observations = read_obs(shared / FOLDER / "ESBC_2020177_GR_60S.rnx.gz")
    known = json.loads((shared / FOLDER / "truth.json").read_text())
    marker = np.array(known["marker_ITRF2014_at_2020.48_interpolated_m"])
    antenna = marker - ned_matrix(llh_from_ecef(marker))[2] * known["antenna_up_m"]
    hour = slice(600, 660)
    values = {code: table[hour].copy() for code, table in observations.values.items()}
    hour_of = replace(observations, time=observations.time[hour], values=values)
    constellations = {c.system.letter: c for c in navigation.constellations()}
    settings = PositioningOptions(klobuchar=navigation.klobuchar)
    for letters, size in (("G", 80e3), ("GR", -80e3)):
        good = solve(hour_of, [constellations[letter] for letter in letters], settings)
        assert good.verdicts.report(good.ranges.names) == ()
        faulty = {code: table.copy() for code, table in values.items()}
        due = np.zeros(good.residual.shape, dtype=bool)
        for k in range(0, 60, 2):
            used = np.flatnonzero(np.isfinite(good.residual[k]))
            due[k, used[k % used.size]] = True
            column = observations.satellites.index(good.ranges.names[used[k % used.size]])
            for code, table in faulty.items():
                if code.startswith("C"):
                    table[k, column] += size
        found = solve(replace(hour_of, values=faulty), [constellations[letter] for letter in letters], settings)
        error = np.linalg.norm(found.position - antenna, axis=1)
        np.testing.assert_array_equal(found.verdicts.excluded, due)
        assert np.isfinite(error).all()
        assert error.max() < 20.0
