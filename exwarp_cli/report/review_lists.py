"""review.csv and review.txt: places worth a look, and frames worth rendering after all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from exwarp_cli.domain.results import FrameRecord
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.report.frames_csv import table
from exwarp_cli.report.review import Place, worth_rendering

COLUMNS = ("frame", "predicted_error", "x", "y", "width", "height", "why")


def review_csv(places: Sequence[Place]) -> str:
    """Write places as CSV, a row each; the error with one decimal."""
    rows = ((p.frame, round(p.error, 1), p.x, p.y, p.width, p.height, p.reason) for p in places)
    return table(COLUMNS, rows)


def review_txt(frames: Iterable[FrameRecord]) -> str:
    """Write which frames are most worth rendering, as farms take them: ``12,15-18``, or nothing."""
    numbers = ranges(worth_rendering(frames))
    return f"{numbers}\n" if numbers else ""
