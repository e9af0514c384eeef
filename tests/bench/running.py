"""Running a command and measuring all of it: wall time, processor time, memory.

This module imports little, and so should who uses it: Linux counts a parent's memory at the moment
of the fork as its child's.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

BYTECODE = "PYTHONDONTWRITEBYTECODE"

MEMORY = 3 << 30
"""Bytes: more than any command here takes, with what it writes to a file system in memory."""

TOUCH = """
import mmap, os, sys
size, page = int(sys.argv[1]), mmap.PAGESIZE
if "SC_AVPHYS_PAGES" in getattr(os, "sysconf_names", ()):
    size = min(size, os.sysconf("SC_AVPHYS_PAGES") * page // 2)
own = {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS} if hasattr(mmap, "MAP_PRIVATE") else {}
with mmap.mmap(-1, size, **own) as memory:
    if hasattr(mmap, "MADV_HUGEPAGE"):
        memory.madvise(mmap.MADV_HUGEPAGE)
    for begin in range(0, size, page):
        memory[begin] = 1
"""
"""A program of its own, as memory that this one had would count as its children's."""


@dataclass(frozen=True)
class Run:
    """What a command took.

    Attributes
    ----------
    wall, cpu
        Seconds; `cpu` is user and system time of it and of what it waited for.
    peak_mb
        Largest resident memory.
    """

    wall: float
    cpu: float
    peak_mb: float


def run(
    command: Sequence[str],
    env: Mapping[str, str] | None = None,
    cwd: Path | None = None,
    limit: float | None = None,
) -> Run:
    """Run a command in silence.

    Parameters
    ----------
    command
        Program and arguments.
    env
        Laid over the environment.
    cwd
        Folder that it runs in; None for this one.
    limit
        Seconds after which it is killed; None for never.

    Raises
    ------
    subprocess.CalledProcessError
        When it fails; what it said is printed then.
    """
    with tempfile.TemporaryFile("w+") as said:
        begin = time.perf_counter()
        running = subprocess.Popen(command, stdout=said, stderr=said, env=environment(env), cwd=cwd)
        ending = threading.Timer(limit or 0, running.kill)
        if limit is not None:
            ending.start()
        try:
            _, status, usage = os.wait4(running.pid, 0)
        except BaseException:  # else it would run on after a Ctrl-C
            running.kill()
            raise
        finally:
            ending.cancel()
        elapsed = time.perf_counter() - begin
        running.returncode = os.waitstatus_to_exitcode(status)
        if running.returncode:
            said.seek(0)
            sys.stderr.write(said.read())
            raise subprocess.CalledProcessError(running.returncode, list(command))
    in_mb = 1024 if sys.platform != "darwin" else 1024**2
    return Run(elapsed, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / in_mb)


def lend_memory(size: int = MEMORY) -> None:
    """Have the machine hold so many bytes of free memory, before something is measured.

    The host of a virtual machine takes back what has been free for seconds. Provided again, a page
    took twenty times as long at its first touch as one that the machine still held: who uses more
    memory was charged for the host, and for how long nothing had run. Where half of what is
    available is less, it is that.
    """
    run([sys.executable, "-c", TOUCH, str(size)])


def environment(more: Mapping[str, str] | None = None) -> dict[str, str]:
    """Return the environment for a child, with more laid over it.

    Bytecode is kept, as where ExWarp is installed; compiling it would count as start-up.
    """
    return {k: v for k, v in os.environ.items() if k != BYTECODE} | dict(more or {})


def upsample(keys: Path, out: Path, method: str, threads: int, *more: str) -> list[str]:
    """Return the command line of `upsample`."""
    return [
        *(sys.executable, "-m", "exwarp_cli", "upsample", str(keys), "-o", str(out)),
        *("--method", method, "--threads", str(threads), "--overwrite", "--progress", "none"),
        *more,
    ]


def module(name: str, *arguments: str) -> list[str]:
    """Return the command line of a Python module."""
    return [sys.executable, "-m", name, *arguments]


def cleared(out: Path) -> None:
    """Bring the machine to where a run may be measured.

    An earlier run's frames are removed, with their bytes on disk, and free memory is held.
    """
    for frame in out.glob("*.exr"):
        frame.unlink()
    os.sync()
    lend_memory()
