"""Motion vectors: the renderer's convention and what was found out about it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from exwarp_cli.domain.frame import Float32
from exwarp_cli.runtime.frame_pool import pool

MIDDLE, ABOUT = 0.5, 0.01
"""What stands for no motion in vectors that were clamped to 0 … 1, and how far from it 8 bits may
put it: 127 / 255, 128 / 255."""


@dataclass(frozen=True)
class AxisMap:
    """How a displacement is read from a renderer's raw motion channels.

    The displacement, in pixels, +x right, +y down, is for each axis
    ``scale * (raw[..., channel] / raw[..., alpha] - still) * raw[..., length]``,
    where the factors that are None are left out. Where alpha is 0 there is nothing that moves.

    Attributes
    ----------
    x_channel, y_channel
        Indices into the raw motion channels.
    x_scale, y_scale
        Signed factors: -1 mirrors an axis, the frame's width undoes a normalisation, and so on.
    still
        Value of no motion: 0.5 where vectors were clamped to 0 … 1.
    length
        Index of the channel with the vector's length, where the others hold its direction alone.
    alpha
        Index of the channel that the others are premultiplied by.
    """

    x_channel: int
    y_channel: int
    x_scale: float
    y_scale: float
    still: float = 0.0
    length: int | None = None
    alpha: int | None = None

    @property
    def channels(self) -> tuple[int, ...]:
        """Indices of all channels that are used."""
        more = (index for index in (self.length, self.alpha) if index is not None)
        return (self.x_channel, self.y_channel, *more)

    def apply(self, raw: Float32) -> Float32:
        """Turn raw motion [..., C] into displacements [..., 2] in pixels.

        What is not finite gives NaN, and so does what was clipped, where `still` is the middle of
        a range from 0 to 1.
        """
        if not self.still and self.length is None and self.alpha is None:
            return self._scaled(raw)
        axes = []
        clipped = self.length is None and abs(self.still - MIDDLE) < ABOUT
        pairs = ((self.x_channel, self.x_scale), (self.y_channel, self.y_scale))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for channel, scale in pairs:
                value = raw[..., channel]
                if self.alpha is not None:
                    value = np.where(raw[..., self.alpha] > 0, value / raw[..., self.alpha],
                                     np.float32(self.still))  # fmt: skip
                if clipped:
                    value = np.where((value > 0) & (value < 1), value, np.nan)
                if self.still:
                    value = value - np.float32(self.still)
                if self.length is not None:
                    value = value * raw[..., self.length]
                axes.append(value * np.float32(scale))
            out: Float32 = pool.empty((*raw.shape[:-1], 2), np.float32)
            np.stack(axes, axis=-1, out=out)
            out[~np.isfinite(axes[0] + axes[1])] = np.nan
        return out

    def _scaled(self, raw: Float32) -> Float32:
        """Read plain displacements: in a third of the time that passes over the frame take."""
        from exwarp_cli.kernels import raw_channels  # numba: not for `exwarp --help`

        out: Float32 = pool.empty((*raw.shape[:-1], 2), np.float32)
        rows = np.ascontiguousarray(raw, np.float32).reshape(-1, raw.shape[-1])
        scales = np.float32(self.x_scale), np.float32(self.y_scale)
        raw_channels.scale_vectors(
            rows, (self.x_channel, self.y_channel), scales, out.reshape(-1, 2)
        )
        return out

    def write(self, displacement: Float32, raw: Float32) -> Float32:
        """Return raw motion channels that read as these displacements: the inverse of `apply`.

        Parameters
        ----------
        displacement
            float32 [..., 2], pixels, +x right, +y down.
        raw
            float32 [..., C]: the channels that this map does not write are kept; its alpha is used.

        Notes
        -----
        A direction has length 1; mapped to 0 … 1 it has 0.5 about `still`.
        """
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
            factor = "" if abs(scale) == 1 else f"{_number(abs(scale))}*"
            value = channels[channel]
            if self.alpha is not None:
                value += f"/{channels[self.alpha]}"
            if self.still:
                sign = "-" if self.still > 0 else "+"
                value = f"({value}{sign}{_number(abs(self.still))})"
            if self.length is not None:
                value += f"*{channels[self.length]}"
            terms.append(f"{'-' if scale < 0 else ''}{factor}{unit and unit + '*'}{value}")
        return ",".join(terms)


@dataclass(frozen=True)
class MotionConvention:
    """What a renderer's motion channels mean.

    Attributes
    ----------
    to_previous, to_next
        How to read the displacement to one frame earlier and later; None where it is not written.
    of_frame
        Whether the scales count frame widths and heights, as long as the frame's size is not
        known; :meth:`sized` turns them into pixels.
    """

    to_previous: AxisMap | None = None
    to_next: AxisMap | None = None
    of_frame: bool = False

    @property
    def count(self) -> int:
        """How many motion channels it takes."""
        maps = (m for m in (self.to_previous, self.to_next) if m is not None)
        return 1 + max((index for m in maps for index in m.channels), default=-1)

    def sized(self, width: int, height: int) -> MotionConvention:
        """Return the convention in pixels for frames (display windows) of this size."""
        if not self.of_frame:
            return self

        def scaled(axes: AxisMap | None) -> AxisMap | None:
            if axes is None:
                return None
            return replace(axes, x_scale=axes.x_scale * width, y_scale=axes.y_scale * height)

        return MotionConvention(scaled(self.to_previous), scaled(self.to_next))

    def scaled(self, factor: float) -> MotionConvention:
        """Return the convention of vectors that are shorter by a factor."""

        def longer(axes: AxisMap | None) -> AxisMap | None:
            if axes is None:
                return None
            return replace(axes, x_scale=axes.x_scale * factor, y_scale=axes.y_scale * factor)

        return replace(self, to_previous=longer(self.to_previous), to_next=longer(self.to_next))

    def describe(self, channels: tuple[str, ...]) -> str:
        """Return the convention in the notation of ``--motion``."""
        units = ("width", "height") if self.of_frame else ("", "")
        parts = []
        if self.to_previous is not None:
            parts.append(f"previous={self.to_previous.describe(channels, units)}")
        if self.to_next is not None:
            parts.append(f"next={self.to_next.describe(channels, units)}")
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
    clear
        Whether all channels were measured to be what their names say, in both directions, and no
        other reading comes near: more frames would tell the same.
    resting
        Whether nothing moves in the frames that were measured.
    preset
        The name that ``--motion`` takes for what was measured; "" without.
    """

    convention: MotionConvention
    source: str
    evidence: str
    error: float | None = None
    still_error: float | None = None
    runner_up_error: float | None = None
    clear: bool = False
    resting: bool = False
    preset: str = ""


def _number(value: float) -> str:
    """Spell a number so that it reads back as itself."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))
