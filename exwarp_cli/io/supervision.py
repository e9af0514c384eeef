"""A parent process that outlives whatever a library does to the process that works.

Decoders and drivers are C and C++ of others: on a damaged file they may crash, or never return. So
the command runs in a child, and its parent, which only waits, says in a sentence what became of it.
Files are complete either way, as they are renamed into place. A command that goes on without
damaged files starts again without those that were being read.

The child ends with its parent, and gets the signals that its parent gets.
"""

from __future__ import annotations

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
from exwarp_cli.runtime.stop import AT_ONCE_S, blocked

TICK_S = 2.0
"""How often the parent looks at what is being read."""

LIMIT_S = 600.0
"""How long a library may be at one file; the largest frames take seconds, and slow shares minutes.
"""

LIMIT_VARIABLE = "EXWARP_FILE_TIMEOUT"
"""Environment variable with another number of seconds; 0 for no end."""

ALONE_VARIABLE = "EXWARP_SUPERVISE"
"""Environment variable that is 0 where the command is to run in one process, for a debugger."""

GRACE_S = 60.0
"""How long the child may take to end after a signal: it finishes the files that it writes."""

MOST_RESTARTS = 32
"""What fails more often is not a matter of single files."""

HANDED_ON = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that the child gets when its parent does."""


@dataclass(frozen=True)
class End:
    """How the child ended.

    Attributes
    ----------
    code
        What it exited with; below 0 the signal that ended it, as of `subprocess`.
    reading
        The files that libraries were reading then; those that took too long, if any did.
    overdue
        Whether it was ended because one of them took too long.
    stopped
        The signal that asked it to end; 0 without one.
    skippable
        Those of the files without which the command can start again.
    """

    code: int
    reading: tuple[Path, ...] = ()
    overdue: bool = False
    stopped: int = 0
    skippable: tuple[Path, ...] = ()

    @property
    def is_failure(self) -> bool:
        """Whether a library failed, rather than that a user or the system ended it."""
        crashed = self.code < 0 and -self.code not in (*HANDED_ON, signal.SIGKILL)
        return not self.stopped and (self.overdue or crashed)

    @property
    def named(self) -> str:
        """The files in words."""
        return " or ".join(str(path) for path in self.reading)

    @property
    def reason(self) -> str:
        """What became of it where libraries were reading files, without what to do."""
        if self.overdue:
            return f"reading {self.named} took longer than {LIMIT_VARIABLE} allows ({limit():g} s)"
        return f"a library crashed ({signal.Signals(-self.code).name}) while it read {self.named}"


def parts() -> bool:
    """Whether commands are parted into two processes: not on Windows, nor where one is wanted."""
    return hasattr(os, "fork") and os.environ.get(ALONE_VARIABLE) != "0"


def part(tell: Callable[[str], None]) -> End | None:
    """Part this process in a child that works and a parent that waits for it.

    Parameters
    ----------
    tell
        Says a sentence to the user.

    Returns
    -------
    End or None
        None in the child, and where processes are not parted: there the command runs alone. In the
        parent, once the last child has ended, how it did.
    """
    if not parts():
        return None
    usual = {number: signal.getsignal(number) for number in HANDED_ON}
    skipped: dict[Path, str] = {}
    for _ in range(MOST_RESTARTS):
        end = _part(skipped, usual)
        if end is None or not (end.is_failure and end.skippable):
            return end
        skipped |= dict.fromkeys(end.skippable, f"{end.reason}; render or copy it again")
        without = "it" if len(end.skippable) == 1 else "them"
        tell(f"{end.reason}; beginning again without {without}")
    return _part(skipped, usual)


def _part(skipped: Mapping[Path, str], usual: Mapping[int, Any]) -> End | None:
    """Part this process once, with what signals do in the child."""
    notes, noted = os.pipe()  # what the child reads
    lifeline, held = os.pipe()  # closes with the parent
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()  # else both would print what waits
    with blocked(*HANDED_ON):  # until both processes handle them
        child = os.fork()
        if child == 0:
            os.close(notes)
            os.close(held)
            for number, handler in usual.items():
                if handler is not None:  # something other than Python set it
                    signal.signal(number, handler)
            with suppress(RuntimeError):  # no more threads: what needs one says so
                threading.Thread(target=_end_with_parent, args=(lifeline,), daemon=True).start()
            attach(noted, skipped)
            return None
        handed_on = _hand_on(child, usual)
    os.close(noted)
    os.close(lifeline)
    try:
        return _await(child, notes, handed_on)
    finally:
        os.close(notes)
        os.close(held)


def limit() -> float:
    """Return after how many seconds at one file the child is ended."""
    try:
        seconds = float(os.environ.get(LIMIT_VARIABLE, ""))
    except ValueError:
        return LIMIT_S
    return seconds if seconds > 0 else float("inf")


def _await(child: int, notes: int, handed_on: list[tuple[int, float]]) -> End:
    """Wait for the child; end it where a file takes too long, or where it does not stop."""
    most = limit()
    registry = ReadRegistry()
    seconds: dict[int, float] = {}
    overdue: list[int] = []
    tick = min(TICK_S, most)
    while True:
        begin = time.monotonic()
        ready = bool(select.select([notes], [], [], tick)[0])
        data = os.read(notes, 1 << 16) if ready else b""
        registry.receive(data)
        if not data:  # the pipe closes with the child
            done, status = os.waitpid(child, 0 if ready else os.WNOHANG)
            if done:
                numbers = overdue or list(registry.files)
                skippable = set(numbers) - registry.required if registry.restarts else ()
                return End(
                    os.waitstatus_to_exitcode(status),
                    tuple(dict.fromkeys(registry.files[number] for number in numbers)),
                    bool(overdue),
                    handed_on[0][0] if handed_on else 0,
                    tuple({registry.files[number] for number in skippable}),
                )
        # A user who suspends both processes for an hour does not want them ended afterwards.
        passed = min(time.monotonic() - begin, 2 * tick)
        seconds = {number: seconds.get(number, 0.0) + passed for number in registry.files}
        overdue = [] if handed_on else [n for n, spent in seconds.items() if spent > most]
        if overdue or _is_to_be_ended(handed_on):
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)


def _is_to_be_ended(handed_on: list[tuple[int, float]]) -> bool:
    """Whether the child did not end by a signal in time; a second signal shortens that."""
    if not handed_on:
        return False
    first, last, now = handed_on[0][1], handed_on[-1][1], time.monotonic()
    return now - first > GRACE_S or (last - first > AT_ONCE_S and now - last > TICK_S)


def _hand_on(child: int, usual: Mapping[int, Any]) -> list[tuple[int, float]]:
    """Have the child get the signals that end a command; who ignores one keeps to that.

    Returns
    -------
    list of (int, float)
        Those that came, as they come, each with its time.
    """
    came: list[tuple[int, float]] = []

    def hand_on(number: int, _frame: FrameType | None) -> None:
        came.append((number, time.monotonic()))
        with suppress(ProcessLookupError):
            os.kill(child, number)

    for number, handler in usual.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, hand_on)
    return came


def _end_with_parent(lifeline: int) -> None:
    """End this process when its parent does, whatever ended that."""
    os.read(lifeline, 1)
    os.kill(os.getpid(), signal.SIGKILL)
