"""What became of key frames that were done, in a whole run or in a chunk of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from exwarp_cli.domain.cuts import Cut
from exwarp_cli.domain.joining import join_cuts
from exwarp_cli.domain.results import BrokenPixels, FrameRecord, LeftOut, WrittenFile


@dataclass(frozen=True)
class Outcome:
    """What was made; attributes as in `RunSummary`."""

    frames: tuple[FrameRecord, ...] = ()
    cuts: tuple[Cut, ...] | None = None
    left_out: tuple[LeftOut, ...] = ()
    files: tuple[WrittenFile, ...] = ()
    verified: int | None = None
    nonfinite: tuple[BrokenPixels, ...] = ()

    @property
    def shown(self) -> int:
        """How many frames a video of them has."""
        return len(self.frames) + sum(len(one.frames) for one in self.left_out)

    @classmethod
    def joined(cls, parts: Sequence[Outcome]) -> Outcome:
        """Join those of chunks, in their order."""
        counts = [part.verified for part in parts if part.verified is not None]
        return cls(
            tuple(frame for part in parts for frame in part.frames),
            join_cuts(part.cuts for part in parts),
            tuple(one for part in parts for one in part.left_out),
            tuple(file for part in parts for file in part.files),
            sum(counts) if counts else None,
            tuple(one for part in parts for one in part.nonfinite),
        )
