"""The frames of a key interval by every system, each different one made once.

A picture's name tells how it was made, so that systems which show the same frame share it: ``F``
is the key frame again, ``W2`` the key frame warped to slot 2, ``E3`` extrapolated to slot 3,
``W(E2)`` the extrapolated frame of slot 2 warped to slot 3. Those of other systems are
``NAME SLOT``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from exwarp_cli.domain.bench import EXTRANET, EXTRANET_FAST, FIXED, MINTERPOLATE, ONNX
from exwarp_cli.domain.decision import EXTRAPOLATE, HOLD, PATHS, WARP
from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import INTERPOLATE, Extrapolator, Interpolator
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.io.minterpolate import minterpolate
from exwarp_cli.pipeline.scoring import SLOTS
from exwarp_cli.synthesis.interval import Interval
from exwarp_cli.synthesis.methods import METHODS, take

REPEATED = "F"

IMPORTED = "extranet "
"""Before the names of pictures that the imported ExtraNet has made, or that come from those."""

FIRST_SLOTS = {REPEATED: 1, "W1": 1, "W2": 2, "E2": 2, "W3": 3, "W(E2)": 3, "E3": 3}
"""Every picture that a decision path shows, by the first slot at which it can stand."""

FIXED_PATHS = {name: name.upper() for name in FIXED} | {EXTRANET: "S1", EXTRANET_FAST: "S3"}
"""The path that a system takes in every key interval."""


def name_on(made_by: Sequence[str], slot: int) -> str:
    """Return the name of the picture that stands at a slot, 1 to 3.

    Parameters
    ----------
    made_by
        What makes the frames of slots 1 to 3 of a decision path: warp, extrapolate or hold.
    slot
        Which of them.
    """
    maker = made_by[slot - 1]
    if maker == HOLD:
        return REPEATED if slot == 1 else name_on(made_by, slot - 1)
    if maker == WARP and slot == FACTOR - 1 and made_by[1] == EXTRAPOLATE:
        return "W(E2)"
    return f"{'E' if maker == EXTRAPOLATE else 'W'}{slot}"


def names_of(system: str, path: str | None) -> tuple[str, ...]:
    """Return the names of the pictures that a system shows at slots 1 to 3.

    Parameters
    ----------
    system
        Its name.
    path
        The path that it takes in this interval; None for one outside the decision tree.
    """
    if path is not None:
        names = [name_on(PATHS[path].made_by, slot) for slot in SLOTS]
        foreign = system in (EXTRANET, EXTRANET_FAST)
        return tuple(IMPORTED + name if foreign and "E" in name else name for name in names)
    if system == HOLD:
        return (REPEATED,) * len(SLOTS)
    return tuple(f"{system} {slot}" for slot in SLOTS)


def makers_of(system: str, path: str | None) -> tuple[str, ...]:
    """Return what makes the frames of slots 1 to 3: warp, extrapolate, interpolate or hold."""
    if path is not None:
        return PATHS[path].made_by
    if system.startswith(ONNX):
        return (INTERPOLATE,) * len(SLOTS)
    return (HOLD if system == HOLD else WARP,) * len(SLOTS)


@dataclass
class Pictures:
    """Frames of one key interval.

    Attributes
    ----------
    interval
        With the next key frame, its past, and our network.
    finish
        Brings pixels on the interval's window to what is judged.
    imported
        ExtraNet, where it is compared.
    networks
        Interpolation networks by the system's name.
    """

    interval: Interval
    finish: Callable[[Float32], Float32]
    imported: Extrapolator | None
    networks: Mapping[str, Interpolator]
    _made: dict[str, Float32] = field(default_factory=dict, init=False)
    _other: Interval | None = field(default=None, init=False)
    _between: tuple[Float32, ...] = field(default=(), init=False)

    def __getitem__(self, name: str) -> Float32:
        """Return a picture, float32 [H, W, 3 or 4], scene-linear."""
        if name not in self._made:
            self._made[name] = self.finish(self._make(name))
        return self._made[name]

    def _make(self, name: str) -> Float32:
        if name.startswith(IMPORTED):
            return self._ours(self._with_imported(), name.removeprefix(IMPORTED))
        if " " not in name:
            return self._ours(self.interval, name)
        system, number = name.rsplit(" ", 1)
        slot = int(number)
        if system == MINTERPOLATE:
            return self._by_ffmpeg()[slot - 1]
        if system in self.networks:
            with_network = replace(self.interval, interpolator=self.networks[system])
            return _predicted("onnx", with_network, slot)
        return _predicted(system, self.interval, slot)

    @staticmethod
    def _ours(interval: Interval, name: str) -> Float32:
        if name == REPEATED:
            return _predicted(HOLD, interval, 1)
        if name == "W(E2)":
            return take("S4", interval, FACTOR - 1).pixels
        slot = int(name[1])
        return interval.extrapolated(slot) if name[0] == "E" else take("S6", interval, slot).pixels

    def _by_ffmpeg(self) -> tuple[Float32, ...]:
        if not self._between:
            interval = self.interval
            if interval.following is None:  # before a cut, where ffmpeg repeats the frame as well
                return tuple(_predicted(HOLD, interval, slot) for slot in SLOTS)
            older = interval.past[0].frame.image.pixels if interval.past else None
            before, after = interval.key.image.pixels, interval.following.image.pixels
            alpha = before[..., 3:]  # which ffmpeg does not make, and no score judges
            self._between = tuple(
                np.concatenate([made, alpha], axis=-1)
                for made in minterpolate(older, before, after)
            )
        return self._between

    def _with_imported(self) -> Interval:
        if self._other is None:
            self._other = replace(self.interval, extrapolator=self.imported)
        return self._other


def _predicted(method: str, interval: Interval, slot: int) -> Float32:
    predict = METHODS[method].predict
    assert predict is not None
    return predict(interval, slot).pixels
