"""Pictures of merged reports: which are chosen, and what they take."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from exwarp_cli.domain.results import FrameRecord, RunSummary, Score
from exwarp_cli.report import gallery as galleries
from exwarp_cli.report.gallery import (
    BUDGET,
    KEY,
    MAX_FRAMES,
    OUTPUT,
    TRUTH,
    Album,
    Gallery,
    merge_albums,
)
from exwarp_cli.report.pictures import Picture, encode_colour, encode_mask
from exwarp_cli.report.schema import to_json
from tests.unit.sample_runs import interval, run

TINY = (9, 16)


def records(keys: Sequence[int]) -> list[FrameRecord]:
    """Four frames a key frame; the later in the sequence, the worse."""
    found = [frame for key in keys for frame in interval(key, "ggg", 4 * key)]
    return [replace(f, score=Score(50 - f.number / 100)) if f.slot else f for f in found]


def file(folder: Path, keys: Sequence[int], size: tuple[int, int] = TINY) -> Path:
    """Write the album of a chunk, as a run with ground truth keeps its frames."""
    gallery = Gallery(has_truth=True)
    gallery.plan([[4 * key + i for i in range(4)] for key in keys])
    for frame in records(keys):
        if gallery.wants(frame.number, frame.score):
            rng = np.random.default_rng(frame.number)
            shown, truth = rng.random((2, *size, 3), np.float32)
            is_key = frame.slot == 0
            mask = None if is_key else truth[..., 0] > 0.5
            gallery.frame(frame.number, shown, None if is_key else truth, mask, is_key)
    path = folder / f"{keys[0]}.json"
    path.write_text(to_json(gallery.album.to_plain(), compact=True))
    return path


def merged(files: Sequence[Path], run: RunSummary) -> tuple[Album, list[Path]]:
    numbers = {frame.number for frame in run.frames}
    return merge_albums(files, [numbers] * len(files), run)


def joined(keys: Sequence[int]) -> RunSummary:
    return run(records(keys))


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    whole = json.loads(file(tmp_path, range(6)).read_text())
    files = [file(tmp_path, range(3)), file(tmp_path, range(3, 6))]
    album, unreadable = merged(files, joined(range(6)))
    album.start = 23
    for frame in album.frames.values():
        frame.kind = "" if frame.number % 4 else "key"
    assert album.to_plain() == whole
    assert unreadable == []


def test_intervals_are_spread_over_the_sequence_whatever_the_chunks(tmp_path: Path) -> None:
    """As one gallery over the whole run chooses them; the last frame is the worst."""
    parts = [range(3), range(3, 20), range(20, 41), range(41, 60)]
    album, _ = merged([file(tmp_path, keys) for keys in parts], joined(range(60)))
    whole = Gallery(has_truth=True)
    whole.plan([[4 * key + i for i in range(4)] for key in range(60)])
    assert set(album.frames) == {n for n in range(240) if whole.wants(n, None)}
    assert len(album.frames) == MAX_FRAMES


def test_the_nearest_interval_has_to_do(tmp_path: Path, monkeypatch) -> None:
    """A long chunk's album has some of its intervals only, and one album is missing."""
    monkeypatch.setattr(galleries, "MAX_FRAMES", 5 * 4)
    files = [file(tmp_path, range(21)), tmp_path / "21.json", file(tmp_path, range(41, 62))]
    album, unreadable = merged(files, joined(range(62)))
    assert unreadable == [files[1]]
    shown = sorted({number // 4 for number in album.frames})
    assert shown == [0, 20, 41, 61], "for 0, 29, 30, 31 and 61"


def test_the_worst_frame_of_all_albums_is_kept(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(galleries, "MAX_FRAMES", 2 * 4)
    made = joined(range(9))
    frames = [replace(f, score=Score(1.0)) if f.number == 18 else f for f in made.frames]
    files = [file(tmp_path, [key]) for key in range(9)]
    album, _ = merged(files, replace(made, frames=tuple(frames)))
    assert set(album.frames) == {0, 1, 2, 3, 18, 32, 33, 34, 35}


def test_of_each_album_only_the_frames_that_are_asked_for_count(tmp_path: Path) -> None:
    files = [file(tmp_path, [0, 1]), file(tmp_path, [2])]
    numbers = [set(range(4)), set(range(8, 12))]
    album, _ = merge_albums(files, numbers, joined([0, 2]))
    assert set(album.frames) == numbers[0] | numbers[1]


def test_pictures_keep_within_the_budget(tmp_path: Path) -> None:
    """Small chunks have room for large pictures, and all of them together have not."""
    files = [file(tmp_path, range(a, a + 2), (135, 240)) for a in range(0, 8, 2)]
    each = [merged([path], joined(range(8)))[0] for path in files]
    before = sum(bytes_of(album.to_plain()) for album in each)
    BIG = 800_000
    assert before > BIG
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(galleries, "BUDGET", BIG)
        album, _ = merged(files, joined(range(8)))
    assert len(album.frames) == 32
    assert bytes_of(album.to_plain()) < BIG < BUDGET
    sizes = {picture.width for f in album.frames.values() for picture in f.pictures.values()}
    assert sizes <= {240, 120, 60}
    shared = {id(album.frames[n].pictures[KEY]) for n in (4, 5, 6, 7)}
    assert (
        shared == {id(album.frames[4].pictures[OUTPUT])} == {id(album.frames[4].pictures[TRUTH])}
    ), "a key frame is encoded once"


def bytes_of(plain: dict) -> int:
    return sum(len(Picture.from_plain(image).data) for image in plain["images"])


def test_pictures_come_back() -> None:
    pixels = np.random.default_rng(1).random((64, 96, 3), np.float32)
    picture = encode_colour(pixels, 4, 10**6)
    mask = encode_mask(pixels[..., 0] > 0.5)
    for one in (picture, mask):
        assert Picture.from_plain(one.to_plain()) == one
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
    plain = encode_mask(np.ones((4, 4), np.bool_)).to_plain()
    with pytest.raises((TypeError, ValueError)):
        Picture.from_plain(plain | change)


@pytest.mark.parametrize(
    "album",
    [
        "[" * 200_000,
        "[]",
        '{"frames": 5, "images": []}',
        '{"frames": [{"number": 1e400, "holes": null}], "images": []}',
        f'{{"frames": [{{"number": {"9" * 5000}}}], "images": []}}',
        '{"frames": [{"number": 1}], "images": []}',
    ],
)
def test_albums_of_another_shape_are_left_out(tmp_path: Path, album: str) -> None:
    path = file(tmp_path, [0])
    path.write_text(album)
    found, unreadable = merged([path], joined([0]))
    assert unreadable == [path] and not found.frames
