"""Files that another machine wrote, and that do not show on this one yet."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

from exwarp_cli.runtime.stop import check_stop

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

    Shares keep in mind that a file was not there when somebody looked, NFS for half a minute; it is
    the opening of the folder that makes them ask again.
    """
    if path.exists():
        return True
    with suppress(OSError), os.scandir(path.parent) as entries:
        next(entries, None)
    return path.exists()
