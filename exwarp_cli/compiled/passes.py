"""Passes of numba over a function, without what they find out for nobody."""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from numba.core import event, types
from numba.core.analysis import compute_live_variables
from numba.core.compiler_machinery import PassManager
from numba.core.inline_closurecall import InlineClosureCallPass
from numba.core.ir import Assign, Expr, FreeVar, Global
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.transforms import canonicalize_cfg
from numba.core.typed_passes import NopythonRewrites

from exwarp_cli.compiled.front_end import wrap

MAKING = frozenset({"call", "unary", "binop"})
"""Expressions that may make arrays."""


def shorten() -> None:
    """Leave it out from now on."""
    wrap(PassManager, "_runPass", _passing_plainly)
    wrap(InlineClosureCallPass, "run", _inlining_closures)
    wrap(PostProcessor, "run", _looking_later)
    wrap(NopythonRewrites, "run_pass", _rewriting_arrays)


def _passing_plainly(
    run: Callable[[Any, int, Any, Any], None],
) -> Callable[[Any, int, Any, Any], None]:
    """Run a pass without its description, times, checks and dumps, where nobody asked for any.

    Numba describes each of the 27 passes over a function with all its types.
    """

    @functools.wraps(run)
    def passing(self: Any, index: int, step: Any, state: Any) -> None:
        told = event._registered["numba:run_pass"] or any(
            (self._print_after, self._print_before, self._print_wrap)
        )
        if told:
            run(self, index, step, state)
            return
        step.analysis = self._analysis
        for part in (step.run_initialization, step.run_pass, step.run_finalizer):
            part(state)

    return passing


def _inlining_closures(inline: Callable[[Any], None]) -> Callable[[Any], None]:
    """Look for functions to be put in place only where some, or lists, are written down."""

    @functools.wraps(inline)
    def inlining(self: Any) -> None:
        values = (
            step.value
            for block in self.func_ir.blocks.values()
            for step in block.body
            if type(step) is Assign
        )
        if any(_may_be_inlined(value) for value in values):
            inline(self)

    return inlining


def _may_be_inlined(value: Any) -> bool:
    """Whether numba may put something in place of a value, or of what is done with it."""
    if type(value) is Expr:
        named = value.op == "getattr" and value.attr in ("reduce", "stencil")
        return named or value.op in ("make_function", "build_list")
    if type(value) is Global or type(value) is FreeVar:
        named = getattr(value.value, "__name__", "") in ("reduce", "stencil")
        return named or type(value.value).__name__ == "StencilFunc"
    return False


class _Living(dict[Any, set[str]]):
    """Variables that live at the beginning of blocks, found when the first block is asked for."""

    def __init__(self, blocks: dict[int, Any], lifetime: Any) -> None:
        super().__init__()
        self._blocks, self._lifetime = dict(blocks), lifetime

    def __missing__(self, block: Any) -> set[str]:
        about = self._lifetime
        found = compute_live_variables(
            about.cfg, self._blocks, about.usedefs.defmap, about.deadmaps.combined
        )
        self.update({one: found[offset] for offset, one in self._blocks.items()})
        return self[block]


def _looking_later(process: Callable[..., None]) -> Callable[..., None]:
    """Find out which variables live at the beginning of blocks when somebody asks.

    Numba does nine times for each function, and only generators and what is not compiled ask.
    """

    @functools.wraps(process)
    def processing(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
        code = self.func_ir
        if code.is_generator:
            process(self, emit_dels, extend_lifetimes)
            return
        code.blocks = canonicalize_cfg(code.blocks)
        code.variable_lifetime = VariableLifetime(code.blocks)
        code.block_entry_vars = _Living(code.blocks, code.variable_lifetime)
        code.generator_info = None
        if emit_dels:
            self._insert_var_dels(extend_lifetimes=extend_lifetimes)

    return processing


def _rewriting_arrays(rewrite: Callable[[Any, Any], bool]) -> Callable[[Any, Any], bool]:
    """Look for operations on whole arrays, and for fields by name, only where there are any.

    Nothing else is rewritten once types are known; kernels have loops of their own instead.
    """

    @functools.wraps(rewrite)
    def rewriting(self: Any, state: Any) -> bool:
        kinds = state.typemap
        arrays = (
            isinstance(kinds.get(step.target.name), types.Array)
            for block in state.func_ir.blocks.values()
            for step in block.body
            if type(step) is Assign and type(step.value) is Expr and step.value.op in MAKING
        )
        named = (isinstance(kind, types.StringLiteral) for kind in kinds.values())
        return (any(arrays) or any(named)) and rewrite(self, state)

    return rewriting
