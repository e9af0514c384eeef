"""frames.csv: a row for every written frame."""

from __future__ import annotations

import csv
import io
from collections.abc import Collection, Iterable, Sequence
from typing import Any

from exwarp_cli.domain.decision import FEATURES, Decision
from exwarp_cli.domain.results import FrameRecord, Score
from exwarp_cli.report.quality import values_of
from exwarp_cli.report.summary import finite, steps_of

FIRST_SCORES = ("psnr_db", "ssim", "flip")
LATER_SCORES = ("hdr_flip", "vmaf", "flicker")
"""Metrics whose columns came later and so stand behind the others."""

LATER_HOLE_SCORES = ("hdr_flip_holes", "flicker_holes")
"""VMAF is one of whole frames only."""

COLUMNS = (
    *("frame", "file", "key", "slot", "kind", "method", "sources"),
    *("hole_fraction", "nonfinite_pixels", "psnr_db", "ssim", "flip"),
    *("psnr_db_holes", "ssim_holes", "flip_holes", "resumed"),
    *("made_by", "path", "node", "choice", "output_warp", "output_extrapolate"),
    *FEATURES,
    "inputs",
    *LATER_SCORES,
    *LATER_HOLE_SCORES,
    *("render_s", "render_source", "rendered_width", "rendered_height", "distance"),
    *("scored", "scored_holes", "replaced", "pulse"),
    *("predicted_error", "risk"),
    *("gate", "tiles", "rendered_sources"),
)
"""A column that is new goes to the end: a line of this table is read by position, too.

`rendered_width`, `rendered_height` and `distance` belong to the features: R is the product of the
first two, EMD_Wp is judged by the last. `scored` and `scored_holes` are true where there was ground
truth, whatever was measured. `replaced` is true where a file made way for the frame. `pulse` is
against ground truth where `scored` is true, else against the key frames. `predicted_error` is the
RMS error that a new frame is expected to have, in display levels of 0 to 255, and `risk` that of
its tiles, see `exwarp_cli.domain.tiles`. `gate` is what a network's use was decided by: the key
frame that was predicted, and the PSNR of both predictions. `tiles` is what made each tile of a
frame, row by row: w for warping, e for the network, r for warping what the network made of the slot
before. `rendered_sources` are the numbers of frames that were rendered after all. After these
columns come the timed steps, each as ``<step>_ms``.
"""

ADDED_COLUMNS = ("pulse", "predicted_error", "risk", "gate", "tiles", "rendered_sources")
"""Columns that tables of earlier versions may lack."""


_FORMULA = (*"=+-@'", "\t", "\r", "\n")


def frames_csv(frames: tuple[FrameRecord, ...], without: Collection[str] = ()) -> str:
    """Write the records as CSV text: a header line, then a row a frame in the given order.

    An empty cell is what was not measured or decided; `sources` are frame numbers with spaces
    between, and so are `inputs`, what the policy's network saw in Q16.16. Columns named in
    `without`, out of `ADDED_COLUMNS`, are left out, as an earlier version wrote it.
    """
    steps = steps_of(frames)
    header = [*COLUMNS, *(f"{step}_ms" for step in steps)]
    kept = [i for i, name in enumerate(header) if name not in without]
    rows = (_row(frame, steps) for frame in frames)
    return table([header[i] for i in kept], ([row[i] for i in kept] for row in rows))


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Write a header and rows as CSV text with ``\\n`` line ends; floats keep all their digits."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([cell(value) for value in row] for row in rows)
    # A file name need not be valid Unicode; what cannot be encoded is spelled out. So is a carriage
    # return, which older versions of the writer do not quote and every reader ends a row at.
    plain = text.getvalue().replace("\r", "\\r")
    return plain.encode("utf-8", "backslashreplace").decode("utf-8")


def cell(value: Any) -> str:
    """Text of one cell: nothing for None, NaN and infinities, ``true`` and ``false`` in words."""
    value = finite(value)
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


def name_cell(name: str | None) -> str | None:
    """Write a name that others chose so that no spreadsheet takes it for a formula and runs it.

    An apostrophe in front says that it is text; `named` takes it away.
    """
    return f"'{name}" if name is not None and name.startswith(_FORMULA) else name


def named(text: str) -> str:
    """Read what `name_cell` wrote."""
    return text.removeprefix("'")


def score_cells(score: Score | None) -> tuple[float | None, ...]:
    """Cells of `FIRST_SCORES`."""
    return tuple(values_of(score)[name] for name in FIRST_SCORES)


def later_cells(score: Score | None, holes: Score | None) -> tuple[float | None, ...]:
    """Cells of `LATER_SCORES` and of `LATER_HOLE_SCORES`."""
    overall, inside = values_of(score), values_of(holes)
    return (
        *(overall[name] for name in LATER_SCORES),
        *(inside[name.removesuffix("_holes")] for name in LATER_HOLE_SCORES),
    )


def decision_cells(decision: Decision | None) -> tuple[Any, ...]:
    """Node, choice, both outputs, the features and the inputs; empty where nothing was decided."""
    if decision is None:
        return (None,) * (5 + len(FEATURES))
    return (
        *(decision.node, decision.choice),
        *(decision.outputs or (None, None)),
        *((None,) * len(FEATURES) if decision.features is None else decision.features.values),
        " ".join(map(str, decision.inputs)) or None,
    )


def seen_cells(decision: Decision | None) -> tuple[float | None, ...]:
    """Width, height and distance of what a decision's features were taken of."""
    seen = None if decision is None else decision.features
    return (None,) * 3 if seen is None else (seen.width, seen.height, seen.distance)


def _row(frame: FrameRecord, steps: list[str]) -> list[Any]:
    return [
        *(
            frame.number,
            name_cell(frame.file),
            frame.key,
            frame.slot,
            frame.kind.value,
            frame.method,
        ),
        " ".join(str(number) for number in frame.sources),
        *(frame.hole_fraction, frame.nonfinite_pixels),
        *score_cells(frame.score),
        *score_cells(frame.hole_score),
        frame.resumed,
        *(frame.made_by, frame.path),
        *decision_cells(frame.decision),
        *later_cells(frame.score, frame.hole_score),
        *(frame.render or (None, None)),
        *seen_cells(frame.decision),
        *(frame.score is not None, frame.hole_score is not None, frame.replaced, frame.pulse),
        *((None, None) if frame.risk is None else (frame.risk.error, frame.risk.text)),
        None if frame.trial is None else frame.trial.text,
        None if frame.tiles is None else frame.tiles.text,
        " ".join(map(str, frame.rendered_sources)) or None,
        *(frame.timing_ms.get(step) for step in steps),
    ]
