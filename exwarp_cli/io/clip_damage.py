"""Which frames of a damaged video are intact, by what ffmpeg prints while it decodes."""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from exwarp_cli.io.clip_timing import Packets
from exwarp_cli.io.ffmpeg import Drain, FfmpegError

ON_DAMAGE = (
    *("-v", "info", "-hide_banner", "-nostats", "-debug_ts", "-max_error_rate", "1"),
    *("-fflags", "+discardcorrupt", "-noaccurate_seek"),
)
"""Input options that make ffmpeg decode on over damage and print each frame that it decodes."""

_B_FRAME = "3"
_CORRUPT = "corrupt decoded frame"  # printed before the line of its frame, by the same thread
_DECODED = re.compile(
    r"decoder -> (?:.*best_effort_ts:|pts:)(-?\d+) "
    r".*keyframe:(\d) .*frame_type:(\d) .*time_base:(\d+/\d+)"
)


@dataclass(frozen=True)
class _Decoded:
    """A frame that was decoded: seconds from where decoding begins, and its state."""

    time: Fraction
    key: bool
    corrupt: bool
    both_ways: bool


def intact_frames(
    ffmpeg: Drain, size: int, packets: Packets, begin: int, rate: Fraction
) -> Iterator[tuple[int, bytes]]:
    """Yield the frames that damage does not affect, with their indices in the file.

    A frame that is corrupt or missing makes those after it unusable up to the next key frame.

    Parameters
    ----------
    ffmpeg
        Decodes with the options `ON_DAMAGE` and writes every frame.
    size
        Bytes of a frame.
    packets
        Of the file.
    begin
        Index of the frame whose time is ffmpeg's 0; 0 for the start of the file.
    rate
        Frames per second, where the packets have no times.
    """
    expected, usable, zero = begin, True, None
    held = _Held(packets)
    for frame, data in _decoded(ffmpeg, size):
        zero = frame.time if zero is None else zero
        if packets.times:
            origin = packets.time(begin) if begin else Fraction(0)
            index = packets.index(frame.time + origin, expected)
        else:
            index = round((frame.time - zero) * rate)
        if index is None or index < expected:
            continue  # shown before what was asked for
        held.drop(range(expected, index + frame.corrupt))
        usable = not frame.corrupt and (frame.key or (usable and index == expected))
        expected = index + 1
        if usable:
            held.append(index, data, frame.both_ways)
        yield from held.settled(index, frame.both_ways)
    held.drop(range(expected, packets.count))
    yield from held.frames


class _Held:
    """Intact frames that wait, as they may build on frames that are shown after them."""

    def __init__(self, packets: Packets) -> None:
        self._packets = packets
        self._needs: deque[int | None] = deque()
        self.frames: deque[tuple[int, bytes]] = deque()

    def append(self, index: int, data: bytes, both_ways: bool) -> None:
        """Hold a frame back; without times, a B-frame waits for the next one that is none."""
        needed = None if both_ways else index
        self._needs.append(self._packets.last_needed(index) if self._packets.times else needed)
        self.frames.append((index, data))

    def drop(self, damaged: range) -> None:
        """Leave out the frames that may build on damaged ones."""
        kept = [
            (needed, frame)
            for needed, frame in zip(self._needs, self.frames, strict=True)
            if not any(self._builds_on(frame[0], needed, index) for index in damaged)
        ]
        self._needs = deque(needed for needed, _ in kept)
        self.frames = deque(frame for _, frame in kept)

    def settled(self, index: int, both_ways: bool) -> Iterator[tuple[int, bytes]]:
        """Yield the frames that build on no frame after one."""
        while self.frames:
            needed = self._needs[0]
            if both_ways if needed is None else needed > index:
                return
            self._needs.popleft()
            yield self.frames.popleft()

    def _builds_on(self, index: int, needed: int | None, damaged: int) -> bool:
        return needed is None or self._packets.is_decoded_before(damaged, index)


def _decoded(ffmpeg: Drain, size: int) -> Iterator[tuple[_Decoded, bytes]]:
    """Yield each decoded frame with its state, up to where decoding fails for good."""
    decoded: deque[_Decoded] = deque()
    corrupt = False
    while True:
        try:
            data = ffmpeg.read(size)
        except FfmpegError:
            return
        for line in ffmpeg.messages():
            match = _DECODED.search(line)
            if match is not None:
                time = int(match[1]) * Fraction(match[4])
                decoded.append(_Decoded(time, match[2] != "0", corrupt, match[3] == _B_FRAME))
                corrupt = False
            elif _CORRUPT in line:
                corrupt = True
        if data is None or not decoded:
            return
        yield decoded.popleft(), data
