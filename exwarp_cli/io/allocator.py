"""Where the threads of this process take memory from."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Mapping

ARENA_MAX = -8
"""Number of the option, from glibc's malloc.h."""

CHOSEN = ("MALLOC_ARENA_MAX", "GLIBC_TUNABLES")
"""Variables by which a user tells glibc the same; then it stays as told."""


def share_one_arena(environment: Mapping[str, str] = os.environ) -> bool:
    """Have all threads take memory from one arena; return whether the allocator was told.

    By default glibc gives every thread an arena of its own, so that what the reader's thread freed
    does not serve the writers', and all of it stays resident. With one, `softsplat` at 1920x1080
    took 797 MB in place of 950, and a tenth less processor time, as fewer pages are fresh.
    """
    if not sys.platform.startswith("linux") or any(name in environment for name in CHOSEN):
        return False
    tell = getattr(ctypes.CDLL(None), "mallopt", None)  # other C libraries than glibc have none
    return tell is not None and bool(tell(ARENA_MAX, 1))


def trim() -> None:
    """Give free memory back to the system, where the allocator can; once, as it is dear."""
    if sys.platform.startswith("linux"):
        give_back = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if give_back is not None:
            give_back(0)
