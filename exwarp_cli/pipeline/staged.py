"""A key interval whose slots can be made, and what is counted in its frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.decision import PATHS, Plan
from exwarp_cli.domain.frame import Bool, KeyFrame, broken_pixels
from exwarp_cli.domain.results import FrameRecord
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.pipeline.choosing import Chosen
from exwarp_cli.pipeline.loaded import Loaded
from exwarp_cli.synthesis.interval import Interval


@dataclass(frozen=True)
class Staged:
    """A key interval whose slots can be made.

    Attributes
    ----------
    interval
        On one window; None where every slot of it was found written.
    chosen
        By whom its path was decided, and how; None outside the decision tree.
    there
        The slots that an earlier run wrote.
    shares
        Milliseconds that all this took, by step: a slot's share.
    broken
        How many pixels of the frames around are NaN or infinite, by the frame's number.
    """

    interval: Interval | None
    chosen: Chosen | None
    there: frozenset[Slot]
    shares: dict[str, float]
    broken: Mapping[int, int]

    @property
    def extrapolates(self) -> bool:
        """Whether its network makes any of the slots."""
        return self.plan is not None and PATHS[self.plan.path].extrapolates

    @property
    def plan(self) -> Plan | None:
        """The path that was decided."""
        return None if self.chosen is None else self.chosen.plan


def hole_fraction(mask: Bool | None) -> float | None:
    """Share of holes, rounded to float32 as the header of the frame keeps it."""
    return None if mask is None else float(np.float32(np.count_nonzero(mask) / mask.size))


def broken_in(loaded: Loaded, known: Mapping[int, int]) -> dict[int, int]:
    """Count the pixels that are NaN or infinite, by frame; `known` are counts of some frames."""
    frames = (loaded.frame, loaded.following, *(older.frame for older in loaded.past))
    return {frame.number: _broken(frame, known) for frame in frames if frame is not None}


def _broken(frame: KeyFrame, known: Mapping[int, int]) -> int:
    count = known.get(frame.number, frame.broken)
    return int(np.count_nonzero(broken_pixels(frame.image.pixels))) if count is None else count


def with_write_times(
    records: Iterable[FrameRecord], taken: Mapping[int, float]
) -> tuple[FrameRecord, ...]:
    """Add how long frames took to write, milliseconds by number, known once all are written."""
    return tuple(
        replace(r, timing_ms=r.timing_ms | {"write": taken[r.number]}) if r.number in taken else r
        for r in records
    )
