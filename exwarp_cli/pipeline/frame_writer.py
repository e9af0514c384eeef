"""Where the frames of a run go: the files that it writes, behind the work, and a video."""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import Bool, Float32, Image, Window
from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import OutputRate, Slot, Timeline, ranges
from exwarp_cli.errors import OutputError, OutputExistsError, UsageError
from exwarp_cli.io.display_colour import to_display
from exwarp_cli.io.exr.template import PREFIX, Plane, PlaneKey
from exwarp_cli.io.exr.writer import Buffer
from exwarp_cli.io.files import (
    ResourceOwner,
    make_folder,
    output_error,
    path_exists,
    remove_leftovers,
)
from exwarp_cli.io.footage import is_plain
from exwarp_cli.io.generated_frames import (
    FrameTemplate,
    read_facts,
    read_fingerprint,
    read_picture,
    write_mask,
    write_picture,
)
from exwarp_cli.io.key_file import KeyFile, key_file, marked_file, opened_key
from exwarp_cli.io.sequence import EXR, OutputPattern, Sequence, output_pattern
from exwarp_cli.io.stills import STILLS, require_writer
from exwarp_cli.io.video_reader import is_clip
from exwarp_cli.io.video_writer import VideoLook, VideoWriter, require_container
from exwarp_cli.pipeline.scheduling import AsyncWriter, record_time
from exwarp_cli.pipeline.verifying import FRAME, HOLES, Sums, sum_of
from exwarp_cli.runtime import cores

FRAMES_BEHIND = 4


@dataclass(frozen=True)
class OutputPlan:
    """Where a run writes.

    Attributes
    ----------
    frames
        Pattern of the frames; None where only a video is written.
    holes
        Pattern of the hole masks; None without.
    video
        None without.
    """

    frames: OutputPattern | None
    holes: OutputPattern | None
    video: Path | None

    @classmethod
    def from_settings(cls, settings: UpsampleSettings, source: Sequence) -> OutputPlan:
        """Read the output options.

        Raises
        ------
        UsageError
            When they name the same folder and pattern twice, or a video of an unknown kind.
        """
        alone = is_clip(settings.output)
        if alone and settings.video is not None:
            raise UsageError("-o names a video already; leave --video out, or name a folder in -o")
        frames = None if alone else _frames(settings, source)
        holes = None
        if settings.write_holes is not None:
            text = source.suffix[: -len(source.type)]
            holes = output_pattern(settings.write_holes, replace(source, suffix=text + EXR[0]))
            if holes == frames:
                raise UsageError(
                    "--write-holes and -o name the same files; give the masks a folder of their own"
                )
        named = settings.output if alone else settings.video
        video = None if named is None else Path(named)
        if video is not None:
            require_container(video)
            if video.resolve() in {path.resolve() for path in source.files.values()}:
                raise OutputError(f"the video {video} is the input itself; name another")
        return cls(frames, holes, video)

    def make_folders(self) -> None:
        """Make the folders, and clear what dead runs left there.

        Raises
        ------
        OutputError
            When one cannot be made or written to.
        """
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

    def check_conflicts(
        self, settings: UpsampleSettings, timeline: Timeline, slots: list[Slot]
    ) -> None:
        """Refuse to overwrite, and touch nothing.

        Raises
        ------
        OutputExistsError
            When something is in the way and neither --overwrite nor --skip-existing was given.
        OutputError
            When a folder is where the video would be.
        """
        if settings.overwrite and settings.skip_existing:
            raise UsageError("--overwrite and --skip-existing contradict each other; give one")
        if self.video is not None and path_exists(self.video) and self.video.is_dir():
            raise output_error(self.video, IsADirectoryError(errno.EISDIR, ""))
        if not (settings.overwrite or settings.skip_existing):
            for pattern in (self.frames, self.holes):
                if pattern is None:
                    continue
                numbers = [timeline.number(slot) for slot in slots]
                there = [n for n in numbers if path_exists(pattern.path(n))]
                if there:
                    raise OutputExistsError(
                        f"{pattern.folder} has frame {ranges(there)} of {pattern.name} already; "
                        "give --skip-existing to keep good ones, --overwrite to replace them, or "
                        "another -o"
                    )
            if self.video is not None and path_exists(self.video):
                option = "--video" if self.frames is not None else "-o"
                raise OutputExistsError(
                    f"{self.video} exists already; give --overwrite to replace it, or another "
                    f"{option}"
                )


def frame_suffix(output: str, source: Sequence) -> str:
    """Return the suffix of the frames that ``-o`` asks for: its own, else the input's."""
    suffix = Path(output).suffix
    named = suffix.lower() in (*EXR, *STILLS) and not Path(output).is_dir()
    return suffix if named else source.suffix


def _frames(settings: UpsampleSettings, source: Sequence) -> OutputPattern:
    """Read where frames go: those of EXR as EXR, others as EXR or stills of any kind."""
    plain = is_plain(source)
    pattern = output_pattern(settings.output, source, (*STILLS, *EXR) if plain else EXR)
    if pattern.type in STILLS:
        require_writer(pattern.path(0))
        if settings.compression is not None:
            raise UsageError(
                f"--compression is for EXR, and frames are written as {pattern.type}; leave it "
                "out, or name a pattern such as out.####.exr"
            )
    return pattern


def key_is_there(target: Path, source: KeyFile) -> bool:
    """Whether a key frame was passed through already: the bytes that this job writes for it."""
    try:
        return target.exists() and source.is_at(target)
    except OSError:
        return False


def slot_is_there(target: Path, recipe: str) -> bool:
    """Whether a generated frame is there, undamaged, and as this run would make it."""
    return target.exists() and read_fingerprint(target) == recipe


class FrameWriter(ResourceOwner):
    """Writes the frames of a run, in order; a context manager.

    Parameters
    ----------
    output
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
        output: OutputPlan,
        settings: UpsampleSettings,
        display: Window,
        rate: OutputRate,
        view: str = "",
        behind: int = FRAMES_BEHIND,
        look: VideoLook | None = None,
        sums: bool = False,
    ) -> None:
        self._output = output
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
        self._writer = stack.enter_context(AsyncWriter(threads, self._behind + threads))
        if self._output.video is not None:
            height, width = self._display.shape
            video = VideoWriter(self._output.video, width, height, self._fps, self._look)
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
        frames, video = self._output.frames, self._output.video
        if frames is None:
            assert video is not None
            return video.name
        return frames.path(number).name

    def has(self, number: int, recipe: str, masked: bool = True) -> bool:
        """Whether an earlier run wrote a frame's files as this one would, and they are kept.

        Frames that are not `masked` have no hole mask.
        """
        if not self._settings.skip_existing or self._output.frames is None:
            return False
        patterns = [self._output.frames]
        if self._output.holes is not None and masked:
            patterns.append(self._output.holes)
        return all(slot_is_there(pattern.path(number), recipe) for pattern in patterns)

    @property
    def keeps_frames(self) -> bool:
        """Whether frames become files, and not a video alone."""
        return self._output.frames is not None

    def copies(self, source: Path) -> bool:
        """Whether a key frame's file is copied, and not decoded and written anew."""
        frames = self._output.frames
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
            may_replace
            and self._output.frames is not None
            and path_exists(self._frame_path(number))
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

    def has_rendered(self, number: int, source: Path, recipe: str) -> bool:
        """Whether an earlier run wrote a rendered frame of a slot, and it is kept."""
        if self.copies(source) and not self._is_marked(source):
            return self.has_copy(number, source)
        return self.has(number, recipe, masked=False)

    def pass_rendered(self, number: int, source: Path, marks: Mapping[str, str | int]) -> None:
        """Copy the file of a rendered frame of a slot, all its layers and attributes.

        Its header gets the output's frame rate and ExWarp's own attributes, `marks`, if it is EXR
        and key frames get a rate, too.
        """
        copy = partial(self._copy, number, source)
        if self._is_marked(source):
            copy = partial(self._copy_marked, number, source, marks)
        self._writer.submit(partial(self._timed, number, copy))

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
            As for `io.frame_files.write_picture`.
        inline
            Whether this thread writes, and does not return before; any thread may.
        """
        submit: Callable[[Callable[[], None]], None] = _run if inline else self._writer.submit
        if self._output.frames is not None:
            path = self._frame_path(number)
            written = partial(write_picture, path, image, template, attributes, layers)
            submit(partial(self._timed, number, partial(self._put, FRAME, number, written)))
        if self._output.holes is not None and mask is not None:
            marks = {k: v for k, v in attributes.items() if k.startswith(PREFIX)}
            windows = (self._display, self._display)
            path = self._output.holes.path(number)
            masked = partial(write_mask, path, mask, windows, marks)
            submit(partial(self._put, HOLES, number, masked))

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
        return read_facts(self._frame_path(number))

    def _frame_path(self, number: int) -> Path:
        assert self._output.frames is not None
        return self._output.frames.path(number)

    def _copy(self, number: int, source: Path) -> None:
        """Copy a key frame's file; its checksum is that of what the source gives."""
        with opened_key(source, self._key_rate) as file:
            file.write(self._frame_path(number))
            if self._wants_sums:
                self.sums[FRAME, number] = sum_of(file.pieces())

    def _copy_marked(self, number: int, source: Path, marks: Mapping[str, str | int]) -> None:
        """Copy a rendered frame's file, with ExWarp's own attributes in its header."""
        file = marked_file(source, self._key_rate, marks)
        file.write(self._frame_path(number))
        if self._wants_sums:
            self.sums[FRAME, number] = sum_of(file.pieces())

    def _is_marked(self, source: Path) -> bool:
        """Whether a rendered frame's header gets ExWarp's own attributes."""
        return source.suffix.lower() in EXR and not self._settings.keep_bytes

    def _put(self, kind: str, number: int, write: Callable[[], list[Buffer]]) -> None:
        """Write a file; its checksum is that of what is in memory."""
        pieces = write()
        if self._wants_sums:
            self.sums[kind, number] = sum_of(pieces)

    def _timed(self, number: int, write: Callable[[], None]) -> None:
        with record_time(self.write_ms, number):
            write()


def _run(write: Callable[[], None]) -> None:
    write()
