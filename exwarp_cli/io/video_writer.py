"""Writing a video of the result, MP4 or QuickTime, with another video's sound.

What a container takes, and what ffmpeg can decode, is tried out before the video is begun: a track
that fails would end the video, with all frames that are made for it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from exwarp_cli.domain.settings import VIDEO_CODECS
from exwarp_cli.errors import InstallationError, OutputError, UsageError
from exwarp_cli.io import ffmpeg
from exwarp_cli.io.display_colour import MATRICES, Codes, Primaries, VideoColour
from exwarp_cli.io.files import ResourceOwner, atomic_path

CONTAINERS = {".mp4": "mp4", ".mov": "mov"}  # ffmpeg's name of the container by file suffix

# Constant rate factor of libx264 and libx265, 0 to 51: at 16 the eye sees no difference from the
# frames.
QUALITY_CRF = 16

# Codecs that are copied into each container as they are, since players of it know them.
COPIED_AUDIO: Mapping[str, frozenset[str]] = {
    "mp4": frozenset({"aac", "ac3", "alac", "eac3", "flac", "mp3", "opus"}),
    "mov": frozenset({"aac", "ac3", "alac", "eac3", "mp3", "pcm_s16le", "pcm_s24le", "pcm_s16be"}),
}


@dataclass(frozen=True)
class Codec:
    """How pictures are encoded."""

    title: str  # as in messages
    encoder: str  # ffmpeg's name
    options: tuple[str, ...]  # of the encoder, for ffmpeg
    pixels: str  # ffmpeg's pixel format of the video
    is_deep: bool = False  # True if frames come with 16 bits a channel, else with 8
    containers: frozenset[str] = frozenset(CONTAINERS.values())
    # False if players take the range for 16 to 235 whatever the file says
    has_full_range: bool = True


_CRF = ("-crf", str(QUALITY_CRF))
# Players of Apple open HEVC with the tag hvc1 alone. libx265 would print its settings.
_X265 = (*_CRF, "-tag:v", "hvc1", "-x265-params", "log-level=error")
_PRORES = ("-profile:v", "hq", "-vendor", "apl0")
_H264, _HEVC, _PRORES_422 = VIDEO_CODECS
# By the values of --video-codec
CODECS: Mapping[str, Codec] = {
    _H264: Codec("H.264", "libx264", _CRF, "yuv420p"),
    _HEVC: Codec("HEVC", "libx265", _X265, "yuv420p10le", is_deep=True),
    _PRORES_422: Codec(
        "ProRes",
        "prores_ks",
        _PRORES,
        "yuv422p10le",
        is_deep=True,
        containers=frozenset({"mov"}),
        has_full_range=False,
    ),
}

# Subtitles whose styles the two containers have no room for.
STYLED_SUBTITLES = frozenset({"ass", "ssa"})

SOUND, SUBTITLES = "a", "s"  # kinds of tracks, as ffmpeg's options call them
MAX_TIMECODE_RATE = 255  # frames per second that a timecode track of MP4 and QuickTime can count

_COPY = "copy"
_FAILED = (
    "cannot write the video {}: {}; check the folder and the space on the disk, or run without the "
    "video"
)
_TIMECODE = re.compile(r"(\d\d):(\d\d):(\d\d)([:;.])(\d+)")
_DAY_S = 24 * 3600


@dataclass(frozen=True)
class Timecode:
    """The timecode of a frame."""

    # ``HH:MM:SS:FF``; with a semicolon or a point before the frames where numbers are dropped
    text: str
    rate: Fraction  # frames per second that it counts
    # Frames, or parts of one, from the one that has this timecode to the one that is meant
    later: Fraction = Fraction(0)

    def convert(self, rate: Fraction) -> str | None:
        """Return the timecode at another rate; None if it cannot be counted there.

        At four times the rate, frame 7 of a second becomes frame 28.
        """
        match, base, own_base = _TIMECODE.fullmatch(self.text), round(rate), round(self.rate)
        if match is None or base > MAX_TIMECODE_RATE:
            return None
        drops = match[4] != ":"
        # Numbers are dropped at 29.97 and its multiples alone.
        if drops and (rate.denominator != 1001 or base % 30 or own_base % 30):
            return None
        hours, minutes, seconds, frames = (int(match[group]) for group in (1, 2, 3, 5))
        minutes += 60 * hours
        count = (60 * minutes + seconds) * own_base + frames
        if drops:  # some in each minute but every tenth
            count -= own_base // 15 * (minutes - minutes // 10)
        count = int((count + self.later) * rate / self.rate)
        if drops:
            dropped = base // 15
            tens, remainder = divmod(count, 600 * base - 9 * dropped)
            # The first of ten minutes drops nothing.
            minutes = 1 + (remainder - 60 * base) // (60 * base - dropped)
            count += dropped * (9 * tens + (0 if remainder < 60 * base else minutes))
        seconds, frames = divmod(count, base)
        hours, seconds = divmod(seconds % _DAY_S, 3600)
        sign = ";" if drops else ":"
        return f"{hours:02}:{seconds // 60:02}:{seconds % 60:02}{sign}{frames:02}"


@dataclass(frozen=True)
class Track:
    """A track of a video."""

    kind: str  # `SOUND` or `SUBTITLES`
    index: int  # among the tracks of its kind, from 0
    codec: str  # by ffmpeg's name


# Tracks that go into the new video, each with the encoder's name and options.
EncodedTracks = Sequence[tuple[Track, tuple[str, ...]]]


@dataclass(frozen=True)
class Soundtrack:
    """The sound and the subtitles that a video takes over from another."""

    path: Path
    codecs: tuple[str, ...]  # of its audio streams, by ffmpeg's names; empty where it is silent
    start: Fraction = Fraction(0)  # seconds from its beginning to the first frame that is written
    length: Fraction | None = None  # seconds to take; None for all
    # Seconds from its beginning to its sound, where ffmpeg drops that time; else 0
    begins: Fraction = Fraction(0)
    subtitles: tuple[str, ...] = ()  # codecs of its subtitles, by ffmpeg's names

    @property
    def input_options(self) -> list[str]:
        """ffmpeg's options that read the part of the other video which is taken over."""
        options = ["-ss", f"{float(self.start):.6f}"] if self.start > 0 else []
        if self.length is not None:
            options += ["-t", f"{float(self.length):.6f}"]
        if self.begins > self.start:  # silence goes before it
            options += ["-itsoffset", f"{float(self.begins - self.start):.6f}"]
        return [*options, "-i", f"file:{self.path}"]


@dataclass(frozen=True)
class VideoLook:
    """The properties of a video beside its size and rate."""

    # The default suits rendered frames on a display
    colour: VideoColour = field(default_factory=VideoColour)
    pixel_aspect: Fraction = Fraction(1)  # width of a pixel by its height
    sound: Soundtrack | None = None  # none for a silent video
    note: str = ""  # what the video was made of, kept as its comment; see `read_video_note`
    primaries: Primaries | None = None  # those of the frames that it shows; None for Rec. 709.
    timecode: Timecode | None = None  # of the first frame; None without
    remarks: tuple[str, ...] = ()  # messages to the user about what the video lacks


def require_container(path: Path) -> None:
    """Refuse a video whose suffix names no container that is written; raises UsageError."""
    if path.suffix.lower() not in CONTAINERS:
        raise UsageError(
            f"the video {path} is neither .mp4 nor .mov; choose a name with one of the two"
        )


def find_codec(name: str, path: Path) -> Codec:
    """Return the codec of a name out of `VIDEO_CODECS` for a video.

    Raises UsageError for another name, and where the container has no room for it. Raises
    InstallationError when ffmpeg cannot encode with it.
    """
    if name not in CODECS:
        raise UsageError(f"--video-codec {name} is not one of {', '.join(CODECS)}")
    codec = CODECS[name]
    if CONTAINERS[path.suffix.lower()] not in codec.containers:
        raise UsageError(
            f"{codec.title} does not go into {path}; name the video .mov, or choose another "
            "--video-codec"
        )
    if codec is CODECS[_H264]:  # which every build has
        return codec
    source = ffmpeg.RAW_INPUT_16.format(width=64, height=64, rate=1).split()
    encoder = ("-c:v", codec.encoder, *codec.options, "-pix_fmt", codec.pixels)
    try:
        ffmpeg.run_ffmpeg([*source, *encoder, "-f", "null", "-"], bytes(64 * 64 * 6))
    except ffmpeg.FfmpegError as error:
        raise InstallationError(
            f"ffmpeg cannot encode {codec.title} by {codec.encoder}: {error}; reinstall the "
            "package imageio-ffmpeg, unset IMAGEIO_FFMPEG_EXE, or choose --video-codec h264"
        ) from error
    return codec


def read_video_note(path: Path) -> str | None:
    """Return the note of a video; None without one, and for what cannot be read as a video.

    A video that `VideoWriter` put in place is complete, so the note alone identifies a good one.
    """
    if not path.is_file():
        return None
    try:
        metadata, _ = ffmpeg.run_ffmpeg(["-i", f"file:{path}", "-f", "ffmetadata", "-"])
    except ffmpeg.FfmpegError:
        return None
    comment = re.search(r"^comment=(.*)$", metadata.decode("utf-8", "replace"), re.MULTILINE)
    return None if comment is None else re.sub(r"\\(.)", r"\1", comment[1])


class VideoWriter(ResourceOwner):
    """Writes frames to a video, ``.mp4`` or ``.mov``, that appears when it is complete.

    A context manager: leaving it without an error puts the video in place, with one discards it.
    The folder must exist. Frames of odd size are padded by repeating the last column or row, since
    4:2:0 video has even sizes only. The frame rate is kept exactly as a `Fraction`; of a float, the
    nearest fraction. `codec` is one that `find_codec` returned.

    Raises UsageError for another suffix, or a frame rate that is not positive. Raises OutputError
    when ffmpeg is missing or fails, or the video cannot be written.
    """

    def __init__(
        self,
        path: Path,
        width: int,
        height: int,
        fps: Fraction | float,
        look: VideoLook | None = None,
        codec: Codec = CODECS[_H264],
    ) -> None:
        require_container(path)
        if not 0 < fps < float("inf"):
            raise UsageError(f"the frame rate {fps} of the video is not a positive number")
        self._path = path
        self._container = CONTAINERS[path.suffix.lower()]
        self._shape = (height, width, 3)
        self._rate = Fraction(fps).limit_denominator(100_000)
        self._look = look or VideoLook()
        self._codec = codec
        self._dtype = np.dtype(np.uint16 if codec.is_deep else np.uint8)
        self._count = 0
        # What the video lacks, or has in another form than the input; complete once entered
        self.remarks = self._look.remarks

    def _open(self, stack: ExitStack) -> None:
        look, codec = self._look, self._codec
        temporary = stack.enter_context(atomic_path(self._path))
        temporary.touch()  # a bad folder shows here, with its reason
        sound_in: list[str] = []
        sound_out: list[str] = []
        if look.sound is not None:
            tracks, remarks = plan_tracks(look.sound, self._container)
            self.remarks += remarks
            if tracks:
                sound_in = look.sound.input_options
                sound_out = ["-map", "0:v", *_track_options(tracks, 1), "-map_metadata", "1"]
        # The timecode at the video's rate; None without, and if it cannot count that rate.
        timecode = look.timecode and look.timecode.convert(self._rate)
        if look.timecode is not None and timecode is None:
            why = f"as it cannot count {float(self._rate):g} frames a second"
            self.remarks += (f"the timecode is left out of the video, {why}",)
        height, width, _ = self._shape
        colour = look.colour
        if not codec.has_full_range:
            colour = replace(colour, full_range=False)
        levels = "pc" if colour.full_range else "tv"
        source = (ffmpeg.RAW_INPUT_16 if codec.is_deep else ffmpeg.RAW_INPUT).format(
            width=width + width % 2, height=height + height % 2, rate=self._rate
        )
        # Turn sRGB codes into the video's colour, and say so: the encoder labels it with that.
        filters = (
            f"scale=out_color_matrix={MATRICES[colour.matrix]}:out_range={levels}:"
            f"{ffmpeg.EXACT_SCALING},setparams=range={levels}:colorspace={colour.matrix}:"
            f"color_primaries={colour.primaries}:color_trc={colour.transfer},"
            f"setsar={look.pixel_aspect.numerator}/{look.pixel_aspect.denominator}"
        )
        if sound_out or timecode:  # the other video's own timecode counts its own rate
            sound_out += ["-metadata", f"timecode={timecode or ''}"]
        options = [
            *source.split(),
            *sound_in,
            *("-vf", filters, "-c:v", codec.encoder, *codec.options, "-pix_fmt", codec.pixels),
            *sound_out,
            *(("-metadata", f"comment={look.note}") if look.note else ()),
            *("-movflags", "+faststart", "-f", self._container, f"file:{temporary}"),
        ]
        try:
            self._ffmpeg = stack.enter_context(ffmpeg.FfmpegWriter(options))
        except ffmpeg.FfmpegError as error:
            raise OutputError(
                f"cannot write the video {self._path}: {error}; reinstall the "
                "package imageio-ffmpeg, or run without the video"
            ) from error
        stack.push(self._finish)

    def _finish(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        if error is not None:
            return
        try:
            self._ffmpeg.close()
        except ffmpeg.FfmpegError as failure:
            raise OutputError(_FAILED.format(self._path, failure)) from failure
        if self._count == 0:
            raise OutputError(
                f"the video {self._path} would have no frames; choose frames to write, or run "
                "without the video"
            )

    def write(self, frame: Codes) -> None:
        """Append a frame, [H, W, 3] in display encoding; raises OutputError.

        It is uint16 where the codec is deep, else uint8.
        """
        if frame.shape != self._shape or frame.dtype != self._dtype:
            raise ValueError(
                f"expected {self._dtype} {self._shape}, got {frame.dtype} {frame.shape}"
            )
        try:
            self._ffmpeg.write(ffmpeg.pad_to_even(frame))
        except ffmpeg.FfmpegError as error:
            raise OutputError(_FAILED.format(self._path, error)) from error
        self._count += 1


def plan_tracks(sound: Soundtrack, container: str) -> tuple[EncodedTracks, tuple[str, ...]]:
    """Find out how each track can go into a container, "mp4" or "mov", by trying.

    Returns the tracks that go along, and a sentence for each one that is not copied.
    """
    tracks = [Track(SOUND, index, codec) for index, codec in enumerate(sound.codecs)]
    tracks += [Track(SUBTITLES, index, codec) for index, codec in enumerate(sound.subtitles)]
    encoded = [(track, _encoders(track, container)[0]) for track in tracks]
    if encoded and not _can_encode(sound, encoded, container):  # rarely: else it is read once
        choices = [(track, _choose_encoder(sound, track, container)) for track in tracks]
        encoded = [(track, encoder) for track, encoder in choices if encoder is not None]
    encoders, remarks = dict(encoded), []
    for track in tracks:
        kind, encoder = "sound" if track.kind == SOUND else "subtitle", encoders.get(track)
        name = f"{kind} track {track.index + 1} ({track.codec}) of {sound.path}"
        if encoder is None:
            fits_mov = container == "mp4" and _choose_encoder(sound, track, "mov") is not None
            better = "; a video named .mov can hold it" if fits_mov else ""
            why = "as it cannot be copied or encoded again"
            remarks.append(f"{name} is left out of the video, {why}{better}")
        elif track.kind == SUBTITLES and track.codec in STYLED_SUBTITLES:
            remarks.append(f"{name} keeps its text alone")
        elif track.kind == SOUND and encoder != (_COPY,):
            is_usual = track.codec in COPIED_AUDIO[container]
            why = "it is damaged" if is_usual else f"players of .{container} do not know it"
            remarks.append(f"{name} is encoded again as {encoder[0]}, since {why}")
    return encoded, tuple(remarks)


def _encoders(track: Track, container: str) -> list[tuple[str, ...]]:
    """Return the encoders to try, the best first."""
    if track.kind == SUBTITLES:
        return [("mov_text",)]
    copied = [(_COPY,)] if track.codec in COPIED_AUDIO[container] else []
    # AAC has 8 channels at most here; PCM has any number, but is not usual in MP4.
    pcm = [("pcm_s24le",)] if container == "mov" else []
    return [*copied, ("aac", "256k"), *pcm]


def _choose_encoder(sound: Soundtrack, track: Track, container: str) -> tuple[str, ...] | None:
    encoders = _encoders(track, container)
    return next((e for e in encoders if _can_encode(sound, [(track, e)], container)), None)


def _can_encode(sound: Soundtrack, tracks: EncodedTracks, container: str) -> bool:
    """Write tracks to nowhere, and return True if that succeeds."""
    options = (*sound.input_options, *_track_options(tracks, 0))
    try:
        ffmpeg.run_ffmpeg([*options, "-f", container, f"file:{os.devnull}"])
    except ffmpeg.FfmpegError:
        return False
    return True


def _track_options(tracks: EncodedTracks, source: int) -> list[str]:
    """Return ffmpeg's options for the output, by the number of the input."""
    options: list[str] = []
    counts = {SOUND: 0, SUBTITLES: 0}
    for track, (encoder, *rate) in tracks:
        place = f"{track.kind}:{counts[track.kind]}"
        counts[track.kind] += 1
        options += ["-map", f"{source}:{track.kind}:{track.index}", f"-c:{place}", encoder]
        options += [f"-b:{place}", *rate] if rate else []
    return options
