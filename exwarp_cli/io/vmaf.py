"""VMAF, by the libvmaf of the ffmpeg that imageio-ffmpeg ships.

Li, Aaron, Katsavounidis, Moorthy, Manohara, "Toward A Practical Perceptual Video Quality Metric",
Netflix Technology Blog, 2016; model vmaf_v0.6.1, made for 1080p seen from three times the screen's
height. It looks at luma alone. Of its features one is temporal: how much the *reference* moves, the
smaller of the differences to the frames before and after. So a frame's score depends on its own
pair and on the reference's neighbours, and on nothing else.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from exwarp_cli.domain.frame import UInt8
from exwarp_cli.errors import InputError, LayoutError
from exwarp_cli.io.atomic import Held
from exwarp_cli.io.ffmpeg import RAW_INPUT, TO_VIDEO, Feed, FfmpegError, even
from exwarp_cli.runtime.stop import scratch_folder

LEAST = 17
"""Fewest rows and columns: with fewer libvmaf crashes."""

RATE = 60
"""Frames per second of the streams. VMAF does not know of it; an encoder's rate control does."""

_VMAF = "libvmaf=model=version=vmaf_v0.6.1:log_fmt=json:log_path=scores.json"
"""The log's path is relative: other characters in it would have to be escaped twice."""

PUBLISHED = "-c:v libx264 -preset veryslow -crf 16 -pix_fmt yuv420p"
"""How ExtraNet's release makes the videos that VMAF is taken of."""


def require_size(height: int, width: int, what: str) -> None:
    """Refuse frames that VMAF cannot be taken of; raises LayoutError."""
    if min(height, width) < LEAST:
        raise LayoutError(
            f"{what} is {width}x{height}, and VMAF needs {LEAST} pixels each way; leave vmaf out "
            "of --metrics"
        )


def vmaf(reference: Iterable[UInt8], test: Iterable[UInt8]) -> list[float]:
    """Score a sequence of frames.

    Parameters
    ----------
    reference, test
        uint8 [H, W, 3], display-encoded (`exwarp_cli.io.video.to_display`), successive frames of
        one size, equally many of both; at least one. They are taken one pair at a time.

    Returns
    -------
    list of float
        One a frame, 0 to 100. Equal frames have less than 100 where the reference hardly moves.

    Raises
    ------
    InputError
        When ffmpeg is missing or fails; LayoutError for frames below `LEAST` pixels.
    """
    with Vmaf() as stream:
        for pair in zip(reference, test, strict=True):
            stream.write(*pair)
        return stream.close()


class Vmaf(Held):
    """The same for frames as they come; a context manager.

    Both frames of a pair go to ffmpeg as one picture, the reference above, and are cut apart there:
    one stream cannot wait for the other.
    """

    def __init__(self) -> None:
        self._feed: Feed | None = None
        self._folder = Path()

    def _open(self, stack: ExitStack) -> None:
        self._folder = stack.enter_context(scratch_folder())

    def write(self, reference: UInt8, test: UInt8) -> None:
        """Append a pair of frames; see `vmaf`."""
        try:
            if self._feed is None:
                height, width, _ = reference.shape
                require_size(height, width, "the frame")
                self._feed = self._stack.enter_context(self._start(height, width))
            self._feed.write(np.concatenate([reference, test]))
        except FfmpegError as error:
            raise _failure(error) from error

    def close(self) -> list[float]:
        """Return the scores of all frames."""
        if self._feed is None:
            return []
        try:
            self._feed.close()
        except FfmpegError as error:
            raise _failure(error) from error
        return _scores(self._folder)

    def _start(self, height: int, width: int) -> Feed:
        # Equal time stamps, whatever the filters before did: pairs must not slip.
        graph = (
            f"[0:v]split[x][y];[x]crop={width}:{height}:0:0,{TO_VIDEO},format=yuv444p,setpts=N[r];"
            f"[y]crop={width}:{height}:0:{height},{TO_VIDEO},format=yuv444p,setpts=N[t];"
            f"[t][r]{_VMAF}"
        )
        source = RAW_INPUT.format(width=width, height=2 * height, rate=RATE)
        options = (*source.split(), "-filter_complex", graph, "-f", "null", "-")
        return Feed(options, self._folder)


class EncodedVmaf(Held):
    """VMAF of two videos in H.264 as ExtraNet's release makes them; used as `Vmaf` is.

    Odd sizes are padded by repeating the last column or row, as 4:2:0 has even ones only.
    """

    def __init__(self) -> None:
        self._feeds: tuple[Feed, ...] = ()
        self._folder = Path()

    def _open(self, stack: ExitStack) -> None:
        self._folder = stack.enter_context(scratch_folder())

    def write(self, reference: UInt8, test: UInt8) -> None:
        """Append a pair of frames; see `vmaf`."""
        pair = (even(reference), even(test))
        try:
            if not self._feeds:
                require_size(reference.shape[0], reference.shape[1], "the frame")
                height, width, _ = pair[0].shape
                source = RAW_INPUT.format(width=width, height=height, rate=RATE)
                self._feeds = tuple(
                    self._stack.enter_context(
                        Feed((*source.split(), *PUBLISHED.split(), name), self._folder)
                    )
                    for name in ("reference.mp4", "test.mp4")
                )
            for feed, frame in zip(self._feeds, pair, strict=True):
                feed.write(frame)
        except FfmpegError as error:
            raise _failure(error) from error

    def close(self) -> list[float]:
        """Return the scores of all frames."""
        if not self._feeds:
            return []
        graph = f"[0:v]setpts=N[r];[1:v]setpts=N[t];[t][r]{_VMAF}"
        videos = ["-i", "reference.mp4", "-i", "test.mp4", "-filter_complex"]
        try:
            for feed in self._feeds:
                feed.close()
            with Feed((*videos, graph, "-f", "null", "-"), self._folder) as comparing:
                comparing.close()
        except FfmpegError as error:
            raise _failure(error) from error
        return _scores(self._folder)


def _scores(folder: Path) -> list[float]:
    log = json.loads((folder / "scores.json").read_text(encoding="utf-8"))
    return [float(frame["metrics"]["vmaf"]) for frame in log["frames"]]


def _failure(error: FfmpegError) -> InputError:
    return InputError(
        f"cannot take VMAF: {error}; reinstall the package imageio-ffmpeg, or leave "
        "vmaf out of --metrics"
    )
