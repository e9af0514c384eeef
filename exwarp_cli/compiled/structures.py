"""Values of several parts, kept as parts while code is made, not in memory.

Numba gives each array, slice, pair and range that it looks into memory of its own, cleared first,
and reads and writes the parts there; LLVM finds out that no memory is wanted. Here a part that was
put into a value is taken as it is, the value itself is put together only where an instruction wants
all of it, and memory comes only when somebody asks where the value lies, or writes a part of it
elsewhere than where it was made.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from llvmlite.ir.instructions import (  # type: ignore[import-untyped]
    ExtractValue,
    InsertValue,
    PhiInstr,
)
from numba.core import cgutils, types
from numba.core.runtime.context import NRTContext
from numba.np import arrayobj

from exwarp_cli.compiled.front_end import wrap

KINDS = (types.Array, types.Pair, types.RangeType, types.RangeIteratorType, types.SliceType)
"""Types whose parts numba writes one after the other where it makes a value."""

# As numba has no types of its own.
_Proxy: Any = cgutils.ValueStructProxy


def shorten() -> None:
    """Have values made and taken apart so from now on."""
    builder: Any = ir.IRBuilder
    builder.insert_value = insert_value
    builder.extract_value = extract_value
    wrap(builder, "_insert", _putting_together)
    wrap(cgutils, "create_struct_proxy", _keeping_values)
    wrap(arrayobj, "make_array", _plain_arrays)
    counter: Any = NRTContext
    counter.get_meminfos = _counted


class Whole(ir.Value):  # type: ignore[misc]
    """A value with a part that was put into it, for which there is no instruction yet.

    Parameters
    ----------
    aggregate
        The value before.
    value
        The part.
    indices
        Where it is put, from outside in.
    """

    def __init__(self, aggregate: Any, value: Any, indices: Sequence[int]) -> None:
        kind = aggregate.type
        for index in indices:
            kind = kind.elements[index]
        assert value.type == kind
        self.type, self.aggregate = aggregate.type, aggregate
        self.value, self.indices = value, list(indices)


def insert_value(
    self: Any, whole: Any, part: Any, index: int | Sequence[int], name: str = ""
) -> Whole:
    """Return a value with a part put into it; it takes an instruction only where it is used."""
    return Whole(whole, part, index if isinstance(index, Sequence) else [index])


def extract_value(self: Any, whole: Any, index: int | Sequence[int], name: str = "") -> Any:
    """Return a part of a value: what was put there, where that is known."""
    wanted = list(index) if isinstance(index, Sequence) else [index]
    while type(whole) is Whole:
        given = whole.indices
        shared = min(len(given), len(wanted))
        if given[:shared] != wanted[:shared]:
            whole = whole.aggregate
        elif len(given) > len(wanted):  # only some of it was put there
            before = extract_value(self, whole.aggregate, wanted)
            return Whole(before, whole.value, given[len(wanted) :])
        elif len(given) == len(wanted):
            return whole.value
        else:
            whole, wanted = whole.value, wanted[shared:]
    found = ExtractValue(self.block, whole, wanted, name=name)
    self._insert(found)
    return found


def put_together(builder: Any, whole: Whole) -> Any:
    """Write the instructions that put a value together; return it."""
    parts = []
    before: Any = whole
    while type(before) is Whole:
        parts.append((before.value, before.indices))
        before = before.aggregate
    for part, indices in reversed(parts):
        made = InsertValue(builder.block, before, _written(builder, part), indices)
        builder._insert(made)
        before = made
    return before


def _written(builder: Any, value: Any) -> Any:
    """Return a value as instructions may use it."""
    return put_together(builder, value) if type(value) is Whole else value


def _putting_together(insert: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Put the values together that an instruction uses, before it."""

    def inserting(self: Any, instruction: Any) -> None:
        used = instruction.operands
        if any(type(one) is Whole for one in used):
            instruction.operands = [_written(self, one) for one in used]
        insert(self, instruction)

    return inserting


def write_chosen(function: Any) -> None:
    """Put the values together among which a function chooses by the block that it comes from."""
    for block in function.blocks:
        for instruction in block.instructions:
            if type(instruction) is not PhiInstr:
                break
            instruction.incomings = [
                (_written_before(end, value), end) for value, end in instruction.incomings
            ]


def _written_before(block: Any, value: Any) -> Any:
    """Return a value as instructions may use it that come after a block."""
    if type(value) is not Whole:
        return value
    builder = ir.IRBuilder(block)
    builder.position_before(block.terminator)
    return put_together(builder, value)


class Value(_Proxy):  # type: ignore[misc]
    """What numba writes a value's parts into, and reads them from.

    Parts are put into a value one by one in the block of code where it was made. Where one is
    written elsewhere, in a branch or a loop, the value goes to memory first.
    """

    def __init__(self, context: Any, builder: Any, value: Any = None, ref: Any = None) -> None:
        self._place: Any = None
        if ref is not None:
            super().__init__(context, builder, value, ref)
            return
        self._context, self._builder = context, builder
        self._datamodel = context.data_model_manager[self._fe_type]
        self._be_type = self._get_be_type(self._datamodel)
        self._written = ir.Constant(self._be_type, None) if value is None else value
        assert self._written.type == self._be_type
        self._block = builder.block
        self._read_elsewhere = False

    @property
    def _value(self) -> Any:
        """Where the value lies; it goes there now, if it does not yet."""
        if self._place is None:
            self._place = self._moved()
        return self._place

    @_value.setter
    def _value(self, place: Any) -> None:
        self._place = place

    @property
    def _outer_ref(self) -> Any:
        return self._value

    @_outer_ref.setter
    def _outer_ref(self, place: Any) -> None:
        self._place = place

    def __getitem__(self, index: int) -> Any:
        if self._place is not None:
            return super().__getitem__(index)
        self._read_elsewhere |= self._builder.block is not self._block
        return self._builder.extract_value(self._written, index)

    def __setitem__(self, index: int, value: Any) -> None:
        if self._place is None and self._builder.block is self._block:
            self._written = self._builder.insert_value(self._written, value, index)
            return
        # Else what was read in a loop may have been written in it.
        assert self._place is not None or not self._read_elsewhere
        super().__setitem__(index, value)

    def _getvalue(self) -> Any:
        return self._written if self._place is None else super()._getvalue()

    def _moved(self) -> Any:
        """Put what was written so far into memory, in the block where it was written."""
        place = memory(self._builder, self._be_type)
        with self._builder.goto_block(self._block):
            self._builder.store(self._written, place)
        return place


def _keeping_values(create: Callable[..., Any]) -> Callable[..., Any]:
    """Have parts of some types written into values."""
    known: dict[Any, Any] = {}

    def creating(kind: Any, use: str = "value") -> Any:
        if use != "value" or type(kind) not in KINDS:
            return create(kind, use)
        if kind not in known:
            known[kind] = type(f"Value_{kind}", (Value,), {"_fe_type": kind})
        return known[kind]

    return creating


def _plain_arrays(make: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Have arrays that are no more than that looked into as other values are."""

    def making(kind: Any) -> Any:
        helpers: Any = cgutils
        return helpers.create_struct_proxy(kind) if type(kind) is types.Array else make(kind)

    return making


def memory(builder: Any, kind: Any) -> Any:
    """Return memory that is written before it is read; numba clears all that it takes."""
    with builder.goto_entry_block():
        return builder.alloca(kind)


def _counted(self: Any, builder: Any, kind: Any, value: Any) -> list[tuple[Any, Any]]:
    """Return all memory in a value of which somebody counts who has it.

    Numba takes all parts out of a value, at any depth, to look for some.
    """
    models = self._context.data_model_manager
    model = models[kind]
    found = []
    if model.has_nrt_meminfo():
        found.append((kind, model.get_nrt_meminfo(builder, value)))
    for inner, take in model.traverse(builder):
        if models[inner].contains_nrt_meminfo():
            found += self.get_meminfos(builder, inner, take(value))
    return found
