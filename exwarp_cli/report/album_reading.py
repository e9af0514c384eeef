"""The viewer of several pages in one: their pictures, read back from the pages of chunks."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exwarp_cli import __version__
from exwarp_cli.domain.results import RunSummary
from exwarp_cli.report.gallery import (
    KEY,
    OUTPUT,
    TRUTH,
    Album,
    Shown,
    evenly,
    room_for,
    worst_of,
)
from exwarp_cli.report.pictures import Picture

SOURCES = (OUTPUT, TRUTH, KEY)

HEAD = 1000
"""Characters at the beginning of a page that name what wrote it."""

GENERATOR = f'<meta name="generator" content="ExWarp {__version__}">'
BEGIN, END = '<script type="application/json">', "</script>"
"""What stands around the album in a page; see `page.viewer_data`."""

_NONSENSE = (
    *(ArithmeticError, AttributeError, LookupError, OSError, RecursionError, TypeError),
    ValueError,
)
"""What is raised on the way by a page that is not there, or holds something else."""


@dataclass(frozen=True)
class PageAlbums:
    """The pages of chunks, and which frames each shows; pictures are read when they are wanted.

    Attributes
    ----------
    pages
        Page by the number of a frame that it shows.
    unreadable
        Pages that are not there, are damaged, or were written by another version.
    """

    pages: Mapping[int, Path]
    unreadable: tuple[Path, ...]

    @classmethod
    def of(
        cls, pages: Sequence[Path], asked: Sequence[Collection[int]] | None = None
    ) -> PageAlbums:
        """Look through pages, one at a time.

        Parameters
        ----------
        pages
            Of the reports that are joined.
        asked
            Numbers of the frames that each report is asked for; None where no two have the same.
        """
        found: dict[int, Path] = {}
        unreadable = []
        for i, page in enumerate(pages):
            try:
                numbers = [int(frame["number"]) for frame in _plain_album(page)["frames"]]
            except _NONSENSE:
                unreadable.append(page)
            else:
                wanted = (n for n in numbers if asked is None or n in asked[i])
                found |= dict.fromkeys(wanted, page)
        return cls(found, tuple(unreadable))

    def album(self, run: RunSummary) -> Album:
        """Return the album of a joined run, of no more frames and bytes than that of a single one.

        Parameters
        ----------
        run
            What the pages' runs were joined into; its frames are chosen evenly.
        """
        numbers = self._chosen(run)
        room = room_for(len(numbers) + 1)
        shown: dict[int, Shown] = {}
        for page in dict.fromkeys(self.pages[number] for number in numbers):
            own = [number for number in numbers if self.pages[number] == page]
            shown |= {frame.number: frame for frame in _frames(page, own, room)}
        has_truth = any(TRUTH in frame.pictures for frame in shown.values())
        first = (OUTPUT, TRUTH) if has_truth else (KEY, OUTPUT)
        return Album(SOURCES, *first, room=room, frames=shown)

    def _chosen(self, run: RunSummary) -> list[int]:
        """Choose whole key intervals evenly, as a gallery does, and the worst frame.

        The pages have chosen already where their chunks were long, so that the nearest interval
        that is there has to do.
        """
        intervals: dict[int, list[int]] = {}
        for frame in run.frames:
            intervals.setdefault(frame.key, []).append(frame.number)
        groups = list(intervals.values())
        there = [i for i, group in enumerate(groups) if all(n in self.pages for n in group)]
        if not there:
            return sorted(self._worst(run))
        nearest = {min(there, key=lambda i: abs(i - wanted)) for wanted in evenly(groups)}
        return sorted({n for i in nearest for n in groups[i]} | self._worst(run))

    def _worst(self, run: RunSummary) -> set[int]:
        """Return the worst frame that a page shows, if any is scored."""
        worst = worst_of(frame for frame in run.frames if frame.number in self.pages)
        return set() if worst is None else {worst}


def _plain_album(page: Path) -> dict[str, Any]:
    """Return the album in a page, as `Album.plain` made it; empty where the page has no viewer."""
    text = page.read_text(encoding="utf-8")
    if GENERATOR not in text[:HEAD]:
        raise ValueError(f"{page} was written by another version")
    begin = text.find(BEGIN)
    if begin < 0:
        return {"frames": [], "images": []}
    begin += len(BEGIN)
    found: dict[str, Any] = json.loads(text[begin : text.index(END, begin)])
    return found


def _frames(page: Path, numbers: Collection[int], room: int) -> Iterator[Shown]:
    """Read the frames of these numbers from a page; leave out what is no picture."""
    try:
        plain = _plain_album(page)
    except _NONSENSE:
        return
    loaded: dict[tuple[int, int], Picture] = {}

    def picture(index: int, room: int) -> Picture:
        if (index, room) not in loaded:
            loaded[index, room] = Picture.of(plain["images"][index]).within(room)
        return loaded[index, room]

    for frame in plain["frames"]:
        try:
            number, holes = int(frame["number"]), frame["holes"]
            if number not in numbers:
                continue
            yield Shown(
                number,
                f"frame {number}",
                "",
                {},
                {n: picture(i, room) for n, i in frame["pictures"].items() if n in SOURCES},
                {n: picture(i, room // 2) for n, i in frame["errors"].items() if n in SOURCES},
                None if holes is None else picture(holes, room),
            )
        except _NONSENSE:
            continue
