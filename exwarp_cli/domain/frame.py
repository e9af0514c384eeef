"""Images, G-buffers and the windows they live in."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.settings import MOST_PIXELS
from exwarp_cli.errors import LayoutError

Float32 = npt.NDArray[np.float32]
Int32 = npt.NDArray[np.int32]
Bool = npt.NDArray[np.bool_]
UInt8 = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Window:
    """A pixel rectangle in the coordinates of OpenEXR: x right, y down, both ends inclusive."""

    x: int  # first column, may be negative
    y: int  # first row, may be negative
    width: int  # pixels, at least 1
    height: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of an array that covers the window."""
        return self.height, self.width

    @property
    def pixels(self) -> int:
        """Number of pixels."""
        return self.width * self.height

    @property
    def corners(self) -> tuple[int, int, int, int]:
        """First column, first row, last column, last row, all inclusive."""
        return self.x, self.y, self.x + self.width - 1, self.y + self.height - 1

    def union(self, other: Window) -> Window:
        """Return the smallest window that covers both."""
        ax, ay, bx, by = self.corners
        cx, cy, dx, dy = other.corners
        x, y = min(ax, cx), min(ay, cy)
        return Window(x, y, max(bx, dx) - x + 1, max(by, dy) - y + 1)

    def covers(self, other: Window) -> bool:
        """Return whether every pixel of `other` lies in this window."""
        return self.union(other) == self

    def meets(self, other: Window) -> bool:
        """Return whether the two have a pixel in common."""
        ax, ay, bx, by = self.corners
        cx, cy, dx, dy = other.corners
        return max(ax, cx) <= min(bx, dx) and max(ay, cy) <= min(by, dy)

    def __str__(self) -> str:
        return f"{self.width}x{self.height}{self.x:+d}{self.y:+d}"


@dataclass(frozen=True)
class Image:
    """Colour of one instant."""

    # [H, W, 3 or 4]: scene-linear R, G, B and premultiplied alpha; any value, even NaN
    pixels: Float32
    data_window: Window  # place of `pixels`
    display_window: Window  # the frame that is meant to be seen

    def on(self, canvas: Window) -> Image:
        """Return the image on another window: cropped, or padded with zeros."""
        return replace(
            self, pixels=place_on_canvas(self.pixels, self.data_window, canvas), data_window=canvas
        )


SURFACE_PARTS = ("albedo", "specular", "roughness", "metallic")  # the materials of a G-buffer


@dataclass(frozen=True)
class GBuffer:
    """Geometry of one instant, all arrays on one window; None for what a renderer did not write."""

    window: Window  # the window that every array covers
    # [H, W], distance along the camera's axis, scene units; +inf is background
    depth: Float32 | None = None
    normal: Float32 | None = None  # [H, W, 3], world space, about unit length; 0 is background
    # [H, W, 3], world space, scene units; meaningless on background
    position: Float32 | None = None
    # [H, W], object id: 0 static, above 0 dynamic; negative where ids mix
    stencil: Int32 | None = None
    # [H, W, 2] px, +x right, +y down: to the place of this surface point one frame earlier; NaN
    # where unusable
    to_previous: Float32 | None = None
    to_next: Float32 | None = None  # the same to one frame later
    # [H, W, 3], scene-linear, 0 to 1, finite: colour of diffuse reflection; black for metals
    albedo: Float32 | None = None
    specular: Float32 | None = None  # the same of glossy reflection
    roughness: Float32 | None = None  # [H, W], 0 to 1
    metallic: Float32 | None = None  # [H, W], 0 to 1
    # [H, W], id of any object, where nothing says what moves: 0 background; negative where ids mix.
    # Only without `stencil`.
    objects: Int32 | None = None
    # [2, H, W, 2] px: offset of points, half a frame earlier and later, from where the vectors
    # alone lead; None where nothing turns. See `exwarp_cli.synthesis.trajectory`.
    bend: Float32 | None = None

    @property
    def has_motion(self) -> bool:
        """True if there are motion vectors."""
        return self.to_previous is not None or self.to_next is not None

    @property
    def background(self) -> Bool:
        """bool [H, W]: pixels that show no surface; none if nothing says so."""
        if self.depth is not None:
            return np.asarray(np.isinf(self.depth))
        surface = self.normal if self.position is None else self.position
        if surface is None:
            return np.zeros(self.window.shape, np.bool_)
        return np.asarray((surface == 0).all(axis=-1))

    @cached_property
    def turning(self) -> npt.NDArray[np.intp]:
        """Flat indices of the pixels that `bend` moves."""
        if self.bend is None:
            return np.zeros(0, np.intp)
        moves = (self.bend[0] != 0) | (self.bend[1] != 0)
        return np.flatnonzero(moves[..., 0] | moves[..., 1])

    def without(self, *parts: str) -> GBuffer:
        """Return the geometry without some parts."""
        missing: dict[str, Any] = dict.fromkeys(parts)
        return replace(self, **missing)

    def bare(self) -> GBuffer:
        """Return motion, depth and ids; all parts if without depth."""
        # Without depth, the other parts say what is background.
        if self.depth is None:
            return self
        kept = {name: getattr(self, name) for name in ("stencil", "to_previous", "to_next", "bend")}
        return GBuffer(self.window, self.depth, **kept)

    def on(self, canvas: Window) -> GBuffer:
        """Return the geometry on another window; what is new there is background."""
        if canvas == self.window:
            return self
        fills = {"depth": np.inf, "to_previous": np.nan, "to_next": np.nan}
        placed: dict[str, Any] = {"window": canvas}
        for name in (field.name for field in fields(self)):
            array = getattr(self, name)
            if name == "bend" and array is not None:
                placed[name] = np.stack(
                    [place_on_canvas(half, self.window, canvas) for half in array]
                )
            elif name != "window" and array is not None:
                placed[name] = place_on_canvas(array, self.window, canvas, fills.get(name, 0.0))
        return GBuffer(**placed)


@dataclass(frozen=True)
class KeyFrame:
    """A rendered frame as synthesis sees it."""

    number: int  # in the input sequence
    image: Image  # non-finite pixels are as the renderer wrote them
    gbuffer: GBuffer | None  # of the same instant, on the same window; None without AOVs

    def on(self, canvas: Window) -> KeyFrame:
        """Return the frame on another window."""
        gbuffer = None if self.gbuffer is None else self.gbuffer.on(canvas)
        return replace(self, image=self.image.on(canvas), gbuffer=gbuffer)

    def without(self, *parts: str) -> KeyFrame:
        """Return the frame with some parts of its geometry left out."""
        gbuffer = None if self.gbuffer is None else self.gbuffer.without(*parts)
        return replace(self, gbuffer=gbuffer)

    def extended(self, canvas: Window) -> KeyFrame:
        """Return the frame on another window, for warping.

        Inside the display window, the part beyond the data window is empty, and stays so: it gets
        no motion. Outside, where another frame may have data, it is unknown: NaN, hence a hole. A
        canvas that leaves out some of the display window is a region, beyond which nothing is
        known.
        """
        placed = self.on(canvas)
        if canvas == self.image.data_window:
            return placed
        around = outside_mask(canvas, self.image.data_window)
        display = self.image.display_window
        beyond = outside_mask(canvas, display) if canvas.covers(display) else np.bool_(True)
        pixels = np.where((around & beyond)[..., None], np.float32(np.nan), placed.image.pixels)
        gbuffer = placed.gbuffer
        if gbuffer is not None:
            empty = (around & ~beyond)[..., None]
            before, after = (
                None if vectors is None else np.where(empty, np.float32(0), vectors)
                for vectors in (gbuffer.to_previous, gbuffer.to_next)
            )
            gbuffer = replace(gbuffer, to_previous=before, to_next=after)
        return replace(placed, image=replace(placed.image, pixels=pixels), gbuffer=gbuffer)


def outside_mask(canvas: Window, window: Window) -> Bool:
    """Return the pixels of `canvas` that `window` does not cover, bool [H, W]."""
    return ~place_on_canvas(np.ones(window.shape, np.bool_), window, canvas)


def nonfinite_pixels(pixels: npt.NDArray[np.floating[Any]]) -> Bool:
    """Return the pixels [H, W, C] with a NaN or infinity in any channel, bool [H, W]."""
    finite = np.isfinite(pixels)
    if finite.all():  # a tenth of the time of testing each pixel
        return np.zeros(pixels.shape[:2], np.bool_)
    return np.asarray(~finite.all(axis=-1))


def place_on_canvas(
    array: np.ndarray, window: Window, canvas: Window, fill: float = 0.0
) -> np.ndarray:
    """Copy an array [H, W, ...] that covers `window` onto `canvas`, with `fill` around.

    The array itself, not a copy, is returned when the windows are equal.
    """
    if window == canvas:
        return array
    out = np.full((*canvas.shape, *array.shape[2:]), fill, dtype=array.dtype)
    ax, ay, bx, by = window.corners
    cx, cy, dx, dy = canvas.corners
    x0, y0, x1, y1 = max(ax, cx), max(ay, cy), min(bx, dx), min(by, dy)
    if x0 <= x1 and y0 <= y1:
        out[y0 - cy : y1 - cy + 1, x0 - cx : x1 - cx + 1] = array[
            y0 - ay : y1 - ay + 1, x0 - ax : x1 - ax + 1
        ]
    return out


def combine_3x3(values: np.ndarray, combine: np.ufunc, **outside: Any) -> np.ndarray:
    """Combine each of the pixels [H, W, ...] with its eight neighbours, by rows and then columns.

    `outside`: what lies beyond the edges, as for `numpy.pad`.
    """
    padded = np.pad(values, ((1, 1), (1, 1), *((0, 0),) * (values.ndim - 2)), **outside)
    rows = combine(combine(padded[:-2], padded[1:-1]), padded[2:])
    out: np.ndarray = combine(combine(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])
    return out


_max_pixels = MOST_PIXELS


def set_max_pixels(pixels: int) -> None:
    """Set how many pixels a frame may have."""
    global _max_pixels
    _max_pixels = pixels


def require_size(path: Path, height: int, width: int) -> None:
    """Raise LayoutError if a file claims a frame larger than allowed."""
    if height * width > _max_pixels:
        raise LayoutError(
            f"{path} says that it is {width}x{height} pixels, more than "
            f"--max-pixels {_max_pixels}; render or copy it again if it is not, or allow more"
        )


def require_canvas(what: object, canvas: Window) -> None:
    """Raise LayoutError if the canvas that holds all windows is larger than allowed."""
    if canvas.pixels > _max_pixels:
        raise LayoutError(
            f"the data and display windows of {what} lie in {canvas.width}x{canvas.height} pixels, "
            f"more than --max-pixels {_max_pixels}; correct them, or allow more"
        )
