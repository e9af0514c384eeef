"""The G-buffer of a slot from those of other frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import SURFACE_PARTS, Bool, Float32, GBuffer
from exwarp_cli.synthesis.geometry import depth_of
from exwarp_cli.synthesis.warp import sampled

SMOOTH = ("albedo", "specular")
"""Sampled bilinearly, as colour is, so that they cancel where colour is divided by them."""

ROWS = 64
"""That are looked up at a time."""

Index = npt.NDArray[np.intp]

SHOWN = ("depth", "normal", *SURFACE_PARTS)
"""What is taken over: what networks are told of a surface, and depth to fill holes by."""


def reprojected(sources: Sequence[tuple[GBuffer, Float32]]) -> tuple[GBuffer, Bool]:
    """Return a slot's G-buffer, taken from other frames'.

    Parameters
    ----------
    sources
        G-buffers on one window, each with the motion field float32 [H, W, 2] from the slot to it,
        NaN where it shows nothing of the slot. Each pixel comes from the first that shows it.

    Returns
    -------
    GBuffer
        Those parts out of SHOWN that the first source has, and a depth in any case: NaN where
        nothing shows what is there, as all else is 0.
    bool [H, W]
        Where that is so.
    """
    first = replace(sources[0][0], depth=depth_of(sources[0][0]))
    made = {
        name: np.full(array.shape, np.nan if name == "depth" else 0, array.dtype)
        for name in SHOWN
        if (array := getattr(first, name)) is not None
    }
    unknown = np.ones(first.window.shape, np.bool_)
    for gbuffer, field in sources:
        new = np.zeros_like(unknown)
        parts = {name: getattr(gbuffer, name) for name in made} | {"depth": depth_of(gbuffer)}
        for pixels, ends in _ends(field, unknown):
            new.reshape(-1)[pixels] = True
            for name, array in parts.items():
                if array is not None and name not in SMOOTH:
                    _flat(made[name])[pixels] = _flat(array)[ends]
        for name in SMOOTH:
            if parts.get(name) is not None:
                np.copyto(made[name], sampled(parts[name], field)[0], where=new[..., None])
        unknown &= ~new
    return GBuffer(first.window, **made), unknown


def lookup(array: np.ndarray, field: Float32, default: object) -> np.ndarray:
    """Return what lies at the end of a motion field, from the nearest pixel.

    Parameters
    ----------
    array
        [H, W, ...].
    field
        float32 [H, W, 2], NaN where unknown.
    default
        For pixels without an end inside the frame.
    """
    out = np.full_like(array, default)
    for pixels, ends in _ends(field, np.ones(array.shape[:2], np.bool_)):
        _flat(out)[pixels] = _flat(array)[ends]
    return out


def _flat(array: np.ndarray) -> np.ndarray:
    """Return [H, W, ...] as [H W, ...]; a view where the array is contiguous."""
    return array.reshape(-1, *array.shape[2:])


def _ends(field: Float32, wanted: Bool) -> Iterator[tuple[Index, Index]]:
    """Yield which wanted pixels a field leads from, and the nearest pixels it leads to, flat.

    Some rows at a time, as the numbers on the way take over ten times the memory of a plane.
    """
    height, width = wanted.shape
    for first in range(0, height, ROWS):
        pixels = np.flatnonzero(wanted[first : first + ROWS]) + first * width
        row, column = np.divmod(pixels, width)
        move = _flat(field)[pixels]
        x, y = column + move[:, 0] + 0.5, row + move[:, 1] + 0.5
        with np.errstate(invalid="ignore"):
            inside = (x >= 0) & (y >= 0) & (x <= width) & (y <= height)
        left = np.minimum(x[inside].astype(np.intp), width - 1)
        top = np.minimum(y[inside].astype(np.intp), height - 1)
        yield pixels[inside], top * width + left
