"""The frames that a page shows: chosen evenly, kept as small pictures, bounded in memory.

album.json and the viewer in a page hold one JSON object an album::

    {"names": ["output", "ground truth", …],      the sources in their order
     "before": "output", "after": "ground truth", which two are shown first
     "start": 12 or null,                          number of the frame that is shown first
     "heat": [[r, g, b], …],                      in pages: colours of the error map, from 0 on
     "fps": 120.0 or null,                        in pages: frames a second, in real time
     "images": [{"url", "width", "height", "peak"}, …],
     "frames": [{"number": 12, "label": "frame 12", "kind": "generated",
                 "facts": {"PSNR": "34.21 dB", …},     text beside the picture
                 "risk": {"columns", "rows", "levels"} or null, predicted error of tiles, 0 to 255
                 "holes": 3 or null,                   indices into `images` from here on
                 "pictures": {"output": 0, "ground truth": 1, …},
                 "errors": {"output": 2, …}}, …]}

A source that a frame lacks is missing from its `pictures`. `peak` is that of `Picture`.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

from exwarp_cli.domain.frame import Bool, Float32
from exwarp_cli.domain.results import FrameRecord, RunSummary, Score
from exwarp_cli.domain.tiles import Risk
from exwarp_cli.report.pictures import (
    LONGEST,
    Picture,
    encode_colour,
    encode_error,
    encode_mask,
    find_peak,
    shrink,
)
from exwarp_cli.report.schema import UNREADABLE

MAX_FRAMES = 240  # of a page: 60 key intervals, two seconds at 120 fps

# Share of a page's frames that are spread over the run, if it has more; the others are in a row in
# its middle, to be played.
SPREAD_SHARE = 0.4

# Bytes of all pictures of a page at most; a third more as text.
BUDGET = 12_000_000

# Bytes of one picture at most, where there are few.
PICTURE_BYTES = 250_000

# Frames of a page from which its pictures are smaller, pixels: so that one quality suits all of
# them. Neighbours of different quality would flicker.
MANY_FRAMES, LONGEST_OF_MANY = 96, 480

# Names of the sources of an upsampled sequence.
OUTPUT, TRUTH, KEY = "output", "ground truth", "key frame before"


@dataclass
class Shown:
    """One frame of an album; see the module's text for what the fields mean."""

    number: int
    kind: str = ""
    facts: dict[str, str] = field(default_factory=dict)
    pictures: dict[str, Picture] = field(default_factory=dict)
    errors: dict[str, Picture] = field(default_factory=dict)
    holes: Picture | None = None
    risk: Risk | None = None


@dataclass
class Album:
    """Frames for one viewer."""

    names: tuple[str, ...]  # sources in the order in which they are offered
    before: str  # the two that are shown first, left and right
    after: str
    room: int = PICTURE_BYTES  # bytes that one picture may take
    longest: int = LONGEST  # longest side of a picture, pixels
    start: int | None = None  # number of the frame shown first; None: the first but key frames
    fps: float | None = None  # frames a second, in real time; None if not known
    frames: dict[int, Shown] = field(default_factory=dict)  # by number
    viewer: str = "viewer"  # id of its viewer, unique in the page: letters, digits and hyphens

    def add(
        self,
        number: int,
        kind: str,
        sources: Mapping[str, Float32],
        reference: str | None = None,
        mask: Bool | None = None,
    ) -> Shown:
        """Encode the pictures of a frame and keep them; `facts` may be set later.

        `sources` are float32 [H, W, 3] or more, scene-linear, of one size; `mask` is bool [H, W],
        holes. Errors are those of the other sources against the one named `reference`.
        """
        small = {name: shrink(pixels, self.longest) for name, pixels in sources.items()}
        peak = find_peak(*small.values())
        shown = Shown(number, kind)
        for name, pixels in small.items():
            shown.pictures[name] = encode_colour(pixels, peak, self.room)
            if reference is not None and name != reference:
                shown.errors[name] = encode_error(
                    sources[reference], sources[name], self.room // 2, self.longest
                )
        shown.holes = None if mask is None else encode_mask(mask, self.longest)
        self.frames[number] = shown
        return shown

    def add_source(self, number: int, name: str, pixels: Float32, reference: Float32) -> None:
        """Encode a further source of a frame that the album has, and its error, as `add` does."""
        shown, small = self.frames[number], shrink(pixels, self.longest)
        shown.pictures[name] = encode_colour(small, find_peak(small), self.room)
        shown.errors[name] = encode_error(reference, pixels, self.room // 2, self.longest)

    def set_facts(
        self, number: int, kind: str, facts: Mapping[str, str], risk: Risk | None = None
    ) -> None:
        """Set the text and the predicted error of a frame, if the album has it."""
        if number in self.frames:
            shown = self.frames[number]
            shown.kind, shown.facts, shown.risk = kind, dict(facts), risk

    def to_plain(self) -> dict[str, Any]:
        """Return the object of the module's text but what pages add; equal pictures appear once."""
        frames = [shown for _, shown in sorted(self.frames.items())]
        used = {name for shown in frames for name in shown.pictures}
        pictures = {
            id(picture): picture
            for shown in frames
            for picture in (shown.holes, *shown.pictures.values(), *shown.errors.values())
            if picture is not None
        }
        index = {key: i for i, key in enumerate(pictures)}
        return {
            "names": [name for name in self.names if name in used],
            "before": self.before,
            "after": self.after,
            "start": self.start,
            "images": [picture.to_plain() for picture in pictures.values()],
            "frames": [
                {
                    "number": shown.number,
                    "label": f"frame {shown.number}",
                    "kind": shown.kind,
                    "facts": shown.facts,
                    "risk": shown.risk
                    and {
                        "columns": shown.risk.columns,
                        "rows": shown.risk.rows,
                        "levels": [round(level, 1) for level in shown.risk.levels],
                    },
                    "holes": shown.holes and index[id(shown.holes)],
                    "pictures": {name: index[id(p)] for name, p in shown.pictures.items()},
                    "errors": {name: index[id(p)] for name, p in shown.errors.items()},
                }
                for shown in frames
            ],
        }


class Gallery:
    """Keeps some frames of a run for its page; a `pipeline.progress.FrameListener`.

    Whole groups (key intervals), see `choose_groups`, and the frame that is worst by the first
    metric that is known while frames are in memory (all but VMAF and flicker), which the viewer
    starts with. Without ground truth it is the frame with the largest predicted error.

    Where several processes do parts of a run, one gallery gets the plan. Each part has what `share`
    returns, which can be pickled, and `adopt` takes over the frames that it kept.

    `sources` counts those that a frame has at last; others are added to the album.
    """

    def __init__(
        self, has_truth: bool, output: str = OUTPUT, truth: str = TRUTH, sources: int = 2
    ) -> None:
        self._output, self._truth, self._has_truth = output, truth, has_truth
        self._sources = sources
        before, after = (output, truth) if has_truth else (KEY, output)
        self.album = Album((output, truth, KEY), before, after)
        self._chosen: set[int] = set()
        self._worst: tuple[float, int] | None = None
        self._key: tuple[int, Picture] | None = None
        self._key_of: dict[int, int] = {}

    def share(self) -> Gallery:
        """Return an empty gallery for a part of the run, with the plan of the whole: plan first."""
        part = copy(self)
        part.album = replace(self.album, start=None, frames={})
        part._worst = part._key = None
        return part

    def adopt(self, part: Gallery) -> None:
        """Take over what a shared gallery kept of its part of the run; parts come in any order."""
        self.album.frames |= part.album.frames
        candidates = [g._worst for g in (self, part) if g._worst is not None]
        if not candidates:
            return
        # Of equally bad frames the first in the run is kept, as by one gallery alone.
        worst, *others = sorted(candidates, key=lambda entry: (-entry[0], entry[1]))
        for _, number in others:
            if number != worst[1] and number not in self._chosen:
                self.album.frames.pop(number, None)
        self._worst, self.album.start = worst, worst[1]

    def plan(self, groups: Sequence[Sequence[int]]) -> None:
        """Choose whole groups, the first and the last among them; what is chosen stays."""
        if self._chosen:  # a part of a run has the plan of the whole
            return
        for i in choose_groups(groups):
            self._chosen.update(groups[i])
        self._key_of = {
            number: group[0] for group in groups for number in group if number in self._chosen
        }
        self.album.room, self.album.longest = limit_pictures(len(self._chosen), self._sources)

    def wants(self, number: int, score: Score | None, risk: Risk | None = None) -> bool:
        """Return whether to keep a frame: chosen, or the worst so far, which replaces the last."""
        badness = None if score is None else score.badness
        if not self._has_truth and risk is not None:
            badness = risk.error
        if badness is None or (self._worst is not None and badness <= self._worst[0]):
            return number in self._chosen
        if self._worst is not None and self._worst[1] not in self._chosen:
            self.album.frames.pop(self._worst[1], None)
        self._worst, self.album.start = (badness, number), number
        return True

    def frame(
        self, number: int, shown: Float32, truth: Float32 | None, mask: Bool | None, is_key: bool
    ) -> None:
        """Keep a frame."""
        sources = {self._output: shown}
        if truth is not None:
            sources[self._truth] = truth
        reference = None if truth is None else self._truth
        added = self.album.add(number, "key" if is_key else "", sources, reference, mask)
        if is_key:
            self._key = number, added.pictures[self._output]
            if self._has_truth:
                added.pictures[self._truth] = added.pictures[self._output]
        if self._key is not None and self._key[0] == self._key_of.get(number):
            added.pictures[KEY] = self._key[1]


def merge_albums(
    files: Sequence[Path], numbers: Sequence[Collection[int]], run: RunSummary
) -> tuple[Album, list[Path]]:
    """Return the album of a joined run, of no more frames and bytes than that of a single one.

    `files` are the album.json of each report that was joined, one of which is in memory at a time;
    `numbers` the frames that each report is asked for. Key intervals of `run`, what the reports
    were joined into, are chosen as for one gallery. The album has no facts. Returned beside it are
    the files that are missing or damaged.
    """
    file_of: dict[int, Path] = {}
    unreadable = []
    for file, asked in zip(files, numbers, strict=True):
        try:
            shown = json.loads(file.read_text(encoding="utf-8"))["frames"]
            there = [int(frame["number"]) for frame in shown]
        except (OSError, *UNREADABLE):
            unreadable.append(file)
        else:
            file_of |= dict.fromkeys((number for number in there if number in asked), file)

    # Whole key intervals, as a gallery chooses them, and the worst frame.
    intervals = groupby(run.frames, lambda frame: frame.key)
    groups = [[frame.number for frame in frames] for _, frames in intervals]
    worst = worst_frame(frame for frame in run.frames if frame.number in file_of)
    chosen = set() if worst is None else {worst}
    complete = [i for i, group in enumerate(groups) if all(n in file_of for n in group)]
    for choice in choose_groups(groups) if complete else ():
        # Albums of long chunks lack intervals, so that the nearest one has to do.
        chosen.update(groups[min(complete, key=lambda i: abs(i - choice))])

    room, longest = limit_pictures(len(chosen))
    frames: dict[int, Shown] = {}
    for file in dict.fromkeys(file_of[number] for number in sorted(chosen)):
        plain = json.loads(file.read_text(encoding="utf-8"))
        try:
            wanted = {number for number in chosen if file_of[number] == file}
            frames |= {shown.number: shown for shown in _read_frames(plain, wanted, room, longest)}
        except (OSError, *UNREADABLE):
            unreadable.append(file)
    has_truth = any(TRUTH in frame.pictures for frame in frames.values())
    before, after = (OUTPUT, TRUTH) if has_truth else (KEY, OUTPUT)
    return Album((OUTPUT, TRUTH, KEY), before, after, room, longest, frames=frames), unreadable


def _read_frames(
    plain: Mapping[str, Any], numbers: Collection[int], room: int, longest: int
) -> list[Shown]:
    """Read frames of an album, with pictures of at most about `room` bytes, `longest` pixels.

    Each picture is read once. Masks keep their size.
    """

    @cache
    def picture(index: int, room: int) -> Picture:
        return Picture.from_plain(plain["images"][index]).within(room, longest)

    return [
        Shown(
            frame["number"],
            pictures={name: picture(i, room) for name, i in frame["pictures"].items()},
            errors={name: picture(i, room // 2) for name, i in frame["errors"].items()},
            holes=None if frame["holes"] is None else picture(frame["holes"], room),
        )
        for frame in plain["frames"]
        if frame["number"] in numbers
    ]


def worst_frame(frames: Iterable[FrameRecord]) -> int | None:
    """Return the number of the worst frame, the first of equally bad ones.

    By all metrics of the finished run, VMAF and flicker among them; where no frame is scored, by
    the predicted error. None without either.
    """
    records = tuple(frames)
    scored = [(f.score.badness, -f.number) for f in records if f.score is not None]
    measured = [(badness, number) for badness, number in scored if badness is not None]
    predicted = [(f.risk.error, -f.number) for f in records if f.risk is not None]
    ranked = measured or ([] if scored else predicted)
    return -max(ranked)[1] if ranked else None


def choose_groups(groups: Sequence[Sequence[int]]) -> list[int]:
    """Return the indices of as many groups of frames as a page has room for: all, or some.

    Some are evenly spaced, the first and the last among them, and the others are in a row in the
    middle.
    """
    size = max((len(group) for group in groups), default=0) or 1  # groups may be empty
    count, limit = len(groups), max(MAX_FRAMES // size, 1)
    if count <= limit:
        return list(range(count))
    spread = min(max(round(SPREAD_SHARE * limit), 2), limit)
    first = (count - (limit - spread)) // 2
    evenly = (round(i * (count - 1) / max(spread - 1, 1)) for i in range(spread))
    return sorted({*evenly, *range(first, first + limit - spread)})


def limit_pictures(frames: int, sources: int = 2) -> tuple[int, int]:
    """Return the bytes and the longest side, pixels, of the pictures of so many chosen frames.

    Errors of all sources but the truth take half the bytes, and the worst frame comes on top.
    """
    room = min(PICTURE_BYTES, int(BUDGET / ((1.5 * sources - 0.5) * (frames + 1))))
    return room, LONGEST_OF_MANY if frames > MANY_FRAMES else LONGEST
