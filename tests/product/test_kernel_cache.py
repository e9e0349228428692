"""The kernels' machine code on disk: damage is dropped and compiled again, a disk that takes none costs time alone."""

from __future__ import annotations

import atexit
import functools
import json
import math
import os
import pkgutil
import random
import shutil
import subprocess
import sys
from collections import namedtuple
from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import types
from numba.core.dispatcher import Dispatcher

import navsim
from navsim.compiler import jit, kernel_cache, kernel_parts
from navsim.compiler.protected_folder import open_protected_folder
from navsim.geodesy import attitude_kernels as attitude
from tests.helpers import in_brief

SERVER = """
import json, os, sys, traceback
import numba, numpy
numba.njit(lambda x: x + 1.0)(1.0)
for line in sys.stdin:
    code, environment, file = json.loads(line)
    child = os.fork()
    if child == 0:
        os.environ.clear()
        os.environ.update(environment)
        os.dup2(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
        try:
            exec(compile(code, "<string>", "exec"), {"__name__": "__main__"})
        except BaseException:
            traceback.print_exc(file=sys.stdout)
            os._exit(1 + bool(sys.stdout.flush()))
        os._exit(bool(sys.stdout.flush()))
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
"""Runs code in forks of a process that has numba and its compiler loaded, and nothing of navsim: a start takes longer
than what is tested."""


@functools.cache
def server() -> subprocess.Popen[str]:
    started = subprocess.Popen(
        [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"},
    )  # fmt: skip
    atexit.register(started.communicate)
    return started


def printed(code: str, folder: Path, environment: Mapping[str, str]) -> str:
    """What a new process prints; folder: for a file with that."""
    asked, file = server(), folder / "printed.txt"
    assert asked.stdin is not None
    assert asked.stdout is not None
    asked.stdin.write(json.dumps([code, dict(environment), str(file)]) + "\n")
    asked.stdin.flush()
    ended = asked.stdout.readline()
    said = file.read_text()
    file.unlink()
    assert ended == "0\n", said
    return said


CODE = (
    "import numpy as np; from navsim.compiler import kernel_cache;"
    "from navsim.geodesy import attitude_kernels as attitude; m = np.empty((3, 3));"
    "attitude.dcm(np.array([0.5, 0.5, -0.5, 0.5]), m);"
    "print(m.ravel().tolist(), sum(attitude.dcm.stats.cache_hits.values()));"
    "print(*kernel_cache.notes, sep='\\n')"
)
"""A small kernel by itself; whether its code came from the cache."""
RIGHT = "[0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0]"


def result(folder: Path, first: str = "") -> tuple[str, int, str]:
    """The kernel's numbers, how many files of the cache were used, what there was to say."""
    said = printed(first + CODE, folder.parent, {**os.environ, "NUMBA_CACHE_DIR": str(folder)})
    numbers, notes = said.split("\n", 1)
    matrix, _, hits = numbers.rpartition(" ")
    return matrix, int(hits), notes.strip()


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kernels")
    matrix, hits, notes = result(folder)
    assert (matrix, hits, notes) == (RIGHT, 0, "")
    return folder


def test_two_processes_at_once_mix_nothing_up(tmp_path: Path) -> None:
    """What is compiled for one call is never under the name of another, and neither loses what the other kept."""
    kept, other = (kernel_cache._CheckedFiles(open_protected_folder(tmp_path), "f", 0) for _ in range(2))
    assert (kept.load("for one"), other.load("for another")) == (None, None)
    kept.save("for one", "code")
    other.save("for another", "other code")
    assert (kept.load("for one"), kept.load("for another")) == ("code", "other code")


def test_a_file_under_another_name_is_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel_cache, "notes", [])
    kept = kernel_cache._CheckedFiles(open_protected_folder(tmp_path), "f", 0)
    for name in ("one", "another"):
        kept.save(name, name)
    first, second = files(tmp_path)
    first.replace(second)
    assert {kept.load("one"), kept.load("another")} == {None}
    assert len(kernel_cache.notes) == 1
    assert not second.exists()


def files(cache: Path) -> list[Path]:
    return sorted(cache.rglob("*.nbc"))


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:100])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[random.Random(path.name).randrange(len(content))] ^= 16
    path.write_bytes(content)


def emptied(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("damage", [cut, flip, emptied])
def test_a_damaged_file_is_as_if_it_were_not_there(
    damage: Callable[[Path], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kernel_cache, "notes", [])
    kept = kernel_cache._CheckedFiles(open_protected_folder(tmp_path), "f", 0)
    kept.save("one", "code" * 100)
    (file,) = files(tmp_path)
    damage(file)
    assert kept.load("one") is None
    assert len(kernel_cache.notes) == 1
    assert not file.exists()


@pytest.mark.parametrize("damage", in_brief([cut, flip], 1))
def test_damage_is_dropped_and_compiled_again(damage: Callable[[Path], None], cache: Path) -> None:
    assert result(cache) == (RIGHT, 1, "")
    victims = files(cache)
    assert victims
    for victim in victims:
        damage(victim)
    matrix, hits, notes = result(cache)
    assert (matrix, hits) == (RIGHT, 0)
    assert "damaged machine code in" in notes
    assert "was dropped and compiled again" in notes
    assert result(cache) == (RIGHT, 1, "")


def test_a_full_disk_compiles_in_memory(tmp_path: Path) -> None:
    limited = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000));"
    )
    matrix, hits, notes = result(tmp_path, limited)
    assert (matrix, hits) == (RIGHT, 0)
    assert "machine code could not be kept in" in notes
    assert not files(tmp_path)


def test_what_is_kept_is_loaded_without_the_compiler(tmp_path: Path) -> None:
    """Code that makes arrays too; and what is compiled after it, in the same process, is right."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    dops = (
        "import sys; import numpy as np; from navsim.gnss import dop;"
        "up = np.array([[[1.0, 0, 0], [-0.5, 0.8, 0.3], [-0.5, -0.8, 0.3], [0, 0, 1.0], [0.6, 0, 0.8]]]);"
        "print(dop.dops(up, np.zeros(5, dtype=int)).tolist(), 'numba.np.linalg' in sys.modules);"
    )
    said = [
        subprocess.run(
            [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=120, check=True
        ).stdout.splitlines()
        for code in (dops, dops + CODE)
    ]
    (compiled,), (loaded, *others) = said
    assert compiled.endswith("True")
    assert loaded == compiled.replace("True", "False")
    assert others[0] == f"{RIGHT} 0"


def test_what_was_loaded_is_loaded_ahead_the_next_time(cache: Path, tmp_path: Path) -> None:
    """Without being called; of a list that is damaged or not there, nothing."""
    memo = tmp_path / "complete-work"
    opening = (
        "from pathlib import Path; from navsim.compiler.protected_folder import open_protected_folder;"
        f"folder = open_protected_folder(Path({str(tmp_path)!r}));"
    )

    def writing(all_of_it: bool) -> str:
        return CODE + f"; {opening} kernel_cache.remember(folder, {memo.name!r}, {all_of_it})"

    loading = (
        f"from navsim.compiler import kernel_cache; from navsim.geodesy import attitude_kernels as attitude; {opening}"
        f"kernel_cache.load_remembered(folder, {memo.name!r}); print(len(attitude.dcm.overloads))"
    )

    def said(code: str) -> str:
        return printed(code, tmp_path, {**os.environ, "NUMBA_CACHE_DIR": str(cache)}).strip()

    said(writing(all_of_it=False))  # other work was done before: whose kernels they are is not known
    assert memo.exists()
    assert said(loading) == "0"
    said(writing(all_of_it=True))
    assert said(loading) == "1"
    flip(memo)
    assert said(loading) == "0"
    assert not memo.exists()


def test_without_the_linker_numba_compiles_the_same(tmp_path: Path) -> None:
    code = (
        "import numpy as np; from navsim.compiler import linker\n"
        "from navsim.geodesy import attitude_kernels as attitude\n"
        "q = np.array([1.0, 0.0, 0.0, 0.0]); attitude.rotate_in_nav_axes(q, 0.2, 0.1, -0.3)\n"
        "print(linker.LINKED); print(q.tobytes().hex())"
    )
    said = []
    for switch in ("on", "off", "off"):  # compiled, then from the cache
        own = {"NUMBA_CACHE_DIR": str(tmp_path), "NAVSIM_LINKER": switch}
        said.append(printed(code, tmp_path, os.environ | own).splitlines())
    assert [lines[0] for lines in said] == ["True", "False", "False"]
    assert len({lines[-1] for lines in said}) == 1


def test_what_kernels_call_is_a_piece_of_them(tmp_path: Path) -> None:
    """It has no machine code of its own, is kept, taken over by other kernels, and compiled when Python calls it."""
    code = (
        "import numpy as np; from navsim.compiler.kernel_pieces import is_piece\n"
        "from navsim.geodesy import attitude_kernels as attitude\n"
        "kinds = lambda: [is_piece(one) for one in attitude.half_sinc.overloads.values()]\n"
        "q = np.array([1.0, 0.0, 0.0, 0.0]); attitude.{}(q, 0.2, 0.0, 0.0)\n"
        "print(kinds(), sum(attitude.half_sinc.stats.cache_hits.values()), q.tolist())\n"
        "made = attitude.half_sinc(0.04)\n"
        "print(kinds(), np.allclose(made, (np.sin(0.1) / 0.2, np.cos(0.1)), rtol=1e-15))"
    )
    right = [math.cos(0.1), math.sin(0.1), 0.0, 0.0]
    for name, hits in (("rotate_in_nav_axes", 0), ("rotate_in_nav_axes", None), ("rotate_in_body_axes", 1)):
        said = printed(code.format(name), tmp_path, {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)})
        first, second = said.splitlines()
        kinds, rest = first.split("]", 1)
        count, numbers = rest.split("[")
        # a kernel that is loaded needs no pieces
        assert (kinds, int(count)) == (("[True", hits) if hits is not None else ("[", 0))
        np.testing.assert_allclose([float(number) for number in numbers.rstrip("]").split(",")], right, atol=1e-15)
        assert second == "[False] True"


@pytest.mark.parametrize(
    ("file", "old", "new", "right", "hits"),
    in_brief(
        [
            ("trajectory/path.py", '"""', '"""Another text. ', RIGHT, 1),
            ("geodesy/attitude_kernels.py", '"""', '"""Another text. ', RIGHT, 1),
            ("geodesy/attitude_kernels.py", "2.0 * (", "3.0 * (", None, 0),
            ("compiler/lanes.py", '"""', '"""Another text. ', RIGHT, 0),
        ],
        0,
        2,
    ),
)
def test_another_version_compiles_what_has_changed(
    file: str, old: str, new: str, right: str | None, hits: int, cache: Path, tmp_path: Path
) -> None:
    """What a kernel reaches decides, a number: not words, other rooms, nor where the sources lie."""
    fresh = tmp_path / "cache"
    shutil.copytree(cache, fresh)
    shutil.copytree(Path(navsim.__file__).parent, tmp_path / "navsim", ignore=shutil.ignore_patterns("__pycache__"))
    changed = tmp_path / "navsim" / file
    assert old in changed.read_text()
    changed.write_text(changed.read_text().replace(old, new, 1 if '"' in old else -1))
    there = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import navsim; assert '{tmp_path}' in navsim.__file__;"
    matrix, loaded, notes = result(fresh, there)
    assert (loaded, notes) == (hits, "")
    assert matrix == right if right is not None else matrix != RIGHT
    assert len(list(fresh.glob("kernels-*"))) == 2
    assert result(fresh, there) == (matrix, 1, "")


def test_every_kernel_can_be_followed() -> None:
    """And a kernel's digest is its own, or that of one with the same name and code."""
    kernels = [
        value
        for room in jit.KERNEL_ROOMS
        for found in pkgutil.walk_packages([str(Path(navsim.__file__).parent / room)], f"navsim.{room}.")
        for value in vars(import_module(found.name)).values()
        if isinstance(value, Dispatcher) and value.py_func.__module__ == found.name
    ]
    assert len(kernels) > 150
    digests = [kernel_parts.digest(each.py_func, (), jit._OVERLOADS, "") for each in kernels]
    assert None not in digests
    assert len(set(digests)) == len({each.py_func for each in kernels})


def test_constants_of_modules_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Arrays and tuples that a kernel reads from another module, and named tuples by their fields."""
    made: dict[str, Any] = {"attitude": attitude, "__name__": "navsim.geodesy.made"}
    exec("def read(): return attitude.TABLE[0]", made)
    digests = []
    for table in (np.arange(3.0), np.arange(1.0, 4.0), (1, 2), namedtuple("Pair", "a b")(1, 2)):
        monkeypatch.setattr(attitude, "TABLE", table, raising=False)
        digests.append(kernel_parts.digest(made["read"], (), {}, ""))
    assert None not in digests
    assert len(set(digests)) == len(digests)


def test_the_order_of_fields_counts_and_the_module() -> None:
    """Of two tuples with other names for the same types the type's name tells nothing. And code names its tuples by
    their modules: that of a class which was moved cannot be loaded."""
    first, second, moved = (
        types.NamedUniTuple(types.float64, 2, namedtuple("Pair", fields, module=module))
        for fields, module in (("ab", "navsim.one"), ("ba", "navsim.one"), ("ab", "navsim.other"))
    )
    kernel = attitude.dcm.py_func
    assert str(first) == str(second) == str(moved)
    assert len({kernel_parts.digest(kernel, (pair,), {}, "") for pair in (first, second, moved)}) == 3


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_a_cache_of_somebody_else_is_not_run(cache: Path, tmp_path: Path) -> None:
    copied = tmp_path / "cache"
    shutil.copytree(cache, copied)
    (folder,) = copied.glob("kernels-*")
    os.chown(folder, 12345, 12345)
    assert result(copied)[:2] == (RIGHT, 0)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_parts_of_somebody_else_are_not_run(cache: Path, tmp_path: Path) -> None:
    copied = tmp_path / "cache"
    shutil.copytree(cache, copied)
    (folder,) = copied.glob("kernels-*")
    shutil.rmtree(folder)
    os.chown(copied / "parts", 12345, 12345)
    assert result(copied)[:2] == (RIGHT, 0)


PLACE = (
    "import json; from navsim.compiler import jit;"
    "print(json.dumps([str(jit._FOLDERS and jit._FOLDERS.version), jit.compiling()]))"
)


def place(setting: dict[str, str], tmp_path: Path, first: str = "") -> tuple[str, str]:
    """Where machine code is kept, and what is said before kernels are compiled."""
    left = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    folder, words = json.loads(printed(first + PLACE, tmp_path, left | setting))
    return folder, words


def test_where_machine_code_is_kept(tmp_path: Path) -> None:
    """Below home, in the folder that is given, from home where it says so; in words, the whole path."""
    home = {"HOME": str(tmp_path)}
    for setting, base in (
        (home, tmp_path / ".cache" / "navsim"),
        (home | {"NUMBA_CACHE_DIR": "~/own"}, tmp_path / "own"),
        (home | {"NUMBA_CACHE_DIR": "own"}, Path.cwd() / "own"),
    ):
        folder, words = place(setting, tmp_path)
        try:
            assert Path(folder).parent == base
            assert Path(folder).stat().st_mode & 0o777 == 0o700
            assert words.endswith(f"the next computation finds them in {folder}")
        finally:
            shutil.rmtree(base, ignore_errors=True)


def test_where_none_can_be_kept_the_reason_is_said(tmp_path: Path) -> None:
    """No home, a file in place of a folder, a folder that can only be read: which is used."""
    nobody = "import os; os.path.expanduser = lambda path: path;"
    always = "compiling the kernels, about a minute at every start: "
    assert place({}, tmp_path, nobody) == ("None", f"{always}no home folder is known, set NUMBA_CACHE_DIR")
    blocked = tmp_path / "file"
    blocked.write_text("")
    folder, words = place({"NUMBA_CACHE_DIR": str(blocked)}, tmp_path)
    assert folder == "None"
    assert f"{blocked}/kernels-" in words
    assert "Not a directory" in words
    reading = "import os; os.access = lambda *_, **__: False;"
    folder, words = place({"NUMBA_CACHE_DIR": str(tmp_path)}, tmp_path, reading)
    assert folder.startswith(str(tmp_path))
    assert words == f"{always}{folder} cannot be written, set NUMBA_CACHE_DIR to one that can"


def test_a_cache_below_a_folder_of_others_is_not_run(cache: Path, tmp_path: Path) -> None:
    """Whoever can write a folder above could exchange all below; the message names it and says what to write."""
    above = tmp_path / "above"
    above.mkdir()
    shutil.copytree(cache, above / "cache")
    above.chmod(0o777)
    said = "from navsim.compiler import jit, kernel_cache; kernel_cache.note(jit.compiling());"
    assert result(above / "cache", said) == (
        RIGHT,
        0,
        f"compiling the kernels, about a minute at every start: {above} can be written by everybody (mode 777), so the "
        f"machine code below {above}/cache might not be yours; set NUMBA_CACHE_DIR to a folder that only you can "
        "change, such as one of `mktemp -d`",
    )
