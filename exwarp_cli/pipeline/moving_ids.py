"""Which objects of a Cryptomatte move in a key interval, where nobody says so.

Decided once per interval: an object that counted as moving in one instant and as standing still in
the next would be a hole to itself. What decides is what the interval reads anyway, so that any part
of a sequence comes to the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

from exwarp_cli.domain.frame import GBuffer, KeyFrame, Window
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.pipeline.instants import between
from exwarp_cli.pipeline.loaded import Loaded, Older
from exwarp_cli.synthesis.geometry import settle_motion
from exwarp_cli.synthesis.movers import chosen, moving, those

Ids = frozenset[int]
Instant = tuple[Slot, GBuffer]
Place = tuple[tuple[Slot, Window], ...]
"""One or two instants with their windows: a key frame's data may fill less than its G-buffer."""


class MovingIds:
    """Finds what moves, interval by interval; what two of them look at is looked at once."""

    def __init__(self) -> None:
        self._known: dict[tuple[Place, Window], Ids] = {}

    def of(self, loaded: Loaded, canvas: Window) -> Ids | None:
        """Return the ids of what moves between any two instants of an interval.

        Parameters
        ----------
        loaded
            As read.
        canvas
            The window that the interval is staged on.

        Returns
        -------
        frozenset or None
            None where there are no ids of what is shown.
        """
        instants = _instants(loaded)
        if all(gbuffer.objects is None for _, gbuffer in instants):
            return None
        looked_at: dict[tuple[Place, Window], Ids] = {}
        for pair in _pairs(instants):
            place = tuple((slot, gbuffer.window) for slot, gbuffer in pair), canvas
            found = self._known.get(place)
            looked_at[place] = _in(canvas, *(g for _, g in pair)) if found is None else found
        self._known = looked_at
        return frozenset().union(*looked_at.values())


def with_stencils(loaded: Loaded, ids: Ids | None) -> Loaded:
    """Return an interval whose G-buffers have the objects of some ids as their stencil.

    Parameters
    ----------
    loaded
        As read.
    ids
        As of `MovingIds`; with None it stays as it is.
    """
    if ids is None:
        return loaded

    def told(gbuffer: GBuffer) -> GBuffer:
        if gbuffer.objects is None:
            return gbuffer
        return replace(gbuffer, stencil=chosen(gbuffer.objects, ids), objects=None)

    def shown(frame: KeyFrame | None) -> KeyFrame | None:
        if frame is None or frame.gbuffer is None:
            return frame
        return replace(frame, gbuffer=told(frame.gbuffer))

    past = tuple(
        Older(shown(older.frame) or older.frame, tuple(map(told, older.instants)))
        for older in loaded.past
    )
    return replace(
        loaded,
        frame=shown(loaded.frame),
        following=shown(loaded.following),
        slots=tuple(map(told, loaded.slots)),
        past=past,
    )


def _pairs(instants: list[Instant]) -> Iterable[tuple[Instant, ...]]:
    """Pair each instant with the one before it; one that is alone with none."""
    return zip(instants[1:], instants, strict=False) if instants[1:] else [(instants[0],)]


def _in(canvas: Window, now: GBuffer, before: GBuffer | None = None) -> Ids:
    """Return the ids of what moves between two instants, or by the vectors of one alone."""
    if now.objects is None or not now.has_motion:
        return frozenset()
    raw = now.on(canvas)
    moves = moving(settle_motion(raw), None if before is None else before.on(canvas), raw)
    return frozenset() if moves is None or raw.objects is None else those(raw.objects, moves)


def _instants(loaded: Loaded) -> list[Instant]:
    """Return the instants of an interval in order, each with motion from the one before it."""
    found: list[Instant] = []
    if loaded.frame is None or loaded.frame.gbuffer is None:
        return found
    at = loaded.key
    if any(older.instants for older in loaded.past):
        found = list(_way(loaded))
    else:
        for back, older in enumerate(loaded.past, start=1):
            if older.frame.gbuffer is not None:
                found.insert(0, (Slot(at - back, 0), older.frame.gbuffer))
        found.append((Slot(at, 0), loaded.frame.gbuffer))
    found += [(Slot(at, i), gbuffer) for i, gbuffer in enumerate(loaded.slots, start=1)]
    following = loaded.following
    if not loaded.slots and following is not None and following.gbuffer is not None:
        found.append((Slot(at + 1, 0), following.gbuffer))
    return found


def _way(loaded: Loaded) -> Iterator[Instant]:
    """Yield the instants from the oldest key frame to this one, where slots have G-buffers."""
    for back in range(len(loaded.past), 0, -1):
        way = list(zip(between(loaded.key - back), loaded.past[back - 1].instants, strict=True))
        yield from reversed(way[1:])
    yield way[0]
