"""Memory that the compiler's library takes of a process that has its kernels.

Of 150 MB of LLVM, loading kernels that were kept needs a little here and there. Around each page
that is touched, Linux maps what it has of the file, so that 50 to 90 MB of it are resident: the
more, the more recently it was installed. They count as the process's own where jobs are watched
for how much memory they take.
"""

from __future__ import annotations

import ctypes
import functools
import mmap
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

MAPS = Path("/proc/self/smaps")
"""What is mapped where, as Linux tells it."""

LIBRARY = "libllvmlite.so"

_PLACE = re.compile(r"([0-9a-f]+)-([0-9a-f]+) r-[-x]p ")
"""Of memory that is mapped for itself, and not to be written; after it comes the file's name."""


def let_compiler_go() -> None:
    """Unmap the pages of the compiler's library; those that are used come back from its file.

    Nothing happens where it is not loaded, or the system is another than Linux.
    """
    if "llvmlite.binding" not in sys.modules:
        return
    for begin, size in _places():
        _madvise()(begin, size, mmap.MADV_DONTNEED)


def unchanged(lines: Iterable[str], name: str) -> Iterator[tuple[int, int]]:
    """Yield where unchanged parts of a library lie: address and bytes.

    What was written, such as addresses in tables that were then made read-only, would be lost.

    Parameters
    ----------
    lines
        As ``/proc/self/smaps`` has them.
    name
        Of its file, without folder.
    """
    place = None
    for line in lines:
        if line.endswith(f"/{name}\n"):
            place = _PLACE.match(line)
        elif place is not None and line.startswith("Anonymous:"):
            begin, end = (int(address, 16) for address in place.groups())
            if line.split()[1] == "0":
                yield begin, end - begin
            place = None


@functools.cache
def _places() -> tuple[tuple[int, int], ...]:
    """Return where unchanged parts of the compiler's library lie."""
    if not hasattr(mmap, "MADV_DONTNEED"):
        return ()
    try:
        with MAPS.open(encoding="utf-8", errors="surrogateescape") as lines:
            return tuple(unchanged(lines, LIBRARY))
    except OSError:  # no Linux, or nothing that tells
        return ()


@functools.cache
def _madvise() -> ctypes._NamedFuncPointer:
    advise = ctypes.CDLL(None).madvise
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    return advise
