"""Planes as networks take them, from interleaved pixels."""

from __future__ import annotations

import math

import numpy as np

from exwarp_cli.kernels._compile import ParallelKernel, device_function, inline
from exwarp_cli.kernels._row_bands import Band, band_range
from exwarp_cli.kernels.array_types import B8, F32
from exwarp_cli.kernels.gather import clamp

Frame = tuple[F32, B8]

# First planes of the colour of the three frames and of the filled one, and planes of their masks.
COLOUR_PLANES, MASK_PLANES = (13, 17, 21, 3), (16, 20, 24)

# Least median of depths, which are divided by it.
MIN_MEDIAN = np.float32(np.finfo(np.float32).tiny)


@inline
def _clamp_known(value: np.float32, low: float, high: float, unknown: float) -> np.float32:
    if math.isnan(value):
        return np.float32(unknown)
    return np.float32(low) if value < low else np.float32(high) if value > high else value


PlaneRow = tuple[int, int]  # A plane and a row of it

# Columns of a part that lie in the frame: the first, the one after the last, and the first's column
# in the frame. At least one.
Columns = tuple[int, int, int]


@device_function
def _write_colour(
    pixels: F32, at: int, channels: int, columns: Columns, out: F32, place: PlaneRow
) -> None:
    """Write three lines of colour from a row of `pixels` [H W C] that begins at pixel `at`."""
    begin, end, start = columns
    plane, y = place
    span = slice(begin, end)
    red, green, blue = out[plane, y][span], out[plane + 1, y][span], out[plane + 2, y][span]
    row = pixels[(at + start) * channels : (at + start + end - begin) * channels]
    for n in range(red.size):
        first = np.uint64(channels) * np.uint64(n)
        red[n] = row[first]
        green[n] = row[first + np.uint64(1)]
        blue[n] = row[first + np.uint64(2)]


@device_function
def _write_surface_row(
    rows: tuple[int, int],  # as `columns`, `out`: see `_write_input_row`
    columns: Columns,
    surface: tuple[F32, F32, F32, F32],  # as for `write_input_planes`, as are the next two
    defaults: tuple[float, float, float],
    median: np.float32,
    out: F32,
) -> None:
    """Write one row of the planes of a slot's normal, depth, roughness and metallic."""
    (i, y), (begin, end, start) = rows, columns
    depth, normal, materials = surface[0], surface[1], (surface[2], surface[3])
    if normal.size > 0:
        _write_colour(normal.reshape(-1), i * normal.shape[1], 3, columns, out, (7, y))
    for c in range(3):
        line = out[7 + c, y]
        for x in range(begin, end):
            value = line[x] if normal.size > 0 else np.float32(0)
            value = np.float32(0) if math.isinf(value) else value
            line[x] = _clamp_known(value, -1.0, 1.0, 0.0)
    scale = max(median, MIN_MEDIAN)
    for n in range(end - begin):
        value = depth[i, start + n] if depth.size > 0 else np.float32(np.nan)
        distance = np.float32(0) if value < 0 else value
        nearness = np.float32(median / np.float32(distance + scale))
        relative = np.float32(np.float32(1) - nearness)
        out[10, y, begin + n] = _clamp_known(relative, 0.0, 1.0, defaults[0])
    for k in range(2):
        line, material, unknown = out[11 + k, y], materials[k], defaults[1 + k]
        for n in range(end - begin):
            value = material[i, start + n] if material.size > 0 else np.float32(np.nan)
            line[begin + n] = _clamp_known(value, 0.0, 1.0, unknown)


@device_function
def _write_input_row(
    rows: tuple[int, int],  # of the frame, and of the planes
    columns: Columns,
    pixels: tuple[F32, F32, F32, F32],  # of the three frames, and of the filled one
    masks: tuple[B8, B8, B8],
    out: F32,
) -> None:
    """Write one row of a slot's planes, but for those of its surface."""
    # Plane by plane: for one pixel after the other, lines of 25 planes, mostly a multiple of 4096
    # bytes apart, evicted each other from the cache.
    i, y = rows
    at = i * pixels[0].shape[1]
    for k in range(4):  # a call for each took twice as long to compile
        colour = pixels[k]
        _write_colour(colour.reshape(-1), at, colour.shape[2], columns, out, (COLOUR_PLANES[k], y))
    begin, end, start = columns
    for k in range(3):
        line, row = out[MASK_PLANES[k], y], masks[k][i]
        for n in range(end - begin):
            line[begin + n] = np.float32(row[start + n])
    # Again the newest frame's mask, and its colour there alone.
    mask, copy = out[MASK_PLANES[0], y], out[6, y]
    for x in range(mask.size):  # as a slice, it took a second more to compile
        copy[x] = mask[x]
    for c in range(3):
        colour_line, visible = out[COLOUR_PLANES[0] + c, y], out[c, y]
        for x in range(mask.size):
            visible[x] = colour_line[x] * mask[x]
    for plane in range(out.shape[0]):  # beyond the frame its edge
        line = out[plane, y]
        for x in range(begin):
            line[x] = line[begin]
        for x in range(end, line.size):
            line[x] = line[end - 1]


@ParallelKernel
def write_input_planes(
    # frames: F_k, F_k-1, F_k-2 moved to the slot: colour [H, W, C] and mask [H, W]
    frames: tuple[Frame, Frame, Frame],
    filled: F32,  # [H, W, C]: the frame of W
    # surface: depth [H, W], normal [H, W, 3], roughness, metallic of the slot; [0, 0(, 3)] if
    # unknown
    surface: tuple[F32, F32, F32, F32],
    defaults: tuple[float, float, float],  # relative depth, roughness and metallic where unknown
    median: np.float32,  # of the finite depth: becomes 0.5
    # corner: row and column of the part's first pixel; beyond the frame its edge is repeated
    corner: tuple[int, int],
    # out: [25, h, w], written: the inputs of `EXTRAPOLATOR_INTERFACE` in `domain.network_api`
    out: F32,
    band: Band,
) -> None:
    """Write a part of a slot's planes, colour still linear."""
    height, width, _ = filled.shape
    pixels = (frames[0][0], frames[1][0], frames[2][0], filled)
    masks = (frames[0][1], frames[1][1], frames[2][1])
    left, count = corner[1], out.shape[2]
    begin = clamp(-left, 0, count - 1)
    columns = begin, clamp(width - left, begin + 1, count), clamp(left + begin, 0, width - 1)
    for y in band_range(out.shape[1], band):
        i = clamp(corner[0] + y, 0, height - 1)
        _write_surface_row((i, y), columns, surface, defaults, median, out)
        _write_input_row((i, y), columns, pixels, masks, out)
