"""Signals that end a command, raised where they break off nothing that must be whole.

Python handles a signal between any two steps of the main thread, and the standard library's locks,
pools and imports are written in Python: an exception between taking a lock and the block that gives
it back leaves it taken, and whoever needs it waits for ever. One in a finalizer is dropped. Such
code is left within microseconds, so a stop that arrives there waits, and strikes a little later.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from types import FrameType
from typing import Any

AT_ONCE_S = 1.0
"""Seconds in which a second interruption is taken for the same one: a terminal sends it to both
processes of a command, and the parent hands it on."""

TIMED = hasattr(signal, "setitimer")
"""Whether a stop can wait: on Windows it strikes at once."""

AGAIN_S = 0.002
"""After how long a stop that had to wait is tried again."""

SHORT = {
    "threading", "contextlib", "queue", "numba.core.compiler_lock", "exwarp_cli.domain.cores",
    __name__,
}  # fmt: skip
"""Modules in which a stop waits, where the main thread is in one of their functions."""

WAITING = {
    ("threading", "wait"),
    ("threading", "join"),
    ("threading", "_wait_for_tstate_lock"),
}
"""Functions of these that may take long: once the thread stays at one place, they are stopped."""

WHOLE = {
    "importlib._bootstrap", "importlib._bootstrap_external",
    "_frozen_importlib", "_frozen_importlib_external",
    "weakref", "llvmlite.binding",
}  # fmt: skip
"""Modules, and packages of them, in which a stop waits, also where they called others. LLVM asks
for machine code that is kept; where an exception is the answer, it goes on without, and what calls
a kernel crashes. Objects of its bindings that were made by half are closed as they go, which fails
and is told."""

WHOLE_FUNCTIONS = {
    ("threading", "start"),
    ("concurrent.futures.thread", "submit"),
}
"""Functions in which a stop waits, also where they called others."""


class Terminated(BaseException):
    """SIGTERM arrived; not an `Exception`, so that nothing on the way takes it for a failure."""


class Stoppable:
    """A block in whose thread SIGTERM raises `Terminated`, and SIGINT KeyboardInterrupt.

    Temporary files are removed on the way out then. After the first SIGTERM others are ignored, as
    they must not break off the cleaning up; so are interruptions at once. Outside the main thread
    signals are the embedding program's business, and the block does nothing.

    Parameters
    ----------
    is_last
        Whether the process ends after the block. Signals are ignored from there on: one that came
        late would strike in what Python does as it ends, which prints a traceback.
    """

    def __init__(self, is_last: bool = False) -> None:
        self._is_last = is_last
        self._usual: dict[int, Any] = {}
        self._usual_hook = sys.unraisablehook
        self._outermost: FrameType | None = None
        self._due = 0  # the signal that waits
        self._last = float("-inf")
        self._place: tuple[int, int] | None = None

    def __enter__(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            return
        self._outermost = sys._getframe(1)  # what called it may be an import
        self._usual_hook, sys.unraisablehook = sys.unraisablehook, self._raise_dropped
        if TIMED:
            self._usual[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._try_again)
        self._usual[signal.SIGTERM] = signal.signal(signal.SIGTERM, self._stop)
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            self._usual[signal.SIGINT] = signal.signal(signal.SIGINT, self._stop)

    def __exit__(self, *_: object) -> None:
        if not self._usual:
            return
        for number in (signal.SIGINT, signal.SIGTERM):
            if number in self._usual:
                usual = self._usual.pop(number)
                signal.signal(number, signal.SIG_IGN if self._is_last else usual)
        self._due = 0  # there is nothing left to stop
        if TIMED:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, self._usual.pop(signal.SIGALRM))
        sys.unraisablehook = self._usual_hook
        self._outermost = None

    def _stop(self, number: int, frame: FrameType | None) -> None:
        before, self._last = self._last, time.monotonic()
        if number == signal.SIGTERM:
            signal.signal(number, signal.SIG_IGN)
        elif self._last - before <= AT_ONCE_S:
            return
        self._due = self._due or number
        self._try_again(number, frame)

    def _try_again(self, _number: int, frame: FrameType | None) -> None:
        if not self._due:
            return
        if TIMED and self._must_wait(frame):
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
            return
        due, self._due = self._due, 0
        raise Terminated if due == signal.SIGTERM else KeyboardInterrupt

    def _must_wait(self, frame: FrameType | None) -> bool:
        """Whether an exception here would leave something by half."""
        if frame is None:
            return False
        before, self._place = self._place, (id(frame), frame.f_lasti)
        if _module(frame) in SHORT and not (
            (_module(frame), frame.f_code.co_name) in WAITING and self._place == before
        ):
            return True
        at: FrameType | None = frame
        while at is not None and at is not self._outermost:
            name = _module(at)
            within = name in WHOLE or name.rpartition(".")[0] in WHOLE
            if within or (name, at.f_code.co_name) in WHOLE_FUNCTIONS:
                return True
            at = at.f_back
        return False

    def _raise_dropped(self, dropped: sys.UnraisableHookArgs) -> None:
        """Have a stop strike again that was raised where Python drops exceptions."""
        if not isinstance(dropped.exc_value, Terminated | KeyboardInterrupt):
            self._usual_hook(dropped)
            return
        terminated = isinstance(dropped.exc_value, Terminated)
        self._due = signal.SIGTERM if terminated else signal.SIGINT
        if TIMED:
            signal.setitimer(signal.ITIMER_REAL, AGAIN_S)


def _module(frame: FrameType) -> str:
    return str(frame.f_globals.get("__name__"))
