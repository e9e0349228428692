"""Result files that are damaged, made by somebody else, or no files at all; and places where none can be written."""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5netcdf
import h5py
import netCDF4
import numpy as np
import pytest
import xarray as xr
from typer.testing import CliRunner

from navsim.cli.main import app
from navsim.landing import study as landing
from navsim.results import checksum, hdf5
from navsim.results.result import (
    Result,
    ResultError,
    Stored,
    Stream,
    Variable,
    check_writable,
    part,
    read,
    read_kind,
    write,
    write_bytes,
    write_text,
)
from navsim.runner.checkpoint import CheckpointError
from navsim.runner.executor import threads
from tests.conftest import SCENARIOS
from tests.helpers import case


def small() -> Result:
    """A result of all sorts of data: numbers, text, a stream, nothing, a single value."""
    rows = np.arange(60_000.0).reshape(6, 10_000)
    variables = {
        "/run": Variable(("run",), np.arange(6), "1", "runs"),
        "/state": Variable(("state",), np.array(["north", "östlich"], dtype=object), "1", "states"),
        "/flown/time": Variable(("time",), np.arange(10_000) * 0.1, "s", "times"),
        "/flown/error": Variable(
            ("run", "time"), Stream(rows.shape, rows.dtype, lambda: iter((rows[:4], rows[4:]))), "m", "errors"
        ),
        "/flown/status": Variable(("run",), np.ones(6, dtype=np.int8), "1", "status", {"degrees_of_freedom": 6}),
        "/event": Variable(("event",), np.zeros(0), "s", "events"),
        "/count": Variable((), np.int64(6), "1", "how many"),
    }
    return Result({"kind": "landing", "navsim_version": "1.2", "title": "plain", "seed": 2**63 - 1}, variables)


def agree(one: Result, other: Result) -> bool:
    """Whether two results hold the same; raises ResultError where one cannot be read."""
    return (
        one.attributes == other.attributes
        and sorted(one.variables) == sorted(other.variables)
        and all(
            np.array_equal(one[path], other[path])
            and replace(v, data=None) == replace(other.variables[path], data=None)
            for path, v in one.variables.items()
        )
    )


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("written") / "small.h5"
    write(file, small())
    return file


@pytest.fixture
def file(written: Path, tmp_path: Path) -> Path:
    return Path(shutil.copy(written, tmp_path))


def unsealed(file: Path, change: Callable[[h5py.File], object] = lambda _: None) -> Path:
    """The file as a version without checksums would have written it, and then changed."""
    with h5py.File(file, "r+") as tree:
        del tree.attrs["checksums"], tree.attrs["contents"]
        change(tree)
    return file


# --- what is written


def test_written_and_read_again(file: Path) -> None:
    again = read(file)
    assert agree(small(), again)
    assert again.attributes["seed"] == 2**63 - 1
    write(file.with_name("again.h5"), again)
    assert agree(again, read(file.with_name("again.h5")))
    assert read_kind(file).kind == "landing"


def test_rows_of_what_is_stored(file: Path) -> None:
    error = read(file).variables["/flown/error"].data
    assert isinstance(error, Stored)
    whole = np.asarray(small().variables["/flown/error"].data)
    np.testing.assert_array_equal(error.rows(2, 5), whole[2:5])
    np.testing.assert_array_equal(part(error, 2, 5), whole[2:5])
    np.testing.assert_array_equal(part(part(error, 2, 5), 1, 2), whole[3:4])
    np.testing.assert_array_equal(np.concatenate(list(part(error, 2, 5).blocks())), whole[2:5])


def test_other_programs_read_it_and_see_damage(file: Path) -> None:
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        assert tree["flown/error"].dims == ("run", "time")
        assert tree["flown/error"].shape == (6, 10_000)
    with h5py.File(file) as tree:
        numbers = [tree[path] for path in ("run", "flown/time", "flown/error", "flown/status")]
        assert all(node.fletcher32 for node in numbers)
        chunk = tree["flown/error"].id.get_chunk_info(0)
    content = bytearray(file.read_bytes())
    content[chunk.byte_offset + 8] ^= 1
    file.write_bytes(content)
    with h5py.File(file) as tree, pytest.raises(OSError, match=r"[Ff]letcher32|filter"):
        tree["flown/error"][()]


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_it_is_netcdf4_as_the_libraries_write_it(engine: str, file: Path) -> None:
    """Names, dimensions, those of groups above too, types and attributes."""
    theirs = file.with_name("theirs.h5")
    ours = small()
    with h5netcdf.File(theirs, "w") as tree:
        groups = {"": tree, "/flown": tree.create_group("flown")}
        for path, variable in ours.variables.items():
            group, _, name = path.rpartition("/")
            if variable.dims == (name,):
                groups[group].dimensions[name] = len(variable.data)
        for path, variable in ours.variables.items():
            data = np.asarray(variable.data)
            kind = h5py.string_dtype() if data.dtype.kind == "O" else data.dtype
            made = tree.create_variable(path, variable.dims, kind, data=data if data.size else None)
            texts = {"units": variable.units, "long_name": variable.long_name}
            made.attrs.update(texts | variable.attributes)
        tree.attrs.update(ours.attributes)
    with xr.open_datatree(file, engine=engine) as one, xr.open_datatree(theirs, engine=engine) as other:
        assert "SHA-256" in one.attrs.pop("checksums")
        assert len(json.loads(one.attrs.pop("contents"))) == len(ours.variables) + len(ours.attributes)
        assert one.identical(other)
    with netCDF4.Dataset(file) as one, netCDF4.Dataset(theirs) as other:
        for mine, its in ((one, other), (one["flown"], other["flown"])):
            seen = [
                (
                    {name: (len(dim), dim.isunlimited()) for name, dim in group.dimensions.items()},
                    {name: (variable.dimensions, variable.dtype) for name, variable in group.variables.items()},
                )
                for group in (mine, its)
            ]
            assert seen[0] == seen[1]


def test_data_that_do_not_fit_their_dimensions_are_not_written(file: Path) -> None:
    before = file.read_bytes()
    wrong = Variable(("run",), np.zeros(5), "m", "five for six runs")
    with pytest.raises(ValueError, match="/flown/wrong: its shape is not that of its dimensions"):
        write(file, replace(small(), variables=small().variables | {"/flown/wrong": wrong}))
    assert file.read_bytes() == before


def test_a_large_result_is_written_like_a_small_one(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("navsim.results.result.IN_MEMORY", 1e5)
    write(file, small())
    assert agree(small(), read(file))
    assert [path.name for path in file.parent.iterdir()] == [file.name]


@pytest.mark.parametrize("in_memory", [6e7, 0])
def test_blocks_that_cannot_be_made_leave_the_earlier_result(
    in_memory: float, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("navsim.results.result.IN_MEMORY", in_memory)
    before = file.read_bytes()

    def blocks() -> Iterator[np.ndarray]:
        yield np.zeros((3, 10_000))
        raise CheckpointError("a piece was damaged")

    wrong = Variable(("run", "time"), Stream((6, 10_000), np.dtype(float), blocks), "m", "errors")
    with pytest.raises(CheckpointError, match="a piece was damaged"):
        write(file, replace(small(), variables=small().variables | {"/flown/error": wrong}))
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == [file.name]


def test_blocks_that_do_not_fit_leave_no_thread(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("navsim.results.result.IN_MEMORY", 0)
    threads = threading.active_count()

    def blocks() -> Iterator[np.ndarray]:
        yield np.zeros((3, 10))
        for _ in range(100):
            yield np.zeros((3, 11))

    wrong = Variable(("run", "time"), Stream((6, 10), np.dtype(float), blocks), "m", "errors")
    other = {path: v for path, v in small().variables.items() if "time" not in v.dims}
    time = Variable(("time",), np.zeros(10), "s", "time")
    with pytest.raises(TypeError) as caught:  # while the error is held, and with it all that it came through
        write(file, replace(small(), variables=other | {"/flown/error": wrong, "/flown/time": time}))
    assert "broadcast" in str(caught.value)
    assert threading.active_count() == threads


@pytest.mark.parametrize("size", [0, 1, checksum.BLOCK, 9_000_000])
def test_a_seal_is_of_each_block_in_its_place(size: int, tmp_path: Path) -> None:
    content = np.random.default_rng(1).bytes(size)
    sealed = content + checksum.checksum_trailer(size, lambda start, end: content[start:end])
    table = b"".join(
        hashlib.sha256(content[at : at + checksum.BLOCK]).digest() for at in range(0, size, checksum.BLOCK)
    )
    assert sealed[size:].startswith(table)
    (tmp_path / "f").write_bytes(sealed)
    with checksum.Reader((tmp_path / "f").open("rb")) as reader:
        assert reader.sealed
        assert reader.read(size) == content


def test_a_content_that_ends_early_is_not_sealed() -> None:
    with pytest.raises(checksum.CorruptFile, match="became shorter"):
        checksum.checksum_trailer(100, lambda start, end: b"x" * (end - start - 1))


def test_what_hdf5_does_not_take_harms_nothing(file: Path) -> None:
    wrong = Result(small().attributes | {"title": "a\0b"}, small().variables)
    with pytest.raises(ResultError, match="title"):
        write(file, wrong)
    assert agree(small(), read(file))
    assert [path.name for path in file.parent.iterdir()] == [file.name]


# --- damage


def test_no_flipped_byte_changes_a_number(file: Path) -> None:
    content, wanted = file.read_bytes(), small()
    draw = random.Random(11)
    seen = 0
    for _ in range(30):
        changed = bytearray(content)
        for _ in range(draw.choice([1, 1, 4, 32])):
            changed[draw.randrange(len(content))] ^= draw.randrange(1, 256)
        file.write_bytes(changed)
        try:
            assert agree(wanted, read(file))
        except ResultError:
            seen += 1
    assert seen > 27  # but for those that hit nothing that is read


def test_no_cut_file_is_read(file: Path) -> None:
    content = file.read_bytes()
    for length in (*range(0, len(content), len(content) // 30), len(content) - 1, len(content) - 70):
        file.write_bytes(content[:length])
        with pytest.raises(ResultError):
            read(file)
    file.write_bytes(content + b"more")
    with pytest.raises(ResultError, match="checksums are gone"):
        read(file)


def test_a_file_that_another_program_changed_is_refused(file: Path) -> None:
    with h5py.File(file, "r+") as tree:
        tree["flown/status"][2] = 0
    with pytest.raises(ResultError, match="damaged"):
        read(file)["/flown/status"]


def test_a_file_without_the_mark_of_its_checksums_is_refused(file: Path) -> None:
    """Somebody deletes it before changing a value: digests of the contents say that there were checksums."""
    with h5py.File(file, "r+") as tree:
        del tree.attrs["checksums"]
        tree["flown/status"][2] = 0
    with pytest.raises(ResultError, match="checksums are gone"):
        read(file)
    with pytest.raises(ResultError, match="checksums are gone"):
        read_kind(file)


def test_damage_is_seen_where_it_is_read(file: Path) -> None:
    with h5py.File(file) as tree:
        at = tree["flown/error"].id.get_chunk_info(0).byte_offset + 3 * checksum.BLOCK
    content = bytearray(file.read_bytes())
    content[at] ^= 1
    file.write_bytes(content)
    result = read(file)
    np.testing.assert_array_equal(result["/flown/time"], small()["/flown/time"])
    with pytest.raises(ResultError, match="checksum"):
        result["/flown/error"]


def test_results_of_earlier_versions_have_no_checksums(file: Path) -> None:
    assert agree(small(), read(unsealed(file)))


# --- what navsim does not write

Change = Callable[[h5py.File], object]


def replaced(make: Callable[[h5py.File, str], object], path: str = "flown/error") -> Change:
    def change(tree: h5py.File) -> None:
        del tree[path]
        make(tree, path)

    return change


def made(*arguments: Any, **options: Any) -> Change:
    return replaced(lambda tree, path: tree.create_dataset(path, *arguments, **options))


def virtual(tree: h5py.File, path: str) -> None:
    layout = h5py.VirtualLayout((6,), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "x", (6,))
    tree.create_virtual_dataset(path, layout)


def nested(tree: h5py.File) -> None:
    for _ in range(50):
        tree = tree.create_group("g")


def attached(data: Any) -> Change:
    """Other data for the errors, their first axis that of runs."""

    def change(tree: h5py.File) -> None:
        made(data=data)(tree)
        tree["flown/error"].dims[0].attach_scale(tree["run"])

    return change


STRANGE: dict[str, Change] = {
    "external link": replaced(lambda t, p: t.__setitem__(p, h5py.ExternalLink("/dev/zero", "/x"))),
    "soft link": replaced(lambda t, p: t.__setitem__(p, h5py.SoftLink("/run"))),
    "link to itself": replaced(lambda t, p: t.__setitem__(p, h5py.SoftLink(f"/{p}"))),
    "the same twice": replaced(lambda t, p: t.__setitem__(p, t["run"])),
    "group within itself": lambda t: t.__setitem__("flown/loop", t["/"]),
    "groups in groups": nested,
    "type with a name": lambda t: t.__setitem__("flown/type", np.dtype("f8")),
    "external storage": made((100,), "u1", external=[("/etc/passwd", 0, 100)]),
    "virtual": replaced(virtual),
    "compressed": made((6,), "f8", compression="gzip"),
    "bomb": made((10**11,), "f8", chunks=(10**6,), compression="gzip", fillvalue=1.0),
    "bomb without compression": made((10**11,), "f8", chunks=(10**3,)),
    "bomb as one block": made((10**9,), "f8"),
    "chunk larger than the file": made((6,), "f8", chunks=(10**8,), maxshape=(None,)),
    "never written": attached(np.zeros(6)),
    "scalar": made(data=1.0),
    "empty": made(data=h5py.Empty("f8")),
    "text for numbers": made(data="hello"),
    "no text": made(data=b"\xff\xfe"),
    "terminal's escapes": made(data="\x1b[31mred"),
    "lists": made((6,), h5py.vlen_dtype("f8")),
    "compound": attached(np.zeros(6, [("a", "f8"), ("b", "S5")])),
    "references": made((6,), h5py.ref_dtype),
    "opaque": attached(np.zeros(6, "V5")),
    "complex": attached(np.ones(6, complex)),
    "axes without names": made(data=np.ones(6)),
    "another length than its axis": attached(np.ones(5)),
    "axis that is no scale": lambda t: t["run"].attrs.__delitem__("CLASS"),
    "scale that is gone": lambda t: t.__delitem__("run"),
    "attribute with control characters": lambda t: t.attrs.__setitem__("title", "\x1b]0;mine\x07"),
    "attribute of bytes": lambda t: t.attrs.__setitem__("title", np.bytes_(b"\xff\xfe")),
    "empty attribute": lambda t: t["run"].attrs.__setitem__("units", h5py.Empty("f8")),
    "kind is a number": lambda t: t.attrs.__setitem__("kind", 5),
    "kind with markup": lambda t: t.attrs.__setitem__("kind", "[red]landing"),
    "version is an array": lambda t: t.attrs.__setitem__("navsim_version", np.arange(3)),
}
"""Changes that make a file none of navsim's; "never written" has its data taken away below."""


@pytest.mark.parametrize("name", STRANGE)
def test_strange_files_are_refused(name: str, file: Path) -> None:
    unsealed(file, STRANGE[name])
    if name == "never written":
        with h5py.File(file, "r+") as tree:
            del tree["flown/error"]
            tree.create_dataset("flown/error", (6,), "f8", chunks=(6,)).dims[0].attach_scale(tree["run"])
    if name in ("scalar", "text for numbers"):  # nothing wrong with the file itself
        assert read(file)["/flown/error"].shape == ()
        return
    with pytest.raises(ResultError, match=r"small\.h5: (a damaged HDF5 file|not a navsim result)"):
        np.asarray(read(file)["/flown/error"])


def test_texts_that_share_their_place_are_counted(file: Path) -> None:
    """A long text in one place, and two hundred names that point there."""
    names = np.array(["x" * 50_000, *"abcdefghij" * 20], dtype=object)
    write(file, Result(small().attributes, {"/name": Variable(("name",), names, "1", "names")}))
    assert np.array_equal(read(unsealed(file))["/name"], names)
    with h5py.File(file) as tree:
        start = tree["name"].id.get_offset()
        width = tree["name"].id.get_storage_size() // names.size
    content = bytearray(file.read_bytes())
    content[start : start + width * names.size] = content[start : start + width] * names.size
    file.write_bytes(content)
    with pytest.raises(ResultError, match="more text than the file can hold"):
        read(file)["/name"]


# --- the commands


@pytest.fixture(scope="module")
def flown() -> Result:
    this = case("duration_s=20")
    return landing.result(this, landing.fly_all(this, 1, 0, 1, threads(1), keep="all"), 1, keep="all")


def run(*arguments: object) -> Any:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def assert_refused(done: Any, *words: str) -> None:
    assert done.exit_code == 2, (done.exit_code, done.output, done.exception)
    assert isinstance(done.exception, SystemExit)
    for word in words:
        assert word in done.stderr


def test_only_what_is_shown_is_read(flown: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "r.h5", flown)
    asked: list[str] = []
    original = hdf5.Tree.read

    def noted(self: hdf5.Tree, path: str, *rows: Any) -> np.ndarray:
        asked.append(path)
        return original(self, path, *rows)

    monkeypatch.setattr(hdf5.Tree, "read", noted)
    assert run("show", tmp_path / "r.h5").exit_code == 0
    assert asked
    names = ("/run", "/filter/state")
    odd = {path for path in asked if not path.startswith(("/summary/", "/findings/")) and path not in names}
    assert not odd


COMMANDS = (("show",), ("show", "--json"), ("plot", "--figures", "figures"), ("export", "--csv", "--kml"))


@pytest.mark.parametrize(
    ("path", "data", "commands"),
    [
        ("/summary/rms/horizontal", np.float64(1.0), COMMANDS[:1]),
        ("/summary/at/lateral", np.array("text", dtype=object), COMMANDS[:1]),
        ("/filter/error", np.float64(1.0), COMMANDS[2:]),
        ("/truth/position_llh", np.array("text", dtype=object), COMMANDS[2:]),
    ],
)
def test_what_does_not_fit_together_is_no_traceback(
    path: str, data: Any, commands: Any, flown: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file that is whole, and holds a single value where rows are due."""
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "r.h5", Result(flown.attributes, flown.variables | {path: Variable((), data, "1", "wrong")}))
    for command, *options in commands:
        assert_refused(run(command, "r.h5", *options), "r.h5: the contents are inconsistent")


def test_unknown_kinds_and_no_files_are_refused(
    flown: Result, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    os.mkfifo(tmp_path / "pipe.h5")
    write(tmp_path / "odd.h5", Result(flown.attributes | {"kind": "crossing"}, flown.variables))
    for command, *options in COMMANDS:
        assert_refused(run(command, "odd.h5", *options), "crossing")
        assert_refused(run(command, "pipe.h5", *options), "pipe.h5", "pipe")
        assert_refused(run(command, "/dev/zero", *options), "/dev/zero")


# --- places


def test_no_output_onto_what_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.h5")
    for path in (tmp_path / "pipe.h5", Path("/dev/null"), tmp_path / f"{'x' * 300}.h5"):
        with pytest.raises(ResultError, match="cannot be written"):
            check_writable(path)
        with pytest.raises(ResultError, match="cannot be written"):
            write_text(path, "x")
        with pytest.raises(ResultError, match="cannot be written"):
            write(path, small())
    assert_refused(run("run", SCENARIOS / "landing.yaml", "-o", tmp_path / "pipe.h5"), "pipe.h5")
    assert [path.name for path in tmp_path.iterdir()] == ["pipe.h5"]
    check_writable(tmp_path / f"{'x' * 244}.h5")  # with room for `.partial`
    write_text(tmp_path / f"{'x' * 250}.h5", "as long as names may be")


def test_the_target_of_a_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    for name, put in (
        ("r.h5", lambda path: write(path, small())),
        ("t.csv", lambda path: write_text(path, "text")),
        ("b.png", lambda path: write_bytes(path, b"bytes")),
    ):
        link, target = tmp_path / name, tmp_path / "store" / name
        link.symlink_to(target)
        check_writable(link)
        put(link)  # where nothing is yet
        first = target.stat().st_ino
        put(link)
        assert link.is_symlink()
        assert target.is_file()
        assert target.stat().st_ino != first
    assert sorted(path.name for path in (tmp_path / "store").iterdir()) == ["b.png", "r.h5", "t.csv"]
    (tmp_path / "loop.h5").symlink_to(tmp_path / "loop.h5")
    with pytest.raises(ResultError, match="cannot be written"):
        check_writable(tmp_path / "loop.h5")


@pytest.mark.parametrize(
    "options",
    [("--seed", 2**63), ("--first-run", 2**63), ("--first-run", 2**63 - 1, "--runs", 2), ("--runs", 10**30)],
)
def test_seeds_and_runs_fit_into_a_file(options: tuple[object, ...], tmp_path: Path) -> None:
    done = run("run", SCENARIOS / "landing.yaml", "-o", tmp_path / "r.h5", *options)
    assert_refused(done, str(options[0]))
    assert not list(tmp_path.iterdir())
