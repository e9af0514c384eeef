"""Images, G-buffers and the windows they live in."""

from __future__ import annotations

from dataclasses import dataclass, replace
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
    """A pixel rectangle in the coordinates of OpenEXR: x right, y down, both ends inclusive.

    Attributes
    ----------
    x, y
        First column and row; negative values are legal.
    width, height
        Size in pixels, at least 1.
    """

    x: int
    y: int
    width: int
    height: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of an array that covers the window."""
        return self.height, self.width

    @property
    def pixels(self) -> int:
        """How many there are."""
        return self.width * self.height

    @property
    def corners(self) -> tuple[int, int, int, int]:
        """First column, first row, last column, last row, all inclusive."""
        return self.x, self.y, self.x + self.width - 1, self.y + self.height - 1

    def union(self, other: Window) -> Window:
        """Smallest window that covers both."""
        ax, ay, bx, by = self.corners
        cx, cy, dx, dy = other.corners
        x, y = min(ax, cx), min(ay, cy)
        return Window(x, y, max(bx, dx) - x + 1, max(by, dy) - y + 1)

    def covers(self, other: Window) -> bool:
        """Whether every pixel of `other` lies in this window."""
        return self.union(other) == self

    def meets(self, other: Window) -> bool:
        """Whether the two have a pixel in common."""
        ax, ay, bx, by = self.corners
        cx, cy, dx, dy = other.corners
        return max(ax, cx) <= min(bx, dx) and max(ay, cy) <= min(by, dy)

    def __str__(self) -> str:
        return f"{self.width}x{self.height}{self.x:+d}{self.y:+d}"


@dataclass(frozen=True)
class Image:
    """Colour of one instant.

    Attributes
    ----------
    pixels
        float32 [H, W, 3] or [H, W, 4]: scene-linear R, G, B and premultiplied alpha. Values below
        0 and above 1 are legal; so are NaN and infinities in what a renderer wrote.
    data_window
        Where `pixels` lie; H and W are its size.
    display_window
        The frame that is meant to be seen.
    """

    pixels: Float32
    data_window: Window
    display_window: Window

    def on(self, canvas: Window) -> Image:
        """Return the image on another window: cropped, or padded with zeros."""
        return replace(
            self, pixels=place(self.pixels, self.data_window, canvas), data_window=canvas
        )


SURFACE_PARTS = ("albedo", "specular", "roughness", "metallic")
"""What a G-buffer tells of materials."""


@dataclass(frozen=True)
class GBuffer:
    """Geometry of one instant, all arrays on one window; what a renderer did not write is None.

    Attributes
    ----------
    window
        The window that every array covers.
    depth
        float32 [H, W], distance along the camera's axis in scene units; +inf is background.
    normal
        float32 [H, W, 3], world space, about unit length; 0 is background.
    position
        float32 [H, W, 3], world space, scene units; meaningless on background.
    stencil
        int32 [H, W], object id: 0 static, above 0 dynamic; negative where ids mix in a pixel.
    to_previous, to_next
        float32 [H, W, 2], pixels, +x right, +y down: where this surface point is seen one frame
        earlier and later, minus where it is seen now. NaN where the renderer's value is unusable.
    albedo, specular
        float32 [H, W, 3], scene-linear, 0 to 1, finite: colour of diffuse and of glossy
        reflection. The albedo of metals is black.
    roughness, metallic
        float32 [H, W], 0 to 1.
    objects
        int32 [H, W], id of whatever is shown, moving or not, where nothing says what moves: 0
        background; negative where ids mix in a pixel. Only there without `stencil`.
    bend
        float32 [2, H, W, 2], pixels: by how much points are elsewhere, half a frame earlier and
        half a frame later, than the vectors alone tell; None where nothing turns. See
        `exwarp_cli.synthesis.trajectory`.
    """

    window: Window
    depth: Float32 | None = None
    normal: Float32 | None = None
    position: Float32 | None = None
    stencil: Int32 | None = None
    to_previous: Float32 | None = None
    to_next: Float32 | None = None
    albedo: Float32 | None = None
    specular: Float32 | None = None
    roughness: Float32 | None = None
    metallic: Float32 | None = None
    objects: Int32 | None = None
    bend: Float32 | None = None

    @property
    def has_motion(self) -> bool:
        """Whether any motion vectors are there."""
        return self.to_previous is not None or self.to_next is not None

    @property
    def background(self) -> Bool:
        """bool [H, W]: pixels that show no surface; none when nothing tells."""
        if self.depth is not None:
            return np.asarray(np.isinf(self.depth))
        known = self.normal if self.position is None else self.position
        if known is None:
            return np.zeros(self.window.shape, np.bool_)
        return np.asarray((known == 0).all(axis=-1))

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
        """Return motion, depth and ids; all of it where only the rest tells what is background."""
        if self.depth is None:
            return self
        kept = {name: getattr(self, name) for name in ("stencil", "to_previous", "to_next", "bend")}
        return GBuffer(self.window, self.depth, **kept)

    def on(self, canvas: Window) -> GBuffer:
        """Return the geometry on another window; what is new there is background."""
        if canvas == self.window:
            return self

        def moved(array: np.ndarray | None, fill: float = 0.0) -> np.ndarray | None:
            return None if array is None else place(array, self.window, canvas, fill)

        return GBuffer(
            canvas,
            moved(self.depth, np.inf),
            moved(self.normal),
            moved(self.position),
            moved(self.stencil),
            moved(self.to_previous, np.nan),
            moved(self.to_next, np.nan),
            moved(self.albedo),
            moved(self.specular),
            moved(self.roughness),
            moved(self.metallic),
            moved(self.objects),
            None
            if self.bend is None
            else np.stack([place(half, self.window, canvas) for half in self.bend]),
        )


@dataclass(frozen=True)
class KeyFrame:
    """A rendered frame as synthesis sees it.

    Attributes
    ----------
    number
        The frame's number in the input sequence.
    image
        Colour; non-finite pixels are as the renderer wrote them.
    gbuffer
        Geometry of the same instant, on the same window as `image`; None without AOVs.
    broken
        How many pixels of the rendered colour are NaN or infinite; None if they were not counted.
    """

    number: int
    image: Image
    gbuffer: GBuffer | None
    broken: int | None = None

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

        Inside the display window, what the data window leaves out is empty, and stays so: it gets
        no motion. Outside, where another frame may have data, it is unknown: NaN, hence a hole. A
        canvas that leaves out some of the display window is that of a picture's region, beyond
        which nothing is known at all.
        """
        placed = self.on(canvas)
        if canvas == self.image.data_window:
            return placed
        around = outside(canvas, self.image.data_window)
        display = self.image.display_window
        beyond = outside(canvas, display) if canvas.covers(display) else np.bool_(True)
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


def outside(canvas: Window, window: Window) -> Bool:
    """bool [H, W] over `canvas`: pixels that `window` does not cover."""
    return ~place(np.ones(window.shape, np.bool_), window, canvas)


def broken_pixels(pixels: npt.NDArray[np.floating[Any]]) -> Bool:
    """bool [H, W]: pixels [H, W, C] with a NaN or infinity in any channel, float32 or float16."""
    if pixels.dtype == np.float16:  # whose comparisons take ten times as long as those of its bits
        bits = pixels.view(np.uint16) & np.uint16(0x7FFF)
        return np.asarray((bits >= np.uint16(0x7C00)).any(axis=-1))
    if are_finite(pixels):
        return np.zeros(pixels.shape[:2], np.bool_)
    return np.asarray(~np.isfinite(pixels).all(axis=-1))


def are_finite(pixels: npt.NDArray[np.floating[Any]]) -> bool:
    """Whether no channel of pixels [H, W, C] is NaN or infinite, as far as a sum shows it.

    In a thirtieth of the time that looking at each pixel takes; numbers beyond 1e19, whose squares
    overflow, and halfs leave it open: False.
    """
    if pixels.dtype == np.float16:
        return False
    with np.errstate(invalid="ignore", over="ignore"):
        # The sum of squares, or the sum, which is faster where pixels lie apart.
        if pixels.flags.c_contiguous:
            return bool(np.isfinite(np.vdot(pixels, pixels)))
        return bool(np.isfinite(pixels.sum(dtype=np.float64)))


def place(array: np.ndarray, window: Window, canvas: Window, fill: float = 0.0) -> np.ndarray:
    """Copy an array [H, W, ...] that covers `window` onto `canvas`.

    Pixels of the canvas outside the window get `fill`; pixels of the window outside the canvas are
    dropped. The array itself is returned, not a copy, when the windows are equal.
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

    `outside` says what lies beyond the edges, as for `numpy.pad`.
    """
    padded = np.pad(values, ((1, 1), (1, 1), *((0, 0),) * (values.ndim - 2)), **outside)
    rows = combine(combine(padded[:-2], padded[1:-1]), padded[2:])
    out: np.ndarray = combine(combine(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])
    return out


_most = MOST_PIXELS


def allow(pixels: int) -> None:
    """Set how many pixels a frame may have."""
    global _most
    _most = pixels


def require_size(path: Path, height: int, width: int) -> None:
    """Refuse a frame that says it is larger than allowed.

    Raises
    ------
    LayoutError
        When it does.
    """
    if height * width > _most:
        raise LayoutError(
            f"{path} says that it is {width}x{height} pixels, more than --max-pixels {_most}; "
            "render or copy it again if it is not, or allow more"
        )


def require_canvas(what: object, canvas: Window) -> None:
    """Refuse windows that lie so far apart that no frame may be as large as what holds them all.

    Raises
    ------
    LayoutError
        When they do.
    """
    if canvas.pixels > _most:
        raise LayoutError(
            f"the data and display windows of {what} lie in {canvas.width}x{canvas.height} pixels, "
            f"more than --max-pixels {_most}; correct them, or allow more"
        )
