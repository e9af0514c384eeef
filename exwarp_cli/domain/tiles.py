"""Cutting a picture into tiles that overlap, so that what a network makes of them has no seams.

Near its border a tile lacks the pixels that the network would have seen beyond. What lies within
the network's reach of a border inside the picture is therefore made but not kept: it is another
tile's. Tiles begin and end at multiples of the network's stride, where its coarsest pixels do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache


@dataclass(frozen=True)
class Span:
    """A tile along one axis, in pixels of the picture.

    Attributes
    ----------
    begin, end
        What the network is given.
    first, last
        What is kept of its answer: from `first` to before `last`.
    """

    begin: int
    end: int
    first: int
    last: int

    @property
    def seen(self) -> slice:
        """What the network is given."""
        return slice(self.begin, self.end)

    @property
    def kept(self) -> slice:
        """Where what is kept lies in the picture."""
        return slice(self.first, self.last)

    @property
    def inside(self) -> slice:
        """Where what is kept lies in the tile."""
        return slice(self.first - self.begin, self.last - self.begin)


Tile = tuple[Span, Span]
"""Rows and columns."""


@lru_cache(maxsize=8)
def cut(size: tuple[int, int], stride: int, reach: int, most: int) -> tuple[Tile, ...]:
    """Cut a picture into tiles of equal size, as few pixels in all as can be.

    Parameters
    ----------
    size
        Height and width of the picture, multiples of `stride`.
    stride
        Where tiles may begin and end.
    reach
        How many pixels away from one that it is given the network's answer may change.
    most
        Pixels of a tile. Where even the smallest tiles have more, those are taken.

    Returns
    -------
    tuple of Tile
        What they keep covers each pixel once. They go by these numbers alone, so that every part
        of a sequence is cut alike.
    """
    margin = -(-reach // stride)
    rows, columns = (list(_lengths(n // stride, margin)) for n in size)
    every = [(a, b) for a in rows for b in columns]
    fits = [pair for pair in every if pair[0][1] * pair[1][1] * stride**2 <= most]
    chosen = min(fits, key=_work) if fits else min(every, key=lambda pair: pair[0][1] * pair[1][1])
    down, across = (
        _spans(n // stride, count, length, margin, stride)
        for n, (count, length) in zip(size, chosen, strict=True)
    )
    return tuple((row, column) for row in down for column in across)


def _work(pair: tuple[tuple[int, int], tuple[int, int]]) -> tuple[int, int]:
    """Coarsest pixels that are worked on in all; then how many tiles there are."""
    (rows, height), (columns, width) = pair
    return rows * height * columns * width, rows * columns


def _lengths(cells: int, margin: int) -> list[tuple[int, int]]:
    """Return every number of tiles along an axis, with their length; both in strides."""
    found = [(1, cells)]
    for count in range(2, cells - 2 * margin + 1):
        length = -(-(cells - 2 * margin) // count) + 2 * margin
        if length < found[-1][1]:
            found.append((count, length))
    return found


def _spans(cells: int, count: int, length: int, margin: int, stride: int) -> list[Span]:
    """Spread tiles of one length evenly over an axis."""
    starts = [i * (cells - length) // max(count - 1, 1) for i in range(count)]
    firsts = [0, *(start + margin for start in starts[1:])]
    lasts = [*firsts[1:], cells]
    return [
        Span(start * stride, (start + length) * stride, first * stride, last * stride)
        for start, first, last in zip(starts, firsts, lasts, strict=True)
    ]
