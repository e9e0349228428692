"""Files from outside: regular ones, of bounded size, whatever they say of themselves."""

from __future__ import annotations

import hashlib
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from navsim.formats.text import FileError, read_lines
from navsim.results import files
from navsim.results.hdf5 import CorruptFile
from navsim.results.result import ResultError, read
from navsim.scenario_files.source import InputError, load

OPENERS: dict[str, Callable[[Path], object]] = {
    "checksum": files.checksum, "content": lambda path: files.content(path, 10_000_000), "lines": read_lines,
    "scenario": load, "result": read,
}  # fmt: skip
REFUSALS = (OSError, FileError, InputError, ResultError, CorruptFile)


def pipe(folder: Path) -> Path:
    os.mkfifo(folder / "pipe")
    return folder / "pipe"


def endpoint(folder: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(folder / "socket"))
    return folder / "socket"


ODD: dict[str, Callable[[Path], Path]] = {
    "named pipe": pipe,
    "socket": endpoint,
    "folder": lambda folder: folder,
    "device": lambda folder: Path("/dev/zero"),
    "memory map": lambda folder: Path("/proc/self/pagemap"),
    "memory": lambda folder: Path("/proc/self/mem"),
    "messages of the kernel": lambda folder: Path("/proc/kmsg"),
    "link": lambda folder: (folder / "link").symlink_to("/proc/self/pagemap") or folder / "link",
}


@pytest.mark.parametrize("opener", OPENERS)
@pytest.mark.parametrize("kind", ODD)
def test_what_is_no_regular_file_is_refused_at_once(kind: str, opener: str, tmp_path: Path) -> None:
    """Files of the kernel's say they are regular: one never ends, one never begins."""
    path = ODD[kind](tmp_path)
    if not os.access(path, os.R_OK):
        pytest.skip(f"{path} cannot be read here")
    begin = time.process_time()
    with pytest.raises(REFUSALS) as caught:
        OPENERS[opener](path)
    assert str(caught.value)
    assert time.process_time() - begin < 2.0


def test_bytes_are_counted_as_they_are_read(tmp_path: Path) -> None:
    """A file may grow after it was opened; one that is read as a whole gives all of it."""
    path = tmp_path / "file"
    path.write_bytes(b"x" * 100)
    assert files.content(path, 100) == b"x" * 100
    assert files.checksum(path) == hashlib.sha256(b"x" * 100).hexdigest()
    with files.open_regular(path, 1000) as file:
        assert file.read(10) == b"x" * 10
        with path.open("ab") as more:
            more.write(b"y" * 2000)
        with pytest.raises(OSError, match="more than 1,000 bytes"):
            file.read()
    with pytest.raises(OSError, match="more than 1,000 bytes"):
        files.open_regular(path, 1000)
