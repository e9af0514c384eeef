"""Files on disks and network shares: read with retries, written whole or not at all.

A file is written beside its place, then renamed into it, so that it is absent or complete. A read
that fails by the system and not by the file is repeated, then reported as what it is. Generated
files carry a checksum, and files of other machines are waited for.
"""

from __future__ import annotations

import errno
import itertools
import os
import re
import socket
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Self, TypeVar

import xxhash

from exwarp_cli.domain.wording import first_line
from exwarp_cli.errors import DamagedFileError, OutputError, UnreadableError
from exwarp_cli.runtime.cores import release_cores
from exwarp_cli.runtime.stop import check_stop, clean_up_after

T = TypeVar("T")

# Ends every temporary name; no image or video reader takes it for one of its own suffixes.
TEMPORARY_SUFFIX = ".exwarp-tmp"

# Seconds without a write after which another machine's temporary counts as left over. Only its own
# machine can say whether a process lives. A day is longer than any frame takes, and longer than the
# clocks of a farm differ.
FOREIGN_AGE_S = 24 * 3600

# The checksum of a generated file is that of the whole file, with its own digits as zeros. XXH128
# shows whatever disks and networks do to a file; a checksum that stands in the file itself cannot
# show deceit. A frame of 1920x1080 takes 0.2 ms; with SHA-256 it took 4.7.
CHECKSUM_NAME = "xxh128"
CHECKSUM_DIGITS = 32
CHECKSUM_ZEROS = "0" * CHECKSUM_DIGITS
new_checksum = xxhash.xxh3_128

# Seconds that a new file may take to show on another machine's view of a network share.
VISIBLE_S = 20.0
POLL_S = 0.1

# Seconds before each further try to read. Shares that change servers come back within seconds.
PAUSES = (0.1, 0.4, 1.6)
PROBED_BYTES = 1 << 22

_NAME_LIMIT = 255  # bytes in a file name, on every file system that matters
_LEFTOVER = re.compile(
    r"\..*\.(?P<host>[A-Za-z0-9_-]+)-(?P<pid>[0-9]+)-[0-9]+" + re.escape(TEMPORARY_SUFFIX)
)
# SIGKILL among pending signals, and PF_EXITING among a process's flags, as Linux has them.
_KILL, _EXITING = 1 << 8, 0x4
_counter = itertools.count()

_WRITE_REMEDIES = {
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

# Errors that come from a wrong path, or from a wrong offset in a damaged file.
_PATH_ERRORS = frozenset(
    {
        *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.ELOOP, errno.ENAMETOOLONG),
        *(errno.EINVAL, errno.EBADF, errno.EFBIG, errno.EOVERFLOW, errno.ESPIPE),
    }
)
# Errors that waiting does not mend; one more try is for shares that are being mounted.
_RIGHTS_ERRORS = frozenset({errno.EACCES, errno.EPERM})

_READ_REMEDIES = {
    **dict.fromkeys(_RIGHTS_ERRORS, "check the rights of the file and of the folders above it"),
    errno.EMFILE: "raise the limit of open files ('ulimit -n'), or use fewer threads",
    errno.ENFILE: "close other programs, or raise the system's limit of open files",
    errno.ENOMEM: "close other programs, or use fewer threads",
}


class ResourceOwner:
    """A context manager that closes what `_open` opened, in whatever way its block ends."""

    _stack: ExitStack

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._open(stack)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def _open(self, stack: ExitStack) -> None:
        """Enter what is to be closed into the stack; what fails here leaves nothing open."""
        raise NotImplementedError


def compute_checksum(pieces: Iterable[bytes | bytearray | memoryview]) -> str:
    """Return the checksum of bytes in pieces, hexadecimal."""
    checksum = new_checksum()
    for piece in pieces:
        checksum.update(piece)
    return checksum.hexdigest()


def output_error(path: Path, error: OSError) -> OutputError:
    """Translate a failure to write `path` into one sentence: what, where, what to do."""
    default = (error.strerror or str(error) or "unknown error", "check the path and the disk")
    reason, remedy = _WRITE_REMEDIES.get(error.errno or 0, default)
    return OutputError(f"cannot write {path}: {reason}; {remedy}")


def path_exists(path: Path) -> bool:
    """Return whether an output path exists; raises OutputError where that cannot be seen."""
    try:
        return path.exists()
    except OSError as error:
        raise output_error(path, error) from error


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; rename it into place when the block succeeds.

    The folder must exist, and an existing file is replaced. The temporary's name has no image or
    video suffix. It is removed when the block fails in any way, interruption included. Raises
    OutputError when writing, or the rename, fails with an OSError.
    """
    temporary = path.with_name(_temporary_name(path.name))
    with clean_up_after(partial(_remove, temporary)):
        try:
            yield temporary
            # Renaming alone would be faster, but after a power cut some file systems then show an
            # empty file under the final name, and network shares report a full disk only here. The
            # folder is not flushed: losing the rename leaves the file absent, which is allowed.
            handle = os.open(temporary, os.O_RDWR)
            try:
                with release_cores():
                    os.fsync(handle)
            except OSError as error:
                if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some shares cannot
                    raise
            finally:
                os.close(handle)
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


def make_folder(path: Path) -> None:
    """Make a folder with its parents, and prove that files can be written in it.

    Raises OutputError when it cannot be made, or nothing can be written there.
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
def marker_file(folder: Path) -> Iterator[Path]:
    """Yield an empty temporary file by which other machines recognise a folder.

    Raises OutputError when it cannot be written.
    """
    mark = folder / _temporary_name("mark")
    with clean_up_after(partial(_remove, mark)):
        try:
            mark.touch()
        except OSError as error:
            raise output_error(mark, error) from error
        yield mark


def remove_leftovers(folder: Path) -> int:
    """Delete the temporaries of dead runs from a folder; return how many.

    Temporaries of this machine go when their process has ended, those of other machines when
    nothing was written to them for `FOREIGN_AGE_S`.
    """
    removed = 0
    try:
        entries = [(entry, _LEFTOVER.fullmatch(entry.name)) for entry in folder.iterdir()]
    except OSError:  # no folder, no leftovers; a real problem shows when frames are written
        return 0
    for entry, match in entries:
        if match is None:
            continue
        with suppress(OSError):  # another run may be cleaning up too
            if match["host"] == host_name() and sys.platform != "win32":
                is_leftover = not _is_alive(int(match["pid"]))
            else:
                is_leftover = time.time() - entry.stat().st_mtime > FOREIGN_AGE_S
            if is_leftover:
                entry.unlink()
                removed += 1
    return removed


def _remove(temporary: Path) -> None:
    with suppress(OSError):
        temporary.unlink(missing_ok=True)


def _temporary_name(name: str) -> str:
    ending = f".{host_name()}-{os.getpid()}-{next(_counter)}{TEMPORARY_SUFFIX}"
    room = _NAME_LIMIT - len(ending) - 1
    return f".{os.fsencode(name)[:room].decode('utf-8', 'ignore')}{ending}"


def host_name() -> str:
    """Return a name for the space in which process ids are valid."""
    # Containers on a host's network share its name but not its process ids, hence the namespace.
    try:
        namespace = f"-{Path('/proc/self/ns/pid').stat().st_ino}"
    except OSError:
        namespace = ""
    return re.sub(r"[^A-Za-z0-9_]+", "_", socket.gethostname())[:64] + namespace


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    # A process that is being killed or dead keeps its number while a disk holds it up, or until
    # its parent asks how it ended.
    try:
        status = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
        text = Path(f"/proc/{pid}/status").read_text(encoding="utf-8", errors="replace")
    except OSError:  # no Linux, or it has just gone
        return True
    pending = re.findall(r"^(?:SigPnd|ShdPnd):\s*([0-9a-f]+)$", text, re.MULTILINE)
    is_killed = any(int(mask, 16) & _KILL for mask in pending)
    return not (is_killed or status[0] in (b"Z", b"X") or int(status[6]) & _EXITING)


def await_file(path: Path, patience: float = VISIBLE_S) -> None:
    """Wait until a file is visible, at most `patience` seconds."""
    deadline = time.monotonic() + patience
    while not is_visible(path) and time.monotonic() < deadline:
        check_stop()
        time.sleep(POLL_S)


def is_visible(path: Path) -> bool:
    """Return whether a file is visible on a network share by now."""
    if path.exists():
        return True
    # Shares remember that a file was not there when a process looked, NFS for half a minute. To
    # open the folder makes them ask again.
    with suppress(OSError), os.scandir(path.parent) as entries:
        next(entries, None)
    return path.exists()


def with_retries(path: Path, read: Callable[[], T]) -> T:
    """Call a reader of a file, again after a pause while the system makes it fail.

    `read` opens the file again at each call, as a stale handle stays stale. Raises UnreadableError
    when the system makes the last try fail, too, and OSError or DamagedFileError as `read` does
    when the file or its path is the cause.
    """
    pauses = iter(PAUSES)
    is_repeated = False
    while True:
        try:
            return read()
        except (OSError, DamagedFileError) as error:
            failure = system_failure(path, error)
            if failure is None:
                # The probe succeeds: either the file is damaged, or the fault has just passed.
                if is_repeated or isinstance(error, OSError):
                    raise
                is_repeated = True
                continue
            pause = next(pauses, None)
            if pause is None or (failure.errno in _RIGHTS_ERRORS and pause != PAUSES[0]):
                remedy = _READ_REMEDIES.get(
                    failure.errno or 0,
                    "check the disk, or the network share and its mount, and run again",
                )
                raise UnreadableError(
                    f"cannot read {path}: {failure.strerror or failure}; {remedy}"
                ) from error
        check_stop()
        time.sleep(pause)


def system_failure(path: Path, error: BaseException) -> OSError | None:
    """Return the system's error behind a failed read; None if the file or its path is wrong.

    Where `error` does not say, the file is read to its end: decoders report a share that went away,
    missing rights and a full table of open files as damage.
    """
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno is not None:
            return None if cause.errno in _PATH_ERRORS else cause
        cause = cause.__cause__
    try:
        # Without waiting, as a pipe has no end.
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
        try:
            while os.read(handle, PROBED_BYTES):
                pass
        finally:
            os.close(handle)
    except OSError as failure:
        return None if failure.errno in _PATH_ERRORS else failure
    return None


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file, which may begin with the byte order mark that some editors write.

    Raises OSError if it cannot be read, ValueError with one line of text if it is not TOML.
    """
    import tomllib  # most commands read none

    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start} is no UTF-8") from error
    except tomllib.TOMLDecodeError as error:
        line = first_line(error)
        raise ValueError(line[:1].lower() + line[1:]) from error
    except RecursionError as error:
        raise ValueError("arrays or tables stand too deep in each other") from error
    except ValueError as error:  # of Python itself, which reads no number of thousands of digits
        raise ValueError(first_line(error)) from error
