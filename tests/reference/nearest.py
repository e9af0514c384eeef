"""Naive twins of the kernels that choose source pixels: plain loops, straight from the text."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from tests.reference.fill import seen_from

FRINGE = 0.02
SAME_DEPTH = 0.1
AS_LIKELY = 0.8


def same_depth(a: float, b: float) -> bool:
    """Whether two depths may be those of one surface."""
    if math.isinf(a) or math.isinf(b):
        return a == b
    return a == b or abs(a - b) < SAME_DEPTH * max(abs(a), abs(b))


def around(x: float, y: float, shape: tuple[int, ...]) -> Iterator[tuple[int, int]]:
    """The four pixels (row, column) around a point, as far as they are there."""
    for row in (math.floor(y), math.floor(y) + 1):
        for column in (math.floor(x), math.floor(x) + 1):
            if 0 <= row < shape[0] and 0 <= column < shape[1]:
                yield row, column


def end_of(x: float, y: float, wanted: float, depth: np.ndarray) -> tuple[int, int] | None:
    """The pixel (row, column) that a point shows; None outside."""
    height, width = depth.shape
    if not (-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5):
        return None
    row, column = min(math.floor(y + 0.5), height - 1), min(math.floor(x + 0.5), width - 1)
    if math.isnan(wanted) or same_depth(wanted, depth[row, column]):
        return row, column
    alike = [place for place in around(x, y, depth.shape) if same_depth(wanted, depth[place])]
    return min(alike, key=lambda p: (x - p[1]) ** 2 + (y - p[0]) ** 2, default=(row, column))


def choose(sides: list[tuple[np.ndarray, ...]], time: float) -> tuple[np.ndarray, ...]:
    """Return source pixels, whether they lie in the later key frame, the depth and the holes.

    `sides` are one or two of field, depth at the slot, the key frame's depth, hole and fringe.
    """
    shape = sides[0][1].shape
    pixel, later = np.full(shape, -1), np.zeros(shape, bool)
    depth = np.full(shape, np.nan)
    for i, j in np.ndindex(shape):
        best = 0.0
        for number, (field, at_slot, own, hole, fringe) in enumerate(sides):
            if not math.isnan(at_slot[i, j]):
                depth[i, j] = np.nanmin([depth[i, j], at_slot[i, j]])
            if hole[i, j] or math.isnan(at_slot[i, j]):
                continue
            x, y = float(np.float32(j) + field[i, j, 0]), float(np.float32(i) + field[i, j, 1])
            end = end_of(x, y, float(at_slot[i, j]), own)
            share = (time if number else 1 - time) * (FRINGE if fringe[i, j] else 1)
            if end is not None and share > best:
                best, later[i, j] = share, number == 1
                pixel[i, j] = end[0] * shape[1] + end[1]
    return pixel, later, depth, pixel < 0


def adopt(chosen: tuple[np.ndarray, ...], cap: float, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Return source pixels and sides with the holes filled from what `choose` returned."""
    pixel, later, depth, hole = chosen
    out, side = pixel.copy(), later.copy()
    for i, j in zip(*np.nonzero(hole), strict=True):
        seen = [
            ((y - i) ** 2 + (x - j) ** 2, min(float(depth[y, x]), cap), y, x)
            for _, _, y, x in seen_from(i, j, hole, reach)
        ]
        wanted = min(float(depth[i, j]), cap)
        if math.isnan(depth[i, j]):
            wanted = max((far for _, far, *_ in seen), default=0.0)
        alike = [min(far, wanted) / max(far, wanted) for _, far, *_ in seen]
        fit = [place for place, a in zip(seen, alike, strict=True) if a >= AS_LIKELY * max(alike)]
        if fit:
            _, _, y, x = min(fit, key=lambda place: place[0])
            out[i, j], side[i, j] = pixel[y, x], later[y, x]
        else:
            out[i, j], side[i, j] = i * hole.shape[1] + j, False
    return out, side


def sample_surface(image: np.ndarray, depth: np.ndarray, field: np.ndarray) -> np.ndarray:
    """Return what lies at the end of a field, mixed from pixels of one surface, float64."""
    out = np.full(image.shape, np.nan)
    for i, j in np.ndindex(depth.shape):
        x, y = float(np.float32(j) + field[i, j, 0]), float(np.float32(i) + field[i, j, 1])
        end = end_of(x, y, math.nan, depth)
        if end is None:
            continue
        total, value = 0.0, np.zeros(image.shape[2])
        for row in (math.floor(y), math.floor(y) + 1):
            for column in (math.floor(x), math.floor(x) + 1):
                weight = (1 - abs(x - column)) * (1 - abs(y - row))
                row_in = min(max(row, 0), depth.shape[0] - 1)
                column_in = min(max(column, 0), depth.shape[1] - 1)
                if weight > 0 and same_depth(depth[row_in, column_in], depth[end]):
                    total += weight
                    value += weight * image[row_in, column_in].astype(np.float64)
        out[i, j] = value / total
    return out
