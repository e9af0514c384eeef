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
from exwarp_cli.io import frame_names
from exwarp_cli.io.channels import Role
from exwarp_cli.io.files import path_exists
from exwarp_cli.io.frame_names import SEPARATORS, NamePattern, PassName, is_padded_to, split_pass

EXR = (".exr",)

# Names under which Unreal dumps colour, the most nearly scene-linear one first.
COLOUR_AOVS = ("PreTonemapHDRColor", "SceneColor", "FinalImage")
MOTION_AOV = "MotionVector"
GEOMETRY_AOVS = (
    "SceneDepth", "WorldNormal", "WorldPosition", "MyStencil",
    "BaseColor", "Roughness", "Metallic", "NoV",
)  # fmt: skip

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
MAX_LISTED = 6


@dataclass(frozen=True)
class FramePattern(NamePattern):
    """Frames in a folder, which need not exist."""

    folder: Path

    @property
    def type(self) -> str:
        """Image suffix in lower case, for example ``.exr``."""
        return frame_names.file_type(self.suffix)

    @property
    def pattern(self) -> str:
        """Path with one ``#`` per digit of padding."""
        return str(self.folder / str(self))

    def path(self, number: int) -> Path:
        """Return the path of the frame with this number."""
        return self.folder / self.name(number)


@dataclass(frozen=True)
class Sequence(FramePattern):
    """Files of one folder that differ in their frame number alone."""

    files: dict[int, Path]  # by frame number, ascending

    @property
    def numbers(self) -> list[int]:
        """Frame numbers, ascending."""
        return list(self.files)

    @property
    def version_note(self) -> str | None:
        """A sentence where the numbers may be versions of one picture; None elsewhere."""
        if len(self.files) < 2 or not frame_names.VERSION.fullmatch(self.base):
            return None
        return (
            f"the numbers of {self} look like versions and are taken for frames; if they are "
            "versions of one picture, give the frames of one version instead"
        )

    def over(self, numbers: Iterable[int]) -> Sequence:
        """Return the sequence with just these frames; missing ones get the path they would have."""
        return replace(self, files={n: self.files.get(n, self.path(n)) for n in numbers})


@dataclass(frozen=True)
class AovSet:
    """Sequences of one shot, one file per AOV and frame; an ordinary sequence is colour alone.

    Unreal dumps them so for ExtraNet; Redshift, V-Ray and Movie Render Queue write a sequence a
    pass, see :mod:`exwarp_cli.io.frame_names`.
    """

    # What stands for the set: the colour, or one of `aovs` in a folder of G-buffers alone.
    leader: Sequence
    # By the name of the AOV, for example "MotionVector".
    aovs: dict[str, Sequence]

    @property
    def colour(self) -> Sequence | None:
        """The sequence that has the colour; None in a folder of G-buffers alone."""
        return None if self.leader in self.aovs.values() else self.leader

    @property
    def members(self) -> tuple[Sequence, ...]:
        """Every sequence of the set."""
        return (self.leader, *self.aovs.values())


def find_sequence(spec: str, suffixes: tuple[str, ...] = EXR, gaps: bool = False) -> Sequence:
    """Find the sequence that a user names; with `gaps`, list missing frames in between, too.

    `spec` is a folder that holds one sequence, a pattern (``shot.####.exr``, ``@@@@``, ``%04d``,
    ``$F4``) or any one frame. In a folder with one file per AOV, the colour sequence is found, or
    the motion vectors if there is no colour. `suffixes` are in lower case.

    Raises InputError if there is no such sequence, or several.
    """
    folder = Path(spec)
    try:
        if not spec or not folder.is_dir():
            leaders = [_find_by_name(spec, suffixes)]
        else:
            leaders = [c.leader for c in _list_candidates(folder, suffixes)]
        if not leaders:
            names = (n for n in sorted(_file_names(folder)) if n.lower().endswith(suffixes))
            single = next(names, None)
            why = f"{single} has no frame number before its suffix" if single else "check the path"
            raise InputError(f"{folder} holds no sequence of {' or '.join(suffixes)} files; {why}")
    except OSError as error:
        raise InputError(
            f"cannot look into {spec}: {error.strerror or error}; check the path and its rights"
        ) from error
    if len(leaders) > 1:
        raise InputError(
            f"{folder} holds {len(leaders)} sequences, {_listing(leaders)}; "
            f"name one of them, for example {leaders[0].pattern}"
        )
    (sequence,) = leaders
    return sequence.over(fill_gaps(sequence.files)) if gaps else sequence


def find_aov_set(
    spec: str, gaps: bool = False, needed: Callable[[AovSet], Collection[str]] | None = None
) -> AovSet:
    """Find the one-file-per-AOV set that a folder, pattern or frame belongs to.

    `needed` returns the AOVs of a set that are used; the others are left out. The sequences have
    the colour's frames, or all frames that any has if there is no colour. If `spec` names an
    ordinary sequence, or no AOV is needed, there is this sequence alone.

    Raises InputError as `find_sequence`, MissingFrameError if an AOV lacks a frame.
    """
    leader = find_sequence(spec)
    sets = [c for c in _list_candidates(leader.folder, EXR) if c.aovs]
    sets = [c for c in sets if c.leader == leader] or [c for c in sets if leader in c.members]
    if len(sets) > 1:
        raise InputError(
            f"{leader.pattern} is a pass of {len(sets)} sequences, "
            f"{_listing([c.leader for c in sets])}; name one of those"
        )
    aov_set = sets[0] if sets else AovSet(leader, {})
    names = needed(aov_set) if sets and needed is not None else aov_set.aovs
    aovs = {name: member for name, member in aov_set.aovs.items() if name in names}
    aov_set = AovSet(aov_set.leader if aovs else leader, aovs)
    leading = aovs.values() if aov_set.colour is None else (aov_set.leader,)
    numbers = sorted({number for sequence in leading for number in sequence.files})
    if gaps:
        numbers = list(fill_gaps(numbers))
    for name, member in aovs.items():
        if not gaps and (absent := sorted(set(numbers).difference(member.files))):
            raise MissingFrameError(
                f"frame {ranges(absent)} of the AOV {name} is missing from {member.pattern}; "
                "render it, or move that frame's other files elsewhere"
            )
    aovs = {name: member.over(numbers) for name, member in aovs.items()}
    return AovSet(aov_set.leader.over(numbers), aovs)


def neighbouring_sequences(sequence: Sequence) -> dict[str, Sequence]:
    """Return a folder's sequences whose names begin as one's, by the rest of their names."""
    stem = sequence.base.rstrip(SEPARATORS)
    neighbours = {}
    for candidate in _list_candidates(sequence.folder, (sequence.suffix.lower(),)):
        for member in candidate.members:
            name = member.base.rstrip(SEPARATORS)
            if stem and name != stem and name.startswith(stem) and member.suffix == sequence.suffix:
                neighbours[name[len(stem) :].lstrip(SEPARATORS)] = member
    return neighbours


def output_pattern(spec: str, source: Sequence, suffixes: tuple[str, ...] = EXR) -> FramePattern:
    """Read the ``-o`` option: a pattern that ends in one of `suffixes`, or a folder.

    A name without frame token and image suffix, one that ends in a slash, and an existing folder
    are folders. In a folder, frames have the base name, padding and suffix of the input.

    Raises UsageError if it names one file or another format, OutputError if the frames would fall
    among those of the input.
    """
    if not spec:
        raise UsageError(
            "the output path is empty; name a folder or a pattern such as out.####.exr"
        )
    path = Path(spec)
    target = FramePattern(source.base, source.padding, source.suffix, path)
    if not (spec.endswith(("/", os.sep)) or (path_exists(path) and path.is_dir())):
        pattern = NamePattern.parse(path.name)
        suffix = path.suffix.lower()
        if suffix not in suffixes and (suffix in _OTHER_MEDIA or pattern is not None):
            kind = "EXR" if source.type in EXR else "EXR or still images"
            raise UsageError(
                f"the output {spec} is not an EXR pattern, and ExWarp writes such frames as {kind} "
                f"only; name a folder or a pattern such as out.####{suffixes[0]}"
            )
        if pattern is not None:
            target = FramePattern(pattern.base, pattern.padding, pattern.suffix, path.parent)
        elif suffix in suffixes:
            raise UsageError(
                f"the output {spec} is one file, and many frames are written; "
                f"put a frame token in it, such as {path.stem}.####{suffix}, or name a folder"
            )
    same_names = (target.base, target.suffix) == (source.base, source.suffix)
    if same_names and target.folder.resolve() == source.folder.resolve():
        raise OutputError(
            f"the output {target.pattern} would mix new frames with those of the "
            "input and overwrite them; name another folder or another base name"
        )
    return target


def _list_candidates(folder: Path, suffixes: tuple[str, ...]) -> list[AovSet]:
    """Return the sequences of a folder, those of one shot as one set."""
    # Names that start with a dot are other programs' bookkeeping, such as macOS' "._" files.
    names = [name for name in _file_names(folder) if not name.startswith(".")]
    patterns = set(frame_names.split_names(names, suffixes).values())
    # Text after the number is read where no file has its number at the end.
    plain = {pattern for pattern in patterns if pattern.suffix.lower() in suffixes}
    stems = {replace(pattern, padding=1) for pattern in plain or patterns}
    sequences = [s for stem in sorted(stems) for s in _group_files(folder, stem, names)]
    # Unreal's names of AOVs, by shot; they are a set if there is colour or motion.
    shots: dict[tuple[str, str, str], dict[str, Sequence]] = defaultdict(dict)
    for sequence in sequences:
        if match := _AOV.fullmatch(sequence.base):
            shot = (match["prefix"], match["end"], sequence.suffix)
            shots[shot].setdefault(match["aov"], sequence)
    sets = []
    for aovs in shots.values():
        colours = [name for name in COLOUR_AOVS if name in aovs]
        if len(aovs) > 1 and (colours or MOTION_AOV in aovs):
            leader = aovs.pop(colours[0]) if colours else aovs[MOTION_AOV]
            sets.append(AovSet(leader, aovs))
    members = [member.pattern for s in sets for member in s.members]
    remaining = [s for s in sequences if s.pattern not in members]
    pass_sets = _find_pass_sets(remaining)
    members += [member.pattern for s in pass_sets for member in s.members]
    alone = (AovSet(s, {}) for s in remaining if s.pattern not in members)
    return [*sets, *pass_sets, *alone]


def _find_pass_sets(sequences: list[Sequence]) -> list[AovSet]:
    """Find the sequences of a folder that belong together as passes.

    There is a set for each beauty that has passes, and for each shot without a beauty that has
    vectors and another pass. A pass that fits two beauties equally well is in the sets of both.
    """
    sets = []
    for suffix in dict.fromkeys(sequence.suffix for sequence in sequences):
        split = {i: split_pass(s.base) for i, s in enumerate(sequences) if s.suffix == suffix}
        data = {i: name for i, name in split.items() if name.is_data}
        beauties = {i: name for i, name in split.items() if i not in data}
        passes: dict[int, dict[str, Sequence]] = defaultdict(dict)
        without_beauty: dict[str, list[int]] = defaultdict(list)
        for index, name in data.items():
            pass_names = _beauties_of(name, beauties)
            for beauty, pass_name in pass_names.items():
                passes[beauty][pass_name] = sequences[index]
            if not pass_names:
                without_beauty[name.shot].append(index)
        for index, aovs in passes.items():
            colour, shot = sequences[index], beauties[index].shot
            # These may be further passes: their names begin as the shot's, and are not known.
            more = {
                name.stem[len(shot) :].lstrip(SEPARATORS): sequences[i]
                for i, name in beauties.items()
                if i not in passes and name.role is None and name.extends(shot)
            }
            for pass_name, sequence in more.items():
                if set(colour.files) <= set(sequence.files):
                    aovs.setdefault(pass_name, sequence)
            sets.append(AovSet(colour, aovs))
        for indices in without_beauty.values():
            aovs = {split[i].name: sequences[i] for i in indices}
            motion = [split[i].name for i in indices if split[i].role is Role.MOTION]
            if motion and len(indices) > 1:
                sets.append(AovSet(aovs[motion[0]], aovs))
    return sets


def _beauties_of(name: PassName, beauties: dict[int, PassName]) -> dict[int, str]:
    """Return the beauties that a pass belongs to, with its name as a pass of each.

    Several only where they share the longest name of a shot.
    """
    fitting: dict[int, tuple[int, str]] = {}
    for index, beauty in beauties.items():
        if beauty.role is Role.COLOUR and beauty.shot == name.shot:
            fitting[index] = (len(beauty.shot), name.name)
        elif name.extends(beauty.stem):
            # FinalImage and FinalImageMovieRenderQueue_WorldDepth are of one shot too.
            shot = beauty.shot if beauty.role is Role.COLOUR else beauty.stem
            fitting[index] = (len(shot), name.stem[len(beauty.stem) :].lstrip(SEPARATORS))
    longest = max((length for length, _ in fitting.values()), default=0)
    return {index: pass_name for index, (length, pass_name) in fitting.items() if length == longest}


def _find_by_name(spec: str, suffixes: tuple[str, ...]) -> Sequence:
    """Find the sequence of a pattern or of one frame."""
    path = Path(spec)
    pattern, is_frame = NamePattern.parse(path.name), path.is_file()
    if not is_frame and not path.parent.is_dir():
        raise InputError(f"the folder {path.parent} does not exist; check the path {spec!r}")
    names = _file_names(path.parent)
    if not is_frame and spec:
        # The suffix in the case that files have, if they all have the same.
        ending = path.suffix if pattern is None else pattern.suffix
        start = path.name.removesuffix(ending) if pattern is None else pattern.base
        endings = {
            name[len(name) - len(ending) :]
            for name in names
            if name.startswith(start) and name.lower().endswith(ending.lower())
        }
        if len(endings) == 1:
            path = path.with_name(path.name.removesuffix(ending) + endings.pop())
            pattern, is_frame = NamePattern.parse(path.name), path.is_file()
    if not is_frame and pattern is None:
        raise InputError(
            f"there is no file or folder {spec!r}; "
            "name a folder, a pattern such as shot.####.exr, or any one frame"
        )
    if not path.name.lower().endswith(suffixes):
        raise InputError(
            f"{path} is not an {' or '.join(suffixes)} file, which is needed here; "
            "convert the frames, or check the path"
        )
    if is_frame or pattern is None:
        stem = frame_names.split_names(names, suffixes).get(path.name)
        if stem is None:
            raise InputError(
                f"{path} has no frame number before its suffix, so it is no frame of a sequence; "
                "name the frames like shot.0001.exr, or give a pattern such as shot.####_left.exr"
            )
        sequences = _group_files(path.parent, stem, names)
        return next(s for s in sequences if path.name in {file.name for file in s.files.values()})
    sequences = _group_files(path.parent, pattern, names)
    exact = []
    for sequence in sequences:
        texts = (pattern.number_text(file.name) for file in sequence.files.values())
        if all(text is not None and is_padded_to(text, pattern.padding) for text in texts):
            exact.append(sequence)
    if not exact and pattern.padding == 1 and len(sequences) == 1:
        return sequences[0]  # "#" and "%d" are often written for any padding; here only one fits
    if not exact:
        others = f"; there is {_listing(sequences)}" if sequences else ""
        raise InputError(
            f"no frame in {path.parent} matches {path.name}{others}; check the pattern"
        )
    return replace(exact[0], padding=pattern.padding)


def _group_files(folder: Path, stem: NamePattern, names: Iterable[str]) -> list[Sequence]:
    sequences = []
    for padding, files in frame_names.group_names(stem, names):
        paths = {number: folder / name for number, name in files.items()}
        sequences.append(Sequence(stem.base, padding, stem.suffix, folder, paths))
    return sequences


def _listing(sequences: list[Sequence]) -> str:
    shown = [f"{Path(s.pattern).name} ({ranges(s.numbers)})" for s in sequences[:MAX_LISTED]]
    more = len(sequences) - MAX_LISTED
    return ", ".join(shown) + (f" and {more} more" if more > 0 else "")


def _file_names(folder: Path) -> list[str]:
    names = []
    with os.scandir(folder) as entries:
        for entry in entries:
            try:
                if entry.is_file():
                    names.append(entry.name)
            except OSError as error:
                if error.errno != errno.ELOOP:
                    raise
                raise InputError(
                    f"the link {entry.path} leads back to itself; remove it, or link it to a frame"
                ) from error
    return names
