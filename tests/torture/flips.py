"""Results with flipped bytes: each command refuses them, or gives what it gives for the sound file."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.forks import HANG_S, Forks

LOOKS: dict[str, tuple[object, ...]] = {
    "show": ("show", "r.h5"),
    "show --json": ("show", "r.h5", "--json"),
    "export --csv": ("export", "r.h5", "--csv", "-o", "out"),
}


def _one_bit(content: bytearray, draw: random.Random) -> None:
    content[draw.randrange(len(content))] ^= 1 << draw.randrange(8)


def _bytes(content: bytearray, draw: random.Random) -> None:
    for _ in range(draw.choice((2, 8, 64))):
        content[draw.randrange(len(content))] = draw.randrange(256)


def _zeros(content: bytearray, draw: random.Random) -> None:
    """As after a power cut."""
    start = draw.randrange(len(content))
    size = min(draw.choice((16, 512, 4096)), len(content) - start)
    content[start : start + size] = bytes(size)


def _cut(content: bytearray, draw: random.Random) -> None:
    del content[draw.randrange(len(content)) :]


def _moved(content: bytearray, draw: random.Random) -> None:
    """Two blocks in each other's place."""
    size = 4096
    i, j = (draw.randrange(max(1, len(content) // size)) * size for _ in range(2))
    content[i : i + size], content[j : j + size] = content[j : j + size], content[i : i + size]


DAMAGES: list[Callable[[bytearray, random.Random], None]] = [_one_bit, _one_bit, _one_bit, _bytes, _zeros, _cut, _moved]


def flipped(commands: Forks, sound: Path, folder: Path, seed: int) -> Iterator[tuple[str, str | None, bool]]:
    """Without end: what was done and looked at, what was wrong (None for all in order), whether it was refused.

    sound: a result in order. folder: to work in, empty.
    """
    draw = random.Random(seed)
    content = sound.read_bytes()
    wanted: dict[str, tuple[str, dict[str, bytes]]] = {}
    for name, words in LOOKS.items():
        (folder / "r.h5").write_bytes(content)
        wanted[name] = (commands.run(*words, cwd=folder).out, _written(folder))
    while True:
        damage = draw.choice(DAMAGES)
        damaged = bytearray(content)
        damage(damaged, draw)
        (folder / "r.h5").write_bytes(damaged)
        name = draw.choice(sorted(LOOKS))
        done = commands.run(*LOOKS[name], cwd=folder, limit_s=HANG_S)
        wrong = done.failure((0, 2))
        if done.code == 0 and (done.out, _written(folder)) != wanted[name]:
            wrong = "other numbers shown as sound"
        _written(folder)
        yield f"{damage.__name__.strip('_')}, {name}", wrong, done.code == 2


def _written(folder: Path) -> dict[str, bytes]:
    """The files beside the result, which are taken away."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != "r.h5":
            found[path.name] = path.read_bytes()
            path.unlink()
    return found
