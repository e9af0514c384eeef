"""Having memory fetched ahead of use, where a kernel computes for long between what it reads."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import types
from numba.extending import intrinsic, overload

from exwarp_cli.kernels.lanes import data_of

F32 = npt.NDArray[np.float32]

LINE = 16
"""Floats that come together: the 64 bytes of a line of most processors' caches."""

_HINTS = (0, 2, 1)
"""To be read; once, so the second cache is near enough; data, and not code."""


def prefetch(values: F32, place: int) -> None:
    """Have the floats around a place of float32 [N] come nearer, waiting for nothing.

    It is a hint. Interpreted, and on processors without such an instruction, nothing happens.
    """


@intrinsic
def _prefetch(_: Any, values: Any, place: Any) -> Any:
    """The same by the processor's instruction."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        data = data_of(context, builder, signature.args[0], given[0])
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        called = builder.module.declare_intrinsic("llvm.prefetch", (byte,), kind)
        begin = builder.bitcast(builder.gep(data, [given[1]]), byte)
        builder.call(called, [begin, *(ir.Constant(number, hint) for hint in _HINTS)])
        return context.get_dummy_value()

    return types.void(values, place), generate


@overload(prefetch, strict=False)
def _compiled(values: Any, place: Any) -> Any:
    def prefetched(values, place):  # type: ignore[no-untyped-def]
        _prefetch(values, place)  # type: ignore[call-arg]

    return prefetched
