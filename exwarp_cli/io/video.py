"""A video of the result for looking at: H.264 in MP4 or QuickTime."""

from __future__ import annotations

import re
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from exwarp_cli.domain.colour import SRGB
from exwarp_cli.domain.frame import Float32, UInt8
from exwarp_cli.errors import OutputError, UsageError
from exwarp_cli.io.atomic import atomic_path
from exwarp_cli.io.chromaticities import Primaries
from exwarp_cli.io.ffmpeg import EXACT, RAW_INPUT, Feed, FfmpegError, even, run_ffmpeg
from exwarp_cli.io.track_coding import SOUND, SUBTITLES, Track, TrackPlan, plan_tracks

UInt16 = npt.NDArray[np.uint16]

CONTAINERS = {".mp4": "mp4", ".mov": "mov"}
"""ffmpeg's name of the container by file suffix."""

QUALITY_CRF = 16
"""Constant rate factor of libx264, 0 to 51: at 16 the eye sees no difference from the frames."""

WIDEST = 255
"""Largest width of a pixel by its height that a video is labelled with, and its inverse."""

MATRICES = {
    "bt709": "bt709",
    "smpte170m": "smpte170m",
    "bt470bg": "bt470",
    "fcc": "fcc",
    "smpte240m": "smpte240m",
    "bt2020nc": "bt2020",
}
"""Matrices of Y'CbCr as files are labelled, with the names that the filter ``scale`` has."""


@dataclass(frozen=True)
class VideoColour:
    """How a video's numbers mean colour: ffmpeg's names, as the encoder is to label them.

    Attributes
    ----------
    matrix
        Of Y'CbCr, one of `MATRICES`.
    primaries, transfer
        By ffmpeg's names, "unknown" among them.
    full_range
        Whether 0 to 255 are used, else 16 to 235.
    """

    matrix: str = "bt709"
    primaries: str = "bt709"
    transfer: str = "iec61966-2-1"
    full_range: bool = False

    @property
    def range(self) -> str:
        """The range by the name that filters take."""
        return "pc" if self.full_range else "tv"


@dataclass(frozen=True)
class Soundtrack:
    """The sound and the subtitles that a video takes over from another.

    Attributes
    ----------
    path
        The other video.
    codecs
        Of its audio streams, by ffmpeg's names; empty where it is silent.
    start
        Seconds from its beginning to the first frame that is written.
    length
        Seconds to take; None for all.
    begins
        Seconds from its beginning to its sound, where ffmpeg drops that time; else 0.
    subtitles
        Codecs of its subtitles, by ffmpeg's names.
    """

    path: Path
    codecs: tuple[str, ...]
    start: Fraction = Fraction(0)
    length: Fraction | None = None
    begins: Fraction = Fraction(0)
    subtitles: tuple[str, ...] = ()

    @property
    def delay(self) -> Fraction:
        """Seconds of silence to put before it."""
        return max(self.begins - self.start, Fraction(0))

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Its tracks, sound first."""
        kinds = ((SOUND, self.codecs), (SUBTITLES, self.subtitles))
        return tuple(
            Track(kind, index, codec)
            for kind, codecs in kinds
            for index, codec in enumerate(codecs)
        )


@dataclass(frozen=True)
class VideoLook:
    """What a video is like beside its size and rate.

    Attributes
    ----------
    colour
        The default suits rendered frames on a display.
    pixel_aspect
        Width of a pixel by its height.
    sound
        None for a silent video.
    note
        What the video was made of, kept as its comment; see `video_note`.
    primaries
        Those of the frames that it shows; None for Rec. 709.
    timecode
        Of the first frame; None without.
    remarks
        What a user has to know of what the video lacks.
    """

    colour: VideoColour = VideoColour()
    pixel_aspect: Fraction = Fraction(1)
    sound: Soundtrack | None = None
    note: str = ""
    primaries: Primaries | None = None
    timecode: Timecode | None = None
    remarks: tuple[str, ...] = ()

    def display(self, pixels: Float32) -> Float32:
        """Return scene-linear colour [H, W, 3 or more] with the primaries of a display."""
        return pixels if self.primaries is None else self.primaries.converted(pixels)


def pixel_aspect(ratio: object) -> Fraction:
    """Read a header's width of a pixel by its height; 1 for what no pixel can have."""
    if not isinstance(ratio, (int, float)) or not 1 / WIDEST <= ratio <= WIDEST:
        return Fraction(1)
    # A float32 of 16/15 is no exact fraction; videos hold one of small numbers.
    return Fraction(ratio).limit_denominator(WIDEST)


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


def from_display(shown: UInt8 | UInt16) -> Float32:
    """Turn sRGB codes into scene-linear colour: what `to_display` undoes for 8 bits.

    Parameters
    ----------
    shown
        uint8 or uint16 of any shape; the type's largest value is white.

    Returns
    -------
    numpy.ndarray
        float32 of the same shape, 0 to 1 (IEC 61966-2-1).
    """
    linear: Float32 = _linear_table(shown.dtype.itemsize)[shown]
    return linear


@cache
def _linear_table(size: int) -> Float32:
    return SRGB.to_linear(np.linspace(0, 1, 256**size, dtype=np.float32))


def require_container(path: Path) -> None:
    """Refuse a video whose suffix names no container that is written; raises UsageError."""
    if path.suffix.lower() not in CONTAINERS:
        raise UsageError(
            f"the video {path} is neither .mp4 nor .mov; choose a name with one of the two"
        )


def video_note(path: Path) -> str | None:
    """Return the note of a video; None without one, and for what cannot be read as a video.

    A video that `VideoWriter` put in place is whole, so the note alone tells a good one.
    """
    if not path.is_file():
        return None
    try:
        listed, _ = run_ffmpeg(["-i", f"file:{path}", "-f", "ffmetadata", "-"])
    except FfmpegError:
        return None
    found = re.search(r"^comment=(.*)$", listed.decode("utf-8", "replace"), re.MULTILINE)
    return None if found is None else re.sub(r"\\(.)", r"\1", found[1])


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
    look
        Colour, pixels and sound.

    Raises
    ------
    UsageError
        For another suffix, or a frame rate that is not positive.
    OutputError
        When ffmpeg is missing or fails, or the video cannot be written.
    """

    def __init__(
        self,
        path: Path,
        width: int,
        height: int,
        fps: Fraction | float,
        look: VideoLook | None = None,
    ) -> None:
        require_container(path)
        if not 0 < fps < float("inf"):
            raise UsageError(f"the frame rate {fps} of the video is not a positive number")
        self._path = path
        self._shape = (height, width, 3)
        self._rate = Fraction(fps).limit_denominator(100_000)
        self._look = look or VideoLook()
        self._stack = ExitStack()
        self._count = 0
        self._plan = TrackPlan()

    def __enter__(self) -> VideoWriter:
        with ExitStack() as stack:
            temporary = stack.enter_context(atomic_path(self._path))
            temporary.touch()  # a bad folder shows here, with its reason
            sound = self._look.sound
            if sound is not None:
                self._plan = plan_tracks(
                    sound.path, self._part_of(sound), sound.tracks, self._container
                )
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

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the video lacks, or has in another form than the input; complete once entered."""
        lost = self._look.timecode is not None and self._timecode is None
        rate = f"{float(self._rate):g}"
        why = f"the timecode is left out of the video, as it cannot count {rate} frames a second"
        return (*self._look.remarks, *self._plan.remarks, *((why,) if lost else ()))

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
        source = RAW_INPUT.format(
            width=width + width % 2, height=height + height % 2, rate=self._rate
        )
        options = [
            *source.split(),
            *self._sound_in(),
            *("-vf", self._filters(), "-c:v", "libx264", "-crf", str(QUALITY_CRF)),
            *("-pix_fmt", "yuv420p"),
            *self._sound_out(),
            *(("-metadata", f"comment={self._look.note}") if self._look.note else ()),
            *("-movflags", "+faststart", "-f", self._container),
        ]
        return [*options, f"file:{target}"]

    def _filters(self) -> str:
        """Turn sRGB codes into the video's colour, and say so: the encoder labels it with that."""
        look, colour = self._look, self._look.colour
        labels = (
            f"range={colour.range}:colorspace={colour.matrix}:"
            f"color_primaries={colour.primaries}:color_trc={colour.transfer}"
        )
        aspect = f"{look.pixel_aspect.numerator}/{look.pixel_aspect.denominator}"
        return (
            f"scale=out_color_matrix={MATRICES[colour.matrix]}:out_range={colour.range}:{EXACT},"
            f"setparams={labels},setsar={aspect}"
        )

    @property
    def _container(self) -> str:
        return CONTAINERS[self._path.suffix.lower()]

    @property
    def _timecode(self) -> str | None:
        """The timecode at the video's rate; None without, and if it cannot count that rate."""
        code = self._look.timecode
        return None if code is None else code.at(self._rate)

    def _sound_in(self) -> list[str]:
        sound = self._look.sound
        return [] if sound is None or not self._plan.kept else self._part_of(sound)

    @staticmethod
    def _part_of(sound: Soundtrack) -> list[str]:
        """Return what makes ffmpeg read the part of the other video that goes along."""
        part = ["-ss", f"{float(sound.start):.6f}"] if sound.start > 0 else []
        if sound.length is not None:
            part += ["-t", f"{float(sound.length):.6f}"]
        if sound.delay:
            part += ["-itsoffset", f"{float(sound.delay):.6f}"]
        return [*part, "-i", f"file:{sound.path}"]

    def _sound_out(self) -> list[str]:
        # The other video's own timecode counts its own rate.
        code = ["-metadata", f"timecode={self._timecode or ''}"]
        if not self._plan.kept:
            return code if self._timecode else []
        return ["-map", "0:v", *self._plan.options(1), "-map_metadata", "1", *code]

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


MOST_RATE = 255
"""Frames per second that a timecode track of MP4 and QuickTime can count."""

_FORM = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d+)")
_DAY = 24 * 3600


@dataclass(frozen=True)
class Timecode:
    """The timecode of a frame.

    Attributes
    ----------
    text
        ``HH:MM:SS:FF``; with a semicolon or a point before the frames where numbers are dropped.
    rate
        Frames per second that it counts.
    later
        Frames, or parts of one, from the one that has this timecode to the one that is meant.
    """

    text: str
    rate: Fraction
    later: Fraction = Fraction(0)

    def at(self, rate: Fraction) -> str | None:
        """Return the timecode at another rate; None if it cannot be counted there.

        At four times the rate, frame 7 of a second becomes frame 28.
        """
        found, base = _FORM.fullmatch(self.text), round(rate)
        drops = found is not None and found[4] != ":"
        # Numbers are dropped at 29.97 and its multiples alone.
        if found is None or base > MOST_RATE or (drops and rate.denominator != 1001):
            return None
        if drops and (base % 30 or round(self.rate) % 30):
            return None
        count = _count(found, round(self.rate), drops) + self.later
        return _text(int(count * rate / self.rate), base, drops)


def _dropped(base: int) -> int:
    """Return how many numbers are dropped in each minute but every tenth."""
    return base // 15


def _count(found: re.Match[str], base: int, drops: bool) -> int:
    """Return the frames since midnight."""
    hours, minutes, seconds, frames = (int(found[group]) for group in (1, 2, 3, 5))
    minutes += 60 * hours
    count = (60 * minutes + seconds) * base + frames
    return count - _dropped(base) * (minutes - minutes // 10) if drops else count


def _text(count: int, base: int, drops: bool) -> str:
    """Write frames since midnight; invert `_count`."""
    if drops:
        less = _dropped(base)
        ten = 600 * base - 9 * less
        tens, rest = divmod(count, ten)
        # The first of ten minutes drops nothing.
        minutes = 0 if rest < 60 * base else 1 + (rest - 60 * base) // (60 * base - less)
        count += less * (9 * tens + minutes)
    seconds, frames = divmod(count, base)
    hours, seconds = divmod(seconds % _DAY, 3600)
    sign = ";" if drops else ":"
    return f"{hours:02}:{seconds // 60:02}:{seconds % 60:02}{sign}{frames:02}"
