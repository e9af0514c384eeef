"""A gallery in parts, as processes of one run fill them, is that of one process."""

from __future__ import annotations

import pickle
import random
from collections.abc import Sequence

import numpy as np
import pytest

from exwarp_cli.domain.results import Score
from exwarp_cli.report import gallery as module
from exwarp_cli.report.gallery import Gallery
from exwarp_cli.report.html import viewer_data

SLOTS = 4


def groups(keys: Sequence[int]) -> list[list[int]]:
    """Frames of each key interval."""
    return [[SLOTS * key + i for i in range(SLOTS)] for key in keys]


def pixels(number: int) -> np.ndarray:
    return np.random.default_rng(number).random((9, 16, 3), np.float32)


def psnr(number: int) -> float:
    """Tell a quality; frames 7 and 23 are equally bad, and the worst."""
    return 5.0 if number in (7, 23) else 20.0 + number * 37 % 11


def watch(gallery: Gallery, keys: Sequence[int], truth: bool) -> Gallery:
    """Show a part of the run to a gallery, as a run does."""
    gallery.plan(groups(keys))
    for group in groups(keys):
        for number in group:
            is_key = number == group[0]
            score = Score(psnr(number)) if truth and not is_key else None
            if gallery.wants(number, score):
                real = pixels(-number + 1000) if truth and not is_key else None
                gallery.frame(number, pixels(number), real, None, is_key)
    return gallery


@pytest.fixture(autouse=True)
def few(monkeypatch) -> None:
    """Room for three key intervals of a page, so that most are left out."""
    monkeypatch.setattr(module, "MAX_FRAMES", 3 * SLOTS)


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_parts_in_any_order_make_the_gallery_of_one_process(truth: bool, seed: int) -> None:
    keys = range(10)
    whole = watch(Gallery(truth), keys, truth)
    rng = random.Random(seed)
    ends = sorted(rng.sample(range(1, 10), 3))
    parts = [keys[a:b] for a, b in zip([0, *ends], [*ends, 10], strict=True)]
    rng.shuffle(parts)
    joined = Gallery(truth)
    joined.plan(groups(keys))
    for part in parts:
        sent = pickle.loads(pickle.dumps(joined.share()))
        joined.adopt(pickle.loads(pickle.dumps(watch(sent, part, truth))))
    assert viewer_data(joined.album) == viewer_data(whole.album)
    assert joined.album.start == whole.album.start == (7 if truth else None)
    chosen = {n for group in (0, 4, 9) for n in groups([group])[0]}
    assert set(joined.album.frames) == chosen | ({7} if truth else set())


def test_a_share_is_empty_and_has_the_plan_of_the_whole() -> None:
    whole = watch(Gallery(True), range(10), True)
    part = whole.share()
    assert part.album.frames == {} and part.album.room == whole.album.room
    part.plan(groups([3]))
    assert not part.wants(13, None) and part.wants(17, None)


def test_a_part_that_is_done_twice_counts_once() -> None:
    joined = Gallery(True)
    joined.plan(groups(range(10)))
    for keys in ((0, 1), (0, 1), range(2, 10)):
        joined.adopt(watch(joined.share(), keys, True))
    whole = watch(Gallery(True), range(10), True)
    assert viewer_data(joined.album) == viewer_data(whole.album)
