"""What pages have in common: how metrics are called and written, and tables of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import PurePath
from typing import Any

from exwarp_cli.domain.metric import METRICS, Metric
from exwarp_cli.domain.results import Score
from exwarp_cli.domain.timeline import ranges
from exwarp_cli.domain.wording import pluralise
from exwarp_cli.report.page import Cell, Link, Number, Table
from exwarp_cli.report.plot_style import Figure, Labels
from exwarp_cli.report.plots import Values, lines
from exwarp_cli.report.quality import values_of
from exwarp_cli.report.render_time import duration

WORST = 8
"""Frames in the table of the worst."""

BY_FIELD = {metric.field: metric for metric in METRICS}


def metric_text(metric: Metric, value: float | None) -> str | None:
    """Write a metric's value without its unit; None stays None."""
    return None if value is None else metric.text(value)


def measured_in(*blocks: Mapping[str, Any]) -> list[Metric]:
    """Return the metrics that any of these has a value of."""
    return [m for m in METRICS if any(block.get(m.field) is not None for block in blocks)]


def better(metric: Metric) -> str:
    """Say which way a metric is good."""
    if metric.signed:
        return "0 is best"
    return "higher is better" if metric.more_is_better else "lower is better"


def number(value: float | None, digits: int = 1, unit: str = "") -> str | None:
    """Write a number, thousands apart; None stays None."""
    if value is None:
        return None
    return f"{value:,.{digits}f}" + (f" {unit}" if unit else "")


def percent(share: float | None, digits: int = 1) -> str | None:
    """Write a share as per cent; None stays None."""
    return None if share is None else f"{share * 100:.{digits}f} %"


def time_text(seconds: float | None) -> str | None:
    """Write seconds as people say them, short ones in ms; None stays None."""
    if seconds is None:
        return None
    return f"{1000 * seconds:.0f} ms" if abs(seconds) < 1 else duration(seconds)


def file_name(pattern: str) -> str:
    """Return the last part of a path, or the path where there is none."""
    return PurePath(pattern).name or pattern


def quality_numbers(quality: Mapping[str, Any]) -> list[Number]:
    """Return the headline's numbers of a quality block; those not measured are left out."""
    return [Number(m.name, m.with_unit(quality[m.field]), better(m)) for m in measured_in(quality)]


def quality_table(title: str, blocks: Mapping[str, Mapping[str, Any]], note: str = "") -> Table:
    """Write quality blocks of report.json, a row each; metrics that none has are left out."""
    metrics = measured_in(*blocks.values())
    rows: list[list[Cell]] = [
        [
            name,
            *(metric_text(m, block.get(m.field)) for m in metrics),
            number(block.get("frames"), 0),
        ]
        for name, block in blocks.items()
    ]
    return Table(title, ["", *(m.title for m in metrics), "frames"], rows, note)


def series_of(scores: Sequence[Score | None]) -> dict[Metric, Values]:
    """Return a series for each metric that any score has."""
    rows = [values_of(score) for score in scores]
    return {m: [row[m.field] for row in rows] for m in measured_in(*rows)}


def facts_of(score: Score | None, hole_score: Score | None) -> dict[str, str]:
    """Return what is written beside a frame about its quality."""
    row = values_of(score)
    facts = {m.name: m.with_unit(row[m.field] or 0.0) for m in measured_in(row)}
    if hole_score is not None and hole_score.psnr_db is not None:
        psnr = BY_FIELD["psnr_db"]
        facts[f"{psnr.name} in holes"] = psnr.with_unit(hole_score.psnr_db)
    return facts


def ranked(values: Values, metric: Metric) -> list[int]:
    """Return the indices of the values that are there, the worst first."""
    known = [i for i, value in enumerate(values) if value is not None]
    return sorted(known, key=lambda i: -metric.badness(values[i] or 0.0))


def metric_plots(
    numbers: Sequence[int],
    scores: Sequence[Score | None],
    skip: Iterable[str] = (),
    cuts: Sequence[int] = (),
) -> list[Figure]:
    """Draw each measured metric over the frames, its worst frame ringed; nothing of one frame."""
    found: list[Figure] = []
    if len(numbers) < 2:
        return found
    for metric, values in series_of(scores).items():
        if metric.field in skip:
            continue
        worst = ranked(values, metric)[0]
        labels = Labels(
            f"{metric.name} per frame",
            "frame",
            metric.title,
            f"{metric.title} of every scored frame; {better(metric)}. Worst at frame "
            f"{numbers[worst]}.",
        )
        found.append(lines(labels, numbers, {metric.title: values}, (worst,), cuts))
    return found


def cuts_line(cuts: Sequence[Mapping[str, Any]]) -> str:
    """Say where cuts are, as `report.json` lists them; at least one."""
    by_source: dict[str, list[str]] = {}
    for cut in cuts:
        by_source.setdefault(cut["source"], []).append(str(cut["frame"]))
    places = ", ".join(f"{', '.join(frames)} ({source})" for source, frames in by_source.items())
    many = "s" if len(cuts) > 1 else ""
    return f"cut{many} before key frame{many} {places}; nothing is interpolated across"


def held_line(held: Sequence[int]) -> str:
    """Say where the picture is held, as `report.json` lists it; at least one."""
    many = "s" if len(held) > 1 else ""
    return (
        f"held after key frame{many} {ranges(held)}, which the next key frame repeats: the frames "
        "between show the same picture"
    )


def rendered_text(frames: Mapping[str, int]) -> str:
    """Say how many frames were rendered, as `report.json` counts them."""
    after_all = frames["rendered"]
    if not after_all:
        return f"{frames['key']} rendered"
    return f"{frames['key'] + after_all} rendered ({after_all} of them after all)"


def left_out_line(left_out: Sequence[Mapping[str, Any]]) -> str:
    """Say what was left out, as `report.json` lists it; at least one."""
    missing = [one for one in left_out if one["frames"]]
    frames, scores, rendered = (
        ranges(sorted({number for one in left_out for number in one[what]}))
        for what in ("frames", "scores", "rendered")
    )
    notes = (
        [f"{pluralise(len(missing), 'key interval')} left out: frames {frames}"] if missing else []
    )
    notes += [f"not scored: frames {scores}"] if scores else []
    notes += [f"generated, although rendered: frames {rendered}"] if rendered else []
    return "; ".join(notes)


def nonfinite_line(found: Sequence[Mapping[str, Any]]) -> str:
    """Say what is NaN or infinite in the input, as `report.json` lists it; at least one."""
    by_channels: dict[str, int] = {}
    for one in found:
        by_channels[one["channels"]] = by_channels.get(one["channels"], 0) + one["pixels"]
    text = ", ".join(
        f"{channels} in {pluralise(n, 'pixel')}" for channels, n in by_channels.items()
    )
    frames = pluralise(len({(one["key"], one["slot"]) for one in found}), "frame")
    return f"NaN or infinite in {frames} of the input: {text}; nothing is made of them"


def worst_table(
    numbers: Sequence[int],
    scores: Sequence[Score | None],
    shown: Iterable[int],
    makers: Sequence[str] = (),
) -> Table | None:
    """List the worst frames by the first metric that was measured; None where none was.

    Parameters
    ----------
    numbers, scores
        Of every frame.
    shown
        Numbers of the frames that the page's viewer has: these are links to it.
    makers
        What made every frame; empty to leave that out.
    """
    series = series_of(scores)
    if not series:
        return None
    metric, values = next(iter(series.items()))
    viewable = set(shown)
    rows: list[list[Cell]] = []
    for i in ranked(values, metric)[:WORST]:
        name = str(numbers[i])
        seen: Cell = Link(name, f"#viewer:{name}") if numbers[i] in viewable else name
        cells = [metric_text(m, column[i]) for m, column in series.items()]
        rows.append([seen, *cells, *makers[i : i + 1]])
    columns = ["frame", *(m.title for m in series), *(["made by"] if makers else [])]
    return Table(f"Worst frames by {metric.name}", columns, rows)
