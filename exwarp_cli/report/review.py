"""What of a run is most worth a look, and which frames are most worth rendering after all.

Both go by the predicted error of new frames, see `exwarp_cli.domain.tiles`, and by the frames'
records alone, so that joined chunks have the lists of a single run.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from exwarp_cli.domain.decision import SOFTSPLAT
from exwarp_cli.domain.network_api import LOOKAHEAD
from exwarp_cli.domain.results import FrameRecord, RunSummary
from exwarp_cli.domain.tiles import REASONS, Risk, tile_edges
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.report.quality import mean

MOST_PLACES = 100
"""Places of a list at most."""

PLACES_OF_FRAME = 3
"""Places of one frame at most."""

SEEN = 8.0
"""Display levels from which the error of a place is worth a look: 30 dB."""

STANDS_OUT = 0.5
"""Share of the error of a frame's worst tile from which another tile belongs to a place."""

RENDERED_SHARE = 0.1
"""Share of the new frames that are named for rendering: the worst of them."""

RENDERED_FROM = 4.0
"""Display levels of a whole frame from which it is named for rendering: 36 dB."""


GAIN_BESIDE, GAIN_FALLS = 0.44, 0.64
"""Share of a frame's squared error that goes when one beside it is rendered, and by how much less
it is for each key interval between the two. A quarter of an interval away 28 % were measured (1.0
to 1.8 dB), half an interval away 12 % (0.3 to 0.7 dB), on the scenes lab, slum, arena and town."""

LOOKING_AHEAD = (SOFTSPLAT, LOOKAHEAD)
"""Makers of frames that `--rendered` makes from rendered frames beside them."""


@dataclass(frozen=True)
class Place:
    """A part of a frame that is expected to be wrong.

    Attributes
    ----------
    frame
        Output number.
    error
        Predicted RMS error, display levels of 0 to 255.
    x, y, width, height
        Pixels, from the upper left corner of the display window.
    reason
        Out of `exwarp_cli.domain.tiles.REASONS`.
    """

    frame: int
    error: float
    x: int
    y: int
    width: int
    height: int
    reason: str


def predicted(frames: Iterable[FrameRecord]) -> list[tuple[float, FrameRecord]]:
    """Return the frames with a predicted error, and that error, the worst first."""
    known = [(frame.risk.error, frame) for frame in frames if frame.risk is not None]
    return sorted(known, key=lambda entry: (-entry[0], entry[1].number))


def worth_rendering(frames: Iterable[FrameRecord]) -> list[int]:
    """Return the numbers of the frames that are most worth rendering after all, ascending.

    One after the other, each by the squared error that it takes away: its own, and a share of that
    of frames beside it, which `--rendered` makes from it, too. So the middle of an interval comes
    before the frames around it, unless these are much worse.
    """
    ordered = predicted(frames)
    known = [frame for _, frame in ordered]
    beside: dict[int, list[FrameRecord]] = {}
    for frame in known:
        beside.setdefault(frame.key, []).append(frame)
    squares = {frame.number: error**2 for error, frame in ordered}
    shares = {frame.number: _shares(frame, beside[frame.key]) for frame in known}
    values = {number: _value(shares[number], squares) for number in squares}
    chosen: list[int] = []
    for _ in range(math.ceil(RENDERED_SHARE * len(known))):
        best = max(values, key=lambda number: (values[number], -number))
        if squares[best] < RENDERED_FROM**2:
            break
        chosen.append(best)
        for number, share in shares[best].items():
            squares[number] *= 1 - share
        values |= {number: _value(shares[number], squares) for number in shares[best]}
    return sorted(chosen)


def _value(shares: Mapping[int, float], squares: Mapping[int, float]) -> float:
    """Return the squared error that goes when a frame is rendered; 0 where it is right itself."""
    (own, _), *_ = shares.items()
    if squares[own] < RENDERED_FROM**2:
        return 0.0
    return sum(share * squares[number] for number, share in shares.items())


def _shares(rendered: FrameRecord, interval: Sequence[FrameRecord]) -> dict[int, float]:
    """Return which share of each frame's squared error goes once one is rendered, itself first.

    `interval` holds all the frames of its key interval that have a predicted error.
    """
    found = {rendered.number: 1.0}
    if rendered.made_by not in LOOKING_AHEAD:
        return found
    count = max(frame.slot for frame in interval) + 1
    for frame in interval:
        if frame is not rendered:
            away = abs(frame.slot - rendered.slot) / count
            found[frame.number] = max(GAIN_BESIDE - GAIN_FALLS * away, 0.0)
    return found


def worth_a_look(run: RunSummary) -> list[Place]:
    """Return the places of a run that are most worth a look, the worst first."""
    size = run.input.width, run.input.height
    found = [place for _, frame in predicted(run.frames) for place in places_of(frame, size)]
    return sorted(found, key=lambda place: (-place.error, place.frame))[:MOST_PLACES]


def places_of(frame: FrameRecord, size: tuple[int, int]) -> list[Place]:
    """Return the places of a frame that stand out, the worst first.

    Parameters
    ----------
    frame
        With a predicted error.
    size
        Width and height of the display window, pixels.
    """
    risk = frame.risk
    assert risk is not None
    levels = risk.levels
    least = max(SEEN, STANDS_OUT * max(levels))
    bad = {i for i, level in enumerate(levels) if level >= least}
    places = [_place(frame.number, risk, group, size) for group in _groups(bad, risk.columns)]
    return sorted(places, key=lambda place: -place.error)[:PLACES_OF_FRAME]


def review(run: RunSummary) -> dict[str, Any] | None:
    """Return what report.json holds of it; None where no frame has a predicted error.

    ``predicted_error`` is in display levels of 0 to 255, and ``worst_frame`` has the largest one.
    ``places`` counts the rows of review.csv, and ``render`` is what review.txt holds, "" for none.
    """
    ordered = predicted(run.frames)
    if not ordered:
        return None
    worst, frame = ordered[0]
    return {
        "predicted_error": {
            "mean": mean(error for error, _ in ordered),
            "worst": worst,
            "worst_frame": frame.number,
            "frames": len(ordered),
        },
        "places": len(worth_a_look(run)),
        "render": ranges(worth_rendering(run.frames)),
    }


def review_line(found: dict[str, Any]) -> str:
    """Say in a line what is most worth a look, as report.json has it."""
    error = found["predicted_error"]
    line = (
        f"predicted error {error['mean']:.1f} of 255 levels on average, worst "
        f"{error['worst']:.1f} in frame {error['worst_frame']}"
    )
    if not found["places"]:
        return f"{line}; nothing stands out"
    looks = f"{pluralise(found['places'], 'place')} worth a look"
    return f"{line}; {looks}" + (
        f"; frames most worth rendering: {found['render']}" if found["render"] else ""
    )


def _groups(bad: set[int], columns: int) -> list[set[int]]:
    """Return groups of tiles that touch along a side."""
    left, groups = set(bad), []
    while left:
        group, fresh = set(), {min(left)}
        while fresh:
            group |= fresh
            beside = {other for tile in fresh for other in _beside(tile, columns)}
            fresh = (beside & left) - group
        groups.append(group)
        left -= group
    return groups


def _beside(tile: int, columns: int) -> list[int]:
    """Return the tiles above, below, left and right of one; some may lie outside the frame."""
    found = [tile - columns, tile + columns]
    if tile % columns:
        found.append(tile - 1)
    if (tile + 1) % columns:
        found.append(tile + 1)
    return found


def _place(number: int, risk: Risk, group: set[int], size: tuple[int, int]) -> Place:
    levels = risk.levels
    across, down = tile_edges(size[0], risk.columns), tile_edges(size[1], risk.rows)
    rows, columns = zip(*(divmod(tile, risk.columns) for tile in group), strict=True)
    x, y = across[min(columns)], down[min(rows)]
    squares = [0.0] * len(REASONS)
    for tile in sorted(group):
        squares[risk.reasons[tile]] += levels[tile] ** 2
    return Place(
        frame=number,
        error=math.sqrt(sum(squares) / len(group)),
        x=x,
        y=y,
        width=across[max(columns) + 1] - x,
        height=down[max(rows) + 1] - y,
        reason=REASONS[squares.index(max(squares))],
    )
