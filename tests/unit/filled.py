"""A network whose answer is known, and intervals whose G-buffers lack parts."""

from __future__ import annotations

from dataclasses import replace

from exwarp_cli.domain.frame import Float32
from exwarp_cli.domain.network_api import NetworkPictures
from exwarp_cli.synthesis.interval import Interval


class Filled:
    """A network that answers with the filled warp."""

    checksum = "0" * 64

    def __call__(self, inputs: NetworkPictures) -> Float32:
        return inputs.pictures["warped"][3:]


def without(interval: Interval, *parts: str) -> Interval:
    return replace(
        interval,
        key=interval.key.without(*parts),
        slots=tuple(gbuffer.without(*parts) for gbuffer in interval.slots),
        past=tuple(replace(step, frame=step.frame.without(*parts)) for step in interval.past),
    )
