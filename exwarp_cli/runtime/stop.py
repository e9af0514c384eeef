"""Stops: SIGINT and SIGTERM set a flag that loops read; a second signal ends the process at once.

Files appear only when they are complete, and the next run removes the temporaries of dead ones. So
wherever a process ends, only its unfinished frames are lost.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

# Seconds in which signals count as one. A terminal sends SIGINT to both processes of a command, and
# the parent forwards it.
AT_ONCE_S = 1.0

# Seconds without progress after which a process that was asked to stop is ended. A frame of
# 1920x1080 by a network takes 3 s of one core, and 6 s on a busy machine. Containers and farms
# allow 10 s or more before they kill. A longer frame is lost, and the next run makes it again.
STALLED_S = 8.0

# The signal by which this process was asked to stop. No Event: its lock may be held by the thread
# that a handler interrupts.
_number = 0
_progress = 0.0  # when a loop began to stop, or a temporary file was last completed
_clean_ups: list[Callable[[], object]] = []


@dataclass(eq=False)
class StopRequested(BaseException):
    """Ends a loop; no `Exception`, as it is no failure."""

    number: int  # the signal's


def check_stop() -> None:
    """Raise StopRequested if this process was asked to stop; loops call it after each frame."""
    if _number:
        note_progress()
        raise StopRequested(_number)


def note_progress() -> None:
    """Let a process that was asked to stop run on for a while; slow clean-ups call it."""
    global _progress
    _progress = time.monotonic()


@contextmanager
def clean_up_after(action: Callable[[], object]) -> Iterator[None]:
    """Call an action when the block ends, or the process within it; if both end, twice."""
    _clean_ups.append(action)
    try:
        yield
    finally:
        action()
        _clean_ups.remove(action)
        note_progress()


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield an empty folder that is removed when the block ends, or the process within it."""
    import tempfile  # not needed by most commands

    folder = tempfile.TemporaryDirectory("-exwarp", ignore_cleanup_errors=True)
    with clean_up_after(folder.cleanup):
        yield Path(folder.name)


@contextmanager
def graceful_stop(last_words: Callable[[int], str], is_last: bool = False) -> Iterator[None]:
    """Let SIGINT and SIGTERM set the flag within the block, unless SIGINT is ignored.

    Outside the main thread signals belong to the program that embeds this one: nothing changes.
    `last_words` returns what to print when a signal, whose number it takes, ends the process at
    once. With `is_last` the process ends after the block, and signals are ignored from there on.

    Raises StopRequested when something failed after a signal: programs that got it too may have
    ended.
    """
    global _number
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    # Python runs a handler between two steps of the main thread, which may be in a library for
    # minutes. What C writes to the wakeup descriptor reaches the other thread at once.
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    watcher = threading.Thread(target=_watch, args=(receiver, last_words), daemon=True)
    previous = None
    handlers = {signal.SIGTERM: signal.signal(signal.SIGTERM, _request_stop)}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        handlers[signal.SIGINT] = signal.signal(signal.SIGINT, _request_stop)
    try:
        with suppress(RuntimeError):  # no more threads: what needs one says so; the flag is set
            watcher.start()
            previous = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
        yield
    except Exception as error:
        if _number:
            raise StopRequested(_number) from error
        raise
    finally:
        if previous is not None:
            signal.set_wakeup_fd(previous)
            sender.close()  # ends the thread
            watcher.join()
        sender.close()
        receiver.close()
        for number, handler in handlers.items():
            signal.signal(number, signal.SIG_IGN if is_last else handler or signal.SIG_DFL)
        _number = 0


@contextmanager
def block_signals(*numbers: int) -> Iterator[None]:
    """Keep signals from this thread in the block, and for good from processes that start in it.

    A terminal interrupts all processes of a command; one that is importing prints a traceback.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _request_stop(number: int, _frame: FrameType | None = None) -> None:
    global _number
    _number = _number or number


def _watch(receiver: socket.socket, last_words: Callable[[int], str]) -> None:
    """End this process at a second signal, or when it does not stop by itself."""
    first = 0.0
    with receiver:
        while True:
            try:
                number = receiver.recv(1)
            except TimeoutError:
                if time.monotonic() - max(first, _progress) > STALLED_S:
                    break
                continue
            if not number:
                return
            if number[0] not in (signal.SIGINT, signal.SIGTERM):
                continue
            if first and time.monotonic() - first > AT_ONCE_S:
                break
            if not first:
                first = time.monotonic()
                receiver.settimeout(0.25)
                _request_stop(number[0])
        with suppress(OSError, ValueError, AttributeError):  # a lock may be held on the stream
            os.write(sys.stderr.fileno(), f"{last_words(_number)}\n".encode())
        for action in reversed(_clean_ups.copy()):  # programs before the files that they write
            with suppress(Exception):
                action()
        os._exit(128 + _number)  # from this thread: the main one may be in a library
