"""Curves between code values, or the inputs of networks, and scene-linear light.

Networks that interpolate were trained on videos: display-encoded colour from 0 to 1. A rendered
frame has more than that, so they are shown an invertible curve. Where no pixel of the two frames is
above 1, it is the plain curve of the encoding. Else white is moved down, to 3/4 at the least, and a
logarithmic shoulder takes the range from 1 to the brightest value of the two frames. Negative
values mirror positive ones. So a highlight moves with its surface, and is not cut off.

Metrics are defined on display values from 0 to 255, which are clipped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Float32, UInt8


@dataclass(frozen=True)
class TransferCurve:
    """A curve between code values and scene-linear light."""

    name: str  # as in messages
    # From float32 codes, 0 to 1, to float32 scene-linear values
    to_linear: Callable[[Float32], Float32]
    to_code: Callable[[Float32], Float32]  # its inverse; light without a code gets the nearest


def _srgb_to_linear(code: Float32) -> Float32:
    # IEC 61966-2-1, odd: below 0 as above.
    size = np.abs(code)
    curved = ((size + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    low = size / np.float32(12.92)
    return np.copysign(np.where(size <= np.float32(0.04045), low, curved), code)


def _srgb_to_code(linear: Float32) -> Float32:
    size = np.abs(linear)
    curved = np.float32(1.055) * size ** np.float32(1 / 2.4) - np.float32(0.055)
    low = np.float32(12.92) * size
    return np.copysign(np.where(size <= np.float32(0.0031308), low, curved), linear)


_WHITE, _BLACK = 685, 95  # code values of 10 bits
_CODES_PER_DECADE = 300.0  # code values per factor of 10: 0.002 of density each, gamma 0.6
_TOE = 10.0 ** ((_BLACK - _WHITE) / _CODES_PER_DECADE)


def _film_to_linear(code: Float32) -> Float32:
    light = 10.0 ** ((1023.0 * code.astype(np.float64) - _WHITE) / _CODES_PER_DECADE)
    linear: Float32 = ((light - _TOE) / (1 - _TOE)).astype(np.float32)
    return linear


def _film_to_code(linear: Float32) -> Float32:
    least = 10.0 ** (-_WHITE / _CODES_PER_DECADE)  # of code 0
    light = np.maximum(linear.astype(np.float64) * (1 - _TOE) + _TOE, least)
    code: Float32 = ((_WHITE + _CODES_PER_DECADE * np.log10(light)) / 1023.0).astype(np.float32)
    return code


LINEAR = TransferCurve("linear", lambda values: values, lambda values: values)
SRGB = TransferCurve("sRGB", _srgb_to_linear, _srgb_to_code)
# Printing density as film scanners write it, with the usual black of 95 and white of 685. Kennel
# and Snider, "Gray-Scale Transformations of Cineon Digital Film Data", SMPTE Journal, 1993.
FILM = TransferCurve("Cineon log", _film_to_linear, _film_to_code)


# The networks' training data: sRGB's curve (IEC 61966-2-1), scene-linear, or log2(1 + x).
ENCODINGS = ("srgb", "linear", "log")

MIN_WHITE = 0.75  # least code of 1. Frames with a sun would be black to the network without it.


@dataclass(frozen=True)
class ShoulderCurve:
    """The invertible curve between scene-linear colour and a network's input."""

    encoding: str  # out of ENCODINGS
    peak: float  # largest absolute value of the two frames, at least 1; its code is 1

    @classmethod
    def of(cls, encoding: str, before: Float32, after: Float32) -> ShoulderCurve:
        """Return the curve for two frames, float32 of any shape, scene-linear and finite."""
        peak = max(float(np.abs(frame).max(initial=1)) for frame in (before, after))
        return cls(encoding, peak)

    @property
    def white(self) -> float:
        """Code of 1; 1 itself where nothing is brighter."""
        slope = 1.055 / 2.4  # of sRGB at white: a shoulder that starts with it has no kink
        return max(MIN_WHITE, float(1 / (1 + slope * np.log(self.peak))))

    def encode(self, linear: Float32) -> Float32:
        """Return the code of scene-linear colour, float32 of the same shape, -1 to 1."""
        size = np.abs(linear)
        plain = np.minimum(size, 1)
        if self.encoding == "srgb":
            plain = SRGB.to_code(plain)
        elif self.encoding == "log":
            plain = np.log2(1 + plain)
        code = np.float32(self.white) * plain
        if self.peak > 1:
            share = (1 - self.white) / np.log(self.peak)
            code += np.float32(share) * np.log(np.maximum(size, 1))
        signed: Float32 = np.copysign(code, linear)
        return signed

    def decode(self, code: Float32) -> Float32:
        """Invert `encode`; what lies outside of -1 to 1 counts as the nearer end."""
        size = np.minimum(np.abs(code), 1)
        white = np.float32(self.white)
        linear = np.minimum(size / white, 1)
        if self.encoding == "srgb":
            curve = ((linear + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
            toe = linear / np.float32(12.92)
            linear = np.where(linear <= np.float32(12.92 * 0.0031308), toe, curve)
        elif self.encoding == "log":
            linear = np.exp2(linear) - 1
        if self.peak > 1:
            share = np.log(self.peak) / (1 - self.white)
            linear *= np.exp(np.float32(share) * np.maximum(size - white, 0))
        return np.copysign(linear, code)


PEAK = 255.0  # largest display value: the metrics' constants are those of 8-bit images


def encode_display(pixels: Float32) -> Float32:
    """Clip to [0, 1], apply the sRGB curve (IEC 61966-2-1) and scale to 0 … 255.

    Pixels are float32 [H, W, 3 or more], scene-linear with sRGB primaries; alpha is dropped. NaN
    counts as 0 and infinities as the nearer end, so that a broken pixel costs quality instead of
    turning the score into NaN.
    """
    # Not rounded to integers: that would hide errors below half a step.
    linear = np.clip(pixels[..., :3].astype(np.float32), 0, 1)
    linear[np.isnan(linear)] = 0
    # The scale is inside the constants, so that white comes out as 255 and not one ulp below.
    curve = np.float32(1.055 * PEAK) * linear ** np.float32(1 / 2.4) - np.float32(0.055 * PEAK)
    toe = np.float32(12.92 * PEAK) * linear
    display: Float32 = np.where(linear <= np.float32(0.0031308), toe, curve)
    return np.clip(display, 0, np.float32(PEAK))


def round_display(pixels: Float32) -> UInt8:
    """Encode as `encode_display`, and round half up to the 8-bit steps of a PNG."""
    steps: UInt8 = np.floor(encode_display(pixels) + np.float32(0.5)).astype(np.uint8)
    return steps
