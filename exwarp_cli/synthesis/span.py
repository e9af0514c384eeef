"""Motion over several steps, from vectors that reach over one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer
from exwarp_cli.synthesis.camera import scene_of, seen_by
from exwarp_cli.synthesis.trajectory import followed


def span_motion(steps: Sequence[GBuffer], way: int) -> Float32:
    """Return the motion from the first of successive instants to the last.

    Parameters
    ----------
    steps
        At least two, in the order in which the motion runs, with settled motion to the instant
        that comes next; the last needs none.
    way
        1 if that is forward in time, -1 if back.

    Returns
    -------
    float32 [H, W, 2]
        Pixels. What stands still follows the recovered cameras, what moves is followed from
        instant to instant.
    """
    start, *others = steps[:-1]
    moved = followed(start, others, way)
    here, there = scene_of(start), scene_of(steps[-1])
    if here is None or there is None or there.camera is None or start.stencil is None:
        return moved
    still = start.stencil == 0
    return np.where(still[..., None], seen_by(here, there.camera), moved)
