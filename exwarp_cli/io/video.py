"""A video of the result for looking at: H.264 in MP4 or QuickTime."""

from __future__ import annotations

from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import numpy as np

from exwarp_cli.domain.frame import Float32, UInt8
from exwarp_cli.errors import OutputError, UsageError
from exwarp_cli.io.atomic import atomic_path
from exwarp_cli.io.ffmpeg import RAW_INPUT, TO_VIDEO, Feed, FfmpegError, even

CONTAINERS = {".mp4": "mp4", ".mov": "mov"}
"""ffmpeg's name of the container by file suffix."""

QUALITY_CRF = 16
"""Constant rate factor of libx264, 0 to 51: 16 cannot be told from the frames by eye."""

# The encoder labels the video with what the filters say.
_FILTERS = (
    f"{TO_VIDEO},setparams=range=tv:colorspace=bt709:color_primaries=bt709:color_trc=iec61966-2-1"
)


def to_display(pixels: Float32, exposure_stops: float = 0.0) -> UInt8:
    """Turn scene-linear colour into 8-bit sRGB.

    Parameters
    ----------
    pixels
        float32 [H, W, 3 or more], scene-linear with Rec. 709 primaries; channels past the third
        are dropped. NaN and negative infinity become 0, positive infinity 255.
    exposure_stops
        Factors of two to brighten by before the curve.

    Returns
    -------
    numpy.ndarray
        uint8 [H, W, 3], rounded half up (IEC 61966-2-1).
    """
    with np.errstate(over="ignore"):  # brightened beyond float32 is white all the same
        linear = pixels[..., :3] * np.float32(2.0**exposure_stops)
    linear = np.nan_to_num(linear, copy=False, nan=0.0, posinf=1.0, neginf=0.0).clip(0.0, 1.0)
    curved = np.where(
        linear <= np.float32(0.0031308),
        linear * np.float32(12.92),
        np.float32(1.055) * linear ** np.float32(1 / 2.4) - np.float32(0.055),
    )
    rounded: UInt8 = np.floor(curved * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)
    return rounded


def require_container(path: Path) -> None:
    """Refuse a video whose suffix names no container that is written; raises UsageError."""
    if path.suffix.lower() not in CONTAINERS:
        raise UsageError(
            f"the video {path} is neither .mp4 nor .mov; choose a name with one of the two"
        )


class VideoWriter:
    """Write frames to a video that appears when it is whole.

    A context manager: leaving it without an error puts the video in place, with one discards it.
    ffmpeg is the one that imageio-ffmpeg ships.

    Parameters
    ----------
    path
        The video, ``.mp4`` or ``.mov``; its folder must exist.
    width, height
        Size of the frames, pixels. Odd sizes are padded by repeating the last column or row,
        since 4:2:0 video has even ones only.
    fps
        Frames per second, kept exactly: `Fraction` (120000, 1001), or the nearest fraction of
        a float.

    Raises
    ------
    UsageError
        For another suffix, or a frame rate that is not positive.
    OutputError
        When ffmpeg is missing or fails, or the video cannot be written.
    """

    def __init__(self, path: Path, width: int, height: int, fps: Fraction | float) -> None:
        require_container(path)
        if not 0 < fps < float("inf"):
            raise UsageError(f"the frame rate {fps} of the video is not a positive number")
        self._path = path
        self._shape = (height, width, 3)
        self._rate = Fraction(fps).limit_denominator(100_000)
        self._stack = ExitStack()
        self._count = 0

    def __enter__(self) -> VideoWriter:
        with ExitStack() as stack:
            temporary = stack.enter_context(atomic_path(self._path))
            temporary.touch()  # a bad folder shows here, with its reason
            try:
                self._feed = stack.enter_context(Feed(self._options(temporary)))
            except FfmpegError as error:
                raise OutputError(
                    f"cannot write the video {self._path}: {error}; reinstall the "
                    "package imageio-ffmpeg, or run without the video"
                ) from error
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is None:
            with self._stack:
                self._finish()
        else:
            self._stack.__exit__(kind, error, trace)

    def write(self, frame: UInt8) -> None:
        """Append a frame, uint8 [H, W, 3] in display encoding; raises OutputError."""
        if frame.shape != self._shape or frame.dtype != np.uint8:
            raise ValueError(f"expected uint8 {self._shape}, got {frame.dtype} {frame.shape}")
        try:
            self._feed.write(even(frame))
        except FfmpegError as error:
            raise self._failure(error) from error
        self._count += 1

    def _options(self, target: Path) -> list[str]:
        height, width, _ = self._shape
        container = CONTAINERS[self._path.suffix.lower()]
        source = RAW_INPUT.format(
            width=width + width % 2, height=height + height % 2, rate=self._rate
        )
        options = (
            f"{source} -vf {_FILTERS} -c:v libx264 -crf {QUALITY_CRF} -pix_fmt yuv420p "
            f"-movflags +faststart -f {container}"
        )
        return [*options.split(), f"file:{target}"]

    def _finish(self) -> None:
        try:
            self._feed.close()
        except FfmpegError as error:
            raise self._failure(error) from error
        if self._count == 0:
            raise OutputError(
                f"the video {self._path} would have no frames; choose frames to write, or run "
                "without the video"
            )

    def _failure(self, error: FfmpegError) -> OutputError:
        return OutputError(
            f"cannot write the video {self._path}: {error}; "
            "check the folder and the space on the disk, or run without the video"
        )
