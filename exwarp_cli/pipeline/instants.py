"""G-buffers of output instants as key frames need them: which, and with what motion."""

from __future__ import annotations

from dataclasses import replace

from exwarp_cli.domain.frame import SURFACE_PARTS, GBuffer
from exwarp_cli.domain.timeline import FACTOR, Slot


def without_surface(gbuffer: GBuffer) -> GBuffer:
    """Return what motion is found by: a third of the memory, where frames are kept for later."""
    return gbuffer.without("normal", *SURFACE_PARTS)


def between(key: int) -> tuple[Slot, ...]:
    """Return the instants from the key frame after one back to it."""
    return (Slot(key + 1, 0), *(Slot(key, i) for i in range(FACTOR - 1, -1, -1)))


def over_interval(gbuffer: GBuffer, steps: int) -> GBuffer:
    """Turn motion per slot into motion per key interval, of `steps` slots, at constant velocity."""
    after, before = gbuffer.to_next, gbuffer.to_previous
    return replace(
        gbuffer,
        to_next=None if after is None else steps * after,
        to_previous=None if before is None else steps * before,
    )


def stretched(gbuffer: GBuffer, steps: int) -> GBuffer:
    """Return a slot's geometry as a key frame's, with motion one way alone.

    A key frame's vectors span a key interval in either setting. With slot G-buffers they are only
    used where the slots' own do not lead: after the last key frame, and to the next one where the
    renderer writes none that way.
    """
    found = over_interval(gbuffer, steps)
    return found if found.to_next is None else found.without("to_previous")
