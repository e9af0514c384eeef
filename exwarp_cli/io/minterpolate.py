"""ffmpeg's motion-compensated interpolation, the one that everybody has.

It sees colour only, in display encoding and 8 bits: values below 0 and above 1 are lost, and so is
alpha. The settings are those that suited it best on the rendered example (PSNR in dB): detection of
scene changes off (21.0 against 20.2, since it repeats frames at motion that it takes for a cut),
blocks of 8 pixels (21.5 against 21.0 with 16) and full-range 4:4:4.

Its search for motion starts from the vectors of the frame before, which go back to those before it,
and so to the first frame it was given. Here it is given one key frame of the past, so that a frame
does not depend on where a run begins. Over the example that is 21.54 dB against 21.49 from the
whole sequence in one go (which differs from it by 50 dB), and 21.31 without the past. What comes
after the interval does not change it in any bit.
"""

from __future__ import annotations

import numpy as np

from exwarp_cli.domain.frame import Float32, UInt8
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import OutputError
from exwarp_cli.io.ffmpeg import EXACT, RAW, RAW_INPUT, FfmpegError, filtered
from exwarp_cli.io.video import to_display

NAME = "ffmpeg minterpolate"
"""As tables show it."""

BLOCK = 8
"""Side of its blocks, pixels; it leaves what is no whole block unmoved."""

LEAST = 16
"""Smallest side in pixels; of less it makes nothing."""

KEY_TOLERANCE = 4
"""Steps of 8 bits by which its YUV may change a frame that it passes through."""

_RATE = 30  # only its ratio to the rate made matters
_CHAIN = ",".join(
    (
        f"scale=out_color_matrix=bt709:out_range=pc:{EXACT}",
        "format=yuvj444p",
        f"minterpolate=fps={_RATE * FACTOR}:mi_mode=mci:mc_mode=aobmc:me_mode=bidir:vsbmc=1"
        f":mb_size={BLOCK}:scd=none",
        f"scale=in_color_matrix=bt709:in_range=pc:{EXACT}",
        "format=rgb24",
    )
)


def minterpolate(older: Float32 | None, before: Float32, after: Float32) -> tuple[Float32, ...]:
    """Make the frames of slots 1 to 3 of one key interval.

    Parameters
    ----------
    older, before, after
        F_k-1 (None at the start of a sequence), F_k and F_k+1: float32 [H, W, 3 or more],
        scene-linear with Rec. 709 primaries; channels past the third are dropped.

    Returns
    -------
    tuple of float32 [H, W, 3]
        Scene-linear, 0 to 1, in steps of 8-bit sRGB.

    Raises
    ------
    OutputError
        When ffmpeg is missing, fails, or gives back other frames than it should.
    """
    shown = [to_display(before if frame is None else frame) for frame in (older, before, after)]
    height, width = shown[0].shape[:2]
    rows, columns = (max(LEAST, size + -size % BLOCK) - size for size in (height, width))
    padded = [np.pad(frame, ((0, rows), (0, columns), (0, 0)), mode="edge") for frame in shown]
    # It makes nothing after the last but one of its frames, so the last is repeated.
    made = _filtered([*padded, padded[-1]])[:, :height, :width]
    first = FACTOR  # of the frames at the output rate, that at `before`
    kept = made[first : first + 1].astype(np.int16)
    if len(made) < first + FACTOR or np.abs(kept - shown[1]).max() > KEY_TOLERANCE:
        raise OutputError(
            f"cannot interpolate with minterpolate: its frames of {width}x{height} pixels are not "
            "at the instants that were asked for; reinstall the package imageio-ffmpeg, or leave "
            "minterpolate out"
        )
    return tuple(_linear(frame) for frame in made[first + 1 : first + FACTOR])


def _filtered(frames: list[UInt8]) -> UInt8:
    """Run ffmpeg on uint8 [H, W, 3] frames; return uint8 [N, H, W, 3] at the output rate."""
    height, width, _ = frames[0].shape
    source = RAW_INPUT.format(width=width, height=height, rate=_RATE)
    options = (*source.split(), "-vf", _CHAIN, *RAW.split(), "-")
    try:
        made = filtered(options, b"".join(frame.tobytes() for frame in frames))
    except FfmpegError as error:
        raise OutputError(
            f"cannot interpolate with minterpolate: {error}; reinstall the package "
            "imageio-ffmpeg, or leave minterpolate out"
        ) from error
    whole = len(made) // frames[0].nbytes * frames[0].nbytes
    return np.frombuffer(made[:whole], np.uint8).reshape(-1, height, width, 3)


def _linear(shown: UInt8) -> Float32:
    """Invert `to_display`."""
    value = np.arange(256) / 255
    table = np.where(value <= 12.92 * 0.0031308, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    linear: Float32 = table.astype(np.float32)[shown]
    return linear
