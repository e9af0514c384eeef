"""A parent process that survives whatever a library does to the process that runs the command.

Decoders and drivers are C and C++: on a damaged file they may crash, or never return. So the
command runs in a child, and the parent waits and reports how it ended. Files are complete either
way, as they are renamed into place. A command that goes on without damaged files starts again
without those that were being read.

The child ends with its parent, and gets the signals that its parent gets.
"""

from __future__ import annotations

import math
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from exwarp_cli.runtime.read_registry import ReadRegistry, attach
from exwarp_cli.runtime.stop import AT_ONCE_S, block_signals

TICK_S = 2.0  # between two looks of the parent at the files that are being read
GRACE_S = 60.0  # for the child to end after a signal: it finishes the files that it writes
MAX_RESTARTS = 32  # a command that fails more often does not fail at single files

# Environment variables: another number of seconds, 0 for no limit; and 0 to run the command in one
# process, for a debugger.
LIMIT_VARIABLE = "EXWARP_FILE_TIMEOUT"
SUPERVISE_VARIABLE = "EXWARP_SUPERVISE"

FORWARDED_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@dataclass(frozen=True)
class ChildExit:
    """How the child ended."""

    code: int  # its exit code; below 0 the signal that ended it, as in `subprocess`
    # Files that libraries were reading then; if some took too long, only these
    reading: tuple[Path, ...] = ()
    overdue: float = 0.0  # seconds at a file after which it was ended; 0 if it was not
    stopped: int = 0  # the signal that asked it to end; 0 without one
    skippable: tuple[Path, ...] = ()  # those of the files without which the command can start again

    @property
    def is_failure(self) -> bool:
        """Whether a library failed; else a user or the system ended it, or it ended itself."""
        crashed = self.code < 0 and -self.code not in (*FORWARDED_SIGNALS, signal.SIGKILL)
        return not self.stopped and (self.overdue > 0 or crashed)

    @property
    def files(self) -> str:
        """The files in words."""
        return " or ".join(str(path) for path in self.reading)

    @property
    def reason(self) -> str:
        """The failure at these files in words."""
        if self.overdue:
            allowed = f"{LIMIT_VARIABLE} allows ({self.overdue:g} s)"
            return f"reading {self.files} took longer than {allowed}"
        return f"a library crashed ({signal.Signals(-self.code).name}) while it read {self.files}"


def is_supervised() -> bool:
    """Return whether commands run in a child: not on Windows, nor if the environment says so."""
    return hasattr(os, "fork") and os.environ.get(SUPERVISE_VARIABLE) != "0"


def fork_command(warn: Callable[[str], None]) -> ChildExit | None:
    """Fork into a child that runs the command, and a parent that waits for it.

    `warn` prints a sentence to the user. Returns None in the process that runs the command, and in
    the parent how the last child ended.
    """
    if not is_supervised():
        return None
    handlers = {number: signal.getsignal(number) for number in FORWARDED_SIGNALS}
    skipped: dict[Path, str] = {}
    for _ in range(MAX_RESTARTS):
        child_exit = _fork_once(skipped, handlers)
        if child_exit is None or not (child_exit.is_failure and child_exit.skippable):
            return child_exit
        reason = child_exit.reason
        skipped |= dict.fromkeys(child_exit.skippable, f"{reason}; render or copy it again")
        without = "it" if len(child_exit.skippable) == 1 else "them"
        warn(f"{reason}; beginning again without {without}")
    return _fork_once(skipped, handlers)


def _fork_once(skipped: Mapping[Path, str], handlers: Mapping[int, Any]) -> ChildExit | None:
    """Fork once; the child handles signals as `handlers` says."""
    messages, messages_in = os.pipe()  # what the child reads
    lifeline, lifeline_in = os.pipe()  # closes with the parent
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()  # else both would print what waits
    with block_signals(*FORWARDED_SIGNALS):  # until both processes handle them
        child = os.fork()
        if child == 0:
            os.close(messages)
            os.close(lifeline_in)
            for number, handler in handlers.items():
                if handler is not None:  # something other than Python set it
                    signal.signal(number, handler)

            def end_with_parent() -> None:
                os.read(lifeline, 1)
                os.kill(os.getpid(), signal.SIGKILL)

            with suppress(RuntimeError):  # no more threads: what needs one says so
                threading.Thread(target=end_with_parent, daemon=True).start()
            attach(messages_in, skipped)
            return None
        signals: list[tuple[int, float]] = []  # number and time

        def forward(number: int, _frame: FrameType | None) -> None:
            signals.append((number, time.monotonic()))
            with suppress(ProcessLookupError):
                os.kill(child, number)

        for number, handler in handlers.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, forward)
    os.close(messages_in)
    os.close(lifeline)
    try:
        return _wait_for_child(child, messages, signals)
    finally:
        os.close(messages)
        os.close(lifeline_in)


def _wait_for_child(child: int, messages: int, signals: list[tuple[int, float]]) -> ChildExit:
    """Wait for the child; kill it if a file takes too long, or if it does not stop."""
    limit = 600.0  # seconds at one file: the largest frames take seconds, and slow shares minutes
    with suppress(ValueError):  # not set, or no number
        limit = float(os.environ.get(LIMIT_VARIABLE, ""))
        limit = limit if limit > 0 else math.inf
    registry = ReadRegistry()
    seconds: dict[int, float] = {}
    overdue: list[int] = []
    tick = min(TICK_S, limit)
    while True:
        begin = time.monotonic()
        is_ready = bool(select.select([messages], [], [], tick)[0])
        data = os.read(messages, 1 << 16) if is_ready else b""
        registry.receive(data)
        if not data:  # the pipe closes with the child
            pid, status = os.waitpid(child, 0 if is_ready else os.WNOHANG)
            if pid:
                numbers = overdue or list(registry.files)
                skippable = set(numbers) - registry.required if registry.restarts else ()
                return ChildExit(
                    os.waitstatus_to_exitcode(status),
                    tuple(dict.fromkeys(registry.files[number] for number in numbers)),
                    limit if overdue else 0.0,
                    signals[0][0] if signals else 0,
                    tuple({registry.files[number] for number in skippable}),
                )
        # A user who suspends both processes for an hour does not want them ended afterwards.
        passed = min(time.monotonic() - begin, 2 * tick)
        seconds = {number: seconds.get(number, 0.0) + passed for number in registry.files}
        overdue = [] if signals else [n for n, spent in seconds.items() if spent > limit]
        is_grace_over = False
        if signals:  # a second one shortens the time to end
            first, last, now = signals[0][1], signals[-1][1], time.monotonic()
            is_repeated = last - first > AT_ONCE_S and now - last > TICK_S
            is_grace_over = is_repeated or now - first > GRACE_S
        if overdue or is_grace_over:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
