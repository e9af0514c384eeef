"""The command in processes of its own, and what may come of it."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from exwarp_cli import cli, errors
from exwarp_cli.io.files import TEMPORARY_SUFFIX
from exwarp_cli.io.generated_frames import is_intact
from tests.cli import shots

BOUND_S = 120
"""Seconds after which a command counts as one that hangs."""

CODES = {0, *(kind.exit_code for kind in vars(errors).values() if isinstance(kind, type))} - {1}
"""What a command may exit with, defects apart."""

CRASHING = "tests.faults.crashing"
"""The command with a decoder that fails; see there for the words before its arguments."""

PLAIN = ("-m", "softsplat", "--motion", "forward", "--threads", "1", "--progress", "none")


@dataclass(frozen=True)
class Outcome:
    """What is left of a command.

    `peak_mb` is how much memory it had at most, and `alone` whether in processes of its own. Linux
    counts what the process had that started it: 0 where no more is known than that.
    """

    code: int
    out: str
    err: str
    peak_mb: int = 0
    alone: bool = False

    @property
    def error_lines(self) -> list[str]:
        """The sentences that say what went wrong."""
        return [line for line in self.err.splitlines() if line.startswith("exwarp: error: ")]

    def judge(self, *codes: int) -> None:
        """Refuse tracebacks, unknown exit codes, silence and chatter."""
        assert self.code in (codes or CODES), (self.code, self.err)
        assert "Traceback" not in self.err + self.out, self.err
        assert "unexpected" not in self.err, self.err
        other = [line for line in self.err.splitlines() if line and line[:8] != "exwarp: "]
        assert other == [], self.err
        assert len(self.error_lines) == (self.code != 0), (self.code, self.err)


def started(
    *arguments: object,
    environment: Mapping[str, str] | None = None,
    largest_file: int | None = None,
    memory: int | None = None,
    module: str = "exwarp_cli",
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
    module
        What is run as the command.
    """

    def bound() -> None:
        if largest_file is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))
        if memory is not None:
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))

    # Python cuts bytecode off without a word where files may not be large.
    more = {} if largest_file is None else {"PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen(
        [sys.executable, "-m", module, *map(str, arguments)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, errors="replace",
        env=os.environ | more | dict(environment or {}), start_new_session=True, preexec_fn=bound,
    )  # fmt: skip


def ended(process: subprocess.Popen[str], seconds: float = BOUND_S) -> Outcome:
    """Wait for a command; TimeoutExpired for one that hangs."""
    pipes = [pipe for pipe in (process.stdout, process.stderr) if pipe is not None]
    with process, ThreadPoolExecutor(len(pipes)) as pool:
        texts = [pool.submit(pipe.read) for pipe in pipes]
        try:
            peak = _reaped(process, time.monotonic() + seconds)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # what it started holds the pipes open
            process.wait()
            raise
        out, err = (text.result() for text in texts)
    if peak <= resource.getrusage(resource.RUSAGE_SELF).ru_maxrss:
        peak = 0
    return Outcome(process.returncode, out, err, peak // 1024, alone=True)


def _reaped(process: subprocess.Popen[str], deadline: float) -> int:
    """Wait for a process, and return what it or its children had at most, kilobytes."""
    while process.returncode is None:
        try:
            pid, status, usage = os.wait4(process.pid, os.WNOHANG)
        except ChildProcessError:  # it was waited for already
            process.wait()
            break
        if pid:
            process.returncode = os.waitstatus_to_exitcode(status)
            return usage.ru_maxrss
        if time.monotonic() > deadline:
            raise subprocess.TimeoutExpired(process.args, deadline)
        time.sleep(0.01)
    return 0


def run(*arguments: object, **more: object) -> Outcome:
    """Run a command to its end; arguments are those of `started`."""
    return ended(started(*arguments, **more))  # type: ignore[arg-type]


def run_here(*arguments: object, code: int = 0) -> None:
    """Run a command in this process, which spares the start of one; judge its exit code."""
    assert cli.run([str(argument) for argument in arguments]) == code


def require_whole(folder: Path, rendered: set[bytes]) -> None:
    """Refuse files that are neither rendered frames nor frames as ExWarp wrote them.

    Temporary names of runs that were killed are none of a frame.
    """
    for name, data in shots.contents(folder).items():
        assert TEMPORARY_SUFFIX in name or data in rendered or is_intact(data), name


def require_no_leftovers(folder: Path) -> None:
    """Refuse temporary files."""
    assert [name for name in shots.names(folder) if TEMPORARY_SUFFIX in name] == []
