"""The frames of a video as ffmpeg reports them: times, rate, interlacing, and damage."""

from __future__ import annotations

import re
from bisect import bisect_left, bisect_right, insort
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from statistics import median

from exwarp_cli.io.ffmpeg import FfmpegError, FfmpegReader, run_ffmpeg

KEY, DISCARD = 1, 4  # ffmpeg's flags of packets: decoding can start at it; an edit list hides it

# Rates that are meant; each also 1000/1001 times as fast, as television has it.
WHOLE_RATES = (8, 10, 12, 12.5, 15, 16, 18, 20, 24, 25, 30, 48, 50, 60, 90, 100, 120, 240)
_STANDARD_RATES = tuple(
    Fraction(rate) * scale for rate in WHOLE_RATES for scale in (Fraction(1), Fraction(1000, 1001))
)

SNAP = 0.004  # share by which a measured rate may miss one that is meant

# Share of the frames that lie at a rate's instants where some are missing and it is meant.
MIN_AT_INSTANTS = 0.9

# Frames at a rate that a tick may last so that times show whether frames lie at its instants.
FINE_TICK = 0.125

# How ``framecrc`` writes that a packet has no time, by the version of ffmpeg.
UNKNOWN_TIMES = ("NOPTS", "-9223372036854775808")

# Share of the packets whose missing times are mended. AVI with B-frames lacks a third of them.
MAX_MISSING = 0.1
MAX_REPEATED = 0.5  # share of the packets whose repeated times are mended

# Frames that may be shown between a frame's decoding and its showing; H.264 buffers 16.
MAX_REORDERED = 16

# Up to as many frames are all tested for fields; of longer videos the key frames are.
EVERY_FRAME = 300

# Instants of a long video without other frames than key frames that are tested, too.
LATER_TESTS = 8

# Input options that make ffmpeg decode on over damage and print each frame that it decodes.
ON_DAMAGE = (
    *("-v", "info", "-hide_banner", "-nostats", "-debug_ts", "-max_error_rate", "1"),
    *("-fflags", "+discardcorrupt", "-noaccurate_seek"),
)

# Input options that make ffmpeg decode one frame after the other. Frames that are decoded at once
# may be handed out before damage in them is noticed.
IN_ORDER = ("-thread_type", "slice")

_B_FRAME = "3"
_CORRUPT = "corrupt decoded frame"  # printed before the line of its frame, by the same thread
_DECODED = re.compile(
    r"decoder -> (?:.*best_effort_ts:|pts:)(-?\d+) "
    r".*keyframe:(\d) .*frame_type:(\d) .*time_base:(\d+/\d+)"
)


@dataclass(frozen=True)
class Packets:
    """The packets of a video stream, one a frame, in the order in which they are shown."""

    # Of each, in ticks; empty where the file has none, as a raw stream. A time that is missing or
    # there twice is mended by its neighbours.
    times: tuple[int, ...]
    tick: Fraction  # seconds
    keys: tuple[int, ...]  # indices of those that decoding can start at, ascending
    count: int
    # The times as ffmpeg sees them, not mended; a missing one is as in `times`
    stamps: tuple[int, ...] = ()
    # Index of the first frame whose time is mended or ambiguous; None if there is none
    mended: int | None = None
    # Places in the file, which is the order of decoding; () where no times are known
    positions: tuple[int, ...] = ()

    def time(self, index: int) -> Fraction:
        """Return when a frame is shown, in seconds; 0 where no times are known."""
        return self.times[index] * self.tick if self.times else Fraction(0)

    @cached_property
    def least_step(self) -> Fraction:
        """Smallest time between two frames, in seconds; 0 where that is not known."""
        return min((b - a for a, b in pairwise(self.times)), default=0) * self.tick

    def index(self, time: Fraction, first: int = 0) -> int | None:
        """Return the first frame, from `first` on, that ffmpeg shows at a time; None without."""
        half = max(self.least_step, self.tick) / 2
        index = bisect_left(self.stamps, (time - half) / self.tick, lo=first)
        if index == self.count or self.stamps[index] * self.tick > time + half:
            return None
        return index


@dataclass(frozen=True)
class Pacing:
    """A video at a constant frame rate."""

    rate: Fraction  # frames per second, exactly
    shown: tuple[int, ...]  # for each instant, the index of the file's frame that is shown
    varies: bool = False  # whether the file's own rate varies by more than its times are rounded

    @property
    def repeated(self) -> int:
        """How many frames are shown again, since the file has none at their instant."""
        return len(self.shown) - len(set(self.shown))

    @property
    def skipped(self) -> int:
        """How many of the file's frames are never shown."""
        return self.shown[-1] - self.shown[0] + 1 - len(set(self.shown)) if self.shown else 0


@dataclass(frozen=True)
class _Packet:
    """A line of ``framecrc``: times in ticks, None where they are missing."""

    time: int | None
    decoding: int | None
    is_key: bool
    is_hidden: bool
    is_certain: bool = True


def parse_packets(listed: str) -> Packets:
    """Read the lines of ffmpeg's format ``framecrc``; raises FfmpegError without any packet.

    Packets are sorted by the time of showing, without those that are not shown or not decodable.
    """
    tick = Fraction(1)
    packets: list[_Packet] = []
    for line in listed.splitlines():
        if line.startswith("#tb 0:"):
            tick = Fraction(line.partition(":")[2].strip())
        elif line and not line.startswith("#"):
            fields = [field.strip() for field in line.split(",")]
            flags = next((int(f[2:], 16) for f in fields[6:] if f.startswith("F=")), KEY)
            decoding, time = (None if f in UNKNOWN_TIMES else int(f) for f in fields[1:3])
            packets.append(_Packet(time, decoding, bool(flags & KEY), bool(flags & DISCARD)))
    if not packets:
        raise FfmpegError("it has no frames")
    packets = _fill_times(packets)
    shown = [packet for packet in packets if not packet.is_hidden]
    times = [packet.time for packet in shown if packet.time is not None]
    if len(times) < len(shown) or 1 - len(set(times)) / len(times) > MAX_REPEATED:
        return Packets((), tick, (), len(shown))
    # What is shown before the first key frame needs frames that were cut away. That key frame may
    # itself be hidden: a clip trimmed without re-encoding starts inside a group of pictures.
    start = next((p.time for p in packets if p.is_key and p.time is not None), min(times))
    order = sorted((time, place) for place, time in enumerate(times) if time >= start)
    stamps = tuple(time for time, _ in order)
    positions = tuple(place for _, place in order)
    keys = tuple(index for index, place in enumerate(positions) if shown[place].is_key)
    mended = (
        index
        for index, place in enumerate(positions)
        if not shown[place].is_certain or stamps[index] in stamps[index + 1 : index + 2]
    )
    spread = tuple(_spread_equal_times(stamps))
    return Packets(spread, tick, keys, len(order), stamps, next(mended, None), positions)


def _fill_times(packets: list[_Packet]) -> list[_Packet]:
    """Put the few packets that lack a time into the gaps that they left."""
    times = sorted(p.time for p in packets if p.time is not None and not p.is_hidden)
    missing = sum(p.time is None for p in packets)
    if not missing or len(times) < 2 or missing > MAX_MISSING * len(packets):
        return packets
    step = _usual_step(times)
    filled: list[_Packet] = []
    for packet in packets:
        if packet.time is None:
            time = times[0] - step
            if filled:
                # The first free time that is not before the time of decoding.
                decoding = packet.decoding
                earliest = times[0] if decoding is None else decoding - step // 2
                latest = earliest + MAX_REORDERED * step
                end = time if time >= earliest else times[-1] + step
                gaps = (a + step for a, b in pairwise(times) if 2 * (b - a) >= 3 * step)
                time = next((gap for gap in gaps if earliest <= gap <= latest), end)
            insort(times, time)
            packet = replace(packet, time=time, is_certain=False)
        filled.append(packet)
    return filled


def _spread_equal_times(times: Sequence[int]) -> list[int]:
    """Spread equal times over the larger gap beside them; times ascend."""
    spread, step = list(times), _usual_step(times)
    for time, count in Counter(times).items():
        if count > 1:
            first = bisect_left(times, time)
            stop = first + count
            before = time - times[first - 1] if first else 0
            after = times[stop] - time if stop < len(times) else step * count
            if stop == len(times) and 2 * before >= 3 * step:
                after = 0  # the gap before the last ones shows where one belongs
            for place in range(1, count):
                if after >= before:
                    spread[first + place] = time + after * place // count
                else:
                    spread[stop - 1 - place] = time - before * place // count
    return spread


def _usual_step(times: Sequence[int]) -> int:
    """Return the median time between two frames, in ticks."""
    return round(median([b - a for a, b in pairwise(times) if b > a] or [1]))


def find_pacing(packets: Packets, header_rate: Fraction | None) -> Pacing:
    """Find the constant rate of a video, also by the rate in its header, if it has one.

    Where every frame lies nearest to an instant of its own at some rate, frames are taken one by
    one. Else, as phones drop frames in the dark, the rate is that of most frames, and each instant
    shows the frame that is there by then.
    """
    default = header_rate if header_rate is not None and header_rate > 0 else Fraction(30)
    if packets.count < 2 or not packets.times:
        return Pacing(default, tuple(range(packets.count)))
    tick = packets.tick
    seconds = [(time - packets.times[0]) * tick for time in packets.times]
    mean = (len(seconds) - 1) / seconds[-1]
    steps = sorted(b - a for a, b in pairwise(seconds) if b > a)
    typical = 1 / median(steps)
    every = tuple(range(packets.count))
    standard = (default,) if default in _STANDARD_RATES else ()
    candidates = (nearest_standard_rate(mean), default, nearest_standard_rate(typical), mean)
    for rate in (*standard, *candidates):
        distance = max(abs(time * rate - place) for place, time in enumerate(seconds))
        if distance <= tick * rate:
            return Pacing(rate, every)
    # Where the rate varies, a header has a mean that stands for nothing: 29.83 of a phone's 30.
    likely = _standard_rates_near(typical, tick)
    # A mean far off that of most frames shows that frames are missing, or too many.
    means = (nearest_standard_rate(mean), mean.limit_denominator(1001))
    drifting = means if abs(mean - typical) <= SNAP * typical else ()
    nearest = sorted(likely, key=lambda rate: abs(rate - mean))
    for rate in (*standard, *nearest, nearest_standard_rate(typical), *drifting):
        if all(abs(time * rate - place) < Fraction(1, 2) for place, time in enumerate(seconds)):
            return Pacing(rate, every, varies=True)
    # With half of the frames missing, only the shorter steps are those of the rate.
    short = _standard_rates_near(1 / steps[len(steps) // 10], tick)
    fine = [rate for rate in short if tick * rate <= FINE_TICK]
    rate = nearest_standard_rate(typical)
    for rates in (likely, fine):
        shares = [
            sum(abs(time * rate - round(time * rate)) <= tick * rate for time in seconds)
            / len(seconds)
            for rate in rates
        ]
        if max(shares, default=0) >= MIN_AT_INSTANTS:
            rate = rates[shares.index(max(shares))]
            break
    instants = range(round(seconds[-1] * rate) + 1)
    half = 1 / (2 * rate)
    shown = tuple(bisect_right(seconds, place / rate + half) - 1 for place in instants)
    return Pacing(rate, shown, varies=True)


def nearest_standard_rate(rate: Fraction) -> Fraction:
    """Return the standard rate that a measured one is near to, else the rate itself, simplified."""
    best = min(_STANDARD_RATES, key=lambda standard: abs(standard - rate))
    return best if abs(best - rate) <= SNAP * rate else rate.limit_denominator(1001)


def _standard_rates_near(rate: Fraction, tick: Fraction) -> list[Fraction]:
    # Times in milliseconds have a median of 42 at 24 fps, which would be 23.8.
    tolerance = SNAP + tick * rate
    return [s for s in _STANDARD_RATES if abs(s - rate) <= tolerance * s]


def first_interlaced(path: Path, packets: Packets, is_indexed: bool) -> Fraction | None:
    """Return when an interlaced frame is shown, in seconds; None if none is found.

    All frames of a short video are tested. Of a long one the key frames are, as other fields begin
    with one; where all are key frames, the first ones and some later ones.
    """
    # Start, options to read and options to write of each test.
    tests: list[tuple[Fraction, tuple[str, ...], tuple[str, ...]]]
    zero = Fraction(0)
    if packets.count <= EVERY_FRAME:
        tests = [(zero, (), ())]
    elif 2 * len(packets.keys) <= packets.count:
        tests = [(zero, ("-skip_frame", "nokey"), ())]
    else:
        tests = [(zero, (), ("-frames:v", str(EVERY_FRAME)))]
        if is_indexed and packets.times:
            step = packets.count // LATER_TESTS
            for index in range(step - 1, step * LATER_TESTS, step):
                time = packets.time(index)
                tests.append((time, ("-ss", f"{float(time):.6f}"), ("-frames:v", "1")))
    for start, reading, writing in tests:
        try:
            info = frame_info(path, *writing, input_options=reading)
        except FfmpegError:
            continue  # damage is reported when it is read
        fields = re.search(r"showinfo.* pts_time:(-?[\d.]+) .* i:[TB] ", info)
        if fields is not None:
            return max(start or Fraction(fields[1]) - packets.time(0), zero)
    return None


def frame_info(path: Path, *options: str, input_options: tuple[str, ...] = ()) -> str:
    """Return what ffmpeg prints about a file and about its frames."""
    source = ["-v", "info", "-hide_banner", *input_options, "-i", f"file:{path}", "-map", "0:V:0"]
    _, info = run_ffmpeg([*source, *options, "-vf", "showinfo=checksum=0", "-f", "null", "-"])
    return info


def intact_frames(
    ffmpeg: FfmpegReader, packets: Packets, begin: int, rate: Fraction
) -> Iterator[tuple[int, bytes]]:
    """Yield the frames that damage does not affect, with their indices in the file.

    A frame that is corrupt or missing makes those after it unusable up to the next key frame.

    `ffmpeg` decodes with the options `ON_DAMAGE` and writes every frame. `begin` is the index of
    the frame whose time is ffmpeg's 0; 0 for the start of the file. `rate` counts where the packets
    have no times.
    """
    expected, is_usable, zero, places = begin, True, None, packets.positions
    # Frames that may build on frames shown after them: index, bytes, and the last frame that each
    # may build on. Without times a B-frame has None there: it waits for the next that is none.
    waiting: deque[tuple[int, bytes, int | None]] = deque()
    for time, is_key, is_corrupt, is_b_frame, data in _decoded_frames(ffmpeg):
        zero = time if zero is None else zero
        if packets.times:
            origin = packets.time(begin) if begin else Fraction(0)
            index = packets.index(time + origin, expected)
        else:
            index = round((time - zero) * rate)
        if index is None or index < expected:
            continue  # shown before the first frame that is wanted
        waiting = _without_dependents(waiting, packets, range(expected, index + is_corrupt))
        is_usable = not is_corrupt and (is_key or (is_usable and index == expected))
        expected = index + 1
        if is_usable:
            needed = None if is_b_frame else index
            if places:
                ahead = range(min(index + MAX_REORDERED, packets.count - 1), index, -1)
                needed = next((i for i in ahead if places[i] < places[index]), index)
            waiting.append((index, data, needed))
        while waiting:
            settled, data, needed = waiting[0]
            if is_b_frame if needed is None else needed > index:
                break
            waiting.popleft()
            yield settled, data
    for index, data, _ in _without_dependents(waiting, packets, range(expected, packets.count)):
        yield index, data


def _without_dependents(
    waiting: deque[tuple[int, bytes, int | None]], packets: Packets, damaged: range
) -> deque[tuple[int, bytes, int | None]]:
    """Return the waiting frames that build on no damaged one."""
    places = packets.positions
    return deque(
        (index, data, needed)
        for index, data, needed in waiting
        if not any(needed is None or (places and places[i] < places[index]) for i in damaged)
    )


def _decoded_frames(ffmpeg: FfmpegReader) -> Iterator[tuple[Fraction, bool, bool, bool, bytes]]:
    """Yield each decoded frame, up to where decoding fails for good.

    Of each: seconds from where decoding begins, True for key frames, True for corrupt ones, True
    for B-frames, and its bytes.
    """
    frames: deque[tuple[Fraction, bool, bool, bool]] = deque()
    is_corrupt = False
    while True:
        try:
            data = ffmpeg.read()
        except FfmpegError:
            return
        for line in ffmpeg.messages():
            match = _DECODED.search(line)
            if match is not None:
                time, is_key = int(match[1]) * Fraction(match[4]), match[2] != "0"
                frames.append((time, is_key, is_corrupt, match[3] == _B_FRAME))
                is_corrupt = False
            elif _CORRUPT in line:
                is_corrupt = True
        if data is None or not frames:
            return
        yield *frames.popleft(), data
