"""Where the frames of a run go: files written behind the work, hole masks, and a video."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain import cores
from exwarp_cli.domain.frame import Bool, Float32, Image, Window
from exwarp_cli.domain.frame_rates import OutputRate
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.io.atomic import is_there
from exwarp_cli.io.exr.template import Plane, PlaneKey
from exwarp_cli.io.exr.writer import Buffer
from exwarp_cli.io.frame_files import FrameTemplate, facts_in, read_picture, write_picture
from exwarp_cli.io.held import Held
from exwarp_cli.io.key_file import key_file, opened_key
from exwarp_cli.io.output import PREFIX, write_mask
from exwarp_cli.io.video import VideoLook, VideoWriter, to_display
from exwarp_cli.pipeline.schedule import WriteBehind
from exwarp_cli.pipeline.targets import Targets, key_is_there, slot_is_there
from exwarp_cli.pipeline.verifying import FRAME, HOLES, Sums, sum_of

FRAMES_BEHIND = 4


class Sink(Held):
    """Takes the frames of a run, in order; a context manager.

    Parameters
    ----------
    targets
        The files to write.
    settings
        Of the run.
    display
        The window that the video and the hole masks show.
    rate
        Of the video, and what headers of key frames get.
    view
        Which view of written frames is read again; "" for the hero, and without views.
    behind
        How many frames may wait for a thread to write them, beyond those under way.
    look
        Of the video: colour, pixels and sound; None for the usual.
    sums
        Whether checksums of files are wanted.
    """

    def __init__(
        self,
        targets: Targets,
        settings: UpsampleSettings,
        display: Window,
        rate: OutputRate,
        view: str = "",
        behind: int = FRAMES_BEHIND,
        look: VideoLook | None = None,
        sums: bool = False,
    ) -> None:
        self._targets = targets
        self._settings = settings
        self._display = display
        self._fps = rate.fps
        self._key_rate = None if settings.keep_bytes else rate.written
        self._view = view
        self._behind = behind
        self._look = look or VideoLook()
        self._wants_sums = sums
        self._video: VideoWriter | None = None
        self._shown: np.ndarray | None = None  # last, by the video
        self._replaced_early: set[int] = set()
        self.write_ms: dict[int, float] = {}
        """Milliseconds that writing took, by the frame's number; complete at the end."""
        self.sums: Sums = {}
        """Checksums of what is written, where they are wanted; complete at the end."""

    def _open(self, stack: ExitStack) -> None:
        threads = cores.count()
        self._writer = stack.enter_context(WriteBehind(threads, self._behind + threads))
        if self._targets.video is not None:
            height, width = self._display.shape
            video = VideoWriter(self._targets.video, width, height, self._fps, self._look)
            self._video = stack.enter_context(video)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a user has to know of the video; see `VideoWriter.remarks`."""
        return () if self._video is None else self._video.remarks

    @property
    def shows(self) -> bool:
        """Whether every frame has to be shown, for a video."""
        return self._video is not None

    def name(self, number: int) -> str:
        """Return the name of a frame's file, or of the video without files, without its folder."""
        frames, video = self._targets.frames, self._targets.video
        if frames is None:
            assert video is not None
            return video.name
        return frames.path(number).name

    def has(self, number: int, recipe: str, masked: bool = True) -> bool:
        """Whether an earlier run wrote a frame's files as this one would, and they are kept.

        Frames that are not `masked` have no hole mask.
        """
        if not self._settings.skip_existing or self._targets.frames is None:
            return False
        patterns = [self._targets.frames]
        if self._targets.holes is not None and masked:
            patterns.append(self._targets.holes)
        return all(slot_is_there(pattern.path(number), recipe) for pattern in patterns)

    @property
    def keeps_frames(self) -> bool:
        """Whether frames become files, and not a video alone."""
        return self._targets.frames is not None

    def copies(self, source: Path) -> bool:
        """Whether a key frame's file is copied, and not decoded and written anew."""
        frames = self._targets.frames
        return frames is not None and frames.type == source.suffix.lower()

    def has_copy(self, number: int, source: Path) -> bool:
        """Whether an earlier run copied a key frame's file, and it is kept."""
        if not self._settings.skip_existing:
            return False
        return key_is_there(self._frame_path(number), key_file(source, self._key_rate))

    def is_in_the_way(self, number: int) -> bool:
        """Whether a frame's file from before the run is there, which writing would replace.

        A run that may replace none began without any: what is there now is its own, as after the
        loss of a worker.
        """
        may_replace = self._settings.overwrite or self._settings.skip_existing
        return (
            may_replace and self._targets.frames is not None and is_there(self._frame_path(number))
        )

    def replace_key(self, number: int, source: Path) -> None:
        """Replace an earlier copy of a key frame at once, if it is another than the source.

        The frames around a key frame name its digest, by which a later run knows a copy of an
        earlier render. If they are replaced first and the run is killed, none names that copy.
        """
        if not self._settings.skip_existing or not self.is_in_the_way(number):
            return
        if number not in self._replaced_early and not self.has_copy(number, source):
            self._timed(number, partial(self._copy, number, source))
            self._replaced_early.add(number)

    def was_replaced(self, number: int) -> bool:
        """Whether `replace_key` replaced a key frame."""
        return number in self._replaced_early

    def pass_key(self, number: int, source: Path) -> bool:
        """Copy a key frame's file, all its layers and attributes but for another frame rate.

        Returns
        -------
        bool
            Whether an earlier run had copied it.
        """
        if number in self._replaced_early:
            return False
        resumed = self.has_copy(number, source)
        if not resumed:
            self._writer.submit(partial(self._timed, number, partial(self._copy, number, source)))
        return resumed

    def write(
        self,
        number: int,
        image: Image,
        mask: Bool | None,
        template: FrameTemplate,
        attributes: Mapping[str, Any],
        beside: Mapping[PlaneKey, Plane] | None = None,
        here: bool = False,
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
        template, attributes, beside
            As for `io.frame_files.write_picture`.
        here
            Whether to write in this thread, any one, before it goes on.
        """
        do: Callable[[Callable[[], None]], None] = _now if here else self._writer.submit
        if self._targets.frames is not None:
            path = self._frame_path(number)
            written = partial(write_picture, path, image, template, attributes, beside)
            do(partial(self._timed, number, partial(self._put, FRAME, number, written)))
        if self._targets.holes is not None and mask is not None:
            marks = {k: v for k, v in attributes.items() if k.startswith(PREFIX)}
            windows = (self._display, self._display)
            path = self._targets.holes.path(number)
            masked = partial(write_mask, path, mask, windows, marks)
            do(partial(self._put, HOLES, number, masked))

    def show(self, image: Image) -> None:
        """Append a frame to the video, if there is one."""
        if self._video is not None:
            pixels = self.displayed(image.on(self._display).pixels)
            code = to_display(pixels, self._settings.exposure)
            self._video.write(code)
            self._shown = code if self._settings.source.keep_going else None

    def displayed(self, pixels: Float32) -> Float32:
        """Return scene-linear colour [H, W, 3 or more] with the primaries of a display."""
        return self._look.display(pixels)

    def show_again(self) -> None:
        """Append the last frame to the video again, so that sound stays in step; else a black one.

        Only where something may be left out: the last frame is kept for that.
        """
        if self._video is not None:
            black = np.zeros((*self._display.shape, 3), np.float32)
            self._video.write(to_display(black) if self._shown is None else self._shown)

    def read(self, number: int) -> Image:
        """Read a frame that an earlier run wrote."""
        return read_picture(self._frame_path(number), self._view)

    def written(self, number: int) -> dict[str, Any]:
        """Return the attributes of a generated frame that an earlier run wrote."""
        return facts_in(self._frame_path(number))

    def _frame_path(self, number: int) -> Path:
        assert self._targets.frames is not None
        return self._targets.frames.path(number)

    def _copy(self, number: int, source: Path) -> None:
        """Copy a key frame's file; its checksum is that of what the source gives."""
        with opened_key(source, self._key_rate) as file:
            file.write(self._frame_path(number))
            if self._wants_sums:
                self.sums[FRAME, number] = sum_of(file.pieces())

    def _put(self, kind: str, number: int, write: Callable[[], list[Buffer]]) -> None:
        """Write a file; its checksum is that of what is in memory."""
        pieces = write()
        if self._wants_sums:
            self.sums[kind, number] = sum_of(pieces)

    def _timed(self, number: int, write: Callable[[], None]) -> None:
        """Write, and record how long it took."""
        begin = time.perf_counter()
        write()
        self.write_ms[number] = 1e3 * (time.perf_counter() - begin)


def _now(write: Callable[[], None]) -> None:
    write()
