"""Stops: SIGINT and SIGTERM set a flag that loops read; a second signal ends the process at once.

Files appear only when they are complete, and the next run removes what is left of dead ones. So
nothing is lost but the frames under way, wherever a process ends.
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
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from subprocess import Popen

AT_ONCE_S = 1.0
"""Seconds in which signals count as one. A terminal sends SIGINT to both processes of a command,
and the parent hands it on."""

STALLED_S = 8.0
"""Seconds without progress after which a process that was asked to stop is ended.

A frame of 1920x1080 by a network takes 3 s of one core, and 6 s on a busy machine. Containers and
farms allow 10 s or more before they kill. A longer frame is lost, and the next run makes it again.
"""

_TICK_S = 0.25

# The signal by which this process was asked to stop. No Event: its lock may be held by the thread
# that a handler interrupts.
_number = 0
_progress = 0.0  # when a frame was last written, or a loop began to stop
_temporaries: set[Path] = set()
_programs: set[Popen[bytes]] = set()


class StopRequested(BaseException):
    """A loop ends by this exception; no `Exception`, as it is no failure.

    Attributes
    ----------
    number
        The signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def check_stop() -> None:
    """Raise StopRequested if this process was asked to stop; loops call it after each frame."""
    if _number:
        _note_progress()
        raise StopRequested(_number)


@contextmanager
def removed_at_end(path: Path) -> Iterator[Path]:
    """Yield the path of a temporary file that is removed with the block, or with the process."""
    _temporaries.add(path)
    try:
        yield path
    finally:
        with suppress(OSError):
            path.unlink(missing_ok=True)
        _temporaries.discard(path)
        _note_progress()


@contextmanager
def killed_at_end(program: Popen[bytes]) -> Iterator[None]:
    """Kill a program with this process in the block, as it may write a temporary file anew."""
    _programs.add(program)
    try:
        yield
    finally:
        _programs.discard(program)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield an empty folder that is removed, with its files, as `removed_at_end` removes a file."""
    import tempfile  # not needed by most commands

    with tempfile.TemporaryDirectory("-exwarp", ignore_cleanup_errors=True) as name:
        _temporaries.add(Path(name))
        try:
            yield Path(name)
        finally:
            _temporaries.discard(Path(name))


@contextmanager
def graceful_stop(last_words: Callable[[int], str], is_last: bool = False) -> Iterator[None]:
    """Have SIGINT and SIGTERM set the flag within the block.

    Outside the main thread signals belong to the program that embeds this one; the block changes
    nothing then. A program that ignores SIGINT, or handles it, keeps that.

    Parameters
    ----------
    last_words
        Returns the sentence to print when a signal ends the process at once.
    is_last
        Whether the process ends after the block; signals are ignored from there on.

    Raises
    ------
    StopRequested
        When something failed after a signal: programs that got it too may have ended.
    """
    global _number
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    watcher = threading.Thread(target=_watch, args=(receiver, last_words), daemon=True)
    watcher.start()
    # Python runs a handler between two steps of the main thread, which may be in a library for
    # minutes. What C writes to this descriptor reaches the other thread at once.
    usual_wakeup = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    usual = {signal.SIGTERM: signal.signal(signal.SIGTERM, _ask)}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        usual[signal.SIGINT] = signal.signal(signal.SIGINT, _ask)
    try:
        yield
    except Exception as error:
        if _number:
            raise StopRequested(_number) from error
        raise
    finally:
        for number, handler in usual.items():
            signal.signal(number, signal.SIG_IGN if is_last else handler or signal.SIG_DFL)
        signal.set_wakeup_fd(usual_wakeup)
        sender.close()  # ends the thread
        watcher.join()
        _number = 0


@contextmanager
def blocked(*numbers: int) -> Iterator[None]:
    """Keep signals from this thread in the block, and from what starts in it for good.

    A terminal sends SIGINT to all processes of a command, and one that is importing would print a
    traceback. Another thread takes the signal for this process meanwhile.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, numbers)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _ask(number: int, _frame: FrameType | None = None) -> None:
    global _number
    _number = _number or number


def _note_progress() -> None:
    global _progress
    _progress = time.monotonic()


def _watch(receiver: socket.socket, last_words: Callable[[int], str]) -> None:
    """End this process at a second signal, or when it does not stop by itself."""
    first, is_announced = 0.0, False
    with receiver:
        while True:
            try:
                number = receiver.recv(1)
            except TimeoutError:
                now = time.monotonic()
                if now - max(first, _progress) > STALLED_S:
                    _end(last_words)
                if now - first > AT_ONCE_S and not is_announced:
                    is_announced = True
                    _announce()
                continue
            if not number:
                return
            if number[0] not in (signal.SIGINT, signal.SIGTERM):
                continue
            if first and time.monotonic() - first > AT_ONCE_S:
                _end(last_words)
            if not first:
                first = time.monotonic()
                receiver.settimeout(_TICK_S)
                _ask(number[0])


def _announce() -> None:
    """Tell the user of a terminal why the command still runs."""
    with suppress(ValueError, AttributeError):
        if _number == signal.SIGINT and sys.stderr.isatty():
            _write("exwarp: stopping after the current frame; a second Ctrl-C stops at once")


def _end(last_words: Callable[[int], str]) -> NoReturn:
    """End this process from another thread: the main one may be in a library."""
    _write(last_words(_number))
    for program in list(_programs):
        program.kill()
        with suppress(Exception):  # also when the main thread waits for it
            program.wait(1)
    for path in list(_temporaries):
        with suppress(OSError):
            if path.is_dir():
                import shutil  # it is there, as `tempfile` needs it

                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
    os._exit(128 + _number)


def _write(line: str) -> None:
    with suppress(OSError, ValueError, AttributeError):
        os.write(sys.stderr.fileno(), f"{line}\n".encode())  # a lock may be held on the stream
