"""Tables of a report as CSV: frames.csv, and review.csv with the frames of review.txt."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from typing import Any

from exwarp_cli.domain.decision import FEATURES
from exwarp_cli.domain.results import FrameRecord, Score
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.report.review import PLACE_COLUMNS, Place, frames_worth_rendering
from exwarp_cli.report.schema import replace_nonfinite, score_values, timed_steps

FIRST_SCORES = ("psnr_db", "ssim", "flip")
# Metrics whose columns came later and so stand behind the others; VMAF is one of whole frames.
LATER_SCORES = ("hdr_flip", "vmaf", "flicker")
LATER_HOLE_SCORES = ("hdr_flip", "flicker")
LATER_COLUMNS = (*LATER_SCORES, *(f"{name}_holes" for name in LATER_HOLE_SCORES))

# Lines of the table are read by position, too: a new column goes to the end. The timed steps stand
# behind these, each as <step>_ms.
COLUMNS = (
    *("frame", "file", "key", "slot", "kind", "method", "sources"),
    *("hole_fraction", "nonfinite_pixels", *FIRST_SCORES),
    *(f"{name}_holes" for name in FIRST_SCORES),
    *("resumed", "made_by", "path", "node", "choice", "output_warp", "output_extrapolate"),
    *FEATURES,
    # What the policy's network saw, in Q16.16, with spaces between.
    "inputs",
    *LATER_COLUMNS,
    *("render_s", "render_source"),
    # Of the features: R is width x height, EMD_Wp is judged by the distance.
    *("rendered_width", "rendered_height", "distance"),
    # True where there was ground truth, whatever was measured.
    *("scored", "scored_holes"),
    "replaced",
    # Against ground truth where `scored` is true, else against the key frames.
    "pulse",
    # RMS of the frame in display levels of 0 to 255, and that of its tiles: see `domain.tiles`.
    *("predicted_error", "risk"),
    # The key frame that the gate predicted, and the PSNR of both predictions.
    "gate",
    # What made each tile, row by row: w for warping, e for the network, r for warping what the
    # network made of the slot before.
    "tiles",
    # Numbers of frames that were rendered after all.
    "rendered_sources",
)

_FORMULA = (*"=+-@'", "\t", "\r", "\n")


def format_frames_csv(frames: tuple[FrameRecord, ...]) -> str:
    """Write the records as CSV text: a header line, then a row a frame in the given order.

    An empty cell is what was not measured or decided; `sources` are frame numbers with spaces
    between.
    """
    steps = timed_steps(frames)
    rows = ([*_frame_cells(frame), *map(frame.timing_ms.get, steps)] for frame in frames)
    return format_csv([*COLUMNS, *(f"{step}_ms" for step in steps)], rows)


def format_review_csv(places: Sequence[Place]) -> str:
    """Write places as CSV, a row each; the error with one decimal."""
    rows = ((p.frame, round(p.error, 1), p.x, p.y, p.width, p.height, p.reason) for p in places)
    return format_csv(PLACE_COLUMNS, rows)


def format_review_txt(frames: Iterable[FrameRecord]) -> str:
    """Write which frames are most worth rendering, as farms take them: ``12,15-18``, or nothing."""
    numbers = ranges(frames_worth_rendering(frames))
    return f"{numbers}\n" if numbers else ""


def format_csv(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a header and rows as CSV text with ``\\n`` line ends; floats keep all their digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([format_cell(value) for value in row] for row in rows)
    # A file name need not be valid Unicode; what cannot be encoded is spelled out. So is a carriage
    # return, which older versions of the writer do not quote and every reader ends a row at.
    plain = text.getvalue().replace("\r", "\\r")
    return plain.encode("utf-8", "backslashreplace").decode("utf-8")


def format_cell(value: Any) -> str:
    """Write a cell: empty for None, NaN and infinities; ``true`` and ``false`` in words."""
    value = replace_nonfinite(value)
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


def escape_formula(name: str | None) -> str | None:
    """Put an apostrophe before a name that a spreadsheet would run as a formula."""
    return f"'{name}" if name is not None and name.startswith(_FORMULA) else name


def first_score_cells(score: Score | None) -> list[float | None]:
    """Return the cells of `FIRST_SCORES`."""
    return [score_values(score)[name] for name in FIRST_SCORES]


def later_score_cells(score: Score | None, holes: Score | None) -> list[float | None]:
    """Return the cells of `LATER_COLUMNS`."""
    frame, inside = score_values(score), score_values(holes)
    return [
        *(frame[name] for name in LATER_SCORES),
        *(inside[name] for name in LATER_HOLE_SCORES),
    ]


def _frame_cells(frame: FrameRecord) -> list[Any]:
    decision = frame.decision
    features = None if decision is None else decision.features
    return [
        *(frame.number, escape_formula(frame.file), frame.key, frame.slot),
        *(frame.kind.value, frame.method, _join(frame.sources)),
        *(frame.hole_fraction, frame.nonfinite_pixels),
        *first_score_cells(frame.score),
        *first_score_cells(frame.hole_score),
        *(frame.resumed, frame.made_by, frame.path),
        *((None, None) if decision is None else (decision.node, decision.choice)),
        *((decision.outputs if decision else None) or (None, None)),
        *((None,) * len(FEATURES) if features is None else features.values),
        (_join(decision.inputs) or None) if decision else None,
        *later_score_cells(frame.score, frame.hole_score),
        *(frame.render or (None, None)),
        *((features.width, features.height, features.distance) if features else (None,) * 3),
        *(frame.score is not None, frame.hole_score is not None, frame.replaced, frame.pulse),
        *((frame.risk.error, frame.risk.text) if frame.risk else (None, None)),
        frame.trial.text if frame.trial else None,
        frame.tiles.text if frame.tiles else None,
        _join(frame.rendered_sources) or None,
    ]


def _join(numbers: Iterable[int]) -> str:
    return " ".join(map(str, numbers))
