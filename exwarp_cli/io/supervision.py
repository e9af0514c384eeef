"""A parent that outlives whatever a library does to the process that works.

Decoders and drivers are other people's C and C++: on a damaged file they may crash, or never come
back. So the command runs in a child, and its parent, which only waits, says in a sentence what
became of it. What the child wrote is whole either way: files are renamed into place.

The child dies with its parent, and gets the signals that its parent gets.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import NoReturn

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

AT_ONCE_S = 1.0
"""Seconds in which a second interruption is taken for the same one: a terminal sends it to both
processes, and the parent hands it on."""

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
        What it exited with; None where a signal ended it.
    signal
        That one's number; 0 where none did.
    reading
        The files that libraries were reading then.
    overdue
        Whether it was ended because one of them took too long.
    """

    code: int | None
    signal: int = 0
    reading: tuple[Path, ...] = ()
    overdue: bool = False


def part() -> End | None:
    """Part this process in a child that works and a parent that waits for it.

    Returns
    -------
    End or None
        None in the child, and where processes cannot be parted, as on Windows: there the command
        runs alone. In the parent, once the child has ended, how it did.
    """
    if not hasattr(os, "fork") or os.environ.get(ALONE_VARIABLE) == "0":
        return None
    board = Board()
    alive, held = os.pipe()  # the child's end closes with it
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()  # else both would print what waits
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        os.close(alive)
        _die_with(parent)
        _interrupted_once()
        hang_up(board)
        return None
    os.close(held)
    _hand_on(child)
    return _await(child, alive, board, limit())


def limit() -> float:
    """Return after how many seconds at one file the child is ended."""
    try:
        told = float(os.environ.get(LIMIT_VARIABLE, ""))
    except ValueError:
        return LIMIT_S
    return told if told > 0 else float("inf")


def _await(child: int, alive: int, board: Board, most: float) -> End:
    """Wait for the child; end it where a file takes too long."""
    since: dict[int, float] = {}
    overdue = False
    tick = min(TICK_S, most)
    while True:
        begin = time.monotonic()
        gone = bool(select.select([alive], [], [], tick)[0])
        done, status = os.waitpid(child, 0 if gone else os.WNOHANG)
        reading = board.notes()
        if done:
            code = os.waitstatus_to_exitcode(status)
            files = tuple(dict.fromkeys(reading.values()))
            if code >= 0:
                return End(code)
            return End(None, -code, files, overdue)
        # Whoever stops both processes for an hour does not want them ended afterwards.
        passed = min(time.monotonic() - begin, 2 * tick)
        since = {number: since.get(number, 0.0) + passed for number in reading}
        if not overdue and any(seconds > most for seconds in since.values()):
            overdue = True
            with suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)


def _hand_on(child: int) -> None:
    """Have the child get the signals that end a command; who ignores one keeps to that."""

    def hand_on(number: int, _frame: FrameType | None) -> None:
        with suppress(ProcessLookupError):
            os.kill(child, number)

    for number in HANDED_ON:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, hand_on)


def _interrupted_once() -> None:
    """Take interruptions that come at once for one: a second would break off cleaning up."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return
    last = float("-inf")

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal last
        before, last = last, time.monotonic()
        if last - before > AT_ONCE_S:
            signal.default_int_handler(number, frame)

    signal.signal(signal.SIGINT, interrupt)


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
