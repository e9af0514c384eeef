"""Command lines for farms that run what they are given, one a chunk."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from exwarp_cli.domain.line import misleads, printable
from exwarp_cli.errors import UsageError
from exwarp_cli.farm.calls import Blank, FarmJob, Word
from exwarp_cli.farm.chunks import frames_text, split
from exwarp_cli.farm.places import Place


@dataclass(frozen=True)
class CommandLines:
    """What a farm runs.

    Attributes
    ----------
    chunks
        Key frames and words of each chunk's command, which may run in any order and side by side.
    afterwards
        Words of the commands to run when all chunks are done.
    """

    chunks: tuple[tuple[str, tuple[str, ...]], ...]
    afterwards: tuple[tuple[str, ...], ...]


def command_lines(job: FarmJob, program: str) -> CommandLines:
    """Write out a job, with absolute paths.

    Parameters
    ----------
    job
        What is done.
    program
        Name or path of `exwarp` on the workers.
    """
    everything = frames_text(job.numbers)
    texts = [frames_text(chunk) for chunk in split(job.numbers, job.size)]
    after = (call for call in (job.merging, job.filming) if call is not None)
    return CommandLines(
        tuple((text, _filled(program, job.chunk, text, everything)) for text in texts),
        tuple(_filled(program, call, everything, everything) for call in after),
    )


def shell_line(words: Sequence[str]) -> str:
    """Write a command for a POSIX shell, on one line.

    Raises
    ------
    UsageError
        When a word has a line end, which would make two lines of it, or what else a terminal obeys.
    """
    if bad := [word for word in words if misleads(word)]:
        raise UsageError(
            f"{printable(bad[0])} has a line end or control character in it, which no line of a "
            "shell should have; rename it, or take --json"
        )
    return shlex.join(words)


def _filled(program: str, call: Sequence[Word], frames: str, everything: str) -> tuple[str, ...]:
    """Put in what is blank."""
    blanks = {Blank.FRAMES: frames, Blank.ALL_FRAMES: everything}
    words = (
        w.text if isinstance(w, Place) else blanks[w] if isinstance(w, Blank) else w for w in call
    )
    return (program, *words)
