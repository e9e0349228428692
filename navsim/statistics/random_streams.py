"""Random numbers keyed by (root seed, run, stream): they depend on nothing else."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

STREAMS = {
    "initial": 0,
    "imu": 1,
    "measurements": 2,
    "elevation": 3,
    "plots": 4,
    "onboard": 5,
    "space": 6,
    "carrier": 7,
    "aids": 8,
    "tilt": 9,
    "subsets": 10,
    "clock": 11,
    "integrity": 12,
    "lasting": 13,
    "air": 14,
    "fix": 15,
    "corrections": 16,
}
"""Random streams of a run. A stream's number never changes when others are added."""


def generator(seed: int, run: int, stream: str, *branch: int) -> np.random.Generator:
    """The random numbers of one stream of one run, or of a branch of it."""
    key = (run, STREAMS[stream], *branch)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=key)))


def branch(rng: np.random.Generator, *number: int) -> np.random.Generator:
    """The branch of a stream that `generator` would give by these numbers, from the stream's own generator."""
    seeds = rng.bit_generator.seed_seq
    assert isinstance(seeds, np.random.SeedSequence)
    own = np.random.SeedSequence(seeds.entropy, spawn_key=(*seeds.spawn_key, *number))
    return np.random.Generator(np.random.PCG64(own))


def normals(rngs: Sequence[np.random.Generator], *shape: int) -> np.ndarray:
    """Standard normal numbers (r, ...) of r streams."""
    from navsim.statistics.noise import draw_normals  # compiled code only when something is drawn

    out = np.empty((len(rngs), math.prod(shape)))
    for rng, own in zip(rngs, out, strict=True):
        draw_normals(rng, own)
    return out.reshape(len(rngs), *shape)
