"""Reads that fail by the system and not by the file: repeated, then reported as what they are.

A share that went away, rights that are missing and a full table of open files say nothing about a
frame. Decoders report all of them as damage, so the reason is looked up here.
"""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from exwarp_cli.errors import DamagedFileError, UnreadableError
from exwarp_cli.runtime.stop import check_stop

T = TypeVar("T")

PAUSES = (0.1, 0.4, 1.6)
"""Seconds before each further try. Shares that change servers come back within seconds."""

PROBED_BYTES = 1 << 22

_OF_THE_PATH = frozenset(
    {
        *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG),
        *(errno.EINVAL, errno.EBADF, errno.EFBIG, errno.EOVERFLOW, errno.ESPIPE),
    }
)
"""Errors that come from a wrong path, or from a wrong offset in a damaged file."""

_RIGHTS = frozenset({errno.EACCES, errno.EPERM})
"""Errors that waiting does not mend; one more try is for shares that are being mounted."""

_REMEDIES = {
    **dict.fromkeys(_RIGHTS, "check the rights of the file and of the folders above it"),
    errno.EMFILE: "raise the limit of open files ('ulimit -n'), or use fewer threads",
    errno.ENFILE: "close other programs, or raise the system's limit of open files",
    errno.ENOMEM: "close other programs, or use fewer threads",
}
_CHECK_SHARE = "check the disk, or the network share and its mount, and run again"


def with_retries(path: Path, read: Callable[[], T]) -> T:
    """Call a reader of a file, again after a pause while the system makes it fail.

    Parameters
    ----------
    path
        The file.
    read
        Opens the file anew at each call, as a stale handle stays stale.

    Raises
    ------
    UnreadableError
        When the system makes the last try fail, too.
    OSError, DamagedFileError
        What `read` raises when the file or its path is the cause.
    """
    pauses = iter(PAUSES)
    repeated = False
    while True:
        try:
            return read()
        except (OSError, DamagedFileError) as error:
            failure = system_failure(path, error)
            if failure is None:
                # The probe succeeds: either the file is damaged, or the fault has just passed.
                if repeated or isinstance(error, OSError):
                    raise
                repeated = True
                continue
            pause = next(pauses, None)
            if pause is None or (failure.errno in _RIGHTS and pause != PAUSES[0]):
                raise unreadable(path, failure) from error
        check_stop()
        time.sleep(pause)


def system_failure(path: Path, error: BaseException) -> OSError | None:
    """Return the system's error behind a failed read; None if the file or its path is wrong.

    Parameters
    ----------
    path
        The file. It is read to its end where `error` does not tell.
    error
        What the reader raised.
    """
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno is not None:
            return None if cause.errno in _OF_THE_PATH else cause
        cause = cause.__cause__
    return probe(path)


def probe(path: Path) -> OSError | None:
    """Read a file to its end; return the error by which the system refuses that, None without."""
    try:
        # Without waiting, as a pipe has no end.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        try:
            while os.read(handle, PROBED_BYTES):
                pass
        finally:
            os.close(handle)
    except OSError as error:
        return None if error.errno in _OF_THE_PATH else error
    return None


def unreadable(path: Path, error: OSError) -> UnreadableError:
    """Build the error for a file that the system does not let through."""
    remedy = _REMEDIES.get(error.errno or 0, _CHECK_SHARE)
    return UnreadableError(f"cannot read {path}: {error.strerror or error}; {remedy}")
