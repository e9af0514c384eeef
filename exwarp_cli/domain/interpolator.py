"""The interface between ExWarp and a network that interpolates, and the colour that it is shown.

Such networks were trained on videos: display-encoded colour from 0 to 1. A rendered frame has more
than that, so what a network is shown is invertible and loses nothing. Where no pixel of the two
frames is above 1, it is the plain curve of the encoding. Else white is moved down and a logarithmic
shoulder from 1 to the brightest value of the two frames takes the room above it; white moves to 3/4
at the least, as one bright pixel must not darken the whole picture. Negative values mirror positive
ones. So a highlight moves with its surface, and is not cut off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from exwarp_cli.domain.frame import Float32

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
