"""Image sequences on disk: finding one, sets of one file per AOV, and where frames are written."""

from __future__ import annotations

import errno
import os
import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from exwarp_cli.domain.timeline import fill_gaps, ranges
from exwarp_cli.errors import InputError, MissingFrameError, OutputError, UsageError
from exwarp_cli.io.atomic import is_there
from exwarp_cli.io.frame_names import (
    NamePattern,
    file_type,
    group_names,
    is_printed,
    split_names,
)
from exwarp_cli.io.pass_sets import pass_sets

EXR = (".exr",)

COLOUR_AOVS = ("PreTonemapHDRColor", "SceneColor", "FinalImage")
"""Names under which Unreal dumps colour, the most nearly scene-linear one first."""

MOTION_AOV = "MotionVector"

GEOMETRY_AOVS = (
    "SceneDepth",
    "WorldNormal",
    "WorldPosition",
    "MyStencil",
    "BaseColor",
    "Roughness",
    "Metallic",
    "NoV",
)

_AOV = re.compile(
    r"(?P<prefix>.*)"
    rf"(?P<aov>{'|'.join((*COLOUR_AOVS, MOTION_AOV, *GEOMETRY_AOVS))})"
    r"(?P<end>[._ -]?)",
    re.DOTALL,
)
# What people write by mistake; anything else without a frame token names a folder.
_OTHER_MEDIA = frozenset(
    {".bmp", ".cin", ".dng", ".dpx", ".gif", ".hdr", ".heic", ".jp2", ".jpeg", ".jpg", ".jxl"}
    | {".pic", ".png", ".ppm", ".psd", ".rgbe", ".sgi", ".tga", ".tif", ".tiff", ".tx", ".webp"}
    | {".avi", ".m4v", ".mkv", ".mov", ".mp4", ".webm"}
)


@dataclass(frozen=True)
class Sequence:
    """Files of one folder that differ in their frame number alone.

    Attributes
    ----------
    directory
        The folder.
    base
        Text before the digits, for example ``shot.``.
    padding
        Digits that numbers are filled up to; 1 means not filled.
    suffix
        Text after the digits, for example ``.exr``.
    files
        Path of each frame by number, ascending.
    """

    directory: Path
    base: str
    padding: int
    suffix: str
    files: dict[int, Path]

    @property
    def type(self) -> str:
        """Image suffix in lower case, for example ``.exr``."""
        return file_type(self.suffix)

    @property
    def pattern(self) -> str:
        """Path with one ``#`` per digit of padding."""
        return str(self.directory / str(NamePattern(self.base, self.padding, self.suffix)))

    @property
    def numbers(self) -> list[int]:
        """Frame numbers, ascending."""
        return list(self.files)

    @property
    def version_note(self) -> str | None:
        """A sentence where the numbers may be versions of one picture; None elsewhere."""
        pattern = NamePattern(self.base, self.padding, self.suffix)
        if len(self.files) < 2 or not pattern.is_version:
            return None
        return (
            f"the numbers of {pattern} look like versions and are taken for frames; if they are "
            "versions of one picture, give the frames of one version instead"
        )

    def over(self, numbers: Iterable[int]) -> Sequence:
        """Return the sequence with just these frames; one that it lacks has the path it would."""
        pattern = NamePattern(self.base, self.padding, self.suffix)
        expected = {number: self.directory / pattern.name(number) for number in numbers}
        return replace(self, files={n: self.files.get(n, path) for n, path in expected.items()})


@dataclass(frozen=True)
class AovSet:
    """Sequences of one shot, one file per AOV and frame.

    Unreal dumps them so for ExtraNet; Redshift, V-Ray and Movie Render Queue write a sequence a
    pass, which :mod:`exwarp_cli.io.pass_sets` recognises by their names.

    Attributes
    ----------
    colour
        The colour sequence; None in a folder of G-buffers alone.
    aovs
        All other sequences by the name of their AOV, for example ``MotionVector``; with the frame
        numbers of the colour, or all with the same ones where there is no colour.
    motion
        Name of the AOV that leads where there is no colour.
    """

    colour: Sequence | None
    aovs: dict[str, Sequence]
    motion: str = MOTION_AOV

    @property
    def leader(self) -> Sequence:
        """The sequence that stands for the set: colour, else motion."""
        return self.colour or self.aovs[self.motion]

    @property
    def members(self) -> tuple[Sequence, ...]:
        """Every sequence of the set."""
        colour = () if self.colour is None else (self.colour,)
        return (*colour, *self.aovs.values())


@dataclass(frozen=True)
class OutputPattern:
    """Where output frames are written.

    Attributes
    ----------
    folder
        The folder, which may not exist yet.
    base, padding, suffix
        As in `Sequence`.
    """

    folder: Path
    base: str
    padding: int
    suffix: str

    @property
    def type(self) -> str:
        """Image suffix in lower case, for example ``.exr``."""
        return file_type(self.suffix)

    @property
    def name(self) -> str:
        """File name with one ``#`` per digit of padding."""
        return str(NamePattern(self.base, self.padding, self.suffix))

    def path(self, number: int) -> Path:
        """Path of the frame with this number."""
        return self.folder / NamePattern(self.base, self.padding, self.suffix).name(number)


def find_sequence(spec: str, suffixes: tuple[str, ...] = EXR, gaps: bool = False) -> Sequence:
    """Find the sequence that a user names.

    Parameters
    ----------
    spec
        A folder that holds one sequence, a pattern (``shot.####.exr``, ``@@@@``, ``%04d``, ``$F4``)
        or any one frame. In a folder with one file per AOV, the colour sequence is found, or the
        motion vectors where there is no colour.
    suffixes
        Accepted file suffixes, in lower case.
    gaps
        Whether frames that are missing in between are listed, too.

    Raises
    ------
    InputError
        When there is no such sequence, or several.
    """
    found = _found(spec, suffixes)
    return found.over(fill_gaps(found.files)) if gaps else found


def _found(spec: str, suffixes: tuple[str, ...]) -> Sequence:
    try:
        if spec and Path(spec).is_dir():
            found = _candidates(Path(spec), suffixes)
            leaders = [c.leader if isinstance(c, AovSet) else c for c in found]
            return _only(Path(spec), leaders, suffixes)
        return _named(spec, suffixes)
    except OSError as error:
        raise InputError(
            f"cannot look into {spec}: {error.strerror or error}; check the path and its rights"
        ) from error


def find_aov_set(
    spec: str,
    suffixes: tuple[str, ...] = EXR,
    gaps: bool = False,
    needed: Callable[[AovSet], Collection[str]] | None = None,
) -> AovSet | None:
    """Find the one-file-per-AOV set that a folder, pattern or frame belongs to.

    Parameters
    ----------
    spec, suffixes, gaps
        As `find_sequence` takes them.
    needed
        Returns which AOVs of a set are used; None for all.

    Returns
    -------
    AovSet or None
        None when `spec` names an ordinary sequence, or no AOV is needed.

    Raises
    ------
    InputError
        As `find_sequence` does.
    MissingFrameError
        When an AOV lacks a frame that the colour has (or any other AOV, without colour).
    """
    leader = find_sequence(spec, suffixes)
    found = [c for c in _candidates(leader.directory, suffixes) if isinstance(c, AovSet)]
    mine = [c for c in found if c.leader == leader] or [c for c in found if leader in c.members]
    if len(mine) > 1:
        raise InputError(
            f"{leader.pattern} is a pass of {len(mine)} sequences, "
            f"{_listing([c.leader for c in mine])}; name one of those"
        )
    if not mine:
        return None
    names = mine[0].aovs if needed is None else needed(mine[0])
    aovs = {name: member for name, member in mine[0].aovs.items() if name in names}
    return _complete(replace(mine[0], aovs=aovs), gaps) if aovs else None


def beside(sequence: Sequence) -> dict[str, Sequence]:
    """Return the sequences of a folder whose names begin as a sequence's does, by what follows."""
    stem = sequence.base.rstrip("._- ")
    found = {}
    for candidate in _candidates(sequence.directory, (sequence.suffix.lower(),)):
        for member in candidate.members if isinstance(candidate, AovSet) else (candidate,):
            name = member.base.rstrip("._- ")
            if stem and name != stem and name.startswith(stem) and member.suffix == sequence.suffix:
                found[name[len(stem) :].lstrip("._- ")] = member
    return found


def output_pattern(spec: str, source: Sequence, suffixes: tuple[str, ...] = EXR) -> OutputPattern:
    """Read the ``-o`` option: a pattern that ends in ``.exr`` or the like, or a folder.

    In a folder, frames have the base name, padding and suffix of the input.

    Parameters
    ----------
    spec
        What the user wrote. A name without frame token and image suffix, one that ends in a
        slash, or an existing folder is a folder.
    source
        The input sequence.
    suffixes
        That frames can be written with, in lower case.

    Raises
    ------
    UsageError
        When it names one file, or another format.
    OutputError
        When the frames would fall among those of the input.
    """
    if not spec:
        raise UsageError(
            "the output path is empty; name a folder or a pattern such as out.####.exr"
        )
    path = Path(spec)
    if spec.endswith(("/", os.sep)) or (is_there(path) and path.is_dir()):
        return _apart(OutputPattern(path, source.base, source.padding, source.suffix), source)
    pattern = NamePattern.parse(path.name)
    suffix = path.suffix.lower()
    if suffix not in suffixes and (suffix in _OTHER_MEDIA or pattern is not None):
        kind = "EXR" if source.type in EXR else "EXR or still images"
        raise UsageError(
            f"the output {spec} is not an EXR pattern, and ExWarp writes such frames as {kind} "
            f"only; name a folder or a pattern such as out.####{suffixes[0]}"
        )
    if pattern is not None:
        return _apart(
            OutputPattern(path.parent, pattern.base, pattern.padding, pattern.suffix), source
        )
    if suffix in suffixes:
        raise UsageError(
            f"the output {spec} is one file, and many frames are written; "
            f"put a frame token in it, such as {path.stem}.####{suffix}, or name a folder"
        )
    return _apart(OutputPattern(path, source.base, source.padding, source.suffix), source)


def _apart(target: OutputPattern, source: Sequence) -> OutputPattern:
    same_names = (target.base, target.suffix) == (source.base, source.suffix)
    if same_names and target.folder.resolve() == source.directory.resolve():
        raise OutputError(
            f"the output {target.folder / target.name} would mix new frames with those of the "
            "input and overwrite them; name another folder or another base name"
        )
    return target


def _candidates(folder: Path, suffixes: tuple[str, ...]) -> list[AovSet | Sequence]:
    """Sequences of a folder, those of one AOV set as one."""
    # Names that start with a dot are other programs' bookkeeping, such as macOS' "._" files.
    names = [name for name in _file_names(folder) if not name.startswith(".")]
    splits = split_names(names, suffixes)
    # Text after the number is read where no file has its number at the end.
    plain = {split for split in splits.values() if split.suffix.lower() in suffixes}
    kinds = plain or set(splits.values())
    stems = {replace(kind, padding=1) for kind in kinds}
    sequences = [s for stem in sorted(stems) for s in _sequences(folder, stem, names)]
    return _gather_aovs(sequences)


def _gather_aovs(sequences: list[Sequence]) -> list[AovSet | Sequence]:
    shots: dict[tuple[str, str, str], dict[str, Sequence]] = defaultdict(dict)
    for sequence in sequences:
        if match := _AOV.fullmatch(sequence.base):
            shot = (match["prefix"], match["end"], sequence.suffix)
            shots[shot].setdefault(match["aov"], sequence)
    sets = [s for members in shots.values() if len(members) > 1 and (s := _as_set(members))]
    taken = [member.pattern for s in sets for member in s.members]
    rest = [s for s in sequences if s.pattern not in taken]
    for found in pass_sets([(s.base, s.suffix) for s in rest]):
        colour = None if found.colour is None else rest[found.colour]
        aovs = {name: rest[index] for name, index in found.passes.items()}
        for name, index in found.more.items():
            if colour is not None and set(colour.files) <= set(rest[index].files):
                aovs.setdefault(name, rest[index])
        sets.append(AovSet(colour, aovs, found.motion))
        taken += [member.pattern for member in sets[-1].members]
    return [*sets, *(s for s in rest if s.pattern not in taken)]


def _as_set(members: dict[str, Sequence]) -> AovSet | None:
    colours = [name for name in COLOUR_AOVS if name in members]
    if not colours and MOTION_AOV not in members:
        return None
    others = {name: s for name, s in members.items() if name not in colours[:1]}
    return AovSet(members[colours[0]] if colours else None, others)


def _complete(found: AovSet, gaps: bool) -> AovSet:
    """Cut the AOVs to the colour's frames, and make sure that they have them all."""
    if found.colour is not None:
        wanted = set(found.colour.files)
    else:
        wanted = {number for sequence in found.aovs.values() for number in sequence.files}
    if gaps:
        every = fill_gaps(wanted)
        colour = None if found.colour is None else found.colour.over(every)
        aovs = {name: member.over(every) for name, member in found.aovs.items()}
        return replace(found, colour=colour, aovs=aovs)
    for name, sequence in found.aovs.items():
        if absent := sorted(wanted - set(sequence.files)):
            raise MissingFrameError(
                f"frame {ranges(absent)} of the AOV {name} is missing from {sequence.pattern}; "
                "render it, or move that frame's other files elsewhere"
            )
    aovs = {
        name: replace(s, files={n: path for n, path in s.files.items() if n in wanted})
        for name, s in found.aovs.items()
    }
    return replace(found, aovs=aovs)


def _named(spec: str, suffixes: tuple[str, ...]) -> Sequence:
    """Find the sequence of a pattern or of one frame."""
    path = _in_its_case(Path(spec))
    if path.is_file():
        return _around(path, suffixes)
    pattern = NamePattern.parse(path.name)
    if not path.parent.is_dir():
        raise InputError(f"the folder {path.parent} does not exist; check the path {spec!r}")
    if pattern is None:
        raise InputError(
            f"there is no file or folder {spec!r}; "
            "name a folder, a pattern such as shot.####.exr, or any one frame"
        )
    _require_suffix(path, suffixes)
    found = _sequences(path.parent, pattern, _file_names(path.parent))
    exact = [s for s in found if _all_printed(s, pattern)]
    if not exact and pattern.padding == 1 and len(found) == 1:
        return found[0]  # "#" and "%d" are often written for any padding; here only one fits
    if not exact:
        there = f"; there is {_listing(found)}" if found else ""
        raise InputError(f"no frame in {path.parent} matches {path.name}{there}; check the pattern")
    return replace(exact[0], padding=pattern.padding)


def _in_its_case(path: Path) -> Path:
    """Return a path with its name's suffix as files have it, where only one case of it is there."""
    if path.is_file() or not path.parent.is_dir():
        return path
    pattern = NamePattern.parse(path.name)
    ending = path.suffix if pattern is None else pattern.suffix
    start = path.name.removesuffix(ending) if pattern is None else pattern.base
    if not ending:
        return path
    there = [
        name[len(name) - len(ending) :]
        for name in _file_names(path.parent)
        if name.startswith(start) and name.lower().endswith(ending.lower())
    ]
    if len(set(there)) != 1 or there[0] == ending:
        return path
    return path.with_name(path.name.removesuffix(ending) + there[0])


def _around(frame: Path, suffixes: tuple[str, ...]) -> Sequence:
    _require_suffix(frame, suffixes)
    names = _file_names(frame.parent)
    stem = split_names(names, suffixes).get(frame.name)
    if stem is None:
        raise InputError(
            f"{frame} has no frame number before its suffix, so it is no frame of a sequence; "
            "name the frames like shot.0001.exr, or give a pattern such as shot.####_left.exr"
        )
    found = _sequences(frame.parent, stem, names)
    return next(s for s in found if frame.name in {path.name for path in s.files.values()})


def _only(folder: Path, found: list[Sequence], suffixes: tuple[str, ...]) -> Sequence:
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(
            f"{folder} holds {len(found)} sequences, {_listing(found)}; "
            f"name one of them, for example {found[0].pattern}"
        )
    single = next((n for n in sorted(_file_names(folder)) if n.lower().endswith(suffixes)), None)
    why = f"{single} has no frame number before its suffix" if single else "check the path"
    raise InputError(f"{folder} holds no sequence of {' or '.join(suffixes)} files; {why}")


def _require_suffix(path: Path, suffixes: tuple[str, ...]) -> None:
    if not path.name.lower().endswith(suffixes):
        raise InputError(
            f"{path} is not an {' or '.join(suffixes)} file, which is needed here; "
            "convert the frames, or check the path"
        )


def _sequences(folder: Path, stem: NamePattern, names: Iterable[str]) -> list[Sequence]:
    return [
        Sequence(
            folder,
            stem.base,
            padding,
            stem.suffix,
            {number: folder / name for number, name in files.items()},
        )
        for padding, files in group_names(stem, names)
    ]


def _all_printed(sequence: Sequence, pattern: NamePattern) -> bool:
    texts = (pattern.number_text(path.name) for path in sequence.files.values())
    return all(text is not None and is_printed(text, pattern.padding) for text in texts)


def _listing(found: list[Sequence], most: int = 6) -> str:
    named = [f"{Path(s.pattern).name} ({ranges(s.numbers)})" for s in found[:most]]
    rest = f" and {len(found) - most} more" if len(found) > most else ""
    return ", ".join(named) + rest


def _file_names(folder: Path) -> list[str]:
    with os.scandir(folder) as entries:
        return [entry.name for entry in entries if _is_file(entry)]


def _is_file(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_file()
    except OSError as error:
        if error.errno != errno.ELOOP:
            raise
        raise InputError(
            f"the link {entry.path} leads back to itself; remove it, or link it to a frame"
        ) from error
