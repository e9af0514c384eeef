"""Motion over several steps, from vectors that reach over one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exwarp_cli.domain.frame import Float32, GBuffer
from exwarp_cli.synthesis.geometry import SlotField, compose_back, compose_forward, displacement


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
        still follows the recovered cameras, what moves its composed vectors. Where the other end
        does not show a moving point, composing has nothing to follow, and the point goes on as it
        moves at its own instant.
    """
    count = len(steps) - 1
    forward = compose_forward(steps[:-1], steps[-1])[0]
    back = compose_back(steps[1:], steps[0])[-1]
    return _mended(forward, steps[0], count), _mended(back, steps[-1], -count)


def _mended(field: SlotField, gbuffer: GBuffer, time: int) -> Float32:
    """Replace the motion of moving points that were lost sight of on the way."""
    lost = field.hole | np.isnan(field.field).any(axis=-1)
    if gbuffer.stencil is not None:
        lost &= gbuffer.stencil != 0
    return np.where(lost[..., None], displacement(gbuffer, time), field.field)
