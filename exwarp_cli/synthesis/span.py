"""Motion over several steps, from vectors that reach over one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer
from exwarp_cli.synthesis.camera import scene_of, seen_by
from exwarp_cli.synthesis.trajectory import followed


def span_motion(steps: Sequence[GBuffer]) -> tuple[Float32, Float32]:
    """Return the motion between the first and the last of successive instants.

    Parameters
    ----------
    steps
        At least two, with settled motion to both neighbours.

    Returns
    -------
    to_next, to_previous
        float32 [H, W, 2] each, pixels: from the first instant to the last, and back. What stands
        still follows the recovered cameras, what moves is followed from instant to instant.
    """
    scenes = scene_of(steps[0]), scene_of(steps[-1])
    found = []
    for way in (1, -1):
        start, *others = steps[::way][:-1]
        here, there = scenes[::way]
        moved = followed(start, others, way)
        camera = None if there is None else there.camera
        if here is not None and camera is not None and start.stencil is not None:
            still = start.stencil == 0
            moved = np.where(still[..., None], seen_by(here, camera), moved)
        found.append(moved)
    return found[0], found[1]
