"""What makes a frame, in the one word that pages, tables and headers have for it.

W, E and the repetition of a frame are in `exwarp_cli.domain.decision`, the networks between two key
frames in `exwarp_cli.domain.interpolator`.
"""

from __future__ import annotations

from exwarp_cli.domain.decision import WARP

SOFTSPLAT = "softsplat"
"""Both key frames splatted to the slot and blended by depth and time."""

BLEND = "blend"
"""A cross-fade of both key frames."""

KEY = "key"
"""A renderer."""

STEPS = {SOFTSPLAT: WARP, BLEND: WARP}
"""The step of the work that a maker's time is booked on, where it has another name."""


def step_of(maker: str) -> str:
    """Name the step of the work that the time of a frame's maker is booked on."""
    return STEPS.get(maker, maker)


def maker_of(told: str | None, method: str | None) -> str | None:
    """Return what made a frame, from what its header or its row in a table says.

    ExWarp 0.1 wrote "warp" for frames of `softsplat` and `blend`.
    """
    return method if told == WARP and method in STEPS else told
