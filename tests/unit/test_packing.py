"""Packed files: gzip, bzip2, zip, Unix compress, Hatanaka, one in another; bounded, and cut at their end."""

from __future__ import annotations

import bz2
import gzip
import io
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from navsim.formats import text
from navsim.formats.rinex_obs import read_obs
from navsim.formats.text import Dropped, FileError, read_lines
from tests.rinex import observations_3

TEXT = "".join(f"line {k}\n" for k in range(5000))
DATA = TEXT.encode()


def zipped(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, data in members:
            archive.writestr(name, data)
    return out.getvalue()


PACKED = {
    "gzip": gzip.compress(DATA),
    "gzip, two members, padded": gzip.compress(DATA[:100]) + gzip.compress(DATA[100:]) + bytes(512),
    "bzip2": bz2.compress(DATA),
    "bzip2, two streams": bz2.compress(DATA[:100]) + bz2.compress(DATA[100:]),
    "zip": zipped(("a.txt", DATA)),
    "zip, stored": zipped(("a.txt", DATA), method=zipfile.ZIP_STORED),
    "zip, bzip2": zipped(("a.txt", DATA), method=zipfile.ZIP_BZIP2),
    "zip, lzma": zipped(("a.txt", DATA), method=zipfile.ZIP_LZMA),
    "zip with a folder": zipped(("folder/", b""), ("folder/a.txt", DATA)),
    "zip of gzip": zipped(("a.txt.gz", gzip.compress(DATA))),
}


@pytest.mark.parametrize("kind", PACKED)
def test_packed_texts_are_opened(kind: str, tmp_path: Path) -> None:
    """By their content: the name says nothing."""
    path = tmp_path / "file.txt"
    path.write_bytes(PACKED[kind])
    assert read_lines(path) == TEXT.split("\n")


@pytest.mark.parametrize("kind", PACKED)
def test_no_packing_unpacks_to_more_than_allowed(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    path = tmp_path / "file"
    path.write_bytes(PACKED[kind])
    held = len(DATA) + text.LINE * TEXT.count("\n")
    monkeypatch.setattr(text, "MOST_BYTES", held)
    read_lines(path)
    monkeypatch.setattr(text, "MOST_BYTES", held - 1)
    with pytest.raises(FileError, match="unpacks to more than"):
        read_lines(path)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (zipped(("a", DATA), ("b", DATA)), r"has 2 files \(a, b\); give one with a single file"),
        (zipped(), "has no file; give one with a single file"),
        (zipped(("a", DATA))[:-30], "cannot be unpacked"),
        (PACKED["zip, stored"].replace(b"line 17\n", b"line 71\n"), "cannot be unpacked: Bad CRC"),
        (gzip.compress(DATA) + b"more", "4 bytes follow the end of the gzip data"),
        (bz2.compress(DATA)[:-9], "the bzip2 file ends too early"),
        (gzip.compress(DATA)[:-9], "the gzip file ends too early"),
        (gzip.compress(DATA)[:-8] + bytes(8), "cannot be unpacked"),
        (gzip.compress(gzip.compress(gzip.compress(gzip.compress(DATA)))), "compressed more than 3 times"),
    ],
)
def test_what_is_wrong_with_a_packed_file_is_said(data: bytes, said: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(data)
    with pytest.raises(FileError, match=said) as caught:
        read_lines(path)
    assert str(path) in str(caught.value)


def test_an_encrypted_archive_is_refused(tmp_path: Path) -> None:
    data = bytearray(zipped(("a", DATA)))
    for magic in (b"PK\x03\x04", b"PK\x01\x02"):
        data[data.index(magic) + (6 if magic == b"PK\x03\x04" else 8)] |= 1
    (tmp_path / "file").write_bytes(bytes(data))
    with pytest.raises(FileError, match="encrypted"):
        read_lines(tmp_path / "file")


@pytest.mark.parametrize("kind", ["gzip", "bzip2"])
def test_a_packed_file_cut_at_its_end(kind: str, tmp_path: Path) -> None:
    """A lenient reader takes the whole lines before the cut."""
    rng = np.random.default_rng(1)
    lines = [" ".join(f"{x:.15f}" for x in rng.random(9)) for _ in range(16000)]
    data = {"gzip": gzip, "bzip2": bz2}[kind].compress(("\n".join(lines) + "\n").encode())
    path = tmp_path / "file"
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(FileError, match="ends too early") as caught:
        read_lines(path)
    assert caught.value.salvageable
    dropped = Dropped(lenient=True)
    found = read_lines(path, dropped)
    assert found[-1] == ""
    assert 1000 < len(found) < 16000
    assert found[:-1] == lines[: len(found) - 1]
    assert len(dropped.counts) == 1


def test_a_hatanaka_file_cut_at_its_end(tmp_path: Path) -> None:
    import hatanaka

    packed = hatanaka.rnx2crx(observations_3()).split("\n")
    path = tmp_path / "file.crx"
    path.write_text("\n".join(packed[:-3]) + "\n")
    with pytest.raises(FileError, match="truncated") as caught:
        read_obs(path)
    assert caught.value.salvageable
    found = read_obs(path, lenient=True)
    assert found.time.size == 1
    assert len(found.satellites) == 3
    assert "Hatanaka" in found.left_out[0]


def test_observations_in_a_zip(tmp_path: Path) -> None:
    import hatanaka

    (tmp_path / "plain").write_text(observations_3())
    packed = hatanaka.rnx2crx(observations_3()).encode()
    (tmp_path / "zip").write_bytes(zipped(("S.crx", packed)))
    a, b = read_obs(tmp_path / "plain"), read_obs(tmp_path / "zip")
    np.testing.assert_array_equal(a.values["C1C"], b.values["C1C"])


MANY = 60_000_000
BOMBS: dict[str, tuple[Callable[[], bytes], str]] = {
    "of line ends": (lambda: gzip.compress(b"\n" * MANY, 1), "unpacks to more than"),
    "of rows": (lambda: bz2.compress(b"12\n" * 500_000) * 40, "unpacks to more than"),
    "in a bomb": (lambda: gzip.compress(gzip.compress(b"\n" * MANY, 1) * 20), "unpacks to more than"),
    "in an archive": (lambda: zipped(("a", b"\n" * MANY)), "unpacks to more than"),
    "of one line": (lambda: gzip.compress(b"0" * MANY, 1), "file:1: a line of more than 1,000,000 bytes"),
    "of nothing": (lambda: gzip.compress(bytes(10_000_000)), "file:1: not a text file"),
    "of members": (lambda: gzip.compress(b"") * 110_000, "more than 100,000 members"),
    "of files": (lambda: b"PK\x03\x04" + b"PK\x01\x02" * 100_001, "more than 100,000 files"),
}


@pytest.mark.parametrize("kind", BOMBS)
def test_bombs_are_refused_before_they_fill_the_memory(kind: str, tmp_path: Path) -> None:
    made, said = BOMBS[kind]
    path = tmp_path / "file"
    path.write_bytes(made())
    tracemalloc.start()
    try:
        with pytest.raises(FileError, match=said):
            read_lines(path)
        assert tracemalloc.get_traced_memory()[1] < 100_000_000
    finally:
        tracemalloc.stop()


def test_a_bomb_of_unix_compress(tmp_path: Path) -> None:
    import ncompress

    path = tmp_path / "file"
    path.write_bytes(ncompress.compress(DATA))
    assert read_lines(path) == TEXT.split("\n")
    path.write_bytes(ncompress.compress(b"0\n" * 60_000_000))
    with pytest.raises(FileError, match="unpacks to more than"):
        read_lines(path)
    path.write_bytes(b"\x1f\x9d\x90" + bytes(range(256)))
    with pytest.raises(FileError, match="cannot be unpacked"):
        read_lines(path)


def test_a_bomb_of_hatanaka(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import hatanaka

    path = tmp_path / "file"
    path.write_text(hatanaka.rnx2crx(observations_3()))
    monkeypatch.setattr(text, "MOST_BYTES", len(observations_3()) - 1)
    with pytest.raises(FileError, match="unpacks to more than"):
        read_lines(path)


def test_lines_are_the_same_however_the_pieces_fall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ends of lines of all three kinds, Latin 1, no end at the end."""
    data = "a\r\nb\rc\n\r\n\u00e9\r\r\nlast\r".encode("latin-1")
    due = ["a", "b", "c", "", "\u00e9", "", "last", ""]
    path = tmp_path / "file"
    for content, lines in ((data, due), (data[:-1], due[:-1]), (b"", [""]), (b"\n", ["", ""])):
        path.write_bytes(content)
        for size in (1, 2, 3, 7, 1 << 20):
            monkeypatch.setattr(text, "_CHUNK", size)
            assert read_lines(path) == lines


def test_a_table_larger_than_the_memory_is_refused() -> None:
    text.check_table(Path("a"), 1000, 1000, 100)
    with pytest.raises(FileError, match="its table of 1,000,000 x 1,000 x 4"):
        text.check_table(Path("a"), 1_000_000, 1000, 4)


@pytest.mark.parametrize("cell", ["0.1_0", "1_000", "1_0D3"])
def test_underscores_are_no_part_of_a_number(cell: str) -> None:
    with pytest.raises(FileError, match="expected a number for x, found"):
        text.number(Path("a"), 1, cell, "x")
