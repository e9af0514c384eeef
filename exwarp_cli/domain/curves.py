"""The curves by which image files hold light as code values, and their inverses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Float32


@dataclass(frozen=True)
class Curve:
    """A curve between code values and scene-linear light.

    Attributes
    ----------
    name
        As messages have it.
    to_linear
        From float32 code values, 0 to 1, to float32 scene-linear values.
    to_code
        Its inverse. Light that the curve has no code for gets the nearest.
    """

    name: str
    to_linear: Callable[[Float32], Float32]
    to_code: Callable[[Float32], Float32]


def _same(values: Float32) -> Float32:
    return values


def _srgb_to_linear(code: Float32) -> Float32:
    """IEC 61966-2-1, odd: below 0 as above."""
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
_STEPS = 300.0  # code values per factor of 10: 0.002 of density each, gamma 0.6
_TOE = 10.0 ** ((_BLACK - _WHITE) / _STEPS)


def _film_to_linear(code: Float32) -> Float32:
    light = 10.0 ** ((1023.0 * code.astype(np.float64) - _WHITE) / _STEPS)
    linear: Float32 = ((light - _TOE) / (1 - _TOE)).astype(np.float32)
    return linear


def _film_to_code(linear: Float32) -> Float32:
    least = 10.0 ** (-_WHITE / _STEPS)  # of code 0
    light = np.maximum(linear.astype(np.float64) * (1 - _TOE) + _TOE, least)
    code: Float32 = ((_WHITE + _STEPS * np.log10(light)) / 1023.0).astype(np.float32)
    return code


LINEAR = Curve("linear", _same, _same)
SRGB = Curve("sRGB", _srgb_to_linear, _srgb_to_code)
FILM = Curve("Cineon log", _film_to_linear, _film_to_code)
"""Printing density as scanners of film write it, with the usual black of 95 and white of 685.

Kennel and Snider, "Gray-Scale Transformations of Cineon Digital Film Data", SMPTE Journal, 1993.
"""
