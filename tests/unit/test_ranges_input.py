"""Tables of `kind: ranges`: how they are read, and what the messages say of wrong ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navsim.ranging.recording import RangeLog, read_log
from navsim.ranging.scenario import RecordedRanges
from navsim.scenario_files.base import validated
from navsim.scenario_files.source import InputError, parse

NAMES = ("a", "b", "c", "d")
POSITIONS = np.array([[0.0, 0.0, 2.0], [40.0, 0.0, 3.0], [40.0, 30.0, 8.0], [0.0, 30.0, 5.0]])
TIME = 0.1 * np.arange(80)
TRUE = np.column_stack([5.0 + TIME, 12.0 + 0.5 * TIME, np.full(TIME.size, 1.0)])
SOURCES = "positions: [" + ", ".join(
    f"{{name: {name}, position_m: [{x:g}, {y:g}, {z:g}]}}" for name, (x, y, z) in zip(NAMES, POSITIONS, strict=True)
) + "]"  # fmt: skip


def table(range_scale: float = 1.0, head: str = "t_s,source,range_m") -> list[str]:
    """Rows of exact two-way ranges, one source after another."""
    which = np.arange(TIME.size) % 4
    distance = np.linalg.norm(TRUE - POSITIONS[which], axis=1) * range_scale
    return [head, *(f"{t:.1f},{NAMES[i]},{r:.4f}" for t, i, r in zip(TIME, which, distance, strict=True))]


def read(folder: Path, rows: list[str], ranges: str = "", sources: str = SOURCES, more: str = "") -> RangeLog:
    """The log of a file with these rows and keys."""
    (folder / "r.csv").write_text("\n".join(rows) + "\n")
    measurement = "" if "measurement" in ranges else "measurement: two_way, "
    text = f"kind: ranges\nversion: 1\nranges: {{{measurement}file: r.csv, {ranges}}}\nsources: {{{sources}}}\n{more}"
    document = parse(text, "x.yaml", folder)
    return read_log(validated(RecordedRanges, document), document)


def refusal(folder: Path, rows: list[str], ranges: str = "", sources: str = SOURCES, more: str = "") -> str:
    """The message of a refused file."""
    with pytest.raises(InputError) as caught:
        read(folder, rows, ranges, sources, more)
    return str(caught.value)


def test_units_and_names_of_columns(tmp_path: Path) -> None:
    plain = read(tmp_path, table())
    assert plain.sources.names == NAMES
    assert plain.time.size == TIME.size
    for unit, size in (("ft", 1 / 0.3048), ("cm", 100.0), ("ns", 1.0 / 0.299792458)):
        keys = f"columns: {{t_s: when, source: anchor, range_m: d}}, range_unit: {unit}"
        other = read(tmp_path, table(size, "when,anchor,d"), keys)
        np.testing.assert_allclose(other.range, plain.range, atol=1e-4)
        np.testing.assert_array_equal(other.source, plain.source)


def test_a_unit_in_brackets_and_two_recordings(tmp_path: Path) -> None:
    rows = table(1 / 0.3048, "t_s,source,d [ft]")
    said = "d [ft] is in ft, but ranges.range_unit is m; write ranges.range_unit: ft"
    assert said in refusal(tmp_path, rows, "columns: {range_m: 'd [ft]'}")
    other = read(tmp_path, rows, "columns: {range_m: 'd [ft]'}, range_unit: ft")
    np.testing.assert_allclose(other.range, read(tmp_path, table()).range, atol=1e-4)
    rows = table()
    later = [f"{float(t) + 100.0:.1f},{rest}" for t, rest in (row.split(",", 1) for row in rows[1:])]
    said = refusal(tmp_path, [rows[0], *later, *rows[1:]])
    assert "the time goes from 107.900 s to 0.000 s, so the file seems to have two recordings" in said


def test_a_column_for_each_source_and_geodetic_positions(tmp_path: Path) -> None:
    rows = ["time,p1,p2,p3,p4", *(f"{t:.1f},{-5.0 + t:.2f},{7.0:.1f},,{2.0}" for t in TIME)]
    places = ["id,lat,lon,h", "1,48.0,11.0,500", "2,48.01,11.0,510", "3,48.0,11.01,505", "4,48.01,11.02,500"]
    (tmp_path / "s.csv").write_text("\n".join(places))
    keys = "measurement: one_way, columns: {t_s: time}, source_columns: {p1: '1', p2: '2', p3: '3', p4: '4'}"
    sources = "file: s.csv, columns: {source: id, lat_deg: lat, lon_deg: lon, h_m: h}"
    with pytest.raises(InputError, match=r"3 sources .*needs 4"):
        read(tmp_path, rows, keys, sources)
    rows[3] = rows[3].replace(",,", ",3.5,")
    log = read(tmp_path, rows, keys, sources)
    assert log.time.size == 3 * TIME.size + 1
    east, north, up = log.sources.position.T
    assert north[1] - north[0] == pytest.approx(1112.0, abs=1.0)  # a hundredth of a degree of latitude at 48 degrees
    assert east[2] - east[0] == pytest.approx(745.6, abs=1.0)
    assert up[1] - up[0] == pytest.approx(10.0, abs=0.5)


def test_a_column_of_zeros_has_no_range(tmp_path: Path) -> None:
    """ArduPilot's BCN has D3 = 0 with three beacons; a zero among ranges stays one."""
    distance = np.linalg.norm(TRUE[:, None] - POSITIONS, axis=2) * [1.0, 1.0, 1.0, 0.0]
    distance[5, 0] = 0.0
    rows = ["t_s,D0,D1,D2,D3", *(",".join(f"{x:.4f}" for x in (t, *d)) for t, d in zip(TIME, distance, strict=True))]
    keys = "source_columns: {D0: a, D1: b, D2: c, D3: d}"
    log = read(tmp_path, rows, keys)
    assert log.sources.names == NAMES[:3]
    assert log.range.size == 3 * TIME.size
    assert log.warnings == ("no range is from d: a column of zeros has none",)
    zeros = [rows[0], *(f"{t:.1f},0,0,0,0" for t in TIME)]
    assert "all ranges are zero" in refusal(tmp_path, zeros, keys)


@pytest.mark.parametrize(
    ("rows", "ranges", "sources", "says"),
    [
        (table(1 / 0.3048), "", SOURCES, r"differ by .* m or more \(median\), .* apart: they would fit in ft. Check"),
        (table(1000.0), "", SOURCES, r"they would fit in mm"),
        (table(0.001), "", SOURCES, r"add up to .* m or less \(median\), but these are .* apart: they would fit in km"),
        (table(1e9), "", SOURCES, r"ranges are .* m long .*check ranges.range_unit"),
        (table(-1.0), "", SOURCES, r"100% of the two-way ranges are negative.*one_way"),
        (table()[:1] + table()[:0:-1], "", SOURCES, r"79 times of 80 in r.csv run backwards.*t_s"),
        ([table()[0], *(f"{r.split(',')[2]},{r.split(',')[1]},{r.split(',')[0]}" for r in table()[1:])], "", SOURCES,
         r"run backwards: is another column the time"),
        (table(), "", SOURCES.replace("name: d", "name: e"), r"line 5: no position is known of d; `sources` has a, b"),
        (table(head="t_s,source,r"), "", SOURCES, r"the header lacks range_m; the header has t_s, source, r"),
        (table(head="t_s,anchor,range_m"), "", SOURCES, r"lacks source; it has t_s, anchor, range_m"),
        ([r for r in table() if ",a," not in r and ",b," not in r], "", SOURCES, r"2 sources \(c, d\).*needs 3"),
        (table(), "", SOURCES.replace("[40, 30, 8]", "[40, 0, 3]"), r"b and c have the same position"),
        (table(), "colums: {}", SOURCES, r"did you mean 'columns'"),
        (table(), "range_unit: feet", SOURCES, r"ft"),
        (table(), "columns: {range: d}", SOURCES, r"'range' is no column; did you mean 'range_m'"),
    ],
)  # fmt: skip
def test_wrong_input_is_named(tmp_path: Path, rows: list[str], ranges: str, sources: str, says: str) -> None:
    import re

    message = refusal(tmp_path, rows, ranges, sources)
    assert re.search(says, message), message
    assert "x.yaml:" in message


def test_ranges_taken_at_different_places_are_not_compared(tmp_path: Path) -> None:
    """Exact ranges within 300 m, of two groups of sources 1 km apart that a straight flight passes one after the other.

    The medians of a and f add up to 313 m, but they were taken 1 km apart.
    """
    places = np.concatenate([POSITIONS[:3], POSITIONS[:3] + np.array([0.0, 1000.0, 0.0])])
    time = 0.5 * np.arange(220)
    position = np.column_stack([np.full(time.size, 20.0), 15.0 * time - 300.0, np.full(time.size, 50.0)])
    distance = np.linalg.norm(position[:, None] - places, axis=2)
    rows = [f"{time[k]:.1f},{'abcdef'[i]},{distance[k, i]:.4f}" for k, i in np.argwhere(distance < 300.0)]
    sources = ", ".join(f"{{name: {'abcdef'[i]}, position_m: {p.tolist()}}}" for i, p in enumerate(places))
    head, table_of = "t_s,source,range_m", f"positions: [{sources}]"
    log = read(tmp_path, [head, *rows], "", table_of)
    assert log.range.size == len(rows)
    wrong = [f"{t},{name},{float(x) * 0.1:.4f}" for t, name, x in (row.split(",") for row in rows)]
    assert "at the same time add up to" in refusal(tmp_path, [head, *wrong], "", table_of)


def test_swapped_latitude_and_longitude(tmp_path: Path) -> None:
    places = ["a,39.8,114.4,900", "b,39.9,114.4,900", "c,39.8,114.5,900", "d,39.9,114.5,900"]
    (tmp_path / "s.csv").write_text("\n".join(["source,lon_deg,lat_deg,h_m", *places]))
    message = refusal(tmp_path, table(), "measurement: one_way", "file: s.csv")
    assert "the latitude of c is 114.5 deg: are the columns of latitude and longitude swapped?" in message
    (tmp_path / "s.csv").write_text("source,x_m,y_m,z_m\na,0,0,0\nb,5,0,0\na,1,0,0\n")
    assert "line 4: a has another position than on line 2" in refusal(tmp_path, table(), "", "file: s.csv")


def test_far_apart_sources(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text("source,lat_deg,lon_deg,h_m\na,48,11,0\nb,48.1,11,0\nc,-48,11,0\nd,48,11.1,0\n")
    message = refusal(tmp_path, table(), "measurement: one_way", "file: s.csv")
    assert "km apart; check the units" in message


def test_a_few_late_rows_are_sorted_and_told(tmp_path: Path) -> None:
    rows = table()
    rows[5], rows[6] = rows[6], rows[5]
    log = read(tmp_path, rows)
    assert (np.diff(log.time) >= 0.0).all()
    assert log.warnings == ("1 range out of order of time, sorted",)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ("clocks: {datum: a}\n", "two-way ranges have no clocks"),
        ("start_s: 5\nend_s: 3\n", "must come after start_s"),
        ("start_s: 500\n", "no range lies between start_s and end_s; the ranges are from 0.0 to 7.9 s"),
        ("motion: {model: velosity}\n", "velocity"),
        ("clocks: {sources: {h0: 1.0e-20}}\n", "give an oscillator, or h0 and h_minus2"),
    ],
)
def test_keys_that_contradict(tmp_path: Path, more: str, says: str) -> None:
    assert says in refusal(tmp_path, table(), more=more)


@pytest.mark.parametrize(("measurement", "more", "text"), [
    ("two_way", "motion: {correlation_time_s: 5}", "the velocity model has no acceleration"),
    ("two_way", "bias: {smoothing_s: 1}", "two-way ranges are measured one by one"),
    ("one_way", "bias: {smoothing_s: 1, wander: {sigma_m: 0, correlation_time_s: 1}}", "no error to smooth"),
])  # fmt: skip
def test_keys_of_the_other_models_are_refused(tmp_path: Path, measurement: str, more: str, text: str) -> None:
    assert text in refusal(tmp_path, table(), f"measurement: {measurement}", more=more)
