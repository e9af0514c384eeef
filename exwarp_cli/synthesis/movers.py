"""What moves of itself, where ids do not say so: what does not keep its place in the world."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.frame import Bool, Float32, GBuffer, Int32
from exwarp_cli.kernels import silhouettes
from exwarp_cli.synthesis.camera import Scene, scene_of, seen_by
from exwarp_cli.synthesis.geometry import STATIC_TOLERANCE, depth_of, stands_still
from exwarp_cli.synthesis.trajectory import stencil_of

Indices = npt.NDArray[np.intp]

SLOW = 0.1
"""Pixels by which the vector of a point inside a surface may miss the cameras' motion.

Of points that stand still 99 % missed it by less than 0.02 px in three shots, by 0.08 in one, and
by 0.11 with half-float passes. At `STATIC_TOLERANCE`, which settled motion keeps to, half of what
moved was taken for standing still in slots 1/120 s apart; at 0.02 the ground of half-float shots
fell into pieces.
"""

SHARE = 0.1
"""Share of its pixels that have to move for an object to count as moving.

Of objects that stand still none had any; of those that move, three quarters or more, and what turns
slowly about its own middle up to two fifths. Of plants in the wind five in six
reached it over a key interval of 1/30 s, of what was near them a quarter, through their edges.
"""


def moving(now: GBuffer, before: GBuffer | None, raw: GBuffer | None) -> Bool | None:
    """Find the pixels whose world position changes; None where nothing tells.

    Parameters
    ----------
    now
        With settled motion.
    before
        The instant that `to_previous` leads to; None where there is none.
    raw
        `now` before its motion was settled, if it is at hand: settling takes what moves slowly for
        standing still, and counts at edges alone then.

    Returns
    -------
    bool [H, W] or None
        Background never moves.

    Notes
    -----
    World positions of both instants give both cameras, however much of the frame moves. The camera
    that fits the vectors best takes more than half of them to stand still: in a shot of leaves in
    the wind it was not found in every other frame.
    """
    here = scene_of(now)
    rigid = None if before is None else _between_cameras(now, here, before)
    if rigid is None:
        still = stands_still(now, here)
        return None if still is None else np.asarray(~still & ~now.background)
    assert now.to_previous is not None
    found = _away(now.to_previous, rigid, STATIC_TOLERANCE)
    if raw is not None and raw.to_previous is not None:
        depth = depth_of(raw)
        edge = np.empty(depth.shape, np.bool_)
        silhouettes.find_edges(depth, stencil_of(raw), edge)
        # At edges a vector is a mixture, or the nearest inside's; one of them may be wrong.
        found = _away(raw.to_previous, rigid, SLOW) & (found | ~edge)
    return np.asarray(found & ~now.background)


def _between_cameras(now: GBuffer, here: Scene | None, before: GBuffer) -> Float32 | None:
    """Return what stands still moves by, as world positions have it."""
    if now.to_previous is None or here is None or here.camera is None or before.position is None:
        return None
    there = scene_of(before)
    if there is None or there.camera is None:
        return None
    return seen_by(here, there.camera)


def _away(vectors: Float32, rigid: Float32, tolerance: float) -> Bool:
    """Whether vectors miss a motion; unknown ones do."""
    with np.errstate(invalid="ignore"):
        return np.asarray(~(np.abs(vectors - rigid).max(axis=-1) <= tolerance))


def of_moving(objects: Int32, moves: Bool) -> Int32:
    """Return a stencil of the objects that move.

    Parameters
    ----------
    objects
        int32 [H, W], id of whatever is shown; 0 background, negative where ids mix.
    moves
        bool [H, W], as of :func:`moving`.

    Returns
    -------
    int32 [H, W]
        The id where at least `SHARE` of the object's pixels move, 0 elsewhere; negative ids stay.
    """
    return chosen(objects, those(objects, moves))


def those(objects: Int32, moves: Bool) -> frozenset[int]:
    """Return the ids of the objects at least `SHARE` of whose pixels move."""
    values, sizes, starts = _runs(objects)
    if not values.size:
        return frozenset()
    counts = np.add.reduceat(moves.ravel().astype(np.int64), starts)
    ids, which = np.unique(values, return_inverse=True)
    total = np.bincount(which, sizes)
    found = ids[(np.bincount(which, counts) >= SHARE * total) & (ids > 0)]
    return frozenset(found.tolist())


def chosen(objects: Int32, ids: Collection[int]) -> Int32:
    """Return a stencil of some objects.

    Returns
    -------
    int32 [H, W]
        The id of those, 0 elsewhere; negative ids stay.
    """
    values, sizes, _ = _runs(objects)
    kept = (values < 0) | np.isin(values, np.array(sorted(ids), np.int32))
    found = np.repeat(np.where(kept, values, 0), sizes)
    return np.asarray(found.reshape(objects.shape), dtype=np.int32)


def _runs(objects: Int32) -> tuple[Int32, Indices, Indices]:
    """Return the id, length and start of each run of equal ids.

    Neighbours mostly have the same id: sorting runs of them takes a tenth of the time.
    """
    flat = objects.ravel()
    if not flat.size:
        return flat, np.zeros(0, np.intp), np.zeros(0, np.intp)
    starts = np.concatenate(([0], np.flatnonzero(flat[1:] != flat[:-1]) + 1))
    return flat[starts], np.diff(starts, append=flat.size), starts
