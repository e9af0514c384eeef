"""Where shots begin, and what of their frames leads beyond them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from exwarp_cli.domain.frame import GBuffer, KeyFrame
from exwarp_cli.domain.timeline import Cut, CutOption
from exwarp_cli.errors import MissingFrameError
from exwarp_cli.pipeline.shots import Shots, pairs_within
from tests.unit.scenes import Scene, town, vec

NUMBERS = tuple(range(1001, 1009))
CUT = 4
"""Index of the key frame after the cut."""

AUTO, NONE = CutOption(), CutOption(detect=False)


def elsewhere() -> Scene:
    """The town from another place."""
    scene = town()
    return replace(scene, camera=replace(scene.camera, start=vec(3.5, -0.8, 1.0), yaw=-0.35))


def frame(key: int, cut: int | None = CUT, **vectors: np.ndarray) -> KeyFrame:
    """Return a key frame, of the other place from the cut on."""
    scene = town() if cut is None or key < cut else elsewhere()
    made = scene.view(float(key % 3)).key(NUMBERS[key])
    assert made.gbuffer is not None
    return replace(made, gbuffer=replace(made.gbuffer, **vectors))


class Footage:
    """Key frames, and which of them were read."""

    def __init__(
        self,
        wish: CutOption,
        made: Callable[[int], KeyFrame] = frame,
        leader: Shots | None = None,
    ) -> None:
        self.seen: list[int] = []
        self._made = made
        self.shots = Shots(wish, NUMBERS, self.read, leader=leader)

    def read(self, key: int) -> None:
        self.seen.append(key)
        self.shots.see(key, self._made(key))


class TestStarts:
    def test_cuts_are_found_by_two_frames_each_read_once(self):
        footage = Footage(AUTO)
        assert footage.shots.starts_at(CUT)
        assert footage.seen == [CUT - 1, CUT]
        assert footage.shots.starts_at(CUT)
        assert footage.seen == [CUT - 1, CUT]
        assert footage.shots.cuts == (Cut(1005, "detected"),)

    @pytest.mark.parametrize("key", [-1, 0, len(NUMBERS)])
    def test_nothing_is_cut_at_the_ends(self, key):
        footage = Footage(AUTO)
        assert not footage.shots.starts_at(key)
        assert footage.seen == []

    def test_given_ones_are_not_looked_at(self):
        footage = Footage(CutOption(False, (1003, 1005)))
        assert [key for key in range(8) if footage.shots.starts_at(key)] == [2, 4]
        assert footage.seen == []
        assert footage.shots.cuts == (Cut(1003, "given"), Cut(1005, "given"))

    def test_both(self):
        footage = Footage(CutOption(True, (1005, 1006)))
        assert footage.shots.starts_at(CUT) and footage.shots.starts_at(CUT + 1)
        assert footage.seen == []
        assert not footage.shots.starts_at(1)
        assert footage.seen == [0, 1]

    @pytest.mark.parametrize(
        ("wish", "expected"), [(NONE, None), (AUTO, ()), (CutOption(False, (1001,)), ())]
    )
    def test_none_by_will_is_no_list(self, wish, expected):
        assert Footage(wish).shots.cuts == expected

    def test_a_given_one_has_to_be_there(self):
        with pytest.raises(MissingFrameError, match="frame 1010 of --cuts"):
            Footage(CutOption(False, (1010,)))

    def test_what_was_forgotten_is_read_again_but_stays_known(self):
        footage = Footage(AUTO)
        footage.shots.starts_at(CUT)
        footage.shots.release_before(CUT + 1)
        assert footage.shots.starts_at(CUT)
        footage.shots.starts_at(CUT + 1)
        assert footage.seen == [CUT - 1, CUT, CUT, CUT + 1]

    def test_other_views_follow(self):
        leader = Footage(AUTO)
        other = Footage(AUTO, lambda key: frame(key, None), leader.shots)
        assert other.shots.starts_at(CUT)
        assert other.seen == []

    @pytest.mark.parametrize(
        ("key", "back", "begin"), [(3, 2, 1), (3, 9, 0), (4, 3, 4), (6, 1, 5), (6, 2, 4), (7, 5, 4)]
    )
    def test_history_ends_at_the_cut(self, key, back, begin):
        footage = Footage(CutOption(False, (1005,)))
        assert footage.shots.begin(key, back) == begin


def sides(gbuffer: GBuffer) -> str:
    """Name the directions that are left."""
    there = {"previous": gbuffer.to_previous, "next": gbuffer.to_next}
    return " ".join(name for name, vectors in there.items() if vectors is not None)


def field(x: float, y: float = 0.0) -> np.ndarray:
    return np.broadcast_to(np.float32([x, y]), (80, 128, 2))


class TestVectorsAtACut:
    """Lengths are pixels of 128 in width, so a change of 1.3 tells."""

    GIVEN = CutOption(False, (1005,))

    def left(self, key: int, wish: CutOption = GIVEN, **vectors: np.ndarray) -> str:
        footage = Footage(wish, lambda k: frame(k, **vectors) if k == key else frame(k))
        made = frame(key, **vectors)
        assert made.gbuffer is not None
        return sides(footage.shots.within(key, made.gbuffer))

    @pytest.mark.parametrize("wish", [GIVEN, AUTO], ids=["given", "found"])
    @pytest.mark.parametrize(("key", "kept"), [(3, "previous"), (4, "next")])
    def test_those_across_it_go_where_they_do_not_continue(self, wish, key, kept):
        vectors = {"to_next": field(20.0, -9.0), "to_previous": field(-2.0)}
        if key == CUT:
            vectors = {"to_next": field(2.0), "to_previous": field(20.0, -9.0)}
        assert self.left(key, wish, **vectors) == kept

    @pytest.mark.parametrize("key", [3, 4])
    def test_a_shot_rendered_by_itself_keeps_them(self, key):
        assert self.left(key) == "previous next"

    @pytest.mark.parametrize(
        ("to_next", "to_previous"), [(1.2, 0.0), (0.0, 9.0), (-8.0, -9.0), (30.0, -20.0)]
    )
    def test_so_does_a_camera_that_starts_brakes_or_turns_back(self, to_next, to_previous):
        """Reversing, what it did last is as far from what it does next as both together."""
        vectors = {"to_next": field(to_next), "to_previous": field(to_previous)}
        left = self.left(3, **vectors)
        assert left == ("previous" if to_next == -8.0 else "previous next")

    @pytest.mark.parametrize("key", [1, 2, 5, 6])
    def test_away_from_a_cut_nothing_goes(self, key):
        assert self.left(key, to_next=field(40.0), to_previous=field(3.0)) == "previous next"

    def test_of_a_shot_of_one_frame_the_shorter_stay(self):
        wish = CutOption(False, (1004, 1005))
        assert self.left(3, wish, to_next=field(3.0), to_previous=field(40.0)) == "next"
        assert self.left(3, wish, to_next=field(40.0), to_previous=field(3.0)) == "previous"

    def test_a_single_direction_stays(self):
        made = frame(3, to_next=field(40.0)).without("to_previous")
        footage = Footage(self.GIVEN, lambda key: made)
        assert made.gbuffer is not None
        assert footage.shots.within(3, made.gbuffer) is made.gbuffer

    def test_unusable_vectors_tell_nothing(self):
        assert self.left(3, to_next=field(np.nan)) == "previous next"

    def test_background_does_not_count(self):
        """Its vectors are often none, whatever the camera does."""
        depth = np.full((80, 128), np.inf, np.float32)
        depth[70:] = 5
        after, before = np.zeros((2, 80, 128, 2), np.float32)
        after[70:], before[70:] = (20, 5), (-2, 0)
        vectors = {"depth": depth, "to_next": after, "to_previous": before}
        assert self.left(3, **vectors) == "previous"

    def test_without_a_wish_nothing_is_read(self):
        footage = Footage(NONE)
        made = frame(3, to_next=field(40.0))
        assert made.gbuffer is not None
        assert footage.shots.within(3, made.gbuffer) is made.gbuffer
        assert footage.seen == []


class TestRecipes:
    @pytest.mark.parametrize(
        ("key", "back", "changes"),
        [(1, 3, []), (3, 3, ["end"]), (4, 0, ["begin 0"]), (5, 3, ["begin -1"]), (5, 0, [])],
    )
    def test_what_a_cut_changes_is_listed(self, key, back, changes):
        footage = Footage(CutOption(False, (1005,)))
        assert footage.shots.cut_facts(key, back, (key,)) == changes

    def test_vectors_too(self):
        footage = Footage(CutOption(False, (1005,)), lambda k: frame(k, to_next=field(40.0)))
        assert footage.shots.cut_facts(3, 0, (3,)) == ["end", "to_next 0"]
        assert footage.shots.cut_facts(2, 0, (2, 3)) == ["to_next 1"]


@pytest.mark.parametrize(
    ("count", "cuts", "firsts"),
    [
        (1, set(), []),
        (2, set(), [0]),
        (3, set(), [0, 1]),
        (9, set(), [0, 4, 7]),
        (9, {5}, [0, 3, 7]),
        (9, {1, 8}, [1, 4, 6]),
        (2, {1}, []),
        (3, {1, 2}, []),
        (4, {1, 3}, [1]),
    ],
)
def test_pairs_to_measure_by_lie_within_shots(count, cuts, firsts):
    assert pairs_within(count, cuts.__contains__) == firsts
