"""The text of a function that LLVM reads, written with fewer calls; it stays the same.

What it is written from is let go once LLVM has read it.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from llvmlite.ir import VoidType  # type: ignore[import-untyped]
from llvmlite.ir._utils import NameScope  # type: ignore[import-untyped]
from llvmlite.ir.values import Block, NamedValue  # type: ignore[import-untyped]
from numba.core.codegen import CPUCodeLibrary

from exwarp_cli.compiled.front_end import wrap
from exwarp_cli.compiled.structures import write_chosen


def shorten() -> None:
    """Write so from now on."""
    wrap(NameScope, "register", _registering)
    NamedValue._to_string = _line
    NamedValue._get_reference = _reference
    Block.descr = _block
    wrap(CPUCodeLibrary, "add_ir_module", _letting_go)


def _registering(register: Callable[..., str]) -> Callable[..., str]:
    """Find a name that is not used yet, and keep it."""

    def registering(self: Any, name: str, deduplicate: bool = False) -> str:
        used = self._useset
        if name not in used:
            used.add(name)
            return name
        if not deduplicate:
            return register(self, name)  # an error
        number = self._basenamemap[name] + 1
        while (found := f"{name}.{number}") in used:
            number += 1
        self._basenamemap[name] = number
        used.add(found)
        return found

    return registering


def _line(self: Any) -> str:
    """Return an instruction."""
    found = [] if isinstance(self.type, VoidType) else [self.get_reference(), " = "]
    self.descr(found)
    return "".join(found).rstrip()


def _reference(self: Any) -> str:
    """Return how instructions name a value."""
    name = self.name
    if "\\" in name or '"' in name:
        name = name.replace("\\", "\\5c").replace('"', "\\22")
    return f'{self.name_prefix}"{name}"'


def _block(self: Any, found: list[str]) -> None:
    """Write a block."""
    found.append(f"{self._format_name()}:\n")
    found += [f"  {instruction}\n" for instruction in self.instructions]


def _letting_go(add: Callable[[Any, Any], None]) -> Callable[[Any, Any], None]:
    """Take code apart that LLVM has read.

    Its parts hold each other, so that Python has to search for what nobody holds: three quarters of
    all that it finds so while kernels are compiled, a twentieth of the time.
    """

    @functools.wraps(add)
    def adding(self: Any, module: Any) -> None:
        for function in module.functions:
            write_chosen(function)
        add(self, module)
        for function in module.functions:
            for block in function.blocks:
                block.instructions.clear()
                block.terminator = None
            function.blocks.clear()
            function.args, function.return_value = (), None
        module.globals.clear()

    return adding
