"""Older forms of the files: RINEX 2 messages, SP3 of versions a and d, twelve satellites a line, events."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.formats import rinex_write
from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import read_obs
from navsim.formats.sp3 import read_sp3
from navsim.formats.text import FileError
from navsim.gnss import timescales
from navsim.gnss.constellations import glonass, glonass_broadcast, gps
from navsim.gnss.constellations.systems import GPS

UTC = timescales.posix(2018, 9, 13, 12)


def header(text: str, label: str) -> str:
    return f"{text:60s}{label}"


def as_version_2(lines: list[str], letter: str) -> str:
    """Version 3 records of one system in the columns of version 2."""
    kind = {"G": "N: GPS NAV DATA", "R": "G: GLONASS NAV DATA"}[letter]
    out = [header(f"     2.11           {kind}", "RINEX VERSION / TYPE"), header("", "END OF HEADER")]
    taken = False
    for line in lines[lines.index(next(x for x in lines if "END OF HEADER" in x)) + 1 :]:
        if line[0] != " ":
            taken = line[0] == letter
            if taken:
                year, rest = line[6:8], line[8:20]
                out.append(f"{int(line[1:3]):2d} {year}{rest} {int(line[21:23]):2d}.0"[:22] + line[23:])
        elif taken:
            out.append(line[1:])
    return "\n".join(out) + "\n"


def test_rinex_2_messages_say_the_same(tmp_path: Path) -> None:
    elements = gps.nominal(UTC).records.take(np.arange(4))
    elements = elements.referred_to(np.round(elements.toe / 7200.0) * 7200.0, GPS)
    vectors = glonass_broadcast.sent_by(glonass.Glonass24Slots(), UTC, UTC).records.take(np.arange(4))
    lines = rinex_write.navigation_lines({GPS: elements}, vectors, [], "made", at=float(elements.toe[0]))
    (tmp_path / "three").write_text("\n".join(lines) + "\n")
    new = read_nav(tmp_path / "three")
    for letter in "GR":
        (tmp_path / letter).write_text(as_version_2(lines, letter))
    old_gps, old_glonass = read_nav(tmp_path / "G").gps, read_nav(tmp_path / "R").glonass
    assert new.gps is not None
    assert new.glonass is not None
    assert old_gps is not None
    assert old_glonass is not None
    for field in ("prn", "toe", "toc", "sqrt_a", "m0", "omega0", "i0", "omega_dot", "healthy"):
        np.testing.assert_array_equal(getattr(old_gps, field), getattr(new.gps, field))
    for field in ("slot", "channel", "time", "position", "velocity", "acceleration", "healthy"):
        np.testing.assert_array_equal(getattr(old_glonass, field), getattr(new.glonass, field))
    np.testing.assert_allclose(new.glonass.position, vectors.position, atol=1e-6)
    assert new.leap_seconds == 18


def test_five_line_glonass_records(tmp_path: Path) -> None:
    """Version 3.05 adds a line to each GLONASS record."""
    vectors = glonass_broadcast.sent_by(glonass.Glonass24Slots(), UTC, UTC).records.take(np.arange(3))
    lines = rinex_write.navigation_lines({}, vectors, [], "made", at=float(timescales.gps_from_utc(UTC)))
    body = lines.index(next(x for x in lines if "END OF HEADER" in x)) + 1
    longer = lines[:body]
    for k in range(body, len(lines), 4):
        longer += [*lines[k : k + 4], "    " + 4 * f"{0.0:19.12E}"]
    (tmp_path / "nav").write_text("\n".join(longer).replace("3.04", "3.05") + "\n")
    found = read_nav(tmp_path / "nav").glonass
    assert found is not None
    np.testing.assert_array_equal(found.slot, vectors.slot)
    np.testing.assert_allclose(found.position, vectors.position, atol=1e-6)


def test_rinex_2_observations_of_many_satellites(tmp_path: Path) -> None:
    """Fourteen satellites and six kinds: a second line of satellites, a second line of values, and an event between."""
    names = [f"G{k:02d}" for k in range(1, 10)] + [f"R{k:02d}" for k in range(1, 6)]
    text = [
        header("     2.11           OBSERVATION DATA    M (MIXED)", "RINEX VERSION / TYPE"),
        header("     6    C1    L1    D1    S1    P1    C2", "# / TYPES OF OBSERV"),
        header("  2018     9    13    12     0    0.0000000     GPS", "TIME OF FIRST OBS"),
        header("", "END OF HEADER"),
    ]
    for second in (0, 30):
        text.append(f" 18  9 13 12  0 {second:2d}.0000000  0 14" + "".join(names[:12]))
        text.append(" " * 32 + "".join(names[12:]))
        for i, _ in enumerate(names):
            values = [2e7 + i, 1e8 + i, 100.0 + i, 40.0, 2e7 + i, 0.0]
            row = "".join(f"{v:14.3f} {7 if k == 1 else ' '}" for k, v in enumerate(values))
            text += [row[:80].rstrip(), row[80:].rstrip()]
        if not second:
            text.append(" 18  9 13 12  0 10.0000000  4  1")
            text.append(header("a remark", "COMMENT"))
    (tmp_path / "obs").write_text("\n".join(text) + "\n")
    found = read_obs(tmp_path / "obs")
    assert found.satellites == tuple(sorted(names))
    assert found.events == 1
    np.testing.assert_allclose(np.diff(found.time), [30.0])
    assert found.values["C1"][1, names.index("R03")] == pytest.approx(2e7 + names.index("R03"))
    assert np.isnan(found.values["C2"]).all()  # zeros are missing values
    assert found.lost_lock["L1"].any() == np.False_ or found.lost_lock["L1"].all()


def test_observations_in_glonass_time_have_the_leap_second(tmp_path: Path) -> None:
    """23:59:60 is a second of its own where a file counts UTC."""
    text = [
        f"{'     3.04           OBSERVATION DATA    R: GLONASS':60s}RINEX VERSION / TYPE",
        f"{'R    1 C1C':60s}SYS / # / OBS TYPES",
        f"{'  2016    12    31    23    59   59.0000000     GLO':60s}TIME OF FIRST OBS",
        f"{'':60s}END OF HEADER",
    ]
    for date in ("2016 12 31 23 59 59.0000000", "2016 12 31 23 59 60.0000000", "2016 12 31 23 59 60.5000000",
                 "2017 01 01 00 00  0.0000000"):  # fmt: skip
        text += [f"> {date}  0  1", f"R01{2.2e7:14.3f}"]
    (tmp_path / "obs").write_text("\n".join(text) + "\n")
    time = read_obs(tmp_path / "obs").time
    np.testing.assert_array_equal(np.diff(time), [1.0, 0.5, 0.5])
    assert time[0] == timescales.gps_from_utc(timescales.posix(2016, 12, 31, 23, 59, 59.0))


@pytest.mark.parametrize("version", "abcd")
def test_versions_of_sp3(version: str, tmp_path: Path) -> None:
    name = "  1" if version == "a" else "G01"
    text = [f"#{version}P2018  9 13 12  0  0.00000000       1 TRACK IGb14 FIT TEST", "+    1   " + name + "  0" * 16,
            "%c M  cc GPS ccc cccc", "*  2018  9 13 12  0  0.00000000",
            f"P{name}  15000.000000  12000.000000  18000.000000     12.500000", "EOF"]  # fmt: skip
    (tmp_path / "sp3").write_text("\n".join(text) + "\n")
    found = read_sp3(tmp_path / "sp3")
    assert found.names == ("G01",)
    np.testing.assert_allclose(found.position[0, 0], [15e6, 12e6, 18e6])
    assert found.offset[0, 0] == pytest.approx(12.5e-6)
    assert found.time[0] == timescales.posix(2018, 9, 13, 12) - timescales.GPS_EPOCH  # the file counts GPS time


def test_versions_not_read_are_named(tmp_path: Path) -> None:
    (tmp_path / "nav").write_text(header("     5.00           NAVIGATION DATA     M", "RINEX VERSION / TYPE") + "\n")
    with pytest.raises(FileError, match="navsim reads versions 2, 3 and 4"):
        read_nav(tmp_path / "nav")
    other = tmp_path / "other"
    other.write_text(header("     3.04           NAVIGATION DATA     M", "RINEX VERSION / TYPE") + "\n")
    with pytest.raises(FileError, match="give one of observations"):
        read_obs(other)


SP3 = ["#cP2018  9 13 12  0  0.00000000       3 TRACK IGb14 FIT TEST", "+    2   G01R02" + "  0" * 15,
       "%c M  cc GPS ccc cccc"]  # fmt: skip


def sp3_epoch(k: int) -> list[str]:
    places = (("G01", 15e3 + k, 12e3, 18e3, 12.5), ("R02", -9e3 - k, 20e3, 12e3, 13.5))
    rows = [f"P{name}" + "".join(f"{x:14.6f}" for x in numbers) for name, *numbers in places]
    return [f"*  2018  9 13 12 {15 * k:2d}  0.00000000", *rows]


def test_damaged_sp3_files(tmp_path: Path) -> None:
    """Refused with the line; a lenient reader takes the whole records."""
    lines = [*SP3, *(line for k in range(3) for line in sp3_epoch(k)), "EOF"]
    path = tmp_path / "sp3"

    def leniently(text: str, said: str, line: int) -> np.ndarray:
        path.write_text(text)
        with pytest.raises(FileError, match=said) as caught:
            read_sp3(path)
        assert caught.value.line == line
        assert caught.value.salvageable
        found = read_sp3(path, lenient=True)
        assert any(said in remark for remark in found.left_out)
        return found.position

    path.write_text("\n".join(lines) + "\n")
    whole = read_sp3(path)
    assert whole.left_out == ()
    position = leniently("\n".join(lines[:-1]) + "\n", "no line EOF", 13)
    np.testing.assert_array_equal(position, whole.position)
    position = leniently("\n".join(lines[:-1])[:-30], "the line ends within position", 12)
    np.testing.assert_array_equal(position[:, 0], whole.position[:, 0])
    assert np.isnan(position[2, 1]).all()
    assert np.isfinite(position[:2]).all()
    position = leniently("\n".join([lines[0].replace("       3 ", "       4 "), *lines[1:]]), "announces 4 epochs", 13)
    np.testing.assert_array_equal(position, whole.position)
    position = leniently("\n".join(lines).replace("9 13 12 15", "9 33 12 15"), "invalid time", 7)
    np.testing.assert_array_equal(position, whole.position[[0, 2]])
    position = leniently("\n".join(lines).replace("+    2", "+    3"), "announces 3 satellites and lists 2", 0)
    np.testing.assert_array_equal(position, whole.position)
    position = leniently("\n".join(lines).replace("PR02", "PR03", 1), "the header does not list R03", 6)
    assert np.isnan(position[0, 1]).all()
