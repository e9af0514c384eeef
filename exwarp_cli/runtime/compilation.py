"""Messages to a user who waits while kernels are compiled, as the disk cache lacks them.

This module imports no compiler, so commands choose the channel before they import one.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

COMPILING = "compiling kernels for this machine, once; this may take half a minute"
COMPILED = "compiled "  # begins all later messages

# Seconds between two messages on a terminal. Logs stay short: they get the first and the last.
INTERVAL = 3.0


class Compilation:
    """The kernels that a process compiles, and the messages about them."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._channels: list[Callable[[str], None]] = []
        self.loaded = self.compiled = 0  # kernels since the process began
        self._is_announced = False
        self._count, self._seconds = 0, 0.0  # of the kernels compiled since the last report
        self._start = self._newest = 0.0  # times of the last kernel's start and the last message

    @contextmanager
    def messages_to(self, channel: Callable[[str], None]) -> Iterator[None]:
        """Send the messages of a block, one line each, to this channel alone."""
        self._channels.append(channel)
        try:
            yield
        finally:
            if self._count:
                self._send(f"{self._summary()}; later runs need not")
                self._count, self._seconds = 0, 0.0
            self._channels.remove(channel)
            self._is_announced = self._is_announced and bool(self._channels)

    def begin(self) -> None:
        """Note that a kernel is about to be compiled."""
        self._start = self._clock()
        if self._channels and not self._is_announced:
            self._is_announced = True
            self._send(COMPILING)

    def end(self) -> None:
        """Note that a kernel was compiled."""
        now = self._clock()
        self.compiled += 1
        if not self._is_announced:
            return
        self._count, self._seconds = self._count + 1, self._seconds + now - self._start
        if sys.stderr.isatty() and now - self._newest >= INTERVAL:
            self._send(f"{self._summary()} so far")

    def _summary(self) -> str:
        kernels = "1 kernel" if self._count == 1 else f"{self._count} kernels"
        return f"{COMPILED}{kernels} in {self._seconds:.0f} s"

    def _send(self, text: str) -> None:
        self._newest = self._clock()
        self._channels[-1](text)


compilation = Compilation()
