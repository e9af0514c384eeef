"""Motion over several steps, from vectors that reach over one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer
from exwarp_cli.kernels.follow import follow
from exwarp_cli.synthesis.camera import scene_of, seen_by
from exwarp_cli.synthesis.geometry import displacement, stencil_of


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
    ids = [stencil_of(gbuffer) for gbuffer in steps]
    scenes = scene_of(steps[0]), scene_of(steps[-1])
    found = []
    for way in (1, -1):
        moved = _followed(steps[::way], ids[::way], way)
        here, there = scenes[::way]
        if here is not None and there is not None and there.camera is not None and ids[0].size:
            still = ids[0 if way == 1 else -1] == 0
            moved = np.where(still[..., None], seen_by(here, there.camera), moved)
        found.append(moved)
    return found[0], found[1]


def _followed(steps: Sequence[GBuffer], ids: Sequence[np.ndarray], way: int) -> Float32:
    """Follow the points of the first of these to the last; `way` is -1 against time."""
    start = steps[0]
    moved = displacement(start, way)
    before = moved.copy()
    for count, gbuffer in enumerate(steps[1:-1], start=1):
        after = displacement(start, way * (count + 1))
        step = gbuffer.to_next if way == 1 else gbuffer.to_previous
        assert step is not None
        follow(step, ids[count], ids[0], after - before, moved)
        before = after
    return moved
