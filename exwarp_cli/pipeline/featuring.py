"""The features of a sequence, as the policy sees them, without making any frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from exwarp_cli.accel.fixed_point import to_fixed
from exwarp_cli.domain.decision import NODES, SLOTS
from exwarp_cli.domain.features import Features
from exwarp_cli.domain.settings import SourceSettings, UpsampleSettings
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.pipeline.interval_inputs import IntervalReader
from exwarp_cli.pipeline.observing import Observer
from exwarp_cli.pipeline.progress import NoProgress, Progress
from exwarp_cli.pipeline.source import open_source
from exwarp_cli.runtime.stop import check_stop
from exwarp_cli.synthesis.methods import METHODS


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
        Told of every key frame.

    Raises
    ------
    InputError
        When the sequence cannot be used.
    MotionError
        When the convention of its motion vectors cannot be settled.
    """
    source = open_source(settings)
    told = progress or NoProgress()
    keys = source.timeline.select(frames)
    asked = UpsampleSettings(settings, "", "exwarp")
    reader = IntervalReader(source, METHODS["exwarp"], asked)
    observer = Observer(source.keys.display, source.setting)
    told.start(len(keys))
    try:
        for key in keys:
            observed, slots = reader.read_observed(key)
            settled = observer.settled(slots)
            surroundings = observer.surroundings(key, observed, settled, read=slots)
            number = source.timeline.numbers[key]
            for node in NODES:
                yield NodeFeatures(
                    source.timeline.number(Slot(key, SLOTS[node])),
                    number,
                    node,
                    surroundings.now[SLOTS[node] - 1],
                    tuple(int(x) for x in to_fixed(surroundings.inputs(node))),
                )
            told.advance(number)
            check_stop()
    finally:
        told.finish()
