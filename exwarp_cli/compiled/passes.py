"""Passes of numba over a function, without what they find out for nobody."""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from numba.core import types
from numba.core.analysis import compute_live_variables
from numba.core.ir import Assign, Expr
from numba.core.postproc import PostProcessor, VariableLifetime
from numba.core.transforms import canonicalize_cfg
from numba.core.typed_passes import NopythonRewrites

MAKING = frozenset({"call", "unary", "binop"})
"""Expressions that may make arrays."""


def shorten() -> None:
    """Leave it out from now on."""
    processor: Any = PostProcessor
    processor.run = _looking_later(processor.run)
    rewrites: Any = NopythonRewrites
    rewrites.run_pass = _rewriting_arrays(rewrites.run_pass)


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
