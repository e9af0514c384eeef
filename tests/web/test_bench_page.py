"""The page of a benchmark in a real browser: headline, sections, and a viewer of systems."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from exwarp_cli import cli
from exwarp_cli.report.gallery import TRUTH
from tests.cli import shots
from tests.matrix import spread
from tests.web.conftest import NAME, STREET

SYSTEMS = ["s6", "softsplat", "hold"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory, report) -> Path:
    """A benchmark of three key frames whose renderer left its times; read only."""
    root = tmp_path_factory.mktemp("bench")
    for number in (1, 2, 3):
        planes = shots.plain_planes(STREET, number - 1)
        header = shots.header(RenderTime="00:50.00")
        shots.write(root / "keys" / f"{NAME}.{number:04d}.exr", {"": planes}, header)
    line = ["bench", root / "keys", *shots.FORWARD, "--ground-truth", report.truth]
    how = ["--systems", ",".join(SYSTEMS), "--metrics", "psnr,ssim", "--jobs", 1]
    given = [*line, *how, "-o", root / "bench", "--progress", "none"]
    assert cli.run([str(argument) for argument in given]) == 0
    return root / "bench"


@pytest.fixture
def seen(visit, folder):
    return visit(page=folder / "report.html")


def test_what_is_saved_stands_first(seen, folder):
    label, value, note = (
        seen.page.locator(f".headline div:first-child {part}").first.inner_text()
        for part in ("dt", "dd", "small")
    )
    (row,) = json.loads((folder / "bench.json").read_text())["render_time"]
    assert row["key_frame_s"] == 50
    made = row["generated_frame_s"]["s6"]
    assert row["saved_share"]["s6"] == pytest.approx(3 * (50 - made) / 200)
    assert label == "Render time saved" and "warping alone" in note
    assert value.split("\n")[0].strip().startswith(f"{100 * row['saved_share']['s6']:.1f} %")


def test_every_section_is_a_word_in_the_navigation_and_leads_there(seen):
    links = seen.page.locator("nav a").all()
    assert len(links) >= 8
    for link in links:
        assert len(link.inner_text()) <= 12
        assert seen.page.locator(link.get_attribute("href")).count() == 1
    assert links[0].inner_text() == "Saved" and links[1].inner_text() == "Frames"


def test_nothing_is_asked_for_outside_and_names_are_text(seen, folder):
    text = (folder / "report.html").read_text()
    assert not re.search(r"(src|href)\s*=\s*[\"']?\s*(https?:)?//", text)
    assert seen.page.locator("img").count() == 0
    assert NAME in seen.page.locator("#quality, #holes").all_inner_texts()[1]


def test_the_viewer_shows_every_system_against_the_truth(seen):
    offered = seen.part("before").locator("option").all_inner_texts()
    assert offered == [*SYSTEMS, TRUTH]
    assert seen.part("after").input_value() == TRUTH
    seen.page.locator(".viewer").focus()
    seen.act("4")
    pictures = set()
    for system in offered:
        before = seen.page.locator(".viewer").get_attribute("data-drawn")
        if seen.part("before").input_value() != system:
            seen.part("before").select_option(system)
            seen.drawn(before)
        pictures.add(seen.canvas())
    assert len(pictures) == len(offered)
    facts = seen.part("facts").inner_text().replace("\n", " ")
    assert all(f"PSNR {system}" in facts for system in SYSTEMS)


def test_it_steps_through_the_slots_of_the_worst_and_a_usual_interval(seen):
    seen.page.locator(".viewer").focus()
    numbers = []
    for key in ("Home", "ArrowRight", "ArrowRight", "ArrowRight", "End"):
        seen.act(key)
        numbers.append(seen.frame)
    assert numbers == [2, 3, 4, 6, 8]


def test_holes_and_errors_are_laid_over(seen):
    seen.page.locator(".viewer").focus()
    shown = set()
    for key in ("4", "h", "3"):
        seen.act(key)
        shown.add(seen.canvas())
    assert len(shown) == 3


def test_light_dark_and_narrow(visit, folder, artefacts):
    for scheme, width in spread([("light", 1200), ("dark", 1200), ("dark", 400)], 2):
        seen = visit(width, page=folder / "report.html", color_scheme=scheme)
        assert seen.page.evaluate("document.documentElement.scrollWidth") == width
        path = artefacts / f"bench-{scheme}-{width}.png"
        seen.page.screenshot(path=path, full_page=True)
        assert path.stat().st_size > 10_000
