"""A few frames of a benchmark made once more, to be looked at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from exwarp_cli.domain.bench import CHOOSERS, BenchSettings
from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.pipeline.bench.opened import Opened, load_networks
from exwarp_cli.pipeline.bench.pictures import FIXED_PATHS, names_of
from exwarp_cli.pipeline.bench.work import Measured
from exwarp_cli.pipeline.scoring import SLOTS


@dataclass(frozen=True)
class Sample:
    """One slot by several systems.

    Attributes
    ----------
    number
        Output number.
    key
        Input number of the key frame before.
    slot
        1 to 3.
    truth
        float32 [H, W, 3 or more], scene-linear.
    pixels
        By system, of the same shape.
    mask
        bool [H, W], holes of W; None without motion.
    """

    number: int
    key: int
    slot: int
    truth: Float32
    pixels: dict[str, Float32]
    mask: Bool | None


def samples(
    settings: BenchSettings, measured: Measured, keys: Sequence[int], systems: Sequence[str]
) -> Iterator[Sample]:
    """Make the frames of some key intervals by some systems.

    Parameters
    ----------
    settings
        Of the benchmark.
    measured
        What it found for the subject: the paths that were taken.
    keys
        Input numbers of key frames, ascending.
    systems
        By name.
    """
    opened = Opened(measured.subject, settings, load_networks(settings, None))
    index = {opened.number(key): key for key in opened.keys}
    parts = {part["key"]: part for part in measured.parts}
    for number in keys:
        key = index[number]
        opened.restart()
        loaded = opened.load(key, lambda recipes: True)
        interval = opened.interval(loaded)
        pictures, masks = opened.pictures(loaded, interval), opened.masks(interval)
        truth, paths = opened.truth(key), FIXED_PATHS | parts[number]["paths"]
        shown = {
            name: names_of(name, paths.get(name))
            for name in systems
            if name not in CHOOSERS or name in paths
        }
        for slot in SLOTS:
            yield Sample(
                opened.source.timeline.number(Slot(key, slot)),
                number,
                slot,
                truth[slot],
                {name: pictures[names[slot - 1]] for name, names in shown.items()},
                masks.get(slot),
            )
