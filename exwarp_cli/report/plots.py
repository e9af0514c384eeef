"""The plots of a page, as SVG that stands inside HTML; None in a series is what was not measured.

matplotlib draws with placeholder colours, which are replaced by the variables of the page's style
sheet, so that plots follow its light and dark themes.
"""

from __future__ import annotations

import io
import logging
import math
import re
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup, escape

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

Values = Sequence[float | None]

# Colours of series: --c0 to --c6 of the style sheet, after Okabe and Ito.
SERIES = 7

# Further colours of the style sheet that plots use.
ROLES = (
    *("fg", "muted", "grid", "warp", "extrapolate", "hold", "blend", "interpolate", "key", "mark"),
    *("bg", "softsplat", "lookahead", "rendered"),
)

# A placeholder for each name, which matplotlib draws with.
COLOURS = {role: f"#fe01{i:02x}" for i, role in enumerate(ROLES)} | {
    f"c{i}": f"#fe02{i:02x}" for i in range(SERIES)
}

# Of series in their order: colour is never all that distinguishes them.
MARKERS = ("o", "s", "^", "D", "v", "P", "X")

# What makes a frame, and the marker of its points.
KINDS = {
    "warp": "o",
    "extrapolate": "^",
    "hold": "x",
    "softsplat": "s",
    "blend": "P",
    "interpolate": "v",
    "lookahead": "*",
    "key": "D",
    "rendered": "d",
}

MAX_POINTS = 2000  # of a line

WIDTH = 7.2  # of a plot, inches of 72 units

# Stands before every id of a plot until the page gives it a number.
IDS = "%PLOT%"

SCATTER_COLUMNS = 3

# The timeline: columns at most (more intervals share one), and sizes in pixels.
TIMELINE_COLUMNS = 600
LEFT, TIMELINE_WIDTH, ROW, LEGEND = 46, 520, 22, 18

SETTINGS: dict[Any, Any] = {
    # Of series, as "C0", "C1" …, over and over.
    "axes.prop_cycle": f"cycler(color={[COLOURS[f'c{i}'] for i in range(SERIES)]})",
    "svg.fonttype": "none",
    "svg.hashsalt": "exwarp",
    "text.parse_math": False,  # a dollar sign in a name is one
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": COLOURS["muted"],
    "axes.labelcolor": COLOURS["muted"],
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": COLOURS["grid"],
    "grid.linewidth": 0.6,
    "text.color": COLOURS["fg"],
    "xtick.color": COLOURS["muted"],
    "ytick.color": COLOURS["muted"],
    "legend.frameon": False,
    "legend.fontsize": 9,
    "legend.loc": "lower left",
    "legend.borderaxespad": 0.2,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 1.4,
    "lines.color": COLOURS["fg"],  # of those that belong to no series
    "lines.linewidth": 1.4,
    "patch.edgecolor": COLOURS["bg"],
    "patch.force_edgecolor": True,
    "patch.linewidth": 0.5,
}

# Around a marked frame.
RING: dict[str, Any] = {"markersize": 9, "markeredgewidth": 1.6, "fillstyle": "none"}


@dataclass(frozen=True)
class Labels:
    """What is written on a plot."""

    title: str  # heading above it
    x: str = ""  # axes, with units; empty for none
    y: str = ""
    description: str = ""  # what it shows in a sentence, for those who do not see it
    note: str = ""  # a line below it


@dataclass(frozen=True)
class Figure:
    """A plot for a page."""

    labels: Labels
    svg: str  # with `IDS` before every id

    def numbered(self, name: str) -> Markup:
        """Return the SVG with ids that begin with a name, which has to be unique in the page."""
        return Markup(self.svg.replace(IDS, f"{name}-"))


@dataclass(frozen=True)
class TimelineCell:
    """One cell of a timeline: a kind out of `KINDS`, and the text shown on hover."""

    kind: str
    hint: str


def draw_lines(
    labels: Labels,
    x: Sequence[float],
    series: Mapping[str, Values],
    marked: int | None = None,
    cuts: Sequence[float] = (),
) -> Figure:
    """Draw series over a common axis.

    `marked` is the index into `x` that gets a ring; an upright line stands before each frame that
    comes after one of the `cuts`.
    """
    with _canvas(2.3) as canvas:
        axes = canvas.add_subplot(xlabel=labels.x, ylabel=labels.y)
        at = np.asarray(x)
        for i, (name, values) in enumerate(series.items()):
            points, y = thin_out(values), np.array(values, float)  # None becomes NaN
            marker = MARKERS[i % len(MARKERS)] if len(points) <= 60 else None
            axes.plot(at[points], y[points], label=name, marker=marker, markersize=3.5)
            if marked is not None and values[marked] is not None:
                axes.plot(x[marked], y[marked], "o", color=COLOURS["mark"], zorder=5, **RING)
        _mark_frames(axes, x, cuts)
        _draw_legend(axes, len(series))
        return _finish(canvas, labels)


def draw_points(
    labels: Labels,
    x: Sequence[float],
    values: Values,
    kinds: Sequence[str],
    cuts: Sequence[float] = (),
) -> Figure:
    """Draw one value a frame, coloured by what made the frame, a word out of KINDS each."""
    with _canvas(2.5) as canvas:
        axes = canvas.add_subplot(xlabel=labels.x, ylabel=labels.y)
        at, points, y = np.asarray(x), thin_out(values), np.array(values, float)
        axes.plot(at[points], y[points], color=COLOURS["grid"], linewidth=1)
        for kind in dict.fromkeys(kinds):
            of_kind = [j for j in points if kinds[j] == kind and values[j] is not None]
            if of_kind:
                marker, colour = KINDS.get(kind, "."), COLOURS[kind_role(kind)]
                axes.plot(at[of_kind], y[of_kind], marker, color=colour, markersize=4, label=kind)
        _mark_frames(axes, x, cuts)
        _draw_legend(axes, len(set(kinds)))
        return _finish(canvas, labels)


def draw_bars(
    labels: Labels,
    groups: Sequence[str],
    series: Mapping[str, Values],
    references: Mapping[str, Values] | None = None,
) -> Figure:
    """Draw groups of bars with their names below: in each, a bar of every series.

    `references` are, by series, values that are marked across its bars: the paper's.
    """
    width = 0.8 / len(series)
    is_in_legend = False  # the first mark stands for all
    with _canvas(2.6) as canvas:
        axes = canvas.add_subplot(xlabel=labels.x, ylabel=labels.y)
        for i, (name, values) in enumerate(series.items()):
            x = [group - 0.4 + width * (i + 0.5) for group in range(len(groups))]
            hatch = "///" if i >= SERIES else None
            y = np.array(values, float)
            axes.bar(x, y, width * 0.92, label=name, hatch=hatch, linewidth=0)
            pairs = zip(x, (references or {}).get(name, ()), strict=False)
            marks = [(a, mark) for a, mark in pairs if mark is not None]
            at, lines = np.array(marks, float).reshape(-1, 2).T
            label = "paper" if marks and not is_in_legend else "_"
            axes.hlines(lines, at - width / 2, at + width / 2, linewidth=2, label=label)
            is_in_legend |= bool(marks)
        angle, side = (30, "right") if sum(map(len, groups)) > 70 else (0, "center")
        axes.set_xticks(range(len(groups)), groups, rotation=angle, ha=side)
        axes.grid(False, axis="x")
        _draw_legend(axes, len(series) + bool(references))
        return _finish(canvas, labels)


def draw_stacked_bars(
    labels: Labels, groups: Sequence[str], parts: Mapping[str, Values], kinds: bool = False
) -> Figure:
    """Draw one horizontal bar a group, made of parts: a length for each group, None counts as 0.

    `kinds` is True if the parts are named out of KINDS and coloured so.
    """
    with _canvas(1.1 + 0.34 * len(groups)) as canvas:
        axes = canvas.add_subplot(xlabel=labels.x, ylabel=labels.y)
        left = [0.0] * len(groups)
        for i, (name, values) in enumerate(parts.items()):
            lengths = [value or 0.0 for value in values]
            colour = COLOURS[kind_role(name)] if kinds else f"C{i}"
            hatch = "///" if i >= SERIES and not kinds else None  # colours repeat from here on
            axes.barh(range(len(groups)), lengths, 0.7, left, color=colour, label=name, hatch=hatch)
            left = [a + b for a, b in zip(left, lengths, strict=True)]
        axes.set_yticks(range(len(groups)), groups)
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        _draw_legend(axes, max(len(parts), 2))
        return _finish(canvas, labels)


def draw_histogram(labels: Labels, edges: Sequence[float], counts: Sequence[float]) -> Figure:
    """Draw counts between edges as a filled outline."""
    with _canvas(2.1) as canvas:
        axes = canvas.add_subplot(xlabel=labels.x, ylabel=labels.y)
        axes.stairs(counts, edges, fill=True, edgecolor="none")
        return _finish(canvas, labels)


def draw_scatter(
    labels: Labels, panels: Mapping[str, Sequence[float]], y: Sequence[float]
) -> Figure:
    """Draw small scatter plots of `y` over each of the panels, in rows of `SCATTER_COLUMNS`."""
    rows = math.ceil(len(panels) / SCATTER_COLUMNS)
    points = thin_out(y)
    with _canvas(0.4 + 1.9 * rows) as canvas:
        grid = canvas.subplots(rows, SCATTER_COLUMNS, sharey=True, squeeze=False)
        for axes in grid.flat[len(panels) :]:
            axes.set_visible(False)
        for i, ((title, x), axes) in enumerate(zip(panels.items(), grid.flat, strict=False)):
            at, values = np.asarray(x)[points], np.asarray(y)[points]
            axes.scatter(at, values, s=7, alpha=0.55, linewidths=0)
            axes.set_title(title)
            if i % SCATTER_COLUMNS == 0:
                axes.set_ylabel(labels.y)
        return _finish(canvas, labels)


def draw_series_panels(labels: Labels, x: Sequence[float], series: Mapping[str, Values]) -> Figure:
    """Draw a small line plot for each series below each other, each with its own y axis."""
    with _canvas(0.5 + 0.75 * len(series)) as canvas:
        grid = canvas.subplots(len(series), 1, sharex=True, squeeze=False)
        for axes, (name, values) in zip(grid.flat, series.items(), strict=True):
            points = thin_out(values)
            axes.plot(np.asarray(x)[points], np.array(values, float)[points])
            axes.set_ylabel(name, rotation=0, ha="right", va="center")
            axes.locator_params(axis="y", nbins=3)
            _mark_frames(axes, x)
        grid.flat[-1].set_xlabel(labels.x)
        return _finish(canvas, labels)


def draw_timeline(
    labels: Labels,
    rows: Sequence[str],
    columns: Sequence[Sequence[TimelineCell | None]],
    kinds: Sequence[str],
) -> Figure:
    """Draw coloured cells: a row a slot, from the top, and a column a key interval.

    Cells that are None stay empty. Of more than TIMELINE_COLUMNS, neighbours share a column: its
    colour is the most frequent, and its hint counts the others. `kinds` are those that appear, for
    the legend.
    """
    shared = [list(column) for column in columns]
    if len(columns) > TIMELINE_COLUMNS:
        shared = [[] for _ in range(TIMELINE_COLUMNS)]
        bounds = [i * len(columns) // TIMELINE_COLUMNS for i in range(TIMELINE_COLUMNS + 1)]
        for column, (start, stop) in zip(shared, pairwise(bounds), strict=True):
            for cells in zip(*columns[start:stop], strict=True):
                filled = [cell for cell in cells if cell is not None]
                counts = Counter(cell.kind for cell in filled).most_common()
                listed = ", ".join(f"{kind} {count}" for kind, count in counts)
                hint = f"{filled[0].hint} and {len(filled) - 1} more: {listed}" if filled else ""
                column.append(TimelineCell(counts[0][0], hint) if filled else None)
    step = TIMELINE_WIDTH / max(len(shared), 1)
    gap = 0.6 if step > 3 else 0
    height = ROW * len(rows)
    parts = [_svg_opening(f"0 0 {LEFT + TIMELINE_WIDTH} {height + LEGEND}", labels)]
    x = LEFT
    for kind in kinds:
        parts.append(
            f'<rect x="{x}" y="{height + 6}" width="9" height="9" class="k-{kind_role(kind)}"/>'
            f'<text class="word" x="{x + 13}" y="{height + 14}">{escape(kind)}</text>'
        )
        x += 26 + 6 * len(kind)
    for r, name in enumerate(rows):
        y = r * ROW
        parts.append(
            f'<text class="name" x="{LEFT - 6}" y="{y + ROW * 0.68:g}">{escape(name)}</text>'
        )
        for c, column in enumerate(shared):
            if (cell := column[r]) is not None:
                parts.append(
                    f'<rect x="{LEFT + c * step:.2f}" y="{y + 1}" width="{step - gap:.2f}" '
                    f'height="{ROW - 2}" class="k-{kind_role(cell.kind)}">'
                    f"<title>{escape(cell.hint)}</title></rect>"
                )
    return Figure(labels, "".join(parts) + "</svg>")


def thin_out(values: Values) -> list[int]:
    """Return the indices to draw: all, or the lowest and highest of MAX_POINTS / 2 stretches.

    So no single bad frame is lost from a long sequence.
    """
    if len(values) <= MAX_POINTS:
        return list(range(len(values)))
    stretches = MAX_POINTS // 2
    indices: set[int] = set()
    for i in range(stretches):
        span = range(i * len(values) // stretches, (i + 1) * len(values) // stretches)
        measured = [(value, j) for j in span if (value := values[j]) is not None]
        indices.update({min(measured)[1], max(measured)[1]} if measured else {span[0]})
    return sorted(indices)


def kind_role(kind: str) -> str:
    """Return the role whose colour stands for what makes a frame, a word out of `KINDS`."""
    return kind if kind in ROLES else "muted"


def _mark_frames(axes: Axes, x: Sequence[float], cuts: Sequence[float] = ()) -> None:
    """Draw a line before each frame after a cut; let no tick stand between two frames."""
    for number in cuts:
        axes.axvline(number - 0.5, linestyle="--", linewidth=1, zorder=1)
    if all(float(value).is_integer() for value in x):
        if len(set(x)) == 1:
            axes.set_xlim(x[0] - 0.5, x[0] + 0.5)
            axes.set_xticks([x[0]])
        else:
            axes.locator_params(axis="x", integer=True)


def _draw_legend(axes: Axes, count: int) -> None:
    """Put a legend above the plot, where it hides nothing; none for a single series."""
    handles, names = axes.get_legend_handles_labels()
    if count > 1 and handles:
        axes.legend(handles, names, bbox_to_anchor=(0, 1.0), ncols=min(len(names), 5))


@contextmanager
def _canvas(height: float) -> Iterator[Canvas]:
    """Yield a canvas, `height` inches high, without settings of the user's own matplotlib.

    Messages on its caches and fonts, which begin on import, are suppressed.
    """
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import matplotlib
            from matplotlib.figure import Figure as Canvas

            with matplotlib.rc_context():
                matplotlib.rcdefaults()
                matplotlib.rcParams.update(SETTINGS)
                yield Canvas(figsize=(WIDTH, height), layout="constrained")
    finally:
        log.setLevel(level)


def _finish(canvas: Canvas, labels: Labels) -> Figure:
    """Turn a canvas into an SVG element for HTML; the same input gives the same text.

    Letters that matplotlib's fonts lack do not matter, as the browser writes the text.
    """
    file = io.StringIO()
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    canvas.savefig(file, format="svg", metadata=metadata, transparent=True)
    text = file.getvalue()
    # No prologue, fonts or global style.
    body = text[text.index("<svg") :]
    body = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>", "", body, count=1, flags=re.DOTALL)
    box = re.findall(r'viewBox="([^"]*)"', body)[0]
    body = body[body.index(">") + 1 :]
    body = re.sub(r'(<g) id="[^"]*"', r"\1", body)
    body = body.replace("xlink:href", "href")
    body = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{IDS}", body)
    body = re.sub(r"font-size: ([0-9.]+)px; font-family: [^;\"]*", r"font-size: \1px", body)
    for name, colour in COLOURS.items():
        body = body.replace(colour, f"var(--{name})")
    body = re.sub(r"\s*\n\s*", " ", body)
    return Figure(labels, _svg_opening(box, labels) + body.rstrip())


def _svg_opening(view_box: str, labels: Labels) -> str:
    title, description = escape(labels.title), escape(labels.description or labels.title)
    return (
        f'<svg class="plot" viewBox="{view_box}" role="img" '
        f'aria-labelledby="{IDS}title {IDS}desc">'
        f'<title id="{IDS}title">{title}</title><desc id="{IDS}desc">{description}</desc>'
    )
