"""Whether a video is interlaced, by what ffmpeg's filter ``showinfo`` says of its frames."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path

from exwarp_cli.io.clip_timing import Packets
from exwarp_cli.io.ffmpeg import FfmpegError, told

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
    _, said = told([*source, *options, "-vf", "showinfo=checksum=0", "-f", "null", "-"])
    return said
