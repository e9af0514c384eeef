"""A run of `upsample` as a farm does it: the files that its options name, and its commands.

A farm carries or maps the files. It runs a command for each chunk, and some after all chunks.
"""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import printable
from exwarp_cli.errors import InputError, UsageError
from exwarp_cli.io.channel_map import parse_aovs, read_channel_map
from exwarp_cli.io.frame_names import NamePattern
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.models.model_file import embed_weights, read_file_bytes
from exwarp_cli.models.policy_files import PAPER

if TYPE_CHECKING:
    from exwarp_cli.pipeline.job import Job

Settings = TypeVar("Settings", UpsampleSettings, SourceSettings)

# Keeps a worker's environment, and settings files there, from changing the job.
ISOLATED = "--isolated"

# Parameters of `upsample` that a chunk does not have, or has otherwise.
AFTERWARDS = ("report_folder", "video")
SCORING = ("ground_truth", "metrics")


class ValueKind(Enum):
    """What an option takes."""

    SEQUENCE = "a folder, a pattern, or any one frame"
    AOV = "a role, and a sequence, and names of channels"
    FILE = "one file"
    FOLDER = "one folder"


@dataclass(frozen=True)
class PathRole:
    """What the files of an option are."""

    name: str  # name of the job's parameter, an identifier
    label: str
    kind: ValueKind  # what the option takes
    is_written: bool = False  # whether the job writes the files; else it reads them


# By the name of the parameter in `upsample`; no other parameter names files.
PATH_ROLES: Mapping[str, PathRole] = {
    "sequence": PathRole("Sequence", "Key frames", ValueKind.SEQUENCE),
    "gbuffers": PathRole("GBuffers", "G-buffers at the output rate", ValueKind.SEQUENCE),
    "aovs": PathRole("Aov", "AOV", ValueKind.AOV),
    "channel_map": PathRole("ChannelMap", "Channel map", ValueKind.FILE),
    "rendered": PathRole("Rendered", "Rendered frames", ValueKind.SEQUENCE),
    "ground_truth": PathRole("GroundTruth", "Ground truth", ValueKind.SEQUENCE),
    "extrapolator": PathRole("Extrapolator", "Network that extrapolates", ValueKind.FILE),
    "interpolator": PathRole("Interpolator", "Network that interpolates", ValueKind.FILE),
    "policy": PathRole("Policy", "Policy", ValueKind.FILE),
    "output": PathRole("Output", "Output frames", ValueKind.SEQUENCE, is_written=True),
    "write_holes": PathRole("Holes", "Hole masks", ValueKind.SEQUENCE, is_written=True),
    "report_folder": PathRole("Report", "Report", ValueKind.FOLDER, is_written=True),
    "video": PathRole("Video", "Video", ValueKind.FILE, is_written=True),
}


def names_files(parameter: str, value: object) -> bool:
    """Return whether a value of `upsample` names files other than those that ExWarp brings."""
    return parameter in PATH_ROLES and value is not None and (parameter, value) != ("policy", PAPER)


@dataclass(frozen=True)
class PathOption:
    """A file or folder of a job, and how an option names it."""

    role: PathRole  # of an AOV, with that role in name and label
    path: Path  # absolute path of the folder or file
    is_file: bool = False  # whether `path` is a file
    pattern: str = ""  # the rest of the path, below the folder; "" where the folder itself is named
    # before, after: what the option's value has around the path
    before: str = ""
    after: str = ""
    # Files that are read with this one without being named, by their name in a job
    companions: Mapping[str, Path] = field(default_factory=dict, hash=False)

    @property
    def remainder(self) -> str:
        """What follows the path in the option's value."""
        # Folders for frames end in a slash: without it ``out.exr`` would be taken for a file.
        is_output = self.role.kind is ValueKind.SEQUENCE and self.role.is_written
        slash = "/" if self.pattern or is_output else ""
        return f"{slash}{self.pattern}{self.after}"

    @property
    def text(self) -> str:
        """The option's value, with an absolute path."""
        return f"{self.before}{self.path}{self.remainder}"


def locate(parameter: str, text: str) -> PathOption:
    """Parse the value of an option that names files; inputs must exist.

    InputError: the path is no text that a job can hold.
    """
    role = PATH_ROLES[parameter]
    option = PathOption(role, Path(text).absolute())
    path = option.path
    if role.kind is ValueKind.AOV:
        (aov,) = parse_aovs([text])
        name = role.name + "".join(word.capitalize() for word in aov.role.value.split("_"))
        option = PathOption(
            replace(role, name=name, label=f"{role.label} {aov.role.value}"),
            Path(aov.pattern).absolute(),
            before=f"{aov.role.value}=",
            after=aov.chosen,
        )
    elif role.kind is ValueKind.FILE:
        companions = {}
        if parameter == "interpolator" and (card := path.with_suffix(".json")).is_file():
            companions["Card"] = card
        if parameter in ("extrapolator", "interpolator") and path.is_file():
            _, files = embed_weights(path, read_file_bytes(path))
            companions |= {f"Weights{n}": file for n, file in enumerate(files, start=1)}
        option = replace(option, is_file=True, companions=companions)
    elif role.kind is ValueKind.SEQUENCE and role.is_written:
        # As `upsample` does; the folder need not exist.
        is_folder = text.endswith(("/", os.sep)) or path.is_dir()
        if not is_folder and NamePattern.parse(path.name) is not None:
            option = replace(option, path=path.parent, pattern=path.name)
    elif role.kind is ValueKind.SEQUENCE and is_clip(text) and path.is_file():
        option = replace(option, is_file=True)
    if not (role.is_written or option.is_file):
        # A folder that exists, and the rest: ``%V`` may also stand for a folder.
        path = option.path
        folder = next(parent for parent in (path, *path.parents) if parent.is_dir())
        pattern = "" if folder == path else path.relative_to(folder).as_posix()
        option = replace(option, path=folder, pattern=pattern)
    # Absolute paths are checked, because the current folder becomes a part of them.
    for name in (option.text, *map(str, option.companions.values())):
        try:
            name.encode("utf-8")
        except UnicodeEncodeError as error:
            raise InputError(
                f"the path {name!r} holds bytes that are no UTF-8, which no job can carry; "
                "rename it"
            ) from error
    return option


def absolute(settings: Settings) -> Settings:
    """Return settings whose paths do not depend on the folder in which a process runs."""
    paths: dict[str, Any] = {}
    for name in (f.name for f in fields(settings)):
        value = getattr(settings, name)
        if isinstance(value, SourceSettings):
            paths[name] = absolute(value)
        elif names_files(name, value) and PATH_ROLES[name].kind is ValueKind.AOV:
            parts = (aov.partition("=") for aov in value)  # ROLE=PATTERN[:CHANNELS]
            paths[name] = tuple(f"{role}{equals}{_absolute(path)}" for role, equals, path in parts)
        elif names_files(name, value):
            paths[name] = _absolute(value)
    return replace(settings, **paths)


def _absolute(text: str) -> str:
    # Not by `Path`, which drops a slash at the end; and `..` stays, as links could lead elsewhere.
    return text if Path(text).is_absolute() else f"{Path.cwd()}/{text}"


def inputs_of(job: Job) -> tuple[tuple[str, int], ...]:
    """Return files that a job reads, with their sizes: enough to tell whether a machine sees all.

    Of sequences these are the first and the last frame, because a folder is mounted or not.
    Networks that come with ExWarp are not among them: each machine has its own.
    """
    files: list[Path] = []
    keys, slots = job.source.keys, job.source.slots
    for shot in (keys,) if slots is None else (keys, slots):
        numbers = shot.sequence.numbers
        for number in (numbers[0], numbers[-1]):
            # With --keep-going, frames that are missing are listed too.
            paths = shot.files(number).values()
            files += [path for path in paths if not shot.keep_going or path.exists()]
    sequences = [] if job.truth is None else [job.truth[0]]
    sequences += [] if job.rendered is None else [job.rendered.sequence]
    for frames in (sequence.files for sequence in sequences):
        files += [frames[min(frames)], frames[max(frames)]]
    for name, role in PATH_ROLES.items():
        if role.kind is ValueKind.FILE and not role.is_written:
            owner = job.settings if hasattr(job.settings, name) else job.settings.source
            value = getattr(owner, name)
            if names_files(name, value):
                files.append(Path(value))
    return tuple((str(path.absolute()), path.stat().st_size) for path in dict.fromkeys(files))


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
    def afterwards(self) -> dict[str, list[Argument]]:
        """The commands to run when all chunks are done, by the names of their steps.

        One joins the chunks' reports, one makes the video of the finished frames.
        """
        report, video = self.path("report_folder"), self.path("video")
        commands: dict[str, list[Argument]] = {}
        if report is not None:
            commands["Report"] = ["merge-reports", ISOLATED, report, "--overwrite"]
        if video is not None:
            without = (*AFTERWARDS, "write_holes", *(() if self.needs_truth else SCORING))
            arguments = [*self._upsample(without), "--skip-existing", "--video", video]
            commands["Video"] = [*arguments, "--frames", Placeholder.ALL_FRAMES]
        return commands

    def _upsample(self, without: Iterable[str]) -> list[Argument]:
        words: list[Argument] = ["upsample", ISOLATED]
        for option in self.options:
            if option.parameter in without:
                continue
            if option.flag:
                words.append(option.flag)
            if option.value is not None:
                words.append(option.value)
        return words


def split(numbers: Sequence[int], size: int) -> tuple[tuple[int, ...], ...]:
    """Divide key frames into chunks of `size`; the last chunk may have fewer."""
    return tuple(tuple(numbers[i : i + size]) for i in range(0, len(numbers), size))


def frames_text(numbers: Sequence[int]) -> str:
    """Write key frames as ``--frames`` and Open Job Description take them.

    Both read ``1001-1010``, ``10-30:4``, ``-8-4:4``, ``1,2,9`` and ``7`` as the same numbers.
    """
    return ranges(list(numbers)).replace("x", ":")


def command_lines(
    job: FarmJob, program: str
) -> tuple[list[tuple[str, list[str]]], list[list[str]]]:
    """Write out a job with absolute paths; `program` is the name or path of `exwarp` on workers.

    Returns the key frames and the words of each chunk's command, which may run in any order and in
    parallel, and the words of the commands to run when all chunks are done.
    """
    all_frames = frames_text(job.numbers)

    def fill(command: Sequence[Argument], frames: str) -> list[str]:
        texts = {Placeholder.FRAMES: frames, Placeholder.ALL_FRAMES: all_frames}
        words = [texts[word] if isinstance(word, Placeholder) else word for word in command]
        return [program, *(w.text if isinstance(w, PathOption) else w for w in words)]

    frames = [frames_text(chunk) for chunk in split(job.numbers, job.size)]
    return (
        [(text, fill(job.chunk, text)) for text in frames],
        [fill(command, all_frames) for command in job.afterwards.values()],
    )


def shell_line(words: Sequence[str]) -> str:
    """Write a command for a POSIX shell, on one line.

    UsageError: a word has a line end or another control character.
    """
    if misleading := [word for word in words if printable(word) != word]:
        raise UsageError(
            f"{printable(misleading[0])} has a line end or control character in it, which no line "
            "of a shell should have; rename it, or take --json"
        )
    return shlex.join(words)


def open_farm_job(
    settings: UpsampleSettings,  # of the whole run
    # Argument and options: name in the command, flag ("" for the argument), value (None without)
    options: Sequence[tuple[str, str, str | None]],
    size: int,  # key frames of a chunk
    title: str | None,  # None for the sequence's name
) -> FarmJob:
    """Check what a job would read and write, and return it in chunks.

    ExwarpError: anything that `upsample` would refuse.
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
        chosen = list(options)
        if settings.source.channel_map is not None:
            # Its AOVs become options, because its paths are relative to this folder.
            roles = {aov.role for aov in parse_aovs(settings.source.aovs)}
            chosen += [
                ("aovs", "--aov", f"{aov.role.value}={aov.pattern}{aov.chosen}")
                for aov in read_channel_map(Path(settings.source.channel_map)).aovs
                if aov.role not in roles
            ]
        values = []
        for parameter, flag, text in chosen:
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
