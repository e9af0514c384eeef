"""Whether the machine has room for the work: CPUs, memory, and the folder of temporary files."""

from __future__ import annotations

import platform
import sys
from pathlib import Path

import exwarp_cli
from exwarp_cli.domain.wording import size_text
from exwarp_cli.pipeline.doctor.examine import Check, failure, warning
from exwarp_cli.runtime.machine import look_at, memory, processors, temporary_folder

LEAST_MEMORY = 4 << 30
"""Bytes that frames of 1920x1080 take with the network that extrapolates; 3.7 GiB were measured."""

WITHOUT_NETWORK = 1 << 30
"""The same for s6 and softsplat."""

LEAST_FREE = 256 << 20
"""Bytes on the disk of temporary files: room for the video of a measurement."""


def check_machine() -> Check:
    """Look at CPUs and memory."""
    cpus, room = processors(), memory()
    remarks = []
    if room.available is not None and room.available < LEAST_MEMORY:
        remarks.append(
            warning(
                f"{size_text(room.available)} of memory is free, and frames of 1920x1080 take "
                f"{size_text(LEAST_MEMORY)} with a network, {size_text(WITHOUT_NETWORK)} with s6 "
                "and softsplat; close other programs, or raise the limit of the job"
            )
        )
    facts = {
        "executable": sys.executable,
        "package": str(Path(exwarp_cli.__file__).parent),
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "system": f"{platform.system()} {platform.release()}",
        "platform": platform.platform(),
        "architecture": platform.machine(),
        "cpus": {"there": cpus.there, "allowed": cpus.allowed, "quota": cpus.quota},
        "memory": {"there": room.there, "available": room.available, "limit": room.limit},
    }
    sizes = {"in the machine": room.there, "free": room.available, "by limit": room.limit}
    known = [f"{size_text(value)} {what}" for what, value in sizes.items() if value is not None]
    lines = (
        f"{facts['package']}, run by {facts['executable']}",
        f"{facts['implementation']} {facts['python']}, {facts['platform']}",
        f"CPUs: {cpus.there} in the machine, {cpus.allowed} by affinity, "
        + ("no quota" if cpus.quota is None else f"{cpus.quota:g} by quota of the control group")
        + f"; {cpus.usable} are used without --threads",
        f"memory: {', '.join(known) or 'the system does not tell'}",
    )
    share = "" if cpus.usable == cpus.there else f" of {cpus.there}"
    found = f"{cpus.usable}{share} CPU{'' if cpus.usable == 1 else 's'}"
    most = room.there if room.limit is None else room.limit
    if most is not None and room.available is None:
        found += f", {size_text(most)} of memory"
    elif most is not None and room.available is not None:
        found += f", {size_text(room.available)} of {size_text(most)} memory free"
    return Check(found, tuple(remarks), facts, lines)


def check_temporary() -> Check:
    """Look at the folder of temporary files."""
    path = temporary_folder()
    if path is None:
        text = "no folder for temporary files can be written; name one in TMPDIR"
        return Check("none", (failure(text),), {"path": None, "writable": False, "free": None})
    folder = look_at(path)
    facts = {"path": str(path), "writable": folder.problem is None, "free": folder.free}
    if folder.problem is not None:
        text = f"cannot write to {path}: {folder.problem}; name another folder in TMPDIR"
        return Check(str(path), (failure(text),), facts)
    found = str(path) if folder.free is None else f"{path}, {size_text(folder.free)} free"
    if folder.free is not None and folder.free < LEAST_FREE:
        text = f"the disk of {path} is nearly full; make room, or name another folder in TMPDIR"
        return Check(found, (warning(text),), facts)
    return Check(found, (), facts)
