"""Variables that stand for values, where numba gives them memory.

Numba does so with all that are used beyond the block of code that sets them, arguments among them,
and copies them at each use. One that is set once stands for its value here, wherever the way there
leads through where it is set.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from typing import Any

from numba.core import typed_passes
from numba.core.analysis import must_use_alloca
from numba.core.ir import Assign, Del, Global
from numba.core.ir_utils import enforce_no_dels, enforce_no_phis
from numba.core.lowering import Lower
from numba.core.postproc import PostProcessor
from numba.core.unsafe import eh

from exwarp_cli.compiled.front_end import wrap


def shorten() -> None:
    """Have variables stand for values from now on."""
    wrap(Lower, "_find_singly_assigned_variable", _finding)
    wrap(Lower, "storevar", _storing)
    wrap(Lower, "delvar", _forgetting)
    wrap(typed_passes.IRLegalization, "run_pass", _counting_ends)


def _finding(find: Callable[[Any], None]) -> Callable[[Any], None]:
    """Find the variables that are set once, where all that use them come after."""

    def finding(self: Any) -> None:
        code = self.func_ir
        if code.func_id.is_generator or self._disable_sroa_like_opt or tries(code):
            find(self)
            return
        self._blk_local_varmap = {}
        self._singly_assigned_vars = _standing(self)

    return finding


def _standing(lower: Any) -> set[str]:
    """Return the variables that stand for values."""
    code = lower.func_ir
    life = code.variable_lifetime
    set_in, ends_in = _set_and_ended(code.blocks)
    used_in: dict[str, list[int]] = defaultdict(list)
    for offset, names in life.usedefs.usemap.items():
        for name in names:
            used_in[name].append(offset)
    before = life.cfg.dominators()
    in_memory = must_use_alloca(code.blocks)
    found = set()
    for name, (place, *others) in set_in.items():
        if others or name in in_memory:
            continue
        # Blocks are written by their numbers.
        if not all(place < user and place in before[user] for user in used_in[name]):
            continue
        if not _is_counted(lower, name) or _ends_once(life.cfg, before, place, ends_in[name]):
            found.add(name)
    return found


def _set_and_ended(blocks: dict[int, Any]) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
    """Return the blocks of code in which variables are set, and in which they end."""
    set_in: dict[str, list[int]] = defaultdict(list)
    ends_in: dict[str, list[int]] = defaultdict(list)
    for offset, block in blocks.items():
        for step in block.body:
            if type(step) is Assign:
                set_in[step.target.name].append(offset)
            elif type(step) is Del:
                ends_in[step.value].append(offset)
    return set_in, ends_in


def _ends_once(cfg: Any, before: Any, place: int, ends: list[int]) -> bool:
    """Whether a variable ends no more than once each time that it is set.

    Numba clears its memory where it ends, so that it may end once more; a value stays what it is.

    Parameters
    ----------
    cfg
        How blocks of code follow each other.
    before
        Which blocks lie on every way to a block.
    place
        The block that sets it.
    ends
        The blocks in which it ends.
    """
    if ends == [place]:
        return True
    if not all(place < end and place in before[end] for end in ends):
        return False
    return len(set(ends)) == len(ends) and not any(
        _may_follow(cfg, end, ends, place) for end in ends
    )


def _may_follow(cfg: Any, first: int, others: list[int], without: int) -> bool:
    """Whether one of some blocks may come after the first, by a way without a certain block."""
    following: set[int] = set()
    left = [first]
    while left:
        for block, _ in cfg.successors(left.pop()):
            if block != without and block not in following:
                following.add(block)
                left.append(block)
    return not following.isdisjoint(others)


def tries(code: Any) -> bool:
    """Whether a function catches exceptions."""
    return any(
        type(step) is Assign
        and type(step.value) is Global
        and step.value.value is eh.exception_check
        for block in code.blocks.values()
        for step in block.body
    )


def _is_counted(lower: Any, name: str) -> bool:
    """Whether somebody counts who has what is in a variable."""
    if not lower.context.enable_nrt:
        return False
    model = lower.context.data_model_manager[lower.typeof(name)]
    return bool(model.contains_nrt_meminfo())


def _storing(store: Callable[..., None]) -> Callable[..., None]:
    """Set a variable without a look at what it was, where nobody counts who has that."""

    def storing(self: Any, value: Any, name: str, argidx: int | None = None) -> None:
        if (
            name in self._singly_assigned_vars
            or self._disable_sroa_like_opt
            or _is_counted(self, name)
        ):
            store(self, value, name, argidx)
            return
        self._alloca_var(name, self.typeof(name))
        place = self.getvar(name)
        assert value.type == place.type.pointee
        self.builder.store(value, place)

    return storing


def _forgetting(forget: Callable[[Any, str], None]) -> Callable[[Any, str], None]:
    """Let variables be that nobody counts."""

    def forgetting(self: Any, name: str) -> None:
        if self._disable_sroa_like_opt or _is_counted(self, name):
            forget(self, name)

    return forgetting


def _counting_ends(check: Callable[[Any, Any], bool]) -> Callable[[Any, Any], bool]:
    """Write down where variables end only in functions in which somebody counts."""

    def checking(self: Any, state: Any) -> bool:
        if state.flags.nrt or state.flags.debuginfo:
            return check(self, state)
        enforce_no_phis(state.func_ir)
        enforce_no_dels(state.func_ir)
        PostProcessor(state.func_ir).run(emit_dels=False)
        return True

    return checking
