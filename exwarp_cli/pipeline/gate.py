"""Trials for the gate: rendered key frames, predicted from those around them by two methods.

Which key frame is predicted follows from an interval's place in the sequence and from cuts and
holds, so chunks of a sequence agree. Key frames and intervals are named by their index.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from itertools import chain, takewhile
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.decision import TRIAL_BLOCK, Trial
from exwarp_cli.domain.frame import Image, KeyFrame, Window, place_on_canvas
from exwarp_cli.domain.network_api import HISTORY_FRAMES
from exwarp_cli.domain.tiles import TILE_ROWS, count_columns, tile_edges
from exwarp_cli.domain.timeline import FACTOR, Slot
from exwarp_cli.pipeline.ground_truth import IntervalTruth
from exwarp_cli.pipeline.key_frames import (
    HistoryFrame,
    KeyFrameStore,
    MotionEstimates,
    over_interval,
)
from exwarp_cli.synthesis.methods import Method, predict_both_ways

if TYPE_CHECKING:
    from exwarp_cli.pipeline.interval_builder import IntervalBuilder
    from exwarp_cli.pipeline.interval_inputs import IntervalInputs
    from exwarp_cli.pipeline.source import Source

# Mean squared error of a tile, on the scale of 255, that is added to all: less is not visible.
NEGLIGIBLE = 1.0


@dataclass
class TrialInputs:
    """A key frame to predict, and what it is predicted from; the gate takes that out."""

    key: int | None = None  # None where no key frame can be predicted
    material: TrialMaterial | None = None  # None where an earlier interval brought it along


@dataclass(frozen=True)
class TrialMaterial:
    """What a trial is computed from."""

    around: IntervalInputs  # the key frames around the predicted one, or before it, as one interval
    truth: Image  # the key frame as it was rendered
    number: int  # its input number


@dataclass(frozen=True)
class TrialFrames:
    """What frames depend on by their gate."""

    keys: tuple[int, ...] = ()
    instants: tuple[Slot, ...] = ()  # with G-buffers of their own
    text: str = "gate without a trial"


class TrialReader:
    """Chooses the key frame that is predicted for an interval, and reads it."""

    def __init__(
        self,
        source: Source,
        method: Method,
        store: KeyFrameStore,
        # Returns the key frames that lead back from one, the newest first.
        history: Callable[[int], tuple[int, ...]],
        reads_late: bool,  # True if the store keeps key frames without their surface
    ) -> None:
        self._source, self._store, self._shots = source, store, store.shots
        self._history = history
        self._lookahead = method.lookahead
        self._reads_late = reads_late
        # The key frame whose trial an interval brought along last.
        self.last_read: int | None = None

    def choose(self, key: int) -> int | None:
        """Return the key frame that is predicted for an interval; None if no one can be."""
        block = key // TRIAL_BLOCK * TRIAL_BLOCK
        begin = self._shots.begin(key, key - block + TRIAL_BLOCK)
        candidates: Iterable[int]
        if self._lookahead:
            # The first one of the interval's block, else the last one before the block, that has
            # a neighbour on both sides.
            first = max(block, begin) + 1
            within = takewhile(
                lambda i: not self._shots.starts_at(i), range(first, block + TRIAL_BLOCK)
            )
            candidates = chain(within, range(first - 1, begin, -1))
        else:
            # The newest that the block begins with. Early in a shot that is the fourth at most:
            # with less history a network has nothing to go by.
            newest = block if block - begin >= HISTORY_FRAMES else min(key, begin + HISTORY_FRAMES)
            candidates = range(newest, begin, -1)
        return next((index for index in candidates if self._is_predictable(index)), None)

    def _is_predictable(self, index: int) -> bool:
        """Return True if a key frame can be predicted, and shows another picture than the last."""
        around = (index, index + 1) if self._lookahead else (index,)
        if around[-1] >= len(self._source.timeline.numbers):
            return False
        if any(self._shots.starts_at(i) or self._shots.repeats(i) for i in around):
            return False
        if self._source.slots is None:
            return True
        steps, slots = self._source.timeline.steps or 0, self._slots(index)
        complete = len(slots) == (2 * steps - 1 if self._lookahead else steps)
        return complete and self._store.unreadable.all_readable(slots)

    def frames(self, key: int) -> TrialFrames:
        """Return what the trial of an interval reads, for fingerprints."""
        index = self.choose(key)
        if index is None:
            return TrialFrames()
        instants: tuple[Slot, ...] = ()
        if self._source.slots is not None:
            older = () if self._lookahead else self._history(index - 1)
            instants = (
                *self._slots(index),
                *(slot for i in older for slot in self._store.slots_after(i)),
            )
        return TrialFrames(self._keys(index), instants, f"gate {index - key}")

    def _keys(self, index: int) -> tuple[int, ...]:
        """Return the key frames that a trial reads, ascending."""
        if self._lookahead:
            return (index - 1, index, index + 1)
        return (*reversed(self._history(index - 1)), index - 1, index)

    def _slots(self, index: int) -> tuple[Slot, ...]:
        """Return the instants with G-buffers between the key frames of a trial; often none."""
        if self._source.slots is None:
            return ()
        after = self._store.slots_after(index) if self._lookahead else ()
        return (*self._store.slots_after(index - 1), Slot(index, 0), *after)

    def read(self, key: int, inputs: IntervalInputs) -> TrialInputs:
        """Read the trial of an interval, unless the one before brought the same along.

        `inputs` is the interval as read.

        Raises
        ------
        InputError
            When a file cannot be read.
        """
        index = self.choose(key)
        if index is None or index == self.last_read:
            return TrialInputs(index)
        alone = replace(
            inputs, slots=tuple(map(self._store.get_slot, self._slots(index))), history=(),
            lacks_history=False, observed=(), layers=None, older=None, views=(), trial=None,
            truth=IntervalTruth(), region=False, held=False, after_hold=False,
        )  # fmt: skip
        if not self._lookahead:
            around = self._before(index, alone)
        elif self._source.estimated:
            around = self._by_flow(index, alone)
        else:
            around = self._both_sides(index, alone)
        truth, number = self._store.get(index).image, self._source.timeline.numbers[index]
        self.last_read = index
        return TrialInputs(index, TrialMaterial(around, truth, number))

    def _both_sides(self, index: int, alone: IntervalInputs) -> IntervalInputs:
        """Return an interval of twice the length: the key frame that it leaves out is a slot."""
        frames = (self._store.get_in_shot(i) for i in self._keys(index))
        before, middle, after = map(_with_vectors_both_ways, frames)
        slots = alone.slots
        if self._source.slots is None and middle.gbuffer is not None:
            slots = (middle.gbuffer,)
        times = tuple((i + 1) / (len(slots) + 1) for i in range(len(slots)))
        return replace(
            alone, key=index - 1, frame=_over_two(before), following=_over_two(after), slots=slots,
            times=times,
        )  # fmt: skip

    def _by_flow(self, index: int, alone: IntervalInputs) -> IntervalInputs:
        """Return an interval of twice the length, along motion that is estimated across it."""
        estimates = MotionEstimates(lambda i: self._store.get(index - 1 + 2 * i), 2)
        before, after = estimates.moving(0, False, True), estimates.moving(1, True, False)
        return replace(alone, key=index - 1, frame=before, following=after, slots=(), times=(0.5,))

    def _before(self, index: int, alone: IntervalInputs) -> IntervalInputs:
        """Return the interval before a key frame, whose last slot is at that key frame."""
        store = self._store
        get = store.get_complete if self._reads_late else store.get_in_shot
        history = tuple(
            HistoryFrame(get(i), store.get_way_back(i), self._shots.repeats(i + 1))
            for i in self._history(index - 1)
        )
        times = tuple((i + 1) / FACTOR for i in range(FACTOR))
        return replace(
            alone, key=index - 1, frame=get(index - 1), following=None, history=history, times=times
        )


def _with_vectors_both_ways(frame: KeyFrame) -> KeyFrame:
    """Return a key frame with vectors both ways: those that are missing at constant velocity."""
    gbuffer = frame.gbuffer
    if gbuffer is None or not gbuffer.has_motion:
        return frame
    if gbuffer.to_previous is None:
        assert gbuffer.to_next is not None
        return replace(frame, gbuffer=replace(gbuffer, to_previous=-gbuffer.to_next))
    if gbuffer.to_next is None:
        return replace(frame, gbuffer=replace(gbuffer, to_next=-gbuffer.to_previous))
    return frame


def _over_two(frame: KeyFrame) -> KeyFrame:
    """Return a key frame whose vectors reach over two key intervals, at constant velocity."""
    gbuffer = frame.gbuffer
    return frame if gbuffer is None else replace(frame, gbuffer=over_interval(gbuffer, 2))


class Gate:
    """Decides for each interval whether the network may make its frames.

    `builder` builds the intervals of trials, and of nothing else. Predictions are compared on the
    window `display`.
    """

    def __init__(self, method: Method, builder: IntervalBuilder, display: Window) -> None:
        self._method, self._builder, self._display = method, builder, display
        self._received = TrialInputs()
        self._last_key: int | None = None
        self._last_trial = Trial()

    def receive(self, inputs: TrialInputs) -> None:
        """Keep what an interval brings along until its trial is asked for."""
        if inputs.material is not None:
            # The interval lives on while it is rendered, and these frames are as large as it is.
            self._received = TrialInputs(inputs.key, inputs.material)
            inputs.material = None

    def decide(self, inputs: TrialInputs) -> Trial:
        """Return the trial of an interval, of which it or one before brought the material along."""
        if inputs.key is None:
            return Trial()
        if inputs.key != self._last_key:
            assert self._received.key == inputs.key and self._received.material is not None
            self._last_trial = self._predict(self._received.material)
            self._last_key, self._received = inputs.key, TrialInputs()
            self._builder.forget()
        return self._last_trial

    def _predict(self, material: TrialMaterial) -> Trial:
        from exwarp_cli.domain.colour import encode_display
        from exwarp_cli.metrics.registry import measure_psnr

        interval = self._builder.build(material.around)
        lookahead, count = self._method.lookahead, len(interval.times)
        slot = count // 2 + 1 if lookahead else count
        canvas = interval.key.image.data_window
        truth = encode_display(material.truth.on(self._display).pixels)
        warped, by_network = (
            measure_psnr(truth, encode_display(place_on_canvas(pixels, canvas, self._display)))
            for pixels in predict_both_ways(interval, slot, lookahead)
        )
        if lookahead:
            values = mean_tile_psnr(warped.per_pixel), mean_tile_psnr(by_network.per_pixel)
        else:
            # What extrapolation gains lies in holes: by the mean of tiles it was refused on the
            # scene town, where it gains 0.8 dB.
            values = warped.overall(), by_network.overall()
        return Trial.measured(material.number, *values)


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
