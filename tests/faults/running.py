"""The command in processes of its own, and what may come of it."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from exwarp_cli import cli, errors
from exwarp_cli.io.atomic import MARK
from exwarp_cli.io.output import is_intact
from tests.cli import shots

FULL = os.environ.get("EXWARP_FAULTS") == "full"
"""Whether everything is tried, as `make faults` does, or a little of it."""

BOUND_S = 120
"""Seconds after which a command counts as one that hangs."""

CODES = {0, *(kind.exit_code for kind in vars(errors).values() if isinstance(kind, type))} - {1}
"""What a command may exit with, defects apart."""

STOPPED = {errors.INTERRUPTED, cli.TERMINATED}

PLAIN = ("-m", "softsplat", "--motion", "forward", "--threads", "1", "--progress", "none")


@dataclass(frozen=True)
class Outcome:
    """What is left of a command."""

    code: int
    out: str
    err: str

    @property
    def told(self) -> list[str]:
        """The sentences that say what went wrong."""
        return [line for line in self.err.splitlines() if line.startswith("exwarp: error: ")]

    def judge(self, *codes: int) -> None:
        """Refuse tracebacks, unknown exit codes, silence and chatter."""
        assert self.code in (codes or CODES), (self.code, self.err)
        assert "Traceback" not in self.err + self.out, self.err
        assert "unexpected" not in self.err, self.err
        other = [line for line in self.err.splitlines() if line and line[:8] != "exwarp: "]
        assert other == [], self.err
        assert len(self.told) == (self.code != 0), (self.code, self.err)


def started(
    *arguments: object,
    environment: Mapping[str, str] | None = None,
    largest_file: int | None = None,
    memory: int | None = None,
) -> subprocess.Popen[str]:
    """Start the command in a group of its own.

    Parameters
    ----------
    arguments
        Of the command line.
    environment
        Variables that it has beside the usual ones.
    largest_file
        Bytes that a file may have.
    memory
        Bytes of address space.
    """

    def bound() -> None:
        if largest_file is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))
        if memory is not None:
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))

    return subprocess.Popen(
        [sys.executable, "-m", "exwarp_cli", *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace",
        env=os.environ | dict(environment or {}), start_new_session=True, preexec_fn=bound,
    )  # fmt: skip


def ended(process: subprocess.Popen[str], seconds: float = BOUND_S) -> Outcome:
    """Wait for a command; TimeoutExpired for one that hangs."""
    try:
        out, err = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return Outcome(process.returncode, out, err)


def run(*arguments: object, **more: object) -> Outcome:
    """Run a command to its end; arguments are those of `started`."""
    return ended(started(*arguments, **more))  # type: ignore[arg-type]


def require_whole(folder: Path, rendered: set[bytes]) -> None:
    """Refuse files that are neither rendered frames nor frames as ExWarp wrote them.

    Temporary names of runs that were killed are none of a frame.
    """
    for name, data in shots.contents(folder).items():
        assert MARK in name or data in rendered or is_intact(data), name


def require_no_leftovers(folder: Path) -> None:
    """Refuse temporary files."""
    assert [name for name in shots.names(folder) if MARK in name] == []
