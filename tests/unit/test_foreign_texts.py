"""Text as other programs, spreadsheets and editors write it: every reader gives the numbers that stand there."""

from __future__ import annotations

import codecs
import gzip
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from navsim.formats import conventions, rinex_write
from navsim.formats.horizon import read_horizon
from navsim.formats.recording import read_fixes, read_headings, read_imu, read_track
from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import read_obs
from navsim.formats.sp3 import read_sp3
from navsim.formats.text import FileError, read_lines
from navsim.gnss.constellations import gps
from navsim.gnss.constellations.systems import GALILEO, GPS, SYSTEMS
from navsim.scenario_files.source import InputError, load
from tests.product import test_fuzz_readers as files
from tests.rinex import observations_2, observations_3

TABLE = "t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s\n" + "".join(
    f"{k}.6,56.0001373{k},37.00000846,150.50{k},30.089,-1.669,-0.206\n" for k in range(8)
)
TRACK = "t_s,lat_deg,lon_deg,h_m\n" + "".join(f"{k}.5,56.{k},37.0,100.5\n" for k in range(8))
HORIZON = "azimuth_deg,elevation_deg\n0.5,5\n90,6.25\n"
READERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "fixes": (read_fixes, TABLE),
    "imu": (read_imu, files.IMU),
    "track": (read_track, TRACK),
    "horizon": (read_horizon, HORIZON),
    "nmea": (read_fixes, files.NMEA.replace("\r\n", "\n")),
    "nav": (read_nav, files.nav_text()),
    "obs": (read_obs, files.obs_text()),
    "obs2": (read_obs, files.obs2_text()),
    "sp3": (read_sp3, files.sp3_text()),
    "yuma": (files.almanac, files.YUMA),
    "sem": (files.almanac, files.SEM),
    "agl": (files.almanac, files.AGL),
    "tle": (files.almanac, files.TLE),
    "scenario": (lambda path: load(path).data, "kind: landing\nversion: 1\nsky: {mask_deg: 5}\n"),
}
ENDINGS: dict[str, Callable[[str], bytes]] = {
    "UTF-8 mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "two marks": lambda text: 2 * codecs.BOM_UTF8 + text.encode(),
    "UTF-16": lambda text: codecs.BOM_UTF16_LE + text.encode("utf-16-le"),
    "UTF-16, big-endian": lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
    "UTF-32": lambda text: codecs.BOM_UTF32_LE + text.encode("utf-32-le"),
    "CRLF": lambda text: text.replace("\n", "\r\n").encode(),
    "CR": lambda text: text.replace("\n", "\r").encode(),
    "Ctrl-Z": lambda text: text.encode() + b"\x1a",
    "Ctrl-Z on a line": lambda text: text.replace("\n", "\r\n").encode() + b"\x1a\r\n",
    "Ctrl-Z, records of 128 bytes": lambda text: text.encode() + b"\x1a" * 100,
    "zero bytes": lambda text: text.encode() + bytes(4096),
    "gzip with a mark inside": lambda text: gzip.compress(codecs.BOM_UTF8 + text.encode() + b"\x1a"),
}


def same(a: object, b: object) -> bool:
    """Whether two results of a reader hold the same numbers."""
    np.testing.assert_equal(plain(a), plain(b))
    return True


def plain(value: object) -> object:
    if isinstance(value, str | int | float | np.ndarray | None):
        return value
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if type(value).__name__ == "Satrec":
        return value.jdsatepoch, value.inclo, value.mo
    return plain(vars(value)) if hasattr(value, "__dict__") else str(value)


@pytest.mark.parametrize("kind", READERS)
def test_every_reader_takes_what_stands_around_a_text(kind: str, tmp_path: Path) -> None:
    reader, text = READERS[kind]
    path = tmp_path / "file"
    path.write_text(text)
    due = reader(path)
    for ending, change in ENDINGS.items():
        if kind == "scenario" and "gzip" in ending:
            continue
        path.write_bytes(change(text))
        assert same(reader(path), due), ending


def test_files_put_together_keep_no_marks(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"a\n" + codecs.BOM_UTF8 + b"b\n")
    assert read_lines(path) == ["a", "b", ""]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("a\n1\n".encode("utf-16-le"), r"seems to be UTF-16 \(little-endian\) without a byte order mark"),
        ("a\n1\n".encode("utf-16-be"), r"seems to be UTF-16 \(big-endian\) without a byte order mark"),
        (codecs.BOM_UTF16_LE + b"\x00\xd8a\x00", "begins like UTF-16, but is not"),
        (b"a\n\x00b\n", "file:2: not a text file"),
        (bytes(10), "file:1: not a text file: it has zero bytes only"),
    ],
)
def test_what_is_no_text_is_named(content: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(FileError, match=said):
        read_lines(path)


def test_text_is_utf_8_or_latin_1_line_by_line(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes("Höhe\n".encode() + "Höhe\n".encode("latin-1") + "1\u00a0000\n".encode() + b"1\xa0000\n")
    assert read_lines(path) == ["Höhe", "Höhe", "1 000", "1 000", ""]


def test_signs_and_blanks_of_editors_in_a_scenario(tmp_path: Path) -> None:
    """Pasted from a page or a word processor: blanks that do not break, a true minus."""
    path = tmp_path / "s.yaml"
    path.write_text("sky:\n\u00a0\u00a0mask_deg:\u00a0\u22125.5\nseed: \u20132\ntitle: '\u22125'\n", encoding="utf-8")
    assert load(path).data == {"sky": {"mask_deg": -5.5}, "seed": -2, "title": "\u22125"}
    path.write_bytes(b"title: caf\xe9\n")
    with pytest.raises(InputError, match="byte 10 is not UTF-8"):
        load(path)


# --- RINEX

NAVIGATION = files.nav_text().replace("D+", "E+").replace("D-", "E-")


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("E+", "e+").replace("E-", "e-"),
        lambda text: text.replace("E+", "d+").replace("E-", "d-"),
        lambda text: "\n".join(f"{line:80s}" for line in text.split("\n")[:-1]) + "\n",
        lambda text: text + "\n\n  \n",
    ],
)
def test_messages_as_programs_write_them(change: Callable[[str], str], tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text(NAVIGATION)
    due = read_nav(path)
    assert change(NAVIGATION) != NAVIGATION
    path.write_text(change(NAVIGATION))
    assert same(read_nav(path), due)


def with_field(text: str, satellite: str, line: int, place: int, field: str) -> str:
    """Messages of version 3 with another field on a line of the first record of a satellite."""
    lines = text.split("\n")
    at = next(k for k, one in enumerate(lines) if one.startswith(satellite)) + line
    lines[at] = f"{lines[at][: 4 + 19 * place]}{field:19s}{lines[at][23 + 19 * place :]}"
    return "\n".join(lines)


@pytest.mark.parametrize("field", ["", " 0.999999999999E+09"])
def test_a_group_delay_that_is_not_known(field: str, tmp_path: Path) -> None:
    """It is read as unknown, told, taken as none where a clock is asked for, and written as blank again."""
    path = tmp_path / "file"
    path.write_text(with_field(NAVIGATION, "G02", 6, 2, field))
    found = read_nav(path)
    assert found.gps is not None
    np.testing.assert_array_equal(np.isnan(found.gps.tgd), found.gps.prn == 2)
    (said,) = found.left_out
    assert said.startswith("1 LNAV messages with a blank group delay; navsim takes it as 0, so ranges of G02 may be")
    (constellation,) = (c for c in found.constellations() if c.system is GPS)
    assert np.isfinite(constellation.clock(found.gps.toe[:1])[0]).all()
    path.write_text("\n".join(rinex_write.navigation_lines({GPS: found.gps}, None, [], "made", at=found.gps.toe[0])))
    again = read_nav(path)
    assert again.gps is not None
    np.testing.assert_array_equal(again.gps.tgd, found.gps.tgd)
    assert again.left_out == found.left_out


def test_galileo_messages_need_the_group_delay_of_their_own_clock(tmp_path: Path) -> None:
    """That of E5b is blank in messages of F/NAV, as RINEX has it."""
    path = tmp_path / "file"
    elements = gps.nominal(files.UTC).records.take(np.arange(2))
    text = "\n".join(rinex_write.navigation_lines({GALILEO: elements}, None, [], "made", at=float(elements.toe[0])))
    fnav = with_field(with_field(text, "E02", 5, 1, f"{258.0:19.12E}"), "E02", 6, 2, f"{5e-9:19.12E}")
    path.write_text(with_field(fnav, "E02", 6, 3, ""))
    found = read_nav(path, systems=SYSTEMS)
    assert found.elements[GALILEO, "FNAV"].tgd == 5e-9
    assert not found.left_out
    path.write_text(with_field(with_field(text, "E02", 6, 3, ""), "E02", 6, 0, ""))
    found = read_nav(path, systems=SYSTEMS)
    np.testing.assert_array_equal(np.isnan(found.elements[GALILEO, "INAV"].tgd), [False, True])
    np.testing.assert_array_equal(found.elements[GALILEO, "INAV"].ura[1], -1.0)


@pytest.mark.parametrize(
    ("sources", "message", "said"),
    [
        (513, "INAV", ""), (516, "INAV", ""), (517, "INAV", ""), (1, "INAV", ""), (4, "INAV", ""),
        (258, "FNAV", ""), (2, "FNAV", ""), (256, "FNAV", ""),
        (263, "FNAV", "1 Galileo messages whose data sources, 263, name both kinds; the clock is F/NAV"),
        (519, "INAV", "1 Galileo messages whose data sources, 519, name both kinds; the clock is I/NAV"),
        (515, "INAV", "the clock is I/NAV"), (261, "FNAV", "the clock is F/NAV"),
        (3, None, "1 Galileo messages taken as I/NAV; the first: .*the data sources 3 name both I/NAV and F/NAV"),
        (0, None, "name neither I/NAV nor F/NAV"), (775, None, "bits 8 and 9 do not name the clock"),
    ],
)  # fmt: skip
def test_galileo_messages_by_their_data_sources(sources: int, message: str | None, said: str, tmp_path: Path) -> None:
    """Bits 8 and 9, whose clock it is, decide where signals of both kinds are named, as simulators write them; where
    they do not, the message is refused, or by a lenient reader taken as I/NAV."""
    path = tmp_path / "file"
    elements = gps.nominal(files.UTC).records.take(np.arange(1))
    lines = rinex_write.navigation_lines({GALILEO: elements}, None, [], "made", at=float(elements.toe[0]))
    text = with_field("\n".join(lines), "E01", 5, 1, f"{sources:19.12E}")
    path.write_text(with_field(text, "E01", 6, 2, f"{5e-9:19.12E}"))
    if message is None:
        with pytest.raises(FileError, match=said.partition("first: ")[2]) as caught:
            read_nav(path, systems=SYSTEMS)
        assert caught.value.salvageable
        assert caught.value.line == next(k for k, line in enumerate(lines, 1) if line.startswith("E01")) + 5
    found = read_nav(path, lenient=message is None, systems=SYSTEMS)
    assert list(found.elements) == [(GALILEO, message or "INAV")]
    assert found.elements[GALILEO, message or "INAV"].tgd[0] == (5e-9 if message == "FNAV" else elements.tgd[0])
    assert found.without_usual() == ({GALILEO: "FNAV"} if message == "FNAV" else {})
    assert re.search(said, "; ".join(found.left_out))
    assert len(found.left_out) == bool(said)


@pytest.mark.parametrize(("told", "seconds"), [("", 18), ("GPS", 18), ("GAL", 18), ("BDS", None), ("BDT", None)])
def test_leap_seconds_of_other_systems_do_not_tell_gps_less_utc(
    told: str, seconds: int | None, tmp_path: Path
) -> None:  # fmt: skip
    path = tmp_path / "file"
    lines = NAVIGATION.split("\n")
    (at,) = (k for k, line in enumerate(lines) if line[60:].startswith("LEAP SECONDS"))
    lines[at] = f"{f'    18    18  1929     7{told}':60s}LEAP SECONDS"
    path.write_text("\n".join(lines))
    assert read_nav(path).leap_seconds == seconds
    blank = f"{'':60s}LEAP SECONDS"
    lines[at:at] = [f"{'     4     4   573     7BDS':60s}LEAP SECONDS", blank]
    path.write_text("\n".join(lines))
    assert read_nav(path).leap_seconds == seconds


@pytest.mark.parametrize("flag", ["   ", " 0 ", "0  ", "  0"])
def test_an_epoch_flag_that_is_blank_or_too_far_left(flag: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text(observations_3())
    due = read_obs(path)
    path.write_text(observations_3().replace(".0000000  0", f".0000000{flag}"))
    assert same(read_obs(path), due)
    path.write_text(observations_3().replace(".0000000  0", ".0000000 4 "))  # an event is none for being displaced
    with pytest.raises(FileError):
        read_obs(path)


def test_satellites_without_a_letter_are_of_gps_in_mixed_files(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text(observations_2(2.11))
    due = read_obs(path)
    assert "M (MIXED)" in observations_2(2.11)
    path.write_text(observations_2(2.11).replace("G05G12", "  5 12"))
    assert same(read_obs(path), due)


CASES = {
    "nav-bom/a.rnx": read_nav, "nav-blank-tgd/a.rnx": read_nav, "nav-leap-bds/a.rnx": read_nav,
    "rinex-bom/a.obs": read_obs, "rtkconv-epoch-column/a.obs": read_obs, "ctrlz/a.10o": read_obs,
    "bom-csv/gnss_bom.csv": read_fixes, "bom-csv/imu_bom.csv": read_imu, "csv-quoted/gnss.csv": read_fixes,
    "csv-semicolon/gnss.csv": read_fixes, "csv-tab/gnss.csv": read_fixes, "horizon-bom/h.csv": read_horizon,
}  # fmt: skip


def test_cases_of_others(shared: Path) -> None:
    found = {name: reader(shared / "cases" / name) for name, reader in CASES.items()}
    fixes = found["bom-csv/gnss_bom.csv"]
    for name in ("csv-quoted/gnss.csv", "csv-semicolon/gnss.csv", "csv-tab/gnss.csv"):
        assert same(found[name][0], fixes[0]), name
    for name in ("nav-leap-bds/a.rnx", "nav-blank-tgd/a.rnx"):
        assert found[name].leap_seconds is None
    assert np.isnan(found["nav-blank-tgd/a.rnx"].gps.tgd).all()
    for name in ("rinex-bom/a.obs", "rtkconv-epoch-column/a.obs"):
        assert found[name].of("C1C")[0, found[name].satellites.index("G05")] == 22000000.123
    assert found["ctrlz/a.10o"].time.size == 3


# --- tables


def semicolons(text: str) -> str:
    return text.replace(",", ";").replace(".", ",")


WRITTEN: dict[str, Callable[[str], str]] = {
    "quoted": lambda text: "\n".join(",".join(f'"{c}"' for c in line.split(",")) for line in text.split("\n")[:-1]),
    "quoted names": lambda text: '"' + text.replace("\n", '"\n', 1).replace(",", '","', text.split("\n")[0].count(",")),
    "semicolons": lambda text: text.replace(",", ";"),
    "decimal commas": semicolons,
    "decimal commas, quoted": lambda text: "\n".join(
        ",".join(f'"{c.replace(".", ",")}"' for c in line.split(",")) for line in text.split("\n")[:-1]
    ),
    "Excel": lambda text: "sep=;\r\n" + semicolons(text).replace("\n", "\r\n") + ";;;;;;\r\n;;;;;;\r\n",
    "tabs": lambda text: text.replace(",", "\t"),
    "tabs and decimal commas": lambda text: text.replace(",", "\t").replace(".", ","),
    "bars": lambda text: text.replace(",", " | "),
    "blanks": lambda text: text.replace(",", "   "),
    "aligned": lambda text: "\n".join("".join(f"{c:>16}" for c in line.split(",")) for line in text.split("\n")[:-1]),
    "blanks around": lambda text: text.replace(",", " , "),
    "comments": lambda text: "# made by a logger\n\n" + text.replace("\n", "\n# a break\n", 1),
    "numpy.savetxt": lambda text: "# " + text,
    "a comma at the end": lambda text: text.replace("\n", ",\n"),
    "a comma at the end of rows": lambda text: text.replace("\n", ",\n").replace(",\n", "\n", 1),
    "minus signs": lambda text: text.replace("-", "\u2212"),
    "empty lines": lambda text: text.replace("\n", "\n\n") + "\n  \n",
    "capitals": lambda text: text.replace(text.split("\n")[0], text.split("\n")[0].upper()),
    "an index": lambda text: "\n".join(f"{k if k else ''},{line}" for k, line in enumerate(text.split("\n")[:-1])),
    "exponents": lambda text: text.replace("37.00000846", "3.700000846D+01").replace("0.206", "2.06e-1"),
}


@pytest.mark.parametrize("how", WRITTEN)
def test_tables_of_all_kinds_say_the_same(how: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    for reader, text in ((read_fixes, TABLE), (read_imu, files.IMU), (read_track, TRACK), (read_horizon, HORIZON)):
        path.write_text(text)
        due = reader(path)
        path.write_text(WRITTEN[how](text), encoding="utf-8")
        assert same(reader(path), due), reader


@pytest.mark.parametrize(
    "head",
    [
        "t_s [s],lat_deg [deg],lon_deg [°],h_m [m],vn_m_s [m/s],ve_m_s (m/s),vd_m_s",
        "t (s),lat (deg),Lon [degrees],h (m),vn (m/s),ve (m/sec),VD_M_S",
    ],
)
def test_units_in_brackets_of_the_header(head: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text(TABLE)
    due = read_fixes(path)
    path.write_text(TABLE.replace(TABLE.split("\n")[0], head), encoding="utf-8")
    assert same(read_fixes(path), due)
    imu = "t [s],gx [rad/s],gy [rad/s],gz [rad/s],ax [m/s^2],ay [m/s²],az [m/s**2]"
    path.write_text(files.IMU)
    samples = read_imu(path)
    path.write_text(files.IMU.replace(files.IMU.split("\n")[0], imu), encoding="utf-8")
    assert same(read_imu(path), samples)


@pytest.mark.parametrize(
    ("due", "there", "cure", "unit"),
    [
        ("h_m", "h_m [ft]", "height_unit: ft", 0.3048),
        ("h_m", "h (feet)", "height_unit: ft", 0.3048),
        ("lat_deg lon_deg", "lat [rad],Lon (radians)", "angle_unit: rad", 180.0 / np.pi),
        ("t_s", "t [ms]", "time_unit: ms", 1e-3),
        ("vd_m_s", "vd [fpm]", "vertical_speed_unit: ft/min", 0.3048 / 60.0),
    ],
)
def test_a_unit_in_brackets_that_is_not_the_declared_one(
    due: str, there: str, cure: str, unit: float, tmp_path: Path
) -> None:
    """A height in feet is never taken for metres: the message has the keys to write, which give the right number."""
    path = tmp_path / "file"
    names = dict(zip(due.split(), there.split(","), strict=True))
    head, *rows = (row.split(",") for row in TABLE.splitlines())
    for row in rows:
        row[:] = [repr(float(x) / unit) if name in names else x for name, x in zip(head, row, strict=True)]
    head = [names.get(name, name) for name in head]
    path.write_text("\n".join(map(",".join, [head, *rows])))
    columns = ", ".join(f'{name}: "{other}"' for name, other in names.items())
    with pytest.raises(FileError, match=re.escape(f"`gnss: {{columns: {{{columns}}}, {cure}}}`")):
        read_fixes(path)
    with pytest.raises(FileError, match=re.escape(f"; write gnss.{cure}")):
        read_fixes(path, convention=conventions.GnssConvention(columns=names))
    key, value = cure.split(": ")
    convention = conventions.GnssConvention(columns=names, **{key: value})
    read = read_fixes(path, convention=convention)[0]
    path.write_text(TABLE)
    expected = read_fixes(path)[0]
    for one, other in ((read.time, expected.time), (read.llh, expected.llh), (read.velocity, expected.velocity)):
        np.testing.assert_allclose(one, other, rtol=1e-12)


def test_units_in_brackets_of_samples_headings_and_accuracies(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text(files.IMU.replace("gx_rad_s", "rate x [deg/s]"))
    columns = {"gx_rad_s": "rate x [deg/s]"}
    with pytest.raises(FileError, match=re.escape("is in deg/s, but imu.gyro_unit is rad/s; write imu.gyro_unit: deg")):
        read_imu(path, convention=conventions.ImuConvention(columns=columns))
    read_imu(path, convention=conventions.ImuConvention(columns=columns, gyro_unit="deg/s"))
    path.write_text("t_s,yaw [rad]\n" + "".join(f"{k},{0.1 * k}\n" for k in range(5)))
    with pytest.raises(FileError, match=re.escape("yaw [rad] is in rad, but navsim takes it in deg; convert it")):
        read_headings(path, False, {"heading_deg": "yaw [rad]"}, "s")
    rows = TABLE.splitlines()
    path.write_text("\n".join([rows[0] + ",acc [mm]", *(row + ",900" for row in rows[1:])]))
    with pytest.raises(FileError, match=re.escape("acc [mm] is in mm, but navsim takes it in m; convert it")):
        read_fixes(path, convention=conventions.GnssConvention(columns={"sigma_horizontal_m": "acc [mm]"}))


@pytest.mark.parametrize("reader", [read_fixes, read_imu, read_track])
def test_a_table_of_two_recordings_is_refused(reader: Callable[[Path], object], tmp_path: Path) -> None:
    """Sorted by time, the rows of both would be one flight that jumps to and fro."""
    path = tmp_path / "file"
    text = {read_fixes: TABLE, read_imu: files.IMU, read_track: TRACK}[reader]
    head, *rows = [line.split(",") for line in text.splitlines()]

    def put(shift: float) -> None:
        moved = [[repr(float(row[0]) + shift), *row[1:]] for row in rows]
        path.write_text("\n".join(map(",".join, [head, *moved, *rows])))

    put(30.0)  # sorted
    reader(path)
    for shift, said in ((100.0, "two recordings"), (-1e5, "two recordings"), (604800.0, "add 604800 s to the times")):
        put(shift)
        with pytest.raises(FileError, match=said) as caught:
            reader(path)
        assert caught.value.line == 2 + len(rows)


def test_a_receiver_without_a_fix_may_have_no_time_either(tmp_path: Path) -> None:
    """Its placeholders at time 0 are no other recording than the fixes at times since 1970."""
    path = tmp_path / "file"
    head, *rows = [line.split(",") for line in TABLE.splitlines()]
    later = [[repr(1.7e9 + float(row[0])), *row[1:]] for row in rows]
    empty = [[f"0.{k}", "0", "0", "0", "0", "0", "0"] for k in range(3)]
    path.write_text("\n".join(map(",".join, [head, *empty, *later])))
    fixes, dropped = read_fixes(path)
    assert fixes.time[0] == float(later[0][0])
    assert dropped.counts["placeholders before the first fix"] == 3


def test_names_of_columns_that_are_not_ascii(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text(TABLE)
    due = read_fixes(path)
    convention = conventions.GnssConvention(columns={"h_m": "Höhe"})
    for encoding in ("utf-8", "utf-8-sig", "latin-1", "utf-16"):
        path.write_text(TABLE.replace("h_m", "Höhe"), encoding=encoding)
        assert same(read_fixes(path, convention=convention), due)


@pytest.mark.parametrize(
    ("change", "line", "said"),
    [
        (lambda text: text.replace("h_m", "h_m [ft]"), 1, "lacks h_m; the header has .*h_m .ft."),
        (lambda text: text.replace("h_m", "t_s"), 1, "several columns are called t_s"),
        (lambda text: text.split("\n", 1)[1], 1, "the table has no header"),
        (lambda text: text.replace("h_m", "alt"), 1, "the header lacks h_m"),
        # the first of several numbers would be taken for a cell each
        (lambda text: text.split("\n")[0] + "\n" + text.split("\n", 1)[1].replace(".", ","), 2,
         "the row has 14 cells, the header 7; if the decimals have commas, separate the cells by semicolons"),
        (lambda text: text.replace(",", ";").replace("150.503", "150,503"), 5,
         "decimal commas on line 5, points on line 2; write one kind"),
        (lambda text: text.replace(",", ";").replace("150.503", "1.150,503"), 5, "write one kind"),
    ],
)  # fmt: skip
def test_tables_that_may_mean_two_things_are_refused(
    change: Callable[[str], str], line: int, said: str, tmp_path: Path
) -> None:
    path = tmp_path / "file"
    path.write_text(change(TABLE))
    with pytest.raises(FileError, match=said) as caught:
        read_fixes(path)
    assert caught.value.line == line
