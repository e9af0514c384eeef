"""The files that a run would write, and which of them are there already."""

from __future__ import annotations

import filecmp
from dataclasses import dataclass
from pathlib import Path

from exwarp_cli.domain.settings import UpsampleSettings
from exwarp_cli.domain.timeline import Slot, Timeline, ranges
from exwarp_cli.errors import OutputExistsError, UsageError
from exwarp_cli.io.atomic import make_folder, remove_leftovers
from exwarp_cli.io.output import recipe_of
from exwarp_cli.io.sequence import OutputPattern, Sequence, output_pattern
from exwarp_cli.io.video import require_container


@dataclass(frozen=True)
class Targets:
    """Where a run writes.

    Attributes
    ----------
    frames
        Pattern of the frames.
    holes
        Pattern of the hole masks; None without.
    video
        None without.
    """

    frames: OutputPattern
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
        frames = output_pattern(settings.output, source)
        holes = None
        if settings.write_holes is not None:
            holes = output_pattern(settings.write_holes, source)
            if holes == frames:
                raise UsageError(
                    "--write-holes and -o name the same files; give the masks a folder of their own"
                )
        video = None if settings.video is None else Path(settings.video)
        if video is not None:
            require_container(video)
        return cls(frames, holes, video)

    def prepare(self, settings: UpsampleSettings, timeline: Timeline, slots: list[Slot]) -> None:
        """Refuse to overwrite, make the folders, and clear what dead runs left there.

        Raises
        ------
        OutputExistsError
            When something is in the way and neither --overwrite nor --skip-existing was given.
        OutputError
            When a folder cannot be made or written to.
        """
        if settings.overwrite and settings.skip_existing:
            raise UsageError("--overwrite and --skip-existing contradict each other; give one")
        if not (settings.overwrite or settings.skip_existing):
            self._refuse(timeline, slots)
        folders = {self.frames.folder}
        if self.holes is not None:
            folders.add(self.holes.folder)
        if self.video is not None:
            folders.add(self.video.parent)
        for folder in folders:
            make_folder(folder)
            remove_leftovers(folder)

    def _refuse(self, timeline: Timeline, slots: list[Slot]) -> None:
        for pattern in (self.frames, self.holes):
            if pattern is None:
                continue
            numbers = [timeline.number(slot) for slot in slots]
            there = [n for n in numbers if pattern.path(n).exists()]
            if there:
                raise OutputExistsError(
                    f"{pattern.folder} has frame {ranges(there)} of {pattern.name} already; give "
                    "--skip-existing to keep good ones, --overwrite to replace them, or another -o"
                )
        if self.video is not None and self.video.exists():
            raise OutputExistsError(
                f"{self.video} exists already; give --overwrite to replace it, or another --video"
            )


def key_is_there(target: Path, source: Path) -> bool:
    """Whether a key frame was passed through already: the same bytes."""
    try:
        return target.exists() and filecmp.cmp(target, source, shallow=False)
    except OSError:
        return False


def slot_is_there(target: Path, recipe: str) -> bool:
    """Whether a generated frame is there, undamaged, and as this run would make it."""
    return target.exists() and recipe_of(target) == recipe
