"""The plots of a page, each a `plot_style.Figure`; None in any series is what was not measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from exwarp_cli.report.plot_style import (
    COLOURS,
    MARKERS,
    SERIES,
    Figure,
    Labels,
    draw,
    draw_panels,
    kind_role,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Canvas

Values = Sequence[float | None]

POINTS = 2000
"""Points of a line at most."""

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
"""What makes a frame, and the marker of its points."""


def lines(
    labels: Labels,
    x: Sequence[float],
    series: Mapping[str, Values],
    marked: Sequence[int] = (),
    cuts: Sequence[float] = (),
) -> Figure:
    """Draw series over a common axis.

    `marked` are indices into `x` that get a ring; an upright line stands before each frame that
    comes after one of the `cuts`.
    """

    def paint(axes: Axes) -> None:
        for i, (name, values) in enumerate(series.items()):
            kept = thinned(values)
            few = len(kept) <= 60
            axes.plot(
                [x[j] for j in kept], _numbers([values[j] for j in kept]), color=_series(i),
                label=name, marker=MARKERS[i % len(MARKERS)] if few else None, markersize=3.5,
            )  # fmt: skip
            spots = [(x[j], values[j]) for j in marked if values[j] is not None]
            _rings(axes, spots)
        _upright(axes, cuts)
        _whole_frames(axes, x)
        _legend(axes, len(series))

    return draw(labels, 2.3, paint)


def points(
    labels: Labels,
    x: Sequence[float],
    values: Values,
    kinds: Sequence[str],
    marked: Sequence[int] = (),
    cuts: Sequence[float] = (),
) -> Figure:
    """Draw one value a frame, coloured by what made the frame, a word out of KINDS each.

    `marked` and `cuts` are as in :func:`lines`.
    """

    def paint(axes: Axes) -> None:
        kept = thinned(values)
        axes.plot(
            [x[j] for j in kept], _numbers([values[j] for j in kept]),
            color=COLOURS["grid"], linewidth=1,
        )  # fmt: skip
        for kind in dict.fromkeys(kinds):
            chosen = [j for j in kept if kinds[j] == kind and values[j] is not None]
            if chosen:
                axes.plot(
                    [x[j] for j in chosen], _numbers([values[j] for j in chosen]), linestyle="none",
                    color=_kind(kind), marker=KINDS.get(kind, "."), markersize=4, label=kind,
                )  # fmt: skip
        _rings(axes, [(x[j], values[j]) for j in marked if values[j] is not None])
        _upright(axes, cuts)
        _whole_frames(axes, x)
        _legend(axes, len(set(kinds)))

    return draw(labels, 2.5, paint)


def bars(
    labels: Labels,
    groups: Sequence[str],
    series: Mapping[str, Values],
    references: Mapping[str, Values] | None = None,
) -> Figure:
    """Draw a group of bars for each name.

    Parameters
    ----------
    groups
        Names below the groups.
    series
        A value for each group; a bar of each in every group.
    references
        By series, values that are marked across its bars: the paper's.
    """
    width = 0.8 / max(len(series), 1)

    def paint(axes: Axes) -> None:
        for i, (name, values) in enumerate(series.items()):
            at = [g - 0.4 + width * (i + 0.5) for g in range(len(groups))]
            axes.bar(
                at, _numbers(values), width * 0.92, color=_series(i), label=name,
                hatch="///" if i >= SERIES else None, edgecolor=COLOURS["bg"], linewidth=0,
            )  # fmt: skip
            marks = (references or {}).get(name, ())
            known = [(a, m) for a, m in zip(at, marks, strict=False) if m is not None]
            axes.hlines(
                [m for _, m in known], [a - width / 2 for a, _ in known],
                [a + width / 2 for a, _ in known], color=COLOURS["fg"], linewidth=2,
                label="paper" if known and name == _first(references) else "_",
            )  # fmt: skip
        _names(axes, groups)
        _legend(axes, len(series) + bool(references))

    return draw(labels, 2.6, paint)


def stacked_bars(
    labels: Labels,
    groups: Sequence[str],
    parts: Mapping[str, Values],
    kinds: bool = False,
    note: str = "",
) -> Figure:
    """Draw one lying bar a group, made of parts.

    Parameters
    ----------
    groups
        Names beside the bars.
    parts
        A length for each group; None counts as 0.
    kinds
        Whether the parts are named out of KINDS and coloured so.
    note
        A line below it.
    """

    def paint(axes: Axes) -> None:
        left = [0.0] * len(groups)
        for i, (name, values) in enumerate(parts.items()):
            lengths = [value or 0.0 for value in values]
            colour = _kind(name) if kinds else _series(i)
            hatch = "///" if i >= SERIES and not kinds else None  # colours have come round
            axes.barh(
                range(len(groups)), lengths, 0.7, left=left, label=name, color=colour, hatch=hatch,
                edgecolor=COLOURS["bg"], linewidth=0.5,
            )  # fmt: skip
            left = [a + b for a, b in zip(left, lengths, strict=True)]
        axes.set_yticks(range(len(groups)), [str(g) for g in groups])
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        _legend(axes, max(len(parts), 2))

    return draw(labels, 1.1 + 0.34 * len(groups), paint, note)


def histogram(
    labels: Labels, edges: Sequence[float], counts: Mapping[str, Sequence[float]]
) -> Figure:
    """Draw counts between edges, one step line a series; a single one is filled."""

    def paint(axes: Axes) -> None:
        for i, (name, values) in enumerate(counts.items()):
            axes.stairs(
                values, edges, label=name, color=_series(i), fill=len(counts) == 1, linewidth=1.6
            )
        _legend(axes, len(counts))

    return draw(labels, 2.1, paint)


@dataclass(frozen=True)
class Panel:
    """One small scatter plot: a title, its points, and a line such as the correlation."""

    title: str
    x: Sequence[float]
    y: Sequence[float]
    note: str = ""


def scatter(labels: Labels, panels: Sequence[Panel], columns: int = 3) -> Figure:
    """Draw small scatter plots with a common y axis, in rows of `columns`."""
    rows = max(math.ceil(len(panels) / columns), 1)

    def paint(canvas: Canvas) -> None:
        grid = canvas.subplots(rows, min(columns, max(len(panels), 1)), sharey=True, squeeze=False)
        for axes in grid.flat[len(panels) :]:
            axes.set_visible(False)
        for i, (panel, axes) in enumerate(zip(panels, grid.flat, strict=False)):
            kept = thinned(panel.y)
            axes.scatter(
                [panel.x[j] for j in kept], [panel.y[j] for j in kept], s=7, alpha=0.55,
                color=COLOURS["c0"], linewidths=0,
            )  # fmt: skip
            axes.set_title(panel.title)
            axes.set_xlabel(panel.note)
            if i % columns == 0:
                axes.set_ylabel(labels.y)

    return draw_panels(labels, 0.4 + 1.9 * rows, paint)


def series_panels(labels: Labels, x: Sequence[float], series: Mapping[str, Values]) -> Figure:
    """Draw a small line plot for each series below each other, each with its own y axis."""

    def paint(canvas: Canvas) -> None:
        grid = canvas.subplots(len(series), 1, sharex=True, squeeze=False)
        for axes, (name, values) in zip(grid.flat, series.items(), strict=True):
            kept = thinned(values)
            axes.plot([x[j] for j in kept], _numbers([values[j] for j in kept]), color=_series(0))
            axes.set_ylabel(name, rotation=0, ha="right", va="center")
            axes.locator_params(axis="y", nbins=3)
            _whole_frames(axes, x)
        grid.flat[-1].set_xlabel(labels.x)

    return draw_panels(labels, 0.5 + 0.75 * max(len(series), 1), paint)


def thinned(values: Values, limit: int = POINTS) -> list[int]:
    """Return the indices to draw: all, or the lowest and highest of `limit` / 2 stretches.

    So no single bad frame is lost from a long sequence.
    """
    if len(values) <= limit:
        return list(range(len(values)))
    stretches = limit // 2
    kept: set[int] = set()
    for i in range(stretches):
        span = range(i * len(values) // stretches, (i + 1) * len(values) // stretches)
        known = [(value, j) for j in span if (value := values[j]) is not None]
        kept.update({min(known)[1], max(known)[1]} if known else {span[0]})
    return sorted(kept)


def _numbers(values: Values) -> list[float]:
    return [math.nan if value is None else float(value) for value in values]


def _series(index: int) -> str:
    return COLOURS[f"c{index % SERIES}"]


def _kind(name: str) -> str:
    return COLOURS[kind_role(name)]


def _whole_frames(axes: Axes, x: Sequence[float]) -> None:
    """Let no tick fall between two frames, nor a single one stand in a row of fractions."""
    if not all(float(value).is_integer() for value in x):
        return
    axes.locator_params(axis="x", integer=True)
    if len(set(x)) == 1:
        axes.set_xlim(x[0] - 0.5, x[0] + 0.5)
        axes.set_xticks([x[0]])


def _first(references: Mapping[str, Values] | None) -> str | None:
    """Return the first series with a mark: only that one stands in the legend."""
    found = (references or {}).items()
    return next((name for name, marks in found if any(m is not None for m in marks)), None)


def _names(axes: Axes, groups: Sequence[str]) -> None:
    long = sum(len(str(g)) for g in groups) > 70
    axes.set_xticks(
        range(len(groups)), [str(g) for g in groups],
        rotation=30 if long else 0, ha="right" if long else "center",
    )  # fmt: skip
    axes.grid(False, axis="x")


def _rings(axes: Axes, spots: Sequence[tuple[float, float | None]]) -> None:
    if spots:
        axes.plot(
            [a for a, _ in spots], _numbers([b for _, b in spots]), linestyle="none", marker="o",
            markersize=9, markerfacecolor="none", markeredgecolor=COLOURS["mark"], zorder=5,
            markeredgewidth=1.6,
        )  # fmt: skip


def _upright(axes: Axes, cuts: Sequence[float]) -> None:
    """Draw a line before each of these frames."""
    for number in cuts:
        axes.axvline(number - 0.5, color=COLOURS["fg"], linestyle="--", linewidth=1, zorder=1)


def _legend(axes: Axes, count: int) -> None:
    """Put a legend above the plot, where it hides nothing; none for a single series."""
    handles, names = axes.get_legend_handles_labels()
    if count > 1 and handles:
        axes.legend(
            handles, names, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=min(len(names), 5),
            borderaxespad=0.2, handlelength=1.4, columnspacing=1.4,
        )  # fmt: skip
