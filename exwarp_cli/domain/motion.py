"""Motion vectors: the renderer's convention and what was found out about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exwarp_cli.domain.frame import Float32


@dataclass(frozen=True)
class AxisMap:
    """How a displacement is read from a renderer's raw motion channels.

    The displacement, in pixels, +x right, +y down, is
    ``(x_scale * raw[..., x_channel], y_scale * raw[..., y_channel])``.

    Attributes
    ----------
    x_channel, y_channel
        Indices into the raw motion channels.
    x_scale, y_scale
        Signed factors: -1 mirrors an axis, the frame's width undoes a normalisation, and so on.
    """

    x_channel: int
    y_channel: int
    x_scale: float
    y_scale: float

    def apply(self, raw: Float32) -> Float32:
        """Turn raw motion [H, W, C] into displacements float32 [H, W, 2]; non-finite gives NaN."""
        x = raw[..., self.x_channel] * np.float32(self.x_scale)
        y = raw[..., self.y_channel] * np.float32(self.y_scale)
        out = np.stack([x, y], axis=-1)
        with np.errstate(over="ignore", invalid="ignore"):
            out[~np.isfinite(x + y)] = np.nan
        return out

    def describe(self, channels: tuple[str, ...]) -> str:
        """Return the map in the notation of ``--motion``, for example ``X,-Y``."""
        terms = []
        pairs = ((self.x_scale, self.x_channel), (self.y_scale, self.y_channel))
        for scale, channel in pairs:
            factor = "" if abs(scale) == 1 else f"{abs(scale):g}*"
            terms.append(f"{'-' if scale < 0 else ''}{factor}{channels[channel]}")
        return ",".join(terms)


@dataclass(frozen=True)
class MotionConvention:
    """What a renderer's motion channels mean.

    Attributes
    ----------
    to_previous, to_next
        How to read the displacement to one frame earlier and later; None where it is not written.
    """

    to_previous: AxisMap | None = None
    to_next: AxisMap | None = None

    def describe(self, channels: tuple[str, ...]) -> str:
        """Return the convention in the notation of ``--motion``."""
        parts = []
        if self.to_previous is not None:
            parts.append(f"previous={self.to_previous.describe(channels)}")
        if self.to_next is not None:
            parts.append(f"next={self.to_next.describe(channels)}")
        return " ".join(parts)


@dataclass(frozen=True)
class MotionFinding:
    """The convention in use, and why.

    Attributes
    ----------
    convention
        What is used.
    source
        "calibrated" (measured, and as the channel names say), "corrected" (measured, and other
        than the names say), "untested" (too little motion to measure) or "given" (by hand).
    evidence
        One sentence for a person.
    error, still_error, runner_up_error
        Mean reprojection error of the convention, of no motion at all, and of the best convention
        that differs materially; None where nothing was measured.
    """

    convention: MotionConvention
    source: str
    evidence: str
    error: float | None = None
    still_error: float | None = None
    runner_up_error: float | None = None
