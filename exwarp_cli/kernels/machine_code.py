"""Machine code for whole kernels only.

Numba optimises each function that a kernel calls, and makes machine code of it, before it links it
into the kernel and optimises all of that once more. With numba's own functions for arrays and the
bodies of parallel loops these are eight for each kernel, and nobody else calls them: two fifths of
the time of compilation.
"""

# mypy: disable-error-code="no-untyped-call"

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

LOOP_BODY = "__numba_parfor_gufunc"
"""How the names of libraries begin that hold the body of a parallel loop. Numba asks for the
address of what would let Python call it, and nobody does."""


class DeferredLibrary(JITCodeLibrary):
    """Code that is optimised, and becomes machine code, when a function's address is wanted.

    Code that is only linked into other code never is.
    """

    _made = False
    _compiled_object: Any = None  # as numba leaves it unset where nothing is cached

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
            if name not in defined or self.name.startswith(LOOP_BODY):
                return 0
            self._make()
        return int(super().get_pointer_to_function(name))

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        """Return the library as the cache keeps it."""
        self._ensure_finalized()
        self._make()
        return tuple(super().serialize_using_object_code())

    def _make(self) -> None:
        if not self._made:
            # One manager for all functions: numba makes one for each, declarations too.
            passes, builder = self._codegen._function_pass_manager()
            for function in self.get_defined_functions():
                passes.run(function, builder)
            super()._optimize_final_module()
            self._final_module.verify()
            self._shared_module = None
            self._made = True
            self._dynamic_globals: list[str] = []  # optimised, it may need none of them
            super()._finalize_final_module()

    def _optimize_functions(self, module: Any) -> None:
        """Leave it to :meth:`_make`; here, the target's layout alone."""
        module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        """Leave it to :meth:`_make`."""

    def _finalize_final_module(self) -> None:
        if self._compiled_object is not None:  # it comes from the cache
            self._made = True
            super()._finalize_final_module()
        else:
            self._finalize_dynamic_globals()
            self._finalized = True


def defer() -> None:
    """Have numba make machine code only of what is called from Python, from now on."""
    cpu_target.target_context.codegen()._library_class = DeferredLibrary
