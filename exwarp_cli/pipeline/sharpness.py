"""How sharp new frames are beside their key frames, where no ground truth tells it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

from exwarp_cli.domain.frame import Image
from exwarp_cli.domain.results import FrameRecord
from exwarp_cli.domain.timeline import Slot
from exwarp_cli.errors import InputError
from exwarp_cli.io.footage import picture
from exwarp_cli.metrics.temporal import interpolate_gradient, mean_gradient, pulse
from exwarp_cli.pipeline.source import Source


class KeyedPulses:
    """Takes mean gradients during a run; returns the pulse of new frames at its end.

    A pulse depends on a frame and on the key frames around it alone, so any split into chunks gives
    the same values.

    Parameters
    ----------
    source
        The view that is scored.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self._keys: dict[int, float] = {}
        self._frames: dict[int, tuple[Slot, float]] = {}
        self._last_of_shot: set[int] = set()

    def add_key(self, key: int, image: Image, followed: bool) -> None:
        """Take a key frame, by its index.

        Parameters
        ----------
        key
            Its index.
        image
            Its colour.
        followed
            Whether a key frame of the same shot comes after it.
        """
        self._keys[key] = mean_gradient(image.on(self._source.keys.display).pixels)
        if not followed:
            self._last_of_shot.add(key)

    def add(self, number: int, slot: Slot, gradient: float) -> None:
        """Take a new frame, by its output number; its key frame was taken before."""
        self._frames[number] = slot, gradient

    def complete(self, records: Sequence[FrameRecord]) -> Iterator[FrameRecord]:
        """Yield the records of a run; those of frames that were taken have their pulse."""
        for record in records:
            if record.number in self._frames:
                yield replace(record, key_pulse=self._pulse(*self._frames[record.number]))
            else:
                yield record

    def _pulse(self, slot: Slot, gradient: float) -> float:
        after = None if slot.key in self._last_of_shot else self._after(slot.key + 1)
        time = float(self._source.timeline.time(slot))
        return pulse(gradient, interpolate_gradient(self._keys[slot.key], after, time))

    def _after(self, key: int) -> float | None:
        """Return the gradient of a next key frame; read it if the run did not, else None."""
        if key not in self._keys:
            keys = self._source.keys
            # A causal method makes its frames without it, so a damaged one is no error.
            with suppress(InputError):
                image = picture(keys.sequence, self._source.timeline.numbers[key], keys.view)
                self._keys[key] = mean_gradient(image.on(keys.display).pixels)
        return self._keys.get(key)
