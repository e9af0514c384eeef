"""The interfaces between ExWarp and networks that extrapolate and interpolate.

A large picture is cut into tiles that overlap, so that what a network makes of them has no seams.
Near its border a tile lacks the pixels that the network would have seen beyond. What lies within
the network's reach of a border inside the picture is therefore made but not kept: it is another
tile's. Tiles begin and end at multiples of the network's stride, where its coarsest pixels do.

Networks that interpolate were trained on videos: display-encoded colour from 0 to 1. A rendered
frame has more than that, so what a network is shown is invertible and loses nothing. Where no pixel
of the two frames is above 1, it is the plain curve of the encoding. Else white is moved down and a
logarithmic shoulder from 1 to the brightest value of the two frames takes the room above it; white
moves to 3/4 at the least, as one bright pixel must not darken the whole picture. Negative values
mirror positive ones. So a highlight moves with its surface, and is not cut off.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network import NetworkGiven, NetworkInterface, NetworkPart

INTERFACE = "exwarp.extrapolator/1"
"""Version of the inputs below; models state it in their metadata."""

HISTORY = 3
"""Rendered frames that the network sees: F_k, F_k-1 and F_k-2."""

INPUTS = {"warped": 6, "mask": 1, "features": 6, "history": 4 * HISTORY}
"""Channels of the picture inputs, float32 [1, channels, H, W] each."""

OUTPUT = "colour"
"""The only output, float32 [1, 3, H, W]."""

EXTRAPOLATES = NetworkInterface(INTERFACE, INPUTS, ("warped", "mask"), OUTPUT, 3)


@dataclass(frozen=True)
class NetworkInputs:
    """What an extrapolation network is given for one slot (ExtraNet's inputs).

    Colour is demodulated, scene-linear, as sign(x) log(1 + |x|), and without alpha.

    Attributes
    ----------
    warped
        float32 [6, H, W]: F_k warped to the slot with holes at 0, then the frame that W makes, with
        holes filled from the background, edges covered and light carried on.
    mask
        float32 [1, H, W]: 1 where F_k shows the slot's surface, 0 in holes.
    features
        float32 [6, H, W] of the slot: world normal (3, background and unknown 0), depth (0 to 1,
        1 is background, unknown 0.5), roughness (unknown 0.5), metallic (unknown 0).
    history
        float32 [12, H, W]: F_k, F_k-1, F_k-2 moved to the slot, newest first, each as colour (3)
        and mask (1). Colour is what lies at the end of the motion, in holes too. The oldest is
        repeated where there are fewer.
    time
        Of the slot in its key interval: 0.25, 0.5 or 0.75.
    """

    warped: Float32
    mask: Float32
    features: Float32
    history: Float32
    time: float

    @property
    def pictures(self) -> dict[str, Float32]:
        """The picture inputs by name, without the batch axis."""
        return {name: getattr(self, name) for name in INPUTS}

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        height, width = self.mask.shape[1:]
        return height, width

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkInputs:
        """Return the inputs of some rows and columns; views of these, so no room is taken."""
        parts = {name: planes[:, rows, columns] for name, planes in self.pictures.items()}
        return NetworkInputs(**parts, time=self.time)


class Inputs(NetworkPart, NetworkGiven, Protocol):
    """What a network is given for one slot, as a whole or part by part as it is wanted.

    The properties are those of `NetworkInputs`, of the whole frame.
    """

    @property
    def warped(self) -> Float32:
        """float32 [6, H, W]."""

    @property
    def mask(self) -> Float32:
        """float32 [1, H, W]."""

    @property
    def features(self) -> Float32:
        """float32 [6, H, W]."""

    @property
    def history(self) -> Float32:
        """float32 [12, H, W]."""

    def part(self, rows: slice, columns: slice, room: Float32 | None = None) -> NetworkInputs:
        """Return the inputs of some rows and columns; see `NetworkGiven`."""


class Extrapolator(Protocol):
    """A network that is ready to run."""

    @property
    def checksum(self) -> str:
        """SHA-256 of the model's file, in hexadecimal digits."""

    def __call__(self, inputs: Inputs) -> Float32:
        """Return the slot's colour, float32 [3, H, W], encoded as the inputs are; any H and W."""


@dataclass(frozen=True)
class Span:
    """A tile along one axis, in pixels of the picture.

    Attributes
    ----------
    begin, end
        What the network is given.
    first, last
        What is kept of its answer: from `first` to before `last`.
    """

    begin: int
    end: int
    first: int
    last: int

    @property
    def seen(self) -> slice:
        """What the network is given."""
        return slice(self.begin, self.end)

    @property
    def kept(self) -> slice:
        """Where what is kept lies in the picture."""
        return slice(self.first, self.last)

    @property
    def inside(self) -> slice:
        """Where what is kept lies in the tile."""
        return slice(self.first - self.begin, self.last - self.begin)


Tile = tuple[Span, Span]
"""Rows and columns."""


@lru_cache(maxsize=8)
def cut(size: tuple[int, int], stride: int, reach: int, most: int) -> tuple[Tile, ...]:
    """Cut a picture into tiles of equal size, as few pixels in all as can be.

    Parameters
    ----------
    size
        Height and width of the picture, multiples of `stride`.
    stride
        Where tiles may begin and end.
    reach
        How many pixels away from one that it is given the network's answer may change.
    most
        Pixels of a tile. Where even the smallest tiles have more, those are taken.

    Returns
    -------
    tuple of Tile
        What they keep covers each pixel once. They go by these numbers alone, so that every part
        of a sequence is cut alike.
    """
    margin = -(-reach // stride)
    rows, columns = (list(_lengths(n // stride, margin)) for n in size)
    every = [(a, b) for a in rows for b in columns]
    fits = [pair for pair in every if pair[0][1] * pair[1][1] * stride**2 <= most]
    chosen = min(fits, key=_work) if fits else min(every, key=lambda pair: pair[0][1] * pair[1][1])
    down, across = (
        _spans(n // stride, count, length, margin, stride)
        for n, (count, length) in zip(size, chosen, strict=True)
    )
    return tuple((row, column) for row in down for column in across)


def _work(pair: tuple[tuple[int, int], tuple[int, int]]) -> tuple[int, int]:
    """Coarsest pixels that are worked on in all; then how many tiles there are."""
    (rows, height), (columns, width) = pair
    return rows * height * columns * width, rows * columns


def _lengths(cells: int, margin: int) -> list[tuple[int, int]]:
    """Return every number of tiles along an axis, with their length; both in strides."""
    found = [(1, cells)]
    for count in range(2, cells - 2 * margin + 1):
        length = -(-(cells - 2 * margin) // count) + 2 * margin
        if length < found[-1][1]:
            found.append((count, length))
    return found


def _spans(cells: int, count: int, length: int, margin: int, stride: int) -> list[Span]:
    """Spread tiles of one length evenly over an axis."""
    starts = [i * (cells - length) // max(count - 1, 1) for i in range(count)]
    firsts = [0, *(start + margin for start in starts[1:])]
    lasts = [*firsts[1:], cells]
    return [
        Span(start * stride, (start + length) * stride, first * stride, last * stride)
        for start, first, last in zip(starts, firsts, lasts, strict=True)
    ]


ENCODINGS = ("srgb", "linear", "log")
"""What networks were trained on: sRGB's curve (IEC 61966-2-1), scene-linear, or log2(1 + x)."""

INTERPOLATE = "interpolate"
"""What makes a frame, beside W and E: the step that its time is booked on."""

LOWEST_WHITE = 0.75
"""Where 1 is shown at the least. Frames with a sun would be black to the network without it."""

_SLOPE = 1.055 / 2.4
"""Of sRGB's curve at 1: a shoulder that starts with it has no kink."""


class Interpolator(Protocol):
    """What makes the frame at any time between two, from their colour alone."""

    @property
    def name(self) -> str:
        """As tables show it."""

    @property
    def checksum(self) -> str:
        """SHA-256 of the model's file, in hexadecimal digits."""

    def __call__(self, before: Float32, after: Float32, time: float) -> Float32:
        """Return the frame at a time, 0 < time < 1, between two frames.

        Frames are float32 [H, W, 3 or 4], finite, scene-linear, with premultiplied alpha.
        """


@dataclass(frozen=True)
class Curve:
    """The invertible curve between scene-linear colour and what a network is shown.

    Attributes
    ----------
    encoding
        Out of `ENCODINGS`.
    peak
        The largest absolute value of the two frames, at least 1; it is shown as 1.
    """

    encoding: str
    peak: float

    @classmethod
    def of(cls, encoding: str, before: Float32, after: Float32) -> Curve:
        """Return the curve for two frames, float32 of any shape, scene-linear and finite."""
        peak = max(float(np.abs(frame).max(initial=1)) for frame in (before, after))
        return cls(encoding, peak)

    @property
    def white(self) -> float:
        """Where 1 is shown; 1 itself where nothing is brighter."""
        return max(LOWEST_WHITE, float(1 / (1 + _SLOPE * np.log(self.peak))))

    def encode(self, linear: Float32) -> Float32:
        """Return what is shown of scene-linear colour: float32 of the same shape, -1 to 1."""
        size = np.abs(linear)
        shown = np.float32(self.white) * _shown(np.minimum(size, 1), self.encoding)
        if self.peak > 1:
            share = (1 - self.white) / np.log(self.peak)
            shown += np.float32(share) * np.log(np.maximum(size, 1))
        signed: Float32 = np.copysign(shown, linear)
        return signed

    def decode(self, shown: Float32) -> Float32:
        """Invert `encode`; what lies outside of -1 to 1 counts as the nearer end."""
        size = np.minimum(np.abs(shown), 1)
        white = np.float32(self.white)
        linear = _linear(np.minimum(size / white, 1), self.encoding)
        if self.peak > 1:
            share = np.log(self.peak) / (1 - self.white)
            linear *= np.exp(np.float32(share) * np.maximum(size - white, 0))
        return np.copysign(linear, shown)


def _shown(linear: Float32, encoding: str) -> Float32:
    """Apply the plain curve to values from 0 to 1."""
    if encoding == "srgb":
        curve = np.float32(1.055) * linear ** np.float32(1 / 2.4) - np.float32(0.055)
        return np.where(linear <= np.float32(0.0031308), np.float32(12.92) * linear, curve)
    return np.log2(1 + linear) if encoding == "log" else linear


def _linear(shown: Float32, encoding: str) -> Float32:
    """Invert `_shown`."""
    if encoding == "srgb":
        curve = ((shown + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
        toe = shown / np.float32(12.92)
        return np.where(shown <= np.float32(12.92 * 0.0031308), toe, curve)
    return np.exp2(shown) - 1 if encoding == "log" else shown
