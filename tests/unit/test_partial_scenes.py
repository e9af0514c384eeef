"""Scenes that are not rendered to the end yet."""

from __future__ import annotations

from pathlib import Path

import pytest

from exwarp_cli.errors import MissingFrameError
from exwarp_cli.io.dataset import RenderedScene, open_scene
from tests.unit.analytic_scene import manifest, write_manifest


def scene(
    folder: Path, instants: set[int], keys: set[int], count: int = 17, step: int = 4
) -> RenderedScene:
    """A scene of `count` instants where only these frames are there, as empty files."""
    write_manifest(folder, manifest(count=count, key_step=step))
    for kind, numbers in (("instants", instants), ("keys", keys)):
        (folder / kind).mkdir()
        for number in numbers:
            (folder / kind / f"analytic.{number:04d}.exr").touch()
    return open_scene(folder)


def numbers(scene: RenderedScene) -> tuple[list[int], list[int]]:
    """First and last instant, and first and last key frame."""
    whole = scene.manifest.instants.numbers, scene.manifest.keys.numbers
    return [whole[0][0], whole[0][-1]], [whole[1][0], whole[1][-1]]


ALL, KEYS = set(range(1, 18)), set(range(1, 6))


def test_a_whole_scene_stays_as_it_is(tmp_path):
    whole = scene(tmp_path / "four", ALL, KEYS)
    assert whole.as_far_as_rendered() is whole
    every = scene(tmp_path / "one", ALL, ALL, step=1)
    assert every.as_far_as_rendered() is every


def test_instants_after_the_last_key_frame_of_a_whole_scene_stay(tmp_path):
    longer = scene(tmp_path, ALL | {18, 19}, KEYS, count=19)
    assert numbers(longer.as_far_as_rendered()) == ([1, 19], [1, 5])


@pytest.mark.parametrize(
    ("instants", "keys", "wanted"),
    [
        (ALL - {17}, KEYS, ([1, 13], [1, 4])),
        (ALL - {14}, KEYS, ([1, 13], [1, 4])),
        (ALL, KEYS - {5}, ([1, 13], [1, 4])),
        (ALL - {6}, KEYS, ([1, 5], [1, 2])),
        (ALL - {2, 6}, KEYS, ([9, 17], [3, 5])),  # one key frame alone is no run
        (ALL - {10}, KEYS, ([1, 9], [1, 3])),  # of two runs the first
        (ALL, KEYS - {3}, ([1, 5], [1, 2])),
        (ALL, KEYS - {1}, ([5, 17], [2, 5])),
        (ALL - {1}, KEYS, ([5, 17], [2, 5])),
        (ALL - {2}, KEYS, ([5, 17], [2, 5])),
        (ALL - {1, 2, 3, 16}, KEYS, ([5, 13], [2, 4])),
        (ALL - {5}, KEYS, ([9, 17], [3, 5])),  # a key frame whose instant is missing
        (set(range(1, 6)), {1, 2}, ([1, 5], [1, 2])),
        (set(range(1, 9)), {1, 2, 3}, ([1, 5], [1, 2])),
        (ALL - {4, 10, 11}, KEYS, ([5, 9], [2, 3])),
        (ALL - {1, 4, 10}, KEYS - {5}, ([5, 9], [2, 3])),
    ],
)
def test_the_first_unbroken_run_counts(tmp_path, instants, keys, wanted):
    found = scene(tmp_path, instants, keys).as_far_as_rendered()
    assert numbers(found) == wanted
    found.require_complete()
    facts = found.manifest
    assert facts.instants.count == 4 * (facts.keys.count - 1) + 1 and facts.keys.step == 4
    assert [i for i in range(40) if facts.has_key(i)] == list(range(0, facts.instants.count, 4))
    for index in range(facts.keys.count):  # a key frame still is the instant that it was
        assert facts.keys.first + index - 1 == (facts.instants.first + 4 * index - 1) / 4


@pytest.mark.parametrize(
    ("instants", "keys", "wanted"),
    [
        (ALL - {17}, ALL, ([1, 16], [1, 16])),
        (ALL, ALL - {9}, ([1, 8], [1, 8])),
        (ALL - {1, 3}, ALL, ([4, 17], [4, 17])),
        (ALL - {8}, ALL - {5}, ([1, 4], [1, 4])),
    ],
)
def test_with_a_key_frame_at_every_instant(tmp_path, instants, keys, wanted):
    found = scene(tmp_path, instants, keys, step=1).as_far_as_rendered()
    assert numbers(found) == wanted
    found.require_complete()
    assert found.manifest.has_key(found.manifest.instants.count - 1)


@pytest.mark.parametrize(
    ("instants", "keys"),
    [
        (set(), set()),
        ({1, 2, 3, 4}, {1}),
        (ALL, {1, 3, 5}),
        (ALL - {2, 7, 12, 15}, KEYS),
        (set(), KEYS),
        (ALL, set()),
    ],
)
def test_nothing_to_go_by_is_refused(tmp_path, instants, keys):
    empty = scene(tmp_path, instants, keys)
    with pytest.raises(MissingFrameError, match="no two successive key frames") as caught:
        empty.as_far_as_rendered()
    message = str(caught.value)
    assert str(tmp_path) in message and "\n" not in message and "render some" in message


def test_the_scene_itself_is_left_alone(tmp_path):
    partial = scene(tmp_path, ALL - {17}, KEYS)
    before = numbers(partial)
    assert numbers(partial.as_far_as_rendered()) != before == numbers(partial)
