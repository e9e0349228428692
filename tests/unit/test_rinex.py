"""RINEX: scale factors, blank lines of version 2, version 4, events, damaged files; texts made here."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import Observations, read_obs
from navsim.formats.text import FileError
from navsim.gnss import timescales
from tests.rinex import epoch_2, header, in_version_4, labelled, navigation_3, observations_2, observations_3, row

UTC = timescales.posix(2018, 9, 13, 12)


def read(tmp_path: Path, text: str, lenient: bool = False) -> Observations:
    (tmp_path / "obs").write_text(text)
    return read_obs(tmp_path / "obs", lenient)


def refused(tmp_path: Path, text: str) -> FileError:
    (tmp_path / "obs").write_text(text)
    with pytest.raises(FileError) as caught:
        read_obs(tmp_path / "obs")
    return caught.value


# --- scale factors


def test_scale_factors_of_version_3_are_undone(tmp_path: Path) -> None:
    """A whole system, listed types that beat it, another system; what is not scaled stays."""
    scaled = [
        labelled("G   10", "SYS / SCALE FACTOR"),
        labelled("G  100   2 C1C S1C", "SYS / SCALE FACTOR"),
        labelled("R 1000   1 L1C", "SYS / SCALE FACTOR"),
    ]
    plain = read(tmp_path, observations_3())
    found = read(tmp_path, observations_3(extra=scaled))
    divisors = {"G": {"C1C": 100, "L1C": 10, "D1C": 10, "S1C": 100}, "R": {"L1C": 1000}}
    for i, name in enumerate(plain.satellites):
        for code in ("C1C", "L1C", "D1C", "S1C"):
            factor = divisors[name[0]].get(code, 1)
            np.testing.assert_array_equal(found.values[code][:, i], plain.values[code][:, i] / factor)


def test_a_scale_factor_of_more_types_than_one_line_holds(tmp_path: Path) -> None:
    codes = [f"{kind}{band}{channel}" for kind in "CLD" for band in "125" for channel in "CW"]
    types = [labelled(f"G   {len(codes)}" + "".join(f" {c}" for c in codes[k : k + 13]) if not k
                      else 6 * " " + "".join(f" {c}" for c in codes[k : k + 13]), "SYS / # / OBS TYPES")
             for k in range(0, len(codes), 13)]  # fmt: skip
    scaled = [
        labelled("G  100  13" + "".join(f" {c}" for c in codes[:12]), "SYS / SCALE FACTOR"),
        labelled(10 * " " + f" {codes[12]}", "SYS / SCALE FACTOR"),
    ]
    body = ["> 2018 09 13 12 00  0.0000000  0  1", row("G01", [2e7] * len(codes))]
    found = read(tmp_path, "\n".join([*header(3.04, [*types, *scaled]), *body]) + "\n")
    for k, code in enumerate(codes):
        assert found.values[code][0, 0] == (2e5 if k < 13 else 2e7)
    short = [scaled[0].replace(" 13 ", " 14 "), scaled[1]]
    error = refused(tmp_path, "\n".join([*header(3.04, [*types, *short]), *body]) + "\n")
    assert "lacks 1 of these scaled types" in error.message


@pytest.mark.parametrize("version", [2.11, 2.20])
def test_scale_factors_of_version_2_are_undone(version: float, tmp_path: Path) -> None:
    scaled = [
        labelled("    10     1    L1", "OBS SCALE FACTOR"),
        labelled("   100     2    S1    D1", "OBS SCALE FACTOR"),
    ]
    plain = read(tmp_path, observations_2(version))
    found = read(tmp_path, observations_2(version, extra=scaled))
    factors = {"L1": 10.0, "S1": 100.0, "D1": 100.0}
    assert factors.keys() < found.values.keys() == plain.values.keys()
    for code, values in plain.values.items():
        np.testing.assert_array_equal(found.values[code], values / factors.get(code, 1.0))
    all_types = read(tmp_path, observations_2(version, extra=[labelled("  1000", "OBS SCALE FACTOR")]))
    for code, values in plain.values.items():
        np.testing.assert_array_equal(all_types.values[code], values / 1000.0)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("G   20", "the scale factor is 20; RINEX allows 1, 10, 100, 1000"),
        ("G    0", "the scale factor is 0; RINEX allows 1, 10, 100, 1000"),
        ("G", "expected a number for the scale factor"),
        ("    10   1 C1C", "but no satellite system"),
        ("X   10", "unknown satellite system 'X'"),
        ("G   10   1 C1C L1C", "more scaled types than line 4 announces"),
        ("           C1C", "types to scale, but no factor"),
    ],
)
def test_unknown_scale_factors_are_refused(line: str, said: str, tmp_path: Path) -> None:
    text = observations_3(extra=[labelled(line, "SYS / SCALE FACTOR")])
    error = refused(tmp_path, text)
    assert said in error.message
    assert error.line == text.split("\n").index(labelled(line, "SYS / SCALE FACTOR")) + 1


def test_header_lines_between_epochs_change_what_follows(tmp_path: Path) -> None:
    """Flag 4: new types and a new factor for GPS from here on."""
    event = [
        "> 2018 09 13 12 00 01.5000000  4  2",
        labelled("G    2 S1C C1C", "SYS / # / OBS TYPES"),
        labelled("G   10   1 C1C", "SYS / SCALE FACTOR"),
    ]
    after = ["> 2018 09 13 12 00  3.0000000  0  1", row("G05", [41.0, 2.5e8])]
    found = read(tmp_path, observations_3(tail=[*event, *after]))
    at = found.satellites.index("G05")
    assert found.events == 1
    assert found.values["S1C"][-1, at] == 41.0
    assert found.values["C1C"][-1, at] == 2.5e7
    assert found.values["C1C"][0, at] == pytest.approx(2e7, rel=0.1)
    assert np.isnan(found.values["L1C"][-1, at])


# --- version 2


@pytest.mark.parametrize("ending", ["padded", "empty", "without the last line's end", "trimmed"])
def test_the_last_lines_of_version_2_may_be_blank(ending: str, tmp_path: Path) -> None:
    """Seven types make two lines; the last satellite has nothing for the second, or for both."""
    text = observations_2(2.11, types=7, blank_from=5)
    lines = text.split("\n")[:-1]
    assert lines[-1].strip() == ""
    assert lines[-2].strip()
    if ending == "padded":
        lines[-1] = 80 * " "
    text = "\n".join(lines) + "\n"
    if ending == "trimmed":
        text = "\n".join(lines[:-1]) + "\n"
    elif ending == "without the last line's end":
        text = "\n".join(lines)
    found = read(tmp_path, text)
    whole = read(tmp_path, observations_2(2.11, types=7))
    assert found.satellites == whole.satellites
    for code in ("C1", "L1", "D1", "S1", "P1"):
        np.testing.assert_array_equal(found.values[code], whole.values[code])
    assert np.isnan(found.values["C2"][-1, -1])
    assert bool(found.left_out) == (ending in ("trimmed", "without the last line's end"))
    if found.left_out:
        assert "as blank" in found.left_out[0]


def test_satellites_of_version_2_without_any_value(tmp_path: Path) -> None:
    text = observations_2(2.11, types=7, blank_from=0)
    found = read(tmp_path, text)
    last = found.satellites.index("R02")
    assert all(np.isnan(values[-1, last]) for values in found.values.values())
    assert found.values["C1"][0, last] > 1e7
    read(tmp_path, text + "\n\n   \n")


def test_slips_of_version_2_have_the_lines_of_observations(tmp_path: Path) -> None:
    """Flag 6 announces satellites, not lines."""
    slips = [epoch_2(1.5, ["G05", "R02"], 6), *[f"{3.0:14.3f}", ""] * 2]
    after = [epoch_2(5.0, ["G05"], 0), *[f"{2.3e7:14.3f}", ""]]
    found = read(tmp_path, observations_2(2.11, types=7, tail=[*slips, *after]))
    assert found.events == 1
    assert found.time.size == 3
    assert found.values["C1"][-1, found.satellites.index("G05")] == 2.3e7


def test_georinex_reads_the_same_of_version_2(tmp_path: Path) -> None:
    import georinex

    (tmp_path / "s.18o").write_text(observations_2(2.11, types=7, blank_from=5))
    theirs, ours = georinex.load(tmp_path / "s.18o"), read_obs(tmp_path / "s.18o")
    assert ours.satellites
    for i, name in enumerate(ours.satellites):
        for code in ("C1", "L1", "S1", "C2"):
            their = theirs[code].sel(sv=name).values
            np.testing.assert_array_equal(ours.values[code][:, i], their)


# --- version 4


@pytest.mark.parametrize("version", ["4.00", "4.01", "4.02"])
def test_observations_of_version_4(version: str, tmp_path: Path) -> None:
    old = read(tmp_path, observations_3())
    new = read(tmp_path, observations_3().replace("3.04", version, 1))
    assert new.satellites == old.satellites
    np.testing.assert_array_equal(new.time, old.time)
    assert new.values.keys() == old.values.keys() > set()
    for code, values in old.values.items():
        np.testing.assert_array_equal(new.values[code], values)


def made_4(*more: str, version: str = "4.00") -> str:
    return in_version_4(navigation_3(UTC), version, [line for record in more for line in record.split("\n")])


ION_OLD = """> ION G17 LNAV
    2018 09 13 01 00 00 1.000000000000e-08 0.000000000000e+00 0.000000000000e+00
     0.000000000000e+00 8.000000000000e+04 0.000000000000e+00 0.000000000000e+00
     0.000000000000e+00"""
ION = """> ION G25 LNAV
    2018 09 13 11 33 54 2.514570951462e-08 1.490116119385e-08-1.192092895508e-07
    -5.960464477539e-08 1.331200000000e+05-1.638400000000e+04-2.621440000000e+05
     1.966080000000e+05"""
STO = """> STO G27 LNAV
    2018 09 13 19 56 48 GPUT                                  UTC(USNO)
     3.177840000000e+05-9.313225746155e-10-4.440892098501e-15 0.000000000000e+00"""
STO_R = """> STO R   FDMA
    2018 09 13 00 00 00 GLGP
     2.809660000000e+05-4.470348358154e-08 0.000000000000e+00 0.000000000000e+00"""
EOP = """> EOP J01 CNVX
    2018 09 13 01 00 00 2.082471847534e-01-6.551742553711e-04 0.000000000000e+00
                        3.444433212280e-01-9.121894836426e-04 0.000000000000e+00
     1.729860000000e+05-1.754972934723e-01 5.635917186737e-04 0.000000000000e+00"""
ION_C = ION.replace("G25 LNAV", "C35 D1D2")
ION_R = """> ION R22 LXOC
    2018 09 13 00 01 09 1.000000000000e+00 1.410000000000e+02 5.000000000000e+00"""


@pytest.mark.parametrize("version", ["4.00", "4.01", "4.02"])
def test_messages_of_version_4(version: str, tmp_path: Path) -> None:
    """LNAV, FDMA and Klobuchar's coefficients are used (of several the newest), all else is counted."""
    (tmp_path / "three").write_text(navigation_3(UTC))
    old = read_nav(tmp_path / "three")
    lnav = made_4().split("> EPH ")[1].split("\n", 1)[1].rstrip("\n")
    others = [f"> EPH G01 {m}\n{lnav}\n    {4 * f'{0.0:19.12e}'}" for m in ("CNAV", "CNV2")]
    others += [f"> EPH E11 INAV\n{lnav.replace('G01', 'E11')}", f"> EPH S27 SBAS\n{lnav.replace('G01', 'S27')}"]
    text = made_4(ION, *others, ION_OLD, STO, STO_R, EOP, ION_C, ION_R, STO, version=version)
    (tmp_path / "four").write_text(text)
    new = read_nav(tmp_path / "four")
    assert old.gps is not None
    assert old.glonass is not None
    assert new.gps is not None
    assert new.glonass is not None
    for field in ("prn", "toe", "toc", "sqrt_a", "e", "m0", "omega0", "i0", "af0", "tgd", "iode", "healthy"):
        np.testing.assert_array_equal(getattr(new.gps, field), getattr(old.gps, field))
    for field in ("slot", "channel", "time", "position", "velocity", "acceleration", "tau", "gamma", "healthy"):
        np.testing.assert_array_equal(getattr(new.glonass, field), getattr(old.glonass, field))
    assert new.leap_seconds == 18
    assert new.klobuchar is not None
    np.testing.assert_array_equal(new.klobuchar[0], [2.514570951462e-08, 1.490116119385e-08, -1.192092895508e-07,
                                                     -5.960464477539e-08])  # fmt: skip
    np.testing.assert_array_equal(new.klobuchar[1], [1.3312e5, -1.6384e4, -2.62144e5, 1.96608e5])
    assert new.skipped == {
        "G CNAV": 1, "G CNV2": 1, "E INAV": 1, "S SBAS": 1, "STO G LNAV": 2, "STO R FDMA": 1, "EOP J CNVX": 1,
        "ION C D1D2": 1, "ION R LXOC": 1,
    }  # fmt: skip
    assert new.left_out == ()


OLD, M = f"{1.0:19.12E}", f"{179.0:19.12E}"


@pytest.mark.parametrize(
    ("flags", "status", "healthy"),
    [(0, M, 1), (1, M, 1), (2, M, 0), (3, M, 1), (4, M, 0), (7, M, 0), ("", M, 1), (0.999999999999e9, M, 1),
     (4, "", 0), (4, OLD, 1), (2, OLD, 0)],
)  # fmt: skip
def test_health_flags_of_the_fifth_line_count(
    flags: float | str, status: str, healthy: int, tmp_path: Path
) -> None:  # fmt: skip
    """String 3 says nothing of satellites before GLONASS-M, the almanac of all."""
    field = f"{flags:19.12E}" if flags != "" else ""
    (tmp_path / "nav").write_text(in_version_4(navigation_3(UTC), "4.00", [], flags=field, status=status))
    found = read_nav(tmp_path / "nav").glonass
    assert found is not None
    assert np.all(found.healthy == bool(healthy))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.replace("> EPH R01 FDMA\n", ""), "too long: it has 13 lines, allowed are 8"),
        (lambda t: t.replace("> EPH G02", "> EPH G03"), "announces G03, here is 'G02'"),
        (lambda t: t.replace("> EPH G02 LNAV", "> XYZ G02 LNAV"), "one of EPH, STO, EOP, ION"),
        (lambda t: t.replace("> EPH G02 LNAV", "> EPH G02"), "a satellite, a message"),
        (lambda t: t.replace("> EPH G01 LNAV\n", "", 1), "expected a line such as > EPH G01 LNAV"),
        (lambda t: t.rstrip("\n").rsplit("\n", 1)[0] + "\n", "the message ends early: it has 4 of 5 lines"),
        (lambda t: t.rstrip("\n")[:-5], "the file ends within a value"),
        (lambda t: t + "> EPH R09 FDMA\n", "no lines follow"),
        (lambda t: t.replace("     4.00", "     5.00"), "version 5; navsim reads versions 2, 3 and 4"),
    ],
)  # fmt: skip
def test_damaged_files_of_version_4_are_refused(change: Any, said: str, tmp_path: Path) -> None:
    text = change(made_4())
    (tmp_path / "nav").write_text(text)
    with pytest.raises(FileError, match=said.replace("(", r"\(")) as caught:
        read_nav(tmp_path / "nav")
    assert caught.value.line > 0


def test_a_file_of_other_messages_alone_names_them(tmp_path: Path) -> None:
    text = made_4(STO)
    head = text[: text.index("> EPH")]
    (tmp_path / "nav").write_text(head + STO + "\n")
    with pytest.raises(FileError, match="navsim skipped STO G LNAV"):
        read_nav(tmp_path / "nav")


def test_a_real_day_in_version_4(shared: Path, tmp_path: Path) -> None:
    """The messages and the observations of a station, in the frames of version 4."""
    folder = shared / "data" / "esbc_2020177"
    path = folder / "ESBC00DNK_R_20201770000_01D_MN.rnx.gz"
    old = read_nav(path)
    (tmp_path / "nav").write_text(in_version_4(gzip.decompress(path.read_bytes()).decode(), "4.00", [ION]))
    new = read_nav(tmp_path / "nav")
    assert old.gps is not None
    assert old.glonass is not None
    assert new.gps is not None
    assert new.glonass is not None
    np.testing.assert_array_equal(new.gps.toe, old.gps.toe)
    np.testing.assert_array_equal(new.glonass.position, old.glonass.position)
    assert {k.split()[0]: n for k, n in new.skipped.items()} == old.skipped
    assert new.klobuchar is not None
    text = gzip.decompress((folder / "ESBC_2020177_GR_60S.rnx.gz").read_bytes()).decode()
    lines = text.split("\n")[:2000]
    last = max(k for k, line in enumerate(lines) if line.startswith(">"))
    lines = [*lines[:last], ""]
    three = read(tmp_path, "\n".join(lines))
    four = read(tmp_path, "\n".join(lines).replace("3.05", "4.02", 1))
    assert four.values.keys() == three.values.keys() > set()
    for code, values in three.values.items():
        np.testing.assert_array_equal(four.values[code], values)


# --- wrong counts, and files cut at their end


def test_a_wrong_number_of_satellites(tmp_path: Path) -> None:
    """Refused with its line; a lenient reader counts the lines."""
    text = observations_3()
    whole = read(tmp_path, text)
    for wrong in (1, 2, 4, 7):
        lines = text.split("\n")
        at = next(k for k, line in enumerate(lines) if line.startswith(">"))
        lines[at] = lines[at][:32] + f"{wrong:3d}" + lines[at][35:]
        error = refused(tmp_path, "\n".join(lines))
        assert error.line == at + 1
        assert f"announces {wrong} satellites, lines of 3 follow" in error.message
        assert error.salvageable
        found = read(tmp_path, "\n".join(lines), lenient=True)
        np.testing.assert_array_equal(found.values["C1C"], whole.values["C1C"])
        assert len(found.left_out) == 1
        assert f"obs:{at + 1}:" in found.left_out[0]


@pytest.mark.parametrize("types", [4, 7])
def test_a_wrong_number_of_satellites_in_version_2(types: int, tmp_path: Path) -> None:
    text = observations_2(2.11, types=types)
    whole = read(tmp_path, text)
    for wrong in (1, 5):
        lines = text.split("\n")
        at = next(k for k, line in enumerate(lines) if line.startswith(" 18"))
        lines[at] = lines[at][:29] + f"{wrong:3d}" + lines[at][32:]
        error = refused(tmp_path, "\n".join(lines))
        assert error.line == at + 1
        assert f"announces {wrong} satellites, 3 are listed" in error.message
        found = read(tmp_path, "\n".join(lines), lenient=True)
        np.testing.assert_array_equal(found.values["C1"], whole.values["C1"])
        assert len(found.left_out) == 1
    # a line too few: whose are the others?
    lines = text.split("\n")
    at = next(k for k, line in enumerate(lines) if line.startswith(" 18"))
    del lines[at + 2]
    assert "each, follow" in refused(tmp_path, "\n".join(lines)).message
    found = read(tmp_path, "\n".join(lines), lenient=True)
    assert found.time.size == whole.time.size - 1
    np.testing.assert_array_equal(found.values["C1"], whole.values["C1"][1:])


@pytest.mark.parametrize("version", [2, 3])
def test_files_cut_at_any_place(version: int, tmp_path: Path) -> None:
    """Strictly: refused, unless it is cut between epochs. Leniently: whatever is found is what the whole file has."""
    text = observations_3() if version == 3 else observations_2(2.11, types=7)
    whole = read(tmp_path, text)
    body = text.index("END OF HEADER") + 14
    starts = [k for k in range(body, len(text)) if text[k - 1] == "\n" and text[k:].startswith((">", " 18"))]
    cuts = range(starts[1], len(text) - 1, 7)
    taken = 0
    for cut in cuts:
        part = text[:cut]
        found = read(tmp_path, part, lenient=True)
        for code, values in found.values.items():
            columns = [whole.satellites.index(name) for name in found.satellites]
            theirs = whole.values[code][: found.time.size, columns]
            known = np.isfinite(values)
            np.testing.assert_array_equal(values[known], theirs[known])
        if found.left_out and "as blank" not in found.left_out[0]:
            error = refused(tmp_path, part)
            assert error.line == len(part.removesuffix("\n").split("\n"))
            assert error.salvageable
        else:
            # nothing tells a cut between values, or between epochs, from values and epochs that are missing
            assert read(tmp_path, part).time.size == found.time.size
            taken += 1
    assert taken < 0.25 * len(cuts)


def test_one_bad_line_costs_one_satellite(tmp_path: Path) -> None:
    lines = observations_3().split("\n")
    at = [k for k, line in enumerate(lines) if line.startswith("G05")][1]
    good = lines[at]
    for bad in (good.replace(".", "x", 1), good[:12], "Z" + good[1:], lines[at + 1]):
        lines[at] = bad
        assert refused(tmp_path, "\n".join(lines)).line in (at + 1, at + 2)
        found = read(tmp_path, "\n".join(lines), lenient=True)
        whole = read(tmp_path, observations_3())
        assert found.time.size == whole.time.size
        assert np.isnan(found.values["C1C"][1, found.satellites.index("G05")])
        rest = [k for k, name in enumerate(whole.satellites) if name != "G05"]
        np.testing.assert_array_equal(found.values["C1C"][:, rest], whole.values["C1C"][:, rest])
        assert found.left_out[0].startswith("1 satellites left out; the first: ")


def test_a_lost_epoch_line_costs_one_epoch(tmp_path: Path) -> None:
    lines = observations_3().split("\n")
    at = [k for k, line in enumerate(lines) if line.startswith(">")][1]
    lines[at] = "> 2018 13 45 12 00  1.0000000  0  3"
    assert "invalid time" in refused(tmp_path, "\n".join(lines)).message
    found = read(tmp_path, "\n".join(lines), lenient=True)
    assert found.time.size == 1
    assert found.left_out[0].startswith("1 epochs left out; the first: ")


def test_a_damaged_header_is_refused_by_the_lenient_too(tmp_path: Path) -> None:
    for text in (
        observations_3().replace("G    4 C1C L1C D1C S1C", "G    5 C1C L1C D1C S1C"),
        observations_3().replace("G    4 C1C L1C D1C S1C", "G    4 C1C L1C D1C C1C"),
        observations_3(extra=[labelled("G   50", "SYS / SCALE FACTOR")]),
        observations_3()[:300],
    ):
        (tmp_path / "obs").write_text(text)
        with pytest.raises(FileError):
            read_obs(tmp_path / "obs", lenient=True)


def test_nothing_whole_is_refused_by_the_lenient_too(tmp_path: Path) -> None:
    text = observations_3()
    (tmp_path / "obs").write_text(text[: text.index(">") + 20])
    with pytest.raises(FileError, match="no epoch"):
        read_obs(tmp_path / "obs", lenient=True)


@pytest.mark.parametrize("version", ["3.04", "4.00"])
def test_one_bad_message_costs_one_message(version: str, tmp_path: Path) -> None:
    text = navigation_3(UTC) if version == "3.04" else made_4()
    path = tmp_path / "nav"
    path.write_text(text)
    whole = read_nav(path)
    lines = text.split("\n")
    at = next(k for k, line in enumerate(lines) if line.startswith("G02"))
    lines[at + 2] = lines[at + 2].replace(".", "!", 1)
    path.write_text("\n".join(lines))
    with pytest.raises(FileError) as caught:
        read_nav(path)
    assert caught.value.line == at + 3
    assert caught.value.salvageable
    found = read_nav(path, lenient=True)
    assert whole.gps is not None
    assert found.gps is not None
    assert found.gps.prn.tolist() == [p for p in whole.gps.prn.tolist() if p != 2]
    assert found.left_out[0].startswith("1 messages left out; the first: ")
    assert f"nav:{at + 3}:" in found.left_out[0]
    cut = text[: text.rindex("R03") + 100]
    path.write_text(cut)
    with pytest.raises(FileError, match=r"ends early|ends within"):
        read_nav(path)
    found = read_nav(path, lenient=True)
    assert found.glonass is not None
    assert found.glonass.slot.tolist() == [1, 2]
    assert found.left_out


def test_version_3_of_our_own_still_reads(tmp_path: Path) -> None:
    """The files that navsim writes, as they are and with blank lines after them."""
    text = navigation_3(UTC).rstrip("\n")
    for ending in ("", "\n", "\n\n  \n"):
        (tmp_path / "nav").write_text(text + ending)
        found = read_nav(tmp_path / "nav")
        assert found.gps is not None
        assert found.glonass is not None
        assert (found.gps.prn.size, found.glonass.slot.size) == (3, 3)


@pytest.mark.parametrize("version", ["3.04", "3.05"])
@pytest.mark.parametrize("lines_each", [4, 5])
def test_glonass_records_of_a_file_are_of_one_length(version: str, lines_each: int, tmp_path: Path) -> None:
    """Programs write the fifth line into files of 3.04, and leave it out of those of 3.05."""
    text = navigation_3(UTC).replace("3.04", version)
    if lines_each == 5:
        text = in_version_4(text, version, [])
        text = "\n".join(line for line in text.split("\n") if not line.startswith(">"))
    (tmp_path / "nav").write_text(text)
    found = read_nav(tmp_path / "nav")
    assert found.glonass is not None
    assert found.glonass.slot.tolist() == [1, 2, 3]
    lines = text.rstrip("\n").split("\n")
    (tmp_path / "nav").write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(FileError, match=f"ends early: it has {lines_each - 1} of {lines_each} lines"):
        read_nav(tmp_path / "nav")


@pytest.mark.parametrize("version", ["3.04", "4.00"])
@pytest.mark.parametrize("body", ["", "\n\n", "     nothing that begins with a satellite\n"])
def test_navigation_files_without_a_message(version: str, body: str, tmp_path: Path) -> None:
    """A header and no record: refused in words, strictly and leniently."""
    whole = navigation_3(UTC) if version == "3.04" else in_version_4(navigation_3(UTC), "4.00", [])
    head = whole[: whole.index("END OF HEADER")] + "END OF HEADER\n"
    (tmp_path / "nav").write_text(head + body)
    for lenient in (False, True):
        with pytest.raises(FileError):
            read_nav(tmp_path / "nav", lenient)
