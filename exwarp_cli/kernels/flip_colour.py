"""The colours that FLIP compares: from either kind of image to opponent colours.

Andersson et al., "FLIP: A Difference Evaluator for Alternating Images" (2020), section 4.1.1. The
planes are the paper's YCxCz without its scales and offset, which filters leave as they are: sums of
float32 keep more digits of dark colours that way.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.flip_powers import power

F32 = npt.NDArray[np.float32]

PLANES = 3
"""Opponent colours of an image: y, x - y and y - z, each of x, y, z 0 to 1 (white)."""

_ZERO, _ONE = np.float32(0), np.float32(1)

# Linear sRGB to CIE XYZ, as the paper's code has it, in relation to white: rows sum to 1.
TO_XYZ = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
TO_XYZ /= TO_XYZ.sum(axis=1, keepdims=True)
_XR, _XG, _XB, _YR, _YG, _YB, _ZR, _ZG, _ZB = TO_XYZ.astype(np.float32).ravel()
_RX, _RY, _RZ, _GX, _GY, _GZ, _BX, _BY, _BZ = np.linalg.inv(TO_XYZ).astype(np.float32).ravel()

_SRGB_TOE, _SRGB_EXPONENT = np.float32(0.04045), np.float32(2.4)
_SRGB_SLOPE, _SRGB_SCALE = np.float32(1 / 12.92), np.float32(1 / 1.055)
_SRGB_OFFSET = np.float32(0.055 / 1.055)
_PEAK, _UNIT = np.float32(255), np.float32(1 / 255)

# ACES as Narkowicz fits it, with the exposure of 0.6 that goes with the fit: a quotient of two
# quadratic polynomials.
_N2, _N1 = np.float32(0.6**2 * 2.51), np.float32(0.6 * 0.03)
_D2, _D1, _D0 = np.float32(0.6**2 * 2.43), np.float32(0.6 * 0.59), np.float32(0.14)


def _saturated(shown: np.float32) -> np.float32:
    """Return the value of which the tone mapper makes `shown`.

    With coefficients of float32, as the authors' package has it: where luminances lie whole stops
    apart, the last digit decides on how many exposures there are.
    """
    a, b, c = (float(v) for v in (_N2 - shown * _D2, _N1 - shown * _D1, -shown * _D0))
    return np.float32((-b + np.sqrt(b * b - 4 * a * c)) / (2 * a))


SATURATED = _saturated(np.float32(0.85))
"""What HDR-FLIP counts as just not too bright."""


@inlined
def to_xyz(r: np.float32, g: np.float32, b: np.float32) -> tuple[np.float32, ...]:
    """Return CIE XYZ in relation to white, 0 to 1, of linear colour, 0 to 1."""
    x = _XR * r + _XG * g + _XB * b
    y = _YR * r + _YG * g + _YB * b
    z = _ZR * r + _ZG * g + _ZB * b
    return x, y, z


@inlined
def to_linear(x: np.float32, y: np.float32, z: np.float32) -> tuple[np.float32, ...]:
    """Return linear colour of CIE XYZ in relation to white: the inverse of `to_xyz`."""
    r = _RX * x + _RY * y + _RZ * z
    g = _GX * x + _GY * y + _GZ * z
    b = _BX * x + _BY * y + _BZ * z
    return r, g, b


@part
def _take(image: F32, row: int, channel: int, out: F32) -> None:
    """Copy a channel of one row: LLVM vectorises what follows only where pixels lie together."""
    for i in range(out.size):
        out[i] = image[row, i, channel]


@part
def _decode_line(line: F32) -> None:
    """Turn display-encoded values, 0 to 255, into linear colour, 0 to 1; in place."""
    for i in range(line.size):
        v = min(max(line[i], _ZERO), _PEAK) * _UNIT
        curve = power(v * _SRGB_SCALE + _SRGB_OFFSET, _SRGB_EXPONENT)
        line[i] = v * _SRGB_SLOPE if v <= _SRGB_TOE else curve


@part
def _tone_line(line: F32, gain: np.float32) -> None:
    """Turn linear values, 0 or more, into what ACES makes of them at an exposure; in place."""
    for i in range(line.size):
        v = line[i] * gain
        line[i] = min(v * (v * _N2 + _N1) / (v * (v * _D2 + _D1) + _D0), _ONE)


@part
def _oppose(r: F32, g: F32, b: F32, row: int, planes: F32) -> None:
    """Write a row of linear colours, each float32 [W], as opponent colours."""
    achromatic, red_green, blue_yellow = planes[0, row], planes[1, row], planes[2, row]
    for i in range(r.size):
        x, y, z = to_xyz(r[i], g[i], b[i])
        achromatic[i] = y
        red_green[i] = x - y
        blue_yellow[i] = y - z


@part
def _decode_row(image: F32, row: int, planes: F32) -> None:
    """Write one row of a display-encoded image as opponent colours."""
    lines = np.empty((3, image.shape[1]), np.float32)
    for c in range(3):
        _take(image, row, c, lines[c])
        _decode_line(lines[c])
    _oppose(lines[0], lines[1], lines[2], row, planes)


@part
def _tone_row(image: F32, gain: np.float32, row: int, planes: F32) -> None:
    """Write one row of a scene-linear image as opponent colours."""
    lines = np.empty((3, image.shape[1]), np.float32)
    for c in range(3):
        _take(image, row, c, lines[c])
        _tone_line(lines[c], gain)
    _oppose(lines[0], lines[1], lines[2], row, planes)


@parallel
def decode(image: F32, planes: F32, share: Share) -> None:
    """Write the opponent colours of a display-encoded image.

    Parameters
    ----------
    image
        float32 [H, W, 3 or more], 0 to 255 with sRGB primaries; what is outside is clipped.
    planes
        float32 [PLANES, H, W], written.
    """
    for row in turns(image.shape[0], share):
        _decode_row(image, row, planes)


@parallel
def expose(image: F32, gain: np.float32, planes: F32, share: Share) -> None:
    """Write the opponent colours of a scene-linear image as it is shown at an exposure.

    Parameters
    ----------
    image
        float32 [H, W, 3 or more], 0 to 65504 with sRGB primaries.
    gain
        float32, what colours are multiplied with before the tone mapper: up to 2^25.
    planes
        float32 [PLANES, H, W], written.
    """
    for row in turns(image.shape[0], share):
        _tone_row(image, gain, row, planes)
