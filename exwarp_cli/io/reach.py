"""How far a network sees, found out by running it.

A model's graph says so only where each of its operators is understood, reshaping and indexing with
computed sizes too. What it does is plain instead: NaN that is put in comes out wherever it is seen,
as convolutions, pools, gates and sums hand it on. Where NaN is swallowed (some maxima) or the place
in the picture counts, a picture and a part of it differ, which is tried as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from exwarp_cli.domain.extrapolator import INPUTS
from exwarp_cli.domain.frame import Float32

Run = Callable[[Mapping[str, Float32]], Float32]
"""Runs a network on pictures float32 [C, H, W] by input; gives [3, H, W]."""

SIDES = (384, 1024)
"""Pixels of the pictures that are tried. The shipped network sees 80 pixels far; what sees farther
than half of the second picture is not worth cutting up."""

LEAST_CELLS = 7
SAME = 1e-5
"""Largest difference between a picture and a part of it that is rounding."""


def reach_of(run: Run, stride: int) -> int | None:
    """Return how many pixels away from one that it is given a network's answer may change.

    Parameters
    ----------
    run
        The network.
    stride
        What height and width have to be multiples of.

    Returns
    -------
    int or None
        A multiple of the stride; None where the network sees too far, all of the picture (global
        pools, normalisation by the picture's own mean), or where in the picture it is.
    """
    for side in SIDES:
        cells = max(LEAST_CELLS, side // stride) // 2 * 2 + 1
        picture = _noise(cells * stride)
        margin = _seen(run, picture, stride, cells)
        if margin is not None and _is_part(run, picture, stride, margin):
            return margin * stride
    return None


def _noise(side: int) -> dict[str, Float32]:
    rng = np.random.default_rng(side)
    shapes = {name: (count, side, side) for name, count in INPUTS.items()}
    return {name: rng.random(shape, dtype=np.float32) for name, shape in shapes.items()}


def _seen(run: Run, picture: dict[str, Float32], stride: int, cells: int) -> int | None:
    """Return how many strides NaN in the middle one spreads; None when it comes near the border."""
    middle = cells // 2
    cell = slice(middle * stride, (middle + 1) * stride)
    spoilt = {name: planes.copy() for name, planes in picture.items()}
    for planes in spoilt.values():
        planes[:, cell, cell] = np.nan
    reached = np.isnan(run(spoilt)).any(axis=0)
    away = np.abs(np.argwhere(reached) // stride - middle)
    margin = int(away.max(initial=0))
    return margin if margin < middle else None


def _is_part(run: Run, picture: dict[str, Float32], stride: int, margin: int) -> bool:
    """Whether a part of a picture, but for its margin, becomes what the whole does there."""
    side = next(iter(picture.values())).shape[-1]
    part = slice(stride, side - stride)
    inner = slice((1 + margin) * stride, side - (1 + margin) * stride)
    whole = run(picture)[:, inner, inner]
    found = run({name: np.ascontiguousarray(p[:, part, part]) for name, p in picture.items()})
    kept = slice(margin * stride, found.shape[-1] - margin * stride)
    return bool(np.abs(found[:, kept, kept] - whole).max() <= SAME)
