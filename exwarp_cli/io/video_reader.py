"""Reading plain video: what a file holds, and its frames as scene-linear colour.

The ffmpeg that imageio-ffmpeg ships comes without ffprobe. Its format ``framecrc`` lists every
packet's time without decoding one, and its filter ``showinfo`` prints what the decoder knows of the
first frame; both have kept their form for many years.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Generator
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from exwarp_cli.domain.frame import Float32, require_size
from exwarp_cli.domain.settings import SourceSettings
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io import video_timing
from exwarp_cli.io.display_colour import MATRICES, VideoColour, from_display
from exwarp_cli.io.ffmpeg import EXACT_SCALING, FfmpegError, FfmpegReader, run_ffmpeg
from exwarp_cli.io.files import system_failure, with_retries
from exwarp_cli.io.video_writer import Soundtrack, Timecode, VideoLook

# Suffixes of the videos that are read, in lower case.
CLIPS = (
    *(".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mxf", ".mpg", ".mpeg", ".ts", ".mts"),
    *(".m2ts", ".flv", ".wmv", ".gif", ".apng", ".y4m"),
)
_PICTURES = (".gif", ".apng")  # of videos that may be single pictures, too

# From as many rows on, a video that does not name its matrix has that of BT.709, else BT.601.
HD_ROWS = 720

# Filter that makes one frame of two fields, and leaves frames alone that are progressive.
DEINTERLACE = "bwdif=mode=send_frame:deint=interlaced"

# The usual decoders of the two drop alpha silently.
_ALPHA_DECODERS = {"vp8": "libvpx", "vp9": "libvpx-vp9"}
_HDR = {"smpte2084": "PQ", "arib-std-b67": "HLG"}
_INDEXED = ("mov,mp4", "matroska")  # containers whose table of frames seeking can rely on
_REBASED = "mpeg"  # program and transport streams: ffmpeg starts what it reads of them at 0
_ALPHA = re.compile(r"(yuva|gbra|rgba|bgra|argb|abgr|ya)[0-9a-z]*")
_RGB = re.compile(r"gbr|rgb|bgr|argb|abgr|0rgb|0bgr|pal8|x2rgb|x2bgr")
_DEEP = re.compile(r"(9|10|12|14|16|32|48|64)(le|be)")
_OUTPUT = re.compile("Stream mapping:|Output #0")  # where ffmpeg has printed all about the input


@dataclass(frozen=True)
class Clip:
    """A video that was looked into."""

    path: Path
    # Of its frames as players show them, turned upright, in pixels
    width: int
    height: int
    # Frame rate, and which of the file's frames is shown at each instant of it
    pacing: video_timing.Pacing
    look: VideoLook  # its colour, pixel aspect and sound, for a video made of it
    has_alpha: bool  # whether it has an alpha channel
    deep: bool  # whether it has more than 8 bits a channel; then 16 are decoded
    packets: video_timing.Packets  # of the file
    _is_indexed: bool
    _decoder: tuple[str, ...] = ()
    is_deinterlaced: bool = False  # whether frames are made of two fields
    _full_alpha: int = 255

    @property
    def rate(self) -> Fraction:
        """Frames per second, exactly."""
        return self.pacing.rate

    @property
    def count(self) -> int:
        """Number of frames at this rate."""
        return len(self.pacing.shown)

    @cached_property
    def digest(self) -> str:
        """Digest of the file, hexadecimal; see `file_digest`."""
        from exwarp_cli.io.key_file import file_digest  # OpenEXR, which is not needed to decode

        return file_digest(self.path)

    def sound(self, start: Fraction | int, stop: Fraction | int | None) -> Soundtrack | None:
        """Return the sound that goes with the frames [start, stop); None where it is silent."""
        sound = self.look.sound
        if sound is None:
            return None
        length = None if stop is None else (stop - start) / self.rate
        return replace(sound, start=sound.start + start / self.rate, length=length)

    def frames(self, start: int = 0) -> Generator[Float32 | None, None, None]:
        """Decode the frames from `start` on, one at a time: float32 [H, W, 3 or 4], 0 to 1.

        They are scene-linear by the sRGB curve, the inverse of `to_display`. With alpha, they are
        premultiplied. Pixels are the same wherever decoding starts.

        None stands for a frame that damage affects: for one that cannot be decoded, and for those
        after it up to the next key frame. Raises DamagedFileError when ffmpeg does not start.
        """
        shown, packets = self.pacing.shown[start:], self.packets
        if not shown:
            return
        # Decoding starts at a key frame that its time identifies: past a mended time, ffmpeg may
        # derive others than those of the file. What is shown before a key frame but comes after it
        # in the file, an open group of pictures, needs the key frame before; by the order of
        # showing it is behind that one.
        first = shown[0] if packets.mended is None else min(shown[0], packets.mended - 1)
        first -= self.is_deinterlaced  # fields need the frame before
        key = bisect_right(packets.keys, first) - 1
        can_seek = self._is_indexed and key > 0 and packets.least_step > 0
        begin = packets.keys[key] if can_seek else 0
        pixels = (("rgb24", "rgba"), ("rgb48le", "rgba64le"))[self.deep][self.has_alpha]
        seek = ["-ss", f"{float(packets.time(begin)):.6f}"] if begin else []
        fields = f"{DEINTERLACE}," if self.is_deinterlaced else ""
        conversion = (
            f"scale={self.width}:{self.height}:in_color_matrix={MATRICES[self.look.colour.matrix]}:"
            f"out_range=pc:{EXACT_SCALING},format={pixels}"
        )
        options = [
            *("-nostdin", *video_timing.ON_DAMAGE, *seek, *video_timing.IN_ORDER, *self._decoder),
            *("-i", f"file:{self.path}", "-map", "0:V:0"),
            *("-vf", f"{fields}{conversion}", "-fps_mode", "passthrough"),
            *("-f", "rawvideo", "-pix_fmt", pixels, "-"),
        ]
        frame_bytes = self.width * self.height * (3 + self.has_alpha) * (1 + self.deep)
        try:
            with FfmpegReader(options, frame_bytes=frame_bytes) as ffmpeg:
                intact = video_timing.intact_frames(ffmpeg, packets, begin, self.rate)
                decoded, data = -1, b""
                for source in shown:
                    while decoded < source:
                        decoded, data = next(intact, (shown[-1] + 1, b""))
                    yield None if decoded > source else self._to_light(data)
        except FfmpegError as error:
            raise damaged_clip(self.path, str(error)) from error

    def _to_light(self, data: bytes) -> Float32:
        """Turn sRGB codes into scene-linear light, premultiplied if there is alpha."""
        codes = np.frombuffer(data, "<u2" if self.deep else "u1")
        codes = codes.reshape(self.height, self.width, 3 + self.has_alpha)
        light = from_display(codes[..., :3])
        if not self.has_alpha:
            return light
        alpha = np.minimum(codes[..., 3:] / np.float32(self._full_alpha), 1)
        return np.concatenate([light * alpha, alpha], axis=-1)


@dataclass(eq=False)
class ClipReader:
    """Frames of a video by their index, cheaply as long as that grows; `close` ends ffmpeg."""

    clip: Clip
    _frames: Generator[Float32 | None, None, None] | None = None
    _index: int = -1
    _frame: Float32 | None = None  # that was decoded last; None if it is damaged

    def read(self, index: int) -> Float32:
        """Return a frame as `Clip.frames` yields it.

        It is decoded on from the last one, or from the key frame before. Raises DamagedFileError
        when damage affects it, or the video ends early.
        """
        clip = self.clip
        damage = damaged_clip(
            clip.path, f"frame {index + 1} of {clip.count} is damaged, or builds on a damaged one"
        )
        if index != self._index:
            if self._frames is None or index < self._index:
                self.close()
                self._frames, self._index = clip.frames(index), index - 1
            try:
                while self._index < index:
                    self._frame = next(self._frames)
                    self._index += 1
            except StopIteration:
                raise IndexError(f"{clip.path} has no frame {index}") from None
            except DamagedFileError:
                self.close()  # a generator that raised has ended
                raise
            if self._frame is None and system_failure(clip.path, damage) is not None:
                self.close()  # the end of what was read is not the end of the file
                raise damage
        if self._frame is None:
            raise damage
        return self._frame

    def close(self) -> None:
        """Stop decoding; a later `read` begins again."""
        if self._frames is not None:
            self._frames.close()
        self._frames, self._index = None, -1


def is_clip(spec: str) -> bool:
    """Return whether a path or pattern of the user is a video, not a sequence of images."""
    path = Path(spec)
    suffix = path.suffix.lower()
    if suffix in _PICTURES and set("#%") & set(path.name):
        return False  # a pattern of single pictures
    return suffix in CLIPS and not path.is_dir()


def open_clip(path: Path, scan: str = SourceSettings.scan) -> Clip:
    """Look into a video.

    `scan`, out of `SCANS`, is how it is read if it is interlaced, at its first frame or later.

    Raises InputError when there is no such file, or it is HDR, sound alone, or interlaced with
    `scan` "auto". Raises DamagedFileError when it cannot be read as video, and UnreadableError when
    the system does not let it through.
    """
    return with_retries(path, partial(_open_clip, path, scan))


def _open_clip(path: Path, scan: str) -> Clip:
    if not path.is_file():
        raise InputError(f"there is no video {path}; check the path")
    packets, decoder, info = _probe(path)
    input_info = _OUTPUT.split(info)[0]
    container = re.search(r"^Input #0, (\S+), from", info, re.MULTILINE)
    frame = re.search(
        r"showinfo.* fmt:(?P<fmt>\S+) .*sar:(?P<sar>\d+/\d+) s:(?P<w>\d+)x(?P<h>\d+) "
        r"i:(?P<scan>\S)",
        info,
    )
    if container is None or frame is None:
        raise damaged_clip(path, "no frame can be decoded")
    pixels, width, height = frame["fmt"], int(frame["w"]), int(frame["h"])
    colour = _parse_colour(path, info, height, pixels)
    is_indexed = container[1].startswith(_INDEXED)
    if scan == "auto":
        since: Fraction | None = Fraction(0)
        if frame["scan"] not in "TB":
            since = video_timing.first_interlaced(path, packets, is_indexed)
        if since is not None:
            begin = f" from {float(since):.2f} s on" if since else ""
            raise InputError(
                f"the video {path} is interlaced{begin}, and frames are upsampled here, not "
                "fields; give --scan deinterlace, or --scan progressive if both fields show one "
                "instant (PsF)"
            )
    require_size(path, height, width)
    sound = _find_soundtrack(path, container[1], input_info, packets.time(0))
    rate = re.search(r"showinfo.*frame_rate: (\d+/[1-9]\d*)", info)
    pacing = video_timing.find_pacing(packets, Fraction(rate[1]) if rate else None)
    code = re.search(r"^\s*timecode\s*: (\S+)", input_info, re.MULTILINE | re.IGNORECASE)
    timecode = None if code is None else Timecode(code[1], pacing.rate)
    num, den = map(int, frame["sar"].split("/"))
    aspect = Fraction(num, den) if num and den else Fraction(1)
    depth = _DEEP.search(pixels)
    # What full alpha is decoded to: the filter ``scale`` shifts 10 or 12 bits up to 16.
    bits = min(int(depth[1]), 16) if depth else 8
    full_alpha = ((1 << bits) - 1) << (16 - bits) if depth else 255
    return Clip(
        path,
        width,
        height,
        pacing,
        VideoLook(colour, aspect, sound, timecode=timecode),
        _ALPHA.fullmatch(pixels) is not None,
        depth is not None,
        packets,
        is_indexed,
        decoder,
        scan == "deinterlace",
        full_alpha,
    )


def damaged_clip(path: Path, why: str) -> DamagedFileError:
    """Build the error for a video that cannot be decoded."""
    return DamagedFileError(f"cannot read the video {path}: {why}; export it again")


def _probe(path: Path) -> tuple[video_timing.Packets, tuple[str, ...], str]:
    """Return packets, options that choose a decoder, and ffmpeg's text on the first frame.

    Raises InputError for a file of sound alone, DamagedFileError for one that is no video.
    """
    decoder: tuple[str, ...] = ()
    try:
        copy = ("-map", "0:V:0", "-c", "copy", "-f", "framecrc", "-")  # nothing is decoded
        listed, _ = run_ffmpeg(["-i", f"file:{path}", *copy])
        packets = video_timing.parse_packets(listed.decode("ascii", "replace"))
        info = video_timing.frame_info(path, "-frames:v", "1")
        video = re.search(r"Stream #0:.*?: Video: (\w+)", info)
        name = _ALPHA_DECODERS.get(video[1]) if video else None
        has_alpha = re.search(r"^\s*alpha_mode\s*: 1", _OUTPUT.split(info)[0], re.MULTILINE)
        if name is not None and has_alpha:
            decoder = ("-c:v", name)
            info = video_timing.frame_info(path, "-frames:v", "1", input_options=decoder)
    except FfmpegError as error:
        if decoder:
            why = f"its alpha needs ffmpeg with the decoder {decoder[1]}"
            raise damaged_clip(path, why) from error
        with suppress(FfmpegError):
            _, info = run_ffmpeg(["-v", "info", "-i", f"file:{path}", "-f", "ffmetadata", "-"])
            streams = re.findall(r"^\s*Stream #0:.*", _OUTPUT.split(info)[0], re.MULTILINE)
            # A cover is no video.
            pictures = [s for s in streams if ": Video: " in s and "(attached pic)" not in s]
            if streams and not pictures:
                raise InputError(
                    f"{path} holds no picture, only sound; name a video or frames"
                ) from error
        raise damaged_clip(path, str(error)) from error
    return packets, decoder, info


def _find_soundtrack(
    path: Path, container: str, input_info: str, first_time: Fraction
) -> Soundtrack | None:
    """Return a video's sound and subtitles from the time of its first picture on, if any."""
    # A transport stream lists a track once for each program that has it.
    tracks: dict[str, dict[int, tuple[str, Fraction]]] = {"Video": {}, "Audio": {}, "Subtitle": {}}
    line = r"^\s*Stream #0:(\d+).*?: (Video|Audio|Subtitle): (\w+)(.*)$"
    for index, kind, codec, rest in re.findall(line, input_info, re.MULTILINE):
        start = re.search(r", start (-?[\d.]+)", rest)
        tracks[kind][int(index)] = codec, Fraction(start[1] if start else 0)
    codecs, subtitles = (
        tuple(codec for _, (codec, _) in sorted(tracks[kind].items()))
        for kind in ("Audio", "Subtitle")
    )
    if not codecs and not subtitles:
        return None
    picture_start = sound_start = zero = Fraction(0)
    begin = re.search(r"^  Duration: .*\bstart: (-?[\d.]+)", input_info, re.MULTILINE)
    if container.startswith(_REBASED) and begin is not None:
        pictures, sounds = (
            [start - Fraction(begin[1]) for _, start in tracks[kind].values()]
            for kind in ("Video", "Audio")
        )
        # One picture is read alone, all sounds together.
        picture_start, sound_start = next(iter(pictures), zero), min(sounds, default=zero)
    begins = max(picture_start + first_time, zero)
    return Soundtrack(path, codecs, begins, None, sound_start, subtitles)


def _parse_colour(path: Path, info: str, rows: int, pixels: str) -> VideoColour:
    """Return what the colour codes mean, with the usual guesses where the file does not say.

    Raises InputError for colour that is not read.
    """
    tags = dict(re.findall(r"\b(color_\w+):(\S+)", info.replace(":reserved", ":unknown")))
    transfer = tags.get("color_trc", "unknown")
    if transfer in _HDR:
        raise InputError(
            f"the video {path} is HDR ({_HDR[transfer]}), and only SDR video is read; convert "
            "it to SDR first, or give the frames as OpenEXR"
        )
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
    primaries = tags.get("color_primaries", "unknown")
    return VideoColour(matrix, primaries, transfer, full_range or pixels.startswith("yuvj"))
