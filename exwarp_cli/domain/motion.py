"""Motion vectors: conventions, those of renderers, and what calibration found about one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.runtime.frame_pool import pool

# What stands for no motion in vectors that were clamped to 0 … 1, and how far from it 8 bits may
# put it: 127 / 255, 128 / 255.
STILL_MIDDLE, STILL_TOLERANCE = 0.5, 0.01


@dataclass(frozen=True)
class AxisMap:
    """How a displacement is read from a renderer's raw motion channels.

    The displacement, in pixels, +x right, +y down, is for each axis ``scale * (raw[..., channel] /
    raw[..., alpha] - still) * raw[..., length]``, where factors that are None are left out. Where
    alpha is 0 nothing moves.
    """

    x_channel: int  # index into the raw motion channels
    y_channel: int
    # Signed: -1 mirrors an axis, the frame's width undoes a normalisation, and so on
    x_scale: float
    y_scale: float
    still: float = 0.0  # value of no motion: 0.5 where vectors were clamped to 0 … 1
    # Index of the channel with the vector's length, if the others hold its direction
    length: int | None = None
    alpha: int | None = None  # index of the channel that the others are premultiplied by

    @property
    def channels(self) -> tuple[int, ...]:
        """Indices of all channels that are used."""
        more = (index for index in (self.length, self.alpha) if index is not None)
        return (self.x_channel, self.y_channel, *more)

    def apply(self, raw: Float32) -> Float32:
        """Turn raw motion [..., C] into displacements [..., 2] in pixels.

        Non-finite values give NaN, and so do clipped ones, where `still` is the middle of 0 … 1.
        """
        out: Float32 = pool.empty((*raw.shape[:-1], 2), np.float32)
        clipped = self.length is None and abs(self.still - STILL_MIDDLE) < STILL_TOLERANCE
        axes = ((self.x_channel, self.x_scale), (self.y_channel, self.y_scale))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for axis, (channel, scale) in enumerate(axes):
                value = raw[..., channel]
                if self.alpha is not None:
                    value = np.where(
                        raw[..., self.alpha] > 0,
                        value / raw[..., self.alpha],
                        np.float32(self.still),
                    )
                if clipped:
                    value = np.where((value > 0) & (value < 1), value, np.nan)
                if self.still:
                    value = value - np.float32(self.still)
                if self.length is not None:
                    value = value * raw[..., self.length]
                np.multiply(value, np.float32(scale), out=out[..., axis])
            out[~np.isfinite(out[..., 0] + out[..., 1])] = np.nan
        return out

    def write(
        self,
        displacement: Float32,  # [..., 2] px, +x right, +y down
        raw: Float32,  # [..., C]
    ) -> Float32:
        """Return raw motion channels that read as these displacements: the inverse of `apply`.

        Channels of `raw` that this map does not write are kept; its alpha is used.
        """
        # A direction has length 1; mapped to 0 … 1 it has 0.5 about `still`.
        out = raw.copy()
        values = displacement / np.array([self.x_scale, self.y_scale], np.float32)
        if self.length is not None:
            size = np.linalg.norm(values, axis=-1) * np.float32(2 if self.still else 1)
            values = values / np.where(size > 0, size, 1)[..., None]
            out[..., self.length] = size
        values = values + np.float32(self.still)
        if self.alpha is not None:
            values = values * raw[..., self.alpha, None]
        out[..., self.x_channel], out[..., self.y_channel] = values[..., 0], values[..., 1]
        return out

    def describe(self, channels: tuple[str, ...], units: tuple[str, str] = ("", "")) -> str:
        """Return the map in the notation of ``--motion``, for example ``X,-Y``."""
        axes = ((self.x_scale, self.x_channel), (self.y_scale, self.y_channel))
        terms = []
        for (scale, channel), unit in zip(axes, units, strict=True):
            factor = "" if abs(scale) == 1 else f"{_format_number(abs(scale))}*"
            value = channels[channel]
            if self.alpha is not None:
                value += f"/{channels[self.alpha]}"
            if self.still:
                sign = "-" if self.still > 0 else "+"
                value = f"({value}{sign}{_format_number(abs(self.still))})"
            if self.length is not None:
                value += f"*{channels[self.length]}"
            terms.append(f"{'-' if scale < 0 else ''}{factor}{unit and unit + '*'}{value}")
        return ",".join(terms)


@dataclass(frozen=True)
class MotionConvention:
    """The meaning of a renderer's motion channels."""

    # How to read the displacement to one frame earlier; None if it is not written
    to_previous: AxisMap | None = None
    to_next: AxisMap | None = None  # the same to one frame later
    of_frame: bool = False  # scales count frame widths and heights; `sized` turns them into pixels

    @property
    def count(self) -> int:
        """Number of motion channels that are used."""
        maps = (m for m in (self.to_previous, self.to_next) if m is not None)
        return 1 + max((index for m in maps for index in m.channels), default=-1)

    def sized(self, width: int, height: int) -> MotionConvention:
        """Return the convention in pixels for frames (display windows) of this size."""
        if not self.of_frame:
            return self
        return replace(self.scaled(width, height), of_frame=False)

    def scaled(self, x: float, y: float | None = None) -> MotionConvention:
        """Return the convention of vectors that are shorter by a factor, or by one per axis."""
        y = x if y is None else y
        before, after = (
            m and replace(m, x_scale=m.x_scale * x, y_scale=m.y_scale * y)
            for m in (self.to_previous, self.to_next)
        )
        return replace(self, to_previous=before, to_next=after)

    def describe(self, channels: tuple[str, ...]) -> str:
        """Return the convention in the notation of ``--motion``."""
        units = ("width", "height") if self.of_frame else ("", "")
        maps = (("previous", self.to_previous), ("next", self.to_next))
        return " ".join(
            f"{name}={m.describe(channels, units)}" for name, m in maps if m is not None
        )


@dataclass(frozen=True)
class MotionFinding:
    """The convention in use, and why."""

    convention: MotionConvention
    # "calibrated" (measured, as the channel names say), "corrected" (measured, other than the names
    # say), "untested" (too little motion to measure) or "given" (by hand)
    source: str
    evidence: str  # one sentence for people
    # Mean reprojection error of the convention; None where nothing was measured
    error: float | None = None
    still_error: float | None = None  # the same of no motion at all
    runner_up_error: float | None = None  # the same of the best convention that differs materially
    # All channels were measured to be what their names say, in both directions, without a similar
    # alternative: more frames would not change the result
    clear: bool = False
    resting: bool = False  # nothing moves in the measured frames
    preset: str = ""  # name for ``--motion`` of what was measured; "" without


def _format_number(value: float) -> str:
    # So that it reads back as itself.
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


# Forward vectors in the first two channels, backward ones in the next two, in pixels, y up.
_BOTH = MotionConvention(AxisMap(2, 3, 1.0, -1.0), AxisMap(0, 1, 1.0, -1.0))
_FORWARD = MotionConvention(to_next=AxisMap(0, 1, 1.0, -1.0))

# Conventions by name, for --motion. Indices count the motion channels in the order in which they
# were found.
PRESETS: dict[str, MotionConvention] = {
    # XY is previous minus current, ZW current minus next, y up.
    "blender": MotionConvention(AxisMap(0, 1, 1.0, -1.0), AxisMap(2, 3, -1.0, 1.0)),
    # As ExtraNet dumps it: current minus previous, y up.
    "unreal": MotionConvention(to_previous=AxisMap(0, 1, -1.0, 1.0)),
    # Movie Render Queue: the same as shares of the frame about 0.5; twice that is reported, too.
    "unreal-mrq": MotionConvention(AxisMap(0, 1, -1.0, 1.0, still=0.5), of_frame=True),
    # Max displace 0: red and green are the direction, blue is the length.
    "arnold": MotionConvention(to_next=AxisMap(0, 1, 1.0, -1.0, length=2)),
    "vray": _FORWARD,
    "redshift": _FORWARD,
    "renderman": MotionConvention(AxisMap(2, 3, 1.0, 1.0), AxisMap(0, 1, 1.0, 1.0)),  # y down
    "karma": _FORWARD,
    # The screen reaches from -1 to 1; premultiplied.
    "moonray": MotionConvention(to_next=AxisMap(0, 1, 0.5, -0.5, alpha=2), of_frame=True),
    "nuke": _BOTH,
    "reelsmart": _FORWARD,
    "twixtor": _FORWARD,
    "forward": _FORWARD,
    "backward": MotionConvention(to_previous=AxisMap(0, 1, 1.0, -1.0)),
    "forward+backward": _BOTH,
}
