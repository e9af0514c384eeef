"""What of a run is most worth a look, and which frames are most worth rendering after all.

Both go by the predicted error of new frames, see `exwarp_cli.domain.tiles`, and by the frames'
records alone, so that joined chunks have the lists of a single run.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from exwarp_cli.domain.decision import LOOKAHEAD, SOFTSPLAT
from exwarp_cli.domain.results import FrameRecord, RunSummary
from exwarp_cli.domain.tiles import REASONS, tile_edges
from exwarp_cli.domain.timeline import ranges

MAX_PLACES = 100  # of a list
MAX_PLACES_OF_FRAME = 3

# Display levels from which the error of a place is worth a look: 30 dB.
NOTICEABLE = 8.0

# Share of the error of a frame's worst tile from which another tile belongs to a place.
STANDS_OUT = 0.5

# Share of the new frames that are named for rendering: the worst of them.
RENDERED_SHARE = 0.1

# Display levels of a whole frame from which it is named for rendering: 36 dB.
RENDERED_FROM = 4.0

# Share of a frame's squared error that goes when one beside it is rendered, and by how much less it
# is for each key interval between the two. A quarter of an interval away 28 % were measured (1.0 to
# 1.8 dB), half an interval away 12 % (0.3 to 0.7 dB), on the scenes lab, slum, arena and town.
GAIN_BESIDE, GAIN_FALLS = 0.44, 0.64

# Makers of frames that --rendered makes from rendered frames beside them.
LOOKING_AHEAD = (SOFTSPLAT, LOOKAHEAD)

PLACE_COLUMNS = ("frame", "predicted_error", "x", "y", "width", "height", "why")


@dataclass(frozen=True)
class Place:
    """A part of a frame that is expected to be wrong."""

    frame: int  # output number
    error: float  # predicted RMS error, display levels of 0 to 255
    x: int  # pixels, from the upper left corner of the display window
    y: int
    width: int
    height: int
    reason: str  # out of `exwarp_cli.domain.tiles.REASONS`


def _rank_by_risk(frames: Iterable[FrameRecord]) -> list[tuple[float, FrameRecord]]:
    """Return the frames with a predicted error, and that error, the worst first."""
    errors = [(frame.risk.error, frame) for frame in frames if frame.risk is not None]
    return sorted(errors, key=lambda entry: (-entry[0], entry[1].number))


def frames_worth_rendering(frames: Iterable[FrameRecord]) -> list[int]:
    """Return the numbers of the frames that are most worth rendering after all, ascending.

    One after the other, each by the squared error that it takes away: its own, and a share of that
    of frames beside it, which `--rendered` makes from it, too. So the middle of an interval comes
    before the frames around it, unless these are much worse.
    """
    ranked = _rank_by_risk(frames)
    intervals: dict[int, list[FrameRecord]] = {}
    for _, frame in ranked:
        intervals.setdefault(frame.key, []).append(frame)
    squares = {frame.number: error**2 for error, frame in ranked}
    # Of each frame, the share of other frames' squared error that goes once it is rendered.
    gains: dict[int, dict[int, float]] = {}
    for _, frame in ranked:
        gains[frame.number] = {frame.number: 1.0}
        if frame.made_by in LOOKING_AHEAD:
            interval = intervals[frame.key]
            count = max(other.slot for other in interval) + 1
            for other in interval:
                if other is not frame:
                    away = abs(other.slot - frame.slot) / count
                    gains[frame.number][other.number] = max(GAIN_BESIDE - GAIN_FALLS * away, 0.0)

    values: dict[int, float] = {}  # what rendering each frame takes away
    stale = set(squares)  # frames whose value changed
    chosen: list[int] = []
    for _ in range(math.ceil(RENDERED_SHARE * len(ranked))):
        for number in stale:
            values[number] = 0.0
            if squares[number] >= RENDERED_FROM**2:
                values[number] = sum(s * squares[frame] for frame, s in gains[number].items())
        best = max(values, key=lambda number: (values[number], -number))
        if squares[best] < RENDERED_FROM**2:
            break
        chosen.append(best)
        for number, share in gains[best].items():
            squares[number] *= 1 - share
        stale = set(gains[best])
    return sorted(chosen)


def places_worth_a_look(run: RunSummary) -> list[Place]:
    """Return the places of a run that are most worth a look, the worst first."""
    size = run.input.width, run.input.height
    places = [p for _, frame in _rank_by_risk(run.frames) for p in places_of_frame(frame, size)]
    return sorted(places, key=lambda place: (-place.error, place.frame))[:MAX_PLACES]


def places_of_frame(frame: FrameRecord, size: tuple[int, int]) -> list[Place]:
    """Return the places of a frame with a predicted error that stand out, the worst first.

    `size` is the width and height of the display window, pixels.
    """
    risk = frame.risk
    assert risk is not None
    levels = risk.levels
    across, down = tile_edges(size[0], risk.columns), tile_edges(size[1], risk.rows)
    threshold = max(NOTICEABLE, STANDS_OUT * max(levels))
    bad = {tile for tile, level in enumerate(levels) if level >= threshold}
    places = []
    while bad:
        # The first tile, and all that are connected to it along a side.
        group: set[int] = set()
        border = {min(bad)}
        while border:
            group |= border
            neighbours = {tile + step for tile in border for step in (-risk.columns, risk.columns)}
            neighbours |= {tile - 1 for tile in border if tile % risk.columns}
            neighbours |= {tile + 1 for tile in border if (tile + 1) % risk.columns}
            border = (neighbours & bad) - group
        bad -= group
        rows, columns = zip(*(divmod(tile, risk.columns) for tile in group), strict=True)
        x, y = across[min(columns)], down[min(rows)]
        squares = [0.0] * len(REASONS)
        for tile in sorted(group):
            squares[risk.reasons[tile]] += levels[tile] ** 2
        places.append(
            Place(
                frame=frame.number,
                error=math.sqrt(sum(squares) / len(group)),
                x=x,
                y=y,
                width=across[max(columns) + 1] - x,
                height=down[max(rows) + 1] - y,
                reason=REASONS[squares.index(max(squares))],
            )
        )
    return sorted(places, key=lambda place: -place.error)[:MAX_PLACES_OF_FRAME]


def summarise_review(run: RunSummary) -> dict[str, Any] | None:
    """Return what report.json holds of it; None where no frame has a predicted error.

    ``predicted_error`` is in display levels of 0 to 255, and ``worst_frame`` has the largest one.
    ``places`` counts the rows of review.csv, and ``render`` is what review.txt holds, "" for none.
    """
    ranked = _rank_by_risk(run.frames)
    if not ranked:
        return None
    return {
        "predicted_error": {
            "mean": sum(float(error) for error, _ in ranked) / len(ranked),
            "worst": ranked[0][0],
            "worst_frame": ranked[0][1].number,
            "frames": len(ranked),
        },
        "places": len(places_worth_a_look(run)),
        "render": ranges(frames_worth_rendering(run.frames)),
    }
