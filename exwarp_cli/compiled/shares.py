"""Loops shared out among threads: every thread runs the whole kernel, and takes some of its turns.

Numba's own loops for threads are compiled once in the kernel and once more as a function that the
threads call, between which stand six passes and two wrappers: two thirds more time of compilation.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic
from numba.np.ufunc import parallel

Share = tuple[int, int]

WHOLE: Share = (0, 1)
"""Which share of its turns a thread takes, and of how many: here all of them."""

_SHARE = types.UniTuple(types.int64, 2)
_SIZE, _BYTES, _FLAG = ir.IntType(64), ir.IntType(8).as_pointer(), ir.IntType(8)


def turns(count: int, share: Share) -> range:
    """Return the turns that of a share: neighbours, as many as others have, or one more.

    Parameters
    ----------
    count
        How many there are in all.
    share
        Its number, from 0 on, and how many shares there are.
    """
    number, shares = share
    return range(count * number // shares, count * (number + 1) // shares)


@infer_global(turns)
class _Turns(ConcreteTemplate):
    """The types of `turns`."""

    cases = [signature(types.range_state64_type, types.int64, _SHARE)]  # noqa: RUF012


@lower_builtin(turns, types.int64, _SHARE)  # type: ignore[untyped-decorator]
def _compiled_turns(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
    """Return the same in LLVM's instructions: as a part it would be compiled with every kernel."""
    count, share = values
    number, shares = (builder.extract_value(share, k) for k in range(2))
    found = cgutils.create_struct_proxy(types.range_state64_type)(context, builder)
    following = builder.add(number, _SIZE(1))
    found.start = builder.sdiv(builder.mul(count, number), shares)
    found.stop = builder.sdiv(builder.mul(count, following), shares)
    found.step = _SIZE(1)
    return found._getvalue()


def looped(text: Any) -> Callable[..., None]:
    """Return what :func:`shared_out` does, for any version of Numba, with a loop of its own.

    Written out with the names of the arguments: its loops take no tuples of tuples, as which they
    are passed together. There are as many shares as there may be threads, since how many are in use
    could not be kept on disk.
    """
    names = ", ".join([*inspect.signature(text.py_func).parameters][:-1])
    source = f"def shared({names}):\n    for number in prange(shares):\n"
    source += f"        text({names}, (int64(number), shares))\n"
    shares = np.int64(numba.config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    known = {"prange": numba.prange, "int64": np.int64, "shares": shares, "text": text}
    exec(source, known)
    shared: Callable[..., None] = known["shared"]
    return shared


def shared_out(text: Any) -> Callable[..., None]:
    """Return a function that threads run a kernel by, each with its share.

    Parameters
    ----------
    text
        The kernel as Numba's dispatcher. It takes a share as its last argument and returns nothing.
    """

    @intrinsic
    def run(_typing: Any, arguments: Any) -> Any:
        kinds = (*arguments.types, _SHARE)
        text.compile(kinds)
        build = text.overloads[kinds]

        def generate(context: Any, builder: Any, _signature: Any, values: Any) -> Any:
            _generate(context, builder, build, arguments, values[0])
            return context.get_dummy_value()

        return types.void(arguments), generate

    def shared(*arguments: Any) -> None:
        run(arguments)  # type: ignore[call-arg]

    return shared


def _generate(context: Any, builder: Any, build: Any, kind: Any, arguments: Any) -> None:
    """Have Numba's threads run a build with the arguments, a tuple, and a share each.

    As their own loops do, which takes a function of a C array of arguments, of which there is one
    here, a number that it counts up instead of an address.
    """
    from numba.core.typed_passes import _reload_parfors

    library = context.active_code_library
    library.add_linking_library(build.library)
    library._reload_init.add(_reload_parfors)
    parallel._launch_threads()
    module = builder.module
    count_threads = cgutils.get_or_insert_function(
        module, ir.FunctionType(_SIZE, []), "get_num_threads"
    )
    run_all = cgutils.get_or_insert_function(
        module, ir.FunctionType(ir.VoidType(), [_BYTES] * 5 + [_SIZE] * 3), "numba_parallel_for"
    )
    shares = builder.call(count_threads, [])
    passed = cgutils.alloca_once(
        builder, ir.LiteralStructType([context.get_value_type(kind), _SIZE, _FLAG])
    )
    for place, value in enumerate((arguments, shares, _FLAG(0))):
        builder.store(value, cgutils.gep_inbounds(builder, passed, 0, place))
    sizes = cgutils.alloca_once_value(builder, shares)
    steps = cgutils.alloca_once_value(builder, _SIZE(1))
    first = cgutils.alloca_once_value(builder, _SIZE(0))
    run_some = _write_turn(context, module, build, kind, passed.type)
    pointers = (run_some, first, sizes, steps, passed)
    handed = [builder.bitcast(pointer, _BYTES) for pointer in pointers]
    builder.call(run_all, [*handed, _SIZE(0), _SIZE(1), shares])
    failed = builder.load(cgutils.gep_inbounds(builder, passed, 0, 2))
    with cgutils.if_unlikely(builder, builder.icmp_unsigned("!=", failed, _FLAG(0))):
        context.call_conv.return_user_exc(builder, MemoryError, ("no memory for a kernel",))


def _write_turn(context: Any, module: Any, build: Any, kind: Any, passed: Any) -> Any:
    """Write the function that Numba's threads call: for some shares, it runs the build."""
    number = _SIZE.as_pointer()
    signature = ir.FunctionType(ir.VoidType(), [number.as_pointer(), number, number, _BYTES])
    function = ir.Function(module, signature, module.get_unique_name("shares"))
    function.linkage = "internal"
    builder = ir.IRBuilder(function.append_basic_block())
    firsts, counts, _, data = function.args
    data = builder.bitcast(data, passed)
    arguments = builder.load(cgutils.gep_inbounds(builder, data, 0, 0))
    shares = builder.load(cgutils.gep_inbounds(builder, data, 0, 1))
    begin = builder.ptrtoint(builder.load(firsts), _SIZE)
    text = context.declare_function(module, build.fndesc)
    with cgutils.for_range(builder, builder.load(counts)) as loop:
        share = cgutils.pack_array(builder, [builder.add(begin, loop.index), shares])
        values = [builder.extract_value(arguments, k) for k in range(len(kind.types))]
        status, _ = context.call_conv.call_function(
            builder, text, types.none, build.fndesc.argtypes, [*values, share]
        )
        with cgutils.if_unlikely(builder, status.is_error):
            builder.store(_FLAG(1), cgutils.gep_inbounds(builder, data, 0, 2))
    builder.ret_void()
    return function
