"""Writes the frames of a run: files, behind the work, and a video; and verifies them at the end."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import Bool, Image, Window
from exwarp_cli.domain.results import FrameKind, FrameRecord, WrittenFile
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.errors import InputError, OutputError
from exwarp_cli.io.display_colour import to_display, to_display_16
from exwarp_cli.io.exr.writer import PREFIX, Buffer, Plane, PlaneKey
from exwarp_cli.io.files import ResourceOwner, output_error, path_exists
from exwarp_cli.io.generated_frames import (
    FrameTemplate,
    read_fingerprint,
    read_picture,
    write_mask,
    write_picture,
)
from exwarp_cli.io.key_file import open_key_file, plan_key_file
from exwarp_cli.io.sequences import EXR
from exwarp_cli.io.video_reader import open_clip
from exwarp_cli.io.video_writer import VideoLook, VideoWriter
from exwarp_cli.io.view_transform import DisplayLook
from exwarp_cli.pipeline.output_plan import OutputPlan
from exwarp_cli.pipeline.scheduling import AsyncWriter, record_time
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.stop import check_stop

# Frames that may wait for a thread to write them, beyond those under way.
FRAMES_BEHIND = 4

FRAME, HOLES, VIDEO = "frame", "holes", "video"  # kinds of written files

# SHA-256 of written files, by kind and number of the frame; of a video there is none.
Sums = dict[tuple[str, int | None], str]


@dataclass
class FrameWriter(ResourceOwner):
    """Writes the frames of a run, in order; a context manager."""

    output: OutputPlan
    display: Window  # that the video and the hole masks show
    fps: Fraction  # of the video
    key_rate: Fraction | None  # what headers of key frames get; None: they are copied as they are
    view: str  # which view of written frames is read again; "" for the hero
    behind: int  # frames that may wait for a thread to write them, beyond those under way
    look: VideoLook  # of the video: colour, pixels and sound
    wants_sums: bool  # whether checksums of files are wanted
    # Milliseconds that writing took, by the frame's number; complete at the end.
    write_ms: dict[int, float] = field(default_factory=dict)
    # Checksums of what is written, where they are wanted; complete at the end.
    sums: Sums = field(default_factory=dict)
    remarks: tuple[str, ...] = ()  # what a user has to know of the video, once it is open
    _video: VideoWriter | None = None
    _last_shown: np.ndarray | None = None  # by the video

    def _open(self, stack: ExitStack) -> None:
        threads = cores.count()
        self._writer = stack.enter_context(AsyncWriter(threads, self.behind + threads))
        self.display_look = DisplayLook(self.look.primaries, self.output.view)
        if self.output.video is not None:
            # To what the video's codec takes
            self._encode = to_display_16 if self.output.codec.is_deep else to_display
            height, width = self.display.shape
            video = VideoWriter(
                self.output.video, width, height, self.fps, self.look, self.output.codec
            )
            self._video = stack.enter_context(video)
            self.remarks = video.remarks

    def name(self, number: int) -> str:
        """Return the name of a frame's file, or of the video without files, without its folder."""
        frames = self.output.frames
        path = self.output.video if frames is None else frames.path(number)
        assert path is not None
        return path.name

    def has(self, number: int, recipe: str, masked: bool = True) -> bool:
        """Return True if an earlier run wrote a frame's files as this one would, and they are kept.

        Frames that are not `masked` have no hole mask.
        """
        if not self.output.resumes or self.output.frames is None:
            return False
        patterns = (self.output.frames, self.output.holes if masked else None)
        paths = [pattern.path(number) for pattern in patterns if pattern is not None]
        return all(path.exists() and read_fingerprint(path) == recipe for path in paths)

    def copies(self, source: Path) -> bool:
        """Return True if a key frame's file is copied, not decoded and encoded."""
        frames = self.output.frames
        return frames is not None and frames.type == source.suffix.lower()

    def has_copy(self, number: int, source: Path) -> bool:
        """Return True if an earlier run copied a key frame's file, and it is kept."""
        if not self.output.resumes:
            return False
        return plan_key_file(source, self.key_rate).is_at(self.path(number))

    def is_in_the_way(self, number: int) -> bool:
        """Return True if a frame's file from before the run exists, which writing would replace."""
        # A run that may replace none began without any: what exists now is its own, as after the
        # loss of a worker.
        may_replace = self.output.overwrites or self.output.resumes
        frames = self.output.frames
        return may_replace and frames is not None and path_exists(frames.path(number))

    def has_rendered(self, number: int, source: Path, recipe: str) -> bool:
        """Return True if an earlier run wrote a rendered frame of a slot, and it is kept."""
        if self.copies(source) and not self._is_marked(source):
            return self.has_copy(number, source)
        return self.has(number, recipe, masked=False)

    def pass_frame(
        self, number: int, source: Path, marks: Mapping[str, str | int] | None = None
    ) -> None:
        """Copy the file of a rendered frame, all its layers and attributes but for the frame rate.

        If it is EXR and key frames get a rate, it gets ExWarp's own attributes, too: `marks`.
        """
        copy = partial(self._copy, number, source, marks if self._is_marked(source) else None)
        if self.output.resumes and self.is_in_the_way(number):
            # At once. The frames around a key frame name its digest, by which a later run knows a
            # copy of an earlier render. If they are replaced first and the run is killed, none
            # names that copy.
            copy()
        else:
            self._writer.submit(copy)

    def _is_marked(self, source: Path) -> bool:
        """Return True if a rendered frame's header gets ExWarp's own attributes."""
        return source.suffix.lower() in EXR and not self.output.keeps_bytes

    def write(
        self,
        number: int,
        image: Image,
        template: FrameTemplate,
        attributes: Mapping[str, Any],
        mask: Bool | None = None,
        layers: Mapping[PlaneKey, Plane] | None = None,
        inline: bool = False,
    ) -> None:
        """Write a frame that is not copied, and its hole mask if masks are written and it has one.

        `mask` is bool [H, W] on the display window; `template`, `attributes` and `layers` are as
        for `io.generated_frames.write_picture`. With `inline` this thread writes, and does not
        return before; any thread may.
        """
        put = partial(self._put, number, image, template, attributes, mask, layers)
        if inline:
            put()
        else:
            self._writer.submit(put)

    def show(self, image: Image | None) -> None:
        """Append a frame to the video, if there is one.

        None repeats the last one, or appends a black one, to keep sound in step.
        """
        if self._video is None:
            return
        shown = self._last_shown
        if image is not None:
            pixels = self.display_look.apply(image.on(self.display).pixels, self.output.exposure)
            shown = self._last_shown = self._encode(pixels)
        elif shown is None:
            shown = self._encode(np.zeros((*self.display.shape, 3), np.float32))
        self._video.write(shown)

    def read(self, number: int) -> Image:
        """Read a frame that an earlier run wrote."""
        return read_picture(self.path(number), self.view)

    def path(self, number: int) -> Path:
        """Return where a frame's file is, where there are files."""
        assert self.output.frames is not None
        return self.output.frames.path(number)

    def _copy(self, number: int, source: Path, marks: Mapping[str, str | int] | None) -> None:
        opened = open_key_file(source, self.key_rate, marks)
        with record_time(self.write_ms, number), opened as file:
            file.write(self.path(number))
            if self.wants_sums:  # of what the source gives
                self.sums[FRAME, number] = sum_of(file.pieces())

    def _put(
        self,
        number: int,
        image: Image,
        template: FrameTemplate,
        attributes: Mapping[str, Any],
        mask: Bool | None,
        layers: Mapping[PlaneKey, Plane] | None,
    ) -> None:
        if self.output.frames is not None:
            with record_time(self.write_ms, number):
                pieces = write_picture(self.path(number), image, template, attributes, layers)
                if self.wants_sums:  # of what is in memory
                    self.sums[FRAME, number] = sum_of(pieces)
        if self.output.holes is not None and mask is not None:
            marks = {k: v for k, v in attributes.items() if k.startswith(PREFIX)}
            windows = (self.display, self.display)
            pieces = write_mask(self.output.holes.path(number), mask, windows, marks)
            if self.wants_sums:
                self.sums[HOLES, number] = sum_of(pieces)


def sum_of(pieces: Iterable[Buffer]) -> str:
    """Return the SHA-256 of a file in pieces, hexadecimal."""
    digest = hashlib.sha256()
    for piece in pieces:
        digest.update(piece)
    return digest.hexdigest()


def sum_in(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal; raises OutputError when it cannot be read."""
    check_stop()
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise output_error(path, error) from error


@dataclass(frozen=True)
class RunFile:
    """A file of a run, and what has to be in it."""

    written: WrittenFile
    path: Path
    is_sealed: bool = False  # True for a frame of an earlier run, which has its own checksum

    def is_sound(self, view: str, shown: int) -> bool:
        """Read the file from the disk, and compare it; see `require_sound`."""
        try:
            drop_cached(self.path)
            if sum_in(self.path) != self.written.sha256:
                return False
            if self.written.kind == VIDEO:
                return open_clip(self.path).count == shown
            if self.is_sealed:
                read_picture(self.path, view)
                return read_fingerprint(self.path) is not None
        except (OSError, InputError, OutputError):
            return False
        return True


def list_files(targets: OutputPlan, frames: Iterable[FrameRecord], sums: Sums) -> list[RunFile]:
    """List the files of a run; those without a known checksum are read.

    A video with frames is left out: it can be made from these at any time. Raises OutputError when
    a file cannot be read.
    """
    files: list[tuple[str, int | None, Path, bool]] = []
    for frame in frames:
        is_copy = frame.kind in (FrameKind.KEY, FrameKind.RENDERED)  # maybe byte for byte
        if targets.frames is not None:
            is_sealed = frame.resumed and not is_copy
            files.append((FRAME, frame.number, targets.frames.path(frame.number), is_sealed))
        if targets.holes is not None and frame.hole_fraction is not None:
            files.append((HOLES, frame.number, targets.holes.path(frame.number), False))
    if targets.frames is None and targets.video is not None:
        files.append((VIDEO, None, targets.video, False))
    return [
        RunFile(
            WrittenFile(kind, number, path.name, sums.get((kind, number)) or sum_in(path)),
            path,
            is_sealed,
        )
        for kind, number, path, is_sealed in files
    ]


def verify_video(path: Path, shown: int) -> None:
    """Read a video of `shown` frames again that was written with frames. Raises OutputError."""
    require_sound([RunFile(WrittenFile(VIDEO, None, path.name, sum_in(path)), path)], "", shown)


def drop_cached(path: Path) -> None:
    """Have the system drop its copy of a file in memory, if it can."""
    if not hasattr(os, "posix_fadvise"):
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.posix_fadvise(handle, 0, 0, os.POSIX_FADV_DONTNEED)
    finally:
        os.close(handle)


def require_sound(files: list[RunFile], view: str, shown: int) -> None:
    """Read files again, and compare them with what was written.

    `view` is that of frames of an earlier run, which is decoded: "" for the hero, and without
    views. `shown` is how many frames a video has. Raises OutputError when some files differ; these
    are removed.
    """
    with ThreadPoolExecutor(cores.count(), "exwarp-verify") as pool:
        sound = list(pool.map(lambda file: file.is_sound(view, shown), files))
    bad = [file for file, is_sound in zip(files, sound, strict=True) if not is_sound]
    if not bad:
        return
    for file in bad:
        with suppress(OSError):
            file.path.unlink()
    names = []
    for kind, word in ((FRAME, "frame"), (HOLES, "hole mask")):
        written = [file.written for file in bad if file.written.kind == kind]
        numbers = [each.frame for each in written if each.frame is not None]
        if numbers:
            names.append(f"{word}{'s' if len(numbers) > 1 else ''} {ranges(numbers)}")
    names += [f"the video {file.path.name}" for file in bad if file.written.kind == VIDEO]
    raise OutputError(
        f"{' and '.join(names)} in {bad[0].path.parent} {'is' if len(bad) == 1 else 'are'} not on "
        "the disk as written, and removed; check the disk or the network share, and run again with "
        "--skip-existing"
    )
