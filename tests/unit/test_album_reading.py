"""Pictures read back from pages: which are chosen, and what they take."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from exwarp_cli.domain.results import FrameRecord, RunSummary, Score
from exwarp_cli.report import gallery as galleries
from exwarp_cli.report.album_reading import BEGIN, END, PageAlbums
from exwarp_cli.report.gallery import BUDGET, FRAMES, KEY, OUTPUT, TRUTH, Gallery
from exwarp_cli.report.page import Page, Section, Viewer, render, viewer_data
from exwarp_cli.report.pictures import Picture, colour_picture, mask_picture
from tests.unit.sample_runs import interval, run

TINY = (9, 16)


def records(keys: Sequence[int]) -> list[FrameRecord]:
    """Four frames a key frame; the later in the sequence, the worse."""
    found = [frame for key in keys for frame in interval(key, "ggg", 4 * key)]
    return [replace(f, score=Score(50 - f.number / 100)) if f.slot else f for f in found]


def page(folder: Path, keys: Sequence[int], size: tuple[int, int] = TINY) -> Path:
    """Write the page of a chunk, as a run with ground truth shows its frames."""
    gallery = Gallery(has_truth=True)
    gallery.plan([[4 * key + i for i in range(4)] for key in keys])
    for frame in records(keys):
        if gallery.wants(frame.number, frame.score):
            rng = np.random.default_rng(frame.number)
            shown, truth = rng.random((2, *size, 3), np.float32)
            is_key = frame.slot == 0
            mask = None if is_key else truth[..., 0] > 0.5
            gallery.frame(frame.number, shown, None if is_key else truth, mask, is_key)
    file = folder / f"{keys[0]}.html"
    file.write_text(render(Page("", "", [], [Section("a", "b", [Viewer(gallery.album)])])))
    return file


def joined(keys: Sequence[int]) -> RunSummary:
    return run(records(keys))


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    keys = range(6)
    whole = page(tmp_path, keys).read_text()
    found = PageAlbums.of([page(tmp_path, range(3)), page(tmp_path, range(3, 6))])
    album = found.album(joined(keys))
    album.start = 23
    for frame in album.frames.values():
        frame.kind = "" if frame.number % 4 else "key"
    assert str(viewer_data(album)) in whole
    assert found.unreadable == ()


def test_intervals_are_spread_over_the_sequence_whatever_the_chunks(tmp_path: Path) -> None:
    """As one gallery over the whole run chooses them; the last frame is the worst."""
    parts = [range(3), range(3, 20), range(20, 41), range(41, 60)]
    found = PageAlbums.of([page(tmp_path, keys) for keys in parts]).album(joined(range(60)))
    whole = Gallery(has_truth=True)
    whole.plan([[4 * key + i for i in range(4)] for key in range(60)])
    assert set(found.frames) == {n for n in range(240) if whole.wants(n, None)}
    assert len(found.frames) == FRAMES


def test_the_nearest_interval_has_to_do(tmp_path: Path, monkeypatch) -> None:
    """A long chunk's page shows some of its intervals only, and one page is missing."""
    monkeypatch.setattr(galleries, "FRAMES", 5 * 4)
    pages = [page(tmp_path, range(21)), tmp_path / "21.html", page(tmp_path, range(41, 62))]
    albums = PageAlbums.of(pages)
    assert albums.unreadable == (pages[1],)
    shown = sorted({number // 4 for number in albums.album(joined(range(62))).frames})
    assert shown == [0, 15, 20, 46, 61], "for 0, 15, 30, 46 and 61; each page has 5"


def test_the_worst_frame_that_a_page_shows_is_kept(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(galleries, "FRAMES", 2 * 4)
    made = joined(range(9))
    frames = [
        replace(f, score=Score(1.0)) if f.number == 18 else f for f in made.frames
    ]  # fmt: skip
    pages = [page(tmp_path, [key]) for key in range(9)]
    album = PageAlbums.of(pages).album(replace(made, frames=tuple(frames)))
    assert set(album.frames) == {0, 1, 2, 3, 18, 32, 33, 34, 35}


def test_pictures_keep_within_the_budget(tmp_path: Path) -> None:
    """Small chunks have room for large pictures, and all of them together have not."""
    pages = [page(tmp_path, range(a, a + 2), (135, 240)) for a in range(0, 8, 2)]
    each = [PageAlbums.of([file]).album(joined(range(8))) for file in pages]
    before = sum(bytes_of(album.plain()) for album in each)
    BIG = 800_000
    assert before > BIG
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(galleries, "BUDGET", BIG)
        album = PageAlbums.of(pages).album(joined(range(8)))
    assert len(album.frames) == 32
    assert bytes_of(album.plain()) < BIG < BUDGET
    sizes = {picture.width for f in album.frames.values() for picture in f.pictures.values()}
    assert sizes <= {240, 120, 60}
    shared = {id(album.frames[n].pictures[KEY]) for n in (4, 5, 6, 7)}
    assert (
        shared == {id(album.frames[4].pictures[OUTPUT])} == {id(album.frames[4].pictures[TRUTH])}
    ), "a key frame is encoded once"


def bytes_of(plain: dict) -> int:
    return sum(len(Picture.of(image).data) for image in plain["images"])


def test_pictures_come_back() -> None:
    pixels = np.random.default_rng(1).random((64, 96, 3), np.float32)
    picture = colour_picture(pixels, 4, 10**6)
    mask = mask_picture(pixels[..., 0] > 0.5)
    for one in (picture, mask):
        assert Picture.of(one.plain()) == one
        assert one.within(10**6) is one
    small = picture.within(2000)
    assert len(small.data) <= 2000 and small.peak == 4
    with Image.open(io.BytesIO(small.data)) as image:
        assert image.format == "WEBP" and image.size == (small.width, small.height)
    assert mask.within(1) is mask, "of a mask there is nothing to leave out"


@pytest.mark.parametrize(
    "change",
    [
        {"url": "data:image/svg+xml;base64,PHN2Zy8+"},
        {"url": "https://example.com/a.webp"},
        {"url": "data:image/webp;base64,*"},
        {"width": None},
    ],
)
def test_what_is_no_picture_is_refused(change: dict[str, object]) -> None:
    plain = mask_picture(np.ones((4, 4), np.bool_)).plain()
    with pytest.raises((TypeError, ValueError)):
        Picture.of(plain | change)


@pytest.mark.parametrize(
    "album",
    [
        "[" * 200_000,
        "[]",
        '{"frames": 5, "images": []}',
        '{"frames": [{"number": 1e400, "holes": null}], "images": []}',
        f'{{"frames": [{{"number": {"9" * 5000}}}], "images": []}}',
    ],
)
def test_albums_of_another_shape_are_left_out(tmp_path: Path, album: str) -> None:
    file = page(tmp_path, [0])
    text = file.read_text()
    begin = text.index(BEGIN) + len(BEGIN)
    file.write_text(text[:begin] + album + text[text.index(END, begin) :])
    assert PageAlbums.of([file]).unreadable == (file,)
