"""Which files libraries read now, reported to the parent process by a pipe.

A decoder may crash on a damaged file, or never return. Then this process cannot name the file, and
its parent does.
"""

from __future__ import annotations

import os
import select
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path

from exwarp_cli.errors import DamagedFileError
from exwarp_cli.runtime.stop import check_stop

_BEGIN, _BEGIN_REQUIRED, _END, _RESTART = b"+", b"!", b"-", b"r"

_numbers = count(1)
_pipe: int | None = None
_skipped: Mapping[Path, str] = {}


@dataclass
class ReadRegistry:
    """The files that another process reads."""

    files: dict[int, Path] = field(default_factory=dict)  # by the number of the reading
    required: set[int] = field(default_factory=set)  # readings that nothing can go on without
    restarts: bool = False  # whether the command can restart without files that crash a library
    _incomplete: bytes = b""

    def receive(self, data: bytes) -> None:
        """Update from the next bytes of the pipe."""
        *messages, self._incomplete = (self._incomplete + data).split(b"\0")
        for message in messages:
            head, _, name = message.partition(b" ")
            kind, number = head[:1], int(head[1:])
            if kind == _RESTART:
                self.restarts = True
            elif kind == _END:
                self.files.pop(number)
                self.required.discard(number)
            else:
                self.files[number] = Path(os.fsdecode(name))
                if kind == _BEGIN_REQUIRED:
                    self.required.add(number)


def attach(pipe: int, skipped: Mapping[Path, str]) -> None:
    """Report this process's readings to a pipe's descriptor.

    The files that failed an earlier process are refused from now on, each with its message.
    """
    global _pipe, _skipped
    _pipe, _skipped = pipe, dict(skipped)


def enable_restart() -> None:
    """Allow a restart without the files at which a library crashes or hangs."""
    _send(_RESTART, 0)


def is_restarted() -> bool:
    """True if an earlier process of this command failed at a file."""
    return bool(_skipped)


@contextmanager
def report_reading(path: Path, required: bool = False) -> Iterator[None]:
    """Report a file while a library reads it in the block.

    Nothing can go on without a file that is `required`, such as a model.

    Raises DamagedFileError when an earlier process failed at it. Raises StopRequested when this
    process was asked to stop.
    """
    check_stop()
    if path in _skipped:
        raise DamagedFileError(_skipped[path])
    number = next(_numbers)
    _send(_BEGIN_REQUIRED if required else _BEGIN, number, os.fsencode(path))
    try:
        yield
    finally:
        _send(_END, number)


def _send(kind: bytes, number: int, name: bytes = b"") -> None:
    if _pipe is not None:
        message = b"%s%d %s" % (kind, number, name)
        with suppress(OSError):  # the parent has ended, and this process will
            # Up to this size, messages of several threads do not mix.
            os.write(_pipe, message[: select.PIPE_BUF - 1] + b"\0")
