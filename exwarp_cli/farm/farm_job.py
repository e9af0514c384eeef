"""The commands of `exwarp` that a farm runs: one for each chunk, and those after all chunks."""

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
from exwarp_cli.farm.path_options import PathOption, locate, names_files
from exwarp_cli.io.channel_map import parse_aovs, read_channel_map
from exwarp_cli.io.video_reader import is_clip

# Keeps a worker's environment, and settings files there, from changing the job.
ISOLATED = "--isolated"

# Parameters of `upsample` that a chunk does not have, or has otherwise.
AFTERWARDS = ("report_folder", "video")
SCORING = ("ground_truth", "metrics")


class Placeholder(Enum):
    """What is filled in for every chunk."""

    FRAMES = "key frames of the chunk"
    ALL_FRAMES = "key frames of the job"


Argument = str | PathOption | Placeholder


@dataclass(frozen=True)
class OptionValue:
    """An option of `upsample`, as the user wrote it."""

    parameter: str  # its name in the command
    flag: str  # how it is written; "" for the argument
    value: str | PathOption | None = None  # None for a flag without value

    @property
    def arguments(self) -> list[Argument]:
        """The option in a command line."""
        flag: list[Argument] = [self.flag] if self.flag else []
        return flag if self.value is None else [*flag, self.value]


@dataclass(frozen=True)
class FarmJob:
    """A run of `upsample` that is done in chunks."""

    # Argument and options, without those that choose frames, repeat, or report progress
    options: tuple[OptionValue, ...]
    numbers: tuple[int, ...]  # input numbers of the key frames to do, ascending
    size: int  # key frames of a chunk
    title: str
    # Whether existing frames are made again. Otherwise good ones are kept, so that a chunk that
    # was killed continues when it is done again.
    overwrite: bool = False
    needs_truth: bool = False  # whether the frames depend on ground truth

    def path(self, parameter: str) -> PathOption | None:
        """Return what an option names; None where it is not used."""
        values = (option.value for option in self.options if option.parameter == parameter)
        return next((value for value in values if isinstance(value, PathOption)), None)

    @property
    def chunk(self) -> list[Argument]:
        """The command that does a chunk."""
        report = self.path("report_folder")
        arguments = self._upsample(AFTERWARDS)
        if report is not None:
            arguments += ["--report", report, "--as-chunk"]
        existing = "--overwrite" if self.overwrite else "--skip-existing"
        return [*arguments, existing, "--frames", Placeholder.FRAMES]

    @property
    def merging(self) -> list[Argument] | None:
        """The command that joins the chunks' reports; None without a report."""
        report = self.path("report_folder")
        return None if report is None else ["merge-reports", ISOLATED, report, "--overwrite"]

    @property
    def filming(self) -> list[Argument] | None:
        """The command that makes the video of the finished frames; None without a video."""
        video = self.path("video")
        if video is None:
            return None
        without = (*AFTERWARDS, "write_holes", *(() if self.needs_truth else SCORING))
        arguments = [*self._upsample(without), "--skip-existing", "--video", video]
        return [*arguments, "--frames", Placeholder.ALL_FRAMES]

    def _upsample(self, without: Iterable[str]) -> list[Argument]:
        options = (option for option in self.options if option.parameter not in without)
        return ["upsample", ISOLATED, *(word for option in options for word in option.arguments)]


def split(numbers: Sequence[int], size: int) -> tuple[tuple[int, ...], ...]:
    """Divide key frames into chunks of `size`; the last chunk may have fewer."""
    return tuple(tuple(numbers[i : i + size]) for i in range(0, len(numbers), size))


def frames_text(numbers: Sequence[int]) -> str:
    """Write key frames as ``--frames`` and Open Job Description take them.

    Both read ``1001-1010``, ``10-30:4``, ``-8-4:4``, ``1,2,9`` and ``7`` as the same numbers.
    """
    return ranges(list(numbers)).replace("x", ":")


def is_dense(numbers: Sequence[int]) -> bool:
    """Return whether any two key frames have neighbouring numbers.

    Of others, such as 10, 14, 18, a range without a step holds a single one.
    """
    return len(numbers) < 2 or any(b - a == 1 for a, b in pairwise(numbers))


def command_lines(
    job: FarmJob, program: str
) -> tuple[list[tuple[str, list[str]]], list[list[str]]]:
    """Write out a job with absolute paths; `program` is the name or path of `exwarp` on workers.

    Returns the key frames and the words of each chunk's command, which may run in any order and in
    parallel, and the words of the commands to run when all chunks are done.
    """
    all_frames = frames_text(job.numbers)

    def fill(command: Sequence[Argument], frames: str) -> list[str]:
        words = [program]
        for word in command:
            if isinstance(word, Placeholder):
                words.append(frames if word is Placeholder.FRAMES else all_frames)
            else:
                words.append(word.text if isinstance(word, PathOption) else word)
        return words

    frames = [frames_text(chunk) for chunk in split(job.numbers, job.size)]
    afterwards = [command for command in (job.merging, job.filming) if command is not None]
    return (
        [(text, fill(job.chunk, text)) for text in frames],
        [fill(command, all_frames) for command in afterwards],
    )


def shell_line(words: Sequence[str]) -> str:
    """Write a command for a POSIX shell, on one line.

    Raises
    ------
    UsageError
        When a word has a line end or another control character.
    """
    if misleading := [word for word in words if has_control_chars(word)]:
        raise UsageError(
            f"{printable(misleading[0])} has a line end or control character in it, which no line "
            "of a shell should have; rename it, or take --json"
        )
    return shlex.join(words)


def open_farm_job(
    settings: UpsampleSettings,
    options: Sequence[tuple[str, str, str | None]],
    size: int,
    title: str | None,
) -> FarmJob:
    """Check what a job would read and write, and return it in chunks.

    Parameters
    ----------
    settings
        Settings of the whole run.
    options
        Argument and options, each as its name in the command, its flag ("" for the argument) and
        its value (None without).
    size
        Key frames of a chunk.
    title
        None for the sequence's name.

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
    from exwarp_cli.pipeline.job import open_job  # imports all of the pipeline: not for --help

    # The device is one of a worker, which this machine may not have.
    job = open_job(replace(settings, device=UpsampleSettings.device))
    try:
        if settings.device != UpsampleSettings.device and not job.method.runs_network:
            raise UsageError(
                f"--device {settings.device} is for methods that run a network, and --method "
                f"{job.method.name} does not; leave it out"
            )
        job.refuse()
        values = []
        for parameter, flag, text in (*options, *_aovs_of_map(settings)):
            is_path = text is not None and names_files(parameter, text)
            value = locate(parameter, text) if is_path and text is not None else text
            values.append(OptionValue(parameter, flag, value))
        return FarmJob(
            tuple(values),
            job.key_numbers,
            size,
            title or f"exwarp {Path(job.source.keys.sequence.pattern).name}",
            settings.overwrite,
            job.method.needs_truth,
        )
    finally:
        job.close()


def _aovs_of_map(settings: UpsampleSettings) -> Iterable[tuple[str, str, str]]:
    """Yield the AOVs of a channel map as options, because its paths are relative to this folder."""
    if settings.source.channel_map is None:
        return
    roles = {aov.role for aov in parse_aovs(settings.source.aovs)}
    for aov in read_channel_map(Path(settings.source.channel_map)).aovs:
        if aov.role not in roles:
            yield "aovs", "--aov", f"{aov.role.value}={aov.pattern}{aov.chosen}"
