"""Every error that a user can cause, in one tree.

::

    ExwarpError                 exit code
      UsageError                2   options that contradict each other or do not parse
      InputError                3   an input file or sequence that cannot be used
        MissingFrameError       3   a frame that the sequence should have and does not
        DamagedFileError        3   a file that is truncated, not an EXR, or unreadable
        LayoutError             3   channels, sizes or windows that do not fit together
      UnreadableError           3   a file that the system does not let through; it may be sound
      MotionError               4   the convention of the motion vectors cannot be settled
      OutputError               5   a file that cannot be written (rights, space, folder)
        OutputExistsError       6   frames in the way, without --overwrite or --skip-existing
        ReaderGoneError         5   the program that reads standard output has ended
      MissingExtraError         7   an optional dependency that is not installed
      QualityError              8   a quality worse than a limit that the user set
      ClusterError              9   a cluster that cannot be reached, or that loses its workers
      InstallationError        10   an installation in which something does not work
      OutOfMemoryError         11   more memory, threads or processes are needed than there are
      IncompleteError          12   something was left out, as --keep-going has it

A message says what is wrong, where (the file, frame or option), and what to do about it, in one
sentence. Exit code 0 means that all went well, 1 is left for defects of ExWarp itself, 130 means
interrupted by the user, 143 terminated, as in shells.
"""

from __future__ import annotations

import errno
import os

INTERRUPTED = 130


class ExwarpError(Exception):
    """Root of the tree; `exit_code` is what the command exits with."""

    exit_code = 1


class UsageError(ExwarpError):
    """Options that contradict each other or do not parse."""

    exit_code = 2


class InputError(ExwarpError):
    """An input file or sequence that cannot be used."""

    exit_code = 3


class MissingFrameError(InputError):
    """A frame that the sequence should have and does not."""


class DamagedFileError(InputError):
    """A file that is truncated, is not what its name says, or cannot be read."""


class LayoutError(InputError):
    """Channels, sizes or windows that do not fit together."""


class UnreadableError(ExwarpError):
    """A file that the system does not let through: share, rights, number of open files."""

    # No InputError: a run that goes on without damaged frames stops at this.
    exit_code = 3


class MotionError(ExwarpError):
    """The convention of the motion vectors cannot be settled."""

    exit_code = 4


class OutputError(ExwarpError):
    """A file that cannot be written."""

    exit_code = 5


class OutputExistsError(OutputError):
    """Frames that this run would write exist already."""

    exit_code = 6


class ReaderGoneError(OutputError):
    """The program that reads standard output has ended, as ``| head`` does; without a message."""


class MissingExtraError(ExwarpError):
    """An optional dependency that is not installed."""

    exit_code = 7


class QualityError(ExwarpError):
    """A quality is worse than a limit that the user set; everything else went well."""

    exit_code = 8


class ClusterError(ExwarpError):
    """A cluster cannot be reached, cannot do the work, or loses its workers."""

    exit_code = 9


class InstallationError(ExwarpError):
    """Something of the installation does not work on this machine."""

    exit_code = 10


class OutOfMemoryError(ExwarpError):
    """More memory, threads or processes are needed than there are."""

    exit_code = 11


class IncompleteError(ExwarpError):
    """Something was left out whose input cannot be used; everything else is made."""

    exit_code = 12


def thread_limit_error(error: BaseException) -> OutOfMemoryError | None:
    """Translate an error that says that the system starts no more threads or processes."""
    # Python raises BlockingIOError for processes and RuntimeError for threads; libraries in C++
    # raise RuntimeError with the words of the system.
    if isinstance(error, OSError):
        is_limit = error.errno == errno.EAGAIN and error.filename is None
    else:
        texts = ("can't start new thread", os.strerror(errno.EAGAIN))
        is_limit = isinstance(error, RuntimeError) and any(text in str(error) for text in texts)
    if not is_limit:
        return None
    return OutOfMemoryError(
        "the system lets this user start no more threads or processes; raise the limit (ulimit -u, "
        "or that of the container or batch job), or end other programs"
    )


def to_exwarp_error(error: BaseException) -> ExwarpError | None:
    """Translate any error to one of this tree; None for a defect of ExWarp.

    Wherever code looks whether a file exists, it may meet a folder that may not be entered, a
    network share that went away, or a name that is too long.
    """
    if isinstance(error, ExwarpError):
        return error
    if (limit := thread_limit_error(error)) is not None:
        return limit
    if not isinstance(error, OSError) or not isinstance(error.filename, str):
        return None
    if error.strerror is None:
        return None
    # Errors that only writing causes.
    is_output = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)
    kind = OutputError if is_output else InputError
    return kind(f"cannot use {error.filename}: {error.strerror}; check the path and its rights")
