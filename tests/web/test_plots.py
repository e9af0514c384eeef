"""Plots: valid, alone in their page, nothing lost of long sequences."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from importlib.resources import files

import numpy as np
import pytest

from exwarp_cli.report import plots
from exwarp_cli.report.plots import (
    COLOURS,
    IDS,
    TIMELINE_COLUMNS,
    Figure,
    Labels,
    TimelineCell,
    draw_timeline,
)

LABELS = Labels("T <i> & $x$ 🎬", "x", "y", 'what "it" shows')
X = list(range(8))
Y = [1.0, 2.0, None, 4.0, 3.0, 2.0, 1.0, 0.5]
FIGURES = {
    "lines": lambda: plots.draw_lines(LABELS, X, {"a": Y, "b": Y[::-1]}, marked=3),
    "points": lambda: plots.draw_points(LABELS, X, Y, ["warp", "extrapolate", "hold", "blend"] * 2),
    "bars": lambda: plots.draw_bars(
        LABELS, ["g", "h"], {"a": [1, 2], "b": [2, None]}, {"a": [3, 1]}
    ),
    "stacked": lambda: plots.draw_stacked_bars(LABELS, ["g"], {f"s{i}": [1.0] for i in range(9)}),
    "histogram": lambda: plots.draw_histogram(LABELS, [0, 1, 2], [3, 4]),
    "scatter": lambda: plots.draw_scatter(LABELS, {name: [1, 2] for name in "pqrs"}, [3, 4]),
    "panels": lambda: plots.draw_series_panels(LABELS, X, {"a": Y, "b": Y}),
    "strip": lambda: draw_timeline(
        LABELS, ["1"], [[TimelineCell("warp", "<w>")], [None]], ["warp"]
    ),
}


@pytest.mark.parametrize("name", FIGURES)
def test_a_plot_is_one_accessible_element_in_the_colours_of_the_page(name: str) -> None:
    figure: Figure = FIGURES[name]()
    root = ET.fromstring(figure.numbered("p1"))
    assert root.get("role") == "img" and root.tag == "svg"
    title, description = root.find("title"), root.find("desc")
    assert title.text == LABELS.title and description.text == LABELS.description
    assert root.get("aria-labelledby") == f"{title.get('id')} {description.get('id')}"
    ids = [e.get("id") for e in root.iter() if e.get("id")]
    assert len(ids) == len(set(ids)) and all(i.startswith("p1-") for i in ids)
    used = {e.get("href") for e in root.iter() if e.get("href")}
    assert used <= {f"#{i}" for i in ids}
    assert not any(colour in figure.svg for colour in COLOURS.values())
    assert "var(--" in figure.svg or "k-warp" in figure.svg
    assert "font-family" not in figure.svg and "http" not in figure.svg


def test_plots_are_the_same_for_the_same_input() -> None:
    first, second = FIGURES["lines"](), FIGURES["lines"]()
    assert first == second and IDS in first.svg


def test_the_marks_of_a_paper_stand_in_the_legend_once() -> None:
    figure = plots.draw_bars(LABELS, ["g"], {"a": [1], "b": [2]}, {"a": [3], "b": [4]})
    assert figure.svg.count(">paper<") == 1


def test_settings_of_the_user_do_not_show() -> None:
    import matplotlib

    plain = FIGURES["points"]()
    with matplotlib.rc_context({"font.size": 40, "text.usetex": True, "axes.grid": False}):
        assert FIGURES["points"]() == plain
        assert matplotlib.rcParams["font.size"] == 40, "and stay theirs"


def test_matplotlib_says_nothing_of_folders_that_it_cannot_write(tmp_path) -> None:
    (tmp_path / "file").write_text("")
    code = (
        "from exwarp_cli.report.html import Album, viewer_data\n"
        "viewer_data(Album(('a',), 'a', 'a'))\n"
        "from exwarp_cli.report import plots\n"
        "plots.draw_lines(plots.Labels('🎬'), [1], {'🎬 $': [2]})"
    )
    place = str(tmp_path / "file" / "below")
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env=os.environ | {"MPLCONFIGDIR": place},
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("", "")


def test_long_series_keep_their_worst_and_best() -> None:
    values: list[float | None] = list(np.random.default_rng(5).normal(30, 1, 10_000))
    values[1234], values[7777], values[0] = 3.0, 99.0, None
    kept = plots.thin_out(values)
    assert len(kept) <= plots.MAX_POINTS and {1234, 7777} <= set(kept) and kept == sorted(kept)
    assert plots.thin_out([None] * 5000)[:2] == [0, 5]
    assert plots.thin_out(values[:2000]) == list(range(2000))


def test_kinds_are_distinguished_by_colour_and_marker() -> None:
    count = len(plots.KINDS)
    svg = plots.draw_points(LABELS, list(range(count)), [1.0] * count, list(plots.KINDS)).svg
    makers = {
        "warp",
        "extrapolate",
        "hold",
        "softsplat",
        "blend",
        "interpolate",
        "lookahead",
        "rendered",
        "key",
    }
    assert makers == set(plots.KINDS)
    assert len(set(plots.KINDS.values())) == len(plots.KINDS)
    for kind in plots.KINDS:
        assert f"var(--{kind})" in svg, kind
    style = files("exwarp_cli.report").joinpath("templates/style.css").read_text()
    for theme in ("light", "dark"):
        part = style.partition(f"macro {theme}()")[2].partition("endmacro")[0]
        colours = dict(re.findall(r"--([a-z0-9]+): (#[0-9a-f]+);", part))
        kinds = [colours[kind] for kind in plots.KINDS]
        assert len(set(kinds)) == len(kinds)


@pytest.mark.parametrize("x", [[7], [7, 8], [7, 8, 9, 10]])
@pytest.mark.parametrize("draw", ["lines", "points", "panels"])
def test_no_tick_stands_between_two_frames(x: list[int], draw: str) -> None:
    y = [1.5] * len(x)
    svg = {
        "lines": lambda: plots.draw_lines(Labels("T"), x, {"a": y}),
        "points": lambda: plots.draw_points(Labels("T"), x, y, ["warp"] * len(x)),
        "panels": lambda: plots.draw_series_panels(Labels("T"), x, {"a": y, "b": y}),
    }[draw]().svg
    texts = ET.fromstring(svg.replace(IDS, "")).iter("text")
    # The y axis is around 1.5, so what is 5 and more belongs to x.
    large = [text for e in texts if (text := "".join(e.itertext())) and text[0].isdigit()]
    across = [float(text) for text in large if float(text) >= 5]
    assert across and all(value in x for value in across)


def test_a_strip_tells_every_cell() -> None:
    svg = draw_timeline(
        LABELS, ["slot 1"], [[TimelineCell("warp", "f1: a<b")], [TimelineCell("odd", "f2")]], []
    ).svg
    root = ET.fromstring(svg.replace(IDS, ""))
    cells = [(e.get("class"), e.findtext("title")) for e in root.iter("rect")]
    assert cells == [("k-warp", "f1: a<b"), ("k-muted", "f2")]


def test_a_long_strip_shares_columns_by_majority() -> None:
    columns = [
        [TimelineCell("extrapolate" if i % 3 else "warp", f"f{i}")]
        for i in range(10 * TIMELINE_COLUMNS)
    ]
    root = ET.fromstring(draw_timeline(LABELS, ["1"], columns, ["warp"]).svg.replace(IDS, ""))
    cells = [e for e in root.iter("rect") if e.find("title") is not None]
    assert len(cells) == TIMELINE_COLUMNS and {e.get("class") for e in cells} == {"k-extrapolate"}
    hint = cells[0].findtext("title")
    assert hint == "f0 and 9 more: extrapolate 6, warp 4"
