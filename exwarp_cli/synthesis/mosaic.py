"""Tiles of a frame, and mosaics: a network makes some of the tiles, warping the others.

The network is run on rectangles around the chosen tiles. It sees some way beyond them, and the
makers are mixed beside them, so that no seam shows.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, Window
from exwarp_cli.domain.tiles import TILE_ROWS, count_columns, tile_edges
from exwarp_cli.synthesis.camera import F64

# A frame is sampled in about so many of its rows at most, and in as many of its columns to their
# length: every second row and column at 427x240, every seventh at 1920x1080.
SAMPLED_ROWS = 160

# Pixels that the network sees around chosen tiles. Against whole frames of 427x240, tiles of 32
# pixels differ by an RMS of 0.2 display levels with 8 pixels, 0.01 to 0.03 with 16 and 0.003 to
# 0.015 with 32, at 1.7 times the time.
HALO = 16

# Rectangles begin at multiples of the stride of the network that comes with ExWarp, whose coarsest
# pixels then lie as in the whole frame. With 24 pixels around, which is no multiple, the difference
# was twice that with 16.
GRID = 16

# A tile is mixed into its neighbours within this share of its height, and at most in HALO.
RAMP = 1 / 8

Float = npt.NDArray[np.floating]

# First row or column, and the one after the last.
Span = tuple[int, int]

# Neighbouring tiles: their rows and columns of tiles.
Box = tuple[Span, Span]


@dataclass(frozen=True)
class Tiles:
    """The tiles of a frame, and the pixels that are sampled in them."""

    canvas: Window  # of the arrays
    display: Window  # that the tiles divide

    @property
    def stride(self) -> int:
        """Every so many-th row and column is sampled."""
        return max(1, -(-min(self.canvas.shape) // SAMPLED_ROWS))

    @property
    def columns(self) -> int:
        """Number of columns of tiles; rows are `TILE_ROWS`."""
        return count_columns(self.display.width, self.display.height)

    def sample(self, values: np.ndarray) -> np.ndarray:
        """Return the samples of an array [H, W, ...] on the canvas."""
        return values[:: self.stride, :: self.stride]

    def means(self, maps: Sequence[np.ndarray]) -> F64:
        """Return the means of samples [h, w] over each tile, [N, rows, columns]; 0 outside."""
        down, across = self.spans(self.stride, maps[0].shape)
        counts = np.outer([b - a for a, b in down], [b - a for a, b in across])
        # Plain sums, in an order that no number of threads changes.
        strips = [[values[a:b].sum(axis=0, dtype=np.float64) for a, b in down] for values in maps]
        sums = np.stack([np.array(strips)[..., a:b].sum(axis=-1) for a, b in across], axis=-1)
        return np.asarray(sums / np.maximum(counts, 1))

    def spans(self, stride: int, shape: tuple[int, ...]) -> tuple[list[Span], list[Span]]:
        """Return the rows and columns of each tile in an array of every `stride`-th pixel."""
        out = []
        for offset, size, parts, end in (
            (self.display.y - self.canvas.y, self.display.height, TILE_ROWS, shape[0]),
            (self.display.x - self.canvas.x, self.display.width, self.columns, shape[1]),
        ):
            first = (-(-(offset + edge) // stride) for edge in tile_edges(size, parts))
            out.append(list(pairwise(min(max(place, 0), end) for place in first)))
        return out[0], out[1]


@dataclass(frozen=True)
class Mosaic:
    """Pixels of each row and column of tiles; together all of the frame."""

    down: tuple[Span, ...]
    across: tuple[Span, ...]

    @classmethod
    def of(cls, tiles: Tiles) -> Mosaic:
        """Place the tiles; the outer ones reach to the frame's borders."""
        down, across = tiles.spans(1, tiles.canvas.shape)
        for spans, size in zip((down, across), tiles.canvas.shape, strict=True):
            spans[0] = 0, spans[0][1]
            spans[-1] = spans[-1][0], size
        return cls(tuple(down), tuple(across))

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the frame."""
        return self.down[-1][1], self.across[-1][1]

    @property
    def ramp(self) -> int:
        """Pixels beyond a tile in which it is mixed into its neighbours."""
        first, last = self.down[len(self.down) // 2]
        return min(max(int((last - first) * RAMP), 1), HALO - 1)

    def means(self, values: Float) -> F64:
        """Return the means over each tile, float64 [rows, columns], of values [H, W]."""
        tiles = [[values[a:b, c:d] for c, d in self.across] for a, b in self.down]
        return np.array([[tile.mean(dtype=np.float64) for tile in row] for row in tiles])

    def weight(self, chosen: Bool) -> Float32:
        """Return the weight of chosen tiles, bool [rows, columns], at each pixel, float32 [H, W].

        1 in them, falling to 0 beyond.
        """
        out = np.zeros(self.shape, np.float32)
        for row, column in np.argwhere(chosen):
            places, weights = [], []  # along each axis, of the tile and its ramps
            for (begin, end), size in zip(
                (self.down[row], self.across[column]), self.shape, strict=True
            ):
                first, last = max(begin - self.ramp, 0), min(end + self.ramp, size)
                place = np.arange(first, last)
                distance = np.maximum(np.maximum(begin - place, place - (end - 1)), 0)
                places.append(slice(first, last))
                weights.append((1 - distance / (self.ramp + 1)).astype(np.float32))
            part = out[places[0], places[1]]
            np.maximum(part, weights[0][:, None] * weights[1], out=part)
        return out

    def parts(self, chosen: Bool) -> list[tuple[Box, slice, slice]]:
        """Return the boxes that chosen tiles are computed in, and the pixels the network sees.

        Neighbours together where that saves pixels; one box of all tiles where the others would
        take as many.
        """
        boxes: list[Box] = []
        for row, marks in enumerate(chosen):
            steps = np.diff(np.concatenate([[0], marks, [0]]))
            firsts, lasts = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
            runs = zip(firsts.tolist(), lasts.tolist(), strict=True)
            boxes += [((row, row + 1), run) for run in runs]
        count = len(boxes) + 1
        while len(boxes) < count:
            count, merged = len(boxes), list[Box]()
            for box in boxes:
                for index, other in enumerate(merged):
                    rows, columns = (
                        (min(a[0], b[0]), max(a[1], b[1])) for a, b in zip(box, other, strict=True)
                    )
                    union = rows, columns
                    if self._cost(union) <= self._cost(box) + self._cost(other):
                        merged[index] = union
                        break
                else:
                    merged.append(box)
            boxes = merged
        full = (0, len(self.down)), (0, len(self.across))
        if sum(map(self._cost, boxes)) >= self._cost(full):
            boxes = [full]
        return [(box, *self._with_halo(box)) for box in boxes]

    def inside(self, box: Box) -> tuple[slice, slice]:
        """Return the pixels of a box of tiles."""
        (top, bottom), (left, right) = box
        return (
            slice(self.down[top][0], self.down[bottom - 1][1]),
            slice(self.across[left][0], self.across[right - 1][1]),
        )

    def _with_halo(self, box: Box) -> tuple[slice, slice]:
        rows, columns = (
            slice(max(inside.start - HALO, 0) // GRID * GRID, min(inside.stop + HALO, size))
            for inside, size in zip(self.inside(box), self.shape, strict=True)
        )
        return rows, columns

    def _cost(self, box: Box) -> int:
        rows, columns = self._with_halo(box)
        return int((rows.stop - rows.start) * (columns.stop - columns.start))


def lay_tiles(
    mosaic: Mosaic,
    # Of `Mosaic.parts`, and what a network makes of their pixels, float32 [C, h, w].
    parts: Iterable[tuple[Box, slice, slice, Float32]],
    out: Float,  # [C, H, W], written in the chosen tiles and in the ramps
) -> None:
    """Lay what a network makes in chosen tiles into a frame."""
    cores: list[tuple[slice, slice, Float32]] = []
    for box, rows, columns, planes in parts:
        out[:, rows, columns] = planes
        down, across = mosaic.inside(box)
        core = planes[
            :,
            down.start - rows.start : down.stop - rows.start,
            across.start - columns.start : across.stop - columns.start,
        ]
        cores.append((down, across, core))
    for down, across, core in cores:  # over what others made around their own tiles
        out[:, down, across] = core


def lay_over(below: Float32, above: Float32, weight: Float32) -> Float32:
    """Mix `above` over `below`, [H, W, C], by a weight, float32 [H, W].

    Where the weight is 0 or 1 the result is exactly one of the two.
    """
    share = weight[..., None]
    mixed = below + share * (above - below)
    return np.where(share == 1, above, np.where(share == 0, below, mixed))
