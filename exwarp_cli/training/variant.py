"""More samples from one render: other key frames, mirrored, backwards, at double speed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from exwarp_cli.domain.frame import SURFACE_PARTS, Float32, GBuffer, Image, KeyFrame
from exwarp_cli.domain.timeline import FACTOR

SPEEDS = (1, 2)


@dataclass(frozen=True)
class Variant:
    """One way of looking at a render.

    Attributes
    ----------
    phase
        Which instant, in playing order and counted from 0, is the first key frame:
        0 <= phase < 4 speed.
    mirror
        Whether left and right are exchanged.
    backwards
        Whether time runs backwards.
    speed
        1, or 2 to take every second instant.
    """

    phase: int = 0
    mirror: bool = False
    backwards: bool = False
    speed: int = 1

    def __post_init__(self) -> None:
        if self.speed not in SPEEDS or not 0 <= self.phase < FACTOR * self.speed:
            raise ValueError(f"{self} is no variant")

    def order(self, count: int) -> range:
        """Which of `count` instants are shown, in playing order; every fourth is a key frame."""
        played = range(count)[::-1] if self.backwards else range(count)
        return played[self.phase :: self.speed]


def all_variants() -> tuple[Variant, ...]:
    """Every variant, the plain one first."""
    return tuple(
        Variant(phase, mirror, backwards, speed)
        for speed, mirror, backwards in product(SPEEDS, (False, True), (False, True))
        for phase in range(FACTOR * speed)
    )


def backwards(gbuffer: GBuffer) -> GBuffer:
    """Let time run backwards: what was the motion to the next frame is that to the previous one.

    Displacements keep their sign, as they lead from this frame to the other in either case; in a
    renderer's files, where both vectors run along time, they are exchanged and negated.
    """
    bend = None if gbuffer.bend is None else gbuffer.bend[::-1]
    return replace(gbuffer, to_previous=gbuffer.to_next, to_next=gbuffer.to_previous, bend=bend)


def mirrored(frame: KeyFrame) -> KeyFrame:
    """Exchange left and right.

    The result is what the camera, reflected with the world at the plane x = 0, would show: columns
    are reversed, and motion, positions and normals change the sign of their x. Windows are reversed
    within the display window.
    """
    image, gbuffer = frame.image, frame.gbuffer
    display = image.display_window
    x = 2 * display.x + display.width - image.data_window.x - image.data_window.width
    window = replace(image.data_window, x=x)
    turned = Image(_reversed(image.pixels), window, display)
    if gbuffer is not None:
        gbuffer = _mirrored_gbuffer(replace(gbuffer, window=window))
    return replace(frame, image=turned, gbuffer=gbuffer)


def _mirrored_gbuffer(gbuffer: GBuffer) -> GBuffer:
    plain = ("depth", "stencil", *SURFACE_PARTS)
    signed = ("normal", "position", "to_previous", "to_next")
    changed = {name: getattr(gbuffer, name) for name in (*plain, *signed)}
    for name, array in changed.items():
        if array is not None:
            changed[name] = _reversed(array)
    if gbuffer.bend is not None:
        changed["bend"] = np.stack([_reversed(half) for half in gbuffer.bend])
    for name in (*signed, "bend"):
        if changed.get(name) is not None:
            changed[name][..., 0] *= np.float32(-1)
    return replace(gbuffer, **changed)


def _reversed(array: np.ndarray) -> Float32:
    """Return a copy with the columns reversed."""
    return np.ascontiguousarray(array[:, ::-1])
