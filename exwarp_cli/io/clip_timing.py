"""What ffmpeg tells of a video's frames: times, rate, interlacing, and which are damaged."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right, insort
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from statistics import median

from exwarp_cli.io.ffmpeg import Drain, FfmpegError, run_ffmpeg

DISCARD = 4
"""ffmpeg's flag of packets that an edit list hides."""

KEY = 1
"""ffmpeg's flag of packets that decoding can start at."""

WHOLE_RATES = (8, 10, 12, 12.5, 15, 16, 18, 20, 24, 25, 30, 48, 50, 60, 90, 100, 120, 240)
"""Rates that are meant; each also 1000/1001 times as fast, as television has it."""

SNAP = 0.004
"""Share by which a measured rate may miss one that is meant."""

MOST_FRAMES = 0.9
"""Share of the frames that lie at a rate's instants where some are missing and it is meant."""


UNKNOWN_TIMES = ("NOPTS", "-9223372036854775808")
"""How ``framecrc`` writes that a packet has no time, by the version of ffmpeg."""

MOST_MISSING = 0.1
"""Share of the packets whose missing times are mended. AVI with B-frames lacks a third of them."""

MOST_REORDERED = 16
"""Frames that may be shown between a frame's decoding and its showing; H.264 buffers 16."""

UNORDERED_AHEAD = 4
"""Frames after one that it may build on, where the order of decoding is unknown, as in AVI."""

MOST_REPEATED = 0.5
"""Share of the packets whose repeated times are mended."""


FINE_TICK = 0.125
"""Frames at a rate that a tick may last so that times tell whether frames lie at its instants."""


@dataclass(frozen=True)
class Packets:
    """The packets of a video stream, one a frame, in the order in which they are shown.

    Attributes
    ----------
    times
        Of each, in ticks; empty where the file tells none, as a raw stream does. A time that is
        missing or there twice is mended by its neighbours.
    tick
        Seconds.
    keys
        Indices of those that decoding can start at, ascending.
    count
        Number of frames.
    stamps
        The times as ffmpeg sees them, not mended; a missing one is as in `times`.
    positions
        Places in the file, which is the order of decoding; () where it is that of showing, or
        unknown.
    mended
        Index of the first frame whose time is mended or ambiguous; None if there is none.
    """

    times: tuple[int, ...]
    tick: Fraction
    keys: tuple[int, ...]
    count: int
    stamps: tuple[int, ...] = ()
    mended: int | None = None
    positions: tuple[int, ...] = ()

    def time(self, index: int) -> Fraction:
        """Return when a frame is shown, in seconds; 0 where no times are known."""
        return self.times[index] * self.tick if self.times else Fraction(0)

    @property
    def least_step(self) -> Fraction:
        """Smallest time between two frames, in seconds; 0 where that is not known."""
        return min((b - a for a, b in pairwise(self.times)), default=0) * self.tick

    def index(self, time: Fraction, first: int = 0) -> int | None:
        """Return the first frame, from one on, that ffmpeg shows at a time; None without one."""
        half = max(self.least_step, self.tick) / 2
        index = bisect_left(self.stamps, (time - half) / self.tick, lo=first)
        if index == self.count or self.stamps[index] * self.tick > time + half:
            return None
        return index

    def is_decoded_before(self, index: int, later: int) -> bool:
        """Return whether a frame is decoded before one that is shown earlier."""
        return bool(self.positions) and self.positions[index] < self.positions[later]

    def last_needed(self, index: int) -> int:
        """Return the last frame in the order of showing that one may build on, or itself."""
        if not self.positions:
            return min(index + UNORDERED_AHEAD, self.count - 1)
        ahead = range(min(index + MOST_REORDERED, self.count - 1), index, -1)
        return next((i for i in ahead if self.is_decoded_before(i, index)), index)

    def cut(self, index: int) -> int | None:
        """Return the last frame, up to one, that its time identifies; None if none does.

        Past a mended time, ffmpeg may derive others than those of the file.
        """
        last = index if self.mended is None else min(index, self.mended - 1)
        return last if self.times and last >= 0 else None


@dataclass(frozen=True)
class Pacing:
    """A video at a constant frame rate.

    Attributes
    ----------
    rate
        Frames per second, exactly.
    shown
        For each instant, the index of the file's frame that is shown.
    varies
        Whether the file's own rate varies by more than its times are rounded.
    """

    rate: Fraction
    shown: tuple[int, ...]
    varies: bool = False

    @property
    def repeated(self) -> int:
        """How many frames are shown again, since the file has none at their instant."""
        return len(self.shown) - len(set(self.shown))

    @property
    def skipped(self) -> int:
        """How many of the file's frames are never shown."""
        return self.shown[-1] - self.shown[0] + 1 - len(set(self.shown)) if self.shown else 0


def read_packets(path: Path) -> Packets:
    """List the packets of a file's first video stream, without decoding.

    Raises
    ------
    FfmpegError
        When there is none, or the file cannot be read.
    """
    listed, _ = run_ffmpeg(
        ["-i", f"file:{path}", "-map", "0:V:0", "-c", "copy", "-f", "framecrc", "-"]
    )
    return parse_packets(listed.decode("ascii", "replace"))


def parse_packets(listed: str) -> Packets:
    """Read the lines of ffmpeg's format ``framecrc``; raises FfmpegError without any packet."""
    tick = Fraction(1)
    packets: list[_Packet] = []
    for line in listed.splitlines():
        if line.startswith("#tb 0:"):
            tick = Fraction(line.partition(":")[2].strip())
        elif line and not line.startswith("#"):
            packets.append(_Packet.parse(line))
    if all(packet.hidden for packet in packets):
        raise FfmpegError("it has no frames")
    return _in_order(_filled(packets), tick)


@dataclass(frozen=True)
class _Packet:
    """A line of ``framecrc``: times in ticks, None where they are missing."""

    time: int | None
    decoding: int | None
    key: bool
    hidden: bool
    sure: bool = True

    @classmethod
    def parse(cls, line: str) -> _Packet:
        fields = [field.strip() for field in line.split(",")]
        flags = next((int(f[2:], 16) for f in fields[6:] if f.startswith("F=")), KEY)
        decoding, time = (None if f in UNKNOWN_TIMES else int(f) for f in fields[1:3])
        return cls(time, decoding, bool(flags & KEY), bool(flags & DISCARD))


def _in_order(packets: list[_Packet], tick: Fraction) -> Packets:
    """Sort packets by the time of showing, without those that are not shown or not decodable."""
    shown = [packet for packet in packets if not packet.hidden]
    times = [packet.time for packet in shown if packet.time is not None]
    if len(times) < len(shown) or 1 - len(set(times)) / len(times) > MOST_REPEATED:
        return Packets((), tick, (), len(shown))
    # What is shown before the first key frame needs frames that were cut away. That key frame may
    # itself be hidden: a clip trimmed without re-encoding starts inside a group of pictures.
    start = next((p.time for p in packets if p.key and p.time is not None), min(times))
    order = sorted(
        (p.time, place) for place, p in enumerate(shown) if p.time is not None and p.time >= start
    )
    keys = tuple(index for index, (_, place) in enumerate(order) if shown[place].key)
    stamps = tuple(time for time, _ in order)
    apart = tuple(_apart(stamps))
    unsure = (
        index
        for index, (_, place) in enumerate(order)
        if not shown[place].sure or stamps[index] in stamps[index + 1 : index + 2]
    )
    positions = tuple(place for _, place in order)
    return Packets(apart, tick, keys, len(order), stamps, next(unsure, None), positions)


def _filled(packets: list[_Packet]) -> list[_Packet]:
    """Put the few packets that lack a time into the gaps that they left."""
    known = sorted(p.time for p in packets if p.time is not None and not p.hidden)
    missing = sum(p.time is None for p in packets)
    if not missing or len(known) < 2 or missing > MOST_MISSING * len(packets):
        return packets
    step = _usual_step(known)
    filled: list[_Packet] = []
    for packet in packets:
        if packet.time is None:
            time = _gap(known, step, packet.decoding) if filled else known[0] - step
            insort(known, time)
            packet = replace(packet, time=time, sure=False)
        filled.append(packet)
    return filled


def _gap(known: Sequence[int], step: int, decoding: int | None) -> int:
    """Return the first free time that is not before the time of decoding."""
    earliest = known[0] if decoding is None else decoding - step // 2
    latest = earliest + MOST_REORDERED * step
    free = (a + step for a, b in pairwise(known) if 2 * (b - a) >= 3 * step)
    ends = (known[0] - step, known[-1] + step)
    between = (time for time in free if earliest <= time <= latest)
    return next(between, ends[0] if ends[0] >= earliest else ends[1])


def _apart(times: Sequence[int]) -> list[int]:
    """Spread equal times over the larger gap beside them; times ascend."""
    spread = list(times)
    first = 0
    while first < len(times):
        stop = bisect_right(times, times[first])
        count = stop - first
        if count > 1:
            time, step = times[first], _usual_step(times)
            before = time - times[first - 1] if first else 0
            after = times[stop] - time if stop < len(times) else step * count
            if stop == len(times) and 2 * before >= 3 * step:
                after = 0  # the gap before the last ones shows where one belongs
            for place in range(1, count):
                if after >= before:
                    spread[first + place] = time + after * place // count
                else:
                    spread[stop - 1 - place] = time - before * place // count
        first = stop
    return spread


def _usual_step(times: Sequence[int]) -> int:
    """Return the median time between two frames, in ticks."""
    return round(median([b - a for a, b in pairwise(times) if b > a] or [1]))


def pace(packets: Packets, said: Fraction | None) -> Pacing:
    """Find the constant rate of a video.

    Parameters
    ----------
    packets
        Its packets.
    said
        The rate that its header has; None where it has none.

    Returns
    -------
    Pacing
        Where every frame lies nearest to an instant of its own at some rate, frames are taken one
        by one. Else, as phones drop frames in the dark, the rate is that of most frames, and each
        instant shows the frame that is there by then.
    """
    usual = said if said is not None and said > 0 else Fraction(30)
    if packets.count < 2 or not packets.times:
        return Pacing(usual, tuple(range(packets.count)))
    seconds = [(time - packets.times[0]) * packets.tick for time in packets.times]
    mean = (len(seconds) - 1) / seconds[-1]
    steps = sorted(b - a for a, b in pairwise(seconds) if b > a)
    most = 1 / median(steps)
    every = tuple(range(packets.count))
    standard = (usual,) if usual in _STANDARD else ()
    for rate in (*standard, meant(mean), usual, meant(most), mean):
        away = max(abs(time * rate - place) for place, time in enumerate(seconds))
        if away <= packets.tick * rate:
            return Pacing(rate, every)
    # Where the rate varies, a header has a mean that stands for nothing: 29.83 of a phone's 30.
    likely = _standard_near(most, packets.tick)
    # A mean far off that of most frames tells of frames that are missing, or too many.
    drifting = (meant(mean), mean.limit_denominator(1001)) if _near(mean, most) else ()
    nearest = sorted(likely, key=lambda rate: abs(rate - mean))
    for rate in (*standard, *nearest, meant(most), *drifting):
        if all(abs(time * rate - place) < Fraction(1, 2) for place, time in enumerate(seconds)):
            return Pacing(rate, every, varies=True)
    # With half of the frames missing, only the shorter steps are those of the rate.
    short = _standard_near(1 / steps[len(steps) // 10], packets.tick)
    fine = [rate for rate in short if packets.tick * rate <= FINE_TICK]
    rate = (
        _rate_of_most(seconds, packets.tick, likely)
        or _rate_of_most(seconds, packets.tick, fine)
        or meant(most)
    )
    instants = range(round(seconds[-1] * rate) + 1)
    half = 1 / (2 * rate)
    shown = tuple(bisect_right(seconds, place / rate + half) - 1 for place in instants)
    return Pacing(rate, shown, varies=True)


def meant(rate: Fraction) -> Fraction:
    """Return the usual rate that a measured one is near to, else the rate itself, simplified."""
    best = min(_STANDARD, key=lambda usual: abs(usual - rate))
    return best if _near(best, rate) else rate.limit_denominator(1001)


def _standard_near(rate: Fraction, tick: Fraction) -> list[Fraction]:
    """Return the standard rates that one which is measured in so many ticks may stand for.

    Times in milliseconds have a median of 42 at 24 fps, which would be 23.8.
    """
    return [one for one in _STANDARD if abs(one - rate) <= (SNAP + tick * rate) * one]


def _rate_of_most(
    seconds: Sequence[Fraction], tick: Fraction, rates: Sequence[Fraction]
) -> Fraction | None:
    """Return the rate at whose instants nearly all frames lie; None without such a one."""

    def share(rate: Fraction) -> float:
        places = (time * rate for time in seconds)
        return sum(abs(p - round(p)) <= tick * rate for p in places) / len(seconds)

    best = max(rates, key=share, default=None)
    return best if best is not None and share(best) >= MOST_FRAMES else None


def _near(one: Fraction, other: Fraction) -> bool:
    return abs(one - other) <= SNAP * other


_STANDARD = tuple(
    Fraction(whole) * scale
    for whole in WHOLE_RATES
    for scale in (Fraction(1), Fraction(1000, 1001))
)


EVERY_FRAME = 300
"""Up to as many frames are all looked at for fields; of longer videos the key frames are."""

LATER_LOOKS = 8
"""Instants of a long video without other frames than key frames that are looked at, too."""


def first_interlaced(path: Path, packets: Packets, indexed: bool) -> Fraction | None:
    """Return when an interlaced frame is shown, in seconds; None if none is seen.

    All frames of a short video are looked at. Of a long one the key frames are, as what has other
    fields begins with one; where all are key frames, the first ones and some later ones.
    """
    since = Fraction(0)
    looks: list[tuple[Fraction, tuple[str, ...], tuple[str, ...]]]
    if packets.count <= EVERY_FRAME:
        looks = [(since, (), ())]
    elif 2 * len(packets.keys) <= packets.count:
        looks = [(since, ("-skip_frame", "nokey"), ())]
    else:
        looks = [(since, (), ("-frames:v", str(EVERY_FRAME)))]
        if indexed and packets.times:
            step = packets.count // LATER_LOOKS
            instants = [packets.time(step * (look + 1) - 1) for look in range(LATER_LOOKS)]
            looks += [(t, ("-ss", f"{float(t):.6f}"), ("-frames:v", "1")) for t in instants]
    for since, reading, writing in looks:
        try:
            said = frame_info(path, *writing, decoder=reading)
        except FfmpegError:
            continue  # what is damaged is named when it is read
        fields = re.search(r"showinfo.* pts_time:(-?[\d.]+) .* i:[TB] ", said)
        if fields is not None:
            return max(since or Fraction(fields[1]) - packets.time(0), Fraction(0))
    return None


def frame_info(path: Path, *options: str, decoder: tuple[str, ...] = ()) -> str:
    """Return what ffmpeg says of a file and of frames."""
    source = ["-v", "info", "-hide_banner", *decoder, "-i", f"file:{path}", "-map", "0:V:0"]
    _, said = run_ffmpeg([*source, *options, "-vf", "showinfo=checksum=0", "-f", "null", "-"])
    return said


ON_DAMAGE = (
    *("-v", "info", "-hide_banner", "-nostats", "-debug_ts", "-max_error_rate", "1"),
    *("-fflags", "+discardcorrupt", "-noaccurate_seek"),
)
"""Input options that make ffmpeg decode on over damage and print each frame that it decodes."""

IN_ORDER = ("-thread_type", "slice")
"""Input options that make ffmpeg decode one frame after the other.

Frames that are decoded at once may be handed out before damage in them is noticed.
"""

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
