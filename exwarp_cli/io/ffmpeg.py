"""ffmpeg on raw frames: running it, VMAF, and motion-compensated interpolation.

It is the one that imageio-ffmpeg ships. It is started here, not by that package's ``write_frames``,
because that drops the exit status and so takes a full disk for success.

VMAF: Li, Aaron, Katsavounidis, Moorthy, Manohara, "Toward A Practical Perceptual Video Quality
Metric", Netflix Technology Blog, 2016; model vmaf_v0.6.1, made for 1080p seen from three times the
screen's height. It looks at luma alone. Of its features one is temporal: how much the *reference*
moves, the smaller of the differences to the frames before and after. So a frame's score depends on
its own pair and on the reference's neighbours, and on nothing else.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import imageio_ffmpeg
import numpy as np

from exwarp_cli.domain.frame import Float32, UInt8
from exwarp_cli.domain.timeline import FACTOR
from exwarp_cli.errors import InputError, LayoutError, OutputError
from exwarp_cli.io.display_colour import Codes, from_display, to_display
from exwarp_cli.io.files import ResourceOwner
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.stop import check_stop, clean_up_after, scratch_folder

RAW = "-f rawvideo -pix_fmt rgb24"  # names frames as bytes: uint8 [H, W, 3], one after the other

# Options that make ffmpeg read such frames, or those of uint16.
RAW_INPUT = RAW + " -s {width}x{height} -r {rate} -i -"
RAW_INPUT_16 = RAW_INPUT.replace("rgb24", "rgb48")

# Of the filter ``scale``: without them colours are off by more than rounding.
EXACT_SCALING = "flags=accurate_rnd+full_chroma_int"

MIN_VMAF_SIZE = 17  # rows and columns: with fewer libvmaf crashes

# Frames per second of the streams. VMAF does not use it; an encoder's rate control does.
VMAF_RATE = 60

# The log's path is relative: other characters in it would have to be escaped twice.
_LIBVMAF = "libvmaf=model=version=vmaf_v0.6.1:log_fmt=json:log_path=scores.json"

# From sRGB to the Y'CbCr of players and VMAF: ffmpeg's own matrix is standard definition's.
_TO_VIDEO = f"scale=out_color_matrix=bt709:out_range=tv:{EXACT_SCALING},format=yuv444p"

# How ExtraNet's release makes the videos that VMAF is computed of.
PUBLISHED_ENCODING = "-c:v libx264 -preset veryslow -crf 16 -pix_fmt yuv420p"

BLOCK = 8  # side of minterpolate's blocks, pixels; it leaves incomplete blocks unmoved
MIN_SIDE = 16  # pixels; minterpolate makes nothing of smaller frames
KEY_TOLERANCE = 4  # steps of 8 bits by which its YUV may change a frame that it passes through

_VIDEOS = ("reference.mp4", "test.mp4")

_NO_VMAF = (
    "cannot take VMAF: {}; reinstall the package imageio-ffmpeg, or leave vmaf out of --metrics"
)

_RATE_IN = 30  # only its ratio to the output rate matters

# The settings that suited minterpolate best on the rendered example (PSNR in dB): detection of
# scene changes off (21.0 against 20.2, since it repeats frames at motion that it takes for a cut),
# blocks of 8 pixels (21.5 against 21.0 with 16) and full-range 4:4:4.
_MINTERPOLATE = ",".join(
    (
        f"scale=out_color_matrix=bt709:out_range=pc:{EXACT_SCALING}",
        "format=yuvj444p",
        f"minterpolate=fps={_RATE_IN * FACTOR}:mi_mode=mci:mc_mode=aobmc:me_mode=bidir:vsbmc=1"
        f":mb_size={BLOCK}:scd=none",
        f"scale=in_color_matrix=bt709:in_range=pc:{EXACT_SCALING}",
        "format=rgb24",
    )
)


class FfmpegError(Exception):
    """ffmpeg failed; the text quotes its last line, or says why it did not start.

    Not an error for users: callers add what ffmpeg was for, and what to do.
    """


def run_ffmpeg(options: Sequence[str], data: bytes | None = None) -> tuple[bytes, str]:
    """Run ffmpeg with options, which write to ``-``; return what it writes and what it prints.

    It reads `data` from ``-``; without, its input is closed. Raises FfmpegError when ffmpeg does
    not start, or fails.
    """
    if data is None:
        options = ("-nostdin", *options)
    try:
        # Ctrl-C is for this process to handle, here as below: leaving `run` ends ffmpeg.
        process = subprocess.run(
            _command(options), input=data, capture_output=True, check=False, process_group=0
        )
    except (OSError, RuntimeError) as error:
        raise FfmpegError(f"ffmpeg does not start ({error})") from error
    if process.returncode:
        raise _exit_error(process.stderr, process.returncode)
    return process.stdout, process.stderr.decode("utf-8", "replace")


@dataclass(eq=False)
class _FfmpegStream(ResourceOwner):
    """One run of ffmpeg beside this process; a context manager that ends it."""

    options: Sequence[str]
    folder: Path | None = None  # in which it runs; None for that of this process

    _stdin: ClassVar[int]
    _stdout: ClassVar[int]

    def _open(self, stack: ExitStack) -> None:
        path = stack.enter_context(scratch_folder()) / "ffmpeg.log"
        log = stack.enter_context(path.open("wb"))
        self._log = stack.enter_context(path.open("rb"))  # ffmpeg shares the position of `log`
        try:
            self._process = subprocess.Popen(
                _command(self.options),
                stdin=self._stdin,
                stdout=self._stdout,
                stderr=log,
                cwd=self.folder,
                process_group=0,
            )
        except (OSError, RuntimeError) as error:
            raise FfmpegError(f"ffmpeg does not start ({error})") from error
        if self._process.stdout is not None:
            stack.enter_context(self._process.stdout)
        stack.enter_context(clean_up_after(self._kill))

    def _kill(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        if self._process.stdin is not None:
            with suppress(OSError):  # what was buffered has no reader any more
                self._process.stdin.close()

    def _error(self) -> FfmpegError:
        self._log.seek(0)
        return _exit_error(self._log.read(), self._process.returncode)


@dataclass(eq=False)
class FfmpegReader(_FfmpegStream):
    """One run of ffmpeg whose output, frames written to ``-``, is read here; a context manager.

    Left before the end, it ends ffmpeg. Raises FfmpegError when ffmpeg does not start.
    """

    frame_bytes: int = field(kw_only=True)
    _incomplete_line: bytes = b""

    _stdin, _stdout = subprocess.DEVNULL, subprocess.PIPE

    def read(self) -> bytes | None:
        """Return the next frame's bytes; None at the end, or where fewer are left.

        Raises FfmpegError when ffmpeg failed. Raises StopRequested when this process was asked to
        stop.
        """
        check_stop()
        assert self._process.stdout is not None
        data = self._process.stdout.read(self.frame_bytes)
        if len(data) == self.frame_bytes:
            return data
        if self._process.wait() != 0:
            raise self._error()
        return None

    def messages(self) -> list[str]:
        """Return the complete lines that ffmpeg printed since the last call."""
        *lines, self._incomplete_line = (self._incomplete_line + self._log.read()).split(b"\n")
        return [line.decode("utf-8", "replace") for line in lines]


class FfmpegWriter(_FfmpegStream):
    """One run of ffmpeg, in a folder, that reads frames from here; a context manager.

    Left without `close`, by an error for example, it ends ffmpeg. Raises FfmpegError when ffmpeg
    does not start.
    """

    _stdin, _stdout = subprocess.PIPE, subprocess.DEVNULL

    def write(self, frame: Codes) -> None:
        """Send a frame, [H, W, 3]; raises FfmpegError."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(np.ascontiguousarray(frame).data)
        except OSError as error:  # a broken pipe; ffmpeg has printed why it ended
            self._kill()
            raise self._error() from error

    def close(self) -> None:
        """Send the end of the frames, and wait for ffmpeg to end; raises FfmpegError."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
        except OSError as error:
            self._kill()
            raise self._error() from error
        if self._process.wait() != 0:
            raise self._error()


def pad_to_even(frame: Codes) -> Codes:
    """Repeat the last row and column of [H, W, 3] where their number is odd.

    4:2:0 video has even sizes only.
    """
    height, width, _ = frame.shape
    if not (height % 2 or width % 2):
        return frame
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _command(options: Sequence[str]) -> list[str]:
    """Return a command line that limits the threads of filters and of the first input's decoder.

    An encoder keeps its own number, since its bytes depend on that.
    """
    count = str(cores.count())
    limits = ("-filter_threads", count, "-filter_complex_threads", count, "-threads", count)
    return [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", *limits, *options]


def _exit_error(log: bytes, status: int) -> FfmpegError:
    """Quote the last line of what ffmpeg printed."""
    lines = log.decode("utf-8", "replace").strip().splitlines()
    if not lines:
        return FfmpegError(f"ffmpeg ends with status {status}")
    # Without its prefixes, as in: [vist#0:0/h264 @ 0x55…] [dec:h264 …]
    message = re.sub(r"^(\[[^\]]*\] )+", "", lines[-1].strip())
    return FfmpegError(f"ffmpeg says {message!r}")


def require_vmaf_size(height: int, width: int, what: str) -> None:
    """Refuse frames that are too small for VMAF; raises LayoutError."""
    if min(height, width) < MIN_VMAF_SIZE:
        raise LayoutError(
            f"{what} is {width}x{height}, and VMAF needs {MIN_VMAF_SIZE} pixels each way; leave "
            "vmaf out of --metrics"
        )


def compute_vmaf(reference: Iterable[UInt8], test: Iterable[UInt8]) -> list[float]:
    """Score successive frames by VMAF, 0 to 100 each.

    Frames are uint8 [H, W, 3], display-encoded (`to_display`), of one size, equally many of both
    sequences, at least one. They are taken one pair at a time. Equal frames have less than 100
    where the reference hardly moves.

    Raises InputError when ffmpeg is missing or fails. Raises LayoutError for frames below
    `MIN_VMAF_SIZE` pixels.
    """
    with VmafStream() as stream:
        for pair in zip(reference, test, strict=True):
            stream.write(*pair)
        return stream.close()


@dataclass(eq=False)
class VmafStream(ResourceOwner):
    """VMAF of pairs of frames as they come; a context manager.

    If `is_encoded`, of two videos in H.264 as ExtraNet's release makes them; odd sizes are then
    padded by repeating the last column or row, as 4:2:0 has even ones only.
    """

    is_encoded: bool = False
    _writers: list[FfmpegWriter] = field(default_factory=list)

    def _open(self, stack: ExitStack) -> None:
        self._folder = stack.enter_context(scratch_folder())

    def write(self, reference: UInt8, test: UInt8) -> None:
        """Append a pair of frames; see `compute_vmaf`."""
        height, width, _ = reference.shape
        if self.is_encoded:
            frames = [pad_to_even(reference), pad_to_even(test)]
        else:
            # Both frames go to ffmpeg as one picture, the reference above, and are cut apart there:
            # one stream cannot wait for the other.
            frames = [np.concatenate([reference, test])]
        try:
            if not self._writers:
                require_vmaf_size(height, width, "the frame")
                rows, columns, _ = frames[0].shape
                source = RAW_INPUT.format(width=columns, height=rows, rate=VMAF_RATE).split()
                if self.is_encoded:
                    runs = [[*PUBLISHED_ENCODING.split(), video] for video in _VIDEOS]
                else:
                    # Equal time stamps, whatever the filters before did: pairs must not slip.
                    graph = (
                        f"[0:v]split[x][y];[x]crop={width}:{height}:0:0,{_TO_VIDEO},setpts=N[r];"
                        f"[y]crop={width}:{height}:0:{height},{_TO_VIDEO},setpts=N[t];"
                        f"[t][r]{_LIBVMAF}"
                    )
                    runs = [["-filter_complex", graph, "-f", "null", "-"]]
                for options in runs:
                    writer = FfmpegWriter([*source, *options], self._folder)
                    self._writers.append(self._stack.enter_context(writer))
            for writer, frame in zip(self._writers, frames, strict=True):
                writer.write(frame)
        except FfmpegError as error:
            raise InputError(_NO_VMAF.format(error)) from error

    def close(self) -> list[float]:
        """Return the scores of all frames."""
        if not self._writers:
            return []
        try:
            for writer in self._writers:
                writer.close()
            if self.is_encoded:
                graph = f"[0:v]setpts=N[r];[1:v]setpts=N[t];[t][r]{_LIBVMAF}"
                videos = [option for video in _VIDEOS for option in ("-i", video)]
                options = (*videos, "-filter_complex", graph, "-f", "null", "-")
                with FfmpegWriter(options, self._folder) as comparison:
                    comparison.close()
        except FfmpegError as error:
            raise InputError(_NO_VMAF.format(error)) from error
        log = json.loads((self._folder / "scores.json").read_text(encoding="utf-8"))
        return [float(frame["metrics"]["vmaf"]) for frame in log["frames"]]


def minterpolate(older: Float32 | None, before: Float32, after: Float32) -> tuple[Float32, ...]:
    """Interpolate the frames of slots 1 to 3 of one key interval by ffmpeg's minterpolate.

    It takes F_k-1 (None at the start of a sequence), F_k and F_k+1: float32 [H, W, 3 or more],
    scene-linear with Rec. 709 primaries; channels past the third are dropped. It sees them in
    display encoding and 8 bits, so values below 0 and above 1 are lost. Returns float32 [H, W, 3],
    scene-linear, 0 to 1, in steps of 8-bit sRGB.

    Raises OutputError when ffmpeg is missing, fails, or returns other frames than it should.
    """
    # The search for motion starts from the vectors of the frame before, and so goes back to the
    # first frame. It gets one key frame of the past, so that a frame does not depend on where a run
    # begins. Over the example that is 21.54 dB against 21.49 from the whole sequence in one go
    # (which differs from it by 50 dB), and 21.31 without the past. What comes after the interval
    # does not change it in any bit.
    shown = [to_display(before if frame is None else frame) for frame in (older, before, after)]
    height, width = shown[0].shape[:2]
    rows, columns = (max(MIN_SIDE, size + -size % BLOCK) - size for size in (height, width))
    padded = [np.pad(frame, ((0, rows), (0, columns), (0, 0)), mode="edge") for frame in shown]
    source = RAW_INPUT.format(width=width + columns, height=height + rows, rate=_RATE_IN)
    options = (*source.split(), "-vf", _MINTERPOLATE, *RAW.split(), "-")
    try:
        # It makes nothing after the last but one of its frames, so the last is repeated.
        data, _ = run_ffmpeg(options, b"".join(frame.tobytes() for frame in (*padded, padded[-1])))
    except FfmpegError as error:
        raise OutputError(
            f"cannot interpolate with minterpolate: {error}; reinstall the package "
            "imageio-ffmpeg, or leave minterpolate out"
        ) from error
    complete = len(data) // padded[0].nbytes * padded[0].nbytes
    frames = np.frombuffer(data[:complete], np.uint8).reshape(-1, *padded[0].shape)
    frames = frames[:, :height, :width]
    key = frames[FACTOR : FACTOR + 1].astype(np.int16)  # at the output rate, that at `before`
    if len(frames) < 2 * FACTOR or np.abs(key - shown[1]).max() > KEY_TOLERANCE:
        raise OutputError(
            f"cannot interpolate with minterpolate: its frames of {width}x{height} pixels are not "
            "at the instants that were asked for; reinstall the package imageio-ffmpeg, or leave "
            "minterpolate out"
        )
    return tuple(from_display(frame) for frame in frames[FACTOR + 1 : 2 * FACTOR])
