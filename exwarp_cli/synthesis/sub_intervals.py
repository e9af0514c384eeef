"""Sub-intervals: parts of a key interval between frames that were rendered after all.

A slot between a key frame and a rendered one is made from these two, which are nearer to it than
the next key frame. Where the middle of three slots was rendered, the others gained 1.1 to 1.8 dB
with `softsplat` on the scenes lab, slum, arena and town.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from exwarp_cli.domain.frame import KeyFrame
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.trajectory import displacement

# Pixels from which on a point moves between a key frame and a rendered one.
MOVES = 0.5

# Up to so many moving points a frame stands still: its vectors may lead over any time.
MAX_STILL_POINTS = 50

# How far, as a logarithm, the measured span of vectors may be from one that there can be.
NEAR = math.log(1.3)


@dataclass(frozen=True)
class SubSlot:
    """How a slot between two rendered frames is made."""

    interval: Interval  # the part of the key interval between the two frames
    index: int  # of the slot in that part
    keys: tuple[int, ...]  # numbers of those of the two that are key frames
    rendered: tuple[int, ...]  # slots, in the key interval, of those that were rendered after all


@dataclass(frozen=True)
class _End:
    """A rendered frame at an end of a sub-interval."""

    slot: int  # in the key interval
    time: float
    frame: KeyFrame
    span: float  # of its vectors, in key intervals
    is_key: bool = True

    def over(self, length: float) -> KeyFrame:
        """Return the frame with vectors over a part of a key interval."""
        gbuffer = self.frame.gbuffer
        assert gbuffer is not None
        before, after = (displacement(gbuffer, way * length / self.span) for way in (-1, 1))
        moved = replace(gbuffer, to_previous=before, to_next=after, bend=None)
        return replace(self.frame, gbuffer=moved)


def vector_spans(
    interval: Interval,  # in the key setting, with motion
    step: float,  # from slot to slot, in key intervals
) -> dict[int, float]:
    """Measure the time span of the vectors of an interval's rendered frames.

    Renderers write vectors to the frame beside, which is a key frame or a slot, as the scene was
    set up for that render. They are compared with those that lead from the key frame to the slot.

    By slot, 1 for a key interval or `step`. Frames whose vectors fit neither are left out.
    """
    spans = {}
    for slot, frame in interval.rendered.items():
        assert frame.gbuffer is not None
        back, own = interval.back(slot), displacement(frame.gbuffer, -1)
        squares = (back.field * back.field).sum(axis=-1)
        with np.errstate(invalid="ignore"):
            moves = ~back.hole & (squares > MOVES**2) & np.isfinite(own).all(axis=-1)
        if np.count_nonzero(moves) <= MAX_STILL_POINTS:
            spans[slot] = 1.0
            continue
        shares = (own[moves] * back.field[moves]).sum(axis=-1) / squares[moves]
        measured = float(np.median(shares)) * interval.time(slot)
        if measured <= 0:
            continue
        distances = {span: abs(math.log(measured / span)) for span in (1.0, step)}
        nearest = min(distances, key=distances.__getitem__)
        if distances[nearest] < NEAR:
            spans[slot] = nearest
    return spans


def sub_slots(
    interval: Interval,  # in the key setting, with motion
    # Of its rendered frames that are used, as `vector_spans` returns them.
    spans: Mapping[int, float],
) -> dict[int, SubSlot]:
    """Return how slots beside rendered frames are made, by slot.

    Slots after the last rendered frame are left out where no key frame follows.
    """
    if interval.held or not spans:
        return {}
    ends = [_End(0, 0.0, interval.key, 1.0)]
    ends += [
        _End(slot, interval.time(slot), interval.rendered[slot], spans[slot], is_key=False)
        for slot in sorted(spans)
    ]
    if interval.leads_both_ways:
        assert interval.following is not None
        ends.append(_End(len(interval.times) + 1, 1.0, interval.following, 1.0))
    out: dict[int, SubSlot] = {}
    for before, after in pairwise(ends):
        slots = range(before.slot + 1, after.slot)
        if not slots:
            continue
        length = after.time - before.time
        part = replace(
            interval,
            key=before.over(length),
            following=after.over(length),
            rendered={},
            past=(),
            times=tuple((interval.time(slot) - before.time) / length for slot in slots),
            keeps=False,
            after_hold=False,
        )
        keys = tuple(end.frame.number for end in (before, after) if end.is_key)
        rendered = tuple(end.slot for end in (before, after) if not end.is_key)
        out |= {slot: SubSlot(part, i, keys, rendered) for i, slot in enumerate(slots, start=1)}
    return out
