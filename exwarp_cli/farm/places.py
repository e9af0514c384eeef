"""The files and folders that options of `upsample` name: what a farm has to carry or to map."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.errors import InputError
from exwarp_cli.io.aov_files import parse_aovs
from exwarp_cli.io.frame_names import NamePattern
from exwarp_cli.io.model_weights import files_of
from exwarp_cli.io.policy_files import PAPER
from exwarp_cli.io.video_reader import is_clip

if TYPE_CHECKING:
    from exwarp_cli.pipeline.job import Job


class Flow(Enum):
    """Whether a job reads a place or writes it, by the names of Open Job Description."""

    READ = "IN"
    WRITTEN = "OUT"


class Form(Enum):
    """What an option takes."""

    SEQUENCE = "a folder, a pattern, or any one frame"
    AOV = "a role, and a sequence, and names of channels"
    FILE = "one file"
    FOLDER = "one folder"


@dataclass(frozen=True)
class Purpose:
    """What an option's files are for.

    Attributes
    ----------
    name
        Of the job's parameter, as an identifier.
    label
        For people.
    form
        What the option takes.
    flow
        Whether the job reads or writes it.
    """

    name: str
    label: str
    form: Form
    flow: Flow = Flow.READ


PURPOSES: Mapping[str, Purpose] = {
    "sequence": Purpose("Sequence", "Key frames", Form.SEQUENCE),
    "gbuffers": Purpose("GBuffers", "G-buffers at the output rate", Form.SEQUENCE),
    "aovs": Purpose("Aov", "AOV", Form.AOV),
    "channel_map": Purpose("ChannelMap", "Channel map", Form.FILE),
    "rendered": Purpose("Rendered", "Rendered frames", Form.SEQUENCE),
    "ground_truth": Purpose("GroundTruth", "Ground truth", Form.SEQUENCE),
    "extrapolator": Purpose("Extrapolator", "Network that extrapolates", Form.FILE),
    "interpolator": Purpose("Interpolator", "Network that interpolates", Form.FILE),
    "policy": Purpose("Policy", "Policy", Form.FILE),
    "output": Purpose("Output", "Output frames", Form.SEQUENCE, Flow.WRITTEN),
    "write_holes": Purpose("Holes", "Hole masks", Form.SEQUENCE, Flow.WRITTEN),
    "report_folder": Purpose("Report", "Report", Form.FOLDER, Flow.WRITTEN),
    "video": Purpose("Video", "Video", Form.FILE, Flow.WRITTEN),
}
"""By the name of the parameter in `upsample`; all others name no files."""


def names_files(parameter: str, value: object) -> bool:
    """Whether the value of a parameter of `upsample` names files, none that come with ExWarp."""
    return parameter in PURPOSES and value is not None and (parameter, value) != ("policy", PAPER)


NETWORKS = ("extrapolator", "interpolator")
"""Those of them that are ONNX models."""


@dataclass(frozen=True)
class Place:
    """A file or folder of a job, and how an option names it.

    Attributes
    ----------
    purpose
        What it is for.
    name, label
        As in `Purpose`, with the role where it is an AOV's.
    path
        Of the folder or file, absolute.
    is_file
        Whether `path` is a file.
    pattern
        The rest of the path, below the folder; "" where the folder itself is named.
    before, after
        What the option's value has around the path.
    beside
        Files that are read with this one, without being named, by what a job calls them.
    """

    purpose: Purpose
    name: str
    label: str
    path: Path
    is_file: bool = False
    pattern: str = ""
    before: str = ""
    after: str = ""
    beside: Mapping[str, Path] = field(default_factory=dict, hash=False)

    @property
    def rest(self) -> str:
        """What follows the path within the option's value.

        Folders for frames end in a slash: without it ``out.exr`` would be taken for a file.
        """
        ends = self.purpose.form is Form.SEQUENCE and self.purpose.flow is Flow.WRITTEN
        slash = "/" if self.pattern or ends else ""
        return f"{slash}{self.pattern}{self.after}"

    @property
    def text(self) -> str:
        """The option's value with the whole path."""
        return f"{self.before}{self.path}{self.rest}"


def locate(parameter: str, text: str) -> Place:
    """Read the value of an option that names files.

    Parameters
    ----------
    parameter
        A name in `PURPOSES`.
    text
        What the user wrote; inputs are there.

    Raises
    ------
    InputError
        When the path is no text that a job can hold.
    """
    place = _located(parameter, text)
    # Whole paths, as the current folder becomes a part of them.
    for path in (place.text, *map(str, place.beside.values())):
        if not _is_text(path):
            raise InputError(
                f"the path {path!r} holds bytes that are no UTF-8, which no job can carry; "
                "rename it"
            )
    return place


def _located(parameter: str, text: str) -> Place:
    purpose = PURPOSES[parameter]
    if purpose.form is Form.AOV:
        return _aov(purpose, text)
    place = Place(purpose, purpose.name, purpose.label, Path(text).absolute())
    if purpose.form is Form.FOLDER:
        return place
    if purpose.form is Form.FILE:
        return replace(place, is_file=True, beside=_beside(parameter, place.path))
    if purpose.flow is Flow.WRITTEN:
        folder, pattern = _written(text, place.path)
    elif is_clip(text) and place.path.is_file():
        return replace(place, is_file=True)
    else:
        folder, pattern = _read(place.path)
    return replace(place, path=folder, pattern=pattern)


def _aov(purpose: Purpose, text: str) -> Place:
    (aov,) = parse_aovs([text])
    folder, pattern = _read(Path(aov.pattern).absolute())
    role = aov.role.value
    name = f"{purpose.name}{''.join(word.capitalize() for word in role.split('_'))}"
    label = f"{purpose.label} {role}"
    return Place(purpose, name, label, folder, False, pattern, f"{role}=", aov.chosen)


def _read(path: Path) -> tuple[Path, str]:
    """Part a path into a folder that is there, and the rest: ``%V`` may stand for a folder, too."""
    folder = next(place for place in (path, *path.parents) if place.is_dir())
    return folder, "" if folder == path else path.relative_to(folder).as_posix()


def _written(text: str, path: Path) -> tuple[Path, str]:
    """Part a path as `upsample` does, whose folder need not be there."""
    is_folder = text.endswith(("/", os.sep)) or path.is_dir()
    if is_folder or NamePattern.parse(path.name) is None:
        return path, ""
    return path.parent, path.name


def _beside(parameter: str, path: Path) -> dict[str, Path]:
    """Return what is read beside a network: its card, and the weights that it keeps apart."""
    found = {}
    if parameter == "interpolator" and (card := path.with_suffix(".json")).is_file():
        found["Card"] = card
    if parameter in NETWORKS and path.is_file():
        for number, file in enumerate(files_of(path), start=1):
            found[f"Weights{number}"] = file
    return found


def _is_text(text: str) -> bool:
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def absolute(settings: UpsampleSettings) -> UpsampleSettings:
    """Return settings whose paths do not depend on the folder in which a process runs."""
    source = replace(settings.source, **_placed_in(settings.source))
    return replace(settings, source=source, **_placed_in(settings))


def inputs_of(job: Job) -> tuple[tuple[str, int], ...]:
    """Return files that a job reads, enough to tell whether a machine sees all, and their sizes.

    Of sequences these are the first and the last frame: mounted is mounted. Networks that come with
    ExWarp are each machine's own.
    """
    return tuple((str(path.absolute()), path.stat().st_size) for path in dict.fromkeys(_files(job)))


def _files(job: Job) -> Iterator[Path]:
    keys, slots = job.source.keys, job.source.slots
    for shot in (keys,) if slots is None else (keys, slots):
        numbers = shot.sequence.numbers
        for number in (numbers[0], numbers[-1]):
            # Where frames may be left out, those that are missing are listed, too.
            paths = shot.files(number).values()
            yield from (path for path in paths if not shot.keep_going or path.exists())
    others = [] if job.truth is None else [job.truth[0]]
    others += [] if job.rendered is None else [job.rendered.sequence]
    for files in (sequence.files for sequence in others):
        yield from (files[min(files)], files[max(files)])
    for name, purpose in PURPOSES.items():
        if purpose.form is Form.FILE and purpose.flow is Flow.READ:
            owner = job.settings if hasattr(job.settings, name) else job.settings.source
            named = getattr(owner, name)
            if names_files(name, named):
                yield Path(named)


def _placed_in(settings: UpsampleSettings | SourceSettings) -> dict[str, Any]:
    """Return the options of these settings that name files, each beginning at the root."""
    given = {f.name: getattr(settings, f.name) for f in fields(settings)}
    return {
        name: tuple(map(_absolute_aov, value))
        if PURPOSES[name].form is Form.AOV
        else _placed(value)
        for name, value in given.items()
        if names_files(name, value)
    }


def _placed(text: str) -> str:
    """Let a path or pattern begin at the root; a slash at its end stays, as it says something."""
    # Not by `Path`, which drops that slash; and `..` stays, as links could lead elsewhere.
    return text if Path(text).is_absolute() else f"{Path.cwd()}/{text}"


def _absolute_aov(text: str) -> str:
    """Place the pattern in ``ROLE=PATTERN[:CHANNELS]``."""
    role, equals, rest = text.partition("=")
    return f"{role}{equals}{_placed(rest)}"
