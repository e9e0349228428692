"""Every reader either reads or refuses with a file and a line; none hangs, crashes or passes wrong numbers on.

Whole files made here are cut, garbled and shuffled by hypothesis; with ../shared the real files are too. What is still
read must be finite or nan where nothing stood, and within the physical limits that the readers promise.
"""

from __future__ import annotations

import bz2
import functools
import gzip
import io
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navsim.formats import rinex_write
from navsim.formats.almanac import AlmanacFile, read_almanac
from navsim.formats.recording import read_fixes, read_headings, read_imu
from navsim.formats.rinex_nav import read_nav
from navsim.formats.rinex_obs import read_obs
from navsim.formats.sp3 import read_sp3
from navsim.formats.text import FileError
from navsim.gnss import timescales
from navsim.gnss.constellations import glonass, glonass_broadcast, gps
from navsim.gnss.constellations.systems import GPS
from tests.rinex import in_version_4, labelled, navigation_3, observations_2, observations_3

UTC = timescales.posix(2018, 9, 13, 12)
NAMES = ("G01", "G02", "G03", "R01", "R02")


def nav_text() -> str:
    elements = gps.nominal(UTC).records.take(np.arange(3))
    vectors = glonass_broadcast.sent_by(glonass.Glonass24Slots(), UTC, UTC).records.take(np.arange(3))
    lines = rinex_write.navigation_lines(
        {GPS: elements}, vectors, ["fuzz"], "made", at=float(elements.toe[0]), klobuchar=([1e-8] * 4, [1e5] * 4)
    )
    return "\n".join(lines) + "\n"


def obs_text() -> str:
    values = np.stack([np.full((4, 5), 2.2e7), np.full((4, 5), -1234.5), np.full((4, 5), 45.0)])
    values[:, 1, 2] = np.nan
    epochs = rinex_write.Epochs(
        float(timescales.gps_from_utc(UTC)), np.arange(4.0), NAMES, values, np.array([2.8e6, 2.1e6, 5.2e6]),
        {"R01": 1, "R02": -4}, 1.0,
    )  # fmt: skip
    return "\n".join(rinex_write.observation_lines(epochs, "fuzz", ["fuzz"], "made")) + "\n"


def obs2_text() -> str:
    head = [
        f"{'     2.11           OBSERVATION DATA    M (MIXED)':60s}RINEX VERSION / TYPE",
        f"{'     3    C1    D1    S1':60s}# / TYPES OF OBSERV",
        f"{'  2018     9    13    12     0    0.0000000     GPS':60s}TIME OF FIRST OBS",
        f"{'':60s}END OF HEADER",
    ]
    body = []
    for k in range(3):
        body.append(f" 18  9 13 12  0 {k:2d}.0000000  0  2G01R02")
        body += [f"{2.2e7:14.3f}  {-1234.5:14.3f}  {45.0:14.3f}"] * 2
    return "\n".join([*head, *body]) + "\n"


def sp3_text() -> str:
    head = ["#cP2018  9 13 12  0  0.00000000       2 TRACK IGb14 FIT TEST", "## 2018 0.0 900.0 58374 0.0",
            "+    2   G01R02" + "  0" * 15, "%c M  cc GPS ccc cccc"]  # fmt: skip
    body = []
    for k in range(2):
        body.append(f"*  2018  9 13 12 {15 * k:2d}  0.00000000")
        for name, *numbers in (("G01", 15e3, 12e3, 18e3, 12.5), ("R02", -9e3, 20e3, 12e3, 999999.999999)):
            body.append(f"P{name}" + "".join(f"{x:14.6f}" for x in numbers))
    return "\n".join([*head, *body, "EOF"]) + "\n"


YUMA = """******** Week 866 almanac for PRN-01 ********
ID:                         01
Health:                     000
Eccentricity:               0.5221366882E-002
Time of Applicability(s):  589824.0000
Orbital Inclination(rad):   0.9637857480
Rate of Right Ascen(r/s):  -0.7897471819E-008
SQRT(A)  (m 1/2):           5153.602051
Right Ascen at Week(rad):  -0.1159458779E+001
Argument of Perigee(rad):   0.451712027
Mean Anom(rad):            -0.2105941778E+001
Af0(s):                     0.1621246338E-004
Af1(s/s):                   0.0000000000E+000
week:                        866
"""
SEM = """1  CURRENT.ALM
 862 319488

1
63
0
 5.10072708129883E-03  6.84547424316406E-03 -2.48837750405073E-09
 5.15360253906250E+03 -2.08778738975525E-01  1.46086812019348E-01
 4.55284833908081E-01  1.33514404296875E-05  0.00000000000000E+00
0
11
"""
AGL = """13 09 2018    3600
 1   1  1  13 09 2018  0.955206250E+04  0.000000000E+00  0.000000000E+00 -0.305175781E-04
-0.9923382E+00  0.6754875E-02 -0.2874756E-01  0.4005432E-03 -0.2656180E+04  0.8544922E-03
"""
TLE = """GPS BIIR-2  (PRN 13)
1 00005U 58002B   00179.78495062  .00000023  00000-0  28098-4 0  4753
2 00005  34.2682 348.7242 1859667 331.7664  19.3264 10.82419157413667
"""
IMU = "t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2\n" + "".join(
    f"{0.02 * k:.2f},0.01,-0.02,0.03,0.1,0.2,-9.8\n" for k in range(15)
)
GNSS = "t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s\n" + "".join(
    f"{k}.0,56.{k},37.0,100.0,10.0,0.5,{'' if k % 2 else '0.1'}\n" for k in range(8)
)


HEADING = "t_s,heading_deg,sigma_heading_deg\n" + "".join(f"{k}.0,{20 + k}.5,{k % 2 or ''}\n" for k in range(8))


def sentence(body: str) -> str:
    check = 0
    for character in body:
        check ^= ord(character)
    return f"${body}*{check:02X}\r\n"


NMEA = "".join(
    sentence(f"GPGGA,12351{k}.00,4807.03{k}0000,N,01131.0000000,E,1,08,0.9,545.400,M,46.900,M,,")
    + sentence(f"GPRMC,12351{k}.00,A,4807.03{k}0000,N,01131.0000000,E,022.4,084.4,230394,,,A")
    for k in range(6)
)


def zipped(data: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("file", data)
    return out.getvalue()


def almanac(path: Path) -> Any:
    return read_almanac(path, UTC)


def headings(path: Path, lenient: bool = False) -> Any:
    *columns, dropped = read_headings(path, lenient, {}, "s")
    return np.column_stack(columns), dropped


ION = """> ION G25 LNAV
    2018 09 13 11 33 54 2.514570951462e-08 1.490116119385e-08-1.192092895508e-07
    -5.960464477539e-08 1.331200000000e+05-1.638400000000e+04-2.621440000000e+05
     1.966080000000e+05"""
STO = """> STO R   FDMA
    2018 09 13 00 00 00 GLGP
     2.809660000000e+05-4.470348358154e-08 0.000000000000e+00 0.000000000000e+00"""
LOGGED = "# a logger\n# and its remarks\n" + "".join(
    f"12:35:1{k % 10} {line}\n" for k, line in enumerate(NMEA.split("\r\n"))
)


READERS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "nav": (read_nav, nav_text()),
    "nav4": (read_nav, in_version_4(navigation_3(UTC), "4.02", [*ION.split("\n"), *STO.split("\n")])),
    "obs": (read_obs, obs_text()),
    "scaled": (read_obs, observations_3(extra=[labelled("G   10   1 C1C", "SYS / SCALE FACTOR")])),
    "obs2": (read_obs, obs2_text()),
    "blank": (read_obs, observations_2(2.11, types=7, blank_from=0)),
    "sp3": (read_sp3, sp3_text()),
    "yuma": (almanac, YUMA),
    "sem": (almanac, SEM),
    "agl": (almanac, AGL),
    "tle": (almanac, TLE),
    "imu": (read_imu, IMU),
    "gnss": (read_fixes, GNSS),
    "heading": (headings, HEADING),
    "nmea": (read_fixes, NMEA),
    "logged": (read_fixes, LOGGED),
}
LENIENT = {name for name, (reader, _) in READERS.items() if reader is not almanac}
"""Readers that can leave damaged parts out."""


def tables(found: Any) -> Iterator[np.ndarray]:
    """The tables of numbers in what was read, however deep."""
    if isinstance(found, np.ndarray):
        if found.dtype.kind == "f":
            yield found
    elif isinstance(found, dict):
        for inner in found.values():
            yield from tables(inner)
    elif hasattr(found, "__dict__"):
        yield from tables(vars(found))


def sane(found: Any) -> None:
    """What was read holds no infinities, and satellites where satellites can be."""
    if isinstance(found, AlmanacFile):
        assert found.constellations or found.not_used or found.untitled
        for constellation in found.constellations:
            sane(constellation)
        return
    if isinstance(found, tuple):
        found = found[0]
    numbers = list(tables(found))
    assert numbers
    assert not any(np.isinf(table).any() for table in numbers)
    if isinstance(found, gps.KeplerianEphemerides | glonass.GlonassAlmanac):
        radius = np.linalg.norm(found.state(timescales.gps_from_utc(np.array([UTC])))[0], axis=2)
        assert np.all(np.isnan(radius) | ((radius > 1.2e7) & (radius < 8e7)))


def attempt(reader: Callable[[Path], Any], path: Path) -> bool:
    """Whether the file was read; if not, the refusal names it."""
    refusal = None
    try:
        sane(reader(path))
    except FileError as error:
        refusal = error
    if refusal is not None:
        assert str(path) in str(refusal)
        assert refusal.message
        assert refusal.line >= 0
    return refusal is None


def attempt_both(name: str, path: Path) -> None:
    """As `attempt`; a lenient reader leaves out nothing of what a strict one takes."""
    reader = READERS[name][0]
    read = attempt(reader, path)
    if name in LENIENT:
        leniently = functools.partial(reader, lenient=True)
        if not read:
            attempt(leniently, path)
        else:
            strict, lenient = reader(path), leniently(path)
            if isinstance(strict, tuple):
                read_by_lenient = [reason for reason in strict[1].counts if "write `skip_bad_records: true`" in reason]
                if read_by_lenient:  # what of them makes no sense is then counted as corrupt, or as of another kind
                    assert sum(lenient[1].counts.values()) <= sum(strict[1].counts.values())
                else:
                    assert strict[1].counts == lenient[1].counts
            else:
                assert strict.left_out == lenient.left_out


@pytest.mark.parametrize("name", READERS)
def test_the_whole_file_is_read(name: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text(READERS[name][1])
    assert attempt(READERS[name][0], path)
    attempt_both(name, path)


@st.composite
def damage(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    """Cut, overwrite, drop or double lines, or insert rubbish."""
    kind = draw(st.sampled_from(["cut", "overwrite", "drop", "double", "insert", "swap"]))
    where, more = draw(st.floats(0.0, 1.0)), draw(st.floats(0.0, 1.0))
    rubbish = draw(st.binary(min_size=1, max_size=12) | st.text("0123456789.-+eED GR*,\n", min_size=1).map(str.encode))

    def apply(data: bytes) -> bytes:
        at = int(where * (len(data) - 1))
        lines = data.split(b"\n")
        i, j = int(where * (len(lines) - 1)), int(more * (len(lines) - 1))
        if kind == "cut":
            return data[:at]
        if kind == "overwrite":
            return data[:at] + rubbish + data[at + len(rubbish) :]
        if kind == "insert":
            return data[:at] + rubbish + data[at:]
        if kind == "drop":
            del lines[i]
        elif kind == "double":
            lines.insert(i, lines[i])
        else:
            lines[i], lines[j] = lines[j], lines[i]
        return b"\n".join(lines)

    return apply


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(harm=st.lists(damage(), min_size=1, max_size=3))
def test_a_damaged_file_is_read_or_refused(name: str, harm: list[Callable[[bytes], bytes]], tmp_path: Path) -> None:
    data = READERS[name][1].encode()
    for one in harm:
        data = one(data)
    path = tmp_path / "file"
    path.write_bytes(data)
    attempt_both(name, path)


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=400))
def test_rubbish_is_refused(name: str, data: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(data)
    attempt_both(name, path)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, zipped])
@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(harm=st.lists(damage(), min_size=1, max_size=2))
def test_a_damaged_packed_file_is_read_or_refused(
    pack: Callable[[bytes], bytes], harm: list[Callable[[bytes], bytes]], tmp_path: Path
) -> None:
    data = pack(obs_text().encode())
    for one in harm:
        data = one(data)
    path = tmp_path / "file"
    path.write_bytes(data)
    attempt(read_obs, path)
    attempt(functools.partial(read_obs, lenient=True), path)


REAL = {
    "esbc_2020177/ESBC00DNK_R_20201770000_01D_MN.rnx.gz": read_nav,
    "esbc_2020177/ESBC_2020177_GR_60S.rnx.gz": read_obs,
    "esbc_2020177/GRG0MGXFIN_20201770000_01D_15M_ORB.SP3.gz": read_sp3,
    "almanacs/gps_yuma_20160331.alm": almanac,
    "almanacs/gps_sem_current.al3": almanac,
    "almanacs/MCCJ_180913.agp": almanac,
    "almanacs/MCCJ_180913.agl": almanac,
    "fw_thor75/gnss.csv": read_fixes,
}


@pytest.mark.parametrize("name", REAL)
def test_real_files_cut_and_garbled(name: str, shared: Path, tmp_path: Path) -> None:
    """Sixteen cuts and sixteen overwritten places of each real file, a long one shortened first."""
    reader = REAL[name]
    data = (shared / "data" / name).read_bytes()
    data = gzip.decompress(data) if name.endswith(".gz") else data
    if not name.endswith("SP3.gz"):
        data = b"\n".join(data.split(b"\n")[:3000])
    rng = np.random.default_rng(1)
    path = tmp_path / Path(name).name.removesuffix(".gz")
    for at in rng.integers(1, len(data), 16):
        path.write_bytes(data[:at])
        attempt(reader, path)
        garbled = bytearray(data)
        garbled[at : at + 6] = bytes(rng.integers(32, 127, 6, dtype=np.uint8))
        path.write_bytes(bytes(garbled))
        attempt(reader, path)


def test_digits_of_other_alphabets_are_no_digits(tmp_path: Path) -> None:
    """A superscript one counts as a digit for Python, and is none; hypothesis found it in a checksum."""
    path = tmp_path / "file"
    path.write_bytes(TLE.replace("00179.784", "0017\xb9.784").encode("latin-1"))
    with pytest.raises(FileError, match="checksum"):
        almanac(path)
    path.write_bytes(obs_text().replace("G02", "G\xb92", 1).encode("latin-1"))
    with pytest.raises(FileError, match="expected one of the header's satellites"):
        read_obs(path)
