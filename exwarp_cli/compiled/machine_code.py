"""Machine code for whole kernels only.

Numba links into each function that a kernel calls all those that this one calls, optimises it, and
makes machine code of it, before the same is done with the kernel. With numba's own functions for
arrays these are several for each kernel, and nobody else calls them: a good part of the time of
compilation.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from llvmlite.binding import Linkage, set_option  # type: ignore[import-untyped]
from numba.core import config
from numba.core.callwrapper import PyCallWrapper
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

from exwarp_cli.compiled.front_end import wrap

LEVEL = 2
"""Of optimisation; 3 takes a tenth more time, and kernels are no faster."""

LEFT_OUT = ("-disable-lsr", "-unroll-runtime=0")
"""Of what LLVM does with loops: other steps through memory, and several turns at once where their
number is not known. It took a quarter of LLVM's time, and kernels are no faster, summed up."""


class DeferredLibrary(JITCodeLibrary):
    """Code that is linked and optimised, and becomes machine code, when an address in it is wanted.

    Code that is only linked into other code never is.
    """

    _made = False
    _shared: tuple[str, ...] | None = None

    @property
    def codegen(self) -> Any:
        """What takes the environments of the functions: this library, as it may not be made yet."""
        return self

    def set_env(self, name: str, environment: Any) -> None:
        """Set a function's environment, which only a function that Python can call has."""
        if self._made:
            maker: Any = self._codegen
            maker.set_env(name, environment)

    def get_pointer_to_function(self, name: str) -> int:
        """Return where a function begins; 0 where this library does not define it."""
        self._ensure_finalized()
        if not self._made:
            defined = {function.name for function in self.get_defined_functions()}
            if name not in defined:
                return 0
            self._make()
        return int(super().get_pointer_to_function(name))

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        """Return the library as the cache keeps it."""
        self._ensure_finalized()
        self._make()
        return tuple(super().serialize_using_object_code())

    def finalize(self) -> None:
        """Let nothing be added any more; linking is left to :meth:`_make`."""
        self._raise_if_finalized()
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """Return this library's own code, of which others take what they call.

        Numba hands out a copy, as the code itself has become machine code by then.
        """
        self._ensure_finalized()
        if self._made:
            return super()._get_module_for_linking()
        if self._shared is None:
            functions = [f for f in self.get_defined_functions() if f.linkage == Linkage.external]
            for function in functions:
                function.linkage = "linkonce_odr"
            self._shared = tuple(function.name for function in functions)
        return self._final_module

    def _make(self) -> None:
        """Link, optimise, and make machine code."""
        if self._made:
            return
        for name in self._shared or ():
            self._final_module.get_function(name).linkage = "external"
        for library in self._callees():
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        # Numba runs this once cheaply before, and others for each function, declarations too: a
        # quarter of the time more, for kernels that are no faster.
        level = min(LEVEL, config.OPT)  # type: ignore[attr-defined]
        passes, builder = self._codegen._module_pass_manager(opt=level)
        passes.run(self._final_module, builder)
        self._final_module.verify()
        self._finalize_final_module()

    def _finalize_final_module(self) -> None:
        """Load the machine code, made now or taken from the cache."""
        self._made = True
        super()._finalize_final_module()

    def _callees(self) -> list[Any]:
        """Return all libraries that code here calls into, at any remove, each after its callers.

        Of a library nothing is linked but what is called by then.
        """
        found: list[Any] = []
        seen = {self}
        # Of a library on the way, what is left of those that it calls into.
        way: list[tuple[Any, Any]] = [(self, iter(self._linking_libraries))]
        while way:
            library, rest = way[-1]
            following = next((one for one in rest if one not in seen), None)
            if following is None:
                found.append(library)
                way.pop()
            else:
                seen.add(following)
                way.append((following, iter(following._linking_libraries)))
        return found[-2::-1]

    def _optimize_functions(self, module: Any) -> None:
        """Leave it to :meth:`_make`; here, the target's layout alone."""
        module.data_layout = self._codegen._data_layout


def defer() -> None:
    """Have numba make machine code only of what is called from Python, from now on."""
    cpu_target.target_context.codegen()._library_class = DeferredLibrary
    wrap(PyCallWrapper, "build", _as_it_stands)
    for option in LEFT_OUT:
        set_option("", option)


def _as_it_stands(build: Callable[[Any], tuple[Any, Any]]) -> Callable[[Any], tuple[Any, Any]]:
    """Leave the entry by which Python calls a kernel as it is written.

    It takes arguments apart, once a call; LLVM spent a tenth of its time on these entries.
    """

    @functools.wraps(build)
    def building(self: Any) -> tuple[Any, Any]:
        entry, api = build(self)
        entry.attributes.add("noinline")
        entry.attributes.add("optnone")
        return entry, api

    return building
