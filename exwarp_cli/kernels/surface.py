"""A slot's surfaces from where motion fields lead."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from exwarp_cli.kernels._compile import inlined, parallel, part
from exwarp_cli.kernels._row_bands import Share, turns
from exwarp_cli.kernels.gather import FURTHEST, clear, sample_border

F32 = npt.NDArray[np.float32]
B8 = npt.NDArray[np.bool_]
Parts = tuple[F32, F32, F32, F32]
Colours = tuple[F32, F32]


@inlined
def end_of(
    i: int, j: int, move_x: np.float32, move_y: np.float32, height: int, width: int
) -> tuple[int, int]:
    """Return row and column of the pixel nearest to where pixel (i, j) comes; -1 beyond the frame.

    In double precision, as ends lie between pixels often enough to be rounded the other way.
    """
    x = np.float64(j) + np.float64(move_x) + 0.5
    y = np.float64(i) + np.float64(move_y) + 0.5
    if x >= 0 and y >= 0 and x <= width and y <= height:  # no for NaN
        return min(int(y), height - 1), min(int(x), width - 1)
    return -1, -1


@part
def sample_colour(
    colour: F32, shape: tuple[int, int, int], x: np.float32, y: np.float32, out: F32, place: int
) -> None:
    """Write a colour from `place` on, as `exwarp_cli.kernels.gather.gather_bilinear` does."""
    shown = False
    if abs(x) < FURTHEST and abs(y) < FURTHEST:
        shown = sample_border(colour, shape, x, y, out, place)
    if not shown:
        clear(out, place, shape[2])


@inlined
def copy_parts(here: Parts, q: int, p: int, made: Parts, i: int, j: int) -> None:
    """Copy what is known of a frame's pixel (q, p) to the slot's (i, j)."""
    depth, normal, roughness, metallic = here
    # Unsigned indices need no test for counting from the end.
    y, x, row, column = np.uint64(q), np.uint64(p), np.uint64(i), np.uint64(j)
    if depth.size > 0:
        made[0][row, column] = depth[y, x]
    if normal.size > 0:
        for c in range(3):
            made[1][row, column, c] = normal[y, x, c]
    if roughness.size > 0:
        made[2][row, column] = roughness[y, x]
    if metallic.size > 0:
        made[3][row, column] = metallic[y, x]


@inlined
def blank(made: Parts, colours: Colours, i: int, j: int, place: int) -> None:
    """Write what stands for nothing to the slot's pixel (i, j), in colours from `place` on."""
    depth, normal, roughness, metallic = made
    row, column = np.uint64(i), np.uint64(j)
    if depth.size > 0:
        depth[row, column] = np.float32(np.nan)
    for c in range(3):
        if normal.size > 0:
            normal[row, column, c] = np.float32(0)
        if colours[0].size > 0:
            colours[0][place + c] = np.float32(0)
        if colours[1].size > 0:
            colours[1][place + c] = np.float32(0)
    if roughness.size > 0:
        roughness[row, column] = np.float32(0)
    if metallic.size > 0:
        metallic[row, column] = np.float32(0)


@parallel
def take_over(
    field: F32,
    here: Parts,
    colours: Colours,
    made: Parts,
    made_colours: Colours,
    unknown: B8,
    blanks: bool,
    share: Share,
) -> None:
    """Take over a frame's surfaces where a slot's are not known yet.

    Parameters
    ----------
    field
        float32 [H, W, 2], pixels, from the slot to the frame; NaN where it shows nothing.
    here
        The frame's depth [H, W], normal [H, W, 3], roughness and metallic [H, W], float32; [0, 0]
        and [0, 0, 3] for what is not known. The nearest pixel's are taken.
    colours
        The frame's albedo and specular, float32 [H W 3]; [0] for what is not known. They are
        sampled bilinearly.
    made, made_colours
        The slot's, changed; where the frame's is empty, they may be so, too.
    unknown
        bool [H, W], changed: what becomes known is taken off.
    blanks
        Whether the slot's parts and colours become NaN, for depth, and 0 where nothing is known.
    """
    height, width, _ = field.shape
    shape = (height, width, 3)
    for i in turns(height, share):
        for j in range(width):
            if not unknown[i, j]:
                continue
            q, p = end_of(i, j, field[i, j, 0], field[i, j, 1], height, width)
            place = (i * width + np.int64(j)) * 3
            if q < 0:
                if blanks:
                    blank(made, made_colours, i, j, place)
                continue
            unknown[i, j] = False
            copy_parts(here, q, p, made, i, j)
            x, y = np.float32(j) + field[i, j, 0], np.float32(i) + field[i, j, 1]
            if colours[0].size > 0:
                sample_colour(colours[0], shape, x, y, made_colours[0], place)
            if colours[1].size > 0:
                sample_colour(colours[1], shape, x, y, made_colours[1], place)


@parallel
def go_on(predicted: F32, moved: F32, lost: B8, share: Share) -> None:
    """Give points that are not known where they come from the place that is predicted.

    Parameters
    ----------
    predicted
        float32 [H, W, 2], pixels; NaN where nothing is.
    moved
        float32 [H, W, 2], pixels, changed where it is NaN.
    lost
        bool [H, W], changed: false for these.
    """
    height, width, _ = moved.shape
    for i in turns(height, share):
        for j in range(width):
            if math.isnan(moved[i, j, 0]) and not math.isnan(predicted[i, j, 0]):
                moved[i, j, 0], moved[i, j, 1] = predicted[i, j, 0], predicted[i, j, 1]
                lost[i, j] = False
