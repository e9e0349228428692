"""Recordings as loggers leave them: NMEA with comments and wrappers, fixes without heights, damaged tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.formats.nmea import Assembler
from navsim.formats.recording import read_fixes, read_imu
from navsim.formats.text import FileError


def sentence(body: str) -> str:
    check = 0
    for character in body:
        check ^= ord(character)
    return f"${body}*{check:02X}"


def gga(k: int, height: str = "545.4", separation: str = "46.9", quality: str = "1") -> str:
    where = f"4807.03{k}0000,N,01131.0000000,E"
    return sentence(f"GPGGA,12351{k}.00,{where},{quality},08,0.9,{height},M,{separation},M,,")


def rmc(k: int) -> str:
    return sentence(f"GPRMC,12351{k}.00,A,4807.03{k}0000,N,01131.0000000,E,022.4,084.4,230394,,,A")


PLAIN = [line for k in range(8) for line in (gga(k), rmc(k))]
WRAPPED = {
    "comments first": ["# a logger", "# of somebody", *["# more"] * 9, "", "started 2021-01-01", *PLAIN],
    "comments between": [x for line in PLAIN for x in ("# " + line[1:9], line)],
    "time before": [f"2021-01-01T00:00:{k:02d}.123 {line}" for k, line in enumerate(PLAIN)],
    "text and marks around": [f'{k};"{line}";rx' for k, line in enumerate(PLAIN)],
    "kind before, time after": [f"NMEA,{line},1616161616{k:03d}" for k, line in enumerate(PLAIN)],
    "two in a line": [PLAIN[k] + PLAIN[k + 1] for k in range(0, len(PLAIN), 2)],
    "bracketed": [f"[{k:8.3f}] <- {line}" for k, line in enumerate(PLAIN)],
}


def written(tmp_path: Path, lines: list[str]) -> Path:
    (tmp_path / "log").write_text("\r\n".join(lines) + "\r\n")
    return tmp_path / "log"


@pytest.mark.parametrize("kind", WRAPPED)
def test_nmea_as_loggers_write_it(kind: str, tmp_path: Path) -> None:
    plain, _ = read_fixes(written(tmp_path, PLAIN))
    found, dropped = read_fixes(written(tmp_path, WRAPPED[kind]))
    np.testing.assert_array_equal(found.time, plain.time)
    np.testing.assert_array_equal(found.llh, plain.llh)
    np.testing.assert_array_equal(found.velocity, plain.velocity)
    assert dropped.counts == ({"lines without an NMEA sentence": 1} if kind == "comments first" else {})


def test_broken_sentences_in_wrappers_are_counted(tmp_path: Path) -> None:
    lines = [f"12.5 {line}" for line in PLAIN]
    lines[4] = lines[4].replace("48", "49", 1)
    lines[6] = "12.5 $GPGGA,1235" + PLAIN[6]  # interrupted, and sent again
    lines[8] = lines[8][:-1]
    found, dropped = read_fixes(written(tmp_path, lines))
    assert dropped.counts["corrupt NMEA sentences"] == 3
    assert found.time.size == 6


def test_fixes_without_a_height_are_counted_apart(tmp_path: Path) -> None:
    lines = list(PLAIN)
    lines[4], lines[8] = gga(2, height=""), gga(4, height="", quality="2")
    lines[10] = gga(5, height="", quality="0")
    del lines[12]  # of this epoch RMC alone is there
    found, dropped = read_fixes(written(tmp_path, lines))
    assert found.time.size == 4
    assert np.all(found.llh[:, 2] == 545.4 + 46.9)
    assert dropped.counts == {
        "NMEA fixes without a height (no GGA or GNS, or none in it)": 3,
        "NMEA epochs without a fix": 1,
    }
    none = [gga(k, height="") for k in range(8)]
    with pytest.raises(FileError, match="no NMEA fix with a height in 9 lines: 8 NMEA fixes without a height"):
        read_fixes(written(tmp_path, none))
    with pytest.raises(FileError, match="8 NMEA fixes without a height"):
        read_fixes(written(tmp_path, [rmc(k) for k in range(8)]))


def test_heights_without_a_separation_are_said(tmp_path: Path) -> None:
    lines = [gga(k, separation="") for k in range(8)]
    found, dropped = read_fixes(written(tmp_path, lines))
    assert np.all(found.llh[:, 2] == 545.4)
    (reason,) = dropped.counts
    assert dropped.counts[reason] == 8
    assert "without a geoid separation" in reason
    # one that some sentences lack is that of the sentence before: no step of the height
    lines = [gga(k, separation="" if k in (3, 4) else "15.0") for k in range(8)]
    found, dropped = read_fixes(written(tmp_path, lines))
    np.testing.assert_allclose(found.llh[:, 2], 560.4)
    assert not dropped.counts


@pytest.mark.parametrize(("velocity", "left"), [("20,1,0", 3), ("20,1,", 3), ("0,0,0", 3), ("0,0,", 4), (",,", 4)])
def test_fixes_that_a_receiver_repeats_are_left_out(velocity: str, left: int, tmp_path: Path) -> None:
    """Also without a vertical velocity; of a standing aircraft such fixes may be new ones."""
    rows = [f"{t},56.0000{place},37.0,100,{velocity}" for t, place in enumerate((1, 2, 2, 3))]
    (tmp_path / "f.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s", *rows]) + "\n")
    fixes, dropped = read_fixes(tmp_path / "f.csv")
    assert fixes.time.size == left
    assert dropped.counts.get("repeated fixes", 0) == 4 - left


def test_a_live_stream_gives_the_same_rows() -> None:
    """The assembler that live runs feed is the one of files."""
    plain, wrapped = Assembler(), Assembler()
    rows = [row for line in PLAIN for row in plain.feed(line)]
    same = [row for line in WRAPPED["time before"] for row in wrapped.feed(line)]
    np.testing.assert_array_equal(rows, same)
    assert len(rows) == 7
    assert not wrapped.corrupt + wrapped.foreign


# --- tables

IMU = ["t_s,gx_rad_s,gy_rad_s,gz_rad_s,ax_m_s2,ay_m_s2,az_m_s2"] + [
    f"{0.02 * k:.2f},0.01,-0.02,0.03,0.1,0.2,-9.8" for k in range(30)
]
GNSS = ["t_s,lat_deg,lon_deg,h_m,vn_m_s,ve_m_s,vd_m_s"] + [f"{k}.0,56.000{k},37.0,100.0,10.0,0.5,0.1" for k in range(8)]


@pytest.mark.parametrize(
    "bad", ["0.06,0.01,nonsense,0.03,0.1,0.2,-9.8", "0.06,0.01,-0.0", "0.06,900,0,0,0,0,-9.8", ",,,,,,"]
)
def test_one_bad_row_of_a_table(bad: str, tmp_path: Path) -> None:
    lines = [*IMU[:4], bad, *IMU[5:]]
    path = written(tmp_path, lines)
    with pytest.raises(FileError) as caught:
        read_imu(path)
    assert caught.value.line == 5
    assert caught.value.salvageable
    samples, dropped = read_imu(path, lenient=True)
    assert samples.time.size == 29
    (said,) = dropped.reasons()
    assert said.startswith("1 rows left out; the first: ")
    assert "log:5:" in said


def test_a_table_cut_at_its_end(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_text("\n".join(GNSS)[:-12])
    with pytest.raises(FileError, match="the header 7") as caught:
        read_fixes(path)
    assert caught.value.line == 9
    found, dropped = read_fixes(path, lenient=True)
    assert found.time.size == 7
    assert sum(dropped.counts.values()) == 1
    path.write_text(GNSS[0][:-3] + "\n" + "\n".join(GNSS[1:]))
    with pytest.raises(FileError, match="the header lacks vd_m_s"):
        read_fixes(path, lenient=True)


def test_tables_of_which_no_row_is_left(tmp_path: Path) -> None:
    """However the rows went, it ends in words that say where."""
    few = [GNSS[0] + ",nsat", *(f"{line},2" for line in GNSS[1:])]
    with pytest.raises(FileError, match="only 0 usable fixes; 8 fixes with fewer than 4 satellites"):
        read_fixes(written(tmp_path, few))
    fast = [IMU[0], *(line.replace("0.01,-0.02", "171.9,-0.02") for line in IMU[1:])]
    with pytest.raises(FileError, match=r"only 0 usable samples; 30 rows left out; the first: .*gx_rad_s is 171\.9"):
        read_imu(written(tmp_path, fast), lenient=True)
    silent = [IMU[0], *(line.split(",")[0] + ",0" * 6 for line in IMU[1:])]
    with pytest.raises(FileError, match="only 0 usable samples; 30 samples that are all zero"):
        read_imu(written(tmp_path, silent))
    far = [GNSS[0], *(line.replace("56.", "156.") for line in GNSS[1:])]
    with pytest.raises(FileError, match="only 0 usable fixes; 8 rows left out"):
        read_fixes(written(tmp_path, far), lenient=True)


def test_cells_no_table_has(tmp_path: Path) -> None:
    """Longer than the csv module reads, and numbers as only Python writes them."""
    path = tmp_path / "log"
    for cell, said in (("9" * 200_000, "field larger"), ("0.1_0", "expected a number for gx_rad_s, found '0.1_0'")):
        lines = [*IMU]
        lines[4] = ",".join([lines[4].split(",")[0], cell, *lines[4].split(",")[2:]])
        path.write_text("\n".join(lines))
        with pytest.raises(FileError, match=said) as caught:
            read_imu(path)
        assert caught.value.line == 5
