"""Frames that cannot be read, and what still is taken of a sequence."""

from __future__ import annotations

import pytest

from exwarp_cli.domain.timeline import MAX_FILLED, CutOption, Slot, fill_gaps
from exwarp_cli.errors import DamagedFileError, InputError
from exwarp_cli.io.sequences import find_aov_set, find_sequence
from exwarp_cli.io.shot import first_usable
from exwarp_cli.pipeline.shots import Shots, UnreadableFrames


def lose(unreadable: UnreadableFrames, slot: Slot, text: str = "gone") -> None:
    with pytest.raises(InputError, match=text), unreadable.recorded(slot):
        raise DamagedFileError(text)


class TestUnreadableFrames:
    def test_what_fails_is_unreadable(self):
        unreadable = UnreadableFrames(tolerant=True)
        lose(unreadable, Slot(3, 0))
        assert unreadable.has(Slot(3, 0)) and len(unreadable) == 1
        assert [key for key in range(6) if unreadable.has(Slot(key, 0))] == [3]

    def test_it_is_not_read_again(self):
        unreadable = UnreadableFrames(tolerant=True)
        lose(unreadable, Slot(3, 0), "truncated")
        with pytest.raises(InputError, match="truncated"), unreadable.recorded(Slot(3, 0)):
            pytest.fail("read again")

    def test_reading_another_frame_for_it_does_not_count(self):
        unreadable = UnreadableFrames(tolerant=True)
        for _ in range(2):
            with pytest.raises(InputError), unreadable.recorded(Slot(2, 0)):
                lose_inside(unreadable, Slot(3, 0))
        assert unreadable.has(Slot(3, 0)) and not unreadable.has(Slot(2, 0))

    def test_nor_is_it_spared_by_an_earlier_failure(self):
        unreadable = UnreadableFrames(tolerant=True)
        lose(unreadable, Slot(3, 0))
        lose(unreadable, Slot(2, 0))
        assert unreadable.has(Slot(2, 0))

    def test_slots_between_part_nothing(self):
        unreadable = UnreadableFrames(tolerant=True)
        lose(unreadable, Slot(2, 1))
        assert not unreadable.has(Slot(1, 0), Slot(2, 0), Slot(2, 2))
        assert unreadable.has(Slot(2, 2), Slot(2, 1))

    def test_unless_tolerant_errors_pass(self):
        unreadable = UnreadableFrames()
        with pytest.raises(DamagedFileError), unreadable.recorded(Slot(3, 0)):
            raise DamagedFileError("gone")
        assert len(unreadable) == 0


def lose_inside(unreadable: UnreadableFrames, slot: Slot) -> None:
    with unreadable.recorded(slot):
        raise DamagedFileError("gone")


class TestShots:
    @pytest.fixture
    def unreadable(self) -> UnreadableFrames:
        return UnreadableFrames(tolerant=True)

    def shots(self, unreadable: UnreadableFrames, wish: CutOption, lost: int) -> Shots:
        def read(key: int) -> None:
            with unreadable.recorded(Slot(key, 0)):
                if key == lost:
                    raise DamagedFileError("gone")

        return Shots(wish, range(1001, 1009), read, unreadable)

    def test_a_lost_frame_is_a_hole_between_two_shots(self, unreadable):
        shots = self.shots(unreadable, CutOption(detect=False), 3)
        with pytest.raises(InputError):
            shots.starts_at(3)
        assert [key for key in range(9) if shots.starts_at(key)] == [3, 4]
        assert shots.cut_facts(2, 0, ()) == ["end"]
        assert shots.cut_facts(4, 0, ()) == ["begin 0"]

    def test_which_is_no_cut(self, unreadable):
        shots = self.shots(unreadable, CutOption(False, (1006,)), 3)
        with pytest.raises(InputError):
            shots.starts_at(4)
        assert all(shots.starts_at(key) for key in (3, 4, 5))
        assert shots.cuts is not None and [cut.number for cut in shots.cuts] == [1006]

    def test_it_shows_wherever_one_begins(self, unreadable):
        """Cuts by hand are not looked for, yet what is around a key frame has to be known."""
        shots = self.shots(unreadable, CutOption(detect=False), 3)
        with pytest.raises(InputError):
            shots.starts_at(4)
        assert shots.starts_at(4)


class TestGaps:
    @pytest.mark.parametrize(
        ("numbers", "filled"),
        [
            ([1, 2, 5], [1, 2, 3, 4, 5]),
            ([10, 14, 22], [10, 14, 18, 22]),
            ([7], [7]),
            ([], []),
            ([1, 3, 6], [1, 3, 6]),
            ([-2, 0, 4], [-2, 0, 2, 4]),
            ([1, 2, MAX_FILLED + 5], [1, 2, MAX_FILLED + 5]),
        ],
    )
    def test_numbers(self, numbers, filled):
        assert list(fill_gaps(numbers)) == filled

    def test_a_missing_frame_has_the_path_it_would(self, tmp_path):
        for number in (8, 9, 11):
            (tmp_path / f"a.{number:04d}.exr").touch()
        found = find_sequence(str(tmp_path), gaps=True)
        assert found.numbers == [8, 9, 10, 11]
        assert found.files[10] == tmp_path / "a.0010.exr"
        assert find_sequence(str(tmp_path)).numbers == [8, 9, 11]

    def test_aovs_have_the_frames_of_colour(self, tmp_path):
        for number in (1, 2, 4):
            (tmp_path / f"SceneColor.{number}.exr").touch()
        for number in (1, 3, 4, 5):
            (tmp_path / f"MotionVector.{number}.exr").touch()
        found = find_aov_set(str(tmp_path), gaps=True)
        assert found.leader.numbers == [1, 2, 3, 4]
        assert found.aovs["MotionVector"].numbers == [1, 2, 3, 4]
        assert found.aovs["MotionVector"].files[2] == tmp_path / "MotionVector.2.exr"


def test_the_first_that_is_of_use():
    def halved(number: int) -> int:
        if number % 2:
            raise InputError(f"{number} is odd")
        return number // 2

    assert first_usable([1, 3, 4, 6], halved) == 2
    with pytest.raises(InputError, match="1 is odd"):
        first_usable([1, 3], halved)
