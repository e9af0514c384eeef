"""The standard streams of the process, made fit for whatever is printed.

Whoever starts the command decides where they lead: nowhere, to a disk that is full, to a program
that reads the first lines and goes, to a terminal that lacks characters.
"""

from __future__ import annotations

import io
import os
import sys
from typing import Any

from exwarp_cli.errors import OutputError

STDOUT, STDERR = 1, 2


class StandardOutput(io.FileIO):
    """Standard output whose failures are no failures to write just any file.

    What is printed after the first failure is lost, too, in silence.
    """

    def __init__(self) -> None:
        super().__init__(STDOUT, "w", closefd=False)
        self._lost = False

    def write(self, data: Any, /) -> Any:
        """Write bytes.

        Raises
        ------
        OutputError
            When they cannot be written; it says nothing where nobody reads them any more, as behind
            ``| head``: who broke off knows it.
        """
        if self._lost:
            return memoryview(data).nbytes
        try:
            return super().write(data)
        except BrokenPipeError as error:
            self._lost = True
            raise OutputError from error
        except OSError as error:
            self._lost = True
            raise OutputError(
                f"cannot write to the standard output: {error.strerror}; send it elsewhere"
            ) from error


def prepare_streams() -> None:
    """Open what is closed, and take over standard output."""
    _open_closed()
    if not isinstance(sys.stdout, io.TextIOWrapper) or os.name == "nt":
        return  # a console of Windows is no file
    encoding, errors = sys.stdout.encoding, sys.stdout.errors
    if errors == "strict":
        # Bytes of file names that are no Unicode are printed as they are; characters that a
        # terminal of another encoding lacks are spelled out.
        is_utf8 = encoding.lower().replace("-", "") == "utf8"
        errors = "surrogateescape" if is_utf8 else "backslashreplace"
    sys.stdout = io.TextIOWrapper(
        io.BufferedWriter(StandardOutput()), encoding, errors,
        line_buffering=sys.stdout.line_buffering,
    )  # fmt: skip


def _open_closed() -> None:
    """Open the streams that whoever started the process closed.

    Else the next file that is opened takes the place of one of them, and gets what is printed.
    """
    if None not in (sys.stdin, sys.stdout, sys.stderr):
        return
    while (number := os.open(os.devnull, os.O_RDWR)) <= STDERR:
        os.set_inheritable(number, True)
    os.close(number)
    # Of a stream that is closed Python's own object is None.
    sys.stdout = sys.stdout or os.fdopen(STDOUT, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(STDERR, "w", closefd=False)
