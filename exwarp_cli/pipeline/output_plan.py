"""Where a run writes: its files and video, and which files in the way it may replace.

A resumed run may replace its own files alone. Own are: frames that ExWarp wrote by the run's
method, complete or damaged, whatever has changed since; and copies of key frames, of the source as
it is, or as it was when the frames around it were made. Everything else may be a person's work, and
is never replaced without --overwrite.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exwarp_cli.domain.results import FrameKind
from exwarp_cli.domain.settings import SRGB_VIEW, VIDEO_CODECS, UpsampleSettings
from exwarp_cli.domain.timeline import Slot, Timeline, ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.errors import OutputError, OutputExistsError, UsageError
from exwarp_cli.io import generated_frames, video_writer
from exwarp_cli.io.files import make_folder, output_error, path_exists, remove_leftovers
from exwarp_cli.io.footage import clip_rate, digest_frame, is_plain, make_video_look
from exwarp_cli.io.key_file import file_digest, possible_key_files
from exwarp_cli.io.sequences import EXR, FramePattern, Sequence, output_pattern
from exwarp_cli.io.stills import STILLS, require_writer
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.io.view_transform import ViewTransform, find_view_transform
from exwarp_cli.pipeline.fingerprint import Fingerprinter, digest_json, key_fingerprint
from exwarp_cli.pipeline.source import Source
from exwarp_cli.runtime import cores
from exwarp_cli.synthesis.methods import Method

if TYPE_CHECKING:
    from exwarp_cli.pipeline.rendered_frames import RenderedFrames

# How the comment of every written video begins.
BY_EXWARP = "ExWarp"

# Files that a refusal names, at most.
NAMED = 4

# Methods of the frames after the last key frame, where the run's method needs a next one.
FALLBACKS = ("s6", "hold")

# Seconds by which a key frame may be newer than the frames around it, as files are written side by
# side. It counts only where none of these names the key frame.
SLACK_S = 60.0

# Files that are read side by side, at most: each is in memory as a whole.
READERS = 4

# Bytes by which a frame rate in the headers of all parts may change a key frame's size.
HEADER_GROWTH = 4096


@dataclass(frozen=True)
class OutputPlan:
    """Where and how a run writes."""

    frames: FramePattern | None  # None where only a video is written
    holes: FramePattern | None  # of the hole masks
    video: Path | None
    compression: Any = None  # of generated frames, as OpenEXR takes it; None: the key frame's
    exposure: float = 0.0  # of the video, in stops
    resumes: bool = False  # whether good frames of an earlier run are kept
    overwrites: bool = False
    keeps_bytes: bool = False  # whether key frames are copied byte for byte, also at another rate
    codec: video_writer.Codec = video_writer.CODECS[VIDEO_CODECS[0]]  # of the video
    # Of the video and the report's pictures; None for the sRGB curve alone
    view: ViewTransform | None = None

    @classmethod
    def from_settings(
        cls, settings: UpsampleSettings, source: Sequence, compression: Any
    ) -> OutputPlan:
        """Read the output options.

        Raises UsageError when they name the same folder and pattern twice, or a video of an unknown
        kind, or a view transform for footage or of an unknown name; InstallationError when the
        video's codec or the view transform is not installed.
        """
        video_alone = is_clip(settings.output)
        if video_alone and settings.video is not None:
            raise UsageError("-o names a video already; leave --video out, or name a folder in -o")
        frames = None
        if not video_alone:  # EXR as EXR, others as EXR or stills of any kind
            types = (*STILLS, *EXR) if is_plain(source) else EXR
            frames = output_pattern(settings.output, source, types)
            if frames.type in STILLS:
                require_writer(frames.path(0))
            if frames.type in STILLS and settings.compression is not None:
                raise UsageError(
                    f"--compression is for EXR, and frames are written as {frames.type}; leave it "
                    "out, or name a pattern such as out.####.exr"
                )
        holes = None
        if settings.write_holes is not None:
            text = source.suffix[: -len(source.type)]
            holes = output_pattern(settings.write_holes, replace(source, suffix=text + EXR[0]))
            if holes == frames:
                raise UsageError(
                    "--write-holes and -o name the same files; give the masks a folder of their own"
                )
        named = settings.output if video_alone else settings.video
        video, codec = None if named is None else Path(named), cls.codec
        if video is not None:
            video_writer.require_container(video)
            codec = video_writer.find_codec(settings.video_codec, video)
            if video.resolve() in {path.resolve() for path in source.files.values()}:
                raise OutputError(f"the video {video} is the input itself; name another")
        view = find_view_transform(settings.view_transform, source)
        return cls(
            frames,
            holes,
            video,
            compression,
            settings.exposure,
            settings.skip_existing,
            settings.overwrite,
            settings.keep_bytes,
            codec,
            view,
        )

    def make_folders(self) -> None:
        """Make the folders, and clear what dead runs left there; raises OutputError."""
        for folder in self.folders:
            make_folder(folder)
            remove_leftovers(folder)

    @property
    def folders(self) -> tuple[Path, ...]:
        """The folders in which files are written."""
        folders = [pattern.folder for pattern in (self.frames, self.holes) if pattern is not None]
        if self.video is not None:
            folders.append(self.video.parent)
        return tuple(dict.fromkeys(folders))

    def check_conflicts(self, timeline: Timeline, slots: list[Slot]) -> None:
        """Refuse to overwrite, and touch nothing.

        Raises OutputExistsError when something is in the way and neither --overwrite nor
        --skip-existing was given; OutputError when a folder is where the video would be.
        """
        if self.overwrites and self.resumes:
            raise UsageError("--overwrite and --skip-existing contradict each other; give one")
        if self.video is not None and path_exists(self.video) and self.video.is_dir():
            raise output_error(self.video, IsADirectoryError(errno.EISDIR, ""))
        if self.overwrites or self.resumes:
            return
        numbers = [timeline.number(slot) for slot in slots]
        for pattern in (self.frames, self.holes):
            existing = [n for n in numbers if pattern is not None and path_exists(pattern.path(n))]
            if existing and pattern is not None:
                raise OutputExistsError(
                    f"{pattern.folder} has frame {ranges(existing)} of {pattern} already; "
                    "give --skip-existing to keep good ones, --overwrite to replace them, or "
                    "another -o"
                )
        if self.video is not None and path_exists(self.video):
            option = "--video" if self.frames is not None else "-o"
            raise OutputExistsError(
                f"{self.video} exists already; give --overwrite to replace it, or another {option}"
            )


def frame_suffix(output: str, source: Sequence) -> str:
    """Return the suffix of the frames that ``-o`` asks for: its own, else the input's."""
    suffix = Path(output).suffix
    is_folder = output.endswith(("/", os.sep)) or Path(output).is_dir()
    named = suffix.lower() in (*EXR, *STILLS) and not is_folder
    return suffix if named else source.suffix


def video_look(source: Source, keys: tuple[int, ...], note: str = "") -> video_writer.VideoLook:
    """Return what a video of some key intervals is like, with the input's sound if it has one.

    `keys` are indices of the key frames that are written. Sound goes along with those that lie side
    by side, as cut up it would be of no use; and where the rate is the input's own. `note` is what
    the video says of itself.
    """
    timeline = source.timeline
    first, last = keys[0], keys[-1]
    shown = timeline.slots_of(first) or (Slot(first, 0),)
    begin = first + timeline.time(shown[0])
    end = None if last == len(timeline.numbers) - 1 else Fraction(last + 1)
    own, apart = clip_rate(source.keys.sequence), None
    if last - first + 1 != len(keys):
        apart = "the key frames that are written do not follow each other"
    elif own is not None and source.fps != own:
        apart = f"--fps {float(source.fps):g} is not its own rate of {float(own):g}"
    return make_video_look(source.keys, begin, end, note, apart)


def video_fingerprint(
    fingerprinter: Fingerprinter,
    settings: UpsampleSettings,
    keys: tuple[int, ...],
    rendered: RenderedFrames | None = None,
) -> str:
    """Digest what a video depends on that is written alone; it keeps that as its comment.

    "" where it may lack something whose files are as they were: it is made again then.
    """
    if settings.source.keep_going:
        return ""
    source = fingerprinter.source
    count = len(source.timeline.numbers)
    instants: list[Slot] = []
    if source.slots is not None:
        instants = [slot for key in range(count) for slot in source.timeline.between(key)]
    facts: dict[str, Any] = {
        "frames": fingerprinter.fingerprints(keys[0], range(count), instants),
        # Needed as "frames" is empty where no frame is made after the first key frame.
        "key": key_fingerprint(source.keys, source.timeline.numbers[keys[0]]),
        "keys": list(keys),
        "exposure": settings.exposure,
        "tail": settings.source.tail,
        "cuts": repr(source.cuts),
    }
    if rendered is not None:
        sequence = rendered.sequence
        facts["rendered"] = [[n, digest_frame(sequence, n)] for n in sequence.numbers]
    look = video_look(source, keys)
    if look.pixel_aspect != 1 or look.primaries is not None:
        facts["look"] = [str(look.pixel_aspect), repr(look.primaries)]
    if settings.video_codec != VIDEO_CODECS[0]:
        facts["codec"] = settings.video_codec
    return video_note(settings, digest_json(facts))


def video_note(settings: UpsampleSettings, digest: str = "") -> str:
    """Return what a video says of itself: who wrote it, the digest, and how colour is shown."""
    note = f"{BY_EXWARP} {digest}".rstrip()
    if settings.view_transform == SRGB_VIEW:
        return note
    return f"{note}, view transform {settings.view_transform}"


def is_video_kept(targets: OutputPlan, settings: UpsampleSettings, note: str) -> bool:
    """Return True if a video that is written alone exists as this run would make it."""
    wanted = settings.skip_existing and settings.ground_truth is None
    if not (wanted and note) or targets.frames is not None or targets.video is None:
        return False
    return video_writer.read_video_note(targets.video) == note


def require_own(
    targets: OutputPlan,
    source: Source,
    method: Method,
    slots: list[Slot],
    rendered: Sequence | None = None,
) -> None:
    """Refuse to replace what the run's earlier parts did not write.

    `slots` are the output instants that the run writes. No other frame is looked at, but for those
    next to a key frame that was rendered again. `rendered` are frames that were rendered after all,
    by output number. Raises OutputExistsError when files are in the way that are not the run's own;
    UnreadableError when the system does not let one of them through.
    """
    ownership = _Ownership(targets, source, method, rendered)
    files: list[tuple[Path, Slot | None]] = []  # without a slot: hole masks
    for slot in slots:
        number = source.timeline.number(slot)
        if targets.frames is not None:
            files.append((targets.frames.path(number), slot))
        if targets.holes is not None and slot.index:
            files.append((targets.holes.path(number), None))
    with ThreadPoolExecutor(min(cores.count(), READERS), "exwarp-own") as pool:
        reasons = pool.map(lambda file: ownership.why_foreign(*file), files)
        foreign = [
            (path, reason)
            for (path, _), reason in zip(files, reasons, strict=True)
            if reason is not None
        ]
    video = targets.video
    if video is not None and path_exists(video) and video.stat().st_size:
        note = video_writer.read_video_note(video) or ""
        if not note.startswith(BY_EXWARP):
            foreign.append((video, "not written by ExWarp"))
    if not foreign:
        return
    listed = ", ".join(f"{path.name} ({reason})" for path, reason in foreign[:NAMED])
    more = f" and {len(foreign) - NAMED} more" if len(foreign) > NAMED else ""
    raise OutputExistsError(
        f"{foreign[0][0].parent} has {pluralise(len(foreign), 'file')} that this run did not "
        f"write: {listed}{more}; move what you want to keep, or give --overwrite to replace it"
    )


@dataclass(frozen=True)
class _Ownership:
    """Tells which files in the way of one run are not its own, and why."""

    targets: OutputPlan
    source: Source
    method: Method
    rendered: Sequence | None = None
    # What a file says of itself; None where there is none.
    _authorship: Callable[[Path], generated_frames.Authorship | None] = field(
        default_factory=lambda: cache(generated_frames.find_authorship), init=False, compare=False
    )

    def why_foreign(self, path: Path, slot: Slot | None) -> str | None:
        """Return why the file of a slot is not the run's own; None if it is, or there is none.

        Without a slot it is a hole mask.
        """
        if slot is None:
            return self._why_not_written(path)
        keys = self.source.keys.sequence
        copied_from = None  # where the run copies the frame
        if not slot.index:
            copied_from = keys.files[self.source.timeline.numbers[slot.key]]
        elif self.rendered is not None:
            copied_from = self.rendered.files.get(self.source.timeline.number(slot))
        if copied_from is not None and _is_copy(path, copied_from):
            return None
        reason = self._why_not_written(path)
        if reason is None:
            return None
        try:
            size = path.stat().st_size
            similar = (
                k for k, length in self._key_sizes.items() if abs(size - length) <= HEADER_GROWTH
            )
            is_own = any(_is_copy(path, key) for key in similar) or (
                not slot.index and self._was_key(path, slot)
            )
        except FileNotFoundError:  # another chunk has just replaced it
            return None
        return None if is_own else reason

    def _why_not_written(self, path: Path) -> str | None:
        """Return why a file is none that the run's method wrote, by what it says of itself."""
        authorship = self._authorship(path)
        if authorship is None:
            return None
        if authorship.state is generated_frames.FileState.FOREIGN:
            return "not written by ExWarp"
        if authorship.state is generated_frames.FileState.EDITED:
            return "changed since ExWarp wrote it"
        facts = authorship.facts
        if facts.get("kind") in (FrameKind.KEY.value, FrameKind.RENDERED.value):
            return None
        by = facts.get(generated_frames.REQUESTED_METHOD)
        if by is None:
            # Frames of earlier builds name only their own method; after the last key frame it may
            # be a fallback of the run's.
            by = facts.get("method")
            if by is None or (self.method.lookahead and by in FALLBACKS):
                return None
        return None if by == self.method.name else f"made by {by} and not by {self.method.name}"

    @cached_property
    def _key_sizes(self) -> dict[Path, int]:
        sizes: dict[Path, int] = {}
        for path in dict.fromkeys(self.source.keys.sequence.files.values()):
            try:
                sizes[path] = path.stat().st_size
            except OSError:  # missing, as --keep-going has it
                continue
        return sizes

    def _was_key(self, path: Path, slot: Slot) -> bool:
        """Return True if a file is the key frame as it was when the frames around it were made.

        Or the beginning of what the key frame is now.
        """
        number = self.source.timeline.numbers[slot.key]
        source = self.source.keys.sequence.files[number]
        if source.suffix.lower() != path.suffix.lower():
            return False  # key frames are decoded there, and carry a checksum
        try:
            beginning = path.read_bytes().rstrip(b"\0")  # zeros may follow it
        except OSError:
            beginning = None
        if beginning is not None and any(
            form.begins_with(beginning) for form in possible_key_files(source, path)
        ):
            return True
        timeline, frames = self.source.timeline, self.targets.frames
        assert frames is not None
        # Generated frames before and after the key frame that are as they were written, and the
        # digests of key frames by number that each names.
        around, named = [], []
        for index in (slot.key, slot.key - 1):
            for each in timeline.made_of(index) if index >= 0 else ():
                frame = frames.path(timeline.number(each))
                authorship = self._authorship(frame)
                if authorship is None or authorship.state is not generated_frames.FileState.INTACT:
                    continue
                around.append(frame)
                words = str(authorship.facts.get(generated_frames.KEY_FRAMES, "")).split(",")
                pairs = (word.partition(":") for word in words)
                named.append({int(n): sha for n, _, sha in pairs if n.lstrip("-").isdecimal()})
        digest = file_digest(path)
        if any(digest in keys.values() for keys in named):
            return True
        if any(number in keys for keys in named):
            return False
        # Earlier builds name none. Without a tail no frame is made of the last key frame, unless
        # the method looks ahead. It is as old as the frames around it.
        times = [frame.stat().st_mtime for frame in around]
        return bool(times) and path.stat().st_mtime <= max(times) + SLACK_S


def _is_copy(path: Path, source: Path) -> bool:
    """Return True if a file holds a key frame, as it is or with another rate in its header."""
    return any(form.is_at(path) for form in possible_key_files(source, path))
