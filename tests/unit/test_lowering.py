"""Kernels whose variables are values instead of memory compute and free what numba's own do."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numba
import numpy as np
import pytest
from numba.core.runtime import _nrt_python
from numba.core.runtime.nrt import rtsys

from navsim.compiler.kernel_pieces import Kernel, KernelCompiler


class Pair(NamedTuple):
    """Two arrays."""

    first: np.ndarray
    second: np.ndarray


def compiled(function: Callable[..., object]) -> Kernel:
    return Kernel(function, targetoptions={"nopython": True}, pipeline_class=KernelCompiler)


@compiled
def changed(pair, n):
    """Once assigned, from before a loop; assigned in it; by branches; and an argument with a new value."""
    scale = pair.first[0] * 2.0
    last = -1.0
    for i in range(n):
        row = pair.second[i]
        if row[0] > 1.0:
            step = row[0] * scale
            if step > 3.0:
                step -= 1.0
                last = step
        else:
            last += scale
        row[1] = last
    n += 1
    pair.first[1] = scale + n
    return last


def whole(n):
    """Calls a kernel with its own arrays; returns one of them, a part of it, and an argument."""
    made = np.zeros((4, 2))
    for i in range(4):
        made[i, 0] = i
    pair = Pair(np.ones(2), made)
    last = changed(pair, n)
    return made, made[1:], last, pair


def given(array):
    """Returns its argument."""
    if array.shape[0] > 1:
        part = array[1:]
        part[0] = 7.0
    return array


def test_variables_of_several_blocks_have_their_values() -> None:
    """Alike with numba's own lowering."""
    own = numba.njit(changed.py_func)
    for n in (0, 1, 4):
        results = []
        for kernel in (changed, own):
            pair = Pair(np.array([1.5, 0.0]), np.array([[0.5, 0.0], [2.0, 0.0], [1.0, 0.0], [3.0, 0.0]]))
            results.append((kernel(pair, n), pair.first.tolist(), pair.second.tolist()))
        assert results[0] == results[1]


@pytest.fixture
def counted() -> Iterator[None]:
    """numba counts what it allocates and frees."""
    _nrt_python.memsys_enable_stats()
    yield
    gc.unfreeze()
    _nrt_python.memsys_disable_stats()


@pytest.mark.usefixtures("counted")
def test_arrays_are_freed_once() -> None:
    """Those that a kernel makes, gives to another, returns, and those of its caller."""
    make, hand_back = compiled(whole), compiled(given)
    for _ in range(2):  # the first call compiles
        gc.freeze()  # garbage is looked for among what is made from here on
        before = rtsys.get_allocation_stats()
        made, part, last, pair = make(4)
        array = hand_back(np.zeros(3))
        assert array.tolist() == [0.0, 7.0, 0.0]
        assert (made[1:] == part).all()
        assert pair.second is not None
        assert last == made[3, 1] == 5.0
        del made, part, pair, array
        gc.collect()
        after = rtsys.get_allocation_stats()
    assert after.alloc - before.alloc == after.free - before.free > 0
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free > 0
