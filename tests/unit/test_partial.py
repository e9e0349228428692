"""Partial work: whose it is, what counts of it, and who may write."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from navsim.optimization.search_log import SearchLog
from navsim.results import atomic_write as whole
from navsim.results.atomic_write import Occupied, clean, discard, locked, partial_folder, write_atomically
from navsim.runner.checkpoint import CheckpointError, CheckpointStore

KEY = {"seed": 1, "runs": 50}
PIECE = {"a": np.arange(3.0), "text": np.array(["x", "yy"])}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    store = CheckpointStore(tmp_path / "r.h5.partial", KEY, fresh=False)
    for name in ("one", "two"):
        store.write(name, {**PIECE, "name": np.array(name)})
    return store.folder


def counted(folder: Path, key: dict[str, int] = KEY) -> tuple[list[str], int]:
    store = CheckpointStore(folder, key, fresh=False)
    found = [name for name in ("one", "two") if store.read(name) is not None]
    return found, store.redone


def test_pieces_come_back(folder: Path) -> None:
    piece = CheckpointStore(folder, KEY, fresh=False).read("two")
    assert piece is not None
    assert {name: value.tolist() for name, value in piece.items()} == {
        "a": [0.0, 1.0, 2.0],
        "text": ["x", "yy"],
        "name": "two",
    }


@pytest.mark.parametrize(
    "array",
    [np.float64(3.0), np.empty((0, 4)), np.arange(24).reshape(2, 3, 4).T, np.array(["", "ж"]), np.array([], str),
     np.array([True, False]), np.arange(0, 3).astype("datetime64[s]"), np.zeros(2, [("x", "f8"), ("n", "i4")])],
    ids=lambda array: f"{array.dtype} {array.shape}",
)  # fmt: skip
def test_arrays_come_back_as_they_were(array: np.ndarray, tmp_path: Path) -> None:
    store = CheckpointStore(tmp_path / "p", KEY, fresh=False)
    kept = store.write("one", {"a": array})["a"].read()
    with np.load(store.file("one")) as others:
        for back in (kept, others["a"]):
            assert (back.dtype, back.shape) == (array.dtype, array.shape)
            np.testing.assert_array_equal(back, array)


def test_objects_are_no_numbers(tmp_path: Path) -> None:
    store = CheckpointStore(tmp_path / "p", KEY, fresh=False)
    with pytest.raises(ValueError, match="no objects"):
        store.write("one", {"a": np.array([{}], object)})
    assert [file.name for file in store.folder.iterdir()] == ["key.json"]


def swap(folder: Path) -> None:
    (folder / "one.npz").rename(folder / "third")
    (folder / "two.npz").rename(folder / "one.npz")
    (folder / "third").rename(folder / "two.npz")


def rename(folder: Path) -> None:
    (folder / "one.npz").replace(folder / "two.npz")


def flip(folder: Path) -> None:
    content = bytearray((folder / "one.npz").read_bytes())
    content[content.index(PIECE["a"].tobytes())] ^= 4
    (folder / "one.npz").write_bytes(content)


def lose(folder: Path) -> None:
    (folder / "one.npz").unlink()


def cut(folder: Path) -> None:
    os.truncate(folder / "one.npz", (folder / "one.npz").stat().st_size - 1)


def blank(folder: Path) -> None:
    (folder / "one.npz").write_bytes(b"")


def forge(folder: Path) -> None:
    """Other numbers in a proper archive."""
    np.savez(folder / "one.npz", a=np.arange(1.0, 4.0), text=PIECE["text"], name=np.array("one"))


@pytest.mark.parametrize(
    ("damage", "left", "redone"),
    [(swap, [], 2), (rename, [], 1), (flip, ["two"], 1), (lose, ["two"], 0), (cut, ["two"], 1), (blank, ["two"], 1),
     (forge, ["two"], 1)],
)  # fmt: skip
def test_a_piece_counts_only_whole_and_in_its_place(
    damage: Callable[[Path], None], left: list[str], redone: int, folder: Path
) -> None:
    damage(folder)
    assert counted(folder) == (left, redone)


def damaged_pieces(content: bytes, every: bool) -> Iterator[bytes]:
    """A piece with each byte changed, cut everywhere, with bytes put in, taken out and added: each byte in all these
    ways, or in two of them, its neighbours in the others."""
    for at in range(len(content)):
        ways = [
            *(content[:at] + bytes([content[at] ^ change]) + content[at + 1 :] for change in (0x01, 0x20, 0x80, 0xFF)),
            content[:at],
            content[:at] + b"\0" + content[at:],
            content[:at] + content[at + 1 :],
        ]
        yield from ways if every else (ways[at % 4], ways[4 + at % 3])
    yield content + b"x" * 70_000
    yield content + content
    yield b"x" * 100 + content


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.long)])
def test_whatever_is_damaged_in_a_piece_its_numbers_are_as_written(every: bool, tmp_path: Path) -> None:
    """Or it does not count: what may change is what nobody reads, such as dates."""
    store = CheckpointStore(tmp_path / "p", KEY, fresh=False)
    kept = store.write("one", PIECE)
    file = store.file("one")
    whole_piece = file.read_bytes()
    again = CheckpointStore(store.folder, KEY, fresh=False)
    counted, harmless = 0, 0
    for content in damaged_pieces(whole_piece, every):
        file.write_bytes(content)
        found = again.read("one")
        counted += 1
        if found is not None:
            harmless += 1
            assert found.keys() == PIECE.keys()
            for name, array in found.items():
                np.testing.assert_array_equal(array, PIECE[name], strict=True)
        for name, array in PIECE.items():  # as a study reads what it wrote itself
            with contextlib.suppress(CheckpointError):
                np.testing.assert_array_equal(kept[name].read(), array, strict=True)
    assert again.redone == counted - harmless
    assert again.redone > 0.7 * counted


def test_pieces_of_another_study_do_not_count(folder: Path) -> None:
    """A `--fresh` that was killed between the key and the pieces, by a version that deleted one file after another."""
    (folder / "key.json").write_text(json.dumps({**KEY, "seed": 2}, sort_keys=True, indent=1))
    assert counted(folder, {**KEY, "seed": 2}) == ([], 2)


@pytest.mark.parametrize("key", [None, "", '{"seed": 1', "[]", '"text"'])
def test_pieces_without_a_key_are_nobodys(key: str | None, folder: Path) -> None:
    (folder / "key.json").unlink()
    if key is not None:
        (folder / "key.json").write_text(key)
    with pytest.raises(CheckpointError, match=r"key\.json is missing or damaged; --fresh discards it"):
        CheckpointStore(folder, KEY, fresh=False)
    assert (folder / "one.npz").exists()
    assert CheckpointStore(folder, KEY, fresh=True).read("one") is None


@pytest.mark.parametrize("key", ["", '{"seed": 1', '{"seed": 7}'])
def test_a_key_without_pieces_is_written_anew(key: str, tmp_path: Path) -> None:
    folder = tmp_path / "r.h5.partial"
    folder.mkdir()
    (folder / "key.json").write_text(key)
    store = CheckpointStore(folder, KEY, fresh=False)
    assert not store.holds_work()
    store.write("one", PIECE)
    assert store.holds_work()
    assert counted(folder) == (["one"], 0)


def test_another_study_is_refused_with_what_differs(folder: Path) -> None:
    with pytest.raises(CheckpointError, match=r"another study lies there \(seed 1 there, 3 here\)"):
        CheckpointStore(folder, {**KEY, "seed": 3}, fresh=False)
    assert counted(folder) == (["one", "two"], 0)


def test_fresh_killed_under_way_leaves_nothing_that_counts(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder goes by one renaming; what is left under the other name is cleaned by the next command."""

    class Killed(Exception):
        pass

    def killed(*_: object, **__: object) -> None:
        raise Killed

    real = shutil.rmtree
    monkeypatch.setattr(whole.shutil, "rmtree", lambda path, **how: killed() if path.exists() else real(path, **how))
    with pytest.raises(Killed):
        CheckpointStore(folder, KEY, fresh=True)
    monkeypatch.undo()
    assert not folder.exists()
    assert [path.name for path in folder.parent.iterdir()] == [f".r.h5.partial.{os.getpid()}.gone"]
    clean(folder.parent / "r.h5", owned=True)
    assert not list(folder.parent.iterdir())
    discard(folder)


def test_a_file_is_whole_or_as_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "f"
    write_atomically(file, b"before")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(whole.os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(file, b"after")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("f", b"before")]


def test_a_lock_says_who_holds_it_and_ends_with_its_process(tmp_path: Path) -> None:
    file = tmp_path / "r.h5"
    code = (
        "import sys, time; from pathlib import Path; from navsim.results.atomic_write import locked\n"
        "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(file)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "held\n"
        who = rf"r\.h5: process {holder.pid} on .*, since .* UTC, is at work on it"
        with pytest.raises(Occupied, match=who), locked(file):
            pass
        with locked(tmp_path / "another.h5"):
            pass
        holder.kill()
    with locked(file):
        assert (tmp_path / ".r.h5.lock").exists()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("fresh", [True, False])
def test_a_folder_with_other_files_is_left_alone(fresh: bool, folder: Path, tmp_path: Path) -> None:
    mine = tmp_path / "p"
    mine.mkdir()
    for place in (mine, folder):
        (place / "notes.txt").write_text("precious")
        with pytest.raises(CheckpointError, match=r"holds 'notes\.txt', which is not navsim's; move"):
            CheckpointStore(place, KEY, fresh)
        assert (place / "notes.txt").read_text() == "precious"


def test_what_came_into_the_folder_meanwhile_stays(folder: Path) -> None:
    store = CheckpointStore(folder, KEY, fresh=False)
    (folder / "notes.txt").write_text("precious")
    store.remove()
    assert (folder / "notes.txt").read_text() == "precious"


def test_what_is_hashed_is_told_by_its_name(tmp_path: Path) -> None:
    CheckpointStore(tmp_path / "p", {"scenario_sha256": "a", "seed": 1}, fresh=False).write("one", PIECE)
    with pytest.raises(CheckpointError, match=r"lies there \(other settings of the scenario; seed 1 there, 2 here\)"):
        CheckpointStore(tmp_path / "p", {"scenario_sha256": "b", "seed": 2}, fresh=False)
    for content, words in (
        ("{}", "another kind"),
        ('{"seed": 2, "more": 1}', "another kind"),
        ("[]", "missing or damaged"),
    ):
        (tmp_path / "p" / "key.json").write_text(content)
        with pytest.raises(CheckpointError, match=words):
            CheckpointStore(tmp_path / "p", {"seed": 2}, fresh=False)


def test_only_leftovers_of_this_output_are_cleaned(tmp_path: Path) -> None:
    """What another process writes under a name that begins alike stays, and so does a folder in the way."""
    mine, others = (tmp_path / name for name in (".o.5.tmp", ".o.h5.5.tmp"))
    for file in (mine, others):
        file.write_bytes(b"")
    (tmp_path / ".o.6.tmp").mkdir()
    clean(tmp_path / "o", owned=True)
    assert {path.name for path in tmp_path.iterdir()} == {".o.h5.5.tmp", ".o.6.tmp"}
    clean(tmp_path / "absent" / "o", owned=True)


@pytest.mark.parametrize("length", [243, 247])
def test_the_longest_names(length: int, tmp_path: Path) -> None:
    """Partial work under a name that leaves no room for another ending is discarded like any other."""
    target = tmp_path / ("x" * length)
    with locked(target):
        store = CheckpointStore(partial_folder(target), KEY, fresh=False)
        store.write("one", PIECE)
        CheckpointStore(partial_folder(target), KEY, fresh=True)
        assert counted(partial_folder(target)) == ([], 0)
        store.remove()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o666, 0o444])
def test_who_may_read_a_file_may_read_the_one_in_its_place(mode: int, tmp_path: Path) -> None:
    file = tmp_path / "f"
    file.write_bytes(b"before")
    file.chmod(mode)
    with whole.replacing(file) as temporary:
        assert temporary.stat().st_mode & 0o777 == 0o600
        temporary.write_bytes(b"after")
    assert file.stat().st_mode & 0o777 == mode
    assert file.read_bytes() == b"after"


@pytest.mark.parametrize("damage", [lambda file: file.unlink(), lambda file: file.write_bytes(b""), flip])
def test_a_piece_damaged_after_it_was_checked_is_noticed(damage: Callable[[Path], None], folder: Path) -> None:
    store = CheckpointStore(folder, KEY, fresh=False)
    found = store.find("one")
    assert found is not None
    np.testing.assert_array_equal(found["a"].read(), PIECE["a"])
    damage(folder if damage is flip else store.file("one"))
    with pytest.raises(CheckpointError, match=r"one\.npz: was damaged or removed"):
        found["a"].read()


# --- the journal of a search


def twice(places: np.ndarray) -> np.ndarray:
    return np.asarray(2.0 * places.sum(axis=(1, 2)))


def forbidden(places: np.ndarray) -> np.ndarray:
    raise AssertionError(places)


def test_a_journal_remembers_to_the_bit(tmp_path: Path) -> None:
    places = np.random.default_rng(1).normal(size=(5, 2, 2))
    nothing = np.empty((1, 0, 2))
    first = SearchLog(CheckpointStore(tmp_path / "p", KEY, fresh=False)).remembering("full", twice)
    np.testing.assert_array_equal(first(places), twice(places))
    assert first(nothing) == [0.0]
    again = SearchLog(CheckpointStore(tmp_path / "p", KEY, fresh=False))
    np.testing.assert_array_equal(again.remembering("full", forbidden)(places), twice(places))
    assert again.remembering("full", forbidden)(nothing) == [0.0]
    with pytest.raises(AssertionError):
        again.remembering("coarse", forbidden)(places)


@pytest.mark.parametrize("cut", [1, 20, 400])
def test_a_cut_journal_counts_up_to_its_last_whole_line(cut: int, tmp_path: Path) -> None:
    places = np.arange(40.0).reshape(10, 2, 2)
    SearchLog(CheckpointStore(tmp_path / "p", KEY, fresh=False)).remembering("full", twice)(places)
    file = tmp_path / "p" / "journal.txt"
    whole_lines = file.read_bytes()
    file.write_bytes(whole_lines[:-cut])
    store = CheckpointStore(tmp_path / "p", KEY, fresh=False)
    np.testing.assert_array_equal(SearchLog(store).remembering("full", twice)(places), twice(places))
    assert store.redone == 1
    assert file.read_bytes() == whole_lines


class Short:
    """A file on a disk that was full for a moment: of one write it took half."""

    def __init__(self, file: Any) -> None:
        self._file, self._left = file, 3

    def write(self, content: bytes) -> int:
        self._left -= 1
        return self._file.write(content if self._left else content[: len(content) // 2])

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def test_a_line_written_in_part_hides_none_after_it(tmp_path: Path) -> None:
    places = np.arange(40.0).reshape(10, 2, 2)
    journal = SearchLog(CheckpointStore(tmp_path / "p", KEY, fresh=False))
    journal._file = Short(journal._file)  # passes all but one write on to the real one
    judge = journal.remembering("full", twice)
    with pytest.raises(CheckpointError, match="No space left"):
        judge(places)
    judge(places[5:])
    store = CheckpointStore(tmp_path / "p", KEY, fresh=False)
    known = SearchLog(store).remembering("full", forbidden)
    np.testing.assert_array_equal(known(places[[0, 1, 5, 9]]), twice(places[[0, 1, 5, 9]]))
    assert store.redone == 0


def test_a_journal_of_another_study_does_not_count(tmp_path: Path) -> None:
    places = np.arange(4.0).reshape(1, 2, 2)
    SearchLog(CheckpointStore(tmp_path / "p", KEY, fresh=False)).remembering("full", twice)(places)
    other = {**KEY, "seed": 2}
    with pytest.raises(CheckpointError, match="another study"):
        CheckpointStore(tmp_path / "p", other, fresh=False)
    (tmp_path / "p" / "key.json").write_text(json.dumps(other, sort_keys=True, indent=1))
    with pytest.raises(AssertionError):
        SearchLog(CheckpointStore(tmp_path / "p", other, fresh=False)).remembering("full", forbidden)(places)
