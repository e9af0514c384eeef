"""The files and folders that options of `upsample` name: what a farm has to carry or to map."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.errors import InputError
from exwarp_cli.io.channel_map import parse_aovs
from exwarp_cli.io.frame_names import NamePattern
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.models.model_file import weight_files
from exwarp_cli.models.policy_files import PAPER

if TYPE_CHECKING:
    from exwarp_cli.pipeline.job import Job


class DataFlow(Enum):
    """Whether a job reads or writes a path, by the names of Open Job Description."""

    READ = "IN"
    WRITTEN = "OUT"


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
    flow: DataFlow = DataFlow.READ  # whether the job reads or writes the files


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
    "output": PathRole("Output", "Output frames", ValueKind.SEQUENCE, DataFlow.WRITTEN),
    "write_holes": PathRole("Holes", "Hole masks", ValueKind.SEQUENCE, DataFlow.WRITTEN),
    "report_folder": PathRole("Report", "Report", ValueKind.FOLDER, DataFlow.WRITTEN),
    "video": PathRole("Video", "Video", ValueKind.FILE, DataFlow.WRITTEN),
}
NETWORKS = ("extrapolator", "interpolator")  # of these the ONNX models


def names_files(parameter: str, value: object) -> bool:
    """Return whether a value of `upsample` names files other than those that ExWarp brings."""
    return parameter in PATH_ROLES and value is not None and (parameter, value) != ("policy", PAPER)


@dataclass(frozen=True)
class PathOption:
    """A file or folder of a job, and how an option names it."""

    role: PathRole
    # name, label: as in `PathRole`, and the role of an AOV
    name: str
    label: str
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
        is_output = self.role.kind is ValueKind.SEQUENCE and self.role.flow is DataFlow.WRITTEN
        slash = "/" if self.pattern or is_output else ""
        return f"{slash}{self.pattern}{self.after}"

    @property
    def text(self) -> str:
        """The option's value, with an absolute path."""
        return f"{self.before}{self.path}{self.remainder}"


def locate(parameter: str, text: str) -> PathOption:
    """Parse the value of an option that names files; inputs must exist.

    Raises
    ------
    InputError
        When the path is no text that a job can hold.
    """
    option = _parse(parameter, text)
    # Absolute paths are checked, because the current folder becomes a part of them.
    for path in (option.text, *map(str, option.companions.values())):
        try:
            path.encode("utf-8")
        except UnicodeEncodeError as error:
            raise InputError(
                f"the path {path!r} holds bytes that are no UTF-8, which no job can carry; "
                "rename it"
            ) from error
    return option


def _parse(parameter: str, text: str) -> PathOption:
    role = PATH_ROLES[parameter]
    if role.kind is ValueKind.AOV:
        (aov,) = parse_aovs([text])
        folder, pattern = _split_existing(Path(aov.pattern).absolute())
        name = "".join(word.capitalize() for word in aov.role.value.split("_"))
        return PathOption(
            role,
            f"{role.name}{name}",
            f"{role.label} {aov.role.value}",
            folder,
            pattern=pattern,
            before=f"{aov.role.value}=",
            after=aov.chosen,
        )
    option = PathOption(role, role.name, role.label, Path(text).absolute())
    path = option.path
    if role.kind is ValueKind.FOLDER:
        return option
    if role.kind is ValueKind.FILE:
        return replace(option, is_file=True, companions=_companions(parameter, path))
    if role.flow is DataFlow.WRITTEN:  # as `upsample` does; the folder need not exist
        is_folder = text.endswith(("/", os.sep)) or path.is_dir()
        if is_folder or NamePattern.parse(path.name) is None:
            return option
        return replace(option, path=path.parent, pattern=path.name)
    if is_clip(text) and path.is_file():
        return replace(option, is_file=True)
    folder, pattern = _split_existing(path)
    return replace(option, path=folder, pattern=pattern)


def _split_existing(path: Path) -> tuple[Path, str]:
    """Split a path into a folder that exists, and the rest: ``%V`` may also stand for a folder."""
    folder = next(parent for parent in (path, *path.parents) if parent.is_dir())
    return folder, "" if folder == path else path.relative_to(folder).as_posix()


def _companions(parameter: str, path: Path) -> dict[str, Path]:
    """Return the card of a network, and the files of weights that it names."""
    companions = {}
    if parameter == "interpolator" and (card := path.with_suffix(".json")).is_file():
        companions["Card"] = card
    if parameter in NETWORKS and path.is_file():
        for number, file in enumerate(weight_files(path), start=1):
            companions[f"Weights{number}"] = file
    return companions


def absolute(settings: UpsampleSettings) -> UpsampleSettings:
    """Return settings whose paths do not depend on the folder in which a process runs."""
    source = replace(settings.source, **_absolute_paths(settings.source))
    return replace(settings, source=source, **_absolute_paths(settings))


def _absolute_paths(settings: UpsampleSettings | SourceSettings) -> dict[str, Any]:
    paths: dict[str, Any] = {}
    for name in (f.name for f in fields(settings)):
        value = getattr(settings, name)
        if not names_files(name, value):
            continue
        if PATH_ROLES[name].kind is ValueKind.AOV:  # ROLE=PATTERN[:CHANNELS]
            parts = (aov.partition("=") for aov in value)
            paths[name] = tuple(f"{role}{equals}{_absolute(path)}" for role, equals, path in parts)
        else:
            paths[name] = _absolute(value)
    return paths


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
        if role.kind is ValueKind.FILE and role.flow is DataFlow.READ:
            owner = job.settings if hasattr(job.settings, name) else job.settings.source
            value = getattr(owner, name)
            if names_files(name, value):
                files.append(Path(value))
    return tuple((str(path.absolute()), path.stat().st_size) for path in dict.fromkeys(files))
