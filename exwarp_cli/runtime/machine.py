"""What this machine has, and what of it this process may use.

Containers and batch systems limit a process by its affinity, and by control groups of version 1
or 2.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

GROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")
MEMORY = Path("/proc/meminfo")


@dataclass(frozen=True)
class Processors:
    """CPUs, hyperthreads counted."""

    there: int  # in the machine
    allowed: int  # by the affinity of this process
    # CPUs at a time by the control group, maybe a fraction; None without a limit
    quota: float | None

    @property
    def usable(self) -> int:
        """Threads that can run at a time."""
        return self.allowed if self.quota is None else min(self.allowed, math.ceil(self.quota))


@dataclass(frozen=True)
class Memory:
    """Bytes of memory; each None where it is unknown."""

    there: int | None  # in the machine
    available: int | None  # for programs without swapping, within the limit
    limit: int | None  # of the control group


@dataclass(frozen=True)
class Folder:
    """A folder for files to be written."""

    path: Path
    problem: str | None  # why nothing can be written there; None if it can
    free: int | None  # bytes on its disk; None if unknown


def processors() -> Processors:
    """Count the CPUs."""
    there = os.cpu_count() or 1
    affinity = getattr(os, "sched_getaffinity", None)  # Linux has it
    quotas = []
    for folder in _control_groups():
        version_2 = _read_text(folder / "cpu.max").partition(" ")[::2]
        version_1 = [_read_text(folder / f"cpu.cfs_{name}_us") for name in ("quota", "period")]
        for quota, period in (version_2, version_1):
            if quota.isdecimal() and period.isdecimal():
                quotas.append(int(quota) / int(period))
    least = min((quota for quota in quotas if quota > 0), default=None)
    return Processors(there, there if affinity is None else len(affinity(0)), least)


def memory() -> Memory:
    """Measure the memory; elsewhere than on Linux the total alone."""
    text = _read_text(MEMORY)
    entries = re.findall(r"^([^:\n]*):[ \t]*(\d+)(?!\S)", text, re.MULTILINE)
    meminfo = {name: int(number) * 1024 for name, number in entries}
    if not text and hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        meminfo["MemTotal"] = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    there, available = meminfo.get("MemTotal"), meminfo.get("MemAvailable")
    limits, rooms = [], [] if available is None else [available]
    for folder in _control_groups():
        for maximum, current in (  # in version 2 of control groups and in version 1
            ("memory.max", "memory.current"),
            ("memory.limit_in_bytes", "memory.usage_in_bytes"),
        ):
            limit, used = _read_text(folder / maximum), _read_text(folder / current)
            # Version 1 writes a huge number of bytes where there is no limit.
            if limit.isdecimal() and used.isdecimal() and int(limit) < (there or 1 << 60):
                # The kernel counts cached files as used, but drops them when memory is needed.
                stat = _read_text(folder / "memory.stat")
                cached = re.search(r"^(?:total_)?inactive_file (\d+)$", stat, re.MULTILINE)
                taken = max(int(used) - (int(cached[1]) if cached else 0), 0)
                limits.append(int(limit))
                rooms.append(max(int(limit) - taken, 0))
    return Memory(there, min(rooms, default=None), min(limits, default=None))


def look_at(path: Path) -> Folder:
    """Try to write to a folder, by a file that has no name or is removed at once."""
    problem = None
    try:
        with tempfile.TemporaryFile(dir=path) as file:
            file.write(b"exwarp")
            file.flush()
    except OSError as error:
        problem = error.strerror or str(error)
    free = None
    with suppress(OSError):
        free = shutil.disk_usage(path).free
    return Folder(path, problem, free)


def cached_files(folder: Path, suffix: str) -> tuple[int, int]:
    """Return number and bytes of the files in a folder with this suffix."""
    sizes = []
    for path in folder.glob(f"*{suffix}"):
        with suppress(OSError):  # another run has just replaced it
            sizes.append(path.stat().st_size)
    return len(sizes), sum(sizes)


def _control_groups() -> Iterator[Path]:
    """Yield the folders of this process's control groups, and of those that contain them."""
    tops = {name: GROUPS / name for name in ("", "cpu", "cpu,cpuacct", "memory")}
    # In a container the group's own path is often invisible, and its files lie at the top.
    inside = {name: Path("/") for name in tops}
    for line in _read_text(MEMBERSHIP).splitlines():
        _, _, group = line.partition(":")
        names, _, own = group.partition(":")
        inside |= {name: Path(own) for name in (names, *names.split(",")) if name in tops}
    for name, top in tops.items():
        for path in (inside[name], *inside[name].parents):
            yield top / path.relative_to("/")


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace").strip()
    except OSError:
        return ""
