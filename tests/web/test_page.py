"""report.html as text: nothing from outside, everything escaped, the same for the same input."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from exwarp_cli import cli
from exwarp_cli.domain.results import RunSummary, Score
from exwarp_cli.report.folder import PAGE_FILE, write_report
from exwarp_cli.report.gallery import (
    BUDGET,
    KEY,
    LONGEST_OF_MANY,
    MAX_FRAMES,
    OUTPUT,
    TRUTH,
    Album,
    Gallery,
)
from exwarp_cli.report.html import Link, Page, Section, Table, is_number, render, viewer_data
from exwarp_cli.report.schema import run_document as document_of
from exwarp_cli.report.upsample_page import frame_maker, headline, upsample_page
from tests.unit.sample_runs import INPUT, no_pictures, path_run, run

VOID = {"meta", "input", "br", "hr", "img", "link"}
NAMES = [
    "a \"b\" 'c' 50% # & <!-- --> {{ 7 * 7 }} {% raw %}.####.exr",
    "</script><script>alert(1)</script>",
    "🎬 \u202e \u2028 broken \udcff byte $x_1$ \\frac",
]


class Checker(HTMLParser):
    """Collects what a page links to, its ids and its text, and finds tags that do not match."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.ids: Counter[str] = Counter()
        self.scripts = 0
        self.text = ""

    def handle_starttag(self, tag, attrs) -> None:
        self.links += [str(value) for name, value in attrs if name in ("src", "href", "xlink:href")]
        self.ids.update(str(value) for name, value in attrs if name == "id")
        assert not [name for name, _ in attrs if name.startswith("on")]
        self.scripts += tag == "script"
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.text += data


def check(text: str) -> Checker:
    checker = Checker()
    checker.feed(text)
    checker.close()
    assert checker.open == []
    assert [name for name, count in checker.ids.items() if count > 1] == []
    assert [link for link in checker.links if not link.startswith("#")] == []
    named = {link[1:] for link in checker.links if not link.startswith("#viewer:")}
    assert named <= set(checker.ids)
    return checker


def data_of(text: str) -> dict:
    found = re.search(r'<script type="application/json">(.*?)</script>', text, re.DOTALL)
    return json.loads(found[1])


def page_of(made: RunSummary) -> str:
    return render(upsample_page(made, document_of(made), no_pictures()))


def long_run(intervals: int) -> RunSummary:
    """Return a run with a value in every frame that pages draw."""
    made = path_run("S5", intervals, scored=True)
    frames = tuple(
        replace(f, hole_fraction=0.1, timing_ms={"warp": 1.0, "read": 2.0}) for f in made.frames
    )
    return replace(made, frames=frames)


def test_a_real_page_is_whole_and_alone(report):
    text = report.page.read_text(encoding="utf-8")
    checker = check(text)
    assert not re.search(r"(src|href|url|import)\W{1,3}https?:", text)
    assert "http:" not in text and "https:" not in text
    assert "default-src 'none'" in text
    for heading in ("Frames", "Quality", "Decisions", "Holes and features", "Time"):
        assert heading in checker.text
    assert "var(--warp)" in text and "#fe01" not in text and "%PLOT%" not in text


def test_the_viewer_has_what_the_run_wrote(report):
    data = data_of(report.page.read_text(encoding="utf-8"))
    assert [frame["number"] for frame in data["frames"]] == list(range(1, 13))
    assert data["names"] == [OUTPUT, TRUTH, KEY]
    assert (data["before"], data["after"]) == (OUTPUT, TRUTH)
    key, first = data["frames"][:2]
    assert set(key["pictures"].values()) == {key["pictures"][OUTPUT]} and key["errors"] == {}
    assert first["pictures"][KEY] == key["pictures"][OUTPUT] != first["pictures"][OUTPUT]
    assert set(first["errors"]) == {OUTPUT} and first["holes"] is not None
    assert first["facts"]["decision"] == "d1 = warp" and first["facts"]["PSNR"].endswith(" dB")
    last = data["frames"][-1]
    assert TRUTH not in last["pictures"], "the truth ends at the last key frame"
    indices = {i for frame in data["frames"] for i in frame["pictures"].values()}
    assert max(indices) < len(data["images"]) and all(i["peak"] >= 0 for i in data["images"])


def test_a_resumed_run_shows_the_same_frames(report, tmp_path):
    again = replace(report, folder=tmp_path)
    again.run("--skip-existing")
    before, after = (data_of(r.page.read_text(encoding="utf-8")) for r in (report, again))
    assert before["images"] == after["images"]
    assert [f["pictures"] for f in before["frames"]] == [f["pictures"] for f in after["frames"]]


@pytest.mark.parametrize("metric", ["vmaf", "flicker"])
def test_the_viewer_starts_at_the_worst_by_what_is_known_at_the_end(report, tmp_path, metric):
    made = replace(report, frames=tmp_path / "out", folder=tmp_path)
    made.run("--metrics", metric)
    data = data_of(made.page.read_text(encoding="utf-8"))
    rows = list(csv.DictReader((tmp_path / "frames.csv").read_text().splitlines()))
    known = {int(row["frame"]): float(row[metric]) for row in rows if row[metric]}
    worst = (min if metric == "vmaf" else max)(known, key=lambda number: known[number])
    first = next(row["frame"] for row in rows if row["kind"] != "key")
    assert data["start"] == worst != int(first)


def test_a_worst_frame_that_was_not_kept_is_not_started_at() -> None:
    made = path_run("S5", 2, scored=True)
    gallery = Gallery(has_truth=True)
    gallery.plan([[3]])
    gallery.frame(3, np.zeros((8, 12, 3), np.float32), None, None, is_key=False)
    for start in (None, 3):
        gallery.album.start = start
        upsample_page(made, document_of(made), gallery.album)
        assert gallery.album.start == start


def test_without_truth_the_key_frame_stands_beside(report, tmp_path):
    pages = []
    for option in ("--overwrite", "--skip-existing"):  # the second time all is read from disk
        code = cli.run(
            [
                *("upsample", str(report.keys), "-o", str(tmp_path / "out"), "-m", "blend"),
                *("--frames", "1", "--report", str(tmp_path), "--progress", "none", option),
            ]
        )
        assert code == 0
        pages.append((tmp_path / PAGE_FILE).read_text(encoding="utf-8"))
    first, second = map(data_of, pages)
    assert (first["before"], first["after"], first["start"]) == (KEY, OUTPUT, None)
    assert first["names"] == [OUTPUT, KEY]
    assert all(frame["errors"] == {} for frame in first["frames"])
    assert "PSNR" not in check(pages[0]).text
    shown = [
        [data["images"][frame["pictures"][OUTPUT]] for frame in data["frames"]]
        for data in (first, second)
    ]
    assert shown[0] == shown[1] and len(shown[0]) == 4


def test_the_page_of_a_comparison(report, tmp_path):
    code = cli.run(
        [
            *("compare", str(report.truth), str(report.frames), "--frames", "1-8"),
            *("--report", str(tmp_path), "--metrics", "psnr", "--fail-below", "psnr=10"),
        ]
    )
    assert code == 0
    text = (tmp_path / PAGE_FILE).read_text(encoding="utf-8")
    data, checker = data_of(text), check(text)
    assert data["names"] == ["test", "reference"] and len(data["frames"]) == 8
    assert "PSNR per frame" in checker.text and "passed" in checker.text
    lowest = min(data["frames"], key=lambda frame: float(frame["facts"]["PSNR"].split()[0]))
    assert data["start"] == lowest["number"]
    assert "Limits" in text.partition("</dl>")[0] and "holes only" not in checker.text


def test_two_methods_are_compared_with_the_truth(two_methods, report):
    text = (two_methods / PAGE_FILE).read_text(encoding="utf-8")
    data, checker = data_of(text), check(text)
    assert data["names"] == ["baseline", "test", "reference"] and data["fps"] == 120
    assert (data["before"], data["after"]) == ("baseline", "test")
    frame = data["frames"][1]
    assert len({*frame["pictures"].values(), *frame["errors"].values()}) == 5
    assert {"PSNR", "PSNR of the baseline"} <= set(frame["facts"])
    for words in ("as the baseline", "baseline, generated", "test, generated"):
        assert words in checker.text
    document = json.loads((two_methods / "report.json").read_text())
    own = json.loads((report.folder / "report.json").read_text())
    generated = document["quality"]["generated"]["psnr_db"]
    assert generated == pytest.approx(own["quality"]["all"]["psnr_db"], abs=0.05)
    assert document["baseline"]["pattern"].endswith(".exr")
    assert document["baseline"]["quality"]["generated"]["psnr_db"] < generated


def test_a_comparison_of_one_frame_says_first_what_fails(report, tmp_path):
    arguments = ("compare", str(report.truth), str(report.frames), "--frames", "2")
    limits = ("--fail-below", "psnr=99", "--fail-above", "flip=1")
    assert cli.run([*arguments, "--report", str(tmp_path), *limits]) == 8
    text = (tmp_path / PAGE_FILE).read_text(encoding="utf-8")
    first = text.partition('class="headline"')[2].partition("</div>")[0]
    assert "failed" in first and "<small>psnr</small>" in first
    assert "per frame" not in check(text).text
    # Its own report it replaces; that of a run it does not.
    assert cli.run([*arguments, "--report", str(tmp_path)]) == 0
    assert cli.run([*arguments, "--report", str(report.folder)]) == 6
    assert json.loads((report.folder / "report.json").read_text())["method"] == "s6"


@pytest.mark.parametrize("name", NAMES)
def test_any_name_is_text(name: str) -> None:
    made = run([*long_run(1).frames], input=replace(INPUT, pattern=f"/in/{name}", producer=name))
    text = page_of(made)
    text.encode("utf-8")
    checker = check(text)
    assert checker.scripts == 1, "the page's own"
    seen = name.encode("utf-8", "backslashreplace").decode("utf-8")
    assert checker.text.count(seen) >= 3 and "49" not in text.partition("<h1>")[2][:200]


def test_json_cannot_end_its_script() -> None:
    name = "</script><!-- <script> \u2028 & \udcff"
    text = str(viewer_data(Album((name,), name, name)))
    assert not set("<>&\u2028") & set(text) and text.isascii()
    assert json.loads(text)["before"] == name


def test_the_same_run_gives_the_same_page() -> None:
    assert page_of(long_run(1)) == page_of(long_run(1))


def test_a_run_without_anything_has_a_page(tmp_path: Path) -> None:
    write_report(tmp_path, run([]), no_pictures())
    checker = check((tmp_path / PAGE_FILE).read_text())
    assert "shot.####.exr" in checker.text


def test_long_runs_stay_small() -> None:
    text = page_of(long_run(1250))
    assert len(text) < 1_500_000
    check(text)


def test_a_gallery_keeps_intervals_evenly_and_in_a_row_and_the_worst() -> None:
    gallery = Gallery(has_truth=True)
    groups = [range(4 * k, 4 * k + 4) for k in range(1250)]
    gallery.plan(groups)
    pixels = np.random.default_rng(7).random((8, 12, 3), dtype=np.float32)
    asked = 0
    for number in range(5000):
        bad = Score(psnr_db={1717: 20.0, 2929: 10.0, 4001: 15.0}.get(number, 30.0))
        if gallery.wants(number, bad if number % 4 else None):
            asked += 1
            gallery.frame(number, pixels, pixels, None, is_key=number % 4 == 0)
    kept = set(gallery.album.frames)
    assert len(kept) == MAX_FRAMES + 1 and 1717 not in kept and gallery.album.start == 2929
    assert asked == MAX_FRAMES + 2, "the worst before was dropped"
    starts = sorted(number for number in kept if number % 4 == 0)
    assert (
        starts[0] == 0
        and starts[-1] == 4996
        and all({s, s + 1, s + 2, s + 3} <= kept for s in starts)
    )
    in_a_row = np.flatnonzero(np.diff(starts) == 4)
    assert len(in_a_row) == 35 and np.ptp(in_a_row) == 34, "to be played"
    assert starts[in_a_row[0]] == 2428 and starts[in_a_row[-1] + 1] == 2568, "in the middle"
    spread = [start for start in starts if not 2428 < start < 2568]
    assert max(np.diff(spread)) <= 220, "the others evenly"
    assert gallery.album.longest == LONGEST_OF_MANY
    # Output and truth each may take all of their room, the error half of it.
    assert gallery.album.room * 2.5 * len(kept) <= BUDGET


def test_a_gallery_without_psnr_keeps_the_worst_by_what_there_is() -> None:
    gallery = Gallery(has_truth=True)
    gallery.plan([[number] for number in range(3 * MAX_FRAMES)])
    pixels = np.zeros((8, 12, 3), np.float32)
    for number in range(3 * MAX_FRAMES):
        if gallery.wants(number, Score(flip=0.5 if number == 100 else 0.1)):
            gallery.frame(number, pixels, pixels, None, is_key=False)
    assert gallery.album.start == 100 and 100 in gallery.album.frames


@pytest.mark.parametrize(
    ("method", "maker", "kind"),
    [
        ("blend", "blend", "blend"),
        ("softsplat", "softsplat", "softsplat"),
        ("onnx", "interpolate", "interpolate"),
        ("s6", "warp", "warp"),
        ("causal", "extrapolate", "extrapolate"),
        ("of a later version", "warp", "warp"),
    ],
)
def test_what_made_a_frame_is_distinguished(method: str, maker: str, kind: str) -> None:
    frame = replace(long_run(1).frames[1], method=method, made_by=maker)
    assert frame_maker(frame) == kind


def test_hole_shares_are_counted() -> None:
    frames = [replace(frame, hole_fraction=0.02 * frame.slot) for frame in long_run(5).frames]
    checker = check(page_of(run(frames)))
    assert "Frames by hole share" in checker.text
    assert "95 % of the frames have at most 6.0 %." in checker.text


def test_a_single_frame_has_no_plots_over_frames() -> None:
    frames = long_run(1).frames
    assert "per frame" in check(page_of(run([*frames]))).text
    assert "PSNR per frame" not in check(page_of(run([*frames[:2]]))).text


@pytest.mark.parametrize("has_truth", [True, False])
def test_sharpness_and_flicker_are_drawn_by_slot(has_truth: bool) -> None:
    """Three lines with a point a slot; key frames are points of sharpness, too."""
    frames = [
        replace(f, score=Score(pulse=-3.0, flicker=2.0 + f.slot)) if has_truth and f.slot
        else replace(f, key_pulse=-2.0 * f.slot if f.slot else None)
        for f in path_run("S5", 4).frames
    ]  # fmt: skip
    text = page_of(run(frames))
    figures = dict(re.findall(r"<figcaption>(\w+) by slot</figcaption>(.*?)</figure>", text, re.S))
    assert set(figures) == ({"Sharpness", "Flicker"} if has_truth else {"Sharpness"})
    points = {"Sharpness": 3 * 5, "Flicker": 3 * 3}
    for name, figure in figures.items():
        drawn = re.findall(r"<use [^>]*fill: var\(--c[0-2]\)", figure)
        assert len(drawn) == points[name] + 3, "three in the legend"
        assert '<p class="note">Good: ' in figure


def test_what_was_saved_comes_first() -> None:
    document = document_of(path_run("S6", 2))
    assert headline(document)[0].label == "Frames"
    block = {"key_frame_s": 400.0, "generated_frame_s": 0.5, "saved_s": 9000.0, "saved_share": 0.74}
    document["render_time"] = block | {"source": "Blender"}
    first = headline(document)[0]
    assert (first.label, first.value, first.note) == (
        "Render time saved",
        "2 h 30 min",
        "74 % of rendering all",
    )


def test_blocks_of_other_pages() -> None:
    table = Table("T", ("", "a"), [["r", None], ["s", "1.5"], ["t", Link("go", "#one")]], "note")
    page = Page("x", "", [], [Section("one", "One", [table, "<b>"]), Section("no", "No", [])])
    text = render(page)
    checker = check(text)
    assert "No" not in re.findall(r"<h2[^>]*>(.*?)</h2>", text)
    assert '<td class="number"><bdi>1.5</bdi></td>' in text and "<b>" in checker.text
    assert 'title="not measured"' in text and '<a href="#one">go</a>' in text


@pytest.mark.parametrize(
    ("cell", "expected"),
    [
        ("1", True),
        ("-1,234.5 ms", True),
        ("24 %", True),
        ("0.1.0", False),
        ("1-9", False),
        ("", False),
    ],
)
def test_numbers_stand_to_the_right(cell: str, expected: bool) -> None:
    assert is_number(cell) is expected


@pytest.mark.parametrize(
    ("cells", "right"),
    [(("1,871", "12 of 16 bytes", "-"), 0), (("1.5", "-", None, "2.5"), 5), (("a", "b"), 0)],
)
def test_a_column_stands_on_one_side_whatever_single_cells_are(cells, right):
    rows = [[f"row {i}", cell] for i, cell in enumerate(cells)]
    sections = [Section("a", "A", [Table("", ("", "counted"), rows)])]
    html = render(Page("title", "", [], sections))
    assert html.count('class="number"') == right
