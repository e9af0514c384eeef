"""A parent that outlives whatever a library does to the process that works.

Decoders and drivers are other people's C and C++: on a damaged file they may crash, or never come
back. So the command runs in a child, and its parent, which only waits, says in a sentence what
became of it. What the child wrote is whole either way: files are renamed into place. A command that
goes on without bad files begins again, without those.

The child dies with its parent, and gets the signals that its parent gets. Where it does not end on
them, it is ended.
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
from typing import Any, NoReturn

from exwarp_cli.domain.being_read import Board, hang_up

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
"""How long the child may take to end once it was told to: a frame's write, or a network's run."""

MOST_AGAIN = 32
"""How often a command begins again: what fails more often is not a matter of single files."""

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
        The files that libraries were reading then.
    overdue
        Whether it was ended because one of them took too long.
    stopped
        The signal by which somebody wanted it to end; 0 where nobody did.
    """

    code: int
    reading: tuple[Path, ...] = ()
    overdue: bool = False
    stopped: int = 0

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
    board = Board()
    usual = {number: signal.getsignal(number) for number in HANDED_ON}
    for _ in range(MOST_AGAIN):
        end = _part(board, usual)
        if end is None or not (end.reading and end.is_failure and board.goes_on):
            return end
        board.clear()
        if len(end.reading) > 1 and not board.singly:
            board.singly = True
            tell(f"{end.reason}; beginning again, to find out which")
        else:
            board.refused |= dict.fromkeys(end.reading, f"{end.reason}; render or copy it again")
            tell(f"{end.reason}; beginning again without it")
    return _part(board, usual)


def _part(board: Board, usual: Mapping[int, Any]) -> End | None:
    """Part this process once, with what signals do in the child."""
    alive, held = os.pipe()  # the child's end closes with it
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()  # else both would print what waits
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        os.close(alive)
        for number, handler in usual.items():
            if handler is not None:  # something other than Python set it
                signal.signal(number, handler)
        _die_with(parent)
        hang_up(board)
        return None
    os.close(held)
    handed_on = _hand_on(child, usual)
    try:
        return _await(child, alive, board, handed_on)
    finally:
        os.close(alive)


def limit() -> float:
    """Return after how many seconds at one file the child is ended."""
    try:
        told = float(os.environ.get(LIMIT_VARIABLE, ""))
    except ValueError:
        return LIMIT_S
    return told if told > 0 else float("inf")


def _await(child: int, alive: int, board: Board, handed_on: list[int]) -> End:
    """Wait for the child; end it where a file takes too long, or where it does not stop."""
    most = limit()
    since: dict[int, float] = {}
    overdue = False
    stopped = 0.0
    tick = min(TICK_S, most)
    while True:
        begin = time.monotonic()
        gone = bool(select.select([alive], [], [], tick)[0])
        done, status = os.waitpid(child, 0 if gone else os.WNOHANG)
        reading = board.notes()
        if done:
            files = tuple(dict.fromkeys(reading.values()))
            return End(os.waitstatus_to_exitcode(status), files, overdue, *handed_on[:1])
        # Whoever stops both processes for an hour does not want them ended afterwards.
        passed = min(time.monotonic() - begin, 2 * tick)
        since = {number: since.get(number, 0.0) + passed for number in reading}
        stopped += passed if handed_on else 0.0
        overdue = not handed_on and any(seconds > most for seconds in since.values())
        if overdue or stopped > GRACE_S:
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)


def _hand_on(child: int, usual: Mapping[int, Any]) -> list[int]:
    """Have the child get the signals that end a command; who ignores one keeps to that.

    Returns
    -------
    list of int
        Those that came, as they come.
    """
    came: list[int] = []

    def hand_on(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        with suppress(ProcessLookupError):
            os.kill(child, number)

    for number, handler in usual.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, hand_on)
    return came


def _die_with(parent: int) -> None:
    """Have this process end when its parent does, whatever ended that."""
    if not _by_kernel():
        threading.Thread(target=_end_without, args=(parent,), daemon=True).start()
    if os.getppid() != parent:  # it was quicker
        os.kill(os.getpid(), signal.SIGKILL)


def _by_kernel() -> bool:
    """Have Linux end this process with its parent; whether it will."""
    if not sys.platform.startswith("linux"):
        return False
    import ctypes  # numpy does, too

    set_signal: Callable[..., int] | None
    set_signal = getattr(ctypes.CDLL(None), "prctl", None)
    pdeathsig = 1  # PR_SET_PDEATHSIG of <linux/prctl.h>
    return set_signal is not None and set_signal(pdeathsig, signal.SIGKILL) == 0


def _end_without(parent: int) -> NoReturn:
    while os.getppid() == parent:
        time.sleep(TICK_S)
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError
