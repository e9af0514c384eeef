"""The standard streams of the process, made safe for whatever is printed.

The caller of the command decides where they lead: nowhere, to a disk that is full, to a program
that reads the first lines and ends, to a terminal that lacks characters.
"""

from __future__ import annotations

import io
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from exwarp_cli.errors import OutputError, ReaderGoneError

STDOUT, STDERR = 1, 2

_silencing = threading.RLock()  # the descriptor belongs to all threads


class StandardOutput(io.FileIO):
    """Standard output whose failures tell it from any other file.

    After the first failure everything else that is printed is dropped.
    """

    _has_failed = False

    def write(self, data: Any, /) -> Any:
        """Write bytes.

        Raises ReaderGoneError when the reader has ended; its user knows that. Raises OutputError
        when they cannot be written for another reason.
        """
        if self._has_failed:
            return memoryview(data).nbytes
        try:
            return super().write(data)
        except BrokenPipeError as error:
            self._has_failed = True
            raise ReaderGoneError from error
        except OSError as error:
            self._has_failed = True
            raise OutputError(
                f"cannot write to the standard output: {error.strerror}; send it elsewhere"
            ) from error


class StandardError(io.FileIO):
    """Standard error that drops what it cannot write: messages must not stop the work."""

    def write(self, data: Any, /) -> Any:
        """Write bytes, or drop them where that fails."""
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes


def prepare_streams() -> None:
    """Open what the parent process closed, and replace standard output and standard error."""
    if None in (sys.stdin, sys.stdout, sys.stderr):
        # Else the next file that is opened takes the place of one, and gets what is printed.
        while (number := os.open(os.devnull, os.O_RDWR)) <= STDERR:
            os.set_inheritable(number, True)
        os.close(number)
        # Python's own object of a closed stream is None.
        sys.stdout = sys.stdout or os.fdopen(STDOUT, "w", closefd=False)
        sys.stderr = sys.stderr or os.fdopen(STDERR, "w", closefd=False)
    if os.name == "nt":
        return  # a console of Windows is no file
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout = _replace_file(sys.stdout, StandardOutput(STDOUT, "w", closefd=False))
    if isinstance(sys.stderr, io.TextIOWrapper):
        # Its own descriptor, so that `silence_libraries` does not silence ExWarp itself.
        sys.stderr = _replace_file(sys.stderr, StandardError(os.dup(STDERR), "w"))


def is_debugging() -> bool:
    """Return whether the environment asks for all details."""
    return os.environ.get("EXWARP_DEBUG", "0") not in ("", "0")


@contextmanager
def silence_libraries() -> Iterator[None]:
    """Drop what libraries in C write to standard error within a block.

    Lines that Python prints there are kept, if `prepare_streams` has replaced the stream.
    With EXWARP_DEBUG=1 nothing is dropped.
    """
    if is_debugging():
        yield
        return
    with _silencing:
        try:
            saved = os.dup(STDERR)
        except OSError:  # closed, or no descriptor is left
            yield
            return
        try:
            with suppress(OSError):
                null = os.open(os.devnull, os.O_WRONLY)
                os.dup2(null, STDERR)
                os.close(null)
            yield
        finally:
            os.dup2(saved, STDERR)
            os.close(saved)


def _replace_file(stream: io.TextIOWrapper, file: io.FileIO) -> io.TextIOWrapper:
    """Return a text stream over another file, with the encoding of the old one."""
    encoding, errors = stream.encoding, stream.errors
    if errors == "strict":
        # Bytes of file names that are no Unicode are printed as they are; characters that a
        # terminal of another encoding lacks are spelled out.
        is_utf8 = encoding.lower().replace("-", "") == "utf8"
        errors = "surrogateescape" if is_utf8 else "backslashreplace"
    buffer = io.BufferedWriter(file)
    return io.TextIOWrapper(buffer, encoding, errors, line_buffering=stream.line_buffering)
