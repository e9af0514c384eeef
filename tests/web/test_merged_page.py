"""The page of merged chunks in a real browser: what the single run's page shows."""

from __future__ import annotations

from pathlib import Path

import pytest

from exwarp_cli import cli


@pytest.fixture(scope="module")
def merged(tmp_path_factory, report) -> Path:
    """The page of the same run, done in two parts."""
    root = tmp_path_factory.mktemp("merged")
    for keys in ("3", "1-2"):
        part = type(report)(report.keys, report.truth, root / "frames", root / "chunks" / keys)
        part.run("--frames", keys)
    assert cli.run(["merge-reports", str(root)]) == 0
    return root / "report.html"


def test_the_viewer_shows_the_same_frames(visit, merged, artefacts):
    single, joined = visit(), visit(page=merged)
    assert joined.frame == single.frame, "both begin with the worst"
    for keys in ((), ("Home",), ("ArrowRight", "3"), ("h", "4"), ("End", "x")):
        single.act(*keys)
        joined.act(*keys)
        assert joined.frame == single.frame
        assert joined.canvas() == single.canvas()
        facts = [seen.part("facts").inner_text() for seen in (single, joined)]
        assert facts[0] == facts[1] != ""
    joined.page.screenshot(path=artefacts / "report-merged.png", full_page=True)


def test_tables_and_plots_are_the_same_but_for_times(visit, merged):
    single, joined = visit(), visit(page=merged)
    for section in ("quality", "decisions", "holes", "input"):
        texts = [seen.page.locator(f"#{section}").inner_text() for seen in (single, joined)]
        assert texts[0] == texts[1] != ""
