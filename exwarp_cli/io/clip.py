"""Reading plain video: what a file holds, and its frames as scene-linear colour.

The ffmpeg that imageio-ffmpeg ships comes without ffprobe. Its format ``framecrc`` lists every
packet's time without decoding one, and its filter ``showinfo`` prints what the decoder knows of the
first frame; both have kept their form for many years.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exwarp_cli.domain.frame import Float32, require_size
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.atomic import Held
from exwarp_cli.io.clip_timing import (
    IN_ORDER,
    ON_DAMAGE,
    Pacing,
    Packets,
    first_interlaced,
    frame_info,
    intact_frames,
    pace,
    read_packets,
)
from exwarp_cli.io.ffmpeg import EXACT, Drain, FfmpegError, run_ffmpeg
from exwarp_cli.io.reading_retry import system_failure, with_retries
from exwarp_cli.io.video import (
    MATRICES,
    Soundtrack,
    Timecode,
    VideoColour,
    VideoLook,
    from_display,
)

CLIPS = (
    *(".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mxf", ".mpg", ".mpeg", ".ts", ".mts"),
    *(".m2ts", ".flv", ".wmv", ".gif", ".apng", ".y4m"),
)
"""Suffixes of the videos that are read, in lower case."""

_PICTURES = (".gif", ".apng")  # of videos that may be single pictures, too

HD_ROWS = 720
"""From as many rows on, a video that does not say its matrix has that of BT.709, else BT.601."""

DEINTERLACE = "bwdif=mode=send_frame:deint=interlaced"
"""Filter that makes one frame of two fields, and leaves frames alone that are progressive."""

# The usual decoders of the two leave alpha out without a word.
_ALPHA_DECODERS = {"vp8": "libvpx", "vp9": "libvpx-vp9"}
_HDR = {"smpte2084": "PQ", "arib-std-b67": "HLG"}
_INDEXED = ("mov,mp4", "matroska")  # containers whose table of frames seeking can rely on
_REBASED = "mpeg"  # program and transport streams: ffmpeg starts what it reads of them at 0
_ALPHA = re.compile(r"(yuva|gbra|rgba|bgra|argb|abgr|ya)[0-9a-z]*")
_RGB = re.compile(r"gbr|rgb|bgr|argb|abgr|0rgb|0bgr|pal8|x2rgb|x2bgr")
_DEEP = re.compile(r"(9|10|12|14|16|32|48|64)(le|be)")


@dataclass(frozen=True)
class Clip:
    """A video that was looked into.

    Attributes
    ----------
    path
        The file.
    width, height
        Of its frames as players show them, turned upright, in pixels.
    pacing
        Frame rate, and which of the file's frames is shown at each instant of it.
    look
        Its colour, pixel aspect and sound, for a video made of it.
    has_alpha
        Whether it has an alpha channel.
    deep
        Whether it has more than 8 bits a channel; then 16 are decoded.
    """

    path: Path
    width: int
    height: int
    pacing: Pacing
    look: VideoLook
    has_alpha: bool
    deep: bool
    _packets: Packets
    _indexed: bool
    _decoder: tuple[str, ...] = ()
    _deinterlaced: bool = False
    _opaque: int = 255

    @property
    def rate(self) -> Fraction:
        """Frames per second, exactly."""
        return self.pacing.rate

    @property
    def count(self) -> int:
        """Number of frames at this rate."""
        return len(self.pacing.shown)

    @property
    def reading(self) -> tuple[str, ...]:
        """Names of what its frames depend on beside the file."""
        names = {"alpha": self.has_alpha, "deinterlaced": self._deinterlaced}
        return tuple(name for name, wanted in names.items() if wanted)

    def sound(
        self, start: Fraction | int = 0, stop: Fraction | int | None = None
    ) -> Soundtrack | None:
        """Return the sound that goes with the frames [start, stop); None where it is silent."""
        whole = self.look.sound
        if whole is None:
            return None
        length = None if stop is None else (stop - start) / self.rate
        first = whole.start + start / self.rate
        return replace(whole, start=first, length=length)

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Float32]:
        """Decode the frames [start, stop), one at a time.

        Yields
        ------
        float32 [H, W, 3 or 4]
            Scene-linear, 0 to 1, by the sRGB curve: what `to_display` undoes. With alpha, it is
            premultiplied. The same pixels wherever decoding starts.

        Raises
        ------
        DamagedFileError
            When the video cannot be decoded, or ends early.
        """
        for code in self._codes(start, self.count if stop is None else stop):
            yield self._light_of(code)

    def _codes(self, start: int, stop: int) -> Iterator[np.ndarray]:
        """Decode frames as uint8 or uint16 [H, W, 3], with alpha [H, W, 4]."""
        shown = self.pacing.shown[start:stop]
        if not shown:
            return
        dtype, name, size = self._layout
        cut = self._packets.cut(shown[0]) if self._packets.times else shown[0]
        at = (cut or 0) - 1
        ahead: deque[tuple[int, bytes]] = deque()
        try:
            with Drain(self._options(cut, name)) as ffmpeg:
                for index, source in enumerate(shown, start=start):
                    # A B-frame is not known to be sound before the frame after it is.
                    needed = self._packets.last_needed(source)
                    while at < needed:
                        data = ffmpeg.read(size)
                        if data is None:
                            raise self._ends(index)
                        at += 1
                        ahead.append((at, data))
                    while ahead[0][0] < source:
                        ahead.popleft()
                    yield self._codes_of(ahead[0][1], dtype)
        except FfmpegError as error:
            raise damaged_clip(self.path, str(error)) from error

    def begins_group(self, index: int) -> bool:
        """True if a frame is the first that is decoded after a seek, or of the file."""
        first = self._first_needed(self.pacing.shown[index])
        return first <= 0 or self._key_before(first) == first

    def _first_needed(self, source: int) -> int:
        """Return the first of the file's frames that one of them is made from."""
        return (self._packets.cut(source) or 0) - self._deinterlaced

    def intact_frames(self, start: int = 0) -> Iterator[Float32 | None]:
        """Decode the frames from one on, over damage.

        Yields
        ------
        float32 [H, W, 3 or 4] or None
            As `frames` does; None for a frame that damage affects: for one that cannot be decoded,
            and for those after it up to the next key frame.
        """
        shown = self.pacing.shown[start:]
        dtype, name, size = self._layout
        begin = self._key_before(self._first_needed(shown[0])) or 0
        seek = ["-ss", f"{float(self._packets.time(begin)):.6f}"] if begin else []
        options = [
            *(*ON_DAMAGE, *seek, *IN_ORDER, *self._decoder, "-i", f"file:{self.path}"),
            *("-map", "0:V:0"),
            *("-vf", f"{self._fields}{self._conversion(name)}", "-fps_mode", "passthrough"),
            *("-f", "rawvideo", "-pix_fmt", name, "-"),
        ]
        with Drain(options) as ffmpeg:
            intact = intact_frames(ffmpeg, size, self._packets, begin, self.rate)
            at, data = -1, b""
            for source in shown:
                while at < source:
                    at, data = next(intact, (self._packets.count, b""))
                if at > source:
                    yield None
                else:
                    yield self._light_of(self._codes_of(data, dtype))

    @property
    def _layout(self) -> tuple[np.dtype[Any], str, int]:
        """Type of a decoded channel, ffmpeg's name of such pixels, and bytes of a frame."""
        dtype: np.dtype[Any] = np.dtype("<u2" if self.deep else "u1")
        names = ("rgb48le", "rgba64le") if self.deep else ("rgb24", "rgba")
        size = self.width * self.height * (3 + self.has_alpha) * dtype.itemsize
        return dtype, names[self.has_alpha], size

    @property
    def _fields(self) -> str:
        """What goes before other filters, to make frames of fields."""
        return f"{DEINTERLACE}," if self._deinterlaced else ""

    def _codes_of(self, data: bytes, dtype: np.dtype[Any]) -> np.ndarray:
        return np.frombuffer(data, dtype).reshape(self.height, self.width, 3 + self.has_alpha)

    def _light_of(self, codes: np.ndarray) -> Float32:
        """Turn sRGB codes into scene-linear light, premultiplied if there is alpha."""
        light = from_display(codes[..., :3])
        if not self.has_alpha:
            return light
        alpha = np.minimum(codes[..., 3:] / np.float32(self._opaque), 1)
        return np.concatenate([light * alpha, alpha], axis=-1)

    def _ends(self, index: int) -> DamagedFileError:
        return damaged_clip(self.path, f"it ends after {index} of {self.count} frames")

    def _options(self, first: int | None, pixels: str) -> list[str]:
        """Return what makes ffmpeg write the file's frames from one on; None for the first."""
        # A field is judged by the frame before, too.
        key = None if first is None else self._key_before(first - self._deinterlaced)
        seek = None if key is None else self._packets.time(key)
        begin = [] if seek is None else ["-ss", f"{float(seek):.6f}"]
        if first is None:
            cut = "null"
        elif self._packets.times:
            # Half a frame before its time, as both are rounded.
            half = max(self._packets.least_step, self._packets.tick) / 2
            since = self._packets.time(first) - (seek or 0) - half
            cut = f"trim=start={max(float(since), 0):.6f}"
        else:
            cut = f"trim=start_frame={first}"
        return [
            *("-xerror", *begin, *IN_ORDER, *self._decoder, "-i", f"file:{self.path}"),
            *("-map", "0:V:0"),
            *("-vf", f"{self._fields}{cut},{self._conversion(pixels)}", "-fps_mode", "passthrough"),
            *("-f", "rawvideo", "-pix_fmt", pixels, "-"),
        ]

    def _conversion(self, pixels: str) -> str:
        """Return the filters that turn what is decoded into full-range RGB."""
        matrix = MATRICES[self.look.colour.matrix]
        return (
            f"scale={self.width}:{self.height}:in_color_matrix={matrix}:"
            f"out_range=pc:{EXACT},format={pixels}"
        )

    def _key_before(self, first: int) -> int | None:
        """Return the key frame to seek to before a frame; None to decode from the start.

        What is shown before a key frame but comes after it in the file, an open group of pictures,
        needs the key frame before; by the order of showing it is behind that one.
        """
        keys = self._packets.keys
        before = bisect_right(keys, first) - 1
        if not self._indexed or before < 1 or self._packets.least_step <= 0:
            return None
        return keys[before]


class ClipReader(Held):
    """Frames of a video by their index, cheaply as long as that grows; a context manager."""

    def __init__(self, clip: Clip) -> None:
        self._clip = clip
        self._next = 0
        self._frames: Iterator[Float32 | None] | None = None
        self._last: tuple[int, Float32] | None = None
        self._damaged: set[int] = set()
        self._is_damaged = False

    def _open(self, stack: ExitStack) -> None:
        stack.callback(self._rest)

    def read(self, index: int) -> Float32:
        """Return a frame as `Clip.frames` yields it.

        Raises
        ------
        DamagedFileError
            When the video ends early, or cannot be decoded there.
        UnreadableError
            When the system does not let it through.
        """
        return with_retries(self._clip.path, partial(self._read, index))

    def _read(self, index: int) -> Float32:
        """Return a frame, decoded on from the last one or from the key frame before."""
        if self._last is not None and self._last[0] == index:
            return self._last[1]
        if index in self._damaged:
            raise self._damage(index)
        try:
            frame = self._decode(index)
        except DamagedFileError as error:
            self._rest()
            if self._is_damaged or system_failure(self._clip.path, error) is not None:
                raise
            # Once there is damage, ffmpeg decodes on over it, and does not begin at each frame.
            self._is_damaged = True
            frame = self._decode(index)
        if frame is None:
            damage = self._damage(index)
            if system_failure(self._clip.path, damage) is None:
                self._damaged.add(index)
            else:
                self._rest()  # the end of what was read is not the end of the file
            raise damage
        self._last = index, frame
        return frame

    def _decode(self, index: int) -> Float32 | None:
        """Return a frame, or None if damage affects it; raises DamagedFileError at first damage."""
        if self._frames is None or index < self._next:
            self._rest()
            clip = self._clip
            # Inside a group of pictures, ffmpeg hands out frames before it stops at earlier damage.
            is_checked = self._is_damaged or not clip.begins_group(index)
            frames = clip.intact_frames(index) if is_checked else clip.frames(index)
            self._frames, self._next = frames, index
        for frame in self._frames:
            self._next += 1
            if self._next > index:
                return frame
        raise IndexError(f"{self._clip.path} has no frame {index}")

    def _damage(self, index: int) -> DamagedFileError:
        return damaged_clip(
            self._clip.path,
            f"frame {index + 1} of {self._clip.count} is damaged, or builds on a damaged one",
        )

    def _rest(self) -> None:
        """Stop decoding."""
        if self._frames is not None:
            self._frames.close()  # type: ignore[attr-defined]  # a generator
        self._frames = None


def is_clip(spec: str) -> bool:
    """Whether what a user names is a video rather than a sequence of images."""
    path = Path(spec)
    suffix = path.suffix.lower()
    if suffix in _PICTURES and set("#%") & set(path.name):
        return False  # a pattern of single pictures
    return suffix in CLIPS and not path.is_dir()


def open_clip(path: Path, scan: str = SourceSettings.scan) -> Clip:
    """Look into a video.

    Parameters
    ----------
    path
        The file.
    scan
        Out of `SCANS`: how it is read if it is interlaced, at its first frame or later.

    Raises
    ------
    InputError
        When there is no such file, or it is HDR, sound alone, or interlaced with `scan` "auto".
    DamagedFileError
        When it cannot be read as video.
    UnreadableError
        When the system does not let it through.
    """
    return with_retries(path, partial(_open_clip, path, scan))


def _open_clip(path: Path, scan: str) -> Clip:
    """Look into a video, once."""
    if not path.is_file():
        raise InputError(f"there is no video {path}; check the path")
    try:
        packets = read_packets(path)
        decoder, said = _first_frame(path)
    except FfmpegError as error:
        _require_picture(path)
        raise damaged_clip(path, str(error)) from error
    seen = _Seen.parse(path, said)
    if scan == "auto":
        _require_progressive(path, packets, seen)
    width, height = seen.size
    require_size(path, height, width)
    sound = None
    if seen.codecs or seen.subtitles:
        start = max(seen.starts.picture + packets.time(0), Fraction(0))
        sound = Soundtrack(path, seen.codecs, start, None, seen.starts.sound, seen.subtitles)
    pacing = pace(packets, seen.rate)
    code = None if seen.timecode is None else Timecode(seen.timecode, pacing.rate)
    return Clip(
        path,
        *seen.size,
        pacing,
        VideoLook(seen.colour, seen.aspect, sound, timecode=code),
        _ALPHA.fullmatch(seen.pixels) is not None,
        _DEEP.search(seen.pixels) is not None,
        packets,
        seen.container.startswith(_INDEXED),
        decoder,
        scan == "deinterlace",
        _opaque(seen.pixels),
    )


def damaged_clip(path: Path, why: str) -> DamagedFileError:
    """Return the error for a video that cannot be decoded."""
    return DamagedFileError(f"cannot read the video {path}: {why}; export it again")


def _opaque(pixels: str) -> int:
    """Return what full alpha is decoded to: the filter ``scale`` shifts 10 or 12 bits up to 16."""
    deep = _DEEP.search(pixels)
    if deep is None:
        return 255
    bits = min(int(deep[1]), 16)
    return ((1 << bits) - 1) << (16 - bits)


def _require_picture(path: Path) -> None:
    """Refuse a file of sound alone; raises InputError."""
    with suppress(FfmpegError):
        _, said = run_ffmpeg(["-v", "info", "-i", f"file:{path}", "-f", "ffmetadata", "-"])
        streams = re.findall(r"^\s*Stream #0:.*", _input_part(said), re.MULTILINE)
        # A cover is no video.
        seen = any(": Video: " in line and "(attached pic)" not in line for line in streams)
        if streams and not seen:
            raise InputError(f"{path} holds no picture, only sound; name a video or frames")


def _first_frame(path: Path) -> tuple[tuple[str, ...], str]:
    """Return the options that choose a decoder, and what ffmpeg says of a file's first frame."""
    said = frame_info(path, "-frames:v", "1")
    video = re.search(r"Stream #0:.*?: Video: (\w+)", said)
    name = _ALPHA_DECODERS.get(video[1]) if video else None
    if name is None or not re.search(r"^\s*alpha_mode\s*: 1", _input_part(said), re.MULTILINE):
        return (), said
    decoder = ("-c:v", name)
    try:
        return decoder, frame_info(path, "-frames:v", "1", decoder=decoder)
    except FfmpegError as error:
        raise FfmpegError(f"its alpha needs ffmpeg with the decoder {name}") from error


def _require_progressive(path: Path, packets: Packets, seen: _Seen) -> None:
    """Refuse a video with interlaced frames; raises InputError."""
    indexed = seen.container.startswith(_INDEXED)
    when = Fraction(0) if seen.interlaced else first_interlaced(path, packets, indexed)
    if when is None:
        return
    begin = f" from {float(when):.2f} s on" if when else ""
    raise InputError(
        f"the video {path} is interlaced{begin}, and frames are upsampled here, not fields; give "
        "--scan deinterlace, or --scan progressive if both fields show one instant (PsF)"
    )


@dataclass(frozen=True)
class _Seen:
    """What ffmpeg says of a video; attributes as in `Clip`."""

    container: str
    size: tuple[int, int]
    aspect: Fraction
    pixels: str
    rate: Fraction | None
    colour: VideoColour
    interlaced: bool
    codecs: tuple[str, ...]
    subtitles: tuple[str, ...]
    timecode: str | None
    starts: _Starts

    @classmethod
    def parse(cls, path: Path, said: str) -> _Seen:
        """Read what it prints; raises InputError for what cannot be upsampled as it is."""
        container = re.search(r"^Input #0, (\S+), from", said, re.MULTILINE)
        frame = re.search(
            r"showinfo.* fmt:(?P<fmt>\S+) .*sar:(?P<sar>\d+/\d+) s:(?P<w>\d+)x(?P<h>\d+) "
            r"i:(?P<scan>\S)",
            said,
        )
        if container is None or frame is None:
            raise damaged_clip(path, "no frame can be decoded")
        tags = dict(re.findall(r"\b(color_\w+):(\S+)", said.replace(":reserved", ":unknown")))
        transfer = tags.get("color_trc", "unknown")
        if transfer in _HDR:
            raise InputError(
                f"the video {path} is HDR ({_HDR[transfer]}), and only SDR video is read; convert "
                "it to SDR first, or give the frames as OpenEXR"
            )
        size = int(frame["w"]), int(frame["h"])
        num, den = map(int, frame["sar"].split("/"))
        code = re.search(r"^\s*timecode\s*: (\S+)", _input_part(said), re.MULTILINE | re.IGNORECASE)
        rate = re.search(r"showinfo.*frame_rate: (\d+)/([1-9]\d*)", said)
        return cls(
            container[1],
            size,
            Fraction(num, den) if num and den else Fraction(1),
            frame["fmt"],
            Fraction(int(rate[1]), int(rate[2])) if rate else None,
            _colour(path, tags, size[1], frame["fmt"]),
            frame["scan"] in "TB",
            _codecs(said, "Audio"),
            _codecs(said, "Subtitle"),
            None if code is None else code[1],
            _Starts.parse(container[1], _input_part(said)),
        )


def _codecs(said: str, kind: str) -> tuple[str, ...]:
    """Return the codecs of a kind of tracks, in the order of the file."""
    line = rf"^\s*Stream #0:(\d+).*?: {kind}: (\w+)"
    streams = re.findall(line, _input_part(said), re.MULTILINE)
    # A transport stream lists a track once for each program that has it.
    by_index = {int(index): codec for index, codec in streams}
    return tuple(by_index[index] for index in sorted(by_index))


@dataclass(frozen=True)
class _Starts:
    """Seconds from a file's first time to those that ffmpeg turns into 0; 0 where it keeps them."""

    picture: Fraction = Fraction(0)
    sound: Fraction = Fraction(0)

    @classmethod
    def parse(cls, container: str, said: str) -> _Starts:
        """Read the start of the file and of its streams."""
        whole = re.search(r"^  Duration: .*\bstart: (-?[\d.]+)", said, re.MULTILINE)
        if not container.startswith(_REBASED) or whole is None:
            return cls()
        starts: dict[str, list[Fraction]] = {"Video": [], "Audio": []}
        streams = re.findall(r"^\s*Stream #0:.*?: (Video|Audio): (.*)$", said, re.MULTILINE)
        for kind, line in streams:
            start = re.search(r", start (-?[\d.]+)", line)
            starts[kind].append(Fraction(start[1] if start else 0) - Fraction(whole[1]))
        zero = Fraction(0)
        # One picture is read alone, all sounds together.
        return cls(next(iter(starts["Video"]), zero), min(starts["Audio"], default=zero))


def _input_part(said: str) -> str:
    """Return what is said of the input, without the output."""
    return said.partition("Stream mapping:")[0].partition("Output #0")[0]


def _colour(path: Path, tags: dict[str, str], rows: int, pixels: str) -> VideoColour:
    """Return what the colour codes mean, with the usual guesses where the file does not tell."""
    matrix, full_range = tags.get("color_space", "unknown"), tags.get("color_range") == "pc"
    if matrix == "gbr" or _RGB.match(pixels):
        matrix, full_range = "bt709", False  # it has neither, and the video made of it needs both
    elif matrix == "unknown":
        matrix = "bt709" if rows >= HD_ROWS else "smpte170m"
    elif matrix not in MATRICES:
        raise InputError(
            f"the video {path} has the colour matrix {matrix}, which is not known here; "
            "convert it to BT.709 first"
        )
    return VideoColour(
        matrix,
        tags.get("color_primaries", "unknown"),
        tags.get("color_trc", "unknown"),
        full_range=full_range or pixels.startswith("yuvj"),
    )
