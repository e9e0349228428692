"""Positions from a day of real pseudoranges against the station's known place."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import Observations, read_obs
from navsim.formats.sp3 import read_sp3
from navsim.geodesy.earth import llh_from_ecef, ned_matrix
from navsim.gnss.constellations import glonass_broadcast, gps
from navsim.gnss.constellations.systems import GALILEO, GLONASS, GPS, SYSTEMS
from navsim.replays.single_point import PositioningOptions, solve
from tests.conftest import DATA, Within
from tests.helpers import in_brief

FOLDER = "data/esbc_2020177"
LIMITS = {"G H": "1.5 m", "G V": "1.6 m", "R H": "2.4 m", "R V": "3.4 m", "GR H": "1.3 m", "GR V": "1.9 m"}
"""Largest rms of GPS, GLONASS and both, horizontal and vertical; GLONASS alone: a tenth over a plain solver's."""
MEAN_PDOP = {"G": 1.83, "R": 2.15, "GR": 1.27}
"""Of a plain solver."""


@pytest.fixture(scope="module")
def station(shared: Path) -> tuple[Any, Any, np.ndarray]:
    folder = shared / FOLDER
    known = json.loads((folder / "truth.json").read_text())
    marker = np.array(known["marker_ITRF2014_at_2020.48_interpolated_m"])
    up = -ned_matrix(llh_from_ecef(marker))[2]
    navigation = read_nav(folder / "ESBC00DNK_R_20201770000_01D_MN.rnx.gz")
    observations = read_obs(folder / "ESBC_2020177_GR_60S.rnx.gz")
    return navigation, observations, marker + known["antenna_up_m"] * up


@pytest.mark.validates("Error of single-point positions over a day by GPS, GLONASS and both",
                       "station ESBC, coordinates to centimetres",
                       "(RMS errors; G: GPS, R: GLONASS; H: horizontal, V: vertical)", **LIMITS,
                       PDOP="0.03")  # fmt: skip
@pytest.mark.parametrize("systems", MEAN_PDOP)
def test_a_day_of_positions(systems: str, station: tuple[Any, Any, np.ndarray], within: Within) -> None:
    navigation, observations, antenna = station
    known = {c.system.letter: c for c in navigation.constellations()}
    solution = solve(observations, [known[s] for s in systems], PositioningOptions(klobuchar=navigation.klobuchar))
    error = (solution.position - antenna) @ ned_matrix(llh_from_ecef(antenna)).T
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2)) <= within[f"{systems} H"]
    assert np.sqrt(np.mean(error[:, 2] ** 2)) <= within[f"{systems} V"]
    assert np.mean(solution.dop[:, 1]) == pytest.approx(MEAN_PDOP[systems], abs=within["PDOP"])
    assert np.sqrt(np.mean(solution.velocity**2)) < 0.05  # it stands still
    # in the mean, too: 1.2 to 1.8 mm/s upwards where the satellites' motion is not taken by the second of reception
    assert abs(solution.velocity[:, 2].mean()) < 0.6e-3


PRECISE = "GRG0MGXFIN_20201770000_01D_15M_ORB.SP3.gz"
EPOCHS = slice(600, 660)
"""An hour: GPS and GLONASS satellites come and go in it."""


def part(observations: Observations, epochs: slice = EPOCHS) -> Observations:
    """Some of the epochs, in arrays of their own."""
    values = {code: table[epochs].copy() for code, table in observations.values.items()}
    return replace(observations, time=observations.time[epochs], values=values)


def errors(position: np.ndarray, antenna: np.ndarray) -> np.ndarray:
    return (position - antenna) @ ned_matrix(llh_from_ecef(antenna)).T


PRECISE_LIMITS = {"G H": "3.0 m", "G V": "4.8 m", "R H": "3.4 m", "R V": "5.6 m", "GR H": "1.7 m", "GR V": "3.5 m"}
"""Largest rms, horizontal and vertical, at PDOP below 4: clocks of two frequencies leave the satellites' group delays
in the ranges of one, up to 5 m."""


@pytest.mark.validates("Error of single-point positions by precise orbits (SP3), whose clocks "
                       "leave the group delays, over a day by GPS, GLONASS and both",
                       "station ESBC, coordinates to centimetres",
                       "(RMS errors; G: GPS, R: GLONASS; H: horizontal, V: vertical)", **PRECISE_LIMITS)  # fmt: skip
@pytest.mark.parametrize("systems", ["G", "R", "GR"])
def test_precise_orbits(systems: str, station: tuple[Any, Any, np.ndarray], shared: Path, within: Within) -> None:
    """The orbits have no frequency channels; the observation file has."""
    navigation, observations, antenna = station
    orbits = read_sp3(shared / FOLDER / PRECISE)
    known = {"G": orbits.of(GPS), "R": orbits.of(GLONASS)}
    solution = solve(observations, [known[s] for s in systems], PositioningOptions(klobuchar=navigation.klobuchar))
    # the table begins with the first epoch, and ends 15 minutes before midnight
    sent = observations.time - 0.075
    inside = (sent > orbits.time[0]) & (sent < orbits.time[-1])
    np.testing.assert_array_equal(np.isfinite(solution.position[:, 0]), inside)
    error = errors(solution.position, antenna)[solution.dop[:, 1] < 4.0]
    assert error.shape[0] > 1300
    assert np.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2)) <= within[f"{systems} H"]
    assert np.sqrt(np.mean(error[:, 2] ** 2)) <= within[f"{systems} V"]
    assert np.sqrt(np.nanmean(solution.velocity**2)) < 0.05


def test_precise_and_broadcast_orbits_agree(station: tuple[Any, Any, np.ndarray], shared: Path) -> None:
    """With the group delays left out of both, positions differ by the broadcast orbits' and clocks' own errors."""
    navigation, observations, antenna = station
    hour = part(observations)
    settings = PositioningOptions(klobuchar=navigation.klobuchar)
    bare = gps.KeplerianEphemerides(replace(navigation.gps, tgd=np.zeros_like(navigation.gps.tgd)))
    ours = solve(hour, [read_sp3(shared / FOLDER / PRECISE).of(GPS)], settings)
    theirs = solve(hour, [bare], settings)
    same = ours.satellites == theirs.satellites
    assert same.sum() > 30
    difference = errors(ours.position, antenna) - errors(theirs.position, antenna)
    assert np.abs(difference[same]).max() < 4.0


def test_channels_come_from_messages_where_the_file_has_none(
    station: tuple[Any, Any, np.ndarray], shared: Path
) -> None:
    navigation, observations, _ = station
    orbits = [read_sp3(shared / FOLDER / PRECISE).of(GLONASS)]
    told = glonass_broadcast.StateVectorEphemerides(navigation.glonass).channels
    # R10 is without messages that day, and the file knows it
    told = observations.channels | told
    bare = replace(part(observations), channels={})
    settings = PositioningOptions(klobuchar=navigation.klobuchar)
    with pytest.raises(ValueError, match=r"no frequency channel is known of R01, R02.*GLONASS SLOT / FRQ #"):
        solve(bare, orbits, settings)
    with pytest.raises(ValueError, match=r"no frequency channel is known of R05:"):
        solve(replace(bare, channels={k: v for k, v in told.items() if k != "R05"}), orbits, settings)
    given = solve(bare, orbits, replace(settings, channels=told))
    read = solve(part(observations), orbits, settings)
    np.testing.assert_array_equal(given.position, read.position)
    np.testing.assert_array_equal(given.velocity, read.velocity)


def test_satellites_without_place_clock_or_measurement_shift_nothing(
    station: tuple[Any, Any, np.ndarray], shared: Path
) -> None:
    """The fix is that of the other satellites alone, to the last digit: of orbits with a hole, of orbits without a
    clock, of messages of a satellite that ran out."""
    navigation, observations, _ = station
    orbits = read_sp3(shared / FOLDER / PRECISE).of(GPS)
    hour = part(observations)
    settings = PositioningOptions(klobuchar=navigation.klobuchar)
    i = max(range(len(orbits.names)), key=lambda k: _seen(hour, orbits.names[k]))
    name = orbits.names[i]

    def without(table: np.ndarray) -> np.ndarray:
        table = table.copy()
        table[:, i] = np.nan
        return table

    others = replace(hour, values={code: _blank(hour, table, name) for code, table in hour.values.items()})
    alone = solve(others, [orbits], settings)
    full = solve(hour, [orbits], settings)
    assert np.abs(full.position - alone.position).max() > 0.01
    for holed in (replace(orbits, position=without(orbits.position)), replace(orbits, offset=without(orbits.offset))):
        found = solve(hour, [holed], settings)
        np.testing.assert_array_equal(found.position, alone.position)
        np.testing.assert_array_equal(found.velocity, alone.velocity)
        np.testing.assert_array_equal(found.satellites, alone.satellites)
    records = navigation.gps
    kept = records.take(np.flatnonzero(records.prn != int(name[1:])))
    old = records.take(np.flatnonzero(records.prn == int(name[1:]))[:1])
    long_ago = replace(old, toe=old.toe - 864000.0, toc=old.toc - 864000.0)
    whole = gps.Elements(**{k: np.concatenate([v, getattr(long_ago, k)]) for k, v in vars(kept).items()})
    found, alone = (solve(hour, [gps.KeplerianEphemerides(r)], settings) for r in (whole, kept))
    np.testing.assert_array_equal(found.position, alone.position)


def test_a_missing_doppler_is_no_range_rate_of_zero(station: tuple[Any, Any, np.ndarray]) -> None:
    """Position stays, velocity is that of the other satellites, and there is none of three."""
    navigation, observations, _ = station
    known, settings = [gps.KeplerianEphemerides(navigation.gps)], PositioningOptions(klobuchar=navigation.klobuchar)
    hour = part(observations)
    full = solve(hour, known, settings)
    columns = [i for i, n in enumerate(hour.satellites) if n[0] == "G" and np.isfinite(hour.of("C1C")[:, i]).all()]
    assert len(columns) >= 5
    hour.values["D1C"][:, columns[0]] = np.nan
    one = solve(hour, known, settings)
    np.testing.assert_array_equal(one.position, full.position)
    assert np.isfinite(one.velocity).all()
    assert 0.0 < np.abs(one.velocity - full.velocity).max() < 0.2
    assert np.all(one.covariance[:, 3, 3] >= full.covariance[:, 3, 3])
    keep = columns[:3]
    hour.values["D1C"][:, [i for i in range(len(hour.satellites)) if i not in keep]] = np.nan
    few = solve(hour, known, settings)
    np.testing.assert_array_equal(few.position, full.position)
    assert np.isnan(few.velocity).all()
    assert np.isnan(few.covariance[:, 3:]).all()


def _seen(observations: Observations, name: str) -> int:
    if name not in observations.satellites:
        return 0
    return int(np.isfinite(observations.of("C1C")[:, observations.satellites.index(name)]).sum())


def _blank(observations: Observations, table: np.ndarray, name: str) -> np.ndarray:
    table = table.copy()
    table[:, observations.satellites.index(name)] = np.nan
    return table


# --- all systems of the station's own file


WITHOUT_DELAY = (11, 21)
"""Galileo satellites whose group delay RTKLIB does not take off: it takes those of each satellite's first record, which
of these two is one of F/NAV, that has no BGD(E1, E5b). E11's is -5.0 m."""
SETS = {"GPS": "G", "GAL": "E", "GPS_GAL": "GE", "GPS_BDS": "GC"}


@pytest.fixture(scope="module")
def all_systems(shared: Path) -> tuple[Any, Observations, np.ndarray]:
    folder = shared / FOLDER
    known = json.loads((folder / "truth.json").read_text())
    marker = np.array(known["marker_ITRF2014_at_2020.48_interpolated_m"])
    up = -ned_matrix(llh_from_ecef(marker))[2]
    navigation = read_nav(folder / "ESBC00DNK_R_20201770000_01D_MN.rnx.gz", systems=SYSTEMS)
    whole = read_obs(folder / "ESBC00DNK_R_20201770000_01D_30S_MO.crx.gz")
    codes = {code for system in SYSTEMS for code in (*system.codes, *system.dopplers)}
    values = {code: table[::2].copy() for code, table in whole.values.items() if code in codes}
    return navigation, replace(whole, time=whole.time[::2], values=values), marker + known["antenna_up_m"] * up


def figures(
    navigation: Any, observations: Observations, antenna: np.ndarray, letters: str, settings: PositioningOptions
) -> list[float]:
    """Epochs, mean number of satellites, rms horizontal and vertical, 95 % in space."""
    known = {c.system.letter: c for c in navigation.constellations()}
    solution = solve(observations, [known[letter] for letter in letters], settings)
    error = errors(solution.position, antenna)
    assert np.isfinite(error).all()
    return [
        len(error), solution.satellites.mean(), np.sqrt(np.mean(error[:, 0] ** 2 + error[:, 1] ** 2)),
        np.sqrt(np.mean(error[:, 2] ** 2)), np.percentile(np.linalg.norm(error, axis=1), 95),
    ]  # fmt: skip


@pytest.mark.validates(
    "Error of weighted single-point positions over a day by GPS, Galileo, GPS and Galileo, GPS and BeiDou",
    "RTKLIB rnx2rtkp 2.4.3 on the same file", satellites="0.1",
    **{"RMS and 95 %": "10 %"})  # fmt: skip
@pytest.mark.parametrize("name", in_brief(SETS, 1, 3))
def test_every_set_of_systems_as_rtklib(
    name: str, all_systems: tuple[Any, Observations, np.ndarray], within: Within
) -> None:
    navigation, observations, antenna = all_systems
    settings = PositioningOptions(klobuchar=navigation.klobuchar, weights="budget")
    records = navigation.elements[GALILEO, GALILEO.message]
    bare = replace(records, tgd=np.where(np.isin(records.prn, WITHOUT_DELAY), 0.0, records.tgd))
    like = replace(navigation, elements={**navigation.elements, (GALILEO, GALILEO.message): bare})
    given = json.loads((DATA / "sky.json").read_text())["spp_rtklib"][name]
    found = figures(like, observations, antenna, SETS[name], settings)
    assert found[0] == given[0]
    assert found[1] == pytest.approx(given[1], abs=within["satellites"])
    np.testing.assert_allclose(found[2:], given[2:], rtol=within["RMS and 95 %"])
    # with all group delays, and by the elevation alone
    whole = figures(navigation, observations, antenna, SETS[name], settings)
    plain = figures(navigation, observations, antenna, SETS[name], replace(settings, weights="elevation"))
    limits = {"GPS": (1.15, 1.4), "GAL": (0.55, 0.9), "GPS_GAL": (0.8, 1.1), "GPS_BDS": (0.85, 0.85)}[name]
    assert whole[2] < limits[0]
    assert whole[3] < limits[1]
    assert plain[2] < (1.4 if name == "GPS" else 0.85)
    assert plain[3] < (1.4 if name == "GPS" else 0.85)
