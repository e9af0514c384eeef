"""Messages to a user who waits while kernels are compiled, as the disk cache lacks them.

This module imports no compiler, so commands choose the channel before they import one.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

COMPILING = "compiling kernels for this machine, once; this may take half a minute"
COMPILED = "compiled "  # begins all later messages

# Seconds between two messages on a terminal. Logs stay short: they get the first and the last.
INTERVAL = 3.0


@dataclass
class Compilation:
    """The kernels that a process compiles, and the messages about them."""

    clock: Callable[[], float] = time.monotonic
    loaded: int = 0  # kernels since the process began
    compiled: int = 0
    _channels: list[Callable[[str], None]] = field(default_factory=list)
    _is_announced: bool = False
    _count: int = 0  # kernels compiled since the last report
    _seconds: float = 0.0  # that they took
    _start: float = 0.0  # time of the last kernel's start
    _newest: float = 0.0  # time of the last message

    @contextmanager
    def messages_to(self, channel: Callable[[str], None]) -> Iterator[None]:
        """Send the messages of a block, one line each, to this channel alone."""
        self._channels.append(channel)
        try:
            yield
        finally:
            if self._count:
                self._report("; later runs need not")
                self._count, self._seconds = 0, 0.0
            self._channels.remove(channel)
            self._is_announced = self._is_announced and bool(self._channels)

    def begin(self) -> None:
        """Note that a kernel is about to be compiled."""
        self._start = self.clock()
        if self._channels and not self._is_announced:
            self._is_announced = True
            self._newest = self._start
            self._channels[-1](COMPILING)

    def end(self) -> None:
        """Note that a kernel was compiled."""
        now = self.clock()
        self.compiled += 1
        if not self._is_announced:
            return
        self._count, self._seconds = self._count + 1, self._seconds + now - self._start
        if sys.stderr.isatty() and now - self._newest >= INTERVAL:
            self._report(" so far")

    def _report(self, ending: str) -> None:
        self._newest = self.clock()
        kernels = "1 kernel" if self._count == 1 else f"{self._count} kernels"
        self._channels[-1](f"{COMPILED}{kernels} in {self._seconds:.0f} s{ending}")


compilation = Compilation()
