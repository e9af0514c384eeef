"""What this machine has, and what of it this process may use.

Containers and batch systems limit processes without telling them: by affinity, and by control
groups of either version.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

GROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")
MEMORY = Path("/proc/meminfo")

_UNLIMITED = 1 << 60
"""Version 1 writes a huge number of bytes where there is no limit."""

_MEMORY_FILES = (
    ("memory.max", "memory.current"),
    ("memory.limit_in_bytes", "memory.usage_in_bytes"),
)
"""Limit and use, in the second version of control groups and in the first."""


@dataclass(frozen=True)
class Processors:
    """CPUs, hyperthreads counted.

    Attributes
    ----------
    there
        In the machine.
    allowed
        That the affinity of this process names.
    quota
        How many of them at a time its control group grants, which may be a fraction; None without
        a limit.
    """

    there: int
    allowed: int
    quota: float | None

    @property
    def usable(self) -> int:
        """Threads that can run at a time."""
        return self.allowed if self.quota is None else min(self.allowed, math.ceil(self.quota))


@dataclass(frozen=True)
class Memory:
    """Bytes of memory; each None where the system does not tell.

    Attributes
    ----------
    there
        In the machine.
    available
        That programs can have without swapping, the limit taken into account.
    limit
        Of the control group; None without one.
    """

    there: int | None
    available: int | None
    limit: int | None


@dataclass(frozen=True)
class Folder:
    """A folder that files are to be written to.

    Attributes
    ----------
    path
        Of the folder.
    problem
        Why nothing can be written there; None where it can.
    free
        Bytes on its disk; None where the system does not tell.
    """

    path: Path
    problem: str | None
    free: int | None


def processors() -> Processors:
    """Count the CPUs."""
    there = os.cpu_count() or 1
    affinity = getattr(os, "sched_getaffinity", None)  # Linux has it
    return Processors(there, there if affinity is None else len(affinity(0)), _quota())


def memory() -> Memory:
    """Measure the memory."""
    meminfo = dict(_meminfo())
    there, available = meminfo.get("MemTotal"), meminfo.get("MemAvailable")
    limits = list(_memory_limits(there))
    rooms = [room for _, room in limits] + ([] if available is None else [available])
    return Memory(there, min(rooms, default=None), min((most for most, _ in limits), default=None))


def look_at(path: Path) -> Folder:
    """Try to write to a folder; what is tried with has no name, or is gone at once."""
    try:
        with tempfile.TemporaryFile(dir=path) as file:
            file.write(b"exwarp")
            file.flush()
        problem = None
    except OSError as error:
        problem = error.strerror or str(error)
    try:
        free = shutil.disk_usage(path).free
    except OSError:
        free = None
    return Folder(path, problem, free)


def temporary_folder() -> Path | None:
    """Return where temporary files go; None where no folder for them can be written."""
    try:
        return Path(tempfile.gettempdir())
    except OSError:
        return None


def cached_files(folder: Path, suffix: str) -> tuple[int, int]:
    """Count the files of a folder that end so, and their bytes; none where there is no folder."""
    sizes = []
    for path in folder.glob(f"*{suffix}"):
        try:
            sizes.append(path.stat().st_size)
        except OSError:  # another run has just replaced it
            continue
    return len(sizes), sum(sizes)


def _quota() -> float | None:
    """Return how many CPUs the control groups grant; the least of all that hold this process."""
    found = []
    for folder in _own_groups():
        quota, _, period = _text(folder / "cpu.max").partition(" ")
        if quota.isdecimal() and period.isdecimal():
            found.append(int(quota) / int(period))
        quota, period = (_text(folder / f"cpu.cfs_{name}_us") for name in ("quota", "period"))
        if quota.isdecimal() and period.isdecimal():
            found.append(int(quota) / int(period))
    return min((share for share in found if share > 0), default=None)


def _memory_limits(there: int | None) -> Iterator[tuple[int, int]]:
    """Yield the limits of the control groups that matter, and how much of each is left.

    Files that the kernel merely keeps at hand are counted as used there, but give way.
    """
    for folder in _own_groups():
        for names in _MEMORY_FILES:
            limit, used = (_text(folder / name) for name in names)
            if limit.isdecimal() and used.isdecimal() and int(limit) < (there or _UNLIMITED):
                stat = _text(folder / "memory.stat")
                spare = re.search(r"^(?:total_)?inactive_file (\d+)$", stat, re.MULTILINE)
                taken = int(used) - (int(spare[1]) if spare else 0)
                yield int(limit), max(int(limit) - max(taken, 0), 0)


def _own_groups() -> Iterator[Path]:
    """Yield the folders of the groups that this process is in, and of those around them.

    In a container the group's own path is often not to be seen, and its files lie at the top.
    """
    tops = {"": GROUPS}
    tops |= {name: GROUPS / name for name in ("cpu", "cpu,cpuacct", "memory")}
    inside = {name: Path("/") for name in tops}
    for line in _text(MEMBERSHIP).splitlines():
        _, _, rest = line.partition(":")
        names, _, own = rest.partition(":")
        inside |= {name: Path(own) for name in (names, *names.split(",")) if name in tops}
    for name, top in tops.items():
        for path in (inside[name], *inside[name].parents):
            yield top / path.relative_to("/")


def _meminfo() -> Iterator[tuple[str, int]]:
    """Yield what Linux tells of its memory, in bytes; elsewhere the size alone."""
    lines = _text(MEMORY).splitlines()
    for line in lines:
        name, _, value = line.partition(":")
        number = value.split()[:1]
        if number and number[0].isdecimal():
            yield name, int(number[0]) * 1024
    if not lines and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        yield "MemTotal", os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _text(path: Path) -> str:
    """Return what a file of the system says; nothing where it is missing."""
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""
