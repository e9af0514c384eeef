"""Mosaics: frames that a network makes in some tiles alone, and warping in the others.

The network is run on rectangles around the chosen tiles. It sees some way beyond them, and the
frame goes over from one maker to the other outside of them, so that no seam shows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.tiles import TILE_ROWS, tile_edges
from exwarp_cli.synthesis.risk import Tiles

HALO = 16
"""Pixels that the network sees around chosen tiles. Against whole frames of 427x240, tiles of 32
pixels differ by an RMS of 0.2 display levels with 8 pixels, 0.01 to 0.03 with 16 and 0.003 to 0.015
with 32, at 1.7 times the time."""

GRID = 16
"""Rectangles begin at multiples of it: of the stride of the network that comes with ExWarp, whose
coarsest pixels then lie as in the whole frame. With 24 pixels around, which is no multiple, the
difference was twice that with 16."""

RAMP = 8
"""A tile is gone over into its neighbours within an eighth of its height, and at most in HALO."""

Span = tuple[int, int]
"""First row or column, and the one after the last."""


@dataclass(frozen=True)
class Box:
    """Neighbouring tiles: rows and columns of tiles, each from the first to after the last."""

    rows: Span
    columns: Span

    def around(self, other: Box) -> Box:
        """Return the smallest box that holds both."""
        rows, columns = (self.rows, other.rows), (self.columns, other.columns)
        return Box(*((min(a[0], b[0]), max(a[1], b[1])) for a, b in (rows, columns)))


@dataclass(frozen=True)
class Mosaic:
    """Where the tiles of a frame lie.

    Attributes
    ----------
    down, across
        Pixels of each row and column of tiles; together all of the frame.
    """

    down: tuple[Span, ...]
    across: tuple[Span, ...]

    @classmethod
    def of(cls, tiles: Tiles) -> Mosaic:
        """Return the tiles that errors are predicted of; the outer ones reach to the borders."""
        canvas, display = tiles.canvas, tiles.display
        return cls(
            _spans(display.y - canvas.y, display.height, TILE_ROWS, canvas.height),
            _spans(display.x - canvas.x, display.width, tiles.columns, canvas.width),
        )

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frame."""
        return self.down[-1][1], self.across[-1][1]

    @property
    def ramp(self) -> int:
        """Pixels beyond a tile in which it goes over into its neighbours."""
        first, last = self.down[len(self.down) // 2]
        return min(max((last - first) // RAMP, 1), HALO - 1)

    def means(self, values: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
        """Return the means over each tile, float64 [rows, columns], of values [H, W]."""
        tiles = [[values[a:b, c:d] for c, d in self.across] for a, b in self.down]
        return np.array([[tile.mean(dtype=np.float64) for tile in row] for row in tiles])

    def weight(self, chosen: Bool) -> Float32:
        """Return how far chosen tiles, bool [rows, columns], count at each pixel.

        Returns
        -------
        float32 [H, W]
            1 in them, falling to 0 beyond.
        """
        out = np.zeros(self.shape, np.float32)
        for row, column in np.argwhere(chosen):
            rows, down = self._ramp(self.down[row], self.shape[0])
            columns, across = self._ramp(self.across[column], self.shape[1])
            part = out[rows, columns]
            np.maximum(part, down[:, None] * across, out=part)
        return out

    def _ramp(self, span: Span, size: int) -> tuple[slice, Float32]:
        """Return the pixels that a tile counts at along one axis, and how much it does."""
        first, last = max(span[0] - self.ramp, 0), min(span[1] + self.ramp, size)
        places = np.arange(first, last)
        away = np.maximum(np.maximum(span[0] - places, places - (span[1] - 1)), 0)
        return slice(first, last), (1 - away / (self.ramp + 1)).astype(np.float32)

    def parts(self, chosen: Bool) -> list[tuple[Box, slice, slice]]:
        """Return the boxes that chosen tiles are computed in, and the pixels that are looked at.

        One of all tiles where the others would take as many pixels.
        """
        boxes = self._merged(chosen)
        whole = Box((0, len(self.down)), (0, len(self.across)))
        if sum(map(self._pixels, boxes)) >= self._pixels(whole):
            boxes = [whole]
        return [(box, *self._looked_at(box)) for box in boxes]

    def inside(self, box: Box) -> tuple[slice, slice]:
        """Return the pixels of a box of tiles."""
        (top, bottom), (left, right) = box.rows, box.columns
        return (
            slice(self.down[top][0], self.down[bottom - 1][1]),
            slice(self.across[left][0], self.across[right - 1][1]),
        )

    def _looked_at(self, box: Box) -> tuple[slice, slice]:
        """Return the pixels of a box, and those around it that the network sees."""
        found = []
        for inside, size in zip(self.inside(box), self.shape, strict=True):
            first = max(inside.start - HALO, 0) // GRID * GRID
            found.append(slice(first, min(inside.stop + HALO, size)))
        return found[0], found[1]

    def _pixels(self, box: Box) -> int:
        rows, columns = self._looked_at(box)
        return int((rows.stop - rows.start) * (columns.stop - columns.start))

    def _merged(self, chosen: Bool) -> list[Box]:
        """Return boxes that hold the chosen tiles: neighbours together, where that saves pixels."""
        boxes = [
            Box((row, row + 1), run) for row, marks in enumerate(chosen) for run in _runs(marks)
        ]
        merging = True
        while merging:
            merging = False
            kept: list[Box] = []
            for box in boxes:
                index = next((i for i, other in enumerate(kept) if self._saves(box, other)), None)
                if index is None:
                    kept.append(box)
                else:
                    kept[index] = kept[index].around(box)
                    merging = True
            boxes = kept
        return boxes

    def _saves(self, box: Box, other: Box) -> bool:
        """Whether two boxes take no fewer pixels apart than together."""
        return self._pixels(box.around(other)) <= self._pixels(box) + self._pixels(other)


def extrapolate_in(
    mosaic: Mosaic, chosen: Bool, answer: Callable[[slice, slice], Float32]
) -> Float32:
    """Have a network answer in chosen tiles, and around them as far as they go over into others.

    Parameters
    ----------
    mosaic, chosen
        Where the tiles lie, and which of them are chosen: bool [rows, columns].
    answer
        Gives planes float32 [3, h, w] of rows and columns of the frame.

    Returns
    -------
    float32 [3, H, W]
        0 where nothing was asked for.
    """
    out = np.zeros((3, *mosaic.shape), np.float32)
    kept: list[tuple[slice, slice, Float32]] = []
    for box, rows, columns in mosaic.parts(chosen):
        made = answer(rows, columns)
        out[:, rows, columns] = made
        down, across = mosaic.inside(box)
        own = made[:, _within(down, rows), _within(across, columns)]
        kept.append((down, across, own))
    for down, across, own in kept:  # over what others made around their own tiles
        out[:, down, across] = own
    return out


def lay_over(below: Float32, above: Float32, weight: Float32) -> Float32:
    """Return a frame [H, W, C] that is another one to the share of a weight, float32 [H, W].

    Where the weight is 0 or 1 it is exactly one of the two.
    """
    share = weight[..., None]
    mixed = below + share * (above - below)
    return np.where(share == 1, above, np.where(share == 0, below, mixed))


def _within(inner: slice, outer: slice) -> slice:
    return slice(inner.start - outer.start, inner.stop - outer.start)


def _runs(marks: Bool) -> list[Span]:
    """Return where marks begin, and where they end."""
    padded = np.concatenate([[False], marks, [False]]).astype(np.int8)
    steps = np.diff(padded)
    firsts, lasts = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
    return [(int(a), int(b)) for a, b in zip(firsts, lasts, strict=True)]


def _spans(offset: int, size: int, parts: int, whole: int) -> tuple[Span, ...]:
    """Return the pixels of tiles along an axis; the first and the last reach to the borders."""
    inner = [min(max(offset + edge, 0), whole) for edge in tile_edges(size, parts)]
    places: Sequence[int] = [0, *inner[1:-1], whole]
    return tuple(pairwise(places))
