"""Writes the frames of a run: files, behind the work, and a video."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, Image, Window
from exwarp_cli.domain.timeline import OutputRate
from exwarp_cli.io.display_colour import DisplayLook, to_display, to_display_16
from exwarp_cli.io.exr.template import PREFIX, Plane, PlaneKey
from exwarp_cli.io.exr.writer import Buffer
from exwarp_cli.io.files import ResourceOwner, path_exists
from exwarp_cli.io.generated_frames import (
    FrameTemplate,
    read_facts,
    read_picture,
    write_mask,
    write_picture,
)
from exwarp_cli.io.key_file import open_key_file, plan_key_file, plan_marked_file
from exwarp_cli.io.sequences import EXR
from exwarp_cli.io.video_writer import VideoLook, VideoWriter
from exwarp_cli.pipeline.output_plan import OutputPlan, key_is_there, slot_is_there
from exwarp_cli.pipeline.scheduling import AsyncWriter, record_time
from exwarp_cli.pipeline.verification import FRAME, HOLES, Sums, sum_of
from exwarp_cli.runtime import cores

# Frames that may wait for a thread to write them, beyond those under way.
FRAMES_BEHIND = 4


class FrameWriter(ResourceOwner):
    """Writes the frames of a run, in order; a context manager."""

    def __init__(
        self,
        output: OutputPlan,
        display: Window,  # that the video and the hole masks show
        rate: OutputRate,  # of the video, and what headers of key frames get
        view: str = "",  # which view of written frames is read again; "" for the hero
        behind: int = FRAMES_BEHIND,
        look: VideoLook | None = None,  # of the video: colour, pixels and sound
        sums: bool = False,  # whether checksums of files are wanted
        skips: bool = False,  # whether the video shows a frame again in the place of skipped ones
    ) -> None:
        self._output = output
        self._display = display
        self._fps = rate.fps
        self._key_rate = None if output.keeps_bytes else rate.written
        self._view = view
        self._behind = behind
        self._look = look or VideoLook()
        self._wants_sums = sums
        self._skips = skips
        # To what the video's codec takes
        self._encode = to_display_16 if output.codec.is_deep else to_display
        self._video: VideoWriter | None = None
        self._last_shown: np.ndarray | None = None  # by the video
        self._replaced_early: set[int] = set()
        # Milliseconds that writing took, by the frame's number; complete at the end.
        self.write_ms: dict[int, float] = {}
        # Checksums of what is written, where they are wanted; complete at the end.
        self.sums: Sums = {}

    def _open(self, stack: ExitStack) -> None:
        threads = cores.count()
        self._writer = stack.enter_context(AsyncWriter(threads, self._behind + threads))
        if self._output.video is not None:
            height, width = self._display.shape
            video = VideoWriter(
                self._output.video, width, height, self._fps, self._look, self._output.codec
            )
            self._video = stack.enter_context(video)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a user has to know of the video; see `VideoWriter.remarks`."""
        return () if self._video is None else self._video.remarks

    @property
    def shows(self) -> bool:
        """True if every frame has to be shown, for a video."""
        return self._video is not None

    @property
    def keeps_frames(self) -> bool:
        """True if frames become files, and not a video alone."""
        return self._output.frames is not None

    def name(self, number: int) -> str:
        """Return the name of a frame's file, or of the video without files, without its folder."""
        frames, video = self._output.frames, self._output.video
        if frames is None:
            assert video is not None
            return video.name
        return frames.path(number).name

    def has(self, number: int, recipe: str, masked: bool = True) -> bool:
        """Return True if an earlier run wrote a frame's files as this one would, and they are kept.

        Frames that are not `masked` have no hole mask.
        """
        if not self._output.resumes or self._output.frames is None:
            return False
        patterns = [self._output.frames]
        if self._output.holes is not None and masked:
            patterns.append(self._output.holes)
        return all(slot_is_there(pattern.path(number), recipe) for pattern in patterns)

    def copies(self, source: Path) -> bool:
        """Return True if a key frame's file is copied, not decoded and encoded."""
        frames = self._output.frames
        return frames is not None and frames.type == source.suffix.lower()

    def has_copy(self, number: int, source: Path) -> bool:
        """Return True if an earlier run copied a key frame's file, and it is kept."""
        if not self._output.resumes:
            return False
        return key_is_there(self._path(number), plan_key_file(source, self._key_rate))

    def is_in_the_way(self, number: int) -> bool:
        """Return True if a frame's file from before the run exists, which writing would replace."""
        # A run that may replace none began without any: what exists now is its own, as after the
        # loss of a worker.
        may_replace = self._output.overwrites or self._output.resumes
        return may_replace and self.keeps_frames and path_exists(self._path(number))

    def replace_key(self, number: int, source: Path) -> None:
        """Replace an earlier copy of a key frame at once, if it is another than the source."""
        # The frames around a key frame name its digest, by which a later run knows a copy of an
        # earlier render. If they are replaced first and the run is killed, none names that copy.
        if not self._output.resumes or not self.is_in_the_way(number):
            return
        if number not in self._replaced_early and not self.has_copy(number, source):
            self._copy(number, source)
            self._replaced_early.add(number)

    def pass_key(self, number: int, source: Path) -> bool:
        """Copy a key frame's file, all its layers and attributes but for another frame rate.

        Returns
        -------
        bool
            True if an earlier run had copied it.
        """
        if number in self._replaced_early:
            return False
        resumed = self.has_copy(number, source)
        if not resumed:
            self._writer.submit(partial(self._copy, number, source))
        return resumed

    def has_rendered(self, number: int, source: Path, recipe: str) -> bool:
        """Return True if an earlier run wrote a rendered frame of a slot, and it is kept."""
        if self.copies(source) and not self._is_marked(source):
            return self.has_copy(number, source)
        return self.has(number, recipe, masked=False)

    def pass_rendered(self, number: int, source: Path, marks: Mapping[str, str | int]) -> None:
        """Copy the file of a rendered frame of a slot, all its layers and attributes.

        Its header gets the output's frame rate and ExWarp's own attributes, `marks`, if it is EXR
        and key frames get a rate, too.
        """
        marked_by = marks if self._is_marked(source) else None
        self._writer.submit(partial(self._copy, number, source, marked_by))

    def _is_marked(self, source: Path) -> bool:
        """Return True if a rendered frame's header gets ExWarp's own attributes."""
        return source.suffix.lower() in EXR and not self._output.keeps_bytes

    def write(
        self,
        number: int,
        image: Image,
        mask: Bool | None,
        template: FrameTemplate,
        attributes: Mapping[str, Any],
        layers: Mapping[PlaneKey, Plane] | None = None,
        inline: bool = False,
    ) -> None:
        """Write a generated frame, and its hole mask if masks are written and it has one.

        Parameters
        ----------
        number
            Of the output.
        image
            Its colour.
        mask
            bool [H, W] on the display window.
        template, attributes, layers
            As for `io.output.write_picture`.
        inline
            Whether this thread writes, and does not return before; any thread may.
        """
        if self._output.compression is not None:
            attributes = {**attributes, "compression": self._output.compression}
        tasks: list[Callable[[], None]] = []
        if self._output.frames is not None:
            tasks.append(partial(self._put_frame, number, image, template, attributes, layers))
        if self._output.holes is not None and mask is not None:
            tasks.append(partial(self._put_mask, number, mask, attributes))
        for task in tasks:
            if inline:
                task()
            else:
                self._writer.submit(task)

    def write_decoded(
        self, number: int, image: Image, template: FrameTemplate, attributes: Mapping[str, Any]
    ) -> None:
        """Write a rendered frame whose file is of another format than the output's."""
        self._writer.submit(partial(self._put_frame, number, image, template, attributes, None))

    def show(self, image: Image) -> None:
        """Append a frame to the video, if there is one."""
        if self._video is not None:
            shown = self.displayed(image.on(self._display).pixels, self._output.exposure)
            code = self._encode(shown)
            self._video.write(code)
            self._last_shown = code if self._skips else None

    def displayed(self, pixels: Float32, exposure_stops: float = 0.0) -> Float32:
        """Return the light of a display that shows scene-linear colour; see `DisplayLook`."""
        look = DisplayLook(self._look.primaries, self._output.view)
        return look.apply(pixels, exposure_stops)

    def show_again(self) -> None:
        """Append the last frame to the video again, so that sound stays in step; else a black one.

        Only where frames may be skipped: the last frame is kept for that.
        """
        if self._video is not None:
            black = np.zeros((*self._display.shape, 3), np.float32)
            shown = self._encode(black) if self._last_shown is None else self._last_shown
            self._video.write(shown)

    def read(self, number: int) -> Image:
        """Read a frame that an earlier run wrote."""
        return read_picture(self._path(number), self._view)

    def written(self, number: int) -> dict[str, Any]:
        """Return the attributes of a generated frame that an earlier run wrote."""
        return read_facts(self._path(number))

    def _path(self, number: int) -> Path:
        assert self._output.frames is not None
        return self._output.frames.path(number)

    def _copy(
        self, number: int, source: Path, marks: Mapping[str, str | int] | None = None
    ) -> None:
        """Copy a rendered file, with `marks` in its header."""
        with record_time(self.write_ms, number), ExitStack() as stack:
            if marks is None:
                file = stack.enter_context(open_key_file(source, self._key_rate))
            else:
                file = plan_marked_file(source, self._key_rate, marks)
            file.write(self._path(number))
            if self._wants_sums:  # of what the source gives
                self.sums[FRAME, number] = sum_of(file.pieces())

    def _put_frame(
        self,
        number: int,
        image: Image,
        template: FrameTemplate,
        attributes: Mapping[str, Any],
        layers: Mapping[PlaneKey, Plane] | None,
    ) -> None:
        with record_time(self.write_ms, number):
            pieces = write_picture(self._path(number), image, template, attributes, layers)
            self._add_sum(FRAME, number, pieces)

    def _put_mask(self, number: int, mask: Bool, attributes: Mapping[str, Any]) -> None:
        assert self._output.holes is not None
        marks = {k: v for k, v in attributes.items() if k.startswith(PREFIX)}
        windows = (self._display, self._display)
        pieces = write_mask(self._output.holes.path(number), mask, windows, marks)
        self._add_sum(HOLES, number, pieces)

    def _add_sum(self, kind: str, number: int, pieces: list[Buffer]) -> None:
        if self._wants_sums:  # of what is in memory
            self.sums[kind, number] = sum_of(pieces)
