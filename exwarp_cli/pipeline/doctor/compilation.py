"""Which kernels were compiled in this process, and which came from numba's cache.

Asks the kernels of the modules that are loaded, so that it does not need numba itself.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PACKAGES = ("exwarp_cli.kernels.", "exwarp_cli.accel.")
"""Where kernels stand."""

COMPILING = (
    "kernels are being compiled, which may take a minute or two; later runs take them from their "
    "cache"
)


def cache_folders() -> list[Path]:
    """Return where the kernels that are loaded are kept; a folder for each package of them."""
    paths = [kernel.stats.cache_path for kernel in _loaded()]
    return [Path(path) for path in dict.fromkeys(paths) if path is not None]


def cache_use() -> tuple[int, int]:
    """Count the builds of kernels that this process took from the cache, and had to compile."""
    stats = [kernel.stats for kernel in _loaded()]
    hits = sum(sum(one.cache_hits.values()) for one in stats)
    return hits, sum(sum(one.cache_misses.values()) for one in stats)


@contextmanager
def telling_of_compilation(tell: Callable[[str], None], after: float = 1.5) -> Iterator[None]:
    """Tell a user who waits that kernels are compiled, once, where the cache did not have them."""
    ended, before = threading.Event(), cache_use()[1]

    def watch() -> None:
        while not ended.wait(after):
            if cache_use()[1] > before:
                tell(COMPILING)
                return

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _loaded() -> list[Any]:
    """Return the kernels of the modules that are loaded; none where nothing is compiled."""
    modules = [m for name, m in list(sys.modules.items()) if name.startswith(PACKAGES)]
    found = {id(v): v for m in modules for v in list(vars(m).values()) if hasattr(v, "stats")}
    return list(found.values())
