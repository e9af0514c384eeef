"""How tracks of sound and subtitles go into a new video: copied, encoded again or left out.

What a container takes, and what ffmpeg can decode, is tried out before the video is begun: a track
that fails would end the video, with all frames that are made for it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from exwarp_cli.io.ffmpeg import FfmpegError, run_ffmpeg

COPIED_AUDIO: Mapping[str, frozenset[str]] = {
    "mp4": frozenset({"aac", "ac3", "alac", "eac3", "flac", "mp3", "opus"}),
    "mov": frozenset({"aac", "ac3", "alac", "eac3", "mp3", "pcm_s16le", "pcm_s24le", "pcm_s16be"}),
}
"""Codecs that are copied into each container as they are, since players of it know them."""

STYLED_SUBTITLES = frozenset({"ass", "ssa"})
"""Subtitles whose styles the two containers have no room for."""

SOUND, SUBTITLES = "a", "s"
"""Kinds of tracks, as ffmpeg's options call them."""

_NAMES = {SOUND: "sound", SUBTITLES: "subtitle"}
_COPY = "copy"


@dataclass(frozen=True)
class Track:
    """A track of a video.

    Attributes
    ----------
    kind
        `SOUND` or `SUBTITLES`.
    index
        Among the tracks of its kind, from 0.
    codec
        By ffmpeg's name.
    """

    kind: str
    index: int
    codec: str

    @property
    def name(self) -> str:
        """How messages call it, counted from 1."""
        return f"{_NAMES[self.kind]} track {self.index + 1} ({self.codec})"


@dataclass(frozen=True)
class TrackPlan:
    """How the tracks of a video go along.

    Attributes
    ----------
    kept
        Tracks that go along, each with the encoder's name and options.
    remarks
        A sentence for each track that is not copied.
    """

    kept: tuple[tuple[Track, tuple[str, ...]], ...] = ()
    remarks: tuple[str, ...] = ()

    def options(self, source: int) -> list[str]:
        """Return ffmpeg's options for the output, by the number of the input."""
        return _mapped(self.kept, source)


def plan_tracks(
    path: Path, part: Sequence[str], tracks: Sequence[Track], container: str
) -> TrackPlan:
    """Find out how each track can go along, by trying.

    Parameters
    ----------
    path
        The video that has them, for messages.
    part
        ffmpeg's options that read the part of it which is wanted.
    tracks
        Its tracks.
    container
        "mp4" or "mov".
    """
    first = [(track, _codings(track, container)[0]) for track in tracks]
    if not tracks or _works(part, first, container):  # nearly always: the file is read once
        kept = first
    else:
        chosen = ((track, _choose(part, track, container)) for track in tracks)
        kept = [(track, coding) for track, coding in chosen if coding is not None]
    codings = dict(kept)
    remarks = (_remark(path, part, track, codings.get(track), container) for track in tracks)
    return TrackPlan(tuple(kept), tuple(filter(None, remarks)))


def _codings(track: Track, container: str) -> list[tuple[str, ...]]:
    """Return the encoders to try, the best first."""
    if track.kind == SUBTITLES:
        return [("mov_text",)]
    copied = [(_COPY,)] if track.codec in COPIED_AUDIO[container] else []
    # AAC has 8 channels at most here; PCM has any number, but is not usual in MP4.
    pcm = [("pcm_s24le",)] if container == "mov" else []
    return [*copied, ("aac", "256k"), *pcm]


def _choose(part: Sequence[str], track: Track, container: str) -> tuple[str, ...] | None:
    """Return the first encoder that works; None if none does."""
    trials = _codings(track, container)
    return next((coding for coding in trials if _works(part, [(track, coding)], container)), None)


def _works(
    part: Sequence[str], kept: Sequence[tuple[Track, tuple[str, ...]]], container: str
) -> bool:
    """Write tracks nowhere, and return True if that succeeds."""
    try:
        run_ffmpeg([*part, *_mapped(kept, 0), "-f", container, f"file:{os.devnull}"])
    except FfmpegError:
        return False
    return True


def _mapped(kept: Sequence[tuple[Track, tuple[str, ...]]], source: int) -> list[str]:
    options: list[str] = []
    counts = {SOUND: 0, SUBTITLES: 0}
    for track, (encoder, *rate) in kept:
        place = f"{track.kind}:{counts[track.kind]}"
        counts[track.kind] += 1
        options += ["-map", f"{source}:{track.kind}:{track.index}", f"-c:{place}", encoder]
        options += [f"-b:{place}", *rate] if rate else []
    return options


def _remark(
    path: Path, part: Sequence[str], track: Track, coding: tuple[str, ...] | None, container: str
) -> str | None:
    """Say what becomes of a track that is not copied; None if there is nothing to say."""
    name = f"{track.name} of {path}"
    if coding is None:
        elsewhere = container == "mp4" and _choose(part, track, "mov") is not None
        better = "; a video named .mov can hold it" if elsewhere else ""
        return f"{name} is left out of the video, as it cannot be copied or encoded again{better}"
    if track.kind == SUBTITLES:
        return f"{name} keeps its text alone" if track.codec in STYLED_SUBTITLES else None
    if coding == (_COPY,):
        return None
    known = track.codec in COPIED_AUDIO[container]
    why = "it is damaged" if known else f"players of .{container} do not know it"
    return f"{name} is encoded again as {coding[0]}, since {why}"
