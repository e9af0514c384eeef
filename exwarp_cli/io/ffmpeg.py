"""Running ffmpeg, the one that imageio-ffmpeg ships, on raw frames.

It is started here, not by that package's ``write_frames``, because that drops the exit status and
so takes a full disk for success.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import IO

import imageio_ffmpeg
import numpy as np

from exwarp_cli.io.display_colour import Codes
from exwarp_cli.io.files import ResourceOwner
from exwarp_cli.runtime import cores
from exwarp_cli.runtime.stop import check_stop, clean_up_after

RAW = "-f rawvideo -pix_fmt rgb24"  # names frames as bytes: uint8 [H, W, 3], one after the other

# Options that make ffmpeg read such frames, or those of uint16.
RAW_INPUT = RAW + " -s {width}x{height} -r {rate} -i -"
RAW_INPUT_16 = RAW_INPUT.replace("rgb24", "rgb48")

# Of the filter ``scale``: without them colours are off by more than rounding.
EXACT_SCALING = "flags=accurate_rnd+full_chroma_int"


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


class _FfmpegStream(ResourceOwner):
    """One run of ffmpeg beside this process; a context manager that ends it."""

    def __init__(self, options: Sequence[str], folder: Path | None = None) -> None:
        self._options, self._folder = options, folder

    def _start(self, stack: ExitStack, stdin: int, stdout: int) -> None:
        log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - the stack closes it
        self._log = stack.enter_context(log)
        try:
            self._process = subprocess.Popen(
                _command(self._options),
                stdin=stdin,
                stdout=stdout,
                stderr=self._log,
                cwd=self._folder,
                process_group=0,
            )
        except (OSError, RuntimeError) as error:
            raise FfmpegError(f"ffmpeg does not start ({error})") from error

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


class FfmpegReader(_FfmpegStream):
    """One run of ffmpeg whose output, written to ``-``, is read here; a context manager.

    Left before the end, it ends ffmpeg. Raises FfmpegError when ffmpeg does not start.
    """

    def _open(self, stack: ExitStack) -> None:
        self._log_position, self._incomplete_line = 0, b""
        self._options = ("-nostdin", *self._options)
        self._start(stack, subprocess.DEVNULL, subprocess.PIPE)
        assert self._process.stdout is not None
        stack.enter_context(self._process.stdout)
        stack.callback(self._kill)

    def read(self, size: int) -> bytes | None:
        """Return the next `size` bytes; None at the end, or where fewer are left.

        Raises FfmpegError when ffmpeg failed. Raises StopRequested when this process was asked to
        stop.
        """
        check_stop()
        assert self._process.stdout is not None
        data = self._process.stdout.read(size)
        if len(data) == size:
            return data
        if self._process.wait() != 0:
            raise self._error()
        return None

    def messages(self) -> list[str]:
        """Return the complete lines that ffmpeg printed since the last call."""
        # ffmpeg shares the file's position, so it is not moved here.
        log, text = self._log.fileno(), self._incomplete_line
        while more := os.pread(log, 1 << 16, self._log_position):
            self._log_position += len(more)
            text += more
        *lines, self._incomplete_line = text.split(b"\n")
        return [line.decode("utf-8", "replace") for line in lines]


class FfmpegWriter(_FfmpegStream):
    """One run of ffmpeg, in a folder, that reads frames from here; a context manager.

    Left without `close`, by an error for example, it ends ffmpeg. Raises FfmpegError when ffmpeg
    does not start.
    """

    def _open(self, stack: ExitStack) -> None:
        self._start(stack, subprocess.PIPE, subprocess.DEVNULL)
        stack.enter_context(clean_up_after(self._kill))

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
