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

from exwarp_cli.domain import cores
from exwarp_cli.domain.frame import UInt8
from exwarp_cli.io.atomic import Held
from exwarp_cli.runtime.stop import check_stop, cleaned_up

RAW = "-f rawvideo -pix_fmt rgb24"
"""What names frames as bytes: uint8 [H, W, 3], one after the other."""

RAW_INPUT = RAW + " -s {width}x{height} -r {rate} -i -"
"""Options that make ffmpeg read such frames."""


EXACT = "flags=accurate_rnd+full_chroma_int"
"""Of the filter ``scale``: without them colours are off by more than rounding."""

TO_VIDEO = f"scale=out_color_matrix=bt709:out_range=tv:{EXACT}"
"""Turns sRGB into what players and VMAF take: ffmpeg's own matrix is standard definition's."""


class FfmpegError(Exception):
    """ffmpeg failed; the text quotes its last line, or tells what kept it from starting.

    Not an error for users: who feeds ffmpeg says what it was for, and what to do.
    """


def filtered(options: Sequence[str], data: bytes) -> bytes:
    """Run ffmpeg on data that fits in memory, and return what it writes.

    Parameters
    ----------
    options
        Without the program's name; they read from and write to ``-``.
    data
        What it reads.

    Raises
    ------
    FfmpegError
        When ffmpeg does not start, or fails.
    """
    try:
        # As for `Feed`, Ctrl-C is for us to answer: leaving `run` ends ffmpeg.
        done = subprocess.run(
            _command(options), input=data, capture_output=True, check=False, process_group=0
        )
    except (OSError, RuntimeError) as error:
        raise _no_start(error) from error
    if done.returncode:
        raise _ended(done.stderr, done.returncode)
    return done.stdout


def run_ffmpeg(options: Sequence[str]) -> tuple[bytes, str]:
    """Run ffmpeg without input from here, and return what it writes and what it says.

    Parameters
    ----------
    options
        Without the program's name; they write to ``-``. What ffmpeg reads is closed.

    Raises
    ------
    FfmpegError
        When ffmpeg does not start, or fails.
    """
    try:
        done = subprocess.run(
            _command(("-nostdin", *options)), capture_output=True, check=False, process_group=0
        )
    except (OSError, RuntimeError) as error:
        raise _no_start(error) from error
    if done.returncode:
        raise _ended(done.stderr, done.returncode)
    return done.stdout, done.stderr.decode("utf-8", "replace")


class Drain(Held):
    """One run of ffmpeg whose output is read here; a context manager.

    Left before the end, it ends ffmpeg.

    Parameters
    ----------
    options
        Without the program's name; they write to ``-``.

    Raises
    ------
    FfmpegError
        When ffmpeg does not start.
    """

    def __init__(self, options: Sequence[str]) -> None:
        self._options = options

    def _open(self, stack: ExitStack) -> None:
        log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - the stack closes it
        self._log = stack.enter_context(log)
        self._listened, self._unfinished = 0, b""
        try:
            self._ffmpeg = subprocess.Popen(
                _command(("-nostdin", *self._options)),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=self._log,
                process_group=0,
            )
        except (OSError, RuntimeError) as error:
            raise _no_start(error) from error
        stack.callback(self._kill)

    def read(self, size: int) -> bytes | None:
        """Return the next `size` bytes; None at the end, or where fewer are left.

        Raises
        ------
        FfmpegError
            When ffmpeg failed.
        StopRequested
            When this process was asked to stop.
        """
        check_stop()
        assert self._ffmpeg.stdout is not None
        data = self._ffmpeg.stdout.read(size)
        if len(data) == size:
            return data
        if self._ffmpeg.wait() != 0:
            self._log.seek(0)
            raise _ended(self._log.read(), self._ffmpeg.returncode)
        return None

    def messages(self) -> list[str]:
        """Return the complete lines that ffmpeg printed since the last call."""
        # ffmpeg shares the file's position, so it is not moved here.
        log, text = self._log.fileno(), self._unfinished
        while more := os.pread(log, 1 << 16, self._listened):
            self._listened += len(more)
            text += more
        *lines, self._unfinished = text.split(b"\n")
        return [line.decode("utf-8", "replace") for line in lines]

    def _kill(self) -> None:
        if self._ffmpeg.poll() is None:
            self._ffmpeg.kill()
        if self._ffmpeg.stdout is not None:
            self._ffmpeg.stdout.close()
        self._ffmpeg.wait()


class Feed(Held):
    """One run of ffmpeg that reads frames from here; a context manager.

    Left without `close`, by an error for example, it ends ffmpeg.

    Parameters
    ----------
    options
        Without the program's name.
    folder
        Where it runs; None for here.

    Raises
    ------
    FfmpegError
        When ffmpeg does not start.
    """

    def __init__(self, options: Sequence[str], folder: Path | None = None) -> None:
        self._options = options
        self._folder = folder

    def _open(self, stack: ExitStack) -> None:
        log: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - the stack closes it
        self._log = stack.enter_context(log)
        try:
            self._ffmpeg = subprocess.Popen(
                _command(self._options),
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=self._log,
                cwd=self._folder,
                process_group=0,  # Ctrl-C is for us to answer; ffmpeg then ends with us
            )
        except (OSError, RuntimeError) as error:
            raise _no_start(error) from error
        stack.enter_context(cleaned_up(self._kill))

    def write(self, frame: UInt8) -> None:
        """Send a frame, uint8 [H, W, 3]; raises FfmpegError."""
        assert self._ffmpeg.stdin is not None
        try:
            self._ffmpeg.stdin.write(np.ascontiguousarray(frame).data)
        except OSError as error:  # a broken pipe; why ffmpeg left stands in what it printed
            raise self._failure() from error

    def close(self) -> None:
        """Say that there are no more frames, and wait for the end; raises FfmpegError."""
        assert self._ffmpeg.stdin is not None
        try:
            self._ffmpeg.stdin.close()
        except OSError as error:
            raise self._failure() from error
        if self._ffmpeg.wait() != 0:
            raise self._failure()

    def _failure(self) -> FfmpegError:
        self._kill()
        self._log.seek(0)
        return _ended(self._log.read(), self._ffmpeg.returncode)

    def _kill(self) -> None:
        if self._ffmpeg.poll() is None:
            self._ffmpeg.kill()
        self._ffmpeg.wait()
        if self._ffmpeg.stdin is not None and not self._ffmpeg.stdin.closed:
            with suppress(OSError):  # what was buffered has no reader any more
                self._ffmpeg.stdin.close()


def even(frame: UInt8) -> UInt8:
    """Repeat the last row and column of uint8 [H, W, 3] where their number is odd.

    4:2:0 video has even sizes only.
    """
    height, width, _ = frame.shape
    if not (height % 2 or width % 2):
        return frame
    return np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _command(options: Sequence[str]) -> list[str]:
    """Return a command line: filters, and who decodes the first input, have our threads.

    An encoder keeps its own number, since its bytes go by that.
    """
    count = str(cores.count())
    bounds = ("-filter_threads", count, "-filter_complex_threads", count, "-threads", count)
    return [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-y", *bounds, *options]


def _no_start(error: Exception) -> FfmpegError:
    return FfmpegError(f"ffmpeg does not start ({error})")


def _ended(log: bytes, status: int) -> FfmpegError:
    """Quote the last line of what ffmpeg printed."""
    lines = log.decode("utf-8", "replace").strip().splitlines()
    if not lines:
        return FfmpegError(f"ffmpeg ends with status {status}")
    said = re.sub(r"^(\[[^\]]*\] )+", "", lines[-1].strip())  # [vist#0:0/h264 @ 0x55…] [dec:h264 …]
    return FfmpegError(f"ffmpeg says {said!r}")
