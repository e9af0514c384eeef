"""A frame at a glance: a small copy of what tells whether the next frame goes on from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, Int32, KeyFrame, Window
from exwarp_cli.kernels import frame_statistics

CELLS = 128
"""Cells along a frame's longer side."""

POINTS = 4
"""Pixels along a cell's side whose colour is averaged: noise of path tracing falls to a quarter."""

Index = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Glance:
    """A frame reduced to cells, h times w of them, over its display window.

    Geometry is that of the pixel in a cell's middle; vectors are counted in cells.

    Attributes
    ----------
    number
        The frame's number in the input sequence.
    light
        float32 [h, w]: mean of the square root of scene-linear luminance; 0 for black, about 1 for
        white, finite.
    surface
        bool [h, w]: cells that show a surface, not background; all of them where nothing tells.
    depth, normal, position, stencil, to_previous, to_next
        As in `GBuffer`, [h, w, ...]; None where there is none.
    """

    number: int
    light: Float32
    surface: Bool
    depth: Float32 | None = None
    normal: Float32 | None = None
    position: Float32 | None = None
    stencil: Int32 | None = None
    to_previous: Float32 | None = None
    to_next: Float32 | None = None


def glance_at(frame: KeyFrame) -> Glance:
    """Reduce a frame: it looks at one pixel in ten of a 1080p frame, and keeps 0.5 MB."""
    display = frame.image.display_window
    size = max(1, round(max(display.shape) / CELLS))
    light = _light(frame.image.pixels, frame.image.data_window, display, size)
    gbuffer = frame.gbuffer
    if gbuffer is None:
        return Glance(frame.number, light, np.ones(light.shape, np.bool_))
    middle = _Sampling(gbuffer.window, display, size, (size // 2, size // 2))

    def vectors(array: Float32 | None) -> Float32 | None:
        picked = middle.pick(array, np.nan)
        return None if picked is None else np.asarray(picked / np.float32(size), np.float32)

    depth = middle.pick(gbuffer.depth, np.inf)
    normal, position = middle.pick(gbuffer.normal), middle.pick(gbuffer.position)
    surface = np.ones(light.shape, np.bool_)
    if depth is not None:
        surface = np.isfinite(depth)
    elif (shown := normal if position is None else position) is not None:
        surface = np.any(np.not_equal(shown, 0), axis=-1)
    return Glance(
        frame.number,
        light,
        surface,
        depth,
        normal,
        position,
        middle.pick(gbuffer.stencil),
        vectors(gbuffer.to_previous),
        vectors(gbuffer.to_next),
    )


class _Sampling:
    """One pixel out of every cell of a display window, from arrays that cover another window."""

    def __init__(self, window: Window, display: Window, size: int, at: tuple[int, int]) -> None:
        height, width = display.shape
        self._rows, row_inside = _along(height, size, at[0] + display.y - window.y, window.height)
        self._columns, inside = _along(width, size, at[1] + display.x - window.x, window.width)
        self._outside = ~(row_inside[:, None] & inside[None, :])

    def pick(self, array: np.ndarray | None, fill: float = 0.0) -> np.ndarray | None:
        """Return the pixels [h, w, ...] of an array [H, W, ...]; `fill` outside it."""
        if array is None:
            return None
        picked = array[self._rows[:, None], self._columns[None, :]]
        if self._outside.any():
            picked[self._outside] = fill
        return picked


def _along(length: int, size: int, first: Index | int, end: int) -> tuple[Index, Bool]:
    """Return where pixels of cells lie along an axis, and which of them lie in the array.

    Parameters
    ----------
    length
        Of the display window along it.
    size
        Of a cell.
    first
        Those of the first cell; the others' follow, one cell's after the other's.
    end
        Of the array.
    """
    begins = size * np.arange(max(1, length // size))
    places = np.add.outer(begins, first).ravel()
    return np.clip(places, 0, end - 1), (places >= 0) & (places < end)


def _light(pixels: Float32, window: Window, display: Window, size: int) -> Float32:
    """Return mean square roots of luminance, float32 [h, w]: bright fireflies do not dominate."""
    offsets = np.array(sorted({(2 * i + 1) * size // (2 * POINTS) for i in range(POINTS)}))
    (rows, inside_rows), (columns, inside) = (
        _along(length, size, offsets + first, end)
        for length, first, end in (
            (display.height, display.y - window.y, window.height),
            (display.width, display.x - window.x, window.width),
        )
    )
    height, width, channels = pixels.shape
    light = np.empty((len(rows) // len(offsets), len(columns) // len(offsets)), np.float32)
    frame_statistics.mean_square_roots(
        np.ascontiguousarray(pixels).reshape(height, width * channels), channels,
        np.where(inside_rows, rows, -1), np.where(inside, columns, -1), len(offsets), light,
    )  # fmt: skip
    return light
