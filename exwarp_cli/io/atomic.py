"""Files that are absent or complete: written beside their place, then renamed into it.

`await_file` waits for those of other machines; `Held` keeps what is open for a ``with`` block.
"""

from __future__ import annotations

import errno
import itertools
import os
import re
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

from exwarp_cli.domain.cores import waiting
from exwarp_cli.errors import InputError, OutputError
from exwarp_cli.io.reading_retry import probe, with_retries
from exwarp_cli.runtime.stop import check_stop, cleaned_up

MARK = ".exwarp-tmp"
"""Ending of every temporary name; no image or video reader takes it for one of its own."""

FOREIGN_AGE_S = 24 * 3600
"""Seconds without a write after which another machine's temporary counts as left over.

Whether a process lives can only be asked on its own machine, so elsewhere age has to do; a day is
longer than any frame takes, and longer than the clocks of a farm differ.
"""

_LEFTOVER = re.compile(r"\..*\.(?P<host>[A-Za-z0-9_-]+)-(?P<pid>[0-9]+)-[0-9]+" + re.escape(MARK))
_KILL, _EXITING = 1 << 8, 0x4
"""SIGKILL among pending signals, and PF_EXITING among a process's flags, as Linux tells them."""

PIECE = 1 << 23
"""Bytes that are copied at a time."""

_NAME_LIMIT = 255  # bytes in a file name, on every file system that matters
_counter = itertools.count()

_REMEDIES = {
    errno.ENOSPC: ("no space is left on the device", "free some space or write elsewhere"),
    errno.EDQUOT: ("the disk quota is used up", "free some space or write elsewhere"),
    errno.EACCES: ("permission denied", "change the rights of the folder or write elsewhere"),
    errno.EPERM: ("permission denied", "change the rights of the folder or write elsewhere"),
    errno.EROFS: ("the file system is read-only", "write elsewhere"),
    errno.ENOENT: ("the folder does not exist", "create it, or check the path"),
    errno.ENOTDIR: ("a part of the path is a file, not a folder", "check the path"),
    errno.EEXIST: ("a file of that name is in the way", "remove it or choose another path"),
    errno.EISDIR: ("a folder of that name is in the way", "remove it or choose another path"),
    errno.ELOOP: ("a part of the path is a loop of links", "remove that link, or write elsewhere"),
    errno.ENAMETOOLONG: ("the name is too long", "choose a shorter one"),
    errno.EFBIG: ("the file system allows no file that large", "write elsewhere"),
    errno.EIO: ("the device reports an input/output error", "check the disk or the network share"),
    errno.ESTALE: ("the network share went away", "mount it again"),
}


def output_error(path: Path, error: OSError) -> OutputError:
    """Translate a failure to write `path` into one sentence: what, where, what to do."""
    default = (error.strerror or str(error) or "unknown error", "check the path and the disk")
    reason, remedy = _REMEDIES.get(error.errno or 0, default)
    return OutputError(f"cannot write {path}: {reason}; {remedy}")


def is_there(path: Path) -> bool:
    """Whether something is where a file or a folder is to be written.

    Raises
    ------
    OutputError
        When that cannot be seen, as a folder above may not be entered.
    """
    try:
        return path.exists()
    except OSError as error:
        raise output_error(path, error) from error


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it into place when the block succeeds.

    The temporary is removed when the block fails in any way, interruption included.

    Parameters
    ----------
    path
        The file to write; its folder must exist. An existing file is replaced.

    Yields
    ------
    Path
        Where to write, in the same folder, with a name that has no image or video suffix.

    Raises
    ------
    OutputError
        When writing, or the rename, fails with an OSError.
    """
    temporary = path.with_name(_temporary_name(path.name))
    with cleaned_up(partial(_remove, temporary)):
        try:
            yield temporary
            _flush(temporary)
            temporary.replace(path)
        except OSError as error:
            raise output_error(path, error) from error


def atomic_write_bytes(path: Path, *pieces: bytes | bytearray | memoryview) -> None:
    """Write a whole file, of pieces one after the other, or none; raises OutputError."""
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(pieces)


def atomic_write_text(path: Path, text: str) -> None:
    """Write a whole UTF-8 file with ``\\n`` line ends, or none; raises OutputError."""
    atomic_write_bytes(path, text.encode("utf-8"))


def atomic_copy(source: Path, target: Path) -> None:
    """Copy a file byte for byte, all or nothing.

    Raises
    ------
    InputError
        When there is no such source.
    UnreadableError
        When the system does not let the source through.
    OutputError
        When the copy cannot be written.
    """

    def copy() -> None:
        with source.open("rb", buffering=0) as read:
            try:
                # Modes and times are the new file's own.
                with atomic_path(target) as temporary, temporary.open("wb") as written:
                    if not _copied_by_system(read, written):
                        read.seek(0)
                        written.seek(0)
                        written.truncate()
                        shutil.copyfileobj(read, written, PIECE)
            except OutputError:
                failure = probe(source)  # a copy does not say which of the two files failed
                if failure is None:
                    raise
                raise failure from None

    try:
        with_retries(source, copy)
    except OSError as error:
        raise InputError(
            f"cannot read {source}: {error.strerror or error}; check the path and its rights"
        ) from error


def _copied_by_system(source: BinaryIO, target: BinaryIO) -> bool:
    """Have the file system copy a file; return whether it could, and did so to the end.

    Some share the blocks (XFS, Btrfs, ZFS) or let the server do it (NFS 4.2, SMB), so that no byte
    passes through this machine; for the others the kernel moves them. Who cannot says so in many
    ways, and what is truly wrong is met again.
    """
    if not hasattr(os, "copy_file_range"):
        return False
    with suppress(OSError):
        left = os.fstat(source.fileno()).st_size
        while left > 0:
            done = os.copy_file_range(source.fileno(), target.fileno(), left)
            if done == 0:
                break
            left -= done
        return left == 0
    return False


def make_folder(path: Path) -> None:
    """Make a folder with its parents, and prove that files can be written in it.

    Raises
    ------
    OutputError
        When it cannot be made, or nothing can be written there.
    """
    probe = path / _temporary_name("probe")
    try:
        path.mkdir(parents=True, exist_ok=True)
        # Rights alone do not tell: shares are exported read-only, and root passes any check.
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise output_error(path, error) from error


@contextmanager
def marked(folder: Path) -> Iterator[Path]:
    """Yield an empty temporary file in a folder, by which other machines know it for the same.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    mark = folder / _temporary_name("mark")
    with cleaned_up(partial(_remove, mark)):
        try:
            mark.touch()
        except OSError as error:
            raise output_error(mark, error) from error
        yield mark


def remove_leftovers(folder: Path) -> int:
    """Delete the temporaries of dead runs from a folder; return how many.

    Never touches one of a living process: those of this machine go when their process is gone,
    those of other machines when nothing was written to them for `FOREIGN_AGE_S`.
    """
    removed = 0
    try:
        entries = [entry for entry in folder.iterdir() if entry.name.endswith(MARK)]
    except OSError:  # no folder, no leftovers; a real problem shows when frames are written
        return 0
    for entry in entries:
        with suppress(OSError):  # another run may be cleaning up too
            if _is_leftover(entry):
                entry.unlink()
                removed += 1
    return removed


def _remove(temporary: Path) -> None:
    with suppress(OSError):
        temporary.unlink(missing_ok=True)


def _temporary_name(name: str) -> str:
    ending = f".{_host()}-{os.getpid()}-{next(_counter)}{MARK}"
    room = _NAME_LIMIT - len(ending) - 1
    return f".{os.fsencode(name)[:room].decode('utf-8', 'ignore')}{ending}"


def _host() -> str:
    """Name the space in which process ids mean something.

    Containers on a host's network share its name but not its process ids, hence the namespace.
    """
    try:
        namespace = f"-{Path('/proc/self/ns/pid').stat().st_ino}"
    except OSError:
        namespace = ""
    return re.sub(r"[^A-Za-z0-9_]+", "_", socket.gethostname())[:64] + namespace


def _flush(path: Path) -> None:
    """Push a written file to the disk.

    Renaming without it would be faster, but after a power cut some file systems then show an empty
    file under the final name, and network shares report a full disk only here. The folder itself
    is not flushed: losing the rename leaves the file absent, which is allowed.
    """
    handle = os.open(path, os.O_RDWR)
    try:
        with waiting():
            os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some shares cannot, and say so
            raise
    finally:
        os.close(handle)


def _is_leftover(path: Path) -> bool:
    match = _LEFTOVER.fullmatch(path.name)
    if match is None:
        return False
    if match["host"] == _host() and sys.platform != "win32":
        return not _is_alive(int(match["pid"]))
    return time.time() - path.stat().st_mtime > FOREIGN_AGE_S


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return not _has_ended(pid)


def _has_ended(pid: int) -> bool:
    """Whether a process that still has a number runs no more: it is being killed, or is dead.

    A disk may hold it up for long, and who started it may not ask how it ended.
    """
    try:
        status = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
        text = Path(f"/proc/{pid}/status").read_text(encoding="utf-8", errors="replace")
    except OSError:  # no Linux, or it has just gone
        return False
    pending = re.findall(r"^(?:SigPnd|ShdPnd):\s*([0-9a-f]+)$", text, re.MULTILINE)
    killed = any(int(mask, 16) & _KILL for mask in pending)
    return killed or status[0] in (b"Z", b"X") or bool(int(status[6]) & _EXITING)


class Held:
    """A context manager that closes what `_open` opened, in whatever way its block ends."""

    _stack: ExitStack

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._open(stack)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    def _open(self, stack: ExitStack) -> None:
        """Enter what is to be closed into the stack; what fails here leaves nothing open."""
        raise NotImplementedError


SHOWS_S = 20.0
"""Seconds that a new file may take to show on another machine's view of a network share."""

LOOK_S = 0.1


def await_file(path: Path, patience: float = SHOWS_S) -> None:
    """Wait until a file shows, but not for ever: who reads it says that it is missing."""
    deadline = time.monotonic() + patience
    while not shows(path) and time.monotonic() < deadline:
        check_stop()
        time.sleep(LOOK_S)


def shows(path: Path) -> bool:
    """Whether a file shows by now.

    Shares remember that a file was not there when a process looked, NFS for half a minute. To open
    the folder makes them ask again.
    """
    if path.exists():
        return True
    with suppress(OSError), os.scandir(path.parent) as entries:
        next(entries, None)
    return path.exists()
