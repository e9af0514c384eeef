"""What a policy sees of a run: the features around each key interval, each computed once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.accelerator.fixed_point import to_fixed
from exwarp_cli.domain.decision import NODE_SLOTS, NODES, Features
from exwarp_cli.domain.frame import GBuffer, Window
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.pipeline.interval_inputs import IntervalInputs, IntervalReader, PolicyObservation
from exwarp_cli.pipeline.progress import NoProgress, Progress
from exwarp_cli.pipeline.source import open_source
from exwarp_cli.policy.features import FrameStatistics, compare
from exwarp_cli.policy.state import OLDER_KEYS, StateHistory
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.geometry import settle_motion
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import CAUSAL, FRAMEWISE
from exwarp_cli.synthesis.movers import moving, of_moving

MOVING = 1
"""Id of all that moves, where only motion tells it: connected areas are the objects then."""


class Observer:
    """Computes features interval by interval, all on the display window.

    Parameters
    ----------
    display
        The display window of all frames.
    setting
        "key" or "slot".
    """

    def __init__(self, display: Window, setting: str) -> None:
        self._display = display
        self._span = FACTOR if setting == "key" else 1
        self._starts: dict[int, Features] = {}
        self._begin = 0
        self._last: FrameStatistics | None = None

    def surroundings(
        self,
        key: int,
        observed: Sequence[PolicyObservation],
        slots: Sequence[GBuffer],
        settled: GBuffer | None = None,
        read: Sequence[GBuffer] = (),
    ) -> StateHistory:
        """Return what the states of an interval are made of.

        Parameters
        ----------
        key
            Index of the key frame.
        observed
            Its instant, and those that were not seen before, ascending; one that nothing comes
            before begins a shot, and what was seen of older ones is of no use.
        slots
            G-buffers of slots 1 to 3 on the display window with settled motion; empty where there
            are none.
        settled
            The key frame's on the display window with settled motion, where it is at hand.
        read
            Those of the slots as read; empty where they are not at hand.
        """
        for instant in observed:
            before = None if instant.before is None else instant.before.on(self._display)
            if before is None:
                self._begin = instant.key
            now, raw = settled if instant.key == key else None, instant.now.on(self._display)
            if now is None:
                now = settle_motion(raw)
            self._starts[instant.key] = self._seen(with_ids(now, before, raw), before, self._span)
        start = self._starts[key]
        now_on = (start, start, start)
        if slots:
            times = [observed[-1].now.on(self._display), *slots[:2]]
            raw_on = [slot.on(self._display) for slot in read[:2]]
            first, second = (
                with_ids(times[i + 1], times[i], raw_on[i] if raw_on else None) for i in (0, 1)
            )
            now_on = (start, self._seen(first, times[0], 1), self._seen(second, first, 1))
            self._last = None  # the next key frame is compared with slot 3
        older = range(key - 1, max(key - OLDER_KEYS, self._begin) - 1, -1)
        before_it = tuple(self._starts[i] for i in older)
        self._starts = {i: found for i, found in self._starts.items() if i > key - OLDER_KEYS}
        return StateHistory(now_on, before_it)

    def _seen(self, now: GBuffer, before: GBuffer | None, span: int) -> Features:
        """Return the features of an instant, of which the one before is mostly known."""
        found = None if before is None else self._shapes(before)
        self._last = FrameStatistics(now)
        return compare(now, self._last, found, span)

    def _shapes(self, gbuffer: GBuffer) -> FrameStatistics:
        known = self._last
        return known if known is not None and known.are_of(gbuffer) else FrameStatistics(gbuffer)

    def of(self, inputs: IntervalInputs, interval: Interval) -> StateHistory:
        """Return what the states of an interval are made of that was read and staged.

        Motion settled on another window than the display's differs in its last digits, as other
        points are looked at; so it is settled again then. It is, too, where the interval took what
        moves in it for ids: features are of an instant, whichever interval they are first seen in.
        """
        settled, slots = None, interval.slots
        whole = inputs.frame is not None and inputs.frame.image.data_window == self._display
        alike = interval.key.image.data_window == self._display and not _shows_objects(inputs)
        if self._span == FACTOR and whole and alike:
            settled = interval.key.gbuffer
        if not alike:
            slots = self.settled(inputs.slots)
        return self.surroundings(inputs.key, inputs.observed, slots, settled, inputs.slots)

    def settled(self, slots: Sequence[GBuffer]) -> tuple[GBuffer, ...]:
        """Return G-buffers of slots as `surroundings` takes them."""
        return tuple(settle_motion(slot.on(self._display)) for slot in slots)


def with_ids(
    gbuffer: GBuffer, before: GBuffer | None = None, raw: GBuffer | None = None
) -> GBuffer:
    """Return a G-buffer with ids of what moves: its own, else of what keeps no place in the world.

    Parameters
    ----------
    gbuffer
        With settled motion. Without ids, positions or depth it stays as it is.
    before, raw
        As :func:`exwarp_cli.synthesis.movers.moving` takes them.
    """
    if gbuffer.stencil is not None:
        return gbuffer
    moves = moving(gbuffer, before, raw)
    if moves is None:
        return gbuffer
    if gbuffer.objects is not None:
        return replace(gbuffer, stencil=of_moving(gbuffer.objects, moves), objects=None)
    return replace(gbuffer, stencil=np.where(moves, MOVING, 0).astype(np.int32))


def _shows_objects(inputs: IntervalInputs) -> bool:
    """Whether what was read has ids of whatever is shown."""
    frame = None if inputs.frame is None else inputs.frame.gbuffer
    return any(g is not None and g.objects is not None for g in (frame, *inputs.slots))


@dataclass(frozen=True)
class NodeFeatures:
    """What is seen at one node of a key interval.

    Attributes
    ----------
    frame
        Output number of the slot that the node decides.
    key
        Input number of the key frame.
    node
        d1 to d5.
    features
        Of the instant at which it is decided.
    inputs
        Of the policy's network, 44 numbers in Q16.16.
    """

    frame: int
    key: int
    node: str
    features: Features
    inputs: tuple[int, ...]


def features(
    settings: SourceSettings, frames: str | None = None, progress: Progress | None = None
) -> Iterator[NodeFeatures]:
    """Yield the features at every node of every key interval.

    Parameters
    ----------
    settings
        The input.
    frames
        Range of key frames by input number; None for all.
    progress
        Receives every key frame.

    Raises
    ------
    InputError
        When the sequence cannot be used.
    MotionError
        When the convention of its motion vectors cannot be settled.
    """
    source = open_source(settings)
    progress = progress or NoProgress()
    keys = source.timeline.select(frames)
    asked = UpsampleSettings(settings, "", CAUSAL)
    reader = IntervalReader(source, FRAMEWISE, asked)
    observer = Observer(source.keys.display, source.setting)
    progress.start(len(keys))
    try:
        for key in keys:
            observed, slots = reader.read_observed(key)
            settled = observer.settled(slots)
            surroundings = observer.surroundings(key, observed, settled, read=slots)
            number = source.timeline.numbers[key]
            for node in NODES:
                yield NodeFeatures(
                    source.timeline.number(Slot(key, NODE_SLOTS[node])),
                    number,
                    node,
                    surroundings.now[NODE_SLOTS[node] - 1],
                    tuple(int(x) for x in to_fixed(surroundings.inputs(node))),
                )
            progress.advance(number)
            check_stop()
    finally:
        progress.finish()
