"""Sums over runs are the same to the bit, in whatever pieces the runs come."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from navsim.runner.exact_sums import Sums, blocks


@given(first=st.integers(0, 300), count=st.integers(1, 300))
def test_blocks_cover_the_runs_by_powers_of_two(first: int, count: int) -> None:
    found = blocks(first, count)
    assert [run for start, length in found for run in range(start, start + length)] == list(range(first, first + count))
    assert all(length & (length - 1) == 0 and start % length == 0 for start, length in found)
    assert len(found) <= 2 * count.bit_length()


@given(first=st.integers(0, 100), sizes=st.lists(st.integers(1, 40), min_size=1, max_size=6))
def test_pieces_leave_no_trace(first: int, sizes: list[int]) -> None:
    count = sum(sizes)
    values = np.random.default_rng(count).normal(size=(first + count, 3)) * 10.0 ** np.arange(0, 9, 3)

    def flown(start: int, number: int) -> Sums:
        out = Sums()
        for run in range(start, start + number):
            out.add(run, 1, {"v": values[run]})
        return out

    at_once, pieces, start = flown(first, count), Sums(), first
    for size in sizes:
        pieces.extend(start, size, flown(start, size).arrays())
        start += size
    assert pieces.total("v").tobytes() == at_once.total("v").tobytes()
    assert pieces.arrays()["v"].tobytes() == at_once.arrays()["v"].tobytes()
    np.testing.assert_allclose(at_once.total("v"), values[first:].sum(axis=0), atol=1e-9 * 1e6)
