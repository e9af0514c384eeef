"""FLIP: what a viewer sees of an image, and how far two images are apart in it.

Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström, Fairchild, "FLIP: A Difference Evaluator for
Alternating Images", Proceedings of the ACM on Computer Graphics and Interactive Techniques 3(2),
2020; sections in the text are its.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels import flip_filters as filters
from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.flip_colour import TO_XYZ, to_linear, to_xyz
from exwarp_cli.kernels.flip_powers import power

F32 = npt.NDArray[np.float32]

SEEN = 5
"""Planes of what is seen: lightness, red-green, blue-yellow, strength of edges and of points."""

_ZERO, _ONE = np.float32(0), np.float32(1)

# CIELAB; all of it scaled so that lightness is 0 to 100.
_LAB_TOE, _LAB_SLOPE = np.float32((6 / 29) ** 3), np.float32(29**2 / (3 * 6**2))
_LAB_OFFSET, _THIRD = np.float32(4 / 29), np.float32(1 / 3)
_L1, _L0, _HUNT = np.float32(116), np.float32(16), np.float32(0.01)
_A1, _B1 = np.float32(500), np.float32(200)


@inlined
def lab_curve(value: np.float32) -> np.float32:
    """Return CIELAB's cube root with its straight toe, of 0 to 1."""
    toe = value * _LAB_SLOPE + _LAB_OFFSET
    return power(value, _THIRD) if value > _LAB_TOE else toe


@inlined
def clipped(value: np.float32) -> np.float32:
    """Return the value that lies in 0 to 1."""
    return min(max(value, _ZERO), _ONE)


@part
def _colour(parts: F32, row: int, seen: F32) -> None:
    """Turn filtered opponent colours, the first of `_PASSES`, into CIELAB with Hunt's effect.

    Section 4.1.2: what no display can show is clipped first; chroma is scaled by lightness.
    """
    achromatic, red_green, wide, narrow = parts[0], parts[1], parts[2], parts[3]
    lightness, a, b = seen[0, row], seen[1, row], seen[2, row]
    for i in range(lightness.size):
        y = achromatic[i]
        x, z = y + red_green[i], y - (wide[i] + narrow[i])
        red, green, blue = to_linear(x, y, z)
        x, y, z = to_xyz(clipped(red), clipped(green), clipped(blue))
        fx, fy, fz = lab_curve(x), lab_curve(y), lab_curve(z)
        light = _L1 * fy - _L0
        lightness[i] = light
        a[i] = _HUNT * light * (_A1 * (fx - fy))
        b[i] = _HUNT * light * (_B1 * (fy - fz))


@part
def _length(a: F32, b: F32, out: F32) -> None:
    """Write the length of the vectors (a, b); all float32 [W]."""
    for i in range(out.size):
        out[i] = np.sqrt(a[i] * a[i] + b[i] * b[i])


_PASSES = np.array(
    [
        (0, filters.BRIGHT, filters.BRIGHT),
        (1, filters.RED_GREEN, filters.RED_GREEN),
        (2, filters.WIDE, filters.WIDE_SHARE),
        (2, filters.NARROW, filters.NARROW_SHARE),
        (0, filters.BELL, filters.SLOPE),
        (0, filters.SLOPE, filters.BELL),
        (0, filters.BELL, filters.BEND),
        (0, filters.BEND, filters.BELL),
    ]
)
"""The plane, the filter down and the filter along. A table, as each call compiles for 0.1 s."""


@part
def _perceive_row(planes: F32, row: int, seen: F32) -> None:
    """Filter, and write one row of all planes of what is seen."""
    width = planes.shape[2]
    line = np.empty(width + 2 * filters.HALO, np.float32)
    parts = np.empty((_PASSES.shape[0], width), np.float32)
    for n in range(_PASSES.shape[0]):
        plane, down, along = _PASSES[n, 0], _PASSES[n, 1], _PASSES[n, 2]
        filters.filter_down(planes[plane], row, down, line)
        filters.filter_along(line, along, parts[n])
    _colour(parts, row, seen)
    _length(parts[4], parts[5], seen[3, row])
    _length(parts[6], parts[7], seen[4, row])


@parallel
def perceive(planes: F32, seen: F32, share: Share) -> None:
    """Write what a viewer sees of an image (sections 4.1.1, 4.1.2 and 4.2.1).

    Parameters
    ----------
    planes
        float32 [PLANES, H, W], opponent colours.
    seen
        float32 [SEEN, H, W], written: lightness, 0 to 100, red-green and blue-yellow of CIELAB
        with Hunt's effect, after the blur of the eye; strength of edges and of points, 0 to
        sqrt(2).
    """
    for row in turns(planes.shape[1], share):
        _perceive_row(planes, row, seen)


def _farthest() -> float:
    """Return the distance of green and blue, the colours farthest apart (section 4.1.3)."""

    def lab(colour: tuple[int, int, int]) -> npt.NDArray[np.float64]:
        x, y, z = np.cbrt(TO_XYZ @ np.array(colour, np.float64))
        lightness = 116 * y - 16
        chroma = 0.01 * lightness
        return np.array([lightness, chroma * 500 * (x - y), chroma * 200 * (y - z)])

    apart = lab((0, 1, 0)) - lab((0, 0, 1))
    return float((abs(apart[0]) + np.hypot(apart[1], apart[2])) ** 0.7)


# Distances to the power of 0.7; those below 0.4 of the largest take 0.95 of the range.
_DISTANCE_EXPONENT = np.float32(0.7)
_LARGEST = _farthest()
_BEND, _AT_BEND = np.float32(0.4 * _LARGEST), np.float32(0.95)
_BELOW, _ABOVE = np.float32(0.95 / (0.4 * _LARGEST)), np.float32((1 - 0.95) / (0.6 * _LARGEST))

_ROOT_HALF = np.float32(np.sqrt(0.5))


@part
def _differ_row(reference: F32, test: F32, row: int, error: F32) -> None:
    """Raise one row of the error to that of a pair of images."""
    l0, a0, b0 = reference[0, row], reference[1, row], reference[2, row]
    l1, a1, b1 = test[0, row], test[1, row], test[2, row]
    e0, p0, e1, p1 = reference[3, row], reference[4, row], test[3, row], test[4, row]
    colour = np.empty(l0.size, np.float32)
    for i in range(colour.size):
        da, db = a0[i] - a1[i], b0[i] - b1[i]
        distance = abs(l0[i] - l1[i]) + np.sqrt(da * da + db * db)
        bent = power(distance, _DISTANCE_EXPONENT)
        colour[i] = _BELOW * bent if bent < _BEND else _AT_BEND + _ABOVE * (bent - _BEND)
    out = error[row]
    for i in range(out.size):
        feature = np.sqrt(_ROOT_HALF * max(abs(e0[i] - e1[i]), abs(p0[i] - p1[i])))
        found = power(colour[i], _ONE - min(feature, _ONE))
        out[i] = max(out[i], min(found, _ONE))


@parallel
def differ(reference: F32, test: F32, error: F32, share: Share) -> None:
    """Raise an error map to the error of a pair of images (sections 4.1.3, 4.2.2 and 4.3).

    Parameters
    ----------
    reference, test
        float32 [SEEN, H, W], from `perceive`.
    error
        float32 [H, W], 0 to 1: becomes the larger of itself and the pair's FLIP error.
    """
    for row in turns(error.shape[0], share):
        _differ_row(reference, test, row, error)
