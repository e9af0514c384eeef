"""The calls of `exwarp` that a farm makes: one a chunk, and those that come after all chunks."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise
from pathlib import Path

from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import has_control_chars, printable
from exwarp_cli.errors import UsageError
from exwarp_cli.farm.places import Place, locate, names_files
from exwarp_cli.io.aov_files import parse_aovs
from exwarp_cli.io.channel_map import read_channel_map
from exwarp_cli.io.clip import is_clip

ALONE = ("--isolated",)
"""What keeps a worker's environment, and files of settings there, from changing the job."""

SCORING = ("ground_truth", "metrics")
LAST = ("report_folder", "video")
"""Parameters of `upsample` that are no part of a chunk as they are."""


class Blank(Enum):
    """What is filled in for every chunk."""

    FRAMES = "key frames of the chunk"
    ALL_FRAMES = "key frames of the job"


Word = str | Place | Blank
"""One word of a command line, without the program's name in front."""


@dataclass(frozen=True)
class Given:
    """An option of `upsample`, as the user gave it.

    Attributes
    ----------
    parameter
        Its name in the command.
    flag
        How it is written; "" for the argument.
    value
        None for a flag without value.
    """

    parameter: str
    flag: str
    value: str | Place | None = None

    @property
    def words(self) -> list[Word]:
        """The option in a command line."""
        flag: list[Word] = [self.flag] if self.flag else []
        return flag if self.value is None else [*flag, self.value]


@dataclass(frozen=True)
class FarmJob:
    """A run of `upsample` that is going to be done in chunks.

    Attributes
    ----------
    given
        Argument and options, without those that say which frames, how often and how loudly.
    numbers
        Key frames to do, by their input numbers, ascending.
    size
        Key frames of a chunk.
    title
        Names it for people.
    overwrite
        Whether frames that are there are made again. Else good ones are kept, so that a chunk that
        was killed and is done again goes on.
    judged
        Whether the frames depend on ground truth.
    """

    given: tuple[Given, ...]
    numbers: tuple[int, ...]
    size: int
    title: str
    overwrite: bool = False
    judged: bool = False

    def place(self, parameter: str) -> Place | None:
        """Return what an option names, None where it is not given."""
        return next(
            (
                g.value
                for g in self.given
                if g.parameter == parameter and isinstance(g.value, Place)
            ),
            None,
        )

    @property
    def chunk(self) -> list[Word]:
        """The call that does a chunk."""
        report = self.place("report_folder")
        reported: list[Word] = [] if report is None else ["--report", report, "--as-chunk"]
        again = "--overwrite" if self.overwrite else "--skip-existing"
        given = self._without(LAST)
        return ["upsample", *ALONE, *given, *reported, again, "--frames", Blank.FRAMES]

    @property
    def merging(self) -> list[Word] | None:
        """The call that joins the chunks' reports; None without a report."""
        report = self.place("report_folder")
        return None if report is None else ["merge-reports", *ALONE, report, "--overwrite"]

    @property
    def filming(self) -> list[Word] | None:
        """The call that makes the video of the finished frames, which it keeps; None without."""
        video = self.place("video")
        if video is None:
            return None
        left_out = LAST if self.judged else (*LAST, *SCORING)
        given = self._without((*left_out, "write_holes"))
        again: list[Word] = ["--skip-existing", "--video", video]
        return ["upsample", *ALONE, *given, *again, "--frames", Blank.ALL_FRAMES]

    def _without(self, parameters: Iterable[str]) -> list[Word]:
        return [w for g in self.given if g.parameter not in parameters for w in g.words]


DEFAULT_SIZE = 10
"""Key frames of a chunk by default: starting ExWarp takes about as long as one of 2K."""


def split(numbers: Sequence[int], size: int) -> tuple[tuple[int, ...], ...]:
    """Cut key frames into chunks.

    Parameters
    ----------
    numbers
        Key frames, ascending: their input numbers, or anything else that stands for them.
    size
        Key frames of a chunk, at least 1; the last may have fewer.
    """
    return tuple(tuple(numbers[i : i + size]) for i in range(0, len(numbers), size))


def frames_text(numbers: Sequence[int]) -> str:
    """Write key frames as ``--frames`` and Open Job Description take them.

    Both read ``1001-1010``, ``10-30:4``, ``-8-4:4``, ``1,2,9`` and ``7`` as the same numbers.
    """
    return ranges(list(numbers)).replace("x", ":")


def is_dense(numbers: Sequence[int]) -> bool:
    """Whether key frames are numbered in steps of one, gaps aside.

    Of others, such as 10, 14, 18, a range without a step holds a single one.
    """
    return len(numbers) < 2 or any(b - a == 1 for a, b in pairwise(numbers))


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
    if bad := [word for word in words if has_control_chars(word)]:
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


def open_farm_job(
    settings: UpsampleSettings,
    options: Sequence[tuple[str, str, str | None]],
    size: int,
    title: str | None,
) -> FarmJob:
    """Look at what a job would read and write, and put down what its chunks are called with.

    Parameters
    ----------
    settings
        Of the whole run.
    options
        Argument and options, each as its name in the command, its flag ("" for the argument) and
        its value (None without).
    size
        Key frames of a chunk.
    title
        Of the job; None for the sequence's name.

    Raises
    ------
    ExwarpError
        For anything that `upsample` would refuse.
    """
    if is_clip(settings.output):
        raise UsageError(
            f"-o {settings.output} is a video, which no chunk can write alone; name a folder for "
            "the frames in -o, and the video with --video"
        )
    # With the device of a worker, not of here.
    from exwarp_cli.pipeline.job import open_job  # imports all of the pipeline: not for --help

    job = open_job(replace(settings, device=UpsampleSettings.device))
    try:
        # Refuse a device for a method that runs nothing on it.
        runs = job.method.runs_network
        if settings.device != UpsampleSettings.device and not runs:
            raise UsageError(
                f"--device {settings.device} is for methods that run a network, and --method "
                f"{job.method.name} does not; leave it out"
            )
        job.refuse()
        return FarmJob(
            tuple(_given((*options, *_mapped(settings)))),
            job.key_numbers,
            size,
            title or f"exwarp {Path(job.source.keys.sequence.pattern).name}",
            settings.overwrite,
            job.method.needs_truth,
        )
    finally:
        job.close()


def _given(options: Iterable[tuple[str, str, str | None]]) -> Iterable[Given]:
    for parameter, flag, text in options:
        if text is None or not names_files(parameter, text):
            yield Given(parameter, flag, text)
        else:
            yield Given(parameter, flag, locate(parameter, text))


def _mapped(settings: UpsampleSettings) -> Iterable[tuple[str, str, str]]:
    """Return the AOVs of a channel map as options: its paths hold in this folder alone."""
    path = settings.source.channel_map
    if path is None:
        return
    given = {aov.role for aov in parse_aovs(settings.source.aovs)}
    for aov in read_channel_map(Path(path)).aovs:
        if aov.role not in given:
            yield "aovs", "--aov", f"{aov.role.value}={aov.pattern}{aov.chosen}"
