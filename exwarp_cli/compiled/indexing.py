"""How elements and rows of arrays are found, in as few instructions as that takes.

Numba copies all that it knows of an array to memory at each use, and takes out what it needs there.
LLVM finds out that none of it is wanted: a fifth of all instructions that it was handed.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.core.cgutils import pack_array
from numba.core.imputils import impl_ret_borrowed
from numba.cpython import slicing
from numba.extending import lower_builtin
from numba.np import arrayobj

from exwarp_cli.compiled.folding import known
from exwarp_cli.compiled.front_end import wrap

# As numba has no types of its own.
_getitem: Any = arrayobj.getitem_arraynd_intp
_getitem_tuple: Any = arrayobj.getitem_array_tuple
_setitem: Any = arrayobj.setitem_array
_reshaped: Any = arrayobj.array_reshape_vararg
_checked: Any = arrayobj.fix_integer_index
_borrowed: Any = impl_ret_borrowed
_packed: Any = pack_array
_Tuple: Any = types.BaseTuple
_many: Any = types.VarArg
_slicing: Any = slicing
_wrapped: Any = _slicing.fix_index

LAST = types.intp.maxval
"""What stands for the end of an array in a slice that names none."""


def shorten() -> None:
    """Have arrays indexed so from now on, in all that is compiled."""
    lower: Any = lower_builtin
    lower(operator.getitem, types.Array, types.Integer)(_get)
    lower(operator.getitem, types.Array, types.SliceType)(_get)
    lower(operator.getitem, types.Array, types.BaseTuple)(_get)
    lower(operator.setitem, types.Array, types.Any, types.Any)(_set)
    lower("array.reshape", types.Array, _many(types.Any))(_reshape)
    wrap(slicing, "fix_slice", _bounding)
    wrap(slicing, "get_slice_length", _counting)


def _get(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Return an element, or what fewer indices than dimensions, or a slice, leave."""
    kind, index = signature.args
    if not _is_plain(context, kind, _without_slice(index, signature.return_type)):
        usual = _getitem_tuple if isinstance(index, _Tuple) else _getitem
        return usual(context, builder, signature, arguments)
    place, shape = _place(context, builder, kind, index, arguments)
    if not shape:
        return context.unpack_value(builder, kind.dtype, place)
    view = _view(context, builder, signature, arguments[0], place, shape)
    return _borrowed(context, builder, signature.return_type, view)


def _reshape(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Return an array of another shape: row by row, all of it is one row as it stands."""
    kind, *sizes = signature.args
    if kind.layout != "C" or len(sizes) > 1 or known(arguments[1]) != -1:
        return _reshaped(context, builder, signature, arguments)
    array = arguments[0]
    place, count = (_field(context, builder, kind, array, name) for name in ("data", "nitems"))
    view = _view(context, builder, signature, array, place, [count])
    return _borrowed(context, builder, signature.return_type, view)


def _set(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write an element."""
    kind, index, value = signature.args
    numbers = _indices(index)
    if not _is_plain(context, kind, numbers) or len(numbers) < kind.ndim:
        return _setitem(context, builder, signature, arguments)
    place, _ = _place(context, builder, kind, index, arguments)
    written = context.cast(builder, arguments[2], value, kind.dtype)
    context.pack_value(builder, kind.dtype, written, place)
    return None


def _indices(index: Any) -> tuple[Any, ...]:
    """Return the types of the indices, one or a tuple of them."""
    return tuple(index.types) if isinstance(index, _Tuple) else (index,)


def _without_slice(index: Any, result: Any) -> tuple[Any, ...]:
    """Return the types of the indices, of a last slice that leaves nothing out that of its begin.

    What it leaves lies row by row.
    """
    *before, last = _indices(index) or (None,)
    if isinstance(last, types.SliceType) and not last.has_step and result.layout == "C":
        last = types.intp
    return (*before, last)


def _is_plain(context: Any, kind: Any, numbers: Sequence[Any]) -> bool:
    """Whether an array lies row by row, and is asked for by whole numbers alone."""
    return (
        type(kind) is types.Array
        and kind.layout == "C"
        and kind.aligned
        and not context.enable_boundscheck
        and 0 < len(numbers) <= kind.ndim
        and all(isinstance(number, types.Integer) for number in numbers)
    )


def _field(context: Any, builder: Any, kind: Any, array: Any, name: str) -> Any:
    """Return what an array's value says of it."""
    return builder.extract_value(array, context.data_model_manager[kind].get_field_position(name))


def _parts(builder: Any, values: Any) -> list[Any]:
    """Return the single ones of several values."""
    return [builder.extract_value(values, k) for k in range(len(values.type))]


def _place(
    context: Any, builder: Any, kind: Any, index: Any, arguments: Any
) -> tuple[Any, list[Any]]:
    """Return where it is, and the sizes of the dimensions that are left, or that a slice leaves."""
    array, given = arguments[:2]
    sizes = _parts(builder, _field(context, builder, kind, array, "shape"))
    numbers = _indices(index)
    values = _parts(builder, given) if isinstance(index, _Tuple) else [given]
    left = sizes[len(numbers) :]
    at: Any = None
    for k, (number, value) in enumerate(zip(numbers, values, strict=True)):
        if isinstance(number, types.SliceType):
            part = context.make_helper(builder, number, value)
            _slicing.fix_slice(builder, part, sizes[k])
            step, left = part.start, [_slicing.get_slice_length(builder, part), *left]
        else:
            step = _checked(context, builder, number, value, sizes[k])
        if sizes[k + 1 :]:
            step = builder.mul(step, functools.reduce(builder.mul, sizes[k + 1 :]))
        at = step if at is None else builder.add(at, step)
    data = _field(context, builder, kind, array, "data")
    return builder.gep(data, [at]), left


def _view(
    context: Any, builder: Any, signature: Any, array: Any, place: Any, shape: Sequence[Any]
) -> Any:
    """Return the array that begins there."""
    kind, result = signature.args[0], signature.return_type
    count = shape[0]
    for size in shape[1:]:
        count = builder.mul(count, size, flags=["nsw"])
    strides = _parts(builder, _field(context, builder, kind, array, "strides"))
    fields = {
        "meminfo": _field(context, builder, kind, array, "meminfo"),
        "parent": _field(context, builder, kind, array, "parent"),
        "nitems": count,
        "itemsize": _field(context, builder, kind, array, "itemsize"),
        "data": place,
        "shape": _packed(builder, shape),
        "strides": _packed(builder, strides[-len(shape) :]),
    }
    model = context.data_model_manager[result]
    view = ir.Constant(model.get_value_type(), ir.Undefined)
    for name, value in fields.items():
        view = builder.insert_value(view, value, model.get_field_position(name))
    return view


def _bounding(bound: Callable[..., None]) -> Callable[..., None]:
    """Put a slice's ends into an array without branches, where it leaves nothing out."""

    def bounding(builder: Any, part: Any, size: Any) -> None:
        if known(part.step) != 1:
            _ = part._value  # branches will write into it
            bound(builder, part, size)
            return
        part.start = _within(builder, part.start, size)
        part.stop = _within(builder, part.stop, size)

    return bounding


def _counting(count: Callable[..., Any]) -> Callable[..., Any]:
    """Return how long a slice is, without divisions where it leaves nothing out."""

    def counting(builder: Any, part: Any) -> Any:
        if known(part.step) != 1:
            return count(builder, part)
        length = builder.sub(part.stop, part.start)
        if known(part.start) == 0:
            return length
        nothing = length.type(0)
        return builder.select(builder.icmp_signed("<=", length, nothing), nothing, length)

    return counting


def _within(builder: Any, end: Any, size: Any) -> Any:
    """Return an end of a slice between the ends of an array."""
    number = known(end)
    if number == 0 or end is size:
        return end
    if number == LAST:
        return size
    nothing = end.type(0)
    end = _wrapped(builder, end, size)
    end = builder.select(builder.icmp_signed("<", end, nothing), nothing, end)
    return builder.select(builder.icmp_signed(">=", end, size), size, end)
