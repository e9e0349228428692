"""SIMD lanes: a number in a kernel is a register of W runs.

A kernel with arrays of lanes reads like one for a single run, and computes W of them. Every operation works lane by
lane, in the order of the source. The bits of a run depend neither on W nor on the other lanes: differences between runs
are masks (`where`), never branches. A branch may only skip work whose result no lane uses (`any_lane`), or that adds
zero to finite numbers. With arrays of float64 the same source is the kernel of one run with the same bits.

Outside kernels, lanes are float64 arrays whose last axis, of length W, is the lane: (..., W). `in_lanes` passes them to
a kernel, `as_simd` receives them there, `alloc` allocates work space.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import llvmlite.binding
import numba.extending
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.arraydecl import GetItemBuffer, SetItemBuffer
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import models, register_model
from numba.np.arrayobj import populate_array

_Function = Callable[..., Any]


def _intrinsic(function: _Function) -> _Function:
    """A piece of code for LLVM that kernels can call."""
    made: _Function = numba.extending.intrinsic(function)
    return made


def _literal_intrinsic(function: _Function) -> _Function:
    """Intrinsic whose numbers are literals."""
    made: _Function = numba.extending.intrinsic(prefer_literal=True)(function)
    return made


def _lower(symbol: Any, *kinds: Any) -> Callable[[_Function], _Function]:
    """The code of an operation on arguments of these types."""
    decorator: Callable[[_Function], _Function] = numba.extending.lower_builtin(symbol, *kinds)
    return decorator


def _cast(source: Any, target: Any) -> Callable[[_Function], _Function]:
    """The code of a conversion."""
    decorator: Callable[[_Function], _Function] = numba.extending.lower_cast(source, target)
    return decorator


WIDTHS = (4, 8)
"""Widths that a register can be given."""


def _width_of_processor() -> int:
    """Lanes of a register: those of AVX-512 if the processor has it, else those of AVX2."""
    return 8 if llvmlite.binding.get_host_cpu_features().get("avx512f", False) else 4


WIDTH = _width_of_processor()
"""Lanes that fly at once on this processor."""


def in_lanes(array: np.ndarray) -> np.ndarray:
    """A C-contiguous float64 array (..., W) as kernels take it, (...); the memory is shared. Raises ValueError for one
    that is not, and for a W that is none of `WIDTHS`."""
    if not array.flags.c_contiguous or array.dtype != np.float64 or array.shape[-1] not in WIDTHS:
        raise ValueError(f"no lanes: {array.dtype} {array.shape}, strides {array.strides}")
    dtype = np.dtype([("lane", np.float64, (array.shape[-1],))])
    return array.view(dtype)[..., 0]


class Lanes(types.Type):
    """W numbers."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"lanes{width}")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Any:
        """A number is broadcast to every lane."""
        return Conversion.safe if isinstance(other, (types.Float, types.Integer)) else None

    def unify(self, typingctx: Any, other: types.Type) -> types.Type | None:
        """A variable may be a number first and lanes later."""
        return self if isinstance(other, (types.Float, types.Integer)) else None


class LaneMask(types.Type):
    """W truth values."""

    def __init__(self, width: int) -> None:
        self.width = width
        super().__init__(name=f"mask{width}")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Any:
        """A truth value is broadcast to every lane."""
        return Conversion.safe if isinstance(other, types.Boolean) else None

    def unify(self, typingctx: Any, other: types.Type) -> types.Type | None:
        """A variable may be a truth value first and a mask later."""
        return self if isinstance(other, types.Boolean) else None


def _vector(width: int) -> ir.VectorType:
    return ir.VectorType(ir.DoubleType(), width)


@register_model(Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, frontend: Lanes) -> None:
        super().__init__(manager, frontend, _vector(frontend.width))


@register_model(LaneMask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, frontend: LaneMask) -> None:
        super().__init__(manager, frontend, ir.VectorType(ir.IntType(1), frontend.width))


@_cast(types.Float, Lanes)
@_cast(types.Integer, Lanes)
def _splat(context: Any, builder: Any, fromty: Any, toty: Lanes, value: Any) -> Any:
    number = context.cast(builder, value, fromty, types.float64)
    if isinstance(number, ir.Constant):
        return ir.Constant(_vector(toty.width), [number.constant] * toty.width)
    one = builder.insert_element(ir.Constant(_vector(toty.width), ir.Undefined), number, ir.IntType(32)(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), toty.width), [0] * toty.width))


@_cast(types.Boolean, LaneMask)
def _splat_truth(context: Any, builder: Any, fromty: Any, toty: LaneMask, value: Any) -> Any:
    vector = ir.VectorType(ir.IntType(1), toty.width)
    return builder.select(value, ir.Constant(vector, [1] * toty.width), ir.Constant(vector, [0] * toty.width))


_FIRST = {"target": "cpu"}
"""Has numba ask a template before its own, which are for any target: most of the time of typing went into asking them
all."""


@infer_global(operator.getitem)
class _ElementTemplate(GetItemBuffer):
    """numba's own rule for arrays, asked first, by whatever this process compiles."""

    metadata = _FIRST


@infer_global(operator.setitem)
class _AssignmentTemplate(SetItemBuffer):
    """numba's own rule for arrays, asked first, by whatever this process compiles."""

    metadata = _FIRST


def _lanes_among(args: tuple[types.Type, ...]) -> Lanes | None:
    """Type of the lanes among arguments, None without lanes, or with anything but numbers beside them."""
    found = {a for a in args if isinstance(a, Lanes)}
    if len(found) != 1 or not all(isinstance(a, (Lanes, types.Float, types.Integer)) for a in args):
        return None
    return found.pop()


def _define(symbol: Any, count: int, build: Callable[..., Any], to_mask: bool = False) -> None:
    """Let lanes, with numbers among them, take part in an operation of `count` arguments."""

    @infer_global(symbol)
    class _LanesTemplate(AbstractTemplate):
        metadata = _FIRST

        def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
            lanes = _lanes_among(args)
            if lanes is None or len(args) != count or kws:
                return None
            return signature(LaneMask(lanes.width) if to_mask else lanes, *([lanes] * count))

    @_lower(symbol, *([Lanes] * count))
    def _code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return build(builder, *args)


def _intrinsic_call(name: str) -> Callable[..., Any]:
    def build(builder: Any, *args: Any) -> Any:
        vector = args[0].type
        kind = ir.FunctionType(vector, [vector] * len(args))
        return builder.call(
            cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{vector.count}f64"), args
        )

    return build


def _compare(symbol: str) -> Callable[..., Any]:
    compare = "fcmp_unordered" if symbol == "!=" else "fcmp_ordered"
    return lambda builder, a, b: getattr(builder, compare)(symbol, a, b)


for _symbols, _name in (
    ((operator.add, operator.iadd), "fadd"),
    ((operator.sub, operator.isub), "fsub"),
    ((operator.mul, operator.imul), "fmul"),
    ((operator.truediv, operator.itruediv), "fdiv"),
):
    for _symbol in _symbols:
        _define(_symbol, 2, lambda builder, a, b, name=_name: getattr(builder, name)(a, b))
_define(operator.neg, 1, lambda builder, a: builder.fneg(a))
for _symbol, _text in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
    (operator.ne, "!="),
):  # fmt: skip
    _define(_symbol, 2, _compare(_text), to_mask=True)
_define(math.sqrt, 1, _intrinsic_call("sqrt"))
_define(math.floor, 1, _intrinsic_call("floor"))
_define(abs, 1, _intrinsic_call("fabs"))
_define(math.isnan, 1, lambda builder, a: builder.fcmp_unordered("uno", a, a), to_mask=True)


def _define_logic(symbol: Any, count: int, build: Callable[..., Any]) -> None:
    """Let masks take part in an operation of `count` arguments."""

    @infer_global(symbol)
    class _MaskTemplate(AbstractTemplate):
        metadata = _FIRST

        def generic(self, args: tuple[types.Type, ...], kws: Any) -> Any:
            if len(args) == count and isinstance(args[0], LaneMask) and all(a == args[0] for a in args):
                return signature(args[0], *args)
            return None

    @_lower(symbol, *([LaneMask] * count))
    def _code(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return build(builder, *args)


for _symbols, _name in (((operator.and_, operator.iand), "and_"), ((operator.or_, operator.ior), "or_")):
    for _symbol in _symbols:
        _define_logic(_symbol, 2, lambda builder, a, b, name=_name: getattr(builder, name)(a, b))


@_intrinsic
def where(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """In each lane `a` where the mask is true, else `b`. Both have been computed."""
    kind = Lanes(mask.width) if isinstance(mask, LaneMask) else _lanes_among((a, b)) or types.float64

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(*args)

    return kind(mask, kind, kind), gen


@_intrinsic
def any_lane(typing: Any, mask: Any) -> Any:
    """Whether a mask is true in any lane; if not, its result need not be computed."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if not isinstance(sig.args[0], LaneMask):
            return args[0]
        bits = builder.bitcast(args[0], ir.IntType(sig.args[0].width))
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(mask), gen


@_intrinsic
def no(typing: Any, mask: Any) -> Any:
    """The mask that is true where this one is not."""

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.not_(args[0])

    return mask(mask), gen


@_intrinsic
def fma(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once."""
    kind = _lanes_among((a, b, c)) or types.float64

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if isinstance(sig.return_type, Lanes):
            return _intrinsic_call("fma")(builder, *args)
        return builder.fma(*args)

    return kind(kind, kind, kind), gen


@_intrinsic
def power_of_two(typing: Any, exponent: Any) -> Any:
    """2 to a whole number between -1022 and 1023, given as float64 or lanes."""
    kind = exponent if isinstance(exponent, Lanes) else types.float64

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        whole: Any = ir.IntType(64)
        bias: Any = ir.Constant(whole, 1023)
        shift: Any = ir.Constant(whole, 52)
        if isinstance(sig.return_type, Lanes):
            width = sig.return_type.width
            whole = ir.VectorType(whole, width)
            bias, shift = ir.Constant(whole, [1023] * width), ir.Constant(whole, [52] * width)
        bits = builder.shl(builder.add(builder.fptosi(args[0], whole), bias), shift)
        return builder.bitcast(bits, args[0].type)

    return kind(kind), gen


def array_type(width: int, dimensions: int) -> Any:
    """numba type of an array of lanes."""
    # numpy aligns arrays to a number, not to a register
    return types.Array(Lanes(width), dimensions, types.float64[::1].layout, aligned=False)


def _fill_array(context: Any, builder: Any, kind: Any, data: Any, meminfo: Any, shape: Any) -> Any:
    """An array over `data`, which lives as long as meminfo."""
    array = context.make_array(kind)(context, builder)
    element = context.get_data_type(kind.dtype)
    size = context.get_abi_sizeof(element)
    strides: list[Any] = []
    step = ir.Constant(ir.IntType(64), size)
    for extent in reversed(shape):
        strides.insert(0, step)
        step = builder.mul(step, extent)
    populate_array(
        array,
        data=builder.bitcast(data, element.as_pointer()),
        shape=shape,
        strides=strides,
        itemsize=ir.Constant(ir.IntType(64), size),
        meminfo=meminfo,
    )
    return array._getvalue()


def _counted(context: Any, builder: Any, kind: Any, array: Any) -> Any:
    """An array with one reference more, in kernels that count them."""
    if context.enable_nrt:
        context.nrt.incref(builder, kind, array)
    return array


@_intrinsic
def as_simd(typing: Any, array: Any) -> Any:
    """Array of lanes from `in_lanes`; other arrays are returned unchanged."""
    given = isinstance(array.dtype, types.Record)
    kind = array_type(array.dtype.size // 8, array.ndim) if given else array

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        if sig.return_type == sig.args[0]:
            return _counted(context, builder, sig.return_type, args[0])
        given = context.make_array(sig.args[0])(context, builder, args[0])
        shape = cgutils.unpack_tuple(builder, given.shape, sig.args[0].ndim)
        array = _fill_array(context, builder, sig.return_type, given.data, given.meminfo, shape)
        return _counted(context, builder, sig.return_type, array)

    return kind(array), gen


@_intrinsic
def numbers(typing: Any, array: Any) -> Any:
    """The numbers (..., n W) of a contiguous array of lanes (..., n), in the same memory: where lanes are no runs."""
    kind = types.Array(types.float64, array.ndim, types.float64[::1].layout)

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        given = context.make_array(sig.args[0])(context, builder, args[0])
        shape = cgutils.unpack_tuple(builder, given.shape, sig.args[0].ndim)
        shape[-1] = builder.mul(shape[-1], ir.Constant(ir.IntType(64), sig.args[0].dtype.width))
        out = _fill_array(context, builder, sig.return_type, given.data, given.meminfo, shape)
        return _counted(context, builder, sig.return_type, out)

    return kind(array), gen


def _like(like: Any, dimensions: int) -> Any:
    """Type of a new array with the element type of `like`."""
    if isinstance(like.dtype, Lanes):
        return array_type(like.dtype.width, dimensions)
    return types.Array(like.dtype, dimensions, types.float64[::1].layout)


@_intrinsic
def alloc(typing: Any, like: Any, shape: Any) -> Any:
    """Allocate an array of this shape (a tuple) with the element type of `like`, lanes or numbers; registers are
    aligned."""
    kind = _like(like, len(shape))

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        extents = cgutils.unpack_tuple(builder, args[1], len(sig.args[1]))
        size = ir.Constant(ir.IntType(64), context.get_abi_sizeof(context.get_data_type(sig.return_type.dtype)))
        for extent in extents:
            size = builder.mul(size, extent)
        owner = context.nrt.meminfo_alloc_aligned(builder, size, 64)
        data = context.nrt.meminfo_data(builder, owner)
        return _fill_array(context, builder, sig.return_type, data, owner, extents)

    return kind(like, shape), gen


def _on_stack(context: Any, builder: Any, kind: Any, extents: list[int]) -> Any:
    element = context.get_data_type(kind.dtype)
    data = cgutils.alloca_once(builder, ir.ArrayType(element, math.prod(extents)))
    return _fill_array(context, builder, kind, data, None, [ir.Constant(ir.IntType(64), n) for n in extents])


@_literal_intrinsic
def small_vector(typing: Any, like: Any, size: Any) -> Any:
    """Array of a literal size with the element type of `like`, on the kernel's stack."""
    extents = [size.literal_value]

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _on_stack(context, builder, sig.return_type, extents)

    return _like(like, 1)(like, size), gen


@_literal_intrinsic
def small_matrix(typing: Any, like: Any, rows: Any, columns: Any) -> Any:
    """Array of literally so many rows and columns with the element type of `like`, on the kernel's stack."""
    extents = [rows.literal_value, columns.literal_value]

    def gen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _on_stack(context, builder, sig.return_type, extents)

    return _like(like, 2)(like, rows, columns), gen


BORROWING = frozenset({as_simd, numbers, small_matrix, small_vector})
"""Functions whose arrays have memory that others own, or the kernel's stack."""
