"""The files that a run would write, and which of them are there already."""

from __future__ import annotations

import errno
from dataclasses import dataclass, replace
from pathlib import Path

from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import Slot, Timeline, ranges
from exwarp_cli.errors import OutputError, OutputExistsError, UsageError
from exwarp_cli.io.atomic import is_there, make_folder, output_error, remove_leftovers
from exwarp_cli.io.clip import is_clip
from exwarp_cli.io.footage import is_plain
from exwarp_cli.io.frame_files import recipe_in
from exwarp_cli.io.key_file import KeyFile
from exwarp_cli.io.sequence import EXR, OutputPattern, Sequence, output_pattern
from exwarp_cli.io.stills import STILLS, require_writer
from exwarp_cli.io.video import require_container


@dataclass(frozen=True)
class Targets:
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
    def of(cls, settings: UpsampleSettings, source: Sequence) -> Targets:
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
        found = [pattern.folder for pattern in (self.frames, self.holes) if pattern is not None]
        if self.video is not None:
            found.append(self.video.parent)
        return tuple(dict.fromkeys(found))

    def refuse(self, settings: UpsampleSettings, timeline: Timeline, slots: list[Slot]) -> None:
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
        if self.video is not None and is_there(self.video) and self.video.is_dir():
            raise output_error(self.video, IsADirectoryError(errno.EISDIR, ""))
        if not (settings.overwrite or settings.skip_existing):
            self._refuse(timeline, slots)

    def _refuse(self, timeline: Timeline, slots: list[Slot]) -> None:
        for pattern in (self.frames, self.holes):
            if pattern is None:
                continue
            numbers = [timeline.number(slot) for slot in slots]
            there = [n for n in numbers if is_there(pattern.path(n))]
            if there:
                raise OutputExistsError(
                    f"{pattern.folder} has frame {ranges(there)} of {pattern.name} already; give "
                    "--skip-existing to keep good ones, --overwrite to replace them, or another -o"
                )
        if self.video is not None and is_there(self.video):
            option = "--video" if self.frames is not None else "-o"
            raise OutputExistsError(
                f"{self.video} exists already; give --overwrite to replace it, or another {option}"
            )


def frame_suffix(output: str, source: Sequence) -> str:
    """Return the suffix of the frames that ``-o`` asks for: its own, else the input's."""
    suffix = Path(output).suffix
    named = suffix.lower() in (*EXR, *STILLS) and not Path(output).is_dir()
    return suffix if named else source.suffix


def _frames(settings: UpsampleSettings, source: Sequence) -> OutputPattern:
    """Read where frames go: those of EXR as EXR, others as EXR or stills of any kind."""
    plain = is_plain(source)
    found = output_pattern(settings.output, source, (*STILLS, *EXR) if plain else EXR)
    if found.type in STILLS:
        require_writer(found.path(0))
        if settings.compression is not None:
            raise UsageError(
                f"--compression is for EXR, and frames are written as {found.type}; leave it "
                "out, or name a pattern such as out.####.exr"
            )
    return found


def key_is_there(target: Path, source: KeyFile) -> bool:
    """Whether a key frame was passed through already: the bytes that this job writes for it."""
    try:
        return target.exists() and source.is_at(target)
    except OSError:
        return False


def slot_is_there(target: Path, recipe: str) -> bool:
    """Whether a generated frame is there, undamaged, and as this run would make it."""
    return target.exists() and recipe_in(target) == recipe
