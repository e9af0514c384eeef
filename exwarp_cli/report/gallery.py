"""The frames that a page shows: chosen evenly, kept as small pictures, bounded in memory.

The viewer in a page reads one JSON object an album::

    {"names": ["output", "ground truth", …],      the sources in their order
     "before": "output", "after": "ground truth", which two are shown first
     "start": 12 or null,                          number of the frame that is shown first
     "heat": [[r, g, b], …],                      colours of the error map, from no error on
     "images": [{"url", "width", "height", "peak"}, …],
     "frames": [{"number": 12, "label": "frame 12", "kind": "generated",
                 "facts": {"PSNR": "34.21 dB", …},     text beside the picture
                 "risk": {"columns", "rows", "levels"} or null, predicted error of tiles, 0 to 255
                 "holes": 3 or null,                   indices into `images` from here on
                 "pictures": {"output": 0, "ground truth": 1, …},
                 "errors": {"output": 2, …}}, …]}

A source that a frame lacks is missing from its `pictures`. `peak` is the M of `pictures.curve`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.results import FrameRecord, Score
from exwarp_cli.domain.tiles import Risk
from exwarp_cli.report.pictures import (
    LONGEST,
    Picture,
    colour_picture,
    error_picture,
    mask_picture,
    peak_of,
    reduced,
)

FRAMES = 96
"""Frames of a page at most: 24 key intervals."""

BUDGET = 8_500_000
"""Bytes of all pictures of a page at most; a third more as text."""

ROOM = 250_000
"""Bytes of one picture at most, where there are few."""

OUTPUT, TRUTH, KEY = "output", "ground truth", "key frame before"
"""Names of the sources of an upsampled sequence."""


@dataclass
class Shown:
    """One frame of an album; see the module's text for what the fields mean."""

    number: int
    label: str
    kind: str
    facts: dict[str, str]
    pictures: dict[str, Picture]
    errors: dict[str, Picture]
    holes: Picture | None = None
    risk: Risk | None = None


@dataclass
class Album:
    """Frames for one viewer.

    Attributes
    ----------
    names
        Sources in the order in which they are offered.
    before, after
        The two that are shown first, left and right.
    room
        Bytes that one picture may take.
    longest
        Longest side of a picture, pixels.
    start
        Number of the frame that is shown first; None for the first that is no key frame.
    frames
        What was added, by number.
    """

    names: tuple[str, ...]
    before: str
    after: str
    room: int = ROOM
    longest: int = LONGEST
    start: int | None = None
    frames: dict[int, Shown] = field(default_factory=dict)

    def add(
        self,
        number: int,
        kind: str,
        sources: Mapping[str, Float32],
        reference: str | None = None,
        mask: Bool | None = None,
    ) -> Shown:
        """Encode the pictures of a frame and keep them; `facts` and `label` may be set later.

        Parameters
        ----------
        number
            Frame number, one of its own in the album.
        kind
            What made it, as `plots.KINDS` names it.
        sources
            By name, float32 [H, W, 3] or more, scene-linear, all of one size.
        reference
            The source that errors of the others are taken from; None for no error pictures.
        mask
            bool [H, W], holes; None where nothing tells.
        """
        small = {name: reduced(pixels, self.longest) for name, pixels in sources.items()}
        peak = peak_of(*small.values())
        shown = Shown(number, f"frame {number}", kind, {}, {}, {})
        for name, pixels in small.items():
            shown.pictures[name] = colour_picture(pixels, peak, self.room)
            if reference is not None and name != reference:
                shown.errors[name] = error_picture(
                    sources[reference], sources[name], self.room // 2, self.longest
                )
        shown.holes = None if mask is None else mask_picture(mask, self.longest)
        self.frames[number] = shown
        return shown

    def tell(
        self, number: int, kind: str, facts: Mapping[str, str], risk: Risk | None = None
    ) -> None:
        """Set what is written beside a frame, and its predicted error, if the album has it."""
        if number in self.frames:
            self.frames[number].kind = kind
            self.frames[number].facts = dict(facts)
            self.frames[number].risk = risk

    def plain(self) -> dict[str, Any]:
        """Return the object of the module's text, without `heat`; equal pictures appear once."""
        images: dict[int, int] = {}
        kept: list[Picture] = []

        def index(picture: Picture) -> int:
            if id(picture) not in images:
                images[id(picture)] = len(kept)
                kept.append(picture)
            return images[id(picture)]

        frames = [
            {
                "number": shown.number,
                "label": shown.label,
                "kind": shown.kind,
                "facts": shown.facts,
                "risk": None if shown.risk is None else risk_tiles(shown.risk),
                "holes": None if shown.holes is None else index(shown.holes),
                "pictures": {name: index(p) for name, p in shown.pictures.items()},
                "errors": {name: index(p) for name, p in shown.errors.items()},
            }
            for _, shown in sorted(self.frames.items())
        ]
        used = {name for shown in self.frames.values() for name in shown.pictures}
        return {
            "names": [name for name in self.names if name in used],
            "before": self.before,
            "after": self.after,
            "start": self.start,
            "images": [picture.plain() for picture in kept],
            "frames": frames,
        }


def risk_tiles(risk: Risk) -> dict[str, Any]:
    """Return the predicted error of a frame's tiles as the viewer reads it."""
    levels = [round(level, 1) for level in risk.levels]
    return {"columns": risk.columns, "rows": risk.rows, "levels": levels}


class Gallery:
    """Watches a run and keeps some of its frames: a `pipeline.progress.FrameListener`.

    Whole groups (key intervals) evenly over the run, and the frame that is worst by the first
    metric that is known while frames are at hand (all but VMAF and flicker), which the viewer
    starts with. Without ground truth it is the frame with the largest predicted error.

    Of a run that is done in parts by several processes, one gallery hears the plan; each part is
    watched by what `share` returned, which can be pickled, and `adopt` takes over what it kept.

    Parameters
    ----------
    output, truth
        Names of the two sources.
    has_truth
        Whether frames come with ground truth; without, they stand beside the key frame before.
    """

    def __init__(self, has_truth: bool, output: str = OUTPUT, truth: str = TRUTH) -> None:
        self._output, self._truth, self._has_truth = output, truth, has_truth
        after = truth if has_truth else output
        before = output if has_truth else KEY
        self.album = Album((output, truth, KEY), before, after)
        self._chosen: set[int] = set()
        self._worst: tuple[float, int] | None = None
        self._key: tuple[int, Picture] | None = None
        self._key_of: dict[int, int] = {}
        self._shared = False

    def share(self) -> Gallery:
        """Return an empty gallery for a part of the run, with the plan of the whole.

        What it hears as a plan is its part's alone, and does not count.
        """
        part = Gallery(self._has_truth, self._output, self._truth)
        part._chosen, part._key_of = self._chosen, self._key_of
        part.album.room = self.album.room
        part._shared = True
        return part

    def adopt(self, part: Gallery) -> None:
        """Take over what a shared gallery kept of its part of the run; parts come in any order."""
        self.album.frames |= part.album.frames
        known = [one._worst for one in (self, part) if one._worst is not None]
        if not known:
            return
        # Of equally bad frames the first in the run is kept, as by one gallery alone.
        first, *others = sorted(known, key=lambda entry: (-entry[0], entry[1]))
        for _, number in others:
            if number != first[1] and number not in self._chosen:
                self.album.frames.pop(number, None)
        self._worst, self.album.start = first, first[1]

    def plan(self, groups: Sequence[Sequence[int]]) -> None:
        """Choose whole groups, evenly, the first and the last among them."""
        if self._shared:
            return
        for i in evenly(groups):
            self._chosen.update(groups[i])
        self._key_of = {
            number: group[0] for group in groups for number in group if number in self._chosen
        }
        self.album.room = room_for(len(self._chosen) + 1)

    def wants(self, number: int, score: Score | None, risk: Risk | None = None) -> bool:
        """Whether a frame was chosen, or is the worst so far, which then replaces the last one."""
        value = None if score is None else score.badness
        if not self._has_truth and risk is not None:
            value = risk.error
        if value is None or (self._worst is not None and value <= self._worst[0]):
            return number in self._chosen
        if self._worst is not None and self._worst[1] not in self._chosen:
            self.album.frames.pop(self._worst[1], None)
        self._worst, self.album.start = (value, number), number
        return True

    def frame(
        self, number: int, shown: Float32, truth: Float32 | None, mask: Bool | None, is_key: bool
    ) -> None:
        """Keep a frame."""
        sources = {self._output: shown}
        if truth is not None:
            sources[self._truth] = truth
        reference = None if truth is None else self._truth
        kept = self.album.add(number, "key" if is_key else "", sources, reference, mask)
        if is_key:
            self._key = number, kept.pictures[self._output]
            if self._has_truth:
                kept.pictures[self._truth] = kept.pictures[self._output]
        if self._key is not None and self._key[0] == self._key_of.get(number):
            kept.pictures[KEY] = self._key[1]


def worst_of(frames: Iterable[FrameRecord]) -> int | None:
    """Return the number of the worst frame, the first of equally bad ones; None if nothing tells.

    By all metrics of the finished run, VMAF and flicker among them; where no frame is scored, by
    the predicted error.
    """
    records = tuple(frames)
    known = [(f.score.badness, -f.number) for f in records if f.score is not None]
    measured = [(badness, number) for badness, number in known if badness is not None]
    predicted = [(f.risk.error, -f.number) for f in records if f.risk is not None]
    ranked = measured or ([] if known else predicted)
    return -max(ranked)[1] if ranked else None


def evenly(groups: Sequence[Sequence[int]]) -> list[int]:
    """Return the indices of as many groups of frames as a page has room for, evenly spread."""
    size = max((len(group) for group in groups), default=0) or 1  # groups may be empty
    return spread(len(groups), max(FRAMES // size, 1))


def room_for(frames: int) -> int:
    """Return the bytes that a picture may take: a frame has output, truth and half of an error."""
    return min(ROOM, int(BUDGET / (2.5 * max(frames, 1))))


def spread(count: int, limit: int) -> list[int]:
    """Return at most `limit` indices out of `count`, evenly, with the first and the last."""
    if count <= limit:
        return list(range(count))
    if limit == 1:
        return [0]
    return sorted({round(i * (count - 1) / (limit - 1)) for i in range(limit)})
