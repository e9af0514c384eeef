"""The filters of FLIP as passes down and along rows, with the image's edge repeated outside.

Andersson et al., "FLIP: A Difference Evaluator for Alternating Images" (2020): the contrast
sensitivity of the eye in section 4.1.1, the edge and point detectors in section 4.2.1. All are sums
of products of one filter down and one along. Filters are given by the weights of the centre and of
the samples at distance 1, 2 and so on; all but the slope are even.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import part

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]

PIXELS_PER_DEGREE = 0.7 * (3840 / 0.7) * np.pi / 180
"""Those of a 4K display, 0.7 m wide, seen from 0.7 m: 67.02."""

_NEGLIGIBLE = 1e-9
"""Weights below this share of the largest change no float32 sum."""

# Spreads b of the Gaussians sqrt(pi / b) exp(-pi^2 x^2 / b), x in degrees; the blue-yellow channel
# has two, of different heights.
_ACHROMATIC, _RED_GREEN = 0.0047, 0.0053
_BLUE_YELLOW = (34.1, 0.04), (13.5, 0.025)

_FEATURE_WIDTH = 0.082
"""Of edges and points, in degrees."""


def _total(weights: F64) -> float:
    """Sum over both sides and the centre."""
    return float(2 * weights.sum() - weights[0])


def _bells() -> list[F64]:
    """Return the Gaussians of the three channels; the last two down, and their share along."""
    widest = max(b for _, b in _BLUE_YELLOW)
    radius = int(np.ceil(3 * np.sqrt(widest / (2 * np.pi**2)) * PIXELS_PER_DEGREE))
    x = np.arange(radius + 1) / PIXELS_PER_DEGREE
    one, other = (np.exp(-((np.pi * x) ** 2) / b) for b in (_ACHROMATIC, _RED_GREEN))
    two = [np.exp(-((np.pi * x) ** 2) / b) for _, b in _BLUE_YELLOW]
    heights = [a * np.sqrt(np.pi / b) for a, b in _BLUE_YELLOW]
    volume = sum(a * _total(bell) ** 2 for a, bell in zip(heights, two, strict=True))
    shares = [a * bell / volume for a, bell in zip(heights, two, strict=True)]
    return [one / _total(one), other / _total(other), *two, *shares]


def _detectors() -> list[F64]:
    """Return the Gaussian of the features, and its first and second derivative.

    Positive weights sum to 1 and negative ones to -1.
    """
    sigma = 0.5 * _FEATURE_WIDTH * PIXELS_PER_DEGREE
    x = np.arange(int(np.ceil(3 * sigma)) + 1)
    bell = np.exp(-(x**2) / (2 * sigma**2))
    slope = x * bell
    bend = (x**2 / sigma**2 - 1) * bell
    outside, inside = np.where(bend > 0, bend, 0), np.where(bend < 0, bend, 0)
    bend = outside / _total(outside) - inside / _total(inside)
    return [bell / _total(bell), slope / slope.sum(), bend]


_ALL = [*_bells(), *_detectors()]
BRIGHT, RED_GREEN, WIDE, NARROW, WIDE_SHARE, NARROW_SHARE, BELL, SLOPE, BEND = range(len(_ALL))
"""The filters' numbers."""

HALO = max(map(len, _ALL)) - 1
"""Samples that a line has on either side of the image."""

_WEIGHTS = np.array([np.pad(w, (0, HALO + 1 - len(w))) for w in _ALL], np.float32)
_COUNTS = np.array([np.flatnonzero(w > _NEGLIGIBLE * w.max()).max() + 1 for w in _ALL])
_SIGNS = np.array([-1 if n == SLOPE else 1 for n in range(len(_ALL))], np.float32)
"""Of the samples above and to the left."""


# One array written and two read, as LLVM vectorises only loops that need few checks for overlap.
@part
def _weigh(weight: np.float32, a: F32, out: F32) -> None:
    for i in range(out.size):
        out[i] = weight * a[i]


@part
def _add_pair(total: F32, weight: np.float32, a: F32, sign: np.float32, b: F32) -> None:
    for i in range(total.size):
        total[i] += weight * (b[i] + sign * a[i])


@part
def filter_down(plane: F32, row: int, number: int, line: F32) -> None:
    """Filter a plane, float32 [H, W], downwards at one row into a line, float32 [W + 2 HALO]."""
    width, last = plane.shape[1], plane.shape[0] - 1
    inner = line[HALO : HALO + width]
    weights, sign = _WEIGHTS[number], _SIGNS[number]
    _weigh(weights[0], plane[row], inner)
    for k in range(1, _COUNTS[number]):
        above, below = plane[max(row - k, 0)], plane[min(row + k, last)]
        _add_pair(inner, weights[k], above, sign, below)
    line[:HALO] = inner[0]
    line[HALO + width :] = inner[width - 1]


@part
def filter_along(line: F32, number: int, out: F32) -> None:
    """Filter a line, float32 [W + 2 HALO], along the row into float32 [W]."""
    weights, sign = _WEIGHTS[number], _SIGNS[number]
    _weigh(weights[0], line[HALO:], out)
    for k in range(1, _COUNTS[number]):
        _add_pair(out, weights[k], line[HALO - k :], sign, line[HALO + k :])
