"""Python's own code, read without a look for what is not in it.

Numba looks at each instruction whether an exception may be caught there, and at each line whether
`with` or the updates of dictionaries left something behind.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import dis
import functools
from collections.abc import Callable
from typing import Any

from numba.core import interpreter
from numba.core.byteflow import Flow
from numba.core.interpreter import Interpreter

from exwarp_cli.compiled.front_end import wrap

# As numba has no types of its own.
_interpreter: Any = interpreter
_delete_with: Any = _interpreter.peep_hole_delete_with_exit
_fuse_dictionaries: Any = _interpreter.peep_hole_fuse_dict_add_updates

DICTIONARIES = frozenset(
    dis.opmap[name]
    for name in ("BUILD_MAP", "BUILD_CONST_KEY_MAP", "MAP_ADD", "DICT_UPDATE", "DICT_MERGE")
    if name in dis.opmap
)
"""Instructions that make dictionaries."""


def shorten() -> None:
    """Read it so from now on."""
    wrap(Flow, "_run_handle_exception", _going_on)
    wrap(Interpreter, "post_process", _mending)


def catches(code: Any) -> bool:
    """Whether a function catches exceptions, as it does where there is a `with`."""
    return bool(code.co_exceptiontable)


def _going_on(handle: Callable[..., Any]) -> Callable[..., Any]:
    """Go on to the next instruction where no exception is caught."""

    @functools.wraps(handle)
    def handling(self: Any, runner: Any, state: Any) -> Any:
        if catches(self._bytecode.func_id.code):
            return handle(self, runner, state)
        state.advance_pc()
        return None

    return handling


def _mending(mend: Callable[..., Any]) -> Callable[..., Any]:
    """Mend what numba makes of Python's code only where there is something to mend."""

    @functools.wraps(mend)
    def mending(self: Any, steps: list[Any], made: Any) -> Any:
        code = made.func_id.code
        if not catches(code):
            steps = [step for step in steps if step is not _delete_with]
        if DICTIONARIES.isdisjoint(code.co_code[::2]):
            steps = [step for step in steps if step is not _fuse_dictionaries]
        return mend(self, steps, made)

    return mending
