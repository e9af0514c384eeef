"""Planes as networks take them, from interleaved pixels and back."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.gather import clamp

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]
Frame = tuple[F32, B8]

COLOURS, SHOWN = (13, 17, 21, 3), (16, 20, 24)
"""First of the planes that hold colour of the three frames and the filled one, and the planes of
what the frames show."""

NEAREST = np.float32(np.finfo(np.float32).tiny)
"""Least median of the depths that anything is divided by."""


@inlined
def within(value: np.float32, low: float, high: float, unknown: float) -> np.float32:
    """Return a value held within bounds; `unknown` for NaN."""
    if math.isnan(value):
        return np.float32(unknown)
    return np.float32(low) if value < low else np.float32(high) if value > high else value


@inlined
def direction(value: np.float32) -> np.float32:
    """Return a normal's component, -1 to 1; 0 where it is not finite."""
    return np.float32(0) if math.isinf(value) else within(value, -1.0, 1.0, 0.0)


Place = tuple[int, int]
"""A plane and a row of it."""

Columns = tuple[int, int, int]
"""Of a part that lie in the frame: the first, the one after the last, and what the first is there.
At least one counts as such."""


@part
def columns_of(left: int, width: int, count: int) -> Columns:
    """Return which of `count` columns, the first being `left`, lie in a frame of some width."""
    begin = clamp(-left, 0, count - 1)
    return begin, clamp(width - left, begin + 1, count), clamp(left + begin, 0, width - 1)


@part
def set_all(value: np.float32, line: F32) -> None:
    """Write one value to a line."""
    for x in range(line.size):
        line[x] = value


@part
def repeat_ends(columns: Columns, y: int, out: F32) -> None:
    """Write what lies beyond the frame in row y of all planes."""
    begin, end, _ = columns
    for plane in range(out.shape[0]):
        line = out[plane, y]
        for x in range(begin):
            line[x] = line[begin]
        for x in range(end, line.size):
            line[x] = line[end - 1]


@part
def write_colour(
    pixels: F32, at: int, channels: int, columns: Columns, out: F32, place: Place
) -> None:
    """Write three lines of colour from a row of `pixels` [H W C] that begins at pixel `at`."""
    begin, end, start = columns
    plane, y = place
    some = slice(begin, end)
    one, two, three = out[plane, y][some], out[plane + 1, y][some], out[plane + 2, y][some]
    row = pixels[(at + start) * channels : (at + start + end - begin) * channels]
    for n in range(one.size):
        first = np.uint64(channels) * np.uint64(n)
        one[n] = row[first]
        two[n] = row[first + np.uint64(1)]
        three[n] = row[first + np.uint64(2)]


@part
def write_shown(row: B8, columns: Columns, line: F32) -> None:
    """Write 1 where a row is true, else 0."""
    begin, end, start = columns
    for n in range(end - begin):
        line[begin + n] = np.float32(row[start + n])


@part
def write_shown_colour(y: int, out: F32) -> None:
    """Write again what the newest frame shows, and its colour there alone."""
    shown, again = out[SHOWN[0], y], out[6, y]
    for x in range(shown.size):  # as a slice, it took a second more to compile
        again[x] = shown[x]
    for c in range(3):
        line, made = out[COLOURS[0] + c, y], out[c, y]
        for x in range(shown.size):
            made[x] = line[x] * shown[x]


@part
def write_normals(normal: F32, at: int, columns: Columns, out: F32, place: Place) -> None:
    """Write three lines of a row of normals [H W 3] that begins at pixel `at`; 0 without any."""
    begin, end, _ = columns
    plane, y = place
    if normal.size == 0:
        for c in range(3):
            set_all(np.float32(0), out[plane + c, y])
        return
    write_colour(normal, at, 3, columns, out, place)
    for c in range(3):
        line = out[plane + c, y][begin:end]
        for n in range(line.size):
            line[n] = direction(line[n])


@part
def write_depth(
    depth: F32, at: int, columns: Columns, median: np.float32, unknown: float, line: F32
) -> None:
    """Write a line of relative depth from a row of `depth` [H W] that begins at pixel `at`."""
    if depth.size == 0:
        set_all(np.float32(unknown), line)
        return
    begin, end, start = columns
    middle = max(median, NEAREST)
    for n in range(end - begin):
        given = depth[np.uint64(at + start + n)]
        away = np.float32(0) if given < 0 else given
        near = np.float32(median / np.float32(away + middle))
        line[begin + n] = within(np.float32(np.float32(1) - near), 0.0, 1.0, unknown)


@part
def write_share(values: F32, at: int, columns: Columns, unknown: float, line: F32) -> None:
    """Write a line of values held within 0 and 1 from a row of `values` [H W]."""
    if values.size == 0:
        set_all(np.float32(unknown), line)
        return
    begin, end, start = columns
    for n in range(end - begin):
        line[begin + n] = within(values[np.uint64(at + start + n)], 0.0, 1.0, unknown)


@part
def spread_row(
    rows: tuple[int, int],
    columns: Columns,
    pixels: tuple[F32, F32, F32, F32],
    shown: tuple[B8, B8, B8],
    known: tuple[tuple[F32, F32], tuple[F32, F32]],
    defaults: tuple[float, float, float],
    median: np.float32,
    out: F32,
) -> None:
    """Write a row of a slot's planes as `spread` does; `rows` are that of the frame, and it.

    `pixels` are those of the three frames there, and the filled ones; `shown` what the frames show,
    `known` depth and normal, then roughness and metallic.

    Plane by plane: written for one pixel after the other, lines of 25 planes, whose places mostly
    are a multiple of 4096 bytes apart, drove each other out of the cache.
    """
    (i, y), ((depth, normal), materials) = rows, known
    at = i * pixels[0].shape[1]
    for k in range(4):  # a call for each took twice as long to compile
        colour = pixels[k]
        write_colour(colour.reshape(-1), at, colour.shape[2], columns, out, (COLOURS[k], y))
    for k in range(3):
        write_shown(shown[k][i], columns, out[SHOWN[k], y])
    write_normals(normal.reshape(-1), at, columns, out, (7, y))
    write_depth(depth.reshape(-1), at, columns, median, defaults[0], out[10, y])
    for k in range(2):
        write_share(materials[k].reshape(-1), at, columns, defaults[1 + k], out[11 + k, y])
    write_shown_colour(y, out)
    repeat_ends(columns, y, out)


@parallel
def spread(
    frames: tuple[Frame, Frame, Frame],
    filled: F32,
    surface: tuple[F32, F32, F32, F32],
    defaults: tuple[float, float, float],
    median: np.float32,
    corner: tuple[int, int],
    out: F32,
    share: Share,
) -> None:
    """Write a part of a slot's planes, colour still linear.

    Parameters
    ----------
    frames
        F_k, F_k-1 and F_k-2 moved to the slot: colour float32 [H, W, C] and bool [H, W], where they
        show it.
    filled
        float32 [H, W, C]: the frame of W.
    surface
        Depth [H, W], normal [H, W, 3], roughness and metallic [H, W] of the slot, float32; [0, 0]
        and [0, 0, 3] for what is not known.
    defaults
        Relative depth, roughness and metallic where they are not known.
    median
        Of the depth where it is finite: becomes 0.5.
    corner
        Row and column of the part's first pixel. What lies beyond the frame repeats its edge.
    out
        float32 [25, h, w], written: `warped`, `mask`, `features` and `history` of
        `exwarp_cli.domain.extrapolator.NetworkInputs`.
    """
    height, width, _ = filled.shape
    pixels = (frames[0][0], frames[1][0], frames[2][0], filled)
    shown = (frames[0][1], frames[1][1], frames[2][1])
    shape, materials = (surface[0], surface[1]), (surface[2], surface[3])
    columns = columns_of(corner[1], width, out.shape[2])
    for y in turns(out.shape[1], share):
        i = clamp(corner[0] + y, 0, height - 1)
        spread_row((i, y), columns, pixels, shown, (shape, materials), defaults, median, out)


@parallel
def join(colour: F32, modulation: F32, filled: F32, out: F32, share: Share) -> None:
    """Write a network's answer as a frame.

    Parameters
    ----------
    colour
        float32 [3, H, W], linear.
    modulation
        float32 [H, W, 3] that it is multiplied with; [0, 0, 3] for nothing.
    filled
        float32 [H, W, C]: the filled warp, whose further channels are taken over.
    out
        float32 [H, W, C], written.
    """
    height, width, channels = filled.shape
    for i in turns(height, share):
        for j in range(width):
            for c in range(3):
                value = colour[c, i, j]
                if modulation.size:
                    value *= modulation[i, j, c]
                out[i, j, c] = value
            for c in range(3, channels):
                out[i, j, c] = filled[i, j, c]


@inlined
def surface_colour(
    diffuse: np.float32, glossy: np.float32, bounds: tuple[float, float]
) -> np.float32:
    """Return what a colour is divided by."""
    colour: np.float32 = within(np.float32(diffuse + glossy), bounds[0], bounds[1], np.nan)
    return colour


@parallel
def demodulate(
    pixels: F32,
    albedo: F32,
    specular: F32,
    bounds: tuple[float, float],
    out: F32,
    share: Share,
) -> None:
    """Divide a frame's colour by its surface colour; further channels are copied.

    Parameters
    ----------
    pixels
        float32 [H, W, C], scene-linear.
    albedo, specular
        float32 [H, W, 3]; their sum, held within `bounds`, is the surface colour.
    bounds
        Least and greatest.
    out
        float32 [H, W, C], written.
    """
    height, width, channels = pixels.shape
    for i in turns(height, share):
        diffuse, glossy = albedo[i].reshape(-1), specular[i].reshape(-1)
        given, made = pixels[i].reshape(-1), out[i].reshape(-1)
        for j in range(width):
            for c in range(3):
                colour = surface_colour(diffuse[3 * j + c], glossy[3 * j + c], bounds)
                made[channels * j + c] = given[channels * j + c] / colour
            for k in range(channels * j + 3, channels * (j + 1)):
                made[k] = given[k]
