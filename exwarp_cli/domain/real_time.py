"""The real-time clock: what a display at 120 Hz shows of each decision path, and what it drops.

Slots follow each other every 1000/120 ms. A slot's frame is requested when its node decides, one
slot earlier; E(F) of a path that extrapolates at d1 is requested with the key frame, two slots
earlier. One engine runs E, a frame at a time; W does not need it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, inf

from exwarp_cli.domain.decision import EXTRAPOLATE, FIRST_NODE, HOLD, PATHS
from exwarp_cli.domain.timeline import FACTOR

REFRESH_HZ = 120
"""Slots a second: the paper's display."""

BASE_FPS = REFRESH_HZ / FACTOR
"""Key frames a second."""

SLOT_MS = 1000 / REFRESH_HZ

TABLE_PIXELS = {"480p": 854 * 480, "720p": 1280 * 720, "1080p": 1920 * 1080}
"""Sizes of frames in the paper's Table III, in pixels."""

TABLE, MEASURED = "table3", "measured"
TABLE_AS = {f"{TABLE}-{size}": size for size in TABLE_PIXELS}
CLOCKS = (TABLE, *TABLE_AS, MEASURED)
"""Where latencies come from: Table III by the size of the frames, or as if they had one of its
sizes; or this machine's run times."""

BY_PATH, LATE, BUSY = "by path", "late", "busy"
REASONS = (BY_PATH, LATE, BUSY)
"""Why a slot repeats the frame before.

The path makes no frame for it; its frame is not ready at the slot; or the engine still runs an
earlier E when its own is requested. A request that meets a busy engine is refused. It could not be
kept waiting with success: where the engine is still busy, E takes so long that it would be late.
"""


@dataclass(frozen=True)
class Latencies:
    """Time from the request of a frame until it can be shown.

    Attributes
    ----------
    warp_ms, extrapolate_ms
        Of W and E, milliseconds; infinite for what never comes.
    """

    warp_ms: float
    extrapolate_ms: float

    @property
    def extrapolate_slots(self) -> int | None:
        """Slots until E's frame can be shown; None if it never comes."""
        slots = self.extrapolate_ms / SLOT_MS
        return ceil(slots) if slots < inf else None


@dataclass(frozen=True)
class ClockedInterval:
    """What a key interval shows under the clock.

    Attributes
    ----------
    made_by
        What makes the frame of slots 1, 2 and 3: warp, extrapolate or hold. A W of slot 3 samples
        E(F) only where slot 2 shows it, else the key frame.
    dropped
        For each slot out of `REASONS`; None for a slot that shows a new frame.
    busy_slots
        How long E's engine works on after the next key frame, in slots.
    """

    made_by: tuple[str, ...]
    dropped: tuple[str | None, ...]
    busy_slots: float

    @property
    def generated(self) -> int:
        """How many of the three frames are new."""
        return self.dropped.count(None)


def play_interval(path: str, latencies: Latencies, busy_slots: float = 0.0) -> ClockedInterval:
    """Run a decision path against the clock.

    Parameters
    ----------
    path
        S1 to S6.
    latencies
        Of W and E.
    busy_slots
        How long the engine still works on an E of the key interval before, in slots.
    """
    made_by, dropped = [], []
    free = busy_slots
    for slot, maker in enumerate(PATHS[path].made_by, start=1):
        requested = _request_slot(path, slot)
        reason: str | None
        if maker == HOLD:
            reason = BY_PATH
        elif maker == EXTRAPOLATE and free > requested:
            reason = BUSY
        else:
            ms = latencies.extrapolate_ms if maker == EXTRAPOLATE else latencies.warp_ms
            ready = requested + ms / SLOT_MS
            reason = LATE if ready > slot else None
            if maker == EXTRAPOLATE:
                free = ready  # an E that is late runs to its end, too
        made_by.append(maker if reason is None else HOLD)
        dropped.append(reason)
    return ClockedInterval(tuple(made_by), tuple(dropped), max(free - FACTOR, 0.0))


def play(paths: Iterable[str], latencies: Latencies) -> tuple[ClockedInterval, ...]:
    """Run the paths of key intervals that follow each other; the engine goes on between them."""
    played: list[ClockedInterval] = []
    for path in paths:
        busy = played[-1].busy_slots if played else 0.0
        played.append(play_interval(path, latencies, busy))
    return tuple(played)


def effective_fps(played: Iterable[ClockedInterval]) -> float:
    """Return key frames and new frames a second; repeats are no new frames."""
    new = [interval.generated for interval in played]
    return BASE_FPS * (1 + sum(new) / len(new))


def _request_slot(path: str, slot: int) -> int:
    """Return the slot at which the frame of another slot is requested."""
    starts_with_key = slot == 2 and PATHS[path].choices[FIRST_NODE] == EXTRAPOLATE
    return 0 if starts_with_key else slot - 1
