"""Objects that keep something open for as long as a ``with`` block lasts."""

from __future__ import annotations

from contextlib import ExitStack
from types import TracebackType
from typing import Self


class Held:
    """A context manager that closes what `_open` opened, in whatever way its block ends."""

    _stack: ExitStack

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._open(stack)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _open(self, stack: ExitStack) -> None:
        """Enter what is to be closed into the stack; what fails here leaves nothing open."""
        raise NotImplementedError
