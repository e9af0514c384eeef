"""The sRGB curve on whole frames, odd below 0 and carried on above 1 (IEC 61966-2-1)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel
from exwarp_cli.kernels._row_bands import Share, turns

F32 = npt.NDArray[np.float32]

COLOURS = 3
"""Channels with a curve; what follows, alpha, is copied."""


@inlined
def to_code(light: np.float32) -> np.float32:
    """Return the code of a scene-linear value."""
    size = abs(light)
    curved = np.float32(1.055) * size ** np.float32(1 / 2.4) - np.float32(0.055)
    code = np.float32(12.92) * size if size <= np.float32(0.0031308) else curved
    return -code if light < 0 else code


@inlined
def to_light(code: np.float32) -> np.float32:
    """Invert :func:`to_code`."""
    size = abs(code)
    curved = ((size + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    light = size / np.float32(12.92) if size <= np.float32(0.04045) else curved
    return -light if code < 0 else light


@parallel
def show(pixels: F32, out: F32, share: Share) -> None:
    """Write the codes of scene-linear pixels, float32 [H, W, C], to another such array."""
    for i in turns(pixels.shape[0], share):
        line, codes = pixels[i], out[i]
        for j in range(line.shape[0]):
            for c in range(line.shape[1]):
                codes[j, c] = to_code(line[j, c]) if c < COLOURS else line[j, c]


@parallel
def light(codes: F32, out: F32, share: Share) -> None:
    """Invert :func:`show`; `out` may be `codes`."""
    for i in turns(codes.shape[0], share):
        line, pixels = codes[i], out[i]
        for j in range(line.shape[0]):
            for c in range(line.shape[1]):
                pixels[j, c] = to_light(line[j, c]) if c < COLOURS else line[j, c]
