"""The frames of a key interval by every system, each different one made once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from exwarp_cli.domain.decision import HOLD
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import Extrapolator, Interpolator
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.ffmpeg import minterpolate
from exwarp_cli.research.bench.systems import IMPORTED, MINTERPOLATE, REPEATED, SLOTS
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS, predict_path


@dataclass
class SystemFrames:
    """Frames of one key interval by the names of `exwarp_cli.research.bench.systems`."""

    interval: Interval  # with the next key frame, its past, and our network
    finish: Callable[[Float32], Float32]  # brings pixels on its window to what is judged
    imported: Extrapolator | None  # ExtraNet, where it is compared
    networks: Mapping[str, Interpolator]  # interpolation networks by the system's name
    _frames: dict[str, Float32] = field(default_factory=dict, init=False)
    _with_imported: Interval | None = field(default=None, init=False)
    _by_ffmpeg: tuple[Float32, ...] = field(default=(), init=False)

    def __getitem__(self, name: str) -> Float32:
        """Return a picture, float32 [H, W, 3 or 4], scene-linear."""
        if name not in self._frames:
            self._frames[name] = self.finish(self._make(name))
        return self._frames[name]

    def _make(self, name: str) -> Float32:
        if name.startswith(IMPORTED):
            if self._with_imported is None:
                self._with_imported = replace(self.interval, extrapolator=self.imported)
            return _take_path_frame(self._with_imported, name.removeprefix(IMPORTED))
        if " " not in name:
            return _take_path_frame(self.interval, name)
        system, number = name.rsplit(" ", 1)
        slot = int(number)
        if system == MINTERPOLATE:
            if not self._by_ffmpeg:
                self._by_ffmpeg = _minterpolate(self.interval)
            return self._by_ffmpeg[slot - 1]
        if system in self.networks:
            with_network = replace(self.interval, interpolator=self.networks[system])
            return _predict("onnx", with_network, slot)
        return _predict(system, self.interval, slot)


def _take_path_frame(interval: Interval, name: str) -> Float32:
    if name == REPEATED:
        return _predict(HOLD, interval, 1)
    if name == "W(E2)":
        return predict_path("S4", interval, FACTOR - 1).pixels
    slot = int(name[1])
    return (
        interval.extrapolated(slot) if name[0] == "E" else predict_path("S6", interval, slot).pixels
    )


def _minterpolate(interval: Interval) -> tuple[Float32, ...]:
    if interval.following is None:  # before a cut, where ffmpeg repeats the frame as well
        return tuple(_predict(HOLD, interval, slot) for slot in SLOTS)
    older = interval.past[0].frame.image.pixels if interval.past else None
    before, after = interval.key.image.pixels, interval.following.image.pixels
    alpha = before[..., 3:]  # which ffmpeg does not make, and no score judges
    frames = minterpolate(older, before, after)
    return tuple(np.concatenate([frame, alpha], axis=-1) for frame in frames)


def _predict(method: str, interval: Interval, slot: int) -> Float32:
    predict = METHODS[method].predict
    assert predict is not None
    return predict(interval, slot).pixels
