"""Two-line elements: whose satellites they are, and what becomes of those of other systems."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.formats.almanac import read_almanac
from navsim.gnss import atmosphere, timescales
from navsim.gnss.constellations import systems, tle
from navsim.landing import study as landing
from navsim.scenario.load import read
from navsim.scenario_files.source import InputError
from tests.helpers import SCENARIOS

UTC = timescales.posix(2018, 9, 13)


def checked(line: str) -> str:
    """A line of elements with its checksum."""
    return line + str(sum(int(c) if c.isdecimal() else c == "-" for c in line) % 10)


def elements(number: int, inclination: float, node: float, anomaly: float, motion: float) -> list[str]:
    """A circular orbit of 2018-09-13 00:00 UTC; degrees, revolutions a day."""
    return [
        checked(f"1 {number:05d}U 93001A   18256.00000000  .00000000  00000-0  00000-0 0  999"),
        checked(f"2 {number:05d} {inclination:8.4f} {node:8.4f} 0001000   0.0000 {anomaly:8.4f} {motion:11.8f}    1"),
    ]


def walker(first: int, titles: list[str], inclination: float, motion: float, planes: int) -> list[str]:
    """The lines of a constellation: satellites by planes, numbered from `first` in the catalogue."""
    lines = []
    each = len(titles) // planes
    for k, title in enumerate(titles):
        plane, place = divmod(k, each)
        anomaly = (360.0 / each * place + 30.0 * plane) % 360.0
        lines += [title] * bool(title) + elements(first + k, inclination, 360.0 / planes * plane, anomaly, motion)
    return lines


GPS = walker(20001, [f"GPS BIIR-{k:<3d} (PRN {k:02d})" for k in range(1, 25)], 55.0, 2.00563, 6)
GLONASS = walker(30001, [f"COSMOS {2400 + k} ({700 + k}{'K' * (k == 2)})" for k in range(1, 25)], 64.8, 2.13102, 3)
GALILEO = walker(40001, [f"GSAT{200 + k:04d} (PRN E{k:02d})" for k in range(1, 25)], 56.0, 1.70475, 3)
BEIDOU = walker(50001, ["BEIDOU-3 M1 (C19)", "BEIDOU-3 M2 (C20)"], 55.0, 1.86232, 2)
QZSS = walker(51001, ["QZS-1 (QZSS/PRN 183)"], 41.0, 1.00272, 1)
NAVIC = walker(53001, ["IRNSS-1B"], 29.0, 1.00272, 1)
STRANGER = walker(52001, ["VANGUARD 1"], 34.0, 10.8, 1)
KEYS = ("sky.source=almanac", "receiver.rate_hz=2", "duration_s=3", "pseudolites.count=0")


def prepared(folder: Path, lines: list[str], *assignments: str) -> landing.Case:
    (folder / "sky.tle").write_text("\n".join(lines) + "\n")
    keys = (*KEYS, f"sky.almanac={folder / 'sky.tle'}", *assignments)
    return landing.prepare(*read(SCENARIOS / "landing.yaml", keys))


@pytest.mark.parametrize(
    ("title", "system", "name"),
    [
        ("GPS BIIR-2  (PRN 13)", "gps", "G13"),
        ("GPS BIII-1  (PRN 4)", "gps", "G04"),
        ("NAVSTAR 43 (USA 132)", "gps", "T24876"),
        ("COSMOS 2456 (730)", "glonass", "R730"),
        ("COSMOS 2471 (701K)", "glonass", "R701"),
        ("GLONASS-K2 13L", "glonass", "T24876"),
        ("COSMOS 1408 DEB", systems.UNKNOWN, "T24876"),
        ("GSAT0101 (PRN E11)", "galileo", "E11"),
        ("GSAT0101 (GALILEO-PFM)", "galileo", "T24876"),
        ("BEIDOU-3 M1 (C19)", "beidou", "C19"),
        ("BEIDOU-2 G8 (C01)", "beidou", "C01"),
        ("QZS-1 (QZSS/PRN 183)", "qzss", "T24876"),
        ("QZS-1R (QZSS/PRN 196)", "qzss", "T24876"),
        ("GSAT-8 (GAGAN/PRN 127)", "SBAS", "T24876"),
        ("ANIK F1R (WAAS/PRN 138)", "SBAS", "T24876"),
        ("LUCH 5A (SDCM/PRN 140)", "SBAS", "T24876"),
        ("IRNSS-1B", "NavIC", "T24876"),
        ("NVS-01 (IRNSS-1J)", "NavIC", "T24876"),
        ("G32", "gps", "G32"),
        ("G7", "gps", "G07"),
        ("PRN G07", "gps", "G07"),
        ("R01", "glonass", "R01"),
        ("E11", "galileo", "E11"),
        ("E11 (GSAT0101)", "galileo", "E11"),
        ("GSAT0210 [E01]", "galileo", "E01"),
        ("C19", "beidou", "C19"),
        ("J02", "qzss", "J02"),
        ("J02 QZS-2", "qzss", "J02"),
        ("GPS G13", "gps", "G13"),
        ("S20", "SBAS", "T24876"),
        ("I03", "NavIC", "T24876"),
        ("G00", systems.UNKNOWN, "T24876"),
        ("G64", systems.UNKNOWN, "T24876"),
        ("E99", systems.UNKNOWN, "T24876"),
        ("R1.5", systems.UNKNOWN, "T24876"),
        ("C19B ROCKET BODY", systems.UNKNOWN, "T24876"),
        ("EXPLORER E11", systems.UNKNOWN, "T24876"),
        ("ISS (ZARYA)", systems.UNKNOWN, "T24876"),
        ("", systems.UNTITLED, "T24876"),
    ],
)
def test_titles_tell_systems(title: str, system: str, name: str) -> None:
    assert systems.system_of(title) == system
    assert tle.short_name(title, elements(24876, 55.0, 0.0, 0.0, 2.0)[0]) == name
    assert tle.short_name(title.lower(), elements(24876, 55.0, 0.0, 0.0, 2.0)[0]) == name


def test_each_system_keeps_its_clock_and_its_carrier(tmp_path: Path) -> None:
    """GPS and GLONASS of a file of six systems and a stranger, as if it had these two alone."""
    mixed = prepared(tmp_path, GALILEO + GPS + BEIDOU + STRANGER + GLONASS + QZSS, "signals.ionosphere={}")
    plain = prepared(tmp_path, GPS + GLONASS, "signals.ionosphere={}")
    s = mixed.shared.signals
    assert len(s.names) == 48
    assert s.names == plain.shared.signals.names
    np.testing.assert_array_equal(s.range_bias, plain.shared.signals.range_bias)
    np.testing.assert_array_equal(mixed.shared.dop, plain.shared.dop)
    np.testing.assert_array_equal(s.time_scale, [0 if n[0] == "R" else 1 for n in s.names])
    assert {n[0] for n in s.names} == {"G", "R"}
    assert {"R702", "G13"} <= set(s.names)
    assert 1.0 < np.nanmedian(mixed.shared.dop[:, 1]) < 2.0
    # the ionosphere by the square of frequencies: channel 0, for elements tell none
    ratio2 = (atmosphere.L1 / systems.GLONASS.carrier) ** 2
    alone = prepared(tmp_path, [x.replace("COSMOS", "NAVSTAR") for x in GLONASS], "signals.ionosphere={}")
    seen = alone.shared.signals.used
    there = s.divergence[:, [n[0] == "R" for n in s.names]]
    np.testing.assert_allclose(there[seen], ratio2 * alone.shared.signals.divergence[seen], rtol=1e-9)
    assert seen.any()


def test_satellites_of_other_systems_are_named_and_left_out(tmp_path: Path) -> None:
    case = prepared(tmp_path, BEIDOU + GPS + STRANGER + QZSS + NAVIC)
    assert [w[w.index("not used") :] for w in case.warnings if "not used" in w] == [
        "not used, of no known system by their titles: VANGUARD 1 (line 79); known are such as "
        + "; ".join(systems.TITLES),
        "not used, of NavIC, which navsim does not model: IRNSS-1B (line 85)",
        "not used: beidou (2 satellites), qzss (1 satellites) (sky.systems does not name them)",
    ]
    assert not [w for w in prepared(tmp_path, GPS + GLONASS).warnings if "not used" in w]
    with pytest.raises(InputError, match=r"sky\.almanac: no satellite of glonass or gps; .*not used, of NavIC"):
        prepared(tmp_path, NAVIC)
    with pytest.raises(InputError, match=r"sky\.systems: `source: almanac` has no satellite of glonass, gps"):
        prepared(tmp_path, BEIDOU)


def test_satellites_named_as_in_rinex_files_are_those_of_celestrak(tmp_path: Path) -> None:
    """The same sky by both sorts of titles; a file of unknown titles is refused with lines and what would be known."""
    plain = prepared(tmp_path, GPS + GALILEO, "sky.systems=[gps, galileo]")
    named = [
        f"{line[-4:-1] if 'GSAT' in line else 'G' + line[-3:-1]}" if line[0] == "G" else line for line in GPS + GALILEO
    ]
    case = prepared(tmp_path, named, "sky.systems=[gps, galileo]")
    assert case.shared.signals.names == plain.shared.signals.names
    np.testing.assert_array_equal(case.shared.dop, plain.shared.dop)
    assert not [w for w in case.warnings if "not used" in w]
    unknown = [line.replace("GPS", "OBJECT").replace("PRN ", "") for line in GPS]
    said = r"no satellite of glonass or gps; .*: OBJECT BIIR-1   \(01\) \(line 1\), .* and 14 more; known are .* G13"
    with pytest.raises(InputError, match=said):
        prepared(tmp_path, unknown)


def test_named_systems_are_used_each_with_its_clock(tmp_path: Path) -> None:
    case = prepared(tmp_path, GALILEO + GPS + GLONASS, "sky.systems=[gps, galileo]")
    s = case.shared.signals
    assert {n[0] for n in s.names} == {"G", "E"}
    assert {n[0]: systems.CLOCKS[c] for n, c in zip(s.names, s.time_scale, strict=True)} == {"G": "gps", "E": "galileo"}
    assert not [w for w in case.warnings if "not used" in w]


def test_elements_without_names_need_the_key(tmp_path: Path) -> None:
    bare = walker(20001, [""] * 24, 64.8, 2.13102, 3)
    with pytest.raises(InputError, match=r"24 of its two-line elements have no names.*sky\.almanac_system"):
        prepared(tmp_path, bare)
    case = prepared(tmp_path, bare, "sky.almanac_system=glonass")
    assert case.shared.signals.names[:2] == ("T20001", "T20002")
    assert not case.shared.signals.time_scale.any()
    assert prepared(tmp_path, bare, "sky.almanac_system=gps", "sky.exclude=[T20003]").shared.signals.time_scale.all()
    # names tell it where there are any
    both = prepared(tmp_path, bare + GPS[:6], "sky.almanac_system=glonass").shared.signals
    assert {n: int(c) for n, c in zip(both.names, both.time_scale, strict=True) if n[0] == "G"} == {
        "G01": 1, "G02": 1
    }  # fmt: skip
    told = prepared(tmp_path, bare, "sky.almanac_system=galileo").shared.signals
    assert {systems.CLOCKS[c] for c in told.time_scale} == {"galileo"}
    with pytest.raises(InputError, match="almanac_system"):
        prepared(tmp_path, bare, "sky.almanac_system=navic")


def test_comments_are_no_names(tmp_path: Path) -> None:
    path = tmp_path / "sky.tle"
    lines = ["# made by hand", "# of 2018", *GPS[:3], "# between", *GPS[3:5], "# within", GPS[5], "#"]
    path.write_text("\n".join(lines) + "\n")
    found = read_almanac(path, UTC)
    assert [one.names for one in found.constellations] == [("G01", "G02")]
    assert not found.not_used


def test_motion_is_steady_through_a_leap_second(tmp_path: Path) -> None:
    """No step at 2017-01-01, of elements from before it: each position continues the last by its velocity."""
    lines = [checked(x[:-1].replace("18256.", "16366.")) if x[:2] == "1 " else x for x in GPS[:3]]
    (tmp_path / "sky.tle").write_text("\n".join(lines) + "\n")
    found = read_almanac(tmp_path / "sky.tle", UTC).constellations[0]
    t = timescales.gps_from_utc(timescales.posix(2016, 12, 31, 23, 59, 57.0)) + np.arange(0.0, 8.0, 0.5)
    position, velocity = found.state(t)
    step = np.diff(position[:, 0], axis=0) / 0.5
    np.testing.assert_allclose(step, 0.5 * (velocity[1:, 0] + velocity[:-1, 0]), atol=1.0)
