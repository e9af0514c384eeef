"""Trials for the gate: rendered key frames, predicted from those around them by two methods.

Which key frame is predicted follows from an interval's place in the sequence and from cuts and
holds, so chunks of a sequence agree. Key frames and intervals are named by their index.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import chain, takewhile
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import TRIAL_BLOCK, Trial
from exwarp_cli.domain.frame import KeyFrame, place_on_canvas
from exwarp_cli.domain.network_api import HISTORY_FRAMES
from exwarp_cli.domain.tiles import TILE_ROWS, count_columns, tile_edges
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.pipeline import key_frames
from exwarp_cli.pipeline.ground_truth import IntervalTruth
from exwarp_cli.synthesis.methods import Method, predict_both_ways

if TYPE_CHECKING:
    from exwarp_cli.pipeline.interval_inputs import IntervalInputs
    from exwarp_cli.pipeline.job import Job

# Mean squared error of a tile, on the scale of 255, that is added to all: less is not visible.
NEGLIGIBLE = 1.0


@dataclass
class TrialInputs:
    """A key frame to predict, and what it is predicted from; the gate takes that out."""

    key: int | None = None  # None where no key frame can be predicted
    # The key frames around it, or before it, as one interval, of whose last or middle slot it is
    # the truth; None where an earlier interval brought these along.
    around: IntervalInputs | None = None


@dataclass
class TrialReader:
    """Chooses the key frame that is predicted for an interval, and reads it."""

    store: key_frames.KeyFrameStore
    lookahead: bool  # whether key frames on both sides predict
    # Returns the key frames that lead back from one, the newest first.
    history: Callable[[int], tuple[int, ...]]
    reads_late: bool  # True if the store keeps key frames without their surface
    last_read: int | None = None  # the key frame whose trial an interval brought along last

    def choose(self, key: int) -> int | None:
        """Return the key frame that is predicted for an interval; None if no one can be."""
        block = key // TRIAL_BLOCK * TRIAL_BLOCK
        begin = self.store.shots.begin(key, key - block + TRIAL_BLOCK)
        candidates: Iterable[int]
        if self.lookahead:
            # The first one of the interval's block, else the last one before the block, that has
            # a neighbour on both sides.
            first = max(block, begin) + 1
            within = takewhile(
                lambda i: not self.store.shots.starts_at(i), range(first, block + TRIAL_BLOCK)
            )
            candidates = chain(within, range(first - 1, begin, -1))
        else:
            # The newest that the block begins with. Early in a shot that is the fourth at most:
            # with less history a network has nothing to go by.
            newest = block if block - begin >= HISTORY_FRAMES else min(key, begin + HISTORY_FRAMES)
            candidates = range(newest, begin, -1)
        shots, timeline = self.store.shots, self.store.source.timeline
        steps = timeline.steps or 0
        for index in candidates:
            around = (index, index + 1) if self.lookahead else (index,)
            if around[-1] >= len(timeline.numbers):
                continue
            # It has to show another picture than the one before.
            if any(shots.starts_at(i) or shots.repeats(i) for i in around):
                continue
            if self.store.source.slots is None:
                return index
            slots = self._slots(index)
            complete = len(slots) == (2 * steps - 1 if self.lookahead else steps)
            if complete and not self.store.unreadable.has(*slots):
                return index
        return None

    def frames(self, key: int) -> tuple[tuple[int, ...], tuple[Slot, ...], str]:
        """Return what the trial of an interval reads, for fingerprints.

        The key frames, the instants with G-buffers of their own, and a text.
        """
        index = self.choose(key)
        if index is None:
            return (), (), "gate without a trial"
        older = () if self.lookahead else self.history(index - 1)
        keys = (*reversed(older), index - 1, index, *((index + 1,) if self.lookahead else ()))
        way_back = (slot for i in older for slot in self.store.slots_after(i))
        return keys, (*self._slots(index), *way_back), f"gate {index - key}"

    def _slots(self, index: int) -> tuple[Slot, ...]:
        """Return the instants with G-buffers between the key frames of a trial; often none."""
        if self.store.source.slots is None:
            return ()
        after = self.store.slots_after(index) if self.lookahead else ()
        return (*self.store.slots_after(index - 1), Slot(index, 0), *after)

    def read(self, key: int, inputs: IntervalInputs) -> TrialInputs:
        """Read the trial of an interval, unless the one before brought the same along.

        `inputs` is the interval as read. Raises InputError when a file cannot be read.
        """
        from exwarp_cli.pipeline.interval_inputs import IntervalInputs

        index = self.choose(key)
        if index is None or index == self.last_read:
            return TrialInputs(index)
        store = self.store
        slots = tuple(map(store.get_slot, self._slots(index)))
        following: KeyFrame | None = None
        history: tuple[key_frames.HistoryFrame, ...] = ()
        if not self.lookahead:
            # The interval before the key frame, whose last slot is at that key frame.
            history = store.get_history(self.history(index - 1), self.reads_late)
            get = store.get_complete if self.reads_late else store.get_in_shot
            frame, times = get(index - 1), tuple((i + 1) / FACTOR for i in range(FACTOR))
        elif self.store.source.estimated:
            # An interval of twice the length, along motion that is estimated across it.
            estimates = key_frames.MotionEstimates(lambda i: store.get(index - 1 + 2 * i), 2)
            frame, following = estimates.moving(0, False, True), estimates.moving(1, True, False)
            times = (0.5,)
        else:
            # An interval of twice the length: the key frame that it leaves out is a slot.
            before, middle, after = map(store.get_in_shot, (index - 1, index, index + 1))
            frame, following = _vectors_over(before, 2), _vectors_over(after, 2)
            between = None if store.source.slots is not None else _vectors_over(middle, 1).gbuffer
            if between is not None:
                slots = (between,)
            times = tuple((i + 1) / (len(slots) + 1) for i in range(len(slots)))
        slot = len(times) // 2 + 1 if self.lookahead else len(times)
        around = IntervalInputs(
            index - 1,
            inputs.template,
            frame,
            following,
            slots,
            history,
            times=times,
            truth=IntervalTruth({slot: store.get(index).image}),
            rendered=inputs.rendered,
        )
        self.last_read = index
        return TrialInputs(index, around)


def _vectors_over(frame: KeyFrame, intervals: int) -> KeyFrame:
    """Return a key frame with vectors both ways, over so many intervals, at constant velocity."""
    gbuffer = frame.gbuffer
    if gbuffer is None or not gbuffer.has_motion:
        return frame
    before, after = gbuffer.to_previous, gbuffer.to_next
    if before is None and after is not None:
        before = -after
    elif after is None and before is not None:
        after = -before
    both = replace(gbuffer, to_previous=before, to_next=after)
    return replace(frame, gbuffer=key_frames.over_interval(both, intervals))


@dataclass
class Gate:
    """Decides for each interval whether the network may make its frames."""

    job: Job
    method: Method
    _received: IntervalInputs | None = None
    _last_key: int | None = None
    _last_trial: Trial = field(default_factory=Trial)

    def receive(self, inputs: TrialInputs) -> None:
        """Keep what an interval brings along until its trial is asked for."""
        if inputs.around is not None:
            # The interval lives on while it is rendered, and these frames are as large as it is.
            self._received, inputs.around = inputs.around, None

    def decide(self, inputs: TrialInputs) -> Trial:
        """Return the trial of an interval, of which it or one before brought the material along."""
        from exwarp_cli.domain.colour import encode_display
        from exwarp_cli.metrics.registry import measure_psnr
        from exwarp_cli.pipeline.interval_builder import IntervalBuilder

        if inputs.key is None:
            return Trial()
        if inputs.key == self._last_key:
            return self._last_trial
        around, lookahead = self._received, self.method.lookahead
        assert around is not None and around.key == inputs.key - 1
        job, source, display = self.job, self.job.source, self.job.source.keys.display
        interval = IntervalBuilder(
            display, job.network, job.interpolator, source.estimated, scratch=source.scratch
        ).build(around)
        ((slot, image),) = around.truth.frames.items()
        canvas = interval.key.image.data_window
        truth = encode_display(image.on(display).pixels)
        warped, by_network = (
            measure_psnr(truth, encode_display(place_on_canvas(pixels, canvas, display)))
            for pixels in predict_both_ways(interval, slot, lookahead)
        )
        if lookahead:
            values = mean_tile_psnr(warped.per_pixel), mean_tile_psnr(by_network.per_pixel)
        else:
            # What extrapolation gains lies in holes: by the mean of tiles it was refused on the
            # scene town, where it gains 0.8 dB.
            values = warped.value(), by_network.value()
        self._last_trial = Trial.measured(source.timeline.numbers[inputs.key], *values)
        self._last_key, self._received = inputs.key, None
        return self._last_trial


def mean_tile_psnr(error: npt.NDArray[np.floating]) -> float:
    """Return the mean of the PSNR of all tiles of a frame, dB.

    `error` is [H, W]: squared errors on the scale of 255.
    """
    from exwarp_cli.domain.colour import PEAK

    # Over twice as long a gap errors are larger than between key frames, above all the largest
    # ones, and a network that mends these may harm all the rest. With the PSNR of the whole frame a
    # network of spoilt weights was chosen on one scene of seven, where it lost 0.6 dB.
    height, width = error.shape
    rows = tile_edges(height, min(2 * TILE_ROWS, height))
    columns = tile_edges(width, min(2 * count_columns(width, height), width))
    sums = np.add.reduceat(np.add.reduceat(error, rows[:-1]), columns[:-1], axis=1)
    means = sums / np.outer(np.diff(rows), np.diff(columns))
    return float(np.mean(10 * np.log10(PEAK**2 / (means + NEGLIGIBLE))))
