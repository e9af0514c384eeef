"""Files that are read whole, into memory: models and what belongs to them."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST_BYTES = 2**31 - 1
"""What a file in Protocol Buffers may have, and more than any other that is read whole."""


def read_whole(path: Path) -> bytes:
    """Read a file on a disk.

    Raises
    ------
    OSError
        When it cannot be read, is too large, or is a folder, a pipe or a device, some of which
        never end and others never begin.
    """
    # Without waiting, as a pipe into which nobody writes would keep whoever opens it.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    with open(path, "rb", opener=lambda name, _: os.open(name, flags)) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is a pipe or a device", str(path))
        if status.st_size > MOST_BYTES:
            raise OSError(errno.EFBIG, "it has more than 2 GiB", str(path))
        return file.read(MOST_BYTES)
