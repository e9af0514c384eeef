"""The one HTML file of a report: what it is made of, tables of scores, and how it becomes text.

A page is a headline of numbers and sections of blocks; it loads nothing from outside the file. Text
is escaped by the template, whatever it holds.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from markupsafe import Markup

from exwarp_cli import __version__
from exwarp_cli.domain.metric import METRICS, Metric
from exwarp_cli.domain.results import Score
from exwarp_cli.report.gallery import Album
from exwarp_cli.report.plots import ROLES, SERIES, Figure, Labels, Values, draw_lines
from exwarp_cli.report.schema import score_values
from exwarp_cli.report.sentences import format_number

# Colours that the error map is interpolated from, dark for none: matplotlib's magma in 24 steps.
HEAT = (
    "000004 060518 110c2f 1e1149 2f1163 420f75 54137d 651a80 782281 892881 9b2e7f ad347c "
    "bf3a77 d0416f e04c67 ed5a5f f66e5c fb835f fd9869 feac76 fec185 fed597 fde9aa fcfdbf"
)

MAX_WORST = 8  # frames in the table of the worst

BY_FIELD = {metric.field: metric for metric in METRICS}


@dataclass(frozen=True)
class Number:
    """One figure of the headline: its name, its value with unit, and a remark."""

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Link:
    """Text of a cell that leads to a place in the page, such as ``#viewer:12``."""

    text: str
    target: str


# Of a table; None was not measured. Columns that mostly read as numbers stand to the right.
Cell = str | Link | None


@dataclass(frozen=True)
class Table:
    """Rows under a heading, which may be empty; the first cell of each is the row's name."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]  # as many cells each
    note: str = ""  # a line below


Block = Table | str | Album | Figure  # text is a paragraph


@dataclass(frozen=True)
class Section:
    """A part of the page with a heading; `name` is unique: letters, digits and hyphens."""

    name: str
    title: str
    blocks: Sequence[Block]  # a section without any is left out


@dataclass(frozen=True)
class Page:
    """A whole page."""

    title: str  # of the window and the page
    subtitle: str
    numbers: Sequence[Number]  # the headline
    sections: Sequence[Section]


def render(page: Page) -> str:
    """Write a page as HTML; the same page gives the same text.

    It is valid Unicode: bytes of a file name that are none are spelled out as ``\\udcff``.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("exwarp_cli.report", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.tests["number_cell"] = is_number
    environment.filters |= {
        "kind_of": lambda block: type(block).__name__.lower(),
        "viewer_data": viewer_data,
    }
    text = environment.get_template("page.html").render(
        page=page,
        sections=[section for section in page.sections if section.blocks],
        version=__version__,
        roles=ROLES,
        series=range(SERIES),
    )
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def viewer_data(album: Album) -> Markup:
    """Return what the viewer's script reads; see `exwarp_cli.report.gallery`.

    It can stand inside a script element: no ``<``, only ASCII.
    """
    heat = [list(bytes.fromhex(colour)) for colour in HEAT.split()]
    plain = album.to_plain() | {"heat": heat, "fps": album.fps}
    text = json.dumps(plain, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)


_NUMBER = re.compile(r"[-+]?[0-9][0-9,]*([.][0-9]+)?( ?(%|dB|ms|s|fps|min|h|MB|KB))?")


def is_number(cell: Cell) -> bool:
    """Return whether a cell of a table reads as a number; None may stand for one."""
    return cell is None or (isinstance(cell, str) and _NUMBER.fullmatch(cell) is not None)


def file_name(pattern: str) -> str:
    """Return the last part of a path, or the path where there is none."""
    return PurePath(pattern).name or pattern


def metric_text(metric: Metric, value: float | None) -> str | None:
    """Write a metric's value without its unit; None stays None."""
    return None if value is None else metric.text(value)


def measured_metrics(*blocks: Mapping[str, Any]) -> list[Metric]:
    """Return the metrics that any of these has a value of."""
    return [m for m in METRICS if any(block.get(m.field) is not None for block in blocks)]


def better(metric: Metric) -> str:
    """Say which way a metric is good."""
    if metric.signed:
        return "0 is best"
    return "higher is better" if metric.more_is_better else "lower is better"


def quality_numbers(quality: Mapping[str, Any]) -> list[Number]:
    """Return the headline's numbers of a quality block; those not measured are left out."""
    return [
        Number(m.name, m.with_unit(quality[m.field]), better(m)) for m in measured_metrics(quality)
    ]


def quality_table(title: str, blocks: Mapping[str, Mapping[str, Any]], note: str = "") -> Table:
    """Write quality blocks of report.json, a row each; metrics that none has are left out."""
    metrics = measured_metrics(*blocks.values())
    rows = [
        [
            name,
            *(metric_text(m, block.get(m.field)) for m in metrics),
            format_number(block.get("frames"), 0),
        ]
        for name, block in blocks.items()
    ]
    return Table(title, ["", *(m.title for m in metrics), "frames"], rows, note)


def score_facts(score: Score | None, hole_score: Score | None) -> dict[str, str]:
    """Return what is written beside a frame about its quality."""
    row = score_values(score)
    facts = {m.name: m.with_unit(row[m.field] or 0.0) for m in measured_metrics(row)}
    if hole_score is not None and hole_score.psnr_db is not None:
        psnr = BY_FIELD["psnr_db"]
        facts[f"{psnr.name} in holes"] = psnr.with_unit(hole_score.psnr_db)
    return facts


def _series_by_metric(scores: Sequence[Score | None]) -> dict[Metric, Values]:
    rows = [score_values(score) for score in scores]
    return {m: [row[m.field] for row in rows] for m in measured_metrics(*rows)}


def metric_plots(
    numbers: Sequence[int],
    scores: Sequence[Score | None],
    skip: Iterable[str] = (),
    cuts: Sequence[int] = (),
    names: tuple[str, str] = ("", ""),
    beside: Sequence[Score | None] = (),
) -> list[Figure]:
    """Draw each measured metric over the frames, its worst frame ringed; nothing for one frame.

    `beside` are further scores of the same frames, or none; `names` are those of both.
    """
    if len(numbers) < 2:
        return []
    figures, others = [], _series_by_metric(beside)
    for metric, values in _series_by_metric(scores).items():
        if metric.field in skip:
            continue
        measured = [i for i, value in enumerate(values) if value is not None]
        worst = max(measured, key=lambda i: metric.badness(values[i] or 0.0))
        labels = Labels(
            f"{metric.name} per frame",
            "frame",
            metric.title,
            f"{metric.title} of every scored frame; {better(metric)}. Worst at frame "
            f"{numbers[worst]}.",
        )
        series = {names[0] or metric.title: values}
        if metric in others:
            series[names[1]] = others[metric]
        figures.append(draw_lines(labels, numbers, series, worst, cuts))
    return figures


def worst_tables(
    numbers: Sequence[int], scores: Sequence[Score | None], album: Album, makers: Sequence[str] = ()
) -> list[Table]:
    """List the worst frames by the first metric that was measured; no table where none was.

    `numbers`, `scores` and `makers`, unless empty, are those of every frame; numbers lead to the
    frames that `album` has.
    """
    series = _series_by_metric(scores)
    if not series:
        return []
    metric, values = next(iter(series.items()))
    rows: list[list[Cell]] = []
    measured = [i for i, value in enumerate(values) if value is not None]
    for i in sorted(measured, key=lambda i: -metric.badness(values[i] or 0.0))[:MAX_WORST]:
        cells = [metric_text(m, column[i]) for m, column in series.items()]
        rows.append([frame_cell(numbers[i], album), *cells, *makers[i : i + 1]])
    columns = ["frame", *(m.title for m in series), *(["made by"] if makers else [])]
    return [Table(f"Worst frames by {metric.name}", columns, rows)]


def frame_cell(number: int, album: Album) -> Cell:
    """Write a frame's number; it leads to the viewer if that has the frame."""
    return Link(str(number), f"#viewer:{number}") if number in album.frames else str(number)
